"""The device's side of the wire: sessions, states, faults. It knows neither sockets nor clocks nor mechanics."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

from maglev_mj.bridge.safety import WARNING_RISE, CoilGuard, Limits, SpotGuard, ThermalModel, command_fault
from maglev_mj.bridge.wire import (
    VERSION,
    Codec,
    Command,
    Control,
    ControlAck,
    Fault,
    Flag,
    Hello,
    HelloAck,
    HelloStatus,
    Operation,
    Result,
    State,
    StateReport,
    newer,
)
from maglev_mj.frames import ZERO
from maglev_mj.parameters import flag

__all__ = ["Amplifiers", "Firmware", "Profile", "Reading"]

_NEVER = 0xFFFFFFFF
_GAP = 2
_SILENCE = 1_000_000_000
_HELLO = 1


class Amplifiers(Protocol):
    """What the firmware drives."""

    def drive(self, now: int, held: Sequence[float], pulsed: Sequence[float] | None, width: float) -> None:
        """Switch the currents [A] as soon as they can be; `now` is the device's time [ns]."""

    def cut(self) -> None:
        """Switch all currents off at once, and forget what was still to come."""


@dataclass(frozen=True, kw_only=True)
class Profile:
    """What a device says of itself in the handshake.

    Args:
        period: Sample period [ns].
        delay: From a command's arrival to its taking effect [ns].
        calibration: First 16 bytes of its calibration's hash.
        limits: What it bears.
        lockstep: Whether simulated time waits for each answer.
        number: Of the device.
    """

    period: int
    delay: int
    calibration: bytes
    limits: Limits = field(default_factory=Limits)
    lockstep: bool = False
    number: int = 1

    def __post_init__(self) -> None:
        flag("lockstep", self.lockstep)


class Reading(NamedTuple):
    """What a device measures at a sample.

    Attributes:
        spots: On the diodes [m], six.
        valid: A bit for each diode whose spot can be trusted.
        measured: Currents [A], six.
        commanded: What the amplifiers were told [A], six.
        segments: Currents since the sample before: how long [s], and six [A].
    """

    spots: Sequence[float]
    valid: int
    measured: Sequence[float]
    commanded: Sequence[float]
    segments: Iterable[tuple[float, Sequence[float]]] = ()


