"""Published bounds on the stiffness of a sampled wall.

Each docstring states the sense of its bound: passivity or stability.

All accept and return numbers or arrays that broadcast. `physical_damping` is that of device and hand. The levitated
flotor has almost none, so no wall on it is passive, but many are stable.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.frames import Array
from maglev_mj.parameters import numbers


def colgate(damping: ArrayLike, *, period: ArrayLike, physical_damping: ArrayLike = 0.0) -> Array:
    """Return the largest passive stiffness.

    It is 2 (b - |B|) / T, or 0 if no stiffness is passive.

    The bound is that of passivity, which implies stability with any passive hand. It is for a wall without delay beyond
    the hold. The virtual damping B lowers it: a device with b below |B| is passive with no spring at all.

    Args:
        damping: Virtual damping B [N s/m].
        period: Sample period T [s].
        physical_damping: Damping b [N s/m].

    Raises:
        ParameterError: If a value is outside its bounds.

    Source: Colgate & Schenkel 1997, b > K T/2 + |B|, as quoted by others; the tests derive it again from the general
    condition on the frequency response.
    """
    b, virtual, time = _checked(damping, physical_damping, period)
    return np.maximum(2.0 * (b - np.abs(virtual)) / time, 0.0)


def gil(damping: ArrayLike, *, period: ArrayLike, delay: ArrayLike, physical_damping: ArrayLike = 0.0) -> Array:
    """Return the stiffness of the linear stability condition.

    It is (b + B) / (T/2 + T_d).

    The bound is that of stability without a hand, to first order in B T/m and K T²/m: low damping, short delay, fast
    sampling. Beyond about B T/m = 0.1 the exact boundary is lower.

    Args:
        damping: Virtual damping B [N s/m].
        period: Sample period T [s].
        delay: Transport delay T_d [s].
        physical_damping: Damping b [N s/m].

    Raises:
        ParameterError: If a value is outside its bounds.

    Source: Gil, Sanchez, Hulin, Preusche & Hirzinger 2009; not checked against the original, its first order checked in
    the tests.
    """
    b, virtual, time = _checked(damping, physical_damping, period)
    return (b + virtual) / (0.5 * time + numbers("delay", delay, at_least=0.0))


def minsky(damping: ArrayLike, *, period: ArrayLike, physical_damping: ArrayLike = 0.0) -> Array:
    """Return the stiffness bound 2 (b + B) / T.

    It is the condition B/(K T) > 1/2 with all damping counted.

    The bound is that of stability to first order, without delay beyond the hold: `gil` at T_d = 0.

    Args:
        damping: Virtual damping B [N s/m].
        period: Sample period T [s].
        physical_damping: Damping b [N s/m].

    Raises:
        ParameterError: If a value is outside its bounds.

    Source: form after Minsky, Ouh-young, Steele, Brooks & Behensky 1990; not checked against the original, nor is the
    constant.
    """
    return gil(damping, period=period, delay=0.0, physical_damping=physical_damping)


def abbott_okamura(
    *, period: ArrayLike, physical_damping: ArrayLike, dry_friction: ArrayLike, quantum: ArrayLike
) -> Array:
    """Return the largest passive stiffness over a quantized sensor.

    It is min(2 b/T, 2 f_c/quantum).

    The wall has no virtual damping and no delay; the mass has viscous and Coulomb friction.

    Args:
        period: Sample period T [s].
        physical_damping: Damping b [N s/m].
        dry_friction: Coulomb friction f_c of the device [N].
        quantum: Resolution of the sensor [m], above 0.

    Raises:
        ParameterError: If a value is outside its bounds.

    Source: Abbott & Okamura 2005, as quoted by others.
    """
    b, friction, time = _checked(dry_friction, physical_damping, period, name="dry_friction")
    step = numbers("quantum", quantum, at_least=0.0, above=0.0)
    return np.minimum(2.0 * b / time, 2.0 * friction / step)


def _checked(
    first: ArrayLike, physical_damping: ArrayLike, period: ArrayLike, name: str = "damping"
) -> tuple[Array, Array, Array]:
    """Return checked physical damping, first value, and period."""
    time = numbers("period", period, at_least=0.0, above=0.0)
    least = -np.inf if name == "damping" else 0.0
    return numbers("physical_damping", physical_damping, at_least=0.0), numbers(name, first, at_least=least), time
