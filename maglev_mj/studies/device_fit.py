"""Mass, delay, own damping and friction of a device from one log of its ringing, with their confidence region.

The law is known, so the log gives its commands exactly, with the sensor's noise and steps. What is left is an open-loop
fit (output error, Ljung 1999; not checked against the original) whose residual is that of the sensor alone, so neither
the loop nor the steps bias it. With a = b/m and d the delay, x'' + a x' = (u(t - d) - f sign(x') + w)/m is linear in
1/m, f/m, w/m and the initial state, so that least squares is exact at each (d, a), and the region is that of two
values. Its ends are found along rays, as it has corners at whole periods of delay and is a valley in (d, a).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from maglev_mj.frames import Array

MOST_SAMPLES = 3000
"""Samples used of a longer log: those after its start, which tell most."""
LONGEST_DELAY = 10
"""Periods of delay searched, as by `recorded_loop.explain`."""
_DELAYS = (np.arange(4 * LONGEST_DELAY) + 0.5) / 4.0
_RATES = np.array([0.0, 1e-3, 3e-3, 1e-2, 3e-2, 0.1, 0.3])
"""Starts: delays in periods, and own damping over mass, per period."""
_STARTS, _STEPS, _PATTERNS = 3, 30, 3
"""Starts refined, most Gauss-Newton steps, and fits with renewed reversals of friction."""
_SHIFT, _LEAST_STEP = 1e-5, 1e-7
_SHARES = np.array([1.0, 0.5, 0.2, 0.05, 0.01])
"""Shares of a Gauss-Newton step that are tried together."""
_RAYS, _HALVINGS, _WIDEST = 24, 14, 60.0
"""Rays of the region, bisections of its end on each, and its largest half width, in standard errors."""
_INSIDE = np.array([0.25, 0.5, 0.75, 1.0])
"""Points on a ray, as shares of its length."""
_LAGS = 8
"""Lags at which the residual's correlation reduces the number of independent samples."""
INTERVAL, REGION = 1.959963984540054**2, 9.0
"""Levels of N ln(S/S0): the 95 % interval of one value, and three standard errors, where gains are designed."""


class Ring(NamedTuple):
    """Motion under a known law.

    Attributes:
        position: Positions [m, rad], (N,).
        command: Commands of the samples, (M + N,), the M earlier ones first [N, N m].
        complete: True if the first command was in effect before; otherwise a constant one is fitted.
        period: Sample period [s].
    """

    position: Array
    command: Array
    complete: bool
    period: float


class Points(NamedTuple):
    """Least-squares solutions at G delays and own dampings over mass.

    Attributes:
        delay: In periods, (G,).
        rate: Own damping over mass, per period, (G,).
        squares: Sum of squared residuals [m²], (G,).
        inverse: Inverse mass [1/kg], (G,).
        error: Its standard error at unit noise, (G,).
    """

    delay: Array
    rate: Array
    squares: Array
    inverse: Array
    error: Array

    def rows(self, index: list[int]) -> Points:
        """Return some of them."""
        return Points(*(part[index] for part in self))


def _integrals(rate: Array, time: Array) -> tuple[Array, Array, Array]:
    """Return exp(-a t), its integral and double integral over a time, broadcast."""
    turn = rate * time
    near = np.abs(turn) < 0.02
    safe = np.where(near, 1.0, rate)
    first = np.where(near, time * (1.0 - turn / 2.0 * (1.0 - turn / 3.0 * (1.0 - turn / 4.0 * (1.0 - turn / 5.0)))),
                     -np.expm1(-turn) / safe)  # fmt: skip
    second = np.where(
        near, time**2 * (0.5 - turn / 6.0 * (1.0 - turn / 4.0 * (1.0 - turn / 5.0 * (1.0 - turn / 6.0)))),
        (time - first) / safe)  # fmt: skip
    return np.exp(-turn), first, second


def _steps(rate: Array, switch: Array, before: Array, after: Array) -> tuple[Array, Array]:
    """Return the changes of speed and position in a period by a force that switches at a share of it, (G, N) each."""
    _, first, double = _integrals(rate, switch)
    decay, rest, double_rest = _integrals(rate, 1.0 - switch)
    return decay * first * before + rest * after, (double + rest * first) * before + double_rest * after


