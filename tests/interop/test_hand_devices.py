"""Gamepads and 3D mice as hands: real sockets, made-up gamepads of GLFW, and the session behind."""

from __future__ import annotations

import math
import os
import socket
import struct
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Self

import numpy as np
import pytest

from joystick_to_3d_mouse import SpacenavServer
from maglev_mj import cli
from maglev_mj.frames import AXES
from maglev_mj.interop import hand_devices
from maglev_mj.interop.hand_devices import (
    AxisMapping,
    Gamepad,
    HandDevice,
    HandState,
    SpacenavMouse,
    described_devices,
    gamepad_shares,
    open_device,
    searched_paths,
)
from maglev_mj.plants.hand import SpringHand
from maglev_mj.scenes import find_scene
from maglev_mj.session import Session, Snapshot
from maglev_mj.spec import RANGE
from maglev_mj.views import viewer_process
from maglev_mj.views.viewer_process import ShowReport
from maglev_mj.views.window import window

REST = HandState((0.0,) * 6)
PERIOD = 0.005
PATIENCE = 60.0
SNAPSHOT = Snapshot(scene=find_scene("joystick")())


class Stick:
    """An input device whose state a test sets."""

    name = "stick"

    def __init__(self) -> None:
        self.reading, self.closed = REST, False

    def read(self) -> HandState:
        return self.reading

    def close(self) -> None:
        self.closed = True


def pushed(shares: Sequence[float], **settings: Any) -> Any:
    """Return the hand's target for a stick deflection."""
    stick, hand = Stick(), SpringHand()
    device = HandDevice(stick, hand, AxisMapping(**settings) if settings else None)
    goal(device, hand)
    stick.reading = HandState(shares)
    return goal(device, hand)


def goal(device: HandDevice, hand: SpringHand) -> Any:
    """Return the hand's target after some readings, enough to find the rest position."""
    for _ in range(hand_devices._STILL + 1):
        device.show(SNAPSHOT)
    return hand.device_target


def one(axis: int, share: float = 1.0) -> list[float]:
    """Return a deflection along one axis."""
    return [share * (index == axis) for index in range(6)]


def waited(ask: Callable[[], Any]) -> Any:
    """Return the first answer that is not empty."""
    end = time.monotonic() + PATIENCE
    while not (answer := ask()):
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.005)
    return answer


# -- deflections to a target -----------------------------------------------------------------------------


def test_a_full_deflection_pulls_to_three_times_the_range() -> None:
    for axis, share in product(range(6), (1.0, -1.0)):
        assert pushed(one(axis, share)) == pytest.approx(one(axis, 3.0 * share * RANGE[axis]))


def test_a_stick_within_its_dead_zone_on_every_axis_lets_go() -> None:
    assert pushed([0.149, -0.149] * 3) is None
    assert pushed([0.151, *[0.0] * 5])[0] == pytest.approx(3.0 * RANGE[0] * 0.001 / 0.85)


def test_no_gain_turns_a_target_round_to_the_other_side() -> None:
    # Past half a turn a spring would pull the other way.
    assert math.hypot(*pushed([1.0] * 6, turning_gain=100.0)[3:]) < math.pi


def test_while_the_mouse_pulls_its_target_counts() -> None:
    hand = SpringHand(device_target=[0.001, *[0.0] * 5])

    def pull() -> Sequence[Any]:
        return hand(0, 0.0, lambda: (np.zeros(6), np.zeros(6)))

    assert pull()[0] == pytest.approx(0.2)
    hand.target = [0.0, -0.002, *[0.0] * 4]
    assert pull()[:3] == pytest.approx([0.0, -0.4, 0.0])
    hand.target = None
    assert pull()[0] == pytest.approx(0.2)


# -- in a session ----------------------------------------------------------------------------------------


def test_a_session_reads_the_device_by_itself_and_closes_it() -> None:
    stick, hand = Stick(), SpringHand()
    device = HandDevice(stick, hand)
    session = Session(find_scene("joystick")(), hand_force=hand, publishers=[device])
    goal(device, hand)
    stick.reading = HandState(one(1))
    waited(lambda: session.tick(PERIOD) and hand.device_target)
    session.close()
    assert stick.closed and hand.device_target is None


