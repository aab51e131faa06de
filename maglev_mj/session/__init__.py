"""Scene in real time, without a window.

Pacing, changes by keys, recording, and snapshots.
"""

from maglev_mj.scenes.stability_check import STEP_FORCE, UnstableLoop, check_step, own_code_refused, unstable_loop
from maglev_mj.session.actions import DEVICES_OWN, EMERGENCY_STOP, actions, device_actions, settable
from maglev_mj.session.live import device_controller, live_plant
from maglev_mj.session.pacing import TIME_SCALES, Due, Note, Pacer, next_scale, real_time
from maglev_mj.session.session import Session
from maglev_mj.session.snapshot import (
    SHOWN,
    History,
    Publisher,
    Publishers,
    SampledMotion,
    Snapshot,
    SnapshotSource,
    TourLine,
    Wish,
)
from maglev_mj.session.stretch import begin_scene

__all__ = [
    "DEVICES_OWN",
    "EMERGENCY_STOP",
    "SHOWN",
    "STEP_FORCE",
    "TIME_SCALES",
    "Due",
    "History",
    "Note",
    "Pacer",
    "Publisher",
    "Publishers",
    "SampledMotion",
    "Session",
    "Snapshot",
    "SnapshotSource",
    "TourLine",
    "UnstableLoop",
    "Wish",
    "actions",
    "begin_scene",
    "check_step",
    "device_actions",
    "device_controller",
    "live_plant",
    "next_scale",
    "own_code_refused",
    "real_time",
    "settable",
    "unstable_loop",
]
