"""Host and device as two processes over real sockets.

In lockstep, and after the death of one.
"""

import json
import os
import re
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest

from maglev_mj import MuJoCoPlant, Timing, drive
from maglev_mj.bridge import Calibration, Fault, RemotePlant, State, Twin, TwinParameters, open_link
from maglev_mj.bridge.connection import Connection
from maglev_mj.bridge.links import UdpLink, UdpServer
from maglev_mj.bridge.realtime import RealtimeError, realtime
from maglev_mj.bridge.twin.simulated_links import Impairment
from maglev_mj.bridge.twin.twin import TwinServer
from maglev_mj.bridge.wire import StateReport
from maglev_mj.control.loop import Plant
from maglev_mj.plants import SpotSensor
from maglev_mj.recording import Recording
from maglev_mj.scenes import Scene
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.rooms import Table
from tests.processes import ADDRESS, Program, ended, running, said_by, started, twin
from tests.recorded import command_row
from tests.udp_proxy import UdpProxy

NEAR = "udp://127.0.0.1:0"

pytestmark = pytest.mark.xdist_group("realtime")

LOCKSTEP = """
import sys
from maglev_mj.bridge import Twin, TwinParameters
from maglev_mj.bridge.links import UdpServer
from maglev_mj.bridge.twin.twin import TwinServer
pose = [float(part) for part in sys.argv[1].split()]
twin = Twin(TwinParameters(lockstep=True, pose=pose, seed=5))
server = TwinServer(twin, UdpServer("127.0.0.1", 0))
print("udp://{}:{}".format(*server.address), flush=True)
server.run(60.0)
"""


@contextmanager
def flown(address: str, folder: Path, *options: str) -> Iterator[Program]:
    """Fly a device; yield once it is in the air."""
    record = str(folder / "run.npz")
    with started("bridge", address, "--anyway", "--record", record, "--out", str(folder), *options) as host:
        host.wait_for("takes off")
        time.sleep(2.0)  # nearly twice as long as that
        yield host


def looked_at(address: str) -> StateReport:
    """Return a device's answer to any host."""
    with closing(Connection(open_link(address), Calibration.nominal().digest, None, 10.0)) as line:
        frame = line.state(10.0)
        assert frame is not None and isinstance(frame.body, StateReport)
        return frame.body


def rows(plant: Plant, scene: Scene) -> np.ndarray:
    seen: list[tuple[float, ...]] = []
    drive(plant, scene.controller(), 400, observe=lambda s, c: seen.append((*s.position, *command_row(c))))
    return np.array(seen)


DROP = Drop(), (0.0, 0.0, 0.004, 0.0, 0.0, 0.0)
STICK_SLIP = Table(), (0.001, 0.0, 0.0, 0.0, 0.01, 0.0)


@pytest.mark.needs("workers")
def test_tests_in_real_time_take_turns(request: pytest.FixtureRequest) -> None:
    assert request.node.nodeid.endswith("@realtime")  # by which one worker gets them all


@pytest.mark.parametrize(
    ("scene", "pose", "loss"),
    [
        pytest.param(*DROP, 0.03, id="drop-0.03"),
        pytest.param(*STICK_SLIP, 0.0, id="stick-slip-0.0"),
        pytest.param(*DROP, 0.0, id="drop-0.0", marks=pytest.mark.study),
        pytest.param(*STICK_SLIP, 0.03, id="stick-slip-0.03", marks=pytest.mark.study),
    ],
)
def test_in_lockstep_over_udp_every_bit_is_that_of_the_plant_in_this_process(
    scene: Scene, pose: tuple[float, ...], loss: float
) -> None:
    local = MuJoCoPlant(
        Timing(),
        pose=pose,
        current_limit=10.0,
        sensor=SpotSensor(quantum=8e-7, noise=4e-7, seed=5),
        stops=True,
        stop_damping=True,
    )
    with running(sys.executable, "-c", LOCKSTEP, " ".join(map(str, pose))) as device:
        address = device.wait_for(ADDRESS)
        host, port = address.removeprefix("udp://").split(":")
        with UdpProxy((host, int(port)), Impairment(loss=loss, duplicate=loss, seed=1)) as proxy:
            place, number = proxy.address
            with RemotePlant(open_link(f"udp://{place}:{number}")) as plant:
                plant.arm()
                np.testing.assert_array_equal(rows(plant, scene), rows(local, scene))


