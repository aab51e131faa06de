"""Settings by other programs: own walls, and their stability check."""

import json
import random
from typing import Any

import mujoco
import numpy as np
import pytest

from maglev_mj import AXES
from maglev_mj.bridge.preflight import check_change
from maglev_mj.control import Hold, Law
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Sample
from maglev_mj.parameters import param
from maglev_mj.plants.model import model_path
from maglev_mj.scenes import BUILT_IN, Scene, find_scene
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.interactive import Box, Corner, InteractiveScene, Joystick, TableTop
from maglev_mj.scenes.run import run
from maglev_mj.scenes.stability_check import marks, stability_warning, started, wall_loops
from maglev_mj.session import STEP_FORCE, check_step
from maglev_mj.session.margin import margin
from maglev_mj.spec import RANGE
from maglev_mj.theory import judge, largest_stable_stiffness, stability
from tests.bridge.test_preflight import GOOD
from tests.cells import unstable
from tests.published import INERTIA, MASS
from tests.sweeps import sweep
from tests.theory.test_linearise import WEIGHTS, Detent, Echo

ANGLES = dict.fromkeys(("rx", "ry", "rz"), float(np.radians(6.0)))


def test_walls_that_are_none_are_refused() -> None:
    refused: list[tuple[Any, str]] = [
        (5, "walls must be a list"),
        (["z"], r"a wall must be \[axis, normal, edge\] \(got 'z'"),
        ([["q", 1, 0.0]], r"a wall's axis must be one of x, y, z, rx, ry, rz \(got 'q'\)"),
        ([["z", 2, 0.0]], "a wall's normal must be 1 or -1 .got 2"),
        ([["z", 1, "low"]], "a wall's edge on z must be a finite number"),
        ([["z", 1, 0.0], ["z", 1, 0.001]], "got two of normal 1 on z"),
        ([["z", 1, 0.002], ["z", -1, 0.001]], "walls must leave a gap .got 0.002 to 0.001 on z"),
    ]
    for walls, says in refused:
        with pytest.raises(ParameterError, match=says):
            Joystick.from_json({"walls": walls})


@pytest.mark.parametrize(("axis", "reach"), [*dict.fromkeys("xyz", 0.0045).items(), *ANGLES.items()])
def test_an_edge_is_within_the_workspace(axis: str, reach: float) -> None:
    cls = Joystick
    for normal in (1, -1):
        for edge in (-reach, reach):
            assert cls.from_json({"walls": [[axis, normal, edge]]}).as_json()["walls"] == ((axis, normal, edge),)
        for edge in (-np.nextafter(reach, 1.0), np.nextafter(reach, 1.0), 1.0, -1.0):
            with pytest.raises(ParameterError) as error:
                cls().replace(walls=[[axis, normal, float(edge)]])
            allowed = f"between -{reach:g} and {reach:g}"
            assert str(error.value) == f"a wall's edge on {axis} must be {allowed} (got {float(edge)!r})"


class Pushing(Scene):
    """A constant push, held or in pulses."""

    axis_pushed: str = param("where", default="x", live=True)
    held: float = param("held force", "N", default=0.0, live=True)
    pulsed: float = param("force of a pulse", "N", default=0.0, live=True)

    def laws(self) -> list[Law]:
        return [Push(AXES.index(self.axis_pushed), self.held, self.pulsed)]


class Push(Law):
    """Law that pushes on one axis, a thousand times as hard with a velocity."""

    pulse_width = 0.001

    def __init__(self, axis: int, held: float, pulsed: float) -> None:
        self._axis, self._held, self._pulsed = axis, held, pulsed

    def __call__(self, position: Any, velocity: Any, state: Any, wrench: list[Any]) -> Any:
        wrench[self._axis] += self._held + 1000.0 * velocity[self._axis] + position[self._axis]
        pulse = [0.0] * 6
        pulse[self._axis] = self._pulsed
        return state, pulse if self._pulsed else None


