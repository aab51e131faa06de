"""Figures of hits on a wall and a press."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from maglev_mj.energy import actuator_work
from maglev_mj.frames import Array
from maglev_mj.trace import Trace

_STEP = 1e-4
_TAIL = 0.2


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
    press = _press(motion, tail) if motion.time[-1] >= end - 1e-9 else (np.nan,) * 4
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


def _press(motion: _Motion, start: float) -> tuple[float, ...]:
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
