"""Arguments of public functions and classes: shapes, times in seconds, keywords; and the errors they raise."""

from __future__ import annotations

import importlib
import inspect
import itertools
import pickle
import pkgutil
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import maglev_mj
from maglev_mj import Calibration, Command, Controller, ExactPlant, MuJoCoPlant, Sample, Timing, theory
from maglev_mj.bridge.fault import DeviceFault
from maglev_mj.bridge.wire import Fault
from maglev_mj.errors import KeywordError, MaglevError, ParameterError
from maglev_mj.interop import gym
from maglev_mj.parameters import Parameters, numbers
from maglev_mj.plants.hand import RecordedHand, SpringHand, Trajectory
from maglev_mj.theory import boundary
from maglev_mj.theory.closed_loop import SampledLoop
from tests.all_of import LAWS, SCENES
from tests.test_all_of import below
from tests.test_parameters import calls

for _module in pkgutil.walk_packages(maglev_mj.__path__, "maglev_mj."):
    if not _module.name.endswith("__main__"):
        importlib.import_module(_module.name)

# -- shapes ----------------------------------------------------------------------------------------------

SHAPES = [shape for axes in range(4) for shape in itertools.product((1, 2, 5, 6), repeat=axes)]
COILS, MANY = Calibration.nominal().coils, np.zeros((5, 6))


def written(plant: Any, value: Any, extra: Any = None) -> None:
    """Write a command, or a pulse if `extra` is set."""
    with plant() as device:
        device.read()
        device.write(Command(value, extra, 1e-3))


def acted(env: Any, action: Any) -> None:
    """Take a step of an environment."""
    env.reset(seed=1)
    env.step(action)


def ends_in_6(shape: tuple[int, ...]) -> bool:
    """Return True for (..., 6)."""
    return shape[-1:] == (6,)


ONE, SIX, ROWS = {()}, {(6,)}, {(count, 6) for count in (1, 2, 5, 6)}
ARRAYS: dict[str, tuple[Callable[[Any], object], Any]] = {
    "action": (partial(acted, gym.TargetEnv(axes=("x", "z"))), {(2,)}),
    "actions": (partial(acted, gym.TargetVectorEnv(5, axes=("x", "z"))), {(5, 2)}),
    "pose": (lambda a: ExactPlant(pose=a), ends_in_6),
    "poses of a batch": (lambda a: maglev_mj.plants.MuJoCoBatchPlant(pose=a), ROWS),
    "pose in MuJoCo": (lambda a: MuJoCoPlant(pose=a), SIX),
    "twist in MuJoCo": (lambda a: MuJoCoPlant(twist=a), SIX),
    "wrench": (lambda a: ExactPlant(pose=MANY, wrench=a), ONE | SIX | {(5, 6)}),
    "wrench limit": (lambda a: ExactPlant(wrench_limit=a), ONE | SIX),
    "mass": (lambda a: ExactPlant(pose=MANY, mass=a), ONE | {(5,)}),
    "inertia": (lambda a: ExactPlant(inertia=a), set()),
    "gravity": (lambda a: MuJoCoPlant(gravity=a), ONE),
    "escape": (lambda a: MuJoCoPlant(escape=a), {(2,)}),
    "command": (lambda a: written(ExactPlant, a), SIX),
    "command in MuJoCo": (lambda a: written(MuJoCoPlant, a), SIX),
    "command of a batch": (lambda a: written(lambda: ExactPlant(pose=MANY), a), SIX | {(6, 5)}),
    "pulse": (lambda a: written(ExactPlant, [0.0] * 6, a), SIX),
    "sample": (lambda a: Controller([], period=0.01).step(Sample(0, 0.0, a)), lambda shape: shape[:1] == (6,)),
    "bias": (maglev_mj.Bias, ends_in_6),
    "gain": (lambda a: maglev_mj.Hold(axes=("x", "y"), stiffness=a, damping=1.0), lambda s: s[-1:] in ((), (2,))),
    "path": (lambda a: Trajectory([0.0, 1.0], a), {(2, 6)}),
    "times": (lambda a: Trajectory(np.cumsum(a, dtype=float).reshape(a.shape), MANY[:1]), {(1,)}),
    "wrenches of a hand": (RecordedHand, ROWS),
    "target": (lambda a: SpringHand(target=a), SIX),
    "start": (lambda a: maglev_mj.Start(pose=a, twist=a, wrench=a), SIX),
    "phase": (lambda a: maglev_mj.run("twist", plant="exact", phase=0.0 * a), lambda shape: len(shape) < 2),
    "currents": (COILS.wrench, ends_in_6),
    "wrench of coils": (COILS.currents, ends_in_6),
    "coils": (lambda a: maglev_mj.CoilMap(COILS.points, COILS.directions, a), SIX),
    "lines": (lambda a: numbers("lines", a, shape="(6, L)"), {(6, one) for one in (1, 2, 5, 6)}),
}


