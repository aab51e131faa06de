"""Stretch of a session: constant parameters, plant and controller."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.control import Bias
from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import ControlLoop, Record
from maglev_mj.frames import ZERO, Array, Command, Sample
from maglev_mj.plants import MuJoCoPlant, Timing
from maglev_mj.plants.hand import HandForce
from maglev_mj.plants.trace import EnergyAccount
from maglev_mj.recording import RecordingFile, setup_of
from maglev_mj.recording.setup import attach_model, attach_source
from maglev_mj.scenes import Scene
from maglev_mj.scenes.find import reference_of, source_of
from maglev_mj.scenes.interactive import WEIGHT
from maglev_mj.session.actions import settable
from maglev_mj.spec import Spec


def begin_scene(file: RecordingFile, scene: Scene, plant: Any, controller: Controller, **known: Any) -> Record:
    """Begin a stretch of a recording with a scene's metadata.

    Args:
        file: The file.
        scene: The scene.
        plant: The controlled plant.
        controller: The controller.
        known: Further arguments of `setup_of`.
    """
    cls = type(scene)
    attach_model(file, scene.model)
    attach_source(file, cls)
    known |= {"scene": reference_of(cls), "source": source_of(cls), "parameters": scene.as_json(), "axis": scene.axis}
    return file.begin(plant, controller, setup_of(plant, controller, **known))


class LiveStretch:
    """Scene running with constant parameters from a given state.

    Args:
        scene: The scene.
        hand: The hand.
        pose: Initial pose [m, rad].
        twist: Initial twist [m/s, rad/s].
        wrench: Coil wrench until the first command takes effect [N, N m].
        file: Recording of every sample; None for none.
        began: Session time at the start [s].
        keep: Called after each tick with a row of history, see `History.add`.

    Attributes:
        scene: The scene.
        energy: Energy balance.
        faces: Every wall: index into AXES, normal, edge.
        pulsed: True if the last command had a pulse.
    """

    def __init__(
        self,
        scene: Scene,
        hand: HandForce,
        *,
        pose: Sequence[float],
        twist: Sequence[float] = ZERO,
        wrench: Sequence[float],
        file: RecordingFile | None,
        began: float,
        keep: Callable[..., object],
    ) -> None:
        self.plant = live_plant(scene, hand, pose=pose, twist=twist, wrench=wrench)
        self.controller = scene.controller()
        record = None
        if file is not None:
            record = begin_scene(file, scene, self.plant, self.controller, name=f"scene {scene.name}")
        self._carried = self.controller.carried
        self.energy = EnergyAccount(np.array(pose), self._carried)
        self.faces = self.controller.faces
        self._loop = ControlLoop(self.plant, self.controller, observe=self._observe, record=record)
        self.scene, self._keep, self._began = scene, keep, began
        self.ticks, self._period = 0, scene.period
        self.pose, self.twist = np.array(pose, dtype=np.float64), np.array(twist, dtype=np.float64)
        self.force: Sequence[float] = wrench
        self.pulsed = False

    def tick(self) -> None:
        """Answer one sample."""
        self._loop.cycle()
        self.ticks += 1

    @property
    def time(self) -> float:
        """Time of the session [s]."""
        return self._began + self.ticks * self._period

    @property
    def anchors(self) -> Array | None:
        """Stick positions [m, rad], (6,).

        NaN on axes without friction; None without any friction.
        """
        return self.controller.stick_positions

    @property
    def rendered(self) -> Array:
        """Device wrench without weight compensation [N, N m], (6,)."""
        rendered: Array = np.array(self.force) - self._carried
        return rendered

    def _observe(self, sample: Sample, applied: Command) -> None:
        plant = self.plant
        self.pose, self.twist = plant.state()
        effort = plant.hand_wrench
        self.energy.add(self.pose, effort, plant.work)
        self.force = applied.force
        self.pulsed = applied.extra is not None and any(applied.extra)
        self._keep(self.time, self.pose, self.twist, self.rendered, effort)


_LIFTED = 0.004


def lifted(scene: Scene) -> tuple[Scene, Sequence[float]]:
    """Return the scene with gravity, and a raised start pose.

    The pose is [m, rad], at a height of 4 mm.
    """
    pose = scene.start().pose
    falling = scene.replace(weightless=False) if "weightless" in settable(scene) else scene
    return falling, (*pose[:2], _LIFTED, *pose[3:])


def centred(scene: Scene) -> Scene:
    """Return the scene with its default gravity compensation."""
    if "weightless" not in settable(scene):
        return scene
    return scene.replace(weightless=scene.parameter("weightless").default)


def live_plant(scene: Scene, hand: HandForce | None = None, **start: ArrayLike) -> MuJoCoPlant:
    """Return a scene's plant with stops and current limits.

    At most 10 A in each coil unless the scene has another limit.

    Args:
        scene: The scene.
        hand: The hand on the flotor; its attribute `hand`, if any, is its impedance.
        start: Pose, twist and wrench in place of the scene's own.
    """

    def make(timing: Timing, **options: Any) -> MuJoCoPlant:
        limits: dict[str, Any] = {"current_limit": Spec.peak_current.value, "stops": True, "metered": True}
        return MuJoCoPlant(timing, **limits | options | {"hand_force": hand, "hand": getattr(hand, "hand", None)})

    plant = scene.plant(make, **start)  # type: ignore[arg-type]
    assert isinstance(plant, MuJoCoPlant)
    return plant


def device_controller(scene: Scene) -> Controller:
    """Return a scene's controller for a device, with gravity compensation.

    Added only if the scene has no gravity.
    """
    controller = scene.controller()
    if scene.start().gravity:
        return controller
    return Controller([*controller.laws, Bias(WEIGHT)], period=scene.period, velocity=scene.velocity_estimator())
