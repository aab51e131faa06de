"""Device description: one TOML file with body, coils, range, sensor, drivers and loop."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, lru_cache, partial
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from maglev_mj.errors import ModelError, ParameterError, check_one_of
from maglev_mj.frames import AXES, Array
from maglev_mj.keywords import checked
from maglev_mj.parameters import LAG, Parameters, numbers, param, read_file, transport_delay
from maglev_mj.scale import HAND, Scale, Sizes
from maglev_mj.spec import GRAVITY, MAX_PERIOD, MIN_PERIOD, RANGE
from maglev_mj.versions import MODELS

PUBLISHED = "ubc"
"""Name of the default device, the published joystick."""

COILS = tuple(f"{kind}{arm}" for kind in ("vertical", "horizontal") for arm in range(3))
"""Actuator names of a model's first six coils, in the order of the currents; see `coil_names`."""

PULSE_WIDTH = 0.003
"""Duration of the published braking pulse [s]."""

_FOLDER = MODELS / "devices"
_UNIT_LENGTH = 1e-6
_ZERO = (0.0, 0.0, 0.0)


def _array(name: str, shape: str, unit: str, default: Any = None, *, optional: bool = False, **bounds: Any) -> Any:
    """Declare an array; required unless it has a default or is optional."""
    return param(name, unit, default=default, optional=optional, parse=partial(_parsed, name, shape, bounds))


def _parsed(name: str, shape: str, bounds: Mapping[str, Any], value: Any) -> Any:
    """Return a checked array as nested tuples."""
    array = numbers(name, value, shape=shape, **bounds)
    if name in ("directions", "across"):
        lengths = np.linalg.norm(array, axis=-1)
        worst = float(lengths.flat[np.abs(lengths - 1.0).argmax()])
        if abs(worst - 1.0) > _UNIT_LENGTH:
            raise ParameterError(f"{name} must be unit vectors within {_UNIT_LENGTH:g} (got length {worst!r})")
    return _tuples(array.tolist())


def _tuples(values: Any) -> Any:
    return tuple(map(_tuples, values)) if isinstance(values, list) else values


class Body(Parameters):
    """Moving body: mass, moments of inertia, centre of mass in the frame of all points, gravity."""

    mass: float = param("moving mass", "kg", default=None, at_least=1e-3, at_most=1e3)
    inertia: Any = _array("inertia", "(3,)", "kg m²", (1e-3,) * 3, above=0.0, at_most=1e3)
    centre_of_mass: Any = _array("centre_of_mass", "(3,)", "m", _ZERO)
    gravity: Any = _array("gravity", "(3,)", "m/s²", (0.0, 0.0, -GRAVITY))


class Coils(Parameters):
    """Six or more coils on the body: points and unit directions of their forces (fixed axes), and limits."""

    points: Any = _array("points", "(N, 3)", "m")
    directions: Any = _array("directions", "(N, 3)", "")
    force_constants: Any = _array("force_constants", "(N,)", "N/A")
    current_limit: float = param("current limit", "A", default=None, above=0.0, at_most=20.0)
    continuous_current: float = param("", "A", default=None, derive=lambda coils: coils.current_limit, above=0.0)
    thermal_time: float = param("thermal time constant", "s", default=10.0, at_least=0.01, at_most=1e7)
    resistance: float | None = param("resistance", "ohm", default=None, optional=True, above=0.0)
    meter: float = param("resolution of the measured currents", "A", default=0.0, at_least=0.0, at_most=20.0)

    def check(self) -> None:
        """See `Parameters`."""
        if self.continuous_current > (most := self.current_limit):
            raise ParameterError(
                f"continuous_current must be at most current_limit, {most:g} A (got {self.continuous_current:g})"
            )
        self.wrench_per_current(_ZERO)

    def wrench_per_current(self, centre: Sequence[float]) -> Array:
        """Return the map from currents to a wrench about a point [N/A, N m/A], (6, N); see `wrench_map`."""
        return wrench_map(np.array(self.points) - centre, np.array(self.directions), np.array(self.force_constants))


