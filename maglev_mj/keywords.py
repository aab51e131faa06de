"""Keyword arguments of public functions and classes: `rate` for `period`, and hints for wrong ones."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from contextlib import suppress
from functools import wraps
from typing import Any, TypeVar
from weakref import WeakSet

from maglev_mj.errors import KeywordError, choice_message

_T = TypeVar("_T")
_done: WeakSet[Any] = WeakSet()


def with_hints(target: _T) -> _T:
    """Return a function, or a class with its constructor replaced, that takes `rate` [Hz] for `period`.

    A wrong keyword raises `KeywordError` with a suggestion.
    """
    method = "__new__" if isinstance(target, type) and issubclass(target, tuple) else "__init__"
    call: Any = getattr(target, method) if isinstance(target, type) else target
    # a sample and a command, dataclasses with slots, are made on every tick
    often = {"__slots__", "__dataclass_fields__"} <= vars(target).keys()
    if often or target in _done or not hasattr(call, "__code__"):
        return target

    @wraps(call)
    def checked(*arguments: Any, **keywords: Any) -> Any:
        if "rate" in keywords:
            keywords = with_period(_names(call), keywords)
        try:
            return call(*arguments, **keywords)
        except TypeError:
            names = _names(call)
            wrong = [name for name in keywords if name not in names]
            if not wrong:
                raise
            also = "; set those of a scene first: find_scene('drop')(height=0.002)" if "scene" in names else ""
            raise KeywordError(choice_message(f"argument of {target.__name__}", names, wrong[0], also)) from None  # type: ignore[attr-defined]

    if isinstance(target, type):
        setattr(target, method, checked)
    _done.add(result := target if isinstance(target, type) else checked)
    return result  # type: ignore[return-value]


def with_period(names: Collection[str], keywords: Mapping[str, Any]) -> dict[str, Any]:
    """Return keywords with `rate` [Hz] replaced by `period` [s] if only the latter is among the accepted names."""
    changed = dict(keywords)
    if "rate" in changed and "rate" not in names and "period" in names:
        import numpy as np  # slow to load

        if "period" in changed:
            raise KeywordError("period and rate must not both be given")
        changed["period"] = changed.pop("rate")
        with suppress(TypeError, ValueError), np.errstate(divide="ignore"):  # no number: the period's check says so
            changed["period"] = (1.0 / np.asarray(changed["period"], dtype=np.float64)).tolist()
    return changed


def _names(call: Any) -> list[str]:
    """Return the names of a function's parameters, with those of an unpacked TypedDict."""
    import inspect  # slow to load

    given = {name: re.fullmatch(r"Unpack\[(\w+)\]", str(note)) for name, note in call.__annotations__.items()}
    names = [name for name in inspect.signature(call).parameters if name != "self" and not given.get(name)]
    return [*names, *(key for kind in given.values() if kind for key in call.__globals__[kind[1]].__annotations__)]
