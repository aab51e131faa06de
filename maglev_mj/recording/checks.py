"""Checks of values and sizes in files of any format."""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Array
from maglev_mj.parameters import number
from maglev_mj.recording.row import FIELDS, TOTALS, Field

if TYPE_CHECKING:
    from mcap.records import Chunk

_WHOLE = 2**53  # from there on a float skips whole numbers
_MISSING = 1_000_000
_FORCE, _POSE = 1e12, 1e3
LARGEST_PART = 64 << 20
"""Largest unpacked size of a compressed part [bytes].

A part is a chunk or an array.
"""

_TIMES = 1000
_KEPT_TIMES = 100
_KEPT = 1 << 20


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


def object_in(holder: Any, name: str) -> Mapping[str, Any]:
    """Return the object of the given name.

    Raises:
        ParameterError: If it is missing or of another type.
    """
    found: Mapping[str, Any] = _of_kind(dict, "an object", holder, name)
    return found


def text_in(holder: Any, name: str) -> str:
    """Return the text of the given name.

    Raises:
        ParameterError: If it is missing or of another type.
    """
    return str(_of_kind(str, "a text", holder, name))


def list_in(holder: Any, name: str) -> list[Any]:
    """Return the list of the given name.

    Raises:
        ParameterError: If it is missing or of another type.
    """
    return list(_of_kind(list, "a list", holder, name))


def flag_in(holder: Any, name: str) -> bool:
    """Return the boolean of the given name.

    Raises:
        ParameterError: If it is missing or of another type.
    """
    return bool(_of_kind(bool, "true or false", holder, name))


def whole(holder: Any, name: str, *, at_least: int = 0, at_most: int = _WHOLE) -> int:
    """Return the whole number of the given name.

    Raises:
        ParameterError: If it is missing, of another type or outside the bounds.
    """
    value = _value(holder, name)
    if value.__class__ is not int or not at_least <= value <= at_most:
        bounds = f"{at_least}" if at_least == at_most else f"a whole number from {at_least} to {at_most}"
        raise ParameterError(f"{name} must be {bounds}, not {shown(value)}")
    return int(value)


def six(holder: Any, name: str, *, at_least: float = -_FORCE) -> list[float]:
    """Return the six axis values of the given name.

    Raises:
        ParameterError: If a value is missing or outside its bounds.
    """
    values = object_in(holder, name)
    return [number(f"{name}.{axis}", _value(values, axis, of=name), at_least=at_least, at_most=_FORCE) for axis in AXES]


def start_in(setup: Mapping[str, Any]) -> dict[str, list[float]]:
    """Return the initial pose, twist and wrench of a setup.

    Six each, [m, rad], [m/s, rad/s] and [N, N m].

    Raises:
        ParameterError: If one is missing or outside its bounds.
    """
    found = {}
    for name, most in (("pose", _POSE), ("twist", _POSE), ("wrench", _FORCE)):
        values = _value(setup, name, of="a setup")
        if not isinstance(values, list) or len(values) != len(AXES):
            raise ParameterError(f"{name} must be a list of {len(AXES)} numbers, not {shown(values)}")
        found[name] = [number(name, value, at_least=-most, at_most=most) for value in values]
    return found


def check_setup(value: Any) -> Mapping[str, Any]:
    """Return a setup after checking its kind and numbers.

    Raises:
        ParameterError: If it is not an object with a kind and finite numbers.
    """
    setup = object_in({"setup": value}, "setup")
    text_in(setup, "kind")
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
    """Check the samples of a file, and their totals.

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
    for field in (*FIELDS, *TOTALS):
        if field.name in rows:
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


def _value(holder: Any, name: str, of: str = "a message") -> Any:
    if not isinstance(holder, Mapping) or name not in holder:
        raise ParameterError(f"{of} must have {name}")
    return holder[name]


def _of_kind(kind: type, what: str, holder: Any, name: str) -> Any:
    value = _value(holder, name)
    if not isinstance(value, kind):
        raise ParameterError(f"{name} must be {what}, not {shown(value)}")
    return value


def shown(value: Any) -> str:
    """Return a value of any size as a short text."""
    if isinstance(value, dict | list):
        return "an object" if isinstance(value, dict) else "a list"
    text = repr(value) if not isinstance(value, int) or abs(value) < _WHOLE else "a number beyond them"
    return text if len(text) <= 40 else f"{text[:37]}..."


def _refuse(constant: str) -> None:
    raise ParameterError(f"numbers must be finite, not {constant}")


class UnpackingError(ValueError):
    """Unpacked part of a file is too large, or invalid."""


class Allowance:
    """Memory budget for unpacking a file.

    It exceeds the needs of any recording, and is too small to exhaust the memory.

    Args:
        size: Size of the file [bytes].
    """

    def __init__(self, size: int) -> None:
        self._left, self._kept = LARGEST_PART + _TIMES * size, _KEPT + _KEPT_TIMES * size

    def part(self, size: int) -> None:
        """Count a part's size [bytes] before it is unpacked.

        Raises:
            UnpackingError: If the part or the sum of all parts is too large.
        """
        if size > LARGEST_PART:
            raise UnpackingError(f"a part of it must unpack to at most {LARGEST_PART} bytes, not {size}")
        self._left -= size
        if self._left < 0:
            raise UnpackingError(f"it must unpack to at most {_TIMES} times its size")

    def text(self, size: int) -> None:
        """Count the size of a text to be kept [bytes].

        As objects it takes many times that memory.

        Raises:
            UnpackingError: If the sum of all texts is too large.
        """
        self._kept -= size
        if self._kept < 0:
            raise UnpackingError(f"its texts must be at most {_KEPT_TIMES} times its size")


def unpacked(chunk: Chunk) -> bytes:
    """Return the content of a chunk of checked size.

    Raises:
        UnpackingError: If the size is not as declared, or the compression is not known.
        Exception: Error of the unpacking package, if the chunk is damaged.
    """
    size = chunk.uncompressed_size
    if chunk.compression == "zstd":
        import zstandard

        data = zstandard.ZstdDecompressor(max_window_size=LARGEST_PART).stream_reader(chunk.data).read(size + 1)
    elif chunk.compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

        data = LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    elif chunk.compression == "":
        data = chunk.data
    else:
        raise UnpackingError(f"a chunk must be packed by zstd or lz4, not {chunk.compression[:20]!r}")
    if len(data) != size:
        raise UnpackingError(f"a chunk must unpack to {size} bytes, as it says")
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise UnpackingError("a chunk must have the checksum that it says")
    return data
