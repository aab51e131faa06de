"""Scene argument of a command and options of its parameters."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from maglev_mj.cli.arguments import Parser, number_option
from maglev_mj.cli.options import add_parameters, chosen
from maglev_mj.errors import ParameterError
from maglev_mj.terminal import say

if TYPE_CHECKING:
    from maglev_mj.scenes.scene import Scene

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
    """Add the scene argument and options of the scene's parameters.

    The class is found while the arguments are parsed, and stored in `scene_class`.

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

    def before(arguments: Sequence[str]) -> None:
        text = _given(parser, arguments, option, known) or default
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
                add_parameters(group, found, without=without)
                group.title = f"parameters of {cls.name}"
            if more is not None:
                more(parser, cls)
        except (argparse.ArgumentError, ParameterError) as error:  # a name that is an option here, or a bad default
            parser.error(f"scene {cls.name} cannot be given here: {error}")
        parser.set_defaults(scene_class=found)

    parser.before = before


def chosen_scene(options: argparse.Namespace, **defaults: Any) -> Scene:
    """Return the given scene with the chosen parameters.

    Args:
        options: Parsed options.
        defaults: Values in place of the scene's own defaults, for parameters of the scene.

    Raises:
        ParameterError: If a value is outside its bounds.
    """
    found = options.scene_class
    made: Scene = found() if isinstance(found, type) else found
    names = {one.name for one in made.parameters()}
    return chosen(options, made.replace(**{name: value for name, value in defaults.items() if name in names}))


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


def _given(parser: Parser, arguments: Sequence[str], option: str | None, names: Sequence[str]) -> str | None:
    """Return the scene among the arguments, after options if any."""
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
