"""Firmware in C on simulated hardware, over UDP.

A flight, faults, the board, and invalid frames.
"""

from __future__ import annotations

import math
import random
import re
import socket
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

from maglev_mj.bridge.bench.calibration import Calibration
from maglev_mj.bridge.twin.firmware import Firmware, Profile, Reading
from maglev_mj.bridge.twin.twin import REST, TwinParameters
from maglev_mj.bridge.wire import (
    Codec,
    Command,
    Control,
    ControlAck,
    Estop,
    EstopAck,
    Fault,
    Flag,
    Frame,
    Hello,
    HelloAck,
    HelloStatus,
    Operation,
    Result,
    State,
    StateReport,
)
from maglev_mj.frames import Array
from tests.conftest import COMPILER
from tests.firmware_core import FOLDER, SANITIZED, STRICT
from tests.test_firmware import HOVER, ONES, ZERO
from tests.test_wire import KEY, golden_bytes, sealed

PROFILE = TwinParameters().profile
NOMINAL = Calibration.nominal()
SLOPES = NOMINAL.beams._spots(np.zeros(6))[1]
PERIOD = 5_000_000

pytestmark = [
    pytest.mark.needs("compiler"),
    pytest.mark.xdist_group("simulated device"),  # so that the program is compiled once
]


