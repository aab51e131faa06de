"""Simulated device: sensors, amplifier board, stops, waiting frames.

In virtual time but for the last few, which ask for no speed.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pytest

from maglev_mj.bridge.connection import Connection
from maglev_mj.bridge.fault import DeviceFault
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.bridge.safety import Limits
from maglev_mj.bridge.twin.fault_injection import InjectedFault
from maglev_mj.bridge.twin.simulated_links import Line, VirtualLink
from maglev_mj.bridge.twin.twin import Twin, TwinParameters, TwinServer
from maglev_mj.bridge.wire import Codec, CommandFrame, ControlRequest, Estop, EstopAck, Fault, Hello, Operation, State
from maglev_mj.cli.twin import _hand
from maglev_mj.errors import ParameterError, PlantError
from maglev_mj.frames import AXES, Array
from maglev_mj.plants import MuJoCoPlant, Timing
from tests.bridge.impaired import ImpairedLine, Impairment
from tests.bridge.test_bridge import CENTRE, REACH, ZERO, Rig, hover
from tests.sweeps import further, sweep

PERIOD = TwinParameters().profile.period  # [ns]


@pytest.mark.parametrize(("noise", "frozen"), [(4e-7, 30), (4e-7 - 1e-12, 0), (0.0, 0), (1e-6, 30)])
def test_a_twin_says_whether_its_noise_rules_equal_readings_out(noise: float, frozen: int) -> None:
    assert TwinParameters(noise=noise, quantum=8e-7).profile.limits.frozen == frozen


@pytest.mark.parametrize(
    ("period", "watchdog", "enable"), [(0.005, 0.05, 0.015), *further((0.001, 0.05, 0.01), (0.005, 0.012, 0.012))]
)
def test_with_the_firmware_hung_the_board_opens(period: float, watchdog: float, enable: float) -> None:
    at = 0.1
    rig = Rig(
        faults=[InjectedFault(kind="hung-firmware", which=0, at=at)],
        pose=CENTRE,
        period=period,
        limits=Limits(watchdog=watchdog),
    )
    twin = rig.twin
    assert twin.parameters.profile.limits.enable == enable
    rig.plant.arm()
    rig.fly(at - period)  # whose last sample is the last that the firmware took
    assert twin.tick == round(at / period) - 1 and all(twin.plant.currents[:3])
    flowed = 0.0
    for _ in range(100):
        assert twin.sample() is None
        flowed += sum(duration for duration, currents in twin.plant.intervals if any(currents))
    assert flowed == pytest.approx(enable, abs=1e-9)
    assert twin.firmware.state == State.ACTIVE and not any(twin.plant.currents)
    estop = Codec().encode(0, 0, 0, Estop(1))
    assert twin.receive(estop, twin.tick * twin.parameters.profile.period, "host") is None


def test_with_the_firmware_hung_right_after_arming_the_board_opens() -> None:
    rig = Rig(faults=[InjectedFault(kind="hung-firmware", which=0, at=0.02)], pose=CENTRE)
    for _ in range(4):
        rig.plant.read()
    rig.link.receive(0.002)
    rig.plant.arm()
    currents = tuple(rig.plant.calibration.hover.tolist())
    rig.plant._connection.command(CommandFrame(rig.twin.tick, 0, currents, currents, 0.0))
    flowed = 0.0
    for _ in range(20):
        rig.twin.sample()
        flowed += sum(duration for duration, held in rig.twin.plant.intervals if any(held))
    assert flowed == pytest.approx(0.015 - 0.0015) and not any(rig.twin.plant.currents)


def test_before_the_first_sample_and_while_its_line_stands_a_board_lets_nothing_through() -> None:
    twin = Twin(TwinParameters(pose=CENTRE))
    known, codec = twin.parameters.calibration, Codec()
    twin.receive(codec.encode(0, 0, 0, Hello(1, known.digest)), 0, "host")
    hover = tuple(known.hover.tolist())
    for sequence, body in ((0, ControlRequest(1, Operation.ARM, 0, hover)), (1, CommandFrame(0, 0, hover, hover, 0.0))):
        twin.receive(codec.encode(twin.firmware.session, sequence, 0, body), 0, "host")
    assert twin.firmware.state == State.ACTIVE
    twin.sample()
    assert not any(twin.plant.currents)
    twin = Twin(TwinParameters(pose=CENTRE))
    for _ in range(3):
        twin.sample()
        twin.board.drive(0, (1.0,) * 6, None, 0.0)
    assert not any(twin.plant.currents) and not twin.board.enabled
    twin.board.toggle(0)
    twin.board.drive(0, (1.0,) * 6, None, 0.0)
    twin.sample()
    assert tuple(twin.plant.currents) == (1.0,) * 6 and twin.board.enabled


@pytest.mark.parametrize(("plant", "period"), [("mujoco", 0.005), ("exact", 0.005), *further(("mujoco", 0.001))])
def test_a_controlled_stop_sets_the_flotor_down_from_any_pose(plant: str, period: float) -> None:
    draw = np.random.default_rng(1)
    for _ in range(6):
        rig = Rig(pose=draw.uniform(-1.0, 1.0, 6) * ([0.0035] * 2 + [0.0042] + [0.06] * 3), plant=plant, period=period)
        rig.plant.arm()
        rig.plant.read()
        rig.plant.drive(rig.plant.calibration.hover.tolist())
        rig.plant.trip(Fault.HOST)
        speeds = []
        for _ in range(round(0.5 / period) + 2):
            rig.twin.sample()
            speeds.append(-rig.twin.plant.state()[1][2])
        assert max(speeds) <= 0.1 and rig.twin.pose[2] < -0.0043 and not rig.twin.plant.currents.any()


def test_a_board_that_opens_by_itself_is_the_watchdog() -> None:
    # As where the wire of the enable line has come off: the firmware toggles it, and the board does not see that.
    rig = Rig(pose=CENTRE)
    rig.plant.arm()
    rig.fly(0.2)
    rig.twin.board.toggle = lambda now: None  # type: ignore[method-assign]
    with pytest.raises(DeviceFault, match="WATCHDOG"):
        rig.fly(0.5)
    assert rig.twin.firmware.faults == Fault.WATCHDOG and rig.twin.tick * 0.005 < 0.2 + 0.015 + 0.015


@pytest.mark.parametrize("coil", sweep(range(3), every=3))
def test_an_amplifier_that_does_not_let_go_is_named_and_bars_a_reset(coil: int) -> None:
    rig = Rig(faults=[InjectedFault(kind="stuck-amplifier", which=coil, at=0.3)], pose=CENTRE)
    rig.plant.arm()
    with pytest.raises(DeviceFault) as caught:
        rig.fly(0.3)
        rig.twin.receive(Codec().encode(0, 0, 0, Estop(1)), rig.link.time, "anyone")
        rig.fly(0.3)
    assert caught.value.faults & (Fault.ESTOP | Fault.COIL_NOT_FOLLOWING)
    for _ in range(4):
        rig.plant.read()
    twin = rig.twin
    assert twin.firmware.faults & Fault.COIL_NOT_OFF and rig.plant.faults & Fault.COIL_NOT_OFF
    assert abs(twin.plant.currents[coil]) > 0.25 and np.count_nonzero(twin.plant.currents) == 1
    request = ControlRequest(99, Operation.RESET, 0, ZERO)
    answer = twin.receive(Codec().encode(twin.firmware.session, 0, 0, request), rig.link.time, twin.firmware.peer)
    assert answer is not None
    acknowledged = Codec().decode(answer)
    assert acknowledged is not None and acknowledged.body[2:4] == (1, State.FAULT)


@pytest.mark.parametrize("coil", sweep(range(6), every=5))
def test_an_amplifier_that_keeps_its_current_in_flight_is_found(coil: int) -> None:
    def hand(tick: int, time: float, state: Any) -> Sequence[float]:
        return [2.0 * (time > 0.35), 2.0 * (time > 0.35), 3.0 * (time > 0.35), 0.0, 0.0, 0.0]

    rig = Rig(hand=hand, faults=[InjectedFault(kind="stuck-amplifier", which=coil, at=0.3)], pose=CENTRE)
    rig.plant.arm()
    with pytest.raises(DeviceFault, match="COIL_NOT_FOLLOWING"):
        rig.fly(1.0)


def test_hover_currents_neither_burn_nor_push() -> None:
    twin = Twin(TwinParameters(pose=CENTRE))
    known = twin.parameters.calibration
    limit = twin.parameters.profile.limits.hover_limit
    assert limit == pytest.approx(1.25 * known.hover.max()) and limit < 3.0
    heavy = Twin(TwinParameters(limits=Limits(continuous_current=1.2, hover_limit=5.0)))
    assert heavy.parameters.profile.limits.hover_limit == 1.2
    host = Connection(VirtualLink(twin), known.digest, None, 1.0)
    for one, result in ((1.01 * limit, 1), (-1.01 * limit, 1), (limit, 0)):
        answer = host.control(Operation.ARM, hover=(one,) * 3 + (0.0,) * 3)
        assert answer is not None and answer.result == result, one
    fastest = 0.0
    while twin.firmware.state != State.FAULT:  # and nobody commands
        twin.sample()
        fastest = max(fastest, float(np.abs(twin.plant.state()[1][:3]).max()))
    assert twin.firmware.faults == Fault.WATCHDOG and fastest < 0.2  # 60 N would have made it 3 m/s
    print(f"{fastest:.3f} m/s")


def test_an_estop_before_the_first_sample_is_taken() -> None:
    twin = Twin(TwinParameters())
    answer = twin.receive(Codec().encode(0, 0, 0, Estop(3)), 0, "anyone")
    assert answer is not None and twin.firmware.faults == Fault.ESTOP
    frame = Codec().decode(answer)
    assert frame is not None and frame.body == EstopAck(3, State.FAULT, 0, Fault.ESTOP, 0, ZERO, 0.25)


R = math.radians(6.0)
DROPS: list[tuple[Sequence[float], Sequence[float]]] = [
    ((0, 0, -0.0044, 0, 0, 0), (0.3, 0.2, -0.2, 0, 0, 0)),
    ((0, 0, -0.0044, 0, 0, 0), (0, 0, -0.2, 8, 0, 0)),
    ((0, 0, -0.0044, 0, 0, 0), (0.2, -0.1, -0.2, 4, -5, 6)),
    ((0, 0, -0.0045, R, 0, 0), (0, 0, 0, 0, 8, 0)),
    ((0, 0, -0.0045, R, 0, 0), (0, 0, 0, 0, 0, 8)),
    ((0, 0, -0.0045, 0, R, 0), (0, 0, 0, 6, 0, -6)),
    ((0.0045, 0, -0.0045, 0, 0, R), (0, 0.3, 0, 6, 6, 0)),
]


def speeds_after(pose: Sequence[float], twist: Sequence[float], seconds: float, **options: Any) -> Array:
    """Return speed and angular speed after a contact.

    Some time after the flotor met its stops [m/s, rad/s].
    """
    plant = MuJoCoPlant(Timing(), pose=pose, twist=twist, stops=True, **options)
    for _ in range(round(seconds / 0.005)):
        plant.read()
        plant.drive(ZERO)
    motion = plant.state()[1]
    return np.array([np.linalg.norm(motion[:3]), np.linalg.norm(motion[3:])])


def test_stops_take_motion_along_them() -> None:
    for pose, twist in DROPS:
        assert (speeds_after(pose, twist, 0.15, stop_damping=True) < (1e-3, 0.05)).all(), (pose, twist)


@pytest.mark.parametrize("torque", [(0.9, -0.6, 0.5), pytest.param((-0.4, 0.9, 0.6), marks=pytest.mark.study)])
def test_takeoff_after_a_rough_landing(torque: Sequence[float]) -> None:
    rig = Rig(hand=lambda _, time, state: [0.0] * 3 + [one * (time < 0.015) for one in torque])
    for _ in range(45):
        rig.plant.read()
    assert np.linalg.norm(np.array(rig.witness.twists)[:, 3:], axis=1).max() > 6.0
    rig.plant.takeoff()
    assert rig.plant.land().at_rest


class Queue:
    """Server with waiting frames, endless if wanted, and a virtual clock.

    Attributes:
        now: The time, of which each frame takes 5 us [ns].
        waiting: Frames to come.
        sent: Frames sent by the twin.
    """

    address = ("nowhere", 0)
    now = 0

    def __init__(self, waiting: Sequence[bytes], endless: bool = False) -> None:
        self.waiting = itertools.cycle(waiting) if endless else iter(waiting)
        self.sent: list[bytes] = []

    def receive(self, timeout: float) -> tuple[bytes, tuple[str, int]] | None:
        data = next(self.waiting, None)
        self.now += 5_000 if data is not None else max(round(timeout * 1e9), 0)
        return None if data is None else (data, ("anyone", 1))

    def send(self, data: bytes, address: Any) -> None:
        self.sent.append(data)

    def sleep(self, seconds: float) -> None:
        self.now += max(round(seconds * 1e9), 1)

    def close(self) -> None:
        pass


CODEC = Codec()
JUNK, ESTOP = b"MJ" + bytes(100), CODEC.encode(0, 0, 0, Estop(1))
HELLO = CODEC.encode(0, 0, 0, Hello(1, bytes(16)))


@pytest.mark.parametrize("lockstep", [False, True])
def test_an_estop_is_taken_before_what_waited_longer(lockstep: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    queue = Queue([JUNK, HELLO] * 40 + [ESTOP, HELLO])
    twin = Twin(TwinParameters(lockstep=lockstep))
    monkeypatch.setattr("time.monotonic_ns", lambda: queue.now)
    TwinServer(twin, queue).run(0.5)
    kinds = [data[3] for data in queue.sent]
    assert kinds[0] == 8 and kinds[1:] == [2] * 41 and twin.codec.dropped == {"crc": 40}


@pytest.mark.parametrize("frame", [JUNK, *further(HELLO, ESTOP)])
def test_a_flood_without_end_keeps_the_twin_from_no_sample(frame: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    twin, queue = Twin(TwinParameters()), Queue([frame], endless=True)
    monkeypatch.setattr("time.monotonic_ns", lambda: queue.now)
    monkeypatch.setattr("time.sleep", queue.sleep)
    report = TwinServer(twin, queue).run(0.05)
    # in time, but for the first, due at the start
    assert report.ticks == 11 and report.latency.p50 < 1e-4 and report.latency.worst < 0.51 * PERIOD


class Silent(Queue):
    """Server whose clock is virtual, and whose host is silent after its first frames."""

    now = 0

    def receive(self, timeout: float) -> tuple[bytes, tuple[str, int]] | None:
        self.now += round(timeout * 1e9)
        data = next(self.waiting, None)
        return None if data is None else (data, ("anyone", 1))


@pytest.mark.parametrize("state", State)
def test_a_silent_host_in_lockstep_is_let_go_in_every_state(state: State, monkeypatch: pytest.MonkeyPatch) -> None:
    twin = Twin(TwinParameters(lockstep=True))
    queue = Silent([CODEC.encode(0, 0, 0, Hello(1, twin.firmware.profile.calibration))])
    monkeypatch.setattr("time.monotonic_ns", lambda: queue.now)
    gone = list[float]()

    def let_go(now: int) -> None:
        gone.append(queue.now * 1e-9)
        twin.firmware.session = 0

    monkeypatch.setattr(twin.firmware, "lose_host", let_go)
    TwinServer(twin, queue).run(3.0, each=lambda: setattr(twin.firmware, "state", state))
    assert gone == [pytest.approx(2.0, abs=0.2)]
    assert [data[3] for data in queue.sent] == [2, *[5] * 8]  # a STATE, repeated at double intervals


BAD = Impairment(delay=0.02, jitter=0.01, duplicate=0.3, loss=0.2, seed=4)


class Counted(Twin):
    """Twin of at most a hundred samples, where one that waits for no answer would take them without end."""

    def sample(self) -> bytes | None:
        assert self.tick < 100
        return super().sample()


def test_in_lockstep_no_line_changes_the_motion() -> None:
    def positions(line: Line) -> list[Sequence[float]]:
        twin = Counted(TwinParameters(lockstep=True, pose=CENTRE))
        control, seen = hover(twin.parameters.period, REACH), []
        with RemotePlant(VirtualLink(twin, line)) as plant:
            plant.arm()
            for _ in range(60):
                seen.append(plant.read())
                plant.write(control.step(seen[-1]))
            assert plant.samples.lost == plant.samples.skipped == 0
        return [tuple(sample.position) for sample in seen]

    assert positions(ImpairedLine(BAD)) == positions(Line())


def test_a_second_session_in_lockstep_begins_with_a_new_sample() -> None:
    twin = Counted(TwinParameters(lockstep=True))
    link, digest = VirtualLink(twin, Line(0.001)), twin.parameters.calibration.digest
    for tick in range(2):
        host = Connection(link, digest, None, 0.2)
        assert host.state().sequence == tick == twin.tick
        with pytest.raises(PlantError, match="no sample"):  # not answered: repeated, and the same is none newer
            host.state()
        assert twin.tick == tick and host.codec.dropped["old"] >= 4
        assert host.control(Operation.BYE) is not None


class Late(Queue):
    """Silent server whose clock is virtual and wakes late.

    Args:
        late: Lateness at each sample but the first [ns].
    """

    def __init__(self, late: Iterable[int]) -> None:
        super().__init__([])
        self.now, self._late = 0, iter(late)

    def receive(self, timeout: float) -> None:
        self.now += round(timeout * 1e9)
        if timeout and self.now % PERIOD == 0:
            self.now += next(self._late)


def test_lateness_is_measured_and_whole_periods_of_it_stall_the_twin(monkeypatch: pytest.MonkeyPatch) -> None:
    late = [0, 100_000, 300_000, 2 * PERIOD + 400_000, *[100_000] * 94, PERIOD, 200_000]
    queue = Late(late[1:])  # the first sample is at once
    monkeypatch.setattr("time.monotonic_ns", lambda: queue.now)
    report = TwinServer(Twin(TwinParameters()), queue).run(0.51)
    latency = report.latency
    assert (report.ticks, report.missed, latency.count, latency.worst) == (100, 3, 100, max(late))
    assert [latency.p50, latency.p99] == pytest.approx(np.percentile(late, [50, 99]) * 1e-9)
    assert "median 100 µs" in str(report)


def test_a_push_lives_from_start_to_end() -> None:
    assert _hand([], None) is None
    with pytest.raises(ParameterError, match="push must be AXIS:NEWTONS@START-END"):
        _hand(["x:5@2-1"], None)
    for axis, name in enumerate(AXES):
        hand = _hand([f"{name}:-2.5@1-2", f"{name}:1@1.5-3", "x:0@0-9"], lambda *_: [0.5] * 6)
        assert hand is not None
        for when, force in ((0.99, 0.0), (1.0, -2.5), (1.5, -1.5), (2.0, 1.0), (3.0, 0.0)):
            wrench = hand(0, when, lambda: (np.zeros(6), np.zeros(6)))
            assert list(wrench) == [0.5 + force * (part == axis) for part in range(6)], when
