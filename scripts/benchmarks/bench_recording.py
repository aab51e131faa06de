"""What recording costs the tick and its writer, and how long an hour takes to read.

    python scripts/benchmarks/bench_recording.py [--quick] [--hour FILE]

The same loop with and without a recording in turn, with the wall's laws on a plant that costs nothing; the difference
is what recording adds to a tick. Times are of the processor, medians over many short turns and five runs; the machine
may be shared. With --hour it also makes a file of an hour at 1 kHz, of 700 MB, all six axes noisy, and reads it.
"""

from __future__ import annotations

import argparse
import gc
import io
import json
import math
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from maglev_mj import Command, Sample
from maglev_mj.loop import ControlLoop, Record
from maglev_mj.recording import Recorder, setup_of
from maglev_mj.recording.files import row_of
from maglev_mj.recording.live import Ring
from maglev_mj.recording.row import ROW, as_table
from maglev_mj.recording.writer import McapWriter
from maglev_mj.scenes.joystick import Joystick

BLOCK = 200
PERIOD = Joystick().period
RUNS = 5
NOISY = 60_000


class Nothing:
    """A plant that costs nothing: the flotor is pressed against the wall, and hits it once in 100 samples."""

    period = PERIOD

    def __init__(self) -> None:
        self._tick = 0
        self._places = [
            [3e-3 + 1e-5 * step, *(1e-4 * math.sin(step + axis) for axis in range(5))] for step in range(100)
        ]
        self.hand_wrench = self._places[0]

    def read(self) -> Sample:
        """Return the next sample."""
        self._tick += 1
        self.hand_wrench = self._places[self._tick * 7 % 100]
        return Sample(self._tick, self._tick * PERIOD, self._places[self._tick % 100])

    def write(self, command: Command) -> Command:
        """Return it as it is."""
        return command

    def close(self) -> None:
        """Do nothing."""


def tick_times(makers: Sequence[Callable[[Nothing], Record] | None], turns: int) -> list[list[float]]:
    """Return the time of a tick [s] in each turn, recorded in each way; short turns, for a machine is not alone."""
    loops = []
    for make in makers:
        plant, controller = Nothing(), Joystick().controller()
        loops.append(ControlLoop(plant, controller, record=None if make is None else make(plant)))
    times: list[list[float]] = [[] for _ in loops]
    gc.disable()
    for _ in range(turns):
        for loop, kept in zip(loops, times, strict=True):
            start = time.thread_time()
            loop.cycle(BLOCK)
            kept.append((time.thread_time() - start) / BLOCK)
    gc.enable()
    return times


def tick_cost(turns: int) -> None:
    """Print what a recorded tick costs: medians of runs, each the median of its turns."""
    found: dict[str, list[float]] = {"bare": [], "mcap": [], "npz": []}
    for _ in range(RUNS):
        ring = Ring()
        times = tick_times([None, ring.record, lambda plant: Recorder(plant, {"kind": "benchmark"})], turns)
        ring.close()
        found["bare"].append(statistics.median(times[0]))
        for name, one in zip(("mcap", "npz"), times[1:], strict=True):
            found[name].append(statistics.median(more - bare for more, bare in zip(one, times[0], strict=True)))
    bare = statistics.median(found["bare"])
    print(f"  a tick without recording             {bare * 1e6:5.2f} µs")
    for name, what in (("mcap", "to .mcap, into shared memory"), ("npz", "to .npz, into memory")):
        low, middle, high = sorted(found[name])[0], statistics.median(found[name]), sorted(found[name])[-1]
        spread = f"{low * 1e6:.2f} to {high * 1e6:.2f} in {RUNS} runs, {1.0 + middle / bare:.3f} times the tick"
        print(f"  recorded {what:28s}+{middle * 1e6:5.2f} µs, {spread}")


