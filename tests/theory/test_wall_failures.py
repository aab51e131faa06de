"""Failures of walls despite stable eigenvalues, and remedies, over phases, seeds or sweeps."""

from itertools import product

import numpy as np
import pytest

from maglev_mj.control import Wall
from maglev_mj.frames import Array, Mask
from maglev_mj.plants.hand import Hand
from maglev_mj.spec import RANGE
from maglev_mj.theory import critical_delay, largest_stable_stiffness, spectral_radius
from tests.sweeps import further
from tests.theory.failures import corner, press_at_edge
from tests.theory.impacts import RATTLE, limited_drop, rattle

T, Q = 0.005, 5e-6


def gate(noise: float, period: float = T) -> float:
    """Return the least approach speed for a pulse: five steps and deviations a period."""
    return 5.0 * (Q + noise) / period


@pytest.mark.parametrize(
    ("press", "noise"), [(0.003, 5e-6), (0.02, 2e-6), *further(*product((0.003, 0.01, 0.02), (2e-6, 5e-6)))]
)
def test_the_pulse_chatters_under_a_light_press_over_a_noisy_sensor(press: float, noise: float) -> None:
    # At the edge of the paper's wall, 20 phases; the gate ends it altogether.
    open_, gated = press_at_edge(press, [0.0, gate(noise)], noise=noise, phases=20).pulses
    assert open_ > 1.0 and gated == 0.0


def test_it_does_not_chatter_under_a_firmer_press_or_an_ideal_sensor() -> None:
    # Noise of 2 µm moves the flotor less than it has sunk from 0.1 N on; an ideal sensor has none.
    for press in (0.1, 3.0):
        assert press_at_edge(press, 0.0, phases=20).pulses[0] == 0.0
    for press in (0.003, 1.0):
        assert press_at_edge(press, 0.0, phases=20, noise=0.0, quantum=0.0).pulses[0] == 0.0


def test_the_gate_does_not_cost_a_real_impact_its_pulse() -> None:
    # Let go 0.1 mm above, 1 N: one pulse at every phase, with the gate and without.
    fired = press_at_edge(1.0, [0.0, gate(2e-6)], height=1e-4, phases=20).pulses
    assert fired.tolist() == [0.5, 0.5]  # one in two seconds


@pytest.mark.parametrize("noise", [2e-6, pytest.param(5e-6, marks=pytest.mark.study)])
def test_a_faster_sampler_needs_a_higher_gate(noise: float) -> None:
    # At 1 kHz a step of the sensor is five times the speed.
    chosen = [0.0, gate(noise), gate(noise, 1e-3)]
    open_, same, higher = press_at_edge(0.02, chosen, noise=noise, phases=20, period=1e-3).pulses
    assert open_ > 2.0 and same > 1.0 and higher == 0.0


@pytest.mark.study
@pytest.mark.parametrize(
    ("noise", "quiet"), [(1e-6, 0.06), (2e-6, 0.1), (3e-6, 0.15), (5e-6, 0.3), (7e-6, 0.35), (10e-6, 0.5)]
)
def test_the_noisier_the_sensor_the_firmer_the_press_that_chatters(noise: float, quiet: float) -> None:
    # Noise by force, 50 phases: it chatters from light presses up to half of `quiet`, and nowhere from that on.
    for press in quiet * np.array([0.1, 0.2, 0.5]):
        assert press_at_edge(float(press), 0.0, noise=noise, phases=50).pulses[0] > 0.1
    for press in quiet * np.array([1.0, 1.2, 1.5, 2.0, 3.0, 5.0]):
        assert press_at_edge(float(press), 0.0, noise=noise, phases=50).pulses[0] == 0.0
    for period in (5e-3, 1e-3):
        for press in quiet * np.geomspace(0.03, 3.0, 8):
            assert press_at_edge(float(press), gate(noise, period), noise=noise, phases=16, period=period).pulses == 0.0


STOPS = 0.7 / 0.003 - 80.0
"""Damping of the pulse that just stops the flotor.

Within its 3 ms, rather than throwing it back [N s/m].
"""


