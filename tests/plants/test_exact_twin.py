"""Twin in closed form beside the one in the engine: motion, flights, faults, stops."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj import Calibration, Command, find_scene
from maglev_mj.bridge.flight import Flight
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.bridge.twin.fault_injection import InjectedFault
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.bridge.twin.twin import Twin, TwinParameters
from maglev_mj.errors import MaglevError, PlantError
from maglev_mj.frames import ZERO, Array
from maglev_mj.plants import MuJoCoPlant, Timing
from maglev_mj.plants.exact_coils import ExactCoilPlant
from maglev_mj.spec import GRAVITY, INERTIA, RANGE
from tests.published import REST
from tests.sweeps import sweep

KNOWN = Calibration.nominal()
LEVEL = KNOWN.gravity
TILTED = GRAVITY * np.array([math.sin(0.05), 0.0, -math.cos(0.05)])


def exact(timing: Timing | None = None, *, gravity: Array = LEVEL, pose: Any = ZERO, **options: Any) -> ExactCoilPlant:
    return ExactCoilPlant(
        timing or Timing(),
        coils=KNOWN.coils,
        mass=KNOWN.mass,
        inertia=KNOWN.inertia,
        gravity=gravity,
        pose=pose,
        **options,
    )


# motion between the stops


@pytest.mark.parametrize("gravity", [LEVEL, TILTED], ids=["level", "tilted"])
@pytest.mark.parametrize("delay", [0.0, 0.0015, 0.0123])
def test_translation_is_that_of_the_engine_to_rounding(delay: float, gravity: Array) -> None:
    """Forces without torque about an upright flotor, with pulses, from a switch to any other."""
    timing, draw = Timing(delay=delay), np.random.default_rng(1)
    pose = (0.0, 0.0, 0.004, 0.0, 0.0, 0.0)
    one, other = exact(timing, gravity=gravity, pose=pose), MuJoCoPlant(timing, gravity=gravity, pose=pose)
    for _ in range(12):
        poses = np.array(one.read().position), np.array(other.read().position)
        assert np.abs(poses[0] - poses[1]).max() < 1e-12
        forces = draw.normal(0.0, 0.3, (2, 3)) - KNOWN.mass * gravity
        held, pulsed = KNOWN.coils.currents(np.hstack([forces, np.zeros((2, 3))])).tolist()
        after = None if draw.random() < 0.5 else 0.0037
        for plant in (one, other):
            plant.drive(held, pulsed, 0.002, after=after)
        assert one.currents == pytest.approx(other.currents, abs=1e-12)
    assert 1e-4 < np.abs(poses[0] - pose).max() and (np.abs(poses[0]) < RANGE).all()
    assert np.abs(one.state()[1] - other.state()[1]).max() < 1e-11
    assert np.abs(one.load - other.load).max() < 1e-12


@pytest.mark.parametrize("axis", range(3))
def test_a_turned_flotors_currents_give_the_wrench_that_was_asked_for(axis: int) -> None:
    """The inverse map at an angle and the coils' own forces and arms are two derivations."""
    pose = [0.0] * 6
    pose[3 + axis] = 0.08
    plant, period = exact(Timing(delay=0.0), gravity=np.zeros(3), pose=pose), 0.005
    plant.read()
    wrench = np.array([0.3, -0.2, 0.4, 0.002, -0.003, 0.001])
    plant.write(Command(wrench.tolist()))
    plant.read()
    assert plant.state()[1] == pytest.approx(period * wrench / INERTIA, abs=1e-12)


def test_a_turn_is_that_of_the_engine_to_second_order_in_a_segment() -> None:
    """Currents that carry a flotor turn it: the arms of their forces turn with it."""
    apart = []
    for period in (0.008, 0.004, 0.002):
        timing, start = Timing(period=period, delay=0.0), [0.0, 0.0, 0.0, 0.05, 0.0, 0.0]
        plants: list[Any] = [exact(timing, pose=start), MuJoCoPlant(timing, pose=start)]
        for _ in range(round(0.04 / period)):
            for plant in plants:
                plant.read()
                plant.drive(KNOWN.hover.tolist())
        turns = [plant.read().position for plant in plants]
        assert abs(turns[1][3] - 0.05) > 1e-3 and max(map(abs, turns[0][4:])) < 1e-15
        apart.append(abs(turns[0][3] - turns[1][3]))
    assert apart[0] / apart[1] == pytest.approx(4.0, rel=0.1) == apart[1] / apart[2]
    assert apart[1] < 1e-5


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_currents_that_cannot_flow_are_refused(bad: float) -> None:
    plant = exact()
    with pytest.raises(PlantError, match="follow a sample"):
        plant.drive(ZERO)
    plant.read()
    for currents, pulsed in (((bad, *ZERO[1:]), None), (ZERO, (*ZERO[1:], bad))):
        with pytest.raises(PlantError, match="currents must be finite"):
            plant.drive(currents, pulsed, 0.001)


