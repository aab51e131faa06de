"""Device's side of a session, in Python and in C.

States, latched faults, permitted hosts, and silence.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import pytest

from maglev_mj.bridge.safety import Limits, Profile
from maglev_mj.bridge.twin.firmware import Reading
from maglev_mj.bridge.wire import (
    Codec,
    Command,
    Control,
    ControlAck,
    Estop,
    EstopAck,
    Fault,
    Flag,
    Frame,
    Hello,
    HelloAck,
    HelloStatus,
    Operation,
    Result,
    State,
    StateReport,
)
from tests.firmware_core import FIRMWARE, FIRMWARES
from tests.test_wire import KEY, sealed, tables

PERIOD, DELAY = 5_000_000, 1_500_000
START = 3_000_000_000_123  # of the device's clock: it has run for 50 minutes
CALIBRATION = bytes(range(16))
ZERO = (0.0,) * 6
ONES = (1.0, 1.0, 1.0, -1.0, -1.0, -1.0)
HOVER = (1.1, 1.1, 1.1, 0.0, 0.0, 0.0)
NEVER = 0xFFFFFFFF


class Bench:
    """Device on a bench with ideal amplifiers and a host.

    Attributes:
        drives: Commands to the amplifiers, in order.
        cuts: Number of cuts.
        toggles: Instants at which the enable line changed [ns].
    """

    make: Callable[..., Any]

    def __init__(
        self, *, lockstep: bool = False, key: bytes | None = None, period: int = PERIOD, **limits: Any
    ) -> None:
        profile = Profile(
            period=period, delay=DELAY, calibration=CALIBRATION, limits=Limits(**limits), lockstep=lockstep
        )
        self.period = period
        self.codec = Codec(key)
        self.drawn = 100
        self.host = Codec(key)
        self.drives: list[tuple[Sequence[float], Sequence[float] | None, float]] = []
        self.toggles: list[int] = []
        self.cuts = 0
        self.currents: Sequence[float] = ZERO
        self.sequence = self.request = self.conversions = 0
        self.now, self.tick = START, -1
        self.device = Bench.make(profile, self, self.codec, self._draw)

    def _draw(self) -> int:
        self.drawn += 1
        return self.drawn

    def drive(self, now: int, held: Sequence[float], pulsed: Sequence[float] | None, width: float) -> None:
        assert now == self.now
        self.drives.append((held, pulsed, width))
        self.currents = held

    def cut(self) -> None:
        self.cuts += 1
        self.currents = ZERO

    def toggle(self, now: int) -> None:
        assert now == self.now
        self.toggles.append(now)

    def give(self, body: Any, *, session: int | None = None, sequence: int | None = None, peer: str = "host") -> Any:
        """Give the device a frame; return the answer, or None.

        A command has the next sequence number.
        """
        self.sequence += isinstance(body, Command)
        session = self.device.session if session is None else session
        number = sequence if sequence is not None else self.sequence * isinstance(body, Command)
        data = self.device.receive(self.host.encode(session, number, self.now, body), self.now, peer)
        return None if data is None else self.read(data)

    def read(self, data: bytes | None) -> Any:
        assert data is not None
        frame = self.host.decode(data)
        assert frame is not None and not self.host.dropped
        self.last: Frame = frame
        return frame.body

    def hello(self, nonce: int = 1, peer: str = "host", calibration: bytes = CALIBRATION) -> HelloAck:
        answer = self.give(Hello(nonce, calibration), session=0, peer=peer)
        assert isinstance(answer, HelloAck)
        assert self.last.sequence == 0 and self.last.time == self.now
        return answer

    def ask(self, operation: int, *, faults: int = 0, hover: Sequence[float] = HOVER) -> ControlAck:
        self.request += 1
        answer = self.give(Control(self.request, operation, faults, tuple(hover)))
        assert isinstance(answer, ControlAck)
        assert self.last.sequence == 0 and self.last.time == self.now
        return answer

    def estop(self, request: int = 5, **frame: Any) -> EstopAck:
        answer = self.give(Estop(request), **frame)
        assert isinstance(answer, EstopAck) and answer.request == request
        assert (self.last.session, self.last.sequence, self.last.time) == (0, 0, self.now)
        return answer

    def command(self, held: Sequence[float] = ONES, pulsed: Sequence[float] = ZERO, width: float = 0.0) -> None:
        answers = max(self.tick, 0)
        assert self.give(Command(answers, 0, tuple(held), tuple(pulsed), width)) is None

    def sample(
        self,
        *,
        spots: Sequence[float] | None = None,
        valid: int = 7,
        measured: Sequence[float] | None = None,
        currents: Sequence[float] | None = None,
        conversions: int | None = None,
        enabled: bool = True,
        steps: int = 1,
    ) -> StateReport | None:
        """Go on by so many periods and sample."""
        self.tick += steps
        self.now = START + self.tick * self.period
        self.conversions = self.conversions + steps if conversions is None else conversions
        flowing = self.currents if currents is None else currents
        reading = Reading(
            moving(self.tick) if spots is None else spots,
            valid,
            flowing if measured is None else measured,
            flowing,
            ((self.period * 1e-9, flowing),),
            self.conversions,
            enabled,
        )
        data = self.device.sample(self.tick, self.now, reading)
        if data is None:
            return None
        report = self.read(data)
        assert isinstance(report, StateReport)
        assert self.last.sequence == self.tick and self.last.time == self.now
        return report

    def brought_to(self, state: State) -> Bench:
        """Start a session, and bring the device to a state."""
        assert self.hello().status == HelloStatus.WELCOME
        self.sample()
        if state == State.ACTIVE:
            assert self.ask(Operation.ARM) == (self.request, Operation.ARM, Result.DONE, State.ACTIVE, 0)
        elif state == State.FAULT:
            assert self.ask(Operation.TRIP, faults=Fault.CLOCK).state == State.FAULT
        return self

    def refuses(self, fault: Fault) -> None:
        """Check a latched fault, zero currents and recovery by RESET."""
        device = self.device
        assert device.state == State.FAULT and device.faults == fault
        assert self.cuts and self.currents == ZERO
        driven = len(self.drives)
        assert self.ask(Operation.ARM) == (self.request, Operation.ARM, Result.REFUSED, State.FAULT, fault)
        assert self.ask(Operation.DISARM).state == State.FAULT
        self.command()
        report = self.sample()
        assert report is not None and report.state == State.FAULT and report.faults == fault
        assert report.currents == ZERO and len(self.drives) == driven
        assert self.ask(Operation.RESET)[2:] == (Result.DONE, State.INACTIVE, 0)
        assert self.ask(Operation.ARM)[2:] == (Result.DONE, State.ACTIVE, 0)
        assert len(self.drives) == driven


@pytest.fixture(autouse=True, params=FIRMWARES)
def _firmware(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Put each firmware on the bench in turn."""
    monkeypatch.setattr(Bench, "make", staticmethod(FIRMWARE[request.param]), raising=False)


