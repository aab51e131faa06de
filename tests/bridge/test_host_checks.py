"""Host guards: device errors that the device does not report."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from maglev_mj.bridge.fault import DeviceFault
from maglev_mj.bridge.safety import Limits
from maglev_mj.bridge.wire import Fault, Flag, State, StateReport, fault_names
from maglev_mj.control import Bias
from maglev_mj.control.controller import Controller
from maglev_mj.errors import PlantError, SensingError
from tests.bridge.impaired import Impairment
from tests.bridge.test_bridge import CENTRE, Rig
from tests.published import WEIGHT


def doctored(rig: Rig, change: Callable[[StateReport], StateReport]) -> None:
    """Change the device's reports from now on.

    The device itself believes it sound.
    """
    encode = rig.twin.firmware._codec.encode

    def changed(session: int, sequence: int, time: int, body: Any) -> bytes:
        return encode(session, sequence, time, change(body) if isinstance(body, StateReport) else body)

    rig.twin.firmware._codec.encode = changed  # type: ignore[method-assign]


def put(name: str, place: int, value: float) -> Callable[[StateReport], StateReport]:
    """Return a function that replaces one of six values."""

    def change(report: StateReport) -> StateReport:
        values = list(getattr(report, name))
        values[place] = value
        return report._replace(**{name: tuple(values)})  # type: ignore[arg-type]

    return change


def far(rig: Rig) -> None:
    """Move the flotor out of its envelope in the host's pose only."""
    track = rig.plant._track
    rig.plant._track = lambda spots: [0.006, *track(spots)[1:]]  # type: ignore[assignment]


def no_pose(rig: Rig) -> None:
    """Make pose measurement fail from now on."""

    def none(spots: Any) -> Any:
        raise SensingError("no pose was found")

    rig.plant._track = none  # type: ignore[assignment]


def backwards(rig: Rig) -> None:
    """Let the pose appear to move against the commands."""
    rig.plant._hand.residual.reversed = True


def out_of_step(rig: Rig) -> None:
    """Put the device's clock forward by two samples."""
    rig.plant.samples._sequence -= 2


def warm(rig: Rig) -> None:
    """Put a coil of the host's thermal model at its limit."""
    rig.plant._output.thermal.rises[3] = 1.01


def reported(change: Callable[[StateReport], StateReport]) -> Callable[[Rig], None]:
    """Return a function that changes the device's reports."""
    return lambda rig: doctored(rig, change)


GUARDED: list[tuple[Callable[[Rig], None], str]] = [
    (reported(put("spots", 3, -0.0210)), "SENSOR_OUT_OF_RANGE: spots "),
    (reported(put("currents", 4, 15.1)), "COIL_OVERCURRENT: measured currents "),
    (no_pose, "SENSOR_OUT_OF_RANGE: no pose was found"),
    (backwards, "NOT_FOLLOWING: the measured pose moves against the commanded force, at "),
    (far, "FLOTOR_OVERSPEED BOUNDARY: the flotor is at 6.00, "),
    (reported(put("currents", 3, 0.9)), "COIL_NOT_FOLLOWING: measured currents "),
    (
        reported(lambda report: report._replace(flags=Flag.HOLDING | Flag.ENABLED)),
        "HOST: the device reports HOLDING",
    ),
    (reported(lambda report: report._replace(flags=0)), "HOST: amplifiers not ENABLED"),
    (out_of_step, "CLOCK: "),
    (warm, "COIL_OVERTEMP: coil 3 reached its temperature limit"),
]
"""For each guard, in order: the injected error, and its message."""


def test_every_guard_has_its_fault_in_the_list() -> None:
    names = [getattr(check, "func", check) for _, check in Rig().plant.guards]
    assert len(GUARDED) == len(names), f"give each guard a row in GUARDED, in this order: {names}"


