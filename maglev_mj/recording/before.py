"""JSON samples of older files."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES
from maglev_mj.recording.checks import shown, whole
from maglev_mj.recording.row import FIELDS, TOTALS

_ALL = (*FIELDS, *TOTALS)
_WHOLE_FIELDS = [field.name for field in _ALL if not field.unit]
_NUMBERS = {float, int}
_COLUMNS = [field for field in FIELDS for _ in field.units]
_COMMANDED = {index for index, field in enumerate(_COLUMNS) if field.array == "command"}
"""Columns that may be NaN for a refused command."""


def sample_row(sample: Any) -> list[float]:
    """Return sample values and totals; non-finite commands as NaN.

    Raises:
        ParameterError: If a value is missing or is not a number.
    """
    row: list[Any] = []
    try:
        for field in _ALL:
            if field.optional and field.name not in sample:
                row += [np.nan] * len(field.units)
            elif field.six:
                row += [sample[field.name][axis] for axis in AXES]
            else:
                row.append(sample[field.name])
    except (KeyError, TypeError):
        names = ", ".join(field.name for field in _ALL if not field.optional)
        raise ParameterError(f"a sample must have {names}") from None
    for name in _WHOLE_FIELDS:
        whole(sample, name)
    if not set(map(type, row)) <= _NUMBERS:
        for index, value in enumerate(row):
            if value is None and index in _COMMANDED:
                row[index] = math.nan
            elif type(value) not in _NUMBERS:
                raise ParameterError(f"a sample must be of numbers, not {shown(value)}")
    try:
        return [float(value) for value in row]
    except OverflowError:
        raise ParameterError("a sample must be of numbers that a float can hold") from None
