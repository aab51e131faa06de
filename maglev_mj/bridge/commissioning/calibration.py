"""Calibration of a device, stored as a JSON file."""

from __future__ import annotations

import hashlib
import json
import os
import re
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from maglev_mj.bridge.safety import WallMaps
from maglev_mj.bridge.wire import CUT
from maglev_mj.errors import MaglevError, ParameterError, check_instance
from maglev_mj.files import atomic_path
from maglev_mj.frames import Array
from maglev_mj.parameters import number, numbers, read_json
from maglev_mj.plants.coils import CoilMap
from maglev_mj.plants.model import Body, body_of, load_model
from maglev_mj.plants.sensor import Beams, beams
from maglev_mj.spec import GRAVITY, INERTIA

_FORMAT = "maglev_mj calibration 1"
_UNIT_LENGTH = 1e-9

_DAMPING = 0.3
"""Damping rate times latency: the largest without overshoot, up to a delay of two periods."""
_STOP, _LIFT = 0.5, 2.5
"""Duration of a controlled stop [s]; largest multiple of the hover currents, which brakes at 1.5 g."""

_COILS = {"points": (6, 3), "directions": (6, 3), "force_constants": (6,)}
_BEAMS = {"leds": (3, 3), "directions": (3, 3), "diodes": (3, 3), "across": (3, 2, 3)}
_BODY = {"spot_offsets": (6,), "mass": (), "inertia": (3,), "gravity": (3,)}
_UNITS: dict[str, Any] = {
    "coils": {"points": "m", "directions": "1", "force_constants": "N/A"},
    "beams": {"leds": "m", "directions": "1", "diodes": "m", "across": "1"},
    **{"spot_offsets": "m", "mass": "kg", "inertia": "kg m^2", "gravity": "m/s^2"},
}


class CalibrationError(MaglevError):
    """Calibration file cannot be read or written, or is invalid."""


