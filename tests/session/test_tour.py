"""Guided tour by a scripted user."""

from collections.abc import Callable

import pytest

from maglev_mj.errors import ParameterError
from maglev_mj.session import EMERGENCY_STOP, REWIND_ACTIONS, Pacer, Session, TourLine
from maglev_mj.session.tour import STEPS, Tour
from tests.sweeps import further

TICK = 0.02
PUSH, WALL, PULSE, STICK, STIFF, BUZZ, DELAY, MEND = range(1, 9)


class User:
    """User at a tour with the hand's spring and keys."""

    def __init__(self, step: int) -> None:
        self.tour = Tour(Session(pacer=Pacer(budget=60.0, patience=3600.0)))
        for _ in range(step - 1):
            self.tour.act("next")
        self.wait(0.3)

    @property
    def line(self) -> TourLine:
        line = self.tour.snapshot().tour
        assert line is not None
        return line

    def wait(self, seconds: float) -> None:
        for tick in range(round(seconds / TICK)):
            self.tour.tick(TICK)
            if tick % 5 == 4 and self.line.done:
                break

    def pull(self, x: float, seconds: float, *, slowly: float = 0.0, y: float = 0.0) -> None:
        """Pull to a position [m], at once or over time."""
        begin = self.tour.snapshot().target or [0.0] * 6
        for part in range(1, round(slowly / TICK) + 1):
            share = part * TICK / slowly
            drawn = [one + share * (end - one) for one, end in zip(begin, (x, y), strict=False)]
            self.tour.hand.target = [*drawn, 0.0, 0.0, 0.0, 0.0]
            self.tour.tick(TICK)
        self.tour.hand.target = [x, y, 0.0, 0.0, 0.0, 0.0]
        self.wait(seconds)

    def twist(self, turn: float) -> None:
        self.tour.hand.target = [0.0, 0.0, 0.0, turn, 0.0, 0.0]
        self.wait(1.0)

    def release(self, seconds: float) -> None:
        self.tour.hand.target = None
        self.wait(seconds)

    def press(self, action: str, times: int = 1) -> None:
        for _ in range(times):
            self.tour.act(action)
            self.wait(0.15)


def hit(user: User) -> None:
    user.pull(0.014, 0.5)


def hold(user: User) -> None:
    user.pull(0.013, 1.6)


def press(action: str, times: int = 1) -> Callable[[User], None]:
    return lambda user: user.press(action, times)


def then(*tasks: Callable[[User], None]) -> Callable[[User], None]:
    def do(user: User) -> None:
        for task in tasks:
            task(user)

    return do


RIGHT: dict[int, Callable[[User], None]] = {
    PUSH: lambda user: user.pull(0.004, 1.0),
    WALL: lambda user: user.pull(0.012, 1.5, slowly=2.0),
    PULSE: hit,
    STICK: lambda user: user.pull(0.005, 1.5, slowly=0.3),
    STIFF: press("stiffness up", 3),
    BUZZ: hold,
    DELAY: then(press("delay up", 5), hold),
    MEND: then(press("damping up", 5), hold),
}


def tap(user: User) -> None:
    """Hit the wall again and again, and never hold it."""
    for _ in range(4):
        user.pull(0.014, 0.25)
        user.release(0.25)


def shake(user: User) -> None:
    """Shake the handle in the wall at 5 Hz."""
    for _ in range(10):
        user.pull(0.026, 0.1)
        user.pull(0.012, 0.1)


