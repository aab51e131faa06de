"""Preflight check: measured latency, critical delay, refusals."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj import cli, find_scene
from maglev_mj.bridge import HostLimits, RemotePlant, Twin, TwinParameters
from maglev_mj.bridge.preflight import (
    MARGIN,
    LinkReport,
    Preflight,
    _clock,
    _problem,
    assess,
    measure_link,
    preflight,
)
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.cli import bridge
from maglev_mj.errors import MaglevError, PlantError
from maglev_mj.plants.hand import HANDS
from maglev_mj.process import SideAnswers
from maglev_mj.session import device_controller
from maglev_mj.spec import INERTIA as _INERTIA
from maglev_mj.theory.verdict import judge
from tests.bridge.conftest import InProcess
from tests.bridge.impaired import ImpairedLine, Impairment
from tests.processes import started, twin
from tests.sweeps import further

SIGN_ERROR = """\
from maglev_mj import AxisLaw, Scene, gain


class Repelling(AxisLaw):
    stiffness: float = gain()

    def force(self, x, v, gains, state):
        return gains.stiffness * x


class Own(Scene):
    def laws(self):
        return [Repelling(axes="x", stiffness=800.0)]
"""


class Clock(VirtualLink):
    """Link with a clock faster than the device's."""

    rate = 1.0

    def now(self) -> int:
        return round(super().now() * self.rate)


def device(folder: Path, way: float = 0.0, jitter: float = 0.0, clock: float = 1.0, **options: Any) -> RemotePlant:
    limits = options.pop("limits", None)
    link = Clock(Twin(TwinParameters(**options), draw=lambda: 7), ImpairedLine(Impairment(delay=way, jitter=jitter)))
    link.rate = clock
    return RemotePlant(link, folder=folder, limits=limits)


@pytest.mark.parametrize(("rate", "way"), [(200, 0.0002), *further((200, 0.0), (1000, 0.001))])
def test_the_link_is_measured_without_current(way: float, rate: int, tmp_path: Path) -> None:
    with device(tmp_path, way, period=1.0 / rate) as plant:
        report = measure_link(plant, 0.5)
        assert not np.any(plant.report.currents) and not plant.disarmed
    assert report.samples == rate // 2 and report.lost == report.skipped == report.late == 0
    assert report.delay == pytest.approx(plant.delay + 2.0 * way, abs=2e-6)
    assert report.delay_95 == pytest.approx(plant.delay + 2.0 * way, abs=2e-6)
    assert report.required_delay == pytest.approx(plant.delay + MARGIN * 2.0 * way, abs=4e-6)
    assert report.clock == pytest.approx(1.0) and report.success >= 0.98
    assert report.as_json()["delay"] == pytest.approx(report.delay.tolist())
    assert "0 samples lost, 0 skipped, 0 answers late;" in " ".join(str(report.table()).split())


def test_late_answers_are_counted_and_an_active_device_is_not_measured(tmp_path: Path) -> None:
    with device(tmp_path, 0.012) as plant:
        assert measure_link(plant, 0.3).success == 0.0  # the device reports none of them
    with device(tmp_path, 0.006) as plant:
        plant.limits = replace(plant.limits, stale=0.01)  # still reports them
        report = measure_link(plant, 0.3)
        assert report.late >= 0.9 * report.samples and report.success < 0.1
        plant.arm()
        with pytest.raises(PlantError, match="no takeoff: device state ACTIVE, faults none"):
            measure_link(plant)


NAMES = ["joystick", "drop", "table", "box", "corner", "stick-slip"]


