"""One line under each verdict says held and free, and it is the same in every front end."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from maglev_mj import Controller, Hand, Hold, Wall, device_card, diagnose, find_scene, stability
from maglev_mj.bridge.preflight import assess
from maglev_mj.cli import main
from maglev_mj.control import Law
from maglev_mj.device import Device
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.stability_check import stability_warning
from maglev_mj.session.margin import margin
from maglev_mj.spec import RANGE
from maglev_mj.terminal import wrapped
from maglev_mj.theory.held import FREE, OWN, held_of
from maglev_mj.theory.loop import Loop
from maglev_mj.theory.verdict import judge
from tests.bridge.test_preflight import GOOD
from tests.cells import unstable
from tests.studies.test_verdict_properties import Undeclared

CASES: list[dict[str, Any]] = [  # of each kind: all stable, all unstable, only while held, only free
    {"stiffness": 6000.0, "damping": 80.0, "delay": 0.0015},
    {"stiffness": 20_000.0, "damping": 40.0, "delay": 0.005},
    {"stiffness": 6000.0, "damping": 80.0, "delay": 0.005},
    {"stiffness": 6000.0, "damping": 80.0, "delay": 0.0032},
]


class Bare(Drop):
    """Drop on a wall, whose other axes are free."""

    def laws(self) -> list[Any]:
        return [Wall(axes="z", lower=0.0, stiffness=self.stiffness, damping=self.damping)]


class Linearised(Drop):
    """The same, by linearisation."""

    def laws(self) -> list[Any]:
        return [Undeclared(axes="z", stiffness=self.stiffness, damping=self.damping)]


def fronts(scene: Drop) -> dict[str, Any]:
    """Return the verdict of each front end: as words, and as JSON where there is one."""
    values: Any = {name: getattr(scene, name) for name in ("stiffness", "damping", "period", "delay", "device")}
    report = replace(GOOD, device_delay=scene.delay, delay=np.full(9, scene.delay))
    return {
        "numbers": diagnose(**values),
        "scene": diagnose(scene),
        "stability": stability(scene),
        "loop": held_of(Loop.of(**values)[0], reach=scene.body.bounded.range),
        # at the measured delay, not at that of the scene
        "flight": assess(scene.replace(delay=0.0), scene.body.inertia, report, as_written=True).held,
    }


def random_scene(seed: int, kind: type[Drop] = Bare) -> Drop:
    random = np.random.default_rng(seed)
    if seed < len(CASES):
        return kind(pulse=0.0, **CASES[seed])
    device = str(random.choice(["ubc", "stage"]))
    period, mass = 10.0 ** random.uniform(-3.0, -2.0), Device.load(device).mass
    w = 10.0 ** random.uniform(-1.3, -0.3) / period
    gains: Any = {"stiffness": mass * w * w, "damping": 2.0 * random.uniform(0.05, 0.8) * mass * w}
    return kind(device=device, period=period, delay=period * random.uniform(0.0, 1.5), pulse=0.0, **gains)


@pytest.mark.parametrize("seed", range(10))
def test_every_front_end_says_the_same_held_and_free(seed: int) -> None:
    scene = random_scene(seed)
    found = fronts(scene)
    lines = found["loop"].lines
    assert lines[0].startswith("held    arm ") and found.pop("flight") == lines
    for result in found.values():
        held = getattr(result, "held", result)
        assert held.lines == lines
        for name, part in held.parts.items():
            assert part.radius == pytest.approx(found["loop"].parts[name].radius, abs=1e-9)
            assert float(part.critical_delay) == pytest.approx(float(found["loop"].parts[name].critical_delay))
        assert held.leaves_after == pytest.approx(found["loop"].leaves_after)
    for name in ("numbers", "scene", "stability"):
        data = found[name].as_json()
        assert json.loads(json.dumps(data["held"], allow_nan=False)).keys() == found["loop"].parts.keys()
        assert data["leaves_after"] == found[name].leaves_after
        text = str(found[name].table())
        assert all("\n".join(wrapped(line, further="    ")) in text for line in lines)
    assert found["stability"].stable == found["loop"].parts[FREE].stable == found["scene"].stable


def test_the_cases_are_of_each_kind() -> None:
    lines = [stability(random_scene(seed)).held.lines for seed in range(len(CASES))]
    assert [len(one) for one in lines] == [1, 1, 2, 2]
    assert lines[2][1].startswith("Stable only while held (arm): released with 1 N it rings at 20.5 Hz and passes 4.5")
    assert lines[3][1].startswith("Unstable only while held (stylus): ")


@pytest.mark.parametrize("seed", [2, 3])
def test_a_card_says_held_and_free_of_its_target_wall(seed: int) -> None:
    scene = random_scene(seed)
    card, lines = device_card(scene), stability(scene).held.lines
    assert card.held.lines == lines and card.as_json()["leaves_after"] == card.held.leaves_after
    assert all("\n".join(wrapped(line, further="    ")) in str(card.table()) for line in lines)


@pytest.mark.parametrize("seed", [2, 3, 5, 7])
def test_a_linearised_law_has_the_verdicts_of_its_gains(seed: int) -> None:
    stated, own = (stability(random_scene(seed, kind)) for kind in (Bare, Linearised))
    assert stated.stated and not own.stated and own.held.lines == stated.held.lines
    for name, part in own.held.parts.items():
        assert part.radius == pytest.approx(stated.held.parts[name].radius, abs=1e-6)
    assert own.held.leaves_after == pytest.approx(stated.held.leaves_after, rel=1e-4)


class Diagonal(Law):
    """Spring and damper on each diagonal of x and y: coupled axes."""

    def __init__(self, *stiffness: float) -> None:
        self.stiffness = stiffness

    def __call__(self, position: Any, velocity: Any, state: Any, wrench: list[Any]) -> Any:
        for side, stiffness in zip((1.0, -1.0), self.stiffness):
            x, v = (0.5 * (part[0] + side * part[1]) for part in (position, velocity))
            force = -(stiffness * x + 80.0 * v)
            wrench[0], wrench[1] = wrench[0] + force, wrench[1] + side * force
        return state, None


def test_coupled_axes_are_held_as_their_diagonals() -> None:
    """A hand acts alike on both; a force along an axis moves the diagonal by its share."""
    stiffness = 6000.0, 3000.0
    found = judge(Controller([Diagonal(*stiffness)], period=0.005), delay=0.005)
    assert found.axes == ("x", "y") and not found.stated
    loops = [Loop(stiffness=one, damping=80.0, inertia=0.7, period=0.005, delay=0.005) for one in stiffness]
    single = [held_of(loop, reach=[2.0 * RANGE[0]] * 6) for loop in loops]
    for name, part in found.held.parts.items():
        assert part.radius == pytest.approx(max(one.parts[name].radius for one in single), abs=1e-6)
        least = min(float(one.parts[name].critical_delay or 0.0) for one in single)
        assert float(part.critical_delay or 0.0) == pytest.approx(least, rel=1e-6)
    assert found.held.leaves_after == pytest.approx(single[0].leaves_after, rel=1e-4)


def test_a_released_handle_on_a_rotation_and_free_motion() -> None:
    turning = judge(Controller([Hold(axes="rx", stiffness=40.0, damping=0.02)], period=0.005), delay=0.005)
    assert turning.held.lines == ("held    no published hand turns it; free unstable",)
    assert turning.held.release is not None and turning.held.release.force == pytest.approx(0.05)
    assert judge(Controller([], period=0.005), delay=0.005).held.lines == ("held    free motion: no law acts",)


def test_a_hand_alone_is_no_loop_of_the_laws() -> None:
    """The wall of press is left in free air, where its arm is slow."""
    verdict = stability(find_scene("press")())
    assert verdict.spectral_radius == pytest.approx(0.8829, abs=5e-5) and not verdict.in_hand
    own = judge(Linearised(pulse=0.0).controller(), delay=0.0015, hand="arm", pose=[0.0, 0.0, -1e-3, 0.0, 0.0, 0.0])
    assert own.spectral_radius == pytest.approx(0.8771, abs=5e-5) and not own.in_hand


def test_the_verdict_on_a_scene_with_a_hand_is_the_worst_of_free_and_held() -> None:
    press: Any = find_scene("press")
    for hand, stable in (("stylus", False), ("arm", True)):
        scene = press(delay=0.0032, hand=hand)
        verdict, found = stability(scene), diagnose(scene)
        assert verdict.stable is stable and verdict.in_hand is not stable and found.stable is stable
        assert ("held by the scene's hand" in verdict.headline) is not stable
        warning = stability_warning(scene)
        assert (warning is None) is stable and (stable or "in the scene's hand" in str(warning))
        assert unstable([scene]) == [not stable] and margin(scene).stable is stable
        assert verdict.held.lines == found.held.lines
        assert verdict.held.lines[1].startswith("Unstable only while held (stylus)")
    assert diagnose(press(delay=0.0032, hand="stylus"), hand="none").stable


class LinearisedPress(find_scene("press")):  # type: ignore[misc]
    """Press on a wall without declared gains."""

    def laws(self) -> list[Any]:
        return [Undeclared(axes="z", stiffness=self.stiffness, damping=self.damping)]


@pytest.mark.parametrize(("hand", "stable"), [("stylus", False), ("arm", True)])
def test_a_linearised_scene_with_a_hand_is_judged_free_and_held_everywhere(hand: str, stable: bool) -> None:
    scene = LinearisedPress(delay=0.0032, hand=hand)
    verdict, found = stability(scene), diagnose(scene)
    assert verdict.stable is found.stable is stable and verdict.in_hand is not stable
    assert found.spectral_radius == pytest.approx(verdict.spectral_radius, abs=1e-9)
    assert verdict.held.lines == found.held.lines and (found.loop.hand == "none") is stable


@pytest.mark.parametrize(("hand", "stable"), [("stylus", False), ("arm", True)])
def test_a_linearised_scene_with_a_hand_is_warned_of_as_it_is_judged(hand: str, stable: bool) -> None:
    scene = LinearisedPress(delay=0.0032, hand=hand)
    assert margin(scene).stable is stable and (stability_warning(scene) is None) is stable


def test_a_hand_of_the_scene_that_is_not_published_is_a_part() -> None:
    own = Hand(mass=0.2, damping=20.0, stiffness=300.0, grip_damping=0.8, grip_stiffness=800.0)
    hold = Controller([Hold(axes="z", stiffness=6000.0, damping=80.0)], period=0.005)
    held, aside = (judge(hold, delay=0.0032, hand=hand) for hand in (own, replace(own, axes="x")))
    assert held.in_hand and held.stable is False and "own hand unstable" in held.held.lines[0]
    assert aside.stable is True and not aside.in_hand and "own hand" not in aside.held.lines[0]
    assert OWN in aside.held.parts


def test_the_command_lines_print_it(capsys: pytest.CaptureFixture[str]) -> None:
    stated = "--stiffness 6000 --damping 80 --delay 0.005"
    for line in (f"diagnose --mass 0.7 --rate 200 {stated}", f"stability drop {stated}"):
        assert main(line.split()) == 0
        text = capsys.readouterr().out
        assert "\n  held    arm " in text and max(map(len, text.splitlines())) <= 80
