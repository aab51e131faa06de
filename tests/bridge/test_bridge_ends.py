"""Ends of flights by failures of line, device or host."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from maglev_mj.bridge.fault import DeviceFault, load_fault
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.bridge.wire import Fault, State
from maglev_mj.errors import MaglevError
from tests.bridge.test_bridge import CENTRE, Rig


def at_tick(rig: Rig, tick: int, act: Callable[[Rig], object]) -> Callable[[], None]:
    """Return a hook that acts at one sample."""

    def observe() -> None:
        if rig.plant.samples.tick == tick:
            act(rig)

    return observe


def hovering() -> Rig:
    """Return a rig whose flotor is at the centre, armed, with its first sample read."""
    rig = Rig(pose=CENTRE)
    rig.plant.arm()
    rig.plant.read()
    return rig


@pytest.mark.parametrize("kind", [ZeroDivisionError, KeyboardInterrupt])
def test_a_program_that_fails_in_flight_leaves_a_fault_and_a_file_and_one_that_is_stopped_does_not(
    kind: type[BaseException], folder: Path
) -> None:
    rig = hovering()

    def stumble(_: Rig) -> None:
        raise kind("oh")

    with pytest.raises(kind), rig.plant:
        rig.fly(0.5, observe=at_tick(rig, 50, stumble))
    files = list(folder.glob("fault-*.maglev"))
    if kind is KeyboardInterrupt:
        assert rig.twin.firmware.state == State.INACTIVE and not files
    else:
        assert rig.twin.firmware.faults == Fault.HOST
        assert load_fault(files[0]).message == "ZeroDivisionError: oh"
    rig.currents()
    assert rig.currents() == [0.0] * 6


class Queueing(VirtualLink):
    """Link that delivers every second command, ever later."""

    def __init__(self, *arguments: object) -> None:
        super().__init__(*arguments)  # type: ignore[arg-type]
        self.kept: list[bytes] = []

    def send(self, data: bytes) -> None:
        """Queue commands, delivered at half the rate."""
        if data[3] != 6:
            super().send(data)
            return
        self.kept.append(data)
        if len(self.kept) % 2 == 0:
            super().send(self.kept[len(self.kept) // 2 - 1])


def test_commands_that_have_lain_in_a_queue_do_not_feed_the_watchdog() -> None:
    rig = Rig()
    line = Queueing(rig.twin)
    line.time = rig.link.time
    rig.plant.takeoff()
    rig.plant._line._link = line
    line.time = rig.link.time
    with pytest.raises(DeviceFault):
        rig.fly(5.0)
    assert rig.twin.firmware.faults & (Fault.WATCHDOG | Fault.FLOTOR_OVERSPEED)
    assert rig.plant.samples.tick < 400


def test_what_a_closed_plant_is_asked_for_is_an_error() -> None:
    rig = Rig()
    rig.plant.close()
    rig.plant.close()
    for act in (rig.plant.read, rig.plant.arm, rig.plant.estop, rig.plant.land):
        with pytest.raises(MaglevError, match="the plant is closed"):
            act()
