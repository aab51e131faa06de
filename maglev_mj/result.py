"""Results as table, text, HTML, JSON, data frame and picture."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from html import escape
from textwrap import wrap
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from maglev_mj.errors import MaglevError, require
from maglev_mj.terminal import WIDTH, printable, wrapped

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray
    from pandas import DataFrame

_MOST_ROWS, _MOST_COLUMNS = 8, 9
_LONGEST = 2000  # of a representation [bytes]
_IN, _GAPS, _NARROWEST = "  ", ("  ", " "), 24
_IN_NUMBERS = re.compile(r"\bto\b|(?<=\d)e(?=[-+]?\d)")


def number_text(value: float, digits: int = 4, decimals: int | None = None) -> str:
    """Return a number as text; a dash if it is not finite.

    Args:
        value: The number.
        digits: Significant digits; whole numbers up to 10 000 000 are written in full.
        decimals: Largest number of decimals, which then all stand there; None to leave out zeros at the end.
    """
    if not math.isfinite(value):
        return "-"
    if decimals is None:
        return f"{value:.0f}" if 10.0**digits <= abs(value) < 1e7 else f"{value:z.{digits}g}"
    whole = math.floor(math.log10(abs(value))) + 1 if value else 0
    return f"{value:z.{min(max(digits - whole, 0), decimals)}f}"


class Table(NamedTuple):
    """Rows under a title, for a terminal and a notebook.

    Attributes:
        title: Description of the rows; empty for none.
        head: Name of each column, its unit in brackets.
        rows: Texts and numbers.
        note: Remarks below the rows, a line each; empty for none.
        below: Further tables under this one.
    """

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[Any]]
    note: str = ""
    below: Sequence[Table] = ()

    def __str__(self) -> str:
        """Return the table for a terminal, at most 80 characters wide.

        Texts are to the left and numbers to the right. Columns that do not fit, even closer together, go on below; the
        last text is wrapped.
        """
        title = wrapped(printable(self.title), "", _IN) if self.title else []
        columns = [list(map(_text, column)) for column in zip(self.head, *self.rows)] if self.rows else []
        left = [any(map(_has_words, column[1:])) for column in columns]
        columns = _narrowed(columns, bool(left and left[-1]))
        first = next((index for index, words in enumerate(left) if not words), len(columns))
        last = next((index for index in range(len(columns), first, -1) if not left[index - 1]), first)
        widths = [max(map(len, column)) for column in columns]
        widths[-1:] = [min(widths[-1], _NARROWEST) if left[-1] else widths[-1]] if columns else []  # it is wrapped
        around = [index for index in range(len(columns)) if not max(first, 1) <= index < last]
        groups = {gap: _fitting(range(max(first, 1), last), around, widths, gap) for gap in _GAPS}
        gap = min(_GAPS, key=lambda gap: len(groups[gap]))
        block: list[str] = []
        for some in groups[gap]:
            shown = [*around[: max(first, 1)], *some, *around[max(first, 1) :]]
            block += _block([columns[index] for index in shown], [left[index] for index in shown], gap)
        notes = [line for remark in self.note.splitlines() for line in wrapped(printable(remark), further=2 * _IN)]
        parts = ["\n".join(lines) for lines in (title, block, notes) if lines]
        return "\n\n".join([*parts, *map(str, self.below)])

    def _repr_html_(self) -> str:
        rows = "".join(f"<tr>{_cells('td', row)}</tr>" for row in self.rows)
        return (
            f"<table><caption>{escape(self.title)}</caption><thead><tr>{_cells('th', self.head)}</tr></thead>"
            f"<tbody>{rows}</tbody></table>"
            + "".join(f"<p>{escape(remark)}</p>" for remark in self.note.splitlines())
            + "".join(table._repr_html_() for table in self.below)
        )


class Result:
    """Dataclass of a result, from whose fields and columns all its forms follow.

    A subclass gives `columns` and `units`; `table` for a table other than the first rows of the columns; `plot` if it
    has a picture.

    Class attributes:
        derived: Names of properties that its JSON has besides the fields.
    """

    derived: ClassVar[Sequence[str]] = ()

    def columns(self) -> Mapping[str, NDArray[Any]]:
        """Return the columns by name, (N,) each."""
        raise NotImplementedError

    @property
    def units(self) -> Mapping[str, str]:
        """Unit of each column; empty or left out for none."""
        raise NotImplementedError

    def table(self) -> Table:
        """Return the table that a terminal and a notebook show."""
        columns, units = self.columns(), self.units
        shown = list(columns)[:_MOST_COLUMNS]
        rows = list(zip(*(columns[name][:_MOST_ROWS].tolist() for name in shown)))
        head = [with_unit(name, units.get(name)) for name in shown]
        left = {"rows": len(columns[shown[0]]) - len(rows), "columns": len(columns) - len(shown)}
        note = " and ".join(f"{count} more {name}" for name, count in left.items() if count)
        return Table(type(self).__name__.lower(), head, rows, note)

    def as_json(self) -> dict[str, Any]:
        """Return every field but those kept from its representation, ready for JSON."""
        names = [one.name for one in fields(self) if one.repr]  # type: ignore[arg-type]
        return {name: plain(getattr(self, name)) for name in (*names, *self.derived)}

    def to_pandas(self) -> DataFrame:
        """Return the columns as a data frame, their units in its `attrs["units"]`.

        Raises:
            MissingPackageError: If pandas is not installed.
        """
        require(("pandas",), "pandas", "data frames need pandas")
        from pandas import DataFrame

        frame = DataFrame(self.columns())
        frame.attrs["units"] = {name: unit for name, unit in self.units.items() if name in frame}
        return frame

    def plot(self, path: Path | None = None) -> Any:
        """Return a picture, a matplotlib figure, or the path that it was written to.

        Args:
            path: File to write; None to return the figure.

        Raises:
            MissingPackageError: If matplotlib is not installed.
            NotImplementedError: If the result has no picture.
        """
        raise NotImplementedError(f"{type(self).__name__} has no picture")

    def __repr__(self) -> str:
        try:
            text = str(self.table())
        except MaglevError as error:
            text = f"{type(self).__name__.lower()}: {error}"
        if len(text.encode()) <= _LONGEST:
            return text
        return text.encode()[: _LONGEST - 3].decode(errors="ignore") + "…"

    def _repr_html_(self) -> str:
        return self.table()._repr_html_()

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        cls.__repr__ = Result.__repr__  # type: ignore[method-assign]  # or a dataclass would make one of all its fields


def plain(value: Any) -> Any:
    """Return a value ready for JSON, None for a number that is not finite."""
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, type):
        return getattr(value, "name", value.__name__)
    if hasattr(value, "as_json"):
        return value.as_json()
    if hasattr(value, "_asdict"):
        value = value._asdict()
    elif is_dataclass(value):
        value = {one.name: getattr(value, one.name) for one in fields(value)}
    if isinstance(value, Mapping):
        return {name: plain(one) for name, one in value.items()}
    return [plain(one) for one in value]


def with_unit(name: str, unit: str | None) -> str:
    """Return the name of a column with its unit in brackets."""
    return f"{name} [{unit}]" if unit else name


def _cells(tag: str, values: Sequence[Any]) -> str:
    return "".join(f"<{tag}>{escape(_text(value))}</{tag}>" for value in values)


def _text(value: Any) -> str:
    return number_text(value) if isinstance(value, float) else printable(str(value))


def _has_words(text: str) -> bool:
    """Return True for a cell of words, which stands to the left."""
    return any(map(str.isalpha, _IN_NUMBERS.sub("", text)))


def _narrowed(columns: list[list[str]], wraps: bool) -> list[list[str]]:
    """Return columns with their units below their names if they do not fit the width otherwise."""
    widths = [max(map(len, column)) + 1 for column in columns]
    widths[-1:] = [min(widths[-1], _NARROWEST) if wraps else widths[-1]] if columns else []
    heads = [column[0].partition(" [") for column in columns]
    if len(_IN) + sum(widths) <= WIDTH or not any(mark for _, mark, _ in heads):
        return columns
    return [[name, mark.strip() + unit, *column[1:]] for (name, mark, unit), column in zip(heads, columns)]


def _fitting(indices: Sequence[int], around: Sequence[int], widths: Sequence[int], gap: str) -> list[list[int]]:
    """Return columns in groups that fit the width beside those around them."""
    groups: list[list[int]] = [[]]
    for index in indices:
        used = len(_IN) + sum(widths[one] + len(gap) for one in [*around, *groups[-1]])
        if groups[-1] and used + widths[index] > WIDTH:
            groups.append([])
        groups[-1].append(index)
    return groups


def _block(columns: Sequence[Sequence[str]], left: Sequence[bool], gap: str) -> list[str]:
    """Return the lines of columns side by side, the last of words wrapped."""
    widths = [max(map(len, column)) for column in columns]
    begin = len(_IN) + sum(width + len(gap) for width in widths[:-1])
    lines = []
    for *row, final in zip(*columns):
        texts = wrap(final, max(WIDTH - begin, _NARROWEST), break_on_hyphens=False) if left[-1] else [final]
        cells = [f"{text:{'<' if words else '>'}{width}}" for text, words, width in zip(row, left, widths)]
        cells.append(f"{texts[0] if texts else '':{'<' if left[-1] else '>'}{widths[-1]}}")
        lines += [(_IN + gap.join(cells)).rstrip(), *(" " * begin + text for text in texts[1:])]
    return [line for line in lines if line]
