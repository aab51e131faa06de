"""What a session in a window came to, and what checking a recording gave."""

from __future__ import annotations

from typing import TYPE_CHECKING

from maglev_mj.recording import Verdict

if TYPE_CHECKING:
    from maglev_mj.viewer.window import ShowReport

__all__ = ["show_table", "verdict_table"]


def show_table(report: ShowReport) -> str:
    """Return what a session in a window came to."""
    passed, frames = max(report.wall_time, 1e-9), report.frames
    factor = report.simulated / passed
    lines = [
        f"  {report.wall_time:.1f} s, {report.ticks} control ticks, {report.missed} missed",
        f"  real-time factor {factor:.3f}",
        f"  {frames} frames, {frames / passed:.1f} a second, {report.frame_cost * 1e3:.1f} ms each",
    ]
    return "\n".join(lines)


def verdict_table(verdict: Verdict) -> str:
    """Return what checking a recording gave."""
    lines = [
        f"  {verdict.commands} of {verdict.ticks} commands the same to the last bit",
        "  the positions are a device's, and are not run again"
        if verdict.positions is None
        else f"  {verdict.positions} of {verdict.ticks} positions the same to the last bit",
    ]
    if verdict.first is not None:
        lines.append(f"  the first that is not: stretch {verdict.first[0]}, tick {verdict.first[1]}")
    return "\n".join(lines)