WRONG: dict[str, tuple[int, Callable[[User], None]]] = {
    "too gentle": (PUSH, lambda user: user.pull(0.002, 1.0)),
    "a twist": (PUSH, lambda user: user.twist(0.1)),
    "not so far": (WALL, lambda user: user.pull(0.008, 1.0, slowly=0.5)),
    "a twist in the wall": (WALL, lambda user: user.twist(0.5)),
    "no wall": (WALL, then(press("wall"), hit)),
    "slowly": (PULSE, lambda user: user.pull(0.012, 1.0, slowly=2.0)),
    "no friction": (STICK, then(press("friction"), lambda user: user.pull(0.005, 1.0, slowly=0.3))),
    "to the wall": (STICK, lambda user: user.pull(0.016, 1.0)),
    "moving": (STICK, then(lambda user: user.pull(0.01, 0.0), lambda user: user.pull(0.015, 0.0, slowly=1.0))),
    "unstable by delay": (STIFF, press("delay up", 12)),
    "tapping": (BUZZ, tap),
    "softer and shaken": (BUZZ, then(press("stiffness down", 3), shake)),
    "unstable by stiffness": (DELAY, then(press("stiffness up", 5), hold)),
    "not held": (MEND, then(press("damping up", 5), lambda user: user.wait(1.5))),
    "by the delay": (MEND, then(press("delay down", 5), hold)),
}
COSTLY = {"a twist in the wall", "no wall", "to the wall", "tapping", "unstable by stiffness", "not held"}


@pytest.mark.parametrize("name", [*sorted(WRONG.keys() - COSTLY), *further(*sorted(COSTLY))])
def test_a_step_is_not_done_by_another_action(name: str) -> None:
    step, task = WRONG[name]
    user = User(step)
    task(user)
    user.release(0.2)
    assert (user.line.number, user.line.done) == (step, False)


def test_what_was_done_before_a_step_does_not_count() -> None:
    # The handle is still in the wall, and then on its way back, when the step begins; nobody holds it any more.
    user = User(PUSH)
    user.pull(0.014, 0.0)
    for _ in range(50):
        user.tour.tick(TICK)
    assert user.tour.snapshot().pose[0] > 0.0035
    user.tour.hand.target = None
    user.tour.act("next")
    user.wait(1.0)
    assert (user.line.number, user.line.done) == (WALL, False)
    user.tour.hand.target = [0.008, 0.0, 0.0, 0.0, 0.0, 0.0]
    for _ in range(50):
        user.tour.tick(TICK)
    user.tour.hand.target = None
    user.tour.act("back")
    assert user.tour.snapshot().pose[0] > 0.002
    user.wait(1.0)
    assert (user.line.number, user.line.done) == (PUSH, False)
    hit(user)
    user.release(0.2)
    assert user.tour.snapshot().pulses > 0
    for _ in range(PULSE - user.line.number):
        user.tour.act("next")
    user.wait(0.5)
    assert (user.line.number, user.line.done) == (PULSE, False)


def test_a_wall_is_quiet_for_a_second_before_it_is_mended() -> None:
    user = User(MEND)
    hold(user)
    for _ in range(5):
        user.tour.act("damping up")
    user.wait(0.5)
    assert not user.line.done
    user.wait(1.5)
    assert user.line.done


def test_a_step_goes_on_after_the_scene_was_started_again() -> None:
    user = User(WALL)
    user.wait(3.0)
    user.press("next")
    user.press("back")  # the step begins at 3 s of the scene's time
    user.press("centre")
    hit(user)
    assert user.tour.snapshot().time < 1.0 and user.line.done


def test_the_whole_tour_is_done_in_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("maglev_mj.session.tour._PAUSE", 1.0)
    user = User(1)
    for step, task in RIGHT.items():
        assert user.line.number == step and not user.line.done
        task(user)
        assert user.line.done, user.line
        user.tour.hand.target = None
        for _ in range(round(1.1 / TICK)):
            user.tour.tick(TICK)
        assert user.tour.snapshot().state == "running"
    assert user.line.task.startswith("Done. This completes the tour")


