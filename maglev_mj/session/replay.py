"""Recorded runs, rebuilt plants and controllers, and playback of recordings."""

from __future__ import annotations

import re
import sys
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from functools import cache, partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from maglev_mj.control import Law
from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import Record
from maglev_mj.device import Device
from maglev_mj.errors import MaglevError, ParameterError, choice_message
from maglev_mj.files import read_text, temporary_folder
from maglev_mj.frames import AXES, Array, Sample
from maglev_mj.keywords import checked
from maglev_mj.parameters import number, param
from maglev_mj.plants import SampledPlant
from maglev_mj.plants.coils import CoilMap
from maglev_mj.plants.hand import HandForce, SpringHand
from maglev_mj.plants.trace import hand_work
from maglev_mj.recording import (
    InvalidRecordingError,
    MemoryFile,
    Rebuild,
    Recording,
    RecordingError,
    RecordingFile,
    Segment,
    Setup,
    UserCodeError,
    open_recording,
)
from maglev_mj.recording.sample import RunMetadata, check_setup, value_in
from maglev_mj.recording.setup import ALLOW_HINT, MEASURED, rebuild_controller, rebuild_plant, refused
from maglev_mj.scenes import BUILT_IN, Scene, find_scene, scene_names
from maglev_mj.scenes.find import SceneLike, defined_in, hashes_of_laws, object_of_text, recorded_scene, text_of
from maglev_mj.scenes.run import Begin, checked_phase, run
from maglev_mj.session import SHOWN, TIME_SCALES, Snapshot, begin_scene, device_controller, next_scale
from maglev_mj.versions import hash_of

ATTACHED = "attached"
"""Value of `--scene` that selects the sources stored in the recording."""

_INVALID = KeyError, TypeError, ParameterError
_CHUNK = 1000
"""Number of samples converted at a time."""


class _Unknown(Scene):
    """Placeholder for a scene that is not available."""

    axis: str = param("axis shown", default="z", choices=AXES)

    def laws(self) -> list[Law]:
        return []


class UserCode:
    """User code that may be executed for a recording.

    Args:
        text: NAME of a scene, FILE.py or FILE.py:CLASS, or `ATTACHED` for the code in the recording. A file is
            executed as a module.
        recording: The recording.

    Attributes:
        scene: The scene of the recording, if it has one.
        changed: True if the code differs from the recorded code.

    Raises:
        ParameterError: If there is no such scene or file, or the recording does not contain it.
    """

    def __init__(self, text: str, recording: Recording) -> None:
        self._attached = recording.attachments if text == ATTACHED else None
        setups = [segment.setup for segment in recording.segments]
        sources = [(setup.get("scene"), setup.get("source")) for setup in setups]
        named = {(scene, source) for scene, source in sources if isinstance(scene, str) and isinstance(source, str)}
        hashes, self._text, self._file = {source for _, source in named}, "", text
        for setup in setups:
            hashes |= {str(part["class"]).rpartition("@")[2] for part in _own_parts(setup)}
        codes = {code for setup in setups for part in _own_parts(setup) if isinstance(code := part.get("code"), str)}
        self.scene: type[Scene] | None = None
        if self._attached is not None:
            self.changed = False
            self._folder = _with_c_files(self._attached, codes) if codes else None
            for reference, source in named:
                path, _, name = reference.rpartition(":")
                self.scene = self(f"{Path(path).name}:{name}@{source}")
            return
        if named or text in scene_names() or ".py:" in text:
            self.scene = find_scene(text)
            self._file, self._text = self.scene.__module__, text_of(self.scene)
        else:
            try:
                self._text = read_text(Path(text))
            except (OSError, ValueError) as error:
                raise ParameterError(f"scene {text!r} cannot be read: {error}") from None
        present = hashes_of_laws(self.scene) if codes and self.scene is not None else set[str]()
        self.changed = bool(hashes - {hash_of(self._text)} or (present and codes - present))

    def __call__(self, reference: str) -> Any:
        """Return a class or function by its reference, FILE:NAME@HASH."""
        file, _, qualified = reference.partition(":")
        name, _, digest = qualified.rpartition("@")
        if self._attached is None:
            if self.scene is None:
                return object_of_text(self._text, name, self._file)
            return defined_in(sys.modules[self.scene.__module__], name, file)
        data = self._attached.get(f"source/{digest}/{file}", b"")
        text = data.decode("utf-8", "replace")
        if hash_of(text) != digest:
            raise InvalidRecordingError(f"the recording does not contain the recorded version of {file!r}")
        return object_of_text(text, name, file if self._folder is None else str(self._folder / file))


