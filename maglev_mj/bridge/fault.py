"""Device faults and black box files of their last cycles."""

from __future__ import annotations

import json
import math
import tempfile
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from itertools import chain, count
from pathlib import Path
from typing import Any, ClassVar, TypeAlias

import numpy as np

from maglev_mj.bridge.wire import Fault, Frame, State, StateReport, fault_names
from maglev_mj.errors import ParameterError, PlantError
from maglev_mj.frames import AXES, Array, unit_of
from maglev_mj.parameters import flag, read_json
from maglev_mj.pictures import save
from maglev_mj.result import Result, Table, number_text
from maglev_mj.terminal import printable
from maglev_mj.versions import versions

_KEPT = 200
_SIX = range(6)
_SPOTS, _HELD, _PULSED, _MEASURED, _WARM = (
    [f"{kind}{place}" for place in _SIX] for kind in ("spot", "held", "pulsed", "measured", "temperature")
)
_COLUMNS = ["sample", "time_ns", "state", "faults", *_SPOTS, *AXES, *_HELD, *_PULSED, "width"]
_COLUMNS += [*_MEASURED, *_WARM, "delay", "latency"]
_UNITS = {"time": "s", "width": "s", "delay": "s", "latency": "s"} | {axis: unit_of("m", axis) for axis in AXES}
_UNITS |= dict.fromkeys(_SPOTS, "m") | dict.fromkeys([*_HELD, *_PULSED, *_MEASURED], "A")
_FORMAT = "maglev_mj fault 2"
_SHOWN = 20
"""Cycles that a table shows unless all are wanted."""
_HEAD = ("time [ms]", *(f"{axis} [{unit_of('mm', axis)}]" for axis in AXES), "cmd [A]", "meas [A]", "warm [%]")
_HEAD += ("delay [ms]", "answer [ms]")
_DECIMALS = 1, *[2] * 6, 2, 2, 0, 2, 2
_CURRENTS = "held", "pulsed", "measured"

_MEANINGS = {
    Fault.SENSOR_OUT_OF_RANGE: "a diode's reading is invalid, off the diode, or jumped; or no pose has these readings",
    Fault.COIL_OVERCURRENT: "a current above the limit was commanded, or measured",
    Fault.COIL_OVERTEMP: "a coil is as warm as it may be",
    Fault.FLOTOR_OVERSPEED: "the flotor was too fast",
    Fault.BOUNDARY: "the flotor left its envelope",
    Fault.WATCHDOG: "no command in time, or the amplifiers' enable line stood still",
    Fault.INVALID_COMMAND: "a command that is not finite",
    Fault.ESTOP: "an emergency stop was asked for",
    Fault.COIL_NOT_FOLLOWING: "a measured current was not the commanded one",
    Fault.SENSOR_FROZEN: "a diode repeated its reading more often than its noise allows",
    Fault.CLOCK: "the device's timestamps did not go as its samples do",
    Fault.NOT_FOLLOWING: "the flotor did not go where it was led: signs, diodes exchanged, or a hand in the way",
    Fault.HOST: "the host's program failed, or lost the device's samples",
    Fault.SENSOR_STOPPED: "the sensor's conversion counter stood still",
    Fault.COIL_NOT_OFF: "a current flowed after it was cut: cut the power",
}

Cycle: TypeAlias = tuple[Frame, Sequence[float], Sequence[float], Sequence[float] | None, float, float, float]
"""One cycle in the black box.

STATE frame, pose, held and pulsed currents [A], width [s], delay at the device [s], latency of the answer [s].
"""


class HandshakeError(PlantError):
    """Handshake failed: no answer, or the device refuses this host."""


class BlackBoxError(ParameterError):
    """Error of a black box file: unreadable or invalid."""


class DeviceFault(PlantError):
    """The device is in the fault state with zero current.

    Attributes:
        faults: Faults that the device or host raised.
        path: File with the last 200 cycles; None if it could not be written.
    """

    def __init__(self, faults: Fault, message: str, path: Path | None) -> None:
        where = f"; the last cycles are in {path}" if path is not None else ""
        super().__init__(f"{fault_names(faults)}: {message}{where}")
        self.faults, self.path = faults, path


