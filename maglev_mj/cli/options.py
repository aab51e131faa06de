"""Options that declared parameters give."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

from maglev_mj.cli.arguments import Container, beside_inverse, count, number_option, offer
from maglev_mj.cli.declare import Shared
from maglev_mj.errors import ParameterError

if TYPE_CHECKING:
    from maglev_mj.parameters import Parameter, Parameters

P = TypeVar("P", bound="Parameters")

_APART = "parameter "
_DECLARED = "parameter"
"""Attribute of an option that holds its declaration."""


def add_parameters(
    parser: Container, parameters: Parameters | type[Parameters], prefix: str = "", /, *, without: Sequence[str] = ()
) -> None:
    """Add an option for each declared parameter.

    Its help has unit and default.

    A value that only a `parse` knows gets none, nor does one with an option of the command itself. Given values
    are kept apart from the command's own options: see `chosen`.

    Args:
        parser: Parser of the command.
        parameters: Class, or parameters with the default values.
        prefix: Prefix of each option's name, for a command with options of several classes.
        without: Names of parameters without option.
    """
    made = parameters() if isinstance(parameters, type) else parameters
    names = [one.name for one in made.parameters()]
    for one in made.parameters():
        option = f"--{prefix}{one.name.replace('_', '-')}"
        if one.kind is not object and one.name not in without and option not in parser._option_string_actions:
            inverse = one.name == "period" and "rate" not in names
            into = beside_inverse(parser, f"--{prefix}rate", _APART + prefix + one.name) if inverse else parser
            _add_parameter(into, option, one, getattr(made, one.name), prefix)


def _add_parameter(parser: Container, option: str, one: Parameter, default: Any, prefix: str) -> None:
    said = described(one, default).replace("%", "%%")
    kept: dict[str, Any] = {"dest": _APART + prefix + one.name, "default": argparse.SUPPRESS, "help": said}
    if one.kind is bool:
        made = parser.add_argument(option, action=argparse.BooleanOptionalAction, **kept)
        setattr(made, _DECLARED, one)
        return
    kinds: Mapping[type, tuple[Callable[[str], Any], str]] = {
        float: (number_option, "X"),
        int: (count, "N"),
        str: (str, "NAME"),
    }
    read, metavar = kinds[one.kind]
    if one.optional:
        read = partial(_or_none, read)
    made = parser.add_argument(option, type=read, metavar=metavar, **kept)
    offer(made, one.choices)
    setattr(made, _DECLARED, one)


def described(one: Parameter, default: Any) -> str:
    """Return a parameter's description with unit, choices and default."""
    from maglev_mj.frames import unit_of  # with arrays, which a help of other options does not need

    text, more, rest = one.help.partition(";")
    unit = " or ".join(dict.fromkeys(unit_of(one.unit, axis, one.along) for axis in ("x", "rx")))
    said = f"{text} [{unit}]{more}{rest}" if unit else text + more + rest
    if one.choices:
        said += f": {', '.join(one.choices)}"
    if one.kind is bool:
        return f"{said} (default {'on' if default else 'off'})"
    return f"{said} (default {'none' if default is None else default if one.kind is str else f'{default:g}'})"


def _or_none(read: Callable[[str], Any], text: str) -> Any:
    return None if text.lower() == "none" else read(text)


def chosen(options: argparse.Namespace, parameters: P | type[P], prefix: str = "", /, **further: Any) -> P:
    """Return parameters with the values chosen by options.

    Args:
        options: Parsed options.
        parameters: Class, or parameters with the values used without a choice.
        prefix: Prefix given to `add_parameters`.
        further: Values of other options.

    Raises:
        ParameterError: If a value is outside its bounds.
    """
    made = parameters() if isinstance(parameters, type) else parameters
    given = {one.name: f"{_APART}{prefix}{one.name}" for one in made.parameters()}
    found = {name: getattr(options, place) for name, place in given.items() if hasattr(options, place)}
    try:
        return made.replace(**found, **further)
    except ParameterError as error:
        raise ParameterError(f"{prefix}{error}") from None


def given(options: argparse.Namespace, parameters: type[Parameters]) -> set[str]:
    """Return the names of parameters with a given option."""
    return {one.name for one in parameters.parameters() if hasattr(options, _APART + one.name)}


def range_of(name: str, words: Sequence[str] | None) -> tuple[float, float] | None:
    """Return a range from one or two words; None without.

    Raises:
        ParameterError: If they are not numbers.
    """
    if words is None:
        return None
    parts = words[0].split(":") if len(words) == 1 else words
    try:
        values = [float(part) for part in parts]
    except ValueError:
        values = []
    if not 1 <= len(values) <= 2:
        raise ParameterError(f"{name} must be LOW HIGH, LOW:HIGH, or one value, not {' '.join(words)!r}")
    return values[0], values[-1]


def parameters(declared: Parameters | type[Parameters], group: str, prefix: str = "") -> Shared:
    """Declare the options of parameters as one value; see `add_parameters` and `chosen`."""
    return Shared(
        lambda parser: add_parameters(parser.group(group), declared, prefix),
        lambda options: chosen(options, declared, prefix),
    )
