"""What a text table is taken for: tables of many programs, random dialects, and kinds of damage in all readers."""

from __future__ import annotations

import gzip
import math
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from maglev_mj import Recording
from maglev_mj.cli import main
from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Array
from maglev_mj.recording import import_table
from maglev_mj.recording.table import Log, read_log
from maglev_mj.recording.text_table import DECIMALS, SEPARATORS

COUNT, RATE = 200, 200.0
T = np.arange(COUNT) / RATE
X = 2e-3 * np.sin(20.0 * T) * np.exp(-T)


def rows(row: str, *, comma: bool = False, end: str = "\n", time: Array = T, x: Array = X) -> str:
    """Return a line for each sample, formatted with k, t [s] and x [m]; s(v, factor) scales."""
    made = [row.format(k=k, t=Scaled(t), x=Scaled(one)) for k, (t, one) in enumerate(zip(time.tolist(), x.tolist()))]
    return "".join((line.replace(".", ",") if comma else line) + end for line in made)


class Scaled(float):
    """Number whose format may end in the factor to a prefix: {t:ms.3f}."""

    def __format__(self, spec: str) -> str:
        factor = next((factor for prefix, factor in PREFIXES.items() if spec.startswith(prefix)), None)
        value = float(self) if factor is None else float(self) * factor
        spec = spec if factor is None else spec[2:]
        return f"{round(value)}" if spec == "d" else repr(value) if spec == "r" else format(value, spec)


PREFIXES = {"ms": 1e3, "us": 1e6, "ns": 1e9}
EPOCH = 1_700_000_000

LABVIEW = """LabVIEW Measurement\t
Writer_Version\t2
Separator\tTab
Decimal_Separator\t{mark}
X_Columns\tOne
Date\t2026/11/28
Time\t12:00:00{mark}1234567
***End_of_Header***\t

Channels\t1\t
Samples\t200\t
X_Dimension\tTime\t
X0\t0{mark}0000000000000000E+0\t
Delta_X\t0{mark}005000\t
***End_of_Header***\t\t
X_Value\tPosition [mm]\tComment
"""
TEKTRONIX = """Model,MSO24
Firmware Version,1.36.0

Point Format,Y
Horizontal Units,s
Sample Interval,0.005
Record Length,200

Labels,,
TIME,CH1
"""
CAMPBELL = """"TOA5","CR1000","CR1000","1234","CR1000.Std.32","CPU:rig.CR1","5678","Table1"
"TIMESTAMP","RECORD","Position"
"TS","RN","mm"
"","","Smp"
"""
ROS = "%time,field.header.seq,field.header.stamp,field.pose.position.x,field.pose.position.z,field.pose.orientation.x\n"

