"""Pages that a browser opens by themselves: their physics against the package, their colours and files."""

from __future__ import annotations

import json
import math
import re
import shutil
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj import Controller, ExactPlant, Hand, StickSlip, Timing, Wall, colours, drive, largest_stable_stiffness
from maglev_mj.cli import main
from maglev_mj.theory import spectral_radius
from maglev_mj.views.pages import FOLDER, NAMES, one_file

Case = dict[str, Any]

COUNT, TICKS, FIRST, LAST = 200, 400, 100, 50
"""Random loops and walls; samples of a loop, the first of them and the last."""


def answers(**cases: Sequence[Case]) -> Mapping[str, Any]:
    """Return what `core.js` computes of loops, walls, glides and pulls; see `core_answers.js`."""
    program = [str(shutil.which("node")), str(Path(__file__).with_name("core_answers.js")), str(FOLDER / "core.js")]
    given = json.dumps({"loops": [], "walls": [], "glides": [], "pulls": [], **cases})
    done = subprocess.run(program, input=given, capture_output=True, text=True, check=True)
    answered: Mapping[str, Any] = json.loads(done.stdout)
    return answered


def new_seed() -> int:
    """Return a seed that no run before had; a failure names it."""
    return int(np.random.SeedSequence().entropy) % 2**32  # type: ignore[arg-type]


def random_timing(random: np.random.Generator) -> Case:
    """Return a loop of 50 to 2000 Hz with a delay of 0 to 10 periods: whole, below one, or any."""
    period = math.exp(random.uniform(math.log(5e-4), math.log(2e-2)))
    periods = (float(random.integers(0, 11)), random.uniform(0.0, 1.0), random.uniform(0.0, 10.0))[random.integers(3)]
    return {"period": period, "delay": float(periods) * period, "mass": float(random.uniform(0.2, 2.0))}


def random_gains(random: np.random.Generator, timing: Case, firm: float) -> Case:
    """Return stiffness and damping near the boundary of stability, which is lower with a longer delay."""
    late = 1.0 + 2.0 * timing["delay"] / timing["period"]
    gain = timing["mass"] / timing["period"] / late
    stiffness = firm * random.uniform(0.02, 0.4) * gain**2 / timing["mass"]
    return {"stiffness": float(stiffness), "damping": float(random.uniform(0.1, 0.6) * gain)}


def loop_of(case: Case) -> Case:
    """Return the keywords of a case's closed loop in the theory."""
    hand = Hand(stiffness=case["hand"], axes="x")
    return {"period": case["period"], "delay": case["delay"], "mass": case["mass"], "hand": hand}


def random_loop(random: np.random.Generator, index: int) -> Case:
    """Return a loop under a load: seven walls of ten, half with a pulse, and friction; a third with a hand."""
    case = random_timing(random)
    gains = random_gains(random, case, random.choice([1.0, 1.0, 5.0]))
    load = float(random.uniform(0.5, 7.0))
    case["hand"] = float(random.uniform(50.0, 400.0)) if index % 3 == 0 else 0.0
    if friction := index % 10 > 6:
        gains |= {"breakaway": load * float(random.uniform(0.5, 1.5)), "slow": 0.01}
    else:
        pulse = 0.5 * gains["damping"] * (index % 2)
        width = float(random.uniform(0.1, 1.0)) * case["period"] * (pulse > 0.0)
        gains |= {"edge": 5e-4, "pulse": pulse, "width": width}
    case |= {"law": "StickSlip" if friction else "Wall", "gains": gains, "load": load}
    return case | {"phase": float(random.uniform(0.0, 1.0)), "x": -1e-3, "v": 0.0, "ticks": TICKS}


