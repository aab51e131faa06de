"""Self-contained recordings of a user's script, with each plant, law and velocity estimate."""

from __future__ import annotations

import base64
import json
import re
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping
from copy import deepcopy
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj.cli import main, program
from maglev_mj.control import Bias, Law
from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import drive
from maglev_mj.plants import ExactPlant, Timing
from maglev_mj.plants.hand import SpringHand
from maglev_mj.recording import InvalidRecordingError, MemoryFile, Recording, RecordingError, open_recording
from maglev_mj.recording.verify import verify
from maglev_mj.scenes.find import _module_of_text
from maglev_mj.session import Pacer, Session
from maglev_mj.session.replay import Replay, rebuild
from maglev_mj.versions import differences, hash_of, versions
from tests.all_of import DELAY, LAWS, PERIOD, PLANTS, START, TIMING, controller_of
from tests.golden.outputs import HERE
from tests.processes import run_here
from tests.recorded import Part, journal_of, numbers_in, parts_in, some_of

TICKS = 80


def record(path: Path, plants: list[str], names: Iterable[str] | None = None, ticks: int = TICKS) -> None:
    """Record as a user's script does, one segment per law."""
    file = open_recording(path, wait=True)
    for name in plants:
        for law in names or LAWS:
            plant, controller = PLANTS[name](), controller_of(law)
            drive(plant, controller, ticks=ticks, record=file.begin(plant, controller))
    file.close()


def unwrapped(text: str) -> str:
    """Return a text as one line."""
    return " ".join(text.split())


@pytest.fixture
def say(capsys: Any) -> Callable[..., tuple[int, str, str]]:
    """Return a function that runs a command and returns status and output."""

    def typed(*words: str) -> tuple[int, str, str]:
        status = main(list(words))
        said = capsys.readouterr()
        return status, said.out, said.err

    return typed


@pytest.mark.parametrize(
    ("plant", "names"),
    [
        ("exact", tuple(LAWS)),
        ("exact, with options", ("Wall",)),
        ("mujoco, with options", ("PassivityController",)),
    ],
)
def test_a_script_s_recording_is_checked_analysed_and_shown(
    plant: str, names: tuple[str, ...], tmp_path: Path, say: Any
) -> None:
    path = tmp_path / "run.maglev"
    ticks = 12
    record(path, [plant], names, ticks=ticks)
    status, said, wrong = say("replay", str(path), "--check")
    assert (status, wrong) == (0, ""), said
    count = ticks * len(names)
    assert f"{count} of {count} equal: tick, time, position, command, pulse," in said
    assert "not run again" not in said and "hand" in said
    assert say("analyse", str(path), "--json", str(tmp_path / "found.json"))[0] == 0
    found = json.loads((tmp_path / "found.json").read_text())["segments"]
    assert [one["comparison"]["same"] for one in found] == [True] * len(names)
    recording = Recording.load(path)
    replay, shown = Replay(recording), list[int]()
    for place, (law, segment) in enumerate(zip(names, recording.segments, strict=True)):
        shown += [replay.tick(PERIOD) for _ in range(ticks - (not place))]
        view = replay.snapshot()
        assert (view.pose == segment.position[-1]).all() and view.delay == DELAY
        assert (view.anchors is not None) == ("breakaway" in segment.setup["controller"]["laws"][0]), law
        assert len(view.faces) == len(controller_of(law).faces)
    assert set(shown) == {1}
    if "mujoco" in plant:
        assert b"<mujoco" in recording.attachments["model/maglev.xml"]


def at(value: Any, place: tuple[Any, ...]) -> Any:
    """Return the value at a position."""
    for key in place:
        value = value[key]
    return value


def other(name: Any, old: Any) -> Any:
    """Return another value of a setup, or the same."""
    if old is None or isinstance(old, bool):
        return old if old is None else not old
    return old + 1 if name in COUNTS else old * (1e5 if name in THRESHOLDS else 1.07)