TABLES: dict[str, tuple[str | bytes, str]] = {
    "labview.lvm": (
        LABVIEW.format(mark=".") + rows("{t:.6f}\t{x:ms.6f}\n", end=""),
        "tabs and decimal point, 15 lines skipped, time in s, length in mm, 200 Hz, 0 of 200 missing, by name: "
        "time = X_Value, z = Position [mm]",
    ),
    "labview_de.lvm": (
        LABVIEW.format(mark=",") + rows("{t:.6f}\t{x:ms.6f}", comma=True),
        "tabs and decimal comma, 15 lines skipped, time in s",
    ),
    "excel_de.csv": (
        ("Zeit in ms;Weg in µm;Kraft in N\r\n" + rows("{t:ms.1f};{x:us.3f};0.5", comma=True, end="\r\n")).encode(
            "latin-1"
        ),
        "Latin-1, ; and decimal comma, time in ms, length in um, 200 Hz, 0 of 200 missing, by name: time = Zeit in ms, "
        "z = Weg in µm",
    ),
    "excel_sep.csv": (
        ("\ufeffsep=;\r\nt [s];x [mm]\r\n" + rows('"{t:.3f}";"{x:ms.6f}"', comma=True, end="\r\n")).encode(),
        "; and decimal comma, 1 line skipped, time in s, length in mm",
    ),
    "excel_unicode.txt": (
        ("\ufefftime [ms]\tposition [mm]\r\n" + rows("{t:ms.0f}\t{x:ms.6f}", end="\r\n")).encode("utf-16-le"),
        "UTF-16, tabs and decimal point, time in ms, length in mm",
    ),
    "excel_thousands.csv": (
        "t;x\n"
        + "".join(
            f"{t:.3f}".replace(".", ",") + f";{one:,}\n".replace(",", ".") for t, one in zip(T, range(900, 1100))
        ),
        "error: decimal mark must be one, point or comma (got '0,000' in row 2, column 't' and '1.000' in row 102, "
        "column 'x'): export without grouping of thousands, or give decimal",
    ),
    "excel_counts.csv": (
        "ms;counts\n" + "".join(f"{5 * k};{one:,}\n".replace(",", ".") for k, one in enumerate(range(900, 1100))),
        "error: decimal mark must not be one that may group thousands (got '1.000' in row 102, column 'counts')",
    ),
    "excel_comma.csv": (
        "t,x\n" + rows("{t:.3f},{x:ms.6f}", comma=True),
        "error: names must be as many as the 4 values of row 2 (got 2 in row 1): a comma cannot be separator and "
        "decimal mark",
    ),
    "excel_quoted.csv": (
        "t [s],x [mm]\n"
        + "".join(f'"{line}"\n'.replace(";", '","') for line in rows("{t:.3f};{x:ms.6f}", comma=True).split()),
        "commas and decimal comma, time in s, length in mm",
    ),
    "serial_plotter.txt": (
        "Ready\r\n" + rows("t_ms:{t:ms.0f},x_um:{x:us.3f}", end="\r\n"),
        "commas and decimal point, 1 line skipped, names in each row, time in ms, length in um",
    ),
    "arduino.txt": (
        "micros,z_mm\r\n" + "".join(f"{(2**32 - 20000 + 5000 * k) % 2**32},{1e3 * x:.6f}\r\n" for k, x in enumerate(X)),
        "commas and decimal point, time in us, 32-bit stamps unwrapped 1 time, length in mm, 200 Hz, 0 of 200 missing",
    ),
    "plotjuggler.csv": (
        '"__time","/rig/pose/position/x","/rig/pose/position/z","/target/position/z"\n'
        + rows("{t:.6f},0.0,{x:.9f},0.1", time=EPOCH + T),
        "commas and decimal point, time in s since 1970, length in m (assumed), 200 Hz, 0 of 200 missing, by name: "
        "time = __time, x = /rig/pose/position/x, z = /rig/pose/position/z",
    ),
    "writematrix.csv": (
        rows("{t:.15g},{x:.15g}"),
        "commas and decimal point, no names, time in s (assumed), length in m",
    ),
    "writetable.txt": (
        "Time_s,Position_mm,Mode\n" + rows("{t:.15g},{x:ms.15g},'hold'"),
        "commas and decimal point, time in s, length in mm",
    ),
    "octave.txt": (
        "% time (s)   position (m)\n" + rows("   {t:.4f}   {x:.9f}"),
        "blanks and decimal point, time in s, length in m, 200 Hz, 0 of 200 missing, by name: time = time (s), "
        "z = position (m)",
    ),
    "rostopic.csv": (
        ROS
        + "".join(f"{EPOCH * 10**9 + 5_000_000 * k},{k},{EPOCH * 10**9},0.0,{x:.9f},0.0\n" for k, x in enumerate(X)),
        "commas and decimal point, time in ns since 1970, length in m (assumed), 200 Hz, 0 of 200 missing, by name: "
        "time = time, x = field.pose.position.x, z = field.pose.position.z",
    ),
    "tektronix.csv": (
        TEKTRONIX + rows("{t:.6e},{x:.8e}", time=T - 0.5),
        "commas and decimal point, 9 lines skipped, time in s (ass",
    ),
    "rigol.csv": (
        "X,CH1,Start,Increment,\nSequence,Volt,-5.0e-01,5.0e-03\n" + rows("{k},{x:.2e},,"),
        "error: columns must include time, or rate must be given if each row is a sample",
    ),
    "keysight.csv": (
        "x-axis,1\nsecond,Volt\n" + rows("{t:+.6E},{x:+.6E}"),
        "error: units must be stated for '1' in Volt: length=m|cm|mm|um|nm; counts need a scale, SI units per count",
    ),
    "candump.log": (
        rows("({t:.6f}) can0 123#{k:08X}", time=EPOCH + T),
        "error: table must have rows of numbers (got none in 200 lines, the last '(1700000000.995000) can0 123#000000",
    ),
    "pandas.csv": (
        ",t,x\n" + rows("{k},{t:r},{x:r}"),
        "commas and decimal point, time in s (assumed), length in m (assumed), 200",
    ),
    "pandas_numbers.csv": (
        ",0,1\n" + rows("{k},{t:r},{x:r}"),
        "error: columns must be given, such as z=NAME: no pose among 1, 2, 3",
    ),
    "pandas_dates.csv": (
        "time,x_mm\n"
        + "".join(f"2026-11-28 23:59:59.{5 * k:03d}000+01:00,{1e3 * x!r}\n" for k, x in enumerate(X.tolist())),
        "commas and decimal point, time in s of a clock, length in mm, 200 Hz, 0 of 200 missing",
    ),
    "origin.txt": (
        "Time\tPosition\ns\tmm\nrun 3\tlaser\n" + rows("{t:.5f}\t{x:ms.6f}"),
        "tabs and decimal point, 1 line skipped, row of units, time in s, length in mm",
    ),
    "saleae.csv": (
        "Time [s],Channel 0\n" + rows("{t:.9f},{x:.9f}"),
        "commas and decimal point, time in s, length in m (assumed)",
    ),
    "ni_daq.csv": (
        "Date/Time,Dev1/ai0 (V)\n" + rows("11/28/2026 12:00:00 PM,{x:.6f}"),
        "error: time must be a number, or as in 2026-11-28 12:00:00.005 (got '11/28/2026 12:00:00 PM' in row 2",
    ),
    "campbell.dat": (
        CAMPBELL + "".join(f'"2026-11-28 12:00:00.{5 * k:03d}",{k},{1e3 * x:.6f}\n' for k, x in enumerate(X)),
        "commas and decimal point, 2 lines skipped, row of units, time in s of a clock, length in mm",
    ),
    "savetxt.txt": ("# t, x\n" + rows("{t:.18e} {x:.18e}"), "blanks and decimal point, time in s (assumed)"),
    "rig.csv.gz": (
        gzip.compress(("t_ms,z_um\n" + rows("{t:ms.0f},{x:us.3f}")).encode()),
        "gzip, commas and decimal point, time in ms, length in um",
    ),
    "dump.psv": ("t [s]|x [mm]\n" + rows("{t:.4f}|{x:ms.6f}"), "| and decimal point, time in s, length in mm"),
    "bursts.csv": (
        "t,x\n" + "".join(f"{0.04 * (k // 8) + 1e-5 * (k % 8):.6f},{x:.6f}\n" for k, x in enumerate(X)),
        "error: time must be that of each sample (got 95808 missing beside 200 at 100000 Hz, the median of the steps): "
        "stamps of bursts are those of arrival: give rate, 200.3 Hz on average, and columns without time",
    ),
    "set_clock.csv": (
        "t,x\n" + rows("{t:.3f},{x:.6f}", time=T + 3600.0 * (T > 0.5)),
        "error: time must be that of each sample (got 720000 missing beside 200 at 200 Hz, the median of the steps): "
        "time jumps by 3600 s before row 103: split the file there, or state the rate",
    ),
    "killed.csv": (
        ("t,x\n" + rows("{t:.6e},{x:.6e}"))[:-5],
        "commas and decimal point, last line without its end left out (row 201, '6.415767')",
    ),
    "powercut.csv": (
        ("t,x\n" + rows("{t:.6e},{x:.6e}")).encode()[:-20] + bytes(512),
        "its end is lost, commas and decimal point, last line without its end left out (row 201, '9.9500')",
    ),
    "book.xlsx": (
        b"PK\x03\x04" + bytes(100),
        "error: file must be a text table (got an Excel, ZIP, MATLAB or database file)",
    ),
}


