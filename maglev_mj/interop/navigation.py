"""Joystick poses as motion of a slave: position within an edge, rate beyond it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Array, Mask
from maglev_mj.parameters import number, numbers, six, store
from maglev_mj.spec import INERTIA

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
        breakaway: Breakaway force [N, N m]; by default 2 N, for rotations the same at the radius of gyration.

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
        Vlaar 1997, section 4. The rule that derives the mode from the spring of the friction is this package's own.
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
