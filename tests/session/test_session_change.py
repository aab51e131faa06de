"""Changes of a running session, and its stops."""

from typing import Any

import numpy as np
import pytest

from maglev_mj.errors import ParameterError
from maglev_mj.parameters import param
from maglev_mj.plants.hand import SpringHand
from maglev_mj.scenes import Scene
from maglev_mj.scenes.interactive import Joystick
from maglev_mj.session import Pacer, Session, changed
from maglev_mj.views.readings import banner

FRAME = 1.0 / 60.0


def made(scene: Scene | None = None, **options: Any) -> Session:
    """Return a session that no slow machine can make late."""
    return Session(scene, pacer=Pacer(budget=60.0, patience=3600.0), **options)


@pytest.mark.parametrize("axis", [4, pytest.param(0, marks=pytest.mark.study)])
def test_a_change_keeps_the_force_until_the_next_answer_acts(axis: int) -> None:
    # At rest under a hand, 4 ms of every period pass under the force of before the change.
    hand = SpringHand(target=[(0.01 if axis < 3 else 0.3) * (place == axis) for place in range(6)])
    session = made(Joystick(delay=0.004, wall=False), hand_force=hand)
    session.tick(3.0)
    before = session.snapshot()
    assert abs(before.force[axis]) > (0.1 if axis < 3 else 0.005)
    session.change({"damping": 21.0})
    session.tick(0.1)
    now = session.snapshot()
    assert now.since == before.tick and now.tick == before.tick + 20
    assert session._past.history.rows[-20:, 1:7] == pytest.approx(np.tile(before.pose, (20, 1)), abs=1e-6)


def test_changes_in_quick_succession_act_together() -> None:
    # A slider that is dragged at 50 Hz makes ten controllers a second, and the last value is in force at the end.
    session, begun = made(Joystick()), set()
    for frame in range(50):
        session.change({"stiffness": 3000.0 + frame})
        session.tick(0.02)
        begun.add(session.snapshot().since)
    assert len(begun) == pytest.approx(1.0 / 0.1, abs=2)
    session.tick(0.1)
    assert session._segment.scene == session.snapshot().scene == Joystick(stiffness=3049.0)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"stiffnes": 1.0}, "must be among period, delay, .*stiffness.* [(]got stiffnes"),
        ({"stiffness": -1.0}, "stiffness must be"),
        ({"time_scale": 0.0}, "time_scale must be between 0.001 and 1.*got 0.0"),
        ({"hand_stiffness": -1.0, "damping": 20.0}, "hand_stiffness must be"),
        ({"delay": -1.0, "time_scale": 0.1}, "delay must be"),
    ],
)
def test_a_change_that_is_refused_changes_nothing(given: dict[str, Any], said: str) -> None:
    session = made(Joystick())
    with pytest.raises(ParameterError, match=said):
        session.change(given)
    session.tick(0.2)
    now = session.snapshot()
    assert (now.scene, now.time_scale, now.hand_stiffness, now.since) == (Joystick(), 1.0, 200.0, 0)


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ({"period": 0.001}, "period is set by the device or the local user; other programs cannot change it"),
        ({"delay": 0.0}, "delay is set by the device or the local user; other programs cannot change it"),
        ({"stifness": 5.0, "scene": 1}, "parameters must be among wall, wall_on, .*, walls [(]got scene, stifness"),
        ({"damping": 10**400}, r"damping must be a finite number between 0 and 10000.* \(got 1000"),
        ({"walls": b"z"}, r"a wall must be \[axis, normal, edge\] \(got 122"),
    ],
)
def test_what_a_program_cannot_set_is_refused(given: dict[str, Any], reason: str) -> None:
    with pytest.raises(ParameterError, match=f"^{reason}"):
        changed(Joystick(), given)
    present = Joystick(friction=True, breakaway=1.5)
    wanted = changed(present, {"damping": 70, "pulse": False, "walls": [["rx", -1.0, 0.05]]})
    assert wanted == present.replace(damping=70.0, pulse=False, walls=(("rx", -1, 0.05),))


class Picky(Scene):
    """Laws that are made from 10 to 1000 alone."""

    level: float = param("level", default=100.0, live=True)

    def laws(self) -> list[Any]:
        if self.level < 10.0:
            raise ValueError("too low for me")
        if self.level > 1000.0:
            raise ParameterError("level must be at most 1000")
        return []


@pytest.mark.parametrize(
    ("level", "said"), [(2000.0, "level must be at most 1000"), (1.0, "ValueError: too low for me")]
)
@pytest.mark.parametrize("stopped", [False, True])
def test_what_a_scene_of_ones_own_refuses_changes_nothing_and_ends_no_stop(
    stopped: bool, level: float, said: str
) -> None:
    session = made(Picky())
    session.tick(0.1)
    if stopped:
        session.act("emergency stop")
    before = session.snapshot()
    with pytest.raises(ParameterError, match=said):
        session.change({"level": level})
    made_ticks = session.tick(0.2)
    now = session.snapshot()
    assert (now.scene, now.state, now.since) == (Picky(), "stopped" if stopped else "running", 0)
    assert made_ticks == (0 if stopped else 40) and now.tick == before.tick + made_ticks
    session.change({"level": 200.0})
    session.tick(0.01)
    assert (session.snapshot().scene, session.snapshot().state) == (Picky(level=200.0), "running")


def test_a_step_is_made_with_what_was_changed_just_before() -> None:
    session = made(Joystick())
    session.tick(0.1)
    session.act("pause")
    for stiffness in (4000.0, 3000.0):
        session.change({"stiffness": stiffness})
        session.act("step")
        session.tick(0.001)
        now = session.snapshot()
        assert session._segment.scene == now.scene == Joystick(stiffness=stiffness) and now.since == now.tick - 1


@pytest.mark.parametrize("scale", [0.002, 0.5])
def test_slow_motion_is_simulated_time_over_real_time(scale: float) -> None:
    session = made(Joystick(period=0.001, delay=0.0005))
    session.change({"time_scale": scale})
    for _ in range(60):
        session.tick(FRAME)
    assert session.simulated == pytest.approx(scale, abs=0.0011)
    assert session.snapshot().time_scale == scale


def test_stops_do_nothing_away_from_them() -> None:
    session = made(Joystick(wall=False), hand_force=SpringHand(target=[9e-3, *[0.0] * 5]))
    session.change({"hand_stiffness": 2000.0})
    session.tick(0.005)
    assert session.snapshot().hand[0] == pytest.approx(2000.0 * 9e-3)
    session.tick(0.5)
    assert session.snapshot().stops[0] < -0.5
    session.hand.target = None
    session.act("centre")
    session.tick(0.2)
    assert not session.snapshot().stops.any()


def test_a_machine_that_is_too_slow_has_a_banner() -> None:
    session = Session(pacer=Pacer(budget=1e-9, patience=0.01))
    session.tick(1.0)
    said = banner(session.snapshot())
    assert (
        said is not None and said.text.startswith("Running slower") and said.resume_action in session.snapshot().actions
    )
