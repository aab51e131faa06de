"""The firmware flies on an emulated Cortex-M4, over a serial line in lockstep."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.conformance import conform
from maglev_mj.bridge.links import SerialLink
from maglev_mj.bridge.wire import Fault, State
from maglev_mj.cli import main
from maglev_mj.recording import Recording
from maglev_mj.recording.recording import Segment
from maglev_mj.scenes.interactive import CENTRING, WEIGHT, Joystick
from tests.bridge.firmware_core import FOLDER
from tests.bridge.test_simulated_device import PROFILE, built, write_plant
from tests.bridge.test_wire import KEY
from tests.processes import Program as Child

BUILD = FOLDER / "boards" / "mps2_an386" / "build.py"
QEMU = "qemu-system-arm -M mps2-an386 -icount shift=6 -nographic -monitor none"
LINE = "-chardev pty,id=line,mux=on -echr 256 -serial chardev:line"
LONGEST = 120.0  # [s] that an emulator may live
INSTRUCTIONS = 40 / 64  # in a count of the board's clock, 40 ns, at 64 ns an instruction
# without a key and with one: those of maglev_firmware.c, but for frame, a HELLO whose number is drawn by a hash
INSTRUCTIONS_AT_MOST = {"sample": (17_000, 27_000), "command": (7_000, 16_500), "frame": (20_000, 36_500)}
INSTRUCTIONS_OF_WALLS = {"command": (15_500, 25_000), "wall": (20_000, 20_000)}  # with one wall
HARDWARE = 600  # instructions of the simulated hardware in each
STACK = 2816
PERIOD = 0.005
HAND, PRESSED = np.array([4.0, 0.0, -5.0, 0.0, 0.0, 0.0]), (2.3, 2.6)  # [N, N m], [s] of the device's clock
PUSH = f"{','.join(map(str, HAND))}@{PRESSED[0]}:{PRESSED[1]}"
CHECKS = ["welcome", "busy", "drawn", "bye", "lockstep", "enabled", "currents", "not-active", "width", "no-tag", "tag"]
CHECKS += ["direction", "estop", "flight-estop", "frames", "samples", "cut"]  # of conform, in its order
EDGE = 0.0035  # of the joystick's walls, on either side [m]

pytestmark = pytest.mark.needs("compiler", "cross", "emulator", "linux")


class Program(NamedTuple):
    """Programs of the board, its key, and the options of a command that has it."""

    path: Path
    still: Path  # without a hand
    key: bytes | None
    options: list[str]


@pytest.fixture(scope="module")
def program(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Program:
    """Build the board's programs, with a hand that presses and without."""
    folder = tmp_path_factory.mktemp("board")
    (folder / "key").write_text(KEY.hex(), encoding="ascii")
    (folder / "key").chmod(0o600)
    options = ["--key", str(folder / "key")] if request.param else []
    for name, hand in (("board.elf", ["--hand", PUSH]), ("still.elf", [])):
        command = [sys.executable, str(BUILD), *hand, *options, str(folder / name)]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
        assert not done.returncode and not done.stderr, done.stderr
    return Program(folder / "board.elf", folder / "still.elf", request.param, options)


class Board:
    """Emulated board; killed if it lives too long.

    Attributes:
        address: Address of its line.
    """

    def __init__(self, program: Path, log: Path) -> None:
        self._log = log
        log.touch()
        command = [*QEMU.split(), "-kernel", str(program), *LINE.split(), "-serial", f"file:{log}"]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        self._limit = threading.Timer(LONGEST, self.process.kill)
        self._limit.start()
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        found = re.search(r"/dev/pts/\d+", line)
        assert found, line
        self.address = f"serial://{found[0]}?baud=921600"
        self.path = found[0]
        self._kept = os.open(self.path, os.O_RDWR | os.O_NOCTTY)  # else QEMU looks only once a second for a host

    def told(self) -> dict[str, int]:
        """Return the numbers in the last whole line of the log."""
        words = self._log.read_text().rpartition("\n")[0].rpartition("\n")[2].split()
        return dict(zip(words[::2], map(int, words[1::2])))

    def wait(self, timeout: float = 60.0, **wanted: int) -> dict[str, int]:
        """Wait until the log tells these numbers; return all."""
        end = time.monotonic() + timeout
        while not wanted.items() <= (told := self.told()).items():
            assert time.monotonic() < end, f"{wanted} is not in {told}"
            time.sleep(0.01)
        return told

    def end(self, patience: float = 5.0) -> None:
        """End the emulator, or kill it if it hangs; idempotent."""
        self._limit.cancel()
        self.process.terminate()
        try:
            self.process.communicate(timeout=patience)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.communicate()
        if self._kept >= 0:
            os.close(self._kept)
        self._kept = -1


Starter = Callable[..., Board]

KEY_ALONE = pytest.mark.parametrize(
    "program", [pytest.param(None, marks=pytest.mark.study), KEY], indirect=True, ids=["no key", "key"]
)
"""Of tests in which frames without a tag are a part of those with one."""


@pytest.fixture
def start(program: Program, tmp_path: Path) -> Iterator[Starter]:
    """Start emulators that are ended with the test."""
    boards: list[Board] = []

    def new(path: Path = program.path) -> Board:
        boards.append(Board(path, tmp_path / f"board{len(boards)}.log"))
        return boards[-1]

    yield new
    for board in boards:
        board.end()


