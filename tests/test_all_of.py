"""The lists of `all_of` are complete, and what all of a kind have in common."""

from __future__ import annotations

import inspect
import itertools
import json
import math
import re
from collections.abc import Iterator
from dataclasses import MISSING, fields, replace
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from maglev_mj import Command, Controller, ExactPlant, MuJoCoPlant, Sample, Timing, control, drive, linearise, plants
from maglev_mj.bridge import RemotePlant
from maglev_mj.control import AxisLaw, Dahl, FiniteDifference, Friction, Hold, Law, LuGre, VelocityEstimator, Wall
from maglev_mj.control.laws.base import Gains
from maglev_mj.control.laws.velocity import Estimator
from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Array, components
from maglev_mj.lazy import by_name, public
from maglev_mj.plants import SampledPlant, Sensor
from maglev_mj.plants.hand import get_hand
from maglev_mj.plants.trace import PassivityObserver, Trace, actuator_work
from maglev_mj.recording import setup
from maglev_mj.scenes import find_scene
from maglev_mj.spec import GRAVITY, INERTIA
from tests.all_of import (
    IDEAL,
    LAWS,
    LINES,
    MOTIONS,
    PERIOD,
    PLANTS,
    SCENES,
    SENSORS,
    START,
    TIMING,
    UNRECORDED,
    VELOCITIES,
    controller_of,
)
from tests.published import WEIGHT
from tests.sweeps import sweep

ALONE: dict[str, Any] = {name: laws[-1] for name, laws in LAWS.items() if laws}
"""Each law by its name."""

FRICTION: dict[str, Any] = {name: law for name, law in ALONE.items() if isinstance(law, Friction)}
UPRIGHT: dict[str, Any] = {name: [*values[:3], 0.0, 0.0, 0.0] for name, values in START.items()}


def below(kind: type) -> Iterator[type]:
    """Yield the classes of the package that derive from one."""
    one: type
    for one in kind.__subclasses__():
        yield from below(one)
        if one.__module__.startswith("maglev_mj."):
            yield one


def test_every_law_and_velocity_estimate_of_the_package_is_listed() -> None:
    listed: set[type] = {type(law) for parts in LAWS.values() for law in parts} | {type(one) for one in VELOCITIES}
    classes = [getattr(control, name) for name in dir(control)]
    there = {cls for cls in classes if isinstance(cls, type) and "__call__" in dir(cls)}
    assert there - {Law, AxisLaw, Friction, VelocityEstimator} == listed | {control.Bias}


def test_every_sensor_of_the_package_is_listed() -> None:
    classes = [getattr(plants, name) for name in dir(plants)]
    there = {
        cls for cls in classes if isinstance(cls, type) and "start" in dir(cls) and not issubclass(cls, SampledPlant)
    }
    there -= {plants.PoseSensor}
    assert there == {*IDEAL.values()} == {type(sensor) for sensor, _ in SENSORS.values()} == {*setup._TYPES["sensor"]}


@pytest.mark.parametrize("kind", [Law, Estimator])
def test_a_list_of_classes_is_in_the_order_of_definition(kind: Any) -> None:
    parts = public(control, kind)
    lines = [(part.__module__, inspect.getsourcelines(part)[1]) for part in parts]
    assert lines == sorted(lines) and {Hold, FiniteDifference} & {*parts}


UNSET = {
    *(("StickSlip", "coupled"), ("Wall", "on"), ("Wall", "cutoff"), ("PassivityController", "paired")),
    *(("HalfSampleWall", "lower"), ("VirtualCoupling", "lower")),
}
"""Options that have their default in `LAWS`: tests of the law try others."""


def test_every_option_of_a_law_is_set_in_the_list() -> None:
    usual = {
        (name, option.name)
        for name, law in ALONE.items()
        for option in fields(law)
        if option.init and option.default is not MISSING and np.array_equal(getattr(law, option.name), option.default)
    }
    assert usual == UNSET, f"set {sorted(usual - UNSET)} in _SPECIAL of tests/all_of.py, or list it in UNSET"


