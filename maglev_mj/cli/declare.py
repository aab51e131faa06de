"""Commands declared by the signatures of their functions, on parsers with one-line errors."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, partial
from inspect import Parameter, Signature, getdoc, signature
from pathlib import Path
from shutil import get_terminal_size
from types import NoneType
from typing import Any, Literal, NamedTuple, TypeAlias, TypeVar, get_args, get_origin

from maglev_mj.errors import meant, not_one_of
from maglev_mj.terminal import WIDTH

Container: TypeAlias = argparse._ActionsContainer
"""A parser, or a group of its options."""

_MARGIN = 2


class _Formatter(argparse.HelpFormatter):
    """Formatter of help texts that names each option once.

    Lines that begin with a space stay as they are.
    """

    def __init__(self, prog: str) -> None:
        super().__init__(prog, width=min(get_terminal_size().columns, WIDTH) - _MARGIN)

    def add_usage(self, usage: str | None, actions: Iterable[argparse.Action], *rest: Any, **named: Any) -> None:
        """Add the required arguments; options are listed below."""
        actions = list(actions)
        needed = [one for one in actions if one.required or not one.option_strings]
        words = [" ".join(filter(None, (*one.option_strings[:1], self._format_args(one, one.dest)))) for one in needed]
        options = ["[options]"] if len(needed) < len(actions) else []
        super().add_usage(" ".join(["%(prog)s", *options, *words]), actions, *rest, **named)

    def _expand_help(self, action: argparse.Action) -> str:
        return super()._expand_help(action) if not hasattr(action, "compose") else help_of(action)

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        paragraphs = re.split(r"\n(?=[ \n])|(?<=\n)(?=\S)", text)
        fill = super()._fill_text
        return "\n".join(one if one[:1] in ("", " ") else fill(one, width, indent) for one in paragraphs)


class Parser(argparse.ArgumentParser):
    """Argument parser with one-line error messages.

    Attributes:
        example: Example command line at the end of the help; empty for none.
        words: Arguments that it will parse, for options that depend on them.
        declared: Flags of the options of a command's function.
        later: Functions that add options which depend on the words: `declare` calls them once the command's own options
            are there.
    """

    def __init__(self, *, example: str = "", words: Sequence[str] = (), **keywords: Any) -> None:
        # the options of a scene are its own: a shorter word must not become one that is added later
        super().__init__(**{"allow_abbrev": False, "formatter_class": _Formatter, **keywords})
        self.example, self.words, self.declared = example, words, set[str]()
        self.later = list[Callable[[], object]]()

    def group(self, title: str) -> argparse._ArgumentGroup:
        """Return the option group of a title.

        The help lists groups in the order of the first calls.
        """
        found = (group for group in self._action_groups if group.title == title)
        return next(found, None) or self.add_argument_group(title)

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse the arguments; an unknown one is an error. See `argparse.ArgumentParser`."""
        options, unknown = self.parse_known_args(args, namespace)
        self.refuse(unknown)
        return options

    def refuse(self, unknown: Sequence[str]) -> None:
        """Exit with an error that names unknown arguments, if there are any."""
        if unknown:
            options = [word.partition("=")[0] for word in unknown if word.startswith("--")]
            near = (text for word in options if (text := meant(word, self._option_string_actions)))
            other = "; parameters are given by --set and --vary" if "--set" in self._option_string_actions else ""
            self.error(f"unrecognized arguments: {' '.join(unknown)}{other}{next(near, '')}")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            name = action.option_strings[0] if action.option_strings else action.dest
            raise argparse.ArgumentError(None, not_one_of(name, action.choices, value))

    def format_help(self) -> str:
        """Return the help: required arguments, option groups, example.

        The options of every command come last among the groups.
        """
        self._action_groups.sort(key=lambda group: group is self._optionals)
        return super().format_help() + (f"\nExample:\n  {self.example}\n" if self.example else "")

    def error(self, message: str) -> Any:
        """Print one line and exit with status 2."""
        self.exit(2, f"{self.prog}: {message}\n")


def help_of(action: argparse.Action) -> str:
    """Return the help of an option, which may be composed when it is asked for."""
    compose: Callable[[], str] | None = getattr(action, "compose", None)
    return (action.help or "").replace("%%", "%") if compose is None else compose()


def joined(arguments: Sequence[str]) -> list[str]:
    """Join an option and a negative number after it.

    argparse takes -1e-3, -5:3 and -inf for options.

    Numbers that argparse knows stay as they are, so that an option of several values gets them all.
    """
    result: list[str] = []
    for argument in arguments:
        odd = re.match(r"-(\.?\d|inf|nan)", argument) and not re.fullmatch(r"-\d+|-\d*\.\d+", argument)
        if odd and result and result[-1].startswith("--") and "=" not in result[-1]:
            result[-1] += f"={argument}"
        else:
            result.append(argument)
    return result


def number_option(text: str) -> float:
    """Return an option's number."""
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be a number, not {text!r}") from None


def count(text: str) -> int:
    """Return an option's whole number."""
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be a whole number, not {text!r}") from None


def beside_inverse(parser: Container, option: str, dest: str) -> Container:
    """Add an unlisted option that gives another's inverse, and return where to add the other.

    A rate [Hz] is understood wherever a period [s] is, and a period wherever a rate is; not both at once.

    Args:
        parser: Parser of the command.
        option: Name of the option.
        dest: Attribute of the other option.
    """
    either = parser.add_mutually_exclusive_group()
    either.add_argument(option, type=_inverse, dest=dest, default=argparse.SUPPRESS, help=argparse.SUPPRESS)
    return either


def _inverse(text: str) -> float:
    value = number_option(text)
    if not (value > 0.0 and math.isfinite(value)):
        raise argparse.ArgumentTypeError(f"must be a finite number above 0, not {text!r}")
    return 1.0 / value


KINDS: Mapping[type, tuple[Callable[[str], Any], str | None]] = {
    float: (number_option, "X"),
    int: (count, "N"),
    Path: (Path, "FILE"),
    str: (str, None),
}
"""Function that reads a word, and the word's name in the help, by type."""

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
    default: Callable[[], Any] | None
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
    default: Callable[[], Any] | None = None,
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
        default: Function that returns its default, where that is in a library of the command.
        bounds: Bounds of its number, as `number` has them.
    """
    return Option(help, group, metavar, name, kind, take, inverse, const, default, bounds)


def declare(function: Callable[..., int], parser: Parser) -> None:
    """Add the options of a command's function, which runs with their values.

    An option that the parser has already is not added again.
    """
    describe(function, parser)
    arguments = _arguments(function, parser)
    parser.set_defaults(run=lambda options: function(**arguments(options)))
    while parser.later:
        parser.later.pop()()


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
    default = default if about.default is None else about.default()
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
    read, metavar = KINDS.get(kind, (kind, None))
    optional = {} if about.const is None else {"nargs": "?", "const": about.const}
    return {"type": read, "metavar": about.metavar or metavar, **optional}


def _value(name: str, about: Option, options: argparse.Namespace) -> Any:
    value = getattr(options, name)
    if about.bounds and value is not None:
        from maglev_mj.parameters import number  # with arrays, which a help does not need

        number(about.name or name, value, **about.bounds)
    return value
