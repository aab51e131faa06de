"""Stability of any law against closed forms."""

import math
import operator
import sys
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from maglev_mj import AXES, Controller, Timing, Wall
from maglev_mj.control import (
    AdaptiveWindow,
    AxisLaw,
    Bias,
    Gains,
    Hold,
    Law,
    LowPass,
    PassivityController,
    StickSlip,
    VelocityEstimator,
    VirtualCoupling,
    Window,
    gain,
)
from maglev_mj.errors import MissingPackageError, ParameterError
from maglev_mj.plants.model import body_of
from maglev_mj.scenes.find import find_scene
from maglev_mj.spec import INERTIA
from maglev_mj.theory import Verdict, judge, spectral_radius, stability, stated_gains
from maglev_mj.theory.linearise import ClosedLoop, Linearised, StateSpace, acts_on_each_axis_alone, linearise
from maglev_mj.theory.loop import AffineLaw, _without_integral
from maglev_mj.theory.loop_array import LoopArray
from maglev_mj.theory.read import loops_at
from tests.sweeps import further, sweep

T, DELAY = 0.005, 0.0015
NAMES = ["joystick", "drop", "press", "table", "box", "corner"]


class Detent(AxisLaw):
    """Sine detents."""

    pitch: float = gain(default=0.002, above=0.0)
    stiffness: float = gain()
    damping: float = gain(default=50.0)

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        turn = 2.0 * np.pi / gains.pitch
        return -gains.stiffness / turn * np.sin(turn * x) - gains.damping * v


def silent(position: Sequence[Any], velocity: Sequence[Any]) -> Sequence[Any]:
    """State no gains, and do nothing."""
    return [0.0] * 6


def along_x(force: Callable[[Any, Any], Any]) -> Callable[[Sequence[Any], Sequence[Any]], Sequence[Any]]:
    """Return a law along x."""
    return lambda position, velocity: [force(position[0], velocity[0]), 0.0, 0.0, 0.0, 0.0, 0.0]


def verdict(
    *laws: Any, period: float = T, velocity: VelocityEstimator | None = None, axes: int = 1, **how: Any
) -> Verdict:
    """Return the verdict on laws, other axes held."""
    others = Hold.critically_damped(AXES[axes:], inertia=INERTIA[axes:], period=period, delay=DELAY)
    return judge(Controller([*laws, others], period=period, velocity=velocity), **{"delay": DELAY, **how})


def at_rest(controller: Controller, delay: float) -> float:
    """Return the spectral radius by closed forms, those of free motion left out.

    With friction stuck, as in the linearisation.
    """
    gains = stated_gains(controller)
    assert gains is not None
    sticks = any("stuck" in acting for acting in gains)
    chosen = [pair for acting, pair in gains.items() if ("stuck" in acting) is sticks or not sticks]
    return max(
        closed(k, b, period=controller.period, delay=delay, mass=mass, velocity=controller.velocity)
        for pair in chosen
        for k, b, mass in zip(*pair, INERTIA)
    )


def closed(stiffness: float, damping: float, **loop: Any) -> float:
    """Return the spectral radius by closed forms, those of free motion left out."""
    roots = np.linalg.eigvals(LoopArray(**loop).matrix(stiffness, damping))
    free = 0 if stiffness > 0.0 else 1 if damping > 0.0 else 2
    return float(np.abs(roots[np.argsort(np.abs(roots - 1.0))[free:]]).max())


def exact(law: AxisLaw, start: Any, *, period: float, delay: float, mass: float) -> NDArray[Any]:
    """Return the roots of a linear law's loop, nearest to 1 first, for a state `start` after rest at 0."""
    size = np.size(start)
    gains: Any = SimpleNamespace(**{name: getattr(law, name) for name in type(law).__annotations__})

    def step(row: Any) -> Any:
        x, before, state = row[0], row[1], row[2:]
        given = tuple(state) if isinstance(start, tuple) else state[0]
        force, after = law.force(x, (x - before) / period, gains, given)
        return np.array([force, *np.atleast_1d(after)])

    # position, speed, last command, last position, the law's states
    columns = [step(row) for row in np.eye(2 + size)]
    law_row = np.zeros((1 + size, 4 + size))
    law_row[:, 0], law_row[:, 3], law_row[:, 4:] = columns[0], columns[1], np.array(columns[2:]).T
    matrix, rest = np.zeros((4 + size, 4 + size)), period - delay
    late, early = (np.array([time**2 / 2.0, time]) / mass for time in (delay, rest))
    matrix[:2, :2] = [[1.0, period], [0.0, 1.0]]
    matrix[:2, 2] = np.array([[1.0, rest], [0.0, 1.0]]) @ late
    matrix[:2] += np.outer(early, law_row[0])
    matrix[2], matrix[3, 0], matrix[4:] = law_row[0], 1.0, law_row[1:]
    roots = np.linalg.eigvals(matrix)
    return np.asarray(roots[np.argsort(np.abs(roots - 1.0))])