def rattling(gaps: Array, pulse: float, delay: float, every: int) -> list[float]:
    """Return the share of rattling starts in each gap, of 16 / every speeds and 8 phases."""
    speeds, phases = np.arange(1, 17, every) * 0.02, np.arange(8) / 8
    found = rattle(gaps[:, None, None], speeds[:, None], phases, pulse=pulse, delay=delay)
    return [float(share) for share in (found.speed > RATTLE).mean(axis=(1, 2))]


@pytest.mark.parametrize("every", [3, *further(1)])
def test_two_walls_rattle_by_their_pulses_from_many_starts(every: int) -> None:
    # At 1.5 ms more often the closer they are, up to 0.2 mm; one starting speed would have shown 0.03.
    shares = rattling(np.array([1e-5, 5e-5, 2e-4, 5e-4]), 220.0, 0.0015, every)
    assert shares[0] > 0.8 and 0.3 < shares[1] < 0.7 and 0.0 < shares[2] < 0.2 and shares[3] == 0.0


@pytest.mark.parametrize("every", [3, *further(1)])
def test_a_pulse_that_just_stops_the_flotor_does_not_make_two_walls_rattle(every: int) -> None:
    assert rattling(np.array([1e-5, 2e-4]), STOPS, 0.0015, every) == [0.0, 0.0]


def random_rattles(
    pulse: float, delay: float, seed: int, count: int = 4000, **options: float
) -> tuple[Array, Mask, Array]:
    """Return random gaps, rattling, and distances, for any speed, phase and start between walls."""
    random = np.random.default_rng(seed)
    gap = np.exp(random.uniform(np.log(1e-5), np.log(5e-3), count))
    speed = random.uniform(0.02, 0.45, count) * random.choice([-1.0, 1.0], count)
    start, phase = random.uniform(-1.0, 1.0, count), random.random(count)
    found = rattle(gap, speed, phase, starts=start, pulse=pulse, delay=delay, **options)
    return gap, found.speed > RATTLE, found.furthest


@pytest.mark.study
@pytest.mark.parametrize("delay", np.arange(13) * 0.25e-3)
def test_where_two_walls_rattle(delay: float) -> None:
    # The study's figures hold for starts that it did not choose: widest gap [mm] by delay [ms] and pulse.
    widest = {
        220.0: {1.25: 0.07, 1.5: 0.25, 1.75: 1.7, 2.0: 2.0, 2.25: 5.0, 2.5: 5.0, 2.75: 5.0, 3.0: 5.0},
        STOPS: {2.5: 0.7, 2.75: 1.0, 3.0: 1.5},
        0.0: {3.0: 0.25},
    }
    for pulse, rattles in widest.items():
        gap, seen, _ = random_rattles(pulse, delay, seed=100 + round(delay * 1e6))
        bound = rattles.get(round(delay * 1e3, 2), 0.0) * 1e-3
        assert gap[seen].max(initial=0.0) <= bound
        assert bound == 0.0 or gap[seen].max() > 0.5 * bound
        if pulse == 220.0 and delay >= 0.0025:
            assert seen.all()


@pytest.mark.study
def test_without_a_pulse_it_is_the_force_limit_that_rattles() -> None:
    # At 3 ms from one start in about a thousand, out of the device's range.
    for seed in (1, 2):
        gap, seen, furthest = random_rattles(0.0, 0.003, seed)
        assert 0.0 < seen.mean() < 0.004
        assert (gap[seen] > 0.1e-3).all() and (furthest[seen] > RANGE[2]).all()
        assert not random_rattles(0.0, 0.003, seed, force_limit=1e9)[1].any()


DEPTHS = {8.0: 42.4e-3, 10.0: 16.7e-3, 12.0: 11.1e-3, 15.0: 7.75e-3, 20.0: 5.62e-3, 30.0: 4.5e-3, 60.0: 4.5e-3}
"""Largest depth of a drop under each force limit.

From 4.5 mm [N: m]; the range is 4.5 mm.
"""


