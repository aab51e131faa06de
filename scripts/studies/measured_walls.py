"""Measured walls held against theory, with what delay, mass and damping that are not known would make of them.

The points are those of `measured_walls.toml` beside this file, or of your own file in its format.
"""

import math
import sys
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import shorten
from typing import Any

import numpy as np

from maglev_mj.cli.output import script_options
from maglev_mj.control import LowPass
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array
from maglev_mj.pictures import TITLE, line_style, name_curves, new_figure, save
from maglev_mj.theory import critical_delay, largest_stable_stiffness, spectral_radius, stiffest_wall

FILE = Path(__file__).with_suffix(".toml")
DELAY, MASS = 0.0005, 0.2
"""Steps of the sensitivity: delay [s], and mass as a fraction."""

_KINDS = "limit", "stable", "unstable"
_STATED = {"device": str, "sensor": str, "source": str, "reading": str, "kind": str, "rotary": bool, "opened": bool}
_NUMBERS = "mass", "own_damping", "period", "delay", "cutoff"
_STEPS = 24
_CURVE = 3
"""Least number of points with damping that make a curve."""


@dataclass(frozen=True)
class Series:
    """Points of one device under one condition, as `measured_walls.toml` describes them.

    Attributes:
        text: Stated texts and flags.
        loop: Known numbers of the loop: those of `mass`, `own_damping`, `period`, `delay` and `cutoff` that are stated
            or assumed [SI].
        assumed: Names of the numbers that the source does not state.
        points: Damping, NaN if the source states none, and stiffness, (N, 2).
    """

    text: Mapping[str, Any]
    loop: Mapping[str, float]
    assumed: Sequence[str]
    points: Array

    @property
    def missing(self) -> list[str]:
        """Numbers that theory needs and neither source nor file states."""
        return [name for name in ("mass", "period", "delay") if name not in self.loop]

    def keywords(self, **changes: Any) -> dict[str, Any]:
        """Return the keywords of the stability functions, with changes."""
        loop: dict[str, Any] = {"own_damping": 0.0, **self.loop, **changes}
        cutoff = loop.pop("cutoff", None)
        return {**loop, "velocity": None if cutoff is None else LowPass(cutoff=cutoff)}

    def critical(self, **changes: Any) -> Array:
        """Return the critical stiffness at the damping of each point, the greatest over all where none is stated."""
        around, damping = self.keywords(**changes), self.points[:, 0]
        known = np.isfinite(damping)
        limits = np.full(len(damping), math.nan)
        if known.any():
            wanted = {name: value[known] if np.ndim(value) else value for name, value in around.items()}
            limits[known] = largest_stable_stiffness(damping[known], **wanted)
        for index in np.flatnonzero(~known):
            one = {name: value[index] if np.ndim(value) else value for name, value in around.items()}
            limits[index] = stiffest_wall(**one).stiffness
        return limits

    def meeting_delay(self) -> Array:
        """Return the delay at which theory meets each point [s]: the critical delay of the measured wall.

        NaN without a stated damping.
        """
        around = self.keywords()
        del around["delay"]
        damping = self.points[:, 0]
        delays = critical_delay(self.points[:, 1], np.nan_to_num(damping), **around)
        return np.where(np.isfinite(damping), delays, math.nan)

    def meeting_damping(self) -> Array:
        """Return the least own damping at which theory allows each point; infinity above 10 m/T."""
        top = 10.0 * self.loop["mass"] / self.loop["period"]
        measured = self.points[:, 1]
        low, high = np.zeros(len(measured)), np.full(len(measured), top)
        enough = self.critical(own_damping=low) >= measured
        if enough.all():
            return low
        never = self.critical(own_damping=high) < measured
        for _ in range(_STEPS):
            middle = 0.5 * (low + high)
            reaches = self.critical(own_damping=middle) >= measured
            low, high = np.where(reaches, low, middle), np.where(reaches, middle, high)
        return np.where(enough, 0.0, np.where(never, math.inf, high))

    def needed_mass(self) -> Array:
        """Return the least mass at which theory allows each point, within 10 %; NaN if there is none up to 100."""
        masses = np.geomspace(1e-6, 100.0, 201)
        damping, stiffness = np.nan_to_num(self.points[:, 0]), self.points[:, 1]
        allowed = spectral_radius(stiffness, damping, **self.keywords(mass=masses[:, None])) < 1.0
        return np.where(allowed.any(axis=0), masses[np.argmax(allowed, axis=0)], math.nan)


