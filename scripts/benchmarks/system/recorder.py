"""Cost of recording a tick, and of writing and reading samples.

The same loop with and without a recording in turn, with the wall's laws on a plant that costs nothing; the difference
is what recording adds to a tick. Times of ticks are of the processor; a thread's time is that of the loop alone, a
process's includes the writer.
"""

from __future__ import annotations

import gc
import json
import math
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from maglev_mj import Command, Sample
from maglev_mj.control.loop import ControlLoop
from maglev_mj.recording import MemoryFile, RecordingError, RecordingFile, load_samples, open_recording, setup_of
from maglev_mj.scenes.interactive import Joystick
from system import Table, beside
from timing import Run, columns, in_turns, medians, ratio, timed

BLOCK = 200
PERIOD = Joystick().period
HOUR = 3_600_000


class Nothing:
    """Plant without cost, pressed against the wall; it hits the wall once in 100 samples.

    Attributes:
        tick: Samples read.
    """

    period = PERIOD

    def __init__(self) -> None:
        self.tick = 0
        self._places = [
            [3e-3 + 1e-5 * step, *(1e-4 * math.sin(step + axis) for axis in range(5))] for step in range(100)
        ]
        self.hand_wrench = self._places[0]

    def read(self) -> Sample:
        """Return the next sample."""
        self.tick += 1
        self.hand_wrench = self._places[self.tick * 7 % 100]
        return Sample(self.tick, self.tick * PERIOD, self._places[self.tick % 100])

    def write(self, command: Command) -> Command:
        """Return it as it is."""
        return command

    def close(self) -> None:
        """Do nothing."""


Writer = RecordingFile | MemoryFile


def loop_of(file: Writer | None) -> tuple[Nothing, ControlLoop]:
    """Return a new loop that records to a file, and its plant."""
    plant, controller = Nothing(), Joystick().controller()
    record = None if file is None else file.begin(plant, controller, setup_of(plant, controller, delay=0.0))
    return plant, ControlLoop(plant, controller, record=record)


@contextmanager
def journal(wait: bool = False) -> Iterator[tuple[Path, RecordingFile]]:
    """Yield a new journal and its path."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run.maglev"
        file = open_recording(path, wait=wait)
        yield path, file
        with suppress(RecordingError):  # lost samples, which are counted
            file.close()


def ticks(loop: ControlLoop, plant: Nothing, clock: Callable[[], float], finish: Callable[[], object]) -> Run:
    """Run a block of ticks."""
    start, before = clock(), plant.tick
    loop.cycle(BLOCK)
    finish()
    return Run(clock() - start, 1, plant.tick - before)


def tick_costs(turns: int) -> Table:
    """Return the time of a tick, and what recording adds to it, in turns."""
    bare, names = "no recording", ("to a journal", "to memory")

    def whole(record: bool) -> Run:
        with journal(wait=True) as (_, file):
            plant, loop = loop_of(file if record else None)
            return ticks(loop, plant, time.process_time, file.close)

    with journal() as (_, file):
        loops = dict(zip((bare, *names), map(loop_of, (None, file, MemoryFile())), strict=True))
        work = {
            f"{name}, thread": partial(ticks, loop, plant, time.thread_time, lambda: None)
            for name, (plant, loop) in loops.items()
        }
        work |= {f"{name}, process": partial(whole, name != bare) for name in (bare, "to a journal")}
        gc.disable()
        runs = in_turns(work, turns)
        gc.enable()
    times = {name: [run.each for run in some] for name, some in runs.items()}
    pairs = {name: f"{bare}, {name.rpartition(', ')[2]}" for name in times}
    more = {name: list(np.subtract(times[name], times[plain])) for name, plain in pairs.items()}
    return {
        **columns(runs),
        "µs added": medians(more, 1e6),
        "over none": {name: ratio(times[name], times[plain]) for name, plain in pairs.items()},
    }


def real_time(rate: float, seconds: float) -> Table:
    """Return how many samples of a run in real time are lost, and how long the writer takes for the rest."""
    name = f"{rate:g} Hz"
    with journal() as (path, file):
        plant, loop = loop_of(file)
        start = time.perf_counter()
        while (now := time.perf_counter() - start) < seconds:
            if due := int(now * rate) - plant.tick:
                loop.cycle(due)
            else:
                time.sleep(1e-4)
        with suppress(RecordingError):  # lost samples, which are counted
            rest = timed(file.close)
        run = Run(time.perf_counter() - start, 1, plant.tick)
        lost = plant.tick - len(load_samples(path, ["tick"]))
    return columns({name: run}) | {"lost": {name: lost}, "s to write the rest": {name: rest}}


READ = """
import json, resource, sys, time
from maglev_mj.recording import load_samples
start, used = time.perf_counter(), time.process_time()
samples = load_samples(sys.argv[1], sys.argv[2].split(",") if len(sys.argv) > 2 else None)
found = [len(samples), time.perf_counter() - start, time.process_time() - used]
print(json.dumps([*found, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024]))
"""


def through_a_file(samples: int, repeats: int, path: Path) -> Table:
    """Return the cost of samples written as fast as they can be, and of reading them in processes of their own."""
    file = open_recording(path, wait=True)
    plant, loop = loop_of(file)
    start = time.perf_counter()
    loop.cycle(samples)
    file.close()
    runs = {"written": [Run(time.perf_counter() - start, 1, plant.tick)]}
    rows = {"written": {"MB": 1e-6 * path.stat().st_size}}
    for fields in ("", "time,position"):
        name = f"read, {fields or 'all fields'}"
        command = [sys.executable, "-c", READ, str(path), *fields.split()]
        done = [json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout) for _ in range(repeats)]
        runs[name] = [Run(seconds, 1, count) for count, seconds, *_ in done]
        processor = statistics.median(used for *_, used, _ in done)
        rows[name] = {
            "processor seconds": processor,
            "processor seconds an hour at 1 kHz": processor * HOUR / samples,
            "MB": 1e-6 * max(memory for *_, memory in done),
        }
    return columns(runs, "sample") | beside(rows)


def measure(quick: bool, hour: str = "", rate: float = 20_000.0, seconds: float = 1.0) -> dict[str, Table]:
    """Return the costs of a tick, of a run in real time at `rate` for `seconds`, and of a file.

    The file has a minute of samples at 1 kHz; the one named `hour`, of 1.2 GB, an hour of them, and is kept.
    """
    minute = 600 if quick else HOUR // 60
    with TemporaryDirectory() as folder:
        files = {"file": (minute, 1 if quick else 3, Path(folder) / "minute.maglev")}
        if hour:
            files["hour"] = 2 * minute if quick else HOUR, 1, Path(hour)
        return {
            "tick": tick_costs(5 if quick else 180),
            "real time": real_time(rate, 0.3 if quick else seconds),
            **{name: through_a_file(*one) for name, one in files.items()},
        }
