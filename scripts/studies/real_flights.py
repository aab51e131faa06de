"""Flights in real time, in processes of their own: every fault, a flood of frames, the delays of a machine.

A fault's case flies a twin over UDP or a serial line. `ms` is for how long currents flow at the device after the fault
began, in simulated time; a machine that stalls adds to what the host does.

A flood's times are from the first ESTOP leaving its sender to the firmware's cut, and to a sample with at most
`off_current`. The twin's watchdog then waits for 1 s, its longest, so that currents flow although the flood drowns the
host's commands.
"""

from __future__ import annotations

import json
import math
import os
import random
import re
import select
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from maglev_mj import find_scene
from maglev_mj.bridge.connection import estop
from maglev_mj.bridge.flight import Flight
from maglev_mj.bridge.links import open_link, parse_url
from maglev_mj.bridge.preflight import LoopTiming
from maglev_mj.bridge.realtime import realtime
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.bridge.safety import HostLimits
from maglev_mj.bridge.twin.firmware import Firmware
from maglev_mj.bridge.twin.twin import TwinServer
from maglev_mj.bridge.wire import Codec, CommandFrame, Fault, Hello, fault_names
from maglev_mj.cli import main
from maglev_mj.control import Bias, Hold
from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import drive
from maglev_mj.errors import MaglevError
from maglev_mj.frames import ZERO, Command, Sample
from maglev_mj.scenes.interactive import Joystick

AT, TIMES = 2.0, 5
"""Time of a fault [s] and number of tries."""

FLOODS = {
    "none": b"",
    "junk": random.Random(1).randbytes(136),
    "valid CMDs": Codec().encode(5, 5, 5, CommandFrame(5, 0, ZERO, ZERO, 0.0)),
    "HELLOs": Codec().encode(0, 0, 0, Hello(5, bytes(16))),
}
LAWS = Bias(Joystick().lift), Hold.critically_damped(period=0.005, delay=0.003)

Act = Callable[[RemotePlant, str], float | None]


class Case(NamedTuple):
    """A fault to inject, and its allowed outcome.

    Its names, options of the twin, largest K, the host's act and limits, and the time to cut.

    What the host does may return the force to which it then pushes along z within a second [N].
    """

    names: Fault
    options: str = ""
    largest: int = 0
    act: Act | None = None
    limits: HostLimits | None = None
    seconds: float = 1.5


def commanding(ahead: int = 0, **changes: Any) -> Act:
    """Return an act that sends a forbidden command."""

    def act(plant: RemotePlant, _: str) -> None:
        line, hover = plant._connection, tuple(plant.calibration.hover.tolist())
        line._sequence += ahead
        line.command(CommandFrame(line._newest or 0, 0, hover, hover, 0.0)._replace(**changes))
        line._sequence -= ahead

    return act


def stop(plant: RemotePlant, address: str) -> None:
    """Stop by another host; a serial line has no other."""
    if address.startswith("serial"):
        plant.estop()
    else:
        threading.Thread(target=lambda: estop(open_link(address))).start()


def injected(names: Fault, largest: int, what: str, push: str = "", seconds: float = 1.5) -> Case:
    """Return a device fault with a pushing hand."""
    options = f"--fault {what}@{{at}}" if "@" not in what else f"--fault {what}"
    return Case(names, f"{options} --push {push}" if push else options, largest, seconds=seconds)


