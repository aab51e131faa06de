"""Numbers and texts out of recordings: every one that a file holds is checked here, whichever kind of file it is."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Array
from maglev_mj.parameters import number
from maglev_mj.recording.stretch import Setup, Stretch

__all__ = ["check_setup", "checked", "object_in", "parsed", "sample_row", "six", "start_in", "text_in", "whole"]

_WHOLE = 2**53  # from there on a float skips whole numbers
_MISSING = 1_000_000
_FORCE = 1e12
# what lies beyond is none of a device's, and overflows before it says anything
_BOUNDS = {"time": 1e9, "position": 1e3, "command": _FORCE, "applied": _FORCE, "hand": _FORCE, "totals": 1e15}
_COMMANDED = slice(8, 21)  # of a row: what may be no number, where the plant refused it


def parsed(text: bytes | str) -> Any:
    """Return what JSON says.

    Raises:
        ParameterError: If it is none, or has a number that JSON does not know, such as NaN.
    """
    try:
        return json.loads(text, parse_constant=_refuse)
    except ParameterError:
        raise
    except (ValueError, RecursionError):
        raise ParameterError("a message is not JSON") from None


def object_in(holder: Any, name: str) -> Mapping[str, Any]:
    """Return the object of a name.

    Raises:
        ParameterError: If there is none.
    """
    found: Mapping[str, Any] = _of_kind(dict, "an object", holder, name)
    return found


def text_in(holder: Any, name: str) -> str:
    """Return the text of a name.

    Raises:
        ParameterError: If there is none.
    """
    return str(_of_kind(str, "a text", holder, name))


def whole(holder: Any, name: str, *, at_least: int = 0, at_most: int = _WHOLE) -> int:
    """Return the whole number of a name.

    Raises:
        ParameterError: If there is none, or it is outside the bounds.
    """
    value = _value(holder, name)
    if value.__class__ is not int or not at_least <= value <= at_most:
        bounds = f"{at_least}" if at_least == at_most else f"a whole number from {at_least} to {at_most}"
        raise ParameterError(f"{name} must be {bounds}, not {_shown(value)}")
    return int(value)


def six(holder: Any, name: str, *, at_least: float = -_FORCE) -> list[float]:
    """Return the numbers that a name has for each axis.

    Raises:
        ParameterError: If one is missing, or outside its bounds.
    """
    values = object_in(holder, name)
    return [number(f"{name}.{axis}", _value(values, axis, of=name), at_least=at_least, at_most=_FORCE) for axis in AXES]


def start_in(setup: Setup) -> dict[str, list[float]]:
    """Return pose, twist and wrench with which a setup starts, six each [m, rad; m/s, rad/s; N, N m].

    Raises:
        ParameterError: If there is none, or it is outside its bounds.
    """
    found = {}
    for name, most in (("pose", _BOUNDS["position"]), ("twist", _BOUNDS["position"]), ("wrench", _FORCE)):
        values = _value(setup, name, of="a setup")
        if not isinstance(values, list) or len(values) != len(AXES):
            raise ParameterError(f"{name} must be a list of {len(AXES)} numbers, not {_shown(values)}")
        found[name] = [number(name, value, at_least=-most, at_most=most) for value in values]
    return found


def check_setup(value: Any) -> Setup:
    """Return what plant and controller were made from, if it is an object with a kind and finite numbers.

    Raises:
        ParameterError: If it is not.
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
        elif isinstance(part, float):
            number(f"setup {name}", part)
    return setup


def sample_row(sample: Any) -> list[float]:
    """Return the 43 numbers of a sample: a `Row`, and the totals up to it; a command that was not finite is NaN.

    Raises:
        ParameterError: If one is missing, or no number.
    """
    try:
        parts = [[sample[name][axis] for axis in AXES] for name in _SIXES]
        command, pulse, applied, applied_pulse = parts[1:5]
        given = [*command, *pulse, sample["pulse_width"]]
        done = [*applied, *applied_pulse, sample["applied_pulse_width"]]
        totals = [sample[name] for name in _TOTALS]
        row = [sample["tick"], sample["time"], *parts[0], *given, *done, *parts[5], *totals]
    except (KeyError, TypeError):
        names = ", ".join((*_SIXES, "pulse_width", "applied_pulse_width", *_TOTALS))
        raise ParameterError(f"a sample must have tick, time, {names}") from None
    whole(sample, "tick")
    whole(sample, "missed")
    if not set(map(type, row)) <= _NUMBERS:
        for place, value in enumerate(row):
            if value is None and place in range(_COMMANDED.start, _COMMANDED.stop):
                row[place] = math.nan
            elif type(value) not in _NUMBERS:
                raise ParameterError(f"a sample must be of numbers, not {_shown(value)}")
    try:
        return [float(value) for value in row]
    except OverflowError:
        raise ParameterError("a sample must be of numbers that a float can hold") from None


_SIXES = ("position", "command", "pulse", "applied", "applied_pulse", "hand")
_TOTALS = ("taken", "hand_work", "missed")
_NUMBERS = {float, int}


def checked(stretch: Stretch) -> Stretch:
    """Return a stretch out of a file.

    Raises:
        ParameterError: If a number in it is not finite or out of range, or its samples do not go on and on. The last
            command alone may be what is no number: the plant refused it, and applied nothing.
    """
    _check_count(stretch.tick, "tick")
    steps = np.diff(stretch.tick)
    if not (steps >= 1.0).all():
        row = int(np.argmin(steps >= 1.0))
        raise ParameterError(f"tick must go up, not from {stretch.tick[row]:g} to {stretch.tick[row + 1]:g}")
    missing = int(steps.sum()) - len(steps)
    if missing > _MISSING:
        raise ParameterError(f"at most {_MISSING} samples may be missing, not {missing}")
    command = stretch.command
    if len(command) and not np.isfinite(command[-1]).all():
        if stretch.applied[-1].any():
            raise ParameterError("a command that is not finite must be applied as zero")
        command = command[:-1]
    arrays: dict[str, Array | None] = {
        **{name: getattr(stretch, name) for name in ("time", "position", "applied", "hand", "totals")},
        "command": command,
    }
    for name, values in arrays.items():
        if values is not None:
            _check_size(name, values, _BOUNDS[name])
    for name, widths in (("pulse_width", command[:, 12]), ("applied_pulse_width", stretch.applied[:, 12])):
        if not (widths >= 0.0).all():
            raise ParameterError(f"{name} must be at least 0 everywhere, not {widths.min():g}")
    if not (np.diff(stretch.time) > 0.0).all():
        raise ParameterError("time must go up from sample to sample")
    if stretch.totals is not None:
        _check_count(stretch.totals[:, 2], "missed")
    return stretch


def _check_size(name: str, values: Array, most: float) -> None:
    good = np.abs(values) <= most  # NaN is not
    if not good.all():
        row = int(np.argmin(good.reshape(len(good), -1).all(axis=1)))
        raise ParameterError(f"{name} must be finite and at most {most:g}, not {values[~good].flat[0]:g} in row {row}")


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
        raise ParameterError(f"{name} must be {what}, not {_shown(value)}")
    return value


def _shown(value: Any) -> str:
    """Return a value of any size as a few letters."""
    if isinstance(value, dict | list):
        return "an object" if isinstance(value, dict) else "a list"
    text = repr(value) if not isinstance(value, int) or abs(value) < _WHOLE else "a number beyond them"
    return text if len(text) <= 40 else f"{text[:37]}..."


def _refuse(constant: str) -> None:
    raise ParameterError(f"numbers must be finite, not {constant}")
