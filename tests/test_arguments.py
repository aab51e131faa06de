"""Arguments of public functions and classes: shapes, times in seconds, keywords; and the errors they raise."""

from __future__ import annotations

import inspect
import itertools
import pickle
import pkgutil
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import maglev_mj
from maglev_mj import Calibration, Command, Controller, ExactPlant, MuJoCoPlant, Sample, Timing, theory
from maglev_mj.bridge.fault import DeviceFault
from maglev_mj.bridge.wire import Fault
from maglev_mj.errors import KeywordError, MaglevError, ParameterError
from maglev_mj.interop import gym
from maglev_mj.interop.navigation import Navigator
from maglev_mj.parameters import Parameters
from maglev_mj.plants.hand import RecordedHand, SpringHand, Trajectory
from maglev_mj.scenes.drop import Drop
from maglev_mj.studies.oscillation import find_oscillation
from maglev_mj.theory.loop_array import LoopArray
from tests.all_of import LAWS, SCENES
from tests.test_all_of import below
from tests.test_parameters import calls

for one in pkgutil.walk_packages(maglev_mj.__path__, "maglev_mj."):
    if "__main__" not in one.name:
        import_module(one.name)  # for the lists of classes
SHAPES = [shape for axes in range(4) for shape in itertools.product((1, 2, 6), repeat=axes)]
HOT = {"Sample", "Command"}
COILS, MANY = Calibration.nominal().coils, np.zeros((2, 6))


def stepped(made: Any, value: Any) -> None:
    """Take a step of an environment, a controller or a plant; a pair is a command with a pulse."""
    if isinstance(made, Controller):
        made.step(Sample(0, 0.0, value))
    elif hasattr(made, "task"):
        made.reset(seed=1)
        made.step(value)
    else:
        made.read()
        made.write(Command(value[0], value[1], 1e-3) if isinstance(value, tuple) else Command(value))


ONE, SIX, ROWS = [()], [(6,)], [(count, 6) for count in (1, 2, 6)]
ENDS = [shape for shape in SHAPES if shape[-1:] == (6,)]
ARRAYS: dict[str, tuple[Callable[[Any], object], list[Any]]] = {
    "action": (partial(stepped, gym.TargetEnv(axes=("x", "z"))), [(2,)]),
    "actions": (partial(stepped, gym.TargetVectorEnv(6, axes=("x", "z"))), [(6, 2)]),
    "pose": (lambda a: ExactPlant(pose=a), ENDS),
    "poses": (lambda a: maglev_mj.plants.MuJoCoBatchPlant(pose=a), ROWS),
    "pose and twist": (lambda a: MuJoCoPlant(pose=a, twist=a), SIX),
    "wrench": (lambda a: ExactPlant(pose=MANY, wrench=a, wrench_limit=a), [*ONE, *SIX, (2, 6)]),
    "mass": (lambda a: ExactPlant(pose=MANY, mass=a), [*ONE, (2,)]),
    "inertia": (lambda a: ExactPlant(inertia=a), []),
    "escape": (lambda a: MuJoCoPlant(escape=a), [(2,)]),
    "command": (lambda a: stepped(ExactPlant(), a), SIX),
    "command in MuJoCo": (lambda a: stepped(MuJoCoPlant(), a), SIX),
    "command of a batch": (lambda a: stepped(ExactPlant(pose=MANY), a), [*SIX, (6, 2)]),
    "pulse": (lambda a: stepped(ExactPlant(), ([0.0] * 6, a)), SIX),
    "sample": (lambda a: stepped(Controller([], period=0.01), a), [shape for shape in SHAPES if shape[:1] == (6,)]),
    "bias": (maglev_mj.Bias, ENDS),
    "path": (lambda a: Trajectory([0.0, 1.0], a), [(2, 6)]),
    "recorded hand": (RecordedHand, ROWS),
    "target": (lambda a: SpringHand(target=a), SIX),
    "start": (lambda a: maglev_mj.Start(pose=a, twist=a, wrench=a), SIX),
    "phase": (lambda a: maglev_mj.run("twist", plant="exact", phase=0.0 * a), [*ONE, (1,), (2,), (6,)]),
    "coils": (lambda a: (COILS.wrench(a), COILS.currents(a)), ENDS),
    "force constants": (lambda a: maglev_mj.CoilMap(COILS.points, COILS.directions, a), SIX),
}