def unseen(plant: str, names: list[str], part: str, every: int, ticks: int = TICKS) -> tuple[list[str], int]:
    """Return undetected changes of a setup's values, and the number tried.

    Of one number of each n-th field; of all numbers for n = 0.
    """
    file, missed, tried = MemoryFile(), [], 0
    for law in names:
        made, controller = PLANTS[plant](), controller_of(law)
        drive(made, controller, ticks=ticks, record=file.begin(made, controller))
    for law, segment in zip(names, file.recording.segments, strict=True):
        places = [
            place
            for place in numbers_in(segment.setup[part])
            if other(place[-1], at(segment.setup[part], place)) != at(segment.setup[part], place)
        ]
        for place in (
            some_of(places, lambda place: str(place[: -isinstance(place[-1], int) or None]), 0)[::every]
            if every
            else places
        ):
            new = other(place[-1], at(segment.setup[part], place))
            setup = deepcopy(dict(segment.setup))
            at(setup[part], place[:-1])[place[-1]] = new
            tried += 1
            try:
                same = verify(Recording([replace(segment, setup=setup)]), rebuild).same
            except InvalidRecordingError:
                continue
            missed += [f"{law} {' '.join(map(str, place))}"] * same
    return missed, tried


COUNTS, THRESHOLDS = ("samples", "longest", "seed"), ("pulse_gate", "v_min", "slow")
WITHOUT_EFFECT = re.compile(r"(escape \d|record|metered|hand_force hand (mass|damping))$")
"""Values without effect on any of these runs.

A guided hand has mass and damping by the plant's `hand`.
"""


@pytest.mark.parametrize(("every", "least"), [(3, 30), pytest.param(0, 100, marks=pytest.mark.study)])
def test_a_changed_gain_is_found(every: int, least: int) -> None:
    missed, tried = unseen("exact", list(LAWS), "controller", every)
    assert tried > least and [name for name in missed if not WITHOUT_EFFECT.search(name)] == []


@pytest.mark.parametrize(
    ("plant", "every", "least"),
    [
        ("exact", 0, 5),
        ("mujoco", 0, 5),
        ("mujoco, with options", 7, 2),
    ],
)
def test_a_changed_option_of_a_plant_is_found(plant: str, every: int, least: int) -> None:
    missed, tried = unseen(plant, ["Hold"], "plant", every, TICKS if every == 0 else 25)
    assert tried > least and [name for name in missed if not WITHOUT_EFFECT.search(name)] == []


# laws of a user's own

