"""Walls on a device: equal to the plants', safe without a host and with faults, refused before takeoff."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj import find_scene
from maglev_mj.bridge import DeviceFault, Fault, RemotePlant, State
from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.connection import Connection
from maglev_mj.bridge.flight import Flight
from maglev_mj.bridge.flight_guards import Alarm
from maglev_mj.bridge.observer import HandObserver
from maglev_mj.bridge.preflight import assess, on_device
from maglev_mj.bridge.residual import Residual
from maglev_mj.bridge.twin import twin as twins
from maglev_mj.bridge.twin.fault_injection import InjectedFault
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.bridge.twin.twin import Twin, TwinParameters
from maglev_mj.bridge.wire import MOST_WALLS, Codec, Estop
from maglev_mj.control import Bias, Hold, Law, Wall, drive
from maglev_mj.control.controller import Controller
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array, Command, DeviceWall
from maglev_mj.plants import ExactPlant, MuJoCoBatchPlant, MuJoCoPlant, Timing
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.stability_check import check_step
from maglev_mj.scenes.wall_scene import others
from maglev_mj.theory.verdict import judge
from tests.bridge.firmware_core import CoreFirmware
from tests.bridge.slow_lines import Flown, fly, residual
from tests.bridge.test_preflight import GOOD
from tests.sweeps import further

LIFT = [0.0, 0.0, 0.7 * 9.81, 0.0, 0.0, 0.0]
WEIGHT = Bias(LIFT)
QUIET: Any = {"noise": 0.0, "quantum": 0.0, "plant": "exact"}
STOPPED = 0.15  # [m/s]


def armed(plant: RemotePlant) -> None:
    """Arm in the air, without takeoff; a device renders walls from its first sample in flight on."""
    plant.read()
    plant.arm()
    plant.read()


def flown(controller: Controller, parameters: TwinParameters, ticks: int = 60, **twin: Any) -> tuple[Twin, list[Any]]:
    """Arm a twin that starts in the air, without takeoff; return it and its true poses at the samples."""
    device, poses = Twin(parameters, draw=lambda: 7, **twin), []
    with RemotePlant(VirtualLink(device)) as plant:
        armed(plant)
        controller.reset()
        drive(plant, controller, ticks, observe=lambda *_: poses.append(device.pose))
    return device, poses


def simulated(made: Any, controller: Controller, start: Sequence[float]) -> Array:
    """Return the poses of a plant at the samples of `flown`."""
    rows: list[Array] = []
    controller.reset()
    with made(Timing(period=0.005, delay=0.0015), mass=0.7, pose=start) as plant:
        plant.read(), plant.read()
        drive(plant, controller, 60, observe=lambda sample, _: rows.append(sample.pose))
    return np.array(rows)


def walls(seed: int) -> tuple[Controller, list[float]]:
    """Return a lower wall along z, an upper one along x, and the flotor's pose at the start."""
    random = np.random.default_rng(seed)
    lower, upper = (
        Wall(axes="z", lower=0.0, on="device", cutoff=(None, 300.0)[seed % 2], stiffness=k, damping=0.0025 * k + 40.0)
        if axis == "z"
        else Wall(axes="x", upper=3e-4, on="device", stiffness=k, damping=0.0025 * k + 40.0)
        for axis, k in zip("zx", 10.0 ** random.uniform(3.8, 4.9, 2))
    )
    push = Bias([*random.uniform(1.0, 5.0, 1), 0.0, 0.0, 0.0, 0.0, 0.0])
    return Controller([lower, upper, push], period=0.005), [0.0, 0.0, random.uniform(4e-4, 6e-4), 0.0, 0.0, 0.0]


C = pytest.param("c", marks=pytest.mark.needs("compiler"))


