"""Faults of device, link or host: zero currents, name, file.

Everything here is one process in virtual time: nothing depends on how fast the machine is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from maglev_mj.bridge import safety
from maglev_mj.bridge.fault import DeviceFault, load_fault
from maglev_mj.bridge.links import LinkError
from maglev_mj.bridge.safety import Limits, ThermalModel
from maglev_mj.bridge.twin import firmware
from maglev_mj.bridge.twin.fault_injection import INJECTED_FAULTS, InjectedFault
from maglev_mj.bridge.wire import Fault, State, StateReport, fault_names
from maglev_mj.control import Bias
from maglev_mj.control.controller import Controller
from maglev_mj.errors import PlantError
from maglev_mj.frames import Command, Sample
from maglev_mj.plants.hand import SpringHand
from tests.bridge.impaired import Impairment
from tests.bridge.test_bridge import BAD, BAD_REACH, CENTRE, REACH, TOUR, ZERO, Rig, hover
from tests.published import REST, WEIGHT
from tests.sweeps import further, sweep

AWAY = Fault.FLOTOR_OVERSPEED | Fault.BOUNDARY | Fault.SENSOR_OUT_OF_RANGE
"""Fault names of a flotor out of control."""


def check_dead(rig: Rig) -> None:
    """Check zero currents from the next sample until a reset."""
    rig.currents()
    assert tuple(rig.twin.plant.currents) == ZERO
    for _ in range(15):
        assert rig.currents() == [0.0] * 6
    assert rig.twin.firmware.state == State.FAULT and rig.twin.firmware.faults
    with pytest.raises(PlantError, match="refused ARM"):
        rig.plant.arm()
    assert rig.currents() == [0.0] * 6


def check_file(rig: Rig, error: DeviceFault) -> None:
    """Check that the file holds the last cycles.

    Up to the faulty sample.
    """
    assert error.path is not None and str(error.path) in str(error)
    record = load_fault(error.path)
    assert record.faults == fault_names(error.faults) and record.message in str(error)
    samples = record.values["sample"].tolist()
    assert 0 < len(samples) <= 200
    last = {name: column[-1] for name, column in record.values.items()}
    assert record.tick <= last["sample"] <= rig.twin.tick and record.tick <= rig.plant.samples.tick
    if "reported by the device" in str(error):
        assert (last["state"], last["faults"]) == (State.FAULT, error.faults)
    assert samples == sorted(samples) and len(set(samples)) >= len(samples) - 1


def fails(rig: Rig, act: Callable[[], object], allowed: Fault) -> DeviceFault:
    """Return the failure of an action, with its effects checked."""
    with pytest.raises(DeviceFault) as caught:
        act()
    error = caught.value
    assert error.faults and not error.faults & ~allowed, error
    assert rig.plant.state == State.FAULT and rig.plant.faults == error.faults
    check_file(rig, error)
    check_dead(rig)
    return error


def fly(rig: Rig, seconds: float = 2.0, controller: Controller | None = None) -> Callable[[], object]:
    """Return a function that takes off and flies."""

    def act() -> None:
        rig.plant.takeoff()
        rig.fly(seconds, controller)

    return act


def hovering(**options: Any) -> Rig:
    """Return a rig whose flotor is at the centre, armed and held."""
    rig = Rig(pose=CENTRE, **options)
    rig.plant.arm()
    return rig


@pytest.mark.parametrize(
    ("line", "frequency"),
    [
        (BAD, 150.0),
        (Impairment(delay=0.015, jitter=0.015), None),
        *further(*((replace(BAD, seed=seed), 300.0) for seed in range(4))),
    ],
)
def test_a_hold_too_stiff_for_the_link_and_a_link_too_slow_fail_safe(line: Impairment, frequency: float | None) -> None:
    rig = Rig(line)
    reach = REACH if frequency is None else BAD_REACH
    fails(rig, fly(rig, 5.0, hover(0.005, reach, frequency)), AWAY | Fault.NOT_FOLLOWING | Fault.WATCHDOG)


def test_a_blackout_longer_than_the_watchdog_latches_until_reset() -> None:
    rig = hovering(impairment=Impairment(blackouts=((0.3, 0.5),)))
    fails(rig, lambda: rig.fly(1.0), Fault.WATCHDOG)
    for _ in range(40):  # falling
        rig.plant.read()
    assert rig.twin.pose[2] == pytest.approx(REST[2], abs=1e-5)
    rig.plant.reset()
    assert not rig.twin.firmware.faults
    assert rig.currents() == [0.0] * 6  # reset does not arm
    fly(rig, 0.1)()
    rig.plant.land()
    assert np.abs(rig.twin.pose - REST)[:3].max() < 1e-4  # slightly tilted after the fall


@pytest.mark.parametrize(
    "command",
    [
        Command([math.nan, *WEIGHT[1:]]),
        Command([*WEIGHT[:5], -math.inf]),
        Command(WEIGHT, [math.nan] * 6, 0.003),
        Command(WEIGHT, ZERO, math.inf),
        Command(WEIGHT[:5]),
        Command(["a"] * 6),
        Command(None),  # type: ignore[arg-type]
    ],
    ids=["nan", "inf", "pulse", "width", "five", "text", "nothing"],
)
def test_invalid_commands_are_refused(command: Command) -> None:
    class Broken(Controller):
        def step(self, sample: Sample) -> Command:
            return command if sample.tick == 30 else super().step(sample)

    rig = hovering()
    broken = Broken(hover(0.005, REACH).laws, period=0.005)
    error = fails(rig, lambda: rig.fly(1.0, broken), Fault.INVALID_COMMAND)
    assert [sample.tick for sample, _ in error.cycles] == list(range(31)) and error.cycles[-1][1] is command


# injected faults while hovering or moved by a hand, and their names
PLACES = range(6)
SUFFERED: list[tuple[str, Iterable[int], bool, Fault]] = [
    ("dead-coil", (5, *PLACES), True, Fault.COIL_NOT_FOLLOWING),
    ("stuck-diode", (2, 0, 1), False, Fault.SENSOR_FROZEN),
    ("stuck-diode", (2, 0, 1), True, Fault.SENSOR_FROZEN),
    ("stuck-diodes", (0,), True, Fault.SENSOR_FROZEN),
    ("invalid-diode", (2, 0, 1), False, Fault.SENSOR_OUT_OF_RANGE),
    ("swapped-diodes", (2, 0, 1), True, AWAY),
    ("clock-jump", (3, 30), False, Fault.CLOCK),
    ("clock-jump", (100,), False, Fault.WATCHDOG),
    ("silence", (200,), False, Fault.WATCHDOG),
    ("stuck-counter", (0,), False, Fault.SENSOR_STOPPED),
    ("nan-spot", PLACES, False, Fault.SENSOR_OUT_OF_RANGE),
    ("nan-current", PLACES, False, Fault.COIL_OVERCURRENT),
    ("nan-temperature", PLACES, False, Fault.COIL_OVERTEMP),
    ("hot-report", PLACES, False, Fault.COIL_OVERTEMP),
]


@pytest.mark.parametrize(
    ("kind", "which", "moved", "fault", "period"),
    [
        pytest.param(*(kind, which, moved, fault, period), marks=pytest.mark.study if place or period < 0.005 else ())
        for kind, places, moved, fault in SUFFERED
        for place, which in enumerate(places)
        for period in (0.005, 0.001)
    ],
)
def test_an_injected_fault_is_named(kind: str, which: int, moved: bool, fault: Fault, period: float) -> None:
    hand = SpringHand(target=TOUR) if moved else None  # after takeoff
    at = 1.0 if moved else 0.2
    options: dict[str, Any] = {"faults": [InjectedFault(kind=kind, which=which, at=at)], "hand": hand, "period": period}
    rig = Rig(**options) if moved else hovering(**options)
    error = fails(rig, fly(rig) if moved else lambda: rig.fly(1.0), fault)
    assert rig.twin.firmware.faults & ~Fault.COIL_NOT_OFF == error.faults  # NaN current counts as not off
    assert (error.path is not None and error.cycles[-1][0].tick >= load_fault(error.path).tick - 1) or kind == "silence"
    # those of the amplifiers, the firmware and a late sensor have other effects, and other tests
    assert {name for name, *_ in SUFFERED} | {"stuck-amplifier", "hung-firmware", "late-sensor"} == set(INJECTED_FAULTS)


def unheard(rig: Rig) -> None:
    """Break the link: every later use raises."""
    for way in ("send", "receive"):
        setattr(rig.link, way, Mock(side_effect=LinkError("the line is gone")))


def disarmed(rig: Rig) -> None:
    """Make the device disarm by itself."""
    rig.twin.board.cut()
    rig.twin.firmware.state = State.INACTIVE


def nonsense(rig: Rig) -> None:
    """Make the device report an unknown state."""
    encode = rig.twin.firmware._codec.encode

    def changed(session: int, sequence: int, time: int, body: Any) -> bytes:
        return encode(session, sequence, time, body._replace(state=7) if isinstance(body, StateReport) else body)

    rig.twin.firmware._codec.encode = changed  # type: ignore[method-assign]


def silent(rig: Rig) -> None:
    """Lose every frame."""
    rig.link._line.fates = lambda *_: ()  # type: ignore[method-assign]


@pytest.mark.parametrize(
    ("act", "says"),
    [
        (disarmed, "HOST: the device disarmed without a request"),
        (nonsense, "HOST: .*the device reports unknown state 7"),
        (silent, "HOST: no sample from the device within 1 s"),
    ],
)
def test_inconsistent_device_states_trip_the_host_fault(act: Callable[[Rig], None], says: str) -> None:
    rig = hovering()
    rig.fly(0.2)
    act(rig)
    with pytest.raises(DeviceFault, match=says) as caught:
        rig.fly(1.5)
    assert caught.value.path is not None and load_fault(caught.value.path).faults == "HOST"
    if act is silent:
        with pytest.raises(PlantError, match="emergency stop not confirmed: cut the power"):
            rig.plant.estop()
    for _ in range(15):
        rig.twin.sample()
    assert rig.currents() == [0.0] * 6 and rig.twin.firmware.state != State.ACTIVE
    rig.plant.close()
    with pytest.raises(PlantError, match="the plant is closed"):
        rig.plant.read()


def test_a_fault_detected_while_the_link_fails_is_reported() -> None:
    rig = hovering()
    rig.plant.read()
    unheard(rig)
    with pytest.raises(DeviceFault, match="INVALID_COMMAND: a command must be six finite numbers"):
        rig.plant.write(Command([float("nan")] * 6))
    assert rig.plant.state == State.FAULT


def test_an_estop_of_this_host_is_latched_and_reported_once() -> None:
    rig = hovering()
    rig.plant.read()
    rig.plant.trip(Fault.CLOCK)
    for _ in range(2):
        rig.plant.estop()
        assert rig.twin.firmware.faults == rig.plant.faults == Fault.CLOCK | Fault.ESTOP
    check_dead(rig)
    with pytest.raises(DeviceFault, match="ESTOP"):
        rig.plant.read()
    rig.plant.read()
    assert rig.plant.state == State.FAULT and rig.plant.faults == Fault.CLOCK | Fault.ESTOP
    rig.plant.reset()
    rig.plant.arm()


@pytest.mark.parametrize("jump", [10_000, *(pytest.param(jump, marks=pytest.mark.study) for jump in (3, 12))])
def test_a_clock_change_of_an_inactive_device_is_not_a_fault(jump: int) -> None:
    rig = Rig(faults=[InjectedFault(kind="clock-jump", which=jump, at=0.1)])
    for _ in range(30):
        rig.plant.read()
    fly(rig, 0.1)()
    rig.plant.land()
    assert not rig.plant.faults and np.abs(rig.poses[-1] - REST).max() < 2e-4


@pytest.mark.parametrize("seed", sweep(range(4), every=4))
def test_a_sample_from_before_a_request_reports_an_outdated_state(seed: int) -> None:
    # A sample in transit during a reset still reports the fault.
    rig = Rig(replace(BAD, seed=seed))
    for _ in range(8):
        rig.plant.read()
        rig.plant.arm()
        rig.plant.read()
        rig.plant.estop()
        with pytest.raises(DeviceFault, match="ESTOP"):
            rig.plant.read()
        for _ in range(5):
            rig.plant.read()
        assert rig.plant.faults == rig.twin.firmware.faults == Fault.ESTOP
        rig.plant.reset()
        for _ in range(5):
            rig.plant.read()
        assert (rig.plant.state, rig.plant.faults) == (State.INACTIVE, Fault(0))


def test_a_held_flotor_ends_the_takeoff() -> None:
    rig = Rig(hand=lambda *_: [0.0, 0.0, -20.0, 0.0, 0.0, 0.0])
    error = fails(rig, rig.plant.takeoff, Fault.NOT_FOLLOWING)
    assert "off the takeoff path" in str(error) and error.cycles


class Cold(ThermalModel):
    """Coils without warming."""

    def add(self, intervals: Any) -> float:
        return 0.0


LOAD = 6.0 * 6.0 - WEIGHT[2]
"""Weight that needs 6 A from three coils [N].

