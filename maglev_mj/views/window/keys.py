"""Keys of the window for the actions available."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple, TypeVar

import glfw

from maglev_mj.session import CHOOSES, EMERGENCY_STOP, REWINDS

SCREENSHOT, AXIS, CAMERA, KEYS, MAGNIFY = "screenshot", "axis of the plots", "camera", "keys", "magnify motion"
"""Actions of every window."""


class Key(NamedTuple):
    """Key of the window.

    Attributes:
        code: Key code of the engine's viewer.
        name: Name in the help.
        action: Name of its action.
        row: Row of the help; keys of one row share it.
        words: Description of the action in the help; its name by default.
    """

    code: int
    name: str
    action: str
    row: str
    words: str = ""


_KEYS = (
    Key(glfw.KEY_F11, "F11", KEYS, "keys", "show, hide keys"),
    Key(glfw.KEY_ENTER, "Enter", "next", "tour", "next step"),
    Key(glfw.KEY_9, "9", "back", "tour", "step before"),
    Key(glfw.KEY_ENTER, "Enter", "next scene", "place"),
    Key(glfw.KEY_9, "9", "drop", "place"),
    Key(glfw.KEY_9, "9", "loop", "place", "play over and over"),
    Key(glfw.KEY_SLASH, "/", "centre", "place"),
    Key(glfw.KEY_SPACE, "Space", "pause", "pause", "pause"),
    Key(glfw.KEY_LEFT, "Left", "step back", "pause"),
    Key(glfw.KEY_LEFT, "Left", "rewind", "pause", "rewind 1 s"),
    Key(glfw.KEY_RIGHT, "Right", "step", "pause", "one step"),
    Key(glfw.KEY_DELETE, "Delete", "same hand again", "again"),
    Key(glfw.KEY_MINUS, "-", "slower", "speed"),
    Key(glfw.KEY_EQUAL, "=", "faster", "speed"),
    Key(glfw.KEY_DOWN, "Down", "skip back", "skip"),
    Key(glfw.KEY_UP, "Up", "skip forward", "skip"),
    Key(glfw.KEY_HOME, "Home", "start", "ends"),
    Key(glfw.KEY_END, "End", "end", "ends"),
    Key(glfw.KEY_F10, "F10", "record", "files"),
    Key(glfw.KEY_F12, "F12", SCREENSHOT, "files"),
    Key(glfw.KEY_GRAVE_ACCENT, "Backquote `", AXIS, "view"),
    Key(glfw.KEY_PAGE_DOWN, "Page Down", CAMERA, "camera", "camera back"),
    Key(glfw.KEY_INSERT, "Insert", MAGNIFY, "magnify", "magnify motion x1, x3, x5"),
    Key(glfw.KEY_ESCAPE, "Esc", EMERGENCY_STOP, "stop"),
)
"""Keys of actions with fixed names.

Of two keys with one code, the first with an available action counts.

The engine's viewer uses letters, 0 to 5, F1 to F7, Tab, brackets, Page Up and Backspace. Its left, right, - and = have
no effect in a window on a program's own simulation, and its Escape only frees the camera, which is free here.
"""

_ALWAYS = SCREENSHOT, AXIS, CAMERA, KEYS, MAGNIFY

_SWITCHES: Mapping[str, tuple[int, str]] = {
    "6": (glfw.KEY_6, "wall"),
    "7": (glfw.KEY_7, "pulse"),
    "8": (glfw.KEY_8, "friction"),
    "Backslash \\": (glfw.KEY_BACKSLASH, ""),
}
"""Keys of switches: name -> key and owner.

The owner is the parameter that has the key if the scene has it; keys without an owner are for other switches.
"""

_PAIRS: Mapping[tuple[str, str], tuple[int, int, str]] = {
    ("Up", "Down"): (glfw.KEY_UP, glfw.KEY_DOWN, "stiffness"),
    ("Period .", "Comma ,"): (glfw.KEY_PERIOD, glfw.KEY_COMMA, "damping"),
    ("F9", "F8"): (glfw.KEY_F9, glfw.KEY_F8, "rate"),
    ("Quote '", "Semicolon ;"): (glfw.KEY_APOSTROPHE, glfw.KEY_SEMICOLON, "delay"),
    ("Home", "End"): (glfw.KEY_HOME, glfw.KEY_END, ""),
}
"""Keys up and down: names -> keys and owner.

See `_SWITCHES`.
"""

_Name = TypeVar("_Name")
_NAMED = {*(key.action for key in _KEYS), *REWINDS}
HAND = "drag the knob"
"""Mouse action that pulls the flotor."""

_HANDS = ((HAND, "pull; elsewhere: turn"), ("Ctrl + right drag", "pull (Shift: level)"), ("Ctrl + left drag", "twist"))


def _there(actions: Sequence[str]) -> list[Key]:
    """Return the keys of actions, in help order."""
    own: dict[int, Key] = {}
    for key in _KEYS:
        if key.action in actions or key.action in _ALWAYS:
            own.setdefault(key.code, key)
    numbers = [name.removesuffix(" up") for name in actions if name.endswith(" up")]
    switches = [name for name in actions if name not in _NAMED and not name.endswith((" up", " down"))]
    switches = [name for name in switches if not name.startswith(CHOOSES)]
    free = {name: found for name, found in _PAIRS.items() if not own.keys() & {*found[:2]}}
    switched = {name: owner for name, (_, owner) in _SWITCHES.items()}
    paired = {names: owner for names, (*_, owner) in free.items()}
    # a number gets a switch only if that key is its own, or it has no other key
    shared = _shared_out(switched, switches, numbers).items()
    found = [Key(_SWITCHES[name][0], name, word, "switches") for name, word in shared]
    for (up, down), word in _shared_out(paired, numbers, ()).items():
        one, other, _ = free[up, down]
        found += [Key(one, up, f"{word} up", word, word), Key(other, down, f"{word} down", word, "")]
    return found + list(own.values())


def _shared_out(owners: Mapping[_Name, str], names: Sequence[str], others: Sequence[str]) -> Mapping[_Name, str]:
    """Return a name for each key, owners first.

    The other names follow in order, without those in `others`.
    """
    found = {key: owner for key, owner in owners.items() if owner in names}
    left = [name for name in names if name not in found.values() and name not in others]
    found |= dict(zip([key for key in owners if key not in found], left))
    return {key: found[key] for key in owners if key in found}


def keys_of(actions: Sequence[str]) -> Mapping[int, str]:
    """Return the action of each key."""
    return {key.code: key.action for key in _there(actions)}


def key_of(action: str, actions: Sequence[str]) -> str:
    """Return the name of an action's key, or ""."""
    return next((key.name for key in _there(actions) if key.action == action), "")


def help_rows(actions: Sequence[str], *, hand: bool = True) -> list[tuple[str, str]]:
    """Return the rows of the help: keys and actions.

    Args:
        actions: Names of the available actions.
        hand: True if the mouse moves the flotor.
    """
    rows: dict[str, tuple[list[str], list[str]]] = {}
    for key in _there(actions):
        names, words = rows.setdefault(key.row, ([], []))
        names.append(key.name)
        words += [key.words or key.action] if not key.action.endswith(" down") else []
    return [*(_HANDS if hand else ()), *(("  ".join(names), ", ".join(words)) for names, words in rows.values())]
