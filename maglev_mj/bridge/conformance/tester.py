"""Host that tests a device and records protocol violations; registry and results of its checks."""

from __future__ import annotations

import itertools
import math
import random
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from enum import IntEnum
from functools import partial
from typing import Any, NamedTuple, NoReturn, TypeAlias

from maglev_mj.bridge import wire
from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.connection import RETRY_INTERVAL, TAKEOVER, draw, exchange, profile_of
from maglev_mj.bridge.fault import HandshakeError
from maglev_mj.bridge.flight_guards import shown as pose_shown
from maglev_mj.bridge.landing import Leader, RecentMotion, straight
from maglev_mj.bridge.links import Link
from maglev_mj.bridge.safety import OutputLimiter, are_off, at_most
from maglev_mj.bridge.wire import WRAP, Fault, Flag, HelloStatus, Operation, State, fault_names, newer
from maglev_mj.errors import MaglevError, PlantError
from maglev_mj.frames import ZERO, Sample
from maglev_mj.plants.sensor import tracker_of

_PATIENCE = 2.0  # [s]
_ANSWERS: dict[type, type] = {
    wire.Hello: wire.HelloAck,
    wire.ControlRequest: wire.ControlAck,
    wire.Estop: wire.EstopAck,
}
_TRIES = 10  # repetitions of a check if this host was late
_LED = 0.6  # [s] of takeoff and landing
_OFF_CENTRE = 0.5  # from the centre, as a share of the largest error of a takeoff
_Numbers: TypeAlias = Sequence[float]
_Walls: TypeAlias = tuple[wire.WallMessage, ...]
_Law: TypeAlias = Callable[[Any], _Numbers]


class Unexpected(MaglevError):
    """The device's behaviour differs from the expected one."""


class CheckResult(NamedTuple):
    """Result of one check.

    Attributes:
        name: Name of the check.
        expected: Behaviour required by the protocol.
        seen: Observed behaviour, or the reason for skipping the check.
        passed: True if it passed; None if it was skipped.
    """

    name: str
    expected: str
    seen: str
    passed: bool | None


class Check(NamedTuple):
    """Check and its requirements.

    Attributes:
        expected: Behaviour required by the protocol.
        run: Function that returns the observed behaviour, or raises `Unexpected`.
        flight: True if the check flies.
        real_time: True if it needs real time.
        peers: Number of host addresses it needs.
        keyed: True if it needs a key.
        lockstep: True if it needs lockstep.
        state: State to which the device is brought first.
    """

    expected: str
    run: Callable[[Tester], str]
    flight: bool = False
    real_time: bool = False
    peers: int = 1
    keyed: bool = False
    lockstep: bool = False
    state: State = State.INACTIVE

    def result(self, name: str, tester: Tester, flight: bool) -> CheckResult:
        """Run the check; repeat it if this host was late."""
        reasons = {
            "flights disabled": self.flight and not flight,
            "needs real time (the device is in lockstep)": self.real_time and tester.welcome.lockstep,
            "needs a second host address (a serial link has one)": self.peers > len(tester.links),
            "needs a key": self.keyed and not tester.keyed,
            "needs a device in lockstep": self.lockstep and not tester.welcome.lockstep,
        }
        if reason := next((reason for reason, holds in reasons.items() if holds), ""):
            return CheckResult(name, self.expected, reason, None)
        for _ in range(_TRIES):
            tester.late = False
            try:
                tester.bring(self.state)
                with tester.flying() if self.flight else nullcontext():
                    return CheckResult(name, self.expected, self.run(tester), True)
            except (Unexpected, PlantError) as error:
                note = "; this host read STATEs late" if tester.late else ""
                result = CheckResult(name, self.expected, f"{error}{note}", False)
            tester.leave()
            if not tester.late:
                break
        return result


CHECKS: dict[str, Check] = {}
"""Checks in the order of execution."""


def check(expected: str, name: str = "", **needs: Any) -> Callable[[Callable[[Tester], str]], object]:
    """Register a check, by default under its function's name; `needs` are other fields of `Check`."""

    def add(run: Any) -> object:
        CHECKS[name or run.__name__.strip("_").replace("_", "-")] = Check(expected, run, **needs)
        return run

    return add


