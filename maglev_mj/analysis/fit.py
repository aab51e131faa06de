"""Least-squares fits of one coordinate: its motion by forces, and its commands by a law.

The commands over the measured positions give the law. The motion is fitted by an output-error model: a mass under
recorded forces, whose only error is that of the sensor. Its resolution and noise are estimated from positions alone.

Between switches of the force the motion is a parabola, so that the position at a sample is linear in the factors of
the forces and smooth in their delay. The recorded forces are known exactly and already include sensor noise fed back
by the controller. The only remaining error is that of the sensor, independent at every sample, so least squares on the
positions has no bias, unlike a fit of accelerations.

Samples are cut into windows, each with its own initial position and speed, so that errors do not accumulate.

Source: output-error method as in Ljung 1999; not checked against the original.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np

from maglev_mj.analysis.motion import Numbers
from maglev_mj.frames import Array, Mask
from maglev_mj.recording import Stretch
from maglev_mj.recording.sample import Face

_SINGULAR, _ROUNDS = 1e-10, 40
_LEAST_SAMPLES, _WINDOW_TIME = 40, 0.05
_MOST_LEVERAGE = 0.9
_SENSOR = 1e-8
"""Residual below that of any sensor [m, rad]."""
SLOW = 0.6
"""Whiteness limit; residuals below it are those of forces."""
ROUNDING = 64.0 * float(np.finfo(np.float64).eps)
"""Relative rounding of positions and commands."""
_NOTHING = 1e-9
"""Part of the largest command below which a remainder is rounding, not a force."""
_DITHERED = 1.0 / 12.0 + 0.25
"""Least mean square of a dithered sensor's error, in steps².

From this value on, noise of half a step moves a flotor at rest over several steps.
"""
_OFF_LATTICE, _DIVISORS, _LEAST_STEPS, _LEAST_MOVING = 1e-4, 20, 4, 20
_EXACT, _NORMAL, _TINY = 1e-12, 1.959963984540054, 4.0 * float(np.finfo(np.float64).eps)


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """A quantity identified from a recording.

    Attributes:
        value: Best value; NaN if it cannot be identified.
        standard_error: Standard error.
        low: Lower end of the 95 % interval.
        high: Upper end; for noise that cannot be identified, its upper bound.
        residual: Root mean square of the fit's residual, in the unit of the fitted data: metres or radians for
            positions, newtons or newton metres for commands.
        why: Reason for a failed identification, in a few words; empty if it succeeded.
    """

    value: float = math.nan
    standard_error: float = math.nan
    low: float = math.nan
    high: float = math.nan
    residual: float = math.nan
    why: str = ""

    def beyond(self, least: float, most: float) -> bool:
        """Return whether the value is known, and outside a range."""
        return self.value < least or self.value > most

    @classmethod
    def of(cls, value: float, error: float, degrees: float, residual: float) -> Self:
        """Return an estimate with the interval of Student's t."""
        reach = student(degrees) * error
        return cls(value=value, standard_error=error, low=value - reach, high=value + reach, residual=residual)

    @property
    def known(self) -> bool:
        """True if the quantity was identified."""
        return not self.why


