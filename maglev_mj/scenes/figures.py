"""Figures of a run: functions of its result.

Each has a unit and a short help text.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from maglev_mj.frames import AXES, Array
from maglev_mj.metrics import BounceSummary, summarise_bounce
from maglev_mj.parameters import flag
from maglev_mj.result import number_text
from maglev_mj.scenes.press_figures import HIT_FIGURES, PressSummary, summarise_press

if TYPE_CHECKING:
    from maglev_mj.scenes.run import RunResult

_MOST_SHOWN = 4
_SHARES = 50.0, 5.0, 95.0
_SMALLER = {1.0: "", 1e3: "m", 1e6: "µ"}


@dataclass(frozen=True)
class Figure:
    """One figure of a run.

    Attributes:
        name: Its name.
        function: Function of a `RunResult` that returns a number, or a list of them; for a batch (..., N).
        unit: Unit in tables.
        help: Short description.
        scale: Factor from SI units to that unit.
        batched: True if the function takes a batch of devices at once, with the same bits as one by one.
        late: True if a missing figure counts as the largest in percentiles; otherwise it is left out.
        along: True if it is along the scene's axis, with the unit of a translation; see `unit_of`.

    Example:
        >>> from maglev_mj import find_scene, run
        >>> from maglev_mj.scenes.figures import Figure
        >>> lowest = Figure("lowest", lambda result: result.motion(result.times())[0].min(), "m")
        >>> round(float(lowest.function(run(find_scene("drop")(duration=0.1), plant="exact"))), 4)  # [m]
        -0.0025
    """

    name: str
    function: Callable[[RunResult], Any]
    unit: str = ""
    help: str = ""
    scale: float = 1.0
    batched: bool = True
    late: bool = False
    along: bool = False

    def __post_init__(self) -> None:
        flag("batched", self.batched)
        flag("late", self.late)
        flag("along", self.along)

    def __call__(self, result: RunResult) -> Any:
        """Return the figure of a result."""
        return self.function(result)

    @property
    def si_unit(self) -> str:
        """SI unit of the function's values; empty if not known."""
        prefix = _SMALLER.get(self.scale)
        return "" if prefix is None else self.unit.removeprefix(prefix)

    def text(self, value: Any, *bounds: Any) -> str:
        """Return one or several values, or a median with bounds.

        Bounds only if they differ.
        """
        values = np.atleast_1d(np.asarray(value, dtype=np.float64))
        if values.size > _MOST_SHOWN:
            return f"{self._number(values.min())} to {self._number(values.max())}"
        text = "/".join(self._number(one) for one in values)
        around = [self._number(bound) for bound in bounds]
        return f"{text} ({around[0]} to {around[1]})" if len(set(around)) > 1 else text

    def spread(self, values: Any) -> str:
        """Return median and 5 to 95 % over phases.

        Several hits are pooled.
        """
        pooled = np.ravel(values) if np.ndim(values) > 1 else values
        return self.text(*(self.percentile(pooled, share) for share in _SHARES))

    def _number(self, value: float) -> str:
        return number_text(value * self.scale, 3, 2) if self.unit else number_text(value, 6)

    def percentile(self, values: Array, share: float) -> Array:
        """Return a percentile over the runs, the first dimension.

        Args:
            values: Figures of N runs, (N, ...).
            share: Percentile in per cent.
        """
        if self.late:
            late = np.where(np.isnan(values), np.inf, values)
            if np.isinf(np.percentile(late, share, method="higher")):
                return np.array(np.nan)
            # a missing figure keeps its rank without an effect on the interpolation
            return np.asarray(np.percentile(np.where(np.isinf(late), np.finfo(float).max, late), share))

        def known(column: Array) -> float:
            found = column[np.isfinite(column)]
            return float(np.percentile(found, share)) if found.size else np.nan

        percentiles: Array = np.apply_along_axis(known, 0, np.asarray(values, dtype=np.float64))
        return percentiles


def figure(
    unit: str = "",
    help: str = "",
    *,
    scale: float = 1.0,
    batched: bool = False,
    late: bool = False,
    along: bool = False,
) -> Callable[[Callable[[RunResult], Any]], Figure]:
    """Make a figure of a function; see `Figure`.

    Example:
        >>> from maglev_mj import figure, find_scene, run
        >>> @figure("mm", "lowest point", scale=1e3)
        ... def lowest(result):
        ...     return result.motion(result.times())[0].min()
        >>> round(float(lowest.function(run(find_scene("drop")(duration=0.1), plant="exact"))), 4)  # [m]
        -0.0025
    """

    def make(function: Callable[[RunResult], Any]) -> Figure:
        return Figure(function.__name__, function, unit, help, scale, batched, late, along)

    return make


