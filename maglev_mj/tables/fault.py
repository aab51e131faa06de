"""A black box as text."""

from __future__ import annotations

import math

import numpy as np

from maglev_mj.bridge.fault import FaultRecord
from maglev_mj.bridge.wire import State
from maglev_mj.frames import AXES
from maglev_mj.terminal import printable

__all__ = ["fault_table"]

_HEADING = ("sample", "ms", "state", *AXES, "A cmd", "A meas", "warm %", "delay", "answer")
_WIDTHS = (7, 8, 9, *[7] * 6, 6, 7, 7, 6, 7)


def fault_table(record: FaultRecord) -> str:
    """Return a fault and its last cycles as text: 99 columns, a dash where a value is unknown.

    Time is before the last cycle [ms], the pose [mm, mrad], currents the largest of the six [A], commanded and
    measured, the temperature the highest, the delay at the device and the latency of the answer [ms].
    """
    when = "" if math.isnan(record.fault_time) else f" at {record.fault_time:.4f} s of the device's clock"
    lines = [
        f"  {printable(record.message)}",
        f"  faults {printable(record.faults)}; first {printable(record.first)}{when}",
        f"  sample {record.tick} at {1.0 / record.period:g} Hz; {record.lost} lost, {record.skipped} skipped",
        _line(_HEADING),
    ]
    pose, time, column = record.six("pose") * 1e3, record.time * 1e3, record.columns
    held, measured = (np.abs(record.six(kind)).max(axis=-1, initial=0.0) for kind in ("held", "measured"))
    pulsed = np.abs(record.six("pulsed")).max(axis=-1, initial=0.0)
    commanded = np.where(column["width"] > 0.0, np.maximum(held, pulsed), held)
    warm = record.six("temperature").max(axis=-1, initial=0.0) * 100.0
    for place, state in enumerate(column["state"]):
        lines.append(
            _line(
                (
                    f"{column['sample'][place]:.0f}",
                    f"{time[place]:.1f}",
                    State(int(state)).name.lower() if state in tuple(State) else _cell(state, 0),
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
