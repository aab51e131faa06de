"""Critical stiffness: where stability first changes as one declared gain alone grows."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np

from maglev_mj.frames import Array, Mask
from maglev_mj.theory.boundary import boundary_of, highest_of
from maglev_mj.theory.linearise import MOST_SAMPLES_AS_STATES, StateSpace, realise
from maglev_mj.theory.loop import RELATIVE_ROUNDING, AffineLaw, Bound, Loop, Loops
from maglev_mj.theory.loop_array import bisect

RATIOS = 1.0, 2.0, 3.0
"""Ratios of the gain at which a law is checked to be affine in it."""
_FACTOR_OF_SCAN, _STEPS_OF_SCAN = 1.2, 14
"""Scan of other laws up to ten times the gain: factor of a step, and steps; a narrower band in between is missed."""
_BISECTIONS = 13
"""Bisections of the step in which stability changes: to 2e-5 of the gain."""

LoopsAt: TypeAlias = Callable[[Sequence[int], Sequence[float]], Sequence[Loops]]
"""Function of indices and ratios of a gain that returns the loops of each; none for a gain out of bounds."""


def critical_ratios(at: LoopsAt, present: Sequence[Loops]) -> list[Bound]:
    """Return the ratio of critical to present gain of N cases: all softer ones are stable.

    By the characteristic polynomial for laws that are affine in the gain, so that no crossing is missed; others by one
    scan up to ten times the gain.

    Args:
        at: Loops of some cases at ratios of their gain; a case is as stable as its worst loop.
        present: Those of each case at its present gain, N.

    Returns:
        By case: `beyond` if nothing changes in the search, 0 if softer ones are unstable too, NaN if not judged.
    """
    count = len(present)
    every = [*range(count)]
    others = at(every * 2, [ratio for ratio in RATIOS[1:] for _ in every])  # together
    exact = [_exact(three) for three in zip(present, others[:count], others[count:], strict=True)]
    radii = [_radius(loops) for loops in present]
    rest = [index for index in every if exact[index] is None and radii[index] == radii[index]]
    scanned = dict(zip(rest, _scan(at, rest, radii), strict=True))
    return [found if (found := exact[index]) is not None else scanned.get(index, Bound(math.nan)) for index in every]


def _radius(loops: Loops) -> float:
    return float(loops.spectral_radii().max()) if len(loops) else math.nan


def _exact(three: Sequence[Loops]) -> Bound | None:
    """Return the ratio of loops at the three gains; None if one of them is not affine in the gain."""
    if not three[0] or len({*map(len, three)}) > 1:
        return None
    limits = [affine_limit(loops) for loops in zip(*three, strict=True)]
    known = [limit for limit in limits if limit is not None]
    return min(known) if len(known) == len(limits) else None


def affine_law(three: Sequence[Loop]) -> AffineLaw | None:
    """Return the law of one axis in a loop at the three gains, affine in the gain; None if it is not."""
    if any(loop.reason or loop.device is not None or (loop.linear and len(loop.linear.axes) > 1) for loop in three):
        return None
    responses = [loop.response() for loop in three]
    size = max(map(len, responses))
    padded = np.array([np.pad(one, (0, size - len(one))) for one in responses])
    return AffineLaw.of(padded, RATIOS, _realised)


def affine_limit(three: Sequence[Loop]) -> Bound | None:
    """Return the critical ratio of one loop at the three gains; None if its law is not affine in the gain."""
    if (law := affine_law(three)) is None:
        return None
    array = three[0].array(law=law.__call__, velocity=None)
    limit, highest = float(boundary_of(array, np.asarray(0.0))), float(highest_of(array))
    return Bound(limit, limit >= highest * (1.0 - RELATIVE_ROUNDING))


def _realised(response: Array) -> StateSpace | None:
    return StateSpace.of(response) if len(response) <= MOST_SAMPLES_AS_STATES else realise(response)


def _scan(at: LoopsAt, cases: Sequence[int], radii: Sequence[float]) -> list[Bound]:
    """Return the ratio of some cases by steps of a factor and bisection."""
    if not cases:
        return []
    stable, valid = np.array([radii[case] for case in cases]) < 1.0 - RELATIVE_ROUNDING, np.ones(len(cases), dtype=bool)

    def changed(ratios: Array) -> Mask:
        """Return True where stability at a ratio above 0 differs from the present; not valid if not judged."""
        asked = np.flatnonzero((ratios > 0.0) & valid)
        result = np.zeros(ratios.shape, dtype=bool)
        if asked.size:
            found = np.array([*map(_radius, at([cases[index] for index in asked.tolist()], ratios[asked].tolist()))])
            valid[asked] = ~np.isnan(found)
            result[asked] = valid[asked] & ((found < 1.0 - RELATIVE_ROUNDING) != stable[asked])
        return result

    before, after = np.ones(len(cases)), np.full(len(cases), math.inf)
    for step in range(1, _STEPS_OF_SCAN):
        ratios = np.where(
            np.isinf(after), np.where(stable, _FACTOR_OF_SCAN**step, (1.0 / _FACTOR_OF_SCAN) ** step), 0.0
        )
        crossed = changed(ratios)
        before, after = np.where(np.isinf(after) & ~crossed, ratios, before), np.where(crossed, ratios, after)
    found = bisect(changed, before, after, _BISECTIONS)
    end = _FACTOR_OF_SCAN ** (_STEPS_OF_SCAN - 1)
    ends = [Bound(end, True) if good else Bound(0.0) for good in stable]
    return [
        Bound(math.nan) if not sure else last if math.isinf(ratio) else Bound(ratio)
        for ratio, sure, last in zip(found.tolist(), valid, ends, strict=True)
    ]
