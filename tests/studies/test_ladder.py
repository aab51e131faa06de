"""Model levels, and recommended models in unseen cases."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import partial
from typing import Any

import mujoco
import numpy as np
import pytest

from maglev_mj import Controller, ExactPlant, MuJoCoPlant, Scene, Start, Timing, drive
from maglev_mj.cli import main
from maglev_mj.control import Bias, Hold, Law, Wall
from maglev_mj.device import Device
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array, Command
from maglev_mj.parameters import param
from maglev_mj.plants.hand import get_hand
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.free import SixAxes, Twist
from maglev_mj.scenes.interactive import InteractiveScene
from maglev_mj.scenes.wall_scene import wall_controller
from maglev_mj.spec import Spec
from maglev_mj.studies import levels
from maglev_mj.studies.fidelity import (
    COMPARED,
    DEAR,
    MARGIN,
    FidelityResult,
    LevelResult,
    Preset,
    Range,
    StepResult,
    _choose,
    largest_jump,
    level_results,
    measure_fidelity,
    measure_levels,
    measure_steps,
    preset_of,
    run_levels,
    worst_of,
)
from maglev_mj.studies.levels import (
    LEVELS,
    LevelMotion,
    _SteppedLoop,
    apart,
    boundary_shift,
    choice_cases,
    distance,
    has_gains,
    itself,
    level_index,
    level_parts,
    loop_of,
    measure_costs,
    motion_of,
    run_case,
    run_together,
    scattered_cases,
    scene_at,
    screen_levels,
)
from maglev_mj.theory.loop_array import LoopArray
from tests.published import WEIGHT
from tests.sweeps import sweep

LAG = 1.0 / (2.0 * math.pi * Spec.driver_bandwidth.value)


WALLS = [(6000.0, 80.0), (6000.0, 40.0), (3000.0, 60.0), (2000.0, 40.0), (8000.0, 80.0)]


INTERACTIVE = ("joystick", "table", "box", "corner")


class Pocket(Scene):
    """Let the flotor swing into a pocket of two walls."""

    tolerance = 2e-4
    tolerance_reason = "a fifth of its way"
    duration: float = param("simulated time", "s", default=0.12, above=0.0)
    stiffness: float = param("stiffness", "N/m", default=2000.0)
    damping: float = param("damping", "N s/m", default=40.0)

    def start(self) -> Start:
        """See `Scene`."""
        return Start(pose=(1e-3, 0.0, 5e-4, 0.0, 0.0, 0.0), twist=(-0.05, 0.0, -0.02, 0.0, 0.0, 0.0), wrench=WEIGHT)

    def laws(self) -> list[Law]:
        """See `Scene`."""
        walls = Wall(axes=("x", "z"), lower=(0.0, 0.0), stiffness=self.stiffness, damping=self.damping)
        return [Bias(WEIGHT), walls, Hold.critically_damped(("y", "rx", "ry", "rz"), period=0.005, delay=0.0015)]


@pytest.fixture(autouse=True)
def briefly(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Take costs from the runs; screen few cases.

    No test of the gate is about the costs themselves. Studies time each loop and screen all cases.
    """
    monkeypatch.setattr("maglev_mj.studies.levels._SHORT", 1e-9)
    if request.node.get_closest_marker("study") is None:
        monkeypatch.setattr("maglev_mj.studies.levels._LONG", 0.0)
        monkeypatch.setattr(levels, "_POINTS", 16)
        monkeypatch.setattr(levels, "_SEEDS", 2)


def unseen_distances(result: FidelityResult, count: int) -> Array:
    """Return the chosen model's distances from the whole device in unseen cases [m]."""
    assert result.level is not None and result.cheapest is not None
    scene, best, level = result.preset.scene, result.cheapest, result.level.level
    options = {"integrator": best.integrator, "longest_step": best.step} if level_index(level) else {}
    cases = scattered_cases(scene, count, result.over.around, seed=10_000)
    pairs = [(run_case(scene, level, case, **options), run_case(scene, LEVELS[-1].name, case)) for case in cases]
    return np.array([distance(*pair, scene.hardware) for pair in pairs])


