"""What is said of the currents after a flight: of three devices, in Python and in C, and refused by the host.

An amplifier that is stuck keeps its current, whatever the firmware commands.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import pytest

from maglev_mj import RemotePlant, Twin, TwinParameters, find_scene
from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.connection import EstopReport, estop
from maglev_mj.bridge.fault import DeviceFault, HandshakeError
from maglev_mj.bridge.flight import Flight
from maglev_mj.bridge.safety import at_most, limits_of
from maglev_mj.bridge.twin import twin as twins
from maglev_mj.bridge.twin.firmware import Reading
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.bridge.wire import EstopAck, Fault, HelloAck, State, fault_names
from maglev_mj.device import Device
from maglev_mj.errors import ParameterError, PlantError
from maglev_mj.frames import Command, DeviceWall
from tests.bridge.devices import DEVICES, LIGHT
from tests.bridge.firmware_core import FIRMWARE, FIRMWARES
from tests.bridge.test_handshake import Doctored

IN_FLIGHT = 1.1
"""Time of a fault after ARM [s], after takeoff and the check of the coils."""
UNCONFIRMED = "; currents not confirmed off: cut the power at the amplifiers"
NEVER_SAID = re.compile("no current|zero current|currents off|without current|0 A", re.IGNORECASE)

devices = pytest.mark.parametrize("name", DEVICES)
firmwares = pytest.mark.parametrize("firmware", FIRMWARES)


class Ending(NamedTuple):
    """End of a flight and of the emergency stop after it.

    Attributes:
        said: Message of the flight; "landed" without.
        faults: Faults of the message.
        stop: Outcome of the emergency stop.
        flowing: True currents in the end [A], six.
        height: Height in the end [m].
        speeds: Largest speed before and after the fault [m/s].
    """

    said: str
    faults: Fault
    stop: EstopReport
    flowing: list[float]
    height: float
    speeds: tuple[float, float]


class Stuck:
    """Device on which amplifiers stick, or the meter of coil 0 reads 0, from a time after ARM on.

    Args:
        device: The device.
        firmware: Name of its firmware.
        monkeypatch: Puts the firmware in place of the twin's.
        stuck: Currents of the amplifiers [A], by coil.
        blind: True for the meter.
        after: Time after ARM [s]; None: from the start.
    """

    def __init__(
        self,
        device: Device,
        firmware: str,
        monkeypatch: pytest.MonkeyPatch,
        stuck: dict[int, float],
        blind: bool = False,
        after: float | None = IN_FLIGHT,
    ) -> None:
        monkeypatch.setattr(twins, "Firmware", FIRMWARE[firmware])
        self.calibration = Calibration.of(device)
        self.twin = Twin(TwinParameters(calibration=self.calibration, seed=5), draw=lambda: 7)
        self.link = VirtualLink(self.twin)
        self._stuck, self._blind, self._due = stuck, blind, 0 if after is None else -1
        self._after = round((after or 0.0) * 1e9 / self.twin._period)
        self._sample, self._read = self.twin.sample, self.twin.firmware.sample
        self.twin.sample, self.twin.firmware.sample = self.sample, self.read  # type: ignore[method-assign]
        self.speeds = [0.0, 0.0]

    @property
    def failed(self) -> bool:
        return 0 <= self._due <= self.twin.tick

    def sample(self) -> bytes | None:
        frame = self._sample()
        speed = float(np.linalg.norm(self.twin.plant.state()[1][:3]))
        self.speeds[self.failed] = max(self.speeds[self.failed], speed)
        if self._due < 0 and self.twin.firmware.state == State.ACTIVE:
            self._due = self.twin.tick + self._after
        if self.failed:
            self.twin.board.stuck.update(self._stuck)
        return frame

    def read(self, tick: int, now: int, reading: Reading) -> bytes | None:
        if self.failed and self._blind:
            reading = reading._replace(measured=[0.0, *reading.measured[1:]])
        return self._read(tick, now, reading)

    def fly(self) -> Ending:
        """Take off, hover, land; then stop."""
        said, faults = "landed", Fault(0)
        try:
            plant = RemotePlant(self.link, calibration=self.calibration)
            scene = find_scene("joystick")().replace(period=plant.period, delay=plant.delay)
            assert Flight(plant, scene).run(0.15).landing.at_rest
        except DeviceFault as error:
            said, faults = str(error), error.faults
        stop = estop(self.link, patience=0.1)
        end = self.link.now() + 100_000_000
        while self.link.now() < end:  # until it lies
            self.link.receive(0.01)
        flowing, height = self.twin.plant.currents.tolist(), float(self.twin.pose[2])
        return Ending(said, faults, stop, flowing, height, (self.speeds[0], self.speeds[1]))


def lifted(device: Device, currents: list[float]) -> float:
    """Return the share of a device's weight that currents lift [A]."""
    calibration = Calibration.of(device)
    return float(
        calibration.coils.wrench(np.array(currents))[2] / (calibration.mass * math.hypot(*calibration.gravity))
    )