def test_in_real_time_it_takes_off_flies_lands_and_its_commands_run_again_bit_for_bit(tmp_path: Path) -> None:
    with twin("--watchdog", "1") as (device, address):
        arguments = ("--seconds", "2", "--friction", "--record", str(tmp_path / "run.npz"))
        status, said = said_by("bridge", address, *arguments)
        assert status == 0 and re.search(r"40\d samples, 0 lost", said), said
        status, said = ended(device)
    assert status == 0 and "inactive, faults: none" in said
    assert re.search(r"late by .* median, \S+ ms at 99 %", said)  # by how much is the machine's affair
    status, said = said_by("replay", str(tmp_path / "run.npz"), "--check")
    assert status == 0 and re.search(r"(\d+) of \1 the same: command, pulse, pulse_width\n", said), said
    (stretch,) = Recording.load(tmp_path / "run.npz").stretches
    stretch.command[100, 2] = np.nextafter(stretch.command[100, 2], 1e3)
    Recording([stretch]).save(tmp_path / "other.npz")
    status, said = said_by("replay", str(tmp_path / "other.npz"), "--check")
    assert status == 1 and "tick" in said


def test_a_host_that_is_killed_leaves_zero_current_and_the_next_one_must_reset(tmp_path: Path) -> None:
    with twin() as (device, address):
        with flown(address, tmp_path) as host:
            host.child.kill()
        # it says that the old host is still there until it has been silent for a second
        report = looked_at(address)
        assert (report.state, report.faults, report.currents) == (State.FAULT, Fault.WATCHDOG, (0.0,) * 6)
        status, said = said_by("bridge", address, "--anyway", "--seconds", "0.5", "--out", str(tmp_path))
        assert status == 1 and "no takeoff: the device is FAULT, faults WATCHDOG" in said
        assert "fault, faults: WATCHDOG" in ended(device)[1]


def test_a_host_that_is_stopped_finds_the_watchdogs_fault_when_it_goes_on(tmp_path: Path) -> None:
    with twin() as (device, address), flown(address, tmp_path) as host:
        host.child.send_signal(signal.SIGSTOP)
        time.sleep(0.5)
        host.child.send_signal(signal.SIGCONT)
        status, said = ended(host, None)
        assert status == 1 and "WATCHDOG" in said
        assert Recording.load(tmp_path / "run.npz").ticks > 100
        (last,) = tmp_path.glob("maglev-fault-*.json")
        assert len(json.loads(last.read_text())["cycles"]) == 200
        assert "fault, faults: WATCHDOG" in ended(device)[1]


def test_a_device_that_is_gone_is_a_fault_of_the_host_and_the_recording_is_kept(tmp_path: Path) -> None:
    with twin("--watchdog", "1") as (device, address), flown(address, tmp_path) as host:
        device.child.kill()
        status, said = ended(host, None)
        assert status == 1 and "HOST: no sample from the device within 1 s" in said
        assert Recording.load(tmp_path / "run.npz").ticks > 100


def test_a_second_host_is_turned_away_and_the_first_flies_on_until_ctrl_c(tmp_path: Path) -> None:
    with twin("--watchdog", "1") as (device, address), flown(address, tmp_path) as host:
        status, said = said_by("bridge", address, "--anyway", "--seconds", "0.5")
        assert status == 1 and "another host has the device" in said
        status, said = ended(host, signal.SIGINT)
        assert status == 0, said
        assert Recording.load(tmp_path / "run.npz").ticks > 100
        assert "inactive, faults: none" in ended(device)[1]