@pytest.mark.parametrize("name", ["joystick", "drop", "corner", *further("press", "table", "box")])
def test_the_numerical_verdict_is_that_of_the_closed_forms(name: str) -> None:

    random = np.random.default_rng([NAMES.index(name), 0])
    values = dict(
        stiffness=float(10.0 ** random.uniform(2.0, 4.7)),
        damping=float(10.0 ** random.uniform(0.0, 2.6)),
        friction=bool(random.integers(2)),
        wall=bool(random.integers(2)),
        period=float(random.choice([0.005, 0.002, 0.01])),
        delay=float(random.choice([0.0, 0.0015, 0.005, 0.0065])),
    )
    scene = find_scene(name)()
    scene = scene.replace(**{one: value for one, value in values.items() if one in scene.as_json()})
    laws = scene.laws()
    how: dict[str, Any] = {"delay": scene.delay, "pose": scene.start().pose}
    stated = Controller(laws, period=scene.period)
    closed, found = judge(stated, **how), judge(Controller([*laws, silent], period=scene.period), **how)
    assert closed.stated and not found.stated
    assert found.stable is closed.stable, scene
    assert found.spectral_radius == pytest.approx(at_rest(stated, scene.delay), abs=1e-9), scene


@pytest.mark.parametrize(
    ("gains", "velocity"),
    sweep(
        [(6000.0, 80.0), (1000.0, 100.0), (0.0, 30.0), (20000.0, 80.0)],
        [None, LowPass(), LowPass(20.0), Window(4)],
        every=4,
    ),
)
def test_velocity_estimates_are_found_as_they_are(
    gains: tuple[float, float], velocity: VelocityEstimator | None
) -> None:
    hold = Hold(stiffness=gains[0] * np.array(INERTIA), damping=gains[1] * np.array(INERTIA))
    loop: Any = {"period": T, "delay": DELAY, "mass": 1.0, "velocity": velocity}
    expected = closed(*gains, **loop)
    for extra in ([], [silent]):
        found = judge(Controller([hold, *extra], period=T, velocity=velocity), delay=DELAY)
        assert found.stated is not bool(extra)
        assert found.spectral_radius == pytest.approx(expected, abs=1e-8)
        assert found.stable is (expected < 1.0)


def test_an_estimate_that_is_not_linear_is_linearised() -> None:
    controller = Controller(
        [Hold(axes="x", stiffness=1000.0, damping=20.0)], period=T, velocity=AdaptiveWindow(longest=4)
    )
    assert stated_gains(controller) is None
    (near,) = linearise(controller, np.zeros((1, 6)))
    # below its resolution it looks as far back as it may
    assert near.response[0, 0, 0] == pytest.approx(-1000.0 - 20.0 / (4 * T), rel=1e-6)


def test_stuck_friction_is_stable_and_the_controller_left_as_it_is() -> None:
    law = StickSlip(axes="x", stiffness=3000.0, damping=30.0, breakaway=2.0, v_min=0.005)
    controller = Controller([law, silent], period=T)
    before = controller.states
    assert judge(controller, delay=DELAY).stable is True and controller.states == before


@pytest.mark.parametrize("stiffness", [9870.0, 8000.0])
def test_detents_are_judged_at_their_bottoms(stiffness: float) -> None:
    # A crest is no place of rest, whatever the wall: set aside, and counted.
    found = verdict(Detent(axes="x", stiffness=stiffness), pose=[2e-4, 0, 0, 0, 0, 0])
    assert found.stable is (stiffness < 9000.0) and len(found.away) > 0
    assert "unstable equilibrium" in found.remarks[-1]
    if stiffness == 9870.0:
        assert found.spectral_radius == pytest.approx(1.0308, abs=1e-4) and found.axes == ("x",)
        assert found.spectral_radius == pytest.approx(
            float(spectral_radius(9870.0, 50.0, period=T, delay=DELAY)), abs=1e-8
        )
        assert str(found) == "x: unstable, spectral radius 1.031"


