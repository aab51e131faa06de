"""Flights behind a wire, in virtual time: bitwise those of the simulation, and over bad lines."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import maglev_mj
from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.fault import HandshakeError
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.bridge.safety import HostLimits
from maglev_mj.bridge.twin import firmware
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.bridge.twin.twin import Twin, TwinParameters
from maglev_mj.bridge.wire import State
from maglev_mj.control import Bias, FiniteDifference, Hold
from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import Plant, drive
from maglev_mj.frames import Array, Command, Sample
from maglev_mj.plants import MuJoCoPlant, SpotSensor
from maglev_mj.plants.hand import HandForce, SpringHand, Trajectory
from maglev_mj.scenes import find_scene
from tests.bridge.impaired import ImpairedLine, Impairment
from tests.published import INERTIA, REST, WEIGHT
from tests.recorded import command_row
from tests.sweeps import further

ZERO = (0.0,) * 6
CENTRE = ZERO
NOISE: dict[str, Any] = {"quantum": 8e-7, "noise": 4e-7, "seed": 3}
REACH = 0.0015
"""Delay of a command on a line without delay [s]."""
BAD_REACH = 0.010
"""Delay on the bad line, with lost samples [s]."""
BAD = Impairment(loss=0.05, delay=0.002, jitter=0.002, duplicate=0.02, corrupt=0.01)
TOUR = Trajectory(
    [0.7, 1.0, 1.3, 1.6, 1.9],
    [ZERO, (0.012, 0.004, 0, 0, 0.1, 0), (-0.01, 0.01, 0.005, 0.1, 0, 0.1), (0, -0.012, 0, 0.1, 0, -0.1), ZERO],
)
"""Path of the hand, to and fro, after takeoff.

Against a hold that yields by a sixth of the way.
"""


class Witness:
    """Hand that records the flotor's true motion."""

    def __init__(self, hand: HandForce | None) -> None:
        self.hand = hand
        self.poses: list[Array] = []
        self.twists: list[Array] = []

    def __call__(self, tick: int, time: Any, state: Callable[[], tuple[Array, Array]]) -> Sequence[Any]:
        pose, twist = state()
        self.poses.append(pose)
        self.twists.append(twist)
        return ZERO if self.hand is None else self.hand(tick, time, state)


class Rig:
    """Twin and host at the ends of a virtual wire.

    Args:
        impairment: Impairment of the wire.
        hand: Hand on the flotor.
        kind: Kind of the host's end.
        host: Keywords of the host's end.
        key: Key of both ends.
        parameters: Parameters of the twin.
    """

    def __init__(
        self,
        impairment: Impairment | None = None,
        *,
        hand: HandForce | None = None,
        kind: type[RemotePlant] = RemotePlant,
        host: dict[str, Any] | None = None,
        key: bytes | None = None,
        **parameters: Any,
    ) -> None:
        self.witness = Witness(hand)
        self.twin = Twin(TwinParameters(**parameters), key=key, hand_force=self.witness, draw=lambda: 7)
        self.link = VirtualLink(self.twin, ImpairedLine(impairment or Impairment()))
        self.plant = kind(self.link, key=key, **(host or {}))
        self.rows: list[list[float]] = []

    @property
    def poses(self) -> Array:
        """True poses at all samples [m, rad], (N, 6)."""
        return np.array(self.witness.poses)

    def fly(
        self, seconds: float, controller: Controller | None = None, *, observe: Callable[[], object] | None = None
    ) -> Array:
        """Fly, by default a soft hold; return the true poses.

        The shape is (N, 6).
        """
        start = len(self.witness.poses)

        def keep(sample: Sample, command: Command) -> None:
            self.rows.append([*sample.position, *command_row(command)])
            if observe is not None:
                observe()

        period = self.plant.period
        drive(self.plant, controller or hover(period, REACH), round(seconds / period), observe=keep)
        return self.poses[start:]

    def currents(self) -> Sequence[float]:
        """Advance one sample; return the largest currents [A], (6,)."""
        self.twin.sample()
        flowed = [currents for _, currents in self.twin.plant.intervals] + [tuple(self.twin.plant.currents)]
        return np.abs(flowed).max(axis=0).tolist()  # type: ignore[no-any-return]