def wrench_map(points: Array, directions: Array, force_constants: Array) -> Array:
    """Return the map from N coil currents to a wrench about the origin of the points [N/A, N m/A], (6, N).

    Raises:
        ModelError: If there are fewer than six coils, or they cannot give every wrench; the axes are named.
    """
    count = max(len(points), len(AXES))
    for name, part in (("points", points), ("directions", directions), ("force_constants", force_constants)):
        if len(part) != count:
            raise ModelError(f"{name} must have {count} entries, one for each of six or more coils (got {len(part)})")
    forces = directions * force_constants[:, None]
    upright = np.concatenate([forces.T, np.cross(points, forces).T])
    vectors = np.linalg.svd(upright)[0][:, np.linalg.matrix_rank(upright) :]  # wrenches that no currents give
    if axes := [axis for axis, row in zip(AXES, vectors) if np.linalg.norm(row) > _UNIT_LENGTH]:
        why = f"the coil map is singular, {count} coils cannot drive {', '.join(axes)} alone"
        raise ModelError(f"points and directions must allow every wrench: {why}")
    return np.asarray(upright)


def inverse_map(wrench_per_current: Array) -> Array:
    """Return the pseudoinverse of coil maps (..., 6, N), (..., N, 6): currents of least norm, unique for six coils."""
    if wrench_per_current.shape[-1] == len(AXES):
        return cast(Array, np.linalg.inv(wrench_per_current))
    turned = np.swapaxes(wrench_per_current, -1, -2)
    return cast(Array, turned @ np.linalg.inv(wrench_per_current @ turned))


def coil_names(count: int) -> tuple[str, ...]:
    """Return the actuator names of coils: `COILS`, and `coil6`, `coil7` and so on above six."""
    return (*COILS, *(f"coil{index}" for index in range(len(COILS), count)))


class Force(Parameters):
    """Actuator along x, y, z that takes a force: its limit on each axis."""

    limit: Any = _array("limit", "(3,)", "N", above=0.0)


class Travel(Parameters):
    """Range of motion to either side of the centre."""

    translation: Any = _array("translation", "(3,)", "m", (math.inf,) * 3, above=0.0, finite=False)
    rotation_deg: Any = _array("rotation_deg", "(3,)", "deg", (math.inf,) * 3, above=0.0, finite=False)
    stops: bool = param("stops at the ends of the range", default=True)


class SensorSection(Parameters):
    """Pose sensor: a pose computed on the device, or spots of three beams on three diodes.

    A pose is sent as x, y, z and the rotation vector times `lever`. LEDs and beams move with the body.
    """

    kind: str = param("what the device sends", default="pose", choices=("pose", "spots"))
    resolution: Any = _array("resolution", "(6,)", "m, rad", _ZERO * 2, at_least=0.0)
    noise: Any = _array("noise", "(6,)", "m, rad", _ZERO * 2, at_least=0.0)
    latency: float = param("age of a pose at its stamp", "s", default=0.0, at_least=0.0, at_most=1.0)
    lever: float = param("lever of rotations", "m", default=0.05, at_least=1e-3, at_most=1.0)
    offsets: Any = _array("offsets", "(6,)", "m", _ZERO * 2)
    leds: Any = _array("leds", "(3, 3)", "m", optional=True)
    directions: Any = _array("directions", "(3, 3)", "", optional=True)
    diodes: Any = _array("diodes", "(3, 3)", "m", optional=True)
    across: Any = _array("across", "(3, 2, 3)", "", optional=True)

    def check(self) -> None:
        """See `Parameters`."""
        for name in ("leds", "directions", "diodes", "across"):
            if (getattr(self, name) is None) == (self.kind == "spots"):
                raise ParameterError(f"{name} must be given for kind 'spots' alone (got kind {self.kind!r})")