@pytest.mark.study
@pytest.mark.parametrize(
    ("name", "wall"),
    [
        *((name, wall) for name in COMPARED for wall in (WALLS if has_gains(preset_of(name).scene) else [None])),
        *((name, WALLS[place]) for name in (*INTERACTIVE, "pocket") for place in (0, 2, 3)),
    ],
)
def test_the_model_recommended_holds_in_cases_never_looked_at(
    name: str, wall: tuple[float, float] | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(InteractiveScene, "end", 1.7)  # into contact: a whole script takes three times as long
    preset = preset_of(Pocket() if name == "pocket" else name)
    if wall is not None:
        preset = preset._replace(scene=preset.scene.replace(stiffness=wall[0], damping=wall[1]))
    result = measure_fidelity(preset)
    assert result.screened in (levels._SEEDS, levels._POINTS * levels._SEEDS)
    furthest = math.inf if result.furthest is None else result.furthest
    found = unseen_distances(result, 24)
    # what is expected is no bound: with the present jitter one press of the 648 cases of all scenes is beyond it
    assert (found > furthest).sum() <= (name == "press")
    assert (found > preset.tolerance).sum() <= 2 or result.unscreened


def small(name: str, **values: float) -> Preset:
    """Return a short version of a scene."""
    preset = preset_of(name)
    return preset._replace(scene=preset.scene.replace(duration=0.1, **values))


@pytest.mark.study
@pytest.mark.parametrize(
    ("name", "level"),
    [("drop", "steps"), ("twist", "body"), ("let-go", "stops")]
    + [(name, "jitter") for name in ("drop-no-pulse", "press", "stick-slip", "six-axes")],
)
def test_each_scene_needs_its_level(name: str, level: str) -> None:
    result = measure_fidelity(name)
    assert result.level is not None and result.level.level == level
    # necessary: the level below is off by more than the tolerance with its margin
    assert MARGIN * result.levels[level_index(level) - 1].missing > result.tolerance
    assert result.cheapest is not None and abs(result.cheapest.shift or 0.0) <= result.over.boundary


def test_cases_run_together_as_they_do_alone() -> None:
    scene = Drop(duration=0.1)
    points: list[tuple[Any, float]] = [scene_at(scene, case) for case in scattered_cases(scene, 3, 0.1, seed=1)]
    assert len({(each.stiffness, each.damping) for each, _ in points}) == len({phase for _, phase in points}) == 3
    together = run_together(points, "axes", 0)
    for place, (each, phase) in enumerate(points):
        alone = motion_of(*level_parts(each, "axes", phase=phase)).pose
        np.testing.assert_allclose(together[:, place], alone[: len(together)], atol=1e-12)
    makers = [partial(level_parts, scene.replace(period=period), "axes") for period in (0.005, 0.002)]
    assert measure_costs(makers, [2.0, 3.0], 1) == pytest.approx((2.0 / 0.105, 3.0 / 0.102))  # of a simulated second


def test_a_jump_is_what_goes_far_beyond_the_median() -> None:
    screen = np.ones((len(LEVELS), 1000))
    screen[level_index("axes"), 0] = 900.0  # below the lag much else differs
    screen[level_index("filter"), 0] = 50.0
    assert largest_jump(screen) == 0.0
    screen[level_index("spots"), 0], screen[level_index("jitter"), 0] = 300.0, 200.0
    assert largest_jump(screen) == 300.0


def test_cases_cover_phases_and_gains() -> None:
    scene = Drop()
    cases = choice_cases(scene, 4, 0.1, phase=0.1)
    assert cases[0] == itself(0.1) == (0.1, 0, 1.0, 1.0)
    assert {case.phase for case in cases} == {0.1, 0.35, 0.6, 0.85} and len({case.seed for case in cases}) == 20
    assert {(round(case.stiffness, 9), round(case.damping, 9)) for case in cases} == {
        (1.0, 1.0),
        *((k, b) for k in (0.9, 1.1) for b in (0.9, 1.1)),
    }
    assert len(choice_cases(Twist(), 4, 0.1)) == 4
    many = np.array([case[:1] + case[2:] for case in scattered_cases(scene, 256, 0.1, seed=3)])
    counts, _ = np.histogramdd(many, bins=4, range=[(0, 1), (0.9, 1.1), (0.9, 1.1)])
    assert counts.min() >= 1 and counts.max() <= 9  # 4 in each of 64 boxes


@pytest.mark.parametrize(
    ("delay", "hand", "driver_lag"),
    sweep([0.0, 0.0015, 0.005, 0.0073], [None, "arm", "stylus", "fingertip"], [0.0, LAG], every=4),
)
def test_a_fine_rk4_has_the_loop_of_theory(delay: float, hand: str | None, driver_lag: float) -> None:
    loop = LoopArray(delay=delay, hand=get_hand(hand or "none"), driver_lag=driver_lag)
    stepped = _SteppedLoop(delay=delay, hand=loop.hand, driver_lag=driver_lag, integrator="rk4", step=2e-5)
    *maps, waiting = loop.flotor
    *measured, waited = stepped.flotor
    assert waited == waiting
    for exact, found in zip(maps, measured, strict=True):
        np.testing.assert_allclose(np.asarray(found), np.asarray(exact), atol=1e-11)


@pytest.mark.parametrize("hand", ["arm", "stylus"])
@pytest.mark.parametrize("integrator", ["euler", "corrected", "rk4"])
def test_the_stepped_loop_is_the_plant(integrator: str, hand: str) -> None:
    delay, step, k, b = 0.0015, 1e-3, 2000.0, 20.0
    loop = _SteppedLoop(delay=delay, hand=get_hand(hand), integrator=integrator, step=step)
    plant = MuJoCoPlant(
        Timing(delay=delay),
        hand=get_hand(hand),
        gravity=0.0,
        coils=False,
        integrator=integrator,
        longest_step=step,
        pose=[0.0, 0.0, 1e-3, 0.0, 0.0, 0.0],
    )
    matrix = loop.matrix(k, b)
    state = np.zeros(len(matrix))
    state[0] = state[-1] = 1e-3  # the last is the position seen before
    assert loop.hand is not None
    if loop.hand.soft:
        state[2] = float(np.asarray(loop.hand.position_at_rest(1e-3)))
    controller = Controller([Hold(axes="z", stiffness=k, damping=b)], period=0.005)
    heights: list[float] = []
    drive(plant, controller, 20, observe=lambda sample, _: heights.append(float(sample.position[2])))
    expected: list[float] = []
    for _ in heights:
        expected.append(float(state[0]))
        state = matrix @ state
    np.testing.assert_allclose(heights, expected, atol=1e-12)


def test_the_shift_of_the_boundary_is_that_of_the_levels_drivers() -> None:
    scene = SixAxes()
    body, delayed, drivers = (loop_of(scene, level) for level in ("body", "lag", "filter"))
    assert boundary_shift("euler", 5e-5, body) == pytest.approx(0.0085, abs=2e-4)
    assert boundary_shift("rk4", 2e-5, drivers) == pytest.approx(0.0, abs=1e-6)
    # a lag of 80 µs is that much delay, here too; a step of Euler's gives the velocity of a lagging force alone
    shifts = [boundary_shift("euler", 5e-5, loop) for loop in (delayed, drivers)]
    assert shifts == pytest.approx([0.00827, 0.00836], abs=1e-5)
    assert boundary_shift("corrected", 1e-3, drivers) == pytest.approx(0.0, abs=1e-12)
    assert boundary_shift("closed form", 1e-3, body) == 0.0


@pytest.mark.parametrize(("name", "radius"), [("ubc", 0.046), ("stage", 0.03), ("arm", 0.0)])
def test_a_distance_counts_rotations_by_the_radius_of_the_device_s_coils(name: str, radius: float) -> None:
    device, poses = Device.load(name), np.zeros((2, 6))
    poses[1] = [3e-4, 0.0, 4e-4, 0.0, 0.0, 2e-3]
    turned = LevelMotion(poses, poses, 0.0, False, 0.0)
    rest = turned._replace(pose=np.zeros((2, 6)))
    assert distance(turned, rest, device) == pytest.approx(5e-4 + radius * 2e-3, rel=1e-12)
    assert distance(None, rest, device) == math.inf


@pytest.mark.parametrize("wall", [(6000.0, 40.0), (6000.0, 80.0)])
def test_stops_that_the_motion_meets_are_told(wall: tuple[float, float]) -> None:
    scene = Drop(stiffness=wall[0], damping=wall[1], pulse=0.0)
    motions = [run_case(scene, level, itself()) for level in ("jitter", "stops")]
    met = [motion is not None and motion.met_stops for motion in motions]
    assert met == [False, wall != (6000.0, 80.0)]
    (below, above), device = motions, scene.hardware
    assert (distance(below, above, device) > 1e-4) == met[1]


@pytest.mark.parametrize("pulse", [0.0, 220.0])
def test_the_drivers_lag_is_so_much_delay_to_two_micrometres(pulse: float) -> None:
    phases = np.arange(50) / 50.0

    def heights(delay: float, driver_lag: bool) -> Array:
        start = np.tile([0.0, 0.0, 4.5e-3, 0.0, 0.0, 0.0], (50, 1))
        plant = ExactPlant(Timing(delay=delay, phase=phases), pose=start, driver_lag=driver_lag)
        controller = wall_controller(
            stiffness=6000.0, damping=80.0, pulse=pulse, pulse_width=0.003, period=0.005, delay=0.0015, mass=0.7
        )
        seen: list[Array] = []
        drive(plant, controller, 80, observe=lambda sample, _: seen.append(sample.position[2]))
        return np.array(seen)

    truth = heights(0.0015, True)
    assert np.abs(heights(0.0015 + LAG, False) - truth).max() < 2e-6
    assert np.abs(heights(0.0015, False) - truth).max() > 1e-4  # where it is left out altogether


@pytest.mark.parametrize(("height", "left"), [(0.0, 1.0), (2.25e-3, 0.975), (-4.5e-3, 0.9)])
def test_a_coil_loses_force_with_the_square_of_its_stroke(height: float, left: float) -> None:
    plant = MuJoCoPlant(Timing(period=1e-4, delay=0.0), pose=[0, 0, height, 0, 0, 0], gravity=0.0, force_falloff=0.1)
    speeds: list[float] = []
    for _ in range(3):
        plant.read()
        plant.write(Command([0.0, 0.0, 7.0, 0.0, 0.0, 0.0]))
        speeds.append(float(plant.state()[1][2]))
    assert (speeds[-1] - speeds[-2]) / plant.period == pytest.approx(10.0 * left, rel=1e-5)
    stopped = drive(MuJoCoPlant(Timing(), stops=True), Controller([], period=0.005), 60).pose
    assert stopped[2] == pytest.approx(-4.5e-3, abs=5e-6)  # without currents


def test_the_handle_swings_at_a_kilohertz() -> None:
    mass = 1.4
    plant = MuJoCoPlant(Timing(), mass=mass, gravity=0.0, flexible=True)
    model = plant.device.model
    model.dof_damping[:] = 0.0
    # mass matrix and stiffness of z and the bend: the one mode that is not a motion of the whole
    data, full = mujoco.MjData(model), np.zeros((model.nv, model.nv))
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, full)
    pair = [model.joint("z").dofadr[0], model.joint("bend").dofadr[0]]
    stiffness = np.diag([0.0, float(model.joint("bend").stiffness[0])])
    squared = np.linalg.eigvals(np.linalg.solve(full[np.ix_(pair, pair)], stiffness))
    assert math.sqrt(squared.max()) / (2.0 * math.pi) == pytest.approx(1000.0, rel=1e-9)
    assert plant.device.mass == pytest.approx(mass)


