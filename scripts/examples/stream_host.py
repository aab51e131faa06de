"""A graphical host of the pose stream, in a terminal: shows where the flotor is, and sets a wall.

    python scripts/examples/stream_host.py --alone                 # with a scene of its own, moved by its scripted hand
    python scripts/examples/stream_host.py [udp://HOST:PORT] [--key FILE]

It asks for a wall as stiff as --stiffness says. Where that is refused, the figures of the refusal say how stiff one may
be, and it asks for half of that. Where the flotor is behind its edge, it asks again when the flotor has come out.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import textwrap
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from maglev_mj.cli.options import Parser, chosen_key, number_option
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.parameters import number
from maglev_mj.scenes import BUILT_IN, find_scene
from maglev_mj.session import Session
from maglev_mj.stream import Answer, PoseStream, StreamClient

LENGTH, ANGLE = 5e-3, math.radians(6.0)
HALF = 24
WIDTH = 110
EACH = 0.1
FRAME = 1.0 / 120.0


def line(axis: str, pose: dict[str, Any], faces: Sequence[Sequence[Any]]) -> str:
    """Return one axis: its position as a figure and on a scale with its walls, and both forces."""
    turns = axis.startswith("r")
    limit, scale, unit = (ANGLE, 180.0 / math.pi, "°") if turns else (LENGTH, 1e3, "mm")
    force, force_scale, force_unit = ("torque", 1e3, "mN m") if turns else ("force ", 1.0, "N")

    def place(value: float) -> int:
        return min(max(round(HALF * (1.0 + value / limit)), 0), 2 * HALF)

    cells = ["·"] * (2 * HALF + 1)
    cells[HALF] = "┼"
    position, inside = pose["pose"][axis], False
    for on, normal, edge in faces:
        if on == axis:
            cells[place(edge)] = "┃"
            inside = inside or normal * (position - edge) < 0.0
    cells[place(position)] = "◆" if inside else "●"
    return (
        f"  {axis:<2} {position * scale:+7.3f} {unit:<2}  {''.join(cells)}  {force} "
        f"{pose['force'][axis] * force_scale:+7.2f}   hand {pose['hand'][axis] * force_scale:+7.2f} {force_unit}"
    )


def picture(pose: dict[str, Any], faces: Sequence[Sequence[Any]]) -> list[str]:
    """Return what there is to see: a heading, and a line for each axis."""
    heading = f"  {pose['state']}, {pose['time']:.2f} s, tick {pose['tick']}, {pose['missed']} missed"
    reason = f": {pose['reason']}" if pose["reason"] else ""
    return [heading + reason, *(line(axis, pose, faces) for axis in pose["pose"])]


def watch(client: StreamClient, seconds: float) -> None:
    """Show poses for so long [s]; in a terminal ten times a second in one place, else once, at the end."""
    faces, end, due, drawn = client.describe()["faces"], time.monotonic() + seconds, 0.0, 0
    last: list[str] = []
    for pose in client.poses():
        now, last = time.monotonic(), picture(pose, faces)
        if sys.stdout.isatty() and now >= due:
            print(f"\033[{drawn}A" * bool(drawn) + "\n".join(f"{text}\033[K" for text in last), flush=True)
            drawn, due = len(last), now + EACH
        if now >= end:
            break
    if not drawn:
        print("\n".join(last), flush=True)


def say(wish: dict[str, Any], answer: Answer) -> None:
    """Print what was asked for, and what came of it."""
    print("\nset " + json.dumps(wish))
    if not answer.reason:
        print(f"  in force from tick {answer.since} on")
        return
    print(textwrap.fill(f"refused: {answer.reason}", WIDTH, initial_indent="  ", subsequent_indent="    "))
    for name, value in (answer.figures or {}).items():
        print(f"    {name:<15}{value if isinstance(value, str) else f'{value:.6g}'}")


def converse(client: StreamClient, options: argparse.Namespace) -> None:
    """Show poses, set the wall, and show them again."""
    told = client.describe()
    settings = told["settings"]
    print(f"{told['scene']}: {told['says']}")
    print(f"  {1.0 / settings['period']:.4g} Hz, {settings['delay'] * 1e3:.3g} ms of delay\n")
    watch(client, 0.5 * options.seconds)
    wish = {"walls": [["x", -1, options.edge]], "wall": True, "stiffness": options.stiffness}
    answer = client.set(**wish)
    say(wish, answer)
    if answer.figures is not None and answer.figures["largest_stable"]:
        share = 0.5 * answer.figures["largest_stable"] / answer.figures["stiffness"]
        wish["stiffness"] = float(f"{share * options.stiffness:.3g}")
        answer = client.set(**wish)
        say(wish, answer)
    if answer.reason and answer.figures is None:  # it would push the flotor, which is behind its edge
        next(pose for pose in client.poses() if pose["pose"]["x"] < options.edge)
        say(wish, client.set(**wish))
    print()
    watch(client, 0.5 * options.seconds)


@contextmanager
def alone(name: str) -> Iterator[str]:
    """Run a scene in its scripted hand, in a thread; yield where its stream is."""
    scene, stopped = find_scene(name)(), threading.Event()
    stream = PoseStream("udp://127.0.0.1:0")
    session = Session(scene, hand=scene.scripted_hand(), publishers=[stream])

    def go_on() -> None:
        last = time.perf_counter()
        while not stopped.wait(FRAME):
            now = time.perf_counter()
            session.tick(now - last)
            last = now

    thread = threading.Thread(target=go_on)
    thread.start()
    try:
        yield f"udp://127.0.0.1:{stream.address[1]}"
    finally:
        stopped.set()
        thread.join()
        session.close()


def main() -> int:
    """Be a host; return the exit status."""
    description, _, epilog = (__doc__ or "").partition("\n")
    parser = Parser(description=description, epilog=epilog, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("url", nargs="?", default="udp://127.0.0.1:5680", help="of the stream (default %(default)s)")
    parser.add_argument("--key", metavar="FILE", type=Path, help="secret of 16 to 32 bytes as hexadecimal digits")
    parser.add_argument("--alone", action="store_true", help="run a scene here, instead of one that runs elsewhere")
    parser.add_argument(
        "--scene", default="joystick", metavar="SCENE", help=f"with --alone: one of {', '.join(BUILT_IN)}"
    )
    parser.add_argument("--stiffness", type=number_option, default=60000.0, metavar="X", help="of the wall [N/m]")
    parser.add_argument("--edge", type=number_option, default=0.001, metavar="X", help="where it begins, along x [m]")
    parser.add_argument("--seconds", type=number_option, default=5.0, metavar="X", help="how long to watch [s]")
    options = parser.parse_args()
    try:
        number("seconds", options.seconds, above=0.0)
        key = chosen_key(options.key)
        if options.alone:
            with alone(options.scene) as url, StreamClient(url) as client:
                converse(client, options)
        else:
            with StreamClient(options.url, key=key) as client:
                converse(client, options)
    except MaglevError as error:
        print(f"stream_host.py: {error}", file=sys.stderr)
        return 2 if isinstance(error, ParameterError) else 1
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
