"""Cost of a browser to the control loop, and latency.

    python scripts/benchmarks/bench_web.py [--seconds X] [--rate HZ ...] [--size WIDTHxHEIGHT]

A session runs in this process, its page in another, and Chromium draws it by software and jerks the knob about, three
times a second: ticks made and missed, the longest time between two turns of the loop, frames drawn, and the time from
the browser's own stamp of a move to the first control tick that had the target it led to. That target is reached 50 ms
later. With nobody watching, the same without a browser.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from bisect import bisect_left
from typing import Any

import numpy as np

from maglev_mj.plants import engine_warnings_silenced
from maglev_mj.plants.shapes import GRIP
from maglev_mj.scenes.rooms import Joystick
from maglev_mj.session import Session, real_time
from maglev_mj.session.access import listen
from maglev_mj.views.page.page import Door, page
from maglev_mj.views.page.stage import FIELD, placed
from maglev_mj.views.viewer_process import RemoteViewer
from tests.views.browser import MISSING, chromium, on_screen

RATES = 200.0, 1000.0
NAP, BETWEEN = 0.001, 0.33
READY = 40.0
WATCH = """
window.moves = []; window.frames = 0;
addEventListener('pointermove', e => moves.push((performance.timeOrigin + e.timeStamp) / 1000), true);
for (const name of ['drawElements', 'drawArrays']) {
  const draw = WebGL2RenderingContext.prototype[name];
  WebGL2RenderingContext.prototype[name] = function (...a) { window.drawn = true; return draw.apply(this, a); };
}
(function turn() { if (window.drawn) { frames++; window.drawn = false; } requestAnimationFrame(turn); })();
"""


def drive(url: str, seconds: float, size: dict[str, int]) -> None:
    """Move the knob in steps; print latency and frame rate."""
    random = np.random.default_rng(0)
    with chromium() as browser:
        tab = browser.new_context(viewport=size).new_page()
        tab.add_init_script(WATCH)
        tab.goto(url, wait_until="domcontentloaded")
        tab.wait_for_selector("text=joystick", timeout=60_000)
        tab.add_style_tag(content=".mantine-Notifications-root{display:none}")
        time.sleep(5.0)
        box = tab.locator("canvas").last.bounding_box()
        x, y = on_screen(tab, GRIP, placed("home", box["width"], box["height"]), FIELD)
        tab.mouse.move(x, y)
        tab.mouse.down()
        tab.mouse.move(x + 8, y, steps=4)
        print("ready", flush=True)
        tab.evaluate("moves.length = 0; frames = 0")
        begun = time.monotonic()
        while time.monotonic() - begun < seconds:
            tab.mouse.move(x + float(random.integers(-60, 60)), y + float(random.integers(-30, 30)))
            time.sleep(BETWEEN)
        moves, frames = tab.evaluate("[moves, frames]")
        tab.mouse.up()
        print(json.dumps({"moves": moves, "frames": frames / (time.monotonic() - begun)}), flush=True)


def measured(rate: float, options: argparse.Namespace) -> str:
    """Return a line on one rate."""
    listener = listen(0)
    door = Door("127.0.0.1", listener.getsockname()[1])
    session = Session(Joystick(period=1.0 / rate))
    viewer: Any = RemoteViewer(session.snapshot(), page(door, listener))
    words = [sys.executable, __file__, "--drive", door.url, "--seconds", str(options.seconds), "--size", options.size]
    browser = None if options.alone else subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    aims: list[float] = []
    goal, aimed, longest, last, ticks, missed = None, 0.0, 0.0, 0.0, 0, 0
    begun = time.perf_counter() + (0.0 if browser is None else READY)
    with engine_warnings_silenced():
        for elapsed, passed in real_time(None, NAP):
            if session.tick(elapsed) and aimed:
                aims.append(time.time())
                aimed = 0.0
            viewer.serve(session)
            if viewer._glide._goal != goal:
                goal = viewer._glide._goal
                aimed = time.time()
            if goal is not None and time.perf_counter() < begun:  # taken hold of: it begins
                begun = time.perf_counter()
            if (now := time.perf_counter()) < begun:
                ticks, missed, last = session._ticks, session.snapshot().missed, passed
            else:
                longest, last = max(longest, passed - last), passed
            if now - begun > options.seconds + 1.0:
                break
    ticks, missed = session._ticks - ticks, session.snapshot().missed - missed
    viewer.close()
    session.close()
    line = f"  {rate:5.0f} Hz  {ticks} ticks, {missed} missed, longest turn {1e3 * longest:.1f} ms"
    if browser is None:
        return line
    said = browser.communicate(timeout=60.0)[0].splitlines()
    if len(said) < 2:
        return f"{line}; the browser failed"
    told = json.loads(said[1])
    found = [bisect_left(aims, move) for move in told["moves"]]
    late = [1e3 * (aims[place] - move) for place, move in zip(found, told["moves"]) if place < len(aims)]
    felt = [one for one in late if one < 1e3 * BETWEEN]
    shares = f"median {np.median(late):.0f} ms, 99 % {np.percentile(late, 99.0):.0f} ms"
    return (
        f"{line}; {told['frames']:.1f} frames a second; {len(late)} moves, to the force {shares}, "
        f"{len(late) - len(felt)} later than the next move"
    )


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, metavar="X", help="for each line (default 60)")
    parser.add_argument("--rate", type=float, nargs="+", default=RATES, metavar="HZ", help="sample rates")
    parser.add_argument("--size", default="1000x600", metavar="WIDTHxHEIGHT", help="of the browser (default 1000x600)")
    parser.add_argument("--alone", action="store_true", help="without a browser")
    parser.add_argument("--drive", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.drive:
        width, height = (int(part) for part in options.size.split("x"))
        drive(options.drive, options.seconds, {"width": width, "height": height})
        return
    if MISSING:
        sys.exit(f"needs {', '.join(MISSING)}")
    for rate in options.rate:
        print(measured(rate, options), flush=True)


if __name__ == "__main__":
    main()
