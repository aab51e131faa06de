"""Results as table, text, HTML, JSON, data frame and chart."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import wraps
from html import escape
from itertools import zip_longest
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, TypeVar, cast

from maglev_mj.errors import MaglevError, check_one_of, require
from maglev_mj.keywords import checked
from maglev_mj.lazy import loaded
from maglev_mj.terminal import WIDTH, joined, printable, width, wrapped

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from pandas import DataFrame

_MAX_ROWS, _MAX_COLUMNS = 8, 9
_MAX_REPR = 2000  # [bytes]
_INDENT, _GAPS, _NARROWEST, _LEAST = "  ", ("  ", " "), 24, 12
"""Widths of wrapped text columns before others, and of the last one in any case [characters]."""
_Method = TypeVar("_Method", bound=Callable[..., Any])
_ALL_AXES, _TURNS, _FAR = 6, ("rx", "ry", "rz"), 100.0
_IN_NUMBERS = re.compile(r"\bto\b|(?<=\d)e(?=[-+]?\d)")


class NoTruthValue:
    """Verdict in `stable`, without a truth value: an unstable loop would be as true as any object."""

    def __bool__(self) -> bool:
        """Raise.

        Raises:
            TypeError: Always.
        """
        raise TypeError(f"{type(self).__name__} has no truth value: use .stable, True, False or None (not computed)")


def number_text(value: float, digits: int = 4, decimals: int | None = None) -> str:
    """Return a number as text; "-" if it is not finite.

    Args:
        value: The number.
        digits: Significant digits; integers below 10 000 000 are written in full.
        decimals: Maximum number of decimals, padded with zeros; None to omit trailing zeros.
    """
    if not math.isfinite(value):
        return "-"
    if decimals is None:
        return f"{value:.0f}" if 10.0**digits <= abs(value) < 1e7 else f"{value:z.{digits}g}"
    whole = math.floor(math.log10(abs(value))) + 1 if value else 0
    return f"{value:z.{min(max(digits - whole, 0), decimals)}f}"


def conditions_text(
    subject: str, axes: Iterable[str], periods: Iterable[float], delays: Iterable[float], *details: str
) -> str:
    """Return scene, axes, rate and delay in words, then further details: the line under the headline of each chart.

    Args:
        subject: Name of the scene, or of the loop.
        axes: Names of the axes; those of the contact first.
        periods: Sample periods [s], equal ones named once.
        delays: Delays [s]; empty for a controller alone.
        details: Plant, gains and so on.
    """
    rates = span_text([1.0 / period for period in periods]) + " Hz"
    delayed = [*delays]
    delay = f"delay {span_text([1e3 * delay for delay in delayed])} ms" if delayed else "without delay"
    named = [*dict.fromkeys(axes)]
    place = (
        "on all axes" if len(named) == _ALL_AXES else f"{'about' if named[0] in _TURNS else 'along'} {', '.join(named)}"
    )
    return ", ".join([f"{subject} {place}", rates, delay, *filter(None, details)])


def span_text(values: Iterable[float]) -> str:
    """Return one value, or the smallest and the largest of several."""
    texts = [*dict.fromkeys(f"{value:.6g}" for value in sorted(values))]
    return texts[0] if len(texts) == 1 else f"{texts[0]} to {texts[-1]}"


def radius_text(radius: float) -> str:
    """Return a spectral radius in words; far above 1 its size says nothing more."""
    return f"spectral radius {f'{radius:.3f}' if radius < _FAR else f'above {_FAR:g}'}"


class Table(NamedTuple):
    """Rows under a title, for a terminal and a notebook.

    Attributes:
        title: Title; empty for none.
        head: Column names with units in brackets.
        rows: Texts and numbers.
        note: Notes below the rows, one per line; empty for none.
        below: Tables to append.
        warnings: Warnings, printed first.
        headline: Finding, printed above the title; empty for none.
    """

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[Any]]
    note: str = ""
    below: Sequence[Table] = ()
    warnings: Sequence[str] = ()
    headline: str = ""

    def __str__(self) -> str:
        """Return the table for a terminal, at most as wide as that is, see `terminal.width`.

        Texts are left-aligned, numbers right-aligned. Columns that do not fit continue below, after a blank line; the
        last text column is wrapped.
        """
        warnings = [line for text in self._warning_lines() for line in wrapped(printable(text), further=2 * _INDENT)]
        heads = filter(None, (self.headline, self.title))
        title = [line for text in heads for line in wrapped(printable(text), "", _INDENT)]
        columns = [list(map(_text, column)) for column in zip(self.head, *self.rows)] if self.rows else []
        left = [any(map(_has_words, column[1:])) for column in columns]
        columns = _narrowed(columns, bool(left and left[-1]))
        first = next((index for index, words in enumerate(left) if not words), len(columns))
        last = next((index for index in range(len(columns), first, -1) if not left[index - 1]), first)
        widths = [max(map(len, column)) for column in columns]
        widths[-1:] = [min(widths[-1], _NARROWEST) if left[-1] else widths[-1]] if columns else []  # wrapped
        widths[:1] = [min(widths[0], _NARROWEST) if left[0] and width() < WIDTH else widths[0]] if columns else []
        around = [index for index in range(len(columns)) if not max(first, 1) <= index < last]
        groups = {gap: _fitting(range(max(first, 1), last), around, widths, gap) for gap in _GAPS}
        gap = min(_GAPS, key=lambda gap: len(groups[gap]))
        blocks: list[list[str]] = []
        for group in groups[gap]:
            shown = [*around[: max(first, 1)], *group, *around[max(first, 1) :]]
            blocks.append(_block([columns[index] for index in shown], [left[index] for index in shown], gap))
        notes = [line for remark in self.note.splitlines() for line in wrapped(printable(remark), further=2 * _INDENT)]
        parts = ["\n".join(lines) for lines in (warnings, title, *blocks, notes) if lines]
        return "\n\n".join([*parts, *map(str, self.below)])

    def _repr_html_(self) -> str:
        rows = "".join(f"<tr>{_cells('td', row)}</tr>" for row in self.rows)
        headline = f"<strong>{escape(self.headline)}</strong><br>" if self.headline else ""
        return (
            f"<table><caption>{headline}{escape(self.title)}</caption><thead><tr>{_cells('th', self.head)}</tr></thead>"
            f"<tbody>{rows}</tbody></table>"
            + "".join(f"<p>{escape(remark)}</p>" for remark in [*self._warning_lines(), *self.note.splitlines()])
            + "".join(table._repr_html_() for table in self.below)
        )

    def _warning_lines(self) -> list[str]:
        return [f"Warning: {text}" for text in self.warnings]


def capitalised(text: str) -> str:
    """Return a text with a capital first letter; units in it keep theirs."""
    return text[:1].upper() + text[1:]


def _with_headline(method: _Method) -> _Method:
    """Add the headline to a method that returns a table or a mapping for JSON."""

    @wraps(method)
    def with_headline(self: Result, *args: Any, **keywords: Any) -> Any:
        content = method(self, *args, **keywords)
        if isinstance(content, Table):
            return content._replace(headline=self.headline)
        return {"headline": self.headline, **content}

    return cast(_Method, with_headline)


class Result:
    """Base class of result dataclasses.

    A subclass defines `columns` and `units`, optionally `headline`, `table` (default: first rows of the columns), and
    for charts `pictures` and `conditions`.

    Class attributes:
        derived: Names of properties to include in the JSON.
    """

    derived: ClassVar[Sequence[str]] = ()

    @property
    def headline(self) -> str:
        """Finding in one sentence, shown by table, JSON, notebook and charts; empty for none."""
        return self._headline()

    def _headline(self) -> str:
        return ""

    def columns(self) -> Mapping[str, NDArray[Any]]:
        """Return the columns by name, (N,) each."""
        raise NotImplementedError

    @property
    def units(self) -> Mapping[str, str]:
        """Unit of each column; empty or missing for none."""
        raise NotImplementedError

    @property
    def warnings(self) -> Sequence[str]:
        """Verdicts printed above the table: an unstable wall, and force or motion above the limits of the device."""
        return ()

    @property
    def conditions(self) -> str:
        """Scene, axis, rate and delay in words, under the headline of each chart; see `conditions_text`."""
        return ""

    @property
    def pictures(self) -> Mapping[str, str]:
        """Drawing functions as "module:function", by file name without suffix; empty for no chart."""
        return {}

    @_with_headline
    def table(self) -> Table:
        """Return the table displayed in a terminal and a notebook."""
        columns, units = self.columns(), self.units
        shown = list(columns)[:_MAX_COLUMNS]
        rows = list(zip(*(columns[name][:_MAX_ROWS].tolist() for name in shown)))
        head = [with_unit(name, units.get(name)) for name in shown]
        hidden = {"rows": len(columns[shown[0]]) - len(rows), "columns": len(columns) - len(shown)}
        note = " and ".join(f"{count} more {name}" for name, count in hidden.items() if count)
        return Table("" if self.headline else type(self).__name__.lower(), head, rows, note)

    @_with_headline
    def as_json(self) -> dict[str, Any]:
        """Return all fields with `repr`, ready for JSON."""
        names = [item.name for item in fields(self) if item.repr]  # type: ignore[arg-type]
        return {name: plain(getattr(self, name)) for name in (*names, *self.derived)}

    def to_pandas(self) -> DataFrame:
        """Return the columns as a data frame, with units in `attrs["units"]`.

        Raises:
            MissingPackageError: If pandas is not installed.
        """
        require(("pandas",), "pandas", "data frames require pandas")
        from pandas import DataFrame

        frame = DataFrame(self.columns())
        frame.attrs["units"] = {name: unit for name, unit in self.units.items() if name in frame}
        return frame

    @checked
    def plot(
        self,
        path: Path | str | None = None,
        picture: str | None = None,
        *,
        ax: Any = None,
        width: float | None = None,
        bare: bool = False,
    ) -> Any:
        """Draw a chart; return the matplotlib figure, or the path of the file.

        Args:
            path: File to write; None to return the figure.
            picture: One of `pictures` by name; the first by default.
            ax: matplotlib axes to draw into, for a chart with one panel; None for a new figure.
            width: Width of the figure [inch], at most 8 by default.
            bare: True to omit headline and conditions, as above a caption.

        Raises:
            MissingPackageError: If matplotlib is not installed.
            NotImplementedError: If the result has no chart.
            ParameterError: If there is no such picture, a value is outside its bounds, or the chart has several panels
                and cannot be drawn into one axes.
        """
        return self._plotted(self._draw, path, picture, ax, width, bare)

    def _plotted(
        self,
        draw: Callable[[Callable[..., Any]], Any],
        path: Path | str | None,
        picture: str | None,
        ax: Any,
        width: float | None,
        bare: bool,
    ) -> Any:
        """Return what `plot` does, of a function that calls the drawing function."""
        names = self.pictures
        if not names:
            raise NotImplementedError(f"{type(self).__name__} has no chart")
        from maglev_mj.pictures import plotted  # imported here: slow

        chosen = next(iter(names)) if picture is None else picture
        check_one_of("picture", names, chosen)
        return plotted(lambda: draw(loaded(names[chosen])), path, ax=ax, width=width, bare=bare)

    def _draw(self, function: Callable[..., Any]) -> Any:
        """Return the figure of a drawing function."""
        return function(self)

    def __repr__(self) -> str:
        try:
            text = str(self.table())
        except MaglevError as error:
            text = f"{type(self).__name__.lower()}: {error}"
        if len(text.encode()) <= _MAX_REPR:
            return text
        return text.encode()[: _MAX_REPR - 3].decode(errors="ignore") + "…"

    def _repr_html_(self) -> str:
        return self.table()._repr_html_()

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        cls.__repr__ = Result.__repr__  # type: ignore[method-assign]  # replaces the repr generated by dataclass
        for name in {"table", "as_json"} & vars(cls).keys():
            setattr(cls, name, _with_headline(vars(cls)[name]))


def plain(value: Any) -> Any:
    """Convert a value for JSON; a number that is not finite becomes None, a complex one its parts."""
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, complex):
        return [plain(value.real), plain(value.imag)]
    if isinstance(value, float) and not hasattr(value, "as_json"):
        return float(value) if math.isfinite(value) else None
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, type):
        return getattr(value, "name", value.__name__)
    if hasattr(value, "as_json"):
        return plain(value.as_json())
    if hasattr(value, "_asdict"):
        value = value._asdict()
    elif is_dataclass(value):
        value = {item.name: getattr(value, item.name) for item in fields(value)}
    if isinstance(value, Mapping):
        return {name: plain(item) for name, item in value.items()}
    return [plain(item) for item in value]


def with_unit(name: str, unit: str | None) -> str:
    """Return a column name with its unit in brackets."""
    return f"{name} [{unit}]" if unit else name


def _cells(tag: str, values: Sequence[Any]) -> str:
    return "".join(f"<{tag}>{escape(_text(value))}</{tag}>" for value in values)


def _text(value: Any) -> str:
    more = "more than " * bool(getattr(value, "beyond", False))  # of a bound
    return more + number_text(value) if isinstance(value, float) else printable(str(value))


def _has_words(text: str) -> bool:
    """Return True for a text cell, which is left-aligned."""
    return any(map(str.isalpha, _IN_NUMBERS.sub("", text)))


def _narrowed(columns: list[list[str]], wraps: bool) -> list[list[str]]:
    """Move units below the column names if the table is too wide otherwise."""
    widths = [max(map(len, column)) + 1 for column in columns]
    widths[-1:] = [min(widths[-1], _NARROWEST) if wraps else widths[-1]] if columns else []
    heads = [column[0].partition(" [") for column in columns]
    if len(_INDENT) + sum(widths) <= width() or not any(mark for _, mark, _ in heads):
        return columns
    return [[name, mark.strip() + unit, *column[1:]] for (name, mark, unit), column in zip(heads, columns)]


def _fitting(indices: Sequence[int], around: Sequence[int], widths: Sequence[int], gap: str) -> list[list[int]]:
    """Group columns so that each group fits the width next to the fixed columns."""
    groups: list[list[int]] = [[]]
    for index in indices:
        used = len(_INDENT) + sum(widths[column] + len(gap) for column in [*around, *groups[-1]])
        if groups[-1] and used + widths[index] > width():
            groups.append([])
        groups[-1].append(index)
    return groups


def _block(columns: Sequence[Sequence[str]], left: Sequence[bool], gap: str) -> list[str]:
    """Return the lines of adjacent columns; where they are too wide, a last and a first text column are wrapped."""
    if not columns:
        return []
    widths = [max(map(len, column)) for column in columns]
    excess = len(_INDENT) + sum(widths) + len(gap) * (len(widths) - 1) - width()
    for index, least in ((-1, _NARROWEST), (0, _NARROWEST), (-1, _LEAST)):
        if left[index] and excess > 0:
            cut = min(excess, max(widths[index] - least, 0))
            widths[index], excess = widths[index] - cut, excess - cut
    lines = []
    for row in zip(*columns):
        last, size = len(row) - 1, widths
        texts = [
            [part.replace("\0", " ") for part in wrap(joined(text), size[index], break_on_hyphens=False)]
            if left[index] and index in (0, last)
            else [text]
            for index, text in enumerate(row)
        ]
        for parts in zip_longest(*texts, fillvalue=""):
            cells = [f"{text:{'<' if words else '>'}{one}}" for text, words, one in zip(parts, left, size)]
            lines.append((_INDENT + gap.join(cells)).rstrip())
    return [line for line in lines if line]