def moving(tick: int) -> list[float]:
    """Return spots that change at each sample, as with noise."""
    return [1e-3 + 1e-6 * (tick % 2 + place) for place in range(6)]


@pytest.mark.parametrize("state", State)
@pytest.mark.parametrize("operation", [*Operation, 0, 3, 7, 255])
def test_every_operation_in_every_state(state: State, operation: int) -> None:
    head, *rows = tables("| operation | INACTIVE |")
    name = Operation(operation).name if operation in [*Operation] else "other"
    (row,) = [row for row in rows if row[0] == name]
    result, _, after = row[head.index(state.name)].partition(": ")
    bench = Bench().brought_to(state)
    cuts = bench.cuts
    answer = bench.ask(operation, faults=Fault.BOUNDARY)
    assert answer == (bench.request, operation, Result[result], State[after], bench.device.faults)
    assert bench.device.state == State[after]
    assert (bench.device.session == 0) == (operation == Operation.BYE)
    tripped = operation == Operation.TRIP
    assert (Fault.BOUNDARY in bench.device.faults) == tripped
    # whatever leads away from flying cuts the currents, and nothing but a command drives them
    assert (bench.cuts > cuts) == (tripped or (state == State.ACTIVE and State[after] != State.ACTIVE))
    assert not bench.drives
    assert bool(bench.device.faults) == (State[after] == State.FAULT)


@pytest.mark.parametrize("lockstep", [False, True])
@pytest.mark.parametrize("peer", ["host", "anyone"])
@pytest.mark.parametrize("state", State)
def test_estop_is_taken_in_every_state_from_anyone_any_number_of_times(state: State, peer: str, lockstep: bool) -> None:
    bench = Bench(lockstep=lockstep).brought_to(state)
    if state == State.ACTIVE:
        bench.command()
    bench.sample()
    before, measured = bench.device.faults, bench.currents
    for count in range(1, 4):
        cuts = bench.cuts
        bench.now += 1000
        answer = bench.estop(request=2**64 - 1, peer=peer)
        assert answer == (2**64 - 1, State.FAULT, before | Fault.ESTOP, START + bench.tick * PERIOD, measured), count
        assert bench.cuts == cuts + 1
    assert bench.device.peer == "host" and bench.last.session == 0
    bench.refuses(before | Fault.ESTOP)


@pytest.mark.parametrize("fault", [False, True])
def test_estop_needs_no_session(fault: bool) -> None:
    bench = Bench()
    bench.sample()
    if fault:
        bench.estop()
    assert bench.estop() == (5, State.FAULT, Fault.ESTOP, START, ZERO) and not bench.device.counts
    assert bench.hello().state == State.FAULT


@pytest.mark.parametrize("lockstep", [False, True])
@pytest.mark.parametrize("ahead", [1000, 2**31 - 2, 2**31 + 7])
def test_numbers_far_ahead_deafen_the_device_to_commands_only(ahead: int, lockstep: bool) -> None:
    bench = Bench(lockstep=lockstep).brought_to(State.ACTIVE)
    bench.command()
    bench.give(Command(bench.tick, 0, ONES, ONES, 0.0), sequence=1 + ahead)
    driven = len(bench.drives)
    assert driven == 1 + (ahead < 2**31)
    assert bench.ask(Operation.DISARM).state == State.INACTIVE and bench.ask(Operation.ARM).state == State.ACTIVE
    bench.command()
    assert len(bench.drives) == driven + (ahead >= 2**31)
    # frames of the others with such a number, and requests far ahead, change nothing of that
    bench.request += 2**31 - 1
    assert bench.give(Control(bench.request, Operation.RESET, 0, ZERO), sequence=2**32 - 1).result == Result.REFUSED
    assert bench.estop(sequence=2**32 - 1, session=77).state == State.FAULT
    assert bench.estop(sequence=0).state == State.FAULT


def test_with_a_key_an_estop_needs_its_tag() -> None:
    bench = Bench(key=KEY).brought_to(State.ACTIVE)
    for codec in (Codec(), Codec(bytes(32))):
        assert bench.device.receive(codec.encode(0, 0, 0, Estop(5)), 0, "host") is None
    assert bench.device.state == State.ACTIVE and bench.codec.dropped == {"length": 1, "tag": 1}
    assert bench.estop().state == State.FAULT


@pytest.mark.parametrize(
    ("asked", "latched"),
    [
        (Fault.BOUNDARY | Fault.CLOCK, Fault.BOUNDARY | Fault.CLOCK),
        (0, Fault.HOST),
        (0x80000000, Fault.HOST),
        (0xFFFFFFFF, Fault(sum(Fault))),
    ],
)
def test_trip_latches_what_the_host_has_seen(asked: int, latched: Fault) -> None:
    bench = Bench().brought_to(State.ACTIVE)
    assert bench.ask(Operation.TRIP, faults=asked).faults == latched
    bench.refuses(latched)


