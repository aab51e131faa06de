"""Charts of a recording beside its simulation.

Figures 5, 6 and 9 of the paper.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from maglev_mj.analysis import Run, SegmentReport
from maglev_mj.colours import REFERENCE, STUCK
from maglev_mj.frames import AXES, Array, unit_of
from maglev_mj.pictures import FIRST, SECOND, TITLE, draw_walls, drawn, name_curves, new_grid

_SHOWN, _LEAD, _POINTS = 0.4, 0.1, 2001
_MOST_DOTS, _MOST_MARKS, _APART = 150, 12, 0.045


@drawn
def first_contact(report: SegmentReport, axis: int) -> Any:
    """Draw 0.4 s around the first contact (figure 5).

    Args:
        report: The recording, and its simulation if there is one.
        axis: Index into AXES.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    time = report.recorded.motion.time
    begin, end = float(report.recorded.motion.trace.time[0]), float(time[-1])
    contacts = [
        contact.start for face in report.recorded.figures.faces if face.axis == AXES[axis] for contact in face.contacts
    ]
    start = max(min(min(contacts, default=begin) - _LEAD, end - _SHOWN), begin)
    return _over_time(report, axis, (start, min(start + _SHOWN, end)), marks=False)


@drawn
def whole_run(report: SegmentReport, axis: int) -> Any:
    """Draw position and force of the whole run (figure 6).

    Each contact is marked with its depth.

    Args:
        report: The recording, and its simulation if there is one.
        axis: Index into AXES.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    trace = report.recorded.motion.trace
    return _over_time(report, axis, (float(trace.time[0]), float(trace.time[-1])), marks=True)


@drawn
def sticks(report: SegmentReport, axis: int) -> Any:
    """Draw position and stick position by axis (figure 9).

    Args:
        report: A recording with friction.
        axis: Index into AXES, of the panel without any friction.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    run = report.recorded
    positions = run.motion.trace.pose[run.motion.starts]
    anchors = np.full_like(positions, np.nan) if run.anchors is None else run.anchors
    slips = {axis: friction.slips for axis, friction in run.figures.friction.items()}
    titles = {AXES.index(axis): f"{count} slip{'' if count == 1 else 's'}" for axis, count in slips.items()}
    conditions = report.conditions_on([*slips] or [AXES[axis]])
    count = sum(slips.values())
    head = f"{count} slip{'' if count == 1 else 's'} in {np.ptp(run.motion.time):.3g} s", conditions
    return staircases(head, run.motion.time, positions, anchors, titles or {axis: "no friction"})


@drawn
def staircases(head: Sequence[str], time: Array, position: Array, anchors: Array, titles: Mapping[int, str]) -> Any:
    """Draw position and stick position over time, by axis.

    Args:
        head: See `new_figure`.
        time: Of the samples [s], (K,).
        position: Positions [m, rad], (K, 6).
        anchors: Stick positions [m, rad], (K, 6); NaN where an axis does not stick.
        titles: Title of each panel, by axis index.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    curves = {AXES[axis]: ([1e3 * position[:, axis]], unit_of("mm", axis)) for axis in titles}
    figure, panels = new_grid(head, curves, "time (s)", high=3, row=2.1, more=1.1)
    for name, panel in panels.items():
        panel.plot(time, *curves[name][0], color=FIRST, linewidth=1.0, label="position")
        panel.step(
            time, 1e3 * anchors[:, AXES.index(name)], color=STUCK, linewidth=2.0, where="post", label="stick position"
        )
        panel.set_title(f"{name}: {titles[AXES.index(name)]}", **TITLE)
        panel.set_xlim(float(time[0]), float(time[-1]))
    name_curves(figure, figure.axes[:1])
    return figure


def _over_time(report: SegmentReport, axis: int, window: tuple[float, float], *, marks: bool) -> Any:
    """Draw position and force of recording and simulation over a time window [s]; a constant force is not shown."""
    traces = [run.motion.trace for run in (report.recorded, report.simulated) if run is not None]
    inside = [(one, (one.time >= window[0]) & (one.time <= window[1])) for one in traces]
    coordinate, effort = (f"position along {AXES[axis]}", "force") if axis < 3 else (AXES[axis], "torque")
    curves = {
        coordinate: ([1e3 * one.pose[rows, axis] for one, rows in inside], unit_of("mm", axis)),
        f"actuator {effort}": ([one.wrench[rows, axis] for one, rows in inside], unit_of("N", axis)),
    }
    conditions = report.conditions_on([AXES[axis]])
    wall = f"{conditions}{'' if report.wall is None else f', wall {report.wall.words}'}"
    figure, panels = new_grid((report.headline, wall), curves, "time (s)", high=2, more=0.8, always=coordinate)
    upper, *lower = panels.values()
    sides = [("recording", report.recorded, FIRST, "-", 3), ("simulation", report.simulated, SECOND, "--", 4)]
    for label, run, color, dashes, order in sides:
        if run is None:
            continue
        style = {"color": color, "linestyle": dashes, "linewidth": 1.5 if order == 3 else 1.1, "zorder": order}
        trace = run.motion.trace
        first, last = max(window[0], float(trace.time[0])), min(window[1], float(trace.time[-1]))
        if last <= first:
            continue
        # with every switch: a short pulse may fall between two points of the grid
        knots = trace.time[(trace.time >= first) & (trace.time <= last)]
        time = np.union1d(np.linspace(first, last, _POINTS), knots)
        pose, _, wrench = trace.at(time)
        upper.plot(time, pose[:, axis] * 1e3, label=label, **style)
        for panel in lower:
            panel.step(time, wrench[:, axis], where="post", **style)
    _dots(upper, report.recorded, axis, window)
    if marks:
        _marks(upper, report.recorded, axis)
    draw_walls(upper, [face[1:] for face in report.metadata.faces if face[0] == axis])
    upper.set_xlim(window)
    name_curves(figure, [upper])
    return figure


def _dots(panel: Any, run: Run, axis: int, window: tuple[float, float]) -> None:
    """Draw the samples, if few enough to tell apart."""
    time = run.motion.time
    inside = (time >= window[0]) & (time <= window[1])
    if inside.sum() <= _MOST_DOTS:
        positions = run.motion.trace.pose[run.motion.starts][:, axis]
        panel.plot(time[inside], positions[inside] * 1e3, ".", color=FIRST, markersize=4.0, zorder=5, label="samples")


def _marks(panel: Any, run: Run, axis: int) -> None:
    """Label contacts with their depth, deepest first, without overlap."""
    contacts = [(contact, face) for face in run.figures.faces if face.axis == AXES[axis] for contact in face.contacts]
    contacts.sort(key=lambda one: -round(one[0].penetration, 9))
    spacing = _APART * (run.figures.end - run.figures.start)
    marked: list[float] = []
    for contact, face in contacts:
        if len(marked) == _MOST_MARKS or any(abs(contact.start - other) < spacing for other in marked):
            continue
        marked.append(contact.start)
        below = face.normal > 0.0
        panel.annotate(
            f"{contact.penetration * 1e3:.2f}",
            (contact.start, (face.edge - face.normal * contact.penetration) * 1e3),
            xytext=(0.0, -3.0 * face.normal),
            textcoords="offset points",
            va="top" if below else "bottom",
            fontsize=8.5,
            color=REFERENCE,
        )
    if contacts:
        panel.margins(y=0.16)
