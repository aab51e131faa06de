"""Playback of a recording over time, with its events."""

import math
from pathlib import Path

import numpy as np
import pytest

from maglev_mj.errors import ParameterError
from maglev_mj.plants.hand import SpringHand
from maglev_mj.recording import Recording
from maglev_mj.session import Pacer, Session
from maglev_mj.session.replay import Replay
from maglev_mj.session.snapshot import COLUMNS, HAND

FIRST, SECOND = 600, 1000
"""Samples of two segments at 200 Hz and 1 kHz."""


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    """Record two segments with a hand; the second stops early."""
    path = tmp_path_factory.mktemp("playback") / "run.maglev"
    hand = SpringHand(target=[6e-3, 0.0, 0.0, 0.0, 0.0, 0.0])
    session = Session(hand_force=hand, record=path, pacer=Pacer(budget=60.0, patience=3600.0))
    session.tick(3.0)
    session.change({"period": 0.001, "friction": True})
    session.tick(0.5)
    session._pacer.missed += 3
    session.tick(0.0)
    session.tick(0.5)
    session.act("emergency stop")
    session.close()
    return Recording.load(path)


@pytest.fixture
def replay(recording: Recording) -> Replay:
    return Replay(recording)


def test_all_segments_are_on_one_time_axis(replay: Replay, recording: Recording) -> None:
    first, second = recording.segments
    assert (len(first), len(second)) == (FIRST, SECOND)
    assert replay.snapshot().duration == pytest.approx(4.0)
    replay.change({"time": 1.0})
    shown = replay.snapshot()
    assert (shown.pose == first.position[200]).all() and shown.scene.period == 0.005 and shown.time == 1.0
    assert (shown.hand == first.hand[200]).all()
    work = (first.hand[:200] * np.diff(first.position[:201], axis=0)).sum()
    assert shown.work == pytest.approx(work, rel=1e-9) and work > 1e-3
    replay.change({"time": 3.25})
    shown = replay.snapshot()
    assert (shown.pose == second.position[250]).all() and shown.scene.period == 0.001
    replay.change({"time": 3.2507})
    assert replay.snapshot().time == replay.snapshot().history[-1, 0] < 3.2504
    assert shown.time == pytest.approx(3.25) and shown.since == FIRST and shown.tick == FIRST + 250


def test_searching_gives_the_last_two_seconds_at_once(replay: Replay, recording: Recording) -> None:
    first, second = recording.segments
    replay.change({"time": 3.5})
    history = replay.snapshot().history
    assert history[0, 0] == pytest.approx(1.5) and history[-1, 0] == pytest.approx(3.5)
    assert len(history) == (FIRST - 300) + 501 and (np.diff(history[:, 0]) > 0.0).all()
    assert (history[:300, 1:7] == first.position[300:]).all()
    assert (history[300:, 1:7] == second.position[:501]).all()
    speed = np.diff(first.position[299:], axis=0) / 0.005
    assert history[:300, 7:13] == pytest.approx(speed, rel=1e-9, abs=1e-12)
    assert (history[300, 7:13] == history[301, 7:13]).all()  # nothing before a segment tells its speed
    assert (history[300:, HAND] == second.hand[:501]).all()
    replay.change({"time": 0.0})
    assert replay.snapshot().history.shape == (1, COLUMNS)


def test_a_history_played_is_that_of_a_search(replay: Replay) -> None:
    for _ in range(35):
        replay.tick(0.1)
    played = replay.snapshot()
    replay.change({"time": 0.0})
    replay.change({"time": played.time})
    assert (replay.snapshot().history == played.history).all() and replay.snapshot().work == played.work


def test_speed(replay: Replay) -> None:
    assert replay.tick(0.5) == 100
    replay.act("faster")
    assert replay.snapshot().time_scale == 2.0 and replay.tick(0.5) == 200
    for _ in range(5):
        replay.act("faster")
    assert replay.snapshot().time_scale == 10.0
    replay.change({"time_scale": 0.1})
    replay.act("slower")
    assert replay.snapshot().time_scale == 0.05 and replay.tick(1.0) == 10
    assert replay.snapshot().time == pytest.approx(1.55)


