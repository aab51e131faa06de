"""Limits of device and host, and guards that check them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

from maglev_mj.bridge.wire import VERSION, Fault, HelloAck
from maglev_mj.control.timeline import Timeline, Timing
from maglev_mj.errors import ParameterError, PlantError
from maglev_mj.frames import ZERO, Command, clipped
from maglev_mj.parameters import Parameters, flag, number, param, read_json, store
from maglev_mj.plants.coils import CoilMap, limited_wrench
from maglev_mj.spec import Spec

WARNING_RISE = 0.8
"""Temperature rise of a warning, as share of the limit."""

OFF = 0.25
"""Largest measured current of a coil that is off [A]."""

_NO_FAULT = Fault(0)
_CHANGED = (0, 0, 0)
_CLOSE_SHARE = 0.1
_IMPLAUSIBLE = 4.0
_FRESH = 4
"""Periods after which an answer is stale, unless stated otherwise."""
_MARGIN = 1.25
"""Factor over the weight and its currents, for control."""
_COLD, _HOT, _OVER = -0.01, 2.0, 1.5
"""Bounds of reported temperatures and overcurrent ratio of measured currents."""


class Limits(Parameters):
    """Limits of a device, under their names in HELLO_ACK.

    The host refuses a device with limits outside these bounds.
    """

    current_limit: float = param("largest in a coil", "A", default=Spec.peak_current.value, above=0.0, at_most=20.0)
    continuous_current: float = param("borne", "A", default=Spec.continuous_current.value, above=0.0, at_most=20.0)
    thermal_time: float = param("of a coil's warming; assumed", "s", default=10.0, at_least=0.01, at_most=1e7)
    spot_limit: float = param("largest coordinate; assumed", "m", default=0.012, at_least=1e-4, at_most=0.1)
    spot_speed: float = param("largest; assumed", "m/s", default=1.0, at_least=1e-3, at_most=100.0)
    watchdog: float = param("longest wait for a command", "s", default=0.05, at_least=1e-3, at_most=1.0)
    enable: float = param("longest pause of the enable line", "s", default=0.01, at_least=1e-5, at_most=1.0)
    stale: float | None = param(
        "of an answered sample; None: 4 periods", "s", default=None, optional=True, at_least=1e-5
    )
    hover_limit: float = param("in ARM", "A", default=Spec.continuous_current.value, at_least=0.0, at_most=20.0)
    frozen: int = param("equal readings that noise rules out; 0: no noise", default=30, at_least=0, at_most=1_000_000)


_LIMITS = [one.name for one in Limits.parameters()]
_NANOSECONDS = "watchdog", "enable", "stale"
"""Limits that the wire has in nanoseconds."""

_AT_MOST = (
    ("two periods", "watchdog"),
    ("delay", "two periods"),
    ("enable", "watchdog"),
    ("one period", "stale"),
    ("stale", "watchdog"),
    ("hover_limit", "continuous_current"),
    ("continuous_current", "current_limit"),
)
"""Pairs of which the first must be at most the second, as HELLO_ACK has them."""


@dataclass(frozen=True, kw_only=True)
class Profile:
    """Properties of a device, as HELLO_ACK states them.

    See docs/reference/protocol.md. Without a limit `stale` it is four periods, and at most the watchdog.

    Raises:
        ParameterError: If a number is outside its bounds, or two contradict each other.
    """

    period: int  # [ns]
    delay: int  # [ns]
    calibration: bytes
    limits: Limits = field(default_factory=Limits)
    lockstep: bool = False
    number: int = 1

    def __post_init__(self) -> None:
        number("period", self.period * 1e-9, at_least=1e-5, at_most=0.1)
        number("delay", self.delay * 1e-9, at_least=0.0, at_most=0.1)
        flag("lockstep", self.lockstep)
        if self.limits.stale is None:
            store(self, limits=self.limits.replace(stale=min(_FRESH * self.period * 1e-9, self.limits.watchdog)))
        # as on the wire: what is equal there is equal here
        values = {**self.stated, "one period": self.period, "two periods": 2 * self.period, "delay": self.delay}
        for name, bound in _AT_MOST:
            if values[name] > values[bound]:
                scale, unit = (1e-9, "s") if isinstance(values[bound], int) else (1, "A")
                value, most = (f"{values[one] * scale:.9g} {unit}" for one in (name, bound))
                raise ParameterError(f"{name} must be at most {bound}, {most}, not {value}")

    @property
    def stated(self) -> dict[str, Any]:
        """Limits as HELLO_ACK states them, by name: times in whole nanoseconds."""
        limits = {name: getattr(self.limits, name) for name in _LIMITS}
        return limits | {name: round(limits[name] * 1e9) for name in _NANOSECONDS}

    @classmethod
    def of(cls, answer: HelloAck) -> Self:
        """Return the properties that a device states."""
        number("lockstep", answer.lockstep, at_least=0, at_most=1)
        own = {name: getattr(answer, name) for name in ("period", "delay", "calibration")}
        limits = {name: getattr(answer, name) * (1e-9 if name in _NANOSECONDS else 1) for name in _LIMITS}
        return cls(**own, limits=Limits(**limits), lockstep=bool(answer.lockstep), number=answer.device)

    def answer(self, **state: Any) -> HelloAck:
        """Return the HELLO_ACK with these properties and the given state."""
        own = {name: getattr(self, name) for name in ("period", "delay", "calibration", "lockstep")}
        return HelloAck(version=VERSION, device=self.number, **own, **self.stated, **state)


class HostLimits(Parameters):
    """Limits of the host.

    The smaller of these and the device's apply.

    Example:
        >>> from maglev_mj import HostLimits
        >>> HostLimits(max_current=5.0).speed_limit
        0.6
    """

    max_current: float | None = param("largest current in any coil", "A", default=None, optional=True, above=0.0)
    continuous_current: float | None = param("largest continuous current", "A", default=None, optional=True, above=0.0)
    force_limit: float | None = param("force along an axis, weight too", "N", default=None, optional=True, above=0.0)
    torque_limit: float | None = param("torque about an axis", "N m", default=None, optional=True, above=0.0)
    envelope: float = param("largest coordinate in flight; a little beyond the stops", "m", default=0.0055, above=0.0)
    envelope_angle: float = param("largest angle in flight", "rad", default=math.radians(7.5), above=0.0)
    speed_limit: float = param("largest speed of the flotor", "m/s", default=0.6, above=0.0)
    spin_limit: float = param("largest angular speed of the flotor", "rad/s", default=15.0, above=0.0)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a profile: a JSON object of limits, SI units.

        Raises:
            ParameterError: If it cannot be read, or a value is outside its bounds; one line with file and value.
        """
        return read_json("profile", path, lambda values: cls.from_json(_by_name(values)))

    @property
    def wrench(self) -> list[float] | None:
        """Largest wrench [N, N m], six; None without a limit."""
        if self.force_limit is None and self.torque_limit is None:
            return None
        return [self.force_limit or math.inf] * 3 + [self.torque_limit or math.inf] * 3

    def narrowed(self, limits: Limits) -> Limits:
        """Return the smaller of the device's and the host's limits."""
        current = min(limits.current_limit, self.max_current or math.inf)
        steady = min(limits.continuous_current, self.continuous_current or math.inf)
        hover = min(limits.hover_limit, current, steady)
        return limits.replace(current_limit=current, continuous_current=steady, hover_limit=hover)


