"""Limits of a device and a flight, and the guards that watch them at both ends."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.bridge.wire import Fault
from maglev_mj.coils import CoilMap, limited_wrench
from maglev_mj.errors import ParameterError, PlantError
from maglev_mj.frames import ZERO, Command, clipped
from maglev_mj.parameters import number, numbers
from maglev_mj.spec import Spec
from maglev_mj.timeline import Timeline, Timing

__all__ = [
    "OFF",
    "WARNING_RISE",
    "CoilGuard",
    "Envelope",
    "FlotorGuard",
    "Limits",
    "OutputLimiter",
    "SpotGuard",
    "ThermalModel",
    "command_fault",
]

WARNING_RISE = 0.8
"""Share of what a coil bears from which there is a warning."""

OFF = 0.25
"""Measured current up to which a coil counts as off [A]."""

_NO_FAULT = Fault(0)
_CLOSE_SHARE = 0.1
_IMPLAUSIBLE = 4.0


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What a device bears; sent to the host in the handshake.

    Args:
        current: Largest current in any coil [A].
        continuous_current: Current that a coil bears for ever [A].
        thermal_time: Time constant of a coil's warming [s]; assumed, the paper has none.
        spot: Largest coordinate of a spot on its diode [m]; assumed.
        spot_speed: Largest speed of a spot [m/s]; assumed.
        watchdog: How long a device waits for a command before it lets go [s].
        enable: How long the amplifiers' enable line may stand still [s].
        hover: Largest current of a coil where the device holds the flotor by itself [A].
        frozen: Equal readings in a row that the sensor's noise rules out; 0 for a sensor without noise.

    Raises:
        ParameterError: If a value is not above 0, or `frozen` is negative or not whole.
    """

    current: float = Spec.peak_current.value
    continuous_current: float = Spec.continuous_current.value
    thermal_time: float = 10.0
    spot: float = 0.012
    spot_speed: float = 1.0
    watchdog: float = 0.05
    enable: float = 0.015
    hover: float = Spec.continuous_current.value
    frozen: int = 20

    def __post_init__(self) -> None:
        for name in (one.name for one in fields(self) if one.name != "frozen"):
            object.__setattr__(self, name, number(name, getattr(self, name), above=0.0))
        if number("frozen", self.frozen, at_least=0) != int(self.frozen):
            raise ParameterError(f"frozen must be a whole number, not {self.frozen!r}")


@dataclass(frozen=True, kw_only=True)
class Envelope:
    """Where and how fast the host lets the flotor go.

    Args:
        translation: Largest coordinate [m]; a little beyond the metal stops.
        rotation: Largest angle [rad].
        speed: Largest speed [m/s].
        turning_speed: Largest angular speed [rad/s].

    Raises:
        ParameterError: If a value is not above 0.
    """

    translation: float = 0.0055
    rotation: float = math.radians(7.5)
    speed: float = 0.6
    turning_speed: float = 15.0

    def __post_init__(self) -> None:
        for name in ("translation", "rotation", "speed", "turning_speed"):
            object.__setattr__(self, name, number(name, getattr(self, name), above=0.0))


class ThermalModel:
    """How warm six coils are: 1 where the current that they bear for ever would bring them, and where they trip.

    Args:
        limits: Their thermal time and continuous current.

    Attributes:
        shares: Of the six coils.
    """

    def __init__(self, limits: Limits) -> None:
        self.rises = [0.0] * 6
        self._scale, self._time = limits.continuous_current**-2, limits.thermal_time
        self._duration, self._share = 0.0, 0.0

    def add(self, segments: Iterable[tuple[float, Sequence[float]]]) -> float:
        """Let currents [A] flow for so long [s] each, in turn; return the share of the warmest coil.

        θ' = ((i / i_continuous)² - θ) / τ, solved exactly for constant currents.
        """
        shares = self.rises
        for duration, currents in segments:
            if duration != self._duration:
                self._duration, self._share = duration, -math.expm1(-duration / self._time)
            share, scale = self._share, self._scale
            shares = [now + share * (scale * one * one - now) for now, one in zip(shares, currents)]
        if not math.isfinite(sum(shares)):
            shares = [1.0] * 6  # a meter that says nonsense is no reason to go on
        self.rises = shares
        return max(shares)


def command_fault(limits: Limits, held: Sequence[float], pulsed: Sequence[float], width: float) -> Fault:
    """Return what is wrong with a command: nothing is ever clipped silently.

    Args:
        limits: Of the device.
        held: Currents [A], six.
        pulsed: In place of them for `width` [A], six.
        width: How long [s].
    """
    if not math.isfinite(sum(held) + sum(pulsed) + width) or not 0.0 <= width <= 1.0:
        return Fault.INVALID_COMMAND
    # rounding on the host's side is no fault
    most = limits.current * (1.0 + 1e-9)
    if max(held) > most or min(held) < -most or max(pulsed) > most or min(pulsed) < -most:
        return Fault.COIL_OVERCURRENT
    return _NO_FAULT


