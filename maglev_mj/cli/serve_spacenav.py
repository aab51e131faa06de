"""`maglev-mj serve-spacenav`: a scene in a scripted hand as the 3D mouse of other programs, without a window."""

from __future__ import annotations

import argparse
import threading
from collections.abc import Sequence
from contextlib import ExitStack
from typing import Any

from maglev_mj.bridge.realtime import stopping
from maglev_mj.cli.options import number_option
from maglev_mj.cli.scenes import add_scene, chosen_scene
from maglev_mj.cli.spacenav import add_spacenav, chosen_spacenav
from maglev_mj.errors import MaglevError
from maglev_mj.frames import Component
from maglev_mj.hand import HandForce, SpringHand
from maglev_mj.parameters import number
from maglev_mj.plants import engine_warnings_silenced
from maglev_mj.session import Session, real_time
from maglev_mj.terminal import say

__all__ = ["add_command"]

_STEP = 1.0 / 240.0
_STANDSTILL = 1.0


def add_command(commands: Any) -> None:
    """Add the command to the parser's."""
    serve = commands.add_parser("serve-spacenav", help="a scene in a scripted hand as the 3D mouse of other programs")
    add_spacenav(serve, always=True)
    serve.add_argument("--seconds", type=number_option, metavar="X", help="end after so long [s]")
    add_scene(serve, default="joystick")
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
    scene = chosen_scene(options, friction=True)
    seconds = None if options.seconds is None else number("seconds", options.seconds, above=0.0)
    script = scene.scripted_hand()
    servers = chosen_spacenav(options, say)
    ended = threading.Event()
    with ExitStack() as stack:
        stack.callback(servers[0].close)
        session = Session(scene, hand=SpringHand() if script is None else _Again(script, scene.end), publishers=servers)
        stack.callback(session.close)
        with engine_warnings_silenced(), stopping(ended.set):
            _run(session, ended, seconds)
    print(f"  {servers[0].sent} events, {servers[0].dropped} programs dropped, {servers[0].refused} refused")
    return 0


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
