"""Scenes to feel, one a module, each with its MJCF file in `model/scenes`."""

from collections.abc import Mapping

from maglev_mj.errors import ParameterError
from maglev_mj.scenes.box import BOX
from maglev_mj.scenes.corner import CORNER
from maglev_mj.scenes.floor import DROP, PRESS
from maglev_mj.scenes.interactive import Scene
from maglev_mj.scenes.joystick import JOYSTICK
from maglev_mj.scenes.settings import Settings
from maglev_mj.scenes.table import TABLE

__all__ = ["SCENES", "Scene", "Settings", "scene_called"]

SCENES: Mapping[str, Scene] = {scene.name: scene for scene in (JOYSTICK, DROP, PRESS, TABLE, BOX, CORNER)}
"""All scenes by name, in the order in which a key goes through them."""


def scene_called(name: str) -> Scene:
    """Return a scene by name.

    Raises:
        ParameterError: If there is none of that name.
    """
    if name not in SCENES:
        raise ParameterError(f"scene must be one of {', '.join(SCENES)}, not {name!r}")
    return SCENES[name]
