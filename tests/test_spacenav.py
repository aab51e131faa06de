"""Joystick as 3D mouse: axes, socket, and all clients.

Good, slow, closed and faulty ones.
"""

from __future__ import annotations

import dataclasses
import math
import os
import socket
import stat
import struct
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj.cli import scenes as commands
from maglev_mj.cli.declare import Parser, declare, declared
from maglev_mj.cli.options import add_parameters, chosen
from maglev_mj.cli.peripherals import MouseOptions
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array
from maglev_mj.interop.spacenav import (
    FULL,
    AxisMapping,
    PoseAxes,
    RateAxes,
    SpacenavMapping,
    SpacenavServer,
    Taps,
    default_path,
)
from maglev_mj.interop.spacenav.mapping import FULL_POSE, FULL_RATE, REST, Navigation
from maglev_mj.interop.spacenav.protocol import DEVICE, EVENT, Conversation, GarbageError, button_event, motion_event
from maglev_mj.parameters import param
from maglev_mj.plants.hand import SpringHand, Trajectory
from maglev_mj.scenes import find_scene
from maglev_mj.scenes.rooms import Joystick
from maglev_mj.session import Session, Snapshot
from tests.conftest import COMPILER
from tests.processes import Program as Process
from tests.sweeps import sweep

SOURCE = Path(__file__).parents[1] / "scripts" / "examples" / "spacenav_client.c"
FRAME = 1.0 / 60.0
PATIENCE = 60.0
CHANGE, TAG = 0x7FAA5500, 0x7FAA0000
AWAY = (0.001, 0.0, 0.0, 0.0, 0.0, 0.0)
ORDER = [0, 2, 1, 3, 5, 4]


def snapshot(
    pose: Any = REST,
    time: float = 0.0,
    *,
    state: str = "running",
    anchors: Array | None = None,
    scene: str = "joystick",
) -> Snapshot:
    """Return a snapshot of a pose."""
    return Snapshot(
        scene=find_scene(scene)(),
        time=time,
        pose=np.array(pose, dtype=np.float64),
        anchors=anchors,
        state=state,
    )


def posed(numbers: Any) -> Array:
    """Return the pose for six numbers in spacenav's order."""
    x, y, z, rx, ry, rz = numbers
    pose: Array = np.array([x, z, y, rx, rz, ry]) / FULL * FULL_POSE
    return pose


def waited(ask: Callable[[], bool]) -> bool:
    """Wait until something is so, or for too long."""
    end = time.monotonic() + PATIENCE
    while not (answer := ask()) and time.monotonic() < end:
        time.sleep(0.002)
    return answer


def frames(session: Session, seconds: float, late: float = 0.0) -> Iterator[Snapshot]:
    """Yield 60 snapshots a second of a scene's time.

    Tick by tick, independent of the machine's speed.
    """
    period, shown = session.snapshot().scene.period, late
    for number in range(1, round(seconds / period) + 1):
        session.tick(period)
        if number * period >= shown:
            shown += FRAME
            yield session.snapshot()


class Clock:
    """Clock that advances one frame per reading."""

    def __init__(self, step: float = FRAME) -> None:
        self.now, self.step = 0.0, step

    def __call__(self) -> float:
        self.now += self.step
        return self.now


# -- axes ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("axis", "field", "full"),
    [
        (0, 0, 0.0045),
        (1, 2, 0.0045),
        (2, 1, 0.0045),
        (3, 3, math.radians(6.0)),
        (4, 5, math.radians(6.0)),
        (5, 4, math.radians(6.0)),
    ],
)
def test_a_deflection_to_the_stop_is_500_on_the_axis_that_points_there(
    axis: int, field: int, full: float, sign: float
) -> None:
    # In spacenav y is up and z away, for the device the other way round.
    pose, expected = [0.0] * 6, [0] * 6
    pose[axis], expected[field] = sign * full, round(sign * 500)
    assert PoseAxes()(snapshot(pose)) == tuple(expected)


def test_deflections_are_rounded_and_no_number_is_none() -> None:
    pose = posed([1.49, -1.49, 1.51, 0.4, -0.4, 1e9])
    assert PoseAxes()(snapshot(pose)) == (1, -1, 2, 0, 0, 32767)
    assert PoseAxes()(snapshot([math.nan, 0.0, 0.001, 0.0, 0.0, -math.inf])) == (0, 111, 0, 0, -32767, 0)


@pytest.mark.parametrize("axes", [PoseAxes, RateAxes])
@pytest.mark.parametrize("state", ["paused", "stopped"])
def test_where_the_scene_stands_still_nothing_moves(axes: Callable[[], Any], state: str) -> None:
    told = axes()
    told(snapshot(AWAY, 0.0))
    assert told(snapshot([0.003] * 6, FRAME, state=state)) == REST
    # nor is what has happened meanwhile a motion, where it goes on
    told = RateAxes()
    told(snapshot(AWAY, 0.0))
    told(snapshot(AWAY, FRAME, state=state))
    assert told(snapshot([0.0] * 6, 2 * FRAME)) == REST
    assert not told.navigator.slave.any()


def test_a_scene_that_begins_anew_is_no_motion() -> None:
    told = RateAxes()
    told(snapshot(AWAY, 5.0))
    assert told(snapshot([0.0] * 6, 0.005)) == REST
    assert told(snapshot(AWAY, 0.005 + FRAME)) != REST


@pytest.mark.parametrize(("friction", "seed"), sweep([True, False], range(2), every=2))
def test_a_program_that_adds_up_rates_goes_the_way_of_the_slave(seed: int, friction: bool) -> None:
    # At every moment within half a unit of it, however irregular the moments are.
    random = np.random.default_rng(seed)
    told, time, went, pose = RateAxes(Navigation(scale=2.0)), 0.0, np.zeros(6), np.zeros(6)
    unit = FULL_RATE / FULL
    told(snapshot(pose, time))
    for _ in range(3000):
        elapsed = float(random.choice([0.005, 0.015, 0.02, 0.035]))
        time += elapsed
        pose = np.clip(pose + random.normal(0.0, 0.03, 6) * FULL_POSE, -FULL_POSE, FULL_POSE)
        anchors = np.where(random.random(6) < 0.5, pose, np.nan) if friction else None
        went += np.array(told(snapshot(pose, time, anchors=anchors)))[ORDER] * unit * elapsed
        assert (np.abs(went - told.navigator.slave) <= 0.5000001 * unit * elapsed).all()
    assert (np.abs(told.navigator.slave) > 100.0 * unit * 0.035).any()


