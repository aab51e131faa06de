"""Lines that lose, repeat, damage and delay frames.

The same seed loses, repeats, damages and delays the same frames.
"""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass

from maglev_mj.bridge.twin.simulated_links import TO_DEVICE, TO_HOST, Line


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
    """

    loss: float = 0.0
    duplicate: float = 0.0
    corrupt: float = 0.0
    delay: float = 0.0
    jitter: float = 0.0
    blackouts: tuple[tuple[float, float], ...] = ()
    seed: int = 0


class Impairer:
    """Random fate of each frame in one direction.

    It draws equally often for each frame: its fate does not depend on others, nor its time on the loss rate.

    Args:
        impairment: Impairment of the line.
        stream: Number of this direction; each has its own random numbers.
        start: Instant [ns] from which blackouts count.
    """

    def __init__(self, impairment: Impairment, stream: int = 0, start: int = 0) -> None:
        self._impairment, self._start = impairment, start
        self._random = random.Random(f"{impairment.seed} {stream}")

    def fates(self, data: bytes, now: int) -> list[tuple[int, bytes]]:
        """Return arrival time [ns] and content of each copy.

        The frame is sent at `now` [ns].
        """
        draw, line = self._random.random, self._impairment
        lost, doubled = draw() < line.loss, draw() < line.duplicate
        copies = [self._copy(data, now, (draw(), draw(), draw(), draw())) for _ in range(2)]
        since = (now - self._start) * 1e-9
        dark = any(start <= since < end for start, end in line.blackouts)
        return [] if dark or lost else copies[: 1 + doubled]

    def _copy(self, data: bytes, now: int, luck: tuple[float, float, float, float]) -> tuple[int, bytes]:
        line = self._impairment
        late = line.delay + (2.0 * luck[0] - 1.0) * line.jitter
        if luck[1] < line.corrupt and data:
            changed = bytearray(data)
            changed[int(luck[2] * len(data))] ^= 1 + int(luck[3] * 255.0)
            data = bytes(changed)
        return now + max(round(late * 1e9), 0), data


class ImpairedLine(Line):
    """Line with an impairment of both directions, whose blackouts count from an instant [ns]."""

    def __init__(self, impairment: Impairment, start: int = 0) -> None:
        super().__init__()
        self.impair(impairment, start)

    def impair(self, impairment: Impairment, start: int = 0) -> None:
        """Impair frames sent from now on."""
        self._impairers = {way: Impairer(impairment, way, start) for way in (TO_HOST, TO_DEVICE)}

    def fates(self, direction: int, data: bytes, now: int) -> Sequence[tuple[int, bytes]]:
        """Return arrival time [ns] and content of each copy."""
        return self._impairers[direction].fates(data, now)
