"""Device faults and the device cycles before them."""

from __future__ import annotations

import math
import tempfile
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from itertools import chain, count, starmap
from pathlib import Path
from typing import Any, ClassVar, TypeAlias

import numpy as np

from maglev_mj.bridge.safety import at_most
from maglev_mj.bridge.wire import Fault, Frame, State, StateReport, fault_names
from maglev_mj.errors import ParameterError, PlantError, file_path
from maglev_mj.files import errors_named
from maglev_mj.frames import AXES, Array, unit_of
from maglev_mj.parameters import flag, whole
from maglev_mj.recording import journal
from maglev_mj.recording.recording import refused
from maglev_mj.recording.sample import value_in
from maglev_mj.result import Result, Table, conditions_text, number_text
from maglev_mj.terminal import printable
from maglev_mj.versions import versions

_CYCLES = 200
_CURRENTS = "held", "pulsed", "measured"
_SIX = [part for part in journal.CYCLE_PARTS if part.format == "6<f8"]
_NAMES: Mapping[str, Sequence[str]] = {
    part.name: AXES if part.name == "pose" else [f"{part.name.removesuffix('s')}{index}" for index in range(6)]
    for part in _SIX
}
"""Names of the six columns of each kind."""
_UNITS = {part.name: part.unit for part in journal.CYCLE_PARTS if part not in _SIX and part.unit}
_UNITS |= {axis: unit_of("m", axis) for axis in AXES}
_UNITS |= {name: part.unit for part in _SIX if part.name != "pose" and part.unit for name in _NAMES[part.name]}
_ROWS = 20
"""Cycles shown in a table by default."""
_HEAD = ("time [ms]", *(f"{axis} [{unit_of('mm', axis)}]" for axis in AXES), "cmd [A]", "meas [A]", "warm [%]")
_HEAD += ("delay [ms]", "answer [ms]")
_DECIMALS = 1, *[2] * 6, 2, 2, 0, 2, 2

_MEANINGS = {
    Fault.SENSOR_OUT_OF_RANGE: "a diode reading is invalid, out of range or jumped, or the readings match no pose",
    Fault.COIL_OVERCURRENT: "a commanded or measured current exceeds the limit",
    Fault.COIL_OVERTEMP: "a coil reached its temperature limit",
    Fault.FLOTOR_OVERSPEED: "the flotor exceeded its speed limit",
    Fault.BOUNDARY: "the flotor left its envelope",
    Fault.WATCHDOG: "no command in time, or the amplifiers' enable line stopped toggling",
    Fault.INVALID_COMMAND: "a command is not finite, or its pulse width is out of range",
    Fault.ESTOP: "emergency stop requested",
    Fault.COIL_NOT_FOLLOWING: "a measured current differs from the commanded one",
    Fault.SENSOR_FROZEN: "a diode repeated its reading more often than its noise allows",
    Fault.CLOCK: "the device's timestamps do not match its sample numbers",
    Fault.NOT_FOLLOWING: "the flotor did not follow the commands: wrong signs, swapped diodes or a hand in the way",
    Fault.HOST: "the host program failed, or received no samples from the device",
    Fault.SENSOR_STOPPED: "the sensor's conversion counter stopped",
    Fault.COIL_NOT_OFF: "a current still flows after the cut: cut the power",
    Fault.WALL_ENERGY: "the walls on the device generated energy: reduce their stiffness",
}

_Answer: TypeAlias = tuple[Sequence[float], Sequence[float] | None, float]
_Cycle: TypeAlias = tuple[Frame, Sequence[float], _Answer, float, float]


class HandshakeError(PlantError):
    """Handshake failed: no answer, or the device refuses this host."""


class DeviceFault(PlantError):
    """A flight has ended with a fault.

    Attributes:
        faults: Faults that the device or host raised.
        path: File with the last 200 cycles; None if it could not be written.
        off: Largest current that counts as off, if a sample since has shown no larger one [A]; None otherwise, and the
            message says to cut the power.
    """

    def __init__(self, faults: Fault, message: str, path: Path | None, *, off: float | None) -> None:
        where = f"; the last cycles are in {path}" if path is not None else ""
        currents = "currents not confirmed off: cut the power at the amplifiers" if off is None else at_most(off)
        super().__init__(f"{fault_names(faults)}: {message}{where}; {currents}")
        self.faults, self.path, self.off = faults, path, off


