"""Common parts of pictures: figures, legends, columns, files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, TypeAlias, overload

import numpy as np

from maglev_mj import errors
from maglev_mj.colours import GRID, REFERENCE, SERIES, WALL
from maglev_mj.errors import check_one_of

FIRST, SECOND = SERIES[:2]
SHADE: dict[str, Any] = {"color": WALL, "alpha": 0.15, "linewidth": 0.0, "zorder": 0}
"""Style of shaded areas, such as behind a wall's edge."""

BESIDE: dict[str, Any] = {"loc": "center left", "bbox_to_anchor": (1.0, 0.5), "frameon": False, "fontsize": 9.0}
"""Style of a legend at the right of its panel."""

TITLE: dict[str, Any] = {"loc": "left", "fontsize": 10.0}
"""Style of the title of a panel."""

HEAD: dict[str, Any] = {"x": 0.01, "ha": "left", "fontsize": 10.0}
"""Style of the title of a figure."""

WIDTH = 8.0
"""Width of every chart [inch].

A page shows no more than 8.6 (830 px), so that letters keep their size.
"""

FORMATS = "png", "pdf", "svg"
"""Formats of pictures."""

_DASHES = (), (4, 1.5), (5, 1.5, 1, 1.5), (1.5, 1), (7, 1.5), (4, 1, 1, 1, 1, 1), (1, 2.2), (3, 1, 3, 1, 1, 1)

Quantities: TypeAlias = Mapping[str, tuple[Any, str]]
"""Arrays of values, in which NaN does not count, and unit of each quantity by name."""

_NOISE = {"mm": 1e-3, "mrad": 1e-3, "mm/s": 0.1, "mrad/s": 0.1, "N": 1e-3, "N m": 1e-5}
"""Range by unit up to which a quantity is flat, by rounding or a sensor."""

_FLAT = 1e-3  # likewise, as a share of the value
_COLUMNS = 3  # of a grid
_LARGE, _MANY = 300_000, 1000  # size of an SVG [bytes], and points of a curve, which is then drawn as pixels
_SHOWN = 100.0  # resolution in a notebook [dots per inch]
_WORDS = 9.0  # size of a legend's words [pt]
_UNDER = 36.0  # what stands between a panel and its legend: ticks, their numbers, the axis' name [pt]


@dataclass(frozen=True)
class PictureFolder:
    """Folder that pictures go to, and their format.

    Attributes:
        folder: The folder; it is made with the first file.
        format: One of `FORMATS`.

    Raises:
        ParameterError: If there is no such format.
    """

    folder: Path
    format: str = FORMATS[0]

    def __post_init__(self) -> None:
        check_one_of("format", FORMATS, self.format)

    def path(self, name: str, ending: str | None = None) -> Path:
        """Return the path of a file, its folder made.

        Args:
            name: Of the file, without an ending.
            ending: Of a file that is no picture.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        return self.folder / f"{name}.{ending or self.format}"


def require() -> None:
    """Check that pictures can be drawn.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    errors.require(("matplotlib",), "charts", "pictures need matplotlib")


