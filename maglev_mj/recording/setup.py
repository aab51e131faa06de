"""Setup of plant and controller: stored as JSON, and rebuilt without importing names from the file."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, Protocol, TypeAlias

import numpy as np

from maglev_mj import control as _laws
from maglev_mj import plants
from maglev_mj.control.controller import Controller
from maglev_mj.control.laws.base import FunctionLaw, Law
from maglev_mj.control.laws.velocity import Estimator
from maglev_mj.control.loop import Record
from maglev_mj.device import Device
from maglev_mj.errors import MaglevError, ParameterError, check_instance
from maglev_mj.lazy import public
from maglev_mj.parameters import number
from maglev_mj.plants import ExactPlant, MuJoCoPlant, SampledPlant, Timing, engine_warnings_silenced
from maglev_mj.plants.hand import GuidedHand, Hand, HandForce, SpringHand, Trajectory
from maglev_mj.plants.model import model_files, model_names
from maglev_mj.plants.sensor import SimulatedSensor
from maglev_mj.recording.journal import InvalidRecordingError
from maglev_mj.recording.sample import RecordedPlant, RunMetadata, Setup, check_setup, value_in
from maglev_mj.versions import file_of, hash_of

CodeLoader: TypeAlias = Callable[[str], Any]
"""Loader of a user's class or function by its reference FILE:NAME@HASH; executes the source."""

_TYPES: Mapping[str, tuple[type, ...]] = {
    "controller": (Controller,),
    "laws": public(_laws, Law),
    "velocity": public(_laws, Estimator),
    "plant": (ExactPlant, MuJoCoPlant),
    "timing": (Timing,),
    "sensor": public(plants, SimulatedSensor),
    "hand": (Hand,),
    "hand_force": (GuidedHand, SpringHand),
    "path": (Trajectory,),
    "target": (Trajectory,),
}
"""Allowed types by argument name, with every law, estimator and sensor of the package; no other type is constructed."""

ALLOW_HINT = "allow it with --scene {}, or with --scene attached for the source in the recording"
"""Advice to the user in an `UserCodeError`."""

MEASURED = "measured"
"""Kind of a setup without plant and controller: a table of another program, see `import_table`."""

UNCONTROLLED = "measured recording without controller: no simulation, laws or check"

_OBJECTS = ("timing", "sensor", "hand", "hand_force", "path")
_OWN_SLOTS = ("laws", "velocity")
_INFINITE = {"inf": math.inf, "-inf": -math.inf}
_INVALID = MaglevError, KeyError, TypeError, ValueError, AttributeError, ArithmeticError, RecursionError
_MAX_VALUE, _MAX_ENTRIES, _MAX_LAWS, _MIN_STEP = 1e15, 100_000, 100, 1e-5


class UserCodeError(InvalidRecordingError):
    """A recording needs user code that was not allowed to run."""


class _NoJsonError(Exception):
    """A value has no JSON form."""


def setup_of(
    plant: Any,
    controller: Controller,
    *,
    kind: str = "run",
    scene: str | None = None,
    source: str | None = None,
    parameters: Mapping[str, Any] | None = None,
    samples: int | None = None,
    session: Mapping[str, int | None] | None = None,
    **metadata: Any,
) -> dict[str, Any]:
    """Return the setup of a run before its first sample, as JSON values.

    Args:
        plant: The plant.
        controller: The controller.
        kind: "run", or "device" for a flight.
        scene: Reference of the scene, if any.
        source: Hash of the scene's file, if any.
        parameters: Parameters of the run by name, JSON values.
        samples: Number of samples unless the run fails earlier; None if unknown.
        session: Session numbers of the `first` sample and of the sample `after` which it resumes (None for a new
            run); see `Segment.before`.
        metadata: Values that override those of plant and controller, see `RunMetadata.of`.

    Raises:
        ParameterError: If a value is not finite, or the delay is missing.
    """
    if scene is not None:
        metadata.setdefault("name", scene)
    setup = {
        "kind": kind,
        "scene": scene,
        "source": source,
        "parameters": dict(parameters or {}),
        "samples": samples,
        "controller": _description("controller", controller),
        "plant": _description("plant", plant),
        "run": RunMetadata.of(plant, controller, **metadata).as_json(),
    }
    if session is not None:
        setup["session"] = session
    return dict(check_setup(setup))


def complete_setup(plant: Any, controller: Controller, setup: Setup | None) -> Setup:
    """Return a setup with its metadata; by default the setup of plant and controller."""
    if setup is None:
        return setup_of(plant, controller)
    return setup if "run" in setup else {**setup, "run": RunMetadata.of(plant, controller).as_json()}


