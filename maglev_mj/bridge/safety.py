"""Limits of device and host, and guards that check them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np

from maglev_mj.bridge.wire import MOST_WALLS, PROPERTIES, VERSION, Fault, HelloAck, WallMessage
from maglev_mj.control.timeline import Timeline, Timing
from maglev_mj.device import Device, published_device
from maglev_mj.errors import ParameterError, PlantError
from maglev_mj.frames import AXES, ZERO, Command, clipped, unit_of
from maglev_mj.keywords import checked
from maglev_mj.parameters import Parameters, flag, number, param, read_json, store
from maglev_mj.plants.coils import CoilMap, limited_wrench
from maglev_mj.plants.sensor import geometry_of, largest_spot
from maglev_mj.scale import OFF_LIFT, Scale
from maglev_mj.spec import Spec

WARNING_RISE = 0.8
"""Temperature rise that raises a warning, as a share of the limit."""

_NO_FAULT = Fault(0)
_CONTINUOUS = Spec.continuous_current.value
_CHANGED = (0, 0, 0)
_TOLERANCE = 0.1
_IMPLAUSIBLE = 4.0
_STALE = 4
"""Periods after which an answer is stale, unless stated otherwise."""
_HEADROOM = 1.25
"""Factor over the weight and the hover currents, as headroom for control."""
_ROOM = 1.1
"""Limit of a spot over the largest of poses within the envelope: outside of that BOUNDARY comes first."""
_ROUNDING = 1e-9
_LIFT, _METER_STEPS = 0.25, 3.0
"""Largest share of the weight that currents at `off_current` may lift; its least value in steps of the meter."""
_COLD, _HOT, _OVER = -0.01, 2.0, 1.5
"""Bounds of reported temperatures; ratio of a measured current to the limit that counts as overcurrent."""


class Limits(Parameters):
    """Limits of a device, named as in HELLO_ACK.

    The host refuses a device with limits outside these bounds.
    """

    current_limit: float = param("coil current limit", "A", default=Spec.peak_current.value, above=0.0, at_most=20.0)
    continuous_current: float = param("continuous current limit", "A", default=_CONTINUOUS, above=0.0, at_most=20.0)
    thermal_time: float = param("thermal time constant; assumed", "s", default=10.0, at_least=0.01, at_most=1e7)
    spot_limit: float = param("spot position limit; assumed", "m", default=0.0209, at_least=1e-4, at_most=10.0)
    spot_speed: float = param("spot speed limit; assumed", "m/s", default=1.0, at_least=1e-3, at_most=100.0)
    watchdog: float = param("watchdog timeout", "s", default=0.05, at_least=1e-3, at_most=1.0)
    enable: float = param("enable line timeout", "s", default=0.01, at_least=1e-5, at_most=1.0)
    stale: float | None = param(
        "age limit of an answered sample; None: 4 periods", "s", default=None, optional=True, at_least=1e-5
    )
    hover_limit: float = param("hover current limit", "A", default=_CONTINUOUS, at_least=0.0, at_most=20.0)
    frozen: int = param("equal readings of a frozen sensor; 0: no check", default=30, at_least=0, at_most=1_000_000)
    stiffness_limit: float = param("stiffness limit of a wall", "N/m", default=1e5, at_least=0.0, at_most=1e8)
    damping_limit: float = param("damping limit of a wall", "N s/m", default=400.0, at_least=0.0, at_most=1e6)
    edge_speed: float = param("speed limit of a wall's edge", "m/s", default=0.1, at_least=0.0, at_most=10.0)
    wall_count: int = param("largest number of walls", default=MOST_WALLS, at_least=0, at_most=MOST_WALLS)
    lever: float = param("lever arm of a wall on a rotation", "m", default=0.03, above=0.0, at_most=10.0)
    energy: float = param("energy limit of the walls", "J", default=0.004, above=0.0, at_most=1e3)
    recede: float = param("speed of edges in a controlled stop", "m/s", default=0.03, at_least=0.0, at_most=10.0)
    off_current: float = param("largest current of a coil that is off", "A", default=0.25, above=0.0, at_most=20.0)

    def lever_of(self, axis: int) -> float:
        """Return the lever arm of the limits of a wall on an axis [m]; 1 on a translation."""
        return 1.0 if axis < 3 else self.lever


def are_off(currents: Iterable[float], off_current: float) -> bool:
    """Return True if all measured currents [A] count as off; False for NaN."""
    return all(abs(current) <= off_current for current in currents)


def at_most(current: float) -> str:
    """Return a bound of the currents [A] as text, rounded up."""
    digits = 1 - math.floor(math.log10(current)) if 0.0 < current < math.inf else 0
    return f"at most {math.ceil(current * 10.0**digits * (1.0 - 1e-9)) / 10.0**digits:g} A in each coil"


def off_fault(limits: Limits, device: Device) -> str:
    """Return a message if currents that a device takes for off could lift its flotor, or its meter is too coarse."""
    off, largest = limits.off_current, device.scale.off * _LIFT / OFF_LIFT
    if off > largest:
        return f"off_current must be at most {largest:.3g} A, which lifts 25 % of the weight (got {off:.3g} A)"
    if device.coils is not None and off < _METER_STEPS * device.coils.meter:
        return f"off_current must be at least three times coils.meter, {device.coils.meter:.3g} A (got {off:.3g} A)"
    return ""


def macro(name: str, members: Mapping[str, Any]) -> str:
    """Return a C macro that initialises the members of a structure by name."""
    lines = []
    for member, value in members.items():
        numbers = ", ".join(repr(x) for x in (1 * np.ravel(value)).tolist())  # true as 1
        lines.append(f".{member} = {{{numbers}}}" if np.ndim(value) else f".{member} = {numbers}")
    return f"#define {name} \\\n    " + ", \\\n    ".join(lines)


@lru_cache(maxsize=64)
def limits_of(device: Device) -> Limits:
    """Return the limits of a device with coils; thresholds by its `Scale`, within the bounds of `Limits`.

    Raises:
        ParameterError: If its meter is too coarse to tell that the coils are off, or its sensor does not see its range.
    """
    coils = device.coils
    if coils is None:
        return Limits()
    steady, scale = coils.continuous_current, device.scale
    own = Limits(current_limit=coils.current_limit, continuous_current=steady, hover_limit=steady).replace(
        stiffness_limit=min(scale.stiffness, 1e8),
        damping_limit=min(scale.damping, 1e6),
        edge_speed=min(scale.edge, 10.0),
        lever=min(scale.lever, 10.0),
        energy=min(scale.wall_energy, 1e3),
        recede=min(scale.recede, 10.0),
        off_current=min(scale.off, steady),
    )
    if problem := off_fault(own, device):
        raise ParameterError(problem)
    farthest = _ROOM * largest_spot(geometry_of(device), scale.reach) + max(map(abs, device.sensor.offsets))
    if not math.isfinite(farthest):
        raise ParameterError("sensor.directions: a beam turns past its diode within the range of motion")
    spot_limit = max(math.ceil(1e4 * farthest) / 1e4, 1e-4)
    return own.replace(thermal_time=coils.thermal_time, spot_limit=spot_limit)


_LIMITS = [x.name for x in Limits.parameters()]
_NANOSECONDS = [name for name in _LIMITS if PROPERTIES[name].type == "u64"]
"""Limits in nanoseconds on the wire."""
_OWN = [name for name in PROPERTIES if name not in (*_LIMITS, "lockstep", "device")]
"""Properties that a profile has under their names."""

_AT_MOST = (
    ("two periods", "watchdog"),
    ("delay", "two periods"),
    ("enable", "watchdog"),
    ("one period", "stale"),
    ("stale", "watchdog"),
    ("hover_limit", "continuous_current"),
    ("continuous_current", "current_limit"),
    ("off_current", "continuous_current"),
    ("latency", "two periods"),
    ("wall_delay", "two wall periods"),
)
"""Pairs in which the first must be at most the second, as in HELLO_ACK."""


class WallMaps(NamedTuple):
    """Linear maps of a device that renders walls, at the centre; see `Calibration.wall_maps`.

    Attributes:
        spots: Spots at the centre [m], six.
        pose_per_spot: Rows of the map from a change of the spots to the pose [1, rad/m], (6, 6).
        current_per_wrench: Rows of the map from wrench to currents [A/N, A/(N m)], (6, 6).
    """

    spots: Sequence[float]
    pose_per_spot: Sequence[Sequence[float]]
    current_per_wrench: Sequence[Sequence[float]]

    def pose(self, spots: Sequence[float]) -> list[float]:
        """Return the linearised pose [m, rad], six."""
        a, b, c, d, e, f = [spot - centre for spot, centre in zip(spots, self.spots)]
        return [p * a + q * b + r * c + s * d + t * e + u * f for p, q, r, s, t, u in self.pose_per_spot]


@dataclass(frozen=True, kw_only=True)
class Profile:
    """Properties of a device, as in HELLO_ACK; see docs/reference/protocol.md.

    The default of `stale` is four periods, at most the watchdog timeout.

    Raises:
        ParameterError: If a number is outside its bounds, or two contradict each other.
    """

    period: int  # [ns]
    delay: int  # [ns]
    calibration: bytes
    limits: Limits = field(default_factory=Limits)
    lockstep: bool = False
    number: int = 1
    wall_period: int = 0  # of walls on the device [ns]; 0 for none
    wall_delay: int = 0  # [ns]
    latency: int = 0  # age of the spots at a sample's time [ns]
    wall_maps: WallMaps | None = None  # not on the wire

    def __post_init__(self) -> None:
        number("period", self.period * 1e-9, at_least=1e-5, at_most=0.1)
        for name in ("delay", "latency"):
            number(name, getattr(self, name) * 1e-9, at_least=0.0, at_most=0.1)
        flag("lockstep", self.lockstep)
        if self.limits.stale is None:
            store(self, limits=self.limits.replace(stale=min(_STALE * self.period * 1e-9, self.limits.watchdog)))
        # compare in units of the wire, to round as the device does
        values = {**self.stated, "one period": self.period, "two periods": 2 * self.period}
        values["two wall periods"] = 2 * self.wall_period
        if self.wall_period and (self.wall_period < 0 or self.period % self.wall_period):
            raise ParameterError(f"wall_period must divide {self.period} ns, the period (got {self.wall_period})")
        for name, bound in _AT_MOST:
            if values[name] > values[bound]:
                scale, unit = (1e-9, "s") if isinstance(values[bound], int) else (1, "A")
                value, most = (f"{values[key] * scale:.9g} {unit}" for key in (name, bound))
                raise ParameterError(f"{name} must be at most {bound}, {most} (got {value})")

    @property
    def stated(self) -> dict[str, Any]:
        """Properties as HELLO_ACK states them, by name: times in whole nanoseconds."""
        own = {name: getattr(self, name) for name in _OWN} | {"device": self.number, "lockstep": self.lockstep}
        limits = {name: getattr(self.limits, name) for name in _LIMITS}
        return own | limits | {name: round(limits[name] * 1e9) for name in _NANOSECONDS}

    def header(self, **more: Any) -> str:
        """Return the C macro PROFILE, the firmware's `struct maglev_profile`; `more` adds or replaces members."""
        maps = self.wall_maps
        members = self.stated | {"calibration": [*self.calibration]}
        if maps is not None:
            members |= {"spots": maps.spots, "pose": maps.pose_per_spot, "current": maps.current_per_wrench}
        return macro("PROFILE", members | more)

    @classmethod
    def of(cls, answer: HelloAck) -> Self:
        """Return the properties that a device states."""
        number("lockstep", answer.lockstep, at_least=0, at_most=1)
        own = {name: getattr(answer, name) for name in _OWN}
        limits = {name: getattr(answer, name) * (1e-9 if name in _NANOSECONDS else 1) for name in _LIMITS}
        return cls(**own, limits=Limits(**limits), lockstep=bool(answer.lockstep), number=answer.device)

    def answer(self, **state: Any) -> HelloAck:
        """Return the HELLO_ACK with these properties and the given state."""
        return HelloAck(version=VERSION, **self.stated, **state)

    def wall_problem(self, walls: Sequence[WallMessage]) -> str:
        """Return why the device cannot render these walls together, or "".

        The limits hold for the sums of the walls that push the same way along an axis.
        """
        if walls and not self.wall_period:
            return "the device renders no walls"
        if len(walls) > (count := self.limits.wall_count):
            return f"the device renders at most {count} walls (got {len(walls)})"
        for wall in walls:
            if wall.axis not in range(6) or wall.side not in (-1, 0, 1) or not math.isfinite(wall.edge):
                return f"a wall needs an axis from 0 to 5, a side of -1, 0 or 1 and a finite edge (got {wall})"
            if not 0.0 <= wall.cutoff < math.inf:
                return f"cutoff of a wall must be 0 or above (got {wall.cutoff:g})"
        for name, unit in (("stiffness", "N/m"), ("damping", "N s/m")):
            sums: dict[tuple[int, int], float] = {}
            for wall in walls:
                axis, value = wall.axis, getattr(wall, name)
                lever = self.limits.lever_of(axis)
                most = getattr(self.limits, f"{name}_limit") * lever * lever
                if not 0.0 <= value <= most:  # also for NaN
                    bound = f"between 0 and {most:g} {unit_of(unit, axis)}, the device's limit"
                    return f"{name} of the wall on {AXES[axis]} must be {bound} (got {value:g})"
                for push in (-1, 1):
                    if wall.side == -push:  # a wall on both sides pushes both ways
                        continue
                    sums[axis, push] = total = sums.get((axis, push), 0.0) + value
                    if total > most:
                        pushing = f"the walls that push towards {'-+'[push > 0]}{AXES[axis]}"
                        bound = f"at most {most:g} {unit_of(unit, axis)}, the device's limit"
                        return f"sum of the {name} of {pushing} must be {bound} (got {total:g})"
        return ""

    def edge_problem(
        self, walls: Sequence[WallMessage], latest: Sequence[WallMessage], pose: Sequence[float], periods: int
    ) -> str:
        """Return why the device refuses the edges of these walls, or "".

        An edge moves at most at `edge_speed`, and a new wall contains the flotor by at most one period of that.

        Args:
            walls: All walls of a command.
            latest: Those of the command before.
            pose: Linearised pose at the last sample [m, rad], six.
            periods: Sample periods for which edges may move.
        """
        for index, wall in enumerate(walls):
            speed = self.limits.edge_speed / self.limits.lever_of(wall.axis)
            step = speed * (self.period * 1e-9) * (1.0 + _ROUNDING)
            depth, continues = wall.edge - pose[wall.axis], index < len(latest) and wall[:2] == latest[index][:2]
            moved, event = wall.side * depth if wall.side else abs(depth), "start around the flotor by"
            if continues:
                moved, step, event = abs(wall.edge - latest[index].edge), step * periods, "move by"
            if not moved <= step:  # also for NaN
                unit = "m" if wall.axis < 3 else "rad"
                limit = f"{step:.3g} {unit} at {speed:g} {unit}/s, the device's limit"
                return f"edge of the wall on {AXES[wall.axis]} must {event} at most {limit} (got {moved:.3g})"
        return ""