@pytest.mark.parametrize("device", ["exact", "mujoco", C])
@pytest.mark.parametrize("seed", [0, 1, *further(*range(2, 200))])
def test_a_device_renders_as_the_plants(seed: int, device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if device == "c":
        monkeypatch.setattr(twins, "Firmware", CoreFirmware)
    monkeypatch.setattr(Residual, "currents", lambda residual: None)  # the plants have no probe
    controller, start = walls(seed)
    kind = {} if device == "c" else {"plant": device}
    for lockstep in (False, True):
        _, poses = flown(controller, TwinParameters(**QUIET | kind, pose=start, lockstep=lockstep))
        for made in (ExactPlant, MuJoCoPlant):
            # with a cutoff a plant's filter begins later: samples far from an edge are skipped
            bound = 1e-15 if seed % 2 == 0 else 1e-5
            assert np.abs(np.array(poses) - simulated(made, controller, start))[:, :3].max() < bound
    assert min(pose[2] for pose in poses) < 0.0 and max(pose[0] for pose in poses) > 3e-4


@pytest.mark.parametrize("device", ["exact", C])
def test_a_repeated_answer_changes_nothing(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if device == "c":
        monkeypatch.setattr(twins, "Firmware", CoreFirmware)
    controller, start = walls(0)
    parameters, send = TwinParameters(**QUIET, pose=start, lockstep=True), Connection.command
    _, once = flown(controller, parameters)
    monkeypatch.setattr(Connection, "command", lambda *answer: (send(*answer), send(*answer)))
    assert np.array_equal(once, flown(controller, parameters)[1])


@pytest.mark.parametrize("on", ["device", "host"])
def test_one_controller_on_five_plants(on: str, monkeypatch: pytest.MonkeyPatch) -> None:
    wall = Wall(axes="z", lower=0.0, stiffness=6e3, damping=80.0, on=on)
    controller, start, timing = Controller([wall], period=0.005), [0.0, 0.0, 1e-3, 0.0, 0.0, 0.0], Timing()
    ends = [flown(controller, TwinParameters(**QUIET, pose=start), 80)[1][-1][2]]
    many = [start, [0.0, 0.0, 2e-3, 0.0, 0.0, 0.0]]
    for made, pose in ((ExactPlant, start), (MuJoCoPlant, start), (ExactPlant, many), (MuJoCoBatchPlant, many)):
        controller.reset()
        with made(timing, mass=0.7, pose=pose) as plant:
            ends += np.ravel(drive(plant, controller, 80).position[2]).tolist()
    assert ends == pytest.approx([-0.7 * 9.81 / 6e3] * 7, abs=2e-6)


def test_a_turned_flotor_meets_the_wall_in_its_place() -> None:
    controller = Controller([Wall(axes="z", lower=0.0, stiffness=3e4, damping=150.0, on="device")], period=0.005)
    for turn in ([0.06, -0.06, 0.0], [0.03, 0.06, 0.06]):
        start = [1e-3, -1e-3, 1e-3, *turn]
        _, poses = flown(controller, TwinParameters(**QUIET, pose=start))
        assert np.abs(np.array(poses) - simulated(ExactPlant, controller, start))[:, 2].max() < 2e-5


def test_a_cut_between_samples_ends_the_walls_then() -> None:
    wall = Wall(axes="z", lower=0.0, stiffness=6e3, damping=80.0, on="device")
    device = Twin(TwinParameters(**QUIET, pose=[0.0, 0.0, 1e-3, 0.0, 0.0, 0.0]))
    plant = RemotePlant(VirtualLink(device))
    armed(plant)
    drive(plant, Controller([wall], period=0.005), 80)
    height = device.pose[2]
    device.receive(Codec().encode(0, 0, 0, Estop(1)), device.tick * 5_000_000 + 4_000_000, "anyone")
    device.sample()
    assert device.pose[2] - height == pytest.approx(-0.5 * 9.81 * 1e-6, rel=1e-3)  # it falls for 1 ms


class Moving(Law):
    """Wall on the device along z, whose edge jumps at a sample."""

    on = "device"

    def __init__(self, jump: float, side: int) -> None:
        self._jump, self._side = jump, side

    def start(self) -> Any:
        return 0

    def __call__(self, position: Any, velocity: Any, state: Any, wrench: Any) -> Any:
        return state + 1, None

    def device_walls(self, state: Any) -> Sequence[DeviceWall]:
        return (DeviceWall(2, self._jump * (state > 40), self._side, 6e4, 200.0),)


def safe(stiffness: float, damping: float, *laws: Law) -> Controller:
    """Return a wall on the device with the weight carried and the other axes held."""
    wall = laws or (Wall(axes="z", lower=0.0, stiffness=stiffness, damping=damping, on="device"),)
    inertia = [0.7, 0.7, 0.00093, 0.00093, 0.00082]
    hold = Hold.critically_damped(others("z"), inertia=inertia, period=0.005, delay=0.0015)
    return Controller([*wall, WEIGHT, hold], period=0.005)


FLIGHTS: dict[str, tuple[Controller, Fault]] = {
    "host killed": (safe(6e4, 200.0), Fault.WATCHDOG),
    "host killed, K at its limit": (safe(1e5, 400.0), Fault.WATCHDOG),
    "host killed, spring on both sides": (safe(0.0, 0.0, Moving(0.0, 0)), Fault.WATCHDOG),
    "K at its limit": (safe(1e5, 200.0), Fault(0)),
    "edge jumps up": (safe(0.0, 0.0, Moving(3e-3, 1)), Fault.INVALID_COMMAND),
    "edge jumps up, unnoticed by the host": (safe(0.0, 0.0, Moving(3e-3, 1)), Fault.INVALID_COMMAND),
}


@pytest.mark.parametrize("push", [0.0, 5.0])
@pytest.mark.parametrize("name", FLIGHTS)
def test_no_flight_with_a_fault_is_fast(name: str, push: float, monkeypatch: pytest.MonkeyPatch) -> None:
    controller, fault = FLIGHTS[name]
    speeds: list[float] = []
    device = Twin(TwinParameters(plant="exact", pose=[0.0] * 6), draw=lambda: 7)
    device.plant.hold(lambda *_: (0.0, 0.0, -push, 0.0, 0.0, 0.0))
    link, sample = VirtualLink(device), device.sample

    def observed() -> bytes | None:
        frame = sample()
        if device.tick > 40:  # after the unguided start
            speeds.append(float(np.abs(device.plant.state()[1][:3]).max()))
        return frame

    device.sample = observed  # type: ignore[method-assign]
    plant = RemotePlant(link)
    if "unnoticed" in name:
        monkeypatch.setattr(plant, "_on_device", plant.check_walls)
    armed(plant)
    controller.reset()
    try:
        drive(plant, controller, 40 if "killed" in name else 100)
    except DeviceFault:
        assert fault
    link.receive(0.7) if not fault else [link.receive(0.005) for _ in range(140)]
    assert device.firmware.faults == fault and max(speeds) < STOPPED
    if fault:  # set down
        assert device.firmware.state == State.FAULT and not device.plant.currents.any()
        assert device.pose[2] < -0.0044


@pytest.mark.parametrize(
    ("kind", "fault"), [("stuck-diodes", Fault.SENSOR_FROZEN), ("nan-spot", Fault.SENSOR_OUT_OF_RANGE)]
)
def test_a_failed_sensor_cuts_the_walls_within_their_own_samples(kind: str, fault: Fault) -> None:
    device = Twin(TwinParameters(plant="exact", pose=[0.0] * 6, faults=[InjectedFault(kind=kind, which=0, at=0.3)]))
    with RemotePlant(VirtualLink(device)) as plant, pytest.raises(DeviceFault) as raised:
        armed(plant)
        drive(plant, safe(6e4, 200.0), 200)
    assert raised.value.faults & fault
    assert device.firmware._fault_time * 1e-9 - 0.3 < (0.04 if fault is Fault.SENSOR_FROZEN else 0.006)


@pytest.mark.parametrize("stiffness", [2e4, 1e5])
def test_a_wall_that_generates_energy_is_removed(stiffness: float) -> None:
    device = Twin(TwinParameters(plant="exact", pose=[0.0] * 6), draw=lambda: 7)
    device.plant.hold(lambda *_: (0.0, 0.0, -5.0, 0.0, 0.0, 0.0))
    with RemotePlant(VirtualLink(device)) as plant, pytest.raises(DeviceFault, match="WALL_ENERGY"):
        armed(plant)
        drive(plant, safe(stiffness, 0.0), 200)


REFUSED: list[tuple[Callable[[], object], str]] = [
    (lambda: checked(Drop(wall_on="device", stiffness=3e5)), "stiffness of the wall on z .* 100000 N/m, the device's"),
    (lambda: checked(Drop(wall_on="device", damping=500.0)), "damping of the wall on z .* 400 N s/m, the device's"),
    (lambda: checked(Drop(wall_on="device"), wall_period=0.0), "renders no walls"),
    (lambda: check_step(safe(6e3, 80.0), safe(6e4, 80.0), [0, 0, -1e-3, 0, 0, 0]), "force step on z .*54 N"),
    (lambda: plant_of().check_walls([DeviceWall(0)] * (MOST_WALLS + 1)), "at most 12 walls"),
    (lambda: plant_of().check_walls([DeviceWall(4, 0.0, 1, 100.0)]), "on ry .* 90 N m/rad"),
    (
        lambda: plant_of().check_walls([DeviceWall(2, 0.0, side, 6e4) for side in (-1, 0)]),
        "sum of the stiffness of the walls that push towards -z must be at most 100000 N/m, the device's .*120000",
    ),
    (
        lambda: plant_of().check_walls([DeviceWall(3, 0.0, 1, 0.0, 0.2) for _ in range(2)]),
        r"sum of the damping of the walls that push towards \+rx must be at most 0.36 N m s/rad",
    ),
    (lambda: drive(plant_of(wall_period=0.0), safe(6e3, 80.0), 1), "cannot render walls on the device"),
]


def plant_of(**parameters: Any) -> RemotePlant:
    return RemotePlant(VirtualLink(Twin(TwinParameters(**parameters))))


def checked(scene: Drop, **parameters: Any) -> object:
    return on_device(scene, plant_of(**parameters))


@pytest.mark.parametrize(("make", "message"), REFUSED)
def test_refused_before_takeoff(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        make()


def test_the_check_before_takeoff_judges_two_rates() -> None:
    plant = plant_of(wall_period=5e-4, wall_delay=1e-4)
    scene = on_device(Drop(wall_on="device", stiffness=6e4, damping=200.0), plant)
    assert isinstance(scene, Drop) and (scene.device_period, scene.device_delay) == (5e-4, 1e-4)
    inertia = plant.calibration.body.inertia
    assert not assess(scene, inertia, GOOD, True).problem
    weak = on_device(Drop(wall_on="device", stiffness=9e4, damping=5.0), plant)
    assert "unstable" in assess(weak, inertia, GOOD, True).problem
    # the host's spring is stable by the damper on the device alone
    beside = Drop(stiffness=2e4, damping=20.0, pulse=0.0)
    margins = [
        judge(each.controller(), delay=0.0).critical_delay for each in (beside, beside.replace(device_damping=100.0))
    ]
    assert margins[0] == 0.0 and margins[1] > 0.0015


# the host's observers, by the measured currents


def on_wall(name: str, stiffness: float, damping: float, *, rate: int = 200, **options: Any) -> Flown:
    """Fly a scene with its walls on the device."""
    scene = find_scene(name)().replace(wall_on="device", stiffness=stiffness, damping=damping)
    return fly(name, rate=rate, scene=scene, critical_delay=0.02, **options)


def jittery(seed: int) -> Callable[[float], float]:
    """Return the delay of a line on which every second pair of frames arrives in reverse order [s]."""
    draw = random.Random(seed)
    return lambda time: 3e-4 + draw.expovariate(1.0 / 1.5e-4)


@pytest.mark.parametrize(
    ("name", "rate", "hand", "delay", "wall"),
    [
        ("drop", 200, "8", 5, (6e4, 200.0)),
        ("press", 200, "5", 4, (1e5, 400.0)),
        ("press", 1000, "5", 3, (6e4, 200.0)),
        *further(*product(["drop", "press"], [200], ["5", "8"], [4, 5], [(6e4, 200.0), (1e5, 400.0)])),
        *further(*product(["drop", "press"], [1000], ["5", "8"], [2, 3, 5], [(6e4, 200.0), (1e5, 400.0)])),
    ],
)
def test_a_delayed_sensor_on_a_wall_ends_the_flight(
    name: str, rate: int, hand: str, delay: int, wall: tuple[float, float], tmp_path: Path
) -> None:
    faults = [InjectedFault(kind="late-sensor", which=delay, at=1.5)]
    flown = on_wall(name, *wall, rate=rate, hand=hand, faults=faults, seconds=0.5, delay=jittery(1), folder=tmp_path)
    assert "HOST: the sensor is delayed by" in flown.outcome and "walls on the device removed" in flown.outcome
    active = flown.rows[flown.rows[:, 14] == State.ACTIVE]
    # it grows while a probe of at least 15 ms tells it from a hand
    assert np.linalg.norm(active[:, 7:10], axis=1).max() < (0.30 if wall[0] < 1e5 else 0.40)
    # with the controlled stop, without walls and with the hand
    assert flown.speeds(1.5).max() < (0.35 if wall[0] < 1e5 else 0.40)


@pytest.mark.parametrize(
    ("name", "rate", "hand", "wall", "force", "torque"),
    [
        ("drop", 1000, "8", (6e4, 200.0), 0.02, 0.5e-3),
        ("corner", 200, "20", (6e3, 80.0), 0.1, 1e-3),  # turned by 60 mrad
        *further(*product(["drop", "press"], [1000], ["20", "tap"], [(1e5, 400.0)], [0.02], [1e-3])),
        *further(*product(["drop", "press"], [200], ["20", "tap"], [(1e5, 400.0)], [0.5], [1e-3])),
    ],
)
def test_the_hand_is_observed_in_contact_with_a_wall_on_the_device(
    name: str, rate: int, hand: str, wall: tuple[float, float], force: float, torque: float, tmp_path: Path
) -> None:
    flown = on_wall(name, *wall, rate=rate, hand=hand, seconds=0.4 if rate == 1000 else 1.0, folder=tmp_path)
    (force_rms, torque_rms), _ = residual(flown, name, hand, rate)
    assert flown.outcome == "landed" and 0.0 < force_rms < force and torque_rms < torque


@pytest.mark.study
@pytest.mark.parametrize("rate", [200, 1000])
def test_good_flights_with_walls_on_the_device_show_no_delay(rate: int, tmp_path: Path) -> None:
    walls = (6e3, 80.0), (6e4, 200.0), (1e5, 400.0)
    for seed, (name, hand, wall) in enumerate(product(("drop", "press", "corner"), ("none", "8", "20", "tap"), walls)):
        if name == "corner" and wall[0] > 6e4:  # refused: too stiff about y
            continue
        flown = on_wall(name, *wall, rate=rate, hand=hand, seed=seed, delay=jittery(seed), folder=tmp_path)
        assert "sensor" not in flown.outcome


def test_currents_of_walls_on_the_device_are_added_to_the_sent_ones() -> None:
    observer = HandObserver(Calibration.nominal(), 0.005, 0.0015)
    flowed: list[Any] = []
    observer._add = lambda now, intervals: flowed.append(intervals)  # type: ignore[method-assign]
    for tick, measured in enumerate((None, [1.0] * 6, None, [2.0] * 6, [3.0] * 6)):
        observer.measured = measured
        observer.sampled(tick, 1, [0.0] * 6, tick - 1, 0.0015)
    assert [sum(duration for duration, _ in intervals) for intervals in flowed] == [0.005] * 5
    currents = [[drive[1][0] for _, drive in intervals] for intervals in flowed]
    assert currents == [[0.0], [0.0, 0.0, 0.0, 1.0], [0.0], [0.0, 0.0, 0.0, 2.0], [0.0, 0.0, 2.0, 3.0]]


def standing(device: Twin | None = None) -> RemotePlant:
    """Return a plant with a wall on its device that carries the flotor."""
    device = device or Twin(TwinParameters(plant="exact", pose=[0.0] * 6), draw=lambda: 7)
    plant = RemotePlant(VirtualLink(device))
    armed(plant)
    drive(plant, safe(6e4, 200.0), 20)
    return plant


def test_walls_stand_until_a_command_without_them_arrives() -> None:
    plant = standing()
    assert plant._hand.measured is not None
    for _ in range(6):  # a stall, shorter than the watchdog's
        plant.read()
        assert plant._hand.measured is not None and not plant.failing_coil
    plant.write(Command(LIFT))
    sent = plant.samples.tick
    while plant._hand.measured is not None:
        plant.read()
        plant.write(Command(LIFT))
    assert plant.answers.answered_tick > sent and plant.samples.tick - sent == 4  # three with their currents


def test_walls_stand_while_the_commands_without_them_are_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    plant = standing()
    monkeypatch.setattr(plant._connection, "command", lambda command: None)
    for _ in range(6):
        plant.write(Command(LIFT))
        plant.read()
        assert plant._hand.measured is not None


def test_a_device_that_was_armed_again_has_no_walls() -> None:
    device = Twin(TwinParameters(plant="exact", pose=[0.0] * 6), draw=lambda: 7)
    plant = standing(device)
    plant.disarm()
    armed(plant)
    assert plant._hand.measured is None and not device.firmware.walled


@pytest.mark.parametrize(
    ("moved", "periods", "refused"), [(0.99, 1, ""), (1.01, 1, "move by at most 0.0005 m"), (2.5, 3, "")]
)
def test_the_host_refuses_an_edge_that_the_device_refuses(moved: float, periods: int, refused: str) -> None:
    plant = standing()
    wall = DeviceWall(2, 0.0, 1, 6e4, 200.0)
    for _ in range(periods - 1):  # one was read after the last command
        plant.read()
    command = Command(LIFT, walls=(wall._replace(edge=-moved * 0.1 * 0.005),))
    if refused:
        with pytest.raises(DeviceFault, match=f"INVALID_COMMAND: edge of the wall on z must {refused}"):
            plant.write(command)
    else:
        plant.write(command)


def test_the_host_refuses_a_wall_that_starts_around_the_flotor() -> None:
    plant = standing()
    plant.write(Command(LIFT))
    plant.read()
    with pytest.raises(DeviceFault, match=r"edge of the wall on z must start around the flotor by at most 0\.0005 m"):
        plant.write(Command(LIFT, walls=(DeviceWall(2, plant.pose[2] + 6e-4, 1, 6e4, 200.0),)))


def test_a_delay_that_was_known_before_the_flight_does_not_end_it() -> None:
    plant = plant_of()
    flight, walls = Flight(plant, Drop(wall_on="device"), critical_delay=0.02), [DeviceWall(2, 0.0, 1, 6e3, 80.0)]
    flight._sensor_delay = 0.0049
    assert flight._check_sensor(0.005, walls) == ""
    assert flight._check_sensor(0.01, walls) == "the sensor is delayed by at least 10.0 ms; walls on the device removed"
    assert flight._check_sensor(0.01) == ""
    sent: list[Any] = []
    plant._send = lambda *answer: sent.append(answer)  # type: ignore[method-assign]
    with pytest.raises(DeviceFault, match="HOST: delayed"):
        plant.state = State.ACTIVE
        plant.end(Alarm(Fault.HOST, "delayed", removes_walls=True))
    assert not sent  # no walls to remove
