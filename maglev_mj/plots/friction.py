"""Pictures of friction: one pull, six axes, and the laws compared."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from maglev_mj.experiments.six_axes import SixAxesResult
from maglev_mj.experiments.stick_slip import StickSlipResult, exact_stick_slip
from maglev_mj.frames import AXES
from maglev_mj.plots.drawing import FIRST, IDEAL, MANY, SECOND, new_figure, save
from maglev_mj.scenes.choices import SLIDES_AT

__all__ = ["friction_laws", "staircase", "stick_slip"]


def stick_slip(result: StickSlipResult, path: Path) -> Path:
    """Draw position and velocity against the exact friction that the law stands for, as figure 8 does.

    Args:
        result: The run.
        path: PNG to write.

    Raises:
        ChartsMissingError: If matplotlib is not installed.
    """
    figure, (upper, lower) = new_figure(2, 1, (8.0, 6.4), sharex=True)
    p, series = result.parameters, result.series(1e-4)
    time, length = series["time"], "mm" if p.axis in AXES[:3] else "mrad"
    exact = exact_stick_slip(p, time)
    kind = "Coulomb, exact" if SLIDES_AT.get(p.law, 1.0) else "Karnopp, exact"
    upper.plot(time, series["position"] * 1e3, color=FIRST, linewidth=1.7, label=f"{p.law}, {1.0 / p.period:g} Hz")
    anchor = np.where(series["state"] > 0.0, series["stick_position"], np.nan)
    upper.plot(time, anchor * 1e3, color=SECOND, linewidth=1.4, linestyle="--", label="stick position")
    upper.plot(time, exact.position * 1e3, color=IDEAL, linewidth=1.8, linestyle=":", label=kind)
    lower.plot(time, series["velocity"] * 1e3, color=FIRST, linewidth=1.5)
    lower.plot(time, exact.velocity * 1e3, color=IDEAL, linewidth=1.8, linestyle=":")
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
    return save(figure, path)


def staircase(result: SixAxesResult, path: Path) -> Path:
    """Draw position against stick position on six axes, as figure 9 does.

    Args:
        result: The run.
        path: PNG to write.

    Raises:
        ChartsMissingError: If matplotlib is not installed.
    """
    figure, panels = new_figure(3, 2, (10.5, 7.5), sharex=True)
    order = [panel for column in (panels[0::2], panels[1::2]) for panel in column]
    for index, (axis, panel) in enumerate(zip(AXES, order, strict=True)):
        unit = "mm" if index < 3 else "mrad"
        anchor = np.where(result.stuck[:, index], result.anchor[:, index], np.nan)
        panel.plot(result.time, result.position[:, index] * 1e3, color=FIRST, linewidth=1.0, label="position")
        panel.step(result.time, anchor * 1e3, color=SECOND, linewidth=1.5, where="post", label="stick position")
        steps = result.steps()[index] * 1e3
        between = f", resting places {steps.min():.2g} to {steps.max():.2g} apart" if steps.size else ""
        panel.set_title(f"{axis} ({unit}): {int(result.slips[index])} slips{between}", loc="left", fontsize=10.5)
        panel.set_xlim(0.0, float(result.time[-1]))
    for panel in panels[-2:]:
        panel.set_xlabel("time (s)")
    panels[0].legend(frameon=False, loc="best")
    return save(figure, path)


def friction_laws(rows: Sequence[Mapping[str, Any]], path: Path) -> Path:
    """Draw the error of each friction law over the rate, for an ideal and a quantized sensor.

    Args:
        rows: Each with law, rate [Hz], quantize [m], velocity (an estimator's name) and error [m].
        path: PNG to write.

    Raises:
        ChartsMissingError: If matplotlib is not installed.
    """
    cases = [(0.0, "difference"), (5e-6, "difference"), (5e-6, "low-pass"), (5e-6, "adaptive")]
    figure, panels = new_figure(1, len(cases), (13.0, 4.2), sharex=True, sharey=True)
    names = list(dict.fromkeys(row["law"] for row in rows))
    for panel, (quantize, velocity) in zip(panels, cases, strict=True):
        for name, color in zip(names, MANY, strict=False):
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
    return save(figure, path)