# stops


def energy(plant: ExactCoilPlant, gravity: Array = LEVEL) -> float:
    """Return kinetic and potential energy [J]."""
    pose, twist = plant.state()
    return float(0.5 * (np.array(INERTIA) * twist**2).sum() - KNOWN.mass * pose[:3] @ gravity)


def pushed(axis: int, force: float, phase: float, gravity: Array) -> tuple[ExactCoilPlant, list[float]]:
    """Return a flotor that was pushed for a period, and its energies from then on."""

    def hand(tick: int, time: float, state: Any) -> Sequence[float]:
        return [force * (part == axis) * (tick == 0) for part in range(6)]

    pose = phase * 0.9 * np.array(RANGE)
    plant = exact(pose=pose, gravity=gravity, hand_force=hand)
    for _ in range(2):
        plant.read()
    energies = []
    for _ in range(60):
        energies.append(energy(plant, gravity))
        plant.read()
    return plant, energies


PULLS = {"level": LEVEL, "tilted": TILTED, "none": np.zeros(3)}


@pytest.mark.parametrize(("axis", "pull"), sweep(range(6), PULLS, every=3))
def test_stops_give_no_energy(axis: int, pull: str) -> None:
    """Over speeds up to 3 m/s and 100 rad/s, and distances to the stop."""
    gravity = PULLS[pull]
    sizes = (0.01, 0.3, 3.0) if axis < 3 else (0.3, 9.0, 100.0)
    for size, sense, phase in zip(sizes, (1, -1, 1), (-0.93, 0.71, 0.0), strict=True):
        plant, energies = pushed(axis, sense * size * INERTIA[axis] / 0.005, phase, gravity)
        assert max(np.diff(energies)) < 1e-13
        assert (np.abs(plant.state()[0]) <= RANGE).all()
        if gravity.any():
            assert plant.state()[0][2] == -RANGE[2] and plant.state()[1][2] == 0.0


def test_a_flotor_falls_freely_and_lies_on_its_stop_exactly() -> None:
    plant = exact()
    for tick in range(40):
        position, fallen = list(plant.read().position), 0.5 * GRAVITY * (0.005 * tick) ** 2
        assert position[2] == pytest.approx(-fallen, abs=1e-15) if fallen < RANGE[2] else position[2] == -RANGE[2]
        assert position[:2] + position[3:] == [0.0] * 5
    assert plant.stop_wrench == pytest.approx(-plant.load, abs=1e-12) and plant.load[2] == -KNOWN.mass * GRAVITY


def test_a_touched_stop_slows_motion_along_it_as_in_the_engine() -> None:
    """To 1/e in 20 ms, sliding and turning."""

    def hand(tick: int, time: float, state: Any) -> Sequence[float]:
        return [5.0 * (tick == 0), 0.0, 0.0, 0.0, 0.0, 0.005 * (tick == 0)]

    plant = exact(pose=REST, hand_force=hand)
    speeds = []
    for _ in range(6):
        plant.read()
        speeds.append(plant.state()[1][[0, 5]])
    assert (speeds[1] > (0.01, 0.01)).all()
    assert speeds[5] == pytest.approx(speeds[1] * math.exp(-1.0), rel=1e-9)


def test_a_stop_that_does_not_push_slows_nothing() -> None:
    def hand(tick: int, time: float, state: Any) -> Sequence[float]:
        return [0.0, 0.0, 0.1 * (tick == 0), 0.0, 0.0, 0.0]

    plant = exact(pose=(RANGE[0], 0.0, 0.0, 0.0, 0.0, 0.0), gravity=np.zeros(3), hand_force=hand)
    for _ in range(10):
        plant.read()
    assert plant.state()[1][2] == pytest.approx(0.005 * 0.1 / KNOWN.mass, rel=1e-12)


