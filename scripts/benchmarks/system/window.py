"""Frames of the window with and without shadows, in turns; under Xvfb the processor draws."""

from __future__ import annotations

from functools import partial

from maglev_mj.session import Session
from maglev_mj.views.viewer_process import ShowReport
from maglev_mj.views.window.window import show
from system import Table, beside
from timing import Run, columns, in_turns


def measure(quick: bool, seconds: float = 8.0, turns: int = 3) -> dict[str, Table]:
    """Return the time of a frame, and the control ticks beside it; each turn takes `seconds`."""

    def one(shadows: bool) -> ShowReport:
        return show(Session(), duration=0.5 if quick else seconds, shadows=shadows)

    work = {"with shadows": partial(one, True), "without": partial(one, False)}
    reports = in_turns(work, 1 if quick else turns)
    runs = {
        name: Run(sum(r.wall_time for r in some), None, sum(r.frames for r in some)) for name, some in reports.items()
    }
    rows = {
        name: {
            "frames a second": runs[name].ticks / runs[name].seconds,
            "ms to draw": 1e3 * max(report.frame_cost for report in some),
            "ticks": sum(report.ticks for report in some),
            "missed": sum(report.missed for report in some),
        }
        for name, some in reports.items()
    }
    return {"window": columns(runs, "frame") | beside(rows)}
