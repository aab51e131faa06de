"""Key bindings of the window."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import glfw

from maglev_mj.session import EMERGENCY_STOP, REWIND_ACTIONS, SCENE_PREFIX

_ALWAYS = SCREENSHOT, AXIS, CAMERA, KEYS = "screenshot", "plot axis", "camera", "keys"
"""Actions available in every window."""


class Key(NamedTuple):
    """Key binding.

    Attributes:
        code: GLFW key code.
        name: Name in the help.
        action: Name of the action.
        row: Row of the help that the key shares with others.
        words: Description in the help; the name of the action by default.
    """

    code: int
    name: str
    action: str
    row: str
    words: str = ""


_KEYS = (
    Key(glfw.KEY_F11, "F11", KEYS, "keys", "keys, numbers, or neither"),
    Key(glfw.KEY_ENTER, "Enter", "next", "tour", "next step"),
    Key(glfw.KEY_9, "9", "back", "tour", "previous step"),
    Key(glfw.KEY_ENTER, "Enter", "next scene", "position"),
    Key(glfw.KEY_9, "9", "drop", "position"),
    Key(glfw.KEY_9, "9", "loop", "position", "loop on or off"),
    Key(glfw.KEY_SLASH, "/", "centre", "position"),
    Key(glfw.KEY_SPACE, "Space", "pause", "pause", "pause"),
    Key(glfw.KEY_LEFT, "Left", "step back", "pause"),
    Key(glfw.KEY_LEFT, "Left", "rewind", "pause", "rewind 1 s"),
    Key(glfw.KEY_RIGHT, "Right", "step", "pause", "single step"),
    Key(glfw.KEY_DELETE, "Delete", REWIND_ACTIONS[2], "repeat"),
    Key(glfw.KEY_MINUS, "-", "slower", "speed"),
    Key(glfw.KEY_EQUAL, "=", "faster", "speed"),
    Key(glfw.KEY_DOWN, "Down", "skip back", "skip"),
    Key(glfw.KEY_UP, "Up", "skip forward", "skip"),
    Key(glfw.KEY_HOME, "Home", "start", "ends"),
    Key(glfw.KEY_END, "End", "end", "ends"),
    Key(glfw.KEY_F10, "F10", "record", "files"),
    Key(glfw.KEY_F12, "F12", SCREENSHOT, "files"),
    Key(glfw.KEY_GRAVE_ACCENT, "Backquote `", AXIS, "view"),
    Key(glfw.KEY_PAGE_DOWN, "Page Down", CAMERA, "camera", "reset camera"),
    Key(glfw.KEY_ESCAPE, "Esc", EMERGENCY_STOP, "stop"),
)
"""Keys of actions with fixed names.

Of two keys with one code, the first with an available action is bound.
"""

_SWITCHES: Mapping[tuple[str, int], str] = {
    ("6", glfw.KEY_6): "wall",
    ("7", glfw.KEY_7): "pulse",
    ("8", glfw.KEY_8): "friction",
    ("Backslash \\", glfw.KEY_BACKSLASH): "",
}
"""Keys of switches: name and code -> preferred parameter.

A key whose parameter is missing from the scene is bound to another switch, as is a key without one.
"""

_PAIRS: Mapping[tuple[tuple[str, int], tuple[str, int]], str] = {
    (("Up", glfw.KEY_UP), ("Down", glfw.KEY_DOWN)): "stiffness",
    (("Period .", glfw.KEY_PERIOD), ("Comma ,", glfw.KEY_COMMA)): "damping",
    (("F9", glfw.KEY_F9), ("F8", glfw.KEY_F8)): "rate",
    (("Quote '", glfw.KEY_APOSTROPHE), ("Semicolon ;", glfw.KEY_SEMICOLON)): "delay",
    (("Home", glfw.KEY_HOME), ("End", glfw.KEY_END)): "",
}
"""Keys that raise and lower a parameter -> preferred parameter, as in `_SWITCHES`."""

_FIXED = {*(key.action for key in _KEYS), *REWIND_ACTIONS}
HAND = "drag the knob"
"""Mouse gesture that pulls the flotor."""

_HANDS = (HAND, "pull (Shift: tilt, Ctrl: twist)"), ("drag elsewhere", "orbit (right: pan, wheel: zoom)")


def _bound(actions: Sequence[str]) -> list[Key]:
    """Return the bound keys in the order of the help."""
    fixed: dict[int, Key] = {}
    for key in _KEYS:
        if key.action in actions or key.action in _ALWAYS:
            fixed.setdefault(key.code, key)
    numbers = [name.removesuffix(" up") for name in actions if name.endswith(" up")]
    switches = [name for name in actions if name not in _FIXED and not name.endswith((" up", " down"))]
    switches = [name for name in switches if not name.startswith(SCENE_PREFIX)]
    # a number gets a switch only if it is the key's preferred parameter, or has no other key
    assigned = _assign(_SWITCHES, switches, numbers).items()
    keys = [Key(code, name, word, "switches") for (name, code), word in assigned]
    free = {pair: word for pair, word in _PAIRS.items() if fixed.keys().isdisjoint(code for _, code in pair)}
    for pair, word in _assign(free, numbers, ()).items():
        keys += [Key(code, name, f"{word} {way}", word, word) for (name, code), way in zip(pair, ("up", "down"))]
    return keys + list(fixed.values())


def _assign(preferred: Mapping[Any, str], names: Sequence[str], excluded: Sequence[str]) -> Mapping[Any, str]:
    """Return a name for each key: the preferred ones first, then the others in order."""
    assigned = {key: name for key, name in preferred.items() if name in names}
    others = [name for name in names if name not in assigned.values() and name not in excluded]
    assigned |= dict(zip([key for key in preferred if key not in assigned], others))
    return {key: assigned[key] for key in preferred if key in assigned}


def keys_of(actions: Sequence[str]) -> Mapping[int, str]:
    """Return the action of each key."""
    return {key.code: key.action for key in _bound(actions)}


def key_of(action: str, actions: Sequence[str]) -> str:
    """Return the name of an action's key; empty for none."""
    return next((key.name for key in _bound(actions) if key.action == action), "")


def help_rows(actions: Sequence[str], *, mouse: bool = True) -> list[tuple[str, str]]:
    """Return the rows of the help: keys and their actions.

    Args:
        actions: Names of the available actions.
        mouse: True if the mouse moves the flotor.
    """
    rows: dict[str, tuple[list[str], list[str]]] = {}
    for key in _bound(actions):
        names, words = rows.setdefault(key.row, ([], []))
        names.append(key.name)
        words += [key.words or key.action] if not key.action.endswith(" down") else []
    return [*(_HANDS if mouse else ()), *(("  ".join(names), ", ".join(words)) for names, words in rows.values())]
