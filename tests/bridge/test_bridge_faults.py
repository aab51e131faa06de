"""Faults of device, line or host: zero currents, name, file.

Everything here is one process in virtual time: nothing depends on how fast the machine is.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj.bridge import safety
from maglev_mj.bridge.fault import DeviceFault, load_fault
from maglev_mj.bridge.safety import Limits, ThermalModel
from maglev_mj.bridge.twin import firmware
from maglev_mj.bridge.twin.fault_injection import INJECTED_FAULTS, InjectedFault
from maglev_mj.bridge.twin.twin import REST
from maglev_mj.bridge.wire import Fault, State, fault_names
from maglev_mj.control import Bias
from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import drive
from maglev_mj.errors import PlantError
from maglev_mj.frames import Command, Sample
from maglev_mj.plants.hand import SpringHand
from maglev_mj.scenes.rooms import WEIGHT
from tests.bridge.impaired import Impairment
from tests.bridge.test_bridge import BAD, BAD_REACH, CENTRE, REACH, TOUR, ZERO, Rig, hover
from tests.sweeps import sweep

AWAY = Fault.FLOTOR_OVERSPEED | Fault.BOUNDARY | Fault.SENSOR_OUT_OF_RANGE
"""Fault names of a flotor out of control."""


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write black boxes to a temporary folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


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
    assert record.tick == rig.plant.samples.tick <= last["sample"] <= rig.twin.tick
    if "said by the device" in str(error):
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


@pytest.mark.parametrize(("frequency", "seed"), sweep([150.0, 300.0], range(4), every=4))
def test_a_hold_too_stiff_for_a_bad_line_fails_safe(frequency: float, seed: int) -> None:
    rig = Rig(replace(BAD, seed=seed))
    error = fails(rig, fly(rig, 5.0, hover(0.005, BAD_REACH, frequency)), AWAY)
    print(error.faults)


def test_a_blackout_longer_than_the_watchdog_latches_until_reset() -> None:
    rig = hovering(impairment=Impairment(blackouts=((0.3, 0.5),)))
    fails(rig, lambda: rig.fly(1.0), Fault.WATCHDOG)
    for _ in range(40):  # it falls
        rig.plant.read()
    assert rig.twin.pose[2] == pytest.approx(REST[2], abs=1e-5)
    rig.plant.reset()
    assert not rig.twin.firmware.faults
    assert rig.currents() == [0.0] * 6  # a reset arms nothing
    fly(rig, 0.1)()
    rig.plant.land()
    assert np.abs(rig.twin.pose - REST)[:3].max() < 1e-4  # where it fell, it lay a little askew


@pytest.mark.parametrize(
    "command",
    [
        Command([math.nan, *WEIGHT[1:]]),
        Command([*WEIGHT[:5], -math.inf]),
        Command(WEIGHT, [math.nan] * 6, 0.003),
        Command(WEIGHT, ZERO, math.inf),
        Command(WEIGHT[:5]),
    ],
    ids=["nan", "inf", "pulse", "width", "five"],
)
def test_the_gate_refuses_what_is_no_command(command: Command) -> None:
    class Broken(Controller):
        def step(self, sample: Sample) -> Command:
            return command if sample.tick == 30 else super().step(sample)

    rig = hovering()
    broken = Broken(hover(0.005, REACH).laws, period=0.005)
    error = fails(rig, lambda: rig.fly(1.0, broken), Fault.INVALID_COMMAND)
    assert [sample.tick for sample, _ in error.cycles] == list(range(31)) and error.cycles[-1][1] is command


# what happens to a flotor that hovers or that a hand moves about, and what it is called
SUFFERED: list[tuple[str, int, bool, Fault]] = [
    *(("dead-coil", coil, True, Fault.COIL_NOT_FOLLOWING) for coil in range(6)),
    *(("stuck-diode", diode, moved, Fault.SENSOR_FROZEN) for diode in range(3) for moved in (False, True)),
    *(("invalid-diode", diode, False, Fault.SENSOR_OUT_OF_RANGE) for diode in range(3)),
    *(("swapped-diodes", diode, True, AWAY) for diode in range(3)),
    ("clock-jump", 3, False, Fault.CLOCK),
    ("clock-jump", 30, False, Fault.CLOCK),
    ("clock-jump", 100, False, Fault.WATCHDOG),
    ("silence", 200, False, Fault.WATCHDOG),
    *(("stuck-diodes", 0, moved, Fault.SENSOR_FROZEN) for moved in (False, True)),
    ("stuck-counter", 0, False, Fault.SENSOR_STOPPED),
    *(("nan-spot", place, False, Fault.SENSOR_OUT_OF_RANGE) for place in range(6)),
    *(("nan-current", coil, False, Fault.COIL_OVERCURRENT) for coil in range(6)),
    *(("nan-temperature", coil, False, Fault.COIL_OVERTEMP) for coil in range(6)),
    *(("hot-report", coil, False, Fault.COIL_OVERTEMP) for coil in range(6)),
]
ELSEWHERE = {"stuck-amplifier", "hung-firmware"}
"""Kinds with their own tests, for their other effects."""
OF_KIND = {"dead-coil": 5, "stuck-diode": 2, "invalid-diode": 2, "swapped-diodes": 2}
"""Coil or diode that is tried of these kinds; of six places else the first, the others are studies."""


def tried(kind: str, which: int, *more: Any, period: float = 0.005) -> Any:
    """Return a case, a study unless it is the one of its kind."""
    one = which == OF_KIND.get(kind, which if "-jump" in kind or kind == "silence" else 0)
    return pytest.param(kind, which, *more, period, marks=[] if one and period > 0.001 else pytest.mark.study)


@pytest.mark.parametrize(
    ("kind", "which", "moved", "fault", "period"),
    [tried(*case) for case in SUFFERED] + [tried(*case, period=0.001) for case in SUFFERED if case[1] == 2 and case[2]],
)
def test_a_misfortune_is_named(kind: str, which: int, moved: bool, fault: Fault, period: float) -> None:
    hand = SpringHand(target=TOUR) if moved else None  # after takeoff
    at = 1.0 if moved else 0.2
    options: dict[str, Any] = {"faults": [InjectedFault(kind=kind, which=which, at=at)], "hand": hand, "period": period}
    rig = Rig(**options) if moved else hovering(**options)
    error = fails(rig, fly(rig) if moved else lambda: rig.fly(1.0), fault)
    assert rig.twin.firmware.faults & ~Fault.COIL_NOT_OFF == error.faults  # which a current that is NaN is too
    last = error.cycles[-1][0].tick
    assert last >= rig.plant.samples.tick - 1 or kind == "silence"
    print(f"{error.faults!r} after {(rig.plant.samples.tick * period - at) * 1e3:.0f} ms")


def test_diodes_that_are_swapped_from_the_beginning_are_found_in_takeoff() -> None:
    rig = Rig(faults=[InjectedFault(kind="swapped-diodes", which=2, at=0.0)])
    fails(rig, rig.plant.takeoff, Fault.NOT_FOLLOWING)


def test_all_misfortunes_are_tried() -> None:
    assert {kind for kind, *_ in SUFFERED} | ELSEWHERE == set(INJECTED_FAULTS)


def test_a_device_that_says_nothing_is_given_up() -> None:
    rig = hovering(faults=[InjectedFault(kind="silence", which=10_000, at=0.2)])
    with pytest.raises(DeviceFault, match="HOST: no sample from the device within 1 s") as caught:
        rig.fly(2.0)
    check_file(rig, caught.value)
    assert rig.twin.firmware.faults == Fault.WATCHDOG and rig.currents() == [0.0] * 6


@pytest.mark.parametrize("jump", [10_000, *(pytest.param(jump, marks=pytest.mark.study) for jump in (3, 12))])
def test_a_clock_set_while_the_device_rests_is_no_fault(jump: int) -> None:
    rig = Rig(faults=[InjectedFault(kind="clock-jump", which=jump, at=0.1)])
    for _ in range(30):
        rig.plant.read()
    fly(rig, 0.1)()
    rig.plant.land()
    assert not rig.plant.faults and np.abs(rig.poses[-1] - REST).max() < 2e-4


@pytest.mark.parametrize("state", ["inactive", "active", "fault"])
def test_an_estop_of_the_host_itself_is_taken_in_every_state_and_twice(state: str) -> None:
    rig = Rig() if state == "inactive" else hovering()
    rig.plant.read()
    if state == "fault":
        rig.plant.trip(Fault.CLOCK)
    before = rig.twin.firmware.faults
    for _ in range(3):
        rig.plant.estop()
        assert rig.twin.firmware.faults == rig.plant.faults == before | Fault.ESTOP
    check_dead(rig)
    if state != "inactive":  # whoever flies is told, once
        with pytest.raises(DeviceFault, match="ESTOP"):
            rig.plant.read()
    rig.plant.read()
    assert rig.plant.state == State.FAULT and rig.plant.faults == before | Fault.ESTOP
    rig.plant.reset()
    rig.plant.arm()


def test_an_estop_that_nobody_hears_is_not_taken_for_granted() -> None:
    rig = hovering(impairment=Impairment(blackouts=((0.2, 9.0),)))
    with pytest.raises(DeviceFault, match="HOST: no sample from the device within 1 s"):
        rig.fly(1.0)
    with pytest.raises(PlantError, match=r"emergency stop not confirmed: cut the power \(no answer within 1 s"):
        rig.plant.estop()
    assert rig.twin.firmware.faults == Fault.WATCHDOG and rig.currents() == [0.0] * 6


@pytest.mark.parametrize("seed", sweep(range(4), every=4))
def test_what_a_sample_says_from_before_a_request_is_old(seed: int) -> None:
    # A sample that was on its way during a reset tells of the fault before it.
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


def test_a_flotor_that_is_held_is_not_led() -> None:
    rig = Rig(hand=lambda *_: [0.0, 0.0, -20.0, 0.0, 0.0, 0.0])
    error = fails(rig, rig.plant.takeoff, Fault.NOT_FOLLOWING)
    assert "not where it is led" in str(error) and error.cycles


class Cold(ThermalModel):
    """Coils that never warm."""

    def add(self, segments: Any) -> float:
        return 0.0


LOAD = 6.0 * 6.0 - WEIGHT[2]
"""Weight that needs 6 A from three coils [N].

