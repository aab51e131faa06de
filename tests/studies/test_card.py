"""The device card: each number beside a simulation of its own, or a closed form."""

from __future__ import annotations

import json
import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj import Command, Controller, ExactPlant, Hold, Sample, Timing, cli, device_card, drive
from maglev_mj.device import Device
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Six
from maglev_mj.plants.hand import HANDS, get_hand
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.scene import Scene
from maglev_mj.spec import Spec
from maglev_mj.studies.card import DeviceCard, DeviceFigures
from maglev_mj.studies.stability_map import StabilityParameters, run_stability
from tests.sweeps import further

RATES = {200: Drop(), 1000: Drop(period=1e-3, delay=5e-4, pulse=0.0)}
EACH = [200, *further(1000)]


pytestmark = pytest.mark.xdist_group("card")  # one worker computes the two cards


@cache
def card(rate: int) -> DeviceCard:
    return device_card(RATES[rate])


@pytest.fixture(scope="module", autouse=True)
def first_card() -> None:
    """Compute the card of the gate before the first test."""
    card(200)


@pytest.mark.parametrize("rate", EACH)
def test_a_sine_hand_meets_the_impedance_of_theory(rate: int) -> None:
    found = card(rate)
    frequency, wanted, rendered, flown = found.impedance
    assert flown == pytest.approx(rendered, rel=1e-7)
    assert rendered[0] == pytest.approx(wanted[0], rel=0.03)  # a slow hand meets the wanted wall
    ratio = rendered / wanted
    last = np.flatnonzero(frequency <= found.transparent)[-1]
    assert (np.abs(20.0 * np.log10(ratio[: last + 1])) < 3.0103).all()
    assert abs(20.0 * math.log10(ratio[last + 1])) > 3.01
    assert found.transparent == pytest.approx({200: 11.21, 1000: 34.05}[rate], abs=0.01)


@pytest.mark.parametrize("rate", EACH)
def test_walls_grow_beyond_the_z_width_and_settle_below(rate: int) -> None:
    found, scene = card(rate), RATES[rate]
    for wall, hand in zip(found.walls[:2], found.hands):
        k, b = float(wall.stiffness), float(wall.damping)
        timing: dict[str, Any] = {"period": scene.period, "delay": scene.delay, "hand": hand}
        walls = StabilityParameters(stiffness=(0.98 * k, 1.02 * k), damping=(b, b), plant="exact", grid=2, **timing)
        settles = run_stability(walls).simulated
        assert settles is not None and settles[:, 0].tolist() == [True, False]


