"""What a hand exerts from one sample to the next: guided along a path, by a spring, or as recorded.

A hand force is what a plant calls at each sample; the wrench it returns acts until the next one. It is the muscles'
part: what the hand's mass, damping and stiffness add to it is the plant's `Hand`.
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Array, Component, quaternion, rotation_vector
from maglev_mj.hand.impedance import Hand
from maglev_mj.parameters import number, numbers

__all__ = ["GuidedHand", "HandForce", "RecordedHand", "SpringHand", "Trajectory"]

State: TypeAlias = Callable[[], tuple[Array, Array]]
"""Returns the true pose and twist of the flotor now, (..., 6) each."""

_NOTHING = (0.0,) * 6


class HandForce(Protocol):
    """What a plant asks of a hand."""

    def __call__(self, tick: int, time: Component, state: State) -> Sequence[Component]:
        """Return the six components of the wrench exerted until the next sample [N, N m].

        Args:
            tick: Number of the sample.
            time: When it is taken [s].
            state: Returns the flotor's true pose and twist, for a hand that needs them.
        """


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses at given times, and a minimum-jerk movement from each to the next.

    Args:
        times: When each pose is reached [s], increasing, (N,).
        poses: The poses [m, rad], (N, 6).

    Raises:
        ParameterError: If the shapes do not fit or the times do not increase.

    Source: Flash & Hogan 1985, the movement of an arm from rest to rest: 10 s³ - 15 s⁴ + 6 s⁵.
    """

    times: ArrayLike
    poses: ArrayLike
    _times: list[float] = field(init=False, repr=False)
    _poses: list[list[float]] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        times, poses = numbers("path times", self.times), numbers("path poses", self.poses)
        if times.ndim != 1 or not times.size or poses.shape != (times.size, len(AXES)):
            raise ParameterError(f"path must have times (N,) and poses (N, 6), not {times.shape} and {poses.shape}")
        if not (np.diff(times) > 0.0).all():
            raise ParameterError(f"path times must increase, not {times.tolist()}")
        object.__setattr__(self, "_times", times.tolist())
        object.__setattr__(self, "_poses", poses.tolist())

    def at(self, time: float) -> list[float]:
        """Return the pose at a time [s]; the first one before the path, the last one after it."""
        place = bisect.bisect_right(self._times, time)
        if place == 0 or place == len(self._times):
            return self._poses[place - 1 if place else 0]
        start, end = self._times[place - 1], self._times[place]
        s = (time - start) / (end - start)
        share = s * s * s * (10.0 + s * (6.0 * s - 15.0))
        return [one + share * (other - one) for one, other in zip(self._poses[place - 1], self._poses[place])]

    @property
    def end(self) -> float:
        """When the last pose is reached [s]."""
        return self._times[-1]


