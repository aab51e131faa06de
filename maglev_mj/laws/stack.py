"""Stack the laws of N devices into one law."""

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

__all__ = ["content", "law_kind", "stacked"]


def law_kind(law: object) -> Hashable | None:
    """Return the kind of a law; those of one kind can be stacked.

    None for a law that cannot be. It can be if it is a dataclass that names in `per_device` the fields that may differ.
    """
    if not (isinstance(law, Law) and is_dataclass(law) and law.per_device):
        return None
    fixed = [getattr(law, name) for name in _fixed(type(law))]
    return None if (known := content(fixed)) is None else (type(law), known)


@cache
def _fixed(cls: Any) -> tuple[str, ...]:
    """Return the fields of a law in which all devices agree."""
    return tuple(one.name for one in fields(cls) if one.init and one.name not in cls.per_device)


def content(value: object) -> bytes | None:
    """Return bytes, equal for equal contents; None for a local function."""
    try:
        return pickle.dumps(value)
    except Exception:  # whatever a user's class raises
        return None


def stacked(laws: Sequence[Any]) -> Any:
    """Return one law for N devices: parameters that differ become (N, axes).

    Raises:
        ParameterError: If a law is of several devices itself, or does not take parameters that differ.
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
    """Return a parameter of N laws, a number or one an axis each, as (N, axes)."""
    try:
        if all(value.__class__ is float for value in values):
            return np.repeat(np.array(values), width).reshape(-1, width)
        return np.stack([np.broadcast_to(np.asarray(value, dtype=np.float64), (width,)) for value in values])
    except (TypeError, ValueError):
        raise ParameterError(f"{name} must be a number or one for each of {width} axes in each law") from None
