"""Text tables of any program: encoding, header, separator, decimal mark, names and units, decided once for a table."""

from __future__ import annotations

import csv
import math
import re
import zlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from decimal import Decimal
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from maglev_mj.errors import ParameterError, check_one_of, one_line
from maglev_mj.frames import Array

UNITS: Mapping[str, Mapping[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "nm": 1e-9},
    "angle": {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180.0},
    "force": {"N": 1.0, "mN": 1e-3},
    "torque": {"Nm": 1.0, "mNm": 1e-3},
    "current": {"A": 1.0, "mA": 1e-3},
}
"""Factors to SI by quantity and unit."""

_SPELLINGS = {
    "s": "sec secs second seconds sek sekunden",
    "ms": "msec millis millisecond milliseconds",
    "us": "usec micros microsecond microseconds",
    "ns": "nsec nanos nanosecond nanoseconds",
    "m": "meter meters metre metres",
    "mm": "millimeter millimeters millimetre millimetres",
    "um": "micron microns micrometer micrometers micrometre micrometres",
    "rad": "radian radians",
    "deg": "degree degrees °",
    "N": "newton newtons",
    "Nm": "n·m n*m n-m newton-meter newton-metre",
    "A": "amp amps ampere amperes",
}
_UNIT_OF = {unit: unit for units in UNITS.values() for unit in units}
_UNIT_OF |= {unit.lower(): unit for unit in _UNIT_OF if unit.lower() not in ("n", "a")}
_UNIT_OF |= {word: unit for unit, words in _SPELLINGS.items() for word in words.split()}
_QUANTITY_OF = {unit: quantity for quantity, units in UNITS.items() for unit in units}
_NO_SI = set("- 1 v mv volt volts count counts ticks raw lsb bit % °c hz m/s mm/s rad/s deg/s m/s² m/s^2 ts rn".split())

ENCODINGS = "utf-8", "utf-16", "latin-1"
SEPARATORS = {"tab": "\t", "semicolon": ";", "comma": ",", "bar": "|", "blank": " "}
DECIMALS = {"point": ".", "comma": ","}

_BLANK = {"", "nan", "-nan", "null", "none", "na", "n/a", "#n/a", "--", "nan(ind)", "-nan(ind)", "1.#qnan", "-1.#ind"}
_LARGEST, _SCPI = 9e36, (9.8e37, 1e38)  # overload (9.9E37) and no value (9.91E37) of instruments
_NUMBER = re.compile(r"[+-]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][+-]?\d+)?")
_GROUPED = re.compile(r"[+-]?\d{1,3}(?:[.,'\u2019\u00a0\u202f]\d{3})+(?:[.,]\d+)?")  # or decimal: decided for the table
_CLOCK = re.compile(r"(?:(\d{4}-\d\d-\d\d)[T ])?(\d\d?):(\d\d):(\d\d(?:[.,]\d+)?)(Z|[+-]\d\d:?\d\d)?")
_LABEL = re.compile(r"(?<![^,;\t ])([A-Za-z_]\w*)\s*[:=]\s*(?=[-+.\d])")
_COMMENT = re.compile(r"\s*(?:[#%]+|//)\s*")
_SAMPLE = 1000  # lines of the end that decide the separator
_SHOWN = 60  # characters of a line in a message


class TableFormat(NamedTuple):
    """What a text table is taken for; None for what the file decides.

    Attributes:
        encoding: One of ENCODINGS.
        skip: Lines before those of names and units, or before the numbers of a table without names.
        separator: One of SEPARATORS.
        decimal: One of DECIMALS; the other mark then groups thousands.
        names: Names of all columns, in place of those in the file.
    """

    encoding: str | None = None
    skip: int | None = None
    separator: str | None = None
    decimal: str | None = None
    names: Sequence[str] | None = None

    def check(self) -> None:
        """Raise ParameterError for a value that is not a choice, or contradicts another one."""
        choices = {"encoding": ENCODINGS, "separator": SEPARATORS, "decimal": DECIMALS}
        for name, allowed in choices.items():
            if (value := getattr(self, name)) is not None:
                check_one_of(name, allowed, value)
        if self.skip is not None and self.skip < 0:
            raise ParameterError(f"skip must be at least 0 lines (got {self.skip})")
        if self.separator == self.decimal == "comma":
            raise ParameterError("separator and decimal must differ (got comma for both)")


