"""Faults by name, and the last cycles before one, on disk and back."""

from __future__ import annotations

import json
import tempfile
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from maglev_mj.bridge.wire import Fault, Frame, StateReport, fault_names
from maglev_mj.errors import ParameterError, PlantError
from maglev_mj.frames import AXES, Array
from maglev_mj.versions import versions

__all__ = ["BlackBox", "BlackBoxError", "DeviceFault", "FaultRecord", "HandshakeError", "load_black_box"]

_KEPT = 200
_FORMAT, _FORMAT_1 = "maglev_mj fault 2", "maglev_mj fault 1"
_SIX = range(6)
_COLUMNS_1 = (
    *("sample", "time_ns", "state", "faults"),
    *(f"spot{place}" for place in _SIX),
    *AXES,
    *(f"{kind}{place}" for kind in ("held", "pulsed") for place in _SIX),
    "width",
)
_COLUMNS = (
    *_COLUMNS_1,
    *(f"{kind}{place}" for kind in ("measured", "temperature") for place in _SIX),
    *("delay", "latency"),
)


Cycle: TypeAlias = tuple[Frame, Sequence[float], Sequence[float], Sequence[float] | None, float, float, int]
"""STATE frame, pose, held and pulsed currents [A], width [s], delay at the device [s], latency of the answer [ns]."""


class HandshakeError(PlantError):
    """No device answered, or the one that did will not have this host."""


class BlackBoxError(ParameterError):
    """A file is no black box."""


class DeviceFault(PlantError):
    """The device is in the fault state, and its currents are zero.

    Attributes:
        faults: Why.
        path: File with the last 200 cycles; None where it could not be written.
    """

    def __init__(self, faults: Fault, message: str, path: Path | None) -> None:
        where = f"; the last cycles are in {path}" if path is not None else ""
        super().__init__(f"{fault_names(faults)}: {message}{where}")
        self.faults, self.path = faults, path


class BlackBox:
    """Keeps the last 200 cycles, and writes them when something has gone wrong.

    Args:
        folder: Where files go.
    """

    def __init__(self, folder: Path) -> None:
        self._folder, self._versions = folder, versions()
        self._rows: deque[Cycle] = deque(maxlen=_KEPT)
        self.keep = self._rows.append

    def write(self, faults: Fault, message: str, about: Mapping[str, Any]) -> Path | None:
        """Write what is kept; to the temporary folder where the own one does not take it.

        Args:
            faults: What went wrong.
            message: The same for a person.
            about: Further values, ready for JSON.

        Returns:
            The file; None if there is no place for it at all. Nothing is raised: the fault itself is what to report.
        """
        with suppress(Exception):
            told = {"format": _FORMAT, "faults": fault_names(faults), "message": message, "versions": self._versions}
            text = json.dumps({**told, **about, "columns": _COLUMNS, "cycles": [_flat(row) for row in self._rows]})
            for folder in (self._folder, Path(tempfile.gettempdir())):
                with suppress(OSError):
                    folder.mkdir(parents=True, exist_ok=True)
                    return _write(folder, text)
        return None


def _write(folder: Path, text: str, now: Callable[[], float] = time.time) -> Path:
    stem = datetime.fromtimestamp(now()).strftime("maglev-fault-%Y%m%d-%H%M%S")
    count = 0
    while True:
        path = folder / (f"{stem}-{count}.json" if count else f"{stem}.json")
        try:
            with path.open("x", encoding="utf-8") as file:
                file.write(text + "\n")
            return path
        except FileExistsError:
            count += 1
        except OSError:
            path.unlink(missing_ok=True)  # cut short, as on a full disk
            raise


def _flat(cycle: Cycle) -> list[float | None]:
    """Return a cycle as plain numbers, None for what is none: JSON knows no NaN."""
    frame, pose, held, pulsed, width, delay, latency = cycle
    report: StateReport = frame.body  # type: ignore[assignment]
    values = (
        *(frame.sequence, frame.time, report.state, report.faults, *report.spots, *pose, *held, *(pulsed or held)),
        *(width, *report.currents, *report.temperatures, delay, latency * 1e-9),
    )
    return [value if value - value == 0 else None for value in values]


