"""The flotor dropped on a stiff wall: figures 3 and 4 of Salcudean and Vlaar (1997)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from numbers import Integral
from typing import Any

import numpy as np

from maglev_mj.controller import Controller
from maglev_mj.errors import DivergenceError, ParameterError
from maglev_mj.exact import analog_wall
from maglev_mj.experiments.choices import PLANTS
from maglev_mj.experiments.wall_controller import wall_controller
from maglev_mj.frames import Array
from maglev_mj.loop import run
from maglev_mj.metrics import BounceSummary, Hardness, perceived_hardness, percentiles, summarise_bounce
from maglev_mj.parameters import number, numbers
from maglev_mj.plants import ExactPlant, MuJoCoPlant, SampledPlant, Sensor, Timing, engine_warnings_silenced
from maglev_mj.spec import GRAVITY, Spec
from maglev_mj.trace import Trace

__all__ = ["DropParameters", "DropResult", "DropSweep", "analog_drop", "run_drop", "sweep_drop", "sweep_hardness"]

_ESCAPE = 0.045
_MOST_TICKS = 1_000_000
_MOST_PHASES = 10_000
_TOGETHER = 64


@dataclass(frozen=True, kw_only=True)
class DropParameters:
    """A drop on a wall that fills z <= 0; the five other axes are held.

    Attributes:
        plant: "mujoco" or "exact".
        height: Drop height above the wall [m].
        phase: The samples are at (k + phase) period after release; in [0, 1).
        period: Sample period [s].
        delay: From a sample to its command taking effect [s].
        stiffness: Wall stiffness [N/m].
        damping: Wall damping [N s/m].
        pulse: Further damping in the braking pulse [N s/m]; 0 for none.
        pulse_width: How long the pulse lasts [s].
        mass: Moving mass [kg].
        force_limit: Largest force of the actuators along z [N]; None for no limit.
        carry: Whether braking that the limit cuts off a pulse follows on the next samples, or is lost.
        quantize: Resolution of the position sensor [m]; 0 for an ideal one.
        duration: Simulated time from release [s].

    Raises:
        ParameterError: If a value is outside its bounds.
    """

    plant: str = "mujoco"
    height: float = Spec.translation_range.value
    phase: float = 0.0
    period: float = 0.005
    delay: float = Spec.transport_delay.value
    stiffness: float = 6000.0
    damping: float = 80.0
    pulse: float = 220.0
    pulse_width: float = 0.003
    mass: float = Spec.moving_mass.value
    force_limit: float | None = None
    carry: bool = False
    quantize: float = 0.0
    duration: float = 0.4

    def __post_init__(self) -> None:
        if self.plant not in PLANTS:
            raise ParameterError(f"plant must be one of {', '.join(PLANTS)}, not {self.plant!r}")
        # wide bounds: what lies beyond is a slip of the keyboard, and overflows before it says anything
        bounds: dict[str, dict[str, float]] = {
            "height": {"above": 0.0, "below": _ESCAPE},
            "phase": {"at_least": 0.0, "below": 1.0},
            "period": {"at_least": 1e-6, "at_most": 1.0},
            "delay": {"at_least": 0.0, "at_most": 1.0},
            "stiffness": {"at_least": 0.0, "at_most": 1e8},
            "damping": {"at_least": 0.0, "at_most": 1e6},
            "pulse": {"at_least": 0.0, "at_most": 1e6},
            "pulse_width": {"at_least": 0.0, "at_most": 1.0},
            "mass": {"at_least": 1e-3, "at_most": 1e3},
            "force_limit": {"above": 0.0, "at_most": 1e6},
            "quantize": {"at_least": 0.0, "at_most": 1.0},
            "duration": {"above": 0.0, "at_most": 1000.0},
        }
        for name, allowed in bounds.items():
            value = getattr(self, name)
            if name != "force_limit" or value is not None:
                object.__setattr__(self, name, number(name, value, **allowed))
        if self.pulse > 0.0 and self.pulse_width == 0.0:
            raise ParameterError("pulse_width must be above 0 where there is a pulse, not 0.0")
        if not isinstance(self.carry, bool):
            raise ParameterError(f"carry must be True or False, not {self.carry!r}")
        if self.carry and self.force_limit is None:
            raise ParameterError("carry needs a force_limit: without one nothing is cut off a pulse")
        if self.duration / self.period > _MOST_TICKS:
            raise ParameterError(f"duration must be at most {_MOST_TICKS} periods, not {self.duration:g} s")

    @property
    def rest(self) -> float:
        """Where weight and wall balance [m]; NaN without stiffness."""
        return -self.mass * GRAVITY / self.stiffness if self.stiffness > 0.0 else math.nan


@dataclass(frozen=True, eq=False)
class DropResult:
    """One drop: its parameters, the motion, and the figures."""

    parameters: DropParameters
    trace: Trace
    summary: BounceSummary

    def series(self, step: float = 1e-3) -> tuple[Array, Array, Array, Array]:
        """Return time [s], z [m], velocity [m/s] and control force [N] on a grid of `step` [s], (M,) each."""
        number("step", step, above=0.0)
        end = float(self.trace.time[-1])
        time: Array = np.arange(math.floor(end / step + 1e-9) + 1, dtype=np.float64) * step
        pose, twist, wrench = self.trace.at(time)
        return time, pose[:, 2], twist[:, 2], wrench[:, 2]

    def as_json(self) -> dict[str, Any]:
        """Return parameters, time series every millisecond and summary, ready for JSON."""
        time, z, _, force = self.series()
        return {
            "parameters": asdict(self.parameters),
            "time": np.round(time, 9).tolist(),
            "z": z.tolist(),
            "force": force.tolist(),
            "summary": _plain(self.summary),
        }


@dataclass(frozen=True, eq=False)
class DropSweep:
    """The same drop at several phases: phases (N,) and each figure (N,)."""

    parameters: DropParameters
    phases: Array
    summary: BounceSummary

    def as_json(self) -> dict[str, Any]:
        """Return one summary a phase, the median, 5th and 95th percentile of each figure, and how many settled."""
        rows = [BounceSummary(*row) for row in zip(*self.summary, strict=True)]
        return {
            "settled": int(np.isfinite(self.summary.settling_time).sum()),
            "phases": [{"phase": float(phase), **_plain(row)} for phase, row in zip(self.phases, rows, strict=True)],
            "median": _plain(percentiles(self.summary, 50.0)),
            "percentile_5": _plain(percentiles(self.summary, 5.0)),
            "percentile_95": _plain(percentiles(self.summary, 95.0)),
        }


def run_drop(parameters: DropParameters) -> DropResult:
    """Drop the flotor once.

    Raises:
        DivergenceError: If the flotor leaves its range by a wide margin; its `partial` attribute is the
            DropResult up to there.
    """
    return _result(parameters, _trace(parameters, parameters.phase))


def sweep_drop(parameters: DropParameters, phases: int | Sequence[float]) -> DropSweep:
    """Drop the flotor at many phases: a batch on the exact plant, one after the other on MuJoCo.

    Args:
        parameters: The drop; its own phase is not used.
        phases: How many, evenly spread over a period, or the phases themselves.

    Raises:
        ParameterError: If there is no phase, or one is outside [0, 1).
        DivergenceError: If a flotor leaves its range by a wide margin.
    """
    chosen = _phases(phases)
    if parameters.plant == "exact":
        parts = [
            summarise_bounce(_trace(parameters, chosen[start : start + _TOGETHER]), parameters.rest)
            for start in range(0, chosen.size, _TOGETHER)
        ]
        figures = [np.concatenate(figure) for figure in zip(*parts, strict=True)]
    else:
        rows = [run_drop(replace(parameters, phase=float(phase))).summary for phase in chosen]
        figures = [np.array(figure) for figure in zip(*rows, strict=True)]
    return DropSweep(parameters, chosen, BounceSummary(*figures))


def sweep_hardness(parameters: DropParameters, phases: int | Sequence[float], window: float) -> Hardness:
    """Return how hard the first contact feels at many phases, (N,) each, on the exact plant.

    Args:
        parameters: The drop; its own phase and plant are not used.
        phases: As for `sweep_drop`.
        window: Length of the window that the force's rise is taken over [s].

    Raises:
        ParameterError: If a value is outside its bounds.
        DivergenceError: If a flotor leaves its range by a wide margin.
    """
    return perceived_hardness(_trace(replace(parameters, plant="exact"), _phases(phases)), window)


def analog_drop(parameters: DropParameters, time: Array) -> tuple[Array, Array, Array]:
    """Return z [m], velocity [m/s] and force [N] of the same drop on the ideal analog wall; see `analog_wall`."""
    return analog_wall(
        time,
        height=parameters.height,
        stiffness=parameters.stiffness,
        damping=parameters.damping,
        mass=parameters.mass,
    )


def _trace(parameters: DropParameters, phase: float | Array) -> Trace:
    """Run one drop, or one for each phase, and return the motion up to the end of its duration."""
    with _plant(parameters, phase) as plant, engine_warnings_silenced():
        try:
            run(plant, _controller(parameters), _ticks(parameters, float(np.min(phase))))
        except DivergenceError as error:
            trace = plant.trace()
            if not escaped_later(trace, parameters.duration):
                if np.ndim(phase) == 0:
                    error.partial = _result(parameters, trace)
                raise
        return plant.trace().until(parameters.duration)


def escaped_later(trace: Trace, duration: float) -> bool:
    """Return whether a run that diverged was still within bounds at the end asked for [s].

    A run goes on to the sample after its end, and escape is found at samples.
    """
    if float(trace.time[-1].min()) < duration:
        return False
    return bool((np.linalg.norm(trace.until(duration).pose[..., :3], axis=-1) < _ESCAPE).all())


def _phases(phases: int | Sequence[float]) -> Array:
    if isinstance(phases, Integral):
        if not 1 <= int(phases) <= _MOST_PHASES:
            raise ParameterError(f"phases must be at least 1 and at most {_MOST_PHASES}, not {phases}")
        return np.arange(int(phases)) / int(phases)
    chosen = numbers("phases", phases, at_least=0.0)
    if chosen.ndim != 1 or not chosen.size:
        raise ParameterError(f"phases must be a whole number or a list of phases, not {phases!r}")
    return chosen


def _ticks(parameters: DropParameters, phase: float) -> int:
    """Return how many samples to answer so that the run reaches its duration."""
    return max(math.ceil(parameters.duration / parameters.period - phase + 1e-9), 1)


def _plant(parameters: DropParameters, phase: float | Array) -> SampledPlant:
    limit = None if parameters.force_limit is None else [np.inf, np.inf, parameters.force_limit] + [np.inf] * 3
    sensor = Sensor(quantum=[0.0, 0.0, parameters.quantize] + [0.0] * 3) if parameters.quantize else None
    plant = ExactPlant if parameters.plant == "exact" else MuJoCoPlant
    return plant(
        Timing(period=parameters.period, delay=parameters.delay, phase=phase),
        mass=parameters.mass,
        pose=[0.0, 0.0, parameters.height, 0.0, 0.0, 0.0],
        wrench_limit=limit,
        sensor=sensor,
        escape=(_ESCAPE, 1.0),
        record=True,
    )


def _controller(parameters: DropParameters) -> Controller:
    return wall_controller(
        stiffness=parameters.stiffness,
        damping=parameters.damping,
        pulse=parameters.pulse,
        pulse_width=parameters.pulse_width,
        # a law that knows of no limit carries nothing over
        force_limit=parameters.force_limit if parameters.force_limit and parameters.carry else math.inf,
        period=parameters.period,
        delay=parameters.delay,
        mass=parameters.mass,
    )


def _result(parameters: DropParameters, trace: Trace) -> DropResult:
    return DropResult(parameters, trace, summarise_bounce(trace, parameters.rest))


def _plain(summary: BounceSummary) -> dict[str, float | None]:
    """Return plain numbers, None for what is not there."""
    return {name: float(value) if math.isfinite(value) else None for name, value in summary._asdict().items()}
