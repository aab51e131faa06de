"""A scene flown on a device: takeoff, the scene's laws, landing; on the main thread, or behind a window."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from maglev_mj.bridge.realtime import Lateness
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.bridge.shown import Shown
from maglev_mj.controller import Controller
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Command, Sample
from maglev_mj.laws import Friction, Wall
from maglev_mj.loop import Answers, ControlLoop
from maglev_mj.recording import Recorder, Recording
from maglev_mj.scenes import Scene, Settings
from maglev_mj.scenes.parts import WEIGHT
from maglev_mj.session.actions import CHANGES

__all__ = ["Flight", "Flown"]

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


class Flight:
    """A scene flown on a device.

    Args:
        plant: The device; closed by the caller.
        scene: The scene.
        settings: Of its laws; its period is the device's.
        record: Whether to keep every sample.

    Attributes:
        recording: What was kept, up to where it ended, whatever ended it.

    Raises:
        ParameterError: If the settings' period is not the device's.
    """

    def __init__(self, plant: RemotePlant, scene: Scene, settings: Settings, *, record: bool = False) -> None:
        if settings.period != plant.period:
            raise ParameterError(f"period must be the device's {plant.period:g} s, not {settings.period:g}")
        self._plant, self._scene, self._settings, self._record = plant, scene, settings, record
        self._stretches: list[Recorder] = []
        self._stopped = threading.Event()
        self._wanted: Settings | None = None
        self._answer = Lateness()
        self._read_at = 0
        self.shown: Shown | None = None

    @property
    def recording(self) -> Recording:
        """Everything kept so far."""
        return Recording([recorder.stretch() for recorder in self._stretches])

    def run(self, duration: float | None = None) -> Flown:
        """Take off, render the scene until `stop` or for so long [s] of the device's time, and land.

        Raises:
            DeviceFault: If something is wrong with the device, or with how it is flown.
        """
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

    def show(self, live: Callable[[], Any]) -> Shown:
        """Return what a window shows of it.

        Args:
            live: What to run on the device's thread, such as `run`.
        """
        shown = _Flying(self, self._scene, self._settings, live)
        self.shown = shown
        return shown

    def _stretch(self, last: int | None) -> None:
        """Fly with unchanged settings."""
        if self._wanted is not None:
            self._settings, self._wanted = self._wanted, None
        controller = self._scene.controller(self._settings)
        answers: Answers = controller
        if self._record:
            setup = {"kind": "device", "scene": self._scene.name, "settings": self._settings.as_json()}
            setup["calibration"] = self._plant.calibration.digest.hex()
            answers = recorder = Recorder(self._plant, controller, setup)
            self._stretches.append(recorder)
        if self.shown is not None:
            laws = controller.laws
            self.shown.settings = self._settings
            self.shown.faces = tuple(face for law in laws if isinstance(law, Wall) for face in law.faces)
        loop = ControlLoop(self._plant, _Timed(answers, self), observe=self._observe(controller))
        samples = self._plant.samples
        while not self._stopped.is_set() and self._wanted is None and (last is None or samples.tick < last):
            loop.cycle()

    def _observe(self, controller: Controller) -> Callable[[Sample, Command], object]:
        carried = np.array(WEIGHT if self._settings.weightless else (0.0,) * 6)
        friction = next(
            ((place, law.indices) for place, law in enumerate(controller.laws) if isinstance(law, Friction)), None
        )
        recorder = self._stretches[-1] if self._record else None

        def observe(sample: Sample, applied: Command) -> None:
            self._answer.add(time.perf_counter_ns() - self._read_at)
            if recorder is not None:
                recorder.observe(sample, applied)
            shown = self.shown
            if shown is not None:
                shown.anchors = None if friction is None else _anchors(controller, *friction)
                shown.keep(
                    np.array(sample.position),
                    np.array(applied.force) - carried,
                    self._plant.hand_wrench,
                    self._plant.last_currents,
                )

        return observe


class _Timed:
    """Stands in front of a controller and notes when a sample was there."""

    def __init__(self, answers: Answers, flight: Flight) -> None:
        self.period, self._step, self._flight = answers.period, answers.step, flight

    def step(self, sample: Sample) -> Command:
        self._flight._read_at = time.perf_counter_ns()
        return self._step(sample)


class _Flying(Shown):
    """A flight in a window: keys change its laws."""

    def __init__(self, flight: Flight, scene: Scene, settings: Settings, live: Callable[[], Any]) -> None:
        super().__init__(scene, settings, live, flight.stop)
        self._flight = flight
        self.notes = ["the hand is at the device"]

    def act(self, action: str) -> None:
        """Change the laws, as far as that is the host's."""
        self._flight.change(action)


def _anchors(controller: Controller, place: int, indices: tuple[int, ...]) -> np.ndarray[Any, Any] | None:
    """Return where the flotor sticks [m, rad], NaN where it does not."""
    states = controller.states[place]
    if states is None:
        return None
    anchors = np.full(6, np.nan)
    for index, state in zip(indices, states, strict=True):
        anchors[index] = state.anchor if state.stuck else np.nan
    return anchors
