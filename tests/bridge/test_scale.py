"""Thresholds that follow from a device's file: of legal devices, of the published joystick, and where they are used."""

from __future__ import annotations

import math
import re
from dataclasses import asdict, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj import HostLimits, RemotePlant, Sample, Twin, TwinParameters, find_scene
from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.flight import Flight
from maglev_mj.bridge.flight_guards import PowerGuard
from maglev_mj.bridge.landing import Leader, RecentMotion, Swing, straight
from maglev_mj.bridge.observer import CoilEstimator
from maglev_mj.bridge.residual import Residual
from maglev_mj.bridge.safety import FlotorGuard
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.bridge.wire import Fault
from maglev_mj.device import Device, published_device
from maglev_mj.errors import ModelError
from maglev_mj.scale import Scale
from maglev_mj.spec import GRAVITY, RANGE
from tests.bridge.devices import DEVICES, LIGHT, STAGE

DOCS = Path(__file__).parents[2] / "docs"
SIGNS = np.array(list(product((1.0, -1.0), repeat=6))).T

PUBLISHED: dict[str, float] = {
    **{"off": 0.25, "least": 0.15, "probe": 0.4, "drop": 0.3, "speed": 0.6, "spin": 15.0, "envelope": 5.5e-3},
    **{"tilt": math.radians(7.5), "stored": 0.045, "generated": 0.008, "wall_energy": 0.004},
    **{"reversals": 380.0, "capped": 190.0, "cap": 10.0, "recede": 0.03, "edge": 0.1, "lever": 0.03},
    **{"stiffness": 1e5, "damping": 400.0, "rest": 5e-3, "rest_spin": 0.1, "lifted": 4e-4, "noise": 3e-6},
    **{"path": 2e-3, "path_angle": math.radians(3.0)},
}
"""Thresholds of the published joystick, in SI units."""


def drawn(seed: int) -> Device:
    """Return a random legal device."""
    draw = np.random.default_rng(seed)

    def between(low: float, high: float, count: int) -> list[float]:
        drawn: list[float] = np.exp(draw.uniform(math.log(low), math.log(high), count)).tolist()
        return drawn

    mass, radius = *between(0.02, 10.0, 1), *between(0.01, 0.1, 1)
    inertia = [mass * radius**2 * part for part in between(0.5, 2.0, 3)]
    fall = draw.standard_normal(3)
    gravity = draw.choice([0.0, 1.62, GRAVITY]) * fall / np.linalg.norm(fall)
    directions = np.array(STAGE.coils.directions) + 0.2 * draw.standard_normal((6, 3))  # type: ignore[union-attr]
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    ends = [[*between(*most, 3)] for most in ((5e-4, 2e-2), (1.0, 30.0))]
    move, turn = (np.where(draw.random(3) < 0.2, math.inf, part).tolist() for part in ends)
    steps, noise = ([*between(1e-8, 2e-5, 3), *between(1e-7, 1e-3, 3)] for _ in range(2))
    device = STAGE.change("body", mass=mass, inertia=inertia, gravity=gravity.tolist())
    device = device.change("range", translation=move, rotation_deg=turn)
    blank = [0.0] * 6
    device = device.change(
        "sensor", resolution=steps if draw.random() < 0.7 else blank, noise=noise if draw.random() < 0.7 else blank
    )
    current, constants = *between(0.3, 20.0, 1), between(0.3, 30.0, 6)
    coils = {"force_constants": constants, "current_limit": current, "continuous_current": 0.5 * current}
    try:
        return device.change("coils", directions=directions.tolist(), **coils)
    except ModelError:  # coils that cannot give every wrench
        return device.change("coils", **coils)


RANDOM = [drawn(seed) for seed in range(200)]


