"""Common parts of bench scenes: device parameters, wall, hold."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from operator import attrgetter
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.control import Hold, Law, VelocityEstimator, Wall
from maglev_mj.control.controller import Controller
from maglev_mj.device import PULSE_WIDTH
from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Array, Component
from maglev_mj.keywords import checked, rate_of
from maglev_mj.parameters import axis_indices, param
from maglev_mj.plants import ExactPlant, Sensor, Timing
from maglev_mj.scenes.results import RunResult
from maglev_mj.scenes.scene import Scene
from maglev_mj.spec import DEVICE_DELAY, DEVICE_PERIOD, INERTIA, MAX_PERIOD, MIN_PERIOD

ANYWHERE = (1e150, 1.0)
"""Divergence bounds of flotors whose flying off is a verdict, not an error."""


def others(axis: str) -> list[str]:
    """Return all axes but one."""
    return [name for name in AXES if name != axis]


def along(axis: str, value: ArrayLike, elsewhere: float = 0.0) -> Array:
    """Return six components with `value` on one axis and `elsewhere` on the others; (N, 6) for values (N,)."""
    return np.where(np.arange(len(AXES)) == AXES.index(axis), np.asarray(value)[..., None], elsewhere)


def stepped(axis: str, quantum: float) -> Sensor | None:
    """Return a sensor of a resolution [m, rad] on one axis, or None (an ideal sensor) for 0."""
    return Sensor(quantum=along(axis, quantum)) if quantum else None


@checked
def hold(scene: Scene, axes: str | Sequence[str], mass: float | None = None) -> Hold:
    """Return a soft hold of some axes, as stiff as period and delay allow with a wide margin.

    Example:
        >>> from maglev_mj import find_scene, hold
        >>> round(float(hold(find_scene("drop")(), ["x", "y"]).stiffness[0]))  # [N/m]
        1036
        >>> round(float(hold(find_scene("drop")(period=0.001), ["x", "y"]).stiffness[0]))
        1750
    """
    body = scene.body.inertia.tolist()
    body[:3] = body[:3] if mass is None else [mass] * 3
    return _hold(axes if isinstance(axes, str) else tuple(axes), tuple(body), scene.period, scene.delay)


@lru_cache
def _hold(axes: str | tuple[str, ...], body: tuple[float, ...], period: float, delay: float) -> Hold:
    """Return a hold, cached for all scenes of a sweep."""
    inertia = [body[index] for index in axis_indices(axes)]
    return Hold.critically_damped(axes, inertia=inertia, period=period, delay=delay)


def wall_controller(
    law: Law | Controller | None = None,
    *,
    period: float,
    delay: float,
    mass: float,
    moments: Sequence[float] = INERTIA[3:],
    velocity: VelocityEstimator | None = None,
    **gains: ArrayLike,
) -> Controller:
    """Return a controller with one wall along z and a hold of the five other axes.

    Args:
        law: The wall, or a controller, returned as it is; None for the PD wall with pulses of eq. (3) of Salcudean &
            Vlaar 1997, which fills z <= 0.
        period: Sample period [s].
        delay: Transport delay [s], for the hold of the other axes.
        mass: Moving mass [kg], for the hold of the other axes.
        moments: Moments of inertia [kg m²], (3,), for the same.
        velocity: Velocity estimator; None for the finite difference.
        gains: Parameters of `Wall`: numbers, or (N,) for N devices.
    """
    if isinstance(law, Controller):
        return law
    if law is None:
        columns: Any = {name: gain if np.ndim(gain) == 0 else np.asarray(gain)[:, None] for name, gain in gains.items()}
        law = Wall(axes="z", lower=0.0, **columns)
    rest = _hold(tuple(others("z")), (mass, mass, mass, *moments), period, delay)
    return Controller([law, rest], period=period, velocity=velocity)


def lagging(lag: float) -> dict[str, Any]:
    """Return keywords of a plant for drivers of a time constant [s]; 0 for none."""
    return {"driver_lag": lag > 0.0, "driver_time_constant": lag or None}


def wall_plant(
    timing: Timing,
    *,
    height: ArrayLike,
    velocity: ArrayLike = 0.0,
    quantum: float = 0.0,
    lag: float = 0.0,
    **keywords: Any,
) -> ExactPlant:
    """Return N exact devices over or in the walls of `wall_controller`, which may fly off.

    The two make a batch of walls from arrays; a `SceneStack` is one of scenes, at a fraction of a millisecond each.

    Args:
        timing: Sample period, delay and phase.
        height: Height at release [m], (N,).
        velocity: Velocity along z at release [m/s], (N,) or a number.
        quantum: Resolution of the sensor along z [m]; 0 for an ideal sensor.
        lag: Time constant of the drivers [s]; 0 for none.
        keywords: Further keywords of `ExactPlant`.
    """
    start: Any = {"pose": along("z", height), "twist": along("z", velocity)}
    return ExactPlant(timing, **start, sensor=stepped("z", quantum), escape=ANYWHERE, **lagging(lag), **keywords)


class WallScene(Scene):
    """Wall that fills z <= 0, with a braking pulse or on the device; the five other axes are held."""

    stiffness: float = param(
        "wall stiffness",
        "N/m",
        default=None,
        derive=attrgetter("hardware.wall.stiffness"),
        at_least=0.0,
        at_most=1e8,
        live=True,
    )
    damping: float = param(
        "wall damping",
        "N s/m",
        default=None,
        derive=attrgetter("hardware.wall.damping"),
        at_least=0.0,
        at_most=1e6,
        live=True,
    )
    pulse: float = param(
        "damping added by the braking pulse; 0 for none",
        "N s/m",
        default=None,
        derive=attrgetter("hardware.wall.pulse"),
        at_least=0.0,
        at_most=1e6,
        live=True,
    )
    pulse_width: float = param("duration of the braking pulse", "s", default=PULSE_WIDTH, at_least=0.0, at_most=1.0)
    mass: float = param(
        "moving mass", "kg", default=None, derive=attrgetter("hardware.mass"), at_least=1e-3, at_most=1e3
    )
    force_limit: float = param(
        "force limit along z; 0 for none",
        "N",
        default=None,
        derive=lambda scene: float(scene.hardware.force_limit[2]),
        at_least=0.0,
        at_most=1e6,
    )
    quantize: float = param(
        "resolution of the position sensor; 0 for an ideal sensor", "m", default=0.0, at_least=0.0, at_most=1.0
    )
    wall_on: str = param(
        "where walls are rendered; on the device without a pulse", default="host", choices=("host", "device"), live=True
    )
    device_damping: float | None = param(
        "damper on the device beside a wall on the host",
        "N s/m",
        default=None,
        at_least=0.0,
        at_most=1e6,
        optional=True,
    )
    device_period: float | None = param(
        f"sample period of the device; {DEVICE_PERIOD:g} by default",
        "s",
        default=None,
        at_least=MIN_PERIOD,
        at_most=MAX_PERIOD,
        optional=True,
    )
    device_rate: float | None = rate_of("device_period")
    device_delay: float | None = param(
        f"delay on the device; {DEVICE_DELAY:g} by default", "s", default=None, at_least=0.0, at_most=1.0, optional=True
    )
    device_cutoff: float | None = param(
        "cutoff of the velocity filter on the device", "Hz", default=None, above=0.0, at_most=1e6, optional=True
    )

    def check(self) -> None:
        """See `Scene`."""
        if self.pulse > 0.0 and self.pulse_width == 0.0:
            raise ParameterError("pulse_width must be above 0 for a pulse (got 0.0)")
        if self.device_damping and self.wall_on == "device":
            raise ParameterError(f"device_damping must be None for a wall on the device (got {self.device_damping:g})")
        if self.device_period is not None or self.device_delay is not None:
            self.device_clock  # noqa: B018 - checks it

    def timing(self, phase: Component = 0.0) -> Timing:
        """See `Scene`."""
        period = DEVICE_PERIOD if self.device_period is None else self.device_period
        delay = DEVICE_DELAY if self.device_delay is None else self.device_delay
        return Timing(period=self.period, delay=self.delay, phase=phase, device_period=period, device_delay=delay)

    def damper(self) -> list[Law]:
        """Return the damper on the device, if any."""
        if not self.device_damping:
            return []
        own: Any = {"damping": self.device_damping, "on": "device", "cutoff": self.device_cutoff}
        return [Wall(axes="z", lower=0.0, stiffness=0.0, **own)]

    def wall(self, *, gate: float = 0.0, force_limit: float = math.inf) -> Wall:
        """Return the PD wall with its braking pulse, eq. (3) of Salcudean & Vlaar 1997.

        Args:
            gate: Least approach speed for a pulse [m/s].
            force_limit: See `Wall`.
        """
        return Wall(
            axes="z",
            lower=0.0,
            stiffness=self.stiffness,
            damping=self.damping,
            pulse=self.pulse if self.wall_on == "host" else 0.0,
            pulse_width=self.pulse_width,
            pulse_gate=gate,
            force_limit=force_limit,
            on=self.wall_on,
            cutoff=self.device_cutoff,
        )

    def variants(self) -> Mapping[str, Self]:
        """See `Scene`."""
        if (without := self.unpulsed()) is None:
            if self.wall_on == "device":
                return {"wall on the device": self}
            return super().variants() if self.pulse else {"no pulse": self}
        return {"with pulse": self, "without pulse": without}

    def unpulsed(self) -> Self | None:
        """Return the scene without its pulse; None if the parameter `pulse` decides on no pulse of its laws."""
        without = self.replace(pulse=0.0)
        return without if self.has_pulses and not without.has_pulses else None

    def series(self, result: RunResult, time: Array) -> dict[str, Array]:
        """Return height [m] and force of the actuators [N]."""
        position, _, force = result.motion(time)
        return {"z": position, "force": force}

    def plant_options(self) -> dict[str, Any]:
        """See `Scene`."""
        return {
            "mass": self.mass,
            "wrench_limit": along("z", self.force_limit, math.inf) if self.force_limit else None,
            "sensor": stepped("z", self.quantize),
        }
