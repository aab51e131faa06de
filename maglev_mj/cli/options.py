"""Options that several commands have: kinds declared once, declared parameters, and the scene."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias, TypeVar

from maglev_mj.cli.declare import KINDS, Container, Option, Parser, Shared, beside_inverse, number_option, option
from maglev_mj.cli.output import add_pictures, chosen_pictures
from maglev_mj.errors import ParameterError
from maglev_mj.terminal import say

if TYPE_CHECKING:
    from maglev_mj.bridge.commissioning.calibration import Calibration
    from maglev_mj.parameters import Parameter, Parameters
    from maglev_mj.pictures import PictureFolder
    from maglev_mj.scenes.scene import Scene

P = TypeVar("P", bound="Parameters")

_APART = "parameter "


def add_parameters(
    parser: Container, parameters: Parameters | type[Parameters], prefix: str = "", /, *, without: Sequence[str] = ()
) -> None:
    """Add an option for each declared parameter.

    Its help has unit and default, and is composed when it is printed; see `help_of`. Its attribute `parameter` is the
    declaration.

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
    kept: dict[str, Any] = {"dest": _APART + prefix + one.name, "default": argparse.SUPPRESS, "help": one.name}
    if one.kind is bool:
        kept["action"] = argparse.BooleanOptionalAction
    else:
        read, metavar = KINDS[one.kind]
        kept |= {"type": partial(_or_none, read) if one.optional else read, "metavar": metavar or "NAME"}
    action: Any = parser.add_argument(option, **kept)
    action.offered, action.parameter = one.choices, one
    action.compose = partial(described, one, default)  # when a help is printed


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
    made, values = parameters() if isinstance(parameters, type) else parameters, vars(options)
    options_of = {one.name: f"{_APART}{prefix}{one.name}" for one in made.parameters()}
    chosen = {name: values[option] for name, option in options_of.items() if option in values}
    try:
        return made.replace(**chosen, **further)
    except ParameterError as error:
        raise ParameterError(f"{prefix}{error}") from None


def given(options: argparse.Namespace, parameters: type[Parameters]) -> set[str]:
    """Return the names of parameters with a given option."""
    return {one.name for one in parameters.parameters() if hasattr(options, _APART + one.name)}


def range_of(name: str, words: Sequence[str]) -> tuple[float, float]:
    """Return a range from one or two words.

    Raises:
        ParameterError: If they are not numbers.
    """
    parts = words[0].split(":") if len(words) == 1 else words
    try:
        values = [float(part) for part in parts]
    except ValueError:
        values = []
    if not 1 <= len(values) <= 2:
        raise ParameterError(f"{name} must be LOW HIGH, LOW:HIGH, or one value, not {' '.join(words)!r}")
    return values[0], values[-1]


def parameters(declared: Callable[[], Parameters], group: str, prefix: str = "") -> Shared:
    """Declare the options of parameters as one value; see `add_parameters` and `chosen`.

    Args:
        declared: Function that returns them with their defaults, and loads what they need.
        group: Title of their group in the help.
        prefix: Prefix of each option's name.
    """
    return Shared(
        lambda parser: add_parameters(parser.group(group), declared(), prefix),
        lambda options: chosen(options, declared(), prefix),
    )


def json_of(what: str = "the figures") -> Option:
    """Declare a result's JSON."""
    return option(f"write {what} as JSON; - for standard output", "output", "FILE")


def pictures_to(help: str = "write pictures to this folder") -> Shared:
    """Declare the folder of pictures and their format."""
    return Shared(partial(add_pictures, told=help), chosen_pictures)


def _calibration(options: argparse.Namespace) -> Calibration:
    from maglev_mj.bridge.commissioning.calibration import Calibration

    return Calibration.nominal() if options.calibration is None else Calibration.load(options.calibration)


def _key(options: argparse.Namespace) -> bytes | None:
    """Return the key in a file; None without one."""
    from maglev_mj.bridge.wire import LEAST_KEY, MOST_KEY

    path: Path | None = options.key
    if path is None:
        return None
    try:
        open_to = path.stat().st_mode & 0o077 if os.name == "posix" else 0
        key = bytes.fromhex(path.read_text(encoding="ascii"))
    except (OSError, ValueError):
        key, open_to = b"", 0
    if not LEAST_KEY <= len(key) <= MOST_KEY:
        digits = f"{2 * LEAST_KEY} to {2 * MOST_KEY} hexadecimal digits"
        raise ParameterError(f"key must be a file of {digits}, not {str(path)!r}")
    if open_to:
        raise ParameterError(f"key must be a file that others cannot read: chmod 600 {path}")
    return key