def test_a_full_rate_is_500_at_the_stops() -> None:
    told = RateAxes()
    pose = [0.0045, 0.0, 0.0, 0.0, 0.0, -math.radians(6.0)]
    told(snapshot(pose, 0.0))
    assert told(snapshot(pose, 0.02)) == (500, 0, 0, 0, -500, 0)


# -- the mapping -----------------------------------------------------------------------------------------


MAPPED: list[tuple[dict[str, Any], Callable[[list[int]], list[int]]]] = [
    ({"gain": 2.0}, lambda row: [2 * number for number in row[:3]] + row[3:]),
    ({"turning_gain": 0.5}, lambda row: row[:3] + [number // 2 for number in row[3:]]),
    ({"dead_zone": 0.2}, lambda row: [250 * (number // 300) for number in row]),
    ({"dead_zone": 0.6}, lambda row: [0] * 6),
    ({"order": "z,0,x,rz,rx,y"}, lambda row: [row[2], 0, row[0], row[5], row[3], row[1]]),
    ({"invert": "y,rx"}, lambda row: [row[0], -row[1], row[2], -row[3], *row[4:]]),
    ({"order": "z,y,x,rx,ry,rz", "invert": "x"}, lambda row: [-row[2], row[1], row[0], *row[3:]]),
    ({"dominant": True}, lambda row: [300 * (number // 300) for number in row]),
    ({"dominant": True, "gain": 0.0}, lambda row: [0, 0, 0, *dominant(row[3:])]),
]
"""Settings and their effect on rows of numbers.

One number of a row is 300, the next 100, and the others 0.
"""


def dominant(row: list[int]) -> list[int]:
    return [number if number == max(row) else 0 for number in row]


def deflected(axis: int) -> list[int]:
    """Return 300 on one axis and 100 on the next."""
    return [[300, 100, 0, 0, 0, 0][(index - axis) % 6] for index in range(6)]


@pytest.mark.parametrize(("settings", "expected"), MAPPED)
@pytest.mark.parametrize("axis", range(6))
def test_each_setting_does_what_it_says_on_each_axis(
    settings: dict[str, Any], expected: Callable[[list[int]], list[int]], axis: int
) -> None:
    row = deflected(axis)
    assert list(PoseAxes(AxisMapping(**settings))(snapshot(posed(row)))) == expected(row)
    mirrored = PoseAxes(AxisMapping(**settings))(snapshot(-posed(row)))
    assert list(mirrored) == [-number for number in expected(row)]


@pytest.mark.parametrize(
    ("settings", "expected"), [(given, expected) for given, expected in MAPPED if "dead_zone" not in given]
)
@pytest.mark.parametrize("axis", range(6))
def test_each_setting_does_the_same_to_rates(
    settings: dict[str, Any], expected: Callable[[list[int]], list[int]], axis: int
) -> None:
    row, told = deflected(axis), RateAxes(mapping=AxisMapping(**settings))
    told(snapshot([0.0] * 6, 0.0))
    way = np.array(row)[ORDER] / FULL * FULL_RATE * FRAME  # within the edge, where a slave goes as far as the flotor
    assert list(told(snapshot(way, FRAME))) == expected(row)


@pytest.mark.parametrize("axis", range(6))
def test_the_dead_zone_of_rates_is_one_of_the_deflection(axis: int) -> None:
    told, full = RateAxes(mapping=AxisMapping(dead_zone=0.2)), np.eye(6)[axis] * FULL_POSE
    for number in range(20):
        assert told(snapshot(0.0099 * number * full, number * FRAME)) == REST
    assert told(snapshot(0.21 * full, FRAME * 20)) != REST


def test_a_full_deflection_stays_full_beside_a_dead_zone_and_nothing_jumps() -> None:
    mapping, step = AxisMapping(dead_zone=0.3), np.linspace(-1.2, 1.2, 2401)
    outside = np.array([mapping.outside(share * FULL_POSE, FULL_POSE) / FULL_POSE for share in step])
    assert np.abs(np.diff(outside, axis=0)).max() < 0.0015
    assert outside[200] == pytest.approx(-1.0) and outside[2200] == pytest.approx(1.0)


def test_a_dominant_axis_is_the_only_one_in_every_event() -> None:
    random = np.random.default_rng(0)
    told, pose, time, seen = RateAxes(mapping=AxisMapping(dominant=True)), np.zeros(6), 0.0, set()
    for _ in range(1000):
        time += float(random.choice([0.005, 0.015, 0.035]))
        pose = pose + random.normal(0.0, 0.02, 6) * FULL_POSE
        numbers = told(snapshot(pose, time))
        assert sum(number != 0 for number in numbers) <= 1
        seen |= {index for index, number in enumerate(numbers) if number}
    assert seen == set(range(6))


@pytest.mark.parametrize(
    ("settings", "complaint"),
    [
        ({"gain": -1.0}, "gain must be "),
        ({"turning_gain": math.nan}, "turning_gain must be "),
        ({"dead_zone": 0.95}, "dead_zone must be "),
        ({"order": "x,y,z"}, "order must be six of "),
        ({"order": "x,y,z,rx,ry,w"}, "order must be six of "),
        ({"invert": "up"}, "invert must be none, or some of "),
        ({"invert": "x,x"}, "invert must be none, or some of "),
        ({"invert": ""}, "invert must be none, or some of "),
        ({"dominant": 1}, "dominant must be True or False"),
        ({"press": 0.0}, "press must be "),
    ],
)
def test_a_setting_that_cannot_be_is_refused_in_one_line(settings: dict[str, Any], complaint: str) -> None:
    with pytest.raises(ParameterError, match=f"^{complaint}[^\n]*, not [^\n]*$"):
        SpacenavMapping(**settings)


# -- the buttons -----------------------------------------------------------------------------------------

WALLS = ((2, 1.0, -0.0035), (2, -1.0, 0.0035))


def pressed(force: float, time: float, *, z: float | None = None, state: str = "running", button: int = 0) -> Snapshot:
    """Return a snapshot of a handle pressed on a wall.

    The lower or the upper one.
    """
    sign = -1.0 if button else 1.0
    depth = 0.0036 if z is None else z
    return dataclasses.replace(
        snapshot([0.0, 0.0, -sign * depth, 0.0, 0.0, 0.0], time, state=state),
        force=np.array([0.0, 0.0, sign * force, 0.0, 0.0, 0.0]),
        faces=WALLS,
    )


def taps(forces: Iterable[float], button: int = 0, **keywords: Any) -> list[tuple[bool, ...]]:
    """Return the clicks of taps of 4 N.

    One force in each frame, with the handle released after them.
    """
    buttons = Taps(4.0)
    frames = [*forces, 0.0, 0.0]
    return [buttons(pressed(force, number * FRAME, button=button, **keywords)) for number, force in enumerate(frames)]


@pytest.mark.parametrize("button", [0, 1])
@pytest.mark.parametrize(
    ("forces", "clicks"),
    [
        ([3.0, 5.0, 5.0, 3.0], [4]),  # 67 ms
        ([5.0] * 9, [9]),  # 150 ms
        ([5.0] * 3, []),  # 50 ms: a bounce
        ([5.0] * 10, []),  # 167 ms: it leans there
        ([3.9] * 6, []),  # too soft
        ([2.1, 4.0, 2.1, 4.0, 2.1], [5]),  # one tap, however often it passes the threshold
        ([1.9, 4.0, 4.0, 4.0, 4.0, 1.9, 1.9], [5]),
        ([5.0] * 5 + [0.0] * 3 + [5.0] * 5, [5, 13]),
        ([5.0] * 5 + [0.0] * 3 + [3.0] * 5, [5]),  # the second is too soft
    ],
)
def test_a_tap_is_a_short_press_and_a_click_of_one_frame(forces: list[float], clicks: list[int], button: int) -> None:
    down = taps(forces, button)
    assert [number for number, both in enumerate(down) if both[button]] == clicks
    assert not any(both[1 - button] for both in down)


def test_a_press_outside_the_walls_or_of_a_scene_that_stands_still_is_no_tap() -> None:
    assert not any(map(any, taps([5.0] * 5, z=0.0034)))
    assert not any(map(any, taps([5.0] * 5, state="paused")))
    assert not any(map(any, taps([-5.0] * 5)))


def moves(scene: Joystick, hand: SpringHand, seconds: float) -> tuple[list[int], float]:
    """Return button presses and the largest force along z."""
    session, buttons, counts, most = Session(scene, hand=hand), Taps(4.0), [0, 0], 0.0
    for shown in frames(session, seconds):
        counts = [count + down for count, down in zip(counts, buttons(shown))]
        most = max(most, abs(float(shown.force[2])))
    session.close()
    return counts, most


@pytest.mark.parametrize(
    ("stiffness", "reach", "friction"),
    sweep([200.0, 700.0, 3000.0], [0.005, 0.008, 0.02], [False, True], every=3),
)
def test_a_hand_that_moves_up_and_down_taps_nothing(stiffness: float, reach: float, friction: bool) -> None:
    random = np.random.default_rng(int(stiffness + 1e4 * reach) + friction)
    phase, times = random.uniform(0.0, 2.0 * math.pi), np.arange(0.01, 3.2, 0.01)
    height = reach * np.minimum(times, 1.0) * np.sin(2.0 * math.pi * random.uniform(0.3, 1.0) * times + phase)
    path = Trajectory(times, [[0.0, 0.0, z, 0.0, 0.0, 0.0] for z in height])
    hand = SpringHand(stiffness=stiffness, damping=max(10.0, 0.01 * stiffness), target=path)
    counts, most = moves(Joystick(friction=friction), hand, 3.0)
    assert counts == [0, 0]
    assert reach < 0.02 or most > 1.0  # and it does reach the walls


@pytest.mark.parametrize(
    ("stiffness", "start", "sign"),
    sweep([1000.0, 2000.0], [0.300, 0.3037, 0.3081, 0.3129], [-1.0, 1.0], every=4),
)
def test_a_hand_that_taps_a_wall_clicks_once_for_each_tap(stiffness: float, start: float, sign: float) -> None:
    # From rest beside the wall, there and back within 0.18 s, at any phase of samples and frames.
    times, heights = [0.0], [0.003]
    for begin in (start, start + 0.5):
        times += [begin, begin + 0.09, begin + 0.18]
        heights += [0.003, 0.014, 0.003]
    path = Trajectory(times, [[0.0, 0.0, sign * z, 0.0, 0.0, 0.0] for z in heights])
    counts, _ = moves(Joystick(), SpringHand(stiffness=stiffness, damping=20.0, target=path), 1.3)
    assert counts == ([2, 0] if sign < 0.0 else [0, 2])


# -- the protocol ----------------------------------------------------------------------------------------


def request(number: int, *data: int, tag: int = TAG) -> bytes:
    return struct.pack("=8i", tag | number, *data, *[0] * (7 - len(data)))


def in_protocol_1() -> Conversation:
    talk = Conversation()
    assert talk.hear(struct.pack("=I", CHANGE | 1)) == struct.pack("=I", CHANGE | 1)
    return talk


@pytest.mark.parametrize(("asked", "given"), [(0, 0), (1, 1), (2, 1), (255, 1)])
def test_no_newer_protocol_than_1_is_agreed_on(asked: int, given: int) -> None:
    talk = Conversation()
    assert talk.hear(struct.pack("=I", CHANGE | asked)) == struct.pack("=I", CHANGE | given)
    assert talk.version == given


def test_what_comes_in_pieces_is_answered_when_it_is_whole() -> None:
    talk = Conversation()
    data = struct.pack("=I", CHANGE | 1)
    assert [talk.hear(bytes([byte])) for byte in data] == [b"", b"", b"", data]
    question = request(0x2002)
    answers = [talk.hear(bytes([byte])) for byte in question]
    assert answers[:-1] == [b""] * 31 and answers[-1] == struct.pack("=8i", TAG | 0x2002, 6, *[0] * 6)


def test_sensitivities_of_protocol_0_are_taken_without_a_word() -> None:
    talk = Conversation()
    assert talk.hear(struct.pack("=5f", 1.0, 0.5, -2.0, math.nan, math.inf)) == b"" and talk.version == 0
    assert talk.sensitivity == -2.0


def test_a_sensitivity_is_answered_as_it_was_set() -> None:
    talk = in_protocol_1()
    bits = struct.unpack("=i", struct.pack("=f", 0.3))[0]
    talk.hear(request(0x1001, bits))
    assert talk.hear(request(0x1002)) == struct.pack("=8i", TAG | 0x1002, bits, *[0] * 6)
    talk.hear(request(0x1001, 0x7F800000))  # refused: the last one stays
    assert talk.hear(request(0x1002)) == struct.pack("=8i", TAG | 0x1002, bits, *[0] * 6)


@pytest.mark.parametrize(
    ("sensitivity", "expected"),
    [
        (1.0, (1, -2, 3, -4, 500, -32767)),
        (0.5, (0, -1, 2, -2, 250, -16384)),
        (-2.0, (-2, 4, -6, 8, -1000, 32767)),
        (1e3, (1000, -2000, 3000, -4000, 32767, -32767)),
        (3e38, (1, -2, 3, -4, 500, -32767)),  # no sensible one
        (0.0, (1, -2, 3, -4, 500, -32767)),
    ],
)
def test_a_sensitivity_multiplies_every_axis(sensitivity: float, expected: tuple[int, ...]) -> None:
    talk = Conversation()
    talk.hear(struct.pack("=f", sensitivity))
    assert talk.scaled((1, -2, 3, -4, 500, -32767)) == expected


def test_a_program_that_has_not_waited_for_the_answer_is_not_given_one() -> None:
    # After 0.3 s libspnav takes the server for an old one; an answer would be an event to it.
    talk = Conversation()
    assert talk.hear(struct.pack("=If", CHANGE | 1, 1.0)) == b"" and talk.version == 0


@pytest.mark.parametrize(
    ("number", "data", "answer"),
    [
        (0x1001, (0x3F000000,), (0, 0, 0, 0, 0, 0, 0)),
        (0x1001, (0x7F800000,), (0, 0, 0, 0, 0, 0, -1)),  # an infinite sensitivity
        (0x1001, (0x7FC00000,), (0, 0, 0, 0, 0, 0, -1)),  # one that is no number
        (0x1001, (0,), (0, 0, 0, 0, 0, 0, -1)),  # what libspnav 1.0 sends for 0.5
        (0x1001, (0x33333333,), (0, 0, 0, 0, 0, 0, -1)),  # and for 0.3
        (0x1002, (), (0x3F800000, 0, 0, 0, 0, 0, 0)),
        (0x1003, (2,), (0, 0, 0, 0, 0, 0, 0)),
        (0x1004, (), (0xFFFF, 0, 0, 0, 0, 0, 0)),
        (0x2001, (), (0, 0, 0, 0, 0, 0, -1)),  # no device file
        (0x2002, (), (6, 0, 0, 0, 0, 0, 0)),
        (0x2003, (), (2, 0, 0, 0, 0, 0, 0)),
        (0x2004, (), (0, 0, 0, 0, 0, 0, -1)),  # no USB device
        (0x2005, (), (0, 0, 0, 0, 0, 0, 0)),
        (0x3000, (7,), (0, 0, 0, 0, 0, 0, -1)),
        (0x3FFE, (), (0, 0, 0, 0, 0, 0, -1)),
    ],
)
def test_each_request_has_its_answer(number: int, data: tuple[int, ...], answer: tuple[int, ...]) -> None:
    assert in_protocol_1().hear(request(number, *data)) == struct.pack("=8i", TAG | number, *answer)


def test_the_name_is_said_and_that_of_a_program_is_not_answered() -> None:
    talk = in_protocol_1()
    assert talk.hear(struct.pack("=i24si", 0x1000, b"a program", 9)) == b""
    answer = talk.hear(request(0x2000))
    assert answer == struct.pack("=i24si", TAG | 0x2000, DEVICE, len(DEVICE))


@pytest.mark.parametrize("first", [b"GET ", b"\0\0\0\0", b"\xff\xff\xff\xff", struct.pack("=i", TAG | 0x0FFF)])
def test_what_is_no_request_is_garbage(first: bytes) -> None:
    with pytest.raises(GarbageError):
        in_protocol_1().hear(first + bytes(28))


# -- the socket ------------------------------------------------------------------------------------------


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "s.sock"


def mode(path: Path) -> int:
    return stat.S_IMODE(path.lstat().st_mode)


@pytest.mark.parametrize("mask", [0o000, 0o022, 0o777])
def test_the_socket_is_this_users_alone_from_its_first_moment(
    path: Path, mask: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    modes = []

    class Watched(socket.socket):
        def bind(self, address: Any) -> None:
            super().bind(address)
            modes.append(mode(path))

    monkeypatch.setattr(socket, "socket", Watched)
    before = os.umask(mask)
    try:
        server = SpacenavServer(path)
        assert os.umask(mask) == mask
    finally:
        os.umask(before)
    assert modes == [0o600] and mode(path) == 0o600
    server.close()


def test_the_socket_goes_with_the_server_and_a_second_close_does_nothing(path: Path) -> None:
    server = SpacenavServer(path)
    assert path.is_socket()
    server.close()
    server.close()
    assert not path.exists()


def test_what_a_dead_server_has_left_is_replaced(path: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as dead:
        dead.bind(str(path))
    assert path.is_socket()
    server = SpacenavServer(path)
    assert mode(path) == 0o600
    with Program(path) as program:
        program.open(server)
    server.close()


def test_a_living_servers_socket_is_refused_and_left_alone(path: Path) -> None:
    server = SpacenavServer(path)
    with pytest.raises(ParameterError, match=r"^socket must be one that no other server has, not "):
        SpacenavServer(path)
    with Program(path) as program:
        program.open(server)
    server.close()


def test_a_server_does_not_remove_what_another_has_put_there(path: Path) -> None:
    first = SpacenavServer(path)
    path.unlink()
    second = SpacenavServer(path)
    first.close()
    assert path.is_socket()
    second.close()
    assert not path.exists()


def test_a_path_where_no_socket_can_be_is_refused_in_one_line(tmp_path: Path) -> None:
    file, folder, link = tmp_path / "file", tmp_path / "folder", tmp_path / "link"
    file.write_text("mine")
    folder.mkdir()
    link.symlink_to(file)
    long = tmp_path / ("s" * 108)
    for wrong in (file, folder, link, tmp_path / "none" / "s.sock", long):
        with pytest.raises(ParameterError, match=r"^socket must be [^\n]*, not [^\n]*$"):
            SpacenavServer(wrong)
    assert file.read_text() == "mine" and folder.is_dir() and link.is_symlink()


def test_a_path_of_107_bytes_is_the_longest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    server = SpacenavServer(Path("s" * 107))
    server.close()
    with pytest.raises(ParameterError, match="at most 107 bytes, not 108"):
        SpacenavServer(Path("ö" * 54))


def test_the_socket_is_where_the_environment_says(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(tempfile, "gettempdir", lambda: str(tmp_path))
    monkeypatch.setenv("SPNAV_SOCKET", "/some/where.sock")
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/run/user/7")
    assert default_path() == Path("/some/where.sock")
    monkeypatch.setenv("SPNAV_SOCKET", "")
    assert default_path() == Path("/run/user/7/maglev-spnav.sock")
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    assert default_path() == tmp_path / f"maglev-spnav-{os.getuid()}.sock"


# -- programs --------------------------------------------------------------------------------------------


class Program:
    """A program on the socket, by hand."""

    def __init__(self, path: Path) -> None:
        self.line = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        # a server's file is there a moment before it listens
        if not waited(lambda: self.line.connect_ex(str(path)) == 0):
            self.line.close()
            pytest.fail(f"nobody listens at {path}")
        self.line.setblocking(False)

    def __enter__(self) -> Program:
        return self

    def __exit__(self, *_: object) -> None:
        self.line.close()

    def open(self, server: SpacenavServer) -> None:
        """Agree on protocol 1."""
        self.line.send(struct.pack("=I", CHANGE | 1))
        server.show(snapshot())
        assert self.line.recv(4) == struct.pack("=I", CHANGE | 1)

    def events(self) -> list[tuple[int, ...]]:
        """Return the received events."""
        try:
            data = self.line.recv(1 << 20)
        except BlockingIOError:
            return []
        assert len(data) % EVENT == 0
        return list(struct.iter_unpack("=8i", data))


@pytest.fixture
def server(path: Path) -> Iterator[SpacenavServer]:
    server = SpacenavServer(path, clock=Clock())
    yield server
    server.close()


def test_an_event_has_its_fields_in_order_and_says_how_long_it_has_been(server: SpacenavServer) -> None:
    with Program(server.path) as program:
        program.open(server)
        for numbers in ((1, -2, 3, -4, 5, -6), (1, -2, 3, -4, 5, -6)):
            server.show(snapshot(posed(numbers)))
        assert program.events() == [(0, 1, -2, 3, -4, 5, -6, 17), (0, 1, -2, 3, -4, 5, -6, 17)]
    assert motion_event((1, -2, 3, -4, 5, -6), 17) == struct.pack("=8i", 0, 1, -2, 3, -4, 5, -6, 17)


def test_at_rest_there_is_one_event_of_zeros_and_then_silence(server: SpacenavServer) -> None:
    with Program(server.path) as program, Program(server.path) as idle:
        program.open(server)
        for _ in range(3):
            server.show(snapshot())
        server.show(snapshot(AWAY))
        idle.open(server)  # this shows a rest
        for _ in range(3):
            server.show(snapshot())
        assert [event[1:7] for event in program.events()] == [(111, 0, 0, 0, 0, 0), REST]
        assert idle.events() == []


@pytest.mark.parametrize(("pose", "naps"), [(AWAY, [0.2]), (REST, [])])
def test_a_server_that_closes_waits_for_programs_in_motion_alone(
    path: Path, pose: tuple[float, ...], naps: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    server, slept = SpacenavServer(path), list[float]()
    monkeypatch.setattr(time, "sleep", slept.append)
    with Program(path) as program:
        program.open(server)
        server.show(snapshot(pose))
        server.close()
        moved = [(111, 0, 0, 0, 0, 0), REST]
        assert [event[1:7] for event in program.events()] == (moved if naps else [])
        assert program.line.recv(1) == b""
    assert slept == naps


def test_nothing_is_said_before_the_answer_to_the_first_request(server: SpacenavServer) -> None:
    # The first four bytes that come are what libspnav reads as its answer.
    with Program(server.path) as program:
        for _ in range(5):
            server.show(snapshot(AWAY))
        program.line.send(struct.pack("=I", CHANGE | 1))
        server.show(snapshot(AWAY))
        server.show(snapshot(AWAY))
        assert program.line.recv(4) == struct.pack("=I", CHANGE | 1)
        assert len(program.events()) == 1


def test_between_a_request_and_the_next_nothing_else_is_said_and_no_rest_is_lost(server: SpacenavServer) -> None:
    # What comes next is what libspnav takes for its answer.
    with Program(server.path) as program:
        program.open(server)
        server.show(snapshot(AWAY))
        assert len(program.events()) == 1
        for _ in range(3):
            program.line.send(request(0x2002))
            server.show(snapshot())
            assert [event[0] for event in program.events()] == [TAG | 0x2002]
        server.show(snapshot())
        assert [event[1:7] for event in program.events()] == [REST]


def test_a_program_that_does_not_read_misses_events_and_the_others_none(server: SpacenavServer) -> None:
    # One that takes long to start, as Blender does, has its 3D mouse once it reads.
    with Program(server.path) as good, Program(server.path) as stalled:
        good.open(server)
        stalled.open(server)
        got: list[tuple[int, ...]] = []
        for number in range(1, 1001):
            server.show(snapshot(posed([number, 0, 0, 0, 0, 0])))
            got += good.events()
        server.show(snapshot())  # a rest for which there is no room either
        assert [event[1] for event in got] == list(range(1, 1001))
        read = [event[1] for event in stalled.events()]
        assert 200 < len(read) < 400 and read == list(range(1, len(read) + 1))
        assert (server.missed, server.dropped, len(server.clients)) == (1001 - len(read), 0, 2)
        server.show(snapshot())
        assert [event[1:7] for event in stalled.events()] == [REST]
        assert [event[1:7] for event in good.events()] == [REST]


@pytest.fixture
def clicking(path: Path) -> Iterator[SpacenavServer]:
    """Return a server with buttons pressed away from the centre.

    By x and y of the pose.
    """
    server = SpacenavServer(
        path, clock=Clock(), buttons=lambda shown: (bool(shown.pose[0] > 0.0), bool(shown.pose[1] > 0.0))
    )
    yield server
    server.close()


def clicks(program: Program) -> list[tuple[int, ...]]:
    """Return a client's button events: press or release, and number."""
    return [event[:2] for event in program.events() if event[0]]


PRESS, RELEASE = 1, 2


def test_a_button_is_pressed_and_released_once(clicking: SpacenavServer) -> None:
    with Program(clicking.path) as program:
        program.open(clicking)
        for pose in (AWAY, AWAY, REST, (0.0, 0.001, 0.0, 0.0, 0.0, 0.0), (0.001, 0.001, 0.0, 0.0, 0.0, 0.0), REST):
            clicking.show(snapshot(pose))
        heard = [(PRESS, 0), (RELEASE, 0), (PRESS, 1), (PRESS, 0), (RELEASE, 0), (RELEASE, 1)]
        assert clicks(program) == heard
    assert button_event(1, True) == struct.pack("=8i", 1, 1, 1, 0, 0, 0, 0, 0)
    assert button_event(1, False) == struct.pack("=8i", 2, 1, 0, 0, 0, 0, 0, 0)


def test_a_press_for_which_there_is_no_room_is_told_when_there_is(clicking: SpacenavServer) -> None:
    with Program(clicking.path) as program:
        program.open(clicking)
        for number in range(1, 500):
            clicking.show(snapshot(posed([-number, 0, 0, 0, 0, 0])))
        clicking.show(snapshot(AWAY))
        assert clicks(program) == []
        clicking.show(snapshot(AWAY))
        clicking.show(snapshot())
        assert clicks(program) == [(PRESS, 0), (RELEASE, 0)]


def test_a_button_that_is_down_as_a_server_closes_or_a_program_asks_is_released_all_the_same(path: Path) -> None:
    server = SpacenavServer(path, buttons=lambda shown: (bool(shown.pose[0] > 0.0), False))
    with Program(path) as program:
        program.open(server)
        server.show(snapshot(AWAY))
        program.line.send(request(0x2002))
        server.show(snapshot())  # the answer, and nothing else
        server.show(snapshot())
        server.show(snapshot(AWAY))
        server.close()
        assert [event[:2] for event in program.events() if event[0] in (PRESS, RELEASE)] == [(1, 0), (2, 0)] * 2


@pytest.mark.parametrize("mask", [0, 1, 2, 3])
def test_a_program_hears_of_buttons_and_of_motion_as_it_wants(clicking: SpacenavServer, mask: int) -> None:
    with Program(clicking.path) as program:
        program.open(clicking)
        program.line.send(request(0x1003, mask))
        clicking.show(snapshot())
        program.line.send(request(0x1004))
        clicking.show(snapshot())
        assert program.events()[-1][:2] == (TAG | 0x1004, mask)
        clicking.show(snapshot(AWAY))
        clicking.show(snapshot())
        kinds = [event[0] for event in program.events()]
        assert (0 in kinds, PRESS in kinds, RELEASE in kinds) == (bool(mask & 1), bool(mask & 2), bool(mask & 2))


def test_a_program_that_never_asks_is_told_of_buttons_too(clicking: SpacenavServer) -> None:
    with Program(clicking.path) as program:
        for number in range(120):
            clicking.show(snapshot(AWAY if number % 2 else REST))
        heard = clicks(program)
        assert heard == [(PRESS, 0), (RELEASE, 0)] * (len(heard) // 2) + [(PRESS, 0)] * (len(heard) % 2)
        assert 55 < len(heard) < 65


def test_each_program_has_its_own_sensitivity_in_either_protocol(server: SpacenavServer) -> None:
    with Program(server.path) as old, Program(server.path) as half, Program(server.path) as plain:
        old.line.send(struct.pack("=f", -3.0))
        half.open(server)
        plain.open(server)
        half.line.send(request(0x1001, 0x3F000000))
        server.show(snapshot())
        assert [event[7] for event in half.events()] == [0]
        server.show(snapshot(posed([100, -200, 0, 0, 0, 10])))
        server.show(snapshot(posed([0, 0, 0, 0, 0, 0])))
        rows = [[event[1:7] for event in program.events()] for program in (old, half, plain)]
        assert rows == [
            [(-300, 600, 0, 0, 0, -30), REST],
            [(50, -100, 0, 0, 0, 5), REST],
            [(100, -200, 0, 0, 0, 10), REST],
        ]


def test_a_motion_that_a_sensitivity_rounds_away_is_rest(server: SpacenavServer) -> None:
    with Program(server.path) as program:
        program.line.send(struct.pack("=f", 0.1))
        for numbers in ([0, 0, 0, 0, 0, 0], [40, 0, 0, 0, 0, 0], [4, 0, 0, 0, 0, 0], [3, 0, 0, 0, 0, 0]):
            server.show(snapshot(posed(numbers)))
        assert [event[1:7] for event in program.events()] == [(4, 0, 0, 0, 0, 0), REST]


@pytest.mark.parametrize("reset", [False, True])
def test_a_program_that_goes_away_is_forgotten_and_not_called_slow(server: SpacenavServer, reset: bool) -> None:
    with Program(server.path) as good, Program(server.path) as gone:
        good.open(server)
        gone.open(server)
        if reset:  # something unread makes the end of the line an error
            server.show(snapshot(AWAY))
        gone.line.close()
        for _ in range(3):
            server.show(snapshot(AWAY))
        assert (server.missed, server.dropped, len(server.clients)) == (0, 0, 1)
        assert len(good.events()) == 3 + reset


def test_programs_that_send_rubbish_are_let_go_and_the_others_miss_nothing(server: SpacenavServer) -> None:
    random = np.random.default_rng(1)
    with Program(server.path) as good:
        good.open(server)
        for round_ in range(30):
            with Program(server.path) as bad:
                bad.open(server)
                bad.line.send(b"\xee" + random.bytes(31 + round_ * 40))
                server.show(snapshot(AWAY))
                assert len(server.clients) == 1
        assert server.dropped == 30
        assert [event[1] for event in good.events()].count(111) == 30


def test_no_more_than_16_programs_are_taken(server: SpacenavServer) -> None:
    programs = []
    for count in range(20):
        programs.append(Program(server.path))
        server.show(snapshot())
        assert len(server.clients) == min(count + 1, 16)
    assert (server.refused, server.dropped) == (4, 0)
    assert [program.line.recv(1) for program in programs[16:]] == [b""] * 4
    programs[0].line.close()
    server.show(snapshot())
    programs[0] = Program(server.path)
    server.show(snapshot())
    assert len(server.clients) == 16
    for program in programs:
        program.line.close()


# -- libspnav --------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the program in C, compiled."""
    program = tmp_path_factory.mktemp("client") / "spacenav_client"
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-O2"]
    command = [str(COMPILER), *flags, str(SOURCE), "-o", str(program), "-lspnav", "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    return program


class Running(Process):
    """Client in C, which has asked all that it wants to know.

    Attributes:
        said: Its first line.
    """

    def __init__(self, program: Path, server: SpacenavServer, *arguments: str) -> None:
        super().__init__(str(program), *arguments, env={"SPNAV_SOCKET": str(server.path)})

        def answered() -> bool:
            server.show(snapshot())
            return "\n" in self.output

        assert waited(answered)
        self.said = self.line()

    def finish(self) -> int:
        """Let it end; return its exit status."""
        assert self.child.stdin is not None
        self.child.stdin.close()
        status = self.end(None).status
        self.close()
        return status


SAID = "protocol 1, device 'maglev_mj' (9), 6 axes, 2 buttons, type 0"


def rows(count: int) -> list[tuple[int, ...]]:
    """Return events with all different numbers."""
    return [(n + 1, -(n + 2), 2 * n + 3, -(2 * n + 4), 3 * n + 5, -(3 * n + 7)) for n in range(count)]


@pytest.mark.needs("compiler", "spnav")
def test_libspnav_reads_500_of_500_events_with_the_right_values(
    client: Path, server: SpacenavServer, tmp_path: Path
) -> None:
    expected = rows(500)
    file = tmp_path / "rows"
    file.write_text("\n".join(" ".join(map(str, row)) for row in expected), encoding="ascii")
    stalled = Running(client, server, "stall")
    program = Running(client, server, "500", str(file))
    assert program.said == stalled.said == SAID
    for row in expected:
        server.show(snapshot(posed(row)))
        assert [int(part) for part in program.line().split()[:6]] == list(row)
    assert program.line().startswith("moved ")
    assert program.line() == "500 of 500 events as expected"
    assert program.finish() == 0
    assert (server.dropped, len(server.clients)) == (0, 2)  # their end has not been looked at yet
    assert server.missed > 0
    assert stalled.finish() == 0


@pytest.mark.needs("compiler", "spnav")
def test_libspnav_hears_each_press_and_its_release(client: Path, clicking: SpacenavServer) -> None:
    program = Running(client, clicking, "8")
    for number in range(6):
        clicking.show(snapshot(np.eye(6)[number % 2] * 0.001))
    clicking.show(snapshot())
    clicking.show(snapshot(AWAY))  # a motion more, at which it ends
    lines = [program.line() for _ in range(8 + 12)]
    for button in "01":
        said = [line.split()[2] for line in lines if line.startswith(f"button {button}")]
        assert said == ["pressed", "released"] * 3
    assert program.finish() == 0


@pytest.mark.needs("compiler", "spnav")
@pytest.mark.parametrize(
    ("axis", "moved", "turned"),
    [
        (0, (0.5, 0.0, 0.0), (0.0, 0.0, 0.0)),  # to the right
        (1, (0.0, 0.0, -0.5), (0.0, 0.0, 0.0)),  # away from the person: libspnav's object has z towards him
        (2, (0.0, 0.5, 0.0), (0.0, 0.0, 0.0)),  # up
        (3, (0.0, 0.0, 0.0), (0.25, 0.0, 0.0)),
        (4, (0.0, 0.0, 0.0), (0.0, 0.0, -0.25)),
        (5, (0.0, 0.0, 0.0), (0.0, 0.25, 0.0)),
    ],
)
def test_libspnav_moves_an_object_where_the_joystick_goes(
    client: Path, server: SpacenavServer, axis: int, moved: tuple[float, ...], turned: tuple[float, ...]
) -> None:
    # A unit for each thousand, a radian likewise, of which a quaternion has half the sine.
    pose = np.zeros(6)
    pose[axis] = FULL_POSE[axis]
    program = Running(client, server, "1")
    server.show(snapshot(pose))
    program.line()
    where, how = program.line().removeprefix("moved ").split(", turned ")
    assert [float(part) for part in where.split()] == pytest.approx(moved, abs=1e-3)
    sines = [math.copysign(math.sin(abs(part)), part) for part in turned]
    assert [float(part) for part in how.split()[:3]] == pytest.approx(sines, abs=1e-3)
    assert program.line() == "1 of 1 events" and program.finish() == 0


# -- the command line ------------------------------------------------------------------------------------


def parsed(*arguments: str) -> MouseOptions:
    parser = Parser(prog="test")
    return declared(MouseOptions, parser)(parser.parse_args(arguments))


def test_the_option_opens_a_server_and_says_how_programs_find_it(path: Path) -> None:
    assert parsed().open(pytest.fail) == []
    said: list[str] = []
    (server,) = parsed("--spacenav", "--socket", str(path), "--axes", "rate").open(said.append)
    assert server.path == path and path.is_socket()
    assert said[1].endswith(f"export SPNAV_SOCKET={path}")
    server.close()


def test_each_setting_is_an_option(path: Path) -> None:
    words = "--spacenav-gain 2 --spacenav-turning-gain 0.5 --spacenav-dead-zone 0.1 --spacenav-order x,y,z,0,0,0"
    more = "--spacenav-invert x,z --spacenav-dominant --spacenav-press 4"
    options = parsed("--spacenav", "--socket", str(path), *words.split(), *more.split())
    (server,) = options.open(len)
    with Program(server.path) as program:
        program.open(server)
        server.show(snapshot(posed([300, 100, -400, 0, 0, 500])))
        for _ in range(6):
            server.show(dataclasses.replace(pressed(5.0, time=1.0), pose=np.array([0.0, 0.0, -0.0036, 0.0, 0.0, 0.0])))
        assert program.events()[0][1:7] == (0, 0, 778, 0, 0, 0)
    server.close()


def test_an_option_of_a_scene_may_have_the_name_of_a_setting(tmp_path: Path) -> None:
    class Gained(Joystick):
        gain: float = param("its own", default=3.0)

    parser = Parser(prog="test")
    declared(MouseOptions, parser)
    add_parameters(parser, Gained)
    options = parser.parse_args(["--spacenav", "--gain", "5", "--spacenav-gain", "7"])
    assert chosen(options, Gained).gain == 5.0
    assert chosen(options, SpacenavMapping, "spacenav-").gain == 7.0


def served(*arguments: str) -> int:
    """Run the command by itself."""
    parser = Parser(prog="maglev-mj serve-spacenav")
    declare(commands.serve_spacenav, parser)
    options = parser.parse_args(arguments)
    status: int = options.run(options)
    return status


@pytest.mark.machine
def test_a_program_hears_of_the_scripted_hand(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    heard: list[tuple[int, ...]] = []

    def listen() -> None:
        with Program(path) as program:
            program.line.setblocking(True)
            program.line.settimeout(PATIENCE)
            program.line.send(struct.pack("=I", CHANGE | 1))
            assert program.line.recv(4) == struct.pack("=I", CHANGE | 1)
            while data := program.line.recv(EVENT):
                heard.append(struct.unpack("=8i", data))

    listener = threading.Thread(target=listen)
    listener.start()
    assert served("--socket", str(path), "--seconds", "1") == 0
    listener.join(PATIENCE)
    said = capsys.readouterr().out.splitlines()
    assert said[1] == f"    export SPNAV_SOCKET={path}"
    assert said[2] == f"  {len(heard)} events, 0 missed, 0 programs dropped, 0 refused"
    assert not path.exists()
    assert max(event[1] for event in heard) > 100  # the hand goes to the right first
    assert heard[-1][1:7] == REST


@pytest.mark.parametrize("axes", ["pose", "rate"])
def test_a_mouse_comes_back_to_its_centre_and_a_stick_of_rates_has_friction(
    axes: str, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenes: list[Any] = []

    def session(scene: Any, **keywords: Any) -> Session:
        scenes.append(scene)
        return Session(scene, **keywords)

    monkeypatch.setattr("maglev_mj.session.Session", session)
    assert served("--socket", str(path), "--axes", axes, "--seconds", "0.01") == 0
    assert served("--socket", str(path), "--axes", axes, "--seconds", "0.01", "--friction") == 0
    assert [scene.friction for scene in scenes] == [axes == "rate", True]


def test_the_scripted_hand_does_it_again() -> None:
    scene = Joystick()
    hand = scene.scripted_hand()
    assert hand is not None
    again = commands._Again(hand, scene.end)

    def state() -> tuple[Array, Array]:
        return np.zeros(6), np.zeros(6)

    for instant in np.linspace(0.0, scene.end - 0.01, 50):
        assert again(0, instant, state) == hand(0, instant, state)
        assert again(0, instant + 3 * scene.end, state) == pytest.approx(hand(0, instant, state), abs=1e-9)


@pytest.mark.study
@pytest.mark.parametrize(
    ("axes", "drift", "late"), [("pose", 0.5, 0.0), ("rate", 10.0, 0.004), ("pose", 0.5, 0.004), ("rate", 10.0, 0.0)]
)
def test_the_scripted_hand_of_the_joystick_comes_back_on_every_axis(axes: str, drift: float, late: float) -> None:
    # Numbers taken for speeds add up to next to nothing over a cycle, and never to much.
    scene, told = Joystick(friction=axes == "rate"), {"pose": PoseAxes, "rate": RateAxes}[axes]()
    session, end = Session(scene, hand=commands._hand(scene)), commands.deflections().end
    sums, most = np.zeros(6), np.zeros(6)
    cycles: list[Array] = []
    for shown in frames(session, 2.01 * end, late):
        numbers = np.array(told(shown))
        sums, most = sums + numbers * FRAME, np.maximum(most, np.abs(numbers))
        assert (np.abs(sums) < 200.0).all()
        if shown.time >= (len(cycles) + 1) * end:
            cycles.append(sums.copy())
    session.close()
    assert len(cycles) == 2 and (most > 200.0).all()
    assert np.abs(np.diff(cycles, axis=0)).max() < drift
