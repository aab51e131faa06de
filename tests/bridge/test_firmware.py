"""What no host can observe of a device, and edges to the nanosecond, in Python and in C.

Rules of the protocol are those of `conform`, which `test_conform.py` has both firmwares pass.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import product
from typing import Any

import pytest

from maglev_mj.bridge.safety import Limits, Profile
from maglev_mj.bridge.twin.firmware import Reading
from maglev_mj.bridge.wire import (
    CUT,
    Codec,
    CommandFrame,
    ControlAck,
    ControlRequest,
    Fault,
    Flag,
    Frame,
    Hello,
    HelloAck,
    HelloStatus,
    Operation,
    Outcome,
    State,
    StateReport,
)
from tests.bridge.firmware_core import FIRMWARE, FIRMWARES
from tests.bridge.test_wire import tables

PERIOD, DELAY = 5_000_000, 1_500_000
START = 3_000_000_000_123  # of the device's clock: it has run for 50 minutes
CALIBRATION = bytes(range(16))
ZERO = (0.0,) * 6
ONES = (1.0, 1.0, 1.0, -1.0, -1.0, -1.0)
HOVER = (1.1, 1.1, 1.1, 0.0, 0.0, 0.0)
STOP = (*(0.5, 0.0) * 3, 0.2, 1.5)  # damped by the x of each spot
NAN, INF = math.nan, math.inf


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
        self.sequence += isinstance(body, CommandFrame)
        session = self.device.session if session is None else session
        number = sequence if sequence is not None else self.sequence * isinstance(body, CommandFrame)
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

    def ask(self, operation: int, *, faults: int = 0, stop: tuple[float, ...] = CUT) -> ControlAck:
        self.request += 1
        answer = self.give(ControlRequest(self.request, operation, faults, HOVER, stop))
        assert isinstance(answer, ControlAck)
        assert self.last.sequence == 0 and self.last.time == self.now
        return answer

    def command(self, held: Sequence[float] = ONES, pulsed: Sequence[float] = ZERO, width: float = 0.0) -> None:
        answers = max(self.tick, 0)
        assert self.give(CommandFrame(answers, 0, tuple(held), tuple(pulsed), width)) is None

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
            assert self.ask(Operation.ARM) == (self.request, Operation.ARM, Outcome.DONE, State.ACTIVE, 0)
        elif state == State.FAULT:
            assert self.ask(Operation.TRIP, faults=Fault.CLOCK).state == State.FAULT
        return self

    def has_tripped(self, fault: Fault) -> None:
        """Check a latched fault, and that nothing is driven any more."""
        assert (self.device.state, self.device.faults) == (State.FAULT, fault)
        driven = len(self.drives)
        self.command()
        self.sample()
        assert self.cuts and self.currents == ZERO and len(self.drives) == driven


@pytest.fixture(autouse=True, params=FIRMWARES)
def _firmware(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Put each firmware on the bench in turn."""
    monkeypatch.setattr(Bench, "make", staticmethod(FIRMWARE[request.param]), raising=False)


def in_controlled_stop(**options: Any) -> Bench:
    """Return a bench whose host tripped in flight."""
    bench = Bench(**options).brought_to(State.INACTIVE)
    bench.ask(Operation.ARM, stop=STOP)
    bench.command()
    bench.sample()
    bench.ask(Operation.TRIP)
    assert bench.device.stopping and bench.currents == HOVER and not bench.cuts
    return bench


def moving(tick: int) -> list[float]:
    """Return spots that change at each sample, as with noise."""
    return [1e-3 + 1e-6 * (tick % 2 + place) for place in range(6)]


def test_what_leads_away_from_flying_cuts_and_no_operation_drives() -> None:
    head, *rows = tables("| operation | INACTIVE |")
    for state, operation in product(State, [*Operation, 0, 255]):
        name = Operation(operation).name if operation in [*Operation] else "other"
        (row,) = [row for row in rows if row[0] == name]
        result, _, after = row[head.index(state.name)].partition(": ")
        bench = Bench().brought_to(state)
        cuts = bench.cuts
        answer = bench.ask(operation, faults=Fault.BOUNDARY)
        assert answer == (bench.request, operation, Outcome[result], State[after], bench.device.faults)
        left = state == State.ACTIVE and State[after] != State.ACTIVE
        assert (bench.cuts > cuts) == (operation == Operation.TRIP or left), (state, name)
        assert not bench.drives


