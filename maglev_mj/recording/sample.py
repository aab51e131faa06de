"""A recorded sample, a run's metadata, and the checks of both in files.

One table of fields defines all file formats.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, NamedTuple, Protocol, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from maglev_mj.control.controller import Controller
from maglev_mj.control.timeline import Timing
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
_WHOLE = 2**53  # from there on a float skips whole numbers
_MISSING = 1_000_000
_KINDS = {dict: "an object", list: "a list", str: "a text", bool: "true or false"}


class RecordedPlant(Protocol):
    """Plant of `row_of`; its `arrival`, the time of the sample by the host's clock [s], is optional."""

    @property
    def hand_wrench(self) -> Sequence[Any]:
        """Hand wrench since the last sample [N, N m], six."""


class Field(NamedTuple):
    """One value of a recorded sample.

    Attributes:
        name: Name in every file.
        unit: Unit; two for the six components of a pose or wrench, of translations and of rotations; empty for a
            whole number.
        description: Short description.
        array: Array of an .npz file that holds it; empty for an array of its own.
        at_least: Smallest value in a file.
        at_most: Largest absolute value in a file; beyond the range of any device.
        optional: True if files without it are read too, as NaN.
        unknown: True if it may be NaN throughout, as an optional field.
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
        """Description with its units in brackets."""
        unit = ", ".join(self.unit) if isinstance(self.unit, tuple) else self.unit
        return f"{self.description} [{unit}]" if unit else self.description

    @property
    def units(self) -> Sequence[tuple[str, str]]:
        """Name and unit of each table column."""
        if isinstance(self.unit, str):
            return [(self.name, self.unit)]
        return [(f"{self.name}.{axis}", self.unit[index > 2]) for index, axis in enumerate(AXES)]


FIELDS: Sequence[Field] = (
    Field("tick", "", "sample number, as the plant counts"),
    Field("time", "s", "of the sample, as the plant counts: a device counts on from segment to segment", at_most=1e9),
    Field("position", _POSE, "what the controller saw", at_most=1e3),
    Field("command", _WRENCH, "what it answered, held", "command"),
    Field("pulse", _WRENCH, "what it answered, for as long as a pulse", "command"),
    Field("applied", _WRENCH, "the command after the plant's limits", "applied"),
    Field("applied_pulse", _WRENCH, "the pulse after the plant's limits", "applied"),
    Field("hand", _WRENCH, "what the hand exerts from the sample on, if known; a device's is estimated", unknown=True),
    Field("pulse_width", "s", "how long the pulse is asked for", "command", at_least=0.0),
    Field("applied_pulse_width", "s", "how long the pulse lasts", "applied", at_least=0.0),
    Field(
        "arrival",
        "s",
        "when it arrived, by the clock of the host: only changes count; not known of a simulated plant",
        optional=True,
    ),
)
"""Recorded fields of each sample, in file order.

A further value takes one further line here, and one in `row_of`.
"""

TOTALS: Sequence[Field] = (
    Field("taken", "J", "energy that the rendered world has taken in, in the segment; below 0 it has made some"),
    Field("hand_work", "J", "work of the hand in the segment, if known"),
    Field("missed", "", "samples that did not arrive, or that were not kept up with, in the segment so far"),
)
"""Running totals, computed from the samples; exports have them with each sample."""


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
"""Fields in each array of an .npz file.

Their shapes are (N,) for one number per sample, or (N, columns).
"""


def row_of(sample: Sample, command: Command, applied: Command, plant: RecordedPlant) -> Row:
    """Return the values of one cycle in the order of FIELDS; written out, for a loop takes four times as long."""
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
    """Return numbers (N, columns) as a structured array (N,)."""
    layout = _layout(fields)
    return np.ascontiguousarray(values, dtype=np.float64).reshape(-1, layout.itemsize // 8).view(layout).reshape(-1)


def as_table(rows: Rows) -> Array:
    """Return a structured array (N,) as numbers, (N, columns)."""
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
    """Return False if an optional field is NaN throughout."""
    return not (field.optional and bool(np.isnan(values).all()))


def units() -> dict[str, str]:
    """Return each column's unit, totals included; empty for whole numbers."""
    return {name: unit for field in (*FIELDS, *TOTALS) for name, unit in field.units}


Face: TypeAlias = tuple[int, float, float]
"""Plane of a wall: index into AXES, normal, edge.

The normal is 1 or -1; the edge is in [m, rad].
"""

Setup: TypeAlias = Mapping[str, Any]
"""Setup of plant and controller, ready for JSON.

Its entry `run` holds the metadata.
"""


