"""The live server: programs that read the Foxglove protocol see every sample, and set the parameters of the scene."""

from __future__ import annotations

import os
import time
from collections import deque
from typing import Any

from maglev_mj.controller import Controller
from maglev_mj.errors import MaglevError, require
from maglev_mj.live.settings import NICE, Answer, State
from maglev_mj.loop import Record
from maglev_mj.net.addresses import ListenError, check_port, listen
from maglev_mj.process import SideProcess
from maglev_mj.recording import Setup
from maglev_mj.recording.live import Ring, RowReader
from maglev_mj.recording.row import RecordedPlant
from maglev_mj.recording.setup import whole_setup
from maglev_mj.session import Snapshot, Wish
from maglev_mj.versions import versions

__all__ = ["PORT", "LiveServer", "LiveServerError"]

PORT = 8765
"""Where programs look by default."""

_PATIENCE = 60.0
_SAME = 1e-5
"""Delays that differ by less are the same [s]."""
_UNSENT = 256


class LiveServerError(MaglevError):
    """The live server cannot start: its package is not installed, or its port is taken."""


class LiveServer:
    """Serves a running scene to other programs: a `RecordingFile` and a `Publisher`.

    It logs, checks and answers in processes of its own. For the control loop a sample is a row put into memory that is
    shared, and a look for a scene that it may go on with; it waits for neither.

    Args:
        port: Of 127.0.0.1; 0 for any that is free.

    Attributes:
        port: Where it listens.

    Raises:
        ParameterError: If the port is none.
        MissingPackageError: If the package is not installed.
        LiveServerError: If the port is taken, or the process does not start, as from a script without
            `if __name__ == "__main__":`.
    """

    def __init__(self, port: int = PORT) -> None:
        check_port(port)
        require(("foxglove",), "record", "a live server needs foxglove-sdk")
        if not hasattr(os, "fork"):
            raise LiveServerError("a live server needs a POSIX system")
        try:
            listener = listen(port)
        except ListenError as error:
            raise LiveServerError(str(error)) from None
        with listener:  # the other process has it then
            self.port: int = listener.getsockname()[1]
            self._ring, self._versions = Ring(), versions()
            self._process = SideProcess(_serve, _Shared(self._ring.descriptor), listener)
        self._told, self._stuck = State(), repr(None)
        self._answer: Answer | None = None
        self._unsent: deque[tuple[Any, ...]] = deque()
        self._process.line.poll(_PATIENCE)
        if why := next(self._process.received(), 'a script that opens one needs `if __name__ == "__main__":`'):
            self.close()
            raise LiveServerError(f"the process of the live server does not start: {why}")

    def begin(self, plant: RecordedPlant, controller: Controller, setup: Setup | None = None) -> Record:
        """Begin a stretch; return what the loop records it to."""
        whole = {**whole_setup(plant, controller, setup), "versions": self._versions}
        self._say("begin", whole, time.time_ns())
        self._stuck = repr(None)
        return self._ring.record(plant)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Do nothing: a recording has what can be attached."""

    def event(self, kind: str, text: str, missed: int = 0) -> None:
        """Tell everybody what a person should know of."""
        self._say("event", kind, text, missed)

    def check(self) -> None:
        """Do nothing: where its process ends, the scene goes on."""

    def take(self) -> Wish | None:
        """Return the scene that a program asks for and may have, once."""
        for scene in self._process.received():
            return Wish(scene, self._note)
        return None

    def show(self, snapshot: Snapshot) -> None:
        """Tell the process of another scene, state or stick position; samples reach it by themselves."""
        stuck = None if snapshot.anchors is None else snapshot.anchors.tolist()
        if repr(stuck) != self._stuck:  # NaN does not differ from itself in it
            self._stuck = repr(stuck)
            self._say("stick", stuck)
        state = f"{snapshot.state}: {snapshot.reason}" if snapshot.reason else snapshot.state
        now, told = State(snapshot.scene, snapshot.delay, snapshot.inertia, state), self._told
        same = now.scene is told.scene and now.state == told.state and abs(now.delay - told.delay) < _SAME
        if self._answer is not None or not same:
            self._say("show", now, self._answer)
            self._told, self._answer = now, None
        else:
            self._send()

    def close(self) -> None:
        """Let everybody go; a second time does nothing."""
        self._process.close()
        self._ring.close()

    def _note(self, answer: int | str) -> None:
        # one scene at a time is handed over: none is written over
        self._answer = Answer(reason=answer) if isinstance(answer, str) else Answer(answer)

    def _say(self, *order: Any) -> None:
        """Tell the process, before the next row is there."""
        self._unsent.append((self._ring.count, *order))
        if len(self._unsent) > _UNSENT:  # all can go but what rows began with, and what a request waits for
            for place, one in enumerate(self._unsent):
                if one[1] != "begin" and not isinstance(one[-1], Answer):
                    del self._unsent[place]
                    break
        self._send()

    def _send(self) -> None:
        while self._unsent and self._process.ready:  # the loop does not wait for a process that hangs
            self._process.send(self._unsent.popleft())


def _serve(*arguments: Any) -> None:
    """See `serve`, which loads what only its process needs."""
    os.nice(NICE)
    from maglev_mj.live.service import serve

    serve(*arguments)
    os._exit(0)  # whoever closes it waits, and the interpreter takes its time to end


class _Shared:
    """A ring's memory, which the process that is being started gets a reader of."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def __reduce__(self) -> Any:
        from multiprocessing.reduction import DupFd  # which some systems do not have

        return _reader, (DupFd(self._descriptor),)


def _reader(shared: Any) -> RowReader:
    return RowReader(shared.detach())