@pytest.mark.parametrize(("name", "way"), [("joystick", 0.0006), *further(*product(NAMES, [0.0, 0.0012]))])
def test_wall_stiffness_is_reduced_to_a_stable_value(name: str, way: float, tmp_path: Path) -> None:
    scene = find_scene(name)()
    with device(tmp_path, way) as plant:
        found = preflight(plant, scene, report=measure_link(plant, 0.2))
    margins = [judge(device_controller(found.scene), delay=0.0, hand=hand).critical_delay for hand in HANDS]
    assert found.critical_delay == pytest.approx(min(margins))
    if found.reduction:
        assert way and found.problem == "" and found.critical_delay >= found.report.required_delay
        stiffness, written = found.scene.stiffness, scene.stiffness  # type: ignore[attr-defined]
        assert stiffness < written and f"from {written:.0f} to {stiffness:.0f} N/m" in found.reduction
        # and no lower than necessary
        stiffer = found.scene.replace(stiffness=1.3 * stiffness)
        margins = [judge(device_controller(stiffer), delay=0.0, hand=hand).critical_delay for hand in HANDS]
        assert min(margins) < 1.1 * found.report.required_delay
    else:
        assert found.critical_delay >= found.report.required_delay or name == "drop"
        assert found.scene == scene.replace(period=plant.period, delay=plant.delay)


class Loading(InProcess):
    """A side process that delays the line while it starts and while it computes."""

    line: ImpairedLine
    looks, left = 300, 300
    started = property(lambda self: self._works(Loading, "left"))

    def _works(self, owner: Any, count: str) -> bool:
        left = getattr(owner, count) - 1
        setattr(owner, count, left)
        self.line.impair(Impairment(delay=0.002 if left >= 0 else 0.0))
        return bool(left < 0)

    def answer(self) -> Any:
        return self._function(*self._question) if self._works(self, "looks") else None


