"""Scene: flotor floating in a box of stiff walls."""

import math
from typing import ClassVar

from maglev_mj.frames import AXES
from maglev_mj.hand import Trajectory
from maglev_mj.laws import Law
from maglev_mj.scenes.interactive import InteractiveScene
from maglev_mj.scenes.parts import contacts, spring, weight

_AIR = 1.0

BOX_WALLS = (0.003,) * 3 + (math.radians(4.0),) * 3
"""Distance of each wall from the centre [m, rad]."""


class Box(InteractiveScene):
    """A box of stiff walls on all six axes."""

    says: ClassVar = "a box of walls on all six axes"
    model: ClassVar = "scenes/box"
    shown_axis: ClassVar = "x"
    script: ClassVar = Trajectory(
        [0.2, 0.5, 0.9, 1.4, 1.9, 2.4, 3.0],
        [
            [x * 1e-3, y * 1e-3, z * 1e-3, 0.0, turn, 0.0]
            for x, y, z, turn in (
                (0, 0, 0, 0),
                (14, 0, 0, 0.2),
                (14, 10, -10, 0),
                (-14, 10, -10, -0.2),
                (-14, -12, 8, 0),
                (6, -12, 8, 0.1),
                (0, 0, 0, 0),
            )
        ],
    )

    def own_laws(self) -> list[Law]:
        """See `InteractiveScene`."""
        # slight damping, as by air: the flotor comes to rest within a minute
        soft = spring(AXES, stiffness=0.0, damping=_AIR)
        return [*weight(self), soft, *contacts(self, AXES, lower=[-edge for edge in BOX_WALLS], upper=BOX_WALLS)]