class CoilGuard:
    """Finds a coil whose current is not the one commanded."""

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
    """Finds a sensor that does not live, and spots that cannot be true.

    Args:
        limits: Of the device.
        period: Sample period [s].
    """

    def __init__(self, limits: Limits, period: float) -> None:
        self._most, self._frozen = limits.spot, limits.frozen
        self._step = limits.spot_speed * period
        self._last: Sequence[float] | None = None
        self._conversions: int | None = None
        self._same = [0, 0, 0]

    def check(self, spots: Sequence[float], valid: int, conversions: int, steps: int) -> Fault:
        """Check a sample.

        Args:
            spots: Both coordinates of each of the three spots [m], six.
            valid: A bit for each diode whose spot can be trusted.
            conversions: Counter of the sensor interface.
            steps: Samples since the one checked before, by their numbers.
        """
        most = self._most
        stopped, self._conversions = conversions == self._conversions, conversions
        fault = Fault.SENSOR_STOPPED if stopped else _NO_FAULT
        if valid & 7 != 7 or not (math.isfinite(sum(spots)) and max(spots) <= most and min(spots) >= -most):
            self._last = None
            return fault | Fault.SENSOR_OUT_OF_RANGE
        last, self._last = self._last, spots
        if last is None:
            return fault
        moved, step = max([abs(one - other) for one, other in zip(spots, last)]), self._step * max(steps, 1)
        if moved > step:
            # faster than any flotor: it is the sensor that jumped
            return fault | (Fault.FLOTOR_OVERSPEED if moved < _IMPLAUSIBLE * step else Fault.SENSOR_OUT_OF_RANGE)
        same = self._same
        for diode in (0, 1, 2):
            first = 2 * diode
            frozen = spots[first] == last[first] and spots[first + 1] == last[first + 1]
            same[diode] = same[diode] + 1 if frozen else 0
        return fault | Fault.SENSOR_FROZEN if self._frozen and max(same) >= self._frozen else fault


class FlotorGuard:
    """Finds a flotor that is beyond its envelope.

    Args:
        envelope: Where it may be.
    """

    def __init__(self, envelope: Envelope) -> None:
        self._far, self._turned = envelope.translation, envelope.rotation**2
        self._fast, self._turning = envelope.speed**2, envelope.turning_speed**2
        self._last: Sequence[float] | None = None

    def check(self, position: Sequence[float], elapsed: float) -> Fault:
        """Look at a pose [m, rad], six components, so long after the one before [s]."""
        x, y, z, rx, ry, rz = position
        last, self._last = self._last, position
        fault, far = _NO_FAULT, self._far
        inside = -far <= x <= far and -far <= y <= far and -far <= z <= far
        if not inside or rx * rx + ry * ry + rz * rz > self._turned:
            fault = Fault.BOUNDARY
        if last is None or elapsed <= 0.0:
            return fault
        a, b, c, d, e, f = x - last[0], y - last[1], z - last[2], rx - last[3], ry - last[4], rz - last[5]
        square, turning = a * a + b * b + c * c, d * d + e * e + f * f
        if square > self._fast * elapsed * elapsed or turning > self._turning * elapsed * elapsed:
            fault |= Fault.FLOTOR_OVERSPEED
        return fault


class OutputLimiter:
    """Turns a command into currents, after every limit.

    Args:
        coils: What is known of the coils.
        limits: What the device bears.
        wrench_limit: Largest wrench, a number or (6,) [N, N m]; None for what the currents allow.
        period: Sample period [s].

    Attributes:
        thermal: Of the coils, by what was let through and told to `passed`.

    Raises:
        ParameterError: If a limit is negative or of another shape.
    """

    def __init__(self, coils: CoilMap, limits: Limits, wrench_limit: ArrayLike | None, period: float) -> None:
        self._limit: list[float] | None = None
        if wrench_limit is not None:
            values = numbers("wrench_limit", wrench_limit, at_least=0.0, finite=False)
            self._limit = [float(part) for part in np.broadcast_to(values, (6,))]
        self._inverse_turned, self._current, self._period = coils.inverse_turned, limits.current, period
        self.thermal = ThermalModel(limits)
        self._timeline = Timeline(Timing(period=period, delay=0.0), ZERO)

    def passed(self, held: Sequence[float], pulsed: Sequence[float] | None, width: float) -> None:
        """Let what `currents` returned flow for a period: it has been sent."""
        self.thermal.add(self._timeline.period(0, (held, pulsed, width)))

    def stay(self, periods: int, currents: Sequence[float]) -> None:
        """Let currents [A] flow for so many periods in which none were let through; a pulse runs out before them."""
        switch = None if currents == self._timeline.acting else (currents, None, 0.0)
        self.thermal.add(self._timeline.period(0, switch))
        if periods > 1:
            self.thermal.add((((periods - 1) * self._period, currents),))

    def currents(
        self, command: Command, position: Sequence[float]
    ) -> tuple[Command, Sequence[float], Sequence[float] | None, float]:
        """Return what is left of a command, its currents [A], those of its pulse if it has one, and its width [s].

        Args:
            command: What the controller answered.
            position: The pose that was measured: the coils turn with the flotor.

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
        # the pulse as it will be known, so that whoever adds it to the force comes to the same currents
        extra = [one - other for one, other in zip(total, left)]
        pulsed: list[float] = inverse_map.dot([one + other for one, other in zip(left, extra)]).tolist()
        return Command(left, extra, width), held, pulsed, width