def test_the_welcome_says_what_the_device_is() -> None:
    bench = Bench(watchdog=0.03, current_limit=8.0, thermal_time=7.0, hover_limit=1.5, enable=0.02, frozen=7)
    answer = bench.hello(nonce=2**64 - 1)
    times, limits = (PERIOD, DELAY, 30_000_000, 20_000_000), (8.0, 3.0, 1.5, 7.0, 0.012, 1.0)
    expected = HelloAck(2**64 - 1, 0, 0, 2, State.INACTIVE, 1, CALIBRATION, *times, 0, 0, 0, 7, *limits)
    assert answer == expected
    assert bench.last.session == bench.device.session == 101


def test_the_welcome_says_what_is_latched_since_when_and_why() -> None:
    bench = Bench().brought_to(State.ACTIVE)
    bench.sample()
    tripped = bench.now = bench.now + 77
    bench.ask(Operation.TRIP, faults=Fault.CLOCK | Fault.BOUNDARY)
    bench.now += 1000
    bench.estop()
    answer = bench.hello()
    assert (answer.fault_time, answer.first) == (tripped, Fault.CLOCK | Fault.BOUNDARY)
    assert answer.faults == Fault.CLOCK | Fault.BOUNDARY | Fault.ESTOP
    bench.ask(Operation.RESET)
    assert bench.hello()[11:14] == (0, 0, 0)
    bench.now += 1000
    bench.estop()
    assert bench.hello()[11:14] == (bench.now, Fault.ESTOP, Fault.ESTOP)


def test_a_hello_repeated_gets_the_same_session_and_changes_nothing() -> None:
    bench = Bench().brought_to(State.ACTIVE)
    bench.command()
    session, sequence = bench.device.session, bench.sequence
    for _ in range(3):
        assert bench.hello(nonce=1)[1:5] == (HelloStatus.WELCOME, 0, 2, State.ACTIVE)
        assert bench.last.session == bench.device.session == session
    bench.give(Command(0, 0, ONES, ONES, 0.0), sequence=sequence)  # what was taken once is still old
    assert bench.device.counts == {"old": 1} and len(bench.drives) == 1
    assert bench.drawn == 101


@pytest.mark.parametrize("state", State)
def test_a_second_host_is_told_so_and_the_first_notices_nothing(state: State) -> None:
    bench = Bench().brought_to(state)
    session, sequence = bench.device.session, bench.sequence
    for nonce, peer in ((2, "other"), (1, "other"), (2, "host")):
        answer = bench.hello(nonce=nonce, peer=peer)
        assert (answer.nonce, answer.status, bench.last.session) == (nonce, HelloStatus.BUSY, 0)
    bench.give(Control(9, Operation.TRIP, 0, ZERO), session=session, peer="other")
    assert bench.device.counts == {"busy": 3, "session": 1}
    assert (bench.device.session, bench.device.peer, bench.device.state) == (session, "host", state)
    bench.sequence = sequence  # its next frame is the next
    bench.command()
    assert len(bench.drives) == (state == State.ACTIVE)
    report = bench.sample()
    assert report is not None and report.state == state and bench.last.session == session


@pytest.mark.parametrize("state", State)
def test_a_session_is_taken_over_when_its_host_is_silent_and_the_device_does_not_fly(state: State) -> None:
    bench = Bench(watchdog=5.0).brought_to(state)
    bench.now += 999_999_999
    assert bench.hello(nonce=2, peer="other").status == HelloStatus.BUSY
    bench.now += 1
    active = state == State.ACTIVE
    assert bench.hello(nonce=2, peer="other").status == (HelloStatus.BUSY if active else HelloStatus.WELCOME)
    assert bench.device.state == state  # a latched fault is the next host's to reset
    assert bench.device.peer == ("host" if active else "other")
    if not active:
        bench.give(Control(1, Operation.TRIP, 0, ZERO), session=101)
        assert bench.device.counts["session"] == 1 and bench.last.session == 102


def test_a_new_session_forgets_numbers_and_the_last_answer() -> None:
    bench = Bench().brought_to(State.ACTIVE)
    bench.command()
    bench.ask(Operation.BYE)
    assert bench.sample() is None and bench.device.peer is None
    assert bench.hello(nonce=2).status == HelloStatus.WELCOME
    report = bench.sample()
    assert report is not None and (report.answered, report.age) == (NEVER, NEVER)
    bench.sequence, bench.request = 0, 0
    assert bench.ask(Operation.ARM).result == Result.DONE


def test_another_calibration_gets_no_session() -> None:
    bench = Bench()
    answer = bench.hello(calibration=bytes(16))
    assert (answer.status, answer.calibration) == (HelloStatus.CALIBRATION, CALIBRATION)
    assert bench.last.session == bench.device.session == 0 and bench.sample() is None