def circulating(position: Sequence[Any], velocity: Sequence[Any]) -> Sequence[Any]:
    """Couple x and y; no axis alone is unstable."""
    (x, y), (u, v) = position[:2], velocity[:2]
    return [-2000.0 * x - 30.0 * u + 1500.0 * y, -2000.0 * y - 30.0 * v - 1500.0 * x, 0.0, 0.0, 0.0, 0.0]


def test_axes_that_act_on_each_other_are_judged_together() -> None:
    found = verdict(circulating, axes=2)
    assert (
        found.stable is False and found.axes == ("x", "y") and found.spectral_radius == pytest.approx(1.0235, abs=1e-4)
    )
    (near,) = linearise(Controller([circulating], period=T), np.zeros((1, 6)))
    assert near.stiffness[:2, :2] == pytest.approx(np.array([[2000.0, -1500.0], [1500.0, 2000.0]]))
    assert near.closed_loop(delay=DELAY, axes=("x", "y")).spectral_radius == pytest.approx(
        found.spectral_radius, abs=1e-9
    )
    assert near.closed_loop(delay=DELAY, axes="x").spectral_radius < 1.0


def test_walls_that_state_no_gains_are_judged_inside_their_faces() -> None:
    common: dict[str, Any] = {"axes": "x", "lower": -0.00447, "damping": 80.0, "period": T}
    for stiffness in (4000.0, 20000.0):
        coupled = VirtualCoupling(**common, inertia=INERTIA[0], stiffness=stiffness)
        assert [face[0] for face in coupled.faces()] == [0]
        found = verdict(coupled, Bias([0.0] * 6))
        assert found.stable is (stiffness < 9000.0), found.spectral_radius


def test_a_start_on_an_edge_is_moved_off_it_and_jumps_are_counted() -> None:
    # Else each pose of the grid but those along that axis would be a jump.
    found = verdict(along_x(lambda x, v: (x < 0.0) * -(3000.0 * x + 50.0 * v)))
    assert found.stable is True and 1 <= len(found.jumps) <= 2
    assert "discontinuous force" in found.remarks[0]
    relay = along_x(lambda x, v: -0.5 * ((x > 0.0) * 1.0 - (x < 0.0) * 1.0) - 20.0 * v)
    found = verdict(relay)  # smooth to both sides, but it rests on the jump
    assert found.stable is None and len(found.jumps) == 1
    assert found.doubts == {"x": "a load is carried by a jump of force, 0.5 N at 0 mm"}
    # a force that jumps with the speed jumps wherever the flotor rests: nothing is known
    coulomb = verdict(along_x(lambda x, v: -0.5 * ((v > 0.0) * 1.0 - (v < 0.0) * 1.0)))
    assert coulomb.stable is None and len(coulomb.jumps) > 100


@pytest.mark.parametrize("period", [0.005, 1e-4])
def test_displacements_stay_below_the_speed_at_which_friction_slides(period: float) -> None:
    law = along_x(lambda x, v: (abs(v) < 4e-4) * (-3000.0 * x) - 20.0 * v)
    (near,) = linearise(Controller([law], period=period), np.zeros((1, 6)))
    assert near.stiffness[0, 0] == pytest.approx(3000.0) and not near.jumps.any()


def test_an_axis_without_stiffness_is_stable() -> None:
    # It may stay anywhere: one root at 1, or two without damping, which are split off.
    others = Hold.critically_damped(AXES[1:], inertia=INERTIA[1:], period=T, delay=DELAY)
    held = at_rest(Controller([others], period=T), DELAY)
    for force in (lambda x, v: -30.0 * v, lambda x, v: -1e-9 * x - 1e-12 * v):
        found = verdict(along_x(force))
        assert found.stable is True and found.spectral_radius == pytest.approx(held, abs=1e-6)
    assert verdict(along_x(lambda x, v: -400.0 * v)).stable is False


