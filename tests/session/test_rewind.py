"""Rewound sessions: the last minute, the repeated hand, the first try beside it."""

import threading
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

from maglev_mj.analysis.report import analyse
from maglev_mj.cli import main
from maglev_mj.control.loop import drive
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array
from maglev_mj.plants import Sensor, SpotSensor, Timing
from maglev_mj.plants.hand import GuidedHand, Hand, RecordedHand, Trajectory
from maglev_mj.recording import Recording, UserCodeError
from maglev_mj.recording.verify import first_different_command, verify
from maglev_mj.scenes import BUILT_IN, Scene, find_scene
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.interactive import Joystick
from maglev_mj.session import EMERGENCY_STOP, MAX_REWIND, Pacer, Session, live_plant
from maglev_mj.session.replay import Replay, UserCode, rebuild, rebuild_for, stick_positions_of
from maglev_mj.session.segment import _MAX_STATES
from maglev_mj.session.snapshot import HAND
from maglev_mj.theory import largest_stable_stiffness
from maglev_mj.views.readings import Charts
from maglev_mj.views.viewer_process import RemoteViewer
from tests.session.test_session_states import Program


class Rough(Joystick):
    """Joystick with everything that has a state: noise, lag, jitter, stops that rub."""

    falloff: ClassVar[float] = 0.1
    """Of the coils' force; the engine takes six times as many steps for it."""

    def timing(self, phase: Any = 0.0) -> Timing:
        return Timing(period=self.period, delay=self.delay, phase=phase, jitter=2e-5, seed=3)

    def plant_options(self) -> dict[str, Any]:
        return {"sensor": self.sensor(), "driver_lag": True, "stop_damping": True, "force_falloff": self.falloff}

    def sensor(self) -> Any:
        return Sensor(quantum=1e-6, noise=2e-6, seed=5)


class Spots(Rough):
    """The same with the device's own sensor, and more delay than a period."""

    falloff = 0.0

    def timing(self, phase: Any = 0.0) -> Timing:
        return Timing(period=self.period, delay=0.0024 + self.period, phase=phase)

    def sensor(self) -> Any:
        return SpotSensor(quantum=1e-6, noise=1e-6, seed=5)


class Locked(Rough):
    """The same with a sensor of one's own that cannot be copied."""

    falloff = 0.0

    def sensor(self) -> Any:
        return SimpleNamespace(start=lambda: partial(lambda lock, position: [*position], threading.Lock()))


def name_of(value: Any) -> str:
    """Return the name of a test's scene, or its other value."""
    return str(getattr(value, "name", value))


def made(scene: Scene | None = None, **options: Any) -> Session:
    """Return a session that no slow machine can make late."""
    return Session(scene, pacer=Pacer(budget=60.0, patience=3600.0), **options)


def played(session: Session, duration: float, size: float = 5e-3) -> Session:
    """Move the hand on all axes, also into walls and stops, and release it."""
    for frame in range(round(duration / 0.02)):
        x, y, z = (size * np.sin(frame / rate) for rate in (7.0, 5.0, 11.0))
        turn = 0.1 * (frame > 30)  # upright before
        session.hand.target = [x, y, z, turn * np.sin(frame / 9.0), turn * np.cos(frame / 6.0), 0.0]
        session.tick(0.02)
    session.hand.target = None
    return session


def rows(session: Session) -> Array:
    """Return all samples that are kept."""
    return session._past.history.rows


def run_to(session: Session, end: float) -> None:
    """Run until a time of the session."""
    period = session.snapshot().scene.period
    for _ in range(round((end - session.snapshot().time) / period)):
        session.tick(period)
    assert session.snapshot().time == pytest.approx(end, abs=1e-9)


SOME = [(find_scene("table"), 0.005, 0.9), (Spots, 0.005, 0.14), (Locked, 0.005, 0.14)]
EVERY = [
    pytest.param(make, period, 0.7 if issubclass(make, Rough) else 1.3, marks=pytest.mark.study)
    for make in [*(find_scene(name) for name in BUILT_IN), Rough, Spots, Locked]
    for period in (0.005, 0.001)
]


