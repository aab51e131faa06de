"""The contract between a control loop and a plant."""

from __future__ import annotations

from typing import Protocol

from maglev_mj.frames import Command, Sample

__all__ = ["Plant"]


class Plant(Protocol):
    """What a control loop asks of a plant, simulated or real."""

    @property
    def period(self) -> float:
        """Sample period [s]."""

    def read(self) -> Sample:
        """Wait for the next sampling instant and return what is measured there."""

    def write(self, command: Command) -> Command:
        """Send the answer to the last sample; return it as applied, after every limit."""

    def close(self) -> None:
        """Let go of the plant; safe to call at any time, and more than once."""
