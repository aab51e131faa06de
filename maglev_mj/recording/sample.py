"""Recorded samples and run metadata: fields, units, JSON, and validation.

One table of fields defines all file formats.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, NamedTuple, Protocol, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from maglev_mj.control.controller import Controller
from maglev_mj.control.timeline import Timing, peak_forces
from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, ZERO, Array, Command, Sample
from maglev_mj.parameters import axis_indices, flag, number, numbers
from maglev_mj.plants.trace import HandWork, PassivityObserver
from maglev_mj.spec import GRAVITY, INERTIA
from maglev_mj.terminal import printable

Row: TypeAlias = Sequence[float]
"""Values of one sample in FIELDS order, components flattened."""

Rows: TypeAlias = NDArray[np.void]
"""N samples: a structured array (N,)."""

_POSE, _WRENCH, _FORCE = ("m", "rad"), ("N", "N m"), 1e12
_MAX_INTEGER = 2**53  # floats above it skip integers
_MAX_MISSING = 1_000_000
_KINDS = {dict: "an object", list: "a list", str: "a string", bool: "true or false"}


class RecordedPlant(Protocol):
    """Plant of `row_of`; `arrival`, the host's time of the sample [s], is optional."""

    @property
    def hand_wrench(self) -> Sequence[Any]:
        """Hand wrench since the previous sample [N, N m], six components."""


class Field(NamedTuple):
    """One value of a recorded sample.

    Attributes:
        name: Name in every file.
        unit: Unit; a pair (translations, rotations) for a pose or wrench; empty for an integer.
        description: Short description.
        array: Array of an .npz file that contains it; empty for a separate array.
        at_least: Smallest valid value.
        at_most: Largest valid magnitude; above the range of any device.
        optional: True if a file may lack it; it then reads as NaN.
        unknown: True if it may be NaN in all samples, like an optional field.
    """

    name: str
    unit: str | tuple[str, str]
    description: str
    array: str = ""
    at_least: float = -np.inf
    at_most: float = _FORCE
    optional: bool = False
    unknown: bool = False

    @property
    def six(self) -> bool:
        """True if the field has six components."""
        return isinstance(self.unit, tuple)

    @property
    def text(self) -> str:
        """Description followed by the units in brackets."""
        unit = ", ".join(self.unit) if isinstance(self.unit, tuple) else self.unit
        return f"{self.description} [{unit}]" if unit else self.description

    @property
    def units(self) -> Sequence[tuple[str, str]]:
        """Name and unit of each table column."""
        if isinstance(self.unit, str):
            return [(self.name, self.unit)]
        return [(f"{self.name}.{axis}", self.unit[index > 2]) for index, axis in enumerate(AXES)]


FIELDS: Sequence[Field] = (
    Field("tick", "", "sample number, counted by the plant"),
    Field("time", "s", "time of the sample, plant clock (not reset between segments of a flight)", at_most=1e9),
    Field("position", _POSE, "measured pose, input of the controller", at_most=1e3),
    Field("command", _WRENCH, "commanded wrench, held until the next command", "command"),
    Field("pulse", _WRENCH, "commanded braking pulse, added to the command", "command"),
    Field("applied", _WRENCH, "commanded wrench after the plant's limits", "applied"),
    Field("applied_pulse", _WRENCH, "braking pulse after the plant's limits", "applied"),
    Field("hand", _WRENCH, "hand's wrench from this sample on; estimated on a device; NaN if unknown", unknown=True),
    Field("pulse_width", "s", "commanded pulse duration", "command", at_least=0.0),
    Field("applied_pulse_width", "s", "pulse duration after the plant's limits", "applied", at_least=0.0),
    Field(
        "arrival",
        "s",
        "arrival time of the sample, host clock with arbitrary origin; NaN for a simulated plant",
        optional=True,
    ),
)
"""Recorded fields of each sample, in file order.

To add a field, add a line here and one in `row_of`.
"""

TOTALS: Sequence[Field] = (
    Field("taken", "J", "energy absorbed by the control laws since the segment's start; negative if generated"),
    Field("hand_work", "J", "work of the hand since the segment's start; NaN if unknown"),
    Field("missed", "", "lost samples and skipped ticks since the segment's start"),
    Field(
        "device_force",
        "N",
        "largest force of the device since the segment's start, pulses included, without weight compensation",
        optional=True,
    ),
)
"""Running totals, computed from the samples and exported with each of them."""


def _layout(fields: Sequence[Field]) -> np.dtype[np.void]:
    return np.dtype([(field.name, np.float64, (6,) if field.six else ()) for field in fields])


ROW = _layout(FIELDS)
"""Structured dtype of a recorded sample: float64 throughout."""


