"""Viewers in a separate process, so that drawing does not delay a control loop."""

from __future__ import annotations

import math
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from maglev_mj import session
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.lazy import stop_profiler
from maglev_mj.parameters import flag
from maglev_mj.plants import engine_warnings_silenced
from maglev_mj.plants.hand import SpringHand
from maglev_mj.process import SideProcess
from maglev_mj.scenes import Scene
from maglev_mj.session import EMERGENCY_STOP, ChangeRequest, FrameClock, Note, Snapshot, SnapshotSource
from maglev_mj.session.actions import actions

if TYPE_CHECKING:
    from multiprocessing.connection import Connection  # missing on some platforms

SILENCE = 0.5
"""Timeout after which the hand is released [s]; the target of a held hand is resent periodically."""

_FURTHEST = 1e3  # [m, rad]
_LONGEST = 0.05
"""Longest time to reach a target [s], the period of a browser's targets (20 Hz; a window sends 60 Hz)."""


class Glide:
    """Linear interpolation of a hand's target between the poses received.

    Args:
        clock: Clock of real time [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._start: Sequence[float] = ()
        self._goal: Sequence[float] | None = None
        self._received, self._duration, self._held = 0.0, 0.0, False

    def aim(self, target: Sequence[float] | None) -> None:
        """Set a new target pose [m, rad], (6,); None, or one that is not finite or too far, releases the hand."""
        if target is not None and not all(abs(part) < _FURTHEST for part in target):
            target = None  # untrusted input from a browser, which would make the plant reject the hand
        now = self._clock()
        self._start = (self._now(now) or target) if self._held and target is not None else target or ()
        self._goal, self._received, self._duration = target, now, min(now - self._received, _LONGEST)

    def move(self, hand_force: SpringHand) -> None:
        """Update a hand's target if this viewer holds the hand."""
        if not self._held and self._goal is None:
            return
        hand_force.target = self._now(self._clock())
        self._held = hand_force.target is not None

    def _now(self, now: float) -> Sequence[float] | None:
        """Return the interpolated target at a time."""
        elapsed = now - self._received
        if self._goal is None or elapsed > SILENCE:
            self._goal = None
            return None
        fraction = min(elapsed / self._duration, 1.0) if self._duration > 0.0 else 1.0
        return [start + fraction * (goal - start) for start, goal in zip(self._start, self._goal)]


Request: TypeAlias = tuple[str, Any]
"""Kind and value: "hand" (target pose), "act" (action), "change" (parameters by name)."""

_PERIOD, _CAPACITY, _LOCKOUT = 0.05, 64, 0.5


class Inbox:
    """Bounded, thread-safe queue of a user's requests.

    Priority: emergency stop, newest target of the hand, then actions and parameters in order. An emergency stop
    discards all waiting actions and parameters, and parameters that follow it at intervals below 0.5 s: a slider in
    motion must not restart the scene. Parameters between two actions are merged, the newest value of each. Requests
    above the capacity of 64 are dropped.

    Args:
        period: Smallest interval between deliveries of actions and parameters [s].
        clock: Clock of real time [s].
    """

    def __init__(self, period: float = _PERIOD, clock: Callable[[], float] = time.monotonic) -> None:
        self._due, self._clock, self._lock = FrameClock(period, clock), clock, threading.Lock()
        self._urgent, self._moved = dict[str, Any](), -math.inf
        self._waiting: list[Request] = []

    def put(self, kind: str, value: Any) -> None:
        """Add a request."""
        with self._lock:
            if kind == "hand":
                self._urgent[kind] = value
            elif value == EMERGENCY_STOP:
                self._urgent["act"], self._waiting, self._moved = value, [], self._clock()
            elif kind == "change" and self._clock() - self._moved < _LOCKOUT:
                self._moved = self._clock()
            elif kind == "change" and self._waiting and self._waiting[-1][0] == "change":
                self._waiting[-1] = kind, {**self._waiting[-1][1], **value}
            elif len(self._waiting) < _CAPACITY:
                self._waiting.append((kind, value))

    def take(self) -> Sequence[Request]:
        """Remove and return the requests that are due, by priority."""
        with self._lock:
            requests, self._urgent = sorted(self._urgent.items()), {}  # "act" before "hand"
            if self._waiting and self._due():
                requests, self._waiting = requests + self._waiting, []
        return requests


