"""Recording of a run to a journal or to memory."""

from __future__ import annotations

import base64
from pathlib import Path

import numpy as np

from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import Record
from maglev_mj.errors import ParameterError, file_path
from maglev_mj.frames import Command, Sample
from maglev_mj.keywords import checked
from maglev_mj.parameters import flag
from maglev_mj.recording.formats import FORMATS
from maglev_mj.recording.journal import PACK_SAMPLE, SUFFIX, Journal, microseconds
from maglev_mj.recording.recording import Recording, Segment, stick_as_json
from maglev_mj.recording.sample import ROW, RecordedPlant, Row, Setup, as_rows, row_of
from maglev_mj.recording.setup import RecordingFile, attach_parts, complete_setup
from maglev_mj.versions import versions

_FAULT = "fault"  # kind of the events that are synced to disk immediately


class JournalFile:
    """Journal written during the run; see `RecordingFile`.

    A tick appends a record to a queue, which a thread writes every 0.1 s. An existing file is replaced at the first
    sample.

    Args:
        path: Path of the file.
        wait: True if the run waits for the disk; False in real time.

    Raises:
        RecordingError: If another program is writing this file.
        OSError: If the file cannot be written.
    """

    def __init__(self, path: Path, *, wait: bool = False) -> None:
        self._waits, self._attached = wait, set[str]()
        self._controller: Controller | None = None
        self._stuck = repr(None)
        self._versions = versions()  # too slow for the start of a segment in real time
        self._journal = Journal(path, wait=wait)

    def begin(self, plant: RecordedPlant, controller: Controller, setup: Setup | None = None) -> Record:
        """Start a segment; return the loop's recording function."""
        complete = {**complete_setup(plant, controller, setup), "versions": self._versions}
        attach_parts(self, plant, controller)
        self._journal.text({"begin": complete, "time": microseconds()})
        self._controller, self._stuck = controller, repr(None)
        append, has_room, record_stick = self._journal.append, self._journal.has_room, self._record_stick_position

        def record(sample: Sample, command: Command, applied: Command) -> None:
            if has_room():
                append(PACK_SAMPLE(*row_of(sample, command, applied, plant)))

        def record_all(sample: Sample, command: Command, applied: Command) -> None:
            record_stick()
            record(sample, command, applied)

        return record_all if self._waits else record

    def event(self, kind: str, text: str, missed: int = 0) -> None:
        """See `RecordingFile.event`."""
        self._journal.text({"event": kind, "text": text, "missed": missed}, urgent=kind == _FAULT)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """See `RecordingFile.attach`."""
        if name in self._attached:
            return
        self._attached.add(name)
        self._journal.text({"attach": name, "type": media_type, "data": base64.b64encode(data).decode()})

    def append(self, records: bytes) -> None:
        """See `RecordingFile.append`."""
        if self._journal.has_room():
            self._journal.append(records)

    def check(self) -> None:
        """Check that the recording is being written.

        Raises:
            RecordingError: If writing has failed.
        """
        self._journal.check()
        self._record_stick_position()

    def close(self) -> Path | None:
        """Finish writing; return the path, or None without samples; idempotent.

        Raises:
            RecordingError: If the file is incomplete.
        """
        return self._journal.close()

    def _record_stick_position(self) -> None:
        """Record the stick position if it has changed; too slow for a tick in real time."""
        stuck = None if self._controller is None else self._controller.stick_positions
        position = None if stuck is None else stuck.tolist()
        if repr(position) != self._stuck:  # as text, because NaN != NaN
            self._stuck = repr(position)
            self._journal.text({"stick": stick_as_json(position)})


