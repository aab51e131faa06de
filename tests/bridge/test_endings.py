"""How flights end: one table for the host, both cores and the page, and one list of guards."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from maglev_mj.bridge.fault import DeviceFault
from maglev_mj.bridge.flight_guards import Alarm
from maglev_mj.bridge.twin.firmware import _SOFT
from maglev_mj.bridge.wire import ENDINGS, Ending, Fault, ending_of
from tests.bridge.test_bridge import CENTRE, Rig

ROOT = Path(__file__).parents[2]
TRIPPED = [fault for fault in Fault if fault != Fault.WALL_ENERGY]
"""Faults of a TRIP; the device alone detects WALL_ENERGY."""


def test_every_fault_has_an_ending_and_a_landing_has_no_fault() -> None:
    assert list(ENDINGS) == list(Fault) and {ending for ending, _ in ENDINGS.values()} == {Ending.STOP, Ending.CUT}
    assert ending_of(0) is Ending.LAND
    for first, (ending, _) in ENDINGS.items():
        for second, (other, _) in ENDINGS.items():
            assert (ending_of(first | second) is Ending.STOP) == (ending is other is Ending.STOP)


def test_the_page_has_the_same_endings_and_reasons() -> None:
    text = (ROOT / "docs/explanation/faults.md").read_text(encoding="utf-8")
    table = text.split("## List of faults")[1].split("\n## ")[0]
    rows = re.findall(r"^\| ([A-Z_]+) \|.*\| ([^|]+) \|$", table, re.MULTILINE)
    assert dict(rows) == {fault.name: f"{ending.value}: {why}" for fault, (ending, why) in ENDINGS.items()}


def test_the_firmware_in_c_stops_at_the_same_faults() -> None:
    source = (ROOT / "scripts/firmware/maglev_firmware.c").read_text(encoding="utf-8")
    (names,) = re.findall(r"^#define SOFT \((.*)\)$", source, re.MULTILINE)
    assert {Fault[name.strip().removeprefix("MAGLEV_")] for name in names.split("|")} == set(_SOFT)


@pytest.mark.parametrize("fault", TRIPPED, ids=lambda fault: fault.name)
def test_a_guard_ends_a_flight_as_the_table_says(fault: Fault) -> None:
    rig = Rig(pose=CENTRE)
    rig.plant.arm()
    rig.fly(0.05)
    began = rig.twin.tick
    with pytest.raises(DeviceFault, match=f"^{fault.name}: for a test"):
        rig.plant.end(Alarm(fault, "for a test"))
    assert rig.twin.firmware.faults == fault
    passed = (rig.twin.tick - began) * rig.plant.period  # until the currents are seen off
    assert 0.5 <= passed < 0.53 if ENDINGS[fault][0] is Ending.STOP else passed < 0.02


def test_an_alarm_without_a_fault_lands_and_the_first_reason_stays() -> None:
    rig = Rig(pose=CENTRE)
    rig.plant.arm()
    rig.fly(0.05)
    for reason in ("too slow", "too strong"):
        rig.plant.end(Alarm(Fault(0), reason))
    assert rig.plant.reason == "too slow" and not rig.plant.alarm and not rig.twin.firmware.faults
    rig.fly(0.05)  # the host carries the weight until it lands
    assert not rig.twin.firmware.faults
    rig.plant.disarm()
    rig.plant.read()
    rig.plant.arm()
    assert not rig.plant.reason