def load(path: Path) -> list[Series]:
    """Return the series of a file.

    Raises:
        ParameterError: If the file is not in the format that `measured_walls.toml` describes.
    """
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8")).get("series", [])
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ParameterError(f"{path} cannot be read: {error}") from None
    if not tables or not isinstance(tables, list):
        raise ParameterError(f"{path} has no [[series]]")
    return [_series(table, f"{path.name}, series {index + 1}") for index, table in enumerate(tables)]


def _series(table: Mapping[str, Any], place: str) -> Series:
    unknown = {*table} - {*_STATED, *_NUMBERS, "assumed", "points"}
    if unknown:
        raise ParameterError(f"{place}: unknown keys {', '.join(sorted(unknown))}")
    for name, kind in _STATED.items():
        if not isinstance(table.get(name), kind):
            raise ParameterError(f"{place}: {name} must be a {kind.__name__} (got {table.get(name)!r})")
    if table["kind"] not in _KINDS:
        raise ParameterError(f"{place}: kind must be one of {', '.join(_KINDS)} (got {table['kind']!r})")
    loop = {name: table[name] for name in _NUMBERS if name in table}
    for name, value in loop.items():
        if not isinstance(value, int | float) or not math.isfinite(value) or value < 0.0:
            raise ParameterError(f"{place}: {name} must be a number, at least 0 (got {value!r})")
    assumed = table.get("assumed", [])
    if not isinstance(assumed, list) or {*assumed} - {*loop}:
        raise ParameterError(f"{place}: assumed must be a list of numbers in this series (got {assumed!r})")
    rows = table.get("points")
    if not isinstance(rows, list) or not rows or not all(isinstance(row, list) and len(row) in (1, 2) for row in rows):
        raise ParameterError(f"{place}: points must be rows [damping, stiffness] or [stiffness] (got {rows!r})")
    points = np.array([[math.nan] * (2 - len(row)) + row for row in rows], dtype=np.float64)
    if not (np.isfinite(points[:, 1]) & (points[:, 1] > 0.0)).all():
        raise ParameterError(f"{place}: stiffness must be above 0")
    text = {name: table[name] for name in _STATED}
    return Series(text, {name: float(value) for name, value in loop.items()}, assumed, points)


@dataclass(frozen=True)
class Comparison:
    """Theory at the points of one series, (N,) each.

    Attributes:
        theory: Critical stiffness.
        shorter, longer: The same with 0.5 ms less and more delay.
        lighter, heavier: The same with 20 % less and more mass.
        delay: Delay at which theory meets the point [s].
        damping: Least own damping at which theory allows the point.
    """

    theory: Array
    shorter: Array
    longer: Array
    lighter: Array
    heavier: Array
    delay: Array
    damping: Array


def compare(series: Series) -> Comparison:
    """Return theory at the points of a series that states, or assumes, mass, period and delay."""
    delay, mass = series.loop["delay"], series.loop["mass"]
    return Comparison(
        theory=series.critical(),
        shorter=series.critical(delay=max(delay - DELAY, 0.0)),
        longer=series.critical(delay=delay + DELAY),
        lighter=series.critical(mass=(1.0 - MASS) * mass),
        heavier=series.critical(mass=(1.0 + MASS) * mass),
        delay=series.meeting_delay(),
        damping=series.meeting_damping(),
    )


HEADS = "damping", "measured", "theory", "ratio", "-0.5 ms", "+0.5 ms", "-20 %", "+20 %", "delay [ms]", "own damping"


def _value(value: float, digits: int) -> str:
    return "-" if math.isnan(value) else "none" if math.isinf(value) else f"{value:.{digits}g}"


def _stiffness(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.0f}" if value >= 100.0 else f"{value:.3g}"


def lines(series: Series) -> Iterator[str]:
    """Yield the table of one series."""
    unit = "N m/rad, N m s/rad" if series.text["rotary"] else "N/m, N s/m"
    mark = "" if series.text["opened"] else ", not opened"
    yield f"{series.text['device']} ({series.text['kind']}{mark}; {unit})"
    names = {"period": "period [s]", "delay": "delay [s]", "cutoff": "cutoff [Hz]"}
    stated = [f"{names.get(name, name.replace('_', ' '))} {value:g}" for name, value in series.loop.items()]
    yield f"  {', '.join(stated) or 'nothing stated'}; assumed: {', '.join(series.assumed) or 'nothing'}"
    if series.missing:
        yield f"  not computed: {', '.join(series.missing)} not stated"
        if series.missing == ["mass"]:
            needed = series.needed_mass()
            kept = needed[np.isfinite(needed)]
            if kept.size:
                yield f"  least mass that allows a point: {kept.min():.2g} to {kept.max():.2g} ({kept.size} points)"
        for damping, stiffness in series.points:
            yield f"  {_value(damping, 4):>8} {_stiffness(stiffness):>9}"
        return
    found = compare(series)
    yield "  " + " ".join(f"{head:>{max(8, len(head))}}" for head in HEADS)
    for index, (damping, stiffness) in enumerate(series.points):
        theory = float(found.theory[index])
        cells = [
            _value(damping, 4),
            _stiffness(stiffness),
            _stiffness(theory),
            f"{stiffness / theory:.2f}" if theory > 0.0 else "-",
            *(_stiffness(part[index]) for part in (found.shorter, found.longer, found.lighter, found.heavier)),
            _value(1e3 * float(found.delay[index]), 3),
            _value(float(found.damping[index]), 2),
        ]
        yield "  " + " ".join(f"{cell:>{max(8, len(head))}}" for cell, head in zip(cells, HEADS, strict=True))
    if series.text["kind"] == "limit":
        yield from _one_delay(series, found)