BAD, ALL = Fault.COIL_NOT_FOLLOWING | Fault.COIL_NOT_OFF, "x:4@{at}-9 --push y:4@{at}-9"
AWAY = Fault.FLOTOR_OVERSPEED | Fault.BOUNDARY | Fault.SENSOR_OUT_OF_RANGE
FROZEN, HOT, LEFT, DOWN = Fault.SENSOR_FROZEN, Fault.COIL_OVERTEMP, "x:4@{at}-9", "z:-8@1.5-{at}"
CASES: dict[str, Case] = {
    "dead-coil": injected(BAD, 5, "dead-coil:{k}", ALL),
    "stuck-amplifier": injected(BAD, 5, "stuck-amplifier:{k}", ALL),
    "stuck-diode": injected(FROZEN, 2, "stuck-diode:{k}"),
    "stuck-diode under a hand": injected(FROZEN, 2, "stuck-diode:{k}", DOWN),
    "stuck-diodes": injected(FROZEN, 0, "stuck-diodes:0"),
    "stuck-diodes under a hand": injected(FROZEN, 0, "stuck-diodes:0", DOWN),
    "stuck-counter": injected(Fault.SENSOR_STOPPED, 0, "stuck-counter:0"),
    "invalid-diode": injected(Fault.SENSOR_OUT_OF_RANGE, 2, "invalid-diode:{k}"),
    "swapped-diodes in flight": injected(AWAY, 2, "swapped-diodes:{k}", ALL),
    "swapped-diodes at takeoff": injected(Fault.NOT_FOLLOWING, 2, "swapped-diodes:{k}@0"),
    "nan-spot": injected(Fault.SENSOR_OUT_OF_RANGE, 5, "nan-spot:{k}"),
    "nan-current": injected(Fault.COIL_OVERCURRENT, 5, "nan-current:{k}"),
    "nan-temperature": injected(HOT, 5, "nan-temperature:{k}"),
    "hot-report": injected(HOT, 5, "hot-report:{k}"),
    "clock-jump of 3 ms": injected(Fault.CLOCK, 0, "clock-jump:3"),
    "clock-jump of 100 ms": injected(Fault.WATCHDOG, 0, "clock-jump:100"),
    "silence of 200 ms": injected(Fault.WATCHDOG, 0, "silence:200"),
    "silence without end": injected(Fault.HOST, 0, "silence:9000", seconds=3.0),
    "hung-firmware": injected(Fault.HOST, 0, "hung-firmware:0", seconds=3.0),
    "flotor held at takeoff": Case(Fault.NOT_FOLLOWING, "--push z:-20@0-9"),
    "beyond the envelope": Case(Fault.BOUNDARY, "--push rz:0.4@{at}-9", limits=HostLimits(envelope_angle=0.03)),
    "above the host's speed": Case(Fault.FLOTOR_OVERSPEED, "--push x:20@{at}-9", limits=HostLimits(speed_limit=0.05)),
    "6 A in three coils": Case(HOT, act=lambda *_: -43.0, seconds=9.0),
    "host silent for 300 ms": Case(Fault.WATCHDOG, act=lambda *_: time.sleep(0.3)),
    "CMD of 11 A": Case(Fault.COIL_OVERCURRENT, act=commanding(held=(11.0,) * 6)),
    "CMD of NaN": Case(Fault.INVALID_COMMAND, act=commanding(held=(math.nan,) * 6)),
    "CMD with a width of 2 s": Case(Fault.INVALID_COMMAND, act=commanding(width=2.0)),
    "CMD far ahead": Case(Fault.WATCHDOG, act=commanding(ahead=2**30)),
    "law that is not a number": Case(Fault.INVALID_COMMAND, act=lambda *_: math.nan),
    "TRIP": Case(Fault.HOST, act=lambda plant, _: plant.trip(Fault.HOST)),
    "host's program fails": Case(Fault.HOST, act=lambda *_: 1 / 0),
    "ESTOP": Case(Fault.ESTOP, act=stop),
}


def device(*options: str) -> None:
    """Run the twin's process, and record its currents."""
    run, record = TwinServer.run, {"flowing": 0, "faults": 0, "zero": 0}

    def recorded(server: TwinServer, *_: Any) -> Any:
        twin, period = server.twin, server.twin.firmware.profile.period

        def each() -> None:
            nanoseconds = 0.0
            for duration, currents in twin.plant.intervals:
                nanoseconds += duration * 1e9
                if any(one for coil, one in enumerate(currents) if coil not in twin.board.stuck):
                    record["flowing"] = round((twin.tick - 1) * period + nanoseconds)
                    record["zero"] = server._zero
            record["faults"] = int(twin.firmware.faults)

        return run(server, 60.0, each)

    TwinServer.run = recorded  # type: ignore[assignment, method-assign]
    main(["twin", *options])
    print(json.dumps(record), flush=True)


def calling(function: Callable[..., None], *words: str) -> tuple[str, ...]:
    """Return a program that calls a function of this module with words."""
    folder, name = str(Path(__file__).resolve().parent), function.__name__
    program = f"import sys; sys.path.insert(0, {folder!r}); import real_flights; real_flights.{name}(*sys.argv[1:])"
    return "-c", program, *words


