"""Laws from gains and functions, and refusal of wrong laws."""

import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

from maglev_mj import AXES, Controller, Sample
from maglev_mj.control import (
    AxisLaw,
    Bias,
    HalfSampleWall,
    Hold,
    Law,
    PassivityController,
    StickSlip,
    Wall,
    check_law,
    gain,
)
from maglev_mj.errors import ParameterError
from maglev_mj.frames import components

T = 0.005
GAINS: dict[str, Any] = {"stiffness": 3000.0, "damping": 30.0}
FRICTION: dict[str, Any] = {**GAINS, "breakaway": 1.0}


class Detent(AxisLaw):
    """Sine detents with damping."""

    pitch: ArrayLike = gain("distance between detents", "m", above=0.0)
    stiffness: ArrayLike = gain("stiffness at the bottom", "N/m")
    damping: ArrayLike = gain("damping", "N s/m", default=10.0)

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        turn = 2.0 * np.pi / gains.pitch
        return -gains.stiffness / turn * np.sin(turn * x) - gains.damping * v


DETENT = Detent(axes=("x", "rz"), pitch=0.002, stiffness=3000.0)


class Leaky(AxisLaw):
    """Integral action with a leak."""

    leak: float = gain(default=0.1)
    rate: float = 100.0

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        area = (0.0 * x if state is None else state) * (1.0 - gains.leak) + x
        return -self.rate * area, area


OWN: dict[str, Law] = {
    "Detent": DETENT,
    "Leaky": Leaky(),
    "coupled": StickSlip(axes=("x", "y"), v_min=0.01, coupled=True, **FRICTION),
}


@pytest.mark.parametrize("law", OWN)
def test_a_law_is_the_same_alone_and_in_a_batch(law: str) -> None:
    check_law(OWN[law])
    with pytest.raises(ParameterError, match=r"must have scalar gains to be checked, not batch shape \(2,\)"):
        check_law(Hold(stiffness=np.ones((2, 6)), damping=0.0))


def test_gains_may_differ_by_axis_and_by_device() -> None:
    law = Detent(axes=("x", "y"), pitch=[0.002, 0.004], stiffness=np.array([[1000.0, 2000.0], [3000.0, 4000.0]]))
    assert law.batch == (2,) and law.indices == (0, 1) and law.damping == 10.0
    wrench: list[Any] = [0.0] * 6
    position = components(np.full((2, 6), 1e-3))
    law(position, [np.zeros(2)] * 6, law.start(), wrench)
    quarter = -np.array([2000.0, 4000.0]) * 0.004 / (2.0 * np.pi)
    assert wrench[0] == pytest.approx([0.0, 0.0], abs=1e-12) and wrench[1] == pytest.approx(quarter)
    assert law.on_axes(law.stiffness).tolist() == [[1000.0, 2000.0, 0, 0, 0, 0], [3000.0, 4000.0, 0, 0, 0, 0]]


def test_a_controller_tells_what_its_laws_are() -> None:
    friction = [StickSlip(axes=axis, v_min=0.01, **FRICTION) for axis in ("x", "rz")]
    ahead = HalfSampleWall(axes="z", lower=-2e-3, period=T, **GAINS)
    watch = PassivityController(axes="y", period=T, most=10.0)
    laws = [
        Bias([0, 0, 6.9, 0, 0, 0]),
        Bias([0, 0, 1, 0, 0, 2]),
        *friction,
        ahead,
        Wall(axes="y", upper=1e-3, **GAINS),
        watch,
    ]
    controller = Controller(laws, period=T)
    assert controller.carried == pytest.approx([0, 0, 7.9, 0, 0, 2])
    assert controller.faces == ((2, 1.0, -2e-3), (1, -1.0, 1e-3))
    assert controller.stick_positions is None and list(controller.signals) == ["energy"]
    controller.step(Sample(0, 0.0, [1e-4, 0.0, 0.0, 0.0, 0.0, 2e-4]))
    controller.step(Sample(1, T, [1e-3, 0.0, 0.0, 0.0, 0.0, 2e-4]))
    found = controller.stick_positions
    assert found is not None and np.isnan(found[:5]).all() and found[5] == 2e-4
    # of two laws with a signal of one name, the later one's
    assert controller.signals["stuck"] == [True] and controller.signals["stick_position"] == [2e-4]


@pytest.mark.parametrize(
    "function",
    [
        lambda position, velocity: [-1000.0 * x for x in position],
        lambda position, velocity: -1000.0 * np.array(position),
        lambda position, velocity: tuple(-1000.0 * x for x in position),
    ],
)
def test_a_plain_function_is_a_law(function: Callable[..., Any]) -> None:
    check_law(function)
    controller = Controller([function, Hold(stiffness=500.0, damping=0.0)], period=T)
    force = controller.step(Sample(0, 0.0, [1e-3] * 6)).force
    assert list(force) == pytest.approx([-1.5] * 6) and all(part.__class__ is float for part in force)
    controller.reset()
    assert controller.step(Sample(0, 0.0, components(np.full((3, 6), 1e-3)))).wrench == pytest.approx(
        np.full((3, 6), -1.5)
    )


