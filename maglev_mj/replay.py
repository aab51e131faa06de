"""Recordings made, run again and shown: what a recording's setup says, turned into plant and controller."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from maglev_mj.controller import Controller
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.experiments.drop import DropParameters, drop_parts
from maglev_mj.experiments.press import PressParameters, press_parts
from maglev_mj.experiments.stick_slip import StickSlipParameters, stick_slip_parts
from maglev_mj.frames import Array, Sample
from maglev_mj.hand import HandForce, SpringHand
from maglev_mj.loop import ControlLoop
from maglev_mj.model import load
from maglev_mj.parameters import number
from maglev_mj.plants import SampledPlant, engine_warnings_silenced
from maglev_mj.recording import (
    ArrayFile,
    Expected,
    InvalidRecordingError,
    Rebuild,
    Recording,
    RecordingError,
    RecordingFile,
    RunMetadata,
    Setup,
    Stretch,
    metadata_of,
    open_recording,
)
from maglev_mj.recording.checks import start_in
from maglev_mj.scenes import SCENES, Scene, Settings, scene_called
from maglev_mj.scenes.scene import PLANTS
from maglev_mj.scenes.scene import Scene as OwnScene
from maglev_mj.session import View, stick_positions

__all__ = [
    "EXPERIMENTS",
    "Replay",
    "expected",
    "rebuild",
    "rebuild_for",
    "record_experiment",
    "scene_of",
    "stick_positions_of",
    "write_experiment",
]

_SHOWN = 2.0
_SCENES = "scene", "device"
_PLANTS = {f"{make.__module__}.{make.__qualname__}": name for name, make in PLANTS.items()}

_Parts: TypeAlias = Callable[[Any, HandForce | None], tuple[SampledPlant, Controller, int]]

EXPERIMENTS: Mapping[str, tuple[type[Any], _Parts, str]] = {
    "drop": (DropParameters, drop_parts, "drop"),
    "press": (PressParameters, press_parts, "press"),
    "stick-slip": (StickSlipParameters, stick_slip_parts, "table"),
}
"""What can be recorded without a window: its parameters, what it is made of, and the scene that shows it."""


def rebuild(
    setup: Setup, hand: HandForce | None, *, scene: type[OwnScene] | None = None
) -> tuple[SampledPlant | None, Controller]:
    """Make plant and controller from a recording's setup.

    Args:
        setup: The setup.
        hand: The hand on the flotor; None for the run's own, if it has one.
        scene: Scene of a recording of one's own.

    Returns:
        Both; None for the plant of a flight on a device.

    Raises:
        InvalidRecordingError: If it is no setup that is known here.
    """
    try:
        kind = setup["kind"]
        if kind in _SCENES:
            shown, settings = scene_called(setup["scene"]), Settings.from_json(setup["settings"])
            if kind == "device":
                return None, shown.controller(settings)
            return shown.plant(settings, hand_force=hand, **start_in(setup)), shown.controller(settings)
        if kind not in EXPERIMENTS:
            known = ", ".join((*_SCENES, *EXPERIMENTS))
            if kind == "own" and scene is not None:
                own = scene.from_json(setup["parameters"])
                plant, phase = _PLANTS[setup["plant"]], number("phase", setup["phase"], at_least=0.0, below=1.0)
                start: dict[str, Any] = {**start_in(setup["start"])}
                return own.plant(plant, phase=phase, hand=hand, **start), own.controller()
            if kind == "own":
                raise InvalidRecordingError(
                    f"a recording of one's own needs its scene, {setup['scene']!r}, to be run again"
                )
            raise InvalidRecordingError(f"a recording of kind {kind!r} cannot be made here, which knows {known}")
        parameters, parts, _ = EXPERIMENTS[kind]
        return parts(parameters(**setup["parameters"]), hand)[:2]
    except (KeyError, TypeError, ParameterError) as error:
        raise InvalidRecordingError(f"a recording's setup cannot be made here: {error}") from None


def rebuild_for(stretch: Stretch, scene: type[OwnScene] | None = None) -> Rebuild | None:
    """Return what makes plant and controller of a stretch again; None where only its scene could.

    A recording never makes this program execute a file that it names: who has the scene gives it.

    Args:
        stretch: The stretch.
        scene: Scene of a recording of one's own.
    """
    known = stretch.setup["kind"] in (*_SCENES, *EXPERIMENTS)
    return partial(rebuild, scene=scene) if known or scene is not None or stretch.metadata is None else None


def expected(setup: Setup) -> Expected:
    """Return what a recording's setup tells besides plant and controller.

    Raises:
        InvalidRecordingError: If it is no setup that is known here.
    """
    kind = setup["kind"]
    if kind == "own":
        return Expected()
    rebuild(setup, None)  # complains of what is not known here
    if kind in EXPERIMENTS:
        made, parts, _ = EXPERIMENTS[kind]
        return Expected(scripted=True, samples=parts(made(**setup["parameters"]), None)[2])
    metadata: dict[str, Any] = {"hand_recorded": kind == "scene"}
    if kind == "device":  # what it weighs and what acted before a stretch is in the flight, not in the setup
        metadata |= {"delay": Settings.from_json(setup["settings"]).delay, "hand_acts_on_flotor": True}
    return Expected(metadata=metadata)


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
    run = RunMetadata.of(plant, controller, name=kind, axis=getattr(parameters, "axis", "z"))
    setup = {"kind": kind, "parameters": asdict(parameters), "run": run.as_json()}
    record = file.begin(plant, controller, setup)
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
        scene: Scene of a recording of one's own, which finds where the flotor sticks; it is shown without too.

    Attributes:
        hand: There is none to be moved; the recorded one acts.
        simulated: Time shown so far [s].

    Raises:
        RecordingError: If there is nothing in it, or its setup is not known here.
    """

    def __init__(self, recording: Recording, scene: type[OwnScene] | None = None) -> None:
        self.hand = SpringHand()
        self.simulated = 0.0
        self._stretches = [
            _Shown(stretch, rebuild_for(stretch, scene)) for stretch in recording.stretches if len(stretch)
        ]
        if not self._stretches:
            raise InvalidRecordingError("there is nothing in the recording")
        self._place, self._owed, self._paused = (0, 0), 0.0, False

    def tick(self, elapsed: float) -> int:
        """Go on by as much as real time has [s]; return how many samples that were."""
        if self._paused:
            return 0
        self._owed += elapsed
        shown = 0
        while self._owed >= self._now.period:
            self._owed -= self._now.period
            self.simulated += self._now.period
            self._next()
            shown += 1
        return shown

    def act(self, action: str) -> None:
        """Pause, or start over for "centre" and "drop"; nothing else can be changed in a recording."""
        if action == "pause":
            self._paused = not self._paused
        elif action in ("centre", "drop"):
            self._place = 0, 0

    def view(self) -> View:
        """Return what there was to see."""
        return self._now.view(self._place[1], "PAUSED" if self._paused else "REPLAY")

    def close(self) -> None:
        """Do nothing: a recording stays as it is."""

    @property
    def _now(self) -> _Shown:
        return self._stretches[self._place[0]]

    def _next(self) -> None:
        stretch, row = self._place
        if row + 1 < len(self._now.pose):
            self._place = stretch, row + 1
        else:
            self._place = (stretch + 1) % len(self._stretches), 0


