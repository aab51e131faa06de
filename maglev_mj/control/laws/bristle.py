"""Bristle friction models: Dahl, LuGre, elasto-plastic, Hayward-Armstrong.

All four carry a stretch z behind the position x; the anchor of the `FrictionState` is x - z. Their differential
equations in z are driven by the travel dx of a sample, over which the velocity counts as constant.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.control.laws.base import gain
from maglev_mj.control.laws.friction import SLIDING_SHARE, Friction, FrictionState, apply, choose
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Component
from maglev_mj.parameters import number


class _Bristle(Friction):
    """Friction law with the bristle deflection as its state."""

    def stretch(self, z: Component, travel: Component, velocity: Component, gains: Any) -> Component:
        """Return the deflection [m, rad] after a travel [m, rad]."""
        raise NotImplementedError

    def pull(self, before: Component, z: Component, velocity: Component, gains: Any) -> Component:
        """Return the force of the bristle [N, N m]."""
        return -(gains.stiffness * z)

    def limit(self, velocity: Component, gains: Any) -> Component:
        """Return the sliding force at this velocity [N, N m]."""
        return gains.breakaway

    def axis(
        self, position: Component, velocity: Component, state: FrictionState, gains: Any
    ) -> tuple[Component, FrictionState]:
        """Answer one sample of one axis; see `Friction`."""
        last, before = (position, 0.0) if state.memory is None else state.memory
        z = self.stretch(before, position - last, velocity, gains)
        force = self.pull(before, z, velocity, gains)
        sticks = gains.stiffness * abs(z) < SLIDING_SHARE * self.limit(velocity, gains)
        return force, FrictionState(sticks, position - z, (position, z))


class Dahl(_Bristle):
    """Dahl friction model.

    dz = dx (1 - sgn(dx) z / z_c) with z_c = breakaway / stiffness. The equation is solved exactly for each travel.

    Source: Dahl 1968, in the form of Olsson et al. 1998; derived again, not checked against the original.
    """

    def stretch(self, z: Component, travel: Component, velocity: Component, gains: Any) -> Component:
        """Return the stretch after a travel; see `_Bristle`."""
        limit = gains.breakaway / gains.stiffness
        return _relaxed(z, travel, limit)


class LuGre(_Bristle):
    """LuGre friction with Stribeck effect and bristle damping.

    `dz/dt = v - stiffness |v| z / g(v)`, with g falling from breakaway to Coulomb friction; F = s0 z + s1 dz/dt.

    Args:
        period: Sample period [s].
        coulomb: Friction in fast sliding, as a share of `breakaway`, in (0, 1].
        stribeck: Stribeck velocity, of the fall from breakaway to Coulomb friction [m/s, rad/s], above 0.
        bristle_damping: Damping s1 of the bristle [N s/m, N m s/rad].

    Source: Canudas de Wit, Olsson, Astrom & Lischinsky 1995; not checked against the original.
    """

    period: float
    coulomb: float = 0.8
    stribeck: ArrayLike = gain(unit="m/s, rad/s", default=0.01, above=0.0)
    bristle_damping: ArrayLike = gain(unit="N s/m, N m s/rad", default=0.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        number("period", self.period, above=0.0)
        number("coulomb", self.coulomb, above=0.0, at_most=1.0)

    @property
    def stuck_damping(self) -> ArrayLike:
        """Damping of the bristle; see `Friction`."""
        return self.bristle_damping

    def stretch(self, z: Component, travel: Component, velocity: Component, gains: Any) -> Component:
        """Return the stretch after a travel; see `_Bristle`."""
        return _relaxed(z, travel, self.limit(velocity, gains) / gains.stiffness)

    def limit(self, velocity: Component, gains: Any) -> Component:
        """Return the Stribeck curve at this velocity [N, N m]."""
        ratio = velocity / gains.stribeck
        share = self.coulomb + (1.0 - self.coulomb) * apply(np.exp, -(ratio * ratio))
        return share * gains.breakaway

    def pull(self, before: Component, z: Component, velocity: Component, gains: Any) -> Component:
        """Return the bristle force with its damping [N, N m]."""
        return -(gains.stiffness * z + gains.bristle_damping * ((z - before) / self.period))


class ElastoPlastic(_Bristle):
    """Elasto-plastic friction without creep at small loads.

    dz = dx (1 - alpha(z) z / z_ss). Up to a share of the limit the bristle is purely elastic. alpha rises from 0 to 1
    over half a sine between elastic * z_ss and z_ss if z and dx have the same sign; otherwise it is 0.

    Args:
        elastic: Share of the largest stretch up to which the bristle is purely elastic, in (0, 1).

    Source: Dupont, Hayward, Armstrong & Altpeter 2002; not checked against the original.
    """

    elastic: float = 0.7

    def __post_init__(self) -> None:
        super().__post_init__()
        number("elastic", self.elastic, above=0.0, below=1.0)

    def stretch(self, z: Component, travel: Component, velocity: Component, gains: Any) -> Component:
        """Return the stretch after a travel; see `_Bristle`."""
        limit = gains.breakaway / gains.stiffness
        share = abs(z) / limit
        middle = (share - 0.5 * (1.0 + self.elastic)) / (1.0 - self.elastic)
        rising = 0.5 + 0.5 * apply(np.sin, np.pi * choose(middle < -0.5, -0.5, choose(middle > 0.5, 0.5, middle)))
        alpha = choose(z * travel > 0.0, rising, 0.0)
        moved = z + travel * (1.0 - alpha * share)
        return choose(moved > limit, limit, choose(moved < -limit, -limit, moved))


class HaywardArmstrong(_Bristle):
    """Displacement-based friction without drift.

    The anchor follows by `alpha(z) |dx| z` and stays within z_max of the flotor.

    alpha(z) = 1/z_max z^8 / (z_stick^8 + z^8): almost 0 while stuck, so small load cycles do not creep.

    Args:
        stick: z_stick as a share of z_max, in (0, 1).

    Source: Hayward & Armstrong 2000; not checked against the original.
    """

    stick: float = 0.7

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 < number("stick", self.stick) < 1.0:
            raise ParameterError(f"stick must be above 0 and below 1, not {self.stick:g}")

    def stretch(self, z: Component, travel: Component, velocity: Component, gains: Any) -> Component:
        """Return the stretch after a travel; see `_Bristle`."""
        limit = gains.breakaway / gains.stiffness
        moved = z + travel
        square = moved * moved / (limit * limit)
        fourth = square * square
        eighth = fourth * fourth
        alpha = eighth / (self.stick**8 + eighth) / limit
        followed = moved / (1.0 + alpha * abs(travel))  # implicit: never past the flotor, however long the travel
        return choose(followed > limit, limit, choose(followed < -limit, -limit, followed))


def _relaxed(z: Component, travel: Component, limit: Component) -> Component:
    """Return the deflection after one travel.

    Solves dz = dx - |dx| z / limit. The solution tends to the limit in the direction of travel.
    """
    end = choose(travel > 0.0, limit, -limit)
    return end + (z - end) * apply(np.exp, -abs(travel) / limit)
