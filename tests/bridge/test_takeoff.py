"""Takeoff from rest, checked landing, prompt currents."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest

from maglev_mj.bridge.fault import DeviceFault
from maglev_mj.bridge.flight import Flight
from maglev_mj.bridge.landing import RecentMotion
from maglev_mj.bridge.safety import HostLimits
from maglev_mj.bridge.twin.fault_injection import InjectedFault
from maglev_mj.bridge.wire import Fault, Operation, State
from maglev_mj.device import published_device
from maglev_mj.errors import PlantError
from maglev_mj.frames import Sample
from maglev_mj.scenes import find_scene
from tests.bridge.test_bridge import Rig
from tests.published import WEIGHT
from tests.sweeps import sweep

RATES = [0.005, 0.001, 0.00025]


def still(rig: Rig) -> RecentMotion:
    """Return the result of a watch before takeoff."""
    return rig.plant._observed(0.0)


NOISES = {4e-7: 100.0, 5e-6: 20.0, 5e-5: 2.0}
"""Spot noise [m], and required factor of the apparent speed below the limits."""
FASTEST = [pytest.param(noise, RATES[2], marks=pytest.mark.study) for noise in (4e-7, 5e-6)]  # more is overspeed


@pytest.mark.parametrize(("noise", "period"), [*sweep(NOISES, RATES[:2], every=2), *FASTEST])
def test_a_flotor_at_rest_is_detected_with_any_noise(noise: float, period: float) -> None:
    worst, margin = [0.0, 0.0], NOISES[noise]
    for seed in range(5 if period > 0.001 else 1):
        motion = still(Rig(period=period, delay=min(0.0015, period), seed=seed, quantum=8e-7, noise=noise))
        worst = [max(one, other) for one, other in zip(worst, motion.speeds)]
        assert motion.at_rest and motion.full
    print(f"{1 / period:g} Hz: at rest up to {worst[0] * 1e3:.3f} mm/s and {worst[1]:.4f} rad/s seen")
    assert worst[0] < 5e-3 / margin and worst[1] < 0.1 / margin


def watched(period: float, pose: Any) -> RecentMotion:
    """Return the motion of a pose as a function of time."""
    motion = RecentMotion(period, published_device().scale)
    for tick in range(5000):
        if motion.full:
            break
        motion.add(Sample(tick, tick * period, pose(tick * period)))
    return motion


@pytest.mark.parametrize("period", RATES)
@pytest.mark.parametrize("axis", range(6))
def test_motion_and_oscillation_on_any_axis_is_not_rest(axis: int, period: float) -> None:
    least, amplitude = (5e-3, 3.5e-4) if axis < 3 else (0.1, 7e-3)
    along = [float(place == axis) for place in range(6)]
    for share in (0.95, 1.05):
        steady = watched(period, lambda at, speed=share * least: [part * speed * at for part in along])
        assert steady.at_rest is (share < 1.0)
        assert max(steady.speeds) == pytest.approx(share * least)
    swinging = watched(period, lambda at: [part * amplitude * math.sin(2.0 * math.pi * 15.0 * at) for part in along])
    assert not swinging.at_rest


def pushed(axis: int, amount: float) -> Any:
    """Return a hand that pushes one axis until 0.3 s."""
    return lambda tick, at, state: [amount * (place == axis and at < 0.3) for place in range(6)]


@pytest.mark.parametrize(
    ("hand", "says"),
    [
        (pushed(0, 0.5), r"no takeoff: the flotor moves at .* mm/s and .* rad/s; it must be at rest"),
        (pushed(5, 0.012), r"no takeoff: the flotor moves at .* mm/s and .* rad/s; it must be at rest"),
    ],
    ids=["slides", "spins"],
)
def test_a_moving_flotor_does_not_take_off(hand: Any, says: str) -> None:
    rig = Rig(hand=hand)
    with pytest.raises(PlantError, match=says) as caught:
        rig.plant.takeoff()
    print(caught.value)
    assert not isinstance(caught.value, DeviceFault)
    assert rig.plant.state == rig.twin.firmware.state == State.INACTIVE and rig.currents() == [0.0] * 6


@pytest.mark.parametrize(
    ("kind", "at", "says"),
    [
        ("invalid-diode", 0.1, "SENSOR_OUT_OF_RANGE: spots .* mm, valid 101"),  # at the last sample
        ("stuck-diode", 0.0, "SENSOR_FROZEN: spots"),
    ],
)
def test_a_sensor_alarm_prevents_takeoff(kind: str, at: float, says: str) -> None:
    rig = Rig(faults=[InjectedFault(kind=kind, which=1, at=at)])
    for _ in range(0 if at else 30):
        rig.plant.read()
    with pytest.raises(PlantError, match=f"no takeoff: {says}") as caught:
        rig.plant.takeoff()
    assert "\n" not in str(caught.value) and rig.twin.firmware.state == State.INACTIVE


@pytest.mark.parametrize("depth", [0.0, -0.0026])
def test_a_flotor_off_its_lower_stop_does_not_take_off(depth: float) -> None:
    rig = Rig(pose=(0.0, 0.0, depth, 0.0, 0.0, 0.0), hand=lambda *_: WEIGHT)
    with pytest.raises(PlantError, match=r"no takeoff: the flotor is at .*; it must lie on its lower stop"):
        rig.plant.takeoff()
    assert rig.twin.firmware.state == State.INACTIVE
    rig = Rig(pose=(0.0, 0.0, -0.0028, 0.0, 0.0, 0.0), hand=lambda tick, at, state: WEIGHT if at < 0.11 else [0.0] * 6)
    rig.plant.takeoff()  # a higher stop than the model's


def late_hand(wrench: Sequence[float], since: float) -> Any:
    """Return a hand that pushes from an instant on."""
    return lambda tick, at, state: wrench if at > since else [0.0] * 6


def test_a_landing_into_a_hand_is_reported_and_disarms() -> None:
    rig = Rig(hand=late_hand([0.0, 0.0, 8.0, 0.0, 0.0, 0.0], 0.8))
    rig.plant.takeoff()
    rig.fly(0.2)
    report = rig.plant.land()
    print(report)
    assert report.error > 5e-3 and "landed 9.0" in str(report)  # against the upper stop
    assert rig.twin.firmware.state == State.INACTIVE and rig.currents() == [0.0] * 6
    rig = Rig(hand=late_hand([0.0, 0.0, 0.0, 0.0, 0.0, 0.012], 1.4))
    rig.plant.takeoff()
    rig.fly(0.2)
    report = rig.plant.land()
    print(report)
    assert not report.at_rest and "NOT at rest" in str(report) and report.spin > 0.1


def test_a_landing_waits_for_rest_before_it_disarms() -> None:
    # An oscillating torque that ends 0.1 s after the path's end.
    rig = Rig(hand=lambda tick, at, state: [1.5 * math.sin(60.0 * at) * (0.9 < at < 1.6), *[0.0] * 5])
    rig.plant.takeoff()
    rig.fly(0.2)
    before, control, at = rig.twin.tick, rig.plant._connection.control, []

    def noted(operation: Operation, **keywords: Any) -> Any:
        at.append((operation, rig.twin.tick - before))
        return control(operation, **keywords)

    rig.plant._connection.control = noted  # type: ignore[method-assign]
    rig.plant.land()
    (operation, ticks), *_ = at
    assert operation == Operation.DISARM and 0.65 / 0.005 < ticks <= 0.9 / 0.005 + 3


def test_at_reduced_power_it_takes_off_and_lands() -> None:
    # a tap for which the weight leaves no current
    tapped = late_hand([0.0, 0.0, -4.0, 0.0, 0.0, 0.0], 0.8)
    rig = Rig(
        host={"limits": HostLimits(max_current=1.45)},
        hand=lambda tick, at, state: tapped(tick, at, state) if at < 0.83 else [0.0] * 6,
    )
    sent, command = list[float](), rig.plant._connection.command

    def told(frame: Any) -> None:
        command(frame)
        sent.extend(map(abs, (*frame.held, *frame.pulsed)))

    rig.plant._connection.command = told  # type: ignore[method-assign, assignment]
    rig.plant.takeoff()
    assert rig.twin.tick * 0.005 < 0.8
    rig.fly(0.4)
    assert rig.plant.land().at_rest and max(sent) == pytest.approx(1.45)


FIRST_HOVER = HostLimits(max_current=2.0, envelope=0.003, speed_limit=0.1, force_limit=9.0)


@pytest.mark.parametrize("seed", sweep(range(3), every=3))
@pytest.mark.parametrize(
    ("period", "seconds"),
    [pytest.param(0.005, 1.0, id="200 Hz"), pytest.param(0.001, 0.3, id="1 kHz", marks=pytest.mark.study)],
)
def test_within_the_first_hovers_limits_it_takes_off_from_a_stop_beyond_them_and_lands(
    period: float, seconds: float, seed: int
) -> None:
    rig = Rig(period=period, seed=seed, quantum=8e-7, noise=4e-7, host={"limits": FIRST_HOVER})
    assert rig.twin.pose[2] < -FIRST_HOVER.envelope
    scene = find_scene("joystick")().replace(period=period, delay=rig.plant.delay)
    report = Flight(rig.plant, scene).run(seconds)
    assert report.landing.at_rest and report.ticks == round(seconds / period) and not rig.plant.faults
    speeds = [math.hypot(*twist[:3]) for twist in rig.witness.twists]
    assert 0.014 < max(speeds) < 0.02  # of takeoff and landing


def test_beyond_its_own_envelope_in_flight_it_is_a_fault() -> None:
    hand = lambda tick, at, state: [8.0 * max(at - 1.0, 0.0), *[0.0] * 5]  # noqa: E731
    rig = Rig(hand=hand, host={"limits": FIRST_HOVER})
    rig.plant.takeoff()
    with pytest.raises(DeviceFault) as caught:
        rig.fly(2.0)
    assert caught.value.faults == rig.twin.firmware.faults == Fault.BOUNDARY
    assert 0.003 <= rig.poses[-1, 0] < 0.0035
    rig = Rig(pose=(0.0, 0.0, -0.0035, 0.0, 0.0, 0.0), host={"limits": FIRST_HOVER})
    rig.plant.read()
    rig.plant.arm()  # counts as flight
    with pytest.raises(DeviceFault, match="BOUNDARY"):
        rig.plant.read()


@pytest.mark.parametrize("until", sweep([0.1, 0.3, 0.0], every=3))
def test_a_takeoff_that_ends_early_may_land_but_not_fly_on(until: float) -> None:
    rig = Rig(host={"limits": FIRST_HOVER})
    for flies in (False, True):
        armed: list[int] = []
        rig.plant.takeoff(watch=lambda armed=armed: armed.append(1) or len(armed) * 0.005 > until)  # type: ignore[misc]
        if flies and until < 0.3:
            with pytest.raises(DeviceFault, match="BOUNDARY"):
                rig.fly(0.1)
        else:
            assert rig.plant.land().at_rest


def test_takeoff_and_landing_have_the_devices_own_envelope_and_the_hosts_speed() -> None:
    rig = Rig(hand=late_hand([0.0, 0.0, 12.0, 0.0, 0.0, 0.0], 0.8), host={"limits": HostLimits(envelope=0.003)})
    rig.plant.takeoff()
    rig.plant.land()  # against the upper stop
    assert rig.poses[-1, 2] > 0.0044 and not rig.plant.faults
    with pytest.raises(DeviceFault, match="FLOTOR_OVERSPEED"):
        Rig(host={"limits": HostLimits(speed_limit=0.01)}).plant.takeoff()
    wide = Rig(host={"limits": HostLimits(envelope=0.02)})
    wide.plant.takeoff()
    assert wide.plant.land().at_rest


def test_no_slow_work_between_arming_and_the_first_command(monkeypatch: pytest.MonkeyPatch) -> None:
    # The first command leaves at the first sample after ARM.
    rig, armed, sent = Rig(), list[int](), list[int]()
    line, control, command = rig.plant._connection, rig.plant._connection.control, rig.plant._connection.command

    def asked(operation: Operation, **keywords: Any) -> Any:
        answer = control(operation, **keywords)
        armed.append(rig.twin.tick)
        for name in ("landing.Controller", "landing.Hold", "remote.Trajectory", "remote.ControlLoop"):
            monkeypatch.setattr(f"maglev_mj.bridge.{name}", Mock(side_effect=AssertionError("made after ARM")))
        monkeypatch.setattr("gc.collect", Mock(side_effect=AssertionError("collected after ARM")))
        return answer

    def told(frame: Any) -> None:
        command(frame)
        if armed:
            sent.append(rig.twin.tick)

    line.control, line.command = asked, told  # type: ignore[method-assign, assignment]
    rig.plant.takeoff()
    assert sent[0] - armed[0] <= 1
    assert rig.twin.firmware.counts["inactive"] >= 2  # after warm-up cycles


FLIGHTS = """
import sys
import maglev_mj.cli.bridge
from dataclasses import replace
from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.flight import Flight
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.bridge.twin.twin import Twin, TwinParameters
from maglev_mj.recording import open_recording
from maglev_mj.scenes import find_scene
from maglev_mj.session import ChangeRequest