class LastCycles:
    """Last 200 cycles of a device, written to a journal on a fault.

    Args:
        folder: Folder of the journals.

    Attributes:
        record: Called with the records of cycles and faults if the flight is recorded; else None.
    """

    def __init__(self, folder: Path) -> None:
        versions()  # cached now: a fault may occur in the real-time loop
        self._folder = folder
        self._rows: deque[_Cycle] = deque(maxlen=_CYCLES)
        self.record: Callable[[bytes], object] | None = None

    def keep(self, frame: Frame, pose: Sequence[float], answer: _Answer, delay: float, latency: float) -> None:
        """Store a cycle.

        Args:
            frame: STATE frame.
            pose: Its pose [m, rad], six.
            answer: Held currents [A], six; pulsed currents [A], six, or None; pulse width [s].
            delay: Delay of the previous answer, by the device's clock [s].
            latency: Host latency of the answer [s].
        """
        row = frame, pose, answer, delay, latency
        self._rows.append(row)
        if self.record is not None:
            self.record(_packed(*row))

    def mark(self, faults: Fault, message: str, about: Mapping[str, Any]) -> bytes:
        """Record a fault, or the reason a flight ends; return its record and those of the stored cycles.

        Args:
            faults: The faults.
            message: One line of explanation.
            about: Additional values for JSON.
        """
        text = journal.text_records({"fault": fault_names(faults), "text": message, **about})
        if self.record is not None:
            self.record(text)
        return b"".join((*starmap(_packed, self._rows), text))

    def write(self, records: bytes) -> Path | None:
        """Write records to a new journal in `folder`, or in the temporary folder if that fails.

        Returns:
            The file; None if neither folder can be written. Raises nothing: it must not hide the fault.
        """
        with suppress(Exception):
            data = b"".join(journal.journal_bytes((records, journal.text_records({"end": {"lost": 0}}))))
            for folder in (self._folder, Path(tempfile.gettempdir())):
                with suppress(OSError):
                    folder.mkdir(parents=True, exist_ok=True)
                    return _write(folder, data)
        return None


def _packed(frame: Frame, pose: Sequence[float], answer: _Answer, delay: float, latency: float) -> bytes:
    """Return the record of a cycle; arguments as of `LastCycles.keep`."""
    report: StateReport = frame.body  # type: ignore[assignment]
    held, pulsed, width = answer
    six = *report.spots, *pose, *held, *(held if pulsed is None else pulsed), *report.currents, *report.temperatures
    head = journal.CYCLE, frame.sequence, report.state, report.faults, frame.time * 1e-9
    reported = (getattr(report, name) for name in journal.REPORTED)
    others = chain.from_iterable(value if isinstance(value, tuple) else (value,) for value in reported)
    return journal.PACK_CYCLE(*head, *six, width, delay, latency, *others)


def _write(folder: Path, data: bytes, now: Callable[[], float] = time.time) -> Path:
    stem = datetime.fromtimestamp(now()).strftime("fault-%Y%m%d-%H%M%S")
    for name in chain([stem], (f"{stem}-{number}" for number in count(1))):
        path = folder / f"{name}{journal.SUFFIX}"
        try:
            with errors_named(path), path.open("xb") as file:
                file.write(data)
            break
        except FileExistsError:
            continue
        except OSError:
            path.unlink(missing_ok=True)  # incomplete, for example on a full disk
            raise
    return path


