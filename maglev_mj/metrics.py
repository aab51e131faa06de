"""Figures of a motion along one axis.

Bounce figures and perceived hardness.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from maglev_mj.frames import Array
from maglev_mj.parameters import number
from maglev_mj.trace import Trace

__all__ = ["BounceSummary", "Hardness", "perceived_hardness", "summarise_bounce"]


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


def _settling_time(line: Trace, rest: float, share: float = 0.02, step: float = 1e-4) -> Array:
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
    grid = np.arange(int(np.floor(end / 1e-4)) + 1) * 1e-4
    pose, twist, wrench = (part[..., 0] for part in line.at(grid))
    inside = pose <= wall
    touched = inside.any(axis=0)
    contact = np.maximum(np.argmax(inside, axis=0) - 1, 0)  # before the force begins to rise
    away = ~inside & (np.arange(len(grid)).reshape((-1,) + (1,) * (inside.ndim - 1)) > contact)
    leaves = np.where(away.any(axis=0), np.argmax(away, axis=0), len(grid) - 1)
    shift = max(round(width / 1e-4), 1)
    rise = np.zeros_like(wrench)
    rise[:-shift] = (wrench[shift:] - wrench[:-shift]) / width
    place = np.arange(len(grid)).reshape((-1,) + (1,) * (rise.ndim - 1))
    during = (place >= contact - shift) & (place <= leaves)
    speed = np.abs(np.take_along_axis(twist, contact[None], axis=0)[0])
    first = np.take_along_axis(rise, contact[None], axis=0)[0]
    most = np.where(during, rise, -np.inf).max(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return Hardness(*(np.where(touched & (speed > 0.0), part / speed, np.nan) for part in (first, most)))
