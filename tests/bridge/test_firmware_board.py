"""The firmware flies on emulated boards with a Cortex-M4, over a serial line in lockstep; a device's program builds."""

from __future__ import annotations

import multiprocessing
import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from inspect import unwrap
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.conformance import conform, tester
from maglev_mj.bridge.guarded import GuardedPlant
from maglev_mj.bridge.links import SerialLink
from maglev_mj.bridge.wire import Fault, State
from maglev_mj.cli import main
from maglev_mj.recording import Recording
from maglev_mj.recording.recording import Segment
from maglev_mj.scenes.interactive import CENTRING, Joystick
from tests.bridge.firmware_core import FOLDER
from tests.bridge.test_simulated_device import PROFILE, built, write_plant
from tests.bridge.test_wire import KEY
from tests.processes import Program as Child
from tests.published import WEIGHT

BUILD = FOLDER / "boards" / "build.py"
QEMU = "qemu-system-arm -M {} -icount shift=6 -nographic -monitor none"
LINE = "-chardev pty,id=line,mux=on -echr 256 -serial chardev:line"
LONGEST = 600.0  # [s] that an emulator may live
PATIENCE = 60.0  # [s] of host and device for each other, on a busy machine
INSTRUCTION = 64.0  # [ns]
COUNTS = {"mps2_an386": 40.0, "stm32f405": 1.0}  # of each board's emulated clock [ns]
MACHINES = {"mps2_an386": "mps2-an386", "stm32f405": "netduinoplus2"}
# without a key and with one: those of maglev_firmware.c, but for frame, a HELLO whose number is drawn by a hash
INSTRUCTIONS_AT_MOST = {"sample": (17_700, 27_000), "command": (7_000, 16_500), "frame": (22_600, 39_400)}
INSTRUCTIONS_OF_WALLS = {
    "drop": {"command": (15_500, 25_000), "wall": (20_000, 20_000)},  # one wall
    "joystick": {"command": (50_400, 71_800), "wall": (38_500, 38_500)},  # the twelve faces of a box
}
HARDWARE = 600  # instructions of the simulated hardware in each
STACK = 3904  # with the frames of twelve walls, 600 bytes each
PERIOD = 0.005
HAND, PRESSED = np.array([4.0, 0.0, -5.0, 0.0, 0.0, 0.0]), (2.3, 2.6)  # [N, N m], [s] of the device's clock
PUSH = f"{','.join(map(str, HAND))}@{PRESSED[0]}:{PRESSED[1]}"
CHECKS = ["welcome", "busy", "drawn", "bye", "lockstep", "enabled", "currents", "not-active", "width", "no-tag", "tag"]
CHECKS += ["direction", "estop", "flight-estop", "frames", "samples", "cut"]  # of conform, in its order
EDGE = 0.0035  # of the joystick's walls, on either side [m]

pytestmark = pytest.mark.needs("compiler", "cross", "emulator", "linux")


class Program(NamedTuple):
    """Programs of a board, its key, and the options of a command that has it."""

    board: str
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
    board, key = request.param
    options = ["--key", str(folder / "key")] if key else []
    for name, hand in (("board.elf", ["--hand", PUSH, "--let-go", f"{PATIENCE:.0f}"]), ("still.elf", [])):
        command = [sys.executable, str(BUILD), "--board", board, *hand, *options, str(folder / name)]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
        assert not done.returncode and not done.stderr, done.stderr
    return Program(board, folder / "board.elf", folder / "still.elf", key, options)


class Board:
    """Emulated board; killed if it lives too long.

    Attributes:
        address: Address of its line.
    """

    def __init__(self, machine: str, program: Path, log: Path) -> None:
        self._log = log
        log.touch()
        command = [*QEMU.format(machine).split(), "-kernel", str(program), *LINE.split(), "-serial", f"file:{log}"]
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

    def wait(self, timeout: float = PATIENCE, **wanted: int) -> dict[str, int]:
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