SCRIPT = """
import math
import sys
from pathlib import Path

from maglev_mj import AxisLaw, Controller, MuJoCoPlant, Timing, Wall, drive, gain
from maglev_mj.recording import open_recording

ratio = math.sqrt(SQUARE)
Path("law executed").write_text(__name__)


class Magnet(AxisLaw):
    stiffness: float = gain("stiffness", "N/m")

    def force(self, x, v, gains, state):
        return -ratio * gains.stiffness * x - 6.0 * v


def lift(position, velocity):
    return [0.0, 0.0, 6.8, 0.0, 0.0, 0.0]


if __name__ == "__main__":
    Path("executed").write_text(__name__)
    laws = [Magnet(axes=("x", "z"), stiffness=300.0), lift]
    file = open_recording(Path(sys.argv[1]), wait=True)
    for _ in range(2):
        plant = MuJoCoPlant(Timing(period=0.001, delay=0.0015), pose=[0.001, 0.0, 0.001, 0.0, 0.0, 0.0])
        controller = Controller(laws, period=0.001)
        drive(plant, controller, ticks=30, record=file.begin(plant, controller))
    file.close()
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return an empty working folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run_script(folder: Path, name: str) -> None:
    """Record by a script with a law of its own, which leaves a mark when executed."""
    text = SCRIPT.replace("SQUARE", "4.0")
    (folder / "script.py").write_text(text)
    (folder / name).write_bytes(run_of(text, name))


@cache
def run_of(text: str, name: str) -> bytes:
    """Return the recording of a script."""
    import tempfile

    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        (folder / "script.py").write_text(text)
        subprocess.run([sys.executable, "script.py", name], cwd=folder, check=True)
        assert {path.name for path in folder.glob("*executed")} == {"executed", "law executed"}
        return (folder / name).read_bytes()


def test_a_law_of_one_s_own_is_executed_only_by_leave(folder: Path, say: Any) -> None:
    name = "run.maglev"
    run_script(folder, name)
    script = folder / "script.py"
    text = script.read_text()
    status, _, wrong = say("replay", name, "--check")
    assert (status, wrong.count("\n")) == (2, 1) and f"'script.py:Magnet@{hash_of(text)}' was not executed" in wrong
    assert "--scene script.py, or with --scene attached" in wrong
    assert say("analyse", name)[0] == 0
    assert Replay(Recording.load(Path(name))).snapshot().anchors is None
    assert not list(folder.glob("*executed"))
    for given in ("script.py", "attached"):
        _module_of_text.cache_clear()
        if given == "attached":
            script.unlink()
        status, said, wrong = say("replay", name, "--check", "--scene", given)
        assert (status, wrong) == (0, "") and "60 of 60 equal: tick, time, position, command" in said
        status, said, wrong = say("analyse", name, "--scene", given)
        assert (status, wrong) == (0, "") and "bit-identical" in said
        assert [mark.name for mark in folder.glob("*executed")] == ["law executed"]  # as a module, not as a script
        (folder / "law executed").unlink()
    script.write_text(text.replace("4.0", "5.0"))
    status, said, wrong = say("replay", name, "--check", "--scene", "script.py")
    assert status == 1 and "differs from the recorded file" in wrong and " equal: command; first" in said


def test_an_attached_source_that_is_not_that_of_its_hash_is_not_executed(folder: Path, say: Any) -> None:
    run_script(folder, "run.maglev")
    recording = Recording.load(folder / "run.maglev")
    others = {name: data + b"# more\n" for name, data in recording.attachments.items()}
    replace(recording, attachments=others).save(folder / "run.maglev")
    status, _, wrong = say("replay", "run.maglev", "--check", "--scene", "attached")
    assert (status, wrong.count("\n")) == (2, 1) and "does not contain the recorded version of 'script.py'" in wrong
    assert not list(folder.glob("*executed"))


def test_a_hand_that_somebody_moves_is_taken_from_the_samples(folder: Path, say: Any) -> None:
    hand = SpringHand(target=[1e-3, 0.0, 0.0, 0.0, 0.0, 0.0])

    def move(sample: Any, command: Any) -> None:
        hand.target = [1e-3 * np.sin(0.3 * sample.tick), 0.0, 0.0, 0.0, 0.0, 0.0]

    file = open_recording(Path("run.maglev"))
    plant, controller = ExactPlant(Timing(**TIMING), **START, hand_force=hand), controller_of("Hold")
    drive(plant, controller, ticks=TICKS, record=file.begin(plant, controller), observe=move)
    file.close()
    status, said, wrong = say("replay", "run.maglev", "--check")
    assert (status, wrong) == (0, "") and "80 of 80 equal: tick, time, position, command," in said
    assert "recorded only, not replayed: hand" in said


class Mine(ExactPlant):
    """A plant of a user's own."""


class Odd(Law):
    """Law with hidden state."""

    def __init__(self, force: float) -> None:
        self.hidden = force

    def __call__(self, position: Any, velocity: Any, state: Any, wrench: list[Any]) -> Any:
        wrench[0] = wrench[0] + self.hidden
        return None, None


def test_a_plant_of_one_s_own_is_left_out_in_one_line(folder: Path, say: Any) -> None:
    file, plant, controller = open_recording(Path("run.maglev")), Mine(Timing(**TIMING), **START), controller_of("Hold")
    drive(plant, controller, ticks=TICKS, record=file.begin(plant, controller))
    file.close()
    status, said, wrong = say("replay", "run.maglev", "--check")
    assert (status, wrong) == (0, "") and "80 of 80 equal: command, pulse, pulse_width" in said
    assert "recorded only, not replayed: tick, time, position, applied," in unwrapped(said)
    told = "test_recording_alone.Mine is not available: only the controller's commands were compared"
    assert unwrapped(said).endswith(told)
    assert say("analyse", "run.maglev")[0] == 0


