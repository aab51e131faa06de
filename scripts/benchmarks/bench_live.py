"""Cost and latency of a live server beside a flight.

    python scripts/benchmarks/bench_live.py [--seconds X] [--flights N] [--rate HZ ...] [--busy] [--only cost|ticks]

cost: flights of a real-time twin, in turn without a server, with one that nobody watches, with a client that hears
every message, and under a flood of sets that are refused, of sets that are accepted, and of sets that are none: the
time from reading a sample to having sent its answer, over that without a server, the longest time between two answers,
the samples missed, messages that the client heard, and the flights that a fault has ended. ticks: samples and time from
a client's call to its being in force, and time until another is refused, on a device and in a session. --busy keeps
every processor busy with something else besides.
"""

from __future__ import annotations

import argparse
import itertools
import os
import re
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

# the client is an example
sys.path.insert(0, str(Path(__file__).parent.parent / "examples"))
from live_client import LiveClient
from maglev_mj.bridge.flight import Flight
from maglev_mj.bridge.links import open_link
from maglev_mj.bridge.realtime import realtime
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.errors import MaglevError
from maglev_mj.interop.foxglove import LiveServer
from maglev_mj.process import SideProcess
from maglev_mj.scenes.rooms import Joystick
from maglev_mj.session import Session, real_time

RATES = 200, 1000
ALONE, IDLE, HEARS = "no server", "nobody watches", "a client hears"
FLOODS: dict[str, Any] = {
    ALONE: None,
    IDLE: None,
    HEARS: None,
    "refused": [{"stiffness": 60000.0 + step} for step in range(2)],
    "accepted": [{"stiffness": 3000.0 + 500.0 * step} for step in range(2)],
    "nonsense": [{"pitch": 1.0}, {"stiffness": "x" * 1000}],
}
SHARES = {"p50": 50.0, "p99": 99.0, "p99.9": 99.9, "max": 100.0}
ANY = "udp://127.0.0.1:0"
SETS, SETTLED = 200, 1.5
PAUSE = 0.0005
STEP = 0.0005


class Noted:
    """Recorder of the answer time of each sample.

    Args:
        owner: What answers: a plant, or a session's stretch, whose method is wrapped.
        method: Name of that method.
        tick: Returns the number of the sample that is answered.
    """

    def __init__(self, owner: Any, method: str, tick: Callable[[], int]) -> None:
        self.rows: list[tuple[int, float]] = []
        answer = getattr(owner, method)

        def noted(*arguments: Any) -> Any:
            self.rows.append((tick(), time.monotonic()))
            return answer(*arguments)

        setattr(owner, method, noted)


def flooding(line: Connection, port: int, wishes: Sequence[Any]) -> None:
    """Ask for parameters without waiting until the line ends."""
    with LiveClient(f"ws://127.0.0.1:{port}", set()) as client:
        for number in itertools.count():
            told = [{"name": name, "value": value} for name, value in wishes[number % len(wishes)].items()]
            client.send({"op": "setParameters", "parameters": told})
            if line.poll(PAUSE):
                break
        client.drop()


def hearing(line: Connection, port: int) -> None:
    """Subscribe to every topic; send counts of poses and samples."""
    with LiveClient(f"ws://127.0.0.1:{port}") as client:
        line.send(None)
        counts: Counter[str] = Counter()
        while not line.poll(0.0):
            counts.update(message.topic for message in client.messages(0.2))
        line.send((counts["/maglev/sample"], counts["/tf"]))


def asking(line: Connection, port: int) -> None:
    """Ask for parameters, every second request to be refused.

    Send when each was asked and answered, and from which sample on it is in force.
    """
    draw, came = np.random.default_rng(1), []
    time.sleep(SETTLED)
    with LiveClient(f"ws://127.0.0.1:{port}", set()) as client:
        for number in range(2 * SETS):
            time.sleep(draw.uniform(0.0, 0.03))
            sent = time.monotonic()
            since = client.set(stiffness=(60000.0 if number % 2 else 3000.0) + number)["since"]
            came.append((sent, time.monotonic(), since))
    line.send(came)


@contextmanager
def device(rate: int) -> Iterator[RemotePlant]:
    """Yield a twin that runs in real time."""
    command = [sys.executable, "-m", "maglev_mj", "twin", "--listen", ANY, "--rate", str(rate)]
    twin = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert twin.stdout is not None
        found = re.search(r"udp://\S+:\d+", twin.stdout.readline())
        assert found
        with RemotePlant(open_link(found[0])) as plant:
            yield plant
    finally:
        twin.kill()
        twin.wait()


def flown(rate: int, name: str, seconds: float) -> tuple[list[float], str, tuple[int, int]]:
    """Fly once.

    Returns:
        SHARES of an answer's time [µs], the longest interval [ms], samples missed; the fault; samples and frames heard.
    """
    with device(rate) as plant, ExitStack() as stack:
        live = None if name == ALONE else stack.enter_context(closing(LiveServer(0)))
        noted, fault, heard = Noted(plant, "write", lambda: plant.samples.tick), "", (0, 0)
        scene = Joystick(period=plant.period, delay=plant.delay)
        flight = Flight(plant, scene, publishers=[live] if live else [], file=live)
        client = None
        if live is not None and FLOODS[name] is not None:
            stack.enter_context(closing(SideProcess(flooding, live.port, FLOODS[name])))
        if live is not None and name == HEARS:
            client = stack.enter_context(closing(SideProcess(hearing, live.port)))
            client.line.recv()
        with realtime("ignore"):
            try:
                flight.run(seconds)
            except MaglevError as error:
                fault = str(error).split(":")[0]
        if client is not None:
            client.send(None)
            heard = client.line.recv()
        missed = float(plant.samples.lost + plant.samples.skipped)
        answers = [flight.timing.answer.percentile(share) * 1e6 for share in SHARES.values()]
    longest = max(after - before for (_, before), (_, after) in itertools.pairwise(noted.rows))
    return [*answers, longest * 1e3, missed], fault, heard


