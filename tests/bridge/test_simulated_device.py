"""Firmware in C on simulated hardware over UDP: conformance, its plant, faults of its hardware."""

from __future__ import annotations

import math
import re
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

from maglev_mj import find_scene
from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.conformance import conform
from maglev_mj.bridge.conformance.tester import CHECKS
from maglev_mj.bridge.conformance.tester import Tester as Host
from maglev_mj.bridge.fault import DeviceFault
from maglev_mj.bridge.flight import Flight
from maglev_mj.bridge.links import UdpLink
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.bridge.safety import at_most, limits_of
from maglev_mj.bridge.twin.twin import TwinParameters
from maglev_mj.bridge.wire import (
    PROPERTIES,
    Fault,
    Flag,
    HelloStatus,
    Operation,
    State,
    StateReport,
)
from maglev_mj.plants.sensor import PoseScale, beams
from tests.bridge.devices import DEVICES
from tests.bridge.firmware_core import FOLDER, SANITIZED, STRICT
from tests.bridge.test_conform import SCALED
from tests.bridge.test_firmware import HOVER, ZERO
from tests.bridge.test_wire import KEY, golden_bytes
from tests.conftest import COMPILER
from tests.processes import Program

PROFILE = TwinParameters().profile
NOMINAL = Calibration.nominal()
SLOPES = beams()._spots(np.zeros(6))[1]
MAPS = NOMINAL.wall_maps
PERIOD = 5_000_000

pytestmark = pytest.mark.needs("compiler")


