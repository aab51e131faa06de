"""A scene flown on a device: takeoff, the scene's laws, landing."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from statistics import median
from typing import NamedTuple

import numpy as np

from maglev_mj.bridge.realtime import LatencyHistogram
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.controller import Controller
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.frames import Array, Command, Sample
from maglev_mj.loop import Answers, ControlLoop, Record
from maglev_mj.parameters import number
from maglev_mj.recording import Mechanics, RecordingError, RecordingFile, RunMetadata
from maglev_mj.scenes import Scene
from maglev_mj.scenes.parts import WEIGHT
from maglev_mj.session import (
    DEVICES_OWN,
    STEP_FORCE,
    Publisher,
    Publishers,
    SampledMotion,
    Snapshot,
    Wish,
    check_step,
    device_controller,
    settings_of,
)

__all__ = ["Flight", "FlightReport"]

_USUAL = 100
"""Answers whose median is the usual delay: one early or late answer makes no loop stable or unstable."""

_NOTE = "the hand, the rate and the delay are the device's"


class FlightReport(NamedTuple):
    """What a flight came to.

    Attributes:
        ticks: Samples answered.
        lost: Samples that did not arrive.
        skipped: Samples that were too old when they were read.
        wall_time: How long it took [s].
        answer: Time from reading a sample to having sent its answer [s].
    """

    ticks: int
    lost: int
    skipped: int
    wall_time: float
    answer: LatencyHistogram


class Flight:
    """A scene flown on a device.

    Args:
        plant: The device; closed by the caller.
        scene: The scene; its period is the device's.
        file: What every sample is recorded to; left open.
        publishers: Windows on it and ways to other programs; left open.
        warn: Called, once, with why the flight is not recorded any more.
        step_force: Largest step of force that new settings may make [N]; see `check_step`.

    Attributes:
        read_at: When the last sample was there [ns].

    Raises:
        ParameterError: If the scene's period is not the device's.
    """

    def __init__(
        self,
        plant: RemotePlant,
        scene: Scene,
        *,
        file: RecordingFile | None = None,
        publishers: Sequence[Publisher] = (),
        warn: Callable[[str], object] | None = None,
        step_force: float = STEP_FORCE,
    ) -> None:
        if scene.period != plant.period:
            raise ParameterError(f"period must be the device's {plant.period:g} s, not {scene.period:g}")
        self._plant, self._scene, self._file = plant, scene, file
        self._publishers, self._since = Publishers(publishers), 0
        self._motion, self._note = SampledMotion(scene.axis_index), _NOTE
        self._stopped = threading.Event()
        self._staged: tuple[Wish, Controller] | None = None
        self._wanted: tuple[Wish, Controller] | None = None
        self._begun: Wish | None = Wish(scene)
        self._controller = device_controller(scene)
        self._step_force = number("step_force", step_force, above=0.0)
        self._inertia = [*[plant.calibration.mass] * 3, *plant.calibration.inertia]
        self._answer = LatencyHistogram()
        self._force: Sequence[float] = WEIGHT
        self._delays: deque[float] = deque(maxlen=_USUAL)
        self._warn, self._checked = warn, 0.0
        self.read_at = 0

    def run(self, duration: float | None = None) -> FlightReport:
        """Take off, render the scene until `stop` or for so long [s] of the device's time, and land.

        Raises:
            DeviceFault: If something is wrong with the device, or with how it is flown.
        """
        try:
            return self._run(duration)
        except MaglevError as error:
            if self._file is not None:
                self._file.event("fault", str(error))
            raise

    def _run(self, duration: float | None) -> FlightReport:
        start, plant = time.monotonic(), self._plant
        plant.takeoff()
        first = plant.samples.tick
        last = None if duration is None else first + round(duration / plant.period)
        while not self._stopped.is_set() and (last is None or plant.samples.tick < last):
            self._stretch(last)
        ticks = plant.samples.tick - first
        plant.land()
        samples = plant.samples
        return FlightReport(ticks, samples.lost, samples.skipped, time.monotonic() - start, self._answer)

    def stop(self) -> None:
        """Let `run` land; from any thread."""
        self._stopped.set()

    def _stretch(self, last: int | None) -> None:
        """Fly with unchanged parameters."""
        if self._wanted is not None:
            (self._begun, self._controller), self._wanted = self._wanted, None
            self._scene = self._begun.scene
        controller = self._controller
        record: Record | None = None
        if self._file is not None:
            scene = self._scene
            setup = {**settings_of(scene, "device"), "calibration": self._plant.calibration.digest.hex()}
            name, mechanics = f"{scene.name} on a device", Mechanics(before=self._force)
            run = RunMetadata.of(self._plant, controller, name=name, axis=scene.axis, mechanics=mechanics)
            record = self._file.begin(self._plant, controller, {**setup, "run": run.as_json()})
        loop = ControlLoop(self._plant, _Timed(controller, self), observe=self._observe(controller), record=record)
        samples = self._plant.samples
        while not self._stopped.is_set() and self._wanted is None and (last is None or samples.tick < last):
            loop.cycle()

    def _observe(self, controller: Controller) -> Callable[[Sample, Command], object]:
        carried, faces = controller.carried, controller.faces

        def observe(sample: Sample, applied: Command) -> None:
            self._answer.add(time.perf_counter_ns() - self.read_at)
            self._force = applied.force
            if self._warn is not None and self._file is not None:
                self._check(self._file, self._warn)
            if not self._publishers:
                return
            if self._begun is not None:
                self._since = sample.tick
                self._begun.answer(sample.tick)
                self._begun = None
            plant, force, pose = self._plant, np.array(applied.force) - carried, np.array(sample.position)
            self._motion.add(plant.samples.tick * plant.period, pose, force, plant.hand_wrench)
            self._publishers.show(lambda: self._snapshot(pose, force, faces, controller.stick_positions))
            self._listen(sample)

        return observe

    def _check(self, file: RecordingFile, warn: Callable[[str], object]) -> None:
        """Once a second, say so if the recording has ended."""
        now = time.monotonic()
        if now < self._checked:
            return
        self._checked = now + 1.0
        try:
            file.check()
        except RecordingError as error:
            self._warn, self._note = None, str(error)
            warn(self._note)

    def _listen(self, sample: Sample) -> None:
        """Note how late answers are, and what another program asks for; rate and delay are the device's."""
        if not math.isnan(self._plant.last_delay):
            self._delays.append(self._plant.last_delay)
        wish, controller = self._staged or (self._publishers.wanted(), None)
        if wish is None:
            return
        self._staged = None
        try:
            if controller is None:  # making one takes half of a period at 1 kHz: it is looked at a sample later
                scene = wish.scene.replace(**{name: getattr(self._scene, name) for name in DEVICES_OWN})
                self._staged = Wish(scene, wish.answer), device_controller(scene)
                return
            check_step(self._controller, controller, sample.position, self._step_force)
        except MaglevError as error:
            self._note = str(error)
            wish.answer(self._note)
        else:
            self._wanted, self._note = (wish, controller), _NOTE

    def _snapshot(
        self, pose: Array, force: Array, faces: Sequence[tuple[int, float, float]], anchors: Array | None
    ) -> Snapshot:
        """Return the picture of now; the delay is the usual one of late."""
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
            currents=np.array(plant.last_currents),
            faces=faces,
            anchors=anchors,
            history=self._motion.history.rows,
            work=self._motion.work,
            missed=samples.lost + samples.skipped,
            state="flying",
            notes=[self._note],
        )


class _Timed:
    """Stands in front of a controller and notes when a sample was there."""

    def __init__(self, answers: Answers, flight: Flight) -> None:
        self.period, self._step, self._flight = answers.period, answers.step, flight

    def step(self, sample: Sample) -> Command:
        self._flight.read_at = time.perf_counter_ns()
        return self._step(sample)
