"""Robots that follow: contact, repetition, the coupling's limit, and what the viewers draw."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import maglev_mj
import teleoperate
from maglev_mj import Controller, ExactPlant, Session, Timing, drive, judge, run, stability
from maglev_mj.errors import ModelError, PlantError
from maglev_mj.frames import Array
from maglev_mj.interop.teleoperation import Coupling, Robot, Teleoperation
from maglev_mj.session import Snapshot

BALL = teleoperate.ROBOT.replace('timestep="1e-4"', 'timestep="5e-4"')
FREE = """<mujoco><option gravity="0 0 0" integrator="RK4"/><worldbody><body><freejoint/><geom size=".01" mass="1"/>
<site name="tool"/></body></worldbody></mujoco>"""
ARM = """<mujoco><option gravity="0 0 0"/><worldbody><body><joint axis="0 1 0"/><geom type="capsule" size=".02" mass="2"
fromto="0 0 0 .3 0 0"/><body pos=".3 0 0"><joint axis="0 1 0"/><joint axis="0 0 1"/><geom type="capsule" size=".02"
fromto="0 0 0 0 0 .3" mass="1"/><site name="tool" pos="0 0 .3"/></body></body></worldbody>
<keyframe><key qpos=".3 -.2 .1"/></keyframe></mujoco>"""
ROBOTS = {"slides": BALL, "free": FREE, "arm": ARM}


def follow(model: str, factor: float = 10.0) -> type[Teleoperation]:
    class Follow(Teleoperation):
        """Follow the joystick."""

        robot, site, scale = model, "tool", factor

    return Follow


def growth(model: str, rate: int, share: float) -> tuple[float, float]:
    """Return measured and computed growth of the joystick's oscillation from sample to sample, both bodies free.

    Fourth differences leave out that both drift.
    """
    timing = Timing(period=1.0 / rate, delay=0.3 / rate)
    scene = follow(model.replace("5e-4", f"{0.1 / rate}"))(period=timing.period, delay=timing.delay, share=share)
    controller, places = Controller([Coupling(scene)], period=timing.period), list[float]()
    plant = ExactPlant(timing, pose=[1e-4, 0.0, 0.0, 0.0, 0.0, 0.0], gravity=0.0)
    drive(plant, controller, 400, observe=lambda sample, _: places.append(float(sample.position[0])))
    bends: Array = np.diff(places, 4)[-200:]
    first, last = (float(np.sqrt(np.mean(part**2))) for part in (bends[:100], bends[100:]))
    return (last / first) ** (1.0 / 100), judge(controller, delay=timing.delay).spectral_radius


@pytest.mark.parametrize("model", ["slides", "free"])
@pytest.mark.parametrize("rate", (200, pytest.param(1000, marks=pytest.mark.study)))
def test_two_free_bodies_have_the_bound_of_a_wall_on_their_reduced_mass(rate: int, model: str) -> None:
    for share in (0.95, 1.05):
        measured, computed = growth(ROBOTS[model], rate, share)
        assert (measured > 1.0) == (computed > 1.0) == (share > 1.0)
        assert measured == pytest.approx(computed, abs=1e-3)


@pytest.mark.parametrize("model", ROBOTS)
def test_every_robot_follows_and_a_run_repeats_bit_for_bit(model: str) -> None:
    scene = follow(ROBOTS[model])(push=0.05)
    first, again = (run(scene).trace.pose for _ in range(2))
    assert np.array_equal(first, again) and np.abs(first).max() > 1e-4
    assert stability(scene).stable
    robot = scene.follower
    moved = robot.data.site_xpos[robot.site] - robot.origin
    assert moved[2] / scene.scale == pytest.approx(first[-1, 2], abs=5e-4)  # up to the extension of the spring


def test_the_force_of_the_block_is_that_of_the_hand() -> None:
    scene = follow(BALL)()
    height = run(scene).trace.pose[-1, 2]
    robot = scene.follower
    assert robot.data.qfrc_constraint[2] == pytest.approx(3.0 * scene.scale, rel=1e-3)
    extension = height - robot.data.site_xpos[robot.site][2] / scene.scale
    assert scene.coupling[0] * extension == pytest.approx(-3.0, rel=1e-3)  # the hand's, which the coupling carries on


def test_the_apparent_mass_is_that_of_the_weakest_direction() -> None:
    assert Robot(FREE, "tool").mass == pytest.approx(1.0)
    robot = Robot(ARM, "tool")
    moved = []
    for direction in np.random.default_rng(0).normal(size=(100, 3)):
        direction /= np.linalg.norm(direction)
        robot.place(robot.start)
        robot.pull(direction, 1e-4)  # in one semi-implicit step
        moved.append(float(robot.place(robot.state()) @ direction) / 1e-8)
    assert 1.0 / max(moved) == pytest.approx(robot.mass, rel=0.05) and max(moved) < 1.001 / robot.mass


def test_the_stability_check_does_not_run_the_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    def answered(*_: object) -> None:
        raise AssertionError("the law was asked")

    monkeypatch.setattr(Coupling, "__call__", answered)
    scene = teleoperate.Teleoperate()
    assert stability(scene).stable and not stability(scene.replace(share=1.05)).stable


@pytest.mark.parametrize("model", ROBOTS)
def test_a_session_shows_the_robot_where_it_is(model: str) -> None:
    session = Session(follow(ROBOTS[model])())
    before = session.snapshot()
    assert len(before.scene.beside()) == len(before.beside) > 0
    session.hand.target = [0.0, 0.0, -2e-3, 0.0, 0.0, 0.0]
    for _ in range(40):
        session.tick(0.005)
    after = session.snapshot()
    session.close()
    moved = np.abs(after.beside - before.beside)[:, :3].max()
    assert moved == pytest.approx(-after.pose[2], rel=0.5)  # as far as the knob
    assert np.allclose(np.linalg.norm(after.beside[:, 3:], axis=1), 1.0)


KEY = """<mujoco><option timestep="0.005" integrator="Euler" gravity="0 0 0"/><worldbody>
<body><joint type="slide" axis="0 0 1"/><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>
<geom size=".01" mass="1"/><site name="tool"/></body>
<body pos="0 0 -.026"><joint type="slide" axis="0 0 1" stiffness="1e6"/><geom size=".01" mass="0.001"/></body>
</worldbody></mujoco>"""


def test_a_robot_that_diverges_is_an_error_and_starts_again_unharmed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    scene = follow(KEY)(push=5.0)
    message = r"MuJoCo warns of the robot at 0\.\d+ s: mjWARN_BADQACC; reduce its time step"
    for _ in range(2):  # the robot is shared, and so are its counts
        with pytest.raises(PlantError, match=message):
            run(scene)
    session = Session(scene)
    session.hand.target = [0.0, 0.0, -4e-3, 0.0, 0.0, 0.0]
    for _ in range(400):
        session.tick(0.005)
    shown = session.snapshot()
    session.close()
    assert shown.state == "stopped" and re.match(message, shown.reason)
    robot = scene.follower
    assert not robot.place(robot.start).any()
    robot.pull(np.zeros(3), 0.005)
    assert not list(tmp_path.glob("*LOG*"))


def test_what_steps_the_engine_looks_at_its_warnings() -> None:
    modules = {path: path.read_text(encoding="utf-8") for path in Path(maglev_mj.__file__).parent.rglob("*.py")}
    calls = re.compile(r"mujoco\.mj_step\(|_engine\.step\(")
    stepping = {path.stem: text for path, text in modules.items() if calls.search(text)}
    assert {"teleoperation", "mujoco", "engine"} <= stepping.keys()
    del stepping["engine"]  # steps for mujoco.py
    assert all(".warning" in text for text in stepping.values()), "compare the counts in data.warning; see Robot.pull"


@pytest.mark.parametrize(
    "text, message", [("<mujoco/>", "robot is invalid: .*tool"), ("none.xml", "robot is invalid: ")]
)
def test_an_invalid_robot_is_one_line(text: str, message: str) -> None:
    with pytest.raises(ModelError, match=message) as caught:
        follow(text)().controller()
    assert "\n" not in str(caught.value)


@pytest.mark.machine
@pytest.mark.needs("drawing")
def test_the_window_draws_the_robot() -> None:
    from maglev_mj.views.window.offscreen import _drawing

    session = Session(follow(BALL)())
    shown: Snapshot = session.snapshot()
    session.close()
    with _drawing(shown.scene, 320, 240, plots=False) as picture:
        pictures: list[Any] = [picture(shown)]
        bare = Snapshot(**{**vars(shown), "beside": np.empty((0, 7))})
        pictures.append(picture(bare))
    changed = (pictures[0] != pictures[1]).any(axis=2)
    assert 20 < changed.sum() < 5000
