"""The exact plant: a rigid body on six decoupled axes, closed form from switch to switch."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array, Component, components, join
from maglev_mj.parameters import number, numbers
from maglev_mj.plants.base import SampledPlant
from maglev_mj.plants.contract import Timing
from maglev_mj.spec import GRAVITY, Spec

__all__ = ["ExactPlant"]


Drive: TypeAlias = tuple[list[Component], Sequence[Component]]
"""Acceleration of each axis, gravity included [m/s², rad/s²], and the force behind it [N, N m]."""


class ExactPlant(SampledPlant):
    """One device or N of them, each coordinate a mass under a constant force: no integrator at all.

    Exact for translation, and for rotation about one principal axis; the coupling between rotations, of
    second order in the angle, is left out. A first-order driver lag has a closed form too.

    Args:
        timing: Sample period, delay and phase; (N,) phases go with a pose (N, 6).
        mass: Mass of the flotor with its handle [kg].
        inertia: Moments of inertia about x, y, z [kg m²], (3,).
        pose: Pose at release [m, rad], (..., 6).
        twist: Velocity at release [m/s, rad/s], (..., 6).
        gravity: Acceleration of free fall along -z [m/s²].
        driver_lag: Switch the current drivers' first-order lag on.
        wrench_limit: See `SampledPlant`, as for the remaining ones.
        quantum: Sensor resolution.
        escape: Distance and angle at which a run counts as diverged.
        record: Keep every switch for `trace()`.

    Raises:
        ParameterError: If a value is outside its bounds or the shapes do not fit.
    """

    def __init__(
        self,
        timing: Timing | None = None,
        *,
        mass: float = Spec.moving_mass.value,
        inertia: ArrayLike = (Spec.tilt_inertia.value, Spec.tilt_inertia.value, Spec.spin_inertia.value),
        pose: ArrayLike = (0.0,) * 6,
        twist: ArrayLike = (0.0,) * 6,
        gravity: float = GRAVITY,
        driver_lag: bool = False,
        wrench_limit: ArrayLike | None = None,
        quantum: ArrayLike | None = None,
        escape: tuple[float, float] = (0.045, 1.0),
        record: bool = False,
    ) -> None:
        timing = timing or Timing()
        start, motion = numbers("pose", pose), numbers("twist", twist)
        moments = numbers("inertia", inertia, at_least=0.0)
        shapes = (start.shape, motion.shape, (*np.shape(timing.phase), 6))
        if moments.shape != (3,) or any(shape[-1:] != (6,) for shape in shapes):
            raise ParameterError(
                f"pose and twist must be (..., 6) and inertia (3,), not {start.shape}, {motion.shape} and "
                f"{moments.shape}"
            )
        try:
            shape = np.broadcast_shapes(*shapes)
        except ValueError:
            raise ParameterError(f"pose, twist and phase must fit one batch, not {shapes}") from None
        start, motion = np.broadcast_to(start, shape), np.broadcast_to(motion, shape)
        body = [number("mass", mass, above=0.0)] * 3 + [number("inertia", value, above=0.0) for value in moments]
        self._inverse_inertia = [1.0 / value for value in body]
        self._gravity = (0.0, 0.0, -number("gravity", gravity), 0.0, 0.0, 0.0)
        self._lag = 1.0 / (2.0 * math.pi * Spec.driver_bandwidth.value) if driver_lag else None
        self._place, self._velocity = components(start), components(motion)
        # acceleration that the drivers give now; it trails the drive where there is a lag
        self._actual: list[Component] = list(self._gravity)
        super().__init__(
            timing,
            batch=start.shape[:-1],
            wrench_limit=wrench_limit,
            quantum=quantum,
            escape=escape,
            record=record,
            # only the recorded curve needs the pieces: the state itself is exact over any stretch
            longest_step=0.25 * self._lag if record and self._lag is not None else None,
        )

    def _prepare(self, force: Sequence[Component]) -> Drive:
        acceleration = [
            push * inverse + fall for push, inverse, fall in zip(force, self._inverse_inertia, self._gravity)
        ]
        return acceleration, force

    def _advance(self, duration: Component, drive: Drive) -> None:
        accelerations = drive[0]
        if self._lag is not None:
            self._advance_lagged(duration, accelerations, self._lag)
            return
        position, velocity = self._place, self._velocity
        half = 0.5 * duration
        for axis, acceleration in enumerate(accelerations):
            speed = velocity[axis]
            position[axis] = position[axis] + duration * (speed + half * acceleration)
            velocity[axis] = speed + duration * acceleration

    def _advance_lagged(self, duration: Component, accelerations: list[Component], lag: float) -> None:
        """Integrate drive + (actual - drive) exp(-t/lag) twice."""
        faded = -np.expm1(-duration / lag)
        for axis, acceleration in enumerate(accelerations):
            missing = self._actual[axis] - acceleration
            gained = missing * lag * faded
            position, speed = self._place[axis], self._velocity[axis]
            travel = speed + 0.5 * duration * acceleration + missing * lag
            self._place[axis] = position + duration * travel - lag * gained
            self._velocity[axis] = speed + duration * acceleration + gained
            self._actual[axis] = acceleration + missing * (1.0 - faded)

    def _position(self) -> list[Component]:
        self._check_escape(self._place)
        return self._place.copy()

    def _state(self, drive: Drive) -> tuple[Array, Array, Array]:
        force = drive[1]
        if self._lag is not None:
            force = [
                (acceleration - fall) / inverse
                for acceleration, fall, inverse in zip(self._actual, self._gravity, self._inverse_inertia)
            ]
        shape = (*self.batch, 6)
        pose, twist, wrench = (np.broadcast_to(join(part), shape) for part in (self._place, self._velocity, force))
        return pose, twist, wrench
