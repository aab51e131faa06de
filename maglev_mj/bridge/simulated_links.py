"""Simulated links: a line that is bad on purpose, and a twin and a host in one program in virtual time.

The same seed loses, repeats, damages and delays the same frames.
"""

from __future__ import annotations

import heapq
import random
import threading
import time
from collections import Counter
from dataclasses import dataclass
from itertools import count
from select import select
from socket import socket, socketpair

from maglev_mj.bridge.twin import Twin
from maglev_mj.errors import ParameterError
from maglev_mj.net.udp import Address, UdpLink, UdpServer
from maglev_mj.parameters import number

__all__ = ["Impairer", "Impairment", "UdpProxy", "VirtualLink"]

_FOREVER = 60.0  # [s] between looks at a line on which nothing happens
_TO_HOST, _TO_DEVICE = "to host", "to device"
_PEER = "host"
_NEVER = 2**63


@dataclass(frozen=True)
class Impairment:
    """How bad a line is, each way.

    Attributes:
        loss: Probability that a frame never arrives.
        duplicate: Probability that one that does arrives twice.
        corrupt: Probability that a copy arrives with one byte changed.
        delay: Mean time under way [s].
        jitter: Each copy's time differs from that evenly by up to this [s], and is never negative.
        blackouts: Pairs of start and end [s] since the beginning, in which all that is sent is lost.
        seed: Of all that is drawn.

    Raises:
        ParameterError: If a value is outside its bounds, or a blackout ends before it starts.
    """

    loss: float = 0.0
    duplicate: float = 0.0
    corrupt: float = 0.0
    delay: float = 0.0
    jitter: float = 0.0
    blackouts: tuple[tuple[float, float], ...] = ()
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("loss", "duplicate", "corrupt"):
            number(name, getattr(self, name), at_least=0.0, at_most=1.0)
        for name in ("delay", "jitter"):
            number(name, getattr(self, name), at_least=0.0)
        for start, end in self.blackouts:
            if not 0.0 <= start < end:
                raise ParameterError(f"a blackout must start at 0 or later and end after that, not {(start, end)!r}")


class Impairer:
    """Decides what becomes of each frame one way; it has no clock, and draws as much for each frame.

    So the same frame has the same luck whatever came of those before it, and more loss leaves the times as they were.

    Args:
        impairment: How bad the line is.
        stream: Number of this way: each has its own luck.
        start: Instant [ns] from which blackouts count.

    Attributes:
        counts: How many frames came (`frames`), how many of them were `lost`, to a `blackout`, or `duplicated`; how
            many copies were `corrupted`, and how many arrive before one sent earlier (`reordered`).
    """

    def __init__(self, impairment: Impairment, stream: int = 0, start: int = 0) -> None:
        self._impairment, self._start = impairment, start
        self._random = random.Random(f"{impairment.seed} {stream}")
        self._latest = 0
        self.counts: Counter[str] = Counter()

    def fates(self, data: bytes, now: int) -> list[tuple[int, bytes]]:
        """Return when [ns] the copies of a frame arrive that is sent now [ns], and what arrives.

        Args:
            data: The frame.
            now: When it is sent [ns].
        """
        draw, line = self._random.random, self._impairment
        lost, doubled = draw() < line.loss, draw() < line.duplicate
        copies = [self._copy(data, now, (draw(), draw(), draw(), draw())) for _ in range(2)]
        self.counts["frames"] += 1
        since = (now - self._start) * 1e-9
        if any(start <= since < end for start, end in line.blackouts):
            self.counts["blackout"] += 1
            return []
        if lost:
            self.counts["lost"] += 1
            return []
        self.counts["duplicated"] += doubled
        arriving = copies[: 1 + doubled]
        self.counts["corrupted"] += sum(copy != data for _, copy in arriving)
        self.counts["reordered"] += sum(due < self._latest for due, _ in arriving)
        self._latest = max(self._latest, *(due for due, _ in arriving))
        return arriving

    def _copy(self, data: bytes, now: int, luck: tuple[float, float, float, float]) -> tuple[int, bytes]:
        line = self._impairment
        late = line.delay + (2.0 * luck[0] - 1.0) * line.jitter
        if luck[1] < line.corrupt and data:
            changed = bytearray(data)
            changed[int(luck[2] * len(data))] ^= 1 + int(luck[3] * 255.0)
            data = bytes(changed)
        return now + max(round(late * 1e9), 0), data


