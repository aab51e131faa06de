"""Axes and buttons of a scene as a 3D mouse has them, by position or rate."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Array, Mask
from maglev_mj.interop.spacenav.protocol import MOST
from maglev_mj.parameters import Parameters, number, numbers, param, six, store
from maglev_mj.session import Snapshot
from maglev_mj.spec import INERTIA, RANGE

_PUSHES, _LETS_GO, _FOR = 0.25, 0.10, 0.1

_BREAKAWAY = 2.0
_GIVE = _BREAKAWAY / 6000.0
_RADII = [math.sqrt(inertia / INERTIA[0]) for inertia in INERTIA[3:]]


@dataclass(frozen=True, kw_only=True, eq=False)
class Navigation:
    """Settings of a navigator.

    Each is a number for all axes, or one for each, (6,).

    Args:
        edge: Deflection from the centre from which on it may be a rate [m, rad].
        scale: The slave's way for the flotor's [1].
        gain: The slave's speed for the deflection beyond the edge [1/s].
        give: How far the spring of the friction stretches before it breaks away, breakaway over stiffness [m, rad];
            by default 2 N over 6000 N/m, for rotations the same at the radius of gyration.
        breakaway: The force at which it does [N, N m]; by default 2 N, likewise.

    Raises:
        ParameterError: If a value is out of its bounds, or neither a number nor (6,).
    """

    edge: ArrayLike = (0.0025,) * 3 + (math.radians(3.0),) * 3
    scale: ArrayLike = 1.0
    gain: ArrayLike = 10.0
    give: ArrayLike = (_GIVE,) * 3 + tuple(_GIVE / radius for radius in _RADII)
    breakaway: ArrayLike = (_BREAKAWAY,) * 3 + tuple(_BREAKAWAY * radius for radius in _RADII)

    def __post_init__(self) -> None:
        for name in ("edge", "scale", "gain", "give", "breakaway"):
            values = six(name, getattr(self, name), finite=True)
            if name in ("give", "breakaway") and not (values > 0.0).all():
                raise ParameterError(f"{name} must be above 0 everywhere, not {values.min():g}")
            store(self, **{name: values.copy()})


class Navigator:
    """Convert joystick poses into slave motion.

    Position control within the edge, rate control beyond it.

    An axis is in rate mode while it is beyond the edge and the hand pushes outward. Sliding, the hand goes where the
    flotor goes. Stuck, what holds the flotor against it shows how hard it pushes: all that the device gives, walls and
    springs too, or, where that is not known, the stretch of the friction's spring. There the mode begins after 0.1 s
    above 25 % of the breakaway, for a flotor that is let go rings, and ends below 10 %. So a hand that holds still
    goes on with the rate, one that lets go ends it, and the friction keeps the flotor where it is. Without friction
    nothing would: there, rate mode is all that is beyond the edge.

    The slave's pose is a sum of increments, and so cannot jump where the mode changes. In position mode it keeps its
    distance to the flotor's; in rate mode that distance shifts. With friction the way back from x beyond the edge is
    position all along, the way out is not: each cycle out and back leaves the slave back by scale (x - edge), at most
    2 mm at the device's stops, beside what the rate has done. Rotations add up axis by axis, as small ones may.

    Args:
        navigation: What it goes by.

    Attributes:
        slave: Pose of the slave, from where it was first [m, rad], (6,).
        rates: True for an axis in rate mode, the slave's rate over the distance beyond the edge; False in position
            mode, where it goes as far as the flotor goes, (6,).

    Source: two modes, and friction that lets one change between them without the slave being returned: Salcudean &
        Vlaar 1997, section 4. How the mode is told from the friction's spring is this package's own.
    """

    def __init__(self, navigation: Navigation | None = None) -> None:
        chosen = navigation or Navigation()
        self._edge, self._scale, self._gain, self._give, self._breakaway = (
            np.asarray(values, dtype=np.float64)
            for values in (chosen.edge, chosen.scale, chosen.gain, chosen.give, chosen.breakaway)
        )
        self.slave: Array = np.zeros(len(AXES))
        self.restart()

    def restart(self) -> None:
        """Forget the last pose; the slave stays in place.

        For a flotor that was moved elsewhere.
        """
        self._last: Array | None = None
        self.rates: Mask = np.zeros(len(AXES), dtype=np.bool_)
        self._rubs: Mask = np.zeros(len(AXES), dtype=np.bool_)
        self._pressed: Array = np.zeros(len(AXES))

    def move(self, pose: ArrayLike, anchors: Array | None, elapsed: float, force: ArrayLike | None = None) -> Array:
        """Move the slave.

        Args:
            pose: Of the flotor [m, rad], (6,).
            anchors: Where the flotor sticks [m, rad], (6,), NaN where it does not; None without friction.
            elapsed: Time since the last call [s].
            force: What the device gives beyond what carries the flotor [N, N m], (6,), if it is known.

        Returns:
            By how much it has moved [m, rad], (6,).

        Raises:
            ParameterError: If pose or force are not finite or not (6,), or the time is below 0.
        """
        now = _six("pose", pose)
        number("elapsed", elapsed, at_least=0.0)
        way = np.zeros(len(AXES)) if self._last is None else now - self._last
        if anchors is None:
            self._rubs[:] = False
            pushed = np.ones(len(AXES), dtype=np.bool_)
        else:
            # friction begins stuck: an axis that never was has none
            self._rubs |= np.isfinite(anchors)
            share = (now - anchors) / self._give if force is None else -_six("force", force) / self._breakaway
            pushed = self._pushed(np.sign(now), np.isfinite(anchors), way, share, elapsed)
        self.rates = (np.abs(now) > self._edge) & pushed
        rate = self._gain * (now - self._edge * np.sign(now)) * elapsed
        moved: Array = np.where(self.rates, rate, self._scale * way)
        self.slave = self.slave + moved
        self._last = now
        return moved

    def _pushed(self, side: Array, stuck: Mask, way: Array, share: Array, elapsed: float) -> Mask:
        """Return the axes that the hand pushes outward.

        Judged by its share of the breakaway force while they stick.
        """
        outward = np.where(stuck, share * side, 0.0)
        self._pressed = np.where(outward > _PUSHES, self._pressed + elapsed, 0.0)
        held = (self._pressed >= _FOR) | (self.rates & (outward > _LETS_GO))
        return np.where(stuck, held, np.where(self._rubs, way * side > 0.0, True))


def _six(name: str, value: ArrayLike) -> Array:
    values = numbers(name, value)
    if values.shape != (len(AXES),):
        raise ParameterError(f"{name} must be (6,), not {values.shape}")
    return values


EXCHANGED = [0, 2, 1, 3, 5, 4]
"""Index permutation between device and spacenav axes, both ways."""

FULL = 500
"""Number sent for a full deflection or rate."""

FULL_POSE: Array = np.array(RANGE)
"""Deflections sent as FULL, the device's stops [m, rad], (6,)."""