class BlackBox:
    """Ring buffer of the last 200 cycles, written on faults.

    Args:
        folder: Folder of the files.
    """

    def __init__(self, folder: Path) -> None:
        self._folder, self._versions = folder, versions()
        self._rows: deque[Cycle] = deque(maxlen=_KEPT)
        self.keep = self._rows.append

    @property
    def cycles(self) -> list[Cycle]:
        """The kept cycles."""
        return list(self._rows)

    def write(
        self, faults: Fault, message: str, about: Mapping[str, Any], cycles: Sequence[Cycle] | None = None
    ) -> Path | None:
        """Write the kept cycles to a file.

        The temporary folder is used if the own folder cannot be written.

        Args:
            faults: The faults.
            message: One line of explanation.
            about: Further values, ready for JSON.
            cycles: Cycles kept before, in place of the last ones.

        Returns:
            The file; None if no folder can be written. Nothing is raised, so that the fault itself is reported.
        """
        with suppress(Exception):
            told = {"format": _FORMAT, "faults": fault_names(faults), "message": message, "versions": self._versions}
            rows = [_flat(row) for row in cycles or self._rows]
            text = json.dumps({**told, **about, "columns": _COLUMNS, "cycles": rows})
            for folder in (self._folder, Path(tempfile.gettempdir())):
                with suppress(OSError):
                    folder.mkdir(parents=True, exist_ok=True)
                    return _write(folder, text)
        return None


def _write(folder: Path, text: str, now: Callable[[], float] = time.time) -> Path:
    stem = datetime.fromtimestamp(now()).strftime("maglev-fault-%Y%m%d-%H%M%S")
    for name in chain([stem], (f"{stem}-{number}" for number in count(1))):
        path = folder / f"{name}.json"
        try:
            with path.open("x", encoding="utf-8") as file:
                file.write(text + "\n")
            break
        except FileExistsError:
            continue
        except OSError:
            path.unlink(missing_ok=True)  # cut short, as on a full disk
            raise
    return path


def _flat(cycle: Cycle) -> list[float | None]:
    """Return a cycle as plain numbers, NaN as None."""
    frame, pose, held, pulsed, width, delay, latency = cycle
    report: StateReport = frame.body  # type: ignore[assignment]
    values = (
        *(frame.sequence, frame.time, report.state, report.faults, *report.spots, *pose, *held, *(pulsed or held)),
        *(width, *report.currents, *report.temperatures, delay, latency),
    )
    return [value if value - value == 0 else None for value in values]


