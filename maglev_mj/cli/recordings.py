"""Commands for recordings: replay, analyse."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from maglev_mj.cli.declare import option
from maglev_mj.cli.options import Pictures, Recorded, json_of
from maglev_mj.cli.output import Progress, write_json, write_results
from maglev_mj.cli.peripherals import PageOptions, window
from maglev_mj.errors import ParameterError
from maglev_mj.terminal import printable, say, wrapped

if TYPE_CHECKING:
    from maglev_mj.analysis import SegmentReport
    from maglev_mj.pictures import PictureFolder
    from maglev_mj.recording import Recording, Segment
    from maglev_mj.session.replay import UserCode

_COMPARED, _MIN_COMPARED = 10_000, 10
"""Commands recomputed before a recording of other code is shown: total, and minimum per segment."""

_OWN_SCENE = (
    "your own scene or laws (executed): NAME or FILE.py[:CLASS]; attached for the source stored in the recording"
)
_PART = "part of the recording"
_CYCLES = "device cycles, in place of samples"


def replay(
    file: Recorded,
    check: Annotated[
        bool,
        option(
            "bit-for-bit check of commands and motion, from the recorded samples and hand; status 1 if any number "
            "differs or the file is damaged"
        ),
    ] = False,
    scene: Annotated[str | None, option(_OWN_SCENE, metavar="SCENE")] = None,
    *,
    page: PageOptions,
) -> int:
    """Play back a recording, or check it bit for bit."""
    from maglev_mj.recording import Recording
    from maglev_mj.session.replay import Replay
    from maglev_mj.views.viewer_process import show_remotely

    with Progress("replay"):
        recording = Recording.load(file)
    recording.require_samples(file)
    if recording.damage:
        say(f"  {file}: {recording.damage}; {recording.ticks} samples were read")
    for event in recording.events:
        print("\n".join(wrapped(printable(event), further="    ")))
    own = _own_code(scene, recording)
    if check:
        return _check(recording, own)
    if note := _other_code(recording, own):
        for line in wrapped(f"{file}: {note}", further="    "):
            say(line)
    show_remotely(Replay(recording, own), page.open(drag=False, settings=False) or window())
    return 0


def _check(recording: Recording, own: UserCode | None) -> int:
    from maglev_mj.recording.setup import MEASURED, UNCONTROLLED
    from maglev_mj.recording.verify import verify
    from maglev_mj.session.replay import rebuild, unsimulated_plant

    if recording.segments[0].setup["kind"] == MEASURED:
        say(f"  {UNCONTROLLED}")
        return 1 if recording.damage else 0
    with Progress("replay"):
        verdict = verify(recording, partial(rebuild, own=own))
    print(verdict)
    simulated = (segment for segment in recording.segments if segment.setup["kind"] != "device")
    for plant in sorted({*map(unsimulated_plant, simulated)} - {""}):
        text = f"plant {plant} is not available: only the controller's commands were compared"
        for line in wrapped(text):
            say(line)
    return 0 if verdict.same else 1


def _own_code(text: str | None, recording: Recording) -> UserCode | None:
    """Return the user's code for a recording; None without one. Print a note if it differs from the recorded code.

    Raises:
        ParameterError: If there is no such code.
    """
    from maglev_mj.session.replay import UserCode

    if text is None:
        return None
    own = UserCode(text, recording)
    if own.changed:
        say(f"  {text} differs from the recorded file: it has changed, or is another file", sys.stderr)
    return own


def _other_code(recording: Recording, own: UserCode | None) -> str:
    """Return a note if a recording was made by other code, else "".

    The first commands of each segment are recomputed and compared.

    Raises:
        RecordingError: If a command differs.
    """
    from maglev_mj.recording import RecordingError, UserCodeError
    from maglev_mj.recording.setup import MEASURED
    from maglev_mj.recording.verify import first_different_command
    from maglev_mj.session.replay import rebuild
    from maglev_mj.versions import differences, validated_versions, versions

    here, segments = versions(), [part for part in recording.segments if part.setup["kind"] != MEASURED]
    theirs = (differences(validated_versions(segment.setup.get("versions")) or {}, here) for segment in segments)
    difference = next(filter(None, theirs), "")
    if not difference:
        return ""
    note, limit = f"recorded by other code ({difference})", max(_COMPARED // len(segments), _MIN_COMPARED)
    try:
        other = first_different_command(recording, partial(rebuild, own=own), limit)
    except UserCodeError:
        return f"{note}; its user-defined laws were not executed"
    if other is not None:
        segment, tick, field = other
        raise RecordingError(f"{note}; {field} differs from tick {tick} of segment {segment + 1}")
    return f"{note}; the first {limit} commands of each segment are identical"


def analyse(
    file: Recorded,
    segment: Annotated[int | None, option("segment number, from 1 (default: all)", _PART)] = None,
    begin: Annotated[
        float | None,
        option("start time within a segment [s]", _PART, "SECONDS", name="from"),
    ] = None,
    end: Annotated[float | None, option("end time within a segment [s]", _PART, "SECONDS", name="to")] = None,
    compare: Annotated[bool, option("simulate the same parameters for comparison (default on)", "simulation")] = True,
    scene: Annotated[str | None, option(_OWN_SCENE, "simulation", "SCENE")] = None,
    cycles: Annotated[
        bool, option("last 20 device cycles of a flight's recording, as of a file that ends with a fault", _CYCLES)
    ] = False,
    all: Annotated[bool, option("all 200 device cycles", _CYCLES)] = False,
    json: Annotated[str | None, json_of()] = None,
    *,
    pictures: Pictures,
    axis: Annotated[
        str | None,
        option("axis of the charts (default: the scene's, or one with wall contact)", "output", "NAME"),
    ] = None,
) -> int:
    """Figures 5, 6 and 9 of the paper from a recording, compared with its simulation; or the cause of a fault.

    docs/explanation/analysis.md explains each figure. Of fault-TIME.maglev, written by a flight, it shows cause, time
    and last device cycles.
    """
    from maglev_mj.parameters import axis_indices
    from maglev_mj.recording import InvalidRecordingError, Recording

    of_samples = {"segment": segment, "from": begin, "to": end, "scene": scene, "axis": axis}
    show_cycles = partial(_show_cycles, file, all, of_samples, json, pictures)
    if cycles or all:
        return show_cycles()
    if axis is not None:
        axis_indices(axis)
    with Progress("analyse") as progress:
        recording = Recording.load(file)
        if not recording.segments:
            with suppress(InvalidRecordingError):  # neither: the next check says so
                return show_cycles()
        several = len(recording.segments) > 1
        with progress.aside():
            own = _own_code(scene, recording)
        segments = _chosen(recording, file, segment, is_part=bool(begin) or end is not None)
        reports: list[tuple[int, SegmentReport]] = []
        for index, part in segments:
            reports.append((index, _report(part, begin or 0.0, end, compare, own)))
            if len(segments) > 1:
                progress(len(reports), len(segments))
    for _, report in reports:
        report.axis(axis)  # before any file is written
    if json is not None:
        write_json(json, _as_json(file, recording, reports))
    drawn = []
    if pictures is not None:
        for index, report in reports:
            drawn += _draw(report, axis, pictures, f"segment_{index}_" if several else "analysis_")
    if json != "-":
        heads = [f"segment {index} of {len(recording.segments)}\n" if several else "" for index, _ in reports]
        print("\n\n".join(f"{head}{report.table()}" for head, (_, report) in zip(heads, reports)))
        damage = [f"{file}: {recording.damage}"] if recording.damage else []
        for line in [*damage, *recording.events, *drawn]:
            print("\n".join(wrapped(printable(line), further="    ")))
    return 0


def _show_cycles(
    file: Path, all: bool, of_samples: Mapping[str, object], json: str | None, pictures: PictureFolder | None
) -> int:
    """Show cause, time and last device cycles of a fault, or of the end of a flight.

    Raises:
        InvalidRecordingError: If the file has no cycles.
        ParameterError: If an option for samples is set.
    """
    from maglev_mj.bridge.fault import load_fault

    record = load_fault(file)
    for name, value in of_samples.items():
        if value is not None:
            raise ParameterError(f"{name} applies to samples, not to device cycles (got {value})")
    draw = partial(lambda folder: [] if folder is None else [folder.plot(record, file.stem)], pictures)
    write_results(json, record.as_json, lambda: str(record.table(whole=all)), draw)
    return 0


def _as_json(file: Path, recording: Recording, reports: Sequence[tuple[int, SegmentReport]]) -> dict[str, Any]:
    from maglev_mj.versions import validated_versions

    data = []
    for index, report in reports:
        recorded = validated_versions(recording.segments[index - 1].setup.get("versions"))
        data.append({"segment": index, "versions": recorded, **report.as_json()})
    about = {"file": str(file), "damage": recording.damage, "events": list(recording.events)}
    return {**about, "segments": data}


def _chosen(recording: Recording, file: Path, number: int | None, *, is_part: bool) -> list[tuple[int, Segment]]:
    """Return the numbers, from 1, and segments to analyse.

    Raises:
        InvalidRecordingError: If the recording has no samples.
        ParameterError: If there is no such segment, or from and to are ambiguous.
    """
    from maglev_mj.parameters import whole
    from maglev_mj.recording import InvalidRecordingError

    recording.require_samples(file)
    segments = recording.segments
    usable = [(index, segment) for index, segment in enumerate(segments, start=1) if len(segment.tick) > 1]
    if not usable:
        raise InvalidRecordingError(f"{str(file)!r} contains no segment to analyse")
    if number is not None:
        index = whole("segment", number, at_least=1, at_most=len(segments))
        return [(index, segments[index - 1])]
    if len(usable) > 1 and is_part:
        raise ParameterError(f"from and to refer to one segment: choose one of {len(segments)} by --segment")
    return usable


def _report(segment: Segment, begin: float, end: float | None, compare: bool, own: UserCode | None) -> SegmentReport:
    from maglev_mj.analysis import analyse
    from maglev_mj.session.replay import rebuild_for, stick_positions_of, unsimulated_plant

    rebuilt = rebuild_for(segment, own)
    anchors = stick_positions_of(segment, rebuilt)
    simulated = compare and not unsimulated_plant(segment, own)
    scene = own.scene if own else None
    return analyse(segment, rebuilt, anchors=anchors, scene=scene, begin=begin, end=end, simulated=simulated)


def _draw(analysed: SegmentReport, axis: str | None, pictures: PictureFolder, stem: str) -> list[str]:
    """Draw the charts of a segment; return a line for each written or omitted chart."""
    from maglev_mj.frames import AXES

    drawn, name = analysed.pictures, AXES[analysed.axis(axis)]
    touched = any(face.axis == name for face in analysed.recorded.figures.faces)
    omitted = {"contact": f"no wall contact on {name}: contact chart omitted"} if not touched else {}
    omitted |= {} if "sticks" in drawn else {"sticks": "no friction: chart of stick positions omitted"}
    lines = [
        f"wrote {pictures.plot(analysed, f'{stem}{kind}', picture=kind, axis=axis)}"
        for kind in drawn
        if kind not in omitted
    ]
    return [*lines, *omitted.values()]
