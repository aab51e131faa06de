"""Laws and controllers of N devices as one, for a batch; and what is alike enough for one."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import fields, is_dataclass, replace
from functools import cache
from typing import Any, TypeVar

import numpy as np

from maglev_mj.control.controller import Controller
from maglev_mj.control.laws.base import Law
from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Array
from maglev_mj.parameters import axis_indices

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


def alike(kinds: Iterable[Hashable]) -> dict[Any, list[int]]:
    """Return the indices of equal kinds by kind, without None, in the order of the first of each."""
    groups: dict[Any, list[int]] = {}
    for index, kind in enumerate(kinds):
        if kind is not None:
            groups.setdefault(kind, []).append(index)
    return groups


def computed_together(
    items: Sequence[_Item],
    kinds: Iterable[Hashable],
    compute: Callable[[list[_Item]], Iterable[_Result]],
    default: Any = None,
    most: Callable[[_Item], int] | None = None,
) -> list[_Result]:
    """Return the result of each item, computed at once for those of equal kind.

    Args:
        items: The items.
        kinds: Kind of each; None for an item that gets the default.
        compute: Function that returns a result for each of some items of one kind.
        default: Result of items without a kind.
        most: Function of the first item of a kind that returns how many are computed at once; None for all.
    """
    results = [default] * len(items)
    for indices in alike(kinds).values():
        size = len(indices) if most is None else most(items[indices[0]])
        for start in range(0, len(indices), size):
            some = indices[start : start + size]
            for index, result in zip(some, compute([items[index] for index in some]), strict=True):
                results[index] = result
    return results


def stacked_controller(controllers: Sequence[Controller], devices: int = 1) -> Controller | None:
    """Return the controllers as one, each for several devices in a row; None if they differ in more than gains."""
    first = controllers[0]
    if all(one is first for one in controllers):
        return first
    kinds = {(one.period, content(one.velocity), *map(law_kind, one.laws)) for one in controllers}
    if len(kinds) > 1 or None in kinds.pop():
        return None
    laws = zip(*(one.laws for one in controllers for _ in range(devices)))
    return Controller([stacked(same) for same in laws], period=first.period, velocity=first.velocity)


def law_kind(law: object) -> Hashable | None:
    """Return a key that is equal for laws that can be stacked; None for a law that cannot.

    A law can be stacked if it is a dataclass that lists the fields that may differ in `per_device`.
    """
    if not (isinstance(law, Law) and is_dataclass(law) and law.per_device):
        return None
    fixed = [getattr(law, name) for name in _fixed(type(law))]
    return None if (key := content(fixed)) is None else (type(law), key)


@cache
def _fixed(cls: Any) -> tuple[str, ...]:
    """Return the names of the fields common to all devices."""
    return tuple(field.name for field in fields(cls) if field.init and field.name not in cls.per_device)


def content(value: object) -> bytes | None:
    """Return bytes that are equal for equal contents; None for an object that cannot be pickled."""
    try:
        return pickle.dumps(value)
    except Exception:  # a user's class may raise anything
        return None


def stacked(laws: Sequence[Any]) -> Any:
    """Return one law for N devices; parameters that differ become (N, axes).

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
    """Return a parameter of N laws, a number or one per axis, as (N, axes)."""
    try:
        if all(value.__class__ is float for value in values):
            return np.repeat(np.array(values), width).reshape(-1, width)
        return np.stack([np.broadcast_to(np.asarray(value, dtype=np.float64), (width,)) for value in values])
    except (TypeError, ValueError):
        raise ParameterError(f"{name} must be a number, or one for each of {width} axes") from None
