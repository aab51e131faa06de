"""Recordings made, run again and shown: what a recording's setup says, turned into plant and controller."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from maglev_mj.controller import Controller
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.frames import AXES, Array, Sample
from maglev_mj.hand import HandForce, SpringHand
from maglev_mj.laws import Law
from maglev_mj.loop import ControlLoop
from maglev_mj.model import load
from maglev_mj.parameters import param
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
    setup_of,
)
from maglev_mj.recording.checks import start_in
from maglev_mj.scenes import Scene, find_scene, scene_names
from maglev_mj.scenes.find import reference_of, source_of
from maglev_mj.scenes.legacy import recorded_scene
from maglev_mj.scenes.run import checked_phase, checked_plant, parameters_json
from maglev_mj.scenes.scene import PLANTS
from maglev_mj.session import EMERGENCY_STOP, SampledMotion, Snapshot, device_controller, live_plant

__all__ = ["Replay", "expected", "rebuild", "rebuild_for", "record_run", "stick_positions_of", "write_run"]

_SCENES, _OWN = ("scene", "device"), "own"
_PLANTS = {f"{make.__module__}.{make.__qualname__}": name for name, make in PLANTS.items() if isinstance(make, type)}


class _Unknown(Scene):
    """A recording whose scene is not known here."""

    axis: str = param("axis shown", default="z", choices=AXES)

    def laws(self) -> list[Law]:
        return []


def rebuild(
    setup: Setup, hand: HandForce | None, *, scene: type[Scene] | None = None
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
            live = recorded_scene(setup["scene"], setup["settings"], scene)
            if kind == "device":
                return None, device_controller(live)
            return live_plant(live, hand, **start_in(setup)), live.controller()
        run, plant, phase = _run(setup, scene)
        started: dict[str, Any] = start_in(setup["start"]) if setup.get("start") else {}
        # in pieces as it was recorded: the exact plant rounds otherwise in one
        return run.plant(plant, phase=phase, hand=hand, record=True, **started), run.controller()
    except (KeyError, TypeError, ParameterError) as error:
        raise InvalidRecordingError(f"a recording's setup cannot be made here: {error}") from None


def _run(setup: Setup, scene: type[Scene] | None) -> tuple[Scene, str, float]:
    """Return scene, plant and phase of a run."""
    kind = setup["kind"]
    if kind not in (_OWN, *scene_names()):
        known = ", ".join((*_SCENES, _OWN, *scene_names()))
        raise InvalidRecordingError(f"a recording of kind {kind!r} cannot be made here, which knows {known}")
    values = dict(setup["parameters"])
    if kind == _OWN:
        if scene is None:
            named = setup["scene"]
            raise InvalidRecordingError(f"a recording of one's own needs its scene, {named!r}, to be run again")
        return scene.from_json(values), _PLANTS[setup["plant"]], checked_phase(setup["phase"])
    plant, phase = values.pop("plant", None), values.pop("phase", 0.0)
    run = find_scene(kind).from_json(values)
    return run, checked_plant(run, setup["parameters"]["plant"] if plant is None else plant), checked_phase(phase)


def rebuild_for(stretch: Stretch, scene: type[Scene] | None = None) -> Rebuild | None:
    """Return what makes plant and controller of a stretch again; None where only its scene could.

    A recording never makes this program execute a file that it names: who has the scene gives it.

    Args:
        stretch: The stretch.
        scene: Scene of a recording of one's own.
    """
    kind, names = stretch.setup["kind"], scene_names()
    known = stretch.setup["scene"] in names if kind in _SCENES else kind in names
    return partial(rebuild, scene=scene) if known or scene is not None or stretch.metadata is None else None


def expected(setup: Setup) -> Expected:
    """Return what a recording's setup tells besides plant and controller.

    Raises:
        InvalidRecordingError: If it is no setup that is known here.
    """
    kind = setup["kind"]
    if kind == _OWN:
        return Expected()
    if kind not in _SCENES:
        rebuild(setup, None)  # complains of what is not known here
        run, _, phase = _run(setup, None)
        return Expected(scripted=True, samples=run.ticks(run.timing(phase)))
    metadata: dict[str, Any] = {"hand_recorded": kind == "scene"}
    if kind == "device":  # what it weighs and what acted before a stretch is in the flight, not in the setup
        metadata |= {"delay": setup["settings"]["delay"], "hand_acts_on_flotor": True}
    return Expected(metadata=metadata)


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
    name, phase, cls = checked_plant(scene, plant), checked_phase(phase), type(scene)
    device, controller = scene.plant(name, phase=phase, record=True), scene.controller()
    setup: Setup
    if scene.name in scene_names() and find_scene(scene.name) is cls:
        run = RunMetadata.of(device, controller, name=scene.name, axis=scene.axis)
        setup = {"kind": scene.name, "parameters": parameters_json(scene, name, phase), "run": run.as_json()}
    else:
        own: dict[str, Any] = {"scene": reference_of(cls), "source": source_of(cls), "parameters": scene.as_json()}
        setup = setup_of(device, controller, **own, name=scene.name, axis=scene.axis)
    record = file.begin(device, controller, setup)
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
        scene: Scene of a recording of one's own, which finds where the flotor sticks; it is shown without too.

    Attributes:
        hand: There is none to be moved; the recorded one acts.
        simulated: Time shown so far [s].

    Raises:
        RecordingError: If there is nothing in it, or its setup is not known here.
    """

    def __init__(self, recording: Recording, scene: type[Scene] | None = None) -> None:
        self.hand = SpringHand()
        self.simulated = 0.0
        self._stretches = [_Shown(stretch, scene) for stretch in recording.stretches if len(stretch)]
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
        if action in ("pause", EMERGENCY_STOP):
            self._paused = action == EMERGENCY_STOP or not self._paused
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

    def __init__(self, stretch: Stretch, scene: type[Scene] | None) -> None:
        again = rebuild_for(stretch, scene)
        metadata = metadata_of(stretch, None if again is None else again(stretch.setup, None)[1])
        self.scene = scene_of(stretch.setup, metadata, scene)
        self.time, self.pose, self.hand = stretch.time, stretch.position, stretch.hand
        self.force = stretch.applied - metadata.carried
        coils = load("drop").coils
        assert coils is not None
        self.currents = stretch.applied @ coils.current_per_wrench.T
        self.faces = tuple(metadata.faces or ())
        self.anchors = stick_positions_of(stretch, again)


