"""`maglev-mj serve-spacenav`: a scene as 3D mouse, without a window.

A scripted hand moves it.
"""

from __future__ import annotations

import argparse
import math
import threading
from collections.abc import Sequence
from contextlib import closing
from typing import Any

from maglev_mj.bridge.realtime import stopping
from maglev_mj.cli.arguments import Parser
from maglev_mj.cli.options import number_option
from maglev_mj.cli.scenes import add_scene, chosen_scene
from maglev_mj.cli.spacenav import add_spacenav, chosen_spacenav
from maglev_mj.errors import MaglevError
from maglev_mj.frames import AXES, Component
from maglev_mj.parameters import number
from maglev_mj.plants import engine_warnings_silenced
from maglev_mj.plants.hand import HandForce, SpringHand, Trajectory
from maglev_mj.scenes import Scene
from maglev_mj.session import Session, real_time
from maglev_mj.terminal import say

_SCENE = "joystick"

_STEP = 1.0 / 240.0
_STANDSTILL = 1.0
_OUT, _TURNED = 0.003, math.radians(3.5)
_QUARTER = 0.5


def add_options(parser: Parser) -> None:
    """Add the options of the command."""
    parser.description = "A scene in a scripted hand as the 3D mouse of other programs, without a window."
    add_scene(parser, default=_SCENE)
    add_spacenav(parser, always=True)
    parser.group("run").add_argument("--seconds", type=number_option, metavar="X", help="end after so long [s]")
    parser.set_defaults(run=_serve)


def tour() -> Trajectory:
    """Return a path along each axis in turn, both ways.

    The deflections add up to zero on every axis, so a program that takes them for speeds ends at its start.
    """
    turns = [(axis, sign) for axis in range(len(AXES)) for sign in (1.0, -1.0, 0.0)]
    gaps = {1.0: _QUARTER, -1.0: 2.0 * _QUARTER, 0.0: _QUARTER}
    times, poses = [0.0], [[0.0] * len(AXES)]
    for axis, sign in turns:
        pose = [0.0] * len(AXES)
        pose[axis] = sign * (_OUT if axis < 3 else _TURNED)
        times.append(times[-1] + gaps[sign])
        poses.append(pose)
    return Trajectory(times, poses)


class _Again:
    """Hand that starts again at the end of the scene.

    Args:
        hand: The hand.
        end: End of the scene [s].
    """

    def __init__(self, hand: HandForce, end: float) -> None:
        self._hand, self._end, self.hand = hand, end, getattr(hand, "hand", None)

    def __call__(self, tick: int, time: Component, state: Any) -> Sequence[Component]:
        """See `HandForce`."""
        return self._hand(tick, time % self._end, state)


def _hand(scene: Scene) -> HandForce:
    """Return the scene's own hand, repeated.

    The joystick gets a hand that returns a view to its start.
    """
    if scene.name == _SCENE:
        path = tour()
        return _Again(SpringHand(stiffness=1000.0, turning_stiffness=3.0, target=path), path.end)
    script = scene.scripted_hand()
    return SpringHand() if script is None else _Again(script, scene.end)


def _serve(options: argparse.Namespace) -> int:
    # a 3D mouse returns to the centre by itself; a slave is moved without that
    scene = chosen_scene(options, friction=options.axes == "rate")
    seconds = None if options.seconds is None else number("seconds", options.seconds, above=0.0)
    (server,) = chosen_spacenav(options, say)
    ended = threading.Event()
    with closing(server), closing(Session(scene, hand=_hand(scene), publishers=[server])) as session:
        with engine_warnings_silenced(), stopping(ended.set):
            _run(session, ended, seconds)
    print(
        f"  {server.sent} events, {server.missed} missed, {server.dropped} programs dropped, {server.refused} refused"
    )
    return 0


def _run(session: Session, ended: threading.Event, seconds: float | None) -> None:
    """Run in real time until the end."""
    moved = 0.0
    for elapsed, now in real_time(seconds, _STEP):
        if session.tick(elapsed):
            moved = now
        if now - moved > _STANDSTILL:
            raise MaglevError("; ".join(session.snapshot().notes))
        if ended.is_set():
            return
