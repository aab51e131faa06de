"""`maglev-mj replay`: a recording shown, or verified bitwise."""

from __future__ import annotations

import argparse
import sys
from functools import partial
from pathlib import Path

from maglev_mj.cli.arguments import Container, Parser
from maglev_mj.cli.progress import Progress
from maglev_mj.cli.web import add_web, chosen_page, show_session
from maglev_mj.recording import InvalidRecordingError, OwnCodeError, Recording, RecordingError
from maglev_mj.recording.verify import first_other_answer, verify
from maglev_mj.session.replay import OwnCode, Replay, expected, rebuild, unmade_plant
from maglev_mj.terminal import printable, say, wrapped
from maglev_mj.versions import differences, versions, versions_read

_COMPARED, _LEAST_COMPARED = 10_000, 10
"""Commands compared before other code's recording is shown.

In all, and the least number of each stretch.
"""


def add_options(parser: Parser) -> None:
    """Add the options of the command."""
    parser.add_argument("file", metavar="FILE", type=Path, help="a recording of run, view or bridge")
    group = parser.group("run")
    group.add_argument(
        "--check",
        action="store_true",
        help="feed the samples to the controller and the hand to the plant; status 1 if any number differs, or the "
        "file is not whole",
    )
    add_own_scene(group)
    add_web(parser)
    parser.set_defaults(run=_replay)


def add_own_scene(parser: Container) -> None:
    """Add the option for user code in a recording."""
    said = (
        "scene or laws of one's own, which are executed: NAME, FILE.py, FILE.py:CLASS, or attached for what the "
        "recording holds"
    )
    parser.add_argument("--scene", metavar="SCENE", help=said)


def own_code(text: str | None, recording: Recording) -> OwnCode | None:
    """Return the code given for a recording; None without.

    A message is printed if it differs from the recorded code.

    Raises:
        ParameterError: If there is no such code.
    """
    if text is None:
        return None
    own = OwnCode(text, recording)
    if own.changed:
        say(f"  {text} is not the file that was recorded: it has changed since, or is another", sys.stderr)
    return own


def _replay(options: argparse.Namespace) -> int:
    with Progress("replay"):
        recording = Recording.load(options.file)
    if not recording.ticks:
        raise InvalidRecordingError(f"there is nothing in {str(options.file)!r}")
    if recording.damage:
        say(f"  {options.file}: {recording.damage}; {recording.ticks} samples are there")
    for event in recording.events:
        print("\n".join(wrapped(printable(event), further="    ")))
    own = own_code(options.scene, recording)
    if options.check:
        with Progress("replay"):
            verdict = verify(recording, partial(rebuild, own=own), expect=expected)
        print(verdict)
        simulated = (stretch.setup for stretch in recording.stretches if stretch.setup["kind"] != "device")
        for plant in sorted({unmade_plant(setup) for setup in simulated} - {""}):
            for line in wrapped(
                f"the plant, {plant}, cannot be made here: the controller's answers alone are compared"
            ):
                say(line)
        return 0 if verdict.same else 1
    if note := _other_code(recording, own):
        for line in wrapped(f"{options.file}: {note}", further="    "):
            say(line)
    show_session(Replay(recording, own), chosen_page(options, drag=False, settings=False))
    return 0


def _other_code(recording: Recording, own: OwnCode | None) -> str:
    """Return a note if other code made a recording.

    Else "". The first answers of each stretch are compared.

    Raises:
        RecordingError: If an answer differs.
    """
    here, stretches = versions(), recording.stretches
    theirs = (differences(versions_read(stretch.setup.get("versions")) or {}, here) for stretch in stretches)
    difference = next(filter(None, theirs), "")
    if not difference:
        return ""
    said, most = f"recorded by other code ({difference})", max(_COMPARED // len(stretches), _LEAST_COMPARED)
    try:
        other = first_other_answer(recording, partial(rebuild, own=own), most)
    except OwnCodeError:
        return f"{said}; its laws were not run again, for they are none of this package's"
    if other is not None:
        stretch, tick, field = other
        raise RecordingError(f"{said}, whose {field} is another from tick {tick} of stretch {stretch + 1} on")
    return f"{said}; the first {most} answers of each stretch are the same here"