def test_steps_are_left_by_keys_in_both_directions_and_begin_with_their_own_parameters() -> None:
    user, numbers = User(1), list[int]()
    for action in ("back", *["next"] * (len(STEPS) + 1), "back"):
        user.tour.act("damping up")
        user.tour.act("friction")
        user.tour.act(action)
        numbers.append(user.line.number)
        scene, own = user.tour.snapshot().scene, STEPS[user.line.number - 1].parameters
        assert {name: getattr(scene, name) for name in own} == own
    assert numbers == [1, *range(2, len(STEPS) + 1), len(STEPS), len(STEPS), DELAY]
    assert user.tour.snapshot().scene.delay == 0.0015


def test_a_tour_takes_what_leaves_the_joystick_as_it_is() -> None:
    user = User(1)
    actions = user.tour.snapshot().actions
    assert {"next", "back", "pause", "centre", "slower", EMERGENCY_STOP, "stiffness up"} <= set(actions)
    assert user.tour.snapshot().rewound is None
    for action in ("next scene", "scene drop", "drop", *REWIND_ACTIONS):
        assert action not in actions
        with pytest.raises(ParameterError, match="action must be one of next, back"):
            user.tour.act(action)
    user.tour.act("pause")
    assert user.tour.snapshot().state == "paused"
    with pytest.raises(ParameterError, match="stiffness"):
        user.tour.change({"stiffness": -1.0})


def test_a_scene_that_made_energy_starts_again_by_itself() -> None:
    user = User(BUZZ)
    user.tour.change({"stiffness": 40000.0})
    user.pull(0.02, 0.0)
    for _ in range(500):
        user.tour.tick(TICK)
        if user.tour.snapshot().state == "stopped":
            break
    assert "was stopped" in user.line.task and not user.line.done
    user.tour.hand.target = None
    for _ in range(round(2.2 / TICK)):
        user.tour.tick(TICK)
    assert user.tour.snapshot().state == "running" and user.line.number == BUZZ
    assert user.line.task == STEPS[BUZZ - 1].task


def test_an_emergency_stop_stays_after_a_step_is_done() -> None:
    # The next step would begin two seconds later, and start the scene again.
    user = User(PUSH)
    user.pull(0.004, 1.0)
    assert user.line.done
    user.tour.act(EMERGENCY_STOP)
    for _ in range(round(5.0 / TICK)):
        user.tour.tick(TICK)
    assert (user.tour.snapshot().state, user.line.number) == ("stopped", PUSH)
    user.tour.act("next")
    assert (user.tour.snapshot().state, user.line.number) == ("running", WALL)


def test_nothing_is_done_in_a_pause() -> None:
    user = User(STIFF)
    user.tour.act("pause")
    user.tour.change({"stiffness": 20000.0})
    user.wait(1.0)
    assert not user.line.done
    user.tour.act("pause")
    user.wait(0.5)
    assert user.line.done


def test_words_have_the_names_of_a_front() -> None:
    line = TourLine(5, 8, "Text.", "Raise it: {stiffness up}, {hand}.", False)
    assert line.words(lambda name: f"<{name}>") == ("Text.", "Raise it: <stiffness up>, <hand>.")
    names: list[str] = []
    for step in STEPS:
        TourLine(1, 1, step.text, step.task, False).words(lambda name: names.append(name) or name)  # type: ignore[func-returns-value]
    assert {"hand"} < set(names) <= {"hand", *User(1).tour.snapshot().actions}


def test_one_long_pull_completes_one_step() -> None:
    user = User(PUSH)
    user.pull(0.014, 1.0)
    assert user.line.done
    for _ in range(400):  # held against a wall while the next step begins, then pressed harder
        user.tour.tick(TICK)
    assert (user.line.number, user.line.done) == (WALL, False) and user.line.task.startswith("Let go.")
    user.pull(0.025, 1.0)
    assert not user.line.done
    user.release(0.3)
    assert not user.line.done and not user.line.task.startswith("Let go.")
    user.pull(0.014, 1.0)
    assert user.line.done
    for _ in range(400):
        user.tour.tick(TICK)
    assert (user.line.number, user.line.done) == (PULSE, False)  # whose pulses of the pull before do not count
    user.release(0.3)
    assert not user.line.done