def cost(rates: Sequence[int], seconds: float, flights: int) -> None:
    """Print how late a flight's answers are in each case."""
    print("from reading a sample to having sent its answer [µs]: medians of the flights (over that without a server)")
    for rate in rates:
        runs: dict[str, list[tuple[list[float], str, tuple[int, int]]]] = {name: [] for name in FLOODS}
        for _ in range(flights):
            for name in FLOODS:
                runs[name].append(flown(rate, name, seconds))
        usual = np.median([row for row, *_ in runs[ALONE]], axis=0)
        for name, found in runs.items():
            rows, faults = np.array([row for row, *_ in found]), [fault for _, fault, _ in found if fault]
            here, heard = np.median(rows, axis=0), np.median([one for *_, one in found], axis=0) / seconds
            cells = "".join(f"{what} {us:4.0f} ({us / one:4.2f})  " for what, us, one in zip(SHARES, here, usual))
            longest, missed = rows[:, -2].max(), ", ".join(f"{one:g}" for one in rows[:, -1])
            listened = f", heard {heard[0]:.0f} samples and {heard[1]:.0f} frames a second" if name == HEARS else ""
            print(
                f"  {rate:4} Hz  {name:<15}{cells}longest interval {longest:4.1f} ms, missed {missed}, "
                f"{len(faults)} of {flights} ended by a fault{listened}",
                *faults,
                flush=True,
            )


@contextmanager
def asked(live: LiveServer) -> Iterator[list[Any]]:
    """Yield a list of the results of a client.

    Its first item is called once the client has asked.
    """
    came: list[Any] = []
    host = SideProcess(asking, live.port)

    def wait() -> None:
        host.line.poll(None)
        came.extend(host.line.recv())
        came[0]()

    waiting = threading.Thread(target=wait)
    waiting.start()
    try:
        yield came
        waiting.join()
    finally:
        host.close()


def counted(what: str, noted: Noted, came: Sequence[tuple[float, float, int | None]]) -> None:
    """Print samples and latencies until in force and until refused."""
    instants, answered = [instant for _, instant in noted.rows], dict(noted.rows)
    samples, spans, refused = [], [], []
    for sent, told, tick in came:
        if tick is None:
            refused.append((told - sent) * 1e3)
            continue
        samples.append(tick - noted.rows[int(np.searchsorted(instants, sent)) - 1][0])
        spans.append((answered[tick] - sent) * 1e3)
    cells = "  ".join(
        f"{name} {np.percentile(samples, share):3.0f} samples, {np.percentile(spans, share):5.1f} ms"
        for name, share in SHARES.items()
    )
    print(f"  {what:<20}{len(spans)} of {SETS} accepted  {cells}", flush=True)
    cells = "  ".join(f"{name} {np.percentile(refused, share):5.1f} ms" for name, share in SHARES.items())
    print(f"  {what:<20}{len(refused)} of {SETS} refused   {cells}", flush=True)


def ticks(rates: Sequence[int]) -> None:
    """Print how soon settings are in force."""
    print("from a client's call to the first sample answered under it, or to its refusal")
    for rate in rates:
        with device(rate) as plant, closing(LiveServer(0)) as live:
            scene = Joystick(period=plant.period, delay=plant.delay)
            noted = Noted(plant, "write", lambda: plant.samples.tick)
            flight = Flight(plant, scene, publishers=[live], file=live)
            with realtime("ignore"), asked(live) as came:
                came.append(flight.switch.land)
                flight.run()
            counted(f"device at {rate} Hz", noted, came[1:])
        live = LiveServer(0)
        with closing(Session(scene, publishers=[live], file=live)) as session, asked(live) as came:
            noted, running = Noted(session, "_one", lambda: session.snapshot().tick), [True]
            came.append(running.clear)
            for elapsed, _ in real_time(None, STEP):
                session.tick(elapsed)
                if not running:
                    break
            counted(f"session at {rate} Hz", noted, came[1:])


def main() -> None:
    """Print both."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=6.0, metavar="X", help="of a flight (default 6)")
    parser.add_argument("--flights", type=int, default=9, metavar="N", help="of each kind (default 9)")
    parser.add_argument(
        "--rate", type=int, nargs="+", default=RATES, metavar="HZ", help="of samples (default 200 1000)"
    )
    parser.add_argument("--busy", action="store_true", help="keep every processor busy besides")
    parser.add_argument("--only", choices=("cost", "ticks"))
    options = parser.parse_args()
    with ExitStack() as stack:
        for _ in range((os.cpu_count() or 1) * options.busy):
            spin = subprocess.Popen([sys.executable, "-c", "while True: pass"])
            stack.callback(spin.wait)
            stack.callback(spin.kill)
        if options.only != "ticks":
            cost(options.rate, options.seconds, options.flights)
        if options.only != "cost":
            ticks(options.rate)


if __name__ == "__main__":
    main()
