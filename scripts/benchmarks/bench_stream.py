"""What the pose stream costs a flight, and how soon settings are in force.

    python scripts/benchmarks/bench_stream.py [--seconds X] [--flights N] [--busy] [--only flood|ticks]

flood: flights of a real-time twin, in turn without requests and under a flood of sets that are refused, of sets that
are accepted, and of sets that are none: the time from reading a sample to having sent its answer, over that without
requests, the longest time between two answers, the samples missed, and the flights that a fault has ended. ticks:
samples and time from a host's sending of a set to its being in force, on a device and in a session. --busy keeps every
processor busy with something else besides.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import re
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from maglev_mj.bridge.flight import Flight
from maglev_mj.bridge.realtime import realtime
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.errors import MaglevError
from maglev_mj.net.udp import open_link
from maglev_mj.process import SideProcess
from maglev_mj.scenes.joystick import Joystick
from maglev_mj.session import Session, real_time
from maglev_mj.stream import PoseStream

RATES = 200, 1000
FLOODS: dict[str, Any] = {
    "no requests": None,
    "refused": [{"stiffness": 60000.0 + step} for step in range(2)],
    "accepted": [{"stiffness": 3000.0 + 500.0 * step} for step in range(2)],
    "nonsense": [{"pitch": 1.0}, 5],
}
SHARES = {"p50": 50.0, "p99": 99.0, "p99.9": 99.9, "max": 100.0}
ANY = "udp://127.0.0.1:0"
SETS, SETTLED = 200, 1.5
PAUSE = 0.0005
STEP = 0.0005


class Noted:
    """Notes when each sample is answered.

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
    """Ask for settings in turn, without waiting for answers, until the line ends."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as host:
        host.setblocking(False)
        for number in itertools.count():
            try:
                wish = {"type": "set", "id": number, "settings": wishes[number % len(wishes)]}
                host.sendto(json.dumps(wish).encode(), ("127.0.0.1", port))
                while True:
                    host.recv(2048)
            except OSError:
                if line.poll(PAUSE):
                    return


def asking(line: Connection, port: int) -> None:
    """Ask for settings at any time; send when that was, and from which sample on they are in force."""
    draw, came = np.random.default_rng(1), []
    time.sleep(SETTLED)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as host:
        host.settimeout(10.0)
        for number in range(SETS):
            time.sleep(draw.uniform(0.0, 0.03))
            wish = {"type": "set", "id": number, "settings": {"stiffness": 3000.0 + number}}
            sent = time.monotonic()
            host.sendto(json.dumps(wish).encode(), ("127.0.0.1", port))
            said = json.loads(host.recv(2048))
            if said["type"] == "accepted":
                came.append((sent, said["tick"]))
    line.send(came)


@contextmanager
def device(rate: int) -> Iterator[RemotePlant]:
    """Yield a twin that runs in real time."""
    command = [sys.executable, "-m", "maglev_mj.cli", "twin", "--listen", ANY, "--rate", str(rate)]
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


def flown(rate: int, wishes: Any, seconds: float) -> tuple[list[float], str]:
    """Fly once; return SHARES of an answer's time [µs], the longest interval [ms], samples missed, and the fault."""
    with device(rate) as plant, closing(PoseStream(ANY)) as stream, ExitStack() as stack:
        noted, fault = Noted(plant, "write", lambda: plant.samples.tick), ""
        flight = Flight(plant, Joystick(period=plant.period, delay=plant.delay), publishers=[stream])
        if wishes is not None:
            stack.enter_context(closing(SideProcess(flooding, stream.address[1], wishes)))
        with realtime("ignore"):
            try:
                flight.run(seconds)
            except MaglevError as error:
                fault = str(error).split(":")[0]
        missed = float(plant.samples.lost + plant.samples.skipped)
        answers = [flight.timing.answer.percentile(share) * 1e6 for share in SHARES.values()]
    longest = max(after - before for (_, before), (_, after) in itertools.pairwise(noted.rows))
    return [*answers, longest * 1e3, missed], fault


def flood(seconds: float, flights: int) -> None:
    """Print how late a flight's answers are under each flood."""
    print("from reading a sample to having sent its answer [µs]: medians of the flights (over that without requests)")
    for rate in RATES:
        runs: dict[str, list[tuple[list[float], str]]] = {name: [] for name in FLOODS}
        for _ in range(flights):
            for name, wishes in FLOODS.items():
                runs[name].append(flown(rate, wishes, seconds))
        usual = np.median([row for row, _ in runs["no requests"]], axis=0)
        for name, found in runs.items():
            rows, faults = np.array([row for row, _ in found]), [fault for _, fault in found if fault]
            here = np.median(rows, axis=0)
            cells = "".join(f"{what} {us:4.0f} ({us / one:4.2f})  " for what, us, one in zip(SHARES, here, usual))
            longest, missed = rows[:, -2].max(), rows[:, -1].sum() / flights
            print(
                f"  {rate:4} Hz  {name:<12}{cells}longest interval {longest:4.1f} ms, {missed:4.1f} missed a flight, "
                f"{len(faults)} of {flights} ended by a fault",
                *faults,
                flush=True,
            )


@contextmanager
def asked(stream: PoseStream) -> Iterator[list[Any]]:
    """Let a host ask; yield a list whose first, put there, is called when it has, and which has then what came."""
    came: list[Any] = []
    host = SideProcess(asking, stream.address[1])

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


def counted(what: str, noted: Noted, came: Sequence[tuple[float, int]]) -> None:
    """Print samples and time from asking to being in force."""
    instants, answered = [instant for _, instant in noted.rows], dict(noted.rows)
    samples, spans = [], []
    for sent, tick in came:
        samples.append(tick - noted.rows[int(np.searchsorted(instants, sent)) - 1][0])
        spans.append((answered[tick] - sent) * 1e3)
    cells = "  ".join(
        f"{name} {np.percentile(samples, share):3.0f} samples, {np.percentile(spans, share):5.1f} ms"
        for name, share in SHARES.items()
    )
    print(f"  {what:<20}{len(came)} of {SETS} accepted  {cells}", flush=True)


def ticks() -> None:
    """Print how soon settings are in force."""
    print("from a host's sending of a set to the first sample answered under it")
    for rate in RATES:
        with device(rate) as plant, closing(PoseStream(ANY)) as stream:
            scene = Joystick(period=plant.period, delay=plant.delay)
            noted = Noted(plant, "write", lambda: plant.samples.tick)
            flight = Flight(plant, scene, publishers=[stream])
            with realtime("ignore"), asked(stream) as came:
                came.append(flight.switch.land)
                flight.run()
            counted(f"device at {rate} Hz", noted, came[1:])
        stream = PoseStream(ANY)
        with closing(Session(scene, publishers=[stream])) as session, asked(stream) as came:
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
    parser.add_argument("--busy", action="store_true", help="keep every processor busy besides")
    parser.add_argument("--only", choices=("flood", "ticks"))
    options = parser.parse_args()
    with ExitStack() as stack:
        for _ in range((os.cpu_count() or 1) * options.busy):
            spin = subprocess.Popen([sys.executable, "-c", "while True: pass"])
            stack.callback(spin.wait)
            stack.callback(spin.kill)
        if options.only != "ticks":
            flood(options.seconds, options.flights)
        if options.only != "flood":
            ticks()


if __name__ == "__main__":
    main()