class Driver(Parameters):
    """Current drivers: time constant of their lag, 0 for none."""

    time_constant: float = param("time constant", "s", default=0.0, at_least=0.0, at_most=LAG["at_most"])


class LoopSection(Parameters):
    """Sample rate, and delay from a sample's stamp to the effect of its command."""

    rate: float = param("sample rate", "Hz", default=None, at_least=1.0 / MAX_PERIOD, at_most=1.0 / MIN_PERIOD)
    delay: float = param("delay", "s", default=None, at_least=0.0, at_most=1.0)


class Knob(Parameters):
    """Knob at which a hand holds the body: radius, and height above the centre of mass."""

    radius: float = param("radius", "m", default=0.0165, above=0.0, at_most=1.0)
    height: float = param("height", "m", default=0.079, at_least=-1.0, at_most=1.0)

    @cached_property
    def centre(self) -> Array:
        """Centre of the knob in moving axes [m], (3,)."""
        return _frozen([0.0, 0.0, self.height])

    @cached_property
    def half(self) -> Array:
        """Half lengths of the drawn knob, a flattened sphere [m], (3,)."""
        return self.radius * np.array([1.0, 1.0, 25.0 / 33.0])

    @cached_property
    def bottom(self) -> float:
        """Height of the drawn knob's lower side [m]."""
        return self.height - self.radius * 38.0 / 55.0


class WallGains(NamedTuple):
    """Stiffness [N/m], damping and damping added by the braking pulse [N s/m] of a wall."""

    stiffness: float
    damping: float
    pulse: float


PUBLISHED_WALL = WallGains(6000.0, 80.0, 220.0)
"""Gains of the published wall, on the published joystick."""


_SECTIONS: Mapping[str, type[Parameters]] = {
    **{"body": Body, "coils": Coils, "force": Force, "range": Travel},
    **{"sensor": SensorSection, "driver": Driver, "loop": LoopSection, "knob": Knob},
}


_FIRST: Mapping[str, str] = {
    "body": "mass inertia centre_of_mass gravity",
    "coils": "points directions force_constants current_limit continuous_current thermal_time resistance",
    "force": "limit",
    "range": "translation rotation_deg stops",
    "sensor": "kind resolution noise latency lever offsets leds directions diodes across",
    "driver": "time_constant",
    "loop": "rate delay",
    "knob": "radius height",
}
"""Keys by section that are part of each digest; fixed."""

_NEUTRAL: Mapping[tuple[str, str], Any] = {("coils", "meter"): 0.0}
"""Keys that were added later, by section and name, each with the value that is as if it were not there.

A digest leaves out a key with that value, so that devices in use and later hosts agree. It is fixed, unlike a default,
which may change unnoticed.
"""


