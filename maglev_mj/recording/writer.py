"""The process that writes a recording: it takes rows out of a ring, and what begins and happens from a pipe.

It ends when the pipe does: because the recording is closed, or because whoever makes it is gone.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from maglev_mj.recording.live import RowReader
from maglev_mj.recording.mcap import McapWriter

__all__ = ["main"]

_NAP = 0.02


class _Orders:
    """What is said through a pipe, a line each, as far as it has come."""

    def __init__(self, descriptor: int) -> None:
        os.set_blocking(descriptor, False)
        self._descriptor, self._rest, self.over = descriptor, b"", False
        self.waiting: deque[Mapping[str, Any]] = deque()

    def listen(self) -> None:
        """Take what has come."""
        while not self.over:
            try:
                data = os.read(self._descriptor, 1 << 16)
            except BlockingIOError:
                return
            self.over = not data
            *lines, self._rest = (self._rest + data).split(b"\n")
            self.waiting.extend(json.loads(line) for line in lines)


def _write(ring: RowReader, orders: _Orders, mcap: McapWriter, first: Callable[[], object]) -> None:
    """Write until the pipe ends; call `first` at the first row."""

    def obey(place: int) -> None:
        while orders.waiting and orders.waiting[0]["at"] <= place:
            order = orders.waiting.popleft()
            if "begin" in order:
                mcap.begin(*order["begin"])
            else:
                mcap.event(*order["event"])

    place = 0
    while True:
        over = orders.over
        rows = list(ring.rows())  # before what is said, for what is said of a row comes before it
        orders.listen()
        if rows and place == 0:
            first()
        for place, row in rows:
            obey(place)
            mcap.row(row)
            place += 1
        obey(place)
        mcap.flush()
        if over and not rows:
            return
        if not rows:
            time.sleep(_NAP)


def main() -> None:
    """Write a recording; the command line names the ring, a file to begin with, and the name that it gets then."""
    ring, aside, path = RowReader(int(sys.argv[1])), Path(sys.argv[2]), Path(sys.argv[3])
    error = ""
    try:
        with aside.open("wb") as file:
            mcap = McapWriter(file)
            _write(ring, _Orders(sys.stdin.fileno()), mcap, lambda: aside.replace(path))
            if ring.lost:
                mcap.event("lost", f"{ring.lost} samples came too fast to be written")
            mcap.close()
        aside.unlink(missing_ok=True)  # there was no row
    except OSError as problem:
        error = problem.strerror or str(problem)
    with suppress(BrokenPipeError):  # nobody is there any more, and the file is whole
        os.write(sys.stdout.fileno(), json.dumps({"error": error, "lost": ring.lost}).encode())


if __name__ == "__main__":
    main()
    os._exit(0)  # a window waits for this, and the interpreter takes its time to end
