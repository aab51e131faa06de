"""Recording and replay of runs.

A recording's setup is turned into plant and controller.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from maglev_mj.control import Law
from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import Record
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.frames import AXES, Array, Sample
from maglev_mj.parameters import param, whole
from maglev_mj.plants import SampledPlant
from maglev_mj.plants.hand import HandForce
from maglev_mj.recording import (
    ArrayFile,
    Expected,
    InvalidRecordingError,
    OwnCodeError,
    Rebuild,
    Recording,
    RecordingError,
    RecordingFile,
    RunMetadata,
    Setup,
    Stretch,
    open_recording,
)
from maglev_mj.recording.sample import check_setup
from maglev_mj.recording.setup import ALLOW, controller_again, plant_again, scripted
from maglev_mj.scenes import BUILT_IN, Scene, find_scene, scene_names
from maglev_mj.scenes.find import SceneLike, defined_in, object_of_text, recorded_scene, text_of
from maglev_mj.scenes.run import Begin, checked_phase, run
from maglev_mj.session import begin_scene, device_controller
from maglev_mj.versions import hash_of

ATTACHED = "attached"
"""Marker for sources stored in the recording.

It is given in place of a scene's name.
"""

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
        setups = [stretch.setup for stretch in recording.stretches]
        said = [(setup.get("scene"), setup.get("source")) for setup in setups]
        named = {(scene, source) for scene, source in said if isinstance(scene, str) and isinstance(source, str)}
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
    told = setup.get("controller")
    told = told if isinstance(told, dict) else {}
    parts = [*(laws if isinstance(laws := told.get("laws"), list) else []), told.get("velocity")]
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
        >>> stretch = record_run(find_scene("drop")(duration=0.1), plant="exact").stretches[0]
        >>> plant, controller = rebuild(stretch.setup, None)
        >>> type(plant).__name__, [type(law).__name__ for law in controller.laws]
        ('ExactPlant', ['Wall', 'Hold'])
    """
    check_setup(setup)
    plant = None if setup["kind"] == "device" else plant_again(setup, hand)
    return plant, _controller(setup, own)


def _controller(setup: Setup, own: OwnCode | None) -> Controller:
    if own is None or own.scene is None or not setup.get("scene"):
        return controller_again(setup, own)
    with _one_line():
        scene = _scene(setup, own)
        return device_controller(scene) if setup["kind"] == "device" else scene.controller()


@contextmanager
def _one_line() -> Iterator[None]:
    """Refuse a setup with missing or invalid values."""
    try:
        yield
    except InvalidRecordingError:
        raise
    except (KeyError, TypeError, ParameterError) as error:
        raise InvalidRecordingError(f"a recording's setup cannot be made here: {error}") from None


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


def rebuild_for(stretch: Stretch, own: OwnCode | None = None) -> Rebuild | None:
    """Return the function that rebuilds a stretch, or None.

    It makes plant and controller; None if it needs user code.

    A recording never makes this program execute code that it names or contains: only the user can allow it.

    Args:
        stretch: The stretch.
        own: User code allowed to run.
    """
    try:
        _controller(stretch.setup, own)
    except OwnCodeError:
        return None
    return partial(rebuild, own=own)


def expected(setup: Setup) -> Expected:
    """Return the expected metadata of a recording's setup.

    They are those besides plant and controller.

    Raises:
        InvalidRecordingError: If the setup is not known here.
    """
    kind, metadata, known = setup["kind"], dict[str, Any](), scripted(setup)
    with _one_line():
        samples = None if setup.get("samples") is None else whole("samples", setup["samples"])
        if kind == "device":  # inertia and previous wrench are recorded with the flight, not in the setup
            metadata = {"delay": setup["parameters"]["delay"], "hand_recorded": False, "hand_acts_on_flotor": True}
        elif isinstance(setup.get("plant"), dict) and not known:
            metadata = {"hand_recorded": True}
    return Expected(scripted=known, samples=samples, metadata=metadata)


def unmade_plant(setup: Setup, own: OwnCode | None = None) -> str:
    """Return the class name of a plant not simulated here.

    Empty for one that can be simulated.

    Args:
        setup: The setup.
        own: User code allowed to run.
    """
    plant = setup.get("plant")
    if not isinstance(plant, str):
        return ""
    if setup["kind"] != "device":
        return plant
    try:
        with _one_line():
            _scene(setup, own)  # its simulated device replaces the real one
    except InvalidRecordingError:
        return plant
    return ""


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
    file = ArrayFile()
    with recorded(file, quiet=True) as begin:
        run(scene, plant=plant, phase=checked_phase(phase), begin=begin)
    return file.recording


def write_run(path: Path | str, scene: SceneLike, *, plant: str | None = None, phase: float = 0.0) -> list[Path]:
    """Run a scene and record it to a file.

    The file is .mcap or .npz. A run that fails is recorded up to the failure.

    Args:
        path: The file.
        scene: The scene, its class, or a text for `find_scene`.
        plant: Name of a plant; the scene's default by default.
        phase: Phase of the samples, in [0, 1).

    Returns:
        The file written, in another folder if its own is not writable; none without a sample.

    Raises:
        ParameterError: If the file is of neither kind.
        RecordingError: If it could not be written as a whole.
        OSError: If it could not be written at all.

    Example:
        >>> import tempfile
        >>> from pathlib import Path
        >>> from maglev_mj import Recording, find_scene, write_run
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     files = write_run(Path(folder, "run.npz"), find_scene("drop")(duration=0.1), plant="exact")
        ...     ticks = Recording.load(files[0]).ticks
        >>> files[0].name, ticks
        ('run.npz', 21)
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


def shown_scene(setup: Setup, metadata: RunMetadata, own: OwnCode | None = None) -> Scene:
    """Return the scene that displays a stretch.

    It is the stretch's own if that is known here.

    Args:
        setup: The setup.
        metadata: Metadata of the run, for an unknown scene.
        own: User code allowed to run.
    """
    try:
        with _one_line():
            return _scene(setup, own)
    except InvalidRecordingError:
        return _Unknown(period=metadata.period, delay=metadata.delay, axis=metadata.axis)


def stick_positions(stretch: Stretch, again: Rebuild | None = rebuild) -> Iterator[Array]:
    """Yield the stick positions at each sample [m, rad], (6,).

    They are as seen by the controller; there are none without friction.

    Args:
        stretch: The stretch.
        again: Function from a setup and a hand to plant and controller; None if there is none: then nothing is yielded.
    """
    if again is None:
        return
    _, controller = again(stretch.setup, None)
    for first in range(0, len(stretch), _CHUNK):  # as lists, a long stretch would take a second and much memory
        part = slice(first, first + _CHUNK)
        for tick, place in zip(stretch.tick[part].tolist(), stretch.position[part].tolist(), strict=True):
            controller.step(Sample(int(tick), 0.0, place))
            if (found := controller.stick_positions) is None:
                return
            yield found


def stick_positions_of(stretch: Stretch, again: Rebuild | None = rebuild) -> Array | None:
    """Return the stick positions at all samples, (N, 6).

    None without friction. See `stick_positions`.
    """
    found = list(stick_positions(stretch, again))
    return np.array(found) if found else None
