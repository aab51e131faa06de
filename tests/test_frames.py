"""Components and arrays, quaternions and rotation vectors."""

import math

import mujoco
import numpy as np
import pytest

from maglev_mj.frames import Command, Sample, components, join, quaternion, rotation_vector


@pytest.mark.parametrize("shape", [(6,), (5, 6), (2, 3, 6)])
def test_components_and_join_undo_each_other(shape: tuple[int, ...]) -> None:
    values = np.random.default_rng(0).normal(size=shape)
    parts = components(values)
    assert len(parts) == 6
    assert all(np.shape(part) == shape[:-1] for part in parts)
    assert np.array_equal(join(parts), values)


def test_one_device_is_six_plain_floats() -> None:
    assert all(type(part) is float for part in components(np.arange(6.0)))


def test_join_spreads_plain_numbers_over_the_batch() -> None:
    joined = join([0.0, np.array([1.0, 2.0]), 0.0, 0.0, 0.0, 3.0])
    assert joined.tolist() == [[0, 1, 0, 0, 0, 3], [0, 2, 0, 0, 0, 3]]


def test_sample_and_command_show_arrays() -> None:
    assert Sample(0, 0.0, [1.0] * 6).pose.shape == (6,)
    assert Command([2.0] * 6).pulse.tolist() == [0.0] * 6
    assert Command([2.0] * 6, [1.0] * 6, 0.001).pulse.tolist() == [1.0] * 6


@pytest.mark.parametrize("angle", [0.0, 1e-200, 1e-12, 1e-6, 0.01, 1.0, math.pi, 6.0])
def test_rotation_vector_of_a_quaternion_comes_back(angle: float) -> None:
    axis = np.array([0.6, -0.48, 0.64])
    back = rotation_vector(*quaternion(angle * axis))
    np.testing.assert_allclose(back, angle * axis, rtol=1e-9 if angle > 3 else 1e-14, atol=1e-300)


def test_rotation_vector_agrees_with_the_engine() -> None:
    random = np.random.default_rng(3)
    for _ in range(100):
        vector = random.normal(size=3) * 0.5
        expected = np.zeros(3)
        mujoco.mju_quat2Vel(expected, np.array(quaternion(vector)), 1.0)
        np.testing.assert_allclose(rotation_vector(*quaternion(vector)), expected, rtol=1e-13, atol=1e-16)
