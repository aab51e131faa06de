"""Ends of flights by failures of line, device or host."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from maglev_mj.bridge.fault import DeviceFault, load_fault
from maglev_mj.bridge.links import LinkError
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.bridge.wire import Fault, State, StateReport
from maglev_mj.errors import MaglevError
from maglev_mj.frames import Command
from tests.bridge.test_bridge import CENTRE, Rig


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write black boxes to a temporary folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def cut(rig: Rig) -> None:
    """Break the line: every later use is an error."""

    def gone(_: object) -> None:
        raise LinkError("the line is gone")

    for way in ("send", "receive"):
        setattr(rig.link, way, gone)


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


def fault_of(rig: Rig, act: Callable[[Rig], object]) -> DeviceFault:
    """Return the fault of an action in flight.

    It must have left a file.
    """
    with pytest.raises(DeviceFault) as caught:
        rig.fly(1.5, observe=at_tick(rig, 210, act))
    assert caught.value.path is not None and load_fault(caught.value.path).time.size == 200
    for _ in range(15):
        rig.twin.sample()
    assert rig.currents() == [0.0] * 6
    return caught.value


def test_a_fault_found_while_the_line_goes_is_the_one_reported() -> None:
    rig = hovering()
    cut(rig)
    with pytest.raises(DeviceFault, match="INVALID_COMMAND: a command must be six finite numbers"):
        rig.plant.write(Command([float("nan")] * 6))
    assert rig.plant.state == State.FAULT


@pytest.mark.parametrize("force", [["a"] * 6, None])
def test_a_command_of_no_numbers_is_invalid_too(force: object) -> None:
    rig = hovering()
    with pytest.raises(DeviceFault, match="INVALID_COMMAND"):
        rig.plant.write(Command(force))  # type: ignore[arg-type]
    assert rig.twin.firmware.faults == Fault.INVALID_COMMAND


def disarms(rig: Rig) -> None:
    rig.twin.board.cut()
    rig.twin.firmware.state = State.INACTIVE


def test_a_device_that_switches_its_currents_off_by_itself_is_not_flown_on() -> None:
    error = fault_of(hovering(), disarms)
    assert error.faults == Fault.HOST and "switched its currents off" in str(error)


def talks_nonsense(rig: Rig) -> None:
    sample = rig.twin.firmware._codec.encode

    def encode(session: int, sequence: int, time: int, body: object) -> bytes:
        if isinstance(body, StateReport):
            body = body._replace(state=7)
        return sample(session, sequence, time, body)  # type: ignore[arg-type]

    rig.twin.firmware._codec.encode = encode  # type: ignore[method-assign]


def test_a_state_that_is_none_is_a_fault() -> None:
    error = fault_of(hovering(), talks_nonsense)
    assert error.faults == Fault.HOST and "in state 7, which is none" in str(error)


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
