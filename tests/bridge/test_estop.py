"""Emergency stops from a second process, in any situation."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any
from unittest.mock import Mock

import pytest

from maglev_mj.bridge.connection import EstopReport, estop
from maglev_mj.bridge.fault import DeviceFault
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.bridge.twin.twin import Twin, TwinParameters
from maglev_mj.bridge.wire import Fault, State
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Command as MotionCommand
from tests.bridge.impaired import Impairer, Impairment
from tests.bridge.test_bridge import CENTRE, Rig
from tests.published import REST
from tests.sweeps import further

KEY = b"0123456789abcdef"
CASES, ALLOWED = 20, 0.03
SOME = (0, 13, 19)
"""First case, last case, and one between."""


class Beside:
    """Second line to a rig's device.

    Time goes on while its program waits; the host's samples are kept.

    Args:
        rig: Rig with the device.
        loss: Share of lost frames, each way.
        seed: Seed of the loss.
    """

    def __init__(self, rig: Rig, loss: float = 0.0, seed: int = 0) -> None:
        self._rig, self._heard, self._currents = rig, list[bytes](), list[tuple[int, bool]]()
        self._ways = [Impairer(Impairment(loss=loss, seed=seed), way) for way in (0, 1)]

    def send(self, data: bytes) -> None:
        """Send a frame; note when the first arrives."""
        link, twin = self._rig.link, self._rig.twin
        for _, copy in self._ways[0].fates(data, link.time):
            if not self._currents:
                self._currents.append((link.time, True))
            answer = twin.receive(copy, link.time, "beside")
            self._heard += [one for _, one in self._ways[1].fates(answer, link.time)] if answer else []

    def receive(self, timeout: float) -> bytes | None:
        """Return a frame, or go on in time."""
        if self._heard:
            return self._heard.pop(0)
        link, end = self._rig.link, self.now() + round(timeout * 1e9)
        while link._next_sample() <= end:
            link.time = max(link.time, link._next_sample())
            link._sample()
            plant = self._rig.twin.plant
            self._currents.append((link.time, any(plant.currents) or any(any(one) for _, one in plant.intervals[1:])))
        link.time = max(link.time, end)
        return None

    def off_after(self) -> float:
        """Return the longest current flow after the first frame [s]."""
        (arrived, _), *later = self._currents
        return max([time for time, flow in later if flow] + [later[0][0]]) * 1e-9 - arrived * 1e-9

    def now(self) -> int:
        """Return the instant."""
        return self._rig.link.time

    def close(self) -> None:
        """Do nothing."""


def stopped(seed: int, where: str, loss: float, key: bytes | None) -> tuple[float, EstopReport]:
    """Stop a device; return time to zero current, and answer."""
    rig = Rig(pose=CENTRE if where == "in flight" else REST, seed=seed, key=key)
    line, reports, write = Beside(rig, loss, seed), list[EstopReport](), rig.plant.write

    def pressed(command: Any) -> Any:
        applied = write(command)
        if rig.plant.samples.tick >= 30 + 3 * seed and not reports and rig.plant.state == State.ACTIVE:
            rig.link.time += round(seed / CASES * 4.9e6)  # at any phase of a period
            reports.append(estop(line, key))
        return applied

    rig.plant.write = pressed  # type: ignore[method-assign]
    with pytest.raises(DeviceFault, match="ESTOP"):
        if where == "in flight":
            rig.plant.arm()
            rig.fly(1.0)
        else:
            rig.plant.takeoff()
    assert rig.twin.firmware.faults & Fault.ESTOP
    return line.off_after(), reports[0]


@pytest.mark.parametrize(
    ("where", "loss", "key", "seeds"),
    [
        ("in flight", 0.0, None, SOME),
        ("in takeoff", 0.2, KEY, SOME),
        *further(*((where, loss, None, range(CASES)) for where in ("in flight", "in takeoff") for loss in (0.0, 0.2))),
    ],
)
def test_an_estop_from_another_host_cuts_within_30_ms(
    where: str, loss: float, key: bytes | None, seeds: Collection[int]
) -> None:
    cases = [stopped(seed, where, loss, key) for seed in seeds]
    worst, longest = max(off for off, _ in cases), max(report.duration for _, report in cases)
    print(
        f"{where}, {loss:.0%} lost: {sum(off <= ALLOWED for off, _ in cases)} of {len(cases)} "
        f"off within {worst * 1e3:.1f} ms of arrival, confirmed within {longest * 1e3:.0f} ms"
    )
    assert worst <= ALLOWED and all(report.confirmed for _, report in cases)


def test_an_estop_without_the_key_is_not_confirmed() -> None:
    rig = Rig(pose=CENTRE, key=KEY)
    rig.plant.arm()
    report = estop(Beside(rig), None)
    assert not report.confirmed and not rig.twin.firmware.faults & Fault.ESTOP
    assert str(report) == "not confirmed: cut the power (no answer within 1 s)"
    with pytest.raises(ParameterError, match="patience must be"):
        estop(Beside(rig), patience=0.0)


def test_a_current_that_does_not_fall_is_not_confirmed() -> None:
    rig = Rig(pose=CENTRE)
    rig.plant.arm()
    rig.fly(0.2)
    sample = rig.twin.firmware.sample

    def measured(tick: int, now: int, reading: Any) -> Any:
        return sample(tick, now, reading._replace(measured=(0.0, 0.0, 0.0, 0.0, -1.5, 0.1)))

    rig.twin.firmware.sample = measured  # type: ignore[method-assign]
    report = estop(Beside(rig), patience=0.5)
    assert not report.confirmed and report.faults & Fault.ESTOP
    assert "not confirmed: cut the power (faults" in str(report) and "-1.5 A in coil 4" in str(report)


def test_a_device_that_answers_and_flies_on_has_not_stopped() -> None:
    rig = Rig(pose=CENTRE)
    rig.twin.firmware.trip = lambda faults, now, **_: None  # type: ignore
    rig.plant.read()
    report = estop(Beside(rig), patience=0.1)
    assert not report.confirmed and report.currents == (0.0,) * 6 and rig.twin.firmware.state == State.INACTIVE


def test_what_was_measured_before_the_stop_confirms_nothing() -> None:
    # The sample at the stop says no current, the next one does not.
    rig = Rig(pose=CENTRE)
    rig.plant.read()
    link = Beside(rig)
    link.receive = answers = Mock(side_effect=link.receive)  # type: ignore[method-assign]
    report = estop(link)
    assert report.confirmed and answers.call_count >= 2 and rig.twin.firmware.state == State.FAULT


def test_in_lockstep_where_time_stands_still_the_state_is_enough() -> None:
    twin = Twin(TwinParameters(lockstep=True))
    link = VirtualLink(twin)
    plant = RemotePlant(link)
    plant.read()
    plant.arm()
    for _ in range(3):
        plant.read()
        plant.write(MotionCommand([0.0] * 6))
    plant.read()
    report = plant.estop()
    assert report.confirmed and twin.firmware.state == State.FAULT
    with pytest.raises(DeviceFault, match="ESTOP"):
        plant.read()