def hover(period: float, reach: float, frequency: float | None = None) -> Controller:
    """Return a hold that carries the flotor.

    As soft as the delay requires, or critically damped.
    """
    if frequency is None:
        hold = Hold.critically_damped(inertia=INERTIA, period=period, delay=reach)
    else:
        hold = Hold(stiffness=INERTIA * frequency**2, damping=2.0 * INERTIA * frequency)
    return Controller([Bias(WEIGHT), hold], period=period)


def rms(poses: Array) -> float:
    """Return the rms distance from the centre [m]."""
    return float(np.sqrt((poses[:, :3] ** 2).sum(axis=1).mean()))


# where a scene starts, and with which settings
STARTS: dict[str, tuple[tuple[float, ...], dict[str, Any]]] = {
    "drop": ((0.0, 0.0, 0.004, 0.0, 0.0, 0.0), {"pulse": 153.0}),
    "table": ((1e-3, 0.0, 0.0, 0.0, 0.0, 0.0), {"friction": True}),
    "joystick": ((1e-3, -5e-4, 2e-3, 0.01, 0.02, -0.01), {"friction": True}),
}
TIMINGS = ((0.005, 0.0015), (0.001, 0.0015), (0.005, 0.007))  # the last two with a delay of more than a period
SAME: list[Any] = [
    *further(*((name, *timing, {}, None) for name in STARTS for timing in TIMINGS)),
    # so hard that the currents' limit is met
    ("drop", 0.001, 0.0004, {"stiffness": 20_000.0, "pulse": 1000.0, "pulse_width": 6e-4}, None),
    ("joystick", 0.005, 0.007, {}, [8.6, 8.6, 8.6, 0.01, 0.01, 0.01]),
]


@pytest.mark.parametrize(("name", "period", "delay", "changes", "wrench_limit"), SAME)
def test_the_same_controller_flies_a_device_bit_for_bit(
    name: str, period: float, delay: float, changes: dict[str, Any], wrench_limit: list[float] | None
) -> None:
    start, usual = STARTS[name]
    scene = find_scene(name)().replace(period=period, delay=delay, **(usual | changes))
    times = period * np.array([10, 100, 170, 260])
    hands = [SpringHand(target=Trajectory(times, np.asarray(TOUR.poses)[:4])) for _ in range(2)]

    def answers(plant: Plant) -> Array:
        rows: list[list[float]] = []
        drive(plant, scene.controller(), 300, observe=lambda one, two: rows.append([*one.position, *command_row(two)]))
        return np.array(rows)

    local = answers(
        MuJoCoPlant(
            scene.timing(),
            pose=start,
            current_limit=10.0,
            wrench_limit=wrench_limit,
            sensor=SpotSensor(**NOISE),
            stops=True,
            stop_damping=True,
            hand_force=hands[0],
        )
    )
    twin = Twin(TwinParameters(period=period, delay=delay, lockstep=True, pose=start, **NOISE), hand_force=hands[1])
    limits = (
        HostLimits() if wrench_limit is None else HostLimits(force_limit=wrench_limit[0], torque_limit=wrench_limit[3])
    )
    with RemotePlant(VirtualLink(twin), limits=limits) as plant:
        plant.arm()
        remote = answers(plant)
        assert plant.samples.lost == plant.samples.skipped == 0 and not plant.faults
    assert remote.shape == (300, 19) and (remote == local).all()
    assert np.ptp(local[:, :3], axis=0).max() > 1e-3  # it does move
    total = np.abs(local[:, 6:12] + local[:, 12:18])
    if changes or wrench_limit is not None:  # and what was asked for is more than is borne
        most = plant.calibration.coils.largest_wrench(10.0) if changes else np.asarray(wrench_limit)
        met = [2] if changes else [3, 4, 5]
        assert total.max(axis=0)[met] == pytest.approx(most[met])


