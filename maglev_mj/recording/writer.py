"""Writer process: rows from a ring, events from a pipe.

It ends with the pipe: the recording was closed, or the recording process has ended.
"""

from __future__ import annotations

import base64
import json
import math
import os
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from itertools import islice
from pathlib import Path
from typing import IO, Any

from foxglove import Context, open_mcap, set_log_level
from foxglove.mcap import MCAPWriteOptions

from maglev_mj.recording.live import RowReader
from maglev_mj.recording.mcap import FORMAT, METADATA
from maglev_mj.recording.messages import Messages
from maglev_mj.recording.row import units
from maglev_mj.versions import versions

_NAP = 0.02
_TOGETHER = 1 << 10  # samples that are added up at once
_LOST = 0.1  # s that a SIGKILL to this process may cost
_CHUNK = 1 << 16  # before it is packed: some 150 samples, lost by damage to one of its bytes


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
    """Messages of a pipe, one per line."""

    def __init__(self, descriptor: int) -> None:
        os.set_blocking(descriptor, False)
        self._descriptor, self._rest, self.over = descriptor, b"", False
        self.waiting: deque[Mapping[str, Any]] = deque()

    def listen(self) -> None:
        """Read the messages that have arrived."""
        while not self.over:
            try:
                data = os.read(self._descriptor, 1 << 16)
            except BlockingIOError:
                return
            self.over = not data
            *lines, self._rest = (self._rest + data).split(b"\n")
            self.waiting.extend(json.loads(line) for line in lines)


def _write(ring: RowReader, orders: _Orders, mcap: McapWriter, first: Callable[[], object]) -> None:
    """Write until the pipe ends.

    `first` is called at the first row.
    """

    def obey(place: int) -> None:
        while orders.waiting and orders.waiting[0]["at"] <= place:
            order = orders.waiting.popleft()
            for name in ("begin", "event", "stick", "attach"):
                if name in order:
                    getattr(mcap, name)(*order[name])

    place = 0
    while True:
        over = orders.over
        # rows first: a message about a row arrives before the row
        rows = list(islice(ring.rows(), _TOGETHER))
        orders.listen()
        if rows and place == 0:
            first()
        waiting = deque(rows)
        while waiting:
            obey(waiting[0][0])
            block = [waiting.popleft()]
            said = orders.waiting[0]["at"] if orders.waiting else math.inf
            while waiting and waiting[0][0] < said:
                block.append(waiting.popleft())
            mcap.rows([row for _, row in block])
            place = block[-1][0] + 1
        obey(place)
        mcap.flush()
        if over and not rows:
            return
        if not rows:
            time.sleep(_NAP)


def main() -> None:
    """Write a recording given by the command line.

    Arguments: descriptor of the ring, temporary file, and the final name.
    """
    set_log_level("CRITICAL")  # errors are reported once, when the recording is closed
    ring, aside, path = RowReader(int(sys.argv[1])), Path(sys.argv[2]), Path(sys.argv[3])
    error = ""
    try:
        with aside.open("wb") as file:
            mcap = McapWriter(file)
            _write(ring, _Orders(sys.stdin.fileno()), mcap, lambda: aside.replace(path))
            if ring.lost:
                mcap.event("lost", f"{ring.lost} samples came too fast to be written")
            mcap.close()
    except OSError as problem:
        error = problem.strerror or str(problem)
    aside.unlink(missing_ok=True)  # where there was no row
    with suppress(BrokenPipeError):  # the recording process has ended, and the file is complete
        os.write(sys.stdout.fileno(), json.dumps({"error": error, "lost": ring.lost}).encode())


if __name__ == "__main__":
    main()
    os._exit(0)  # a window waits for this, and the interpreter takes its time to end