_SCALED = {"envelope": "envelope", "envelope_angle": "tilt", "speed_limit": "speed", "spin_limit": "spin"}
"""Limits of the host that follow from the device's file unless they are set, and their names in `Scale`."""


def _scaled_limit(name: str, help: str, unit: str) -> Any:
    """Declare a limit that follows from the device's file; the published joystick's until `HostLimits.scaled`."""
    own = attrgetter(_SCALED[name])
    return param(help, unit, default=None, derive=lambda _: own(published_device().scale), above=0.0)


@checked
class HostLimits(Parameters):
    """Limits of the host; the smaller of these and the device's apply.

    Envelope and speeds that are not set are the device's own, see `Scale`; here those of the published joystick.

    Example:
        >>> from maglev_mj import HostLimits
        >>> HostLimits(max_current=5.0).speed_limit
        0.6
    """

    max_current: float | None = param("coil current limit", "A", default=None, optional=True, above=0.0)
    continuous_current: float | None = param("continuous current limit", "A", default=None, optional=True, above=0.0)
    force_limit: float | None = param("force limit per axis, with weight", "N", default=None, optional=True, above=0.0)
    torque_limit: float | None = param("torque limit per axis", "N m", default=None, optional=True, above=0.0)
    envelope: float = _scaled_limit("envelope", "position limit in flight; just outside the stops", "m")
    envelope_angle: float = _scaled_limit("envelope_angle", "rotation limit in flight", "rad")
    speed_limit: float = _scaled_limit("speed_limit", "flotor speed limit", "m/s")
    spin_limit: float = _scaled_limit("spin_limit", "flotor angular speed limit", "rad/s")

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a profile: a JSON object of limits by name, in SI units.

        Raises:
            ParameterError: If it cannot be read, or a value is outside its bounds; one line with file and value.
        """
        return read_json("profile", path, lambda values: cls.from_json(_by_name(values)))

    @property
    def wrench(self) -> list[float] | None:
        """Wrench limit [N, N m], six; None without a limit."""
        if self.force_limit is None and self.torque_limit is None:
            return None
        return [self.force_limit or math.inf] * 3 + [self.torque_limit or math.inf] * 3

    def scaled(self, scale: Scale) -> Self:
        """Return limits with the device's own in place of those that were not set."""
        return self.replace(**{name: getattr(scale, _SCALED[name]) for name in _SCALED if name in self._derived})

    def narrowed(self, limits: Limits) -> Limits:
        """Return the smaller of the device's and the host's limits."""
        current = min(limits.current_limit, self.max_current or math.inf)
        steady = min(limits.continuous_current, self.continuous_current or math.inf)
        hover = min(limits.hover_limit, current, steady)
        return limits.replace(current_limit=current, continuous_current=steady, hover_limit=hover)