6 N/A together, less the flotor's weight.
"""


@pytest.mark.parametrize(
    ("cold", "says"),
    [(None, ""), (firmware, "reached its temperature limit"), (safety, "reported by the device")],
    ids=["", "host", "device"],
)
def test_a_coil_with_6_A_trips_on_either_end(cold: Any, says: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if cold is not None:
        monkeypatch.setattr(cold, "ThermalModel", Cold)
    rig = Rig(hand=lambda *_: [0.0, 0.0, -LOAD, 0.0, 0.0, 0.0], pose=CENTRE, limits=Limits(thermal_time=2.0))
    controller = Controller([*hover(0.005, REACH).laws, Bias([0.0, 0.0, LOAD, 0.0, 0.0, 0.0])], period=0.005)
    rig.plant.arm()
    warm = []

    def watch() -> None:
        warm.append(max(rig.plant.temperatures))

    with pytest.warns(UserWarning, match="coil temperature at 80 % of its limit") as warned:
        error = fails(rig, lambda: rig.fly(5.0, controller, observe=watch), Fault.COIL_OVERTEMP)
    assert says in str(error) and len(warned) == 1
    assert len(warm) * 0.005 == pytest.approx(2.0 * math.log(4.0 / 3.0), abs=0.015)  # 0.58 s
    assert np.searchsorted(warm, 0.8) * 0.005 == pytest.approx(2.0 * math.log(5.0 / 4.0), abs=0.015)
    if cold is None:
        with pytest.raises(PlantError, match="refused RESET: state FAULT, faults COIL_OVERTEMP"):
            rig.plant.reset()
        tripped = rig.plant.samples.tick
        for _ in range(120):
            rig.plant.read()
        cooled = (rig.plant.samples.tick - tripped) * 0.005
        assert max(rig.plant.temperatures) == pytest.approx(math.exp(-cooled / 2.0), abs=0.01)  # the higher of both
        rig.plant.reset()


def test_the_host_models_currents_of_unanswered_samples() -> None:
    # Currents continue during lost samples, and so does the host's thermal model.
    rig = Rig(Impairment(loss=0.2, seed=1), hand=lambda *_: [0.0, 0.0, -10.0, 0.0, 0.0, 0.0], pose=CENTRE)
    rig.plant.arm()
    controller = Controller([*hover(0.005, BAD_REACH).laws, Bias([0.0, 0.0, 10.0, 0.0, 0.0, 0.0])], period=0.005)
    rig.fly(2.0, controller)
    assert rig.plant.samples.lost > 50
    expected = (-math.expm1(-rig.twin.tick * 0.005 / 10.0)) * ((10.0 + WEIGHT[2]) / 18.0) ** 2
    assert rig.plant._output.thermal.rises[:3] == pytest.approx([expected] * 3, rel=0.05)