def _with_c_files(attachments: Mapping[str, bytes], codes: Collection[str]) -> Path:
    """Return a folder with the C files of laws, in which their classes find them."""
    folder = temporary_folder()
    for prefix in (f"source/{code}/" for code in codes):
        for name in (name for name in attachments if name.startswith(prefix)):
            parts = name.removeprefix(prefix).split("/")
            if all(re.fullmatch(r"\w[\w.+-]*", part) for part in parts):  # a file may contain anything
                path = folder.joinpath(*parts)
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(attachments[name])
    return folder


def _own_parts(setup: Setup) -> Iterator[Mapping[str, Any]]:
    """Yield the descriptions of user code in a controller."""
    controller = setup.get("controller")
    controller = controller if isinstance(controller, dict) else {}
    parts = [*(laws if isinstance(laws := controller.get("laws"), list) else []), controller.get("velocity")]
    yield from (part for part in parts if isinstance(part, dict) and "@" in str(part.get("class")))


@checked(own="setup")
def rebuild(
    setup: Setup, hand_force: HandForce | None, *, own: UserCode | None = None
) -> tuple[SampledPlant | None, Controller]:
    """Rebuild plant and controller of a recorded setup.

    Args:
        setup: The setup.
        hand_force: The hand on the flotor; None for the hand of the setup, if any.
        own: User code; its scene, if any, replaces the laws of the setup.

    Returns:
        Plant and controller; the plant is None for a flight on a device, or if it is user-defined.

    Raises:
        UserCodeError: If it needs user code that is not allowed to run.
        InvalidRecordingError: If the setup cannot be rebuilt.

    Example:
        >>> from maglev_mj import find_scene, rebuild, record_run
        >>> segment = record_run(find_scene("drop")(duration=0.1), plant="exact").segments[0]
        >>> plant, controller = rebuild(segment.setup, None)
        >>> type(plant).__name__, [type(law).__name__ for law in controller.laws]
        ('ExactPlant', ['Wall', 'Hold'])
    """
    check_setup(setup)
    plant = None if setup["kind"] in ("device", MEASURED) else rebuild_plant(setup, hand_force)
    return plant, _controller(setup, own)


def _controller(setup: Setup, own: UserCode | None) -> Controller:
    if (setup.get("session") or {}).get("after") is not None:
        raise UserCodeError("a segment resumes after a rewind from a sample that is not in the recording")
    if own is None or own.scene is None or not setup.get("scene"):
        return rebuild_controller(setup, own)
    with refused(*_INVALID):
        scene = _scene(setup, own)
        if setup["kind"] == "device":
            return device_controller(scene, RunMetadata.from_json(value_in(setup, "run", dict)).carried)
        return scene.controller()


def _scene(setup: Setup, own: UserCode | None) -> Scene:
    """Return the scene of a setup.

    Raises:
        UserCodeError: If it is user-defined, and not allowed to run.
        ParameterError: If its parameters are outside their bounds.
    """
    name = setup["scene"]
    if name not in BUILT_IN and (own is None or own.scene is None):
        file = Path(str(name).rpartition(":")[0]).name or "NAME"
        raise UserCodeError(f"user code, scene {name!r}, was not executed: {ALLOW_HINT.format(file)}")
    return recorded_scene(name, setup["parameters"], None if own is None else own.scene)


def rebuild_for(segment: Segment, own: UserCode | None = None) -> Rebuild | None:
    """Return the function that rebuilds plant and controller of a segment; None if it needs user code or has none.

    A recording never makes this program execute code that it names or contains: only the user can allow it.

    Args:
        segment: The segment.
        own: User code allowed to run.
    """
    if segment.setup["kind"] == MEASURED:
        return None
    try:
        _controller(segment.whole.setup, own)
    except UserCodeError:
        return None
    return partial(rebuild, own=own)


def unsimulated_plant(segment: Segment, own: UserCode | None = None) -> str:
    """Return the class name of a plant that cannot be simulated; "" if it can, as for a device with a known scene.

    Args:
        segment: The segment.
        own: User code allowed to run.
    """
    plant = segment.whole.setup.get("plant")
    is_twin = segment.setup["kind"] == "device" and not isinstance(displayed_scene(segment, own), _Unknown)
    return plant if isinstance(plant, str) and not is_twin else ""


