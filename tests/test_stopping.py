"""What ends a flight: Ctrl-C once and twice, SIGTERM, SIGHUP, a window's key; and how soon the currents are zero."""

import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from maglev_mj.bridge import Fault, State, Twin, TwinParameters
from maglev_mj.bridge.safety import Limits
from maglev_mj.bridge.twin import TwinServer
from maglev_mj.net.udp import UdpServer

COMMAND = [sys.executable, "-m", "maglev_mj.cli"]
ZERO_CURRENT = 1e-9

pytestmark = pytest.mark.xdist_group("realtime")


class Moment(NamedTuple):
    """A sample of the twin: when, its state, faults, and largest current [A]."""

    time: float
    state: State
    faults: Fault
    current: float


class Watched:
    """A twin in this process, and every sample of it."""

    def __init__(self, **options: Any) -> None:
        self.twin = Twin(TwinParameters(limits=Limits(watchdog=1.0), **options))
        self.server = TwinServer(self.twin, UdpServer("127.0.0.1", 0))
        self.moments: list[Moment] = []
        self._thread = threading.Thread(target=self.server.run, kwargs={"each": self._look})

    def _look(self) -> None:
        firmware = self.twin.firmware
        current = float(np.abs(self.twin.plant.currents).max())
        self.moments.append(Moment(time.monotonic(), firmware.state, firmware.faults, current))

    def __enter__(self) -> "Watched":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.server.stop()
        self._thread.join()
        self.server.close()

    @property
    def address(self) -> str:
        return "udp://{}:{}".format(*self.server.address)

    @property
    def last(self) -> Moment:
        return self.moments[-1]

    def until(self, so: Callable[[], bool], patience: float = 30.0) -> float:
        """Wait until something is so; return when it was seen."""
        end = time.monotonic() + patience
        while not so():
            assert time.monotonic() < end, "waited in vain"
            time.sleep(0.001)
        return time.monotonic()

    def flown(self, seconds: float) -> None:
        """Wait until the device has been active for so long."""
        start = self.until(lambda: bool(self.moments) and self.last.state == State.ACTIVE)
        self.until(lambda: time.monotonic() - start >= seconds)

    def cut_after(self, when: float) -> float:
        """Return how long after an instant the currents were zero for good [s]."""
        flowing = [one.time for one in self.moments if one.time > when and one.current > ZERO_CURRENT]
        after = flowing[-1] if flowing else when
        return next(one.time for one in self.moments if one.time > after) - when


@contextmanager
def flight(twin: Watched, folder: Path, *options: str) -> Iterator[subprocess.Popen[str]]:
    command = [*COMMAND, "bridge", twin.address, "--out", str(folder), *options]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        yield child
    finally:
        child.kill()
        child.communicate()


LANDING = [(signal.SIGINT, at) for at in (0.02, 0.3, 0.58, 1.0)]
LANDING += [(kind, at) for kind in (signal.SIGTERM, signal.SIGHUP) for at in (0.3, 1.0)]


@pytest.mark.parametrize(("kind", "at"), LANDING, ids=[f"{kind.name}-{at}" for kind, at in LANDING])
def test_the_first_signal_lands_at_any_time_of_takeoff_and_flight(
    kind: signal.Signals, at: float, tmp_path: Path
) -> None:
    record = tmp_path / "run.npz"
    with Watched() as twin, flight(twin, tmp_path, "--record", str(record)) as host:
        twin.flown(at)
        sent = time.monotonic()
        host.send_signal(kind)
        said, _ = host.communicate(timeout=30)
        after = twin.cut_after(sent)
        print(f"{kind.name} at {at} s: {after * 1e3:.0f} ms to zero current")
    assert host.returncode == 0, said
    assert (twin.last.state, twin.last.faults) == (State.INACTIVE, Fault(0))
    assert 0.5 < after < 1.5
    assert abs(twin.twin.pose[2] + 0.0045) < 1e-4  # it lies where it lay
    assert record.exists() == (at > 0.6), said


TWICE = [(at, gap) for at in (0.02, 0.3, 1.0) for gap in (0.05, 0.4)]


@pytest.mark.parametrize(("at", "gap"), TWICE)
def test_a_second_ctrl_c_cuts_now(at: float, gap: float, tmp_path: Path) -> None:
    record = tmp_path / "run.npz"
    with Watched() as twin, flight(twin, tmp_path, "--record", str(record)) as host:
        twin.flown(at)
        host.send_signal(signal.SIGINT)
        time.sleep(gap)
        sent = time.monotonic()
        host.send_signal(signal.SIGINT)
        said, _ = host.communicate(timeout=30)
        after = twin.cut_after(sent)
        print(f"twice, at {at} s and {gap} s later: {after * 1e3:.1f} ms to zero current")
    assert host.returncode == 1 and "ESTOP" in said, said
    assert (twin.last.state, twin.last.faults) == (State.FAULT, Fault.ESTOP)
    assert after < 0.05
    assert record.exists() == (at > 0.6), said
    (box,) = tmp_path.glob("maglev-fault-*.json")
    assert json.loads(box.read_text())["faults"] == "ESTOP"
