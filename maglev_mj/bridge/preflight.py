"""Preflight check: link latency, and stability of a scene with it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, nullcontext, suppress
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple, cast

import numpy as np

from maglev_mj.bridge.realtime import LatencyHistogram, Realtime
from maglev_mj.bridge.realtime import realtime as scheduled
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.errors import ParameterError, SensingError, TooManyCallsError
from maglev_mj.frames import ZERO, Array
from maglev_mj.parameters import number
from maglev_mj.plants.hand import HANDS
from maglev_mj.process import SideAnswers
from maglev_mj.result import Result, Table
from maglev_mj.scenes import Scene
from maglev_mj.session import device_controller, user_errors_rejected
from maglev_mj.theory import largest_stable_stiffness
from maglev_mj.theory.held import Held
from maglev_mj.theory.line import LossyLine, mean_square_line
from maglev_mj.theory.loop import Bound, Loop
from maglev_mj.theory.read import scene_lag, stated_gains
from maglev_mj.theory.verdict import judge, stability

_ANSWERS = 64
_WINDOW = 2_000_000_000  # [ns] of the minimum transport time: clocks drift by up to 100 µs/s

MARGIN = 1.5
"""Required margin of a scene over the 95th percentile of the link delay."""

_CLOCK = 0.02
"""Tolerance of the device clock's rate."""

_PARTS = 10
"""Parts of a measurement in which the rate is taken: up to four stalls are left out."""

_FASTER = "keep a processor free or use a faster link"

_ANSWERED = 0.5
"""Required share of samples answered in time."""

_PATIENCE = 10.0
"""Timeout of the assessment in a process of its own [s]."""

_ALL = 1.0 - 1e-9
"""Largest share of lost samples: a line that loses all of them has no loop."""

_HALVINGS, _HAND_MARGIN = 7, 1.1
"""Bisections of the stiffness factor; delay factor that covers the least stable hand."""


class LoopTiming:
    """Latency histograms of a control loop over a device.

    Attributes:
        answer: Host latency: from a sample's arrival to sending its answer.
        age: Age of a sample when its answer is sent, in excess of the fastest transport of the last seconds (the two
            clocks have no common zero). Bounded by the delays that the device reports: a stalled device clock is
            not taken for a slow link.
        delay: Time from a sample to its answer's effect, by the device's clock.
        newest_age: Last age [s]; 0 in lockstep.
    """

    def __init__(self) -> None:
        self.answer, self.age, self.delay = LatencyHistogram(), LatencyHistogram(), LatencyHistogram()
        self.newest_age = 0.0
        self._least, self._before, self._expiry = math.inf, math.inf, 0
        # last answered samples, and the times of their answers
        self._sent: list[tuple[int | None, int]] = [(None, 0)] * _ANSWERS

    def add(self, plant: RemotePlant) -> None:
        """Add the last sample; call after its answer."""
        answer, samples = round(plant.answer_latency * 1e9), plant.samples
        answered, _, delay, _, transport = plant.answers
        self.answer.add(answer)
        if delay == delay:
            self.delay.add(round(delay * 1e9))
        if plant.lockstep:
            return  # device time is stopped meanwhile
        if samples.time > self._expiry:
            self._least, self._before, self._expiry = transport, self._least, samples.time + _WINDOW
        tick, sent = self._sent[answered % _ANSWERS]
        if delay == delay and tick == answered:
            fastest = sent - round((delay - plant.delay) * 1e9)  # transport if the return took no time
            self._least, self._before = max(self._least, fastest), max(self._before, fastest)
        self._least = min(self._least, transport)
        self._sent[samples.tick % _ANSWERS] = samples.tick, answer + transport
        newest = answer + transport - int(min(self._least, self._before))
        self.age.add(newest)
        self.newest_age = newest * 1e-9

    @property
    def kinds(self) -> Mapping[str, LatencyHistogram]:
        """Latency histograms by name, without empty ones."""
        kinds = {
            "host latency, arrival to answer": self.answer,
            "sample age when answered": self.age,
            "loop delay, sample to effect": self.delay,
        }
        return {name: histogram for name, histogram in kinds.items() if histogram.count}

    def table(self) -> Table:
        """Return the latencies; empty if the loop did not run."""
        rows = [(name, *(f"{x * 1e3:.3f}" for x in (h.p50, h.p99, h.max))) for name, h in self.kinds.items()]
        return Table("", ("latency [ms]", "median", "99 %", "max"), rows)


