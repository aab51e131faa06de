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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self, TypeAlias

import numpy as np

from maglev_mj.analysis.motion import Numbers
from maglev_mj.frames import Array, Mask
from maglev_mj.recording import Segment
from maglev_mj.recording.sample import Face

_SINGULAR, _ROUNDS = 1e-10, 40
_LEAST_SAMPLES, _WINDOW_TIME = 40, 0.05
_MOST_LEVERAGE = 0.9
_CLEAR = 10.0
"""Least ratio of caused motion to noise for identification."""
_NOT_LINEAR = 0.02
"""Largest residual of a linear law, relative to its commands."""
_SENSOR = 1e-8
"""Residual below that of any sensor [m, rad]."""
_WHITENESS = 0.6
"""Least mean square of the differences of noise, over twice its own mean square; it is lower for residual forces."""
_UNEXPLAINED = 3e-3
"""Least share of motion of a relevant unrecorded force."""
_ROUNDING = 64.0 * float(np.finfo(np.float64).eps)
"""Relative rounding of positions and commands."""
_NOTHING = 1e-9
"""Part of the largest command below which a remainder is rounding, not a force."""
_DITHERED = 1.0 / 12.0 + 0.25
"""Least mean square of a dithered sensor's error, in steps².

From this value on, noise of half a step moves a flotor at rest over several steps.
"""
_OFF_LATTICE, _DIVISORS, _LEAST_STEPS, _LEAST_MOVING = 1e-4, 20, 4, 20
_EXACT, _NORMAL, _TINY = 1e-12, 1.959963984540054, 4.0 * float(np.finfo(np.float64).eps)

