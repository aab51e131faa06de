"""Figures of a motion: bounces, perceived hardness, presses; and the stock of them by name."""

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
_TAIL = 0.2  # share of a press over which its last figures are taken


def figures_named(chosen: Sequence[Figure | str] | Mapping[str, Figure | str]) -> dict[str, Figure]:
    """Return figures by their JSON names.

    Raises:
        TypeError: If a name is not that of a stock figure.
    """
    if not isinstance(chosen, Mapping):
        chosen = {one if isinstance(one, str) else one.name: one for one in chosen}
    figures = {}
    for name, one in chosen.items():
        if isinstance(one, str) and one not in STOCK:
            raise TypeError(f"figure must be one of {', '.join(STOCK)}, or made by @figure, not {one!r}")
        figures[name] = STOCK[one] if isinstance(one, str) else one
    return figures


class BounceSummary(NamedTuple):
    """Figures of a bounce on a wall, (...) each.

    Attributes:
        penetration: Largest depth behind the wall [m].
        rebound: Largest height above the wall after the first contact [m], 0 if it never leaves.
        peak_force: Largest force of the actuators on the axis, either sign [N].
        settling_time: Time from release after which the position stays within 2 % of the way from start to
            rest around the rest [s]; NaN if it does not, or if there is no rest.
        final_z: Position at the end [m].
    """

    penetration: Array
    rebound: Array
    peak_force: Array
    settling_time: Array
    final_z: Array


def summarise_bounce(trace: Trace, rest: float, *, axis: int = 2, wall: float = 0.0) -> BounceSummary:
    """Return the bounce figures of a drop.

    The wall fills x <= `wall`.

    Positions are extremes of the exact curve, not of samples of it.

    Args:
        trace: The motion.
        rest: Rest position of the flotor [m]; NaN if there is none.
        axis: Index into AXES.
        wall: Position of the wall [m].
    """
    line = trace.along(axis)
    turn_time, turn = (part[..., 0] for part in line.turning_points())
    times = np.concatenate([line.time, turn_time])
    places = np.concatenate([line.pose[..., 0], turn])
    touched = np.where(places <= wall, times, np.inf).min(axis=0)
    after = times >= touched
    highest = np.where(after, places - wall, 0.0).max(axis=0)
    return BounceSummary(
        penetration=np.maximum(wall - places.min(axis=0), 0.0),
        rebound=np.maximum(highest, 0.0),
        peak_force=np.abs(line.wrench[:-1, ..., 0]).max(axis=0),  # the last knot's force has not acted yet
        settling_time=_settling_time(line, rest),
        final_z=line.pose[-1, ..., 0],
    )


def _settling_time(line: Trace, rest: float, share: float = 0.02, step: float = _STEP) -> Array:
    """Return the last entry into the band around `rest` [s].

    It is interpolated on a grid of `step` [s].
    """
    end = float(line.time[-1].min())
    grid = np.minimum(step * np.arange(int(np.ceil(end / step)) + 1), end)
    away = np.abs(line.at(grid)[0][..., 0] - rest)
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
    """Return the perceived hardness of the first contact.

    The wall fills x <= `wall`.

    A force held between samples rises in steps, so its rate is that of its mean over a window:
    (f(t + window) - f(t)) / window.

    Args:
        trace: The motion; a device that does not touch the wall gives NaN.
        window: Length of the window [s].
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
    place = np.arange(len(grid)).reshape((-1,) + (1,) * (rise.ndim - 1))
    during = (place >= contact - shift) & (place <= leaves)
    speed = np.abs(np.take_along_axis(twist, contact[None], axis=0)[0])
    first = np.take_along_axis(rise, contact[None], axis=0)[0]
    most = np.where(during, rise, -np.inf).max(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return Hardness(*(np.where(touched & (speed > 0.0), part / speed, np.nan) for part in (first, most)))


class PressSummary(NamedTuple):
    """Figures of the hits and the press.

    Each figure of the hits is (..., hits), each of the press and the energy (...,).

    A hit lasts from the beginning of its stroke to that of the next one, bounces included. Figures of a hit or press
    that the run does not reach are NaN.

    Attributes:
        penetration: Greatest depth behind the wall [m].
        approach_speed: Speed at the first entry into the wall [m/s]; NaN if there is none.
        peak_force: Largest force of the actuators along z, either sign [N].
        contact_time: Time of the flotor behind the wall [s].
        contacts: Number of entries into the wall: 1 for a clean hit, more with bounces.
        final_force: Mean force of the actuators over the last 20 % of the press [N].
        final_depth: Mean depth over the same time [m].
        force_ripple: Force over the same time, peak to peak [N].
        ripple: Position over the same time, peak to peak [m].
        absorbed: Energy absorbed by the wall over the whole run [J]; below 0 the wall has generated energy. Energy
            stored in the wall's spring at the end is included.
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
"""Names of the figures of a single hit."""