class TextTable(NamedTuple):
    """Table of a file; see `read_table`.

    Attributes:
        names: Name of each column; its number, from 1, for one without a name.
        units: Unit of each column as the file states it, a name of `UNITS` if it is one; empty for none.
        words: Words of each row, numbers with a decimal point.
        rows: Number of each row in the file, from 1.
        taken: What the file is taken for, in words.
    """

    names: Sequence[str]
    units: Sequence[str]
    words: Sequence[Sequence[str]]
    rows: NDArray[np.int64]
    taken: tuple[str, ...]

    def place(self, name: str) -> int:
        """Return the index of a column by its name, or by its number from 1."""
        if name not in self.names and str(name).isdecimal() and 0 < int(name) <= len(self.names):
            return int(name) - 1
        check_one_of("column", self.names, name)
        return self.names.index(name)

    def values(self, name: str) -> Array:
        """Return a column as numbers, (N,), NaN for an empty cell; raise ParameterError for another word."""
        index = self.place(name)
        words = [row[index] for row in self.words]
        if all(map(_NUMBER.fullmatch, words)) and np.abs(values := np.array([*map(float, words)])).max() < _LARGEST:
            return values
        for row, word in zip(self.rows, words):
            if not _is_number(word):
                got = f"got {one_line(word)} in row {row}, column {one_line(name)}"
                raise ParameterError(f"values must be numbers below 1e37 ({got}): correct it, or leave the cell empty")
        values = np.array([math.nan if word.lower() in _BLANK else float(word) for word in words])
        return np.where(np.abs(values) > _LARGEST, math.nan, values)

    def is_clock(self, index: int) -> bool:
        """Return True for a column of clock times, such as 2026-11-28 12:00:00.005 or 12:00:00.

        Raises:
            ParameterError: If it starts with neither a number nor such a time.
        """
        word = self.words[0][index]
        if not (clock := bool(_CLOCK.fullmatch(word))) and not _is_number(word):
            got = f"got {one_line(word)} in row {self.rows[0]}, column {one_line(self.names[index])}"
            raise ParameterError(f"time must be a number, or as in 2026-11-28 12:00:00.005 ({got}): convert it")
        return clock

    def stamps(self, name: str) -> Array:
        """Return a column since its first row, (N,), exact for nanoseconds since 1970; in s for clock times."""
        index = self.place(name)
        words = [row[index] for row in self.words]
        if self.is_clock(index):
            stamps = [_seconds(word, row) for row, word in zip(self.rows.tolist(), words)]
        else:
            values = self.values(name)
            check_values(
                np.isfinite(values), self.rows, values, "time must be known", "delete it, or give rate without time"
            )
            stamps = [Decimal(word) for word in words]
        return np.array([float(stamp - stamps[0]) for stamp in stamps])

    def is_empty(self, index: int) -> bool:
        """Return True for a column without any value."""
        return all(row[index].lower() in _BLANK for row in self.words)


def check_values(valid: NDArray[np.bool_], rows: NDArray[np.int64], values: Array, rule: str, remedy: str) -> None:
    """Raise ParameterError for the first value that is not valid."""
    if not valid.all():
        index = int(np.argmin(valid))
        raise ParameterError(f"{rule} (got {values[index]:.4g} in row {rows[index]}): {remedy}")


def unit_of(text: str) -> str:
    """Return the name in `UNITS` of a unit in words or symbols; empty for another one."""
    word = text.replace(" ", "").replace("µ", "u").replace("μ", "u")
    return _UNIT_OF.get(word) or _UNIT_OF.get(word.lower(), "")


def quantity_of(unit: str) -> str:
    """Return the quantity of a unit of `UNITS`; empty for another one."""
    return _QUANTITY_OF.get(unit, "")


