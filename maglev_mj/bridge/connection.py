"""Session between a host and a device: handshake, requests, samples."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, suppress
from typing import NamedTuple, TypeVar

import maglev_mj
from maglev_mj.bridge import wire
from maglev_mj.bridge.fault import HandshakeError
from maglev_mj.bridge.links import Link, open_link
from maglev_mj.bridge.safety import Profile, are_off, at_most
from maglev_mj.bridge.wire import WRAP, Codec, Frame, HelloStatus, Operation, State, StateReport, fault_names
from maglev_mj.errors import MaglevError, ParameterError, PlantError
from maglev_mj.frames import ZERO
from maglev_mj.keywords import checked
from maglev_mj.parameters import number

RETRY_INTERVAL = 0.02
"""Repeat interval of an unanswered request [s]."""

_HELLO_INTERVAL, _ESTOP_INTERVAL = 0.1, 0.005
TAKEOVER = 1.0
"""Silence after which an idle device drops its host [s]."""

_MISMATCH = 0.5
"""Largest error of a timestamp against the number of its sample, in periods."""

T = TypeVar("T")


class EstopReport(NamedTuple):
    """Outcome of an emergency stop.

    Attributes:
        confirmed: True if the device is in the fault state and has measured its currents off since, or is in lockstep.
        duration: Time from the first request to the end [s].
        faults: Faults latched in the device; 0 without an answer.
        currents: Currents measured since the first answer [A], six; empty without.
        at: Device time of its first answer [ns]; 0 without an answer.
        off: Largest current that counts as off on the device, if a sample since its first answer shows no larger one
            [A]; None otherwise.
    """

    confirmed: bool
    duration: float
    faults: int
    currents: tuple[float, ...]
    at: int
    off: float | None

    def __str__(self) -> str:
        names = fault_names(self.faults)
        if self.confirmed:
            after = f"{self.duration * 1e3:.1f} ms after the first request"
            if self.off is None:
                return f"stopped: {names} {after}; in lockstep no sample follows, so the currents are not measured"
            return f"stopped: {names}, {at_most(self.off)} {after}"
        reason = f"no answer within {self.duration:.3g} s"
        if self.currents:
            coil = max(range(6), key=lambda index: abs(self.currents[index]))
            reason = f"faults {names}, {self.currents[coil]:.3g} A in coil {coil}"
        elif self.at or self.faults:
            reason = f"faults {names}, no sample in {self.duration:.3g} s"
        return f"not confirmed: cut the power ({reason})"


@checked(own="link")
def estop(link: Link | str, key: bytes | None = None, patience: float = 1.0) -> EstopReport:
    """Send an emergency stop to a device, without a session.

    Works during another host's session.

    Args:
        link: Link to the device (not closed), or its address.
        key: Authentication key of the frames; None for none.
        patience: Timeout [s], above 0.

    Raises:
        LinkError: If the link has failed.
        ParameterError: If the key or the patience is outside its bounds.

    Example:
        >>> from maglev_mj import Twin, TwinParameters, estop
        >>> from maglev_mj.bridge.twin.simulated_links import VirtualLink
        >>> report = estop(VirtualLink(Twin(TwinParameters())))
        >>> report.confirmed
        True
    """
    if isinstance(link, str):
        with closing(open_link(link, key)) as opened:
            return estop(opened, key, patience)
    return _stop(open_link(link), Codec(key), number("patience", patience, above=0.0), lambda frame: None)


def _stop(link: Link, codec: Codec, patience: float, others: Callable[[Frame | None], object]) -> EstopReport:
    """Send ESTOP until the device confirms it; pass other frames to `others`."""
    body = wire.Estop(draw())
    start, first = link.now(), None
    answer: wire.EstopAck | None = None
    currents: tuple[float, ...] = ()
    off, confirmed = False, False
    for data in _requested(link, codec, 0, body, _ESTOP_INTERVAL, patience):
        frame = codec.decode(data)
        if frame is None or not isinstance(frame.body, wire.EstopAck) or frame.body.request != body.request:
            others(frame)
            continue
        answer, first = frame.body, frame.time if first is None else first
        currents = answer.currents if answer.sampled > first else ()
        off = bool(currents) and are_off(currents, answer.off_current)
        # in lockstep no sample may follow: simulated time stands still until the host answers
        confirmed = answer.state == State.FAULT and (off or answer.lockstep == 1)
        if confirmed:
            break
    duration = (link.now() - start) * 1e-9
    if answer is None:
        return EstopReport(False, duration, 0, (), 0, None)
    limit = answer.off_current if off else None
    return EstopReport(confirmed, duration, answer.faults, currents, first or 0, limit)


def exchange(
    link: Link, encode: Callable[[], bytes], receive: Callable[[float], T | None], every: float, patience: float
) -> Iterator[T]:
    """Send a request repeatedly; yield all data received meanwhile.

    Args:
        link: Link to the device.
        encode: Function that returns the request's frame.
        receive: Function that receives for a time [s], such as `link.receive`.
        every: Repeat interval [s].
        patience: Duration of the exchange [s].
    """
    end = link.now() + int(patience * 1e9)
    while (now := link.now()) < end:
        link.send(encode())
        repeat = now + int(every * 1e9)
        while (remaining := repeat - link.now()) > 0 and (data := receive(remaining * 1e-9)) is not None:
            yield data


def _requested(
    link: Link, codec: Codec, session: int, body: wire.Body, every: float, patience: float
) -> Iterator[bytes]:
    return exchange(link, lambda: codec.encode(session, 0, link.now(), body), link.receive, every, patience)


def draw() -> int:
    """Return a random 64-bit number."""
    return int.from_bytes(os.urandom(8), "little")


class SampleCounter:
    """Counter of received, lost and skipped samples.

    Args:
        period: Sample period [ns].

    Attributes:
        period: Sample period [ns].
        tick: Index of the last sample; the first received is 0.
        time: Device clock at the last sample [ns].
        elapsed: Sample periods between the last two samples.
        out_of_step: Clock error of the last sample as a message; empty if timestamps match.
        lost: Samples that did not arrive.
        skipped: Samples not answered because a newer one had arrived.
    """

    def __init__(self, period: int) -> None:
        self.period, self.out_of_step, self.tick = period, "", -1
        self._mismatch = int(_MISMATCH * period)
        self.elapsed = self.lost = self.skipped = self.time = self._sequence = 0

    def count(self, sequence: int, time: int, skipped: int) -> None:
        """Count a sample by its number and time [ns].

        `skipped` is the number of older samples that arrived with it.
        """
        self.out_of_step = ""
        if self.tick < 0:
            self.tick = 0
        else:
            self.elapsed, passed = (sequence - self._sequence) & WRAP, time - self.time
            if abs(passed - self.elapsed * self.period) > self._mismatch:
                span = f"{self.elapsed} samples of {self.period * 1e-6:.3f} ms"
                self.out_of_step = f"{passed * 1e-6:.3f} ms elapsed over {span}"
            self.tick += self.elapsed
            if missing := self.elapsed - 1:
                self.skipped += min(skipped, missing)
                self.lost += missing - min(skipped, missing)
        self._sequence, self.time = sequence, time


class AnswerTiming(NamedTuple):
    """Delays of answers, as reported with a sample.

    Attributes:
        answered_tick: Tick of the sample answered by the device's newest command.
        last_delay: Delay of the previous sample's answer, by the device's clock [s]; NaN if the command in force
            answers another sample.
        newest_delay: Delay of the newest answer that has arrived [s]; NaN without a new one.
        delay_bound: `newest_delay`, or without a new answer the lower bound of the next answer's delay [s].
        transport: Arrival time by the host's clock minus sample time by the device's [ns]; includes the offset of the
            two clocks.
    """

    answered_tick: int
    last_delay: float
    newest_delay: float
    delay_bound: float
    transport: int


class Connection:
    """Session between a host and one device.

    Args:
        link: Link to the device; closed with the connection or if the handshake fails.
        calibration: First 16 bytes of the hash of the host's calibration.
        key: Authentication key of the frames; None for none.
        patience: Longest wait for an answer [s].

    Attributes:
        welcome: Device's answer to the handshake.
        profile: Device properties, checked against sane bounds.
        codec: Frame encoder and decoder; counts dropped frames by reason.
        open: True until closed.
        samples: Counter of received, lost and skipped samples.
        sequence: The device's number of the last sample.
        answers: Delays of answers, as reported with the last sample.
        patience: Longest wait for an answer or a sample [s].
        arrival: Arrival time of the last sample, by the link's clock [ns].
        latency: Time from that arrival to sending the last command [ns].
        settled: Device time of its last answer to a request [ns]; older samples report an outdated state.

    Raises:
        HandshakeError: If no device answers, it refuses this host, or its limits are outside sane bounds.
        LinkError: If the link has failed.
        ParameterError: If the key or the patience is outside its bounds.
    """

    def __init__(self, link: Link, calibration: bytes, key: bytes | None, patience: float) -> None:
        self._link, self._keyed, self.open, self._process = link, key is not None, True, os.getpid()
        self._session = self._sequence = self._request = self._skipped = self._handshake_time = 0
        self.settled = self.arrival = self.latency = self.sequence = 0
        self._answered: int | None = None  # by the newest answer
        self._newest: int | None = None
        self._waiting: Frame | None = None
        self._last: wire.CommandFrame | None = None
        try:
            self.patience = number("patience", patience, above=0.0)
            self.codec = Codec(key)
            self.welcome = self._join(calibration)
            self.profile = profile_of(self.welcome, self._handshake_time)
            self.samples = SampleCounter(self.profile.period)
            self._delay = (self.profile.delay + self.profile.latency) / 1e9
            self.answers = AnswerTiming(0, math.nan, math.nan, self._delay, 0)
        except BaseException as error:
            self.close()
            if isinstance(error, (ValueError, ArithmeticError)) and not isinstance(error, MaglevError):
                raise HandshakeError(f"invalid answer from the device: {error}") from error
            raise

    @property
    def latched(self) -> str:
        """Faults latched at the handshake as one line; "" without faults."""
        welcome = self.welcome
        age = max(self._handshake_time - welcome.fault_time, 0) * 1e-9
        names, first = fault_names(welcome.faults), fault_names(welcome.first)
        return f"latched: {names}, {age:.1f} s ago, first {first}" if welcome.faults else ""

    def command(self, command: wire.CommandFrame) -> None:
        """Send currents."""
        self._last = command
        self._sequence = (self._sequence + 1) & WRAP
        now = self._link.now()
        self._link.send(self.codec.encode(self._session, self._sequence, now, command))
        self.latency = now - self.arrival

    def state(self) -> Frame:
        """Return the newest sample.

        Raises:
            PlantError: If there is none within `patience`.
        """
        link, remaining = self._link, self.patience
        self.arrival = link.now()
        end = self.arrival + int(remaining * 1e9)
        while self._waiting is None:
            data = link.receive(remaining) if remaining > 0.0 else None  # other frames may arrive indefinitely
            if data is None:
                raise PlantError(f"no sample from the device within {self.patience:g} s")
            self._keep(self._trusted(data))
            self.arrival = now = link.now()
            remaining = (end - now) * 1e-9
        # in lockstep no newer sample can exist: the device waits for the answer to this one
        while not self.profile.lockstep and (data := link.receive(0.0)) is not None:
            if self._keep(self._trusted(data)):
                self.arrival = link.now()
        frame, self._waiting = self._waiting, None
        skipped, self._skipped = self._skipped, 0
        self.samples.count(frame.sequence, frame.time, skipped)
        self._time(frame)
        return frame

    def _time(self, frame: Frame) -> None:
        """Update the delays of answers from a sample."""
        report: StateReport = frame.body  # type: ignore[assignment]
        period, delay, samples = self.profile.period / 1e9, self._delay, self.samples
        self.sequence, behind = frame.sequence, (frame.sequence - report.answered) & WRAP
        fresh = report.age != wire.NEVER and report.answered != self._answered
        self._answered = report.answered
        newest = behind * period - report.age * 1e-6 + delay if fresh else math.nan
        last = newest if samples.elapsed == behind == 1 else math.nan
        # lower bound for the next answer
        delay_bound = newest if fresh else (behind - 1) * period + delay
        self.answers = AnswerTiming(samples.tick - behind, last, newest, delay_bound, self.arrival - frame.time)

    def control(
        self, operation: Operation, *, faults: int = 0, hover: Sequence[float] = ZERO, stop: Sequence[float] = wire.CUT
    ) -> wire.ControlAck | None:
        """Request a change of state; return the answer, or None after `patience`.

        The request is repeated until it is answered.
        """
        if not self.open:
            return None
        self._request += 1
        body = wire.ControlRequest(self._request, operation, faults, tuple(hover), tuple(stop))
        for data in _requested(self._link, self.codec, self._session, body, RETRY_INTERVAL, self.patience):
            frame = self._trusted(data)
            if frame is not None and isinstance(frame.body, wire.ControlAck) and frame.body.request == self._request:
                self.settled = frame.time
                return frame.body
            self._keep(frame)
        return None

    def estop(self) -> EstopReport:
        """Send ESTOP until the device confirms it.

        Samples that arrive meanwhile are queued for `state`.
        """
        report = _stop(self._link, self.codec, self.patience, self._keep)
        self.settled = max(self.settled, report.at)
        return report

    @property
    def session(self) -> int:
        """Number of the session, drawn by the device."""
        return self._session

    def close(self) -> None:
        """End the session and close the link; idempotent. In a forked process the session is its parent's."""
        if self.open:
            try:
                with suppress(Exception):  # best effort: the link may be down
                    if self._session and self._process == os.getpid():
                        self.control(Operation.BYE)
            finally:
                self.open = False
                with suppress(Exception):
                    self._link.close()

    def _join(self, calibration: bytes) -> wire.HelloAck:
        """Send HELLO until the device answers."""
        hello, versions = wire.Hello(draw(), calibration), set[int]()
        for patience in (self.patience, TAKEOVER):
            busy = False
            for data in _requested(self._link, self.codec, 0, hello, _HELLO_INTERVAL, patience):
                if (answer := self._welcome(data, hello, versions)) is not None:
                    if answer.status == HelloStatus.WELCOME:
                        return answer
                    busy = True
            if not busy:
                break
        if busy:
            raise HandshakeError("the device is in use by another host")
        counts, seen = self.codec.dropped, f" ({', '.join(map(str, sorted(versions)))})"
        dropped = ", ".join(f"{count} for {reason}{seen * (reason == 'version')}" for reason, count in counts.items())
        reason = f"; frames dropped: {dropped}" if dropped else ""
        if counts["tag"]:
            reason += "; check that both ends use the same key"
        raise HandshakeError(f"no device answered within {self.patience:g} s{reason}")

    def _welcome(self, data: bytes, hello: wire.Hello, versions: set[int]) -> wire.HelloAck | None:
        """Return the answer to a HELLO and store its session; None for other data.

        HandshakeError if the device refuses.
        """
        self.codec.version_met = None
        frame = self.codec.decode(data)
        if (version := self.codec.version_met) is not None:
            versions.add(version)
            if not self._keyed:  # else the tag of another version cannot be checked: the sender is unknown
                raise _other_version(version)
        if frame is None or not isinstance(answer := frame.body, wire.HelloAck):
            return None
        if answer.status == HelloStatus.VERSION:
            raise _other_version(answer.version)
        if answer.nonce != hello.nonce:
            return None
        if answer.status == HelloStatus.CALIBRATION:
            both = f"device {answer.calibration.hex()}, host {hello.calibration.hex()}"
            older = f"if they have it, update the older end (host: maglev_mj {maglev_mj.__version__})"
            raise HandshakeError(f"calibration mismatch: {both}; start both with the same device file; {older}")
        if answer.status == HelloStatus.WELCOME:
            self._session, self._handshake_time = frame.session, frame.time
        return answer if answer.status in (HelloStatus.WELCOME, HelloStatus.BUSY) else None

    def _trusted(self, data: bytes) -> Frame | None:
        """Return the frame if it is authentic and of this session, else None."""
        frame = self.codec.decode(data)
        if frame is not None and frame.session != self._session:
            self.codec.dropped["session"] += 1
            return None
        return frame

    def _is_newer(self, frame: Frame) -> bool:
        newest = self._newest
        if newest is not None and frame.sequence != (newest + 1) & WRAP:  # rare
            if newest == frame.sequence and self.profile.lockstep and self._last is not None:
                self.command(self._last)  # the device waits, so the answer was lost
            if not wire.newer(frame.sequence, newest):
                self.codec.dropped["old"] += 1
                return False
        self._newest = frame.sequence
        return True

    def _keep(self, frame: Frame | None) -> bool:
        """Queue the frame for `state` if it is a newer sample of this session; return True then."""
        if frame is None or frame.session != self._session or not isinstance(frame.body, StateReport):
            return False
        if not self._is_newer(frame):
            return False
        self._skipped += self._waiting is not None
        self._waiting = frame
        return True


def _other_version(version: int) -> HandshakeError:
    return HandshakeError(f"protocol version mismatch: device {version}, host {wire.VERSION}")


def profile_of(welcome: wire.HelloAck, time: int) -> Profile:
    """Return a device's properties, as of its time [ns].

    HandshakeError if one is invalid, or state and faults contradict each other.
    """
    faults, failed = f"faults {fault_names(welcome.faults)}", welcome.state == State.FAULT
    try:
        number("state", welcome.state, at_least=0, at_most=max(State))
        for contradiction, present in (
            (f"state {State(welcome.state).name} with {faults}", failed != bool(welcome.faults)),
            (f"first {fault_names(welcome.first)} of {faults}", welcome.first & ~welcome.faults),
            (f"fault_time {welcome.fault_time} ns at {time} ns", welcome.fault_time > time),
        ):
            if present:
                raise ParameterError(contradiction)
        return Profile.of(welcome)
    except ParameterError as error:
        raise HandshakeError(f"inconsistent handshake: {error}") from None
