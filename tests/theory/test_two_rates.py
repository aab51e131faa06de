"""Own damping, a flexible mode and a law on the device: known values, and events simulated in time."""

from itertools import product
from typing import Any

import numpy as np
import pytest

from maglev_mj.control import LowPass
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array
from maglev_mj.plants.hand import Hand, transition
from maglev_mj.studies.levels import _SteppedLoop
from maglev_mj.theory import (
    DeviceLaw,
    Mode,
    critical_delay,
    largest_stable_stiffness,
    least_dynamic_stiffness,
    spectral_radius,
    stable_ranges,
    stiffest_wall,
)
from maglev_mj.theory.loop_array import LoopArray, pd
from maglev_mj.theory.two_rates import rates_of
from tests.sweeps import further

SOFT = "0.204,18.06,271.7,0.776,769.9"
HOST: Any = {"period": 0.005, "delay": 0.0015, "mass": 0.7}
MAGLEV_200: Any = {"period": 1e-3, "delay": 5e-4, "mass": 0.555, "velocity": LowPass(200.0)}
ONE_RATE: list[tuple[dict[str, Any], list[float]]] = [
    ({}, [6000.0, 80.0, 0.877085, 24.2084, 10106.6]),
    ({"delay": 0.005}, [6000.0, 80.0, 1.082124, 20.4967, 3530.42]),
    ({"delay": 0.012}, [900.0, 20.0, 0.987535, 6.9352, 1055.20]),
    ({"delay": 0.0}, [1000.0, 0.0, 1.008889, 5.9911, 0.0]),
    ({"period": 2e-3, "delay": 7e-4, "mass": 0.3, "own_damping": 8.0}, [2500.0, 5.0, 0.970806, 14.5833, 7476.04]),
    ({"period": 1e-3, "delay": 3e-3, "mass": 0.15, "own_damping": 2.0}, [400.0, 3.0, 0.987447, 8.2662, 1391.08]),
    ({"hand": "arm"}, [15000.0, 120.0, 0.950626, 23.3147, 18461.6]),
    ({"hand": SOFT, "delay": 0.0022}, [8000.0, 70.0, 1.002550, 23.7275, 7906.71]),
    ({"velocity": LowPass(40.0)}, [3000.0, 60.0, 0.870078, 17.7461, 6782.09]),
    ({"prediction": 0.004}, [4000.0, 0.0, 1.007443, 12.5963, 0.0]),
    ({"period": 1 / 60, "delay": 1 / 60, "mass": 0.034}, [10.0, 0.35, 0.988718, 3.1083, 11.2936]),
    (MAGLEV_200, [1e4, 15.0, 0.995843, 21.8054, 14233.3]),
]


@pytest.mark.parametrize(("loop", "known"), ONE_RATE)
def test_one_rate(loop: dict[str, Any], known: list[float]) -> None:
    stiffness, damping, radius, frequency, critical = known
    loop = HOST | loop
    poles = np.linalg.eigvals(LoopArray(**loop).matrix(stiffness, damping))
    ring = np.abs(np.angle(poles[np.argmax(np.abs(poles))])) / (2.0 * np.pi * loop["period"])
    assert spectral_radius(stiffness, damping, **loop) == pytest.approx(radius, abs=6e-7)
    assert ring == pytest.approx(frequency, abs=6e-5)
    assert largest_stable_stiffness(damping, **loop) == pytest.approx(critical, rel=1e-5)


TWO_RATES = """
20000 20    0   0  1     0.2   1.223071   4319.402
20000 20    0  50  1     0.2   1.051624  16121.14
20000 20    0 100  1     0.2   0.881964  29436.54
20000 20    0 200  1     0.2   0.521482  61385.85
20000 20    0 100  0.125 0.125 0.887611  30212.84
20000 20    0 200  0.125 0.125 0.619381  62489.88
20000 20    0 400  0.125 0.125 0.713608 145322.6
 2000 20 6000  80  1     0.2   0.627723  22627.74
    0 70.1  0  50  1     0.2   nan       19055
    0 52.4  0 100  1     0.2   nan       30551
    0 17.4  0 200  1     0.2   nan       61392
    0  0    0 400  1     0.2   nan      168872
    0 76.8  0  50  0.125 0.125 nan       19981
    0 66.2  0 100  0.125 0.125 nan       32266
    0 46.8  0 200  0.125 0.125 nan       63017
    0 18.1  0 400  0.125 0.125 nan      145324
"""
"""Host's K, B; device's K, B, period and delay [ms]; spectral radius; critical stiffness on the host."""


