"""`maglev-mj replay`: a recording shown in a window, or checked bit for bit."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from maglev_mj.recording import InvalidRecordingError, Recording, verify
from maglev_mj.replay import Replay, expected, rebuild
from maglev_mj.tables import verdict_table
from maglev_mj.terminal import say

__all__ = ["add_command"]


def add_command(commands: Any) -> None:
    """Add the command to the parser's."""
    replay = commands.add_parser("replay", help="show a recording, or check it bit for bit")
    replay.add_argument("file", metavar="FILE", type=Path, help="what view, bridge, drop, press or stick-slip recorded")
    replay.add_argument(
        "--check",
        action="store_true",
        help="feed the samples to the controller and the hand to the plant; status 1 if any number differs, or the "
        "file is not whole",
    )
    replay.set_defaults(run=_replay)


def _replay(options: argparse.Namespace) -> int:
    recording = Recording.load(options.file)
    if not recording.ticks:
        raise InvalidRecordingError(f"there is nothing in {str(options.file)!r}")
    if recording.damage:
        say(f"  {options.file}: {recording.damage}; {recording.ticks} samples are there")
    for event in recording.events:
        say(f"  {event}")
    if options.check:
        verdict = verify(recording, rebuild, expect=expected)
        print(verdict_table(verdict))
        return 0 if verdict.same else 1
    session = Replay(recording)
    # imported here: it loads the library that opens windows
    from maglev_mj.viewer.window import show

    show(session)
    return 0
