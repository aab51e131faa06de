"""Guided tour of the joystick: eight tasks, each checked from the samples."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from maglev_mj.errors import ParameterError, choice_message
from maglev_mj.frames import Array, Mask
from maglev_mj.scenes import Scene
from maglev_mj.scenes.interactive import Joystick
from maglev_mj.session import (
    DEVICE_PARAMETERS,
    EMERGENCY_STOP,
    REWIND_ACTIONS,
    SCENE_PREFIX,
    Session,
    Snapshot,
    TourLine,
    settable_parameters,
)
from maglev_mj.theory import stability

_CHECK_INTERVAL, _PAUSE = 1.0 / 30.0, 2.0
"""Interval of the checks, and pause after a completed step or a stop [s]."""

_HOLD_TIME, _STICK_TIME = 1.0, 0.5
_PULL_FORCE, _PULL_DISTANCE, _STICK_TOLERANCE = 0.2, 1e-3, 3e-4
_BUZZ_FORCE, _BUZZ_REVERSALS, _CALM_FORCE, _CALM_REVERSALS = 1.0, 16, 0.4, 6
"""Thresholds of a buzzing and a quiet wall: size [N] and number per second of force reversals."""

_ROUNDING = 1e-9


class Moment(NamedTuple):
    """Data for the check of a step.

    Attributes:
        begin: Snapshot at the start of the step.
        now: Current snapshot.
        rows: Samples of the last two seconds, since the start or the first release, (N, 32); see `Snapshot.history`.
        stable: True if the closed loop with the current parameters is stable.
    """

    begin: Snapshot
    now: Snapshot
    rows: Array
    stable: bool

    def last(self, duration: float) -> Array:
        """Return the samples of the last `duration` seconds; empty if the step is shorter."""
        begin = self.now.time - duration
        rows = self.rows
        if not len(rows) or rows[0, 0] > begin + 1.5 * self.now.scene.period:
            return rows[:0]
        return rows[rows[:, 0] > begin - _ROUNDING]


class Step(NamedTuple):
    """A step of the tour.

    Attributes:
        text: Explanation.
        task: Task of the user; see `TourLine`.
        check: Function that returns True when the task is done.
        parameters: Parameters of the scene at the start of the step.
    """

    text: str
    task: str
    check: Callable[[Moment], bool]
    parameters: Mapping[str, Any]


class Tour:
    """Session with a guided tour; a `SnapshotSource`.

    Args:
        session: Session of the joystick; closed with the tour.

    Attributes:
        hand: The mouse's hand.
        simulated: Total simulated time [s].
    """

    def __init__(self, session: Session) -> None:
        self._session, self.hand, self.simulated = session, session.hand, session.simulated
        self._stability: tuple[Scene, bool] | None = None
        self._check_elapsed = self._pause_elapsed = 0.0
        self._begin(0)

    def tick(self, elapsed: float) -> int:
        """Advance by elapsed real time, and check the step.

        Args:
            elapsed: Real time since the last call [s].

        Returns:
            Number of control ticks.
        """
        ticks = self._session.tick(elapsed)
        self.simulated = self._session.simulated
        self._check_elapsed += elapsed
        if self._check_elapsed >= _CHECK_INTERVAL:
            self._check(self._check_elapsed)
            self._check_elapsed = 0.0
        return ticks

    def act(self, action: str) -> None:
        """Perform "next" or "back", one step of the tour forward or back, or an action of its session.

        Raises:
            ParameterError: If there is no such action.
        """
        if action in ("next", "back"):
            index = self._index + (1 if action == "next" else -1)
            self._begin(min(max(index, 0), len(STEPS) - 1))
        elif action in (available := self._actions()):
            self._session.act(action)
        else:
            raise ParameterError(choice_message("action", available, action))

    def change(self, parameters: Mapping[str, Any]) -> None:
        """Change parameters; see `Session.change`."""
        self._session.change(parameters)

    def snapshot(self) -> Snapshot:
        """Return the current snapshot with the step of the tour."""
        snapshot, step = self._session.snapshot(), STEPS[self._index]
        task = step.task
        if self._has_failed(snapshot):
            task = "The scene was stopped. Let go: it restarts in a moment."
        elif not self._released:
            task = f"Let go. Then: {step.task}"
        elif self._done:
            last = self._index == len(STEPS) - 1
            task = "Done. This completes the tour: keep exploring." if last else "Done."
        line = TourLine(self._index + 1, len(STEPS), step.text, task, self._done)
        return replace(snapshot, actions=self._actions(), tour=line, rewound=None)

    def close(self) -> None:
        """Close the session."""
        self._session.close()

    def _actions(self) -> Sequence[str]:
        """Return the names of the actions; those that would end the tour are excluded."""
        names = (name for name in self._session.actions if name not in ("next scene", "drop", *REWIND_ACTIONS))
        return "next", "back", *(name for name in names if not name.startswith(SCENE_PREFIX))

    def _begin(self, index: int) -> None:
        """Start a step with its parameters."""
        self._index, self._done, self._check_elapsed, self._pause_elapsed = index, False, 0.0, 0.0
        self._released = self.hand.goal is None
        self._session.change(STEPS[index].parameters)
        self._start = self._session.snapshot()
        self._start_time = self._start.time

    def _check(self, elapsed: float) -> None:
        """Check the step; after a pause, start the next one, or restart a stopped scene."""
        now = self._session.snapshot()
        if now.reason == EMERGENCY_STOP:  # stays until the user restarts
            return
        if self._has_failed(now) or (self._done and self._index < len(STEPS) - 1):
            self._pause_elapsed += elapsed
            if self._pause_elapsed >= _PAUSE:
                self._pause_elapsed = 0.0
                if self._has_failed(now):
                    self._session.act("centre")
                else:
                    self._begin(self._index + 1)
            return
        if not self._released:  # one pull must not complete two steps
            self._released = now.target is None
            self._start, self._start_time = replace(self._start, pulses=now.pulses), now.time
            return
        if now.time < self._start_time:  # the scene has restarted
            self._start_time = 0.0
        rows = now.history[now.history[:, 0] > self._start_time]
        moment = Moment(self._start, now, rows, self._stable(now.scene))
        self._done = self._done or (now.state == "running" and STEPS[self._index].check(moment))

    def _stable(self, scene: Scene) -> bool:
        if self._stability is None or self._stability[0] != scene:
            self._stability = scene, stability(scene).stable is True
        return self._stability[1]

    @staticmethod
    def _has_failed(snapshot: Snapshot) -> bool:
        return snapshot.state == "stopped" and snapshot.reason != EMERGENCY_STOP


def _moved_handle(moment: Moment) -> bool:
    """Return True if the hand has pulled the handle away."""
    pulled, moved = (np.linalg.norm(moment.rows[:, part : part + 3], axis=1) for part in (19, 1))
    return bool(np.any((pulled >= _PULL_FORCE) & (moved >= _PULL_DISTANCE)))


def _pressed_wall(moment: Moment) -> bool:
    """Return True if the hand has pressed against a wall."""
    return any((inside & (pressing >= _PULL_FORCE)).any() for inside, pressing, _ in _at_walls(moment, moment.rows))


def _pulse_fired(moment: Moment) -> bool:
    """Return True if a wall has commanded a braking pulse."""
    return moment.now.pulses > moment.begin.pulses


def _sticks(moment: Moment) -> bool:
    """Return True if the handle sticks under a pull, outside the walls."""
    rows = moment.last(_STICK_TIME)
    if not len(rows) or moment.now.anchors is None:
        return False
    axis = int(np.argmax(np.abs(rows[-1, 19:22])))
    free = not any(inside.any() for inside, _, _ in _at_walls(moment, rows))
    pulled = (np.abs(rows[:, 19 + axis]) >= _PULL_FORCE).all()
    return bool(free and pulled and np.ptp(rows[:, 1 + axis]) <= _STICK_TOLERANCE)


def _stiffness_unstable(moment: Moment) -> bool:
    """Return True if the loop is unstable with a raised stiffness."""
    return not moment.stable and _was_raised("stiffness", moment)


def _wall_buzzes(moment: Moment) -> bool:
    """Return True if the force of a held wall oscillates."""
    return any(_reversals(force, _BUZZ_FORCE) >= _BUZZ_REVERSALS for force in _held_wall_forces(moment))


def _delay_buzzes(moment: Moment) -> bool:
    """Return True if a held wall buzzes with a raised delay."""
    return _was_raised("delay", moment) and _wall_buzzes(moment)


def _damping_calms(moment: Moment) -> bool:
    """Return True if, with a raised damping, the loop is stable and a held wall is quiet."""
    quiet = any(_reversals(force, _CALM_FORCE) < _CALM_REVERSALS for force in _held_wall_forces(moment))
    return moment.stable and _was_raised("damping", moment) and quiet


def _was_raised(name: str, moment: Moment) -> bool:
    return bool(getattr(moment.now.scene, name) > getattr(moment.begin.scene, name))


def _at_walls(moment: Moment, rows: Array) -> list[tuple[Mask, Array, Array]]:
    """Return contact flags, hand force into the wall and wall force [N] of each wall, (N,) each."""
    return [
        (normal * (rows[:, 1 + axis] - edge) <= 0.0, -normal * rows[:, 19 + axis], normal * rows[:, 13 + axis])
        for axis, normal, edge in moment.now.faces
        if axis < 3
    ]


def _held_wall_forces(moment: Moment) -> list[Array]:
    """Return the force of each wall that the hand has pressed for `_HOLD_TIME` [N], (N,)."""
    walls = _at_walls(moment, moment.last(_HOLD_TIME))
    return [back for inside, pressing, back in walls if inside.any() and pressing.all()]


def _reversals(force: Array, least: float) -> int:
    """Return how often a force changes sides of its mean, by at least half of `least` on each side."""
    side = np.sign(force - force.mean()) * (np.abs(force - force.mean()) >= 0.5 * least)
    return int(np.count_nonzero(np.diff(side[side != 0.0])))


_DEFAULTS = {name: getattr(Joystick(), name) for name in (*settable_parameters(Joystick), *DEVICE_PARAMETERS)}
_SOFT_WALL = {**_DEFAULTS, "stiffness": 4200.0, "damping": 12.0}

STEPS = (
    Step(
        "The handle floats in a magnetic field. A soft spring pulls it to the centre.",
        "Pull it 1 mm off centre: {hand}. Notice the spring pulling back.",
        _moved_handle,
        _DEFAULTS,
    ),
    Step(
        "A wall is a computed force: 6000 N/m of stiffness, 3.5 mm from the centre.",
        "Pull the handle against a wall. Notice the wall pushing back.",
        _pressed_wall,
        _DEFAULTS,
    ),
    Step(
        "A fast impact triggers a braking pulse, extra damping that absorbs energy.",
        "Hit a wall fast: let go, then pull quickly.",
        _pulse_fired,
        _DEFAULTS,
    ),
    Step(
        "Friction is on: the handle sticks until the pull exceeds the breakaway force, 2 N.",
        "Pull gently and hold for half a second. Notice that it does not move.",
        _sticks,
        {**_DEFAULTS, "friction": True},
    ),
    Step(
        "A sampled wall can be too stiff: above the boundary in the plot it is unstable.",
        "Raise the stiffness past the boundary: {stiffness up}.",
        _stiffness_unstable,
        _DEFAULTS,
    ),
    Step(
        "This wall is too stiff: each force acts after a delay, and so adds energy.",
        "Hold the handle against a wall for one second. Notice the buzz in the force plot.",
        _wall_buzzes,
        {**_DEFAULTS, "stiffness": 11720.0},
    ),
    Step(
        "A softer wall with little damping, quiet at 1.5 ms of delay. Delay lowers the boundary.",
        "Raise the delay: {delay up}. Press a wall gently from time to time, until it buzzes.",
        _delay_buzzes,
        _SOFT_WALL,
    ),
    Step(
        "At 4 ms of delay the wall buzzes. Damping dissipates the energy. The grey dot of the map is the wall alone.",
        "Raise the damping until it is stable: {damping up}. Then hold a wall: it is quiet.",
        _damping_calms,
        {**_SOFT_WALL, "delay": 0.004},
    ),
)
"""Steps of the tour."""
