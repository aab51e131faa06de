"""Recording of one run to several files."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from maglev_mj.controller import Controller
from maglev_mj.frames import Command, Sample
from maglev_mj.loop import Record
from maglev_mj.recording.files import RecordingFile
from maglev_mj.recording.metadata import Setup
from maglev_mj.recording.row import RecordedPlant
from maglev_mj.recording.setup import whole_setup


def tee(*files: RecordingFile | None) -> RecordingFile | None:
    """Return one file that writes to all given, or None."""
    given = [file for file in files if file is not None]
    return _Tee(given) if len(given) > 1 else given[0] if given else None


class _Tee:
    """Group of files that record the same run.

    See `RecordingFile`.
    """

    def __init__(self, files: Sequence[RecordingFile]) -> None:
        self._files = files

    def begin(self, plant: RecordedPlant, controller: Controller, setup: Setup | None = None) -> Record:
        """Begin a stretch in each; return one recording function."""
        whole = whole_setup(plant, controller, setup)
        records = [file.begin(plant, controller, whole) for file in self._files]

        def record(sample: Sample, command: Command, applied: Command) -> None:
            for one in records:
                one(sample, command, applied)

        return record

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """See `RecordingFile`."""
        for file in self._files:
            file.attach(name, media_type, data)

    def event(self, kind: str, text: str, missed: int = 0) -> None:
        """See `RecordingFile`."""
        for file in self._files:
            file.event(kind, text, missed)

    def check(self) -> None:
        """See `RecordingFile`."""
        for file in self._files:
            file.check()

    def close(self) -> Path | None:
        """Close all files; return the first one written.

        An error of one file does not keep the others open.
        """
        paths: list[Path | None] = []

        def close(file: RecordingFile) -> None:
            paths.append(file.close())

        with ExitStack() as closing:
            for file in reversed(self._files):
                closing.callback(close, file)
        return next((path for path in paths if path is not None), None)
