"""Hand on the flotor: impedance, published values and forces."""

from __future__ import annotations

import bisect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.device import PUBLISHED, Device
from maglev_mj.errors import ParameterError, check_instance, check_one_of, choice_message
from maglev_mj.frames import AXES, Array, Component, Six, quaternion, rotation_vector
from maglev_mj.keywords import checked, every_tick
from maglev_mj.parameters import axis_indices, common_shape, number, numbers, store

HANDS: Mapping[str, tuple[float, ...]] = {
    "none": (),
    # one trial: van Beek, Bergmann Tiest, Mugge & Kappers 2015, figure 3
    "arm": (0.554, 6.45, 135.0),
    # vertical direction of a stylus, after Fu & Cavusoglu 2012; from a secondary source
    "stylus": (0.204, 18.06, 271.7, 0.776, 769.9),
    # assumed: lower end of the published range
    "fingertip": (0.02, 1.0, 40.0),
}
"""Published hands by name: mass [kg], damping [N s/m] and stiffness [N/m]; damping and stiffness of the grip."""

_TERMS = 14
_LEAST_MASS = 1e-3
_MOST = {"mass": 1e3, "damping": 1e6, "stiffness": 1e7, "grip_damping": 1e5, "grip_stiffness": 1e7}


@checked(own="axes")
@dataclass(frozen=True, kw_only=True, eq=False)
class Hand:
    """Linear, passive hand on the flotor: mass m, arm damping b and stiffness k, and grip.

    Rigid grip: m moves with the flotor, f = -m dv/dt - b v - k x. Soft grip: the hand has its own position x_h, and a
    spring and damper connect it to the flotor; without an arm (k = b = 0) it floats freely. The hand adds no weight.
    Each value is a number, or (...,) for a batch.

    Args:
        mass: Mass of the hand [kg].
        damping: Damping of the arm [N s/m].
        stiffness: Stiffness of the arm [N/m].
        grip_damping: Damping of the grip [N s/m].
        grip_stiffness: Stiffness of the grip [N/m]; None for a rigid grip.
        axes: Names from AXES on which it acts; the translations by default.

    Raises:
        ParameterError: If a value is negative or too large, shapes do not match, a hand with a soft grip has a mass
            below 1 g or no grip stiffness, or a rigid grip has damping.

    Example:
        >>> from maglev_mj import Hand
        >>> arm = Hand(mass=0.554, damping=6.45, stiffness=135.0)
        >>> float(arm.static_stiffness)
        135.0
    """

    mass: ArrayLike = 0.0
    damping: ArrayLike = 0.0
    stiffness: ArrayLike = 0.0
    grip_damping: ArrayLike = 0.0
    grip_stiffness: ArrayLike | None = None
    axes: str | Sequence[str] = ("x", "y", "z")
    indices: tuple[int, ...] = field(init=False)
    """Indices of the axes into AXES."""
    shape: tuple[int, ...] = field(init=False)
    """Batch shape of the values."""

    def __post_init__(self) -> None:
        for name, most in _MOST.items():
            if (value := getattr(self, name)) is not None or name != "grip_stiffness":
                numbers(f"hand {name}", value, at_least=0.0, at_most=most)
        shape = common_shape("hand values", *(value.shape for value in self.values))
        mass, _, _, grip_damping, grip_stiffness = self.values
        if self.soft and not ((mass >= _LEAST_MASS).all() and (grip_stiffness > 0.0).all()):
            # otherwise the position of the hand is undetermined
            raise ParameterError(
                f"hand mass must be at least {_LEAST_MASS:g} kg and grip_stiffness above 0 in a soft grip"
            )
        if not self.soft and grip_damping.any():
            raise ParameterError("hand grip_damping must be 0 in a rigid grip; for a soft grip set grip_stiffness")
        store(self, indices=axis_indices(self.axes), shape=shape)

    @property
    def soft(self) -> bool:
        """True if the grip is soft, so that the hand moves on its own."""
        return self.grip_stiffness is not None

    def position_at_rest(self, flotor: Component) -> Component:
        """Return the hand's equilibrium position for a flotor position [m]."""
        _, _, arm, _, grip = self.values
        total = arm + grip
        share = np.where(total > 0.0, grip / np.where(total > 0.0, total, 1.0), 1.0)
        return flotor * (share if share.ndim else float(share))

    @property
    def static_stiffness(self) -> Array:
        """Static stiffness of arm and grip at the flotor [N/m]."""
        return np.asarray(self.values[2] * (self.position_at_rest(1.0) if self.soft else 1.0))

    @property
    def values(self) -> tuple[Array, ...]:
        """Mass, damping, stiffness, grip damping, grip stiffness; the last is 0 for a rigid grip."""
        grip = 0.0 if self.grip_stiffness is None else self.grip_stiffness
        parts = (self.mass, self.damping, self.stiffness, self.grip_damping, grip)
        return tuple(np.asarray(part, dtype=np.float64) for part in parts)


