"""Viewers in a process of their own: drawing must not delay a control loop with deadlines."""

from __future__ import annotations

import math
import os
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from maglev_mj import session
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.parameters import flag
from maglev_mj.plants import engine_warnings_silenced
from maglev_mj.plants.hand import SpringHand
from maglev_mj.process import SideProcess
from maglev_mj.scenes import Scene
from maglev_mj.session import EMERGENCY_STOP, ChangeRequest, Due, Note, Snapshot, SnapshotSource
from maglev_mj.session.actions import actions

if TYPE_CHECKING:
    from multiprocessing.connection import Connection  # not everywhere there

SILENCE = 0.5
"""Silence after which the hand is released [s].

A held target is sent again and again.
"""

_LONGEST = 0.05
"""Longest time to reach a target [s].

A browser sends 20 a second, a window 60; each is reached when the next may come.
"""


class Glide:
    """Move a hand's target smoothly to the wanted pose.

    Args:
        clock: Returns real time [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._start: Sequence[float] = ()
        self._goal: Sequence[float] | None = None
        self._came, self._lasts, self._held = 0.0, 0.0, False

    def aim(self, target: Sequence[float] | None) -> None:
        """Take a new target pose [m, rad], (6,).

        None releases the hand, as does one that is not finite.
        """
        if target is not None and not all(map(math.isfinite, target)):
            target = None  # a browser may say anything, and a plant refuses such a hand for good
        now = self._clock()
        self._start = (self._now(now) or target) if self._held and target is not None else target or ()
        self._goal, self._came, self._lasts = target, now, min(now - self._came, _LONGEST)

    def move(self, hand: SpringHand) -> None:
        """Move a hand's target, if the hand is held here."""
        if not self._held and self._goal is None:
            return
        hand.target = self._now(self._clock())
        self._held = hand.target is not None

    def _now(self, now: float) -> Sequence[float] | None:
        """Return the target of an instant."""
        passed = now - self._came
        if self._goal is None or passed > SILENCE:
            self._goal = None
            return None
        share = min(passed / self._lasts, 1.0) if self._lasts > 0.0 else 1.0
        return [start + share * (goal - start) for start, goal in zip(self._start, self._goal)]


Request: TypeAlias = tuple[str, Any]
"""A kind and its value: "hand" (target), "act" (action), "change" (parameters by name)."""

_PERIOD = 0.05
_MOST = 64
_STILL = 0.5


class Inbox:
    """Bounded queue of a person's requests, filled from any thread.

    The emergency stop goes ahead of everything, and what waits before it is dropped, as are parameters after it that
    follow one another within half a second: a slider still moving starts nothing again. The newest target of the hand
    goes ahead of the rest. Of each parameter between two actions the newest value is kept; beyond 64 requests that
    wait, further ones are dropped.

    Args:
        period: Shortest time from one handing over of actions and parameters to the next [s].
        clock: Clock of real time [s].
    """

    def __init__(self, period: float = _PERIOD, clock: Callable[[], float] = time.monotonic) -> None:
        self._due, self._clock, self._lock = Due(period, clock), clock, threading.Lock()
        self._stop, self._moved = False, -math.inf
        self._hand: list[Request] = []
        self._waiting: list[Request] = []

    def put(self, kind: str, value: Any) -> None:
        """Add a request."""
        with self._lock:
            if kind == "hand":
                self._hand = [(kind, value)]
            elif value == EMERGENCY_STOP:
                self._stop, self._waiting, self._moved = True, [], self._clock()
            elif kind == "change" and self._clock() - self._moved < _STILL:
                self._moved = self._clock()
            elif kind == "change" and self._waiting and self._waiting[-1][0] == "change":
                self._waiting[-1] = kind, {**self._waiting[-1][1], **value}
            elif len(self._waiting) < _MOST:
                self._waiting.append((kind, value))

    def take(self) -> Sequence[Request]:
        """Return the requests that are due, the most urgent first; each is returned once."""
        with self._lock:
            requests: list[Request] = [("act", EMERGENCY_STOP)] if self._stop else []
            requests += self._hand
            self._stop, self._hand = False, []
            if self._waiting and self._due():
                requests += self._waiting
                self._waiting = []
        return requests