def _one_delay(series: Series, found: Comparison) -> Iterator[str]:
    """Yield what one delay for all points with damping would make of them."""
    damped = _damped(series)
    if damped.size < _CURVE:
        return
    delays, measured = found.delay[damped], series.points[damped, 1]
    middle = float(np.median(delays))
    theory = series.critical(delay=middle)[damped]
    ratios = measured[theory > 0.0] / theory[theory > 0.0]
    yield f"  theory meets the points with damping at {1e3 * delays.min():.3g} to {1e3 * delays.max():.3g} ms"
    yield (
        f"  at the median, {1e3 * middle:.3g} ms, measured over theory is {ratios.min():.2g} to {ratios.max():.2g}"
        f" (median {np.median(ratios):.2f}); theory is 0 at {(theory <= 0.0).sum()} of {theory.size} points"
    )


def _damped(series: Series) -> Any:
    """Return the indices of the points with virtual damping."""
    return np.flatnonzero(series.points[:, 0] > 0.0)


def draw(every: Sequence[Series], path: Path) -> Path | None:
    """Draw each curve of at least three points with damping beside theory; None without one.

    Args:
        every: Series of a file.
        path: File to write.
    """
    chosen = [one for one in every if not one.missing and one.text["kind"] == "limit" and _damped(one).size >= _CURVE]
    if not chosen:
        return None
    columns = min(2, len(chosen))
    rows = -(-len(chosen) // columns)
    delays = [float(np.median(one.meeting_delay()[_damped(one)])) for one in chosen]
    shown = [f"{1e3 * delay:.2g} ms" for delay in (min(delays), max(delays))]
    finding = f"Theory meets measured walls at a median delay of {' to '.join(dict.fromkeys(shown))}"
    head = [finding, "critical stiffness over damping of the wall; above each panel that delay"]
    figure, panels = new_figure(head, rows, columns, 2.6 * rows)
    for panel, series, delay in zip(panels, chosen, delays):
        unit = ("N m s/rad", "N m/rad") if series.text["rotary"] else ("N s/m", "N/m")
        damping = np.linspace(0.0, float(np.nanmax(series.points[:, 0])), 60)
        grid = Series(series.text, series.loop, series.assumed, np.column_stack([damping, np.ones_like(damping)]))
        curves: dict[str, dict[str, float]] = {"theory, delay of the file": {}, "theory, that delay": {"delay": delay}}
        for index, (label, changes) in enumerate(curves.items()):
            panel.plot(damping, grid.critical(**changes), label=label, **line_style(index))
        panel.plot(*series.points.T, "o", color="black", markersize=4.0, label="measured")
        panel.set_ylim(0.0, 2.0 * series.points[:, 1].max())
        device = shorten(series.text["device"].rpartition("paddle, ")[2], 32, placeholder=" ...")
        panel.set_title(f"{device}: {1e3 * delay:.2g} ms", **TITLE)
        panel.set_xlabel(f"damping ({unit[0]})")
        panel.set_ylabel(f"stiffness ({unit[1]})")
    for panel in panels[len(chosen) :]:
        panel.axis("off")
    name_curves(figure, panels[:1])
    return Path(save(figure, path))


def main(path: Path = FILE) -> list[Series]:
    """Print all tables of a file, and return its series."""
    every = load(path)
    for number, series in enumerate(every):
        if number:
            print()
        print("\n".join(lines(series)))
        print(f"  source: {series.text['source']}")
    return every


if __name__ == "__main__":

    def add_file(parser: Any) -> None:
        """Add the option of the script."""
        parser.add_argument("file", nargs="?", type=Path, default=FILE, help="points (default: those of this folder)")

    options = script_options(__doc__, more=add_file)
    try:
        picture = draw(main(options.file), options.pictures.path("measured_walls"))
    except ParameterError as error:
        sys.exit(f"measured_walls.py: error: {error}")
    if picture:
        print("\nwrote", picture)
