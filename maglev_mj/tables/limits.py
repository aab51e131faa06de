"""What a motion asks of the device beyond what it gives, as text."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.frames import Array, Mask
from maglev_mj.spec import RANGE, Spec
from maglev_mj.trace import Trace

__all__ = ["beyond_force", "beyond_range"]

_ROUNDING = 1.0 + 1e-9


def beyond_force(trace: Trace) -> list[str]:
    """Return a line if the actuators exceed the device's force along z, else none."""
    # the last knot's force has not acted yet
    peak, device = float(np.abs(trace.wrench[:-1, 2]).max(initial=0.0)), Spec.largest_vertical_force.value
    if peak <= device * _ROUNDING:
        return []
    return [f"  The device gives {device:g} N along z, less than this peak: see --force-limit {device:g}"]


def beyond_range(labels: Sequence[str], runs: Sequence[ArrayLike], sweeps: Sequence[ArrayLike] = ()) -> list[str]:
    """Return a line if a motion leaves the device's range, else none.

    Args:
        labels: A name for each run.
        runs: Greatest distance from the centre on each axis [m, rad], (6,) each.
        sweeps: The same for each phase of each run, (N, 6) each; or nothing.
    """
    texts, left = [], np.zeros(len(RANGE), dtype=bool)
    for index, (label, run) in enumerate(zip(labels, runs, strict=True)):
        swept = np.asarray(sweeps[index]) if sweeps else np.empty((0, len(RANGE)))
        furthest = np.vstack([np.asarray(run), swept]).max(axis=0)
        if not (outside := _outside(furthest)).any():
            continue
        left |= outside
        phases = int(_outside(swept).any(axis=1).sum())
        count = f" ({phases} of {len(swept)} phases)" if phases else ""
        texts.append(f"{label} {_distances(np.where(outside, furthest, 0.0))}{count}")
    if not texts:
        return []
    return [f"  Beyond the range of {_distances(np.where(left, RANGE, 0.0))}: {', '.join(texts)}"]


def _outside(furthest: Array) -> Mask:
    """Return the axes that leave the device's range."""
    outside: Mask = furthest > np.array(RANGE) * _ROUNDING
    return outside


def _distances(furthest: Array) -> str:
    """Return the largest translation and rotation, each with its unit; zero is left out."""
    parts = [(furthest[:3].max() * 1e3, "mm"), (np.degrees(furthest[3:].max()), "deg")]
    return " and ".join(f"{value:.4g} {unit}" for value, unit in parts if value > 0.0)
