"""Recordings from tables of other programs: columns by name, stated units, checked time stamps."""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from decimal import Decimal
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
from maglev_mj.spec import GRAVITY
from maglev_mj.versions import versions

UNITS: Mapping[str, Mapping[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "length": {"m": 1.0, "mm": 1e-3, "um": 1e-6},
    "angle": {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180.0},
    "force": {"N": 1.0, "mN": 1e-3},
    "torque": {"Nm": 1.0, "mNm": 1e-3},
    "current": {"A": 1.0, "mA": 1e-3},
}
"""Factors to SI by quantity and unit."""

_GROUPS = {
    "position": dict(zip(AXES, ["length"] * 3 + ["angle"] * 3)),
    "command": {f"f{axis}": ("force", "torque")[index > 2] for index, axis in enumerate(AXES)},
    "hand": {f"h{axis}": ("force", "torque")[index > 2] for index, axis in enumerate(AXES)},
}
_ORDERS = {"quaternion": "xyzw:qx+qy+qz+qw", "euler": "ZYX:yaw+pitch+roll"}  # with an example
_QUANTITIES = {"time": "time", "quaternion": "", "euler": "angle"}
_QUANTITIES |= {key: quantity for group in _GROUPS.values() for key, quantity in group.items()}

_BLANK = {"", "nan", "null", "none", "na", "n/a"}
_LEAST_SAMPLES = 16
_OFF_GRID, _LONGEST_STEP, _ROUNDING = 0.25, 3.0, 1e-9  # in periods
_LARGEST_TURN, _NORM_ERROR = 1.0, 0.01
_LARGEST = 1e100  # with a finite square


class TextTable(NamedTuple):
    """Column names, words of each row, and number of each row in the file, from 1; see `read_table`."""

    names: Sequence[str]
    words: Sequence[Sequence[str]]
    rows: NDArray[np.int64]

    def values(self, name: str) -> Array:
        """Return a column as numbers, (N,), NaN for an empty cell; raise ParameterError for another word."""
        check_one_of("column", self.names, name)
        words = [row[self.names.index(name)].lower() for row in self.words]
        for row, word in zip(self.rows, words):
            if not _is_number(word):
                got = f"got {one_line(word)} in row {row}, column {one_line(name)}"
                raise ParameterError(f"values must be numbers below 1e100 ({got}): correct it, or leave the cell empty")
        return np.array([math.nan if word in _BLANK else float(word) for word in words])

    def stamps(self, name: str, factor: float) -> Array:
        """Return a column times a factor since its first row, (N,): exact for nanoseconds since 1970."""
        values = self.values(name)
        _check(np.isfinite(values), self.rows, values, "time must be known", "delete it, or give rate without time")
        stamps = [Decimal(row[self.names.index(name)]) for row in self.words]
        return np.array([float((stamp - stamps[0]) * Decimal(repr(factor))) for stamp in stamps])


def read_table(text: str) -> TextTable:
    """Split a table at tabs, semicolons (with decimal point or comma), commas or blanks.

    Lines that start with # are comments. Without a line of names, the columns are 1, 2, ...

    Raises:
        ParameterError: If there are no rows, a name repeats, or the rows have different lengths.
    """
    lines = [(row, line) for row, line in enumerate(text.splitlines(), 1) if line.strip() and line.lstrip()[0] != "#"]
    mark = next((mark for mark in "\t;," if lines and mark in lines[0][1]), None)
    cut = [next(csv.reader([line], delimiter=mark)) if mark else line.split() for _, line in lines]
    words = [[word.strip().replace(",", "." if mark == ";" else ",") for word in row] for row in cut]
    names = [str(index + 1) for index in range(len(words[0]))] if words else []
    if words and not all(map(_is_number, words[0])):
        names, words, lines = [name.strip() for name in cut[0]], words[1:], lines[1:]
    if not words:
        raise ParameterError("table must have rows of numbers (got none)")
    if repeated := [name for name, count in Counter(names).items() if count > 1]:
        raise ParameterError(f"column {one_line(repeated[0])} must be named once: rename the others")
    for (row, _), part in zip(lines, words):
        if len(part) != len(names):
            raise ParameterError(f"row {row} must have {len(names)} values, like the first row (got {len(part)})")
    return TextTable(names, words, np.array([row for row, _ in lines]))


def _check(valid: Mask, rows: NDArray[np.int64], values: Array, rule: str, remedy: str) -> None:
    """Raise ParameterError for the first value that is not valid."""
    if not valid.all():
        index = int(np.argmin(valid))
        raise ParameterError(f"{rule} (got {values[index]:.4g} in row {rows[index]}): {remedy}")


def _is_number(word: str) -> bool:
    try:
        return word.lower() in _BLANK or abs(float(word)) < _LARGEST
    except ValueError:
        return False


@checked
def import_table(
    path: Path | str,
    columns: Mapping[str, str],
    units: Mapping[str, str],
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
) -> Recording:
    """Return a recording of kind measured from a text table; see `read_table`.

    Args:
        path: The file.
        columns: Column of each value: time; x to rz, pose; fx to frz, wrench of the actuators; hx to hrz, wrench of
            the hand; i0, i1 and so on, currents of all coils. In place of rx, ry, rz: quaternion, such as
            "xyzw:qx+qy+qz+qw", or euler, such as "ZYX:yaw+pitch+roll", each about the axes turned by those before it.
        units: Unit of each quantity, see `UNITS`.
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

    Raises:
        ParameterError: If table, unit, time or rotation is invalid; one line with row and remedy.
    """

    def parsed(text: str) -> Recording:
        table = read_table(text)
        stamps, parts = _in_si(table, columns, units, scale or {}, coils)
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
        _check(turns <= _LARGEST_TURN, rows[1:], turns, rule, remedy)
        period, tick, error = uniform_ticks(time, rows, step, resample=resample)
        if off_grid := bool(error.max() > _OFF_GRID or (np.diff(tick) < 1.0).any()):
            path_of = Trajectory(time, parts["position"], "cubic")
            tick = np.arange(np.floor(time[-1] / period + _ROUNDING) + 1.0)
            before = np.searchsorted(time, (tick + _ROUNDING) * period, side="right") - 1
            inside = np.append(np.diff(time), 0.0)[before] <= _LONGEST_STEP * period  # not in a gap
            tick, parts = tick[inside], {name: part[before[inside]] for name, part in parts.items()}
            parts["position"] = np.array([path_of.at(at) for at in (tick * period).tolist()])
        if inertia is None and any(_QUANTITIES.get(key, "current") in ("torque", "current") for key in columns):
            raise ParameterError("inertia must be given for torques and currents [kg m²]")
        moments = np.broadcast_to(
            numbers("inertia", 1e-3 if inertia is None else inertia, shape="() or (3,)", above=0.0), 3
        )
        travel = np.ptp(parts["position"], axis=0)
        metadata = RunMetadata.of(
            Timing(period=period, delay=period if delay is None else delay),
            Controller([], period=period),
            name=Path(path).stem,
            axis=AXES[faces[0][0] if faces else int(np.argmax(travel[:3] if travel[:3].any() else travel))],
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
        setup |= {"parameters": {"resampled": off_grid, "delay_assumed": delay is None}}
        setup |= {"samples": len(tick), "controller": {}, "plant": {}, "versions": versions()}
        setup["run"] = replace(metadata, faces=[*faces]).as_json()
        note = f"import: {len(tick)} samples at {1.0 / period:.6g} Hz, {int(tick[-1]) + 1 - len(tick)} missing"
        note += f", time off its grid by up to {error.max():.2g} periods" * bool(error.max() > _ROUNDING)
        note += f"{', resampled' * off_grid}{'' if 'command' in parts else '; no wrench of the actuators'}"
        note += "; a delay of one period is assumed" * (delay is None)
        return Recording([Segment(setup=setup, arrays=arrays)], events=[note], event_samples=[len(tick)])

    return read_file("log", path, parsed)


_Words: TypeAlias = Mapping[str, str]


def _in_si(
    table: TextTable, columns: _Words, units: _Words, scale: Mapping[str, float], coils: CoilMap | None
) -> tuple[Array | None, dict[str, Array]]:
    """Return time [s], (N,), None without it, and the fields in use, (N, 6) each, zero for axes without a column."""
    currents = [f"i{index}" for index in range(len(coils or AXES))]
    quantities = _QUANTITIES | dict.fromkeys(currents, "current")
    for key in columns:
        check_one_of("columns", quantities, key)
    sources = {key: _orders_and_names(key, text) for key, text in columns.items()}
    used = {name: quantities[key] for key, (_, names) in sources.items() for name in names}
    for quantity, unit in units.items():
        check_one_of("quantity of units", UNITS, quantity)
        check_one_of(f"unit of {quantity}", UNITS[quantity], unit)
    for name in (*used, *scale):
        check_one_of("column", table.names, name)
    if without := {part: name for name, part in used.items() if part and part not in units and name not in scale}:
        proposed = " ".join(f"{quantity}={_unit_in(name, quantity)}" for quantity, name in without.items())
        names = ", ".join(map(one_line, without.values()))
        raise ParameterError(f"units must be stated for {names}: {proposed}; counts need a scale, SI units per count")
    factors = {name: UNITS[part][units[part]] if part in units else 1.0 for name, part in used.items()}
    factors |= {name: factors.get(name, 1.0) * number("scale", factor) for name, factor in scale.items()}
    time = table.stamps(columns["time"], factors[columns["time"]]) if "time" in columns else None
    read = {key: [table.values(name) * factors[name] for name in names] for key, (_, names) in sources.items()}
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
    return time, parts


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


def _unit_in(name: str, quantity: str) -> str:
    """Return the unit that ends the name of a column, such as time_ms or x [mm]; without one, the choices."""
    match = re.search(r"(?:^|[_ (\[])([A-Za-z]+)[)\]]?$", name)
    return match[1] if match and match[1] in UNITS[quantity] else "|".join(UNITS[quantity])


def _rotation(order: str, parts: Sequence[Array], rows: NDArray[np.int64]) -> Sequence[Array]:
    """Return the components of the rotation vectors [rad], (N,) each, of quaternions or Euler angles [rad]."""
    pose = np.zeros((len(rows), 6))
    for letter, angle in zip(order[::-1], parts[::-1]) if len(order) == 3 else ():
        pose = moved(pose, np.eye(6)[3 + "XYZ".index(letter)] * angle[:, None])
    w, x, y, z = quaternions(pose[:, 3:]) if len(order) == 3 else (parts[order.index(letter)] for letter in "wxyz")
    size = np.sqrt(w * w + x * x + y * y + z * z)
    _check(~(np.abs(size - 1.0) > _NORM_ERROR), rows, size, "quaternion must have norm 1", "check its columns")
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
        ParameterError: If time [s], (N,), of rows of a file does not increase, or is off its ticks without `resample`.
    """
    steps = np.diff(time)
    _check(steps >= 0.0, rows[1:], steps, "time must not go back", "split the file there")
    remedy = "use the device's clock, or give rate without time if each row is a sample"
    _check(steps > 0.0, rows[1:], steps, "time must increase", remedy)
    step = float(np.median(steps)) if period is None else period
    if period is None:
        step = float(np.polyfit(np.append(0.0, np.cumsum(np.rint(steps / step))), time, 1)[0])
    tick = np.rint(time / step)
    offset = np.median(time - tick * step)
    tick = np.rint((time - offset) / step)
    error = np.abs(time - offset - tick * step) / step
    if not resample:
        rule = f"time must be within {_OFF_GRID} periods of its tick at {1.0 / step:.6g} Hz, one row each"
        on_grid = (error <= _OFF_GRID) & (np.diff(tick, prepend=-math.inf) > 0.0)
        _check(on_grid, rows, error, rule, "resample, or give the rate")
    return step, tick - tick[0], error
