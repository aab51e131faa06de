"""What a twin and a flight came to."""

from __future__ import annotations

from typing import TYPE_CHECKING

from maglev_mj.bridge.states import fault_names

if TYPE_CHECKING:
    from maglev_mj.bridge.flight import Flown
    from maglev_mj.bridge.server import Served
    from maglev_mj.bridge.twin import Twin

__all__ = ["flown_table", "served_table"]


def served_table(served: Served, twin: Twin) -> str:
    """Return what a twin came to."""
    firmware = twin.firmware
    rate = served.ticks / max(served.wall_time, 1e-9)
    lines = [
        f"  {served.wall_time:.1f} s, {served.ticks} samples, {rate:.0f} a second, {served.missed} periods stalled"
    ]
    if served.lateness.count:
        lateness = served.lateness
        lines.append(f"  late by {lateness.p50 * 1e6:.0f} µs in the median, {lateness.p99 * 1e3:.2f} ms at 99 %")
    ignored = firmware.counts + twin.codec.dropped
    if ignored:
        lines.append(
            "  frames ignored: " + ", ".join(f"{count} for {reason}" for reason, count in sorted(ignored.items()))
        )
    lines.append(f"  {firmware.state.name.lower()}, faults: {fault_names(firmware.faults)}")
    return "\n".join(lines)


def flown_table(flown: Flown) -> str:
    """Return what a flight came to."""
    lines = [f"  {flown.wall_time:.1f} s, {flown.ticks} samples, {flown.lost} lost, {flown.skipped} skipped"]
    if flown.answer.count:
        answer = flown.answer
        lines.append(f"  answered within {answer.p50 * 1e6:.0f} µs in the median, {answer.p99 * 1e6:.0f} µs at 99 %")
    return "\n".join(lines)
