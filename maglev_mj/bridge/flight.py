"""Flight of a scene on a device: takeoff, rendering, landing."""

from __future__ import annotations

import json
import math
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from statistics import median
from typing import NamedTuple

import numpy as np

from maglev_mj import session
from maglev_mj.bridge.landing import LandingReport, StopSwitch
from maglev_mj.bridge.line import LoopTiming
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import ControlLoop
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.frames import ZERO, Array, Command, Sample
from maglev_mj.parameters import number
from maglev_mj.process import SideAnswers
from maglev_mj.recording import RecordingError, RecordingFile
from maglev_mj.scenes import Scene
from maglev_mj.scenes.rooms import WEIGHT
from maglev_mj.session import REPLACED, STEP_FORCE, ChangeRequest, Publisher, SampledMotion, Snapshot
from maglev_mj.spec import GRAVITY, INERTIA
from maglev_mj.terminal import wrapped
from maglev_mj.theory.closed_loop import MOST_PERIODS

_BORNE = 0.8
"""Share of what laws bear from which answers are late.

Near what it bears, a loop swings long after a tap.
"""
_SURE = 0.005
"""Delay up to which laws are taken to bear the whole [s].

Usual delays leave no room for a share.
"""
_LONGEST = 0.03
"""Longest delay to which margins are known [s]."""
_RULES = (3, 5, 3.0), (8, 16, 1.25), (48, 64, 1.0)
"""Late answers, of how many, beyond how much of the delay from which they are late.

A busy machine has answers a little late for a tenth of a second; a loop swings up slowly there.
"""
_MEMORY = 0.2
"""Time constant in which reversals are forgotten [s]."""
_SWING = 10.0
"""Largest part of a swing in the second sum of reversals [N].

A blow is a few hard swings, which weak vibrations exceed by their number.
"""
_REVERSALS, _SMALL = 380.0, 190.0
"""Most reversals of a law's force in both sums [N].

Twice the largest of good flights: 184 and 86 N, taps of 20 N on the stiffest published wall at 200 Hz.
"""
_SPAN = 1.0
_ENERGY = 0.045
"""Most energy that laws may give out in a second [J].

More than twice the largest of good flights, 18 mJ: 20 N let go after a second against a wall.
"""
_HEAVY = 1e9
_SIZES = tuple(math.sqrt(own / INERTIA[0]) for own in INERTIA)
"""Radius of gyration of each rotation, 1 for translations [m].

A torque over it is a force, an angle times it a path.
"""


def late_delay(bears: float, period: float) -> float:
    """Return the delay from which answers are late [s].

    Args:
        bears: Longest delay that the laws bear [s], as `delay_margins` returns it: NaN or infinity if it is not known.
        period: Sample period [s].
    """
    longest = min(_LONGEST, MOST_PERIODS * period)
    known = bears if bears < longest else longest  # which NaN is not
    return max(_BORNE * known, min(known, _SURE))


class DelayGuard:
    """Detector of answers later than the rendered laws bear.

    A single late answer makes no loop unstable, nor do some that are a little late: it takes 48 of the last 64 samples
    beyond what the laws bear, 8 of 16 beyond 1.25 times that, or 3 of 5 beyond three times.

    Args:
        bears: Longest delay from a sample to its answer's effect that the laws bear [s]; see `late_delay`.

    Attributes:
        bears: As given; it may be changed.
    """

    def __init__(self, bears: float) -> None:
        self.bears = bears
        most = max(last for _, last, _ in _RULES)
        self._delays = deque([0.0] * most, maxlen=most)

    def check(self, delay: float) -> str:
        """Add the delay of one sample [s]; return what is wrong, or ""."""
        delays, bears = self._delays, self.bears
        delays.append(delay)
        if delay <= bears:
            return ""
        recent = list(delays)
        for most, last, share in _RULES:
            bound = share * bears
            if delay > bound and (late := sum(one > bound for one in recent[-last:])) >= most:
                return (
                    f"the line is slower than the scene bears: {late} of the last {last} delays are above "
                    f"{bound * 1e3:.2f} ms, the newest {delay * 1e3:.2f} ms"
                )
        return ""


