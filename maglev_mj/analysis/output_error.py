"""Output-error fit of one coordinate.

The model is a mass under recorded forces; the only error is that of the sensor.

Between switches of the force the motion is a parabola, so that the position at a sample is linear in the factors of
the forces and smooth in their delay. The recorded forces are known exactly and already include sensor noise fed back
by the controller. The only remaining error is that of the sensor, independent at every sample, so least squares on the
positions has no bias, unlike a fit of accelerations.

Samples are cut into windows, each with its own initial position and speed, so that errors do not accumulate.

Source: output-error method as in Ljung 1999; not checked against the original.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from maglev_mj.frames import Array, Mask

_SINGULAR, _ROUNDS = 1e-10, 40
_LEAST_SAMPLES, _WINDOW_TIME = 40, 0.05
_MOST_LEVERAGE = 0.9
_SENSOR = 1e-8
"""Residual below that of any sensor [m, rad]."""
SLOW = 0.6
"""Whiteness limit; residuals below it are those of forces."""

Numbers: TypeAlias = NDArray[np.intp]


def student(degrees: float) -> float:
    """Return the 97.5 % point of Student's t.

    The relative error is within 1e-3 from 4 degrees of freedom on.
    """
    z, n = 1.959963984540054, max(degrees, 1.0)
    terms = (
        (z**3 + z) / 4.0,
        (5.0 * z**5 + 16.0 * z**3 + 3.0 * z) / 96.0,
        (3.0 * z**7 + 19.0 * z**5 + 17.0 * z**3 - 15.0 * z) / 384.0,
    )
    return float(z + sum(term / n ** (power + 1) for power, term in enumerate(terms)))


def inverse(columns: Array) -> tuple[Array, Mask]:
    """Return the inverse Gram matrix of columns, (P, P).

    A mask (P,) of linearly independent columns is returned too.

    Args:
        columns: (N, P).
    """
    size = np.sqrt(np.square(columns).sum(axis=0))
    unit = columns / np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(unit.T @ unit)
    weak = values < _SINGULAR
    known = (size > 0.0) & ~((np.square(vectors) * weak).sum(axis=1) > _SINGULAR)
    gram = (vectors * np.where(weak, 0.0, 1.0 / np.where(weak, 1.0, values))) @ vectors.T
    return gram / np.outer(*[np.where(size > 0.0, size, np.inf)] * 2), known


class Windows(NamedTuple):
    """M windows of up to W samples, without gaps.

    Attributes:
        rows: Indices of the samples, (M, W).
        there: True for existing samples, (M, W).
        basis: Position and speed at the beginning as two orthonormal columns, (M, W, 2).
    """

    rows: Numbers
    there: Mask
    basis: Array

    @classmethod
    def cut(cls, time: Array, runs: Sequence[tuple[int, int]], period: float) -> Windows:
        """Cut runs of samples into windows.

        A window has about 40 samples or 50 ms, the longer of both; a run goes from one row up to another.
        """
        usual = max(_LEAST_SAMPLES, round(_WINDOW_TIME / period))
        parts = [
            part
            for first, last in runs
            for part in np.array_split(np.arange(first, last), max(1, round((last - first) / usual)))
            if len(part) > 3
        ]
        width = max(map(len, parts), default=0)
        rows, there = np.zeros((len(parts), width), dtype=np.intp), np.zeros((len(parts), width), dtype=np.bool_)
        for index, part in enumerate(parts):
            rows[index, : len(part)], there[index, : len(part)] = part, True
        return cls._of(rows, there, time)

    @classmethod
    def _of(cls, rows: Numbers, there: Mask, time: Array) -> Windows:
        since = (time[rows] - time[rows[:, :1]]) * there
        basis, _ = np.linalg.qr(np.stack([there.astype(np.float64), since], axis=-1)) if rows.size else (since, None)
        return cls(rows, there, basis)

    def choose(self, place: Array, most: int) -> Windows:
        """Return the windows with the least straight motion.

        They have at most `most` samples in all; the motion is (N,).
        """
        count = max(most // max(self.rows.shape[1], 1), 1)
        if len(self.rows) <= count:
            return self
        bent = np.square(self.project(place[self.rows][:, :, None])).sum(axis=(1, 2))
        chosen = np.sort(np.argsort(-bent, kind="stable")[:count])
        return Windows(self.rows[chosen], self.there[chosen], self.basis[chosen])

    def project(self, values: Array) -> Array:
        """Remove initial position and speed from values.

        (M, W, P).
        """
        values = values * self.there[:, :, None]
        return np.asarray(values - self.basis @ (self.basis.swapaxes(1, 2) @ values))


@dataclass(frozen=True, kw_only=True, eq=False)
class Forces:
    """P forces on one coordinate over N samples.

    Each is multiplied by a value to be found.

    Attributes:
        time: Times of the samples [s], (N,).
        switch: Switching times of commands, without their delay [s], (S,).
        late: Forces after each switch [N], (S, P).
        before: Forces before the first switch [N], (P,).
        speed: Integral of the forces without delay, from each sample to the next [N s], (N - 1, P).
        way: Double integral of the same forces [N s²], (N - 1, P).
    """

    time: Array
    switch: Array
    late: Array
    before: Array
    speed: Array
    way: Array

    def gained(self, delay: float) -> tuple[Array, Array, Array, Array]:
        """Return the forces' integrals over each period, with slopes.

        Integral, double integral, and the derivatives of both with respect to the delay, (N - 1, P).
        """
        time, when = self.time, self.switch + delay
        levels = np.vstack([self.before, self.late])
        at = levels[np.searchsorted(when, time, side="right")]
        period = np.searchsorted(time, when, side="right") - 1
        inside = (period >= 0) & (period < len(time) - 1)
        inside[inside] = when[inside] > time[period[inside]]
        index, jump = period[inside], np.diff(levels, axis=0)[inside]
        left = (time[index + 1] - when[inside])[:, None]
        width = np.diff(time)[:, None]
        speed, way = width * at[:-1], 0.5 * width**2 * at[:-1]
        for column in range(levels.shape[1]):
            speed[:, column] += np.bincount(index, (left * jump)[:, column], len(width))
            way[:, column] += np.bincount(index, (0.5 * left**2 * jump)[:, column], len(width))
        return speed + self.speed, way + self.way, at[:-1] - at[1:], width * at[:-1] - speed

    def moved(self, windows: Windows, delay: float) -> tuple[Array, Array]:
        """Return each force's displacement of a unit mass.

        The derivative with respect to the delay is returned too, (M, W, P) each.
        """
        speed, way, by_speed, by_way = self.gained(delay)
        width = np.diff(self.time)[:, None]
        steps = np.minimum(windows.rows[:, :-1], len(width) - 1)
        on = windows.there[:, 1:, None]

        def summed(fast: Array, far: Array) -> Array:
            fast, far = fast[steps] * on, far[steps] * on
            before = np.cumsum(fast, axis=1) - fast
            place = np.cumsum(far + width[steps] * before, axis=1)
            return np.concatenate([np.zeros_like(place[:, :1]), place], axis=1)

        return summed(speed, way), summed(by_speed, by_way)


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """Fit of P values and a delay.

    Attributes:
        values: Factors of the forces [1/kg], (P,).
        delay: Delay of the commands [s].
        covariance: Covariance of the values and the delay, for white residuals, (P + 1, P + 1).
        errors: Standard errors of both, (P + 1,).
        moves: Largest motion explained by each value alone, for the delay by one period of it [m], (P + 1,); 0 for a
            value that the others can replace.
        residual: Root mean square of the residuals [m].
        degrees: Degrees of freedom.
        left: Residuals, scaled to the error of a sample [m], (M, W); 0 for missing samples.
        whiteness: Mean square of the residuals' differences over twice their own mean square: 1 for noise, near 0 for
            slow changes, such as those of a missing force.
        share: Residual relative to the motion to be explained.
    """

    values: Array
    delay: float
    covariance: Array
    errors: Array
    moves: Array
    residual: float
    degrees: int
    left: Array
    whiteness: float
    share: float


def fit(
    forces: Forces,
    windows: Windows,
    place: Array,
    delay: float,
    *,
    period: float,
    search: bool,
    floor: float,
    fixed: Array,
) -> Fit:
    """Return the fit of positions by forces.

    Args:
        forces: The forces.
        windows: Windows of the samples.
        place: Positions at the samples [m], (N,).
        delay: First guess at the delay [s], or the delay.
        period: Sample period [s].
        search: True to find the delay.
        floor: Least error of a position, such as that of rounding [m].
        fixed: Known values, (P,); NaN for values to be found.
    """
    seen = windows.project(place[windows.rows][:, :, None])[:, :, 0]
    free = np.isnan(fixed)
    given = np.where(free, 0.0, fixed)

    def at(late: float) -> tuple[Array, Array, Array, Array]:
        """Return values, residuals and columns at a delay.

        The columns are the displacements and their derivatives with respect to the delay.
        """
        where, slope = (windows.project(part) for part in forces.moved(windows, late))
        target = seen - where @ given
        columns = where[:, :, free].reshape(-1, int(free.sum()))
        gram, _ = inverse(columns)
        found = gram @ (columns.T @ target.ravel())
        values = given.copy()
        values[free] = found
        return values, target - (where[:, :, free] @ found), where, slope

    values, left, where, slope = at(delay)
    for _ in range(_ROUNDS if search else 0):
        columns = np.concatenate([where[:, :, free], (slope @ values)[:, :, None]], axis=2)
        columns = columns.reshape(-1, columns.shape[2])
        gram, _ = inverse(columns)
        move = float(np.clip((gram @ (columns.T @ left.ravel()))[-1], -0.25 * period, 0.25 * period))
        best = float(np.square(left).sum())
        while abs(move) > 1e-9 * period:
            trial = at(delay + move)
            if float(np.square(trial[1]).sum()) < best:
                break
            move *= 0.5
        else:
            break
        delay += move
        values, left, where, slope = trial
    late = (slope @ values)[:, :, None] * search
    return _judged(
        windows,
        seen,
        np.concatenate([where, late], axis=2),
        free,
        values,
        delay,
        left,
        floor,
        period if search else 0.0,
    )


def _judged(
    windows: Windows,
    seen: Array,
    where: Array,
    free: Mask,
    values: Array,
    delay: float,
    left: Array,
    floor: float,
    period: float,
) -> Fit:
    """Return the fit with its errors."""
    size = where.shape[2]
    chosen = np.append(np.flatnonzero(free), size - 1 if period else []).astype(np.intp)
    columns = where[:, :, chosen].reshape(-1, len(chosen))
    gram, known = inverse(columns)
    count = int(windows.there.sum())
    degrees = max(count - 2 * len(windows.rows) - int(known.sum()), 1)
    spread = max(float(np.sqrt(np.square(left).sum() / degrees)), floor)
    leverage = np.square(windows.basis).sum(axis=2).ravel() + ((columns @ gram) * columns).sum(axis=1)
    kept = 1.0 - np.minimum(leverage, _MOST_LEVERAGE)
    white = gram * spread**2
    inner = windows.there[:, 1:]
    change = np.square(np.diff(left, axis=1) * inner).sum() / max(int(inner.sum()), 1)
    square = np.square(left).sum() / count
    whiteness = float(change / (2.0 * square)) if square > 0.0 else 1.0
    errors = np.sqrt(np.diag(white))
    if whiteness < SLOW or spread < _SENSOR or count < _LEAST_SAMPLES:
        # residuals of forces or of rounding, or too few samples to tell: the worst case, with all of one sign
        errors = np.maximum(errors, np.abs(columns @ gram).T @ np.abs(left.ravel()))
    covariance, wide, moves = np.zeros((size, size)), np.zeros(size), np.zeros(size)
    covariance[np.ix_(chosen, chosen)] = white
    wide[chosen] = errors
    # the effect of a column beyond all others
    unit = np.diag(gram) > 0.0
    alone = np.abs(columns @ (gram / np.where(unit, np.diag(gram), 1.0))).max(axis=0, initial=0.0)
    moves[chosen] = np.where(known & unit, alone, 0.0)
    moves *= np.append(np.abs(values), period)
    return Fit(
        values=values,
        delay=delay,
        covariance=covariance,
        errors=wide,
        moves=moves,
        residual=spread,
        degrees=degrees,
        left=left / np.sqrt(kept.reshape(left.shape)) * windows.there,
        whiteness=whiteness,
        share=float(np.sqrt(square / max(np.square(seen).sum() / count, 1e-300))),
    )