class Tester:
    """Host that tests a device; it follows the protocol unless a check makes it deviate.

    Args:
        links: Links to the device, one per host address; the first one holds the session.
        calibration: Calibration of the device.
        key: Authentication key of the frames.

    Attributes:
        welcome: HELLO_ACK of the session, sent at `greeted` by the device's clock [ns].
        last: Newest STATE.
        law: Function from a STATE to the currents of its answer [A].
        walls: Walls of every command.
        once: Arguments of `command` for the next answer, instead of the law's currents.
        answering: True if STATEs are answered.
        loss: Fraction of answers that are lost; the same fractions are damaged and duplicated.
        late: True if a STATE was read more than half a period late, which may be this host's fault.
        wrong: First violation of each rule.
        others: Received frames except STATEs.
    """

    def __init__(self, links: Sequence[Link], calibration: Calibration, key: bytes | None) -> None:
        self.links, self.calibration, self.keyed, self.codec = links, calibration, key is not None, wire.Codec(key)
        self.half = tuple((0.5 * calibration.hover).tolist())
        self.session = self.greeted = self.sequence = self.request = self.nonce = self.asked_at = self.arrived = 0
        self.welcome: wire.HelloAck
        self.last: Any = None
        self.law = constant(ZERO)
        self.answering, self.late, self.loss = True, False, 0.0
        self.wrong: dict[str, str] = {}
        self.once: list[Sequence[Any]] = []
        self.walls: _Walls = ()
        self._answer: Sequence[Any] = []
        self.others: list[Any] = []
        self._sessions: set[int] = set()
        self._times: dict[int, int] = {}  # of the last frame from each address
        self._random, self._raw, self._idle = random.Random(1), b"", 0
        self._scale, self._offsets = calibration.device.scale, calibration.spot_offsets.tolist()
        self._track = tracker_of(calibration.beams, self._scale.reach)

    def now(self) -> int:
        """Return the link's clock [ns]."""
        return self.links[0].now()

    def encode(self, body: Any, *, session: int | None = None, sequence: int = 0) -> bytes:
        """Return an encoded frame, by default of this session."""
        if isinstance(body, (wire.Hello, wire.Estop)):
            session = 0
        return self.codec.encode(self.session if session is None else session, sequence, self.now(), body)

    def command(
        self, answers: int, held: _Numbers, pulsed: _Numbers = (), width: float = 0.0, walls: _Walls = ()
    ) -> None:
        """Send currents under the next sequence number."""
        self.sequence = (self.sequence + 1) & WRAP
        body = wire.CommandFrame(answers & WRAP, 0, tuple(held), tuple(pulsed or held), width, walls or self.walls)
        data, chance = self.encode(body, sequence=self.sequence), self._random.random()
        if self.loss <= chance < 2.0 * self.loss:
            self.links[0].send(data[:43] + bytes([data[43] ^ 255]) + data[44:])
        for _ in range((chance >= self.loss) + (2.0 * self.loss <= chance < 3.0 * self.loss)):
            self.links[0].send(data)

    def receive(self, timeout: float, peer: int = 0) -> Any:
        """Return the next frame at an address, or None after `timeout` [s]; answer STATEs meanwhile."""
        end = self.now() + round(timeout * 1e9)
        while True:
            remaining, source = max((end - self.now()) * 1e-9, 0.0), peer
            data = self.links[peer].receive(0.0 if peer else remaining)
            if data is None and peer:
                source, data = 0, self.links[0].receive(min(remaining, 1e-3))
            if data is None and self.now() >= end:
                return None
            frame = None if data is None else self._checked(data, source)
            if frame is not None and source == peer:
                return frame

    def wait(self, seconds: float, kind: type | None = None) -> Any:
        """Receive until a frame of a kind, which is returned, or None after `seconds`."""
        end = self.now() + round(seconds * 1e9)
        while (remaining := end - self.now()) > 0:
            if (frame := self.receive(remaining * 1e-9)) is not None and kind and isinstance(frame.body, kind):
                return frame
        return None

    def exchange(self, body: Any, patience: float = _PATIENCE, *, peer: int = 0, **header: int) -> Any:
        """Repeat a request until it is answered; return the answer, or None after `patience` [s]."""
        encode, receive = partial(self.encode, body, **header), partial(self.receive, peer=peer)
        for frame in exchange(self.links[peer], encode, receive, RETRY_INTERVAL, patience):
            if frame.body[0] == body[0] and isinstance(frame.body, _ANSWERS[type(body)]):  # nonce or request
                return frame
        return None

    def states(self, count: int) -> list[Any]:
        """Return the frames of the next samples."""
        frames: list[Any] = []
        end = self.now() + 3 * count * self.welcome.period + round(_PATIENCE * 1e9)
        while len(frames) < count:
            frame = self.wait((end - self.now()) * 1e-9, wire.StateReport)
            frames.append(frame or fail(f"{len(frames)} STATEs instead of {count}"))
        return frames

    # rules for all frames

    def _checked(self, data: bytes, source: int) -> Any:
        """Check a frame against the general rules; return it if it belongs to this session."""
        frame: Any = self.codec.decode(data)
        if frame is None:
            self.wrong.setdefault("frames", f"invalid frame: {data[:200].hex()}")
            return None
        body, kind = frame.body, type(frame.body)
        ours, reports = kind in (wire.StateReport, wire.ControlAck), kind is wire.StateReport
        welcomes = kind is wire.HelloAck and body.status == HelloStatus.WELCOME
        self._sessions |= {frame.session} if welcomes else set()
        wrong = {
            "type": kind in (wire.Hello, wire.ControlRequest, wire.CommandFrame, wire.Estop)
            or (reports and source > 0),
            "padding": self.codec.encode(*frame) != data,
            "sequence number": frame.sequence > 0 and not reports,
            "session": (frame.session not in self._sessions) if ours else (frame.session != 0) != welcomes,
            # per address: the order of arrival at two of them is arbitrary
            "time": self.last is not None and frame.time + self.welcome.period < self._times.get(source, 0),
        }
        self._times[source] = frame.time
        if any(wrong.values()):
            names = ", ".join(name for name, is_wrong in wrong.items() if is_wrong)
            self.wrong.setdefault("frames", f"wrong {names} of a {kind.__name__}: {data.hex()}")
        if ours and frame.session != self.session:
            return None
        if reports:
            return self._sampled(frame, data)
        self.others.append(frame)
        return frame

    def _sampled(self, frame: Any, data: bytes) -> Any:
        """Answer a sample; return it if it is new."""
        before, arrived, self.arrived = self.last, self.arrived, self.now()
        is_newer = before is None or newer(frame.sequence, before.sequence)
        if is_newer:
            self._check_frame(frame, before)
            self.last, self._raw = frame, data
            if before is not None:
                usual = ((frame.sequence - before.sequence) & WRAP) * self.welcome.period
                self.late |= self.arrived - arrived > usual + self.welcome.period // 2
        elif frame.sequence == before.sequence and data != self._raw:
            self.wrong.setdefault("samples", f"number {frame.sequence} repeated with different bytes")
        if self.answering and frame.sequence == self.last.sequence:
            if is_newer or not self._answer:
                self._answer = self.once.pop() if self.once else [self.law(frame)]
            self.command(frame.sequence, *self._answer)
        return frame if is_newer else None

    def _check_frame(self, frame: Any, before: Any) -> None:
        """Record violations in a sample."""
        body, period = frame.body, self.welcome.period
        # after a cut, currents take a few samples to decay
        stopping = body.flags & Flag.STOPPING
        self._idle = 0 if body.state == State.ACTIVE or stopping else self._idle + 1
        wrong = {
            "frames": body.flags & ~int(sum(Flag)) or body.valid > 7 or body.state > max(State),
            "samples": not all(map(math.isfinite, (*body.spots, *body.currents, *body.temperatures)))
            or (body.state == State.FAULT) != bool(body.faults)
            or (body.flags & Flag.HOLDING and body.state != State.ACTIVE)
            or (stopping and body.state != State.FAULT),
            "cut": self._idle > 3 and not self.is_off(body.currents),
        }
        if before is not None:
            steps = (frame.sequence - before.sequence) & WRAP
            wrong["samples"] |= frame.time - before.time != steps * period
            wrong["samples"] |= not newer(body.conversions, before.body.conversions)
        for rule in (rule for rule, is_wrong in wrong.items() if is_wrong):
            self.wrong.setdefault(rule, f"{frame} after {before}")

    # sessions and states

    def greet(self, nonce: int, calibration: bytes | None = None, peer: int = 0) -> Any:
        """Return the answer to a HELLO."""
        answer = self.exchange(wire.Hello(nonce, calibration or self.calibration.digest), peer=peer)
        return answer or fail("no answer to HELLO")

    def join(self) -> None:
        """Start a session, waiting for a lost host's session to expire.

        Raises:
            HandshakeError: If no device answers, or it refuses this host.
        """
        end, self.session = self.now() + round(2.0 * TAKEOVER * 1e9), 0
        while True:
            self.nonce = draw()
            frame = self.exchange(wire.Hello(self.nonce, self.calibration.digest))
            if frame is None:
                raise HandshakeError(f"no answer from the device within {_PATIENCE:g} s")
            status = frame.body.status
            if status == HelloStatus.WELCOME:
                self.welcome, self.session, self.greeted, self.last = frame.body, frame.session, frame.time, None
                self.sequence = self.request = 0
                self._times.clear()
                return
            if status != HelloStatus.BUSY or self.now() > end:
                hint = "; state its file by --device" if status == HelloStatus.CALIBRATION else ""
                shown_status = shown(status, HelloStatus.WELCOME)
                raise HandshakeError(f"the device answered HELLO with status {shown_status}{hint}")
            self.wait(0.1)

    def ask(
        self, operation: int, *, faults: int = 0, hover: _Numbers = (), stop: _Numbers = wire.CUT, **header: int
    ) -> wire.ControlAck:
        """Send a new request and return its answer."""
        self.request = (self.request + 1) & WRAP
        body = wire.ControlRequest(self.request, operation, faults, tuple(hover or self.half), tuple(stop))
        frame = self.exchange(body, **header) or fail(f"no answer to {shown(operation, Operation.ARM)}")
        answer: wire.ControlAck = frame.body
        self.asked_at = frame.time
        same("operation", answer.operation, operation)
        return answer

    def bring(
        self, state: State, currents: _Numbers = ZERO, *, answering: bool = True, stop: _Numbers = wire.CUT
    ) -> None:
        """Bring the device to a state and check it in a sample.

        Args:
            state: Target state.
            currents: Commanded currents in ACTIVE [A].
            answering: False to stop sending commands afterwards.
            stop: Parameters of the controlled stop at ARM.
        """
        self.law, self.answering, self.loss, self.once, self.walls = constant(ZERO), True, 0.0, [], ()
        try:
            self.ask(Operation.DISARM) if self.session else self.join()
        except Unexpected:
            self.join()
        end = self.now() + round(TAKEOVER * 1e9)
        while (answer := self.ask(Operation.DISARM)).state != State.INACTIVE:
            # refused until a sample shows that the currents are off
            if self.ask(Operation.RESET).state != State.INACTIVE:
                if self.now() > end:
                    fail(f"RESET refused: {fault_names(answer.faults)}")
                self.states(1)
        if state == State.FAULT:
            answer = self.ask(Operation.TRIP, faults=Fault.HOST)
        elif state == State.ACTIVE:
            self.law = constant(currents)
            answer = self.ask(Operation.ARM, stop=stop)
            self.states(1 + math.ceil(self.welcome.delay / self.welcome.period))
        same("state", answer.state, state)
        self.expect(state, Fault.HOST if state == State.FAULT else 0, 1)
        self.answering = answering

    def expect(self, state: State, faults: int = 0, samples: int = 2) -> Any:
        """Check state and faults of all received samples but the first; return the last one."""
        for frame in (seen := self.states(samples + 1)[1:]):
            same("state, faults", (frame.body.state, frame.body.faults), (state, Fault(faults)))
        return seen[-1]

    def leave(self) -> None:
        """End the session."""
        if self.session:
            with suppress(Unexpected):
                self.ask(Operation.BYE)
        self.session = 0

    def release(self) -> None:
        """Leave the device INACTIVE, without a session; request an emergency stop if that fails."""
        try:
            self.bring(State.INACTIVE)
            self.ask(Operation.BYE)
        except BaseException as error:
            self.exchange(wire.Estop(draw()))
            if not isinstance(error, MaglevError):
                raise

    def is_off(self, currents: Sequence[float]) -> bool:
        """Return True if measured currents [A] count as off."""
        return are_off(currents, self.welcome.off_current)

    def close(self, frame: Any, expected: Sequence[float]) -> None:
        """Check that the measured currents are close to the expected ones [A]."""
        measured, tolerance = frame.body.currents, 0.4 * self.welcome.off_current
        if any(abs(actual - current) > tolerance + 0.1 * abs(current) for actual, current in zip(measured, expected)):
            fail(f"{shown(measured)} A measured instead of {shown(expected)} A")

    def stopped(self, peer: int = 0, faults: int = Fault.ESTOP) -> str:
        """Request emergency stops until the measured currents are off; return the time taken as text."""
        body, start, first = wire.Estop(draw()), self.now(), None
        while True:
            frame = self.exchange(body, peer=peer) or fail("no answer to ESTOP")
            ack, first = frame.body, first or frame
            same("state, faults in ESTOP_ACK", (ack.state, ack.faults), (State.FAULT, faults))
            if not 0 <= frame.time - ack.sampled <= 2 * self.welcome.period:
                fail(f"sampled at {ack.sampled} ns, reported at {frame.time} ns")
            stated = self.welcome.lockstep, self.welcome.off_current
            same("lockstep, off_current in ESTOP_ACK", (ack.lockstep, ack.off_current), stated)
            taken = f"{(self.now() - start) / 1e6:.1f} ms"
            if self.welcome.lockstep:
                return f"{taken}; in lockstep no sample follows"
            if ack.sampled > first.time and self.is_off(ack.currents):
                return f"{taken} until {at_most(ack.off_current)} was measured"
            if self.now() - start > 1_000_000_000:
                fail(f"{shown(ack.currents)} A measured 1 s after ESTOP")
            self.wait(0.005)

    def zero(self) -> str:
        """Check that the currents are off from the second sample on."""
        for frame in self.states(4)[1:]:
            if not self.is_off(frame.body.currents):
                fail(
                    f"{shown(frame.body.currents)} A after the cut instead of at most {self.welcome.off_current:.3g} A"
                )
        return at_most(self.welcome.off_current)

    # flights

    @contextmanager
    def flying(self) -> Iterator[None]:
        """Take off from rest, and land at exit in any case."""
        welcome, period, calibration = self.welcome, self.welcome.period * 1e-9, self.calibration
        # before ARM: computing time in flight would trip the watchdog
        output = OutputLimiter(calibration.coils, profile_of(welcome, self.greeted).limits, None, period)
        leader = Leader(calibration, period, welcome.delay * 1e-9)
        stop = calibration.controlled_stop(period + welcome.delay * 1e-9, welcome.continuous_current)

        def law(frame: Any) -> Sequence[float]:
            pose = self.locate(frame)
            return output.currents(leader.step(Sample(frame.sequence, frame.time * 1e-9, pose)), pose)[1]

        def off_path(pose: Sequence[float]) -> None:
            if self.last.body.state == State.ACTIVE:
                fail(f"the flotor does not follow: {pose_shown(pose)}")

        rest, led = self._rest(), round(1.5 * _LED * 1e9) // welcome.period
        leader.aim(straight(rest, ZERO, _LED), off_path)
        self.law = law
        try:
            armed = self.ask(Operation.ARM, hover=calibration.hover.tolist(), stop=stop)
            same("state after ARM", armed.state, State.ACTIVE)
            self.states(led)
            self.hovers()
            yield
        finally:
            if self.last is not None and self.last.body.state == State.ACTIVE:
                leader.aim(straight(ZERO, rest, _LED))
                self.law, self.answering, self.loss = law, True, 0.0
                with suppress(MaglevError):
                    self.states(led)

    def hovers(self) -> str:
        """Check that the flotor hovers at the centre; return its pose as text."""
        pose = self.locate(self.expect(State.ACTIVE))
        most, turned = _OFF_CENTRE * self._scale.path, _OFF_CENTRE * self._scale.path_angle
        if math.hypot(*pose[:3]) > most or math.hypot(*pose[3:]) > turned:
            fail(f"the flotor hovers off centre: {pose_shown(pose)}")
        return pose_shown(pose)

    def _rest(self) -> list[float]:
        """Wait until the flotor is at rest and return its pose."""
        motion, end = RecentMotion(self.welcome.period * 1e-9, self._scale), self.now() + 10_000_000_000
        while not (motion.full and motion.at_rest):
            frame = self.states(1)[0]
            motion.add(Sample(frame.sequence, frame.time * 1e-9, self.locate(frame)))
            if self.now() > end:
                fail(f"the flotor is not at rest after 10 s: {motion}")
        return motion.pose

    def locate(self, frame: Any) -> list[float]:
        """Return the pose of a sample [m, rad]."""
        return self._track([spot - offset for spot, offset in zip(frame.body.spots, self._offsets)])


@contextmanager
def case(name: str) -> Iterator[None]:
    """Prefix the message of a failure with the case."""
    try:
        yield
    except (Unexpected, PlantError) as error:
        raise Unexpected(f"{name}: {error}") from None


def fail(seen: str) -> NoReturn:
    """Fail a check with the observed behaviour."""
    raise Unexpected(seen)


def same(what: str, actual: Any, expected: Any) -> str:
    """Fail a check if values differ; return the actual one as text."""
    if actual != expected:
        fail(f"{what} {shown(actual, expected)} instead of {shown(expected, expected)}")
    return f"{what} {shown(actual, expected)}"


def shown(value: Any, like: Any = None) -> str:
    """Return values as text, as names of the enumeration if `like` is a member; sequences elementwise."""
    if isinstance(value, (tuple, list)):
        return f"({', '.join(itertools.starmap(shown, itertools.zip_longest(value, (like or ())[: len(value)])))})"
    if isinstance(like, Fault):
        return fault_names(value)
    if isinstance(like, IntEnum):
        return type(like)(value).name if value in tuple(type(like)) else str(value)
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def constant(currents: _Numbers) -> _Law:
    """Return the law of constant currents [A], six."""
    return lambda frame: currents
