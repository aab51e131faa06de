"""Runs of scenes: devices, phases, batches, figures, refusals."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
import pytest

from maglev_mj.control import Law
from maglev_mj.errors import DivergenceError, ParameterError
from maglev_mj.frames import AXES, Command, Sample
from maglev_mj.parameters import param
from maglev_mj.plants import ExactPlant, MuJoCoPlant, Timing
from maglev_mj.plants.hand import HandForce
from maglev_mj.result import plain
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.figures import STOCK, figures_named
from maglev_mj.scenes.find import find_scene
from maglev_mj.scenes.free import LetGo, SixAxes, Twist
from maglev_mj.scenes.press import Press
from maglev_mj.scenes.results import Figure, RunResult, figure
from maglev_mj.scenes.run import figures_of, run, run_phases, run_variants
from maglev_mj.scenes.scene import Scene, Start
from maglev_mj.scenes.stick_slip import Pull
from maglev_mj.spec import GRAVITY, Spec
from tests.all_of import SCENES
from tests.sweeps import sweep

MASS = Spec.moving_mass.value
WEIGHT = (0.0, 0.0, MASS * GRAVITY, 0.0, 0.0, 0.0)
PHASES = np.random.default_rng(16).uniform(0.0, 1.0, 3)
SHORT = Press(hits=1, interval=0.1, duration=0.4)


@figure("mm", "half the way fallen", scale=1e3, batched=True)
def half_fallen(result: RunResult) -> Any:
    return 0.5 * (result.line.pose[0, ..., 0] - result.line.pose[-1, ..., 0])


@figure("", "knots of one device alone")
def knots(result: RunResult) -> int:
    assert result.trace.time.ndim == 1
    return len(result.trace.time)


@figure("s", "when it is below 4 mm", nan_is_largest=True)
def low(result: RunResult) -> float:
    time = result.times(1e-3)
    below = np.flatnonzero(result.motion(time)[0] < 0.004)
    return float(time[below[0]]) if below.size else math.nan


class Fall(Scene):
    """Fall freely."""

    figures: ClassVar[Any] = (half_fallen, knots, low, "final_position")
    duration: float = param("simulated time", "s", default=0.02, above=0.0)

    def start(self) -> Start:
        return Start(pose=(0.0, 0.0, 0.0045, 0.0, 0.0, 0.0))

    def laws(self) -> list[Law]:
        return []


# -- what a scene says -----------------------------------------------------------------------------------


def test_a_scene_is_named_after_its_class_unless_it_names_itself() -> None:
    class TwoWords(Fall):
        """Two words of mine."""

    class Named(Fall):
        name: ClassVar[str] = "mine"

    class Heir(Named):
        pass

    assert [cls.name for cls in (Fall, TwoWords, Named, Heir)] == ["fall", "two-words", "mine", "heir"]
    assert TwoWords().describe() == "Two words of mine"
    assert dict(Named().variants()) == {"mine": Named()}


def test_only_laws_are_required() -> None:
    class Bare(Scene):
        pass

    class Empty(Scene):
        def laws(self) -> list[Law]:
            return []

    with pytest.raises(ParameterError, match=r"Bare of test_scenes\.py must define laws\(\)"):
        run(Bare(), plant="exact")
    assert Empty().end == 1.0 and not Empty.figures
    found = run_phases(Fall().replace(duration=0.01), 3, plant="exact")
    assert found.peaks.shape == (3, 7)
    assert Empty().start() == Start() and Start().gravity is None
    with pytest.raises(ParameterError, match=r"axis must be one of x, y, z, rx, ry, rz \(got 'w'\)"):
        type("Mine", (Scene,), {"shown_axis": "w"})
    with pytest.raises(
        TypeError, match=r"figure must be one of penetration, .*, or decorated with @figure .got 'depth'"
    ):
        type("Mine", (Scene,), {"figures": ("penetration", "depth")})


@pytest.mark.parametrize("plant", ["exact", "mujoco"])
def test_the_start_is_where_how_fast_and_under_what_it_is_let_go(plant: str) -> None:
    # Thrown up with its weight carried until the first command, which is none: uniform, then a fall.
    class Thrown(Scene):
        duration: float = param("simulated time", "s", default=0.02)

        def start(self) -> Start:
            return Start(pose=(0.0, 0.0, 1e-3, 0.0, 0.0, 0.0), twist=(0.0, 0.0, 0.1, 0.0, 0.0, 0.0), wrench=WEIGHT)

        def laws(self) -> list[Law]:
            return []

    delay = Spec.transport_delay.value
    place, speed, force = run(Thrown(), plant=plant).motion(np.array([0.0, 0.001, 0.01]))
    falls = 0.01 - delay
    np.testing.assert_allclose(place, [1e-3, 1.1e-3, 2e-3 - 0.5 * GRAVITY * falls**2], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(speed, [0.1, 0.1, 0.1 - GRAVITY * falls], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(force, [WEIGHT[2], WEIGHT[2], 0.0], rtol=0.0, atol=1e-9)


def test_keywords_hands_and_timings_go_before_the_scene_s() -> None:
    asked: list[str] = []

    class Heavy(Fall):
        def plant_options(self) -> dict[str, Any]:
            return {"mass": 2.0, "longest_step": self.longest}

        def longest(self, plant: str) -> float:
            asked.append(plant)
            return 1e-3

    lift: HandForce = lambda tick, time, state: [0.0, 0.0, 2.0, 0.0, 0.0, 0.0]  # noqa: E731
    seen = []
    for plant, keywords in (("exact", {}), ("mujoco", {"mass": 1.0}), ("exact", {"timing": Timing(period=0.01)})):
        device = Heavy().plant(plant, hand_force=lift, record=True, **keywords)
        with device:
            drive(device, 2)
            trace = device.trace()
        seen.append((device.period, float(trace.twist[-1, 2])))
    # it is pulled from the first sample on, held from sample to sample
    for (period, speed), mass in zip(seen, (2.0, 1.0, 2.0), strict=True):
        assert speed == pytest.approx(2.0 * period * (2.0 / mass - GRAVITY), rel=1e-9)
    assert [period for period, _ in seen] == [0.005, 0.005, 0.01]
    assert asked == ["exact", "mujoco", "exact"]
    assert isinstance(Heavy().plant(MuJoCoPlant), MuJoCoPlant) and isinstance(Heavy().plant("exact"), ExactPlant)


def drive(device: Any, ticks: int) -> None:
    for _ in range(ticks):
        device.read()
        device.write(Command([0.0] * 6))
    device.read()


# -- one run ---------------------------------------------------------------------------------------------


def test_a_run_is_on_the_scene_s_usual_plant_unless_it_is_told() -> None:
    class Exact(Fall):
        plants: ClassVar[Sequence[str]] = ("exact",)

    assert (run(Fall()).plant, run(Exact()).plant, run_phases(Exact(), 2).plant) == ("mujoco", "exact", "exact")
    for refused in (lambda: run(Exact(), plant="mujoco"), lambda: run_phases(Exact(), 2, plant="mujoco")):
        with pytest.raises(ParameterError, match=r"plant must be one of exact \(got 'mujoco'\)"):
            refused()


def test_phases_outside_their_bounds_are_refused() -> None:
    for phases, words in (
        ([0.5, 1.0], "phases must all be below 1 .got 1"),
        ([-0.5, 0.0], r"phases must be at least 0 \(got -0.5"),
        ([], "phases must be an integer or a list of phases"),
        ([[0.5]], "phases must be an integer or a list of phases"),
    ):
        for call in (lambda given: run(Fall(), plant="exact", phase=given), lambda given: run_phases(Fall(), given)):
            with pytest.raises(ParameterError, match=words):
                call(phases)
    for phase in (-0.1, 1.0, math.nan, "x", None):
        with pytest.raises(ParameterError, match=r"phase must be .*at least 0 and below 1.* \(got "):
            run(Fall(), plant="exact", phase=phase)  # type: ignore[arg-type]
    with pytest.raises(ParameterError, match=r"phase must be a number on mujoco; use run_phases"):
        run(Fall(), plant="mujoco", phase=[0.0, 0.5])
    longest: dict[str, Any] = {"duration": 10.0, "period": 1e-5, "delay": 0.0}
    assert Drop(**longest).end == 10.0
    kinds: list[Any] = [Drop, Press, Pull, Twist, LetGo, SixAxes]
    for cls in kinds:
        with pytest.raises(ParameterError, match=r"duration must be at most 1000000 periods \(got 10\.1 s"):
            cls(**longest | {"duration": 10.1})


@pytest.mark.parametrize("plant", ["exact", "mujoco"])
def test_whoever_observes_sees_every_sample_and_the_command_as_applied(plant: str) -> None:
    seen: list[tuple[Sample, Command]] = []
    drop = Drop(force_limit=60.0)
    result = run(drop, plant=plant, phase=0.3, observe=lambda sample, applied: seen.append((sample, applied)))
    assert [sample.tick for sample, _ in seen] == list(range(drop.ticks(drop.timing(0.3)))) == list(range(80))
    times = np.array([float(sample.time) for sample, _ in seen])
    np.testing.assert_allclose(times, (np.arange(80) + 0.3) * drop.period, rtol=1e-12)
    np.testing.assert_allclose(
        [sample.position[2] for sample, _ in seen], result.motion(times)[0], rtol=0.0, atol=1e-12
    )
    pulses = [applied.force[2] + applied.extra[2] for _, applied in seen if applied.extra is not None]
    assert pulses[0] == pytest.approx(60.0) and max(applied.force[2] for _, applied in seen) <= 60.0


def test_what_laws_tell_is_kept_with_each_sample() -> None:
    # A batch tells it of every device, and a device of it what that device alone tells.
    single = run(Pull(), plant="exact")
    assert set(single.samples) == {"position", "stick_position", "stuck"}
    assert len(single.sample_time) == len(single.samples["stuck"]) == 61
    assert single.samples["position"].shape == (61, 6) and single.samples["stuck"].shape == (61, 1)
    assert single.samples["stuck"].dtype == bool
    batch = run(Pull(), plant="exact", phase=PHASES)
    assert batch.samples["stick_position"].shape == (60, 1, 3)
    for device, phase in enumerate(PHASES.tolist()):
        one, alone = batch[device], run(Pull(), plant="exact", phase=phase)
        count = len(alone.sample_time)
        np.testing.assert_allclose(one.sample_time[:count], alone.sample_time, rtol=1e-12)
        np.testing.assert_array_equal(one.samples["stuck"][:count], alone.samples["stuck"])
        for name in ("position", "stick_position"):
            np.testing.assert_allclose(one.samples[name][:count], alone.samples[name], rtol=0.0, atol=1e-14)
    assert not run(Drop(), plant="exact").samples and not run(Fall(), plant="exact", phase=PHASES).samples


def test_series_are_on_a_grid_up_to_the_end() -> None:
    result = run(Fall(duration=0.0105), plant="exact")
    assert result.times().tolist() == [k * 1e-3 for k in range(11)]
    series = result.series(5e-3)
    assert list(series) == ["time", "position", "velocity", "force"]
    assert series["time"].tolist() == [0.0, 0.005, 0.01]
    np.testing.assert_allclose(series["position"], 0.0045 - 0.5 * GRAVITY * series["time"] ** 2, rtol=1e-12)
    np.testing.assert_allclose(series["velocity"], -GRAVITY * series["time"], rtol=1e-12)
    for step in (0.0, -1e-3, math.nan):
        with pytest.raises(ParameterError, match=r"step must be (a finite number )?above 0"):
            result.series(step)


@pytest.mark.parametrize("plant", ["exact", "mujoco"])
def test_a_diverging_run_keeps_what_it_was_up_to_there(plant: str) -> None:
    drop = Drop(force_limit=0.0, delay=0.005, duration=3.0)
    with pytest.raises(DivergenceError, match="diverged") as caught:
        run(drop, plant=plant, phase=0.3)
    partial = caught.value.partial
    assert isinstance(partial, RunResult) and (partial.scene, partial.plant, partial.phase) == (drop, plant, 0.3)
    assert 0.3 < partial.trace.time[-1] < 3.0
    assert abs(partial.figures["final_z"]) > 0.02 and math.isnan(partial.figures["settling_time"])
    assert partial.as_json()["summary"]["settling_time"] is None


@pytest.mark.parametrize("runs", [{}, {"phases": [0.4]}, {"bands": [0.4]}])
def test_a_divergence_names_its_variant(runs: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    stable, other = Drop(duration=0.05), Drop(duration=0.04)

    def diverging(scene: Any, *, phase: Any = 0.0, **_: Any) -> RunResult:
        if scene is other and (not runs or np.max(phase) == 0.4):
            raise DivergenceError("diverged at 3 s")
        return run(scene, plant="exact", phase=phase)

    monkeypatch.setattr("maglev_mj.scenes.run.run", diverging)
    with pytest.raises(DivergenceError, match=r"^second: diverged at 3 s$"):
        run_variants({"first": stable, "second": other}, plant="exact", **runs)


def test_a_diverging_batch_keeps_nothing_and_its_samples_are_those_before() -> None:
    with pytest.raises(DivergenceError, match="device") as caught:
        run(Drop(force_limit=0.0, delay=0.005, duration=3.0), plant="exact", phase=PHASES)
    assert caught.value.partial is None
    with pytest.raises(DivergenceError) as caught:
        run(Pull(spring=30000.0, duration=2.0), plant="exact")
    partial = caught.value.partial
    assert partial.sample_time[-1] <= partial.trace.time[-1] < 2.0
    assert len(partial.sample_time) == len(partial.samples["stuck"])


# -- many phases -----------------------------------------------------------------------------------------

SWITCHED: Mapping[str, Any] = {
    "as it comes": {},
    "late": {"delay": 0.004, "stiffness": 3000.0, "damping": 55.0},
    "coarse": {"quantize": 5e-6},
    "limited": {"force_limit": 60.0},
    "fast": {"period": 0.001, "delay": 0.0005, "pulse_width": 0.0009},
}


@pytest.mark.parametrize(("gains", "scene"), sweep(SWITCHED.values(), [Drop(duration=0.2), SHORT], every=5))
def test_a_batch_is_its_runs_to_rounding(gains: Any, scene: Scene) -> None:
    # Where one device has a pulse all have a knot, and a way in two parts rounds differently.
    changed = scene.replace(**gains)
    batch = run(changed, plant="exact", phase=PHASES)
    swept = run_phases(changed, PHASES, plant="exact")
    times = np.linspace(0.0, changed.end, 500)
    for device, phase in enumerate(PHASES.tolist()):
        alone = run(changed, plant="exact", phase=phase)
        for ours, theirs in zip(batch[device].motion(times)[:2], alone.motion(times)[:2], strict=True):
            # a hand bends the curve between knots
            np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=1e-12 if isinstance(scene, Drop) else 1e-6)
        for name, value in alone.figures.items():
            one = swept.figures[name][device]
            np.testing.assert_allclose(one, value, rtol=1e-9 if isinstance(scene, Drop) else 1e-5, atol=1e-9)


def test_figures_of_ones_own_are_swept_whether_they_take_a_batch_or_not() -> None:
    swept = run_phases(Fall(duration=0.012), PHASES, plant="exact")
    assert list(swept.figures) == ["half_fallen", "knots", "low", "final_position"]
    assert all(values.shape == (3,) for values in swept.figures.values())
    np.testing.assert_allclose(swept.figures["half_fallen"], 0.25 * GRAVITY * 0.012**2, rtol=1e-12)
    assert np.isin(swept.figures["knots"], range(2, 9)).all()
    on_engine = run_phases(Fall(duration=0.012), PHASES, plant="mujoco")
    np.testing.assert_allclose(on_engine.figures["half_fallen"], swept.figures["half_fallen"], rtol=1e-9)
    data = swept.as_json()
    assert list(data["phases"][0]) == ["phase", *swept.figures]
    assert data["median"]["low"] == pytest.approx(math.sqrt(2.0 * 0.0005 / GRAVITY), abs=1e-3)
    early = run_phases(Fall(duration=0.005), 2, plant="exact").as_json()
    assert early["median"]["low"] is None and early["phases"][1]["low"] is None


def test_missing_values_count_as_late_or_not_at_all() -> None:
    values = np.array([3.0, math.nan, 1.0, 2.0])
    late, left = Figure("late", low.function, nan_is_largest=True), Figure("left", low.function)
    assert [float(late.percentile(values, share)) for share in (0.0, 100.0 / 3.0)] == pytest.approx([1.0, 2.0])
    assert math.isnan(late.percentile(values, 75.0)) and math.isnan(late.percentile(values, 100.0))
    assert [float(left.percentile(values, share)) for share in (0.0, 50.0, 100.0)] == [1.0, 2.0, 3.0]
    assert math.isnan(left.percentile(np.full(3, math.nan), 50.0))
    both = left.percentile(np.column_stack([values, np.full(4, math.nan)]), 50.0)
    assert both[0] == 2.0 and math.isnan(both[1])
    for name in ("batched", "nan_is_largest"):
        with pytest.raises(ParameterError, match=rf"{name} must be True or False \(got 1\)"):
            figure("", "", **{name: 1})(low.function)  # type: ignore[arg-type]


def test_what_several_figures_share_is_made_once() -> None:
    made: list[RunResult] = []

    def deep(result: RunResult) -> float:
        made.append(result)
        return 2.0

    class Shared(Fall):
        figures: ClassVar[Any] = {
            "one": Figure("one", lambda result: result.once("deep", deep)),
            "other": Figure("other", lambda result: 2.0 * result.once("deep", deep)),
            "end": "final_position",
        }

    result = run(Shared(), plant="exact")
    assert (result.figures["one"], result.figures["other"], len(made)) == (2.0, 4.0, 1)
    assert list(result.figures) == list(Shared.figures) == ["one", "other", "end"]
    assert figures_named({"end": "final_position"}) == {"end": STOCK["final_position"]}
    assert result.figures is result.figures


def test_phases_are_run_in_parts_and_told_of() -> None:
    done: list[tuple[int, int]] = []
    run_phases(Fall(duration=0.01), 130, plant="exact", progress=lambda some, every: done.append((some, every)))
    assert done == [(64, 130), (128, 130), (130, 130)]


@pytest.mark.parametrize(("name", "plant"), sweep(SCENES, ["exact", "mujoco"], every=4))
def test_every_scene_runs_on_both_plants(name: str, plant: str) -> None:
    scene = find_scene(name)()
    result = run(scene, plant=plant, phase=0.4)
    data, timed = result.as_json(), result.series()
    how = {"plant": plant, "phase": 0.4} if scene.takes_phase else {"plant": plant}
    assert list(data) == ["headline", "parameters", *timed, *list(data)[len(timed) + 2 : -1], "summary"]
    assert data["headline"] == result.headline
    assert list(data["parameters"])[: len(how)] == [*how] and data["parameters"] == plain({**how, **scene.as_json()})
    time = [round(one, 9) for one in timed.pop("time").tolist()]
    assert data["time"] == time and len(time) > 40
    assert all(data[name] == plain(values) for name, values in timed.items())
    assert list(data["summary"]) == list(scene.figures) and data["summary"] == plain(dict(result.figures))
    assert result.trace.time[-1] == pytest.approx(scene.end)
    assert AXES[AXES.index(scene.axis)] == scene.axis and scene.describe()
    assert next(iter(scene.variants().values())) == scene
    assert figures_of(scene, plant, 0.4).keys() >= result.figures.keys()


def test_an_option_that_a_plant_lacks_is_named() -> None:
    class Stopped(find_scene("twist")):  # type: ignore[misc]
        """A body that meets its stops."""

        def plant_options(self) -> dict[str, Any]:
            return {"stops": True}

    Stopped().plant("mujoco", model="maglev").close()
    with pytest.raises(ParameterError, match=r"argument of ExactPlant must be one of .*got 'stops'"):
        run(Stopped(), plant="exact")
