"""Ends of flights by failures of line, device or host."""

from __future__ import annotations

from pathlib import Path
from unittest.mock import Mock

import pytest

from maglev_mj.bridge.fault import DeviceFault, load_fault
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.bridge.wire import Fault, State
from maglev_mj.errors import MaglevError
from tests.bridge.test_bridge import CENTRE, Rig


@pytest.mark.parametrize("kind", [ZeroDivisionError, KeyboardInterrupt])
def test_a_program_that_fails_in_flight_leaves_a_fault_and_a_file_and_one_that_is_stopped_does_not(
    kind: type[BaseException], folder: Path
) -> None:
    rig = Rig(pose=CENTRE)
    with pytest.raises(kind), rig.plant:
        rig.plant.arm()
        rig.fly(0.5, observe=Mock(side_effect=[*[None] * 50, kind("oh")]))
    files = list(folder.glob("fault-*.maglev"))
    if kind is KeyboardInterrupt:
        assert rig.twin.firmware.state == State.INACTIVE and not files
    else:
        assert rig.twin.firmware.faults == Fault.HOST and load_fault(files[0]).message == "ZeroDivisionError: oh"
    rig.currents()
    assert rig.currents() == [0.0] * 6


def test_commands_that_have_lain_in_a_queue_do_not_feed_the_watchdog() -> None:
    rig, send, kept = Rig(), VirtualLink.send, list[bytes]()

    def queued(data: bytes) -> None:
        """Deliver every second command, ever later."""
        kept.append(data)
        if data[3] != 6:
            send(rig.link, kept.pop())
        elif len(kept) % 2 == 0:
            send(rig.link, kept[len(kept) // 2 - 1])

    rig.plant.takeoff()
    rig.link.send = queued  # type: ignore[method-assign]
    with pytest.raises(DeviceFault):
        rig.fly(5.0)
    assert rig.twin.firmware.faults & (Fault.WATCHDOG | Fault.FLOTOR_OVERSPEED) and rig.plant.samples.tick < 400


def test_a_forked_process_that_leaves_its_copy_ends_no_flight(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig(pose=CENTRE)
    rig.plant.arm()
    rig.fly(0.1)
    with monkeypatch.context() as patch:
        patch.setattr("os.getpid", lambda: -1)
        rig.plant._connection._link = Mock(wraps=rig.link)
        rig.plant.close()
        assert not rig.plant._connection._link.send.called
    assert rig.twin.firmware.state == State.ACTIVE


def test_calls_of_a_closed_plant_raise() -> None:
    rig = Rig()
    rig.plant.close()
    rig.plant.close()
    for act in (rig.plant.read, rig.plant.arm, rig.plant.estop, rig.plant.land):
        with pytest.raises(MaglevError, match="the plant is closed"):
            act()
