"""The flotor pulled out of rendered friction by a virtual spring: figure 8 of Salcudean and Vlaar (1997)."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from maglev_mj.controller import Controller
from maglev_mj.errors import DivergenceError, ParameterError
from maglev_mj.experiments.drop import escaped_later
from maglev_mj.frames import AXES, Array, Command, Mask, Sample
from maglev_mj.hand import HandForce
from maglev_mj.laws import Hold
from maglev_mj.loop import run
from maglev_mj.parameters import axis_indices, number
from maglev_mj.plants import SampledPlant, Sensor, Timing, engine_warnings_silenced
from maglev_mj.scenes.choices import LAWS, PLANTS, SLIDES_AT, VELOCITIES, PlantMaker
from maglev_mj.spec import INERTIA, Spec
from maglev_mj.theory.karnopp import FrictionEvent, KarnoppMotion, karnopp
from maglev_mj.trace import Trace

__all__ = [
    "StickSlipParameters",
    "StickSlipResult",
    "StickSlipSummary",
    "exact_stick_slip",
    "run_stick_slip",
    "stick_slip_parts",
]

_MOST_TICKS = 1_000_000

_AT_TRANSLATION = {"spring": 1000.0, "target": 0.003, "stiffness": 6000.0, "damping": 80.0, "breakaway": 2.0}
_AT_TRANSLATION["v_min"] = 0.005
_POWER_OF_RADIUS = {"spring": 2, "target": -1, "stiffness": 2, "damping": 2, "breakaway": 1, "v_min": -1}


@dataclass(frozen=True, kw_only=True)
class StickSlipParameters:
    """A flotor at rest and stuck at 0, released against a virtual spring whose far end is at `target`.

    On a rotation axis the defaults are those of a translation at the radius of gyration, so that the motion is the
    same in units of it; what is given is in N m/rad, rad, N m s/rad, N m and rad/s there.

    Attributes:
        plant: "mujoco" or "exact".
        law: Name from LAWS.
        velocity: Name from VELOCITIES.
        axis: Name from AXES; gravity is compensated, the other axes are held.
        period: Sample period [s].
        delay: From a sample to its command taking effect [s].
        quantize: Resolution of the position sensor [m, rad]; 0 for an ideal one.
        spring: Stiffness of the virtual spring [N/m].
        target: Where its far end is [m].
        stiffness: Stiffness of the friction law while stuck [N/m].
        damping: Viscous damping [N s/m].
        breakaway: Breakaway force [N].
        v_min: Speed below which the flotor sticks [m/s].
        duration: Simulated time [s].

    Raises:
        ParameterError: If a value is outside its bounds.
    """

    plant: str = "mujoco"
    law: str = "stick-slip"
    velocity: str = "difference"
    axis: str = "x"
    period: float = 1.0 / Spec.control_rate.value
    delay: float = Spec.transport_delay.value
    quantize: float = 0.0
    spring: float | None = None
    target: float | None = None
    stiffness: float | None = None
    damping: float | None = None
    breakaway: float | None = None
    v_min: float | None = None
    duration: float = 0.3

    def __post_init__(self) -> None:
        for name, choices in (("plant", PLANTS), ("law", tuple(LAWS)), ("velocity", tuple(VELOCITIES))):
            if getattr(self, name) not in choices:
                raise ParameterError(f"{name} must be one of {', '.join(choices)}, not {getattr(self, name)!r}")
        (index,) = axis_indices(self.axis)
        radius = 1.0 if index < 3 else math.sqrt(self.inertia / Spec.moving_mass.value)
        for name, value in _AT_TRANSLATION.items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, value * radius ** _POWER_OF_RADIUS[name])
        bounds: dict[str, dict[str, float]] = {
            "period": {"at_least": 1e-6, "at_most": 1.0},
            "delay": {"at_least": 0.0, "at_most": 1.0},
            "quantize": {"at_least": 0.0, "at_most": 1.0},
            "spring": {"above": 0.0, "at_most": 1e8},
            "target": {"at_least": -0.5, "at_most": 0.5},
            "stiffness": {"above": 0.0, "at_most": 1e8},
            "damping": {"at_least": 0.0, "at_most": 1e6},
            "breakaway": {"above": 0.0, "at_most": 1e6},
            "v_min": {"above": 0.0, "at_most": 1e3},
            "duration": {"above": 0.0, "at_most": 1000.0},
        }
        for name, allowed in bounds.items():
            object.__setattr__(self, name, number(name, getattr(self, name), **allowed))
        if self.duration / self.period > _MOST_TICKS:
            raise ParameterError(f"duration must be at most {_MOST_TICKS} periods, not {self.duration:g} s")

    @property
    def inertia(self) -> float:
        """Mass or moment of inertia on the axis [kg, kg m²]."""
        return INERTIA[AXES.index(self.axis)]


class StickSlipSummary(NamedTuple):
    """Figures of one run.

    Attributes:
        peak_speed: Greatest speed [m/s, rad/s].
        stick_time: When it last stuck [s]; NaN if it never did.
        stick_position: Where its stick position is at the end [m, rad].
        final_position: Where it is at the end [m, rad].
        transitions: Changes between stuck and sliding.
        ripple: Peak to peak over the last 50 ms [m, rad].
    """

    peak_speed: float
    stick_time: float
    stick_position: float
    final_position: float
    transitions: int
    ripple: float


@dataclass(frozen=True, eq=False)
class StickSlipResult:
    """One run: its parameters, the motion, and the law's state at each sample.

    Attributes:
        parameters: What was run.
        trace: The motion along all axes.
        sample_time: When each answered sample was taken [s], (K,).
        anchor: The law's stick position from each sample on [m, rad], (K,).
        stuck: Whether the law sticks from each sample on, (K,).
        events: Changes of the law's state, at the samples that found them.
    """

    parameters: StickSlipParameters
    trace: Trace
    sample_time: Array
    anchor: Array
    stuck: Mask
    events: tuple[FrictionEvent, ...]

    def series(self, step: float = 1e-3) -> dict[str, Array]:
        """Return time, position, velocity, stick_position, state (1 stuck) and force on a grid of `step` [s], (M,)."""
        index = AXES.index(self.parameters.axis)
        end = float(self.trace.time[-1])
        time: Array = np.arange(math.floor(end / number("step", step, above=0.0) + 1e-9) + 1, dtype=np.float64) * step
        pose, twist, wrench = self.trace.at(time)
        held = np.clip(np.searchsorted(self.sample_time, time + 1e-12, side="right") - 1, 0, None)
        return {
            "time": time,
            "position": pose[:, index],
            "velocity": twist[:, index],
            "stick_position": self.anchor[held],
            "state": self.stuck[held].astype(np.float64),
            "force": wrench[:, index],
        }

    @property
    def summary(self) -> StickSlipSummary:
        """Figures of the run."""
        index = AXES.index(self.parameters.axis)
        line = self.trace.along(index)
        end = float(line.time[-1])
        tail = line.at(np.linspace(max(end - 0.05, 0.0), end, 501))[0][:, 0]
        sticks = [event.time for event in self.events if event.kind == "stick"]
        return StickSlipSummary(
            peak_speed=float(np.abs(line.twist).max()),  # greatest at a knot: the speed is linear between them
            stick_time=sticks[-1] if sticks else math.nan,
            stick_position=float(self.anchor[-1]),
            final_position=float(line.pose[-1, 0]),
            transitions=len(self.events),
            ripple=float(np.ptp(tail)),
        )

    def as_json(self) -> dict[str, Any]:
        """Return parameters, series every millisecond, events and summary, ready for JSON."""
        series = self.series()
        series["time"] = np.round(series["time"], 9)
        plain = {name: values.tolist() for name, values in series.items()}
        plain["state"] = ["stuck" if value else "sliding" for value in plain["state"]]
        figures = self.summary._asdict()
        if math.isnan(figures["stick_time"]):
            figures["stick_time"] = None
        events = [event._asdict() for event in self.events]
        return {"parameters": asdict(self.parameters), **plain, "events": events, "summary": figures}


def run_stick_slip(parameters: StickSlipParameters) -> StickSlipResult:
    """Release the flotor against the spring.

    Raises:
        DivergenceError: If the flotor leaves its range by a wide margin; its `partial` attribute is the
            StickSlipResult up to there.
    """
    p = parameters
    index = AXES.index(p.axis)
    plant, controller, ticks = stick_slip_parts(p)
    rows: list[tuple[float, float, float, bool]] = []

    def observe(sample: Sample, _: Command) -> None:
        (state,) = controller.states[0]
        rows.append((float(sample.time), sample.position[index], float(state.anchor), bool(state.stuck)))

    with plant, engine_warnings_silenced():
        try:
            run(plant, controller, ticks, observe=observe)
            trace = plant.trace().until(p.duration)
        except DivergenceError as error:
            trace = plant.trace()
            if not escaped_later(trace, p.duration):
                error.partial = _result(p, trace, rows)
                raise
            trace = trace.until(p.duration)
    return _result(p, trace, rows)


def stick_slip_parts(
    parameters: StickSlipParameters, hand_force: HandForce | None = None, *, make: PlantMaker | None = None
) -> tuple[SampledPlant, Controller, int]:
    """Return what a run is made of: the plant, in a hand if there is one, the controller, and how many samples.

    Args:
        parameters: The run.
        hand_force: What a hand exerts.
        make: Makes the plant; the parameters' by default.
    """
    p = parameters
    common = {"axes": p.axis, "stiffness": p.stiffness, "damping": p.damping, "breakaway": p.breakaway}
    friction = LAWS[p.law](v_min=p.v_min, period=p.period, **common)
    spring = Hold(axes=p.axis, stiffness=p.spring or 0.0, damping=0.0, target=p.target or 0.0)
    index = AXES.index(p.axis)
    others = [name for name in AXES if name != p.axis]
    hold = Hold.critically_damped(others, inertia=np.delete(INERTIA, index), period=p.period, delay=p.delay)
    controller = Controller([friction, spring, hold], period=p.period, velocity=VELOCITIES[p.velocity](p.quantize))
    ticks = max(math.ceil(p.duration / p.period + 1e-9), 1)
    return _plant(p, index, hand_force, make or PLANTS[p.plant]), controller, ticks


def exact_stick_slip(parameters: StickSlipParameters, time: Array) -> KarnoppMotion:
    """Return what the friction that a law stands for does itself with the same spring, mass and damping.

    Karnopp's for the laws that slide freely; for the others Coulomb friction, which against a motion that never turns
    back is a constant force: the spring's end moved by f / k.
    """
    p = parameters
    spring, target, breakaway, v_min = p.spring or 0.0, p.target or 0.0, p.breakaway or 0.0, p.v_min or 0.0
    share = SLIDES_AT.get(p.law, 1.0)
    if share > 0.0 and abs(spring * target) > breakaway:
        target -= math.copysign(share * breakaway / spring, target)
        breakaway, v_min = 1e-9 * breakaway, 1e-9 * v_min
    return karnopp(
        time,
        targets=[(0.0, target)],
        spring=spring,
        damping=p.damping or 0.0,
        breakaway=breakaway,
        v_min=v_min,
        mass=p.inertia,
    )


def _plant(parameters: StickSlipParameters, index: int, hand_force: HandForce | None, make: PlantMaker) -> SampledPlant:
    sensor = Sensor(quantum=np.eye(6)[index] * parameters.quantize) if parameters.quantize else None
    timing = Timing(period=parameters.period, delay=parameters.delay)
    return make(timing, gravity=0.0, sensor=sensor, record=True, hand_force=hand_force)


def _result(
    parameters: StickSlipParameters, trace: Trace, rows: list[tuple[float, float, float, bool]]
) -> StickSlipResult:
    time, place, anchor, stuck = (np.array(column) for column in zip(*rows, strict=True))
    kept = time <= float(trace.time[-1])
    changes = np.flatnonzero(stuck[1:] != stuck[:-1]) + 1
    events = [
        FrictionEvent(float(time[k]), "stick" if stuck[k] else "slip", float(place[k])) for k in changes if kept[k]
    ]
    return StickSlipResult(parameters, trace, time[kept], anchor[kept], stuck[kept], tuple(events))
