"""Ring buffer of a recording's rows, shared by two processes.

It is a file that both map, as every system can. Each row stands between two copies of its number, from 1. A reader
takes a row only if both are right: the first copy is written first and the second last.
"""

from __future__ import annotations

import mmap
import os
import struct
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from maglev_mj.control.loop import Record
from maglev_mj.recording.sample import ROW, RecordedPlant, Row, compiled

ROWS = 1 << 15
"""Rows in the shared memory.

1.6 s at 20 kHz: the longest time for the writer's start or pause.
"""

_SLOT = struct.Struct(f"{ROW.itemsize // 8 + 2}d")  # native, which packs faster
_HEAD, _NUMBER = 64, struct.Struct("=q")  # bytes in front of the rows, which begin with two numbers:
_READ, _TOLD = 0, 8  # rows read so far, and messages told of

_MEMORY = Path("/dev/shm")  # of Linux; elsewhere the temporary folder, whose files that are mapped lie in memory too
_THERE = {"flags": mmap.MAP_SHARED | mmap.MAP_POPULATE} if hasattr(mmap, "MAP_POPULATE") else {}  # not in the tick
_LOOKED_AFTER = 512
_MASK = ROWS - 1
_NAP = 1e-3

_PUT = f"""count = ring.count
number = count + 1
pack(memory, {_HEAD} + (count & {_MASK}) * {_SLOT.size}, number, {{values}}, number)
ring.count = number"""


class Ring:
    """Writing end of the ring buffer.

    Args:
        wait: Called repeatedly while the ring is full; None for no waiting, so that rows are lost.

    Attributes:
        path: File of the memory, for one reader; it is removed as soon as that has it, or by the last to close it.
        count: Rows put in so far.

    Raises:
        OSError: If the memory cannot be allocated.
    """

    def __init__(self, *, wait: Callable[[], object] | None = None) -> None:
        size = _HEAD + ROWS * _SLOT.size
        self.count, self._wait = 0, wait
        descriptor, name = tempfile.mkstemp(prefix="maglev-mj-", dir=_MEMORY if _MEMORY.is_dir() else None)
        self.path = Path(name)
        try:
            with open(descriptor, "r+b") as file:  # the mapping has one of its own
                if hasattr(os, "posix_fallocate"):  # a page that is not there would end the process at its first use
                    os.posix_fallocate(descriptor, 0, size)
                file.truncate(size)
                self._memory = mmap.mmap(descriptor, size, **_THERE)
        except BaseException:
            _remove(self.path)
            raise

    def tell(self, messages: int) -> None:
        """Tell the reader how many messages it must have before the next row."""
        _NUMBER.pack_into(self._memory, _TOLD, messages)

    def record(self, plant: RecordedPlant, *, first: Callable[[], object] | None = None) -> Record:
        """Return the function that writes one row per cycle.

        A compiled function, because it is called in every tick and a method is slower.

        Args:
            plant: Plant with the hand's wrench.
            first: Function called before each row; None for none.
        """
        names: dict[str, Any] = {"pack": _SLOT.pack_into, "memory": self._memory, "ring": self, "plant": plant}
        before = "" if first is None else "first()\n"
        after = "" if self._wait is None else f"\nif not number % {_LOOKED_AFTER}: catch_up()"
        names |= {"first": first, "catch_up": self._let_catch_up}
        return compiled("sample, command, applied", before + _PUT + after, **names)

    def close(self) -> None:
        """Release the memory; idempotent."""
        self._memory.close()
        _remove(self.path)

    def _let_catch_up(self) -> None:
        assert self._wait is not None
        while self.count - _NUMBER.unpack_from(self._memory, _READ)[0] > ROWS - 2 * _LOOKED_AFTER:
            self._wait()
            time.sleep(_NAP)


class RowReader:
    """Reading end of the ring buffer.

    Args:
        path: File of the memory; removed.

    Attributes:
        lost: Number of rows overwritten before they were read.
    """

    def __init__(self, path: Path) -> None:
        with path.open("r+b") as file:
            self._memory = mmap.mmap(file.fileno(), 0)
        self._path, self._place, self.lost = path, 0, 0
        _remove(path)

    @property
    def told(self) -> int:
        """Number of messages sent before the rows that have been read."""
        return int(_NUMBER.unpack_from(self._memory, _TOLD)[0])

    def rows(self) -> Iterator[tuple[int, Row]]:
        """Yield available rows with their index from 0."""
        while True:
            start = _HEAD + (self._place & (ROWS - 1)) * _SLOT.size
            data = self._memory[start : start + _SLOT.size]
            first, *row, last = _SLOT.unpack(data)
            number = int(first)
            if number < self._place + 1 or last != first:
                break
            if number > self._place + 1:  # the row was overwritten; the next may still be there
                self._place += 1
                self.lost += 1
                continue
            if self._memory[start : start + _SLOT.size] != data:
                continue  # it was overwritten meanwhile
            self._place = number
            _NUMBER.pack_into(self._memory, _READ, number)
            yield number - 1, row

    def close(self) -> None:
        """Release the memory."""
        self._memory.close()
        _remove(self._path)


def _remove(path: Path) -> None:
    with suppress(PermissionError):  # Windows removes no file that the other end has mapped
        path.unlink(missing_ok=True)
