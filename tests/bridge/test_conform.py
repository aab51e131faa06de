"""Conformance checks pass a correct device and find missing guards."""

from __future__ import annotations
import __future__ as future

import inspect
import json
import re
import sys
import textwrap
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest

from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.conformance import CheckResult, checks, conform
from maglev_mj.bridge.conformance.tester import CHECKS
from maglev_mj.bridge.fault import HandshakeError
from maglev_mj.bridge.safety import Limits, Profile, ThermalModel, at_most, command_fault
from maglev_mj.bridge.twin import firmware, twin
from maglev_mj.bridge.twin.firmware import Firmware, Walls
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.bridge.twin.twin import AmplifierBoard, Twin, TwinParameters
from maglev_mj.bridge.wire import Codec, Fault, State
from maglev_mj.cli import main
from maglev_mj.errors import PlantError
from tests.bridge.devices import DEVICES
from tests.bridge.firmware_core import FIRMWARE
from tests.sweeps import sweep

KEY = bytes(range(32))
TAGS = {"no-tag", "tag"}
PARTS = 5
"""Parts of a complete test, each a test of its own."""


class Mortal(Twin):
    """Twin that is silent after an error of its program."""

    alive = True

    def receive(self, data: bytes, now: int, peer: Any) -> bytes | None:
        return self._lived(lambda: super(Mortal, self).receive(data, now, peer))

    def sample(self) -> bytes | None:
        tick = self.tick
        frame = self._lived(super().sample)
        self.tick = tick + 1
        return frame

    def _lived(self, step: Callable[[], bytes | None]) -> bytes | None:
        try:
            return step() if self.alive else None
        except Exception:
            self.alive = False
            return None


class Elsewhere:
    """Second address of the host, in virtual time."""

    def __init__(self, device: Twin, link: VirtualLink) -> None:
        self._device, self._link = device, link
        self._arrived: list[bytes] = []

    def send(self, data: bytes) -> None:
        parameters = self._device.parameters
        # in lockstep the device's clock stands at its last sample
        now = max(self._device.tick, 0) * parameters.profile.period if parameters.lockstep else self._link.now()
        answer = self._device.receive(data, now, "elsewhere")
        self._arrived += [answer] if answer is not None else []

    def receive(self, timeout: float) -> bytes | None:
        return self._arrived.pop(0) if self._arrived else None

    def now(self) -> int:
        return self._link.now()

    def close(self) -> None:
        pass


def results_of(
    *, key: bytes | None = None, only: Sequence[str] | None = None, **parameters: Any
) -> dict[str, CheckResult]:
    """Test a twin in virtual time; return results by name."""
    device = Mortal(TwinParameters(**parameters), key=key)
    link = VirtualLink(device)
    results = conform([link, Elsewhere(device, link)], calibration=parameters.get("calibration"), key=key, only=only)
    if all(one.passed is not False for one in results):
        assert (device.firmware.state, device.firmware.session) == (State.INACTIVE, 0)
    return {one.name: one for one in results}


def names(results: dict[str, CheckResult], passed: bool | None) -> set[str]:
    return {name for name, one in results.items() if one.passed is passed}


@pytest.mark.parametrize("part", range(PARTS))
def test_a_twin_passes(part: int) -> None:
    results = results_of(only=[*CHECKS][part::PARTS])
    assert list(results) == [*checks()][part::PARTS]
    assert not names(results, False) and names(results, None) <= {"lockstep"} | TAGS


