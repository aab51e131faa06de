"""Picture of the last cycles before a fault."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from maglev_mj.frames import AXES, Array
from maglev_mj.plots.drawing import MANY, new_figure, save

if TYPE_CHECKING:
    from maglev_mj.bridge.fault import FaultRecord

__all__ = ["fault_run"]

_COILS = [f"coil {place}" for place in range(6)]


def fault_run(record: FaultRecord, path: Path) -> Path:
    """Draw pose, spots, currents, temperatures and delays of the last cycles, over the time before the last.

    Args:
        record: A black box.
        path: PNG to write.

    Raises:
        ChartsMissingError: If matplotlib is not installed.
    """
    figure, panels = new_figure(3, 2, (11.0, 8.6), sharex=True)
    time, columns = record.time * 1e3, record.columns
    pose = record.six("pose") * 1e3
    _draw(panels[0], "position (mm)", time, pose[:, :3], AXES[:3])
    _draw(panels[1], "rotation (mrad)", time, pose[:, 3:], AXES[3:])
    _draw(panels[2], "spots on the diodes (mm)", time, record.six("spot") * 1e3, [f"spot {one}" for one in range(6)])
    _draw(panels[3], "currents measured, thin: commanded (A)", time, record.six("measured"), _COILS)
    for color, held in zip(MANY, record.six("held").T):
        panels[3].step(time, held, where="post", color=color, linewidth=0.7, linestyle="--")
    _draw(panels[4], "temperature, share of the limit (%)", time, record.six("temperature") * 1e2, _COILS)
    late = np.stack([columns["delay"], columns["latency"]], axis=-1) * 1e3
    _draw(panels[5], "delay (ms)", time, late, ("at the device", "of the answer"))
    for panel in panels[-2:]:
        panel.set_xlabel("time before the last cycle (ms)")
    figure.suptitle(f"{record.faults}: {record.message}"[:120], x=0.01, ha="left", fontsize=11)
    return save(figure, path)


def _draw(panel: Any, title: str, time: Array, values: Array, names: Any) -> None:
    panel.set_title(title, loc="left", fontsize=10.5)
    if not np.isfinite(values).any():
        panel.text(0.5, 0.5, "not recorded", transform=panel.transAxes, ha="center", color="#5a5f66")
        return
    for color, name, column in zip(MANY, names, values.T):
        panel.plot(time, column, color=color, linewidth=1.3, label=name)
    panel.legend(frameon=True, framealpha=0.85, edgecolor="none", fontsize=8, ncols=2 if len(names) > 3 else 1)
