"""Batches of flotors that move along z: their starts, their sampled positions, their pulses."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.controller import Controller
from maglev_mj.frames import Array, Command, Sample
from maglev_mj.loop import run
from maglev_mj.parameters import numbers
from maglev_mj.plants import SampledPlant

__all__ = ["FAR", "Watch", "along_z", "each_phase", "watched"]

FAR = (1e9, 1.0)
"""Distance [m] and angle [rad] that let an unstable flotor go on to the end of its run."""


class Watch:
    """Keeps the positions along z, (ticks, N), and counts the pulses of each device, (N,)."""

    def __init__(self, ticks: int, devices: int) -> None:
        self.places = np.zeros((ticks, devices))
        self.pulses = np.zeros(devices)

    def __call__(self, sample: Sample, command: Command) -> None:
        """Keep one sample and the command that answers it."""
        self.places[sample.tick] = sample.position[2]
        if command.extra is not None:
            self.pulses += np.broadcast_to(np.asarray(command.extra[2]) != 0.0, self.pulses.shape)


def watched(plant: SampledPlant, controller: Controller, duration: float, devices: int) -> Watch:
    """Run a batch for `duration` [s] and return its samples."""
    watch = Watch(round(duration / plant.period), devices)
    with plant:
        run(plant, controller, len(watch.places), observe=watch)
    return watch


def each_phase(values: ArrayLike, phases: int) -> tuple[Array, Array]:
    """Return each value once for each sampling phase, and the phases."""
    chosen = np.atleast_1d(numbers("values", values))
    return np.repeat(chosen, phases), np.tile(np.arange(phases) / phases, chosen.size)


def along_z(values: Array) -> Array:
    """Return (N, 6) with values along z and zero elsewhere."""
    result = np.zeros((values.size, 6))
    result[:, 2] = values
    return result