def base_and_unit(name: str) -> tuple[str, str]:
    """Return the name of a column without its unit, and the unit: x [mm], x (mm), x in mm, x_mm, t/s, or ms alone.

    A unit in brackets is returned in any case, another one only if it is in `UNITS`.
    """
    if match := re.fullmatch(r"(.*?)\s*(?:\[([^\[\]]*)\]|\(([^()]*)\)|<([^<>]*)>)\s*", name):
        text = next(part for part in match.groups()[1:] if part is not None)
        if unit_of(text) or re.fullmatch(r"\S{1,12}", text.strip()):
            return match[1], unit_of(text) or text.strip()
    match = re.fullmatch(r"(.*?)(\s+in\s+|\s|[_.-]|/)([^\s_./-]+)", name)
    if match and not name.startswith("/") and match[1] and (unit := unit_of(match[3])):
        if unit not in ("N", "A") or match[2].strip() in ("in", "/"):  # F_N, phase_A
            return match[1], unit
    whole = unit_of(name)
    return name, whole if quantity_of(whole) == "time" and len(name) > 1 else ""


def read_table(data: bytes, wanted: TableFormat = TableFormat()) -> TextTable:  # noqa: B008
    """Read a table, and decide once for all of it what it is; `wanted` overrides each decision.

    Lines that start with #, % or // are comments, except names behind such a mark. Without a line of names, the columns
    are 1, 2, ... A last line that is cut is left out.

    Raises:
        ParameterError: If there are no rows of numbers, a name repeats, the rows have different lengths, two decimal
            marks are in use, or the file contradicts what is wanted.
    """
    wanted.check()
    text, taken = _decoded(data, wanted.encoding)
    raw = re.split(r"\r\n|\r|\n", text.replace("\u2212", "-"))
    lines = [(row, line) for row, line in enumerate(raw, 1) if line.strip()]
    ended = not raw[-1].strip()
    lines, labels = _without_labels([(row, line) for row, line in lines if row > (wanted.skip or 0)])
    match = re.fullmatch(r'"?sep=(.)"?', lines[0][1].strip()) if lines else None  # for Excel
    excel, lines = (match[1], lines[1:]) if match else (None, lines)
    labels = labels if wanted.names is None else []
    wanted = wanted._replace(names=labels or wanted.names)
    separator, count, numeric = _separator(lines, wanted, excel)
    split = _splitter(separator)
    first = _first_row([line for _, line in lines], split, count, numeric)
    if first is None:
        raise ParameterError(_no_rows(wanted, lines))
    header, body = lines[:first], [part for part in lines[first:] if not _COMMENT.match(part[1])]
    words = [[word.strip() for word in split(line)] for _, line in body]
    rows, cut = [row for row, _ in body], ""
    if not ended and len(words) > 1 and _is_cut(words):
        cut = f"row {rows.pop()}, {one_line(words.pop()[-1])}"
    if words and (pandas := words[0]) and not pandas[0] and pandas[1:] == [str(k) for k in range(len(pandas) - 1)]:
        words, rows = words[1:], rows[1:]  # names of a data frame without names
    for row, part in zip(rows, words):
        if len(part) != count:
            raise ParameterError(f"row {row} must have {count} values, like the first row (got {len(part)})")
    if not words:
        raise ParameterError(_no_rows(wanted, lines))
    empty = 0
    while empty < count - 1 and not any(part[count - 1 - empty] for part in words):
        empty += 1
    names, row_of_units, of_header = _names(header, split, count - empty, count, wanted, rows[0])
    words = [part[: len(names)] for part in words] if len(names) < count else words
    mark = _decimal(words, rows, names, wanted.decimal)
    taken += [_marks(separator, mark)]
    before = rows[0] - 1 - of_header
    taken += [f"{before} line{'s' * (before != 1)} skipped"] * bool(before)
    taken += ["no names"] * (of_header == 0 and wanted.names is None) + ["names in each row"] * bool(labels)
    taken += ["row of units"] * bool(row_of_units)
    taken += [f"last line without its end left out ({cut})"] * bool(cut)
    if repeated := [name for name, number in Counter(names).items() if number > 1]:
        raise ParameterError(f"column {one_line(repeated[0])} must be named once: rename the others, or give names")
    return TextTable(names, _units(names, row_of_units), words, np.array(rows), tuple(taken))


def _no_rows(wanted: TableFormat, lines: Sequence[tuple[int, str]]) -> str:
    reasons = [
        f"{name} {value}" for name, value in zip(wanted._fields, wanted) if value is not None and name != "names"
    ]
    with_ = f" with {', '.join(reasons)}" if reasons else ""
    last = f" in {len(lines)} lines{with_}, the last {one_line(lines[-1][1][:_SHOWN])}" if lines else with_
    return f"table must have rows of numbers (got none{last}): export columns of numbers"


