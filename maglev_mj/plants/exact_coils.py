"""Closed-form device with coil currents and metal stops."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.control.timeline import Interval, Timing
from maglev_mj.frames import Array, Component, Six, rotation_matrix
from maglev_mj.plants.coils import CoilMap
from maglev_mj.plants.engine import STOP_TIME
from maglev_mj.plants.exact import ExactPlant
from maglev_mj.plants.hand import HandForce
from maglev_mj.plants.model import acceleration
from maglev_mj.plants.sensor import Measure
from maglev_mj.spec import RANGE


class ExactCoilPlant(ExactPlant):
    """One closed-form device driven by coil currents, with metal stops.

    Between switches of the currents the wrench is constant: that at the angle of the interval's midpoint, extrapolated
    by the velocity. Translation is exact, because forces keep their directions in stator axes; the error of a rotation
    about one axis is of second order in the time between switches. The coupling between rotations is neglected, as in
    `ExactPlant`.

    Stops are inelastic: at the end of an interval, an axis outside its range is set to its stop, with zero velocity, so
    energy never increases. As in `MuJoCoPlant` with `stop_damping`, a stop in contact also slows motion along it. Each
    axis has its own stops; MuJoCo limits the rotation angle instead of each rotation.

    Args:
        timing: Sample period and delay.
        coils: Coil map.
        mass: Moving mass [kg].
        inertia: Moments of inertia about x, y, z [kg m²], (3,).
        gravity: Gravitational acceleration along -z, or in stator axes (3,) [m/s²].
        pose: Pose at release [m, rad], (6,).
        twist: Velocity at release [m/s, rad/s], (6,).
        hand_force: Force of a hand on the flotor; see `SampledPlant`.
        reach: Range of motion to either side [m, rad], (6,).
        lag: Time constant of the drivers [s]; 0 for none.

    Attributes:
        stop_wrench: Mean wrench of the stops over the last interval [N, N m], (6,).

    Raises:
        ParameterError: If a value is outside its bounds or shapes do not match.
    """

    def __init__(
        self,
        timing: Timing,
        *,
        coils: CoilMap,
        mass: float,
        inertia: ArrayLike,
        gravity: ArrayLike,
        pose: ArrayLike,
        twist: ArrayLike = (0.0,) * 6,
        hand_force: HandForce | None = None,
        reach: ArrayLike = RANGE,
        lag: float = 0.0,
    ) -> None:
        self._reach, self._coils = np.array(reach), coils
        self._loaded = np.append(mass * acceleration(gravity), np.zeros(3))
        lags: Any = {"driver_lag": True, "driver_time_constant": lag} if lag else {}
        start: Any = {"pose": pose, "twist": twist, "hand_force": hand_force}
        super().__init__(timing, mass=mass, inertia=inertia, gravity=0.0, **start, **lags)

    def _release(self, timing: Timing, start: tuple[Array, Array], measure: Measure | None) -> None:
        self._constants = self._coils.force_constants.copy()
        super()._release(timing, start, measure)
        self.load, self.stop_wrench = self._loaded, np.zeros(6)
        if self._lag:  # the weight does not lag
            self._actual = self.load.tolist()
        self._timeline.compares = False  # drives are currents: one equal entry does not make them equal

    def drive(
        self,
        currents: Sequence[float],
        pulsed: Sequence[float] | None = None,
        width: float = 0.0,
        *,
        after: float | None = None,
    ) -> None:
        """Switch the currents; see `MuJoCoPlant.drive`.

        Raises:
            PlantError: If a current is not finite, or no sample was read.
        """
        self._switch(tuple, currents, pulsed, width, after)

    def _raised(self, drive: Sequence[float], currents: Sequence[float]) -> Sequence[float]:
        """Return a drive with currents added to its own [A], N."""
        return tuple([own + extra for own, extra in zip(drive, currents)])

    def open_coil(self, coil: int) -> None:
        """Disconnect a coil, counted from 0, as by a broken wire."""
        self._constants[coil] = 0.0

    @property
    def currents(self) -> Array:
        """Commanded coil currents at the last sample [A], (N,)."""
        return np.array(self._timeline.now() if self._walls is None else self._walls.drive)

    @property
    def intervals(self) -> list[Interval]:
        """Durations [s] and N currents [A] of the last period, in order."""
        return self._last_intervals

    def _prepare(self, force: Six) -> Any:
        return tuple(self._coils.inverse_at_angle(*self._pose[3:]).dot(force).tolist())

    def _wrench(self, currents: Sequence[float], ahead: Component = 0.0) -> Array:
        """Return the wrench [N, N m] of currents [A], (N,), at the angle extrapolated by `ahead` [s]."""
        forces = self._coils.directions * (self._constants * currents)[:, None]
        angle = np.array(self._pose[3:]) + ahead * np.array(self._velocity[3:])
        arms = self._coils.points @ rotation_matrix(angle).T
        return np.append(forces.sum(axis=0), np.cross(arms, forces).sum(axis=0))

    def _advance(self, duration: Component, drive: Any, pieces: int = 1) -> None:
        super()._advance(duration, super()._prepare((self._wrench(drive, 0.5 * duration) + self.load).tolist()))
        self.stop_wrench = np.zeros(6)
        pose, velocity = np.array(self._pose), np.array(self._velocity)
        outside = np.abs(pose) > self._reach
        if not outside.any():
            return
        slowed = np.where(outside, 0.0, math.exp(-duration / STOP_TIME) * velocity)
        self.stop_wrench = self.inertia * (slowed - velocity) / duration
        self._pose, self._velocity = np.clip(pose, -self._reach, self._reach).tolist(), slowed.tolist()

    def _snapshot(self, drive: Any) -> Any:
        return self._pose, self._velocity, self._wrench(drive).tolist()
