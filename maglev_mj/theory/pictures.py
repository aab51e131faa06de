"""Pictures of linearised controllers and their closed loops."""

from __future__ import annotations

from typing import Any

import numpy as np

from maglev_mj.colours import REFERENCE, SERIES
from maglev_mj.pictures import FIRST, SECOND, TITLE, name_curves, new_figure
from maglev_mj.theory import ClosedLoop, Linearised, Verdict

_FREE = 1e-6  # to which the double root at 1 of an axis without stiffness is found


def pole_map(loop: ClosedLoop | Verdict) -> Any:
    """Draw the closed loop's eigenvalues in the unit circle.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    figure, (panel,) = new_figure(1, 1, 5.4)
    turn = np.linspace(0.0, 2.0 * np.pi, 361)
    panel.plot(np.cos(turn), np.sin(turn), color=REFERENCE, linewidth=1.2, label="unit circle: boundary of stability")
    outside = np.abs(loop.eigenvalues) > 1.0 + _FREE
    for chosen, color, label in (
        (~outside, FIRST, "eigenvalues inside"),
        (outside, SECOND, "outside, or on it"),
    ):
        poles = loop.eigenvalues[chosen]
        if poles.size:
            panel.plot(poles.real, poles.imag, "x", color=color, markersize=9, markeredgewidth=2.0, label=label)
    panel.set(aspect="equal", xlabel="real part", ylabel="imaginary part")
    panel.set_title(f"spectral radius {loop.spectral_radius:.4g}", **TITLE)
    name_curves(figure, [panel])
    return figure


def impulse_response(near: Linearised) -> Any:
    """Draw the wrench after a unit displacement at one sample.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    columns = near.columns()
    time = columns.pop("time") * 1e3
    groups = {"force to a displacement": ("N/m", "N/rad"), "torque to a displacement": ("N m/m", "N m/rad")}
    shown = {title: [name for name in columns if near.units[name] in units] for title, units in groups.items()}
    shown = {title: names for title, names in shown.items() if names} or shown
    figure, panels = new_figure(1, len(shown), 4.0)
    for panel, (title, names) in zip(panels, shown.items()):
        for index, name in enumerate(names):
            color = SERIES[index % len(SERIES)]
            panel.plot(time, columns[name], "o:", color=color, markersize=7 - 2 * (index % 3), label=name)
        panel.set_title(f"{title} ({', '.join(dict.fromkeys(near.units[name] for name in names))})", **TITLE)
        panel.set_xlabel("time after it (ms)")
        name_curves(panel)
    return figure
