"""`maglev-mj serve-spacenav`: a scene in a scripted hand as the 3D mouse of other programs, without a window."""

from __future__ import annotations

import argparse
import pathlib
import threading
import time
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any

from maglev_mj.bridge.realtime import stopping
from maglev_mj.cli.options import add_settings, chosen_key, chosen_settings, number_option
from maglev_mj.cli.outlets import add_spacenav, chosen_spacenav
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.hand import Path, SpringHand
from maglev_mj.parameters import number
from maglev_mj.plants import engine_warnings_silenced
from maglev_mj.scenes import SCENES, scene_called
from maglev_mj.session import Session
from maglev_mj.spacenav import SpacenavServer
from maglev_mj.stream import StreamClient
from maglev_mj.terminal import say

__all__ = ["add_command"]

_STEP = 1.0 / 240.0
_TAIL = 0.4
_STANDSTILL = 1.0


def add_command(commands: Any) -> None:
    """Add the command to the parser's."""
    serve = commands.add_parser("serve-spacenav", help="a scene in a scripted hand as the 3D mouse of other programs")
    scenes = f"one of {', '.join(SCENES)} (default joystick)"
    serve.add_argument("scene", nargs="?", metavar="SCENE", help=scenes)
    add_spacenav(serve, always=True)
    serve.add_argument(
        "--from",
        dest="source",
        metavar="ADDRESS",
        help="the pose stream of a view or a bridge that runs with --stream, in place of a scene of its own",
    )
    serve.add_argument("--key", metavar="FILE", type=pathlib.Path, help="the secret of that stream, if it has one")
    serve.add_argument("--seconds", type=number_option, metavar="X", help="end after so long [s]")
    add_settings(serve)
    serve.set_defaults(run=_serve)


@dataclass(frozen=True, eq=False)
class _Again(Path):
    """A path that begins anew at its end, after a rest."""

    def at(self, time: float) -> list[float]:
        """Return the pose at a time [s]."""
        return super().at(time % (self.end + _TAIL))


def _serve(options: argparse.Namespace) -> int:
    if options.scene is not None and options.source is not None:
        raise ParameterError(f"scene must be that of the stream with --from, not {options.scene!r}")
    scene = scene_called(options.scene or "joystick")
    settings = chosen_settings(options, replace(scene.settings, friction=True))
    key = chosen_key(options.key)
    if key is not None and options.source is None:
        raise ParameterError("key is for --from")
    seconds = None if options.seconds is None else number("seconds", options.seconds, above=0.0)
    script = None if scene.script is None else _Again(scene.script.times, scene.script.poses)
    servers = chosen_spacenav(options, say)
    ended = threading.Event()
    with ExitStack() as stack:
        stack.callback(servers[0].close)
        if options.source is not None:
            client = stack.enter_context(StreamClient(options.source, key=key))
            with stopping(ended.set):
                _follow(client, servers[0], ended, seconds)
            return _done(servers[0])
        session = Session(scene.name, settings=settings, hand=SpringHand(target=script), outlets=servers)
        stack.callback(session.close)
        with engine_warnings_silenced(), stopping(ended.set):
            _run(session, ended, seconds)
    return _done(servers[0])


def _follow(client: StreamClient, server: SpacenavServer, ended: threading.Event, seconds: float | None) -> None:
    """Show what a stream tells until it is over."""
    start = time.perf_counter()
    for moment in client.moments():
        server.show(moment)
        if ended.is_set() or (seconds is not None and time.perf_counter() - start >= seconds):
            return


def _run(session: Session, ended: threading.Event, seconds: float | None) -> None:
    """Keep real time until it is over."""
    start = before = moved = time.perf_counter()
    while not ended.wait(_STEP):
        now = time.perf_counter()
        if session.tick(now - before):
            moved = now
        if now - moved > _STANDSTILL:
            raise MaglevError("; ".join(session.view().notes))
        before = now
        if seconds is not None and now - start >= seconds:
            return


def _done(server: SpacenavServer) -> int:
    print(f"  {server.sent} events, {server.dropped} programs dropped, {server.refused} refused")
    return 0