def test_what_nothing_tells_is_one_line(folder: Path, say: Any) -> None:
    for laws, ran, words in (
        ([Odd(0.1)], 0, "test_recording_alone.Odd cannot be rebuilt: it is not part"),
        (None, 3, "already running when recording started"),
    ):
        file, plant = open_recording(Path("run.maglev")), PLANTS["exact"]()
        answers = controller_of("Hold") if laws is None else Controller(laws, period=PERIOD)
        if ran:
            drive(plant, answers, ticks=ran)
        drive(plant, answers, ticks=5, record=file.begin(plant, answers))
        file.close()
        for given in ([], ["--scene", "attached"]):
            status, _, wrong = say("replay", "run.maglev", "--check", *given)
            assert (status, wrong.count("\n")) == (2, 1) and words in wrong
        assert say("analyse", "run.maglev")[0] == 0


# files made to do harm

Change = Callable[[dict[str, Any]], Any]


def law(**values: Any) -> Change:
    """Return a function that replaces a setup's first law."""
    return lambda setup: setup["controller"]["laws"].__setitem__(0, values)


def told(*place: Any, value: Any) -> Change:
    """Return a function that sets a value in a setup."""
    return lambda setup: at(setup, place[:-1]).__setitem__(place[-1], value)


def nested(depth: int) -> Any:
    """Return a list in a list and so on."""
    value: Any = []
    for _ in range(depth):
        value = [value]
    return value


DIGEST = "0" * 16
HOSTILE: Mapping[str, Change] = {
    "a module's function": law(**{"class": "os:system@" + DIGEST, "command": "touch executed"}),
    "a file elsewhere": law(**{"class": f"../../../tmp/evil.py:Evil@{DIGEST}"}),
    "a class of the package that is no law": law(**{"class": "MemoryFile", "path": "executed"}),
    "a law as plant": told("plant", "class", value="Wall"),
    "own code as plant": told("plant", "class", value=f"script.py:Magnet@{DIGEST}"),
    "a class that is a number": law(**{"class": 3}),
    "no class": law(axes="z"),
    "a private argument": law(**{"class": "Hold", "stiffness": 1.0, "damping": 1.0, "_each": []}),
    "a private method": told("plant", "__class__", value="Wall"),
    "a timing that is text": told("plant", "timing", value="Timing"),
    "a timing that is a law": told("plant", "timing", value={"class": "Bias", "wrench": [0.0] * 6}),
    "a model elsewhere": told("plant", "model", value="../../tmp/evil"),
    "steps without end": told("plant", "longest_step", value=1e-300),
    "a window without end": told("controller", "velocity", value={"class": "Window", "samples": 10**9}),
    "an own estimate": told("controller", "velocity", value={"class": f"a.py:B@{DIGEST}"}),
    "a thousand laws": told("controller", "laws", value=[{"class": "Bias", "wrench": [0.0] * 6}] * 1000),
    "a long list": told("plant", "pose", value=[0.0] * 100_001),
    "laws without end": told("controller", "laws", value=nested(500)),
    "laws that are one": told("controller", "laws", value={"class": "Bias", "wrench": [0.0] * 6}),
    "a controller as text": told("controller", value="os.system"),
    "no plant": told("plant", value=None),
    "a hand that is a law": told("plant", "hand", value={"class": "Hold", "stiffness": 1.0, "damping": 1.0}),
    "a force of no hand": told("plant", "hand_force", value=1.0),
    "a sensor as number": told("plant", "sensor", value=1.0),
    "a law that is a number": told("controller", "laws", 0, value=1.0),
    "a number without bound": told("plant", "mass", value=1e200),
    "a delay without end": told("plant", "timing", "delay", value=1e11),
    "samples that are none": told("samples", value=-1),
}


OF_OWN_CODE = ("a module's function", "a file elsewhere", "own code as plant", "an own estimate")


def test_a_scene_that_is_none_is_shown_or_refused(folder: Path, say: Any) -> None:
    for kind, name, value in (("run", "source", "../evil.py:Evil"), ("device", "scene", []), ("run", "scene", None)):
        parts = deepcopy(kept())
        begun_in(parts).update({"kind": kind, "scene": "mine.py:Mine", "source": DIGEST} | {name: value})
        (folder / "run.maglev").write_bytes(journal_of(parts))
        heard.clear()
        for typed in (["replay", "--check"], ["analyse", "--scene", "attached"]):
            status, _, wrong = say(typed[0], "run.maglev", *typed[1:])
            assert status in (0, 1, 2) and wrong.count("\n") == (status == 2), wrong
        assert executed() == []


