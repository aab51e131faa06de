"""Exact motions of ideal laws: a drop on the analog wall, and Karnopp's stick-slip friction.

Both are a closed form between events, whose times are exact to rounding.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array, Mask
from maglev_mj.keywords import checked
from maglev_mj.parameters import number, numbers
from maglev_mj.spec import GRAVITY
from maglev_mj.theory.loop_array import bisect

_HALVINGS = 60


@checked
def analog_wall(
    time: ArrayLike,
    *,
    height: float,
    stiffness: float,
    damping: float,
    mass: float,
    bandwidth: float = 10e3,
    gravity: float = GRAVITY,
) -> tuple[Array, Array, Array]:
    """Simulate a drop on the ideal analog wall of eq. (1), whose force passes a first-order low-pass.

    The motion is a closed form inside the wall (three modes) and outside it (free fall with a decaying force); crossing
    times are exact to rounding.

    Args:
        time: Times since release [s], ascending, (M,).
        height: Drop height above the wall at z = 0 [m].
        stiffness: Wall stiffness [N/m].
        damping: Wall damping [N s/m].
        mass: Falling mass [kg].
        bandwidth: Cut-off of the low-pass [Hz].
        gravity: Acceleration of free fall [m/s²].

    Returns:
        Height [m], velocity [m/s] and wall force [N], (M,) each.

    Raises:
        ParameterError: If a value is outside its bounds.

    Source: Salcudean & Vlaar 1997, eq. (1) and figure 4.
    """
    times = _ascending(time)
    k, b = number("stiffness", stiffness, above=0.0), number("damping", damping, at_least=0.0)
    m, g = number("mass", mass, above=0.0), number("gravity", gravity, above=0.0)
    rate = 2.0 * math.pi * number("bandwidth", bandwidth, above=0.0)
    inside, outside = _in_wall(k, b, m, g, rate), _in_air(m, g, rate)
    scan = 0.02 * min(math.sqrt(m / k), math.sqrt(2.0 * number("height", height, above=0.0) / g))
    state, start, end = np.array([height, 0.0, 0.0]), 0.0, float(times[-1]) if times.size else 0.0
    out = np.empty((times.size, 3))
    touching = False
    while True:
        motion = inside if touching else outside
        leave = _next_crossing(motion, state, scan, end - start, touching)
        during = (times >= start) & (times <= start + leave)
        out[during] = motion(state, times[during] - start)
        if start + leave >= end:
            return out[:, 0], out[:, 1], out[:, 2]
        state, start, touching = motion(state, np.array([leave]))[0], start + leave, not touching
        state[0] = 0.0


def _ascending(time: ArrayLike) -> Array:
    times = np.atleast_1d(numbers("time", time, at_least=0.0))
    if times.ndim > 1 or (np.diff(times) < 0.0).any():
        raise ParameterError("time must be one-dimensional and ascending")
    return times


Motion = Callable[[Array, Array], Array]
"""Function from a state (z, v, f) and times (M,) to states (M, 3)."""


def _in_wall(k: float, b: float, m: float, g: float, rate: float) -> Motion:
    matrix = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0 / m], [-rate * k, -rate * b, -rate]])
    values, vectors = np.linalg.eig(matrix)
    inverse = np.linalg.inv(vectors)
    equilibrium = np.array([-m * g / k, 0.0, m * g])

    def motion(state: Array, time: Array) -> Array:
        modes = inverse @ (state - equilibrium) * np.exp(np.multiply.outer(time, values))
        return np.asarray(equilibrium + (modes @ vectors.T).real)

    return motion


def _in_air(m: float, g: float, rate: float) -> Motion:
    def motion(state: Array, time: Array) -> Array:
        z, v, f = state
        decayed = -np.expm1(-rate * time)
        push = f / (m * rate)
        height = z + time * (v - 0.5 * g * time) + push * (time - decayed / rate)
        return np.stack([height, v - g * time + push * decayed, f * (1.0 - decayed)], axis=-1)

    return motion


def _next_crossing(motion: Motion, state: Array, scan: float, longest: float, inside: bool) -> float:
    """Return the time until z changes sign, at most `longest`, by a scan and bisection to rounding."""
    sign = -1.0 if inside else 1.0
    for start in np.arange(0.0, longest, 256 * scan):
        grid = start + scan * np.arange(1, 258)
        out = np.flatnonzero(sign * motion(state, grid)[:, 0] < 0.0)
        if out.size:
            high = grid[out[:1]]
            crossing = bisect(lambda time: sign * motion(state, time)[:, 0] < 0.0, high - scan, high, _HALVINGS)
            return min(float(crossing[0]), longest)
    return longest


class FrictionEvent(NamedTuple):
    """Change of the friction state: time [s], "stick" or "slip", position [m]."""

    time: float
    kind: str
    position: float


@dataclass(frozen=True, eq=False)
class KarnoppMotion:
    """Exact motion at requested times, with all events.

    Attributes:
        time: Times [s], (M,).
        position: Position [m], (M,).
        velocity: Velocity [m/s], (M,).
        stuck: True while the mass sticks, (M,).
        events: Changes of the friction state, in order.
    """

    time: Array
    position: Array
    velocity: Array
    stuck: Mask
    events: tuple[FrictionEvent, ...]


@checked
def karnopp(
    time: ArrayLike,
    *,
    targets: Sequence[tuple[float, float]],
    spring: float,
    damping: float,
    breakaway: float,
    v_min: float,
    mass: float,
) -> KarnoppMotion:
    """Solve the motion of a mass with Karnopp friction.

    m x'' = f_ext - k_v x' + f_stick, with the spring force f_ext = spring (target - x).

    The mass starts at 0, at rest and stuck. Stuck: f_stick = -f_ext, until abs(f_ext) > breakaway. Sliding:
    f_stick = 0, until abs(x') < v_min and abs(f_ext) <= breakaway, when the speed is set to 0. Without the second
    condition it would stick again at the instant of breakaway.

    Args:
        time: Times of the result [s], ascending, (M,).
        targets: Times and positions of the spring's far end after each jump [s, m], ascending; the first at time 0.
        spring: Spring stiffness [N/m], above 0.
        damping: Viscous damping while sliding k_v [N s/m].
        breakaway: Breakaway force [N], above 0.
        v_min: Speed below which the mass sticks [m/s], above 0.
        mass: Mass [kg], above 0.

    Raises:
        ParameterError: If a value is outside its bounds.

    Source: Karnopp 1985; Salcudean & Vlaar 1997, eq. (10)-(11).
    """
    times = _ascending(time)
    starts = [number("target time", start, at_least=0.0) for start, _ in targets]
    ends = [number("target", target) for _, target in targets]
    if not starts or starts[0] != 0.0 or sorted(set(starts)) != starts:
        raise ParameterError(f"target times must start at 0 and ascend (got {starts})")
    k, m = number("spring", spring, above=0.0), number("mass", mass, above=0.0)
    b = number("damping", damping, at_least=0.0)
    limit, slow = number("breakaway", breakaway, above=0.0), number("v_min", v_min, above=0.0)
    slide = _sliding(k, b, m)
    scan = 0.005 * math.sqrt(m / k)
    end = float(times[-1]) if times.size else 0.0

    position, velocity, stuck = np.zeros_like(times), np.zeros_like(times), np.ones(times.shape, dtype=np.bool_)
    events: list[FrictionEvent] = []
    x, v, sticks = 0.0, 0.0, True
    for index, (start, target) in enumerate(zip(starts, ends, strict=True)):
        if start > end:
            break
        # a sample at a jump belongs to the interval that begins there
        stop = starts[index + 1] if index + 1 < len(starts) else math.inf
        now = start
        if sticks and abs(k * (target - x)) > limit:
            sticks = False
            events.append(FrictionEvent(now, "slip", x))
        if not sticks:
            move = functools.partial(slide, x - target, v)
            length = _first_stick_time(move, slow, limit / k, scan, min(stop, end) - now)
            during = (times >= now) & (times < min(now + length, stop))
            offset, speed = move(times[during] - now)
            position[during], velocity[during], stuck[during] = target + offset, speed, False
            offset, speed = move(np.array([min(length, min(stop, end) - now)]))
            x, v = float(target + offset[0]), float(speed[0])
            if math.isfinite(length):
                now, v, sticks = now + length, 0.0, True
                events.append(FrictionEvent(now, "stick", x))
        if sticks:
            during = (times >= now) & (times < stop)
            position[during], velocity[during], stuck[during] = x, 0.0, True
    return KarnoppMotion(times, position, velocity, stuck, tuple(events))


def _sliding(k: float, b: float, m: float) -> Callable[[float, float, Array], tuple[Array, Array]]:
    """Return the solution of m x'' = -k x - b x': offset and speed to those a time later.

    Separate forms for overdamped, critically damped and underdamped motion, without growing terms.
    """
    decay, square = 0.5 * b / m, (0.5 * b / m) ** 2 - k / m
    rate = math.sqrt(abs(square))

    def slide(offset: float, speed: float, time: Array) -> tuple[Array, Array]:
        if square > 0.0:
            fast = decay + rate
            slow = k / m / fast  # decay - rate without its cancellation
            slow_mode, fast_mode = np.exp(-slow * time), np.exp(-fast * time)
            odd = -slow_mode * np.expm1(-(fast - slow) * time) / (fast - slow)
            even = 0.5 * (slow_mode + fast_mode)
        elif square < 0.0:
            fade = np.exp(-decay * time)
            odd, even = fade * np.sin(rate * time) / rate, fade * np.cos(rate * time)
        else:
            even = np.exp(-decay * time)
            odd = time * even
        moved = offset * even + (speed + decay * offset) * odd
        return moved, speed * even - (decay * speed + k / m * offset) * odd

    return slide


def _first_stick_time(
    move: Callable[[Array], tuple[Array, Array]], slow: float, reach: float, scan: float, longest: float
) -> float:
    """Return the first time with a speed below `slow` and an offset within `reach`; infinity if later than `longest`.

    Scanned on a grid, then bisected to rounding. Turning points between grid points are checked separately, because the
    speed may be small there for much less than a grid step.
    """

    def rests(time: Array) -> Mask:
        offset, speed = move(time)
        return (np.abs(speed) < slow) & (np.abs(offset) <= reach)

    for start in np.arange(0.0, longest, 256 * scan):
        grid = start + scan * np.arange(0, 257)
        _, speed = move(grid)
        sticks = rests(grid)
        turns = np.append(speed[:-1] * speed[1:] < 0.0, False)
        for index in np.flatnonzero(sticks | turns):
            low = high = grid[index : index + 1]
            if sticks[index]:
                low = np.maximum(high - scan, 0.0)
            else:
                turned = functools.partial(_has_turned, move, float(speed[index]))
                high = bisect(turned, low, low + scan, _HALVINGS)
                if not rests(high)[0]:
                    continue
            first = float(bisect(rests, low, high, _HALVINGS)[0])
            return first if first <= longest else math.inf
    return math.inf


def _has_turned(move: Callable[[Array], tuple[Array, Array]], speed: float, time: Array) -> Mask:
    return np.asarray(move(time)[1] * speed <= 0.0)