@pytest.mark.parametrize("name", ["joystick", *further("table", "stick-slip")])
def test_the_check_does_not_measure_its_own_load(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A device is answered all the time, though the check takes longer than it waits for a host."""
    twin, Loading.line = Twin(TwinParameters(), draw=lambda: 7), ImpairedLine(Impairment())
    monkeypatch.setattr(Loading, "left", 300)
    monkeypatch.setattr("maglev_mj.bridge.preflight.SideAnswers", Loading)
    monkeypatch.setattr("maglev_mj.bridge.preflight._critical_delay", lambda *_: 0.0021)  # takes 0.4 s
    with RemotePlant(VirtualLink(twin, Loading.line), folder=tmp_path) as plant:
        found = preflight(plant, find_scene(name)(), aside=True)
        assert found.report.delay == pytest.approx(plant.delay, abs=2e-6) and found.problem == ""
        assert plant.samples.tick > 700 and plant.samples.skipped == 0
        plant.arm()


@pytest.mark.parametrize("way", [0.0006, *further(0.0, 0.0004, 0.0008)])
def test_walls_are_reduced_for_the_report_that_counts(way: float, tmp_path: Path) -> None:
    with device(tmp_path, way) as plant:
        found = preflight(plant, JOYSTICK, aside=True)
        here = preflight(plant, JOYSTICK, report=found.report)
    assert found == here and found.problem == "" and found.critical_delay >= found.report.required_delay
    assert bool(found.reduction) == (way >= 0.0006)  # as written stable up to 2.77 ms


@pytest.mark.machine
def test_a_check_that_takes_too_long_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("maglev_mj.bridge.preflight.SideAnswers", SideAnswers)
    monkeypatch.setattr("maglev_mj.bridge.preflight._PATIENCE", 0.0)
    plant = device(tmp_path)
    with plant, pytest.raises(MaglevError, match="no takeoff: stability of the scene not known: timeout after 0 s"):
        preflight(plant, JOYSTICK, report=measure_link(plant, 0.2), aside=True)
    monkeypatch.setattr("maglev_mj.bridge.preflight._PATIENCE", 60.0)
    plant = device(tmp_path)
    with plant:
        report = measure_link(plant, 0.2)
        assert preflight(plant, JOYSTICK, report=report, aside=True) == preflight(plant, JOYSTICK, report=report)


@pytest.mark.parametrize("clock", [1.03, 0.5, 0.99])
def test_a_wrong_clock_rate_is_measured_and_reported(clock: float, tmp_path: Path) -> None:
    with device(tmp_path, clock=clock) as plant:
        report = measure_link(plant, 0.5)
    assert report.clock == pytest.approx(1.0 / clock, rel=1e-3)
    said = f"the device clock runs at {report.clock:.3f} times the host clock (tolerance 2 %)"
    assert _problem(JOYSTICK, report, 0.003) == "" if clock == 0.99 else said in _problem(JOYSTICK, report, 0.003)


class Stalling(Clock):
    """Link to a twin that stands still for 50 ms of its host's time, from each of some instants [s] on."""

    stalls: tuple[float, ...] = ()

    def now(self) -> int:
        time = super().now()
        return time + 50_000_000 * sum(time > 1e9 * stall for stall in self.stalls)


@pytest.mark.parametrize(
    ("rate", "clock", "stalls", "wrong"),
    [
        (1000, 1.0, (0.2,), False),
        (1000, 1.0, (0.1, 0.23, 0.38, 0.41), False),
        (200, 1.0, (0.21, 0.34), False),
        (1000, 1.01, (0.2,), False),
        (1000, 1.05, (0.2,), True),
        (1000, 0.95, (0.2, 0.31), True),  # before: the stalls hid it
        (200, 1.03, (0.2, 0.31), True),
    ],
)
def test_a_twin_that_stands_still_has_no_wrong_rate_and_a_wrong_rate_is_still_measured(
    rate: int, clock: float, stalls: tuple[float, ...], wrong: bool, tmp_path: Path
) -> None:
    link = Stalling(Twin(TwinParameters(period=1.0 / rate), draw=lambda: 7))
    link.rate, link.stalls = clock, stalls
    with RemotePlant(link, folder=tmp_path) as plant:
        report = measure_link(plant, 0.5)
    assert report.clock == pytest.approx(1.0 / clock, rel=1e-3)
    assert ("the device clock runs at" in _problem(JOYSTICK, report, 0.003)) is wrong


@pytest.mark.parametrize("rate", [200, 1000])
def test_rate_and_stalls_of_a_clock_are_told_apart_over_a_jittery_line(rate: int) -> None:
    """One to three stalls of 5 to 100 ms in a second, wrong rates of 3 % and more, jitter of 1 ms."""
    for seed, (error, count) in enumerate(product([-0.05, -0.03, -0.01, 0.0, 0.01, 0.03, 0.05], [0, 1, 3] * 5)):
        draw = np.random.default_rng(seed)
        device = np.arange(rate) / rate
        stalled = sum(draw.uniform(0.005, 0.1) * (device > draw.uniform()) for _ in range(count))
        arrived = np.maximum.accumulate(device / (1.0 + error) + stalled + draw.exponential(1e-3, rate))
        assert (abs(_clock(1e9 * np.column_stack([device, arrived])) - 1.0) > 0.02) is (abs(error) > 0.02)


JOYSTICK = find_scene("joystick")()
INERTIA = np.array(_INERTIA)
GOOD = LinkReport(
    device_delay=0.0015,
    delay=np.full(100, 0.002),
    answer=np.full(100, 1e-4),
    samples=100,
    lost=0,
    skipped=0,
    late=0,
    clock=1.0,
    lockstep=False,
)


@pytest.mark.parametrize(
    ("changes", "critical_delay", "says"),
    [
        ({}, 0.002, ""),
        (
            {},
            0.00199,
            "joystick is stable up to a loop delay of 1.99 ms, but 5 % of the answers exceed 2.00 ms",
        ),
        ({}, 0.0, "joystick is unstable even without delay: reduce its stiffness"),
        ({}, math.nan, "critical delay of joystick not computed"),
        ({"late": 50}, 0.003, ""),
        ({"late": 51}, 0.003, "only 49 % of 100 samples were answered in time, at least 50 % required"),
        ({"clock": 1.021}, 0.003, "the device clock runs at 1.021 times the host clock (tolerance 2 %)"),
        ({"clock": 1.019}, 0.003, ""),
    ],
)
def test_the_reason_not_to_fly_is_one_line(changes: dict[str, Any], critical_delay: float, says: str) -> None:
    problem = _problem(JOYSTICK, replace(GOOD, **changes), critical_delay)
    assert says in problem and bool(says) == bool(problem) and "\n" not in problem


@pytest.mark.parametrize(
    ("delays", "changes", "says"),
    [
        (
            [0.002] * 99 + [0.0015],
            {},
            "line    delay 1.5 to 2 ms: stable in the mean square (x 0.",
        ),
        (
            [0.004] * 99 + [0.0035],
            {},
            "line    delay 3.5 to 4 ms: unstable in the mean square (x 1.",
        ),
        ([0.002] * 100, {"lost": 20, "skipped": 10}, "line    delay 2 ms, 30 % lost: unstable in the mean square"),
        ([0.002] * 90 + [0.03] * 10, {"late": 10}, "line    delay 2 ms, 10 % lost: stable in the mean square"),
        ([0.002] * 90 + [0.008] * 10, {}, "line    delay 2 ms, 10 % lost: stable in the mean square"),
        ([], {"lost": 99}, "line    delay 1.5 ms, 99 % lost: unstable in the mean square"),
    ],
)
def test_the_measured_delays_and_losses_have_a_mean_square_verdict(
    delays: list[float], changes: dict[str, Any], says: str
) -> None:
    scene = find_scene("drop")(period=0.005, delay=0.0015)
    report = replace(GOOD, delay=np.array(delays), **changes)
    found = assess(scene, INERTIA, report, True)
    assert found.line.startswith(says)


def test_a_wall_on_the_device_has_no_mean_square_verdict() -> None:
    scene = find_scene("drop")().replace(period=0.005, delay=0.0015, wall_on="device")
    assert (
        assess(scene, INERTIA, GOOD, True).line
        == "line    delay 2 ms: not judged: a law on the device has a rate of its own"
    )


@pytest.mark.parametrize(
    ("name", "way", "says"),
    [
        ("mine", 0.0, "own is unstable even without delay"),
        ("joystick", 0.001, "joystick is stable up to a loop delay of 2.77 ms, but 5 %"),
    ],
)
def test_a_scene_unstable_at_the_measured_delay_should_not_fly(
    name: str, way: float, says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(SIGN_ERROR)
    files = {"mine": "mine.py"}
    with device(tmp_path, way) as plant:
        found = preflight(plant, find_scene(files.get(name, name))(), as_written=True, report=measure_link(plant, 0.2))
    assert says in found.problem and "\n" not in found.problem and not found.reduction


# the command


Flown = Callable[..., tuple[int, str, str]]


@pytest.fixture
def flown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Flown:
    """Return a function that runs `bridge` on a device, and returns status, output and errors."""
    flights: list[Any] = []

    def run(plant: RemotePlant, *options: str, address: str = "udp://127.0.0.1:1") -> tuple[int, str, str]:
        monkeypatch.setattr(bridge, "_opened", lambda *_: plant)
        monkeypatch.setattr(bridge, "measure_link", lambda plant, *_: measure_link(plant, 0.2))
        monkeypatch.setattr("maglev_mj.bridge.preflight.measure_link", lambda plant: measure_link(plant, 0.2))

        def fly(plant: RemotePlant, flight: Any, *_: Any) -> int:
            flights.append(flight)
            return 0

        monkeypatch.setattr(bridge, "_fly", fly)
        capsys.readouterr()
        flights.clear()
        status = cli.main(["bridge", address, *options])
        said = capsys.readouterr()
        flies = f"takeoff{', settings too' * flights[0].anyway}" if flights else ""
        return status, f"{said.out}{flies}", said.err

    return run


SLOW = {"way": 0.002}


@pytest.mark.parametrize(
    ("address", "current", "options", "says"),
    [
        ("udp://127.0.0.1:1", None, ["--anyway"], "warning: table is stable up to a loop delay of 3.11 ms"),
        ("serial:///dev/x?baud=921600", None, ["--anyway"], "--anyway needs --max-current of at most 5 A on a device"),
        ("serial:///dev/x?baud=921600", 5.0, ["--anyway"], "warning: table is stable up to a loop delay of 3.11 ms"),
        ("serial:///dev/x?baud=921600", 5.0, [], "no takeoff: table is stable up to a loop delay of 3.11 ms"),
    ],
)
def test_anyway_flies_a_twin_and_a_device_at_half_power(
    address: str,
    current: float | None,
    options: list[str],
    says: str,
    flown: Flown,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("maglev_mj.bridge.preflight._critical_delay", lambda *_: 0.00311)  # takes 0.4 s
    plant = device(tmp_path, **SLOW, limits=HostLimits(max_current=current))
    status, output, errors = flown(plant, "--scene", "table", "--as-written", *options, address=address)
    assert says in " ".join(errors.split()) and errors.count("maglev-mj bridge: ") <= 1
    assert ("takeoff" in output) == says.startswith("warning") and status == (0 if "takeoff" in output else 1)


@pytest.mark.parametrize(("address", "current"), [("udp://10.0.0.1:1", 5.0), *further(("udp://[::1]:1", None))])
def test_anyway_holds_for_settings_in_flight_where_it_holds_before(
    address: str, current: float | None, flown: Flown, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("maglev_mj.bridge.preflight._critical_delay", lambda *_: 0.0027)
    limits = HostLimits(max_current=current)
    for where, options, holds in (
        (address, ["--anyway"], True),
        ("udp://10.0.0.1:1", ["--anyway"], current is not None),
        (address, [], False),
    ):
        _, output, _ = flown(device(tmp_path, limits=limits), *options, address=where)
        assert output.endswith("takeoff, settings too" if holds else "takeoff")


def test_reduced_stiffness_is_reported_and_as_written_keeps_it(
    flown: Flown, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def checked(plant: RemotePlant, scene: Any, *, as_written: bool, **_: Any) -> Preflight:
        scene = scene.replace(period=plant.period, delay=plant.delay)
        asked = scene.stiffness
        if as_written:
            return Preflight(scene, GOOD, 0.01, "", "", asked)
        return Preflight(scene.replace(stiffness=5000.0), GOOD, 0.01, "", "stiffness reduced", asked)

    monkeypatch.setattr(bridge, "preflight", checked)
    for options, softer, flies in (
        ([], True, True),
        (["--as-written"], False, True),
        (["--require-stiffness=5000"], True, True),
        (["--require-stiffness=5001"], True, False),
        (["--as-written", "--require-stiffness=6000"], False, True),
        (["--as-written", "--require-stiffness=6001"], False, False),
    ):
        status, output, error = flown(device(tmp_path), *options)
        said, walls = " ".join(f"{output} {error}".split()), "5000 N/m (6000 requested)" if softer else "6000 N/m"
        assert (
            status == (0 if flies else 1)
            and ("stiffness reduced" in said) == softer
            and ("no takeoff" in said) != flies
        )
        assert flies or f"no takeoff: wall stiffness {walls}, below the required {options[-1][-4:]} N/m" in said


@pytest.mark.parametrize(("scene", "way", "status"), [("joystick", 0.0003, 0), ("table", 0.02, 1)])
def test_check_reports_the_stiffest_walls_and_ends(
    scene: str, way: float, status: int, flown: Flown, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("maglev_mj.bridge.preflight._critical_delay", lambda *_: 0.003)
    plant = device(tmp_path, way)
    got, output, _ = flown(plant, "--check", "--scene", scene)
    said = " ".join(output.split())
    assert got == status and "takeoff" not in said and not plant.disarmed
    head = r"Critical stiffness at \d\.\d\d ms \(1\.5 times the latency\) hand stiffness \[N/m\] at damping \[N s/m\]"
    assert re.search(rf"{head} none \d+ \d+ arm", said)
    assert all(f"{hand} " in said for hand in HANDS)


@pytest.mark.parametrize("other", ["--seconds=1", "--record=x.maglev", "--reset", "--identify=a.json"])
def test_check_does_that_alone(other: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["bridge", "udp://127.0.0.1:1", "--check", other]) == 2
    assert "check" in capsys.readouterr().err


@pytest.mark.machine
def test_check_of_a_twin_over_udp_is_ended_by_ctrl_c() -> None:
    with twin() as (_, address), started("bridge", address, "--check") as host:
        host.wait_for("measuring link latency")
        outcome = host.end()
    assert outcome.status == 130 and "Traceback" not in outcome.errors