def _switched(ring: Ring, index: Array, share: Array, rate: Array) -> tuple[Array, Array]:
    """Return the changes by the commands in effect from a share of each period on, and by those before them."""
    levels = np.concatenate([[ring.command[0] if ring.complete else 0.0], ring.command])
    before, after = (levels[np.maximum(one, -1) + 1] for one in (index - 1, index))
    return _steps(rate, share, before, after)


def _reversals_of(position: Array) -> Array:
    """Return the direction of motion at each sample but the last, and the share of the period at which it reverses."""
    speed = np.gradient(position)
    sign = np.where(speed >= 0.0, 1.0, -1.0)
    with np.errstate(all="ignore"):
        share = np.where(sign[1:] != sign[:-1], speed[:-1] / (speed[:-1] - speed[1:]), 1.0)
    return np.array([sign[:-1], share])


def _measured_reversals(position: Array, turns: Sequence[int]) -> Array:
    """Return the same of measured positions, by parabolas through their extremes."""
    count = len(position)
    sign, share = np.ones(count), np.ones(count)
    ends = [0, *turns, count - 1]
    for first, last in pairwise(ends):
        sign[first:last] = 1.0 if position[last] >= position[first] else -1.0
    for turn in turns:
        if 0 < turn < count - 1:
            before, at, after = position[turn - 1 : turn + 2]
            bend = before - 2.0 * at + after
            shift = 0.5 * (before - after) / bend if bend else 0.0
            if shift < 0.0:  # before the sample: it moves the other way already
                share[turn - 1] = 1.0 + max(shift, -1.0)
            else:
                sign[turn], share[turn] = sign[turn - 1], min(shift, 1.0)
    return np.array([sign[:-1], share[:-1]])