@pytest.mark.parametrize("version", [0, 1, 3, 255])
def test_another_version_is_told_ours(version: int) -> None:
    bench = Bench().brought_to(State.ACTIVE)
    session = bench.device.session
    data = bytearray(bench.host.encode(0, 0, 0, Hello(5, CALIBRATION)))
    for more in (b"", b"and more that only that version knows"):
        data[2] = version
        answer = bench.read(bench.device.receive(sealed(bytes(data) + more), 0, "other"))
        assert answer[:4] == (0, HelloStatus.VERSION, 0, 2) and bench.last.session == 0
    for body in (Control(9, Operation.TRIP, 0, ZERO), Estop(1)):
        data = bytearray(bench.host.encode(session, 0, 0, body))
        data[2] = version
        assert bench.device.receive(sealed(bytes(data)), 0, "host") is None
    assert bench.codec.dropped == {"version": 4} and bench.device.state == State.ACTIVE


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"sequence": 1}, "old"),
        ({"sequence": 0}, "old"),
        ({"sequence": 1 + 2**31}, "old"),
        ({"sequence": 2**32 - 1}, "old"),
        ({"session": 102}, "session"),
        ({"session": 0}, "session"),
        ({"peer": "other"}, "session"),
    ],
)
@pytest.mark.parametrize("body", [Command(0, 0, ONES, ONES, 0.0), Control(9, Operation.TRIP, 0, ZERO)])
def test_what_is_old_or_not_of_the_session_is_ignored(body: Any, changes: dict[str, Any], reason: str) -> None:
    bench = Bench().brought_to(State.ACTIVE)
    bench.command()
    assert bench.sequence == 1 and len(bench.drives) == 1
    if reason == "old" and isinstance(body, Control):  # which has no such number
        assert bench.give(body, **changes).state == State.FAULT
        return
    assert bench.give(body, **changes) is None
    assert bench.device.counts == {reason: 1}
    assert bench.device.state == State.ACTIVE and len(bench.drives) == 1
    assert bench.give(Control(9, Operation.TRIP, 0, ZERO)).state == State.FAULT


def test_frames_of_a_device_are_ignored_by_one() -> None:
    bench = Bench().brought_to(State.ACTIVE)
    for body in (
        ControlAck(1, 1, 0, 0, 0),
        StateReport(ZERO, ZERO, ZERO, 1, 7, 0, 0, 0, 0, 0),
        HelloAck(1, 0, 0, 1, 0, 1, CALIBRATION, 1, 1, 1, 1, 0, 0, 0, 0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0),
        EstopAck(1, 0, 0, 0, ZERO),
    ):
        assert bench.give(body) is None
    assert bench.device.counts == {"direction": 4}


def test_nothing_is_taken_without_a_session() -> None:
    bench = Bench()
    assert bench.give(Control(1, Operation.ARM, 0, ZERO)) is None
    assert bench.give(Control(1, Operation.ARM, 0, ZERO), session=101) is None
    assert bench.device.counts == {"session": 2} and bench.device.state == State.INACTIVE


def test_sequence_numbers_go_round() -> None:
    bench = Bench().brought_to(State.ACTIVE)
    for number in (2**31 - 1, 2**32 - 2, 2**32 - 1, 0, 1):
        bench.give(Command(0, 0, ONES, ONES, 0.0), sequence=number)
    assert len(bench.drives) == 5 and not bench.device.counts


@pytest.mark.parametrize("state", [State.INACTIVE, State.FAULT])
@pytest.mark.parametrize(("current", "width"), [(math.nan, 0.0), (1e308, 0.0), (1.0, -1.0)])
def test_a_command_to_a_device_that_is_not_active_is_not_examined(state: State, current: float, width: float) -> None:
    bench = Bench().brought_to(state)
    before = bench.device.faults
    bench.command((current,) * 6, width=width)
    assert bench.device.counts == {"inactive": 1}
    assert (bench.device.state, bench.device.faults) == (state, before) and not bench.drives
    assert bench.device.answered == bench.tick  # it was an answer all the same
    bench.now += 999_999_999
    assert bench.hello(nonce=2, peer="other").status == HelloStatus.BUSY  # and its host lives


@pytest.mark.parametrize(
    ("period", "watchdog", "most"), [(5_000_000, 0.05, 10), (15_000_000, 0.05, 3), (7_000_000, 0.007, 1)]
)
def test_an_answer_may_be_as_many_samples_behind_as_the_watchdog_has_whole_periods(
    period: int, watchdog: float, most: int
) -> None:
    bench = Bench(period=period, watchdog=watchdog).brought_to(State.INACTIVE)
    for _ in range(20):
        bench.sample()
    bench.ask(Operation.ARM)
    for answers, taken in ((bench.tick - most, 1), (bench.tick, 2), (bench.tick - most - 1, 2), (bench.tick + 1, 2)):
        bench.give(Command(answers, 0, ONES, ONES, 0.0))
        assert len(bench.drives) == taken, answers
    assert bench.device.counts == {"old": 2}


def test_a_command_is_driven_as_it_came() -> None:
    bench = Bench().brought_to(State.ACTIVE)
    bench.command(ONES, HOVER, 0.0005)
    bench.command(ONES, HOVER, 0.0)
    assert bench.drives == [(ONES, HOVER, 0.0005), (ONES, None, 0.0)]
    report = bench.sample()
    assert report is not None and (report.answered, report.age, report.flags) == (0, 5000, Flag.ENABLED)


NAN, INF = math.nan, math.inf


@pytest.mark.parametrize("place", [0, 5])
@pytest.mark.parametrize("pulse", [False, True])
@pytest.mark.parametrize(
    ("current", "fault"),
    [
        (NAN, Fault.INVALID_COMMAND),
        (INF, Fault.INVALID_COMMAND),
        (-INF, Fault.INVALID_COMMAND),
        (10.1, Fault.COIL_OVERCURRENT),
        (-10.1, Fault.COIL_OVERCURRENT),
        (10.0 * (1.0 + 1e-8), Fault.COIL_OVERCURRENT),
        (1e308, Fault.COIL_OVERCURRENT),
    ],
)
def test_a_current_that_must_not_be_is_a_fault(current: float, fault: Fault, pulse: bool, place: int) -> None:
    bench = Bench().brought_to(State.ACTIVE)
    bench.command()
    wrong = [*ZERO]
    wrong[place] = current
    bench.command(ONES if pulse else wrong, wrong if pulse else ZERO, 0.001 if pulse else 0.0)
    assert len(bench.drives) == 1
    bench.refuses(fault)


@pytest.mark.parametrize("width", [NAN, INF, -INF, -1e-9, 1.0 + 1e-9, 1e308])
def test_a_width_that_must_not_be_is_a_fault(width: float) -> None:
    bench = Bench().brought_to(State.ACTIVE)
    bench.command(ONES, ONES, width)
    assert not bench.drives
    bench.refuses(Fault.INVALID_COMMAND)