class RecordingFile(Protocol):
    """Interface of a file that records a run."""

    def begin(self, plant: RecordedPlant, controller: Controller, setup: Setup | None = None) -> Record:
        """Start a segment; return the loop's recording function.

        Args:
            plant: The controlled plant.
            controller: The controller.
            setup: Setup of both, by default from `setup_of`; the metadata `run` are added if missing.
        """

    def event(self, kind: str, text: str, missed: int = 0) -> None:
        """Record an event for the user, with the number of samples missed in it."""

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Attach a file, before the first sample.

        Args:
            name: Unique name.
            media_type: Media type, such as "text/xml".
            data: Content of the file.
        """

    def append(self, records: bytes) -> None:
        """Append packed journal records, such as device cycles."""

    def check(self) -> None:
        """Check that the recording is being written.

        Raises:
            RecordingError: If writing has failed.
        """

    def close(self) -> Path | None:
        """Finish writing; return the path, or None without samples; idempotent.

        Raises:
            RecordingError: If the file is incomplete.
        """


def attach_parts(file: RecordingFile, plant: Any, controller: Controller) -> None:
    """Attach the MJCF of the plant, and the source files of user-defined laws."""
    model = getattr(plant, "given", {}).get("model", "drop" if isinstance(plant, MuJoCoPlant) else None)
    if isinstance(model, str | Path):
        attach_model(file, model)
    for part in (*controller.laws, controller.velocity):
        attach_source(file, part.function if isinstance(part, FunctionLaw) else type(part))


def attach_model(file: RecordingFile, model: str | Path) -> None:
    """Attach the MJCF of a model with its included files."""
    for name, text in model_files(model):
        file.attach(f"model/{name}", "application/xml", text.encode())


def attach_source(file: RecordingFile, definition: Any) -> None:
    """Attach the source file of a user-defined class or function, and the C files of a law in C."""
    is_user_defined = getattr(definition, "__module__", "maglev_mj").partition(".")[0] != "maglev_mj"
    if is_user_defined and (source := file_of(definition)) is not None:
        path, text = source
        file.attach(f"source/{hash_of(text)}/{path.name}", "text/x-python", text.encode())
        from maglev_mj.control.laws.c_law import files_of  # loads ctypes

        for digest, files in files_of([definition]).items():
            if any(name.endswith(".c") for name in files):  # a compiled library is for one kind of machine
                for name, data in files.items():
                    file.attach(f"source/{digest}/{name}", "text/x-c", data)


def scripted(setup: Setup) -> bool:
    """Return True if the setup defines the hand, or there is none."""
    plant = setup.get("plant")
    return isinstance(plant, dict) and not isinstance(plant.get("hand_force"), str)


def rebuild_controller(setup: Setup, own: CodeLoader | None = None) -> Controller:
    """Rebuild the controller of a setup.

    Args:
        setup: The setup.
        own: Loader of user-defined classes and functions; None if these must not be executed.

    Raises:
        UserCodeError: If it needs user code that is not allowed to run, or not available.
        InvalidRecordingError: If a value is missing, of another type, or out of range, or there is no controller.
    """
    if setup["kind"] == MEASURED:
        raise InvalidRecordingError(UNCONTROLLED)
    with refused(*_INVALID):
        controller = _object("controller", setup["controller"], own)
        if not isinstance(controller, Controller):
            raise UserCodeError(
                f"{controller} cannot be rebuilt: user-defined, or already running when recording started"
            )
        return controller


def rebuild_plant(setup: Setup, hand_force: HandForce | None = None) -> SampledPlant | None:
    """Rebuild the plant of a setup; None for a user-defined plant.

    Args:
        setup: The setup.
        hand_force: The hand on the flotor; None for the hand of the setup, if any.

    Raises:
        InvalidRecordingError: If a value is missing, of another type, or out of range.
    """
    description = setup.get("plant")
    if isinstance(description, str):
        return None
    with refused(*_INVALID), engine_warnings_silenced():
        if isinstance(description, dict) and (hand_force is not None or not scripted(setup)):
            description = {name: value for name, value in description.items() if name != "hand_force"}
        force = {} if hand_force is None else {"hand_force": hand_force}
        plant: SampledPlant = _object("plant", description, None, force)
        check_instance("plant", plant, SampledPlant, "an object")
        if plant.batch or np.ndim(plant.timing.delay):
            raise ParameterError("plant must be a single device, not a batch")
        return plant


@contextmanager
def refused(*errors: type[Exception]) -> Iterator[None]:
    """Raise errors of an invalid setup as InvalidRecordingError."""
    try:
        yield
    except InvalidRecordingError:
        raise
    except errors as error:
        raise InvalidRecordingError(f"cannot rebuild the recorded setup: {error}") from None


def _description(slot: str, value: Any) -> Any:
    """Return an object as JSON values, or only its class name if an argument has no JSON form."""
    try:
        reference = _reference(slot, value)
        return {"class": reference, **{name: _value(name, part) for name, part in _arguments(value).items()}}
    except _NoJsonError:
        return f"{type(value).__module__}.{type(value).__qualname__}"


def _reference(slot: str, value: Any) -> str:
    """Return the reference of an object's class: a name in `_TYPES`, or FILE:NAME@HASH if user-defined."""
    if type(value) in _TYPES[slot]:
        return type(value).__name__
    definition = value.function if isinstance(value, FunctionLaw) else type(value)
    if slot in _OWN_SLOTS and (source := file_of(definition) if hasattr(definition, "__qualname__") else None):
        return f"{source[0].name}:{definition.__qualname__}@{hash_of(source[1])}"
    raise _NoJsonError


