"""User's own scene and law in every command."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj import AXES, Controller, drive
from maglev_mj.bridge import Calibration, RemotePlant, Twin, TwinParameters
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.cli import bridge, main
from maglev_mj.control import AxisLaw, Bias, gain
from maglev_mj.recording import Recording
from maglev_mj.scenes import Scene, Start
from maglev_mj.scenes.rooms import WEIGHT
from maglev_mj.session import Pacer, Session
from maglev_mj.theory import stability
from maglev_mj.versions import hash_of
from maglev_mj.views.readings import STABILITY
from maglev_mj.views.window.screen import Plots
from tests.studies.test_dask_workers import cluster

__all__ = ["cluster"]

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
    """Return a function that runs a command.

    It returns status, output and errors.
    """

    def typed(*command: object) -> tuple[int, str, str]:
        capsys.readouterr()
        try:
            status = main([str(word) for word in command])
        except SystemExit as stopped:
            status = int(stopped.code or 0)
        said = capsys.readouterr()
        return status, said.out, said.err

    return typed


def test_it_runs_with_its_options_at_a_hundred_phases(folder: Path, say: Say) -> None:
    status, said, wrong = say(
        *"run detents.py --stiffness 3000 --away 1e-4 --phases 100 --plant exact --json run.json".split()
    )
    assert (status, wrong) == (0, "") and "over 100 phases" in said and "stiffness 3000 N/m" in said
    data = json.loads((folder / "run.json").read_text())
    assert (data["parameters"]["stiffness"], data["parameters"]["away"]) == (3000.0, 1e-4)
    assert len(data["sweep"]["phases"]) == 100
    assert data["position"][0] == 1e-4 and abs(data["position"][-1]) < 1e-6


@pytest.mark.parametrize(
    ("options", "stable", "modulus"),
    [pytest.param([], True, 0.9147, marks=pytest.mark.study), (UNSTABLE, False, 1.0308)],
)
def test_its_stability_is_told_and_warned_of(
    options: list[str], stable: bool, modulus: float, folder: Path, say: Say
) -> None:
    status, said, wrong = say("stability", "detents.py", *options, "--json", "-")
    found = json.loads(said)
    assert (status, wrong, found["stable"]) == (0, "", stable)
    assert found["modulus"] == pytest.approx(modulus, abs=1e-4)
    status, said, wrong = say("run", "detents.py", *options, "--duration", "0.02", "--json", "-")
    assert status == 0 and json.loads(said)["parameters"]["duration"] == 0.02
    assert wrong.count("\n") == (0 if stable else 1) and ("is unstable" in wrong) is not stable


def test_its_model_levels_are_compared(folder: Path, say: Say, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("_LONG", 1e-9), ("_POINTS", 8), ("_SEEDS", 2)):  # computing times are taken once
        monkeypatch.setattr(f"maglev_mj.studies.levels.{name}", value)
    command = "fidelity detents.py --phases 1 --duration 0.02 --around 0 --json all.json".split()
    status, said, wrong = say(*command)
    assert status == 0, wrong
    assert "detents" in said and json.loads((folder / "all.json").read_text())


def assert_checked_with_the_scene_alone(say: Say, name: str) -> None:
    status, said, wrong = say("replay", name, "--check")
    assert (status, wrong.count("\n")) == (2, 1) and "must be executed" in wrong and "--scene detents.py" in wrong
    assert say("analyse", name)[0] == 0
    status, said, wrong = say("replay", name, "--check", "--scene", "detents.py")
    assert (status, wrong) == (0, "") and "the same: " in said
    status, said, wrong = say("analyse", name, "--scene", "detents.py")
    assert (status, wrong) == (0, "") and "simulation" in said
    file = Path("detents.py")
    text = file.read_text()
    file.unlink()
    for command in (["replay", name, "--check"], ["analyse", name]):
        status, said, wrong = say(*command, "--scene", "attached")
        assert (status, wrong) == (0, "") and ("the same: " in said or "simulation" in said)
    file.write_text(text + "# later\n")
    os.utime(file, ns=(1, 1))
    assert "has changed since, or is another" in say("replay", name, "--check", "--scene", "detents.py")[2]
    file.write_text(text)


def test_a_run_is_recorded_checked_and_analysed(folder: Path, say: Say) -> None:
    assert say(*"run detents.py --plant exact --duration 0.1 --record run.maglev".split())[0] == 0
    assert_checked_with_the_scene_alone(say, "run.maglev")


@pytest.fixture
def served(monkeypatch: pytest.MonkeyPatch) -> str:
    """Return the address of a twin in lockstep, in virtual time, whose flight is checked with a free handle."""
    monkeypatch.setattr(bridge, "_opened", lambda *parameters: RemotePlant(twin_link(), folder=parameters[-1]))
    monkeypatch.setattr("maglev_mj.bridge.line.HANDS", ["none"])
    return "udp://127.0.0.1:1"


def twin_link() -> VirtualLink:
    return VirtualLink(Twin(TwinParameters(lockstep=True), draw=lambda: 7))


def fly(say: Say, address: str) -> None:
    flight = ["bridge", address, "--scene", "detents.py", "--seconds", "0.3", "--record", "fly.maglev"]
    status, said, wrong = say(*flight, "--stiffness", "3000", "--anyway")
    assert status == 0, wrong
    assert "detents at 200 Hz" in said


def test_it_is_flown_on_a_twin_recorded_and_checked(served: str, folder: Path, say: Say) -> None:
    fly(say, served)
    recording = Recording.load(folder / "fly.maglev")
    (stretch,) = recording.stretches
    source = f"source/{hash_of((folder / 'detents.py').read_text())}/detents.py"
    assert {"calibration.json", "model/maglev.xml", source} <= recording.attachments.keys()
    assert json.loads(recording.attachments["calibration.json"]) == Calibration.nominal().as_json()
    assert stretch.setup["kind"] == "device" and stretch.setup["parameters"]["stiffness"] == 3000.0
    status, said, wrong = say("replay", "fly.maglev", "--check", "--scene", "detents.py")
    assert (status, wrong) == (0, "") and "the same: " in said


def test_it_is_not_flown_if_it_is_unstable(served: str, folder: Path, say: Say) -> None:
    status, _, wrong = say("bridge", served, "--scene", "detents.py", "--seconds", "0.05", *UNSTABLE)
    assert status == 1 and "no takeoff: detents bears 0.96 ms" in wrong and "of delay and is UNSTABLE beyond" in wrong


TEXT = EXAMPLE.read_text()
LINE = TEXT[: TEXT.index("return [detent")].count("\n") + 1
FAULTS: dict[str, tuple[str, int, str]] = {
    "not Python": ("def (", 2, "detents.py cannot be read: SyntaxError"),
    "an error in a method": (
        TEXT.replace("return [detent", "return 1 / 0, [detent"),
        2,
        f"detents.py, line {LINE}: ZeroDiv",
    ),
    "an error in the law": (TEXT.replace("return -gains", "return 1 / 0 - gains"), 2, "law Detent fails: ZeroDiv"),
    "a wrong law": (TEXT.replace("def force(self, x, v, gains, state)", "def force(self, x, v)"), 2, "force must take"),
    "no number": (TEXT.replace("default=4000.0", "default=-1.0"), 2, "stiffness must be a finite number at least 0"),
    "unstable": (TEXT.replace("default=4000.0", "default=9870.0"), 0, "warning: detents is unstable: the laws on x"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_what_is_wrong_in_it_is_one_line(fault: str, folder: Path, say: Say) -> None:
    text, expected, words = FAULTS[fault]
    (folder / "detents.py").write_text(text)
    status, _, wrong = say(*"run detents.py --plant exact".split())
    assert status == expected and wrong.count("\n") == 1 and words in wrong, wrong


# a law of one's own, in ten lines


class Magnet(AxisLaw):
    """A pull that grows with the cube of the distance."""

    stiffness: float = gain("stiffness", "N/m")
    damping: float = gain("damping", "N s/m")

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        return -gains.stiffness * x * (1.0 + 1e4 * x * x) - gains.damping * v


def pull(position: Any, velocity: Any) -> Any:
    """Pull along x, and only there."""
    return [-3000.0 * position[0] * (1.0 + 1e4 * position[0] ** 2) - 40.0 * velocity[0], 0.0, 0.0, 0.0, 0.0, 0.0]


def hold(position: Any, velocity: Any) -> Any:
    """Pull on all axes."""
    return [-s * (900.0 * x + 30.0 * v) for s, x, v in zip([0.7] * 3 + [9e-4] * 3, position, velocity, strict=True)]


LAWS: dict[str, Callable[[], list[Any]]] = {
    "an AxisLaw": lambda: [Magnet(axes=("x", "y", "z"), stiffness=3000.0, damping=40.0), hold],
    "a function": lambda: [pull, hold],
}
each_law = pytest.mark.parametrize("laws", LAWS.values(), ids=LAWS)
START = np.array([1e-3, -5e-4, 2e-4, 0.01, 0.0, 0.0])


def controller(laws: Callable[[], list[Any]]) -> Controller:
    return Controller([Bias(WEIGHT), *laws()], period=0.005)


def poses(plant: Any, laws: Callable[[], list[Any]], ticks: int = 40) -> Any:
    seen: list[Any] = []
    with plant:
        drive(plant, controller(laws), ticks, observe=lambda sample, _: seen.append(sample.pose))
    return np.array(seen)


@each_law
def test_a_twin_takes_it(laws: Any) -> None:
    with RemotePlant(twin_link()) as plant:
        plant.takeoff()
        made = controller(laws)
        seen = []
        for _ in range(40):
            sample = plant.read()
            seen.append(sample.pose)
            plant.write(made.step(sample))
        plant.land()
    assert np.abs(seen[-1]).max() < 1e-3


class Mine(Scene):
    """A scene of any laws."""

    shown_axis = "x"

    def laws(self) -> list[Any]:
        return [Bias(WEIGHT), *LAWS["an AxisLaw"]()]

    def start(self) -> Start:
        return Start(pose=START.tolist(), wrench=WEIGHT)


class Plain(Mine):
    """A scene of functions."""

    def laws(self) -> list[Any]:
        return [Bias(WEIGHT), *LAWS["a function"]()]


@pytest.mark.parametrize("cls", [pytest.param(Mine, marks=pytest.mark.study), Plain])
def test_the_viewer_takes_it_and_says_whether_it_is_stable(cls: type[Mine]) -> None:
    with closing(Session(cls(), pacer=Pacer(budget=60.0, patience=3600.0))) as session:
        for _ in range(30):
            session.tick(1.0 / 60.0)
        shot, plots = session.snapshot(), Plots()
    assert shot.state == "running" and np.abs(shot.pose).max() < np.abs(START).max()
    verdict = stability(cls())
    STABILITY.wait(shot)
    title = plots.update(shot)[2].title
    text = title if isinstance(title, str) else bytes(title).split(b"\0")[0].decode()
    assert verdict.stable and text == str(verdict) and set(verdict.axes) <= set(AXES)