def figures_named(chosen: Sequence[Figure | str] | Mapping[str, Figure | str]) -> dict[str, Figure]:
    """Return figures by their JSON names.

    Raises:
        TypeError: If a name is not that of a stock figure.
    """
    if not isinstance(chosen, Mapping):
        chosen = {one if isinstance(one, str) else one.name: one for one in chosen}
    found = {}
    for name, one in chosen.items():
        if isinstance(one, str) and one not in STOCK:
            raise TypeError(f"figure must be one of {', '.join(STOCK)}, or made by @figure, not {one!r}")
        found[name] = STOCK[one] if isinstance(one, str) else one
    return found


def _bounce(name: str) -> Callable[[RunResult], Any]:
    """Return the function of one bounce figure.

    The wall fills the shown axis below 0.
    """

    def made(result: RunResult) -> BounceSummary:
        rest = getattr(result.scene, "rest", np.nan)
        return summarise_bounce(result.trace, rest, axis=AXES.index(result.scene.axis))

    return lambda result: getattr(result.once("bounce", made), name)


def _press(name: str) -> Callable[[RunResult], Any]:
    """Return the function of one hit or press figure."""

    def made(result: RunResult) -> PressSummary:
        scene: Any = result.scene
        settled = scene.path(result.phase).end
        return summarise_press(result.trace, scene.strokes(result.phase), settled, scene.end)

    return lambda result: getattr(result.once("press", made), name)


def changes(result: RunResult) -> list[int]:
    """Return the samples of changes in the friction state."""
    stuck = result.samples["stuck"][:, 0]
    found: list[int] = (np.flatnonzero(stuck[1:] != stuck[:-1]) + 1).tolist()
    return found


def _peak_speed(result: RunResult) -> Any:
    # greatest at a knot: the speed is linear between them
    return np.abs(result.line.twist[..., 0]).max(axis=0)


def _stick_time(result: RunResult) -> float:
    sticks = [result.sample_time[k] for k in changes(result) if result.samples["stuck"][k, 0]]
    return float(sticks[-1]) if sticks else np.nan


def _ripple(result: RunResult) -> Any:
    end = float(result.line.time[-1].min())
    return np.ptp(result.line.at(np.linspace(max(end - 0.05, 0.0), end, 501))[0][..., 0], axis=0)


def _press_name(name: str) -> str:
    return f"hit_{name}" if name in HIT_FIGURES else name if name == "absorbed" else f"press_{name}"


STOCK: Mapping[str, Figure] = {
    one.name: replace(one, along=True)
    for one in (
        Figure("penetration", _bounce("penetration"), "mm", "greatest depth behind the wall", 1e3, late=True),
        Figure("rebound", _bounce("rebound"), "mm", "greatest height after the first contact", 1e3, late=True),
        Figure("peak_force", _bounce("peak_force"), "N", "largest force of the actuators", late=True),
        Figure("settling_time", _bounce("settling_time"), "ms", "time until within 2 % of rest", 1e3, late=True),
        Figure("final_z", _bounce("final_z"), "mm", "height at the end", 1e3, late=True),
        Figure("peak_speed", _peak_speed, "mm/s", "greatest speed", 1e3),
        Figure("stick_time", _stick_time, "ms", "when it last stuck", 1e3, batched=False),
        Figure(
            "stick_position",
            lambda result: float(result.samples["stick_position"][-1, 0]),
            "mm",
            "stick position at the end",
            1e3,
            batched=False,
        ),
        Figure("final_position", lambda result: result.line.pose[-1, ..., 0], "mm", "position at the end", 1e3),
        Figure("transitions", lambda result: len(changes(result)), "", "changes of state", batched=False),
        Figure("ripple", _ripple, "µm", "position over the last 50 ms, peak to peak", 1e6),
        *(
            Figure(_press_name(name), _press(name), unit, help, scale, batched=False)
            for name, unit, help, scale in (
                ("penetration", "mm", "greatest depth of each hit", 1e3),
                ("approach_speed", "mm/s", "speed at which each hit enters", 1e3),
                ("peak_force", "N", "largest force of each hit", 1.0),
                ("contact_time", "ms", "time of each hit behind the wall", 1e3),
                ("contacts", "", "entries of each hit", 1.0),
                ("final_force", "N", "mean force, last 20 % of the press", 1.0),
                ("final_depth", "mm", "mean depth over the same time", 1e3),
                ("force_ripple", "mN", "its force, peak to peak", 1e3),
                ("ripple", "µm", "its position, peak to peak", 1e6),
                ("absorbed", "mJ", "energy that the wall has taken", 1e3),
            )
        ),
    )
}
"""Predefined figures by name."""