6 N/A together, less the flotor's weight.
"""


@pytest.mark.parametrize(
    ("cold", "says"),
    [(None, ""), (firmware, "bears no more"), (safety, "said by the device")],
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

    with pytest.warns(UserWarning, match="a coil is at 80% of what it bears") as warned:
        error = fails(rig, lambda: rig.fly(5.0, controller, observe=watch), Fault.COIL_OVERTEMP)
    assert says in str(error) and len(warned) == 1
    assert rig.plant.samples.tick * 0.005 == pytest.approx(2.0 * math.log(4.0 / 3.0), abs=0.015)  # 0.58 s
    assert np.searchsorted(warm, 0.8) * 0.005 == pytest.approx(2.0 * math.log(5.0 / 4.0), abs=0.015)
    if cold is None:
        with pytest.raises(PlantError, match="refused RESET: it is FAULT, faults COIL_OVERTEMP"):
            rig.plant.reset()
        tripped = rig.plant.samples.tick
        for _ in range(120):
            rig.plant.read()
        cooled = (rig.plant.samples.tick - tripped) * 0.005
        assert max(rig.plant.temperatures) == pytest.approx(math.exp(-cooled / 2.0), abs=0.01)  # the higher of both
        rig.plant.reset()


def test_the_host_counts_currents_that_nobody_answered_with() -> None:
    # Where samples are lost the currents flow on, and so does the host's count of what warms the coils.
    rig = Rig(Impairment(loss=0.2, seed=1), hand=lambda *_: [0.0, 0.0, -10.0, 0.0, 0.0, 0.0], pose=CENTRE)
    rig.plant.arm()
    controller = Controller([*hover(0.005, BAD_REACH).laws, Bias([0.0, 0.0, 10.0, 0.0, 0.0, 0.0])], period=0.005)
    rig.fly(2.0, controller)
    assert rig.plant.samples.lost > 50
    expected = (-math.expm1(-rig.twin.tick * 0.005 / 10.0)) * ((10.0 + WEIGHT[2]) / 18.0) ** 2
    assert rig.plant._output.thermal.rises[:3] == pytest.approx([expected] * 3, rel=0.05)


def test_a_fault_in_a_loop_of_ones_own_has_its_cycles() -> None:
    rig = Rig(faults=[InjectedFault(kind="invalid-diode", which=1, at=0.5)], pose=CENTRE)
    rig.plant.arm()
    with pytest.raises(DeviceFault) as caught:
        drive(rig.plant, hover(0.005, REACH), 500)
    assert [sample.tick for sample, _ in caught.value.cycles] == list(range(50, 100))
