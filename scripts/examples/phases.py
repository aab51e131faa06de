"""Statistics over phases of the sampler.

A drop on a wall, with and without the braking pulse.

The flotor meets the wall at some instant between two samples, and the bounce depends on it. One run is one case; the
median and the 5th to 95th percentile over all phases describe the wall.
"""

from maglev_mj import run_phases
from maglev_mj.scenes.drop import Drop

print("100 phases           median (5 to 95 %)")
for name, scene in {"pulse": Drop(), "no pulse": Drop(pulse=0.0)}.items():
    phases = run_phases(scene, 100, plant="exact")
    median, low, high = (phases.percentile(share) for share in (50.0, 5.0, 95.0))
    for figure, scale, unit in (("penetration", 1e3, "mm"), ("peak_force", 1.0, "N")):
        middle, least, most = (scale * part[figure] for part in (median, low, high))
        print(f"{name:9s}{figure:12s}{middle:6.2f} ({least:.2f} to {most:.2f}) {unit}")
