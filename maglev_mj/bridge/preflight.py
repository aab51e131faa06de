"""Check before takeoff: what the line takes, and what a scene bears."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np

from maglev_mj.bridge.realtime import LatencyHistogram
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.errors import ParameterError, SensingError
from maglev_mj.frames import ZERO, Array
from maglev_mj.parameters import number
from maglev_mj.plants.hand import HANDS
from maglev_mj.result import Result, Table
from maglev_mj.scenes import Scene
from maglev_mj.session import device_controller, own_code_refused
from maglev_mj.theory import largest_stable_stiffness
from maglev_mj.theory.verdict import delay_margins, judge, stated_gains

_ANSWERS = 64
_RENEWED = 2_000_000_000  # [ns] the quickest way is looked for in: clocks drift apart by up to 100 µs a second

MARGIN = 1.5
"""Factor over the line's usual delay that a scene has to bear."""

_CLOCK = 0.02
"""Largest difference of the device's clock and the host's."""

_ANSWERED = 0.5
"""Least share of samples that are answered in time."""

_HALVINGS, _STYLUS = 7, 1.1
"""Halvings of a softer wall's share, and factor that covers the hand that bears least."""


class LoopTiming:
    """Latency histograms of a control loop over a device.

    Attributes:
        answer: Time from a sample's arrival to sending its answer.
        age: Time from a sample to sending its answer, beyond the quickest transport of the last seconds: the two clocks
            have no common zero. It is at most what the device's clock says of the answers that have arrived: a device
            whose clock stood still is no slow line.
        delay: Time from a sample to its answer's effect, by the device's clock.
        newest_age: Last of the ages [s]; 0 in lockstep.
    """

    def __init__(self) -> None:
        self.answer, self.age, self.delay = LatencyHistogram(), LatencyHistogram(), LatencyHistogram()
        self.newest_age = 0.0
        self._least, self._before, self._renewed = math.inf, math.inf, 0
        # samples answered last, and instants of their answers by the clocks
        self._sent: list[tuple[int | None, int]] = [(None, 0)] * _ANSWERS

    def add(self, plant: RemotePlant) -> None:
        """Add the last sample, once it is answered."""
        answer, samples = round(plant.answer_latency * 1e9), plant.samples
        answered, _, delay, _, way = plant.answers
        self.answer.add(answer)
        if delay == delay:
            self.delay.add(round(delay * 1e9))
        if plant.lockstep:
            return  # the device's time stands still meanwhile
        if samples.time > self._renewed:
            self._least, self._before, self._renewed = way, self._least, samples.time + _RENEWED
        tick, sent = self._sent[answered % _ANSWERS]
        if delay == delay and tick == answered:
            quickest = sent - round((delay - plant.delay) * 1e9)  # the transport, had the way back taken no time
            self._least, self._before = max(self._least, quickest), max(self._before, quickest)
        self._least = min(self._least, way)
        self._sent[samples.tick % _ANSWERS] = samples.tick, answer + way
        newest = answer + way - int(min(self._least, self._before))
        self.age.add(newest)
        self.newest_age = newest * 1e-9

    @property
    def kinds(self) -> Mapping[str, LatencyHistogram]:
        """Measured latencies by name."""
        kinds = {
            "answer, from the sample's arrival": self.answer,
            "age of the sample when that left": self.age,
            "delay at the device": self.delay,
        }
        return {name: one for name, one in kinds.items() if one.count}

    def table(self) -> Table:
        """Return the latencies; empty for a loop that did not run."""
        rows = [
            (name, *(f"{part * 1e3:.3f}" for part in (one.p50, one.p99, one.max))) for name, one in self.kinds.items()
        ]
        return Table("", ("milliseconds", "median", "99 %", "most"), rows)


