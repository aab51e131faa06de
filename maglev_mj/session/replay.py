"""Recordings run again: plant and controller of their setups, runs recorded, and playback."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache, partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from maglev_mj.control import Law
from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import Record
from maglev_mj.errors import MaglevError, ParameterError, not_one_of
from maglev_mj.frames import AXES, Array, Sample
from maglev_mj.parameters import number, param
from maglev_mj.plants import SampledPlant
from maglev_mj.plants.hand import HandForce, SpringHand
from maglev_mj.plants.model import load_model
from maglev_mj.plants.trace import hand_work
from maglev_mj.recording import (
    InvalidRecordingError,
    MemoryFile,
    OwnCodeError,
    Rebuild,
    Recording,
    RecordingError,
    RecordingFile,
    Segment,
    Setup,
    open_recording,
)
from maglev_mj.recording.sample import check_setup
from maglev_mj.recording.setup import ALLOW, rebuild_controller, rebuild_plant, refused
from maglev_mj.scenes import BUILT_IN, Scene, find_scene, scene_names
from maglev_mj.scenes.find import SceneLike, defined_in, object_of_text, recorded_scene, text_of
from maglev_mj.scenes.run import Begin, checked_phase, run
from maglev_mj.session import SHOWN, TIME_SCALES, Snapshot, begin_scene, device_controller, next_scale
from maglev_mj.versions import hash_of

ATTACHED = "attached"
"""Marker for sources stored in the recording.