@pytest.mark.parametrize("name", ARRAYS)
def test_documented_shapes_pass_and_every_other_of_up_to_three_axes_is_refused(name: str) -> None:
    call, allowed = ARRAYS[name]
    for shape in SHAPES:
        if allowed(shape) if callable(allowed) else shape in allowed:
            call(np.full(shape, 1e-3))
        else:
            with pytest.raises(MaglevError):
                call(np.full(shape, 1e-3))


# -- times in seconds ------------------------------------------------------------------------------------

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
    *((name, SampledLoop, value) for name, value in {"period": 0.005, "delay": 1e-3, "driver_lag": 8e-5}.items()),
    *(("period", partial(LIKE, laws[-1]), 1e-3) for laws in LAWS.values() if laws and hasattr(laws[-1], "period")),
]


@pytest.mark.parametrize(("name", "call", "value"), TIMES)
def test_a_time_a_thousand_times_too_long_is_refused(name: str, call: Callable[..., Any], value: float) -> None:
    with pytest.raises(ParameterError, match=rf"{name} must be .* \(got {1e3 * value:g}"):
        call(**{name: 1e3 * value})


# -- keywords --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "call"), [pair for pair in calls() if "." not in pair[0]])
def test_a_misspelled_keyword_is_named_with_the_right_one(name: str, call: Callable[..., Any]) -> None:
    for key, one in inspect.signature(call).parameters.items():
        if name not in ("Sample", "Command") and one.kind in (one.KEYWORD_ONLY, one.POSITIONAL_OR_KEYWORD):
            wrong = f"{key[:-1]}_{key[-1]}"
            with pytest.raises(KeywordError, match=rf"argument of {name} .*got '{wrong}'\); did you mean {key}"):
                call(**{wrong: None})


def test_a_rate_is_taken_for_a_period() -> None:
    rate: Any = {"rate": 500.0}
    assert Timing(**rate).period == Controller([], **rate).period == 0.002
    for scene in map(maglev_mj.find_scene, SCENES):
        assert scene(**rate) == scene().replace(**rate) == scene(period=0.002)
    assert theory.critical_delay(6e3, 80.0, **rate) == theory.critical_delay(6e3, 80.0, period=0.002)
    with pytest.raises(KeywordError, match="period and rate must not both be given"):
        boundary.colgate(5.0, **rate, period=0.005)
    assert maglev_mj.sweep("twist", {"rate": [200.0, 500.0]}, plant="exact").varied == {"period": [0.005, 0.002]}


# -- errors ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [MaglevError, *below(MaglevError)])
def test_an_error_is_short_and_the_same_after_pickle(kind: type[MaglevError]) -> None:
    for text in ("short", "long " * 200_000 + "end"):
        error = kind(next(iter(Fault)), text, Path("a")) if kind is DeviceFault else kind(text)
        error.cycles = ((Sample(0, 0.0, [0.0] * 6), Command([0.0] * 6)),)
        again = pickle.loads(pickle.dumps(error))
        assert type(again) is kind and str(again) == str(error) and vars(again).keys() == vars(error).keys()
        assert len(str(error)) < 500 and ("end" in str(error)) == (len(text) > 5)


def test_the_message_of_equal_times_names_their_index() -> None:
    times = np.arange(100_000) * 1e-3
    times[500] = times[499]
    with pytest.raises(ParameterError, match=r"path times must increase \(got 0.499, 0.499 at index 499\)"):
        Trajectory(times, np.zeros((len(times), 6)))
