"""Link to a twin in virtual time."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from itertools import count

from maglev_mj.bridge.twin.twin import Twin
from maglev_mj.parameters import number

_PEER = "host"
_NEVER = 2**63
TO_HOST, TO_DEVICE = 0, 1
"""Directions of a line."""


class Line:
    """Frames in transit in both directions. A subclass may lose or change them.

    Of two due at once, the first sent arrives first.

    Args:
        delay: Time under way, each way [s].

    Raises:
        ParameterError: If it is below 0.
    """

    def __init__(self, delay: float = 0.0) -> None:
        self._delay = round(number("delay", delay, at_least=0.0) * 1e9)
        self._order, self._frames = count(), list[tuple[int, int, int, bytes]]()

    def fates(self, direction: int, data: bytes, now: int) -> Sequence[tuple[int, bytes]]:
        """Return arrival time [ns] and content of each copy of a frame that is sent at `now` [ns]."""
        return [(now + self._delay, data)]

    def send(self, direction: int, data: bytes, now: int) -> None:
        """Send one frame in one direction at `now` [ns]."""
        for due, copy in self.fates(direction, data, now):
            heapq.heappush(self._frames, (due, next(self._order), direction, copy))

    @property
    def due(self) -> int:
        """Instant of the next arrival [ns]."""
        return self._frames[0][0] if self._frames else _NEVER

    def arrived(self, now: int) -> Iterator[tuple[int, bytes]]:
        """Yield direction and content of each frame that has arrived."""
        while self.due <= now:
            yield heapq.heappop(self._frames)[2:]


class VirtualLink:
    """Link to a twin of this program in simulated time.

    Time advances only while the host waits.

    Args:
        twin: The device, stepped by this link alone.
        line: Line to it; by default one on which each frame arrives at once.

    Attributes:
        time: Simulated time [ns].
    """

    def __init__(self, twin: Twin, line: Line | None = None) -> None:
        self._twin, self._line = twin, line or Line()
        self._arrived: list[bytes] = []
        self._period, self._lockstep = twin.parameters.profile.period, twin.parameters.lockstep
        self.time = 0

    def send(self, data: bytes) -> None:
        """Send one frame."""
        self._line.send(TO_DEVICE, data, self.time)
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
            self._line.send(TO_HOST, frame, self.time)

    def _deliver(self) -> None:
        """Deliver all frames that have arrived."""
        # in lockstep the device's clock stands at its last sample
        now = max(self._twin.tick, 0) * self._period if self._lockstep else self.time
        for direction, data in self._line.arrived(self.time):
            if direction == TO_HOST:
                self._arrived.append(data)
            elif answer := self._twin.receive(data, now, _PEER):
                self._line.send(TO_HOST, answer, self.time)
