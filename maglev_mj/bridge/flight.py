"""A scene flown on a device: takeoff, the scene's laws, landing."""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from statistics import median
from typing import Any, NamedTuple, Protocol

import numpy as np

from maglev_mj.bridge.realtime import Lateness
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.controller import Controller
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.frames import Array, Command, Sample
from maglev_mj.loop import Answers, ControlLoop, Record
from maglev_mj.recording import Mechanics, RecordingError, RecordingFile, RunMetadata, carried_by, wall_faces
from maglev_mj.scenes import Scene, Settings
from maglev_mj.scenes.parts import WEIGHT
from maglev_mj.session import Moment, Outlet, Outlets, stick_positions
from maglev_mj.session.actions import CHANGES

__all__ = ["Flight", "Flown", "Watcher"]

_USUAL = 100
"""Answers whose median is the usual delay: one early or late answer makes no loop stable or unstable."""

_FIXED = ("rate up", "rate down", "delay up", "delay down")
"""What the device decides."""


class Flown(NamedTuple):
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
    answer: Lateness


class Watcher(Protocol):
    """What a flight asks of a window on it."""

    settings: Settings
    faces: Sequence[tuple[int, float, float]]
    closed: bool

    def keep(
        self,
        pose: Array,
        force: Array,
        effort: Sequence[float],
        currents: Sequence[float],
        anchors: Array | None = None,
    ) -> None:
        """Show a sample."""

    def poll(self) -> Sequence[str]:
        """Return which actions keys asked for."""


class Flight:
    """A scene flown on a device.

    Args:
        plant: The device; closed by the caller.
        scene: The scene.
        settings: Of its laws; its period is the device's.
        file: What every sample is recorded to; left open.
        watch: A window on it.
        outlets: Ways to other programs; left open.
        warn: Called, once, with why the flight is not recorded any more.

    Attributes:
        read_at: When the last sample was there [ns].

    Raises:
        ParameterError: If the settings' period is not the device's.
    """

    def __init__(
        self,
        plant: RemotePlant,
        scene: Scene,
        settings: Settings,
        *,
        file: RecordingFile | None = None,
        watch: Watcher | None = None,
        outlets: Sequence[Outlet] = (),
        warn: Callable[[str], object] | None = None,
    ) -> None:
        if settings.period != plant.period:
            raise ParameterError(f"period must be the device's {plant.period:g} s, not {settings.period:g}")
        self._plant, self._scene, self._settings, self._file = plant, scene, settings, file
        self._watch, self._outlets, self._since = watch, Outlets(outlets), 0
        self._stopped = threading.Event()
        self._wanted: Settings | None = None
        self._answer = Lateness()
        self._force: Sequence[float] = WEIGHT
        self._delays: deque[float] = deque(maxlen=_USUAL)
        self._warn, self._checked = warn, 0.0
        self.read_at = 0

    def run(self, duration: float | None = None) -> Flown:
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

    def _run(self, duration: float | None) -> Flown:
        start, plant = time.monotonic(), self._plant
        plant.takeoff()
        first = plant.samples.tick
        last = None if duration is None else first + round(duration / plant.period)
        while not self._stopped.is_set() and (last is None or plant.samples.tick < last):
            self._stretch(last)
        ticks = plant.samples.tick - first
        plant.land()
        samples = plant.samples
        return Flown(ticks, samples.lost, samples.skipped, time.monotonic() - start, self._answer)

    def stop(self) -> None:
        """Let `run` land; from any thread."""
        self._stopped.set()

    def change(self, action: str) -> None:
        """Do what a key asks for, at the next sample; rate and delay are the device's."""
        if action in CHANGES and action not in _FIXED:
            self._wanted = CHANGES[action](self._wanted or self._settings)

    def _stretch(self, last: int | None) -> None:
        """Fly with unchanged settings."""
        if self._wanted is not None:
            self._settings, self._wanted = self._wanted, None
        self._since = self._plant.samples.tick
        controller = self._scene.controller(self._settings)
        record: Record | None = None
        if self._file is not None:
            setup: dict[str, Any] = {"kind": "device", "scene": self._scene.name, "settings": self._settings.as_json()}
            setup["calibration"] = self._plant.calibration.digest.hex()
            name, mechanics = f"{self._scene.name} on a device", Mechanics(before=self._force)
            run = RunMetadata.of(self._plant, controller, name=name, axis=self._scene.axis, mechanics=mechanics)
            record = self._file.begin(self._plant, controller, {**setup, "run": run.as_json()})
        if self._watch is not None:
            self._watch.settings = self._settings
            self._watch.faces = wall_faces(controller.laws)
        loop = ControlLoop(self._plant, _Timed(controller, self), observe=self._observe(controller), record=record)
        samples = self._plant.samples
        while not self._stopped.is_set() and self._wanted is None and (last is None or samples.tick < last):
            loop.cycle()

    def _observe(self, controller: Controller) -> Callable[[Sample, Command], object]:
        carried = carried_by(controller.laws)
        anchors = stick_positions(controller)

        def observe(sample: Sample, applied: Command) -> None:
            self._answer.add(time.perf_counter_ns() - self.read_at)
            self._force = applied.force
            if self._warn is not None and self._file is not None:
                self._check(self._file, self._warn)
            if self._watch is not None:
                self._look(self._watch, sample, np.array(applied.force) - carried, anchors())
            if self._outlets:
                self._outlets.show(lambda: self._moment(sample, np.array(applied.force) - carried, anchors()))
                self._listen()

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
            self._warn = None
            warn(str(error))

    def _listen(self) -> None:
        """Note how late answers are, and what another program asks for; rate and delay are the device's."""
        if not math.isnan(self._plant.last_delay):
            self._delays.append(self._plant.last_delay)
        wanted = self._outlets.wanted() if self._wanted is None else None
        if wanted is not None:
            self._wanted = replace(wanted, period=self._settings.period, delay=self._settings.delay)

    def _moment(self, sample: Sample, force: Array, anchors: Array | None) -> Moment:
        """Return what other programs are told; the delay is the usual one of late."""
        plant, samples = self._plant, self._plant.samples
        return Moment(
            scene=self._scene,
            settings=self._settings,
            since=self._since,
            delay=median(self._delays or [plant.delay]),
            tick=samples.tick,
            time=float(samples.tick * plant.period),
            pose=list(sample.position),
            force=force.tolist(),
            hand=plant.hand_wrench,
            anchors=anchors,
            state="flying",
            missed=samples.lost + samples.skipped,
        )

    def _look(self, watch: Watcher, sample: Sample, force: Array, anchors: Array | None) -> None:
        """Show a sample, and do what the window asks for."""
        plant = self._plant
        watch.keep(np.array(sample.position), force, plant.hand_wrench, plant.last_currents, anchors)
        for action in watch.poll():
            self.change(action)
        if watch.closed:
            self.stop()


class _Timed:
    """Stands in front of a controller and notes when a sample was there."""

    def __init__(self, answers: Answers, flight: Flight) -> None:
        self.period, self._step, self._flight = answers.period, answers.step, flight

    def step(self, sample: Sample) -> Command:
        self._flight.read_at = time.perf_counter_ns()
        return self._step(sample)