def executed() -> list[tuple[str, Any]]:
    """Return what was heard besides the file that was read."""
    return [event for event in heard if event[0] != "open" or "run.maglev" not in str(event[1])]


def test_a_hostile_file_executes_nothing_and_is_one_line(folder: Path) -> None:
    for what, change in HOSTILE.items():
        parts = deepcopy(kept())
        change(begun_in(parts))
        (folder / "run.maglev").write_bytes(journal_of(parts))
        heard.clear()
        with pytest.raises(RecordingError) as refused:
            verify(Recording.load(Path("run.maglev")), rebuild)
        assert "\n" not in str(refused.value) and len(str(refused.value)) < 400, what
        assert executed() == [] and [path.name for path in folder.iterdir()] == ["run.maglev"], what


def test_not_even_where_a_person_lets_the_program_execute_what_a_file_holds(folder: Path, say: Any) -> None:
    for command in ("replay", "analyse"):  # the program's own code is loaded
        program.parse([command, "run.maglev"])
    for what in OF_OWN_CODE:
        parts = deepcopy(kept())
        HOSTILE[what](begun_in(parts))
        (folder / "run.maglev").write_bytes(journal_of(parts))
        heard.clear()
        status, output, wrong = say("replay", "run.maglev", "--check", "--scene", "attached")
        assert (status, output) == (2, "") and wrong.count("\n") == 1 and len(wrong) < 400, wrong
        assert say("analyse", "run.maglev")[0] in (0, 2)
        assert executed() == [] and [path.name for path in folder.iterdir()] == ["run.maglev"]


def begun_in(parts: list[Part]) -> dict[str, Any]:
    """Return the first setup."""
    return next(part["begin"] for part in parts if isinstance(part, dict) and "begin" in part)


heard: list[tuple[str, Any]] = []
"""Names executed, imported or opened."""


def hear(event: str, arguments: tuple[Any, ...]) -> None:
    if event in ("exec", "import", "open", "os.system", "subprocess.Popen"):
        heard.append((event, arguments[0]))


sys.addaudithook(hear)


@cache
def kept() -> list[Part]:
    """Return the parts of a script's recording; the code that reads it is loaded."""
    import tempfile

    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "run.maglev"
        file, plant, controller = open_recording(path), PLANTS["mujoco"](), controller_of("Hold")
        drive(plant, controller, ticks=20, record=file.begin(plant, controller))
        file.close()
        for command in (["replay", str(path), "--check"], ["analyse", str(path)]):
            assert run_here(*command).status == 0
        return parts_in(path.read_bytes())


# a recording of other code


