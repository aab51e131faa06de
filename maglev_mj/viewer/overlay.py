"""The words on the screen: scene, gains, rate and delay, what it costs, where the energy went, and the keys."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import glfw

from maglev_mj.display.banner import banner
from maglev_mj.parameters import Parameter
from maglev_mj.scenes import Scene
from maglev_mj.session import DEVICES_OWN, EMERGENCY_STOP, Snapshot, actions
from maglev_mj.viewer.scenery import ARROW

__all__ = ["SCREENSHOT", "help_text", "keys_of", "status_text"]

SCREENSHOT = "screenshot"

_NOTHING = 5e-5

_OWN: Mapping[int, str] = {
    glfw.KEY_ESCAPE: EMERGENCY_STOP,
    glfw.KEY_ENTER: "next scene",
    glfw.KEY_9: "drop",
    glfw.KEY_SLASH: "centre",
    glfw.KEY_SPACE: "pause",
    glfw.KEY_F10: "record",
    glfw.KEY_F12: SCREENSHOT,
}
"""Keys that every scene has; the engine's viewer has letters, 0 to 5, F1 to F7, Tab, [ ], - =, Page Up, left, right.

Its Escape only frees a camera, which is free here.
"""

_SWITCHES: Mapping[str, tuple[int, str]] = {
    "6": (glfw.KEY_6, "wall"),
    "7": (glfw.KEY_7, "pulse"),
    "8": (glfw.KEY_8, "friction"),
    "\\": (glfw.KEY_BACKSLASH, ""),
    "F11": (glfw.KEY_F11, ""),
}
"""Keys that switch: name -> key, and whose it is where a scene has that; the others are for what is left."""

_PAIRS: Mapping[str, tuple[int, int, str]] = {
    "Up  Down": (glfw.KEY_UP, glfw.KEY_DOWN, "stiffness"),
    ".   ,": (glfw.KEY_PERIOD, glfw.KEY_COMMA, "damping"),
    "F9  F8": (glfw.KEY_F9, glfw.KEY_F8, "rate"),
    "'   ;": (glfw.KEY_APOSTROPHE, glfw.KEY_SEMICOLON, "delay"),
    "Home  End": (glfw.KEY_HOME, glfw.KEY_END, ""),
    "Ins  Del": (glfw.KEY_INSERT, glfw.KEY_DELETE, ""),
}
"""Keys up and down, likewise."""


def _assigned(cls: type[Scene]) -> tuple[Mapping[str, str], Mapping[str, str]]:
    """Return the switches and the numbers of a scene by their keys' names; what there is no key for is left out."""
    known = actions(cls)
    numbers = [name.removesuffix(" up") for name in known if name.endswith(" up")]
    switches = [name for name in known if not name.endswith((" up", " down"))]
    # a number is switched where its key is free for it, or it has no other
    return (
        _shared_out({key: owner for key, (_, owner) in _SWITCHES.items()}, switches, numbers),
        _shared_out({key: owner for key, (_, _, owner) in _PAIRS.items()}, numbers, ()),
    )


def _shared_out(owners: Mapping[str, str], names: Sequence[str], others: Sequence[str]) -> Mapping[str, str]:
    """Return a name for each key: its owner's, then the others in order, but for some that have keys already."""
    found = {key: owner for key, owner in owners.items() if owner in names}
    left = [name for name in names if name not in found.values() and name not in others]
    found |= dict(zip([key for key in owners if key not in found], left))
    return {key: found[key] for key in owners if key in found}


def keys_of(cls: type[Scene]) -> Mapping[int, str]:
    """Return what each key does to a scene of a class."""
    switches, pairs = _assigned(cls)
    found = dict(_OWN) | {_SWITCHES[key][0]: name for key, name in switches.items()}
    for key, name in pairs.items():
        up, down, _ = _PAIRS[key]
        found |= {up: f"{name} up", down: f"{name} down"}
    return found


def help_text(cls: type[Scene]) -> tuple[str, str]:
    """Return the keys of a scene of a class and what they do, a column each."""
    switches, pairs = _assigned(cls)
    rows = [
        ("Ctrl + right drag", "push (Shift: level)"),
        ("Ctrl + left drag", "twist"),
        ("Enter", "next scene"),
        ("   ".join(switches), ", ".join(switches.values())),
        *pairs.items(),
        ("9   /", "drop, centre"),
        ("Space", "pause"),
        ("F10  F12", "record, screenshot"),
        ("ESC", EMERGENCY_STOP),
    ]
    keys, does = zip(*[row for row in rows if row[0]], strict=True)
    return "\n".join(keys), "\n".join(does)


def status_text(snapshot: Snapshot, notes: tuple[str, ...] = ()) -> tuple[str, str]:
    """Return what a person wants to know of a session, names and values a column each.

    Args:
        snapshot: The picture of now.
        notes: Further notes, such as the last screenshot.
    """
    scene = snapshot.scene
    live = [one for one in scene.parameters() if one.live and one.live.has_keys and one.name not in DEVICES_OWN]
    on = [one.name for one in live if one.kind is bool and getattr(scene, one.name)]
    gains = [_shown(one, getattr(scene, one.name)) for one in live if one.kind in (float, int)]
    made = snapshot.taken < -_NOTHING
    taken = f"world {'MADE' if made else 'took'} {(-snapshot.taken if made else snapshot.taken) * 1e3:.1f} mJ"
    if math.isnan(snapshot.taken):  # a recording does not say
        taken = "world not known"
    said = banner(snapshot)
    rows = [
        ("scene", f"{scene.name}: {scene.describe()}"),
        ("on", ", ".join(on) or "nothing"),
        ("gains", "  ".join(gains) or "none"),
        ("rate", f"{1.0 / scene.period:.0f} Hz, delay {scene.delay * 1e3:.1f} ms"),
        ("tick", f"{snapshot.cost * 1e6:.0f} us, {snapshot.missed} missed, {snapshot.time:.1f} s"),
        ("energy", f"hand gave {snapshot.work * 1e3:.1f} mJ, {taken}"),
        ("arrows", f"green hand, red device, 5 N = {5e3 * ARROW:.0f} mm"),
        *(("", note) for note in (said.text if said else "", *snapshot.notes, *notes) if note),
    ]
    names, values = zip(*rows, strict=True)
    return "\n".join(names), "\n".join(values)


def _shown(one: Parameter, value: float | None) -> str:
    """Return a gain; one that is not of a wall goes by its name."""
    if value is None:
        return f"{one.name} none"
    number = f"{value:.0f}" if abs(value) >= 1e3 else f"{value:.3g}"
    return f"{number} {one.unit}" if one.name in ("stiffness", "damping") else f"{one.name} {number} {one.unit}".strip()