@pytest.mark.parametrize("width", [0.0, -0.0, 5e-324, 1.0])
@pytest.mark.parametrize("current", [10.0, -10.0, 10.0 * (1.0 + 1e-10)])
def test_the_largest_current_and_width_are_taken(current: float, width: float) -> None:
    bench = Bench().brought_to(State.ACTIVE)
    bench.command((current,) * 6, (-current,) * 6, width)
    assert bench.device.state == State.ACTIVE and len(bench.drives) == 1


@pytest.mark.parametrize("place", [0, 5])
@pytest.mark.parametrize("current", [NAN, INF, -INF, 1.5 + 1e-9, -1.5 - 1e-9, 9.0])
def test_hover_currents_that_must_not_be_are_refused(current: float, place: int) -> None:
    bench = Bench(hover_limit=1.5).brought_to(State.INACTIVE)
    hover = [*ZERO]
    hover[place] = current
    assert bench.ask(Operation.ARM, hover=hover)[2:] == (Result.REFUSED, State.INACTIVE, 0)
    hover[place] = math.copysign(1.5, current)
    assert not bench.toggles and bench.ask(Operation.ARM, hover=hover)[2:] == (Result.DONE, State.ACTIVE, 0)


def test_faults_add_up() -> None:
    bench = Bench().brought_to(State.FAULT)
    bench.estop()
    assert bench.ask(Operation.TRIP).faults == Fault.CLOCK | Fault.ESTOP | Fault.HOST


def flags_while_silent(bench: Bench, samples: int) -> list[tuple[State, Flag, Fault]]:
    found = []
    for _ in range(samples):
        report = bench.sample()
        assert report is not None
        found.append((State(report.state), Flag(report.flags), Fault(report.faults)))
    return found


@pytest.mark.parametrize("commanded", [True, False], ids=["after a command", "after arming"])
def test_silence_is_held_after_two_periods_and_ends_with_the_watchdog(commanded: bool) -> None:
    bench = Bench().brought_to(State.ACTIVE)
    if commanded:
        bench.command(ONES, HOVER, 0.001)
    found = flags_while_silent(bench, 12)
    none, holding = (State.ACTIVE, Flag.ENABLED, Fault(0)), (State.ACTIVE, Flag.ENABLED | Flag.HOLDING, Fault(0))
    assert found[:2] == [none] * 2  # 5 and 10 ms: no more than two periods
    assert found[2:10] == [holding] * 8  # 15 to 50 ms: no more than the watchdog
    assert found[10:] == [(State.FAULT, Flag.ENABLED, Fault.WATCHDOG)] * 2
    assert bench.drives[commanded:] == [(HOVER, None, 0.0)]  # once
    bench.refuses(Fault.WATCHDOG)


def test_one_command_lost_is_no_silence() -> None:
    bench = Bench().brought_to(State.ACTIVE)
    for tick in range(40):
        if tick % 2:
            bench.command()
        report = bench.sample()
        assert report is not None and report.flags == Flag.ENABLED and report.state == State.ACTIVE
    assert len(bench.drives) == 20


def test_a_command_ends_the_hold() -> None:
    bench = Bench().brought_to(State.ACTIVE)
    bench.command()
    assert flags_while_silent(bench, 4)[-1][1] & Flag.HOLDING
    bench.command()
    report = bench.sample()
    assert report is not None and (report.flags, report.age) == (Flag.ENABLED, 5000)
    assert [held for held, _, _ in bench.drives] == [ONES, HOVER, ONES]
    flags_while_silent(bench, 4)
    assert len(bench.drives) == 4  # and it is held again


@pytest.mark.parametrize("operation", [Operation.DISARM, Operation.TRIP])
def test_nothing_is_held_once_the_currents_are_off(operation: Operation) -> None:
    bench = Bench().brought_to(State.ACTIVE)
    assert flags_while_silent(bench, 4)[-1][1] & Flag.HOLDING
    bench.ask(operation)
    report = bench.sample()
    assert report is not None and report.flags == Flag.ENABLED and bench.currents == ZERO


def test_the_watchdog_is_as_long_as_it_is_said_to_be() -> None:
    bench = Bench(watchdog=0.012).brought_to(State.ACTIVE)
    assert [state for state, _, _ in flags_while_silent(bench, 3)] == [State.ACTIVE, State.ACTIVE, State.FAULT]
    assert not bench.drives  # when both are due, it is the fault


def test_in_lockstep_silence_lasts_as_long_as_it_likes() -> None:
    bench = Bench(lockstep=True).brought_to(State.ACTIVE)
    assert bench.hello(nonce=1).lockstep == 1
    assert set(flags_while_silent(bench, 100)) == {(State.ACTIVE, Flag.ENABLED, Fault(0))}


def test_in_lockstep_only_the_answer_to_the_last_sample_counts() -> None:
    bench = Bench(lockstep=True).brought_to(State.ACTIVE)
    bench.sample()
    for answers in (bench.tick - 1, bench.tick + 1, NEVER):
        bench.give(Command(answers, 0, ONES, ONES, 0.0))
    assert bench.device.counts == {"old": 3} and not bench.drives
    bench.command()
    assert bench.device.answered == bench.tick and len(bench.drives) == 1


@pytest.mark.parametrize("state", State)
def test_a_host_that_is_lost(state: State) -> None:
    bench = Bench(lockstep=True).brought_to(state)
    before = bench.device.faults
    bench.device.lose_host(bench.now)
    lost = state == State.ACTIVE
    assert bench.device.state == (State.FAULT if lost else state)
    assert bench.device.faults == (Fault.WATCHDOG if lost else before)
    assert bench.cuts >= lost and bench.device.session == 0 and bench.sample() is None
    assert bench.hello(nonce=2).status == HelloStatus.WELCOME


