"""Viewer process of a device: messages both ways.

A wall felt through the mouse too.
"""

import os
import time
from contextlib import suppress
from dataclasses import replace
from multiprocessing import Pipe
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import glfw
import numpy as np
import pytest

from maglev_mj.cli.peripherals import PageOptions
from maglev_mj.errors import MaglevError
from maglev_mj.parameters import Turn, param
from maglev_mj.plants.hand import SpringHand
from maglev_mj.scenes import Scene
from maglev_mj.scenes.interactive import Joystick
from maglev_mj.session import EMERGENCY_STOP, SampledMotion, Session, Snapshot, SnapshotSource, device_actions
from maglev_mj.session.snapshot import COLUMNS
from maglev_mj.views.viewer_process import Inbox, RemoteSession, RemoteViewer, show_remotely
from maglev_mj.views.window.keys import keys_of
from maglev_mj.views.window.window import show
from tests.processes import ADDRESS, PATIENCE, WEAK, said_by, started, twin
from tests.views.virtual_screen import VirtualScreen, waited

SIZE = 600, 450
"""Size of the screen [px], which software draws."""


@pytest.mark.needs("screen", "xdotool")
def test_escape_in_the_window_of_a_twin_cuts_the_currents_in_flight() -> None:
    listen = "twin", "--listen", "udp://127.0.0.1:0", "--watchdog", "1", "--view"
    with VirtualScreen(*SIZE) as screen, started(*listen, env=screen.environment) as twin:
        with started("bridge", twin.wait_for(ADDRESS), *WEAK, "--seconds", "600") as host:
            window = screen.window("maglev-mj")
            host.wait_for("during takeoff")

            def cut() -> bool:
                with suppress(AssertionError):  # refused until it is on the screen; one that is not drawn yet misses it
                    screen.xdotool("windowfocus", window)
                    screen.xdotool("key", "Escape")
                return host.child.poll() is not None

            waited(cut, PATIENCE)
            stopped = host.end(None)
            assert stopped.status == 1 and "ESTOP: " in stopped.output + stopped.errors
            assert "final state: fault, faults ESTOP" in twin.end().output


def stopping(source: SnapshotSource) -> None:
    """Show a flight, and stop it once it has begun: a window that needs no screen."""
    while True:
        source.tick(0.0)
        if source.snapshot().tick:
            source.act(EMERGENCY_STOP)
        time.sleep(0.05)


@pytest.mark.machine
def test_an_emergency_stop_in_a_hosts_window_cuts_the_currents(tmp_path: Path) -> None:
    with twin("--watchdog", "1") as (device, address), patch.object(PageOptions, "front", lambda *_, **__: stopping):
        status, said = said_by("bridge", address, *WEAK, "--seconds", "60", "--out", str(tmp_path), "--view")
        assert status == 1 and "ESTOP: " in said, said
        assert "final state: fault, faults ESTOP" in device.end().output


class ViewerHere(RemoteViewer):
    """A viewer whose window is this test.

    Attributes:
        sent: What it has shown.
        window: The session behind the window.
    """

    def __init__(self, scene: Scene, *, watch: bool = False) -> None:
        line, far = Pipe()
        received = lambda: [line.recv() for _ in iter(line.poll, False)]  # noqa: E731
        self.line = line
        self.sent, self.window = list[Snapshot](), RemoteSession(far, Snapshot(scene=scene))
        front = SimpleNamespace(received=received, ended=False, ready=True, send=self.sent.append)
        with patch("maglev_mj.views.viewer_process.SideProcess", return_value=front):
            super().__init__(Snapshot(scene=scene), show, watch=watch)
        self._inbox = Inbox(1e-9)