_MECHANICS: Mapping[str, ArrayLike] = {
    "inertia": INERTIA,
    "load": (0.0, 0.0, -INERTIA[2] * GRAVITY, 0.0, 0.0, 0.0),
    "before": ZERO,
}
"""The published device's, for a plant that does not state its own."""


def mechanics(plant: Any) -> dict[str, Array]:
    """Return inertia, load and initial wrench of a plant, by default the device's; see `RunMetadata`.

    The mass of a hand in a rigid grip moves with the flotor.
    """
    parts = {name: np.array(getattr(plant, name, usual), np.float64) for name, usual in _MECHANICS.items()}
    hand = getattr(plant, "hand", None)
    if hand is not None and not hand.soft:
        parts["inertia"][list(hand.indices)] += float(np.asarray(hand.mass))
    return parts


@dataclass(frozen=True, kw_only=True, eq=False)
class RunMetadata:
    """Metadata of a run besides its samples.

    Attributes:
        period: Sample period [s].
        delay: Time from a sample to its command's effect [s].
        inertia: Moving mass and moments of inertia [kg, kg m²], (6,).
        load: Constant wrench besides the actuators' [N, N m], (6,).
        before: Wrench of the actuators until the first command takes effect [N, N m], (6,).
        carried: Wrench of the actuators that carries the flotor and renders nothing [N, N m], (6,).
        faces: All planes of walls.
        name: Name of the run.
        axis: Name of the axis that matters most.
        hand_recorded: True if the hand's wrench was recorded; False if it is estimated or not known.
        hand_acts_on_flotor: True if the recorded hand acts on the flotor directly, not through a soft grip.

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
        **stated: ArrayLike,
    ) -> Self:
        """Return the metadata of a plant and its controller.

        Args:
            plant: The plant.
            controller: The controller.
            name: Name of the run.
            axis: The axis that matters most; by default that of the first wall, or z.
            delay: Time from a sample to its command's effect [s]; the plant's by default.
            hand_recorded: True if the hand's wrench is recorded; by default if the plant has a hand.
            stated: `inertia`, `load` and `before` in place of the plant's.

        Raises:
            ParameterError: If the plant has no delay and none is given, a value is not finite, or an inertia is not
                above 0.
        """
        timing = getattr(plant, "timing", plant)
        late = getattr(timing, "delay", None) if delay is None else delay
        if late is None:
            raise ParameterError("delay must be given for a plant that has neither timing nor delay, not None")
        faces, hand, least = controller.faces, getattr(plant, "hand", None), {"inertia": 1e-12}
        parts = {
            part: numbers(part, value, at_least=least.get(part, -math.inf))
            for part, value in {**mechanics(plant), **stated}.items()
        }
        return cls(
            period=controller.period,
            delay=number("delay", late, at_least=0.0),
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
        """Return all values, ready for JSON."""
        values: dict[str, Any] = {}
        for one in fields(self):
            value = getattr(self, one.name)
            values[one.name] = dict(zip(AXES, value.tolist(), strict=True)) if isinstance(value, np.ndarray) else value
        values["faces"] = [{"axis": AXES[axis], "normal": normal, "edge": edge} for axis, normal, edge in self.faces]
        return values


def _face(values: Any) -> Face:
    """Return a plane of a wall from JSON."""
    (axis,) = axis_indices(value_in(values, "axis", str))
    edge = number("edge", values.get("edge"), at_least=-1e3, at_most=1e3)
    normal = number("normal", values.get("normal"))
    if abs(normal) != 1.0:
        raise ParameterError(f"normal must be 1 or -1, not {normal:g}")
    return axis, normal, edge


def _six(holder: Any, name: str, *, at_least: float = -_FORCE) -> Array:
    values = value_in(holder, name, dict)
    return np.array([number(f"{name}.{axis}", values.get(axis), at_least=at_least, at_most=_FORCE) for axis in AXES])


class Totals:
    """Running totals of energy, hand work and missed samples.

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

    def miss(self, count: int) -> None:
        """Count missed samples without a gap in the ticks."""
        self._missed += count

    def take(self, rows: Rows | Mapping[str, Array]) -> Array:
        """Return the totals at N samples, (N, 3).

        Energy absorbed by the rendered world [J], work of the hand [J], missed samples. The bits are the same in blocks
        of any size.
        """
        poses, force = np.ascontiguousarray(rows["position"]), rows["applied"] - self._carried
        energy = self._observer.take(poses, force, rows["applied_pulse"], rows["applied_pulse_width"])
        work = self._hand.take(poses, np.ascontiguousarray(rows["hand"]))
        ticks = rows["tick"]
        # a device counts on from segment to segment
        gaps = np.diff(ticks, prepend=ticks[:1] - 1.0 if self._tick is None else self._tick)
        missed = self._missed + np.add.accumulate(np.maximum(np.trunc(gaps) - 1.0, 0.0))
        self._tick, self._missed = float(ticks[-1]), int(missed[-1])
        return np.column_stack([energy.sum(axis=1), work, missed])