_MOST_ROWS, _MOST_MESSAGES = 400, 64
_NAP = 0.001
_LEAVE = 0.5

Front: TypeAlias = Callable[[SnapshotSource], object]
"""Viewer function: shows a source until either ends.

At module level, since another process gets it by its name.
"""


class RemoteViewer:
    """A window or page in its own process: a `Publisher`.

    Args:
        snapshot: What it shows at first.
        front: Opens it there, such as `viewer.window.show`.
        watch: Whether nothing but an emergency stop is taken from it: no hand, no parameter.

    Attributes:
        hand: The mouse's.
        frames: Snapshots handed over.
        on_close: Called once when the person has closed the window; may be replaced.
        on_emergency: Called by `take` when the emergency stop's key was pressed; may be replaced, and may raise.
    """

    def __init__(self, snapshot: Snapshot, front: Front, *, watch: bool = False) -> None:
        self._watch = flag("watch", watch)
        self.hand, self.on_close, self.frames = SpringHand(), _nothing, 0
        self.on_emergency: Callable[[], object] = _nothing
        self._scene, self._sent, self._open = snapshot.scene, -np.inf, True
        self._note, self._due, self._glide = Note(), Due(), Glide()
        self._inbox = Inbox()
        self._front = SideProcess(_open, snapshot, front)

    def show(self, snapshot: Snapshot) -> None:
        """Show a snapshot, unless the viewer is busy."""
        self._scene = snapshot.scene
        if not self._front.ready:
            return
        if snapshot.time < self._sent:  # it has started again
            self._sent = -np.inf
        # only the rows that are new, and so many that writing them cannot wait
        rows = snapshot.history[np.searchsorted(snapshot.history[:, 0], self._sent, side="right") :]
        self._sent = snapshot.time
        every = max(1, -(-len(rows) // _MOST_ROWS))  # fewer of them where a recording has jumped
        self._front.send(replace(snapshot, history=rows[::-every][::-1], notes=[*snapshot.notes, *self._note.lines]))
        self.frames += 1

    def take(self) -> ChangeRequest | None:
        """Apply mouse and keys: move the hand, return the scene."""
        wanted = None
        for kind, value in self._requests():
            if value == EMERGENCY_STOP:
                self.on_emergency()
            elif self._watch:
                continue
            elif kind == "hand":
                self._glide.aim(value)
            elif (asked := self._asked(kind, value)) is not None:
                self._scene = wanted = asked
        self._look()
        self._glide.move(self.hand)
        return None if wanted is None else ChangeRequest(wanted)

    def _requests(self) -> Sequence[Request]:
        """Return the requests that are due; no number of them delays a tick."""
        for kind, value in islice(self._front.received(), _MOST_MESSAGES):
            self._inbox.put(kind, value)
        return self._inbox.take()

    def _asked(self, kind: str, value: Any) -> Scene | None:
        """Return the requested scene; a refusal ends no flight."""
        scene = self._scene
        try:
            if "rewind" in value:
                raise ParameterError("rewind is for a simulation: a device cannot be rewound")
            if kind == "change":
                return session.changed(scene, {name: value[name] for name in value if name in session.settable(scene)})
            return session.changed(scene, value) if value in actions(type(scene)) else None
        except MaglevError as error:
            self._note.say(str(error))
            return None

    def serve(self, source: SnapshotSource) -> None:
        """Apply a person's requests, show the source.

        To be called between its ticks.
        """
        for kind, value in self._requests():
            try:
                if kind == "hand":
                    self._glide.aim(value)
                elif kind == "act":
                    source.act(value)
                else:
                    source.change(value)
            except (MaglevError, OSError) as error:  # such as a folder that takes no recording
                self._note.say(str(error))
        self._look()
        self._glide.move(source.hand)
        if self._front.ready and self._due():
            self.show(source.snapshot())

    def _look(self) -> None:
        """Release the hand once the viewer is closed."""
        if self._front.ended and self._open:
            self._open = False
            self._glide.aim(None)
            self.on_close()

    def close(self) -> None:
        """Close the window; a second time does nothing."""
        self._open = False
        self._front.close(_LEAVE)


class ShowReport(NamedTuple):
    """Report of a session in a window or page.

    Attributes:
        frames: Frames shown, or handed to the page.
        frame_cost: Median time from a snapshot to its being drawn [s], beside the control ticks; 0 where not known.
        wall_time: Time that it was open [s].
        simulated: Time simulated meanwhile [s].
        ticks: Control ticks made.
        missed: Ticks given up.
    """

    frames: int
    frame_cost: float
    wall_time: float
    simulated: float
    ticks: int
    missed: int

    def __str__(self) -> str:
        passed = max(self.wall_time, 1e-9)
        cost = f", {self.frame_cost * 1e3:.1f} ms each" if self.frame_cost else ""
        return (
            f"  {self.wall_time:.1f} s, {self.ticks} control ticks, {self.missed} missed\n"
            f"  real-time factor {self.simulated / passed:.3f}\n"
            f"  {self.frames} frames, {self.frames / passed:.1f} a second{cost}"
        )


def show_remotely(source: SnapshotSource, front: Front, duration: float | None = None) -> ShowReport:
    """Run a source in real time behind a remote viewer.

    It is closed at the end.

    Args:
        source: What to show.
        front: Shows it.
        duration: End after so much real time [s]; None goes on until Ctrl-C.

    Raises:
        MaglevError: If the front ends before.
    """
    viewer, ticks, wall_time = RemoteViewer(source.snapshot(), front), 0, 0.0
    viewer.on_close = _ended
    with closing(viewer), closing(source):
        with engine_warnings_silenced(), suppress(KeyboardInterrupt):  # the way in which a page is ended
            for elapsed, passed in session.real_time(duration, _NAP):
                ticks, wall_time = ticks + source.tick(elapsed), passed
                viewer.serve(source)
        missed = source.snapshot().missed
        return ShowReport(viewer.frames, 0.0, wall_time, source.simulated, ticks, missed)


class RemoteSession:
    """Session behind a remote window: a `SnapshotSource`.

    Args:
        line: To the process that runs the device.
        snapshot: What is shown until the device has sent something.
    """

    def __init__(self, line: Connection, snapshot: Snapshot) -> None:
        self.hand, self.simulated = SpringHand(), 0.0
        self._line, self._snapshot, self._history = line, snapshot, session.History()
        self._over = False
        self._target: Any = None
        self._due = Due(SILENCE / 5.0)

    def tick(self, elapsed: float) -> int:
        """Take new snapshots; return the samples since the last."""
        before = self._snapshot.tick
        try:
            while not self._over and self._line.poll():
                last, self._snapshot = self._snapshot, self._line.recv()
                if self._snapshot.time < last.time:  # it has started again
                    self._history.clear()
                self._history.extend(self._snapshot.history)
            moved, again = self._target != self.hand.target, self._due()
            if moved or (again and self._target is not None):
                self._target = self.hand.target
                self._line.send(("hand", self._target))
        except (EOFError, OSError):
            self._over = True
            raise MaglevError("the device's program has ended") from None
        made = self._snapshot.tick - before
        self.simulated += made * self._snapshot.scene.period
        return made

    def act(self, action: str) -> None:
        """Pass on the action of a key."""
        if not self._over:
            self._line.send(("act", action))

    def change(self, parameters: Mapping[str, Any]) -> None:
        """Pass on parameters."""
        if not self._over:
            self._line.send(("change", dict(parameters)))

    def snapshot(self) -> Snapshot:
        """Return the picture of now."""
        return replace(self._snapshot, history=self._history.rows)

    def close(self) -> None:
        """Notify the device's program."""
        self._line.close()


def _nothing() -> None: ...


def _ended() -> None:
    raise MaglevError("the process that shows the scene has ended")


def _open(line: Connection, snapshot: Snapshot, front: Front) -> None:
    """Open the front; in its own process."""
    try:
        front(RemoteSession(line, snapshot))
    except MaglevError:
        pass  # the device's program has ended, and says why
    finally:
        line.close()
        # the engine's viewer leaves threads that outlive it by seconds
        os._exit(0)
