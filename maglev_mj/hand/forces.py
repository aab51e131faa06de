"""Hand forces over a sample period: guided, spring or recorded.

A plant calls a hand force at each sample; the returned wrench acts until the next one. It is the muscles'
part of the hand; mass, damping and stiffness are the plant's `Hand`.
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

State: TypeAlias = Callable[[], tuple[Array, Array]]
"""Function returning the flotor's present pose and twist.

Both are true values, (..., 6) each.
"""

_NOTHING = (0.0,) * 6


class HandForce(Protocol):
    """Interface of a hand's force on the flotor."""

    def __call__(self, tick: int, time: Component, state: State) -> Sequence[Component]:
        """Return the hand's wrench until the next sample.

        Six components [N, N m].

        Args:
            tick: Number of the sample.
            time: Time of the sample [s].
            state: Function that returns the flotor's true pose and twist.
        """


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Path of minimum-jerk movements through timed poses.

    Args:
        times: Time of each pose [s], increasing, (N,).
        poses: The poses [m, rad], (N, 6).

    Raises:
        ParameterError: If the shapes do not fit or the times do not increase.

    Source: Flash & Hogan 1985, the movement of an arm from rest to rest: 10 s³ - 15 s⁴ + 6 s⁵.

    Example:
        >>> from maglev_mj import Trajectory
        >>> path = Trajectory([0.0, 0.4], [[0.0] * 6, [0.004, 0, 0, 0, 0, 0]])
        >>> path.at(0.2)[0], path.end
        (0.002, 0.4)
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
        """Return the pose at a time [s].

        The first pose before the path, the last one after it.
        """
        place = bisect.bisect_right(self._times, time)
        if place == 0 or place == len(self._times):
            return self._poses[place - 1 if place else 0]
        start, end = self._times[place - 1], self._times[place]
        s = (time - start) / (end - start)
        share = s * s * s * (10.0 + s * (6.0 * s - 15.0))
        return [one + share * (other - one) for one, other in zip(self._poses[place - 1], self._poses[place])]

    @property
    def end(self) -> float:
        """Time of the last pose [s]."""
        return self._times[-1]


@dataclass(frozen=True, kw_only=True, eq=False)
class GuidedHand:
    """Hand with an arm spring drawn along a path.

    The muscles move the rest position of the arm's spring.

    Give the plant the same `hand`, which holds the flotor by its mass, damping and stiffness; both plants are
    then exact between two samples.

    Args:
        hand: The hand, with an arm of some stiffness.
        path: Rest position of the arm's spring.

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
    """Spring and damper from the flotor to a movable pose.

    It is the hand of the mouse. Force and torque at the flotor's centre, within their limits, are held from sample to
    sample. A period T reduces the damping by K T / 2; the damping must be larger than that.

    Args:
        stiffness: Stiffness of the translations [N/m].
        damping: Damping of the translations [N s/m].
        turning_stiffness: Stiffness of the rotations [N m/rad].
        turning_damping: Damping of the rotations [N m s/rad].
        force_limit: Largest force [N].
        torque_limit: Largest torque [N m].
        target: Target pose [m, rad], (6,), or its path; None if released.
        device_target: Target given by an input device, used while `target` is None [m, rad], (6,); None for none.

    Raises:
        ParameterError: If a value is negative, or a target is no pose.

    Example:
        >>> import numpy as np
        >>> from maglev_mj import SpringHand
        >>> hand = SpringHand(stiffness=200.0, target=[0.004, 0, 0, 0, 0, 0])
        >>> wrench = hand(0, 0.0, lambda: (np.zeros(6), np.zeros(6)))
        >>> round(float(wrench[0]), 3)  # 200 N/m times 4 mm
        0.8
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
        for name in ("target", "device_target"):
            goal = getattr(self, name)
            if not isinstance(goal, Trajectory | None) and numbers(f"hand {name}", goal).shape != (len(AXES),):
                raise ParameterError(f"hand {name} must be a pose (6,), a Trajectory or None, not {goal!r}")

    @property
    def goal(self) -> Sequence[float] | Trajectory | None:
        """Present target; None if the hand is released."""
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
    """Recorded hand, replayed sample by sample.

    Args:
        wrenches: Wrench at each sample [N, N m], (N, 6); zero after the last one.

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
    """Return a vector shortened to its limit."""
    length = math.sqrt(sum(part * part for part in parts))
    return parts if length <= limit else [part * limit / length for part in parts]


def _turn(start: Sequence[float], end: Sequence[float]) -> tuple[float, float, float]:
    """Return the rotation vector between two orientations [rad].

    Of the shorter turn, in stator axes.
    """
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
