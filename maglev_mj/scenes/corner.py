"""A corner of two walls and a stop for a rotation: three contacts at once, on axes that the device couples."""

import numpy as np

from maglev_mj.frames import AXES
from maglev_mj.hand import Path
from maglev_mj.laws import Law
from maglev_mj.scenes.interactive import Scene
from maglev_mj.scenes.parts import friction, shared, spring, wall, weight
from maglev_mj.scenes.settings import Settings

__all__ = ["CORNER"]

_INTO = ("x", "z", "ry")


def _laws(settings: Settings) -> list[Law]:
    # a press of 0.4 N at the walls, and as much acceleration at the stop
    target = np.isin(AXES, _INTO) * -2e-3
    laws: list[Law] = [*weight(settings), spring(AXES, stiffness=200.0, damping=4.0, target=target)]
    gains = shared(settings)
    if settings.wall:
        laws.append(wall(gains, _INTO, lower=0.0))
    if settings.friction:
        laws.append(friction(gains))
    return laws


CORNER = Scene(
    name="corner",
    says="drawn into a corner of two walls, and a stop for a rotation",
    make=_laws,
    pose=(0.003, 0.0, 0.003, 0.0, 0.04, 0.0),
    script=Path(
        [0.8, 1.2, 1.6, 2.4, 3.0],
        [
            [x * 1e-3, 0.0, z * 1e-3, 0.0, turn, 0.0]
            for x, z, turn in ((0, 0, 0), (6, 6, 0.1), (-10, 4, 0), (-10, -10, -0.1), (-6, -6, 0))
        ],
    ),
)
