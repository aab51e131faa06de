"""Recording files of runs: arrays at the end, or MCAP meanwhile by another process.

That process outlives the recording one, even if that is killed. Rows pass through a ring buffer. Messages pass through
a pipe, and their number through the ring: a row is not logged before those sent ahead of it. The writer ends with the
pipe: the recording was closed, or the recording process has ended.
"""

from __future__ import annotations

import base64
import json
import math
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from queue import SimpleQueue
from typing import IO, Any, TypeAlias

import numpy as np

from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import Record
from maglev_mj.errors import ParameterError, file_path
from maglev_mj.frames import Command, Sample
from maglev_mj.parameters import flag
from maglev_mj.process import interrupts_held
from maglev_mj.recording.mcap import FORMAT, METADATA, require_mcap
from maglev_mj.recording.recording import Recording, RecordingError, Stretch
from maglev_mj.recording.ring import Ring, RowReader
from maglev_mj.recording.sample import ROW, RecordedPlant, Row, Setup, as_rows, compiled, units
from maglev_mj.recording.setup import RecordingFile, attach_parts, whole_setup
from maglev_mj.versions import versions

_PATIENCE = 60.0
# a window waits for the end, and the interpreter takes its time
_WRITER = "import os; from maglev_mj.recording.writer import main; main(); os._exit(0)"
_TOGETHER = 1 << 10  # samples that are added up at once
_LOST = 0.1  # s that a SIGKILL to the writer may cost
_CHUNK = 1 << 16  # before it is packed: some 150 samples, lost by damage to one of its bytes
_NAP = 0.02
_RENAMES_OPEN = os.name != "nt"  # where a file that is written can get its name before the end


