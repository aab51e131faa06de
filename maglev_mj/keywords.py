"""Arguments of public functions and classes: their declared types, `rate` for `period`, and hints for wrong ones."""

from __future__ import annotations

import operator
import re
import sys
import types
from collections import ChainMap
from collections.abc import Callable, Collection, Container, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import cache, partial, wraps
from inspect import CO_VARKEYWORDS, Parameter, signature, unwrap
from itertools import repeat
from numbers import Number, Real
from os import PathLike
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, overload

from maglev_mj.errors import (
    NO_MASK,
    KeywordError,
    MaglevError,
    ParameterError,
    choice_message,
    is_masked,
    one_line,
    refuse_mask,
)

_T = TypeVar("_T")
_WORDS = {"bool": "True or False", "float": "a number", "int": "an integer", "str": "a string"}
_WORDS |= dict.fromkeys(("Path", "Path | str", "str | Path"), "a file path")
_WORDS |= {f"{note} | None": f"{text} or None" for note, text in _WORDS.items()}
_RATES = frozenset(("rate", "device_rate"))
_OWN = (type, Number, Collection)
"""Kinds of values of which each is checked; of another class, that one object fits means that all do."""


@overload
def checked(target: _T) -> _T: ...
@overload
def checked(*, own: str) -> Callable[[_T], _T]: ...
def checked(target: Any = None, *, own: str = "") -> Any:
    """Decorate a public function, method or class: a wrong argument is refused before anything runs.

    A wrong keyword raises `KeywordError` with a suggestion, an argument of another type `ParameterError`. Of a class,
    the constructor and the public methods of its own body are checked, except those marked `every_tick`. The contents
    of arrays are checked by the function itself.

    Args:
        target: The function or class.
        own: Names of arguments whose type the function, or constructor, checks itself before anything else: its words
            say more.
    """
    if target is None:
        return partial(checked, own=own)
    if not isinstance(target, type):
        return _checked(target, target.__name__, own=own)
    check_constructor(target, own)
    for name, member in list(vars(target).items()):
        call = getattr(member, "__func__", member)  # of a class method
        if isinstance(call, types.FunctionType) and not name.startswith("_") and not hasattr(call, "__wrapped__"):
            if not hasattr(call, "every_tick") and call.__code__.co_argcount + call.__code__.co_kwonlyargcount > 1:
                setattr(target, name, _checked(call, name) if call is member else type(member)(_checked(call, name)))
    return target


def check_constructor(cls: type, own: str = "") -> None:
    """Replace the constructor of a class's own body by one that checks its arguments; see `checked`."""
    method = "__new__" if issubclass(cls, tuple) else "__init__"
    call: Any = getattr(cls, method)
    if method in vars(cls) and not hasattr(call, "__wrapped__"):
        call.__module__ = cls.__module__  # a generated one has no names of the module
        late = isinstance(getattr(cls, "parameters", None), types.MethodType)  # parameters, each with its check
        rates = [name for name in sorted(_RATES) if isinstance(getattr(cls, name, None), _Rate)]
        setattr(cls, method, _checked(call, "", late=late, own=own, rates=rates))


class _Rate(property):
    """Sample rate [Hz] of an object with a sample period."""

    def __set_name__(self, owner: type, name: str) -> None:
        del owner.__annotations__[name]  # for type checkers a field, and for dataclasses none


def rate_of(period: str) -> Any:
    """Declare a sample rate that the constructor of a checked class accepts for a period: the attribute is 1 / period.

    Annotate it as a field, with which a type checker accepts it: `rate: float = rate_of("period")`.
    """
    return _Rate(lambda self: None if getattr(self, period) is None else 1.0 / getattr(self, period))


def every_tick(call: _T) -> _T:
    """Mark a method whose wrapper would take more than 2 % of a tick: it checks its arguments alone."""
    call.every_tick = True  # type: ignore[attr-defined]
    return call


