"""Common parts of charts: figures, legends, columns, files."""

from __future__ import annotations

import math
import os
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from functools import wraps
from io import BytesIO
from pathlib import Path
from typing import Any, ParamSpec, TypeAlias, TypeVar, overload

import numpy as np

from maglev_mj import errors
from maglev_mj.colours import GRID, REFERENCE, SERIES, WALL
from maglev_mj.errors import ParameterError, check_instance, check_one_of
from maglev_mj.files import atomic_path

FIRST, SECOND = SERIES[:2]
SHADE: dict[str, Any] = {"color": WALL, "alpha": 0.15, "linewidth": 0.0, "zorder": 0}
"""Style of shaded areas, e.g. inside a wall."""

_LIMIT: dict[str, Any] = {"color": "black", "linestyle": (0, (6, 3)), "linewidth": 1.0}

BESIDE: dict[str, Any] = {"loc": "center left", "bbox_to_anchor": (1.0, 0.5), "frameon": False, "fontsize": 9.0}
"""Style of a legend to the right of its panel."""

TITLE: dict[str, Any] = {"loc": "left", "fontsize": "medium"}
"""Style of a panel title."""

WIDTH = 8.0
"""Default width of a chart [inch]; pages show up to 8.6 (830 px) without scaling."""

_WIDTHS = 2.5, 20.0
_NARROW, _LEAST_PANEL = 5.0, 2.4
"""Width of a chart with smaller letters, and of a panel beside others [inch]."""

FORMATS = "png", "pdf", "svg"
"""Chart formats."""

_DASHES = (), (4, 1.5), (5, 1.5, 1, 1.5), (1.5, 1), (7, 1.5), (4, 1, 1, 1, 1, 1), (1, 2.2), (3, 1, 3, 1, 1, 1)

Quantities: TypeAlias = Mapping[str, tuple[Any, str]]
"""Arrays of values (NaN is ignored) and unit of each quantity by name."""

_NOISE = {"mm": 1e-3, "mrad": 1e-3, "mm/s": 0.1, "mrad/s": 0.1, "N": 1e-3, "N m": 1e-5}
"""Range by unit up to which a quantity counts as constant."""

_LETTER, _SAMPLE = 0.54 / 72.0, 0.57  # width of a letter [inch/pt] and of a line sample in a legend [inch]
_PLAIN, _DENSE = (1e-3, 1e4), 200.0  # numbers written out, and the ratio of a short logarithmic axis
_FLAT = 1e-3  # the same, relative to the value
_COLUMNS = 3  # per row of a grid
_LARGE, _MANY = 300_000, 1000  # SVG size [bytes] above which curves of this many points are rasterised
_NOTEBOOK_DPI = 100.0
_TICK_SIZE = _LEGEND_SIZE = 9.0  # [pt]
_HEADLINE, _DETAIL = (11.0, 81), (9.0, 108)  # size [pt] and letters across a chart
_SHRUNK = 1.3  # a headline longer than a line by this factor is wrapped
_TICKS = "xtick.labelsize", "ytick.labelsize"
_SMALL, _SMALLEST = 8.5, 8.0
"""Sizes of letters, and of those of ticks and legends, in a narrow chart [pt]."""
_LEAST_ROW = 3.0
"""Height of a row that narrow panels keep, with labels and legend [inch]."""
_UNDER = 36.0  # gap between a panel and its legend, for ticks, tick labels and axis label [pt]


