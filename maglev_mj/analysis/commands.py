"""Identification of a rendered law from its commands.

The gains are slopes of the commands over the measured positions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from maglev_mj.analysis.output_error import inverse
from maglev_mj.frames import Array, Mask
from maglev_mj.recording import RunMetadata, Stretch
from maglev_mj.recording.sample import Face

_ROUNDING = 64.0 * float(np.finfo(np.float64).eps)
_NOTHING = 1e-9
"""Part of the largest command below which a remainder is rounding, not a force."""


class CommandedLaw(NamedTuple):
    """Linear fit of commands by P parts.

    A part is a known function of the measured positions; each has a gain.

    Attributes:
        names: Names of the parts, such as ("stiffness", 0) for the first face.
        parts: Values of the parts at unit gain, (N, P).
        gains: The gains, (P,).
        errors: Their standard errors, (P,); infinite for a gain that cannot be separated from the others.
        residual: Residual of the commands [N, N m].
        degrees: Degrees of freedom.
        scale: Root mean square of all parts [N, N m].
        rest: Commands as applied without all parts [N, N m], (N,).
    """

    names: Sequence[tuple[str, int]]
    parts: Array
    gains: Array
    errors: Array
    residual: float
    degrees: int
    scale: float
    rest: Array


def is_inside(place: Array, face: Face) -> Mask:
    """Return True for positions (N,) in a wall."""
    return np.asarray(face[1] * (place - face[2]) <= 0.0)


def fit_law(
    stretch: Stretch, metadata: RunMetadata, axis: int, faces: Sequence[Face], anchors: Array | None, used: Mask
) -> CommandedLaw:
    """Fit the commands on an axis by a law.

    The law is a sum of walls, friction, and a spring and a damper that act everywhere.

    Args:
        stretch: N samples.
        metadata: Metadata of the run.
        axis: Index into AXES.
        faces: Touched walls.
        anchors: Stick positions of the axis [m, rad], (N,); None without friction.
        used: True for samples that count, (N,).
    """
    tick, place, period = stretch.tick, stretch.position[:, axis], metadata.period
    speed = np.append(0.0, np.diff(place) / (np.diff(tick) * period))
    names: list[tuple[str, int]] = []
    parts: list[Array] = []
    outside = np.ones(len(place), dtype=np.bool_)
    for number, face in enumerate(faces):
        inside = is_inside(place, face)
        outside &= ~inside
        names += [("stiffness", number), ("damping", number)]
        parts += [inside * (face[2] - place), inside * -speed]
    stated = stretch.command[:, axis]
    applied = stretch.applied[:, axis]
    command = np.where(np.isfinite(stated), stated, applied) - metadata.carried[axis]
    outside &= used
    if anchors is not None:
        stuck = np.isfinite(anchors)
        last = anchors[np.maximum.accumulate(np.where(stuck, np.arange(len(stuck)), np.argmax(stuck)))]
        names += [("stuck", 0), ("sliding", 0)]
        parts += [np.where(stuck, anchors - place, 0.0), ~stuck * np.sign(last - place)]
    largest = float(np.abs(command).max())
    if anchors is not None or (outside.any() and np.ptp(command[outside]) > _NOTHING * largest):
        names += [("spring", 0), ("damper", 0)]
        parts += [-place, -speed]
    columns = np.column_stack([*parts, np.ones(len(place))][: len(parts) + bool(outside.sum() > 1)])
    known = used & np.append(False, np.diff(tick) > 0)
    gram, told = inverse(columns[known])
    gains = gram @ (columns[known].T @ command[known])
    left = command[known] - columns[known] @ gains
    degrees = max(int(known.sum()) - columns.shape[1], 1)
    residual = max(float(np.sqrt(np.square(left).sum() / degrees)), _ROUNDING * largest)
    errors = np.where(told, residual * np.sqrt(np.maximum(np.diag(gram), 0.0)), np.inf)
    count = len(parts)
    made = columns[:, :count] @ gains[:count]
    rest = applied - made
    return CommandedLaw(
        names=names,
        parts=columns[:, :count],
        gains=gains[:count],
        errors=errors[:count],
        residual=residual,
        degrees=degrees,
        scale=float(np.sqrt(np.square(made[known]).mean())),
        rest=np.where(np.abs(rest) > _NOTHING * largest, rest, 0.0),
    )
