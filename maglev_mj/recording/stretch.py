"""What a recording holds: stretches of samples under one controller, in a file of arrays."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.frames import AXES, Array

__all__ = [
    "COLUMNS",
    "FORMAT",
    "Basis",
    "InvalidRecordingError",
    "Recording",
    "RecordingError",
    "Setup",
    "Stretch",
    "aside",
    "table",
]

FORMAT = "maglev_mj recording 1"
"""First line of a file of arrays."""

COLUMNS = {"tick": 0, "time": 0, "position": 6, "command": 13, "applied": 13, "hand": 6}
"""Columns of each array of a stretch; 0 for one number a sample."""

Setup: TypeAlias = Mapping[str, Any]
"""What a plant and a controller are made from, ready for JSON."""


class RecordingError(MaglevError):
    """A recording cannot be written, or cannot be run again here."""


class InvalidRecordingError(RecordingError, ParameterError):
    """A file is no recording, or holds what none can."""


@dataclass(frozen=True, kw_only=True)
class Basis:
    """What a stretch is besides its samples.

    Attributes:
        period: Sample period [s].
        delay: From a sample to its command taking effect [s].
        carried: Wrench that carries the flotor [N, N m], six.
        inertia: Mass and moments of inertia that the actuators push at [kg, kg m²], six.
        load: Constant wrench that acts besides the actuators' [N, N m], six.
        before: Wrench of the actuators until the first command takes effect [N, N m], six.
    """

    period: float
    delay: float
    carried: Sequence[float]
    inertia: Sequence[float]
    load: Sequence[float]
    before: Sequence[float]


@dataclass(frozen=True, kw_only=True, eq=False)
class Stretch:
    """N samples under one controller.

    Attributes:
        setup: What plant and controller were made from.
        tick: Sample numbers, (N,).
        time: When they were taken since the start of the stretch [s], (N,).
        position: What the controller saw [m, rad], (N, 6).
        command: What it answered: held wrench and pulse [N, N m], pulse width [s], (N, 13); not finite where that is
            why the plant refused it.
        applied: The same after the plant's limits, (N, 13).
        hand: What the hand exerted from each sample on [N, N m], (N, 6).
        totals: Energy that the rendered world has taken in [J], work of the hand [J] and samples missed, each from the
            beginning on, (N, 3); None where they are not recorded.
        basis: What it is besides; None where that is not recorded.
        gaps: Samples that were missed without a gap in the ticks: before which row, and how many.
    """

    setup: Setup
    tick: Array
    time: Array
    position: Array
    command: Array
    applied: Array
    hand: Array
    totals: Array | None = None
    basis: Basis | None = None
    gaps: Sequence[tuple[int, int]] = ()

    def part(self, first: int, last: int) -> Stretch:
        """Return the samples from one row to another, both included, without what is only of the whole."""
        rows = {name: getattr(self, name)[first : last + 1] for name in COLUMNS}
        return replace(self, **rows, totals=None, basis=None, gaps=())


@dataclass(frozen=True, eq=False)
class Recording:
    """One run.

    Attributes:
        stretches: In the order in which they happened.
        events: What a person should know of, such as faults.
        damage: What is wrong with the file that it was read from, such as a missing end; empty for nothing.
    """

    stretches: Sequence[Stretch]
    events: Sequence[str] = ()
    damage: str = ""

    def save(self, path: Path | str) -> None:
        """Write to a file, whole or not at all.

        Raises:
            OSError: If it cannot be written.
        """
        arrays = {
            f"{index}/{name}": getattr(stretch, name)
            for index, stretch in enumerate(self.stretches)
            for name in COLUMNS
        }
        setups = [dict(stretch.setup) for stretch in self.stretches]
        header = {"format": FORMAT, "axes": AXES, "setups": setups, "events": list(self.events)}
        with aside(Path(path)) as partial, partial.open("wb") as file:
            np.savez(file, header=np.array(json.dumps(header)), **arrays)

    @classmethod
    def load(cls, path: Path) -> Recording:
        """Read from a file of either kind; one of MCAP that was not closed, as far as it goes.

        What a file unpacks to is bounded, by 64 MiB for each of its parts among other things.

        Raises:
            McapMissingError: If it is of MCAP, and the package for it is not installed.
            InvalidRecordingError: If it is not there, no recording, or holds what none can, such as a number that is
                not finite, of another type or out of range.
        """
        from maglev_mj.recording.mcap_reader import MAGIC, read_mcap  # both need what is defined here
        from maglev_mj.recording.npz_reader import read_npz

        try:
            with path.open("rb") as file:
                size, first = os.fstat(file.fileno()).st_size, file.read(len(MAGIC))
                file.seek(0)
                return (read_mcap if first == MAGIC else read_npz)(file, size)
        except OSError as error:
            raise InvalidRecordingError(f"recording {str(path)!r} cannot be read: {error.strerror or error}") from None
        except ParameterError as error:
            raise InvalidRecordingError(f"{str(path)!r} is not a whole recording: {error}") from None

    @property
    def ticks(self) -> int:
        """Samples in all."""
        return sum(len(stretch.tick) for stretch in self.stretches)


@contextmanager
def aside(path: Path) -> Iterator[Path]:
    """Return a name to write to; once that is done it takes the place of `path`, and if it fails nothing is left."""
    partial = path.with_name(f"{path.name}.{os.getpid()}.partial")
    try:
        yield partial
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def table(rows: Sequence[Any], columns: int) -> Array:
    """Return rows as an array, (N, columns)."""
    return np.array(rows, dtype=np.float64).reshape(-1, columns)
