"""Guards of a flight: late answers, vibration, energy, and the hand's estimated force."""

from __future__ import annotations

import math
import random
import re
from collections import deque
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj import AxisLaw, Controller, Hold, Law, Wall, find_scene, judge
from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.fault import load_fault
from maglev_mj.bridge.flight_guards import DelayGuard, PowerGuard, delay_limit
from maglev_mj.bridge.landing import LANDING_DELAY, Leader, Swing
from maglev_mj.bridge.observer import HandObserver
from maglev_mj.bridge.preflight import LinkReport, _critical_delay
from maglev_mj.bridge.safety import Limits
from maglev_mj.bridge.twin.fault_injection import InjectedFault
from maglev_mj.frames import Command
from maglev_mj.scenes import BUILT_IN
from maglev_mj.scenes.interactive import Joystick
from maglev_mj.session import device_controller
from maglev_mj.spec import INERTIA
from tests.bridge.slow_lines import SHAPES, ChangedLaw, fly
from tests.sweeps import sweep

FLOWN = tuple(name for name in BUILT_IN if find_scene(name)().laws())
"""Scenes with laws."""
RATES = [200, pytest.param(1000, marks=pytest.mark.study)]
"""Rates of flights: each kind flies at 200 Hz in the suite."""


HEAVY = [1e3 * part for part in INERTIA]
"""Inertia of a flotor that hardly moves within a period."""


def studies(*cases: tuple[Any, ...]) -> list[Any]:
    """Return cases that are studies."""
    return [pytest.param(*case, marks=pytest.mark.study) for case in cases]


# critical delay


@pytest.mark.parametrize(("name", "period"), sweep(FLOWN, [0.005, 0.001], every=5))
def test_a_margin_is_where_the_verdict_turns(name: str, period: float) -> None:
    controller = device_controller(find_scene(name)().replace(period=period, delay=0.0015))
    margin = judge(controller, delay=0.0).critical_delay
    if not margin.beyond:
        assert judge(controller, delay=margin * 0.999).stable and not judge(controller, delay=margin * 1.002).stable
    else:
        assert judge(controller, delay=min(0.03, 10 * period) * 0.999).stable


class Unstated(Hold):
    """Hold that states no gains, so that it is linearised."""

    def gains(self) -> None:  # type: ignore[override]
        return None


@pytest.mark.parametrize("hand", [*studies(("none",)), "arm", *studies(("stylus",), ("fingertip",))])
def test_a_law_that_states_no_gains_has_the_margin_of_one_that_does(hand: str) -> None:
    stated, unstated = (
        Controller([law(axes=["x", "y", "z"], stiffness=3000.0, damping=60.0)], period=0.005)
        for law in (Hold, Unstated)
    )
    expected = judge(stated, delay=0.0, hand=hand).critical_delay
    assert math.isfinite(expected)
    assert judge(unstated, delay=0.0, hand=hand).critical_delay == pytest.approx(expected, rel=1e-3)


class Jumping(AxisLaw):
    """Law with a discontinuous force at rest, so that no margin is computed."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        return -1000.0 * x - 2.0 * np.sign(v)


class StiffOutside(AxisLaw):
    """Law that is soft within 3 mm and too stiff outside."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        return -x - 0.1 * v - 1e5 * np.sign(x) * np.maximum(np.abs(x) - 0.003, 0.0)


class Outside(Joystick):
    """Scene of that law."""

    def laws(self) -> list[Law]:
        return [StiffOutside(axes="z")]


@pytest.mark.parametrize(("name", "delay"), [("ubc", 0.0), ("stage", 0.0884394), ("arm", 0.0)])
def test_margins_are_those_within_the_range_of_the_device(name: str, delay: float) -> None:
    scene = Outside(device=name, period=0.02)
    assert _critical_delay(scene, scene.body.inertia) == pytest.approx(delay, abs=1e-7)  # B/K - T/2 is 0.09


