"""Each guard and limit: values that trip and values that pass."""

from __future__ import annotations

import itertools
import json
import math
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.safety import (
    CoilGuard,
    FlotorGuard,
    HostLimits,
    Limits,
    OutputLimiter,
    SpotGuard,
    ThermalModel,
    reading_fault,
    weight_fault,
)
from maglev_mj.bridge.wire import Fault
from maglev_mj.device import published_device
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Command
from tests.published import WEIGHT

NONE = Fault(0)
PERIOD = 0.005
SCALE = published_device().scale
NAN, INF = math.nan, math.inf


def moved(axis: int, amount: float, base: tuple[float, ...] = (0.0,) * 6) -> tuple[float, ...]:
    """Return six equal numbers, one replaced."""
    return tuple(amount if place == axis else value for place, value in enumerate(base))


def test_a_flotor_outside_its_envelope_is_detected_on_every_axis() -> None:
    limits = HostLimits()
    for axis in range(6):
        for sign in (1.0, -1.0):
            most = sign * (limits.envelope if axis < 3 else limits.envelope_angle)
            assert FlotorGuard(limits, SCALE).check(moved(axis, 1.001 * most), PERIOD) == Fault.BOUNDARY
            assert FlotorGuard(limits, SCALE).check(moved(axis, 0.999 * most), PERIOD) == NONE


def test_an_angle_about_several_axes_counts_as_one() -> None:
    part = 0.6 * HostLimits().envelope_angle
    assert FlotorGuard(HostLimits(), SCALE).check((0.0, 0.0, 0.0, part, part, part), PERIOD) == Fault.BOUNDARY
    assert FlotorGuard(HostLimits(), SCALE).check((0.0, 0.0, 0.0, part, part, 0.0), PERIOD) == NONE


STILL = (0.001,) * 6


def spots_guard() -> SpotGuard:
    return SpotGuard(Limits(frozen=3), PERIOD)


SERIES: dict[str, tuple[Any, Any, Any, Fault]] = {
    "coils": (lambda: CoilGuard(Limits()), ((0.0,) * 6, (2.0,) * 6), (None, (2.0,) * 6), Fault.COIL_NOT_FOLLOWING),
    "frozen, no valid spot": (spots_guard, (STILL, 7), (STILL, 3), Fault.SENSOR_FROZEN),
    "frozen, spots not finite": (spots_guard, (STILL, 7), ((NAN,) * 6, 7), Fault.SENSOR_FROZEN),
    "frozen, too fast": (spots_guard, (STILL, 7), ((0.009,) * 6, 7), Fault.SENSOR_FROZEN),
}
"""Guards that count consecutive samples: a sample that counts, one that does not, and the fault."""


@pytest.mark.parametrize("name", SERIES)
def test_a_sample_between_that_does_not_count_starts_the_count_again(name: str) -> None:
    made, wrong, other, fault = SERIES[name]
    check = made().check
    count = itertools.count()

    def seen(sample: Any) -> Any:
        return check(*sample) if name == "coils" else check(*sample, next(count), 1)

    enough = next(number for number in range(1, 9) if fault in seen(wrong))
    for _ in range(5):
        seen(other)
        # spots are compared with the sample before: the first after another is none that repeats it
        assert not any(fault in seen(wrong) for _ in range(enough - 1))
    assert fault in seen(wrong)


@pytest.mark.parametrize("missed", [0, 1, 9])
@pytest.mark.parametrize("axis", range(6))
def test_speed_is_over_the_time_that_passed(axis: int, missed: int) -> None:
    limits, elapsed = HostLimits(envelope=1.0, envelope_angle=3.0), PERIOD * (1 + missed)
    most = elapsed * (limits.speed_limit if axis < 3 else limits.spin_limit)
    for share, fault in ((0.99, NONE), (1.01, Fault.FLOTOR_OVERSPEED)):
        guard = FlotorGuard(limits, SCALE)
        assert guard.check((0.0,) * 6, PERIOD) == NONE
        assert guard.check(moved(axis, share * most), elapsed) == fault


SPOTS = (1e-3, -2e-3, 3e-3, -4e-3, 5e-3, -6e-3)


def watched(limits: Limits | None = None) -> SpotGuard:
    """Return a guard that has seen one good sample."""
    guard = SpotGuard(limits or Limits(), PERIOD)
    assert guard.check(SPOTS, 7, 0, 1) == NONE
    return guard


def test_an_implausible_spot_is_detected() -> None:
    assert {watched().check(SPOTS, valid, 1, 1) for valid in range(7)} == {Fault.SENSOR_OUT_OF_RANGE}
    fast = Limits(spot_speed=100.0)
    for place, value in product(range(6), (NAN, INF, -INF, 0.0210, -0.0210)):
        assert watched(fast).check(moved(place, value, SPOTS), 7, 1, 1) == Fault.SENSOR_OUT_OF_RANGE
        assert watched(fast).check(moved(place, math.copysign(0.0208, value), SPOTS), 7, 1, 1) == NONE


