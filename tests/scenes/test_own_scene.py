"""User's own scene and law in every command."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj import Bias, Controller
from maglev_mj.bridge import RemotePlant, Twin, TwinParameters
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.cli import bridge, main
from maglev_mj.device import Device
from maglev_mj.recording import Recording
from maglev_mj.versions import hash_of
from tests.bridge.conftest import InProcess
from tests.published import WEIGHT

EXAMPLE = Path(__file__).parents[2] / "scripts" / "examples" / "detents.py"

UNSTABLE = ["--stiffness", "9870"]

Say = Callable[..., tuple[int, str, str]]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with only the scene's file."""
    place = tmp_path / "mine"
    place.mkdir()
    (place / "detents.py").write_bytes(EXAMPLE.read_bytes())
    monkeypatch.chdir(place)
    return place


@pytest.fixture
def say(folder: Path, capsys: pytest.CaptureFixture[str]) -> Say:
    """Return a function that runs a command."""

    def typed(*command: object) -> tuple[int, str, str]:
        capsys.readouterr()
        try:
            status = main([str(word) for word in command])
        except SystemExit as stopped:
            status = int(stopped.code or 0)
        said = capsys.readouterr()
        return status, said.out, said.err

    return typed


def test_its_stability_is_told_and_warned_of(folder: Path, say: Say) -> None:
    status, said, wrong = say("stability", "detents.py", *UNSTABLE, "--json", "-")
    found = json.loads(said)
    assert (status, wrong, found["stable"]) == (0, "", False)
    assert found["spectral_radius"] == pytest.approx(1.0308, abs=1e-4)
    status, said, wrong = say("run", "detents.py", *UNSTABLE, "--duration", "0.02", "--plant", "exact", "--json", "-")
    assert status == 0 and json.loads(said)["parameters"]["duration"] == 0.02
    assert not wrong and "detents is unstable" in json.loads(said)["warnings"][0]


def test_a_run_is_recorded_checked_and_analysed(folder: Path, say: Say) -> None:
    name = "run.maglev"
    assert say(*f"run detents.py --plant exact --duration 0.1 --record {name}".split())[0] == 0
    status, said, wrong = say("replay", name, "--check")
    assert (status, wrong.count("\n")) == (2, 1) and "was not executed" in wrong and "--scene detents.py" in wrong
    assert say("analyse", name)[0] == 0
    status, said, wrong = say("replay", name, "--check", "--scene", "detents.py")
    assert (status, wrong) == (0, "") and "equal: " in said
    status, said, wrong = say("analyse", name, "--scene", "detents.py")
    assert (status, wrong) == (0, "") and "simulation" in said
    file = Path("detents.py")
    text = file.read_text()
    file.unlink()
    for command in (["replay", name, "--check"], ["analyse", name]):
        status, said, wrong = say(*command, "--scene", "attached")
        assert (status, wrong) == (0, "") and ("equal: " in said or "simulation" in said)
    file.write_text(text + "# later\n")
    os.utime(file, ns=(1, 1))
    assert "differs from the recorded file" in say("replay", name, "--check", "--scene", "detents.py")[2]
    file.write_text(text)


@pytest.fixture
def served(monkeypatch: pytest.MonkeyPatch) -> str:
    """Return the address of a twin in lockstep, in virtual time, whose flight is checked with a free handle."""
    monkeypatch.setattr(bridge, "_opened", lambda *parameters: RemotePlant(twin_link(), folder=parameters[-1]))
    monkeypatch.setattr("maglev_mj.bridge.preflight.HANDS", ["none"])
    monkeypatch.setattr("maglev_mj.bridge.preflight.SideAnswers", InProcess)
    return "udp://127.0.0.1:1"


def twin_link() -> VirtualLink:
    return VirtualLink(Twin(TwinParameters(lockstep=True), draw=lambda: 7))


def fly(say: Say, address: str) -> None:
    flight = ["bridge", address, "--scene", "detents.py", "--seconds", "0.3", "--record", "fly.maglev"]
    status, said, wrong = say(*flight, "--stiffness", "3000")
    assert status == 0, wrong
    assert "detents at 200 Hz" in said


def test_it_is_flown_on_a_twin_recorded_and_checked(served: str, folder: Path, say: Say) -> None:
    fly(say, served)
    recording = Recording.load(folder / "fly.maglev")
    (segment,) = recording.segments
    source = f"source/{hash_of((folder / 'detents.py').read_text())}/detents.py"
    assert {"device.toml", "model/maglev.xml", source} <= recording.attachments.keys()
    assert Device.parse(recording.attachments["device.toml"].decode()) == Device.load("ubc")
    assert segment.setup["kind"] == "device" and segment.setup["parameters"]["stiffness"] == 3000.0
    status, said, wrong = say("replay", "fly.maglev", "--check", "--scene", "detents.py")
    assert (status, wrong) == (0, "") and "equal: " in said


def hold(position: Any, velocity: Any) -> Any:
    """Return a pull towards the middle, a law that is a plain function."""
    return [-s * (900.0 * x + 30.0 * v) for s, x, v in zip([0.7] * 3 + [9e-4] * 3, position, velocity, strict=True)]


def pull(position: Any, velocity: Any) -> Any:
    """Return a further pull along x, and only there."""
    return [-3000.0 * position[0] * (1.0 + 1e4 * position[0] ** 2) - 40.0 * velocity[0], 0.0, 0.0, 0.0, 0.0, 0.0]


def test_a_plain_function_is_a_law_that_a_twin_is_flown_with() -> None:
    controller, poses = Controller([Bias(WEIGHT), pull, hold], period=0.005), list[Any]()
    with RemotePlant(twin_link()) as plant:
        plant.takeoff()
        for _ in range(40):
            sample = plant.read()
            poses.append(sample.pose)
            plant.write(controller.step(sample))
        plant.land()
    assert np.abs(poses[-1]).max() < 1e-3