@pytest.mark.parametrize("index", range(len(GUARDED)))
def test_each_guard_detects_its_fault_and_no_other_guard_does(index: int) -> None:
    prepare, message = GUARDED[index]
    for guarded in (True, False):
        rig = Rig(pose=CENTRE)
        rig.plant.arm()
        rig.fly(0.05)
        began = rig.plant.samples.time
        prepare(rig)
        if not guarded:
            del rig.plant.guards[index]
        error = ""
        try:
            rig.fly(0.02)
        except (DeviceFault, SensingError) as caught:
            error = str(caught)
        assert error.startswith(message) == guarded and "\n" not in error, error
        if guarded:  # cuts the currents at once
            faults = rig.twin.firmware.faults
            assert error.startswith(f"{fault_names(faults)}: ") and rig.twin.firmware.state == State.FAULT
            assert rig.plant.fault_time - began <= 20_000_000
            for _ in range(105 if faults == Fault.HOST else 1):  # a controlled stop takes 0.5 s
                rig.currents()
            assert rig.currents() == [0.0] * 6


@pytest.mark.parametrize("missed", [1, 3])
def test_lost_samples_do_not_count_as_speed(missed: int) -> None:
    # Pushed to more than half of what trips; a gap makes the step look larger, not the speed.
    start = 0.25
    hand = lambda tick, at, state: [8.0 * (start < at < start + 0.033), *[0.0] * 5]  # noqa: E731
    gap = Impairment(blackouts=((start + 0.0315, start + 0.0315 + 0.005 * missed),))
    rig = Rig(gap, pose=(-0.004, 0.0, 0.0, 0.0, 0.0, 0.0), hand=hand, limits=Limits(spot_speed=0.4))
    rig.plant.arm()
    controller = Controller([Bias(WEIGHT)], period=0.005)
    rig.fly(start + 0.031 + 0.005 * missed + 0.007, controller)
    speeds = [math.hypot(*twist[:3]) for twist in rig.witness.twists]
    assert rig.plant.samples.lost == missed and max(speeds) > 0.33
    assert not rig.plant.faults


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ([{"flags": 0}] * 2, "^HOST: amplifiers not ENABLED, but the device has not cut the currents"),
        ([{"flags": 0}, {}, {"flags": 0}], ""),
        ([{"flags": 0, "state": State.INACTIVE}] * 2, ""),  # late samples, from before arming
        ([{"faults": 1024}], "^HOST: the device reports state ACTIVE with faults CLOCK"),
        ([{"state": State.FAULT}], "^HOST: the device reports state FAULT with faults none"),
        ([{}, {"flags": Flag.HOLDING | Flag.ENABLED}], "^HOST: the device reports HOLDING, but its newest"),
        ([{"currents": (2.0,) * 6}] * 2, ""),  # the third in a row counts
    ],
)
def test_a_device_that_contradicts_itself_is_not_flown(changes: list[dict[str, Any]], says: str) -> None:
    rig = Rig(pose=CENTRE)
    rig.plant.arm()
    rig.fly(0.05)
    left = [*changes]
    doctored(rig, lambda report: report._replace(**left.pop(0)) if left else report)
    if not says:
        rig.plant._connection.settled = rig.link.time + 50_000_000
        rig.fly(0.05)
        return
    with pytest.raises(DeviceFault, match=says):
        rig.fly(0.05)


def test_a_sample_from_before_a_stop_does_not_undo_it(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig(pose=CENTRE)
    rig.plant.arm()
    rig.plant.read()
    receive = rig.link.receive
    stale = receive(1.0)
    assert stale is not None and stale[3] == 5

    def no_samples(timeout: float) -> bytes | None:
        end = rig.link.time + round(timeout * 1e9)
        while (data := receive((end - rig.link.time) * 1e-9)) is not None and data[3] == 5:
            pass
        return data

    monkeypatch.setattr(rig.link, "receive", no_samples)
    rig.plant.estop()
    monkeypatch.undo()
    rig.plant._armed = False  # not in flight: no fault expected
    rig.link._arrived[:] = [stale]
    for _ in range(3):
        rig.plant.read()
        assert (rig.plant.state, rig.plant.faults) == (State.FAULT, Fault.ESTOP)


def test_endless_garbage_is_not_a_sample() -> None:
    rig = Rig()
    rig.plant.read()

    def rubbish(timeout: float) -> bytes:
        rig.link.time += 1_000_000
        return b"rubbish"

    rig.link.receive = rubbish  # type: ignore[method-assign]
    with pytest.raises(PlantError, match="no sample from the device within 1 s"):
        rig.plant.read()