@pytest.mark.parametrize("name", TABLES)
def test_tables_of_programs_are_read_or_refused_in_words(name: str, tmp_path: Path) -> None:
    content, line = TABLES[name]
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    if line.startswith("error: "):
        with pytest.raises(ParameterError, match=re.escape(line[7:])):
            read_log(tmp_path / name, si=True)
        return
    log = read_log(tmp_path / name, si=True)
    assert log.taken.startswith(f"{name}: {line}")
    assert log.tick.tolist() == [*range(COUNT - ("left out" in line))] and log.period == pytest.approx(1.0 / RATE)
    np.testing.assert_allclose(log.parts["position"][:, log.axis], X[: len(log.tick)], rtol=0.0, atol=6e-10)


class Dialect(NamedTuple):
    """How a table is written."""

    encoding: str
    zipped: bool
    separator: str
    decimal: str
    end: str
    names: str
    units: str
    before: int
    time_unit: str
    unit: str
    axis: str
    spare: bool

    @property
    def mark(self) -> str:
        return SEPARATORS[self.separator]


NAMES = {"plain": "{}", "comment": "# {}", "percent": "% {}", "quoted": "{}", "none": ""}
FACTORS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "m": 1.0, "mm": 1e-3, "um": 1e-6, "rad": 1.0, "mrad": 1e-3}
FACTORS |= {"deg": math.pi / 180.0}


