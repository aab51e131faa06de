"""Scenes of old recordings: former versions of drop and press."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from maglev_mj.errors import ParameterError, not_one_of
from maglev_mj.frames import AXES
from maglev_mj.laws import Law
from maglev_mj.parameters import param
from maglev_mj.scenes.bench import hold
from maglev_mj.scenes.find import find_scene
from maglev_mj.scenes.interactive import InteractiveScene
from maglev_mj.scenes.names import BUILT_IN
from maglev_mj.scenes.parts import wall, weight
from maglev_mj.scenes.scene import Scene
from maglev_mj.spec import Spec

_OTHERS = tuple(axis for axis in AXES if axis != "z")


class OldPress(InteractiveScene):
    """A wall below the flotor, with or without gravity."""

    name: ClassVar = "press"
    model: ClassVar = "scenes/press"
    pose: ClassVar = (0.0, 0.0, 0.003, 0.0, 0.0, 0.0)
    says: ClassVar = "hit the wall several times, then press (figure 6)"

    def own_laws(self) -> list[Law]:
        """See `InteractiveScene`."""
        laws: list[Law] = [*weight(self), hold(self, _OTHERS)]
        return [*laws, wall(self, "z", lower=0.0)] if self.wall else laws


class OldDrop(OldPress):
    """The same wall, with a drop from a height."""

    name: ClassVar = "drop"
    model: ClassVar = "scenes/drop"
    pose: ClassVar = (0.0, 0.0, Spec.translation_range.value, 0.0, 0.0, 0.0)
    says: ClassVar = "let go above a stiff wall (figure 3)"

    weightless: bool = param("currents that carry the flotor's weight", default=False)


_OLD: Mapping[str, type[Scene]] = {"drop": OldDrop, "press": OldPress}


def parameters_in(setup: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the scene parameters of a recording's setup.

    Raises:
        ParameterError: If there are no parameters.
    """
    found = setup.get("settings", setup.get("parameters"))
    if not isinstance(found, dict):
        raise ParameterError("a setup must have parameters")
    return found


def recorded_scene(name: str, values: Mapping[str, Any], scene: type[Scene] | None = None) -> Scene:
    """Return the scene named by a recording or another program.

    Code of others is never run.

    Args:
        name: Its name.
        values: Its parameters.
        scene: Its class if it is not of this package.

    Raises:
        ParameterError: If there is no such scene here, or a value is outside its bounds.
    """
    known = isinstance(name, str)  # of a file it may be anything
    if known and name in _OLD and "wall" in values:
        return _OLD[name].from_json(values)
    if known and name in BUILT_IN:
        return find_scene(name).from_json(values)
    if scene is None:
        raise ParameterError(not_one_of("scene", BUILT_IN, name))
    return scene.from_json(values)
