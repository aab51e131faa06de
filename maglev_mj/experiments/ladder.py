"""The ladder of fidelity: what each further piece of the device changes in each scene, and what it costs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from maglev_mj.controller import Controller
from maglev_mj.detail import Detail
from maglev_mj.errors import ParameterError
from maglev_mj.experiments.wall_controller import wall_controller
from maglev_mj.frames import AXES, Array, Command, Sample
from maglev_mj.hand import Hand, hand_called
from maglev_mj.laws import Hold, StickSlip
from maglev_mj.loop import run
from maglev_mj.plants import CorrectedPlant, ExactPlant, MuJoCoPlant, SampledPlant, Sensor, SpotSensor, Timing
from maglev_mj.spec import DRIVER_TIME_CONSTANT, GRAVITY, INERTIA, RESOLUTION, Spec

__all__ = [
    "DELAY",
    "FIDELITY_SCENES",
    "PERIOD",
    "RUNGS",
    "FidelityScene",
    "Motion",
    "Rung",
    "apart",
    "motion_of",
    "place_of",
    "plant_of",
]

PERIOD, DELAY = 1.0 / Spec.control_rate.value, Spec.transport_delay.value
"""Of every scene [s]."""

_MASS = Spec.moving_mass.value
_SPOTS = SpotSensor(quantum=Spec.spot_resolution.value)
_WALL: dict[str, Any] = {"stiffness": 6000.0, "damping": 80.0, "period": PERIOD, "delay": DELAY, "mass": _MASS}


class Rung(NamedTuple):
    """One step of the ladder: what it adds to those below.

    Attributes:
        name: Its name.
        says: What it adds.
        options: Keywords of the plant that it adds or replaces.
        timing: Keywords of its timing that it replaces.
    """

    name: str
    says: str
    options: Mapping[str, Any]
    timing: Mapping[str, float] = MappingProxyType({})


RUNGS: tuple[Rung, ...] = (
    Rung("axes", "six decoupled axes, in closed form", {}),
    Rung("body", "a rigid body with an ideal wrench", {"coils": False}),
    Rung("coils", "six coils that do not turn, 10 A each", {"current_limit": Spec.peak_current.value}),
    Rung("turning", "coils that turn with the flotor", {"coils": True}),
    Rung("lag", "drivers of 2 kHz, as 80 µs more of delay", {}, {"delay": DELAY + DRIVER_TIME_CONSTANT}),
    Rung("falloff", "a tenth of the force lost at the end of the range", {"detail": Detail(force_falloff=0.1)}),
    Rung("steps", "a sensor of 5 µm and 10 µrad", {"sensor": Sensor(quantum=RESOLUTION)}),
    Rung("spots", "LEDs and diodes of 0.8 µm, the pose by Newton", {"sensor": _SPOTS}),
    Rung("jitter", "conversions that vary by 0.1 ms either way", {}, {"jitter": 1e-4}),
    Rung("stops", "metal stops", {"detail": Detail(force_falloff=0.1, stops=True)}),
    Rung("filter", "the drivers' lag as the filter that it is", {"driver_lag": True}, {"delay": DELAY}),
    Rung("flexible", "a handle that swings at 1 kHz", {"detail": Detail(force_falloff=0.1, stops=True, flexible=True)}),
)
"""From the least model to the most, each with all that is below it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FidelityScene:
    """What happens, and how well one wants to know it.

    Attributes:
        name: Its name.
        says: What happens.
        tolerance: Greatest displacement of a coil that does not matter [m].
        reason: Where the tolerance is from.
        rung: The least rung that keeps it.
        controller: Makes the controller.
        ticks: Samples.
        pose: At release [m, rad].
        twist: At release [m/s, rad/s].
        gravity: Acceleration of free fall [m/s²].
        hand: On the flotor.
    """

    name: str
    says: str
    tolerance: float
    reason: str
    rung: str
    controller: Callable[[], Controller]
    ticks: int = 80
    pose: tuple[float, ...] = (0.0,) * 6
    twist: tuple[float, ...] = (0.0,) * 6
    gravity: float = GRAVITY
    hand: Hand | None = None


def _stick_slip() -> Controller:
    friction = StickSlip(axes="x", stiffness=6000.0, damping=80.0, breakaway=2.0, v_min=0.005)
    spring = Hold(axes="x", stiffness=1000.0, damping=0.0, target=0.003)
    others = Hold.critically_damped(AXES[1:], inertia=INERTIA[1:], period=PERIOD, delay=DELAY)
    return Controller([friction, spring, others], period=PERIOD)


def _centring() -> Controller:
    return Controller([Hold.critically_damped(inertia=INERTIA, period=PERIOD, delay=DELAY)], period=PERIOD)


_HIGH = (0.0, 0.0, Spec.translation_range.value, 0.0, 0.0, 0.0)

