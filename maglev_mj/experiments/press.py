"""A wall hit several times by a scripted hand, then pressed: figure 6 of Salcudean and Vlaar (1997)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from maglev_mj.controller import Controller
from maglev_mj.errors import DivergenceError, ParameterError
from maglev_mj.experiments.drop import escaped_later
from maglev_mj.experiments.press_parameters import PressParameters
from maglev_mj.experiments.wall_controller import wall_controller
from maglev_mj.frames import AXES, Array, Component
from maglev_mj.hand import GuidedHand, HandForce
from maglev_mj.loop import run
from maglev_mj.parameters import number
from maglev_mj.plants import SampledPlant, Sensor, Timing, engine_warnings_silenced
from maglev_mj.scenes.choices import PLANTS, PlantMaker
from maglev_mj.scenes.press_figures import PressSummary, press_percentiles, summarise_press
from maglev_mj.spec import ESCAPE
from maglev_mj.trace import Trace

__all__ = ["PressParameters", "PressResult", "PressSweep", "run_press", "sweep_press"]

_MOST_PHASES = 10_000
_TOGETHER = 64


@dataclass(frozen=True, eq=False)
class PressResult:
    """One run: its parameters, the motion, and the figures."""

    parameters: PressParameters
    trace: Trace
    summary: PressSummary

    def series(self, step: float = 1e-3) -> dict[str, Array]:
        """Return time [s], z [m], velocity [m/s], force of the actuators [N] and the point the hand pulls to [m].

        Each on a grid of `step` [s], (M,): "time", "z", "velocity", "force", "target".
        """
        number("step", step, above=0.0)
        end = float(self.trace.time[-1])
        time: Array = np.arange(math.floor(end / step + 1e-9) + 1, dtype=np.float64) * step
        pose, twist, wrench = self.trace.at(time)
        path = self.parameters.path
        target = np.array([path.at(instant)[2] for instant in time.tolist()])
        return {"time": time, "z": pose[:, 2], "velocity": twist[:, 2], "force": wrench[:, 2], "target": target}

    def as_json(self) -> dict[str, Any]:
        """Return parameters, time series every millisecond and summary, ready for JSON."""
        series = self.series()
        series["time"] = np.round(series["time"], 9)
        return {
            "parameters": asdict(self.parameters),
            **{name: series[name].tolist() for name in ("time", "z", "force", "target")},
            "summary": _plain(self.summary),
        }


@dataclass(frozen=True, eq=False)
class PressSweep:
    """The same run at several phases: phases (N,), figures of the hits (N, hits) and of the press (N,).

    `furthest` is the greatest distance from the centre on each axis [m, rad], (N, 6).
    """

    parameters: PressParameters
    phases: Array
    summary: PressSummary
    furthest: Array

    def as_json(self) -> dict[str, Any]:
        """Return one summary a phase, and the median, 5th and 95th percentile of each figure, each hit for itself."""
        rows = [PressSummary(*row) for row in zip(*self.summary, strict=True)]
        return {
            "phases": [{"phase": float(phase), **_plain(row)} for phase, row in zip(self.phases, rows, strict=True)],
            "median": _plain(press_percentiles(self.summary, 50.0)),
            "percentile_5": _plain(press_percentiles(self.summary, 5.0)),
            "percentile_95": _plain(press_percentiles(self.summary, 95.0)),
        }


def run_press(parameters: PressParameters) -> PressResult:
    """Hit the wall and press against it once.

    Raises:
        DivergenceError: If the flotor leaves its range by a wide margin; its `partial` attribute is the
            PressResult up to there.
    """
    return _result(parameters, _trace([parameters], together=False))


def sweep_press(
    parameters: PressParameters, phases: int, *, progress: Callable[[int, int], object] | None = None
) -> PressSweep:
    """Hit and press at many phases: a batch on the exact plant, one after the other on MuJoCo.

    Args:
        parameters: The run; its own phase is not used.
        phases: How many, evenly spread over a period.
        progress: Called with how many phases are done, and with all of them.

    Raises:
        ParameterError: If there is no phase, or too many.
        DivergenceError: If a flotor leaves its range by a wide margin.
    """
    if number("phases", phases, at_least=1, at_most=_MOST_PHASES) != int(phases):
        raise ParameterError(f"phases must be a whole number, not {phases:g}")
    chosen = np.arange(int(phases)) / int(phases)
    runs = [replace(parameters, phase=float(phase)) for phase in chosen]
    rows: list[PressSummary] = []
    furthest: list[Array] = []
    while len(rows) < len(runs):
        if parameters.plant == "exact":
            some = runs[len(rows) : len(rows) + _TOGETHER]
            trace = _trace(some, together=True)
            results = [_result(one, _of_device(trace, place)) for place, one in enumerate(some)]
        else:
            results = [run_press(runs[len(rows)])]
        rows += [one.summary for one in results]
        furthest += [one.trace.furthest() for one in results]
        if progress is not None:
            progress(len(rows), len(runs))
    figures = PressSummary(*(np.array(figure) for figure in zip(*rows, strict=True)))
    return PressSweep(parameters, chosen, figures, np.array(furthest))


class SideBySide:
    """Hands that differ in their paths alone, one for each device of a batch."""

    def __init__(self, hands: Sequence[GuidedHand]) -> None:
        self._hands = hands

    def __call__(self, tick: int, time: Component, state: Any) -> list[Array]:
        """See `HandForce`."""
        rows = [hand(tick, time, state) for hand in self._hands]
        return [np.array(part) for part in zip(*rows, strict=True)]


def _trace(runs: Sequence[PressParameters], *, together: bool) -> Trace:
    """Run one, or a batch of runs that differ in phase alone; return the motion up to the end of its duration."""
    p = runs[0]
    with _plant(runs, together=together) as plant, engine_warnings_silenced():
        try:
            run(plant, _controller(p), _ticks(p))
        except DivergenceError as error:
            trace = plant.trace()
            if not escaped_later(trace, p.end):
                if not together:
                    error.partial = _result(p, trace)
                raise
        return plant.trace().until(p.end)


def press_parts(
    parameters: PressParameters, hand_force: HandForce | None = None, *, make: PlantMaker | None = None
) -> tuple[SampledPlant, Controller, int]:
    """Return what a run is made of: the plant, in another hand if one is given, the controller, how many samples.

    Args:
        parameters: The run.
        hand_force: What another hand exerts.
        make: Makes the plant; the parameters' by default.
    """
    plant = _plant([parameters], together=False, hand_force=hand_force, make=make)
    return plant, _controller(parameters), _ticks(parameters)


def _controller(parameters: PressParameters) -> Controller:
    p = parameters
    return wall_controller(
        stiffness=p.stiffness,
        damping=p.damping,
        pulse=p.pulse,
        pulse_width=p.pulse_width,
        pulse_gate=p.pulse_gate,
        period=p.period,
        delay=p.delay,
        mass=p.mass,
    )


def _ticks(parameters: PressParameters) -> int:
    return math.ceil(parameters.end / parameters.period + 1e-9)


def _plant(
    runs: Sequence[PressParameters],
    *,
    together: bool,
    hand_force: HandForce | None = None,
    make: PlantMaker | None = None,
) -> SampledPlant:
    p, hand = runs[0], runs[0].impedance
    hands = [GuidedHand(hand=hand, path=one.path) for one in runs]
    force: HandForce = hand_force or (SideBySide(hands) if together else hands[0])
    up = [0.0, 0.0, p.height, 0.0, 0.0, 0.0]
    return (make or PLANTS[p.plant])(
        Timing(period=p.period, delay=p.delay),
        mass=p.mass,
        pose=[up] * len(runs) if together else up,
        gravity=0.0,
        hand=hand,
        hand_force=force,
        wrench_limit=None if p.force_limit is None else [np.inf, np.inf, p.force_limit] + [np.inf] * 3,
        sensor=Sensor(quantum=np.eye(len(AXES))[2] * p.quantize) if p.quantize else None,
        escape=(ESCAPE, 1.0),
        record=True,
        longest_step=p.longest_step,
    )


def _of_device(trace: Trace, place: int) -> Trace:
    return Trace(*(part[:, place] for part in (trace.time, trace.pose, trace.twist, trace.wrench)))


def _result(parameters: PressParameters, trace: Trace) -> PressResult:
    p = parameters
    return PressResult(p, trace, summarise_press(trace, p.strokes, p.path.end, p.end))


def _plain(summary: PressSummary) -> dict[str, Any]:
    """Return plain numbers, a list for the hits, None for what is not there."""
    plain: dict[str, Any] = {}
    for name, figure in summary._asdict().items():
        values = np.array(figure, dtype=object)
        values[~np.isfinite(figure)] = None
        plain[name] = values.tolist()
    return plain
