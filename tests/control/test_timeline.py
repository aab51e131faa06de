"""Times of commands: intervals, pulses, delays, recorded commands."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from maglev_mj import MuJoCoPlant, Timing
from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.safety import Limits, OutputLimiter, ThermalModel
from maglev_mj.control.timeline import Timeline, recorded_switches, split_delay

T = 0.005


def rounded(intervals: list[tuple[float, object]]) -> list[tuple[float, object]]:
    return [(round(duration, 9), drive) for duration, drive in intervals]


@pytest.mark.parametrize(("periods", "period"), [(0, T), (1, 1e-4), (3, 0.1), (7, 1.0 / 3.0)])
def test_a_delay_within_rounding_of_whole_periods_is_whole(periods: int, period: float) -> None:
    for delay in (periods * period, sum([period] * periods), periods * period * (1.0 + 2e-16)):
        assert split_delay(delay, period) == (periods, 0.0)
    whole, rest = split_delay((periods + 0.3) * period, period)
    assert whole == periods and rest == pytest.approx(0.3 * period, rel=1e-12)
    wholes, rests = split_delay(np.array([periods * period, (periods + 0.3) * period]), period)
    assert wholes.tolist() == [periods, periods] and rests.tolist() == [0.0, rest]


def test_a_pulse_runs_out_unless_a_command_ends_it() -> None:
    line = Timeline(Timing(period=T, delay=0.0015), "before")
    line.answer(0, "held", "pulsed", 0.009)
    assert rounded(line.period(0)) == [(0.0015, "before"), (0.0035, "pulsed")]
    assert line.now() == "pulsed"
    assert rounded(line.period(1)) == [(0.005, "pulsed")]  # nobody answered
    assert rounded(line.period(2)) == [(0.0005, "pulsed"), (0.0045, "held")]
    assert line.now() == "held"
    line.answer(3, "other", "kick", 0.009)
    line.period(3)
    line.answer(4, "last")
    assert rounded(line.period(4)) == [(0.0015, "kick"), (0.0035, "last")]


def test_a_second_answer_replaces_the_first_and_an_early_switch_what_comes_later() -> None:
    line = Timeline(Timing(period=T, delay=0.0065), "before")
    line.answer(0, "wrong")
    line.answer(0, "right")
    line.period(0)
    line.answer(1, "never")
    line.answer(1, "cut", after=0.002)
    assert rounded(line.period(1)) == [(0.0015, "before"), (0.0005, "right"), (0.003, "cut")]
    assert line.period(2) == [(T, "cut")]
    line.answer(3, "late", after=2.2 * T)
    assert line.period(3) == line.period(4) == [(T, "cut")]
    assert rounded(line.period(5)) == [(0.001, "cut"), (0.004, "late")]


@pytest.mark.parametrize("timing", [{"delay": 0.0}, {"delay": 0.0015}, {"delay": 0.0065}, {"jitter": 5e-4}])
def test_an_answer_with_the_request_is_as_one_before_it(timing: dict[str, Any]) -> None:
    made = Timing(period=T, **timing)
    one, other = Timeline(made, -1), Timeline(made, -1)
    for tick in range(12):
        answer = (tick, -tick, 0.002 if tick % 3 == 2 else 0.0)
        one.answer(tick, *answer)
        intervals = other.period(tick, answer)
        assert one.period(tick) == intervals
        assert all(duration > 0.0 for duration, _ in intervals)
        if "jitter" in timing and tick % 3 == 0:
            assert intervals[0][0] == made.rest_at(tick)


@pytest.mark.parametrize("delay", [0.0, 0.0015, T, 0.0123])
def test_recorded_commands_switch_as_live_ones_do(delay: float) -> None:
    # Random commands with pulses, every fifth sample not answered: the same wrench at every instant.
    random = np.random.default_rng(7)
    ticks = np.flatnonzero(np.arange(60) % 5 != 3)
    held, extra = random.normal(size=(2, len(ticks), 6))
    width = random.choice([0.0, 0.001, 0.003, T, 0.008, 0.02], len(ticks))
    when, force = recorded_switches(np.asarray(ticks * T, dtype=np.float64), held, extra, width, period=T, delay=delay)
    line, start = Timeline(Timing(period=T, delay=delay), np.zeros(6)), 0.0
    answers = {tick: row for row, tick in enumerate(ticks.tolist())}
    for tick in range(60):
        if (row := answers.get(tick)) is not None:
            line.answer(tick, held[row], held[row] + extra[row], float(width[row]))
        for duration, acting in line.period(tick):
            index = np.searchsorted(when, start + 0.5 * duration) - 1
            np.testing.assert_array_equal(acting, force[index] if index >= 0 else 0.0)
            start += duration
    assert start == pytest.approx(60 * T)


def test_a_pulse_of_currents_runs_out_after_an_unanswered_sample() -> None:
    driven = MuJoCoPlant(Timing(period=T, delay=0.0015), gravity=(0.0, 0.0, 0.0))
    driven.read()
    driven.drive([0.0] * 6, [1.0, 0, 0, 0, 0, 0], 0.009)
    seen = []
    for _ in range(3):
        driven.read()
        seen += [(round(duration, 9), currents[0]) for duration, currents in driven.intervals]
    assert seen == [(0.0015, 0.0), (0.0035, 1.0), (0.005, 1.0), (0.0005, 1.0), (0.0045, 0.0)]


def test_the_gate_counts_the_heat_of_a_pulse_to_its_end() -> None:
    # A pulse of one and a half periods whose second half falls on a sample that nobody answered.
    calibration, limits = Calibration.nominal(), Limits()
    gate, known = OutputLimiter(calibration.coils, limits, None, T), ThermalModel(limits)
    held, pulsed = [1.0] * 6, [8.0] * 6
    gate.add_command(held, pulsed, 1.5 * T)
    gate.add_periods(3, held)
    known.add(((T, pulsed), (0.5 * T, pulsed), (0.5 * T, held), (2.0 * T, held)))
    assert gate.thermal.rises == pytest.approx(known.rises, rel=1e-12)
    gate.add_command(held, pulsed, 1.5 * T)
    gate.add_periods(1, [0.0] * 6)  # switched off: that ends it
    known.add(((T, pulsed), (T, [0.0] * 6)))
    assert gate.thermal.rises == pytest.approx(known.rises, rel=1e-12)
