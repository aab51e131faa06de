"""Poses from the spots of three beams, and errors."""

import math

import numpy as np
import pytest

from maglev_mj.errors import ModelError, ParameterError
from maglev_mj.frames import rotation_matrix
from maglev_mj.plants import SpotSensor
from maglev_mj.plants.sensor import Beams, beams
from maglev_mj.spec import Spec


def poses(count: int, share: float = 1.0) -> np.ndarray:
    """Return seeded poses all over the device's range."""
    random = np.random.default_rng(7)
    turned = random.uniform(-1.0, 1.0, (count, 3))
    turned *= math.radians(6.0) / np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1.0)
    return np.concatenate([random.uniform(-4.5e-3, 4.5e-3, (count, 3)), turned], axis=1) * share


def test_upright_at_centre_every_beam_meets_the_middle_of_its_diode() -> None:
    np.testing.assert_allclose(beams().spots(np.zeros(6)), 0.0, atol=1e-15)


@pytest.mark.parametrize("share", [0.01, 1.0, 2.0])
def test_the_pose_comes_back_from_the_spots(share: float) -> None:
    wanted = poses(500, share)
    np.testing.assert_allclose(beams().pose(beams().spots(wanted)), wanted, atol=1e-13)
    np.testing.assert_array_equal(beams().spots(wanted[3]), beams().spots(wanted)[3])


def test_a_spot_is_where_a_line_meets_a_plane() -> None:
    pose = poses(1)[0]
    sensor, turn = beams(), rotation_matrix(pose[3:])
    for arm in range(3):
        light, direction = pose[:3] + turn @ sensor.leds[arm], turn @ sensor.directions[arm]
        across, up = sensor.across[arm]
        # light + s direction = diode + u across + v up
        s, u, v = np.linalg.solve(np.column_stack([direction, -across, -up]), sensor.diodes[arm] - light)
        assert s > 0.0
        np.testing.assert_allclose([u, v], sensor.spots(pose)[2 * arm : 2 * arm + 2], atol=1e-16)


def test_spots_of_0_8_micrometres_give_the_resolution_of_table_1() -> None:
    wanted, quantum = poses(4000), 8e-7
    off = np.abs(beams().pose(np.rint(beams().spots(wanted) / quantum) * quantum) - wanted)
    assert off[:, :3].max() < Spec.translation_resolution.value
    assert off[:, 3:].max() < Spec.rotation_resolution.value


def test_a_geometry_that_cannot_tell_is_refused() -> None:
    good = beams()
    with pytest.raises(ModelError, match="every beam must meet its diode"):
        Beams(
            good.leds,
            np.roll(good.directions, 1, axis=1)[:, ::-1] * [0, 0, 1] + [0, 0, 1e-12],
            good.diodes,
            good.across,
        )
    with pytest.raises(ModelError, match="do not determine all six coordinates"):
        Beams(good.leds[[0, 0, 0]], good.directions[[0, 0, 0]], good.diodes[[0, 0, 0]], good.across[[0, 0, 0]])
    with pytest.raises(ModelError, match="three LEDs"):
        Beams(good.leds[:2], good.directions, good.diodes, good.across)
    with pytest.raises(ParameterError, match="quantum must be"):
        SpotSensor(beams=good, quantum=-1.0)
