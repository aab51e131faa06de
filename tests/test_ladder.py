"""Each rung of the ladder does what it says, and each scene needs the rung that it declares."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from maglev_mj import Controller, ExactPlant, Hold, MuJoCoPlant, Timing, run
from maglev_mj.cli import main
from maglev_mj.detail import Detail
from maglev_mj.errors import ParameterError
from maglev_mj.experiments.fidelity import FidelityResult, RungResult, measure_fidelity, measure_rungs, measure_steps
from maglev_mj.experiments.ladder import FIDELITY_SCENES, RUNGS, apart, motion_of, plant_of
from maglev_mj.experiments.wall_controller import wall_controller
from maglev_mj.frames import Array, Command
from maglev_mj.spec import Spec

LAG = 1.0 / (2.0 * math.pi * Spec.driver_bandwidth.value)


@pytest.mark.parametrize("name", FIDELITY_SCENES)
def test_a_scene_declares_the_least_rung_that_keeps_its_tolerance(name: str) -> None:
    scene = FIDELITY_SCENES[name]
    rows = measure_rungs(scene, repeats=1)
    assert [row.rung for row in rows] == [rung.name for rung in RUNGS]
    place = [row.rung for row in rows].index(scene.rung)
    # sufficient: neither the next rung nor any above it changes the answer by the tolerance
    assert rows[place + 1].changes < scene.tolerance and rows[place].missing < scene.tolerance
    # necessary: the rung below is off by more
    assert rows[place].changes >= scene.tolerance and rows[place - 1].missing >= scene.tolerance


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
        run(plant, controller, 80, observe=lambda sample, _: seen.append(sample.position[2]))
        return np.array(seen)

    truth = heights(0.0015, True)
    assert np.abs(heights(0.0015 + LAG, False) - truth).max() < 2e-6
    assert np.abs(heights(0.0015, False) - truth).max() > 1e-4  # where it is left out altogether


def steady(plant: MuJoCoPlant, force: float, ticks: int = 2) -> float:
    """Return the acceleration along z under a held force, from where the flotor is after some ticks [m/s²]."""
    for _ in range(ticks):
        plant.read()
        plant.write(Command([0.0, 0.0, force, 0.0, 0.0, 0.0]))
    before = plant.state()[1][2]
    plant.read()
    return float(plant.state()[1][2] - before) / plant.period


@pytest.mark.parametrize(("height", "left"), [(0.0, 1.0), (2.25e-3, 0.975), (-4.5e-3, 0.9)])
def test_a_coil_loses_force_with_the_square_of_its_stroke(height: float, left: float) -> None:
    timing = Timing(period=1e-4, delay=0.0)
    plant = MuJoCoPlant(timing, pose=[0, 0, height, 0, 0, 0], gravity=0.0, detail=Detail(force_falloff=0.1))
    assert steady(plant, 7.0) == pytest.approx(10.0 * left, rel=1e-5)


def test_a_trace_holds_the_force_that_is_left() -> None:
    detail = Detail(force_falloff=0.1)
    plant = MuJoCoPlant(
        pose=[0, 0, 4.5e-3, 0, 0, 0], wrench=[0, 0, 7, 0, 0, 0], gravity=0.0, detail=detail, record=True
    )
    plant.read()
    assert plant.trace().wrench[0][2] == pytest.approx(6.3)


def test_falloff_converges_with_the_second_power_of_the_step() -> None:
    def last(step: float) -> float:
        timing, detail = Timing(delay=0.0), Detail(force_falloff=0.5)
        start = [0.0, 0.0, 4e-3, 0.0, 0.0, 0.0]
        plant = MuJoCoPlant(timing, pose=start, gravity=0.0, detail=detail, longest_step=step)
        hold = Hold(axes="z", stiffness=2000.0, damping=20.0)
        return float(run(plant, Controller([hold], period=0.005), 10).pose[2])

    places = [last(step) for step in (1.25e-3, 6.25e-4, 3.125e-4, 1e-5)]
    errors = [abs(place - places[-1]) for place in places[:-1]]
    assert np.polyfit(np.log([4.0, 2.0, 1.0]), np.log(errors), 1)[0] == pytest.approx(2.0, abs=0.15)


def test_the_stops_hold_a_flotor_without_currents() -> None:
    plant = MuJoCoPlant(Timing(), detail=Detail(stops=True))
    last = run(plant, Controller([], period=0.005), 60).pose
    assert last[2] == pytest.approx(-4.5e-3, abs=5e-6)


@pytest.mark.parametrize("mass", [0.7, 1.4])
def test_the_handle_swings_at_a_kilohertz(mass: float) -> None:
    plant = MuJoCoPlant(Timing(), mass=mass, gravity=0.0, detail=Detail(flexible=True))
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


def test_detail_needs_coils_and_sense() -> None:
    with pytest.raises(ParameterError, match="driver_lag and detail need coils=True"):
        MuJoCoPlant(coils=False, detail=Detail(stops=True))
    with pytest.raises(ParameterError, match="force_falloff must be a finite number at least 0 and at most 1, not 2"):
        Detail(force_falloff=2.0)


def test_a_looser_tolerance_takes_a_lower_rung() -> None:
    tight, loose = measure_fidelity("twist"), measure_fidelity("twist", 2e-4)
    assert tight.rung.rung == "body" and loose.rung.rung == "axes"
    assert tight.cheapest is not None and tight.cheapest.error + tight.rung.missing < 1e-5
    assert loose.cheapest is not None and loose.cheapest.integrator == "closed form"
    for wrong, words in (("moon", "scene must be one of drop, "), ("twist", "tolerance must be")):
        with pytest.raises(ParameterError, match=words):
            measure_fidelity(wrong, math.nan)


def test_a_step_that_diverges_is_no_choice() -> None:
    scene = replace(FIDELITY_SCENES["six-axes"], ticks=10)
    rows = measure_steps(scene, "filter", repeats=1)
    diverged = [row for row in rows if not math.isfinite(row.error)]
    # beyond twice the drivers' time constant Euler's activation grows
    assert diverged and all(row.step is not None and row.step > 2.0 * LAG for row in diverged)
    assert {row.step for row in rows if math.isfinite(row.error)} >= {None, 1e-4, 5e-5}
    rung = RungResult("filter", "", 0.0, 0.0, 0.0, 1.0)
    result = FidelityResult(scene, 1e-5, (rung,), rung, rows, None)
    assert json.loads(json.dumps(result.as_json(), allow_nan=False))["steps"][rows.index(diverged[0])]["cost"] is None


def test_every_rung_can_be_built_for_every_scene() -> None:
    with pytest.raises(ParameterError, match="rung must be one of axes, body"):
        plant_of(FIDELITY_SCENES["drop"], "attic")
    scene = FIDELITY_SCENES["six-axes"]
    for rung in ("body", "turning"):
        corrected, exact = (motion_of(scene, plant_of(scene, rung, integrator=kind)) for kind in ("corrected", "rk4"))
        assert 0.0 < apart(corrected.pose, exact.pose) < 2e-6


def test_the_command_prints_and_writes_the_ladder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "fidelity.json"
    assert main(["fidelity", "twist", "--tolerance", "1e-5", "--json", str(out)]) == 0
    said = capsys.readouterr().out
    assert "> body " in said and "take body with" in said
    data = json.loads(out.read_text())
    assert data["rung"] == "body" and data["cheapest"]["error"] < 1e-5
    assert [row["rung"] for row in data["rungs"]] == [rung.name for rung in RUNGS]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["moon"], "scene must be one of drop, drop-no-pulse"),
        (["drop", "--tolerance", "0"], "tolerance must be a finite number above 0, not 0"),
        (["all", "--tolerance", "1e-3"], "tolerance must be left out for all scenes"),
        (["drop", "--json", "no/such/folder.json"], "json"),
    ],
)
def test_bad_input_is_one_line_and_status_2(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["fidelity", *arguments]) == 2
    said = capsys.readouterr().err
    assert words in said and said.count("\n") == 1
