"""Control loop: its steps, and its state after errors."""

from __future__ import annotations

import math

import pytest

from maglev_mj import Command, Controller, ExactPlant, Hold, MuJoCoPlant, Sample, Timing, drive
from maglev_mj.errors import DivergenceError, ParameterError, PlantError


class Recorder(ExactPlant):
    """Plant that records its commands."""

    def __init__(self) -> None:
        super().__init__(Timing(), gravity=0.0, twist=[0, 0, 0.01, 0, 0, 0])
        self.written: list[Command] = []

    def write(self, command: Command) -> Command:
        self.written.append(command)
        return super().write(command)


class Broken(Controller):
    """A controller that fails or answers nonsense at sample 260."""

    def __init__(self, answer: float | BaseException) -> None:
        super().__init__([Hold(stiffness=100.0, damping=1.0)], period=0.005)
        self.answer = answer

    def step(self, sample: Sample) -> Command:
        if sample.tick == 260:
            if isinstance(self.answer, BaseException):
                raise self.answer
            return Command([self.answer] * 6)
        return super().step(sample)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_command_that_is_no_number_ends_in_zero_and_carries_the_last_cycles(bad: float) -> None:
    plant = Recorder()
    with pytest.raises(PlantError, match="command at tick 260 must be finite") as caught:
        drive(plant, Broken(bad), 300)
    assert list(plant.written[-1].force) == [0.0] * 6
    assert [sample.tick for sample, _ in caught.value.cycles] == list(range(211, 261))
    plant.read()  # the plant is still there, with zero on its way


def test_any_exception_ends_in_zero_and_is_the_one_reported() -> None:
    plant = Recorder()
    with pytest.raises(ZeroDivisionError):
        drive(plant, Broken(ZeroDivisionError()), 300)
    assert list(plant.written[-1].force) == [0.0] * 6
    plant = Recorder()
    with pytest.raises(KeyboardInterrupt):
        drive(plant, Broken(KeyboardInterrupt()), 300)
    assert list(plant.written[-1].force) == [0.0] * 6


def test_a_closed_plant_does_not_hide_the_error() -> None:
    plant = Recorder()
    plant.close()
    with pytest.raises(PlantError, match="closed"):
        drive(plant, Broken(0.0), 300)


def test_divergence_carries_its_cycles() -> None:
    unstable = Controller([Hold(axes="z", stiffness=20_000.0, damping=10.0)], period=0.005)
    with pytest.raises(DivergenceError) as caught:
        drive(MuJoCoPlant(pose=[0, 0, 1e-3, 0, 0, 0]), unstable, 1000)
    assert 0 < len(caught.value.cycles) <= 50


def test_ticks_must_be_whole_and_positive() -> None:
    with pytest.raises(ParameterError, match=r"ticks must be at least 1.* \(got 0"):
        drive(Recorder(), Broken(0.0), 0)
    with pytest.raises(ParameterError, match=r"ticks must be an integer \(got 2.7\)"):
        drive(Recorder(), Broken(0.0), 2.7)  # type: ignore[arg-type]


def test_controller_and_plant_must_share_a_period() -> None:
    with pytest.raises(ParameterError, match=r"period must equal the plant's 0.005 s [(]got 0.001 s"):
        drive(Recorder(), Controller([], period=0.001), 3)


def test_a_plant_that_fails_to_release_is_closed_and_the_first_error_reported() -> None:
    class Deaf(Recorder):
        def write(self, command: Command) -> Command:
            if self._tick == 260:
                raise OSError("the wire is cut")
            return super().write(command)

    plant = Deaf()
    with pytest.raises(ZeroDivisionError):
        drive(plant, Broken(ZeroDivisionError()), 300)
    with pytest.raises(PlantError, match="closed"):
        plant.read()
