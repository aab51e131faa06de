"""Sessions, twins, flights and verified recordings as text."""

from __future__ import annotations

from typing import TYPE_CHECKING

from maglev_mj.bridge.wire import fault_names
from maglev_mj.recording import Verdict
from maglev_mj.terminal import wrapped

if TYPE_CHECKING:
    from maglev_mj.bridge.flight import FlightReport, LoopTiming
    from maglev_mj.bridge.twin import ServerReport, Twin
    from maglev_mj.display.remote import ShowReport

_IN = "    "


def served_table(served: ServerReport, twin: Twin) -> str:
    """Return the statistics of a twin as text."""
    firmware = twin.firmware
    rate = served.ticks / max(served.wall_time, 1e-9)
    lines = [
        f"  {served.wall_time:.1f} s, {served.ticks} samples, {rate:.0f} a second, {served.missed} periods stalled"
    ]
    if served.latency.count:
        latency = served.latency
        lines.append(f"  late by {latency.p50 * 1e6:.0f} µs in the median, {latency.p99 * 1e3:.2f} ms at 99 %")
    ignored = firmware.counts + twin.codec.dropped
    if ignored:
        told = ", ".join(f"{count} for {reason}" for reason, count in sorted(ignored.items()))
        lines += wrapped(f"frames ignored: {told}", further=_IN)
    lines += wrapped(f"{firmware.state.name.lower()}, faults: {fault_names(firmware.faults)}", further=_IN)
    return "\n".join(lines)


def flown_table(flown: FlightReport) -> str:
    """Return the outcome of a flight as text."""
    first = f"  {flown.wall_time:.1f} s, {flown.ticks} samples, {flown.lost} lost, {flown.skipped} skipped"
    return "\n".join([first, *wrapped(str(flown.landing), further=_IN)])


def timing_table(timing: LoopTiming, warning: str = "") -> str:
    """Return the latencies of a loop as text.

    Whole lines; empty for a loop that did not run.

    Args:
        timing: Latencies of the loop.
        warning: Warning about the delay; empty for none.
    """
    known = [
        f"  {name:<34}" + "".join(f"{part * 1e3:10.3f}" for part in (one.p50, one.p99, one.max))
        for name, one in timing.kinds.items()
    ]
    head = [f"  {'milliseconds':<34}{'median':>10}{'99 %':>10}{'most':>10}"] if known else []
    parts = f"warning: {warning}".split("; ") if warning else []
    said = [line for place, part in enumerate(parts) for line in wrapped(part, _IN if place else "  ", _IN)]
    return "".join(f"{line}\n" for line in [*head, *known, *said])


def show_table(report: ShowReport) -> str:
    """Return the statistics of a viewer session as text."""
    passed, frames = max(report.wall_time, 1e-9), report.frames
    factor = report.simulated / passed
    lines = [
        f"  {report.wall_time:.1f} s, {report.ticks} control ticks, {report.missed} missed",
        f"  real-time factor {factor:.3f}",
        f"  {frames} frames, {frames / passed:.1f} a second"
        + (f", {report.frame_cost * 1e3:.1f} ms each" if report.frame_cost else ""),
    ]
    return "\n".join(lines)


def verdict_table(verdict: Verdict) -> str:
    """Return the result of verifying a recording as text.

    Equal fields share a line; each different one has its own.
    """
    lines = [f"  {verdict.ticks} samples, run again and compared to the last bit"]
    same: dict[int, list[str]] = {}
    for name, field in verdict.fields.items():
        if field.first is None:
            same.setdefault(field.compared, []).append(name)
    given = same.pop(0, [])
    for count, names in same.items():
        lines += wrapped(f"{count} of {count} the same: {', '.join(names)}", further=_IN)
    for name, field in verdict.fields.items():
        if field.first is not None:
            stretch, tick = field.first
            differs = f"{name}, which first differs at tick {tick} of stretch {stretch + 1}"
            lines += wrapped(f"{field.same} of {field.compared} the same: {differs}", further=_IN)
    if given:
        lines += wrapped(f"not run again, for only the recording knows them: {', '.join(given)}", further=_IN)
    return "\n".join(lines)
