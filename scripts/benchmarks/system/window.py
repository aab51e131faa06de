"""Frames of the window, and the control ticks beside it; under Xvfb the processor draws."""

from __future__ import annotations

from functools import partial

from maglev_mj.session import Session
from maglev_mj.views.viewer_process import ShowReport, show_remotely
from maglev_mj.views.window.window import show
from system import Table, beside
from timing import Run, columns, in_turns


def measure(quick: bool, seconds: float = 8.0, turns: int = 3) -> dict[str, Table]:
    """Return the frames per second, and the control ticks beside them; each turn takes `seconds`."""

    def one(period: float) -> ShowReport:
        session = Session()
        session.change({"period": period})
        return show_remotely(session, show, 0.5 if quick else seconds)

    work = {f"{1.0 / period:.0f} Hz": partial(one, period) for period in (0.005, 0.001)}
    reports = in_turns(work, 1 if quick else turns)
    runs = {
        name: Run(sum(r.wall_time for r in some), None, sum(r.frames for r in some)) for name, some in reports.items()
    }
    rows = {
        name: {
            "frames a second": runs[name].ticks / runs[name].seconds,
            "ticks": sum(report.ticks for report in some),
            "missed": sum(report.missed for report in some),
        }
        for name, some in reports.items()
    }
    return {"window": columns(runs, "frame") | beside(rows)}
