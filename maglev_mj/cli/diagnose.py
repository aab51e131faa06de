"""Command that diagnoses a loop: its own module, so that a verdict on numbers loads no scene."""

from __future__ import annotations

import argparse
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

from maglev_mj.cli.declare import Parser, Shared, count, number_option, option
from maglev_mj.cli.options import Json, add_device, add_parameters, chosen, pictures_to, range_of, scene_word, stated
from maglev_mj.cli.output import write_result
from maglev_mj.errors import MaglevError
from maglev_mj.parameters import MEASURED_MOTIONS
from maglev_mj.scenes.names import scene_names
from maglev_mj.studies.diagnosed_loops import DiagnosedLoop
from maglev_mj.studies.diagnosis import diagnose as diagnose_loop
from maglev_mj.theory.line import LossyLine

if TYPE_CHECKING:
    from maglev_mj.pictures import PictureFolder

_SOURCES = {
    "stiffness": "from the scene or recording, else required",
    "damping": "from the scene or recording, else required",
    "period": "from the scene, recording or device, else that of the log, or required",
    "delay": "from the scene, recording or device, else fitted to a log, or one period",
    "mass": "from the scene, recording or device, else fitted to a log; or mass or inertia is required",
    "inertia": "from the scene or recording, else none",
    "cutoff": "from the scene, else none",
}


def _add_loop(parser: Parser) -> None:
    group = parser.group("loop")
    add_device(parser)
    add_parameters(group, DiagnosedLoop, sources=_SOURCES)
    parser.set_defaults(scene=None)
    parser.later.append(partial(_add_scene, parser))


def _add_scene(parser: Parser) -> None:
    """Add the options of the named scene, if any, that the loop does not have."""
    word = scene_word(parser, None, scene_names)
    if word is None or word.endswith(MEASURED_MOTIONS):
        return
    from maglev_mj.scenes.find import get_scene  # slow

    with suppress(MaglevError):  # reported by the diagnosis
        scene = get_scene(word)
        add_parameters(parser.group(f"parameters of {scene.name}"), scene)
        parser.set_defaults(scene=scene)


def _stated_values(options: argparse.Namespace) -> dict[str, Any]:
    """Return the values of scene and loop that are set on the command line."""
    own = {} if options.scene is None else stated(options, options.scene)
    loop = chosen(options, DiagnosedLoop)  # checks the values
    return own | {name: getattr(loop, name) for name in stated(options, DiagnosedLoop)}


_Files: TypeAlias = Annotated[
    "PictureFolder | None", pictures_to("output folder for the chart, and for the gains from a log as a C header")
]
_StatedLoop: TypeAlias = Annotated[dict[str, Any], Shared(_add_loop, _stated_values)]


def _add_line(parser: Parser) -> None:
    group = parser.group("line")
    text = "least and largest delay, if it varies from sample to sample [s]"
    group.add_argument("--jitter", metavar="LOW,HIGH", help=text)
    text = "probability that a sample or its command is lost (default 0)"
    group.add_argument("--loss", type=number_option, metavar="P", help=text)
    text = "largest number of samples lost in a row, for the worst case (default: not limited)"
    group.add_argument("--lost-in-a-row", type=count, metavar="N", help=text)


def _stated_line(options: argparse.Namespace) -> LossyLine | None:
    """Return the line if one of its options is set."""
    text, forms = options.jitter, "LOW,HIGH, LOW:HIGH or one value"
    jitter = None if text is None else range_of("jitter", text.replace(",", ":"), forms)
    if jitter is None and options.loss is None and options.lost_in_a_row is None:
        return None
    return LossyLine(jitter=jitter, loss=options.loss or 0.0, lost_in_a_row=options.lost_in_a_row)


def diagnose(
    what: Annotated[
        str | None,
        option("scene (its worst loop), or recording or table (time, position, ...) of a shaking device", "", "WHAT"),
    ] = None,
    *,
    on_axis: Annotated[
        str | None, option("axis of the scene to diagnose (default: that of its worst loop)", "loop", "AXIS")
    ] = None,
    line: Annotated[LossyLine | None, Shared(_add_line, _stated_line)] = None,
    loop: _StatedLoop,
    json: Json = None,
    pictures: _Files,
) -> int:
    """Say why a wall shakes, how far each value is from the boundary, and which change helps most.

    For a wall, a spring or a controller with stiffness and damping on one axis, of any mass or inertia. The exit status
    is 0 for an unstable wall too; `stable` in the JSON is the verdict.
    """
    result = diagnose_loop(what, on_axis=on_axis, line=line, **loop)
    gains, written = result.from_log, []
    if pictures is not None and gains is not None and not gains.refused:
        written.append(pictures.path("gains", "h"))
        written[0].write_text(gains.header(), encoding="utf-8")
    write_result(json, result, pictures, written)
    return 0