@dataclass(frozen=True)
class PictureFolder:
    """Output folder and format of charts.

    Attributes:
        folder: The folder; created with the first file.
        format: One of `FORMATS`.
        width: Width of each chart [inch]; None for the default.
        bare: True to omit headline and conditions.

    Raises:
        ParameterError: If the format is unknown, or the width is outside its bounds.
    """

    folder: Path
    format: str = FORMATS[0]
    width: float | None = None
    bare: bool = False

    def __post_init__(self) -> None:
        check_one_of("format", FORMATS, self.format)
        checked_width(self.width)

    def plot(self, result: Any, name: str = "", **keywords: Any) -> Path:
        """Draw a chart of a result in this format and width.

        Args:
            result: The result.
            name: File stem; that of the picture by default.
            keywords: Further keywords of the result's `plot`, such as `picture`.
        """
        path = self.path(name or keywords["picture"])
        return Path(result.plot(path, width=self.width, bare=self.bare, **keywords))

    def path(self, name: str, ending: str | None = None) -> Path:
        """Return the path of a file; create its folder.

        Args:
            name: File stem.
            ending: Suffix, if it differs from the format.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        return self.folder / f"{name}.{ending or self.format}"


_P = ParamSpec("_P")
_T = TypeVar("_T")


@dataclass(frozen=True)
class _Page:
    """Where a chart is drawn: width [inch], without headline if bare, into other axes if there are some."""

    width: float = WIDTH
    bare: bool = False
    ax: Any = None


_DEFAULT = _Page()
_page = ContextVar("page", default=_DEFAULT)


def checked_width(width: float | None) -> float:
    """Return the width of a chart [inch], the default for None.

    Raises:
        ParameterError: If it is not a number, or outside its bounds.
    """
    if width is None:
        return WIDTH
    low, high = _WIDTHS
    if isinstance(width, bool) or not isinstance(width, int | float) or not low <= width <= high:
        raise ParameterError(f"width must be a number between {low:g} and {high:g} inches (got {width!r})")
    return float(width)


def plotted(draw: Callable[[], Any], path: Path | str | None, *, ax: Any, width: float | None, bare: bool) -> Any:
    """Draw a chart and save it; see `Result.plot`.

    Args:
        draw: Function that draws it and returns its figure.
        path: See `Result.plot`, as all others.
        ax: See there.
        width: See there.
        bare: See there.
    """
    require()
    if ax is not None:
        from matplotlib.axes import Axes

        check_instance("ax", ax, Axes, "matplotlib axes")
        if path is not None or width is not None:
            raise ParameterError("ax must be omitted with path or width: its own figure has a size and is saved by you")
    before = _page.set(_Page(checked_width(width), bare, ax))
    try:
        figure = draw()
    finally:
        _page.reset(before)
    return save(figure, path)


def fitting(columns: int) -> int:
    """Return how many of some panels fit beside one another."""
    return max(min(columns, int(_page.get().width / _LEAST_PANEL)), 1)


def in_own_axes() -> bool:
    """Return True if a chart is drawn into axes passed to `plot`, which hold one panel."""
    return _page.get().ax is not None


def wide_share() -> float:
    """Return the width of the chart, relative to the default."""
    return _page.get().width / WIDTH


def require() -> None:
    """Check that charts can be drawn, and import matplotlib.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    errors.require(("matplotlib",), "charts", "charts require matplotlib")
    if "matplotlib" not in sys.modules:
        # a notebook's backend need not exist here, and files need none
        backend = os.environ.pop("MPLBACKEND", None)
        import matplotlib

        if backend is not None:
            os.environ["MPLBACKEND"] = backend
            with suppress(ValueError):
                matplotlib.rcParams["backend"] = backend  # for the user's own figures


@contextmanager
def own_style() -> Iterator[None]:
    """Use matplotlib's defaults, and fonts that publishers accept, whatever the user's settings; restore these."""
    require()
    import matplotlib

    with matplotlib.rc_context():
        matplotlib.rcdefaults()  # all but the backend
        _set_style()
        if _page.get().width < _NARROW:
            sizes: dict[Any, Any] = {"font.size": _SMALL} | dict.fromkeys(_TICKS, _SMALLEST)
            matplotlib.rcParams.update(sizes)
        yield


def _set_style() -> None:
    """Set colours, grid and fonts of all charts."""
    import matplotlib
    from cycler import cycler

    matplotlib.rcParams.update(
        {
            **{"pdf.fonttype": 42, "ps.fonttype": 42},  # TrueType
            **{"axes.prop_cycle": cycler(color=SERIES), "axes.axisbelow": True},
            **{"axes.grid": True, "grid.color": GRID, "grid.linewidth": 0.8},
            **{"axes.spines.top": False, "axes.spines.right": False},
            **{"xtick.labelsize": _TICK_SIZE, "ytick.labelsize": _TICK_SIZE},
        }
    )