class _Motion(NamedTuple):
    """Motion of one run along z on a refined grid.

    The grid has the knots, a fine spacing, and the bounds of all windows.
    """

    time: Array
    place: Array
    speed: Array
    force: Array
    turn_time: Array
    turn: Array


def summarise_press(trace: Trace, strokes: Sequence[float], settled: float, end: float) -> PressSummary:
    """Summarise one run on a wall filling z <= 0.

    Positions are extremes of the recorded curve, not of samples of it, and speeds those at the crossing itself.

    Args:
        trace: The motion of one device.
        strokes: Start times of the strokes [s], in order, that of the press last.
        settled: Time of the hand's arrival at its pressing position [s].
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
    place, speed, width = motion.place, motion.speed, np.diff(motion.time)
    piece = (motion.time[:-1] >= start) & (motion.time[:-1] < end)
    lowest = np.min(motion.turn[piece], initial=float(place[:-1][piece].min()))
    before, after = place[:-1], place[1:]
    entries = np.flatnonzero(piece & (before > 0.0) & (after <= 0.0))
    approach = np.nan
    if entries.size:
        # v² = v0² - 2 a z0, exact under a constant force
        first = entries[0]
        acceleration = (speed[first + 1] - speed[first]) / width[first]
        approach = np.sqrt(max(speed[first] ** 2 - 2.0 * acceleration * before[first], 0.0))
    # the share of each piece behind the wall, the edge crossed in a straight line
    behind, whole = np.maximum(-before, 0.0) + np.maximum(-after, 0.0), np.abs(before) + np.abs(after)
    inside = np.divide(behind, whole, out=np.ones_like(whole), where=whole > 0.0)
    peak = np.abs(motion.force[piece]).max()
    return (
        max(-float(lowest), 0.0),
        float(approach),
        float(peak),
        float((inside * width)[piece].sum()),
        float(entries.size),
    )


def _last_figures(motion: _Motion, start: float) -> tuple[float, ...]:
    """Return the press figures: force, depth, and their ripples."""
    piece = motion.time[:-1] >= start
    width, force = np.diff(motion.time)[piece], motion.force[piece]
    middle = 0.5 * (motion.place[:-1] + motion.place[1:])[piece]
    places = np.concatenate([motion.place[motion.time >= start], motion.turn[piece]])
    whole = width.sum()
    return (
        float((force * width).sum() / whole),
        -float((middle * width).sum() / whole),
        float(np.ptp(force)),
        float(np.ptp(places)),
    )


def _bounce(result: RunResult) -> BounceSummary:
    """Return the bounce figures; the wall fills the shown axis below 0."""
    return summarise_bounce(result.trace, getattr(result.scene, "rest", np.nan), axis=result.scene.axis_index)


def _press(result: RunResult) -> PressSummary:
    scene: Any = result.scene
    return summarise_press(result.trace, scene.strokes(result.phase), scene.path(result.phase).end, scene.end)


def _part(summarise: Callable[[RunResult], Any], name: str) -> Callable[[RunResult], Any]:
    """Return the function of one figure of a summary, which is made once a run."""
    return lambda result: getattr(result.once(summarise.__name__, summarise), name)


def changes(result: RunResult) -> list[int]:
    """Return the samples of changes in the friction state."""
    stuck = result.samples["stuck"][:, 0]
    indices: list[int] = (np.flatnonzero(stuck[1:] != stuck[:-1]) + 1).tolist()
    return indices


def _peak_speed(result: RunResult) -> Any:
    # greatest at a knot: the speed is linear between them
    return np.abs(result.line.twist[..., 0]).max(axis=0)


def _stick_time(result: RunResult) -> float:
    sticks = [result.sample_time[k] for k in changes(result) if result.samples["stuck"][k, 0]]
    return float(sticks[-1]) if sticks else np.nan


def _ripple(result: RunResult) -> Any:
    end = float(result.line.time[-1].min())
    return np.ptp(result.line.at(np.linspace(max(end - 0.05, 0.0), end, 501))[0][..., 0], axis=0)


def _hardness(result: RunResult) -> Any:
    return perceived_hardness(result.trace, 0.005, axis=result.scene.axis_index).extended


def press_name(name: str) -> str:
    """Return the name in `STOCK` of a field of `PressSummary`."""
    return f"hit_{name}" if name in HIT_FIGURES else name if name == "absorbed" else f"press_{name}"


STOCK: Mapping[str, Figure] = {
    one.name: replace(one, along=True)
    for one in (
        Figure("penetration", _part(_bounce, "penetration"), "mm", "greatest depth behind the wall", 1e3, late=True),
        Figure("rebound", _part(_bounce, "rebound"), "mm", "greatest height after the first contact", 1e3, late=True),
        Figure("peak_force", _part(_bounce, "peak_force"), "N", "largest force of the actuators", late=True),
        Figure("settling_time", _part(_bounce, "settling_time"), "ms", "time until within 2 % of rest", 1e3, late=True),
        Figure("final_z", _part(_bounce, "final_z"), "mm", "height at the end", 1e3, late=True),
        Figure("hardness", _hardness, "kN/m", "fastest rise of the force over 5 ms, by speed of impact", 1e-3),
        Figure("peak_speed", _peak_speed, "mm/s", "greatest speed", 1e3),
        Figure("stick_time", _stick_time, "ms", "when it last stuck", 1e3, batched=False),
        Figure(
            "stick_position",
            lambda result: float(result.samples["stick_position"][-1, 0]),
            "mm",
            "stick position at the end",
            1e3,
            batched=False,
        ),
        Figure("final_position", lambda result: result.line.pose[-1, ..., 0], "mm", "position at the end", 1e3),
        Figure("transitions", lambda result: len(changes(result)), "", "changes of state", batched=False),
        Figure("ripple", _ripple, "µm", "position over the last 50 ms, peak to peak", 1e6),
        *(
            Figure(press_name(name), _part(_press, name), unit, help, scale, batched=False)
            for name, unit, help, scale in (
                ("penetration", "mm", "greatest depth of each hit", 1e3),
                ("approach_speed", "mm/s", "speed at which each hit enters", 1e3),
                ("peak_force", "N", "largest force of each hit", 1.0),
                ("contact_time", "ms", "time of each hit behind the wall", 1e3),
                ("contacts", "", "entries of each hit", 1.0),
                ("final_force", "N", "mean force, last 20 % of the press", 1.0),
                ("final_depth", "mm", "mean depth over the same time", 1e3),
                ("force_ripple", "mN", "its force, peak to peak", 1e3),
                ("ripple", "µm", "its position, peak to peak", 1e6),
                ("absorbed", "mJ", "energy that the wall has taken", 1e3),
            )
        ),
    )
}
"""Predefined figures by name."""