@dataclass(frozen=True, kw_only=True, eq=False)
class FaultRecord(Result):
    """Last cycles of a device: before its fault, or at the end of a recording.

    Attributes:
        faults: Names of the faults.
        first: Names of the first faults.
        message: One line of explanation.
        fault_time: Device time of the first fault [s]; NaN if unknown.
        tick: Index of the last sample since the handshake. Without a fault: the device's number of it.
        lost: Samples that did not arrive, since the handshake. Without a fault: missing cycles, lost or skipped.
        skipped: Samples not answered because a newer one had arrived.
        period: Sample period [s].
        values: Values by name, (N,) each, NaN if missing: sample, time [s], state, faults, spot0 to spot5
            [m], x, y, z [m], rx, ry, rz [rad], held0.. and pulsed0.. [A], width [s], measured0.. [A], temperature0..
            as a share of a coil's limit, delay (at the device) and latency (of the answer) [s].
        damage: Damage to the file, at which the cycles end; empty if intact.
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
    damage: str = ""
    units: ClassVar = _UNITS
    pictures: ClassVar = {"fault": "maglev_mj.bridge.pictures:last_cycles"}

    def _headline(self) -> str:
        fault = "" if math.isnan(self.fault_time) else f"{self.faults}: "
        return f"{fault}{self.message} ({len(self.time)} cycles at {1.0 / self.period:g} Hz)"

    @property
    def conditions(self) -> str:
        """See `Result`; the delay is the median measured by the device."""
        delays = self.values["delay"][np.isfinite(self.values["delay"])]
        return conditions_text("flight", AXES, [self.period], [np.median(delays)] if delays.size else ())

    def columns(self) -> Mapping[str, Array]:
        """Return the values by name, (N,) each."""
        return self.values

    def table(self, *, whole: bool = False) -> Table:
        """Return the last cycles; below, the faults and their meanings.

        A dash marks a missing value. Time is relative to the last cycle; currents and temperature are the largest of
        the six coils; delay is by the device's clock, answer the host latency.

        Args:
            whole: True for every cycle, else the last 20.
        """
        flag("whole", whole)
        values, count = self.values, len(self.time)
        first = 0 if whole else max(count - _ROWS, 0)
        held, pulsed, measured = (np.abs(self.six(name)).max(axis=-1, initial=0.0) for name in _CURRENTS)
        commanded = np.where(values["width"] > 0.0, np.maximum(held, pulsed), held)
        warm = self.six("temperature").max(axis=-1, initial=0.0) * 100.0
        spans = values["delay"] * 1e3, values["latency"] * 1e3
        table = np.column_stack([self.time * 1e3, self.six("pose") * 1e3, commanded, measured, warm, *spans])[first:]
        rows = [
            [number_text(value, 9, decimals) for value, decimals in zip(row, _DECIMALS, strict=True)]
            for row in table.tolist()
        ]
        when = "" if math.isnan(self.fault_time) else f" at {self.fault_time:.4f} s (device clock)"
        state, sample = values["state"], values["sample"]
        changes = [index for index in range(first, count) if index == first or state[index] != state[index - 1]]
        states = [  # the first row need not be a change
            f"{_state_name(state[index])} {'at' if index == first else 'from'} {sample[index]:.0f}" for index in changes
        ]
        states = [f"device's sample numbers: {', '.join(states)}, last {sample[-1]:.0f}"] if count else []
        # the host counts from the handshake, the device from its start
        since = "these cycles" if math.isnan(self.fault_time) else "since the handshake, with the preflight check"
        remarks = [
            "cmd, meas, warm: largest commanded current, measured current and temperature of a coil",
            *([f"last {_ROWS} of {count} cycles; --all shows all"] if first else []),
            *states,
            f"{1.0 / self.period:g} Hz; {since}: {self.lost} samples lost, {self.skipped} skipped",
            f"faults {self.faults}; first {self.first}{when}",
            self.damage,
            *fault_meanings(self.faults),
        ]
        return Table("", _HEAD, rows, "\n".join(printable(remark) for remark in remarks if remark))

    @property
    def time(self) -> Array:
        """Time of each cycle, relative to the last [s], (N,)."""
        time = self.values["time"]
        return time - time[-1] if len(time) else time

    def six(self, kind: str) -> Array:
        """Return the six columns of one kind, (N, 6).

        The kind is "pose", or a prefix of column names such as "measured".
        """
        names = AXES if kind == "pose" else [f"{kind}{index}" for index in range(6)]
        return np.stack([self.values[name] for name in names], axis=-1)


def fault_meanings(names: str) -> list[str]:
    """Return `NAME: meaning` for each named fault."""
    return [f"{fault.name}: {meaning}" for fault, meaning in _MEANINGS.items() if (fault.name or "") in names.split()]


def _state_name(state: float) -> str:
    return State(int(state)).name.lower() if state in tuple(State) else number_text(state, 9, 0)


def load_fault(path: str | Path) -> FaultRecord:
    """Read the last cycles from a journal: those before its last fault, or before its end.

    Raises:
        InvalidRecordingError: If it cannot be read, is not a journal, or contains no cycles; one line with file and
            reason.
    """
    path = file_path(path)
    with refused(path):
        content = journal.open_journal(path)
        for index in np.flatnonzero(content.kinds == journal.TEXT)[::-1].tolist():
            try:
                message = content.message(index)
            except ParameterError:
                if index < content.proven:
                    raise
                continue  # damaged, after the last checksum
            if "fault" in message:
                return _record(content, index, message)
        return _record(content, len(content.records), None)


def _record(content: journal.JournalContent, last: int, message: Mapping[str, Any] | None) -> FaultRecord:
    damage = "; ".join(filter(None, (content.repaired, content.damage)))
    cycles = content.cycles(last, _CYCLES)
    values = {name: cycles[name].astype(np.float64) for name in cycles.dtype.names or () if name not in _NAMES}
    values |= {name: column for kind, names in _NAMES.items() for name, column in zip(names, cycles[kind].T)}
    values = {name: np.where(np.isfinite(column), column, np.nan) for name, column in values.items()}
    values["sample"] = values.pop("tick")
    del values["kind"]
    texts: dict[str, Any]
    if message is not None:
        counts: dict[str, Any] = {name: whole(name, value_in(message, name)) for name in ("tick", "lost", "skipped")}
        period = whole("period_ns", value_in(message, "period_ns"), at_least=1) * 1e-9
        fault_time = whole("fault_time_ns", value_in(message, "fault_time_ns")) * 1e-9
        keys = {"faults": "fault", "first": "first", "message": "text"}
        texts = {name: value_in(message, key, str) for name, key in keys.items()}
    elif len(cycles) < 2:
        raise ParameterError(damage or "no device cycles (only recordings of flights contain them)")
    else:
        steps = np.diff(cycles["tick"])
        period, fault_time = float(np.median(np.diff(cycles["time"]) / steps)), math.nan
        counts = {"tick": int(cycles["tick"][-1]), "lost": int((steps - 1).sum()), "skipped": 0}
        faults = fault_names(int(cycles["faults"][-1]))
        texts = {"faults": faults, "first": faults, "message": "no fault recorded; last cycles"}
    return FaultRecord(**counts, **texts, period=period, fault_time=fault_time, values=values, damage=damage)