@checked(own="scene")
def record_run(scene: SceneLike, *, plant: str | None = None, phase: float = 0.0) -> Recording:
    """Run a scene and record it in memory; a run that fails is recorded up to the failure.

    Args:
        scene: The scene, its class, or a text for `find_scene`.
        plant: Name of a plant; by default that of the scene.
        phase: Sampling phase, in [0, 1).

    Example:
        >>> from maglev_mj import find_scene, record_run
        >>> recording = record_run(find_scene("drop")(duration=0.1), plant="exact")
        >>> recording.ticks  # a sample each 5 ms
        21
    """
    file = MemoryFile()
    with recorded(file, quiet=True) as begin:
        run(scene, plant=plant, phase=checked_phase(phase), begin=begin)
    return file.recording


@checked
def write_run(path: Path | str, scene: SceneLike, *, plant: str | None = None, phase: float = 0.0) -> list[Path]:
    """Run a scene and record it to a journal; a run that fails is recorded up to the failure.

    Args:
        path: Path with the suffix .maglev.
        scene: The scene, its class, or a text for `find_scene`.
        plant: Name of a plant; by default that of the scene.
        phase: Sampling phase, in [0, 1).

    Returns:
        The path of the file; an empty list without samples.

    Raises:
        ParameterError: If the suffix is different.
        RecordingError: If the file is incomplete.
        OSError: If the file cannot be written.

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> from maglev_mj import Recording, find_scene, write_run
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     files = write_run(Path(folder, "run.maglev"), find_scene("drop")(duration=0.1), plant="exact")
        ...     ticks = Recording.load(files[0]).ticks
        >>> files[0].name, ticks
        ('run.maglev', 21)
    """
    written = list[Path]()
    with record_to_file(path, written, quiet=True) as begin:
        run(scene, plant=plant, phase=checked_phase(phase), begin=begin)
    return written


@contextmanager
def recorded(file: RecordingFile, *, quiet: bool = False) -> Iterator[Begin]:
    """Yield the `begin` argument of `run` that records to a file; a failure of the run becomes an event.

    Args:
        file: The file; it is not closed.
        quiet: True to suppress the exception of a failed run.
    """
    started = list[Scene]()

    def begin(scene: Scene, plant: Any, controller: Controller, samples: int) -> Record:
        started.append(scene)
        return begin_scene(file, scene, plant, controller, samples=samples, name=scene.name)

    try:
        yield begin
    except RecordingError:
        raise
    except MaglevError as error:
        if started:
            file.event("fault", str(error))
        if not (started and quiet):
            raise


@contextmanager
def record_to_file(path: Path | str, written: list[Path], *, quiet: bool = False) -> Iterator[Begin]:
    """Yield the `begin` argument of `run` that records to a new file; see `recorded`.

    Args:
        path: Path of the file.
        written: List to which the path is added unless there are no samples.
        quiet: See `recorded`.
    """
    file = open_recording(path, wait=True)
    try:
        with recorded(file, quiet=quiet) as begin:
            yield begin
    finally:
        if (closed := file.close()) is not None:
            written.append(closed)


def displayed_scene(segment: Segment, own: UserCode | None = None) -> Scene:
    """Return the scene of a segment for display, or a placeholder if it is not available.

    Args:
        segment: The segment.
        own: User code allowed to run.
    """
    try:
        with refused(*_INVALID):
            return _scene(segment.setup, own)
    except InvalidRecordingError:
        metadata = segment.metadata
        return _Unknown(period=metadata.period, delay=metadata.delay, axis=metadata.axis)


def stick_positions(segment: Segment, rebuild_run: Rebuild | None = rebuild) -> Iterator[Array]:
    """Yield the controller's stick positions at each sample of a run [m, rad], (6,); nothing without friction.

    Args:
        segment: A segment of the run; samples that precede it are included.
        rebuild_run: Function that makes plant and controller from a setup and a hand; None yields nothing.
    """
    if rebuild_run is None:
        return
    run = segment.whole
    _, controller = rebuild_run(run.setup, None)
    for first in range(0, len(run), _CHUNK):  # one list of a long segment would take a second and much memory
        part = slice(first, first + _CHUNK)
        for tick, pose in zip(run.tick[part].tolist(), run.position[part].tolist(), strict=True):
            controller.step(Sample(int(tick), 0.0, pose))
            if (positions := controller.stick_positions) is None:
                return
            yield positions


def stick_positions_of(segment: Segment, rebuild_run: Rebuild | None = rebuild) -> Array | None:
    """Return the stick positions at all samples, (N, 6); None without friction. See `stick_positions`."""
    positions = list(stick_positions(segment, rebuild_run))[-len(segment) :]
    return np.array(positions) if positions else None


