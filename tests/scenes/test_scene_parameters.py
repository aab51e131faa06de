"""Declared parameters of scenes: kinds, bounds, derived defaults, JSON, refused declarations."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import Any, ClassVar

import pytest

from maglev_mj.errors import ParameterError
from maglev_mj.parameters import Parameters, param
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.find import find_scene
from maglev_mj.scenes.names import BUILT_IN
from maglev_mj.scenes.scene import RESERVED, Scene


class Bow(Parameters):
    """A parameter of each kind."""

    length: float = param("length", "m", default=0.5, above=0.0, at_most=2.0)
    pull: float = param("pull", "N", default=10.0, at_least=0.0, below=100.0)
    twice: float = param("twice the length", "m", default=None, derive=lambda bow: 2.0 * bow.length, at_most=3.0)
    both: float = param("length and twice it", "m", default=None, derive=lambda bow: bow.length + bow.twice)
    load: float | None = param("load", "kg", default=None, optional=True, at_least=0.0)
    hairs: int = param("how many hairs", default=3, at_least=1, at_most=9)
    wood: str = param("wood", default="ash", choices=("ash", "elm"))
    note: str = param("any text", default="")
    strung: bool = param("whether it is strung", default=False)
    ends: tuple[int, ...] = param("ends", default=(0, 1), parse=lambda value: tuple(sorted(value)))


NUMBER = "must be a finite number"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"length": 2.0000001}, "length must be above 0 and at most 2 m (got 2.0000001)"),
        *(({"pull": bad}, f"pull {NUMBER} at least 0 and below 100 N (got {bad!r})") for bad in (math.nan, "9", True)),
        ({"length": 1.6}, "twice must be at most 3 m (got 3.2)"),
        ({"twice": 4.0}, "twice must be at most 3 m (got 4.0)"),
        ({"load": -1.0}, "load must be at least 0 kg (got -1.0)"),
        ({"hairs": 2.5}, "hairs must be an integer (got 2.5)"),
        ({"hairs": None}, f"hairs {NUMBER} between 1 and 9 (got None)"),
        ({"wood": None}, "wood must be one of ash, elm (got None)"),
        ({"note": 3}, "note must be a string (got 3)"),
        ({"strung": 1}, "strung must be True or False (got 1)"),
    ],
)
def test_a_value_that_is_not_allowed_is_refused_however_it_is_given(changes: dict[str, Any], words: str) -> None:
    ways: list[Callable[[], Bow]]
    ways = [lambda: Bow(**changes), lambda: Bow().replace(**changes), lambda: Bow.from_json(changes)]
    for make in ways:
        with pytest.raises(ParameterError) as refused:
            make()
        assert str(refused.value) == words


def test_values_at_the_bounds_are_taken_as_what_they_are_declared() -> None:
    bow = Bow(length=1, twice=3.0, pull=0, load=0, hairs=9.0, wood="elm", note="x", strung=True, ends=[4, 2])  # type: ignore[arg-type]
    values = [*bow.as_json().values()]
    assert values == [1.0, 0.0, 3.0, 4.0, 0.0, 9, "elm", "x", True, (2, 4)]
    assert [type(value) for value in values] == [float] * 5 + [int, str, str, bool, tuple]
    assert Bow().load is None and Bow(length=2.0, twice=0.0).length == 2.0
    with pytest.raises(ParameterError, match=r"length must be above 0.* \(got -1\.0"):  # its own default
        declare("length", base=Bow, default=-1.0, above=0.0)()


def test_a_derived_default_is_derived_anew_and_a_given_value_is_kept() -> None:
    bow = Bow(length=1.0)
    assert (bow.twice, bow.both) == (2.0, 3.0)
    longer = bow.replace(length=1.5)
    assert (longer.twice, longer.both) == (3.0, 4.5)
    given = Bow(twice=1.0).replace(length=1.5)
    assert (given.twice, given.both) == (1.0, 2.5)
    assert given.replace(twice=None) == Bow(length=1.5)
    assert bow.replace() == bow and bow.replace(length=1.5).replace(length=1.0) == bow


def test_a_copy_checks_what_is_changed_or_derived_and_what_holds_for_several() -> None:
    parsed = list[float]()

    def parse(value: float) -> float:
        parsed.append(value)
        return value

    class Bag(Parameters):
        content: float = param("content", default=1.0, parse=parse)
        half: float = param("half of it", default=None, derive=lambda bag: 0.5 * bag.content, at_most=2.0)
        most: float = param("most", default=5.0)

        def check(self) -> None:
            if self.content > self.most:
                raise ParameterError("content must be at most most")

    bag = Bag()
    fuller = bag.replace(most=6.0).replace(content=3.0)
    assert parsed == [1.0, 3.0] and fuller == Bag(content=3.0, half=1.5, most=6.0) and bag == Bag()
    assert hash(fuller) == hash(Bag(content=3.0, half=1.5, most=6.0)) and vars(fuller) == {
        **vars(bag),
        **fuller.as_json(),
    }
    for changes, words in (
        ({"content": 5.0}, "half must be"),
        ({"most": 2.0}, "at most most"),
        ({"most": "x"}, "number"),
    ):
        with pytest.raises(ParameterError, match=words):
            fuller.replace(**changes)


def test_a_scene_cannot_be_changed_in_place() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        Drop().stiffness = 1.0  # type: ignore[misc]


@pytest.mark.parametrize("name", BUILT_IN)
def test_json_gives_the_scene_back(name: str) -> None:
    cls = find_scene(name)
    scene = cls(period=0.002, delay=0.0005)
    values = scene.as_json()
    assert list(values)[:3] == ["device", "period", "delay"]
    assert cls.from_json(values) == scene
    assert cls.from_json({"delay": 0.001}) == cls(delay=0.001)


@pytest.mark.parametrize("make", [Drop.from_json, lambda values: Drop().replace(**values)])
def test_an_unknown_name_is_refused_with_those_that_there_are(make: Any) -> None:
    with pytest.raises(ParameterError) as refused:
        make({"stiffness": 1.0, "stifness": 2.0})
    said = str(refused.value)
    assert said.startswith("parameter must be one of device, period, delay, stiffness, ")
    assert said.endswith(" (got 'stifness'); did you mean stiffness?")
    assert Drop.parameter("height").unit == "m" and Drop.parameter("stiffness").live


def declare(name: str, annotation: Any = float, base: type = Scene, **keywords: Any) -> type:
    """Return a class with one parameter, without a type for the annotation None."""
    types = {} if annotation is None else {name: annotation}
    return type("Mine", (base,), {"__annotations__": types, name: param("mine", **{"default": 1.0, **keywords})})


def test_a_type_that_no_option_can_have_needs_a_parser() -> None:
    with pytest.raises(TypeError, match=r"Mine\.speed needs a type annotation: `speed: float = param\(\.\.\.\)`"):
        declare("speed", None)
    for annotation in (list[float], float | int, dict, tuple[float, float]):
        with pytest.raises(TypeError, match=r"Mine\.speed must be float, int, bool or str, or have a `parse` \(got "):
            declare("speed", annotation)
        assert declare("speed", annotation, parse=lambda value: value).parameter("speed").kind is object  # type: ignore[attr-defined]


def test_a_parameter_may_not_be_named_as_an_option_of_every_command() -> None:
    for name in RESERVED | {"out", "format"}:
        with pytest.raises(TypeError, match=rf"Mine\.{name} cannot be a parameter: it is an option of every command"):
            declare(name)


HIDDEN = {"laws", "scripted_hand", "velocity_estimator", "variants", "plant_options", "replace", "from_json"}


def test_a_parameter_may_not_hide_a_method() -> None:
    for name in HIDDEN:
        with pytest.raises(TypeError, match=rf"Mine\.{name} cannot be a parameter: it is a method of "):
            declare(name)


def test_a_parameter_may_not_hide_a_method_or_attribute_of_any_base() -> None:
    with pytest.raises(TypeError, match=r"Mine\.wall cannot be a parameter: it is a method of WallScene"):
        declare("wall", base=Drop)
    for name in ("name", "figures", "shown_axis", "plants", "takes_phase", "tolerance"):
        with pytest.raises(TypeError, match=rf"Mine\.{name} cannot be a parameter: it is an attribute of Scene"):
            declare(name)


def test_hand_velocity_and_another_default_are_names_of_parameters() -> None:
    for name in ("hand", "velocity", "axis", "rest"):
        declare(name, base=Drop)

    class Deep(Drop):
        height: float = param("height", "m", default=0.002, above=0.0, at_most=0.003)

    assert Deep().height == 0.002
    with pytest.raises(ParameterError, match=r"height must be above 0 and at most 0\.003.* \(got 0\.0045"):
        Deep(height=0.0045)
    assert [one.name for one in Deep.parameters()] == [one.name for one in Drop.parameters()]


def test_what_would_silently_not_be_a_parameter_is_refused() -> None:
    # An inherited default set without `param` would not be used, and a bare field would be in no JSON.
    for types in ({}, {"stiffness": float}):
        with pytest.raises(TypeError, match=r"Mine\.stiffness must be declared by param\(\.\.\.\), as in WallScene"):
            type("Mine", (Drop,), {"__annotations__": types, "stiffness": 5000.0})
    with pytest.raises(TypeError, match=r"Mine\.speed must be declared by param\(\.\.\.\), or be a ClassVar"):
        type("Mine", (Scene,), {"__annotations__": {"speed": float}, "speed": 1.0})

    class Mine(Scene):
        speed: ClassVar[float] = 1.0

    assert "speed" not in Mine().as_json()
