"""Properties of a verdict over all front ends: agreement, effects, advice, scaling, load."""

from __future__ import annotations

import json
import math
import re
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj import AxisLaw, compare, device_card, diagnose, gain, hold, judge
from maglev_mj import stability as stability_of
from maglev_mj.bridge.preflight import _critical_delay
from maglev_mj.cli import main
from maglev_mj.control import LowPass
from maglev_mj.errors import ParameterError
from maglev_mj.plants.hand import Mode, get_hand
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.stability_check import stability_warning, wall_loops
from maglev_mj.session.margin import margin
from maglev_mj.studies.card import _target
from maglev_mj.studies.compare import sweep_laws
from maglev_mj.studies.stability_map import StabilityParameters, run_stability
from maglev_mj.theory import DeviceLaw
from maglev_mj.theory.boundary import boundary_of, stiffest_of
from maglev_mj.theory.design import WallRequirements, design_wall
from maglev_mj.theory.loop import Loop
from maglev_mj.theory.loop_parameters import LoopParameters
from maglev_mj.theory.remedies import critical_of
from tests.cells import unstable
from tests.studies.test_one_verdict import Notch, lagging
from tests.sweeps import further

ALONG_Z = "x", "y", "rx", "ry", "rz"


class Undeclared(AxisLaw):
    """Wall that declares no gains."""

    stiffness: float = gain("stiffness", "N/m")
    damping: float = gain("damping", "N s/m")

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        return -(gains.stiffness * x + gains.damping * v) * (x < 0.0)


class Linearised(Drop):
    """Drop on that wall."""

    def laws(self) -> list[Any]:
        return [Undeclared(axes="z", stiffness=self.stiffness, damping=self.damping), hold(self, ALONG_Z)]


def drawn(seed: int, folder: Path, *, declared: bool = True, device: bool = False) -> Drop:
    """Return a random scene with a lag of its device, and perhaps a law with a filter on the device."""
    random = np.random.default_rng(seed)
    values: dict[str, Any] = {"device": lagging(float(random.choice([0.0, 1e-4, 1e-3])), folder), "pulse": 0.0}
    values["duration"] = 0.01
    values |= {"stiffness": 10.0 ** random.uniform(3.5, 5.0), "damping": random.uniform(30.0, 250.0)}
    values |= {"delay": random.uniform(1e-4, 1.5e-3), "period": float(random.choice([1e-3, 2e-3]))}
    if device:
        values |= {"device_damping": random.uniform(20.0, 150.0), "device_cutoff": random.uniform(50.0, 400.0)}
    return (Drop if declared else Linearised)(**values)


MORE = further(*((seed, bool(seed % 2)) for seed in range(7, 80)))


def said(front: Callable[[], Any]) -> Any:
    """Return True, False or None for stable, unstable and not judged."""
    try:
        return front()
    except ParameterError:
        return None


def warned(scene: Drop) -> bool | None:
    text = stability_warning(scene)
    return True if text is None else False if " is unstable" in text else None


STABLE: dict[str, Callable[[Drop], Any]] = {
    "judge": lambda scene: judge(scene).stable,
    "stability": lambda scene: stability_of(scene).stable,
    "diagnose": lambda scene: diagnose(scene).stable,
    "warning": warned,
    "sweep": lambda scene: not unstable([scene])[0],
    "page": lambda scene: margin(scene).stable,
    "numbers": lambda scene: all(judge(loop).stable for loop in Loop.of(scene)),
}


