"""Recording files of runs."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from importlib.util import find_spec
from pathlib import Path
from typing import TypeAlias

import numpy as np

from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import Record
from maglev_mj.errors import ParameterError, file_path
from maglev_mj.frames import Command, Sample
from maglev_mj.parameters import flag
from maglev_mj.recording.mcap import require_mcap
from maglev_mj.recording.recording import Recording, RecordingError, Stretch
from maglev_mj.recording.sample import ROW, RecordedPlant, Row, Setup, as_rows, compiled
from maglev_mj.recording.setup import RecordingFile, attach_parts, whole_setup
from maglev_mj.recording.writer import LiveFile
from maglev_mj.versions import versions

_SUFFIXES = (".mcap", ".npz")


_RowOf: TypeAlias = Callable[[Sample, Command, Command, RecordedPlant], Row]


class Recorder:
    """Recording of a control loop in memory.

    Pass it to the loop as `record`.

    Args:
        plant: The controlled plant.
        setup: Setup of plant and controller, with the metadata as `run`.
    """

    def __init__(self, plant: RecordedPlant, setup: Setup) -> None:
        self._plant, self._setup = plant, setup
        self._rows: list[Row] = []
        self._gaps: list[tuple[int, int]] = []

    def __call__(self, sample: Sample, command: Command, applied: Command) -> None:
        """Record one cycle."""
        self._rows.append(row_of(sample, command, applied, self._plant))

    def __len__(self) -> int:
        return len(self._rows)

    def miss(self, count: int) -> None:
        """Record the number of samples missed before the next."""
        self._gaps.append((len(self._rows), count))

    def stretch(self) -> Stretch:
        """Return the recorded samples."""
        rows = as_rows(self._rows)
        arrays = {name: np.ascontiguousarray(rows[name]) for name in ROW.names or ()}
        return Stretch(setup=self._setup, arrays=arrays, gaps=tuple(self._gaps))


row_of: _RowOf = compiled("sample, command, applied, plant", "return ({values},)")
"""Return the values of one cycle in FIELDS order."""


class ArrayFile:
    """Recording in memory, written to an .npz file when closed.

    See `RecordingFile`.

    Args:
        path: Path of the file; None for memory only.
    """

    def __init__(self, path: Path | None = None) -> None:
        self._path, self._closed = path, False
        self._versions = versions()  # here, for a stretch may begin in real time
        self._recorders: list[Recorder] = []
        self._events: list[str] = []
        self._event_samples: list[int] = []
        self._attachments: dict[str, bytes] = {}

    @property
    def recording(self) -> Recording:
        """Recording of all samples so far."""
        return Recording(
            [recorder.stretch() for recorder in self._recorders if len(recorder)],
            events=tuple(self._events),
            event_samples=tuple(self._event_samples),
            attachments=self._attachments,
        )

    def begin(self, plant: RecordedPlant, controller: Controller, setup: Setup | None = None) -> Recorder:
        """Begin a stretch; return the loop's recording function."""
        whole = {**whole_setup(plant, controller, setup), "versions": self._versions}
        attach_parts(self, plant, controller)
        self._recorders.append(Recorder(plant, whole))
        return self._recorders[-1]

    def event(self, kind: str, text: str, missed: int = 0) -> None:
        """See `RecordingFile`."""
        self._events.append(f"{kind}: {text}")
        self._event_samples.append(sum(map(len, self._recorders)))
        if missed and self._recorders:
            self._recorders[-1].miss(missed)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """See `RecordingFile`; the media type is not kept."""
        self._attachments.setdefault(name, data)

    def check(self) -> None:
        """Do nothing: the file is written when closed."""

    def close(self) -> Path | None:
        """Write the file; see `RecordingFile.close`.

        If it cannot be written, a new folder in the temporary folder is used.

        Raises:
            RecordingError: If it is there.
            OSError: If it is in neither; the next call tries again.
        """
        recording = self.recording
        if self._closed or self._path is None or not recording.ticks:
            return self._path if self._closed else None
        try:
            recording.save(self._path)
        except OSError as error:
            kept = Path(tempfile.mkdtemp(prefix="maglev-"), self._path.name)
            recording.save(kept)
            asked, self._path, self._closed = self._path, kept, True
            raise RecordingError(f"{asked} cannot be written: {error.strerror or error}; it is in {kept}") from None
        self._closed = True
        return self._path


def best_suffix() -> str:
    """Return ".mcap" if this system can write it, else ".npz"."""
    return ".mcap" if hasattr(os, "fork") and find_spec("mcap") and find_spec("foxglove") else ".npz"


def check_name(path: Path) -> None:
    """Check a recording's file name and the required package.

    Raises:
        ParameterError: If the suffix is not known.
        MissingPackageError: If the package for .mcap is not installed.
    """
    if path.suffix not in _SUFFIXES:
        raise ParameterError(f"record must be a file that ends in {' or '.join(_SUFFIXES)}, not {str(path)!r}")
    if path.suffix == ".mcap":
        require_mcap()


def open_recording(path: Path | str, *, wait: bool = False) -> RecordingFile:
    """Open a file to record to, by its suffix.

    Args:
        path: Path with suffix .mcap, written during the run, or .npz, written at its end.
        wait: True if the run may wait for the writer; not for a run in real time.

    Raises:
        ParameterError: If it has another suffix.
        MissingPackageError: If the package for .mcap is not installed.
        OSError: If it cannot be written.

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> from maglev_mj import Bias, Controller, ExactPlant, Recording, drive, open_recording
        >>> with tempfile.TemporaryDirectory() as folder, ExactPlant() as plant:
        ...     file, controller = open_recording(Path(folder, "mine.npz")), Controller([Bias([0.0] * 6)], period=0.005)
        ...     last = drive(plant, controller, 5, record=file.begin(plant, controller))
        ...     ticks = Recording.load(file.close()).ticks
        >>> ticks
        5
    """
    flag("wait", wait)
    path = file_path(path)
    check_name(path)
    return LiveFile(path, wait=wait) if path.suffix == ".mcap" else ArrayFile(path)


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