@pytest.mark.parametrize("name", [*DEVICES, "random"])
def test_the_thresholds_of_any_device_are_sane(name: str) -> None:
    for device in RANDOM if name == "random" else [DEVICES[name]]:
        scale, sizes = device.scale, asdict(device.scale)
        assert all(math.isfinite(value) and value > 0.0 for value in sizes.values()), sizes
        gravity = np.array(device.body.gravity)
        weight = float(np.linalg.norm(gravity))
        up = gravity / weight if weight else np.array([0.0, 0.0, 1.0])
        assert device.coils is not None
        lift = up @ device.coils.wrench_per_current(device.body.centre_of_mass)[:3] @ (scale.off * SIGNS)
        assert np.abs(lift).max() < 0.25 * device.mass * (weight or GRAVITY)
        reach = np.where(np.isfinite(device.reach), device.reach, RANGE)
        assert 0.0 < scale.envelope - reach[:3].max() < 2e-3 * scale.speed
        assert 0.0 < scale.tilt - reach[3:].max() < 2e-3 * scale.spin
        assert scale.path < reach[:3].min() and scale.path_angle < reach[3:].min()
        assert scale.rest < 0.1 * scale.drop and scale.rest_spin < 0.1 * scale.drop / (scale.lever / 1.3)
        assert scale.rest < 0.1 * scale.drop < 2.0 * scale.drop <= scale.speed * (1.0 + 1e-12)
        assert scale.drop <= 1.01 * math.sqrt(2.0 * (weight or GRAVITY) * reach[:3].max() * math.sqrt(3.0))
        assert scale.generated < 0.51 * device.mass * (0.51 * scale.drop) ** 2
        assert scale.cap < scale.capped < scale.reversals


def test_a_takeoff_is_slower_than_half_the_speed_limit_on_any_device() -> None:
    for device in RANDOM:
        rise = float(device.rest[2] and np.linalg.norm(device.rest[:3]))
        assert 1.875 * rise / 0.6 < 0.5 * device.scale.speed  # peak of a minimum-jerk path of 0.6 s


def test_the_published_joystick_keeps_its_numbers() -> None:
    assert asdict(published_device().scale) == PUBLISHED
    limits = HostLimits()
    own = limits.envelope, limits.envelope_angle, limits.speed_limit, limits.spin_limit
    assert own == (5.5e-3, math.radians(7.5), 0.6, 15.0)
    assert limits == limits.scaled(published_device().scale)


def test_a_light_device_is_off_below_its_hover_current() -> None:
    hover = np.abs(Calibration.of(LIGHT).hover).max()
    assert LIGHT.scale.off < 0.25 * hover < 0.03
    blind = LIGHT.change("sensor", resolution=(1e-4,) * 6)
    assert blind.scale.least == pytest.approx(0.15 / 0.25 * LIGHT.scale.off * 1e-4 / 5e-6, rel=1e-3)


# where they are used


@pytest.mark.parametrize("name", DEVICES)
def test_limits_of_the_host_are_the_devices_own_unless_set(name: str) -> None:
    device, scale = DEVICES[name], DEVICES[name].scale
    plant = remote(device)
    assert plant.scale == scale
    own = HostLimits().scaled(scale)
    assert (own.envelope, own.envelope_angle) == (scale.envelope, scale.tilt)
    assert (own.speed_limit, own.spin_limit) == (scale.speed, scale.spin)
    assert HostLimits(speed_limit=0.1, envelope=0.003).scaled(scale) == own.replace(speed_limit=0.1, envelope=0.003)
    guards: list[Any] = [part.args[0] for _, part in plant.guards if isinstance(part, partial)]
    (guard,) = (part for part in guards if isinstance(part, FlotorGuard))
    for axis, far in ((0, scale.envelope), (4, scale.tilt)):
        for guided in (True, False):
            crossed(guard, axis, far, guided=guided)
    for axis, fast in ((0, scale.speed), (4, scale.spin)):
        for share in (0.99, 1.01):
            guard._last = None
            step = share * fast * 1e-3
            said = [guard.check([part * (k == axis) for k in range(6)], 1e-3) for part in (0.0, step)]
            assert said == [Fault(0), Fault(0) if share < 1.0 else Fault.FLOTOR_OVERSPEED]


def crossed(guard: FlotorGuard, axis: int, far: float, *, guided: bool = False) -> None:
    """Check that a guard's envelope is at `far`, to 1 %."""
    for share, fault in ((0.99, Fault(0)), (1.01, Fault.BOUNDARY)):
        assert guard.check([share * far * (k == axis) for k in range(6)], 0.0, guided) == fault


def test_a_stage_of_2_mm_is_guided_within_its_own_envelope() -> None:
    scale = STAGE.scale
    assert scale.envelope == pytest.approx(3.018e-3, rel=1e-3)
    for chosen, guided in ((None, scale.envelope), (1e-3, scale.envelope), (4e-3, 4e-3)):
        limits = HostLimits().scaled(scale) if chosen is None else HostLimits(envelope=chosen).scaled(scale)
        guard = FlotorGuard(limits, scale)
        crossed(guard, 2, guided, guided=True)
        crossed(guard, 2, chosen or guided)


def remote(device: Device) -> RemotePlant:
    """Return a device's twin, connected."""
    return connected(Calibration.of(device))