@dataclass(frozen=True, kw_only=True, eq=False)
class GuidedHand:
    """A hand whose arm is drawn along a path: the muscles move the point to which the arm's spring pulls.

    Give the plant the same `hand`, which holds the flotor by its mass, damping and stiffness; both plants are
    then exact in what lies between two samples.

    Args:
        hand: The hand, with an arm of some stiffness.
        path: Where the arm's spring would come to rest.

    Raises:
        ParameterError: If the hand's arm has no stiffness, or differs from device to device.
    """

    hand: Hand
    path: Trajectory
    _pulls: tuple[tuple[int, float], ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if self.hand.shape or not float(np.max(self.hand.stiffness)) > 0.0:
            raise ParameterError("a guided hand must be one, and its arm's stiffness above 0")
        stiffness = float(np.asarray(self.hand.stiffness))
        object.__setattr__(self, "_pulls", tuple((index, stiffness) for index in self.hand.indices))

    def __call__(self, tick: int, time: Component, state: State) -> Sequence[Component]:
        """See `HandForce`."""
        target = self.path.at(float(time))
        wrench = list(_NOTHING)
        for index, stiffness in self._pulls:
            wrench[index] = stiffness * target[index]
        return wrench


@dataclass(kw_only=True, eq=False)
class SpringHand:
    """A spring and damper from the flotor to a pose that may be moved at any time: the mouse's hand.

    It pulls at the flotor's centre and turns it about that, no harder than its limits, and is held from sample to
    sample. A period T takes K T / 2 off its damping, which must be larger than that.

    Args:
        stiffness: Stiffness of the translations [N/m].
        damping: Their damping [N s/m].
        turning_stiffness: Stiffness of the rotations [N m/rad].
        turning_damping: Their damping [N m s/rad].
        force_limit: Largest force [N].
        torque_limit: Largest torque [N m].
        target: Where it pulls to [m, rad], (6,), or the path along which that moves; None where it has let go.
        device_target: Target given by an input device, used while `target` is None [m, rad], (6,); None for none.

    Raises:
        ParameterError: If a value is negative.
    """

    stiffness: float = 200.0
    damping: float = 10.0
    turning_stiffness: float = 0.6
    turning_damping: float = 0.02
    force_limit: float = 20.0
    torque_limit: float = 0.4
    target: Sequence[float] | Trajectory | None = None
    device_target: Sequence[float] | None = None

    def __post_init__(self) -> None:
        for name in ("stiffness", "damping", "turning_stiffness", "turning_damping", "force_limit", "torque_limit"):
            setattr(self, name, number(f"hand {name}", getattr(self, name), at_least=0.0))

    @property
    def goal(self) -> Sequence[float] | Trajectory | None:
        """Target in force; None for a hand that is released."""
        return self.device_target if self.target is None else self.target

    def __call__(self, tick: int, time: Component, state: State) -> Sequence[Component]:
        """See `HandForce`."""
        target = self.goal
        if target is None:
            return _NOTHING
        if isinstance(target, Trajectory):
            target = target.at(float(time))
        pose, twist = (part.tolist() for part in state())
        force = [
            self.stiffness * (goal - place) - self.damping * speed
            for goal, place, speed in zip(target[:3], pose[:3], twist[:3])
        ]
        torque = [
            self.turning_stiffness * angle - self.turning_damping * speed
            for angle, speed in zip(_turn(pose[3:], target[3:]), twist[3:])
        ]
        return [*_no_more(force, self.force_limit), *_no_more(torque, self.torque_limit)]


@dataclass(frozen=True, eq=False)
class RecordedHand:
    """A hand that was recorded, given again sample for sample.

    Args:
        wrenches: What it exerted at each sample [N, N m], (N, 6); after the last one it has let go.

    Raises:
        ParameterError: If they are not finite or not (N, 6).
    """

    wrenches: ArrayLike
    _rows: list[list[float]] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        rows = numbers("hand wrenches", self.wrenches)
        if rows.ndim != 2 or rows.shape[1] != len(AXES):
            raise ParameterError(f"hand wrenches must be (N, 6), not {rows.shape}")
        object.__setattr__(self, "_rows", rows.tolist())

    def __call__(self, tick: int, time: Component, state: State) -> Sequence[Component]:
        """See `HandForce`."""
        return self._rows[tick] if tick < len(self._rows) else _NOTHING


def _no_more(parts: list[float], limit: float) -> list[float]:
    """Return a vector no longer than its limit."""
    length = math.sqrt(sum(part * part for part in parts))
    return parts if length <= limit else [part * limit / length for part in parts]


def _turn(start: Sequence[float], end: Sequence[float]) -> tuple[float, float, float]:
    """Return the rotation vector [rad] of the shorter turn from one orientation to another, in stator axes."""
    w, x, y, z = quaternion(start)
    a, b, c, d = quaternion(end)
    turn = (
        a * w + b * x + c * y + d * z,
        b * w - a * x - c * z + d * y,
        c * w - a * y - d * x + b * z,
        d * w - a * z - b * y + c * x,
    )
    w, x, y, z = turn if turn[0] >= 0.0 else [-part for part in turn]
    return rotation_vector(w, x, y, z)