class Washout(AxisLaw):
    """Spring that pushes away and yields: no stiffness but for the cut-off part of its answer."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        slow = x if state is None else state + 0.05 * (x - state)
        return 200.0 * (x - slow) - 30.0 * v, slow


def test_the_end_of_a_long_answer_does_not_push_away() -> None:
    found = verdict(Washout(axes="x"))
    roots = exact(Washout(axes="x"), 0.0, period=T, delay=DELAY, mass=INERTIA[0])
    assert abs(roots[0] - 1.0) < 1e-12 and found.spectral_radius == pytest.approx(np.abs(roots[1:]).max(), abs=1e-9)
    assert found.stable is True and not found.remarks


class VirtualMass(AxisLaw):
    """Mass that the flotor draws along by a spring and a damper."""

    mass: float = gain(default=1.0)
    stiffness: float = gain(default=1000.0)
    damping: float = gain(default=10.0)

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        place, speed = (x, 0.0 * x) if state is None else state
        force = gains.stiffness * (place - x) + gains.damping * (speed - v)
        speed = speed - 0.001 * force / gains.mass
        return force, (place + 0.001 * speed, speed)


def test_a_virtual_mass_is_judged_without_its_free_motion() -> None:
    for mass, stiffness, damping in ((0.1, 500.0, 5.0), (1.0, 20000.0, 4.0)):
        law = VirtualMass(axes="z", mass=mass, stiffness=stiffness, damping=damping)
        roots = exact(law, (0.0, 0.0), period=0.001, delay=0.0005, mass=INERTIA[2])
        assert np.abs(roots[:2] - 1.0).max() < 1e-6  # a double root is known to half of the digits
        found = judge(Controller([law], period=0.001), delay=0.0005)
        assert found.spectral_radius == pytest.approx(np.abs(roots[2:]).max(), abs=1e-9) and found.axes == ("z",)
        assert found.stable is bool(np.abs(roots).max() < 1.0 + 1e-6) and not found.remarks


class Integral(AxisLaw):
    """Proportional, integral and derivative action, with a leak."""

    leak: float = gain(default=0.0)

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        area = (0.0 if state is None else state) * (1.0 - gains.leak) + 0.005 * x
        return -1000.0 * x - 40.0 * v - 1000.0 * area, area


@pytest.mark.parametrize("leak", [0.0, 0.1, *further(1e-4)])
def test_an_integral_is_judged_by_its_own_root(leak: float) -> None:
    found = verdict(law := Integral(axes="x", leak=leak))
    roots = exact(law, 0.0, period=T, delay=DELAY, mass=INERTIA[0])
    assert found.stable is True and found.spectral_radius == pytest.approx(np.abs(roots).max(), abs=1e-9)
    if leak in (0.0, 0.1):  # with a leak the integral has a static stiffness, too
        assert found.stiffness[0, 0] == pytest.approx(1050.0 if leak else 1000.0)
        assert leak or found.damping[0, 0] == pytest.approx(40.0)

    class Corner(Integral):
        """The same at one end of the range only."""

        def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
            area = (0.0 if state is None else state) * (1.0 - gains.leak) + (x < -3e-3) * 0.005 * x
            return -1000.0 * x - 40.0 * v - 1000.0 * area, area

    if leak == 0.1:
        there = verdict(Corner(axes="x", leak=leak))
        assert there.stable is True and not len(there.unknown)
        assert there.spectral_radius >= np.abs(roots).max() - 1e-9


WEIGHTS = np.random.default_rng(0).standard_normal(600)


class Echo(AxisLaw):
    """Force by the positions of 600 samples, as no law of few states has it."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        line = (x,) * len(WEIGHTS) if state is None else (x, *state[:-1])
        return -1000.0 * x - 40.0 * v - sum(map(operator.mul, WEIGHTS, line)), line


class Cave(Echo):
    """Echo at one end of the range only."""

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        echo, line = super().force(x, v, gains, state)
        near = x < -3e-3
        return near * echo + (1.0 - near) * (-1000.0 * x - 40.0 * v), line