def test_a_force_limit_lets_the_flotor_out_of_the_device_s_range() -> None:
    # The paper's wall, 64 phases: it settles under every limit, but within the range from 27 N on.
    paper = Wall(axes="z", lower=0.0, stiffness=6000.0, damping=80.0)
    phases = np.arange(64) / 64
    for limit, depth in DEPTHS.items():
        found = limited_drop(RANGE[2], paper, phases, force_limit=limit, duration=1.0)
        assert (found.furthest <= depth).all() and found.furthest.max() > 0.99 * min(depth, RANGE[2])
        assert (found.furthest > RANGE[2]).any() == (limit < 27.0)


@pytest.mark.study
@pytest.mark.parametrize("limit", [8.0, 10.0, 15.0, 20.0, 30.0, 60.0])
def test_a_force_limit_undoes_no_stable_wall(limit: float) -> None:
    # Random stable walls, heights and phases: each settles, however deep it goes on the way.
    random = np.random.default_rng(int(limit))
    k, b = random.uniform(300.0, 10_000.0, 700), random.uniform(3.0, 140.0, 700)
    stable = spectral_radius(k, b, period=T, delay=0.0015) < 0.95
    k, b, heights = k[stable], b[stable], random.permutation(np.geomspace(2e-4, 9e-3, int(stable.sum())))
    law = Wall(axes="z", lower=0.0, stiffness=k[:, None], damping=b[:, None])
    found = limited_drop(heights, law, random.random(k.size), force_limit=limit, duration=4.0)
    assert (found.swing < 1e-5).all()


@pytest.mark.parametrize("seed", [0, *further(1, 2)])
def test_a_corner_of_two_walls_and_a_rotation_comes_to_rest(seed: int) -> None:
    # Three pulses and contacts at once, on both plants, and at the same place.
    random = np.random.default_rng(seed)
    pose = [*random.uniform(1e-3, 4e-3, 3), 0.0, random.uniform(0.01, 0.05), 0.0]
    twist = [-0.1, 0.0, -0.15, 0.0, -random.uniform(0.3, 1.5), 0.0]
    (one, energy), (other, engine) = (corner(plant, pose, twist) for plant in ("exact", "mujoco"))
    assert energy[-1] < 1e-4 * energy[0] and engine[-1] < 1e-4 * engine[0]
    assert np.abs(one[-1] - other[-1])[[0, 2, 4]].max() < 1e-7
    assert np.abs(one[-1] - other[-1]).max() < 2e-5  # the free rotations, softly sprung, which only MuJoCo couples
    assert np.abs(one - other)[:, :3].max() < 1e-9  # translations do not feel the rotation
    assert one[:, [0, 2]].min() < -1e-4 and one[:, 4].min() < -1e-3  # each of the three was hit


def test_a_hand_stiff_enough_undoes_a_stable_wall() -> None:
    # A clamp raises the frequency until the delay turns damping into drive; hands are far softer.
    wall = {"stiffness": 6000.0, "damping": 80.0}
    stiff = np.array([0.0, 500.0, 1050.0, 9100.0, 9150.0, 40000.0])
    radius = spectral_radius(wall["stiffness"], wall["damping"], period=T, delay=0.0015, hand=Hand(stiffness=stiff))
    assert (np.diff(radius) > 0.0).all()
    assert (radius[:4] < 1.0).all() and (radius[4:] > 1.0).all()
    assert critical_delay(6000.0, 80.0, period=T, hand=Hand(stiffness=40000.0)) < 0.0015


def test_mass_alone_never_undoes_a_stable_wall() -> None:
    # It scales both gains down; the boundary at a low damping goes up to the first-order one, and no further.
    mass = np.array([0.0, 0.2, 1.0, 5.0, 100.0])
    boundary = [float(largest_stable_stiffness(23.0, period=T, delay=0.0015, hand=Hand(mass=m))) for m in mass]
    assert np.all(np.diff(boundary) > 0.0)
    assert boundary[-1] == pytest.approx(23.0 / (0.5 * T + 0.0015), rel=0.01)
    random = np.random.default_rng(6)
    k, b = random.uniform(10.0, 15000.0, 3000), random.uniform(1.0, 180.0, 3000)
    stable = spectral_radius(k, b, period=T, delay=0.0015) < 1.0
    for m in mass:
        assert (spectral_radius(k[stable], b[stable], period=T, delay=0.0015, hand=Hand(mass=m)) < 1.0).all()
