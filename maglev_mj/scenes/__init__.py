"""Scenes: simulated experiments with laws, start, hand and figures."""

from typing import TYPE_CHECKING

from maglev_mj.lazy import attach

if TYPE_CHECKING:
    from maglev_mj.scenes.find import find_scene as find_scene
    from maglev_mj.scenes.names import BUILT_IN as BUILT_IN
    from maglev_mj.scenes.names import scene_names as scene_names
    from maglev_mj.scenes.scene import Scene as Scene
    from maglev_mj.scenes.scene import Start as Start
else:
    _HOMES = {
        "find": "find_scene",
        "names": "BUILT_IN scene_names",
        "scene": "Scene Start",
    }
    __getattr__, __dir__, __all__ = attach(__name__, _HOMES)
