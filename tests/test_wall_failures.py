"""Where a wall fails although its eigenvalues are fine, and what cures it; each claim over phases, seeds or a sweep."""

import numpy as np
import pytest

from maglev_mj.bounds import gil
from maglev_mj.experiments.corner import corner
from maglev_mj.experiments.failures import press_at_edge, rattle
from maglev_mj.experiments.growth import RestingWall, measure_growth
from maglev_mj.hand import Hand
from maglev_mj.stability import critical_delay, largest_modulus, largest_stable_stiffness

T, Q = 0.005, 5e-6


def gate(noise: float, period: float = T) -> float:
    """Return the approach speed from which on a pulse is worth giving: five steps and deviations a period."""
    return 5.0 * (Q + noise) / period


@pytest.mark.parametrize("noise", [2e-6, 5e-6])
@pytest.mark.parametrize("press", [0.003, 0.01, 0.02])
def test_the_pulse_chatters_under_a_light_press_over_a_noisy_sensor(press: float, noise: float) -> None:
    """At the edge of the paper's wall, 20 phases; the gate ends it altogether."""
    open_, gated = press_at_edge(press, [0.0, gate(noise)], noise=noise, phases=20).pulses
    assert open_ > 1.0 and gated == 0.0


def test_it_does_not_chatter_under_a_firmer_press_or_an_ideal_sensor() -> None:
    """Noise of 2 µm moves the flotor less than it has sunk from 0.1 N on; an ideal sensor has none."""
    for press in (0.1, 0.3, 1.0, 3.0):
        assert press_at_edge(press, 0.0, phases=20).pulses[0] == 0.0
    for press in (0.003, 0.01, 0.1, 1.0):
        assert press_at_edge(press, 0.0, phases=20, noise=0.0, quantum=0.0).pulses[0] == 0.0


def test_more_noise_takes_a_firmer_press() -> None:
    quiet, noisy = (press_at_edge(0.1, 0.0, phases=20, noise=noise).pulses[0] for noise in (2e-6, 5e-6))
    assert quiet == 0.0 and noisy > 1.0


def test_the_gate_does_not_cost_a_real_impact_its_pulse() -> None:
    """Let go 0.1 mm above, 1 N: one pulse at every phase, with the gate and without."""
    fired = press_at_edge(1.0, [0.0, gate(2e-6)], height=1e-4, phases=20).pulses
    assert fired.tolist() == [0.5, 0.5]  # one in two seconds


def test_a_faster_sampler_needs_a_higher_gate() -> None:
    """At 1 kHz a step of the sensor is five times the speed."""
    for noise in (2e-6, 5e-6):
        chosen = [0.0, gate(noise), gate(noise, 1e-3)]
        open_, same, higher = press_at_edge(0.02, chosen, noise=noise, phases=20, period=1e-3).pulses
        assert open_ > 2.0 and same > 1.0 and higher == 0.0


def test_two_walls_closer_than_a_sample_of_travel_rattle_by_their_pulses() -> None:
    """At 60 N, 0.1 m/s, eight phases, the worst: for ever with the paper's pulse, by and by still without one."""
    narrow, wide = np.array([1e-5, 3e-5]), np.array([3e-4, 1e-3, 3e-3])
    assert (rattle(narrow, pulse=220.0) > 0.1).all()
    assert (rattle(wide, pulse=220.0) < 0.01).all()
    assert (rattle(narrow, pulse=0.0) < 0.001).all()
    # a pulse that stops the flotor rather than throwing it back, 0.7 kg / 3 ms less the damping, does not
    assert (rattle(narrow, pulse=0.7 / 0.003 - 80.0) < 0.001).all()


def test_the_longer_the_delay_the_wider_the_gap_that_rattles() -> None:
    gaps = np.array([1e-5, 1e-4, 1e-3, 3e-3])
    reach = [int((rattle(gaps, pulse=220.0, delay=delay) > 0.1).sum()) for delay in (0.0, 0.0015, 0.003)]
    assert reach == sorted(reach) and reach[0] == 0 and reach[2] == len(gaps)
    assert (rattle(gaps, pulse=0.0, delay=0.003) < 0.01).all()  # the walls themselves are stable


@pytest.mark.parametrize("seed", range(3))
def test_a_corner_of_two_walls_and_a_rotation_comes_to_rest(seed: int) -> None:
    """Three pulses and contacts at once, on both plants, and at the same place."""
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
    """A clamp raises the frequency until the delay turns damping into drive; hands are far softer."""
    wall = {"stiffness": 6000.0, "damping": 80.0}
    stiff = np.array([0.0, 500.0, 1050.0, 5000.0, 12000.0, 40000.0])
    modulus = largest_modulus(wall["stiffness"], wall["damping"], period=T, delay=0.0015, hand=Hand(stiffness=stiff))
    assert (np.diff(modulus) > 0.0).all()
    assert (modulus[:4] < 1.0).all() and (modulus[4:] > 1.0).all()
    assert critical_delay(6000.0, 80.0, period=T, hand=Hand(stiffness=40000.0)) < 0.0015


def test_letting_go_undoes_a_wall_tuned_with_the_hand_on() -> None:
    """9000 N/m and 130 N s/m: the hand's mass carries what is too much damping for the flotor alone."""
    arm = Hand(mass=0.554, damping=6.45, stiffness=135.0)
    assert largest_modulus(9000.0, 130.0, period=T, delay=0.0015, hand=arm) < 0.9
    assert largest_modulus(9000.0, 130.0, period=T, delay=0.0015) > 1.0


def test_mass_alone_never_undoes_a_stable_wall() -> None:
    """It scales both gains down; the boundary at a low damping goes up to the first-order one, and no further."""
    mass = np.array([0.0, 0.2, 1.0, 5.0, 100.0])
    boundary = [float(largest_stable_stiffness(23.0, period=T, delay=0.0015, hand=Hand(mass=m))) for m in mass]
    assert np.all(np.diff(boundary) > 0.0)
    assert boundary[-1] == pytest.approx(gil(23.0, period=T, delay=0.0015), rel=0.01)
    random = np.random.default_rng(6)
    k, b = random.uniform(10.0, 15000.0, 3000), random.uniform(1.0, 180.0, 3000)
    stable = largest_modulus(k, b, period=T, delay=0.0015) < 1.0
    for m in mass:
        assert (largest_modulus(k[stable], b[stable], period=T, delay=0.0015, hand=Hand(mass=m)) < 1.0).all()


def test_clamps_and_letting_go_are_so_in_simulation_too() -> None:
    """Both plants settle or grow as the modulus says, held, clamped and let go."""
    arm = Hand(mass=0.554, damping=6.45, stiffness=135.0)
    cases = [
        (6000.0, 80.0, None, True),
        (6000.0, 80.0, Hand(stiffness=12000.0), False),
        (9000.0, 130.0, arm, True),
        (9000.0, 130.0, None, False),
    ]
    for plant in ("exact", "mujoco"):
        for k, b, hand, settles in cases:
            assert bool(measure_growth([k], [b], RestingWall(plant=plant, hand=hand)).stable[0]) == settles