def test_margins_may_be_zero_far_above_the_period_or_nan() -> None:
    shaky = Controller([Wall(axes="z", lower=0.0, stiffness=90_000.0, damping=10.0)], period=0.005)
    assert judge(shaky, delay=0.0).critical_delay == 0.0
    soft = Controller([Hold(axes="z", stiffness=1.0, damping=0.1)], period=0.005)
    margin = judge(soft, delay=0.0).critical_delay
    assert margin == pytest.approx(0.0969883, abs=1e-7) and not margin.beyond  # B/K - T/2 is 0.0975
    free = judge(Controller([Hold(axes="z", stiffness=0.0, damping=0.0)], period=0.005), delay=0.0).critical_delay
    assert free.proved and free.largest_gain == 0.0
    jumping = Controller([Jumping(axes="z")], period=0.005)
    assert math.isnan(judge(jumping, delay=0.0).critical_delay)


# guards alone


@pytest.mark.parametrize(
    ("delays", "rule"),
    [
        ([3.8] * 7, ""),
        ([3.8] * 8, "8 of the last 16 delays above 3.75 ms, newest 3.80 ms"),
        ([3.8, 1.0] * 7 + [3.8], "8 of the last 16"),
        ([3.8, 1.0, 1.0] * 40, ""),
        ([3.7] * 47, ""),
        ([3.7] * 48, "48 of the last 64 delays above 3.00 ms, newest 3.70 ms"),
        ([3.7, 1.0] * 100, ""),
        ([9.1] * 2, ""),
        ([9.1] * 3, "3 of the last 5 delays above 9.00 ms"),
        ([9.1, 1.0, 9.1, 1.0, 9.1], "3 of the last 5"),
        ([9.1, 1.0, 1.0, 9.1, 1.0, 9.1], ""),
        ([40.0, 1.0, 1.0, 1.0] * 3, ""),
        ([math.inf] * 3, "3 of the last 5"),
    ],
)
def test_a_slow_link_is_detected_and_a_single_late_answer_is_not(delays: list[float], rule: str) -> None:
    guard = DelayGuard(3e-3)
    said = [guard.check(delay * 1e-3) for delay in delays]
    assert not any(said[:-1]) and rule in said[-1] and bool(rule) == bool(said[-1])


@pytest.mark.parametrize(
    ("critical_delay", "period", "late"),
    [
        (2.91e-3, 0.005, 2.91e-3),
        (5.5e-3, 0.001, 5e-3),
        (11.6e-3, 0.005, 9.28e-3),
        (math.inf, 0.005, 24e-3),
        (math.nan, 0.005, 24e-3),
        (math.nan, 0.001, 8e-3),
        (0.0, 0.005, 0.0),
    ],
)
def test_the_delay_limit_is_below_the_critical_delay(critical_delay: float, period: float, late: float) -> None:
    assert delay_limit(critical_delay, period) == pytest.approx(late)


@pytest.mark.parametrize("link", [1e-5, 2e-4, 2e-3])
@pytest.mark.parametrize("own", [2e-4, 0.002, 0.006, 0.011])
def test_a_scene_that_is_just_stable_enough_flies_at_the_measured_delay(own: float, link: float) -> None:
    report = LinkReport(device_delay=own, delay=np.full(64, own + link), answer=np.zeros(64), samples=64, late=0)
    guard = DelayGuard(delay_limit(report.required_delay, 0.005, own=own))
    assert not any(guard.check(delay) for delay in report.delay) and guard.limit <= report.required_delay + 1e-12


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("period", [0.005, 0.001])
def test_reversals_are_counted_in_each_axis(axis: int, period: float) -> None:
    guard, size = PowerGuard(period, HEAVY), 1.0 if axis < 3 else 0.02
    force, said = np.zeros(6), []
    for tick in range(round(0.3 / period)):
        force[axis] = (60.0 if tick % 2 else -60.0) * size
        said.append(guard.check([0.0] * 6, force.tolist()))
    assert "the laws vibrate" in next(filter(None, said)) and not any(said[:3])


def test_a_hard_tap_and_slow_swings_are_not_vibration() -> None:
    for forces in ([0.0, 200.0, -200.0, 0.0], 60.0 * np.sin(2.0 * np.pi * 2.0 * np.arange(0.0, 2.0, 0.005))):
        guard = PowerGuard(0.005, HEAVY)
        assert not any(guard.check([0.0] * 6, [0.0, 0.0, force, 0.0, 0.0, 0.0]) for force in forces)


