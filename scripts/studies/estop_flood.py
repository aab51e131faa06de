"""Stop a flying twin under a flood of frames, and time the cut.

    python scripts/studies/estop_flood.py [20]

The time is from the first ESTOP leaving its sender to the firmware's cut, and to a sample without current. The twin's
watchdog waits for 1 s, its longest, so that currents flow although the flood drowns the host's commands.
"""

from __future__ import annotations

import os
import random
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from maglev_mj.bridge.connection import estop
from maglev_mj.bridge.links import open_link, parse_url
from maglev_mj.bridge.realtime import realtime
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.bridge.twin.firmware import Firmware
from maglev_mj.bridge.wire import Codec, Command, Fault, Hello
from maglev_mj.cli import main
from maglev_mj.control import Bias, Hold
from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import drive
from maglev_mj.frames import ZERO
from maglev_mj.scenes.rooms import INERTIA, WEIGHT

CODEC = Codec()
FLOODS = {
    "none": b"",
    "junk": random.Random(1).randbytes(136),
    "valid CMDs": CODEC.encode(5, 5, 5, Command(5, 0, ZERO, ZERO, 0.0)),
    "HELLOs": CODEC.encode(0, 0, 0, Hello(5, bytes(16))),
}


def device() -> None:
    """Be the twin's process; say when ESTOP is latched first."""
    trip = Firmware.trip

    def told(firmware: Firmware, faults: Fault, now: int) -> None:
        first = not firmware.faults
        trip(firmware, faults, now)
        if first:
            print(f"cut {time.monotonic_ns()} {int(faults)}", flush=True)

    Firmware.trip = told  # type: ignore[assignment, method-assign]
    main(["twin", "--listen", "udp://127.0.0.1:0", "--watchdog", "1", "--seconds", "20"])


def flood(address: str, data: bytes) -> None:
    """Send a frame again and again."""
    # neither its parent's priority nor its processor
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.sched_setaffinity(0, range(os.cpu_count() or 1))
    url = parse_url(address)
    to, link = (url.place, url.number), socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    end = time.monotonic() + 3.0
    while data and time.monotonic() < end:
        for _ in range(1000):
            link.sendto(data, to)


def stopped(kind: str) -> tuple[float, float]:
    """Fly, flood and stop once; return times to the cut, and to zero current [ms]."""
    child: Any = subprocess.Popen([sys.executable, __file__, "device"], stdout=subprocess.PIPE, text=True)
    address = child.stdout.readline().split(" at ")[1].split(",")[0]
    hold = Hold.critically_damped(inertia=INERTIA, period=0.005, delay=0.003)
    try:
        with tempfile.TemporaryDirectory() as folder:
            plant = RemotePlant(open_link(address), folder=Path(folder))
            plant.takeoff()
            drive(plant, Controller([Bias(WEIGHT), hold], period=0.005), 40)
            flooding = subprocess.Popen([sys.executable, __file__, "flood", address, kind])
            time.sleep(1.5)  # until it has begun
            sent = time.monotonic_ns()
            report = estop(open_link(address))
            flooding.wait()
        _, cut, faults = next(line for line in child.stdout if line.startswith("cut")).split()
        assert int(faults) == Fault.ESTOP and report.confirmed, (faults, report)
        return (int(cut) - sent) * 1e-6, report.duration * 1e3
    finally:
        child.kill()
        child.communicate()


def measured(count: int) -> None:
    """Print a table."""
    print("| flood | tried | to the cut, median and largest [ms] | to a sample without current |\n|---|---|---|---|")
    for kind in FLOODS:
        cuts, zeros = (sorted(one) for one in zip(*[stopped(kind) for _ in range(count)]))
        middle = count // 2
        figures = f"{cuts[middle]:.2f}, {cuts[-1]:.2f} | {zeros[middle]:.1f}, {zeros[-1]:.1f}"
        print(f"| {kind} | {count} | {figures} |", flush=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["device"]:
        device()
    elif sys.argv[1:2] == ["flood"]:
        flood(sys.argv[2], FLOODS[sys.argv[3]])
    else:
        with realtime("ignore"):
            measured(int(sys.argv[1]) if sys.argv[1:] else 20)