@pytest.mark.parametrize(("axis", "sign", "limit"), sweep(AXES, [1.0, -1.0], [STEP_FORCE, 0.5], every=3))
def test_a_step_of_force_is_at_most_the_limit(axis: str, sign: float, limit: float) -> None:
    # On every axis, held or in a pulse, from whatever acts now; the pose counts, the speed does not.
    most, unit = (limit, "N") if axis in "xyz" else (0.05 * limit, "N m")
    scene = Pushing(axis_pushed=axis, held=sign * 3.0)
    present, place = scene.controller(), [1e-3] * 6
    for tick in range(3):  # it moves
        present.step(Sample(tick, tick * 0.005, [1e-3 * tick] * 6))
    for part in ("held", "pulsed"):
        before = scene.as_json()[part]
        for step in (sign, -sign):
            check_step(present, scene.replace(**{part: before + 0.99 * step * most}).controller(), place, limit)
            far = scene.replace(**{part: before + 1.01 * step * most}).controller()
            with pytest.raises(ParameterError) as error:
                check_step(present, far, place, limit)
            assert str(error.value) == (
                f"force step on {axis} at the present pose must be at most {most:g} {unit} "
                f"(got {1.01 * step * most:+.3g} {unit})"
            )
    assert present.step(Sample(3, 0.015, [3e-3] * 6)).force[AXES.index(axis)] != 0.0  # it goes on as it was


