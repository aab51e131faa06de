"""Warnings of motions beyond the device's range: one line, and only then."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from itertools import compress
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

from maglev_mj import AXES, Calibration, Controller, Twin, TwinParameters, Wall, compare, find_scene, stability
from maglev_mj import sweep as sweep_of
from maglev_mj.bridge.flight import Flight
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.frames import Array
from maglev_mj.interop.gym import TargetTask
from maglev_mj.interop.hand_devices import AxisMapping, HandDevice, HandState
from maglev_mj.interop.navigation import Navigation
from maglev_mj.plants.hand import SpringHand
from maglev_mj.plants.limits import LIMITS, peaks_of
from maglev_mj.plants.model import model_path
from maglev_mj.plants.trace import Trace
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.press import Press
from maglev_mj.scenes.run import run, run_phases
from maglev_mj.scenes.scene import Scene
from maglev_mj.scenes.stick_slip import Pull
from maglev_mj.session import Snapshot
from maglev_mj.spec import INERTIA, RANGE
from tests.all_of import SCENES


def furthest(trace: Trace) -> Array:
    """Return the largest distances on each axis, sampled every 10 µs."""
    pose = trace.at(np.arange(0.0, float(trace.time[-1].min()), 1e-5))[0]
    distance: Array = np.abs(pose).max(axis=0)
    return distance


def test_the_furthest_of_a_trace_lies_between_its_knots_too() -> None:
    trace = run(Drop(force_limit=15.0), plant="exact").trace
    np.testing.assert_allclose(trace.furthest(), furthest(trace), atol=1e-8)
    assert trace.furthest()[2] > np.abs(trace.pose[:, 2]).max() + 1e-6
    for knot, acted in ((0, True), (-2, True), (-1, False)):
        wrench = np.where(np.arange(len(trace.time))[:, None] == knot % len(trace.time), -1e3, trace.wrench)
        assert (peaks_of(replace(trace, wrench=wrench))[0] == 1e3) == acted
    ball = Trace(np.array([0.0, 0.2]), np.zeros((2, 1)), np.array([[1.0], [-1.0]]), np.zeros((2, 1)))
    assert ball.furthest() == pytest.approx([0.05])  # thrown up at 1 m/s, back after 0.2 s


FORCES = [8.0, 20.0, 26.0, 27.0, 60.0, 0.0]
GAINS = (6000.0, 80.0), (3000.0, 40.0)
SHARES = 0.9, 1.0, 1.03, 1.15, -0.9, -1.5
RUNS = [
    *(Drop(force_limit=limit, duration=0.3, stiffness=k, damping=b) for limit in FORCES for k, b in GAINS),
    *(Drop(height=height * RANGE[2], duration=0.05, pulse=0.0) for height in (1.0, 1.0001)),
    *(Press(hits=1, **change) for change in ({"force_limit": 5.5}, {"height": 0.0046})),  # type: ignore[arg-type]
    *(Pull(axis=axis, target=part * RANGE[AXES.index(axis)]) for axis in ("x", "rz") for part in SHARES),
]


@pytest.mark.parametrize("scene", RUNS, ids=lambda scene: scene.name)
def test_every_result_names_the_limits_that_its_runs_exceed(scene: Scene) -> None:
    phases = np.arange(4) / 4.0 if scene.takes_phase else np.zeros(1)
    vary: dict[str, Any] = {"phase": phases.tolist()} if scene.takes_phase else {"plant": ["exact"]}
    traces = [run(scene, plant="exact", phase=float(phase)).trace for phase in phases]
    reached = np.array([trace.furthest() for trace in traces])
    above = [np.abs(trace.wrench[:-1, 2]).max() > scene.body.force_limit for trace in traces]
    out = [bool(row.any()) for row in reached > scene.body.range * (1.0 + 1e-9)]
    verdicts = [", ".join(compress([limit.verdict for limit in LIMITS], pair)) for pair in zip(above, out)]
    cells = sweep_of(scene, vary, plant="exact").columns()
    assert list(cells.get("warnings", [""] * len(phases))) == verdicts
    several = run_phases(scene, phases, plant="exact")
    for result, count in ((run(scene, plant="exact"), 1), (several, len(phases))):
        said = " ".join(result.warnings)
        assert ("peak force" in said) == any(above[:count]) and ("exceeds the range" in said) == any(out[:count])
        if (value := re.search(r"([0-9.]+) (mm|deg)(?: \((\d) of|$)", said)) is not None:
            most = reached[:count].max() * (1e3 if value[2] == "mm" else 180.0 / np.pi)
            assert float(value[1]) == pytest.approx(most, rel=1e-3)
            assert int(value[3] or 0) == (sum(out) if result is several else 0)


@pytest.fixture(scope="module")
def light(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the model of a device of 0.3 kg with half the force, 2 mm of range and the moon's gravity."""
    spec, file = mujoco.MjSpec.from_file(str(model_path("maglev"))), tmp_path_factory.mktemp("light") / "light.xml"
    spec.body("flotor").mass, spec.option.gravity = 0.25, [0.0, 0.0, -1.62]
    for actuator in spec.actuators:
        actuator.gainprm[0] = 1.0
    for joint in spec.body("flotor").joints[:3]:
        joint.range = [-0.002, 0.002]
    file.write_text(spec.to_xml())
    return str(file)


