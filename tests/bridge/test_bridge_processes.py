"""Host and device as two processes over real sockets.

In lockstep, and after the death of one.
"""

import json
import os
import re
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest

from maglev_mj.bridge import Calibration, Fault, HostLimits, RemotePlant, State, Twin, TwinParameters, open_link
from maglev_mj.bridge.connection import Connection
from maglev_mj.bridge.preflight import measure_link
from maglev_mj.bridge.realtime import RealtimeError, realtime
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.bridge.wire import StateReport
from maglev_mj.cli import bridge
from maglev_mj.recording import Recording, RecordingError
from tests.bridge.test_stopping import waited
from tests.processes import PATIENCE, WEAK, Program, ended, said_by, started, twin

NEAR, FAR = "udp://127.0.0.1:0", "udp://127.0.0.1:1"


@contextmanager
def flown(address: str, folder: Path, *options: str) -> Iterator[Program]:
    """Fly a device; yield once it is in the air, with samples in `run.maglev`."""
    record = folder / "run.maglev"
    with started("bridge", address, *WEAK, "--record", str(record), "--out", str(folder), *options) as host:

        def in_flight() -> bool:
            assert host.child.poll() is None, host.output + host.errors
            with suppress(OSError, RecordingError):  # not begun yet
                return Recording.load(record).ticks > 0
            return False

        waited(in_flight, 0.1)
        yield host


def looked_at(address: str) -> StateReport:
    """Return a device's answer to any host."""
    with closing(Connection(open_link(address), Calibration.nominal().digest, None, PATIENCE)) as line:
        frame = line.state()
        assert isinstance(frame.body, StateReport)
        return frame.body


@pytest.fixture
def device(monkeypatch: pytest.MonkeyPatch) -> Twin:
    """Return a twin in virtual time, which the commands of this process open."""
    twin = Twin(TwinParameters(), draw=lambda: 7)
    links = [VirtualLink(twin)]

    def opened(_address: str, _key: object, calibration: Calibration, limits: HostLimits, out: Path) -> RemotePlant:
        before, link = links[-1], VirtualLink(twin)
        link.time = before.time + 1_000_000_000  # a flotor that was dropped lies
        while before.time < link.time:
            before.receive(0.1)
        links.append(link)
        return RemotePlant(links[-1], calibration=calibration, limits=limits, folder=out)

    monkeypatch.setattr(bridge, "_opened", opened)
    monkeypatch.setattr("maglev_mj.bridge.preflight.measure_link", lambda plant: measure_link(plant, 0.2))
    monkeypatch.setattr("maglev_mj.bridge.preflight._critical_delay", lambda *_: 0.0027)  # takes 0.4 s
    return twin


def assert_runs_again(path: Path) -> None:
    """Assert that the commands of a recording follow from its samples, and that one bit more is found."""
    status, said = said_by("replay", str(path), "--check")
    assert status == 0 and re.search(r"(\d+) of \1 equal: command, pulse, pulse_width\n", said), said
    (segment,) = Recording.load(path).segments
    row = len(segment) // 2
    segment.command[row, 2] = np.nextafter(segment.command[row, 2], 1e3)
    other = path.with_name("other.maglev")
    Recording([segment]).save(other)
    status, said = said_by("replay", str(other), "--check")
    assert status == 1 and "tick" in said


def test_it_takes_off_flies_lands_and_its_commands_run_again_bit_for_bit(device: Twin, tmp_path: Path) -> None:
    record = tmp_path / "run.maglev"
    status, said = said_by("bridge", FAR, "--seconds", "1", "--friction", "--record", str(record))
    assert status == 0 and "200 samples, 0 lost, 0 skipped" in said and "at rest" in said, said
    assert (device.firmware.state, device.firmware.faults) == (State.INACTIVE, Fault(0))
    assert_runs_again(record)