def writer_cost(count: int) -> None:
    """Print what a sample costs the writer, in microseconds of processor and bytes."""
    plant, controller = Nothing(), Joystick().controller()
    rows: list[list[float]] = []

    def keep(sample: Sample, command: Command, applied: Command) -> None:
        rows.append([*row_of(sample, command, applied, plant)])

    ControlLoop(plant, controller, record=keep).cycle(count)
    whole = {**setup_of(plant, controller, delay=0.0), "versions": {}}
    for rate in (round(1.0 / PERIOD), 1000):
        for tick, row in enumerate(rows):
            row[1] = tick / rate
        found = []
        for _ in range(RUNS):
            file = io.BytesIO()
            writer, start = McapWriter(file), time.thread_time()
            writer.begin(whole, 10**18)
            for row in rows:
                writer.row(row)
            writer.close()
            found.append((time.thread_time() - start) / count)
        cost, size = statistics.median(found), len(file.getvalue()) / count
        most = f"{1.0 / cost:.0f} samples a second, {size:.0f} bytes each"
        print(f"  the writer takes {cost * 1e6:.0f} µs a sample at {rate} Hz: {most}")


class _Totals:
    """Totals that cost nothing."""

    def __init__(self, values: Sequence[Sequence[float]]) -> None:
        self._values, self._place = values, 0

    def add(self, row: Any) -> tuple[float, float, int]:
        """Return the next."""
        self._place += 1
        taken, work = self._values[self._place % len(self._values)]
        return taken, work, 0


def make_hour(path: Path, samples: int) -> None:
    """Write a file of so many samples at 1 kHz, by the writer, from noise in place of a plant."""
    random, rows = np.random.default_rng(1), np.zeros(NOISY, ROW)
    for name, size in (("position", 1e-3), ("command", 10.0), ("hand", 3.0)):
        rows[name] = random.normal(size=(NOISY, 6)) * size
    rows["pulse"][: NOISY // 10, 2] = random.normal(size=NOISY // 10)
    rows["pulse_width"][: NOISY // 10] = 1e-3
    for name in ("", "_pulse", "_pulse_width"):
        rows[f"applied{name}"] = rows["command" if not name else name[1:]]
    rows["arrival"] = np.nan
    values, (plant, controller) = as_table(rows).tolist(), (Nothing(), Joystick().controller())
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.begin({**setup_of(plant, controller, delay=0.0), "versions": {}}, 10**18)
        writer._messages._totals = _Totals(random.normal(size=(NOISY, 2)).tolist())  # type: ignore[assignment]
        for tick in range(samples):
            row = values[tick % NOISY]
            row[:2] = [tick, tick * 1e-3]
            writer.row(row)
        writer.close()


READ = """
import json, resource, sys, time
from maglev_mj.recording import load
start, used = time.perf_counter(), time.process_time()
samples = load(sys.argv[1], sys.argv[2].split(",") if len(sys.argv) > 2 else None)
found = [len(samples), time.perf_counter() - start, time.process_time() - used]
print(json.dumps([*found, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024]))
"""


def read_cost(path: Path, samples: int) -> None:
    """Print how long a file takes to read and how much memory, in a process of its own."""
    make_hour(path, samples)
    print(f"  {samples} samples, {path.stat().st_size / samples:.0f} bytes each")
    for fields in ([], ["time,position"]):
        done = subprocess.run([sys.executable, "-c", READ, str(path), *fields], check=True, capture_output=True)
        count, took, used, peak = json.loads(done.stdout)
        what = fields[0] if fields else "all fields"
        print(
            f"  load, {what}: {count} samples in {took:.1f} s, {used:.1f} s of processor, {peak / 1e6:.0f} MB at most"
        )


def main() -> None:
    """Print what a recorded tick costs, its writer and its reader."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer turns and samples")
    parser.add_argument("--hour", metavar="FILE", type=Path, help="also read a file of an hour, made under this name")
    options = parser.parse_args()
    tick_cost(20 if options.quick else 500)
    writer_cost(2000 if options.quick else 20_000)
    if options.hour is not None:
        read_cost(options.hour, 20_000 if options.quick else 3_600_000)


if __name__ == "__main__":
    main()