def test_the_first_buttons_are_actions_and_further_ones_are_none() -> None:
    stick, actions = Stick(), list[str]()
    stick.reading, device = HandState((0.0,) * 6, [2, 1, 7, 0]), HandDevice(stick, SpringHand())
    device.act = actions.append
    device.show(SNAPSHOT)
    assert actions == ["pause", "centre"]


# -- the 3D mouse ----------------------------------------------------------------------------------------


@pytest.fixture
def path(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Return the only path searched for a 3D mouse."""
    with tempfile.TemporaryDirectory() as folder:
        monkeypatch.setattr(hand_devices, "_SETTINGS", Path(folder) / "spnavrc")
        monkeypatch.setattr(hand_devices, "_DAEMONS", Path(folder) / "daemon.sock")
        monkeypatch.setenv("SPNAV_SOCKET", f"{folder}/spnav.sock")
        yield Path(folder) / "spnav.sock"


def seen(pose: Sequence[float]) -> Snapshot:
    """Return a snapshot of a pose."""
    return Snapshot(scene=SNAPSHOT.scene, pose=np.array(pose))


def test_a_mouse_is_deflected_as_the_joystick_behind_the_socket_is(path: Path) -> None:
    # The example server is the other end: along the same axis, to the same side, by the same share.
    server = SpacenavServer(path)
    mouse = SpacenavMouse(path)
    try:
        for axis, share in product(range(6), (1.0, -0.5, 0.0)):
            server.show(seen(one(axis, share * RANGE[axis])))
            assert mouse.read().shares == pytest.approx(one(axis, share))
        assert mouse.read().shares == pytest.approx([0.0] * 6)  # it stays so while nothing is said
    finally:
        mouse.close()
        server.close()


class Daemon:
    """Driver's end of a mouse, byte by byte.

    It lasts as long as the context.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._open = path, ExitStack()

    def __enter__(self) -> Self:
        self._listener = self._open.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM))
        self._open.callback(self._path.unlink)
        self._listener.bind(os.fspath(self._path))
        self._listener.listen()
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def accept(self) -> socket.socket:
        """Return the connection of the caller."""
        return self._open.enter_context(self._listener.accept()[0])


