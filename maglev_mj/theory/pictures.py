"""Pictures of linearised controllers and their closed loops."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from maglev_mj.colours import BAD, GOOD, REFERENCE, SERIES, on_white
from maglev_mj.pictures import FIRST, SECOND, TITLE, drawn, in_own_axes, name_curves, new_figure, wide_share
from maglev_mj.theory import ClosedLoop, Linearised, Verdict

_TICKS = 8
_OUTER = 3.0
"""Largest magnitude of a pole in a chart, so that the unit circle stays visible."""
_FREE = 1e-6  # accuracy of the double pole at 1 of an axis without stiffness


@drawn
def pole_map(loop: ClosedLoop | Verdict) -> Any:
    """Draw the poles of a closed loop and the unit circle; of a verdict those of its loop in contact.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    head, eigenvalues = [loop.headline, loop.conditions], loop.eigenvalues
    if isinstance(loop, Verdict) and loop.contact is not None and loop.contact[0] is not loop.loop:
        head, eigenvalues = (
            [loop.contact_headline, loop.conditions, f"worst of all axes: {loop}"],
            loop.contact[0].poles,
        )
    states = (
        [] if in_own_axes() or not isinstance(loop, Verdict) else [row for row in loop.states if row.spectral_radius]
    )
    figure, (panel, *others) = new_figure(head, 1, 2 if states else 1, 4.6 if states else 5.2)
    turn = np.linspace(0.0, 2.0 * np.pi, 361)
    panel.plot(np.cos(turn), np.sin(turn), color=REFERENCE, linewidth=1.2, label="unit circle (stability boundary)")
    outside = np.abs(eigenvalues) > 1.0 + _FREE
    for chosen, color, label in (
        (~outside, FIRST, "stable poles"),
        (outside, SECOND, "unstable poles"),
    ):
        poles = eigenvalues[chosen]
        if poles.size:
            if beyond := int((np.abs(poles) > _OUTER).sum()):
                label += f" ({beyond} outside the chart)"
            panel.plot(poles.real, poles.imag, "x", color=color, markersize=9, markeredgewidth=2.0, label=label)
    end = min(1.1 * float(np.abs(eigenvalues).max(initial=1.0)), _OUTER)
    panel.set(aspect="equal", xlabel="real part", ylabel="imaginary part", xlim=(-end, end), ylim=(-end, end))
    panel.locator_params(nbins=max(int(_TICKS * wide_share()) // (1 + len(others)), 5))
    for other in others:
        panel.set_title("poles", **TITLE)
        _states(other, states)
    name_curves(figure, [panel])
    return figure


def _states(panel: Any, states: Sequence[Any]) -> None:
    """Draw the spectral radius of each loop in each state of its laws."""
    panel.set_label("<states>")  # left out of axes of the user
    for index, state in enumerate(states):
        axes, acting, radius, _ = state.row()
        colour = GOOD if state.spectral_radius < 1.0 else BAD
        panel.barh(index, state.spectral_radius, color=on_white(colour, 3.0), height=0.3)
        inside: dict[str, Any] = {"textcoords": "offset points", "va": "center", "fontsize": 9.0}
        panel.annotate(f"{axes}: {acting}, {radius}", (0.0, index - 0.15), (4, 9), **inside)
    panel.axvline(1.0, color=REFERENCE, linewidth=1.2)
    panel.set(
        xlabel="spectral radius", ylim=(len(states) - 0.5, -0.8), xlim=(0.0, max(1.05, panel.get_xlim()[1])), yticks=[]
    )
    panel.set_title("each loop and state; stable below 1", **TITLE)


@drawn
def impulse_response(near: Linearised) -> Any:
    """Draw the impulse response: wrench after a unit displacement at one sample.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    columns = near.columns()
    time = columns.pop("time") * 1e3
    groups = {"force per displacement": ("N/m", "N/rad"), "torque per displacement": ("N m/m", "N m/rad")}
    groups_drawn = {title: [name for name in columns if near.units[name] in units] for title, units in groups.items()}
    groups_drawn = {title: names for title, names in groups_drawn.items() if names} or groups_drawn
    figure, panels = new_figure((near.headline, near.conditions), 1, len(groups_drawn), 4.0)
    for panel, (title, names) in zip(panels, groups_drawn.items()):
        for index, name in enumerate(names):
            color = SERIES[index % len(SERIES)]
            panel.plot(time, columns[name], "o:", color=color, markersize=7 - 2 * (index % 3), label=name)
        panel.set_title(f"{title} ({', '.join(dict.fromkeys(near.units[name] for name in names))})", **TITLE)
        panel.set_xlabel("time after displacement (ms)")
        name_curves(panel)
    return figure
