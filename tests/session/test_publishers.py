"""Publishers: snapshots and settings of other programs, in a session and in a flight."""

import inspect
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj import cli
from maglev_mj.bridge import RemotePlant, Twin, TwinParameters
from maglev_mj.bridge.flight import Flight
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.control.laws.base import as_law
from maglev_mj.recording import Recording, RecordingError, open_recording
from maglev_mj.scenes import Scene
from maglev_mj.scenes.interactive import Box, Joystick
from maglev_mj.session import ChangeRequest, Publishers, Snapshot
from tests.bridge.impaired import ImpairedLine, Impairment


def test_outlets_are_told_sixty_times_a_second_and_asked_every_tick() -> None:
    class Told:
        waiting: Any = None

        def take(self) -> Any:
            taken, self.waiting = self.waiting, None
            return taken

        def __init__(self) -> None:
            self.snapshots: list[Snapshot] = []

        def show(self, snapshot: Snapshot) -> None:
            self.snapshots.append(snapshot)

        def close(self) -> None:
            self.closed = True

    now, made, told = 0.0, 0, [Told(), Told()]
    publishers = Publishers(told, clock=lambda: now)
    scene = Box()

    def snapshot() -> Snapshot:
        nonlocal made
        made += 1
        return Snapshot(scene=scene, time=now)

    for tick in range(2001):
        now = tick * 5e-4
        publishers.show(snapshot)
    assert made == len(told[0].snapshots) == len(told[1].snapshots)
    assert 60 <= made <= 62
    gaps = [after.time - before.time for before, after in zip(told[0].snapshots, told[0].snapshots[1:], strict=False)]
    assert max(gaps) - min(gaps) < 1e-3
    now += 5.0  # a pause is not made up for
    for _ in range(10):
        publishers.show(snapshot)
        now += 1e-4
    assert made <= 63
    told[1].waiting = ChangeRequest(scene)
    assert publishers.wanted() == ChangeRequest(scene) and publishers.wanted() is None
    publishers.close()
    assert told[0].closed and told[1].closed


class Asks:
    """Publisher that requests settings and keeps the answers."""

    def __init__(self, *wanted: Scene) -> None:
        self._waiting, self._asked = list(wanted), False
        self.answers: list[int | str] = []
        self.snapshots: list[Snapshot] = []

    def take(self) -> ChangeRequest | None:
        asked, self._asked = self._asked, False
        return ChangeRequest(self._waiting.pop(0), self.answers.append) if asked else None

    def show(self, snapshot: Snapshot) -> None:
        self.snapshots.append(snapshot)
        if self._waiting and len(self.snapshots) % 3 == 0:
            self._asked = True

    def close(self) -> None: ...


def flight(**options: Any) -> tuple[Flight, RemotePlant]:
    """Return a flight on a virtual twin."""
    line = ImpairedLine(Impairment(jitter=0.001))
    plant = RemotePlant(VirtualLink(Twin(TwinParameters(), draw=lambda: 7), line))
    return Flight(plant, Joystick(period=plant.period, delay=plant.delay), **options), plant


def slow() -> Callable[[], float]:
    """Return a clock of one frame per call."""
    now = iter(range(10**9))
    return lambda: next(now) / 60.0


def test_a_flight_is_recorded_through_changes_as_one_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # Settings from outside: what is missed and when counts on from change to change, for a device does.
    monkeypatch.setattr(inspect.unwrap(Publishers.__init__), "__defaults__", ((), slow()))
    wishes = [Joystick(friction=True), Joystick(stiffness=4000.0)]
    asks, file = Asks(*wishes), open_recording(tmp_path / "run.maglev")
    flown, plant = flight(publishers=[asks], file=file)
    with plant:
        flown.run(0.5)
    file.close()
    recording = Recording.load(tmp_path / "run.maglev")
    assert [segment.setup["parameters"]["friction"] for segment in recording.segments] == [False, True, False]
    ticks = np.concatenate([segment.tick for segment in recording.segments])
    assert (np.diff(ticks) >= 1).all() and ticks[0] > 100  # it counts from takeoff on
    for before, after in zip(asks.snapshots, asks.snapshots[1:], strict=False):
        assert after.tick - before.tick <= 3
    begun = [int(segment.tick[0]) for segment in recording.segments]
    assert asks.answers == begun[1:]
    since = [next(one.since for one in asks.snapshots if one.scene == segment) for segment in (Joystick(), *wishes)]
    assert since == begun and 1 <= since[1] - asks.snapshots[2].tick <= 3
    assert cli.main(["replay", str(tmp_path / "run.maglev"), "--check"]) == 0
    assert f"{recording.ticks} of {recording.ticks} equal: command," in capsys.readouterr().out
    assert cli.main(["analyse", str(tmp_path / "run.maglev")]) == 0


