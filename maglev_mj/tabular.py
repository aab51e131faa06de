"""Results as data frames, pictures and tables of a notebook."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from numpy.typing import NDArray

from maglev_mj.errors import require

if TYPE_CHECKING:
    from pandas import DataFrame

__all__ = ["Table", "Tabular"]

_MOST_ROWS, _MOST_COLUMNS = 8, 9


class Table(NamedTuple):
    """Rows under a title.

    Attributes:
        title: One line.
        head: Name of each column.
        rows: Texts and numbers.
        note: One line below it; empty for none.
    """

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[Any]]
    note: str = ""


class Tabular:
    """Result with data frame, picture and table.

    A subclass gives `columns` and `units`; `table` for a table other than the first rows of the columns.

    Class attributes:
        drawn_by: Function that draws it, as "module:function"; it is imported when a picture is asked for.
    """

    drawn_by: ClassVar[str]

    def columns(self) -> Mapping[str, NDArray[Any]]:
        """Return the columns by name, (N,) each."""
        raise NotImplementedError

    @property
    def units(self) -> Mapping[str, str]:
        """Unit of each column; empty or left out for none."""
        raise NotImplementedError

    def table(self) -> Table:
        """Return the table that a notebook shows."""
        columns, units = self.columns(), self.units
        shown = list(columns)[:_MOST_COLUMNS]
        rows = list(zip(*(columns[name][:_MOST_ROWS].tolist() for name in shown)))
        head = [f"{name} [{units[name]}]" if units.get(name) else name for name in shown]
        left = {"rows": len(columns[shown[0]]) - len(rows), "columns": len(columns) - len(shown)}
        note = " and ".join(f"{count} more {name}" for name, count in left.items() if count)
        return Table(type(self).__name__.lower(), head, rows, note)

    def to_pandas(self) -> DataFrame:
        """Return the columns as a data frame.

        Its `attrs["units"]` has their units.

        Raises:
            MissingPackageError: If pandas is not installed.
        """
        require(("pandas",), "pandas", "data frames need pandas")
        from pandas import DataFrame

        frame = DataFrame(self.columns())
        frame.attrs["units"] = {name: unit for name, unit in self.units.items() if name in frame}
        return frame

    def plot(self, **options: Any) -> Any:
        """Return a picture, a matplotlib figure.

        Args:
            options: Those of the function that draws it; see `drawn_by`.

        Raises:
            MissingPackageError: If matplotlib is not installed.
        """
        module, _, name = self.drawn_by.partition(":")
        return getattr(import_module(module), name)(self, **options)

    def _repr_html_(self) -> str:
        table = self.table()
        note = f"<p>{escape(table.note)}</p>" if table.note else ""
        rows = "".join(f"<tr>{_cells('td', row)}</tr>" for row in table.rows)
        return (
            f"<table><caption>{escape(table.title)}</caption><thead><tr>{_cells('th', table.head)}</tr></thead>"
            f"<tbody>{rows}</tbody></table>{note}"
        )


def _cells(tag: str, values: Sequence[Any]) -> str:
    return "".join(f"<{tag}>{escape(_text(value))}</{tag}>" for value in values)


def _text(value: Any) -> str:
    """Return a value as text, numbers to four digits.

    NaN is a dash.
    """
    if not isinstance(value, float):
        return str(value)
    if math.isnan(value):
        return "-"
    return f"{value:.0f}" if 1e4 <= abs(value) < 1e7 else f"{value:.4g}"