@pytest.mark.parametrize("name", ARRAYS)
def test_documented_shapes_pass_and_every_other_of_up_to_three_axes_is_refused(name: str) -> None:
    call, allowed = ARRAYS[name]
    for shape in SHAPES:
        try:
            call(np.full(shape, 1e-3))
        except MaglevError:
            assert shape not in allowed
        else:
            assert shape in allowed


def masked(shape: tuple[int, ...]) -> Any:
    """Return an array whose last value does not count, as a logger marks it."""
    values = np.full(shape, 1e-3)
    values[(-1,) * len(shape)] = 9999.0
    return np.ma.masked_greater(values, 1.0)


@pytest.mark.parametrize("name", [name for name, (_, shapes) in ARRAYS.items() if shapes])
def test_masked_values_are_refused_where_arrays_are_taken(name: str) -> None:
    call, allowed = ARRAYS[name]
    for shape in allowed:
        for value in (masked(shape), list(masked(shape)) if shape and name != "phase" else np.ma.masked):
            with pytest.raises(MaglevError, match=r"must (have no masked values|be a)"):
                call(value)
        call(np.ma.masked_greater(np.full(shape, 1e-3), 1.0))  # without one they are numbers


@pytest.mark.parametrize(("name", "call"), [pair for pair in calls() if "." not in pair[0] and pair[0] not in HOT])
def test_masked_values_are_refused_by_every_public_call(name: str, call: Callable[..., Any]) -> None:
    for key, one in inspect.signature(call).parameters.items():
        if one.kind in (one.KEYWORD_ONLY, one.POSITIONAL_OR_KEYWORD):
            with pytest.raises(ParameterError, match=r"must have no masked values|must be .*\(got masked_array"):
                call(**{key: masked((6,))})


def test_masked_values_are_refused_by_recordings_and_navigation() -> None:
    (segment,) = maglev_mj.record_run(Drop(duration=0.05), plant="exact").segments
    rows, navigator = masked(segment.position.shape), Navigator()
    for act in (
        lambda: segment.replace(position=rows),
        lambda: replace(segment, arrays={**segment.arrays, "position": rows}),
        lambda: navigator.move(masked((6,)), None, 0.1),
        lambda: navigator.move([0.0] * 6, masked((6,)), 0.1),
        lambda: navigator.move([0.0] * 6, np.zeros(6), 0.1, masked((6,))),
        lambda: find_oscillation(np.arange(6), masked((6,)), period=0.001),
        lambda: find_oscillation(np.arange(6), np.zeros(6), period=0.001, usable=masked((6,)) > 0.0),
        lambda: maglev_mj.Timing(rate=masked((2,))),
    ):
        with pytest.raises(ParameterError, match="must have no masked values"):
            act()


def batch_of(value: Any) -> list[Any]:
    """Return six components of two devices."""
    return [value] + [np.zeros(2)] * 5


@pytest.mark.parametrize("value", [masked((2,)), np.ma.masked], ids=["array", "number"])
def test_masked_values_that_the_users_code_returns_are_refused(value: Any) -> None:
    class Odd(maglev_mj.Law):
        def __call__(self, position: Any, velocity: Any, state: Any, wrench: Any) -> Any:
            wrench[0] = value
            return state, None

    several = np.ndim(value) > 0
    pose: Any = {"pose": MANY} if several else {}
    six = batch_of(value) if several else [value] + [0.0] * 5
    zeros = [np.zeros(2)] * 6 if several else [0.0] * 6
    controller = Controller([], period=0.01)
    controller.step(Sample(0, 0.0, zeros))
    for act in (
        lambda: ExactPlant(**pose, hand_force=lambda *_: six).read(),
        lambda: stepped(ExactPlant(**pose), six),
        lambda: stepped(ExactPlant(**pose), (zeros, six)),
        lambda: controller.step(Sample(1, 0.01, six)),
        lambda: Controller([Odd()], period=0.01).step(Sample(0, 0.0, zeros)),
        lambda: Controller([lambda *_: six], period=0.01).step(Sample(0, 0.0, zeros)),
    ):
        with pytest.raises(MaglevError, match=r"must (have no masked values|be a number)"):
            act()


