"""Recordings of a session, one file at a time.

Each lasts from one key press to the next.
"""

from __future__ import annotations

import tempfile
import threading
from datetime import datetime
from pathlib import Path

from maglev_mj.recording import RecordingError, RecordingFile, best_suffix, open_recording, tee
from maglev_mj.session.pacing import Note


class SessionRecorder:
    """Recordings of a session.

    Args:
        folder: Folder of the files.
        beside: Further destination of all samples, left open; None for none.

    Attributes:
        written: Closed recordings.
        file: Open recording; None for none.
    """

    def __init__(self, folder: Path, beside: RecordingFile | None = None) -> None:
        self.written: list[Path] = []
        self.file: RecordingFile | None = None
        self._folder, self._beside, self._failed, self._missed = folder, beside, "", 0
        self._said = Note()
        self._closing: list[threading.Thread] = []
        self._unwritten: dict[RecordingFile, str] = {}
        self._broken: list[str] = []
        self._named: set[Path] = set()

    @property
    def whole(self) -> RecordingFile | None:
        """File for all samples, None without one."""
        return tee(self.file, self._beside)

    def start(self, path: Path | None = None) -> None:
        """Begin a recording.

        Args:
            path: Path of the file; None for a new name in the folder, or in the temporary folder if that cannot be
                written.

        Raises:
            OSError: If the file cannot be written.
        """
        if path is not None:
            self.file = open_recording(path)
            return
        try:
            self.file = open_recording(self._new_path(self._folder))
        except OSError:
            self.file = open_recording(self._new_path(Path(tempfile.gettempdir())))

    def stop(self) -> None:
        """End the recording; its file is closed in another thread."""
        if self.file is None:
            return
        file, self.file = self.file, None
        self._said.say("writing the recording")
        self._closing.append(threading.Thread(target=self._keep, args=(file,)))
        self._closing[-1].start()

    def close(self) -> None:
        """End the recording and wait for all files.

        Raises:
            RecordingError: If one is not whole, or cannot be written after another try; all are tried.
        """
        self.stop()
        for thread in self._closing:
            thread.join()
        again, self._unwritten = self._unwritten, {}
        for file in again:
            self._keep(file)
        if broken := [*self._broken, *self._unwritten.values()]:
            raise RecordingError("; ".join(broken))

    def _keep(self, file: RecordingFile) -> None:
        """Close a file and report the outcome."""
        try:
            path = file.close()
        except RecordingError as error:  # the part before the error is on disk
            self._broken.append(str(error))
            self._failed = f"RECORDING: {error}"
            return
        except OSError as error:
            self._unwritten[file] = str(error)
            self._failed = f"RECORDING: {error}; it is tried again at the end"
            return
        self._said.say(f"wrote {path}" if path is not None else "nothing was recorded")
        if path is not None:
            self.written.append(path)

    def failed(self, why: str) -> None:
        """Set the reason of a stopped scene."""
        if (file := self.whole) is not None:
            file.event("fault", why)

    def missed(self, count: int) -> None:
        """Set the number of ticks given up so far."""
        more, self._missed = count - self._missed, count
        if more and (file := self.whole) is not None:
            file.event("missed", f"{more} ticks were given up: too slow", more)

    @property
    def notes(self) -> list[str]:
        """Recording status lines for the viewer.

        Success messages disappear after some seconds.
        """
        found = [*filter(None, [self._failed]), *self._said.lines]
        if self.file is None:
            return found
        try:
            self.file.check()
        except RecordingError as error:
            return [*found, f"NOT RECORDING: {error}"]
        return [*found, "RECORDING"]

    def _new_path(self, folder: Path) -> Path:
        """Return an unused name for a recording."""
        stem, suffix = datetime.now().strftime("maglev-%Y%m%d-%H%M%S"), best_suffix()
        path, count = folder / f"{stem}{suffix}", 1
        while path in self._named or path.exists():
            path, count = folder / f"{stem}-{count}{suffix}", count + 1
        self._named.add(path)
        return path