def student(degrees: float) -> float:
    """Return the 97.5 % point of Student's t.

    The relative error is within 1e-3 from 4 degrees of freedom on.
    """
    z, n = _NORMAL, max(degrees, 1.0)
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
        since = (time[rows] - time[rows[:, :1]]) * there
        basis, _ = np.linalg.qr(np.stack([there.astype(np.float64), since], axis=-1)) if rows.size else (since, None)
        return cls(rows, there, basis)

    def choose(self, position: Array, most: int) -> Windows:
        """Return the windows with the least straight motion.

        They have at most `most` samples in all; the motion is (N,).
        """
        count = max(most // max(self.rows.shape[1], 1), 1)
        if len(self.rows) <= count:
            return self
        bent = np.square(self.project(position[self.rows][:, :, None])).sum(axis=(1, 2))
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
            position = np.cumsum(far + width[steps] * before, axis=1)
            return np.concatenate([np.zeros_like(position[:, :1]), position], axis=1)

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

    def estimate(self, value: float, error: float) -> Estimate:
        """Return an estimate from the fit."""
        return Estimate.of(value, error, self.degrees, self.residual)

    def error_of(self, weights: Array) -> float:
        """Return the standard error of a sum of values and delay by weights, (P + 1,)."""
        white = np.sqrt(np.diag(self.covariance))
        # enlarged if the residuals are not white
        ratio = np.where(white > 0.0, self.errors / np.where(white > 0.0, white, 1.0), 1.0)
        scaled = np.asarray(weights) * ratio
        return math.sqrt(max(float(scaled @ self.covariance @ scaled), 0.0))


def fit(
    forces: Forces,
    windows: Windows,
    position: Array,
    delay: float,
    *,
    period: float,
    search: bool,
    floor: float,
    fixed: Array,
) -> Fit:
    """Return the fit of positions by forces, with its errors.

    Args:
        forces: The forces.
        windows: Windows of the samples.
        position: Positions at the samples [m], (N,).
        delay: First guess at the delay [s], or the delay.
        period: Sample period [s].
        search: True to find the delay.
        floor: Least error of a position, such as that of rounding [m].
        fixed: Known values, (P,); NaN for values to be found.
    """
    seen = windows.project(position[windows.rows][:, :, None])[:, :, 0]
    free = np.isnan(fixed)
    fixed_values = np.where(free, 0.0, fixed)

    def at(late: float) -> tuple[Array, Array, Array, Array]:
        """Return values, residuals and columns at a delay.

        The columns are the displacements and their derivatives with respect to the delay.
        """
        where, slope = (windows.project(part) for part in forces.moved(windows, late))
        target = seen - where @ fixed_values
        columns = where[:, :, free].reshape(-1, int(free.sum()))
        gram, _ = inverse(columns)
        factors = gram @ (columns.T @ target.ravel())
        values = fixed_values.copy()
        values[free] = factors
        return values, target - (where[:, :, free] @ factors), where, slope

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
    # the errors, with a column for the delay
    where = np.concatenate([where, (slope @ values)[:, :, None] * search], axis=2)
    size = where.shape[2]
    chosen = np.append(np.flatnonzero(free), size - 1 if search else []).astype(np.intp)
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
    moves *= np.append(np.abs(values), period * search)
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


def is_inside(position: Array, face: Face) -> Mask:
    """Return True for positions (N,) in a wall."""
    return np.asarray(face[1] * (position - face[2]) <= 0.0)


def fit_law(stretch: Stretch, axis: int, faces: Sequence[Face], anchors: Array | None, used: Mask) -> CommandedLaw:
    """Fit the commands on an axis by a law.

    The law is a sum of walls, friction, and a spring and a damper that act everywhere.

    Args:
        stretch: N samples.
        axis: Index into AXES.
        faces: Touched walls.
        anchors: Stick positions of the axis [m, rad], (N,); None without friction.
        used: True for samples that count, (N,).
    """
    tick, position, period = stretch.tick, stretch.position[:, axis], stretch.metadata.period
    speed = np.append(0.0, np.diff(position) / (np.diff(tick) * period))
    names: list[tuple[str, int]] = []
    parts: list[Array] = []
    outside = np.ones(len(position), dtype=np.bool_)
    for number, face in enumerate(faces):
        inside = is_inside(position, face)
        outside &= ~inside
        names += [("stiffness", number), ("damping", number)]
        parts += [inside * (face[2] - position), inside * -speed]
    stated = stretch.command[:, axis]
    applied = stretch.applied[:, axis]
    command = np.where(np.isfinite(stated), stated, applied) - stretch.metadata.carried[axis]
    outside &= used
    if anchors is not None:
        stuck = np.isfinite(anchors)
        last = anchors[np.maximum.accumulate(np.where(stuck, np.arange(len(stuck)), np.argmax(stuck)))]
        names += [("stuck", 0), ("sliding", 0)]
        parts += [np.where(stuck, anchors - position, 0.0), ~stuck * np.sign(last - position)]
    largest = float(np.abs(command).max())
    if anchors is not None or (outside.any() and np.ptp(command[outside]) > _NOTHING * largest):
        names += [("spring", 0), ("damper", 0)]
        parts += [-position, -speed]
    columns = np.column_stack([*parts, np.ones(len(position))][: len(parts) + bool(outside.sum() > 1)])
    moved = used & np.append(False, np.diff(tick) > 0)
    gram, separate = inverse(columns[moved])
    gains = gram @ (columns[moved].T @ command[moved])
    left = command[moved] - columns[moved] @ gains
    degrees = max(int(moved.sum()) - columns.shape[1], 1)
    residual = max(float(np.sqrt(np.square(left).sum() / degrees)), ROUNDING * largest)
    errors = np.where(separate, residual * np.sqrt(np.maximum(np.diag(gram), 0.0)), np.inf)
    count = len(parts)
    explained = columns[:, :count] @ gains[:count]
    rest = applied - explained
    return CommandedLaw(
        names=names,
        parts=columns[:, :count],
        gains=gains[:count],
        errors=errors[:count],
        residual=residual,
        degrees=degrees,
        scale=float(np.sqrt(np.square(explained[moved]).mean())),
        rest=np.where(np.abs(rest) > _NOTHING * largest, rest, 0.0),
    )


def estimate_quantum(position: Array) -> Estimate:
    """Return the sensor resolution from positions [m, rad].

    It is the step of a lattice with all positions on it.

    Args:
        position: Positions, (N,).
    """
    values = np.unique(position)
    steps = np.diff(values)
    size = float(np.abs(values).max())
    steps = steps[steps > 1e3 * _TINY * size]
    if len(steps) < _LEAST_STEPS:
        return Estimate(why=f"only {len(steps) + 1} different positions")
    for part in range(1, _DIVISORS + 1):
        step = float(steps.min()) / part
        counts = np.rint(values / step)
        if np.abs(counts).max() > 0.0 and np.abs(values / step - counts).max() < 1e2 * _OFF_LATTICE:
            step = float(counts @ values / (counts @ counts))
            counts = np.rint(values / step)
            left = values - step * counts
            if np.abs(left).max() < _OFF_LATTICE * step:
                residual = float(np.sqrt(np.square(left).mean()))
                error = max(residual / math.sqrt(float(counts @ counts)), _TINY * step)
                return Estimate.of(step, error, len(values) - 1, residual)
    return Estimate(why="positions lie on no lattice")


def estimate_noise(motion: Fit, there: Mask, moving: Mask, step: float) -> Estimate:
    """Return the sensor noise before quantization [m, rad].

    It is the standard deviation of white noise.

    The quantization error, step² / 12, is subtracted: it is that of a position, or of noise, moving over many steps.

    Args:
        motion: Fit of the motion.
        there: True for existing samples, (M, W).
        moving: True for samples with motion by more than a step, (M, W).
        step: Step of the sensor; 0 for none.
    """
    left = motion.left[there]
    if np.square(left).mean() < _DITHERED * step**2:  # at rest within a step the noise is rarely visible
        left = motion.left[moving & there]
    if len(left) < _LEAST_MOVING:
        return Estimate(why=f"only {len(left)} samples move over the sensor's steps")
    square = np.square(left)
    mean = float(square.mean())
    spread = max(float(square.std(ddof=1)), math.sqrt(2.0) * mean) / math.sqrt(len(left))
    variance = mean - step * step / 12.0
    # the logarithm of a variance is closer to a normal distribution
    ends = (
        mean * math.exp(sign * _NORMAL * spread / mean) - step * step / 12.0 if mean else 0.0 for sign in (-1.0, 1.0)
    )
    low, high = (math.sqrt(max(end, 0.0)) for end in ends)
    if math.sqrt(mean) < _EXACT:
        return Estimate(why="the forces explain the positions to rounding")
    if low == 0.0:
        return Estimate(why="it hides in the sensor's steps", low=0.0, high=max(high, math.sqrt(spread)))
    value = math.sqrt(variance)
    return Estimate(value=value, standard_error=0.5 * spread / value, low=low, high=high, residual=motion.residual)