class PowerGuard:
    """Detector of laws that vibrate, or give out energy.

    Torques count as the forces, and angles as the paths, of a body with the axis' moment of inertia at the moving mass.
    Reversals are the smaller of two swings of a force to and fro, summed and forgotten in 0.2 s: whole, and up to 10 N
    of each. Energy is force times path over the last second. All are of the laws alone, without the weight carried.

    Args:
        period: Sample period [s].
    """

    def __init__(self, period: float) -> None:
        self._growth = math.exp(period / _MEMORY)
        self._weight = 1.0  # of a reversal now: it grows where the older ones would shrink
        self._reversals, self._small = [0.0] * 6, [0.0] * 6
        self._turns, self._swings, self._rises = [0.0] * 6, [0.0] * 6, [False] * 6
        self._place: Sequence[float] = ZERO
        self._last: Sequence[float] = ZERO
        span = max(round(_SPAN / period), 1) + 1
        self._sums = deque([0.0] * span, maxlen=span)

    def check(self, position: Sequence[float], force: Sequence[float]) -> str:
        """Add one sample's pose and the laws' answer to it; return what is wrong, or ""."""
        given, rises, swings, most, capped = self._sums[-1], self._rises, self._swings, 0.0, 0.0
        self._weight = weight = self._weight * self._growth
        parts = zip(self._last, force, self._place, position, rises)
        for axis, (before, part, start, end, rose) in enumerate(parts):
            given += before * (end - start)
            if part != before and (part > before) is not rose:
                rises[axis] = not rose
                swing = abs(before - self._turns[axis]) / _SIZES[axis]
                less = swing if swing < swings[axis] else swings[axis]
                self._turns[axis], swings[axis] = before, swing
                self._reversals[axis] = whole = self._reversals[axis] + weight * less
                self._small[axis] = small = self._small[axis] + weight * (less if less < _SWING else _SWING)
                if whole > most:
                    most = whole
                if small > capped:
                    capped = small
        most, capped = most / weight, capped / weight
        self._sums.append(given)
        self._place, self._last = position, force
        if weight > _HEAVY:
            self._reversals, self._small = ([one / weight for one in six] for six in (self._reversals, self._small))
            self._weight = 1.0
        if most > _REVERSALS:
            return f"the laws vibrate: {most:.0f} N of reversals in {_MEMORY:g} s, {_REVERSALS:g} N allowed"
        if capped > _SMALL:
            return (
                f"the laws vibrate: {capped:.0f} N of reversals of at most {_SWING:g} N each in {_MEMORY:g} s, "
                f"{_SMALL:g} N allowed"
            )
        if (out := given - self._sums[0]) > _ENERGY:
            return f"the laws give out energy: {out * 1e3:.0f} mJ in {_SPAN:g} s, {_ENERGY * 1e3:g} mJ allowed"
        return ""


_USUAL = 100  # answers whose median is the usual delay: one late answer makes no loop unstable
_NOTE = "the hand, the rate and the delay are the device's"


class FlightReport(NamedTuple):
    """Outcome of a flight.

    Attributes:
        ticks: Samples answered.
        lost: Samples that did not arrive, from takeoff on.
        skipped: Samples too old when read, from takeoff on.
        wall_time: Duration in real time [s].
        landing: Pose and motion after landing.
    """

    ticks: int
    lost: int
    skipped: int
    wall_time: float
    landing: LandingReport

    def __str__(self) -> str:
        first = f"  {self.wall_time:.1f} s, {self.ticks} samples, {self.lost} lost, {self.skipped} skipped"
        return "\n".join([first, *wrapped(str(self.landing), further="    ")])


