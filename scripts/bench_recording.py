"""What recording costs the tick, and how fast the writer is.

    python scripts/bench_recording.py [--quick]

The same loop with and without a recording in turn, with the wall's laws on a plant that costs nothing; the difference
is what recording adds to a tick. Medians and best values of one run; the machine may be shared.
"""

from __future__ import annotations

import argparse
import gc
import statistics
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from maglev_mj import Command, Sample
from maglev_mj.frames import ZERO
from maglev_mj.loop import ControlLoop
from maglev_mj.recording import ArrayFile, Recording, RecordingFile, open_recording
from maglev_mj.scenes import Settings, scene_called

BLOCK = 2000
PERIOD = Settings().period


class Nothing:
    """A plant that costs nothing: the flotor is pressed against the wall, and hits it once in 50 samples."""

    period, hand_wrench = PERIOD, (0.1,) * 6

    def __init__(self) -> None:
        self._tick = 0
        self._places = [[3e-3 + 1e-5 * step, *ZERO[1:]] for step in range(100)]

    def read(self) -> Sample:
        """Return the next sample."""
        self._tick += 1
        return Sample(self._tick, self._tick * PERIOD, self._places[self._tick % 100])

    def write(self, command: Command) -> Command:
        """Return it as it is."""
        return command

    def close(self) -> None:
        """Do nothing."""


def tick_times(files: Sequence[RecordingFile | None], turns: int) -> list[list[float]]:
    """Return the time of a tick [s] in each turn, recorded to each file."""
    loops = []
    for file in files:
        plant, controller = Nothing(), scene_called("joystick").controller(Settings())
        if file is None:
            loops.append(ControlLoop(plant, controller))
        else:
            record = file.begin(plant, controller, {"kind": "benchmark"}, delay=0.0)
            loops.append(ControlLoop(plant, controller, record=record))
    times: list[list[float]] = [[] for _ in loops]
    gc.disable()
    for _ in range(turns):
        for loop, kept in zip(loops, times, strict=True):
            start = time.perf_counter()
            loop.cycle(BLOCK)
            kept.append((time.perf_counter() - start) / BLOCK)
            time.sleep(0.3)  # the writer is not to share the processor with the next
    gc.enable()
    return times


def main() -> None:
    """Print what a recorded tick costs, and how fast the writer writes."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer turns")
    turns = 5 if parser.parse_args().quick else 40
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        live = open_recording(path)
        time.sleep(2.0)  # it starts
        bare, arrays, mcap = tick_times([None, ArrayFile(), live], turns)
        live.close()
        size, rows = path.stat().st_size, Recording.load(path).ticks
        print(
            f"  a tick without recording            {statistics.median(bare) * 1e6:5.2f} µs, best {min(bare) * 1e6:.2f}"
        )
        for name, times in (("to .npz, in memory", arrays), ("to .mcap, in shared memory", mcap)):
            more = [one - other for one, other in zip(times, bare, strict=True)]
            best = min(times) - min(bare)
            print(f"  recorded {name:27s}+{statistics.median(more) * 1e6:5.2f} µs, best {best * 1e6:+.2f}")
        waited = open_recording(path, wait=True)
        start = time.perf_counter()
        plant, controller = Nothing(), scene_called("joystick").controller(Settings())
        record = waited.begin(plant, controller, {"kind": "benchmark"}, delay=0.0)
        ControlLoop(plant, controller, record=record).cycle(20 * BLOCK)
        waited.close()
        rate = 20 * BLOCK / (time.perf_counter() - start)
        print(f"  the writer writes {rate:.0f} samples a second, {size / rows:.0f} bytes each")


if __name__ == "__main__":
    main()