class Firmware:
    """A device: one session at a time, a state, latched faults.

    Args:
        profile: What it is.
        amplifiers: What it drives.
        codec: Its frames.
        draw: Returns a new session's number, 1 to 2³² - 1; seeded in tests, else unpredictable.

    Attributes:
        state: See `State`.
        faults: See `Fault`.
        counts: Frames that were ignored, by reason, beside the codec's own.
        answered: Number of the last sample that was answered; None before any.
        peer: Address of the host in session; None for none.
    """

    def __init__(self, profile: Profile, amplifiers: Amplifiers, codec: Codec, draw: Callable[[], int]) -> None:
        self.profile, self._amplifiers, self._codec, self._draw = profile, amplifiers, codec, draw
        self.state, self.faults = State.INACTIVE, Fault(0)
        self.counts: Counter[str] = Counter()
        self.answered: int | None = None
        self.peer: Any = None
        self.session = 0
        self._nonce, self._heard, self._sequence = 0, 0, 0
        self._acknowledgement: ControlAck | None = None
        self._hover: Sequence[float] = ZERO
        self._commanded_at, self._answers, self._holding, self._sampled = 0, _NEVER, False, 0
        self._coils, self._diodes = CoilGuard(), SpotGuard(profile.limits, profile.period * 1e-9)
        self._thermal = ThermalModel(profile.limits)
        self._watchdog = round(profile.limits.watchdog * 1e9)
        # how many samples an answer may be behind
        self._stale = 0 if profile.lockstep else self._watchdog // profile.period

    def receive(self, data: bytes, now: int, peer: Any) -> bytes | None:
        """Take a frame from a peer at an instant [ns]; return what to send back to it, if anything."""
        codec = self._codec
        codec.version_met = None
        frame = codec.decode(data)
        if frame is None:
            if codec.version_met is not None and data[3] == _HELLO:
                return self._greet(now, 0, HelloStatus.VERSION)
            return None
        body = frame.body
        if isinstance(body, Hello):
            return self._hello(body, now, peer)
        if not isinstance(body, (Command, Control)):
            self.counts["direction"] += 1
            return None
        if self.session == 0 or frame.session != self.session or peer != self.peer:
            self.counts["session"] += 1
            return None
        if not newer(frame.sequence, self._sequence):
            self.counts["old"] += 1
            return None
        self._sequence, self._heard = frame.sequence, now
        if isinstance(body, Control):
            return self._control(body, now)
        self._obey(body, now)
        return None

    def sample(self, tick: int, now: int, reading: Reading) -> bytes | None:
        """Look at a sample of number `tick` at an instant [ns], act on what is wrong, and return the STATE frame.

        None where there is no session. Outside the active state what the sensors say is no fault: a device that nobody
        flies may be opened and turned over.
        """
        self._sampled = tick & 0xFFFFFFFF
        warmest = self._thermal.add(reading.segments)
        if self.state == State.ACTIVE:
            diodes = self._diodes.check(reading.spots, reading.valid)
            coils, waited = self._coils.check(reading.commanded, reading.measured), self._waited(now)
            if diodes or coils or waited:
                self.trip(diodes | coils | waited)
        if warmest >= 1.0:
            self.trip(Fault.COIL_OVERTEMP)
        if self.session == 0:
            return None
        age = min(max(now - self._commanded_at, 0) // 1000, _NEVER - 1) if self._answers != _NEVER else _NEVER
        report = StateReport(
            tuple(reading.spots),
            tuple(reading.measured),
            tuple(self._thermal.rises),
            self.state,
            reading.valid,
            Flag.HOLDING if self._holding else 0,
            self.faults,
            self._answers,
            age,
        )
        return self._codec.encode(self.session, tick, now, report)

    def trip(self, faults: Fault) -> None:
        """Cut the currents and latch faults."""
        self._amplifiers.cut()
        self._holding = False
        self.state, self.faults = State.FAULT, self.faults | faults

    def lose_host(self) -> None:
        """Latch the watchdog's fault if the device is active, and end the session: nobody is there."""
        if self.state == State.ACTIVE:
            self.trip(Fault.WATCHDOG)
        self.session, self.peer = 0, None

    def _waited(self, now: int) -> Fault:
        """Hold the flotor where commands are missing; return the watchdog's fault where they have for too long."""
        gap = now - self._commanded_at
        if gap > self._watchdog and not self.profile.lockstep:
            return Fault.WATCHDOG
        if gap > _GAP * self.profile.period and not self._holding and not self.profile.lockstep:
            self._holding = True
            self._amplifiers.drive(now, self._hover, None, 0.0)
        return Fault(0)

    def _hello(self, hello: Hello, now: int, peer: Any) -> bytes:
        if self.session and hello.nonce == self._nonce and peer == self.peer:
            self._heard = now
            return self._greet(now, hello.nonce, HelloStatus.WELCOME)  # the answer before was lost
        if self.session and (self.state == State.ACTIVE or now - self._heard < _SILENCE):
            self.counts["busy"] += 1
            return self._greet(now, hello.nonce, HelloStatus.BUSY)
        if hello.calibration != self.profile.calibration:
            return self._greet(now, hello.nonce, HelloStatus.CALIBRATION)
        self.session, self._nonce, self.peer, self._heard = self._draw(), hello.nonce, peer, now
        self._sequence, self._acknowledgement = 0, None
        self._answers, self.answered = _NEVER, None
        return self._greet(now, hello.nonce, HelloStatus.WELCOME)

    def _greet(self, now: int, nonce: int, status: HelloStatus) -> bytes:
        profile, limits = self.profile, self.profile.limits
        body = HelloAck(
            nonce,
            status,
            int(profile.lockstep),
            VERSION,
            self.state,
            profile.number,
            profile.calibration,
            profile.period,
            profile.delay,
            self._watchdog,
            limits.current,
            limits.continuous_current,
            limits.thermal_time,
            limits.spot,
            limits.spot_speed,
        )
        session = self.session if status == HelloStatus.WELCOME else 0
        return self._codec.encode(session, 0, now, body)

    def _obey(self, command: Command, now: int) -> None:
        if (self._sampled - command.answers) & 0xFFFFFFFF > self._stale:
            self.counts["old"] += 1  # it lay in a queue, answers what is yet to come, or seemed lost and was sent again
            return
        self.answered = command.answers
        if self.state != State.ACTIVE:
            self.counts["inactive"] += 1
            return
        if wrong := command_fault(self.profile.limits, command.held, command.pulsed, command.width):
            self.trip(wrong)
            return
        self._commanded_at, self._answers, self._holding = now, command.answers, False
        self._amplifiers.drive(now, command.held, command.pulsed if command.width else None, command.width)

    def _control(self, control: Control, now: int) -> bytes | None:
        last = self._acknowledgement
        if last is None or control.request != last.request:
            if last is not None and not newer(control.request, last.request):
                self.counts["old"] += 1
                return None
            done = self._do(control, now)
            last = ControlAck(control.request, control.operation, 0 if done else Result.REFUSED, 0, 0)
            self._acknowledgement = last
        body = last._replace(state=self.state, faults=self.faults)
        answer = self._codec.encode(self.session, 0, now, body)
        if last.operation == Operation.BYE:
            self.session, self.peer = 0, None
        return answer

    def _do(self, control: Control, now: int) -> bool:
        """Do what a host asks for; return whether it was done."""
        operation = control.operation
        if operation == Operation.ESTOP:
            self.trip(Fault.ESTOP)
        elif operation == Operation.TRIP:
            self.trip(Fault(control.faults & sum(Fault)) or Fault.HOST)
        elif operation == Operation.RESET:
            return self._reset()
        elif operation == Operation.ARM:
            return self._arm(control.hover, now)
        elif operation in (Operation.DISARM, Operation.BYE):
            if self.state == State.ACTIVE:
                self._amplifiers.cut()
                self.state, self._holding = State.INACTIVE, False
        else:
            return False
        return True

    def _arm(self, hover: Sequence[float], now: int) -> bool:
        if self.state != State.INACTIVE or command_fault(self.profile.limits, hover, hover, 0.0):
            return False
        self._hover, self._commanded_at, self._answers, self._holding = hover, now, _NEVER, False
        self._coils, self._diodes = CoilGuard(), SpotGuard(self.profile.limits, self.profile.period * 1e-9)
        self.state = State.ACTIVE
        return True

    def _reset(self) -> bool:
        if self.state == State.ACTIVE or max(self._thermal.rises) >= WARNING_RISE:
            return False
        self.state, self.faults = State.INACTIVE, Fault(0)
        return True
