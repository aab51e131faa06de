"""Warnings of motions beyond the device's range: one line, and only then."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

from maglev_mj import AXES, Wall, find_scene
from maglev_mj import sweep as sweep_of
from maglev_mj.frames import Array
from maglev_mj.plants.model import model_path
from maglev_mj.plants.trace import Trace
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.press import Press
from maglev_mj.scenes.results import Variants
from maglev_mj.scenes.run import run, run_phases, run_variants
from maglev_mj.scenes.stick_slip import StickSlip
from maglev_mj.spec import RANGE, Spec
from tests.all_of import SCENES
from tests.sweeps import further, sweep

LINE = re.compile(r"  Warning: motion exceeds the range of (.*?): (.*)")


def remark(text: str) -> str | None:
    """Return a table's remark on range, or None."""
    whole = re.sub(r"\n    (?=\S)", " ", text)  # a line that goes on below
    found = [match for line in whole.splitlines() if (match := LINE.fullmatch(line))]
    assert len(found) <= 1
    return found[0][2] if found else None


def furthest(trace: Trace) -> Array:
    """Return the largest distances on each axis, sampled every 10 µs."""
    pose = trace.at(np.arange(0.0, float(trace.time[-1].min()), 1e-5))[0]
    distance: Array = np.abs(pose).max(axis=0)
    return distance


def outside(traces: Sequence[Trace]) -> list[bool]:
    return [bool((furthest(trace) > RANGE).any()) for trace in traces]


def test_the_furthest_of_a_trace_lies_between_its_knots_too() -> None:
    trace = run(Drop(force_limit=15.0), plant="exact").trace
    np.testing.assert_allclose(trace.furthest(), furthest(trace), atol=1e-8)
    assert trace.furthest()[2] > np.abs(trace.pose[:, 2]).max() + 1e-6
    ball = Trace(np.array([0.0, 0.2]), np.zeros((2, 1)), np.array([[1.0], [-1.0]]), np.zeros((2, 1)))
    assert ball.furthest() == pytest.approx([0.05])  # thrown up at 1 m/s, back after 0.2 s


LIMITS = [8.0, 20.0, 26.0, 27.0, 60.0, None]


@pytest.mark.parametrize(("limit", "gains"), sweep(LIMITS, [(6000.0, 80.0), (3000.0, 40.0), (9000.0, 60.0)], every=6))
def test_a_drop_says_when_it_leaves_the_range(limit: float | None, gains: tuple[float, float]) -> None:
    # By force limit and gains, with the pulse and without, one phase and several.
    drop = Drop(force_limit=limit, stiffness=gains[0], damping=gains[1], duration=0.3)
    variants = [drop.replace(pulse=pulse) for pulse in (220.0, 0.0)]
    labels = ["with pulse", "without pulse"]
    results = {label: run(one, plant="exact") for label, one in zip(labels, variants, strict=True)}
    left = outside([one.trace for one in results.values()])
    said = remark(str(Variants(results).table()))
    assert [label in [part.rsplit(" ", 2)[0] for part in (said or "").split(", ")] for label in labels] == left
    sweeps = {label: run_phases(one, 4, plant="exact") for label, one in zip(labels, variants, strict=True)}
    said = remark(str(Variants(results, sweeps).table())) or ""
    for label, one in zip(labels, variants, strict=True):
        phases = [run(one, plant="exact", phase=phase / 4).trace for phase in range(4)]
        count = sum(outside(phases))
        found = re.search(rf"{label} [0-9.]+ mm \((\d) of 4 phases\)", said)
        assert (int(found[1]) if found else 0) == count


def test_a_drop_from_the_very_end_of_the_range_has_not_left_it() -> None:
    for plant in ("exact", "mujoco"):
        for height, left in ((RANGE[2], False), (RANGE[2] * 1.0001, True)):
            result = run(Drop(height=height, duration=0.05), plant=plant)
            assert (remark(str(Variants({"drop": result}).table())) is not None) == left


@pytest.mark.parametrize("change", [{"force_limit": 5.5}, *further({}, {"height": 0.0046}, {"press": 40.0})])
def test_a_press_says_when_it_leaves_the_range(change: dict[str, float]) -> None:
    results = {
        label: run(Press(hits=1, pulse=pulse, **change), plant="exact")  # type: ignore[arg-type]
        for label, pulse in (("with pulse", 220.0), ("without pulse", 0.0))
    }
    said = remark(str(Variants(results).table()))
    left = outside([one.trace for one in results.values()])
    assert [label in [part.rsplit(" ", 2)[0] for part in (said or "").split(", ")] for label in results] == left