FIDELITY_SCENES: Mapping[str, FidelityScene] = {
    scene.name: scene
    for scene in (
        FidelityScene(
            name="drop",
            says="a drop of 4.5 mm on a wall of 6000 N/m with a braking pulse",
            tolerance=1e-3,
            reason="less than the sampler's phase alone does to the penetration",
            rung="coils",
            controller=lambda: wall_controller(pulse=220.0, pulse_width=0.003, **_WALL),
            pose=_HIGH,
        ),
        FidelityScene(
            name="drop-no-pulse",
            says="the same without the pulse",
            tolerance=1e-4,
            reason="what the paper's figure 3 can be read to",
            rung="falloff",
            controller=lambda: wall_controller(**_WALL),
            pose=_HIGH,
        ),
        FidelityScene(
            name="press",
            says="an arm of 0.55 kg laid on the wall from 1 mm above",
            tolerance=1e-5,
            reason="two steps of the sensor",
            rung="falloff",
            controller=lambda: wall_controller(**_WALL),
            pose=(0.0, 0.0, 0.001, 0.0, 0.0, 0.0),
            hand=hand_called("arm"),
        ),
        FidelityScene(
            name="stick-slip",
            says="pulled out of friction of 2 N by a spring, as in figure 8",
            tolerance=1e-5,
            reason="two steps of the sensor",
            rung="spots",
            controller=_stick_slip,
            ticks=60,
            gravity=0.0,
        ),
        FidelityScene(
            name="twist",
            says="a free flotor that turns at 3.7 rad/s about all three axes",
            tolerance=1e-5,
            reason="two steps of the sensor",
            rung="body",
            controller=lambda: Controller([], period=PERIOD),
            ticks=8,
            pose=(0.0, 0.0, 0.0, -0.04, 0.03, -0.02),
            twist=(0.0, 0.0, 0.0, 2.0, -1.5, 2.7),
            gravity=0.0,
        ),
        FidelityScene(
            name="six-axes",
            says="drawn back to the centre from 3 mm and 3.4 degrees, on all six axes",
            tolerance=1e-5,
            reason="two steps of the sensor",
            rung="falloff",
            controller=_centring,
            ticks=60,
            pose=(0.003, -0.002, 0.003, 0.06, -0.04, 0.05),
            gravity=0.0,
        ),
        FidelityScene(
            name="let-go",
            says="the currents off at centre: the flotor falls on its stop",
            tolerance=1e-4,
            reason="well below the 0.5 mm over which the stop gives",
            rung="stops",
            controller=lambda: Controller([], period=PERIOD),
            ticks=16,
        ),
    )
}


class Motion(NamedTuple):
    """The answer of one run.

    Attributes:
        pose: At the samples [m, rad], (K, 6).
        twist: At the samples [m/s, rad/s], (K, 6).
        peak_force: Greatest force commanded along an axis, after the limits [N].
    """

    pose: Array
    twist: Array
    peak_force: float


def plant_of(scene: FidelityScene, rung: str, *, integrator: str = "rk4", **keywords: Any) -> SampledPlant:
    """Return the plant of a scene on a rung.

    Args:
        scene: The scene.
        rung: Name from RUNGS.
        integrator: One of `INTEGRATORS`, or "corrected" for `CorrectedPlant`; the lowest rung has none.
        keywords: Further ones of the plant, such as record and longest_step.

    Raises:
        ParameterError: If there is no such rung.
    """
    options: dict[str, Any] = {"pose": scene.pose, "twist": scene.twist, "gravity": scene.gravity, "hand": scene.hand}
    when: dict[str, Any] = {"period": PERIOD, "delay": DELAY}
    for each in RUNGS[: place_of(rung) + 1]:
        options |= each.options
        when |= each.timing
    options |= keywords
    timing = Timing(**when)
    if rung == RUNGS[0].name:
        return ExactPlant(timing, **options)
    if integrator == "corrected":
        return CorrectedPlant(timing, **options)
    return MuJoCoPlant(timing, integrator=integrator, **options)


def place_of(rung: str) -> int:
    """Return how many rungs are below one.

    Raises:
        ParameterError: If there is no such rung.
    """
    names = [each.name for each in RUNGS]
    if rung not in names:
        raise ParameterError(f"rung must be one of {', '.join(names)}, not {rung!r}")
    return names.index(rung)


def motion_of(scene: FidelityScene, plant: SampledPlant) -> Motion:
    """Run a scene and return the true motion at the samples."""
    states: list[tuple[Array, Array]] = []
    forces: list[Array] = []

    def observe(_: Sample, command: Command) -> None:
        states.append(plant.state())
        forces.append(np.maximum(np.abs(command.wrench), np.abs(command.wrench + command.pulse)))

    run(plant, scene.controller(), scene.ticks, observe=observe)
    states.append(plant.state())
    pose, twist = (np.array(part) for part in zip(*states, strict=True))
    return Motion(pose, twist, float(np.max(forces, axis=0)[:3].max()))


def apart(one: Array, other: Array) -> float:
    """Return how far two motions are apart at most: the greatest displacement of a coil [m], from poses (K, 6)."""
    difference = one - other
    moved, turned = (np.linalg.norm(part, axis=-1) for part in (difference[:, :3], difference[:, 3:]))
    return float((moved + Spec.coil_radius.value * turned).max())