@pytest.mark.machine
@pytest.mark.parametrize("listen", [NEAR, "pty"])
def test_in_real_time_it_takes_off_flies_lands_and_its_commands_run_again(listen: str, tmp_path: Path) -> None:
    record = tmp_path / "run.maglev"
    with twin("--watchdog", "1", listen=listen) as (device, address):
        status, said = said_by("bridge", address, *WEAK, "--seconds", "1", "--friction", "--record", str(record))
        assert status == 0, said
        status, said = ended(device)
    assert status == 0 and "final state: inactive, no faults" in said
    assert re.search(r"sample latency: median .*, 99th percentile \S+ ms", said)  # by how much is the machine's affair
    assert_runs_again(record)


@pytest.mark.machine
def test_a_host_that_is_killed_leaves_zero_current_and_the_next_one_must_reset(tmp_path: Path) -> None:
    with twin("--watchdog", "1") as (device, address):
        with flown(address, tmp_path) as host:
            host.child.kill()
        # it says that the old host is still there until it has been silent for a second
        waited(lambda: looked_at(address).state == State.FAULT, 0.1)
        report = looked_at(address)
        assert (report.state, report.faults, report.currents) == (State.FAULT, Fault.WATCHDOG, (0.0,) * 6)
        status, said = said_by("bridge", address, *WEAK, "--seconds", "0.5", "--out", str(tmp_path))
        assert status == 1 and "no takeoff: device state FAULT, faults WATCHDOG: find the cause" in " ".join(
            said.split()
        )
        assert "final state: fault, faults WATCHDOG" in ended(device)[1]


@pytest.mark.machine
def test_a_device_that_is_gone_is_a_fault_of_the_host_and_the_recording_is_kept(tmp_path: Path) -> None:
    with twin("--watchdog", "1") as (device, address), flown(address, tmp_path) as host:
        device.child.kill()
        status, said = ended(host, None)
        assert status == 1 and "HOST: no sample from the device within 1 s" in said
        assert Recording.load(tmp_path / "run.maglev").ticks > 0


@pytest.mark.machine
def test_a_host_needs_the_devices_key(tmp_path: Path) -> None:
    for name, byte in (("key", "a7"), ("other", "b8")):
        (tmp_path / name).write_text(byte * 32 + "\n")
        (tmp_path / name).chmod(0o600)
    key = ["--key", str(tmp_path / "key")]
    with twin("--watchdog", "1", *key) as (device, address):
        for wrong in ([], ["--key", str(tmp_path / "other")]):
            status, said = said_by("bridge", address, *WEAK, "--seconds", "0.2", *wrong)
            assert status == 1 and "no device answered" in said
        status, said = said_by("bridge", address, *WEAK, "--seconds", "0.2", *key)
        assert status == 0, said
        assert re.search(r"frames ignored: .*\(wrong length\).*\(wrong\s+key\)", ended(device)[1])


@pytest.mark.machine
def test_real_time_is_enforced_where_the_system_permits_it(monkeypatch: pytest.MonkeyPatch) -> None:
    arguments = ("twin", "--listen", NEAR, "--seconds", "0.1", "--realtime", "enforce")
    try:
        with realtime("enforce"):
            permitted = True
    except RealtimeError:
        permitted = False
    assert said_by(*arguments)[0] == (0 if permitted else 1)

    def refuse(*_: Any) -> NoReturn:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    status, said = said_by(*arguments)
    assert status == 1 and re.search(r"real-time settings refused: .*SCHED_FIFO.*not permitted", said)
    assert said_by(*arguments[:-1], "ignore")[0] == 0


def test_the_hosts_limits_hold_in_flight_and_options_go_before_the_profile(device: Twin, tmp_path: Path) -> None:
    profile = tmp_path / "careful.json"
    profile.write_text(json.dumps({"max_current": 4.0, "speed_limit": 0.001}))
    arguments = ("bridge", FAR, "--seconds", "0.3", "--out", str(tmp_path), "--profile", str(profile))
    status, said = said_by(*arguments)
    assert status == 1 and "FLOTOR_OVERSPEED" in said
    status, said = said_by("bridge", FAR, "--reset")
    assert status == 0, said
    status, said = said_by(*arguments, "--speed-limit", "0.6")
    assert status == 0 and "at rest" in said, said
    assert (device.firmware.state, device.firmware.faults) == (State.INACTIVE, Fault(0))