@checked
@dataclass(frozen=True, kw_only=True)
class Device:
    """Description of a device, in SI units.

    Attributes:
        name: Name; not part of the digest.
        axes: Actuated axes: all six, or x, y, z.
        coils: Coils; None for a device that takes a force.
        force: Force limits; None for a device with coils.

    Example:
        >>> from maglev_mj import Device
        >>> device = Device.load("stage")
        >>> device.mass, device.force_limit.round(1).tolist()[2]  # [kg], [N]
        (0.3, 33.0)
    """

    name: str
    axes: tuple[str, ...] = AXES
    body: Body
    coils: Coils | None = None
    force: Force | None = None
    range: Travel
    sensor: SensorSection
    driver: Driver
    loop: LoopSection
    knob: Knob

    def __post_init__(self) -> None:
        if (self.coils is None) == (self.force is None):
            raise ParameterError("exactly one of [coils] and [force] must be given")
        if self.axes not in (AXES, AXES[:3]) or (self.coils is not None and self.axes != AXES):
            raise ParameterError(
                f"axes must be {list(AXES)}, or {list(AXES[:3])} without coils (got {list(self.axes)})"
            )
        if self.coils is not None and self.sensor.kind == "spots" and self.sensor.latency:
            raise ParameterError(f"sensor.latency must be 0 for spots (got {self.sensor.latency:g})")
        transport_delay(self.delay, self.period, "loop.delay plus sensor.latency")

    @classmethod
    def load(cls, path: str | Path) -> Device:
        """Read a device file (.toml), its text, or a device of the package by name: ubc, stage, arm.

        Raises:
            ParameterError: If it cannot be read, or a value is missing, unknown, of another type or out of bounds; one
                line with file and section.key.
        """
        if isinstance(path, str) and "\n" in path:
            return cls.parse(path)
        return read_file("device file", path, cls.parse) if str(path).endswith(".toml") else _of_package(path)

    @classmethod
    @lru_cache(maxsize=32)
    def parse(cls, text: str) -> Device:
        """Return the device of a TOML text; see `load`."""
        import tomllib  # imported here: slow

        try:
            values = tomllib.loads(text.removeprefix("\ufeff"))
        except (ValueError, RecursionError) as error:  # also an integer of thousands of digits
            raise ParameterError(f"not TOML: {error}") from None
        sections = {name: value for name, value in values.items() if isinstance(value, dict)}
        top = {name: value for name, value in values.items() if name not in sections}
        for name in sections:
            check_one_of("section", _SECTIONS, name)
        _check_keys("", top, {"format": True, "name": True, "axes": False})
        if repr(top["format"]) != "1":
            raise ParameterError(f"format must be 1 (got {top['format']!r})")
        if not isinstance(top["name"], str) or not top["name"].isprintable() or not top["name"]:
            raise ParameterError(f"name must be a printable text (got {top['name']!r})")
        axes = top.get("axes", list(AXES))
        required = {"body", "loop"} | set(sections)
        made = {
            name: _section(name, kind, sections.get(name, {}))
            for name, kind in _SECTIONS.items()
            if name in required or name not in ("coils", "force")
        }
        return cls(name=top["name"], axes=tuple(axes) if isinstance(axes, list) else axes, **made)  # type: ignore[arg-type]

    def toml(self) -> str:
        """Return the device as the text of a file, without loss of precision."""
        lines = ["format = 1", f"name = {json.dumps(self.name)}", f"axes = {json.dumps(self.axes)}"]
        for name in _SECTIONS:
            if (section := getattr(self, name)) is not None:
                rows = section.as_json().items()
                lines += ["", f"[{name}]", *(f"{key} = {_toml(value)}" for key, value in rows if value is not None)]
        return "\n".join(lines) + "\n"

    def change(self, section: str, **values: Any) -> Device:
        """Return the device with other values in a section."""
        return replace(self, **{section: getattr(self, section).replace(**values)})

    def as_json(self) -> dict[str, Any]:
        """Return all values but the name by section, with their defaults."""
        sections = {name: section.as_json() for name in _SECTIONS if (section := getattr(self, name)) is not None}
        return {"axes": list(self.axes), **sections}

    @cached_property
    def digest(self) -> bytes:
        """BLAKE2s digest of all values but the name and those of `_NEUTRAL`, 16 bytes."""
        text = json.dumps(self._digested(), sort_keys=True, separators=(",", ":"))
        return hashlib.blake2s(text.encode(), digest_size=16).digest()

    def _digested(self) -> dict[str, Any]:
        """Return the values that count; sections without any are left out."""
        values: dict[str, Any] = {"axes": list(self.axes)}
        for section, of in self.as_json().items():
            if section != "axes" and (
                kept := {name: x for name, x in of.items() if not self._neutral(section, name, x)}
            ):
                values[section] = kept
        return values

    def _neutral(self, section: str, name: str, value: Any) -> bool:
        """Return True if a digest leaves out a value, as that of a key which was added later."""
        if name in _FIRST.get(section, "").split():
            return False
        declared = getattr(self, section).parameter(name).default  # a test asks for `_NEUTRAL`
        return bool(value == _NEUTRAL.get((section, name), declared))

    @cached_property
    def published(self) -> bool:
        """True for the published joystick, under any name."""
        return self.digest == published_device().digest

    @cached_property
    def mass(self) -> float:
        """Moving mass [kg]."""
        return self.body.mass

    @cached_property
    def period(self) -> float:
        """Sample period [s]."""
        return 1.0 / self.loop.rate

    @cached_property
    def delay(self) -> float:
        """Delay from a pose to the effect of its command [s]."""
        return self.loop.delay + self.sensor.latency

    @cached_property
    def inertia(self) -> Array:
        """Mass and moments of inertia [kg, kg m²], (6,)."""
        return _frozen([self.mass] * 3 + list(self.body.inertia))

    @cached_property
    def reach(self) -> Array:
        """Range of motion to either side of the centre [m, rad], (6,); infinite without one."""
        return _frozen([*self.range.translation, *np.radians(self.range.rotation_deg)])

    @cached_property
    def scale(self) -> Scale:
        """Thresholds of a flight that follow from this file; only for a device with coils."""
        return Scale.of(self.sizes, published_device().sizes)

    @cached_property
    def sizes(self) -> Sizes:
        """Sizes from which the thresholds of a flight follow; g is 9.81 m/s² and a range that of `ubc` without one."""
        if self.coils is None:
            raise ParameterError(f"device {self.name!r} has no coils: its scale is not defined")
        gravity = np.array(self.body.gravity)
        weight = float(np.linalg.norm(gravity))
        down = gravity / weight if weight else np.array([0.0, 0.0, -1.0])
        unit = self.coils.wrench_per_current(self.body.centre_of_mass)[:3]
        reach = np.where(np.isfinite(self.reach), self.reach, RANGE)
        noise = np.hypot(np.array(self.sensor.resolution) / math.sqrt(12.0), self.sensor.noise)
        return Sizes(
            mass=self.mass,
            gravity=weight or GRAVITY,
            longest=float(reach[:3].max()),
            shortest=float(reach[:3].min()),
            fall=float(1.0 / (np.abs(down) / reach[:3]).max()),
            tilt=float(reach[3:].max()),
            narrowest=float(reach[3:].min()),
            radius=math.sqrt(float(self.inertia[3:].mean()) / self.mass),
            force=min(HAND, float(self.force_limit[:3].min())),
            lift=float(np.abs(down @ unit).sum()),
            noise=float(noise[:3].max()),
            turning=float(noise[3:].max()),
        )

    @cached_property
    def range_ratio(self) -> Array:
        """Range of motion as a multiple of the published joystick's, 1 without a range, (6,)."""
        return _frozen(np.where(np.isfinite(self.reach), self.reach, RANGE) / np.array(RANGE))

    @cached_property
    def force_limit(self) -> Array:
        """Largest force or torque on each axis alone [N, N m], (6,)."""
        if self.coils is None:
            assert self.force is not None
            return _frozen([*self.force.limit, 0.0, 0.0, 0.0])
        inverse = inverse_map(self.coils.wrench_per_current(self.body.centre_of_mass))
        # rounded, since a limit is compared and printed: 60 N, not its neighbour in floating point
        return _frozen(np.round(self.coils.current_limit / np.abs(inverse).max(axis=0), 12))

    @cached_property
    def coil_radius(self) -> float:
        """Largest distance of a coil from the vertical axis through the centre of mass [m]; 0 without coils."""
        places = np.zeros((1, 3)) if self.coils is None else np.array(self.coils.points) - self.body.centre_of_mass
        return float(np.hypot(places[:, 0], places[:, 1]).max())

    @cached_property
    def escape(self) -> float:
        """Distance from the centre at which a simulation counts as diverged [m]: ten ranges, or 1 m without one."""
        largest = max(self.range.translation)
        return 10.0 * largest if math.isfinite(largest) else 1.0

    @cached_property
    def reference(self) -> str:
        """Value for `load` that needs no file: the name of a device of the package, or the text."""
        own = (name for name in devices() if Device.load(name) == self)
        return next(own, None) or self.toml()

    @cached_property
    def keywords(self) -> dict[str, Any]:
        """Keywords that make a plant this device; none for the published joystick, as by default."""
        return {} if self.published else {"model": self}

    @cached_property
    def height(self) -> float:
        """Height of the centre above the lower end of the range [m]."""
        return float(self.range.translation[2])

    @cached_property
    def wall(self) -> WallGains:
        """Default gains of walls: the published ones, or less where the device is lighter or slower for them.

        A loop of mass m and time t behaves as the published one if stiffness is proportional to m/t² and damping to
        m/t. Its time is the period, or half of it plus the delay, whichever is more of the published. A pulse acts
        until the next command at most, and its impulse is proportional to m.
        """
        usual = published_device()
        mass, period = self.mass / usual.mass, self.period / usual.period
        time = max(period, (0.5 * self.period + self.delay) / (0.5 * usual.period + usual.delay))
        acting = min(PULSE_WIDTH, self.period) / PULSE_WIDTH
        shares = mass / time**2, mass / time, mass / acting
        return WallGains(*(gain * min(share, 1.0) for gain, share in zip(PUBLISHED_WALL, shares)))

    @property
    def rest(self) -> tuple[float, ...]:
        """Pose on the lower stop, or the centre without stops [m, rad], six."""
        low = -self.height if self.range.stops and math.isfinite(self.height) else 0.0
        return (0.0, 0.0, low, 0.0, 0.0, 0.0)

    def mjcf(self) -> str:
        """Return the bare device as MJCF: the flotor with its joints and knob, and a site and an actuator per coil."""
        move, turn = self.range.translation, min(self.range.rotation_deg)
        joints = [
            _joint(x, "slide", -end, end, f'axis="{_row(np.eye(3)[k])}"') for k, (x, end) in enumerate(zip("xyz", move))
        ]
        joints.append(_joint("rotation", "ball", 0.0, turn))
        parts, actuators = [_rod(0.5 * self.knob.radius, self.knob.centre)], list[str]()
        if (part := self.coils) is not None:
            rows = zip(
                coil_names(len(part.points)),
                np.array(part.points) - self.body.centre_of_mass,
                part.directions,
                part.force_constants,
                strict=True,
            )
            for name, point, direction, constant in rows:
                winding = f'type="cylinder" size="{_row(self.knob.half[1:] * [0.6, 0.2])}" zaxis="{_row(direction)}"'
                parts.append(_rod(0.1 * self.knob.radius, point))
                parts.append(f'<geom {winding} pos="{_row(point)}" material="copper"/>')
                parts.append(f'<site name="{name}" pos="{_row(point)}"/>')
                limits = f'ctrllimited="true" ctrlrange="{_row([-part.current_limit, part.current_limit])}"'
                force = f'gear="{_row(direction)} 0 0 0" gainprm="{constant:.17g}"'
                actuators.append(f'<general name="{name}" site="{name}" refsite="stator" {force} {limits}/>')
        return f"""<mujoco model="device">
  <compiler angle="degree"/>
  <option gravity="{_row(self.body.gravity)}"/>
  <default>
    <joint solreflimit="0.004 1" solimplimit="0.99 0.995 0.0005"/>
    <geom contype="0" conaffinity="0" mass="0" material="grip"/>
    <site group="4"/>
  </default>
  <asset>
    <material name="copper" rgba="0.42 0.25 0.17 1" specular="0.9" shininess="0.7"/>
    <material name="grip" rgba="0.11 0.11 0.12 1" specular="0.35" shininess="0.2"/>
  </asset>
  <custom><numeric name="driver_time_constant" data="{self.driver.time_constant:.17g}"/></custom>
  <worldbody>
    <site name="stator"/>
    <body name="flotor">
      {"".join(joints)}
      <inertial pos="0 0 0" mass="{self.mass:.17g}" diaginertia="{_row(self.body.inertia)}"/>
      <geom type="ellipsoid" size="{_row(self.knob.half)}" pos="{_row(self.knob.centre)}"/>
      {"".join(parts)}
    </body>
  </worldbody>
  <actuator>{"".join(actuators)}</actuator>
</mujoco>
"""


