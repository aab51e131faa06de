"""A recording that is written while it happens, by a process of its own: it outlives this one, whatever ends it."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from maglev_mj.controller import Controller
from maglev_mj.loop import Record
from maglev_mj.recording.mcap_file import about, require_mcap
from maglev_mj.recording.recorder import Felt, carried_by
from maglev_mj.recording.ring import Ring
from maglev_mj.recording.stretch import RecordingError, Setup
from maglev_mj.workers import interrupts_held

__all__ = ["LiveFile"]

_PATIENCE = 60.0


class LiveFile:
    """Writes an MCAP file: see `RecordingFile`.

    A tick costs a row put into memory that the other process reads. That process writes until this one closes the file,
    or is gone.

    Args:
        path: Where to.
        wait: Whether to wait for it where a run is faster than it writes; a run in real time must not.

    Raises:
        McapMissingError: If the package is not installed.
        OSError: If the file cannot be written.
    """

    def __init__(self, path: Path, *, wait: bool = False) -> None:
        require_mcap()
        path.open("wb").close()
        self._path = path
        self._ring = Ring(wait=self.check if wait else None)
        command = [sys.executable, "-m", "maglev_mj.recording.writing", str(self._ring.path), str(path)]
        with interrupts_held():  # Ctrl-C ends the run, and the recording when the run says so
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True
            )
        self._result: Path | None = None
        self._closed = False

    def begin(self, plant: Felt, controller: Controller, setup: Setup, *, delay: float) -> Record:
        """Begin a stretch; return what the loop records it to."""
        carried, began = carried_by(controller), time.time_ns()
        self._say(begin=about(setup, period=controller.period, delay=delay, carried=carried, began=began))
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
        self._ring.path.unlink(missing_ok=True)
        kept = self._ring.count
        self._ring.close()
        if status["error"]:
            raise RecordingError(f"{self._path} is not whole: {status['error']}")
        if status["lost"]:
            raise RecordingError(f"{self._path} is not whole: {status['lost']} of {kept} samples came too fast")
        if kept:
            self._result = self._path
        else:
            self._path.unlink(missing_ok=True)
        return self._result

    def _say(self, **what: Any) -> None:
        """Tell the writer, before the next row is there."""
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):  # it is gone: `check` and `close` say so
            self._process.stdin.write(json.dumps({"at": self._ring.count, **what}) + "\n")
            self._process.stdin.flush()
