"""What a session is recorded to: one file after the other, each from a key to the next."""

from __future__ import annotations

import tempfile
from datetime import datetime
from pathlib import Path

from maglev_mj.recording import RecordingError, RecordingFile, best_suffix, open_recording, tee

__all__ = ["Tape"]


class Tape:
    """The recordings of a session.

    Args:
        folder: Where they go.
        beside: File that everything goes to as well, left open; None for none.

    Attributes:
        written: Those that are closed.
        file: The one that is open; None while nothing is recorded.
    """

    def __init__(self, folder: Path, beside: RecordingFile | None = None) -> None:
        self.written: list[Path] = []
        self.file: RecordingFile | None = None
        self._folder, self._beside, self._said, self._missed = folder, beside, "", 0

    @property
    def whole(self) -> RecordingFile | None:
        """What a stretch is to be recorded to; None for nothing."""
        return tee(self.file, self._beside)

    def start(self, path: Path | None = None) -> None:
        """Begin a recording.

        Args:
            path: Where to; None for a new name in the folder, or in the temporary one where that does not take it.

        Raises:
            OSError: If the file cannot be written.
        """
        if path is not None:
            self.file = open_recording(path)
            return
        try:
            self.file = open_recording(_new_path(self._folder))
        except OSError:
            self.file = open_recording(_new_path(Path(tempfile.gettempdir())))

    def stop(self) -> None:
        """End the recording, if there is one.

        Raises:
            OSError: If it cannot be written; it is tried again the next time.
        """
        if self.file is None:
            return
        path = None
        try:
            path = self.file.close()
            self._said = f"wrote {path}" if path is not None else "nothing was recorded"
        except RecordingError as error:  # what there is of it, is there
            self._said = f"RECORDING: {error}"
        self.file = None  # only now, for what could not be written is tried again
        if path is not None:
            self.written.append(path)

    def failed(self, why: str) -> None:
        """Keep why the scene stopped."""
        if (file := self.whole) is not None:
            file.event("fault", why)

    def missed(self, count: int) -> None:
        """Keep how many ticks have been given up so far."""
        more, self._missed = count - self._missed, count
        if more and (file := self.whole) is not None:
            file.event("missed", f"{more} ticks were given up: too slow", more)

    @property
    def note(self) -> str:
        """How it goes, for a person; empty where nothing was ever recorded."""
        if self.file is None:
            return self._said
        try:
            self.file.check()
        except RecordingError as error:
            return f"NOT RECORDING: {error}"
        return "RECORDING"


def _new_path(folder: Path) -> Path:
    """Return a name for a recording that no file has yet."""
    stem, suffix = datetime.now().strftime("maglev-%Y%m%d-%H%M%S"), best_suffix()
    path, count = folder / f"{stem}{suffix}", 1
    while path.exists():
        path, count = folder / f"{stem}-{count}{suffix}", count + 1
    return path