@pytest.mark.parametrize("current", [10.0, -10.0, 6.0, 3.2, 3.0])
@pytest.mark.parametrize("time", [10.0, 2.0])
def test_warmth_trips_when_the_closed_form_says(current: float, time: float) -> None:
    bench = Bench(thermal_time=time).brought_to(State.ACTIVE)
    left = 1.0 - (3.0 / current) ** 2
    expected = -time * math.log(left) if left > 0.0 else math.inf
    currents = [0.0, 0.0, current, 0.0, 0.0, 0.0]
    report = None
    for _ in range(math.ceil(min(expected, 6.0 * time) / PERIOD * 1e9) + 2):
        bench.command(currents)
        report = bench.sample()
        if bench.device.state == State.FAULT:
            break
    assert report is not None
    if math.isinf(expected):
        assert bench.device.state == State.ACTIVE
        assert report.temperatures[2] == pytest.approx(1.0 - math.exp(-6.0), rel=1e-3)
        return
    assert (bench.now - START) * 1e-9 == pytest.approx(expected, abs=1.1 * PERIOD * 1e-9)
    assert bench.device.faults == Fault.COIL_OVERTEMP and bench.currents == ZERO
    assert report.temperatures[2] >= 1.0 > max(report.temperatures[:2] + report.temperatures[3:])
    # it is reset when it has cooled to 0.8, not before
    hot, since = report.temperatures[2], bench.now
    while bench.ask(Operation.RESET).result == Result.REFUSED:
        assert bench.device.state == State.FAULT
        bench.sample()
    assert (bench.now - since) * 1e-9 == pytest.approx(time * math.log(hot / 0.8), abs=1.1 * PERIOD * 1e-9)
    assert bench.ask(Operation.ARM).state == State.ACTIVE


@pytest.mark.parametrize(("current", "seconds"), [(10.0, 0.94), (6.0, 2.88), (3.2, 21.1)])
def test_the_closed_form_is_what_the_page_says(current: float, seconds: float) -> None:
    assert -10.0 * math.log(1.0 - (3.0 / current) ** 2) == pytest.approx(seconds, rel=4e-3)


def test_warmth_goes_by_what_flowed_between_samples() -> None:
    bench = Bench().brought_to(State.ACTIVE)
    pulse = ((0.001, (10.0,) * 6), (0.004, ZERO))
    for _ in range(100):
        bench.command()
        bench.tick += 1
        bench.now = START + bench.tick * PERIOD
        bench.conversions += 1
        reading = Reading(moving(bench.tick), 7, ZERO, ZERO, pulse, bench.conversions)
        bench.device.sample(bench.tick, bench.now, reading)
    mean = (10.0 / 3.0) ** 2 / 5.0
    report = bench.sample()
    assert report is not None and report.temperatures[0] == pytest.approx(mean * (1.0 - math.exp(-0.05)), rel=2e-3)


def test_a_dead_coil_is_found_in_three_samples() -> None:
    bench = Bench().brought_to(State.ACTIVE)
    for count in range(3):
        bench.command()
        assert bench.device.state == State.ACTIVE, count
        bench.sample(measured=[*ONES[:5], 0.0])
    bench.refuses(Fault.COIL_NOT_FOLLOWING)


@pytest.mark.parametrize("found", [NAN, INF, -1.4, -0.6])
def test_a_coil_that_does_something_else_is_found(found: float) -> None:
    bench = Bench().brought_to(State.ACTIVE)
    for _ in range(3):
        bench.command()
        bench.sample(measured=[*ONES[:5], found])
    bench.refuses(Fault.COIL_NOT_FOLLOWING)


def test_coils_may_be_a_little_off_and_twice_much() -> None:
    bench = Bench().brought_to(State.ACTIVE)
    for tick in range(60):
        bench.command()
        bench.sample(measured=[0.66, 1.34, 1.0, 0.0 if tick % 3 else -1.0, -1.0, -1.0])
    assert bench.device.state == State.ACTIVE


@pytest.mark.parametrize("diode", [0, 1, 2])
def test_an_invalid_diode_is_found_at_once(diode: int) -> None:
    bench = Bench().brought_to(State.ACTIVE)
    bench.command()
    report = bench.sample(valid=7 & ~(1 << diode))
    assert report is not None and report.valid == 7 & ~(1 << diode)
    bench.refuses(Fault.SENSOR_OUT_OF_RANGE)


@pytest.mark.parametrize("spot", [0.0121, -0.0121, NAN, INF, -INF])
@pytest.mark.parametrize("place", range(6))
def test_a_spot_off_its_diode_is_found_at_once(spot: float, place: int) -> None:
    bench = Bench().brought_to(State.ACTIVE)
    bench.command()
    spots = moving(0)
    spots[place] = spot
    bench.sample(spots=spots)
    bench.refuses(Fault.SENSOR_OUT_OF_RANGE)


@pytest.mark.parametrize("diode", [0, 1, 2])
def test_a_stuck_diode_is_found(diode: int) -> None:
    bench = Bench().brought_to(State.ACTIVE)
    first = 2 * diode
    stuck = moving(0)[first : first + 2]
    count = 0
    while bench.device.state == State.ACTIVE:
        bench.command()
        spots = moving(bench.tick + 1)
        spots[first : first + 2] = stuck
        bench.sample(spots=spots)
        count += 1
        assert count < 60
    assert count == 31  # the first, and thirty like it
    bench.refuses(Fault.SENSOR_FROZEN)


@pytest.mark.parametrize("frozen", [3, 20])
def test_three_stuck_diodes_are_found(frozen: int) -> None:
    bench = Bench(frozen=frozen).brought_to(State.ACTIVE)
    for count in range(frozen + 1):
        assert bench.device.state == State.ACTIVE, count
        bench.command()
        bench.sample(spots=(0.001,) * 6)
    bench.refuses(Fault.SENSOR_FROZEN)


