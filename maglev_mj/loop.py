"""The control loop: read, control, write, for any plant."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from maglev_mj.controller import Controller
from maglev_mj.errors import MaglevError
from maglev_mj.frames import Command, Sample
from maglev_mj.parameters import number
from maglev_mj.plants.base import Plant

__all__ = ["run"]

_KEPT = 50


def run(
    plant: Plant,
    controller: Controller,
    ticks: int,
    *,
    observe: Callable[[Sample, Command], object] | None = None,
) -> Sample:
    """Drive a plant with a controller for a number of samples, then read once more.

    Args:
        plant: Any plant; it is left open.
        controller: Any controller; it is not reset.
        ticks: Samples to answer, at least 1.
        observe: Called with each sample and the command as applied.

    Returns:
        The sample after the last answer, which closes the last period.

    Raises:
        MaglevError: Whatever went wrong, with the last cycles in `cycles`; the plant was commanded zero first,
            for any other exception too.
    """
    count = int(number("ticks", ticks, at_least=1))
    cycles: deque[tuple[Sample, Command]] = deque(maxlen=_KEPT)
    sample = None
    read, step, write, keep = plant.read, controller.step, plant.write, cycles.append
    try:
        for _ in range(count):
            sample = read()
            command = write(step(sample))
            keep((sample, command))
            if observe is not None:
                observe(sample, command)
        return read()
    except BaseException as error:
        _release(plant, sample)
        if isinstance(error, MaglevError):
            error.cycles = tuple(cycles)
        raise


def _release(plant: Plant, sample: Sample | None) -> None:
    """Command zero if the plant still listens; the error that brought us here is the one to report."""
    if sample is None:
        return
    try:
        plant.write(Command([0.0] * 6))
    except MaglevError:
        plant.close()
