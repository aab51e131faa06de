"""Cost of the bridge: cycles of the host, two processes in lockstep, latency in real time."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from maglev_mj.bridge.flight import Flight
from maglev_mj.bridge.links import open_link
from maglev_mj.bridge.realtime import realtime
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.bridge.twin.twin import Twin, TwinParameters
from maglev_mj.control.loop import drive
from maglev_mj.errors import MaglevError
from maglev_mj.scenes.interactive import Joystick
from maglev_mj.spec import Spec
from system import Table, beside
from timing import Run, columns, timed

RATES = 200, 1000, 2000, 4000
clock = time.perf_counter_ns


class Timed(VirtualLink):
    """Link to a twin in this process that notes when frames arrive and leave, and its own time [ns]."""

    arrived = left = spent = 0

    def send(self, data: bytes) -> None:
        """Send one frame."""
        self.left = clock()
        super().send(data)
        self.spent += clock() - self.left

    def receive(self, timeout: float) -> bytes | None:
        """Return a frame."""
        start = clock()
        data = super().receive(timeout)
        end = clock()
        self.arrived = self.arrived if data is None else end
        self.spent += end - start
        return data


def cycles(count: int) -> tuple[list[float], list[float]]:
    """Return the host's own time in each cycle until the answer is sent, and total [s]."""
    link = Timed(Twin(TwinParameters()))
    answers, wholes = [], []
    with TemporaryDirectory() as folder, realtime("ignore"):
        with RemotePlant(link, folder=Path(folder)) as plant:
            plant.takeoff()
            controller = Joystick(friction=True).controller()
            for _ in range(count):
                start, link.spent = clock(), 0
                plant.write(controller.step(plant.read()))
                wholes.append((clock() - start - link.spent) * 1e-9)
                answers.append((link.left - link.arrived) * 1e-9)
    return answers, wholes


def host(count: int, repeats: int) -> Table:
    """Return the cost of a host's cycle, from a STATE in to its CMD out: six axes with walls and friction."""
    times = dict(zip(("until sent", "until done"), zip(*(cycles(count) for _ in range(repeats)))))
    rows = {
        name: {
            "median, µs": 1e6 * float(np.median(some)),
            "best median": 1e6 * float(np.median(some, axis=1).min()),
            "99 %": 1e6 * float(np.median(np.percentile(some, 99, axis=1))),
        }
        for name, some in times.items()
    }
    return columns({name: [Run(sum(one), 1, len(one)) for one in some] for name, some in times.items()}) | beside(rows)


@contextmanager
def twin(*options: str) -> Iterator[tuple[str, list[str]]]:
    """Start a twin in a process of its own; yield its address, and a list that gets its report at the end."""
    command = [sys.executable, "-m", "maglev_mj", "twin", "--listen", "udp://127.0.0.1:0", *options]
    report: list[str] = []
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        try:
            yield re.findall(r"udp://[^\s,]+", child.stdout.readline())[0], report
        finally:
            child.terminate()
            report.append(child.stdout.read())


def lockstep(blocks: int, block: int) -> Table:
    """Return the cost of a tick of two processes in lockstep over UDP."""
    runs: dict[str, list[Run]] = {"on one processor": [], "on any": []}
    processors = os.sched_getaffinity(0)
    for name, some in runs.items():
        os.sched_setaffinity(0, {min(processors)} if name == "on one processor" else processors)  # the child's too
        try:
            with twin("--lockstep") as (address, _), TemporaryDirectory() as folder:
                link = open_link(address)
                with RemotePlant(link, patience=10.0, folder=Path(folder)) as plant, realtime("ignore"):
                    plant.takeoff()
                    laws = Joystick(friction=True).controller()
                    drive(plant, laws, 1)  # from now on each block starts with a sample that was read
                    for _ in range(blocks):
                        before = plant.samples.tick
                        seconds = timed(partial(drive, plant, laws, block))
                        some.append(Run(seconds, 1, plant.samples.tick - before))
        finally:
            os.sched_setaffinity(0, processors)
    best = {name: max(run.ticks / run.seconds for run in some) for name, some in runs.items()}
    return columns(runs) | {"most ticks a second": best}


def in_real_time(seconds: float) -> Table:
    """Return the device's samples and stalls of flights in real time, and the delays of the answers."""
    runs, rows = dict[str, Run](), dict[str, dict[str, float]]()
    for rate in RATES:
        delay = min(Spec.transport_delay.value, 1.0 / rate)  # the driver's own must fit into two periods
        with twin("--rate", str(rate), "--delay", str(delay)) as (address, report), TemporaryDirectory() as folder:
            try:
                with realtime("ignore"), RemotePlant(open_link(address), folder=Path(folder)) as plant:
                    flight = Flight(plant, Joystick().replace(period=plant.period, delay=plant.delay))
                    flown = flight.run(seconds)
            except MaglevError as error:  # a busy machine stalls a takeoff or a flight
                print(f"no row for {rate} Hz: {error}", file=sys.stderr)
                continue
        ((wall, samples, stalled),) = re.findall(r"([\d.]+) s, (\d+) samples, \d+ Hz, (\d+) periods", report[0])
        runs[f"{rate} Hz"] = Run(float(wall), 1, int(samples))  # of the device: takeoff and landing too
        rows[f"{rate} Hz"] = {
            "stalled periods": int(stalled),
            "lost": flown.lost,
            "skipped": flown.skipped,
            "delay at the device, µs": flight.timing.delay.p50 * 1e6,
            "99 %": flight.timing.delay.p99 * 1e6,
        }
    return columns(runs) | beside(rows)


def measure(quick: bool, only: str = "") -> dict[str, Table]:
    """Return the cost of the bridge; only `host`, `lockstep` or `realtime` if it is named."""
    parts: dict[str, Callable[[], Table]] = {
        "host": lambda: host(*((200, 2) if quick else (2000, 15))),
        "lockstep": lambda: lockstep(*((2, 50) if quick else (20, 500))),
        "realtime": lambda: in_real_time(0.3 if quick else 4.0),
    }
    return {name: part() for name, part in parts.items() if only in ("", name)}