@contextmanager
def process(*words: str) -> Iterator[tuple[Any, str]]:
    """Start a twin's process; yield it and the twin's address."""
    with subprocess.Popen([sys.executable, *words], stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        try:
            yield child, re.findall(r"(?:udp|serial)://[^\s,]+", child.stdout.readline())[0]
        finally:
            child.terminate()
            child.stdout.read() if not child.stdout.closed else None


def flown(case: Case, k: int, line: str) -> tuple[Fault, float]:
    """Fly once; return latched faults and cut times [ms], at both ends."""
    listen = "pty" if line == "serial" else "udp://127.0.0.1:0"
    options = case.options.format(k=k % (case.largest + 1), at=AT).split()
    began, extra, named = 0, 0.0, Fault(0)

    class Hovering(Controller):
        def step(self, sample: Sample) -> Command:
            nonlocal began, extra
            if case.act is not None and sample.tick >= start + 60 and not began:
                began = time.monotonic_ns()
                extra = case.act(plant, address) or 0.0
            pushed = extra * min(1.0, (time.monotonic_ns() - began) * 1e-9) if extra else 0.0
            force = super().step(sample).force
            return Command([*force[:2], force[2] + pushed, *force[3:]])

    words = "--listen", listen, "--seed", str(k), *options
    with process(*calling(device, *words)) as (child, address), tempfile.TemporaryDirectory() as folder:
        plant = RemotePlant(open_link(address), limits=case.limits, folder=Path(folder))
        with suppress(MaglevError, ZeroDivisionError), plant:
            began = time.monotonic_ns() if "@0" in case.options else 0
            plant.takeoff()
            start = plant.samples.tick
            drive(plant, Hovering(LAWS, period=0.005), round((case.seconds + AT) / 0.005))
        named = plant.faults
        time.sleep(0.1)
        child.send_signal(signal.SIGINT)
        record = json.loads(child.communicate(timeout=30)[0].splitlines()[-1])
    named |= Fault(record["faults"])
    first = began - record["zero"] if began else AT * 1e9
    return named, (record["flowing"] - first) * 1e-6


def campaign(words: Sequence[str]) -> None:
    """Fly each case named, or all, repeatedly over each line; print a table."""
    lines, names = ([one for one in every if one in words] or list(every) for every in (("udp", "serial"), CASES))
    print("| fault | line | tried | cut | named | called | ms, median and largest | flown again |")
    print("|---|---|---|---|---|---|---|---|", flush=True)
    for name, line in product(names, lines):
        case, again = CASES[name], 0
        tries: list[tuple[Fault, float]] = []
        while len(tries) < TIMES and again < 20:
            faults, lasted = flown(case, len(tries), line)
            # a machine that stalls for as long as the watchdog waits ends a flight before its fault
            early = lasted < 0.0 or (faults == Fault.WATCHDOG and not faults & case.names)
            again += early
            tries += [] if early else [(faults, lasted)]
        cut = sum(bool(faults) and lasted < 1e3 * case.seconds for faults, lasted in tries)
        named = sum(bool(faults & case.names) for faults, _ in tries)
        called = ", ".join(f"{words} {count}" for words, count in Counter(fault_names(one) for one, _ in tries).items())
        times = [lasted for _, lasted in tries] or [math.nan]
        figures = f"{statistics.median(times):.1f}, {max(times):.1f}"
        print(f"| {name} | {line} | {len(tries)} | {cut} | {named} | {called} | {figures} | {again} |", flush=True)


# an emergency stop under a flood


def flooded_device() -> None:
    """Be the twin's process; print when ESTOP is latched first."""
    trip = Firmware.trip

    def reported(firmware: Firmware, faults: Fault, now: int, *, soft: bool = False) -> None:
        first = not firmware.faults
        trip(firmware, faults, now, soft=soft)
        if first:
            print(f"cut {time.monotonic_ns()} {int(faults)}", flush=True)

    Firmware.trip = reported  # type: ignore[assignment, method-assign]
    main(["twin", "--listen", "udp://127.0.0.1:0", "--watchdog", "1", "--seconds", "20"])


def flood(address: str, kind: str) -> None:
    """Send a frame again and again."""
    # neither its parent's priority nor its processor
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.sched_setaffinity(0, range(os.cpu_count() or 1))
    url = parse_url(address)
    data, to, link = FLOODS[kind], (url.host, url.number), socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    end = time.monotonic() + 1.0
    print("begun", flush=True)
    while data and time.monotonic() < end:
        for _ in range(1000):
            link.sendto(data, to)


def stopped(kind: str) -> tuple[float, float]:
    """Fly, flood and stop once; return times to the cut, and to a sample with at most `off_current` [ms]."""
    with process(*calling(flooded_device)) as (child, address), tempfile.TemporaryDirectory() as folder:
        plant = RemotePlant(open_link(address), folder=Path(folder))
        plant.takeoff()
        command, laws = [sys.executable, *calling(flood, address, kind)], Controller(LAWS, period=0.005)
        flooding: Any = subprocess.Popen(command, stdout=subprocess.PIPE)
        while not select.select([flooding.stdout], [], [], 0.0)[0]:  # the watchdog would end a flight without host
            drive(plant, laws, 4)
        time.sleep(0.3)
        sent = time.monotonic_ns()
        report = estop(open_link(address))
        flooding.communicate()
        _, cut, faults = next(line for line in child.stdout if line.startswith("cut")).split()
        assert int(faults) == Fault.ESTOP and report.confirmed, (faults, report)
        return (int(cut) - sent) * 1e-6, report.duration * 1e3


def floods(count: int) -> None:
    """Print a table."""
    print("| flood | tried | to the cut, median and largest [ms] | to currents off [ms] |\n|---|---|---|---|")
    for kind in FLOODS:
        cuts, zeros = (sorted(one) for one in zip(*[stopped(kind) for _ in range(count)]))
        middle = count // 2
        figures = f"{cuts[middle]:.2f}, {cuts[-1]:.2f} | {zeros[middle]:.1f}, {zeros[-1]:.1f}"
        print(f"| {kind} | {count} | {figures} |", flush=True)


# delays of this machine


def record_delays(path: Path, seconds: float) -> None:
    """Fly a twin over UDP in real time, at both rates; keep each sample's delay.

    First on the idle machine, then with every core busy. A flight that a stall ends is followed by another; the delays
    of an earlier call are kept.
    """
    print("| load, samples a second | samples | median [ms] | 99 % | largest |\n|---|---|---|---|---|", flush=True)
    delays_by_load = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    for load, rate in product(("quiet", "busy"), (200, 1000)):
        cores = range(os.cpu_count() or 1) if load == "busy" else ()
        busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in cores]
        name = f"{load} {rate}"
        delays: list[int] = []
        try:
            for _ in range(20):
                if len(delays) < seconds * rate:
                    delays += real_delays(rate, seconds - len(delays) / rate)
        finally:
            for one in busy:
                one.kill()
                one.wait()
        delays_by_load[name] = delays_by_load.get(name, []) + delays
        median, most, largest = np.quantile(delays, (0.5, 0.99, 1.0)) * 1e-3
        print(f"| {name} | {len(delays)} | {median:.2f} | {most:.2f} | {largest:.2f} |", flush=True)
    path.write_text(json.dumps(delays_by_load), encoding="utf-8")