def _by_name(values: Any) -> dict[str, Any]:
    if not isinstance(values, dict):
        raise ParameterError(f"must be a JSON object of limits by name (got {values!r:.60})")
    return values


def weight_fault(weight: float, hover: Sequence[float], own: HostLimits, limits: Limits) -> str:
    """Return a message if the limits do not allow hovering, else "".

    `weight` is in [N], `hover` are six currents [A].
    """
    largest = max(map(abs, hover))
    force, least, current = own.force_limit, _HEADROOM * largest, limits.current_limit
    if force is not None and force <= _HEADROOM * weight:
        return f"force_limit must be above {_HEADROOM * weight:.3g} N (got {force:g}): the weight is {weight:.3g} N"
    if current < least:
        needs = f"hovering needs {largest:.3g} A plus 25 % for control"
        return f"max_current must be at least {least:.3g} A (got {current:g}): {needs}"
    if limits.hover_limit < largest:
        return f"the hover limit must be at least {largest:.3g} A to carry the weight (got {limits.hover_limit:g})"
    return ""


class ThermalModel:
    """First-order thermal model of the six coils.

    Temperature rises are relative to the steady state at the continuous current; at 1 a coil trips.

    Attributes:
        rises: Temperature rises of the six coils.
        warmest: Largest of the rises.
    """

    def __init__(self, limits: Limits) -> None:
        self.rises, self.warmest = [0.0] * 6, 0.0
        self._scale, self._time = limits.continuous_current**-2, limits.thermal_time
        self._duration, self._share = 0.0, 0.0

    def add(self, intervals: Iterable[tuple[float, Sequence[float]]]) -> float:
        """Add intervals, each a duration [s] and six currents [A]; return the largest rise.

        θ' = ((i / i_continuous)² - θ) / τ, solved exactly for constant currents.
        """
        p, q, r, s, t, u = self.rises
        scale = self._scale
        for duration, (a, b, c, d, e, f) in intervals:
            if duration != self._duration:
                self._duration, self._share = duration, -math.expm1(-duration / self._time)
            share = self._share  # unrolled: half the time of a loop
            p, q, r = p + share * (scale * a * a - p), q + share * (scale * b * b - q), r + share * (scale * c * c - r)
            s, t, u = s + share * (scale * d * d - s), t + share * (scale * e * e - t), u + share * (scale * f * f - u)
        shares = [p, q, r, s, t, u]
        if not math.isfinite(sum(shares)):
            shares = [1.0] * 6  # trip on a non-finite reading
        self.rises, self.warmest = shares, max(shares)
        return self.warmest