@dataclass(frozen=True, kw_only=True, eq=False)
class LinkReport(Result):
    """Latencies of link and host, measured without currents.

    Attributes:
        device_delay: Time from a command's arrival to its effect [s].
        delay: Times from a sample to its answer's effect, by the device's clock [s], (N,).
        answer: Host latencies, from a sample's arrival to sending its answer [s], (N,).
        samples: Number of samples taken by the device.
        lost: Samples that did not arrive.
        skipped: Samples not answered because a newer one had arrived.
        late: Answers too old for the device to apply.
        clock: Rate of the device clock relative to the host clock.
        lockstep: True if the device waits for each answer.
    """

    device_delay: float
    delay: Array
    answer: Array
    samples: int
    lost: int = 0
    skipped: int = 0
    late: int
    clock: float = 1.0
    lockstep: bool = False
    units: ClassVar = {"delay": "s", "answer": "s"}

    def _headline(self) -> str:
        share = f"{self.success:.1%}".replace("%", " %")
        return f"Loop delay {1e3 * self.delay_95:.3g} ms (95th percentile); {share} answered in time"

    @property
    def delay_95(self) -> float:
        """95th percentile of the loop delay [s]; the device's own delay without any answer.

        Not the maximum: single late answers do not destabilise a loop.
        """
        return float(np.percentile(self.delay, 95.0)) if self.delay.size else self.device_delay

    @property
    def required_delay(self) -> float:
        """Delay at which a scene must be stable [s]: the device's, plus 1.5 times that of link and host."""
        return self.device_delay + MARGIN * max(self.delay_95 - self.device_delay, 0.0)

    @property
    def anyway(self) -> float:
        """Critical delay assumed for a scene that is flown although the check failed [s]."""
        return 2.0 * self.required_delay

    def line(self, period: float) -> LossyLine:
        """Return the line with these delays, at a sample period [s]; samples lost, skipped or late count as lost."""
        delays = np.sort(self.delay)[: max(self.delay.size - self.late, 0)]
        lost = (self.lost + self.skipped + self.late) / max(self.samples, 1)
        return LossyLine.of_delays(delays if delays.size else [self.device_delay], period, min(lost, _ALL))

    @property
    def success(self) -> float:
        """Share of the samples answered in time."""
        return max(self.delay.size - self.late, 0) / max(self.samples, 1)

    def columns(self) -> Mapping[str, Array]:
        """Return the latencies of each answer."""
        return {"delay": self.delay, "answer": self.answer}

    def table(self) -> Table:
        """Return the latencies, with counts of lost and late samples below."""
        device, program = self.device_delay, self.answer
        link = self.delay - device - program if self.delay.size == program.size else np.zeros(0)
        kinds = {
            "loop delay, sample to effect": self.delay,
            "of which link and kernel": link,
            "of which host program": program,
        }
        rows = [
            (name, *(f"{1e3 * float(np.percentile(times, share)):.3f}" for share in (50.0, 95.0, 99.0, 100.0)))
            for name, times in kinds.items()
            if times.size
        ]
        clock = f"device clock {100.0 * (self.clock - 1.0):+.2f} %"
        note = f"{self.lost} samples lost, {self.skipped} skipped, {self.late} answers late; {clock}"
        return Table("", ("latency [ms]", "median", "95 %", "99 %", "max"), rows, note)


def measure_link(plant: RemotePlant, duration: float = 1.0) -> LinkReport:
    """Measure the latencies of link and host by answering an inactive device with zero currents.

    Args:
        plant: The device, not armed.
        duration: Duration by the device's clock [s].

    Raises:
        PlantError: If the device is not inactive, or its samples end.
    """
    plant.require_inactive()
    count = max(round(number("duration", duration, above=0.0) / plant.period), 2)
    measurement = _Measurement(plant)
    while measurement.samples < count:
        measurement.cycle()
    return measurement.report()