class Flight:
    """Flight of a scene on a device.

    Args:
        plant: The device; closed by the caller.
        scene: Rendered scene; its period must be the device's.
        switch: Switch that ends the flight; a new one by default.
        file: Recording of every sample; left open.
        publishers: Publishers to viewers and other programs; left open.
        warn: Called, once, with the reason if the recording ends.
        step_force: Largest step of force by new settings [N]; see `check_step`.
        bears: Longest delay from a sample to its answer's effect that the scene bears [s]; see `preflight` and
            `late_delay`.
        judge: `judge_change` in a process of its own, started before the thread is a real-time one; None to take new
            settings without.

    Attributes:
        switch: Switch that ends the flight.
        reason: Why a guard ends the flight; "" if none does.
        timing: Latencies of the loop.

    Raises:
        ParameterError: If the scene's period is not the device's.
    """

    def __init__(
        self,
        plant: RemotePlant,
        scene: Scene,
        *,
        switch: StopSwitch | None = None,
        file: RecordingFile | None = None,
        publishers: Sequence[Publisher] = (),
        warn: Callable[[str], object] | None = None,
        step_force: float = STEP_FORCE,
        bears: float = math.inf,
        judge: SideAnswers | None = None,
    ) -> None:
        if scene.period != plant.period:
            raise ParameterError(f"period must be the device's {plant.period:g} s, not {scene.period:g}")
        self._plant, self._scene, self._file = plant, scene, file
        self._publishers, self._since = session.Publishers(publishers), 0
        self._motion, self._note = SampledMotion(), _NOTE
        self.switch, self.timing = switch or StopSwitch(), LoopTiming()
        self._lost = self._skipped = 0
        self._request: ChangeRequest | None = None
        self._steps: Iterator[None] = iter(())
        self._wanted: tuple[ChangeRequest, Controller] | None = None
        self._begun: ChangeRequest | None = ChangeRequest(scene)
        self._controller = session.device_controller(scene)
        self._step_force = number("step_force", step_force, above=0.0)
        self._actions = session.device_actions(type(scene))
        self._inertia = [*[plant.calibration.mass] * 3, *plant.calibration.inertia]
        self._force: Sequence[float] = WEIGHT
        self._delays: deque[float] = deque(maxlen=_USUAL)
        self._warn, self._check_due = warn, session.Due(1.0)
        self._late, self._power = DelayGuard(late_delay(bears, plant.period)), PowerGuard(plant.period)
        self.reason, self._judge = "", judge
        if file is not None:
            file.attach("calibration.json", "application/json", json.dumps(plant.calibration.as_json()).encode())

    def run(self, duration: float | None = None) -> FlightReport:
        """Take off, render the scene, and land.

        Args:
            duration: Rendering time by the device's clock [s]; None until landing is requested.

        Raises:
            KeyboardInterrupt: As `StopSwitch.flying`.
            DeviceFault: If the device or the flight has a fault, or the currents were cut.
            PlantError: If the device does not confirm the cut.
        """
        start, plant = time.monotonic(), self._plant
        try:
            with self.switch.flying(plant):
                ticks, landing = self._fly(duration)
        except MaglevError as error:
            if self._file is not None:
                self._file.event("fault", str(error))
            raise
        finally:
            if self.timing.answer.count and self._file is not None:
                self._record_timing(self._file)
        return FlightReport(ticks, *self._missing(), time.monotonic() - start, landing)

    def _fly(self, duration: float | None) -> tuple[int, LandingReport]:
        plant, switch = self._plant, self.switch
        plant.takeoff(watch=self._watch, tries=True)
        self._force = plant.calibration.coils.wrench(np.array(plant.last_currents)).tolist()
        first, (self._lost, self._skipped) = plant.samples.tick, self._missing()
        last = None if duration is None else first + round(duration / plant.period)
        while not self.reason and not switch.landing and (last is None or plant.samples.tick < last):
            self._stretch(last)
        ticks = plant.samples.tick - first
        if self.reason and self._file is not None:
            self._file.event("landing", self.reason)
        return ticks, plant.land(watch=lambda: self._watch() and False, reason=self.reason)

    def _missing(self) -> tuple[int, int]:
        """Return lost and skipped samples since takeoff."""
        samples = self._plant.samples
        return samples.lost - self._lost, samples.skipped - self._skipped

    def _watch(self) -> bool:
        """Refuse new settings in takeoff and landing; return landing request."""
        if (request := self._publishers.wanted()) is not None:
            request.reply("settings are taken in flight, not while it takes off or lands")
        return self.switch.landing

    def _record_timing(self, file: RecordingFile) -> None:
        """Record the timing of the flight."""
        for name, one in self.timing.kinds.items():
            times = f"{one.p50 * 1e3:.3f} ms in the median, {one.p99 * 1e3:.3f} at 99 %, {one.max * 1e3:.3f} at most"
            file.event("timing", f"{name}: {times}")
        file.event("timing", "{} samples lost, {} skipped".format(*self._missing()))

    def _stretch(self, last: int | None) -> None:
        """Fly one segment with unchanged parameters."""
        if self._wanted is not None:
            (self._begun, self._controller), self._wanted = self._wanted, None
            self._scene = self._begun.scene
        plant, controller, scene, record = self._plant, self._controller, self._scene, None
        if self._file is not None:
            weight = (0.0, 0.0, -self._inertia[2] * GRAVITY, 0.0, 0.0, 0.0)
            known = {"inertia": self._inertia, "load": weight, "before": self._force}
            name = f"{scene.name} on a device"
            record = session.begin_scene(self._file, scene, plant, controller, kind="device", name=name, **known)
        loop, samples = ControlLoop(plant, controller, observe=self._observe(controller), record=record), plant.samples
        while (
            not self.reason
            and not self.switch.landing
            and self._wanted is None
            and (last is None or samples.tick < last)
        ):
            loop.cycle()

    def _observe(self, controller: Controller) -> Callable[[Sample, Command], object]:
        carried, faces = controller.carried.tolist(), controller.faces
        plant, timing, slow, bad = self._plant, self.timing, self._late.check, self._power.check

        def observe(sample: Sample, applied: Command) -> None:
            timing.add(plant)
            self._force = applied.force
            late = max(plant.lateness, plant.delay + timing.newest_age)
            laws = [one - other for one, other in zip(applied.force, carried)]
            self.reason = slow(late) or bad(sample.position, laws)
            if self._warn is not None and self._file is not None:
                self._check(self._file, self._warn)
            if not self._publishers:
                return
            if self._begun is not None:
                self._since = sample.tick
                self._begun.reply(sample.tick)
                self._begun = None
            force, pose = np.array(laws), np.array(sample.position)
            self._motion.add(plant.samples.tick * plant.period, pose, force, plant.hand_wrench)
            self._publishers.show(lambda: self._snapshot(pose, force, faces, controller.stick_positions))
            self._listen(sample)

        return observe

    def _check(self, file: RecordingFile, warn: Callable[[str], object]) -> None:
        """Report once a second if the recording has ended."""
        if not self._check_due():
            return
        try:
            file.check()
        except RecordingError as error:
            self._warn, self._note = None, str(error)
            warn(self._note)

    def _listen(self, sample: Sample) -> None:
        """Record the delay and take up new settings, the newest only."""
        if not math.isnan(self._plant.last_delay):
            self._delays.append(self._plant.last_delay)
        if (newest := self._publishers.wanted()) is not None:
            older, self._request = self._request, newest
            if older is not None:
                older.reply(REPLACED)
            if older is None or older.scene != newest.scene:  # a key that is held asks again and again
                self._steps = self._take_up(newest.scene)
        if self._request is None:
            return
        self._position = sample.position
        try:
            with session.own_code_refused():
                next(self._steps, None)
        except MaglevError as error:
            self._note = str(error)
            self._request.reply(self._note)
            self._request = None

    def _take_up(self, wanted: Scene) -> Iterator[None]:
        """Judge settings and put them in force, a step a sample.

        Sample rate and delay stay the device's.
        """
        scene, late, note = session.changed(self._scene, wanted), self._late.bears, ""
        if self._judge is not None:
            self._judge.ask(scene, self._inertia, tuple(self._delays))
            while (judged := self._judge.answer()) is None:
                yield
            bears, note = judged
            if bears is None:
                raise ParameterError(note)
            late = late_delay(bears, self._plant.period)
        controller = session.device_controller(scene)
        yield  # making one takes half of a period at 1 kHz: it is looked at a sample later
        session.check_step(self._controller, controller, self._position, self._step_force)
        assert self._request is not None
        self._wanted, self._note = (ChangeRequest(scene, self._request.reply), controller), note or _NOTE
        self._request, self._late.bears = None, late

    def _snapshot(
        self, pose: Array, force: Array, faces: Sequence[tuple[int, float, float]], anchors: Array | None
    ) -> Snapshot:
        """Return the snapshot of now, with the median recent delay."""
        plant, samples = self._plant, self._plant.samples
        return Snapshot(
            scene=self._scene,
            since=self._since,
            delay=median(self._delays or [plant.delay]),
            inertia=self._inertia,
            tick=samples.tick,
            time=float(samples.tick * plant.period),
            pose=pose,
            force=force,
            hand=np.array(plant.hand_wrench),
            hand_estimated=True,
            currents=np.array(plant.last_currents),
            faces=faces,
            anchors=anchors,
            history=self._motion.history.rows,
            work=self._motion.work,
            missed=samples.lost + samples.skipped,
            actions=self._actions,
            state="flying",
            notes=[self._note],
        )