class Clock:
    """Real time that a test sets."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


def motion_event(axes: Sequence[int], period: int) -> bytes:
    return struct.pack("=8i", 0, *axes, period)


def button_event(number: int, down: bool) -> bytes:
    return struct.pack("=8i", 1 if down else 2, number, down, *[0] * 5)


FULL_X = motion_event([500, 0, 0, 0, 0, 0], 16)


def test_events_in_pieces_and_many_at_once_are_read_whole(path: Path) -> None:
    up, press, unknown = motion_event([0, 250, 0, 0, 0, 0], 16), button_event(3, True), struct.pack("=8i", 3, *[9] * 7)
    with Daemon(path) as daemon, closing(SpacenavMouse(path)) as mouse:
        line = daemon.accept()
        line.send(FULL_X[:13])
        assert mouse.read().shares == REST.shares
        line.send(FULL_X[13:] + up + press[:7])
        assert mouse.read() == HandState((0.0, 0.0, 0.5, 0.0, 0.0, 0.0), [])
        line.send(press[7:] + button_event(3, False) + unknown)
        assert mouse.read() == HandState((0.0, 0.0, 0.5, 0.0, 0.0, 0.0), [3])


def test_a_line_that_ends_in_motion_lets_go_at_once_and_is_called_again(path: Path) -> None:
    clock = Clock()
    with Daemon(path) as daemon:
        mouse = SpacenavMouse(path, clock)
        daemon.accept().send(FULL_X + FULL_X[:20])
        assert mouse.read().shares == (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert mouse.read() == HandState(None)
    clock.now = 1.1
    assert mouse.read() == HandState(None)  # nobody is there
    with Daemon(path) as daemon, closing(mouse):
        assert mouse.read() == HandState(None)  # it does not call every time
        clock.now = 2.2
        assert mouse.read() == REST  # neither the motion nor the half event from before
        daemon.accept().send(FULL_X)
        assert mouse.read().shares == (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def test_a_mouse_is_looked_for_where_libspnav_looks(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert searched_paths() == [path, hand_devices._DAEMONS]
    monkeypatch.delenv("SPNAV_SOCKET")
    hand_devices._SETTINGS.write_text(
        "# socket = /no\nled = 1\n  socket =\n socket = /tmp/a b.sock \nsocket = /tmp/late\n"
    )
    assert searched_paths() == [Path("/tmp/a b.sock"), hand_devices._DAEMONS]


# -- gamepads --------------------------------------------------------------------------------------------


def test_each_control_of_a_gamepad_moves_its_axis() -> None:
    # Left stick right and back, right stick right and back (so leans the handle), triggers, bumpers: left is
    # counter-clockwise from above.
    moves = [("x", 1.0), ("y", -1.0), ("ry", 1.0), ("rx", 1.0), ("z", -1.0), ("z", 1.0), ("rz", 1.0), ("rz", -1.0)]
    for control, (axis, share) in enumerate(moves):
        controls = [0.0, 0.0, 0.0, 0.0, -1.0, -1.0, 0.0, 0.0]
        assert gamepad_shares(controls[:6], 0.0) == (0.0,) * 6
        controls[control] = 1.0
        shares = gamepad_shares(controls[:6], controls[6] - controls[7])
        assert shares == pytest.approx(one(AXES.index(axis), share))


class PadRig:
    """Hand of one of two pads of a model, as GLFW reports them."""

    JOYSTICK_1, JOYSTICK_LAST, GAMEPAD_BUTTON_LEFT_BUMPER, GAMEPAD_BUTTON_RIGHT_BUMPER = 0, 15, 4, 5

    get_gamepad_name: Callable[[int], bytes | None]

    def __init__(self, known: bool) -> None:
        rig: Any = self
        self.rest = [0.0] * 4 + [-1.0 if known else 0.0] * 2
        self.axes, self.down, self.silent, self.waiting = {0: self.rest, 1: self.rest}, [False] * 15, False, list[Any]()
        self.joystick_is_gamepad, self.get_gamepad_name = lambda number: known, lambda number: b"Pad"
        self.joystick_present = lambda number: number in self.axes
        self.get_joystick_axes = lambda number: (self.axes[number], 6)
        self.get_joystick_buttons = lambda number: (self.down, 15)
        self.get_gamepad_state = lambda number: SimpleNamespace(axes=self.axes[number], buttons=self.down)
        pad, self.pads = Gamepad.__new__(Gamepad), hand_devices._Pads(self)
        self.hand, self.clock = SpringHand(), Clock()
        process: Any = SimpleNamespace(received=self.received, ended=False)
        pad.name, pad._state, pad._clock, pad._received, pad._process = "Pad", None, self.clock, 0.0, process
        self.device = HandDevice(pad, self.hand)
        self.faults = {
            "removed": lambda: (rig.deflect(1.0, 1), rig.axes.pop(0)),  # the other user's takes no part
            "replaced": lambda: (rig.axes.pop(0), rig.waiting.append(rig.pads.state("pad")), rig.deflect(1.0)),
            "silent": self.hang,
            "garbage": lambda: self.deflect(math.nan),
        }

    def received(self) -> list[Any]:
        waiting, self.waiting = self.waiting, []
        return [] if self.silent else [*waiting, self.pads.state("pad")]

    def hang(self) -> None:
        self.silent, self.clock.now = True, 3.0

    def deflect(self, share: float, number: int = 0) -> None:
        self.axes[number], self.silent = [share, *self.rest[1:]], False

    def press(self, number: int = 0) -> None:
        self.down[number] = True
        self.device.show(SNAPSHOT)
        self.down[number] = False


class MouseRig:
    """Hand of a 3D mouse, from the daemon's end; one that is held still is silent."""

    def __init__(self, path: Path, stack: ExitStack) -> None:
        daemon, self.hand = stack.enter_context(Daemon(path)), SpringHand()
        self.device = HandDevice(stack.enter_context(closing(SpacenavMouse(path))), self.hand)
        self.line, removed, added = daemon.accept(), *(struct.pack("=8i", 3, end, *[0] * 6) for end in (1, 0))
        asked = self.line.recv(64)
        assert struct.unpack("=IIf", asked[:12]) == (0x7FAA5501, 0x7FAA1001, 1.0)  # protocol 1, sensitivity
        self.line.send(asked[:4])
        self.faults = {
            "removed": lambda: self.line.send(removed),
            "replaced": lambda: self.line.send(removed + added + FULL_X),
            "garbage": lambda: self.line.send(motion_event([-(2**31)] * 6, 0)),
        }

    def deflect(self, share: float) -> None:
        self.line.send(motion_event([round(500 * share), 0, 0, 0, 0, 0], 16))

    def press(self, number: int = 0) -> None:
        self.line.send(button_event(number, True))


