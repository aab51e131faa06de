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
BESIDE_EDGE = 1e-5
"""Distance by which a start on an edge is moved off it [m]; ten times as much [rad]."""
_DEPTHS_INSIDE = 1e-6, 1e-5, 1e-4
"""Depths of poses inside a face or another edge [m]; ten times as much [rad].

A law whose gains grow from its edge on is judged there, as the grid has a pose every 0.4 mm of a range of 4.5 mm.
"""
DISPLACEMENT = 1e-7
"""Displacement that finds an edge [m]; ten times as much [rad]: that of a linearisation."""
_CHANGE_AT_EDGE = 1e-4
"""Relative change of the gains that marks an edge; a smaller one is rounding of a difference of forces."""
_BISECTIONS_OF_EDGE = 10
"""Bisections of its interval: to 0.4 µm of a range of 4.5 mm, below the least depth."""
_POINTS_OF_LAYERS = 901
"""Positions along an axis in a search of layers: one thinner than 1/450 of the range may be missed."""
_RATIO_OF_LAYER = 1.01
"""Ratio of a gain in a layer to those at the poses, from which it gets a pose of its own."""
SCALE = np.array([1.0] * 3 + [10.0] * 3)


def poses_of(controllers: Sequence[Controller], start: Array, reach: ArrayLike) -> list[Array]:
    """Return start, centre, poses along each axis, and poses inside each face, of each controller."""
    result = []
    for controller, near in zip(controllers, linearise(controllers, np.tile(start, (len(controllers), 1)))):
        first = start + BESIDE_EDGE * SCALE * near.jumps  # from a start on an edge, the whole grid would be on it
        rows = [first, np.zeros(6)]
        for axis, far in enumerate(np.asarray(reach)):
            rows += [_with(first, axis, value) for value in np.linspace(-1.0, 1.0, POINTS) * far * STRIDE]
        for axis, normal, edge in controller.faces:
            rows += [_with(first, axis, float(edge) - normal * depth * SCALE[axis]) for depth in _DEPTHS_INSIDE]
        result.append(np.array(rows))
    return result


def extremes_of(controller: Controller, start: Array, reach: ArrayLike) -> list[Array]:
    """Return poses of the stiffest and the least damped layer along each axis, if the poses along it miss them.

    Empty for laws that accept floats only.
    """
    positions = np.linspace(-1.0, 1.0, _POINTS_OF_LAYERS)
    rows = np.tile(start, (len(AXES), _POINTS_OF_LAYERS, 1))
    for axis, far in enumerate(np.asarray(reach)):
        rows[axis, :, axis] = positions * far * STRIDE
    probe, forces = copy(controller), []
    probe.reset()
    try:
        for tick in range(2):  # at rest, then all displaced
            moved = rows + tick * DISPLACEMENT * SCALE * np.eye(len(AXES))[:, None]
            wrench = probe.step(Sample(tick, 0.0, components(moved.reshape(-1, len(AXES))))).force
            each = [
                np.broadcast_to(part, len(AXES) * _POINTS_OF_LAYERS).reshape(len(AXES), _POINTS_OF_LAYERS)
                for part in wrench
            ]
            forces.append(np.array([each[axis][axis] for axis in range(len(AXES))]))
    except (MaglevError, TypeError, ValueError):
        return []
    result = []
    near = np.searchsorted(positions, np.linspace(-1.0, 1.0, POINTS)) - 1
    for axis in range(len(AXES)):
        stiffness = -np.diff(forces[0][axis]) / np.diff(rows[axis, :, axis])
        moving = (forces[0][axis] - forces[1][axis]) / (DISPLACEMENT * SCALE[axis])
        moving = np.maximum(moving[1:], moving[:-1])
        share = np.where(
            stiffness > _CHANGE_AT_EDGE * stiffness.max(), stiffness / np.where(moving > 0.0, moving, np.inf), 0.0
        )
        for size in (stiffness, share):
            if size[at := int(np.argmax(size))] > _RATIO_OF_LAYER * size[near].max():
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
                for _ in range(_BISECTIONS_OF_EDGE):
                    middle = 0.5 * (outside + inside)
                    unchanged = _same(_slope(controller, middle, axis), slope)
                    outside, inside = (middle, inside) if unchanged else (outside, middle)
                sign = np.sign(inside[axis] - outside[axis]) * SCALE[axis]
                yield from (_with(inside, axis, inside[axis] + sign * depth) for depth in _DEPTHS_INSIDE)


def _slope(controller: Controller, pose: Array, axis: int) -> Array:
    """Return the change of the wrench by a small displacement along one axis, (1, 6)."""
    forces = []
    for step in (0.0, DISPLACEMENT * SCALE[axis]):
        probe = copy(controller)
        probe.reset()
        for tick, shift in enumerate((0.0, 0.0, step)):
            command = probe.step(Sample(tick, 0.0, _with(pose, axis, pose[axis] + shift).tolist()))
        forces.append(command.force)
    return np.diff(forces, axis=0)


def _same(first: Array, second: Array) -> bool:
    return bool(np.abs(first - second).max() <= _CHANGE_AT_EDGE * max(np.abs(first).max(), np.abs(second).max()))


def _with(pose: Array, axis: int, value: float) -> Array:
    changed = pose.copy()
    changed[axis] = value
    return changed
