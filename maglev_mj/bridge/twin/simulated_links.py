"""Simulated links: impaired line, and twin in virtual time.

The same seed loses, repeats, damages and delays the same frames.
"""

from __future__ import annotations

import heapq
import random
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count

from maglev_mj.bridge.twin.twin import Twin
from maglev_mj.errors import ParameterError
from maglev_mj.parameters import number

_PEER = "host"
_NEVER = 2**63


@dataclass(frozen=True)
class Impairment:
    """Impairment of a line, each way.

    Attributes:
        loss: Probability that a frame never arrives.
        duplicate: Probability that an arriving frame arrives twice.
        corrupt: Probability that a copy arrives with one byte changed.
        delay: Mean time under way [s].
        jitter: Half width of the uniform variation of each copy's time [s]; the time is never negative.
        blackouts: Pairs of start and end [s] since the beginning, in which all frames are lost.
        seed: Seed of the random numbers.

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
    """Random fate of each frame in one direction.

    It draws equally often for each frame: its fate does not depend on others, nor its time on the loss rate.

    Args:
        impairment: Impairment of the line.
        stream: Number of this direction; each has its own random numbers.
        start: Instant [ns] from which blackouts count.

    Attributes:
        counts: Numbers of frames (`frames`, `lost`, lost to a `blackout`, `duplicated`) and of copies
            (`corrupted`; `reordered`: arriving before one sent earlier).
    """

    def __init__(self, impairment: Impairment, stream: int = 0, start: int = 0) -> None:
        self._impairment, self._start = impairment, start
        self._random = random.Random(f"{impairment.seed} {stream}")
        self._latest = 0
        self.counts: Counter[str] = Counter()

    def fates(self, data: bytes, now: int) -> list[tuple[int, bytes]]:
        """Return arrival time [ns] and content of each copy.

        The frame is sent at `now` [ns].
        """
        draw, line = self._random.random, self._impairment
        lost, doubled = draw() < line.loss, draw() < line.duplicate
        copies = [self._copy(data, now, (draw(), draw(), draw(), draw())) for _ in range(2)]
        self.counts["frames"] += 1
        since = (now - self._start) * 1e-9
        dark = any(start <= since < end for start, end in line.blackouts)
        if dark or lost:
            self.counts["blackout" if dark else "lost"] += 1
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


class ImpairedLine:
    """Frames in transit in both directions.

    Of two due at once, the first sent arrives first.
    """

    def __init__(self, impairment: Impairment, start: int = 0) -> None:
        self.to_host, self.to_device = Impairer(impairment, 0, start), Impairer(impairment, 1, start)
        self._order, self._frames = count(), list[tuple[int, int, Impairer, bytes]]()

    def send(self, way: Impairer, data: bytes, now: int) -> None:
        """Send one frame in one direction at `now` [ns]."""
        for due, copy in way.fates(data, now):
            heapq.heappush(self._frames, (due, next(self._order), way, copy))

    @property
    def due(self) -> int:
        """Instant of the next arrival [ns]."""
        return self._frames[0][0] if self._frames else _NEVER

    def arrived(self, now: int) -> Iterator[tuple[Impairer, bytes]]:
        """Yield direction and content of each frame that has arrived."""
        while self.due <= now:
            yield heapq.heappop(self._frames)[2:]


class VirtualLink:
    """Link to a twin of this program in simulated time.

    Time advances only while the host waits.

    Args:
        twin: The device, stepped by this link alone.
        impairment: Impairment of the line; none by default.

    Attributes:
        time: Simulated time [ns].
    """

    def __init__(self, twin: Twin, impairment: Impairment | None = None) -> None:
        self._twin, self._line = twin, ImpairedLine(impairment or Impairment())
        self._arrived: list[bytes] = []
        self._period, self._lockstep = twin.parameters.profile.period, twin.parameters.lockstep
        self.time = 0

    def send(self, data: bytes) -> None:
        """Send one frame; without impairment it arrives at once."""
        self._line.send(self._line.to_device, data, self.time)
        self._deliver()

    def receive(self, timeout: float) -> bytes | None:
        """Return the oldest received frame, or None after the timeout.

        The timeout is in simulated time [s].
        """
        end = self.time + round(timeout * 1e9)
        while not self._arrived:
            due = min(self._next_sample(), self._line.due)
            if due > end or timeout <= 0.0:
                self.time = max(self.time, end)
                return None
            self.time = max(self.time, due)
            if self._next_sample() <= self.time:
                self._sample()
            self._deliver()
        return self._arrived.pop(0)

    def now(self) -> int:
        """Return the simulated time [ns]."""
        return self.time

    def close(self) -> None:
        """Do nothing: there is nothing open."""

    def _next_sample(self) -> int:
        """Return the next sample's time [ns].

        In lockstep it waits for a host and its answer.
        """
        twin = self._twin
        if not self._lockstep:
            return (twin.tick + 1) * self._period
        ready = twin.firmware.session and (twin.tick < 0 or twin.firmware.answered is None or twin.answered)
        return self.time if ready and not self._arrived else _NEVER

    def _sample(self) -> None:
        if (frame := self._twin.sample()) is not None:
            self._line.send(self._line.to_host, frame, self.time)

    def _deliver(self) -> None:
        """Deliver all frames that have arrived."""
        # in lockstep the device's clock stands at its last sample
        now = max(self._twin.tick, 0) * self._period if self._lockstep else self.time
        for way, data in self._line.arrived(self.time):
            if way is self._line.to_host:
                self._arrived.append(data)
            elif answer := self._twin.receive(data, now, _PEER):
                self._line.send(self._line.to_host, answer, self.time)
