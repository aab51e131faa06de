"""Figures of a motion: bounce, perceived hardness, press; stock figures by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from maglev_mj.frames import Array
from maglev_mj.parameters import number
from maglev_mj.plants.trace import Trace, actuator_work
from maglev_mj.scenes.results import Figure, RunResult

_STEP = 1e-4  # of the grids on which a motion is evaluated [s]
_TAIL = 0.2  # last fraction of a press over which its figures are averaged


def figures_named(chosen: Sequence[Figure | str] | Mapping[str, Figure | str]) -> dict[str, Figure]:
    """Return figures by JSON key.

    Raises:
        TypeError: If a name is not that of a stock figure.
    """
    if not isinstance(chosen, Mapping):
        chosen = {figure if isinstance(figure, str) else figure.name: figure for figure in chosen}
    figures = {}
    for name, figure in chosen.items():
        if isinstance(figure, str) and figure not in STOCK:
            raise TypeError(f"figure must be one of {', '.join(STOCK)}, or decorated with @figure (got {figure!r})")
        figures[name] = STOCK[figure] if isinstance(figure, str) else figure
    return figures


class BounceSummary(NamedTuple):
    """Figures of a bounce on a wall, (...) each.

    Attributes:
        penetration: Largest depth inside the wall [m].
        rebound: Largest height above the wall after the first contact [m]; 0 without a rebound.
        peak_force: Largest actuator force on the axis, absolute [N].
        settling_time: Time from release after which the position stays at its equilibrium within 2 % of the distance
            from the start [s]; NaN if it does not, or without an equilibrium.
        final_z: Position at the end [m].
    """

    penetration: Array
    rebound: Array
    peak_force: Array
    settling_time: Array
    final_z: Array


def summarise_bounce(trace: Trace, rest: float, *, axis: int = 2, wall: float = 0.0) -> BounceSummary:
    """Return the bounce figures of a drop on a wall that fills x <= `wall`.

    Positions are extremes of the exact curve, not of its samples.

    Args:
        trace: The motion.
        rest: Equilibrium position of the flotor [m]; NaN if there is none.
        axis: Index into AXES.
        wall: Position of the wall [m].
    """
    line = trace.along(axis)
    turn_time, turn = (part[..., 0] for part in line.turning_points())
    times = np.concatenate([line.time, turn_time])
    positions = np.concatenate([line.pose[..., 0], turn])
    contact_start = np.where(positions <= wall, times, np.inf).min(axis=0)
    after = times >= contact_start
    highest = np.where(after, positions - wall, 0.0).max(axis=0)
    return BounceSummary(
        penetration=np.maximum(wall - positions.min(axis=0), 0.0),
        rebound=np.maximum(highest, 0.0),
        peak_force=np.abs(line.wrench[:-1, ..., 0]).max(axis=0),  # the last knot's force has not acted yet
        settling_time=_settling_time(line, rest),
        final_z=line.pose[-1, ..., 0],
    )


def _settling_time(line: Trace, rest: float, share: float = 0.02, step: float = _STEP) -> Array:
    """Return the last entry into the band around `rest` [s], interpolated on a grid of `step` [s]."""
    end = float(line.time[-1].min())
    grid = np.minimum(step * np.arange(int(np.ceil(end / step)) + 1), end)
    away = np.abs(line.positions(grid)[..., 0] - rest)
    band = share * np.abs(line.pose[0, ..., 0] - rest)
    outside = ~(away <= band)
    last = len(grid) - 1 - np.argmax(outside[::-1], axis=0)
    following = np.minimum(last + 1, len(grid) - 1)
    before, behind = (np.take_along_axis(away, index[None], axis=0)[0] for index in (last, following))
    fall = np.where(before > behind, before - behind, 1.0)
    entered = grid[last] + (grid[following] - grid[last]) * np.clip((before - band) / fall, 0.0, 1.0)
    settled = np.where(outside.any(axis=0), entered, 0.0)
    return np.where(outside[-1], np.nan, settled)


class Hardness(NamedTuple):
    """Perceived hardness of a tap [N/m], (...,) each.

    Attributes:
        rate: Rate-hardness: rate of the force over the first window after contact, divided by the impact speed.
        extended: The same for the fastest rise over any window that overlaps the first contact.
    """

    rate: Array
    extended: Array


def perceived_hardness(trace: Trace, window: float, *, axis: int = 2, wall: float = 0.0) -> Hardness:
    """Return the perceived hardness of the first contact with a wall that fills x <= `wall`.

    A force constant between samples rises in steps, so its rate is averaged over a window:
    (f(t + window) - f(t)) / window.

    Args:
        trace: The motion; NaN for a device without contact.
        window: Duration of the window [s].
        axis: Index into AXES.
        wall: Position of the wall [m].

    Raises:
        ParameterError: If the window is not above 0, or longer than the trace.

    Source: Lawrence, Pao, Dougherty, Salada & Pavlou 2000; Han & Choi 2010. Definitions not checked against the
    originals; the window is this project's.
    """
    width = number("window", window, above=0.0)
    line = trace.along(axis)
    end = float(line.time[-1].min())
    number("window", window, below=end)
    grid = np.arange(int(np.floor(end / _STEP)) + 1) * _STEP
    pose, twist, wrench = (part[..., 0] for part in line.at(grid))
    inside = pose <= wall
    touched = inside.any(axis=0)
    contact = np.maximum(np.argmax(inside, axis=0) - 1, 0)  # before the force begins to rise
    away = ~inside & (np.arange(len(grid)).reshape((-1,) + (1,) * (inside.ndim - 1)) > contact)
    leaves = np.where(away.any(axis=0), np.argmax(away, axis=0), len(grid) - 1)
    shift = max(round(width / _STEP), 1)
    rise = np.zeros_like(wrench)
    rise[:-shift] = (wrench[shift:] - wrench[:-shift]) / width
    index = np.arange(len(grid)).reshape((-1,) + (1,) * (rise.ndim - 1))
    during = (index >= contact - shift) & (index <= leaves)
    speed = np.abs(np.take_along_axis(twist, contact[None], axis=0)[0])
    first = np.take_along_axis(rise, contact[None], axis=0)[0]
    most = np.where(during, rise, -np.inf).max(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return Hardness(*(np.where(touched & (speed > 0.0), part / speed, np.nan) for part in (first, most)))


class PressSummary(NamedTuple):
    """Figures of the hits, (..., hits) each, and of the press and the energy, (...,) each.

    A hit lasts from the start of its stroke to that of the next one, bounces included. Figures of a hit or press after
    the end of the run are NaN.

    Attributes:
        penetration: Largest depth inside the wall [m].
        approach_speed: Speed at the first entry into the wall [m/s]; NaN without one.
        peak_force: Largest actuator force along z, absolute [N].
        contact_time: Time inside the wall [s].
        contacts: Number of entries into the wall: 1 for a clean hit, more with bounces.
        final_force: Mean actuator force over the last 20 % of the press [N].
        final_depth: Mean depth over the same time [m].
        force_ripple: Peak-to-peak force over the same time [N].
        ripple: Peak-to-peak position over the same time [m].
        absorbed: Energy absorbed by the wall during the run, stored in its spring included [J]; negative if the wall
            generated energy.
    """

    penetration: Array
    approach_speed: Array
    peak_force: Array
    contact_time: Array
    contacts: Array
    final_force: Array
    final_depth: Array
    force_ripple: Array
    ripple: Array
    absorbed: Array


HIT_FIGURES = PressSummary._fields[:5]
"""Names of the figures of one hit."""


class _Motion(NamedTuple):
    """Motion of one run along z on a grid of the knots, a fine spacing, and the bounds of all windows."""

    time: Array
    position: Array
    speed: Array
    force: Array
    turn_time: Array
    turn: Array


def summarise_press(trace: Trace, strokes: Sequence[float], settled: float, end: float) -> PressSummary:
    """Return the figures of one run on a wall that fills z <= 0.

    Positions are extremes of the recorded curve, not of its samples, and speeds are those at the crossing.

    Args:
        trace: The motion of one device.
        strokes: Start times of the hits and of the press [s].
        settled: Time at which the hand reaches its pressing position [s].
        end: Planned end of the run [s].
    """
    tail = end - _TAIL * (end - settled)
    motion = _refined(trace, [*strokes, tail])
    hits = [_hit(motion, start, finish) for start, finish in pairwise(strokes)]
    press = _last_figures(motion, tail) if motion.time[-1] >= end - 1e-9 else (np.nan,) * 4
    absorbed = -actuator_work(trace)[..., 2].sum(axis=0)
    figures = [*np.array(hits).T, *(np.array(figure) for figure in press), np.asarray(absorbed)]
    return PressSummary(*figures)


def _refined(trace: Trace, bounds: Sequence[float]) -> _Motion:
    line = trace.along(2)
    first, last = float(line.time[0]), float(line.time[-1])
    inside = [bound for bound in bounds if first <= bound <= last]
    time = np.unique(np.concatenate([line.time, np.arange(first, last, _STEP), inside]))
    fine = Trace(time, *line.at(time))
    turn_time, turn = fine.turning_points()
    return _Motion(time, fine.pose[:, 0], fine.twist[:, 0], fine.wrench[:-1, 0], turn_time[:, 0], turn[:, 0])


def _hit(motion: _Motion, start: float, end: float) -> tuple[float, ...]:
    """Return one hit's figures in the order of `HIT_FIGURES`."""
    if start >= motion.time[-1]:
        return (np.nan,) * len(HIT_FIGURES)
    position, speed, width = motion.position, motion.speed, np.diff(motion.time)
    interval = (motion.time[:-1] >= start) & (motion.time[:-1] < end)
    lowest = np.min(motion.turn[interval], initial=float(position[:-1][interval].min()))
    before, after = position[:-1], position[1:]
    entries = np.flatnonzero(interval & (before > 0.0) & (after <= 0.0))
    approach = np.nan
    if entries.size:
        # v² = v0² - 2 a z0, exact under a constant force
        first = entries[0]
        acceleration = (speed[first + 1] - speed[first]) / width[first]
        approach = np.sqrt(max(speed[first] ** 2 - 2.0 * acceleration * before[first], 0.0))
    # fraction of each interval inside the wall, linear at the edge
    behind, depths = np.maximum(-before, 0.0) + np.maximum(-after, 0.0), np.abs(before) + np.abs(after)
    inside = np.divide(behind, depths, out=np.ones_like(depths), where=depths > 0.0)
    peak = np.abs(motion.force[interval]).max()
    return (
        max(-float(lowest), 0.0),
        float(approach),
        float(peak),
        float((inside * width)[interval].sum()),
        float(entries.size),
    )