class _Shown:
    """A stretch of a recording, and what there was to see at each of its samples."""

    def __init__(self, stretch: Stretch, again: Rebuild | None) -> None:
        metadata = metadata_of(stretch, None if again is None else again(stretch.setup, None)[1])
        self.scene, self.settings = scene_of(stretch.setup, metadata)
        self.period, self.pose = self.settings.period, stretch.position
        self._time, self._hand = stretch.time, stretch.hand
        self._force = stretch.applied - metadata.carried
        coils = load("drop").coils
        assert coils is not None
        self._currents = stretch.applied @ coils.current_per_wrench.T
        way = np.diff(stretch.position, axis=0, prepend=stretch.position[:1])
        self._work = np.cumsum((np.roll(stretch.hand, 1, axis=0) * way).sum(axis=1))
        self._faces = tuple(metadata.faces or ())
        self._anchors = stick_positions_of(stretch, again)
        axis = self.scene.axis_index
        place = stretch.position[:, axis]
        speed = np.diff(place, prepend=place[0]) / self.period
        self._rows = np.column_stack([stretch.time, place, speed, self._force[:, axis], stretch.hand[:, axis]])

    def view(self, row: int, note: str) -> View:
        """Return what there was to see at a sample."""
        first = max(row - round(_SHOWN / self.period), 0)
        return View(
            scene=self.scene,
            settings=self.settings,
            time=float(self._time[row]),
            pose=self.pose[row],
            force=self._force[row],
            hand=self._hand[row],
            currents=self._currents[row],
            faces=self._faces,
            anchors=None if self._anchors is None else self._anchors[row],
            history=self._rows[first : row + 1],
            work=float(self._work[row]),
            taken=float("nan"),
            cost=0.0,
            missed=0,
            notes=(note,),
        )


def scene_of(setup: Setup, metadata: RunMetadata) -> tuple[Scene, Settings]:
    """Return the scene that shows a stretch, and its settings."""
    if setup["kind"] not in (*_SCENES, *EXPERIMENTS):
        shown = replace(scene_called("joystick"), says=metadata.name, axis=metadata.axis, make=lambda settings: ())
        return shown, replace(shown.settings, wall=False, period=metadata.period, delay=metadata.delay)
    rebuild(setup, None)  # complains of what is not known here
    if setup["kind"] in _SCENES:
        return scene_called(setup["scene"]), Settings.from_json(setup["settings"])
    parameters, _, name = EXPERIMENTS[setup["kind"]]
    made = parameters(**setup["parameters"])
    scene = SCENES[name]
    gains = {name: getattr(made, name) for name in ("stiffness", "damping", "period", "delay")}
    return scene, replace(scene.settings, pulse=getattr(made, "pulse", 0.0) > 0.0, **gains)


def stick_positions_of(stretch: Stretch, again: Rebuild | None = rebuild) -> Array | None:
    """Return where the flotor stuck at each sample, as the controller saw it, (N, 6); None without friction.

    Args:
        stretch: The stretch.
        again: Makes plant and controller from a setup and a hand; None where nobody can: then it is not known.
    """
    if again is None:
        return None
    _, controller = again(stretch.setup, None)
    stuck_at, anchors = stick_positions(controller), []
    for tick, place in zip(stretch.tick.tolist(), stretch.position.tolist(), strict=True):
        controller.step(Sample(int(tick), 0.0, place))
        found = stuck_at()
        if found is None:
            return None
        anchors.append(found)
    return np.array(anchors)
