"""Tour and recording in a real window, by script.

Mouse and keys are scripted.
"""

import json
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from time import sleep
from typing import Any

import pytest

from maglev_mj.plants.hand import SpringHand
from maglev_mj.session import Pacer, Session
from tests.views.virtual_screen import VirtualScreen, waited

pytestmark = pytest.mark.needs("screen", "xdotool")

SIZE = 900, 600
PATIENCE = 60.0

TELLS = """
import json, sys, time
import numpy as np
from pathlib import Path
from maglev_mj.cli import main
from maglev_mj.session.replay import Replay
from maglev_mj.session.tour import Tour

def telling(tick):
    def told(self, elapsed):
        made, now = tick(self, elapsed), time.monotonic()
        if now - told.last > 0.05:
            told.last, seen = now, self.snapshot()
            line = seen.tour and [seen.tour.number, seen.tour.done]
            pulled = float(np.linalg.norm(seen.hand[:3]))
            print(json.dumps([line, pulled, seen.time, seen.state, seen.time_scale, list(seen.notes)]), flush=True)
        return made
    told.last = 0.0
    return told

for cls in (Tour, Replay):
    cls.tick = telling(cls.tick)
sys.exit(main(sys.argv[1:]))
"""
"""Command line that prints the window's state.

Twenty times a second.
"""


class Shown:
    """A window with somebody in front of it."""

    def __init__(self, screen: VirtualScreen, program: "subprocess.Popen[str]") -> None:
        self.screen, self._program = screen, program
        self.last: list[Any] = []
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def _read(self) -> None:
        assert self._program.stdout is not None
        for line in self._program.stdout:
            if line.startswith("["):
                self.last = json.loads(line)

    def close(self) -> None:
        self._program.kill()
        self._program.wait()
        self._reader.join()
        assert self._program.stdout is not None
        self._program.stdout.close()

    def until(self, so: Callable[[], bool]) -> None:
        waited(lambda: bool(self.last) and so(), PATIENCE)

    def key(self, *names: str) -> None:
        for name in names:
            self.screen.xdotool("key", name)
            sleep(0.15)

    @property
    def step(self) -> int:
        return int(self.last[0][0])

    @property
    def done(self) -> bool:
        return bool(self.last[0][1])

    @contextmanager
    def dragged(self, force: float, step: int = 8) -> Iterator[None]:
        """Pull right up to a force [N], then release."""
        x, y = SIZE[0] // 3, SIZE[1] // 3
        self.screen.xdotool("mousemove", x, y, "keydown", "ctrl", "mousedown", 3)
        sleep(0.4)
        try:
            for moved in range(step, SIZE[0] - x, step):
                self.screen.xdotool("mousemove", x + moved, y)
                sleep(0.2)
                if self.last[1] >= force:
                    break
            yield
        finally:
            self.screen.xdotool("mouseup", 3, "keyup", "ctrl")


@contextmanager
def shown(*arguments: object) -> Iterator[Shown]:
    with VirtualScreen(*SIZE) as screen:
        command = [sys.executable, "-c", TELLS, *map(str, arguments)]
        program = subprocess.Popen(command, env=screen.environment, stdout=subprocess.PIPE, text=True)
        window = Shown(screen, program)
        try:
            number = screen.window("MuJoCo")
            window.until(lambda: True)
            screen.xdotool("windowfocus", number, "mousemove", SIZE[0] // 3, SIZE[1] // 3)
            sleep(2.0)  # its first frames
            yield window
            screen.close(number)
            assert program.wait(PATIENCE) == 0
        finally:
            window.close()


@pytest.mark.study  # half a minute of drags in real time
def test_the_tour_is_done_by_mouse_and_keys(tmp_path: Path) -> None:
    # Each step is done after its deed and not before; the next comes by itself.
    deeds: dict[int, tuple[list[str], float, int]] = {
        1: ([], 0.4, 8),
        2: ([], 2.2, 8),
        3: ([], 2.2, 300),
        4: ([], 0.6, 4),
        5: (["Up"] * 3, 0.0, 0),
        6: ([], 2.5, 40),
        7: (["apostrophe"] * 5, 2.5, 40),
        8: (["period"] * 5, 2.5, 40),
    }
    with shown("tour", "--out", tmp_path) as window:
        for number, (keys, force, step) in deeds.items():
            window.until(lambda number=number: window.step == number)  # type: ignore[misc]
            sleep(0.5)
            assert window.last[0] == [number, False]
            window.key(*keys)
            if force:
                with window.dragged(force, step):
                    window.until(lambda number=number: window.done or window.step > number)  # type: ignore[misc]
            window.until(lambda number=number: window.done or window.step > number)  # type: ignore[misc]
        assert window.last[0] == [8, True]


def test_a_recording_is_searched_by_keys(tmp_path: Path) -> None:
    path = tmp_path / "run.maglev"
    session = Session(hand=SpringHand(target=[4e-3, 0, 0, 0, 0, 0]), record=path, pacer=Pacer(budget=60.0))
    for _ in range(40):
        session.tick(0.1)
    session.close()
    with shown("replay", path) as window:
        window.key("space")
        window.until(lambda: window.last[3] == "paused")
        for keys, time in (
            (["Home"], 0.0),
            (["Up", "Up"], 0.4),
            (["Right", "Right", "Right"], 0.415),
            (["Left"], 0.41),
            (["Down"], 0.21),
            (["End"], 3.995),
        ):
            window.key(*keys)
            window.until(lambda time=time: window.last[2] == pytest.approx(time))  # type: ignore[misc]
        window.key("equal", "9")
        window.until(lambda: window.last[4] == 2.0 and window.last[5] == ["REPLAY"])
        window.key("6", "slash", "Return", "Escape")  # of a scene: they do nothing here
        window.key("Home", "space")
        window.until(lambda: window.last[3] == "running")
        window.until(lambda: window.last[3] == "paused" and window.last[2] == pytest.approx(3.995))
