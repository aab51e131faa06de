"""The device's numbers have one home."""

from __future__ import annotations

import ast
import dataclasses
from collections.abc import Iterator
from pathlib import Path

import pytest

from maglev_mj.spec import DRIVER_TIME_CONSTANT, ESCAPE, GRAVITY, RESOLUTION, Quantity, Spec

ROOT = Path(__file__).resolve().parents[1]

OWN = {GRAVITY, DRIVER_TIME_CONSTANT} | {
    quantity.value
    for quantity in (
        *(Spec.radius, Spec.flotor_mass, Spec.translation_range, Spec.coil_radius),
        *(Spec.spot_resolution, Spec.tilt_inertia, Spec.spin_inertia),
    )
}
"""Device numbers that no float may repeat."""

DEFAULTS = {
    "mass": {Spec.moving_mass.value},
    "period": {1.0 / Spec.control_rate.value},
    "delay": {Spec.transport_delay.value},
    "current": {Spec.peak_current.value},
    "continuous_current": {Spec.continuous_current.value},
    "escape": {ESCAPE},
    "quantum": {Spec.spot_resolution.value, *RESOLUTION},
    "noise": {*RESOLUTION},
}
"""Device numbers that no default of that name may repeat."""


@pytest.mark.parametrize(("instance", "name"), [(Spec(), "radius"), (Spec.radius, "value")])
def test_a_constant_of_the_device_cannot_be_assigned_to(instance: Spec | Quantity, name: str) -> None:
    before = getattr(instance, name)
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(instance, name, None)
    assert getattr(instance, name) == before


@pytest.mark.parametrize("folder", ["maglev_mj", "scripts"])
def test_the_numbers_of_the_device_are_written_once(folder: str) -> None:
    found = []
    for path in ROOT.glob(f"{folder}/**/*.py"):
        if path.name == "spec.py" or path.parent.name == "peers":  # peers have copies on purpose
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Constant | ast.AnnAssign | ast.FunctionDef):
                continue
            copies = (
                [node] if isinstance(node, ast.Constant) and type(node.value) is float and node.value in OWN else []
            )
            for name, value in defaults(node):
                copies += [part for part in numbers_in(value) if part.value in DEFAULTS.get(name, ())]
            found += [f"{path.relative_to(ROOT)}:{copy.lineno} {copy.value!r}" for copy in copies]
    assert not found


def numbers_in(value: ast.expr) -> list[ast.Constant]:
    """Return the floats of an expression."""
    parts = ast.walk(value)
    return [part for part in parts if isinstance(part, ast.Constant) and type(part.value) is float]


def defaults(node: ast.AST) -> Iterator[tuple[str, ast.expr]]:
    """Yield names and defaults of fields and arguments."""
    pairs: list[tuple[str, ast.expr | None]] = []
    if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
        pairs = [(node.target.id, node.value)]
    elif isinstance(node, ast.FunctionDef):
        arguments, given = [*node.args.posonlyargs, *node.args.args], node.args.defaults
        pairs = [(one.arg, value) for one, value in zip(arguments[len(arguments) - len(given) :], given, strict=True)]
        pairs += [(one.arg, value) for one, value in zip(node.args.kwonlyargs, node.args.kw_defaults, strict=True)]
    yield from ((name, value) for name, value in pairs if value is not None)