class UdpProxy:
    """A bad line between hosts and a device, in a thread of this process: give hosts its address for the device's.

    What the device sends goes to the host that was heard last.

    Args:
        upstream: Where the device listens.
        impairment: How bad the line is, each way.
        host: Address of this machine to listen at.
        port: To listen at; 0 for any that is free.

    Attributes:
        address: Where it listens.
        to_device: What became of the frames that way; `counts` has the figures.
        to_host: And that way.

    Raises:
        ParameterError: If a host or port is none.
        LinkError: If it cannot listen there.
    """

    def __init__(self, upstream: Address, impairment: Impairment, host: str = "127.0.0.1", port: int = 0) -> None:
        self._device = UdpLink(*upstream)
        try:
            self._host = UdpServer(host, port)
        except BaseException:
            self._device.close()
            raise
        self.address = self._host.address
        start = time.monotonic_ns()
        self.to_device, self.to_host = Impairer(impairment, 0, start), Impairer(impairment, 1, start)
        self._peer: Address | None = None
        self._line: list[tuple[int, int, bool, bytes]] = []
        self._entered = 0
        self._stop, self._stopped = socketpair()
        self._thread = threading.Thread(target=self._run, name="bad line", daemon=True)
        self._thread.start()

    def __enter__(self) -> UdpProxy:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End it, and lose what is under way; a second time does nothing."""
        self._stop.close()
        self._thread.join()

    def _run(self) -> None:
        ends: tuple[socket | UdpLink | UdpServer, ...] = (self._stopped, self._device, self._host)
        try:
            while True:
                left = (self._line[0][0] - time.monotonic_ns()) * 1e-9 if self._line else _FOREVER
                if self._stopped in select(ends, (), (), max(left, 0.0))[0]:
                    return
                self._take()
                self._deliver()
        finally:
            for end in ends:
                end.close()

    def _take(self) -> None:
        """Decide what becomes of the frames that have come."""
        while (heard := self._host.receive(0.0)) is not None:
            data, self._peer = heard
            self._enter(self.to_device, True, data)
        while (answer := self._device.receive(0.0)) is not None:
            self._enter(self.to_host, False, answer)

    def _enter(self, way: Impairer, outward: bool, data: bytes) -> None:
        for due, copy in way.fates(data, time.monotonic_ns()):
            self._entered += 1  # of two due at once, the first to come goes first
            heapq.heappush(self._line, (due, self._entered, outward, copy))

    def _deliver(self) -> None:
        """Send what is due."""
        while self._line and self._line[0][0] <= time.monotonic_ns():
            _, _, outward, data = heapq.heappop(self._line)
            if outward:
                self._device.send(data)
            elif self._peer is not None:
                self._host.send(data, self._peer)


class VirtualLink:
    """A link to a twin in the same program. Time is simulated, and goes on only while the host waits.

    Args:
        twin: The device; nobody else steps it.
        impairment: What becomes of frames on their way; nothing by default.

    Attributes:
        time: Simulated time [ns].
    """

    def __init__(self, twin: Twin, impairment: Impairment | None = None) -> None:
        self._twin = twin
        self._fates = {
            way: Impairer(impairment or Impairment(), offset) for offset, way in enumerate((_TO_HOST, _TO_DEVICE))
        }
        self._order = count()
        self._arrivals: list[tuple[int, int, str, bytes]] = []
        self._arrived: list[bytes] = []
        self._period = twin.parameters.profile.period
        self._lockstep = twin.parameters.lockstep
        self.time = 0

    def send(self, data: bytes) -> None:
        """Send one frame; where nothing happens to it, it is there at once."""
        self._leave(data, _TO_DEVICE)
        self._deliver()

    def receive(self, timeout: float) -> bytes | None:
        """Return the oldest frame that has come, or None if none comes within `timeout` of simulated time [s]."""
        end = self.time + round(timeout * 1e9)
        while not self._arrived:
            due = min(self._next_sample(), self._arrivals[0][0] if self._arrivals else _NEVER)
            if due > end or timeout <= 0.0:
                self.time = max(self.time, end)
                return None
            self.time = max(self.time, due)
            if self._next_sample() <= self.time:
                self._sample()
            self._deliver()
        return self._arrived.pop(0)

    def now(self) -> int:
        """Return the instant of simulated time [ns]."""
        return self.time

    def close(self) -> None:
        """Do nothing: there is nothing open."""

    def _may_sample(self) -> bool:
        """Return whether a device in lockstep may go on: there is a host, and it has answered."""
        twin = self._twin
        return twin.firmware.session != 0 and (twin.tick < 0 or twin.firmware.answered is None or twin.answered)

    def _next_sample(self) -> int:
        """Return when the device samples next [ns]."""
        if self._lockstep:
            return self.time if self._may_sample() and not self._arrived else _NEVER
        return (self._twin.tick + 1) * self._period

    def _sample(self) -> None:
        frame = self._twin.sample()
        if frame is not None:
            self._leave(frame, _TO_HOST)

    def _leave(self, data: bytes, way: str) -> None:
        for due, copy in self._fates[way].fates(data, self.time):
            heapq.heappush(self._arrivals, (due, next(self._order), way, copy))

    def _deliver(self) -> None:
        """Hand over what has arrived by now."""
        while self._arrivals and self._arrivals[0][0] <= self.time:
            _, _, way, data = heapq.heappop(self._arrivals)
            if way == _TO_HOST:
                self._arrived.append(data)
            elif answer := self._twin.receive(data, self._device_time(), _PEER):
                self._leave(answer, _TO_HOST)

    def _device_time(self) -> int:
        """Return what the device's clock says [ns]: in lockstep that of its last sample."""
        return max(self._twin.tick, 0) * self._period if self._lockstep else self.time