_MAX_ROWS, _MAX_MESSAGES = 400, 64
_NAP = 0.001
_CLOSE_TIMEOUT = 0.5

ViewerFunction: TypeAlias = Callable[[SnapshotSource], object]
"""Viewer function: shows a source until either ends. Must be picklable, therefore at module level."""


class RemoteViewer:
    """Window or page in a separate process: a `Publisher`.

    Args:
        snapshot: Initial snapshot.
        front: Viewer function, such as `window.show`.
        watch: True for a read-only viewer: only its emergency stop is accepted.

    Attributes:
        hand: Hand of the mouse.
        frames: Number of snapshots sent.
        is_open: False once the viewer's process has ended.
        failure: Why it ended; empty if the user closed the window.
        on_close: Called once when the viewer's process has ended; may be replaced.
        on_emergency: Called by `take` on an emergency stop; may be replaced, and may raise.
    """

    def __init__(self, snapshot: Snapshot, front: ViewerFunction, *, watch: bool = False) -> None:
        self._watch = flag("watch", watch)
        self.hand, self.frames = SpringHand.of_mouse(device=snapshot.scene.device), 0
        self.on_close: Callable[[], object] = lambda: None
        self.on_emergency: Callable[[], object] = lambda: None
        self._scene, self._sent_time, self.is_open = snapshot.scene, -np.inf, True
        self.failure = "the viewer process has ended"
        self._note, self._due, self._glide = Note(), FrameClock(), Glide()
        self._inbox = Inbox()
        self._front = SideProcess(_open, snapshot, front)

    def show(self, snapshot: Snapshot) -> None:
        """Send a snapshot unless the viewer is busy."""
        self._scene = snapshot.scene
        if not self._front.ready:
            return
        if snapshot.time < self._sent_time:  # restarted
            self._sent_time = -np.inf
        # only new rows, and few enough that sending them does not block
        rows = snapshot.history[np.searchsorted(snapshot.history[:, 0], self._sent_time, side="right") :]
        self._sent_time = snapshot.time
        every = max(1, -(-len(rows) // _MAX_ROWS))  # thinned after a jump in a recording
        self._front.send(replace(snapshot, history=rows[::-every][::-1], notes=[*snapshot.notes, *self._note.lines]))
        self.frames += 1

    def take(self) -> ChangeRequest | None:
        """Apply mouse and keys: update the hand, return a request for a changed scene."""
        requested = None
        for kind, value in self._requests(self.hand):
            if value == EMERGENCY_STOP:
                self.on_emergency()
            elif not self._watch and (scene := self._changed(kind, value)) is not None:
                self._scene = requested = scene
        return None if requested is None else ChangeRequest(requested)

    def _requests(self, hand_force: SpringHand) -> Iterator[Request]:
        """Yield the actions and parameters that are due, then move the hand.

        Bounded, so that a flood does not delay a tick.
        """
        for kind, value in islice(self._front.received(), _MAX_MESSAGES):
            if kind == "closed":
                self.failure = value
            else:
                self._inbox.put(kind, value)
        for kind, value in self._inbox.take():
            if kind != "hand":
                yield kind, value
            elif not self._watch:
                self._glide.aim(value)
        if self._front.ended and self.is_open:
            self.is_open = False
            self._glide.aim(None)
            self.on_close()
        self._glide.move(hand_force)

    def _changed(self, kind: str, value: Any) -> Scene | None:
        """Return the changed scene, or None; an invalid request becomes a note and does not end a flight."""
        scene = self._scene
        try:
            if "rewind" in value:
                raise ParameterError("rewind needs a simulation: a device cannot be rewound")
            if kind == "change":
                value = {name: value[name] for name in session.settable_parameters(scene) if name in value}
            elif value not in actions(type(scene)):
                return None
            scene = session.changed(scene, value)
            self._note.clear()
            return scene
        except MaglevError as error:
            self._note.say(str(error))
            return None

    def serve(self, source: SnapshotSource) -> None:
        """Apply the user's requests to a source and show it; call it between ticks."""
        for kind, value in self._requests(source.hand):
            try:
                (source.act if kind == "act" else source.change)(value)
                self._note.clear()
            except (MaglevError, OSError) as error:  # for example a folder that is not writable
                self._note.say(str(error))
        if self._front.ready and self._due():
            self.show(source.snapshot())

    def close(self) -> None:
        """Close the viewer; idempotent."""
        self.is_open = False
        self._front.close(_CLOSE_TIMEOUT)


class ShowReport(NamedTuple):
    """Report of a session in a window or page.

    Attributes:
        frames: Snapshots sent to the viewer, which takes the next one when it has drawn the last.
        wall_time: Real time that the viewer was open [s].
        simulated: Simulated time [s].
        ticks: Number of control ticks.
        missed: Number of skipped ticks.
    """

    frames: int
    wall_time: float
    simulated: float
    ticks: int
    missed: int

    def __str__(self) -> str:
        duration = max(self.wall_time, 1e-9)
        return (
            f"  {self.wall_time:.1f} s, {self.ticks} control ticks, {self.missed} skipped\n"
            f"  real-time factor {self.simulated / duration:.3f}\n"
            f"  {self.frames} frames, {self.frames / duration:.1f} per second"
        )


def show_remotely(source: SnapshotSource, front: ViewerFunction, duration: float | None = None) -> ShowReport:
    """Run a source in real time with a remote viewer, and close both at the end.

    Args:
        source: Source to run.
        front: Viewer function.
        duration: Real time to run [s]; None until the user closes the window, or Ctrl-C.

    Raises:
        MaglevError: If the viewer's process ends by itself.
    """
    viewer, ticks, wall_time = RemoteViewer(source.snapshot(), front), 0, 0.0
    with closing(viewer), closing(source):
        with engine_warnings_silenced(), suppress(KeyboardInterrupt):  # ends a page
            for elapsed, total in session.real_time(duration, _NAP):
                ticks, wall_time = ticks + source.tick(elapsed), total
                viewer.serve(source)
                if not viewer.is_open:
                    if viewer.failure:
                        raise MaglevError(viewer.failure)
                    break
        missed = source.snapshot().missed
        return ShowReport(viewer.frames, wall_time, source.simulated, ticks, missed)


class RemoteSession:
    """Session of a remote viewer: a `SnapshotSource`.

    Args:
        pipe: Connection to the control process.
        snapshot: Snapshot to show until the first arrives.
    """

    def __init__(self, pipe: Connection, snapshot: Snapshot) -> None:
        self.hand, self.simulated = SpringHand(), 0.0
        self._pipe, self._snapshot, self._history = pipe, snapshot, session.History()
        self._target: Any = None
        self._due = FrameClock(SILENCE / 5.0)

    def tick(self, elapsed: float) -> int:
        """Receive snapshots; return the number of samples since the last call."""
        before = self._snapshot.tick
        try:
            while self._pipe.poll():
                last, self._snapshot = self._snapshot, self._pipe.recv()
                if self._snapshot.time < last.time:  # restarted
                    self._history.clear()
                self._history.extend(self._snapshot.history)
            moved, due = self._target != self.hand.target, self._due()
            if moved or (due and self._target is not None):
                self._target = self.hand.target
                self._pipe.send(("hand", self._target))
        except (EOFError, OSError):
            raise MaglevError("the control process has ended") from None
        samples = self._snapshot.tick - before
        self.simulated += samples * self._snapshot.scene.period
        return samples

    def act(self, action: str) -> None:
        """Send an action."""
        self._pipe.send(("act", action))

    def change(self, parameters: Mapping[str, Any]) -> None:
        """Send parameters."""
        self._pipe.send(("change", dict(parameters)))

    def snapshot(self) -> Snapshot:
        """Return the newest snapshot."""
        return replace(self._snapshot, history=self._history.rows)

    def close(self) -> None:
        """Close the connection."""
        self._pipe.close()


def _open(pipe: Connection, snapshot: Snapshot, front: ViewerFunction) -> None:
    """Run the viewer function in the viewer process, and say why it ended."""
    stop_profiler()
    reason = ""
    try:
        front(RemoteSession(pipe, snapshot))
    except Exception as error:
        reason = str(error) if isinstance(error, MaglevError) else repr(error)
    finally:
        with suppress(OSError):  # the control process has ended
            pipe.send(("closed", reason))
        pipe.close()
        os._exit(0)  # threads of a server outlive it by seconds
