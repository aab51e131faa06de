"""The lists of `all_of` are complete, and what all of a kind have in common."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from maglev_mj import ExactPlant, Timing, control, drive
from maglev_mj.control import AxisLaw, Friction, Law, VelocityEstimator
from maglev_mj.frames import AXES
from maglev_mj.plants import SampledPlant
from tests.all_of import LAWS, PLANTS, START, TIMING, UNRECORDED, VELOCITIES, controller_of


def below(kind: type) -> Iterator[type]:
    """Yield the classes of the package that derive from one."""
    for one in kind.__subclasses__():
        yield from below(one)
        if one.__module__.startswith("maglev_mj."):
            yield one


def test_every_law_and_velocity_estimate_of_the_package_is_listed() -> None:
    listed: set[type] = {type(law) for parts in LAWS.values() for law in parts} | {type(one) for one in VELOCITIES}
    public = [getattr(control, name) for name in dir(control)]
    there = {cls for cls in public if isinstance(cls, type) and "__call__" in dir(cls)}
    assert there - {Law, AxisLaw, Friction, VelocityEstimator} == listed | {control.Bias}


def test_every_plant_of_the_package_is_listed() -> None:
    made = [make() for make in (*PLANTS.values(), *UNRECORDED.values())]
    try:
        device = {cls for cls in below(SampledPlant) if cls.__module__.startswith("maglev_mj.plants.")}
        assert {type(plant) for plant in made} == device
    finally:
        for plant in made:
            plant.close()


@pytest.mark.parametrize("law", LAWS)
def test_a_batch_moves_as_each_of_its_devices(law: str) -> None:
    starts = np.array(START["pose"]) * np.array([1.0, -0.4, 0.1])[:, None]

    def moved(pose: Any) -> Any:
        seen: list[Any] = []
        with ExactPlant(Timing(**TIMING), pose=pose) as plant:
            drive(plant, controller_of(law), 30, observe=lambda sample, _: seen.append(np.array(sample.pose)))
        return np.array(seen)

    together = moved(starts)
    assert together.shape == (30, 3, len(AXES)) and np.ptp(together[-1, :, 2]) > 0.0
    for device, start in enumerate(starts):
        # not to the last bit: a period is cut where any device switches
        np.testing.assert_allclose(together[:, device], moved(start), rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("plant", PLANTS)
def test_a_plant_moves_alike_each_time(plant: str) -> None:
    def moved() -> list[Any]:
        with PLANTS[plant]() as made:
            return [
                tuple(made.read().position),
                *(tuple(drive(made, controller_of("Hold"), 10).position) for _ in "ab"),
            ]

    assert moved() == moved()