def get_hand(text: str | Hand | None) -> Hand | None:
    """Return a hand by name or from "mass,damping,stiffness[,grip damping,grip stiffness]".

    A `Hand` or None is returned unchanged.

    Raises:
        ParameterError: If the name is unknown, or the numbers are invalid.
    """
    if not isinstance(text, str):
        check_instance("hand", text, Hand | None, f"a Hand, or one of {', '.join(HANDS)}")
        return text
    return _named(text)


@lru_cache  # one object of a text, so that loops with it are equal
def _named(text: str) -> Hand | None:
    values = HANDS.get(text)
    if values is None:
        try:
            values = tuple(float(part) for part in text.split(","))
        except ValueError:
            values = ()
        if len(values) not in (3, 5):
            numeric = ", or mass,damping,stiffness[,grip damping,grip stiffness] in SI units"
            raise ParameterError(choice_message("hand", HANDS, text, numeric))
    return hand_of(values) if values else None


def hand_of(values: Sequence[ArrayLike]) -> Hand:
    """Return a hand with its mass, damping, stiffness, and grip damping and stiffness if it is soft."""
    by_name: dict[str, Any] = dict(zip(_MOST, values))
    return Hand(**by_name)


@dataclass(frozen=True, eq=False)
class Mode:
    """First flexible mode of the flotor, between the coils' force and the sensor.

    For a total mass m, X/U = (1/m) [1/s² + rho / (s² + 2 zeta w s + w²)], w = 2 pi f. Two masses joined by a spring
    and a damper, m1 at the coils and m2 at the handle, have rho = m2/m1 with the sensor at the coils and -1 with it at
    the handle. A rigid hand's mass is part of m.

    Args:
        frequency: Frequency f of the free flotor's mode [Hz], (...,).
        damping_ratio: Damping ratio zeta, (...,).
        participation: Participation rho, (...,), at least -1.

    Raises:
        ParameterError: If a value is outside its bounds, or the shapes do not match.

    Source: derived for this project from the two masses.
    """

    frequency: ArrayLike
    damping_ratio: ArrayLike
    participation: ArrayLike
    values: tuple[Array, ...] = field(init=False, repr=False)
    """Frequency, damping ratio, participation."""
    shape: tuple[int, ...] = field(init=False)
    """Batch shape of the values."""

    def __post_init__(self) -> None:
        frequency = numbers("mode frequency", self.frequency, above=0.0, at_most=1e5, unit="Hz")
        ratio = numbers("mode damping_ratio", self.damping_ratio, at_least=0.0, at_most=1.0)
        share = numbers("mode participation", self.participation, at_least=-1.0, at_most=1e3)
        store(self, values=(frequency, ratio, share))
        store(self, shape=common_shape("mode values", *map(np.shape, self.values)))


def get_mode(text: str | Mode | None) -> Mode | None:
    """Return a mode from "frequency,damping ratio,participation"; a `Mode` or None is returned unchanged.

    Raises:
        ParameterError: If the text is not three numbers, or one is outside its bounds.
    """
    return _mode_of(text) if isinstance(text, str) else text


@lru_cache
def _mode_of(text: str) -> Mode:
    try:
        return Mode(*map(float, text.split(",")))
    except (TypeError, ValueError) as error:
        if isinstance(error, ParameterError):
            raise
        raise ParameterError(f"mode must be HZ,ZETA,RHO, such as 1000,0.01,-1 (got {text!r})") from None


