"""Keyword arguments of public functions and classes: `rate` in place of `period`, and hints for wrong ones."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping
from functools import wraps
from typing import Any, TypeVar

from maglev_mj.errors import KeywordError, choice_message

_T = TypeVar("_T")


def with_hints(target: _T) -> _T:
    """Return a function, or a class with its constructor changed in place, whose wrong arguments raise `KeywordError`.

    A `rate` [Hz] is converted to the `period` that the target accepts.
    """
    if not isinstance(target, type):
        return target if hasattr(target, "__wrapped__") else _checked(target, target.__name__)  # type: ignore[attr-defined]
    # a sample and a command, dataclasses with slots, are made on every tick
    if (make := vars(target).get("__init__")) is not None and not hasattr(make, "__wrapped__"):
        if not {"__slots__", "__dataclass_fields__"} <= vars(target).keys():
            target.__init__ = _checked(make, target.__name__)  # type: ignore[misc]
    return target


def _checked(call: Any, name: str) -> Any:
    @wraps(call)
    def checked(*arguments: Any, **keywords: Any) -> Any:
        if "rate" in keywords:
            keywords = with_period(_names(call), keywords)
        try:
            return call(*arguments, **keywords)
        except TypeError as error:
            wrong = re.search(r"unexpected keyword argument '(\w+)'", text := str(error))
            if wrong and wrong[1] in keywords:
                names = _names(call)
                also = "; set those of a scene first: find_scene('drop')(height=0.002)" if "scene" in names else ""
                raise KeywordError(choice_message(f"argument of {name}", names, wrong[1], also)) from None
            if error.__traceback__ is not None and error.__traceback__.tb_next is None:  # the call itself failed
                raise KeywordError(text.replace(".__init__()", "()")) from None
            raise

    return checked


def with_period(names: Collection[str], keywords: Mapping[str, Any]) -> dict[str, Any]:
    """Return keywords with `rate` [Hz] replaced by `period` [s] if only the latter is among the accepted names.

    Raises:
        KeywordError: If both are given.
        ParameterError: If the rate is not above 0.
    """
    changed = dict(keywords)
    if "rate" in changed and "rate" not in names and "period" in names:
        from maglev_mj.parameters import numbers  # imported here: loads NumPy

        if "period" in changed:
            raise KeywordError("period and rate must not both be given")
        changed["period"] = (1.0 / numbers("rate", changed.pop("rate"), above=0.0)).tolist()
    return changed


def _names(call: Callable[..., Any]) -> list[str]:
    """Return the names of a function's parameters, with those of an unpacked TypedDict."""
    import inspect  # slow to load

    names = []
    for one in inspect.signature(call).parameters.values():
        unpacked = re.fullmatch(r"Unpack\[(\w+)\]", str(one.annotation))
        names += [*call.__globals__[unpacked[1]].__annotations__] if unpacked else [one.name]
    return [name for name in names if name != "self"]
