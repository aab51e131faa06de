"""Stability of many scenes: laws that differ in gains alone are probed and linearised together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from maglev_mj.control import AxisLaw
from maglev_mj.control.controller import Controller
from maglev_mj.control.stack import alike, computed_together, law_kind
from maglev_mj.errors import MaglevError
from maglev_mj.scenes.scene import Scene
from maglev_mj.theory.read import of_scene, probed_at, scene_hand, scene_lag, stated_gains
from maglev_mj.theory.verdict import Verdict, stability, verdicts

_AT_ONCE = 16
"""Scenes that are linearised at once, limited by memory."""
_STATED = "stated"
"""Kind of all scenes whose laws declare their gains."""


def cell_verdicts(scenes: Sequence[Scene]) -> list[Verdict | Exception]:
    """Return the verdict of `stability` on each scene, or the error that it raises."""
    result: list[Verdict | Exception] = [MaglevError()] * len(scenes)
    kinds, controllers = dict[int, Any](), dict[int, Controller]()
    contents: list[Any] = [None] * len(scenes)
    for index, scene in enumerate(scenes):
        try:
            controllers[index] = controller = scene.controller()
            kinds[index] = _kind(scene, controller, index)
            contents[index] = _content(scene, controller, index)
        except Exception as error:  # of a user's scene
            result[index] = error
    equal = [*alike(contents).values()]
    firsts = [first for first, *_ in equal]
    judged = computed_together(
        firsts,
        [kinds[first] for first in firsts],
        lambda some: _together([(scenes[index], controllers[index]) for index in some]),
        most=lambda first: len(scenes) if kinds[first] == _STATED else _AT_ONCE,
    )
    for indices, verdict in zip(equal, judged, strict=True):
        for index in indices:
            result[index] = verdict
    return result


def _content(scene: Scene, controller: Controller, index: int) -> Any:
    """Return what is equal for scenes that differ in nothing that matters to a verdict, such as a height."""
    laws: list[Any] = []
    for law in controller.laws:
        if not isinstance(law, AxisLaw) or not is_dataclass(law):
            return index
        laws.append((type(law), *(repr(getattr(law, entry.name)) for entry in fields(law) if entry.init)))
    body = scene.body.bounded
    clocks = scene.period, scene.delay, scene.device_clock, scene_lag(scene), repr(scene_hand(scene))
    arrays = scene.start().pose, body.inertia, body.load, body.range
    return (*laws, repr(controller.velocity), *clocks, *map(np.ndarray.tobytes, map(np.asarray, arrays)))


def _kind(scene: Scene, controller: Controller, index: int) -> Any:
    """Return what is equal for scenes whose laws are linearised together."""
    body = scene.body.bounded
    if stated_gains(controller) is not None:
        return _STATED
    kinds = [law_kind(law) for law in controller.laws]
    own: Any = index if None in kinds or controller.on_device else (controller.period, repr(controller.velocity))
    return (own, *kinds, *map(np.ndarray.tobytes, map(np.asarray, (scene.start().pose, body.range, body.load))))


def _together(members: Sequence[tuple[Scene, Controller]]) -> Sequence[Verdict | Exception]:
    """Return the verdict on each scene of one kind with its controller; one after another if one fails."""
    try:
        controllers, first = [controller for _, controller in members], members[0][0]
        if len(members) == 1 or stated_gains(controllers[0]) is not None:
            return verdicts([of_scene(scene, controller=controller) for scene, controller in members])
        body, pose = first.body.bounded, np.asarray(first.start().pose, dtype=np.float64)
        around: Any = {"reach": np.asarray(body.range), "load": np.asarray(body.load)}
        probed = probed_at(controllers, pose=pose, **around)
        pairs = zip(members, probed, strict=True)
        return verdicts([of_scene(scene, controller=controller, probed=one) for (scene, controller), one in pairs])
    except Exception as error:
        return [error] if len(members) == 1 else [_alone(scene) for scene, _ in members]


def _alone(scene: Scene) -> Verdict | Exception:
    try:
        return stability(scene)
    except Exception as error:  # of a user's law
        return error