@dataclass(frozen=True, kw_only=True, eq=False)
class LineReport(Result):
    """What a line and its host take, measured without currents.

    Attributes:
        device_delay: Time from a command's arrival to its effect [s].
        delay: Times from a sample to its answer's effect, by the device's clock [s], (N,).
        answer: Times from a sample's arrival to sending its answer [s], (N,).
        samples: Number of samples of the device in that time.
        lost: Samples that did not arrive.
        skipped: Samples too old when read.
        late: Answers that the device would not have obeyed.
        clock: Time by the device's clock over that by the host's.
        lockstep: True if the device's time waits for each answer.
    """

    device_delay: float
    delay: Array
    answer: Array
    samples: int
    lost: int
    skipped: int
    late: int
    clock: float
    lockstep: bool
    units: ClassVar = {"delay": "s", "answer": "s"}

    @property
    def usual(self) -> float:
        """Delay that 95 % of the answers keep [s]; the device's own if none was seen.

        Single late answers make no loop unstable.
        """
        return float(np.percentile(self.delay, 95.0)) if self.delay.size else self.device_delay

    @property
    def planned(self) -> float:
        """Delay that a scene has to bear [s]: the device's, and 1.5 times the line's."""
        return self.device_delay + MARGIN * max(self.usual - self.device_delay, 0.0)

    @property
    def anyway(self) -> float:
        """Delay taken for what a scene bears that is flown all the same [s]."""
        return 2.0 * self.planned

    @property
    def success(self) -> float:
        """Share of the samples whose answer would have been obeyed in time."""
        return max(self.delay.size - self.late, 0) / max(self.samples, 1)

    def columns(self) -> Mapping[str, Array]:
        """Return the times of each answer."""
        return {"delay": self.delay, "answer": self.answer}

    def table(self) -> Table:
        """Return the times, and below what was lost."""
        device, program = self.device_delay, self.answer
        line = self.delay - device - program if self.delay.size == program.size else np.zeros(0)
        kinds = {
            "delay, from a sample to its answer's effect": self.delay,
            "of it the line and the kernel": line,
            "of it the program": program,
        }
        rows = [
            (name, *(f"{1e3 * float(np.percentile(one, share)):.3f}" for share in (50.0, 95.0, 99.0, 100.0)))
            for name, one in kinds.items()
            if one.size
        ]
        said = (
            f"{self.success:.1%} of {self.samples} samples answered in time; {self.lost} lost, {self.skipped} skipped, "
            f"{self.late} answers late; clock {self.clock - 1.0:+.2%}"
        )
        return Table("", ("milliseconds", "median", "95 %", "99 %", "most"), rows, said.replace("%", " %"))


def measure_line(plant: RemotePlant, duration: float = 1.0) -> LineReport:
    """Answer the samples of an inactive device with no current, and measure what that takes.

    Args:
        plant: The device, not armed.
        duration: Time by the device's clock [s].

    Raises:
        PlantError: If the device is not inactive, or its samples end.
    """
    plant.require_inactive()
    delays, answers, clocks = [], [], []
    stale, late = plant.limits.stale or math.inf, 0
    samples = plant.samples
    first, lost, skipped = samples.tick, samples.lost, samples.skipped
    count = max(round(number("duration", duration, above=0.0) / plant.period), 2)
    while samples.tick < first + count:
        with suppress(SensingError):  # it may be open on the bench
            plant.read()
        clocks.append((samples.time, samples.time + plant.answers.transport))
        if not math.isnan(delay := plant.answers.newest_delay):
            delays.append(delay)
            late += delay - plant.delay > stale
        plant.drive(ZERO)
        answers.append(plant.answer_latency)
    return LineReport(
        device_delay=plant.delay,
        delay=np.array(delays[1:]),
        answer=np.array(answers[1:][: len(delays) - 1]),
        samples=samples.tick - first,
        lost=samples.lost - lost,
        skipped=samples.skipped - skipped,
        late=late,
        clock=1.0 if plant.lockstep else _clock(np.array(clocks, dtype=float)),
        lockstep=plant.lockstep,
    )


