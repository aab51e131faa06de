"""The process that writes a recording: it takes rows out of a ring, and what begins and happens from a pipe.

It ends when the pipe does: because the recording is closed, or because whoever makes it is gone.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from maglev_mj.recording.mcap_file import Scribe
from maglev_mj.recording.ring import RowReader

__all__ = ["main"]

_NAP = 0.05


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


def _write(ring: RowReader, orders: _Orders, scribe: Scribe) -> None:
    """Write until the pipe ends."""

    def obey(place: int) -> None:
        while orders.waiting and orders.waiting[0]["at"] <= place:
            order = orders.waiting.popleft()
            if "begin" in order:
                scribe.begin(order["begin"])
            else:
                scribe.event(*order["event"])

    place = 0
    while True:
        over = orders.over
        rows = list(ring.rows())  # before what is said, for what is said of a row comes before it
        orders.listen()
        for place, row in rows:
            obey(place)
            scribe.row(row)
            place += 1
        obey(place)
        scribe.flush()
        if over and not rows:
            return
        if not rows:
            time.sleep(_NAP)


def main() -> None:
    """Write a recording: the ring and the file are named on the command line."""
    ring, path = RowReader(Path(sys.argv[1])), Path(sys.argv[2])
    error = ""
    try:
        with path.open("wb") as file:
            scribe = Scribe(file)
            _write(ring, _Orders(sys.stdin.fileno()), scribe)
            if ring.lost:
                scribe.event("lost", f"{ring.lost} samples came too fast to be written", ring.lost)
            scribe.close()
    except OSError as problem:
        error = problem.strerror or str(problem)
    with suppress(BrokenPipeError):  # nobody is there any more, and the file is whole
        os.write(sys.stdout.fileno(), json.dumps({"error": error, "lost": ring.lost}).encode())


if __name__ == "__main__":
    main()
