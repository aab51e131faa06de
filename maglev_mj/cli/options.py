"""Command-line options: what the commands share, each complaint one line."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from maglev_mj.errors import ParameterError
from maglev_mj.net.authentication import LEAST_KEY, MOST_KEY
from maglev_mj.scenes import BUILT_IN, Scene, find_scene, scene_names
from maglev_mj.workers import Workers, dask_workers, local_workers

__all__ = [
    "Parser",
    "add_bridge",
    "add_options",
    "add_outputs",
    "add_recording",
    "add_scene",
    "add_workers",
    "chosen_key",
    "chosen_scene",
    "chosen_workers",
    "count",
    "joined",
    "number_option",
    "range_of",
]


_SCENE = "joystick"


class Parser(argparse.ArgumentParser):
    """An argument parser whose complaint is one line.

    Attributes:
        without: Parameters of a scene that are no options; None where no scene is asked for.
    """

    without: Sequence[str] | None = None

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse arguments; those of a command with a scene are the scene's too, whichever it is."""
        if self.without is not None:
            self.set_defaults(parameters={})
            self.allow_abbrev = False
            try:
                _add_parameters(self, find_scene(self._named(args or [])), self.without)
            except ParameterError as error:
                return argparse.Namespace(run=partial(_refuse, error)), []
        return super().parse_known_args(args, namespace)

    def _named(self, words: Sequence[str]) -> str:
        """Return the scene that is named among words, or the one by default."""
        before = ""
        for word in words:
            option = self._option_string_actions.get(before)
            is_value = before != "--scene" and option is not None and option.nargs is None
            name, before = word.removeprefix("--scene="), word
            if is_value:
                continue
            if name in BUILT_IN or re.search(r"\.py(:\w+)?$", name) or (name.isidentifier() and name in scene_names()):
                return name
        return _SCENE

    def error(self, message: str) -> Any:
        """Print one line and exit with status 2."""
        self.exit(2, f"{self.prog}: {message}\n")


def _refuse(error: ParameterError, _: argparse.Namespace) -> int:
    raise error


def joined(arguments: Sequence[str]) -> list[str]:
    """Join an option and a negative number after it: argparse takes -1e-3, -5:3 and -inf for options of their own.

    What it does know for a number stays as it is, so that an option of several values gets them all.
    """
    result: list[str] = []
    for argument in arguments:
        odd = re.match(r"-(\.?\d|inf|nan)", argument) and not re.fullmatch(r"-\d+|-\d*\.\d+", argument)
        if odd and result and result[-1].startswith("--") and "=" not in result[-1]:
            result[-1] += f"={argument}"
        else:
            result.append(argument)
    return result


def add_options(
    parser: argparse.ArgumentParser, names: Mapping[str, Iterable[str]], helps: Mapping[str, str], parameters: Any
) -> None:
    """Add an option for each name to choose and each number to give, with its default in the help text.

    Args:
        parser: Of the command.
        names: Choices of each option that is a name.
        helps: Help text of each option that is a number.
        parameters: Class of the parameters, or parameters whose values are the defaults.
    """
    made = parameters() if isinstance(parameters, type) else parameters
    for name, choices in names.items():
        default = getattr(made, name)
        parser.add_argument(f"--{name}", default=default, help=f"{', '.join(choices)} (default {default})")
    for name, text in helps.items():
        # a default that depends on other options is the class's to fill in: None here, its value in the help
        default = parameters.__dataclass_fields__[name].default
        shown = "none" if getattr(made, name) is None else f"{getattr(made, name):g}"
        option = f"--{name.replace('_', '-')}"
        parser.add_argument(option, type=number_option, default=default, metavar="X", help=f"{text} (default {shown})")


def add_outputs(parser: argparse.ArgumentParser) -> None:
    """Add --json and --out."""
    parser.add_argument(
        "--json", metavar="FILE", help="write parameters, motion and figures as JSON; - for standard output"
    )
    parser.add_argument("--out", metavar="DIR", type=Path, help="write pictures to this folder")


def add_recording(parser: argparse.ArgumentParser) -> None:
    """Add --record, for a recording that `replay` shows and checks."""
    parser.add_argument(
        "--record", metavar="FILE", type=Path, help="write a recording, .mcap or .npz, for `maglev-mj replay`"
    )


def add_workers(parser: argparse.ArgumentParser, record: str) -> None:
    """Add --record, --workers and --scheduler.

    Args:
        parser: Of the command.
        record: What the record is for.
    """
    parser.add_argument("--record", metavar="FILE", type=Path, help=f"{record}; one JSON object a line")
    parser.add_argument("--workers", type=count, metavar="N", help="processes on this machine; 0 for this one alone")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="run on the Dask cluster of this scheduler instead")