def _last_figures(motion: _Motion, start: float) -> tuple[float, ...]:
    """Return force and depth of the press, and their ripples."""
    interval = motion.time[:-1] >= start
    width, force = np.diff(motion.time)[interval], motion.force[interval]
    middle = 0.5 * (motion.position[:-1] + motion.position[1:])[interval]
    positions = np.concatenate([motion.position[motion.time >= start], motion.turn[interval]])
    duration = width.sum()
    return (
        float((force * width).sum() / duration),
        -float((middle * width).sum() / duration),
        float(np.ptp(force)),
        float(np.ptp(positions)),
    )


def _bounce(result: RunResult) -> BounceSummary:
    """Return the bounce figures; the wall fills the shown axis below 0."""
    return summarise_bounce(result.trace, getattr(result.scene, "rest", np.nan), axis=result.scene.axis_index)


def _press(result: RunResult) -> PressSummary:
    scene: Any = result.scene
    return summarise_press(result.trace, scene.strokes(result.phase), scene.path(result.phase).end, scene.end)


def _part(summarise: Callable[[RunResult], Any], name: str) -> Callable[[RunResult], Any]:
    """Return the function of one field of a summary, which is computed once per run."""
    return lambda result: getattr(result.once(summarise.__name__, summarise), name)


def changes(result: RunResult) -> list[int]:
    """Return the indices of samples at which the friction state changes."""
    stuck = result.samples["stuck"][:, 0]
    indices: list[int] = (np.flatnonzero(stuck[1:] != stuck[:-1]) + 1).tolist()
    return indices


