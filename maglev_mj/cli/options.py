"""Options shared by the commands, with one-line errors."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from maglev_mj.cli.arguments import Container, Parser, offer
from maglev_mj.cli.pictures import add_pictures
from maglev_mj.errors import ParameterError
from maglev_mj.frames import unit_of
from maglev_mj.parameters import Parameter, Parameters

P = TypeVar("P", bound=Parameters)

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


def add_json(parser: Parser, what: str = "the figures") -> None:
    """Add --json."""
    told = f"write {what} as JSON; - for standard output"
    parser.group("output").add_argument("--json", metavar="FILE", help=told)


def add_outputs(
    parser: Parser,
    json: str = "parameters, motion and figures",
    out: str = "write pictures to this folder",
) -> None:
    """Add --json, --out and --format.

    Args:
        parser: Parser of the command.
        json: Contents of the JSON, for its help.
        out: Help of --out.
    """
    add_json(parser, json)
    add_pictures(parser, out)


def add_recording(parser: Parser) -> None:
    """Add --record, for a recording."""
    parser.group("output").add_argument(
        "--record", metavar="FILE", type=Path, help="write a recording, .mcap or .npz, for `maglev-mj replay`"
    )


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


def add_calibration(parser: Parser) -> None:
    """Add --calibration."""
    told = "what is known of the device (default: the model)"
    parser.group("device").add_argument("--calibration", metavar="FILE", type=Path, help=told)


def add_key(parser: Parser) -> None:
    """Add --key."""
    told = "secret of 16 to 32 bytes as hexadecimal digits, for more than this machine"
    parser.group("device").add_argument("--key", metavar="FILE", type=Path, help=told)


def add_bridge(parser: Parser) -> None:
    """Add the options of both ends of a link."""
    add_calibration(parser)
    add_key(parser)
    group = parser.group("run")
    group.add_argument("--seconds", type=number_option, metavar="X", help="end after so long [s]")
    group.add_argument(
        "--realtime",
        default="ignore",
        choices=("enforce", "ignore"),
        help="what to do where the system refuses real-time scheduling (default ignore)",
    )


def chosen_key(path: Path | None, name: str = "key") -> bytes | None:
    """Return the key in a file; None without one.

    Args:
        path: The file.
        name: Name of the option.

    Raises:
        ParameterError: If the file holds no valid key.
    """
    if path is None:
        return None
    try:
        key = bytes.fromhex(path.read_text(encoding="ascii"))
    except (OSError, ValueError):
        key = b""
    from maglev_mj.bridge.wire import LEAST_KEY, MOST_KEY

    if not LEAST_KEY <= len(key) <= MOST_KEY:
        digits = f"{2 * LEAST_KEY} to {2 * MOST_KEY} hexadecimal digits"
        raise ParameterError(f"{name} must be a file of {digits}, not {str(path)!r}")
    return key