def connected(known: Calibration) -> RemotePlant:
    """Return the twin of a calibrated device, connected."""
    return RemotePlant(VirtualLink(Twin(TwinParameters(calibration=known, lockstep=True))), calibration=known)


@pytest.mark.parametrize("name", DEVICES)
def test_the_power_guard_of_a_flight_has_the_devices_limits(name: str) -> None:
    plant, scale = remote(DEVICES[name]), DEVICES[name].scale
    flight = Flight(plant, find_scene("joystick")().replace(period=plant.period))
    assert flight._power_guard._limits == (scale.reversals, scale.capped, scale.stored, -scale.generated)


def test_takeoff_and_landing_have_the_numbers_of_the_measured_device(monkeypatch: pytest.MonkeyPatch) -> None:
    known = replace(Calibration.of(STAGE), mass=0.35)
    plant, scale = connected(known), known.device.scale
    assert plant.scale == scale != STAGE.scale
    assert plant._observed(0.0)._slow == plant._leader.motion._slow == (scale.rest, scale.rest_spin)
    assert plant._hand.coils._scale == plant._leader._scale == scale
    assert plant._hand.residual._least == scale.least
    assert plant._hand.residual.amplitudes == pytest.approx(scale.probe / plant._hand.residual._sizes)
    drops: list[float] = []

    def swing(drop: float) -> Swing:
        drops.append(drop)
        return Swing(drop)

    monkeypatch.setattr("maglev_mj.bridge.remote.Swing", swing)
    plant.takeoff(0.2)
    assert plant.land(0.2, reason="late").at_rest and drops == [scale.drop]


@pytest.mark.parametrize("name", DEVICES)
def test_the_power_guard_trips_at_each_of_its_limits(name: str) -> None:
    scale, inertia = DEVICES[name].scale, DEVICES[name].inertia.tolist()
    for limit, force, why in (
        (scale.capped, 0.4 * scale.cap, f"capped at {scale.cap:.3g} N each in 0.2 s, limit {scale.capped:.3g} N"),
        (scale.reversals, 2.4 * scale.cap, f"N of force reversals in 0.2 s, limit {scale.reversals:.3g} N"),
    ):
        guard, said = PowerGuard(0.001, inertia, scale), ""
        for tick in range(1000):
            said = said or guard.check([0.0] * 6, [force * (-1) ** tick, 0.0, 0.0, 0.0, 0.0, 0.0])
        assert said.endswith(why)
        assert limit <= float(said.split()[3]) * (1.0 + 5e-3) < limit + 2.2 * force
    push, most = 0.02 * scale.cap, scale.generated
    returned = pushed(PowerGuard(0.001, inertia, scale), push, most)
    assert 0.95 * most < returned < 1.1 * most
    guard = PowerGuard(0.001, inertia, scale)
    assert pushed(guard, -push, 3.0 * scale.stored) == math.inf  # put in by a hand, and forgotten but for `stored`
    assert not any(guard.check([0.0] * 6, [0.0] * 6) for _ in range(3000))
    most += scale.stored
    assert 0.95 * most < pushed(guard, push, most) < 1.1 * most


def pushed(guard: PowerGuard, force: float, energy: float) -> float:
    """Push along a path up to 1.2 times an energy [J]; return that of the force at the guard's message, or infinity."""
    for at in np.linspace(0.0, 1.2 * energy / abs(force), 60):  # in 60 ms: what is generated decays with 1 s
        if said := guard.check([at, 0.0, 0.0, 0.0, 0.0, 0.0], [force, 0.0, 0.0, 0.0, 0.0, 0.0]):
            assert "the laws generate energy" in said
            return abs(force) * float(at)
    guard.check([at, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0] * 6)
    guard.check([0.0] * 6, [0.0] * 6)  # back to the start without a force
    return math.inf


@pytest.mark.parametrize("name", DEVICES)
def test_rest_and_the_path_of_a_takeoff_are_the_devices(name: str) -> None:
    calibration, scale = Calibration.of(DEVICES[name]), DEVICES[name].scale
    for axis, slow in ((0, scale.rest), (4, scale.rest_spin)):
        for share in (0.95, 1.05):
            motion = RecentMotion(0.001, scale)
            while not motion.full:
                tick = len(motion._samples)
                motion.add(Sample(tick, 0.0, [share * slow * tick * 1e-3 * (k == axis) for k in range(6)]))
            assert motion.at_rest is (share < 1.0)
    for axis, most in ((1, scale.path), (5, scale.path_angle)):
        astray: list[Any] = []
        leader = Leader(calibration, 1e-3, 9e-4)
        leader.aim(straight([0.0] * 6, [0.0] * 6, 1.0), astray.append)
        for tick, share in enumerate((0.95, 1.05)):
            leader.step(Sample(tick, 1e-3 * tick, [share * most * (k == axis) for k in range(6)]))
        assert len(astray) == 1