FULL_RATE: Array = np.array([0.020] * 3 + [math.radians(30.0)] * 3)
"""Rates sent as FULL [m/s, rad/s], (6,).

Those of a default navigator at the stops.
"""

REST = (0,) * len(AXES)
"""Numbers sent at rest."""

Axes: TypeAlias = Callable[[Snapshot], tuple[int, ...]]
"""Returns the six numbers for a snapshot, in spacenav's order."""

RUNS = ("running", "flying")
"""States of a scene that moves."""


def told(shares: Array) -> Array:
    """Return deflection or rate shares as whole numbers, (6,)."""
    return np.rint(np.clip(FULL * shares, -MOST, MOST))


class PoseAxes:
    """Deflections from the centre, as a 3D mouse has them.

    Args:
        mapping: Settings of the axes; the defaults where it is None.
    """

    def __init__(self, mapping: AxisMapping | None = None) -> None:
        self._mapping = mapping or AxisMapping()

    def __call__(self, snapshot: Snapshot) -> tuple[int, ...]:
        """Return the six numbers for a snapshot; see `Axes`."""
        if snapshot.state not in RUNS:
            return REST
        deflection = self._mapping.outside(np.asarray(snapshot.pose), FULL_POSE)
        return tuple(told(self._mapping((deflection / FULL_POSE)[EXCHANGED])).astype(int).tolist())


