"""Options shared by several commands: common declarations, parameters, and the scene."""

from __future__ import annotations

import argparse
import math
import os
import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias, TypeVar

from maglev_mj.cli.declare import KINDS, Container, Option, Parser, Shared, beside_inverse, number_option, option
from maglev_mj.cli.output import add_pictures, chosen_pictures
from maglev_mj.errors import ParameterError

if TYPE_CHECKING:
    from maglev_mj.bridge.commissioning.calibration import Calibration
    from maglev_mj.device import Device
    from maglev_mj.parameters import Parameter, Parameters
    from maglev_mj.pictures import PictureFolder
    from maglev_mj.scenes.scene import Scene

P = TypeVar("P", bound="Parameters")

_DEST = "parameter "


def add_parameters(
    parser: Container,
    parameters: Parameters | type[Parameters],
    prefix: str = "",
    /,
    *,
    without: Sequence[str] = (),
    sources: Mapping[str, str] = {},
) -> None:
    """Add an option for each declared parameter whose name is not an option yet.

    The help with unit and default is composed lazily (see `help_of`). Values are stored separately from the command's
    own options (see `chosen`). Parameters with a `parse` function get no option.

    Args:
        parser: Parser of the command.
        parameters: Class, or parameters with the default values.
        prefix: Prefix of each option's name, for a command with options of several classes.
        without: Names of parameters without an option.
        sources: Help for the default of some, in place of the value.
    """
    defaults = parameters() if isinstance(parameters, type) else parameters
    names = [parameter.name for parameter in defaults.parameters()]
    for parameter in defaults.parameters():
        name = parameter.name
        option = f"--{prefix}{name.replace('_', '-')}"
        if parameter.kind is not object and name not in without and option not in parser._option_string_actions:
            rate = re.sub("period$", "rate", name)  # a hidden option for the inverse
            inverse = rate not in (name, *names)
            into = (
                beside_inverse(parser, f"--{prefix}{rate.replace('_', '-')}", _DEST + prefix + name)
                if inverse
                else parser
            )
            help = partial(described, parameter, getattr(defaults, name), sources.get(name, ""))
            _add_parameter(into, option, parameter, prefix, help)


def _add_parameter(parser: Container, option: str, item: Parameter, prefix: str, help: Callable[[], str]) -> None:
    keywords: dict[str, Any] = {"dest": _DEST + prefix + item.name, "default": argparse.SUPPRESS, "help": item.name}
    if item.kind is bool:
        keywords["action"] = argparse.BooleanOptionalAction
    else:
        read, metavar = KINDS[item.kind]
        keywords |= {"type": partial(_or_none, read) if item.optional else read, "metavar": metavar or "NAME"}
    action: Any = parser.add_argument(option, **keywords)
    action.offered, action.parameter = item.choices, item
    action.compose = help  # lazily, when a help is printed


def described(item: Parameter, default: Any, source: str = "") -> str:
    """Return a parameter's description with unit, choices and default, or where the default comes from."""
    from maglev_mj.frames import unit_of  # imported here: other help texts do not need NumPy

    head, semicolon, tail = item.help.partition(";")
    unit = " or ".join(dict.fromkeys(unit_of(item.unit, axis, item.along) for axis in ("x", "rx")))
    text = f"{head} [{unit}]{semicolon}{tail}" if unit else item.help
    if item.choices:
        text += f": {', '.join(item.choices)}"
    if source:
        return f"{text} (default: {source})"
    if item.kind is bool:
        return f"{text} (default {'on' if default else 'off'})"
    return f"{text} (default {'none' if default is None else default if item.kind is str else f'{default:g}'})"


def _or_none(read: Callable[[str], Any], text: str) -> Any:
    return None if text.lower() == "none" else read(text)


def chosen(options: argparse.Namespace, parameters: P | type[P], prefix: str = "", /, **others: Any) -> P:
    """Return parameters with the values set by options.

    Args:
        options: Parsed options.
        parameters: Class, or parameters with the default values.
        prefix: Prefix passed to `add_parameters`.
        others: Values from other options.

    Raises:
        ParameterError: If a value is outside its bounds.
    """
    defaults, values = parameters() if isinstance(parameters, type) else parameters, vars(options)
    options_of = {item.name: f"{_DEST}{prefix}{item.name}" for item in defaults.parameters()}
    changes = {name: values[option] for name, option in options_of.items() if option in values}
    try:
        return defaults.replace(**changes, **others)
    except ParameterError as error:
        raise ParameterError(f"{prefix}{error}") from None


def stated(options: argparse.Namespace, parameters: Parameters | type[Parameters]) -> dict[str, Any]:
    """Return the values of the parameters set on the command line, by name."""
    values = vars(options)
    return {item.name: values[_DEST + item.name] for item in parameters.parameters() if _DEST + item.name in values}


