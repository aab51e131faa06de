"""The words on the screen: scene, gains, rate and delay, what it costs, where the energy went, and the keys."""

from __future__ import annotations

import math
from collections.abc import Mapping

import glfw

from maglev_mj.session import Snapshot
from maglev_mj.viewer.scenery import ARROW

__all__ = ["KEYS", "SCREENSHOT", "help_text", "status_text"]

SCREENSHOT = "screenshot"

_NOTHING = 5e-5

KEYS: Mapping[int, str] = {
    glfw.KEY_ENTER: "next scene",
    glfw.KEY_6: "wall",
    glfw.KEY_7: "pulse",
    glfw.KEY_8: "friction",
    glfw.KEY_9: "drop",
    glfw.KEY_SLASH: "centre",
    glfw.KEY_UP: "stiffness up",
    glfw.KEY_DOWN: "stiffness down",
    glfw.KEY_PERIOD: "damping up",
    glfw.KEY_COMMA: "damping down",
    glfw.KEY_F9: "rate up",
    glfw.KEY_F8: "rate down",
    glfw.KEY_APOSTROPHE: "delay up",
    glfw.KEY_SEMICOLON: "delay down",
    glfw.KEY_SPACE: "pause",
    glfw.KEY_F10: "record",
    glfw.KEY_F12: SCREENSHOT,
}
"""What each key does; the engine's viewer has letters, 0 to 5, F1 to F7, Tab, [ ], - =, Page Up, left and right."""

_HELP = (
    ("Ctrl + right drag", "push (Shift: level)"),
    ("Ctrl + left drag", "twist"),
    ("Enter", "next scene"),
    ("6   7   8", "wall, pulse, friction"),
    ("Up  Down", "stiffness"),
    (".   ,", "damping"),
    ("F9  F8", "rate"),
    ("'   ;", "delay"),
    ("9   /", "drop, centre"),
    ("Space", "pause"),
    ("F10  F12", "record, screenshot"),
)


def help_text() -> tuple[str, str]:
    """Return the keys and what they do, a column each."""
    keys, does = zip(*_HELP, strict=True)
    return "\n".join(keys), "\n".join(does)


def status_text(snapshot: Snapshot, notes: tuple[str, ...] = ()) -> tuple[str, str]:
    """Return what a person wants to know of a session, names and values a column each.

    Args:
        snapshot: The picture of now.
        notes: Further notes, such as the last screenshot.
    """
    settings = snapshot.settings
    on = [name for name in ("wall", "pulse", "friction") if getattr(settings, name)]
    made = snapshot.taken < -_NOTHING
    taken = f"world {'MADE' if made else 'took'} {(-snapshot.taken if made else snapshot.taken) * 1e3:.1f} mJ"
    if math.isnan(snapshot.taken):  # a recording does not say
        taken = "world not known"
    rows = [
        ("scene", f"{snapshot.scene.name}: {snapshot.scene.says}"),
        ("on", ", ".join(on) or "nothing"),
        ("gains", f"{settings.stiffness:.0f} N/m  {settings.damping:.3g} N s/m"),
        ("rate", f"{1.0 / settings.period:.0f} Hz, delay {settings.delay * 1e3:.1f} ms"),
        ("tick", f"{snapshot.cost * 1e6:.0f} us, {snapshot.missed} missed, {snapshot.time:.1f} s"),
        ("energy", f"hand gave {snapshot.work * 1e3:.1f} mJ, {taken}"),
        ("arrows", f"green hand, red device, 5 N = {5e3 * ARROW:.0f} mm"),
        *(("", note) for note in (*snapshot.notes, *notes)),
    ]
    names, values = zip(*rows, strict=True)
    return "\n".join(names), "\n".join(values)
