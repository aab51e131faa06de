"""Cost of recording a tick, writing and reading it.

    python scripts/benchmarks/recorder.py [--quick] [--hour FILE]
    python scripts/benchmarks/recorder.py --rate 20000 --seconds 30

The same loop with and without a recording in turn, with the wall's laws on a plant that costs nothing; the difference
is what recording adds to a tick. Times are of the processor, medians over many short turns and some runs; the machine
may be shared. The time to read an hour at 1 kHz, all six axes noisy, is extrapolated from some minutes of it; with
--hour a file of the whole, of 1.2 GB, is made and read. With --rate a run in real time is recorded.
"""

from __future__ import annotations

import argparse
import gc
import json
import math
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from maglev_mj import Command, Sample
from maglev_mj.control.loop import ControlLoop, Record
from maglev_mj.recording import MemoryFile, RecordingError, RecordingFile, load_samples, open_recording, setup_of
from maglev_mj.recording.journal import checksum_record, header, sample_records, text_records
from maglev_mj.recording.sample import ROW
from maglev_mj.scenes.rooms import Joystick

BLOCK = 200
PERIOD = Joystick().period
NOISY = 60_000


class Nothing:
    """Plant without cost, pressed against the wall; it hits the wall once in 100 samples."""

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
    """Return tick times [s] by way of recording, in short turns."""
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


def tick_costs(turns: int, runs: int) -> dict[str, float]:
    """Return the time of a tick and what recording adds [s]: medians of runs, each of its turns.

    Of the loop's own thread, to a journal and to memory; `all` is that of a journal with its thread.
    """
    found: dict[str, list[float]] = {"bare": [], "journal": [], "memory": [], "all": []}
    for _ in range(runs):
        with TemporaryDirectory() as folder:
            file = open_recording(Path(folder) / "run.maglev")
            bare, *recorded = tick_times([None, partial(_begun, file), partial(_begun, MemoryFile())], turns)
            file.close()
        found["bare"].append(statistics.median(bare))
        for name, one in zip(("journal", "memory"), recorded, strict=True):
            found[name].append(statistics.median(more - less for more, less in zip(one, bare, strict=True)))
        alone, beside = (_whole_cost(recording, turns) for recording in (False, True))
        found["all"].append(beside - alone)
    return {name: statistics.median(times) for name, times in found.items()}


def _whole_cost(recording: bool, turns: int) -> float:
    """Return the processor time a tick of all threads [s]."""
    plant, controller = Nothing(), Joystick().controller()
    with TemporaryDirectory() as folder:
        file = open_recording(Path(folder) / "run.maglev", wait=True)
        record = file.begin(plant, controller, setup_of(plant, controller, delay=0.0)) if recording else None
        loop, start = ControlLoop(plant, controller, record=record), time.process_time()
        loop.cycle(turns * BLOCK)
        file.close()
        return (time.process_time() - start) / (turns * BLOCK)


def _begun(file: RecordingFile, plant: Nothing) -> Record:
    controller = Joystick().controller()
    return file.begin(plant, controller, setup_of(plant, controller, delay=0.0))


def kept_up(rate: float, seconds: float) -> dict[str, float]:
    """Record to a file in real time [1/s].

    Returns:
        Samples recorded and lost, and the time that the writer takes for the rest at the end [s].
    """
    plant, controller = Nothing(), Joystick().controller()
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run.maglev"
        file = open_recording(path)
        record = file.begin(plant, controller, setup_of(plant, controller, delay=0.0))
        loop, start, done = ControlLoop(plant, controller, record=record), time.perf_counter(), 0
        while (now := time.perf_counter() - start) < seconds:
            if due := int(now * rate) - done:
                loop.cycle(due)
                done += due
            else:
                time.sleep(1e-4)
        start = time.perf_counter()
        with suppress(RecordingError):  # of lost samples, which are counted
            file.close()
        rest = time.perf_counter() - start
        lost = done - len(load_samples(path, ["tick"]))
    return {"samples": done, "lost": lost, "rest": rest}


def throughput(samples: int) -> float:
    """Return samples a second of a running writer, to the last one in the file."""
    plant, controller = Nothing(), Joystick().controller()
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run.maglev"
        file = open_recording(path, wait=True)
        record = file.begin(plant, controller, setup_of(plant, controller, delay=0.0))
        loop = ControlLoop(plant, controller, record=record)
        loop.cycle(1)
        while not path.exists():  # which it gets with its first sample
            time.sleep(1e-3)
        start = time.perf_counter()
        loop.cycle(samples)
        file.close()
        return samples / (time.perf_counter() - start)


