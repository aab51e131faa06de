"""Calibration of a device: the measured values of its file."""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np

from maglev_mj.bridge.safety import WallMaps
from maglev_mj.bridge.wire import CUT
from maglev_mj.device import PUBLISHED, Device
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.files import atomic_path
from maglev_mj.frames import AXES, Array
from maglev_mj.keywords import checked
from maglev_mj.parameters import numbers
from maglev_mj.plants.coils import CoilMap
from maglev_mj.plants.model import Flotor, body_of
from maglev_mj.plants.sensor import Beams, PoseScale, geometry_of

_DAMPING = 0.3
"""Damping rate times latency: the largest without overshoot, up to a delay of two periods."""
_STOP, _LIFT = 0.5, 2.5
"""Duration of a controlled stop [s]; largest multiple of the hover currents, which brakes at 1.5 g."""

_COILS, _BEAMS = ("points", "directions", "force_constants"), ("leds", "directions", "diodes", "across")


class CalibrationError(MaglevError):
    """Device file cannot be written."""


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class Calibration:
    """Coils, sensor, mass and gravity of a device: the values of its file that are measured, and the file.

    Args:
        coils: Points, directions and force constants of the coils.
        beams: LEDs and diodes, or the scale of a pose computed on the device.
        spot_offsets: Subtracted from measured spots, (6,) [m].
        mass: Moving mass [kg].
        inertia: Moments of inertia about stator axes through the centre of mass, (3,) [kg m²].
        gravity: Acceleration of free fall in stator axes, (3,) [m/s²].
        base: Device with all other values.
        name: Name; not part of the digest.

    Raises:
        ParameterError: If a value is not finite, has the wrong shape, or is outside the bounds of a device file.

    Example:
        >>> from maglev_mj import Calibration
        >>> nominal = Calibration.nominal()
        >>> nominal.mass, nominal.hover.round(2).tolist()
        (0.7, [1.14, 1.14, 1.14, 0.0, 0.0, 0.0])
    """

    coils: CoilMap
    beams: Beams | PoseScale
    spot_offsets: Array
    mass: float
    inertia: Array
    gravity: Array
    base: Device = field(default_factory=lambda: Device.load(PUBLISHED))
    name: str = PUBLISHED

    def __post_init__(self) -> None:
        if (count := len(self.coils)) > len(AXES):
            why = "a frame of the protocol carries six currents: simulate it without twin and bridge"
            raise ParameterError(f"device {self.name!r} has {count} coils, but {why}")
        for name in ("spot_offsets", "inertia", "gravity"):
            values = np.array(numbers(name, getattr(self, name)))
            values.setflags(write=False)
            object.__setattr__(self, name, values)
        self.device  # noqa: B018  checks the values

    @classmethod
    def of(cls, device: Device) -> Self:
        """Return the calibration that a device file states.

        Raises:
            ParameterError: If the device has no coils, or more than six.
        """
        return cls(
            coils=CoilMap.of(device),
            beams=geometry_of(device),
            spot_offsets=np.array(device.sensor.offsets),
            mass=device.mass,
            inertia=device.inertia[3:],
            gravity=np.array(device.body.gravity),
            base=device,
            name=device.name,
        )

    @classmethod
    def nominal(cls) -> Self:
        """Return the calibration of the published joystick."""
        return cls.of(Device.load(PUBLISHED))

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Return the calibration that a device file states; see `Device.load`."""
        return cls.of(Device.load(path))

    @cached_property
    def device(self) -> Device:
        """The device with these values; positions from the centre of mass if coils or beams differ from the file's."""
        base, own = self.base, {"mass": self.mass, "inertia": self.inertia.tolist(), "gravity": self.gravity.tolist()}
        coils, sensor = measured = _geometry(self.coils, self.beams)
        if measured == _geometry(CoilMap.of(base), geometry_of(base)):
            coils = sensor = {}
        else:
            own["centre_of_mass"] = [0.0] * 3
        device = base.change("coils", **coils).change("sensor", **sensor, offsets=self.spot_offsets.tolist())
        return replace(device.change("body", **own), name=self.name)

    @property
    def body(self) -> Flotor:
        """Flotor and limits of the device."""
        return body_of(self.base.keywords | {"mass": self.mass, "inertia": self.inertia, "gravity": self.gravity})

    @property
    def hover(self) -> Array:
        """Hover currents at the centre, upright [A], (6,)."""
        return self.coils.currents(np.concatenate([-self.mass * self.gravity, np.zeros(3)]))

    @property
    def wall_maps(self) -> WallMaps:
        """Linear maps at the centre, for walls on the device; see `WallMaps`."""
        steps = 1e-6 * np.eye(6)
        slopes = (self.beams.spots(steps) - self.beams.spots(-steps)).T / 2e-6
        centre = self.beams.spots(np.zeros(6)) + self.spot_offsets
        return WallMaps(centre.tolist(), np.linalg.inv(slopes).tolist(), self.coils.current_per_wrench.tolist())

    def controlled_stop(self, latency: float, current: float) -> tuple[float, ...]:
        """Return the parameters of a device's controlled stop, eight.

        The device reduces the hover currents linearly to zero and damps the motion against gravity, measured by its
        spots alone.

        Args:
            latency: Sample period plus delay of a command [s].
            current: Limit of a coil current [A].

        Returns:
            Damping by the velocity of each spot, six [s/m]; duration [s]; largest multiple of the hover currents.
        """
        weight, most = float(np.linalg.norm(self.gravity)), float(np.abs(self.hover).max())
        if not weight or not most:
            return CUT
        up = -self.gravity / weight @ np.array(self.wall_maps.pose_per_spot)[:3]
        return (*(_DAMPING / latency / weight * up).tolist(), _STOP, min(_LIFT, 0.99 * current / most))

    @property
    def digest(self) -> bytes:
        """Digest of the device with these values, 16 bytes; see `Device.digest`."""
        return self.device.digest

    def save(self, path: str | Path) -> None:
        """Write the device to a file, atomically: an existing file is replaced only by a complete one.

        Raises:
            CalibrationError: If it cannot be written.
        """
        try:
            with atomic_path(Path(path)) as partial, partial.open("w", encoding="utf-8") as file:
                file.write(self.device.toml())
                file.flush()
                os.fsync(file.fileno())  # a power failure must not leave an empty file
        except OSError as error:
            raise CalibrationError(f"device file {str(path)!r} cannot be written: {error.strerror}") from error


def _geometry(coils: CoilMap, beams: Beams | PoseScale) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the measured values of the coils and of the sensor, as in a device file."""
    sensor = {name: getattr(beams, name).tolist() for name in _BEAMS} if isinstance(beams, Beams) else {}
    return {name: getattr(coils, name).tolist() for name in _COILS}, sensor