def _clock(times: Array) -> float:
    """Return device time over host time, between the quickest arrivals at both ends."""
    part = max(len(times) // 5, 1)
    ends = [rows[np.argmin(rows[:, 1] - rows[:, 0])] for rows in (times[:part], times[-part:])]
    device, host = ends[1] - ends[0]
    return float(device / host) if host > 0.0 else math.inf


class Preflight(NamedTuple):
    """Outcome of the check before takeoff.

    Attributes:
        scene: The scene to fly: as given, or with the stiffest walls that bear the planned delay.
        report: The measured line.
        bears: Longest delay that the scene bears [s]: the smallest of those free and in each published hand.
        problem: Why it should not fly, in one line; "" if it may.
        softened: What was changed of the scene, in one line; "" if nothing.
    """

    scene: Scene
    report: LineReport
    bears: float
    problem: str
    softened: str


def preflight(
    plant: RemotePlant, scene: Scene, *, as_written: bool = False, report: LineReport | None = None
) -> Preflight:
    """Measure the line, and check that a scene bears it.

    Args:
        plant: The device, not armed.
        scene: Scene to be rendered.
        as_written: True to leave the scene as it is. Else walls that do not bear 1.5 times the line are softened: to
            the stiffest that do, for a scene with `stiffness` and `damping` whose laws state their gains.
        report: The line as measured with the flight's scheduling; measured for a second by default.

    Raises:
        PlantError: If the device is not inactive.
        MaglevError: If a law fails.
    """
    report = report or measure_line(plant)
    scene = scene.replace(period=plant.period, delay=plant.delay)
    inertia = np.array([*[plant.calibration.mass] * 3, *plant.calibration.inertia])
    bears, softened = _bears(scene, inertia), ""
    if bears < report.planned and not as_written and (soft := _softer(scene, report.planned, inertia)) is not None:
        before, after = (f"{one.stiffness:.0f}" for one in (scene, soft))  # type: ignore[attr-defined]
        scene, written, bears = soft, bears, _bears(soft, inertia)
        softened = (
            f"{scene.name}'s walls are {after} N/m instead of {before}, which bear {written * 1e3:.2f} ms: "
            f"these bear {bears * 1e3:.2f} ms, and the line takes {report.usual * 1e3:.2f}"
        )
    return Preflight(scene, report, bears, _problem(scene, report, bears), softened)


def judge_change(
    scene: Scene, inertia: Sequence[float], delays: Sequence[float], *, report: LineReport, anyway: bool
) -> tuple[float | None, str]:
    """Check new settings in flight as a scene is checked before takeoff.

    Args:
        scene: The scene with the new settings, its period and delay the device's.
        inertia: Mass and moments of inertia of the flotor [kg, kg m²], six.
        delays: Newest times from a sample to its answer's effect [s]; may be empty.
        report: The line as measured before takeoff.
        anyway: True to fly all the same.

    Returns:
        Longest delay that they are flown with [s], None if they are refused; and why, or "".

    Raises:
        MaglevError: If a law fails.
    """
    with own_code_refused():
        bears = _bears(scene, np.array(inertia))
    newest = replace(report, delay=np.array(delays), samples=len(delays), late=0)
    problem = _problem(scene, max(report, newest, key=lambda one: one.usual), bears)
    if problem and anyway:
        return report.anyway, f"warning: {problem}"
    return None if problem else bears, problem


def _bears(scene: Scene, inertia: Array) -> float:
    margins = delay_margins(device_controller(scene), list(HANDS), pose=scene.start().pose, inertia=inertia)
    return float(np.min([*margins.values()]))


def _problem(scene: Scene, report: LineReport, bears: float) -> str:
    """Return why a scene should not fly, with the remedy."""
    if abs(report.clock - 1.0) > _CLOCK:
        return (
            f"the device's clock goes {report.clock:.3f} times as fast as this host's, and 2 % is allowed: "
            "correct its period"
        )
    if report.success < _ANSWERED:
        return (
            f"only {100.0 * report.success:.0f} % of {report.samples} samples were answered in time, and "
            f"{100.0 * _ANSWERED:.0f} % are needed: keep a processor free or take a quicker line"
        )
    if math.isnan(bears):
        return f"it is not known what delay {scene.name} bears: its laws remember too long, or jump"
    if bears == 0.0:
        return f"{scene.name} is UNSTABLE without any delay: lower its stiffness, or raise its damping"
    if bears < report.usual:
        return (
            f"{scene.name} bears {bears * 1e3:.2f} ms of delay and is UNSTABLE beyond, and one in 20 answers takes "
            f"more than {report.usual * 1e3:.2f} ms: lower its stiffness, keep a processor free or take a quicker line"
        )
    return ""


def _softer(scene: Scene, planned: float, inertia: Array) -> Scene | None:
    """Return the scene with the stiffest walls that bear a delay; None if there are none."""
    live = {one.name for one in scene.parameters() if one.live}
    if not {"stiffness", "damping"} <= live or stated_gains(device_controller(scene)) is None:
        return None
    stiffness, damping = scene.stiffness, scene.damping  # type: ignore[attr-defined]

    def soft(share: float, delay: float) -> Scene | None:
        for less in (1.0, math.sqrt(share), share):
            try:
                one = scene.replace(stiffness=share * stiffness, damping=less * damping)
            except ParameterError:
                continue
            if judge(device_controller(one), delay=delay, pose=one.start().pose, inertia=inertia).stable:
                return one
        return None

    low, high, best = 0.0, 1.0, None
    for _ in range(_HALVINGS):
        share = 0.5 * (low + high)
        if (one := soft(share, _STYLUS * planned)) is None:
            high = share
        else:
            low, best = share, one
    return best if best is not None and _bears(best, inertia) >= planned else None


def stiffest_walls(report: LineReport, plant: RemotePlant) -> dict[str, tuple[float, float]]:
    """Return the stiffest wall that a line bears, by hand.

    Stiffness and damping [N/m, N s/m] each.
    """
    walls = {}
    for hand in HANDS:
        wall = largest_stable_stiffness(
            period=plant.period, delay=report.planned, mass=plant.calibration.mass, hand=hand
        )
        walls[hand] = float(wall.stiffness), float(wall.damping)
    return walls