Part: TypeAlias = tuple[str, int]
"""Name of a part of a law, and number of its wall."""


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
        why: Reason for a failed identification; empty if it succeeded.
    """

    value: float = math.nan
    standard_error: float = math.nan
    low: float = math.nan
    high: float = math.nan
    residual: float = math.nan
    why: str = ""

    def beyond(self, least: float, most: float) -> bool:
        """Return True for an identified value outside a range."""
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


class Solution(NamedTuple):
    """Linear least-squares solution for P values from N equations.

    Attributes:
        values: The values, (P,).
        gram: Inverse Gram matrix of the columns, (P, P).
        separate: True for linearly independent columns, (P,).
        residuals: Residuals, (N,).
    """

    values: Array
    gram: Array
    separate: Mask
    residuals: Array


def solve(columns: Array, target: Array) -> Solution:
    """Return the least-squares solution of columns @ values = target.

    Dependent columns share their part: the solution with the least norm in units of the columns' sizes.

    Args:
        columns: (N, P).
        target: (N,).
    """
    size = np.sqrt(np.square(columns).sum(axis=0))
    unit = columns / np.where(size > 0.0, size, 1.0)
    eigenvalues, vectors = np.linalg.eigh(unit.T @ unit)
    weak = eigenvalues < _SINGULAR
    separate = (size > 0.0) & ~((np.square(vectors) * weak).sum(axis=1) > _SINGULAR)
    gram = (vectors * np.where(weak, 0.0, 1.0 / np.where(weak, 1.0, eigenvalues))) @ vectors.T
    gram /= np.outer(*[np.where(size > 0.0, size, np.inf)] * 2)
    values = gram @ (columns.T @ target)
    return Solution(values, gram, separate, target - columns @ values)


class Windows(NamedTuple):
    """M windows of up to W samples, without gaps.

    Attributes:
        rows: Indices of the samples, (M, W).
        mask: True for existing samples, (M, W).
        basis: Position and speed at the beginning as two orthonormal columns, (M, W, 2).
    """

    rows: Numbers
    mask: Mask
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
        rows, mask = np.zeros((len(parts), width), dtype=np.intp), np.zeros((len(parts), width), dtype=np.bool_)
        for index, part in enumerate(parts):
            rows[index, : len(part)], mask[index, : len(part)] = part, True
        elapsed = (time[rows] - time[rows[:, :1]]) * mask
        return cls(rows, mask, np.linalg.qr(np.stack([mask.astype(np.float64), elapsed], axis=-1))[0])

    def choose(self, position: Array, most: int) -> Windows:
        """Return the windows with the most curved motion (N,), at most `most` samples in total."""
        count = max(most // max(self.rows.shape[1], 1), 1)
        if len(self.rows) <= count:
            return self
        bent = np.square(self.project(position[self.rows][:, :, None])).sum(axis=(1, 2))
        chosen = np.sort(np.argsort(-bent, kind="stable")[:count])
        return Windows(self.rows[chosen], self.mask[chosen], self.basis[chosen])

    def project(self, values: Array) -> Array:
        """Remove initial position and speed from values (M, W, P)."""
        values = values * self.mask[:, :, None]
        return np.asarray(values - self.basis @ (self.basis.swapaxes(1, 2) @ values))


def unit_integrals(duration: Array) -> Array:
    """Return integral and double integral of a unit force over durations (N,), [s, s²], (N, 2, 1)."""
    return np.stack([duration, 0.5 * duration**2], axis=1)[:, :, None]


@dataclass(frozen=True, kw_only=True, eq=False)
class Forces:
    """P forces on one coordinate over N samples, each to be multiplied by a factor.

    The first S are switched by the commands. Others act without delay: a part of the last switched force, and the
    forces after it.

    Attributes:
        time: Times of the samples [s], (N,).
        switch: Switching times of commands, without their delay [s], (K,).
        levels: Switched forces before the first switch, and after each [N], (K + 1, S).
        prompt: Integral and double integral of the forces without delay, over each period [N s, N s²],
            (N - 1, 2, P - S + 1).
    """

    time: Array
    switch: Array
    levels: Array
    prompt: Array

    def integrals(self, delay: float) -> Array:
        """Return integral and double integral of the forces over each period, (N - 1, 2, P + S).

        The last S columns are the derivatives of the switched forces' integrals with respect to the delay.
        """
        time, switch = self.time, self.switch + delay
        # a switch at a sample belongs to the period after it
        level = self.levels[np.searchsorted(switch, time)]
        inside = (switch >= time[0]) & (switch < time[-1])
        index, jump = np.searchsorted(time, switch[inside], side="right") - 1, np.diff(self.levels, axis=0)[inside]
        duration = np.diff(time)
        switched = unit_integrals(duration) * level[:-1, None]
        np.add.at(switched, index, unit_integrals(time[index + 1] - switch[inside]) * jump[:, None])
        slopes = np.stack([level[:-1] - level[1:], duration[:, None] * level[:-1] - switched[:, 0]], axis=1)
        switched[..., -1] += self.prompt[..., 0]
        return np.concatenate([switched, self.prompt[..., 1:], slopes], axis=2)

    def displace(self, windows: Windows, delay: float) -> tuple[Array, Array]:
        """Return each force's displacement of a unit mass in the windows, (M W, P).

        The derivatives of the first S with respect to the delay are returned too, (M W, S).
        """
        steps = np.minimum(windows.rows[:, :-1], len(self.time) - 2)
        integrals = self.integrals(delay)[steps] * windows.mask[:, 1:, None, None]
        speed, displacement = integrals[:, :, 0], integrals[:, :, 1]
        width = np.diff(self.time)[steps][:, :, None]
        position = np.cumsum(displacement + width * (np.cumsum(speed, axis=1) - speed), axis=1)
        columns = windows.project(np.pad(position, ((0, 0), (1, 0), (0, 0)))).reshape(windows.rows.size, -1)
        switched = self.levels.shape[1]
        return columns[:, :-switched], columns[:, -switched:]


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """Fit of positions by forces.

    Attributes:
        values: Factors of the P forces [1/kg] and, if it was fitted, the delay of the commands [s], (P + 1,).
        covariance: Covariance of the values, (P + 1, P + 1); enlarged if the residuals are not white.
        effects: Largest motion caused by a unit of each value alone [m], (P + 1,); 0 for a value that the others can
            replace.
        residual: Root mean square of the residuals [m].
        degrees: Degrees of freedom.
        residuals: Residuals, scaled to the error of a sample [m], (M, W); 0 for missing samples.
        is_incomplete: True if the residuals are slow changes of relevant size, such as those of a missing force.
    """

    values: Array
    covariance: Array
    effects: Array
    residual: float
    degrees: int
    residuals: Array
    is_incomplete: bool

    def moves(self, index: int, change: float) -> bool:
        """Return whether a change of a value moves the coordinate by clearly more than noise."""
        return bool(self.effects[index] * abs(change) >= _CLEAR * self.residual)

    def estimate(self, value: float, slopes: Mapping[int, float]) -> Estimate:
        """Return an estimate of a function of the values, from its derivatives by their indices."""
        index, weights = list(slopes), np.array(list(slopes.values()))
        variance = float(weights @ self.covariance[np.ix_(index, index)] @ weights)
        return Estimate.of(value, math.sqrt(max(variance, 0.0)), self.degrees, self.residual)


def fit_motion(forces: Forces, windows: Windows, position: Array, delay: float, period: float) -> Fit:
    """Fit positions by forces with unknown factors and delay, by Gauss-Newton steps of the delay.

    Args:
        forces: The forces.
        windows: Windows of the samples.
        position: Positions at the samples [m], (N,).
        delay: First guess at the delay [s].
        period: Sample period [s].
    """
    target = windows.project(position[windows.rows][:, :, None]).ravel()

    def solve_at(delay: float) -> tuple[Solution, Array, float]:
        """Return the solution at a delay, its columns with one for the delay, and its sum of squares."""
        columns, slopes = forces.displace(windows, delay)
        solution = solve(columns, target)
        by_delay = slopes @ solution.values[: slopes.shape[1]]
        return solution, np.column_stack([columns, by_delay]), float(np.square(solution.residuals).sum())

    solution, columns, squares = solve_at(delay)
    for _ in range(_ROUNDS):
        step = float(np.clip(solve(columns, solution.residuals).values[-1], -0.25 * period, 0.25 * period))
        while abs(step) > 1e-9 * period:
            trial = solve_at(delay + step)
            if trial[2] < squares:
                break
            step *= 0.5
        else:
            break
        delay += step
        solution, columns, squares = trial
    return _assess(windows, position, columns, target, solution, delay)


def fit_constant(forces: Forces, windows: Windows, position: Array, delay: float, mass: float) -> Fit:
    """Fit positions by all forces but the first, which has a known delay [s] and moves a known mass [kg].

    Other arguments are those of `fit_motion`.
    """
    columns, _ = forces.displace(windows, delay)
    displacement, columns = columns[:, 0] / mass, columns[:, 1:]
    target = windows.project(position[windows.rows][:, :, None]).ravel() - displacement
    solution = solve(columns, target)
    return _assess(windows, position, columns, target, solution)


def _assess(windows: Windows, position: Array, columns: Array, target: Array, solution: Solution, *delay: float) -> Fit:
    """Return a solution with its errors; the last column is that of a fitted delay."""
    residuals = solution.residuals
    _, gram, separate, _ = solve(columns, residuals)
    count = int(windows.mask.sum())
    degrees = max(count - 2 * len(windows.rows) - int(separate.sum()), 1)
    residual = max(math.sqrt(np.square(residuals).sum() / degrees), _ROUNDING * float(np.abs(position).max()))
    leverage = np.square(windows.basis).sum(axis=2).ravel() + ((columns @ gram) * columns).sum(axis=1)
    scaled = residuals / np.sqrt(1.0 - np.minimum(leverage, _MOST_LEVERAGE))
    inner = windows.mask[:, 1:]
    change = np.square(np.diff(residuals.reshape(windows.rows.shape), axis=1) * inner).sum() / max(int(inner.sum()), 1)
    square = np.square(residuals).sum() / count
    # the mean square of differences is twice that of noise
    is_slow = bool(change < 2.0 * _WHITENESS * square)
    scale = np.diag(gram)
    unit = np.where(scale > 0.0, scale, 1.0)
    enlarged = np.ones(len(unit))
    if is_slow or residual < _SENSOR or count < _LEAST_SAMPLES:
        # residuals of forces or rounding, or too few samples: worst case, all of one sign
        worst = np.abs(columns @ gram).T @ np.abs(residuals)
        enlarged = np.maximum(worst / (residual * np.sqrt(unit)), 1.0)
    # each column's effect, given all others
    effects = np.abs(columns @ (gram / unit)).max(axis=0, initial=0.0)
    return Fit(
        values=np.append(solution.values, delay),
        covariance=gram * residual**2 * np.outer(enlarged, enlarged),
        effects=np.where(separate, effects, 0.0),
        residual=residual,
        degrees=degrees,
        residuals=scaled.reshape(windows.rows.shape) * windows.mask,
        is_incomplete=is_slow and bool(square > _UNEXPLAINED**2 * np.square(target).sum() / count),
    )


class CommandedLaw(NamedTuple):
    """Linear fit of commands by P parts.

    A part is a function of the measured positions; each has a gain.

    Attributes:
        estimates: Gains by the parts' names, such as ("stiffness", 0) for the first face, in order.
        gains: The same gains, identified or not, (P,).
        parts: Values of the parts at unit gain, (N, P).
        rest: Applied commands minus all parts [N, N m], (N,).
    """

    estimates: Mapping[Part, Estimate]
    gains: Array
    parts: Array
    rest: Array


def is_inside(position: Array, face: Face) -> Mask:
    """Return True for positions (N,) in a wall."""
    return np.asarray(face[1] * (position - face[2]) <= 0.0)


def fit_law(segment: Segment, axis: int, faces: Sequence[Face], anchors: Array | None, used: Mask) -> CommandedLaw:
    """Fit the commands on an axis by a law.

    The law is a sum of walls, friction, and a spring and a damper that act everywhere.

    Args:
        segment: N samples.
        axis: Index into AXES.
        faces: Touched walls.
        anchors: Stick positions of the axis [m, rad], (N,); None without friction.
        used: True for samples that count, (N,).
    """
    position, applied, stated = (part[:, axis] for part in (segment.position, segment.applied, segment.command))
    command = np.where(np.isfinite(stated), stated, applied) - segment.metadata.carried[axis]
    largest = float(np.abs(command).max())
    ticks = np.diff(segment.tick)
    speed = np.append(0.0, np.diff(position) / (ticks * segment.metadata.period))
    parts: dict[Part, Array] = {}
    outside = used.copy()
    for index, face in enumerate(faces):
        inside = is_inside(position, face)
        outside &= ~inside
        parts["stiffness", index] = inside * (face[2] - position)
        parts["damping", index] = inside * -speed
    if anchors is not None:
        stuck = np.isfinite(anchors)
        last = anchors[np.maximum.accumulate(np.where(stuck, np.arange(len(stuck)), np.argmax(stuck)))]
        parts["stuck", 0] = np.where(stuck, anchors - position, 0.0)
        parts["sliding", 0] = ~stuck * np.sign(last - position)
    if anchors is not None or (outside.any() and np.ptp(command[outside]) > _NOTHING * largest):
        parts["spring", 0], parts["damper", 0] = -position, -speed
    count = len(parts)
    columns = np.column_stack([*parts.values(), *[np.ones(len(position))] * bool(outside.sum() > 1)])
    moved = used & np.append(False, ticks > 0)
    solution = solve(columns[moved], command[moved])
    degrees = max(int(moved.sum()) - columns.shape[1], 1)
    residual = max(math.sqrt(np.square(solution.residuals).sum() / degrees), _ROUNDING * largest)
    columns, gains = columns[:, :count], solution.values[:count]
    explained = columns @ gains
    is_linear = residual <= _NOT_LINEAR * math.sqrt(np.square(explained[moved]).mean())

    def estimate(index: int) -> Estimate:
        """Return a gain, if the law is linear and the gain separate from others."""
        if not is_linear:
            return Estimate(why=f"commands do not fit a spring and a damper (residual {residual:.2g})")
        if not solution.separate[index]:
            return Estimate(why="confounded with other laws on this axis")
        error = residual * math.sqrt(max(solution.gram[index, index], 0.0))
        return Estimate.of(float(gains[index]), error, degrees, residual)

    return CommandedLaw(
        estimates={name: estimate(index) for index, name in enumerate(parts)},
        gains=gains,
        parts=columns,
        rest=np.where(np.abs(applied - explained) > _NOTHING * largest, applied - explained, 0.0),
    )


def estimate_quantum(position: Array) -> Estimate:
    """Return the sensor resolution [m, rad], the step of the lattice of all positions.

    Args:
        position: Positions, (N,).
    """
    values = np.unique(position)
    steps = np.diff(values)
    size = float(np.abs(values).max())
    steps = steps[steps > 1e3 * _TINY * size]
    if len(steps) < _LEAST_STEPS:
        return Estimate(why=f"only {len(steps) + 1} distinct positions")
    for part in range(1, _DIVISORS + 1):
        step = float(steps.min()) / part
        counts = np.rint(values / step)
        if np.abs(counts).max() > 0.0 and np.abs(values / step - counts).max() < 1e2 * _OFF_LATTICE:
            step = float(counts @ values / (counts @ counts))
            counts = np.rint(values / step)
            error = values - step * counts
            if np.abs(error).max() < _OFF_LATTICE * step:
                residual = float(np.sqrt(np.square(error).mean()))
                standard_error = max(residual / math.sqrt(float(counts @ counts)), _TINY * step)
                return Estimate.of(step, standard_error, len(values) - 1, residual)
    return Estimate(why="positions are not quantized")


def estimate_noise(motion: Fit, windows: Windows, position: Array, step: float) -> Estimate:
    """Return the standard deviation of white sensor noise before quantization [m, rad].

    The quantization error, step² / 12, is subtracted; it assumes motion or noise over many steps.

    Args:
        motion: Fit of the motion.
        windows: Windows of the samples.
        position: Positions at the samples [m, rad], (N,).
        step: Step of the sensor; 0 for none.
    """
    squares = np.square(motion.residuals[windows.mask])
    if squares.mean() < _DITHERED * step**2:  # at rest within a step, noise is rarely visible
        after, before = np.minimum(windows.rows + 1, len(position) - 1), np.maximum(windows.rows - 1, 0)
        moving = np.abs(position[after] - position[before]) > 2.0 * step
        squares = np.square(motion.residuals[moving & windows.mask])
    if len(squares) < _LEAST_MOVING:
        return Estimate(why=f"only {len(squares)} samples move by more than the resolution")
    mean, quantization = float(squares.mean()), step * step / 12.0
    if math.sqrt(mean) < _EXACT:
        return Estimate(why="residual at rounding level")
    spread = max(float(squares.std(ddof=1)), math.sqrt(2.0) * mean) / math.sqrt(len(squares))
    # the logarithm of a variance is closer to a normal distribution
    ends = (mean * math.exp(sign * _NORMAL * spread / mean) - quantization for sign in (-1.0, 1.0))
    low, high = (math.sqrt(max(end, 0.0)) for end in ends)
    if low == 0.0:
        return Estimate(why="below the sensor resolution", low=0.0, high=max(high, math.sqrt(spread)))
    value = math.sqrt(mean - quantization)
    return Estimate(value=value, standard_error=0.5 * spread / value, low=low, high=high, residual=motion.residual)