def by_package(case: Case) -> list[float]:
    """Return the position at each sample [m], of the exact plant."""
    gains, period, mass = dict(case["gains"]), case["period"], case["mass"]
    if case["law"] == "Wall":
        law: Any = Wall(axes="x", upper=gains.pop("edge"), pulse_width=gains.pop("width"), **gains)
    else:
        law = StickSlip(axes="x", v_min=gains.pop("slow"), **gains)
    timing = Timing(period=period, delay=case["delay"], phase=case["phase"])
    hand = Hand(stiffness=case["hand"], axes="x") if case["hand"] else None
    gravity, pose, seen = (case["load"] / mass, 0.0, 0.0), (case["x"], 0, 0, 0, 0, 0), list[float]()
    with ExactPlant(timing, mass=mass, gravity=gravity, pose=pose, hand=hand, escape=(1e90, 1e90)) as plant:
        drive(
            plant,
            Controller([law], period=period),
            case["ticks"],
            observe=lambda sample, _: seen.append(float(sample.position[0])),
        )
    return seen


@pytest.mark.needs("node")
def test_the_pages_move_as_the_exact_plant_does() -> None:
    random = np.random.default_rng(seed := new_seed())
    loops = [random_loop(random, index) for index in range(COUNT)]
    expected = np.array([by_package(case) for case in loops])
    size = np.maximum(np.abs(expected).max(axis=1), 1e-3)
    off = np.abs(np.array(answers(loops=loops)["positions"]) - expected) / size[:, np.newaxis]
    # a bounce doubles rounding: one that goes on is compared over its first samples
    settles = np.ptp(expected[:, -LAST:], axis=1) < 1e-3 * np.ptp(expected, axis=1)
    first, last = off[:, :FIRST].max(axis=1), off[settles, -LAST:].max(axis=1)
    assert first.max() < 1e-9, (seed, loops[first.argmax()])
    assert last.max() < 1e-9, (seed, [case for case, one in zip(loops, settles) if one][last.argmax()])
    assert 0.2 < settles.mean() < 0.9 and np.median(np.ptp(expected, axis=1)) > 1e-4, seed
    print(
        f"seed {seed}: {COUNT} loops within {first.max():.1e}, at rest within {last.max():.1e} of the largest position"
    )


@pytest.mark.needs("node")
def test_the_pages_judge_walls_as_the_package_does() -> None:
    random = np.random.default_rng(seed := new_seed())
    walls = []
    for index in range(COUNT):
        timing = random_timing(random)
        hand = float(random.uniform(50.0, 2000.0)) if index % 2 else 0.0
        walls.append({**timing, "hand": hand, **random_gains(random, timing, 2.0)})
    answered, near, most = answers(walls=walls), 0, [0.0, 0.0]
    for wall, radius, critical in zip(walls, answered["radii"], answered["critical"], strict=True):
        limit = float(largest_stable_stiffness(wall["damping"], **loop_of(wall)))
        off = abs(radius - float(spectral_radius(wall["stiffness"], wall["damping"], **loop_of(wall))))
        most = [max(most[0], off), max(most[1], abs(critical - limit) / max(limit, 1.0))]
        assert max(most) < 1e-7, (seed, wall)
        assert (wall["stiffness"] < critical) == (wall["stiffness"] < limit), (seed, wall)
        near += 0.3 < wall["stiffness"] / max(limit, 1.0) < 3.0
    assert near > COUNT / 10, seed  # neither all stable nor all unstable
    print(f"seed {seed}: {COUNT} radii within {most[0]:.1e}, critical stiffness within {most[1]:.1e} of it")