Json: TypeAlias = Annotated[str | None, json_of()]
Pictures: TypeAlias = Annotated["PictureFolder | None", pictures_to()]
Picture: TypeAlias = Annotated["PictureFolder | None", pictures_to("write a picture to this folder")]
Record: TypeAlias = Annotated[
    Path | None, option("write a recording, FILE.maglev, for `maglev-mj replay`", "output", "FILE")
]
Folder: TypeAlias = Annotated[Path, option("folder for recordings and screenshots", "output", "DIR")]
Recorded: TypeAlias = Annotated[Path, option("a recording of run, view or bridge", "", "FILE")]
Seconds: TypeAlias = Annotated[float | None, option("end after so long [s]", above=0.0)]
Shown: TypeAlias = Annotated[float | None, option("close the window after so long [s]", above=0.0)]
Address: TypeAlias = Annotated[str, option("udp://HOST:PORT, or serial:///PATH?baud=RATE", "", "ADDRESS")]
CalibrationFile: TypeAlias = Annotated[
    "Calibration",
    option("what is known of the device (default: the model)", "device", "FILE", kind=Path, take=_calibration),
]
Key: TypeAlias = Annotated[
    bytes | None,
    option(
        "secret of 16 to 32 bytes as hexadecimal digits, for more than this machine",
        "device",
        "FILE",
        kind=Path,
        take=_key,
    ),
]
Realtime: TypeAlias = Annotated[
    Literal["enforce", "ignore"], option("what to do where the system refuses real-time scheduling")
]


_MORE = "SCENE is a name, FILE.py or FILE.py:CLASS; SCENE --help lists its own options."

More = Callable[[Parser, "type[Scene]"], object]
Find = Callable[[str], "Scene | type[Scene] | None"]


def add_scene(
    parser: Parser,
    *,
    more: More | None = None,
    option: str | None = None,
    default: str | None = None,
    without: Sequence[str] = (),
    options: bool = True,
    instead: Callable[[Parser], object] | None = None,
    find: Find | None = None,
    names: Sequence[str] = (),
) -> None:
    """Add the scene argument, and later the options of the scene's parameters.

    The scene is found among the parser's words, and stored with its default values in `scene_class`: the class alone
    with `options` False.

    Args:
        parser: Parser of the command.
        more: Called with parser and scene's class, for options that depend on it.
        option: Name of the scene's option, such as "--scene"; None for the command's first word.
        default: Default scene; None if the scene is required.
        without: Names of parameters without option.
        options: False if parameters are given in another way.
        instead: Called with the parser if no scene is given, for a command with an optional scene.
        find: Function that finds the scene, or one with the default values of the options, where it is not
            `find_scene`; it returns None for no options.
        names: Further names that `find` knows.
    """
    from maglev_mj.scenes.find import find_scene
    from maglev_mj.scenes.names import scene_names

    known = [*scene_names(), *names]
    told = f"{', '.join(known)}, or a file" + (f" (default {default})" if default else "")
    group = parser.group("scene")
    if option is not None:
        group.add_argument(option, dest="scene", default=default, metavar="SCENE", help=told)
    else:
        parser.add_argument(
            "scene", nargs="?" if default or instead else None, default=default, metavar="SCENE", help=told
        )
    parser.epilog = f"{parser.epilog}\n{_MORE}" if parser.epilog else _MORE
    parser.set_defaults(scene_class=None)

    def add_chosen() -> None:
        text = _given(parser, option, known) or default
        if text is None:
            if instead is not None:
                instead(parser)
            return
        try:
            found = (find or find_scene)(text)
        except ParameterError as error:
            parser.error(str(error))
        if found is None:
            return
        cls = found if isinstance(found, type) else type(found)
        try:
            if options:
                found = found() if isinstance(found, type) else found
                add_parameters(group, found, without=without)
                group.title = f"parameters of {cls.name}"
            if more is not None:
                more(parser, cls)
        except (argparse.ArgumentError, ParameterError) as error:  # a name that is an option here, or a bad default
            parser.error(f"scene {cls.name} cannot be given here: {error}")
        parser.set_defaults(scene_class=found)

    parser.later.append(add_chosen)


def chosen_scene(options: argparse.Namespace) -> Scene:
    """Return the given scene with the chosen parameters.

    Raises:
        ParameterError: If a value is outside its bounds.
    """
    scene: Scene = chosen(options, options.scene_class)
    return scene


def add_phase(parser: Parser, group: str, default: float | None) -> None:
    """Add --phase."""
    text = "the samples are at (k + phase) period, in [0, 1) (default 0)"
    parser.group(group).add_argument("--phase", type=number_option, default=default, metavar="X", help=text)


def scene_class(options: argparse.Namespace) -> Any:
    """Return what was found by the given name; None without one."""
    return options.scene_class


def warn_of_instability(scene: Scene, inertia: Sequence[float] | None = None, delay: float | None = None) -> None:
    """Warn on standard error if a scene may be unstable.

    Args:
        scene: See `stability_warning`.
        inertia: See `stability_warning`.
        delay: See `stability_warning`.
    """
    from maglev_mj.scenes.stability_check import stability_warning

    if (warning := stability_warning(scene, inertia=inertia, delay=delay)) is not None:
        say(f"  warning: {warning}", sys.stderr)


def _given(parser: Parser, option: str | None, names: Sequence[str]) -> str | None:
    """Return the scene among the arguments, after options if any."""
    arguments = parser.words
    if option is not None:
        for place, word in enumerate(arguments):
            if word == option and place + 1 < len(arguments):
                return arguments[place + 1]
            if word.startswith(f"{option}="):
                return word.partition("=")[2]
        return None
    if arguments and not arguments[0].startswith("-"):
        return arguments[0]
    before = ""
    for word in arguments:
        known = parser._option_string_actions.get(before)
        before = word
        # the value of an option is none: a file that is given for something else must not be run
        if known is None and (word in names or word.partition(":")[0].endswith(".py")):
            return word
    return None