def _by_name(values: Any) -> dict[str, Any]:
    if not isinstance(values, dict):
        raise ParameterError(f"must be a JSON object of limits by name, not {values!r:.60}")
    return values


def weight_fault(weight: float, hover: Sequence[float], own: HostLimits, limits: Limits) -> str:
    """Return the limit that hovering would exceed, as a message.

    `weight` is in [N], `hover` are six currents [A]; the message is empty if hovering is possible.
    """
    most = max(map(abs, hover))
    force, least, current = own.force_limit, _MARGIN * most, limits.current_limit
    if force is not None and force <= _MARGIN * weight:
        return f"force_limit must be above {_MARGIN * weight:.3g} N, not {force:g}: the weight is {weight:.3g} N"
    if current < least:
        needs = f"hovering needs {most:.3g} A, and control a quarter more"
        return f"max_current must be at least {least:.3g} A, not {current:g}: {needs}"
    if limits.hover_limit < most:
        return f"the hover limit must be at least {most:.3g} A, which carries the weight, not {limits.hover_limit:g}"
    return ""


class ThermalModel:
    """First-order thermal model of the six coils.

    Temperature rises are shares of that at the continuous current; at 1 the coils trip.

    Attributes:
        rises: Temperature rises of the six coils.
        warmest: Largest of the rises.
    """

    def __init__(self, limits: Limits) -> None:
        self.rises, self.warmest = [0.0] * 6, 0.0
        self._scale, self._time = limits.continuous_current**-2, limits.thermal_time
        self._duration, self._share = 0.0, 0.0

    def add(self, intervals: Iterable[tuple[float, Sequence[float]]]) -> float:
        """Add intervals of constant currents; return the warmest coil's rise.

        Each interval is a duration [s] and six currents [A].

        θ' = ((i / i_continuous)² - θ) / τ, solved exactly for constant currents.
        """
        p, q, r, s, t, u = self.rises
        scale = self._scale
        for duration, (a, b, c, d, e, f) in intervals:
            if duration != self._duration:
                self._duration, self._share = duration, -math.expm1(-duration / self._time)
            share = self._share  # written out: in half the time of a loop
            p, q, r = p + share * (scale * a * a - p), q + share * (scale * b * b - q), r + share * (scale * c * c - r)
            s, t, u = s + share * (scale * d * d - s), t + share * (scale * e * e - t), u + share * (scale * f * f - u)
        shares = [p, q, r, s, t, u]
        if not math.isfinite(sum(shares)):
            shares = [1.0] * 6  # a meter that says nonsense is no reason to go on
        self.rises, self.warmest = shares, max(shares)
        return self.warmest


