"""Eigenvalues of the exact closed loop: largest modulus, critical delay, least dynamic stiffness."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Unpack

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array, Mask
from maglev_mj.parameters import common_shape, number, numbers
from maglev_mj.theory.closed_loop import LoopKeywords, SampledLoop

__all__ = ["critical_delay", "is_stable", "largest_modulus", "least_dynamic_stiffness"]

_HALVINGS = 45
_ROUNDING = 1e-12


def is_stable(modulus: ArrayLike, limit: float = 1.0) -> Mask:
    """Return whether a largest modulus is below a limit, by more than rounding."""
    return np.asarray(modulus) < limit * (1.0 - _ROUNDING)


def largest_modulus(stiffness: ArrayLike, damping: ArrayLike, **loop: Unpack[LoopKeywords]) -> Array:
    """Return the largest eigenvalue modulus of the closed loop inside the wall; below 1 it is stable.

    Args:
        stiffness: Wall stiffness [N/m], (...,).
        damping: Wall damping [N s/m], (...,).
        loop: Keywords of `SampledLoop`: period, delay, mass and so on; they broadcast with the gains.

    Raises:
        ParameterError: If a value is outside its bounds.
    """
    return SampledLoop(**loop).modulus(stiffness, damping)


def critical_delay(stiffness: ArrayLike, damping: ArrayLike, **loop: Unpack[LoopKeywords]) -> Array:
    """Return the delay [s] at which the wall stops being stable.

    Args:
        stiffness: Wall stiffness [N/m], (...,).
        damping: Wall damping [N s/m], (...,).
        loop: Keywords of `SampledLoop` but the delay; they broadcast with the gains.

    Returns:
        The shortest delay that is too long, (...,): 0 where the wall is unstable without delay, infinity where it
        is stable up to 3 periods.

    Raises:
        ParameterError: If a value is outside its bounds, or a delay is given.
    """
    if "delay" in loop:
        raise ParameterError(f"delay must be left out of critical_delay, which looks for it, not {loop['delay']!r}")
    loop["delay"] = 0.0
    around = SampledLoop(**loop)
    k, b = numbers("stiffness", stiffness, at_least=0.0), numbers("damping", damping, at_least=0.0)
    shape = common_shape("stiffness, damping and loop", k.shape, b.shape, around.shape)
    k, b = np.broadcast_to(k, shape)[..., None], np.broadcast_to(b, shape)[..., None]
    wide = around.widened()
    grid = np.broadcast_to(np.asarray(wide.period), (*shape, 1)) * np.linspace(0.0, 3.0, 121)
    unstable = ~is_stable(replace(wide, delay=grid).modulus(k, b))
    first = np.argmax(unstable, axis=-1)
    pick = np.stack([np.maximum(first - 1, 0), first], axis=-1)
    low, high = np.moveaxis(np.take_along_axis(grid, pick, axis=-1), -1, 0)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        good = is_stable(replace(wide, delay=middle[..., None]).modulus(k, b)[..., 0])
        low, high = np.where(good, middle, low), np.where(good, high, middle)
    return np.where(unstable.any(axis=-1), high, np.inf)


def least_dynamic_stiffness(
    stiffness: ArrayLike,
    damping: ArrayLike,
    *,
    frequencies: Sequence[float] | None = None,
    **loop: Unpack[LoopKeywords],
) -> Array:
    """Return how much force a hand needs at least for each metre, over all frequencies [N/m]; 0 for an unstable wall.

    It counts stiffness and stability margin at once: a wall near its boundary gives way at its resonance.

    Args:
        stiffness: Wall stiffness [N/m], (...,).
        damping: Wall damping [N s/m], (...,).
        frequencies: Where to look [Hz]; None for 0 and 50 more up to half the sample rate.
        loop: Keywords of `SampledLoop`; the period is a number.

    Raises:
        ParameterError: If a value is outside its bounds.
    """
    around = SampledLoop(**loop)
    if np.ndim(around.period):
        raise ParameterError(f"period must be one number here, not {np.shape(around.period)}")
    stable = is_stable(around.modulus(stiffness, damping))
    half = 0.5 / float(np.asarray(around.period))
    if frequencies is None:
        frequencies = [0.0, *np.geomspace(0.01 * half, 0.999 * half, 50)]
    if not len(frequencies):
        raise ParameterError("frequencies must be at least one, not none")
    chosen = [number("frequency", frequency, at_least=0.0, below=half) for frequency in frequencies]
    result, gives = np.zeros(stable.size), np.zeros(np.count_nonzero(stable))
    where = np.flatnonzero(stable)  # an unstable wall has no steady answer
    k, b = (np.broadcast_to(gain, stable.shape).reshape(-1)[where] for gain in (stiffness, damping))
    part = around.part(stable.shape, where)
    for moved in part.compliances(k, b, chosen) if where.size else ():
        gives = np.maximum(gives, np.abs(moved))
    result[where] = 1.0 / gives
    return result.reshape(stable.shape)
