"""Draw figure 9: all six axes in stick-slip.

A smooth seeded hand moves the flotor; each axis shows a staircase.
"""

import itertools

import numpy as np

from maglev_mj import AXES
from maglev_mj.analysis.pictures import staircases
from maglev_mj.cli.output import script_options
from maglev_mj.frames import Array
from maglev_mj.pictures import save
from maglev_mj.spec import INERTIA, RANGE
from six_axes import run_six_axes

options = script_options(__doc__, quick="one seed, phase and hand; a shorter staircase")

DURATION = 4.0 if options.quick else 12.0
result = run_six_axes(duration=DURATION)
print(f"{'axis':>6}{'slips':>8}{'still stuck at':>18}{'slips at':>12}{'breakaway / stiffness':>24}{'least step':>14}")
for index, axis in enumerate(AXES):
    stuck, gone = (bound[index] * 1e3 for bound in result.stretch)
    expected, unit = result.expected_stretch[index] * 1e3, "mm" if index < 3 else "mrad"
    least = result.steps()[index].min() * 1e3
    print(f"{axis:>6}{result.slips[index]:>8}{stuck:>18.4f}{gone:>12.4f}{expected:>24.4f}{least:>14.2f} {unit}")

# what a hand can place: a step of a rotation is taken at the radius of gyration
radius = np.sqrt(np.array(INERTIA) / INERTIA[0])
seeds, phases = ((1,), (0.0,)) if options.quick else (range(1, 9), (0.0, 0.25, 0.5, 0.75))
hands = (1500.0,) if options.quick else (1000.0, 1500.0, 2500.0)
print(
    "distance from one resting place to the next, exact plant [mm], on each axis that stays within the device's range"
)
print(f"{'hand':>10}{'steps':>8}{'least':>8}{'5 %':>8}{'median':>8}   axes")
for stiffness in hands:
    found: list[Array] = []
    tried = 0
    for seed, phase in itertools.product(seeds, phases):
        run = run_six_axes(plant="exact", seed=seed, phase=phase, hand_stiffness=stiffness, duration=DURATION)
        inside = np.abs(run.position).max(axis=0) <= RANGE
        found += [one * scale * 1e3 for one, scale, kept in zip(run.steps(), radius, inside, strict=True) if kept]
        tried += len(AXES)
    low, fifth, middle = np.percentile(np.concatenate(found), [0.0, 5.0, 50.0])
    count = sum(map(len, found))
    print(f"{stiffness:>6.0f} N/m{count:>8}{low:>8.2f}{fifth:>8.2f}{middle:>8.2f}   {len(found)} of {tried}")
said = {}
for index, steps in enumerate(result.steps()):
    between = f", resting places {steps.min() * 1e3:.2g} to {steps.max() * 1e3:.2g} apart" if steps.size else ""
    said[index] = f"{int(result.slips[index])} slips{between}"
anchors = np.where(result.stuck, result.anchor, np.nan)
figure = staircases(result.time, result.position, anchors, said)
print("wrote", save(figure, options.pictures.path("fig9_six_axes")))