RIGS: dict[str, Callable[[Path, ExitStack], Any]] = {
    "gamepad": lambda path, stack: PadRig(True),
    "joystick": lambda path, stack: PadRig(False),
    "3D mouse": MouseRig,
}


@pytest.mark.parametrize("fault", ["removed", "replaced", "silent", "garbage", "held at the start"])
@pytest.mark.parametrize("kind", RIGS)
def test_no_input_device_pulls_that_was_lost_or_never_at_rest(kind: str, fault: str, path: Path) -> None:
    with ExitStack() as stack:
        rig = RIGS[kind](path, stack)
        if fault in rig.faults:
            assert goal(rig.device, rig.hand) is None
            rig.deflect(1.0)
            assert goal(rig.device, rig.hand)[0] > 0.0
            rig.faults[fault]()
            for share in (0.0, 1.0):  # however it comes back
                assert goal(rig.device, rig.hand) is None
                assert "the hand is released until you press" in rig.device.note
                rig.deflect(share)
            rig.press()
        for share in np.linspace(0.0, 0.3, 12):  # never still
            rig.deflect(share)
            rig.device.show(SNAPSHOT)
        for share in (0.4, 1.0, 0.05):
            rig.deflect(share)
            assert goal(rig.device, rig.hand) is None
            assert ("is deflected: let it go" in rig.device.note) == (share > 0.3)
        rig.deflect(-1.0)
        assert goal(rig.device, rig.hand)[0] < 0.0
        rig.press(2)  # rests here from now on
        assert goal(rig.device, rig.hand) is None
        rig.deflect(0.0)
        assert goal(rig.device, rig.hand)[0] > 0.0


class WatchedPads(PadRig):
    """GLFW with a joystick and a gamepad, watched in this process over a script of changes."""

    ended = False

    def __init__(self, *changes: Callable[[WatchedPads], object]) -> None:
        super().__init__(True)
        self.axes[0], self.line, self.messages, self.changes = [0.0, 0.0, 1.0, 0.0], self, list[Any](), iter(changes)
        self.joystick_is_gamepad, self.get_joystick_name = lambda number: number == 1, lambda number: b"Test Stick"
        self.get_gamepad_name = lambda number: b"X360 Controller" if number else None
        self.get_joystick_axes = lambda number: (self.axes[number], len(self.axes[number]))
        self.send, self.sent = self.messages.append, iter(self.messages)
        self.init = self.poll_events = self.terminate = self.close = lambda: None

    def watch(self, function: Callable[..., None], name: str) -> WatchedPads:
        function(self, name)
        return self

    def poll(self, _: float) -> bool:
        if (change := next(self.changes, None)) is not None:
            change(self)
        return change is None

    def received(self) -> Any:
        return self.sent


