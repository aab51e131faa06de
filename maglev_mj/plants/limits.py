"""Limits of a device, and the runs that exceed them."""

from __future__ import annotations

from collections.abc import Callable
from itertools import compress
from typing import NamedTuple

import numpy as np

from maglev_mj.frames import Array
from maglev_mj.plants.model import Flotor
from maglev_mj.plants.trace import Trace

_ROUNDING = 1.0 + 1e-9


class Limit(NamedTuple):
    """Limit of a device.

    Attributes:
        verdict: Verdict on a run that exceeds it, beside many others.
        template: Warning, a format of peak, axis, limit, remedy and runs.
        part: Columns of `peaks_of`.
        text: Function that returns their values with a unit, to a number of digits.
    """

    verdict: str
    template: str
    part: slice
    text: Callable[[Array, int], str]

    def warning(self, excess: Array, body: Flotor, **texts: str) -> str:
        """Return the warning about an excess, (7,); `texts` are parts of the template."""
        excess, limits = excess[self.part], _limits_of(body)[self.part]
        parts = {"axis": "", "remedy": "", "runs": self.text(excess, 4)} | texts
        limit = self.text(np.where(excess > 0.0, limits, 0.0), 4)
        return self.template.format(peak=self.text(excess, 3), limit=limit, **parts)


def _distances(values: Array, digits: int) -> str:
    parts = [(values[:3].max() * 1e3, "mm"), (np.degrees(values[3:].max()), "deg")]
    return " and ".join(f"{value:.{digits}g} {unit}" for value, unit in parts if value > 0.0)


LIMITS = (
    Limit(
        "peak force above limit",
        "peak force {peak}{axis} exceeds the device's {limit} limit{remedy}",
        slice(0, 1),
        lambda values, digits: f"{values[0]:.{digits}g} N",
    ),
    Limit("motion out of range", "motion exceeds the range of {limit}: {runs}", slice(1, 7), _distances),
)
"""Limits of a device, in the order of their warnings."""


def peaks_of(trace: Trace) -> Array:
    """Return the largest force along z [N], and the largest distance on each axis [m, rad], (..., 7)."""
    # the last knot's force has not acted yet
    force = np.abs(trace.wrench[:-1, ..., 2:3]).max(axis=0, initial=0.0)
    return np.concatenate([force, trace.furthest()], axis=-1)


def excess_of(peaks: Array, body: Flotor) -> Array:
    """Return peaks with 0 in place of those within the limits of a body, or of N bodies, (N, 7)."""
    return np.where(peaks > _limits_of(body).T * _ROUNDING, peaks, 0.0)


def verdicts(excess: Array) -> list[str]:
    """Return what each of N runs exceeds, such as "peak force above limit, motion out of range"; empty for nothing."""
    exceeded = np.transpose([excess[:, limit.part].any(axis=1) for limit in LIMITS])
    return [", ".join(compress([limit.verdict for limit in LIMITS], row)) for row in exceeded.tolist()]


def _limits_of(body: Flotor) -> Array:
    return np.array(np.broadcast_arrays(body.force_limit, *body.range))
