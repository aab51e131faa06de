"""Causes that a takeoff names: the fewest that explain its path."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.flight import Flight
from maglev_mj.bridge.observer import CoilEstimator
from maglev_mj.bridge.preflight import check_change, measure_link
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.bridge.safety import HostLimits
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.bridge.twin.twin import Twin, TwinParameters
from maglev_mj.errors import MaglevError, PlantError
from maglev_mj.frames import Command, DeviceWall
from maglev_mj.plants.coils import CoilMap
from maglev_mj.scenes import find_scene
from tests.bridge.conftest import InProcess

NOMINAL = Calibration.nominal()


def gains(**values: float) -> Calibration:
    """Return the nominal calibration with other gains of coils, as c0=0.9."""
    coils = NOMINAL.coils
    constants = np.array(coils.force_constants) * [values.get(f"c{coil}", 1.0) for coil in range(6)]
    points, directions = np.array(coils.points), np.array(coils.directions)
    return replace(NOMINAL, coils=CoilMap(points=points, directions=directions, force_constants=constants))


def flown(truth: Calibration, rate: int, folder: Path, judge: bool = True) -> tuple[str, Flight]:
    """Return how a flight of 0.2 s of a device that differs from its calibration ends, and the flight."""
    twin = Twin(TwinParameters(period=1.0 / rate, calibration=NOMINAL, truth=truth, seed=3), draw=lambda: 7)
    plant = RemotePlant(VirtualLink(twin), folder=folder)
    scene = find_scene("drop" if rate == 1000 else "joystick")().replace(period=plant.period, delay=plant.delay)
    side: Any = InProcess(partial(check_change, report=measure_link(plant), anyway=False)) if judge else None
    flight = Flight(plant, scene, critical_delay=0.01, check=side)
    try:
        return flight.run(0.2).landing.reason or "landed", flight
    except PlantError as error:
        return str(error), flight


TRUTHS: list[tuple[Calibration, str]] = [
    (NOMINAL, ""),
    (replace(NOMINAL, mass=0.8), "1.14 times the calibrated mass"),
    (replace(NOMINAL, mass=0.9), "1.29 times the calibrated mass"),
    (replace(NOMINAL, mass=0.5), "0.71 times the calibrated mass"),
    (replace(NOMINAL, inertia=2.0 * NOMINAL.inertia), "2.00 times the calibrated inertia"),
    (replace(NOMINAL, spot_offsets=1e-3 * np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0])), ""),
    (replace(NOMINAL, spot_offsets=1e-3 * np.array([1.0, 1.0, -1.0, 1.0, 1.0, 1.0])), ""),
    (gains(**{f"c{coil}": 1.4 for coil in range(6)}), "0.71 times the calibrated mass and 0.71"),
]


@pytest.mark.parametrize("rate", [200, pytest.param(1000, marks=pytest.mark.study)])
@pytest.mark.parametrize(("truth", "found"), TRUTHS)
def test_a_weight_is_a_weight(truth: Calibration, found: str, rate: int, tmp_path: Path) -> None:
    outcome, flight = flown(truth, rate, tmp_path)
    assert "coil" not in outcome
    if not found:
        assert outcome == "landed" and flight._weight[2] == pytest.approx(0.7 * 9.81)
        return
    if outcome != "landed":  # the scene is refused with what was found, or the device cannot hold it
        refused = r"stable up to|hover limit must be at least"
        assert outcome.startswith("the flotor has") and found[:20] in outcome and re.search(refused, outcome)
        assert ("hover limit" in outcome) == found.startswith("1.29")
        return
    assert found[:20] in flight._note and "coil" not in flight._note
    lifted = 1.0 / 1.4 if "and 0.71" in found else truth.mass / 0.7
    assert flight._weight[2] == pytest.approx(lifted * 0.7 * 9.81, rel=0.02)  # carried by the laws


@pytest.mark.parametrize("rate", [200, pytest.param(1000, marks=pytest.mark.study)])
@pytest.mark.parametrize("coil", [0, *(pytest.param(coil, marks=pytest.mark.study) for coil in range(1, 6))])
def test_a_weak_coil_is_named(coil: int, rate: int, tmp_path: Path) -> None:
    outcome, _ = flown(gains(**{f"c{coil}": 0.9}), rate, tmp_path)
    assert f"no flight: coil {coil} gives" in outcome and outcome.count("coil") == 1


def test_a_flotor_that_is_too_heavy_names_no_coil(tmp_path: Path) -> None:
    outcome, _ = flown(replace(NOMINAL, mass=1.2), 200, tmp_path)
    assert "NOT_FOLLOWING" in outcome and "it does not lift off" in outcome and "coil 0" not in outcome


def test_without_a_check_of_the_scene_another_mass_lands(tmp_path: Path) -> None:
    outcome, _ = flown(replace(NOMINAL, mass=0.8), 200, tmp_path, judge=False)
    assert outcome == "the flotor has 1.14 times the calibrated mass: the scene was not checked with it"


@pytest.mark.parametrize("mass", [0.6, 0.8])
def test_a_device_holds_the_weight_that_was_found(mass: float, tmp_path: Path) -> None:
    # a host that falls silent leaves the flotor to the currents that the device was armed with
    twin = Twin(TwinParameters(calibration=NOMINAL, truth=replace(NOMINAL, mass=mass), seed=3), draw=lambda: 7)
    with RemotePlant(VirtualLink(twin), folder=tmp_path) as plant:
        plant.takeoff(check_coils=True)
        assert f"{mass / 0.7:.2f} times" in plant.coils.weight and plant.weigh() == ""
        plant.land()
        plant.takeoff(check_coils=True)
        assert plant.coils.weight == ""
        heights = [plant.read().position[2] for _ in range(8)]  # without an answer
        assert max(map(abs, heights)) < 2e-4


class Asked:
    """Check of a scene that never ends: landing is requested meanwhile; or that fails."""

    def __init__(self, error: str = "") -> None:
        self.error, self.flight, self.looks = error, None, 0

    def ask(self, *question: Any) -> None:
        pass

    def answer(self) -> None:
        self.looks += 1
        if self.error:
            raise MaglevError(self.error)
        if self.looks == 3:
            self.flight.switch.land()  # type: ignore[attr-defined]


@pytest.mark.parametrize("error", ["", "stability not known: timeout after 10 s"])
def test_landing_is_obeyed_while_the_scene_is_checked(error: str, tmp_path: Path) -> None:
    twin = Twin(TwinParameters(calibration=NOMINAL, truth=replace(NOMINAL, mass=0.8)), draw=lambda: 7)
    plant, side = RemotePlant(VirtualLink(twin), folder=tmp_path), Asked(error)
    scene = find_scene("joystick")().replace(period=plant.period, delay=plant.delay)
    side.flight = flight = Flight(plant, scene, critical_delay=0.01, check=side)  # type: ignore[assignment,arg-type]
    report = flight.run(0.2).landing
    assert report.at_rest
    assert report.reason == f"the flotor has 1.14 times the calibrated mass: {error or 'landing was requested'}"
    plant.close()


def test_a_probe_obeys_the_force_limit_of_the_host(tmp_path: Path) -> None:
    limits = HostLimits(force_limit=9.0)
    with RemotePlant(VirtualLink(Twin(TwinParameters(), draw=lambda: 7)), folder=tmp_path, limits=limits) as plant:
        plant.takeoff()
        plant._hand.residual._begin()
        largest = 0.0
        for _ in range(12):
            plant.read()
            applied = plant.write(Command([0.0, 0.0, 50.0, 0.0, 0.0, 0.0]))
            largest = max(largest, *map(abs, applied.force))
        assert 8.9 < largest <= 9.0


def estimated(sizes: dict[int, float], noise: float = 0.0, other: float = 0.0) -> dict[str, float]:
    """Return the causes of a path with these sizes of columns (0 to 5 coils, 6 delay, 7 mass), noise and another error.

    Errors are orthogonal to all columns, and in lengths of the squared error of the first cause.
    """
    draw = np.random.default_rng(5)
    columns, _ = np.linalg.qr(draw.normal(size=(600, 8)))
    matrix, rest = columns[:, :7].copy(), columns[:, 7]
    estimator = CoilEstimator(NOMINAL, 0.005)
    estimator._flown = lambda: np.zeros((1, 21))  # type: ignore[method-assign]
    mass = np.where(np.arange(600) < 300, matrix[:, :6].sum(axis=1), 0.0)
    path = sum(size * (mass if k == 7 else matrix[:, k]) for k, size in sizes.items()) + other * rest
    estimator._fit = lambda rows, axes: (matrix, path + noise * rest)  # type: ignore[method-assign]
    return estimator.causes()


def test_the_fewest_causes_count() -> None:
    assert set(estimated({2: 0.5})) == {"coil 2"} and set(estimated({7: 0.5})) == {"mass"}
    sizes: Sequence[float] = (8.0, 4.0, 2.0, 1.0)
    found = estimated(dict(enumerate(sizes)))
    assert list(found) == ["coil 0", "coil 1", "coil 2"]  # at most three
    for share, count in ((0.36, 1), (0.44, 0)):  # of the squared error that is left
        assert len(estimated({1: 1.0}, other=(share / (1.0 - share)) ** 0.5)) == count
    explained = 0.25 * NOMINAL.device.scale.noise * 600**0.5
    assert [len(estimated({1: part * explained})) for part in (0.9, 1.1)] == [0, 1]


@pytest.mark.parametrize(("size", "named"), [(0.063, False), (0.077, True), (-0.063, False), (-0.077, True)])
def test_an_error_counts_from_seven_percent_on(size: float, named: bool) -> None:
    for cause in ("coil 3", "mass", "inertia"):
        estimator = CoilEstimator(NOMINAL, 0.005)
        estimator.causes = lambda cause=cause: {cause: size}  # type: ignore[method-assign, misc]
        said = estimator.fault() + estimator.weight
        assert bool(said) == named and (not named or cause in said)


@pytest.mark.parametrize(("size", "named"), [(450.0, False), (550.0, True)])
def test_a_rotation_on_the_stop_shows_a_coil(size: float, named: bool) -> None:
    estimator, scale = CoilEstimator(NOMINAL, 0.005), NOMINAL.device.scale
    for _ in range(10):
        estimator.add([0.0] * 6, [0.0] * 6)
    matrix = np.zeros((600, 7))
    matrix[0, 4] = 1.0
    path = np.zeros(600)
    path[0] = size * scale.noise * scale.lever
    estimator._fit = lambda rows, axes: (matrix, path)  # type: ignore[method-assign]
    assert ("coil 4 is the most likely cause" in estimator.fault(lost=True)) == named


@pytest.mark.parametrize(("count", "enough"), [(7, False), (8, True)])
def test_eight_samples_after_liftoff_are_enough(count: int, enough: bool) -> None:
    estimator = CoilEstimator(NOMINAL, 0.005)
    for height in [0.0] * 5 + [1e-3] * count:
        estimator.add([0.0, 0.0, height, 0.0, 0.0, 0.0], NOMINAL.hover.tolist())
    assert (estimator._flown() is not None) == enough


@pytest.mark.parametrize(("share", "certain"), [(0.9, True), (1.1, False)])
def test_an_uncertain_gain_or_delay_is_not_reported(share: float, certain: bool) -> None:
    estimator, noise = CoilEstimator(NOMINAL, 0.005), NOMINAL.device.scale.noise
    sizes = noise / (share * np.array([0.02] * 6 + [2e-4]))
    estimator._flown = lambda: np.zeros((1, 21))  # type: ignore[method-assign]
    estimator._fit = lambda rows, axes: (np.diag(sizes), np.zeros(7))  # type: ignore[method-assign]
    gains, delay = estimator.estimate()
    assert (np.isfinite(gains) == certain).all() and np.isfinite(delay) == certain


@pytest.mark.parametrize(("share", "named"), [(0.45, False), (0.55, True)])
def test_a_delay_of_half_a_period_is_acted_on_at_takeoff(share: float, named: bool, tmp_path: Path) -> None:
    estimator = CoilEstimator(NOMINAL, 0.005)
    for _ in range(5):
        estimator.add([0.0] * 6, [0.0] * 6)
    estimator.estimate = lambda: (np.ones(6), share * 0.005)  # type: ignore[method-assign]
    assert ("the sensor is delayed by" in estimator.fault(lost=True)) == named


@pytest.mark.parametrize(("delay", "acted"), [(0.9e-3, False), (1.1e-3, True)])
def test_a_delay_of_1_ms_is_acted_on_after_a_probe(delay: float, acted: bool, tmp_path: Path) -> None:
    plant = RemotePlant(VirtualLink(Twin(TwinParameters(), draw=lambda: 7)), folder=tmp_path)
    scene = find_scene("joystick")().replace(period=plant.period, delay=plant.delay)
    for walls in ((), [DeviceWall(2, 0.0, 1, 6e3, 80.0)]):
        flight = Flight(plant, scene, critical_delay=1e-4)
        assert bool(flight._check_sensor(delay, walls)) == acted
    plant.close()
