"""Other simulators perform the same task with known accuracy."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import speed_accuracy
from maglev_mj import ExactPlant, Timing, drive
from maglev_mj.frames import Array
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.wall_scene import wall_controller
from maglev_mj.spec import GRAVITY, INERTIA
from peers import Task, available
from work_precision import WorkPoint, pareto

SCENES = ["drop", "drop-no-pulse", "press", "stick-slip", "twist", "six-axes"]

EXACT = {
    "mujoco": ("split, RK4", "split, Euler, half-kick", "RK4, steps of 0.5 ms"),
    "drake": ("scripted, RK2", "LeafSystem, RK2"),
    "pybullet": ("step an interval, corrected, force as gravity",),
    "scipy": ("solve_ivp an interval, RK45, default tolerances", "ode an interval, dopri5, one step"),
    "pinocchio": ("mean velocity, step an interval",),
    "control": ("ss, sampled for each length, A x + B u", "nlsys an interval, RK23, one step"),
}
"""Variants that are exact to rounding in translation."""


def truth(task: Any) -> tuple[Array, Array]:
    """Return true poses and commanded wrenches.

    Their shapes are (81, 6) and (80, 2, 6).
    """
    plant = ExactPlant(Timing(delay=task.delay), pose=task.pose)
    gains: dict[str, Any] = {"stiffness": 6000.0, "damping": 80.0, "pulse": 220.0, "pulse_width": task.pulse_width}
    controller = wall_controller(period=0.005, delay=task.delay, mass=0.7, **gains)
    poses: list[Array] = []
    wrenches: list[Array] = []

    def keep(sample: Any, command: Any) -> None:
        poses.append(sample.pose)
        wrenches.append(np.array([command.wrench, command.wrench + command.pulse]))

    last = drive(plant, controller, task.ticks, observe=keep)
    return np.array([*poses, last.pose]), np.array(wrenches)


def test_the_task_of_the_peers_is_the_drop_of_this_device() -> None:
    # Its numbers are copies on purpose: the peers run without this package.
    task, drop = Task(), Drop()
    assert (*[task.mass] * 3, *task.inertia) == INERTIA
    assert (task.gravity, task.offset[2]) == (GRAVITY, drop.height) == (-drop.body.gravity[2], drop.start().pose[2])
    assert (task.ticks, task.duration) == (drop.end / drop.period, drop.end)
    assert drop.device == Drop.parameter("device").default
    for name in ("mass", "period", "delay", "stiffness", "damping", "pulse", "pulse_width"):
        assert getattr(task, name) == getattr(drop, name)


@pytest.mark.parametrize(
    "peer", [pytest.param(one, marks=[pytest.mark.needs(one)] * (one != "mujoco")) for one in EXACT]
)
@pytest.mark.filterwarnings("default")
def test_a_peer_that_is_said_to_be_exact_is(peer: str, capfd: pytest.CaptureFixture[str]) -> None:
    variants, missing = available([peer])
    assert not missing
    named = {variant.name: variant for variant in variants}
    task = Task()
    poses, _ = truth(task)
    for name in EXACT[peer]:
        simulate = named[name].build(task)
        for _ in range(2):  # a run begins anew
            assert np.abs(simulate() - poses).max() < 1e-13, name
    with pytest.raises(ValueError, match="peer must be one of mujoco, drake"):
        available(["gazebo"])


def test_steps_that_miss_what_they_should_not_are_seen_to() -> None:
    task = Task()
    poses, _ = truth(task)
    named = {variant.name: variant for variant in available(["mujoco"])[0]}
    raw, native, callback = (
        float(np.abs(named[name].build(task)() - poses).max())
        for name in ("Euler, steps of 0.1 ms", "native delay, RK4, steps of 0.5 ms", "callback, RK4, steps of 0.5 ms")
    )
    assert raw == pytest.approx(81e-6, rel=0.05)
    # the last stage of RK4 sees the command that begins where it ends
    assert native == pytest.approx(180e-6, rel=0.1) and callback == pytest.approx(180e-6, rel=0.1)


def test_a_way_that_another_beats_in_both_is_not_on_the_front() -> None:
    points = [
        WorkPoint("cheap", "a", 1.0, 1e-3),
        WorkPoint("beaten", "a", 2.0, 2e-3),
        WorkPoint("exact enough", "b", 3.0, 2e-10),
        WorkPoint("more exact", "b", 4.0, 1e-18),
        WorkPoint("dear", "b", 5.0, 1e-6),
    ]
    assert [point.name for point in pareto(points)] == ["cheap", "exact enough"]


@pytest.mark.study
@pytest.mark.filterwarnings("default")
def test_the_chart_holds_every_scene_and_says_what_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["speed_accuracy.py", "--out", str(tmp_path), "--quick", "--scenes", *SCENES])
    speed_accuracy.main()
    data = json.loads((tmp_path / "speed_accuracy.json").read_text())
    assert list(data["scenes"]) == SCENES
    for scene in data["scenes"].values():
        errors = {method["name"]: method["error"] for method in scene["methods"]}
        assert scene["front"] and set(scene["front"]) <= set(errors)
        assert errors["rk4, one step per interval"] < 1e-9 < errors["euler, one step per interval"]
    disagreement = data["sweep"]["disagreement"]
    assert disagreement["MuJoCo, corrected"] == disagreement["MuJoCo, rk4"] == 0 < disagreement["MuJoCo, raw euler"]
    assert data["boundary"]["orders"]["euler"] == pytest.approx(1.0, abs=0.1)
    for name in (*(f"speed_accuracy_{scene}" for scene in SCENES), "speed_accuracy_peers", "speed_accuracy_steps"):
        assert (tmp_path / f"{name}.png").is_file()