def command_fault(limits: Limits, held: Sequence[float], pulsed: Sequence[float], width: float) -> Fault:
    """Return the fault of a command, if any.

    Six held and six pulsed currents [A], and the pulse width [s]: checked, not clipped.
    """
    # per element: the sum of finite numbers may overflow
    if not all(map(math.isfinite, (*held, *pulsed))) or not 0.0 <= width <= 1.0:
        return Fault.INVALID_COMMAND
    # tolerate rounding on the host
    bound = limits.current_limit * (1.0 + 1e-9)
    if max(held) > bound or min(held) < -bound or max(pulsed) > bound or min(pulsed) < -bound:
        return Fault.COIL_OVERCURRENT
    return _NO_FAULT


def reading_fault(limits: Limits, currents: Sequence[float], temperatures: Sequence[float]) -> Fault:
    """Return the fault of measured currents and temperatures.

    Currents [A] and temperature rises, six each.
    """
    bound, (a, b, c, d, e, f) = _OVER * limits.current_limit, currents
    # fast path: a sum of squares checks bounds and finiteness at once
    if a * a + b * b + c * c + d * d + e * e + f * f <= bound * bound and min(temperatures) >= _COLD:
        a, b, c, d, e, f = temperatures
        if a * a + b * b + c * c + d * d + e * e + f * f <= _HOT * _HOT:
            return _NO_FAULT
    fault = _NO_FAULT if all(_COLD <= x <= _HOT for x in temperatures) else Fault.COIL_OVERTEMP
    return fault if all(abs(x) <= bound for x in currents) else fault | Fault.COIL_OVERCURRENT