def test_currents_are_limited_without_coils_as_with_upright_ones() -> None:
    wrench = Command([30.0, -20.0, 70.0, 0.5, -0.4, 0.3])
    applied = []
    for coils in (True, False):
        plant = MuJoCoPlant(coils=coils, current_limit=10.0)
        plant.read()
        applied.append(plant.write(wrench).wrench)
    np.testing.assert_allclose(applied[0], applied[1], atol=1e-12)
    assert not np.allclose(applied[0], wrench.wrench)
    small = Command([1.0, 0.0, 6.87, 0.0, 0.0, 0.0])
    assert plant.write(small).force is small.force


def test_a_tight_tolerance_takes_the_cheapest_step_within_it() -> None:
    tight = measure_fidelity("twist", 1e-5, Range(phases=1, boundary=0.01))
    assert tight.level is not None and tight.level.level == "body"
    best = tight.cheapest
    assert best is not None and best.error < 1e-5
    # slow turning asks little of the position, where a raw step of Euler's moves the boundary by 84 %
    assert best.shift is not None and abs(best.shift) <= 0.01
    cheaper = tight.steps[: tight.steps.index(best)]
    assert all(step.shift is None or abs(step.shift) > 0.01 for step in cheaper)
    # the exact plant turns about each axis alone
    assert tight.screened and tight.unscreened == "the exact plant cannot assess level body"
    said = " ".join(str(tight.table()).split())
    assert "in 99 % of 1 cases of the whole device only" in said and "largest expected" in said


