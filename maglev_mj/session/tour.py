"""Guided tour of the joystick, with checked steps.

The user does the steps by hand.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from maglev_mj.errors import ParameterError, not_one_of
from maglev_mj.frames import Array, Mask
from maglev_mj.scenes import Scene
from maglev_mj.scenes.interactive import Joystick
from maglev_mj.session import CHOOSES, DEVICES_OWN, EMERGENCY_STOP, REWINDS, Session, Snapshot, TourLine, settable
from maglev_mj.theory import stability

_LOOK, _SHOWN = 1.0 / 30.0, 2.0
"""Times between checks and of display [s].

The second is that of a done step or a stopped scene.
"""

_HELD, _STUCK = 1.0, 0.5
_TOUCH, _MOVED, _STILL = 0.2, 1e-3, 3e-4
_BUZZ, _BUZZES, _CALM, _CALMER = 1.0, 16, 0.4, 6
"""Thresholds of a buzzing and a quiet wall.

Swings of force [N] and their number in a second, at least for buzzing, below for quiet.
"""

_ROUNDING = 1e-9


class Moment(NamedTuple):
    """Data for the check of a step.

    Attributes:
        begin: Snapshot when the step began.
        now: Present snapshot.
        rows: Samples since the begin, at most those of the last two seconds, (N, 25); see `Snapshot.history`.
        stable: True if the closed loop of the present parameters is stable.
    """

    begin: Snapshot
    now: Snapshot
    rows: Array
    stable: bool

    def last(self, duration: float) -> Array:
        """Return the samples of the last seconds.

        Empty if the step is younger.
        """
        begin = self.now.time - duration
        rows = self.rows
        if not len(rows) or rows[0, 0] > begin + 1.5 * self.now.scene.period:
            return rows[:0]
        return rows[rows[:, 0] > begin - _ROUNDING]


class Step(NamedTuple):
    """A step of the tour.

    Attributes:
        text: Explanation.
        deed: Task; see `TourLine`.
        check: Function that returns True once it is done.
        parameters: Parameters of the scene at the begin of the step.
    """

    text: str
    deed: str
    check: Callable[[Moment], bool]
    parameters: Mapping[str, Any]


class Tour:
    """Session with a guided tour; a `SnapshotSource`.

    Args:
        session: The session of the joystick; closed with the tour.

    Attributes:
        hand: The hand of the mouse.
        simulated: Time simulated so far [s].
    """

    def __init__(self, session: Session) -> None:
        self._session, self.hand, self.simulated = session, session.hand, session.simulated
        self._verdict: tuple[Scene, bool] | None = None
        self._looked = self._waited = 0.0
        self._begin(0)

    def tick(self, elapsed: float) -> int:
        """Advance by a real time, and check the step.

        Args:
            elapsed: Real time since the last call [s].

        Returns:
            Number of control ticks.
        """
        ticks = self._session.tick(elapsed)
        self.simulated = self._session.simulated
        self._looked += elapsed
        if self._looked >= _LOOK:
            self._look(self._looked)
            self._looked = 0.0
        return ticks

    def act(self, action: str) -> None:
        """Run an action of the tour or of its session.

        "next" and "back" go one step forward or back.

        Raises:
            ParameterError: If there is no such action.
        """
        if action in ("next", "back"):
            place = self._place + (1 if action == "next" else -1)
            self._begin(min(max(place, 0), len(STEPS) - 1))
        elif action in (known := self._actions()):
            self._session.act(action)
        else:
            raise ParameterError(not_one_of("action", known, action))

    def change(self, parameters: Mapping[str, Any]) -> None:
        """Change parameters; see `Session.change`."""
        self._session.change(parameters)

    def snapshot(self) -> Snapshot:
        """Return the present snapshot with the tour's line."""
        snapshot, step = self._session.snapshot(), STEPS[self._place]
        deed = step.deed
        if self._made_energy(snapshot):
            deed = "It made energy and was stopped. Let go: it starts again in a moment."
        elif self._done:
            last = self._place == len(STEPS) - 1
            deed = "Done. That was the tour: go on as you like." if last else "Done."
        line = TourLine(self._place + 1, len(STEPS), step.text, deed, self._done)
        return replace(snapshot, actions=self._actions(), tour=line, rewound=None)

    def close(self) -> None:
        """Close the session."""
        self._session.close()

    def _actions(self) -> Sequence[str]:
        """Return the names of the actions of `act`.

        Changes of scene, drops and rewinds are excluded, because they would end the tour.
        """
        own = (name for name in self._session.actions if name not in ("next scene", "drop", *REWINDS))
        return "next", "back", *(name for name in own if not name.startswith(CHOOSES))

    def _begin(self, place: int) -> None:
        """Begin a step with its parameters."""
        self._place, self._done, self._looked, self._waited = place, False, 0.0, 0.0
        self._session.change(STEPS[place].parameters)
        self._at = self._session.snapshot()
        self._since = self._at.time

    def _look(self, elapsed: float) -> None:
        """Check the step, and go on if it is done.

        After generated energy the scene is reset to the centre.
        """
        now = self._session.snapshot()
        if now.reason == EMERGENCY_STOP:  # it stays until the user continues
            return
        if self._made_energy(now) or (self._done and self._place < len(STEPS) - 1):
            self._waited += elapsed
            if self._waited >= _SHOWN:
                self._waited = 0.0
                if self._made_energy(now):
                    self._session.act("centre")
                else:
                    self._begin(self._place + 1)
            return
        if now.time < self._since:  # it has started again
            self._since = 0.0
        rows = now.history[now.history[:, 0] > self._since]
        moment = Moment(self._at, now, rows, self._stable(now.scene))
        self._done = self._done or (now.state == "running" and STEPS[self._place].check(moment))

    def _stable(self, scene: Scene) -> bool:
        if self._verdict is None or self._verdict[0] != scene:
            self._verdict = scene, stability(scene).stable is True
        return self._verdict[1]

    @staticmethod
    def _made_energy(snapshot: Snapshot) -> bool:
        return snapshot.state == "stopped" and snapshot.reason != EMERGENCY_STOP