@pytest.fixture(autouse=True)
def _patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the host wait for samples of an emulator that its machine does not run."""
    monkeypatch.setitem(unwrap(GuardedPlant.__init__).__kwdefaults__, "patience", PATIENCE)
    monkeypatch.setattr(tester.Tester.exchange, "__defaults__", (PATIENCE,))
    monkeypatch.setattr(tester, "RETRY_INTERVAL", 1.0)


KEY_ALONE = pytest.mark.parametrize(
    "program",
    [
        pytest.param((board, key), marks=[] if key else pytest.mark.study, id=f"{board}{', no key' * (key is None)}")
        for board in MACHINES
        for key in (None, KEY)
    ],
    indirect=True,
)
"""Of tests in which frames without a tag are a part of those with one."""


@pytest.fixture
def start(program: Program, tmp_path: Path) -> Iterator[Starter]:
    """Start emulators that are ended with the test."""
    boards: list[Board] = []

    def new(path: Path = program.path) -> Board:
        boards.append(Board(MACHINES[program.board], path, tmp_path / f"board{len(boards)}.log"))
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
        assert 0.9 * most < told[name] * COUNTS[program.board] / INSTRUCTION <= most, name
    assert told["stack"] < STACK

    assert_same_on_pc(flight, program, tmp_path)


def assert_same_on_pc(flight: Segment, program: Program, tmp_path: Path, *options: str) -> None:
    """Check that the same program of a PC flies the same, to the last bit."""
    program_of_pc = built(tmp_path, ["-O2", f"-DLET_GO={PATIENCE * 1e9:.0f}u"])
    assert program_of_pc is not None
    known = ["--plant", str(write_plant(tmp_path / "plant.txt")), "--seconds", "600", "--lockstep", "--hand", PUSH]
    known += ["--calibration-hash", Calibration.nominal().digest.hex(), *program.options]
    with closing(Child(str(program_of_pc), *known, "--hover-limit", str(PROFILE.limits.hover_limit))) as device:
        port = device.wait_for(r"^listening udp://127\.0\.0\.1:(\d+)$")
        (on_pc,) = flown(f"udp://127.0.0.1:{port}", tmp_path / "pc.maglev", *program.options, *options).segments
    for name in on_pc.arrays.keys() - {"arrival"}:
        assert np.array_equal(on_pc.arrays[name], flight.arrays[name], equal_nan=True), name


@KEY_ALONE
@pytest.mark.parametrize("scene", INSTRUCTIONS_OF_WALLS)
def test_walls_on_the_board(program: Program, scene: str, start: Starter, tmp_path: Path) -> None:
    board, options = start(), ["--scene", scene, "--wall-on", "device", "--stiffness", "60000", "--damping", "200"]
    (flight,) = flown(board.address, tmp_path / "flight.maglev", *program.options, *options).segments
    told = board.wait(state=State.INACTIVE, flows=0)
    assert told["faults"] == 0 and told["stack"] < STACK
    if scene == "drop":  # at rest it carries weight and hand
        assert flight.position[pressed(flight), 2].mean() == pytest.approx((HAND - WEIGHT)[2] / 6e4, abs=2e-6)
    else:
        assert np.abs(flight.position[pressed(flight), :3]).max() < EDGE + 1e-3
    for name, bounds in INSTRUCTIONS_OF_WALLS[scene].items():
        most = bounds[program.key is not None] + HARDWARE
        assert 0.9 * most < told[name] * COUNTS[program.board] / INSTRUCTION <= most, name
    # float precision: the depth differs by about 1e-12 m, in the contact alone
    assert_same_on_pc(flight, program, tmp_path, *options)


@KEY_ALONE
def test_a_killed_host_is_given_up(
    program: Program, start: Starter, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    board = start(program.still)  # takeoff begins when the check ends
    command = ["bridge", board.address, "--out", str(tmp_path), *program.options]
    host = multiprocessing.get_context("fork").Process(target=main, args=(command,))  # as patient as this process
    host.start()
    try:
        before = board.wait(state=State.ACTIVE, flows=1)
    finally:
        host.kill()
        host.join()
    after = board.wait(state=State.FAULT, flows=0, faults=Fault.WATCHDOG)
    assert after["again"] - before["again"] < 30  # of one STATE 7, at double intervals
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


OWN = '#include "own.h"\n' + "\n".join(
    [
        "void own_start(void) {}",
        "void own_read(struct maglev_reading *reading) { reading->valid = 7; }",
        "void own_currents(const double *amperes) { (void)amperes; }",
        "void own_toggle(void) {}",
    ]
)
FLOWS = {
    # a command each period of 5 ms, in effect 1.5 ms after its sample
    0: [(6.5, 1.0), (11.5, 2.0), (16.5, 3.0), (21.5, 4.0)],
    # with a pulse of 4 ms, which the next command does not shorten
    1: [(6.5, 11.0), (10.5, 1.0), (11.5, 12.0), (15.5, 2.0), (16.5, 13.0), (20.5, 3.0), (21.5, 14.0)],
    # a wall of 0.5 A, 0.2 ms after each millisecond, beside it
    2: [(5.2, 0.5), (6.2, 0.5), (6.5, 1.5), (7.2, 1.5), (8.2, 1.5), (9.2, 1.5), (10.2, 1.5), (11.2, 1.5), (11.5, 2.5)],
    # cut at the third sample, with the command of the second in effect and none pending
    3: [(6.5, 1.0), (11.5, 2.0), (15.0, 0.0), (21.5, 4.0)],
}
"""Case of timers.c -> time [ms] and current [A] of the first changes."""


@pytest.fixture(scope="module")
def device_program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build a device's program for the chip, and its timers' part for this machine; return the latter."""
    folder = tmp_path_factory.mktemp("device")
    (folder / "own.c").write_text(OWN, encoding="ascii")
    options = ["--board", "stm32f405", "--own", str(folder / "own.c"), "--crystal", "12"]
    subprocess.run([sys.executable, str(BUILD), *options, str(folder / "device.elf")], check=True, timeout=120)
    chip, boards = Path(__file__).parent / "stm32f405", FOLDER / "boards"
    compiler = ["gcc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-include", str(chip / "chip.h"), f"-I{folder}"]
    compiler += [f"-I{place}" for place in (FOLDER, boards, boards / "stm32f405")]
    device = ["-Dmain=device_main", "-c", str(boards / "stm32f405" / "device.c"), "-o", str(folder / "device.o")]
    for part in (device, [str(chip / "timers.c"), str(folder / "device.o"), "-o", str(folder / "timers")]):
        subprocess.run([*compiler, *part], check=True, timeout=120)
    return folder / "timers"


@pytest.mark.parametrize("case", FLOWS)
def test_the_timers_of_a_device_let_the_commanded_currents_flow_in_time(device_program: Path, case: int) -> None:
    environment = {"SCENE": str(case)}
    said = subprocess.run(
        [device_program], env=environment, capture_output=True, text=True, check=True, timeout=60
    ).stdout
    rows = [line.split() for line in said.splitlines()]
    told = {
        kind: [(int(row[1]), float(row[2])) for row in rows if row[0] == kind] for kind in ("flow", "sample", "heat")
    }
    flows = [(time / 1e6, current) for time, current in told["flow"]]
    assert flows[: len(FLOWS[case])] == FLOWS[case]
    assert told["sample"] == [(number, 5e6 * number) for number in range(1, len(told["sample"]) + 1)]
    assert len(told["sample"]) > 3
    # the coils are heated by what flowed, from the start on
    end = sum(time for time, _ in told["heat"]) / 1e6
    changes = [(time, current) for time, current in flows if time < end]
    flowed = sum((until - time) * now for (time, now), (until, _) in zip(changes, [*changes[1:], (end, 0.0)]))
    assert sum(time * current for time, current in told["heat"]) / 1e6 == pytest.approx(flowed, rel=1e-9)
