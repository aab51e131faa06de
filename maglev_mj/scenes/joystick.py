"""Scene: joystick with soft centring in a box of walls.

All six axes are centred; stick-slip friction is switched on by a key.
"""

import math
from typing import ClassVar

from maglev_mj.frames import AXES
from maglev_mj.hand import Trajectory
from maglev_mj.laws import Law
from maglev_mj.scenes.interactive import InteractiveScene
from maglev_mj.scenes.parts import contacts, spring, weight

CENTRING = 300.0
"""Stiffness of the spring to the centre [N/m]."""

_DAMPING = 12.0
_EDGES = (0.0035,) * 3 + (math.radians(4.5),) * 3


class Joystick(InteractiveScene):
    """A joystick in a box of walls."""

    says: ClassVar = "soft centring on six axes in a box of walls; friction on a key"
    model: ClassVar = "scenes/joystick"
    shown_axis: ClassVar = "x"
    script: ClassVar = Trajectory(
        [0.3, 0.8, 1.0, 1.6, 2.1, 2.6, 3.2, 3.8, 4.2],
        [
            [x * 1e-3, y * 1e-3, z * 1e-3, tilt, nod, spin]
            for x, y, z, tilt, nod, spin in (
                (0, 0, 0, 0, 0, 0),
                (16, 0, 0, 0, 0.15, 0),
                (16, 0, 0, 0, 0.15, 0),
                (0, 16, 0, -0.15, 0, 0),
                (-16, 0, 0, 0, -0.15, 0),
                (0, -16, 6, 0.15, 0, 0.2),
                (0, 0, -18, 0, 0, -0.2),
                (0, 0, 0, 0, 0, 0),
                (0, 0, 0, 0, 0, 0),
            )
        ],
    )

    def own_laws(self) -> list[Law]:
        """See `InteractiveScene`."""
        soft = spring(AXES, stiffness=CENTRING, damping=_DAMPING)
        return [*weight(self), soft, *contacts(self, AXES, lower=[-edge for edge in _EDGES], upper=_EDGES)]