def _pushed(moment: Moment) -> bool:
    """Return True if the hand has moved the handle."""
    pulled, moved = (np.linalg.norm(moment.rows[:, part : part + 3], axis=1) for part in (19, 1))
    return bool(np.any((pulled >= _TOUCH) & (moved >= _MOVED)))


def _met(moment: Moment) -> bool:
    """Return True if the hand has pressed against a wall."""
    return any((inside & (pressing >= _TOUCH)).any() for inside, pressing, _ in _at_walls(moment, moment.rows))


def _braked(moment: Moment) -> bool:
    """Return True if a wall has given a pulse."""
    return moment.now.pulses > moment.begin.pulses


def _stuck(moment: Moment) -> bool:
    """Return True if the handle sticks under a pull.

    It must be off the walls.
    """
    rows = moment.last(_STUCK)
    if not len(rows) or moment.now.anchors is None:
        return False
    axis = int(np.argmax(np.abs(rows[-1, 19:22])))
    free = not any(inside.any() for inside, _, _ in _at_walls(moment, rows))
    pulled = (np.abs(rows[:, 19 + axis]) >= _TOUCH).all()
    return bool(free and pulled and np.ptp(rows[:, 1 + axis]) <= _STILL)


def _too_stiff(moment: Moment) -> bool:
    """Return True if more stiffness made the loop unstable."""
    return not moment.stable and _raised("stiffness", moment)


def _buzzes(moment: Moment) -> bool:
    """Return True if the force of a held wall alternated."""
    return any(_swings(force, _BUZZ) >= _BUZZES for force in _held(moment))


def _too_late(moment: Moment) -> bool:
    """Return True if more delay makes a held wall buzz."""
    return _raised("delay", moment) and _buzzes(moment)


def _mended(moment: Moment) -> bool:
    """Return True if more damping made the loop stable.

    A held wall must be quiet too.
    """
    quiet = any(_swings(force, _CALM) < _CALMER for force in _held(moment))
    return moment.stable and _raised("damping", moment) and quiet


def _raised(name: str, moment: Moment) -> bool:
    return bool(getattr(moment.now.scene, name) > getattr(moment.begin.scene, name))


def _at_walls(moment: Moment, rows: Array) -> list[tuple[Mask, Array, Array]]:
    """Return contact flags and opposing forces at each wall.

    (N,) each, forces of hand and wall in [N].
    """
    return [
        (normal * (rows[:, 1 + axis] - edge) <= 0.0, -normal * rows[:, 19 + axis], normal * rows[:, 13 + axis])
        for axis, normal, edge in moment.now.faces
        if axis < 3
    ]


def _held(moment: Moment) -> list[Array]:
    """Return the forces of walls held for a second [N].

    (N,) each.
    """
    walls = _at_walls(moment, moment.last(_HELD))
    return [back for inside, pressing, back in walls if inside.any() and pressing.all()]


def _swings(force: Array, least: float) -> int:
    """Return the number of swings of a force.

    A swing goes from one side of the mean to the other, by half of `least` on each.
    """
    side = np.sign(force - force.mean()) * (np.abs(force - force.mean()) >= 0.5 * least)
    return int(np.count_nonzero(np.diff(side[side != 0.0])))


_PLAIN = {name: Joystick.parameter(name).default for name in (*settable(Joystick), *DEVICES_OWN)}
_BARE = {**_PLAIN, "stiffness": 4200.0, "damping": 12.0}

STEPS = (
    Step(
        "The handle floats in a magnetic field. A soft spring draws it to its centre.",
        "Pull it away by a millimetre: {hand}.",
        _pushed,
        _PLAIN,
    ),
    Step(
        "Computed forces make walls, 3.5 mm from the centre and as stiff as 6000 N/m.",
        "Pull the handle against a wall, until the wall pushes back.",
        _met,
        _PLAIN,
    ),
    Step(
        "A fast handle is braked by a pulse of force, on the sample that finds it in the wall.",
        "Hit a wall fast: let go, then pull quickly.",
        _braked,
        _PLAIN,
    ),
    Step(
        "Friction is on: the handle sticks to a point, until you pull with more than 2 N.",
        "Pull gently, and hold: it must not move for half a second.",
        _stuck,
        {**_PLAIN, "friction": True},
    ),
    Step(
        "A sampled wall can be too stiff: above the boundary in the plot it is unstable.",
        "Raise the stiffness past the boundary: {stiffness up}.",
        _too_stiff,
        _PLAIN,
    ),
    Step(
        "This wall is too stiff: each force comes too late for the motion, and adds energy.",
        "Hold the handle against a wall for a second, and watch the force buzz.",
        _buzzes,
        {**_PLAIN, "stiffness": 11720.0},
    ),
    Step(
        "A softer wall with little damping: it is quiet while its forces come 1.5 ms late.",
        "Raise the delay: {delay up}. Hold a wall gently now and then, until it buzzes.",
        _too_late,
        _BARE,
    ),
    Step(
        "With 4 ms of delay the wall buzzes. Damping takes the energy out of it.",
        "Raise the damping until it is stable: {damping up}. Then hold a wall: it is quiet.",
        _mended,
        {**_BARE, "delay": 0.004},
    ),
)
"""Steps of the tour."""