@dataclass(frozen=True, kw_only=True, eq=False)
class FaultRecord:
    """A black box, read back.

    Attributes:
        faults: Names of the faults.
        first: Names of those that came first; the same as `faults` in a file of format 1.
        message: One line for a person.
        fault_time: When the first came, by the device's clock [s]; NaN where unknown.
        tick: Of the last sample.
        lost: Samples that did not arrive.
        skipped: Samples left unanswered for a newer one.
        period: Sample period [s].
        columns: Values by name, (N,) each, NaN where there is none: sample, time [s], state, faults, spot0 to spot5
            [m], x, y, z [m], rx, ry, rz [rad], held0.. and pulsed0.. [A], width [s], measured0.. [A], temperature0..
            as a share of what a coil bears, delay (at the device) and latency (of the answer) [s].
    """

    faults: str
    first: str
    message: str
    fault_time: float
    tick: int
    lost: int
    skipped: int
    period: float
    columns: Mapping[str, Array]

    @property
    def time(self) -> Array:
        """Time of each cycle, from the last [s], (N,)."""
        time = self.columns["time"]
        return time - time[-1] if len(time) else time

    def six(self, kind: str) -> Array:
        """Return six columns of a kind, such as "measured" or "pose", (N, 6)."""
        names = AXES if kind == "pose" else [f"{kind}{place}" for place in _SIX]
        return np.stack([self.columns[name] for name in names], axis=-1)


def load_black_box(path: str | Path) -> FaultRecord:
    """Read a black box of this or the former format.

    Raises:
        BlackBoxError: If it cannot be read or is none; one line with the file and what is wrong.
    """
    try:
        told = json.loads(Path(path).read_text(encoding="utf-8"))
        return _record(told)
    except OSError as error:
        raise BlackBoxError(f"black box {str(path)!r} cannot be read: {error.strerror}") from None
    except BlackBoxError as error:
        raise BlackBoxError(f"black box {str(path)!r}: {error}") from None
    except (ValueError, RecursionError) as error:
        raise BlackBoxError(f"black box {str(path)!r} is not JSON: {error}") from None


def _record(told: Any) -> FaultRecord:
    kind = told.get("format") if isinstance(told, dict) else type(told).__name__
    if kind not in (_FORMAT, _FORMAT_1):
        raise BlackBoxError(f"format must be {_FORMAT!r} or {_FORMAT_1!r}, not {kind!r:.60}")
    names = _COLUMNS if kind == _FORMAT else _COLUMNS_1
    if told.get("columns") != list(names):
        raise BlackBoxError(f"columns must be those of {kind!r}")
    cycles = told.get("cycles")
    if not isinstance(cycles, list) or any(not isinstance(row, list) or len(row) != len(names) for row in cycles):
        raise BlackBoxError(f"cycles must be rows of {len(names)} values")
    try:
        table = np.array(cycles, dtype=np.float64).reshape(len(cycles), len(names))
        values = {
            name: int(told[name]) * scale
            for name, scale in (("tick", 1), ("lost", 1), ("skipped", 1), ("period_ns", 1e-9), ("fault_time_ns", 1e-9))
            if name in told or name != "fault_time_ns"
        }
    except (TypeError, ValueError, OverflowError, KeyError) as error:
        raise BlackBoxError(f"a value is missing or no number: {error}") from None
    if not values["period_ns"] > 0.0:
        raise BlackBoxError(f"period_ns must be above 0, not {told['period_ns']!r:.60}")
    columns = {name: np.full(len(cycles), np.nan) for name in _COLUMNS}
    columns |= {name: table[:, place] for place, name in enumerate(names)}
    columns["time"] = columns.pop("time_ns") * 1e-9
    return FaultRecord(
        faults=str(told.get("faults")),
        first=str(told.get("first", told.get("faults"))),
        message=str(told.get("message")),
        fault_time=float(values.get("fault_time_ns", np.nan)),
        tick=int(values["tick"]),
        lost=int(values["lost"]),
        skipped=int(values["skipped"]),
        period=float(values["period_ns"]),
        columns=columns,
    )
