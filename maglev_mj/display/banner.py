"""The banner of a snapshot: stopped, paused, too slow."""

from __future__ import annotations

from typing import NamedTuple

from maglev_mj.session import Snapshot


class Banner(NamedTuple):
    """Words over everything else.

    Attributes:
        text: What is the matter.
        way_on: Action that goes on; empty where there is none.
        bad: Whether something is wrong, and not only asked for.
        remedy: Way on where it is no action; empty otherwise.
    """

    text: str
    way_on: str
    bad: bool
    remedy: str = ""


def banner(snapshot: Snapshot) -> Banner | None:
    """Return the banner of a snapshot; None while running normally."""
    if snapshot.state == "stopped":
        return Banner(f"STOPPED: {snapshot.reason}", _known("centre", snapshot), True, snapshot.remedy)
    if snapshot.state == "paused":
        where = "" if snapshot.duration is None else f": {snapshot.time:.3f} of {snapshot.duration:.3f} s"
        return Banner(f"PAUSED{where}", _known("pause", snapshot), False)
    if (line := snapshot.tour) is not None and line.done and line.number < line.total:
        return Banner("DONE", "next", False)
    if snapshot.late:
        text = "TOO SLOW: this machine cannot keep up, simulated time slows down"
        return Banner(text, _known("slower", snapshot), True)
    return None


def _known(action: str, snapshot: Snapshot) -> str:
    """Return an action if it has effect; else empty."""
    return action if action in snapshot.actions else ""


def pace(snapshot: Snapshot) -> str:
    """Return the pace of time; empty for real time."""
    if (scale := snapshot.time_scale) == 1.0:
        return ""
    return f"1/{1.0 / scale:.3g} of real time" if scale < 1.0 else f"{scale:.3g} times real time"
