"""Identification from recordings: intervals hold the truth, or are withheld."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from identified_recordings import draw, estimates, holds, record, truth
from maglev_mj import ExactPlant, Hold, Timing, Wall
from maglev_mj.analysis import Estimate, Identification, identification, identify
from maglev_mj.analysis.fit import Forces, estimate_quantum, solve, student
from maglev_mj.analysis.identification import _Row
from maglev_mj.cli import main
from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import ControlLoop
from maglev_mj.frames import Array
from maglev_mj.plants.sensor import Sensor
from maglev_mj.recording import MemoryFile, Segment
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.press import Press
from maglev_mj.scenes.scene import Scene
from maglev_mj.scenes.stick_slip import Pull
from maglev_mj.session.replay import record_run, stick_positions_of
from maglev_mj.theory import largest_stable_stiffness
from tests.sweeps import further

EXACT = {"wall stiffness, commanded", "wall damping, commanded", "stick stiffness, commanded"} | {
    *("quantum", "sliding friction", "sliding damping")
}
"""Found to rounding."""


@cache
def recorded(scene: Scene, phase: float = 0.0) -> Segment:
    (segment,) = record_run(scene, plant="exact", phase=phase).segments
    return segment


def found_in(scene: Scene, phase: float = 0.0) -> Identification:
    segment = recorded(scene, phase)
    return identify(segment, anchors=stick_positions_of(segment))


def coverage(seeds: range) -> dict[str, list[bool]]:
    """Return by name if each interval holds the truth."""
    kept: dict[str, list[bool]] = {}
    for seed in seeds:
        case = draw(seed)
        segment, anchors = record(case)
        true = truth(case)
        for name, one in estimates(identify(segment, anchors=anchors)).items():
            if one.known:
                kept.setdefault(name, []).append(holds(one, true[name]))
    return kept


def test_intervals_hold_the_truth_in_three_recordings() -> None:
    # Of 95 % intervals of some 30 estimates at least 80 %: three standard deviations below the mean.
    kept = coverage(range(2_000_000, 2_000_003))
    assert all(all(kept[name]) for name in EXACT)
    held = [hit for name, hits in kept.items() if name not in EXACT for hit in hits]
    assert len(held) > 25 and np.mean(held) >= 0.8


@pytest.mark.study
def test_intervals_of_each_quantity_hold_the_truth_in_90_to_99_percent_of_200_recordings() -> None:
    kept = coverage(range(5_000_000, 5_000_200))
    assert all(all(kept[name]) for name in EXACT)
    assert {
        name: np.mean(ones) for name, ones in kept.items() if name not in EXACT and not 0.90 <= np.mean(ones) <= 0.99
    } == {}


@pytest.mark.parametrize("stiffness", [6000.0, *further(1500.0, 9000.0)])
def test_one_press_at_200_hz_over_5_micrometres_tells_stiffness_within_2_percent(stiffness: float) -> None:
    press = Press(hits=1, quantize=5e-6, stiffness=stiffness)
    for phase in np.arange(4) / 4 + 0.03:
        (wall,) = found_in(press, float(phase)).walls
        assert wall.stiffness.value == pytest.approx(stiffness, rel=0.02)
        assert wall.stiffness.standard_error < 0.01 * stiffness
        assert wall.commanded_stiffness.value == pytest.approx(stiffness, rel=1e-9)


@pytest.mark.parametrize(
    ("scene", "near"),
    [
        (Drop(), 1e-9),
        (Drop(delay=0.004, stiffness=3000.0), 1e-9),
        (Drop(delay=0.007, stiffness=1000.0), 1e-9),
        (Press(), 1e-4),
    ],
)
def test_an_ideal_sensor_tells_the_truth_to_rounding_or_as_well_as_an_arm_is_known(
    scene: Drop | Press, near: float
) -> None:
    found = found_in(scene, 0.3)
    (wall,), inertia = found.walls, recorded(scene, 0.3).metadata.inertia[2]
    share = scene.stiffness / float(largest_stable_stiffness(scene.damping, delay=scene.delay, mass=inertia))
    told = found.axes["z"].inertia, found.delay, wall.stiffness, wall.damping, wall.share
    for one, true in zip(told, (inertia, scene.delay, scene.stiffness, scene.damping, share), strict=True):
        assert one.value == pytest.approx(true, rel=near)
        assert holds(one, true)


@pytest.mark.parametrize("spring", [0.0, 1500.0])
def test_a_walls_share_is_that_of_all_springs_and_dampers_on_its_axis(spring: float) -> None:
    class Suspended(Drop):
        def laws(self) -> list[Any]:
            damping = 20.0 if spring else 0.0
            return [*super().laws(), Hold(axes="z", stiffness=spring, damping=damping)]

    segment = recorded(scene := Suspended(stiffness=4000.0, pulse=0.0), 0.3)
    (wall,), mass = found_in(scene, 0.3).walls, segment.metadata.inertia[2]
    damping = scene.damping + (20.0 if spring else 0.0)
    true = (4000.0 + spring) / float(largest_stable_stiffness(damping, delay=scene.delay, mass=mass))
    assert wall.stiffness.value == pytest.approx(4000.0, rel=1e-9)
    assert wall.share.value == pytest.approx(true, rel=1e-9) and holds(wall.share, true)


def test_a_delay_and_a_mass_other_than_stated_are_found() -> None:
    segment = recorded(Drop(quantize=5e-6), 0.3)
    known = segment.metadata
    for late in (0.0, 0.0005, 0.004, 0.02):
        stated = replace(known, delay=late, inertia=1.2 * known.inertia)
        found = identify(segment, stated)
        assert holds(found.delay, known.delay)
        assert holds(found.axes["z"].inertia, known.inertia[2])
        # in the newtons of the mass that is stated
        assert holds(found.walls[0].stiffness, 1.2 * 6000.0)
        assert found.walls[0].commanded_stiffness.value == pytest.approx(6000.0)
        assert found.walls[0].share.value == pytest.approx(0.5937, rel=0.01)


def test_the_lag_of_drivers_counts_as_delay() -> None:
    options: dict[str, Any] = {"driver_lag": True, "driver_time_constant": 3e-4, "sensor": Sensor(noise=1e-6)}
    plant = ExactPlant(Timing(phase=0.3), pose=(0.0, 0.0, 0.004, 0.0, 0.0, 0.0), **options)
    controller = Controller([Wall(axes="z", lower=0.0, stiffness=6000.0, damping=80.0)], period=plant.period)
    file = MemoryFile()
    with plant:
        ControlLoop(plant, controller, record=file.begin(plant, controller)).cycle(80)
    (segment,) = file.recording.segments
    assert identify(segment).delay.value == pytest.approx(0.0018, abs=1e-5)


@pytest.mark.parametrize("law", ["stick-slip", "spring-reset", "dahl", "kikuuwe"])
def test_friction_is_found(law: str) -> None:
    scene = Pull(law=law, duration=1.0, target=0.02, spring=200.0, damping=10.0)
    (one,) = found_in(scene).friction.values()
    assert holds(one.commanded_stiffness, 6000.0)
    if law != "spring-reset":
        assert one.breakaway.value == pytest.approx(2.0, abs=0.7)
    sliding = 0.0 if law in ("stick-slip", "spring-reset") else 2.0
    assert one.sliding.value == pytest.approx(sliding, abs=0.05)


CASE = replace(draw(3), rate=400.0, arm=False, height=0.004, noise=1e-6, quantum=0.0)


@cache
def sample_case(**changes: Any) -> tuple[Segment, Array]:
    return record(replace(CASE, **changes))


def test_what_a_recording_does_not_tell_is_said_with_its_reason() -> None:
    def why(one: Estimate) -> str:
        assert np.isnan([one.value, one.standard_error]).all()
        return one.why

    segment, anchors = sample_case()
    whole = identify(segment, anchors=anchors)
    assert all(one.known for name, one in estimates(whole).items() if name != "quantum")

    fall, _ = sample_case(rate=1000.0)
    early = fall[: int(np.argmax(fall.position[:, 2] < 2e-4))]
    free = identify(early)
    assert {why(one) for one in vars(free.walls[0]).values() if isinstance(one, Estimate)} == {"no contact"}
    assert not free.friction  # where nobody says where it stuck
    assert why(free.axes["z"].inertia) == "force variation below the noise"  # no motion under forces
    assert holds(free.axes["z"].noise, 1e-6)

    still = segment.position.copy()
    still[:, 0] = 0.0
    stuck = identify(segment.replace(position=still), anchors=anchors)
    assert "x" not in stuck.axes and why(stuck.friction["x"].breakaway) == "no motion on this axis"
    assert why(identify(segment[:9]).walls[0].stiffness) == "only 9 samples"

    hand = segment.hand.copy()
    hand[:, 0] = 0.0
    alone = identify(segment.replace(hand=hand), anchors=anchors)
    assert why(alone.axes["x"].inertia) == why(alone.axes["x"].noise) == "unrecorded forces"
    assert why(alone.friction["x"].stiffness) == "unrecorded forces"
    assert alone.friction["x"].commanded_stiffness.known

    gaps = segment[np.arange(len(segment)) % 3 > 0]
    assert why(identify(gaps).walls[0].stiffness) == "too few consecutive samples"

    short = recorded(Drop(height=2e-4, quantize=5e-6), 0.3)[:12]
    assert why(identify(short).walls[0].stiffness) == "too few samples for the laws on this axis"

    first = int(np.argmax(np.isnan(anchors[:, 0])))
    held = identify(segment[:first], anchors=anchors[:first])
    assert why(held.friction["x"].commanded_stiffness) == "confounded with other laws on this axis"
    random = np.random.default_rng(1).normal(size=segment.command.shape)
    other = identify(segment.replace(command=segment.command + random), anchors=anchors).walls[0]
    assert "commands do not fit a spring and a damper" in why(other.commanded_stiffness)
    assert why(other.stiffness) == why(other.commanded_stiffness)


def test_a_sensor_without_noise_or_without_steps_is_seen_to_be_one() -> None:
    ideal, steps = (found_in(Drop(quantize=quantum)).axes["z"] for quantum in (0.0, 5e-6))
    assert ideal.noise.why == "residual at rounding level"
    assert ideal.quantum.why == "positions are not quantized"
    assert steps.noise.why.startswith("below the sensor") and steps.noise.high < 1.5e-6
    assert steps.quantum.value == pytest.approx(5e-6, rel=1e-12)
    assert "only 1 distinct positions" in estimate_quantum(np.full(9, 1e-3)).why
    lattice = 3e-7 * np.array([0.0, 14.0, 35.0, 56.0, 63.0, 105.0, 1_000_005.0])  # no two a step apart
    assert estimate_quantum(lattice).value == pytest.approx(3e-7, rel=1e-9)
    segment, anchors = record(case := draw(20))  # at rest within a step
    assert case.noise == 0.0 < case.quantum
    assert identify(segment, anchors=anchors).axes["z"].noise.why == "below the sensor resolution"


def test_samples_behind_a_gap_are_left_out_until_every_command_is_known() -> None:
    segment, anchors = sample_case()
    kept = np.ones(len(segment), dtype=bool)
    kept[60:63] = kept[200:201] = False
    found = identify(segment[kept], anchors=anchors[kept])
    assert found.of == len(segment) - 4 and found.samples == found.of - 2 * 2
    for name, one in estimates(found).items():
        if name != "quantum":
            assert abs(one.value - truth(CASE)[name]) <= 3.5 * one.standard_error + 1e-9 * abs(one.value)


def test_a_long_recording_is_told_by_the_part_that_moves_least_straight(monkeypatch: pytest.MonkeyPatch) -> None:
    segment, anchors = sample_case()
    monkeypatch.setattr(identification, "_MOST_SAMPLES", 160)
    found = identify(segment, anchors=anchors)
    assert found.samples <= 160 < found.of
    assert holds(found.walls[0].stiffness, truth(CASE)["wall stiffness, rendered"])
    assert f"based on {found.samples} of {found.of} samples" in found.table().note.splitlines()[-1]


def test_a_rotation_is_told_where_nothing_else_acts_on_it() -> None:
    alone = recorded(Pull(axis="ry"))
    found = identify(alone, anchors=stick_positions_of(alone))
    assert holds(found.axes["ry"].inertia, alone.metadata.inertia[4])
    turned = alone.position.copy()
    turned[:, 5] = turned[:, 4]
    assert identify(alone.replace(position=turned)).axes["ry"].inertia.why == "coupled to other axes"


def test_the_table_and_the_json_say_every_estimate(tmp_path: Path, capsys: Any) -> None:
    path = tmp_path / "run.maglev"
    record_run(Drop(quantize=5e-6), plant="exact").save(path)
    assert main(["analyse", str(path), "--json", str(tmp_path / "run.json")]) == 0
    said = capsys.readouterr().out
    assert max(map(len, said.splitlines())) <= 80
    for words in (
        "z below 0 mm\n    stiffness ",
        " of critical stiffness ",
        " effective delay ",
        " z\n    mass ",
        "below the sensor resolution",
    ):
        assert words in said
    (segment,) = json.loads((tmp_path / "run.json").read_text())["segments"]
    identified: Mapping[str, Any] = segment["identified"]
    (wall,) = identified["walls"]
    assert wall["stiffness"]["value"] == pytest.approx(6000.0, rel=0.01)
    assert set(wall["stiffness"]) == {"value", "standard_error", "low", "high", "residual", "why"}
    assert identified["axes"]["z"]["noise"]["value"] is None
    assert identified["axes"]["z"]["noise"]["why"].startswith("below")


def test_intervals_are_those_of_student_and_singular_columns_are_not_told() -> None:
    for degrees, point in ((6, 2.447), (10, 2.228), (30, 2.042), (1000, 1.962)):
        assert student(degrees) == pytest.approx(point, abs=2e-3)
    columns = np.column_stack([np.arange(5.0), 2.0 * np.arange(5.0), np.ones(5), np.zeros(5)])
    solution = solve(columns, np.arange(5.0) + 3.0)
    assert solution.separate.tolist() == [False, False, True, False]
    assert solution.values[2] == pytest.approx(3.0)
    assert solution.residuals == pytest.approx(np.zeros(5), abs=1e-12)
    kept = columns[:, [0, 2]]
    assert solution.gram[2, 2] == pytest.approx(np.linalg.inv(kept.T @ kept)[1, 1])


@pytest.mark.parametrize("delay", [0.0, 1e-3, 2e-3])
def test_a_force_that_switches_at_a_sample_is_counted_once(delay: float) -> None:
    levels = np.append(1.0, np.random.default_rng(1).normal(size=12))[:, None]
    time = np.linspace(0.0, 0.011, 12)
    forces = Forces(time=time, switch=time, levels=levels, prompt=np.zeros((11, 2, 1)))
    at = forces.integrals(delay)[..., 0]
    for near in (1e-12, -1e-12):
        assert forces.integrals(delay + near)[..., 0] == pytest.approx(at, abs=1e-11)


def test_a_stop_that_nobody_recorded_does_not_pass_for_a_weight() -> None:
    (segment,) = record_run("let-go", plant="mujoco").segments  # falls on the stop with the currents off
    one = identify(segment).axes["z"].force_error
    assert not one.known or holds(one, 0.0)


def test_what_lies_outside_the_tested_ranges_is_named() -> None:
    assert found_in(Drop(), 0.3).outside == []
    stiff = found_in(Drop(stiffness=9000.0), 0.3)
    assert stiff.outside == ["z below 0 mm at 89% of critical"] and stiff.as_json()["outside"] == stiff.outside
    assert "error estimates not validated for" in stiff.table().note
    soft = found_in(Drop(stiffness=800.0, quantize=2e-5), 0.3)
    assert soft.outside == ["z below 0 mm at 8% of critical", "noise or resolution above 5 µm on z"]


@pytest.mark.parametrize(
    ("error", "text"),
    [(123.4, ("1235", "123")), (12.3, ("1235", "12")), (0.0123, ("1234.568", "0.012")), (1e-9, ("1234.5678", "1e-09"))],
)
def test_a_value_is_rounded_to_the_second_digit_of_its_error(error: float, text: tuple[str, str]) -> None:
    assert _Row("", "z", "", Estimate(value=1234.5678, standard_error=error), "N").cells()[1:3] == text
