"""Arguments of public functions and classes: their declared types, `rate` for `period`, and hints for wrong ones."""

from __future__ import annotations

import operator
import re
import sys
import types
from collections import ChainMap
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import cache, partial, wraps
from inspect import CO_VARKEYWORDS, signature, unwrap
from itertools import repeat
from numbers import Number, Real
from os import PathLike
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, get_args, get_origin
from weakref import WeakSet

from maglev_mj.errors import KeywordError, MaglevError, ParameterError, choice_message, one_line

_T = TypeVar("_T")
_WORDS = {"bool": "True or False", "float": "a number", "int": "an integer", "str": "a string"}
_WORDS |= dict.fromkeys(("Path", "Path | str", "str | Path"), "a file path")
_WORDS |= {f"{note} | None": f"{text} or None" for note, text in _WORDS.items()}
_EVERY_TICK = frozenset("drive force inverse_at inverse_at_angle receive".split())
"""Called on every tick: their arguments are checked only after a failure."""
_INNER = frozenset("FrictionState answer at axis period sample signals step switch time write".split())
"""Called on every tick: a wrapper, even an empty one, takes more than 2 % of it. They check arguments alone."""
_RATES = frozenset(("rate", "device_rate"))
_OWN = (type, Number, Collection)
"""Kinds of values of which each is checked; of another class, that one object fits means that all do."""
_done: WeakSet[Any] = WeakSet()
_whole: WeakSet[type] = WeakSet()


def with_hints(target: _T) -> _T:
    """Return a function, or a class with its constructor replaced, that checks its arguments by their declared types.

    A wrong keyword raises `KeywordError` with a suggestion, an argument of another type `ParameterError`. The contents
    of arrays are checked only after a failure. `rate` [Hz] is accepted for `period`.
    """
    method = "__new__" if isinstance(target, type) and issubclass(target, tuple) else "__init__"
    call: Any = getattr(target, method) if isinstance(target, type) else target
    name = getattr(target, "__name__", "")
    # a sample and a command, dataclasses with slots, are made on every tick
    if _is_light(target) or target in _done or not hasattr(call, "__code__") or name in _INNER:
        return target
    result = target if isinstance(target, type) else _checked(call, name)
    if isinstance(target, type):
        if method == "__new__":
            call.__module__ = target.__module__  # generated: it has no names of the module
        own = isinstance(getattr(target, "parameters", None), types.MethodType)  # parameters, each with its check
        setattr(target, method, _checked(call, name, late=own))
    _done.add(result)
    return result


def with_checked_methods(cls: type) -> None:
    """Replace the public methods of a class, and of its bases, by ones that check their arguments; see `with_hints`."""
    for base in cls.__mro__:
        if base in _whole or not base.__module__.startswith("maglev_mj."):
            continue
        _whole.add(base)
        for name, member in list(vars(base).items()):
            call = getattr(member, "__func__", member)  # of a class method
            if not isinstance(call, types.FunctionType) or name.startswith("_") or name in _INNER or call in _done:
                continue
            if call.__code__.co_argcount + call.__code__.co_kwonlyargcount > 1:
                method = _checked(call, name, late=name in _EVERY_TICK)
                setattr(base, name, method if call is member else type(member)(method))


def _is_light(kind: Any) -> bool:
    return bool(vars(kind).keys() >= {"__slots__", "__dataclass_fields__"})


def _checked(call: Any, called: str, *, late: bool = False) -> Any:
    """Return a function that checks its arguments before the call; if `late`, only once the call has failed."""
    good: set[tuple[Any, ...]] = set()  # classes of arguments that need no further check

    def checked(*arguments: Any, **keywords: Any) -> Any:
        if not _RATES.isdisjoint(keywords):
            keywords = with_period(_names(call), keywords)
        if not late:
            kinds = (*map(type, arguments), *keywords, *map(type, keywords.values()))
            if kinds not in good:
                if message := mismatch(call, arguments, keywords):
                    raise ParameterError(message)
                if message is None:
                    good.add(kinds)
        try:
            return call(*arguments, **keywords)
        except (TypeError, AttributeError, LookupError, ValueError) as error:
            if not isinstance(error, MaglevError) or isinstance(error, TypeError):
                _explain(error, called, call, arguments, keywords)
            raise

    return wraps(call)(checked)


