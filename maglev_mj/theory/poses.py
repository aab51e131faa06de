"""Poses at which laws without declared gains are linearised: along each axis, inside faces, at edges of regions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.control.controller import Controller
from maglev_mj.errors import MaglevError
from maglev_mj.frames import AXES, Array, Sample, components
from maglev_mj.theory.linearise import Linearised, linearise

POINTS, STRIDE = 23, 0.9871
"""Number of poses along each axis, and range covered.

The range is a fraction of the range of motion, chosen so that few poses fall on an edge.
"""
EDGE, _DEPTHS = 1e-5, (1e-6, 1e-5, 1e-4)
"""Distances from an edge [m]; ten times as many [rad].

The first moves a start off an edge, the others are depths of poses inside a face or another edge.
"""
_PROBE, _EDGE, _LOCATED = 1e-7, 1e-4, 10
"""Displacement that probes for an edge [m, 0.1 rad], relative change that marks one, and bisections of its interval."""
_FINE, _MORE = 901, 1.01
"""Positions along an axis in a search of layers, and ratio of a gain there to those at the poses."""
SCALE = np.array([1.0] * 3 + [10.0] * 3)


def poses_of(controllers: Sequence[Controller], start: Array, reach: ArrayLike) -> list[Array]:
    """Return start, centre, poses along each axis, and poses inside each face, of each controller."""
    result = []
    for controller, near in zip(controllers, linearise(controllers, np.tile(start, (len(controllers), 1)))):
        first = start + EDGE * SCALE * near.jumps  # from a start on an edge, the whole grid would be on it
        rows = [first, np.zeros(6)]
        for axis, far in enumerate(np.asarray(reach)):
            rows += [_with(first, axis, value) for value in np.linspace(-1.0, 1.0, POINTS) * far * STRIDE]
        for axis, normal, edge in controller.faces:
            rows += [_with(first, axis, float(edge) - normal * depth * SCALE[axis]) for depth in _DEPTHS]
        result.append(np.array(rows))
    return result


def extremes_of(controller: Controller, start: Array, reach: ArrayLike) -> list[Array]:
    """Return poses of the stiffest and the least damped layer along each axis, if the poses along it miss them.

    Empty for laws that accept floats only.
    """
    positions = np.linspace(-1.0, 1.0, _FINE)
    rows = np.tile(start, (len(AXES), _FINE, 1))
    for axis, far in enumerate(np.asarray(reach)):
        rows[axis, :, axis] = positions * far * STRIDE
    probe, forces = copy(controller), []
    probe.reset()
    try:
        for tick in range(2):  # at rest, then all displaced
            moved = rows + tick * _PROBE * SCALE * np.eye(len(AXES))[:, None]
            wrench = probe.step(Sample(tick, 0.0, components(moved.reshape(-1, len(AXES))))).force
            each = [np.broadcast_to(part, len(AXES) * _FINE).reshape(len(AXES), _FINE) for part in wrench]
            forces.append(np.array([each[axis][axis] for axis in range(len(AXES))]))
    except (MaglevError, TypeError, ValueError):
        return []
    result = []
    near = np.searchsorted(positions, np.linspace(-1.0, 1.0, POINTS)) - 1
    for axis in range(len(AXES)):
        stiffness = -np.diff(forces[0][axis]) / np.diff(rows[axis, :, axis])
        moving = (forces[0][axis] - forces[1][axis]) / (_PROBE * SCALE[axis])
        moving = np.maximum(moving[1:], moving[:-1])
        share = np.where(stiffness > _EDGE * stiffness.max(), stiffness / np.where(moving > 0.0, moving, np.inf), 0.0)
        for size in (stiffness, share):
            if size[at := int(np.argmax(size))] > _MORE * size[near].max():
                result.append(_with(start, axis, float(rows[axis, at : at + 2, axis].mean())))
    return result


def edges_of(controller: Controller, grid: Sequence[Linearised]) -> Iterator[Array]:
    """Yield poses just inside the edges of regions of constant gains, such as free motion, along each axis."""
    for axis in range(len(AXES)):
        line = grid[axis * POINTS : (axis + 1) * POINTS]
        same = [_same(*(near.response for near in pair)) for pair in pairwise(line)]
        for index in (index for index, equal in enumerate(same) if not equal):
            ends = line[index].pose, line[index + 1].pose
            for (outside, inside), constant in ((ends, same[:index][-1:]), (ends[::-1], same[index + 1 :][:1])):
                if constant != [True]:
                    continue
                slope = _slope(controller, outside, axis)
                for _ in range(_LOCATED):
                    middle = 0.5 * (outside + inside)
                    unchanged = _same(_slope(controller, middle, axis), slope)
                    outside, inside = (middle, inside) if unchanged else (outside, middle)
                sign = np.sign(inside[axis] - outside[axis]) * SCALE[axis]
                yield from (_with(inside, axis, inside[axis] + sign * depth) for depth in _DEPTHS)


def _slope(controller: Controller, pose: Array, axis: int) -> Array:
    """Return the change of the wrench by a small displacement along one axis, (1, 6)."""
    forces = []
    for step in (0.0, _PROBE * SCALE[axis]):
        probe = copy(controller)
        probe.reset()
        for tick, shift in enumerate((0.0, 0.0, step)):
            command = probe.step(Sample(tick, 0.0, _with(pose, axis, pose[axis] + shift).tolist()))
        forces.append(command.force)
    return np.diff(forces, axis=0)


def _same(first: Array, second: Array) -> bool:
    return bool(np.abs(first - second).max() <= _EDGE * max(np.abs(first).max(), np.abs(second).max()))


def _with(pose: Array, axis: int, value: float) -> Array:
    changed = pose.copy()
    changed[axis] = value
    return changed