def flags_while_silent(bench: Bench, samples: int) -> list[tuple[State, Flag, Fault]]:
    found = []
    for _ in range(samples):
        report = bench.sample()
        assert report is not None
        found.append((State(report.state), Flag(report.flags), Fault(report.faults)))
    return found


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
    for operation in (None, Operation.BYE):
        bench = in_controlled_stop(lockstep=True)
        bench.ask(operation) if operation else bench.device.lose_host(bench.now)
        assert bench.cuts and bench.currents == ZERO and not bench.device.stopping


@pytest.mark.parametrize(
    ("fault", "samples", "reading"),
    [
        (Fault.SENSOR_OUT_OF_RANGE, 1, {"valid": 5}),
        (Fault.FLOTOR_OVERSPEED, 1, {"spots": [0.009] * 6}),
        (Fault.SENSOR_FROZEN, 31, {"spots": [1e-3] * 6}),
        (Fault.SENSOR_STOPPED, 1, {"conversions": 2}),
        (Fault.COIL_NOT_FOLLOWING, 3, {"measured": ONES}),
        (Fault.WATCHDOG, 2, {"enabled": False}),
        (Fault.COIL_OVERTEMP, 1, {"currents": (200.0,) * 6}),
    ],
)
def test_each_guard_cuts_during_a_controlled_stop(fault: Fault, samples: int, reading: dict[str, Any]) -> None:
    bench = in_controlled_stop()
    for count in range(samples):
        assert bench.device.stopping, count
        report = bench.sample(**reading)
    assert report is not None and report.flags & Flag.STOPPING  # its currents were measured before the cut
    assert not bench.device.stopping
    bench.has_tripped(Fault.HOST | fault)


@pytest.mark.parametrize("steps", [1, 3])
def test_a_controlled_stop_damps_the_motion_within_its_bounds(steps: int) -> None:
    bench, before = in_controlled_stop(), 1e-3
    bench.sample(spots=[before, 0.0] * 3)
    for speed in (0.1, -0.1, -0.5, 0.9):
        spot = before + speed * steps * 0.005
        bench.sample(spots=[spot, 1e-6 * bench.tick] * 3, steps=steps)
        elapsed = (bench.now - START) * 1e-9 - bench.period * 1e-9
        scale = min(max(1.0 - elapsed / 0.2 - 1.5 * speed, 0.0), 1.5)
        assert bench.currents == pytest.approx([scale * current for current in HOVER], abs=1e-9)
        before = spot


def test_a_device_that_nobody_flies_may_be_opened() -> None:
    for state in (State.INACTIVE, State.FAULT):
        bench = Bench().brought_to(state)
        before = bench.device.faults
        for spots in (ZERO, (0.01,) * 6, (NAN,) * 6):
            for _ in range(50):
                bench.sample(spots=spots, valid=3, conversions=4, enabled=False)
        assert (bench.device.state, bench.device.faults) == (state, before) and not bench.toggles


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


@pytest.mark.parametrize(
    ("period", "stale", "lockstep", "behind", "late"),
    [
        (5_000_000, None, False, 4, 0),  # four periods, where nothing else is said
        (15_000_000, None, False, 3, 5_000_000),  # and no longer than the watchdog's 50 ms
        (5_000_000, 0.05, False, 10, 0),
        (5_000_000, 0.012, False, 2, 2_000_000),
        (5_000_000, 0.012, False, 0, 12_000_000),  # where no sample came since
        (7_000_000, 0.007, False, 1, 0),
        (5_000_000, None, True, 0, 3_600_000_000_000),  # in lockstep time stands still
    ],
)
def test_an_answer_is_obeyed_until_its_sample_is_stale(
    period: int, stale: float | None, lockstep: bool, behind: int, late: int
) -> None:
    bench = Bench(period=period, stale=stale, lockstep=lockstep).brought_to(State.INACTIVE)
    for _ in range(20):
        bench.sample()
    bench.ask(Operation.ARM)
    at, last = bench.now, bench.tick
    for answers, now, taken in (
        (last - behind, at + late, 1),
        (last, at, 2),
        (last - behind, at + late + 1, 2 + lockstep),
        (last - behind - 1, at + late, 2 + lockstep),
        (last + 1, at, 2 + lockstep),
    ):
        bench.now = now
        bench.give(CommandFrame(answers, 0, ONES, ONES, 0.0))
        assert len(bench.drives) == taken, (answers, now)
    assert bench.device.counts == {"old": 3 - lockstep}