@pytest.mark.parametrize("kind", [Friction, Estimator])
def test_a_public_class_without_a_name_or_with_that_of_another_is_an_error(kind: Any) -> None:
    class First(kind):  # type: ignore[misc]
        called = "first"

    class Nameless(First):
        pass

    class Second(kind):  # type: ignore[misc]
        called = "first"

    def package(*classes: type) -> ModuleType:
        module = ModuleType("package")
        vars(module).update({"__all__": [one.__name__ for one in classes]}, **{one.__name__: one for one in classes})
        for one in classes:
            one.__module__ = __name__
        return module

    with pytest.MonkeyPatch.context() as patch:
        for one in (First, Nameless, Second):
            patch.setitem(globals(), one.__name__, one)
        assert by_name(package(First), kind) == {"first": First}
        with pytest.raises(TypeError, match="Nameless must state its name: called"):
            by_name(package(First, Nameless), kind)
        with pytest.raises(TypeError, match="Second and First are both called 'first'"):
            by_name(package(First, Second), kind)


def test_every_law_and_velocity_estimate_of_the_package_is_rebuilt_from_a_recording() -> None:
    for slot, parts in (("laws", itertools.chain(*LAWS.values())), ("velocity", VELOCITIES)):
        assert {*map(type, parts)} <= {*setup._TYPES[slot]} and not {Law, AxisLaw, Friction} & {*setup._TYPES[slot]}


@pytest.mark.parametrize("scene", SCENES)
def test_a_recording_of_a_scene_of_the_package_rebuilds_its_laws(scene: str) -> None:
    """Others are code of a user, which replay does not execute."""
    made = find_scene(scene)()
    foreign = {type(law).__name__ for law in made.laws()} - {law.__name__ for law in setup._TYPES["laws"]}
    assert not foreign, f"move {foreign} to control/laws, with a line in control/__init__.pyi"


def test_every_plant_of_the_package_is_listed() -> None:
    made = [make() for make in (*PLANTS.values(), *UNRECORDED.values())]
    try:
        device = {cls for cls in below(SampledPlant) if cls.__module__.startswith("maglev_mj.plants.")}
        assert {type(plant) for plant in made} == device
    finally:
        for plant in made:
            plant.close()


# -- laws ------------------------------------------------------------------------------------------------


def answers(laws: list[Any], poses: Array, period: float = PERIOD) -> tuple[Array, Array]:
    """Return held forces and pulses of laws for a prescribed motion, of one device or several."""
    controller = Controller(laws, period=period)
    commands = [controller.step(Sample(tick, tick * period, components(pose))) for tick, pose in enumerate(poses)]
    return np.array([command.wrench for command in commands]), np.array([command.pulse for command in commands])


def weaker(law: Any, factors: Any) -> Any:
    """Return a law with all its gains times each factor, of which there is one for each device."""
    if not isinstance(law, AxisLaw):
        return law
    many = np.asarray(factors)[..., None] * np.ones(len(law.indices))
    gains: dict[str, Any] = {name: np.asarray(getattr(law, name)) * many for name in law.per_device}
    return replace(law, **gains)


@pytest.mark.parametrize("law", ALONE)
def test_a_batch_of_devices_with_their_own_gains_answers_as_each_alone_to_the_last_bit(law: str) -> None:
    random, devices, ticks = np.random.default_rng(7), 9, 80
    factors, phase, rate = (random.uniform(*ends, devices) for ends in ((0.5, 1.0), (0.0, 6.0), (0.02, 0.9)))
    turns = phase[:, None] + rate[:, None] * np.arange(ticks)[:, None, None] + np.arange(6)
    poses = 1e-3 * np.sin(turns) * ([1.0] * 3 + [3.0] * 3)
    together = answers([weaker(one, factors) for one in LAWS[law]], poses)
    assert together[0].shape == (ticks, devices, 6) and np.ptp(together[0], axis=(0, 1)).any()
    for device, factor in enumerate(factors):
        alone = answers([weaker(one, factor) for one in LAWS[law]], poses[:, device])
        for one, many in zip(alone, together, strict=True):
            assert np.array_equal(one, many[:, device])