class CoilGuard:
    """Detector of coil currents that do not follow the command.

    Args:
        limits: Limits of the device: a current may differ by `off_current` plus a tenth of the command. None for
            those of the published joystick.
    """

    _PATIENCE = 3

    def __init__(self, limits: Limits | None = None) -> None:
        self._tolerance, self._strikes = (limits or Limits()).off_current, 0

    def check(self, commanded: Sequence[float] | None, measured: Sequence[float]) -> Fault:
        """Compare the currents of a sample [A], six each.

        A sample without commanded currents ends a series of wrong ones: they are not consecutive.
        """
        for target, actual in () if measured == commanded else zip(commanded or (), measured):  # fast path: a twin
            if not abs(target - actual) <= self._tolerance + _TOLERANCE * abs(target):
                self._strikes += 1
                return Fault.COIL_NOT_FOLLOWING if self._strikes >= self._PATIENCE else _NO_FAULT
        self._strikes = 0
        return _NO_FAULT


class SpotGuard:
    """Detector of frozen sensors and implausible spots.

    Samples arrive every `period` [s].

    Attributes:
        last: Last valid spots [m], six; None without.
    """

    def __init__(self, limits: Limits, period: float) -> None:
        self._bound, self._frozen = limits.spot_limit, limits.frozen
        self._step = limits.spot_speed * period
        self.last: Sequence[float] | None = None
        self._conversions: int | None = None
        self._same: tuple[int, ...] = _CHANGED

    def check(self, spots: Sequence[float], valid: int, conversions: int, steps: int) -> Fault:
        """Check the sensor fields of a `StateReport`.

        `steps` is the increase of the sample number since the last check.
        """
        fault = Fault.SENSOR_STOPPED if conversions == self._conversions else _NO_FAULT
        self._conversions, bound = conversions, self._bound
        a, b, c, d, e, f = spots
        # unrolled: half the time of min and max; comparisons with NaN and infinity fail
        within = -bound <= a <= bound and -bound <= b <= bound and -bound <= c <= bound
        if valid & 7 != 7 or not (within and -bound <= d <= bound and -bound <= e <= bound and -bound <= f <= bound):
            self.last = None
            return fault | Fault.SENSOR_OUT_OF_RANGE
        last, self.last = self.last, spots
        if last is None:
            self._same = _CHANGED
            return fault
        p, q, r, s, t, u = last
        if a != p and c != r and e != t:
            self._same = _CHANGED
        else:
            still = (a == p and b == q, c == r and d == s, e == t and f == u)
            self._same = tuple([count + 1 if same else 0 for count, same in zip(self._same, still)])
        step = self._step * steps if steps > 1 else self._step
        near = -step <= a - p <= step and -step <= b - q <= step and -step <= c - r <= step
        if not (near and -step <= d - s <= step and -step <= e - t <= step and -step <= f - u <= step):
            # far above any flotor speed: the sensor jumped
            moved = max(abs(new - old) for new, old in zip(spots, last))
            return fault | (Fault.FLOTOR_OVERSPEED if moved < _IMPLAUSIBLE * step else Fault.SENSOR_OUT_OF_RANGE)
        return fault | Fault.SENSOR_FROZEN if self._frozen and max(self._same) >= self._frozen else fault


