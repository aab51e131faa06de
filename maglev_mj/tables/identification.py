"""Identified parameters of a recording as text."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import groupby
from typing import NamedTuple

from maglev_mj.analysis import Estimate, Identification
from maglev_mj.frames import AXES, unit_of
from maglev_mj.terminal import wrapped

_DECIMALS, _NAME, _IN = 4, 26, "    "


class _Row(NamedTuple):
    """Row of the table of identified parameters.

    Owner, name, estimate, scale and unit of the estimate and of its residual.
    """

    whose: str
    name: str
    estimate: Estimate
    scale: float
    unit: str
    left: tuple[float, str]


def identified_lines(found: Identification) -> list[str]:
    """Return a line for each estimate.

    Parameters that cannot be identified for the same reason share a line.
    """
    lines = [f"  {'identified':<{_NAME}}{'value':>12}{'std. error':>12}  {'unit':<10}{'residual':>14}"]
    untold: dict[tuple[str, str], list[str]] = {}
    heading = ""
    for (whose, why), group in groupby(_rows(found), key=lambda row: (row.whose, row.estimate.why)):
        rows = list(group)
        if why:
            untold.setdefault((", ".join(row.name for row in rows), why), []).append(whose)
            continue
        if whose not in ("", heading):
            lines.append(f"  {whose}")
        heading = whose
        lines += map(_line, rows)
    for (names, why), all_of in untold.items():
        whose = f"of {', '.join(all_of)}: " if any(all_of) else ""
        lines += [*wrapped(f"cannot be told: {names}", further=_IN), *wrapped(whose + why, _IN)]
    if found.outside:
        lines += wrapped(f"outside the ranges in which errors were tested: {', '.join(found.outside)}", further=_IN)
    if found.samples < found.of:
        lines.append(f"  from {found.samples} of {found.of} samples: docs/explanation/analysis.md says which")
    return lines


def _line(row: _Row) -> str:
    one, (scale, unit) = row.estimate, row.left
    value, error = _rounded(one.value * row.scale, one.error * row.scale)
    left = f"{one.residual * scale:.2g} {unit}"
    name = f"{_IN if row.whose else '  '}{row.name}"
    return f"{name:<{_NAME + 2}}{value:>12}{error:>12}  {row.unit:<10}{left:>14}".rstrip()


def _rounded(value: float, error: float) -> tuple[str, str]:
    """Return a value rounded to its error, and the error.

    To the second digit of the error, at most four decimals.
    """
    decimals = min(max(1 - math.floor(math.log10(error)), 0), _DECIMALS) if error > 0.0 else _DECIMALS
    return f"{round(value, decimals) + 0.0:.{decimals}f}", f"{error:.2g}" if error < 100.0 else f"{error:.0f}"


def _units(axis: int) -> tuple[str, str, tuple[float, str], tuple[float, str]]:
    """Return the units of gains, and scale and unit of positions and forces."""
    stiff, damp, small, force = (unit_of(unit, axis) for unit in ("N/m", "N s/m", "µm", "N"))
    return stiff, damp, (1e6, small), (1.0, force)


def _rows(found: Identification) -> Iterator[_Row]:
    told = next((axis for axis, one in found.axes.items() if one.delay is found.delay), 0)
    yield _Row("", "effective delay", found.delay, 1e3, "ms", _units(told)[2])
    for wall in found.walls:
        stiff, damp, moved, said = _units(wall.face[0])
        yield _Row(wall.name, "stiffness", wall.stiffness, 1.0, stiff, moved)
        yield _Row(wall.name, "damping", wall.damping, 1.0, damp, moved)
        yield _Row(wall.name, "of largest stable", wall.share, 1e2, "%", moved)
        yield _Row(wall.name, "commanded stiffness", wall.commanded_stiffness, 1.0, stiff, said)
        yield _Row(wall.name, "commanded damping", wall.commanded_damping, 1.0, damp, said)
    for axis, rub in found.friction.items():
        stiff, damp, moved, said = _units(axis)
        name = f"friction on {AXES[axis]}"
        yield _Row(name, "stiffness", rub.stiffness, 1.0, stiff, moved)
        yield _Row(name, "commanded stiffness", rub.commanded_stiffness, 1.0, stiff, said)
        yield _Row(name, "breakaway", rub.breakaway, 1.0, said[1], said)
        yield _Row(name, "sliding", rub.sliding, 1.0, said[1], said)
        yield _Row(name, "damping", rub.damping, 1.0, damp, said)
    for axis, one in found.axes.items():
        name, (_, _, moved, said) = AXES[axis], _units(axis)
        mass = ("mass", 1.0, "kg") if axis < 3 else ("moment of inertia", 1e3, "g m²")
        yield _Row(name, mass[0], one.inertia, mass[1], mass[2], moved)
        yield _Row(name, "force not compensated", one.force_error, 1e3, f"m{said[1]}", moved)
        yield _Row(name, "noise", one.noise, *moved, moved)
        yield _Row(name, "steps", one.quantum, *moved, moved)
