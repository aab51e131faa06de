"""Identification of coils, mass and level by small motions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.commissioning.identification import (
    LINES,
    IdentificationError,
    Identified,
    RecordedMotion,
    Shaker,
    Trim,
    collect,
    excitation,
    identify,
)
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.bridge.twin.twin import Twin as BridgeTwin
from maglev_mj.bridge.twin.twin import TwinParameters
from maglev_mj.control import Bias
from maglev_mj.control.controller import Controller
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array, Command, Sample
from maglev_mj.plants import MuJoCoPlant, SpotReader, Timing
from maglev_mj.plants.coils import CoilMap
from maglev_mj.plants.sensor import tracker_of
from tests.sweeps import further

NOMINAL = Calibration.nominal()
SLOW, FAST = (0.005, 0.0015), (0.001, 0.0003)
QUANTUM, NOISE = 0.8e-6, 0.3e-6
MASS = 0.82

pytestmark = pytest.mark.xdist_group("identification")  # so that each device is shaken once


class Twin:
    """Device with random true values, and its nominal host."""

    def __init__(
        self,
        seed: int,
        timing: tuple[float, float],
        *,
        noisy: bool = False,
        mass: float = MASS,
        spread: float = 0.1,
        losses: float = 0.0,
        **keywords: Any,
    ) -> None:
        draw = np.random.default_rng(seed)
        known = NOMINAL.coils
        self.coils = CoilMap(
            points=known.points + draw.uniform(-1e-3, 1e-3, (6, 3)),
            directions=known.directions.copy(),
            force_constants=known.force_constants * draw.uniform(1.0 - spread, 1.0 + spread, 6),
        )
        tilt, way = math.radians(3.0), draw.uniform(0.0, 2.0 * math.pi)
        down = [math.sin(tilt) * math.cos(way), math.sin(tilt) * math.sin(way), -math.cos(tilt)]
        self.gravity = 9.81 * np.array(down)
        period, delay = timing
        self.plant = MuJoCoPlant(
            Timing(period=period, delay=delay), coil_map=self.coils, gravity=self.gravity, mass=mass, **keywords
        )
        self.period = period
        self.last_currents: Sequence[float] = (0.0,) * 6
        self.last_delay = math.nan
        self._losses, self._draw = losses, draw
        self._spots = SpotReader(NOMINAL.beams, QUANTUM, NOISE, seed) if noisy else None
        self._pose = tracker_of(NOMINAL.beams)

    @property
    def acceleration_per_current(self) -> Array:
        body = np.concatenate([np.full(3, self.plant.device.mass), self.plant.device.inertia])
        return np.asarray(self.coils.wrench_per_current / body[:, None])

    def read(self) -> Sample:
        sample = self.plant.read()
        while self._losses and self._draw.uniform() < self._losses:
            sample = self.plant.read()  # nobody heard of the one before, and the currents stay
        return (
            sample
            if self._spots is None
            else Sample(sample.tick, sample.time, self._pose(self._spots(sample.position)))
        )

    def write(self, command: Command) -> Command:
        self.last_currents = NOMINAL.coils.currents(command.wrench).tolist()
        self.plant.drive(self.last_currents)
        return command

    def close(self) -> None:
        self.plant.close()


@dataclass(frozen=True)
class Errors:
    """Relative, in the Frobenius norm: forces, torques, and gravity."""

    forces: float
    torques: float
    gravity: float


def errors(found: Identified, twin: Twin) -> Errors:
    truth, off = twin.acceleration_per_current, found.acceleration_per_current - twin.acceleration_per_current
    forces, torques = (np.linalg.norm(off[rows]) / np.linalg.norm(truth[rows]) for rows in (slice(3), slice(3, 6)))
    gravity = np.linalg.norm(found.gravity - twin.gravity) / 9.81
    return Errors(float(forces), float(torques), float(gravity))


def shaken(twin: Twin, timing: tuple[float, float], duration: float, amplitude: float = 1.0) -> RecordedMotion:
    period, delay = timing
    controller = excitation(
        NOMINAL, period=period, delay=delay, translation=1e-4 * amplitude, rotation=1.5e-3 * amplitude
    )
    return collect(twin, controller, duration)


@lru_cache(maxsize=64)
def study(
    seed: int, timing: tuple[float, float], noisy: bool, duration: float = 10.0, amplitude: float = 1.0
) -> tuple[Twin, RecordedMotion, Identified]:
    twin = Twin(seed, timing, noisy=noisy)
    motion = shaken(twin, timing, duration, amplitude)
    return twin, motion, identify(*motion[:2], period=timing[0], delay=timing[1])


@pytest.mark.parametrize(("timing", "torques"), [(SLOW, 5e-5), *further((FAST, 2e-5), ((0.001, 0.0023), 2e-5))])
def test_an_ideal_sensor_tells_all(timing: tuple[float, float], torques: float) -> None:
    twin, motion, found = study(0, timing, False)
    off = errors(found, twin)
    # translations are linear in the currents, and the relation is exact: what is left is rounding
    assert off.forces < 1e-9 and off.gravity < 1e-11
    # torques turn with the flotor: an angle squared is left, 2e-5 and 1e-5
    assert off.torques < torques
    # and the motions are small: below 0.3 mm and 6 mrad, about the centre
    assert np.abs(motion.poses[:, :3]).max() < 0.3e-3 and np.abs(motion.poses[:, 3:]).max() < 6e-3
    assert np.abs(motion.poses.mean(axis=0)).max() < 1e-4


@pytest.mark.parametrize(("timing", "seeds"), [(SLOW, (1,)), *further((SLOW, range(3)), (FAST, range(3)))])
def test_ten_seconds_with_the_devices_sensor_are_within_a_thousandth(
    timing: tuple[float, float], seeds: Sequence[int]
) -> None:
    seen = [(errors(found, twin), found) for twin, _, found in (study(seed, timing, True) for seed in seeds)]
    # seen over six seeds: forces 4e-4 to 7e-4, torques 2e-4 to 3e-4, gravity 1e-4 to 3e-4
    assert max(off.forces for off, _ in seen) < 1.2e-3
    assert max(off.torques for off, _ in seen) < 6e-4
    assert max(off.gravity for off, _ in seen) < 6e-4
    for _, found in seen:
        # 0.8 µm steps and 0.3 µm of noise are 0.38 µm on a spot, and two thirds to nine tenths of that on x, y, z
        np.testing.assert_allclose(found.noise[:3] / math.hypot(QUANTUM / math.sqrt(12.0), NOISE), 0.75, atol=0.25)
        assert (found.misfit < 2.0 * found.noise).all()


def level(duration: float, amplitude: float) -> float:
    """Return the standard error, as tested above."""
    studies = [study(seed, SLOW, True, duration, amplitude)[2] for seed in range(3)]
    return float(np.sqrt(np.mean([np.square(found.errors[:3]) for found in studies])))


def test_errors_fall_with_the_amplitude_and_with_the_root_of_the_duration() -> None:
    assert level(1.25, 0.5) / level(1.25, 1.0) == pytest.approx(2.0, rel=0.15)
    assert level(1.25, 1.0) / level(5.0, 1.0) == pytest.approx(2.0, rel=0.15)


@pytest.mark.parametrize(("mass", "timing"), [(0.6, SLOW), *further((0.9, SLOW), (0.9, FAST))])
def test_a_device_that_is_known_badly_hovers_and_is_found_all_the_same(
    mass: float, timing: tuple[float, float]
) -> None:
    twin = Twin(0, timing, noisy=True, mass=mass, spread=0.15)
    off = errors(identify(*shaken(twin, timing, 10.0)[:2], period=timing[0], delay=timing[1]), twin)
    assert max(off.forces, off.torques) < 1.5e-3 and off.gravity < 6e-4


def test_a_known_mass_gives_forces_and_the_calibration_its_coils() -> None:
    for noisy, much in ((False, 4e-5), (True, 1e-3)):
        twin, _, found = study(2 * noisy, SLOW, noisy)
        one = found.calibration(NOMINAL, MASS)
        assert one.mass == MASS and one.name == "identified"
        np.testing.assert_array_equal(one.gravity, found.gravity)
        np.testing.assert_allclose(one.coils.force_constants, twin.coils.force_constants, rtol=much)
        # a controller with this calibration accelerates the flotor as it means to, whatever its inertia is
        body = np.concatenate([np.full(3, MASS), one.inertia])
        meant = one.coils.wrench_per_current / body[:, None]
        off = meant - twin.acceleration_per_current
        assert np.linalg.norm(off) < much * np.linalg.norm(meant)
        # points move across their forces only: along them, by up to 1 mm here, an upright flotor tells nothing
        moved = one.coils.points - NOMINAL.coils.points
        assert np.abs(np.einsum("ja,ja->j", moved, NOMINAL.coils.directions)).max() < 1e-12
        assert np.abs(one.coils.points - twin.coils.points).max() < 1.2e-3
        # and it hovers without trim: what the nominal one lacks is 2 N
        lacking = MASS * twin.gravity + twin.coils.wrench(one.hover)[:3]
        assert np.linalg.norm(lacking) < 2.0 * much * MASS * 9.81
        assert np.linalg.norm(MASS * twin.gravity + twin.coils.wrench(NOMINAL.hover)[:3]) > 0.5
    assert found.calibration(NOMINAL).mass == NOMINAL.mass


@pytest.mark.parametrize(("timing", "noisy"), [(SLOW, True), *further((SLOW, False), (FAST, True))])
def test_a_wrong_delay_is_seen(timing: tuple[float, float], noisy: bool) -> None:
    twin, motion, _ = study(int(noisy), timing, noisy)
    period, delay = timing
    wrong = identify(*motion[:2], period=period, delay=delay + 1e-4)
    assert 1e-3 < errors(wrong, twin).forces < 4e-3
    assert not noisy or (wrong.misfit > 5.0 * wrong.noise).any()


def test_a_device_at_the_other_end_of_a_wire_is_found_too(tmp_path: Path) -> None:
    other = Twin(1, SLOW)
    truth = replace(NOMINAL, coils=other.coils, mass=MASS, gravity=other.gravity)
    device = BridgeTwin(TwinParameters(lockstep=True, truth=truth, pose=(0.0,) * 6))
    with RemotePlant(VirtualLink(device), folder=tmp_path) as plant:
        plant.read()
        plant.arm()
        motion = collect(plant, excitation(plant.calibration, period=plant.period, delay=plant.delay), 6.0)
        off = errors(identify(*motion[:2], period=plant.period, delay=plant.delay), other)
    assert off.forces < 1.5e-3 and off.torques < 8e-4 and off.gravity < 6e-4


def test_samples_that_were_lost_cost_little() -> None:
    twin = Twin(1, SLOW, noisy=True, losses=0.03)
    motion = shaken(twin, SLOW, 10.0)
    lost = np.isnan(motion.poses[:, 0])
    assert 20 < lost.sum() < 120 and (lost == np.isnan(motion.currents).all(axis=1)).all()
    off = errors(identify(*motion[:2], period=SLOW[0], delay=SLOW[1]), twin)
    # up to 2e-3, 1e-3 and 9e-4 over four seeds: each gap is an edge, where the window is not smooth
    assert off.forces < 4e-3 and off.torques < 2e-3 and off.gravity < 2e-3


def test_the_relation_holds_for_any_delay_to_rounding() -> None:
    # one body by itself, currents at random, positions by the closed form: not MuJoCo's, not the controller's
    draw = np.random.default_rng(0)
    a, g = draw.normal(size=(6, 6)), draw.normal(size=6)
    for period, delay in ((0.005, 0.0), (0.005, 0.0015), (0.005, 0.005), (0.004, 0.0091)):
        times = period * np.arange(800)
        currents = sum(
            (np.sin(2.0 * np.pi * line * times)[:, None] * draw.normal(size=6) for line in LINES.ravel()),
            start=-np.linalg.solve(a, g) + np.zeros((800, 6)),
        )
        since = np.maximum(times[:, None] - times - delay, 0.0)  # [sample, switch]
        steps = np.diff(currents, axis=0, prepend=0.0)
        poses = 0.5 * since**2 @ steps @ a.T + 0.5 * times[:, None] ** 2 * g
        line = np.stack([np.ones(800), times], axis=1)
        poses -= line @ np.linalg.lstsq(line, poses, rcond=None)[0]  # as if it had begun so as to stay nearby
        found = identify(poses, currents, period=period, delay=delay)
        np.testing.assert_allclose(found.acceleration_per_current, a, atol=1e-6)
        np.testing.assert_allclose(found.free_acceleration, g, atol=1e-6)
        np.testing.assert_allclose(found.stiffness, 0.0, atol=1e-6)


def test_what_tells_nothing_is_refused() -> None:
    _, motion, _ = study(0, SLOW, False)
    poses, currents, _ = motion
    keywords = {"period": 0.005, "delay": 0.0015}
    with pytest.raises(
        ParameterError, match=r"poses and currents must both have shape \(N, 6\) \(got \(2000, 6\) and \(1999"
    ):
        identify(poses, currents[:-1], **keywords)
    with pytest.raises(ParameterError, match="currents must be finite, or NaN"):
        identify(poses, np.full_like(currents, np.inf), **keywords)
    with pytest.raises(ParameterError, match=r"the highest line must be below 100.* \(got 150"):
        identify(poses, currents, lines=[4.5, 150.0], **keywords)
    for few in (2, 3, 40):
        with pytest.raises(IdentificationError, match="longer than"):
            identify(poses[:few], currents[:few], **keywords)
    with pytest.raises(IdentificationError, match="fewer gaps"):
        identify(np.full_like(poses, np.nan), currents, **keywords)
    with pytest.raises(IdentificationError, match="all six axes, each at two frequencies or more"):
        identify(poses, currents, lines=LINES[:, 0], **keywords)
    still = np.zeros_like(currents)
    with pytest.raises(IdentificationError, match="all six axes"):
        identify(poses, still, **keywords)


def test_the_excitation_is_what_it_says() -> None:
    calm = Controller([Bias([1.0] * 6)], period=0.005)
    shaker = Shaker(calm, frequencies=[[2.0, 0.0]] * 6, amplitudes=[[0.5, 7.0]] * 6)
    # an eighth of a second is a quarter of a period, however few samples there were before
    assert shaker.step(Sample(25, 0.125, [0.0] * 6)).force == pytest.approx([1.5] * 6)
    trim = Trim(gain=[20.0] * 6, period=0.05)
    force = trim.start()
    for _ in range(3):
        wrench = [0.0] * 6
        force, _ = trim([1.0] * 6, [0.0] * 6, force, wrench)
    assert wrench == [-3.0] * 6
    # what two lines make of a product is no line
    half = np.rint(2.0 * LINES.ravel()).astype(int)
    assert np.array_equal(half, 2.0 * LINES.ravel()) and (half % 2 == 1).all() and len(set(half)) == 12
    with pytest.raises(ParameterError, match=r"frequencies must have shape \(6, L\)"):
        Shaker(calm, frequencies=[1.0] * 6, amplitudes=[1.0] * 6)
    with pytest.raises(ParameterError, match="the highest frequency must be"):
        excitation(NOMINAL, period=0.05, delay=0.0)
    with pytest.raises(ParameterError, match=r"lines must have shape \(6, L\) \(got \(12,\)"):
        excitation(NOMINAL, period=0.005, delay=0.0, lines=LINES.ravel())
    with pytest.raises(ParameterError, match="Trim gain must have a last dimension of 6"):
        Trim(gain=[1.0] * 5, period=0.005)