class FlotorGuard:
    """Detector of a flotor outside its envelope or too fast.

    Args:
        limits: Limits of the host.
        scale: Scale of the device: its envelope, if larger, holds in takeoff and landing; None if the limits do.
    """

    def __init__(self, limits: HostLimits, scale: Scale | None = None) -> None:
        far, turned = limits.envelope, limits.envelope_angle
        own = (far, turned) if scale is None else (scale.envelope, scale.tilt)
        self._own = far, turned**2
        self._guided = max(far, own[0]), max(turned, own[1]) ** 2
        self._fast, self._turning = limits.speed_limit**2, limits.spin_limit**2
        self._last: Sequence[float] | None = None

    def check(self, position: Sequence[float], elapsed: float, guided: bool = False) -> Fault:
        """Check a pose.

        Args:
            position: Measured pose [m, rad], six components.
            elapsed: Time since the previous pose [s].
            guided: True in takeoff and landing; the larger of the device's own and the chosen envelope then applies.
        """
        x, y, z, rx, ry, rz = position
        last, self._last = self._last, position
        fault, (far, turned) = _NO_FAULT, self._guided if guided else self._own
        inside = -far <= x <= far and -far <= y <= far and -far <= z <= far
        if not inside or rx * rx + ry * ry + rz * rz > turned:
            fault = Fault.BOUNDARY
        if last is None or elapsed <= 0.0:
            return fault
        a, b, c, d, e, f = x - last[0], y - last[1], z - last[2], rx - last[3], ry - last[4], rz - last[5]
        square, turning = a * a + b * b + c * c, d * d + e * e + f * f
        if square > self._fast * elapsed * elapsed or turning > self._turning * elapsed * elapsed:
            fault |= Fault.FLOTOR_OVERSPEED
        return fault


