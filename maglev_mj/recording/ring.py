"""Rows in memory that two processes share: one puts them in, within its tick, and the other takes them out.

A row is 29 doubles: its number from 1, whether it has pulses, what every row has, and its number again. A reader takes
a row whose number stands at both ends; the first is written first and the second last. Pulses are further behind.
"""

from __future__ import annotations

import mmap
import os
import struct
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeAlias

from maglev_mj.frames import ZERO, Command, Sample
from maglev_mj.loop import Record
from maglev_mj.recording.recorder import Felt

__all__ = ["ROWS", "Ring", "Row", "RowReader"]

ROWS = 1 << 14
"""Rows in a ring: 8 s at 2 kHz, which is how long its reader may be away."""

_ALWAYS = struct.Struct("=29d")
_PULSES = struct.Struct("=15d")
_THERE = {"flags": mmap.MAP_SHARED | mmap.MAP_POPULATE} if hasattr(mmap, "MAP_POPULATE") else {}  # not in the tick
_HEAD = 64  # bytes in front of the rows, the first eight of them the reader's place
_PLACE = struct.Struct("=q")
_LOOKED_AFTER = 512
_MASK = ROWS - 1
_BEHIND = _HEAD + ROWS * _ALWAYS.size
_NAP = 1e-3

Row: TypeAlias = tuple[float, ...]
"""Tick, time, position, command and applied as 13 numbers each, hand: 40 numbers."""


class Ring:
    """The end that puts rows in.

    Args:
        wait: Called again and again while the reader is a whole ring behind; None for not to wait, and to lose rows.

    Attributes:
        descriptor: Of the memory, for the reader; it has no name that could outlive both.
        count: Rows put in so far.

    Raises:
        OSError: If there is no room for it.
    """

    def __init__(self, *, wait: Callable[[], object] | None = None) -> None:
        shared, size = Path("/dev/shm"), _HEAD + ROWS * (_ALWAYS.size + _PULSES.size)
        self.count, self._wait = 0, wait
        self._file = tempfile.TemporaryFile(dir=shared if shared.is_dir() else None)
        try:
            if hasattr(os, "posix_fallocate"):  # a page that is not to be had would end the process at its first use
                os.posix_fallocate(self._file.fileno(), 0, size)
            self._file.truncate(size)
            self._memory = mmap.mmap(self._file.fileno(), size, **_THERE)
        except BaseException:
            self._file.close()
            raise
        self.descriptor = self._file.fileno()

    def record(self, plant: Felt) -> Record:
        """Return what puts in a row a cycle.

        A function of this one's variables, not a method: it is in the tick, and that is cheaper.

        Args:
            plant: Tells what the hand exerts.
        """
        memory, wait = self._memory, self._wait
        always, pulses, size = _ALWAYS.pack_into, _PULSES.pack_into, _ALWAYS.size

        def put(sample: Sample, command: Command, applied: Command) -> None:
            count = self.count
            number, place = count + 1, count & _MASK
            extra, after, pulsed = command.extra, applied.extra, 0.0
            if extra is not None or after is not None:
                pulsed = 1.0
                widths = command.pulse_width if extra else 0.0, applied.pulse_width if after else 0.0
                pulses(memory, _BEHIND + place * _PULSES.size, *(extra or ZERO), *(after or ZERO), *widths, number)
            always(
                memory,
                _HEAD + place * size,
                number,
                pulsed,
                sample.tick,
                sample.time,
                *sample.position,
                *command.force,
                *applied.force,
                *plant.hand_wrench,
                number,
            )
            self.count = number
            if wait is not None and not number % _LOOKED_AFTER:
                self._let_catch_up(wait)

        return put

    def close(self) -> None:
        """Let go of the memory; a second time does nothing."""
        self._memory.close()
        self._file.close()

    def _let_catch_up(self, wait: Callable[[], object]) -> None:
        while self.count - _PLACE.unpack_from(self._memory, 0)[0] > ROWS - 2 * _LOOKED_AFTER:
            wait()
            time.sleep(_NAP)


class RowReader:
    """The end that takes rows out.

    Args:
        descriptor: Of the memory; left open.

    Attributes:
        lost: Rows that were overwritten before they were read.
    """

    def __init__(self, descriptor: int) -> None:
        self._memory = mmap.mmap(descriptor, 0)
        self._place, self.lost = 0, 0

    def rows(self) -> Iterator[tuple[int, Row]]:
        """Yield the rows that are there, each with its place in the run, from 0."""
        while True:
            place = self._place & _MASK
            start, end = _HEAD + place * _ALWAYS.size, _HEAD + (place + 1) * _ALWAYS.size
            data = self._memory[start:end]
            values = _ALWAYS.unpack(data)
            first = int(values[0])
            if first < self._place + 1 or values[-1] != first:
                break
            if first > self._place + 1:  # the row was overwritten; the next may still be there
                self._place += 1
                self.lost += 1
                continue
            pulses = [0.0] * 14
            if values[1]:
                *pulses, number = _PULSES.unpack_from(self._memory, _BEHIND + place * _PULSES.size)
                if number != first:
                    continue  # it is being overwritten
            if self._memory[start:end] != data:
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
