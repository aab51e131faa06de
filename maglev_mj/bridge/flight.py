"""Flight of a scene on a device: takeoff, rendering, landing."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from statistics import median
from typing import Any, NamedTuple

import numpy as np

from maglev_mj import session
from maglev_mj.bridge.flight_guards import (
    Alarm,
    DelayGuard,
    DeviceSample,
    Guard,
    PowerGuard,
    When,
    delay_limit,
    landing,
)
from maglev_mj.bridge.landing import LandingReport, StopSwitch
from maglev_mj.bridge.observer import LATE
from maglev_mj.bridge.preflight import LoopTiming
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.bridge.wire import Fault
from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import ControlLoop
from maglev_mj.errors import MaglevError, ParameterError, PlantError, SensingError
from maglev_mj.frames import AXES, ZERO, Array, Command, DeviceWall, Sample
from maglev_mj.parameters import number
from maglev_mj.process import SideAnswers
from maglev_mj.recording import RecordingError, RecordingFile
from maglev_mj.recording.sample import Setup
from maglev_mj.scenes import Scene
from maglev_mj.session import REPLACED, STEP_FORCE, ChangeRequest, DeviceStatus, Publisher, SampledMotion, Snapshot
from maglev_mj.terminal import wrapped

_ANSWERS = 100  # of the median delay: single late answers do not destabilise a loop
_PROVEN = 1e-3
"""Least delay of the sensor that is acted on after a probe [s]."""
_NOTE = "hand, sample rate and delay are the device's"


class FlightReport(NamedTuple):
    """Outcome of a flight.

    Attributes:
        ticks: Number of rendered samples.
        lost: Samples that did not arrive, since takeoff.
        skipped: Samples not answered because a newer one had arrived, since takeoff.
        wall_time: Duration in real time [s].
        landing: Pose and motion after landing.
        probes: Probes by their outcome, as text; "" without.
    """

    ticks: int
    lost: int
    skipped: int
    wall_time: float
    landing: LandingReport
    probes: str = ""

    def __str__(self) -> str:
        summary = f"  {self.wall_time:.1f} s, {self.ticks} samples, {self.lost} lost, {self.skipped} skipped"
        probes = wrapped(self.probes, further="    ") if self.probes else []
        return "\n".join([summary, *probes, *wrapped(str(self.landing), further="    ")])


class Flight:
    """Flight of a scene on a device.

    Args:
        plant: The device; closed by the caller.
        scene: Scene to render; its period must be the device's.
        switch: Switch that ends the flight; a new one by default.
        file: Recording of every sample; not closed.
        publishers: Publishers to viewers and other programs; not closed.
        warn: Called once with the reason if the recording ends.
        step_force: Largest force step caused by new settings [N]; see `check_step`.
        critical_delay: Critical delay of the scene [s]; see `preflight` and `delay_limit`.
        rendered: Wall stiffness of the scene as text, for the recording; see `Preflight`.
        device: Status of the device before the flight, for viewers; None for none.
        check: `check_change` in a separate process, started before the thread becomes real-time; None to accept new
            settings unchecked; another mass found in takeoff then ends the flight.

    Attributes:
        switch: Switch that ends the flight.
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
        critical_delay: float = math.inf,
        rendered: str = "",
        device: DeviceStatus | None = None,
        check: SideAnswers | None = None,
    ) -> None:
        if scene.period != plant.period:
            raise ParameterError(f"period must be the device's {plant.period:g} s (got {scene.period:g})")
        self._plant, self._scene, self._file, self._device = plant, scene, file, device
        self._publishers, self._since = session.Publishers(publishers), 0
        self._motion, self._note = SampledMotion(), _NOTE
        self.switch, self.timing = switch or StopSwitch(), LoopTiming()
        self._lost = self._skipped = 0
        self._sensor_delay = 0.0  # in addition to the stated one [s]
        self._request: ChangeRequest | None = None
        self._steps: Iterator[None] = iter(())
        self._started: ChangeRequest | None = ChangeRequest(scene)
        body = plant.calibration.body
        self._inertia, self._load, self._force = (each.tolist() for each in (body.inertia, body.load, 0.0 - body.load))
        self._weight = self._force
        self._controller = session.device_controller(scene, self._weight)
        self._step_force = number("step_force", step_force, above=0.0)
        self._actions = session.device_actions(type(scene))
        self._delays: deque[float] = deque(maxlen=_ANSWERS)
        self._warn, self._check_due = warn, session.FrameClock(1.0)  # of the recording: once a second
        self._delay_guard = DelayGuard(delay_limit(critical_delay, plant.period, own=plant.delay))
        self._power_guard = PowerGuard(plant.period, self._inertia, plant.scale)
        self._checker = check
        self._guards: list[Guard] = [
            (When.COMMANDED, self._power),
            (When.ANSWERED, self._delay),
            (When.ANSWERED, self._named),
        ]
        self._name = ", ".join(filter(None, (f"{scene.name} on a device", rendered)))
        if file is not None:
            file.attach("device.toml", "application/toml", plant.calibration.device.toml().encode())

    def run(self, duration: float | None = None) -> FlightReport:
        """Take off, render the scene, and land.

        Args:
            duration: Rendering time by the device's clock [s]; None to render until landing is requested.

        Raises:
            KeyboardInterrupt: As in `StopSwitch.flying`.
            DeviceFault: If the device or a guard raised a fault, or the currents were cut.
            PlantError: If the device does not confirm the cut.
        """
        if duration is not None:
            number("duration", duration, at_least=0.0)
        start, plant, file = time.monotonic(), self._plant, self._file
        plant.cycles.record = None if file is None else file.append
        try:
            with self.switch.flying(plant):
                ticks, landing = self._fly(duration)
        except MaglevError as error:
            if file is not None:
                file.event("fault", str(error))
            raise
        finally:
            plant.cycles.record, plant.guards = None, [one for one in plant.guards if one not in self._guards]
            if self.timing.answer.count and file is not None:
                for name, h in self.timing.kinds.items():
                    times = f"median {h.p50 * 1e3:.3f} ms, 99 % {h.p99 * 1e3:.3f} ms, max {h.max * 1e3:.3f} ms"
                    file.event("timing", f"{name}: {times}")
                if plant.probes:
                    file.event("probes", plant.probes)
                file.event("timing", "{} samples lost, {} skipped".format(*self._missing()))
        return FlightReport(ticks, *self._missing(), time.monotonic() - start, landing, plant.probes)

    def _fly(self, duration: float | None) -> tuple[int, LandingReport]:
        plant = self._plant
        if (landed := self._take_off()) is not None:
            if self._file is not None:
                self._file.event("landing", landed.reason)
            return 0, landed
        self._force = plant.calibration.coils.wrench(np.array(plant.last_currents)).tolist()
        late = landing(self._check_sensor(plant.coils.sensor_delay, least=LATE * plant.period) or plant.coils.weight)
        if late is not None:
            plant.end(late)
        first, (self._lost, self._skipped) = plant.samples.tick, self._missing()
        last = None if duration is None else first + round(duration / plant.period)
        plant.guards += self._guards
        while not self._is_over(last):
            self._segment(last)
        ticks = plant.samples.tick - first
        if self.reason and self._file is not None:
            self._file.event("landing", self.reason)
        return ticks, plant.land(watch=lambda: self._watch() and False, reason=self.reason)

    def _take_off(self) -> LandingReport | None:
        """Take off; return the report of a landing if the scene is not flown with the mass that was found.

        With another mass or inertia the flotor lands, the scene is checked with it, and it takes off again: the device
        gets the currents that carry the flotor, and those of a controlled stop, before each takeoff.
        """
        plant = self._plant
        self._setup = self._describe(self._scene, self._controller)  # reads files: before the currents flow
        plant.takeoff(watch=self._watch, check_coils=True)
        if not (found := plant.coils.weight):
            return None
        if self._file is not None:
            self._file.event("takeoff", found)
        problem = plant.weigh()
        landed = plant.land(watch=lambda: self._watch() and False)
        if problem := problem or self._check_weight():
            return landed._replace(reason=f"{found}: {problem}")
        self._note = found
        self._setup = self._describe(self._scene, self._controller)
        plant.takeoff(watch=self._watch, check_coils=True)
        return None

    def _check_sensor(self, delay: float, walls: Sequence[DeviceWall] = (), least: float = _PROVEN) -> str:
        """Add the sensor's delay [s] to that of the loop; return a message if the scene does not tolerate both.

        `walls` are those on the device: they tolerate no delay that begins in flight. Delays up to `least` [s] are not
        acted on.
        """
        if walls and delay > self._sensor_delay + least:
            return f"the sensor is delayed by at least {delay * 1e3:.1f} ms; walls on the device removed"
        if delay > max(self._sensor_delay, least):  # false for NaN
            self._sensor_delay, limit = delay, self._delay_guard.limit
            if delay + self._plant.answers.delay_bound > limit:
                return f"the sensor is delayed by {delay * 1e3:.1f} ms; loop delay limit {limit * 1e3:.2f} ms"
        return ""

    def _check_weight(self) -> str:
        """Check the scene with the mass that the takeoff has found, and carry it; return a message if refused."""
        plant, scene = self._plant, self._scene
        if self._checker is None:
            return "the scene was not checked with it"
        body = plant.calibration.body
        self._inertia, self._load, self._weight = (each.tolist() for each in (body.inertia, body.load, 0.0 - body.load))
        self._checker.ask(scene, self._inertia, ())
        try:
            while (answer := self._checker.answer()) is None:
                if self._watch():
                    return "landing was requested"
                with suppress(SensingError):  # a pose is not needed
                    plant.read()
        except PlantError:
            raise
        except MaglevError as error:
            return str(error)
        critical, problem = answer
        if critical is None:
            return str(problem)
        self._delay_guard.limit = delay_limit(critical, plant.period, own=plant.delay)
        self._power_guard = PowerGuard(plant.period, self._inertia, plant.scale)
        self._controller = session.device_controller(scene, self._weight)
        return ""

    @property
    def reason(self) -> str:
        """Reason of a guard to land; "" without."""
        return self._plant.reason

    def _power(self, sample: DeviceSample) -> Alarm | None:
        """Check that the laws of a command do not vibrate or generate energy."""
        assert sample.force is not None
        self._laws = [total - weight for total, weight in zip(sample.force, self._carried)]
        return landing(self._power_guard.check(self._plant.pose, self._laws))

    def _delay(self, sample: DeviceSample) -> Alarm | None:
        """Check the loop delay of the last answer, with the sensor's."""
        plant = self._plant
        delay = max(plant.answers.delay_bound, plant.delay + self.timing.newest_age) + self._sensor_delay
        return landing(self._delay_guard.check(delay))

    def _named(self, sample: DeviceSample) -> Alarm | None:
        """Return an alarm if the observer names a late sensor or a failing coil.

        The device then stops: a hand moves a soft landing further.
        """
        delay, coil = self._plant.sensor_delay, self._plant.failing_coil
        fault = (self._check_sensor(delay, self._controller.device_walls) if delay else "") or coil
        return Alarm(Fault.HOST, fault, removes_walls=True) if fault else None

    def _missing(self) -> tuple[int, int]:
        """Return lost and skipped samples since takeoff."""
        samples = self._plant.samples
        return samples.lost - self._lost, samples.skipped - self._skipped

    def _watch(self) -> bool:
        """Refuse new settings in takeoff and landing; return True if landing is requested."""
        if (request := self._publishers.wanted()) is not None:
            request.reply("settings cannot be changed during takeoff and landing")
        return self.switch.landing

    def _describe(self, scene: Scene, controller: Controller) -> Setup | None:
        """Return the setup of a segment, without the force before it; None without a recording."""
        if self._file is None:
            return None
        values: Any = {"inertia": self._inertia, "load": self._load, "before": ZERO, "name": self._name}
        return session.describe_scene(self._file, scene, self._plant, controller, kind="device", **values)

    def _segment(self, last: int | None) -> None:
        """Fly one segment with unchanged parameters."""
        plant, controller, record = self._plant, self._controller, None
        if self._file is not None and self._setup is not None:
            run = {**self._setup["run"], "before": dict(zip(AXES, self._force, strict=True))}
            record = self._file.begin(plant, controller, {**self._setup, "run": run})
        loop = ControlLoop(plant, controller, observe=self._observe(controller), record=record)
        while self._controller is controller and not self._is_over(last):
            loop.cycle()

    def _is_over(self, last: int | None) -> bool:
        return bool(self.reason) or self.switch.landing or (last is not None and self._plant.samples.tick >= last)

    def _observe(self, controller: Controller) -> Callable[[Sample, Command], object]:
        self._carried, self._faces = controller.carried.tolist(), controller.faces
        plant, timing = self._plant, self.timing

        def observe(sample: Sample, applied: Command) -> None:
            timing.add(plant)
            self._force = applied.force
            plant.check_guards(When.ANSWERED)
            if self._warn is not None and self._file is not None and self._check_due():
                self._check(self._file, self._warn)
            if not self._publishers:
                return
            if self._started is not None:
                self._since = sample.tick
                self._started.reply(sample.tick)
                self._started = None
            force, pose = np.array(self._laws), np.array(sample.position)
            pulse, width = (ZERO, 0.0) if applied.extra is None else (applied.extra, applied.pulse_width)
            self._motion.add(plant.samples.tick * plant.period, pose, force, plant.hand_wrench, pulse, width)
            self._publishers.show(lambda: self._snapshot(pose, force))
            self._listen(sample)

        return observe

    def _check(self, file: RecordingFile, warn: Callable[[str], object]) -> None:
        """Report if the recording has ended."""
        try:
            file.check()
        except RecordingError as error:
            self._warn, self._note = None, str(error)
            warn(self._note)

    def _listen(self, sample: Sample) -> None:
        """Store the delay; check and apply new settings, the newest only."""
        if not math.isnan(self._plant.last_delay):
            self._delays.append(self._plant.last_delay)
        if (newest := self._publishers.wanted()) is not None:
            previous, self._request = self._request, newest
            if previous is not None:
                previous.reply(REPLACED)
            if previous is None or previous.scene != newest.scene:  # a held key repeats its request
                self._steps = self._change(newest.scene)
        if self._request is None:
            return
        self._position = sample.position
        try:
            with session.user_errors_rejected():
                next(self._steps, None)
        except MaglevError as error:
            self._note = str(error)
            self._request.reply(self._note)
            self._request = None

    def _change(self, target: Scene) -> Iterator[None]:
        """Check settings and apply them, one step per sample; sample rate and delay stay the device's."""
        scene, limit, note = session.changed(self._scene, target), self._delay_guard.limit, ""
        if self._checker is not None:
            self._checker.ask(scene, self._inertia, tuple(self._delays))
            while (answer := self._checker.answer()) is None:
                yield
            critical, note = answer
            if critical is None:
                raise ParameterError(note)
            limit = delay_limit(critical, self._plant.period, own=self._plant.delay)
        controller = session.device_controller(scene, self._weight)
        yield  # creating it takes half a period at 1 kHz: check it later
        self._name = f"{scene.name} on a device"  # with the stiffness that was just set
        setup = self._describe(scene, controller)
        yield
        session.check_step(self._controller, controller, self._position, self._step_force)
        known = {(place, wall.axis, wall.side): wall.edge for place, wall in enumerate(self._controller.device_walls)}
        for place, wall in enumerate(self._plant.check_walls(controller.device_walls)):
            edge = known.get((place, wall.axis, wall.side))
            inside = edge is None and wall.side * (self._position[wall.axis] - wall.edge) < 0.0
            if inside or edge not in (None, wall.edge):  # the device would stop
                rule = "must begin clear of the flotor" if inside else "must keep its edge"
                raise ParameterError(f"the wall on {AXES[wall.axis]} {rule} on the device")
        assert self._request is not None
        self._started, self._request = ChangeRequest(scene, self._request.reply), None
        self._scene, self._controller, self._note = scene, controller, note or _NOTE  # of the next segment
        self._device = self._device and self._device._replace(requested=math.nan)  # the stiffness just set is the wish
        self._setup, self._delay_guard.limit = setup, limit

    def _snapshot(self, pose: Array, force: Array) -> Snapshot:
        """Return the current snapshot, with the median of the recent delays."""
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
            faces=self._faces,
            anchors=self._controller.stick_positions,
            history=self._motion.history.rows,
            work=self._motion.work,
            missed=samples.lost + samples.skipped,
            actions=self._actions,
            state="flying",
            device=self._device and self._device._replace(phase="in flight", warmth=max(plant.temperatures)),
            notes=[self._note],
        )
