"""Changes of a running scene: live parameters, actions of keys."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, TypeAlias

from maglev_mj.errors import ParameterError
from maglev_mj.parameters import Parameter
from maglev_mj.scenes import Scene
from maglev_mj.scenes.stability_check import own_code_refused

DEVICES_OWN = "period", "delay"
"""Parameters that other programs cannot change.

They belong to the device, or to the user at the machine.
"""

EMERGENCY_STOP = "emergency stop"
"""Action of the emergency stop key of every window."""

CHOOSES = "scene "
"""Prefix of a session's actions that choose a scene by name."""

REWINDS = "rewind", "go on from here", "same hand again"
"""Actions of a session that can be rewound; the first goes back by a second."""

Action: TypeAlias = Callable[[Scene], Scene]
"""Function that returns the changed scene."""


def settable(scene: Scene | type[Scene]) -> tuple[str, ...]:
    """Return the parameters that other programs may change."""
    return tuple(one.name for one in scene.parameters() if one.live and one.name not in DEVICES_OWN)


def actions(cls: type[Scene]) -> Mapping[str, Action]:
    """Return a scene's key actions by name.

    A switch has its name; a number has "NAME up" and "NAME down", and its name alone turns it off and on if
    it may be 0.
    """
    changes: dict[str, Action] = {}
    for one in cls.parameters():
        if not one.live or not one.live.has_keys or one.kind not in (bool, float, int):
            continue
        word = one.live.word or one.name
        if one.kind is bool:
            changes[word] = partial(_switched, one.name)
            continue
        if one.default and one.bounds.get("at_least") == 0.0 and not one.live.word:
            changes[word] = partial(_cleared, one.name, one.default)
        for sense, way in (("up", 1), ("down", -1)):
            changes[f"{word} {sense}"] = partial(_turned, one, way)
    return changes


def device_actions(cls: type[Scene]) -> tuple[str, ...]:
    """Return the actions of a scene on a device."""
    own = {one.live.word or one.name for one in cls.parameters() if one.live and one.name in DEVICES_OWN}
    names = (name for name in actions(cls) if name.removesuffix(" up").removesuffix(" down") not in own)
    return *names, EMERGENCY_STOP


def changed(
    scene: Scene, change: Mapping[str, Any] | str | Scene, *, own: bool = False, besides: Sequence[str] = ()
) -> Scene:
    """Return a scene after a change by a key, a slider, a page, a program.

    Args:
        scene: The scene in force.
        change: Values by name; the name of a key's action; or a scene with other values.
        own: True if sample rate and delay may change too, as by a person in simulation.
        besides: Names of values that the caller takes itself, for the message.

    Raises:
        ParameterError: If there is no such live parameter, a value is refused, or the scene's own code fails.
    """
    with own_code_refused():
        if isinstance(change, Scene):
            return change.replace(**{name: getattr(scene, name) for name in DEVICES_OWN})
        if isinstance(change, str):
            return actions(type(scene))[change](scene)
        if fixed := [name for name in DEVICES_OWN if name in change and not own]:
            raise ParameterError(f"{fixed[0]} is the device's, or the person's at the machine; a program cannot set it")
        live = (*(DEVICES_OWN if own else ()), *settable(scene))
        if unknown := sorted(set(change) - set(live)):
            raise ParameterError(f"parameters must be of {', '.join((*live, *besides))}, not {', '.join(unknown)}")
        return scene.replace(**change)


def _switched(name: str, scene: Scene) -> Scene:
    return scene.replace(**{name: not getattr(scene, name)})


def _cleared(name: str, default: float, scene: Scene) -> Scene:
    return scene.replace(**{name: 0.0 if getattr(scene, name) else default})


def _turned(one: Parameter, way: int, scene: Scene) -> Scene:
    assert one.live
    if (value := getattr(scene, one.name)) is None:
        return scene
    least, most = one.bounds.get("at_least", -math.inf), one.bounds.get("at_most", math.inf)
    turned = one.live(value, way)
    if one.kind is int:  # a whole step at least, or a small number would stay
        turned = value + way if round(turned) == value else round(turned)
    # a person at a key is stopped at a bound, not told off
    return scene.replace(**{one.name: min(max(turned, least), most)})
