"""Stability of a scene as text."""

from __future__ import annotations

from maglev_mj.frames import AXES
from maglev_mj.scenes.scene import Scene
from maglev_mj.terminal import wrapped
from maglev_mj.theory import Verdict


def loop_table(scene: Scene, verdict: Verdict) -> str:
    """Return the stability of a scene's closed loop as text.

    Each state of the laws has a line; without stated gains, the worst pose is named.
    """
    place = ", ".join(f"{axis} {value:g}" for axis, value in zip(AXES, verdict.pose, strict=True) if value) or "centre"
    states = [str(state) for state in verdict.states] or [f"{verdict}; at {place} (m, rad)"]
    means = "by the laws' own gains" if verdict.stated else "by the answers of the laws to small displacements"
    lines = wrapped(f"{scene.name}: {scene.describe()}", "", "  ")
    for text in (*states, f"found {means}", *verdict.remarks):
        lines += wrapped(text)
    return "\n".join(lines)
