"""Every law, plant, sensor, hand, link, scene, command and format of the package, each with its smallest instance.

A property that all of a kind have is stated once, over its list here; `test_all_of.py` holds the lists to the package.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from maglev_mj import control, plants
from maglev_mj.bridge.twin.simulated_links import Line, VirtualLink
from maglev_mj.bridge.twin.twin import Twin, TwinParameters
from maglev_mj.cli.program import COMMANDS as COMMANDS
from maglev_mj.control import (
    Bias,
    HalfSampleWall,
    Hold,
    ImplicitCoulomb,
    Law,
    LuGre,
    PassivityController,
    StickSlip,
    VirtualCoupling,
    Wall,
)
from maglev_mj.control.controller import Controller
from maglev_mj.control.laws.velocity import Estimator
from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES
from maglev_mj.lazy import public
from maglev_mj.plants import ExactPlant, MuJoCoBatchPlant, MuJoCoPlant, SampledPlant, Sensor, SpotSensor, Timing
from maglev_mj.plants.exact_coils import ExactCoilPlant
from maglev_mj.plants.hand import GuidedHand, Hand, SpringHand, Trajectory
from maglev_mj.plants.model import load_model
from maglev_mj.plants.sensor import SimulatedSensor
from maglev_mj.recording.formats import FORMATS as FORMATS
from maglev_mj.scenes.names import BUILT_IN
from maglev_mj.spec import INERTIA
from tests.published import WEIGHT

SCENES = [*BUILT_IN]
IDEAL: Mapping[str, type[SimulatedSensor]] = {one.__name__: one for one in public(plants, SimulatedSensor)}
SENSORS: Mapping[str, tuple[Any, float]] = {
    **{name: (one(), 1e-13) for name, one in IDEAL.items()},
    "Sensor": (Sensor(), 1e-15),
    # half a step and six standard deviations; a step of a spot turns the flotor by that over its arm
    "coarse": (Sensor(quantum=5e-6), 2.5e-6 + 1e-15),
    "noisy": (Sensor(quantum=5e-6, noise=2e-5, seed=3), 2.5e-6 + 6.0 * 2e-5),
    "spots": (SpotSensor(quantum=5e-6), 1e-4),
}
"""Every sensor of the package, and some with resolution or noise; the largest error of a reading [m, rad]."""

PERIOD, DELAY = 0.002, 0.003
ALL: dict[str, Any] = {"stiffness": 300.0, "damping": 5.0, "axes": ("x", "y", "z")}
FRICTION = {**ALL, "breakaway": 0.05}
_SPECIAL: Mapping[str, list[Law]] = {
    "Wall": [
        Wall(
            axes=("y", "z"),
            lower=[-np.inf, 1e-4],
            upper=[2e-4, np.inf],
            stiffness=[800.0, 2000.0],
            damping=20.0,
            pulse=40.0,
            pulse_width=1e-3,
            pulse_gate=1e-4,
            force_limit=[np.inf, 0.2],
        )
    ],
    "Hold": [Hold(**ALL, target=[1e-3, 0.0, -1e-3])],
    "HalfSampleWall": [HalfSampleWall(axes="z", stiffness=1500.0, damping=10.0, period=PERIOD)],
    "VirtualCoupling": [VirtualCoupling(axes="z", stiffness=900.0, damping=10.0, inertia=0.4, period=PERIOD)],
    "PassivityController": [
        Wall(axes="z", lower=1e-4, stiffness=4000.0, damping=0.0),
        PassivityController(axes="z", period=PERIOD, delay=DELAY, most=30.0, slow=1e-5),
    ],
    "StickSlip": [StickSlip(**FRICTION, v_min=1e-3, coupled=False)],
    "ImplicitCoulomb": [ImplicitCoulomb(**FRICTION, period=PERIOD, element_damping=3.0)],
    "LuGre": [LuGre(**FRICTION, period=PERIOD, coulomb=0.7, stribeck=0.02, bristle_damping=0.5)],
    "ElastoPlastic": [control.ElastoPlastic(**FRICTION, elastic=0.6)],
    "HaywardArmstrong": [control.HaywardArmstrong(**FRICTION, stick=0.6)],
    "Bias": [],
}
"""Laws with more than the gains of `FRICTION`, or beside others."""


def _smallest(law: type[Law]) -> list[Law]:
    """Return the smallest instance of a law, beside the others that it needs."""
    if law.__name__ in _SPECIAL:
        return _SPECIAL[law.__name__]
    try:
        return [law(**FRICTION)]
    except ParameterError as error:
        error.add_note(f"give {law.__name__} other gains in _SPECIAL of tests/all_of.py")
        raise


LAWS: Mapping[str, list[Law]] = {law.__name__: _smallest(law) for law in public(control, Law)}
_SET: Mapping[str, dict[str, Any]] = {"LowPass": {"cutoff": 80.0}, "Window": {"samples": 4}}
VELOCITIES: list[Estimator] = [one(**_SET.get(one.__name__, {})) for one in public(control, Estimator)]
_MANY = ("StickSlip", "LowPass"), ("Wall", "Window"), ("LuGre", "AdaptiveWindow")
_PAIRED = {law: next(one for one in VELOCITIES if type(one).__name__ == name) for law, name in _MANY}
"""Velocity estimates that laws are tried with, by name; the finite difference with the others."""
ARM = Hand(mass=0.3, damping=5.0, stiffness=100.0)
PATH = Trajectory([0.01, 0.05, 0.12], [[0.0] * 6, [1e-3, -1e-3, 2e-3, 0.0, 0.0, 0.0], [0.0] * 6])
START: dict[str, Any] = {"pose": [8e-4, -6e-4, 9e-4, 4e-3, 0.0, 0.0], "twist": [0.02, 0.01, -0.05, 0.0, 0.0, 0.0]}
TIMING: dict[str, Any] = {"period": PERIOD, "delay": DELAY}
PLANTS: Mapping[str, Callable[[], SampledPlant]] = {
    "exact": lambda: ExactPlant(Timing(**TIMING), **START, wrench=WEIGHT),
    "exact, with options": lambda: ExactPlant(
        Timing(**TIMING, phase=0.3, jitter=2e-4, seed=4),
        **START,
        mass=0.9,
        inertia=[1e-3, 2e-3, 3e-3],
        gravity=1.5,
        wrench=[0.0, 0.0, 1.3, 0.0, 0.0, 0.0],
        wrench_limit=np.array([0.05, np.inf, 1.0, np.inf, np.inf, np.inf]),
        sensor=Sensor(quantum=5e-6, noise=2e-5, seed=3),
        driver_lag=True,
        hand=ARM,
        hand_force=GuidedHand(hand=ARM, path=PATH),
        record=True,
    ),
    "mujoco": lambda: MuJoCoPlant(Timing(**TIMING), **START, wrench=WEIGHT),
    "mujoco, with options": lambda: MuJoCoPlant(
        Timing(**TIMING, phase=0.6),
        **START,
        model="scenes/table",
        mass=0.8,
        gravity=2.0,
        current_limit=0.5,
        driver_lag=True,
        stops=True,
        force_falloff=0.1,
        sensor=SpotSensor(quantum=5e-6, noise=2e-6, seed=5),
        hand_force=SpringHand(target=PATH, stiffness=150.0),
        escape=(0.02, 1.0),
        longest_step=5e-5,
        metered=True,
    ),
}

MOTIONS: Mapping[str, Callable[..., SampledPlant]] = {
    "exact": ExactPlant,
    "mujoco": MuJoCoPlant,
    "mujoco, ideal wrench": partial(MuJoCoPlant, coils=False),
    "mujoco, corrected": partial(MuJoCoPlant, integrator="corrected"),
    "mujoco, corrected in short steps": partial(MuJoCoPlant, integrator="corrected", coils=False, longest_step=1e-3),
}
"""Ways to compute the motion of one device, all of the same device."""

_COILS: Any = load_model("maglev").coils
UNRECORDED: Mapping[str, Callable[[], SampledPlant]] = {
    "mujoco, batch": lambda: MuJoCoBatchPlant(Timing(**TIMING), pose=np.tile(START["pose"], (2, 1))),
    "exact, coils": lambda: ExactCoilPlant(
        Timing(**TIMING), coils=_COILS, mass=0.7, inertia=INERTIA[3:], gravity=np.zeros(3), pose=START["pose"]
    ),
}
"""Plants that no recording makes again: batches, and that of the twin."""

LINES: Mapping[str, Callable[[], VirtualLink]] = {
    "perfect": lambda: VirtualLink(Twin(TwinParameters())),
    "delayed": lambda: VirtualLink(Twin(TwinParameters()), Line(delay=2e-3)),
    "lockstep": lambda: VirtualLink(Twin(TwinParameters(lockstep=True))),
}


def controller_of(name: str) -> Controller:
    """Return a controller of a law, with another velocity estimate, that holds the other axes."""
    estimate = _PAIRED.get(name, VELOCITIES[0])
    rest = Hold(axes=AXES[3:], stiffness=0.3, damping=0.02)
    return Controller([*LAWS[name], rest, Bias(WEIGHT)], period=PERIOD, velocity=estimate)
