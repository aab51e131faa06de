"""Commands for recordings: replay, analyse, export, fault."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from maglev_mj.cli.declare import option
from maglev_mj.cli.options import Picture, Pictures, Recorded, json_of
from maglev_mj.cli.output import LAYOUT, Progress, check_files, write_json
from maglev_mj.cli.peripherals import PageOptions, show_session
from maglev_mj.errors import ParameterError
from maglev_mj.terminal import printable, say, wrapped

if TYPE_CHECKING:
    from maglev_mj.analysis import SegmentReport
    from maglev_mj.pictures import PictureFolder
    from maglev_mj.recording import Recording, Segment
    from maglev_mj.session.replay import OwnCode

_COMPARED, _LEAST_COMPARED = 10_000, 10
"""Commands compared before other code's recording is shown.

In all, and the least number of each segment.
"""

_OWN_SCENE = (
    "scene or laws of one's own, which are executed: NAME, FILE.py, FILE.py:CLASS, or attached for what the recording "
    "holds"
)
_PART = "part of the recording"


def replay(
    file: Recorded,
    check: Annotated[
        bool,
        option(
            "feed the samples to the controller and the hand to the plant; status 1 if any number differs, or the "
            "file is not whole"
        ),
    ] = False,
    scene: Annotated[str | None, option(_OWN_SCENE, metavar="SCENE")] = None,
    *,
    page: PageOptions,
) -> int:
    """Show a recording, or check it bit for bit."""
    from maglev_mj.recording import InvalidRecordingError, Recording
    from maglev_mj.session.replay import Replay

    with Progress("replay"):
        recording = Recording.load(file)
    if not recording.ticks:
        raise InvalidRecordingError(f"there is nothing in {str(file)!r}")
    if recording.damage:
        say(f"  {file}: {recording.damage}; {recording.ticks} samples are there")
    for event in recording.events:
        print("\n".join(wrapped(printable(event), further="    ")))
    own = _own_code(scene, recording)
    if check:
        return _check(recording, own)
    if note := _other_code(recording, own):
        for line in wrapped(f"{file}: {note}", further="    "):
            say(line)
    show_session(Replay(recording, own), page.open(drag=False, settings=False))
    return 0


def _check(recording: Recording, own: OwnCode | None) -> int:
    from maglev_mj.recording.verify import verify
    from maglev_mj.session.replay import rebuild, unmade_plant

    with Progress("replay"):
        verdict = verify(recording, partial(rebuild, own=own))
    print(verdict)
    simulated = (segment for segment in recording.segments if segment.setup["kind"] != "device")
    for plant in sorted({*map(unmade_plant, simulated)} - {""}):
        text = f"the plant, {plant}, cannot be made here: the controller's answers alone are compared"
        for line in wrapped(text):
            say(line)
    return 0 if verdict.same else 1


def _own_code(text: str | None, recording: Recording) -> OwnCode | None:
    """Return the code given for a recording; None without.

    A message is printed if it differs from the recorded code.

    Raises:
        ParameterError: If there is no such code.
    """
    from maglev_mj.session.replay import OwnCode

    if text is None:
        return None
    own = OwnCode(text, recording)
    if own.changed:
        say(f"  {text} is not the file that was recorded: it has changed since, or is another", sys.stderr)
    return own


def _other_code(recording: Recording, own: OwnCode | None) -> str:
    """Return a note if other code made a recording.

    Else "". The first answers of each segment are compared.

    Raises:
        RecordingError: If an answer differs.
    """
    from maglev_mj.recording import OwnCodeError, RecordingError
    from maglev_mj.recording.verify import first_other_answer
    from maglev_mj.session.replay import rebuild
    from maglev_mj.versions import differences, versions, versions_read

    here, segments = versions(), recording.segments
    theirs = (differences(versions_read(segment.setup.get("versions")) or {}, here) for segment in segments)
    difference = next(filter(None, theirs), "")
    if not difference:
        return ""
    said, most = f"recorded by other code ({difference})", max(_COMPARED // len(segments), _LEAST_COMPARED)
    try:
        other = first_other_answer(recording, partial(rebuild, own=own), most)
    except OwnCodeError:
        return f"{said}; its laws were not run again, for they are none of this package's"
    if other is not None:
        segment, tick, field = other
        raise RecordingError(f"{said}, whose {field} is another from tick {tick} of segment {segment + 1} on")
    return f"{said}; the first {most} answers of each segment are the same here"


def analyse(
    file: Recorded,
    segment: Annotated[int | None, option("only the N-th segment, from 1; parameters change between", _PART)] = None,
    begin: Annotated[
        float | None,
        option("from so long after the beginning of a segment on [s]", _PART, "SECONDS", name="from"),
    ] = None,
    end: Annotated[float | None, option("up to so long after it [s]", _PART, "SECONDS", name="to")] = None,
    compare: Annotated[
        bool, option("run the simulation of the same parameters too (the default)", "simulation")
    ] = True,
    scene: Annotated[str | None, option(_OWN_SCENE, "simulation", "SCENE")] = None,
    json: Annotated[str | None, json_of()] = None,
    *,
    pictures: Pictures,
    axis: Annotated[
        str | None,
        option("axis to draw (default: the scene's, or one whose wall was touched)", "output", "NAME"),
    ] = None,
) -> int:
    """Figures 5, 6 and 9 of the paper from a recording, beside its simulation.

    docs/explanation/analysis.md says of each what it tells.
    """
    from maglev_mj.parameters import axis_indices
    from maglev_mj.recording import Recording

    if axis is not None:
        axis_indices(axis)
    with Progress("analyse") as progress:
        recording = Recording.load(file)
        several = len(recording.segments) > 1
        with progress.aside():
            own = _own_code(scene, recording)
        wanted = _chosen(recording, file, segment, is_part=bool(begin) or end is not None)
        reports: list[tuple[int, SegmentReport]] = []
        for place, one in wanted:
            reports.append((place, _report(one, begin or 0.0, end, compare, own)))
            if len(wanted) > 1:
                progress(len(reports), len(wanted))
    axes = [one.axis(axis) for _, one in reports]  # before anything is written
    if json is not None:
        write_json(json, _as_json(file, recording, reports))
    drawn = []
    if pictures is not None:
        for (place, report), number in zip(reports, axes, strict=True):
            drawn += _draw(report, number, pictures, f"segment_{place}_" if several else "analysis_")
    if json != "-":
        heads = [f"segment {place} of {len(recording.segments)}\n" if several else "" for place, _ in reports]
        print("\n\n".join(f"{head}{one.table()}" for head, (_, one) in zip(heads, reports)))
        damage = [f"{file}: {recording.damage}"] if recording.damage else []
        for line in [*damage, *recording.events, *drawn]:
            print("\n".join(wrapped(printable(line), further="    ")))
    return 0


def _as_json(file: Path, recording: Recording, reports: Sequence[tuple[int, SegmentReport]]) -> dict[str, Any]:
    from maglev_mj.versions import versions_read

    data = []
    for place, report in reports:
        by = versions_read(recording.segments[place - 1].setup.get("versions"))
        data.append({"segment": place, "versions": by, **report.as_json()})
    about = {"file": str(file), "damage": recording.damage, "events": list(recording.events)}
    return {**about, "segments": data}


def _chosen(recording: Recording, file: Path, number: int | None, *, is_part: bool) -> list[tuple[int, Segment]]:
    """Return the segments to analyse and their numbers from 1.

    Raises:
        InvalidRecordingError: If the recording has no samples.
        ParameterError: If there is no such segment, or the segment of a part is ambiguous.
    """
    from maglev_mj.parameters import whole
    from maglev_mj.recording import InvalidRecordingError

    segments = recording.segments
    usable = [(place, segment) for place, segment in enumerate(segments, start=1) if len(segment.tick) > 1]
    if not usable:
        raise InvalidRecordingError(f"there is nothing in {str(file)!r} to be analysed")
    if number is not None:
        place = whole("segment", number, at_least=1, at_most=len(segments))
        return [(place, segments[place - 1])]
    if len(usable) > 1 and is_part:
        raise ParameterError(f"from and to are within a segment: choose one of {len(segments)} with --segment")
    return usable


def _report(segment: Segment, begin: float, end: float | None, compare: bool, own: OwnCode | None) -> SegmentReport:
    from maglev_mj.analysis import analyse
    from maglev_mj.session.replay import rebuild_for, stick_positions_of, unmade_plant

    again = rebuild_for(segment, own)
    anchors = stick_positions_of(segment, again)
    simulated = compare and not unmade_plant(segment, own)
    scene = own.scene if own else None
    return analyse(segment, again, anchors=anchors, scene=scene, begin=begin, end=end, simulated=simulated)


def _draw(analysed: SegmentReport, axis: int, pictures: PictureFolder, stem: str) -> list[str]:
    """Draw a segment; return lines about written and missing pictures."""
    from maglev_mj.analysis.pictures import first_contact, sticks, whole_run
    from maglev_mj.frames import AXES
    from maglev_mj.pictures import save

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


def export(
    file: Annotated[Path, option("a recording", "", "FILE")],
    to: Annotated[
        Literal["npz", "mcap", "csv", "parquet", "wav"],
        option("format; mcap is for Foxglove and Rerun, wav is the force as sound", "output"),
    ],
    out: Annotated[Path | None, option("where to (default: beside the recording)", "output")] = None,
) -> int:
    """A recording for other programs: MCAP, table, arrays or sound."""  # noqa: D401
    from maglev_mj.recording import Recording
    from maglev_mj.recording.export import export

    path = out or file.with_suffix(f".{to}")
    check_files({"out": path}, file)
    with Progress("export"):
        recording = Recording.load(file)
        export(recording, to, path)
    if recording.damage:
        say(f"  {file}: {recording.damage}")
    print(f"  wrote {path}: {recording.ticks} samples")
    if to == "mcap":
        print(f"  Foxglove shows it with the layout {LAYOUT}")
    return 0


def fault(
    file: Annotated[Path, option("fault-TIME.maglev, which a flight has left, or its recording", "", "FILE")],
    all: Annotated[bool, option("show all 200 cycles, not the last 20", "output")] = False,
    *,
    pictures: Picture,
) -> int:
    """What happened, when, and the last cycles, from a flight's journal."""  # noqa: D401
    from maglev_mj.bridge.fault import load_fault

    record = load_fault(file)
    print(record.table(whole=all))
    if pictures is not None:
        print(f"  wrote {record.plot(path=pictures.path(file.stem))}")
    return 0