ACTIONS = "pause", "step", "step back", "skip forward", "skip back", "slower", "faster", "loop", "start", "end"
"""Actions of `Replay.act`; "skip forward" and "skip back" move by 5 % of the recording."""

_SCALES = (*TIME_SCALES, 2.0, 5.0, 10.0)
_JUMP = 0.05
_ROUNDING = 1e-9
_STICKS = 100
"""Number of stick positions computed in one `tick`, in a few ms."""


class Replay:
    """Playback of a recording; a `SnapshotSource`.

    Its segments follow each other on one time axis. Opening and seeking take constant time: stick positions are
    computed during playback, from the first sample of each segment on.

    Args:
        recording: The recording, with at least one sample.
        own: User code allowed to run, for the stick positions; without it they are not shown.

    Attributes:
        hand: A dummy hand: the recorded one acts.
        simulated: Time played so far [s].

    Raises:
        RecordingError: If the recording is empty, or its setup cannot be rebuilt.
    """

    def __init__(self, recording: Recording, own: UserCode | None = None) -> None:
        self.hand = SpringHand()
        self.simulated = 0.0
        self._segments = [_PlayedSegment(segment, own) for segment in recording.segments if len(segment)]
        if not self._segments:
            raise InvalidRecordingError("the recording has no samples")
        begins = np.cumsum([0.0, *(part.duration for part in self._segments)])
        self._duration = float(begins[-1])
        self._times: Array = np.concatenate([begin + part.time for begin, part in zip(begins, self._segments)])
        self._firsts = np.cumsum([0, *(len(part.time) for part in self._segments)])
        last = len(self._times) - 1
        self._marks = [float(self._times[min(max(count - 1, 0), last)]) for count in recording.event_samples]
        self._events = list(recording.events)
        self._paused, self._loops, self._scale = False, True, 1.0
        self._time, self._row = 0.0, 0

    def tick(self, elapsed: float) -> int:
        """Advance by elapsed real time.

        Args:
            elapsed: Real time since the last call [s].

        Returns:
            Number of samples played.
        """
        self._now.compute_stick_positions()
        if self._paused:
            return 0
        before, rounds = self._row, 0.0
        passed = elapsed * self._scale
        self.simulated += passed
        time = self._time + passed
        if time >= self._duration - _ROUNDING:
            rounds, time = divmod(time + _ROUNDING, self._duration) if self._loops else (0.0, self._duration)
            self._paused = not self._loops
        self._seek(time)
        return int(rounds) * len(self._times) + self._row - before

    def act(self, action: str) -> None:
        """Perform one of `ACTIONS`.

        Raises:
            ParameterError: If there is no such action.
        """
        sign = -1 if action.endswith("back") else 1
        if action == "pause":
            if self._paused and self._time >= self._duration:
                self._seek(0.0)
            self._paused = not self._paused
        elif action in ("step", "step back"):
            self._paused = True
            self._seek(float(self._times[min(max(self._row + sign, 0), len(self._times) - 1)]))
        elif action in ("skip forward", "skip back"):
            time = self._time + sign * _JUMP * self._duration
            self._seek(min(max(time, 0.0), float(self._times[-1])))
        elif action in ("slower", "faster"):
            self._scale = next_scale(self._scale, action, _SCALES)
        elif action == "loop":
            self._loops = not self._loops
        elif action == "start":
            self._seek(0.0)
        elif action == "end":
            self._paused = True
            self._seek(self._duration)
        else:
            raise ParameterError(choice_message("action", ACTIONS, action))

    def change(self, parameters: Mapping[str, Any]) -> None:
        """Seek, or change the playback speed.

        Args:
            parameters: `time` [s], from 0 to the recording's duration, and `time_scale`, from 0.001 to 10.

        Raises:
            ParameterError: If a parameter is unknown or a value is out of range; then nothing changes.
        """
        changes = dict(parameters)
        time = number("time", changes.pop("time", self._time), at_least=0.0, at_most=self._duration)
        least, most = _SCALES[0], _SCALES[-1]
        scale = number("time_scale", changes.pop("time_scale", self._scale), at_least=least, at_most=most)
        if changes:
            raise ParameterError(f"parameters must be among time, time_scale (recording) (got {', '.join(changes)})")
        self._scale = scale
        self._seek(time)

    def snapshot(self) -> Snapshot:
        """Return the current snapshot."""
        now, row = self._now, self._row - self._firsts[self._index]
        samples, time = now.segment.arrays, float(self._times[self._row])
        since = SHOWN * max(self._scale, 1.0)
        recent = [event for event, mark in zip(self._events, self._marks) if 0.0 <= time - mark < since]
        return Snapshot(
            scene=now.scene,
            since=int(self._firsts[self._index]),
            delay=now.scene.delay,
            tick=self._row,
            time=time,
            pose=np.array(samples["position"][row]),
            force=samples["applied"][row] - now.carried,
            hand=np.array(samples["hand"][row]),
            hand_estimated=now.segment.setup["kind"] == "device",
            currents=_current_per_wrench(now.scene.hardware) @ samples["applied"][row],
            faces=now.faces,
            anchors=now.anchors(row),
            history=self._history(),
            work=float(now.work[row]),
            missed=int(samples["missed"][row]) if "missed" in samples else 0,
            taken=float(samples["taken"][row]) if "taken" in samples else float("nan"),
            time_scale=self._scale,
            duration=self._duration,
            marks=self._marks,
            actions=ACTIONS,
            state="paused" if self._paused else "running",
            notes=["REPLAY (looped)" if self._loops else "REPLAY", *recent],
        )

    def close(self) -> None:
        """Do nothing: a recording needs no closing."""

    @property
    def _index(self) -> int:
        """Index of the current segment."""
        return int(np.searchsorted(self._firsts, self._row, side="right")) - 1

    @property
    def _now(self) -> _PlayedSegment:
        return self._segments[self._index]

    def _seek(self, time: float) -> None:
        self._time, self._row = time, int(np.searchsorted(self._times, time + _ROUNDING, side="right")) - 1

    def _history(self) -> Array:
        """Return the samples of the last two seconds, across segments, (N, 32)."""
        end, firsts = self._row + 1, self._firsts
        first = int(np.searchsorted(self._times, self._times[self._row] - SHOWN))
        rows = []
        for index in range(int(np.searchsorted(firsts, first, side="right")) - 1, self._index + 1):
            low, high = max(first, firsts[index]), min(end, firsts[index + 1])
            part = self._segments[index].history(low - firsts[index], high - firsts[index])
            rows.append(np.column_stack([self._times[low:high], part]))
        return np.concatenate(rows)


