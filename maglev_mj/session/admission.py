"""Whether a scene may be had: the closed loop of every axis, in and out of contact, at the present rate and delay."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from maglev_mj.frames import AXES, Array
from maglev_mj.laws import Friction, Hold, Law, Wall
from maglev_mj.parameters import axis_indices
from maglev_mj.scenes import Scene
from maglev_mj.scenes.parts import INERTIA
from maglev_mj.theory import largest_modulus, largest_stable_stiffness

__all__ = ["Refusal", "refusal"]

_ROUNDING = 1e-9


class Refusal(NamedTuple):
    """Why settings may not be had: the worst loop that they make.

    Attributes:
        axis: Name of its axis.
        acting: What acts there: "walls", "friction", both, or "nothing but the scene".
        stiffness: Of all that acts together [N/m, N m/rad].
        damping: Likewise [N s/m, N m s/rad].
        modulus: Largest modulus of the loop's eigenvalues; from 1 on it is unstable.
        largest_stable: Stiffness up to which it would be stable at that damping [N/m, N m/rad]; 0 for none.
        period: Sample period [s].
        delay: From a sample to its command taking effect [s].
    """

    axis: str
    acting: str
    stiffness: float
    damping: float
    modulus: float
    largest_stable: float
    period: float
    delay: float

    def __str__(self) -> str:
        unit, rate = ("N/m", "N s/m") if self.axis in AXES[:3] else ("N m/rad", "N m s/rad"), 1.0 / self.period
        bound = (
            f"stable up to {self.largest_stable:.4g} {unit[0]}" if self.largest_stable else "unstable at any stiffness"
        )
        return (
            f"{self.acting} on {self.axis}: {self.stiffness:.4g} {unit[0]} and {self.damping:.4g} {unit[1]} in all, at "
            f"{rate:.4g} Hz with {self.delay * 1e3:.3g} ms of delay, have the largest root modulus {self.modulus:.4f}, "
            f"which must be below 1; at this damping it is {bound}"
        )


def refusal(scene: Scene) -> Refusal | None:
    """Return why a scene would be unstable; None where it would not.

    The loop is that of a flotor that nobody holds, at its centre, where the axes do not act on each other. A hand
    mostly damps; braking pulses are not in it, for they end by themselves.

    Args:
        scene: The scene, with the present period and delay.
    """
    laws = scene.laws()
    worst: Refusal | None = None
    for acting, stiffness, damping in _loops(laws):
        modulus = largest_modulus(stiffness, damping, period=scene.period, delay=scene.delay, mass=INERTIA)
        # with no stiffness the flotor may stay anywhere, which is one root at 1
        wrong = modulus >= np.where(stiffness > 0.0, 1.0 - _ROUNDING, 1.0 + _ROUNDING)
        for index in np.flatnonzero(wrong):
            if worst is None or modulus[index] > worst.modulus * (1.0 + _ROUNDING):
                worst = Refusal(
                    axis=AXES[index],
                    acting=acting,
                    stiffness=float(stiffness[index]),
                    damping=float(damping[index]),
                    modulus=float(modulus[index]),
                    largest_stable=0.0,
                    period=scene.period,
                    delay=scene.delay,
                )
    if worst is None:
        return None
    mass = float(INERTIA[AXES.index(worst.axis)])
    bound = largest_stable_stiffness(worst.damping, period=worst.period, delay=worst.delay, mass=mass)
    return worst._replace(largest_stable=float(bound))


def _loops(laws: Sequence[Law]) -> Iterator[tuple[str, Array, Array]]:
    """Yield what may act together, and its stiffness and damping on the six axes, (6,) each.

    Walls act in contact only, and the stiffness of friction only while it sticks; its damping always does.
    """
    always, touched, stuck = np.zeros((2, 6)), np.zeros((2, 6)), np.zeros((2, 6))
    for law in laws:
        if isinstance(law, Hold):
            always += _gains(law.axes, law.stiffness, law.damping)
        elif isinstance(law, Friction):
            always += _gains(law.axes, 0.0, law.damping)
            stuck += _gains(law.axes, law.stiffness, 0.0)
        elif isinstance(law, Wall):
            met = np.isin(np.arange(len(AXES)), [index for index, _, _ in law.faces])
            touched += _gains(law.axes, law.stiffness, law.damping) * met
    for touches, sticks in product((False, True), repeat=2):
        if (touches and not touched.any()) or (sticks and not stuck.any()):
            continue
        acting = [name for name, acts in (("walls", touches), ("friction", sticks)) if acts]
        stiffness, damping = always + touches * touched + sticks * stuck
        yield " and ".join(acting) or "nothing but the scene", stiffness, damping


def _gains(axes: str | Sequence[str], stiffness: object, damping: object) -> Array:
    """Return a law's gains on the six axes, (2, 6)."""
    gains = np.zeros((2, len(AXES)))
    indices = list(axis_indices(axes))
    gains[0, indices], gains[1, indices] = np.asarray(stiffness), np.asarray(damping)
    return gains