@pytest.mark.parametrize(("make", "period", "duration"), [*SOME, *EVERY], ids=name_of)
def test_the_same_hand_again_moves_it_alike_to_the_last_bit(make: type[Scene], period: float, duration: float) -> None:
    session, random = made(make(period=period)), np.random.default_rng(7)
    if issubclass(make, Rough):  # at its stops where a state is kept
        session.change({"wall": False})
        played(session, duration, size=4e-2)
    else:
        played(session, duration)
    first, end, before = rows(session).copy(), session.snapshot().time, session.snapshot()
    assert np.ptp(first[:, 1:4]) > 1e-4
    for branch in range(2 if issubclass(make, Rough) else 4):
        if branch % 2:
            session.rewind(random.uniform(0.0, end - 0.1), again=True)
        else:  # a gain that is changed and changed back changes nothing
            session.change({"rewind": random.uniform(0.0, end - 0.1)})
            session.change({"delay": 0.0012})
            session.tick(0.1)
            session.change({"delay": make(period=period).delay})
            session.act("repeat the hand's motion")
        run_to(session, end)
        assert rows(session).tobytes() == first.tobytes()
        now = session.snapshot()
        assert (now.work, now.taken) == (before.work, before.taken)


@pytest.mark.parametrize("again", [True, pytest.param(False, marks=pytest.mark.study)])
def test_a_changed_gain_gives_the_run_from_the_same_state(again: bool) -> None:
    session = played(made(), 1.0)
    first, end = rows(session).copy(), session.snapshot().time
    session.change({"rewind": end - 0.6})
    session.change({"stiffness": 3000.0})
    shown, wrench = session.snapshot(), session._segment.force
    session.act("repeat the hand's motion" if again else "resume from here")
    run_to(session, end)
    segment = session._segment
    efforts = first[120:, HAND] if again else np.zeros((80, 6))
    assert shown.time == pytest.approx(0.6) and shown.state == "paused"
    assert shown.pose.tobytes() == first[119, 1:7].tobytes()
    scene, hand = Joystick(stiffness=3000.0), RecordedHand(efforts)
    plant = live_plant(scene, hand, pose=first[119, 1:7], twist=first[119, 7:13], wrench=wrench)
    poses: list[Array] = []
    drive(plant, scene.controller(), 80, observe=lambda sample, command: poses.append(plant.state()[0]))
    assert segment.scene == scene and np.array(poses).tobytes() == rows(session)[120:, 1:7].tobytes()
    assert np.array(poses).tobytes() != first[120:, 1:7].tobytes()
    times = [saved[0] for saved in session._past._states]
    assert times == sorted(times)  # those of the first try take no room
    second = rows(session).copy()
    session.rewind(0.7, again=True)  # into the second try: nothing is left of the first
    run_to(session, end)
    assert rows(session).tobytes() == second.tobytes() and session.snapshot().scene == scene


def test_the_first_try_is_shown_until_its_end_and_the_live_hand_follows() -> None:
    session = played(made(), 1.0)
    first, end = rows(session).copy(), session.snapshot().time
    assert not len(session.snapshot().first) and session.snapshot().ghost is None
    session.rewind(0.5, again=True)
    session.change({"damping": 30.0})
    run_to(session, 0.75)
    now, found = session.snapshot(), Charts(100).of(session.snapshot(), 2)[0]
    assert now.ghost is not None and now.ghost.tobytes() == first[149, 1:7].tobytes()
    assert (now.ghost != now.pose).any() and now.hand.tobytes() == first[149, HAND].tobytes()
    assert [words for words, _ in found.title] == ["position along z [mm]", "walls", "first attempt"]
    assert np.asarray(found.lines[-2].y)[-1] == pytest.approx(1e3 * now.ghost[2])
    session.hand.target = [-0.002, 0.0, 0.0, 0.0, 0.0, 0.0]
    run_to(session, end)
    assert session.snapshot().hand.tobytes() == first[-1, HAND].tobytes() and first[-1, 19] > 0.0
    run_to(session, end + 0.05)
    after = session.snapshot()
    assert not len(after.first) and after.hand[0] < 0.0
    session.change({"rewind": after.time - 0.7})  # where that hand acted again
    assert not len(session.snapshot().first)


@pytest.mark.parametrize("kept", [MAX_REWIND / 10.0, pytest.param(MAX_REWIND, marks=pytest.mark.study)])
def test_no_more_than_a_minute_is_kept_whatever_is_changed(kept: float, monkeypatch: pytest.MonkeyPatch) -> None:
    every = 0.5 * kept / MAX_REWIND
    for name, value in {"segment.MAX_REWIND": kept, "segment._EVERY": every, "session.MAX_REWIND": kept}.items():
        monkeypatch.setattr(f"maglev_mj.session.{name}", value)
    session = made()
    past, most = session._past, kept / 0.005
    for _ in range(62):
        session.tick(kept / 60.0)
    least, now = past.bounds(session.snapshot().time)
    assert kept - 1.2 * every < now - least <= kept and len(past._states) <= kept / every + 1
    for stiffness in range(200):
        session.change({"stiffness": 3000.0 + stiffness})
        session.tick(kept / 300.0)
    assert len(past._states) == _MAX_STATES
    assert len(rows(session)) <= most + 1 and len(past.history._rows) <= 2 * most + 1024
    least, now = past.bounds(session.snapshot().time)
    session.change({"rewind": kept})
    shown = session.snapshot()
    assert kept / 6.0 < now - least < kept and shown.time == pytest.approx(least)
    assert shown.scene == past._states[0][1].scene != Joystick(stiffness=3199.0)


