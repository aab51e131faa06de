"""Stability of many scenes with laws that declare no gains: one linearisation for those that differ in stiffness."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from maglev_mj.control import AxisLaw
from maglev_mj.control.controller import Controller
from maglev_mj.control.stack import law_kind
from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Array
from maglev_mj.scenes.scene import Scene
from maglev_mj.scenes.wall_scene import WallScene, along
from maglev_mj.spec import GRAVITY
from maglev_mj.theory.critical import RATIOS, affine_law
from maglev_mj.theory.read import Probed, loops_at, of_scene, probed_together, scene_doubts, scene_hand, scene_lag
from maglev_mj.theory.verdict import stability, verdicts

_INSIDE, _END = (1e-6, 1e-4), 0.9871
"""Depths just inside a wall [m], and fraction of the range of motion."""
_AT_ONCE = 64
"""Scenes that are probed at once."""
_FREE = 1e-7
"""Distance from 1 of a spectral radius that may be a pole of free motion, which a verdict leaves out."""


def unstable_cells(scenes: Sequence[Scene]) -> list[bool | None]:
    """Return whether each scene has an unstable loop at its start, or at some poses in its wall.

    Scenes that differ in the stiffness of a wall alone share their linearisation, if their law is affine in it. None if
    not computed.

    Raises:
        MaglevError: If a law fails at a pose.
    """
    groups, result = defaultdict[Any, list[int]](list), list[bool | None]([None] * len(scenes))
    gains = [scene.stiffness for scene in scenes if isinstance(scene, WallScene) and scene.stiffness > 0.0]
    for index, scene in enumerate(scenes):
        groups[_key(scene, min(gains, default=0.0))].append(index)
    rest = list[int]()
    for indices in groups.values():
        shared = _judged([scenes[index] for index in indices])
        rest += indices if shared is None else []
        for index, stable in zip(indices, shared or (), strict=False):
            result[index] = None if stable is None else not stable
    for index, stable in zip(rest, _together([scenes[index] for index in rest]), strict=True):
        result[index] = None if stable is None else not stable
    return result


def _together(scenes: Sequence[Scene]) -> list[bool | None]:
    """Return whether scenes are stable; laws that differ in gains alone are probed and linearised at once."""
    groups, result = defaultdict[Any, list[int]](list), list[bool | None]([None] * len(scenes))
    for index, scene in enumerate(scenes):
        body, controller = scene.body.bounded, scene.controller()
        kinds = [law_kind(law) for law in controller.laws]
        own: Any = index if None in kinds or controller.on_device else (controller.period, repr(controller.velocity))
        where = scene.start().pose, body.range, body.load
        groups[own, *kinds, *map(np.ndarray.tobytes, map(np.asarray, where))].append(index)
    for indices in groups.values():
        for first in range(0, len(indices), _AT_ONCE):
            some = indices[first : first + _AT_ONCE]
            body, poses = scenes[some[0]].body.bounded, [_poses(scenes[index]) for index in some]
            probed: list[Probed | None] = [None] * len(some)
            if len(some) > 1:
                around: Any = {"pose": scenes[some[0]].start().pose, "reach": body.range, "load": body.load}
                probed[:] = probed_together([scenes[index].controller() for index in some], poses, **around)
            each = [of_scene(scenes[index], poses=own, probed=one) for index, own, one in zip(some, poses, probed)]
            for index, verdict in zip(some, verdicts(each), strict=True):
                result[index] = verdict.stable
    return result


def _key(scene: Scene, stiffness: float) -> Any:
    """Return what is equal for scenes that differ in the stiffness of a wall, and in nothing else that matters."""
    same = scene.replace(stiffness=stiffness) if isinstance(scene, WallScene) and scene.stiffness > 0.0 else scene
    controller, body = same.controller(), same.body.bounded
    around = same.period, same.delay, scene_lag(same), *map(np.ndarray.tobytes, (body.inertia, body.load, body.range))
    laws: list[Any] = [repr(controller.velocity)]
    for law in controller.laws:
        if not isinstance(law, AxisLaw) or not is_dataclass(law):
            return type(same), repr(same.as_json()), *around
        laws.append((type(law), *(repr(getattr(law, entry.name)) for entry in fields(law) if entry.init)))
    return type(same), scene is same, *laws, *around


def _judged(scenes: Sequence[Scene]) -> list[bool | None] | None:
    """Return whether scenes that differ in stiffness alone are stable; None if their law is not affine in it."""
    first: Any = scenes[0]
    if len(scenes) == 1 or not isinstance(first, WallScene):
        return None
    radii = _radii(first, np.array([scene.stiffness for scene in scenes]))  # type: ignore[attr-defined]
    if radii is None:
        return None
    common = stability(first, poses=_poses(first))
    if common.stable is False and first.axis not in common.axes:
        return [False] * len(scenes)
    (doubt,) = scene_doubts([first], first.axis_index) if first.axis in common.doubts else (None,)
    others = {*common.unjudged} - {*common.doubts}
    void, reason = (False, "") if doubt is None else (doubt.void, doubt.reason)
    return [None if void else False if radius >= 1.0 else None if others or reason else True for radius in radii]


def _poses(scene: Any) -> Array:
    """Return the start, and poses just inside each wall, where it carries the weight, and at the end of the range.

    Without a wall, the centre and both ends of the shown axis.
    """
    start, reach = scene.start().pose, scene.body.bounded.range * _END
    if not (isinstance(scene, WallScene) and scene.stiffness > 0.0):
        ends = (along(scene.shown_axis, sign * float(reach[AXES.index(scene.shown_axis)])) for sign in (-1.0, 1.0))
        return np.array([start, np.zeros(len(AXES)), *ends])
    depth = float(scene.body.inertia[0]) * GRAVITY / scene.stiffness
    rows = []
    for axis, normal, edge in scene.controller().faces or [(scene.axis_index, 1.0, 0.0)]:
        depths = *_INSIDE, depth, normal * edge + float(reach[axis])
        rows += [along(AXES[axis], edge - normal * one) for one in depths]
    return np.array([start, *rows])


def _radii(scene: Any, stiffness: Array) -> Array | None:
    """Return the largest spectral radius of the wall's loop at each stiffness; None if a law is not affine in it."""
    body, axis = scene.body.inertia, scene.axis_index
    if not scene.stiffness > 0.0:
        return None
    try:
        some: list[Controller] = [scene.replace(stiffness=one * scene.stiffness).controller() for one in RATIOS]
    except ParameterError:  # out of bounds
        return None
    poses = _poses(scene)[1:]
    around: Any = {"delay": scene.delay, "driver_lag": scene_lag(scene), "device": scene.device_clock}
    rows = np.repeat(poses, len(RATIOS), axis=0)
    found = loops_at(some * len(poses), axis, poses=rows, inertia=body, **around)
    ratios, radii = stiffness / scene.stiffness, []
    for loops in (found, *[found.replace(hand=hand) for hand in [scene_hand(scene)] if hand]):
        for first in range(0, len(loops), len(RATIOS)):
            three = loops[first : first + len(RATIOS)]
            if (law := affine_law(three)) is None:
                return None
            loop = three[0].array(law=law.__call__, velocity=None)
            radii.append(np.asarray(loop.spectral_radius(ratios, np.zeros_like(ratios))))
    free = np.abs(np.array(radii) - 1.0) < _FREE
    return None if free.any() or not (ratios > 0.0).all() else np.max(radii, axis=0)