def test_steps_pause_and_go_one_sample(replay: Replay) -> None:
    replay.change({"time": 3.0 - 0.005})
    for action, row in (("step", FIRST), ("step", FIRST + 1), ("step back", FIRST), ("step back", FIRST - 1)):
        replay.act(action)
        shown = replay.snapshot()
        assert shown.tick == row and shown.state == "paused" and replay.tick(1.0) == 0
    replay.act("start")
    replay.act("step back")
    assert replay.snapshot().tick == 0
    replay.act("skip forward")
    assert replay.snapshot().time == pytest.approx(0.2)  # a twentieth
    replay.act("skip back")
    replay.act("skip back")
    assert replay.snapshot().time == 0.0
    replay.act("end")
    replay.act("step")
    assert replay.snapshot().tick == FIRST + SECOND - 1


def test_it_loops_or_stops_at_its_end(replay: Replay) -> None:
    replay.change({"time": 3.75})
    assert replay.tick(0.5) == 250 + 50 and replay.snapshot().time == pytest.approx(0.25)
    assert replay.tick(8.0) == 2 * (FIRST + SECOND)
    assert "REPLAY (looped)" in replay.snapshot().notes
    replay.act("loop")
    replay.change({"time": 3.75})
    assert replay.tick(0.5) == 249
    ended = replay.snapshot()
    assert ended.state == "paused" and ended.tick == FIRST + SECOND - 1 and "REPLAY" in ended.notes
    replay.act("pause")  # plays it again
    assert replay.snapshot().state == "running" and replay.tick(0.1) == 20


def test_events_are_marked_and_told_when_they_are_passed(replay: Replay, recording: Recording) -> None:
    assert [event.partition(":")[0] for event in recording.events] == ["missed", "fault"]
    assert replay.snapshot().marks == pytest.approx([3.499, 3.999])
    told = []
    for time in (3.4, 3.6, 3.9999):
        replay.change({"time": time})
        told.append(list(replay.snapshot().notes)[1:])
    assert told == [[], list(recording.events[:1]), list(recording.events)]
    replay.change({"time": 1.0})
    assert len(replay.snapshot().notes) == 1
    assert not Replay(Recording(recording.segments, events=recording.events)).snapshot().marks  # of unknown times


def test_stick_positions_are_found_while_it_is_shown(replay: Replay) -> None:
    replay.change({"time": 3.9})
    assert replay.snapshot().anchors is None
    replay.act("pause")
    for _ in range(SECOND // 100):
        replay.tick(0.001)
    found = replay.snapshot().anchors
    assert found is not None and found[0] == pytest.approx(replay.snapshot().pose[0], abs=1e-3)


def test_what_a_recording_cannot_be_changed_to(replay: Replay) -> None:
    with pytest.raises(ParameterError, match="parameters must be among time, time_scale"):
        replay.change({"stiffness": 1.0})
    for time in (-0.1, 4.1, math.nan):
        with pytest.raises(ParameterError, match="time must be"):
            replay.change({"time": time})
    with pytest.raises(ParameterError, match="time_scale must be"):
        replay.change({"time_scale": 20.0, "time": 1.0})
    assert replay.snapshot().time == 0.0
    with pytest.raises(ParameterError, match=r"action must be one of pause, step.*got 'wall'\)"):
        replay.act("wall")


def test_one_sample_is_shown(recording: Recording, tmp_path: Path) -> None:
    replay = Replay(Recording([recording.segments[0][:1]]))
    assert replay.tick(0.02) == 4 and replay.snapshot().duration == pytest.approx(0.005)
    assert replay.snapshot().history.shape == (1, COLUMNS)