@pytest.mark.parametrize("spot", range(6))
def test_a_diode_of_which_one_coordinate_moves_is_not_stuck(spot: int) -> None:
    bench = Bench().brought_to(State.ACTIVE)
    for tick in range(60):
        bench.command()
        spots = moving(tick)
        spots[spot] = 0.001
        bench.sample(spots=spots)
    assert bench.device.state == State.ACTIVE


@pytest.mark.parametrize("coordinates", [range(6), range(0, 6, 2), range(1, 6, 2)])
def test_a_diode_that_moves_now_and_then_is_not_stuck(coordinates: Sequence[int]) -> None:
    bench = Bench().brought_to(State.ACTIVE)
    for tick in range(200):
        bench.command()
        bench.sample(spots=[0.001 + 1e-6 * (tick // 20 % 2) * (place in coordinates) for place in range(6)])
    assert bench.device.state == State.ACTIVE


@pytest.mark.parametrize("count", [0, 7, 2**32 - 1])
def test_a_conversion_counter_that_stands_is_found_at_once(count: int) -> None:
    bench = Bench().brought_to(State.ACTIVE)
    bench.command()
    bench.sample(conversions=count)
    assert bench.device.state == State.ACTIVE
    bench.command()
    report = bench.sample(conversions=count)
    assert report is not None and report.conversions == count
    bench.refuses(Fault.SENSOR_STOPPED)


def test_a_conversion_counter_may_go_round_and_leap() -> None:
    bench = Bench().brought_to(State.ACTIVE)
    for count in (5, 9, 2**32 - 1, 2**32, 3, 2, 7):
        bench.command()
        report = bench.sample(conversions=count)
        assert report is not None and (report.state, report.conversions) == (State.ACTIVE, count % 2**32)


def test_diodes_may_be_left_unwatched() -> None:
    bench = Bench(frozen=0).brought_to(State.ACTIVE)
    for tick in range(200):
        bench.command()
        bench.sample(spots=(*moving(tick)[:4], 0.001, 0.001))
    assert bench.device.state == State.ACTIVE


@pytest.mark.parametrize(
    ("step", "fault"),
    [
        (0.0049, None),
        (0.0051, Fault.FLOTOR_OVERSPEED),
        (-0.0051, Fault.FLOTOR_OVERSPEED),
        (0.0199, Fault.FLOTOR_OVERSPEED),
        (0.0201, Fault.SENSOR_OUT_OF_RANGE),
    ],
)
@pytest.mark.parametrize("steps", [1, 2, 7])
def test_a_spot_that_jumps(step: float, fault: Fault | None, steps: int) -> None:
    # By so much for each period, of which some had no sample.
    bench = Bench(watchdog=1.0, spot_limit=0.1).brought_to(State.ACTIVE)
    for place in (-0.5 * step * steps, 0.5 * step * steps):
        bench.command()
        bench.sample(spots=[*ZERO[:3], place, *ZERO[:2]], steps=steps)
    if fault is None:
        assert bench.device.state == State.ACTIVE
    else:
        bench.refuses(fault)


@pytest.mark.parametrize("place", range(6))
def test_each_spot_may_jump(place: int) -> None:
    bench = Bench().brought_to(State.ACTIVE)
    for spot in (-0.003, 0.003):
        bench.command()
        spots = moving(bench.tick)
        spots[place] = spot
        bench.sample(spots=spots)
    bench.refuses(Fault.FLOTOR_OVERSPEED)


@pytest.mark.parametrize("state", [State.INACTIVE, State.FAULT])
def test_a_device_that_nobody_flies_may_be_opened(state: State) -> None:
    bench = Bench().brought_to(state)
    before = bench.device.faults
    for spots in (ZERO, (0.01,) * 6, (NAN,) * 6):
        for _ in range(50):
            bench.sample(spots=spots, valid=3, conversions=4, enabled=False)
    assert (bench.device.state, bench.device.faults) == (state, before)
    assert not bench.toggles


OFF = [*((current, True) for current in (0.26, -0.26, 9.0, NAN, INF)), (0.25, False), (-0.25, False)]


@pytest.mark.parametrize("place", [0, 5])
@pytest.mark.parametrize(("current", "found"), OFF)
@pytest.mark.parametrize("state", State)
def test_a_current_that_does_not_stop_is_found_in_three_samples(
    state: State, current: float, found: bool, place: int
) -> None:
    bench = Bench().brought_to(state)
    if state == State.ACTIVE:
        bench.ask(Operation.DISARM)
    before, cuts = bench.device.faults, bench.cuts
    measured = [*ZERO]
    measured[place] = current
    for count in range(1, 6):
        if count == 2:
            bench.sample(measured=measured)
            bench.sample()  # one sample in which it is off begins the count anew
        bench.sample(measured=measured)
        assert bench.device.faults == (before | Fault.COIL_NOT_OFF if found and count >= 4 else before), count
    assert bench.cuts == cuts + 2 * found  # again at each sample while it lasts
    assert bench.ask(Operation.RESET).result == (Result.REFUSED if found else Result.DONE)
    bench.sample()
    assert bench.ask(Operation.RESET)[2:] == (Result.DONE, State.INACTIVE, 0)


def test_reset_is_refused_while_a_current_flows() -> None:
    bench = Bench().brought_to(State.FAULT)
    for current, result in (
        (0.26, Result.REFUSED),
        (NAN, Result.REFUSED),
        (-0.26, Result.REFUSED),
        (0.25, Result.DONE),
    ):
        bench.sample(measured=[*ZERO[:5], current])
        assert bench.ask(Operation.RESET).result == result, current
    assert bench.device.state == State.INACTIVE


def test_currents_of_a_flight_are_not_counted_after_it_nor_those_before() -> None:
    bench = Bench().brought_to(State.INACTIVE)
    for _ in range(2):
        bench.sample(measured=[*ZERO[:5], 2.0])
    bench.ask(Operation.ARM)
    for _ in range(2):
        bench.command()
        bench.sample(measured=[*ONES[:5], 2.0])
    bench.ask(Operation.DISARM)
    bench.sample(measured=[*ZERO[:5], 2.0])
    assert bench.device.state == State.INACTIVE
    bench.ask(Operation.ARM)
    for _ in range(2):
        bench.command()
        bench.sample(measured=[*ONES[:5], 2.0])
    assert bench.device.state == State.ACTIVE


def test_the_enable_line_lives_while_the_device_is_active_and_no_longer() -> None:
    bench = Bench().brought_to(State.INACTIVE)
    bench.sample()
    assert not bench.toggles
    bench.now += 1000
    bench.ask(Operation.ARM)
    expected = [bench.now]
    for _ in range(5):
        bench.command()
        bench.sample()
        expected.append(bench.now)
    assert bench.toggles == expected
    bench.ask(Operation.DISARM)
    bench.sample()
    bench.ask(Operation.ARM)
    expected.append(bench.now)
    bench.sample(valid=0)  # a sample step that finds a fault leaves it as it is
    bench.sample()
    assert bench.toggles == expected and bench.device.state == State.FAULT


def test_a_board_that_is_open_twice_is_the_watchdog() -> None:
    bench = Bench().brought_to(State.ACTIVE)
    for enabled in (False, True, False):
        bench.command()
        report = bench.sample(enabled=enabled)
        assert report is not None and (report.state, report.flags) == (State.ACTIVE, Flag.ENABLED * enabled)
    bench.command()
    bench.sample(enabled=False)
    bench.refuses(Fault.WATCHDOG)


def test_nothing_is_held_where_something_is_wrong() -> None:
    bench = Bench().brought_to(State.ACTIVE)
    flags_while_silent(bench, 2)
    bench.sample(valid=0)
    assert not bench.drives
    bench.refuses(Fault.SENSOR_OUT_OF_RANGE)


def test_what_was_seen_before_arming_is_no_fault_of_the_flight() -> None:
    bench = Bench().brought_to(State.INACTIVE)
    bench.sample(spots=(0.011,) * 6)
    bench.ask(Operation.ARM)
    bench.command()
    bench.sample(spots=(-0.011,) * 6)
    assert bench.device.state == State.ACTIVE


def test_a_request_is_done_once_and_answered_each_time() -> None:
    bench = Bench().brought_to(State.ACTIVE)
    bench.ask(Operation.TRIP)
    assert bench.ask(Operation.RESET).state == State.INACTIVE
    reset = Control(bench.request, Operation.RESET, 0, ZERO)
    assert bench.ask(Operation.ARM).state == State.ACTIVE
    arm = Control(bench.request, Operation.ARM, 0, HOVER)
    bench.ask(Operation.TRIP)
    answers = [bench.give(Control(bench.request, Operation.TRIP, 0, ZERO)) for _ in range(3)]
    assert answers == [(bench.request, Operation.TRIP, Result.DONE, State.FAULT, Fault.HOST)] * 3
    cuts = bench.cuts
    assert bench.give(arm) is None and bench.give(reset) is None  # those are over
    assert bench.device.counts == {"old": 2} and bench.cuts == cuts
    assert bench.device.state == State.FAULT


def test_a_refused_request_stays_refused() -> None:
    bench = Bench().brought_to(State.FAULT)
    bench.ask(Operation.ARM)
    arm = Control(bench.request, Operation.ARM, 0, HOVER)
    bench.device.state, bench.device.faults = State.INACTIVE, Fault(0)
    assert bench.give(arm)[2:] == (Result.REFUSED, State.INACTIVE, 0)
    assert bench.ask(Operation.ARM)[2:] == (Result.DONE, State.ACTIVE, 0)


def test_the_first_request_of_a_session_has_any_number_and_they_go_round() -> None:
    bench = Bench().brought_to(State.INACTIVE)
    bench.request = 2**32 - 3
    for operation in (Operation.ARM, Operation.DISARM):
        assert bench.ask(operation).result == Result.DONE
    bench.request = -1
    assert bench.ask(Operation.ARM).state == State.ACTIVE


def test_another_operation_under_the_last_request_is_neither_done_nor_the_end() -> None:
    bench = Bench().brought_to(State.ACTIVE)
    for operation in (Operation.BYE, Operation.DISARM):
        answer = bench.give(Control(bench.request, operation, 0, ZERO))
        assert answer == (bench.request, Operation.ARM, Result.DONE, State.ACTIVE, 0)
    assert bench.device.session == 101 and bench.device.state == State.ACTIVE


def test_bye_ends_the_session_and_switches_off() -> None:
    bench = Bench().brought_to(State.ACTIVE)
    bench.command()
    assert bench.ask(Operation.BYE)[2:] == (Result.DONE, State.INACTIVE, 0)
    assert bench.last.session == 101 and bench.currents == ZERO
    assert bench.give(Control(bench.request, Operation.BYE, 0, ZERO), session=101) is None
    assert bench.device.counts == {"session": 1}
    assert bench.hello(nonce=1).status == HelloStatus.WELCOME and bench.last.session == 102


def test_a_clock_that_lags_behind_a_command_makes_no_negative_age() -> None:
    bench = Bench().brought_to(State.ACTIVE)
    bench.now += 7_000_000
    bench.command()
    report = bench.sample()
    assert report is not None and report.age == 0


def test_age_has_an_end() -> None:
    bench = Bench(lockstep=True).brought_to(State.ACTIVE)
    bench.command()
    bench.tick = 10**6
    report = bench.sample()
    assert report is not None and report.age == NEVER - 1


def test_counts_name_the_codecs_reasons_too() -> None:
    bench = Bench()
    assert bench.device.receive(b"no frame", 0, "host") is None
    assert bench.codec.dropped == Counter(magic=1)