class Watched(RemotePlant):
    armed = False

    def arm(self):
        super().arm()
        Watched.armed = True

    def disarm(self):
        Watched.armed = False
        super().disarm()

class Wish:
    def __init__(self, scene):
        self.scene, self.looks = scene, 0

    def take(self):
        self.looks += 1
        return ChangeRequest(self.scene, changed.append) if self.looks == 400 else None

    def show(self, snapshot):
        pass

class Judge:
    looks = 0

    def ask(self, *question):
        pass

    def answer(self):
        self.looks += 1
        return (0.01, "") if self.looks > 5 else None

def audit(event, arguments):
    if Watched.armed and event in ("import", "open", "os.listdir", "os.scandir"):
        print(event, arguments[0])

changed = []
file = open_recording(sys.argv[1])
heavy = replace(Calibration.nominal(), mass=0.8)
sys.addaudithook(audit)
for scene, critical_delay in (("joystick", 0.01), ("stick-slip", 0.01), ("table", 0.001), ("box", 0.01)):
    parameters = TwinParameters(truth=heavy) if scene == "box" else TwinParameters()
    with Watched(VirtualLink(Twin(parameters, draw=lambda: 7))) as plant:
        scene = find_scene(scene)().replace(period=plant.period, delay=plant.delay)
        options = {"critical_delay": critical_delay, "file": file, "warn": print}
        if scene.name == "joystick":
            options["publishers"] = [Wish(scene.replace(stiffness=0.95 * scene.stiffness))]
        if scene.name == "box":
            options["check"] = Judge()
        flight = Flight(plant, scene, **options)
        assert flight.run(1.0).landing.at_rest
        assert bool(flight.reason) == (critical_delay == 0.001), flight.reason
        assert scene.name != "box" or options["check"].looks == 6  # with the mass that was found
file.close()
print(len(changed), "changed")
"""


def test_no_file_is_read_and_nothing_imported_while_currents_flow(tmp_path: Path) -> None:
    # an import or a scene's files take 40 ms, on a busy machine as long as the watchdog
    done = subprocess.run([sys.executable, "-c", FLIGHTS, tmp_path / "a.maglev"], capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("1 changed\n", "")
