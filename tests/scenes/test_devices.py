"""Scenes on the devices of the package: figures, warnings, verdicts and both plants."""

from __future__ import annotations

import numpy as np
import pytest

from maglev_mj import find_scene, run
from maglev_mj.device import devices
from maglev_mj.errors import ParameterError
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.names import BUILT_IN
from maglev_mj.scenes.results import Variants
from maglev_mj.theory import stability

OTHERS = [name for name in devices() if name != "ubc"]


@pytest.mark.parametrize("device", OTHERS)
@pytest.mark.parametrize("name", [name for name in BUILT_IN if name not in ("press", "wall")])
def test_a_scene_is_of_its_device_on_both_plants(name: str, device: str) -> None:
    scene = find_scene(name)(device=device)
    hardware = scene.hardware
    assert (scene.period, scene.delay) == (hardware.period, hardware.delay)
    np.testing.assert_array_equal(scene.body.inertia, hardware.inertia)
    np.testing.assert_array_equal(scene.body.range, hardware.reach)
    assert scene.body.force_limit == hardware.force_limit[2]
    assert np.all(np.abs(scene.start().pose) <= hardware.reach * (1.0 + 1e-12))
    if scene.laws():
        assert stability(scene).stable
    if hasattr(scene, "duration"):
        scene = scene.replace(duration=0.02)
        one, other = (run(scene, plant=plant).trace.pose[-1, :3] for plant in ("exact", "mujoco"))
        np.testing.assert_allclose(one, other, atol=1e-9)


@pytest.mark.parametrize(("stiffness", "radius"), [(6000.0, 0.9003907522), (60000.0, 1.0608294673)])
def test_verdict_by_a_loop_written_out(stiffness: float, radius: float) -> None:
    mass, period, delay, damping = 0.3, 1e-3, 9e-4, 80.0
    law, left = np.array([-stiffness - damping / period, 0.0, damping / period, 0.0]), period - delay
    place = np.array([1.0, period, 0.0, delay * (period - 0.5 * delay) / mass]) + law * left**2 / 2.0 / mass
    speed = np.array([0.0, 1.0, 0.0, delay / mass]) + law * left / mass
    loop = np.array([place, speed, [1.0, 0.0, 0.0, 0.0], law])
    assert np.abs(np.linalg.eigvals(loop)).max() == pytest.approx(radius, abs=1e-9)
    states = stability(Drop(device="stage", stiffness=stiffness)).states
    assert [one.spectral_radius for one in states if "contact" in one.acting] == pytest.approx([radius], abs=1e-9)


def test_warnings_and_headers_have_the_numbers_of_the_device() -> None:
    scene = Drop(device="stage", stiffness=1000.0)
    text = str(Variants({"drop": run(scene, plant="exact")}).table())
    for words in ("device stage", "mass 0.3 kg", "1000 Hz, delay 0.9 ms", "the device's 33 N limit", "range of 2 mm"):
        assert words in " ".join(text.split()), words
    with pytest.raises(ParameterError, match=r"height must be above 0 and below 0.02 m|height must be below 0.02 m"):
        Drop(device="stage", height=0.03)
    with pytest.raises(ParameterError, match="device must be one of arm, stage, ubc, or a file"):
        Drop(device="moon")


def test_a_device_without_torque_gets_none() -> None:
    scene = find_scene("joystick")(device="arm")
    plant = scene.plant("exact")
    assert plant.given["wrench_limit"][3:].tolist() == [0.0, 0.0, 0.0]
