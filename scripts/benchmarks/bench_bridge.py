"""Cost of the bridge: cycles of the host, lockstep, latency.

    python scripts/benchmarks/bench_bridge.py [--quick] [--only host|lockstep|realtime]

On a machine that others use, compare medians with medians of the same run, and best values across runs.
"""

from __future__ import annotations

import argparse
import gc
import multiprocessing
import os
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from maglev_mj import Controller, Hold
from maglev_mj.bridge.bench.calibration import Calibration
from maglev_mj.bridge.flight import Flight
from maglev_mj.bridge.links import Link, UdpLink, UdpServer
from maglev_mj.bridge.realtime import LatencyHistogram, realtime, stopping
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.bridge.safety import HostLimits, Limits
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.bridge.twin.twin import ServerReport, Twin, TwinParameters, TwinServer
from maglev_mj.bridge.wire import Codec, StateReport
from maglev_mj.control import Bias
from maglev_mj.control.loop import drive
from maglev_mj.plants import engine_warnings_silenced
from maglev_mj.plants.sensor import FastBeams
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.rooms import INERTIA, WEIGHT, Joystick
from maglev_mj.spec import Spec
from timing import timed

PARTS = "host", "lockstep", "realtime"
HOME = "127.0.0.1"
SESSION = 1
START = (1e-3, 0.0, 0.0, 0.0, 0.01, 0.0)
BLOCK = 500
WIDE = HostLimits(envelope=1.0, envelope_angle=1.0, speed_limit=10.0, spin_limit=100.0)
COOL = Limits(thermal_time=1e6, spot_limit=0.1, spot_speed=100.0)
RATES = 200, 1000, 2000, 4000
clock = time.perf_counter_ns


# what is flown


def hover() -> Controller:
    """Return a law that carries the flotor at the centre."""
    scene = Joystick()
    hold = Hold.critically_damped(inertia=INERTIA, period=scene.period, delay=scene.delay)
    return Controller([Bias(WEIGHT), hold], period=scene.period)


SCENES: dict[str, tuple[Callable[[], Controller], Sequence[float]]] = {
    "hold": (hover, START),
    "drop": (Drop().controller, (0.0, 0.0, 0.004, 0.0, 0.0, 0.0)),
    "joystick, walls and friction": (Joystick(friction=True).controller, START),
}


# the host's share


class Memory:
    """A link with one frame in it."""

    frame: bytes | None = None

    def send(self, data: bytes) -> None:
        """Discard a frame."""

    def receive(self, timeout: float) -> bytes | None:
        """Return the frame."""
        frame, self.frame = self.frame, None
        return frame

    def now(self) -> int:
        """Return the instant [ns]."""
        return time.monotonic_ns()

    def close(self) -> None:
        """Do nothing."""


class Switched:
    """Link to a twin for the handshake, replaced afterwards."""

    def __init__(self, twin: Twin) -> None:
        self.wire: Link = VirtualLink(twin)
        self.sent = 0

    def send(self, data: bytes) -> None:
        """Send one frame, and note when it has left."""
        self.wire.send(data)
        self.sent = clock()

    def receive(self, timeout: float) -> bytes | None:
        """Return a frame."""
        return self.wire.receive(timeout)

    def now(self) -> int:
        """Return the instant [ns]."""
        return self.wire.now()

    def close(self) -> None:
        """Close it."""
        self.wire.close()


def prepared(count: int, period: int) -> list[bytes]:
    """Return STATE frames of seeded motion through the joystick's walls."""
    random = np.random.default_rng(1)
    phase, speed = random.uniform(0.0, 6.28, 6), random.uniform(0.02, 0.1, 6)
    size = np.array([Spec.translation_range.value] * 3 + [0.09] * 3)
    beams, codec = FastBeams(Calibration.nominal().beams), Codec()
    frames = []
    for tick in range(1, count + 1):
        spots = tuple(beams.spots((size * np.sin(phase + speed * tick)).tolist()))
        report = StateReport(spots, (1.0,) * 6, (0.1,) * 6, 1, 7, 0, 0, tick - 1, 5000, tick)
        frames.append(codec.encode(SESSION, tick, tick * period, report))
    return frames


