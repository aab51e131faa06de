"""The example of a follower: contact, repetition, and the coupling's limit."""

from __future__ import annotations

import numpy as np
import pytest

import teleoperate
from maglev_mj import Controller, ExactPlant, Timing, drive, judge, largest_stable_stiffness, run, stability
from maglev_mj.frames import Array

RATES = (200, pytest.param(1000, marks=pytest.mark.study))


def growth(rate: int, share: float) -> tuple[float, float]:
    """Return measured and computed growth of the joystick's oscillation from sample to sample, both bodies free.

    The coupling has a share of the largest stable stiffness. Fourth differences leave out that both drift.
    """
    timing = Timing(period=1.0 / rate, delay=0.3 / rate)
    most = largest_stable_stiffness(period=timing.period, delay=timing.delay, mass=teleoperate.REDUCED)
    gains = {"stiffness": share * float(most.stiffness), "damping": float(most.damping)}
    scene = teleoperate.Teleoperate(period=timing.period, delay=timing.delay, **gains)
    controller, places = Controller([teleoperate.Coupling(scene)], period=timing.period), list[float]()
    plant = ExactPlant(timing, pose=[1e-4, 0.0, 0.0, 0.0, 0.0, 0.0], gravity=0.0)
    drive(plant, controller, 400, observe=lambda sample, _: places.append(float(sample.position[0])))
    bends: Array = np.diff(places, 4)[-200:]
    first, last = (float(np.sqrt(np.mean(part**2))) for part in (bends[:100], bends[100:]))
    return (last / first) ** (1.0 / 100), judge(controller, delay=timing.delay).spectral_radius


@pytest.mark.parametrize("rate", RATES)
def test_two_free_bodies_have_the_bound_of_a_wall_on_their_reduced_mass(
    rate: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(teleoperate.ROBOT.opt, "timestep", 0.1 / rate)  # exact at any step where nothing is touched
    for share in (0.97, 1.03):
        measured, computed = growth(rate, share)
        assert (measured > 1.0) == (computed > 1.0) == (share > 1.0)
        assert measured == pytest.approx(computed, abs=3e-4)


def test_the_force_of_the_block_is_that_of_the_hand_and_a_run_repeats(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(teleoperate.ROBOT.opt, "timestep", 5e-4)
    first, again = (run(teleoperate.Teleoperate()).trace.pose for _ in range(2))
    assert np.array_equal(first, again)
    assert teleoperate.DATA.qfrc_constraint[2] == pytest.approx(3.0 * teleoperate.SCALE, rel=1e-3)
    stretch = first[-1, 2] - teleoperate.DATA.qpos[2] / teleoperate.SCALE
    assert 1496.0 * stretch == pytest.approx(-3.0, rel=1e-3)  # the hand's, whose force the coupling carries on


def test_the_stability_check_does_not_run_the_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    def answered(*_: object) -> None:
        raise AssertionError("the law was asked")

    monkeypatch.setattr(teleoperate.Coupling, "__call__", answered)
    stable, limit = stability(teleoperate.Teleoperate()), stability(teleoperate.Teleoperate(stiffness=6100.0))
    assert stable.stable and not limit.stable