def motion(
    mass: ArrayLike,
    hand: Hand | None = None,
    lag: ArrayLike = 0.0,
    own_damping: ArrayLike = 0.0,
    mode: Mode | None = None,
) -> tuple[Array, Array]:
    """Return the continuous-time state space model of one axis, ds/dt = A s + B (u, w, e).

    The state s is sensed position and mean velocity of the flotor, position and velocity of a hand with a soft grip,
    the mode's deflection and its rate over 2 pi f, and the lagging driver force; u is the commanded force, w any other
    force on the flotor, and e the force of the hand's muscles. Own damping, hand and w do not excite the mode.

    Args:
        mass: Mass of the flotor [kg], (...,).
        hand: Hand; None for no hand.
        lag: Time constant of the drivers [s], (...,); 0 for no lag, of all.
        own_damping: Viscous damping of the device to ground [N s/m], (...,).
        mode: Flexible mode; None for a rigid flotor.

    Returns:
        A (..., n, n) and B (..., n, 3).
    """
    hand = hand or Hand()
    hand_mass, damping, stiffness, grip_damping, grip_stiffness = hand.values
    flotor = np.asarray(mass, dtype=np.float64)
    total = flotor if hand.soft else flotor + hand_mass
    own, flexible = np.asarray(own_damping, dtype=np.float64), mode is not None
    late = np.asarray(lag, dtype=np.float64)
    first, lags = 2 + 2 * hand.soft, bool((late > 0.0).any())
    size = first + 2 * flexible + lags
    shape = np.broadcast_shapes(total.shape, hand.shape, own.shape, late.shape, mode.shape if mode else ())
    a, b = np.zeros((*shape, size, size)), np.zeros((*shape, size, 3))
    spring, damper = (grip_stiffness, grip_damping) if hand.soft else (stiffness, damping)
    a[..., 0, 1], a[..., 1, 0], a[..., 1, 1] = 1.0, -spring / total, -(damper + own) / total
    b[..., 1, 1] = 1.0 / total
    if hand.soft:
        a[..., 1, 2], a[..., 1, 3] = grip_stiffness / total, grip_damping / total
        a[..., 2, 3] = 1.0
        a[..., 3, 0], a[..., 3, 1] = grip_stiffness / hand_mass, grip_damping / hand_mass
        a[..., 3, 2] = -(grip_stiffness + stiffness) / hand_mass
        a[..., 3, 3] = -(grip_damping + damping) / hand_mass
        b[..., 3, 2] = 1.0 / hand_mass
    else:
        b[..., 1, 2] = 1.0 / total
    if lags:
        a[..., 1, -1] = 1.0 / total
        a[..., -1, -1], b[..., -1, 0] = -1.0 / late, 1.0 / late
    else:
        b[..., 1, 0] = 1.0 / total
    if mode is not None:
        frequency, ratio, participation = mode.values
        turn = 2.0 * np.pi * frequency
        a[..., first, first + 1], a[..., first + 1, first] = turn, -turn
        a[..., first + 1, first + 1] = -2.0 * ratio * turn
        force = a[..., -1] if lags else b[..., 0]
        force[..., first + 1] = participation / (total * turn)
        # the sensed position is the sum of mean position and deflection
        a[..., 0, :] += a[..., first, :]
        a[..., first] -= a[..., 0]
    return a, b


def transition(a: Array, b: Array, duration: ArrayLike) -> tuple[Array, Array]:
    """Discretise ds/dt = A s + B u under constant input: s <- Phi s + Gamma u after a duration [s], (...,).

    Returns:
        Phi (..., n, n) and Gamma (..., n, m).
    """
    time = np.asarray(duration, dtype=np.float64)[..., None, None]
    size, inputs = b.shape[-2:]
    shape = np.broadcast_shapes(a.shape[:-2], b.shape[:-2], time.shape[:-2])
    augmented = np.zeros((*shape, size + inputs, size + inputs))
    augmented[..., :size, :size], augmented[..., :size, size:] = a * time, b * time
    result = exponential(augmented)
    return result[..., :size, :size], result[..., :size, size:]


def exponential(matrix: Array) -> Array:
    """Return the exponential of square matrices (..., n, n), by Taylor series with scaling and squaring.

    Exact to rounding for the small matrices here. SciPy would be a dependency for this alone. exp(M) - I is squared
    instead of exp(M): next to the identity, each squaring would double the rounding error of small entries.
    """
    largest = float(np.abs(matrix).sum(axis=-1).max(initial=0.0))
    squarings = max(int(np.ceil(np.log2(largest / 0.25))), 0) if largest > 0.0 else 0
    scaled = matrix / 2.0**squarings
    identity = np.eye(matrix.shape[-1])
    result = np.zeros(matrix.shape)
    for term in range(_TERMS, 0, -1):
        result = scaled @ (identity + result) / term
    for _ in range(squarings):
        result = 2.0 * result + result @ result
    return np.asarray(identity + result)