LIKE: Any = replace
LONG = {"duration", "thermal_time"}
"""Times that may well be a thousand times longer."""
TIMES: list[tuple[str, Callable[..., Any], float]] = [
    (item.name, cls, item.default)
    for cls in below(Parameters)
    for item in cls.parameters()  # type: ignore[attr-defined]
    if item.unit == "s" and item.name not in LONG and isinstance(item.default, float) and item.default
]
TIMES += [
    ("period", Timing, 1e-3),
    ("delay", Timing, 1.5e-3),
    ("delay", lambda delay: theory.design_wall(theory.WallRequirements(delay=(delay, delay))), 1.5e-3),
    ("driver_time_constant", lambda **time: MuJoCoPlant(driver_lag=True, **time), 8e-5),
    *((name, LoopArray, value) for name, value in {"period": 0.005, "delay": 1.5e-3, "driver_lag": 8e-5}.items()),
    *(("period", partial(LIKE, laws[-1]), 1e-3) for laws in LAWS.values() if laws and hasattr(laws[-1], "period")),
]


@pytest.mark.parametrize(("name", "call", "value"), TIMES)
def test_a_time_a_thousand_times_too_long_is_refused(name: str, call: Callable[..., Any], value: float) -> None:
    with pytest.raises(ParameterError, match=rf"{name} must be .* \(got {1e3 * value:g}"):
        call(**{name: 1e3 * value})


@pytest.mark.parametrize(("name", "call"), [pair for pair in calls() if "." not in pair[0] and pair[0] not in HOT])
def test_a_misspelled_keyword_is_named_with_the_right_one(name: str, call: Callable[..., Any]) -> None:
    for key, one in inspect.signature(call).parameters.items():
        if one.kind in (one.KEYWORD_ONLY, one.POSITIONAL_OR_KEYWORD):
            wrong = f"{key[:-1]}_{key[-1]}"
            with pytest.raises(KeywordError, match=rf"argument of {name} .*got '{wrong}'\); did you mean {key}"):
                call(**{wrong: None})


RATED: dict[str, Callable[[], Any]] = {
    "Controller": lambda: Controller([], rate=500.0).period,
    "Scene": lambda: maglev_mj.Scene(rate=500.0).period,
    "Timing": lambda: Timing(rate=500.0, device_rate=1e3).period,
    "TwinParameters": lambda: maglev_mj.TwinParameters(rate=500.0).period,
    "WallRequirements": lambda: theory.WallRequirements(rate=500.0, device_rate=1e3).period,
    "critical_delay": lambda: (
        theory.critical_delay(6e3, 80.0, rate=500.0) == theory.critical_delay(6e3, 80.0, period=0.002)
    ),
    "largest_stable_stiffness": lambda: (
        theory.largest_stable_stiffness(80.0, rate=500.0) == theory.largest_stable_stiffness(80.0, period=0.002)
    ),
    "least_dynamic_stiffness": lambda: (
        theory.least_dynamic_stiffness(6e3, 80.0, rate=500.0) == theory.least_dynamic_stiffness(6e3, 80.0, period=0.002)
    ),
    "spectral_radius": lambda: (
        theory.spectral_radius(6e3, 80.0, rate=500.0) == theory.spectral_radius(6e3, 80.0, period=0.002)
    ),
    "stable_ranges": lambda: theory.stable_ranges(80.0, rate=500.0) == theory.stable_ranges(80.0, period=0.002),
    "stiffest_wall": lambda: theory.stiffest_wall(rate=500.0) == theory.stiffest_wall(period=0.002),
}
"""Calls with a rate, as a type checker sees them: 500 Hz is a period of 0.002 s."""