def test_a_flotor_pressed_to_its_upper_stop_leaves_it_without_a_jump() -> None:
    plant = exact(Timing(delay=0.0))
    for tick in range(36):
        plant.read()
        plant.drive([*[5.0 if tick < 30 else 0.0] * 3, 0.0, 0.0, 0.0])
        if 20 < tick <= 30:
            assert plant.state()[0][2] == RANGE[2] and plant.state()[1][2] == 0.0
            assert plant.stop_wrench[2] == pytest.approx(6.867 - KNOWN.coils.wrench(plant.currents)[2])
    assert plant.state()[0][2] == pytest.approx(RANGE[2] - 0.5 * GRAVITY * (0.005 * 5) ** 2, abs=1e-12)
    assert not plant.stop_wrench.any()


# faults


def test_an_open_coil_gives_no_force_though_its_current_is_commanded() -> None:
    plant = exact(Timing(delay=0.0))
    plant.open_coil(1)
    plant.read()
    plant.drive((1.0, 2.0, 3.0, 0.0, 0.0, 0.0))
    plant.read()
    force = KNOWN.coils.wrench(np.array([1.0, 0.0, 3.0, 0.0, 0.0, 0.0]))
    assert plant.state()[1] == pytest.approx(0.005 * (force + plant.load) / INERTIA, abs=1e-12)
    assert plant.currents[1] == 2.0


def flown(plant: str, folder: Path, kind: type, hand: Any = None, **parameters: Any) -> tuple[str, Array]:
    """Return the outcome of a flight, and pose, twist and mean currents of the period before at each sample."""
    twin = Twin(TwinParameters(plant=plant, **parameters), hand_force=hand, draw=lambda: 7)
    assert isinstance(twin.plant, kind)
    rows, take = list[Array](), twin.sample

    def sample() -> bytes | None:
        frame = take()
        spans = [span * np.array(currents) for span, currents in twin.plant.intervals]
        rows.append(np.concatenate([*twin.plant.state(), np.sum(spans, axis=0) / 0.005 if spans else np.zeros(6)]))
        return frame

    twin.sample = sample  # type: ignore[method-assign]
    with RemotePlant(VirtualLink(twin), folder=folder) as host:
        scene = find_scene("joystick")().replace(period=host.period, delay=host.delay)
        try:
            landing = Flight(host, scene).run(1.0).landing
            outcome = "landed" if landing.at_rest and not landing.reason else str(landing)
        except MaglevError as error:
            outcome = str(error)
    return outcome, np.array(rows)


def nudge(tick: int, time: float, state: Any) -> Sequence[float]:
    return [1.5 * (1.4 < time < 1.6), 0.0, -2.0 * (1.5 < time < 1.7), 0.0, 0.01 * (1.4 < time < 1.6), 0.0]


KINDS = {"exact": ExactCoilPlant, "mujoco": MuJoCoPlant}


def test_flights_on_both_plants_agree(tmp_path: Path) -> None:
    """Without noise or steps of a sensor; an angle differs by the middle rule's error, and with it the currents."""
    both = [flown(plant, tmp_path, kind, nudge, noise=0.0, quantum=1e-12) for plant, kind in KINDS.items()]
    assert [outcome for outcome, _ in both] == ["landed", "landed"]
    one, other = (rows[round(1.25 * 200) : round(1.75 * 200) + 1] for _, rows in both)
    apart, size = np.abs(one - other).max(axis=0), np.abs(other).max(axis=0)
    assert apart[:3].max() < 5e-11 and apart[6:9].max() < 5e-9
    assert apart[3:6].max() < 1e-4 * size[3:6].max() and apart[12:].max() < 2e-5
    assert (size[[0, 2]] > 3e-3).all() and size[4] > 0.03


def test_a_dead_coil_is_found_at_takeoff_of_the_twin_in_closed_form(tmp_path: Path) -> None:
    fault = InjectedFault(kind="dead-coil", which=0, at=0.05)
    outcome = flown("exact", tmp_path, ExactCoilPlant, faults=[fault])[0].split(";")[0]
    assert outcome in (
        "COIL_NOT_FOLLOWING: reported by the device",
        "no flight: coil 0 gives 0 % of its calibrated force",
    )
