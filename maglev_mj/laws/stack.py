"""Laws of devices that differ in their parameters, as one law for all of them."""

from __future__ import annotations

import pickle
from collections.abc import Hashable, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np

from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Array
from maglev_mj.laws.base import Law
from maglev_mj.parameters import axis_indices

__all__ = ["content", "law_kind", "stacked"]


def law_kind(law: object) -> Hashable | None:
    """Return what laws must agree in to be stacked; None for a law that cannot be.

    A law can be if it is a dataclass that names in `per_device` the fields that may differ.
    """
    if not (isinstance(law, Law) and is_dataclass(law) and law.per_device):
        return None
    fixed = [getattr(law, one.name) for one in fields(law) if one.init and one.name not in law.per_device]
    return None if (known := content(fixed)) is None else (type(law), known)


def content(value: object) -> bytes | None:
    """Return bytes that are equal for equal contents; None for what has none, as a local function."""
    try:
        return pickle.dumps(value)
    except Exception:  # whatever a user's class raises
        return None


def stacked(laws: Sequence[Any]) -> Any:
    """Return one law for N devices of N laws of one kind: what differs becomes (N, axes).

    Raises:
        ParameterError: If a law is of several devices itself, or does not take parameters that differ.
    """
    first = laws[0]
    width = len(axis_indices(getattr(first, "axes", AXES)))
    changes = {}
    for name in first.per_device:
        rows = _rows(name, [getattr(law, name) for law in laws], width)
        if (rows != rows[0]).any():
            changes[name] = rows
    return replace(first, **changes) if changes else first


def _rows(name: str, values: Sequence[Any], width: int) -> Array:
    """Return a parameter of N laws, a number or one an axis each, as (N, axes)."""
    try:
        return np.stack([np.broadcast_to(np.asarray(value, dtype=np.float64), (width,)) for value in values])
    except (TypeError, ValueError):
        raise ParameterError(f"{name} must be a number or one for each of {width} axes in each law") from None
