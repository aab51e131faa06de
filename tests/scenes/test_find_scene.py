"""Scenes by name, file or package, also in other processes."""

from __future__ import annotations

import hashlib
import json
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from maglev_mj.errors import ParameterError
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.find import find_scene, line_of, reference_of, scene_from_reference, source_of
from maglev_mj.scenes.names import BUILT_IN, scene_names
from maglev_mj.scenes.run import run
from maglev_mj.scenes.scene import Scene
from maglev_mj.scenes.stick_slip import Pull

PUSH = """
from maglev_mj import Hold
from maglev_mj.scenes.scene import Scene, Start
from maglev_mj.parameters import param


class Push(Scene):
    '''Draw the flotor back to its centre.'''

    figures = ("peak_speed", "final_position")
    away: float = param("where it starts", "m", default=1e-3, at_most=4e-3)
    twice: float = param("twice that", "m", default=None, derive=lambda scene: 2.0 * scene.away)
    duration: float = param("simulated time", "s", default=0.05, above=0.0)

    def start(self):
        return Start(pose=(0.0, 0.0, self.away, 0.0, 0.0, 0.0), gravity=0.0)

    def laws(self):
        return [Hold(stiffness=100.0, damping=5.0)]
"""


@pytest.fixture
def push(tmp_path: Path) -> Path:
    """Return a file with one scene."""
    path = tmp_path / "my_push.py"
    path.write_text(PUSH)
    return path


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., None]]:
    """Yield a function that installs a package with scenes."""

    def install(source: str, **entries: str) -> None:
        folder = tmp_path / "site"
        info = folder / "other_package-1.0.dist-info"
        info.mkdir(parents=True)
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: other-package\nVersion: 1.0\n")
        lines = [f"{name.replace('_', '-')} = {place}\n" for name, place in entries.items()]
        (info / "entry_points.txt").write_text("[maglev_mj.scenes]\n" + "".join(lines))
        (folder / "other_scenes.py").write_text(source)
        monkeypatch.syspath_prepend(str(folder))

    yield install
    sys.modules.pop("other_scenes", None)


def test_a_scene_is_found_by_the_name_that_it_has() -> None:
    for name in BUILT_IN:
        cls = find_scene(name)
        assert (cls.name, reference_of(cls), source_of(cls)) == (name, name, None)
        assert name in scene_names()


@pytest.mark.parametrize(("text", "meant"), [("", ""), ("maglev_mj.scenes.drop:Drop", ""), ("joistick", "joystick")])
def test_what_is_no_scene_is_refused_with_those_that_there_are(text: str, meant: str) -> None:
    with pytest.raises(ParameterError) as refused:
        find_scene(text)
    near = f"; did you mean {meant}?" if meant else ""
    said = f"scene must be one of {', '.join(scene_names())}, or a file such as my_scene.py (got {text!r}){near}"
    assert str(refused.value) == said


def test_a_scene_is_found_in_a_file(push: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, modules = list(sys.path), set(sys.modules)
    cls = find_scene(str(push))
    assert issubclass(cls, Scene) and (cls.__name__, cls.name) == ("Push", "push")
    assert {*sys.path} - {*path} <= {str(push.parent)} and len(set(sys.modules) - modules) == 1
    assert find_scene(f"{push}:Push") is cls is find_scene(str(push))
    monkeypatch.chdir(push.parent)
    assert find_scene("my_push.py") is cls
    assert reference_of(cls) == f"{push}:Push"
    assert source_of(cls) == hashlib.sha256(push.read_bytes()).hexdigest()[:16]
    push.write_text(PUSH.replace("default=1e-3", "default=3e-3"))  # read anew
    assert (cls().away, find_scene(str(push))().away) == (1e-3, 3e-3)  # type: ignore[attr-defined]


TWO = PUSH + "\n\nclass Pull(Push):\n    pass\n"


def test_of_several_scenes_in_a_file_one_is_named(push: Path) -> None:
    push.write_text(TWO)
    with pytest.raises(ParameterError) as refused:
        find_scene(str(push))
    said = "my_push.py defines several (Push, Pull); choose one as my_push.py:CLASS"
    assert str(refused.value) == said
    assert [find_scene(f"{push}:{name}").name for name in ("Push", "Pull")] == ["push", "pull"]
    with pytest.raises(ParameterError, match=r"scene of my_push\.py must be one of Push, Pull \(got 'Shove'\)"):
        find_scene(f"{push}:Shove")


def test_scenes_that_a_file_imports_are_not_its_own(push: Path) -> None:
    push.write_text("from maglev_mj.scenes.drop import Drop\n\nclass Mine(Drop):\n    pass\n")
    assert find_scene(str(push)).__name__ == "Mine"
    push.write_text("from maglev_mj.scenes.drop import Drop\n")
    with pytest.raises(ParameterError, match=r"my_push\.py defines no Scene"):
        find_scene(str(push))
    with pytest.raises(ParameterError, match=r"scene of my_push\.py must be one of none \(got 'Drop'\)"):
        find_scene(f"{push}:Drop")


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("def (\n", "SyntaxError: invalid syntax (my_push.py, line 1)"),
        ("raise ValueError('two\\nlines')\n", "ValueError: two lines"),
        (PUSH.replace("away: float", "away: list"), "TypeError: Push.away must be float, int, bool or str, or have"),
        (PUSH.replace('"peak_speed"', '"pek_speed"'), "TypeError: figure must be one of penetration, rebound"),
    ],
    ids=lambda value: value[:12] if isinstance(value, str) else None,
)
def test_an_error_in_a_file_is_one_line_and_leaves_nothing(source: str, words: str, push: Path) -> None:
    push.write_text(source)
    path, modules = list(sys.path), set(sys.modules)
    for _ in range(2):
        with pytest.raises(ParameterError) as refused:
            find_scene(str(push))
        said = str(refused.value)
        assert said.startswith(f"file my_push.py cannot be read: {words}") and "\n" not in said
    assert sys.path == path and set(sys.modules) == modules
    push.write_text(PUSH)
    assert find_scene(str(push)).name == "push"


