"""`maglev-mj replay`: a recording shown in a window, or checked bit for bit."""

from __future__ import annotations

import argparse
import sys
from functools import partial
from pathlib import Path
from typing import Any

from maglev_mj.recording import InvalidRecordingError, Recording, verify
from maglev_mj.replay import Replay, expected, rebuild
from maglev_mj.scenes.find import find_scene, source_of
from maglev_mj.scenes.scene import Scene
from maglev_mj.tables import verdict_table
from maglev_mj.terminal import say

__all__ = ["add_command", "add_own_scene", "own_scene"]


def add_command(commands: Any) -> None:
    """Add the command to the parser's."""
    replay = commands.add_parser("replay", help="show a recording, or check it bit for bit")
    replay.add_argument("file", metavar="FILE", type=Path, help="a recording of run, view or bridge")
    replay.add_argument(
        "--check",
        action="store_true",
        help="feed the samples to the controller and the hand to the plant; status 1 if any number differs, or the "
        "file is not whole",
    )
    add_own_scene(replay)
    replay.set_defaults(run=_replay)


def add_own_scene(parser: argparse.ArgumentParser) -> None:
    """Add the option for the scene of a recording."""
    said = "scene of a recording of one's own, NAME, FILE.py or FILE.py:CLASS, which is executed, to run it again"
    parser.add_argument("--scene", metavar="SCENE", help=said)


def own_scene(text: str | None, recording: Recording) -> type[Scene] | None:
    """Return the scene that was given for a recording; None for none. Say so if its file has changed since.

    Raises:
        ParameterError: If there is no such scene.
    """
    if text is None:
        return None
    scene = find_scene(text)
    sources = {stretch.setup["source"] for stretch in recording.stretches if "source" in stretch.setup}
    if sources - {source_of(scene)}:
        say(f"  {text} is not the file that was recorded: it has changed since, or is another", sys.stderr)
    return scene


def _replay(options: argparse.Namespace) -> int:
    recording = Recording.load(options.file)
    if not recording.ticks:
        raise InvalidRecordingError(f"there is nothing in {str(options.file)!r}")
    if recording.damage:
        say(f"  {options.file}: {recording.damage}; {recording.ticks} samples are there")
    for event in recording.events:
        say(f"  {event}")
    scene = own_scene(options.scene, recording)
    if options.check:
        verdict = verify(recording, partial(rebuild, scene=scene), expect=expected)
        print(verdict_table(verdict))
        return 0 if verdict.same else 1
    session = Replay(recording, scene)
    # imported here: it loads the library that opens windows
    from maglev_mj.viewer.window import show

    show(session)
    return 0