@pytest.mark.parametrize(
    "make",
    [Joystick, *(pytest.param(make, marks=pytest.mark.study) for make in (find_scene("table"), Spots))],
    ids=name_of,
)
def test_a_recording_of_many_rewinds_is_checked_to_the_last_bit(
    make: type[Scene], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, random = tmp_path / "run.maglev", np.random.default_rng(11)
    session = made(make(), record=path)
    for turn in range(7):
        played(session, random.uniform(0.1, 0.5))
        if turn == 4:
            session.act("centre")  # forgets all before
        elif turn % 3 == 1:  # the next one may go back before it
            session.change({"delay": 0.0018 + 1e-4 * turn})
            played(session, 0.2)
        session.rewind(random.uniform(*session._past.bounds(session.snapshot().time)), again=bool(turn % 2))
    for back in 0.2, 0.05:  # into the part before, of which no state is kept in between
        session.rewind(played(session, 0.25).snapshot().time - back)
    played(session, 0.3)
    session.rewind(session.snapshot().time)  # not at all
    session.rewind(session._past.bounds(1.0)[0])  # to the start, after which a plant is as new
    played(session, 0.1)
    session.close()
    recording = Recording.load(path)
    leads = [0 if one.before is None else len(one.whole) - len(one) for one in recording.segments]
    assert len(leads) > 8 and sum(map(bool, leads)) > 4 and not leads[-1]
    assert any(one.before is not None and one.before.before is not None for one in recording.segments)
    assert first_different_command(recording, rebuild, 10) is None
    assert main(["replay", str(path), "--check"]) == 0
    said, count = " ".join(capsys.readouterr().out.split()), len(leads)
    assert f"{recording.ticks} of {recording.ticks} equal: tick, time, position" in said and "cannot" not in said
    assert f"{count} of {count} equal: period, delay, carried, inertia, load, before, faces, hand_recorded" in said


def test_a_rewind_before_a_change_takes_its_scripted_hand_along_and_sticks_alike(tmp_path: Path) -> None:
    record, hand = tmp_path / "run.maglev", Hand(mass=0.1, damping=4.0, stiffness=1500.0, axes="x")
    path = Trajectory([0.0, 0.3, 0.5, 0.9], [[place, 0.0, 0.0, 0.0, 0.0, 0.0] for place in (0.0, 3e-3, 0.0, 2e-3)])
    session = made(find_scene("table")(), record=record, hand_force=GuidedHand(hand=hand, path=path))
    session.tick(0.5)
    session.change({"delay": 0.0016})  # a hand's path begins again
    session.tick(0.6)
    session.rewind(0.3, again=True)
    run_to(session, 1.2)
    session.close()
    recording = Recording.load(record)
    first, changed, again = recording.segments
    verdict = verify(recording, rebuild)
    assert verdict.same and verdict.fields["hand"].compared == len(first) + len(changed)
    firsts, sticks = stick_positions_of(first), stick_positions_of(again)
    assert firsts is not None and sticks is not None and sticks[:40].tobytes() == firsts[60:].tobytes()
    shown = Replay(recording)
    shown.change({"time": 1.2})
    for _ in range(3):
        shown.tick(0.0)
    place = shown.snapshot().tick - len(first) - len(changed)
    anchors = shown.snapshot().anchors
    assert anchors is not None and anchors.tobytes() == sticks[place].tobytes()


def test_a_recording_goes_on_and_loses_nothing(tmp_path: Path) -> None:
    session = played(made(record=tmp_path / "run.maglev"), 0.5)
    session.rewind(0.2, again=True)
    run_to(session, 0.5)
    session.change({"rewind": 0.15})
    session.change({"stiffness": 3000.0})
    session.act("pause")
    session.tick(0.15)
    session.close()
    recording = Recording.load(tmp_path / "run.maglev")
    assert [len(one) for one in recording.segments] == [100, 60, 30]
    again = recording.segments[1]
    assert again.metadata.before.tobytes() == recording.segments[0].applied[39].tobytes()
    assert again.position.tobytes() == recording.segments[0].position[40:].tobytes()
    assert verify(recording, rebuild).same
    report = analyse(again, rebuild_for(again))
    assert len(report.recorded.motion.time) == 60 and report.comparison is not None and report.comparison.same
    assert Replay(recording).snapshot().duration == pytest.approx(0.95)
    wrong = again.replace(position=again.position + 1e-12 * (again.tick == 60.0)[:, None])
    first, alone = recording.segments[0], replace(again, before=None)
    assert verify(Recording([first, wrong]), rebuild).first == (1, 60)
    assert verify(Recording([first[:39], alone]), rebuild).first == (1, 40)
    assert rebuild_for(alone) is None and analyse(alone).as_json()["recorded"] == report.as_json()["recorded"]
    for segments in (
        [alone],
        [alone, first],
        [first[50:], alone],
        [replace(first, setup={**first.setup, "session": None}), alone],
    ):
        lost = Recording(segments)  # with nothing that it goes on from
        with pytest.raises(UserCodeError, match="from a sample that is not in the recording"):
            verify(lost, partial(rebuild, own=UserCode("joystick", lost)))
    for broken, said in (("no", "after is missing in a message"), ({"first": 0.5, "after": None}, "first must be")):
        with pytest.raises(ParameterError, match=said):
            Recording([replace(first, setup={**first.setup, "session": broken})])


def test_a_rewind_that_is_refused_says_why() -> None:
    session = played(made(), 1.0)
    refused: list[tuple[Callable[[], Any], str]] = [
        (lambda: session.rewind(1.1), "time must be between 0 and 1.*got 1.1"),
        (lambda: session.rewind(-0.1), "time must be .*between 0 and 1"),
        (lambda: session.rewind(0.5, again="yes"), "again must be"),  # type: ignore[arg-type]
        (lambda: session.change({"rewind": 61.0}), "rewind must be .*60 .*got 61"),
        (lambda: session.act("repeat the hand's motion"), "motion can only be repeated after a rewind"),
    ]
    for ask, said in refused:
        with pytest.raises(ParameterError, match=said):
            ask()


def test_an_unstable_scene_is_rewound_and_an_emergency_stop_stays() -> None:
    limit = float(largest_stable_stiffness(87.0, period=0.005, delay=0.0015))
    session = made(Drop(pulse=0.0, stiffness=1.5 * limit, damping=87.0))
    session.tick(8.0)
    assert session.snapshot().reason.startswith("unstable: ")
    session.act("rewind")
    assert (session.snapshot().state, session.snapshot().reason) == ("paused", "")
    session.change({"stiffness": 0.5 * limit})
    session.act("pause")
    session.tick(1.0)
    assert session.snapshot().state == "running"
    session.act("rewind")
    session.change({"damping": 80.0})
    session.act(EMERGENCY_STOP)
    session.act("resume from here")
    assert session.tick(0.5) == 0 and session.snapshot().reason == EMERGENCY_STOP
    session.act("centre")
    assert session.tick(0.1) == 20 and session.snapshot().rewound == 0.0


def test_single_steps_go_on_from_there_and_a_program_waits_for_none() -> None:
    program = Program()
    session = played(made(publishers=[program]), 1.0, size=1e-3)
    newest = session.snapshot()
    session.change({"rewind": 0.5})
    program.wanted = Joystick(stiffness=3000.0)
    session.tick(0.1)
    before = session.snapshot()
    assert program.answers == [before.tick] and before.time == pytest.approx(0.5)
    session.change({"rewind": 0.0})
    shown = session.snapshot()
    assert shown.pose.tobytes() == newest.pose.tobytes() and shown.scene == newest.scene
    session.change({"rewind": 0.5})
    session.change({"stiffness": 3000.0})
    session.act("step")
    assert session.tick(0.1) == 1
    now = session.snapshot()
    assert now.state == "paused" and session._segment.scene == Joystick(stiffness=3000.0)
    assert now.rewound == 0.0 and now.time == pytest.approx(0.505)


def test_a_device_refuses_a_rewind() -> None:
    viewer, said = object.__new__(RemoteViewer), list[str]()
    viewer._scene, viewer._note = Joystick(), type("Said", (), {"say": staticmethod(said.append)})()
    assert viewer._changed("change", {"rewind": 1.0}) is None and viewer._changed("act", "rewind") is None
    assert said == 2 * ["rewind needs a simulation: a device cannot be rewound"]