class LiveFile:
    """MCAP file written during the run; see `RecordingFile`.

    A tick writes one row to shared memory. The other process writes the file until this one closes it
    or ends. An existing file of that name stays until the first sample.

    Args:
        path: Path of the file.
        wait: True if a run faster than the writer waits for it; not for a run in real time.

    Raises:
        RecordingError: If the system has no memory left to share.
        OSError: If the file cannot be written.
    """

    def __init__(self, path: Path, *, wait: bool = False) -> None:
        self._path, self._closed, self._waits, self._attached = path, False, wait, set[str]()
        self._controller: Controller | None = None
        self._stuck, self._sent = repr(None), 0
        self._versions = versions()  # here, for a stretch may begin in real time
        self._aside = path.with_name(f"{path.name}.{os.getpid()}.partial")
        self._result: Path | None = None
        self._aside.open("wb").close()
        with ExitStack() as undo:
            undo.callback(self._aside.unlink, missing_ok=True)
            try:
                self._ring = Ring(wait=self.check if wait else None)
            except OSError as error:
                why = f"no memory to share with what writes a recording: {error.strerror}"
                raise RecordingError(why) from None
            undo.callback(self._ring.close)
            self._process = self._start()
            undo.pop_all()

    def begin(self, plant: RecordedPlant, controller: Controller, setup: Setup | None = None) -> Record:
        """Begin a stretch; return the loop's recording function."""
        whole = {**whole_setup(plant, controller, setup), "versions": self._versions}
        attach_parts(self, plant, controller)
        self._send("begin", whole, time.time_ns())
        self._controller, self._stuck = controller, repr(None)
        return self._ring.record(plant, first=self._tell_stick_position if self._waits else None)

    def event(self, kind: str, text: str, missed: int = 0) -> None:
        """Record an event for the user.

        `missed` is the number of samples missed with it.
        """
        self._send("event", kind, text, missed)

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Attach a file; see `RecordingFile.attach`."""
        if name in self._attached:
            return
        self._attached.add(name)
        self._send("attach", name, media_type, base64.b64encode(data).decode())

    def check(self) -> None:
        """Check that the recording is being written.

        Raises:
            RecordingError: If the writing process has ended.
        """
        if self._closed:
            return
        if self._process.poll() is not None:
            raise RecordingError(f"{self._path} is not written any more: its writer ended")
        self._tell_stick_position()

    def _tell_stick_position(self) -> None:
        """Send a changed stick position to the writer.

        Too slow for a tick in real time.
        """
        stuck = None if self._controller is None else self._controller.stick_positions
        position = None if stuck is None else stuck.tolist()
        if repr(position) != self._stuck:  # which NaN does not differ from itself in
            self._stuck = repr(position)
            self._send("stick", position)

    def close(self) -> Path | None:
        """Finish writing; return the file, or None without samples.

        A second call does nothing.

        Raises:
            RecordingError: If the file is incomplete.
        """
        if self._closed:
            return self._result
        self._closed = True
        try:
            answer, _ = self._process.communicate(timeout=_PATIENCE)
            status = json.loads(answer)
        except (ValueError, subprocess.TimeoutExpired):
            self._process.kill()
            self._process.communicate()
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
        # modules come from where this process has them from, and not from the folder that it happens to be in
        path = os.pathsep.join(entry or os.getcwd() for entry in sys.path)
        with interrupts_held():  # Ctrl-C ends the run, and the recording when the run says so
            return subprocess.Popen(
                [sys.executable, "-P", "-c", _WRITER, str(self._ring.path), str(self._aside), str(self._path)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                start_new_session=True,
                creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),  # as a session, on Windows
                env={**os.environ, "PYTHONPATH": path},
            )

    def _send(self, method: str, *arguments: Any) -> None:
        """Send a message to the writer before the next row."""
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):  # it is gone: `check` and `close` say so
            self._process.stdin.write(json.dumps([self._ring.count, method, *arguments]) + "\n")
            self._process.stdin.flush()
            self._sent += 1
            self._ring.tell(self._sent)


class _File:
    """File that keeps its first error.

    foxglove-sdk reports no errors while it logs.

    Args:
        file: File to write to.
    """

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self.error: OSError | None = None

    def write(self, data: bytes | bytearray) -> int:
        """Write all data."""
        return int(self._kept(self._file.write, data))

    def seek(self, offset: int, whence: int = 0) -> int:
        """Set the file position."""
        return int(self._kept(self._file.seek, offset, whence))

    def flush(self) -> None:
        """Flush the data to the system."""
        self._kept(self._file.flush)

    def _kept(self, do: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return do(*arguments)
        except OSError as error:
            self.error = self.error or error
            raise

    @contextmanager
    def checked(self) -> Iterator[None]:
        """Raise the first error, in place of foxglove-sdk's if any."""
        try:
            yield
        except RuntimeError:
            if self.error is None:
                raise
        if self.error is not None:
            raise self.error from None


class McapWriter:
    """Writer of an MCAP file during a run.

    Args:
        file: A file to write to; it is left open.

    Raises:
        OSError: If it cannot be written; this holds for all methods.
    """

    def __init__(self, file: IO[bytes]) -> None:
        from foxglove import Context, open_mcap  # only where MCAP is written
        from foxglove.mcap import MCAPWriteOptions

        from maglev_mj.recording.messages import Messages

        self._file, self._context = _File(file), Context()  # without which its channels close
        options = MCAPWriteOptions(profile="", chunk_size=_CHUNK, compression_threads=0, disable_seeking=True)
        about = {"format": FORMAT, "units": units(), **versions()}
        texts = {name: one if isinstance(one, str) else json.dumps(one) for name, one in about.items()}
        with self._file.checked():
            self._writer = open_mcap(self._file, context=self._context, writer_options=options)
            self._writer.write_metadata(METADATA, texts)
        self._messages, self._flushed = Messages(self._context), time.monotonic()
        self.begin, self.rows = self._messages.begin, self._messages.rows
        self.event, self.stick = self._messages.event, self._messages.stick

    def attach(self, name: str, media_type: str, data: str) -> None:
        """Attach a file, given in base64."""
        now, whole = time.time_ns(), base64.b64decode(data)
        with self._file.checked():
            self._writer.attach(log_time=now, create_time=now, name=name, media_type=media_type, data=whole)

    def flush(self) -> None:
        """Flush the written data at intervals."""
        with self._file.checked():
            if time.monotonic() - self._flushed > _LOST:
                self._writer.flush()
                self._flushed = time.monotonic()

    def close(self) -> None:
        """Write the remaining data and the index."""
        with self._file.checked():
            self._writer.close()


