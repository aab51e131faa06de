"""Stability of a scene's wall alone: its root, its limit, and where both are read."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest

from maglev_mj import analyse, rebuild, record_run, run
from maglev_mj.analysis.pictures import whole_run
from maglev_mj.control import Law, Wall
from maglev_mj.errors import MaglevError
from maglev_mj.scenes import Scene, find_scene
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.interactive import Joystick
from maglev_mj.scenes.press import Press
from maglev_mj.scenes.results import Variants
from maglev_mj.scenes.stability_check import wall_loops
from maglev_mj.scenes.wall_scene import WallScene
from maglev_mj.session import Snapshot
from maglev_mj.session import margin as session_margin
from maglev_mj.session.margin import LiveVerdict, margin
from maglev_mj.theory import DeviceLaw, judge, stability
from maglev_mj.theory.boundary import boundary_of
from maglev_mj.theory.critical import critical_ratios
from maglev_mj.theory.loop import Loop, Loops
from maglev_mj.views.page import panel
from maglev_mj.views.readings import Charts, readings
from maglev_mj.views.window.screen import status_rows
from tests.all_of import SCENES
from tests.bridge.test_flight_changes import Here
from tests.studies.test_charts import details
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
    found = judge(wall_loops(scene))
    assert found.spectral_radius == pytest.approx(contact_root(scene), abs=1e-9)
    assert (found.ratio > 1.0) == (found.spectral_radius < 1.0)
    below, above = (scene.replace(stiffness=share * found.ratio * stiffness) for share in (0.999, 1.001))
    assert contact_root(below) < 1.0 < contact_root(above)


@pytest.mark.parametrize(
    ("scene", "says"),
    [
        (Drop(), "stable: 59 % of critical stiffness, spectral radius 0.8771"),
        (Drop(stiffness=15_000.0), "unstable: 148 % of critical stiffness, spectral radius 1.1049"),
        (Drop(stiffness=400.0), "stable: 4 % of critical stiffness, spectral radius 0.9745"),
        (
            Joystick(period=1e-4, delay=0.0, stiffness=5e5),
            "stable: 28 % of critical stiffness, spectral radius 0.9952",
        ),
    ],
)
def test_it_is_said_in_a_line(scene: Scene, says: str) -> None:
    assert judge(wall_loops(scene)).words == says


def test_what_remembers_too_long_is_not_known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("maglev_mj.theory.linearise._MOST_SAMPLES", 80)
    monkeypatch.setattr("tests.theory.test_linearise.WEIGHTS", WEIGHTS[:100])
    assert judge(wall_loops(Echoing())).words == "stability not computed"


def test_critical_ratios_are_searched_together() -> None:
    """Of laws that are not affine in their gain, such as one on the device."""
    device = DeviceLaw(0.0, 60.0)
    wall = Loop(stiffness=6000.0, damping=80.0, period=5e-3, delay=1.5e-3, inertia=0.7, device=device)
    limit = float(boundary_of(wall.array(), np.asarray(80.0)))
    stiffnesses = [limit / 1.7, limit / 0.3, math.nan, 1e-3]

    def at(indices: Sequence[int], ratios: Sequence[float]) -> list[Loops]:
        gains = [ratio * stiffnesses[index] for index, ratio in zip(indices, ratios, strict=True)]
        return [Loops((replace(wall, stiffness=gain, reason="unknown" * math.isnan(gain)),)) for gain in gains]

    found = critical_ratios(at, at(range(4), [1.0] * 4))
    assert found[:3] == pytest.approx([1.7, 0.3, math.nan], rel=1e-4, nan_ok=True)
    assert [one.beyond for one in found] == [False, False, False, True] and found[3] == pytest.approx(10.7, rel=1e-2)


def test_without_a_stiff_wall_there_is_none() -> None:
    assert not any(map(wall_loops, (Joystick(wall=False), Drop(stiffness=0.0))))


def test_it_is_that_of_the_hand_delay_and_flotor_in_question() -> None:
    free, held = (judge(wall_loops(Press(stiffness=12_000.0), held=held)).words for held in (False, True))
    assert free.endswith("spectral radius 1.0442")
    assert held == "stable: 78 % of critical stiffness, spectral radius 0.9563"
    assert wall_loops(Drop(), delay=0.003).items == wall_loops(Drop(delay=0.003)).items
    assert wall_loops(Drop(), inertia=[1.4] * 3 + [1e-3] * 3).items == wall_loops(Drop(mass=1.4)).items


# what a person reads


class Unstated(Wall):
    """Wall that declares no gains."""

    def gains(self) -> Any: ...


class Undeclared(WallScene):
    """Drop on a wall that declares no gains."""

    def laws(self) -> list[Law]:
        return [Unstated(axes="z", lower=0.0, stiffness=self.stiffness, damping=self.damping)]


class Quick(NamedTuple):
    """Verdict of a linearisation that takes no time."""

    stiffness: float
    delay: float
    stable: bool = True


@pytest.fixture
def own(monkeypatch: pytest.MonkeyPatch) -> LiveVerdict:
    """Give viewers a stability map of their own, with answers of this process instead of another."""
    monkeypatch.setattr("maglev_mj.session.margin.SideAnswers", Here)
    monkeypatch.setattr("maglev_mj.views.readings.STABILITY", own := LiveVerdict())
    return own


def shown(scene: Scene, **more: Any) -> Snapshot:
    return Snapshot(scene=scene, faces=scene.controller().faces, **more)


def verdict(snapshot: Snapshot) -> str:
    """Return the verdict, which all elements of window and page must show alike."""
    row = next(row for row in readings(snapshot) if row.name == "margin")
    assert [(row.value, row.colour)] == list(Charts(9).of(snapshot, 0)[2].title)
    assert f">{row.value}<" in panel._verdict(snapshot) and dict(status_rows(snapshot))["margin"] == row.value
    return row.value


@pytest.mark.parametrize("name", SCENES)
def test_the_verdict_is_one_number_without_waiting(name: str, own: LiveVerdict) -> None:
    scene: Any = find_scene(name)()
    scenes = [scene, *(scene.replace(stiffness=2.5 * scene.stiffness) for _ in range(hasattr(scene, "stiffness")))]
    for changed in scenes:
        assert verdict(shown(changed)) == margin(changed).words and own._answers is None
    assert verdict(shown(Drop(stiffness=15_000.0))) == "unstable on z: 148 % of critical stiffness"


def test_in_flight_it_is_of_the_measured_delay_and_the_devices_mass(own: LiveVerdict) -> None:
    flying: dict[str, Any] = {"state": "flying", "inertia": [0.75] * 3 + [1e-3] * 3}
    texts = [verdict(shown(Joystick(), delay=delay, **flying)) for delay in (0.0021, 0.00212, 0.0031)]
    want = [margin(Joystick(), delay, flying["inertia"]).words for delay in (0.0021, 0.0031)]
    assert texts == [want[0], *want] and want[0] != want[1]
    rows = {row.name: row.value for row in readings(shown(Joystick(), delay=0.0031, **flying))}
    assert rows["rate"] == "200 Hz, delay 3.1 ms"


def test_without_declared_gains_the_last_verdict_is_of_the_same_scene(
    own: LiveVerdict, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(session_margin, "stability", lambda scene, *, inertia, delay: Quick(scene.stiffness, delay))
    flying: dict[str, Any] = {"state": "flying"}
    scenes = Undeclared(), Undeclared(stiffness=15_000.0)
    asked = [shown(scenes[0], delay=0.0015, **flying), shown(scenes[0], delay=0.0031, **flying), shown(scenes[1])]
    texts = [[own.of(snapshot).words for _ in range(2)] for snapshot in asked]
    first, late, last = (str(Quick(*one)) for one in ((6000.0, 0.0015), (6000.0, 0.0031), (15_000.0, 0.0015)))
    assert texts == [["computing stability", first], [first, late], ["computing stability", last]]
    assert own.of(shown(scenes[0]), wait=True).words == first


@pytest.mark.machine
def test_a_viewer_outlives_the_process() -> None:
    own = LiveVerdict()
    for scene in (Undeclared(), Undeclared(stiffness=2000.0)):
        while (found := own.of(shown(scene)).words) == "computing stability":
            time.sleep(0.005)
        assert found == str(stability(scene))
        own._answers._process.kill()
        own._answers._process.join()


ENDED = MaglevError("stability not computed: its process has ended")


@pytest.mark.parametrize(
    ("answers", "words"),
    [
        ([None] * 500, str(Quick(6000.0, 0.0015))),
        ([ENDED], "stability not computed: its process has ended"),
        ([TypeError("no pickle")], "stability not computed: no pickle"),
    ],
    ids=["slow", "killed", "raises"],
)
def test_each_question_of_a_viewer_is_answered_in_the_end(
    answers: list[Any], words: str, own: LiveVerdict, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Faulty(Here):
        """Process with the next of the answers at each poll, then the right one."""

        def answer(self) -> Any:
            fault = answers.pop() if answers else self._found[0]
            if isinstance(fault, Exception):
                raise fault
            return fault

    monkeypatch.setattr("maglev_mj.session.margin.SideAnswers", Faulty)
    monkeypatch.setattr(session_margin, "stability", lambda scene, *, inertia, delay: Quick(scene.stiffness, delay))
    texts = [own.of(shown(Undeclared())).words for _ in range(len(answers) + 1)]
    assert set(texts[:-1]) <= {"computing stability", words} and texts[-1] == words


def test_charts_of_runs_and_recordings_say_it() -> None:
    figure = run(Press(stiffness=12_000.0, hits=1), plant="exact").plot()
    assert "wall stable: 78 % of critical stiffness, spectral radius 0.9563" in details(figure)
    runs = {f"{gain:g} N/m": run(Press(stiffness=gain, hits=1), plant="exact") for gain in (3000.0, 6000.0)}
    assert "wall stable" not in details(Variants(runs).plot())  # they differ
    segment = record_run(Press(hits=1), plant="exact").segments[0]
    report = analyse(segment, rebuild)
    said = "press along z, 200 Hz, delay 1.5 ms, wall stable: 39 % of critical stiffness, spectral radius 0.8525"
    assert details(whole_run(report, 2)).startswith(said)
    for other in ({"kind": "device"}, {"scene": "unknown"}):
        assert analyse(replace(segment, setup={**segment.setup, **other})).wall is None
    bare = {name: value for name, value in segment.setup.items() if name != "scene"}  # of a loop of one's own
    assert analyse(replace(segment, setup=bare)).wall is None
    assert "wall" not in details(analyse(replace(segment, setup={**segment.setup, "scene": "unknown"})).plot())
