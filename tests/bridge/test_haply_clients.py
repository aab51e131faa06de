"""Arm's twin over real sockets: access control, frames, the command, and a client of another project."""

from __future__ import annotations

import asyncio
import importlib
import subprocess
import sys
import time
import types
import zipfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin

from maglev_mj.bridge import Arm, HaplyPlant, HaplyServer, HaplyTwin
from maglev_mj.bridge.haply.plant import devices, force_message, token_of
from maglev_mj.bridge.links import LinkError
from maglev_mj.errors import ParameterError, PlantError
from maglev_mj.frames import ZERO, Command
from maglev_mj.theory import largest_stable_stiffness
from tests.bridge.test_haply import FREE
from tests.processes import PATIENCE, started

pytestmark = pytest.mark.machine


@contextmanager
def served(twin: HaplyTwin, **options: Any) -> Iterator[HaplyServer]:
    with closing(HaplyServer(twin, 0, **options)) as server:
        yield server


def status(server: HaplyServer, path: str = "", origin: str | None = None, **headers: str) -> int:
    address = f"ws://127.0.0.1:{server.address[1]}/{path}"
    try:
        with connect(address, origin=None if origin is None else Origin(origin), additional_headers=headers):
            return 101
    except InvalidStatus as error:
        return error.response.status_code


def test_hosts_origins_and_keys_are_checked() -> None:
    key = b"k" * 16
    with served(HaplyTwin(), origins=["http://127.0.0.1:8080"]) as server:
        assert status(server) == status(server, origin="http://127.0.0.1:8080") == 101
        for origin in ("http://evil.example", "null", "http://127.0.0.1:1"):
            assert status(server, origin=origin) == 403
    with served(HaplyTwin(), key=key) as server:
        assert status(server) == status(server, "?token=") == status(server, f"{server.query}0") == 403
        assert status(server, server.query) == 101 and server.query == token_of(key)
        address = f"haply://127.0.0.1:{server.address[1]}"
        with pytest.raises(LinkError, match="HTTP 403"):
            HaplyPlant(address)
        HaplyPlant(address, key=key).close()
    with pytest.raises(ParameterError, match="loopback address"):
        HaplyServer(HaplyTwin(), 0, "0.0.0.0")


def test_text_and_binary_frames_get_one_update_each_and_a_closed_socket_no_force() -> None:
    twin = HaplyTwin(lockstep=True)
    with served(twin) as server:
        with connect(f"ws://127.0.0.1:{server.address[1]}") as line:
            assert "config" in devices(line.recv(PATIENCE))["TWIN"]
            for frame in (force_message("TWIN", (0.0, 3.0, 0.0)), force_message("TWIN", (0.0, 2.0, 0.0)).decode()):
                line.send(frame)
                assert (
                    devices(line.recv(PATIENCE))["TWIN"]["state"]["current_cursor_force"]["y"] == twin.force[1] != 0.0
                )
            with pytest.raises(TimeoutError):
                line.recv(0.05)
        deadline = time.monotonic() + PATIENCE
        while any(twin.force):
            assert time.monotonic() < deadline
            time.sleep(0.01)


def test_a_plant_reads_the_twin_of_the_command_and_notices_its_end() -> None:
    with started("twin", "--haply", "0", "--lockstep", "--rate", "100") as program:
        address = program.wait_for(r"arm at ws://(127\.0\.0\.1:\d+)/, 100 Hz, in lockstep")
        with HaplyPlant(f"haply://{address}?rate=100") as plant:
            assert plant.period == 0.01 and plant.device == "TWIN"
            for tick in range(5):
                assert plant.read().tick >= tick
                plant.write(Command(ZERO))
            assert program.end().status == 0 and "0 forces above the limit" in program.output
            with pytest.raises(PlantError, match="the service closed the connection"):
                plant.read()


ISAAC = "isaaclab==2.3.2.post1"


@pytest.fixture(scope="session")
def isaac(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return IsaacLab's module for the Haply, unmodified from the package index; torch is replaced by NumPy."""
    folder = tmp_path_factory.mktemp("isaac")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "download", "--quiet", "--no-deps"]
    only = ["--only-binary=:all:", "--platform=manylinux_2_35_x86_64", "--python-version=3.11"]
    if subprocess.run([*pip, *only, f"--dest={folder}", ISAAC], capture_output=True, timeout=PATIENCE).returncode:
        pytest.skip(f"peer {ISAAC} cannot be downloaded")
    (wheel,) = folder.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder, [name for name in archive.namelist() if "/isaaclab/devices/" in name])
    root = next(folder.rglob("isaaclab/devices")).parent
    torch: Any = types.ModuleType("torch")
    torch.float32, torch.Tensor, torch.tensor = np.float32, np.ndarray, lambda values, **_: np.asarray(values)
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "torch", torch)
        for name in ("isaaclab", "isaaclab.devices", "isaaclab.devices.haply"):  # not their imports of the simulator
            module = types.ModuleType(name)
            module.__path__ = [str(Path(root, *name.split(".")[1:]))]
            patch.setitem(sys.modules, name, module)
        yield importlib.import_module("isaaclab.devices.haply.se3_haply")


class Tensor(np.ndarray[Any, Any]):
    """The part of torch's tensor that the client's `push_force` uses."""

    is_cuda = False

    def numpy(self) -> Any:
        return np.asarray(self)

    def sum(self, dim: int) -> Any:  # type: ignore[override]
        return np.asarray(self).sum(axis=dim).view(Tensor)


@pytest.mark.parametrize("periods, share", [(2, 0.9), (2, 1.1), (1, 0.9)])
def test_isaac_lab_is_stable_up_to_the_stiffness_of_two_periods(
    isaac: Any, periods: int, share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its class sleeps between a reply and the next force, which adds a period to the loop delay."""
    period, heights, loop = 0.005, list[float](), asyncio.new_event_loop()
    monkeypatch.setattr(asyncio, "new_event_loop", lambda: loop)  # the client does not close its own
    arm = Arm(rate=1.0 / period, delay=0.0, **FREE)
    limit = largest_stable_stiffness(period=period, delay=periods * period, mass=arm.mass)
    twin = HaplyTwin(arm, lockstep=True, start=(0.0, 0.0, 1e-3))
    with served(twin) as server:
        uri = f"ws://127.0.0.1:{server.address[1]}"
        device = isaac.HaplyDevice(isaac.HaplyDeviceCfg(websocket_uri=uri, limit_force=1e9, sim_device="cpu"))
        last, deadline = 1e-3, time.monotonic() + PATIENCE
        while len(heights) < 250 and abs(last) < 0.1 and time.monotonic() < deadline:
            if (height := float(device.advance()[2])) != last:  # else still the same state
                speed, last = (height - last) / period, height
                force = [0.0, 0.0, -share * float(limit.stiffness) * height - float(limit.damping) * speed]
                device.push_force(np.array([force]).view(Tensor), np.array([0]))
                heights.append(abs(height))
            elif not heights:  # at rest until the first force
                device.push_force(np.array([[0.0, 0.0, -1e-3]]).view(Tensor), np.array([0]))
            time.sleep(2e-4)
        device.running = False
        device._websocket_thread.join(PATIENCE)
        loop.close()
    decayed = max(heights[-25:]) < max(heights[:25])
    assert decayed == (periods == 2 and share < 1.0)