@dataclass(frozen=True, eq=False)
class DeviceFit:
    """Output-error fit of a ring; periods are the unit of time inside.

    Attributes:
        ring: The ring.
        own_damping: Own damping that is stated [N s/m, N m s/rad]; None if it is fitted.
        rounding: Least noise [m, rad], which is added to the squares.
        reversals: Direction of motion at each sample, and the share of the period at which it reverses, (2, N - 1);
            None without friction.
    """

    ring: Ring
    own_damping: float | None = None
    rounding: float = 0.0
    reversals: Array | None = None

    def columns(self, delay: Array, rate: Array, *, spring: bool = False) -> Array:
        """Return the displacement by a unit of each linear value, (G, N, P): 1/m, state, constant, and others."""
        ring, count, groups = self.ring, len(self.ring.position), len(delay)
        lead = len(ring.command) - count
        whole = np.floor(delay).astype(int)
        share, slow = (delay - whole)[:, None], rate[:, None]
        index = np.arange(count - 1) + lead - whole[:, None]
        driven = [_switched(ring, index, share, slow)]
        if not ring.complete:  # a level before the first command
            driven.append(_steps(slow, share, 1.0 * (index < 1), 1.0 * (index < 0)))
        if self.reversals is not None:
            sign, at = self.reversals
            driven.append(_steps(slow, np.broadcast_to(at, index.shape), -sign, sign * (at < 1.0)))
        if spring:
            middle = -0.5 * (ring.position[1:] + ring.position[:-1]) + ring.position[0]
            driven.append(_steps(slow, np.ones_like(share), middle, middle))
        speeds, moves = (np.stack([one[part] * np.ones(index.shape) for one in driven], -1) for part in (0, 1))
        decay, first, _ = (part[..., None] for part in _integrals(slow[:, 0], np.ones(groups)))
        position, speed = np.zeros((2, groups, len(driven)))
        result = np.zeros((count, groups, len(driven)))
        for at in range(count - 1):
            position = position + first * speed + moves[:, at]
            speed = decay * speed + speeds[:, at]
            result[at + 1] = position
        _, ramp, parabola = _integrals(slow, np.arange(float(count)))
        still = np.stack([np.ones_like(ramp), ramp, parabola], axis=-1)
        return np.concatenate([result.swapaxes(0, 1)[..., :1], still, result.swapaxes(0, 1)[..., 1:]], axis=-1)

    def solve(self, delay: Array, rate: Array, *, spring: bool = False) -> tuple[Array, Array, Array]:
        """Return values (G, P), inverse Gram matrices (G, P, P) and residuals (G, N) at delays and rates (G,)."""
        columns, target = self.columns(delay, rate, spring=spring), self.ring.position - self.ring.position[0]
        size = np.sqrt(np.square(columns).sum(axis=1, keepdims=True))
        size = np.where(size > 0.0, size, 1.0)
        q, r = np.linalg.qr(columns / size)
        r = r + 1e-12 * np.eye(r.shape[-1])  # a column that others replace
        inverse = np.linalg.inv(r) / size.swapaxes(1, 2)
        along = target @ q
        return (
            (inverse @ along[..., None])[..., 0],
            inverse @ inverse.swapaxes(1, 2),
            target - (q @ along[..., None])[..., 0],
        )

    def points(self, delay: Array, rate: Array) -> Points:
        """Return the solutions at delays and rates (G,)."""
        if self.own_damping is not None:  # a = b/m, of the mass that it gives
            rate = np.zeros_like(rate)
            for _ in range(4 * bool(self.own_damping)):
                inverse = self.solve(delay, rate)[0][:, 0]
                rate = self.own_damping * self.ring.period * np.maximum(inverse, 0.0) * self._unit
        values, gram, rest = self.solve(delay, rate)
        inverse, error = values[:, 0] * self._unit, np.sqrt(gram[:, 0, 0]) * self._unit
        squares = np.square(rest).sum(axis=-1) + rest.shape[-1] * self.rounding**2
        return Points(delay, rate, np.where(inverse > 0.0, squares, np.inf), inverse, error)

    @property
    def _unit(self) -> float:
        return 1.0 / self.ring.period**2

    def best(self, delay: Array, rate: Array) -> Points:
        """Return the least squares from some starts, by Gauss-Newton steps of which several shares are tried, (1,)."""
        tried = self.points(delay, rate)
        order = np.argsort(tried.squares)[:_STARTS]
        found = [self._refined(tried.rows([int(at)])) for at in order]
        return min(found, key=lambda one: float(one.squares[0]))

    def _slopes(self, at: Points) -> tuple[Array, Array]:
        """Return the residuals at a point (N,), and their slopes by its free values (N, F): projected ones."""
        steps = np.array([[0.0, 0.0], [_SHIFT, 0.0], [0.0, _SHIFT]])[: 2 + self._free]
        rest = self.solve(*self._bounded(np.array([at.delay[0], at.rate[0]]) + steps))[2]
        return rest[0], (rest[1:] - rest[0]).T / _SHIFT

    @property
    def _free(self) -> int:
        """1 if own damping is fitted."""
        return int(self.own_damping is None)

    def _bounded(self, values: Array) -> tuple[Array, Array]:
        """Return delays and rates within their bounds."""
        return np.clip(values[:, 0], 0.0, LONGEST_DELAY), np.maximum(values[:, 1], 0.0)

    def _refined(self, at: Points) -> Points:
        for _ in range(_STEPS):
            rest, slopes = self._slopes(at)
            gram = slopes.T @ slopes
            damped = gram + 1e-12 * np.trace(gram) * np.eye(len(gram))
            step = np.pad(-np.linalg.solve(damped, slopes.T @ rest), (0, 1 - self._free))
            step = step / max(float(np.abs(step / np.array([1.0, 0.1])).max()), 1.0)
            here = np.array([at.delay[0], at.rate[0]])
            alone = np.array([[step[0], 0.0], [0.0, step[1]]])  # at a bound, or a corner, of the other one
            trials = self.points(*self._bounded(here + np.concatenate([_SHARES[:, None] * step, alone])))
            least = int(np.argmin(trials.squares))
            if not trials.squares[least] < at.squares[0]:
                break
            gain = 1.0 - trials.squares[least] / at.squares[0]
            at = trials.rows([least])
            if gain < _LEAST_STEP:
                break
        return at

    def reversed_at(self, at: Points) -> DeviceFit:
        """Return the fit with the friction of the motion at a point."""
        columns, (values, _, _) = self.columns(at.delay, at.rate)[0], self.solve(at.delay, at.rate)
        return replace(self, reversals=_reversals_of(columns @ values[0]))

    def fitted(self, turns: Sequence[int]) -> tuple[DeviceFit, Points]:
        """Return the fit with friction, unless it is not above 0, and its best point, (1,).

        Args:
            turns: Indices of the extremes of the positions, from which the directions of motion start.
        """
        grid = np.stack(np.meshgrid(_DELAYS, _RATES), axis=-1).reshape(-1, 2).T
        own = replace(self, reversals=_measured_reversals(self.ring.position, turns))
        best = own.best(*grid)
        for _ in range(_PATTERNS):
            own = own.reversed_at(best)
            best = own.best(best.delay, best.rate)
        if own.friction(best)[0][0] > 0.0:
            return own, best
        return self, self.best(*grid)

    def friction(self, at: Points) -> tuple[Array, Array]:
        """Return dry friction at points, and its standard error at unit noise [N, N m], (G,) each; 0 without it."""
        if self.reversals is None:
            return np.zeros(len(at.delay)), np.zeros(len(at.delay))
        values, gram, _ = self.solve(at.delay, at.rate)
        return values[:, -1] / values[:, 0], np.sqrt(gram[:, -1, -1]) / values[:, 0]

    def residual(self, at: Points) -> Array:
        """Return the residuals at a point [m, rad], (N,)."""
        return np.asarray(self.solve(at.delay, at.rate)[2][0])

    def spring(self, at: Points) -> tuple[float, float]:
        """Return the stiffness of a spring beside the law, and its standard error at unit noise [N/m, N m/rad].

        Delay and own damping are refitted with it, to first order.
        """
        steps = np.array([[0.0, 0.0], [_SHIFT, 0.0], [0.0, _SHIFT]])[: 2 + self._free]
        places = self._bounded(np.array([at.delay[0], at.rate[0]]) + steps)
        values, _, rest = self.solve(*places)
        every = np.concatenate([self.columns(*(part[:1] for part in places), spring=True)[0],
                                (rest[1:] - rest[0]).T / _SHIFT], axis=1)  # fmt: skip
        size = np.sqrt(np.square(every).sum(axis=0))
        gram = np.linalg.pinv((every / size).T @ (every / size), rcond=1e-13) / np.outer(size, size)
        column = every.shape[1] - 1 - len(steps[1:])
        found, inverse = gram @ (every.T @ rest[0]), values[0, 0]
        return float(found[column] / inverse), float(math.sqrt(gram[column, column]) / inverse)

    def region(self, best: Points, deviance: float, count: float) -> Points:
        """Return points with N ln(S/S0) up to a deviance, along rays from the best one and at it."""
        _, slopes = self._slopes(best)
        noise = math.sqrt(float(best.squares[0]) / count)
        angles = 2.0 * np.pi * np.arange(_RAYS) / _RAYS
        turn = np.stack([np.cos(angles), np.sin(angles)], axis=-1) if self._free else np.array([[1.0], [-1.0]])
        values, vectors = np.linalg.eigh(slopes.T @ slopes)
        rays = turn @ (vectors * (noise / np.sqrt(np.maximum(values, 1e-12 * values.max())))).T
        if self._free:  # along the bounds, too
            size = noise / np.sqrt(np.maximum(np.square(slopes).sum(axis=0), 1e-300))
            rays = np.concatenate([rays, np.diag(size), -np.diag(size)])
        else:
            rays = np.pad(rays, ((0, 0), (0, 1)))
        here = np.array([best.delay[0], best.rate[0]])
        ends = np.where(rays < 0.0, here / np.maximum(-rays, 1e-300), np.inf)
        most = np.minimum(np.min(ends, axis=1), _WIDEST)
        low, high = np.zeros(len(rays)), most
        for step in range(_HALVINGS):
            middle = high if step == 0 else np.where(low == high, high, 0.5 * (low + high))
            found = self.points(*self._bounded(here + middle[:, None] * rays))
            inside = count * np.log(found.squares / best.squares[0]) <= deviance
            low, high = np.where(inside, middle, low), np.where(inside, high, middle)
        shares = (low[:, None] * _INSIDE).reshape(-1, 1)
        every = here + shares * np.repeat(rays, len(_INSIDE), axis=0)
        return self.points(*self._bounded(np.concatenate([here[None], every])))


def independent(rest: Array) -> float:
    """Return the number of independent samples of residuals: less than N by their correlation at the first lags."""
    power = float(rest @ rest)
    sums = np.cumsum([float(rest[lag:] @ rest[:-lag]) / power for lag in range(1, min(_LAGS, len(rest) - 1) + 1)])
    return float(len(rest) / max(1.0 + 2.0 * sums.max(initial=0.0), 1.0))
