"""Scene on the limited device, in real time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from numpy.typing import ArrayLike

from maglev_mj.controller import Controller
from maglev_mj.hand import HandForce
from maglev_mj.laws import Bias
from maglev_mj.plants import MuJoCoPlant, Timing
from maglev_mj.scenes import Scene
from maglev_mj.scenes.parts import WEIGHT
from maglev_mj.session.actions import settable
from maglev_mj.spec import Spec

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