def test_commands_are_limited_and_the_host_gets_the_applied_ones() -> None:
    rig = Rig(pose=CENTRE, host={"limits": HostLimits(force_limit=9.0)})
    plant, coils = rig.plant, rig.plant.calibration.coils
    plant.arm()
    plant.read()
    applied = plant.write(Command([1000.0, 0.0, *WEIGHT[2:]]))
    assert applied.force == pytest.approx([9.0, *WEIGHT[1:]])
    rig = Rig(pose=CENTRE)
    plant = rig.plant
    plant.arm()
    plant.read()
    applied = plant.write(Command([0.0, 0.0, 1000.0, 0.0, 0.0, 0.0], [0.0, 0.0, -1000.0, 0.0, 0.0, 0.0], 0.003))
    assert applied.extra is not None and applied.force[2] == pytest.approx(60.0)
    assert coils.currents(np.array(applied.force)) == pytest.approx([10.0] * 3 + [0.0] * 3, abs=1e-9)
    assert np.add(applied.force, applied.extra) == pytest.approx(ZERO, abs=1e-9)
    twice = plant.write(applied)
    assert twice.force == pytest.approx(applied.force) and twice.extra == pytest.approx(applied.extra)
    plant.read()
    assert rig.twin.firmware.state == State.ACTIVE  # rounding is no over-current
    assert max(abs(current) for _, one in rig.twin.plant.intervals for current in one) == pytest.approx(10.0)


@pytest.mark.parametrize(
    ("period", "most"),
    [pytest.param(0.005, 4.7e-6, id="200 Hz"), pytest.param(0.001, 3.7e-6, id="1 kHz", marks=pytest.mark.study)],
)
def test_it_takes_off_hovers_and_lands(period: float, most: float) -> None:
    rig = Rig(period=period)
    rig.plant.takeoff()
    assert rms(rig.fly(2.0)) < most
    assert rms(rig.poses[-round(1.0 / period) :]) < 1e-6
    rig.plant.land()
    assert rig.plant.state == rig.twin.firmware.state == State.INACTIVE and not rig.plant.faults
    assert np.abs(rig.twin.pose - REST).max() < 2e-4
    rig.currents()
    assert rig.currents() == [0.0] * 6
    assert np.abs(rig.twin.pose - REST).max() < 2e-4


@pytest.mark.parametrize(
    ("seed", "seconds"),
    [(0, 2.0), *(pytest.param(*case, marks=pytest.mark.study) for case in ((0, 20.0), (1, 5.0), (2, 5.0)))],
)
def test_it_hovers_over_a_bad_link(seed: int, seconds: float) -> None:
    rig = Rig(replace(BAD, seed=seed))
    rig.plant.takeoff()
    poses = rig.fly(seconds, hover(0.005, BAD_REACH))
    assert rms(poses) < 25e-6
    assert not rig.twin.firmware.faults and not rig.plant.faults
    assert rig.plant.samples.lost > 0.03 * len(poses) and rig.twin.codec.dropped["crc"] > 0
    rig.plant.land()
    assert rig.twin.firmware.state == State.INACTIVE


GAP_START, GAP = 0.3, 0.03


def sunk_in_a_gap(period: float, seed: int = 0) -> float:
    """Return the displacement after 30 ms without frames [m]."""
    rig = Rig(Impairment(blackouts=((GAP_START, GAP_START + GAP),)), period=period, seed=seed, pose=CENTRE)
    rig.plant.arm()
    rig.fly(GAP_START + 0.1 - rig.twin.tick * period)
    assert not rig.twin.firmware.faults and rig.plant.samples.lost == round(GAP / period)
    first, last = (round(time / period) for time in (GAP_START, GAP_START + GAP + 0.01))
    off: Array = rig.poses[first:last, :3] - rig.poses[first - 1, :3]
    return float(np.sqrt((off**2).sum(axis=1)).max())