def sample_period(**options: Any) -> Any:
    """Declare the sample period of an `OnDevice`, by default the device's."""
    own: Any = {"default": None, "derive": attrgetter("hardware.period")}
    return param("sample period", "s", **own, at_least=MIN_PERIOD, at_most=MAX_PERIOD, **options)


def command_delay(**options: Any) -> Any:
    """Declare the delay of an `OnDevice` from a sample to the effect of its command, by default the device's."""
    own: Any = {"default": None, "derive": attrgetter("hardware.delay"), "at_least": 0.0}
    return param("delay from a sample to the effect of its command", "s", **own | options)


def lag_of(device: Device) -> float:
    """Return the time constant of a device's drivers that enters its loops [s].

    The published joystick's 80 µs are part of its published delay of 1.5 ms: the paper's own analysis has no other lag.
    So they are where it is calibrated, with the same drivers and loop.
    """
    own = published_device()
    return 0.0 if (device.driver, device.loop) == (own.driver, own.loop) else device.driver.time_constant


class OnDevice(Parameters):
    """Parameters with defaults of a device."""

    device: str = param("device file (.toml), or a device of the package by name", default=PUBLISHED)

    @cached_property
    def hardware(self) -> Device:
        """Description of the device."""
        return published_device() if self.device == PUBLISHED else Device.load(self.device)


