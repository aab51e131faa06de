"""Commands declared by the signatures of their functions.

A parameter of a command is `Annotated[kind, option(...)]`, a dataclass of such fields, or `Annotated[kind, Shared(add,
take)]` for options that depend on others. The docstring is the help; what it returns is the note at the end.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from functools import cache, partial
from inspect import Parameter, Signature, getdoc, signature
from pathlib import Path
from types import NoneType
from typing import Any, Literal, NamedTuple, TypeVar, get_args, get_origin

from maglev_mj.cli.arguments import Container, Parser, beside_inverse, count, number_option

_KINDS: Mapping[type, tuple[Callable[[str], Any], str | None]] = {
    float: (number_option, "X"),
    int: (count, "N"),
    Path: (Path, "FILE"),
    str: (str, None),
}

T = TypeVar("T")
Take = Callable[[argparse.Namespace], Any]


class Option(NamedTuple):
    """Option of a command; see `option`."""

    help: str
    group: str
    metavar: str | None
    name: str
    kind: Any
    take: Take | None
    inverse: str
    const: object
    bounds: Mapping[str, float]


class Shared(NamedTuple):
    """Options that depend on others.

    Attributes:
        add: Function that adds them to a parser; None if another option adds them.
        take: Function that returns their value.
    """

    add: Callable[[Parser], object] | None
    take: Take


def option(
    help: str,
    group: str = "run",
    metavar: str | None = None,
    *,
    name: str = "",
    kind: Any = None,
    take: Take | None = None,
    inverse: str = "",
    const: object = None,
    **bounds: float,
) -> Option:
    """Declare an option; an argument if it has no group.

    Args:
        help: What it is. A default is added, except of flags and lists.
        group: Title of its group in the help.
        metavar: Word for its value.
        name: Its name, where that is not the parameter's.
        kind: Type of its word, or function that reads it, where that is not the parameter's.
        take: Function that returns the parameter's value.
        inverse: Name of an option that gives its inverse.
        const: Value of the option without a word; None if it needs one.
        bounds: Bounds of its number, as `number` has them.
    """
    return Option(help, group, metavar, name, kind, take, inverse, const, bounds)


def declare(function: Callable[..., int], parser: Parser) -> None:
    """Add the options of a command's function, which runs with their values.

    An option that the parser has already is not added again.
    """
    describe(function, parser)
    arguments = _arguments(function, parser)
    parser.set_defaults(run=lambda options: function(**arguments(options)))


def declared(kind: Callable[..., T], parser: Parser) -> Callable[[argparse.Namespace], T]:
    """Add the options of a dataclass; return a function that takes one from parsed options."""
    arguments = _arguments(kind, parser)
    return lambda options: kind(**arguments(options))


@cache
def _signature(owner: Callable[..., object]) -> Signature:
    return signature(owner, eval_str=True)


def _arguments(owner: Callable[..., object], parser: Parser) -> Callable[[argparse.Namespace], dict[str, Any]]:
    """Add an option for each argument of a function; return a function that takes their values."""
    takes: dict[str, Take] = {}
    for name, one in _signature(owner).parameters.items():
        kind, about = get_args(one.annotation) or (one.annotation, None)
        if isinstance(about, Option):
            _add(parser, name, kind, about, one.default)
            takes[name] = about.take or partial(_value, name, about)
        elif isinstance(about, Shared):
            if about.add is not None:
                about.add(parser)
            takes[name] = about.take
        else:
            takes[name] = declared(kind, parser)
    return lambda options: {name: take(options) for name, take in takes.items()}


def describe(function: Callable[..., object], parser: Parser) -> None:
    """Set a parser's help to a function's docstring."""
    description, _, status = str(getdoc(function)).partition("\n\nReturns:\n")
    parser.description = " ".join(description.split())
    parser.epilog = " ".join(status.split()) or None


def _add(parser: Parser, name: str, kind: Any, about: Option, default: Any) -> None:
    flag = f"--{(about.name or name).replace('_', '-')}"
    if flag in parser.declared:
        return
    parser.declared.add(flag)
    into: Container = parser.group(about.group) if about.group else parser
    settings: dict[str, Any] = {"help": about.help}
    if about.group:
        settings |= {"dest": name, "default": None if default is Parameter.empty else default}
        settings["required"] = default is Parameter.empty and about.take is None and get_origin(kind) is not list
    if kind is bool:
        into.add_argument(flag, action=argparse.BooleanOptionalAction if default else "store_true", **settings)
        return
    if get_origin(kind) is list:
        settings |= {"action": "append", "default": []}
    elif default not in (None, Parameter.empty):
        settings["help"] += f" (default {default:g})" if isinstance(default, float) else f" (default {default})"
    if about.inverse:
        into = beside_inverse(into, f"--{about.inverse}", name)
    into.add_argument(flag if about.group else name, **_reading(kind, about), **settings)


def _reading(kind: Any, about: Option) -> dict[str, Any]:
    """Return how a word becomes an option's value."""
    if get_origin(kind) is Literal:
        return {"choices": get_args(kind), "metavar": about.metavar}
    kinds = [about.kind] if about.kind is not None else [*get_args(kind), kind]
    kind = next(part for part in kinds if part is not NoneType)
    read, metavar = _KINDS.get(kind, (kind, None))
    optional = {} if about.const is None else {"nargs": "?", "const": about.const}
    return {"type": read, "metavar": about.metavar or metavar, **optional}


def _value(name: str, about: Option, options: argparse.Namespace) -> Any:
    value = getattr(options, name)
    if about.bounds and value is not None:
        from maglev_mj.parameters import number  # with arrays, which a help does not need

        number(about.name or name, value, **about.bounds)
    return value
