"""A twin behind a socket or a serial line: in real time, or in lockstep with its host."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import NamedTuple

from maglev_mj.bridge.realtime import Lateness
from maglev_mj.bridge.twin import Twin
from maglev_mj.net.udp import Address, Server

__all__ = ["Served", "TwinServer"]

_AGAIN = 0.02
_LET_GO = 2.0
_LOOK = 0.05
_AT_ONCE = 8


class Served(NamedTuple):
    """What a server came to.

    Attributes:
        ticks: Samples taken.
        missed: Periods for which simulated time stood still because the machine did.
        wall_time: For how long it ran [s].
        lateness: Of the samples, in real time.
    """

    ticks: int
    missed: int
    wall_time: float
    lateness: Lateness


class TwinServer:
    """Runs a twin: samples on time, frames in and out.

    In real time it is the clock of both ends: it samples at absolute deadlines, and where it is late by whole periods
    simulated time stands still for as long. In lockstep it takes a sample when the one before is answered, says it
    again after 20 ms without answer, and lets go after 2 s.

    Args:
        twin: The device.
        server: Where hosts reach it; closed with the server.
        spin: How long to poll rather than sleep in lockstep [s]: quick where a processor is free for it.

    Attributes:
        address: Where hosts reach it.
        missed: See `Served`.
    """

    def __init__(self, twin: Twin, server: Server, *, spin: float = 0.0) -> None:
        self.twin, self._server, self._spin = twin, server, spin
        self._period = twin.firmware.profile.period
        self.address: Address = server.address
        self.missed = 0
        self.lateness = Lateness()
        self._stopped = threading.Event()

    def run(self, duration: float | None = None, each: Callable[[], object] | None = None) -> Served:
        """Serve until `stop`, or for so long [s].

        Args:
            duration: How long [s]; None until stopped.
            each: Called after each sample.

        Raises:
            MaglevError: If the simulated device cannot go on, or the line is gone.
        """
        start = time.monotonic_ns()
        end = None if duration is None else start + round(duration * 1e9)
        try:
            if self.twin.parameters.lockstep:
                self._in_lockstep(end, each)
            else:
                self._in_real_time(end, each)
        finally:
            self.twin.cut()
        wall = (time.monotonic_ns() - start) * 1e-9
        return Served(self.twin.tick + 1, self.missed, wall, self.lateness)

    def stop(self) -> None:
        """Let `run` end; from any thread."""
        self._stopped.set()

    def close(self) -> None:
        """Stop, and close the socket or line."""
        self.stop()
        self._server.close()

    def _over(self, end: int | None) -> bool:
        return self._stopped.is_set() or (end is not None and time.monotonic_ns() >= end)

    def _in_real_time(self, end: int | None, each: Callable[[], object] | None) -> None:
        twin, clock, period = self.twin, time.monotonic_ns, self._period
        zero = clock() - max(twin.tick, 0) * period
        while not self._over(end):
            deadline = zero + (twin.tick + 1) * period
            self._listen(deadline, zero)
            late = clock() - deadline
            self.lateness.add(late)
            # a machine that stalls makes simulated time stall, where catching up would look like a host gone silent
            self.missed += late // period
            zero += late // period * period
            self._say(twin.sample())
            if each is not None:
                each()

    def _listen(self, deadline: int, zero: int) -> None:
        """Take frames until a deadline [ns]; a few where it has passed already, for late is not deaf."""
        clock, server = time.monotonic_ns, self._server
        for _ in range(_AT_ONCE if clock() >= deadline else 0):
            if (arrived := server.receive(0.0)) is None:
                break
            self._take(*arrived, deadline - zero)
        while (left := deadline - clock()) > 0:
            arrived = server.receive(min(left * 1e-9, _LOOK))
            if arrived is not None:
                self._take(*arrived, clock() - zero)
            elif self._stopped.is_set():
                return

    def _take(self, data: bytes, sender: Address, now: int) -> None:
        answer = self.twin.receive(data, now, sender)
        if answer is not None:
            self._server.send(answer, sender)

    def _say(self, frame: bytes | None) -> None:
        if frame is not None:
            self._server.send(frame, self.twin.firmware.peer)

    def _in_lockstep(self, end: int | None, each: Callable[[], object] | None) -> None:
        twin = self.twin
        while not self._over(end):
            if twin.firmware.session == 0:
                self._hear(_LOOK)
                continue
            frame = twin.sample()
            self._say(frame)
            if each is not None:
                each()
            self._await_answer(frame)

    def _await_answer(self, frame: bytes | None) -> None:
        """Wait until the last sample is answered, or nobody is there any more."""
        twin, clock = self.twin, time.monotonic_ns
        asked = clock()
        patience = asked + round(_LET_GO * 1e9)
        again = asked + round(_AGAIN * 1e9)
        spun = asked + round(self._spin * 1e9)
        while not twin.answered and twin.firmware.session and not self._stopped.is_set():
            self._hear(0.0 if clock() < spun else _AGAIN)
            if twin.answered:
                return
            now = clock()
            if now > patience:
                twin.firmware.lose_host()
            elif now > again:
                self._say(frame)
                again = now + round(_AGAIN * 1e9)

    def _hear(self, timeout: float) -> None:
        """Take a frame if one comes in time [s]."""
        arrived = self._server.receive(timeout)
        if arrived is not None:
            self._take(*arrived, max(self.twin.tick, 0) * self._period)
