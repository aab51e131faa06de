"""Settings changed in flight: checked in another process before they take effect."""

from __future__ import annotations

import math
import os
import re
import signal
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from maglev_mj import cli
from maglev_mj.bridge import RemotePlant, Twin, TwinParameters
from maglev_mj.bridge.connection import Connection
from maglev_mj.bridge.flight import Flight
from maglev_mj.bridge.flight_guards import delay_limit
from maglev_mj.bridge.preflight import LinkReport, check_change, measure_link
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.cli import bridge
from maglev_mj.cli.peripherals import PageOptions
from maglev_mj.errors import MaglevError
from maglev_mj.process import NICE, SideAnswers
from maglev_mj.scenes import Scene
from maglev_mj.scenes.interactive import Joystick
from maglev_mj.session import REPLACED, UNKNOWN, ChangeRequest, Snapshot
from tests.bridge.impaired import ImpairedLine, Impairment

GOOD, STIFF, SLOW = Joystick(stiffness=4000.0), Joystick(stiffness=60_000.0), Joystick(stiffness=10_000.0)


# the process


def _deed(word: str) -> Any:
    if word == "end":
        os._exit(3)
    if word == "where":
        return os.getpid(), os.nice(0)
    if word == "fail":
        raise MaglevError("no such wall")
    while word.startswith("wait") and not Path(word.removeprefix("wait")).exists():
        time.sleep(0.001)
    return word.upper()


def answered(answers: SideAnswers) -> Any:
    """Return the next answer."""
    while (found := answers.answer()) is None:
        time.sleep(0.001)
    return found


@pytest.mark.machine
@pytest.mark.needs("linux")
def test_the_check_runs_in_a_process_of_lower_priority() -> None:
    with closing(SideAnswers(_deed, "no")) as answers:
        answers.ask("where")
        process, niceness = answered(answers)
        assert process != os.getpid() and niceness == min(os.nice(0) + NICE, 19)


@pytest.mark.machine
def test_only_the_newest_request_is_answered(tmp_path: Path) -> None:
    with closing(SideAnswers(_deed, "no")) as answers:
        assert answers.answer() is None
        answers.ask("a")
        assert answered(answers) == "A" and answers.answer() is None
        for question in (f"wait{tmp_path / 'end'}", "c", "d"):
            answers.ask(question)
            assert answers.answer() is None
        (tmp_path / "end").touch()
        assert answered(answers) == "D"
        answers.ask("fail")
        with pytest.raises(MaglevError, match="no such wall"):
            answered(answers)
        answers.ask("e")
        assert answered(answers) == "E"
        answers.ask("end")
        for _ in range(2):
            with pytest.raises(MaglevError, match="no: its process has ended"):
                answered(answers)
            answers.ask("f")


@pytest.mark.machine
def test_a_late_answer_is_not_taken_for_the_next_request() -> None:
    with closing(SideAnswers(_deed, "no")) as answers:
        answers.ask("first")
        assert answered(answers)
        answers._timeout = 0.0
        answers.ask("a")
        with pytest.raises(MaglevError, match="no: timeout after 0 s"):
            answered(answers)
        assert answers.line.poll(600.0) and answers.answer() is None
        answers.ask("a")
        with pytest.raises(MaglevError, match="no: timeout after 0 s"):
            answered(answers)
        answers._timeout = 600.0
        answers.ask("b")
        assert answered(answers) == "B"


# the flight, in virtual time


class Judge:
    """Judge in this process; answers after some polls."""

    def __init__(self, report: LinkReport, anyway: bool = False, looks: int = 5) -> None:
        self._how: dict[str, Any] = {"report": report, "anyway": anyway}
        self._looks, self.asked = looks, list[Any]()

    def ask(self, *question: Any) -> None:
        self.asked.append(question)
        self._left = self._looks

    def answer(self) -> Any:
        self._left -= 1
        return check_change(*self.asked[-1], **self._how) if self._left < 0 else None


