"""Checks that parameters share: each failure is one line that names the value and what is allowed."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Array, Component

__all__ = ["axis_indices", "batch_shape", "common_shape", "flag", "number", "numbers", "parsed_number", "per_axis"]

_NO_NUMBERS = bool, np.bool_, str, bytes
"""Types that float() takes, and that are a slip in place of a number."""


def flag(name: str, value: object) -> bool:
    """Return `value` as a bool.

    Raises:
        ParameterError: If it is neither True nor False.
    """
    if not isinstance(value, bool | np.bool_):
        raise ParameterError(f"{name} must be True or False, not {value!r}")
    return bool(value)


def number(
    name: str,
    value: object,
    *,
    above: float = -math.inf,
    at_least: float = -math.inf,
    below: float = math.inf,
    at_most: float = math.inf,
) -> float:
    """Return `value` as a finite float within the bounds.

    Raises:
        ParameterError: If it is no number, not finite, or outside the bounds.
    """
    try:
        result = math.nan if isinstance(value, _NO_NUMBERS) else float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        result = math.nan
    if not (above < result < below and at_least <= result <= at_most and math.isfinite(result)):
        words = [
            f"{word} {bound:g}"
            for word, bound in (
                ("above", above),
                ("at least", at_least),
                ("below", below),
                ("at most", at_most),
            )
            if math.isfinite(bound)
        ]
        allowed = "a finite number" + (" " + " and ".join(words) if words else "")
        raise ParameterError(f"{name} must be {allowed}, not {value!r}")
    return result


def numbers(name: str, value: ArrayLike, *, at_least: float = -math.inf, finite: bool = True) -> Array:
    """Return `value` as a float array, each entry checked as `number` checks one.

    Args:
        name: What to call it in the message.
        value: Number or array.
        at_least: Least value allowed.
        finite: False lets infinity pass; NaN never passes.

    Raises:
        ParameterError: If an entry is not a number, not finite, or too small.
    """
    try:
        given = np.asarray(value)
    except ValueError:  # rows of different lengths
        given = np.asarray("")
    if given.dtype.kind not in "fiu" or _has_flag(value):
        raise ParameterError(f"{name} must be a number or an array of numbers, not {value!r}")
    array = np.asarray(given, dtype=np.float64)
    good = array >= at_least
    if flag("finite", finite):
        good &= np.isfinite(array)
    if not good.all():
        kind = "finite and " if finite else ""
        bound = f"at least {at_least:g}" if math.isfinite(at_least) else "a number"
        raise ParameterError(f"{name} must be {kind}{bound} everywhere, not {array[~good].flat[0]:g}")
    return array


def parsed_number(name: str, text: str) -> float:
    """Return the finite number that a text is.

    Raises:
        ParameterError: If it is none.
    """
    try:
        return number(name, float(text))
    except ValueError:
        return number(name, text)


def axis_indices(axes: str | Sequence[str]) -> tuple[int, ...]:
    """Return the indices of `axes`: one name, or several as a sequence.

    Raises:
        ParameterError: If a name is unknown, is given twice, or none is given.
    """
    names = (axes,) if isinstance(axes, str) else tuple(axes)
    for name in names:
        if name not in AXES:
            raise ParameterError(f"axis must be one of {', '.join(AXES)}, not {name!r}")
    if not names or len(set(names)) != len(names):
        raise ParameterError(f"axes must be one or more different names of {', '.join(AXES)}, not {names!r}")
    return tuple(AXES.index(name) for name in names)


def batch_shape(what: str, values: Iterable[Array]) -> tuple[int, ...]:
    """Return the batch shape that parameters (..., axes) share.

    Raises:
        ParameterError: If they do not fit one another.
    """
    shapes = [value.shape[:-1] for value in values]
    try:
        return np.broadcast_shapes(*shapes)
    except ValueError:
        raise ParameterError(f"{what} parameters must fit one batch shape, not {sorted(set(shapes))}") from None


def common_shape(what: str, *shapes: tuple[int, ...]) -> tuple[int, ...]:
    """Return what shapes broadcast to.

    Raises:
        ParameterError: If they do not.
    """
    try:
        return np.broadcast_shapes(*shapes)
    except ValueError:
        raise ParameterError(f"{what} must fit one shape, not {', '.join(map(str, sorted(set(shapes))))}") from None


def per_axis(name: str, values: Array, count: int) -> tuple[Component, ...]:
    """Split a checked parameter into `count` components, one for each axis of a law.

    A number serves all axes; (count,) gives one each; (..., count) also differs from device to device.

    Raises:
        ParameterError: If the last dimension is not `count`.
    """
    if values.ndim == 0:
        return (float(values),) * count
    if values.shape[-1] != count:
        raise ParameterError(f"{name} must have a last dimension of {count} (one for each axis), not {values.shape}")
    if values.ndim == 1:
        return tuple(values.tolist())
    return tuple(np.ascontiguousarray(np.moveaxis(values, -1, 0)))


def _has_flag(value: object) -> bool:
    """Return whether there is a bool among numbers; as an array it would be 0 or 1."""
    return isinstance(value, bool | np.bool_) or (isinstance(value, list | tuple) and any(map(_has_flag, value)))
