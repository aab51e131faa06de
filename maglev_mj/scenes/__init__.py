"""Scenes: parameters, laws, start, hand and figures of what happens to the flotor."""

from maglev_mj.scenes.find import BUILT_IN, find_scene, scene_names
from maglev_mj.scenes.scene import Scene, Start

__all__ = ["BUILT_IN", "Scene", "Start", "find_scene", "scene_names"]
