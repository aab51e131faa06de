"""Runs with different numbers as one batch give the results of the single runs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj import find_scene, stability
from maglev_mj.control import Bias, Hold, Law, StickSlip, Wall
from maglev_mj.control.stack import alike, computed_together, law_kind, stacked
from maglev_mj.errors import ParameterError
from maglev_mj.scenes import batch
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.stack import SceneStack
from maglev_mj.studies.sweep import Grid, run_scene_cells


@pytest.fixture
def batches(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return a list of the sizes of tried batches."""
    sizes: list[int] = []

    class Counted(SceneStack):
        def controller(self) -> Any:
            sizes.append(len(self.scenes))
            return super().controller()

    monkeypatch.setattr(batch, "SceneStack", Counted)
    return sizes


def both_ways(cells: Sequence[Any], text: str | None = None) -> tuple[list[Any], list[Any]]:
    """Return the results of cells together, and one by one."""
    return run_scene_cells(cells, text), [run_scene_cells([cell], text)[0] for cell in cells]


@pytest.fixture
def unjudged(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the verdict on each cell, which takes longer than its run and has tests of its own."""
    verdict = stability(Drop())
    monkeypatch.setattr("maglev_mj.scenes.stability_check.cell_verdicts", lambda scenes: [verdict] * len(scenes))


def same(one: Mapping[str, Any], other: Mapping[str, Any], tolerance: float) -> bool:
    if "error" in one or "error" in other:
        return one == other
    one, other = dict(one), dict(other)
    return (
        one.pop("warnings", "") == other.pop("warnings", "")
        and one.keys() == other.keys()
        and all(
            np.allclose(
                np.array(one[name], dtype=float), np.array(other[name], dtype=float), tolerance, 1e-12, equal_nan=True
            )
            for name in one
        )
    )


def spread(low: float, high: float, count: int) -> list[float]:
    return [float(value) for value in np.linspace(low, high, count)]


CASES: Mapping[str, tuple[str, dict[str, Any], dict[str, list[Any]]]] = {
    "starts and masses": ("drop", {"quantize": 5e-6}, {"height": spread(1e-3, 4e-3, 4), "mass": [0.5, 0.9]}),
    "phases and limits": (
        "drop",
        {"pulse": 153.0, "carry": True, "force_limit": 60.0},
        {"phase": spread(0.0, 0.9, 4), "force_limit": [30.0, 90.0]},
    ),
    "hands": ("press", {"hits": 1, "interval": 0.1}, {"stiffness": spread(2000.0, 8000.0, 4), "press": [3.0, 5.0]}),
    "friction": ("stick-slip", {}, {"breakaway": spread(0.5, 2.5, 4), "spring": [500.0, 1500.0]}),
    "resting": ("wall", {}, {"stiffness": [4000.0, 12000.0], "hand": ["none", "arm"]}),
}


@pytest.mark.parametrize("case", CASES)
def test_a_batch_says_what_its_runs_say_one_by_one(case: str, batches: list[int]) -> None:
    # But for rounding: in a batch a neighbour's pulse splits a period in two, and the sums of the motion round anew.
    #
    # In a hand the recorded curve is the true one within a nanometre only, between more knots a little nearer to it.
    tolerance = 1e-5 if case == "hands" else 1e-8
    name, fixed, vary = CASES[case]
    cells = Grid(find_scene(name)(**fixed), vary, plant="exact")
    at_once, alone = both_ways(cells)
    assert batches == ([] if name == "wall" else [len(cells)])  # which has a way of its own
    assert all(same(one, other, tolerance) for one, other in zip(at_once, alone, strict=True))
    assert len({str(one) for one in alone}) > len(alone) // 2  # the runs do differ


@pytest.mark.parametrize("case", sorted(CASES.keys() - {"resting"}))
def test_no_run_of_a_batch_is_repeated_alone(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("maglev_mj.studies.sweep._run_single", None)
    name, fixed, vary = CASES[case]
    cells = Grid(find_scene(name)(**fixed), vary, plant="exact")
    assert len(run_scene_cells(cells)) == len(cells)


def test_few_runs_other_plants_and_other_periods_are_made_alone(
    batches: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    run_scene_cells(Grid(Drop(), {"stiffness": spread(3000.0, 6000.0, 7)}, plant="exact"))
    run_scene_cells(Grid(Drop(duration=0.05), {"stiffness": spread(3000.0, 6000.0, 8)}, plant="mujoco"))
    run_scene_cells(Grid(Drop(duration=0.05), {"period": spread(0.004, 0.006, 8)}, plant="exact"))
    assert batches == []
    run_scene_cells(Grid(Drop(), {"pulse_width": [0.002, 0.003], "stiffness": spread(3e3, 6e3, 10)}, plant="exact"))
    assert batches == [10, 10]  # of two kinds
    monkeypatch.setattr(batch, "_MEMORY", 12 * 243 * 144.0)  # a run of 80 samples keeps about 240 knots of 144 bytes
    run_scene_cells(Grid(Drop(), {"stiffness": spread(3000.0, 6000.0, 24)}, plant="exact"))
    assert batches[2:] == [12, 12]


def test_runs_that_diverge_are_made_alone_and_say_so(batches: list[int]) -> None:
    vary = {"stiffness": [4000.0, 6000.0, 60000.0], "damping": [50.0, 60.0, 80.0]}
    at_once, alone = both_ways(Grid(Drop(duration=2.0), vary, plant="exact"))
    assert batches == [9]
    diverged = [index for index, one in enumerate(alone) if "error" in one]
    assert 0 < len(diverged) < 9 and all("diverged at" in alone[index]["error"] for index in diverged)
    assert all(same(one, other, 1e-8) for one, other in zip(at_once, alone, strict=True))


OWN = """
import numpy as np
from maglev_mj import AxisLaw, Scene, Start, figure, gain, param


class Pull(AxisLaw):
    stiffness: float = gain("stiffness", "N/m")

    def force(self, x, v, gains, state):
        %s
        return -gains.stiffness * x - 20.0 * v


@figure("mm", "position at the end")
def last(result):
    return result.line.pose[-1, 0]


class Spring(Scene):
    figures = (last, "peak_speed")
    stiffness: float = param("stiffness", "N/m", default=500.0, above=0.0)
    duration: float = param("simulated time", "s", default=0.1, above=0.0)

    def start(self):
        return Start(pose=(0.0, 0.0, 1e-3, 0.0, 0.0, 0.0), gravity=0.0)

    def laws(self):
        return [Pull(axes="z", stiffness=self.stiffness)]
"""


@pytest.mark.parametrize(
    ("line", "sizes"),
    [
        ("pass", [12]),
        # what does not take arrays fails, whatever is left of the batch; what mixes devices says something else alone
        ("x = x if x > 0.0 else 2.0 * x", [12]),
        # a thousandth too much in the last device alone
        ("x = x * (1.0 + 1e-3 * np.squeeze(np.arange(np.size(gains.stiffness)) == 11))", [12]),
    ],
)
def test_laws_of_ones_own_run_together_unless_they_are_not_elementwise(
    tmp_path: Path, batches: list[int], unjudged: None, line: str, sizes: list[int]
) -> None:
    file = tmp_path / "spring.py"
    file.write_text(OWN % line)
    cells = Grid(find_scene(str(file))(), {"stiffness": spread(200.0, 900.0, 12)}, plant="exact")
    at_once, alone = both_ways(cells, file.read_text())
    assert batches == sizes
    assert all(same(one, other, 1e-9) for one, other in zip(at_once, alone, strict=True))
    assert "error" not in alone[0]


# a local class has no content that can be compared
OWN_SENSOR = """
    offset: float = param("of the sensor", "m", default=0.0, at_least=0.0)

    def plant_options(self):
        class Shifted:
            def start(sensor):
                return lambda position: [part + self.offset for part in position]
        return {"sensor": Shifted()}
"""
# an array takes None for NaN
OWN_FIGURE = """
    offset: float | None = param("in a figure", "m", default=None, at_least=0.0, optional=True)
    figures = (figure(batched=True)(
        lambda result: result.phase + (9.0 if result.scene.offset is None else result.scene.offset)
    ),)
"""


@pytest.mark.parametrize(
    ("own", "offsets", "sizes"),
    [
        (OWN_SENSOR, [0.0, 1e-4, 2e-4, 0.0], []),
        (OWN_FIGURE, [0.5, None, 0.7, 0.5], [12]),
    ],
)
def test_what_a_scene_makes_itself_is_that_of_each_run(
    tmp_path: Path, batches: list[int], unjudged: None, own: str, offsets: list[float | None], sizes: list[int]
) -> None:
    # Though first and last cell, which are made alone too, agree in it.
    file = tmp_path / "spring.py"
    file.write_text(f"{OWN % 'pass'}{own}".replace("figure, gain", "figure, Timing, gain"))
    vary: dict[str, list[Any]] = {"stiffness": spread(200.0, 900.0, 3), "offset": [*offsets]}
    at_once, alone = both_ways(Grid(find_scene(str(file))(), vary, plant="exact"), file.read_text())
    assert batches == sizes
    assert "error" not in alone[0] and len({str(one) for one in alone[:4]}) == 3
    assert all(same(one, other, 1e-9) for one, other in zip(at_once, alone, strict=True))


OWN_RUN = """
    def run_figures(self, plant, phase=0.0):
        return {'own': self.stiffness}
"""


def test_a_scene_with_a_run_of_its_own_is_left_to_it(tmp_path: Path, batches: list[int]) -> None:
    file = tmp_path / "spring.py"
    file.write_text(OWN % "pass" + OWN_RUN)
    cells = Grid(find_scene(str(file))(), {"stiffness": spread(200.0, 900.0, 12)}, plant="exact")
    assert [one["own"] for one in run_scene_cells(cells, file.read_text())] == spread(200.0, 900.0, 12)
    assert batches == []


def test_laws_are_stacked_by_the_parameters_that_may_differ() -> None:
    walls = [Wall(axes=("y", "z"), lower=0.0, stiffness=k, damping=[1.0, k]) for k in (1.0, 2.0, 3.0)]
    whole = stacked(walls)
    assert whole.batch == (3,) and whole.lower == 0.0
    assert np.array_equal(whole.stiffness, [[1.0, 1.0], [2.0, 2.0], [3.0, 3.0]])
    assert np.array_equal(whole.damping, [[1.0, 1.0], [1.0, 2.0], [1.0, 3.0]])
    assert stacked([walls[0], walls[0]]) is walls[0]
    assert stacked([Bias([float(n)] * 6) for n in range(2)]).batch == (2,)
    with pytest.raises(ParameterError, match="stiffness must be a number, or one for each of 1 axes"):
        stacked([Hold(axes="z", stiffness=[[1.0], [2.0]], damping=0.0), Hold(axes="z", stiffness=1.0, damping=0.0)])


def test_laws_are_of_one_kind_if_all_else_agrees() -> None:
    def friction(**values: Any) -> Law:
        default: dict[str, Any] = {"axes": "z", "stiffness": 1.0, "breakaway": 1.0, "v_min": 1.0}
        return StickSlip(**default | values)

    assert law_kind(friction()) == law_kind(friction(stiffness=2.0)) != law_kind(friction(axes="x"))
    assert law_kind(Hold(axes="z", stiffness=1.0, damping=0.0)) != law_kind(friction())
    assert law_kind(lambda position, velocity: [0.0] * 6) is None

    @dataclass(frozen=True)
    class Silent(Law):
        """Law without a declaration of its fields."""

        stiffness: float

    assert law_kind(Silent(1.0)) is None


def test_what_is_alike_is_computed_at_once_and_in_place() -> None:
    kinds = ["a", "b", None, "a", "a", "b"]
    assert alike(kinds) == {"a": [0, 3, 4], "b": [1, 5]}
    calls: list[list[int]] = []

    def doubled(some: list[int]) -> list[int]:
        calls.append(some)
        return [2 * one for one in some]

    assert computed_together([1, 2, 3, 4, 5, 6], kinds, doubled, default=0) == [2, 4, 0, 8, 10, 12]
    assert calls == [[1, 4, 5], [2, 6]]
    calls.clear()
    most = {1: 2, 2: 1}  # by the first of a kind
    assert computed_together([1, 2, 3, 4, 5, 6], kinds, doubled, most=most.__getitem__)[2] is None
    assert calls == [[1, 4], [5], [2], [6]]
