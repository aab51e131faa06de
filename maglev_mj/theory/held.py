"""Verdict on a loop free and in each hand, and the time until a released handle leaves its range."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.frames import AXES, Array, unit_of
from maglev_mj.lazy import loaded
from maglev_mj.plants.hand import HANDS, Hand, get_hand, transition
from maglev_mj.result import plain
from maglev_mj.spec import LEVER_ARM, RANGE
from maglev_mj.theory.loop import Bound, Loop, Loops, linear_matrices
from maglev_mj.theory.loop_array import LoopArray, is_stable
from maglev_mj.theory.two_rates import rates_of

FORCE = 1.0
"""Force with which a handle is held still before it is released [N]; a torque of it on the lever arm for rotations."""

FREE, OWN = "free", "own hand"
"""Names of the free flotor, and of a hand of the scene or loop that is not a published one."""

_WORDS = {True: "stable", False: "unstable", None: "not computed"}


class Driven(NamedTuple):
    """Map of a free loop over a period, whose first states are the positions.

    Attributes:
        matrix: The map, (n, n).
        push: Its response to a constant unit force along each axis, (A, n).
        period: The period [s].
        frequency: Frequency of its dominant pole [Hz].
    """

    matrix: Array
    push: Array
    period: float
    frequency: float


def _driven(loop: Loop) -> Driven:
    """Return the map of a free loop."""
    if loop.linear is None:
        array = loop.array()
        forced = array.driven(loop.stiffness, loop.damping)
        host = 1 if loop.device is None else rates_of(loop.period, loop.device).host
        frequency = array.pole(loop.stiffness, loop.damping)[1]
        return Driven(forced.matrix, forced.inputs[None], loop.period * host, frequency)
    (matrix,), inertia = linear_matrices([loop]), np.array(loop.body)[list(loop.linear.axes)]
    _, push = transition(*LoopArray(mass=inertia, driver_lag=loop.driver_lag).motion(), loop.period)
    count = len(inertia)
    inputs = np.zeros((count, len(matrix)))
    for index in range(count):  # states of `linear_matrices`: first all positions, then all speeds
        inputs[index, index : count * push.shape[-2] : count] = push[index, :, 1]
    poles = np.linalg.eigvals(matrix)
    frequency = abs(float(np.angle(poles[np.argmax(np.abs(poles))]))) / (2.0 * np.pi * loop.period)
    return Driven(matrix, inputs, loop.period, frequency)


class Release(NamedTuple):
    """Motion of a handle that was held still with a force and is released.

    Attributes:
        axis: Name of its axis.
        force: The force [N, N m].
        rest: Displacement by it [m, rad].
        reach: Range of motion [m, rad].
        frequency: Ringing frequency [Hz]; 0 for a motion that does not oscillate.
        time: Time until it leaves the range [s]: 0 if it is outside at rest.
        uncertainty: Half a period of the ringing [s]: it leaves up to that much later.
    """

    axis: str
    force: float
    rest: float
    reach: float
    frequency: float
    time: float
    uncertainty: float

    @property
    def words(self) -> str:
        """The motion in words."""
        reach = f"{1e3 * self.reach:.3g} {unit_of('mm', self.axis)}"
        force = f"{self.force:g} {unit_of('N', self.axis)}"
        rings = f"rings at {self.frequency:.3g} Hz" if self.frequency else "moves away without ringing"
        if self.rest >= self.reach:
            return f"released it {rings}; {force} alone holds it outside its range of {reach}"
        when = "after about " + _duration(self.time) if self.time else "at once"
        return f"released with {force} it {rings} and passes {reach} {when}"


def _duration(seconds: float) -> str:
    """Return a duration to two digits in words."""
    return f"{1e3 * seconds:.2g} ms" if seconds < 0.0995 else f"{seconds:.2g} s" if seconds < 99.5 else "minutes"


def release_of(loop: Loop, reach: ArrayLike = RANGE) -> Release | None:
    """Return the motion of the released handle of an unstable free loop; None if stable or without stiffness.

    The dominant pole z with left and right eigenvectors l and r gives the amplitude A = 2 |l s| |r_x| from the state s
    held still, without the 2 for a real pole, and the time ln(reach / A) T / ln|z|.

    Args:
        loop: The loop.
        reach: Range of motion [m, rad], (6,).

    Source: derived for this project.
    """
    free, ranges = loop.in_hand(None), np.asarray(reach, dtype=np.float64)
    if is_stable(free.spectral_radius):
        return None
    matrix, push, period, frequency = _driven(free)
    poles, vectors = np.linalg.eig(matrix)
    worst = int(np.argmax(np.abs(poles)))
    growth, single = math.log(abs(poles[worst])) / period, abs(poles[worst].imag) < 1e-12
    releases: list[Release] = []
    for index, axis in enumerate(free.axes):
        force, limit = FORCE * (1.0 if axis in AXES[:3] else LEVER_ARM), float(ranges[AXES.index(axis)])
        try:
            state = force * np.linalg.solve(np.eye(len(matrix)) - matrix, push[index])
            share = np.linalg.solve(vectors, state)[worst]
        except np.linalg.LinAlgError:
            continue
        rest = abs(float(state[index]))
        amplitude = abs(share * vectors[index, worst]) * (1.0 if single else 2.0)
        if not (math.isfinite(rest) and amplitude > 0.0 and growth > 0.0):
            continue
        time = 0.0 if rest >= limit else max(math.log(limit / amplitude) / growth, 0.0)
        half = 0.5 / frequency if frequency else 0.0
        releases.append(Release(axis, force, rest, limit, frequency, time, half))
    return min(releases, key=lambda one: one.time, default=None)


@dataclass(frozen=True, eq=False)
class Part:
    """Verdict on loops in one hand.

    Attributes:
        loops: The loops in it.
        judged: False if a loop was not computed.
    """

    loops: tuple[Loop, ...]
    judged: bool = True

    @cached_property
    def radius(self) -> float:
        """Spectral radius of the worst loop; NaN without one."""
        radii = Loops(self.loops).spectral_radii().tolist()
        return max(radii, default=0.0 if self.judged else math.nan)

    @property
    def stable(self) -> bool | None:
        """False if a loop is unstable; else None if one was not computed; else True."""
        if self.loops and not is_stable(self.radius):
            return False
        return True if self.judged else None

    @cached_property
    def critical_delay(self) -> Bound | None:
        """Least critical delay [s]; None if not computed, or without a loop."""
        if not (self.loops and self.judged):
            return None
        bound: Bound = loaded("maglev_mj.theory.verdict:critical_delay_of")(Loops(self.loops))  # which imports this
        return None if math.isnan(bound) else bound

    def as_json(self) -> dict[str, Any]:
        """Return verdict, spectral radius and critical delay, ready for JSON."""
        return {name: plain(getattr(self, name)) for name in ("stable", "radius", "critical_delay")}


@dataclass(frozen=True, eq=False)
class Held:
    """Verdict on the loops of a device free and in each published hand.

    Attributes:
        loops: The loops, with any hand.
        reach: Range of motion [m, rad], six.
        own: Another hand to judge; None for none.
        judged: False if a loop was not computed.

    Example:
        >>> from maglev_mj.theory.held import held_of
        >>> from maglev_mj.theory.loop import Loop
        >>> print(held_of(Loop(stiffness=6000.0, damping=80.0, period=0.005, delay=0.005, inertia=0.7)))
        held    arm stable, stylus unstable, fingertip unstable; free unstable
        Stable only while held (arm): released with 1 N it rings at 20.5 Hz and passes 4.5 mm after about 0.24 s
    """

    loops: tuple[Loop, ...]
    reach: tuple[float, ...] = RANGE
    own: Hand | None = None
    judged: bool = True

    @cached_property
    def parts(self) -> Mapping[str, Part]:
        """Verdict free and in each hand."""
        hands = {FREE if name == "none" else name: get_hand(name) for name in HANDS}
        if self.own is not None and all(other is None or not _same(self.own, other) for other in hands.values()):
            hands[OWN] = self.own
        free = tuple(loop.in_hand(None) for loop in self.loops)
        return {name: Part(tuple(loop.in_hand(hand) for loop in free), self.judged) for name, hand in hands.items()}

    @cached_property
    def release(self) -> Release | None:
        """Motion of the released handle in its worst loop; None if stable free."""
        free = self.parts[FREE].loops
        return release_of(free[int(np.argmax(Loops(free).spectral_radii()))], self.reach) if free else None

    @property
    def leaves_after(self) -> float | None:
        """Time until the released handle leaves its range [s], 0 if it is outside at rest; None if stable free."""
        return None if self.release is None else self.release.time

    @cached_property
    def lines(self) -> tuple[str, ...]:
        """Verdicts in one line, and a second one if they differ."""
        if self.judged and not self.loops:
            return ("held    free motion: no law acts",)
        parts = dict(self.parts)
        free = parts.pop(FREE).stable
        if free is None and all(part.stable is None for part in parts.values()):
            return ("held    not computed",)
        acting = {name: part for name, part in parts.items() if any(loop.hand is not None for loop in part.loops)}
        hands = ", ".join(f"{name} {_WORDS[part.stable]}" for name, part in acting.items())
        first = f"held    {hands or 'no published hand turns it'}; free {_WORDS[free]}"
        others = [name for name, part in parts.items() if part.stable is (not free)]
        if free is None or not others:
            return (first,)
        names = ", ".join(others)
        if not free:
            then = self.release.words if self.release else "released it is unstable"
            return first, f"Stable only while held ({names}): {then}"
        worst = max((parts[name] for name in others), key=lambda part: part.radius)
        return first, f"Unstable only while held ({names}): spectral radius {worst.radius:.4f}; released it settles"

    def __str__(self) -> str:
        return "\n".join(self.lines)

    def as_json(self) -> dict[str, Any]:
        """Return the verdict of each hand, ready for JSON."""
        return {name: part.as_json() for name, part in self.parts.items()}


def held_of(loop: Loop, *, reach: Sequence[float] | Array = RANGE, own: Hand | None = None) -> Held:
    """Return the verdict on a loop free and in each hand.

    Args:
        loop: The loop, with any hand.
        reach: Range of motion [m, rad], (6,).
        own: Another hand to judge; None for that of the loop.
    """
    return Held((loop,), tuple(map(float, reach)), loop.hand if own is None else own)


def _same(first: Hand, second: Hand) -> bool:
    """Return True for hands of equal values on the translations."""
    return first.indices == second.indices and all(map(np.array_equal, first.values, second.values))