def test_a_step_is_that_of_what_acts_now() -> None:
    # Friction that holds 1.9 N would let go; a wall takes the place of one that pushes as much.
    table = TableTop(breakaway=3.0)
    stuck = table.controller()
    for tick, x in enumerate((0.0, 0.0, 0.0, 0.35e-3, 0.35e-3)):
        stuck.step(Sample(tick, 0.005 * tick, [x, 0.0, 0.0, 0.0, 0.0, 0.0]))
    inside = [0.35e-3, 0.0, 0.0, 0.0, 0.0, 0.0]
    assert stuck.at_rest(inside).force[0] == pytest.approx(-6000.0 * 0.35e-3)
    with pytest.raises(ParameterError, match=r"force step on x .* at most 2 N \(got \+2\.1 N"):
        check_step(stuck, table.controller(), inside)
    one, other = (Joystick(walls=[("x", -1, edge)]).controller() for edge in (0.001, 0.0012))
    check_step(one, other, [0.004, 0.0, 0.0, 0.0, 0.0, 0.0])
    with pytest.raises(ParameterError, match="force step on x"):
        check_step(Joystick().controller(), other, [0.003, 0.0, 0.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("name", ["joystick", "table", "box", "corner"])
def test_walls_of_the_settings_take_the_place_of_the_scenes_own(name: str) -> None:
    cls, walls = find_scene(name), [("x", 1, -0.002), ("rz", -1, 0.03), ("z", 1, 0.001), ("z", -1, 0.003)]
    scene = cls().replace(wall=True, friction=False, walls=walls)
    faces = scene.controller().faces
    assert sorted(faces) == sorted((AXES.index(axis), float(normal), edge) for axis, normal, edge in walls)
    assert scene.replace(wall=False).controller().faces == ()
    assert scene.replace(walls=[]).controller().faces == ()
    assert cls.from_json(json.loads(json.dumps(scene.as_json()))) == scene


@pytest.mark.parametrize(
    ("name", "delay", "period"),
    sweep(["joystick", "table", "box", "corner"], [0.0, 0.0015, 0.004], [5e-3, 1e-3], every=3),
)
def test_settings_are_refused_from_the_boundary_of_theory_on(name: str, delay: float, period: float) -> None:
    # Just below the largest stable stiffness they may be had, just above they may not, with the figures of theory.
    chosen = find_scene(name)().replace(period=period, delay=delay, pulse=False)
    assert isinstance(chosen, InteractiveScene)
    on = "friction" if chosen.friction else "walls"
    held = [law for law in chosen.laws() if isinstance(law, Hold)]
    springs = max(float(np.max(law.stiffness)) for law in held if "x" in law.axes) if name != "table" else 0.0
    dampers = max(float(np.max(law.damping)) for law in held if "x" in law.axes) if name != "table" else 0.0
    bound = float(largest_stable_stiffness(chosen.damping + dampers, period=period, delay=delay, mass=MASS))
    assert judge(chosen.replace(stiffness=0.999 * (bound - springs))).stable
    refused = judge(chosen.replace(stiffness=1.001 * (bound - springs)))
    assert refused.stable is False and refused.details.startswith(on) and refused.spectral_radius > 1.0
    share = 1.0 if refused.axes[0] in AXES[:3] else INERTIA[AXES.index(refused.axes[0])] / MASS
    assert refused.critical_stiffness == pytest.approx(bound * share, rel=1e-6) and refused.ratio < 1.0
    assert "must be below 1" in refused.details and "stable up to" in refused.details


def test_a_scene_is_checked_with_another_delay_or_flotor() -> None:
    for delay, stable in ((0.0, True), (0.0015, True), (0.003, False)):
        verdict = judge(Box(stiffness=9000.0), delay=delay)
        assert verdict.stable is stable and verdict.loop is not None and verdict.loop.delay == delay
    for mass, stable in ((0.7, True), (0.35, False)):
        assert judge(Drop(), inertia=[mass] * 3 + [1e-3] * 3).stable is stable


@pytest.mark.parametrize("count", [16, pytest.param(100, marks=pytest.mark.study)])
def test_every_legal_scene_is_judged(count: int) -> None:
    draw, stable = random.Random(3), 0
    for _ in range(count):
        cls = draw.choice((Joystick, TableTop, Box, Corner))
        values: dict[str, Any] = {name: draw.random() < 0.5 for name in ("wall", "friction", "pulse", "weightless")}
        values |= {"stiffness": 10 ** draw.uniform(0, 6), "damping": 10 ** draw.uniform(-2, 4)}
        if draw.random() < 0.5:
            reaches = zip(AXES, RANGE, strict=True)
            values["walls"] = [[axis, 1, draw.uniform(-reach, reach)] for axis, reach in reaches if draw.random() < 0.5]
        stable += judge(cls(period=draw.choice((5e-3, 1e-3)), delay=draw.uniform(0.0, 5e-3), **values)).stable is True
    assert 0.1 * count < stable < 0.9 * count


class Detents(Scene):
    """Detents along x."""

    shown_axis = "x"

    stiffness: float = param("stiffness at a bottom", "N/m", default=4000.0)
    damping: float = param("damping", "N s/m", default=50.0)

    def laws(self) -> list[Law]:
        others = Hold.critically_damped(AXES[1:], inertia=INERTIA[1:], period=self.period, delay=self.delay)
        return [Detent(axes="x", stiffness=self.stiffness, damping=self.damping), others]


class Echoing(Detents):
    """Detents and an echo."""

    def laws(self) -> list[Law]:
        return [Echo(axes="x"), *super().laws()]


def test_a_law_that_states_no_gains_is_judged_too() -> None:
    assert judge(Detents()).stable
    refused = judge(Detents(stiffness=9870.0))
    assert refused.stable is False and refused.axes == ("x",) and refused.details.startswith("all laws on x")
    assert refused.spectral_radius == pytest.approx(1.0308, abs=1e-4)
    assert refused.gains == pytest.approx((9870.0, 50.0), rel=1e-6)
    assert judge(Detents(stiffness=0.999 * refused.critical_stiffness)).stable
    assert judge(Detents(stiffness=1.001 * refused.critical_stiffness)).stable is False
    assert "(must be below 1)" in refused.details


class Slow(Drop):
    """Drop on a wall of floats that states no gains."""

    calls = 0

    def laws(self) -> list[Any]:
        def slow(position: Any, velocity: Any) -> list[float]:
            Slow.calls += 1
            depth = min(float(position[2]), 0.0)
            return [
                0.0,
                0.0,
                -self.stiffness * depth - self.damping * float(velocity[2]) * (depth < 0.0),
                0.0,
                0.0,
                0.0,
            ]

        return [slow]


CALLS = {50_000: 40_484, 2000: 4324}
"""Calls for a verdict: lines along the axes, probes and linearisation, of which the last two have the limit each."""
AT_THE_WALL, TICKS = 1459, 5
"""Calls for the loop of the wall alone, and for the run itself."""


@pytest.mark.parametrize("limit", [50_000, 2000])
@pytest.mark.parametrize(
    ("asked", "besides", "says"),
    [
        (lambda scene: run(scene, plant="exact").warnings, TICKS, "not computed"),
        (stability_warning, 0, "not computed"),
        (lambda scene: judge(wall_loops(scene, held=True)), None, "spectral radius 0.877"),
        (lambda scene: margin(scene).words, 0, "not computed"),
        (lambda scene: check_change(scene, [*INERTIA], [], report=GOOD, anyway=False)[1], 0, "not computed"),
        (lambda scene: marks([scene]), 0, "not computed"),
    ],
    ids=["run", "warning", "wall", "viewer", "flight", "cell"],
)
def test_a_slow_law_is_called_a_stored_number_of_times(
    asked: Any, besides: int | None, says: str, limit: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Slow, "calls", 0)
    monkeypatch.setattr("maglev_mj.theory.linearise._MOST_CALLS", limit)
    answer = str(asked(Slow(duration=0.02)))
    assert Slow.calls == (AT_THE_WALL if besides is None else CALLS[limit] + besides)
    assert says in answer if limit == 2000 else "not computed" not in answer


@pytest.mark.parametrize("name", BUILT_IN)
def test_no_scene_warns_as_it_is(name: str) -> None:
    scene = find_scene(name)()
    for variant in (scene, *scene.variants().values()):
        assert stability_warning(variant) is None


def test_a_scene_that_may_be_unstable_warns_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("maglev_mj.theory.linearise._MOST_SAMPLES", 80)
    monkeypatch.setattr("tests.theory.test_linearise.WEIGHTS", WEIGHTS[:100])
    wrong = Detents(stiffness=9870.0)
    warned = str(stability_warning(wrong))
    assert warned == f"detents is unstable: {judge(wrong).details}"
    assert "spectral radius 1.0308 (must be below 1)" in warned
    unknown = stability_warning(Echoing(stiffness=1000.0))
    assert unknown is not None and "\n" not in unknown
    begin = "echoing may be unstable: stability not computed on x; 135 poses skipped: "
    assert unknown.startswith(begin)
    with pytest.raises(
        ParameterError, match="law Detent must have six wrench"
    ):  # a slip in a law is no question of gains
        started(Slipped())


class Slipped(Detents):
    """Scene with a law that answers wrongly."""

    def laws(self) -> list[Any]:
        class Detent(Law):
            def __call__(self, position: Any, velocity: Any, state: Any, wrench: Any) -> Any:
                wrench.pop()
                return None, None

        return [Detent()]


@pytest.mark.parametrize(
    ("options", "inertia"),
    [
        ({"mass": None, "inertia": None, "model": None}, INERTIA),
        ({"model": "HEAVY", "inertia": [1e-3, 2e-3, 3e-3]}, (0.75, 0.75, 0.75, 1e-3, 2e-3, 3e-3)),
        ({"model": "HEAVY", "mass": 2.0}, (2.0, 2.0, 2.0, *INERTIA[3:])),
    ],
)
def test_a_scene_is_judged_with_its_own_flotor(options: dict[str, Any], inertia: Any) -> None:
    """By the mass on which the plants agree."""
    if options.get("model") == "HEAVY":
        heavy = mujoco.MjSpec.from_file(str(model_path("drop")))
        heavy.body("flotor").mass += 0.05
        options = options | {"model": heavy}
    scene = type("Own", (Drop,), {"plant_options": lambda self: options})(stiffness=15_000.0)
    body = scene.body.inertia
    np.testing.assert_allclose(body, inertia, rtol=2e-3)
    np.testing.assert_array_equal(scene.plant("exact").inertia, body)
    assert stability(scene).spectral_radius == stability(scene, inertia=body).spectral_radius
    assert judge(scene, inertia=[10.0] * 3 + [1.0] * 3).stable
    assert (stability_warning(scene) is None) == (body[0] > 1.0) == (not unstable([scene])[0])
