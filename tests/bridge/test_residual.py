"""Residual of a flight: what is suspected, what is probed, and what is named."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from maglev_mj.bridge import residual as module
from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.residual import Evidence, Residual, follows, verdict
from maglev_mj.frames import ZERO
from tests.bridge.devices import DEVICES

CALIBRATION = Calibration.nominal()
PER_CURRENT = CALIBRATION.coils.wrench_per_current
POSE = np.array(CALIBRATION.wall_maps.pose_per_spot)
NONE: Sequence[float] = (0.0,) * 6


def flown(
    period: float,
    *,
    gains: Sequence[float] = (1.0,) * 6,
    delay: float = 0.0,
    sign: Any = None,
    mass: float = 1.0,
    hand: Callable[[float], Any] = lambda time: 0.0,
    forced: bool = False,
    seconds: float = 0.8,
    seed: int = 1,
    calibration: Calibration = CALIBRATION,
    lost: Sequence[int] = (),
) -> Residual:
    """Return the residual after a flight of a free flotor on a spring and a damper; the fault begins after 0.2 s.

    Args:
        period: Sample period [s].
        gains: Gains of the coils.
        delay: Delay of the sensor, a multiple of 0.5 ms [s].
        sign: Matrix from true to measured pose, (6, 6).
        mass: Mass and inertia, relative.
        hand: Wrench of the hand at a time.
        forced: True to probe all the time.
        seconds: Duration [s]; it ends with a name.
        seed: Seed of signs and noise.
        calibration: Calibration of the device.
        lost: Ticks without a pose.
    """
    residual, draw = Residual(calibration, period, seed=seed), np.random.default_rng(seed)
    residual.watching = True
    per, body = calibration.coils.wrench_per_current, calibration.body
    to_currents, weight = np.linalg.inv(per), -body.load
    stiffness, damping = 4000.0 * body.inertia / 0.7, 60.0 * body.inertia / 0.7
    part, noise = 0.0005, calibration.device.scale.noise / 6.0
    count = round(period / part)
    x, v, path, last, still = np.zeros(6), np.zeros(6), [np.zeros(6)] * 60, np.zeros(6), NONE
    held, probe = to_currents @ weight, np.zeros(6)
    for tick in range(round(seconds / period)):
        time = tick * period
        failed = time >= 0.2
        pose = path[-1 - round(delay / part) * failed] + noise * draw.standard_normal(6)
        pose = sign @ pose if sign is not None and failed else pose
        if tick:
            wrench, added = per @ held, per @ probe
            sums = [((period * w).tolist(), (0.5 * period**2 * w).tolist()) for w in (wrench, added)]
            residual.add([math.nan] * 6 if tick in lost else pose.tolist(), sums[0], sums[1])
        if residual.delay or residual.coil or residual.reversed:
            break
        if forced and residual._signs is None:
            residual._begin()
        command = weight - stiffness * pose - damping * (pose - last) / period
        last, still = pose, still
        currents = residual.currents()
        probe = np.zeros(6) if currents is None else np.array(currents)
        held = to_currents @ command + probe
        true = per @ (held * (np.array(gains) if failed else 1.0))
        for step in range(count):
            push = np.asarray(hand(time + step * part)) + true
            rate = (push + body.load * (mass if failed else 1.0)) / (body.inertia * (mass if failed else 1.0))
            x, v = x + part * v + 0.5 * part**2 * rate, v + part * rate
            path.append(x)
    return residual


def named(residual: Residual) -> str:
    """Return the kind of the cause that was named, "" without."""
    return "delay" if residual.delay else residual.coil[:6] if residual.coil else "reversed" * residual.reversed


def shaken(size: float, hertz: float, seed: int = 0) -> Callable[[float], Any]:
    """Return a hand that trembles on all axes [N], with phases drawn at random."""
    draw = random.Random(seed)
    phases, lever = [draw.uniform(0.0, 6.3) for _ in range(6)], [1.0, 1.0, 1.0, 0.03, 0.03, 0.03]
    return lambda time: np.array(
        [size * r * math.sin(2.0 * math.pi * hertz * time + phase) for r, phase in zip(lever, phases)]
    )


def one(axis: int) -> Any:
    return np.diag([1.0 - 2.0 * (k == axis) for k in range(6)])


@pytest.mark.parametrize("period", [0.005, 0.0025, 0.001])
@pytest.mark.parametrize("coil", range(6))
@pytest.mark.parametrize("gain", [0.0, -1.0])
def test_a_coil_that_fails_is_named(period: float, coil: int, gain: float) -> None:
    found = flown(period, gains=[gain if k == coil else 1.0 for k in range(6)], hand=shaken(0.5, 3.0))
    assert named(found) == f"coil {coil}"
    assert float(found.coil.split()[3]) == pytest.approx(100.0 * gain, abs=35.0)


@pytest.mark.parametrize("period", [0.005, 0.001])
@pytest.mark.parametrize("delay", [0.003, 0.005, 0.0075, 0.01, 0.02])
def test_a_delay_is_named(period: float, delay: float) -> None:
    found = flown(period, delay=delay, hand=shaken(2.0, 9.0))
    assert named(found) == "delay" and found.delay == pytest.approx(delay, abs=0.5 * delay)


@pytest.mark.parametrize("period", [0.005, 0.001])
@pytest.mark.parametrize("spots", [(), (0,), (1,), (1, 5), (0, 2, 4)])
def test_a_reversed_pose_is_named(period: float, spots: tuple[int, ...]) -> None:
    flip = np.eye(6)
    flip[list(spots), list(spots)] = -1.0
    sign = POSE @ flip @ np.linalg.inv(POSE) if spots else one(2)
    assert named(flown(period, sign=sign, hand=shaken(0.3, 3.0))) == "reversed"


@pytest.mark.parametrize("period", [0.005, 0.001])
@pytest.mark.parametrize("mass", [0.7, 1.4])
def test_another_mass_is_not_named(period: float, mass: float) -> None:
    found = flown(period, mass=mass, hand=shaken(2.0, 9.0))
    assert not named(found) and set(found.outcomes) <= {"mass", "inertia", "as calibrated", "inconclusive"}


@pytest.mark.parametrize("period", [0.005, 0.001])
@pytest.mark.parametrize(("size", "hertz"), [(0.0, 1.0), (1.0, 5.0), (2.0, 8.0), (4.0, 12.0), (20.0, 2.0)])
@pytest.mark.parametrize("forced", [False, True])
def test_no_hand_is_named(period: float, size: float, hertz: float, forced: bool) -> None:
    found = flown(period, hand=shaken(size, hertz, seed=3), forced=forced)
    assert not named(found) and (not forced or found.outcomes["as calibrated"] + found.outcomes["inconclusive"] > 2)


def test_a_probe_moves_an_untouched_flotor_by_less_than_0_1_mm() -> None:
    for calibration in (CALIBRATION, Calibration.of(DEVICES["light"])):
        residual, x, v, most = Residual(calibration, 0.005), np.zeros(6), np.zeros(6), 0.0
        residual.watching = True
        residual._begin()
        for _ in range(33):
            currents = np.array(residual.currents() or NONE)
            assert (np.abs(currents) <= residual.amplitudes + 1e-12).all()
            rate = calibration.coils.wrench_per_current @ currents / calibration.body.inertia
            x, v = x + 0.005 * v + 0.5 * 0.005**2 * rate, v + 0.005 * rate
            residual.add([math.nan] * 6, (NONE, NONE), (NONE, NONE))
            most = max(most, float(np.abs(x[:3]).max()))
        assert 1e-5 < most < 1e-4 and np.abs(v).max() < 1e-12  # neither speed nor path is left


@pytest.mark.parametrize("name", DEVICES)
def test_two_blocks_of_a_probe_move_every_axis(name: str) -> None:
    calibration = Calibration.of(DEVICES[name])
    residual = Residual(calibration, 0.005)
    per = calibration.coils.wrench_per_current * residual._unit[:, None]
    sizes = [float(((pair * residual.amplitudes @ per.T) ** 2).sum(axis=0).min()) for pair in residual._pairs]
    assert len(sizes) >= 64 and min(sizes) >= 0.5 * max(sizes) > 0.0
    # no sign is preferred
    assert np.abs(np.mean(residual._pairs, axis=(0, 1))).max() < 1e-12


def test_lost_samples_are_not_judged() -> None:
    found = flown(0.005, hand=shaken(2.0, 9.0), lost=range(50, 150, 3))
    assert not named(found) and not found._sums.any()


def test_nothing_is_probed_in_takeoff() -> None:
    residual = Residual(CALIBRATION, 0.005)
    residual._begin()
    assert residual.currents() is None  # not watching
    residual.add(list(ZERO), (ZERO, ZERO), (ZERO, ZERO))
    residual.add(list(ZERO), (ZERO, ZERO), (ZERO, ZERO))
    assert residual._signs is None


# thresholds, each from both sides: 10 % less and 10 % more

CLEAR = Evidence("delay", 0, 1.0, 0.05, 0.9, 0.05, 0.0, 20.0, False, True)
EVIDENCE: list[tuple[str, dict[str, Any], int, str]] = [
    ("share left by a named cause", dict(left=0.36), 4, "delay"),
    ("share left by a named cause", dict(left=0.44), 4, ""),
    ("share left by a coil at a stop", dict(kind="coil", clear=False, left=0.09), 4, "coil"),
    ("share left by a coil at a stop", dict(kind="coil", clear=False, left=0.11), 4, ""),
    ("share left by a reversed pose at a stop", dict(kind="reversed", clear=False, left=0.11), 4, ""),
    ("share left by a delay at a stop", dict(clear=False, left=0.11), 4, "delay"),
    ("share left by every fault", dict(left=0.9, faults=1.65), 4, "as calibrated"),
    ("share left by every fault", dict(left=0.9, faults=1.35), 4, ""),
    ("error of the mass", dict(left=0.9, faults=2.0, scale=0.18), 4, "as calibrated"),
    ("error of the mass", dict(left=0.9, faults=2.0, scale=0.22), 4, ""),
    ("distance", dict(left=0.3, other=1.44 * 0.3 + 0.01), 4, "delay"),
    ("distance", dict(left=0.3, other=1.36 * 0.3 + 0.01), 4, ""),
    ("distance of a name that cuts", dict(kind="reversed", left=0.3, other=1.88 * 0.3 + 0.01), 4, "reversed"),
    ("distance of a name that cuts", dict(kind="reversed", left=0.3, other=1.72 * 0.3 + 0.01), 4, ""),
    ("standard errors", dict(t=6.6), 4, "delay"),
    ("standard errors", dict(t=5.4), 4, ""),
    ("steps of a loud hand", dict(loud=True), 8, "delay"),
    ("steps of a loud hand", dict(loud=True), 7, ""),
]


@pytest.mark.parametrize(("what", "changes", "steps", "said"), EVIDENCE)
def test_a_verdict_turns_at_its_thresholds(what: str, changes: dict[str, Any], steps: int, said: str) -> None:
    assert verdict(CLEAR._replace(**changes), steps) == said


SIZES = np.full(6, 4.5)


def coil_case(**changes: float) -> tuple[Any, Any, int]:
    """Return what a coil 0 misses and carries, each step; it fails four steps before the end."""
    case = {"loss": 1.0, "others": 0.0, "slope": 0.0, "rise": 1.0, "swing": 0.5, "noise": 0.0, "steps": 3.0} | changes
    currents = 1.5 + case["swing"] * np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0, -0.3, 0.3, 1.0])
    fails = np.array([0.0] * 5 + [case["rise"]] + [1.0] * 4)
    missing = np.zeros((10, 6))
    missing[:, 0] = -fails * (case["loss"] * currents + case["slope"] * (currents - 1.5))
    size = math.sqrt(float((missing[-4:, 0] ** 2).sum()) / 4.0)
    missing[-4:, 1] = size * math.sqrt(case["others"])
    return missing, currents, round(case["steps"])


FOLLOWED: list[tuple[str, dict[str, float], bool]] = [
    ("dead", {}, True),
    ("reversed", {"loss": 2.0}, True),
    ("loss", {"loss": 1.13}, True),
    ("loss", {"loss": 1.17}, False),
    ("loss of a reversed coil", {"loss": 1.87}, True),
    ("loss of a reversed coil", {"loss": 1.83}, False),
    ("other coils", {"others": 0.009}, True),
    ("other coils", {"others": 0.0115}, False),
    ("slope", {"slope": 0.27, "swing": 0.3}, True),
    ("slope", {"slope": 0.34, "swing": 0.3}, False),
    ("tolerance of the loss in the second step", {"steps": 1.0, "loss": 1.045}, True),
    ("tolerance of the loss in the second step", {"steps": 1.0, "loss": 1.056}, False),
    ("tolerance of the loss in the third step", {"steps": 2.0, "loss": 1.056}, True),
    ("tolerance of the loss in the first step", {"steps": 0.0, "loss": 1.045}, True),
    ("tolerance of the loss in the first step", {"steps": 0.0, "loss": 1.056}, False),
    ("tolerance of the slope in the first step", {"steps": 0.0, "slope": 0.09, "swing": 0.1}, True),
    ("tolerance of the slope in the first step", {"steps": 0.0, "slope": 0.112, "swing": 0.1}, False),
]


@pytest.mark.parametrize(("what", "changes", "named"), FOLLOWED)
def test_a_missing_force_follows_the_current_of_its_coil(what: str, changes: dict[str, float], named: bool) -> None:
    missing, currents, steps = coil_case(**changes)
    assert bool(follows(missing, currents, 0, steps, SIZES, 0.01)) == named


@pytest.mark.parametrize(("share", "named"), [(4.5, False), (5.5, True)])
def test_a_slope_is_certain_from_five_standard_errors_on(share: float, named: bool) -> None:
    missing, currents, steps = coil_case()
    flowing = currents[-4:]
    noise = math.sqrt(float(((flowing - flowing.mean()) ** 2).sum())) * SIZES[0] / share
    assert bool(follows(missing, currents, 0, steps, SIZES, noise)) == named


def test_a_force_that_rises_slowly_is_no_coil() -> None:
    for partial, named in ((1, True), (2, False)):
        missing, currents, steps = coil_case()
        for step in range(partial):
            missing[5 - step, 0] = -0.5 * currents[5]
        assert bool(follows(missing, currents, 0, steps, SIZES, 0.01)) == named
    for share in (0.13, 0.17):  # of the full loss, what counts as partial
        missing, currents, steps = coil_case(rise=1.0 - share)
        missing[4, 0] = -share * currents[4]
        assert bool(follows(missing, currents, 0, steps, SIZES, 0.0)) == (share < 0.15)


def moved(changes: Sequence[float]) -> Residual:
    """Return a residual with accelerations along x that changed by these amounts, as if nothing had been driven."""
    residual = Residual(CALIBRATION, 0.005)
    residual.watching = True
    residual._rows[:] = 0.0
    for rate in np.cumsum([0.0, *changes]).tolist():
        residual._rows[:-1] = residual._rows[1:]
        residual._rows[-1] = 0.0
        residual._rows[-1, 0, 0] = rate
        residual._suspects(False)
    return residual


def test_sums_of_a_suspicion_fade_and_a_change_is_bounded() -> None:
    probe = CALIBRATION.device.scale.probe
    square = float(moved([0.1 * probe])._sums[0])
    assert square == pytest.approx(0.01 * probe**2)
    faded = float(moved([0.1 * probe] + [0.0] * 12)._sums[0])  # 60 ms later
    assert square * math.exp(-1.0) * 0.9 < faded < square * math.exp(-1.0) * 1.1
    assert 36.0 * probe**2 < float(moved([100.0 * probe])._sums[0]) < 44.0 * probe**2


@pytest.mark.parametrize(("share", "suspected"), [(0.9, False), (1.1, True)])
def test_a_suspicion_needs_changes_and_a_cause(share: float, suspected: bool) -> None:
    probe = CALIBRATION.device.scale.probe
    for quantity in ("sum", "share", "near"):
        residual = moved([])
        rows = residual._rows
        rows[-1, 0, 0], rows[-1, 1, 0] = 0.5, -0.5  # reversed: the square without a cause is 1, with it 0
        residual._excited = 1.0 / share if quantity == "sum" else 0.1
        if quantity == "sum":
            assert residual._excited != module._LEAST_CHANGES * probe**2
            assert residual._suspects(False) == suspected
        elif quantity == "share":
            residual._sums[:] = 0.0
            rows[-1, 0, 1] = math.sqrt(0.45 / (share - 0.45))  # another motion, which leaves 0.45 / share
            assert residual._suspects(False) == suspected
        else:
            assert residual._suspects(False) and not residual._suspects(True)
    assert Residual(CALIBRATION, 0.005)._excited == pytest.approx(2.0 * probe**2)


@pytest.mark.parametrize(("share", "suspected"), [(0.9, True), (1.1, False)])
@pytest.mark.parametrize("loss", [1.0, 2.0])
def test_a_coil_is_suspected_alone(share: float, suspected: bool, loss: float) -> None:
    for quantity in ("loss", "others"):
        residual = Residual(CALIBRATION, 0.005)
        to_rows = np.linalg.inv(residual._to_coils)
        currents, missing = np.full((7, 6), 1.2), np.zeros((7, 6))
        missing[-2:, 2] = -(loss - 0.35 * share if quantity == "loss" else loss) * 1.2
        if quantity == "others":
            missing[-2:, 4] = math.sqrt(0.15 * share / (1.0 - 0.15 * share)) * missing[-2:, 2]
        residual._rows[-7:, 1] = currents @ to_rows.T
        residual._rows[-7:, 0] = (currents + missing) @ to_rows.T
        residual._suspects_coil()
        assert (residual._coil is not None) == suspected


def ended(residual: Residual, kind: str, time: float) -> float:
    """Return the pause after a probe that ends with an outcome at a time [s]."""
    residual._tick = round(time / 0.005)
    residual._end(kind)
    return residual._wait


def test_probes_are_repeated_four_times_and_pause() -> None:
    residual = Residual(CALIBRATION, 0.005)
    waits = [ended(residual, "inconclusive", 0.2 * k) for k in range(5)]
    assert waits == [0.0, 0.0, 0.0, pytest.approx(0.5), 0.0]
    residual = Residual(CALIBRATION, 0.005)
    assert [ended(residual, "as calibrated", time) for time in (0.0, 0.5, 0.9, 1.45, 2.0)] == [
        0.0, 0.0, pytest.approx(0.5), pytest.approx(0.5), 0.0,
    ]  # fmt: skip
    assert ended(residual, "mass", 3.0) == pytest.approx(0.5)


def test_the_numbers_of_a_probe() -> None:
    """A block of 20 ms, 160 ms in total, judged from the third step to the tenth last."""
    residual = Residual(CALIBRATION, 0.005)
    residual._begin()
    assert residual._signs is not None and residual._signs.shape == (32, 6)
    assert np.abs(residual._signs.reshape(8, 4, 6).sum(axis=1)).max() < 1e-12
    assert (module._LEAST_STEPS_JUDGED, module._MOST_STEPS_JUDGED, module._LONGEST_DELAY) == (3, 10, 5)
    assert module._MOST_STEPS_FOLLOWED == 8
    assert residual.amplitudes == pytest.approx(0.4 / residual._sizes)
    weak = Residual(Calibration.of(DEVICES["ubc"].change("coils", current_limit=0.2, continuous_current=0.2)), 0.005)
    assert weak.amplitudes == pytest.approx([0.05] * 6)  # a quarter of the limit


@pytest.mark.parametrize(("share", "clear"), [(0.9, True), (1.0, False)])
def test_a_stop_may_be_touched_from_the_edge_of_the_range(share: float, clear: bool) -> None:
    residual = Residual(CALIBRATION, 0.005)
    for _ in range(3):
        residual.add(
            [0.5 * share * part * (k in (0, 4)) for k, part in enumerate(residual._range)], (ZERO, ZERO), (ZERO, ZERO)
        )
    assert residual._clear[-1] == clear


@pytest.mark.parametrize(("share", "near"), [(0.8, False), (0.85, False), (0.92, True), (1.05, True)])
def test_a_swing_near_the_end_of_the_range_raises_no_suspicion(share: float, near: bool) -> None:
    residual, seen = Residual(CALIBRATION, 0.005), list[bool]()
    residual._suspects = lambda near: seen.append(near) or False  # type: ignore[func-returns-value, method-assign]
    residual.watching = True
    for _ in range(3):
        residual.add([share * part * (k == 1) for k, part in enumerate(residual._range)], (ZERO, ZERO), (ZERO, ZERO))
    assert seen[-1] == near


@pytest.mark.parametrize(("period", "stride"), [(0.02, 1), (0.005, 1), (0.0025, 2), (0.001, 5), (0.0005, 10)])
def test_a_step_takes_5_ms(period: float, stride: int) -> None:
    residual = Residual(CALIBRATION, period)
    assert residual._stride == stride and residual._parts * max(stride - 1, 1) >= 3  # judged before the next step


def test_a_probe_of_two_blocks_covers_half_of_the_best() -> None:
    counts = []
    for least in (0.4, 0.5, 0.6):
        per = CALIBRATION.coils.wrench_per_current * Residual(CALIBRATION, 0.005)._unit[:, None]
        signs = 1.0 - 2.0 * (np.arange(64)[:, None] >> np.arange(6) & 1)
        moved = (signs * Residual(CALIBRATION, 0.005).amplitudes @ per.T) ** 2
        covered = (moved[:, None] + moved).min(axis=2)
        counts.append(int((covered >= least * covered.max()).sum()))
    assert len(Residual(CALIBRATION, 0.005)._pairs) == counts[1]
    assert counts[0] >= counts[1] >= counts[2]
