"""A restarted plant equals a new one bit for bit, whatever it was used for."""

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

from maglev_mj.errors import MaglevError, ParameterError, PlantError
from maglev_mj.frames import Command, DeviceWall, Sample, join
from maglev_mj.plants import (
    ExactPlant,
    Hand,
    MuJoCoBatchPlant,
    MuJoCoPlant,
    SampledPlant,
    Sensor,
    SpringHand,
    Timing,
    engine_warnings_silenced,
)
from maglev_mj.plants.exact_coils import ExactCoilPlant
from tests.all_of import _COILS, PLANTS, START, TIMING, UNRECORDED
from tests.sweeps import sweep

SOFT = Hand(mass=0.3, damping=5.0, stiffness=100.0, grip_damping=2.0, grip_stiffness=400.0)
PAIR: dict[str, Any] = {"pose": np.tile(START["pose"], (2, 1)), "twist": np.tile(START["twist"], (2, 1))}
MORE: Mapping[str, Callable[[], SampledPlant]] = {
    "exact, soft grip and lag": lambda: ExactPlant(Timing(**TIMING), **START, hand=SOFT, driver_lag=True, metered=True),
    "exact, dry friction": lambda: ExactPlant(Timing(**TIMING), **START, dry_friction=0.1, record=True),
    "exact, batch": lambda: ExactPlant(
        Timing(period=0.002, delay=[1e-3, 1.5e-3], phase=[0.0, 0.4]), **PAIR, hand=SOFT, driver_lag=True, record=True
    ),
    "exact, coils and lag": lambda: ExactCoilPlant(
        Timing(**TIMING), coils=_COILS, mass=0.7, inertia=[1e-3] * 3, gravity=[0.1, 0.0, 9.0], lag=1e-3, **START
    ),
    "mujoco, corrected": lambda: MuJoCoPlant(
        Timing(**TIMING), **START, integrator="corrected", record=True, sensor=Sensor(noise=1e-5), current_limit=2.0
    ),
    "mujoco, corrected body, lag": lambda: MuJoCoPlant(
        Timing(**TIMING), **START, integrator="corrected", coils=False, driver_lag=True, longest_step=4e-4, record=True
    ),
    "mujoco, stops": lambda: MuJoCoPlant(Timing(**TIMING), **START, stops=True, stop_damping=True, metered=True),
    "mujoco, soft grip": lambda: MuJoCoPlant(
        Timing(**TIMING), **START, hand=SOFT, hand_force=SpringHand(target=[1e-3] * 6), record=True, force_falloff=0.2
    ),
    "mujoco, flexible": lambda: MuJoCoPlant(Timing(**TIMING), **START, flexible=True, longest_step=2e-4),
    "mujoco, batch with options": lambda: MuJoCoBatchPlant(
        Timing(period=0.002, delay=1e-3, phase=[0.1, 0.7]),
        **PAIR,
        integrator="corrected",
        driver_lag=True,
        hand=SOFT,
        hand_force=lambda tick, time, state: [np.array([0.1, -0.2]), *[1e-3] * 5],
        sensor=Sensor(noise=1e-5, quantum=1e-6),
        record=True,
        metered=True,
        threads=1,
    ),
}
MAKERS = {**PLANTS, **UNRECORDED, **MORE}


def use(plant: SampledPlant, random: Any, ticks: int = 30) -> list[Any]:
    """Use a plant at random; return all that it shows."""
    seen: list[Any] = []
    single = not plant.batch
    for _ in range(ticks):
        sample = plant.read()
        seen.append((sample.tick, np.array(sample.time), sample.pose, *plant.state(), join(plant.hand_wrench)))
        if random.random() < 0.1:
            continue  # a lost sample
        force, pulse = (scale * random.normal(size=(6, *plant.batch)) for scale in (0.3, 1.0))
        force[3:] *= 1e-2
        pulse[3:] *= 1e-2
        walls: tuple[DeviceWall, ...] = ()
        if random.random() < 0.5 and not np.ndim(plant.timing.delay):
            walls = (DeviceWall(2, random.normal() * 1e-3, 1, 1e3, 2.0, random.choice([None, 300.0])),)
        parts = [part.tolist() if single else list(part) for part in (force, pulse)]
        pulsed = random.random() < 0.5
        seen.append(plant.write(Command(parts[0], parts[1] if pulsed else None, 7e-4 * pulsed, walls)).wrench)
        seen.append(join(plant.walls_wrench))
    return seen