def chosen_workers(options: argparse.Namespace, default: int | None) -> Workers:
    """Return the workers asked for; `default` processes, None for one a processor, unless told."""
    if options.scheduler is not None:
        if options.workers is not None:
            raise ParameterError(f"workers must be left to the scheduler where there is one, not {options.workers}")
        return dask_workers(options.scheduler)
    return local_workers(default if options.workers is None else options.workers)


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
    """Return the ends of a range, given as one word or two; None where it is not given.

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


def add_bridge(parser: argparse.ArgumentParser) -> None:
    """Add what both ends of a wire are told."""
    parser.add_argument(
        "--calibration", metavar="FILE", type=Path, help="what is known of the device (default: the model)"
    )
    parser.add_argument(
        "--key",
        metavar="FILE",
        type=Path,
        help="secret of 16 to 32 bytes as hexadecimal digits, for more than this machine",
    )
    parser.add_argument("--seconds", type=number_option, metavar="X", help="end after so long [s]")
    parser.add_argument(
        "--realtime",
        default="ignore",
        choices=("enforce", "ignore"),
        help="what to do where the system refuses real-time scheduling (default ignore)",
    )


def chosen_key(path: Path | None, name: str = "key") -> bytes | None:
    """Return the key in a file; None without one.

    Args:
        path: The file.
        name: Of the option that names it.

    Raises:
        ParameterError: If it is no key.
    """
    if path is None:
        return None
    try:
        key = bytes.fromhex(path.read_text(encoding="ascii"))
    except (OSError, ValueError):
        key = b""
    if not LEAST_KEY <= len(key) <= MOST_KEY:
        digits = f"{2 * LEAST_KEY} to {2 * MOST_KEY} hexadecimal digits"
        raise ParameterError(f"{name} must be a file of {digits}, not {str(path)!r}")
    return key


def add_scene(parser: Parser, option: str = "scene", *, without: Sequence[str] = ()) -> None:
    """Add the scene, and an option for each of its parameters.

    Args:
        parser: Of the command.
        option: Name of the argument: "scene", or "--scene".
        without: Parameters that are not the user's to choose here.
    """
    parser.without = without
    known = f"one of {', '.join(BUILT_IN)}, or a file such as my_scene.py (default {_SCENE})"
    optional: dict[str, Any] = {} if option.startswith("-") else {"nargs": "?"}
    parser.add_argument(option, metavar="SCENE", help=known, **optional)


def chosen_scene(options: argparse.Namespace, **defaults: Any) -> Scene:
    """Return the scene asked for, with the parameters given.

    Args:
        options: Of the command line.
        defaults: Parameters in place of its own defaults, where it has them.

    Raises:
        ParameterError: If there is no such scene, or a parameter is outside its bounds.
    """
    cls = find_scene(options.scene or _SCENE)
    names = [one.name for one in cls.parameters()]
    given = {name: value for name, value in defaults.items() if name in names}
    return cls(**given | {name: options.parameters[name] for name in names if name in options.parameters})


_KINDS: Mapping[type, tuple[Callable[[str], Any], str]] = {
    float: (number_option, "X"),
    int: (count, "N"),
    str: (str, "NAME"),
}
"""Reader and placeholder of a parameter that is no switch."""


class _Given(argparse.Action):
    """Keeps a parameter among the others, away from the command's own options."""

    def __call__(self, parser: Any, namespace: Any, values: Any, option: str | None = None) -> None:
        name = self.dest.removeprefix("parameter ")
        given = not (option or "").startswith("--no-") if self.nargs == 0 else values
        namespace.parameters = {**namespace.parameters, name: given}


def _add_parameters(parser: Parser, cls: type[Scene], without: Sequence[str]) -> None:
    """Add an option for each parameter of a scene, but for those that are no number, switch or word."""
    made = cls()
    for one in cls.parameters():
        option, value = f"--{one.name.replace('_', '-')}", getattr(made, one.name)
        # an option of the command itself goes before
        if one.kind is object or one.name in without or option in parser._option_string_actions:
            continue
        unit = f" [{one.unit}]" if one.unit else ""
        shown = "none" if value is None else f"{value:g}" if one.kind in (float, int) else str(value)
        common: dict[str, Any] = {"dest": f"parameter {one.name}", "action": _Given, "default": argparse.SUPPRESS}
        if one.kind is bool:
            off = f"--no-{one.name.replace('_', '-')}"
            parser.add_argument(option, off, nargs=0, help=f"{one.help} (default {shown.lower()})", **common)
            continue
        kind, letter = _KINDS[one.kind]
        text = f"{one.help}{unit} (default {shown})".replace("%", "%%")
        parser.add_argument(option, type=kind, metavar=letter, help=text, **common)