@pytest.mark.parametrize(("seed", "device"), [*((seed, False) for seed in range(6)), (6, True), *MORE])
def test_front_ends_agree_on_declared_gains(
    seed: int, device: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("maglev_mj.studies.compare._TICKS", 20)  # in less time
    scene = drawn(seed, tmp_path, device=device)
    # of a law on the device a diagnosis takes seconds
    fronts = {name: front for name, front in STABLE.items() if not (device and seed < 7 and name == "diagnose")}
    answers = {name: said(partial(front, scene)) for name, front in fronts.items()}
    assert len({*answers.values()}) == 1, answers
    assert answers["judge"] or not _critical_delay(scene, scene.body.inertia) > scene.delay
    walls, compared = judge(wall_loops(scene)), compare(scene, ["pd"], phases=1).margins["pd"]
    assert compared["spectral_radius"] == pytest.approx(walls.spectral_radius, abs=1e-9)
    if device:
        return
    found = diagnose(scene)
    assert found.spectral_radius == pytest.approx(walls.spectral_radius, abs=1e-9)
    mapped = sweep_laws(scene, ["pd"], "damping", [scene.damping], figure="critical_stiffness")
    critical = [found.critical_stiffness, float(mapped.figure("critical_stiffness")[0, 0])]
    critical += [compared["critical_stiffness"]] * (walls.ratio > 0.0)  # NaN if none is stable
    assert critical == pytest.approx([walls.critical_stiffness] * len(critical), rel=1e-6)


@pytest.mark.parametrize("seed", further(*range(20)))
def test_front_ends_agree_on_linearised_laws(seed: int, tmp_path: Path) -> None:
    scene = drawn(seed, tmp_path, declared=False)
    answers = {name: said(partial(front, scene)) for name, front in STABLE.items()}
    assert len({*answers.values()}) == 1, answers
    walls, twin = judge(wall_loops(scene)), judge(wall_loops(Drop(**scene.independent_values())))
    assert walls.spectral_radius == pytest.approx(twin.spectral_radius, abs=1e-6)
    assert walls.critical_stiffness == pytest.approx(twin.critical_stiffness, rel=1e-6)


@pytest.mark.parametrize("hand", ["arm", "stylus", "fingertip"])
def test_a_hand_is_that_of_the_loop_in_every_front_end(hand: str) -> None:
    scene = Drop(stiffness=9000.0, pulse=0.0)
    held = [loop for loop in Loop.of(scene, hand=hand) if loop.hand is not None and loop.axis == "z" and loop.state]
    assert judge(held[0]).spectral_radius == pytest.approx(diagnose(scene, hand=hand).spectral_radius, abs=1e-12)
    assert judge(held[0]).critical_stiffness == pytest.approx(diagnose(scene, hand=hand).critical_stiffness, rel=1e-6)


@pytest.mark.parametrize("seed", [*range(5), *further(*range(5, 40))])
def test_one_wall_of_stability_is_answered_as_diagnose_answers_it(seed: int, tmp_path: Path) -> None:
    random = np.random.default_rng([67, seed])
    period, rotary = 10.0 ** random.uniform(-3.3, -2.0), random.random() < 0.3
    body = 10.0 ** random.uniform(-3.0, -1.0) if rotary else random.uniform(0.05, 2.0)
    loop = {"period": period, "delay": period * random.uniform(0.0, 3.0), "inertia" if rotary else "mass": body}
    most = body / period
    loop |= {"stiffness": random.uniform(0.01, 0.5) * most / period, "damping": random.uniform(0.0, 0.4) * most}
    words = [word for name, value in loop.items() for word in (f"--{name}", repr(float(value)))]
    words += ["--hand", str(random.choice(["none", "arm", "stylus"]))] if not rotary else []
    answers = []
    for command in ("stability", "diagnose"):
        assert main([command, *words, "--json", str(tmp_path / command)]) == 0
        answers.append(json.loads((tmp_path / command).read_text("utf-8")))
    assert answers[0] == answers[1]


def test_a_recording_is_judged_as_the_loop_that_it_is_diagnosed_as(tmp_path: Path) -> None:
    shaking: Any = {"stiffness": 500.0, "damping": 1.0, "mass": 0.15}
    loop = diagnose(**shaking, rate=200.0, delay=0.005)
    time_ = 0.005 * np.arange(300)
    growth = math.log(2.0) / loop.doubling_time
    position = 1e-5 * np.exp(growth * time_) * np.sin(2.0 * math.pi * loop.frequency * time_)
    path = tmp_path / "shaking.csv"
    path.write_text("time,z\n" + "".join(f"{t:.6f},{z:.12g}\n" for t, z in zip(time_, position, strict=True)))
    verdict = judge(str(path), **shaking)
    assert verdict.stable is False
    assert verdict.spectral_radius == pytest.approx(diagnose(str(path), **shaking).spectral_radius, abs=1e-12)


def test_loops_of_devices_scenes_controllers_and_numbers_are_read_by_one_name() -> None:
    (stage,) = Loop.of("stage", stiffness=6000.0, damping=80.0, delay=1e-3)
    (number,) = Loop.of(
        **{name: getattr(stage, name) for name in ("stiffness", "damping", "period", "delay")}, inertia=0.3
    )
    assert number == replace(stage, driver_lag=0.0) and (stage.driver_lag, stage.inertia) == (1e-4, 0.3)
    assert Loop.of(device="stage", stiffness=6000.0, damping=80.0, delay=1e-3).items == (stage,)
    assert Loop.of(stage).items == (stage,) and Loop.of(stage, delay=0.0)[0].delay == 0.0
    scene = Drop(stiffness=9000.0)
    assert Loop.of("drop", stiffness=9000.0).items == Loop.of(scene).items == Loop.of(Drop, stiffness=9000.0).items
    body: Any = {"delay": scene.delay, "inertia": scene.body.inertia}
    assert Loop.of(scene.controller(), **body).items == Loop.of(scene).items
    for wrong, says in (
        ({"stifness": 1.0}, "did you mean stiffness"),
        ({"stiffness": 1.0}, "must be given, or a device"),
    ):
        with pytest.raises(ParameterError, match=says):
            judge(**wrong)


# every effect moves every verdict

NUMBERS: dict[str, Any] = {"period": 1e-3, "delay": 8e-4, "mass": 0.3}
GAINS = 30_000.0, 120.0
LAW: dict[str, Any] = {"device_damping": 60.0}
EFFECTS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "lag": ({}, {"driver_lag": 1e-3}),
    "own damping": ({}, {"own_damping": 5.0}),
    "mode": ({}, {"mode": "120,0.05,0.3"}),
    "device gains": ({}, LAW),
    "device filter": (LAW, LAW | {"device_cutoff": 60.0}),
    "device delay": (LAW, LAW | {"device_delay": 9e-4}),
    "device rate": (LAW, LAW | {"device_period": 5e-4}),
    "host filter": ({}, {"cutoff": 60.0}),
    "hand": ({}, {"hand": "arm"}),
    "delay": ({}, {"delay": 1.2e-3}),
    "period": ({}, {"period": 1.5e-3}),
    "inertia": ({}, {"mass": 0.4}),
    "rotary": ({"mass": None, "inertia": 0.3}, {"mass": None, "inertia": 0.4}),
}
"""Options of `diagnose`, `map`, `design` and `card`, without and with an effect."""


