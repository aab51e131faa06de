"""Samples as protobuf messages of one fixed layout.

Every value is written at its full width, so that all messages of a file have the same layout: a writer
packs them at once, and a reader takes thousands of them as one array. Any decoder of protobuf reads them by name.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.lib.stride_tricks import as_strided

from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Array
from maglev_mj.recording.row import FIELDS, TOTALS, Field, Row

NAME = "maglev_mj.Sample"
"""Full name of the message type."""

STRETCH = Field("stretch", "", "number of the stretch, from 0")
"""Name of the stretch number, first field of a sample."""

_NUMBERED: Sequence[Field] = (
    STRETCH,
    *(field for field in FIELDS if not field.optional),
    *TOTALS,
    *(field for field in FIELDS if field.optional),
)
"""Fields in the order of their numbers, from 1.

New fields are optional and come last.
"""

_SIX = "SixAxes"
_VARINT, _FIXED64, _BYTES = 0, 1, 2
_DOUBLE_TYPE, _MESSAGE_TYPE, _FIXED64_TYPE, _OPTIONAL = 1, 11, 6, 1
_NUMBER_SIZE, _SIX_SIZE = 8, 6 * 9


def _varint(value: int) -> bytes:
    found = b""
    while value > 0x7F:
        found, value = found + bytes([value & 0x7F | 0x80]), value >> 7
    return found + bytes([value])


def _part(number: int, value: int | str | bytes) -> bytes:
    """Return one field of a descriptor."""
    if isinstance(value, int):
        return _varint(number << 3 | _VARINT) + _varint(value)
    data = value.encode() if isinstance(value, str) else value
    return _varint(number << 3 | _BYTES) + _varint(len(data)) + data


def _message(name: str, fields: Sequence[tuple[str, int, str]]) -> bytes:
    """Return the descriptor of a message.

    Each field has a name, a type and the type's name.
    """
    parts = [_part(1, name)]
    for number, (field, kind, of) in enumerate(fields, 1):
        about = _part(1, field) + _part(3, number) + _part(4, _OPTIONAL) + _part(5, kind)
        parts.append(_part(2, about + (_part(6, of) if of else b"")))
    return b"".join(parts)


def descriptor() -> bytes:
    """Return the schema of a sample, a FileDescriptorSet."""
    package, name = NAME.split(".")
    fields = [
        (field.name, _MESSAGE_TYPE, f".{package}.{_SIX}")
        if field.six
        else (field.name, _DOUBLE_TYPE if field.unit else _FIXED64_TYPE, "")
        for field in _NUMBERED
    ]
    six = _message(_SIX, [(axis, _DOUBLE_TYPE, "") for axis in AXES])
    messages = _part(4, six) + _part(4, _message(name, fields))
    return _part(1, _part(1, f"{package}.proto") + _part(2, package) + messages + _part(12, "proto3"))


def _head(field: Field) -> bytes:
    """Return the bytes in front of a field's value."""
    number = _NUMBERED.index(field) + 1
    if field.six:
        return _varint(number << 3 | _BYTES) + bytes([_SIX_SIZE])
    return _varint(number << 3 | _FIXED64)


class _Value(NamedTuple):
    """Number in a message: preceding bytes and type code."""

    head: bytes
    code: str


def _values(fields: Sequence[Field]) -> list[_Value]:
    found = []
    for field in fields:
        head, code = _head(field), "d" if field.unit else "Q"
        for place in range(len(field.units)):
            inner = bytes([place + 1 << 3 | _FIXED64]) if field.six else b""
            found.append(_Value(head + inner if not place else inner, code))
    return found


_WRITTEN = _values((STRETCH, *FIELDS, *TOTALS))
_STRUCT = struct.Struct("<" + "".join(f"{len(value.head)}s{value.code}" for value in _WRITTEN))
_PARTS = [part for value in _WRITTEN for part in (value.head, None)]
_WHOLE = [place for place, value in enumerate(_WRITTEN) if value.code == "Q"]


def packed(stretch: int, row: Row, totals: Row) -> bytes:
    """Return a sample as a message.

    Args:
        stretch: Number of the stretch.
        row: Values in the order of FIELDS.
        totals: Running totals in the order of TOTALS.
    """
    values: list[float] = [stretch, *row, *totals]
    for place in _WHOLE:
        values[place] = int(values[place])
    parts = _PARTS.copy()
    parts[1::2] = values  # type: ignore[assignment]
    return _STRUCT.pack(*parts)


MessageArray: TypeAlias = "np.ndarray[tuple[int, int], np.dtype[np.uint8]]"
"""Messages of one layout, (N, size) bytes."""


class Layout:
    """Layout of a sample's message: byte position of each number.

    Args:
        fields: Fields in their order; a number stands for that many unknown bytes.

    Attributes:
        size: Size of a message [bytes].
    """

    def __init__(self, fields: Sequence[Field | int]) -> None:
        heads: list[int] = []
        expected, at = b"", 0
        self._places: dict[str, int] = {}
        for field in fields:
            if isinstance(field, int):
                at += field
                continue
            for value in _values([field]):
                heads += range(at, at + len(value.head))
                at, expected = at + len(value.head), expected + value.head
                self._places.setdefault(field.name, at)
                at += _NUMBER_SIZE
        self.size = at
        self._heads, self._expected = np.array(heads), np.frombuffer(expected, np.uint8)

    def check(self, messages: MessageArray) -> None:
        """Check that messages have this layout.

        Raises:
            ParameterError: If one has another layout.
        """
        if not (messages[:, self._heads] == self._expected).all():
            raise ParameterError("the samples of a file must all have the same fields")

    def values(self, messages: MessageArray, field: Field) -> Array:
        """Return a field of messages, NaN if missing.

        The shape is (N,) or (N, 6).
        """
        at = self._places.get(field.name)
        count = len(messages)
        if at is None:
            return np.full((count, 6) if field.six else count, np.nan)
        kind = np.dtype("<f8" if field.unit else "<u8")
        values = messages[:, at : at + _NUMBER_SIZE].view(kind)
        if field.six:
            values = as_strided(values, (count, 6), (values.strides[0], _SIX_SIZE // 6))
        found = values.astype(np.float64)
        return found if field.six else found[:, 0]


def layout_of(message: bytes) -> Layout:
    """Return the layout of a message; unknown fields are skipped.

    Raises:
        ParameterError: If it is no message of a sample.
    """
    heads = {_head(field): field for field in _NUMBERED}
    fields: list[Field | int] = []
    at, stop = 0, len(message)
    while at < stop:
        start, (tag, at) = at, _number_at(message, at)
        size, after = _number_at(message, at) if tag & 7 == _BYTES else (_NUMBER_SIZE, at)
        field, at = heads.pop(message[start:after], None), after + size
        if tag & 7 not in (_BYTES, _FIXED64) or (field is None and tag >> 3 <= len(_NUMBERED)):
            raise ParameterError("a sample must have the fields that its schema says, each once")
        fields.append(at - start if field is None else field)
    missing = [field.name for field in _NUMBERED if field not in fields and not field.optional]
    if missing or at != stop:
        raise ParameterError(f"a sample must have {', '.join(missing) or 'all its bytes'}")
    layout = Layout(fields)
    layout.check(np.frombuffer(message, np.uint8)[None])
    return layout


def _number_at(message: bytes, at: int) -> tuple[int, int]:
    """Return a variable-length number and the offset behind it."""
    found = shift = 0
    while at < len(message) and shift < 63:
        found |= (message[at] & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if message[at - 1] < 0x80:
            return found, at
    raise ParameterError("a sample must have all its bytes")
