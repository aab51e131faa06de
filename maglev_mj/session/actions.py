"""Changes of a running scene: live parameters and key actions."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, TypeAlias

from maglev_mj.errors import ParameterError
from maglev_mj.parameters import Parameter
from maglev_mj.scenes import Scene
from maglev_mj.scenes.stability_check import user_errors_rejected

DEVICE_PARAMETERS = "period", "delay"
"""Parameters that other programs cannot change: set by the device, or by the local user."""

EMERGENCY_STOP = "emergency stop"
"""Name of the emergency stop action."""

SCENE_PREFIX = "scene "
"""Prefix of the actions that select a scene by name."""

REWIND_ACTIONS = "rewind", "resume from here", "repeat the hand's motion"
"""Rewind actions of a session; the first goes back by one second."""

Action: TypeAlias = Callable[[Scene], Scene]
"""Function that returns the changed scene."""


def settable_parameters(scene: Scene | type[Scene]) -> tuple[str, ...]:
    """Return the parameters that other programs may change."""
    return tuple(entry.name for entry in scene.parameters() if entry.live and entry.name not in DEVICE_PARAMETERS)


def actions(cls: type[Scene]) -> Mapping[str, Action]:
    """Return a scene's key actions by name.

    NAME toggles a switch or steps through choices, and toggles a number between 0 and its default if 0 is allowed;
    "NAME up" and "NAME down" step a number.
    """
    changes: dict[str, Action] = {}
    for entry in cls.parameters():
        if not entry.live or not entry.live.has_keys:
            continue
        word = entry.live.word or entry.name
        if choices := (False, True) if entry.kind is bool else entry.choices:
            changes[word.replace("_", " ")] = partial(_next_choice, entry.name, choices)
            continue
        if entry.kind not in (float, int):
            continue
        if (entry.default or entry.derive) and entry.bounds.get("at_least") == 0.0 and not entry.live.word:
            changes[word] = partial(_toggle_number, entry)
        for direction, sign in (("up", 1), ("down", -1)):
            changes[f"{word} {direction}"] = partial(_step_number, entry, sign)
    return changes


def device_actions(cls: type[Scene]) -> tuple[str, ...]:
    """Return the actions of a scene on a device."""
    fixed = {
        entry.live.word or entry.name for entry in cls.parameters() if entry.live and entry.name in DEVICE_PARAMETERS
    }
    names = (name for name in actions(cls) if name.removesuffix(" up").removesuffix(" down") not in fixed)
    return *names, EMERGENCY_STOP


def changed(
    scene: Scene, change: Mapping[str, Any] | str | Scene, *, own: bool = False, besides: Sequence[str] = ()
) -> Scene:
    """Return a scene after a change by a key, a slider, a page or a program.

    Args:
        scene: The current scene.
        change: Values by name, the name of a key action, or a scene with other values.
        own: True if sample period and delay may change, as by a local user in simulation.
        besides: Names of parameters that the caller handles, for the message.

    Raises:
        ParameterError: If a live parameter is unknown, a value is refused, or the scene's code fails.
    """
    with user_errors_rejected():
        if isinstance(change, Scene):
            return change.replace(**{name: getattr(scene, name) for name in DEVICE_PARAMETERS})
        if isinstance(change, str):
            return actions(type(scene))[change](scene)
        if fixed := [name for name in DEVICE_PARAMETERS if name in change and not own]:
            raise ParameterError(f"{fixed[0]} is set by the device or the local user; other programs cannot change it")
        live = (*(DEVICE_PARAMETERS if own else ()), *settable_parameters(scene))
        if unknown := sorted(set(change) - set(live)):
            raise ParameterError(f"parameters must be among {', '.join((*live, *besides))} (got {', '.join(unknown)})")
        return scene.replace(**change)


def _next_choice(name: str, choices: Sequence[Any], scene: Scene) -> Scene:
    return scene.replace(**{name: choices[(choices.index(getattr(scene, name)) + 1) % len(choices)]})


def _toggle_number(parameter: Parameter, scene: Scene) -> Scene:
    name = parameter.name
    return scene.replace(**{name: 0.0 if getattr(scene, name) else parameter.usual(scene)})


def _step_number(parameter: Parameter, sign: int, scene: Scene) -> Scene:
    assert parameter.live
    if (value := getattr(scene, parameter.name)) is None:
        return scene
    lowest, highest = parameter.bounds.get("at_least", -math.inf), parameter.bounds.get("at_most", math.inf)
    stepped = parameter.live(value, sign)
    if parameter.kind is int:  # step by at least 1, or a small number would not change
        stepped = value + sign if round(stepped) == value else round(stepped)
    # clamp at the bound instead of raising
    return scene.replace(**{parameter.name: min(max(stepped, lowest), highest)})
