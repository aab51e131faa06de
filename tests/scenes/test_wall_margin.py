"""Stability of a scene's wall alone: its root, its limit, and where both are read."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import pytest

from maglev_mj import analyse, rebuild, record_run, run
from maglev_mj.analysis.pictures import _describe
from maglev_mj.colours import BAD
from maglev_mj.control import Law, Wall
from maglev_mj.errors import MaglevError
from maglev_mj.process import SideAnswers
from maglev_mj.scenes import Scene, find_scene
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.interactive import Joystick
from maglev_mj.scenes.press import Press
from maglev_mj.scenes.results import Variants
from maglev_mj.scenes.stability_check import wall_margin
from maglev_mj.scenes.wall_scene import WallScene
from maglev_mj.session import Snapshot
from maglev_mj.theory import stability
from maglev_mj.views.readings import Reading, StabilityMap, margin, readings
from tests.bridge.test_flight_changes import Here
from tests.sweeps import sweep
from tests.theory.test_linearise import WEIGHTS, Echo


class Echoing(WallScene):
    """Wall beside a law that remembers too long."""

    def laws(self) -> list[Law]:
        return [Wall(axes="z", lower=0.0, stiffness=self.stiffness, damping=self.damping), Echo()]


def contact_root(scene: Scene) -> float:
    """Return the spectral radius of all states in contact on axes with a wall."""
    axes = {axis for axis, _, _ in scene.controller().faces}
    states = [one for one in stability(scene).states if "contact" in one.acting]
    return max(one.spectral_radius for one in states if axes & set(map("x y z rx ry rz".split().index, one.axes)))


@pytest.mark.parametrize(
    ("name", "stiffness"), sweep(["drop", "press", "joystick", "box", "corner"], [3000.0, 15_000.0], every=2)
)
def test_the_margin_is_where_the_walls_own_root_passes_one(name: str, stiffness: float) -> None:
    scene = find_scene(name)().replace(stiffness=stiffness)
    found = wall_margin(scene)
    assert found is not None and found.spectral_radius == pytest.approx(contact_root(scene), abs=1e-9)
    assert (found.margin > 1.0) == (found.spectral_radius < 1.0)
    below, above = (scene.replace(stiffness=share * found.margin * stiffness) for share in (0.999, 1.001))
    assert contact_root(below) < 1.0 < contact_root(above)


@pytest.mark.parametrize(
    ("scene", "says"),
    [
        (Drop(), "spectral radius 0.877, 59 % of critical stiffness"),
        (Drop(stiffness=15_000.0), "unstable, spectral radius 1.105, 148 % of critical stiffness"),
        (Drop(stiffness=400.0), "spectral radius 0.975"),  # up to tenfold it is stable
        (
            Joystick(period=1e-4, delay=0.0, stiffness=5e5),
            "spectral radius 0.995",
        ),  # up to the largest stiffness that it takes
    ],
)
def test_it_is_said_in_a_line(scene: Scene, says: str) -> None:
    assert str(wall_margin(scene)) == says


def test_what_remembers_too_long_is_not_known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("maglev_mj.theory.linearise._LONGEST", 80)
    monkeypatch.setattr("tests.theory.test_linearise.WEIGHTS", WEIGHTS[:100])
    assert str(wall_margin(Echoing())) == "spectral radius not computed"


def test_without_a_stiff_wall_there_is_none() -> None:
    assert [wall_margin(one) for one in (Joystick(wall=False), Drop(stiffness=0.0))] == [None, None]


def test_it_is_that_of_the_hand_delay_and_flotor_in_question() -> None:
    assert str(wall_margin(Press(stiffness=12_000.0))).startswith("unstable, spectral radius 1.044")
    assert str(wall_margin(Press(stiffness=12_000.0), held=True)) == "spectral radius 0.956, 78 % of critical stiffness"
    assert wall_margin(Drop(), delay=0.003) == wall_margin(Drop(delay=0.003))
    assert wall_margin(Drop(), inertia=[1.4] * 3 + [1e-3] * 3) == wall_margin(Drop(mass=1.4))


# what a person reads


@pytest.fixture(params=[Here, pytest.param(SideAnswers, marks=pytest.mark.machine)])
def beside(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[StabilityMap]:
    """Give viewers answers of their own: of this process, or of one beside it, with time for it on a busy machine."""
    monkeypatch.setattr("maglev_mj.views.readings.SideAnswers", request.param)
    own = StabilityMap()
    monkeypatch.setattr("maglev_mj.views.readings.STABILITY", own)
    yield own
    if own._answers is not None:
        own._answers.close(0.0)


def shown(scene: Scene, **more: Any) -> Snapshot:
    return Snapshot(scene=scene, faces=scene.controller().faces, **more)


def wall_of(snapshot: Snapshot) -> Reading | None:
    return next((one for one in readings(snapshot) if one.name == "wall"), None)


def without_fraction(scene: Scene, **options: Any) -> str:
    """Return the margin of a wall in words, without the fraction, which the stability map states."""
    return str(wall_margin(scene, **options)).rpartition(", ")[0]


def settled(snapshot: Snapshot, known: Callable[[], bool]) -> Reading | None:
    """Return the reading once the process has answered."""
    while not known():
        wall_of(snapshot)
        time.sleep(0.005)
    return wall_of(snapshot)


def test_a_reading_is_computed_beside_the_viewer(beside: StabilityMap) -> None:
    for scene, colour in ((Drop(), None), (Drop(stiffness=15_000.0), BAD)):
        meanwhile = wall_of(shown(scene))
        assert meanwhile == Reading("wall", "...")
        found = settled(shown(scene), lambda scene=scene: beside.scene == scene)  # type: ignore[misc]
        assert found == Reading("wall", without_fraction(scene), colour)
    table = find_scene("table")()
    assert wall_of(shown(table)) is None and settled(shown(table), lambda: beside.scene == table) is None


def test_in_flight_it_is_of_the_measured_delay_and_the_devices_mass(beside: StabilityMap) -> None:
    flying: dict[str, Any] = {"state": "flying", "inertia": [0.75] * 3 + [1e-3] * 3}
    shots = [shown(Joystick(), delay=delay, **flying) for delay in (0.0021, 0.00212, 0.0031)]
    found = [settled(shots[0], lambda: beside.scene is not None), wall_of(shots[1])]
    assert beside._arguments[1] == 0.0021 and wall_of(shots[2]) != Reading("wall", "...")  # of the same scene
    found.append(settled(shots[2], lambda: not beside._left))
    want = [without_fraction(Joystick(), delay=delay, inertia=flying["inertia"]) for delay in (0.0021, 0.0031)]
    assert [one.value for one in found if one] == [want[0], *want]


@pytest.mark.parametrize("beside", [pytest.param(SideAnswers, marks=pytest.mark.machine)], indirect=True)
def test_a_viewer_outlives_the_process(beside: StabilityMap) -> None:
    settled(shown(Drop()), lambda: beside.scene is not None)
    assert beside._answers is not None
    beside._answers._process.kill()
    beside._answers._process.join()
    again = Drop(stiffness=2000.0)
    assert settled(shown(again), lambda: beside.scene == again) == Reading("wall", without_fraction(again))


@pytest.mark.parametrize(
    ("answers", "words"),
    [
        ([None] * 500, "stable: 59 % of critical stiffness"),
        (["killed", None, "killed"], "stable: 59 % of critical stiffness"),
        (["killed"] * 3, "stability not computed: its process has ended"),
        ([TypeError("no pickle")], "stability not computed: no pickle"),
    ],
    ids=["slow", "killed twice", "always killed", "raises"],
)
def test_each_question_of_a_viewer_is_answered_in_the_end(
    answers: list[Any], words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Faulty(Here):
        """Process with the next of the answers at each poll, then the right one."""

        def answer(self) -> Any:
            fault = answers.pop() if answers else margin(*self.question)
            if fault == "killed":
                self.ended = True
                fault = MaglevError("stability not computed: its process has ended")
            if isinstance(fault, Exception):
                raise fault
            return fault

        def ask(self, *question: Any) -> None:
            self.question = question

    monkeypatch.setattr("maglev_mj.views.readings.SideAnswers", Faulty)
    stability_map, polls = StabilityMap(), len(answers)
    texts = [stability_map.of(shown(Drop())).words for _ in range(polls + 1)]
    assert set(texts[:-1]) <= {"computing stability"} | {words} and texts[-1] == words


def test_charts_of_runs_and_recordings_say_it() -> None:
    figure = run(Press(stiffness=12_000.0, hits=1), plant="exact").plot()
    assert "wall 12000 N/m, 80 N s/m (spectral radius 0.956, 78 % of critical stiffness)\n" in figure.axes[0].get_title(
        "left"
    )
    runs = {f"{gain:g} N/m": run(Press(stiffness=gain, hits=1), plant="exact") for gain in (3000.0, 6000.0)}
    assert "wall of" not in Variants(runs).plot().axes[0].get_title("left")  # they differ
    segment = record_run(Press(hits=1), plant="exact").segments[0]
    report = analyse(segment, rebuild)
    assert _describe(report).startswith(
        "press, 200 Hz, delay 1.5 ms; wall: spectral radius 0.853, 39 % of critical stiffness\n"
    )
    for other in ({"kind": "device"}, {"scene": "unknown"}):
        assert analyse(replace(segment, setup={**segment.setup, **other})).wall is None
    bare = {name: value for name, value in segment.setup.items() if name != "scene"}  # of a loop of one's own
    assert analyse(replace(segment, setup=bare)).wall is None
    assert "wall" not in _describe(analyse(replace(segment, setup={**segment.setup, "scene": "unknown"})))