def _decoded(data: bytes, encoding: str | None) -> tuple[str, list[str]]:
    """Return the text, and how it was encoded unless in UTF-8 and if its end is lost, in words."""
    taken, damaged = list[str](), False
    if data[:2] == b"\x1f\x8b":
        data, damaged = _inflated(data)
        taken += ["gzip"]
    if data[:4] in (b"PK\x03\x04", b"PAR1", b"SQLi", b"MATL", b"\x89HDF", b"\xd0\xcf\x11\xe0"):
        raise ParameterError("file must be a text table (got an Excel, ZIP, MATLAB or database file): export it as CSV")
    if data.startswith(b"version https://git-lfs"):
        raise ParameterError("a Git LFS pointer: run git lfs pull")
    codec = {None: "utf-8", "utf-16": "utf-16-le"}.get(encoding, encoding)
    start = data[:4096]
    zeros = [start[side::2].count(0) / max(len(start) // 2, 1) for side in (0, 1)]
    if encoding in (None, "utf-16"):
        if data[:2] in (b"\xff\xfe", b"\xfe\xff") or max(zeros) > 0.5 > 2.0 * min(zeros):
            big = data[:2] == b"\xfe\xff" or (data[:2] != b"\xff\xfe" and zeros[0] > zeros[1])
            codec = "utf-16-be" if big else "utf-16-le"
            data, damaged = data[: len(data) // 2 * 2], damaged or bool(len(data) % 2)
    try:
        text = data.decode(codec or "")
    except UnicodeDecodeError as error:
        if codec == "utf-8" and error.reason == "unexpected end of data":
            text, damaged = data[: error.start].decode(codec), True
        elif encoding is None and codec == "utf-8":
            codec, text = "latin-1", data.decode("latin-1")
        else:
            raise ParameterError(f"file must be in {encoding or codec} (got another byte at {error.start})") from None
    text = text.removeprefix("\ufeff")
    whole = text.rstrip("\0")  # zeros of a file whose end was not written
    damaged |= whole != text
    taken += ["its end is lost"] * damaged
    if "\0" in whole or re.search(r"[\x01-\x08\x0e-\x1a\x1c-\x1f]", whole[:4096]):
        raise ParameterError("file must be a text table (got control characters): export it as CSV")
    name = {"utf-8": "", "latin-1": "Latin-1"}.get(str(codec), "UTF-16")
    return whole, [name] * bool(name) + taken


def _inflated(data: bytes) -> tuple[bytes, bool]:
    """Return the content of a gzip file, also of one that ends early, and True for that."""
    parts = list[bytes]()
    while data[:2] == b"\x1f\x8b":
        stream = zlib.decompressobj(wbits=31)
        try:
            parts.append(stream.decompress(data))
        except zlib.error as error:
            raise ParameterError(f"gzip data must be intact ({error}): compress the table again") from None
        if not stream.eof:
            return b"".join(parts), True
        data = stream.unused_data
    return b"".join(parts), False


def _without_labels(lines: list[tuple[int, str]]) -> tuple[list[tuple[int, str]], list[str]]:
    """Return the lines with values alone, and the labels of most of them, such as x:1,y:2 of a serial plotter."""
    found = Counter(tuple(_LABEL.findall(line)) for _, line in lines[-_SAMPLE:])
    labels = [*max(found, key=found.__getitem__, default=())]
    if not labels or 2 * found[tuple(labels)] <= found.total():
        return lines, []
    return [(row, _LABEL.sub("", line) if _LABEL.findall(line) == labels else line) for row, line in lines], labels


_Split = Callable[[str], list[str]]


def _splitter(separator: str) -> _Split:
    """Return the function that splits a line."""
    if separator == " ":
        return lambda line: re.split(r"[ \t]+", line.strip())

    def split(line: str) -> list[str]:
        if '"' not in line:
            return line.split(separator)
        try:
            return next(csv.reader([line], delimiter=separator, skipinitialspace=True))
        except csv.Error as error:
            raise ParameterError(f"file must be a text table ({error})") from None

    return split


def _is_value(word: str) -> bool:
    """Return True for a number with any decimal mark, or a clock time."""
    return bool(_NUMBER.fullmatch(word) or _GROUPED.fullmatch(word) or _CLOCK.fullmatch(word))


def _is_number(word: str) -> bool:
    if word.lower() in _BLANK:
        return True
    try:
        value = abs(float(word)) if _NUMBER.fullmatch(word) else math.inf
    except ValueError:
        return False
    return value < _LARGEST or _SCPI[0] < value < _SCPI[1]


def _separator(lines: Sequence[tuple[int, str]], wanted: TableFormat, excel: str | None) -> tuple[str, int, list[int]]:
    """Return the separator, the number of columns, and the indices of those with numbers.

    It is the one with the most columns of numbers, less those of words, in the last half of the file.
    """
    text = [line for _, line in lines if not _COMMENT.match(line)]
    sample = text[-min(max(len(text) // 2, 8), _SAMPLE) :]
    tried = [SEPARATORS[wanted.separator]] if wanted.separator else [excel] if excel else [*SEPARATORS.values()]
    if wanted.decimal == "comma" and wanted.separator is None:
        tried = [mark for mark in tried if mark != ","] or tried
    best, result = -math.inf, (tried[0], 0, list[int]())
    for mark in tried:
        split = _splitter(mark)
        cells = [[word.strip() for word in split(line)] for line in sample]
        cells = [part for part in cells if any(map(_is_value, part))]
        if not cells:
            continue
        ((count, number),) = Counter(map(len, cells)).most_common(1)
        rows = [part for part in cells if len(part) == count]
        kinds = [
            [_is_value(word) - (word.lower() not in _BLANK and not _is_value(word)) for word in part] for part in rows
        ]
        shares = np.sum(kinds, axis=0)
        numeric = np.flatnonzero(shares > 0).tolist()
        score = (len(numeric) - int(np.sum(shares < 0))) * number
        if score > best and numeric:
            best, result = score, (mark, count, numeric)
    return result


def _first_row(lines: Sequence[str], split: _Split, count: int, numeric: Sequence[int]) -> int | None:
    """Return the index of the first of two lines with numbers in all columns of numbers; None without any."""

    def is_row(line: str) -> bool:
        words = [word.strip() for word in split(line)]
        valid = len(words) == count and all(_is_value(words[k]) or words[k].lower() in _BLANK for k in numeric)
        return valid and any(_is_value(words[k]) for k in numeric)

    previous: int | None = None
    for index, line in enumerate(lines):
        if _COMMENT.match(line):
            continue
        if not numeric or not is_row(line):
            previous = None
        elif previous is not None:
            return previous
        else:
            previous = index
    return previous


def _is_cut(words: Sequence[Sequence[str]]) -> bool:
    """Return True for a last line without its end whose last word may be a part of one.

    It is whole if all numbers above it have the same digits behind the mark and in the exponent, as it has.
    """
    *above, last = words
    if not above or len(last) != len(above[-1]):
        return bool(above)
    column = [row[-1] for row in above if len(row) == len(last)]
    if not all(map(_NUMBER.fullmatch, column)):
        return last[-1] not in column
    return {*map(_form, column)} != {_form(last[-1])}


def _form(word: str) -> tuple[int, ...]:
    """Return the number of digits behind the decimal mark and in the exponent, or of all for an integer."""
    mantissa, _, exponent = word.lower().partition("e")
    whole, *decimals = re.split(r"[.,]", mantissa)
    if not decimals and not exponent:
        return (len(whole.lstrip("+-")),)
    return len("".join(decimals)), len(exponent.lstrip("+-"))


def _names(
    header: Sequence[tuple[int, str]], split: _Split, least: int, most: int, wanted: TableFormat, first: int
) -> tuple[list[str], list[str], int]:
    """Return the names, the row of units, and how many lines of the header these are.

    The names are the last line of words, or that above a row of units, with as many words as there are columns.
    """
    found = [_head_words(line, split, least, most) for _, line in header]
    row_of_units, at = list[str](), -1
    for index in range(len(found) - 1, 0, -1):
        if (words := found[index]) and _are_units(words) and any(found[:index]):
            row_of_units, at = words, index
            break
    places = [index for index, words in enumerate(found) if words and _named(words) and (at < 0 or index < at)]
    places += [at - 1] * bool(at > 0 and found[at - 1])  # numbers too, such as those of channels
    if wanted.names is not None:
        if not least <= len(wanted.names) <= most:
            raise ParameterError(f"names must be one for each of {least} columns (got {len(wanted.names)})")
        return list(wanted.names), row_of_units, bool(row_of_units) + bool(places)
    if places:
        names = found[places[-1]] or []
        width = max(least, len(names))
        names = [*names, *[""] * (width - len(names))]
        return [name or str(k + 1) for k, name in enumerate(names)], row_of_units, 1 + bool(row_of_units)
    if header and not _COMMENT.match(header[-1][1]):
        words = [word.strip() for word in split(header[-1][1])]
        if len(words) > 1 and all(words) and not any(map(_is_value, words)):
            got = f"got {len(words)} in row {header[-1][0]}"
            remedy = f"correct it, give names, or skip={header[-1][0]}"
            if split("a,b") == ["a", "b"] and least == 2 * len(words):
                remedy = "a comma cannot be separator and decimal mark: export with semicolons or decimal points"
            raise ParameterError(f"names must be as many as the {least} values of row {first} ({got}): {remedy}")
    return [str(index + 1) for index in range(least)], [], 0


def _head_words(line: str, split: _Split, least: int, most: int) -> list[str] | None:
    """Return the words of a line of the header, if they may be those of the columns: with any separator."""
    text = _COMMENT.sub("", line, count=1) if _COMMENT.match(line) else line
    merged = re.sub(r"\s+(?=[(\[<])", "", text)
    *others, blank = [_splitter(mark) for mark in SEPARATORS.values()]
    wide: _Split = lambda part: re.split(r"\s{2,}", part.strip())  # noqa: E731
    own = [split] if len(split("a b")) == 1 else []  # names of a table of blanks may have blanks
    for attempt, part in [(one, text) for one in (*own, *others, wide, blank)] + [(blank, merged)]:
        words = [word.strip() for word in attempt(part)]
        if len(words) == most + 1 and words[-1].lower() in ("comment", "comments"):
            words = words[:-1]  # of LabVIEW, whose column is not written
        while len(words) > least and not words[-1]:
            words = words[:-1]
        if least <= len(words) <= most and not all(map(_is_value, words)) and any(words):
            return words
    return None


def _named(words: Sequence[str]) -> bool:
    """Return True for words that name columns: no number, and at most one, an index, is empty."""
    return words.count("") <= 1 and not any(map(_is_value, words))


def _are_units(words: Sequence[str]) -> bool:
    """Return True for a row of units, at least one of them known."""
    bare = [word.strip("[]()<> ") for word in words]
    return any(map(unit_of, bare)) and all(not word or unit_of(word) or word.lower() in _NO_SI for word in bare)


def _units(names: Sequence[str], row: Sequence[str]) -> list[str]:
    """Return the unit of each column, of its name or of the row of units."""
    units = list[str]()
    for index, name in enumerate(names):
        own = base_and_unit(name)[1]
        stated = row[index].strip("[]()<> ") if index < len(row) else ""
        stated = unit_of(stated) or stated
        if own and stated and own != stated:
            raise ParameterError(
                f"unit of {one_line(name)} must be that of the row of units (got {stated}): correct one"
            )
        units.append(stated or own)
    return units


def _decimal(words: list[list[str]], rows: Sequence[int], names: Sequence[str], wanted: str | None) -> str:
    """Return the decimal mark in use, empty without any, and put points in its place.

    A column counts if most of its words are numbers. Two marks are an error, since one of them may group thousands.
    """
    columns = dict[int, list[str]]()
    for index in range(len(names)):
        column = [part[index] for part in words]
        numbers = column
        if not all(map(_NUMBER.fullmatch, column)):
            numbers = [word for word in column if _NUMBER.fullmatch(word) or _GROUPED.fullmatch(word)]
        if 2 * len(numbers) > sum(word.lower() not in _BLANK for word in column):
            columns[index] = column
    first = dict[str, tuple[int, int, str]]()
    for mark in ".,":
        marked = (
            (index, ((k, part) for k, part in enumerate(column) if mark in part and not _CLOCK.fullmatch(part)))
            for index, column in columns.items()
        )
        places = [(place[0], index, place[1]) for index, parts in marked if (place := next(parts, None))]
        first |= {mark: min(places)} if places else {}
    where = {
        mark: f"{one_line(part)} in row {rows[k]}, column {one_line(names[index])}"
        for mark, (k, index, part) in first.items()
    }
    remedy = "export without grouping of thousands, or give decimal"
    if wanted is None:
        if len(first) == 2:
            got = " and ".join(where[mark] for mark in sorted(first, key=lambda mark: first[mark]))
            raise ParameterError(f"decimal mark must be one, point or comma (got {got}): {remedy}")
        grouped = [one for mark in first for one in _grouped(columns, mark)]
        if grouped:
            k, index, part = grouped[0]
            got = f"got {one_line(part)} in row {rows[k]}, column {one_line(names[index])}"
            raise ParameterError(f"decimal mark must not be one that may group thousands ({got}): {remedy}")
        mark, other = next(iter(first), ""), ""
    else:
        mark = DECIMALS[wanted]
        other = ",."[mark == ","]
    for index in columns:
        for row, cells in zip(rows, words):
            if cells[index] and (mark == "," or other):
                cells[index] = _pointed(cells[index], mark, other, row, names[index])
    return mark if mark in first else ""


def _pointed(word: str, mark: str, other: str, row: int, name: str) -> str:
    """Return a number with a decimal point, without the other mark where it groups thousands."""
    if other and other in word:
        if not re.fullmatch(rf"[+-]?[1-9]\d{{0,2}}(?:\{other}\d{{3}})+(?:\{mark}\d+)?", word):
            got = f"got {one_line(word)} in row {row}, column {one_line(name)}"
            raise ParameterError(
                f"numbers must have a decimal {'comma' if mark == ',' else 'point'} ({got}): give the other"
            )
        word = word.replace(other, "")
    return word.replace(",", ".") if mark == "," else word


def _grouped(columns: Mapping[int, Sequence[str]], mark: str) -> list[tuple[int, int, str]]:
    """Return the first word of a column whose marks may all group thousands: row, column and word.

    A zero before the mark, or not three digits behind it, shows a decimal mark; so does a mark in every number.
    """
    suspects = list[tuple[int, int, str]]()
    for index, column in columns.items():
        marked = [(k, word) for k, word in enumerate(column) if mark in word]
        if twice := [(k, index, word) for k, word in marked if word.count(mark) > 1]:
            return twice
        if not all(re.fullmatch(rf"[+-]?[1-9]\d{{0,2}}\{mark}\d{{3}}", word) for _, word in marked):
            return []
        plain = [word for word in column if re.fullmatch(r"[+-]?\d{1,3}", word) and int(word)]
        if marked and plain and not any(re.fullmatch(r"[+-]?\d{4,}", word) for word in column):
            suspects.append((marked[0][0], index, marked[0][1]))
    return suspects


def _marks(separator: str, mark: str) -> str:
    name = {"\t": "tabs", " ": "blanks", ",": "commas"}.get(separator, separator)
    return name + {".": " and decimal point", ",": " and decimal comma", "": ""}[mark]


def _seconds(word: str, row: int) -> Decimal:
    """Return the seconds of a clock time, since 1970 with a date."""
    match = _CLOCK.fullmatch(word)
    if match is None:
        raise ParameterError(
            f"time must be a clock time in all rows, like the first (got {one_line(word)} in row {row})"
        )
    date, hour, minute, second, zone = match.groups()
    seconds = Decimal(int(hour) * 3600 + int(minute) * 60) + Decimal(second.replace(",", "."))
    if date:
        try:
            days = (datetime.fromisoformat(date) - datetime(1970, 1, 1)).days
        except ValueError:
            raise ParameterError(f"time must be a date of the calendar (got {one_line(word)} in row {row})") from None
        seconds += 86400 * days
    if zone and zone != "Z":
        offset = int(zone[1:3]) * 3600 + int(zone[-2:]) * 60
        seconds -= offset if zone[0] == "+" else -offset
    return seconds


def words_of(name: str) -> list[str]:
    """Return the words of a name in lower case, of field.pose.position.x, PosX or pos_x."""
    return [word.lower() for word in re.findall(r"[A-ZÄÖÜ]?[a-zäöüß]+|[A-ZÄÖÜ]+|\d+", name)]