def keywords_of(call: Callable[..., Any]) -> Iterator[tuple[str, object]]:
    """Yield name and annotation of each argument in the signature, with those of an unpacked TypedDict."""
    plain = inspect.unwrap(call.__init__ if inspect.isclass(call) else call)
    for key, one in inspect.signature(call).parameters.items():
        if packed := re.fullmatch(r"Unpack\[(\w+)\]", str(one.annotation)):
            kinds = plain.__globals__[packed[1]].__annotations__
            yield from ((key, getattr(kind, "__forward_arg__", kind)) for key, kind in kinds.items())
        elif one.kind < one.VAR_KEYWORD and one.kind != one.VAR_POSITIONAL and one.annotation is not one.empty:
            yield key, one.annotation


def test_a_rate_is_taken_for_a_period_where_the_signature_has_it() -> None:
    assert RATED.keys() == {name for name, call in calls() if {"rate", "period"} <= {*dict(keywords_of(call))}}
    for name, call in RATED.items():
        assert call() in (0.002, True), name
    assert Timing(rate=500.0).rate == 500.0 and Timing(device_rate=1e3).device_period == 1e-3
    rate: Any = {"rate": 500.0}  # of a scene by its name
    for scene in map(maglev_mj.find_scene, SCENES):
        assert scene(**rate) == scene().replace(**rate) == scene(period=0.002) and scene(**rate).rate == 500.0
        assert "rate" in inspect.signature(scene).parameters
    with pytest.raises(KeywordError, match="period and rate must not both be given"):
        theory.largest_stable_stiffness(5.0, rate=500.0, period=0.005)
    with pytest.raises(ParameterError, match="rate must be a number"):
        Timing(rate="fast")  # type: ignore[arg-type]
    assert maglev_mj.sweep("twist", {"rate": [200.0, 500.0]}, plant="exact").varied == {"period": [0.005, 0.002]}


STUBS = Path(maglev_mj.__file__).parent.glob("*/__init__.pyi")
PACKAGES = [maglev_mj, *(import_module(f"maglev_mj.{stub.parent.name}") for stub in STUBS)]


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: package.__name__)
def test_a_name_is_the_same_object_wherever_it_is_imported_from(package: ModuleType) -> None:
    for name in dir(package):
        value = getattr(package, name)
        if inspect.isclass(value) or inspect.isfunction(value):
            assert getattr(import_module(value.__module__), value.__qualname__) is value, name
            assert pickle.loads(pickle.dumps(value)) is value, name


@pytest.mark.parametrize("kind", [MaglevError, *below(MaglevError)])
def test_an_error_is_short_and_the_same_after_pickle(kind: type[MaglevError]) -> None:
    for text in ("short", "long " * 200_000 + "end"):
        error = kind(next(iter(Fault)), text, Path("a"), off=0.25) if kind is DeviceFault else kind(text)
        error.cycles = ((Sample(0, 0.0, [0.0] * 6), Command([0.0] * 6)),)
        again = pickle.loads(pickle.dumps(error))
        assert type(again) is kind and str(again) == str(error) and vars(again).keys() == vars(error).keys()
        assert len(str(error)) < 500 and ("end" in str(error)) == (len(text) > 5)


def test_the_message_of_equal_times_names_their_index() -> None:
    times = np.arange(100_000) * 1e-3
    times[500] = times[499]
    with pytest.raises(ParameterError, match=r"path times must increase \(got 0.499, 0.499 at index 499\)"):
        Trajectory(times, np.zeros((len(times), 6)))


OPEN = re.compile(r"Any|object|Self|tuple\[Any.*|_?[A-Za-z]*Model|.*(Array|Mask|Six|Component).*")
"""Annotations of what any value, any array or an optional package's object may be."""