It is given in place of a scene's name.
"""

_INVALID = KeyError, TypeError, ParameterError
_CHUNK = 1000
"""Number of samples processed at a time."""


class _Unknown(Scene):
    """Recording with a scene that is not known here."""

    axis: str = param("axis shown", default="z", choices=AXES)

    def laws(self) -> list[Law]:
        return []


class OwnCode:
    """User code that may be executed for a recording.

    Args:
        text: NAME of a scene, FILE.py or FILE.py:CLASS, or `ATTACHED` for the code in the recording. A file is
            executed as a module.
        recording: The recording.

    Attributes:
        scene: The scene of the recording; None for one without.
        changed: True if it differs from the recorded code.

    Raises:
        ParameterError: If there is no such scene or file, or the recording does not hold it.
    """

    def __init__(self, text: str, recording: Recording) -> None:
        self._attached = recording.attachments if text == ATTACHED else None
        setups = [segment.setup for segment in recording.segments]
        sources = [(setup.get("scene"), setup.get("source")) for setup in setups]
        named = {(scene, source) for scene, source in sources if isinstance(scene, str) and isinstance(source, str)}
        hashes, self._text, self._file = {source for _, source in named}, "", text
        for setup in setups:
            hashes |= {name.rpartition("@")[2] for name in _own_names(setup)}
        self.scene: type[Scene] | None = None
        if self._attached is not None:
            self.changed = False
            for reference, source in named:
                path, _, name = reference.rpartition(":")
                self.scene = self(f"{Path(path).name}:{name}@{source}")
            return
        if named or text in scene_names() or ".py:" in text:
            self.scene = find_scene(text)
            self._file, self._text = self.scene.__module__, text_of(self.scene)
        else:
            try:
                self._text = Path(text).read_text(encoding="utf-8")
            except (OSError, ValueError) as error:
                raise ParameterError(f"scene must be a file that can be read, not {text!r}: {error}") from None
        self.changed = bool(hashes - {hash_of(self._text)})

    def __call__(self, reference: str) -> Any:
        """Return a class or function by its reference, FILE:NAME@HASH."""
        file, _, rest = reference.partition(":")
        name, _, digest = rest.rpartition("@")
        if self._attached is None:
            if self.scene is None:
                return object_of_text(self._text, name, self._file)
            return defined_in(sys.modules[self.scene.__module__], name, file)
        data = self._attached.get(f"source/{digest}/{file}", b"")
        text = data.decode("utf-8", "replace")
        if hash_of(text) != digest:
            raise InvalidRecordingError(f"the recording does not hold {file!r} as it was")
        return object_of_text(text, name, file)


def _own_names(setup: Setup) -> Iterator[str]:
    """Yield the references of user code in a controller."""
    controller = setup.get("controller")
    controller = controller if isinstance(controller, dict) else {}
    parts = [*(laws if isinstance(laws := controller.get("laws"), list) else []), controller.get("velocity")]
    yield from (one["class"] for one in parts if isinstance(one, dict) and "@" in str(one.get("class")))


def rebuild(
    setup: Setup, hand: HandForce | None, *, own: OwnCode | None = None
) -> tuple[SampledPlant | None, Controller]:
    """Return plant and controller of a recording's setup.

    Args:
        setup: The setup.
        hand: The hand on the flotor; None for the run's own, if it has one.
        own: User code; its scene, if it has one, gives the laws in place of the setup.

    Returns:
        Both; None for the plant of a flight on a device, and for one that is not this package's.

    Raises:
        OwnCodeError: If it needs user code that is not allowed to run.
        InvalidRecordingError: If the setup is not known here.

    Example:
        >>> from maglev_mj import find_scene, rebuild, record_run
        >>> segment = record_run(find_scene("drop")(duration=0.1), plant="exact").segments[0]
        >>> plant, controller = rebuild(segment.setup, None)
        >>> type(plant).__name__, [type(law).__name__ for law in controller.laws]
        ('ExactPlant', ['Wall', 'Hold'])
    """
    check_setup(setup)
    plant = None if setup["kind"] == "device" else rebuild_plant(setup, hand)
    return plant, _controller(setup, own)


def _controller(setup: Setup, own: OwnCode | None) -> Controller:
    if (setup.get("session") or {}).get("after") is not None:
        raise OwnCodeError("a segment goes on, after a rewind, from a sample that is not in the recording")
    if own is None or own.scene is None or not setup.get("scene"):
        return rebuild_controller(setup, own)
    with refused(*_INVALID):
        scene = _scene(setup, own)
        return device_controller(scene) if setup["kind"] == "device" else scene.controller()


def _scene(setup: Setup, own: OwnCode | None) -> Scene:
    """Return the scene of a setup.

    Raises:
        OwnCodeError: If it is not of this package, and not allowed to run.
        ParameterError: If its parameters are outside their bounds.
    """
    name = setup["scene"]
    if name not in BUILT_IN and (own is None or own.scene is None):
        file = Path(str(name).rpartition(":")[0]).name or "NAME"
        raise OwnCodeError(f"scene {name!r} must be executed to run it again: {ALLOW.format(file)}")
    return recorded_scene(name, setup["parameters"], None if own is None else own.scene)


def rebuild_for(segment: Segment, own: OwnCode | None = None) -> Rebuild | None:
    """Return the function that rebuilds a segment, or None.

    It makes plant and controller; None if it needs user code.

    A recording never makes this program execute code that it names or contains: only the user can allow it.

    Args:
        segment: The segment.
        own: User code allowed to run.
    """
    try:
        _controller(segment.whole.setup, own)
    except OwnCodeError:
        return None
    return partial(rebuild, own=own)


def unmade_plant(segment: Segment, own: OwnCode | None = None) -> str:
    """Return the class name of a plant not simulated here.

    Empty for one that can be simulated, as a device of a known scene.

    Args:
        segment: The segment.
        own: User code allowed to run.
    """
    plant = segment.whole.setup.get("plant")
    is_twin = segment.setup["kind"] == "device" and not isinstance(shown_scene(segment, own), _Unknown)
    return plant if isinstance(plant, str) and not is_twin else ""


def record_run(scene: SceneLike, *, plant: str | None = None, phase: float = 0.0) -> Recording:
    """Run a scene and record it in memory.

    A run that fails is recorded up to the failure.

    Args:
        scene: The scene, its class, or a text for `find_scene`.
        plant: Name of a plant; the scene's default by default.
        phase: Phase of the samples, in [0, 1).

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


def write_run(path: Path | str, scene: SceneLike, *, plant: str | None = None, phase: float = 0.0) -> list[Path]:
    """Run a scene and record it to a file.

    The file is a journal, .maglev. A run that fails is recorded up to the failure.

    Args:
        path: The file.
        scene: The scene, its class, or a text for `find_scene`.
        plant: Name of a plant; the scene's default by default.
        phase: Phase of the samples, in [0, 1).

    Returns:
        The file written; none without a sample.

    Raises:
        ParameterError: If the file has another suffix.
        RecordingError: If it could not be written as a whole.
        OSError: If it could not be written at all.

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
    with recorded_to(path, written, quiet=True) as begin:
        run(scene, plant=plant, phase=checked_phase(phase), begin=begin)
    return written


@contextmanager
def recorded(file: RecordingFile, *, quiet: bool = False) -> Iterator[Begin]:
    """Give `run` what begins a recording in a file.

    A fault of the run is an event there.

    Args:
        file: The file; it is left open.
        quiet: True if nothing else is to tell of a fault.
    """
    begun = list[Scene]()

    def begin(scene: Scene, plant: Any, controller: Controller, samples: int) -> Record:
        begun.append(scene)
        return begin_scene(file, scene, plant, controller, samples=samples, name=scene.name)

    try:
        yield begin
    except RecordingError:
        raise
    except MaglevError as error:
        if begun:
            file.event("fault", str(error))
        if not (begun and quiet):
            raise


@contextmanager
def recorded_to(path: Path | str, written: list[Path], *, quiet: bool = False) -> Iterator[Begin]:
    """Give `run` what begins a recording in a file of a path; see `recorded`.

    Args:
        path: The file.
        written: List to which the file written is added; none without a sample.
        quiet: See `recorded`.
    """
    file = open_recording(path, wait=True)
    try:
        with recorded(file, quiet=quiet) as begin:
            yield begin
    finally:
        if (done := file.close()) is not None:
            written.append(done)


def shown_scene(segment: Segment, own: OwnCode | None = None) -> Scene:
    """Return the scene that displays a segment.

    It is the segment's own if that is known here.

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


