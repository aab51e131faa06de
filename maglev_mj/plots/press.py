"""Pictures of a wall that a hand hits and presses."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from maglev_mj.plots.drawing import FIRST, IDEAL, SECOND, new_figure, save
from maglev_mj.scenes.run import Phases, Result

__all__ = ["figure_6"]

_WALL = "#f1efe9"


def _describe(result: Result) -> str:
    p = result.scene
    limit = "" if p.force_limit is None else f", limit {p.force_limit:g} N"
    return (
        f"hand {p.hand}, {p.press:g} N in the end, wall of {p.stiffness:g} N/m and {p.damping:g} N s/m, "
        f"{1.0 / p.period:g} Hz, delay {p.delay * 1e3:g} ms{limit} ({result.plant})"
    )


def figure_6(results: Mapping[str, Result], sweeps: Mapping[str, Phases], path: Path) -> Path:
    """Draw position and control force over time, as figure 6 does, and where the hand pulls to.

    Args:
        results: Runs by label; the first is drawn in front.
        sweeps: Not drawn.
        path: PNG to write.

    Raises:
        ChartsMissingError: If matplotlib is not installed.
    """
    figure, (upper, lower) = new_figure(2, 1, (10.0, 6.8), sharex=True)
    first = next(iter(results.values()))
    for place, (label, result) in enumerate(results.items()):
        series = result.series(1e-4)
        style = {
            "color": (FIRST, SECOND)[place % 2],
            "linestyle": ("-", "--")[place % 2],
            "linewidth": 1.4,
            "zorder": 3 - place,
            "label": label,
        }
        upper.plot(series["time"], series["z"] * 1e3, **style)
        lower.step(series["time"], series["force"], where="post", **style)
    bottom, top = upper.get_ylim()
    bottom = min(bottom, -0.5)
    p, pulled = first.scene, first.series(1e-4)
    upper.plot(
        pulled["time"],
        pulled["target"] * 1e3,
        color=IDEAL,
        linewidth=0.8,
        label=f"where the hand pulls to, down to {p.resting_point * 1e3:.1f} mm",
    )
    upper.axhspan(bottom, 0.0, color=_WALL, zorder=0)
    upper.set_ylim(bottom, top + 0.22 * (top - bottom))
    upper.text(0.008, 0.02, "wall", transform=upper.transAxes, color=IDEAL, fontsize=9.5)
    upper.set_ylabel("height above the wall (mm)")
    lower.set_ylabel("control force (N)")
    lower.set_xlabel("time (s)")
    lower.set_xlim(0.0, p.end)
    upper.legend(frameon=False, loc="upper right", ncols=3)
    upper.set_title(_describe(first), loc="left", fontsize=10.5)
    return save(figure, path)
