"""Faults as text: latched in a device, or recorded."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from maglev_mj.bridge.fault import FaultRecord
from maglev_mj.bridge.wire import Fault, State, fault_names
from maglev_mj.frames import AXES
from maglev_mj.parameters import flag
from maglev_mj.result import printable, wrapped

if TYPE_CHECKING:
    from maglev_mj.bridge.remote import RemotePlant

_SHOWN = 20

_HEADING = ("ms", *AXES, "A cmd", "A meas", "warm %", "delay", "answer")
_WIDTHS = (7, *[6] * 3, *[7] * 3, 7, 7, 7, 6, 7)


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


def fault_table(record: FaultRecord, *, whole: bool = False) -> str:
    """Return a fault and its last cycles as text.

    A dash stands for an unknown value.

    A line names each new state. Time is before the last cycle [ms], the pose [mm, mrad], currents the
    largest of the six [A], commanded and measured, the temperature the highest, the delay at the device and the
    latency of the answer [ms].

    Args:
        record: The black box.
        whole: True for every cycle, else the last 20.
    """
    flag("whole", whole)
    when = "" if math.isnan(record.fault_time) else f" at {record.fault_time:.4f} s of the device's clock"
    lines = [
        *wrapped(printable(record.message)),
        *wrapped(f"faults {printable(record.faults)}; first {printable(record.first)}{when}"),
        *_reasons(record.faults),
        f"  sample {record.tick} at {1.0 / record.period:g} Hz; {record.lost} lost, {record.skipped} skipped",
        _line(_HEADING),
    ]
    pose, time, column = record.six("pose") * 1e3, record.time * 1e3, record.columns
    held, measured = (np.abs(record.six(kind)).max(axis=-1, initial=0.0) for kind in ("held", "measured"))
    pulsed = np.abs(record.six("pulsed")).max(axis=-1, initial=0.0)
    commanded = np.where(column["width"] > 0.0, np.maximum(held, pulsed), held)
    warm = record.six("temperature").max(axis=-1, initial=0.0) * 100.0
    first = 0 if whole else max(len(time) - _SHOWN, 0)
    if first:
        lines.insert(-1, f"  the last {_SHOWN} of {len(time)} cycles; --all shows all")
    for place in range(first, len(time)):
        state = column["state"][place]
        if place == first or state != column["state"][place - 1]:
            named = State(int(state)).name.lower() if state in tuple(State) else _cell(state, 0)
            lines.append(f"  {named}, from sample {column['sample'][place]:.0f} on")
        lines.append(
            _line(
                (
                    f"{time[place]:.1f}",
                    *(_cell(value, 2) for value in (*pose[place], commanded[place], measured[place])),
                    _cell(warm[place], 0),
                    *(_cell(column[name][place] * 1e3, 2) for name in ("delay", "latency")),
                )
            )
        )
    return "\n".join(lines)


def _cell(value: float, places: int) -> str:
    return "-" if math.isnan(value) else f"{value:.{places}f}"


def _line(cells: tuple[str, ...]) -> str:
    return "".join(f"{cell:>{width}}" for cell, width in zip(cells, _WIDTHS, strict=True))


def _reasons(names: str) -> list[str]:
    """Return the meaning of each named fault, one per line."""
    known = [fault for fault in _REASONS if (fault.name or "") in names.split()]
    return [line for fault in known for line in wrapped(f"{fault.name}: {_REASONS[fault]}", "    ", "      ")]


def latched_table(plant: RemotePlant) -> str:
    """Return the faults latched at the handshake as text."""
    if not plant.faults:
        return f"  no fault is latched; the device is {plant.state.name.lower()}"
    return "\n".join([*wrapped(plant.latched), *_reasons(fault_names(plant.faults))])
