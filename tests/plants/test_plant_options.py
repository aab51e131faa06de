"""Fast options of the plants equal the plain ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import islice
from typing import Any

import numpy as np
import pytest

from maglev_mj import Command, Controller, ExactPlant, MuJoCoPlant, Timing, drive
from maglev_mj.control import Hold, Wall
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array, Component, components, join
from maglev_mj.plants import MuJoCoBatchPlant, SampledPlant, Sensor
from maglev_mj.plants.exact import DryFriction
from maglev_mj.plants.hand import Hand
from maglev_mj.spec import INERTIA
from tests.sweeps import sweep

T = 0.005
QUANTUM = [5e-6, 3e-7, 1.0, 10e-6, 7e-6, 0.3]


def bouncing(axes: Sequence[str] = ("z",)) -> Controller:
    wall = Wall(axes=axes, lower=0.0, stiffness=3000.0, damping=40.0, pulse=60.0, pulse_width=0.002)
    return Controller([wall, Hold(axes=("rx", "ry"), stiffness=[1.0] * 2, damping=[0.05] * 2)], period=T)


def places(count: int) -> Array:
    """Return poses on all axes, above the wall, (count, 6)."""
    spread = np.random.default_rng(3).uniform(-1.0, 1.0, (count, 6)) * [3e-4, 3e-4, 1e-3, 2e-3, 2e-3, 2e-3]
    return np.array([5e-4, -3e-4, 2e-3, 0.0, 1e-3, 0.0]) + spread


# --- sensor


@pytest.mark.parametrize("quantum", [QUANTUM, [0.0, *QUANTUM[1:]]])
def test_steps_are_whole_ones_to_the_last_bit_for_one_device_and_for_many(quantum: list[float]) -> None:
    # As np.rint, for ties, for what is beyond every step, and for what is no number.
    halves = np.arange(-20.0, 20.0)[:, None] * 0.5 * np.where(np.array(quantum) > 0.0, quantum, 1.0)
    random = np.random.default_rng(1).normal(size=(500, 6)) * 10.0 ** np.arange(-6, 0)
    poses = np.concatenate([halves, random, np.full((1, 6), np.nan), np.full((1, 6), np.inf), np.full((1, 6), -np.inf)])
    step = np.where(np.array(quantum) > 0.0, quantum, 1.0)
    expected = np.where(np.array(quantum) > 0.0, np.rint(poses / step) * step, poses)
    measure = Sensor(quantum=quantum).start()
    assert np.array_equal(join(measure(components(poses))), expected, equal_nan=True)
    alone = [measure(pose.tolist()) for pose in poses]
    assert np.array_equal(alone, expected, equal_nan=True)
    assert all(part.__class__ is float for row in alone for part in row)


@pytest.mark.parametrize("shape", [(), (7,)])
def test_noise_is_one_stream_of_six_a_sample(shape: tuple[int, ...]) -> None:
    # Drawn many samples at once for one device, and for axes without noise too.
    noise = np.array([1e-6, 0.0, 2e-6, 1e-5, 0.0, 3e-6])
    measure, stream = Sensor(noise=noise, seed=4).start(), np.random.default_rng(4)
    for tick in range(600):
        pose = np.broadcast_to(1e-3 * np.sin(np.arange(6.0) + tick), (*shape, 6))
        expected = pose + noise * stream.standard_normal((*shape, 6))
        assert np.array_equal(join(measure(components(pose))), expected)


# --- jitter


def test_jitter_is_that_of_seed_and_tick_whoever_asks_in_whatever_order() -> None:
    ticks = range(1200)
    one, other = (Timing(period=T, jitter=1e-3, seed=2) for _ in range(2))
    forward = [one.rest_at(tick) for tick in ticks]
    assert forward == [other.rest_at(tick) for tick in reversed(ticks)][::-1]
    assert forward != [Timing(period=T, jitter=1e-3, seed=3).rest_at(tick) for tick in ticks]
    draws = (np.array(forward) - 0.0015) / 1e-3
    assert len(set(forward)) == len(forward)
    assert abs(draws).max() < 1.0
    # evenly: mean 0 and variance 1/3, within four standard errors of 1200 draws, and no draw tells the next one
    assert abs(draws.mean()) < 4.0 * np.sqrt(1.0 / 3.0 / 1200)
    assert abs((draws**2).mean() - 1.0 / 3.0) < 4.0 * np.sqrt(4.0 / 45.0 / 1200)
    assert abs((draws[1:] * draws[:-1]).mean()) < 4.0 / 3.0 / np.sqrt(1200)


# --- limits


def test_a_command_within_the_limits_is_passed_on_as_it_is() -> None:
    limit = [1.0, 2.0, 3.0, 0.1, 0.2, 0.3]
    for edge in (1.0, -1.0):
        plant = ExactPlant(wrench_limit=limit)
        plant.read()
        command = Command([edge * most for most in limit])
        assert plant.write(command) is command
        for axis in range(6):
            beyond = [edge * most for most in limit]
            beyond[axis] *= 1.0 + 1e-15
            plant.read()
            assert plant.write(Command(beyond)).force == [edge * most for most in limit]


# --- axes of the exact plant


@pytest.mark.parametrize("single", [True, False])
def test_friction_slides_stops_rests_and_turns_back(single: bool) -> None:
    mass, rub, span = INERTIA[0], 0.5, 0.003
    cases = [  # speed, push, and the expected way and speed after 3 ms
        (0.01, 0.0, 0.01 * span - 0.5 * rub / mass * span**2, 0.01 - rub / mass * span),  # slides on
        (5e-4, 0.3, 0.125e-6 * mass / 0.2, 0.0),  # stops and rests
        (0.0, 0.5, 0.0, 0.0),  # rests at breakaway
        (0.0, -0.7, -0.5 * 0.2 / mass * span**2, -0.2 / mass * span),  # breaks away
    ]
    until = 1e-3 * mass / 1.2  # under 1.2 N the flotor turns back
    cases.append((1e-3, -0.7, 0.5e-3 * until - 0.1 / mass * (span - until) ** 2, -0.2 / mass * (span - until)))

    def slid(v: Component, push: Component) -> list[Component]:
        none: list[Component] = [0.0] * 6
        friction = DryFriction({0: rub}, INERTIA, none, single=single)
        after: tuple[list[Component], list[Component], list[Component]] = [0.0] * 6, [0.0] * 6, [0.0] * 6
        friction.amend(span, ([push, *none[1:]], none), (none, [v, *none[1:]], none), after)
        return [after[0][0], after[1][0]]

    speeds, pushes, ways, lasts = np.array(cases).T
    found = np.array([slid(v, f) for v, f in zip(speeds, pushes)]).T if single else slid(speeds, pushes)
    np.testing.assert_allclose(found, [ways, lasts], rtol=1e-12, atol=1e-18)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"driver_lag": True}, "dry_friction and driver_lag cannot be combined"),
        ({"hand": Hand(stiffness=50.0, axes=("y", "z"))}, "dry_friction must be 0 on an axis held by a hand"),
        ({"hand": Hand(stiffness=np.ones(3))}, r"hand must be scalar or of batch shape \(\) [(]got \(3,\)"),
    ],
)
def test_options_without_a_closed_form_together_are_refused(options: dict[str, Any], words: str) -> None:
    with pytest.raises(ParameterError, match=words):
        ExactPlant(dry_friction=[0.1, 0.0, 0.2, 0.0, 0.0, 0.0], **options)


OPTIONS: dict[str, dict[str, Any]] = {
    "lag": {"driver_lag": True},
    "hand": {"hand": Hand(mass=0.1, damping=5.0, stiffness=100.0, axes="z")},
    "soft hand, lag": {"hand": Hand(mass=0.1, grip_damping=2.0, grip_stiffness=900.0), "driver_lag": True},
    "friction": {"dry_friction": [0.3, 0.3, 0.3, 1e-3, 1e-3, 1e-3]},
    "friction, hand": {"dry_friction": [0.3, 0, 0, 1e-3, 0, 0], "hand": Hand(stiffness=50.0, axes=("y", "z"))},
    "limit, sensor, jitter": {"wrench_limit": 20.0, "sensor": Sensor(quantum=5e-6)},
}


@pytest.mark.parametrize("name", OPTIONS)
def test_a_batch_moves_as_its_devices_alone_whatever_they_share(name: str) -> None:
    timing, options = Timing(jitter=1e-4 if "jitter" in name else 0.0), OPTIONS[name]
    poses = places(12)
    for start in (poses, np.where([1, 1, 0, 1, 1, 1], poses[0], poses)):
        # a pulse of one splits the step of all
        together = drive(ExactPlant(timing, pose=start, **options), bouncing(), 40).pose
        for device in (0, 11):
            alone = drive(ExactPlant(timing, pose=start[device], **options), bouncing(), 40).pose
            np.testing.assert_allclose(together[device], alone, rtol=0.0, atol=1e-15)


# --- records


MANY = places(4)
RECORDED: dict[str, Callable[..., SampledPlant]] = {
    "exact, soft hand, lag": partial(ExactPlant, pose=MANY[0], **OPTIONS["soft hand, lag"]),
    "exact batch, hand": partial(ExactPlant, pose=MANY, **OPTIONS["hand"]),
    "exact batch, friction": partial(ExactPlant, pose=MANY, **OPTIONS["friction"]),
    "coils": partial(MuJoCoPlant, pose=MANY[0]),
    "corrected": partial(MuJoCoPlant, pose=MANY[0], integrator="corrected", coils=False, longest_step=1e-3),
    "lagging coils": partial(MuJoCoPlant, pose=MANY[0], driver_lag=True, driver_time_constant=5e-4),
    "falling off": partial(MuJoCoPlant, pose=MANY[0], force_falloff=0.1),
    "batch": partial(MuJoCoBatchPlant, pose=MANY, integrator="corrected", coils=False),
    "lagging batch": partial(MuJoCoBatchPlant, pose=MANY[:2], driver_lag=True, driver_time_constant=5e-4),
}


@pytest.mark.parametrize("name", RECORDED)
def test_a_trace_is_what_each_state_was(name: str) -> None:
    # Bit for bit, though its arrays are made at the end: nothing that is kept changes afterwards.
    plant, seen = RECORDED[name](Timing(), record=True), []
    drive(plant, bouncing(), 12, observe=lambda *_: seen.append([part.copy() for part in plant.state()]))
    trace = plant.trace()
    for tick, (pose, twist) in enumerate(seen):
        knot = np.flatnonzero((trace.time if trace.time.ndim == 1 else trace.time[:, 0]) == tick * T)[-1]
        assert np.array_equal(trace.pose[knot], pose) and np.array_equal(trace.twist[knot], twist)


@pytest.mark.parametrize(("name", "record"), sweep([*RECORDED, "exact, nothing"], [True, False], every=5))
def test_what_a_caller_does_to_a_command_later_changes_nothing(name: str, record: bool) -> None:
    """Its list and its arrays are its own."""
    states, traces = [], []
    for again in (False, True):
        make = RECORDED.get(name, partial(ExactPlant, pose=MANY[0]))
        plant = make(Timing(delay=1.3 * T), record=record, gravity=0.0)
        force: list[Any] = [np.zeros(plant.batch) if plant.batch else 0.0 for _ in range(6)]
        for sample in islice(plant, 5):
            push = np.full(plant.batch, 0.3 * sample.tick) if plant.batch else 0.3 * sample.tick
            if again and plant.batch:
                force[2][...] = push
            else:
                force[2] = push
            plant.write(Command(force if again else list(force)))
        states.append(plant.state())
        if record:
            traces.append(plant.trace())
    assert np.array_equal(states[0], states[1])
    if record:
        for part in ("time", "pose", "twist", "wrench"):
            assert np.array_equal(getattr(traces[0], part), getattr(traces[1], part))
        assert traces[0].wrench[..., 2].max() > 0.5
