"""The flotor let go above a stiff wall: figure 3 of Salcudean and Vlaar (1997)."""

from maglev_mj.frames import AXES
from maglev_mj.hand import Path
from maglev_mj.laws import Law
from maglev_mj.scenes.interactive import Scene
from maglev_mj.scenes.parts import hold, wall, weight
from maglev_mj.scenes.settings import Settings
from maglev_mj.spec import Spec

__all__ = ["DROP", "PRESS"]

_OTHERS = tuple(axis for axis in AXES if axis != "z")
_HEIGHT = Spec.translation_range.value


def _floor(settings: Settings) -> list[Law]:
    laws: list[Law] = [*weight(settings), hold(settings, _OTHERS)]
    return [*laws, wall(settings, "z", lower=0.0)] if settings.wall else laws


DROP = Scene(
    name="drop",
    says="let go above a stiff wall (figure 3)",
    make=_floor,
    settings=Settings(weightless=False),
    pose=(0.0, 0.0, _HEIGHT, 0.0, 0.0, 0.0),
)

_UP, _DOWN, _PRESSED = ((0.0, 0.0, height, 0.0, 0.0, 0.0) for height in (0.003, -0.018, -0.025))

PRESS = Scene(
    name="press",
    says="hit the wall several times, then press (figure 6)",
    make=_floor,
    pose=(0.0, 0.0, 0.003, 0.0, 0.0, 0.0),
    script=Path(
        [0.2, 0.35, 0.55, 0.7, 0.9, 1.05, 1.25, 1.5, 2.5],
        [_UP, _DOWN, _UP, _DOWN, _UP, _DOWN, _UP, _PRESSED, _PRESSED],
    ),
)