@pytest.mark.parametrize("law", LAWS)
def test_a_batch_moves_as_each_of_its_devices(law: str) -> None:
    starts = np.array(START["pose"]) * np.array([1.0, -0.4, 0.1])[:, None]

    def moved(pose: Any) -> Any:
        seen: list[Any] = []
        with ExactPlant(Timing(**TIMING), pose=pose) as plant:
            drive(plant, controller_of(law), 30, observe=lambda sample, _: seen.append(np.array(sample.pose)))
        return np.array(seen)

    together = moved(starts)
    assert together.shape == (30, 3, len(AXES)) and np.ptp(together[-1, :, 2]) > 0.0
    for device, start in enumerate(starts):
        # not to the last bit: a period is cut where any device switches
        np.testing.assert_allclose(together[:, device], moved(start), rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize(("law", "plant"), sweep(LAWS, PLANTS, every=3))
def test_a_run_is_the_same_again_after_a_reset_and_is_refused_before_it(law: str, plant: str) -> None:
    controller = controller_of(law)

    def moved() -> list[Any]:
        with PLANTS[plant]() as made:
            seen: list[Any] = []
            drive(made, controller, 8, observe=lambda sample, applied: seen.append((*sample.position, *applied.force)))
        return seen

    first = moved()
    with pytest.raises(ParameterError, match=r"tick must be above the previous tick \d+ [(]got 0[)]; call reset\(\)"):
        moved()
    controller.reset()
    assert moved() == first


@pytest.mark.parametrize("law", LAWS)
def test_a_law_moves_both_plants_alike(law: str) -> None:
    """To rounding in translation, also behind the steps of a sensor."""
    for sensor in (SENSORS["Sensor"][0], Sensor(quantum=5.3e-6)):  # no pose of it lies between two steps
        paths = []
        for kind in (ExactPlant, MuJoCoPlant):
            with kind(Timing(**TIMING), **UPRIGHT, wrench=WEIGHT, sensor=sensor, record=True) as plant:
                drive(plant, controller_of(law), 60)
                paths.append(plant.trace().at(np.arange(60) * PERIOD)[0])
        assert np.ptp(paths[0][:, 2]) > 1e-4
        np.testing.assert_allclose(paths[0][:, :3], paths[1][:, :3], rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("law", [name for name, law in ALONE.items() if law.gains()])
def test_the_gains_that_a_law_states_are_those_of_its_linearisation(law: str) -> None:
    """In contact, where it is a wall, and stuck, where it is friction."""
    pose = np.zeros(6)
    for axis, normal, edge in ALONE[law].faces():
        pose[axis] = np.max(edge) - 1e-3 * normal
    stated: list[Gains] = list(ALONE[law].gains() or ())
    near = linearise(Controller([ALONE[law]], period=PERIOD), pose)[0]
    assert not near.jumps.any() and any(one.stiffness.any() for one in stated)
    # the wrench is taken at displacements of 0.1 µm, and some friction bends
    creep = 1e-3 if isinstance(ALONE[law], Dahl | LuGre) else 1e-6
    for name in ("stiffness", "damping"):
        wanted = np.diag(sum(getattr(one, name) for one in stated))
        advice = "if its force bends at rest, name the law at `creep`"
        np.testing.assert_allclose(getattr(near, name), wanted, rtol=creep, atol=1e-6, err_msg=advice)


LIMIT = 0.05
SLIDING = np.outer(np.sin(np.linspace(0.0, 4.0 * math.pi, 801)), [1e-3, 1e-3, 1e-3, 0.0, 0.0, 0.0])
"""Two cycles along x, y and z, of six times the stretch at breakaway."""


@pytest.mark.parametrize("law", FRICTION)
def test_friction_is_at_most_its_breakaway_and_takes_energy_over_a_closed_cycle(law: str) -> None:
    still = replace(FRICTION[law], stiffness=300.0, damping=0.0, breakaway=LIMIT)
    bound = LIMIT * (1.0 + 1e-9)
    for path in (SLIDING, 1e-4 * np.random.default_rng(3).normal(size=(300, 6))):
        alone = replace(still, bristle_damping=0.0) if law == "LuGre" else still
        assert 0.5 * LIMIT < np.abs(answers([alone], path)[0]).max() <= bound
    force = answers([still], SLIDING)[0]
    work = (force[:-1] * np.diff(SLIDING, axis=0))[400:].sum(axis=0)[:3]
    # of Coulomb's 4 F A, less what the spring gives back: half of it where it is reset, twice F² / 2 K where it breaks
    least = {"SpringReset": 0.35, "StickSlip": 0.9 * LIMIT / 300.0 / 4e-3}.get(law, 0.6)
    assert (least < -work / (4.0 * LIMIT * 1e-3)).all() and (-work < 4.0 * LIMIT * 1e-3).all()


def test_a_wall_with_a_force_limit_pushes_no_harder_in_its_pulses() -> None:
    wall = replace(ALONE["Wall"], pulse=400.0, force_limit=0.4, stiffness=100.0, damping=1.0)
    held, pulse = answers([wall], SLIDING)
    assert pulse[:, 1:3].any(axis=0).all()
    assert np.abs(held[:, 1:3] + pulse[:, 1:3])[pulse[:, 1:3] != 0.0].max() == pytest.approx(0.4, rel=1e-12)


@pytest.mark.parametrize("estimate", VELOCITIES, ids=lambda one: type(one).__name__)
def test_a_velocity_estimate_of_a_ramp_is_its_slope_on_every_axis(estimate: Estimator) -> None:
    """At irregular times, and with lost samples."""
    slopes, state = np.array([1e-4, -0.02, 0.03, 1e-3, -0.2, 0.3]), None
    periods = PERIOD * np.random.default_rng(5).choice([0.7, 1.0, 1.1, 2.0, 3.0], estimate.settles_in)
    for time, period in zip(np.cumsum(periods), periods):
        velocity, state = estimate((slopes * time + 1e-3).tolist(), state, float(period))
        assert time > period or not np.any(velocity)
    np.testing.assert_allclose(velocity, slopes, rtol=1e-9)


@pytest.mark.parametrize(
    "estimate", [one for one in VELOCITIES if hasattr(one, "linear")], ids=lambda one: type(one).__name__
)
def test_the_linear_model_of_a_velocity_estimate_answers_as_the_estimate(estimate: Any) -> None:
    model, state = estimate.linear(PERIOD), None
    inner = np.zeros(len(model.take))
    for x in [0.0, *np.random.default_rng(6).normal(size=30)]:
        velocity, state = estimate([float(x)] * 6, state, PERIOD)
        assert float(model.give @ inner + model.direct * x) == pytest.approx(velocity[2], rel=1e-12, abs=1e-9)
        inner = model.advance @ inner + model.take * x


STEADY = np.arange(80)[:, None] * PERIOD * [2e-3, 3e-3, -4e-3, 0.02, -0.03, 0.04] + [0.0, 0.0, 4e-4, 0.0, 0.0, 0.0]
"""Motion at constant velocity that breaks each friction loose and enters each wall after sample 20."""


def steady_commands(laws: Controller, *lost: int, path: Array = STEADY) -> list[Command]:
    """Return the commands for that motion; that before a lost sample is held."""
    given: list[Command] = []
    for tick, pose in enumerate(path.tolist()):
        given.append(given[-1] if tick in lost else laws.step(Sample(tick, 0.0, pose)))
    return given


@pytest.mark.parametrize("law", LAWS)
def test_lost_samples_at_constant_velocity_do_not_change_the_other_forces(law: str) -> None:
    """The pulse comes with the first sample inside the wall that arrives."""
    wanted = np.array([command.wrench for command in steady_commands(controller_of(law))])
    end = 37 if law == "PassivityController" else 70  # inside, their own force is held
    for first, gap in itertools.product(range(20, end, 7), (0, 1, 3)):
        seen = steady_commands(controller_of(law), first, first + gap)
        arrived = [tick for tick in range(len(STEADY)) if tick not in (first, first + gap)]
        np.testing.assert_allclose([seen[tick].wrench for tick in arrived], wanted[arrived], rtol=1e-9, atol=1e-9)
        pulsed = [tick for tick in arrived if seen[tick].pulse[1]]
        assert law != "Wall" or pulsed == [tick for tick in arrived if STEADY[tick, 1] >= 2e-4][:1]


@pytest.mark.parametrize("lost", [(), (30,), (30, 31), (30, 32)])
def test_a_passivity_controller_knows_that_its_force_is_held_while_samples_are_lost(lost: tuple[int, ...]) -> None:
    watch = Controller(LAWS["PassivityController"], period=PERIOD)
    force = [command.force[2] for command in steady_commands(watch, *lost, path=STEADY[::-1])]
    energy = 0.5 * (sum(force[:-2]) + sum(force[:-3])) * np.diff(STEADY[:2, 2])  # a delay of 1.5 periods
    assert watch.signals["energy"] == pytest.approx(energy, rel=1e-9)


@pytest.mark.parametrize("law", LAWS)
def test_a_sample_that_is_not_finite_is_refused_and_changes_no_state(law: str) -> None:
    for poses, device in (STEADY, ""), (np.stack([STEADY] * 2, axis=1), r", device \(1,\)"):
        laws, untouched = controller_of(law), controller_of(law)
        for tick, pose in enumerate(poses[:3]):
            for axis, bad in itertools.product(range(7), (math.nan, math.inf, -math.inf)):
                row = np.insert(pose, 6, 0.0, axis=-1)
                row[-1 if device else ..., axis] = bad
                name = (*AXES, "time")[axis]
                with pytest.raises(ParameterError, match=rf"tick {tick} must be .*got {name} = {bad:g}{device}\)"):
                    laws.step(Sample(tick, row[..., 6], components(row[..., :6])))
            good = Sample(tick, 0.0, components(pose))
            assert np.array_equal(laws.step(good).wrench, untouched.step(good).wrench)
            with pytest.raises(ParameterError, match=rf"tick must be above the previous tick {tick} \(got {tick}\)"):
                laws.step(good)


def test_the_first_sample_of_one_device_is_checked_without_arrays(monkeypatch: pytest.MonkeyPatch) -> None:
    """They take as long as several samples."""
    laws = Controller([*LAWS["Wall"], *LAWS["Hold"]], period=PERIOD)
    for module in ("controller", "laws.base"):
        monkeypatch.setattr(f"maglev_mj.control.{module}.np", None)
    assert laws.step(Sample(0, 0.0, STEADY[0].tolist())).force[2] < 0.0


ANY = {"lower", "upper", "target"}
ABOVE_ZERO = {"breakaway", "v_min", "period", "inertia", "slow", "stribeck", "coulomb", "elastic", "stick"}
TOO_MUCH = {"pole": 1.0, "elastic": 1.0, "stick": 1.0, "coulomb": 1.0 + 1e-9}
INFINITE = {("Wall", "lower"), ("Wall", "upper"), ("Wall", "force_limit")}
LISTS = "ANY, ABOVE_ZERO, TOO_MUCH or INFINITE of tests/test_all_of.py"
NUMBERS = [
    (name, one.name) for name, law in ALONE.items() for one in fields(law) if {"gain", "setting"} & one.metadata.keys()
]


@pytest.mark.parametrize("law", ALONE)
def test_a_number_outside_its_bounds_is_refused_with_the_value(law: str) -> None:
    for name in (own for of, own in NUMBERS if of == law):
        above = name in ABOVE_ZERO or (name == "stiffness" and law in FRICTION)
        bad = [math.nan, "stiff", *([] if name in ANY else [0.0 if above else -1e-9]), TOO_MUCH.get(name, math.nan)]
        for value in [*bad, *([] if (law, name) in INFINITE else [math.inf])]:
            try:
                taken = replace(ALONE[law], **{name: value})
            except ParameterError as error:
                refused = str(error)
            else:
                pytest.fail(f"{taken} accepts {name} = {value}: declare its bound, or list {name} in {LISTS}")
            assert re.search(rf"{name} .*(not|got) ", refused)
            assert (repr(value) if isinstance(value, str) else f"{value:g}") in refused
        if not above and name not in ANY:
            try:
                replace(ALONE[law], **{name: 0.0})
            except ParameterError as error:
                pytest.fail(f"{error}: if that is right, list {name} in {LISTS}")
    for axes, words in (
        ("q", r"axis must be one of x, y, z, .*got 'q'"),
        (("x", "x"), "without duplicates"),
    ):
        with pytest.raises(ParameterError, match=words):
            replace(ALONE[law], axes=axes)


# -- plants ----------------------------------------------------------------------------------------------


def bounced(kind: Any, pulse: float = 0.0, ticks: int = 60, timing: Timing | None = None, **options: Any) -> Any:
    """Return a plant after drops onto a wall, and what an observer of it counted."""
    own = Timing(delay=0.0015, phase=0.3) if timing is None else timing
    plant = kind(own, pose=[0.0, 0.0, 4e-3, 0.0, 0.0, 0.0], **options)
    watch = PassivityObserver(own, INERTIA, load=[0.0, 0.0, -INERTIA[0] * GRAVITY, 0.0, 0.0, 0.0])
    wall = Wall(axes="z", lower=0.0, stiffness=4000.0, damping=40.0, pulse=pulse, pulse_width=0.003)
    last = drive(plant, Controller([wall], period=own.period), ticks, observe=watch)
    watch(last, Command([0.0] * 6))  # the period up to the last sample
    return plant, watch


@pytest.mark.parametrize("plant", [*PLANTS, *UNRECORDED, *LINES])
def test_a_run_in_several_calls_answers_every_sample_as_in_one_call(plant: str) -> None:
    runs: list[list[Any]] = []
    for cuts in itertools.product((False, True), repeat=4):
        with {**PLANTS, **UNRECORDED}.get(plant, lambda: RemotePlant(LINES[plant]()))() as made:
            laws = Controller([*LAWS["Wall"], *LAWS["Dahl"]], period=made.period, velocity=VELOCITIES[2])
            runs.append([])
            for ticks in np.diff(np.flatnonzero([True, *cuts, True])).tolist():
                last = drive(made, laws, ticks, observe=lambda *cycle: runs[-1].append(cycle))
            runs[-1].append((last, Command(last.position)))
    rows = [[(sample.tick, sample.pose.tolist(), command.wrench.tolist()) for sample, command in run] for run in runs]
    assert rows.count(rows[0]) == len(rows) and [row[0] for row in rows[0]] == [*range(6)]


@pytest.mark.parametrize("kind", MOTIONS)
def test_a_flotor_under_a_constant_force_moves_on_a_parabola(kind: str) -> None:
    push = np.array([0.3, -0.2, 0.1, 0.0, 0.0, 4e-4])
    with MOTIONS[kind](Timing(phase=0.3), gravity=1.5, hand_force=lambda *_: push.tolist(), record=True) as plant:
        for tick in range(8):
            sample = plant.read()
            assert (sample.tick, sample.time) == (tick, (tick + 0.3) * 0.005)
        trace = plant.trace()
    since = np.linspace(0.0015, trace.time[-1], 50)[:, None]
    rate = push / INERTIA - [0.0, 0.0, 1.5, 0.0, 0.0, 0.0]
    pose, twist, _ = trace.at(since[:, 0])
    # the hand acts from the first sample on; before that it falls alone
    fallen, early = np.array([0.0, 0.0, 1.5, 0.0, 0.0, 0.0]), 0.0015
    np.testing.assert_allclose(twist, rate * (since - early) - fallen * early, rtol=0.0, atol=1e-14)
    lag = since - early
    expected = 0.5 * rate * lag**2 - fallen * early * (lag + 0.5 * early)
    np.testing.assert_allclose(pose, expected, rtol=0.0, atol=1e-15)


@pytest.mark.parametrize("pulse", [0.0, 120.0])
@pytest.mark.parametrize("kind", MOTIONS)
def test_the_energy_gained_is_the_work_of_the_actuators_and_of_gravity(kind: str, pulse: float) -> None:
    """By the plant's meter, by its trace and by an observer of samples and commands."""
    plant, watch = bounced(MOTIONS[kind], pulse, metered=True, record=True)
    trace: Trace = plant.trace()
    for end in (*range(2, len(trace.time), len(trace.time) // 9), len(trace.time)):
        part = Trace(trace.time[:end], trace.pose[:end], trace.twist[:end], trace.wrench[:end])
        heights, speeds = part.pose[[0, -1], 2], part.twist[[0, -1], 2]
        gained = INERTIA[0] * (0.5 * np.diff(speeds**2) + GRAVITY * np.diff(heights))[0]
        assert actuator_work(part).sum() == pytest.approx(gained, abs=1e-15)
    assert plant.work == pytest.approx(gained, abs=1e-12) and gained < -0.01
    assert -watch.energy.sum() == pytest.approx(plant.work, abs=1e-12)


@pytest.mark.parametrize(
    ("order", "options"),
    [
        (1.0, {"integrator": "euler", "coils": False}),
        (3.0, {"driver_lag": True, "driver_time_constant": 1e-3, "hand": get_hand("stylus")}),
    ],
    ids=["euler", "rk4 under lag, held"],
)
def test_the_engines_error_falls_with_the_order_of_its_integrator(order: float, options: dict[str, Any]) -> None:
    """Towards the motion in closed form."""
    steps = np.array([1e-3, 5e-4])
    physical = {name: value for name, value in options.items() if name not in ("integrator", "coils")}
    exact = bounced(ExactPlant, 120.0, 12, **physical)[0].state()[0]
    errors = [
        np.abs(bounced(MuJoCoPlant, 120.0, 12, longest_step=step, **options)[0].state()[0] - exact).max()
        for step in steps
    ]
    assert np.diff(np.log(errors)) / np.diff(np.log(steps)) > order - 0.5, errors
    assert errors[-1] < (1e-8 if order > 1.0 else 1e-3)


# -- sensors ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sensor", SENSORS)
def test_a_sensor_reads_the_same_again_near_the_pose_and_a_batch_as_its_devices(sensor: str) -> None:
    (made, within), random = SENSORS[sensor], np.random.default_rng(2)
    poses = random.uniform(-1.0, 1.0, (200, 6)) * ([4e-3] * 3 + [0.05] * 3)
    one, again = made.start(), made.start()
    read = np.array([one(pose.tolist()) for pose in poses])
    assert np.array_equal(read, [again(pose.tolist()) for pose in poses])
    off = np.abs(read - poses).max()
    assert off <= within and (sensor in IDEAL or off > 0.3 * within)
    if np.any(made.noise):  # drawn for all devices of a sample
        return
    back = np.array([one(pose.tolist()) for pose in poses[::-1]])[::-1]
    assert made.remembers == (np.abs(back - read).max() > 1e-12), f"{type(made).__name__} must state `remembers`"
    if not made.remembers:
        together = np.stack(np.broadcast_arrays(*made.start()(components(poses))), axis=-1)
        np.testing.assert_allclose(together, read, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("sensor", SENSORS)
def test_every_sensor_of_the_package_is_rebuilt_from_a_recording(sensor: str) -> None:
    made = SENSORS[sensor][0]
    again = setup._object("sensor", json.loads(json.dumps(setup._value("sensor", made))), None)
    pose = [1.1e-3, -2.3e-3, 0.4e-3, 0.02, 0.0, -0.01]
    assert type(again) is type(made) and again.start()(pose) == made.start()(pose)