def test_two_rates() -> None:
    rows = np.array([line.split() for line in TWO_RATES.split("\n")[1:-1]], dtype=np.float64)
    for stiffness, damping, device, damper, period, delay, radius, critical in rows:
        law = DeviceLaw(device, damper, 1e-3 * period, 1e-3 * delay)
        assert np.isnan(radius) or spectral_radius(stiffness, damping, device=law, **HOST) == pytest.approx(
            radius, abs=6e-7
        )
        exact = largest_stable_stiffness(damping, device=law, **HOST)
        assert exact == pytest.approx(critical, abs=1.0 if np.isnan(radius) else 0.06)
    soft: Any = HOST | {"hand": SOFT}
    assert spectral_radius(3e4, 30.0, device=DeviceLaw(0.0, 150.0), **soft) == pytest.approx(0.838080, abs=6e-7)
    assert largest_stable_stiffness(30.0, device=DeviceLaw(0.0, 150.0), **soft) == pytest.approx(44969.56, abs=0.006)
    assert largest_stable_stiffness(20.0, device=DeviceLaw(0.0, 1200.0), **HOST) == 0.0  # the damper alone is unstable


def test_rates_that_are_not_commensurate() -> None:
    damper: Any = {"stiffness": 0.0, "damping": 100.0}
    for period, radius in {9e-4: 0.882017, 9.7e-4: 0.881957, 1.03e-3: 0.881970, 1.25e-3: 0.882633}.items():
        assert spectral_radius(2e4, 20.0, device=DeviceLaw(**damper, period=period), **HOST) == pytest.approx(
            radius, abs=6e-7
        )
    # A fixed phase between the clocks; the worst of ten below a ratio of 4 if they are not commensurate.
    loop, host = LoopArray(**HOST, device=DeviceLaw(**damper)), pd()(*map(np.asarray, (2e4, 20.0, 5e-3)))
    phases = [np.abs(np.linalg.eigvals(loop.two_rates(0.1 * k).matrix(host)[:-1, :-1])).max() for k in range(10)]
    assert (min(phases), max(phases)) == pytest.approx((0.881942, 0.881966), abs=6e-7)  # as simulated
    for ratio, count in {1.0: 1, 1.0 + 1e-6: 10, 4.0 + 1e-6: 1}.items():
        device = DeviceLaw(**damper, period=5e-3 / ratio)
        assert len(rates_of(5e-3, device).phases) == count
        start = spectral_radius(2e4, 20.0, **HOST, device=DeviceLaw(**damper, period=5e-3 / round(ratio)))
        worst = spectral_radius(2e4, 20.0, **HOST, device=device)
        assert worst > start + 9e-4 if count > 1 else worst == pytest.approx(start, abs=1e-5)
        edge = [0.999, 1.001] * largest_stable_stiffness(20.0, **HOST, device=device)
        assert (spectral_radius(edge, 20.0, **HOST, device=device) < 1.0).tolist() == [True, False]


@pytest.mark.parametrize(
    ("wall", "period", "delay", "radius", "critical"),
    [
        ((6e4, 200.0), 1e-3, 2e-4, 0.857502, 211773.8),
        ((6e4, 200.0), 1.25e-4, 1.25e-4, 0.982051, 1024220),
        ((0.0, 471.0), 1e-3, 2e-4, None, 304231),
        ((0.0, 297.0), 1e-3, 1e-3, None, 101129),
    ],
)
def test_law_on_the_device_alone(wall: Any, period: float, delay: float, radius: Any, critical: float) -> None:
    law = DeviceLaw(wall[0], wall[1], period, delay)
    alone: Any = {"period": period, "delay": delay, "mass": 0.7, "velocity": law.velocity}
    exact = spectral_radius(*wall, **alone)
    assert spectral_radius(0.0, 0.0, device=law, **HOST) == pytest.approx(exact ** (HOST["period"] / period), rel=1e-10)
    assert radius is None or exact == pytest.approx(radius, abs=6e-7)
    assert largest_stable_stiffness(wall[1], **alone) == pytest.approx(critical, rel=1e-5)


PLACES = [(f, 0.01, -1.0 if at else m / (0.7 - m)) for m, f, at in product((0.05, 0.2), (900.0, 1e3, 1.1e3), (0, 1))]


