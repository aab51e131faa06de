"""Scene: corner of two walls and a rotation stop.

It has three contacts at once, on coupled axes of the device.
"""

from typing import ClassVar

import numpy as np

from maglev_mj.frames import AXES
from maglev_mj.hand import Trajectory
from maglev_mj.laws import Law
from maglev_mj.scenes.interactive import InteractiveScene
from maglev_mj.scenes.parts import contacts, spring, weight

_INTO = ("x", "z", "ry")


class Corner(InteractiveScene):
    """A corner of two walls and a rotation stop."""

    says: ClassVar = "drawn into a corner of two walls, and a stop for a rotation"
    model: ClassVar = "scenes/corner"
    pose: ClassVar = (0.003, 0.0, 0.003, 0.0, 0.04, 0.0)
    script: ClassVar = Trajectory(
        [0.8, 1.2, 1.6, 2.4, 3.0],
        [
            [x * 1e-3, 0.0, z * 1e-3, 0.0, turn, 0.0]
            for x, z, turn in ((0, 0, 0), (6, 6, 0.1), (-10, 4, 0), (-10, -10, -0.1), (-6, -6, 0))
        ],
    )

    def own_laws(self) -> list[Law]:
        """See `InteractiveScene`."""
        # a press of 0.4 N at the walls, and as much acceleration at the stop
        target = np.isin(AXES, _INTO) * -2e-3
        soft = spring(AXES, stiffness=200.0, damping=4.0, target=target)
        return [*weight(self), soft, *contacts(self, _INTO, lower=0.0)]
