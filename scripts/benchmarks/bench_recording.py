"""What recording costs the tick, and how fast the writer is.

    python scripts/benchmarks/bench_recording.py [--quick]

The same loop with and without a recording in turn, with the wall's laws on a plant that costs nothing; the difference
is what recording adds to a tick. Medians over many short turns of one run; the machine may be shared.
"""

from __future__ import annotations

import argparse
import gc
import math
import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from maglev_mj import Command, Sample
from maglev_mj.loop import ControlLoop, Record
from maglev_mj.recording import Recorder, open_recording, setup_of
from maglev_mj.recording.live import Ring
from maglev_mj.scenes.joystick import Joystick

BLOCK = 200
PERIOD = Joystick().period


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
            start = time.perf_counter()
            loop.cycle(BLOCK)
            kept.append((time.perf_counter() - start) / BLOCK)
    gc.enable()
    return times


def main() -> None:
    """Print what a recorded tick costs, and how fast the writer writes."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer turns and samples")
    turns, blocks = (20, 10) if parser.parse_args().quick else (2000, 100)
    ring = Ring()
    bare, mcap, arrays = tick_times([None, ring.record, lambda plant: Recorder(plant, {"kind": "benchmark"})], turns)
    ring.close()
    print(f"  a tick without recording             {statistics.median(bare) * 1e6:5.2f} µs")
    for name, times in (("to .mcap, into shared memory", mcap), ("to .npz, into memory", arrays)):
        more = sorted(one - other for one, other in zip(times, bare, strict=True))
        low, middle, high = (more[round(share * (len(more) - 1))] * 1e6 for share in (0.1, 0.5, 0.9))
        print(f"  recorded {name:28s}+{middle:5.2f} µs, {low:.2f} to {high:.2f} in four of five turns")
    with tempfile.TemporaryDirectory() as folder:
        path, count = Path(folder) / "run.mcap", blocks * BLOCK
        file, start = open_recording(path, wait=True), time.perf_counter()
        plant, controller = Nothing(), Joystick().controller()
        record = file.begin(plant, controller, setup_of(plant, controller, delay=0.0))
        ControlLoop(plant, controller, record=record).cycle(count)
        file.close()
        rate, size = count / (time.perf_counter() - start), path.stat().st_size / count
        print(f"  the writer writes {rate:.0f} samples a second, {size:.0f} bytes each")


if __name__ == "__main__":
    main()
