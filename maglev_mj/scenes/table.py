"""A block on a table: stick-slip friction in the plane, figures 8 and 9 of Salcudean and Vlaar (1997)."""

from maglev_mj.frames import AXES
from maglev_mj.hand import Path
from maglev_mj.laws import Law
from maglev_mj.scenes.interactive import Scene
from maglev_mj.scenes.parts import friction, hold, weight
from maglev_mj.scenes.settings import Settings

__all__ = ["TABLE"]


def _laws(settings: Settings) -> list[Law]:
    laws: list[Law] = [*weight(settings), hold(settings, AXES[2:])]
    if settings.friction:
        laws.append(friction(settings, ("x", "y"), coupled=True))
    return laws


TABLE = Scene(
    name="table",
    says="a block with dry friction on a table (figures 8 and 9)",
    make=_laws,
    settings=Settings(wall=False, friction=True),
    axis="x",
    script=Path(
        [0.2, 1.2, 1.5, 2.5, 2.8, 4.0],
        [[x * 1e-3, y * 1e-3, 0.0, 0.0, 0.0, 0.0] for x, y in ((0, 0), (13, 4), (13, 4), (-8, -13), (-8, -13), (0, 0))],
    ),
)