@pytest.mark.parametrize("steps", [1, 2, 10])
@pytest.mark.parametrize("place", range(6))
def test_a_spots_speed_is_over_the_samples_that_passed(place: int, steps: int) -> None:
    step = 0.4 * PERIOD * steps
    shares = ((0.99, NONE), (-0.99, NONE), (1.01, Fault.FLOTOR_OVERSPEED), (-1.01, Fault.FLOTOR_OVERSPEED))
    for share, fault in (*shares, (4.5, Fault.SENSOR_OUT_OF_RANGE)):
        guard = watched(Limits(spot_speed=0.4, spot_limit=0.1))
        assert guard.check(moved(place, SPOTS[place] + share * step, SPOTS), 7, 1, steps) == fault


@pytest.mark.parametrize("diodes", [(0,), (1,), (2,), (0, 1), (0, 2), (1, 2), (0, 1, 2)])
def test_a_frozen_diode_is_detected_independently_of_the_others(diodes: tuple[int, ...]) -> None:
    guard = watched(Limits(frozen=5))
    found = []
    for tick in range(1, 9):
        spots = tuple(one if place // 2 in diodes else one + 1e-6 * tick for place, one in enumerate(SPOTS))
        found.append(guard.check(spots, 7, tick, 1))
    assert found == [NONE] * 4 + [Fault.SENSOR_FROZEN] * 4
    guard = watched(Limits(frozen=5))
    for tick in range(1, 30):  # one changing coordinate per diode suffices
        spots = tuple(one + 1e-6 * (tick % 5 == 0) * (place % 2) for place, one in enumerate(SPOTS))
        assert guard.check(spots, 7, tick, 1) == NONE
    guard = watched(Limits(frozen=0))
    assert {guard.check(SPOTS, 7, tick, 1) for tick in range(1, 100)} == {NONE}  # a sensor without noise


def test_a_stopped_conversion_counter_is_detected_and_a_wrapping_one_is_not() -> None:
    guard = watched()
    assert guard.check(SPOTS, 7, 0, 1) == Fault.SENSOR_STOPPED
    assert guard.check(SPOTS, 7, 0xFFFFFFFF, 1) == NONE
    assert guard.check(SPOTS, 7, 0, 1) == NONE
    assert guard.check(SPOTS, 3, 0, 1) == Fault.SENSOR_STOPPED | Fault.SENSOR_OUT_OF_RANGE


@pytest.mark.parametrize("place", range(6))
def test_implausible_currents_and_temperatures_are_detected(place: int) -> None:
    limits, ones, cool = Limits(current_limit=2.0), (1.0,) * 6, (0.1,) * 6
    assert reading_fault(limits, ones, cool) == NONE
    assert reading_fault(limits, (2.9,) * 6, (1.9,) * 6) == NONE  # whatever their sum
    for wrong in (NAN, INF, -INF, 3.01, -3.01):
        assert reading_fault(limits, moved(place, wrong, ones), cool) == Fault.COIL_OVERCURRENT
    for right in (2.99, -2.99):
        assert reading_fault(limits, moved(place, right, ones), cool) == NONE
    for wrong in (NAN, INF, -INF, 2.01, -0.011):
        assert reading_fault(limits, ones, moved(place, wrong, cool)) == Fault.COIL_OVERTEMP
    for right in (1.99, -0.009):
        assert reading_fault(limits, ones, moved(place, right, cool)) == NONE
    both = reading_fault(limits, moved(place, NAN, ones), moved(5 - place, 5.0, cool))
    assert both == Fault.COIL_OVERCURRENT | Fault.COIL_OVERTEMP


def heated(*intervals: tuple[float, float]) -> float:
    """Return a coil's temperature rise after currents [A].

    By the default limits, each for a duration [s].
    """
    warm = 0.0
    for duration, current in intervals:
        goal = (current / 3.0) ** 2
        warm = goal + (warm - goal) * math.exp(-duration / 10.0)
    return warm


@pytest.mark.parametrize("value", [NAN, INF, 1e200])
def test_a_temperature_that_is_not_finite_trips(value: float) -> None:
    model = ThermalModel(Limits())
    assert model.add([(0.005, moved(3, value))]) == model.warmest == 1.0


def limiter(**own: float) -> OutputLimiter:
    """Return an output limiter of the nominal device."""
    limits = HostLimits(**own)
    return OutputLimiter(Calibration.nominal().coils, limits.narrowed(Limits()), limits.wrench, PERIOD)


@pytest.mark.parametrize("width", [0.0, 0.001, 0.005, 0.0123, 0.015, 0.0312, 1.0])
def test_pulses_warm_the_coils_for_any_width_and_number_of_missed_periods(width: float) -> None:
    held, pulsed = [1.0] * 6, [8.0] * 6
    for missed in (1, 2, 3, 7, 400):
        once, each = limiter(), limiter()
        for output in (once, each):
            output.add_command(held, pulsed, width)
        once.add_periods(missed, held)
        for _ in range(missed):
            each.add_periods(1, held)
        length = (missed + 1) * PERIOD
        expected = heated((min(width, length), 8.0), (max(length - width, 0.0), 1.0))
        assert once.thermal.warmest == pytest.approx(expected, rel=1e-9)
        assert each.thermal.warmest == pytest.approx(expected, rel=1e-9)
        once.add_periods(missed, [2.0] * 6)  # other currents end the pulse
        cooler = 4.0 / 9.0 + (expected - 4.0 / 9.0) * math.exp(-missed * PERIOD / 10.0)
        assert once.thermal.warmest == pytest.approx(cooler, rel=1e-9)


@pytest.mark.parametrize("axis", range(6))
def test_the_hosts_own_limits_hold_for_force_torque_and_pulse(axis: int) -> None:
    output = limiter(force_limit=9.0, torque_limit=0.02)
    most = 9.0 if axis < 3 else 0.02
    for sign in (1.0, -1.0):
        asked = moved(axis, sign * 1000.0)
        applied, _, _, _ = output.currents(Command(asked), (0.0,) * 6)
        assert applied.force == pytest.approx(moved(axis, sign * most), abs=1e-9)
        applied, _, pulsed, _ = output.currents(Command((0.0,) * 6, asked, 0.001), (0.0,) * 6)
        assert applied.extra == pytest.approx(moved(axis, sign * most), abs=1e-9) and pulsed is not None


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (0.1, -0.05, 0.08)])
def test_the_smaller_current_counts(turn: tuple[float, ...]) -> None:
    for own, device, most in ((2.0, 10.0, 2.0), (20.0, 10.0, 10.0)):
        limits = HostLimits(max_current=own).narrowed(Limits(current_limit=device, hover_limit=3.0))
        assert (limits.current_limit, limits.hover_limit) == (most, min(most, 3.0))
        output = OutputLimiter(Calibration.nominal().coils, limits, None, PERIOD)
        pose = (0.0, 0.0, 0.0, *turn)
        _, held, pulsed, _ = output.currents(Command((50.0, -30.0, 500.0, 0.5, 1.0, -1.0), (100.0,) * 6, 0.002), pose)
        assert pulsed is not None and np.abs([held, pulsed]).max() == pytest.approx(most)
    assert HostLimits(continuous_current=1.5).narrowed(Limits()).continuous_current == 1.5
    assert HostLimits(continuous_current=9.0).narrowed(Limits()).continuous_current == Limits().continuous_current
    assert HostLimits().narrowed(Limits()) == Limits()