def _explain(error: Exception, called: str, call: Any, arguments: tuple[Any, ...], keywords: dict[str, Any]) -> None:
    """Raise an error that names the wrong keyword or argument, if one explains the error of a call."""
    names = _names(call)
    is_open = unwrap(call).__code__.co_flags & CO_VARKEYWORDS and "Unpack" not in str(call.__annotations__)
    wrong = [] if is_open else [name for name in keywords if name not in names]
    if wrong:
        also = "; set those of a scene first: find_scene('drop')(height=0.002)" if "scene" in names else ""
        raise KeywordError(choice_message(f"argument of {called}", names, wrong[0], also)) from None
    if not isinstance(error, MaglevError):
        try:
            signature(call).bind(*arguments, **keywords)
        except TypeError as missing:
            raise KeywordError(f"arguments of {called} must be {', '.join(names)}: {missing}") from None
        if message := mismatch(call, arguments, keywords, arrays=True):
            raise ParameterError(message) from None


def with_period(names: Collection[str], keywords: Mapping[str, Any]) -> dict[str, Any]:
    """Return keywords with `rate` [Hz] replaced by `period` [s] if only the latter is among the accepted names.

    So is `device_rate` by `device_period`.
    """
    changed = dict(keywords)
    for rate in (_RATES & changed.keys()) - set(names):
        if (period := f"{rate[:-4]}period") in names:
            import numpy as np  # slow to load

            if period in changed:
                raise KeywordError(f"{period} and {rate} must not both be given")
            changed[period] = changed.pop(rate)
            with suppress(TypeError, ValueError), np.errstate(divide="ignore"):  # no number: the period's check says so
                changed[period] = (1.0 / np.asarray(changed[period], dtype=np.float64)).tolist()
    return changed


def mismatch(call: Any, arguments: tuple[Any, ...], keywords: dict[str, Any], *, arrays: bool = False) -> str | None:
    """Return the message for the first argument that does not have its declared type; "" for none.

    None if the classes of the arguments alone tell that there is none.
    """
    positions, hints = _hints(call, arrays)
    certain = True
    for name, value in (*zip(positions, arguments), *keywords.items()):
        if name in hints:
            note, hint, usual, test = hints[name]
            if value.__class__ not in usual:
                certain = False
                if not test(value):
                    if get_origin(hint) is Literal:
                        return choice_message(name, map(str, get_args(hint)), value)
                    spelled = re.sub(r"(\w+\.)+", "", str(hint)) if get_args(hint) else note
                    return f"{name} must be {_WORDS.get(note, f'of type {spelled}')} (got {one_line(value)})"
                if not isinstance(value, _OWN):
                    usual.add(value.__class__)
            if arrays and _is_light(type(value)):
                fields = {key: getattr(value, key) for key in type(value).__dataclass_fields__}
                if message := mismatch(type(value).__init__, (), fields, arrays=True):
                    return f"{name} {message}"
    return None if certain else ""