State: TypeAlias = Callable[[], tuple[Array, Array]]
"""Function that returns the flotor's true pose and twist, (..., 6) each."""

_NOTHING = (0.0,) * 6
_GAP, _SOFTEST = 0.1, 1e-9
_YIELD_STIFFNESS, _YIELD_DAMPING, _YIELD_SHARE = 3.0, 0.1, 0.5
"""Stiffness and damping towards the largest angle [N m/rad, N m s/rad], and the share of it from which they act."""


class HandForce(Protocol):
    """Interface of a hand's force on the flotor."""

    def __call__(self, tick: int, time: Component, state: State) -> Six:
        """Return the hand's wrench until the next sample, six components [N, N m].

        Args:
            tick: Index of the sample.
            time: Time of the sample [s].
            state: Function that returns the flotor's true pose and twist.
        """


INTERPOLATIONS: Mapping[str, Callable[[float], float]] = {
    "minimum-jerk": lambda s: s * s * s * (10.0 + s * (6.0 * s - 15.0)),
    "linear": lambda s: s,
    "cubic": lambda s: s * s * (3.0 - 2.0 * s),
}
"""Interpolations by name: share of the way from one pose to the next at 0 <= s <= 1; "cubic" adds the slopes."""


_MOST_VIA_POINTS, _LEAST_CUBIC_POINTS = 20, 4


@checked
@dataclass(frozen=True, eq=False)
class Trajectory:
    """Path through timed poses.

    Args:
        times: Time of each pose [s], increasing, (N,).
        poses: The poses [m, rad], (N, 6).
        interpolation: One of `INTERPOLATIONS`. "minimum-jerk" is for a few via points: the path stops at each; "cubic"
            (slopes by differences, zero at rest, where a value repeats; error of third order in the sample period;
            linear below four poses) and "linear" are for recorded motion.
            By default "minimum-jerk" for up to 20 poses, "cubic" for more.

    Raises:
        ParameterError: If shapes do not match, the times do not increase, or there is no such interpolation.

    Source: Flash & Hogan 1985, arm movement from rest to rest: 10 s³ - 15 s⁴ + 6 s⁵.

    Example:
        >>> from maglev_mj import Trajectory
        >>> path = Trajectory([0.0, 0.4], [[0.0] * 6, [0.004, 0, 0, 0, 0, 0]])
        >>> path.at(0.2)[0], path.end
        (0.002, 0.4)
    """

    times: ArrayLike
    poses: ArrayLike
    interpolation: str = ""
    _times: list[float] = field(init=False, repr=False)
    _poses: list[list[float]] = field(init=False, repr=False)
    _slopes: list[list[float]] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        times = numbers("path times", self.times, shape="(N,)")
        poses = numbers("path poses", self.poses, shape=str((max(times.size, 1), len(AXES))))
        if (wrong := np.flatnonzero(np.diff(times) <= 0.0)).size:
            index = wrong[0]
            raise ParameterError(f"path times must increase (got {times[index]}, {times[index + 1]} at index {index})")
        if not self.interpolation:
            store(self, interpolation="cubic" if times.size > _MOST_VIA_POINTS else "minimum-jerk")
        check_one_of("interpolation", INTERPOLATIONS, self.interpolation)
        slopes = np.zeros_like(poses)
        if self.interpolation == "cubic" and times.size < _LEAST_CUBIC_POINTS:
            store(self, interpolation="linear")
        if self.interpolation == "cubic":
            slopes = np.gradient(poses, times, axis=0, edge_order=2)
            steps = np.pad(np.diff(poses, axis=0), ((1, 1), (0, 0)))
            rests = (steps[1:-1] == 0.0) & (steps[:-2] * steps[2:] >= 0.0)  # not the two samples beside an extremum
            slopes[1:][rests] = slopes[:-1][rests] = 0.0
        store(self, _times=times.tolist(), _poses=poses.tolist(), _slopes=slopes.tolist())

    @every_tick
    def at(self, time: float) -> list[float]:
        """Return the pose at a time [s]: the first one before the path, the last one after it."""
        if time != time:
            raise ParameterError("time must be a number (got nan)")
        try:
            index = bisect.bisect_right(self._times, time)
        except TypeError:
            raise ParameterError(f"time must be a number (got {time!r})") from None
        if index == 0 or index == len(self._times):
            return self._poses[index - 1 if index else 0]
        start, end = self._times[index - 1], self._times[index]
        s = (time - start) / (end - start)
        share, pair = INTERPOLATIONS[self.interpolation](s), (self._poses[index - 1], self._poses[index])
        if self.interpolation != "cubic":
            return [a + share * (b - a) for a, b in zip(*pair)]
        first, last = s * (1.0 - s) * (1.0 - s) * (end - start), s * s * (s - 1.0) * (end - start)
        ends = zip(*pair, self._slopes[index - 1], self._slopes[index])
        return [a + share * (b - a) + first * u + last * v for a, b, u, v in ends]

    @property
    def end(self) -> float:
        """Time of the last pose [s]."""
        return self._times[-1]