def all_of(plant: SampledPlant, seed: Any) -> list[Any]:
    """Return samples, states and commands of a run from release, and in the end trace, work and engine state."""
    seen = use(plant, np.random.default_rng(seed))
    if plant.given.get("record"):
        trace = plant.trace()
        seen.append((trace.time, trace.pose, trace.twist, trace.wrench))
    if plant.given.get("metered"):
        seen.append(np.array(plant.work))
    seen += [
        np.array(getattr(plant, name))
        for name in ("start", "currents", "stop_wrench", "met_stops")
        if hasattr(type(plant), name) and not (name == "currents" and plant.given.get("coils") is False)
    ]
    if isinstance(plant, MuJoCoPlant):
        state = np.empty(mujoco.mj_stateSize(plant._model, mujoco.mjtState.mjSTATE_INTEGRATION))
        mujoco.mj_getState(plant._model, plant._data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
        seen += [state, plant._model.actuator_gainprm.copy(), plant._model.dof_damping.copy()]
    return seen


def disturb(plant: SampledPlant, random: Any) -> None:
    """Do what a new plant has not seen: another hand, an opened coil, currents, and perhaps a divergence."""
    if not plant.batch and random.random() < 0.5:
        plant.hold(SpringHand(target=[2e-3, 0.0, 1e-3, 0.0, 0.0, 0.0], rise_time=0.2))
    if isinstance(plant, MuJoCoPlant | ExactCoilPlant) and plant.given.get("coils") is not False:
        plant.read()
        plant.drive(random.normal(size=6).tolist(), random.normal(size=6).tolist(), 5e-4)
        plant.open_coil(int(random.integers(6)))
    use(plant, random, int(random.integers(20)))
    if random.random() < 0.5:
        with suppress(MaglevError):  # metal stops end no run
            for _ in range(40):
                plant.read()
                plant.write(Command([np.full(plant.batch, part) if plant.batch else part for part in [500.0] * 6]))


@pytest.mark.parametrize(("kind", "seed"), sweep(MAKERS, range(12), every=4))
def test_a_restarted_plant_equals_a_new_one_bit_for_bit(kind: str, seed: int) -> None:
    random = np.random.default_rng([seed, len(kind)])
    with MAKERS[kind]() as plant:
        shape = plant.start[0].shape
        again = plant.timing
        for _ in range(2):
            disturb(plant, random)
            pose, twist = (scale * random.normal(size=shape) for scale in (1e-3, 1e-2))
            if random.random() < 0.5:
                again = replace(again, phase=np.full(np.shape(again.phase), random.random())[()])
            plant.restart(pose, twist, timing=again)
            arguments = {**plant.given, "timing": again, "pose": pose, "twist": twist}
            with type(plant)(**arguments) as new:
                fresh, restarted = (all_of(one, seed) for one in (new, plant))
            same(restarted, fresh)


def same(left: Any, right: Any) -> None:
    """Compare nested arrays bit for bit."""
    assert len(left) == len(right)
    for one, other in zip(left, right, strict=True):
        if isinstance(one, tuple):
            same(one, other)
        else:
            np.testing.assert_array_equal(one, other, strict=True)


REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"pose": [0.0] * 5}, "pose must have shape"),
    ({"pose": [np.nan] * 6}, "pose must be a finite number"),
    ({"pose": np.zeros((3, 6))}, "pose.* must"),
    ({"pose": np.zeros(6), "twist": [0.0, 1.0]}, "twist must have shape"),
    ({"pose": np.zeros(6), "timing": Timing(phase=[0.1, 0.2])}, "phase"),
    ({"pose": np.zeros(6), "timing": Timing(delay=[1e-3, 2e-3])}, "delay"),
    ({"pose": "zero"}, "pose must be"),
]


@pytest.mark.parametrize("kind", ["exact, with options", "mujoco, with options", "exact, coils"])
@pytest.mark.parametrize(("arguments", "message"), REFUSED)
def test_a_refused_restart_changes_nothing(kind: str, arguments: Any, message: str) -> None:
    runs = []
    for attempt in (False, True):
        with MAKERS[kind]() as plant:
            seen = use(plant, np.random.default_rng(1), 5)
            if attempt:
                with pytest.raises(ParameterError, match=message):
                    plant.restart(**arguments)
            runs.append([*seen, *use(plant, np.random.default_rng(2), 5)])
    same(*runs)


class _Once:
    """Sensor that starts once only."""

    started = False

    def start(self) -> Callable[[Any], list[Any]]:
        if self.started:
            raise PlantError("in use")
        self.started = True
        return list


def test_what_cannot_start_again_is_refused_before_anything_changes() -> None:
    for made in (ExactPlant(sensor=_Once()), MuJoCoPlant(sensor=_Once())):
        first = made.read()
        with pytest.raises(PlantError, match="in use"):
            made.restart(np.ones(6))
        assert made.started and made.unanswered is first and made.start[0].tolist() == [0.0] * 6
        made.close()
        with pytest.raises(PlantError, match="closed"):
            made.restart(np.zeros(6))
    with ExactPlant() as plant:
        plant.follow(SimpleNamespace(period=None))
        with pytest.raises(PlantError, match="follow"):
            plant.restart(np.zeros(6))


def test_a_pose_that_is_reused_changes_no_earlier_run() -> None:
    for plant in (ExactPlant(pose=np.zeros((2, 6))), MuJoCoBatchPlant(pose=np.zeros((2, 6)), threads=1)):
        pose = np.zeros((2, 6))
        with plant:
            plant.restart(pose)
            first: Sample = plant.read()
            pose[:] = 1e-3
            assert not first.pose.any() and not plant.start[0].any() and not np.any(plant.given["pose"])


@pytest.mark.parametrize("kind", [MuJoCoPlant, MuJoCoBatchPlant])
def test_restart_after_a_warning_of_the_engine(kind: Any) -> None:
    pose = np.zeros(6) if kind is MuJoCoPlant else np.zeros((2, 6))
    options: Any = {"integrator": "corrected", "coils": False, "escape": (1e15, 1e15), "pose": pose}
    with kind(Timing(phase=0.5), **options) as plant, kind(Timing(phase=0.5), **options) as new:
        plant.read()
        plant.write(Command([1e13] * 6))
        with engine_warnings_silenced(), pytest.raises(PlantError, match="MuJoCo warns"):
            for _ in range(4):
                plant.read()
        plant.restart(pose)
        same(all_of(plant, 0), all_of(new, 0))


def test_restart_and_rewind() -> None:
    with MuJoCoPlant(sensor=Sensor(noise=1e-5)) as plant:
        use(plant, np.random.default_rng(0), 5)
        saved = plant.saved()
        after = use(plant, np.random.default_rng(1), 5)
        plant.restart([1e-3] * 6)
        plant.restore(saved)
        same(use(plant, np.random.default_rng(1), 5), after)
        assert not np.any(plant.start[0]) and "pose" not in plant.given
