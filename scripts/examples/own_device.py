"""Own device: an MJCF file, dropped on a wall.

The flotor is heavier, the coils are stronger and further out.

Numbers alone need no file: `mass`, `inertia` and `driver_time_constant` are keywords of both plants, and `coil_map`
of the MuJoCo plant.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco

from maglev_mj import Controller, Hold, MuJoCoPlant, Timing, Wall, drive, load_model, model_path

OTHERS = ("x", "y", "rx", "ry", "rz")
START = [0.0, 0.0, 0.003, 0.0, 0.0, 0.0]


def write_device(path):
    """Write a modified copy of the device model."""
    spec = mujoco.MjSpec.from_file(str(model_path("maglev")))
    spec.body("flotor").mass += 0.3
    for site in spec.sites:
        if site.name.startswith("coil_vertical"):
            site.pos *= [1.2, 1.2, 1.0]
    for coil in spec.actuators:
        coil.gainprm[0] *= 1.5  # force constant [N/A]
    path.write_text(spec.to_xml(), encoding="utf-8")


def deepest(model):
    """Return the penetration of a drop from 3 mm [m].

    No coil takes more than 10 A.
    """
    timing, device = Timing(), load_model(model)
    inertia = [device.mass, device.mass, *device.inertia]
    others = Hold.critically_damped(OTHERS, period=timing.period, delay=timing.delay, inertia=inertia)
    wall = Wall(axes="z", lower=0.0, stiffness=6000.0, damping=80.0, pulse=220.0, pulse_width=0.003)
    plant = MuJoCoPlant(timing, model=model, pose=START, current_limit=10.0, record=True)
    drive(plant, Controller([wall, others], period=timing.period), 60)
    return -plant.trace().pose[:, 2].min()


if __name__ == "__main__":
    with TemporaryDirectory() as folder:
        mine = Path(folder) / "mine.xml"
        write_device(mine)
        for name, model in {"published": "maglev", "mine": mine}.items():
            device = load_model(model)
            wrench = device.coils.largest_wrench(10.0)
            print(f"{name}: {device.mass:.2f} kg, {wrench[2]:.0f} N along z and {wrench[3]:.2f} N m about x at 10 A,")
            print(f"  falls {1e3 * deepest(model):.2f} mm into the wall")