def put(values: list[Any], index: int, value: Any) -> Any:
    """Set one of some values; return no state."""
    values[index] = value
    return None


COUNT = itertools.count(1)
BAD: dict[str, tuple[Callable[..., Any], str, bool]] = {
    "no return": (lambda p, v, s, w: None, r"must return \(next state, pulse or None\) [(]got None", True),
    "a force": (lambda p, v, s, w: -3.0 * p[0], r"must return \(next state, pulse or None\) .got", True),
    "seventh axis": (lambda p, v, s, w: (w.extend([0.0]), None), "six wrench components", True),
    "seventh index": (lambda p, v, s, w: (put(w, 6, 1.0), None), "raises IndexError", True),
    "pulse of one": (lambda p, v, s, w: (None, [1.0]), "six pulse components", True),
    "not a number": (lambda p, v, s, w: (put(w, 0, math.nan), None), "wrench on x must be finite [(]got nan", True),
    "a word": (lambda p, v, s, w: (put(w, 1, "a"), None), "wrench on y must be a number [(]got 'a'", True),
    "wrong shape": (lambda p, v, s, w: (put(w, 0, np.zeros(2)), None), "wrench on x must be a number", True),
    "changed position": (
        lambda p, v, s, w: (put(p, 0, 1.0), None),
        "must not modify its arguments position and velocity",
        True,
    ),
    "changed velocity": (
        lambda p, v, s, w: (put(v, 0, 1.0), None),
        "must not modify its arguments position and velocity",
        False,
    ),
    "nothing added": (lambda p, v, s, w: (None, None), "zero wrench at every sample", False),
    "floats alone": (
        lambda p, v, s, w: (put(w, 0, w[0] + math.sin(p[0])), None),
        "does not work on arrays of N devices",
        False,
    ),
    "an if": (
        lambda p, v, s, w: (put(w, 0, w[0] + (1.0 if p[0] > 0 else 2.0)), None),
        "does not work on arrays of N devices",
        False,
    ),
    "devices mixed": (
        lambda p, v, s, w: (put(w, 0, w[0] - np.mean(p[0])), None),
        "bit-identical for one device and a batch: x at",
        False,
    ),
    "own state": (
        lambda p, v, s, w: (put(w, 0, w[0] + next(COUNT)), None),
        "not a pure function",
        False,
    ),
}


@pytest.mark.parametrize("name", list(BAD))
def test_a_law_that_is_wrong_is_refused_in_one_line(name: str) -> None:
    # By `check_law`, and where that needs no batch and no second look, at the first sample.
    body, message, first = BAD[name]

    class Wrong(Law):
        def __call__(self, position: Any, velocity: Any, state: Any, wrench: Any) -> Any:
            return body(position, velocity, state, wrench)

    with pytest.raises(ParameterError, match=message) as caught:
        check_law(Wrong())
    assert "\n" not in str(caught.value) and "law Wrong" in str(caught.value)
    if first:
        with pytest.raises(ParameterError, match=message):
            Controller([Wrong()], period=T).step(Sample(0, 0.0, [1e-3] * 6))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (5, "got 5"),
        (Detent, "got <class"),
        (lambda position: [0.0] * 6, r"f\(position, velocity\)"),
        (lambda p, v: [0.0] * 5, "six wrench components .got"),
        (lambda p, v: None, "six wrench components [(]got None"),
    ],
)
def test_what_is_no_law_is_refused(given: Any, message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        Controller([given], period=T).step(Sample(0, 0.0, [0.0] * 6))


def test_a_class_that_is_no_law_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"Short.force must take \(self, x, v, gains, state\)"):

        class Short(AxisLaw):
            def force(self, x: Any) -> Any:  # type: ignore[override]
                return x

    with pytest.raises(ParameterError, match="must not have a gain called faces"):

        class Hidden(AxisLaw):
            faces: float = gain()  # type: ignore[assignment]

    class Silent(AxisLaw):
        pass

    with pytest.raises(ParameterError, match=r"Silent of test_law_base\.py must define force"):
        Controller([Silent()], period=T).step(Sample(0, 0.0, [0.0] * 6))


def test_axes_are_all_six_by_default_and_laws_inherit_gains() -> None:
    class Scaled(Detent):
        share: float = gain(default=2.0)

        def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
            return gains.share * super().force(x, v, gains, state)

    law = Scaled(pitch=0.002, stiffness=1.0)
    assert law.indices == tuple(range(len(AXES))) and law.share == 2.0
    check_law(law)
