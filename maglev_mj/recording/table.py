"""Recordings from tables of other programs: columns by name, stated units, checked time stamps."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from maglev_mj.control.controller import Controller
from maglev_mj.control.timeline import Timing
from maglev_mj.errors import ParameterError, check_one_of, one_line
from maglev_mj.frames import AXES, Array, Mask, quaternions, rotation_vector
from maglev_mj.keywords import checked
from maglev_mj.parameters import number, numbers, read_file
from maglev_mj.plants.coils import CoilMap
from maglev_mj.plants.hand import Trajectory
from maglev_mj.plants.sensor import moved
from maglev_mj.recording.recording import Recording, Segment
from maglev_mj.recording.sample import FIELDS, Face, RunMetadata, check_rows
from maglev_mj.recording.setup import MEASURED
from maglev_mj.recording.text_table import (
    UNITS,
    TableFormat,
    TextTable,
    base_and_unit,
    check_values,
    quantity_of,
    read_table,
    words_of,
)
from maglev_mj.spec import GRAVITY, MAX_PERIOD, MIN_PERIOD
from maglev_mj.versions import versions

_GROUPS = {
    "position": dict(zip(AXES, ["length"] * 3 + ["angle"] * 3)),
    "command": {f"f{axis}": ("force", "torque")[index > 2] for index, axis in enumerate(AXES)},
    "hand": {f"h{axis}": ("force", "torque")[index > 2] for index, axis in enumerate(AXES)},
}
_ORDERS = {"quaternion": "xyzw:qx+qy+qz+qw", "euler": "ZYX:yaw+pitch+roll"}  # with an example
_QUANTITIES = {"time": "time", "quaternion": "", "euler": "angle"}
_QUANTITIES |= {key: quantity for group in _GROUPS.values() for key, quantity in group.items()}

_TIMES = {"t", "time", "stamp", "timestamp", "clock", "zeit", "datetime", "millis", "micros"}
_AXIS_OF_TIME = "x-axis", "x_value"  # of oscilloscopes; of LabVIEW, in s
_POSES = {"p", "pos", "position", "pose", "translation"}
_MOTIONS = {"pos", "position", "displacement", "deflection", "travel", "weg"}
_ANGLES = {"angle", "theta", "phi", "winkel", "rotation", "pitch", "roll", "yaw"}
_OTHERS = set(
    "v vel velocity speed acc acceleration target desired reference ref setpoint goal orientation error".split()
)

_LEAST_SAMPLES = 16
_SINCE_1970 = 1e9, 4.1e9  # [s], 2001 to 2099
_TURN = 2.0**32  # of a counter
_PREFIXES = 1.0, 1e-3, 1e-6, 1e-9
_LONGEST_WRAP = 100.0  # steps across a wrap, in typical steps
_FEW_GAPS, _MOST_MISSING = 3, 0.25  # pauses; share in more gaps, which bursts have
_ONE_GAP = 0.9  # share of one gap in what is missing: the clock was set
_LEAST_PPM = 0.1
_OFF_GRID, _LONGEST_STEP, _ROUNDING = 0.25, 3.0, 1e-9  # in periods
_MOST_TICKS = 1e8
"""Most samples of a table that is resampled."""
_LARGEST_TURN, _NORM_ERROR = 1.0, 0.01


class Log(NamedTuple):
    """Motion in a text table; see `read_log`.

    Attributes:
        period: Sample period [s].
        tick: Tick of each sample, (N,).
        parts: Fields of a recording in use, (N, 6) each, zero for axes without a column.
        taken: What the file was taken for, in one line.
        resampled: True if the samples are interpolated.
        axis: Index into AXES of the largest travel, of translations if there are any.
    """

    period: float
    tick: Array
    parts: dict[str, Array]
    taken: str
    resampled: bool
    axis: int


def read_log(
    path: Path | str,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    *,
    scale: Mapping[str, float] | None = None,
    coils: CoilMap | None = None,
    rate: float | None = None,
    hold: bool = False,
    resample: bool = False,
    form: TableFormat | None = None,
    si: bool = False,
) -> Log:
    """Read the motion in a text table; see `import_table`.

    Args:
        path: The file.
        columns: Column of each value; time and pose by their names if None.
        units: Unit of each quantity; by default as the file states it.
        scale: Factor of a column by its name.
        coils: Coil map, for currents.
        rate: Sample rate [Hz]; estimated if None.
        hold: True to hold wrenches until their next row.
        resample: True to accept time off a grid.
        form: What the file is to be taken for.
        si: True for SI units where neither `units` nor the file states one.

    Raises:
        ParameterError: If the file cannot be read, or contradicts what it is taken for; one line with path and remedy.
    """

    def parsed(data: bytes) -> Log:
        table = read_table(data, form or TableFormat())
        chosen = _by_name(table, units or {}) if columns is None else columns
        stamps, parts, notes = _in_si(table, chosen, units or {}, scale or {}, coils, si=si)
        step = None if rate is None else 1.0 / number("rate", rate, above=0.0)
        if stamps is None:
            if step is None or hold:
                raise ParameterError("columns must include time, or rate must be given if each row is a sample")
            stamps = np.arange(len(table.rows), dtype=np.float64) * step
        kept = _complete_rows(table.rows, parts, hold)
        rows, time = table.rows[kept], stamps[kept] - stamps[kept][:1]
        parts = {"position": np.zeros((len(rows), 6))} | {name: part[kept] for name, part in parts.items()}
        if len(rows) < _LEAST_SAMPLES:
            raise ParameterError(f"table must have at least {_LEAST_SAMPLES} samples (got {len(rows)}): record longer")
        turns = np.linalg.norm(np.diff(parts["position"][:, 3:], axis=0), axis=1)
        rule, remedy = "rotation must change by at most 1 rad a sample", "check its order and unit"
        check_values(turns <= _LARGEST_TURN, rows[1:], turns, rule, remedy)
        period, tick, error = uniform_ticks(time, rows, step, resample=resample)
        if not MIN_PERIOD <= period <= MAX_PERIOD:
            got = f"got {1.0 / period:.4g} Hz{''.join(f', {note}' for note in notes[:1])}"
            remedy = f"{'import it, and ' * si}state the unit of time, such as time=ms"
            raise ParameterError(f"rate must be 10 Hz to 1 MHz ({got}): {remedy}")
        if off_grid := bool(error.max() > _OFF_GRID or (np.diff(tick) < 1.0).any()):
            if (count := time[-1] / period) > _MOST_TICKS:
                raise ParameterError(f"table spans {count:.3g} samples of {period:g} s: split the file at its gap")
            path_of = Trajectory(time, parts["position"], "cubic")
            tick = np.arange(np.floor(time[-1] / period + _ROUNDING) + 1.0)
            before = np.searchsorted(time, (tick + _ROUNDING) * period, side="right") - 1
            inside = np.append(np.diff(time), 0.0)[before] <= _LONGEST_STEP * period  # not in a gap
            tick, parts = tick[inside], {name: part[before[inside]] for name, part in parts.items()}
            parts["position"] = np.array([path_of.at(at) for at in (tick * period).tolist()])
        count = int(tick[-1]) + 1
        taken = [*table.taken, *notes, f"{1.0 / period:.6g} Hz", f"{count - len(tick)} of {count} missing"]
        taken += [f"time off its grid by up to {error.max():.2g} periods"] * bool(error.max() > _ROUNDING)
        taken += ["resampled"] * off_grid
        taken += ["by name: " + ", ".join(f"{key} = {text}" for key, text in chosen.items())] * (columns is None)
        travel = np.ptp(parts["position"], axis=0)
        axis = int(np.argmax(travel[:3] if travel[:3].any() else travel))
        return Log(period, tick, parts, f"{Path(path).name}: {', '.join(taken)}", off_grid, axis)

    return read_file("log", path, parsed, read=Path.read_bytes)


@checked
def import_table(
    path: Path | str,
    columns: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    *,
    mass: float,
    delay: float | None = None,
    inertia: ArrayLike | None = None,
    gravity: ArrayLike = (0.0, 0.0, -GRAVITY),
    coils: CoilMap | None = None,
    scale: Mapping[str, float] | None = None,
    rate: float | None = None,
    hold: bool = False,
    resample: bool = False,
    faces: Sequence[Face] = (),
    encoding: str | None = None,
    skip: int | None = None,
    separator: str | None = None,
    decimal: str | None = None,
    names: Sequence[str] | None = None,
) -> Recording:
    """Return a recording of kind measured from a text table; its first event says what the file was taken for.

    Args:
        path: The file, which may be compressed by gzip.
        columns: Column of each value: time; x to rz, pose; fx to frz, wrench of the actuators; hx to hrz, wrench of
            the hand; i0, i1 and so on, currents of all coils. In place of rx, ry, rz: quaternion, such as
            "xyzw:qx+qy+qz+qw", or euler, such as "ZYX:yaw+pitch+roll", each about the axes turned by those before it.
            Time and pose by their names if None.
        units: Unit of each quantity, see `UNITS`; by default as names or a row of units state it.
        mass: Moving mass [kg].
        delay: Delay from a sample to the effect of its command [s]; one period by default.
        inertia: Moments of inertia [kg m²], one or (3,); required with torques.
        gravity: Acceleration of free fall [m/s²], (3,); zero for a device that compensates its weight.
        coils: Coil map, for currents.
        scale: Factor of a column by its name, to the stated unit or else to SI; negative for a mirrored axis.
        rate: Sample rate [Hz]; by default estimated from time. Without time, each row is a sample.
        hold: True to hold wrenches until their next row, for pose and wrench on rows of their own.
        resample: True to accept time off a grid: the pose is interpolated by a cubic, wrenches are held.
        faces: Planes of walls: index into AXES, normal (1 if the device is free above the edge), edge [m, rad].
        encoding: "utf-8", "utf-16" or "latin-1"; by default, as skip to names, decided by the file.
        skip: Lines before the names, or before the numbers of a table without names.
        separator: "tab", "semicolon", "comma", "bar" or "blank".
        decimal: "point" or "comma"; the other one then groups thousands.
        names: Names of all columns, in place of those in the file.

    Raises:
        ParameterError: If table, unit, time or rotation is invalid; one line with row and remedy.
    """
    form = TableFormat(encoding, skip, separator, decimal, names)
    log = read_log(path, columns, units, scale=scale, coils=coils, rate=rate, hold=hold, resample=resample, form=form)
    period, tick, parts = log.period, log.tick, log.parts
    if inertia is None and any(_QUANTITIES.get(key, "current") in ("torque", "current") for key in columns or ()):
        raise ParameterError("inertia must be given for torques and currents [kg m²]")
    moments = np.broadcast_to(
        numbers("inertia", 1e-3 if inertia is None else inertia, shape="() or (3,)", above=0.0), 3
    )
    metadata = RunMetadata.of(
        Timing(period=period, delay=period if delay is None else delay),
        Controller([], period=period),
        name=Path(path).stem,
        axis=AXES[faces[0][0] if faces else log.axis],
        hand_recorded="hand" in parts,
        inertia=[number("mass", mass, above=0.0)] * 3 + moments.tolist(),
        load=[*(mass * numbers("gravity", gravity, shape="(3,)")), 0.0, 0.0, 0.0],
        before=np.zeros(6),
    )
    arrays = {field.name: np.zeros((len(tick), 6) if field.six else len(tick)) for field in FIELDS}
    arrays |= {name: np.full_like(arrays[name], np.nan) for name in ("hand", "arrival")}
    arrays |= {"tick": tick, "time": tick * period, **parts, "applied": parts.get("command", arrays["command"])}
    check_rows(arrays)
    setup: dict[str, Any] = {"kind": MEASURED, "scene": None, "source": None}
    assumed = {"delay_assumed": delay is None, "inertia_assumed": inertia is None}
    setup |= {"parameters": {"resampled": log.resampled, **assumed}}
    setup |= {"samples": len(tick), "controller": {}, "plant": {}, "versions": versions()}
    setup["run"] = replace(metadata, faces=[*faces]).as_json()
    note = log.taken + ("" if "command" in parts else "; no wrench of the actuators")
    note += "; a delay of one period is assumed" * (delay is None)
    return Recording([Segment(setup=setup, arrays=arrays)], events=[note], event_samples=[len(tick)])


def _by_name(table: TextTable, units: Mapping[str, str]) -> dict[str, str]:
    """Return the columns of time and pose by their names; of two columns, the second one may have any name."""
    ranked: dict[str, list[tuple[int, str]]] = {}
    usable = [index for index in range(len(table.names)) if not table.is_empty(index)]
    for index in usable:
        for key, rank in _keys_of(table.names[index], table.units[index], units):
            ranked.setdefault(key, []).append((rank, table.names[index]))
    columns = {key: _only(key, ranked[key]) for key in ("time", *AXES) if key in ranked}
    motion = [key for key in ("z of motion", "rx of motion") if key in ranked]
    if not {*columns} & {*AXES} and motion:
        names = [one for key in motion for one in ranked[key]]
        name = _only("position", names)
        columns |= {next(key.split()[0] for key in motion if name in [one for _, one in ranked[key]]): name}
    if not {*columns} & {*AXES} and len(usable) == 2:
        time = columns.setdefault("time", table.names[usable[0]])
        (other,) = (index for index in usable if table.names[index] != time)
        columns["rx" if _is_angle(table.units[other], units) else "z"] = table.names[other]
    if not {*columns} & {*AXES}:
        raise ParameterError(f"columns must be given, such as z=NAME: no pose among {', '.join(table.names)}")
    return columns


def _only(what: str, ranked: Sequence[tuple[int, str]]) -> str:
    """Return the name of the best rank; raise ParameterError for several."""
    names = [name for rank, name in ranked if rank == min(ranked)[0]]
    if len(names) > 1:
        choices = " or ".join(map(one_line, names))
        raise ParameterError(f"{what} must be one column (got {choices}): import it, with columns")
    return names[0]


def _is_angle(unit: str, units: Mapping[str, str]) -> bool:
    quantity = quantity_of(unit)
    return quantity == "angle" or (not quantity and "angle" in units and "length" not in units)


def _keys_of(name: str, unit: str, units: Mapping[str, str]) -> Iterator[tuple[str, int]]:
    """Yield what a column may be by its name, with a rank, 0 for a name that says nothing else.

    A position without an axis is z, or rx for an angle, of motion.
    """
    (base, own), quantity = base_and_unit(name), quantity_of(unit)
    words = words_of(base)
    if quantity in ("", "time"):
        alone = bool(own) and base == name  # such as ms
        if alone or base.lower() in _AXIS_OF_TIME or (len(words) == 1 and words[0] in _TIMES):
            yield "time", 0
        elif {*words} & (_TIMES - {"t"}):
            yield "time", 1
    if quantity in ("time", "force", "torque", "current") or {*words} & _OTHERS:
        return
    for axis in AXES:
        key = f"r{axis}" if len(axis) == 1 and quantity == "angle" else axis
        if (quantity == "length" and len(axis) == 2) or not words:
            continue
        if words in ([axis], ["position", axis]):
            yield key, 0
        elif words == [f"p{axis}"] or (axis in (words[0], words[-1]) and {*words} & _POSES):
            yield key, 1
    if {*words} & (_MOTIONS | _ANGLES):
        angle = _is_angle(unit, units) or (not quantity and bool({*words} & _ANGLES))
        yield ("rx of motion" if angle else "z of motion"), int(len(words) > 1)


_Words: TypeAlias = Mapping[str, str]


def _in_si(
    table: TextTable,
    columns: _Words,
    units: _Words,
    scale: Mapping[str, float],
    coils: CoilMap | None,
    *,
    si: bool,
) -> tuple[Array | None, dict[str, Array], list[str]]:
    """Return time [s], (N,), None without it, the fields in use, (N, 6) each, and the units in words, time first."""
    currents = [f"i{index}" for index in range(len(coils or AXES))]
    quantities = _QUANTITIES | dict.fromkeys(currents, "current")
    for key in columns:
        check_one_of("columns", quantities, key)
    sources = {key: _orders_and_names(key, text) for key, text in columns.items()}
    used = {name: quantities[key] for key, (_, names) in sources.items() for name in names}
    for quantity, unit in units.items():
        check_one_of("quantity of units", UNITS, quantity)
        check_one_of(f"unit of {quantity}", UNITS[quantity], unit)
    scales = {table.place(name): number("scale", factor) for name, factor in scale.items()}
    factors, notes = dict[str, float](), dict[str, list[str]]()
    without = dict[str, str]()
    for name, quantity in used.items():
        index = table.place(name)
        factor, own, how = scales.get(index, 1.0), table.units[index], ""
        unit = units.get(quantity, "") or _own_unit(name, own, quantity, scaled=index in scales)
        if quantity == "time" and not unit:
            unit, how = _unit_of_time(table, index)
        if not unit and si and quantity and not own and index not in scales:
            unit, how = next(iter(UNITS[quantity])), " (assumed)"
        if unit:
            factor *= UNITS[quantity][unit]
            notes.setdefault(quantity, []).append(f"{quantity} in {unit}{how}")
        elif quantity and index not in scales:
            without[quantity] = f"{one_line(name)}{f' in {own}' * bool(own)}"
        factors[name] = factor
    if without:
        proposed = " ".join(f"{quantity}={'|'.join(UNITS[quantity])}" for quantity in without)
        lacking = ", ".join(without.values())
        raise ParameterError(f"units must be stated for {lacking}: {proposed}; counts need a scale, SI units per count")
    time, words = None, ["no time"]
    if "time" in columns:
        words = notes.pop("time", ["time scaled"])
        stamps, wraps = _unwrapped(table.stamps(columns["time"]))
        time = stamps * factors[columns["time"]]
        words += [f"32-bit stamps unwrapped {wraps} time{'s' * (wraps != 1)}"] * bool(wraps)
    words += [note for part in notes.values() for note in dict.fromkeys(part)]
    read = {
        key: [table.values(name) * factors[name] for name in names]
        for key, (_, names) in sources.items()
        if key != "time"
    }
    if turns := [key for key in _ORDERS if key in read]:
        if len(turns) > 1 or {*AXES[3:]} & {*read}:
            raise ParameterError("rotation must be one of rx ry rz, quaternion and euler (got several)")
        vectors = _rotation(sources[turns[0]][0], read[turns[0]], table.rows)
        read |= {axis: [part] for axis, part in zip(AXES[3:], vectors)}
    zero, parts = [np.zeros(len(table.rows))], {}
    for field in [field for field, keys in _GROUPS.items() if {*keys} & {*read}]:
        parts[field] = np.column_stack([read.get(key, zero)[0] for key in _GROUPS[field]])
    if {*currents} & {*read}:
        if coils is None or "command" in parts or {*currents} - {*read}:
            names = f"i0 to {currents[-1]}"
            raise ParameterError(f"columns of currents must be {names}, with a calibration and without a wrench")
        parts["command"] = np.column_stack([read[key][0] for key in currents]) @ coils.wrench_per_current.T
    if not parts:
        raise ParameterError("columns must include a pose or a wrench (got time alone)")
    return time, parts, words


def _own_unit(name: str, unit: str, quantity: str, *, scaled: bool) -> str:
    """Return the unit of a column that its file states, empty for one that a scale converts or that is not SI.

    Raises:
        ParameterError: If it is that of another quantity.
    """
    if not quantity or unit in UNITS[quantity]:
        return unit if quantity else ""
    if scaled or not quantity_of(unit):
        return ""
    hint = ": x in an angle is rx" if (quantity, quantity_of(unit)) == ("length", "angle") else ""
    raise ParameterError(
        f"column {one_line(name)} must be a {quantity} (got {unit} in the file){hint or ': state units'}"
    )


def _unit_of_time(table: TextTable, index: int) -> tuple[str, str]:
    """Return the unit of stamps that are since 1970, of a clock, or of LabVIEW, and which in words; empty for others.

    In another unit, stamps since 1970 would have no rate in the allowed range.
    """
    if table.is_clock(index):
        return "s", " of a clock"
    if table.names[index].lower() == _AXIS_OF_TIME[1]:
        return "s", ""
    first = table.values(table.names[index])[0]
    for unit, factor in UNITS["time"].items():
        if _SINCE_1970[0] < first * factor < _SINCE_1970[1]:
            return unit, " since 1970"
    return "", ""


def _unwrapped(stamps: Array) -> tuple[Array, int]:
    """Return stamps since the first one without the wraps of a 32-bit counter of s, ms, us or ns, and their number."""
    steps = np.diff(stamps)
    back, forward = steps < 0.0, steps[steps > 0.0]
    if not back.any() or not len(forward):
        return stamps, 0
    typical = float(np.median(forward))
    for turn in (_TURN * prefix for prefix in _PREFIXES):
        across = steps[back] + turn
        if (across > 0.0).all() and (across < _LONGEST_WRAP * typical).all() and _LONGEST_WRAP * typical < 0.5 * turn:
            return stamps + np.append(0.0, np.cumsum(turn * back)), int(np.count_nonzero(back))
    return stamps, 0


def _orders_and_names(key: str, text: str) -> tuple[str, list[str]]:
    """Return the columns of a value, several for a quaternion or Euler angles, whose order is stated before them."""
    if key not in _ORDERS:
        return "", [text]
    order, _, rest = text.partition(":")
    names = rest.split("+")
    valid = sorted(order) == [*"wxyz"] if key == "quaternion" else re.fullmatch(r"(?!.*(.)\1)[XYZ]{3}", order)
    if not valid or len(names) != len(order):
        raise ParameterError(f"{key} must be an order and its columns, such as {_ORDERS[key]} (got {one_line(text)})")
    return order, names


def _rotation(order: str, parts: Sequence[Array], rows: NDArray[np.int64]) -> Sequence[Array]:
    """Return the components of the rotation vectors [rad], (N,) each, of quaternions or Euler angles [rad]."""
    pose = np.zeros((len(rows), 6))
    for letter, angle in zip(order[::-1], parts[::-1]) if len(order) == 3 else ():
        pose = moved(pose, np.eye(6)[3 + "XYZ".index(letter)] * angle[:, None])
    w, x, y, z = quaternions(pose[:, 3:]) if len(order) == 3 else (parts[order.index(letter)] for letter in "wxyz")
    size = np.sqrt(w * w + x * x + y * y + z * z)
    check_values(~(np.abs(size - 1.0) > _NORM_ERROR), rows, size, "quaternion must have norm 1", "check its columns")
    size = np.where(w < 0.0, -size, size)  # the shorter way
    return rotation_vector(w / size, x / size, y / size, z / size, np.sqrt, np.arctan2)


def _complete_rows(rows: NDArray[np.int64], parts: dict[str, Array], hold: bool) -> Mask:
    """Return which rows have all values, (N,); with `hold`, fill in wrenches from the last row that has them."""
    for name in [*parts][1:] if hold else ():
        known = np.isfinite(parts[name]).all(axis=1)
        last = np.maximum.accumulate(np.where(known, np.arange(len(rows)), -1))
        parts[name] = np.where(last[:, None] < 0, np.nan, parts[name][last])
    kept = np.logical_and.reduce([np.isfinite(part).all(axis=1) for part in parts.values()])
    if not hold and 2 * np.count_nonzero(kept) < len(rows):
        got = f"got {np.count_nonzero(~kept)} of {len(rows)}, first row {rows[~kept][0]}"
        raise ParameterError(f"at most half of the rows may lack values ({got}): join hold if they alternate")
    return np.asarray(kept)


def uniform_ticks(
    time: Array, rows: NDArray[np.int64], period: float | None = None, *, resample: bool = False
) -> tuple[float, Array, Array]:
    """Return the period [s], estimated if None, the tick of each sample and its distance to it in periods, (N,) each.

    Raises:
        ParameterError: If time [s], (N,), of rows of a file does not increase, is off its ticks without `resample`, or
            too many samples are missing at an estimated period: of bursts, or of a clock that was set.
    """
    steps = np.diff(time)
    check_values(steps >= 0.0, rows[1:], steps, "time must not go back", "split the file there")
    remedy = "use the device's clock, or give rate without time if each row is a sample"
    check_values(steps > 0.0, rows[1:], steps, "time must increase", remedy)
    step = float(np.median(steps)) if period is None else period
    if period is None:
        _check_missing(steps, step, rows)
        step = _fitted(time, step)
    tick, error = _ticks(time, step)
    on_grid = (error <= _OFF_GRID) & (np.diff(tick, prepend=-math.inf) > 0.0)
    if not resample and not on_grid.all():
        rule = f"time must be within {_OFF_GRID} periods of its tick at {1.0 / step:.6g} Hz, one row each"
        remedy = "resample, or state the rate" if period is None else "resample"
        if period is not None and (own := _own_rate(time, steps, period)):
            remedy = f"the clock of the file gives {own}; leave out the rate, or resample"
        check_values(on_grid, rows, error, rule, remedy)
    return step, tick - tick[0], error


def _fitted(time: Array, step: float) -> float:
    """Return the period by a line through the stamps, from an approximate one."""
    return float(np.polyfit(np.append(0.0, np.cumsum(np.rint(np.diff(time) / step))), time, 1)[0])


def _ticks(time: Array, step: float) -> tuple[Array, Array]:
    """Return the tick of each stamp, and its distance to it in periods."""
    tick = np.rint(time / step)
    offset = np.median(time - tick * step)
    tick = np.rint((time - offset) / step)
    return tick, np.abs(time - offset - tick * step) / step


def _own_rate(time: Array, steps: Array, period: float) -> str:
    """Return the rate on whose grid the stamps are, in words, if it is not the stated one; else empty."""
    own = _fitted(time, float(np.median(steps)))
    ppm = 1e6 * (period / own - 1.0)
    tick, error = _ticks(time, own)
    if abs(ppm) < _LEAST_PPM or error.max() > _OFF_GRID or (np.diff(tick) < 1.0).any():
        return ""
    return f"{1.0 / own:.9g} Hz, {ppm:+.4g} ppm from it"


def _check_missing(steps: Array, step: float, rows: NDArray[np.int64]) -> None:
    """Raise ParameterError if more samples are missing than there are, or a quarter of them in many gaps."""
    gaps = np.rint(steps / step) - 1.0
    missing, count = float(gaps.sum()), len(steps) + 1
    if missing <= (count if np.count_nonzero(gaps) <= _FEW_GAPS else _MOST_MISSING * count):
        return
    longest = int(np.argmax(gaps))
    got = f"got {missing:.0f} missing beside {count} at {1.0 / step:.6g} Hz, the median of the steps"
    if gaps[longest] > _ONE_GAP * missing:
        where = f"time jumps by {steps[longest]:.4g} s before row {rows[longest + 1]}"
        remedy = f"{where}: split the file there, or state the rate"
    else:
        mean = 1.0 / float(np.polyfit(np.arange(count), np.append(0.0, np.cumsum(steps)), 1)[0])
        given = f"give rate ({mean:.4g} Hz on average), without time if no sample is lost"
        remedy = f"stamps of bursts are those of arrival: {given}"
    raise ParameterError(f"time must be that of each sample ({got}): {remedy}")