def _arrays() -> Mapping[str, Sequence[Field]]:
    arrays: dict[str, list[Field]] = {}
    for field in FIELDS:
        arrays.setdefault(field.array or field.name, []).append(field)
    return arrays


ARRAYS = _arrays()
"""Fields in each array of an .npz file; shapes (N,) or (N, columns)."""


def row_of(sample: Sample, command: Command, applied: Command, plant: RecordedPlant) -> Row:
    """Return the values of one tick in the order of FIELDS (unrolled: a loop takes four times as long)."""
    return (
        sample.tick,
        sample.time,
        *sample.position,
        *command.force,
        *(command.extra or ZERO),
        *applied.force,
        *(applied.extra or ZERO),
        *plant.hand_wrench,
        command.pulse_width if command.extra else 0.0,
        applied.pulse_width if applied.extra else 0.0,
        getattr(plant, "arrival", math.nan),
    )


def as_rows(values: Any, fields: Sequence[Field] = FIELDS) -> Rows:
    """Convert numbers (N, columns) to a structured array (N,)."""
    layout = _layout(fields)
    return np.ascontiguousarray(values, dtype=np.float64).reshape(-1, layout.itemsize // 8).view(layout).reshape(-1)


def as_table(rows: Rows) -> Array:
    """Convert a structured array (N,) to numbers (N, columns)."""
    return np.ascontiguousarray(rows).view(np.float64).reshape(len(rows), rows.dtype.itemsize // 8)


def schema(field: Field) -> dict[str, Any]:
    """Return the JSON schema of a field."""
    if isinstance(field.unit, tuple):
        parts = {
            axis: schema(Field(field.name, unit, f"{field.description}, {axis}"))
            for axis, (_, unit) in zip(AXES, field.units, strict=True)
        }
        return {"type": "object", "description": field.text, "properties": parts}
    if not field.unit:
        return {"type": "integer", "description": field.text}
    return {"type": "number", "unit": field.unit, "description": field.text}


def is_recorded(field: Field, values: Array) -> bool:
    """Return False if an optional field is NaN in all samples."""
    return not (field.optional and bool(np.isnan(values).all()))


def units() -> dict[str, str]:
    """Return the unit of each column, totals included; empty for integers."""
    return {name: unit for field in (*FIELDS, *TOTALS) for name, unit in field.units}


Face: TypeAlias = tuple[int, float, float]
"""Plane of a wall: index into AXES, normal, edge.

The normal is 1 or -1; the edge is in [m, rad].
"""

Setup: TypeAlias = Mapping[str, Any]
"""Setup of plant and controller as JSON values; its entry `run` is the metadata."""


_MECHANICS: Mapping[str, ArrayLike] = {
    "inertia": INERTIA,
    "load": (0.0, 0.0, -INERTIA[2] * GRAVITY, 0.0, 0.0, 0.0),
    "before": ZERO,
}
"""Defaults for plants without these attributes: the published device's values."""


def mechanics(plant: Any) -> dict[str, Array]:
    """Return inertia, load and initial wrench of a plant, see `RunMetadata`.

    The mass of a hand in a rigid grip is included: it moves with the flotor.
    """
    parts = {name: np.array(getattr(plant, name, default), np.float64) for name, default in _MECHANICS.items()}
    hand = getattr(plant, "hand", None)
    if hand is not None and not hand.soft:
        parts["inertia"][list(hand.indices)] += float(np.asarray(hand.mass))
    return parts


@dataclass(frozen=True, kw_only=True, eq=False)
class RunMetadata:
    """Metadata of a run besides its samples.

    Attributes:
        period: Sample period [s].
        delay: Delay from a sample to its command's effect [s].
        inertia: Moving mass and moments of inertia [kg, kg m²], (6,).
        load: Constant external wrench, such as the weight [N, N m], (6,).
        before: Actuator wrench before the first command takes effect [N, N m], (6,).
        carried: Actuator wrench of the weight compensation [N, N m], (6,).
        faces: Planes of all walls.
        name: Name of the run.
        axis: Main axis of the run.
        hand_recorded: True if the hand's wrench was recorded; False if it is estimated or unknown.
        hand_acts_on_flotor: True if the recorded hand acts on the flotor directly; False for a soft grip.

    Raises:
        ParameterError: If a number is outside its bounds.
    """

    period: float
    delay: float
    inertia: Array
    load: Array
    before: Array
    carried: Array
    faces: Sequence[Face] = ()
    name: str = ""
    axis: str = "z"
    hand_recorded: bool = False
    hand_acts_on_flotor: bool = True

    def __post_init__(self) -> None:
        flag("hand_recorded", self.hand_recorded)
        flag("hand_acts_on_flotor", self.hand_acts_on_flotor)

    @classmethod
    def of(
        cls,
        plant: Any,
        controller: Controller,
        *,
        name: str = "own run",
        axis: str | None = None,
        delay: float | None = None,
        hand_recorded: bool | None = None,
        **mechanical: ArrayLike,
    ) -> Self:
        """Return the metadata of a plant and its controller.

        Args:
            plant: The plant.
            controller: The controller.
            name: Name of the run.
            axis: Main axis; by default that of the first wall, or z.
            delay: Delay from a sample to its command's effect [s]; the plant's by default.
            hand_recorded: True if the hand's wrench is recorded; by default if the plant has a hand.
            mechanical: `inertia`, `load` and `before` in place of the plant's.

        Raises:
            ParameterError: If the delay is missing, a value is not finite, or an inertia is not positive.
        """
        timing = getattr(plant, "timing", plant)
        delay = getattr(timing, "delay", None) if delay is None else delay
        if delay is None:
            raise ParameterError("delay is required: the plant has neither timing nor delay")
        faces, hand, minima = controller.faces, getattr(plant, "hand", None), {"inertia": 1e-12}
        parts = {
            part: numbers(part, value, at_least=minima.get(part, -math.inf))
            for part, value in {**mechanics(plant), **mechanical}.items()
        }
        return cls(
            period=controller.period,
            delay=number("delay", delay, at_least=0.0),
            **{part: np.broadcast_to(value, 6) for part, value in parts.items()},
            carried=controller.carried,
            faces=faces,
            name=name,
            axis=axis or (AXES[faces[0][0]] if faces else "z"),
            hand_recorded=getattr(plant, "held", False) if hand_recorded is None else hand_recorded,
            hand_acts_on_flotor=hand is None or not hand.soft,
        )

    @classmethod
    def from_json(cls, values: Any) -> Self:
        """Return the metadata from JSON.

        Raises:
            ParameterError: If a value is missing or outside its bounds.
        """
        axis = value_in(values, "axis", str)
        axis_indices(axis)
        return cls(
            period=number("period", values.get("period"), above=0.0, at_most=1e3),
            delay=number("delay", values.get("delay"), at_least=0.0, at_most=1e3),
            inertia=_six(values, "inertia", at_least=1e-12),
            load=_six(values, "load"),
            before=_six(values, "before"),
            carried=_six(values, "carried"),
            faces=[_face(face) for face in value_in(values, "faces", list)],
            name=printable(value_in(values, "name", str)),
            axis=axis,
            hand_recorded=value_in(values, "hand_recorded", bool),
            hand_acts_on_flotor=value_in(values, "hand_acts_on_flotor", bool),
        )

    def as_json(self) -> dict[str, Any]:
        """Return all values as JSON values."""
        values: dict[str, Any] = {}
        for name in (entry.name for entry in fields(self)):
            value = getattr(self, name)
            values[name] = dict(zip(AXES, value.tolist(), strict=True)) if isinstance(value, np.ndarray) else value
        values["faces"] = [{"axis": AXES[axis], "normal": normal, "edge": edge} for axis, normal, edge in self.faces]
        return values


def _face(values: Any) -> Face:
    """Return the plane of a wall from JSON."""
    (axis,) = axis_indices(value_in(values, "axis", str))
    edge = number("edge", values.get("edge"), at_least=-1e3, at_most=1e3)
    normal = number("normal", values.get("normal"))
    if abs(normal) != 1.0:
        raise ParameterError(f"normal must be 1 or -1 (got {normal:g})")
    return axis, normal, edge


def _six(holder: Any, name: str, *, at_least: float = -_FORCE) -> Array:
    values = value_in(holder, name, dict)
    return np.array([number(f"{name}.{axis}", values.get(axis), at_least=at_least, at_most=_FORCE) for axis in AXES])


class Totals:
    """Running totals of absorbed energy, hand work and missed samples, and running maximum of the device's force.

    Args:
        metadata: Metadata of the segment.
    """

    def __init__(self, metadata: RunMetadata) -> None:
        timing = Timing(period=metadata.period, delay=metadata.delay)
        self._carried = metadata.carried
        load, before = self._carried + metadata.load, metadata.before - self._carried
        self._observer = PassivityObserver(timing, metadata.inertia, load, before)
        self._hand, self._missed = HandWork(), 0
        self._tick: float | None = None
        self._peak = 0.0

    def miss(self, count: int) -> None:
        """Add missed samples that leave no gap in the tick numbers."""
        self._missed += count

    def take(self, rows: Rows | Mapping[str, Array]) -> Array:
        """Return the totals at N samples, (N, 4), in the order of TOTALS.

        The result does not depend on the block size, bitwise.
        """
        poses, force = np.ascontiguousarray(rows["position"]), rows["applied"] - self._carried
        energy = self._observer.take(poses, force, rows["applied_pulse"], rows["applied_pulse_width"])
        work = self._hand.take(poses, np.ascontiguousarray(rows["hand"]))
        ticks = rows["tick"]
        # a device does not reset its tick between segments
        gaps = np.diff(ticks, prepend=ticks[:1] - 1.0 if self._tick is None else self._tick)
        missed = self._missed + np.add.accumulate(np.maximum(np.trunc(gaps) - 1.0, 0.0))
        sizes = peak_forces(force, rows["applied_pulse"], rows["applied_pulse_width"])
        peaks = np.maximum.accumulate(np.append(self._peak, sizes))[1:]
        self._tick, self._missed, self._peak = float(ticks[-1]), int(missed[-1]), float(peaks[-1])
        return np.column_stack([energy.sum(axis=1), work, missed, peaks])


def value_in(holder: Any, name: str, kind: type | None = None) -> Any:
    """Return a value of a JSON object by name.

    Args:
        holder: The object.
        name: The name.
        kind: Expected type: dict, list, str or bool; None for any.

    Raises:
        ParameterError: If it is missing or has another type.
    """
    if not isinstance(holder, Mapping) or name not in holder:
        raise ParameterError(f"{name} is missing in a message")
    value = holder[name]
    if kind is not None and not isinstance(value, kind):
        raise ParameterError(f"{name} must be {_KINDS[kind]} (got {_short(value)})")
    return value


def check_setup(value: Any) -> Setup:
    """Validate a setup and return it.

    Raises:
        ParameterError: If it is not an object with a kind and finite numbers.
    """
    setup: Setup = value_in({"setup": value}, "setup", dict)
    value_in(setup, "kind", str)
    pending: list[tuple[str, Any]] = list(setup.items())
    while pending:
        name, part = pending.pop()
        if isinstance(part, dict):
            pending += [(f"{name}.{key}", value) for key, value in part.items()]
        elif isinstance(part, list):
            pending += [(name, value) for value in part]
        elif isinstance(part, int | float) and not isinstance(part, bool):
            number(f"setup {name}", part)
    return setup


def check_rows(rows: Mapping[str, Array], first: int = 0) -> None:
    """Validate the samples of a file.

    Args:
        rows: Fields by name, (N,) or (N, 6) each.
        first: Index of the first row, for error messages.

    Raises:
        ParameterError: If a value is not finite or out of range, or ticks or times do not increase. Exceptions: the
            last command may be NaN (the plant rejected it and applied zero), and an unknown field is NaN in all rows.
    """
    tick = rows["tick"]
    _check_count(tick, "tick")
    steps = np.diff(tick)
    if not (steps >= 1.0).all():
        row = int(np.argmin(steps >= 1.0))
        raise ParameterError(f"tick must increase, not go from {tick[row]:g} to {tick[row + 1]:g}")
    missing = int(steps.sum()) - len(steps)
    if missing > _MAX_MISSING:
        raise ParameterError(f"at most {_MAX_MISSING} samples may be missing (got {missing})")
    commanded = [field.name for field in FIELDS if field.array == "command"]
    rejected = not all(np.isfinite(rows[name][-1:]).all() for name in commanded)
    if rejected and any(rows[field.name][-1:].any() for field in FIELDS if field.array == "applied"):
        raise ParameterError("applied must be zero where the command is not finite")
    for field in FIELDS:
        values = rows[field.name]
        _check_field(field, values[:-1] if rejected and field.name in commanded else values, first)
    if not (np.diff(rows["time"]) > 0.0).all():
        raise ParameterError("time must increase from sample to sample")


def _check_field(field: Field, values: Array, first: int) -> None:
    if (field.optional or field.unknown) and np.isnan(values).all():
        return
    if not field.unit:
        return _check_count(values, field.name)
    valid = np.abs(values) <= field.at_most  # False for NaN
    if not valid.all():
        row = first + int(np.argmin(valid.reshape(len(valid), -1).all(axis=1)))
        allowed = f"finite and at most {field.at_most:g}"
        raise ParameterError(f"{field.name} must be {allowed} (got {values[~valid].flat[0]:g} in row {row})")
    if not (values >= field.at_least).all():
        raise ParameterError(f"{field.name} must be at least {field.at_least:g} in all rows (got {values.min():g})")


def _check_count(values: Array, name: str) -> None:
    valid = (values >= 0.0) & (values < _MAX_INTEGER) & (values == np.floor(values))
    if not valid.all():
        raise ParameterError(f"{name} must be integers of at least 0 (got {values[~valid][0]:g})")


def _short(value: Any) -> str:
    """Return a value as a short text for a message."""
    if isinstance(value, dict | list):
        return "an object" if isinstance(value, dict) else "a list"
    text = repr(value) if not isinstance(value, int) or abs(value) < _MAX_INTEGER else "a number above 2^53"
    return text if len(text) <= 40 else f"{text[:37]}..."