def make_file(path: Path, samples: int) -> None:
    """Write a journal of many samples at 1 kHz, from noise."""
    random, rows = np.random.default_rng(1), np.zeros(NOISY, ROW)
    for name, size in (("position", 1e-3), ("command", 10.0), ("hand", 3.0)):
        rows[name] = random.normal(size=(NOISY, 6)) * size
    rows["pulse"][: NOISY // 10, 2] = random.normal(size=NOISY // 10)
    rows["pulse_width"][: NOISY // 10] = 1e-3
    for name in ("", "_pulse", "_pulse_width"):
        rows[f"applied{name}"] = rows["command" if not name else name[1:]]
    rows["arrival"] = np.nan
    plant, controller = Nothing(), Joystick().controller()
    begun = text_records({"begin": setup_of(plant, controller, delay=0.0), "time": 0})
    with path.open("wb") as file:
        file.write(header() + begun + checksum_record(begun))
        for first in range(0, samples, BLOCK):
            block = rows[first % NOISY :][: min(BLOCK, samples - first)].copy()
            block["tick"] = np.arange(first, first + len(block))
            block["time"] = block["tick"] * 1e-3
            data = sample_records(block)
            file.write(data + checksum_record(data))
        end = text_records({"end": {"lost": 0}})
        file.write(end + checksum_record(end))


READ = """
import json, resource, sys, time
from maglev_mj.recording import load_samples
start, used = time.perf_counter(), time.process_time()
samples = load_samples(sys.argv[1], sys.argv[2].split(",") if len(sys.argv) > 2 else None)
found = [len(samples), time.perf_counter() - start, time.process_time() - used]
print(json.dumps([*found, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024]))
"""


def read_cost(path: Path, fields: str = "") -> dict[str, float]:
    """Return time, processor time [s] and memory [bytes] of reading, in a process of its own."""
    done = subprocess.run([sys.executable, "-c", READ, str(path), *fields.split()], check=True, capture_output=True)
    return dict(zip(("samples", "seconds", "processor", "memory"), json.loads(done.stdout), strict=True))


def read_hour(minutes: float, runs: int) -> dict[str, float]:
    """Return the extrapolated time to read an hour [s], at 1 kHz, from a few minutes."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "minutes.maglev"
        make_file(path, round(minutes * 60_000))
        found = [read_cost(path) for _ in range(runs)]
        size = path.stat().st_size
    hour = 60.0 / minutes
    return {
        "minutes": minutes,
        "seconds": statistics.median(one["seconds"] for one in found) * hour,
        "processor": statistics.median(one["processor"] for one in found) * hour,
        "bytes": size * hour,
    }


def measure(quick: bool) -> dict[str, Any]:
    """Return the costs of recording and reading."""
    turns, runs = (5, 1) if quick else (60, 3)
    return {
        "tick": tick_costs(turns, runs),
        "kept_up": kept_up(20_000.0, 0.3 if quick else 1.0),
        "throughput": throughput(1000 if quick else 30_000),
        "read_hour": read_hour(0.01 if quick else 1.0, runs),
    }


def main() -> None:
    """Print the costs of recording, writing and reading."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer turns and samples")
    parser.add_argument("--hour", metavar="FILE", type=Path, help="also read a file of an hour, made under this name")
    parser.add_argument("--rate", metavar="HZ", type=float, help="record for --seconds at this rate, and nothing else")
    parser.add_argument("--seconds", metavar="X", type=float, default=30.0, help="how long (default 30)")
    options = parser.parse_args()
    if options.rate is not None:
        kept = kept_up(options.rate, options.seconds)
        print(f"  {kept['samples']} samples, {kept['lost']} lost, {kept['rest']:.2f} s to write the rest")
        return
    found = measure(options.quick)
    tick, bare = found["tick"], found["tick"]["bare"]
    print(f"  a tick without recording             {bare * 1e6:5.2f} µs")
    for name, what in (("journal", "a journal"), ("memory", "memory"), ("all", "a journal, with its thread")):
        more = f"{tick[name] * 1e6:5.2f} µs, {1.0 + tick[name] / bare:.3f} times the tick"
        print(f"  recorded to {what:25s}+{more}")
    kept = found["kept_up"]
    print(f"  at 20 kHz {kept['lost']} of {kept['samples']} samples are lost;", end=" ")
    print(f"a run that waits records {found['throughput']:.0f} samples a second")
    hour = found["read_hour"]
    print(f"  an hour at 1 kHz is read in {hour['seconds']:.1f} s, {hour['processor']:.1f} s of processor,", end=" ")
    print(f"from {hour['minutes']:g} minutes of it")
    if options.hour is not None:
        make_file(options.hour, 20_000 if options.quick else 3_600_000)
        for fields in ("", "time,position"):
            one = read_cost(options.hour, fields)
            took = (
                f"{one['seconds']:.1f} s, {one['processor']:.1f} s of processor, {one['memory'] / 1e6:.0f} MB at most"
            )
            print(f"  load, {fields or 'all fields'}: {one['samples']} samples in {took}")


if __name__ == "__main__":
    main()