def real_delays(rate: int, seconds: float) -> list[int]:
    """Return the delays of one flight in real time, above the device's own [µs]."""
    delays: list[int] = []

    class Timing(LoopTiming):
        def add(self, plant: RemotePlant) -> None:
            super().add(plant)
            late = max(plant.answers.delay_bound - plant.delay, self.newest_age)
            delays.append(round(max(late, 0.0) * 1e6))

    words = "-m", "maglev_mj", "twin", "--listen", "udp://127.0.0.1:0", "--rate", str(rate)
    with process(*words) as (_, address), tempfile.TemporaryDirectory() as folder:
        try:
            with realtime("ignore"), RemotePlant(open_link(address), folder=folder) as plant:
                scene = find_scene("joystick")().replace(period=plant.period, delay=plant.delay)
                flight = Flight(plant, scene)
                flight.timing = Timing()
                flight.run(seconds)
        except MaglevError as error:  # a stall of this machine ends the flight
            print(f"after {len(delays) / rate:.1f} s: {error}", file=sys.stderr)
    return delays


def print_table(*head: str, rows: Iterable[Sequence[object]]) -> None:
    """Print a table as Markdown."""
    print("\n| " + " | ".join(head) + " |\n|" + "---|" * len(head))
    for row in rows:
        print("| " + " | ".join(str(part) for part in row) + " |")
