"""Control loop of any plant and controller: read, compute, write."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol, TypeAlias

from maglev_mj.errors import MaglevError, ParameterError, one_line
from maglev_mj.frames import Command, Sample
from maglev_mj.keywords import checked
from maglev_mj.parameters import whole

_HISTORY = 50  # cycles reported with an error; 200 would exceed the L1 cache and cost 4 % of the loop

Record: TypeAlias = Callable[[Sample, Command, Command], object]
"""Function of a sample, the controller's command and the applied command (zero if the plant rejected it)."""


class Plant(Protocol):
    """Interface of a plant to the control loop; optionally with `unanswered`, the last sample until it is answered."""

    @property
    def period(self) -> float:
        """Sample period [s]."""

    def read(self) -> Sample:
        """Wait for the next sampling instant and return its measurement."""

    def write(self, command: Command) -> Command:
        """Send the command for the last sample; return the command as applied, after all limits."""

    def close(self) -> None:
        """Release the plant; may be called at any time and repeatedly."""


class Answers(Protocol):
    """Interface of a controller to the control loop."""

    @property
    def period(self) -> float:
        """Sample period [s]."""

    def step(self, sample: Sample) -> Command:
        """Return the command for one sample."""


class ControlLoop:
    """Control loop of a plant and a controller.

    Args:
        plant: Any plant; stays open.
        controller: Any controller; is not reset.
        observe: Callback for each sample and the command as applied.
        record: Callback that records each cycle.

    Raises:
        ParameterError: If the periods differ, plant and controller are swapped, or the plant cannot render the
            controller's walls on the device.
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
                raise ParameterError(f"{name} must have a method {method}() (got {one_line(part)})")
        for name, function in (("observe", observe), ("record", record)):
            if not (function is None or callable(function)):
                raise ParameterError(
                    f"{name} must be a function, such as open_recording(FILE).begin(plant, controller)"
                )
        if controller.period != plant.period:
            raise ParameterError(
                f"controller period must equal the plant's {plant.period:g} s (got {controller.period:g} s)"
            )
        if getattr(controller, "on_device", False) and not getattr(plant, "renders_walls", False):
            name = type(plant).__name__
            raise ParameterError(f"{name} cannot render walls on the device; use laws with on='host'")
        self._plant, self._controller, self._observe, self._record = plant, controller, observe, record
        self._cycles: deque[tuple[Sample, Command]] = deque(maxlen=_HISTORY)

    def cycle(self, count: int = 1) -> None:
        """Run `count` cycles, the first from the plant's unanswered sample if there is one.

        After any exception the plant is commanded to zero, or closed if that fails too.

        Raises:
            MaglevError: If a cycle fails; its attribute `cycles` holds the last cycles.
        """
        sample = command = None
        plant, observe, record = self._plant, self._observe, self._record
        read, step, write, keep = plant.read, self._controller.step, plant.write, self._cycles.append
        waiting = [first] if (first := getattr(plant, "unanswered", None)) is not None else []
        try:
            for _ in range(count):
                command = None
                sample = waiting.pop() if waiting else read()
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
        """Return the sample at the end of the last period.

        Raises:
            MaglevError: As `cycle`.
        """
        try:
            return self._plant.read()
        except BaseException as error:
            self._stop(error, None, None)
            raise

    def _stop(self, error: BaseException, sample: Sample | None, command: Command | None) -> None:
        """Command zero, or close the plant if that fails; attach the last cycles to the error."""
        try:
            self._plant.write(Command([0.0] * 6))
        except Exception:  # suppressed: the original error is the one to report
            with suppress(Exception):
                self._plant.close()
        cycles = self._cycles
        if sample is not None and command is not None and (not cycles or cycles[-1][0] is not sample):
            cycles.append((sample, command))  # the rejected command
            if self._record is not None:
                self._record(sample, command, Command([0.0] * 6))
        if isinstance(error, MaglevError):
            error.cycles = tuple(cycles)


@checked(own="controller plant record ticks")
def drive(
    plant: Plant,
    controller: Answers,
    ticks: int,
    *,
    observe: Callable[[Sample, Command], object] | None = None,
    record: Record | None = None,
) -> Sample:
    """Run the control loop for a number of ticks; the next call answers the sample that this one returns.

    Args:
        plant: Any plant; stays open.
        controller: Any controller; is not reset.
        ticks: Number of ticks, at least 1.
        observe: Callback for each sample and the command as applied.
        record: Callback that records each cycle.

    Returns:
        The sample at the end of the last period.

    Raises:
        ParameterError: If `ticks` is not a whole number of at least 1, or the periods differ.
        MaglevError: As `ControlLoop.cycle`.

    Example:
        >>> from maglev_mj import Bias, Controller, ExactPlant, drive
        >>> weight = [0.0, 0.0, 0.7 * 9.81, 0.0, 0.0, 0.0]
        >>> with ExactPlant(mass=0.7, wrench=weight) as plant:
        ...     last = drive(plant, Controller([Bias(weight)], period=0.005), 200)
        >>> last.tick, abs(last.position[2]) < 1e-9  # hovers for a second
        (200, True)
    """
    count = whole("ticks", ticks, at_least=1, at_most=math.inf)
    loop = ControlLoop(plant, controller, observe=observe, record=record)
    loop.cycle(count)
    return loop.finish()
