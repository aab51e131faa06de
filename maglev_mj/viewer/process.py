"""A window on a device that this process runs, in a process of its own: drawing must not hold up what has deadlines."""

from __future__ import annotations

import multiprocessing
import os
import time
from collections import deque
from collections.abc import Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from select import select
from typing import Any, NamedTuple

import numpy as np

from maglev_mj.energy import HandWork
from maglev_mj.errors import MaglevError
from maglev_mj.frames import Array
from maglev_mj.hand import SpringHand
from maglev_mj.scenes import Settings, scene_called
from maglev_mj.session import View
from maglev_mj.workers import interrupts_held

__all__ = ["Watch"]

_FRAME = 1.0 / 60.0
_HISTORY = 2.0
_MOST_ROWS = 400
_PATIENCE = 10.0


class _Seen(NamedTuple):
    """What the window is sent: see `View`."""

    ticks: int
    rows: Sequence[tuple[float, ...]]
    settings: Settings
    faces: Sequence[tuple[int, float, float]]
    note: str
    work: float
    pose: Array
    force: Array
    effort: Array
    currents: Array
    anchors: Array | None


class Watch:
    """A window on a device.

    Args:
        scene: Name of the scene that shows it.
        settings: Of its laws, and its sample period.
        folder: Where screenshots go.

    Attributes:
        hand: The mouse's.
        closed: Whether the window is.
        settings: Those to be shown; may be replaced.
        faces: Every wall to be shown: index into AXES, normal, edge.
        note: What a person should know now.
    """

    def __init__(self, scene: str, settings: Settings, folder: Path = Path()) -> None:
        self.settings, self.hand, self.closed = settings, SpringHand(), False
        self.faces: Sequence[tuple[int, float, float]] = ()
        self.note = ""
        self._axis = scene_called(scene).axis_index
        self._rows: deque[tuple[float, ...]] = deque(maxlen=_MOST_ROWS)
        self._sent, self._ticks, self._hand_work = 0.0, 0, HandWork()
        self._last: Array | None = None
        context = multiprocessing.get_context("spawn")
        self._line, far = context.Pipe()
        self._process = context.Process(target=_open, args=(far, scene, settings, folder), daemon=True)
        with interrupts_held():  # it is closed by who opened it
            self._process.start()
        far.close()

    def keep(
        self,
        pose: Array,
        force: Array,
        effort: Sequence[float],
        currents: Sequence[float],
        anchors: Array | None = None,
    ) -> None:
        """Show a sample; most are only plotted, and none is waited for.

        Args:
            pose: Of the flotor [m, rad], (6,).
            force: Wrench that the device holds beyond what carries the flotor [N, N m], (6,).
            effort: Wrench of the hand [N, N m], six.
            currents: In the coils [A], six.
            anchors: Where the flotor sticks [m, rad], (6,), NaN where it does not; None without friction.
        """
        axis, period = self._axis, self.settings.period
        last = pose if self._last is None else self._last
        way, self._last = pose - last, pose
        self._hand_work.add(pose, effort)
        row = self._ticks * period, pose[axis], way[axis] / period, force[axis], effort[axis]
        self._rows.append(tuple(float(value) for value in row))
        self._ticks += 1
        now = time.monotonic()
        if now - self._sent < _FRAME or self.closed:
            return
        self._sent = now
        if select((), (self._line,), (), 0.0)[1]:  # where the window does not keep up, it misses something
            self._send(
                _Seen(
                    ticks=self._ticks,
                    rows=list(self._rows),
                    settings=self.settings,
                    faces=self.faces,
                    note=self.note,
                    work=self._hand_work.total,
                    pose=pose,
                    force=force,
                    effort=np.array(effort),
                    currents=np.array(currents),
                    anchors=anchors,
                )
            )
            self._rows.clear()

    def poll(self) -> list[str]:
        """Move the hand as the mouse does, and return which actions keys asked for."""
        actions: list[str] = []
        try:
            while not self.closed and self._line.poll():
                kind, value = self._line.recv()
                if kind == "hand":
                    self.hand.target = value
                else:
                    actions.append(value)
        except (EOFError, OSError):
            self.closed = True
            self.hand.target = None
        return actions

    def close(self) -> None:
        """Close the window; a second time does nothing."""
        self.closed = True
        self._line.close()
        self._process.join(_PATIENCE)
        if self._process.is_alive():
            self._process.terminate()
            self._process.join(_PATIENCE)

    def _send(self, message: Any) -> None:
        try:
            self._line.send(message)
        except OSError:
            self.closed = True


class _Watched:
    """What the window's process knows of the device: see `Showable`."""

    def __init__(self, line: Connection, scene: str, settings: Settings) -> None:
        self.hand, self.simulated = SpringHand(), 0.0
        self._line, self._scene = line, scene_called(scene)
        self._history: deque[tuple[float, ...]] = deque()
        nothing = np.zeros(6)
        self._seen = _Seen(0, (), settings, (), "", 0.0, nothing, nothing, nothing, nothing, None)
        self._over = False
        self._target: Any = None

    def tick(self, elapsed: float) -> int:
        """Take what the device has sent; return how many samples that were."""
        before = self._seen.ticks
        try:
            while not self._over and self._line.poll():
                self._take(self._line.recv())
            if self._target != self.hand.target:
                self._target = self.hand.target
                self._line.send(("hand", self._target))
        except (EOFError, OSError):
            self._over = True
            raise MaglevError("the device's program has ended") from None
        made = self._seen.ticks - before
        self.simulated += made * self._seen.settings.period
        return made

    def act(self, action: str) -> None:
        """Pass on what a key asks for."""
        if not self._over:
            self._line.send(("act", action))

    def view(self) -> View:
        """Return what there is to see."""
        seen = self._seen
        return View(
            scene=self._scene,
            settings=seen.settings,
            time=seen.ticks * seen.settings.period,
            pose=seen.pose,
            force=seen.force,
            hand=seen.effort,
            currents=seen.currents,
            faces=seen.faces,
            anchors=seen.anchors,
            history=np.array(self._history).reshape(-1, 5),
            work=seen.work,
            taken=float("nan"),
            cost=0.0,
            missed=0,
            notes=[seen.note] if seen.note else [],
        )

    def close(self) -> None:
        """Let the device's program know."""
        self._line.close()

    def _take(self, seen: _Seen) -> None:
        self._seen = seen
        self._history.extend(seen.rows)
        while self._history and self._history[0][0] < self._history[-1][0] - _HISTORY:
            self._history.popleft()


def _open(line: Connection, scene: str, settings: Settings, folder: Path) -> None:
    """Open the window; in its own process."""
    from maglev_mj.viewer.window import show

    try:
        show(_Watched(line, scene, settings), folder=folder)
    except MaglevError:
        pass  # the device's program has ended, and says why
    finally:
        line.close()
        # the engine's viewer leaves threads that outlive it by seconds
        os._exit(0)