@pytest.mark.parametrize("name", DEVICES)
def test_gains_are_estimated_once_a_device_has_lifted_off(name: str) -> None:
    calibration, scale = Calibration.of(DEVICES[name]), DEVICES[name].scale
    for share in (0.95, 1.05):
        estimator = CoilEstimator(calibration, 0.005)
        for height in [0.0] * 10 + [share * scale.lifted] * 10:
            estimator.add([0.0, 0.0, height, 0.0, 0.0, 0.0], calibration.hover.tolist())
        assert np.isnan(estimator.estimate()[0]).all() == (share < 1.0)


@pytest.mark.parametrize("name", DEVICES)
def test_a_gain_is_as_certain_as_the_devices_sensor_allows(name: str) -> None:
    device = DEVICES[name]
    steps, noises = np.array(device.sensor.resolution), np.array(device.sensor.noise)
    certain = []
    for factor in (1.0, 8.0):
        known = Calibration.of(device.change("sensor", resolution=factor * steps, noise=factor * noises))
        estimator = CoilEstimator(known, 0.005)
        for pose, currents in free_motion(known, 0.005, 60):
            estimator.add(pose, currents)
        certain.append(np.isfinite(estimator.estimate()[0]).all())
    assert certain == [True, False]


@pytest.mark.parametrize("name", DEVICES)
def test_rotations_count_by_the_devices_lever(name: str) -> None:
    calibration, scale = Calibration.of(DEVICES[name]), DEVICES[name].scale
    estimator = CoilEstimator(calibration, 0.005)
    for tick in range(20):
        turned = 0.01 * (-1) ** tick
        estimator.add([turned, 0.0, 0.0, turned, 0.0, 0.0], [0.0] * 6)
    (_, moved), (_, angle) = (estimator._fit(estimator._summed(), [axis]) for axis in (0, 3))
    assert angle == pytest.approx(scale.lever * moved, abs=1e-12)


@pytest.mark.parametrize("coil", range(6))
@pytest.mark.parametrize("name", DEVICES)
def test_a_coil_is_suspected_from_the_devices_least_current_on(name: str, coil: int) -> None:
    calibration, least = Calibration.of(DEVICES[name]), DEVICES[name].scale.least
    for share in (0.98, 1.02):
        residual, suspected = Residual(calibration, 0.005), False
        residual.watching = True
        currents = calibration.hover.copy()
        currents[coil] = share * least
        wrench = (calibration.coils.wrench_per_current @ currents).tolist()
        for pose, _ in free_motion(calibration, 0.005, 60, currents=currents, dead=coil):
            driven = [0.005 * x for x in wrench], [0.5 * 0.005**2 * x for x in wrench]
            residual.add(pose.tolist(), driven, ((0.0,) * 6, (0.0,) * 6))
            suspected = suspected or (residual._coil is not None and residual._coil[0] == coil)
        assert suspected == (share > 1.0)


def free_motion(calibration: Calibration, period: float, count: int, currents: Any = None, dead: int = -1) -> Any:
    """Return poses and currents of a free flotor; without currents they are drawn around those that hover.

    A coil is dead in the second half.
    """
    draw, x, v, hover = np.random.default_rng(4), np.zeros(6), np.zeros(6), calibration.hover
    for tick in range(count):
        drawn = hover + 0.2 * np.abs(hover).max() * draw.uniform(-1.0, 1.0, 6) if currents is None else currents
        flowing = np.where(np.arange(6) == dead, 0.0, drawn) if tick >= count // 2 else drawn
        rate = (calibration.coils.wrench_per_current @ flowing + calibration.body.load) / calibration.body.inertia
        x, v = x + period * v + 0.5 * period**2 * rate, v + period * rate
        yield x, drawn


@pytest.mark.parametrize("name", DEVICES)
def test_a_device_takes_off_and_lands_by_its_own_numbers(name: str) -> None:
    plant = remote(DEVICES[name])
    low, tick = plant.calibration.base.rest[2], plant.period
    scene = find_scene("joystick")().replace(period=tick, delay=plant.delay)
    report = Flight(plant, scene).run(0.1)
    assert report.landing.at_rest and report.landing.error < 5e-5 and not plant.faults
    assert plant.pose[2] == pytest.approx(low, abs=5e-5)