def test_weak_vibration_is_detected_and_a_ringing_tap_is_not() -> None:
    weak, blow = PowerGuard(0.005, HEAVY), PowerGuard(0.005, HEAVY)
    swings = [5.0 if tick // 2 % 2 else -5.0 for tick in range(150)]
    said = [weak.check([0.0] * 6, [force, 0.0, 0.0, 0.0, 0.0, 0.0]) for force in swings]
    assert "190 N of force reversals capped at 10 N each in 0.2 s, limit 190 N" in next(filter(None, said))
    assert not any(said[:90])
    ringing = [60.0, -60.0, 30.0, -30.0, 10.0, -10.0, 5.0, -5.0, *[0.0] * 92] * 3
    assert not any(blow.check([0.0] * 6, [0.0, 0.0, force, 0.0, 0.0, 0.0]) for force in ringing)


def moved(guard: PowerGuard, force: float, start: float, end: float, period: float) -> list[str]:
    """Return what the guard says of a constant force along a path of 0.1 s."""
    path = np.linspace(start, end, round(0.1 / period) + 1)
    return [guard.check([part, 0, 0, 0, 0, 0], [force, 0, 0, 0, 0, 0]) for part in path]


@pytest.mark.parametrize("period", [0.005, 0.001])
def test_laws_may_give_back_what_a_hand_put_in(period: float) -> None:
    """10 N along 0.7 mm are 7 mJ, and 8 mJ more than was put in exceed the limit."""
    guard = PowerGuard(period, HEAVY)
    assert not any(moved(guard, 10.0, 0.0, 0.0007, period))
    assert "the laws generate energy: 8" in next(filter(None, moved(guard, 10.0, 0.0007, 0.0014, period)))
    spring = PowerGuard(period, HEAVY)
    assert not any(moved(spring, -10.0, 0.0, 0.004, period) + moved(spring, -10.0, 0.004, 0.004, period) * 20)
    assert not any(moved(spring, -10.0, 0.004, -0.0005, period))
    assert any(moved(spring, -10.0, -0.0005, -0.002, period))


@pytest.mark.parametrize("period", [0.005, 0.001])
def test_energy_above_that_of_a_spring_is_forgotten_and_so_is_generated_energy(period: float) -> None:
    """A tap brings 80 mJ and takes them back at once, but not after a second."""
    for pause, said in ((0.0, False), (1.0, True)):
        guard = PowerGuard(period, HEAVY)
        moved(guard, -40.0, 0.0, 0.002, period)
        [guard.check([0.002, 0, 0, 0, 0, 0], [0.0] * 6) for _ in range(round(pause / period))]
        assert any(moved(guard, -40.0, 0.002, 0.0005, period)) is said
    weak = PowerGuard(period, HEAVY)
    for _ in range(20):  # 4 mJ each second
        assert not any(moved(weak, 4.0, 0.0, 0.001, period))
        assert not any(weak.check([0.001, 0, 0, 0, 0, 0], [0.0] * 6) for _ in range(round(1.0 / period)))
        weak.check([0.0] * 6, [0.0] * 6)


@pytest.mark.parametrize(("force", "refused"), [(20.0, False), (22.0, True), (-22.0, True)])
@pytest.mark.parametrize("axis", range(6))
def test_a_force_that_would_generate_too_much_within_a_period_is_refused(
    force: float, refused: bool, axis: int
) -> None:
    """At rest (F T)² / 2 m: 22 N generate 8.6 mJ within 5 ms, 20 N 7.1 mJ."""
    guard, wrench = PowerGuard(0.005), [0.0] * 6
    wrench[axis] = force * math.sqrt(INERTIA[axis] / INERTIA[0])
    assert not PowerGuard(0.005).check([0.004] * 6, [10.0, 0.0, 0.0, 0.0, 0.0, 0.0])  # at its first pose
    assert not guard.check([0.001] * 6, [0.0] * 6)
    assert bool(guard.check([0.001] * 6, wrench)) is refused


def test_a_hand_that_lets_go_of_a_spring_is_not_refused() -> None:
    """20 N on 6000 N/m, pressed slowly: 33 mJ are stored."""
    guard = PowerGuard(0.005)
    for x in [*np.linspace(0.0, 20.0 / 6000.0, 100), *[20.0 / 6000.0] * 400]:
        assert not guard.check([x, 0, 0, 0, 0, 0], [-6000.0 * x, 0, 0, 0, 0, 0])


@pytest.mark.parametrize("drop", [0.3, 0.2])
def test_a_swing_is_cut_after_a_tenth_of_a_second(drop: float) -> None:
    swing, fast = Swing(drop), drop + 0.05
    said = [swing.check([fast * time, 0.0, 0.0], time) for time in np.arange(0.0, 0.2, 0.005)]
    assert not any(said[:20]) and said[22] == pytest.approx(fast)
    slow = Swing(drop)
    assert not any(slow.check([(drop - 0.01) * time, 0.0, 0.0], time) for time in np.arange(0.0, 0.5, 0.005))


@pytest.mark.parametrize("period", [0.005, 0.001])
def test_the_hold_of_an_early_landing_is_stable_up_to_50_ms(period: float) -> None:
    leader = Leader(Calibration.nominal(), period, LANDING_DELAY)
    for delay in np.arange(0.0, min(0.0505, 10 * period), 0.0025):
        assert judge(leader._controller, delay=float(delay)).stable


# flights


def delayed(shape: str, size: float, begin: float, seed: int = 0) -> Any:
    draw = random.Random(seed)
    return lambda time: SHAPES[shape](size, time - begin, draw)


@pytest.mark.parametrize(
    ("name", "rate", "hand", "shape", "size"),
    [
        ("joystick", 200, "5", "step", 0.005),
        *studies(
            ("joystick", 200, "none", "step", 0.010),
            ("box", 200, "8", "jitter", 0.040),
            ("press", 200, "5", "ramp", 0.045),
            ("table", 200, "5", "burst", 0.015),
            ("wall", 1000, "8", "step", 0.060),
        ),
    ],
)
def test_a_slow_link_lands_the_flotor(name: str, rate: int, hand: str, shape: str, size: float, tmp_path: Path) -> None:
    flown = fly(name, rate=rate, hand=hand, delay=delayed(shape, size, 1.6), folder=tmp_path)
    assert "loop delay too long for the scene" in flown.outcome or "WATCHDOG" in flown.outcome
    most = 0.30 if hand == "none" else 0.40
    assert flown.speeds(1.6).max() < most and (flown.speeds(1.6) > 0.30).sum() / rate <= 0.15
    record = load_fault(next(tmp_path.glob("fault-*.maglev")))
    assert "delays above" not in flown.outcome or record.message == flown.outcome
    assert record.time.size == 200 and record.time[-1] > record.time[0]


def test_a_loop_near_its_critical_delay_does_not_keep_ringing_after_a_tap(tmp_path: Path) -> None:
    """Six-axes is stable up to 11.6 ms at 200 Hz; at 11.5 ms a tap reached 0.63 m/s."""
    flown = fly("six-axes", hand="tap", delay=delayed("step", 0.005, 2.4), folder=tmp_path)
    assert "delays above" in flown.outcome
    assert flown.speeds(2.4).max() < 0.45 and (flown.speeds(2.4) > 0.30).sum() / 200 < 0.05


@pytest.mark.study
def test_laws_without_a_computed_margin_are_guarded_too(tmp_path: Path) -> None:
    """Six-axes at 1 kHz: margins are computed up to 10 ms; 15.5 ms is late."""
    delay = delayed("step", 0.007, 1.2)
    flown = fly("six-axes", rate=1000, delay=delay, limits=Limits(stale=0.02), folder=tmp_path, seconds=0.3)
    assert "8 of the last 16" in flown.outcome and flown.speeds(1.2).max() < 0.05


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("size", [5.0, *studies((10.0,), (25.0,))])
def test_a_law_that_chatters_is_landed(size: float, rate: int, tmp_path: Path) -> None:
    law = partial(ChangedLaw, change=lambda tick, own: size if tick % 2 else -size)
    flown = fly("joystick", rate=rate, law=law, folder=tmp_path, seed=11)
    assert "the laws vibrate" in flown.outcome and flown.speeds(0.0).max() < 0.15


@pytest.mark.parametrize(
    ("name", "rate", "hand", "push"),
    [
        ("joystick", 200, "none", 20.0),
        ("joystick", 200, "8", 20.0),
        *studies(*product(["joystick", "corner", "box"], [200, 1000], ["none", "5", "8"], [10.0, 20.0, 30.0])),
    ],
)
def test_a_law_that_pushes_is_landed(name: str, rate: int, hand: str, push: float, tmp_path: Path) -> None:
    """The push is judged before it is sent: by the energy that it would generate within a period."""
    law = partial(ChangedLaw, change=lambda tick, own: push)
    flown = fly(name, rate=rate, hand=hand, law=law, folder=tmp_path, seed=11)
    assert "generate energy" in flown.outcome or push < 20.0
    assert flown.rows[-1, 13] == 0.0 and flown.rows[-1, 14] == 0.0
    assert flown.speeds(flown.began).max() < 0.30


def test_a_push_that_generates_too_much_is_never_sent(tmp_path: Path) -> None:
    flown = fly("joystick", law=partial(ChangedLaw, change=lambda tick, own: 30.0), folder=tmp_path, seed=11)
    assert "generate energy" in flown.outcome
    assert flown.rows[:, 13].max() < 1.5 and flown.speeds(0.0).max() < 0.03


# the hand's force


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize(("name", "hand"), [("drop", "2"), *studies(("joystick", "none"), ("six-axes", "2"))])
def test_the_hands_force_is_estimated(name: str, hand: str, rate: int, tmp_path: Path) -> None:
    flown = fly(name, rate=rate, hand=hand, folder=tmp_path, seconds=1.4)
    steady = (flown.wrenches[:, 0] > 1.7) & (flown.wrenches[:, 0] < 2.4)
    error = flown.wrenches[steady, 1:]
    axis, sense = (2, -1) if name == "drop" else (0, 1 if name == "six-axes" else -1)
    error[:, axis] -= sense * (0.0 if hand == "none" else 2.0)
    assert np.sqrt((error[:, :3] ** 2).mean(axis=0)).max() < 0.03  # [N]
    assert np.sqrt((error[:, 3:] ** 2).mean(axis=0)).max() < 0.5e-3  # [N m]
    known = np.isfinite(flown.wrenches[:, 1])  # while the device is active
    states = np.interp(flown.wrenches[:, 0], flown.rows[:, 0], flown.rows[:, 14])
    assert known.any() and (states[known] > 0.5).all()


# coil check in takeoff


def weakened(coil: int, share: float) -> Calibration:
    known = Calibration.nominal()
    constants = known.coils.force_constants.copy()
    constants[coil] *= share
    return replace(known, coils=replace(known.coils, force_constants=constants))


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize("coil", [5, *studies(*((coil,) for coil in range(5)))])
def test_a_coil_unlike_its_calibration_is_named_in_takeoff(coil: int, rate: int, tmp_path: Path) -> None:
    """10 % weak: landed; dead or reversed: often NOT_FOLLOWING before."""
    for share, seed in ((0.9, coil), (0.01, coil + 6), (-1.0, coil + 12)):
        flown = fly("joystick", rate=rate, truth=weakened(coil, share), seed=seed, folder=tmp_path)
        gain = re.fullmatch(
            r"PlantError: no flight: coil (\d) gives (-?\d+) % of its calibrated force; .*", flown.outcome
        )
        if gain is None:
            assert share != 0.9 and "NOT_FOLLOWING" in flown.outcome and f"coil {coil} " in flown.outcome
        else:
            assert int(gain[1]) == coil and int(gain[2]) == pytest.approx(100.0 * share, abs=2.0)
            assert flown.speeds(0.0).max() < 0.05 and flown.rows[-1, 14] == 0.0


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.parametrize(("seed", "heavier"), [(0, True), *studies(*product(range(1, 5), [False, True]))])
def test_good_coils_are_not_refused(rate: int, seed: int, heavier: bool, tmp_path: Path) -> None:
    """Nor with 35 g on the handle, which look like a common gain of all coils."""
    known = Calibration.nominal()
    truth = replace(known, mass=1.05 * known.mass) if heavier else None
    assert fly("table", rate=rate, seed=seed, truth=truth, seconds=0.1, folder=tmp_path).outcome == "landed"


@pytest.mark.parametrize(("rate", "jitter", "seed"), [(500, 0.45, 2), *studies(*product([1000], [0.15], range(9)))])
def test_good_coils_are_not_refused_over_a_jittery_line(rate: int, jitter: float, seed: int, tmp_path: Path) -> None:
    """0.3 periods each way and exponential jitter: of two answers within a period the device reports one."""
    draw = random.Random(seed)
    line = lambda time: (0.3 + draw.expovariate(1.0 / jitter)) / rate  # noqa: E731
    assert fly("joystick", rate=rate, seed=seed, seconds=0.05, delay=line, folder=tmp_path).outcome == "landed"


def test_a_coil_is_checked_across_lost_samples(tmp_path: Path) -> None:
    lost = lambda time: 9.0 * (0.95 < time < 0.97)  # noqa: E731
    flown = fly("joystick", truth=weakened(3, 0.9), delay=lost, seconds=0.05, folder=tmp_path)
    assert "no flight: coil 3 gives 90 % of its" in flown.outcome


@pytest.mark.parametrize(
    ("rate", "late", "said"),
    [
        (200, 5, r"the sensor is delayed by 5\.0 ms; loop delay limit 2\.\d\d ms"),
        (200, 20, r".*NOT_FOLLOWING: .*; the sensor is delayed by 1\d\.\d ms; .*"),
        *studies((1000, 1, "landed"), (1000, 8, r"the sensor is delayed by 7\.\d ms; loop .*")),
    ],
)
def test_a_sensor_that_is_late_is_found_in_takeoff(rate: int, late: int, said: str, tmp_path: Path) -> None:
    faults = [InjectedFault(kind="late-sensor", which=late, at=0.0)]
    flown = fly("joystick", rate=rate, faults=faults, seconds=0.2, folder=tmp_path)
    assert re.fullmatch(said, flown.outcome) and ("FOLLOWING" in said or flown.speeds(0.0).max() < 0.05)


def test_the_delay_guard_counts_the_sensors_delay(tmp_path: Path) -> None:
    """At 200 Hz six-axes is stable up to 11.6 ms: 5 ms of the sensor and 6 ms of the line are too long."""
    faults = [InjectedFault(kind="late-sensor", which=5, at=0.0)]
    slow = lambda time: 0.002 * (time > 1.3)  # noqa: E731
    flown = fly("six-axes", faults=faults, delay=slow, seconds=0.6, folder=tmp_path)
    assert "delays above" in flown.outcome and flown.ended > 1.3


# delay of the sensor in flight


def test_a_sensor_mirrored_in_flight_ends_it(tmp_path: Path) -> None:
    def prepare(twin: Any, link: Any) -> None:
        read = twin._read
        twin._read = lambda pose: read([-pose[0] if twin.tick > 320 else pose[0], *pose[1:]])

    flown = fly("drop", prepare=prepare, seconds=1.0, folder=tmp_path)
    assert "NOT_FOLLOWING: the measured pose moves against the commanded force" in flown.outcome
    active = flown.rows[flown.rows[:, 14] == 1.0]
    assert np.linalg.norm(active[:, 7:10], axis=1).max() < 0.15


def delayed_sensor(samples: int, since: float = 1.6) -> Any:
    """Return a `prepare` of `fly`: the spots are some samples old from a time on [s], under new stamps."""

    def prepare(twin: Any, link: Any) -> None:
        read, kept = twin._read, deque[Any](maxlen=samples + 1)

        def delayed(position: Any) -> Any:
            kept.append(read(position))
            return kept[0 if twin.tick * 0.005 > since else -1]

        twin._read = delayed

    return prepare


@pytest.mark.parametrize(
    ("name", "hand", "late"),
    [
        ("joystick", "5", 1),
        ("drop", "8", 4),
        *studies(*product(["corner", "press"], ["5", "8"], [1, 2, 4]), ("joystick", "5", 4)),
    ],
)
def test_a_sensor_delayed_in_flight_ends_it(name: str, hand: str, late: int, tmp_path: Path) -> None:
    flown = fly(name, hand=hand, prepare=delayed_sensor(late), folder=tmp_path)
    message = re.search(r"HOST: the sensor is delayed by ([\d.]+) ms; loop delay limit", flown.outcome)
    assert message is not None
    assert float(message[1]) == pytest.approx(5.0 * late, abs=2.5, rel=0.25)
    active = flown.rows[flown.rows[:, 14] == 1.0]
    assert np.linalg.norm(active[:, 7:10], axis=1).max() < 0.30 and flown.speeds(1.6).max() < 0.33


@pytest.mark.parametrize("hand", ["none", *studies(("8",))])
def test_a_sensor_whose_delay_shows_in_the_landing_only_lands_softly(hand: str, tmp_path: Path) -> None:
    """The usual hold is unstable at 20 ms: it reached 0.86 m/s."""
    flown = fly("joystick", hand=hand, prepare=delayed_sensor(4), folder=tmp_path)
    assert flown.outcome == "landed" and flown.speeds(1.6).max() < 0.15


# coils in flight


def failing_coil(coil: int, gain: float, rate: int) -> Any:
    """Return a `prepare` of `fly`: a coil's force is multiplied by a gain from 1.6 s on, while its meter reads well."""

    def prepare(twin: Any, link: Any) -> None:
        take, failed = twin.sample, list[bool]()

        def sample() -> Any:
            if not failed and twin.tick >= 1.6 * rate:
                failed.append(True)
                twin.plant._model.actuator_gainprm[coil, 0] *= gain
            return take()

        twin.sample = sample

    return prepare


@pytest.mark.parametrize(
    ("name", "hand", "coil", "gain", "rate"),
    [
        ("drop", "none", 0, -1.0, 200),
        *studies(*product(["drop", "corner"], ["none", "5"], [1, 2], [0.0, -1.0], [200])),
        *studies(*product(["drop"], ["none", "5"], [1, 2], [0.0], [1000])),
    ],
)
def test_a_coil_that_fails_in_flight_ends_it(
    name: str, hand: str, coil: int, gain: float, rate: int, tmp_path: Path
) -> None:
    flown = fly(name, hand=hand, rate=rate, seconds=1.0, prepare=failing_coil(coil, gain, rate), folder=tmp_path)
    assert f"HOST: coil {coil} gives " in flown.outcome
    active = flown.rows[flown.rows[:, 14] == 1.0]
    assert np.linalg.norm(active[:, 7:10], axis=1).max() < 0.30


@pytest.mark.study
def test_good_flights_show_no_delay_of_the_sensor_and_no_failing_coil(tmp_path: Path) -> None:
    for seed, (name, hand) in enumerate(product(FLOWN, ("none", "8", "20", "tap"))):
        draw = random.Random(seed)
        line = lambda time: 3e-4 + draw.expovariate(1.0 / 1.5e-4)  # noqa: E731, B023
        flown = fly(name, hand=hand, seed=seed, delay=line, critical_delay=0.02, folder=tmp_path)
        thrown = hand == "tap" and "FLOTOR_OVERSPEED" in flown.outcome  # by the tap alone
        assert flown.outcome == "landed" or thrown


def test_lost_frames_are_not_mistaken_for_a_coil_fault(tmp_path: Path) -> None:
    calibration = Calibration.nominal()
    observer = HandObserver(calibration, 0.005, 0.0015)
    observer.check_coils = True
    hover = Command([*(-calibration.mass * calibration.gravity), 0.0, 0.0, 0.0])
    for tick in [*range(40), *range(50, 90)]:
        observer.sampled(tick, 11 if tick == 50 else 1, [0.0] * 6, tick - 1, 0.0015)
        observer.answered(tick, hover, calibration.hover.tolist(), None, 0.0)
        if tick in (49, 89):
            assert observer.wrench == pytest.approx([0.0] * 6, abs=1e-9)
    assert observer.coils.fault() == ""


def test_a_gap_in_the_samples_is_not_an_acceleration() -> None:
    calibration = Calibration.nominal()
    observer = HandObserver(calibration, 0.005, 0.0015)
    hover = Command([*(-calibration.mass * calibration.gravity), 0.0, 0.0, 0.0])
    for tick in [*range(20), *range(25, 45)]:
        observer.sampled(tick, 6 if tick == 25 else 1, [1e-3 * tick] * 6, tick - 1, 0.0015)
        observer.answered(tick, hover, calibration.hover.tolist(), None, 0.0)
        assert tick < 19 or not observer.residual._sums.any()