def _key(path: Path, byte: str) -> list[str]:
    path.write_text(byte * 32 + "\n")
    path.chmod(0o600)
    return ["--key", str(path)]


def test_a_host_needs_the_devices_key(tmp_path: Path) -> None:
    key, other = _key(tmp_path / "key", "a7"), _key(tmp_path / "other", "b8")
    with twin("--watchdog", "1", *key) as (device, address):
        for wrong, reason in (([], "no device answered"), (other, "no device answered")):
            status, said = said_by("bridge", address, "--anyway", "--seconds", "0.2", *wrong)
            assert status == 1 and reason in said
        status, said = said_by("bridge", address, "--anyway", "--seconds", "0.2", *key)
        assert status == 0, said
        assert re.search(r"frames ignored: .*for length.*for tag", ended(device)[1])


def test_a_flight_over_a_serial_line(tmp_path: Path) -> None:
    with twin("--watchdog", "1", listen="pty") as (device, address):
        status, said = said_by("bridge", address, "--anyway", "--seconds", "1")
        counted = re.search(r"(\d+) samples, (\d+) lost(?:, (\d+) skipped)?", said)
        assert status == 0 and counted and sum(int(count or 0) for count in counted.groups()) >= 200, said
        assert "inactive, faults: none" in ended(device)[1]


def test_a_twin_too_slow_for_its_rate_is_late_but_not_deaf() -> None:
    server = TwinServer(Twin(TwinParameters()), UdpServer("127.0.0.1", 0))
    thread = threading.Thread(target=server.run, kwargs={"each": lambda: time.sleep(0.01)})  # of a period of 5 ms
    with closing(server):
        thread.start()
        try:
            with RemotePlant(UdpLink(*server.address), patience=5.0) as plant:
                plant.arm()
                plant.estop()
            assert server.twin.firmware.faults == Fault.ESTOP
        finally:
            server.stop()
            thread.join()


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
    assert status == 1 and re.search(r"no real time: .*SCHED_FIFO.*not permitted", said)
    assert said_by(*arguments[:-1], "ignore")[0] == 0


def test_the_hosts_limits_hold_in_flight_and_options_go_before_the_profile(tmp_path: Path) -> None:
    profile = tmp_path / "careful.json"
    profile.write_text(json.dumps({"max_current": 4.0, "speed_limit": 0.001}))
    with twin("--watchdog", "1") as (device, address):
        arguments = ("bridge", address, "--seconds", "0.3", "--out", str(tmp_path), "--profile", str(profile))
        status, said = said_by(*arguments)
        assert status == 1 and "FLOTOR_OVERSPEED" in said
        assert said_by("bridge", address, "--reset")[0] == 0
        status, said = said_by(*arguments, "--speed-limit", "0.6")
        assert status == 0 and "at rest" in said, said
        assert "inactive, faults: none" in ended(device)[1]


def test_help_says_what_ends_a_flight() -> None:
    status, said = said_by("bridge", "--help")
    assert status == 0
    for words in ("Ctrl-C twice", "SIGTERM, SIGHUP", "2 s later", "Esc in the window", "maglev-mj estop ADDRESS"):
        assert words in said
    for option in ("max-current", "force-limit", "torque-limit", "envelope", "speed-limit", "profile", "reset"):
        assert f"--{option}" in said


def test_where_no_device_answers_that_is_said_in_one_line() -> None:
    for arguments, words in (
        (("estop", "udp://127.0.0.1:9"), "not confirmed: cut the power (no answer within 1"),
        (("bridge", "udp://127.0.0.1:9"), "udp://127.0.0.1:9: no device answered within 1 s"),
    ):
        status, said = said_by(*arguments)
        assert status == 1 and words in said and said.count("\n") == 1, said