def dialects(seed: int, count: int) -> Iterator[Dialect]:
    """Yield random dialects of which a reader can tell all parts."""
    rng = np.random.default_rng(seed)
    pick: Callable[..., Any] = lambda *choices: choices[int(rng.integers(len(choices)))]  # noqa: E731
    while count:
        axis = pick(*AXES)
        one = Dialect(
            encoding=pick("utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "latin-1"),
            zipped=pick(False, False, True),
            separator=pick(*SEPARATORS),
            decimal=pick(*DECIMALS),
            end=pick("\n", "\r\n", "\r"),
            names=pick(*NAMES),
            units=pick("brackets", "in", "suffix", "row", "stated"),
            before=pick(0, 1, 3, 12),
            time_unit=pick("s", "ms", "us", "ns"),
            unit=pick("rad", "mrad", "deg") if len(axis) == 2 else pick("m", "mm", "um"),
            axis=axis,
            spare=pick(False, True),
        )
        if one.separator == "comma" == one.decimal and one.names != "quoted":
            continue
        if one.names == "none" and one.units != "stated":
            continue
        count -= 1
        yield one


def written(one: Dialect, rng: np.random.Generator, count: int = 40) -> tuple[bytes, Array, Array]:
    """Return a table, the ticks of its rows and its positions: some rows are missing."""
    kept = np.sort(rng.choice(np.arange(1, count), count - 4, replace=False))
    ticks = np.append(0, kept)
    values = np.cumsum(rng.uniform(-1.0, 1.0, len(ticks))) * 0.05
    style = {"brackets": "{} [{}]", "in": "{} in {}", "suffix": "{}_{}"}.get(one.units, "{}")
    names = [style.format("time", one.time_unit), style.format(one.axis, one.unit)]
    cells = [[f"{0.005 * t / FACTORS[one.time_unit]:.6f}" for t in ticks]]
    cells += [[f"{value / FACTORS[one.unit]:.9f}" for value in values.tolist()]]
    if one.spare:  # a column of counts between them
        names, cells = [names[0], "count", names[1]], [cells[0], [str(int(tick)) for tick in ticks], cells[1]]
    table = [[word.replace(".", DECIMALS[one.decimal]) for word in row] for row in zip(*cells)]
    units = [[{"time": one.time_unit, one.axis: one.unit}.get(name, "-") for name in names]] * (one.units == "row")
    quote = '"{}"' if one.names == "quoted" and one.separator != "blank" else "{}"
    if one.separator == "blank" and one.units == "in":
        names = [name.replace(" in ", "_") for name in names]
    lines = [one.mark.join(map(quote.format, row)) for row in (*[names] * (one.names != "none"), *units, *table)]
    if one.names in ("comment", "percent"):
        lines[0] = NAMES[one.names].format(lines[0])
    head = ["Rig 3 of the laboratory", "Sample interval" + one.mark + "5", "", "Operator" + one.mark + "µ"] * 3
    data = one.end.join([*head[: one.before][::-1], *lines, ""]).encode(one.encoding)
    return gzip.compress(data) if one.zipped else data, ticks.astype(np.float64), values


def by_name(path: Path, one: Dialect) -> Array:
    units = {"time": one.time_unit, "angle" if len(one.axis) == 2 else "length": one.unit}
    return as_rows(read_log(path, None, units if one.units == "stated" else None))


def by_column(path: Path, one: Dialect) -> Array:
    columns = {"time": "1", one.axis: "3" if one.spare else "2"}
    units = {"time": one.time_unit, "angle" if len(one.axis) == 2 else "length": one.unit}
    segment = import_table(path, columns, units, mass=0.3).segments[0]
    return np.column_stack([segment.tick, segment.time, segment.position])


def by_command(path: Path, one: Dialect) -> Array:
    units = [f"time={one.time_unit}", f"{'angle' if len(one.axis) == 2 else 'length'}={one.unit}"]
    columns = ["time=1", f"{one.axis}={'3' if one.spare else '2'}"]
    out = path.with_name("out.maglev")
    assert not main(["import", str(path), "--columns", *columns, "--units", *units, "--mass", "0.3", "--out", str(out)])
    segment = Recording.load(out).segments[0]
    return np.column_stack([segment.tick, segment.time, segment.position])


def as_rows(log: Log) -> Array:
    return np.column_stack([log.tick, log.tick * log.period, log.parts["position"]])


READERS = {"by name": by_name, "by column": by_column, "command": by_command}


@pytest.mark.parametrize("reader", READERS)
def test_a_table_in_any_dialect_reads_back_equal(reader: str, tmp_path: Path) -> None:
    for index, one in enumerate(dialects(66, 20 if reader == "command" else 120)):
        if reader == "by name" and one.names == "none":
            continue
        data, ticks, values = written(one, np.random.default_rng(index))
        (tmp_path / "rig.csv").write_bytes(data)
        found = READERS[reader](tmp_path / "rig.csv", one)
        wanted = np.zeros((len(ticks), 6))
        wanted[:, AXES.index(one.axis)] = values
        assert found[:, 0].tolist() == ticks.tolist(), one
        np.testing.assert_allclose(found[:, 1], 0.005 * ticks, rtol=1e-9, err_msg=str(one))
        np.testing.assert_allclose(found[:, 2:], wanted, rtol=0.0, atol=1e-9, err_msg=str(one))