def stick_positions(segment: Segment, again: Rebuild | None = rebuild) -> Iterator[Array]:
    """Yield the stick positions at each sample of a segment's whole run [m, rad], (6,).

    They are as seen by the controller; there are none without friction.

    Args:
        segment: The segment.
        again: Function from a setup and a hand to plant and controller; None if there is none: then nothing is yielded.
    """
    if again is None:
        return
    whole = segment.whole
    _, controller = again(whole.setup, None)
    for first in range(0, len(whole), _CHUNK):  # as lists, a long segment would take a second and much memory
        part = slice(first, first + _CHUNK)
        for tick, place in zip(whole.tick[part].tolist(), whole.position[part].tolist(), strict=True):
            controller.step(Sample(int(tick), 0.0, place))
            if (found := controller.stick_positions) is None:
                return
            yield found


def stick_positions_of(segment: Segment, again: Rebuild | None = rebuild) -> Array | None:
    """Return the stick positions at all samples, (N, 6).

    None without friction. See `stick_positions`.
    """
    positions = list(stick_positions(segment, again))[-len(segment) :]
    return np.array(positions) if positions else None


ACTIONS = "pause", "step", "step back", "skip forward", "skip back", "slower", "faster", "loop", "start", "end"
"""Actions of `Replay.act`.

"skip forward" and "skip back" move by a twentieth of the recording.
"""

_SCALES = (*TIME_SCALES, 2.0, 5.0, 10.0)
_JUMP = 0.05
_ROUNDING = 1e-9
_STICKS = 100
"""Number of stick positions found in one `tick`.

It takes some ms.
"""