def test_settings_that_would_push_the_flotor_are_refused_in_a_flight(monkeypatch: pytest.MonkeyPatch) -> None:
    # A wall 2 mm deep, the flotor's weight, laws that fail: each is refused with why, and the flight goes on.
    monkeypatch.setattr(inspect.unwrap(Publishers.__init__), "__defaults__", ((), slow()))
    around, good = [("z", -1, -0.002)], Joystick(stiffness=3000.0)
    asks = Asks(Joystick(walls=around), good, Unmade(), Failing(period=0.005, delay=0.0015))
    flown, plant = flight(publishers=[asks])
    with plant:
        assert flown.run(0.6).ticks == 120
    wall, tick, unmade, failing = asks.answers
    pushed = re.fullmatch(r"force step on z at the present pose must be at most 2 N \(got -(.*) N\)", str(wall))
    assert pushed and float(pushed[1]) == pytest.approx(12.0, abs=0.5)
    assert "law broken raises ValueError: no" in str(failing)
    assert unmade == "parameters rejected: ValueError: never"
    assert asks.snapshots[-1].scene == good and asks.snapshots[-1].since == tick
    assert any(wall in one.notes for one in asks.snapshots) and failing in asks.snapshots[-1].notes
    asks = Asks(Joystick(walls=around, stiffness=1000.0))
    flown, plant = flight(publishers=[asks], step_force=2.5)
    with plant:
        flown.run(0.3)
    assert asks.answers == [asks.snapshots[-1].since]


def broken(position: Any, velocity: Any) -> Any:
    raise ValueError("no")


class Unmade(Joystick):
    """Scene with laws that cannot be made."""

    def own_laws(self) -> Any:
        raise ValueError("never")


class Failing(Joystick):
    """Scene with a failing law."""

    def own_laws(self) -> Any:
        return [*super().own_laws(), as_law(broken)]


def test_mass_period_and_delay_of_settings_are_the_devices(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inspect.unwrap(Publishers.__init__), "__defaults__", ((), slow()))
    asks = Asks(Joystick(stiffness=3000.0, period=0.001, delay=0.01))
    flown, plant = flight(publishers=[asks])
    with plant:
        assert flown.run(0.3).ticks == 60
    last, known = asks.snapshots[-1], plant.calibration
    assert last.scene == Joystick(stiffness=3000.0, period=plant.period, delay=plant.delay)
    assert asks.answers == [last.since] and last.inertia == [*[known.mass] * 3, *known.inertia]


def test_the_delay_that_is_told_is_the_usual_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inspect.unwrap(Publishers.__init__), "__defaults__", ((), slow()))
    asks = Asks()
    flown, plant = flight(publishers=[asks])
    measured: list[tuple[int, float]] = []
    with plant:
        read = plant.read

        def noted() -> Any:
            sample = read()
            measured.append((sample.tick, plant.last_delay))
            return sample

        monkeypatch.setattr(plant, "read", noted)
        flown.run(0.7)
    last = [delay for tick, delay in measured if tick < asks.snapshots[-1].tick and delay == delay][-100:]
    assert asks.snapshots[-1].delay == pytest.approx(np.median(last), abs=2e-5)
    assert plant.delay + 1e-4 < np.median(last) < max(last) - 1e-4


def full(_: bytes) -> None:
    raise OSError(28, "No space left on device")


def test_a_flight_whose_recording_ends_says_so_and_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    file: Any = open_recording(tmp_path / "run.maglev")
    flown, plant = flight(file=file, warn=said.append)
    monkeypatch.setattr(file._journal, "_write", full)
    file.event("timing", "for a test")
    file._journal._thread.join()
    with plant:
        assert flown.run(0.5).ticks == 100
    assert len(said) == 1 and "has stopped: No space left on device" in said[0]
    with pytest.raises(RecordingError):
        file.close()
