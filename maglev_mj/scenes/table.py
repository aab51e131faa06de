"""Scene: block on a table with stick-slip friction.

Figures 8 and 9 of Salcudean and Vlaar (1997).
"""

from typing import ClassVar

from maglev_mj.frames import AXES
from maglev_mj.hand import Trajectory
from maglev_mj.laws import Law
from maglev_mj.parameters import param
from maglev_mj.scenes.interactive import InteractiveScene
from maglev_mj.scenes.parts import friction, hold, weight


class Table(InteractiveScene):
    """A block with friction on a table (figures 8, 9)."""

    says: ClassVar = "a block with dry friction on a table (figures 8 and 9)"
    model: ClassVar = "scenes/table"
    shown_axis: ClassVar = "x"
    script: ClassVar = Trajectory(
        [0.2, 1.2, 1.5, 2.5, 2.8, 4.0],
        [[x * 1e-3, y * 1e-3, 0.0, 0.0, 0.0, 0.0] for x, y in ((0, 0), (13, 4), (13, 4), (-8, -13), (-8, -13), (0, 0))],
    )

    wall: bool = param("walls", default=False, live=True)
    friction: bool = param("stick-slip friction", default=True, live=True)

    def own_laws(self) -> list[Law]:
        """See `InteractiveScene`."""
        laws: list[Law] = [*weight(self), hold(self, AXES[2:])]
        if self.friction:
            laws.append(friction(self, ("x", "y"), coupled=True))
        return laws