def of_loop(p: dict[str, Any]) -> Loop:
    """Return the loop that the options describe, written from the fields of `Loop`."""
    p = {"mass": None, "inertia": None, "hand": "none", "mode": None, "cutoff": None} | p
    beside = {name.removeprefix("device_"): p.pop(name) for name in list(p) if name.startswith("device_")}
    cutoff, mass, inertia = p.pop("cutoff"), p.pop("mass"), p.pop("inertia")
    hand, mode = get_hand(p.pop("hand")), p.pop("mode")
    return Loop(
        stiffness=GAINS[0],
        damping=GAINS[1],
        **p,
        inertia=mass or inertia,
        hand=hand,
        mode=None if mode is None else Mode(*map(float, mode.split(","))),
        velocity=None if cutoff is None else LowPass(cutoff=cutoff),
        device=DeviceLaw(**beside) if beside else None,
    )


def of_diagnosis(p: dict[str, Any]) -> tuple[float, float | None]:
    found = diagnose(stiffness=GAINS[0], damping=GAINS[1], **p)
    return found.spectral_radius, found.critical_stiffness


def of_map(p: dict[str, Any]) -> tuple[float, float | None]:
    ranges: Any = {name: (gain, 1.1 * gain) for name, gain in zip(("stiffness", "damping"), GAINS)}
    found = run_stability(StabilityParameters(**ranges, grid=2, **p))
    return float(found.spectral_radius[0, 0]), float(found.boundary[0])


def of_design(p: dict[str, Any]) -> tuple[float, float | None]:
    ranges = {name: (p[name],) * 2 for name in ("mass", "inertia", "delay") if p.get(name)}
    needs = WallRequirements(**p | ranges)
    ((_, loop),) = needs.loops(cases := needs.grid(1))
    return float(needs.spectral_radii(cases, *GAINS)[0]), float(boundary_of(loop, np.array([GAINS[1]]))[0])


def of_card(p: dict[str, Any]) -> tuple[float, float | None]:
    own = {name: p[name] for name in ("period", "delay", "mass")}
    scene = Drop(**own, stiffness=GAINS[0], damping=GAINS[1])
    return _target(scene, LoopParameters(**p), *GAINS)[1].spectral_radius, None


FRONTS = of_diagnosis, of_map, of_design, of_card
ELSEWHERE = {(of_card, "rotary"), (of_card, "hand")}
"""A card is along a translation and has a wall for each hand: both are refused."""
SLOW = {(front, effect) for front in (of_diagnosis, of_map) for effect in EFFECTS if effect.startswith("device")}
SLOW |= {(of_diagnosis, "mode"), (of_map, "mode")}
CASES = [case for case in product(FRONTS, EFFECTS) if case not in SLOW]


