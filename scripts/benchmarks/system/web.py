"""Cost of a browser to the control loop, and latency of a drag.

A session runs in this process, its page in another, and Chromium draws it by software and jerks the knob about, three
times a second: ticks made and missed, the longest time between two turns of the loop, frames drawn, and the time from
the browser's own stamp of a move to the first control tick that had the target it led to. That target is reached 50 ms
later.
"""

from __future__ import annotations

import json
import sys
import time
from bisect import bisect_left
from typing import Any

import numpy as np

from maglev_mj.device import Knob
from maglev_mj.plants import engine_warnings_silenced
from maglev_mj.scenes.interactive import Joystick
from maglev_mj.session import Session, real_time
from maglev_mj.session.access import listen
from maglev_mj.views.page.page import Endpoint, page
from maglev_mj.views.page.stage import FIELD, placed
from maglev_mj.views.viewer_process import RemoteViewer
from system import Table, beside, child
from tests.views.browser import MISSING, chromium, on_screen
from timing import Run, columns

NAP, BETWEEN, READY = 0.001, 0.33, 40.0
WATCH = """
window.moves = []; window.frames = 0;
addEventListener('pointermove', e => moves.push((performance.timeOrigin + e.timeStamp) / 1000), true);
for (const name of ['drawElements', 'drawArrays']) {
  const draw = WebGL2RenderingContext.prototype[name];
  WebGL2RenderingContext.prototype[name] = function (...a) { window.drawn = true; return draw.apply(this, a); };
}
(function turn() { if (window.drawn) { frames++; window.drawn = false; } requestAnimationFrame(turn); })();
"""


def drive(url: str, seconds: float, size: str) -> None:
    """Move the knob in steps; print the times of the moves and the frame rate."""
    random, (width, height) = np.random.default_rng(0), map(int, size.split("x"))
    with chromium() as browser:
        tab = browser.new_context(viewport={"width": width, "height": height}).new_page()
        tab.add_init_script(WATCH)
        tab.goto(url, wait_until="domcontentloaded")
        tab.wait_for_selector(".gauge", timeout=60_000)
        tab.add_style_tag(content=".mantine-Notifications-root{display:none}")
        time.sleep(5.0)
        box = tab.locator("canvas[data-engine]").bounding_box()
        x, y = on_screen(tab, Knob().centre, placed("home", box["width"], box["height"]), FIELD)
        tab.mouse.move(x, y)
        tab.mouse.down()
        tab.mouse.move(x + 8, y, steps=4)
        tab.evaluate("moves.length = 0; frames = 0")
        began = time.monotonic()
        while time.monotonic() - began < seconds:
            tab.mouse.move(x + float(random.integers(-60, 60)), y + float(random.integers(-30, 30)))
            time.sleep(BETWEEN)
        moves, frames = tab.evaluate("[moves, frames]")
        tab.mouse.up()
        print(json.dumps({"moves": moves, "frames": frames / (time.monotonic() - began)}), flush=True)


def watched(rate: float, seconds: float, size: str, alone: bool) -> tuple[Run, dict[str, float]]:
    """Return the ticks of a session under a browser, and the columns beside them."""
    listener = listen(0)
    door = Endpoint("127.0.0.1", listener.getsockname()[1])
    session = Session(Joystick(period=1.0 / rate))
    viewer: Any = RemoteViewer(session.snapshot(), page(door, listener))
    browser = None if alone else child("web", door.url, seconds, size)
    targets: list[float] = []  # times of the first tick with each target
    goal, aimed, longest, last, ticks, missed = None, 0.0, 0.0, 0.0, 0, 0
    began = time.perf_counter() + (0.0 if alone else READY)
    with engine_warnings_silenced():
        for elapsed, passed in real_time(None, NAP):
            if session.tick(elapsed) and aimed:
                targets.append(time.time())
                aimed = 0.0
            viewer.serve(session)
            if viewer._glide._goal != goal:
                goal = viewer._glide._goal
                aimed = time.time()
            if goal is not None and time.perf_counter() < began:  # the browser holds the knob: begin
                began = time.perf_counter()
            if (now := time.perf_counter()) < began:
                ticks, missed, last = session._ticks, session.snapshot().missed, passed
            else:
                longest, last = max(longest, passed - last), passed
            if now - began > seconds + 1.0:
                break
    run = Run(now - began, 1, session._ticks - ticks)
    more = {"missed": session.snapshot().missed - missed, "longest turn (ms)": 1e3 * longest}
    viewer.close()
    listener.close()
    session.close()
    if browser is not None:
        report = json.loads(browser.communicate(timeout=60.0)[0])
        found = [(bisect_left(targets, move), move) for move in report["moves"]]
        late = [1e3 * (targets[index] - move) for index, move in found if index < len(targets)]
        more |= {"frames a second": report["frames"], "moves": len(late)}
        more |= {f"{share:g} % of moves (ms)": float(np.percentile(late, share)) for share in (50.0, 99.0)}
        more["after the next move"] = sum(delay >= 1e3 * BETWEEN for delay in late)
    return run, more


def measure(
    quick: bool,
    seconds: float = 60.0,
    rate: tuple[float, ...] = (200.0, 1000.0),
    size: str = "1000x600",
    alone: bool = False,
) -> dict[str, Table]:
    """Return ticks, frames and latency of drags by sample `rate`, in a browser of `size` [px] or `alone`."""
    if MISSING and not alone:
        sys.exit(f"needs {', '.join(MISSING)}")
    rows = {f"{one:g} Hz": watched(one, 1.0 if quick else seconds, size, alone) for one in rate}
    table = columns({name: run for name, (run, _) in rows.items()})
    return {"page": table | beside({name: more for name, (_, more) in rows.items()})}


if __name__ == "__main__":
    drive(sys.argv[1], float(sys.argv[2]), sys.argv[3])
