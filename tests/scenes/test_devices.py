"""Scenes on the devices of the package: figures, warnings, verdicts and both plants."""

from __future__ import annotations

import math
from itertools import product
from typing import Any

import numpy as np
import pytest

from maglev_mj import find_scene, run
from maglev_mj.control.loop import drive
from maglev_mj.device import Device, devices
from maglev_mj.errors import ParameterError
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.names import BUILT_IN
from maglev_mj.scenes.results import Variants
from maglev_mj.session.actions import changed
from maglev_mj.theory import stability
from tests.all_of import SCENES

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


@pytest.mark.parametrize(("stiffness", "radius"), [(6000.0, 0.901073213805), (60000.0, 1.073331889117)])
def test_verdict_by_a_loop_written_out(stiffness: float, radius: float) -> None:
    mass, period, delay, damping, lag = 0.3, 1e-3, 9e-4, 80.0, 1e-4

    def flow(time: float) -> Any:
        """Return the map of position, speed, force of the lagging drivers, and command."""
        left = lag * -math.expm1(-time / lag)
        double = lag * (time - left)
        return np.array(
            [
                [1.0, time, double / mass, (time**2 / 2.0 - double) / mass],
                [0.0, 1.0, left / mass, (time - left) / mass],
                [0.0, 0.0, 1.0 - left / lag, left / lag],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )

    old, new = np.zeros((4, 5)), np.zeros((4, 5))  # of position, speed, force, last command and last position
    old[:, :4] = flow(delay)
    new[:3], new[3] = old[:3], [-stiffness - damping / period, 0.0, 0.0, 0.0, damping / period]
    loop = np.vstack([flow(period - delay)[:3] @ new, new[3], [1.0, 0.0, 0.0, 0.0, 0.0]])
    assert np.abs(np.linalg.eigvals(loop)).max() == pytest.approx(radius, abs=1e-9)
    states = stability(Drop(device="stage", stiffness=stiffness)).states
    assert [one.spectral_radius for one in states if "contact" in one.acting] == pytest.approx([radius], abs=1e-9)


def test_warnings_and_headers_have_the_numbers_of_the_device() -> None:
    scene = Drop(device="stage", stiffness=1000.0, force_limit=0.0)
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


def like_the_stage(mass: float, rate: float, delay: float) -> Device:
    """Return the stage with another mass, sample rate and delay in periods."""
    stage = Device.load("stage").change("sensor", latency=0.0).change("loop", rate=rate, delay=delay / rate)
    return stage.change("body", mass=mass, inertia=[part * mass / stage.mass for part in stage.body.inertia])


@pytest.mark.parametrize("name", SCENES)
def test_no_scene_diverges_at_the_defaults_of_a_device(name: str) -> None:
    for mass, rate, delay in product((0.25, 0.7, 2.0), (200.0, 500.0), (0.2, 1.0)):
        scene = find_scene(name)(device=like_the_stage(mass, rate, delay).toml())
        for variant in scene.variants().values():
            drive(variant.plant("exact"), variant.controller(), variant.ticks(variant.timing()))  # or DivergenceError


def test_default_gains_are_the_published_ones_or_as_stable() -> None:
    for name in ("drop", "press", "joystick", "table", "box", "corner", "stick-slip"):
        scene = find_scene(name)()
        assert (scene.stiffness, scene.damping) == (6000.0, 80.0)  # type: ignore[attr-defined]
    assert Drop().pulse == 220.0 and Drop(mass=0.25, period=0.002).pulse == 220.0  # of the device alone
    for mass, rate, delay in product((0.25, 2.0), (100.0, 200.0, 1000.0), (0.0, 0.3, 1.0)):
        device = like_the_stage(mass, rate, delay)
        drop, period = Drop(device=device.toml()), device.period
        most = (6000.0 * 0.005**2 / 0.7, 80.0 * 0.005 / 0.7, 220.0 * 0.003 / 0.7)
        own = drop.stiffness * period**2, drop.damping * period, drop.pulse * min(period, 0.003)
        assert all(part / mass <= limit * (1.0 + 1e-12) for part, limit in zip(own, most))
        assert drop.stiffness <= 6000.0 and drop.damping <= 80.0 and drop.pulse <= 220.0


def test_a_key_toggles_a_derived_gain() -> None:
    light = Drop(device=like_the_stage(0.25, 200.0, 0.3).toml())
    for name in ("damping", "pulse"):
        off = changed(light, name)
        assert getattr(off, name) == 0.0 < getattr(changed(off, name), name) == getattr(light, name)