class _PlayedSegment:
    """Segment of a recording, prepared for playback."""

    def __init__(self, segment: Segment, own: UserCode | None) -> None:
        self._rebuild = rebuild_for(segment, own)
        metadata = segment.metadata
        self.segment, self.scene = segment, displayed_scene(segment, own)
        self.time: Array = segment.time - segment.time[0]
        self.duration = float(self.time[-1]) + metadata.period
        self.carried, self.faces = metadata.carried, tuple(metadata.faces)
        if "hand_work" in segment.arrays:
            self.work: Array = segment.hand_work
        else:
            work = hand_work(segment.position, segment.hand).sum(axis=1)
            self.work = np.concatenate([[0.0], np.cumsum(work)])
        self._remaining, self._lead = stick_positions(segment, self._rebuild), len(segment.whole) - len(segment)
        self._anchors: list[Array] = []

    def compute_stick_positions(self) -> None:
        """Compute the next stick positions."""
        self._anchors += islice(self._remaining, _STICKS)

    def anchors(self, row: int) -> Array | None:
        """Return the stick positions at a sample; None without friction, or if not computed yet."""
        index = self._lead + row
        return self._anchors[index] if index < len(self._anchors) else None

    def history(self, low: int, high: int) -> Array:
        """Return the columns of a history after the time, of a range of samples, (N, 31)."""
        segment, before = self.segment, max(low - 1, 0)
        pose, time = segment.position[before:high], self.time[before:high]
        speed = np.diff(pose, axis=0) / np.diff(time)[:, None]
        if low == 0:  # repeat the second sample's speed: the first has no predecessor
            speed = np.concatenate([speed[:1] if len(speed) else np.zeros((1, 6)), speed])
        force = segment.applied[low:high] - self.carried
        pulse, width = segment.applied_pulse[low:high], segment.applied_pulse_width[low:high]
        return np.column_stack([pose[low - before :], speed, force, segment.hand[low:high], pulse, width])


@cache
def _current_per_wrench(device: Device) -> Array:
    """Return the coil currents per wrench [A/N, A/(N m)], (N, 6); zero without coils."""
    return np.zeros((6, 6)) if device.coils is None else CoilMap.of(device).current_per_wrench