def range_of(name: str, text: str, forms: str = "LOW:HIGH or one value") -> tuple[float, ...]:
    """Parse the ends of a range, and how many values it has if the forms have COUNT.

    Args:
        name: Name for the message.
        text: LOW:HIGH:COUNT, LOW:HIGH, or one value, which is both ends.
        forms: Allowed forms, for the message.

    Raises:
        ParameterError: If the text has another form.
    """
    try:
        values = tuple(float(part) for part in text.split(":"))
        *ends, count = values if len(values) == 3 and "COUNT" in forms else (*values, 1.0)
        if not (1 <= len(ends) <= 2 and math.isfinite(sum(values)) and count == int(count) >= 1):
            raise ValueError(text)
    except ValueError:
        raise ParameterError(f"{name} must be {forms} (got {text!r})") from None
    return values if len(values) == 3 else (ends[0], ends[-1])


def assignments(what: str, words: Sequence[str], spelling: Callable[[str], str] = str) -> dict[str, str]:
    """Parse words NAME=VALUE; return the text of each value by name.

    Raises:
        ParameterError: If a word has another form, or a name is given twice.
    """
    result: dict[str, str] = {}
    for word in words:
        name, _, text = word.partition("=")
        if not (name and text):
            raise ParameterError(f"{what} must be given as NAME=VALUE (got {word!r})")
        if (name := spelling(name)) in result:
            raise ParameterError(f"{name} must be given once (got {result[name]} and {text})")
        result[name] = text
    return result


def parameters(declared: Callable[[], Parameters], group: str, prefix: str = "") -> Shared:
    """Declare parameters as one argument with an option each; see `add_parameters` and `chosen`.

    Args:
        declared: Function that returns the parameters with their defaults; may import lazily.
        group: Title of their group in the help.
        prefix: Prefix of each option's name.
    """
    return Shared(
        lambda parser: add_parameters(parser.group(group), declared(), prefix),
        lambda options: chosen(options, declared(), prefix),
    )


def add_device(parser: Parser) -> None:
    """Add the options of the device among `LoopParameters`, which parameters of several commands include."""
    from maglev_mj.theory.loop_parameters import LoopParameters

    own, names = ("own_damping", "mode", "driver_lag"), [item.name for item in LoopParameters.parameters()]
    others = [name for name in names if not (name in own or name.startswith("device"))]
    group = parser.group("device: own damping, flexible mode, law at a second rate")
    add_parameters(group, LoopParameters, without=others)


def json_of(content: str = "figures") -> Option:
    """Declare the option for a result's JSON file."""
    return option(f"JSON file for {content}; - for standard output", "output", "FILE")


def pictures_to(help: str = "output folder for charts") -> Shared:
    """Declare the options for the folder and format of charts."""
    return Shared(partial(add_pictures, help=help), chosen_pictures)


def _calibration(options: argparse.Namespace) -> Calibration:
    from maglev_mj.bridge.commissioning.calibration import Calibration

    return Calibration.load(options.calibration)


def _device(options: argparse.Namespace) -> Device:
    from maglev_mj.device import Device

    return Device.load(options.device)


def _key(options: argparse.Namespace) -> bytes | None:
    """Return the key read from a file; None without one."""
    from maglev_mj.bridge.wire import LEAST_KEY, MOST_KEY
    from maglev_mj.files import read_text

    path: Path | None = options.key
    if path is None:
        return None
    try:
        shared = path.stat().st_mode & 0o077 if os.name == "posix" else 0
        key = bytes.fromhex(read_text(path)) if path.is_file() else b""  # a FIFO might wait for its writer
    except (OSError, ValueError):
        key, shared = b"", 0
    if not LEAST_KEY <= len(key) <= MOST_KEY:
        digits = f"{2 * LEAST_KEY} to {2 * MOST_KEY} hexadecimal digits"
        raise ParameterError(f"key must be a file of {digits} (got {str(path)!r})")
    if shared:
        raise ParameterError(f"key must be a file that only you can read; run: chmod 600 {path}")
    return key


