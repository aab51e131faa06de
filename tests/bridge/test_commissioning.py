"""Coils and diodes of a new device, checked in foam."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from maglev_mj.bridge import Calibration, RemotePlant, State
from maglev_mj.bridge.commissioning.coil_check import check_coil, mean_pose, record_step, with_offsets
from maglev_mj.bridge.twin.fault_injection import INJECTED_FAULTS, Effect, InjectedFault
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.bridge.twin.twin import Twin, TwinParameters
from maglev_mj.cli.twin import foam
from maglev_mj.errors import ParameterError
from maglev_mj.plants.coils import CoilMap
from tests.bridge.devices import DEVICES
from tests.sweeps import sweep

KNOWN = Calibration.nominal()
COILS = range(6)


def device(
    truth: Calibration | None = None, *, stiffness: float = 10_000.0, period: float = 0.005, **parameters: Any
) -> tuple[Twin, RemotePlant]:
    """Return a twin in foam, and its host."""
    parameters |= {"truth": truth, "pose": [0.0] * 6, "period": period}
    twin = Twin(TwinParameters(**parameters), hand_force=foam(stiffness, 0.7))
    plant = RemotePlant(VirtualLink(twin))
    for _ in range(round(0.5 / period)):
        plant.read()
    return twin, plant


def rewired(order: Sequence[int], signs: Sequence[float]) -> Calibration:
    """Return a device with permuted and reversed coils.

    Its coil k is the calibration's coil order[k], with a sign.
    """
    coils = KNOWN.coils
    return replace(
        KNOWN,
        coils=CoilMap(
            points=coils.points[list(order)],
            directions=coils.directions[list(order)],
            force_constants=coils.force_constants[list(order)] * np.array(signs),
        ),
    )


@pytest.mark.parametrize(("coil", "period"), sweep(COILS, [0.005, 0.001], every=6))
def test_a_coil_as_calibrated_is_told_from_a_reversed_one(coil: int, period: float) -> None:
    signs = [-1.0 if other == coil else 1.0 for other in COILS]
    for truth, verdict in ((None, "as calibrated"), (rewired(COILS, signs), "reversed")):
        twin, plant = device(truth, period=period)
        check = check_coil(plant, coil)
        assert check.verdict == verdict and check.measured == pytest.approx(0.2) and check.others == 0.0
        force = check.displacement[:3] * 10_000.0  # by the foam
        assert np.abs(force) == pytest.approx(np.abs(check.expected[:3]), abs=0.01)
        assert plant.state == twin.firmware.state == State.INACTIVE
        plant.read()
        assert not twin.plant.currents.any()


def test_currents_of_other_coils_are_told_and_an_offset_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    # Coil 2's current shows in coils 0 and 4 too; every measured current is 20 mA too high.
    shares = np.array([0.03, 0.0, 1.0, 0.0, -0.06, 0.0])
    leak = Effect("", 5, read=lambda now, *_: now._replace(measured=[*(0.02 + shares * now.measured[2])]))
    monkeypatch.setitem(INJECTED_FAULTS, "leak", leak)
    _, plant = device(faults=[InjectedFault(kind="leak", which=0, at=0.0)])
    check = check_coil(plant, 2)
    assert check.measured == pytest.approx(0.2) and check.others == pytest.approx(0.012)


def test_the_error_is_that_of_the_mean() -> None:
    # The same check under several noises: its results scatter by its error, along each axis.
    checks = [check_coil(device(seed=seed, noise=2e-6, quantum=0.0)[1], 1) for seed in range(6)]
    scatter = np.std([check.displacement for check in checks], axis=0, ddof=1)
    error = np.mean([check.error for check in checks], axis=0)
    assert np.sqrt(np.mean((scatter / error) ** 2)) == pytest.approx(1.0, abs=0.25)


def test_a_step_is_followed_after_the_delay() -> None:
    twin, plant = device(period=0.001)
    rows = record_step(plant, 3, 0.2, samples=12)
    assert rows[:, 0] == pytest.approx(0.001 * np.arange(1, 13))
    assert rows[:, 1] == pytest.approx([0.0] + [0.2] * 11)  # 1.5 ms after the first sample
    assert twin.firmware.state == State.INACTIVE


def test_measured_offsets_make_the_clamped_pose_the_centre() -> None:
    offsets = np.array([1e-4, -2e-4, 3e-4, 0.0, 5e-5, -5e-5])
    truth = replace(KNOWN, spot_offsets=offsets, gravity=np.zeros(3))
    _, plant = device(truth)
    spots, errors = mean_pose(plant, 2.0)
    found = with_offsets(KNOWN, spots)
    assert found.spot_offsets == pytest.approx(offsets, abs=1e-7) and errors.max() < 1e-7


def test_exchanged_coils_and_a_clamped_flotor_are_named() -> None:
    _, plant = device(rewired([3, 1, 2, 0, 4, 5], [1.0] * 6))
    assert [check_coil(plant, coil).verdict for coil in (0, 1)] == ["wrong direction", "as calibrated"]
    assert check_coil(plant, 2, current=1e-5).verdict == "no motion"


def test_a_coil_or_current_that_is_none_is_refused_unarmed() -> None:
    twin, plant = device()
    for coil, current in ((6, 0.2), (-1, 0.2), (0, 0.0), (0, -0.2), (0, 11.0), (0, np.nan)):
        for test in (check_coil, record_step):
            with pytest.raises(ParameterError, match=r"must be"):
                test(plant, coil, current)
    assert twin.firmware.state == State.INACTIVE


@pytest.mark.parametrize("name", DEVICES)
def test_the_test_current_is_a_share_of_the_devices_own(name: str) -> None:
    """At 0.2 A a light device would lift off."""
    calibration = Calibration.of(DEVICES[name])
    twin = Twin(TwinParameters(calibration=calibration, pose=[0.0] * 6), hand_force=foam(10_000.0, calibration.mass))
    plant = RemotePlant(VirtualLink(twin), calibration=calibration)
    plant.read()
    largest = record_step(plant, 0, samples=12)[:, 1].max()
    assert largest == pytest.approx(0.8 * DEVICES[name].scale.off, rel=1e-6)
    assert name != "ubc" or largest == pytest.approx(0.2)