def scene_of(setup: Setup, metadata: RunMetadata, scene: type[Scene] | None = None) -> Scene:
    """Return the scene that shows a stretch: its own where that is known here.

    Args:
        setup: The setup.
        metadata: What is known of the run in any case.
        scene: Scene of a recording of one's own.
    """
    try:
        if setup["kind"] in _SCENES:
            return recorded_scene(setup["scene"], setup["settings"], scene)
        return _run(setup, scene)[0]
    except (InvalidRecordingError, ParameterError):
        return _Unknown(period=metadata.period, delay=metadata.delay, axis=metadata.axis)


def stick_positions_of(stretch: Stretch, again: Rebuild | None = rebuild) -> Array | None:
    """Return where the flotor stuck at each sample, as the controller saw it, (N, 6); None without friction.

    Args:
        stretch: The stretch.
        again: Makes plant and controller from a setup and a hand; None where nobody can: then it is not known.
    """
    if again is None:
        return None
    _, controller = again(stretch.setup, None)
    anchors = []
    for tick, place in zip(stretch.tick.tolist(), stretch.position.tolist(), strict=True):
        controller.step(Sample(int(tick), 0.0, place))
        found = controller.stick_positions
        if found is None:
            return None
        anchors.append(found)
    return np.array(anchors)