@pytest.fixture
def watched(path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Return a function that sets the script of the next devices."""

    def plug(*changes: Callable[[WatchedPads], object]) -> None:
        pads = WatchedPads(lambda _: None, *changes)
        monkeypatch.setitem(sys.modules, "glfw", pads)
        monkeypatch.setattr(hand_devices, "SideProcess", pads.watch)

    return plug


HELD = [0, 1, 0, 0, 0], [1, 0, 0, 0, 0], [1, 1, 0, 0, 1]
"""Buttons of a gamepad in turn: one that stays down is not pressed again, and the last is the left bumper."""


def test_a_gamepad_is_read_and_unplugged(watched: Callable[..., None]) -> None:
    watched()
    assert described_devices() == ["gamepad X360 Controller", "gamepad Test Stick"]  # gamepads first
    held = [lambda pads, button=button: pads.down.__setitem__(slice(5), button) for button in HELD]
    watched(*held, lambda pads: pads.axes.update({1: [1.0, 0.0, 0.0, 0.0, -1.0, 1.0]}))
    pad = Gamepad("x360")
    assert pad.name == "X360 Controller"
    assert pad.read() == HandState((1.0, 0.0, 1.0, 0.0, 0.0, 1.0), [1, 0, 1])
    watched(*held, lambda pads: pads.axes.pop(1))
    assert Gamepad("x360").read() == HandState(None)


def test_an_unknown_joystick_has_its_axes_in_order(watched: Callable[..., None]) -> None:
    watched(lambda pads: pads.axes.update({0: [0.0, 1.0, 0.0, 0.0]}), lambda pads: pads.axes.pop(1))
    stick = open_device("Stick")
    assert stick.name == "Test Stick"
    assert stick.read().shares == pytest.approx([0.0, -1.0, 0.0, 0.0, 0.0, 0.0])


# -- the command -----------------------------------------------------------------------------------------


class Shown:
    """Replacement of `view`'s window: a session until the target moves.

    Attributes:
        begin: Function called first.
        targets: Target of each session.
        states: State of each session.
    """

    def __init__(self) -> None:
        self.begin: Callable[[], object] = lambda: None
        self.targets: list[Any] = []
        self.states: list[str] = []

    def show(self, session: Session, *_: Any) -> ShowReport:
        session.tick(PERIOD)  # reads the rest position
        self.begin()
        waited(lambda: [session.tick(PERIOD), session.hand.device_target][1])
        self.targets.append(session.hand.device_target)
        self.states.append(session.snapshot().state)
        session.close()
        return ShowReport(0, 1.0, 1.0, 200, 0)


@pytest.fixture
def shown(monkeypatch: pytest.MonkeyPatch) -> Shown:
    """Run `view` without window or display."""
    made = Shown()
    monkeypatch.setattr(viewer_process, "show_remotely", made.show)
    monkeypatch.setattr(hand_devices, "_STILL", 1)
    monkeypatch.setattr(window, "require_display", lambda: None)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    return made


def test_view_has_its_hand_from_a_3d_mouse(path: Path, shown: Shown, capsys: pytest.CaptureFixture[str]) -> None:
    with Daemon(path) as daemon:
        shown.begin = lambda: daemon.accept().send(FULL_X + button_event(1, True))
        assert cli.main(["view", "--hand-device", "auto", "--hand-gain", "2", "--hand-invert", "x"]) == 0
    assert shown.targets == [pytest.approx([-2.0 * RANGE[0], *[0.0] * 5])]
    assert shown.states == ["paused"]  # by the button
    assert f"hand device: 3D mouse at {path}" in capsys.readouterr().out


def test_list_prints_what_is_there(
    path: Path, shown: Shown, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main(["view", "--hand-device", "list"])
    assert (ended.value.code, capsys.readouterr().out) == (0, "  no 3D mouse or gamepad detected\n")
    monkeypatch.setattr(hand_devices, "gamepad_names", lambda: ["Test Stick"])
    with Daemon(path), pytest.raises(SystemExit) as ended:
        cli.main(["view", "--hand-device", "list"])
    assert (ended.value.code, capsys.readouterr().out) == (0, f"  3D mouse at {path}\n  gamepad Test Stick\n")
    assert shown.targets == []