def test_an_answer_that_does_not_die_away_is_not_known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("maglev_mj.theory.linearise._MOST_SAMPLES", 40)
    monkeypatch.setattr("tests.theory.test_linearise.WEIGHTS", WEIGHTS[:128])
    found = verdict(Echo(axes="x"))
    assert found.stable is None and len(found.unknown) > 100 and "512 samples" in found.remarks[1]
    assert str(found).startswith("not computed on x: ") and found.unjudged == ("x",)
    # nor is a controller known that is stable at all poses but a few
    few = verdict(Cave(axes="x"))
    assert few.stable is None and few.spectral_radius < 1.0 and 0 < len(few.unknown) < 10
    # what is unstable for certain is said to be
    assert verdict(Echo(axes="y"), Hold(axes="x", stiffness=20000.0, damping=80.0), axes=2).stable is False
    with np.errstate(invalid="ignore"):
        (near,) = linearise(Controller([along_x(lambda x, v: np.sqrt(1e-16 - x * x))], period=T), np.zeros((1, 6)))
    assert near.settled.tolist() == [False, True, True, True, True, True]  # what is not finite is not known


def test_laws_of_floats_alone_and_laws_that_mix_devices_are_asked_one_by_one() -> None:
    poses = [[0.0] * 6, [1e-3, 0.0, 0.0, 0.0, 0.0, 0.0]]
    for force in (lambda x, v: -5.0 * math.sin(100.0 * x), lambda x, v: -5.0 * np.sin(100.0 * np.max(x))):
        for near, pose in zip(linearise(Controller([along_x(force)], period=T), poses), poses, strict=True):
            assert near.stiffness[0, 0] == pytest.approx(500.0 * math.cos(100.0 * pose[0]), rel=1e-6)


def test_a_scene_of_any_kind_is_judged() -> None:
    controller = Controller([Hold(stiffness=np.array(INERTIA) * 3e4, damping=np.array(INERTIA) * 300.0)], period=T)
    scene: Any = SimpleNamespace(
        delay=DELAY,
        controller=lambda: controller,
        start=lambda: SimpleNamespace(pose=[0.0] * 6),
        timing=lambda: Timing(period=T, delay=DELAY),
        body=body_of({}),
    )
    assert stability(scene).stable is False
    heavy = stability(scene, inertia=np.array(INERTIA) * 10.0)
    assert heavy.stable is True and heavy.spectral_radius == pytest.approx(
        float(spectral_radius(3e3, 30.0, mass=1.0)), abs=1e-9
    )


