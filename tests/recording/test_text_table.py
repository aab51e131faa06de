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
from maglev_mj.recording.text_table import DECIMALS, SEPARATORS, TableFormat, base_and_unit
from maglev_mj.studies.oscillation import read_oscillation

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
        "stamps of bursts are those of arrival: give rate (200.3 Hz on average), without time if no sample is lost",
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
    "trailing.csv": (
        "t [s],x [mm]\n" + rows("{t:.3f},{x:ms.6f},"),
        "commas and decimal point, time in s, length in mm, 200 Hz, 0 of 200 missing, by name: time",
    ),
    "unused.csv": (
        "t,x,z\n" + rows("{t:.3f},,{x:.9f}"),
        "commas and decimal point, time in s (assumed), length in m (assumed), 200 Hz, 0 of 200 missing, by name: "
        "time = t, z = z",
    ),
    "general.csv": (  # the time shows that the comma is the decimal mark of the gains, too
        "t;z;gain\n"
        + "".join(
            f"{0.005 * k:.3f};{x:.9f};{7 if k < 50 else 1.5:{'' if k < 50 else '.3f'}}\n" for k, x in enumerate(X)
        ).replace(".", ","),
        "; and decimal comma, time in s (assumed)",
    ),
    "millions.csv": (
        "ms;z\n" + "".join(f"{5 * k};{one:,}\n".replace(",", ".") for k, one in enumerate(range(999_900, 1_000_100))),
        "error: decimal mark must not be one that may group thousands (got '1.000.000' in row 102, column 'z')",
    ),
    "half_a_letter.csv": (
        ("ms,z_mm,unit\n" + rows("{t:ms.0f},{x:ms.6f},µ")).encode()[:-2],
        "its end is lost, commas and decimal point, last line without its end left out (row 201, '')",
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


def test_the_page_lists_lines_as_printed(tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs" / "howto" / "use_measurements.md").read_text(encoding="utf-8")
    lines = re.findall(r"^\| (\w+\.[\w.]+) \| `(.+)` \|$", page, re.MULTILINE)
    assert len(lines) == 10
    for name, line in lines:
        content, _ = TABLES[name]
        (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
        assert read_log(tmp_path / name, si=True).taken.startswith(f"{name}: {line}")


@pytest.mark.parametrize("name", TABLES)
def test_a_damaged_table_is_read_or_refused_in_a_line(name: str, tmp_path: Path) -> None:
    content = TABLES[name][0]
    data = (content if isinstance(content, bytes) else content.encode())[:3000]
    rng = np.random.default_rng(len(data))
    parts = [
        b"",
        b",",
        b";",
        b"\t",
        b"\n",
        b'"',
        bytes(2),
        b"#",
        b"\xff",
        b"x:1",
        b"sep=;\n",
        b"2026-13-45 25:61:99,1\n",
    ]
    for part in parts:
        start, end = np.sort(rng.integers(0, len(data) + 1, 2)).tolist()
        end = start + (end - start) % 20
        (tmp_path / name).write_bytes(data[:start] + part + data[end:])
        try:
            log = read_log(tmp_path / name, si=True)
        except ParameterError as error:
            assert str(error).count("\n") == 0 and str(error).startswith("log ")
        else:
            assert log.taken.count("\n") == 0 and len(log.tick) <= log.tick[-1] + 1


REMEDIES: dict[str, dict[str, Any]] = {
    "excel_counts.csv": {"decimal": "comma", "columns": {"time": "ms", "z": "counts"}, "scale": {"counts": 1e-6}},
    "rigol.csv": {"columns": {"z": "CH1"}, "scale": {"CH1": 1.0}, "rate": RATE},
    "keysight.csv": {"columns": {"time": "x-axis", "z": "1"}, "scale": {"1": 1.0}},
    "pandas_numbers.csv": {"columns": {"time": "2", "z": "3"}},
    "ni_daq.csv": {"columns": {"z": "2"}, "scale": {"2": 1.0}, "rate": RATE},
    "bursts.csv": {"columns": {"z": "x"}, "rate": RATE},
    "set_clock.csv": {"rate": RATE},
}


@pytest.mark.parametrize("name", REMEDIES)
def test_a_refused_table_is_read_by_the_remedy(name: str, tmp_path: Path) -> None:
    content, line = TABLES[name]
    assert line.startswith("error: ") and isinstance(content, str)
    missing = 7 if name == "keysight.csv" else COUNT  # a value that its instrument marks as none
    lines = content.splitlines()
    lines[2 + 7 : 3 + 7] = [lines[2 + 7].split(",")[0] + ",+9.91E+37"] if missing == 7 else lines[2 + 7 : 3 + 7]
    (tmp_path / name).write_text("\n".join([*lines, ""]))
    units = {"time": "ms"} if name == "excel_counts.csv" else {"time": "s", "length": "m"}
    units = {} if name == "keysight.csv" else units
    segment = import_table(tmp_path / name, **{"columns": None, "units": units, "mass": 0.3} | REMEDIES[name]).segments[
        0
    ]
    kept = np.delete(np.arange(COUNT), [missing] if missing < COUNT else [])
    wanted = 1e-6 * np.arange(900, 1100) if name == "excel_counts.csv" else X[kept]
    assert segment.tick.tolist() == [k + (720_000 if name == "set_clock.csv" and k > 100 else 0) for k in kept]
    np.testing.assert_allclose(segment.position[:, segment.position.any(axis=0).argmax()], wanted, atol=6e-6)


UNITS_OF_NAMES = {
    "x [mm]": ("x", "mm"), "x (mm)": ("x", "mm"), "x in mm": ("x", "mm"), "x/mm": ("x", "mm"), "x_mm": ("x", "mm"),
    "t µs": ("t", "us"), "t [μs]": ("t", "us"), "Winkel [°]": ("Winkel", "deg"), "angle (degrees)": ("angle", "deg"),
    "F in N": ("F", "N"), "F/N": ("F", "N"), "F_N": ("F_N", ""), "phase_A": ("phase_A", ""), "M [N·m]": ("M", "Nm"),
    "ms": ("ms", "ms"), "millis": ("millis", "ms"), "m": ("m", ""), "/rig/m": ("/rig/m", ""), "u [V]": ("u", "V"),
    "position.x": ("position.x", ""), "M (N m)": ("M", "Nm"),
    "time since start (of the run)": ("time since start (of the run)", ""),
}  # fmt: skip


def test_units_of_names() -> None:
    assert {name: base_and_unit(name) for name in UNITS_OF_NAMES} == UNITS_OF_NAMES


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
    assert not main(["convert", str(path), str(out), "--columns", *columns, "--units", *units, "--mass", "0.3"])
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


def for_diagnosis(path: Path, **options: Any) -> Array:
    return as_rows(read_log(path, si=True, **options))


def imported(path: Path, columns: dict[str, str] | None = None, **options: Any) -> Array:
    units = {"time": "s", "length": "m"} | options.pop("units", {})
    segment = import_table(path, columns, units, mass=0.3, **options).segments[0]
    return np.column_stack([segment.tick, segment.time, segment.position])


ENTRANCES: dict[str, Callable[..., Array]] = {
    "diagnose": for_diagnosis,
    "import by name": imported,
    "import by column": lambda path, **options: imported(path, {"time": "1", "z": "2"}, **options),
}
entrances = pytest.mark.parametrize("entrance", ENTRANCES.values(), ids=ENTRANCES)
FORMS = ["{:.6e}", "{:.6f}", "{:.9g}", "{!r}"]


@entrances
@pytest.mark.parametrize("form", FORMS)
def test_no_part_of_a_cut_last_line_is_a_sample(entrance: Callable[..., Array], form: str, tmp_path: Path) -> None:
    values = [2e-3 * math.sin(0.3 * k) for k in range(30)]
    lines = [f"{0.005 * k:.3f},{form.format(value)}" for k, value in enumerate(values)]
    for mark, endings in ((",", (b"", bytes(700))), (";", (b"",))):
        text = "\n".join(["t,z", *lines]).replace(",", mark).encode()
        for cut in range(len(lines[-1]) + 1):
            (tmp_path / "rig.csv").write_bytes(text[: len(text) - cut] + endings[cut % len(endings)])
            z = entrance(tmp_path / "rig.csv")[:, 4]
            assert len(z) == 29 or (len(z) == 30 and cut == 0)
            np.testing.assert_allclose(z, values[: len(z)], atol=1e-6)


@entrances
@pytest.mark.parametrize("ending", ["counts", "gzip", "utf-16"])
def test_a_cut_last_line_is_named_in_other_files(entrance: Callable[..., Array], ending: str, tmp_path: Path) -> None:
    lines = [f"{0.005 * k:.3f}\t{round(1e3 * math.sin(0.3 * k))}" for k in range(400)]
    text = "\n".join(["t\tz", *lines]) + "\n" * (ending != "counts")
    for cut in range(1, 60, 7):
        data = text.encode("utf-16" if ending == "utf-16" else "utf-8")
        data = gzip.compress(data, mtime=0)[:-cut] if ending == "gzip" else data[:-cut]
        (tmp_path / "rig.csv").write_bytes(data)
        found = entrance(tmp_path / "rig.csv")
        assert 300 < len(found) <= 400
        assert found[:, 4].tolist() == [round(1e3 * math.sin(0.3 * k)) for k in range(len(found))]
        line = read_log(tmp_path / "rig.csv", si=True).taken
        whole = text.encode()[: len(data)].endswith(b"\n") if ending == "counts" else "its end is lost" in line
        assert whole or "last line without its end left out (row " in line, line


@entrances
@pytest.mark.parametrize("separator", ["tab", "semicolon", "blank", "bar"])
@pytest.mark.parametrize("decimal", DECIMALS)
def test_two_decimal_marks_are_refused_and_a_stated_one_reads_them(
    entrance: Callable[..., Array], separator: str, decimal: str, tmp_path: Path
) -> None:
    counts = [round(3000.0 * math.sin(0.05 * k)) for k in range(200)]
    lines = [f"{0.005 * k:.3f}{SEPARATORS[separator]}{count:,}" for k, count in enumerate(counts)]
    text = "\n".join([f"t{SEPARATORS[separator]}z", *lines, ""])
    if decimal == "comma":
        text = text.translate({ord(","): ".", ord("."): ","})
    (tmp_path / "rig.csv").write_text(text)
    with pytest.raises(ParameterError, match=r"decimal mark must be one, point or comma .got '0.000' in row 2"):
        entrance(tmp_path / "rig.csv")
    forms: Callable[[str], Any] = lambda mark: (  # noqa: E731
        {"form": TableFormat(decimal=mark)} if entrance is for_diagnosis else {"decimal": mark}
    )
    found = entrance(tmp_path / "rig.csv", units={"length": "mm"}, **forms(decimal))
    assert found[:, 4].tolist() == [1e-3 * count for count in counts]
    other = next(name for name in DECIMALS if name != decimal)
    with pytest.raises(ParameterError, match=f"numbers must have a decimal {other} .got '0.000' in row 2, column 't'"):
        entrance(tmp_path / "rig.csv", **forms(other))


@entrances
@pytest.mark.parametrize("burst", [2, 3, 8, 20])
@pytest.mark.parametrize("spacing", [1e-5, 2e-4, 2.5e-3])
def test_stamps_of_bursts_are_refused_and_a_rate_without_time_reads_them(
    entrance: Callable[..., Array], burst: int, spacing: float, tmp_path: Path
) -> None:
    k = np.arange(400)
    stamps = burst / RATE * (k // burst) + spacing * (k % burst)
    write(tmp_path / "rig.csv", stamps, 1e-3 * np.sin(0.04 * k))
    for options in ({}, {"resample": True}):
        with pytest.raises(
            ParameterError, match=r"time must be (that of each sample .*rate .20\d.*without time|within)"
        ):
            entrance(tmp_path / "rig.csv", **options)
    found = imported(tmp_path / "rig.csv", {"z": "2"}, rate=RATE)
    assert found[:, 0].tolist() == k.tolist()


@entrances
@pytest.mark.parametrize(
    ("step", "reason"), [(3600.0, "time jumps by 3600 s before row 102"), (-1.0, "must not go back")]
)
def test_a_clock_that_was_set_is_refused(
    entrance: Callable[..., Array], step: float, reason: str, tmp_path: Path
) -> None:
    k = np.arange(200)
    write(tmp_path / "rig.csv", 0.005 * k + step * (k >= 100), 1e-3 * np.sin(0.04 * k))
    with pytest.raises(ParameterError, match=reason):
        entrance(tmp_path / "rig.csv")
    if step > 0.0:  # a stated rate says that the gap is one
        assert entrance(tmp_path / "rig.csv", rate=RATE)[-1, 0] == 199 + 3600 * RATE


def write(path: Path, time: Any, z: Any, form: str = "%.6f") -> None:
    np.savetxt(path, np.column_stack([time, z]), delimiter=",", header="t,z", comments="", fmt=(form, "%.9f"))


@entrances
@pytest.mark.parametrize(("unit", "factor"), [("us", 1.0), ("ms", 1e-3), ("s", 1e-6)])
@pytest.mark.parametrize("signed", [False, True])
def test_wraps_of_a_32_bit_counter_are_undone(
    entrance: Callable[..., Array], unit: str, factor: float, signed: bool, tmp_path: Path
) -> None:
    k = np.concatenate([np.arange(60), np.arange(64, 260_000, 400), 260_000 + np.arange(60)])  # gaps below a wrap
    k = k if unit == "us" else np.arange(260)
    counter = (2**32 - 100_000 + 20_000 * k) % 2**32 - 2**31 * signed
    write(tmp_path / "rig.csv", counter * factor, 1e-3 * np.sin(0.04 * k), f"%.{6 * (factor < 1.0)}f")
    options: dict[str, Any] = {"units": {"time": unit}, "rate": 50.0}
    found = entrance(tmp_path / "rig.csv", **options)
    assert found[:, 0].tolist() == k.tolist()
    assert "32-bit stamps unwrapped" in read_log(tmp_path / "rig.csv", si=True, **options).taken


@entrances
@pytest.mark.parametrize("ppm", [100.0, -300.0, 5000.0])
def test_a_clock_off_the_stated_rate_is_named(entrance: Callable[..., Array], ppm: float, tmp_path: Path) -> None:
    k = np.arange(6000)
    write(tmp_path / "rig.csv", 1e-3 * k / (1.0 + 1e-6 * ppm), 1e-3 * np.sin(0.04 * k), "%.9f")
    rate = f"{1000.0 * (1.0 + 1e-6 * ppm):g}"
    with pytest.raises(
        ParameterError, match=rf"clock of the file gives {rate}\S* Hz, \{ppm:+.0f}.* ppm from it; leave"
    ):
        entrance(tmp_path / "rig.csv", rate=1000.0)
    assert entrance(tmp_path / "rig.csv")[:, 0].tolist() == k.tolist()


CONTRADICTIONS: dict[str, tuple[str, dict[str, Any], str]] = {
    "separator": (
        "t,z\n",
        {"separator": "semicolon"},
        "rows of numbers .got none in 41 lines with separator semicolon",
    ),
    "decimal": (
        "t,z\n",
        {"decimal": "comma"},
        "rows of numbers .got none in 41 lines with decimal comma|names must be",
    ),
    "both": ("t,z\n", {"decimal": "comma", "separator": "comma"}, "separator and decimal must differ"),
    "skip": ("t,z\n", {"skip": 99}, "rows of numbers .got none with skip 99"),
    "before": ("t,z\n", {"skip": -1}, "skip must be at least 0 lines"),
    "encoding": ("t,µ\n", {"encoding": "utf-8"}, "file must be in utf-8 .got another byte at 2"),
    "choice": ("t,z\n", {"encoding": "ebcdic"}, "encoding must be one of utf-8, utf-16, latin-1"),
    "names": ("t,z\n", {"names": ["t", "x", "z"]}, "names must be one for each of 2 columns .got 3"),
    "number of names": ("t,z,x\n", {}, "names must be as many as the 2 values of row 2 .got 3 in row 1"),
    "two units": ("t_ms,z\ns,mm\n", {}, "unit of 't_ms' must be that of the row of units .got s"),
    "unit": ("t,z [N]\n", {"columns": {"time": "1", "z": "2"}}, "column '2' must be a length .got N in the file"),
    "angle": ("t,a [deg]\n", {"columns": {"time": "1", "z": "2"}}, "must be a length .got deg in the file.: .* is rx"),
    "rate": ("t,z\n", {"scale": {"t": 1000.0}}, "rate must be 10 Hz to 1 MHz .got 0.2 Hz"),
    "two times": ("time,stamp\n", {}, "time must be one column .got 'time' or 'stamp'"),
}


@pytest.mark.parametrize("name", CONTRADICTIONS)
def test_a_guess_that_the_file_contradicts_is_an_error(name: str, tmp_path: Path) -> None:
    head, options, message = CONTRADICTIONS[name]
    text = head + "".join(f"{0.005 * k:.3f},{1e-3 * math.sin(k):.6f}\n" for k in range(40))
    (tmp_path / "rig.csv").write_bytes(text.encode("latin-1"))
    units = {"time": "s", "length": "m"} if "columns" not in options and "two" not in name else None
    with pytest.raises(ParameterError, match=message):
        import_table(tmp_path / "rig.csv", **{"units": units, "mass": 0.3} | options)


OVERRIDES: dict[str, tuple[str, dict[str, Any]]] = {
    "separator": ("1;2,t,3;4,z\n", {"separator": "comma", "names": ["t", "z"]}),
    "skip": ("a,b\n1,2\n3,4\n", {"skip": 3, "names": ["t", "z"]}),
    "names": ("z,t\n", {"names": ["t", "z"]}),
    "encoding": ("time µ,weg µ\n", {"encoding": "latin-1", "columns": {"time": "time µ", "z": "weg µ"}}),
    "columns": ("z,t\n", {"columns": {"time": "z", "z": "t"}}),
    "units": ("t [ms],z [nm]\n", {}),
}


@pytest.mark.parametrize("name", OVERRIDES)
def test_options_override_what_the_file_says(name: str, tmp_path: Path) -> None:
    head, options = OVERRIDES[name]
    text = head + "".join(f"{0.005 * k:.3f},{1e-3 * k:.6f}\n" for k in range(40))
    (tmp_path / "rig.csv").write_bytes(text.encode("latin-1"))
    recording = import_table(tmp_path / "rig.csv", units={"time": "s", "length": "m"}, mass=0.3, **options)
    assert recording.segments[0].position[:, 2].tolist() == [round(1e-3 * k, 6) for k in range(40)]


@pytest.mark.parametrize("rotary", [True, False])
def test_diagnose_chooses_by_name_and_says_what_the_table_was_taken_for(
    rotary: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    t = 0.002 * np.arange(180)  # too few cycles for gains, which take seconds at such a delay
    head, scale = ("force [N];time in ms;position_deg;mode", 20.0) if rotary else ("f;ms;z_mm;u", 1.0)
    ring = scale * np.exp(-2.0 * t) * np.cos(60.0 * t)
    lines = [f"0,5;{1e3 * a:.1f};{b:.6f};hold".replace(".", ",") for a, b in zip(t, ring)]
    (tmp_path / "rig.csv").write_text("\n".join([head, *lines, ""]))
    assert main(["diagnose", str(tmp_path / "rig.csv"), "--stiffness", "2000", "--damping", "15"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "rig.csv: ; and decimal comma, time in ms, " in said and "500 Hz, 0 of 180 missing, by name: " in said
    assert ("kg m²" in said) is rotary and ("rx = position_deg" in said) is rotary
    recording = import_table(tmp_path / "rig.csv", {"time": "2", "rx" if rotary else "z": "3"}, mass=0.3)
    recording.save(tmp_path / "rig.maglev")
    assert "rig.csv: ; and decimal comma, time in ms, " in Recording.load(tmp_path / "rig.maglev").events[0]
    _, stated, *_ = read_oscillation(tmp_path / "rig.maglev")
    assert stated == ({"inertia": None} if rotary else {"mass": 0.3})


def test_a_line_for_excel_holds_no_names_and_columns_have_numbers(tmp_path: Path) -> None:
    file = tmp_path / "log.csv"
    rows = [f"{0.001 * tick:.3f};{1e-3 * np.sin(0.3 * tick):.9f}" for tick in range(200)]
    file.write_text("\n".join(["sep=;", *rows]) + "\n")
    stated: dict[str, Any] = {"units": {"time": "s", "length": "m"}, "mass": 0.3}
    by_text = import_table(file, columns={"time": "1", "z": "2"}, **stated)
    by_number = import_table(file, columns={"time": 1, "z": 2}, **stated)  # type: ignore[dict-item]
    assert len(by_text.segments[0]) == 200
    assert np.array_equal(by_text.segments[0].position, by_number.segments[0].position)


def test_a_clock_that_jumps_by_years_is_refused_before_it_fills_the_memory(tmp_path: Path) -> None:
    file = tmp_path / "log.csv"
    times = 1e-3 * np.arange(300) + np.random.default_rng(2).uniform(0.0, 9e-4, 300)
    times[150:] += 1e8
    file.write_text("time,z\n" + "".join(f"{time:.6f},{1e-3 * np.sin(time):.9f}\n" for time in times))
    with pytest.raises(ParameterError, match="split the file at its gap"):
        import_table(file, units={"time": "s", "length": "m"}, mass=0.3, rate=1000.0, resample=True)