@pytest.fixture
def shown(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Return the object shown in place of a window."""
    seen: list[Any] = []
    monkeypatch.setattr("maglev_mj.views.window.window.require_display", lambda: None)
    monkeypatch.setattr("maglev_mj.views.viewer_process.show_remotely", lambda source, front: seen.append(source))
    return seen


OTHER = {"sources": "c" * 16}


def of_other_code(monkeypatch: pytest.MonkeyPatch, path: Path) -> str:
    """Simulate other code; return its differences from that of a recording."""
    now = {**versions(), **OTHER}
    monkeypatch.setattr("maglev_mj.versions.versions", lambda: now)
    return differences(Recording.load(path).segments[0].setup["versions"], now)


@pytest.mark.parametrize("kind", ["session", "device"])
def test_other_code_is_shown_with_a_note_or_with_other_answers_refused_in_one_line(
    kind: str, folder: Path, say: Any, shown: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    path, before = RECORDED[kind](folder), Bias.__call__
    difference, segments = of_other_code(monkeypatch, path), Recording.load(path).segments
    monkeypatch.setattr("maglev_mj.cli.recordings._COMPARED", 1000)  # fewer than some of them have
    status, said, wrong = say("replay", str(path))
    assert (status, wrong, len(shown)) == (0, "", 1)
    same = f"the first {1000 // len(segments)} commands of each segment are identical"
    assert f"recorded by other code ({difference}); {same}" in unwrapped(said)

    def heavier(self: Any, position: Any, velocity: Any, state: Any, wrench: Any) -> Any:
        answer = before(self, position, velocity, state, wrench)
        wrench[2] = float(np.nextafter(wrench[2], np.inf))
        return answer

    monkeypatch.setattr(Bias, "__call__", heavier)
    status, _, wrong = say("replay", str(path))
    assert (status, len(shown), wrong.count("\n")) == (1, 1, 1)
    first = f"command differs from tick {int(segments[0].tick[0])} of segment 1"
    assert f"recorded by other code ({difference}); {first}" in wrong and OTHER["sources"] in wrong


def test_laws_of_one_s_own_of_other_code_are_shown_and_said_to_be(
    folder: Path, say: Any, shown: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    run_script(folder, "run.maglev")
    of_other_code(monkeypatch, Path("run.maglev"))
    status, said, wrong = say("replay", "run.maglev")
    assert (status, wrong, len(shown)) == (0, "", 1) and "its user-defined laws were not executed" in said
    said = unwrapped(say("replay", "run.maglev", "--scene", "attached")[1])
    assert "commands of each segment are identical" in said
    assert not (folder / "executed").exists()


def of_session(folder: Path) -> Path:
    session = Session(record=Path("run.maglev"), pacer=Pacer(budget=60.0, patience=3600.0))
    for _ in range(2):
        session.tick(0.05)
        session.act("friction")
    session.close()
    return Path("run.maglev")


def of_device(folder: Path) -> Path:
    return HERE / "recordings" / "flight.maglev"


def test_a_flight_has_the_delay_of_its_setup_and_an_unmeasured_hand() -> None:
    flight = Recording.load(of_device(Path()))
    fields = verify(flight, rebuild).fields
    assert {fields[name].compared for name in ("delay", "hand_recorded", "hand_acts_on_flotor")} == {
        len(flight.segments)
    }
    setup = dict(flight.segments[0].setup)
    setup["parameters"] = {name: one for name, one in setup["parameters"].items() if name != "delay"}
    with pytest.raises(InvalidRecordingError, match="cannot rebuild the recorded setup: 'delay'"):
        verify(Recording([replace(flight.segments[0], setup=setup)]), rebuild)


RECORDED = {"session": of_session, "device": of_device}


# what is in a file


def test_segments_of_one_file_attach_a_source_once(folder: Path) -> None:
    run_script(folder, "run.maglev")
    parts = [part for part in parts_in((folder / "run.maglev").read_bytes()) if isinstance(part, dict)]
    found = [(part["attach"], part["type"], base64.b64decode(part["data"])) for part in parts if "attach" in part]
    text = (folder / "script.py").read_text()
    assert sorted(name for name, _, _ in found) == sorted(
        ["model/drop.xml", "model/maglev.xml", f"source/{hash_of(text)}/script.py"]
    )
    assert (f"source/{hash_of(text)}/script.py", "text/x-python", text.encode()) in found
    assert len(Recording.load(folder / "run.maglev").segments) == 2


IMPORTS = """
from pathlib import Path
from subprocess import Popen


class Mark:
    def __init__(self, args):
        Path(args[0]).write_text("made")


def lift(position, velocity):
    return [0.0] * 6
"""


@pytest.mark.parametrize(("wanted", "given"), [("Popen", "attached"), ("Mark", "script.py")])
def test_leave_is_for_the_laws_that_a_file_defines(wanted: str, given: str, folder: Path, say: Any) -> None:
    # Neither what it imports nor a class that is no law gets the arguments that a recording tells.
    run_script(folder, "run.maglev")
    (folder / "script.py").write_text(IMPORTS)
    recording = Recording.load(folder / "run.maglev")
    setup: Any = recording.segments[0].setup
    digest, arguments = hash_of(IMPORTS), ["touch", "made"] if wanted == "Popen" else ["made"]
    setup["controller"]["laws"] = [{"class": f"script.py:{wanted}@{digest}", "args": arguments}]
    replace(
        recording, segments=recording.segments[:1], attachments={f"source/{digest}/script.py": IMPORTS.encode()}
    ).save(folder / "run.maglev")
    status, _, wrong = say("replay", "run.maglev", "--check", "--scene", given)
    assert (status, wrong.count("\n")) == (2, 1), wrong
    assert ("script.py must define Popen" if wanted == "Popen" else "a class with __call__") in wrong
    assert not (folder / "made").exists()