class Wishes:
    """Publisher of requests, each after some polls of the flight; stores snapshots and answers."""

    def __init__(self, wishes: Sequence[tuple[int, Scene]]) -> None:
        self._wishes, self._looks = dict(wishes), 0
        self.answers: list[int | str] = []
        self.snapshots: list[Snapshot] = []

    def take(self) -> ChangeRequest | None:
        if not self.snapshots:  # takeoff
            return None
        self._looks += 1
        scene = self._wishes.get(self._looks)
        return None if scene is None else ChangeRequest(scene, self.answers.append)

    def show(self, snapshot: Snapshot) -> None:
        self.snapshots.append(snapshot)

    def close(self) -> None: ...


def device(way: float = 0.00025) -> RemotePlant:
    return RemotePlant(VirtualLink(Twin(TwinParameters(), draw=lambda: 7), ImpairedLine(Impairment(delay=way))))


Fly = Callable[..., tuple[Flight, Wishes, Any]]


@pytest.fixture
def fly(monkeypatch: pytest.MonkeyPatch) -> Fly:
    """Return a function that flies with requests."""
    monkeypatch.setattr("maglev_mj.session.snapshot.FrameClock.__call__", lambda _: True)

    def run(*wishes: tuple[int, Scene], make: Callable[[LinkReport], Any] = Judge) -> tuple[Flight, Wishes, Any]:
        asks = Wishes(wishes)
        with device() as plant:
            check = make(measure_link(plant, 0.2))
            scene = Joystick(period=plant.period, delay=plant.delay)
            flown = Flight(plant, scene, publishers=[asks], check=check, critical_delay=0.0027)
            assert flown.run(0.6).landing.at_rest and not flown.reason
        return flown, asks, check

    return run


def test_settings_unstable_at_the_measured_delay_are_refused_as_before_takeoff(fly: Fly) -> None:
    says = "joystick is stable up to a loop delay of 1.40 ms, but 5 % of the answers exceed 2.00 ms"
    flown, asks, _ = fly((20, SLOW))
    assert [says in str(answer) for answer in asks.answers] == [True]
    assert says in asks.snapshots[-1].notes[0]  # shown to the user
    assert {one.scene for one in asks.snapshots} == {Joystick()}
    assert flown._delay_guard.limit == delay_limit(0.0027, 0.005)


def test_accepted_settings_set_the_delay_limit(fly: Fly) -> None:
    flown, asks, _ = fly((20, STIFF), (60, GOOD))
    refused, since = asks.answers
    assert isinstance(refused, str) and isinstance(since, int)
    assert asks.snapshots[-1].scene == GOOD and asks.snapshots[-1].since == since
    assert flown._delay_guard.limit == pytest.approx(0.003749077, rel=1e-6)
    assert "stable" not in asks.snapshots[-1].notes[0]


def test_anyway_flies_it_with_a_warning_and_twice_the_planned_delay(fly: Fly) -> None:
    flown, asks, _ = fly((20, SLOW), make=lambda report: Judge(report, anyway=True))
    assert asks.snapshots[-1].scene == SLOW and isinstance(asks.answers[0], int)
    assert asks.snapshots[-1].notes[0].startswith("warning: joystick is stable up to a loop delay of 1.40 ms")
    assert flown._delay_guard.limit == pytest.approx(2.0 * (0.0015 + 1.5 * 0.0005), rel=1e-3)


def test_a_newer_request_replaces_a_pending_one(fly: Fly) -> None:
    # A held key repeats its request, which is checked once.
    _, asks, check = fly((20, STIFF), (22, GOOD), (24, GOOD), (25, GOOD))
    assert [scene.stiffness for scene, *_ in check.asked] == [60_000.0, 4000.0]
    assert asks.answers[:-1] == [REPLACED] * 3 and isinstance(asks.answers[-1], int)
    assert {one.scene for one in asks.snapshots} == {Joystick(), GOOD}


def test_without_an_answer_nothing_changes(fly: Fly) -> None:
    said = f"{UNKNOWN}: its process has ended"

    class Gone(Judge):
        def answer(self) -> Any:
            raise MaglevError(said)

    flown, asks, _ = fly((20, GOOD), (40, GOOD), make=Gone)
    assert asks.answers == [said, said] and said in asks.snapshots[-1].notes
    assert {one.scene for one in asks.snapshots} == {Joystick()}
    assert flown._delay_guard.limit == delay_limit(0.0027, 0.005)


