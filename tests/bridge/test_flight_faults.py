"""Errors in flight cut the currents before anything else."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from maglev_mj import cli
from maglev_mj.bridge.fault import DeviceFault, load_fault
from maglev_mj.bridge.flight import Flight
from maglev_mj.bridge.flight_guards import When
from maglev_mj.bridge.preflight import LinkReport, LoopTiming, Preflight, measure_link
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.bridge.twin.fault_injection import InjectedFault
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.bridge.twin.twin import Twin, TwinParameters
from maglev_mj.bridge.wire import Fault, State
from maglev_mj.cli import bridge
from maglev_mj.frames import Sample
from maglev_mj.recording import Recording
from maglev_mj.scenes import Scene
from maglev_mj.scenes.interactive import Joystick
from tests.bridge.impaired import ImpairedLine, Impairment
from tests.bridge.slow_lines import PUSHES, ChangedLaw, fly
from tests.sweeps import further, sweep

ANALYSIS = 80_000_000
"""Time of an analysis on a slow machine [ns]."""

DELAYS = {"none measured": 0.0, "as expected": 0.0, "longer than expected": 0.0006}


class Witnessed:
    """Flight in virtual time with a record of its currents.

    Args:
        folder: Folder of the black boxes.
        way: Delay of the line, each way [s].
        options: Further arguments of the flight.
    """

    def __init__(self, folder: Path, way: float = 0.0, **options: Any) -> None:
        self.twin = Twin(TwinParameters(), draw=lambda: 7)
        self.link = VirtualLink(self.twin, ImpairedLine(Impairment(delay=way)))
        self.plant = RemotePlant(self.link, folder=folder)
        self.flight = Flight(self.plant, Joystick(period=self.plant.period, delay=self.plant.delay), **options)
        self.intervals: list[tuple[float, float]] = []
        self.state: list[State] = []
        self._sample, self.twin.sample = self.twin.sample, self._witness  # type: ignore[method-assign]

    def _witness(self) -> bytes | None:
        frame = self._sample()
        self.intervals += [(span, max(map(abs, currents))) for span, currents in self.twin.plant.intervals]
        self.state.append(self.twin.firmware.state)
        return frame

    def wait(self, time: int = ANALYSIS) -> None:
        """Advance time [ns] while the host is busy."""
        end = self.link.time + time
        while self.link.time < end:
            self.link.receive((end - self.link.time) * 1e-9)

    def break_law(self, at: int, error: BaseException) -> None:
        """Make the controller raise from a sample on."""
        step, left = self.flight._controller.step, [at]

        def broken(sample: Sample) -> Any:
            if left[0] == 0:
                self.forget()
                raise error
            left[0] -= 1
            return step(sample)

        self.flight._controller.step = broken  # type: ignore[method-assign]

    def forget(self) -> None:
        """Record the currents from here on."""
        self.intervals.clear()
        self.state.clear()

    def check(self, first: Fault) -> None:
        """Check that a fault ended the currents, by a controlled stop or at once."""
        self.wait()
        longest = 2 * self.plant.period + 0.5 * (first == Fault.HOST)
        assert self.twin.firmware._first == first and self.state[1] == State.FAULT
        carried = [most > 0.0 for _, most in self.intervals]
        zero = carried.index(False)
        assert not any(carried[zero:])
        assert sum(span for span, _ in self.intervals[:zero]) <= longest


@pytest.mark.parametrize(("delays", "at"), sweep(DELAYS, range(200), every=199))
def test_a_law_that_raises_ends_the_currents(
    delays: str, at: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if delays == "none measured":
        monkeypatch.setattr(LoopTiming, "add", lambda timing, plant: timing.answer.add(1))
    flown = Witnessed(tmp_path, DELAYS[delays])
    flown.break_law(at, ValueError("no square root"))
    with flown.plant:
        with pytest.raises(DeviceFault, match="HOST: ValueError: no square root; the last cycles are in") as caught:
            flown.flight.run(2.0)
        flown.check(Fault.HOST)
    assert {when for when, _ in flown.plant.guards} == {When.SAMPLED}  # those of the flight are gone
    late = flown.flight.timing.delay.p99
    assert (late > 2.5e-3) == (delays == "longer than expected" and at > 0)
    assert (late == late) == (delays != "none measured" and at > 0)
    assert caught.value.path is not None and load_fault(caught.value.path).message == "ValueError: no square root"


SILENT = 1.6
"""Time at which the line is cut [s]."""


@pytest.mark.parametrize(
    ("name", "rate", "hand", "most", "change"),
    [
        ("joystick", 200, "none", 0.1, None),
        ("joystick", 200, "none", 0.1, lambda tick, own: math.nan),
        ("drop", 200, "8", 0.23, None),
        *further(*((name, rate, "none", 0.1, None) for name in PUSHES for rate in (200, 1000))),
        *further(("joystick", 200, "none", 0.1, lambda tick, own: 1 / (tick % 1 or 0))),
    ],
)
def test_a_host_that_fails_leaves_the_flotor_set_down(
    name: str, rate: int, hand: str, most: float, change: Any, tmp_path: Path
) -> None:
    options: dict[str, Any] = {"delay": lambda time: 9.0 * (time > SILENT)}
    if change is not None:
        options = {"law": partial(ChangedLaw, change=change)}
    flown = fly(name, rate=rate, hand=hand, folder=tmp_path, **options)
    failed = flown.rows[flown.rows[:, 14] == State.FAULT, 0][0]
    assert flown.at_stop(failed) <= most
    low = flown.after(failed + 0.51)
    assert low[:, 3].max() < -4.4e-3 and not low[:, 13].any()


class Broken:
    """Publisher and recording that fail at one sample."""

    def __init__(self, error: BaseException, at: int = 30) -> None:
        self.error, self.left = error, at
        self.flown: Witnessed

    def fail(self, *_: Any, **__: Any) -> None:
        self.left -= 1
        if self.left <= 0:
            self.flown.forget()
            raise self.error

    def take(self) -> None:
        if self.flown.flight.timing.answer.count:
            self.fail()

    def begin(self, *_: Any) -> Any:
        if self.left == 0:
            self.fail()
        return self.fail

    def show(self, snapshot: Any) -> None: ...
    def close(self) -> None: ...
    def event(self, *_: Any) -> None: ...
    def attach(self, *_: Any) -> None: ...
    def check(self) -> None: ...
    def append(self, *_: Any) -> None: ...


ERRORS = [OSError(28, "No space left on device"), SystemExit(3), KeyboardInterrupt()]


@pytest.mark.parametrize(("error", "at", "kind"), sweep(ERRORS, [0, 1, 30], ["file", "publishers"], every=5))
def test_so_do_a_recording_a_viewer_and_an_interrupt(error: BaseException, at: int, kind: str, tmp_path: Path) -> None:
    first = Fault.ESTOP if isinstance(error, KeyboardInterrupt) else Fault.HOST
    broken = Broken(error, at)
    options: dict[str, Any] = {"file": broken} if kind == "file" else {"publishers": [broken]}
    flown = broken.flown = Witnessed(tmp_path, **options)
    with flown.plant:
        with pytest.raises(DeviceFault):
            flown.flight.run(2.0)
        flown.check(first)


FAILING = [[InjectedFault(kind=kind, which=0, at=0.1)] for kind in ("stuck-amplifier", "nan-current")]
CUTS: dict[str, tuple[dict[str, Any], Impairment, bool]] = {
    "the line is cut right after arming": ({}, Impairment(loss=1.0), False),
    "the device answers": ({}, Impairment(), True),
    "on a slow line": ({}, Impairment(delay=0.004), True),
    "on a line that loses frames": ({}, Impairment(loss=0.5, seed=3), True),
    "in lockstep": ({"lockstep": True}, Impairment(), True),
    "an amplifier is stuck": (
        {"faults": [InjectedFault(kind="stuck-amplifier", which=0, at=0.1)]},
        Impairment(),
        False,
    ),
    "a meter is broken": ({"faults": FAILING[1]}, Impairment(), False),
    "the line is cut": ({}, Impairment(loss=1.0), False),
}
"""What a cut meets: the twin, the line from then on, and whether the currents are seen off."""


@pytest.mark.parametrize("met", CUTS)
@pytest.mark.parametrize("fault", Fault, ids=lambda fault: fault.name)
def test_currents_are_said_to_be_off_only_after_a_sample_without(met: str, fault: Fault, tmp_path: Path) -> None:
    parameters, impairment, off = CUTS[met]
    twin, line = Twin(TwinParameters(**parameters), draw=lambda: 7), ImpairedLine(Impairment())
    plant = RemotePlant(VirtualLink(twin, line), folder=tmp_path)
    plant.guards = []
    plant.read()
    plant.arm()
    with pytest.raises(DeviceFault) as caught:
        for _ in range(0 if "arming" in met else 40):
            plant.read()
            plant.drive([1.0] * 6)
        line.impair(impairment)
        plant.fail(fault, "for a test")
    said = str(caught.value)
    assert caught.value.off == (0.25 if off else None) and ("at most 0.25 A in each coil" in said) == off
    assert ("cut the power" in said) != off
    assert not off or not twin.plant.currents.any()


def test_a_silent_serial_link_is_reported_with_a_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    address = "serial:///dev/ttyUSB0?baud=921600"
    twin, line = Twin(TwinParameters(), draw=lambda: 7), ImpairedLine(Impairment(blackouts=((2.7, 2.8),)))
    monkeypatch.setattr(bridge, "_opened", lambda *_: RemotePlant(VirtualLink(twin, line), folder=tmp_path))
    monkeypatch.setattr("maglev_mj.bridge.preflight._critical_delay", lambda *_: 0.0027)  # takes 0.4 s
    assert cli.main(["bridge", address, "--seconds", "1"]) == 1
    fault = " ".join(capsys.readouterr().err.split())
    assert fault.startswith("maglev-mj bridge: WATCHDOG: reported by the device; the last cycles are in ")
    assert "; at most 0.25 A in each coil; a busy machine delays serial data" in fault
    assert f"clear the fault with: maglev-mj bridge {shlex.quote(address)} --reset" in fault


SCENE = '''
from maglev_mj import Hold
from maglev_mj.scenes.interactive import Joystick

class Rooted(Hold):
    def __call__(self, *arguments):
        if Rooted.left == 0:
            raise ValueError("no square root")
        Rooted.left -= 1
        return super().__call__(*arguments)

Rooted.left = {left}

class Mine(Joystick):
    """Joystick with a law that fails."""

    def laws(self):
        return [*super().laws(), Rooted(stiffness=[1.0] * 6, damping=[0.01] * 6)]
'''


def unchecked(plant: RemotePlant, scene: Scene, **_: Any) -> Preflight:
    scene = scene.replace(period=plant.period, delay=plant.delay)
    return Preflight(scene, measure_link(plant, 0.1), math.inf, "", "reduced", 7000.0)


def test_the_command_reports_cause_and_remedy_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    twin, line = Twin(TwinParameters(), draw=lambda: 7), ImpairedLine(Impairment(delay=0.0006))
    monkeypatch.setattr(bridge, "_opened", lambda *_: RemotePlant(VirtualLink(twin, line), folder=tmp_path))
    monkeypatch.setattr(bridge, "preflight", unchecked)  # the law fails there too
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(SCENE.format(left=50))
    record = tmp_path / "run.maglev"
    asked = ["bridge", "udp://127.0.0.1:1", "--key", "a key"]
    Path("a key").write_text("a7" * 16)
    Path("a key").chmod(0o600)
    status = cli.main([*asked, "--scene", "mine.py", "--seconds", "1", "--record", str(record)])
    said = capsys.readouterr()
    fault = " ".join(said.err.split())
    (box,) = tmp_path.glob("fault-*.maglev")
    assert status == 1 and twin.firmware.faults == Fault.HOST and record.exists()
    told = f"mine.py, line 8: ValueError: no square root; the last cycles are in {box}"
    again = "maglev-mj bridge udp://127.0.0.1:1 '--key=a key' --reset"
    assert fault == f"maglev-mj bridge: HOST: {told}; at most 0.25 A in each coil; clear the fault with: {again}"
    assert "host latency, arrival to answer" in said.out
    walls = "wall stiffness 6000 N/m (7000 requested)"
    assert f"{walls}; keep hands off" in " ".join(said.out.split())
    assert Recording.load(record).segments[0].metadata.name == f"mine on a device, {walls}"
    twin.sample()  # without currents
    assert cli.main(shlex.split(again)[1:]) == 0 and twin.firmware.state == State.INACTIVE


def test_the_link_is_measured_with_the_flights_scheduling(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a busy machine, other scheduling doubled the measured latency."""
    inside: list[str] = []
    measured: list[list[str]] = []

    @contextmanager
    def scheduled(policy: str) -> Iterator[list[str]]:
        inside.append(policy)
        yield []
        inside.pop()

    def measure(plant: RemotePlant, *_: float) -> LinkReport:
        measured.append([*inside])
        return measure_link(plant, 0.1)

    monkeypatch.setattr(bridge, "_opened", lambda *_: RemotePlant(VirtualLink(Twin(TwinParameters())), folder=tmp_path))
    for place in ("maglev_mj.cli.bridge", "maglev_mj.bridge.preflight"):
        monkeypatch.setattr(f"{place}.scheduled", scheduled)
        monkeypatch.setattr(f"{place}.measure_link", measure)
    monkeypatch.setattr("maglev_mj.bridge.preflight._critical_delay", lambda *_: 0.0027)
    for options in (["--check"], ["--seconds", "0.1"]):
        measured.clear()
        assert cli.main(["bridge", "udp://127.0.0.1:1", *options]) == 0
        assert measured == [["ignore"]] and not inside
