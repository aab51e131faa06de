"""Pictures of drops: over time, in the phase plane, over the sampling phase."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from maglev_mj.charts.drawing import FIRST, IDEAL, SECOND, new_figure, save
from maglev_mj.experiments.drop import DropResult, DropSweep, analog_drop

__all__ = ["phase_plane", "phases", "time_series"]


def _describe(result: DropResult) -> str:
    p = result.parameters
    limit = "" if p.force_limit is None else f", limit {p.force_limit:g} N"
    return (
        f"{p.height * 1e3:g} mm drop, {p.stiffness:g} N/m and {p.damping:g} N s/m, {1.0 / p.period:g} Hz, "
        f"delay {p.delay * 1e3:g} ms{limit} ({p.plant})"
    )


def time_series(runs: Iterable[tuple[str, DropResult]], path: Path) -> Path:
    """Draw position and force over time, as figure 3 does.

    Args:
        runs: Label and result of each drop; the first is drawn in front.
        path: PNG to write.

    Raises:
        ChartsMissingError: If matplotlib is not installed.
    """
    figure, (upper, lower) = new_figure(2, 1, (8.0, 6.4), sharex=True)
    shown = list(runs)
    for place, (label, result) in enumerate(shown):
        time, z, _, force = result.series(1e-4)
        style = {
            "color": (FIRST, SECOND)[place % 2],
            "linestyle": ("-", "--")[place % 2],
            "linewidth": 1.7,
            "zorder": 3 - place,
            "label": label,
        }
        upper.plot(time, z * 1e3, **style)
        lower.step(time, force, where="post", **style)
    upper.axhspan(min(upper.get_ylim()[0], -0.5), 0.0, color="#f1efe9", zorder=0)
    upper.set_ylim(bottom=upper.get_ylim()[0])
    upper.set_ylabel("height above the wall (mm)")
    lower.set_ylabel("force on the flotor (N)")
    lower.set_xlabel("time after release (s)")
    lower.set_xlim(0.0, float(shown[0][1].parameters.duration))
    upper.legend(frameon=False, loc="upper right")
    upper.set_title(_describe(shown[0][1]), loc="left", fontsize=10.5)
    return save(figure, path)


def phase_plane(runs: Iterable[tuple[str, DropResult]], path: Path) -> Path:
    """Draw velocity over position beside the ideal analog wall, as figure 4 does.

    Args:
        runs: Label and result of each drop; the first is drawn in front.
        path: PNG to write.

    Raises:
        ChartsMissingError: If matplotlib is not installed.
    """
    figure, (panel,) = new_figure(1, 1, (7.2, 5.6))
    shown = list(runs)
    for place, (label, result) in enumerate(shown):
        _, z, velocity, _ = result.series(1e-4)
        panel.plot(
            z * 1e3,
            velocity,
            color=(FIRST, SECOND)[place % 2],
            linestyle=("-", "--")[place % 2],
            linewidth=1.6,
            zorder=3 - place,
            label=label,
        )
    parameters = shown[0][1].parameters
    if parameters.stiffness > 0.0:
        time = shown[0][1].series(1e-4)[0]
        z, velocity, _ = analog_drop(parameters, time)
        panel.plot(z * 1e3, velocity, color=IDEAL, linestyle=":", linewidth=1.8, label="analog wall, 10 kHz filter")
    panel.axvline(0.0, color="#b9b2a3", linewidth=1.2)
    panel.set_xlabel("height above the wall (mm)")
    panel.set_ylabel("velocity (m/s)")
    panel.legend(frameon=False, loc="best")
    panel.set_title(_describe(shown[0][1]), loc="left", fontsize=10.5)
    return save(figure, path)


def phases(sweeps: Iterable[tuple[str, DropSweep]], path: Path) -> Path:
    """Draw how penetration, rebound and peak force depend on the phase of the sampler.

    Args:
        sweeps: Label and sweep of each variant.
        path: PNG to write.

    Raises:
        ChartsMissingError: If matplotlib is not installed.
    """
    figure, panels = new_figure(1, 3, (10.5, 3.8), sharex=True)
    shown = list(sweeps)
    for place, (label, sweep) in enumerate(shown):
        figures = (sweep.summary.penetration * 1e3, sweep.summary.rebound * 1e3, sweep.summary.peak_force)
        for panel, values in zip(panels, figures, strict=True):
            panel.plot(
                sweep.phases,
                values,
                color=(FIRST, SECOND)[place % 2],
                linewidth=1.7,
                linestyle=("-", "--")[place % 2],
                label=label,
            )
    for panel, name in zip(panels, ("penetration (mm)", "rebound (mm)", "peak force (N)"), strict=True):
        panel.set_title(name, loc="left", fontsize=10.5)
        panel.set_ylim(bottom=0.0)
        panel.set_xlim(0.0, 1.0)
        panel.set_xlabel("phase of the first sample (periods)")
    panels[0].legend(frameon=False, loc="lower left")
    return save(figure, path)
