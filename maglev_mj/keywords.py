"""Keyword arguments of public functions and classes: `rate` for `period`, and hints for wrong ones."""

from __future__ import annotations

import re
import types
from collections import ChainMap
from collections.abc import Collection, Mapping
from contextlib import suppress
from functools import wraps
from numbers import Integral, Real
from typing import Any, TypeVar, Union, get_args, get_origin
from weakref import WeakSet

from maglev_mj.errors import KeywordError, MaglevError, ParameterError, choice_message, one_line

_T = TypeVar("_T")
_NUMBERS: dict[Any, Any] = {float: Real, int: Integral}
_done: WeakSet[Any] = WeakSet()


def with_hints(target: _T) -> _T:
    """Return a function, or a class with its constructor replaced, that takes `rate` [Hz] for `period`.

    A wrong keyword raises `KeywordError` with a suggestion. If the call fails on an argument of another type than
    declared, or on their number, a `ParameterError` says so.
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
        except (TypeError, AttributeError) as error:
            names = _names(call)
            wrong = [name for name in keywords if name not in names]
            if not wrong:
                if not isinstance(error, MaglevError):
                    _check_types(target.__name__, call, arguments, keywords)  # type: ignore[attr-defined]
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


def _check_types(called: str, call: Any, arguments: tuple[Any, ...], keywords: dict[str, Any]) -> None:
    """Raise an error if arguments are missing or too many, or one does not have its declared type."""
    import inspect  # slow to load

    try:
        given = inspect.signature(call).bind(*arguments, **keywords).arguments | keywords
    except TypeError as error:
        raise KeywordError(f"arguments of {called} must be {', '.join(_names(call))}: {error}") from None
    for name, declared in _names(call).items():
        note = getattr(declared, "__forward_arg__", declared)
        with suppress(NameError, TypeError):  # without a type, or one that cannot be checked here
            hint = eval(note, call.__globals__)
            parts = get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,)
            kinds = tuple(_NUMBERS.get(part, get_origin(part) or part) for part in parts)
            if name in given and "Array" not in note and not isinstance(given[name], kinds):
                kind = re.sub(r"\w+\.(?=\w)", "", inspect.formatannotation(hint))
                raise ParameterError(f"{name} must be of type {kind} (got {one_line(given[name])})")


def _names(call: Any) -> dict[str, Any]:
    """Return a function's parameters with their declared types, with those of an unpacked TypedDict."""
    import inspect  # slow to load

    given = {name: re.fullmatch(r"Unpack\[(\w+)\]", str(note)) for name, note in call.__annotations__.items()}
    names = [name for name in inspect.signature(call).parameters if name != "self" and not given.get(name)]
    packed = [call.__globals__[kind[1]].__annotations__ for kind in given.values() if kind]
    return {name: call.__annotations__.get(name) for name in names} | dict(ChainMap(*packed))
