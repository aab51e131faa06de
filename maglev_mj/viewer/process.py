"""A window on a device that this process runs, in a process of its own: drawing must not hold up what has deadlines."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from maglev_mj.errors import MaglevError
from maglev_mj.hand import SpringHand
from maglev_mj.process import SideProcess
from maglev_mj.session import EMERGENCY_STOP, History, Snapshot, Wish, actions

__all__ = ["RemoteViewer"]

_MOST_ROWS = 400


class RemoteViewer:
    """A window in a process of its own: a `Publisher`.

    Args:
        snapshot: What it shows at first.
        folder: Folder for screenshots.

    Attributes:
        hand: The mouse's.
        on_close: Called once when the person has closed the window; may be replaced.
        on_emergency: Called by `take` when the emergency stop's key was pressed; may be replaced, and may raise.
    """

    def __init__(self, snapshot: Snapshot, folder: Path = Path()) -> None:
        self.hand, self.on_close = SpringHand(), _nothing
        self.on_emergency: Callable[[], object] = _nothing
        self._scene, self._sent, self._open = snapshot.scene, -np.inf, True
        self._window = SideProcess(_open, snapshot, folder)

    def show(self, snapshot: Snapshot) -> None:
        """Show a snapshot; where the window does not keep up, it is left out."""
        self._scene = snapshot.scene
        if not self._window.ready:
            return
        # only the rows that are new, and so many that writing them cannot wait
        rows = snapshot.history[np.searchsorted(snapshot.history[:, 0], self._sent, side="right") :]
        self._sent = snapshot.time
        self._window.send(replace(snapshot, history=rows[-_MOST_ROWS:]))

    def take(self) -> Wish | None:
        """Move the hand as the mouse does; return the scene that keys ask for."""
        wanted = None
        for kind, value in self._window.received():
            if kind == "hand":
                self.hand.target = value
            elif value == EMERGENCY_STOP:
                self.on_emergency()
            elif (change := actions(type(self._scene)).get(value)) is not None:
                self._scene = wanted = change(self._scene)
        if self._window.ended and self._open:
            self._open, self.hand.target = False, None
            self.on_close()
        return None if wanted is None else Wish(wanted)

    def close(self) -> None:
        """Close the window; a second time does nothing."""
        self._open = False
        self._window.close()


class RemoteSession:
    """The session behind a window in a process of its own: a `SnapshotSource`.

    Args:
        line: To the process that runs the device.
        snapshot: What is shown until the device has sent something.
    """

    def __init__(self, line: Connection, snapshot: Snapshot) -> None:
        self.hand, self.simulated = SpringHand(), 0.0
        self._line, self._snapshot, self._history = line, snapshot, History()
        self._over = False
        self._target: Any = None

    def tick(self, elapsed: float) -> int:
        """Take the snapshots that the device has sent; return the number of samples since the last."""
        before = self._snapshot.tick
        try:
            while not self._over and self._line.poll():
                self._snapshot = self._line.recv()
                for row in self._snapshot.history:
                    self._history.add(*row)
            if self._target != self.hand.target:
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

    def snapshot(self) -> Snapshot:
        """Return the picture of now."""
        return replace(self._snapshot, history=self._history.rows)

    def close(self) -> None:
        """Let the device's program know."""
        self._line.close()


def _nothing() -> None: ...


def _open(line: Connection, snapshot: Snapshot, folder: Path) -> None:
    """Open the window; in its own process."""
    from maglev_mj.viewer.window import show

    try:
        show(RemoteSession(line, snapshot), folder=folder)
    except MaglevError:
        pass  # the device's program has ended, and says why
    finally:
        line.close()
        # the engine's viewer leaves threads that outlive it by seconds
        os._exit(0)