@pytest.mark.parametrize(("front", "effect"), [*CASES, *further(*sorted(SLOW, key=str))])
def test_every_effect_moves_the_verdict_of_every_front_end_to_that_of_the_loop(
    front: Callable[..., Any], effect: str
) -> None:
    before, after = (NUMBERS | values for values in EFFECTS[effect])
    if (front, effect) in ELSEWHERE:
        with pytest.raises(ParameterError, match=r"(hand|inertia) must be none .*: a card "):
            front(after)
        return
    found = [front(values) for values in (before, after)]
    assert found[0] != found[1]
    for (radius, critical), values in zip(found, (before, after)):
        loop = of_loop(values)
        assert radius == pytest.approx(loop.spectral_radius, rel=1e-6)
        if critical is not None:
            assert critical == pytest.approx(float(boundary_of(loop.array(), np.asarray(GAINS[1]))), rel=1e-6)


class Filtered(Drop):
    """Drop with a velocity filter of the host."""

    def velocity_estimator(self) -> LowPass:
        return LowPass(cutoff=60.0)


@pytest.mark.parametrize("lag", [0.0, 1e-3])
@pytest.mark.parametrize("cls", [Drop, Filtered])
@pytest.mark.parametrize(
    "own", [{}, {"device_damping": 60.0, "device_cutoff": 60.0}, {"wall_on": "device", "device_delay": 5e-4}]
)
def test_the_target_wall_of_a_card_is_the_wall_of_its_scene(
    own: dict[str, Any], cls: type[Drop], lag: float, tmp_path: Path
) -> None:
    scene = cls(device=lagging(lag, tmp_path), stiffness=30_000.0, damping=120.0, pulse=0.0, **own)
    _, target = _target(scene, None, scene.stiffness, scene.damping)
    assert target.spectral_radius == pytest.approx(judge(wall_loops(scene)).spectral_radius, rel=1e-9)


