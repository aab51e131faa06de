"""Rooms to feel: a joystick between stops, a table, a box, a corner."""

import math
from typing import ClassVar

import numpy as np

from maglev_mj.control import Law
from maglev_mj.frames import AXES
from maglev_mj.parameters import param
from maglev_mj.plants.hand import Trajectory
from maglev_mj.scenes.bench import hold
from maglev_mj.scenes.interactive import InteractiveScene, contacts, friction, spring, weight

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