def check_words(device: Device, ending: Ending) -> None:
    """Check that each sentence is true, and that none says more than was measured."""
    off, most = device.scale.off, max(map(abs, ending.flowing))
    words = [ending.said, str(ending.stop)]
    assert not any(NEVER_SAID.search(text) or "\n" in text for text in words)
    for text in words:
        if text != "landed":
            assert ((at_most(off) in text), ("cut the power" in text)) == (most <= off, most > off)
    assert ending.stop.confirmed == (most <= off)
    if most <= off:
        assert ending.height == pytest.approx(device.rest[2], abs=5e-5) and lifted(device, ending.flowing) < 0.25
        names = fault_names(Fault.ESTOP | ending.faults)
        assert re.fullmatch(rf"stopped: {names}, {at_most(off)} \d+\.\d ms after the first request", words[1])
    else:
        coil = max(range(6), key=lambda coil: abs(ending.flowing[coil]))
        names = fault_names(Fault.ESTOP | Fault.COIL_NOT_OFF | ending.faults)
        reason = f"faults {names}, {ending.stop.currents[coil]:.3g} A in coil {coil}"
        assert words[1] == f"not confirmed: cut the power ({reason})"
        assert ending.stop.currents == pytest.approx(ending.flowing, rel=1e-6)


@firmwares
@devices
def test_an_untouched_flight_lands(name: str, firmware: str, monkeypatch: pytest.MonkeyPatch) -> None:
    ending = Stuck(DEVICES[name], firmware, monkeypatch, {}).fly()
    assert ending.said == "landed" and ending.flowing == [0.0] * 6
    check_words(DEVICES[name], ending)


STUCK: Mapping[str, Callable[[float, float], float]] = {
    "a third of hovering": lambda off, hover: hover / 3.0,
    "hovering": lambda off, hover: hover,
    "three times hovering": lambda off, hover: 3.0 * hover,
    "just off": lambda off, hover: 0.98 * off,
    "not quite off": lambda off, hover: 1.02 * off,
}
"""Currents of stuck amplifiers [A], from `Scale.off` and the largest hover current [A]."""


