"""`maglev-mj analyse`: figures of a recording, and comparison with simulation."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from maglev_mj.analysis import StretchReport, analyse
from maglev_mj.analysis.pictures import first_contact, sticks, whole_run
from maglev_mj.cli.arguments import Parser
from maglev_mj.cli.options import add_outputs, count, number_option
from maglev_mj.cli.output import write_json
from maglev_mj.cli.pictures import chosen_pictures
from maglev_mj.cli.progress import Progress
from maglev_mj.cli.replay import add_own_scene, own_code
from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES
from maglev_mj.parameters import axis_indices, number
from maglev_mj.pictures import PictureFolder, save
from maglev_mj.recording import InvalidRecordingError, Recording, Stretch
from maglev_mj.session.replay import OwnCode, rebuild_for, stick_positions_of, unmade_plant
from maglev_mj.terminal import printable, wrapped
from maglev_mj.versions import versions_read


def add_options(parser: Parser) -> None:
    """Add the options of the command."""
    parser.description = (
        "Figures 5, 6 and 9 of the paper from a recording, beside its simulation: "
        "docs/explanation/analysis.md says of each what it tells."
    )
    parser.add_argument("file", metavar="FILE", type=Path, help="a recording of run, view or bridge")
    part = parser.group("part of the recording")
    part.add_argument(
        "--stretch", type=count, metavar="N", help="only the N-th stretch, from 1; parameters change between"
    )
    begin, end = "from so long after the beginning of a stretch on [s]", "up to so long after it [s]"
    part.add_argument("--from", dest="begin", type=number_option, default=0.0, metavar="SECONDS", help=begin)
    part.add_argument("--to", dest="end", type=number_option, metavar="SECONDS", help=end)
    compared = parser.group("simulation")
    compared.add_argument(
        "--compare",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="run the simulation of the same parameters too (the default)",
    )
    add_own_scene(compared)
    add_outputs(parser, "the figures")
    parser.group("output").add_argument(
        "--axis", metavar="NAME", help="axis to draw (default: the scene's, or one whose wall was touched)"
    )
    parser.set_defaults(run=_analyse)


def _analyse(options: argparse.Namespace) -> int:
    if options.axis is not None:
        axis_indices(options.axis)
    pictures = chosen_pictures(options)
    with Progress("analyse") as progress:
        recording = Recording.load(options.file)
        stretches = recording.stretches
        several = len(stretches) > 1
        with progress.aside():
            own = own_code(options.scene, recording)
        wanted, found = _chosen(stretches, options), []
        for place, stretch in wanted:
            found.append((place, _found(stretch, options, own)))
            if len(wanted) > 1:
                progress(len(found), len(wanted))
    axes = [one.axis(options.axis) for _, one in found]  # before anything is written
    if options.json is not None:
        recorded_by = {place: versions_read(stretches[place - 1].setup.get("versions")) for place, _ in found}
        data = [{"stretch": place, "versions": recorded_by[place], **one.as_json()} for place, one in found]
        about = {"file": str(options.file), "damage": recording.damage, "events": list(recording.events)}
        write_json(options.json, {**about, "stretches": data})
    drawn = []
    if pictures is not None:
        for (place, one), axis in zip(found, axes, strict=True):
            drawn += _draw(one, axis, pictures, f"stretch_{place}_" if several else "analysis_")
    if options.json != "-":
        heads = [f"stretch {place} of {len(stretches)}\n" if several else "" for place, _ in found]
        print("\n\n".join(f"{head}{one.table()}" for head, (_, one) in zip(heads, found)))
        damage = [f"{options.file}: {recording.damage}"] if recording.damage else []
        for line in [*damage, *recording.events, *drawn]:
            print("\n".join(wrapped(printable(line), further="    ")))
    return 0


def _chosen(stretches: Sequence[Stretch], options: argparse.Namespace) -> list[tuple[int, Stretch]]:
    """Return the stretches to analyse and their numbers from 1.

    Raises:
        InvalidRecordingError: If the recording has no samples.
        ParameterError: If there is no such stretch, or the stretch of a part is ambiguous.
    """
    usable = [(place, stretch) for place, stretch in enumerate(stretches, start=1) if len(stretch.tick) > 1]
    if not usable:
        raise InvalidRecordingError(f"there is nothing in {str(options.file)!r} to be analysed")
    if options.stretch is not None:
        place = int(number("stretch", options.stretch, at_least=1, at_most=len(stretches)))
        return [(place, stretches[place - 1])]
    if len(usable) > 1 and (options.begin != 0.0 or options.end is not None):
        raise ParameterError(f"from and to are within a stretch: choose one of {len(stretches)} with --stretch")
    return usable


def _found(stretch: Stretch, options: argparse.Namespace, own: OwnCode | None) -> StretchReport:
    again = rebuild_for(stretch, own)
    anchors = stick_positions_of(stretch, again)
    part = {
        "begin": options.begin,
        "end": options.end,
        "simulated": options.compare and not unmade_plant(stretch.setup, own),
    }
    return analyse(stretch, again, anchors=anchors, scene=own.scene if own else None, **part)


def _draw(analysed: StretchReport, axis: int, pictures: PictureFolder, stem: str) -> list[str]:
    """Draw a stretch; return lines about written and missing pictures."""
    wrote = [f"wrote {save(whole_run(analysed, axis), pictures.path(f'{stem}run'))}"]
    if any(face.axis == AXES[axis] for face in analysed.recorded.figures.faces):
        wrote.insert(0, f"wrote {save(first_contact(analysed, axis), pictures.path(f'{stem}contact'))}")
    else:
        wrote.append(f"no wall was touched on {AXES[axis]}: no picture of a contact")
    if analysed.recorded.anchors is not None:
        wrote.append(f"wrote {save(sticks(analysed.recorded), pictures.path(f'{stem}sticks'))}")
    else:
        wrote.append("there is no friction: no picture of where it sticks")
    return wrote
