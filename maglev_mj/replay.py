"""Recordings made, run again and shown: what a recording's setup says, turned into plant and controller."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from maglev_mj.analysis.known import known_experiment
from maglev_mj.controller import Controller
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.experiments.drop import DropParameters, drop_parts
from maglev_mj.experiments.press import PressParameters, press_parts
from maglev_mj.experiments.stick_slip import StickSlipParameters, stick_slip_parts
from maglev_mj.frames import Array, Sample
from maglev_mj.hand import HandForce, SpringHand
from maglev_mj.loop import ControlLoop
from maglev_mj.model import load
from maglev_mj.plants import SampledPlant, engine_warnings_silenced
from maglev_mj.recording import (
    ArrayFile,
    Expected,
    InvalidRecordingError,
    Mechanics,
    Recording,
    RecordingError,
    RecordingFile,
    Setup,
    Stretch,
    carried_by,
    open_recording,
)
from maglev_mj.recording.fields import start_in
from maglev_mj.scenes import Scene, find_scene
from maglev_mj.scenes.legacy import recorded_scene
from maglev_mj.session import (
    SampledMotion,
    Snapshot,
    device_controller,
    live_plant,
    mechanics,
    stick_positions,
    wall_faces,
)

__all__ = [
    "EXPERIMENTS",
    "Replay",
    "expected",
    "rebuild",
    "record_experiment",
    "scene_of",
    "stick_positions_of",
    "write_experiment",
]

_SCENES = "scene", "device"

_Parts: TypeAlias = Callable[[Any, HandForce | None], tuple[SampledPlant, Controller, int]]

EXPERIMENTS: Mapping[str, tuple[type[Any], _Parts, str]] = {
    "drop": (DropParameters, drop_parts, "drop"),
    "press": (PressParameters, press_parts, "press"),
    "stick-slip": (StickSlipParameters, stick_slip_parts, "table"),
}
"""What can be recorded without a window: its parameters, what it is made of, and the scene that shows it."""


def rebuild(setup: Setup, hand: HandForce | None) -> tuple[SampledPlant | None, Controller]:
    """Make plant and controller from a recording's setup.

    Args:
        setup: The setup.
        hand: The hand on the flotor; None for the run's own, if it has one.

    Returns:
        Both; None for the plant of a flight on a device.

    Raises:
        InvalidRecordingError: If it is no setup that is known here.
    """
    try:
        kind = setup["kind"]
        if kind in _SCENES:
            scene = recorded_scene(setup["scene"], setup["settings"])
            if kind == "device":
                return None, device_controller(scene)
            return live_plant(scene, hand, **start_in(setup)), scene.controller()
        if kind not in EXPERIMENTS:
            known = ", ".join((*_SCENES, *EXPERIMENTS))
            raise InvalidRecordingError(f"a recording of kind {kind!r} cannot be made here, which knows {known}")
        parameters, parts, _ = EXPERIMENTS[kind]
        plant, controller, _ = parts(parameters(**setup["parameters"]), hand)
        return plant, controller
    except (KeyError, TypeError, ParameterError) as error:
        raise InvalidRecordingError(f"a recording's setup cannot be made here: {error}") from None


def expected(setup: Setup) -> Expected:
    """Return what a recording's setup tells besides plant and controller.

    Raises:
        InvalidRecordingError: If it is no setup that is known here.
    """
    rebuild(setup, None)  # complains of what is not known here
    kind = setup["kind"]
    if kind in EXPERIMENTS:
        made, parts, _ = EXPERIMENTS[kind]
        parameters = made(**setup["parameters"])
        known, (_, _, samples) = known_experiment(kind, asdict(parameters)), parts(parameters, None)
        load = [0.0, 0.0, known.weight, 0.0, 0.0, 0.0]
        masses = Mechanics(inertia=known.inertia, load=load, before=known.before)
        return Expected(known.delay, masses, scripted=True, samples=samples)
    scene = recorded_scene(setup["scene"], setup["settings"])
    # on a device, what acted before a stretch is in the flight, not in the setup
    return Expected(scene.delay, mechanics(scene, setup["wrench"]) if kind == "scene" else None, scripted=False)


def record_experiment(kind: str, parameters: Any) -> Recording:
    """Run an experiment and record it in memory; where it fails, up to there.

    Args:
        kind: One of EXPERIMENTS.
        parameters: Its parameters.
    """
    file = ArrayFile()
    _run_into(file, kind, parameters)
    return file.recording


def write_experiment(path: Path, kind: str, parameters: Any) -> list[Path]:
    """Run an experiment and record it to a file, of .mcap or .npz; where it fails, up to there.

    Returns:
        The file that was written, which is elsewhere where its own folder did not take it; none without a sample.

    Raises:
        ParameterError: If the file is of neither kind.
        RecordingError: If it could not be written as a whole.
        OSError: If it could not be written at all.
    """
    file = open_recording(path, wait=True)
    try:
        _run_into(file, kind, parameters)
    finally:
        written = file.close()
    return [] if written is None else [written]


def _run_into(file: RecordingFile, kind: str, parameters: Any) -> None:
    _, parts, _ = EXPERIMENTS[kind]
    plant, controller, ticks = parts(parameters, None)
    setup = {"kind": kind, "parameters": asdict(parameters)}
    record = file.begin(plant, controller, setup, delay=parameters.delay, mechanics=expected(setup).mechanics)
    with plant, engine_warnings_silenced():
        try:
            ControlLoop(plant, controller, record=record).cycle(ticks)
        except RecordingError:
            raise
        except MaglevError as error:  # the experiment itself says what happened
            file.event("fault", str(error))


class Replay:
    """A recording to be shown in real time, over and over.

    Args:
        recording: The recording, of at least one sample.

    Attributes:
        hand: There is none to be moved; the recorded one acts.
        simulated: Time shown so far [s].

    Raises:
        RecordingError: If there is nothing in it, or its setup is not known here.
    """

    def __init__(self, recording: Recording) -> None:
        self.hand = SpringHand()
        self.simulated = 0.0
        self._stretches = [_Shown(stretch) for stretch in recording.stretches if len(stretch.tick)]
        if not self._stretches:
            raise InvalidRecordingError("there is nothing in the recording")
        self._owed, self._paused = 0.0, False
        self._show(0, 0)

    def tick(self, elapsed: float) -> int:
        """Go on by as much as real time has [s]; return how many samples that were."""
        if self._paused:
            return 0
        self._owed += elapsed
        shown = 0
        while self._owed >= (period := self._now.scene.period):
            self._owed -= period
            self.simulated += period
            self._next()
            shown += 1
        return shown

    def act(self, action: str) -> None:
        """Pause, or start over for "centre" and "drop"; nothing else can be changed in a recording."""
        if action == "pause":
            self._paused = not self._paused
        elif action in ("centre", "drop"):
            self._show(0, 0)

    def snapshot(self) -> Snapshot:
        """Return the picture of now."""
        (_, row), now, motion = self._place, self._now, self._motion
        return Snapshot(
            scene=now.scene,
            delay=now.scene.delay,
            tick=row,
            time=float(now.time[row]),
            pose=now.pose[row],
            force=now.force[row],
            hand=now.hand[row],
            currents=now.currents[row],
            faces=now.faces,
            anchors=None if now.anchors is None else now.anchors[row],
            history=motion.history.rows,
            work=motion.work,
            notes=("PAUSED" if self._paused else "REPLAY",),
        )

    def close(self) -> None:
        """Do nothing: a recording stays as it is."""

    @property
    def _now(self) -> _Shown:
        return self._stretches[self._place[0]]

    def _next(self) -> None:
        stretch, row = self._place
        if row + 1 < len(self._now.pose):
            self._show(stretch, row + 1)
        else:
            self._show((stretch + 1) % len(self._stretches), 0)

    def _show(self, stretch: int, row: int) -> None:
        """Go to a sample; a stretch begins with a history of its own."""
        self._place, now = (stretch, row), self._stretches[stretch]
        if row == 0:
            self._motion = SampledMotion(now.scene.axis_index)
        self._motion.add(float(now.time[row]), now.pose[row], now.force[row], now.hand[row])


class _Shown:
    """A stretch of a recording with what its setup tells of it."""

    def __init__(self, stretch: Stretch) -> None:
        self.scene = scene_of(stretch.setup)
        self.time, self.pose, self.hand = stretch.time, stretch.position, stretch.hand
        _, controller = rebuild(stretch.setup, None)
        self.force = stretch.applied[:, :6] - carried_by(controller.laws)
        coils = load("drop").coils
        assert coils is not None
        self.currents = stretch.applied[:, :6] @ coils.current_per_wrench.T
        self.faces = wall_faces(controller.laws)
        self.anchors = stick_positions_of(stretch)


def scene_of(setup: Setup) -> Scene:
    """Return the scene that shows a stretch."""
    rebuild(setup, None)  # complains of what is not known here
    if setup["kind"] in _SCENES:
        return recorded_scene(setup["scene"], setup["settings"])
    values = {name: value for name, value in setup["parameters"].items() if name not in ("plant", "phase")}
    return find_scene(setup["kind"]).from_json(values)


def stick_positions_of(stretch: Stretch) -> Array | None:
    """Return where the flotor stuck at each sample, as the controller saw it, (N, 6); None without friction."""
    _, controller = rebuild(stretch.setup, None)
    stuck_at, anchors = stick_positions(controller), []
    for tick, place in zip(stretch.tick.tolist(), stretch.position.tolist(), strict=True):
        controller.step(Sample(int(tick), 0.0, place))
        found = stuck_at()
        if found is None:
            return None
        anchors.append(found)
    return np.array(anchors)