@dataclass(frozen=True, kw_only=True, eq=False)
class FaultRecord(Result):
    """Contents of a black box file.

    Attributes:
        faults: Names of the faults.
        first: Names of the first faults.
        message: One line of explanation.
        fault_time: Device time of the first fault [s]; NaN if unknown.
        tick: Number of the last sample.
        lost: Samples that did not arrive.
        skipped: Samples left unanswered for a newer one.
        period: Sample period [s].
        values: Values by name, (N,) each, NaN if missing: sample, time [s], state, faults, spot0 to spot5
            [m], x, y, z [m], rx, ry, rz [rad], held0.. and pulsed0.. [A], width [s], measured0.. [A], temperature0..
            as a share of a coil's limit, delay (at the device) and latency (of the answer) [s].
    """

    faults: str
    first: str
    message: str
    fault_time: float
    tick: int
    lost: int
    skipped: int
    period: float
    values: Mapping[str, Array]
    units: ClassVar = _UNITS

    def columns(self) -> Mapping[str, Array]:
        """Return the values by name, (N,) each."""
        return self.values

    def plot(self, path: Path | None = None) -> Any:
        """Draw the last cycles; see `Result.plot`."""
        from maglev_mj.bridge.pictures import last_cycles

        return save(last_cycles(self), path)

    def table(self, *, whole: bool = False) -> Table:
        """Return the last cycles, with the faults and their meanings below.

        A dash is an unknown value. Time is before the last cycle; currents are the largest of the six, the temperature
        is the highest, delay is at the device and latency that of the answer.

        Args:
            whole: True for every cycle, else the last 20.
        """
        flag("whole", whole)
        values, count = self.values, len(self.time)
        first = 0 if whole else max(count - _SHOWN, 0)
        held, pulsed, measured = (np.abs(self.six(name)).max(axis=-1, initial=0.0) for name in _CURRENTS)
        commanded = np.where(values["width"] > 0.0, np.maximum(held, pulsed), held)
        warm = self.six("temperature").max(axis=-1, initial=0.0) * 100.0
        spans = values["delay"] * 1e3, values["latency"] * 1e3
        shown = np.column_stack([self.time * 1e3, self.six("pose") * 1e3, commanded, measured, warm, *spans])[first:]
        rows = [
            [number_text(value, 9, decimals) for value, decimals in zip(row, _DECIMALS, strict=True)]
            for row in shown.tolist()
        ]
        when = "" if math.isnan(self.fault_time) else f" at {self.fault_time:.4f} s of the device's clock"
        state, sample = values["state"], values["sample"]
        changes = [place for place in range(first, count) if place == first or state[place] != state[place - 1]]
        states = [f"{_state_named(state[place])} from sample {sample[place]:.0f} on" for place in changes]
        remarks = [
            *([f"the last {_SHOWN} of {count} cycles; --all shows all"] if first else []),
            ", ".join(states),
            f"sample {self.tick} at {1.0 / self.period:g} Hz; {self.lost} lost, {self.skipped} skipped",
            f"faults {self.faults}; first {self.first}{when}",
            *fault_meanings(self.faults),
        ]
        return Table(self.message, _HEAD, rows, "\n".join(printable(remark) for remark in remarks if remark))

    @property
    def time(self) -> Array:
        """Time of each cycle, from the last [s], (N,)."""
        time = self.values["time"]
        return time - time[-1] if len(time) else time

    def six(self, kind: str) -> Array:
        """Return six columns of one kind, (N, 6).

        The kind is "measured", "pose" or another prefix of the columns.
        """
        names = AXES if kind == "pose" else [f"{kind}{place}" for place in _SIX]
        return np.stack([self.values[name] for name in names], axis=-1)


def fault_meanings(names: str) -> list[str]:
    """Return name and meaning of each named fault."""
    return [f"{fault.name}: {meaning}" for fault, meaning in _MEANINGS.items() if (fault.name or "") in names.split()]


def _state_named(state: float) -> str:
    return State(int(state)).name.lower() if state in tuple(State) else number_text(state, 9, 0)


def load_black_box(path: str | Path) -> FaultRecord:
    """Read a black box.

    Raises:
        BlackBoxError: If it cannot be read or is not a black box; one line with file and reason.
    """
    return read_json("black box", path, _record, BlackBoxError)


def _record(told: Any) -> FaultRecord:
    kind = told.get("format") if isinstance(told, dict) else type(told).__name__
    if kind != _FORMAT:
        raise BlackBoxError(f"format must be {_FORMAT!r}, not {kind!r:.60}")
    if told.get("columns") != _COLUMNS:
        raise BlackBoxError(f"columns must be those of {kind!r}")
    cycles = told.get("cycles")
    if not isinstance(cycles, list) or any(not isinstance(row, list) or len(row) != len(_COLUMNS) for row in cycles):
        raise BlackBoxError(f"cycles must be rows of {len(_COLUMNS)} values")
    try:
        table = np.array(cycles, dtype=np.float64).reshape(len(cycles), len(_COLUMNS))
        counts: dict[str, Any] = {name: int(told[name]) for name in ("tick", "lost", "skipped")}
        period = int(told["period_ns"]) * 1e-9
        fault_time = int(told["fault_time_ns"]) * 1e-9 if "fault_time_ns" in told else np.nan
    except (TypeError, ValueError, OverflowError, KeyError) as error:
        raise BlackBoxError(f"a value is missing or no number: {error}") from None
    if not period > 0.0:
        raise BlackBoxError(f"period_ns must be above 0, not {told['period_ns']!r:.60}")
    values = dict(zip(_COLUMNS, table.T))
    values["time"] = values.pop("time_ns") * 1e-9
    texts: dict[str, Any] = {name: str(told.get(name)) for name in ("faults", "message")}
    first = str(told.get("first", texts["faults"]))
    return FaultRecord(**counts, **texts, first=first, period=period, fault_time=fault_time, values=values)
