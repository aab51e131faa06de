"""A wire in virtual time: a twin and a host in one program, as fast as they go, the same again for the same seeds."""

from __future__ import annotations

import heapq
from itertools import count

from maglev_mj.bridge.impair import Impairer, Impairment
from maglev_mj.bridge.twin import Twin

__all__ = ["VirtualLink"]

_TO_HOST, _TO_DEVICE = "to host", "to device"
_PEER = "host"
_NEVER = 2**63


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