class _Orders:
    """Messages of a pipe, one per line, read by a thread.

    Not all systems can look into a pipe without waiting.
    """

    def __init__(self, pipe: IO[bytes]) -> None:
        self._lines, self._heard, self.over = SimpleQueue[bytes](), 0, False
        self.waiting: deque[Sequence[Any]] = deque()
        threading.Thread(target=self._read, args=(pipe,), daemon=True).start()

    def _read(self, pipe: IO[bytes]) -> None:
        while line := pipe.readline():
            self._lines.put(line)
        self._lines.put(b"")

    def listen(self, told: int) -> None:
        """Wait for the messages told of; take those that have come beside."""
        while not self.over and (self._heard < told or not self._lines.empty()):
            line = self._lines.get()
            self.over = not line.endswith(b"\n")  # of a process that was killed the last may be a part
            if not self.over:
                self.waiting.append(json.loads(line))
                self._heard += 1


def log_in_order(log: Any, rows: Iterable[tuple[int, Row]], messages: deque[Sequence[Any]], place: int) -> int:
    """Log rows in blocks, each message before the row that it belongs to.

    Args:
        log: Object with `rows` and the methods that messages name.
        rows: Rows with their numbers.
        messages: Number of the following row, method and arguments of each; those logged are taken out.
        place: Number of the next row.

    Returns:
        The number of the next row.
    """
    waiting = deque(rows)
    while True:
        place = waiting[0][0] if waiting else place
        while messages and messages[0][0] <= place:
            _, method, *arguments = messages.popleft()
            getattr(log, method)(*arguments)
        if not waiting:
            return place
        end = messages[0][0] if messages else math.inf
        block = []
        while waiting and waiting[0][0] < end:
            place, row = waiting.popleft()
            block.append(row)
        log.rows(block)
        place += 1


def _write(ring: RowReader, orders: _Orders, mcap: McapWriter, first: Callable[[], object]) -> None:
    """Write until the pipe ends.

    `first` is called at the first row.
    """
    place = 0
    while True:
        over = orders.over
        rows = list(islice(ring.rows(), _TOGETHER))
        orders.listen(ring.told)  # after the rows
        if rows and place == 0:
            first()
        place = log_in_order(mcap, rows, orders.waiting, place)
        mcap.flush()
        if over and not rows:
            return
        if not rows:
            time.sleep(_NAP)


def main() -> None:
    """Write a recording given by the command line.

    Arguments: file of the ring, temporary file, and the final name.
    """
    import foxglove

    foxglove.set_log_level("CRITICAL")  # errors are reported once, when the recording is closed
    ring, aside, path = RowReader(Path(sys.argv[1])), Path(sys.argv[2]), Path(sys.argv[3])
    error, rows = "", False

    def first() -> None:
        nonlocal rows
        if _RENAMES_OPEN:
            aside.replace(path)
        rows = True

    try:
        with aside.open("wb") as file:
            mcap = McapWriter(file)
            _write(ring, _Orders(sys.stdin.buffer), mcap, first)
            if ring.lost:
                mcap.event("lost", f"{ring.lost} samples came too fast to be written")
            mcap.close()
        if rows and not _RENAMES_OPEN:
            aside.replace(path)
    except OSError as problem:
        error = problem.strerror or str(problem)
    if not rows:
        aside.unlink(missing_ok=True)
    elif aside.exists():
        error += f"; it is in {aside}"
    ring.close()
    with suppress(BrokenPipeError):  # the recording process has ended, and the file is complete
        os.write(sys.stdout.fileno(), json.dumps({"error": error, "lost": ring.lost}).encode())


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
    """Return ".mcap" if the packages for it are installed, else ".npz"."""
    return ".mcap" if find_spec("mcap") and find_spec("foxglove") else ".npz"


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