def command_fault(limits: Limits, held: Sequence[float], pulsed: Sequence[float], width: float) -> Fault:
    """Return the fault of a command, if any.

    Currents [A], six each, and pulse width [s]. They are checked, not clipped.
    """
    # one by one: the sum of finite numbers may be infinite
    if not all(map(math.isfinite, (*held, *pulsed))) or not 0.0 <= width <= 1.0:
        return Fault.INVALID_COMMAND
    # rounding on the host's side is no fault
    most = limits.current_limit * (1.0 + 1e-9)
    if max(held) > most or min(held) < -most or max(pulsed) > most or min(pulsed) < -most:
        return Fault.COIL_OVERCURRENT
    return _NO_FAULT


def reading_fault(limits: Limits, currents: Sequence[float], temperatures: Sequence[float]) -> Fault:
    """Return the fault of measured currents and temperatures.

    Currents [A] and temperatures, six each.
    """
    most, (a, b, c, d, e, f) = _OVER * limits.current_limit, currents
    # the sums of squares first: both say at once that nothing is wrong, and that all is finite
    if a * a + b * b + c * c + d * d + e * e + f * f <= most * most and min(temperatures) >= _COLD:
        a, b, c, d, e, f = temperatures
        if a * a + b * b + c * c + d * d + e * e + f * f <= _HOT * _HOT:
            return _NO_FAULT
    fault = _NO_FAULT if all(_COLD <= one <= _HOT for one in temperatures) else Fault.COIL_OVERTEMP
    return fault if all(abs(one) <= most for one in currents) else fault | Fault.COIL_OVERCURRENT


class CoilGuard:
    """Detector of coils that do not follow their command."""

    _PATIENCE = 3

    def __init__(self) -> None:
        self._strikes = 0

    def check(self, commanded: Sequence[float], measured: Sequence[float]) -> Fault:
        """Compare the currents of a sample [A], six each."""
        if measured == commanded:  # as a twin's are
            self._strikes = 0
            return _NO_FAULT
        for wanted, found in zip(commanded, measured):
            if not abs(wanted - found) <= OFF + _CLOSE_SHARE * abs(wanted):
                self._strikes += 1
                return Fault.COIL_NOT_FOLLOWING if self._strikes >= self._PATIENCE else _NO_FAULT
        self._strikes = 0
        return _NO_FAULT


class SpotGuard:
    """Detector of frozen sensors and implausible spots.

    Samples arrive every `period` [s].
    """

    def __init__(self, limits: Limits, period: float) -> None:
        self._most, self._frozen = limits.spot_limit, limits.frozen
        self._step = limits.spot_speed * period
        self._last: Sequence[float] | None = None
        self._conversions: int | None = None
        self._same: tuple[int, ...] = _CHANGED

    def check(self, spots: Sequence[float], valid: int, conversions: int, steps: int) -> Fault:
        """Check the sensor fields of a `StateReport`.

        `steps` is the increase of the sample number since the last check.
        """
        fault = Fault.SENSOR_STOPPED if conversions == self._conversions else _NO_FAULT
        self._conversions, most = conversions, self._most
        a, b, c, d, e, f = spots
        # written out: in half the time of min and max; a comparison with NaN or infinity fails
        within = -most <= a <= most and -most <= b <= most and -most <= c <= most
        if valid & 7 != 7 or not (within and -most <= d <= most and -most <= e <= most and -most <= f <= most):
            self._last = None
            return fault | Fault.SENSOR_OUT_OF_RANGE
        last, self._last = self._last, spots
        if last is None:
            return fault
        p, q, r, s, t, u = last
        step = self._step * steps if steps > 1 else self._step
        near = -step <= a - p <= step and -step <= b - q <= step and -step <= c - r <= step
        if not (near and -step <= d - s <= step and -step <= e - t <= step and -step <= f - u <= step):
            # faster than any flotor: it is the sensor that jumped
            moved = max(abs(one - other) for one, other in zip(spots, last))
            return fault | (Fault.FLOTOR_OVERSPEED if moved < _IMPLAUSIBLE * step else Fault.SENSOR_OUT_OF_RANGE)
        if a != p and c != r and e != t:
            self._same = _CHANGED
            return fault
        still = (a == p and b == q, c == r and d == s, e == t and f == u)
        self._same = tuple([count + 1 if same else 0 for count, same in zip(self._same, still)])
        return fault | Fault.SENSOR_FROZEN if self._frozen and max(self._same) >= self._frozen else fault