def test_an_installed_package_adds_scenes(installed: Callable[..., None]) -> None:
    installed(PUSH, push_back="other_scenes:Push")
    assert scene_names() == [*BUILT_IN, "push-back"]
    assert "other_scenes" not in sys.modules  # loaded when asked for
    cls = find_scene("push-back")
    assert cls.__module__ == "other_scenes" and reference_of(cls) == "other_scenes:Push" and source_of(cls) is None
    assert scene_from_reference(reference_of(cls), {"away": 2e-3}) == cls(away=2e-3)  # type: ignore[call-arg]
    with pytest.raises(ParameterError, match=r"scene must be one of joystick, drop, .*, push-back, or a file"):
        find_scene("push")


def test_a_broken_package_breaks_its_own_scenes_alone(installed: Callable[..., None]) -> None:
    installed(
        PUSH,
        missing="nowhere_at_all:Push",
        absent="other_scenes:Shove",
        number="other_scenes:PUSH",
        drop="nowhere:Drop",
    )
    (Path(sys.path[0]) / "other_scenes.py").write_text(PUSH + "\nPUSH = 3\n")
    for name, words in (
        ("missing", "of nowhere_at_all:Push cannot be loaded: ModuleNotFoundError: No module named 'nowhere_at_all'"),
        ("absent", "of other_scenes:Shove cannot be loaded: AttributeError: module 'other_scenes' has no attribute"),
        ("number", "of other_scenes:PUSH must be a subclass of Scene (got 3)"),
    ):
        with pytest.raises(ParameterError) as refused:
            find_scene(name)
        assert str(refused.value).startswith(f"scene {name} {words}") and "\n" not in str(refused.value)
    assert find_scene("drop") is Drop  # nobody else's
    assert scene_names() == [*BUILT_IN, "absent", "missing", "number"]


ELSEWHERE = """
import json, pickle, sys
from maglev_mj.scenes.run import run
for scene, changes in pickle.load(sys.stdin.buffer):
    figures = {name: float(value) for name, value in run(scene, plant="exact").figures.items()}
    changed = scene.replace(**changes).as_json()
    print(json.dumps([type(scene).__name__, scene.name, scene.as_json(), changed, figures]))
"""


def test_scenes_are_the_same_in_another_process(push: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # One of them was given by a path of this process's folder, which has several scenes.
    push.write_text(TWO)
    monkeypatch.chdir(push.parent)
    scenes: list[tuple[Scene, dict[str, Any]]] = [
        (Drop(height=2e-3, force_limit=60.0), {"height": 1e-3}),
        (Pull(axis="ry", v_min=0.2), {"axis": "x"}),
        (find_scene("my_push.py:Pull")(away=2e-3), {"away": 3e-3}),  # type: ignore[call-arg]
    ]
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    command = [sys.executable, "-P", "-c", ELSEWHERE]
    done = subprocess.run(command, input=pickle.dumps(scenes), capture_output=True, cwd=folder, timeout=60)
    assert done.returncode == 0, done.stderr.decode()
    for (scene, changes), line in zip(scenes, done.stdout.splitlines(), strict=True):
        cls, name, values, changed, figures = json.loads(line)
        assert (cls, name, values) == (type(scene).__name__, scene.name, scene.as_json())
        assert changed == scene.replace(**changes).as_json()  # what was derived is derived anew there too
        assert figures == {name: float(value) for name, value in run(scene, plant="exact").figures.items()}


def test_an_error_of_a_users_own_file_has_a_line(push: Path) -> None:
    push.write_text(PUSH.replace("return [Hold(", "return [1 / 0, Hold("))
    with pytest.raises(ZeroDivisionError) as caught:
        find_scene(str(push))().controller()
    line = 1 + push.read_text().split("\n").index("        return [1 / 0, Hold(stiffness=100.0, damping=5.0)]")
    assert line_of(caught.value) == f"my_push.py, line {line}"
    with pytest.raises(ZeroDivisionError) as others:
        1 / 0  # noqa: B018
    assert line_of(others.value) is None
