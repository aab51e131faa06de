"""A recording that is written while it happens, by a process of its own: it outlives this one, whatever ends it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from maglev_mj.controller import Controller
from maglev_mj.loop import Record
from maglev_mj.parameters import flag
from maglev_mj.recording.mcap_file import about
from maglev_mj.recording.mcap_reader import require_mcap
from maglev_mj.recording.recorder import Felt, Mechanics
from maglev_mj.recording.ring import Ring
from maglev_mj.recording.stretch import RecordingError, Setup
from maglev_mj.versions import versions
from maglev_mj.workers import interrupts_held

__all__ = ["LiveFile"]

_PATIENCE = 60.0
_WRITER = "maglev_mj.recording.writing"


class LiveFile:
    """Writes an MCAP file: see `RecordingFile`.

    A tick costs a row put into memory that the other process reads. That process writes until this one closes the file,
    or is gone. What was there under the name stays until there is a sample to take its place.

    Args:
        path: Where to.
        wait: Whether to wait for it where a run is faster than it writes; a run in real time must not.

    Raises:
        McapMissingError: If the package is not installed.
        RecordingError: If this system is none for it, or has no memory left to share.
        OSError: If the file cannot be written.
    """

    def __init__(self, path: Path, *, wait: bool = False) -> None:
        flag("wait", wait)
        require_mcap()
        if not hasattr(os, "fork"):
            raise RecordingError("recordings as MCAP need a POSIX system; .npz needs none")
        self._path, self._closed = path, False
        self._versions = versions()  # here, for a stretch may begin in real time
        self._aside = path.with_name(f"{path.name}.{os.getpid()}.partial")
        self._aside.open("wb").close()
        try:
            self._ring = _ring(self.check if wait else None)
            self._process = self._start()
        except BaseException:
            self._aside.unlink(missing_ok=True)
            raise
        self._result: Path | None = None

    def begin(
        self, plant: Felt, controller: Controller, setup: Setup, *, delay: float, mechanics: Mechanics | None = None
    ) -> Record:
        """Begin a stretch; return what the loop records it to."""
        what = about(
            {**setup, "versions": self._versions},
            period=controller.period,
            delay=delay,
            carried=controller.carried.tolist(),
            began=time.time_ns(),
            mechanics=mechanics or Mechanics(),
        )
        self._say(begin=what)
        return self._ring.record(plant)

    def event(self, kind: str, text: str, missed: int = 0) -> None:
        """Keep what a person should know of, and how many samples were missed with it."""
        self._say(event=[kind, text, missed])

    def check(self) -> None:
        """Check that it is being written.

        Raises:
            RecordingError: If the process that writes is gone.
        """
        if not self._closed and self._process.poll() is not None:
            raise RecordingError(f"{self._path} is not written any more: its writer ended")

    def close(self) -> Path | None:
        """Write what is left; return the file, or None where nothing was recorded. A second time does nothing.

        Raises:
            RecordingError: If it is not whole.
        """
        if self._closed:
            return self._result
        self._closed = True
        try:
            said, _ = self._process.communicate(timeout=_PATIENCE)
            status = json.loads(said)
        except (ValueError, subprocess.TimeoutExpired):
            self._process.kill()
            status = {"error": "its writer ended"}
        kept = self._ring.count
        self._ring.close()
        if status["error"]:
            raise RecordingError(f"{self._path} is not whole: {status['error']}")
        if status["lost"]:
            raise RecordingError(f"{self._path} is not whole: {status['lost']} of {kept} samples came too fast")
        if kept:
            self._result = self._path
        return self._result

    def _start(self) -> subprocess.Popen[str]:
        ring = self._ring.descriptor
        # modules come from where this process has them from, and not from the folder that it happens to be in
        path = os.pathsep.join(entry or os.getcwd() for entry in sys.path)
        with interrupts_held():  # Ctrl-C ends the run, and the recording when the run says so
            return subprocess.Popen(
                [sys.executable, "-P", "-m", _WRITER, str(ring), str(self._aside), str(self._path)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                start_new_session=True,
                pass_fds=[ring],
                env={**os.environ, "PYTHONPATH": path},
            )

    def _say(self, **what: Any) -> None:
        """Tell the writer, before the next row is there."""
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):  # it is gone: `check` and `close` say so
            self._process.stdin.write(json.dumps({"at": self._ring.count, **what}) + "\n")
            self._process.stdin.flush()


def _ring(wait: Callable[[], object] | None) -> Ring:
    try:
        return Ring(wait=wait)
    except OSError as error:
        raise RecordingError(f"no memory to share with what writes a recording: {error.strerror}") from None