def parsed(text: bytes | str) -> Any:
    """Parse JSON text.

    Raises:
        ParameterError: If it is not JSON, or has a number outside JSON, such as NaN.
    """
    try:
        return json.loads(text, parse_constant=_refuse)
    except ParameterError:
        raise
    except (ValueError, RecursionError):
        raise ParameterError("a message is not JSON") from None


def value_in(holder: Any, name: str, kind: type | None = None) -> Any:
    """Return the value of the given name in a JSON object.

    Args:
        holder: The object.
        name: The name.
        kind: Type of the value: dict, list, str or bool; None for any.

    Raises:
        ParameterError: If it is missing or of another type.
    """
    if not isinstance(holder, Mapping) or name not in holder:
        raise ParameterError(f"a message must have {name}")
    value = holder[name]
    if kind is not None and not isinstance(value, kind):
        raise ParameterError(f"{name} must be {_KINDS[kind]}, not {shown(value)}")
    return value


def check_setup(value: Any) -> Setup:
    """Return a setup after checking its kind and numbers.

    Raises:
        ParameterError: If it is not an object with a kind and finite numbers.
    """
    setup: Setup = value_in({"setup": value}, "setup", dict)
    value_in(setup, "kind", str)
    waiting: list[tuple[str, Any]] = list(setup.items())
    while waiting:
        name, part = waiting.pop()
        if isinstance(part, dict):
            waiting += [(f"{name}.{key}", one) for key, one in part.items()]
        elif isinstance(part, list):
            waiting += [(name, one) for one in part]
        elif isinstance(part, int | float) and not isinstance(part, bool):
            number(f"setup {name}", part)
    return setup


def check_rows(rows: Mapping[str, Array], first: int = 0) -> None:
    """Check the samples of a file.

    Args:
        rows: Fields by name, (N,) or (N, 6) each.
        first: Number of the first row, for the message.

    Raises:
        ParameterError: If a number is not finite or out of range, or ticks or times do not increase. Only the last
            command may be NaN: the plant refused it and applied nothing. An unknown field is NaN throughout.
    """
    tick = rows["tick"]
    _check_count(tick, "tick")
    steps = np.diff(tick)
    if not (steps >= 1.0).all():
        row = int(np.argmin(steps >= 1.0))
        raise ParameterError(f"tick must go up, not from {tick[row]:g} to {tick[row + 1]:g}")
    missing = int(steps.sum()) - len(steps)
    if missing > _MISSING:
        raise ParameterError(f"at most {_MISSING} samples may be missing, not {missing}")
    commanded = [field.name for field in FIELDS if field.array == "command"]
    refused = not all(np.isfinite(rows[name][-1:]).all() for name in commanded)
    if refused and any(rows[field.name][-1:].any() for field in FIELDS if field.array == "applied"):
        raise ParameterError("a command that is not finite must be applied as zero")
    for field in FIELDS:
        values = rows[field.name]
        _check_field(field, values[:-1] if refused and field.name in commanded else values, first)
    if not (np.diff(rows["time"]) > 0.0).all():
        raise ParameterError("time must go up from sample to sample")


def _check_field(field: Field, values: Array, first: int) -> None:
    if (field.optional or field.unknown) and np.isnan(values).all():
        return
    if not field.unit:
        return _check_count(values, field.name)
    good = np.abs(values) <= field.at_most  # NaN is not
    if not good.all():
        row = first + int(np.argmin(good.reshape(len(good), -1).all(axis=1)))
        allowed = f"finite and at most {field.at_most:g}"
        raise ParameterError(f"{field.name} must be {allowed}, not {values[~good].flat[0]:g} in row {row}")
    if not (values >= field.at_least).all():
        raise ParameterError(f"{field.name} must be at least {field.at_least:g} everywhere, not {values.min():g}")


def _check_count(values: Array, name: str) -> None:
    good = (values >= 0.0) & (values < _WHOLE) & (values == np.floor(values))
    if not good.all():
        raise ParameterError(f"{name} must be whole numbers of at least 0, not {values[~good][0]:g}")


def shown(value: Any) -> str:
    """Return a value of any size as a short text."""
    if isinstance(value, dict | list):
        return "an object" if isinstance(value, dict) else "a list"
    text = repr(value) if not isinstance(value, int) or abs(value) < _WHOLE else "a number beyond them"
    return text if len(text) <= 40 else f"{text[:37]}..."


def _refuse(constant: str) -> None:
    raise ParameterError(f"numbers must be finite, not {constant}")
