"""Live server and 3D mouse on a device.

With their options.
"""

import re
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from inspect import CO_OPTIMIZED
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from live_client import LiveClient, reader
from maglev_mj import theory
from maglev_mj.bridge import RemotePlant, Twin, TwinParameters
from maglev_mj.bridge.flight import Flight
from maglev_mj.bridge.landing import StopSwitch
from maglev_mj.bridge.twin.simulated_links import Impairment, VirtualLink
from maglev_mj.control.laws.base import as_law
from maglev_mj.interop.foxglove import LiveServer
from maglev_mj.recording import Recording, RecordingError, open_recording
from maglev_mj.scenes import Scene
from maglev_mj.scenes.rooms import Box, Joystick
from maglev_mj.session import ChangeRequest, Publishers, Session, Snapshot, unstable_loop
from tests.processes import PATIENCE, ended, said_by, started, twin


@pytest.mark.machine
def test_a_device_is_seen_set_and_recorded_by_other_programs(tmp_path: Path) -> None:
    # A wall on the wire is refused or taken; what was flown is in the file with both settings.
    record = tmp_path / "run.mcap"
    publishers = ("--foxglove", "0")
    with twin("--watchdog", "1") as (device, address):
        options = ("--scene", "table", "--record", str(record), "--out", str(tmp_path), *publishers)
        with started("bridge", address, "--as-written", "--anyway", *options) as host:
            with LiveClient(host.wait_for(r"ws://[\d.:]+"), {"/maglev/sample"}) as client:
                while client.parameters().get("state") != "flying":
                    time.sleep(0.1)
                wall = {"wall": True, "walls": [["z", 1, -0.001]]}
                end = time.monotonic() + PATIENCE  # the delay is told once it has been measured
                while time.monotonic() < end:
                    refused = client.set(**wall, stiffness=40000.0)
                    if refused["figures"]["delay"] > 0.0015 + 1e-4:
                        break
                assert refused["figures"]["modulus"] > 1.0 and refused["figures"]["delay"] > 0.0015 + 1e-4
                accepted = client.set(**wall, stiffness=2000.0)
                assert accepted["since"] is not None and not accepted["reason"]
                ticks = [message.fields.tick for message in client.messages(0.5)]
                assert abs(next(client.messages(PATIENCE)).fields.position.z) < 1e-3
            assert host.end().status == 0
        assert not (tmp_path / "s").exists()
        assert "inactive, faults: none" in ended(device)[1]
    recording = Recording.load(record)
    before, after = (stretch.setup["parameters"] for stretch in recording.stretches)
    assert (before["stiffness"], before["walls"]) == (6000.0, None)
    assert (after["stiffness"], after["walls"]) == (2000.0, [["z", 1, -0.001]])
    assert recording.stretches[1].tick[0] == accepted["since"]
    kept = np.concatenate([stretch.tick for stretch in recording.stretches])
    assert ticks and set(ticks) <= set(kept.astype(int))
    status, said_again = said_by("replay", str(record), "--check")
    assert status == 0 and f"{recording.ticks} of {recording.ticks} the same: command," in said_again
    assert said_by("analyse", str(record))[0] == 0


@pytest.mark.machine
def test_a_twin_shows_its_true_pose_and_its_faults() -> None:
    # It lies on its stop, nothing can be set there, and an emergency stop is logged.
    with started("twin", "--foxglove", "0", "--listen", "udp://127.0.0.1:0") as device:
        with LiveClient(device.wait_for(r"ws://[\d.:]+")) as client:
            sample = next(one.fields for one in client.messages(PATIENCE) if one.topic == "/maglev/sample")
            assert sample.position.z == pytest.approx(-0.0045, abs=1e-5) and not sample.applied.z
            assert client.parameters() == {} and client.set(wall=True)["reason"] == "no scene runs here"
            client.send({"op": "nonsense"})  # is not for the person at the terminal
            said_by("estop", device.wait_for(r"udp://[\d.:]+"))
            logged = (one.fields.message for one in client.messages(PATIENCE) if one.topic == "/log")
            assert next(line for line in logged if "fault" in line) == "fault: ESTOP"
        ended_twin = device.end()
        assert (ended_twin.status, ended_twin.errors) == (0, "")


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
    """Return a flight on a virtual twin.

    It takes off at once.
    """
    plant = RemotePlant(VirtualLink(Twin(TwinParameters(), draw=lambda: 7), Impairment(jitter=0.001)))
    return Flight(plant, Joystick(period=plant.period, delay=plant.delay), **options), plant


