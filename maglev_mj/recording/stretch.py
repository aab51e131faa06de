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

from maglev_mj.errors import MaglevError
from maglev_mj.frames import AXES, Array

__all__ = ["Recording", "RecordingError", "Setup", "Stretch", "aside", "table"]

_FORMAT = "maglev_mj recording 1"
_COLUMNS = {"tick": 0, "time": 0, "position": 6, "command": 13, "applied": 13, "hand": 6}
"""Columns of each array of a stretch; 0 for one number a sample."""

Setup: TypeAlias = Mapping[str, Any]
"""What a plant and a controller are made from, ready for JSON."""


class RecordingError(MaglevError):
    """A file is no recording, or is not whole."""


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
    """

    setup: Setup
    tick: Array
    time: Array
    position: Array
    command: Array
    applied: Array
    hand: Array

    def part(self, first: int, last: int) -> Stretch:
        """Return the samples from one row to another, both included."""
        return replace(self, **{name: getattr(self, name)[first : last + 1] for name in _COLUMNS})


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
            for name in _COLUMNS
        }
        setups = [dict(stretch.setup) for stretch in self.stretches]
        header = {"format": _FORMAT, "axes": AXES, "setups": setups, "events": list(self.events)}
        with aside(Path(path)) as partial, partial.open("wb") as file:
            np.savez(file, header=np.array(json.dumps(header)), **arrays)

    @classmethod
    def load(cls, path: Path) -> Recording:
        """Read from a file of either kind; one of MCAP that was not closed, as far as it goes.

        Raises:
            McapMissingError: If it is of MCAP, and the package for it is not installed.
            RecordingError: If it is not there, or no recording.
        """
        from maglev_mj.recording.mcap_file import MAGIC, read_mcap  # which needs what is defined here

        try:
            with path.open("rb") as file:
                if file.read(len(MAGIC)) == MAGIC:
                    file.seek(0)
                    return read_mcap(file, str(path))
        except OSError as error:
            raise RecordingError(f"recording {str(path)!r} cannot be read: {error.strerror or error}") from None
        return cls._load_arrays(path)

    @classmethod
    def _load_arrays(cls, path: Path) -> Recording:
        try:
            with path.open("rb") as whole, np.load(whole, allow_pickle=False) as file:
                header = json.loads(str(file["header"]))
                if header["format"] != _FORMAT:
                    raise RecordingError(f"recording must be of {_FORMAT!r}, not {header['format']!r}")
                stretches = [
                    Stretch(setup=setup, **{name: _checked(file[f"{index}/{name}"], name) for name in _COLUMNS})
                    for index, setup in enumerate(header["setups"])
                ]
        except OSError as error:
            raise RecordingError(f"recording {str(path)!r} cannot be read: {error.strerror or error}") from None
        except RecordingError:
            raise
        except Exception:  # of zip files, of what decompresses, of headers: a damaged one fails in many ways
            raise RecordingError(f"{str(path)!r} is not a whole recording") from None
        if any(len({len(getattr(stretch, name)) for name in _COLUMNS}) > 1 for stretch in stretches):
            raise RecordingError(f"{str(path)!r} is not a whole recording")
        return cls(stretches, events=header.get("events", ()))

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


def _checked(array: Any, name: str) -> Array:
    columns = _COLUMNS[name]
    if array.dtype != np.float64 or array.ndim != (2 if columns else 1) or (columns and array.shape[1] != columns):
        raise ValueError(name)
    if name != "command" and not np.isfinite(array).all():  # which a plant may have refused
        raise ValueError(name)
    return np.asarray(array)