class RateAxes:
    """Rates of the slave that a `Navigator` moves.

    What rounding leaves over is said with the next snapshot: a program that adds up rates over time stays within half
    a unit of one snapshot of the slave's way.

    Args:
        navigation: What the navigator goes by.
        mapping: Settings of the axes; the dead zone is one of the flotor's deflection.

    Attributes:
        navigator: It.
    """

    def __init__(self, navigation: Navigation | None = None, mapping: AxisMapping | None = None) -> None:
        self.navigator, self._mapping = Navigator(navigation), mapping or AxisMapping()
        self._time: float | None = None
        self._owed: Array = np.zeros(len(AXES))

    def __call__(self, snapshot: Snapshot) -> tuple[int, ...]:
        """Return the six numbers for a snapshot; see `Axes`."""
        runs = snapshot.state in RUNS and bool(np.isfinite([*snapshot.pose, *snapshot.force]).all())
        before, self._time = self._time, snapshot.time if runs else None
        if not runs or before is None or snapshot.time < before:
            self.navigator.restart()  # the scene stood still or began anew: that is no motion
        if not runs:
            return REST
        elapsed = 0.0 if before is None else max(snapshot.time - before, 0.0)
        pose = self._mapping.outside(np.asarray(snapshot.pose), FULL_POSE)
        way = self.navigator.move(pose, snapshot.anchors, elapsed, snapshot.force) / FULL_RATE
        moved = self._mapping(way[EXCHANGED])
        self._owed = moved + (self._owed * (moved != 0.0) if self._mapping.dominant else self._owed)
        if elapsed == 0.0:
            return REST
        counts = told(self._owed / elapsed)
        self._owed -= counts * (elapsed / FULL)
        return tuple(counts.astype(int).tolist())


Buttons: TypeAlias = Callable[[Snapshot], tuple[bool, ...]]
"""Returns which buttons are down at a snapshot."""

NO_BUTTONS: tuple[bool, ...] = (False, False)
"""Both buttons, up."""

_Z, _WALLS = 2, (1.0, -1.0)
_SHORTEST, _LONGEST = 0.055, 0.155
_RELEASE = 0.5


class Taps:
    """Two buttons: 0 at the lower wall, 1 above.

    The handle taps if the force along z in a wall passes half of `force`, reaches `force`, and is below half of it
    again 0.06 to 0.15 s later. A bounce is shorter, a handle that leans on the wall longer. The button is down for one
    snapshot, at the end of the tap. The times are those of snapshots, 60 in a second.

    Args:
        force: Force of the device against the handle, springs and friction included [N].

    Raises:
        ParameterError: If it is not above 0.
    """

    def __init__(self, force: float) -> None:
        self._force = number("force", force, above=0.0)
        self._began: list[float | None] = [None, None]
        self._peak = [0.0, 0.0]

    def __call__(self, snapshot: Snapshot) -> tuple[bool, ...]:
        """Return which buttons are down; see `Buttons`."""
        return tuple(self._tapped(button, normal, snapshot) for button, normal in enumerate(_WALLS))

    def _tapped(self, button: int, normal: float, snapshot: Snapshot) -> bool:
        """Follow one wall; return True when a tap ends."""
        began, force = self._began[button], _force(snapshot, normal)
        if force >= _RELEASE * self._force:
            self._began[button] = snapshot.time if began is None else began
            self._peak[button] = max(self._peak[button], force)
            return False
        tapped = self._peak[button] >= self._force and began is not None
        self._began[button], self._peak[button] = None, 0.0
        return tapped and began is not None and _SHORTEST <= snapshot.time - began <= _LONGEST


