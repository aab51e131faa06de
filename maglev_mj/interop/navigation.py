"""Teleoperation of a slave robot: position control within an edge, rate control outside."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.errors import ParameterError, refuse_mask
from maglev_mj.frames import AXES, Array, Mask
from maglev_mj.parameters import number, numbers, six, store
from maglev_mj.plants.model import Flotor, body_of
from maglev_mj.spec import RANGE

_PUSH_ON, _PUSH_OFF, _PUSH_TIME = 0.25, 0.10, 0.1  # fractions of the breakaway force, [s]

_BREAKAWAY = 2.0
_STRETCH = _BREAKAWAY / 6000.0
_EDGE = (0.0025,) * 3 + (math.radians(3.0),) * 3


@dataclass(frozen=True, kw_only=True, eq=False)
class Navigation:
    """Settings of a navigator; each is a number, or (6,) for one per axis.

    Args:
        body: The device, `Scene.body` of a scene; by default the published one.
        edge: Deflection above which rate mode is possible [m, rad]; by default 2.5 mm and 3 degrees, in proportion to
            the device's range.
        scale: Displacement of the slave per displacement of the flotor [1].
        gain: Speed of the slave per deflection outside the edge [1/s].
        give: Stretch of the friction's spring at breakaway, breakaway force over stiffness [m, rad]; by default 2 N
            over 6000 N/m, for rotations the equivalent at the radius of gyration.
        breakaway: Breakaway force [N, N m]; by default 2 N, for rotations the equivalent at the radius of gyration.

    Raises:
        ParameterError: If a value is outside its bounds, or neither a number nor (6,).
    """

    body: Flotor | None = None
    edge: ArrayLike | None = None
    scale: ArrayLike = 1.0
    gain: ArrayLike = 10.0
    give: ArrayLike | None = None
    breakaway: ArrayLike | None = None

    def __post_init__(self) -> None:
        body = (self.body or body_of({})).bounded
        radii = np.sqrt(body.inertia / body.inertia[0])
        own = {"edge": _EDGE * (body.range / RANGE), "give": _STRETCH / radii, "breakaway": _BREAKAWAY * radii}
        for name in ("edge", "scale", "gain", "give", "breakaway"):
            value = getattr(self, name)
            values = six(name, own[name] if value is None else value, finite=True)
            if name in ("give", "breakaway") and not (values > 0.0).all():
                raise ParameterError(f"{name} must be above 0 (got {values.min():g})")
            store(self, **{name: values.copy()})


class Navigator:
    """Convert joystick poses to slave motion: position control within the edge, rate control outside.

    An axis is in rate mode while it is outside the edge and the hand pushes outward. While sliding, the direction of
    motion is that of the push. While stuck, the push is the force that holds the flotor: the whole device force if
    `move` gets it, else the stretch of the friction's spring. Rate mode starts after 0.1 s above 25 % of the breakaway
    force (a released flotor rings) and ends below 10 %. Thus a hand that holds still continues the rate, a released one
    ends it, and friction holds the flotor. On an axis without friction, rate mode is everything outside the edge.

    The slave pose is a sum of increments, so it does not jump at a mode change. In position mode its offset from the
    flotor is constant; in rate mode the offset changes. With friction the return from x outside the edge is in position
    mode, the outward motion is not: each cycle moves the slave back by scale (x - edge), at most 2 mm at the metal
    stops, in addition to the rate motion. Small-angle approximation: rotations are summed per axis.

    Args:
        navigation: Settings; default `Navigation()`.

    Attributes:
        slave: Pose of the slave relative to its initial pose [m, rad], (6,).
        rates: True for axes in rate mode, False in position mode, (6,).

    Source: two modes, switched by friction without returning the slave: Salcudean & Vlaar 1997, section 4. The rule
        that derives the mode from the friction's spring is this package's own.
    """

    def __init__(self, navigation: Navigation | None = None) -> None:
        settings = navigation or Navigation()
        self._edge, self._scale, self._gain, self._give, self._breakaway = (
            np.asarray(values, dtype=np.float64)
            for values in (settings.edge, settings.scale, settings.gain, settings.give, settings.breakaway)
        )
        self.slave: Array = np.zeros(len(AXES))
        self.restart()

    def restart(self) -> None:
        """Reset after the flotor was repositioned; the slave does not move."""
        self._last: Array | None = None
        self.rates: Mask = np.zeros(len(AXES), dtype=np.bool_)
        self._has_friction: Mask = np.zeros(len(AXES), dtype=np.bool_)
        self._pressed: Array = np.zeros(len(AXES))

    def move(self, pose: ArrayLike, anchors: Array | None, elapsed: float, force: ArrayLike | None = None) -> Array:
        """Move the slave.

        Args:
            pose: Pose of the flotor [m, rad], (6,).
            anchors: Stick positions [m, rad], (6,), NaN on sliding axes; None without friction.
            elapsed: Time since the last call [s].
            force: Device wrench without weight compensation [N, N m], (6,); None if not available.

        Returns:
            Displacement of the slave [m, rad], (6,).

        Raises:
            ParameterError: If pose or force are not finite or not (6,), or the time is below 0.
        """
        now = numbers("pose", pose, shape="(6,)")
        number("elapsed", elapsed, at_least=0.0)
        refuse_mask("anchors", anchors)
        motion = np.zeros(len(AXES)) if self._last is None else now - self._last
        if anchors is None:
            self._has_friction[:] = False
            pushed = np.ones(len(AXES), dtype=np.bool_)
        else:
            # friction starts stuck: an axis that never stuck has none
            self._has_friction |= np.isfinite(anchors)
            force = force if force is None else numbers("force", force, shape="(6,)")
            share = (now - anchors) / self._give if force is None else -force / self._breakaway
            pushed = self._pushed(np.sign(now), np.isfinite(anchors), motion, share, elapsed)
        self.rates = (np.abs(now) > self._edge) & pushed
        rate = self._gain * (now - self._edge * np.sign(now)) * elapsed
        moved: Array = np.where(self.rates, rate, self._scale * motion)
        self.slave = self.slave + moved
        self._last = now
        return moved

    def _pushed(self, side: Array, stuck: Mask, motion: Array, share: Array, elapsed: float) -> Mask:
        """Return the mask of axes pushed outward; while stuck, by the share of the breakaway force."""
        outward = np.where(stuck, share * side, 0.0)
        self._pressed = np.where(outward > _PUSH_ON, self._pressed + elapsed, 0.0)
        held = (self._pressed >= _PUSH_TIME) | (self.rates & (outward > _PUSH_OFF))
        return np.where(stuck, held, np.where(self._has_friction, motion * side > 0.0, True))
