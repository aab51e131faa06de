"""Link to a twin in simulated time."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from itertools import count

from maglev_mj.bridge.twin.twin import Twin
from maglev_mj.parameters import number

_PEER = "host"
_NEVER = 2**63
_AGAIN = 20_000_000
"""Time after which an unanswered sample is first repeated in lockstep [ns], as in `TwinServer`."""
TO_HOST, TO_DEVICE = 0, 1
"""Directions of a link."""


class Line:
    """Frames in transit in both directions; a subclass may lose, delay or change them.

    Frames due at the same time arrive in the order of sending.

    Args:
        delay: Latency in each direction [s].

    Raises:
        ParameterError: If it is below 0.
    """

    def __init__(self, delay: float = 0.0) -> None:
        self._delay = round(number("delay", delay, at_least=0.0) * 1e9)
        self._order, self._frames = count(), list[tuple[int, int, int, bytes]]()

    def fates(self, direction: int, data: bytes, now: int) -> Sequence[tuple[int, bytes]]:
        """Return arrival time [ns] and bytes of each copy of a frame sent at `now` [ns]."""
        return [(now + self._delay, data)]

    def send(self, direction: int, data: bytes, now: int) -> None:
        """Send one frame in one direction at `now` [ns]."""
        for due, copy in self.fates(direction, data, now):
            heapq.heappush(self._frames, (due, next(self._order), direction, copy))

    @property
    def due(self) -> int:
        """Time of the next arrival [ns]."""
        return self._frames[0][0] if self._frames else _NEVER

    def arrived(self, now: int) -> Iterator[tuple[int, bytes]]:
        """Yield direction and bytes of each frame that has arrived."""
        while self.due <= now:
            yield heapq.heappop(self._frames)[2:]


class VirtualLink:
    """Link to a twin in the same process, in simulated time.

    Time advances only while the host waits. In lockstep a sample is repeated after 20, 40, 80 ms and so on until it is
    answered, and the next sample is at least a period later.

    Args:
        twin: The device, advanced only by this link.
        line: Line to it; without delay by default.

    Attributes:
        time: Simulated time [ns].
    """

    def __init__(self, twin: Twin, line: Line | None = None) -> None:
        self._twin, self._line = twin, line or Line()
        self._arrived: list[bytes] = []
        self._period, self._lockstep = twin.parameters.profile.period, twin.parameters.lockstep
        self._frame: bytes | None = None
        self._is_new, self._sent = False, -self._period  # no sample yet in this session; time of the last frame [ns]
        self._first = self._sent  # time at which that frame was sent first
        self.time = 0

    def send(self, data: bytes) -> None:
        """Send one frame."""
        self._line.send(TO_DEVICE, data, self.time)
        self._deliver()

    def receive(self, timeout: float) -> bytes | None:
        """Return the oldest received frame, or None after the timeout [s], in simulated time."""
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
        """Do nothing."""

    @property
    def _is_waiting(self) -> bool:
        """True if the device waits for the answer to its last sample."""
        return self._lockstep and not self._is_new and not self._twin.answered

    def _next_sample(self) -> int:
        """Return the time of the next sample or repetition [ns]."""
        if not self._lockstep:
            return (self._twin.tick + 1) * self._period
        if not self._twin.firmware.session:
            return _NEVER
        return self._sent + (max(self._sent - self._first, _AGAIN) if self._is_waiting else self._period)

    def _sample(self) -> None:
        if not self._is_waiting:
            self._frame, self._first = self._twin.sample(), self.time
        self._is_new, self._sent = False, self.time
        if self._frame is not None:
            self._line.send(TO_HOST, self._frame, self.time)

    def _deliver(self) -> None:
        """Deliver all frames that are due."""
        # in lockstep the device's clock stands still between samples
        now = max(self._twin.tick, 0) * self._period if self._lockstep else self.time
        for direction, data in self._line.arrived(self.time):
            if direction == TO_HOST:
                self._arrived.append(data)
                continue
            session = self._twin.firmware.session
            if answer := self._twin.receive(data, now, _PEER):
                self._line.send(TO_HOST, answer, self.time)
            self._is_new |= not session and self._twin.firmware.session != 0