class _Measurement:
    """Latencies of an inactive device's samples, answered with zero currents."""

    def __init__(self, plant: RemotePlant) -> None:
        self._plant, samples = plant, plant.samples
        self._delays, self._answers, self._clocks = list[float](), list[float](), list[tuple[int, int]]()
        self._late, self._first, self._lost, self._skipped = 0, samples.tick, samples.lost, samples.skipped

    @property
    def samples(self) -> int:
        """Number of samples taken by the device so far."""
        return self._plant.samples.tick - self._first

    def cycle(self) -> None:
        """Answer one sample."""
        plant, samples = self._plant, self._plant.samples
        with suppress(SensingError):  # the device may be open on the bench
            plant.read()
        self._clocks.append((samples.time, samples.time + plant.answers.transport))
        if not math.isnan(delay := plant.answers.newest_delay):
            self._delays.append(delay)
            self._late += delay - plant.delay > (plant.limits.stale or math.inf)
        plant.drive(ZERO)
        self._answers.append(plant.answer_latency)

    def report(self) -> LinkReport:
        """Return the latencies so far, of at least two samples."""
        plant, samples, delays = self._plant, self._plant.samples, self._delays
        return LinkReport(
            device_delay=plant.delay,
            delay=np.array(delays[1:]),
            answer=np.array(self._answers[1:][: len(delays) - 1]),
            samples=self.samples,
            lost=samples.lost - self._lost,
            skipped=samples.skipped - self._skipped,
            late=self._late,
            clock=1.0 if plant.lockstep else _clock(np.array(self._clocks, dtype=float)),
            lockstep=plant.lockstep,
        )


def _clock(times: Array) -> float:
    """Return device time over host time: the median between the fastest arrivals of successive parts.

    A device that stands still, as a stalled twin, shows in one or two parts, a wrong rate in all.
    """
    parts = np.array_split(times, min(_PARTS, len(times)))
    device, host = np.diff([rows[np.argmin(rows[:, 1] - rows[:, 0])] for rows in parts], axis=0).T
    return float(np.median(np.divide(device, host, out=np.full(len(host), math.inf), where=host > 0.0)))


class Preflight(NamedTuple):
    """Outcome of the preflight check.

    Attributes:
        scene: The scene to fly, unchanged or with wall stiffness reduced until it is stable at `report.required_delay`.
        report: Latencies of link and host.
        critical_delay: Critical delay of the scene [s], the smallest over no hand and each published hand.
        problem: Reason not to fly, as one line; "" if it may.
        reduction: Message about reduced wall stiffness; "" without.
        requested: Wall stiffness of the scene before a reduction [N/m]; None without walls of one stiffness.
        held: Verdict at the measured delay free and in each hand, in one or two lines; see `Held`.
        line: Mean-square verdict at random delays as measured, in one line; "" without a wall.
    """

    scene: Scene
    report: LinkReport
    critical_delay: float
    problem: str
    reduction: str
    requested: float | None = None
    held: tuple[str, ...] = ()
    line: str = ""

    @property
    def rendered(self) -> str:
        """Wall stiffness of the flight, and the requested one if it differs, as text; "" without walls of one."""
        if self.requested is None:
            return ""
        stiffness: float = self.scene.stiffness  # type: ignore[attr-defined]
        asked = f" ({self.requested:.0f} requested)" if self.reduction else ""
        return f"wall stiffness {stiffness:.0f} N/m{asked}"