def test_a_looser_tolerance_takes_a_lower_level_unless_it_diverges(monkeypatch: pytest.MonkeyPatch) -> None:
    loose = measure_fidelity("twist", 2e-4, Range(phases=1))
    assert loose.level is not None and loose.level.level == "axes"
    assert loose.cheapest is not None and loose.cheapest.integrator == "closed form"

    def diverged(*given: Any) -> tuple[LevelResult, ...]:
        axes, *others = level_results(*given)
        return (axes._replace(diverged=1), *others)

    monkeypatch.setattr("maglev_mj.studies.fidelity.level_results", diverged)
    other = measure_fidelity("twist", 2e-4, Range(phases=1))
    assert MARGIN * other.levels[0].missing <= 2e-4  # so that only its divergence forbids it
    assert other.level is not None and other.level.level == "body"


def moved(place: float, force: float = 0.0) -> LevelMotion:
    """Return a motion that is nothing but a displacement [m]."""
    return LevelMotion(np.array([[place, 0.0, 0.0, 0.0, 0.0, 0.0]]), np.zeros((1, 6)), force, False, 1.0)


def test_the_dear_levels_run_in_the_cases_that_are_worst_without_them(monkeypatch: pytest.MonkeyPatch) -> None:
    lacking = [5e-6, 1e-6, 9e-6, 3e-6, 7e-6, 2e-6, 8e-6]

    def run_alone(scene: Any, level: str, case: Any, **_: Any) -> LevelMotion:
        return moved(lacking[case.seed] if level_index(level) > level_index("falloff") else 0.0)

    monkeypatch.setattr("maglev_mj.studies.fidelity.run_case", run_alone)
    cases = [itself()._replace(seed=seed) for seed in range(len(lacking))]
    motions = run_levels(Drop(), cases)
    assert all(set(motions[index]) == {*range(len(cases))} for index in range(DEAR))
    assert all(set(motions[index]) == {0, 2, 6, 4} for index in range(DEAR, len(LEVELS)))