@pytest.fixture(scope="module")
def device() -> RemotePlant:
    """Return a twin of the light device."""
    own = replace(Calibration.nominal(), mass=0.3, gravity=np.array([0.0, 0.0, -1.62]))
    return RemotePlant(VirtualLink(Twin(TwinParameters(calibration=own))), calibration=own)


@pytest.mark.parametrize("name", SCENES)
def test_a_scene_is_judged_by_the_device_in_use(name: str, light: str, device: RemotePlant) -> None:
    base: Any = find_scene(name)
    options = lambda self: {**base.plant_options(self), "model": light, "mass": None}  # noqa: E731
    scene: Any = type("Light", (base,), {"plant_options": options})()
    fall = 1.62 if scene.start().gravity is None else 0.0
    assert scene.body.inertia[0] == pytest.approx(0.3) and scene.body.gravity[2] == -fall
    assert scene.body.range[0] == 0.002 and scene.body.force_limit == pytest.approx(30.0)
    for plant in (scene.plant(kind) for kind in scene.plants if kind != "none"):
        assert_allclose([plant.inertia[0], plant.load[2]], [0.3, -0.3 * fall], rtol=1e-9)
        carried = getattr(scene, "weightless", False)
        assert_allclose(plant.before[2] + (carried or name == "wall") * plant.load[2], 0.0, atol=1e-12)
        assert_allclose(scene.controller().carried[2] + carried * plant.load[2], 0.0, atol=1e-12)
    if name == "drop":
        text = " ".join(str(run(scene, plant="exact").table()).split())
        assert "mass 0.3 kg" in text and "device's 30 N" in text and "range of 2 mm" in text
        assert scene.rest == pytest.approx(-0.3 * 1.62 / scene.stiffness)
        seen: Any = []
        law = lambda position, velocity: seen.append(np.abs(position[0]).max()) or [0.0] * 6  # noqa: E731
        stability(type("Own", (type(scene),), {"controller": lambda self: Controller([law], period=0.005)})())
        assert 0.0018 < max(seen) < 0.0021
    if "exact" in scene.plants:
        task = TargetTask(scene, AXES)
        assert task.limit[2] == pytest.approx(10.0) and (task.observation_space.high[:6] == 2 * scene.body.range).all()
    assert_allclose(
        np.array(Navigation(body=scene.body).edge), [0.0025 * 2.0 / 4.5] * 3 + [math.radians(3.0)] * 3, rtol=1e-5
    )
    hand, readings = SpringHand(), iter((HandState([0.0] * 6, [2]), HandState([1.0] * 6)))
    stick: Any = HandDevice(SimpleNamespace(read=lambda: next(readings)), hand, AxisMapping())
    for _ in range(2):
        stick.show(Snapshot(scene=scene))
    assert hand.device_target == scene.body.range.tolist()
    pulses = [np.max(law.pulse) for law in scene.laws() if isinstance(law, Wall)]
    assert not carried or pulses in ([], [pytest.approx(0.3 / 0.003 - 80.0)], [0.0])
    for flown in (base(), scene):
        flight = Flight(device, flown.replace(period=device.period))
        assert flight._controller.carried[2] == pytest.approx(0.3 * 1.62 * (carried or not fall))
        assert (flight._force[2], flight._load[2]) == pytest.approx((0.3 * 1.62, -0.3 * 1.62))
        assert flight._power_guard._sizes[3] == pytest.approx(math.sqrt(INERTIA[3] / 0.3))


@pytest.mark.parametrize(("name", "gain"), [("drop", 0.0), ("drop", 50.0), ("press", 0.0), ("press", 50.0)])
def test_variants_are_compared_only_if_the_parameter_decides_on_a_pulse(name: str, gain: float) -> None:
    base: Any = find_scene(name)
    wall = Wall(axes="z", lower=0.0, stiffness=3000.0, damping=20.0, pulse=gain, pulse_width=0.003)
    scene = type("Mine", (base,), {"laws": lambda self: [wall]})()
    assert dict(scene.variants()) == {"mine": scene}
    assert [each.has_pulses for each in base().variants().values()] == [True] * (1 + (name == "drop")) + [False]


@pytest.mark.parametrize("study", ["compare", "sweep"])
@pytest.mark.parametrize("told", [True, False])
def test_a_chaotic_bounce_gives_the_spread_of_its_figures(told: bool, study: str) -> None:
    chaotic = Drop(period=1.0 / 1300.0, stiffness=18000.0, damping=0.0, pulse=900.0, duration=0.75, force_limit=0.0)
    scene = chaotic if told else Drop()
    spread = re.compile(r"figures are not reproducible: .* (-?[0-9.]+) to (-?[0-9.]+) \S+ over 6 starts")
    result: Any = (
        compare(scene, ["pulse"], phases=1, phase=0.0)
        if study == "compare"
        else sweep_of(scene, {"pulse_width": [0.003]})
    )
    found = [match for text in result.warnings if (match := spread.search(text))]
    assert len(found) == told and all(float(match[1]) < float(match[2]) for match in found)