@pytest.mark.parametrize(
    ("language", "key"),
    [
        pytest.param("c", KEY, marks=pytest.mark.needs("compiler")),
        pytest.param("python", KEY, marks=pytest.mark.study),
        pytest.param("c", None, marks=[pytest.mark.study, pytest.mark.needs("compiler")]),
    ],
)
def test_devices_pass(language: str, key: bytes | None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(twin, "Firmware", FIRMWARE[language])
    results = results_of(key=key)
    assert not names(results, False) and names(results, None) == {"lockstep"} | (set() if key else TAGS)


LEFT_OUT = "needs real time (the device is in lockstep)"
TIMED = [name for name, one in CHECKS.items() if one.real_time] + ["hover", "flight-silence"]


SCALED = "period currents stop estop reset-flowing walls hover flight-over-current flight-estop".split()
"""Checks that judge by the scale of the device, and some of those in flight."""


@pytest.mark.parametrize(
    ("name", "only"),
    [
        *(pytest.param(name, SCALED, id=name) for name in DEVICES),
        *(pytest.param(name, None, marks=pytest.mark.study, id=f"{name}, all") for name in DEVICES),
    ],
)
def test_devices_of_other_sizes_pass(name: str, only: list[str] | None) -> None:
    results = results_of(calibration=Calibration.of(DEVICES[name]), only=only)
    assert not names(results, False) and (only is None or set(only) <= set(results))
    off = at_most(DEVICES[name].scale.off)
    assert off in results["currents"].seen and off in results["estop"].seen and off in results["flight-estop"].seen


@pytest.mark.study
@pytest.mark.parametrize("rate", [100, 1000])
def test_it_passes_at_other_rates(rate: int) -> None:
    assert not names(results_of(period=1.0 / rate, delay=0.0003), False)


@pytest.mark.parametrize("part", sweep(range(PARTS), every=PARTS))
def test_a_twin_in_lockstep_passes(part: int) -> None:
    results = results_of(lockstep=True, only=[name for name in CHECKS if name not in TIMED][part::PARTS])
    assert results and not names(results, False) and names(results, None) <= TAGS


def test_in_lockstep_what_needs_real_time_is_left_out() -> None:
    results = results_of(lockstep=True, only=TIMED)
    assert {one.seen for one in results.values() if not one.passed} == {LEFT_OUT}
    assert names(results, True) == {"hover"} and names(results, None) == {*TIMED} - {"hover"}


@contextmanager
def virtual() -> Iterator[str]:
    """Serve a twin in virtual time to commands of this process."""
    device = Mortal(TwinParameters())
    link = VirtualLink(device)
    ends = iter([link, Elsewhere(device, link)])
    with patch("maglev_mj.bridge.links.open_link", lambda *_: next(ends)):
        yield "udp://127.0.0.1:1"


def test_the_command_reports_each_check_and_fails_where_one_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    skipped = [name for name, one in CHECKS.items() if one.flight or one.keyed or one.lockstep]
    for name in {*CHECKS} - {*skipped, *[*CHECKS][::10], "operations"}:
        monkeypatch.delitem(CHECKS, name)
    path = tmp_path / "report.json"
    for failing in (0, 1):
        if failing:
            without(monkeypatch, F, "_reset", ("self.state == State.ACTIVE or ", ""))
        with virtual() as address:
            assert main(["conform", address, "--no-flight", "--json", str(path)]) == failing
        report, lines = json.loads(path.read_text()), capsys.readouterr().out.splitlines()
        assert report["address"] == address and [one["name"] for one in report["checks"]] == list(checks())
        passed = len(checks()) - len(skipped) - failing
        assert report["counts"] == {"pass": passed, "FAIL": failing, "skip": len(skipped)}
        words = {True: "pass", False: "FAIL", None: "skip"}
        told = [
            f"{words[one['passed']]} {one['name']}: {one['expected']} result: {one['seen']}" for one in report["checks"]
        ]
        assert " ".join(" ".join(lines[:-1]).split()) == " ".join(" ".join(told).split())
        assert [line.split()[1] for line in lines if "FAIL  " in line] == ["operations:"] * failing


def test_a_line_with_one_peer_skips_what_needs_two() -> None:
    results = conform([VirtualLink(Twin(TwinParameters()))], only=["operations", "address", "estop-elsewhere"])
    assert [one.passed for one in results] == [True, None, None]
    assert results[1].seen == "needs a second host address (a serial link has one)"


def test_an_answer_read_late_at_the_second_address_is_no_violation() -> None:
    class Late(Elsewhere):
        waited = 0

        def receive(self, timeout: float) -> bytes | None:
            self.waited = (self.waited + 1) % 25  # meanwhile samples are answered at the first address
            return super().receive(timeout) if self.waited == 0 else None

    device = Mortal(TwinParameters(lockstep=True))
    link = VirtualLink(device)
    assert [one.passed for one in conform([link, Late(device, link)], only=["busy", "frames"])] == [True, True]


def test_what_is_latched_is_not_tested_away() -> None:
    device = Twin(TwinParameters())
    device.firmware.trip(Fault.COIL_OVERTEMP, 0)
    with pytest.raises(PlantError, match="has latched COIL_OVERTEMP: fix the cause, then reset"):
        conform([VirtualLink(device)])
    assert device.firmware.faults == Fault.COIL_OVERTEMP and device.firmware.session == 0


def test_no_device_or_a_busy_one_is_said() -> None:
    with pytest.raises(HandshakeError, match="CALIBRATION"):
        conform([VirtualLink(Twin(TwinParameters()))], replace(Calibration.nominal(), mass=0.9))
    with pytest.raises(HandshakeError, match="no answer from the device"):
        conform([VirtualLink(Twin(TwinParameters(), key=KEY))])


@pytest.mark.parametrize(
    ("check", "ticks"), sweep(["hover", "bad-line", "estop", "not-finite", "far-ahead"], [5, 60, 150, 260], every=5)
)
def test_ctrl_c_leaves_the_device_without_currents(check: str, ticks: int) -> None:
    class Interrupted(VirtualLink):
        left = ticks

        def receive(self, timeout: float) -> bytes | None:
            self.left -= device.firmware.state == State.ACTIVE
            if self.left == 0:
                self.left = -1
                raise KeyboardInterrupt
            return super().receive(timeout)

    device = Twin(TwinParameters())
    try:
        conform([Interrupted(device)], only=[check])
    except KeyboardInterrupt:
        pass
    assert device.firmware.state == State.INACTIVE and device.firmware.session == 0
    assert device.plant.read() and not device.plant.currents.any()


def test_ctrl_c_in_flight_lands() -> None:
    speeds: list[float] = []

    class Interrupted(VirtualLink):
        def receive(self, timeout: float) -> bytes | None:
            speeds.append(abs(device.plant.state()[1][2]))
            if device.tick == 400:
                raise KeyboardInterrupt
            return super().receive(timeout)

    device = Twin(TwinParameters())
    with pytest.raises(KeyboardInterrupt):
        conform([Interrupted(device)], only=["bad-line"])
    assert max(speeds[30:]) < 0.05  # a flotor that is let go hits its stop at 0.4 m/s


# a twin without a guard

F, C, W = Firmware, Codec, Walls
GUARDS: list[tuple[str, Any, str, str, str]] = [
    # sessions
    ("session", F, "receive", "frame.session != self.session", "False"),
    ("address", F, "receive", " or peer != self.peer", ""),
    ("sequence", F, "receive", "not newer(frame.sequence, self._sequence)", "False"),
    ("sequence-numbers", F, "receive", "newer(frame.sequence, self._sequence)", "frame.sequence > self._sequence"),
    ("direction", F, "receive", "not isinstance(body, (wire.CommandFrame, wire.ControlRequest))", "False"),
    ("hello-again", F, "_hello", "hello.nonce == self._nonce and peer == self.peer", "False"),
    ("busy", F, "_hello", "and peer == self.peer", ""),
    ("busy", F, "_hello", "self.session and (", "hello.calibration == self.profile.calibration and self.session and ("),
    ("takeover", F, "_hello", "now - self._heard < _SILENCE", "False"),
    ("takeover", F, "_hello", "now - self._heard < _SILENCE", "True"),
    ("takeover", F, "_hello", "peer == self.peer:", "peer == self.peer:\n        self._heard = now"),
    ("calibration", F, "_hello", "hello.calibration != self.profile.calibration", "False"),
    ("request-numbers", F, "_hello", "self._sequence, self._acknowledgement = 0, None", "self._sequence = 0"),
    ("drawn", F, "_hello", "self._draw()", "self.session + 1 or 1"),
    ("version", F, "receive", "codec.version_met is not None", "False"),
    ("welcome", Profile, "answer", "**self.stated", "**{**self.stated, 'hover_limit': self.limits.current_limit}"),
    ("welcome", Profile, "answer", "**self.stated", "**{**self.stated, 'watchdog': self.period}"),
    ("frames", F, "_answer_hello", "codec.encode(session, 0,", "codec.encode(self.session, 0,"),
    ("bye", F, "_control", "last.operation == Operation.BYE", "False"),
    # frames
    ("magic", C, "_reason", "data[:2] != _MAGIC", "False"),
    ("crc", C, "_reason", "zlib.crc32(data) != _CRC_RESIDUE", "False"),
    ("frame-version", C, "_reason", "data[2] != VERSION", "False"),
    ("type", C, "_reason", "shape is None", "False"),
    ("too-short", C, "_reason", "end != shape.size", "end > shape.size"),
    ("too-long", C, "_reason", "end != shape.size", "end < shape.size"),
    # requests
    ("requests", F, "_control", "not newer(control.request, last.request)", "False"),
    (
        "far-ahead",
        F,
        "receive",
        "(body, wire.ControlRequest)",
        "(body, wire.ControlRequest) and self._sequence < 1 << 31",
    ),
    ("operations", F, "_do", "return False", "return True"),
    ("operations", F, "_arm", "self.state != State.INACTIVE or ", ""),
    ("reset-flowing", F, "_reset", " or not off", ""),
    ("arm", F, "_arm", "not all(abs(x) <= limits.hover_limit for x in hover)", "False"),
    ("arm", F, "_arm", "abs(x) <=", "x <="),
    ("trip", F, "_do", "control.faults & sum(Fault)", "control.faults"),
    ("trip", F, "_do", " or Fault.HOST", ""),
    ("first-fault", F, "trip", "if not self.faults:", "if True:"),
    # commands
    ("not-active", F, "_apply", "self.state != State.ACTIVE", "False"),
    ("future", F, "_apply", "((self._sampled - command.answers) & WRAP)", "max(self._sampled - command.answers, 0)"),
    ("stale", F, "_apply", "age > self._stale", "age > self._watchdog"),
    ("stale", F, "_apply", "age += max(now - self._sampled_at, 0)", "pass"),
    ("stale-answers", F, "_apply", 'self.counts["old"] += 1', 'self._sequence -= 1; self.counts["old"] += 1'),
    ("late-command", F, "_apply", "age > self._stale", "age >= self._stale - self.profile.period"),
    ("stale-answers", F, "_apply", 'self.counts["old"] += 1', 'self.counts["old"] += 1; self._commanded_at = now'),
    ("not-finite", firmware, "command_fault", "not all(map(math.isfinite, (*held, *pulsed)))", "False"),
    ("not-finite", firmware, "command_fault", "(*held, *pulsed)", "pulsed"),
    ("width", firmware, "command_fault", "not 0.0 <= width <= 1.0", "width < 0.0"),
    ("width", firmware, "command_fault", "not 0.0 <= width <= 1.0", "width > 1.0"),
    ("over-current", firmware, "command_fault", "max(held) > bound", "False"),
    ("over-current", firmware, "command_fault", "min(held) < -bound", "False"),
    ("pulse", F, "_apply", "command.pulsed if command.width else None", "None"),
    ("answered", F, "_apply", "now, command.answers, False", "now, command.answers - 1, False"),
    ("answered-inactive", F, "_apply", "self.state == State.INACTIVE", "False"),
    # currents
    ("currents", F, "_do", "self._cut()", "pass"),
    ("temperatures", ThermalModel, "add", "= shares, max", "= self.rises, max"),
    ("enabled", F, "sample", "self._amplifiers.toggle(now)", "pass"),
    # emergency stop
    ("estop", F, "receive", "self._sampled_at, tuple", "0, tuple"),
    ("estop", F, "receive", "self.trip(Fault.ESTOP, now)", "pass"),
    ("estop-without-session", F, "receive", "(body, wire.Estop)", "(body, wire.Estop) and self.session"),
    ("estop-elsewhere", F, "receive", "(body, wire.Estop)", "(body, wire.Estop) and peer == self.peer"),
    ("far-ahead", F, "receive", "(body, wire.Estop)", "(body, wire.Estop) and self._sequence < 1 << 30"),
    # time and silence
    ("period", F, "sample", "or self.stopping:\n        self._amp", "or True:\n        self._amp"),
    ("silence-after-arm", F, "_hold", "gap > self._watchdog", "False"),
    ("silence-after-arm", F, "_hold", "gap > _GAP * self.profile.period", "False"),
    ("silence-after-arm", F, "_hold", "gap > _GAP * self.profile.period", "gap > 4 * self.profile.period"),
    ("silence-after-commands", F, "_hold", "gap > self._watchdog", "gap > 2 * self._watchdog"),
    # walls
    ("walls", F, "_apply", "command.walls, now", "(), now"),
    ("walls", W, "render", "0.0 if silent and not side else stiffness", "stiffness"),
    ("wall-limits", Profile, "wall_problem", "not 0.0 <= value <= most", "not value <= most"),
    ("wall-limits", Profile, "wall_problem", "not 0.0 <= value <= most", "value < 0.0"),
    ("wall-limits", Profile, "wall_problem", " * lever * lever", ""),
    ("wall-limits", Profile, "wall_problem", " or not math.isfinite(wall.edge)", ""),
    ("wall-limits", Profile, "edge_problem", "not moved <= step", "False"),
    ("wall-limits", Profile, "edge_problem", "step * periods", "1e3 * step"),
    ("wall-sums", Profile, "wall_problem", "total > most", "False"),
    ("wall-sums", Profile, "wall_problem", "wall.side == -push", "wall.side != push"),
    ("wall-sums", Profile, "wall_problem", "wall.side == -push", "False"),
    ("wall-edges", F, "_apply", " if newer(command.answers, self._newest) else self._newest", ""),
    ("wall-edges", F, "_apply", "self._newest = newest", "self._newest = command.answers"),
    ("wall-edges", F, "_apply", "(newest - self._newest) & WRAP", "1"),
    # controlled stop
    ("stop", F, "trip", "and self._stop[6]", "and False"),
    ("stop", F, "_reset", "or self.stopping", ""),
    ("stop", F, "_descend", "not elapsed < duration", "False"),
    ("stop", F, "_descend", "1.0 - elapsed / duration", "1.0"),
    ("stop", F, "_apply", "soft=True", "soft=False"),
    ("stop", F, "_do", "~_SOFT", "~(_SOFT & ~Fault.CLOCK)"),
    ("stop-cut", F, "_do", " or self.stopping", ""),
    ("stop-cut", F, "_do", "soft=not faults & ~_SOFT", "soft=True"),
    ("stop-cut", F, "trip", " and (self._holding or self._answers != NEVER)", ""),
    ("arm", F, "_arm", "all(map(math.isfinite, stop))", "True"),
    ("arm", F, "_arm", "<= stop[6] <= _LONGEST_STOP", "<= stop[6]"),
    ("arm", F, "_arm", "0.0 <= stop[6]", "stop[6]"),
    ("arm", F, "_arm", " and stop[7] >= 0.0", ""),
    ("arm", F, "_arm", "not all(abs(stop[7] * x) <=", "any(abs(stop[7] * x) > 2 *"),
    ("flight-silence", F, "sample", "soft=not faults", "soft=False"),
    ("flight-over-current", F, "_descend", "- motion / (", "- 0.0 * motion / ("),
    # all frames
    ("samples", F, "trip", "self.state, self.faults = State.FAULT, self.faults | faults", "self.faults |= faults"),
    ("cut", F, "trip", "self._cut()", "pass"),
    # in flight
    ("bad-line", C, "_reason", "zlib.crc32(data) != _CRC_RESIDUE", "False"),
    ("flight-silence", F, "_hold", "gap > self._watchdog", "False"),
    ("flight-over-current", firmware, "command_fault", "Fault.COIL_OVERCURRENT", "_NO_FAULT"),
    ("flight-estop", F, "receive", "self.trip(Fault.ESTOP, now)", "pass"),
    ("flight-disarm", F, "_do", "(Operation.DISARM, Operation.BYE)", "(Operation.BYE,)"),
    ("flight-bye", F, "_do", "(Operation.DISARM, Operation.BYE)", "(Operation.DISARM,)"),
]


def without(monkeypatch: pytest.MonkeyPatch, owner: Any, name: str, *changes: tuple[str, str]) -> None:
    """Replace texts in a function of the twin.

    Each must occur exactly once.
    """
    if owner is Codec:  # the host keeps its own
        owner = type("DeviceCodec", (Codec,), {"__module__": Codec.__module__})
        monkeypatch.setattr(twin, "Codec", owner)
    source = textwrap.dedent(inspect.getsource(getattr(owner, name)))
    for old, new in changes:
        assert source.count(old) == 1, f"{old!r} is {source.count(old)} times in {name}"
        source = source.replace(old, new)
    module = sys.modules[getattr(owner, "__module__", command_fault.__module__)]
    found: dict[str, Any] = {}
    code = compile(source, "<mutant>", "exec", flags=future.annotations.compiler_flag)
    # zero-argument super() is in none of them
    exec(code, vars(module), found)
    monkeypatch.setattr(owner, name, found[name])


CASES = {
    "busy": r"HELLO (repeated from another address|of another calibration): status [A-Z]+ instead of BUSY",
    "calibration": "byte 0 of the calibration changed: status WELCOME instead of CALIBRATION",
    "version": r"HELLO of version 3 in 48 bytes: (no answer|.* \(1, VERSION, 4\) instead of \(0, VERSION, 4\))",
    "arm": r"\S+ in (hover|stop)\[[067]\]: result, state \(DONE, ACTIVE\) instead of \(REFUSED, INACTIVE\)",
    "trip": r"TRIP of (0x80000000|none): faults (0x80000000|none) instead of HOST|"
    "TRIP of SENSOR_OUT_OF_RANGE, then of CLOCK: faults CLOCK instead of SENSOR_OUT_OF_RANGE CLOCK",
    "currents": r"after (DISARM|TRIP): \(0\.57\d+, .*\) A after the cut instead of at most 0.25 A",
    "temperatures": "coil 0: 0 instead of 0.00106, from 0",
    "not-active": r"CMD of \(nan, .*\) A in INACTIVE: state, faults \(FAULT, .*\) instead of \(INACTIVE, none\)",
    "not-finite": r"nan in entry [06] of held, pulsed, width: "
    r"(1 STATEs instead of 2|state, faults \(ACTIVE, none\) instead of \(FAULT, INVALID_COMMAND\))",
    "sequence-numbers": r"CMDs from number \d+ on: |the last accepted command is \d+ samples old",
    "far-ahead": "(ESTOP|DISARM) after a CMD far ahead: no answer (to ESTOP|from the device within 2 s)",
    "direction": "StateReport: 0 STATEs instead of 3",
    "estop": r"in (INACTIVE|FAULT): (state, faults in ESTOP_ACK|sampled at 0 ns)",
}
"""Messages of checks with several cases: which one failed, the value seen and the one expected."""


SOME_GUARDS = [
    pytest.param(*guard, marks=pytest.mark.study if number % 4 else (), id=f"{guard[0]}: {guard[3][:40]}")
    for number, guard in enumerate(GUARDS)
]


@pytest.mark.parametrize(("check", "owner", "name", "old", "new"), SOME_GUARDS)
def test_a_twin_without_a_guard_fails(
    check: str, owner: Any, name: str, old: str, new: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    without(monkeypatch, owner, name, (old, new))
    # rules of all frames are looked at after others
    before = ["currents", "silence-after-arm", "busy"] if check in ("frames", "samples", "cut") else []
    # the amplifier board would open before anyone saw
    limits = Limits(enable=0.03) if check == "cut" else Limits()
    results = results_of(only=[*before, check], limits=limits)
    assert results[check].passed is False and re.match(CASES.get(check, ""), results[check].seen), results[check].seen


@pytest.mark.parametrize("check", sorted(TAGS))
def test_a_keyed_twin_that_looks_at_no_tag_fails(check: str, monkeypatch: pytest.MonkeyPatch) -> None:
    changes = [("not hmac.compare_digest(data[end : end + TAG], _tag(data[:end], self._key))", "False")]
    if check == "no-tag":
        changes = [
            ("end != shape.size", "len(data) not in (shape.size + 4, shape.size + self._overhead)"),
            ("self._key is not None", "self._key is not None and len(data) != shape.size + 4"),
        ]
    without(monkeypatch, Codec, "_reason", *changes)
    assert results_of(key=KEY, only=[check])[check].passed is False


def test_a_command_that_survives_the_cut_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    drive, cut = AmplifierBoard.drive, AmplifierBoard.cut
    told: list[Any] = [0]

    def remember(board: AmplifierBoard, *command: Any) -> None:
        told[:] = [board.now, command]
        drive(board, *command)

    def cut_but_forget_nothing(board: AmplifierBoard) -> None:
        cut(board)
        if told[1:] and board.now - told[0] < 1_000_000:
            drive(board, *told[1])

    monkeypatch.setattr(AmplifierBoard, "drive", remember)
    monkeypatch.setattr(AmplifierBoard, "cut", cut_but_forget_nothing)
    result = results_of(only=["forgotten"])["forgotten"]
    expected = (
        r"after a CMD of \(0\.57\d+, .*\) A and DISARM: \(0\.57\d+, .*\) A after the cut instead of at most 0.25 A"
    )
    assert result.passed is False and re.match(expected, result.seen), result.seen


class Flooded(Mortal):
    """Twin that takes 0.2 ms for each frame from elsewhere.

    Args:
        most: Frames that it takes between two samples, in order of arrival.
    """

    def __init__(self, most: int) -> None:
        super().__init__(TwinParameters())
        self._most, self._backlog = most, list[tuple[bytes, int, Any]]()

    def receive(self, data: bytes, now: int, peer: Any) -> bytes | None:
        if peer != "elsewhere":
            return super().receive(data, now, peer)
        self._backlog.append((data, now, peer))
        return None

    def sample(self) -> bytes | None:
        taken, self._backlog = self._backlog[: self._most], self._backlog[self._most :]
        for frame in taken:
            super().receive(*frame)
        for _ in range(len(taken) * 200_000 // self.parameters.profile.period):
            super().sample()  # missed: its STATE is never sent
        return super().sample()


@pytest.mark.parametrize(("most", "seen"), [(10_000, r"samples \(11, .*"), (16, "ESTOP not in 10 samples")])
def test_a_flood_that_delays_samples_or_an_estop_is_seen(most: int, seen: str) -> None:
    device = Flooded(most)
    link = VirtualLink(device)
    (result,) = conform([link, Elsewhere(device, link)], only=["flood"])
    assert result.passed is False and re.match(seen, result.seen), result.seen


def test_a_device_with_its_coils_reversed_is_let_go() -> None:
    known = Calibration.nominal()
    coils = replace(known.coils, force_constants=-known.coils.force_constants)
    result = results_of(only=["hover"], truth=replace(known, coils=coils))["hover"]
    assert result.passed is False and "does not follow" in result.seen


def test_a_device_that_does_not_wait_in_lockstep_fails() -> None:
    device = Twin(TwinParameters())
    device.firmware.profile = replace(device.firmware.profile, lockstep=True)  # it says so, and samples all the same
    (result,) = conform([VirtualLink(device)], only=["lockstep"])
    assert result.passed is False


def test_every_check_fails_for_some_device() -> None:
    covered = {guard[0] for guard in GUARDS} | TAGS | {"flood", "forgotten", "hover", "lockstep"}
    assert set(checks()) == covered
