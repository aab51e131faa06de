"""Chart of the last cycles before a fault."""

from __future__ import annotations

import textwrap
from typing import Any

import numpy as np

from maglev_mj.bridge.fault import FaultRecord
from maglev_mj.colours import REFERENCE, SERIES
from maglev_mj.frames import AXES, Array
from maglev_mj.pictures import BESIDE, drawn, new_figure, wide_share
from maglev_mj.terminal import printable

_TICKS = 8


@drawn
def last_cycles(record: FaultRecord) -> Any:
    """Draw the last cycles before a fault.

    Lines are measured currents, dots commanded ones; a vertical line marks the first fault.

    Args:
        record: The last cycles.

    Raises:
        MissingPackageError: If matplotlib is not installed.
    """
    faults = textwrap.shorten(printable(record.faults), 70, placeholder="…")
    head = printable(record.headline), record.conditions, faults
    figure, axes = new_figure(head, 4, 1, 8.6, sharex=True, height_ratios=[2, 2, 3, 2])
    time, pose, columns = record.time * 1e3, record.six("pose") * 1e3, record.values
    _curves(axes[0], time, pose[:, :3], AXES[:3], "position (mm)")
    _curves(axes[1], time, pose[:, 3:], AXES[3:], "angle (mrad)")
    coils, label = [f"coil {index}" for index in range(6)], "current (A)\n—— measured   · · commanded"
    _curves(axes[2], time, record.six("measured"), coils, label)
    for index, held in enumerate(record.six("held").T):
        axes[2].plot(time, held, ".", color=SERIES[index], markersize=2.5)
    spans = np.stack([columns["delay"], columns["latency"]], axis=-1) * 1e3
    _curves(axes[3], time, spans, ("loop delay", "host latency"), "delay (ms)")
    first = (record.fault_time - columns["time"][-1]) * 1e3 if len(time) else np.nan
    for axis in axes:
        if len(time) and time[0] <= first <= time[-1]:
            axis.axvline(first, color=REFERENCE, linewidth=1.0, linestyle="--")
    axes[3].set_xlabel("time relative to the last cycle (ms)")
    axes[3].locator_params(axis="x", nbins=max(int(_TICKS * wide_share()), 2))  # beside the legends
    return figure


def _curves(axis: Any, time: Array, values: Array, names: Any, label: str) -> None:
    """Draw a curve for each column, with a legend beside the chart."""
    for index, name in enumerate(names):
        axis.plot(time, values[:, index], color=SERIES[index], linewidth=1.4, label=name)
    axis.set_ylabel(label)
    axis.legend(**BESIDE)