def _arguments(value: Any) -> Mapping[str, Any]:
    """Return the constructor arguments of an object that differ from their defaults."""
    if isinstance(value, Controller | SampledPlant) and value.started:
        raise _NoJsonError  # its state is not in its arguments
    if isinstance(value, Controller):
        return {"laws": value.laws, "period": value.period, "velocity": value.velocity}
    if isinstance(value, SampledPlant):
        return value.given
    if isinstance(value, SpringHand) and (value.rise_time or not isinstance(value.target, Trajectory)):
        raise _NoJsonError  # it has a state, or a target that is set from outside
    if is_dataclass(value):
        return {
            entry.name: part
            for entry in fields(value)
            if entry.init and (part := getattr(value, entry.name)) is not entry.default
        }
    if isinstance(value, FunctionLaw) or not vars(value):
        return {}
    raise _NoJsonError


def _value(slot: str, value: Any) -> Any:
    """Return an argument as JSON values."""
    if isinstance(value, Device):
        return {"device": value.toml()}
    if slot == "model" and value not in (None, *model_names()):
        raise _NoJsonError
    if value is None or isinstance(value, bool | str):
        return value
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, int | float):
        return value if math.isfinite(value) else str(float(value))
    if isinstance(value, list | tuple):
        return [_description(slot, part) if slot == "laws" else _value(slot, part) for part in value]
    if slot not in _TYPES:
        raise _NoJsonError
    description = _description(slot, value)
    if isinstance(description, str) and slot not in ("hand_force", *_OWN_SLOTS):
        raise _NoJsonError
    return description


def _object(slot: str, description: Any, own: CodeLoader | None, extra: Mapping[str, Any] | None = None) -> Any:
    """Return the object or number of a JSON description.

    Args:
        slot: Name of the argument.
        description: The JSON values.
        own: See `rebuild_controller`.
        extra: Additional constructor arguments.
    """
    if slot in _OBJECTS and description is not None and not isinstance(description, dict):
        raise ParameterError(f"{slot} must be an object (got {str(description)[:40]!r})")
    if isinstance(description, list):
        limit = _MAX_LAWS if slot == "laws" else _MAX_ENTRIES
        if len(description) > limit:
            raise ParameterError(f"{slot} must have at most {limit} entries (got {len(description)})")
        return [_object(slot, part, own) for part in description]
    if slot == "model" and isinstance(description, dict):
        return Device.parse(value_in(description, "device", str))
    if isinstance(description, dict):
        name = value_in(description, "class", str)
        cls = {allowed.__name__: allowed for allowed in _TYPES.get(slot, ())}.get(name)
        if cls is None:
            cls = _user_defined(slot, name, own)
        arguments = {key: _object(key, part, own) for key, part in description.items() if key != "class"}
        return cls(**arguments, **(extra or {})) if isinstance(cls, type) else cls
    if slot in _OWN_SLOTS and isinstance(description, str):
        raise UserCodeError(f"{description} cannot be rebuilt: it is not part of this package")
    if slot == "model" and description not in (None, *model_names()):
        raise ParameterError(f"model must be one of {', '.join(model_names())} (got {description!r})")
    if isinstance(description, int | float) and not isinstance(description, bool):
        number(slot, description, at_least=_MIN_STEP if slot == "longest_step" else -_MAX_VALUE, at_most=_MAX_VALUE)
    return _INFINITE.get(description, description) if isinstance(description, str) else description


def _user_defined(slot: str, name: str, own: CodeLoader | None) -> Any:
    """Return a user-defined class or function.

    Raises:
        ParameterError: If the class is not allowed for this argument.
        UserCodeError: If it is not allowed to run.
    """
    if slot not in _OWN_SLOTS or "@" not in name:
        allowed = ", ".join(cls.__name__ for cls in _TYPES.get(slot, ()))
        raise ParameterError(f"{slot} must be of class {allowed or 'none'} (got {name[:60]!r})")
    if own is None:
        file = name.partition(":")[0][:60]
        raise UserCodeError(f"user code {name[:80]!r} was not executed: {ALLOW_HINT.format(file)}")
    definition = own(name)
    if isinstance(definition, type) and "__call__" not in dir(definition):  # its arguments come from the recording
        raise ParameterError(f"{slot} must be of a class with __call__ (got {name[:60]!r})")
    return definition