def preflight(
    plant: RemotePlant,
    scene: Scene,
    *,
    as_written: bool = False,
    report: LinkReport | None = None,
    aside: bool = False,
    realtime: Realtime | None = None,
) -> Preflight:
    """Measure the loop delay, and check that a scene is stable with it.

    Args:
        plant: The device, not armed.
        scene: Scene to be rendered.
        as_written: True to leave the scene unchanged. Else, in a scene with `stiffness` and `damping` whose laws state
            their gains, wall stiffness is reduced to the largest that is stable at `LinkReport.required_delay`.
        report: Latencies measured with the flight's scheduling; by default measured for 1 s.
        aside: True to compute in a process of its own, within 10 s, while the device is answered: a device gives up a
            host that is silent. The process waits while the link is measured, so the check does not load what it
            measures. Scene and laws must then be picklable.
        realtime: Scheduling of the measurement, as in flight; None: that of the caller.

    Raises:
        PlantError: If the device is not inactive.
        MaglevError: If a law fails, or its stability is not known in time.
    """
    with ExitStack() as last:
        cycle, side = _Measurement(plant).cycle, None
        if aside:  # before real-time scheduling, which a child process would inherit
            side = SideAnswers(assess, "no takeoff: stability of the scene not known", _PATIENCE)
            last.callback(side.close, 0.0)
            while not side.started:
                cycle()
        if report is None:
            with nullcontext() if realtime is None else scheduled(realtime):
                report = measure_link(plant)
        question = on_device(scene, plant), plant.calibration.body.inertia, report, as_written
        if side is None:
            return assess(*question)
        side.ask(*question)
        while (result := side.answer()) is None:
            cycle()
        return cast(Preflight, result._replace(report=report))


def on_device(scene: Scene, plant: RemotePlant) -> Scene:
    """Return a scene with the clocks of a device.

    Raises:
        ParameterError: If the device cannot render a wall of the scene.
    """
    clocks = {"period": plant.period, "delay": plant.delay}
    own = zip(("device_period", "device_delay"), plant.walls_clock or ())
    clocks |= {name: value for name, value in own if hasattr(scene, name)}
    scene = scene.replace(**clocks)
    plant.check_walls(scene.controller().device_walls)
    return scene


def assess(scene: Scene, inertia: Array, report: LinkReport, as_written: bool) -> Preflight:
    """Check that a scene is stable with a measured loop delay; see `preflight`.

    Args:
        scene: Scene with the device's period and delay.
        inertia: Mass and moments of inertia of the flotor [kg, kg m²], (6,).
        report: Latencies of the link.
        as_written: True to leave the scene unchanged.

    Raises:
        MaglevError: If a law fails.
    """
    requested = getattr(scene, "stiffness", None)
    critical_delay, reduction, required = _critical_delay(scene, inertia), "", report.required_delay
    short = critical_delay < required and not as_written
    if short and (reduced := _reduced(scene, required, inertia)) is not None:
        before, after = (f"{x.stiffness:.0f}" for x in (scene, reduced))  # type: ignore[attr-defined]
        scene, original, critical_delay = reduced, critical_delay, _critical_delay(reduced, inertia)
        reduction = (
            f"wall stiffness reduced from {before} to {after} N/m: 95 % of the loop delays are below "
            f"{report.delay_95 * 1e3:.2f} ms, so it must be stable up to {required * 1e3:.2f} ms; stable "
            f"up to {original * 1e3:.2f} ms before and {critical_delay * 1e3:.2f} ms now"
        )
    problem = _problem(scene, report, critical_delay)
    verdicts = _at_measured_delays(scene, inertia, report)
    return Preflight(scene, report, critical_delay, problem, reduction, requested, *verdicts)


def check_change(
    scene: Scene, inertia: Sequence[float], delays: Sequence[float], *, report: LinkReport, anyway: bool
) -> tuple[float | None, str]:
    """Check new settings in flight, as `preflight` checks a scene.

    Args:
        scene: Scene with the new settings, and with the device's period and delay.
        inertia: Mass and moments of inertia of the flotor [kg, kg m²], six.
        delays: Newest loop delays [s]; may be empty.
        report: Latencies measured before takeoff.
        anyway: True to accept settings that fail the check.

    Returns:
        Critical delay for the delay guard [s], None if refused; and the reason, or "".

    Raises:
        MaglevError: If a law fails.
    """
    with user_errors_rejected():
        critical_delay = _critical_delay(scene, np.array(inertia))
    newest = replace(report, delay=np.array(delays), samples=len(delays), late=0)
    problem = _problem(scene, max(report, newest, key=lambda report: report.delay_95), critical_delay)
    if problem and anyway:
        return report.anyway, f"warning: {problem}"
    return None if problem else critical_delay, problem


