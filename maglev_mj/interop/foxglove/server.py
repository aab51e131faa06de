"""Live server: samples and parameters for Foxglove programs."""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import Record
from maglev_mj.errors import MaglevError, require
from maglev_mj.interop.foxglove.settings import Answer, State
from maglev_mj.process import SideProcess, be_nice
from maglev_mj.recording import Setup
from maglev_mj.recording.ring import Ring, RowReader
from maglev_mj.recording.sample import RecordedPlant
from maglev_mj.recording.setup import whole_setup
from maglev_mj.session import ChangeRequest, Snapshot
from maglev_mj.session.access import ListenError, check_origin, listen
from maglev_mj.versions import versions

PORT = 8765
"""Default port of Foxglove programs."""

_PATIENCE = 60.0
_SAME = 1e-5
"""Largest difference of equal delays [s]."""
_UNSENT = 256


class LiveServerError(MaglevError):
    """Live server cannot start: package missing, port in use, or no memory to share."""


class LiveServer:
    """Server of a running scene to other programs.

    It is a `RecordingFile` and a `Publisher`.

    It logs, checks and answers in processes of its own. The control loop only writes a row to shared memory
    and looks for a new scene; it never waits.

    Args:
        port: Port of 127.0.0.1; 0 for any free one.
        origins: Origins of viewers' pages that may connect, besides this machine's and Foxglove's.

    Attributes:
        port: Port of the server.

    Raises:
        ParameterError: If the port or an origin is invalid.
        MissingPackageError: If the package is not installed.
        LiveServerError: If the port is taken, or the process does not start, as from a script without
            `if __name__ == "__main__":`.

    Example:
        >>> from maglev_mj import LiveServer, Session, real_time
        >>> session = Session(publishers=[LiveServer()])  # doctest: +SKIP
        >>> for elapsed, now in real_time(60.0, step=0.005):  # doctest: +SKIP
        ...     session.tick(elapsed)
    """

    def __init__(self, port: int = PORT, origins: Sequence[str] = ()) -> None:
        origins = [check_origin(one) for one in origins]
        require(("foxglove",), "record", "a live server needs foxglove-sdk")
        try:
            listener = listen(port)
        except ListenError as error:
            raise LiveServerError(str(error)) from None
        with listener:  # the other process has it then
            self.port: int = listener.getsockname()[1]
            try:
                self._ring, self._versions = Ring(), versions()
            except OSError as error:
                raise LiveServerError(f"no memory to share with the live server: {error.strerror}") from None
            try:
                self._process = SideProcess(_serve, self._ring.path, listener, origins)
            except BaseException:
                self._ring.close()
                raise
        self._told, self._stuck = State(), repr(None)
        self._answer: Answer | None = None
        self._unsent: deque[tuple[Any, ...]] = deque()
        self._process.line.poll(_PATIENCE)
        if why := next(self._process.received(), 'a script that opens one needs `if __name__ == "__main__":`'):
            self.close()
            raise LiveServerError(f"the process of the live server does not start: {why}")

    def begin(self, plant: RecordedPlant, controller: Controller, setup: Setup | None = None) -> Record:
        """Begin a stretch; return the loop's recording function."""
        whole = {**whole_setup(plant, controller, setup), "versions": self._versions}
        self._queue("begin", whole, time.time_ns())
        self._stuck = repr(None)
        return self._ring.record(plant)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Do nothing: recordings hold the attachments."""

    def event(self, kind: str, text: str, missed: int = 0) -> None:
        """Send an event to all clients."""
        self._queue("event", kind, text, missed)

    def check(self) -> None:
        """Do nothing: the scene runs on without the server's process."""

    def take(self) -> ChangeRequest | None:
        """Return an accepted scene requested by a program, once."""
        for scene in self._process.received():
            return ChangeRequest(scene, self._note)
        return None

    def show(self, snapshot: Snapshot) -> None:
        """Send a changed scene, state or stick position.

        Samples go through shared memory.
        """
        stuck = None if snapshot.anchors is None else snapshot.anchors.tolist()
        if repr(stuck) != self._stuck:  # NaN does not differ from itself in it
            self._stuck = repr(stuck)
            self._queue("stick", stuck)
        state = f"{snapshot.state}: {snapshot.reason}" if snapshot.reason else snapshot.state
        now, told = State(snapshot.scene, snapshot.delay, snapshot.inertia, state), self._told
        same = now.scene is told.scene and now.state == told.state and abs(now.delay - told.delay) < _SAME
        if self._answer is not None or not same:
            self._queue("show", now, self._answer)
            self._told, self._answer = now, None
        else:
            self._send()

    def close(self) -> None:
        """Close all connections; idempotent."""
        self._process.close()
        self._ring.close()

    def _note(self, answer: int | str) -> None:
        # one scene at a time is handed over: none is written over
        self._answer = Answer(reason=answer) if isinstance(answer, str) else Answer(answer)

    def _queue(self, *order: Any) -> None:
        """Send a message to the server, before the next row."""
        self._unsent.append((self._ring.count, *order))
        if len(self._unsent) > _UNSENT:  # all can be dropped but the beginning of rows, and answers to requests
            for place, one in enumerate(self._unsent):
                if one[1] != "begin" and not isinstance(one[-1], Answer):
                    del self._unsent[place]
                    break
        self._send()

    def _send(self) -> None:
        while self._unsent and self._process.ready:  # the loop does not wait for a process that hangs
            self._process.send(self._unsent.popleft())


def _serve(line: Connection, ring: Path, *arguments: Any) -> None:
    """Run `serve` with imports needed in its process only."""
    be_nice()
    from maglev_mj.interop.foxglove.service import serve

    rows = RowReader(ring)
    serve(line, rows, *arguments)
    rows.close()
    os._exit(0)  # the closing process waits, and the interpreter's own end is slow