@pytest.mark.parametrize(("name", "force"), [("light", 8.0), ("stage", 20.0)])
def test_a_tap_onto_the_stops_ends_no_flight(name: str, force: float) -> None:
    """Stops yield by 0.4 to 0.9 mm on any device; a share of the range is less on one of 2 mm."""
    calibration, far = Calibration.of(DEVICES[name]), [0.0]

    def tap(tick: int, time: float, state: Any) -> list[float]:
        far[0] = max(far[0], abs(float(state()[0][2])) * (time > 1.3))
        return [0.0, 0.0, force * (1.3 < time < 1.33), 0.0, 0.0, 0.0]

    twin = Twin(TwinParameters(calibration=calibration), hand_force=tap)
    plant = RemotePlant(VirtualLink(twin), calibration=calibration)
    scene = find_scene("joystick")().replace(period=plant.period, delay=plant.delay)
    assert Flight(plant, scene).run(0.25).landing.at_rest and not plant.faults
    assert 2.4e-3 < far[0] < plant.scale.envelope


# the page


def test_the_page_states_formulas_and_numbers_of_every_threshold() -> None:
    """Formulas hold on random devices; numbers are those of the class, to three digits."""
    text = (DOCS / "explanation/flight_safety.md").read_text(encoding="utf-8")
    table = text.split("## Scale of a device")[1].split("\n## ")[0]
    rows = re.findall(r"^\| `(\w+)` \|[^|]*\| `([^`]+)` \|([^|]+)\|([^|]+)\|$", table, re.MULTILINE)
    assert [name for name, *_ in rows] == list(Scale.__dataclass_fields__)
    functions: dict[str, Any] = {"sqrt": math.sqrt, "max": max, "min": min, "rad": math.radians}
    random = []
    for device in RANDOM[:60]:
        own, published = device.sizes, published_device().sizes
        sizes = {letter: a / b for letter, a, b in zip("m g x s d a b r F L n w".split(), own, published)}
        random.append((device.scale, functions | sizes | {"n": sizes["n"] or 1.0, "w": sizes["w"] or 1.0}))
    for name, formula, *columns in rows:
        for device_name, stated in zip(("ubc", "stage"), columns):
            ((number, unit),) = re.findall(r"^([\d.]+) ?(.*)$", stated.strip())
            value = getattr(DEVICES[device_name].scale, name) / UNITS.get(unit, 1.0)
            assert float(number) == pytest.approx(float(f"{value:.3g}"), rel=1e-9), (name, device_name)
        code = compile(formula, name, "eval")
        for scale, names in random:
            assert eval(code, {}, names) == pytest.approx(getattr(scale, name)), name


UNITS = {"mm/s": 1e-3, "mm": 1e-3, "µm": 1e-6, "mJ": 1e-3, "°": math.radians(1.0)}
"""Units of the page, in SI units."""


def test_the_guide_states_the_limits_of_the_published_joystick() -> None:
    text = (DOCS / "howto/fly.md").read_text(encoding="utf-8")
    own, limits = HostLimits(), []
    for names in (("envelope", "envelope_angle"), ("speed_limit", "spin_limit")):
        options = ", ".join(f"`--{name.replace('_', '-')}`" for name in names)
        (stated,) = re.findall(rf"\| {options} \|[^|]*\| the device's own: ([^|]*) for `ubc` \|", text)
        limits += [stated == ", ".join(f"{getattr(own, name):.4g}" for name in names)]
    assert limits == [True, True]


def changed(key: str) -> set[str]:
    """Return the thresholds that change with a key of the file, on some device."""
    names = set()
    for device in RANDOM[:60]:
        section, _, rest = key.partition(".")
        for name in ("force_constants", "current_limit") if rest == "*" else (rest,):
            value = 0.7 * np.array(getattr(getattr(device, section), name))
            other = device.change(section, **{name: value.tolist()})
            before, after = asdict(device.scale), asdict(other.scale)
            names |= {name for name in before if not math.isclose(before[name], after[name], rel_tol=1e-12)}
    return names


def test_the_page_of_a_device_names_the_thresholds_of_each_key() -> None:
    text = (DOCS / "howto/describe_your_device.md").read_text(encoding="utf-8")
    table = text.split("| key | thresholds of a flight |")[1].split("\n\n")[0]
    rows = re.findall(r"^\| (.*?) \| (.*) \|$", table, re.MULTILINE)
    assert len(rows) == 7
    for keys, names in rows:
        assert set(re.findall(r"`(\w+)`", names)) == set().union(*map(changed, re.findall(r"`([^`]+)`", keys))), keys