@pytest.mark.parametrize(
    ("period", "delay", "wall", "known", "unstable"),
    [
        (2e-4, 1.5e-3, (66760.15, 378.0540), {0: 0.992506, 5: 1.017590, 6: 1.006474, 9: 0.992255}, 3),
        (2e-4, 5e-4, (398975.42, 882.5852), {2: 0.989363, 5: 1.023769, 6: 1.012758}, 3),
        (1e-3, 1.5e-3, (31764.96, 241.5921), {3: 0.939099}, 0),
        (1.25e-4, 1.25e-4, (3236113.0, 2378.285), {}, 12),
        (1.25e-4, 1.25e-4, (6e4, 200.0), {}, 0),
        (1e-3, 2e-4, (6e3, 80.0), {}, 0),
    ],
)
def test_modes(period: float, delay: float, wall: Any, known: dict[int, float], unstable: int) -> None:
    loop: Any = {"period": period, "delay": delay, "mass": 0.7}
    radii = spectral_radius(*wall, mode=Mode(*np.transpose(PLACES)), **loop)
    assert radii[[*known]] == pytest.approx([*known.values()], abs=6e-7)
    assert np.count_nonzero(radii > 1.0) == unstable
    if 3 in known:
        flexible = largest_stable_stiffness(wall[1], mode=Mode(*PLACES[3]), **loop)
        assert flexible / largest_stable_stiffness(wall[1], **loop) == pytest.approx(0.992, abs=5e-4)


def simulated(a: Array, push: Array, sense: Array, laws: list[list[Any]], horizon: float) -> Array:
    """Return the map of all initial conditions over a time; a law: period, delay, K, B, share of the filter."""
    waits = [[late - age * step for age in range(12, 0, -1) if late - age * step > -1e-12] for step, late, *_ in laws]
    rows = iter(np.eye(len(a) + sum(3 + len(times) for times in waits)))
    body, time, samples = np.array([next(rows) for _ in a]), 0.0, [0.0 for _ in laws]
    last, speed, force = ([next(rows) for _ in laws] for _ in range(3))
    queues = [[(due, next(rows)) for due in times] for times in waits]
    while time < horizon:
        due = [(at, 0, index) for index, at in enumerate(samples)]
        when, kind, index = min(due + [(queue[0][0], 1, index) for index, queue in enumerate(queues) if queue])
        when = horizon if when > horizon - 1e-12 else when
        phi, gamma = transition(a, push, max(when - time, 0.0))
        body, time = phi @ body + gamma * sum(force), when
        if kind and when < horizon:
            force[index] = queues[index].pop(0)[1]
        elif when < horizon:
            step, delay, stiffness, damping, share = laws[index]
            speed[index] = speed[index] + share * ((sense @ body - last[index]) / step - speed[index])
            last[index], samples[index] = sense @ body, when + step
            queues[index].append((when + delay, -stiffness * last[index] - damping * speed[index]))
    return np.array([*body, *last, *speed, *force, *(row for queue in queues for _, row in queue)])


def radius_and_growth(random: np.random.Generator) -> tuple[float, float]:
    """Return the spectral radius of two masses under one law or two, and their simulated growth per host period."""
    step, own, share = 10.0 ** random.uniform(-3.0, -2.0), random.uniform(0.0, 20.0), random.uniform(0.5, 0.95)
    mass, q = random.uniform(0.1, 2.0), random.choice([1, 1, 2, 4])
    fine = step * q / random.integers(q, 8 * q)
    late = random.choice([0.0, 1.0, *random.uniform(0.0, 2.5, 4)], 2)
    handle, filtered, device = random.random(3) < 0.5
    frequency, ratio = random.uniform(0.05, 3.0) / step, 10.0 ** random.uniform(-2.5, -0.7)
    pair, pull, turn = mass * np.array([share, 1.0 - share]), np.array([1.0, -1.0]), 2.0 * np.pi * frequency
    spring = np.outer(pull / pair, pull) * mass * share * (1.0 - share)
    arm, mean = random.uniform(0.0, 500.0), np.outer([1.0, 1.0], pair) / mass**2
    drag = 2.0 * ratio * turn * spring + own * mean
    a = np.block([[np.zeros((2, 2)), np.eye(2)], [-(turn**2) * spring - arm * mean, -drag]])
    units = mass / np.array([[step**2], [step / 3.0]])
    (k, kd), (b, bd) = units * 10.0 ** random.uniform(-2.5, 0.0, (2, 2)) * [1.0, 0.3]
    cutoff = random.uniform(0.05, 1.0) / step if filtered else None
    law = DeviceLaw(kd, bd, fine, late[1] * fine, cutoff)
    laws = [[step, late[0] * step, k, b], [fine, law.delay, law.stiffness, law.damping]][: 1 + device]
    laws = [[*parts, -np.expm1(-2.0 * np.pi * cutoff * parts[0]) if cutoff else 1.0] for parts in laws]
    loop: Any = {"period": step, "delay": laws[0][1], "mass": mass, "velocity": law.velocity, "own_damping": own}
    loop["hand"], loop["mode"] = Hand(stiffness=arm), Mode(frequency, ratio, -1.0 if handle else (1.0 - share) / share)
    radius = spectral_radius(k, b, device=law, **loop) if device else spectral_radius(k, b, **loop)
    power, growth = simulated(a, np.eye(4)[:, 2:3] / pair[0], np.eye(4)[int(handle)], laws, q * step), 0.0
    for doubling in range(20):
        size = np.linalg.norm(power)
        power, growth = (power / size) @ (power / size), growth + float(np.log(size)) / 2.0**doubling
    return float(radius), float(np.exp(growth / q))