def built(folder: Path, flags: Sequence[str]) -> Path | None:
    """Return the compiled program; None for unknown flags."""
    program = folder / "simulated_device"
    sources = [str(FOLDER / name) for name in ("simulated_device.c", "maglev_firmware.c")]
    command = [str(COMPILER), *STRICT, *flags, *sources, "-o", str(program), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    if done.returncode and flags == ["-O2"]:
        pytest.fail(f"{' '.join(command)}:\n{done.stderr}")
    return None if done.returncode else program


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the program, with sanitizers if available."""
    optimised = built(tmp_path_factory.mktemp("optimised"), ["-O2"])
    assert optimised is not None
    return built(tmp_path_factory.mktemp("sanitized"), SANITIZED) or optimised


@pytest.fixture(scope="module")
def key_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a file with the page's key."""
    path = tmp_path_factory.mktemp("key") / "key"
    path.write_text(KEY.hex() + "\n", encoding="ascii")
    return path


def write_plant(path: Path, calibration: Calibration) -> Path:
    """Write the program's plant: the linearised device.

    About its centre.
    """
    rows: dict[str, ArrayLike] = {
        "wrench_per_current": calibration.coils.wrench_per_current,
        "inertia": [*[calibration.mass] * 3, *calibration.inertia],
        "gravity": [*calibration.gravity, 0.0, 0.0, 0.0],
        "spots_per_pose": calibration.beams._spots(np.zeros(6))[1],
        "rest": REST,
    }
    lines = [f"{name} {' '.join(repr(float(one)) for one in np.ravel(values))}" for name, values in rows.items()]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
    return path


def six(values: ArrayLike) -> tuple[float, ...]:
    """Return numbers as a frame has them."""
    return tuple(np.asarray(values, dtype=float).tolist())


class Host:
    """A host of single frames.

    Attributes:
        state: The last STATE.
    """

    def __init__(self, port: int, key: bytes | None) -> None:
        self.codec = Codec(key)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.connect(("127.0.0.1", port))
        self.session = self.sequence = self.request = 0
        self.state: Frame

    def close(self) -> None:
        self.socket.close()

    def receive(self, timeout: float = 5.0) -> Frame | None:
        self.socket.settimeout(timeout)
        try:
            frame = self.codec.decode(self.socket.recv(512))
        except (TimeoutError, BlockingIOError):
            return None
        assert frame is not None and not self.codec.dropped
        return frame

    def wait(self, body: type, timeout: float = 5.0) -> Any:
        """Return the next frame of a type, keeping STATEs."""
        end = time.monotonic() + timeout
        while (left := end - time.monotonic()) > 0:
            frame = self.receive(left)
            if frame is not None and isinstance(frame.body, StateReport):
                self.state = frame
            if frame is not None and isinstance(frame.body, body):
                return frame
        raise AssertionError(f"no {body.__name__} within {timeout} s")

    def send(self, body: Any, **header: int) -> None:
        self.sequence += 1
        session, sequence = header.get("session", self.session), header.get("sequence", self.sequence)
        self.socket.send(self.codec.encode(session, sequence, time.monotonic_ns(), body))

    def estop(self, request: int = 1) -> EstopAck:
        for _ in range(400):  # again every 5 ms, as the page says: a flood leaves no room for some
            self.send(Estop(request), session=0)
            with suppress(AssertionError):
                answer: EstopAck = self.wait(EstopAck, 0.005).body
                break
        assert answer.request == request
        return answer

    def hello(self, nonce: int = 1, calibration: bytes = NOMINAL.digest) -> HelloAck:
        self.send(Hello(nonce, calibration), session=0)
        frame = self.wait(HelloAck)
        if frame.body.status == HelloStatus.WELCOME:
            self.session = frame.session
        answer: HelloAck = frame.body
        assert answer.nonce == nonce and frame.sequence == 0
        return answer

    def ask(self, operation: int, hover: ArrayLike = NOMINAL.hover, faults: int = 0) -> ControlAck:
        self.request += 1
        self.send(Control(self.request, operation, faults, six(hover)))
        answer: ControlAck = self.wait(ControlAck).body
        assert answer.request == self.request and answer.operation == operation
        return answer

    def command(self, held: ArrayLike, pulsed: ArrayLike = ZERO, width: float = 0.0) -> None:
        self.send(Command(self.state.sequence, 0, six(held), six(pulsed), width))

    def answered(self, held: ArrayLike = ZERO, pulsed: ArrayLike = ZERO, width: float = 0.0) -> StateReport:
        """Answer the last STATE and wait for the next.

        The last may come again first, if this host was slow.
        """
        before = self.state.sequence
        self.command(held, pulsed, width)
        report = self.sampled()
        while self.state.sequence == before:
            report = self.sampled()
        return report

    def sampled(self, timeout: float = 5.0) -> StateReport:
        report: StateReport = self.wait(StateReport, timeout).body
        return report


class Device:
    """The program, running, and hosts that are closed with it.

    Attributes:
        counts: What it ignored, by reason, once it has ended.
    """

    def __init__(self, program: Path, plant: Path, *arguments: str) -> None:
        command = [str(program), "--plant", str(plant), "--calibration-hash", NOMINAL.digest.hex(), "--seconds", "60"]
        command += ["--hover-limit", str(PROFILE.limits.hover)]
        self.key = KEY if "--key" in arguments else None
        self.process = subprocess.Popen(
            [*command, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        found = re.fullmatch(r"listening udp://127\.0\.0\.1:(\d+)\n", line)
        assert found, line + self.process.communicate()[1]
        self.port = int(found[1])
        self.hosts: list[Host] = []
        self.counts: dict[str, int] = {}

    def host(self) -> Host:
        self.hosts.append(Host(self.port, self.key))
        return self.hosts[-1]

    def end(self) -> dict[str, int]:
        """End the program normally; idempotent."""
        for host in self.hosts:
            host.close()
        if self.process.poll() is None or not self.counts:
            self.process.terminate()
            out, error = self.process.communicate(timeout=10)
            assert self.process.returncode == 0 and not error, error
            self.counts = {name: int(count) for name, count in re.findall(r"(\w+) (\d+)", out)}
        return self.counts


Starter = Callable[..., Device]


@pytest.fixture
def start(program: Path, tmp_path: Path) -> Iterator[Starter]:
    """Start devices that are ended with the test."""
    devices: list[Device] = []

    def new(*arguments: str) -> Device:
        devices.append(Device(program, write_plant(tmp_path / "plant.txt", NOMINAL), *arguments))
        return devices[-1]

    yield new
    for device in devices:
        device.end()


def flying(host: Host, ticks: int) -> list[Array]:
    """Hold the flotor at the centre; return the poses.

    By springs on poses from the linearised beams.
    """
    assert host.ask(Operation.ARM)[2:] == (Result.DONE, State.ACTIVE, 0)
    host.answered()
    inverse = np.linalg.inv(SLOPES)
    inertia = np.array([*[NOMINAL.mass] * 3, *NOMINAL.inertia])
    hover = NOMINAL.hover
    last = None
    poses = []
    for _ in range(ticks):
        report: Any = host.state.body
        assert report.state == State.ACTIVE and report.valid == 7 and report.faults == 0
        assert report.flags == Flag.ENABLED
        pose = inverse @ report.spots
        speed = np.zeros(6) if last is None else (pose - last) / (PERIOD * 1e-9)
        last = pose
        poses.append(pose)
        pull = inertia * (-(50.0**2) * pose - 2.0 * 0.9 * 50.0 * speed)
        host.answered(hover + NOMINAL.coils.currents(pull))
    return poses


@pytest.mark.parametrize("keyed", [False, True], ids=["no key", "key"])
def test_golden_bytes(program: Path, key_file: Path, keyed: bool) -> None:
    frames = [data for name, data in golden_bytes().items() if name.endswith("keyed") == keyed]
    command = [str(program), "--golden", *(["--key", str(key_file)] if keyed else [])]
    lines = "\n".join(data.hex() for data in frames)
    done = subprocess.run(command, input=lines, capture_output=True, text=True, check=True, timeout=30)
    assert done.stdout.split() == lines.split() and len(frames) == 8


@pytest.mark.parametrize(
    "arguments",
    [
        ["--rate", "0"],
        ["--rate", "200x"],
        ["--rate"],
        ["--speed", "1"],
        ["--calibration-hash", "00"],
        ["--calibration-hash", "g" * 32],
        ["--plant", "/nowhere"],
        ["--plant", str(FOLDER / "README.md")],
        ["--key", "/nowhere"],
        ["--key", str(FOLDER / "README.md")],
        ["--fault", "stuck-diode:3@0"],
        ["--fault", "dead-coil:1"],
        ["--fault", "hot-coil:1@2"],
        [],
    ],
)
def test_arguments_that_cannot_be_are_refused(program: Path, arguments: list[str]) -> None:
    done = subprocess.run([str(program), *arguments], capture_output=True, text=True, check=False, timeout=30)
    assert done.returncode == 2 and done.stderr.startswith("simulated_device: ") and done.stderr.count("\n") == 1


def test_a_session_in_lockstep(start: Starter) -> None:
    device = start("--lockstep")
    host = device.host()
    welcome = host.hello()
    limits = PROFILE.limits
    assert welcome.hover_limit == pytest.approx(limits.hover, rel=1e-15)
    assert welcome == HelloAck(
        *(1, 0, 1, 2, State.INACTIVE, 1, NOMINAL.digest, PROFILE.period, PROFILE.delay),
        *(round(limits.watchdog * 1e9), round(limits.enable * 1e9), 0, 0, 0, 0),
        *(limits.current, limits.continuous_current, welcome.hover_limit),
        *(limits.thermal_time, limits.spot, limits.spot_speed),
    )
    report = host.sampled()
    assert report.spots == pytest.approx(SLOPES @ REST, abs=1e-15)
    assert report[1:] == (ZERO, ZERO, State.INACTIVE, 7, 0, 0, 0xFFFFFFFF, 0xFFFFFFFF, 1)
    session = host.session
    assert host.hello(nonce=1).status == HelloStatus.WELCOME and host.session == session  # the same again

    poses = flying(host, 400)
    assert poses[0] == pytest.approx(np.array(REST), abs=1e-12)
    assert np.abs(poses[200:]).max() < 1e-6
    assert np.abs(np.array(poses)[60:, 2]).max() < 2e-4

    # a second host disturbs nobody
    other = device.host()
    assert other.hello(nonce=7).status == HelloStatus.BUSY
    other.send(Control(1, Operation.TRIP, 0, ZERO), session=session)
    assert host.answered(NOMINAL.hover).state == State.ACTIVE

    # a command that is none: fault, currents off, latched
    report = host.answered((*NOMINAL.hover[:5], math.nan))
    assert (report.state, report.faults, report.currents) == (State.FAULT, Fault.INVALID_COMMAND, ZERO)
    assert host.ask(Operation.ARM)[2:] == (Result.REFUSED, State.FAULT, Fault.INVALID_COMMAND)
    for _ in range(20):
        report = host.answered(NOMINAL.hover)
    assert report.currents == ZERO and report.spots == pytest.approx(SLOPES @ REST, abs=1e-6)  # it fell
    assert host.ask(Operation.RESET)[2:] == (Result.DONE, State.INACTIVE, 0)

    flying(host, 100)
    for _ in range(2):  # anyone may
        assert other.estop()[1:3] == (State.FAULT, Fault.ESTOP)
    assert host.ask(Operation.BYE).state == State.FAULT
    assert other.hello(nonce=8)[1:5] == (HelloStatus.WELCOME, 1, 2, State.FAULT)
    counts = device.end()
    # 20 commands while faulted, and the one that was answered into the void before it
    assert counts["busy"] == 1 and counts["session"] == 1 and counts["inactive"] == 20
    assert sum(counts.values()) == 22


def test_motion_is_exact_between_switches(start: Starter) -> None:
    host = start("--lockstep", "--delay", "0.0015").host()
    host.hello()
    host.sampled()
    assert host.ask(Operation.ARM).state == State.ACTIVE
    held, pulsed, width = np.array(NOMINAL.hover) * 1.5, np.array(NOMINAL.hover) * 1.2 + 0.3, 0.002
    report = host.answered(held, pulsed, width)
    inertia = np.array([*[NOMINAL.mass] * 3, *NOMINAL.inertia])
    gravity = np.array([*NOMINAL.gravity, 0.0, 0.0, 0.0])
    pose, speed = np.array(REST), np.zeros(6)
    temperatures = np.zeros(6)
    for currents, duration in ((ZERO, 0.0015), (pulsed, width), (held, 0.0015)):
        share = -math.expm1(-duration / 10.0)
        temperatures += share * ((np.array(currents) / 3.0) ** 2 - temperatures)
        pull = NOMINAL.coils.wrench(np.array(currents)) / inertia + gravity
        if not any(currents):
            continue  # it lies until something lifts it
        pose += duration * speed + 0.5 * duration**2 * pull
        speed += duration * pull
    assert np.linalg.solve(SLOPES, report.spots) == pytest.approx(pose, abs=1e-15)
    assert report.temperatures == pytest.approx(temperatures, rel=1e-6)
    assert report.currents == pytest.approx(held, rel=1e-6) and report.age == 5000


def test_a_new_command_ends_a_pulse(start: Starter) -> None:
    host = start("--lockstep", "--delay", "0.0015").host()
    host.hello()
    host.sampled()
    host.ask(Operation.ARM)
    assert host.answered(ZERO, ONES, 0.1).currents == ONES
    assert host.answered(ZERO, ONES, 0.1).currents == ONES
    assert host.answered(HOVER).currents == pytest.approx(HOVER)
    # one that lasts longer than a period, and is let end
    host.answered(ZERO, ONES, 0.0049)
    host.send(Command(host.state.sequence - 1, 0, HOVER, HOVER, 0.0))  # old: in lockstep it is no answer
    report = host.answered(ZERO)
    assert report.currents == ZERO and report.state == State.ACTIVE


def test_lockstep_sends_again_and_then_lets_go(start: Starter) -> None:
    device = start("--lockstep")
    host = device.host()
    begun = time.monotonic()
    host.hello()
    host.sampled()
    first = host.state
    host.ask(Operation.ARM)
    again = [host.wait(StateReport) for _ in range(5)]
    assert again == [first] * 5  # the same bytes, every 20 ms
    assert time.monotonic() - begun >= 0.1
    report = host.answered()
    assert report.state == State.ACTIVE and host.state.sequence == first.sequence + 1  # its time stood still
    other = device.host()
    end = time.monotonic() + 10.0
    while (answer := other.hello(nonce=2)).status == HelloStatus.BUSY:
        assert time.monotonic() < end
        time.sleep(0.1)
    assert time.monotonic() - begun > 2.0
    assert answer.status == HelloStatus.WELCOME and answer.state == State.FAULT
    assert other.sampled().faults == Fault.WATCHDOG


def test_real_time_holds_and_then_lets_go_of_a_silent_host(start: Starter) -> None:
    # a slow device, so that a machine that stalls for 30 ms makes no difference
    device = start("--rate", "20", "--watchdog", "0.4", "--delay", "0")
    host = device.host()
    assert host.hello().lockstep == 0
    host.sampled()
    host.ask(Operation.ARM, hover=HOVER)
    host.answered(ONES)
    seen = [host.sampled() for _ in range(12)]
    at = [report.state == State.FAULT for report in seen].index(True)
    held = [report for report in seen[:at] if report.flags == Flag.HOLDING | Flag.ENABLED]
    # what it says first was measured before the cut
    assert seen[at].faults == Fault.WATCHDOG and seen[at].flags == Flag.ENABLED and seen[at + 1].currents == ZERO
    assert seen[at].age > 400_000
    assert held and held[-1].currents == pytest.approx(HOVER)
    assert all(report.age > 100_000 for report in held)
    assert host.answered(ONES).currents == ZERO and host.answered(ONES).state == State.FAULT
    assert host.ask(Operation.ARM).result == Result.REFUSED
    assert host.ask(Operation.RESET).state == State.INACTIVE


def test_real_time_samples_at_whole_periods(start: Starter) -> None:
    host = start("--rate", "1000").host()
    host.hello()
    host.sampled()
    first = host.state
    frames = [host.wait(StateReport) for _ in range(200)]
    for frame in frames:
        assert frame.time - first.time == 1_000_000 * (frame.sequence - first.sequence)
    numbers = [frame.sequence for frame in frames]
    assert numbers == sorted(set(numbers))  # some may be left out, none comes twice


@pytest.mark.parametrize(("current", "fault"), [(10.1, Fault.COIL_OVERCURRENT), (math.inf, Fault.INVALID_COMMAND)])
@pytest.mark.parametrize("pulse", [False, True])
def test_commands_that_must_not_be(start: Starter, current: float, fault: Fault, pulse: bool) -> None:
    host = start("--lockstep").host()
    host.hello()
    host.sampled()
    host.ask(Operation.ARM)
    wrong = (*ZERO[:5], -current)
    report = host.answered(ZERO if pulse else wrong, wrong if pulse else ZERO, 0.001 if pulse else 0.0)
    assert (report.state, report.faults) == (State.FAULT, fault)


@pytest.mark.parametrize(("current", "seconds"), [(10.0, 0.943), (6.0, 2.877)])
def test_warmth_trips_as_the_page_says(start: Starter, current: float, seconds: float) -> None:
    host = start("--lockstep", "--delay", "0").host()
    host.hello()
    host.sampled()
    host.ask(Operation.ARM)
    begun = host.state.time
    push = (0.0, 0.0, 0.0, current, current, current)  # they turn it, and it lies; its spots stay
    while (report := host.answered(push)).state == State.ACTIVE:
        pass
    assert report.faults == Fault.COIL_OVERTEMP
    assert (host.state.time - begun) * 1e-9 == pytest.approx(seconds, abs=0.006)
    assert host.ask(Operation.RESET).result == Result.REFUSED
    for _ in range(460):  # 2.3 s: from 1 to 0.8 takes 2.23 s
        host.answered()
    assert host.ask(Operation.RESET).result == Result.DONE


@pytest.mark.parametrize(
    ("fault", "named", "samples"),
    [
        ("dead-coil:1", Fault.COIL_NOT_FOLLOWING, 4),  # the sample that measures it, and two more
        ("stuck-diode:2", Fault.SENSOR_FROZEN, 32),
        ("stuck-diodes:0", Fault.SENSOR_FROZEN, 32),
        ("invalid-diode:0", Fault.SENSOR_OUT_OF_RANGE, 2),
        ("stuck-counter:0", Fault.SENSOR_STOPPED, 2),
    ],
)
def test_a_fault_of_the_hardware_is_named_and_cut(start: Starter, fault: str, named: Fault, samples: int) -> None:
    host = start("--lockstep", "--noise", "5e-7", "--fault", f"{fault}@0.5").host()
    assert host.hello().frozen == 30
    host.sampled()
    assert host.ask(Operation.ARM).state == State.ACTIVE
    for _ in range(200):
        report = host.answered(HOVER)
        if report.state == State.FAULT:
            break
    assert report.faults == named
    assert 0.5 <= host.state.time * 1e-9 <= 0.5 + samples * PERIOD * 1e-9
    report = host.answered(HOVER)
    assert report.currents == ZERO and report.flags == Flag.ENABLED
    for _ in range(4):
        report = host.answered(HOVER)
    assert report.flags == 0  # nobody toggles the enable line


def test_a_current_that_does_not_stop_is_a_fault_of_its_own(start: Starter) -> None:
    host = start("--lockstep", "--fault", "stuck-amplifier:1@0.02").host()
    host.hello()
    host.sampled()
    host.ask(Operation.ARM)
    for _ in range(6):
        host.answered(HOVER)
    assert host.ask(Operation.DISARM).state == State.INACTIVE
    seen = [host.answered() for _ in range(3)]
    assert [report.faults for report in seen] == [0, 0, Fault.COIL_NOT_OFF]
    assert [report.currents[1] for report in seen] == pytest.approx([HOVER[1]] * 3)
    assert host.ask(Operation.RESET).result == Result.REFUSED
    assert host.estop().currents[1] == pytest.approx(HOVER[1])


def test_hover_currents_beyond_their_limit_are_refused(start: Starter) -> None:
    host = start("--lockstep").host()
    host.hello()
    most = PROFILE.limits.hover
    for current, result in ((most * 1.0001, Result.REFUSED), (math.nan, Result.REFUSED), (-most, Result.DONE)):
        assert host.ask(Operation.ARM, hover=(*ZERO[:5], current)).result == result


@pytest.mark.parametrize("keyed", [False, True], ids=["no key", "key"])
def test_anyone_stops_it_whatever_came_before(start: Starter, key_file: Path, keyed: bool) -> None:
    device = start("--rate", "200", "--watchdog", "5", *(["--key", str(key_file)] if keyed else []))
    host, other = device.host(), device.host()
    host.hello()
    host.sampled()
    host.ask(Operation.ARM)
    report = host.answered(ONES)
    host.sequence += 2**31 - 2
    host.command(ONES)
    host.sequence = 100
    while host.receive(0.0) is not None:  # what a slow host has not read yet
        pass
    for _ in range(8):  # deaf to those
        host.command(HOVER)
        report = host.sampled()
    assert report.state == State.ACTIVE and report.flags & Flag.HOLDING
    assert report.currents == pytest.approx(NOMINAL.hover)
    for _ in range(500):  # a flood
        other.socket.send(b"MJ, but no frame at all")
    first = other.estop(request=7)
    assert (first.state, first.faults) == (State.FAULT, Fault.ESTOP)
    time.sleep(0.011)
    again = other.estop(request=7)
    assert again.sampled > first.sampled and again.currents == ZERO
    assert host.ask(Operation.RESET).state == State.INACTIVE


def test_handshakes_that_fail(start: Starter) -> None:
    device = start("--lockstep")
    host = device.host()
    answer = host.hello(calibration=bytes(16))
    assert (answer.status, answer.calibration) == (HelloStatus.CALIBRATION, NOMINAL.digest)
    data = bytearray(host.codec.encode(0, 0, 0, Hello(1, NOMINAL.digest)))
    data[2] = 3
    host.socket.send(sealed(bytes(data) + b"of version 3"))
    assert host.wait(HelloAck).body[:4] == (0, HelloStatus.VERSION, 1, 2)
    assert device.end()["version"] == 1


@pytest.mark.parametrize("keyed", [False, True], ids=["no key", "key"])
def test_it_answers_as_the_firmware_in_python_does(start: Starter, key_file: Path, keyed: bool) -> None:
    device = start("--lockstep", *(["--key", str(key_file)] if keyed else []))
    host = device.host()
    draw = random.Random(5)
    codec = Codec(device.key)
    limits = replace(PROFILE.limits, frozen=0)
    profile = Profile(period=PERIOD, delay=1_500_000, calibration=NOMINAL.digest, limits=limits, lockstep=True)
    twin = Firmware(profile, _Nothing(), codec, lambda: 1)

    def sampled(before: int) -> int:
        """Compare the next sample of both; return its number."""
        while host.wait(StateReport).sequence == before:  # sent again, as this host was slow
            pass
        tick, report = host.state.sequence, host.state.body
        assert isinstance(report, StateReport)
        enabled = bool(report.flags & Flag.ENABLED)
        reading = Reading(report.spots, 7, ZERO, ZERO, (), report.conversions, enabled)
        mine = twin.sample(tick, tick * PERIOD, reading)
        assert mine is not None and _decoded(codec, mine).body == report
        return tick

    host.hello()
    twin.receive(codec.encode(0, 0, 0, Hello(1, NOMINAL.digest)), 0, "host")
    tick = sampled(-1)
    sequence = request = 0
    for number in range(1500):
        sequence = max(sequence + draw.choice([1, 1, 1, 1, 0, -1, 3]), 0)
        kind = draw.random()
        body: Any
        if number % 50 == 49:  # an answer to the sample, before the device in C gives its host up
            sequence, body = sequence + 5, Command(tick, 0, ZERO, ZERO, 0.0)
        elif kind < 0.06:
            body = Hello(draw.choice([1, 1, 2]), draw.choice([NOMINAL.digest, bytes(16)]))
        elif kind < 0.8:
            request = max(request + draw.choice([1, 1, 1, 1, 0, -1, 5]), 0)
            hover = draw.choice([HOVER, HOVER, HOVER, (*ZERO[:5], 11.0), (math.nan, *ZERO[:5])])
            operation = draw.choice([1, 1, 1, 1, 4, 4, 4, 4, 2, 3, 5, 0, 7, 255])
            body = Control(request, operation, draw.randrange(2**14), hover)
        else:
            body = draw.choice([Command(tick + 1, 0, ONES, ONES, 0.0), ControlAck(1, 1, 0, 0, 0), Estop(number)])
        session = 0 if isinstance(body, (Hello, Estop)) else 1
        mine = twin.receive(codec.encode(session, sequence, 0, body), tick * PERIOD, "host")
        host.send(body, session=session and host.session, sequence=sequence)
        if number % 50 == 49:
            tick = sampled(tick)
        elif mine is not None:
            frame = _decoded(codec, mine)
            answer = host.wait(type(frame.body))
            assert answer.body == frame.body and bool(answer.session) == bool(frame.session), number
    counts = {name: count for name, count in device.end().items() if count}
    assert counts == {name: count for name, count in twin.counts.items() if count}
    assert {"old", "direction", "busy", "inactive"} <= set(counts)


def test_rubbish_does_no_harm(start: Starter) -> None:
    device = start("--lockstep")
    host = device.host()
    host.hello()
    host.sampled()
    host.ask(Operation.ARM)
    draw = random.Random(9)
    genuine = [data for name, data in golden_bytes().items()]
    genuine += [host.codec.encode(host.session, 50, 0, Command(host.state.sequence, 0, ONES, ONES, 0.01))]
    genuine += [host.codec.encode(host.session, 50, 0, Control(60, Operation.ARM, 0, HOVER))]
    for number in range(20_000):
        data = bytearray(draw.choice(genuine))
        kind = draw.randrange(5)
        if kind == 0:
            data = bytearray(draw.randbytes(draw.randrange(600)))
        elif kind == 1:
            del data[draw.randrange(len(data)) :]
        else:
            for _ in range(draw.randrange(1, 6)):
                data[draw.randrange(len(data))] = draw.randrange(256)
            data[2:4] = bytes([2, draw.randrange(10)]) if kind == 2 else data[2:4]
        host.socket.send(sealed(bytes(data)) if kind > 2 and len(data) > 4 else bytes(data))
        if number % 50 == 49:  # no more than its socket holds; and it still answers a stranger
            _drain(host)
            other = device.host()
            assert other.hello(nonce=number).status in (HelloStatus.BUSY, HelloStatus.WELCOME)
            other.close()
            device.hosts.remove(other)
    counts = device.end()
    assert min(counts[name] for name in ("short", "magic", "crc", "version", "type", "length", "session")) > 0


def _drain(host: Host) -> None:
    host.socket.setblocking(False)
    try:
        while True:
            host.socket.recv(512)
    except BlockingIOError:
        pass


def _decoded(codec: Codec, data: bytes) -> Frame:
    frame = codec.decode(data)
    assert frame is not None
    return frame


class _Nothing:
    def drive(self, now: int, held: Sequence[float], pulsed: Sequence[float] | None, width: float) -> None:
        assert held == ZERO and pulsed is None

    def cut(self) -> None:
        pass

    def toggle(self, now: int) -> None:
        pass
