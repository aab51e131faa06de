"""Names of built-in and installed scenes, without loading them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from importlib.metadata import EntryPoints

GROUP = "maglev_mj.scenes"
"""Entry point group of scenes in other packages."""

BUILT_IN: Mapping[str, str] = {
    "joystick": "maglev_mj.scenes.interactive:Joystick",
    "drop": "maglev_mj.scenes.drop:Drop",
    "press": "maglev_mj.scenes.press:Press",
    "table": "maglev_mj.scenes.interactive:TableTop",
    "box": "maglev_mj.scenes.interactive:Box",
    "corner": "maglev_mj.scenes.interactive:Corner",
    "stick-slip": "maglev_mj.scenes.stick_slip:Pull",
    "twist": "maglev_mj.scenes.free:Twist",
    "let-go": "maglev_mj.scenes.free:LetGo",
    "six-axes": "maglev_mj.scenes.free:SixAxes",
    "wall": "maglev_mj.studies.stability_map:RestingWall",
}
"""Built-in scenes: name -> module and class, in the order of the viewer's key."""


def installed_scenes() -> EntryPoints:
    """Return the entry points of other packages' scenes."""
    from importlib.metadata import entry_points  # slow to load

    return entry_points(group=GROUP)


def scene_names() -> list[str]:
    """Return all scene names, built-in ones first."""
    return [*BUILT_IN, *sorted(set(installed_scenes().names) - set(BUILT_IN))]
