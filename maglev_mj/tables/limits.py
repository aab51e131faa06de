"""What a motion asks of the device beyond what it gives, as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.frames import Array, Mask
from maglev_mj.scenes.run import Result
from maglev_mj.spec import RANGE, Spec

__all__ = ["beyond_force", "beyond_range"]

_ROUNDING = 1.0 + 1e-9


def beyond_force(results: Mapping[str, Result]) -> list[str]:
    """Return a line if the actuators exceed the device's force along z in a run, else none."""
    device = Spec.largest_vertical_force.value
    # the last knot's force has not acted yet
    peaks = {label: float(np.abs(one.trace.wrench[:-1, 2]).max(initial=0.0)) for label, one in results.items()}
    beyond = [f"{label} {peak:.3g}" for label, peak in peaks.items() if peak > device * _ROUNDING]
    if not beyond:
        return []
    return [f"  Above the device's {device:g} N (z): {', '.join(beyond)}"]


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
