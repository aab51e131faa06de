"""A stretch of a session under unchanged settings: one plant, one controller, one loop."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from maglev_mj.frames import ZERO, Array, Command, Sample
from maglev_mj.hand import HandForce
from maglev_mj.loop import ControlLoop
from maglev_mj.recording import RecordingFile, RunMetadata, carried_by, wall_faces
from maglev_mj.scenes import Scene, Settings
from maglev_mj.session.energy import EnergyAccount
from maglev_mj.session.view import stick_positions

__all__ = ["LiveStretch", "scene_setup"]


def scene_setup(
    scene: Scene, settings: Settings, pose: Sequence[float], twist: Sequence[float], wrench: Sequence[float]
) -> dict[str, Any]:
    """Return what a stretch is made from, ready for JSON."""
    return {
        "kind": "scene",
        "scene": scene.name,
        "settings": settings.as_json(),
        "pose": [float(part) for part in pose],
        "twist": [float(part) for part in twist],
        "wrench": [float(part) for part in wrench],
    }


class LiveStretch:
    """A scene running under one choice of settings, from a given state on.

    Args:
        scene: The scene.
        settings: Its settings.
        hand: The hand.
        pose: Where the flotor starts [m, rad].
        twist: How fast [m/s, rad/s].
        wrench: What the coils give until the first command takes effect [N, N m].
        file: What every sample is recorded to; None for nothing.
        began: Time of the session at which it starts [s].
        keep: Called after each tick with a row of history.

    Attributes:
        energy: Where the energy went.
        faces: Every wall: index into AXES, normal, edge.
    """

    def __init__(
        self,
        scene: Scene,
        settings: Settings,
        hand: HandForce,
        *,
        pose: Sequence[float],
        twist: Sequence[float] = ZERO,
        wrench: Sequence[float],
        file: RecordingFile | None,
        began: float,
        keep: Callable[[tuple[float, ...]], object],
    ) -> None:
        self.plant = scene.plant(settings, pose=pose, twist=twist, wrench=wrench, hand_force=hand)
        self.controller = scene.controller(settings)
        record = None
        if file is not None:
            run = RunMetadata.of(self.plant, self.controller, name=f"scene {scene.name}", axis=scene.axis)
            setup = {**scene_setup(scene, settings, pose, twist, wrench), "run": run.as_json()}
            record = file.begin(self.plant, self.controller, setup)
        self._carried = carried_by(self.controller.laws)
        self.energy = EnergyAccount(np.array(pose), self._carried)
        self.faces = wall_faces(self.controller.laws)
        self._stick_positions = stick_positions(self.controller)
        self._loop = ControlLoop(self.plant, self.controller, observe=self._observe, record=record)
        self._axis, self._keep, self._began = scene.axis_index, keep, began
        self.ticks, self._settings = 0, settings
        self.pose, self.twist = np.array(pose, dtype=np.float64), np.array(twist, dtype=np.float64)
        self.force: Sequence[float] = wrench

    def tick(self) -> None:
        """Answer one sample."""
        self._loop.cycle()
        self.ticks += 1

    @property
    def time(self) -> float:
        """Time of the session [s]."""
        return self._began + self.ticks * self._settings.period

    @property
    def anchors(self) -> Array | None:
        """Where the flotor sticks [m, rad], (6,), NaN on axes without friction; None where there is none at all."""
        return self._stick_positions()

    @property
    def rendered(self) -> Array:
        """Wrench of the device beyond what carries the flotor [N, N m], (6,)."""
        rendered: Array = np.array(self.force) - self._carried
        return rendered

    def _observe(self, sample: Sample, applied: Command) -> None:
        plant, axis = self.plant, self._axis
        self.pose, self.twist = plant.state()
        effort = plant.hand_wrench
        self.energy.add(self.pose, effort, plant.work)
        self.force = applied.force
        force = float(applied.force[axis] - self._carried[axis])
        self._keep((self.time, float(self.pose[axis]), float(self.twist[axis]), force, float(effort[axis])))
