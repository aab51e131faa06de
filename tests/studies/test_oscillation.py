"""Oscillations of known loops: pole and loop from a recording, and motions that one pole does not fit."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pytest

from maglev_mj import Controller, ExactPlant, Hand, Hold, Sensor, Timing, Wall, diagnose, record_run
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array
from maglev_mj.recording import import_table
from maglev_mj.recording.table import read_log
from maglev_mj.scenes.drop import Drop
from maglev_mj.studies.oscillation import Oscillation, find_oscillation, read_oscillation
from maglev_mj.studies.recorded_loop import _Explained, explain
from maglev_mj.theory.loop import Loop
from tests.studies.test_one_verdict import lagging

Values: TypeAlias = tuple[float, float, float, float, float]
"""Stiffness, damping, period, mass, delay."""

POLES: list[tuple[complex, Values]] = [
    (0.865425 + 0.649640j, (6000.0, 80.0, 0.005, 0.7, 0.005)),
    (0.964189 + 0.213462j, (900.0, 20.0, 0.005, 0.7, 0.012)),
    (1.000499 + 0.057714j, (500.0, 0.1, 0.001, 0.15, 0.001)),
    (0.971427 + 0.538291j, (30.0, 0.5, 1.0 / 60.0, 0.034, 1.0 / 60.0)),
]


def ringing(pole: complex, period: float) -> Oscillation:
    """Return an exact oscillation."""
    rate = np.log(pole) / period
    frequency = rate.imag / (2.0 * math.pi)
    return Oscillation(
        pole, 1.0 / frequency, frequency, rate.real, math.log(2.0) / rate.real, 100, 1e-3, 1.0 / period, 1e-6
    )


def loop_of(stiffness: float, damping: float, period: float, mass: float, delay: float, own: float = 0.0) -> Loop:
    around: Any = {"period": period, "delay": delay, "inertia": mass, "own_damping": own}
    return Loop(stiffness=stiffness, damping=damping, **around)


def pole_of(*values: float) -> complex:
    loop = loop_of(*values)
    poles = np.linalg.eigvals(loop.array().matrix(loop.stiffness, loop.damping))
    return complex(poles[np.argmax(np.abs(poles) * (poles.imag > 1e-3))])


def explained(seen: Oscillation, *values: float, **stated: float) -> _Explained:
    """Return the loop with stated gains and period, and what else is stated."""
    stiffness, damping, period = values
    loop = loop_of(stiffness, damping, period, 1.0, 0.0)
    return explain(seen, replace(loop, **stated), {*stated})  # type: ignore[arg-type]


def loops(seed: int, count: int) -> Iterator[Values]:
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


def measured(loop: Values, *, count: int = 0, seed: int = 0, start: float = 0.0, wall: bool = False,
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
def test_published_poles(pole: complex, loop: Values) -> None:
    exact = pole_of(*loop)
    assert abs(exact - pole) < 1e-6
    found = explained(ringing(exact, loop[2]), *loop[:3]).loop
    assert (found.inertia, found.delay) == pytest.approx(loop[3:], rel=1e-6)
    wave = 0.01 + 1e-3 * (exact ** np.arange(400)).real
    assert abs(find_oscillation(loop[2] * np.arange(400), wave, period=loop[2]).pole - pole) < 1e-6


@pytest.mark.parametrize("part", [0, 1])
def test_inertia_and_delay_of_recordings(part: int) -> None:
    for seed, loop in [*enumerate(loops(20261, 10))][part::2]:
        seen = find_oscillation(*measured(loop, seed=seed), period=loop[2])
        found = explained(seen, *loop[:3])
        assert found.loop.inertia == pytest.approx(loop[3], rel=2e-3)
        assert found.loop.delay == pytest.approx(loop[4], abs=1e-5)
        assert found.assumptions == ("no damping of the device's own",) and "fitted: mass" in found.remarks[0]


@pytest.mark.parametrize("count", [6, pytest.param(30, marks=pytest.mark.study)])
def test_the_wrong_value_is_named(count: int) -> None:
    rng, right = np.random.default_rng(77 + count), 0
    for seed, loop in enumerate(loops(5500 + count, count)):
        seen = find_oscillation(*measured(loop, seed=seed), period=loop[2])
        assert seen.frequency == pytest.approx(np.angle(pole_of(*loop)) / (2.0 * math.pi * loop[2]), rel=0.02)
        stated = dict(zip(("inertia", "delay"), loop[3:]))
        wrong, word = (("inertia", "mass"), ("delay", "delay"))[seed % 2]
        stated[wrong] *= rng.uniform(1.3, 2.0) ** rng.choice([-1.0, 1.0])
        with pytest.raises(ParameterError, match="must be consistent with the oscillation") as refused:
            explained(seen, *loop[:3], **stated, own_damping=0.0)
        right += str(refused.value).startswith(f"{word} must")
    assert right >= 0.9 * count


@pytest.mark.parametrize("own", [0.0, 2.0])
@pytest.mark.parametrize("known", ["inertia", "delay", "both"])
def test_own_damping_follows_from_what_is_stated(known: str, own: float) -> None:
    pole, stated = pole_of(400.0, 3.0, 0.001, 0.15, 0.003, own), {"inertia": 0.15, "delay": 0.003}
    kept = stated if known == "both" else {known: stated[known]}
    loop = explained(ringing(pole, 0.001), 400.0, 3.0, 0.001, **kept).loop
    assert (loop.inertia, loop.delay, loop.own_damping) == pytest.approx((0.15, 0.003, own), rel=1e-4, abs=1e-4)


OTHERS: list[tuple[str, Values, dict[str, Any]]] = [
    (r"friction of about 0\.4 N per kg", (2000.0, 6.0, 0.001, 0.5, 0.001), {"friction": 0.2, "start": 4e-3}),
    ("limit cycle", (6000.0, 80.0, 0.005, 0.7, 0.005), {"limit": 12.0, "start": 2e-3}),
    ("contact is lost", (10000.0, 15.0, 0.001, 0.7, 0.001), {"wall": True, "start": 4.5e-3}),
]


@pytest.mark.parametrize(("reason", "loop", "changes"), OTHERS, ids=["friction", "saturation", "bounces"])
def test_another_motion_is_refused_with_the_reason(reason: str, loop: Values, changes: dict[str, Any]) -> None:
    with pytest.raises(ParameterError, match=reason):
        find_oscillation(*measured(loop, count=1000, **changes), period=loop[2])


def test_a_window_has_one_contact_state_and_no_gap() -> None:
    time = 0.001 * np.arange(1000)
    wave, cut = np.exp(-time) * np.sin(63.0 * time), np.arange(1000) % 250 > 0
    gaps = time + 0.002 * np.cumsum(~cut)
    named = "record without gaps: 2 missing after 0.251 s, 2 missing after 0.503 s, 2 missing after 0.755 s"
    for times, usable, where in ((time, cut, " in one contact state.*got 4"), (gaps, None, f".*got 4.*{named}$")):
        with pytest.raises(ParameterError, match=f"5 half cycles{where}"):
            find_oscillation(times, wave, period=0.001, usable=usable)


@pytest.mark.parametrize("quantum", [0.0, 5e-6])
def test_a_decay_below_the_noise_names_the_noise_floor(quantum: float) -> None:
    time = 0.002 * np.arange(400)
    x = 1e-4 * np.exp(-20.0 * time) * np.cos(63.0 * time) + 2e-6 * np.random.default_rng(1).standard_normal(400)
    x = np.round(x / quantum) * quantum if quantum else x
    with pytest.raises(ParameterError, match=r"noise floor of [1-4]\.?\d?e-06 m"):
        find_oscillation(time, x, period=0.002)


def text_of(separator: str, head: str = "", scale: float = 1.0, skip: int = -1) -> str:
    rows = [f"{0.005 * k:.4f}{separator}{scale * math.sin(k):.6f}" for k in range(50) if k != skip]
    return "\n".join([head, *rows, ""])


def times_of(name: str, scale: float) -> str:
    """Return a table whose times have a unit."""
    return "\n".join([f"{name},angle [mrad]", *(f"{0.005 * k * scale:.3f},{1e3 * math.sin(k):.6f}" for k in range(50))])


@pytest.mark.parametrize(
    "text",
    [
        text_of(",").lstrip(),
        "\ufeff" + text_of(",", "time,position"),
        text_of("\t", "t [s]\tx [mm]", 1e3),
        text_of(";", "time;position_mm", 1e3).replace(".", ","),
        times_of("time [ms]", 1e3),
        times_of("time_us", 1e6),
    ],
    ids=["plain", "mark", "tab", "semicolon", "ms", "us"],
)
def test_text_of_any_program_is_read(tmp_path: Path, text: str) -> None:
    (tmp_path / "run.csv").write_text(text, encoding="utf-8")
    log = read_log(tmp_path / "run.csv", si=True)
    assert (log.axis > 2) is ("mrad" in text)
    assert log.period == pytest.approx(0.005) and log.tick.tolist() == [*range(50)]
    assert log.parts["position"][:, log.axis] == pytest.approx(np.sin(np.arange(50)), abs=1e-6)


def test_a_table_that_is_not_time_and_position_is_refused(tmp_path: Path) -> None:
    texts = {"0,1,2\n1,2,3\n": "columns must be given, such as z=NAME: no pose among 1, 2, 3"}
    texts |= {"time,position\n0,1\n": "at least 16 samples .got 1", "0,1\n1,\n": "at least 16 samples .got 1"}
    texts |= {text_of(",").replace("0.0500", "0.0520"): "its tick at .* in row 12.: resample"}
    for text, message in texts.items():
        (tmp_path / "run.csv").write_text(text)
        with pytest.raises(ParameterError, match=f"run.csv.*{message}"):
            read_oscillation(tmp_path / "run.csv")


LAWS: dict[str, dict[str, Any]] = {
    "wall": {},
    "damper on the device": {"device_damping": 8.0, "device_period": 5e-4},
    "wall on the device": {"wall_on": "device", "device_period": 1e-3, "device_delay": 1e-3},
}


@pytest.mark.parametrize("name", LAWS)
def test_a_recording_states_its_loop(name: str, tmp_path: Path) -> None:
    changes: dict[str, Any] = {"stiffness": 6000.0, "damping": 20.0, "pulse": 0.0, "duration": 1.0}
    scene = Drop(**changes | {"period": 0.001, "delay": 0.001} | LAWS[name])
    record_run(scene, plant="exact").save(tmp_path / "run.maglev")
    seen, stated, *_ = read_oscillation(tmp_path / "run.maglev")
    on, base = ("device_", {"device_damping": 20.0}) if "wall_on" in LAWS[name] else ("", {"damping": 20.0})
    base |= {"mass": 0.7, "delay": 0.001, "period": 0.001, f"{on}stiffness": 6000.0, **LAWS[name]}
    assert {key: stated[key] for key in base if key != "wall_on"} == {
        key: value for key, value in base.items() if key != "wall_on"
    }
    found = diagnose(tmp_path / "run.maglev")
    assert found.measured == seen and "the loop as given explains the oscillation" in found.remarks
    assert found.frequency == pytest.approx(seen.frequency, rel=1e-3)


class Held(Drop):
    """Drop of a flotor that a hand holds."""

    def plant_options(self) -> dict[str, Any]:
        return {**super().plant_options(), "hand": Hand(mass=0.3, damping=2.0, stiffness=60.0)}


def test_the_hand_of_a_recording_is_in_its_loop(tmp_path: Path) -> None:
    scene = Held(stiffness=6000.0, damping=20.0, pulse=0.0, period=0.001, delay=0.001, duration=1.0)
    record_run(scene, plant="exact").save(tmp_path / "run.maglev")
    found = diagnose(tmp_path / "run.maglev")
    assert found.loop.hand == "0.3,2.0,60.0" and found.loop.mass == 0.7
    assert "the loop as given explains the oscillation" in found.remarks


@pytest.mark.parametrize("plant", ["exact", "mujoco", "device"])
@pytest.mark.parametrize("lag", [0.0, 4e-4])
def test_the_driver_lag_of_a_recording_is_in_its_loop(
    plant: str, lag: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    changes: dict[str, Any] = {"stiffness": 4000.0, "damping": 12.0, "pulse": 0.0, "period": 0.001, "delay": 0.001}
    scene = Drop(device=lagging(lag, tmp_path), **changes, duration=0.5)
    record_run(scene, plant="mujoco" if plant == "mujoco" else "exact").save(tmp_path / "run.maglev")
    if plant == "device":  # which is not rebuilt
        monkeypatch.setattr("maglev_mj.studies.oscillation.rebuild_plant", lambda setup: None)
    _, stated, *_ = read_oscillation(tmp_path / "run.maglev")
    assert stated["driver_lag"] == lag
    found = diagnose(tmp_path / "run.maglev")
    assert found.loop.driver_lag == lag and "the loop as given explains the oscillation" in found.remarks
    assert found.spectral_radius == pytest.approx(diagnose(scene, on_axis="z").spectral_radius, abs=1e-9)


def test_a_delay_that_an_import_assumed_is_fitted(tmp_path: Path) -> None:
    loop: Values = (6000.0, 20.0, 0.001, 0.7, 0.002)
    time, position = measured(loop)
    np.savetxt(tmp_path / "run.csv", np.column_stack([time, position]), delimiter=",", header="t,z", comments="")
    columns, units = {"time": "t", "z": "z"}, {"time": "s", "length": "m"}
    for delay, how in ((None, "fitted: delay"), (0.002, "the loop as given")):
        import_table(tmp_path / "run.csv", columns, units, mass=0.7, delay=delay).save(tmp_path / "run.maglev")
        found = diagnose(tmp_path / "run.maglev", stiffness=6000.0, damping=20.0)
        assert found.remarks[-1].startswith(how) and found.loop.delay == pytest.approx(0.002, abs=2e-5)
        assert "the rate of the loop is that of the log, 1000 Hz" in found.assumptions


def test_the_pair_is_the_one_whose_dominant_pole_is_measured() -> None:
    # 0.373 kg with 47 ms has this pole, too, and a slower one that grows.
    values: Values = (7000.0, 70.0, 0.005, 0.62, 0.0033)
    found = explained(ringing(pole_of(*values), 0.005), *values[:3])
    assert (found.loop.inertia, found.loop.delay) == pytest.approx(values[3:], rel=1e-5)
    assert not any("not determined" in text for text in found.remarks)


@pytest.mark.parametrize("share", [0.97, 1.047])
def test_a_loop_with_another_frequency_is_refused(share: float, tmp_path: Path) -> None:
    # A stated mass may be rounded, but not by so much that the loop rings at another frequency.
    loop: Values = (6000.0, 20.0, 0.001, 0.7, 0.001)
    np.savetxt(tmp_path / "run.csv", np.column_stack(measured(loop)), delimiter=",", header="t,z", comments="")
    stated: Any = {"stiffness": 6000.0, "damping": 20.0, "delay": 0.001, "own_damping": 0.0}
    if share < 1.0:
        found = diagnose(tmp_path / "run.csv", **stated, mass=share * 0.7)
        assert found.loop.mass == share * 0.7 and "consistent with what is given" in found.remarks
    else:
        with pytest.raises(ParameterError, match=r"must have the measured frequency, within 2% .got 14\.\d+ Hz"):
            diagnose(tmp_path / "run.csv", **stated, mass=share * 0.7)


def test_an_alias_is_that_of_the_loop_as_stated() -> None:
    # At 1 kHz it rings at 200 Hz, which a log at 250 Hz shows at 50 Hz.
    loop = loop_of(0.7 * (2e3 * math.pi / 5.0) ** 2 * 0.9, 5.0, 0.001, 0.7, 0.0002, 300.0)
    rate = np.log(pole_of(loop.stiffness, 5.0, 0.001, 0.7, 0.0002, 300.0)) / 0.001
    seen = ringing(np.exp(rate * 0.004), 0.004)
    found = explain(seen, loop, {"inertia", "delay", "own_damping"})
    assert found.loop == loop and found.oscillation.frequency == pytest.approx(rate.imag / (2.0 * math.pi))
    assert "which a log at 250 Hz shows at" in found.remarks[0]