Json: TypeAlias = Annotated[str | None, json_of()]
Pictures: TypeAlias = Annotated["PictureFolder | None", pictures_to()]
Picture: TypeAlias = Annotated["PictureFolder | None", pictures_to("output folder for the chart")]
Record: TypeAlias = Annotated[
    Path | None, option("recording to write, FILE.maglev; open it with `maglev-mj replay`", "output", "FILE")
]
Folder: TypeAlias = Annotated[Path, option("output folder for recordings and screenshots", "output", "DIR")]
Recorded: TypeAlias = Annotated[Path, option("recording written by run, view or bridge", "", "FILE")]
Seconds: TypeAlias = Annotated[float | None, option("duration [s] (default: until stopped)", above=0.0)]
Shown: TypeAlias = Annotated[float | None, option("duration [s] (default: no limit)", above=0.0)]
Address: TypeAlias = Annotated[str, option("device: udp://HOST:PORT or serial:///PATH?baud=RATE", "", "ADDRESS")]
_device_file = partial(
    option,
    "device file (.toml), or a device of the package by name",
    "device",
    "FILE",
    name="device",
    kind=str,
    default=lambda: "ubc",
)
DeviceFile: TypeAlias = Annotated["Calibration", _device_file(take=_calibration)]
AnyDevice: TypeAlias = Annotated["Device", _device_file(take=_device)]
"""One with coils, and any."""
Key: TypeAlias = Annotated[
    bytes | None,
    option(
        "file with a shared secret, 16 to 32 bytes in hexadecimal; required for another machine",
        "device",
        "FILE",
        kind=Path,
        take=_key,
    ),
]
Realtime: TypeAlias = Annotated[
    Literal["enforce", "ignore"], option("action if the system refuses real-time scheduling")
]


_MORE = "SCENE is a name or your own FILE.py[:CLASS] (executed); SCENE --help lists its parameters."

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
    optional: bool = False,
    find: Find | None = None,
    names: Sequence[str] = (),
) -> None:
    """Add the scene argument, then the options of the scene's parameters.

    The scene named in the parser's words is stored with its default values in `scene_class`; its class if `options` is
    False.

    Args:
        parser: Parser of the command.
        more: Function that adds options which depend on the scene's class.
        option: Name of the scene's option, such as "--scene"; None for a positional argument.
        default: Default scene; None if the scene is required.
        without: Names of parameters without an option.
        options: False if parameters are set in another way.
        optional: True if the scene may be left out.
        find: Function that returns the scene or its class, in place of `find_scene`; None for no options.
        names: Additional names that `find` accepts.
    """
    from maglev_mj.scenes.find import find_scene
    from maglev_mj.scenes.names import scene_names

    def known() -> list[str]:
        return [*scene_names(), *names]  # those of other packages take longer to find than most scenes to parse

    def text() -> str:
        return f"{', '.join(known())}, or FILE.py[:CLASS]" + (f" (default {default})" if default else "")

    group = parser.group("scene")
    argument: Any
    if option is not None:
        argument = group.add_argument(option, dest="scene", default=default, metavar="SCENE", help="scene")
    else:
        argument = parser.add_argument(
            "scene", nargs="?" if default or optional else None, default=default, metavar="SCENE", help="scene"
        )
    argument.compose = text
    parser.epilog = f"{parser.epilog}\n{_MORE}" if parser.epilog else _MORE
    parser.set_defaults(scene_class=None)

    def add_chosen() -> None:
        name = scene_word(parser, option, known) or default
        if name is None:
            return
        try:
            scene = (find or find_scene)(name)
        except ParameterError as error:
            parser.error(str(error))
        if scene is None:
            return
        cls = scene if isinstance(scene, type) else type(scene)
        try:
            if options:
                scene = scene() if isinstance(scene, type) else scene
                parser.give_way([f"--{item.name.replace('_', '-')}" for item in scene.parameters()])
                add_parameters(group, scene, without=without)
                group.title = f"parameters of {cls.name}"
            if more is not None:
                more(parser, cls)
        except (
            argparse.ArgumentError,
            ParameterError,
        ) as error:  # duplicate option, or invalid default
            parser.error(f"scene {cls.name} is not supported by this command: {error}")
        parser.set_defaults(scene_class=scene)

    parser.later.append(add_chosen)


def chosen_scene(options: argparse.Namespace) -> Scene:
    """Return the scene with the parameters set by options.

    Raises:
        ParameterError: If a value is outside its bounds.
    """
    scene: Scene = chosen(options, options.scene_class)
    return scene


def add_phase(parser: Parser, group: str, default: float | None) -> None:
    """Add --phase."""
    text = "sampling phase in [0, 1); sample k is at (k + phase) periods (default 0)"
    parser.group(group).add_argument("--phase", type=number_option, default=default, metavar="X", help=text)


def scene_class(options: argparse.Namespace) -> Any:
    """Return the scene or class that `add_scene` stored; None without one."""
    return options.scene_class


def scene_word(parser: Parser, option: str | None, names: Callable[[], Sequence[str]]) -> str | None:
    """Return the argument that names the scene; None without one. The names are asked for if options come first."""
    arguments = parser.words
    if option is not None:
        for index, word in enumerate(arguments):
            if word == option and index + 1 < len(arguments):
                return arguments[index + 1]
            if word.startswith(f"{option}="):
                return word.partition("=")[2]
        return None
    if arguments and not arguments[0].startswith("-"):
        return arguments[0]
    before = ""
    for word in arguments:
        action = parser._option_string_actions.get(before)
        before = word
        # skip values of options: a file named for another purpose must not be executed
        if action is None and (word in names() or word.partition(":")[0].endswith(".py")):
            return word
    return None