def _critical_delay(scene: Scene, inertia: Array) -> Bound:
    """Return the shortest critical delay, free and in each hand; NaN if a loop cannot be judged."""
    around: Any = {"inertia": inertia, "reach": scene.body.bounded.range, "device": scene.device_clock}
    around |= {"driver_lag": scene_lag(scene), "delay": 0.0, "pose": scene.start().pose, "load": scene.body.load}
    loops = Loop.of(device_controller(scene), **around)  # linearised once
    bounds = [judge(loops, hand=hand).critical_delay for hand in HANDS]
    return Bound.least(bounds)


def _at_measured_delays(scene: Scene, inertia: Array, report: LinkReport) -> tuple[tuple[str, ...], str]:
    """Return the verdicts at the 95th percentile free and in each hand, and on random delays as measured, in words."""
    try:
        verdict = stability(scene, inertia=inertia, delay=report.delay_95)
        return verdict.held.lines, mean_square_line(verdict.loops, report.line(float(scene.period)))
    except (ParameterError, TooManyCallsError):  # a delay longer than the theory's, a law that is not judged
        return Held((), judged=False).lines, ""


def _problem(scene: Scene, report: LinkReport, critical_delay: float) -> str:
    """Return the reason not to fly with its remedy, or ""."""
    if abs(report.clock - 1.0) > _CLOCK:
        rate = f"{report.clock:.3f} times the host clock (tolerance 2 %)"
        return f"the device clock runs at {rate}: correct the device's sample period"
    if report.success < _ANSWERED:
        answered = f"only {100.0 * report.success:.0f} % of {report.samples} samples were answered in time"
        return f"{answered}, at least {100.0 * _ANSWERED:.0f} % required: {_FASTER}"
    if math.isnan(critical_delay):
        causes = "have too long a memory or a discontinuous force, or need too many calls (declare gains())"
        return f"critical delay of {scene.name} not computed: its laws {causes}"
    if critical_delay == 0.0:
        return f"{scene.name} is unstable even without delay: reduce its stiffness or increase its damping"
    if critical_delay < report.delay_95:
        delays = f"5 % of the answers exceed {report.delay_95 * 1e3:.2f} ms: reduce its stiffness, {_FASTER}"
        return f"{scene.name} is stable up to a loop delay of {critical_delay * 1e3:.2f} ms, but {delays}"
    return ""


def _reduced(scene: Scene, required_delay: float, inertia: Array) -> Scene | None:
    """Return the scene with the largest wall stiffness that is stable at a delay; None without any."""
    live = {x.name for x in scene.parameters() if x.live}
    if not {"stiffness", "damping"} <= live or stated_gains(device_controller(scene)) is None:
        return None
    stiffness, damping = scene.stiffness, scene.damping  # type: ignore[attr-defined]

    def stable_scene(share: float, delay: float) -> Scene | None:
        for damping_share in (1.0, math.sqrt(share), share):
            try:
                reduced = scene.replace(stiffness=share * stiffness, damping=damping_share * damping)
            except ParameterError:
                continue
            around: Any = {"pose": reduced.start().pose, "inertia": inertia, "device": reduced.device_clock}
            around["driver_lag"] = scene_lag(reduced)
            if judge(device_controller(reduced), delay=delay, **around).stable:
                return reduced
        return None

    low, high, best = 0.0, 1.0, None
    for _ in range(_HALVINGS):
        share = 0.5 * (low + high)
        if (reduced := stable_scene(share, _HAND_MARGIN * required_delay)) is None:
            high = share
        else:
            low, best = share, reduced
    return best if best is not None and _critical_delay(best, inertia) >= required_delay else None


def stiffest_walls(
    report: LinkReport, period: float, mass: float, driver_lag: float = 0.0
) -> dict[str, tuple[float, float]]:
    """Return the stiffest wall that is stable at the required delay, by hand: stiffness and damping [N/m, N s/m]."""
    loop: Any = {"period": period, "delay": report.required_delay, "mass": mass, "driver_lag": driver_lag}
    walls = {hand: largest_stable_stiffness(hand=hand, **loop) for hand in HANDS}
    return {hand: (float(wall.stiffness), float(wall.damping)) for hand, wall in walls.items()}