def slow() -> Callable[[], float]:
    """Return a clock of one frame per call.

    Virtual time does not wait.
    """
    now = iter(range(10**9))
    return lambda: next(now) / 60.0


def test_a_flight_is_recorded_through_changes_as_one_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Settings from outside: what is missed and when counts on from change to change, for a device does.
    monkeypatch.setattr(Publishers.__init__, "__defaults__", ((), slow()))
    wishes = [Joystick(friction=True), Joystick(stiffness=4000.0)]
    asks, file = Asks(*wishes), open_recording(tmp_path / "run.mcap")
    flown, plant = flight(publishers=[asks], file=file)
    with plant:
        flown.run(0.5)
    file.close()
    recording = Recording.load(tmp_path / "run.mcap")
    assert [stretch.setup["parameters"]["friction"] for stretch in recording.stretches] == [False, True, False]
    ticks = np.concatenate([stretch.tick for stretch in recording.stretches])
    assert (np.diff(ticks) >= 1).all() and ticks[0] > 100  # it counts from takeoff on
    for before, after in zip(asks.snapshots, asks.snapshots[1:], strict=False):
        assert after.tick - before.tick <= 3
    begun = [int(stretch.tick[0]) for stretch in recording.stretches]
    assert asks.answers == begun[1:]
    since = [next(one.since for one in asks.snapshots if one.scene == stretch) for stretch in (Joystick(), *wishes)]
    assert since == begun and 1 <= since[1] - asks.snapshots[2].tick <= 3
    with (tmp_path / "run.mcap").open("rb") as opened:
        read = [
            (message.log_time, reader(channel.message_encoding, schema.name, schema.data)(message.data))
            for schema, channel, message in make_reader(opened).iter_messages(topics=["/maglev/sample"])
            if schema is not None
        ]
    firsts = [next(said for _, said in read if said.stretch == place) for place in range(3)]
    assert [said.missed for said in firsts] == [0, 0, 0]
    for place in range(3):
        logged = [(when, said.tick) for when, said in read if said.stretch == place]
        for when, tick in logged:
            assert (when - logged[0][0]) * 1e-9 == pytest.approx((tick - logged[0][1]) * plant.period, abs=1e-6)


def test_settings_that_would_push_the_flotor_are_refused_in_a_flight(monkeypatch: pytest.MonkeyPatch) -> None:
    # A wall 2 mm deep, the flotor's weight, laws that fail: each is refused with why, and the flight goes on.
    monkeypatch.setattr(Publishers.__init__, "__defaults__", ((), slow()))
    around, good = [("z", -1, -0.002)], Joystick(stiffness=3000.0)
    asks = Asks(Joystick(walls=around), good, Unmade(), Failing(period=0.005, delay=0.0015))
    flown, plant = flight(publishers=[asks])
    with plant:
        assert flown.run(0.6).ticks == 120
    wall, tick, unmade, failing = asks.answers
    pushed = re.fullmatch(
        r"settings must change the force on z, where the flotor is, by at most 2 N, not -(.*) N", str(wall)
    )
    assert pushed and float(pushed[1]) == pytest.approx(12.0, abs=0.5)
    assert "law broken fails: ValueError: no" in str(failing)
    assert unmade == "the parameters are refused: ValueError: never"
    assert asks.snapshots[-1].scene == good and asks.snapshots[-1].since == tick
    assert any(wall in one.notes for one in asks.snapshots) and failing in asks.snapshots[-1].notes
    asks = Asks(Joystick(walls=around, stiffness=1000.0))
    flown, plant = flight(publishers=[asks], step_force=2.5)
    with plant:
        flown.run(0.3)
    assert asks.answers == [asks.snapshots[-1].since]