@cache
def _of_package(name: str) -> Device:
    check_one_of("device", devices(), name, ", or a file .toml")
    return read_file("device file", _FOLDER / f"{name}.toml", Device.parse)


@cache
def published_device() -> Device:
    """Return the published joystick."""
    return _of_package(PUBLISHED)


def devices() -> tuple[str, ...]:
    """Return the names of the devices of the package."""
    return tuple(sorted(path.stem for path in _FOLDER.glob("*.toml")))


def _section(name: str, kind: type[Parameters], values: Mapping[str, Any]) -> Parameters:
    """Return a checked section."""
    declared = kind.parameters()
    _check_keys(
        f"{name}.", values, {x.name: x.default is None and not x.optional and x.derive is None for x in declared}
    )
    try:
        return kind(**values)
    except ParameterError as error:
        raise ParameterError(f"{name}.{error}") from None


def _check_keys(where: str, values: Mapping[str, Any], keys: Mapping[str, bool]) -> None:
    """Raise ParameterError for an unknown key, or a missing one that is required."""
    for name in values:
        if name not in keys:
            raise ParameterError(f"{where}{name} is not a key; keys are {', '.join(keys)}")
    for name, required in keys.items():
        if required and name not in values:
            raise ParameterError(f"{where}{name} is missing")


def _toml(value: Any) -> str:
    """Return a value as TOML; a float's text is exact."""
    if isinstance(value, tuple):
        return f"[{', '.join(map(_toml, value))}]"
    return repr(value) if isinstance(value, float) else json.dumps(value)


def _frozen(values: Any) -> Array:
    """Return a read-only array."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


def _row(values: Any) -> str:
    return " ".join(f"{value:.17g}" for value in np.ravel(values))


def _rod(radius: float, end: Array) -> str:
    """Return a rod from the centre; MuJoCo refuses one without length."""
    return f'<geom type="capsule" size="{radius:.17g}" fromto="0 0 0 {_row(end)}"/>' if np.any(end) else ""


def _joint(name: str, kind: str, low: float, high: float, more: str = "") -> str:
    limits = f'limited="true" range="{_row([low, high])}"' if math.isfinite(high) else ""
    return f'<joint name="{name}" type="{kind}" {limits} {more}/>'
