"""Rows in memory that two processes share: one puts them in, within its tick, and the other takes them out.

A row is N doubles: its number, whether it has pulses, what every row has, its number again, and what only a row with
pulses has. A reader takes a row whose number stands at both ends; the first is written first and the second last.
"""

from __future__ import annotations

import mmap
import os
import struct
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from maglev_mj.frames import ZERO, Command, Sample

__all__ = ["ROWS", "Ring", "Row", "RowReader"]

ROWS = 1 << 15
"""Rows in a ring: 16 s at 2 kHz, which is how long its reader may be away."""

_ALWAYS = struct.Struct("=29d")
_PULSES = struct.Struct("=14d")
_SIZE = _ALWAYS.size + _PULSES.size
_HEAD = 64  # bytes in front of the rows, the first eight of them the reader's place
_PLACE = struct.Struct("=q")
_LOOKED_AFTER = 512
_NAP = 1e-3

Row = tuple[float, ...]
"""Tick, time, position, command and applied as 13 numbers each, hand: 40 numbers."""


class Ring:
    """The end that puts rows in.

    Args:
        wait: Called again and again while the reader is a whole ring behind; None for not to wait, and to lose rows.

    Attributes:
        path: Of the memory, for the reader, who removes it.
        count: Rows put in so far.
    """

    def __init__(self, *, wait: Callable[[], object] | None = None) -> None:
        shared = Path("/dev/shm")
        descriptor, name = tempfile.mkstemp(prefix="maglev-ring-", dir=shared if shared.is_dir() else None)
        self.path, self.count, self._wait = Path(name), 0, wait
        with os.fdopen(descriptor, "r+b") as file:
            file.truncate(_HEAD + ROWS * _SIZE)
            self._memory = mmap.mmap(file.fileno(), 0)
        _PLACE.pack_into(self._memory, 0, 0)
        # numbers start at 1, so that fresh memory is no row
        self._always, self._pulses = _ALWAYS.pack_into, _PULSES.pack_into

    def put(self, sample: Sample, command: Command, applied: Command, hand: Sequence[float]) -> None:
        """Put in one row."""
        memory, count = self._memory, self.count
        number = count + 1
        start = _HEAD + (count & (ROWS - 1)) * _SIZE
        extra, after = command.extra, applied.extra
        pulsed = 0.0
        if extra is not None or after is not None:
            pulsed = 1.0
            widths = command.pulse_width if extra else 0.0, applied.pulse_width if after else 0.0
            self._pulses(memory, start + _ALWAYS.size, *(extra or ZERO), *(after or ZERO), *widths)
        position, force, given = sample.position, command.force, applied.force
        self._always(memory, start, number, pulsed, sample.tick, sample.time, *position, *force, *given, *hand, number)
        self.count = number
        if self._wait is not None and not number % _LOOKED_AFTER:
            self._let_catch_up(self._wait)

    def close(self) -> None:
        """Let go of the memory; a second time does nothing."""
        self._memory.close()

    def _let_catch_up(self, wait: Callable[[], object]) -> None:
        while self.count - _PLACE.unpack_from(self._memory, 0)[0] > ROWS - 2 * _LOOKED_AFTER:
            wait()
            time.sleep(_NAP)


class RowReader:
    """The end that takes rows out.

    Args:
        path: Of the memory.

    Attributes:
        lost: Rows that were overwritten before they were read.
    """

    def __init__(self, path: Path) -> None:
        with path.open("r+b") as file:
            self._memory = mmap.mmap(file.fileno(), 0)
        path.unlink()
        self._place, self.lost = 0, 0

    def rows(self) -> Iterator[tuple[int, Row]]:
        """Yield the rows that are there, each with its place in the run, from 0."""
        while True:
            start = _HEAD + (self._place & (ROWS - 1)) * _SIZE
            values = _ALWAYS.unpack_from(self._memory, start)
            first = int(values[0])
            if first < self._place + 1 or values[-1] != first:
                break
            if first > self._place + 1:  # the row was overwritten; the next may still be there
                self._place += 1
                self.lost += 1
                continue
            pulses = _PULSES.unpack_from(self._memory, start + _ALWAYS.size) if values[1] else (0.0,) * 14
            if _ALWAYS.unpack_from(self._memory, start) != values:
                continue  # it was overwritten meanwhile
            self._place = first
            _PLACE.pack_into(self._memory, 0, first)
            tick, time_ = values[2:4]
            command = (*values[10:16], *pulses[:6], pulses[12])
            applied = (*values[16:22], *pulses[6:12], pulses[13])
            yield first - 1, (tick, time_, *values[4:10], *command, *applied, *values[22:28])

    def close(self) -> None:
        """Let go of the memory."""
        self._memory.close()
