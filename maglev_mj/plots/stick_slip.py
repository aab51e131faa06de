"""Pictures of friction: one pull out of it, over time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from maglev_mj.frames import AXES
from maglev_mj.plots.drawing import FIRST, IDEAL, SECOND, new_figure, save
from maglev_mj.scenes.run import Phases, Result

__all__ = ["stick_slip"]


def stick_slip(results: Mapping[str, Result], sweeps: Mapping[str, Phases], path: Path) -> Path:
    """Draw position and velocity against the exact friction that the law stands for, as figure 8 does.

    Args:
        results: Runs by label, the first of which is drawn.
        sweeps: Not drawn.
        path: PNG to write.

    Raises:
        ChartsMissingError: If matplotlib is not installed.
    """
    figure, (upper, lower) = new_figure(2, 1, (8.0, 6.4), sharex=True)
    result = next(iter(results.values()))
    p, series = result.scene, result.series(1e-4)
    time, length = series["time"], "mm" if p.axis in AXES[:3] else "mrad"
    exact = p.exact(time)
    upper.plot(time, series["position"] * 1e3, color=FIRST, linewidth=1.7, label=f"{p.law}, {1.0 / p.period:g} Hz")
    anchor = np.where(series["state"] == "stuck", series["stick_position"], np.nan)
    upper.plot(time, anchor * 1e3, color=SECOND, linewidth=1.4, linestyle="--", label="stick position")
    upper.plot(time, exact.position * 1e3, color=IDEAL, linewidth=1.8, linestyle=":", label=f"{p.exact_name}, exact")
    lower.plot(time, series["velocity"] * 1e3, color=FIRST, linewidth=1.5)
    lower.plot(time, exact.velocity * 1e3, color=IDEAL, linewidth=1.8, linestyle=":")
    upper.set_ylabel(f"position along {p.axis} ({length})")
    lower.set_ylabel(f"velocity ({length}/s)")
    lower.set_xlabel("time (s)")
    lower.set_xlim(0.0, max(float(time[-1]), 1e-3))
    upper.legend(frameon=False, loc="lower right")
    upper.set_title(
        f"spring {p.spring:.4g}, breakaway {p.breakaway:.4g}, stiffness {p.stiffness:.4g}, damping {p.damping:.4g} "
        f"(SI), delay {p.delay * 1e3:g} ms ({result.plant})",
        loc="left",
        fontsize=10.5,
    )
    return save(figure, path)