def explained(call: _T) -> _T:
    """Decorate a function that runs on every tick: its arguments are checked only once a call has failed."""
    return _checked(call, call.__name__, late=True)  # type: ignore[attr-defined, no-any-return]


def _checked(call: Any, called: str, *, late: bool = False, own: str = "", rates: Sequence[str] = ()) -> Any:
    """Return a function that checks its arguments before the call; if `late`, only once the call has failed."""
    seen: dict[tuple[Any, ...], bool] = {}  # by keywords and classes of arguments: whether these suffice
    passed = frozenset(own.split())

    @wraps(call)
    def checked(*arguments: Any, **keywords: Any) -> Any:
        if rates and not keywords.keys().isdisjoint(rates):
            keywords = with_period(_names(call), keywords)
        if not late:
            kinds = (*map(type, arguments), *keywords, *map(type, keywords.values()))
            if not (certain := seen.get(kinds)):
                if certain is None:
                    seen[kinds] = _refuse(checked, called, arguments, keywords, passed)
                elif message := mismatch(checked, arguments, keywords, passed):
                    raise ParameterError(message)
        try:
            return call(*arguments, **keywords)
        except (TypeError, AttributeError, LookupError, ValueError) as error:
            if not isinstance(error, MaglevError):
                _refuse(checked, called, arguments, keywords, arrays=True)
            raise

    if rates:
        added = [Parameter(name, Parameter.KEYWORD_ONLY, default=None, annotation="float | None") for name in rates]
        checked.__signature__ = signature(call).replace(parameters=[*signature(call).parameters.values(), *added])  # type: ignore[attr-defined]
    checked.late, checked.own = late, passed  # type: ignore[attr-defined]
    return checked


def _refuse(
    call: Any,
    called: str,
    arguments: tuple[Any, ...],
    keywords: dict[str, Any],
    own: Container[str] = (),
    *,
    arrays: bool = False,
) -> bool:
    """Raise the error of the first wrong argument, without a call. Return True if checking their classes suffices."""
    names = _names(call)
    if not called:  # a constructor, perhaps of a subclass
        called = (arguments[0] if isinstance(arguments[0], type) else type(arguments[0])).__name__
    is_open = unwrap(call).__code__.co_flags & CO_VARKEYWORDS and "Unpack" not in str(call.__annotations__)
    if not is_open and (wrong := [name for name in keywords if name not in names]):
        also = "; set those of a scene first: find_scene('drop')(height=0.002)" if "scene" in names else ""
        raise KeywordError(choice_message(f"argument of {called}", names, wrong[0], also)) from None
    missed = ""
    try:
        signature(call).bind(*arguments, **keywords)
    except TypeError as error:
        missed = str(error)
    if message := mismatch(call, arguments, keywords, () if missed else own, arrays=arrays):
        raise ParameterError(message) from None
    if missed:
        raise KeywordError(f"arguments of {called} must be {', '.join(names)}: {missed}") from None
    return message is None


def with_period(names: Collection[str], keywords: Mapping[str, Any]) -> dict[str, Any]:
    """Return keywords with `rate` [Hz] replaced by `period` [s] if only the latter is among the accepted names.

    So is `device_rate` by `device_period`. None counts as not given.
    """
    changed = dict(keywords)
    for name in (_RATES & changed.keys()) - set(names):
        if (period := f"{name[:-4]}period") in names and (rate := changed.pop(name)) is not None:
            import numpy as np  # slow to load

            if changed.get(period) is not None:
                raise KeywordError(f"{period} and {name} must not both be given")
            refuse_mask(name, rate)
            if not _is_numeric(rate):
                raise ParameterError(f"{name} must be a number (got {one_line(rate)})")
            with np.errstate(divide="ignore"):
                changed[period] = (1.0 / np.asarray(rate, dtype=np.float64)).tolist()
    return changed


