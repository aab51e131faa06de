"""Karnopp's stick-slip friction solved exactly: closed form between events, the events found to rounding."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array
from maglev_mj.parameters import number, numbers

__all__ = ["FrictionEvent", "KarnoppMotion", "karnopp"]


Mask: TypeAlias = NDArray[np.bool_]


class FrictionEvent(NamedTuple):
    """A change of state: when, "stick" or "slip", and where."""

    time: float
    kind: str
    position: float


@dataclass(frozen=True, eq=False)
class KarnoppMotion:
    """The exact motion at the times asked for, and every event.

    Attributes:
        time: Times [s], (M,).
        position: Position [m], (M,).
        velocity: Velocity [m/s], (M,).
        stuck: Whether the mass sticks, (M,).
        events: Changes of state, in order.
    """

    time: Array
    position: Array
    velocity: Array
    stuck: Mask
    events: tuple[FrictionEvent, ...]


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
    """Solve m x'' = f_ext - k_v x' + f_stick for a mass pulled by a spring, f_ext = spring (target - x).

    The mass is at rest and stuck at 0 at first. STUCK, f_stick = -f_ext, and the mass is at rest; it breaks away
    where |f_ext| > breakaway. SLIDING, f_stick = 0; it sticks, its speed set to 0, where |x'| < v_min and
    |f_ext| <= breakaway. Without the second condition it would stick again at the instant of breakaway.

    Args:
        time: Times asked for [s], ascending, (M,).
        targets: When the spring's far end jumps and where to [s, m], ascending; the first from time 0.
        spring: Spring stiffness [N/m], above 0.
        damping: Viscous damping while sliding k_v [N s/m].
        breakaway: Breakaway force [N], above 0.
        v_min: Speed below which the mass sticks [m/s], above 0.
        mass: Mass [kg], above 0.

    Raises:
        ParameterError: If a value is outside its bounds.

    Source: Karnopp 1985; Salcudean & Vlaar 1997, eq. (10)-(11).
    """
    times = np.atleast_1d(numbers("time", time, at_least=0.0))
    if times.ndim > 1 or (np.diff(times) < 0.0).any():
        raise ParameterError("time must be (M,) and ascending")
    starts = [number("target time", start, at_least=0.0) for start, _ in targets]
    if not starts or starts[0] != 0.0 or sorted(set(starts)) != starts:
        raise ParameterError(f"targets must start at 0 and ascend in time, not {starts}")
    k, m = number("spring", spring, above=0.0), number("mass", mass, above=0.0)
    b = number("damping", damping, at_least=0.0)
    limit, slow = number("breakaway", breakaway, above=0.0), number("v_min", v_min, above=0.0)
    slide = _sliding(k, b, m)
    scan = 0.005 * min(math.sqrt(m / k), m / b if b > 0.0 else math.inf)
    end = float(times[-1]) if times.size else 0.0

    position, velocity, stuck = np.zeros_like(times), np.zeros_like(times), np.ones(times.shape, dtype=np.bool_)
    events: list[FrictionEvent] = []
    x, v, sticks = 0.0, 0.0, True
    for place, (start, target) in enumerate(targets):
        stop = min(targets[place + 1][0] if place + 1 < len(targets) else math.inf, end)
        now = start
        if sticks and abs(k * (target - x)) > limit:
            sticks = False
            events.append(FrictionEvent(now, "slip", x))
        if not sticks:

            def rests(at: Array, x: float = x, v: float = v, target: float = target) -> Mask:
                offset, speed = slide(x - target, v, at)
                return (np.abs(speed) < slow) & (np.abs(k * offset) <= limit)

            length = _first(rests, scan, stop - now)
            here = (times >= now) & (times <= min(now + length, stop))
            offset, speed = slide(x - target, v, times[here] - now)
            position[here], velocity[here], stuck[here] = target + offset, speed, False
            offset, speed = slide(x - target, v, np.array([min(length, stop - now)]))
            x, v = float(target + offset[0]), float(speed[0])
            if length <= stop - now:
                now, v, sticks = now + length, 0.0, True
                events.append(FrictionEvent(now, "stick", x))
        if sticks:
            here = (times > now) & (times <= stop) if events else (times <= stop)
            position[here], velocity[here], stuck[here] = x, 0.0, True
        if stop >= end:
            break
    return KarnoppMotion(times, position, velocity, stuck, tuple(events))


def _sliding(k: float, b: float, m: float) -> Callable[[float, float, Array], tuple[Array, Array]]:
    """Return the map from offset and speed to those a time later, for m x'' = -k x - b x'."""
    decay = 0.5 * b / m
    root = complex(decay * decay - k / m) ** 0.5

    def slide(offset: float, speed: float, time: Array) -> tuple[Array, Array]:
        angle = root * time
        even = np.cosh(angle)
        odd = time * np.where(np.abs(angle) > 1e-12, np.sinh(angle) / np.where(angle == 0.0, 1.0, angle), 1.0)
        fade = np.exp(-decay * time)
        moved = fade * (offset * even + (speed + decay * offset) * odd)
        faster = fade * (speed * even - (decay * speed + k / m * offset) * odd)
        return moved.real, faster.real

    return slide


def _first(holds: Callable[[Array], Mask], scan: float, longest: float) -> float:
    """Return when a condition first holds: scanned, then bisected to rounding; infinity if not by `longest`."""
    for start in np.arange(0.0, longest, 256 * scan):
        grid = start + scan * np.arange(0, 257)
        found = np.flatnonzero(holds(grid))
        if found.size:
            high = float(grid[found[0]])
            low = max(high - scan, 0.0)
            for _ in range(60):
                middle = 0.5 * (low + high)
                if holds(np.array([middle]))[0]:
                    high = middle
                else:
                    low = middle
            return high if high <= longest else math.inf
    return math.inf