@pytest.mark.needs("node")
def test_a_metal_stop_is_never_passed_nor_missed_and_every_motion_ends() -> None:
    random = np.random.default_rng(seed := new_seed())
    stop, glides = 4.5e-3, []
    for _ in range(3000):
        hand = {"stiffness": float(random.choice([0.0, 50.0, 400.0, 2000.0])), "target": random.uniform(-0.02, 0.02)}
        force = float(random.choice([0.0, *(random.choice([-1.0, 1.0]) * 10.0 ** random.uniform(-9.0, 4.0, 3))]))
        x = float(random.choice([-stop, stop, stop * (1.0 - 1e-15), 0.0, *random.uniform(-stop, stop, 3)]))
        v = float(
            random.choice([0.0, 1e-18, -1e-18, 1e-9, *random.uniform(-1.0, 1.0, 3) * 10.0 ** random.uniform(-6, 2)])
        )
        glides.append({"force": force, "hand": hand, "x": x, "v": v, "time": 10.0 ** random.uniform(-5.0, -1.7)})
    answered = answers(glides=glides)
    for case, end in zip(glides, answered["glides"], strict=True):
        assert end["time"] == case["time"] and abs(end["x"]) <= answered["stop"] == stop, (seed, case)
        assert end["hits"] < answered["mostHits"] / 2, (seed, case)
        assert end["hits"] or end["outside"] < 1e-12, (seed, case)  # 1000 points of the motion without a stop
        assert not end["hits"] or end["outside"] > -1e-6 or abs(case["x"]) > stop * 0.999, (seed, case)
    assert sum(end["hits"] > 1 for end in answered["glides"]) > 100, seed
    print(f"seed {seed}: at most {max(end['hits'] for end in answered['glides'])} hits")


@pytest.mark.needs("node")
def test_friction_lets_go_twice_where_its_page_says_so() -> None:
    """Of a weak friction or in a fast loop: the sample after breakaway sees a speed below v_min, and it sticks."""
    cases = [{"rate": 200, "breakaway": 2.0}, {"rate": 1000, "breakaway": 3.0}, {"rate": 200, "breakaway": 3.0}]
    for case, changes in zip(cases, answers(pulls=cases)["pulls"], strict=True):
        assert [stuck for _, stuck in changes[:3]] == [False, True, False]  # lets go, sticks, lets go
        slip = changes[1][0] - changes[0][0]
        assert slip > 5e-4 if case == cases[-1] else slip < 6e-5, case


# what of maglev_mj/colours.py a page's colour is, and its contrast on the page
ROLES = {"hand": "HAND", "magnet": "DEVICE", "good": "GOOD", "bad": "BAD", "pin": "STUCK", "dim": "REFERENCE"}
LINES = {"wall": "WALL"}


def test_colours_by_role_are_those_of_the_package() -> None:
    styles = dict(re.findall(r"--(\w+): (light-dark\([^)]*\))", (FOLDER / "page.css").read_text("utf-8")))
    assert {name: styles[name] for name in ROLES} == {
        name: colours.on_page(getattr(colours, role)) for name, role in ROLES.items()
    }
    assert {name: styles[name] for name in LINES} == {
        name: colours.on_page(getattr(colours, role), 3.0) for name, role in LINES.items()
    }


def test_each_file_is_small_and_a_page_in_one_file_needs_no_other() -> None:
    files = [path for path in FOLDER.iterdir() if path.suffix in (".html", ".css", ".js")]
    assert {path.stem for path in files if path.suffix == ".html"} == set(NAMES)
    assert {path.name: path.stat().st_size for path in files if path.stat().st_size >= 20_000} == {}
    for name in NAMES:
        text = one_file(name)
        assert len(text.encode()) < 60_000
        assert re.findall(r"(?:src|href)=\"(?!data:)[^\"]*|url\(|https?:|import |fetch\(", text) == []
        for path in files:
            if path.suffix != ".html":  # each once, whole
                assert text.count(path.read_text("utf-8")) == 1, path.name
                assert "</script" not in path.read_text("utf-8")


def test_the_tour_names_the_page_that_needs_no_python(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("maglev_mj.cli.peripherals.PageOptions.open", lambda self: id)
    monkeypatch.setattr("maglev_mj.cli.scenes._show", lambda *_: None)
    assert main(["view", "--tour", "--web", "--out", str(tmp_path)]) == 0
    path = capsys.readouterr().out.strip().partition("without Python: open ")[2]
    assert Path(path).read_text("utf-8").startswith("<!doctype html>")
