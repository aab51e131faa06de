"""Faults as text: what is latched in a device, and what a black box holds."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from maglev_mj.bridge.wire import Fault
from maglev_mj.terminal import printable

if TYPE_CHECKING:
    from maglev_mj.bridge.fault import FaultRecord
    from maglev_mj.bridge.remote import RemotePlant

__all__ = ["fault_table", "latched_table"]

_SHOWN = 20

_REASONS = {
    Fault.SENSOR_OUT_OF_RANGE: "a diode's reading is invalid, off the diode, or jumped; or no pose has these readings",
    Fault.COIL_OVERCURRENT: "a current above the limit was commanded, or measured",
    Fault.COIL_OVERTEMP: "a coil is as warm as it may be",
    Fault.FLOTOR_OVERSPEED: "the flotor was too fast",
    Fault.BOUNDARY: "the flotor left its envelope",
    Fault.WATCHDOG: "no command in time, or the amplifiers' enable line stood still",
    Fault.INVALID_COMMAND: "a command that is not finite",
    Fault.ESTOP: "an emergency stop was asked for",
    Fault.COIL_NOT_FOLLOWING: "a measured current was not the commanded one",
    Fault.SENSOR_FROZEN: "a diode repeated its reading more often than its noise allows",
    Fault.CLOCK: "the device's timestamps did not go as its samples do",
    Fault.NOT_FOLLOWING: "the flotor did not go where it was led: signs, diodes exchanged, or a hand in the way",
    Fault.HOST: "the host's program failed, or lost the device's samples",
    Fault.SENSOR_STOPPED: "the sensor's conversion counter stood still",
    Fault.COIL_NOT_OFF: "a current flowed after it was cut: cut the power",
}


def latched_table(plant: RemotePlant) -> str:
    """Return what is latched in a device, since when and why."""
    if not plant.faults:
        return f"  no fault is latched; the device is {plant.state.name.lower()}"
    return "\n".join([f"  {plant.latched}", *_reasons(" ".join(fault.name or "" for fault in plant.faults))])


def fault_table(record: FaultRecord, *, whole: bool = False) -> str:
    """Return a black box: what, when, and the last cycles.

    Args:
        record: The black box.
        whole: True for every cycle, else the last 20.
    """
    head, *rows = record.rows()
    shown = rows if whole else rows[-_SHOWN:]
    widths = [max(len(row[place]) for row in (head, *shown)) for place in range(len(head))]
    lines = ["  ".join(text.rjust(width) for text, width in zip(row, widths, strict=True)) for row in (head, *shown)]
    first = f", first {record.first}" if record.first != record.faults else ""
    before = (record.columns["time"][-1:] - record.fault_time) * 1e3
    since = [f"  the first fault came {one:.1f} ms before the last cycle" for one in before if math.isfinite(one)]
    code = [f"{name} {record.versions[name]!s:.12}" for name in ("maglev_mj", "revision") if name in record.versions]
    left_out = len(rows) - len(shown)
    return "\n".join(
        [
            f"  {printable(record.faults)}{printable(first)}",
            *_reasons(record.faults),
            f"  {printable(record.message)}",
            f"  {record.tick * record.period:.3f} s after the first of {record.tick + 1} samples at "
            f"{1.0 / record.period:g} Hz, {record.lost} lost, {record.skipped} skipped",
            *since,
            *([f"  written by {printable(', '.join(code))}"] if code else []),
            *([f"  the last {len(shown)} of {len(rows)} cycles; --all shows them all"] if left_out else []),
            "",
            *lines,
        ]
    )


def _reasons(names: str) -> list[str]:
    """Return what each fault of some names means, a line each."""
    known = [fault for fault in _REASONS if (fault.name or "") in names.split()]
    return [f"    {fault.name}: {_REASONS[fault]}" for fault in known]
