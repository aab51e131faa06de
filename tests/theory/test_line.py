"""Delay that varies, and lost samples: worst case with a proof or a sequence, mean square, and their limits."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from maglev_mj import ParameterError, Timing
from maglev_mj.control import LinearController, LowPass
from maglev_mj.frames import Array
from maglev_mj.plants import ExactPlant
from maglev_mj.plants.hand import Hand, get_hand
from maglev_mj.theory.line import (
    MOST_IN_A_ROW,
    Event,
    LineVerdict,
    LossyLine,
    Maps,
    MeanSquare,
    WorstCase,
    _blocks,
    least_norm,
    longest_loss,
    mean_square_line,
    worst_case,
)
from maglev_mj.theory.loop import Loop
from maglev_mj.theory.loop_array import LinearisedLaw
from maglev_mj.theory.two_rates import DeviceLaw
from tests.sweeps import further

STUDY = [pytest.param(1000, marks=pytest.mark.study)]


def loop_of(mass: float, stiffness: float, damping: float, period: float, delay: float, **values: Any) -> Loop:
    """Return a loop; period and delay in [ms]."""
    times: Any = {"period": 1e-3 * period, "delay": 1e-3 * delay}
    return Loop(stiffness=stiffness, damping=damping, inertia=mass, **times, **values)


PAPER = loop_of(0.7, 6000.0, 80.0, 5.0, 1.5)


def played(loop: Loop, sequence: Sequence[float | None], samples: int) -> Array:
    """Return position and speed times period at each sample of the exact plant, under repeated delays [s], (N, 2)."""
    law = loop.controller()
    hand = loop.hand or (Hand(mass=0.0, damping=loop.own_damping, stiffness=0.0) if loop.own_damping else None)
    memory, motion = np.zeros(len(law.advance)), []
    lag: Any = {"driver_lag": loop.driver_lag > 0.0, "driver_time_constant": loop.driver_lag or None}
    start = (0.0, 0.0, 1e-6, 0.0, 0.0, 0.0)
    with ExactPlant(
        Timing(period=loop.period, delay=0.0),
        mass=loop.inertia,
        gravity=0.0,
        pose=start,
        hand=hand,
        escape=(1e30, 1.0),
        **lag,
    ) as plant:
        for index in range(samples):
            position = float(plant.read().position[2])
            motion.append((position, loop.period * float(plant.state()[1][2])))
            force = float(law.direct) * position + float(law.give @ memory)
            memory = law.advance @ memory + law.take * position
            if (delay := sequence[index % len(sequence)]) is not None:
                plant._switch(plant._driven, [0.0, 0.0, force, 0.0, 0.0, 0.0], None, 0.0, delay)
            plant.unanswered = None
    return np.array(motion)


def event_of(maps: Maps, before: float | None, delay: float | None) -> Event:
    """Return the event of a period, of the delays of the command before and its own one [s]; None if lost."""
    past = [math.nan if one is None else one - maps.whole * maps.period for one in (before, delay)]
    late = past[0] - maps.period if past[0] > maps.period else 0.0
    return Event(late, math.inf if past[1] > maps.period else past[1])


def mapped(loop: Loop, delays: tuple[float, float], sequence: Sequence[float | None], samples: int) -> Array:
    """Return the same as `played` by the maps."""
    maps, motion = Maps(loop, *delays), []
    state = np.zeros(maps.order)
    state[0] = 1e-6
    if loop.hand is not None and loop.hand.soft:
        state[2] = loop.hand.position_at_rest(1e-6)
    every = [None] * (maps.whole + 1) + [*sequence] * (1 + samples // len(sequence))
    for before, delay in pairwise(every[: samples + 1]):
        motion.append((state[0], maps.period * state[1]))
        state = maps.of(event_of(maps, before, delay)) @ state
    return np.array(motion)


def grows(loop: Loop, found: WorstCase) -> None:
    """Check that the sequence of an unstable verdict grows in the exact plant, as fast as it says."""
    cycle = len(found.sequence)
    samples = int(np.clip(math.log(1e16) / math.log(found.growth), 240, 6000))
    sizes = np.linalg.norm(played(loop, found.sequence, samples), axis=1)
    window = max(cycle, 60)
    span = (samples - window) // (2 * cycle) * cycle
    rate = (sizes[-window:].max() / sizes[-window - span : -span].max()) ** (1.0 / span)
    assert rate == pytest.approx(found.growth, abs=0.05 * (found.growth - 1.0) + 1e-4)
    assert sizes[-window:].max() > sizes[window : 2 * window].max()


def settles(maps: Maps, count: int, most: int = 0, samples: int = 400) -> None:
    """Check that random sequences settle: of delays in between, of both ends, alternating, with runs of losses."""
    generator, low = np.random.default_rng(count), maps.whole * maps.period + maps.first
    high = maps.whole * maps.period + (maps.period + maps.latest if maps.crosses else maps.last)
    delays = [low, high, *generator.uniform(low, high, 9).tolist(), None]
    table = np.array([[maps.of(event_of(maps, before, delay)) for delay in delays] for before in delays])
    kinds, states = np.arange(count) % 3, np.zeros((count, maps.order, 1))
    states[:, 0] = 1.0
    before, lost = np.zeros(count, dtype=int), np.zeros(count, dtype=int)
    for step in range(samples):
        inside, ends = generator.integers(0, len(delays) - 1, count), generator.integers(0, 2, count)
        chosen = np.select([kinds == 0, kinds == 1], [inside, ends], step % 2)
        drops = (generator.random(count) < 0.6) & (lost < most)
        chosen, lost = np.where(drops, len(delays) - 1, chosen), np.where(drops, lost + 1, 0)
        states, before = table[before, chosen] @ states, chosen
    assert np.abs(states[:, 0]).max() < 0.2


# least and largest delay [ms]; largest growth of a constant delay; norm of another descent; verdict
WORST = [
    ((1.0, 2.0), 0.917131, 0.9191, True),
    ((0.0, 3.0), 0.984902, 0.9945, True),
    ((2.0, 3.0), 0.984902, 0.9921, True),
    ((0.0, 3.2), 0.996717, 1.0086, True),
    ((3.0, 3.2), 0.996717, 1.0074, True),
    ((3.05, 3.25), 0.999588, 1.0107, None),  # proved by 30 000 products, or not, by the last bits of the norm
    ((2.5, 3.5), 1.013470, math.inf, False),
]


@pytest.mark.parametrize("sequences", [50, *STUDY])
@pytest.mark.parametrize(("delays", "growth", "norm", "stable"), WORST)
def test_worst_cases_of_the_paper_s_wall(
    delays: tuple[float, float], growth: float, norm: float, stable: bool | None, sequences: int
) -> None:
    maps = Maps(PAPER, *(1e-3 * delay for delay in delays))
    found = worst_case(maps, 0)
    assert found.stable is stable or (stable is None and found.stable is True)
    assert found.growth == pytest.approx(growth, abs=6e-7)
    if stable is False:
        assert found.sequence == (1e-3 * delays[1],) and found.words.startswith("destabilised by a constant delay of")
        grows(PAPER, found)
        return
    assert found.growth < found.norm <= norm + 2e-3
    assert found.words.startswith("stable for every sequence (proved: " if found.stable else "not decided (between the")
    assert bool(found.products) is (found.norm >= 1.0)
    settles(maps, sequences)


KINDS: dict[str, tuple[Loop, tuple[float, float]]] = {
    "within a period": (PAPER, (0.5e-3, 4.0e-3)),
    "across a sample": (PAPER, (3.0e-3, 7.5e-3)),
    "one period wide": (loop_of(0.7, 2000.0, 40.0, 5.0, 1.5), (2.0e-3, 7.0e-3)),
    "late": (loop_of(0.7, 1000.0, 20.0, 5.0, 1.5), (12.0e-3, 16.0e-3)),
    "own damping": (replace(PAPER, own_damping=20.0), (0.0, 6.0e-3 - 1e-3)),
    "hand": (replace(PAPER, hand=get_hand("stylus")), (1.0e-3, 5.5e-3)),
    "driver lag": (replace(PAPER, driver_lag=0.5e-3), (1.0e-3, 5.5e-3)),
    "filter": (loop_of(0.7, 6000.0, 40.0, 2.0, 1.0, velocity=LowPass(cutoff=60.0)), (0.2e-3, 2.1e-3)),
}


@pytest.mark.parametrize("name", KINDS)
def test_maps_are_the_exact_plant(name: str) -> None:
    loop, (low, high) = KINDS[name]
    generator = np.random.default_rng(3)
    sequence = [low, high, *generator.uniform(low, high, 30).tolist(), None, None, high, low, None, high]
    motion, expected = played(loop, sequence, 60), mapped(loop, (low, high), sequence, 60)
    assert motion == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("name", ["own damping", "hand", "driver lag"])
def test_the_hull_of_curves_that_are_no_quadratics_needs_its_remainder(name: str) -> None:
    """All delays are in the hull but for the remainder, which is no more than some hundred times too large."""
    loop, (low, high) = KINDS[name]
    maps = Maps(loop, low, high)
    assert not maps.exact and Maps(PAPER, low, high).exact
    for start, end in ((maps.first, maps.last), *[(0.0, maps.latest)] * maps.crosses):
        hull, identity = maps.hull(start, end), np.eye(maps.order)
        bound, width = maps.remainder(start, end, identity), (end - start) / maps.parts(start, end)
        assert bound > 0.0 and len(hull) == 2 * maps.parts(start, end) + 1
        worst = 0.0
        for index in range(maps.parts(start, end)):
            a, b, middle = hull[index], hull[index + 1], hull[maps.parts(start, end) + 1 + index]
            share = np.linspace(0.0, 1.0, 21)[:, None]
            curve = (1.0 - share) ** 2 * a + 2.0 * share * (1.0 - share) * middle + share**2 * b
            exact = maps.effects(maps.period - start - width * (index + share[:, 0]))
            worst = max(worst, float(np.linalg.norm(curve - exact, axis=1).max()))
        assert 2e-3 * bound < worst <= bound


# least and largest delay [ms], loss; growth of the mean square; the same by 200 000 copies, twice
SQUARES = [
    ((1.0, 2.0), 0.0, 0.77034, (0.7716, 0.7717)),
    ((0.0, 5.0), 0.0, 0.92226, (0.9238, 0.9240)),
    ((1.5, 1.5), 0.1, 0.87774, (0.8746, 0.8790)),
    ((1.5, 1.5), 0.25, 1.03789, (1.0315, 1.0467)),
    ((0.5, 2.5), 0.2, 0.98674, (0.9776, 0.9869)),
]


@pytest.mark.parametrize(("delays", "loss", "growth", "events"), SQUARES)
def test_mean_squares_of_the_paper_s_wall(
    delays: tuple[float, float], loss: float, growth: float, events: tuple[float, float]
) -> None:
    line = LossyLine(jitter=[1e-3 * delay for delay in delays], loss=loss)
    found = LineVerdict(PAPER, line)
    assert found.mean_square == pytest.approx(growth, abs=6e-6)
    assert min(events) - 0.003 < found.mean_square < max(events) + 0.003
    assert found.is_stable is (growth < 1.0)


def test_the_mean_delay_matters_less_a_loss_by_the_square_of_the_jitter() -> None:
    for half, critical in ((0.0, 3.25722), (0.5, 3.25373), (1.0, 3.24330), (1.5, 3.22597)):
        for side, stable in ((-2e-5, True), (2e-5, False)):
            middle = critical + side
            line = LossyLine(jitter=(1e-3 * (middle - half), 1e-3 * (middle + half)))
            assert LineVerdict(PAPER, line).is_stable is stable


def test_the_mean_square_across_a_sample_is_that_of_simulated_copies() -> None:
    """Delays of 3 to 7.5 ms and 10 % lost: each command is pending or in effect at the next sample."""
    loop, generator, count, steps = KINDS["across a sample"][0], np.random.default_rng(5), 40_000, 8
    loop = replace(loop, stiffness=1500.0, damping=40.0)
    maps, loss = Maps(loop, 3.0e-3, 7.5e-3), 0.1
    states = np.zeros((count, maps.order, 1))
    states[:, 0, 0] = generator.normal(size=count)
    before, sizes = np.zeros(count), []
    period = loop.period
    for _ in range(steps):
        delays = generator.uniform(3.0e-3, 7.5e-3, count)
        x, v, last, waiting, held = (states[:, index, 0].copy() for index in range(5))
        command = -loop.stiffness * x - loop.damping / period * (x - last)
        arrives = np.where(before > period, before - period, 0.0)  # of the command before, `waiting`
        got = generator.random(count) >= loss
        ends = np.minimum(delays, period)
        y, w, force = x, v, held
        for duration, following in (
            (arrives, waiting),
            (ends - arrives, np.where(got & (delays <= period), command, waiting)),
            (period - ends, None),
        ):
            y, w = y + w * duration + force * duration**2 / (2.0 * loop.inertia), w + force * duration / loop.inertia
            force = force if following is None else following
        states[:, :, 0] = np.stack([y, w, x, np.where(got, command, waiting), force], axis=1)
        before = np.where(got, delays, 0.0)
        sizes.append(float(np.mean(y**2 + (period * w) ** 2)))
    row, column = np.triu_indices(maps.order)
    square, expected = MeanSquare.uniform(maps), []
    mean = (1.0 - loss) * square._received + loss * square._lost
    moments = 1.0 * ((row == 0) & (column == 0))
    for _ in range(steps):
        moments = mean @ moments
        expected.append(moments[0] + period**2 * moments[(row == 1) & (column == 1)][0])
    assert sizes == pytest.approx(expected, rel=0.1)


# loop; critical probability of loss; lost in a row proved stable, least unstable
LOSSES = [
    ((0.7, 6000.0, 80.0, 5.0, 1.5), 0.214133, (0, 1)),
    ((0.7, 3000.0, 60.0, 5.0, 1.5), 0.422362, (2, 3)),
    ((0.7, 6000.0, 80.0, 1.0, 0.5), 0.819493, (13, 15)),
    ((0.7, 1000.0, 40.0, 1.0, 1.0), 0.919452, (31, 33)),
    ((0.4, 5000.0, 50.0, 0.25, 0.25), 0.944198, (48, 54)),
    ((0.15, 200.0, 5.0, 0.5, 0.5), 0.963411, (MOST_IN_A_ROW, None)),
    ((0.7, 300.0, 20.0, 1.0, 1.0), 0.956875, (MOST_IN_A_ROW, None)),
]


@pytest.mark.parametrize("sequences", [60, *STUDY])
@pytest.mark.parametrize(("values", "loss", "runs"), [*LOSSES[:3], *further(*LOSSES[3:])])
def test_limits_of_lost_samples(values: Any, loss: float, runs: tuple[int, int | None], sequences: int) -> None:
    loop = loop_of(*values)
    found = LineVerdict(loop, LossyLine())
    assert found.critical_loss == pytest.approx(loss, abs=6e-7)
    for side, stable in ((-1e-6, True), (1e-6, False)):
        assert LineVerdict(loop, LossyLine(loss=found.critical_loss + side)).is_stable is stable
    limits = found.longest_loss
    assert limits is not None and limits.stable >= runs[0]
    settles(found._maps, sequences, most=limits.stable)
    if runs[1] is None:
        assert (
            limits.unstable is None and limits.words == f"{MOST_IN_A_ROW} proved stable (searched to {MOST_IN_A_ROW})"
        )
    else:
        assert limits.unstable is not None and limits.stable < limits.unstable <= runs[1]
        unstable = worst_case(found._maps, limits.unstable)
        assert unstable.stable is False and max(map(len, _runs_of(unstable.sequence))) == limits.unstable
        grows(loop, unstable)


def _runs_of(sequence: Sequence[float | None]) -> list[str]:
    return "".join("." if delay is None else " " for delay in [*sequence, *sequence]).split() or [""]


@pytest.mark.parametrize("sequences", [60, *STUDY])
@pytest.mark.parametrize("name", KINDS)
def test_verdicts_hold_for_loops_of_all_kinds(name: str, sequences: int) -> None:
    """What is proved settles in random sequences, what is not stable grows in the exact plant."""
    kind, (low, high) = KINDS[name]
    decided = []
    for gain, share, most in ((0.15, 0.6, 0), (0.15, 1.0, 1), (1.0, 0.2, 0), (2.5, 1.0, 0), (1.0, 1.0, 2)):
        loop = replace(kind, stiffness=gain * kind.stiffness, damping=gain**0.5 * kind.damping)
        maps = Maps(loop, low, low + share * (high - low))
        found = worst_case(maps, most)
        decided.append(found.stable)
        if found.stable:
            settles(maps, sequences, most)
        elif found.stable is False:
            grows(loop, found)
        else:
            assert found.words.startswith("not decided (between the bounds: growth x ")
            assert found.growth < 1.0 + 1e-9 < found.norm + 1e-3
    assert {True, False} <= {*decided}


@pytest.mark.parametrize(
    ("changes", "line", "reason"),
    [
        ({"device": DeviceLaw(damping=10.0)}, {}, "a law on the device has a rate of its own"),
        ({"reason": "friction is not linear"}, {}, "friction is not linear"),
        ({"axis": "x, y"}, {}, "its axes are coupled"),
        ({}, {"jitter": (0.0, 5.1e-3)}, "delays are more than a period, 5 ms, apart"),
        ({}, {"jitter": (0.049, 0.051)}, "delays are above 10 periods, 50 ms"),
    ],
)
def test_what_is_not_judged_is_never_stable(changes: Any, line: Any, reason: str) -> None:
    found = LineVerdict(replace(PAPER, **changes), LossyLine(**line))
    assert found.reason == reason and found.rows == (("over this line", f"not judged: {reason}"),)
    assert found.worst_case is None and found.longest_loss is None and not found.is_stable
    assert math.isnan(found.mean_square) and math.isnan(found.critical_loss)
    assert json.loads(json.dumps(found.as_json(), allow_nan=False))["mean_square"] is None


def test_losses_without_a_longest_run_have_no_worst_case() -> None:
    found = LineVerdict(PAPER, LossyLine(loss=0.1))
    assert found.worst_case is None and found.is_stable
    assert dict(found.rows)["worst case"] == "not judged: state the most samples lost in a row"
    assert LineVerdict(PAPER, LossyLine(loss=0.1, lost_in_a_row=1)).worst_case == worst_case(
        Maps(PAPER, 1.5e-3, 1.5e-3), 1
    )


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"jitter": (0.002, 0.001)}, "jitter must be in ascending order, low to high"),
        ({"jitter": (-0.001, 0.001)}, "jitter must be between 0 and 1 "),
        ({"loss": 1.0}, "loss must be at least 0 and below 1"),
        ({"lost_in_a_row": 65}, "lost_in_a_row must be between 0 and 64"),
        ({"lost_in_a_row": 1.5}, "lost_in_a_row must be an integer"),
    ],
)
def test_wrong_lines_are_refused(values: Any, text: str) -> None:
    with pytest.raises(ParameterError, match=text):
        LossyLine(**values)


def test_a_constant_line_is_the_loop_itself() -> None:
    for loop, _ in KINDS.values():
        found = LineVerdict(loop, LossyLine())
        assert found.worst_case is not None and found.worst_case.growth == pytest.approx(loop.spectral_radius, abs=1e-9)
        assert found.worst_case.stable is (loop.spectral_radius < 1.0)
        assert found.mean_square == pytest.approx(loop.spectral_radius**2, abs=1e-8)
        assert json.loads(json.dumps(found.as_json(), allow_nan=False))["worst_case"]["sequence"] == [loop.delay]


def test_a_norm_of_maps_is_one_of_all_of_them() -> None:
    maps = _blocks(Maps(PAPER, 0.0, 3e-3), 0).maps
    norm, coordinates = least_norm(maps)
    changed = coordinates @ maps @ np.linalg.inv(coordinates)
    assert np.linalg.norm(changed, 2, axis=(1, 2)).max() == pytest.approx(norm, abs=1e-9)
    assert longest_loss(Maps(PAPER, 3.5e-3, 3.5e-3)) == (-1, 0)


@pytest.mark.parametrize(
    ("columns", "rows", "counts"),
    [(8, 5, (9, 0, 21)), *further((29, 17, (109, 3, 262)))],
)
def test_regions_over_middle_and_half_width(columns: int, rows: int, counts: tuple[int, int, int]) -> None:
    """Proved, not decided, destabilised; of another program with delays within a period 109, 3 and 143."""
    middles, halves = np.linspace(2e-4, 4.8e-3, columns), np.linspace(0.0, 2.5e-3, rows)
    worst, growth = LineVerdict(PAPER, LossyLine()).regions(middles, halves)
    found = tuple(int((worst == kind).sum()) for kind in (1, 0, -1))
    assert found[0] >= counts[0] and sum(found) == sum(counts) and found[2] == counts[2]
    assert (growth[worst == 1] < 1.0).all() and (np.isnan(worst) == (halves[:, None] > middles)).all()
    if columns > 8:
        within = (middles + halves[:, None] <= PAPER.period) & (worst == -1)
        assert int(within.sum()) == 143


def test_measured_delays_have_the_mean_square_of_their_distribution() -> None:
    loop = replace(KINDS["across a sample"][0], stiffness=1500.0, damping=40.0)
    for low, high in ((1.0e-3, 2.0e-3), (3.0e-3, 7.5e-3)):
        delays = low + (high - low) * (np.arange(20_000) + 0.5) / 20_000
        found = LineVerdict(loop, LossyLine.of_delays(delays, loop.period))
        assert found.mean_square == pytest.approx(
            LineVerdict(loop, LossyLine(jitter=(low, high))).mean_square, abs=1e-7
        )
        assert found.line.jitter == (delays[0], delays[-1]) and "(as measured, independent: x " in str(found.rows)


def test_a_measured_delay_of_more_than_a_period_above_the_least_counts_as_lost() -> None:
    line = LossyLine.of_delays([2e-3, 1e-3, 6.1e-3, 1.5e-3], 5e-3, 0.1)
    assert line.jitter == (1e-3, 2e-3) and line.loss == pytest.approx(1.0 - 0.9 * 0.75)
    with pytest.raises(ParameterError, match="delays must not be empty"):
        LossyLine.of_delays([], 5e-3)


def test_the_line_of_several_loops_is_that_of_the_worst_and_unstable_outranks_not_judged() -> None:
    free, odd = replace(PAPER, stiffness=0.0), replace(PAPER, reason="friction is not linear")
    worse = replace(PAPER, stiffness=12_000.0)
    good, bad = LossyLine(jitter=(1e-3, 2e-3)), LossyLine(jitter=(3e-3, 5e-3), loss=0.3)
    assert mean_square_line([free], good) == ""
    line = mean_square_line([PAPER, free], good)
    assert line == "line    delay 1 to 2 ms: stable in the mean square (x 0.770 a sample)"
    assert mean_square_line([PAPER, odd], good) == "line    delay 1 to 2 ms: not judged: friction is not linear"
    unstable = mean_square_line([PAPER, odd, worse], bad)
    assert unstable.startswith("line    delay 3 to 5 ms, 30 % lost: unstable in the mean square")


def test_a_law_with_a_long_memory_is_not_judged() -> None:
    states = np.diag(np.ones(40), -1)
    law = LinearisedLaw(LinearController(states, np.eye(41)[0], -np.ones(41), np.asarray(-6000.0)), 6000.0, 80.0)
    found = LineVerdict(replace(PAPER, law=law), LossyLine(loss=0.1))
    assert found.reason == "its law has a memory of more than 32 states" and found.worst_case is None


@pytest.mark.parametrize("name", KINDS)
def test_the_norm_of_a_verdict_bounds_the_map_of_every_delay(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of delays in between, and with losses after them, in the coordinates of the proof."""
    kind, (low, high) = KINDS[name]
    coordinates: list[Array] = []

    def spied(maps: Array, enough: float = 0.0) -> tuple[float, Array]:
        norm, change = least_norm(maps, enough)
        coordinates.append(change)
        return norm, change

    monkeypatch.setattr("maglev_mj.theory.line.least_norm", spied)
    loop = replace(kind, stiffness=0.15 * kind.stiffness, damping=0.4 * kind.damping)
    maps, generator = Maps(loop, low, high), np.random.default_rng(7)
    found = worst_case(maps, 1)
    assert found.stable is not False
    change, worst = coordinates[-1], 0.0
    end = maps.whole * maps.period + (maps.period + maps.latest if maps.crosses else maps.last)
    for _ in range(300):
        before, delay = generator.uniform(low, end, 2).tolist()
        block = maps.of(event_of(maps, before, delay))
        if generator.random() < 0.5:
            block = maps.of(event_of(maps, delay, None)) @ block
        worst = max(worst, float(np.linalg.norm(change @ block @ np.linalg.inv(change), 2)))
    assert worst <= found.norm + 1e-9


@pytest.mark.parametrize(("low", "high", "most"), [(2.5e-3, 3.5e-3, 0), (3.2e-3, 3.26e-3, 0), (1.5e-3, 1.5e-3, 1)])
def test_nothing_unstable_is_proved_stable_where_the_search_finds_no_sequence(
    low: float, high: float, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    maps = Maps(PAPER, low, high)
    assert worst_case(maps, most).stable is False
    monkeypatch.setattr("maglev_mj.theory.line._search", lambda *_: (0.99, (low,)))
    found = worst_case(maps, most, quick=True)
    assert found.stable is None and found.norm > 1.0 and found.words.startswith("not decided (between the bounds: ")