def _peak_speed(result: RunResult) -> Any:
    # the speed is linear between knots
    return np.abs(result.line.twist[..., 0]).max(axis=0)


def _stick_time(result: RunResult) -> float:
    sticks = [result.sample_time[k] for k in changes(result) if result.samples["stuck"][k, 0]]
    return float(sticks[-1]) if sticks else np.nan


def _ripple(result: RunResult) -> Any:
    end = float(result.line.time[-1].min())
    return np.ptp(result.line.positions(np.linspace(max(end - 0.05, 0.0), end, 501))[..., 0], axis=0)


def _hardness(result: RunResult) -> Any:
    return perceived_hardness(result.trace, 0.005, axis=result.scene.axis_index).extended


def press_name(name: str) -> str:
    """Return the name of a field of `PressSummary` in `STOCK`."""
    return f"hit_{name}" if name in HIT_FIGURES else name if name == "absorbed" else f"press_{name}"


STOCK: Mapping[str, Figure] = {
    figure.name: replace(figure, along=True)
    for figure in (
        Figure(
            "penetration",
            _part(_bounce, "penetration"),
            "mm",
            "largest depth inside the wall",
            1e3,
            nan_is_largest=True,
        ),
        Figure("rebound", _part(_bounce, "rebound"), "mm", "height after the first contact", 1e3, nan_is_largest=True),
        Figure("peak_force", _part(_bounce, "peak_force"), "N", "largest actuator force", nan_is_largest=True),
        Figure(
            "settling_time",
            _part(_bounce, "settling_time"),
            "ms",
            "time to within 2 % of rest",
            1e3,
            nan_is_largest=True,
            missing="does not settle",
        ),
        Figure("final_z", _part(_bounce, "final_z"), "mm", "height at the end", 1e3, nan_is_largest=True),
        Figure("hardness", _hardness, "kN/m", "force rate over 5 ms / impact speed", 1e-3),
        Figure("peak_speed", _peak_speed, "mm/s", "peak speed", 1e3),
        Figure("stick_time", _stick_time, "ms", "time of the last stick", 1e3, batched=False, missing="never sticks"),
        Figure(
            "stick_position",
            lambda result: float(result.samples["stick_position"][-1, 0]),
            "mm",
            "stick position at the end",
            1e3,
            batched=False,
            missing="never sticks",
        ),
        Figure("final_position", lambda result: result.line.pose[-1, ..., 0], "mm", "position at the end", 1e3),
        Figure("transitions", lambda result: len(changes(result)), "", "changes of the friction state", batched=False),
        Figure("ripple", _ripple, "µm", "peak-to-peak position, last 50 ms", 1e6),
        *(
            Figure(press_name(name), _part(_press, name), unit, help, scale, batched=False)
            for name, unit, help, scale in (
                ("penetration", "mm", "largest depth of each hit", 1e3),
                ("approach_speed", "mm/s", "entry speed of each hit", 1e3),
                ("peak_force", "N", "peak force of each hit", 1.0),
                ("contact_time", "ms", "contact time of each hit", 1e3),
                ("contacts", "", "entries of each hit", 1.0),
                ("final_force", "N", "mean force, last 20 % of the press", 1.0),
                ("final_depth", "mm", "mean depth, last 20 % of the press", 1e3),
                ("force_ripple", "mN", "peak-to-peak force, same window", 1e3),
                ("ripple", "µm", "peak-to-peak position, same window", 1e6),
                ("absorbed", "mJ", "energy absorbed by the wall", 1e3),
            )
        ),
    )
}
"""Predefined figures by name."""