def test_a_level_changes_what_the_level_below_it_did() -> None:
    places = np.cumsum([1e-6 * (place + 1) for place in range(len(LEVELS))])
    motions: list[dict[int, LevelMotion | None]] = [{0: moved(place, 1e6 * place)} for place in places.tolist()]
    rows = level_results(Drop(duration=0.01), motions, np.zeros((len(LEVELS), 1)), 1e-3, repeats=1)
    changes = np.diff(places, prepend=places[0])
    assert [row.changes for row in rows] == pytest.approx(changes.tolist(), abs=1e-15)
    assert [row.force for row in rows] == pytest.approx((1e6 * changes).tolist(), abs=1e-9)
    assert [row.worst for row in rows] == pytest.approx((places[-1] - places).tolist(), abs=1e-15)


def test_what_is_promised_is_rounded_down_and_never_beyond_the_range() -> None:
    row = LevelResult("body", "", 0.0, 2e-3, 0.0, 1.0, 0, 0.0, 1.0)
    step = StepResult("rk4", None, 0.0, 1.0, 0.0, 1e-6)
    result = FidelityResult(preset_of("drop"), 1e-3, Range(), (itself(),), 4096, 3e-3, 0, (row,), row, (step,), step)
    assert result.furthest == pytest.approx(MARGIN * 3e-3)  # of the jump
    assert "largest expected 3750 µm, where a sample" in " ".join(str(result.table()).split())
    for far in (4e-3, math.inf):  # the flotor has 4.5 mm
        lost = replace(result, jump=far)
        assert lost.furthest is None and lost.as_json()["furthest"] is None
        assert "no bound for the others" in " ".join(str(lost.table()).split())
    for share, text in {1.0: "100", 4095 / 4096: "99.98", 1.0 - 1e-9: "99.99", 0.0: "0"}.items():
        table = replace(result, levels=(row._replace(keeps=share),), level=None, steps=(), cheapest=None).table()
        assert next(line for line in str(table).splitlines() if line.startswith("  body")).split()[-3] == text