def test_viewer_and_session_exchange_samples_and_requests() -> None:
    # Each sample's row arrives once; keys pressed between two snapshots add up; who is gone is told of once.
    viewer, motion, blank = ViewerHere(Joystick()), SampledMotion(), Snapshot(scene=Joystick())
    session, closed, stopped = viewer.window, list[int](), list[int]()
    viewer.on_close, viewer.on_emergency = lambda: closed.append(1), lambda: stopped.append(1)
    for tick in range(1, 1001):
        motion.add(tick * 0.005, np.full(6, 1e-6 * tick), np.ones(6), [0.5] * 6)
        if tick % 3 == 0:
            rows = motion.history.rows
            viewer.show(replace(blank, tick=tick, time=tick * 0.005, notes=["a note"], history=rows, work=motion.work))
            viewer.line.send(viewer.sent[-1])
            session.tick(0.0)
    view = session.snapshot()
    assert (view.history[-399:] == motion.history.rows[-400:-1]).all()  # the last was not shown
    assert len(view.history) == pytest.approx(400, abs=2) and view.notes == ["a note"]
    assert view.history[1:, 7] == pytest.approx(1e-6 / 0.005) and view.work == pytest.approx(6 * 0.5 * 998e-6)
    session.hand.target = [1e-3] * 6
    session.tick(0.0)
    for action in ("stiffness up", "pause", "stiffness up", "wall"):
        session.act(action)
    request = viewer.take()
    assert request is not None and request.scene == Joystick(stiffness=9380.0, wall=False) and viewer.take() is None
    request.reply("not heard")
    assert viewer.hand.target == [1e-3] * 6
    viewer.show(replace(blank, scene=Joystick(stiffness=3000.0)))  # the person is not the only one who changes it
    session.act("wall")
    request = viewer.take()
    assert request is not None and request.scene == Joystick(stiffness=3000.0, wall=False)
    session.act(keys_of(device_actions(Joystick))[glfw.KEY_ESCAPE])
    assert viewer.take() is None and stopped == [1]
    viewer._front.ended = True
    for _ in range(3):
        viewer.take()
        viewer.show(blank)
    assert closed == [1] and viewer.hand.target is None
    viewer.line.close()
    with pytest.raises(MaglevError, match="the control process has ended"):
        session.tick(0.02)


