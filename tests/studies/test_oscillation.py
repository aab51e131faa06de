"""Oscillations of known loops: pole, inertia and delay from a recording, and motions that one pole does not fit."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pytest

from maglev_mj import Controller, ExactPlant, Hold, Recording, Sensor, Timing, Wall, record_run
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array
from maglev_mj.scenes.drop import Drop
from maglev_mj.studies.oscillation import Oscillation, find_oscillation, matched, read_motion, recorded_motion
from maglev_mj.theory.closed_loop import SampledLoop

Loop: TypeAlias = tuple[float, float, float, float, float]
"""Stiffness, damping, period, mass, delay."""

POLES: list[tuple[complex, Loop]] = [
    (0.865425 + 0.649640j, (6000.0, 80.0, 0.005, 0.7, 0.005)),
    (0.964189 + 0.213462j, (900.0, 20.0, 0.005, 0.7, 0.012)),
    (1.000499 + 0.057714j, (500.0, 0.1, 0.001, 0.15, 0.001)),
    (0.971427 + 0.538291j, (30.0, 0.5, 1.0 / 60.0, 0.034, 1.0 / 60.0)),
]


def ringing(pole: complex) -> Oscillation:
    return Oscillation(pole, 1.0, 1.0, 1.0, 1.0, 100, 1e-3)


def pole_of(stiffness: float, damping: float, period: float, mass: float, delay: float, own: float = 0.0) -> complex:
    hand = f"0,{own},0"
    loop = SampledLoop(period=period, delay=delay, mass=mass, hand=hand if own else None)
    poles = np.linalg.eigvals(loop.matrix(stiffness, damping))
    return complex(poles[np.argmax(np.abs(poles) * (poles.imag > 1e-3))])


def loops(seed: int, count: int) -> Iterator[Loop]:
    """Yield random loops whose amplitude changes by 3 to 49 % a cycle."""
    rng = np.random.default_rng(seed)
    while count:
        mass, period = rng.uniform(0.1, 1.0), float(rng.choice([0.001, 0.002, 0.005]))
        turn, delay = rng.uniform(0.08, 0.4), rng.uniform(0.2, 3.0) * period
        stiffness = mass * (turn / period) ** 2
        loop = stiffness, rng.uniform(0.0, 0.6) * math.sqrt(mass * stiffness), period, mass, delay
        pole = pole_of(*loop)
        if 0.03 < abs(math.log(abs(pole))) * 2.0 * math.pi / np.angle(pole) < 0.4:
            count -= 1
            yield loop


def measured(loop: Loop, *, count: int = 0, seed: int = 0, start: float = 0.0, wall: bool = False,
             limit: float = math.inf, friction: float = 0.0) -> tuple[Array, Array]:  # fmt: skip
    """Return times and positions over a sensor of 5 µm and 2 µm noise, about the rest under the weight."""
    (stiffness, damping, period, mass, delay), pole = loop, pole_of(*loop)
    count = count or min(600, int(12 * 2.0 * math.pi / np.angle(pole)))
    start = start or 3e-3 * min(1.0, abs(pole) ** -count)
    gains: Any = {"axes": "z", "stiffness": stiffness, "damping": damping}
    controller = Controller([Wall(lower=0.0, **gains) if wall else Hold(**gains)], period=period)
    acting: Any = {"wrench": [0, 0, 9.81 * mass, 0, 0, 0], "wrench_limit": limit}
    acting |= {"dry_friction": [0, 0, friction, 0, 0, 0], "sensor": Sensor(quantum=5e-6, noise=2e-6, seed=seed)}
    pose = [0, 0, start - 9.81 * mass / stiffness, 0, 0, 0]
    rows = []
    with ExactPlant(Timing(period=period, delay=delay), mass=mass, pose=pose, **acting) as plant:
        for _ in range(count):
            sample = plant.read()
            rows.append((sample.time, sample.position[2]))
            plant.write(controller.step(sample))
    return np.array(rows)[:, 0], np.array(rows)[:, 1]


@pytest.mark.parametrize(("pole", "loop"), POLES)
def test_published_poles(pole: complex, loop: Loop) -> None:
    exact = pole_of(*loop)
    assert abs(exact - pole) < 1e-6
    assert matched(ringing(exact), *loop[:3])[0][:2] == pytest.approx(loop[3:], rel=1e-6)
    wave = 0.01 + 1e-3 * (exact ** np.arange(400)).real
    assert abs(find_oscillation(loop[2] * np.arange(400), wave, period=loop[2]).pole - pole) < 1e-6


def test_inertia_and_delay_of_recordings() -> None:
    for seed, loop in enumerate(loops(20261, 10)):
        seen = find_oscillation(*measured(loop, seed=seed), period=loop[2])
        (match,) = matched(seen, *loop[:3])
        assert match.mass == pytest.approx(loop[3], rel=2e-3) and match.delay == pytest.approx(loop[4], abs=1e-5)


@pytest.mark.parametrize("count", [6, pytest.param(30, marks=pytest.mark.study)])
def test_the_wrong_value_is_named(count: int) -> None:
    rng, right = np.random.default_rng(77 + count), 0
    for seed, loop in enumerate(loops(5500 + count, count)):
        seen = find_oscillation(*measured(loop, seed=seed), period=loop[2])
        assert seen.frequency == pytest.approx(np.angle(pole_of(*loop)) / (2.0 * math.pi * loop[2]), rel=0.02)
        stated: Any = dict(zip(("mass", "delay"), loop[3:]))
        wrong = ("mass", "delay")[seed % 2]
        stated[wrong] *= rng.uniform(1.3, 2.0) ** rng.choice([-1.0, 1.0])
        right += matched(seen, *loop[:3], **stated)[0].text.startswith(wrong)
    assert right >= 0.9 * count


@pytest.mark.parametrize("own", [0.0, 2.0])
def test_a_known_mass_gives_delay_and_own_damping(own: float) -> None:
    pole = pole_of(400.0, 3.0, 0.001, 0.15, 0.003, own)
    matches = matched(ringing(pole), 400.0, 3.0, 0.001, mass=0.15)
    assert any(match[:3] == pytest.approx((0.15, 0.003, own), rel=1e-6, abs=1e-6) for match in matches)


OTHERS: list[tuple[str, Loop, dict[str, Any]]] = [
    (r"friction of about 0\.4 N per kg", (2000.0, 6.0, 0.001, 0.5, 0.001), {"friction": 0.2, "start": 4e-3}),
    ("limit cycle", (6000.0, 80.0, 0.005, 0.7, 0.005), {"limit": 12.0, "start": 2e-3}),
    ("contact is lost", (10000.0, 15.0, 0.001, 0.7, 0.001), {"wall": True, "start": 4.5e-3}),
]


@pytest.mark.parametrize(("reason", "loop", "changes"), OTHERS, ids=["friction", "saturation", "bounces"])
def test_another_motion_is_refused_with_the_reason(reason: str, loop: Loop, changes: dict[str, Any]) -> None:
    with pytest.raises(ParameterError, match=reason):
        find_oscillation(*measured(loop, count=1000, **changes), period=loop[2])


def test_a_window_has_one_contact_state_and_no_gap() -> None:
    time = 0.001 * np.arange(1000)
    wave, cut = np.exp(-time) * np.sin(63.0 * time), np.arange(1000) % 250 > 0
    for times, usable, where in ((time, cut, " in one contact state.*"), (time + 0.002 * np.cumsum(~cut), None, " ")):
        with pytest.raises(ParameterError, match=f"5 half cycles{where}.got 4"):
            find_oscillation(times, wave, period=0.001, usable=usable)


def text_of(separator: str, head: str = "", scale: float = 1.0, skip: int = -1) -> str:
    rows = [f"{0.005 * k:.4f}{separator}{scale * math.sin(k):.6f}" for k in range(50) if k != skip]
    return "\n".join([head, *rows, ""])


@pytest.mark.parametrize(
    "text",
    [
        text_of(",").lstrip(),
        "\ufeff" + text_of(",", "time,position"),
        text_of("\t", "t [s]\tx [mm]", 1e3),
        text_of(";", "time;position_mm", 1e3).replace(".", ","),
    ],
    ids=["plain", "mark", "tab", "semicolon"],
)
def test_text_of_any_program_is_read(tmp_path: Path, text: str) -> None:
    (tmp_path / "run.csv").write_text(text, encoding="utf-8")
    time, position, period = read_motion(tmp_path / "run.csv")
    assert period == pytest.approx(0.005) and time == pytest.approx(0.005 * np.arange(50))
    assert position == pytest.approx(np.sin(np.arange(50)), abs=1e-6)


def test_a_table_that_is_not_time_and_position_is_refused(tmp_path: Path) -> None:
    texts = {"0,1,2\n1,2,3\n": "got 3 columns, 2 rows.; others: maglev-mj import", "time,position\n0,1\n": "at least 2"}
    texts |= {text_of(",").replace("0.0500", "0.0520"): "its tick at .* in row 12.: resample", "0,1\n1,\n": "finite"}
    for text, message in texts.items():
        (tmp_path / "run.csv").write_text(text)
        with pytest.raises(ParameterError, match=f"run.csv.*{message}"):
            read_motion(tmp_path / "run.csv")


def test_a_recording_states_its_wall(tmp_path: Path) -> None:
    scene = Drop(stiffness=6000.0, damping=20.0, pulse=0.0, period=0.001, delay=0.001, duration=1.0)
    record_run(scene, plant="exact").save(tmp_path / "run.maglev")
    motion = recorded_motion(Recording.load(tmp_path / "run.maglev"))
    assert (motion.axis, motion.stiffness, motion.damping, motion.delay, motion.mass) == ("z", 6000.0, 20.0, 0.001, 0.7)
    seen = find_oscillation(motion.time, motion.position, period=motion.period, usable=motion.usable)
    assert matched(seen, 6000.0, 20.0, 0.001)[0][:2] == pytest.approx((0.7, 0.001), rel=1e-3)
