"""Recordings made, run again and shown: what a recording's setup says, turned into plant and controller."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from maglev_mj.analysis.known import known_experiment
from maglev_mj.controller import Controller
from maglev_mj.errors import MaglevError, ParameterError
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
    open_recording,
)
from maglev_mj.recording.checks import start_in
from maglev_mj.scenes import Scene, find_scene, scene_names
from maglev_mj.scenes.legacy import recorded_scene
from maglev_mj.scenes.run import checked_phase, checked_plant, parameters_json
from maglev_mj.session import SampledMotion, Snapshot, device_controller, live_plant, mechanics

__all__ = ["Replay", "expected", "rebuild", "record_run", "scene_of", "stick_positions_of", "write_run"]

_SCENES = "scene", "device"


def run_in(setup: Setup) -> tuple[Scene, str, float]:
    """Return scene, plant and phase of a recorded run."""
    values = dict(setup["parameters"])
    plant, phase = values.pop("plant"), values.pop("phase", 0.0)
    scene = find_scene(setup["kind"]).from_json(values)
    return scene, checked_plant(scene, plant), checked_phase(phase)


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
        if kind not in scene_names():
            known = ", ".join((*_SCENES, *scene_names()))
            raise InvalidRecordingError(f"a recording of kind {kind!r} cannot be made here, which knows {known}")
        run, plant, phase = run_in(setup)
        return run.plant(plant, phase=phase, hand=hand, record=True), run.controller()
    except (KeyError, TypeError, ParameterError) as error:
        raise InvalidRecordingError(f"a recording's setup cannot be made here: {error}") from None


def expected(setup: Setup) -> Expected:
    """Return what a recording's setup tells besides plant and controller.

    Raises:
        InvalidRecordingError: If it is no setup that is known here.
    """
    rebuild(setup, None)  # complains of what is not known here
    kind = setup["kind"]
    if kind not in _SCENES:
        run, _, phase = run_in(setup)
        known, samples = known_experiment(kind, run.as_json()), run.ticks(run.timing(phase))
        load = [0.0, 0.0, known.weight, 0.0, 0.0, 0.0]
        masses = Mechanics(inertia=known.inertia, load=load, before=known.before)
        return Expected(known.delay, masses, scripted=True, samples=samples)
    scene = recorded_scene(setup["scene"], setup["settings"])
    # on a device, what acted before a stretch is in the flight, not in the setup
    return Expected(scene.delay, mechanics(scene, setup["wrench"]) if kind == "scene" else None, scripted=False)


def record_run(scene: Scene, *, plant: str | None = None, phase: float = 0.0) -> Recording:
    """Run a scene and record it in memory; where it fails, up to there.

    Args:
        scene: The scene.
        plant: Name of a plant; the scene's usual one by default.
        phase: Of the samples, in [0, 1).
    """
    file = ArrayFile()
    _run_into(file, scene, plant, phase)
    return file.recording


def write_run(path: Path, scene: Scene, *, plant: str | None = None, phase: float = 0.0) -> list[Path]:
    """Run a scene and record it to a file, of .mcap or .npz; where it fails, up to there.

    Args:
        path: The file.
        scene: The scene.
        plant: Name of a plant; the scene's usual one by default.
        phase: Of the samples, in [0, 1).

    Returns:
        The file that was written, which is elsewhere where its own folder did not take it; none without a sample.

    Raises:
        ParameterError: If the file is of neither kind.
        RecordingError: If it could not be written as a whole.
        OSError: If it could not be written at all.
    """
    file = open_recording(path, wait=True)
    try:
        _run_into(file, scene, plant, phase)
    finally:
        written = file.close()
    return [] if written is None else [written]


def _run_into(file: RecordingFile, scene: Scene, plant: str | None, phase: float) -> None:
    name, phase = checked_plant(scene, plant), checked_phase(phase)
    device, controller = scene.plant(name, phase=phase, record=True), scene.controller()
    setup = {"kind": scene.name, "parameters": parameters_json(scene, name, phase)}
    record = file.begin(device, controller, setup, delay=scene.delay, mechanics=expected(setup).mechanics)
    with device, engine_warnings_silenced():
        try:
            ControlLoop(device, controller, record=record).cycle(scene.ticks(scene.timing(phase)))
        except RecordingError:
            raise
        except MaglevError as error:  # the run itself says what happened
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
        self.force = stretch.applied - controller.carried
        coils = load("drop").coils
        assert coils is not None
        self.currents = stretch.applied @ coils.current_per_wrench.T
        self.faces = controller.faces
        self.anchors = stick_positions_of(stretch)


def scene_of(setup: Setup) -> Scene:
    """Return the scene that shows a stretch."""
    rebuild(setup, None)  # complains of what is not known here
    if setup["kind"] in _SCENES:
        return recorded_scene(setup["scene"], setup["settings"])
    return run_in(setup)[0]


def stick_positions_of(stretch: Stretch) -> Array | None:
    """Return where the flotor stuck at each sample, as the controller saw it, (N, 6); None without friction."""
    _, controller = rebuild(stretch.setup, None)
    anchors = []
    for tick, place in zip(stretch.tick.tolist(), stretch.position.tolist(), strict=True):
        controller.step(Sample(int(tick), 0.0, place))
        found = controller.stick_positions
        if found is None:
            return None
        anchors.append(found)
    return np.array(anchors)