class Recorder:
    """Recorder of a control loop in memory; pass it to the loop as `record`.

    Args:
        plant: The controlled plant.
        setup: Setup of plant and controller, with the metadata as `run`.
    """

    def __init__(self, plant: RecordedPlant, setup: Setup) -> None:
        self._plant, self._setup = plant, setup
        self._rows: list[Row] = []
        self._start = microseconds()
        self._gaps: list[tuple[int, int]] = []

    def __call__(self, sample: Sample, command: Command, applied: Command) -> None:
        """Record one tick."""
        self._rows.append(row_of(sample, command, applied, self._plant))

    def __len__(self) -> int:
        return len(self._rows)

    def miss(self, count: int) -> None:
        """Record the number of samples missed before the next one."""
        self._gaps.append((len(self._rows), count))

    def segment(self) -> Segment:
        """Return the recorded samples."""
        rows = as_rows(self._rows)
        arrays = {name: np.ascontiguousarray(rows[name]) for name in ROW.names or ()}
        return Segment(setup=self._setup, arrays=arrays, gaps=tuple(self._gaps), began=self._start)


class MemoryFile:
    """Recording in memory; see `RecordingFile`."""

    def __init__(self) -> None:
        self._versions = versions()  # too slow for the start of a segment in real time
        self._recorders: list[Recorder] = []
        self._events: list[str] = []
        self._event_samples: list[int] = []
        self._attachments: dict[str, bytes] = {}

    @property
    def recording(self) -> Recording:
        """Recording of the samples so far."""
        return Recording(
            [recorder.segment() for recorder in self._recorders if len(recorder)],
            events=tuple(self._events),
            event_samples=tuple(self._event_samples),
            attachments=self._attachments,
        )

    def begin(self, plant: RecordedPlant, controller: Controller, setup: Setup | None = None) -> Recorder:
        """Start a segment; return the loop's recording function."""
        complete = {**complete_setup(plant, controller, setup), "versions": self._versions}
        attach_parts(self, plant, controller)
        self._recorders.append(Recorder(plant, complete))
        return self._recorders[-1]

    def event(self, kind: str, text: str, missed: int = 0) -> None:
        """See `RecordingFile.event`."""
        self._events.append(f"{kind}: {text}")
        self._event_samples.append(sum(map(len, self._recorders)))
        if missed and self._recorders:
            self._recorders[-1].miss(missed)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """See `RecordingFile.attach`; the media type is ignored."""
        self._attachments.setdefault(name, data)

    def append(self, records: bytes) -> None:
        """Do nothing: device cycles are not recorded in memory."""

    def check(self) -> None:
        """Do nothing: recording to memory cannot fail."""

    def close(self) -> Path | None:
        """Return None: there is no file."""
        return None


def check_name(path: Path) -> None:
    """Check the file name of a recording.

    Raises:
        ParameterError: If its suffix is not .maglev, or it is a device or FIFO: readers map the file into memory.
    """
    if path.suffix[1:] in FORMATS:
        journal = path.with_suffix(SUFFIX)
        raise ParameterError(
            f"record must end in {SUFFIX} (got {path.suffix}): record to {journal}, then run "
            f"`maglev-mj convert {journal} {path}`"
        )
    if path.suffix != SUFFIX:
        raise ParameterError(f"record must be a file that ends in {SUFFIX} (got {str(path)!r})")
    if path.exists() and not path.is_file():
        raise ParameterError(f"record must be a new or regular file (got {str(path)!r})")


@checked
def open_recording(path: Path | str, *, wait: bool = False) -> RecordingFile:
    """Open a journal to record to.

    Args:
        path: Path with the suffix .maglev.
        wait: True if the run may wait for the disk; False in real time.

    Raises:
        ParameterError: If the suffix is different.
        RecordingError: If another program is writing this file.
        OSError: If the file cannot be written.

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> from maglev_mj import Bias, Controller, ExactPlant, Recording, drive, open_recording
        >>> with tempfile.TemporaryDirectory() as folder, ExactPlant() as plant:
        ...     file = open_recording(Path(folder, "mine.maglev"))
        ...     controller = Controller([Bias([0.0] * 6)], period=0.005)
        ...     last = drive(plant, controller, 5, record=file.begin(plant, controller))
        ...     ticks = Recording.load(file.close()).ticks
        >>> ticks
        5
    """
    flag("wait", wait)
    path = file_path(path)
    check_name(path)
    return JournalFile(path, wait=wait)