@cache
def _hints(
    call: Any, arrays: bool
) -> tuple[tuple[str, ...], dict[str, tuple[str, Any, set[type], Callable[[Any], bool]]]]:
    """Return names of positional parameters, and the type of each annotated one with the classes that need no check."""
    function = unwrap(call)
    code, hints, module = function.__code__, {}, sys.modules.get(function.__module__)
    space = vars(module) if module else function.__globals__
    for name, declared in _names(function).items():
        note = getattr(declared, "__forward_arg__", declared)
        with suppress(NameError, TypeError):  # without a type, or one that cannot be checked here
            hint = eval(note, space)
            if re.search("Array|Mask|Six|Component", note):
                if not arrays:
                    continue
                hint = hint if note == "Array" else _Numeric | None if "None" in note else _Numeric
            if hint in (Any, object):
                continue
            parts = get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,)
            usual = {part for part in parts if isinstance(part, type)} | ({int} if float in parts else set())
            hints[name] = note, hint, usual, _test(hint)
    return code.co_varnames[: code.co_argcount], hints


class _Numeric:
    """Hint of an array, or of what one is made of."""


def _test(hint: Any) -> Callable[[Any], bool]:
    """Return a function that is True unless a value is certainly not of a type."""
    kind, parts = get_origin(hint) or hint, get_args(hint)
    if kind in (Union, types.UnionType):
        tests = [_test(part) for part in parts]
        return lambda value: any(map(operator.call, tests, repeat(value)))
    if kind is Literal:
        return lambda value: isinstance(value, tuple(map(type, parts))) and value in parts
    if kind in (float, int, bool, str):
        return partial(_is_scalar, kind)
    if kind is type and isinstance(parts[0], type):
        return lambda value: isinstance(value, type) and issubclass(value, parts[0])
    if getattr(kind, "_is_protocol", False):
        return lambda value: not isinstance(value, type) and all(hasattr(value, name) for name in _members(kind))
    if kind is _Numeric:
        return _is_numeric
    if kind is None:
        return lambda value: value is None
    if kind in (Any, object) or not isinstance(kind, type):
        return lambda value: True
    if kind is Path:
        kind = (str, PathLike)
    elif kind in (tuple, list, Sequence):
        kind = Collection  # a list is as good as a tuple
    if kind in (Collection, Iterable) and len(parts) == 1 + (... in parts):
        return partial(_holds, kind, _test(parts[0]))
    return lambda value: isinstance(value, kind)


def _is_scalar(kind: type, value: Any) -> bool:
    if getattr(value, "shape", None) == ():
        value = value.item()  # of NumPy
    if kind in (bool, str):
        return isinstance(value, kind)
    if getattr(value, "shape", None):
        return _is_numeric(value)  # values of many devices: the call's own check says if it takes them
    return isinstance(value, Real) and not isinstance(value, bool) and (kind is float or value % 1 == 0)


def _holds(kind: type, test: Callable[[Any], bool], value: Any) -> bool:
    """Return True for a collection; in a list or tuple one element of each type is tested."""
    kinds = dict(zip(map(type, value), value)) if isinstance(value, (list, tuple, str)) else {}
    return isinstance(value, kind) and all(map(test, kinds.values()))


def _members(protocol: type) -> list[str]:
    names = {name for base in protocol.__mro__ if getattr(base, "_is_protocol", False) for name in vars(base)}
    return [name for name in names if not name.startswith("_") or name == "__call__"]


def _is_numeric(value: Any) -> bool:
    """Return True for a number, an array of numbers, or a sequence of such."""
    if isinstance(value, list | tuple):
        return all(map(_is_numeric, value))
    return isinstance(value, Real) or getattr(getattr(value, "dtype", None), "kind", "O") in "fiu"


def _names(call: Any) -> dict[str, Any]:
    """Return a function's parameters with their declared types, with those of an unpacked TypedDict."""
    given = {name: re.fullmatch(r"Unpack\[(\w+)\]", str(note)) for name, note in call.__annotations__.items()}
    named = [one.name for one in signature(call).parameters.values() if one.kind is not one.VAR_POSITIONAL]
    names = [name for name in named if name not in ("self", "cls", "_cls") and not given.get(name)]
    packed = [unwrap(call).__globals__[kind[1]].__annotations__ for kind in given.values() if kind]
    return {name: call.__annotations__.get(name) for name in names} | dict(ChainMap(*packed))