def _force(snapshot: Snapshot, normal: float) -> float:
    """Return the wall force along z [N].

    0 outside the wall, and while the scene does not run.
    """
    inside = any(
        axis == _Z and way == normal and way * (edge - snapshot.pose[_Z]) > 0.0 for axis, way, edge in snapshot.faces
    )
    return normal * float(snapshot.force[_Z]) if inside and snapshot.state in RUNS else 0.0


_NOTHING, _NONE = "0", "none"
_FINITE = 1e6


class AxisMapping(Parameters):
    """Mapping from an input device's deflections to six numbers.

    The dead zone is taken off each deflection first. Then come order and signs, the gains, and the choice of the
    largest. The defaults change no number.

    Raises:
        ParameterError: If a value is outside its bounds, or a word is no axis.

    Example:
        >>> mapping = AxisMapping(order="x,y,z,0,0,0", invert="y", dominant=True)
        >>> mapping([0.2, 0.1, 0.5, 0.9, 0.0, 0.0]).tolist()
        [0.0, 0.0, 0.5, 0.0, 0.0, 0.0]
    """

    gain: float = param("factor on translations", default=1.0, at_least=0.0, at_most=100.0)
    turning_gain: float = param("factor on rotations", default=1.0, at_least=0.0, at_most=100.0)
    dead_zone: float = param("share of a full deflection that counts as none", default=0.0, at_least=0.0, at_most=0.9)
    order: str = param("axis behind each of the six numbers, 0 for none", default=",".join(AXES))
    invert: str = param("numbers with the opposite sign, such as x,rz", default=_NONE)
    dominant: bool = param("keep the largest of the six numbers alone", default=False)

    def check(self) -> None:
        """See `Parameters`."""
        words, inverted = self.order.split(","), self._inverted()
        if len(words) != len(AXES) or not set(words) <= {*AXES, _NOTHING}:
            raise ParameterError(f"order must be six of {', '.join(AXES)} and {_NOTHING}, not {self.order!r}")
        if not set(inverted) <= set(AXES) or len(set(inverted)) < len(inverted):
            raise ParameterError(f"invert must be {_NONE}, or some of {', '.join(AXES)}, not {self.invert!r}")

    def outside(self, deflection: Array, full: Array) -> Array:
        """Return a deflection without its dead zone, (6,).

        A full deflection stays full.

        Args:
            deflection: From the centre [m, rad], (6,).
            full: The full one [m, rad], (6,).
        """
        if self.dead_zone == 0.0:
            return deflection
        rest = np.maximum(np.abs(deflection) - self.dead_zone * full, 0.0) / (1.0 - self.dead_zone)
        return np.copysign(rest, deflection)

    def __call__(self, shares: Array) -> Array:
        """Return the six numbers, (6,); NaN counts as 0.

        Args:
            shares: Of the full deflection or rate, (6,).
        """
        told: Array = self._matrix @ np.nan_to_num(shares, posinf=_FINITE, neginf=-_FINITE)
        if self.dominant:
            told[np.arange(len(AXES)) != np.argmax(np.abs(told))] = 0.0
        return told

    def _inverted(self) -> list[str]:
        return [] if self.invert == _NONE else self.invert.split(",")

    @cached_property
    def _matrix(self) -> Array:
        matrix = np.zeros((len(AXES), len(AXES)))
        for row, (name, source) in enumerate(zip(AXES, self.order.split(","))):
            if source != _NOTHING:
                gain = self.gain if row < 3 else self.turning_gain
                matrix[row, AXES.index(source)] = -gain if name in self._inverted() else gain
        return matrix


class SpacenavMapping(AxisMapping):
    """Settings of the joystick as a 3D mouse.

    Raises:
        ParameterError: See `AxisMapping`.
    """

    press: float | None = param(
        "force of a tap on the lower or the upper wall, which is button 0 or 1",
        "N",
        default=None,
        optional=True,
        at_least=0.5,
        at_most=50.0,
    )