class InvalidCalibrationError(CalibrationError, ParameterError):
    """Calibration file is missing, or its contents are invalid."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Calibration:
    """Coils, beams, mass and gravity of a device.

    Args:
        coils: Points, directions and force constants of the coils.
        beams: LEDs and diodes.
        spot_offsets: Subtracted from measured spots, (6,) [m].
        mass: Moving mass [kg].
        inertia: Moments of inertia about stator axes through the centre of mass, (3,) [kg m²].
        gravity: Acceleration of free fall in stator axes, (3,) [m/s²].
        name: Name; not part of the digest.

    Raises:
        ParameterError: If a value is not finite or has the wrong shape, a direction is not a unit vector, or mass or a
            moment of inertia is not above 0.

    Example:
        >>> from maglev_mj import Calibration
        >>> nominal = Calibration.nominal()
        >>> nominal.mass, nominal.hover.round(2).tolist()
        (0.7, [1.14, 1.14, 1.14, 0.0, 0.0, 0.0])
    """

    coils: CoilMap
    beams: Beams
    spot_offsets: Array
    mass: float
    inertia: Array
    gravity: Array
    name: str = "nominal"

    def __post_init__(self) -> None:
        for name, shape in _COILS.items():
            _checked(f"coils {name}", getattr(self.coils, name), shape)
        for name, shape in _BEAMS.items():
            _checked(f"beams {name}", getattr(self.beams, name), shape)
        for name in ("spot_offsets", "inertia", "gravity"):
            object.__setattr__(self, name, _checked(name, getattr(self, name), _BODY[name]))
        object.__setattr__(self, "mass", number("mass", self.mass, above=0.0))
        for moment in self.inertia:
            number("inertia", float(moment), above=0.0)
        check_instance("name", self.name, str, "a text")

    @classmethod
    def nominal(cls) -> Self:
        """Return the nominal calibration: values of the model, base level, no spot offsets."""
        coils = load_model("drop").coils
        assert coils is not None  # the model has coils
        return cls(
            coils=coils,
            beams=beams(),
            spot_offsets=np.zeros(6),
            mass=INERTIA[0],
            inertia=np.array(INERTIA[3:]),
            gravity=np.array([0.0, 0.0, -GRAVITY]),
        )

    @property
    def body(self) -> Body:
        """The device, with the published range and force limit: a calibration states none."""
        return body_of({"mass": self.mass, "inertia": self.inertia, "gravity": self.gravity})

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
        """BLAKE2s digest of all values but the name, 16 bytes; unchanged by `save` and `load`."""
        values = {name: value for name, value in self.as_json().items() if name != "name"}
        text = json.dumps(values, sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.blake2s(text.encode(), digest_size=16).digest()

    def as_json(self) -> dict[str, Any]:
        """Return all values as JSON-ready lists, numbers and strings, without loss of precision."""
        return {
            "format": _FORMAT,
            "name": self.name,
            "units": deepcopy(_UNITS),
            "coils": {name: getattr(self.coils, name).tolist() for name in _COILS},
            "beams": {name: getattr(self.beams, name).tolist() for name in _BEAMS},
            **{name: np.asarray(getattr(self, name)).tolist() for name in _BODY},
        }

    @classmethod
    def from_json(cls, values: Any) -> Self:
        """Return a calibration from the output of `as_json`.

        Raises:
            InvalidCalibrationError: If the format or a unit is wrong, or an entry is missing or unknown.
            ParameterError: See the class.
            ModelError: If the coils cannot give every wrench, or the beams do not determine the pose.
        """
        if not isinstance(values, dict) or values.get("format") != _FORMAT:
            actual = values.get("format") if isinstance(values, dict) else type(values).__name__
            raise InvalidCalibrationError(f"format must be {_FORMAT!r} (got {actual!r})")
        parts = _entries("", values, {"format", "name", "units", "coils", "beams", *_BODY})
        if values["units"] != _UNITS:
            raise InvalidCalibrationError(f"units must be {json.dumps(_UNITS)} (got {json.dumps(values['units'])})")
        coils, diodes = _arrays("coils", parts, _COILS), _arrays("beams", parts, _BEAMS)
        body: dict[str, Any] = {name: _checked(name, parts[name], shape) for name, shape in _BODY.items()}
        body["mass"] = float(body["mass"])
        return cls(coils=CoilMap(**coils), beams=Beams(**diodes), **body, name=parts["name"])

    def save(self, path: str | Path) -> None:
        """Write the calibration to a file, atomically: an existing file is replaced only by a complete one.

        Raises:
            CalibrationError: If it cannot be written.
        """
        try:
            with atomic_path(Path(path)) as partial, partial.open("w", encoding="utf-8") as file:
                file.write(_pretty(self.as_json()) + "\n")
                file.flush()
                os.fsync(file.fileno())  # a power failure must not leave an empty file
        except OSError as error:
            raise CalibrationError(f"calibration {str(path)!r} cannot be written: {error.strerror}") from error

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a calibration file.

        Raises:
            InvalidCalibrationError: If it cannot be read or is invalid; one line with file and value.
        """
        # integers as floats: NumPy cannot convert very large ones
        return read_json("calibration", path, cls.from_json, InvalidCalibrationError, parse_int=float)


def _checked(name: str, value: Any, shape: tuple[int, ...]) -> Array:
    """Return a finite, read-only array of a shape; check directions for unit length."""
    array = np.array(numbers(name, value, shape=str(shape)))
    if name.endswith(("directions", "across")):
        lengths = np.linalg.norm(array, axis=-1)
        worst = float(lengths.flat[np.abs(lengths - 1.0).argmax()])
        if abs(worst - 1.0) > _UNIT_LENGTH:
            raise ParameterError(f"{name} must be unit vectors within {_UNIT_LENGTH:g} (got length {worst!r})")
    array.setflags(write=False)
    return array


def _arrays(where: str, values: dict[str, Any], shapes: dict[str, tuple[int, ...]]) -> dict[str, Array]:
    """Return the checked arrays of one part."""
    entries = _entries(f"{where} ", values[where], set(shapes))
    return {name: _checked(f"{where} {name}", entries[name], shape) for name, shape in shapes.items()}


def _entries(where: str, values: Any, names: set[str]) -> dict[str, Any]:
    """Return a dictionary after checking its names."""
    if not isinstance(values, dict):
        raise InvalidCalibrationError(
            f"{where.strip()} must be an object with {', '.join(sorted(names))} (got {values!r})"
        )
    for name in sorted(names ^ set(values)):
        what = "is missing" if name in names else "is unknown"
        raise InvalidCalibrationError(f"{where}{name} {what}; expected entries: {', '.join(sorted(names))}")
    return values


def _pretty(values: dict[str, Any]) -> str:
    """Return indented JSON with one row of numbers per line."""
    text = json.dumps(values, indent=2, allow_nan=False)
    # strings contain no newline: JSON escapes it
    return re.sub(r"\[\n[^][{}]+\]", lambda row: re.sub(r"\n *", "", row[0]).replace(",", ", "), text)
