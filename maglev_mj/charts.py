"""Pictures of results; the only module that needs matplotlib (the extra `charts`)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from maglev_mj.errors import MaglevError
from maglev_mj.experiments.choices import SLIDES_AT
from maglev_mj.experiments.drop import DropResult, DropSweep, analog_drop
from maglev_mj.experiments.six_axes import SixAxesResult
from maglev_mj.experiments.stick_slip import StickSlipResult, exact_stick_slip
from maglev_mj.frames import AXES

__all__ = [
    "ChartsMissingError",
    "friction_laws",
    "phase_plane",
    "phases",
    "require",
    "staircase",
    "stick_slip",
    "time_series",
]

_WITH, _WITHOUT, _IDEAL, _GRID = "#0b6e99", "#d1495b", "#5a5f66", "#e3e5e8"


class ChartsMissingError(MaglevError):
    """matplotlib is not installed."""


def require() -> None:
    """Check that pictures can be drawn.

    Raises:
        ChartsMissingError: If matplotlib is not installed.
    """
    try:
        import matplotlib.figure  # noqa: F401 - only whether it is there
    except ImportError:
        raise ChartsMissingError("pictures need matplotlib: pip install 'maglev-mj[charts]'") from None


def _figure(rows: int, columns: int, size: tuple[float, float], **options: Any) -> tuple[Any, list[Any]]:
    require()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    axes = list(np.atleast_1d(figure.subplots(rows, columns, **options)).ravel())
    for panel in axes:
        panel.grid(color=_GRID, linewidth=0.8)
        panel.set_axisbelow(True)
        for side in ("top", "right"):
            panel.spines[side].set_visible(False)
    return figure, axes


def _save(figure: Any, path: Path) -> Path:
    figure.savefig(path, dpi=150)
    return path


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
    figure, (upper, lower) = _figure(2, 1, (8.0, 6.4), sharex=True)
    shown = list(runs)
    for place, (label, result) in enumerate(shown):
        time, z, _, force = result.series(1e-4)
        style = {
            "color": (_WITH, _WITHOUT)[place % 2],
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
    return _save(figure, path)


def phase_plane(runs: Iterable[tuple[str, DropResult]], path: Path) -> Path:
    """Draw velocity over position beside the ideal analog wall, as figure 4 does.

    Args:
        runs: Label and result of each drop; the first is drawn in front.
        path: PNG to write.

    Raises:
        ChartsMissingError: If matplotlib is not installed.
    """
    figure, (panel,) = _figure(1, 1, (7.2, 5.6))
    shown = list(runs)
    for place, (label, result) in enumerate(shown):
        _, z, velocity, _ = result.series(1e-4)
        panel.plot(
            z * 1e3,
            velocity,
            color=(_WITH, _WITHOUT)[place % 2],
            linestyle=("-", "--")[place % 2],
            linewidth=1.6,
            zorder=3 - place,
            label=label,
        )
    parameters = shown[0][1].parameters
    if parameters.stiffness > 0.0:
        time = shown[0][1].series(1e-4)[0]
        z, velocity, _ = analog_drop(parameters, time)
        panel.plot(z * 1e3, velocity, color=_IDEAL, linestyle=":", linewidth=1.8, label="analog wall, 10 kHz filter")
    panel.axvline(0.0, color="#b9b2a3", linewidth=1.2)
    panel.set_xlabel("height above the wall (mm)")
    panel.set_ylabel("velocity (m/s)")
    panel.legend(frameon=False, loc="best")
    panel.set_title(_describe(shown[0][1]), loc="left", fontsize=10.5)
    return _save(figure, path)


def stick_slip(result: StickSlipResult, path: Path) -> Path:
    """Draw position and velocity against the exact friction that the law stands for, as figure 8 does.

    Args:
        result: The run.
        path: PNG to write.

    Raises:
        ChartsMissingError: If matplotlib is not installed.
    """
    figure, (upper, lower) = _figure(2, 1, (8.0, 6.4), sharex=True)
    p, series = result.parameters, result.series(1e-4)
    time, length = series["time"], "mm" if p.axis in AXES[:3] else "mrad"
    exact = exact_stick_slip(p, time)
    kind = "Coulomb, exact" if SLIDES_AT.get(p.law, 1.0) else "Karnopp, exact"
    upper.plot(time, series["position"] * 1e3, color=_WITH, linewidth=1.7, label=f"{p.law}, {1.0 / p.period:g} Hz")
    anchor = np.where(series["state"] > 0.0, series["stick_position"], np.nan)
    upper.plot(time, anchor * 1e3, color=_WITHOUT, linewidth=1.4, linestyle="--", label="stick position")
    upper.plot(time, exact.position * 1e3, color=_IDEAL, linewidth=1.8, linestyle=":", label=kind)
    lower.plot(time, series["velocity"] * 1e3, color=_WITH, linewidth=1.5)
    lower.plot(time, exact.velocity * 1e3, color=_IDEAL, linewidth=1.8, linestyle=":")
    upper.set_ylabel(f"position along {p.axis} ({length})")
    lower.set_ylabel(f"velocity ({length}/s)")
    lower.set_xlabel("time (s)")
    lower.set_xlim(0.0, max(float(time[-1]), 1e-3))
    upper.legend(frameon=False, loc="lower right")
    upper.set_title(
        f"spring {p.spring:.4g}, breakaway {p.breakaway:.4g}, stiffness {p.stiffness:.4g}, damping {p.damping:.4g} "
        f"(SI), delay {p.delay * 1e3:g} ms ({p.plant})",
        loc="left",
        fontsize=10.5,
    )
    return _save(figure, path)


def staircase(result: SixAxesResult, path: Path) -> Path:
    """Draw position against stick position on six axes, as figure 9 does.

    Args:
        result: The run.
        path: PNG to write.

    Raises:
        ChartsMissingError: If matplotlib is not installed.
    """
    figure, panels = _figure(3, 2, (10.5, 7.5), sharex=True)
    order = [panel for column in (panels[0::2], panels[1::2]) for panel in column]
    for index, (axis, panel) in enumerate(zip(AXES, order, strict=True)):
        unit = "mm" if index < 3 else "mrad"
        anchor = np.where(result.stuck[:, index], result.anchor[:, index], np.nan)
        panel.plot(result.time, result.position[:, index] * 1e3, color=_WITH, linewidth=1.0, label="position")
        panel.step(result.time, anchor * 1e3, color=_WITHOUT, linewidth=1.5, where="post", label="stick position")
        panel.set_title(f"{axis} ({unit}): {int(result.slips[index])} slips", loc="left", fontsize=10.5)
        panel.set_xlim(0.0, float(result.time[-1]))
    for panel in panels[-2:]:
        panel.set_xlabel("time (s)")
    panels[0].legend(frameon=False, loc="best")
    return _save(figure, path)


def friction_laws(rows: Sequence[Mapping[str, Any]], path: Path) -> Path:
    """Draw the error of each friction law over the rate, for an ideal and a quantized sensor.

    Args:
        rows: Each with law, rate [Hz], quantize [m], velocity (an estimator's name) and error [m].
        path: PNG to write.

    Raises:
        ChartsMissingError: If matplotlib is not installed.
    """
    cases = [(0.0, "difference"), (5e-6, "difference"), (5e-6, "low-pass"), (5e-6, "adaptive")]
    figure, panels = _figure(1, len(cases), (13.0, 4.2), sharex=True, sharey=True)
    colors = ("#0b6e99", "#d1495b", "#7a8b3c", "#8d6cab", "#e3973b", "#4f5a65", "#3aa6a0")
    names = list(dict.fromkeys(row["law"] for row in rows))
    for panel, (quantize, velocity) in zip(panels, cases, strict=True):
        for name, color in zip(names, colors, strict=False):
            chosen = [r for r in rows if (r["law"], r["quantize"], r["velocity"]) == (name, quantize, velocity)]
            rates, errors = [r["rate"] for r in chosen], [r["error"] * 1e3 for r in chosen]
            panel.loglog(rates, errors, color=color, marker="o", markersize=4, linewidth=1.5, label=name)
        sensor = "ideal sensor" if quantize == 0.0 else "5 µm sensor"
        panel.set_title(f"{sensor}, {velocity}", loc="left", fontsize=10.5)
        panel.set_xlabel("rate (Hz)")
        ticks = sorted({row["rate"] for row in rows})
        panel.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        panel.minorticks_off()
        panel.set_yticks([0.05, 0.1, 0.2, 0.5, 1.0], ["0.05", "0.1", "0.2", "0.5", "1"])
    panels[0].set_ylabel("greatest error (mm)")
    figure.legend(*panels[0].get_legend_handles_labels(), frameon=False, loc="outside lower center", ncols=len(names))
    return _save(figure, path)


def phases(sweeps: Iterable[tuple[str, DropSweep]], path: Path) -> Path:
    """Draw how penetration, rebound and peak force depend on the phase of the sampler.

    Args:
        sweeps: Label and sweep of each variant.
        path: PNG to write.

    Raises:
        ChartsMissingError: If matplotlib is not installed.
    """
    figure, panels = _figure(1, 3, (10.5, 3.8), sharex=True)
    shown = list(sweeps)
    for place, (label, sweep) in enumerate(shown):
        figures = (sweep.summary.penetration * 1e3, sweep.summary.rebound * 1e3, sweep.summary.peak_force)
        for panel, values in zip(panels, figures, strict=True):
            panel.plot(
                sweep.phases,
                values,
                color=(_WITH, _WITHOUT)[place % 2],
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
    return _save(figure, path)