@pytest.mark.parametrize("command", ["diagnose", "stability", "map", "design", "card"])
def test_every_front_end_has_the_same_options(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main([command, "--help"])
    listed = set(re.findall(r"--([a-z-]+)", capsys.readouterr().out))
    assert {name.replace("_", "-") for _, effect in EFFECTS.values() for name in effect} <= listed


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("card --hand arm", "hand must be none (got arm): a card has a wall for each hand"),
        ("card --inertia 1e-3", "inertia must be none (got 0.001): a card is along a translation"),
        ("design --friction 0.1", "friction must be 0 (got 0.1): a design is of the linear loop"),
        ("map --of exact --inertia 1e-3", "a rotary axis cannot be simulated (plant exact)"),
        ("map --of drops --inertia 1e-3 --height 1e-3", "inertia must be none (got 0.001): a drop is along z"),
        ("design --inertia 1e-3 --mass 0.7", "mass and inertia must not both be given"),
    ],
)
def test_an_option_without_an_effect_is_refused_in_one_line(
    line: str, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(line.split()) == 2
    text = capsys.readouterr().err
    assert says in text and text.count("\n") == 1


@pytest.mark.parametrize("command", ["map", "design", "diagnose"])
def test_a_rotary_axis_has_its_units_in_text_and_json(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    own = {"map": "--grid 3", "design": "", "diagnose": "--stiffness 3 --damping 0.03 --rate 500 --delay 1e-3"}
    assert main([command, "--inertia", "0.002", "--cutoff", "100", *own[command].split()]) == 0
    text = capsys.readouterr().out
    assert re.search(r"N m/rad", text) and re.search(r"0\.002 kg m²", text)
    assert not re.search(r"N/m|N s/m|kg(?! m²)", text)


@pytest.mark.parametrize("plant", ["exact", "mujoco"])
@pytest.mark.parametrize("effect", [{"driver_lag": 1e-3}, {"cutoff": 60.0}])
def test_a_simulated_wall_has_driver_lag_and_filter_of_its_map(effect: dict[str, Any], plant: str) -> None:
    p, damping = StabilityParameters(**effect), (75.0, 75.0)
    critical, without = (float(boundary_of(one.loop().array(), np.asarray(75.0))) for one in (p, StabilityParameters()))
    assert critical < 0.85 * without
    found = run_stability(p.replace(stiffness=(0.93 * critical, 1.07 * critical), damping=damping, grid=2, plant=plant))
    assert found.simulated is not None and found.simulated[:, 0].tolist() == [True, False]


def drop(folder: Path, lag: float = 0.0, cls: type[Drop] = Drop, **values: Any) -> Drop:
    own: dict[str, Any] = {"stiffness": 30_000.0, "damping": 120.0, "pulse": 0.0, "duration": 0.03}
    return cls(**{"device": lagging(lag, folder), **own, **values})


SCENES: dict[str, Callable[[Drop], Any]] = {
    "judge": lambda scene: max(loop.spectral_radius for loop in judge(scene).loops if loop.state),
    "diagnose": lambda scene: diagnose(scene).spectral_radius,
    "compare": lambda scene: compare(scene, ["pd"], phases=1).margins["pd"]["spectral_radius"],
    "map of laws": lambda scene: sweep_laws(
        scene, ["pd"], "damping", [scene.damping], figure="critical_stiffness"
    ).columns()["critical_stiffness"][0],
    "wall": lambda scene: judge(wall_loops(scene)).spectral_radius,
    "page": lambda scene: (margin(scene).words, margin(scene).boundary[1].tolist()),
    "preflight": lambda scene: float(_critical_delay(scene, scene.body.inertia)),
    "warning": lambda scene: stability_warning(scene.replace(stiffness=5.0 * scene.stiffness)),
    "card": lambda scene: float(device_card(scene).walls[0].stiffness),
    "map": lambda scene: float(stiffest_of(StabilityParameters(device=scene.device).loop().array()).stiffness),
    "design": lambda scene: (
        design_wall(WallRequirements(device=scene.device, mass=(0.3, 0.3), delay=(8e-4, 8e-4), period=1e-3)).stiffness
    ),
}
SLOW_SCENES = {("diagnose", "device gains"), ("diagnose", "device filter")}
SCENE_EFFECTS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "lag": ({}, {"lag": 1e-3}),
    "device gains": ({}, {"device_damping": 60.0}),
    "device filter": ({"device_damping": 60.0}, {"device_damping": 60.0, "device_cutoff": 60.0}),
    "delay": ({}, {"delay": 1.2e-3}),
    "inertia": ({}, {"mass": 0.4}),
    "damping": ({}, {"damping": 90.0}),
}
NOT_OF_THE_SCENE = {(front, effect) for front in ("map", "design") for effect in SCENE_EFFECTS if effect != "lag"}
NOT_OF_THE_SCENE |= {("preflight", "delay"), ("card", "damping")}
"""Map and design take a device alone; preflight returns a delay; a card has the best damping."""


SCENE_CASES = [case for case in product(SCENES, SCENE_EFFECTS) if case not in SLOW_SCENES]


@pytest.mark.parametrize(("front", "effect"), [*SCENE_CASES, *further(*SLOW_SCENES)])
def test_every_effect_on_a_scene_moves_the_verdict(
    front: str, effect: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("maglev_mj.studies.compare._TICKS", 20)  # in less time
    before, after = (SCENES[front](drop(tmp_path, **values)) for values in SCENE_EFFECTS[effect])
    assert (before == after) == ((front, effect) in NOT_OF_THE_SCENE)


# advice


@pytest.mark.parametrize("seed", [*range(4), *further(*range(4, 40))])
def test_advice_that_is_obeyed_has_the_printed_ratio_and_every_softer_wall_is_stable(seed: int) -> None:
    random = np.random.default_rng(seed)
    values: dict[str, Any] = {"stiffness": 10.0 ** random.uniform(3.0, 5.0), "damping": random.uniform(10.0, 150.0)}
    values |= {"rate": float(random.choice([200.0, 1000.0])), "mass": random.uniform(0.2, 1.5)}
    values |= {"delay": random.uniform(0.0, 1.5) / values["rate"], "driver_lag": float(random.choice([0.0, 3e-4]))}
    values |= {"own_damping": float(random.choice([0.0, 3.0]))}
    found = diagnose(**values)
    for remedy in found.remedies:
        obeyed = found.loop.replace(**remedy.change)
        critical, loop = critical_of(obeyed.whole), obeyed.loop_in_question
        assert critical >= remedy.ratio * obeyed.gains[0] * (1.0 - 1e-9), remedy.words
        for share in (0.05, 0.3, 0.6, 0.9, 0.999):
            assert judge(replace(loop, stiffness=share * critical)).stable, remedy.words


def test_advice_for_a_law_with_memory_is_obeyed() -> None:
    class Own(Drop):
        def laws(self) -> list[Any]:
            notch = Notch(axes="z", stiffness=self.stiffness, damping=self.damping, period=self.period)
            return [notch, hold(self, ALONG_Z)]

    found = diagnose(Own(period=1e-3, delay=8e-4, stiffness=6e4, damping=80.0))
    for remedy in found.remedies:
        obeyed = found.loop.replace(**remedy.change)
        for share in np.linspace(0.05, 0.999, 12):
            radius = float(obeyed.sampled.spectral_radius(share * remedy.critical_stiffness, obeyed.gains[1]))
            assert radius < 1.0, remedy.words


# scaling


def loops(seed: int) -> Loop:
    random = np.random.default_rng(seed)
    period = 10.0 ** random.uniform(-3.3, -2.3)
    mass = 10.0 ** random.uniform(-2.0, 0.3)
    values: dict[str, Any] = {"period": period, "delay": random.uniform(0.0, 3.0) * period, "inertia": mass}
    values |= {"stiffness": random.uniform(0.01, 0.4) * mass / period**2}
    values |= {"damping": random.uniform(0.05, 0.5) * mass / period}
    if seed % 2:
        values |= {"driver_lag": random.uniform(0.0, 0.3) * period, "own_damping": 0.05 * mass / period}
    if seed % 3 == 0:
        values["mode"] = Mode(random.uniform(0.05, 0.3) / period, 0.05, 0.3)
    if seed % 4 == 0:
        values["velocity"] = LowPass(cutoff=0.1 / period)
    return Loop(**values)


@pytest.mark.parametrize("seed", range(12))
def test_a_slower_loop_of_equal_shape_has_the_same_poles(seed: int) -> None:
    loop, slow = loops(seed), 1.7
    times: Any = {name: slow * getattr(loop, name) for name in ("period", "delay", "driver_lag")}
    gains: Any = {"stiffness": loop.stiffness / slow**2, "damping": loop.damping / slow}
    own: Any = {"own_damping": loop.own_damping / slow}
    if loop.mode is not None:
        frequency, damping, participation = (float(np.asarray(value)) for value in loop.mode.values)
        own["mode"] = Mode(frequency / slow, damping, participation)
    if isinstance(loop.velocity, LowPass):
        own["velocity"] = LowPass(cutoff=loop.velocity.cutoff / slow)
    slower = replace(loop, **times, **gains, **own)
    assert slower.spectral_radius == pytest.approx(loop.spectral_radius, abs=1e-9)
    assert judge(slower).critical_stiffness == pytest.approx(judge(loop).critical_stiffness / slow**2, rel=1e-6)
    rotary = replace(loop, axis="rz")
    assert rotary.spectral_radius == loop.spectral_radius


@pytest.mark.parametrize("seed", range(1, 12, 2))
def test_a_law_on_the_device_at_the_hosts_rate_and_delay_adds_its_gains(seed: int) -> None:
    loop = replace(loops(seed), mode=None, velocity=None)
    beside = replace(
        loop,
        stiffness=0.6 * loop.stiffness,
        damping=0.3 * loop.damping,
        device=DeviceLaw(0.4 * loop.stiffness, 0.7 * loop.damping, loop.period, loop.delay),
    )
    assert beside.spectral_radius == pytest.approx(loop.spectral_radius, abs=1e-9)


def test_a_mass_is_that_of_a_hand_in_a_rigid_grip_of_no_stiffness() -> None:
    loop = loops(2)
    hand = get_hand(f"{0.5 * loop.inertia},0,0")
    held = replace(loop, hand=hand)
    assert held.spectral_radius == pytest.approx(replace(loop, inertia=1.5 * loop.inertia).spectral_radius, abs=1e-9)


# load


def test_a_verdict_does_not_depend_on_the_load_of_the_machine(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    scene = drawn(3, tmp_path, declared=False)
    plain = Drop(**scene.independent_values())

    def verdicts() -> list[Any]:
        mapped = sweep_laws(plain, [Undeclared], "damping", [80.0], figure="critical_stiffness")
        walls = judge(wall_loops(scene))
        return [
            walls.spectral_radius,
            walls.critical_stiffness,
            judge(scene).stable,
            *mapped.figure("critical_stiffness"),
        ]

    calm = verdicts()
    for name in ("perf_counter", "monotonic", "thread_time", "process_time", "time"):
        clock = getattr(time, name)
        monkeypatch.setattr(time, name, lambda clock=clock: 100.0 * clock())
    assert verdicts() == calm and math.isfinite(calm[1])