ITEMS = {"axes": "axis", "laws": "law", "hands": "hand", "count": "workers", "url": "link", "text": "scene"}
"""Arguments whose message may name a single item of them, or what they stand for."""


class Foreign:
    """Value of no type that an argument is declared with."""

    def __repr__(self) -> str:
        return "Foreign"


def checkable() -> Iterator[tuple[str, Callable[..., Any], str, str]]:
    """Yield every annotated argument that is checked before a call: owner's name, owner, argument, annotation."""
    for name, call in calls():
        if name in HOT or hasattr(call, "every_tick") or getattr(call, "late", False):
            continue
        yield from ((name, call, key, str(note)) for key, note in keywords_of(call) if not OPEN.fullmatch(str(note)))


CHECKABLE = [*checkable()]
assert len(CHECKABLE) > 300  # the sweep is only as good as what it goes over


@pytest.mark.parametrize("name", sorted({row[0] for row in CHECKABLE}))
def test_an_argument_of_a_foreign_type_is_named(name: str) -> None:
    for _, call, argument, note in (row for row in CHECKABLE if row[0] == name):
        switch = (1e-3, "no", 1, 0, None, [True], float("nan")) if note == "bool" else ()
        for value in (Foreign(), [Foreign()], *switch):
            allowed, shown = "be True or False" if switch else ".*", repr(value if switch else Foreign())
            with pytest.raises(
                ParameterError,
                match=rf"\b({argument}|{ITEMS.get(argument)})\w* must {allowed} \(got .*{re.escape(shown)}",
            ):
                call(**{argument: value})


def stepped_again(*sample: Any) -> None:
    """Give a controller a second sample."""
    controller = Controller([], period=0.005)
    controller.step(Sample(0, 0.0, [0.0] * 6))
    controller.step(Sample(*sample))


LATE = """
sample: Controller([], period=0.005).step(None); sample tick: stepped_again("x", 0.0, [0.0] * 6)
sample time: stepped_again(1, None, [0.0] * 6); sample position: stepped_again(1, 0.0, ["x"] * 6)
currents: MuJoCoPlant().drive(None); coil: MuJoCoPlant().open_coil(9); data: Twin(TwinParameters()).receive(None, 1, 0)
rotation: COILS.inverse_at(0); rx: COILS.inverse_at_angle(None, 0.0, 0.0); length: COILS.condition_number(0)
time: Trajectory([0, 1], MANY).at("x"); time: Trajectory([0, 1], MANY).at(np.nan); value: Turn()(None, 1)
step: next(real_time(1.0, -1.0)); links: conform([]); function: figure("N")(3); hand mass: Hand(mass=None)
pose: TwinParameters(pose="x"); least: Turn(least=5, most=1); default: gain(default="y")
velocity: Controller([], period=1e-3, velocity=LowPass); pose: (Start(pose=[0.0] * 6), Start(pose=["x"] * 6))
wall pulse_width: Wall(lower=0.0, stiffness=1.0, damping=1.0, pulse_width=3)
period: HalfSampleWall(stiffness=1.0, period=2)
parameters: Session("drop").change(None); law: compare("drop", [3]); observe: run("twist", plant="exact", observe=3)
arguments of Wall: Wall(6000, 80); arguments of judge: judge(Controller([], period=0.005))
"""
"""Arguments checked after a failure, or by their value."""


@pytest.mark.parametrize("line", LATE.strip().replace("\n", "; ").split("; "))
def test_an_argument_that_fails_a_call_is_named(line: str) -> None:
    name, call = line.split(": ", 1)
    with pytest.raises(ParameterError, match=f"^{name} must be "):
        eval(call, {**{one: getattr(maglev_mj, one) for one in dir(maglev_mj)}, **globals()})


def test_a_file_in_a_missing_folder_names_the_folder(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"no such folder: '.*absent'"):
        maglev_mj.Recording([]).save(tmp_path / "absent" / "run.maglev")