@firmwares
@pytest.mark.parametrize("coils", [1, 3])
@pytest.mark.parametrize("current", STUCK)
@devices
def test_amplifiers_that_stick_in_flight(
    name: str, current: str, coils: int, firmware: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    device = DEVICES[name]
    hover = float(np.abs(Calibration.of(device).hover).max())
    flowing = STUCK[current](device.scale.off, hover)
    ending = Stuck(device, firmware, monkeypatch, dict.fromkeys(range(coils), flowing)).fly()
    print(table_row(name, firmware, coils, flowing, ending))
    assert ending.flowing[:coils] == [flowing] * coils and not any(ending.flowing[coils:])
    alike = current == "hovering" and coils == 1  # as its command, until the landing has cut the others
    assert ending.faults & Fault.COIL_NOT_FOLLOWING or (alike and ending.faults == Fault.COIL_NOT_OFF)
    assert ending.said.startswith(f"{fault_names(ending.faults)}: reported by the device")
    assert ending.said.endswith(f"; {at_most(device.scale.off)}" if "just off" == current else UNCONFIRMED)
    check_words(device, ending)


def table_row(name: str, firmware: str, coils: int, current: float, ending: Ending) -> str:
    """Return an ending as a row of a table."""
    before, after = ending.speeds
    said = re.sub("; the last cycles are in [^;]*", "", ending.said)
    numbers = f"{coils} x {current:.3g} | {ending.height * 1e3:+.2f} | {before:.3f} | {after:.3f}"
    return f"| {name} | {firmware} | {numbers} | {said} | {ending.stop} |"


@firmwares
@devices
def test_a_meter_that_reads_zero_ends_the_flight(name: str, firmware: str, monkeypatch: pytest.MonkeyPatch) -> None:
    ending = Stuck(DEVICES[name], firmware, monkeypatch, {}, blind=True).fly()
    assert ending.faults == Fault.COIL_NOT_FOLLOWING and ending.said.endswith(at_most(DEVICES[name].scale.off))
    check_words(DEVICES[name], ending)


@firmwares
@devices
def test_a_device_with_a_stuck_amplifier_does_not_take_off(
    name: str, firmware: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    device = DEVICES[name]
    rig = Stuck(device, firmware, monkeypatch, {0: 1.02 * device.scale.off}, after=None)
    plant = RemotePlant(rig.link, calibration=rig.calibration)
    plant.read()
    rig.twin.board.cut()  # the current begins to flow
    with pytest.raises(DeviceFault, match=r"^COIL_NOT_OFF: reported by the device; ") as caught:
        plant.takeoff()
    assert str(caught.value).endswith(UNCONFIRMED) and not NEVER_SAID.search(str(caught.value))
    flowing = rig.twin.plant.currents.tolist()
    assert not any(flowing[1:]) and rig.twin.firmware.faults == Fault.COIL_NOT_OFF  # ARM was never sent
    with pytest.raises(PlantError, match="no takeoff: device state FAULT, faults COIL_NOT_OFF: find the cause"):
        plant.takeoff()
    with pytest.raises(
        PlantError, match="the device refused RESET: state FAULT, faults COIL_NOT_OFF; remove the cause"
    ):
        plant.reset()


# refused at the handshake


def refused(device: Device, change: Callable[[Any], Any] = lambda body: body) -> str:
    """Return why the host refuses the twin of a device whose answers are changed; "" if it accepts it."""
    calibration = Calibration.of(device)
    link = Doctored(Twin(TwinParameters(calibration=calibration)), change)
    try:
        RemotePlant(link, calibration=calibration).close()
    except HandshakeError as error:
        assert link.closed == 1 and "\n" not in str(error)
        return str(error)
    return ""


def stating(**values: Any) -> Callable[[Any], Any]:
    """Return a function that changes what HELLO_ACK states."""
    return lambda body: body._replace(**values) if isinstance(body, HelloAck) else body


@devices
def test_a_device_whose_currents_that_are_off_could_lift_its_flotor_is_refused(name: str) -> None:
    calibration, off = Calibration.of(DEVICES[name]), DEVICES[name].scale.off
    lift = lifted(DEVICES[name], (off * np.sign(calibration.coils.wrench_per_current[2])).tolist())
    assert lift == pytest.approx(0.22, abs=0.005)
    for share in (0.2, 0.249):
        assert not refused(DEVICES[name], stating(off_current=share / lift * off))
    for share in (0.251, 0.5):
        stated, most = share / lift * off, 0.25 / lift * off
        words = re.fullmatch(
            r"the device cannot tell that its coils are off: off_current must be at most "
            r"(\S+) A, which lifts 25 % of the weight \(got (\S+) A\)",
            refused(DEVICES[name], stating(off_current=stated)),
        )
        assert words and [float(word) for word in words.groups()] == pytest.approx([most, stated], rel=5e-3)


@devices
def test_a_device_whose_meter_is_too_coarse_is_refused(name: str) -> None:
    off = DEVICES[name].scale.off
    for steps in (3.01, 100.0):
        assert not refused(DEVICES[name].change("coils", meter=off / steps))
    for steps in (2.99, 1.0):
        coarse = Calibration.of(DEVICES[name].change("coils", meter=off / steps))
        problem = f"off_current must be at least three times coils.meter, {off / steps:.3g} A (got {off:.3g} A)"
        with pytest.raises(ParameterError, match=re.escape(problem)):  # where its limits are made
            TwinParameters(calibration=coarse)
        other = TwinParameters(calibration=coarse, limits=limits_of(DEVICES[name]))
        with pytest.raises(HandshakeError, match=re.escape(f"cannot tell that its coils are off: {problem}")):
            RemotePlant(VirtualLink(Twin(other)), calibration=coarse)


def test_the_host_sends_no_more_walls_than_the_device_states() -> None:
    for count, problem in ((13, "wall_count must be between 0 and 12"), (2, "")):
        said = refused(LIGHT, stating(wall_count=count))
        assert (problem in said) if problem else not said
    calibration = Calibration.of(LIGHT)
    plant = RemotePlant(
        Doctored(Twin(TwinParameters(calibration=calibration)), stating(wall_count=2)), calibration=calibration
    )
    plant.read()
    walls = [DeviceWall(axis, -1e-3, 1, 100.0, 1.0, None) for axis in range(3)]
    assert len(plant.check_walls(walls[:2])) == 2
    with pytest.raises(DeviceFault, match=r"the device renders at most 2 walls [(]got 3[)]"):
        plant.write(Command([0.0] * 6, walls=tuple(walls)))


# emergency stops in lockstep


@pytest.mark.parametrize("lockstep", [1, 0])
@devices
def test_a_clock_that_stands_still_confirms_a_stop_only_if_lockstep_is_stated(name: str, lockstep: int) -> None:
    calibration = Calibration.of(DEVICES[name])
    twin = Twin(TwinParameters(calibration=calibration, lockstep=True))

    def said(body: Any) -> Any:
        return body._replace(lockstep=lockstep) if isinstance(body, EstopAck) else body

    report = estop(Doctored(twin, said), patience=0.05)
    assert twin.firmware.state == State.FAULT and report.confirmed == bool(lockstep) and report.off is None
    if lockstep:
        assert re.fullmatch(
            r"stopped: ESTOP \d\.\d ms after the first request; in lockstep no sample follows, so the currents are not "
            "measured",
            str(report),
        )
    else:
        assert str(report) == "not confirmed: cut the power (faults ESTOP, no sample in 0.05 s)"
