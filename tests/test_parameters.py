"""Arguments of wrong types: switches and numbers."""

import ast
import inspect
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import maglev_mj
from maglev_mj import bridge, plants, recording, theory
from maglev_mj.errors import ParameterError
from maglev_mj.parameters import Parameters, flag, number, numbers, param, param_range, parsed_number

OURS = re.compile(r".*Plant\.six|.*\.(axis|force|signals)")
"""Methods that the package calls itself, those of a law on every tick."""


ALSO: list[Any] = [theory.analog_wall, theory.karnopp, theory.least_dynamic_stiffness, theory.least_passive_damping]
ALSO += [theory.spectral_radius, theory.stable_ranges, theory.stiffest_wall, theory.worst_case]
ALSO += [recording.import_table, plants.RecordedHand, bridge.HaplyPlant, bridge.HaplyServer, bridge.HaplyTwin]
"""What the pages use of the packages."""


def calls() -> Iterator[tuple[str, Callable[..., Any]]]:
    """Yield every class, function and method that `import maglev_mj` gives, and `ALSO`, but what the package calls."""
    names = {name: getattr(maglev_mj, name) for name in dir(maglev_mj)} | {one.__name__: one for one in ALSO}
    for name, found in names.items():
        if inspect.isclass(found):
            methods = inspect.getmembers_static(found, inspect.isfunction)
            ours = [(method, call) for method, call in methods if call.__module__.startswith("maglev_mj")]
            named = ((f"{name}.{method}", call) for method, call in ours if not method.startswith("_"))
            yield from ((name, call) for name, call in named if not OURS.fullmatch(name))
        if callable(found) and not inspect.isabstract(found):
            yield name, found


@pytest.mark.parametrize("bad", ["1", b"1", "inf", True, np.True_, None, [1.0], {}, float("nan"), 10**400])
def test_a_number_is_no_text_and_no_switch(bad: object) -> None:
    with pytest.raises(ParameterError, match=r"mass must be a finite number \(got"):
        number("mass", bad)


def test_a_message_names_the_stricter_of_two_bounds() -> None:
    cases: list[tuple[dict[str, Any], str]] = [
        ({"above": 0.0, "at_least": 0.0}, "above 0"),
        ({"above": 0.0, "at_least": 1.0}, "at least 1"),
        ({"below": 1.0, "at_most": 1.0, "at_least": 0.0}, "at least 0 and below 1"),
        ({"above": -1.0, "at_least": 0.0, "below": 2.0, "at_most": 1.0}, "between 0 and 1"),
    ]
    for bounds, said in cases:
        with pytest.raises(ParameterError, match=rf"mass must be {said} \(got -5"):
            number("mass", -5.0, **bounds)


def test_a_hand_is_an_impedance_and_a_hand_force_a_function() -> None:
    """In every function and named tuple of the package."""
    for path in Path(maglev_mj.__file__).parent.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(text if re.search(r"\bhand(_force)?:", text) else "")):
            name = getattr(node, "arg", None) or getattr(getattr(node, "target", None), "id", None)
            if name in ("hand", "hand_force") and (note := getattr(node, "annotation", None)) is not None:
                kind = ast.unparse(note)  # a class of the package's hands is a force; a viewer has one as its `hand`
                is_force = "HandForce" in kind or (isinstance(node, ast.arg) and re.search(r"[a-z]Hand\b", kind))
                assert "bool" not in kind, f"{path}:{getattr(node, 'lineno', '')}"
                assert bool(is_force) == (name == "hand_force"), f"{path}:{getattr(node, 'lineno', '')}"


def test_numbers_are_no_texts_and_no_switches() -> None:
    wrong: list[Any] = [["1"], [1.0, "1"], True, [1.0, True], [[0.0], [True]], [None], [[1.0], [1.0, 2.0]]]
    for bad in wrong:
        with pytest.raises(ParameterError, match=r"pose must be a number or an array of numbers \(got"):
            numbers("pose", bad)
    assert parsed_number("mass", "7e-1") == 0.7
    for text in ("", "a", "nan", "inf", "0x7"):
        with pytest.raises(ParameterError, match=rf"mass must be a finite number \(got '{text}'"):
            parsed_number("mass", text)
    assert flag("switch", np.True_) is True and flag("switch", np.bool_(False)) is False


class Lever(Parameters):
    """A length, and two ends."""

    length: float = param("arm", "m", default=0.5, at_least=0.0, at_most=1.0, along=True)
    ends: tuple[float, float] | None = param_range("ends", "both ends", "m", default=None, at_least=0.0, at_most=1.0)
    range: tuple[float, float] = param_range("range", "both", "m", default=(0.0, 1.0))
    grid: tuple[float, ...] = param_range("grid", "values", "m", default=(0.0, 1.0), most=9)


def test_a_parameter_like_another_is_declared_as_it_is_but_for_changes() -> None:
    class Longer(Parameters):
        length: float = Lever.like("length", default=2.0, at_most=3.0)
        above: float = Lever.like("length", at_least=None, above=0.0)

    one = Longer.parameter("length")
    assert (one.help, one.unit, one.along, one.default) == ("arm", "m", True, 2.0)
    assert one.bounds == {"at_least": 0.0, "at_most": 3.0} and Longer.parameter("above").default == 0.5
    assert Longer.parameter("above").bounds == {"above": 0.0, "at_most": 1.0}
    with pytest.raises(ParameterError, match=r"parameter must be one of length, ends, range, grid \(got 'lenght'\)"):
        Lever.like("lenght")


def test_a_range_has_a_lower_and_a_higher_value_within_its_bounds() -> None:
    assert Lever().ends is None and Lever(ends=(0, 1)).ends == (0.0, 1.0) and Lever().range == (0.0, 1.0)
    assert Lever(grid=(0, 1)).grid == (0.0, 1.0) and Lever(grid=(0, 2, 9)).grid == (0.0, 2.0, 9)
    wrong: list[tuple[dict[str, Any], str]] = [
        ({"ends": (0.5, 2.0)}, r"ends must be between 0 and 1.* \(got 2.0"),
        ({"ends": (1.0, 0.0)}, "ends must be in ascending order, low to high"),
        ({"range": (0.0, 1.0, 3)}, r"range must be a pair \(low, high\) \(got \(0.0, 1.0, 3\)"),
        ({"grid": (0.0,)}, r"grid must be \(low, high\) or \(low, high, count\) \(got \(0.0,\)"),
        ({"grid": (0.0, 1.0, 10)}, r"count of grid must be between 1 and 9 \(got 10"),
        ({"grid": (0.0, 1.0, 2.5)}, r"count of grid must be an integer \(got 2.5"),
        ({"range": None}, r"range must be a pair \(low, high\) \(got None"),
    ]
    for values, said in wrong:
        with pytest.raises(ParameterError, match=said):
            Lever(**values)