def use_style() -> None:
    """Give figures that you draw with pyplot the style of the package's charts, with the title as headline.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    require()
    import matplotlib

    _set_style()
    size, _ = _HEADLINE
    head: dict[Any, Any] = {"axes.titlelocation": "left", "axes.titleweight": "bold", "axes.titlesize": size}
    figure: dict[Any, Any] = {"figure.figsize": (7.5, 3.2), "figure.constrained_layout.use": True}
    suptitle: dict[Any, Any] = {"figure.titleweight": "bold", "figure.titlesize": size}
    legend: dict[Any, Any] = {"legend.edgecolor": "none", "legend.framealpha": 0.85, "legend.fontsize": _LEGEND_SIZE}
    matplotlib.rcParams.update({**head, **figure, **suptitle, **legend})


def drawn(function: Callable[_P, _T]) -> Callable[_P, _T]:
    """Make a function that draws a chart use `own_style`."""

    @wraps(function)
    def styled(*values: _P.args, **keywords: _P.kwargs) -> _T:
        with own_style():
            return function(*values, **keywords)

    return styled


@drawn
def new_figure(
    head: Sequence[str], rows: int, columns: int, height: float, *, least: float = _LEAST_ROW, **options: Any
) -> tuple[Any, list[Any]]:
    """Return a figure and its panels, row by row.

    Args:
        head: Headline, the finding in one sentence; then smaller lines: scene, timing and constant parameters.
        rows: Rows of panels.
        columns: Columns of panels.
        height: Height without the head, of panels of the default width [inch].
        least: Height of a row that narrower panels keep [inch].
        options: Options of matplotlib's `Figure.subplots`.

    Raises:
        ParameterError: If there are several panels, and axes for one were passed to `plot`.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    class NotebookFigure(Figure):
        """Figure displayed by a notebook without pyplot."""

        @drawn
        def savefig(self, *values: Any, **keywords: Any) -> None:
            super().savefig(*values, **keywords)

        def _repr_png_(self) -> bytes:
            file = BytesIO()
            self.savefig(file, dpi=_NOTEBOOK_DPI)
            return file.getvalue()

    page = _page.get()
    if page.ax is not None:
        if rows * columns > 1:
            raise ParameterError("ax must be omitted: this chart has several panels, and a figure of its own")
        return page.ax.figure, [page.ax]
    fit = fitting(columns)
    lines = -(-rows * columns // fit)
    if fit < columns:  # below one another, in the order of reading
        ratios = options.pop("height_ratios", None)
        options |= {} if ratios is None else {"height_ratios": np.repeat(ratios, columns)}
        options["sharey"] = options.get("sharey") is True
    row = height / rows
    row = min(max(row * page.width / WIDTH * columns / fit, least), row)
    figure = NotebookFigure(figsize=(page.width, row * lines), layout="constrained")
    FigureCanvasAgg(figure)
    axes = list(np.atleast_1d(figure.subplots(lines, fit, **options)).ravel())
    for panel in axes:
        panel.locator_params(axis="x", nbins=max(int(12 * wide_share()) // fit, 4))  # avoid overlapping tick labels
    if not page.bare:
        _add_head(figure, *head)
    for panel in axes[rows * columns :]:
        panel.set_axis_off()
    return figure, axes[: rows * columns]


def _add_head(figure: Any, headline: str, *details: str) -> None:
    """Write the headline in bold, and the details below it; both are wrapped, and the figure grows by their height.

    A headline that is slightly too long for one line is written smaller instead.
    """
    from matplotlib.text import Annotation

    (large, wide), (small, narrow) = ((size, int(letters * wide_share())) for size, letters in (_HEADLINE, _DETAIL))
    details = tuple(filter(None, details))
    if wide < len(headline) <= _SHRUNK * wide:
        large, wide = large * wide / len(headline), len(headline)
    lines = textwrap.wrap(headline, wide)
    below = [line for text in details for line in textwrap.wrap(_unbroken(text), narrow)]
    down = -1.2 * large * len(lines) - 2.0
    lines += [""] * math.ceil(len(below) * small / large)  # room for the details
    title = figure.suptitle("\n".join(lines), x=0.01, ha="left", fontsize=large, fontweight="bold")
    place: dict[str, Any] = {"xytext": (0.0, down), "textcoords": "offset points", "va": "top"}
    style: dict[str, Any] = {"fontsize": small, "color": REFERENCE, "annotation_clip": False}
    note = Annotation("\n".join(below), (0.0, 1.0), xycoords=title, **place, **style)
    note.set_figure(figure)
    figure.texts.append(note)
    figure.set_figheight(figure.get_figheight() + len(lines) * 1.3 * large / 72.0)


def label_rows(*rows: tuple[Sequence[Any], str]) -> None:
    """Label the y axes of rows of panels that share them: the first of each row, or all of panels below one another.

    Of the latter, which share an x axis too, the lowest keeps its label.
    """
    panels = [panel for row, _ in rows for panel in row]
    stacked = panels[0].get_gridspec().ncols == 1
    for row, label in rows:
        for panel in row if stacked else row[:1]:
            panel.set_ylabel(label)
            if stacked:
                panel.sharey(row[0]) if panel is not row[0] else None
    for panel in panels[:-1] if stacked else ():
        panel.set_xlabel("")


@drawn
def new_grid(
    head: Sequence[str],
    quantities: Quantities,
    along: str,
    *,
    high: int = 0,
    row: float = 2.8,
    more: float = 0.6,
    always: str = "",
    **options: Any,
) -> tuple[Any, dict[str, Any]]:
    """Return a figure with a panel, by name, for each quantity that varies; its head also names the constant ones.

    Args:
        head: See `new_figure`.
        quantities: One or more; if all are constant, the first has a panel.
        along: Label of the shared x axis.
        high: Maximum number of panels in a column, with y labels; 0 for titled panels, three in a row.
        row: Height of a row [inch].
        more: Additional height [inch].
        always: Name of a quantity that has a panel in any case.
        options: Options of matplotlib's `Figure.subplots`.
    """
    ranges = {name: _range(values) for name, (values, _) in quantities.items()}
    least = {name: max(_NOISE.get(unit, 0.0), _FLAT * abs(ranges[name][0])) for name, (_, unit) in quantities.items()}
    names = [name for name in quantities if ranges[name][1] > least[name] or name == always] or list(quantities)[:1]
    columns = fitting(-(-len(names) // (high or -(-len(names) // _COLUMNS))))
    rows = -(-len(names) // columns)
    others = ", ".join(name.replace("_", " ") for name in quantities if name not in names)
    head = [*head, *[f"not shown (constant): {others}"] * bool(others)]
    figure, panels = new_figure(head, rows, columns, more + row * rows, sharex=True, **options)
    if high:  # column by column
        panels = [panel for column in range(columns) for panel in panels[column::columns]]
    lowest = {}
    for name, panel in zip(names, panels):
        label, margin = axis_label(name, quantities[name][1]), 10.0 * least[name]
        panel.update_datalim([(0.0, ranges[name][0] + end) for end in (-margin, margin)], updatex=False)
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
    return figure, dict(zip(names, panels))


def _unbroken(text: str) -> str:
    """Return a list in words with spaces that do not break within an item, as between value and unit."""
    return ", ".join(item.replace(" ", "\N{NO-BREAK SPACE}") for item in text.split(", "))


def _range(values: Any) -> tuple[float, float]:
    """Return midpoint and width of the range of arrays of values."""
    finite = np.concatenate([*map(np.ravel, values)]).astype(np.float64)
    finite = finite[np.isfinite(finite)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
    return 0.5 * (low + high), high - low


def broken(x: Any, y: Any) -> tuple[Any, Any]:
    """Return curves, (M,) and (M, N), with a gap at each jump.

    A jump is a step of more than a tenth of the range and ten times the smaller step beside it; in a constant curve
    there is none.

    Example:
        >>> from maglev_mj.pictures import broken
        >>> broken([0.0, 1.0, 2.0, 3.0], [0.0, 0.1, 9.1, 9.2])[0].tolist()
        [0.0, 1.0, 1.5, 2.0, 3.0]
    """
    x, y = np.asarray(x, dtype=float), np.asarray(y, dtype=float)
    steps = np.abs(np.diff(y.reshape(len(y), -1), axis=0))
    padded = np.pad(steps, ((1, 1), (0, 0)), constant_values=np.inf)
    ranges = np.ptp(y.reshape(len(y), -1), axis=0)
    least = np.maximum(0.1 * ranges, _FLAT * np.abs(y.reshape(len(y), -1)).max(axis=0))
    jumps = (steps > least) & (steps > 10.0 * np.minimum(padded[:-2], padded[2:]))
    after = np.flatnonzero(jumps.any(axis=1)) + 1
    return np.insert(x, after, 0.5 * (x[after - 1] + x[after])), np.insert(y, after, np.nan, axis=0)


def draw_limit(panel: Any, scene: Any) -> None:
    """Draw the vertical force limit of a scene's device, if a third of it is reached."""
    limit, peak = scene.body.force_limit, np.nanmax(np.abs(panel.dataLim.intervaly))
    if scene.axis == "z" and limit < 3.0 * peak:
        panel.axhline(limit, label=f"force limit, {limit:.4g} N", **_LIMIT)


def draw_walls(panel: Any, faces: Iterable[tuple[float, float]]) -> None:
    """Shade the walls near the range shown.

    Args:
        panel: Panel with a position [mm, mrad] upwards.
        faces: Normal, 1 or -1, and edge [m, rad] of each wall.
    """
    bottom, top = panel.get_ylim()
    margin = 0.08 * (top - bottom)
    label = "wall"
    for normal, edge in ((normal, 1e3 * edge) for normal, edge in faces):
        if normal > 0.0 and edge > bottom - margin:
            bottom = min(bottom, edge - margin)
            panel.axhspan(bottom - 1e3, edge, label=label, **SHADE)
        elif normal < 0.0 and edge < top + margin:
            top = max(top, edge + margin)
            panel.axhspan(edge, top + 1e3, label=label, **SHADE)
        else:
            continue
        label = ""
    panel.set_ylim(bottom, top)


def plain_numbers(axis: Any) -> None:
    """Write the numbers of a logarithmic axis as 0.01 or 2000 while they are short; at 1, 2 and 5 on a short axis."""
    from matplotlib.ticker import FuncFormatter, LogFormatterSciNotation, LogLocator, NullFormatter

    low, high = axis.get_data_interval()
    if not 0.0 < low <= high:
        return
    short = low >= 0.5 * _PLAIN[0] and high <= 2.0 * _PLAIN[1]
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}") if short else LogFormatterSciNotation())
    axis.set_minor_formatter(NullFormatter())
    if short and high / low < _DENSE:
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))


def axis_label(name: str, unit: str | None) -> str:
    """Return the name of a quantity with its unit in parentheses."""
    return f"{name.replace('_', ' ')} ({unit})" if unit else name.replace("_", " ")


def line_style(index: int) -> dict[str, Any]:
    """Return colour and dash of a curve, distinct for 56 curves.

    The first eight have distinct dashes, for print without colour.

    Example:
        >>> from maglev_mj.pictures import line_style
        >>> line_style(0)["linestyle"]
        '-'
    """
    dashes = _DASHES[index % len(_DASHES)]
    return {"color": SERIES[index % len(SERIES)], "linestyle": (0, dashes) if dashes else "-"}


@overload
def save(figure: Any, path: Path | str) -> Path: ...


@overload
def save(figure: Any, path: Path | str | None) -> Any: ...


def save(figure: Any, path: Path | str | None) -> Any:
    """Write a figure and return the path; without a path, return the figure.

    Long curves of a large SVG are rasterised.
    """
    if path is None:
        return figure
    path = errors.file_path(path)
    dpi = 150 if path.suffix == ".png" else 110  # for rasterised curves
    with atomic_path(path) as partial:
        figure.savefig(partial, dpi=dpi, format=path.suffix[1:] or FORMATS[0])
        if path.suffix == ".svg" and partial.stat().st_size > _LARGE:
            for line in (line for panel in figure.axes for line in panel.lines if len(line.get_xdata()) > _MANY):
                line.set_rasterized(True)
            figure.savefig(partial, dpi=dpi, format="svg")
    return path


def name_curves(target: Any, panels: Sequence[Any] = ()) -> None:
    """Add a legend under a panel, or under a figure for several panels; none without labels.

    Args:
        target: The figure or panel.
        panels: Panels whose curves are in the figure's legend, each label once.
    """
    import matplotlib.transforms as moves

    entries: dict[str, Any] = {}
    for panel in panels or (target,):
        handles, labels = panel.get_legend_handles_labels()
        entries |= {label: handle for label, handle in zip(labels, handles, strict=True) if label not in entries}
    if not entries:
        return
    page = _page.get()
    size = _SMALLEST if page.width < _NARROW else _LEGEND_SIZE
    if page.ax is not None:  # where the user's own layout leaves room
        page.ax.legend(entries.values(), entries.keys(), loc="best", fontsize=_SMALLEST)
        return
    options: dict[str, Any] = {"loc": "outside lower center"}
    width = page.width
    if not panels:
        width = _width(target.get_gridspec().ncols)
        down = moves.ScaledTranslation(0.0, -_UNDER / 72.0, target.figure.dpi_scale_trans)
        options = {"loc": "upper center", "bbox_to_anchor": (0.5, 0.0), "bbox_transform": target.transAxes + down}
        options["borderaxespad"] = 0.0
    elif (gap := _gap(target)) is not None:
        entries_width = max(map(len, entries)) * _LETTER * size + _SAMPLE
        if entries_width <= gap.get_gridspec().figure.get_figwidth() / gap.get_gridspec().ncols:
            gap.legend(entries.values(), entries.keys(), loc="center", frameon=False, fontsize=size)
            return
    options |= {
        "ncols": _columns(list(entries), width),
        "columnspacing": 1.2,
        "handlelength": 2.4,
        "frameon": False,
        "fontsize": size,
    }
    target.legend(entries.values(), entries.keys(), **options)


def _gap(figure: Any) -> Any:
    """Return the empty cell at the end of a grid of panels; None if the grid is full."""
    last = figure.axes[-1] if figure.axes else None
    return None if last is None or last.axison or last.get_subplotspec() is None else last


def _width(columns: int) -> float:
    """Return the width of a legend under a panel [inch]."""
    width = _page.get().width
    return width if columns == 1 else width / columns - 0.4


def _columns(names: Sequence[str], width: float) -> int:
    """Return the number of legend columns of about equal length for a width [inch]."""
    lengths = np.array([len(name) * _LETTER * _LEGEND_SIZE + _SAMPLE for name in names])  # with its line sample
    counts = range(len(names), 0, -1)
    fitting = (count for count in counts if sum(part.max() for part in np.array_split(lengths, count)) <= width)
    rows = -(-len(names) // next(fitting, 1))
    return max(-(-len(names) // max(rows, 1)), 1)


@dataclass(frozen=True, kw_only=True)
class ChartPanel:
    """Panel of curves.

    Attributes:
        title: Title.
        labels: Labels of the x and y axes.
        curves: Label, x and y of each curve.
        log: Logarithmic axes: "", "x", "y" or "xy".
        level: y of a thin horizontal line; None for none.
        top: Upper limit of y; None for automatic.
        marked: True to mark points.
        outside: Mask of points outside the device's range, per curve; drawn hollow. Empty for none.
    """

    title: str
    labels: tuple[str, str]
    curves: Sequence[tuple[str, Any, Any]]
    log: str = ""
    level: float | None = None
    top: float | None = None
    marked: bool = False
    outside: Sequence[Any] = ()


@drawn
def small_multiples(head: Sequence[str], panels: Sequence[ChartPanel], path: Path) -> Path:
    """Draw panels of curves in two columns.

    Args:
        head: See `new_figure`.
        panels: The panels, row by row.
        path: File to write.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    rows = -(-len(panels) // 2)
    names = [[label for label, _, _ in panel.curves] for panel in panels]
    lines = max(-(-len(labels) // _columns(labels, _width(2))) for labels in names)
    figure, axes = new_figure(head, rows, 2, rows * (3.3 + 0.19 * lines))
    for axis, panel in zip(axes, panels):
        for index, (label, x, y) in enumerate(panel.curves):
            style = line_style(index) | {"marker": "o" if panel.marked else None, "markersize": 4}
            axis.plot(x, y, label=label, linewidth=1.7, **style)
            if panel.outside and np.any(hollow := np.asarray(panel.outside[index])):
                style |= {"marker": "o", "markersize": 6, "markerfacecolor": "white", "linestyle": "none"}
                axis.plot(np.asarray(x)[hollow], np.asarray(y)[hollow], **style)
        axis.set(**{f"{name}scale": "log" for name in panel.log}, xlabel=panel.labels[0], ylabel=panel.labels[1])
        for name in panel.log:
            plain_numbers(axis.xaxis if name == "x" else axis.yaxis)
        if panel.level is not None:
            axis.axhline(panel.level, color=REFERENCE, linewidth=1.0, linestyle=":")
        if panel.top is not None:
            axis.set_ylim(-0.02 * panel.top if "y" not in panel.log else None, panel.top)
        axis.set_title(panel.title, **TITLE)
        if any(np.any(hollow) for hollow in panel.outside):
            hollow_point = {"color": REFERENCE, "markersize": 6, "markerfacecolor": "white"}
            axis.plot([], [], "o", label="hollow: outside the device's range", **hollow_point)
    for axis in axes[len(panels) :]:
        axis.set_axis_off()
    names = [axis.get_legend_handles_labels()[1] for axis in axes]
    longest = max(names, key=len)
    if all(labels == longest[: len(labels)] for labels in names):  # same curves in all panels
        name_curves(figure, axes)
    else:
        for axis in axes:
            name_curves(axis)
    return save(figure, path)
