"""Recorded sample: one table that defines all file formats."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from maglev_mj.frames import AXES, ZERO, Array

Row: TypeAlias = Sequence[float]
"""Values of one sample in FIELDS order, components flattened."""

Rows: TypeAlias = NDArray[np.void]
"""N samples: a structured array (N,)."""

_POSE, _WRENCH, _FORCE = ("m", "rad"), ("N", "N m"), 1e12


class RecordedPlant(Protocol):
    """Plant in the expressions of `Field.value`."""

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
        value: Expression in `sample`, `command`, `applied` and `plant`; empty for a running total.
        array: Array of an .npz file that holds it; empty for an array of its own.
        at_least: Smallest value in a file.
        at_most: Largest absolute value in a file; beyond the range of any device.
        optional: True if files without it are read too, as NaN.
        unknown: True if it may be NaN throughout, as an optional field.
    """

    name: str
    unit: str | tuple[str, str]
    description: str
    value: str = ""
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
    def units(self) -> Sequence[tuple[str, str]]:
        """Name and unit of each table column."""
        if isinstance(self.unit, str):
            return [(self.name, self.unit)]
        return [(f"{self.name}.{axis}", self.unit[index > 2]) for index, axis in enumerate(AXES)]


FIELDS: Sequence[Field] = (
    Field("tick", "", "sample number, as the plant counts", "sample.tick"),
    Field(
        "time",
        "s",
        "of the sample, as the plant counts: a device counts on from stretch to stretch",
        "sample.time",
        at_most=1e9,
    ),
    Field("position", _POSE, "what the controller saw", "sample.position", at_most=1e3),
    Field("command", _WRENCH, "what it answered, held", "command.force", "command"),
    Field("pulse", _WRENCH, "what it answered, for as long as a pulse", "command.extra or ZERO", "command"),
    Field("applied", _WRENCH, "the command after the plant's limits", "applied.force", "applied"),
    Field("applied_pulse", _WRENCH, "the pulse after the plant's limits", "applied.extra or ZERO", "applied"),
    Field("hand", _WRENCH, "what the hand exerts from the sample on, if known", "plant.hand_wrench", unknown=True),
    Field(
        "pulse_width",
        "s",
        "how long the pulse is asked for",
        "command.pulse_width if command.extra else 0.0",
        "command",
        at_least=0.0,
    ),
    Field(
        "applied_pulse_width",
        "s",
        "how long the pulse lasts",
        "applied.pulse_width if applied.extra else 0.0",
        "applied",
        at_least=0.0,
    ),
    Field(
        "arrival",
        "s",
        "when it arrived, by the clock of the host: only changes count; not known of a simulated plant",
        "plant.arrival",
        optional=True,
    ),
)
"""Recorded fields of each sample, in file order.

A further value takes one further line here.
"""

TOTALS: Sequence[Field] = (
    Field(
        "taken",
        "J",
        "energy that the rendered world has taken in, in the stretch; below 0 it has made some",
        at_most=1e15,
    ),
    Field("hand_work", "J", "work of the hand in the stretch, if known", at_most=1e15, unknown=True),
    Field("missed", "", "samples that did not arrive, or that were not kept up with, in the stretch so far"),
)
"""Running totals, stored in MCAP files with each sample."""


def _layout(fields: Sequence[Field]) -> np.dtype[np.void]:
    return np.dtype([(field.name, np.float64, (6,) if field.six else ()) for field in fields])


ROW = _layout(FIELDS)
"""Structured dtype of a recorded sample: float64 throughout."""


def _arrays() -> Mapping[str, Sequence[Field]]:
    found: dict[str, list[Field]] = {}
    for field in FIELDS:
        found.setdefault(field.array or field.name, []).append(field)
    return found


ARRAYS = _arrays()
"""Fields in each array of an .npz file.

Their shapes are (N,) for one number per sample, or (N, columns).
"""


def compiled(arguments: str, template: str, fields: Sequence[Field] = FIELDS, **names: Any) -> Callable[..., Any]:
    """Return a compiled function of a sample's values.

    Generated as source, because a loop over FIELDS takes four times as long in the control tick.

    Args:
        arguments: Names of the function's arguments.
        template: Body of the function, with {values} for the sequence of all values.
        fields: Fields of the values.
        names: Further names used in the body.
    """
    sources = ((field, _source(field, names.get("plant"))) for field in fields)
    values = ", ".join(f"*({source})" if field.six else f"({source})" for field, source in sources)
    known: dict[str, Any] = {"NAN": math.nan, "ZERO": ZERO, **names}
    body = template.format(values=values).replace("\n", "\n    ")
    exec(f"def made({arguments}):\n    {body}", known)
    made: Callable[..., Any] = known["made"]
    return made


def _source(field: Field, plant: RecordedPlant | None) -> str:
    """Return the expression of a field; NaN if not available.

    An optional field of the plant may be missing; without a plant that is checked later.
    """
    of, _, name = field.value.partition(".")
    if not field.optional or of != "plant":
        return field.value
    if plant is None:
        return f"getattr(plant, {name!r}, NAN)"
    return field.value if hasattr(plant, name) else "NAN"


def as_rows(values: Any, fields: Sequence[Field] = FIELDS) -> Rows:
    """Return numbers (N, columns) as a structured array (N,)."""
    layout = _layout(fields)
    return np.ascontiguousarray(values, dtype=np.float64).reshape(-1, layout.itemsize // 8).view(layout).reshape(-1)


def as_table(rows: Rows) -> Array:
    """Return a structured array (N,) as numbers, (N, columns)."""
    return np.ascontiguousarray(rows).view(np.float64).reshape(len(rows), rows.dtype.itemsize // 8)


def _places() -> Iterator[tuple[str, int | slice]]:
    start = 0
    for field in FIELDS:
        yield field.name, slice(start, start + 6) if field.six else start
        start += len(field.units)


_PLACES = dict(_places())


def named(row: Row) -> dict[str, Any]:
    """Return a sample's values by name, six components as sequence."""
    return {name: row[place] for name, place in _PLACES.items()}


def schema(field: Field) -> dict[str, Any]:
    """Return the JSON schema of a field."""
    if isinstance(field.unit, tuple):
        parts = {
            axis: schema(Field(field.name, unit, f"{field.description}, {axis}"))
            for axis, (_, unit) in zip(AXES, field.units, strict=True)
        }
        return {"type": "object", "description": field.description, "properties": parts}
    if not field.unit:
        return {"type": "integer", "description": field.description}
    return {"type": "number", "unit": field.unit, "description": f"{field.description} [{field.unit}]"}


def told(field: Field, values: Array) -> bool:
    """Return False if an optional field is NaN throughout."""
    return not (field.optional and bool(np.isnan(values).all()))


def units() -> dict[str, str]:
    """Return each column's unit, totals included; empty for whole numbers."""
    return {name: unit for field in (*FIELDS, *TOTALS) for name, unit in field.units}