class Steep(Scene):
    """Scene that refuses some values set by keys.

    A number and a switch.
    """

    level: float = param("level", default=1.0, above=0.0, live=Turn(add=1.0))
    fragile: bool = param("fails", default=False, live=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.fragile:
            raise ValueError("it breaks")


@pytest.mark.parametrize(("key", "said"), [("level down", "level must be"), ("fragile", "ValueError: it breaks")])
def test_a_rejected_value_becomes_a_note_and_does_not_end_the_flight(key: str, said: str) -> None:
    """Keys are taken in the loop of a device."""
    viewer = ViewerHere(Steep())
    viewer.window.act(key)
    assert viewer.take() is None
    viewer.show(Snapshot(scene=Steep(), notes=["a device"]))
    assert viewer.sent[0].notes[0] == "a device" and said in viewer.sent[0].notes[1]
    viewer.window.act("level up")
    request = viewer.take()
    assert request is not None and request.scene == Steep(level=2.0)


def test_a_device_accepts_only_its_scenes_parameters_and_no_rewind() -> None:
    viewer = ViewerHere(Joystick())
    viewer.window.change({"stiffness": 3000.0, "hand_stiffness": 9.0})
    request = viewer.take()
    assert request is not None and request.scene == Joystick(stiffness=3000.0)
    viewer.window.act("of another scene")
    assert viewer.take() is None and not viewer._note.lines
    viewer.window.change({"rewind": 1.0})
    assert viewer.take() is None and "a device cannot be rewound" in viewer._note.lines[0]


def test_a_restarted_scene_is_shown_from_its_beginning() -> None:
    viewer, blank = ViewerHere(Joystick()), Snapshot(scene=Joystick())
    for times in ([0.9, 1.0], [0.005, 0.01], [0.01, 0.015]):
        viewer.show(replace(blank, time=times[-1], history=np.full((2, COLUMNS), 1.0) * np.array(times)[:, None]))
    assert [shown.history[:, 0].tolist() for shown in viewer.sent] == [[0.9, 1.0], [0.005, 0.01], [0.015]]


def test_rows_are_thinned_after_a_jump_in_a_recording() -> None:
    viewer, rows = ViewerHere(Joystick()), np.zeros((5000, len(SampledMotion().history.rows.T)))
    rows[:, 0] = 0.005 * np.arange(5000)
    viewer.show(Snapshot(scene=Joystick(), time=25.0, history=rows))
    sent = viewer.sent[0].history[:, 0]
    assert 350 <= len(sent) <= 400 and sent[-1] == rows[-1, 0] and np.ptp(np.diff(sent)) < 1e-9


def killed(source: SnapshotSource) -> None:
    """Show nothing, and end without a word."""
    os._exit(3)


def failing(source: SnapshotSource) -> None:
    """Show nothing, and fail."""
    raise MaglevError("no display")


@pytest.mark.machine
def test_the_session_ends_with_the_viewer_process() -> None:
    # As an error that says why, unless the user closed the window.
    for front, words in ((killed, "the viewer process has ended"), (failing, "no display")):
        with pytest.raises(MaglevError, match=words):
            show_remotely(Session(), front, 60.0)
    assert show_remotely(Session(), id, 60.0).wall_time < 60.0


def test_a_flood_of_requests_delays_neither_ticks_nor_the_emergency_stop() -> None:
    # Ten seconds of 4800 slider values a second and half as many actions, the stop amid them.
    now = [100.0]
    inbox = Inbox(clock=lambda: now[0])
    taken, stops = [], []
    for turn in range(2000):
        now[0] = 100.0 + 0.005 * turn
        if turn == 1000:
            inbox.put("act", EMERGENCY_STOP)
        for count in range(12):
            inbox.put("change", {"stiffness": 1000.0 + 12 * turn + count})
            inbox.put("change", {"damping": float(count)})
            inbox.put("hand", [1e-6 * count] * 6)
            inbox.put("act", "wall" if count % 2 else "pulse")
        requests = inbox.take()
        stops += [turn for request in requests if request[1] == EMERGENCY_STOP]
        assert [request[0] for request in requests].count("hand") == 1 and len(requests) <= 66
        taken += [turn] if len(requests) > 2 else []
    assert stops == [1000] and 180 <= len(taken) <= 201 and min(np.diff(taken)) >= 10


def test_waiting_changes_are_merged() -> None:
    inbox = Inbox(1e-9)
    for value in range(1000):
        inbox.put("change", {"stiffness": value})
        inbox.put("change", {"damping": 2 * value})
    inbox.put("act", "wall")
    inbox.put("change", {"stiffness": 5.0})
    assert inbox.take() == [
        ("change", {"stiffness": 999, "damping": 1998}),
        ("act", "wall"),
        ("change", {"stiffness": 5.0}),
    ]
    assert inbox.take() == []


def test_an_emergency_stop_discards_earlier_requests() -> None:
    inbox = Inbox(1e-9)
    inbox.put("act", "centre")
    inbox.put("change", {"stiffness": 5.0})
    inbox.put("hand", [1e-3] * 6)
    inbox.put("act", EMERGENCY_STOP)
    assert inbox.take() == [("act", EMERGENCY_STOP), ("hand", [1e-3] * 6)]
    inbox.put("act", "centre")
    assert inbox.take() == [("act", "centre")]


def test_a_moving_slider_does_not_restart_the_scene_after_an_emergency_stop() -> None:
    now = [10.0]
    inbox = Inbox(1e-9, lambda: now[0])
    inbox.put("act", EMERGENCY_STOP)
    assert inbox.take() == [("act", EMERGENCY_STOP)]
    for _ in range(100):
        now[0] += 0.04
        inbox.put("change", {"stiffness": 5.0})
        assert inbox.take() == []
    inbox.put("act", "centre")  # the person goes on
    assert inbox.take() == [("act", "centre")]
    now[0] += 0.6
    inbox.put("change", {"stiffness": 6.0})
    assert inbox.take() == [("change", {"stiffness": 6.0})]


def test_endless_messages_do_not_block_a_tick() -> None:
    viewer, messages = ViewerHere(Joystick()), iter([("change", {"stiffness": 1000.0})] * 10_000)
    viewer._front.received = lambda: messages  # type: ignore[method-assign]
    source: Any = SimpleNamespace(change=id, hand=SpringHand(), snapshot=lambda: Snapshot(scene=Joystick()))
    viewer.serve(source)
    assert len(list(messages)) >= 9900