@pytest.mark.parametrize("pulse", [False, True])
def test_the_edges_of_a_command(pulse: bool) -> None:
    for current, width, fault in (
        *((10.0, width, Fault(0)) for width in (0.0, -0.0, 5e-324, 1.0)),
        *((current, 0.001, Fault(0)) for current in (-10.0, 10.0 * (1.0 + 1e-10))),
        *((current, 0.001, Fault.COIL_OVERCURRENT) for current in (10.0 * (1.0 + 1e-8), -10.1, 1e308)),
        *((10.0, width, Fault.INVALID_COMMAND) for width in (-1e-9, 1.0 + 1e-9, 1e308, NAN, -INF)),
    ):
        bench = Bench().brought_to(State.ACTIVE)
        edge = (*ZERO[:4], current, current)  # the sum of two that are huge is infinite
        bench.command(ZERO if pulse else edge, edge if pulse else ZERO, width)
        assert len(bench.drives) == (not fault) and bench.device.faults == fault, (current, width)


def test_a_command_a_cut_and_a_trip_end_the_hold() -> None:
    bench = Bench().brought_to(State.ACTIVE)
    for end in (bench.command, lambda: bench.ask(Operation.DISARM), lambda: bench.ask(Operation.TRIP)):
        driven = len(bench.drives)
        assert flags_while_silent(bench, 4)[-1][1] & Flag.HOLDING
        assert bench.drives[driven:] == [(HOVER, None, 0.0)]  # once
        end()
        report = bench.sample()
        assert report is not None and report.flags == Flag.ENABLED
        bench.ask(Operation.ARM)


def test_reset_is_refused_in_inactive_while_a_coil_is_warm() -> None:
    bench = Bench().brought_to(State.ACTIVE)
    while (report := bench.sample(currents=(8.0,) * 6)) is None or report.temperatures[0] < 0.85:
        bench.command((8.0,) * 6)
    bench.ask(Operation.DISARM)
    bench.sample()
    assert bench.ask(Operation.RESET)[2:] == (Outcome.REFUSED, State.INACTIVE, 0)
    assert bench.ask(Operation.ARM).result == Outcome.DONE  # it is warm, not too warm


def test_nothing_is_held_where_something_is_wrong() -> None:
    bench = Bench().brought_to(State.ACTIVE)
    flags_while_silent(bench, 2)
    bench.sample(valid=0)
    assert not bench.drives
    bench.has_tripped(Fault.SENSOR_OUT_OF_RANGE)


@pytest.mark.parametrize(
    ("limits", "reading"),
    [
        ({}, lambda tick: {"measured": [0.66, 1.34, 1.0, 0.0 if tick % 3 else -1.0, -1.0, -1.0]}),
        ({}, lambda tick: {"spots": [1e-3, *moving(tick)[1:]]}),
        ({"frozen": 0}, lambda tick: {"spots": (1e-3,) * 6}),
        ({}, lambda tick: {"spots": [0.0024 * (-1) ** tick] * 6}),
        ({}, lambda tick: {"conversions": (2**32 - 1, 2**32, 3, 2)[tick % 4]}),
        ({}, lambda tick: {"enabled": tick % 2}),
    ],
    ids=["coils a little off", "a coordinate", "without noise", "fast", "counter", "board"],
)
def test_what_is_no_fault_of_a_flight(limits: dict[str, Any], reading: Callable[[int], dict[str, Any]]) -> None:
    bench = Bench(**limits).brought_to(State.INACTIVE)
    bench.sample(spots=(0.011,) * 6)  # seen before arming
    bench.ask(Operation.ARM)
    for tick in range(60):
        bench.command()
        values = reading(tick)
        report = bench.sample(**values)
        assert report is not None and (report.state, report.faults) == (State.ACTIVE, 0)
        assert report.conversions == values.get("conversions", bench.conversions) % 2**32
        assert report.flags == Flag.ENABLED * values.get("enabled", True)


@pytest.mark.parametrize(("current", "found"), [(0.26, True), (-0.26, True), (NAN, True), (0.25, False)])
@pytest.mark.parametrize("state", State)
def test_a_current_that_does_not_stop_is_found_in_three_samples(state: State, current: float, found: bool) -> None:
    bench = Bench().brought_to(state)
    if state == State.ACTIVE:
        bench.ask(Operation.DISARM)
    before, cuts = bench.device.faults, bench.cuts
    measured = [*ZERO[:5], current]
    for count in range(1, 6):
        if count == 2:
            bench.sample(measured=measured)
            bench.sample()  # one sample in which it is off begins the count anew
        bench.sample(measured=measured)
        assert bench.device.faults == (before | Fault.COIL_NOT_OFF if found and count >= 4 else before), count
    assert bench.cuts == cuts + 2 * found  # again at each sample while it lasts
    assert bench.ask(Operation.RESET).result == (Outcome.REFUSED if found else Outcome.DONE)
    bench.sample()
    assert bench.ask(Operation.RESET)[2:] == (Outcome.DONE, State.INACTIVE, 0)