@dataclass(frozen=True, kw_only=True, eq=False)
class GuidedHand:
    """Hand whose muscles move the rest position of the arm's spring along a path: f = k x_path(t).

    Pass the same `hand` to the plant, which adds its mass, damping and stiffness; both plants are then exact between
    two samples.

    Args:
        hand: Hand with arm stiffness k above 0.
        path: Rest position x_path of the arm's spring.

    Raises:
        ParameterError: If the arm has no stiffness, or its values differ between devices.
    """

    hand: Hand
    path: Trajectory
    _pulls: tuple[tuple[int, float], ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if self.hand.shape or not float(np.max(self.hand.stiffness)) > 0.0:
            raise ParameterError("a guided hand must have scalar values and an arm stiffness above 0")
        stiffness = float(np.asarray(self.hand.stiffness))
        store(self, _pulls=tuple((index, stiffness) for index in self.hand.indices))

    def __call__(self, tick: int, time: Component, state: State) -> Six:
        """Return the hand's wrench; see `HandForce`."""
        target = self.path.at(float(time))
        wrench = list(_NOTHING)
        for index, stiffness in self._pulls:
            wrench[index] = stiffness * target[index]
        return wrench


@checked
@dataclass(kw_only=True, eq=False)
class SpringHand:
    """Spring and damper from the flotor to a movable target: f = k (x_t - x) - b v.

    This is the hand moved by the mouse. Force and torque act at the flotor's centre, saturate at their limits, and are
    held between samples. A hold over the period T reduces the damping by k T / 2, so b must be larger.

    Args:
        stiffness: Stiffness of the translations [N/m].
        damping: Damping of the translations [N s/m].
        turning_stiffness: Stiffness of the rotations [N m/rad].
        turning_damping: Damping of the rotations [N m s/rad].
        force_limit: Largest force [N].
        torque_limit: Largest torque [N m].
        rise_time: Shortest time in which the force rises to its limit [s]: the spring's end moves to the target.
        largest_angle: Largest total angle to which it turns the flotor [rad]: the torque away from the centre yields by
            3 N m/rad and 0.1 N m s/rad before it.
        target: Target pose [m, rad], (6,), or a path; None if released.
        device_target: Target of an input device [m, rad], (6,), used while `target` is None; None if released.

    Raises:
        ParameterError: If a value is negative, or a target is not a pose.

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
    rise_time: float = 0.0
    largest_angle: float = math.pi
    target: Sequence[float] | Trajectory | None = None
    device_target: Sequence[float] | None = None
    _end: list[float] | None = field(default=None, init=False, repr=False)
    _last: float = field(default=0.0, init=False, repr=False)

    def __post_init__(self) -> None:
        for name in [entry.name for entry in fields(self) if entry.init and entry.type == "float"]:
            setattr(self, name, number(f"hand {name}", getattr(self, name), at_least=0.0))
        for name in ("target", "device_target"):
            goal = getattr(self, name)
            if not isinstance(goal, Trajectory | None):
                numbers(f"hand {name}", goal, shape="(6,)")

    @classmethod
    def of_mouse(cls, stiffness: float = stiffness, device: str | Path = PUBLISHED) -> SpringHand:
        """Return the mouse's hand, which lifts the body but is too weak and slow for the stops behind walls.

        Args:
            stiffness: Stiffness of the translations [N/m].
            device: Device, see `Device.load`.
        """
        own = Device.load(device)
        force = max(7.0, 1.015 * own.mass * math.hypot(*own.body.gravity))
        largest = min(0.97 * float(own.reach[3:].min()), math.pi)
        return cls(stiffness=stiffness, force_limit=force, torque_limit=0.2, rise_time=0.2, largest_angle=largest)

    @property
    def goal(self) -> Sequence[float] | Trajectory | None:
        """Present target; None if the hand is released."""
        return self.device_target if self.target is None else self.target

    def __call__(self, tick: int, time: Component, state: State) -> Six:
        """Return the hand's wrench; see `HandForce`."""
        target = self.goal
        if target is None:
            self._end = None
            return _NOTHING
        if isinstance(target, Trajectory):
            target = target.at(float(time))
        pose, twist = (part.tolist() for part in state())
        if self.rise_time > 0.0:
            elapsed = 0.0 if self._end is None else min(max(float(time) - self._last, 0.0), _GAP)  # segments begin at 0
            target = self._end = self._moved(self._end or pose, target, pose, elapsed / self.rise_time)
            self._last = float(time)
        force = [
            self.stiffness * (goal - position) - self.damping * speed
            for goal, position, speed in zip(target[:3], pose[:3], twist[:3])
        ]
        torque = [
            self.turning_stiffness * angle - self.turning_damping * speed
            for angle, speed in zip(_turn(pose[3:], target[3:]), twist[3:])
        ]
        torque = self._yielding(_shortened(torque, self.torque_limit), pose[3:], twist[3:])
        return [*_shortened(force, self.force_limit), *torque]

    def _yielding(self, torque: list[float], turn: list[float], speed: list[float]) -> list[float]:
        """Return a torque that turns the flotor to the largest angle at most."""
        angle = math.hypot(*turn)
        if angle <= _YIELD_SHARE * self.largest_angle:
            return torque
        outward, rate = (sum(a * b for a, b in zip(turn, parts)) / angle for parts in (torque, speed))
        most = _YIELD_STIFFNESS * (self.largest_angle - angle) - _YIELD_DAMPING * rate
        excess = max(outward - max(most, -self.torque_limit), 0.0)
        return [part - excess * along / angle for part, along in zip(torque, turn)]

    def _moved(self, end: Sequence[float], target: Sequence[float], pose: list[float], share: float) -> list[float]:
        """Return the spring's end, moved to the target by a share of the extension that gives the limits."""
        moved: list[float] = []
        limits = (self.force_limit, self.stiffness), (self.torque_limit, self.turning_stiffness)
        for axes, (limit, stiffness) in zip((slice(3), slice(3, 6)), limits):
            longest, here = limit / max(stiffness, _SOFTEST), pose[axes]
            step = _shortened([goal - part for goal, part in zip(target[axes], end[axes])], share * longest)
            extension = _shortened([part + by - at for part, by, at in zip(end[axes], step, here)], longest)
            moved += [at + part for at, part in zip(here, extension)]
        return moved


@checked
@dataclass(frozen=True, eq=False)
class RecordedHand:
    """Replay of a recorded hand, sample by sample.

    Args:
        wrenches: Wrench at each sample [N, N m], (N, 6); zero after the last one.

    Raises:
        ParameterError: If they are not finite or not (N, 6).
    """

    wrenches: ArrayLike
    _rows: list[list[float]] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        rows = numbers("hand wrenches", self.wrenches, shape="(N, 6)")
        store(self, _rows=rows.tolist())

    def __call__(self, tick: int, time: Component, state: State) -> Six:
        """Return the hand's wrench; see `HandForce`."""
        return self._rows[tick] if tick < len(self._rows) else _NOTHING


def _shortened(parts: list[float], limit: float) -> list[float]:
    """Return a vector, shortened to a length of at most `limit`."""
    length = math.sqrt(sum(part * part for part in parts))
    return parts if length <= limit else [part * limit / length for part in parts]


def _turn(start: Sequence[float], end: Sequence[float]) -> tuple[float, float, float]:
    """Return the rotation vector [rad] of the shorter rotation between two orientations, in stator axes."""
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