@pytest.mark.parametrize("axis", ["x", "rz"])
def test_stick_slip_says_when_it_leaves_the_range_on_any_axis(axis: str) -> None:
    # Targets around the end of the range, in m and rad.
    reach, kind = RANGE[AXES.index(axis)], []
    for share in (0.9, 1.0, 1.03, 1.15, -0.9, -1.5):
        result = run(StickSlip(axis=axis, target=share * reach), plant="exact")
        said = remark(str(Variants({"stick-slip": result}).table()))
        assert (said is not None) == outside([result.trace])[0]
        kind.append(said is not None)
        if said:
            value, unit = said.split()[-2:]
            most = float(
                np.degrees(furthest(result.trace).max()) if unit == "deg" else furthest(result.trace).max() * 1e3
            )
            assert float(value) == pytest.approx(most, rel=1e-3)
            assert unit == ("mm" if axis in AXES[:3] else "deg")
    assert any(kind) and not all(kind)


@pytest.mark.parametrize(("knot", "told"), [(0, True), (-2, True), (-1, False)])
def test_a_force_beyond_the_devices_is_told_if_it_acted(knot: int, told: bool) -> None:
    ran, most = run(Drop(stiffness=2000.0, pulse=0.0), plant="exact"), Spec.largest_vertical_force.value
    forces = ran.trace.wrench.copy()
    assert np.abs(forces[:, 2]).max() < most
    forces[knot, 2] = -1.5 * most
    text = str(Variants({"drop": replace(ran, trace=replace(ran.trace, wrench=forces))}).table())
    assert (f"Warning: peak force {1.5 * most:.3g} N exceeds the device's {most:g} N limit" in text) is told


@pytest.fixture(scope="module")
def light(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the model of a device of 0.3 kg with half the force, 2 mm of range and the moon's gravity."""
    spec, file = mujoco.MjSpec.from_file(str(model_path("maglev"))), tmp_path_factory.mktemp("light") / "light.xml"
    spec.body("flotor").mass, spec.option.gravity = 0.25, [0.0, 0.0, -1.62]
    for actuator in spec.actuators:
        actuator.gainprm[0] = 1.0
    for joint in spec.body("flotor").joints[:3]:
        joint.range = [-0.002, 0.002]
    file.write_text(spec.to_xml())
    return str(file)


@pytest.mark.parametrize("name", SCENES)
def test_a_scene_is_judged_by_the_device_in_use(name: str, light: str) -> None:
    base: Any = find_scene(name)

    def options(self: Any) -> dict[str, Any]:
        return {**super(type(self), self).plant_options(), "model": light, "mass": None}

    scene = type("Light", (base,), {"plant_options": options})()
    fall = 1.62 if scene.start().gravity is None else 0.0
    assert scene.body.inertia[0] == pytest.approx(0.3) and scene.body.gravity[2] == -fall
    assert scene.body.range[0] == 0.002 and scene.body.force_limit == pytest.approx(30.0)
    for plant in (scene.plant(kind) for kind in scene.plants if kind != "none"):
        assert_allclose([plant.inertia[0], plant.load[2]], [0.3, -0.3 * fall], rtol=1e-9)
        carried = getattr(scene, "weightless", False)
        assert_allclose(plant.before[2] + (carried or name == "wall") * plant.load[2], 0.0, atol=1e-12)
        assert_allclose(scene.controller().carried[2] + carried * plant.load[2], 0.0, atol=1e-12)
    if name == "drop":
        text = " ".join(str(run(scene, plant="exact").table()).split())
        assert "mass 0.3 kg" in text and "device's 30 N" in text and "range of 2 mm" in text
        assert scene.rest == pytest.approx(-0.3 * 1.62 / scene.stiffness)


@pytest.mark.parametrize(("name", "gain"), [("drop", 0.0), ("drop", 50.0), ("press", 0.0), ("press", 50.0)])
def test_variants_are_compared_only_if_the_parameter_decides_on_a_pulse(name: str, gain: float) -> None:
    base: Any = find_scene(name)
    wall = Wall(axes="z", lower=0.0, stiffness=3000.0, damping=20.0, pulse=gain, pulse_width=0.003)
    scene = type("Mine", (base,), {"laws": lambda self: [wall]})()
    assert dict(scene.variants()) == {"mine": scene}
    assert [each.has_pulses for each in base().variants().values()] == [True] * (1 + (name == "drop")) + [False]


def test_a_chaotic_bounce_says_that_single_figures_are_not_reproducible() -> None:
    chaotic = Drop(period=1.0 / 1300.0, stiffness=18000.0, damping=0.0, pulse=900.0, duration=0.75)
    for scene, told in ((chaotic, True), (Drop(), False)):
        for result in (run_variants({"with pulse": scene}, plant="exact"), sweep_of(scene, {"pulse_width": [0.003]})):
            assert ("chaotic, single figures are not reproducible" in str(result.table())) == told
