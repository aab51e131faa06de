"""Sweeps of parameters, in part for the gate."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product
from typing import Any

import pytest


def sweep(*axes: Iterable[Any], every: int) -> list[Any]:
    """Return all combinations, for the gate one in `every`.

    The gate has those whose indices sum to a multiple of `every`; with axes of as many values each pair of values is
    among them. The rest are marked as studies.
    """
    numbered = [tuple(enumerate(axis)) for axis in axes]
    return [
        pytest.param(
            *(value for _, value in case),
            marks=[pytest.mark.study] if sum(place for place, _ in case) % every else [],
        )
        for case in product(*numbered)
    ]


def further(*cases: Any) -> list[Any]:
    """Return cases for the studies, beside those of the gate; a tuple has a value for each name."""
    return [pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.study) for case in cases]
