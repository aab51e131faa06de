"""Position and rate control of a slave by one stick."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from maglev_mj.control.loop import ControlLoop
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array
from maglev_mj.interop.navigation import Navigation, Navigator
from maglev_mj.plants.hand import SpringHand
from maglev_mj.scenes.interactive import CENTRING, Joystick
from maglev_mj.session import live_plant
from tests.published import WEIGHT
from tests.sweeps import sweep

FRAME = 1.0 / 60.0
EDGE, GAIN, GIVE = 0.0025, 10.0, 2.0 / 6000.0
SLIDES = np.full(6, np.nan)
LONG = 0.1  # enough for a push to count


def along(x: float) -> Array:
    """Return a pose that is deflected along x alone."""
    return np.array([x, 0.0, 0.0, 0.0, 0.0, 0.0])


def stuck(anchor: float) -> Array:
    """Return stick positions: given on x, centre on the others."""
    return along(anchor)


def sliding(anchor: float = 0.0) -> Navigator:
    """Return a navigator with a flotor stuck at the centre."""
    navigator = Navigator()
    navigator.move(along(anchor), stuck(anchor), 0.0)
    return navigator


def test_a_parameter_a_pose_or_a_time_that_cannot_be_is_refused() -> None:
    values = {"edge": math.inf, "scale": math.nan, "gain": [1.0, 2.0], "give": "much", "breakaway": 0.0}
    for name, value in values.items():
        with pytest.raises(ParameterError, match=f"^{name} must be .*$"):
            Navigation(**{name: value})  # type: ignore[arg-type]
    for pose, elapsed in (([0.0] * 5, FRAME), ([math.nan] * 6, FRAME), ([0.0] * 6, -FRAME), ([0.0] * 6, math.nan)):
        with pytest.raises(ParameterError):
            Navigator().move(pose, None, elapsed)


@pytest.mark.parametrize("friction", [True, False])
def test_the_slave_never_jumps_whatever_the_hand_does(friction: bool) -> None:
    # Each increment is its mode's to the last bit: the flotor's way, or that of the rate.
    random = np.random.default_rng(0)
    chosen = Navigation(scale=random.uniform(0.2, 5.0, 6), gain=random.uniform(1.0, 30.0, 6))
    edge, scale, gain, give = (np.asarray(one) for one in (chosen.edge, chosen.scale, chosen.gain, chosen.give))
    navigator, seen = Navigator(chosen), set()
    pose, anchors, total = np.zeros(6), np.zeros(6), np.zeros(6)
    navigator.move(pose, anchors if friction else None, 0.0)
    for _ in range(800):
        before = pose
        pose = np.clip(pose + random.normal(0.0, 0.2, 6) * edge, -1.8 * edge, 1.8 * edge)
        anchors = np.where(random.random(6) < 0.5, pose - random.uniform(-1.0, 1.0, 6) * give, np.nan)
        elapsed = random.uniform(0.0, 2.0 * FRAME)
        moved = navigator.move(pose, anchors if friction else None, elapsed)
        beyond = pose - edge * np.sign(pose)
        rate = navigator.rates
        seen |= set(rate.tolist())
        assert (moved == np.where(rate, gain * beyond * elapsed, scale * (pose - before))).all()
        assert (np.abs(pose[rate]) > edge[rate]).all()
        total = total + moved
    assert seen == {False, True}
    assert (navigator.slave == total).all()


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_mode_follows_the_push_of_the_hand_with_hysteresis(side: float) -> None:
    # By the stretch of the friction's spring, or by what the device gives where that is known: a wall may hold the
    # flotor, so that the spring is not stretched; or a spring may pull it inward.
    shares = [0.0, 0.24, 0.26, 0.9, 0.2, 0.11, 0.09, 0.2, 0.26, -0.5, 0.24]
    by_stretch, by_force = sliding(side * 0.003), sliding(side * 0.003)
    stretched, forced = [], []
    for share in shares:
        by_stretch.move(along(side * (0.003 + share * GIVE)), stuck(side * 0.003), LONG)
        by_force.move(along(side * 0.003), stuck(side * 0.003), LONG, along(-side * share * 2.0))
        stretched.append(by_stretch.rates[0])
        forced.append(by_force.rates[0])
    assert stretched == forced == [False, False, True, True, True, True, False, False, True, False, False]


def test_a_push_counts_where_it_lasts_for_a_tenth_of_a_second() -> None:
    # A flotor that has been let go rings, and its spring is stretched outward for a while.
    navigator, modes = sliding(0.003), []
    for share in [0.5] * 6 + [0.0] + [0.5] * 9:
        navigator.move(along(0.003 + share * GIVE), stuck(0.003), 1.0 / 64.0)
        modes.append(navigator.rates[0])
    assert modes == [False] * 13 + [True] * 3


def test_sliding_outward_beyond_the_edge_is_rate_and_inward_is_position() -> None:
    navigator = sliding()
    modes = []
    for x in (0.002, 0.003, 0.004, 0.0038, 0.003, 0.0031, 0.001, -0.003, -0.0035, -0.003):
        navigator.move(along(x), SLIDES, FRAME)
        modes.append(navigator.rates[0])
    assert modes == [False, True, True, False, False, True, False, True, True, False]


def test_an_axis_that_has_never_stuck_has_no_friction_and_is_rate_beyond_the_edge() -> None:
    # On a table there is friction on x and y alone: anchors of the others are never there.
    table = np.array([0.0, 0.0, *[math.nan] * 4])
    navigator = Navigator()
    navigator.move(np.zeros(6), table, 0.0)
    navigator.move([0.003, 0.0, 0.003, 0.0, 0.0, 0.0], SLIDES, FRAME)
    navigator.move([0.003, 0.0, 0.003, 0.0, 0.0, 0.0], SLIDES, FRAME)
    assert navigator.rates[[0, 2]].tolist() == [False, True]


def test_a_flotor_put_elsewhere_does_not_move_the_slave() -> None:
    navigator = Navigator()
    navigator.move(along(0.001), None, FRAME)
    navigator.move(along(0.002), None, FRAME)
    navigator.restart()
    assert not navigator.move(along(-0.002), None, FRAME).any()
    assert navigator.slave[0] == pytest.approx(0.001, abs=1e-15)


# -- the joystick in the loop ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Push:
    """Hand of 1000 N/m: pull, press, release.

    Attributes:
        target: First target [m].
        press: Additional distance from 0.5 s on [m].
        release: Time of release [s].
    """

    target: float
    press: float
    release: float


END = 1.8
EVERY = 1.0 / 60.0


def pushed(
    push: Push, scene: Joystick, navigation: Navigation | None = None, *, forces: bool = True
) -> dict[str, Array]:
    """Return time, position, slave and mode along x.

    At 60 frames a second of the joystick's scene.
    """
    hand, navigator = SpringHand(stiffness=1000.0, damping=20.0), Navigator(navigation)
    plant, controller = live_plant(scene, hand), scene.controller()
    given: list[Array] = []
    loop = ControlLoop(plant, controller, observe=lambda sample, applied: given.append(np.array(applied.force)))
    rows: list[tuple[float, ...]] = []
    for tick in range(round(END / scene.period)):
        time = tick * scene.period
        reach = push.target + (push.press if time >= 0.5 else 0.0)
        hand.target = None if time >= push.release else along(reach).tolist()
        loop.cycle()
        if time >= len(rows) * EVERY:
            pose, elapsed = plant.state()[0], time - rows[-1][0] if rows else 0.0
            navigator.move(pose, controller.stick_positions, elapsed, given[-1] - np.array(WEIGHT) if forces else None)
            rows.append((time, pose[0], navigator.slave[0], navigator.rates[0]))
    plant.close()
    time, position, slave, rate = np.array(rows).T
    return {"time": time, "position": position, "slave": slave, "rate": rate.astype(bool)}


@pytest.mark.parametrize(
    ("target", "press", "release", "forces"),
    sweep([0.0042, 0.0050, -0.0046], [0.0003, 0.001], [1.0, 1.0025, 1.005, 1.0075, 1.011], [True, False], every=8),
)
def test_a_hand_that_lets_go_beyond_the_edge_leaves_the_slave_where_it_is(
    target: float, press: float, release: float, forces: bool
) -> None:
    side = math.copysign(1.0, target)
    run = pushed(Push(target, side * press, release), Joystick(friction=True, wall=False), forces=forces)
    time, position, slave, rate = (run[name] for name in ("time", "position", "slave", "rate"))
    held = (time > 0.65) & (time < release)
    assert rate[held].all()  # a hand that holds still goes on with the rate
    speed = side * np.diff(slave[held]) / np.diff(time[held])
    assert speed == pytest.approx(GAIN * (side * position[held][1:] - EDGE), rel=1e-9)

    after = np.flatnonzero(time >= release)
    let_go = after[0] - 1
    in_rate = int(rate[after].sum())
    assert in_rate <= 1 and not rate[after[in_rate:]].any()
    assert side * position[-1] > EDGE  # friction holds the flotor there
    # from there on position: the slave keeps its distance to the flotor
    kept = slave[after[in_rate:]] - position[after[in_rate:]]
    assert np.ptp(kept) < 1e-12
    # which comes back by what the hand had stretched the springs of friction and centring
    given = -1000.0 * (target + side * press - position[let_go]) / (6000.0 + CENTRING)
    assert position[-1] - position[let_go] == pytest.approx(given, abs=2e-6)
    ahead = side * (slave[-1] - slave[let_go] - given)
    assert -2e-6 < ahead < GIVE + GAIN * 0.002 * EVERY  # a frame in rate mode comes back by less
    assert np.ptp(slave[time > 1.5]) < 1e-6
    assert abs(slave[-1]) > 4e-3


@pytest.mark.parametrize("friction", [True, False])
def test_without_friction_a_slave_by_position_is_returned_when_the_hand_lets_go(friction: bool) -> None:
    # What the paper holds against a joystick with a centring spring, and what friction does about it.
    by_position = Navigation(edge=1.0)
    run = pushed(Push(0.0045, 0.0005, 1.0), Joystick(friction=friction, wall=False), by_position)
    before, after = run["slave"][run["time"] < 1.0][-1], run["slave"][-1]
    assert before > 0.003
    assert after > 0.9 * before if friction else abs(after) < 0.01 * before


def test_a_hand_that_holds_against_a_wall_goes_on_with_the_rate_until_it_lets_go() -> None:
    target = -0.007
    # The wall at 3.5 mm holds the flotor, and the friction's spring alone would tell nothing.
    run = pushed(Push(target, 0.0, 1.0), Joystick(friction=True, wall=True))
    time, rate, slave = run["time"], run["rate"], run["slave"]
    assert rate[(time > 0.5) & (time < 1.0)].all()
    assert rate[time >= 1.0].sum() <= 1
    assert abs(slave[-1]) > 6e-3
    blind = pushed(Push(target, 0.0, 1.0), Joystick(friction=True, wall=True), forces=False)
    assert not blind["rate"][(time > 0.5) & (time < 1.0)].any()
