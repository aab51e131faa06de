"""The scene that a command is given, and the options that its parameters make."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from maglev_mj.cli.options import Parser, add_parameters
from maglev_mj.errors import ParameterError
from maglev_mj.scenes.find import find_scene, scene_names
from maglev_mj.scenes.scene import Scene

__all__ = ["add_scene"]

_MORE = "SCENE is a name, FILE.py or FILE.py:CLASS, and has options of its own: SCENE --help lists them."

More = Callable[[Parser, type[Scene]], object]


def add_scene(
    parser: Parser,
    *,
    more: More | None = None,
    option: str | None = None,
    default: str | None = None,
    without: Sequence[str] = (),
) -> None:
    """Add the scene to a command, and an option for each parameter of the one that is given.

    The class is found as the arguments are parsed, and left in `scene_class`.

    Args:
        parser: Of the command.
        more: Called with parser and scene's class, for options that depend on it.
        option: Name of the option that says which, such as "--scene"; None for the command's first word.
        default: Scene where none is given; None where one must be.
        without: Names of parameters that get no option.
    """
    told = f"{', '.join(scene_names())}, or a file" + (f" (default {default})" if default else "")
    if option is not None:
        parser.add_argument(option, dest="scene", default=default, metavar="SCENE", help=told)
    else:
        parser.add_argument("scene", nargs="?" if default else None, default=default, metavar="SCENE", help=told)
    parser.epilog = f"{parser.epilog} {_MORE}" if parser.epilog else _MORE

    def find(arguments: Sequence[str]) -> None:
        parser.before = None
        text = _given(arguments, option) or default
        if text is None:
            return
        try:
            cls = find_scene(text)
        except ParameterError as error:
            parser.error(str(error))
        add_parameters(parser, cls, without=without)
        if more is not None:
            more(parser, cls)
        parser.set_defaults(scene_class=cls)

    parser.before = find


def _given(arguments: Sequence[str], option: str | None) -> str | None:
    """Return the scene among the arguments, which options of its own may stand in front of."""
    if option is not None:
        for place, word in enumerate(arguments):
            if word == option and place + 1 < len(arguments):
                return arguments[place + 1]
            if word.startswith(f"{option}="):
                return word.partition("=")[2]
        return None
    if arguments and not arguments[0].startswith("-"):
        return arguments[0]
    names = scene_names()
    return next((word for word in arguments if word in names or word.partition(":")[0].endswith(".py")), None)