def built(folder: Path, flags: Sequence[str]) -> Path | None:
    """Return the compiled program; None for unknown flags."""
    program = folder / "simulated_device"
    parts = ["simulated_device.c", "simulated_flotor.c", "maglev_queue.c", "maglev_firmware.c"]
    sources = [str(FOLDER / name) for name in parts]
    command = [str(COMPILER), *STRICT, *flags, *sources, "-o", str(program), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    if done.returncode and flags == ["-O2"]:
        pytest.fail(f"{' '.join(command)}:\n{done.stderr}")
    return None if done.returncode else program


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the program, with sanitizers if available, beside a plant and the page's key."""
    folder = tmp_path_factory.mktemp("device")
    found = built(folder, SANITIZED) or built(folder, ["-O2"])
    assert found is not None
    write_plant(folder / "plant.txt")
    (folder / "key").write_text(KEY.hex() + "\n", encoding="ascii")
    return found


def write_plant(path: Path, device: Calibration = NOMINAL) -> Path:
    """Write the program's plant: a device linearised about its centre, with its limits."""
    sensor = device.beams
    slopes = np.diag(sensor.spots(np.ones(6))) if isinstance(sensor, PoseScale) else sensor._spots(np.zeros(6))[1]
    rows: dict[str, ArrayLike] = {
        "wrench_per_current": device.coils.wrench_per_current,
        "inertia": [*[device.mass] * 3, *device.inertia],
        "gravity": [*device.gravity, 0.0, 0.0, 0.0],
        "spots_per_pose": slopes,
        "rest": device.base.rest,
        "pose_per_spot": device.wall_maps.pose_per_spot,
        "current_per_wrench": device.wall_maps.current_per_wrench,
    }
    limits = limits_of(device.device)
    names = [limit.name for limit in limits.parameters() if PROPERTIES[limit.name].type == "f64"]
    rows |= {name: getattr(limits, name) for name in names if name != "hover_limit"}  # an option
    lines = [f"{name} {' '.join(repr(float(one)) for one in np.ravel(values))}" for name, values in rows.items()]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
    return path


@dataclass
class Device:
    """The program, running, and links to it.

    Attributes:
        key: Key of its frames.
        links: Links that were opened, to be closed with it.
        counts: Number of frames it ignored by reason, once it has ended.
    """

    program: Program
    port: int
    key: bytes | None
    links: list[UdpLink]
    counts: dict[str, int]

    def link(self) -> UdpLink:
        """Open a link from one more address."""
        self.links.append(UdpLink("127.0.0.1", self.port))
        return self.links[-1]

    def host(self) -> Host:
        """Return a host in session that has seen the first sample, and answers none by itself."""
        host = Host([self.link()], NOMINAL, self.key)
        host.answering = False
        host.join()
        host.states(1)
        return host

    def end(self) -> dict[str, int]:
        """End the program normally; return the number of frames it ignored by reason."""
        for link in self.links:
            link.close()
        if not self.counts:
            status, output, errors = self.program.end(15)
            assert status == 0 and not errors, errors
            self.counts = {name: int(count) for name, count in re.findall(r"(\w+) (\d+)", output)}
        return self.counts


Starter = Callable[..., Device]


@pytest.fixture
def start(program: Path) -> Iterator[Starter]:
    """Start devices that are ended with the test."""
    devices: list[Device] = []

    def new(*arguments: str, device: str | None = None) -> Device:
        calibration = NOMINAL if device is None else Calibration.of(DEVICES[device])
        plant, twin = program.parent / "plant.txt", TwinParameters(calibration=calibration).profile
        if device is not None:
            write_plant(plant := program.parent / f"{device}.txt", calibration)
            own = {"rate": 1e9 / twin.period, "delay": (twin.delay + twin.latency) * 1e-9}
            arguments = (*(part for name, value in own.items() for part in (f"--{name}", str(value))), *arguments)
        known = ["--plant", str(plant), "--calibration-hash", calibration.digest.hex(), "--seconds", "60"]
        child = Program(str(program), *known, "--hover-limit", str(twin.limits.hover_limit), *arguments)
        port = int(child.wait_for(r"^listening udp://127\.0\.0\.1:(\d+)$"))
        devices.append(Device(child, port, KEY if "--key" in arguments else None, [], {}))
        return devices[-1]

    yield new
    try:
        for device in devices:
            device.end()
    finally:
        for device in devices:
            device.program.close()


def answered(host: Host, held: ArrayLike = ZERO, pulsed: ArrayLike = ZERO, width: float = 0.0) -> StateReport:
    """Answer the last sample; return the next."""
    first, second = (tuple(np.asarray(values, dtype=float).tolist()) for values in (held, pulsed))
    host.command(host.last.sequence, first, second, width)
    report: StateReport = host.states(1)[0].body
    return report


@pytest.mark.parametrize("keyed", [False, True], ids=["no key", "key"])
def test_golden_bytes(program: Path, keyed: bool) -> None:
    frames = [data for name, data in golden_bytes().items() if name.endswith("keyed") == keyed]
    command = [str(program), "--golden", *(["--key", str(program.parent / "key")] if keyed else [])]
    lines = "\n".join(data.hex() for data in frames)
    done = subprocess.run(command, input=lines, capture_output=True, text=True, check=True, timeout=30)
    assert done.stdout.split() == lines.split() and len(frames) == 9


@pytest.mark.parametrize(
    "arguments",
    [
        ["--rate", "0"],
        ["--rate", "200x"],
        ["--speed", "1"],
        ["--calibration-hash", "00"],
        ["--plant", "/nowhere"],
        ["--key", str(FOLDER / "README.md")],
        ["--fault", "stuck-diode:3@0"],
        ["--hand", "0,0,-5,0,0,0@2:1"],
        [],
    ],
)
def test_arguments_that_cannot_be_are_refused(program: Path, arguments: list[str]) -> None:
    done = subprocess.run([str(program), *arguments], capture_output=True, text=True, check=False, timeout=30)
    assert done.returncode == 2 and done.stderr.startswith("simulated_device: ") and done.stderr.count("\n") == 1


IN_REAL_TIME = [name for name, one in CHECKS.items() if one.real_time and not one.flight and name != "takeover"]


@pytest.mark.parametrize(
    ("arguments", "only"),
    [
        pytest.param(["--lockstep"], None, id="lockstep"),
        pytest.param(["--lockstep", "--key"], None, id="lockstep-keyed"),
        # slow, so that a machine that stalls for 30 ms makes no difference
        pytest.param(["--rate", "50", "--watchdog", "0.4"], IN_REAL_TIME, id="real-time"),
    ],
)
def test_it_passes_the_checks(start: Starter, program: Path, arguments: list[str], only: list[str] | None) -> None:
    device = start(*arguments, *([str(program.parent / "key")] if "--key" in arguments else []))
    results = conform([device.link(), device.link()], key=device.key, only=only)
    # a machine that stalls is no fault of the device
    assert not [one for one in results if one.passed is False and not one.seen.endswith("STATEs were read late")]
    skipped = {one.name for one in results if one.passed is None}
    lacking = {name for name, one in CHECKS.items() if one.real_time or (one.keyed and not device.key)}
    assert skipped == (set() if only else lacking)
    assert only or min(device.end()[name] for name in ("magic", "crc", "version", "type", "length", "old", "busy")) > 0


@pytest.mark.parametrize("name", DEVICES)
def test_devices_of_any_size_pass_the_checks(start: Starter, name: str) -> None:
    calibration = Calibration.of(DEVICES[name])
    results = conform([start("--lockstep", device=name).link()], calibration, only=SCALED)
    assert not [one for one in results if one.passed is False]
    assert any(at_most(DEVICES[name].scale.off) in one.seen for one in results)


@pytest.mark.parametrize("fault", [None, "stuck-amplifier:1@1.2", "dead-coil:1@1.2"])
@pytest.mark.parametrize("name", DEVICES)
def test_devices_of_any_size_fly(start: Starter, name: str, fault: str | None) -> None:
    calibration, off = Calibration.of(DEVICES[name]), at_most(DEVICES[name].scale.off)
    link = start("--lockstep", *(["--fault", fault] if fault else []), device=name).link()
    plant, said = RemotePlant(link, calibration=calibration), "landed"
    stated, own = plant.stated, limits_of(calibration.device)
    names = "off_current", "energy", "recede", "lever", "edge_speed", "stiffness_limit", "damping_limit"
    assert [getattr(stated, name) for name in names] == [getattr(own, name) for name in names]
    try:
        scene = find_scene("joystick")().replace(period=plant.period, delay=plant.delay)
        assert Flight(plant, scene).run(0.2).landing.at_rest
    except DeviceFault as error:
        said = str(error)
    kind = fault and fault.partition(":")[0]
    endings = {None: "landed", "dead-coil": off, "stuck-amplifier": "cut the power at the amplifiers"}
    assert said.endswith(endings[kind]) and (not fault or said.startswith("COIL_NOT_"))
    report = plant.estop()
    assert report.off is None and "in lockstep no sample follows, so the currents are not measured" in str(report)


def test_motion_is_exact_between_switches(start: Starter) -> None:
    host = start("--lockstep", "--delay", "0.0015").host()
    assert host.ask(Operation.ARM).state == State.ACTIVE
    held, pulsed, width = np.array(NOMINAL.hover) * 1.5, np.array(NOMINAL.hover) * 1.2 + 0.3, 0.002
    report = answered(host, held, pulsed, width)
    inertia = np.array([*[NOMINAL.mass] * 3, *NOMINAL.inertia])
    gravity = np.array([*NOMINAL.gravity, 0.0, 0.0, 0.0])
    pose, speed = np.array(NOMINAL.base.rest), np.zeros(6)
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


def test_lockstep_sends_again_and_then_lets_go(start: Starter) -> None:
    device = start("--lockstep")
    begun = time.monotonic()
    host = device.host()
    first, link = host.last, host.links[0]
    host.ask(Operation.ARM)
    again: list[Any] = []
    while len(again) < 5:
        data = link.receive(60.0)
        assert data is not None
        again.append(host.codec.decode(data))
    assert again == [first] * 5  # the same bytes, 20, 40, 80, 160 and 320 ms later
    assert time.monotonic() - begun >= 0.32
    report = answered(host)
    assert report.state == State.ACTIVE and host.last.sequence == first.sequence + 1  # its time stood still
    other = Host([device.link()], NOMINAL, None)
    end = time.monotonic() + 60.0
    while (answer := other.greet(2).body).status == HelloStatus.BUSY:
        assert time.monotonic() < end
        time.sleep(0.1)
    assert time.monotonic() - begun > 2.0
    assert answer.status == HelloStatus.WELCOME and (answer.state, answer.faults) == (State.FAULT, Fault.WATCHDOG)


@pytest.mark.parametrize(
    ("fault", "named", "samples"),
    [
        ("dead-coil:1", Fault.COIL_NOT_FOLLOWING, 4),  # the sample that measures it, and two more
        ("stuck-diode:2", Fault.SENSOR_FROZEN, 32),
        ("stuck-counter:0", Fault.SENSOR_STOPPED, 2),
    ],
)
def test_a_fault_of_the_hardware_is_named_and_cut(start: Starter, fault: str, named: Fault, samples: int) -> None:
    host = start("--lockstep", "--noise", "5e-7", "--fault", f"{fault}@0.5").host()
    assert host.welcome.frozen == 30
    assert host.ask(Operation.ARM).state == State.ACTIVE
    for _ in range(200):
        report = answered(host, HOVER)
        if report.state == State.FAULT:
            break
    assert report.faults == named
    assert 0.5 <= host.last.time * 1e-9 <= 0.5 + samples * PERIOD * 1e-9
    report = answered(host, HOVER)
    assert report.currents == ZERO and report.flags == Flag.ENABLED
    for _ in range(4):
        report = answered(host, HOVER)
    assert report.flags == 0  # nobody toggles the enable line