def test_a_stated_gain_below_zero_is_judged_numerically() -> None:
    class Negative(Law):
        def gains(self) -> list[Gains]:
            return [Gains("always", np.full(6, -300.0), np.zeros(6))]

        def __call__(self, position: Any, velocity: Any, state: Any, wrench: Any) -> Any:
            wrench[0] = wrench[0] + 300.0 * position[0]
            return None, None

    found = verdict(Negative())
    assert not found.stated and found.stable is False


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ({"delay": -1.0}, "delay must be"),
        ({"delay": 1.1}, "delay must be between 0 and 1 s"),
        ({"delay": 0.0, "pose": [0.0] * 3}, r"shape \(6,\)"),
        ({"delay": 0.0, "inertia": [0.0] * 6}, "above 0"),
    ],
)
def test_bad_values_are_refused(how: dict[str, Any], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        judge(Controller([silent], period=T), **how)
    with pytest.raises(ParameterError, match="batch shape"):
        judge(Controller([Hold(stiffness=np.ones((3, 6)), damping=0.0)], period=T), delay=0.0)


def test_a_state_space_needs_python_control(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "control", None)
    (near,) = linearise(Controller([silent], period=T), np.zeros((1, 6)))
    with pytest.raises(MissingPackageError, match=r"python-control: .* -m pip install '?(control>=|\.\[control)"):
        near.to_statespace()


def responses(system: Sequence[Any], inputs: NDArray[Any]) -> NDArray[Any]:
    """Return the outputs of a state space (A, B, C, D), (n, K), by its recurrence."""
    advance, enters, seen, direct = system[:4]
    state, rows = np.zeros(len(advance)), []
    for column in inputs.T:
        rows.append(seen @ state + direct @ column)
        state = advance @ state + enters @ column
    return np.array(rows).T


def held_loop() -> tuple[Linearised, ClosedLoop]:
    """Return the linearisation of a hold on all axes, and its loop."""
    hold = Hold(stiffness=np.array(INERTIA) * 4000.0, damping=np.array(INERTIA) * 60.0)
    (near,) = linearise(Controller([hold], period=T, velocity=LowPass()), np.zeros((1, 6)))
    return near, near.closed_loop(delay=DELAY)


def test_state_spaces_of_controller_and_loop_answer_as_they_do(monkeypatch: pytest.MonkeyPatch) -> None:
    there = SimpleNamespace(ss=lambda *system: system, __spec__=object())
    monkeypatch.setitem(sys.modules, "control", there)
    near, loop = held_loop()
    law, plant = near.to_statespace(), loop.to_statespace()
    assert law[4] == plant[4] == T and np.abs(np.linalg.eigvals(plant[0])).max() == pytest.approx(
        loop.spectral_radius, abs=1e-9
    )
    # the flotor under a constant push, in the loop and with the controller around it
    push = np.zeros((6, 300))
    push[0] = 1.0
    moved = responses(plant, push)
    # a push held for a period moves the flotor from rest by T²/2m, before any law answers
    assert moved[0, 1] == pytest.approx(T**2 / 2.0 / INERTIA[0], rel=1e-12)
    free = linearise(Controller([silent], period=T), np.zeros((1, 6)))[0].closed_loop(delay=DELAY).to_statespace()
    times = T * np.arange(300)
    np.testing.assert_allclose(responses(free, push)[0], times**2 / 2.0 / INERTIA[0], rtol=1e-9)
    assert moved[0, -1] == pytest.approx(1.0 / near.stiffness[0, 0], rel=1e-3)
    answer = responses(law, moved)
    assert answer[0, -1] == pytest.approx(-1.0, rel=1e-3)
    # each answer is the sum over the positions so far, the newest first
    past = np.convolve(moved[0], near.response[:, 0, 0])[: len(times)]
    assert len(near.response) > 3
    np.testing.assert_allclose(answer[0], past, atol=1e-12)


def test_a_hold_on_an_axis_without_a_wall_is_judged_too() -> None:
    laws = [Wall(axes="z", lower=0.0, stiffness=1000.0, damping=40.0), Hold(axes="ry", stiffness=5e4, damping=1.0)]
    found = judge(Controller(laws, period=0.005), delay=DELAY)
    assert (found.stable, found.axes, found.stated) == (False, ("ry",), True)
    # of two that are unstable the worse is named
    worse = [*laws, Hold(axes="z", stiffness=1e9, damping=1.0)]
    assert judge(Controller(worse, period=0.005), delay=DELAY).axes == ("z",)


class Growing(AxisLaw):
    """Wall without declared faces; its damping grows with depth."""

    edge: float = gain(at_least=-np.inf)
    side: float = gain(at_least=-1.0)
    growth: float = gain(above=0.0)

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        depth = (gains.edge - x) * gains.side
        damping = 80.0 * np.minimum(depth / gains.growth, 1.0)
        return np.where(depth > 0.0, gains.side * 6000.0 * depth - damping * v, 0.0)


@pytest.mark.parametrize("edge", [0.0, 1.3e-4, -2.2e-3, 3.9e-3])
@pytest.mark.parametrize("growth", [1e-4, 1e-3, 4e-3])
def test_a_law_unstable_near_an_edge_alone_is_unstable(edge: float, growth: float) -> None:
    axis = AXES[int(1e4 * abs(edge)) % 3]
    law = Growing(axes=axis, edge=edge, side=-1.0 if edge < 0.0 else 1.0, growth=growth)
    found = judge(Controller([law, Hold(axes="ry", stiffness=1.0, damping=0.01)], period=T), delay=DELAY)
    assert found.stable is False and found.axes == (axis,)
    assert found.spectral_radius == pytest.approx(spectral_radius(6000.0, 0.0, period=T, delay=DELAY), abs=0.005)


@pytest.mark.parametrize("most", [50_000, 5000, 30])
def test_the_calls_of_a_law_are_limited(most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = 0

    def slow(position: Sequence[Any], velocity: Sequence[Any]) -> list[float]:
        nonlocal calls
        calls += 1
        return [-300.0 * float(position[0]) - 3.0 * float(velocity[0]), 0.0, 0.0, 0.0, 0.0, 0.0]

    monkeypatch.setattr("maglev_mj.theory.linearise._MOST_CALLS", most)
    controller = Controller([slow], period=T)
    if most == 50_000:
        assert judge(controller, delay=DELAY).stable and calls < 40_000
        return
    verdict = judge(controller, delay=DELAY)
    assert verdict.stable is None and verdict.unjudged == AXES and math.isnan(verdict.critical_delay)
    assert f"law slow needs more than {most} calls: accept arrays" in str(verdict)
    assert calls < 2.0 * most  # of the probes, and of the linearisation
    (loop,) = loops_at([controller], 0, poses=[[0.0] * 6], delay=DELAY, inertia=np.array(INERTIA))
    assert most > 30 or (loop.reason and math.isnan(loop.spectral_radius))


@pytest.mark.parametrize("kind", [StickSlip, PassivityController, Wall, Hold])
def test_laws_that_act_on_each_axis_alone_are_displaced_on_all_axes_at_once(
    kind: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    gains: Any = {"stiffness": 3000.0, "damping": 20.0}
    laws: dict[Any, list[Law]] = {
        StickSlip: [StickSlip(axes=AXES, breakaway=0.1, v_min=0.01, **gains), Hold(axes="z", **gains)],
        PassivityController: [Hold(**gains), PassivityController(period=T, most=10.0)],
        Wall: [
            Wall(axes="z", lower=0.0, pulse=30.0, pulse_width=T, **gains),
            Hold(axes="rx", stiffness=2.0, damping=0.01),
        ],
        Hold: [Hold(axes=["x", "ry"], target=1e-3, **gains)],
    }
    controller = Controller(laws[kind], period=T)
    poses = np.random.default_rng(1).uniform(-1e-3, 1e-3, (4, 6))
    each = linearise(controller, poses)
    monkeypatch.setattr("maglev_mj.theory.linearise.acts_on_each_axis_alone", lambda controller: False)
    for alone, full in zip(each, linearise(controller, poses), strict=True):
        np.testing.assert_allclose(alone.response, full.response, atol=1e-9 * np.abs(full.response).max())
        assert (alone.jumps == full.jumps).all() and (alone.settled == full.settled).all()


def test_a_law_that_couples_axes_is_displaced_on_each_axis() -> None:
    class Sum(AxisLaw):
        stiffness: float = gain("stiffness", "N/m")

        def __call__(self, position: Any, velocity: Any, state: Any, wrench: Any) -> Any:
            wrench[0] = wrench[0] - self.stiffness * (position[0] + position[1])
            return state, None

    for laws in (
        [Sum(axes="x", stiffness=100.0)],
        [StickSlip(axes="x", stiffness=1.0, damping=1.0, breakaway=1.0, v_min=1.0, coupled=True)],
    ):
        assert not acts_on_each_axis_alone(Controller(laws, period=T))
    assert linearise(Controller([Sum(axes="x", stiffness=100.0)], period=T), np.zeros(6))[0].stiffness[0, 1]


def test_an_integrator_is_left_out_of_the_static_stiffness_and_a_double_one_is_not() -> None:
    # 100 / ((z - 1)(z - 0.5)) = 200 / (z - 1) - 200 / (z - 0.5)
    single = StateSpace(np.array([[1.0, 0.0], [100.0, 0.5]]), np.eye(2)[:, :1], np.eye(2)[1:], np.zeros((1, 1)))
    static, ages = _without_integral(single)
    assert (static.item(), ages.item()) == pytest.approx((-200.0 - 400.0, -800.0), rel=1e-12)
    double = StateSpace(np.array([[1.0, 0.0], [1.0, 1.0]]), np.eye(2)[:, :1], np.eye(2)[1:], np.zeros((1, 1)))
    assert np.isneginf(_without_integral(double)[0]).all()


@pytest.mark.parametrize(("error", "affine"), [(0.9e-6, True), (1.1e-6, False)])
def test_a_law_is_affine_in_a_gain_to_1e_6(error: float, affine: bool) -> None:
    responses = np.outer([1.0, 2.0, 3.0 * (1.0 + error)], [-5.0, 4.0]) - 1.0
    assert (AffineLaw.of(responses, (1.0, 2.0, 3.0), StateSpace.of) is not None) == affine