def new_figure(rows: int, columns: int, height: float, **options: Any) -> tuple[Any, list[Any]]:
    """Return a figure and its panels, row by row.

    It is `WIDTH` wide, `height` in inches.
    """
    require()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    class Shown(Figure):
        """Figure that a notebook shows, pyplot or not."""

        def _repr_png_(self) -> bytes:
            file = BytesIO()
            self.savefig(file, dpi=_SHOWN)
            return file.getvalue()

    figure = Shown(figsize=(WIDTH, height), layout="constrained")
    FigureCanvasAgg(figure)
    axes = list(np.atleast_1d(figure.subplots(rows, columns, **options)).ravel())
    for panel in axes:
        panel.grid(color=GRID, linewidth=0.8)
        panel.set_axisbelow(True)
        panel.tick_params(labelsize=9.0)
        panel.locator_params(axis="x", nbins=max(12 // columns, 4))  # so that numbers do not touch
        for side in ("top", "right"):
            panel.spines[side].set_visible(False)
    return figure, axes


def new_grid(
    quantities: Quantities,
    along: str,
    *,
    high: int = 0,
    row: float = 2.8,
    more: float = 0.6,
    always: str = "",
    **options: Any,
) -> tuple[Any, dict[str, Any]]:
    """Return a figure, and a panel by name for each quantity that changes.

    The figure names the others. Rounding alone does not fill a panel.

    Args:
        quantities: One or more; if none changes, the first has a panel.
        along: Label of the abscissa, which all share.
        high: Most panels below one another, with labels at their ordinates; 0 for titled ones, three in a row.
        row: Height of a row [inch].
        more: Height of all else [inch].
        always: Name of a quantity that has a panel in any case.
        options: Options of matplotlib's `Figure.subplots`.
    """
    ranges = {name: _range(values) for name, (values, _) in quantities.items()}
    least = {name: max(_NOISE.get(unit, 0.0), _FLAT * abs(ranges[name][0])) for name, (_, unit) in quantities.items()}
    names = [name for name in quantities if ranges[name][1] > least[name] or name == always] or list(quantities)[:1]
    columns = -(-len(names) // (high or -(-len(names) // _COLUMNS)))
    rows = -(-len(names) // columns)
    figure, panels = new_figure(rows, columns, more + row * rows, sharex=True, **options)
    if high:  # column by column
        panels = [panel for column in range(columns) for panel in panels[column::columns]]
    lowest = {}
    for name, panel in zip(names, panels):
        label, room = axis_label(name, quantities[name][1]), 10.0 * least[name]
        panel.update_datalim([(0.0, ranges[name][0] + end) for end in (-room, room)], updatex=False)
        if high:
            panel.set_ylabel(label)
        else:
            panel.set_title(label, **TITLE)
        lowest[panel.get_subplotspec().colspan.start] = panel
    for panel in lowest.values():
        panel.set_xlabel(along)
        panel.tick_params(labelbottom=True)
    for panel in panels[len(names) :]:
        panel.set_axis_off()
    if others := ", ".join(name.replace("_", " ") for name in quantities if name not in names):
        figure.suptitle(f"not shown (constant): {others}", **HEAD, color=REFERENCE)
    return figure, dict(zip(names, panels))


def _range(values: Any) -> tuple[float, float]:
    """Return middle and width of the range of arrays of values."""
    known = np.concatenate([*map(np.ravel, values)]).astype(np.float64)
    known = known[np.isfinite(known)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    return 0.5 * (low + high), high - low


def broken(x: Any, y: Any) -> tuple[Any, Any]:
    """Return curves, (M,) and (M, N), with a gap at each jump.

    A jump is a step of more than a tenth of the range and ten times the smaller step beside it.

    Example:
        >>> from maglev_mj.pictures import broken
        >>> broken([0.0, 1.0, 2.0, 3.0], [0.0, 0.1, 9.1, 9.2])[0].tolist()
        [0.0, 1.0, 1.5, 2.0, 3.0]
    """
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    steps = np.abs(np.diff(y.reshape(len(y), -1), axis=0))
    padded = np.pad(steps, ((1, 1), (0, 0)), constant_values=np.inf)
    jumps = (steps > 0.1 * np.ptp(y, axis=0)) & (steps > 10.0 * np.minimum(padded[:-2], padded[2:]))
    after = np.flatnonzero(jumps.any(axis=1)) + 1
    return np.insert(x, after, 0.5 * (x[after - 1] + x[after])), np.insert(y, after, np.nan, axis=0)


def axis_label(name: str, unit: str | None) -> str:
    """Return the name of a quantity with its unit in parentheses."""
    return f"{name.replace('_', ' ')} ({unit})" if unit else name.replace("_", " ")


def line_style(index: int) -> dict[str, Any]:
    """Return colour and dash of a curve, which differ from those of 55 others.

    The first eight have dashes of their own, for a print without colour.

    Example:
        >>> from maglev_mj.pictures import line_style
        >>> line_style(0)["linestyle"]
        '-'
    """
    dashes = _DASHES[index % len(_DASHES)]
    return {"color": SERIES[index % len(SERIES)], "linestyle": (0, dashes) if dashes else "-"}


@overload
def save(figure: Any, path: Path) -> Path: ...


@overload
def save(figure: Any, path: Path | None) -> Any: ...


def save(figure: Any, path: Path | None) -> Any:
    """Write the figure in its path's format; return the path.

    Long curves of an SVG that would be large are pixels. Without a path, return the figure.
    """
    if path is None:
        return figure
    dpi = 150 if path.suffix == ".png" else 110  # of the pixels among curves
    figure.savefig(path, dpi=dpi)
    if path.suffix == ".svg" and path.stat().st_size > _LARGE:
        for line in (line for panel in figure.axes for line in panel.lines if len(line.get_xdata()) > _MANY):
            line.set_rasterized(True)
        figure.savefig(path, dpi=dpi)
    return path


def name_curves(place: Any, panels: Sequence[Any] = ()) -> None:
    """Add a legend under a panel or a figure.

    Under the figure for several panels; none without a name.

    Args:
        place: The figure, or the panel.
        panels: Panels whose curves are named in the figure's legend, each name once.
    """
    import matplotlib.transforms as moves

    entries: dict[str, Any] = {}
    for panel in panels or (place,):
        handles, labels = panel.get_legend_handles_labels()
        entries |= {label: handle for label, handle in zip(labels, handles, strict=True) if label not in entries}
    if not entries:
        return
    options: dict[str, Any] = {"loc": "outside lower center"}
    width = WIDTH
    if not panels:
        width = _width(place.get_gridspec().ncols)
        down = moves.ScaledTranslation(0.0, -_UNDER / 72.0, place.figure.dpi_scale_trans)
        options = {"loc": "upper center", "bbox_to_anchor": (0.5, 0.0), "bbox_transform": place.transAxes + down}
        options["borderaxespad"] = 0.0
    options |= {
        "ncols": _columns(list(entries), width),
        "columnspacing": 1.2,
        "handlelength": 2.4,
        "frameon": False,
        "fontsize": _WORDS,
    }
    place.legend(entries.values(), entries.keys(), **options)


def _width(columns: int) -> float:
    """Return the width of a legend under a panel [inch]."""
    return WIDTH if columns == 1 else WIDTH / columns - 0.4


def _columns(names: Sequence[str], width: float) -> int:
    """Return the number of legend columns for a width [inch].

    Columns are of about the same length.
    """
    lengths = np.array([len(name) * 0.54 * _WORDS / 72.0 + 0.57 for name in names])  # each with its mark
    counts = range(len(names), 0, -1)
    fitting = (count for count in counts if sum(part.max() for part in np.array_split(lengths, count)) <= width)
    rows = -(-len(names) // next(fitting, 1))
    return max(-(-len(names) // max(rows, 1)), 1)


@dataclass(frozen=True, kw_only=True)
class Panel:
    """One picture among several.

    Attributes:
        title: Above it.
        labels: What the two axes say.
        curves: Label, abscissa and ordinate of each.
        log: Which axes are logarithmic: "", "x", "y" or "xy".
        level: Where a thin horizontal line is drawn; None for none.
        top: Upper end of the ordinate; None for what the curves need.
        marked: Whether points are marked.
        outside: For each curve, which points leave the device's range: they are drawn hollow. Empty for none.
    """

    title: str
    labels: tuple[str, str]
    curves: Sequence[tuple[str, Any, Any]]
    log: str = ""
    level: float | None = None
    top: float | None = None
    marked: bool = False
    outside: Sequence[Any] = ()


def small_multiples(panels: Sequence[Panel], path: Path) -> Path:
    """Draw panels of curves, two side by side.

    Args:
        panels: What to draw, row by row.
        path: File to write.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    rows = -(-len(panels) // 2)
    names = [[label for label, _, _ in panel.curves] for panel in panels]
    lines = max(-(-len(some) // _columns(some, _width(2))) for some in names)
    figure, axes = new_figure(rows, 2, rows * (3.3 + 0.19 * lines))
    for axis, panel in zip(axes, panels):
        for index, (label, x, y) in enumerate(panel.curves):
            style = line_style(index) | {"marker": "o" if panel.marked else None, "markersize": 4}
            axis.plot(x, y, label=label, linewidth=1.7, **style)
            if panel.outside and np.any(hollow := np.asarray(panel.outside[index])):
                style |= {"marker": "o", "markersize": 6, "markerfacecolor": "white", "linestyle": "none"}
                axis.plot(np.asarray(x)[hollow], np.asarray(y)[hollow], **style)
        axis.set(**{f"{name}scale": "log" for name in panel.log}, xlabel=panel.labels[0], ylabel=panel.labels[1])
        if panel.level is not None:
            axis.axhline(panel.level, color=REFERENCE, linewidth=1.0, linestyle=":")
        if panel.top is not None:
            axis.set_ylim(-0.02 * panel.top if "y" not in panel.log else None, panel.top)
        axis.set_title(panel.title, **TITLE)
        if any(np.any(hollow) for hollow in panel.outside):
            hollow_point = {"color": REFERENCE, "markersize": 6, "markerfacecolor": "white"}
            axis.plot([], [], "o", label="hollow: leaves the device's range", **hollow_point)
    for axis in axes[len(panels) :]:
        axis.set_axis_off()
    names = [axis.get_legend_handles_labels()[1] for axis in axes]
    longest = max(names, key=len)
    if all(some == longest[: len(some)] for some in names):  # the same curves in all
        name_curves(figure, axes)
    else:
        for axis in axes:
            name_curves(axis)
    return save(figure, path)