def mismatch(
    call: Any, arguments: tuple[Any, ...], keywords: dict[str, Any], own: Container[str] = (), *, arrays: bool = False
) -> str | None:
    """Return the message for the first argument that does not have its declared type; "" for none.

    None if the classes of the arguments suffice to exclude one.
    """
    positions, hints = _hints(call, arrays)
    certain = True
    for name, value in (*zip(positions, arguments), *keywords.items()):
        if (hasattr(value, "mask") or isinstance(value, list | tuple)) and is_masked(value):
            return f"{name} {NO_MASK} (got {one_line(value)})"
        if name in hints and name not in own:
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
            if arrays and vars(type(value)).keys() >= {"__slots__", "__dataclass_fields__"}:  # a sample, a command
                fields = {key: getattr(value, key) for key in type(value).__dataclass_fields__}
                if message := mismatch(type(value).__init__, (), fields, arrays=True):
                    return f"{name} {message}"
        certain &= not hasattr(value, "mask")  # an array of this class may have masked values next time
    return None if certain else ""


@cache
def _hints(
    call: Any, arrays: bool
) -> tuple[tuple[str, ...], dict[str, tuple[str, Any, set[type], Callable[[Any], bool]]]]:
    """Return names of positional parameters, and the type of each annotated one with the classes that need no check."""
    function = unwrap(call)
    code, hints, module = function.__code__, {}, sys.modules.get(function.__module__)
    space = vars(module) if module else function.__globals__
    others = ChainMap(*(vars(sys.modules[kind.__module__]) for kind in _packed(function)))
    for name, declared in _names(function).items():
        note = getattr(declared, "__forward_arg__", declared)
        with suppress(NameError, TypeError):  # without a type, or one that cannot be checked here
            hint = eval(note, space, others)
            if re.search("Array|Mask|Six|Component", note):
                if not arrays:
                    continue
                hint = hint if note == "Array" else _Numeric | None if "None" in note else _Numeric
            if hint in (Any, object):
                continue
            hints[name] = note, hint, _classes(hint), _test(hint)
    return code.co_varnames[: code.co_argcount], hints


def _classes(hint: Any) -> set[type]:
    """Return classes whose objects are of a type for certain."""
    parts = get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,)
    return {part for part in parts if isinstance(part, type)} | ({int} if float in parts else set())


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
        return partial(_holds, kind, _classes(parts[0]), _test(parts[0]))
    return lambda value: isinstance(value, kind)


def _is_scalar(kind: type, value: Any) -> bool:
    if getattr(value, "shape", None) == ():
        value = value.item()  # of NumPy
    if kind in (bool, str):
        return isinstance(value, kind)
    if getattr(value, "shape", None):
        return _is_numeric(value)  # values of many devices: the call's own check says if it takes them
    return isinstance(value, Real) and not isinstance(value, bool) and (kind is float or value % 1 == 0)


def _holds(kind: type, usual: set[type], test: Callable[[Any], bool], value: Any) -> bool:
    """Return True for a collection; in a list or tuple one element of each class that is not usual is tested."""
    items = dict(zip(map(type, value), value)) if isinstance(value, (list, tuple, str)) else {}
    return isinstance(value, kind) and all(map(test, map(items.__getitem__, items.keys() - usual)))


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
    named = [one.name for one in signature(call).parameters.values() if one.kind is not one.VAR_POSITIONAL]
    notes = {name: call.__annotations__.get(name) for name in named if name not in ("self", "cls", "_cls")}
    plain = {name: note for name, note in notes.items() if not str(note).startswith("Unpack[")}
    return plain | dict(ChainMap(*(kind.__annotations__ for kind in _packed(call))))


def _packed(call: Any) -> list[Any]:
    """Return the TypedDicts that a function unpacks."""
    matches = [re.fullmatch(r"Unpack\[(\w+)\]", str(note)) for note in call.__annotations__.values()]
    return [unwrap(call).__globals__[match[1]] for match in matches if match]