def flown(address: str, path: Path, *options: str) -> Recording:
    """Fly the joystick through the hand's press; return the recording."""
    assert main(["bridge", address, "--seconds", "0.6", "--record", str(path), *options]) == 0
    return Recording.load(path)


def pressed(flight: Segment) -> Any:
    """Return True for the last samples under the hand."""
    time_on_device = (flight.tick + 1) * PERIOD
    return (time_on_device > PRESSED[1] - 0.03) & (time_on_device < PRESSED[1])


@KEY_ALONE
def test_a_hand_presses_the_wall_and_it_lands(
    program: Program, start: Starter, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    board = start()
    (flight,) = flown(board.address, tmp_path / "flight.maglev", *program.options).segments
    said = capsys.readouterr().out
    assert "120 samples, 0 lost, 0 skipped" in said and "landed 0.00 mm from its takeoff position, at rest" in said
    told = board.wait(state=State.INACTIVE, flows=0)
    assert told["faults"] == 0 and (told["lost"] == 0 or told["again"])  # a host that is late answers all at once

    # at rest in both walls, the coils bear the hand and the weight, and the laws give that at this depth
    late = pressed(flight)
    pose, wrench = flight.position[late].mean(axis=0), flight.applied[late].mean(axis=0)
    depth = np.clip(pose[:3], -EDGE, EDGE) - pose[:3]
    assert depth[0] < -4e-4 and depth[1] == 0.0 and depth[2] > 5e-4
    assert wrench[:3] == pytest.approx((WEIGHT - HAND)[:3], abs=0.05)
    assert Joystick().stiffness * depth - CENTRING * pose[:3] == pytest.approx(-HAND[:3], abs=0.05)
    # released, it swings back through the centre, out of both walls
    assert np.abs(flight.position[-10:, :3]).max() < 0.5 * EDGE

    for name, bounds in INSTRUCTIONS_AT_MOST.items():
        most = bounds[program.key is not None] + HARDWARE
        assert 0.9 * most < told[name] * INSTRUCTIONS <= most, name
    assert told["stack"] < STACK

    assert_same_on_pc(flight, program, tmp_path)


def assert_same_on_pc(flight: Segment, program: Program, tmp_path: Path, *options: str) -> None:
    """Check that the same program of a PC flies the same, to the last bit."""
    program_of_pc = built(tmp_path, ["-O2"])
    assert program_of_pc is not None
    known = ["--plant", str(write_plant(tmp_path / "plant.txt")), "--seconds", "60", "--lockstep", "--hand", PUSH]
    known += ["--calibration-hash", Calibration.nominal().digest.hex(), *program.options]
    with closing(Child(str(program_of_pc), *known, "--hover-limit", str(PROFILE.limits.hover_limit))) as device:
        port = device.wait_for(r"^listening udp://127\.0\.0\.1:(\d+)$")
        (on_pc,) = flown(f"udp://127.0.0.1:{port}", tmp_path / "pc.maglev", *program.options, *options).segments
    for name in on_pc.arrays.keys() - {"arrival"}:
        assert np.array_equal(on_pc.arrays[name], flight.arrays[name], equal_nan=True), name


@KEY_ALONE
def test_a_wall_on_the_board(program: Program, start: Starter, tmp_path: Path) -> None:
    board, options = start(), ["--scene", "drop", "--wall-on", "device", "--stiffness", "60000", "--damping", "200"]
    (flight,) = flown(board.address, tmp_path / "flight.maglev", *program.options, *options).segments
    told = board.wait(state=State.INACTIVE, flows=0)
    assert told["faults"] == 0 and told["stack"] < STACK
    # at rest it carries weight and hand
    assert flight.position[pressed(flight), 2].mean() == pytest.approx((HAND - WEIGHT)[2] / 6e4, abs=2e-6)
    for name, bounds in INSTRUCTIONS_OF_WALLS.items():
        most = bounds[program.key is not None] + HARDWARE
        assert 0.9 * most < told[name] * INSTRUCTIONS <= most, name
    assert_same_on_pc(flight, program, tmp_path, *options)


@KEY_ALONE
def test_a_killed_host_is_given_up(
    program: Program, start: Starter, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    board = start(program.still)  # takeoff begins when the check ends
    command = [sys.executable, "-m", "maglev_mj", "bridge", board.address, "--out", str(tmp_path), *program.options]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as host:
        try:
            board.wait(state=State.ACTIVE, flows=1)
        finally:
            host.kill()
    board.wait(state=State.FAULT, flows=0, faults=Fault.WATCHDOG)
    assert main(["bridge", board.address, "--reset", *program.options]) == 0
    assert "latched: WATCHDOG" in capsys.readouterr().out
    board.wait(state=State.INACTIVE, flows=0, faults=0)


@KEY_ALONE
@pytest.mark.parametrize("only", [CHECKS, pytest.param(None, marks=pytest.mark.study)], ids=["some", "all"])
def test_it_conforms(program: Program, start: Starter, only: list[str] | None) -> None:
    board = start(program.still)  # conform takes off whenever it comes to it
    with closing(SerialLink(board.path, 921600)) as link:
        results = conform([link], key=program.key, only=only)
    assert not [one for one in results if one.passed is False]
    skipped = {one.name for one in results if one.passed is None}
    assert skipped & {*CHECKS} == (set() if program.key else {"no-tag", "tag"})
    board.wait(state=State.INACTIVE, flows=0, faults=0)