def host(cycles: int, repeats: int) -> None:
    """Print the cost of a host cycle."""
    print(f"host, six axes with walls and friction: from a STATE in to its CMD out, {repeats} times {cycles} cycles")
    for name in ("in memory", "over UDP"):
        answers, wholes = np.array([timed_cycles(cycles, name == "over UDP") for _ in range(repeats)]).swapaxes(0, 1)
        for what, values in (("sent", answers), ("and kept", wholes)):
            medians = np.median(values, axis=1)
            print(
                f"  {name + ', ' + what:<24}{np.median(medians):7.1f} µs in the median (best {medians.min():.1f}), "
                f"{np.median(np.percentile(values, 99, axis=1)):7.1f} at 99 %"
            )


def timed_cycles(cycles: int, over_udp: bool) -> tuple[list[float], list[float]]:
    """Return times of each cycle until the answer was sent, and until all was done [µs]."""
    twin = Twin(TwinParameters(lockstep=True, limits=COOL), draw=lambda: SESSION)
    link = Switched(twin)
    plant, controller = RemotePlant(link, limits=WIDE), Joystick(friction=True).controller()
    plant.arm()
    answers, wholes = [], []
    with closing(UdpServer(HOME, 0)) as server, closing(UdpLink(*server.address)) as wire, no_garbage():
        wire.send(b"here")
        _, peer = server.receive(1.0) or (b"", server.address)
        link.wire = memory = Memory()
        if over_udp:
            link.wire = wire
        for frame in prepared(cycles, twin.parameters.profile.period):
            if over_udp:
                server.send(frame, peer)
            memory.frame = frame
            start = clock()
            plant.write(controller.step(plant.read()))
            wholes.append((clock() - start) * 1e-3)
            answers.append((link.sent - start) * 1e-3)
            if over_udp:
                server.receive(1.0)
    return answers, wholes


# two processes


class Polled(UdpLink):
    """Link that polls, for the usual time of an answer."""

    def receive(self, timeout: float) -> bytes | None:
        """Return the oldest frame."""
        end = self.now() + (1_000_000 if timeout > 0.0 else 0)
        while (data := super().receive(0.0)) is None and self.now() < end:
            pass
        return super().receive(timeout) if data is None and timeout > 0.0 else data


class Answered(Twin):
    """Twin that notes the arrival time of each answer."""

    def __init__(self, parameters: TwinParameters) -> None:
        super().__init__(parameters)
        self.late = LatencyHistogram()

    def receive(self, data: bytes, now: int, peer: Any) -> bytes | None:
        """Take a frame."""
        before = self.firmware.answered
        answer = super().receive(data, now, peer)
        if self.firmware.answered not in (None, before):
            self.late.add(now - self.firmware.answered * self.firmware.profile.period)
        return answer


def serve(pipe: Connection, parameters: dict[str, Any], spin: float, cpu: int | None, on_time: bool) -> None:
    """Serve a twin until SIGTERM; its first line tells the port, its last one the figures."""
    pin(cpu)
    twin = Answered(TwinParameters(**parameters))
    with closing(TwinServer(twin, UdpServer(HOME, 0), spin=spin)) as server, engine_warnings_silenced():
        with stopping(server.stop), realtime("ignore") if on_time else no_garbage():
            pipe.send(server.address[1])
            pipe.send((server.run(), twin.late))


