"""Stacking of N devices' laws into one law."""

from __future__ import annotations

import pickle
from collections.abc import Hashable, Sequence
from dataclasses import fields, is_dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Array
from maglev_mj.laws.base import Law
from maglev_mj.parameters import axis_indices


def law_kind(law: object) -> Hashable | None:
    """Return the kind of a law, or None.

    Laws of one kind can be stacked; None is for a law that cannot be stacked.

    A law can be stacked if it is a dataclass that lists in `per_device` the fields that may differ.
    """
    if not (isinstance(law, Law) and is_dataclass(law) and law.per_device):
        return None
    fixed = [getattr(law, name) for name in _fixed(type(law))]
    return None if (known := content(fixed)) is None else (type(law), known)


@cache
def _fixed(cls: Any) -> tuple[str, ...]:
    """Return the field names common to all devices."""
    return tuple(one.name for one in fields(cls) if one.init and one.name not in cls.per_device)


def content(value: object) -> bytes | None:
    """Return bytes that are equal for equal contents.

    None for a local function, which has none.
    """
    try:
        return pickle.dumps(value)
    except Exception:  # a user's class may raise anything
        return None


def stacked(laws: Sequence[Any]) -> Any:
    """Return one law for N devices.

    Parameters that differ become (N, axes).

    Raises:
        ParameterError: If a law is itself for several devices, or does not accept per-device parameters.
    """
    first = laws[0]
    if all(law is first for law in laws):
        return first
    width = len(axis_indices(getattr(first, "axes", AXES)))
    changes = {}
    for name in first.per_device:
        values = [getattr(law, name) for law in laws]
        if not all(value is values[0] for value in values):
            rows = _rows(name, values, width)
            if (rows != rows[0]).any():
                changes[name] = rows
    return replace(first, **changes) if changes else first


def _rows(name: str, values: Sequence[Any], width: int) -> Array:
    """Return a parameter of N laws as (N, axes).

    In each law it is one number or one number per axis.
    """
    try:
        if all(value.__class__ is float for value in values):
            return np.repeat(np.array(values), width).reshape(-1, width)
        return np.stack([np.broadcast_to(np.asarray(value, dtype=np.float64), (width,)) for value in values])
    except (TypeError, ValueError):
        raise ParameterError(f"{name} must be a number or one for each of {width} axes in each law") from None