@pytest.mark.parametrize(
    "period", [pytest.param(0.005, id="200 Hz"), pytest.param(0.001, id="1 kHz", marks=pytest.mark.study)]
)
def test_in_a_gap_of_30_ms_the_device_carries_the_flotor(period: float, monkeypatch: pytest.MonkeyPatch) -> None:
    carried = [sunk_in_a_gap(period, seed) for seed in range(2)]
    monkeypatch.setattr(firmware, "_GAP", 10_000)
    held = [sunk_in_a_gap(period, seed) for seed in range(2)]
    monkeypatch.undo()
    monkeypatch.setattr(Calibration, "hover", property(lambda self: np.zeros(6)))
    dropped = sunk_in_a_gap(period)
    print(f"carried {np.multiply(carried, 1e6)}, held {np.multiply(held, 1e6)}, dropped {dropped * 1e6:.0f} um")
    assert max(carried) < 22e-6  # what the prototype lost
    # what was commanded last is the answer to a noisy sample: the faster the sampling, the further that would throw it
    assert np.mean(held) > np.mean(carried)
    assert dropped > 1.9e-3


class Speedometer:
    """Velocity estimator that keeps its estimates."""

    def __init__(self) -> None:
        self.found: list[Sequence[float]] = []

    def __call__(
        self, position: Sequence[Any], state: Sequence[Any] | None, period: float
    ) -> tuple[Sequence[Any], Sequence[Any]]:
        found = FiniteDifference()(position, state, period)
        self.found.append(found[0])
        return found


def test_across_lost_samples_the_velocity_is_right() -> None:
    rig, meter = Rig(Impairment(loss=0.2, seed=5), hand=SpringHand(target=TOUR), quantum=0.0, noise=0.0), Speedometer()
    rig.plant.takeoff()
    ticks: list[tuple[int, int]] = []
    controller = Controller(hover(0.005, BAD_REACH).laws, period=0.005, velocity=meter)
    rig.fly(1.0, controller, observe=lambda: ticks.append((rig.plant.samples.tick, rig.twin.tick)))
    host, device = np.array(ticks).T
    steps = np.diff(host)
    assert (np.diff(device) == steps).all() and np.bincount(steps)[:4].min() == 0 and steps.max() >= 3
    moved = rig.poses[device[1:]] - rig.poses[device[:-1]]
    found = np.array(meter.found)[1:]
    assert np.abs(found - moved / (0.005 * steps[:, None])).max() < 1e-9
    # and not what it would be for a period: the true velocity lies between those at both ends
    ends = np.stack([np.array(rig.witness.twists)[device[at]] for at in (slice(1, None), slice(-1))])
    assert np.ptp(found[:, :3], axis=0).max() > 0.02
    assert np.abs(found - ends.mean(axis=0))[:, :3].max() < 0.2 * np.abs(found[:, :3]).max()


def offsets() -> Calibration:
    """Return a device with other spot offsets than the model's."""
    return replace(Calibration.nominal(), spot_offsets=np.array([3e-4, -2e-4, 1e-4, 4e-4, -3e-4, 2e-4]))


def test_a_device_with_offsets_flies_with_its_calibration_and_beside_the_centre_with_another() -> None:
    right = Rig(pose=CENTRE, calibration=offsets(), host={"calibration": offsets()})
    wrong = Rig(pose=CENTRE, truth=offsets())
    for rig in (right, wrong):
        rig.plant.arm()
        rig.fly(1.2)
    assert rms(right.poses[-200:]) < 4.7e-6
    assert rms(wrong.poses[-200:]) > 1e-4


def test_a_calibration_mismatch_names_both_hashes_and_the_hosts_version() -> None:
    names = [one.digest.hex() for one in (Calibration.nominal(), offsets())]
    message = f"calibration mismatch: device {names[0]}, host {names[1]}; start .* maglev_mj {maglev_mj.__version__}"
    with pytest.raises(HandshakeError, match=message):
        Rig(host={"calibration": offsets()})


def test_a_weight_on_the_handle_is_not_a_fault() -> None:
    rig = Rig(hand=lambda *_: [0.0, 0.0, -1.0, 0.0, 0.0, 0.0])
    rig.plant.takeoff()
    assert abs(rig.fly(1.0)[-1, 2] + 1.0 / (INERTIA[2] * (0.25 / 0.0065) ** 2)) < 2e-5
    rig.plant.land()
    assert not rig.plant.faults