class Coupled:
    """Virtual mass behind a spring and a damper, computed step by step."""

    def __init__(self, mass: float, scene: Drop) -> None:
        self.mass, self.scene, self.state = mass, scene, (0.0, 0.0, 0.0)
        self.period = scene.period
        self.stretch: list[float] = []

    def reset(self) -> None:
        self.state = (0.0, 0.0, 0.0)

    def step(self, sample: Sample) -> Any:
        (last, place, speed), x, period = self.state, float(sample.position[0]), self.period
        force = self.scene.stiffness * (place - x) + self.scene.damping * (speed - (x - last) / period)
        speed -= force / self.mass * period
        self.state = x, place + speed * period, speed
        self.stretch.append(abs(self.state[1] - x))
        return Command([force, 0.0, 0.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("rate", EACH)
def test_lighter_virtual_masses_shake(rate: int) -> None:
    found, scene = card(rate), RATES[rate]
    for (least, most), hand in zip(found.masses[:2], found.hands):
        assert math.isinf(most)
        for share, shakes in ((0.97, True), (1.03, False)):
            law = Coupled(share * least, scene)
            timing = Timing(period=scene.period, delay=scene.delay)
            start: Six = [1e-9, 0.0, 0.0, 0.0, 0.0, 0.0]
            with ExactPlant(timing, mass=scene.mass, pose=start, gravity=0.0, hand=get_hand(hand)) as plant:
                drive(plant, law, 100)
            assert bool(max(law.stretch[90:]) > max(law.stretch[40:50])) is shakes


@pytest.mark.parametrize("rate", EACH)
def test_the_force_bandwidth_is_that_of_a_held_sine_through_the_drivers(rate: int) -> None:
    period, frequency, fine = 1.0 / rate, card(rate).force_bandwidth, 400
    samples, step = 800, 1.0 / rate / fine
    command = np.repeat(np.sin(2.0 * np.pi * frequency * period * np.arange(samples)), fine)
    gain = 1.0 - math.exp(-2.0 * np.pi * Spec.driver_bandwidth.value * step)
    force, value = np.empty(command.size), 0.0
    for index, one in enumerate(command.tolist()):
        value += gain * (one - value)
        force[index] = value
    window = np.hanning(force.size)
    turn = np.exp(-2j * np.pi * frequency * step * np.arange(force.size))
    size = 2.0 * abs((window * force * turn).sum()) / window.sum()
    assert size == pytest.approx(math.sqrt(0.5), rel=3e-3)


@pytest.mark.parametrize("rate", EACH)
def test_one_step_of_the_sensor_is_the_force_resolution(rate: int) -> None:
    scene = RATES[rate]
    law = Controller([Hold(axes="x", stiffness=scene.stiffness, damping=scene.damping)], period=scene.period)
    law.step(Sample(0, 0.0, [0.0] * 6))
    force = law.step(Sample(1, scene.period, [Spec.translation_resolution.value, *[0.0] * 5])).force
    assert card(rate).force_resolution == pytest.approx(-force[0])


@pytest.fixture
def one_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make cards of one hand."""
    monkeypatch.setattr("maglev_mj.studies.card.HANDS", dict([*HANDS.items()][:1]))


def test_the_command_takes_scenes_and_devices(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found: list[Any] = []

    def keep(scene: Scene, _: Any) -> None:
        found.append(scene)
        raise ParameterError("scene must be kept")

    monkeypatch.setattr("maglev_mj.cli.studies.device_card", keep)
    heavy = tmp_path / "heavy.toml"
    heavy.write_text(Device.load("ubc").change("body", mass=1.4).toml())
    for words in (f"drop --device {heavy}", str(heavy)):
        assert cli.main(["card", *words.split(), "--json", "-"]) == 2
    assert len(found) == 2 and found[0] == found[1]


@pytest.mark.usefixtures("one_hand")
def test_an_unstable_wall_has_a_card_without_what_it_cannot_render(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data, wall = tmp_path / "card.json", ["--stiffness", "30000", "--delay", "0.0015"]
    assert cli.main(["card", "drop", *wall, "--out", str(tmp_path), "--json", str(data)]) == 0
    said = capsys.readouterr().out
    assert (tmp_path / "card.png").exists() and max(map(len, said.splitlines()[:-2])) <= 80
    card = json.loads(data.read_text())
    assert set(card["impedance"][3]) == {None} and card["masses"][0] == [None, None]


@pytest.mark.parametrize(
    ("device", "section", "change", "warning"),
    [
        ("stage", "body", {"mass": 420.0}, "weight needs 1.25e+03 A, above the current limit of 10 A"),
        ("ubc", "coils", {"continuous_current": 1.0}, "weight needs 1.14 A, above the continuous current of 1 A"),
        ("arm", "body", {"gravity": (0.0, 0.0, -90.0)}, "weight needs 13.5 N, above the force limit of 8 N"),
        ("stage", "body", {"inertia": (0.13, 0.13, 0.19)}, "radius of gyration is 0.796 m: are mass and inertia"),
    ],
)
def test_a_device_that_cannot_carry_itself_is_warned_of(
    device: str, section: str, change: dict[str, Any], warning: str
) -> None:
    assert DeviceFigures(Device.load(device)).warnings == []
    (found,) = DeviceFigures(Device.load(device).change(section, **change)).warnings
    assert found.startswith(warning)
