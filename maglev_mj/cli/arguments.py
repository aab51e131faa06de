"""Command-line parsers: option groups, examples, one-line errors.

All within 80 columns.
"""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Callable, Iterable, Sequence
from shutil import get_terminal_size
from typing import Any, TypeAlias

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

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        paragraphs = re.split(r"\n(?=[ \n])|(?<=\n)(?=\S)", text)
        fill = super()._fill_text
        return "\n".join(one if one[:1] in ("", " ") else fill(one, width, indent) for one in paragraphs)


class Parser(argparse.ArgumentParser):
    """Argument parser with one-line error messages.

    Attributes:
        example: Example command line at the end of the help; empty for none.
        declared: Flags of the options of a command's function.
    """

    def __init__(self, *, example: str = "", **keywords: Any) -> None:
        # the options of a scene are its own: a shorter word must not become one that is added later
        super().__init__(**{"allow_abbrev": False, "formatter_class": _Formatter, **keywords})
        self.example, self.declared = example, set[str]()

    before: Callable[[Sequence[str]], None] | None = None
    """Hook called once with the arguments before parsing.

    For options that depend on another.
    """

    def prepare(self, arguments: Sequence[str]) -> None:
        """Add the options that depend on the arguments."""
        while (before := self.before) is not None:
            self.before = None  # it may leave another
            before(arguments)

    def group(self, title: str) -> argparse._ArgumentGroup:
        """Return the option group of a title.

        The help lists groups in the order of the first calls.
        """
        found = (group for group in self._action_groups if group.title == title)
        return next(found, None) or self.add_argument_group(title)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse the arguments; an unknown one is an error.

        The error is raised in the command of the argument. See `argparse.ArgumentParser`.
        """
        self.prepare(args or ())
        found, unknown = super().parse_known_args(args, namespace)
        if unknown:
            options = [word.partition("=")[0] for word in unknown if word.startswith("--")]
            near = (text for word in options if (text := meant(word, self._option_string_actions)))
            other = "; parameters are given by --set and --vary" if "--set" in self._option_string_actions else ""
            self.error(f"unrecognized arguments: {' '.join(unknown)}{next(near, other)}")
        return found, unknown

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


def offer(action: argparse.Action, values: Iterable[str]) -> None:
    """Set an option's values for shell completion.

    Others stay allowed.
    """
    setattr(action, "offered", list(values))  # noqa: B010


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