class OutputLimiter:
    """Converter of a command to coil currents within limits.

    Args:
        coils: The calibrated coils.
        limits: Limits of the device.
        wrench_limit: Wrench limit [N, N m], six; None for current limits only.
        period: Sample period [s].

    Attributes:
        thermal: Thermal model of the coils, updated by `add_command` and `add_periods`.
    """

    def __init__(self, coils: CoilMap, limits: Limits, wrench_limit: Sequence[float] | None, period: float) -> None:
        self._limit = wrench_limit
        self._inverse_turned, self._current, self._period = coils.inverse_at_angle, limits.current_limit, period
        self.thermal = ThermalModel(limits)
        self._timeline = Timeline(Timing(period=period, delay=0.0), ZERO)

    def add_command(self, held: Sequence[float], pulsed: Sequence[float] | None, width: float) -> None:
        """Update the thermal model by one period of sent currents."""
        self.thermal.add(self._timeline.period(0, (held, pulsed, width)))

    def add_periods(self, periods: int, currents: Sequence[float]) -> None:
        """Update the thermal model by periods of constant currents [A].

        An acting pulse ends first, by itself or by a change of the currents.
        """
        timeline = self._timeline
        self.thermal.add(timeline.period(0, None if currents == timeline.acting else (currents, None, 0.0)))
        while (periods := periods - 1) > 0 and timeline.now() is not timeline.acting:  # the pulse continues
            self.thermal.add(timeline.period(0))
        if periods > 0:
            self.thermal.add(((periods * self._period, currents),))

    def currents(
        self, command: Command, position: Sequence[float]
    ) -> tuple[Command, Sequence[float], Sequence[float] | None, float]:
        """Return the limited command, held currents [A], pulsed currents [A] or None, and pulse width [s].

        The coils turn with the flotor; `position` is its measured pose.

        Raises:
            PlantError: If the command is not six finite numbers.
        """
        force, extra, limit = command.force, command.extra, self._limit
        width = 0.0 if extra is None else command.pulse_width
        if len(force) != 6 or not math.isfinite(sum(force) + width + (0.0 if extra is None else sum(extra))):
            raise PlantError(f"a command must be six finite numbers (got {list(force)}, pulse {extra} of {width:g} s)")
        inverse_map = self._inverse_turned(*position[3:])
        if limit is not None:
            force = [clipped(x, bound) for x, bound in zip(force, limit)]
        applied, held = limited_wrench(inverse_map, force, self._current)
        if extra is None:
            return Command(applied), held, None, 0.0
        total: Sequence[float] = [x + dx for x, dx in zip(command.force, extra)]
        if limit is not None:
            total = [clipped(x, bound) for x, bound in zip(total, limit)]
        total, _ = limited_wrench(inverse_map, total, self._current)
        # pulse relative to the applied force: their sum gives the same currents
        extra = [x - y for x, y in zip(total, applied)]
        pulsed: list[float] = inverse_map.dot([x + dx for x, dx in zip(applied, extra)]).tolist()
        return Command(applied, extra, width), held, pulsed, width