@pytest.mark.parametrize(("share", "worst"), [(1.0, 4.0), (0.99, 4.0), (0.7, 4.0), (0.5, 3.0), (0.01, 2.0)])
def test_a_share_of_cases_is_rounded_up_to_a_whole_case(share: float, worst: float) -> None:
    assert worst_of([2.0, 4.0, 1.0, 3.0], share) == worst


@pytest.mark.parametrize("shift", [-0.3, 0.3])
def test_a_boundary_that_moves_either_way_forbids_a_step(shift: float, monkeypatch: pytest.MonkeyPatch) -> None:
    shifts = {"euler": shift, "rk4": 0.5 * shift}
    monkeypatch.setattr("maglev_mj.studies.fidelity.boundary_shift", lambda kind, *_: shifts[kind])
    rows = [StepResult("rk4", 1e-3, 0.0, cost=2.0), StepResult("euler", 1e-3, 0.0, cost=1.0)]
    ordered, best = _choose(rows, loop_of(Drop(), "body"), 1e-3, lambda _: True, 0.2, lambda _: 0.0)
    assert [row.shift for row in ordered] == [shift, 0.5 * shift]
    assert best is not None and best.integrator == "rk4"


def test_a_step_that_diverges_is_no_choice(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("maglev_mj.studies.levels._LONG", 1.0)  # and each step is timed
    scene = SixAxes(duration=0.02)
    rows = measure_steps(scene, "flexible", repeats=1)
    diverged = [row for row in rows if not math.isfinite(row.error)]
    # beyond 1 / (pi f) Euler's handle, which swings at f = 1 kHz, grows
    assert diverged and all(row.step is not None and row.step > 1.0 / (1000.0 * math.pi) for row in diverged)
    assert {row.step for row in rows if math.isfinite(row.error)} >= {None, 1e-4, 5e-5}
    result = FidelityResult(preset_of(scene), 1e-5, Range(), (itself(),), 1, 0.0, 0, (), None, rows, None)
    assert json.loads(json.dumps(result.as_json(), allow_nan=False))["steps"][rows.index(diverged[0])]["cost"] is None


def test_an_unstable_wall_has_no_model() -> None:
    wall = SixAxes(stiffness=400000.0, damping=80.0, duration=0.15)
    result = measure_fidelity(wall, over=Range(phases=1, around=0.0))
    assert result.level is None and result.levels[0].diverged and "1 diverged" in str(result.table())
    assert "the loop diverges on the exact plant" in str(result.table())
    json.dumps(result.as_json(), allow_nan=False)


def test_every_level_can_be_built_for_every_scene() -> None:
    with pytest.raises(ParameterError, match="level must be one of axes, body"):
        level_parts(Drop(), "attic")
    scene = SixAxes()
    for level in ("body", "turning"):
        corrected, exact = (motion_of(*level_parts(scene, level, integrator=kind)) for kind in ("corrected", "rk4"))
        assert 0.0 < apart(corrected.pose, exact.pose, scene.hardware) < 2e-6
    # a delay that leaves no room for jitter has less of it
    for delay in (0.0, 0.005):
        assert math.isfinite(measure_levels(Drop(delay=delay, duration=0.02), repeats=1)[-1].changes)


def test_the_command_answers_for_a_wall_of_ones_own(capsys: pytest.CaptureFixture[str]) -> None:
    wall = ["--stiffness", "2000", "--damping", "20", "--period", "0.004", "--delay", "0.001", "--height", "0.004"]
    small = ["--duration", "0.04", "--phases", "1", "--around", "0", "--tolerance", "1e-3"]
    assert main(["fidelity", "drop-no-pulse", *wall, *small]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "a drop of 4 mm on a wall of 2000 N/m and 20 N s/m, no pulse" in said
    assert "metal stops reached in 1 of 1 cases" in said and "32 cases on the exact plant" in said
    assert main(["fidelity", "press", "--hand", "none"]) == 2
    assert "hand must have a stiffness above 0" in capsys.readouterr().err


class OneAlone(SixAxes):
    """Hold the flotor with a function, which takes one device."""

    def laws(self) -> list[Any]:
        """See `Scene`."""
        return [lambda position, velocity: [-self.stiffness * position[0], 0.0, 0.0, 0.0, 0.0, 0.0]]


def test_laws_that_take_one_device_alone_are_not_screened_and_promise_less() -> None:
    reason = "law <lambda> must be an AxisLaw or list its gains in per_device"
    result = measure_fidelity(OneAlone(duration=0.02), 1e-3, Range(phases=1))
    assert result.unscreened.startswith(reason) and result.screened == 0 and result.furthest is None
    said = " ".join(str(result.table()).split())
    assert f"no cases on the exact plant, whose batches the laws must support: {reason}" in said
    assert "in 99 % of 5 cases of the whole device" in said and "no bound for the others" in said
    data = result.as_json()
    assert (data["screened"], data["furthest"], data["unscreened"]) == (0, None, result.unscreened)


def test_where_the_level_below_jumps_its_share_of_the_screen_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = np.zeros((len(LEVELS), 40))
    screen[: level_index("filter"), :7] = 1e-3  # so that the filter is needed, of which the exact plant knows nothing
    monkeypatch.setattr("maglev_mj.studies.fidelity.screen_levels", lambda *_: screen)
    result = measure_fidelity(SixAxes(duration=0.02), over=Range(phases=1, around=0.0))
    assert result.level is not None and result.level.level == "filter"
    assert "(level jitter, which it includes, fails in 0.17 of its cases" in result.unscreened


class Release(Scene):
    """Let the flotor go beside the centre, held by a function without gains to vary."""

    duration: float = param("simulated time", "s", default=0.05, above=0.0)

    def start(self) -> Start:
        """See `Scene`."""
        return Start(pose=(1e-3, 0.0, 0.0, 0.0, 0.0, 0.0), twist=(0.02, 0.0, 0.0, 0.0, 0.0, 0.0), gravity=0.0)

    def laws(self) -> list[Any]:
        """See `Scene`."""
        return [lambda position, velocity: [-2000.0 * position[0] - 40.0 * velocity[0], 0.0, 0.0, 0.0, 0.0, 0.0]]


def test_a_scene_without_gains_is_screened_over_its_phases_and_seeds() -> None:
    assert screen_levels(Twist(), 0.1).shape == (len(LEVELS), 2)
    seen = screen_levels(Release(), 0.1)
    assert seen.shape == (len(LEVELS), 32) and len(np.unique(seen[level_index("axes")])) >= 16
