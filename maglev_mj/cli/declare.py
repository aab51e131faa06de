"""Declaration of commands by the signatures of their functions, and parsers with one-line errors."""

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

from maglev_mj.errors import choice_message, meant
from maglev_mj.terminal import WIDTH, wrapped

Container: TypeAlias = argparse._ActionsContainer
"""A parser, or a group of its options."""

_MARGIN = 2


class _Formatter(argparse.HelpFormatter):
    """Help formatter with one metavar per option; lines that start with a space are not wrapped."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, width=min(get_terminal_size().columns, WIDTH) - _MARGIN)

    def add_usage(self, usage: str | None, actions: Iterable[argparse.Action], *rest: Any, **named: Any) -> None:
        """Add a usage line with the required arguments only."""
        actions = list(actions)
        required = [item for item in actions if item.required or not item.option_strings]
        words = [" ".join(filter(None, (*x.option_strings[:1], self._format_args(x, x.dest)))) for x in required]
        options = ["[options]"] if len(required) < len(actions) else []
        super().add_usage(" ".join(["%(prog)s", *options, *words]), actions, *rest, **named)

    def _expand_help(self, action: argparse.Action) -> str:
        return super()._expand_help(action) if not hasattr(action, "compose") else help_of(action)

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        paragraphs = re.split(r"\n(?=[ \n])|(?<=\n)(?=\S)", text)
        fill = super()._fill_text
        return "\n".join(text if text[:1] in ("", " ") else fill(text, width, indent) for text in paragraphs)


class Parser(argparse.ArgumentParser):
    """Argument parser with one-line error messages.

    Attributes:
        example: Example command line at the end of the help; empty for none.
        words: Arguments to be parsed, for options that depend on them.
        declared: Flags declared by the command's function.
        later: Functions that add options which depend on the words; `declare` calls them after the command's options.
        yielding: Options of the command that give way to those of a scene; see `give_way`.
    """

    def __init__(self, *, example: str = "", words: Sequence[str] = (), **keywords: Any) -> None:
        # no abbreviations: one could match a scene's option that is added later
        super().__init__(**{"allow_abbrev": False, "formatter_class": _Formatter, **keywords})
        self.example, self.words, self.declared = example, words, set[str]()
        self.later = list[Callable[[], object]]()
        self.yielding = list[Any]()

    def group(self, title: str) -> argparse._ArgumentGroup:
        """Return the option group with this title, created at the first call."""
        for group in self._action_groups:
            if group.title == title:
                return group
        return self.add_argument_group(title)

    def give_way(self, options: Iterable[str]) -> None:
        """Remove optional options of this command that a user's scene names its parameters by; they are None then."""
        for option in options:
            action: Any = self._option_string_actions.get(option)
            if action in self.yielding:
                self._option_string_actions.pop(option)
                action.container._remove_action(action)
                self.set_defaults(**{action.dest: None})

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse the arguments; unknown ones are an error. See `argparse.ArgumentParser`."""
        options, unknown = self.parse_known_args(args, namespace)
        self.refuse(unknown)
        return options

    def refuse(self, unknown: Sequence[str]) -> None:
        """Exit with an error if there are unknown arguments."""
        if unknown:
            options = [word.partition("=")[0] for word in unknown if word.startswith("--")]
            near = (text for word in options if (text := meant(word, self._option_string_actions)))
            hint = "; set parameters by --set and --vary" if "--set" in self._option_string_actions else ""
            self.error(f"unrecognized arguments: {' '.join(unknown)}{hint}{next(near, '')}")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            name = action.option_strings[0] if action.option_strings else action.dest
            raise argparse.ArgumentError(None, choice_message(name, action.choices, value))

    def format_help(self) -> str:
        """Return the help: arguments, option groups (general options last), example."""
        self._action_groups.sort(key=lambda group: group is self._optionals)
        return super().format_help() + (f"\nExample:\n  {self.example}\n" if self.example else "")

    def error(self, message: str) -> Any:
        """Print a one-line error and exit with status 2."""
        self.exit(2, f"{self.prog}: {message}\n")


def help_of(action: argparse.Action) -> str:
    """Return the help of an option; it may be composed lazily."""
    compose: Callable[[], str] | None = getattr(action, "compose", None)
    return (action.help or "").replace("%%", "%") if compose is None else compose()


def joined(arguments: Sequence[str]) -> list[str]:
    """Join an option with a negative number after it that argparse would take for an option: -1e-3, -5:3, -inf.

    Plain negative numbers stay separate, for options with several values.
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
    """Parse a number."""
    try:
        return float(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be a number (got {text!r})") from None


def count(text: str) -> int:
    """Parse an integer."""
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be an integer (got {text!r})") from None


def beside_inverse(parser: Container, option: str, dest: str) -> Container:
    """Add a hidden option for the inverse of another (rate [Hz], period [s]); return the group for the other.

    The two options are mutually exclusive.

    Args:
        parser: Parser of the command.
        option: Name of the hidden option.
        dest: Attribute of the other option.
    """
    either = parser.add_mutually_exclusive_group()
    either.add_argument(option, type=_inverse, dest=dest, default=argparse.SUPPRESS, help=argparse.SUPPRESS)
    return either


def _inverse(text: str) -> float:
    value = number_option(text)
    if not (value > 0.0 and math.isfinite(value)):
        raise argparse.ArgumentTypeError(f"must be a finite number above 0 (got {text!r})")
    return 1.0 / value


KINDS: Mapping[type, tuple[Callable[[str], Any], str | None]] = {
    float: (number_option, "X"),
    int: (count, "N"),
    Path: (Path, "FILE"),
    str: (str, None),
}
"""Parsing function and metavar by type."""

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
    several: bool
    meanings: Mapping[str, str]
    bounds: Mapping[str, float]


class Shared(NamedTuple):
    """Options shared by several commands.

    Attributes:
        add: Function that adds them to a parser; None if another declaration adds them.
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
    several: bool = False,
    meanings: Mapping[str, str] = {},
    **bounds: float,
) -> Option:
    """Declare an option; a positional argument if the group is empty.

    Args:
        help: Description; the default is appended, except for flags and lists.
        group: Title of its group in the help.
        metavar: Placeholder for the value.
        name: Name, if it differs from the parameter's.
        kind: Type or parsing function, if it differs from the parameter's type.
        take: Function that returns the parameter's value.
        inverse: Name of a hidden option for the inverse.
        const: Value of the option without an argument; None if it requires one.
        default: Function that returns the default, if that needs a slow import.
        several: True for a list of which each use of the option takes one or more.
        meanings: Meaning of each value, listed at the end of the help; those of a text are its choices.
        bounds: Bounds of a number; see `number`.
    """
    return Option(help, group, metavar, name, kind, take, inverse, const, default, several, meanings, bounds)


def declare(function: Callable[..., int], parser: Parser) -> None:
    """Add the options of a command's function, except those already added, and set it as `run`."""
    describe(function, parser)
    arguments = _arguments(function, parser)
    parser.set_defaults(run=lambda options: function(**arguments(options)))
    while parser.later:
        parser.later.pop()()


def declared(kind: Callable[..., T], parser: Parser) -> Callable[[argparse.Namespace], T]:
    """Add the options of a dataclass; return a function that builds it from parsed options."""
    arguments = _arguments(kind, parser)
    return lambda options: kind(**arguments(options))


@cache
def _signature(owner: Callable[..., object]) -> Signature:
    return signature(owner, eval_str=True)


def _arguments(owner: Callable[..., object], parser: Parser) -> Callable[[argparse.Namespace], dict[str, Any]]:
    """Add an option for each argument of a function; return a function that collects their values."""
    takes: dict[str, Take] = {}
    for name, argument in _signature(owner).parameters.items():
        kind, about = get_args(argument.annotation) or (argument.annotation, None)
        if isinstance(about, Option):
            _add(parser, name, kind, about, argument.default)
            takes[name] = about.take or partial(_value, name, about)
        elif isinstance(about, Shared):
            if about.add is not None:
                about.add(parser)
            takes[name] = about.take
        else:
            takes[name] = declared(kind, parser)
    return lambda options: {name: take(options) for name, take in takes.items()}


def describe(function: Callable[..., object], parser: Parser) -> None:
    """Set a parser's description and epilog from a function's docstring."""
    description, _, status = str(getdoc(function)).partition("\n\nReturns:\n")
    parser.description = " ".join(description.split())
    parser.epilog = " ".join(status.split()) or None


def listed(title: str, texts: Mapping[str, str]) -> str:
    """Return names with their texts as a list under a title, for the end of the help."""
    width = max(map(len, texts)) + 2
    lines = [line for name, text in texts.items() for line in wrapped(text, f"  {name:<{width}}", " " * (width + 2))]
    return "\n".join([f"{title}:", *lines])


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
    elif default is not Parameter.empty:
        settings |= {"nargs": "?", "default": default}
    if about.meanings:
        values = listed(f"values of {flag if about.group else about.metavar}", about.meanings)
        parser.epilog = f"{parser.epilog}\n{values}" if parser.epilog else values
    if kind is bool:
        into.add_argument(flag, action=argparse.BooleanOptionalAction if default else "store_true", **settings)
        return
    if get_origin(kind) is list:
        settings |= {"action": "append", "default": []}
        settings |= {"action": "extend", "nargs": "+"} if about.several else {}
    elif default not in (None, Parameter.empty):
        settings["help"] += f" (default {default:g})" if isinstance(default, float) else f" (default {default})"
    if about.inverse:
        into = beside_inverse(into, f"--{about.inverse}", name)
    into.add_argument(flag if about.group else name, **_reading(kind, about), **settings)


def _reading(kind: Any, about: Option) -> dict[str, Any]:
    """Return the argparse settings that parse an option's value."""
    for part in (kind, *get_args(kind)):  # also of one that may be None
        if get_origin(part) is Literal:
            return {"choices": get_args(part), "metavar": about.metavar}
    if kind is str and about.meanings:
        return {"choices": tuple(about.meanings), "metavar": about.metavar}
    kinds = [about.kind] if about.kind is not None else [*get_args(kind), kind]
    kind = next(part for part in kinds if part is not NoneType)
    read, metavar = KINDS.get(kind, (kind, None))
    optional = {} if about.const is None else {"nargs": "?", "const": about.const}
    return {"type": read, "metavar": about.metavar or metavar, **optional}


def _value(name: str, about: Option, options: argparse.Namespace) -> Any:
    value = getattr(options, name)
    if about.bounds and value is not None:
        from maglev_mj.parameters import number  # imported here: --help does not need NumPy

        bounds: Any = about.bounds
        unit = re.search(r"\[([^]]+)\]", about.help)
        number(about.name or name, value, **bounds, unit=unit[1] if unit else "")
    return value