class TwinProcess:
    """Twin in its own process, with port and figures."""

    def __init__(self, parameters: dict[str, Any], spin: float = 0.0, cpu: int | None = None, on_time: bool = False):
        spawn = multiprocessing.get_context("spawn")
        self._pipe, other = spawn.Pipe()
        self._process = spawn.Process(target=serve, args=(other, parameters, spin, cpu, on_time), daemon=True)
        self._process.start()
        self.port: int = self._pipe.recv()

    def end(self) -> tuple[ServerReport, LatencyHistogram]:
        """End the process."""
        self._process.terminate()
        result: tuple[ServerReport, LatencyHistogram] = self._pipe.recv()
        return result

    def close(self) -> None:
        """Be done with it."""
        self._process.kill()
        self._process.join()
        self._pipe.close()


def lockstep(blocks: int) -> None:
    """Print how many cycles a second two processes make."""
    print(f"two processes in lockstep over UDP, cycles a second: median and best of {blocks} blocks of {BLOCK}")
    ways = {"on one processor": (0, 0, 0.0), "wherever they like": (None, None, 0.0), "polling, one each": (0, 1, 1e-3)}
    if (os.cpu_count() or 1) < 2:
        del ways["polling, one each"]
    for scene, (controller, pose) in SCENES.items():
        for way, (ours, theirs, spin) in ways.items():
            parameters = {"lockstep": True, "pose": pose, "limits": COOL}
            with closing(TwinProcess(parameters, spin, theirs)) as twin, pinned(ours):
                link = (Polled if spin else UdpLink)(HOME, twin.port)
                with RemotePlant(link, patience=10.0) as plant, no_garbage():
                    plant.arm()
                    laws = controller()
                    rates = [BLOCK / timed(partial(drive, plant, laws, BLOCK)) for _ in range(blocks)]
            print(f"  {scene + ', ' + way:<52}{statistics.median(rates):8.0f} {max(rates):8.0f}")


def in_real_time(seconds: float) -> None:
    """Print the latency of answers at the device."""
    for rate in RATES:
        with closing(TwinProcess({"period": 1.0 / rate}, on_time=True)) as twin:
            link, scene = UdpLink(HOME, twin.port), Joystick()
            with RemotePlant(link) as plant, realtime("ignore") as refused:
                flight = Flight(plant, scene.replace(period=plant.period, delay=plant.delay))
                flown = flight.run(seconds)
            served, answered = twin.end()
        print(f"real time at {rate} Hz, {'; '.join(refused) or 'nothing refused'}")
        sampling, lost = served.latency, f"{flown.lost} lost, {flown.skipped} skipped by the host"
        print(f"  {served.ticks} samples, {served.missed} periods stalled, {lost}")
        print(f"  sampled late by {sampling.p50 * 1e6:.0f} µs in the median, {sampling.p99 * 1e6:.0f} µs at 99 %")
        print(f"  answer at the device after its sample: {answered.p50 * 1e6:.0f} µs, {answered.p99 * 1e6:.0f} at 99 %")


# what all of them need


def pin(cpu: int | None) -> None:
    """Stay on a processor."""
    if cpu is not None:
        os.sched_setaffinity(0, {cpu})


@contextmanager
def pinned(cpu: int | None) -> Iterator[None]:
    """Stay on a processor for a while."""
    before = os.sched_getaffinity(0)
    pin(cpu)
    yield
    os.sched_setaffinity(0, before)


@contextmanager
def no_garbage() -> Iterator[None]:
    """Collect none for a while, as `realtime` does."""
    gc.freeze()
    gc.disable()
    yield
    gc.enable()
    gc.unfreeze()


def main() -> None:
    """Print the sections asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a tenth of everything")
    parser.add_argument("--only", choices=PARTS, help="one part alone")
    options = parser.parse_args()
    wanted = PARTS if options.only is None else (options.only,)
    if "host" in wanted:
        host(200 if options.quick else 2000, 5 if options.quick else 15)
    if "lockstep" in wanted:
        lockstep(2 if options.quick else 20)
    if "realtime" in wanted:
        in_real_time(0.3 if options.quick else 4.0)


if __name__ == "__main__":
    main()