def test_limits_too_low_for_hovering_are_reported_with_figures() -> None:
    hover, weight = Calibration.nominal().hover.tolist(), WEIGHT[2]

    def said(limits: Limits | None = None, **own: float) -> str:
        made = HostLimits(**own)
        return weight_fault(weight, hover, made, made.narrowed(limits or Limits()))

    assert said() == said(max_current=1.45, force_limit=8.7) == ""
    assert "max_current must be at least 1.43 A (got 1.3): hovering needs 1.14 A" in said(max_current=1.3)
    assert "max_current must be at least 1.43 A (got 1): " in said(Limits(current_limit=1.0))
    assert "force_limit must be above 8.58 N (got 8): the weight is 6.87 N" in said(force_limit=8.0)
    assert "hover limit must be at least 1.14 A to carry the weight (got 1.1" in said(Limits(hover_limit=1.1))
    assert "hover limit must be at least 1.14 A" in said(continuous_current=1.0)


def test_a_profile_is_read_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "profile.json"
    limits = HostLimits(max_current=3.0, force_limit=12.0, envelope=0.003, speed_limit=0.2)
    path.write_text(json.dumps(limits.as_json()))
    assert HostLimits.load(path) == limits
    path.write_text('{"max_current": 2}')
    assert HostLimits.load(path) == HostLimits(max_current=2.0)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('{"max_current": -1}', r"max_current must be above 0.* \(got -1"),
        ('{"speed": 1}', r"parameter must be one of max_current, .* \(got 'speed'\)"),
        ("[1, 2]", r"must be a JSON object of limits by name [(]got \[1, 2\]"),
        (None, "cannot be read: No such file"),
    ],
)
def test_an_invalid_profile_is_an_error_of_one_line(text: str | bytes | None, says: str, tmp_path: Path) -> None:
    path = tmp_path / "profile.json"
    if text is not None:
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ParameterError, match=says) as caught:
        HostLimits.load(path)
    assert "profile.json" in str(caught.value) and "\n" not in str(caught.value)