@pytest.mark.parametrize("seed", [*range(4), *further(*range(4, 40))])
def test_radius_is_the_growth_of_simulated_events(seed: int) -> None:
    random = np.random.default_rng(seed)
    radii, growths = np.transpose([radius_and_growth(random) for _ in range(50)])
    np.testing.assert_allclose(growths, radii, rtol=1e-4)
    decided = np.abs(radii - 1.0) > 1e-3
    np.testing.assert_array_equal(growths[decided] < 1.0, radii[decided] < 1.0)
    assert 10 < np.count_nonzero(radii < 1.0) < 40


def test_laws_of_equal_rates_add_up_and_every_function_takes_arrays() -> None:
    modes = Mode([900.0, 1100.0], 0.01, [[0.1], [-1.0], [0.4]])
    loop: Any = HOST | {"hand": SOFT, "own_damping": [0.0, 5.0], "mode": modes, "velocity": LowPass(90.0)}
    loop["driver_lag"] = 1e-4
    single = loop | {"own_damping": 5.0, "mode": Mode(1100.0, 0.01, -1.0)}
    radius, critical = spectral_radius(3000.0, 29.0, **loop), largest_stable_stiffness(29.0, **loop)
    both = spectral_radius(2000.0, 20.0, device=DeviceLaw(1000.0, 9.0, 0.005, 0.0015, 90.0), **loop)
    np.testing.assert_allclose(both, radius, rtol=1e-10)
    np.testing.assert_allclose(spectral_radius(3000.0, 29.0, device=DeviceLaw(), **loop), radius, rtol=1e-10)
    np.testing.assert_allclose(largest_stable_stiffness(29.0, device=DeviceLaw(), **loop), critical, rtol=1e-9)
    assert radius[1, 1] == pytest.approx(spectral_radius(3000.0, 29.0, **single), rel=1e-12)
    assert stable_ranges(29.0, **single)[0][1] == pytest.approx(critical[1, 1], rel=1e-6)
    best = stiffest_wall(**single)
    assert best.stiffness == pytest.approx(largest_stable_stiffness(best.damping, **single), rel=1e-9)
    least = least_dynamic_stiffness(3000.0, 29.0, **loop)
    assert least[1, 1] == pytest.approx(least_dynamic_stiffness(3000.0, 29.0, **single), rel=1e-9)
    edge = critical_delay(3000.0, 29.0, **{name: value for name, value in loop.items() if name != "delay"})
    np.testing.assert_allclose(spectral_radius(3000.0, 29.0, **loop | {"delay": edge}), 1.0, atol=1e-9)


@pytest.mark.parametrize(
    ("device", "loop", "words"),
    [
        ({"period": 0.1}, {"period": 1e-4, "delay": 0.0}, "device period must be at most 0.0128 s, 128 of the host"),
        ({"period": 1.0}, {}, "device period must be between"),
        ({"delay": 0.02}, {}, "delay must be at most 0.01 s, 10 periods"),
        ({"cutoff": 0.0}, {}, "device cutoff must be above 0"),
        ({"stiffness": -1.0}, {}, "device stiffness must be"),
        ({"damping": -1.0}, {}, "device damping must be"),
        ({}, {"own_damping": -1.0}, "own_damping must be"),
        ({}, {"own_damping": [1.0, 2.0], "mass": [1.0] * 3}, "own_damping, driver_lag, hand, mode must share"),
    ],
)
def test_wrong_values_are_refused(device: dict[str, Any], loop: dict[str, Any], words: str) -> None:
    with pytest.raises(ParameterError, match=words):
        spectral_radius(2e4, 20.0, device=DeviceLaw(**device), **HOST | loop)
    for values in ((0.0, 0.01, 1.0), (1.0, -0.1, 1.0), (1.0, 0.1, -1.1)):
        with pytest.raises(ParameterError, match=r"mode .* must be"):
            Mode(*values)
    with pytest.raises(ParameterError, match="a stepped loop must have neither"):
        _SteppedLoop(own_damping=1.0).flotor  # noqa: B018
