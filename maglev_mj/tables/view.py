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
    """Return what checking a recording gave: fields that are the same together, each that differs by itself."""
    lines = [f"  {verdict.ticks} samples, run again and compared to the last bit"]
    same: dict[int, list[str]] = {}
    for name, field in verdict.fields.items():
        if field.first is None:
            same.setdefault(field.compared, []).append(name)
    given = same.pop(0, [])
    lines += [f"  {count} of {count} the same: {', '.join(names)}" for count, names in same.items()]
    for name, field in verdict.fields.items():
        if field.first is not None:
            stretch, tick = field.first
            lines.append(
                f"  {field.same} of {field.compared} the same: {name}, which first differs at tick {tick} of stretch "
                f"{stretch + 1}"
            )
    if given:
        lines.append(f"  not run again, for only the recording knows them: {', '.join(given)}")
    return "\n".join(lines)