class Replay:
    """Recording shown in time; a `SnapshotSource`.

    All its segments are on one time axis, one after the other. The time of opening and seeking does not grow with the
    number of samples: stick positions are found during playback, in each segment from its first sample on.

    Args:
        recording: The recording, of at least one sample.
        own: User code allowed to run, for the stick positions; without it the recording is shown without them.

    Attributes:
        hand: A hand that moves nothing; the recorded one acts.
        simulated: Time shown so far [s].

    Raises:
        RecordingError: If it is empty, or its setup is not known here.
    """

    def __init__(self, recording: Recording, own: OwnCode | None = None) -> None:
        self.hand = SpringHand()
        self.simulated = 0.0
        self._segments = [_Shown(segment, own) for segment in recording.segments if len(segment)]
        if not self._segments:
            raise InvalidRecordingError("there is nothing in the recording")
        begins = np.cumsum([0.0, *(one.duration for one in self._segments)])
        self._duration = float(begins[-1])
        self._times: Array = np.concatenate([begin + one.time for begin, one in zip(begins, self._segments)])
        self._firsts = np.cumsum([0, *(len(one.time) for one in self._segments)])
        last = len(self._times) - 1
        self._marks = [float(self._times[min(max(count - 1, 0), last)]) for count in recording.event_samples]
        self._events = list(recording.events)
        self._paused, self._loops, self._scale = False, True, 1.0
        self._time, self._row = 0.0, 0

    def tick(self, elapsed: float) -> int:
        """Advance by a real time.

        Args:
            elapsed: Real time since the last call [s].

        Returns:
            Number of samples passed.
        """
        self._now.find_sticking()
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
        """Run one of `ACTIONS`.

        Raises:
            ParameterError: If there is no such action.
        """
        way = -1 if action.endswith("back") else 1
        if action == "pause":
            if self._paused and self._time >= self._duration:
                self._seek(0.0)
            self._paused = not self._paused
        elif action in ("step", "step back"):
            self._paused = True
            self._seek(float(self._times[min(max(self._row + way, 0), len(self._times) - 1)]))
        elif action in ("skip forward", "skip back"):
            time = self._time + way * _JUMP * self._duration
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
            raise ParameterError(not_one_of("action", ACTIONS, action))

    def change(self, parameters: Mapping[str, Any]) -> None:
        """Change the time or the playback speed.

        Args:
            parameters: `time` [s], from 0 to the recording's length, and `time_scale`, from 0.001 to 10.

        Raises:
            ParameterError: If there is another parameter or a value is out of range; nothing changes then.
        """
        changes = dict(parameters)
        time = number("time", changes.pop("time", self._time), at_least=0.0, at_most=self._duration)
        least, most = _SCALES[0], _SCALES[-1]
        scale = number("time_scale", changes.pop("time_scale", self._scale), at_least=least, at_most=most)
        if changes:
            raise ParameterError(f"parameters of a recording must be of time, time_scale, not {', '.join(changes)}")
        self._scale = scale
        self._seek(time)

    def snapshot(self) -> Snapshot:
        """Return the present snapshot."""
        now, row = self._now, self._row - self._firsts[self._place]
        samples, time = now.segment.arrays, float(self._times[self._row])
        since = SHOWN * max(self._scale, 1.0)
        passed = [event for event, mark in zip(self._events, self._marks) if 0.0 <= time - mark < since]
        return Snapshot(
            scene=now.scene,
            since=int(self._firsts[self._place]),
            delay=now.scene.delay,
            tick=self._row,
            time=time,
            pose=np.array(samples["position"][row]),
            force=samples["applied"][row] - now.carried,
            hand=np.array(samples["hand"][row]),
            hand_estimated=now.segment.setup["kind"] == "device",
            currents=_current_per_wrench() @ samples["applied"][row],
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
            notes=["REPLAY, in a loop" if self._loops else "REPLAY", *passed],
        )

    def close(self) -> None:
        """Do nothing: a recording needs no closing."""

    @property
    def _place(self) -> int:
        """Index of the segment shown."""
        return int(np.searchsorted(self._firsts, self._row, side="right")) - 1

    @property
    def _now(self) -> _Shown:
        return self._segments[self._place]

    def _seek(self, time: float) -> None:
        self._time, self._row = time, int(np.searchsorted(self._times, time + _ROUNDING, side="right")) - 1

    def _history(self) -> Array:
        """Return the samples of the last two seconds.

        Those of earlier segments are included.
        """
        end, firsts = self._row + 1, self._firsts
        first = int(np.searchsorted(self._times, self._times[self._row] - SHOWN))
        rows = []
        for place in range(int(np.searchsorted(firsts, first, side="right")) - 1, self._place + 1):
            low, high = max(first, firsts[place]), min(end, firsts[place + 1])
            part = self._segments[place].history(low - firsts[place], high - firsts[place])
            rows.append(np.column_stack([self._times[low:high], part]))
        return np.concatenate(rows)


class _Shown:
    """Segment of a recording with its metadata."""

    def __init__(self, segment: Segment, own: OwnCode | None) -> None:
        self._again = rebuild_for(segment, own)
        metadata = segment.metadata
        self.segment, self.scene = segment, shown_scene(segment, own)
        self.time: Array = segment.time - segment.time[0]
        self.duration = float(self.time[-1]) + metadata.period
        self.carried, self.faces = metadata.carried, tuple(metadata.faces)
        if "hand_work" in segment.arrays:
            self.work: Array = segment.hand_work
        else:
            work = hand_work(segment.position, segment.hand).sum(axis=1)
            self.work = np.concatenate([[0.0], np.cumsum(work)])
        self._sticking, self._lead = stick_positions(segment, self._again), len(segment.whole) - len(segment)
        self._anchors: list[Array] = []

    def find_sticking(self) -> None:
        """Find the next stick positions."""
        self._anchors += islice(self._sticking, _STICKS)

    def anchors(self, row: int) -> Array | None:
        """Return the stick positions at a sample, or None.

        None without friction, or if they are not found yet.
        """
        place = self._lead + row
        return self._anchors[place] if place < len(self._anchors) else None

    def history(self, low: int, high: int) -> Array:
        """Return motion and forces of a range of samples.

        (N, 24): pose, speed, wrench of the device, wrench of the hand.
        """
        segment, before = self.segment, max(low - 1, 0)
        pose, time = segment.position[before:high], self.time[before:high]
        speed = np.diff(pose, axis=0) / np.diff(time)[:, None]
        if low == 0:  # the first sample has no speed: it gets the next one's
            speed = np.concatenate([speed[:1] if len(speed) else np.zeros((1, 6)), speed])
        force = segment.applied[low:high] - self.carried
        return np.column_stack([pose[low - before :], speed, force, segment.hand[low:high]])


@cache
def _current_per_wrench() -> Array:
    """Return the coil currents per wrench, (6, 6).

    In [A/N, A/(N m)].
    """
    coils = load_model("drop").coils
    assert coils is not None
    return coils.current_per_wrench
