"""Control loop for any plant: read, control, write."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol, TypeAlias

from maglev_mj.errors import MaglevError, ParameterError, one_line
from maglev_mj.frames import Command, Sample
from maglev_mj.parameters import whole

_KEPT = 50  # more of them leave the fastest cache: 200 cost 4 % of the loop

Record: TypeAlias = Callable[[Sample, Command, Command], object]
"""Function of a sample, its answer, and the applied command.

The applied command is zero if the plant refused the answer.
"""


class Plant(Protocol):
    """Interface of a plant to the control loop."""

    @property
    def period(self) -> float:
        """Sample period [s]."""

    def read(self) -> Sample:
        """Wait for the next sampling instant and return its measurement."""

    def write(self, command: Command) -> Command:
        """Send the answer to the last sample.

        Returns the command as applied, after every limit.
        """

    def close(self) -> None:
        """Release the plant.

        Safe at any time, and more than once.
        """


class Answers(Protocol):
    """Interface of a controller to the control loop."""

    @property
    def period(self) -> float:
        """Sample period [s]."""

    def step(self, sample: Sample) -> Command:
        """Answer one sample."""


class ControlLoop:
    """Control loop of a plant and a controller.

    It reads, controls and writes, for a number of samples at a time.

    Args:
        plant: Any plant; it is left open.
        controller: Any controller; it is not reset.
        observe: Function called with each sample and the command as applied.
        record: Function that records each cycle.

    Raises:
        ParameterError: If the periods differ, or plant and controller are swapped.
    """

    def __init__(
        self,
        plant: Plant,
        controller: Answers,
        *,
        observe: Callable[[Sample, Command], object] | None = None,
        record: Record | None = None,
    ) -> None:
        for name, part, method in (("plant", plant, "read"), ("controller", controller, "step")):
            if isinstance(part, type) or not hasattr(part, method):
                raise ParameterError(f"{name} must have {method}(), not be {one_line(part)}")
        for name, function in (("observe", observe), ("record", record)):
            if not (function is None or callable(function)):
                raise ParameterError(f"{name} must be a function, as open_recording(FILE).begin(plant, controller) is")
        if controller.period != plant.period:
            raise ParameterError(
                f"period must be the plant's {plant.period:g} in the controller, not {controller.period:g}"
            )
        self._plant, self._controller, self._observe, self._record = plant, controller, observe, record
        self._cycles: deque[tuple[Sample, Command]] = deque(maxlen=_KEPT)

    def cycle(self, count: int = 1) -> None:
        """Answer a number of samples.

        Raises:
            MaglevError: If a cycle fails; `cycles` holds the last ones. The plant was commanded zero before, or closed
                if that failed too. The same holds for any other exception.
        """
        sample = command = None
        plant, observe, record = self._plant, self._observe, self._record
        read, step, write, keep = plant.read, self._controller.step, plant.write, self._cycles.append
        try:
            for _ in range(count):
                command = None
                sample = read()
                command = step(sample)
                applied = write(command)
                keep((sample, applied))
                if record is not None:
                    record(sample, command, applied)
                if observe is not None:
                    observe(sample, applied)
        except BaseException as error:
            self._stop(error, sample, command)
            raise

    def finish(self) -> Sample:
        """Return the sample that closes the last period.

        Raises:
            MaglevError: As `cycle`.
        """
        try:
            return self._plant.read()
        except BaseException as error:
            self._stop(error, None, None)
            raise

    def _stop(self, error: BaseException, sample: Sample | None, command: Command | None) -> None:
        """Release the plant, and add the cycles to the error."""
        try:
            self._plant.write(Command([0.0] * 6))
        except Exception:  # errors here are dropped, so that the original one is reported
            with suppress(Exception):
                self._plant.close()
        cycles = self._cycles
        if sample is not None and command is not None and (not cycles or cycles[-1][0] is not sample):
            cycles.append((sample, command))  # the refused answer
            if self._record is not None:
                self._record(sample, command, Command([0.0] * 6))
        if isinstance(error, MaglevError):
            error.cycles = tuple(cycles)


def drive(
    plant: Plant,
    controller: Answers,
    ticks: int,
    *,
    observe: Callable[[Sample, Command], object] | None = None,
    record: Record | None = None,
) -> Sample:
    """Run the control loop for a number of samples.

    One more sample is read at the end.

    Args:
        plant: Any plant; it is left open.
        controller: Any controller; it is not reset.
        ticks: Number of samples to answer, at least 1.
        observe: Function called with each sample and the command as applied.
        record: Function that records each cycle.

    Returns:
        The sample after the last answer, which closes the last period.

    Raises:
        ParameterError: If `ticks` is not a whole number of at least 1, or the periods differ.
        MaglevError: As `ControlLoop.cycle`.

    Example:
        >>> from maglev_mj import Bias, Controller, ExactPlant, drive
        >>> weight = [0.0, 0.0, 0.7 * 9.81, 0.0, 0.0, 0.0]
        >>> with ExactPlant(mass=0.7, wrench=weight) as plant:
        ...     last = drive(plant, Controller([Bias(weight)], period=0.005), 200)
        >>> last.tick, abs(last.position[2]) < 1e-9  # carried for a second
        (200, True)
    """
    count = whole("ticks", ticks, at_least=1, at_most=math.inf)
    loop = ControlLoop(plant, controller, observe=observe, record=record)
    loop.cycle(count)
    return loop.finish()
