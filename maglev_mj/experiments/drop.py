"""The flotor dropped on a stiff wall: figures 3 and 4 of Salcudean and Vlaar (1997)."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from numbers import Integral
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.controller import Controller
from maglev_mj.errors import DivergenceError, ParameterError
from maglev_mj.experiments.drop_parameters import DropParameters
from maglev_mj.experiments.wall_controller import wall_controller
from maglev_mj.frames import Array
from maglev_mj.hand import HandForce
from maglev_mj.loop import run
from maglev_mj.metrics import BounceSummary, percentiles, summarise_bounce
from maglev_mj.parameters import number, numbers
from maglev_mj.plants import SampledPlant, Sensor, Timing, engine_warnings_silenced
from maglev_mj.scenes.choices import PLANTS, PlantMaker
from maglev_mj.spec import ESCAPE
from maglev_mj.theory.analog_wall import analog_wall
from maglev_mj.trace import Trace

__all__ = [
    "DropParameters",
    "DropResult",
    "DropSweep",
    "analog_drop",
    "drop_parts",
    "drop_variants",
    "run_drop",
    "share_less_deep",
    "sweep_drop",
    "trace_phases",
]

_MOST_PHASES = 10_000
_TOGETHER = 64


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
    """The same drop at several phases: phases (N,), each figure (N,), and the furthest on each axis (N, 6)."""

    parameters: DropParameters
    phases: Array
    summary: BounceSummary
    furthest: Array

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


def sweep_drop(parameters: DropParameters, phases: int | ArrayLike) -> DropSweep:
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
        batches = (chosen[start : start + _TOGETHER] for start in range(0, chosen.size, _TOGETHER))
        traces = (trace_phases(parameters, batch) for batch in batches)
    else:
        traces = (run_drop(replace(parameters, phase=float(phase))).trace for phase in chosen)
    # a trace is large: only its figures are kept
    found = ((summarise_bounce(trace, parameters.rest), trace.furthest()) for trace in traces)
    summaries, furthest = zip(*found, strict=True)
    figures = BounceSummary(*(np.hstack(figure) for figure in zip(*summaries, strict=True)))
    return DropSweep(parameters, chosen, figures, np.vstack(furthest))


def trace_phases(parameters: DropParameters, phases: int | ArrayLike) -> Trace:
    """Return the motion at many phases (K, N, ...) on the exact plant.

    Args:
        parameters: The drop; its own phase and plant are not used.
        phases: As for `sweep_drop`.

    Raises:
        ParameterError: If there is no phase, or one is outside [0, 1).
        DivergenceError: If a flotor leaves its range by a wide margin.
    """
    return _trace(replace(parameters, plant="exact"), _phases(phases))


def drop_variants(parameters: DropParameters) -> dict[str, DropParameters]:
    """Return the drops to compare, by label.

    First the drop itself, last the same without its pulse. The paper's equation (9) adds its pulse of 220 N s/m to the
    damping, but its figure 3 fits 220 with the damping included: a drop with this pulse has that reading in between.

    Source: Salcudean & Vlaar 1997, eq. (9) and figure 3.
    """
    plain = {"no pulse": replace(parameters, pulse=0.0)}
    if parameters.pulse == 0.0:
        return plain
    variants = {f"pulse {parameters.pulse:g} further": parameters}
    if parameters.pulse == DropParameters.pulse and 0.0 < parameters.damping < parameters.pulse:
        in_all = replace(parameters, pulse=parameters.pulse - parameters.damping)
        variants[f"pulse {parameters.pulse:g} in all"] = in_all
    return variants | plain


def share_less_deep(drop: BounceSummary, phases: BounceSummary) -> float:
    """Return the share of phases with less penetration than a drop."""
    return float(np.mean(phases.penetration < drop.penetration - 1e-9))  # the two plants round differently


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
    return bool((np.linalg.norm(trace.until(duration).pose[..., :3], axis=-1) < ESCAPE).all())


def _phases(phases: int | ArrayLike) -> Array:
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


def drop_parts(
    parameters: DropParameters, hand_force: HandForce | None = None, *, make: PlantMaker | None = None
) -> tuple[SampledPlant, Controller, int]:
    """Return what a drop is made of: the plant, in a hand if there is one, the controller, and how many samples.

    Args:
        parameters: The drop.
        hand_force: What a hand exerts.
        make: Makes the plant; the parameters' by default.
    """
    plant = _plant(parameters, parameters.phase, hand_force, make)
    return plant, _controller(parameters), _ticks(parameters, parameters.phase)


def _plant(
    parameters: DropParameters,
    phase: float | Array,
    hand_force: HandForce | None = None,
    make: PlantMaker | None = None,
) -> SampledPlant:
    limit = None if parameters.force_limit is None else [np.inf, np.inf, parameters.force_limit] + [np.inf] * 3
    sensor = Sensor(quantum=[0.0, 0.0, parameters.quantize] + [0.0] * 3) if parameters.quantize else None
    return (make or PLANTS[parameters.plant])(
        Timing(period=parameters.period, delay=parameters.delay, phase=phase),
        mass=parameters.mass,
        pose=[0.0, 0.0, parameters.height, 0.0, 0.0, 0.0],
        wrench_limit=limit,
        sensor=sensor,
        escape=(ESCAPE, 1.0),
        record=True,
        hand_force=hand_force,
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
