"""Calibrations in files: bitwise round trips, one-line refusals."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj import RemotePlant, Twin, TwinParameters
from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.fault import HandshakeError
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.device import Device, devices
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array
from maglev_mj.plants import MuJoCoPlant
from maglev_mj.plants.coils import CoilMap
from maglev_mj.plants.sensor import Beams

_COILS = ("points", "directions", "force_constants", "wrench_per_current", "current_per_wrench")
_BEAMS = ("leds", "directions", "diodes", "across")


def other(seed: int) -> Calibration:
    """Return a calibration without round numbers."""
    draw = np.random.default_rng(seed)
    nominal = Calibration.nominal()

    def turned(values: Array) -> Array:
        moved = values + draw.normal(0.0, 0.02, values.shape)
        return np.asarray(moved / np.linalg.norm(moved, axis=-1, keepdims=True))

    known, light = nominal.coils, nominal.beams
    assert isinstance(light, Beams)
    return Calibration(
        coils=CoilMap(
            points=known.points + draw.normal(0.0, 1e-3, (6, 3)),
            directions=turned(known.directions),
            force_constants=known.force_constants * draw.uniform(0.9, 1.1, 6),
        ),
        beams=Beams(
            leds=light.leds + draw.normal(0.0, 1e-4, (3, 3)),
            directions=turned(light.directions),
            diodes=light.diodes + draw.normal(0.0, 1e-4, (3, 3)),
            across=turned(light.across),
        ),
        spot_offsets=draw.normal(0.0, 1e-4, 6),
        mass=draw.uniform(0.6, 0.9),
        inertia=draw.uniform(8e-4, 1e-3, 3),
        gravity=draw.normal((0.0, 0.0, -9.8), 0.3),
        name=f"device [ {seed} ] of the \u201cbest\u201d sort",
    )


def bits(one: Calibration) -> list[bytes]:
    parts = [getattr(one.coils, name) for name in _COILS] + [getattr(one.beams, name) for name in _BEAMS]
    parts += [one.spot_offsets, one.inertia, one.gravity, np.float64(one.mass), one.hover]
    return [part.tobytes() for part in parts]


def test_a_file_gives_back_every_bit(tmp_path: Path) -> None:
    for one in (other(0), Calibration.nominal()):
        one.save(tmp_path / "device.toml")
        back = Calibration.load(tmp_path / "device.toml")
        assert bits(back) == bits(one)
        assert back.digest == one.digest and len(one.digest) == 16
        assert back.name == one.name


VALUES = ("coils.points", "coils.force_constants", "beams.leds", "beams.diodes", "spot_offsets", "inertia", "gravity")


@pytest.mark.parametrize("name", VALUES)
def test_the_digest_sees_every_number(name: str) -> None:
    one, (part, _, entry) = other(0), name.partition(".")
    values = np.array(getattr(getattr(one, part), entry) if entry else getattr(one, part))
    seen = {one.digest}
    for index in np.ndindex(values.shape):
        changed = values.copy()
        changed[index] = math.nextafter(changed[index], math.inf)
        whole: Any = replace(getattr(one, part), **{entry: changed}) if entry else changed
        parts: Any = {part: whole}
        seen.add(replace(one, **parts).digest)
    assert len(seen) == values.size + 1 and replace(one, name="another").digest == one.digest


@pytest.mark.parametrize("name", devices())
def test_a_calibration_has_the_digest_of_its_file(name: str) -> None:
    device = Device.load(name)
    if device.coils is None:
        with pytest.raises(ParameterError, match="device 'arm' has no coils"):
            Calibration.of(device)
        return
    known = Calibration.of(device)
    assert known.digest == device.digest and known.device == device
    moved = replace(known, mass=2.0 * known.mass)
    assert moved.device.mass == 2.0 * device.mass and moved.device.coils == device.coils
    np.testing.assert_allclose(Calibration.of(moved.device).hover, 2.0 * known.hover)


def test_hover_carries_the_weight() -> None:
    one = other(0)
    wrench = one.coils.wrench(one.hover)
    np.testing.assert_allclose(wrench, [*(-one.mass * one.gravity), 0.0, 0.0, 0.0], atol=1e-12)
    # and so it does in the engine: upright, at the centre, nothing begins to move
    with MuJoCoPlant(coil_map=one.coils, gravity=one.gravity, mass=one.mass) as plant:
        plant.read()
        plant.drive(one.hover.tolist(), after=0.0)
        plant.read()
        _, twist = plant.state()
        assert np.abs(twist).max() < 1e-12 < 1e-3 * 9.81 * plant.period


def test_a_stage_of_its_own_file_takes_off_and_lands() -> None:
    known = Calibration.load("stage")
    twin = Twin(TwinParameters(calibration=known, lockstep=True))
    assert twin.pose[2] == pytest.approx(-0.002, abs=1e-5)
    with RemotePlant(VirtualLink(twin), calibration=known) as device:
        assert (device.period, device.delay) == (0.001, 0.0009) and device.stated.continuous_current == 2.0
        device.takeoff(0.2)
        assert np.abs(twin.pose[:3]).max() < 1e-4
        assert device.land(0.2).at_rest
    with pytest.raises(HandshakeError, match="calibration mismatch"):
        RemotePlant(VirtualLink(Twin(TwinParameters(calibration=known))))