def test_period_and_delay_of_settings_are_the_devices(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Publishers.__init__, "__defaults__", ((), slow()))
    asks = Asks(Joystick(stiffness=3000.0, period=0.001, delay=0.02))
    flown, plant = flight(publishers=[asks])
    with plant:
        assert flown.run(0.3).ticks == 60
    assert asks.snapshots[-1].scene == Joystick(stiffness=3000.0, period=plant.period, delay=plant.delay)
    assert asks.answers == [asks.snapshots[-1].since]


@contextmanager
def theory_called() -> Iterator[set[str]]:
    """Yield the called functions of the theory.

    In this thread and in new ones of this process.
    """
    called, folder = set[str](), str(Path(theory.__file__).parent)

    def note(frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(folder) and code.co_flags & CO_OPTIMIZED:  # no import
            called.add(code.co_qualname)

    threading.setprofile(note)
    sys.setprofile(note)
    try:
        yield called
    finally:
        sys.setprofile(None)
        threading.setprofile(None)


def fly(live: LiveServer, switch: StopSwitch) -> None:
    flown, plant = flight(publishers=[live], file=live, switch=switch)
    with plant:
        flown.run()


def render(live: LiveServer, switch: StopSwitch) -> None:
    session = Session(publishers=[live], file=live)
    while not switch.landing:
        session.tick(0.005)
        time.sleep(0.001)


@pytest.mark.machine
@pytest.mark.parametrize("run", [fly, render])
def test_settings_are_checked_in_another_process(run: Callable[..., None], monkeypatch: pytest.MonkeyPatch) -> None:
    # No function of the theory is called where a scene runs, whether settings are refused or accepted.
    with theory_called() as called:
        unstable_loop(Joystick())
    assert "stability" in called
    answers: list[dict[str, Any]] = []
    with closing(LiveServer(0)) as live, theory_called() as called:
        switch = StopSwitch()

        def ask() -> None:
            try:
                with LiveClient(f"ws://127.0.0.1:{live.port}", set()) as client:
                    while client.parameters().get("state") not in ("flying", "running"):
                        time.sleep(0.01)
                    answers.extend(client.set(stiffness=stiffness) for stiffness in (60000.0, 3000.0))
            finally:
                switch.land()

        client = threading.Thread(target=ask)
        client.start()
        run(live, switch)
        client.join()
    refused, accepted = answers
    assert refused["figures"]["modulus"] > 1.0 and accepted["since"] is not None
    assert not called


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


def test_a_set_is_told_the_mass_of_the_device(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Publishers.__init__, "__defaults__", ((), slow()))
    asks = Asks()
    flown, plant = flight(publishers=[asks])
    with plant:
        flown.run(0.2)
    known = plant.calibration
    assert asks.snapshots[-1].inertia == [*[known.mass] * 3, *known.inertia]


def test_the_delay_that_is_told_is_the_usual_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Publishers.__init__, "__defaults__", ((), slow()))
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
        flown.run(1.5)
    last = [delay for tick, delay in measured if tick < asks.snapshots[-1].tick and delay == delay][-100:]
    assert asks.snapshots[-1].delay == pytest.approx(np.median(last), abs=2e-5)
    assert plant.delay + 1e-4 < np.median(last) < max(last) - 1e-4


def test_a_flight_whose_recording_ends_says_so_and_goes_on(tmp_path: Path) -> None:
    said: list[str] = []
    file: Any = open_recording(tmp_path / "run.mcap")
    flown, plant = flight(file=file, warn=said.append)
    file._process.kill()
    file._process.wait()
    with plant:
        assert flown.run(0.5).ticks == 100
    assert len(said) == 1 and "is not written any more" in said[0]
    with pytest.raises(RecordingError):
        file.close()