def floor(edge: float) -> Scene:
    return GOOD.replace(walls=[("z", 1, edge)], wall_on="device")


@pytest.mark.parametrize(
    ("scenes", "refused"),
    [
        ([GOOD.replace(wall_on="device")], [""]),
        ([floor(2e-4)], ["wall on z must begin clear of"]),
        ([floor(-3e-3), floor(-2.9e-3)], ["", "wall on z must keep its edge"]),
        ([floor(-3e-3), GOOD], ["", ""]),
    ],
)
def test_walls_move_to_the_device_where_it_can_render_them(
    scenes: list[Scene], refused: list[str], fly: Fly, monkeypatch: pytest.MonkeyPatch
) -> None:
    def command(connection: Connection, command: Any) -> None:
        sent.add(len(command.walls))
        send(connection, command)

    monkeypatch.setattr("maglev_mj.bridge.preflight.HANDS", ("none", "arm"))  # fewer margins: only walls are tested
    sent, send = set[int](), Connection.command
    monkeypatch.setattr(Connection, "command", command)
    _, asks, _ = fly(*zip((20, 40), scenes))
    for answer, words in zip(asks.answers, refused, strict=True):
        assert re.search(words, str(answer)) if words else isinstance(answer, int)
    accepted = {scene for scene, words in zip(scenes, refused, strict=True) if not words}
    assert {one.scene for one in asks.snapshots} == {Joystick()} | accepted
    assert sent == {0} | {len(scene.controller().device_walls) for scene in accepted}


# the command, with its process, in virtual time


class Ends(Wishes):
    """Successive requests; the last answer lands."""

    def __init__(self, *wishes: Scene) -> None:
        super().__init__([])
        self._left = list(wishes)
        self._landing = False

    def take(self) -> ChangeRequest | None:
        if not self.snapshots or self._landing:
            return None
        if len(self.answers) < self._looks:
            time.sleep(0.05)  # leave the core to the process: virtual time would run ahead
            return None
        if not self._left:
            self._landing = True
            signal.raise_signal(signal.SIGINT)
            return None
        self._looks += 1
        return ChangeRequest(self._left.pop(0), self.answers.append)


class Here:
    """Answers of this process instead of another; each at the second poll."""

    ended = False

    def __init__(self, deed: Callable[..., Any], unknown: str, timeout: float = math.inf) -> None:
        self._deed, self._found = deed, list[Any]()

    def ask(self, *question: Any) -> None:
        self._found = [self._deed(*question), None]

    def answer(self) -> Any:
        return self._found.pop() if self._found else None

    def close(self, patience: float) -> None: ...


@pytest.mark.parametrize("anyway", [False, pytest.param(True, marks=pytest.mark.study)])
@pytest.mark.parametrize(
    "answers",
    [Here, pytest.param(SideAnswers, marks=pytest.mark.machine)],
    ids=["in this process", "in another process"],
)
def test_bridge_checks_settings_in_flight(
    answers: Any, anyway: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bridge, "SideAnswers", answers)
    monkeypatch.setattr(bridge, "_ANSWER", 600.0)  # slow start of the process on a busy machine
    asks = Ends(SLOW if anyway else STIFF, GOOD)

    # instead of a window
    monkeypatch.setattr(PageOptions, "front", lambda *_, **__: print)
    monkeypatch.setattr(bridge, "RemoteViewer", lambda blank, front, watch: asks)
    monkeypatch.setattr(bridge, "_opened", lambda *_: device())
    monkeypatch.chdir(tmp_path)
    options = ["--anyway"] if anyway else []
    assert cli.main(["bridge", "udp://127.0.0.1:1", *options]) == 0
    first, second = asks.answers
    assert isinstance(first, int) if anyway else "unstable even without delay" in str(first)
    assert isinstance(second, int)
