"""`maglev-mj serve-spacenav`: a scene in a scripted hand as the 3D mouse of other programs, without a window."""

from __future__ import annotations

import argparse
import pathlib
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack
from typing import Any

from maglev_mj.bridge.realtime import stopping
from maglev_mj.cli.options import chosen_key, number_option
from maglev_mj.cli.scenes import add_scene, chosen_scene
from maglev_mj.cli.spacenav import add_spacenav, chosen_spacenav
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.frames import Component
from maglev_mj.hand import HandForce, SpringHand
from maglev_mj.parameters import number
from maglev_mj.plants import engine_warnings_silenced
from maglev_mj.session import Session, real_time
from maglev_mj.spacenav import SpacenavServer
from maglev_mj.stream import StreamClient
from maglev_mj.terminal import say

__all__ = ["add_command"]

_SCENE = "joystick"

_STEP = 1.0 / 240.0
_STANDSTILL = 1.0


def add_command(commands: Any) -> None:
    """Add the command to the parser's."""
    serve = commands.add_parser("serve-spacenav", help="a scene in a scripted hand as the 3D mouse of other programs")
    add_spacenav(serve, always=True)
    serve.add_argument(
        "--from",
        dest="source",
        metavar="ADDRESS",
        help="the pose stream of a view or a bridge that runs with --stream, in place of a scene of its own",
    )
    serve.add_argument("--key", metavar="FILE", type=pathlib.Path, help="the secret of that stream, if it has one")
    serve.add_argument("--seconds", type=number_option, metavar="X", help="end after so long [s]")
    add_scene(serve, default=_SCENE)
    serve.set_defaults(run=_serve)


class _Again:
    """A hand that begins anew when the scene's time is over.

    Args:
        hand: The hand.
        end: When it is [s].
    """

    def __init__(self, hand: HandForce, end: float) -> None:
        self._hand, self._end, self.hand = hand, end, getattr(hand, "hand", None)

    def __call__(self, tick: int, time: Component, state: Any) -> Sequence[Component]:
        """See `HandForce`."""
        return self._hand(tick, time % self._end, state)


def _serve(options: argparse.Namespace) -> int:
    if options.scene != _SCENE and options.source is not None:
        raise ParameterError(f"scene must be that of the stream with --from, not {options.scene!r}")
    scene = chosen_scene(options, friction=True)
    key = chosen_key(options.key)
    if key is not None and options.source is None:
        raise ParameterError("key is for --from")
    seconds = None if options.seconds is None else number("seconds", options.seconds, above=0.0)
    script = scene.scripted_hand()
    servers = chosen_spacenav(options, say)
    ended = threading.Event()
    with ExitStack() as stack:
        stack.callback(servers[0].close)
        if options.source is not None:
            client = stack.enter_context(StreamClient(options.source, key=key))
            with stopping(ended.set):
                _follow(client, servers[0], ended, seconds)
            return _done(servers[0])
        session = Session(scene, hand=SpringHand() if script is None else _Again(script, scene.end), publishers=servers)
        stack.callback(session.close)
        with engine_warnings_silenced(), stopping(ended.set):
            _run(session, ended, seconds)
    return _done(servers[0])


def _follow(client: StreamClient, server: SpacenavServer, ended: threading.Event, seconds: float | None) -> None:
    """Show what a stream tells until it is over."""
    start = time.perf_counter()
    for snapshot in client.snapshots():
        server.show(snapshot)
        if ended.is_set() or (seconds is not None and time.perf_counter() - start >= seconds):
            return


def _run(session: Session, ended: threading.Event, seconds: float | None) -> None:
    """Keep real time until it is over."""
    moved = 0.0
    for elapsed, now in real_time(seconds, _STEP):
        if session.tick(elapsed):
            moved = now
        if now - moved > _STANDSTILL:
            raise MaglevError("; ".join(session.snapshot().notes))
        if ended.is_set():
            return


def _done(server: SpacenavServer) -> int:
    print(f"  {server.sent} events, {server.dropped} programs dropped, {server.refused} refused")
    return 0