class FlotorGuard:
    """Detector of a flotor outside its envelope or too fast."""

    def __init__(self, limits: HostLimits) -> None:
        most = HostLimits()
        self._own = limits.envelope, limits.envelope_angle**2
        self._led = max(limits.envelope, most.envelope), max(limits.envelope_angle, most.envelope_angle) ** 2
        self._fast, self._turning = limits.speed_limit**2, limits.spin_limit**2
        self._last: Sequence[float] | None = None

    def check(self, position: Sequence[float], elapsed: float, led: bool = False) -> Fault:
        """Check a pose.

        Args:
            position: Measured pose [m, rad], six components.
            elapsed: Time since the pose before [s].
            led: True in takeoff and landing: the default envelope applies if it is the larger.
        """
        x, y, z, rx, ry, rz = position
        last, self._last = self._last, position
        fault, (far, turned) = _NO_FAULT, self._led if led else self._own
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
    """Limiter that turns a command into coil currents.

    Args:
        coils: The calibrated coils.
        limits: Limits of the device.
        wrench_limit: Largest wrench [N, N m], six; None for no limit besides the currents.
        period: Sample period [s].

    Attributes:
        thermal: Thermal model of the coils, by the currents given to `passed` and `stay`.
    """

    def __init__(self, coils: CoilMap, limits: Limits, wrench_limit: Sequence[float] | None, period: float) -> None:
        self._limit = wrench_limit
        self._inverse_turned, self._current, self._period = coils.inverse_turned, limits.current_limit, period
        self.thermal = ThermalModel(limits)
        self._timeline = Timeline(Timing(period=period, delay=0.0), ZERO)

    def passed(self, held: Sequence[float], pulsed: Sequence[float] | None, width: float) -> None:
        """Update the thermal model by one period of sent currents."""
        self.thermal.add(self._timeline.period(0, (held, pulsed, width)))

    def stay(self, periods: int, currents: Sequence[float]) -> None:
        """Update the thermal model by periods of constant currents [A].

        A pulse still acting ends first: by itself, or by other currents than those after it.
        """
        line = self._timeline
        self.thermal.add(line.period(0, None if currents == line.acting else (currents, None, 0.0)))
        while (periods := periods - 1) > 0 and line.now() is not line.acting:  # a pulse goes on
            self.thermal.add(line.period(0))
        if periods > 0:
            self.thermal.add(((periods * self._period, currents),))

    def currents(
        self, command: Command, position: Sequence[float]
    ) -> tuple[Command, Sequence[float], Sequence[float] | None, float]:
        """Return a command within the limits, and its currents.

        After the command: held currents [A], pulsed currents [A] or None, pulse width [s].

        The coils turn with the flotor; `position` is its measured pose.

        Raises:
            PlantError: If the command is not six finite numbers.
        """
        force, extra, limit = command.force, command.extra, self._limit
        width = 0.0 if extra is None else command.pulse_width
        if len(force) != 6 or not math.isfinite(sum(force) + width + (0.0 if extra is None else sum(extra))):
            raise PlantError(f"a command must be six finite numbers, not {list(force)} and {extra} for {width:g} s")
        inverse_map = self._inverse_turned(*position[3:])
        if limit is not None:
            force = [clipped(one, most) for one, most in zip(force, limit)]
        left, held = limited_wrench(inverse_map, force, self._current)
        if extra is None:
            return Command(left), held, None, 0.0
        total: Sequence[float] = [one + other for one, other in zip(command.force, extra)]
        if limit is not None:
            total = [clipped(one, most) for one, most in zip(total, limit)]
        total, _ = limited_wrench(inverse_map, total, self._current)
        # the pulse relative to the applied force, so that their sum gives the same currents
        extra = [one - other for one, other in zip(total, left)]
        pulsed: list[float] = inverse_map.dot([one + other for one, other in zip(left, extra)]).tolist()
        return Command(left, extra, width), held, pulsed, width
