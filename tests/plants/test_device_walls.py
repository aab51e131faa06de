"""Walls on the device: the drop's known values, every plant alike, and the two-rate limit against simulation."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from maglev_mj.control import Bias, Hold, Law, Wall, drive
from maglev_mj.control.controller import Controller
from maglev_mj.errors import MaglevError
from maglev_mj.frames import AXES, Array, Command, DeviceWall
from maglev_mj.plants import ExactPlant, MuJoCoBatchPlant, MuJoCoPlant, SampledPlant, Sensor, Timing
from maglev_mj.plants.device_walls import DeviceWalls
from maglev_mj.recording.verify import verify
from maglev_mj.scenes.batch import figures_together
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.run import figures_of, run_phases
from maglev_mj.scenes.stability_check import wall_loops
from maglev_mj.session.replay import rebuild, record_run
from maglev_mj.theory import judge, largest_stable_stiffness, spectral_radius, stability
from maglev_mj.theory.two_rates import DeviceLaw
from tests.all_of import MOTIONS, START
from tests.cells import unstable
from tests.sweeps import further

DEVICE: Any = {"wall_on": "device"}
FAST: Any = {"device_period": 1.25e-4, "device_delay": 1.25e-4}
STIFF: Any = DEVICE | {"stiffness": 6e4, "damping": 200.0}
LIMITED: Any = STIFF | {"force_limit": 60.0}
BESIDE: Any = {"device_damping": 200.0, "pulse": 0.0}
DROPS: list[tuple[Any, str, str, str]] = [
    ({"pulse": 0.0}, "2.927 2.363 3.612", "0 0 0.084", "37.05 31.24 43.14"),
    (DEVICE, "2.148 2.066 2.238", "0 0 0", "26.33 25.12 27.56"),
    (DEVICE | FAST, "2.153 2.142 2.163", "0 0 0", "24.36 24.21 24.52"),
    (STIFF, "0.699 0.609 0.802", "0.028 0.004 0.081", "80.7 72.0 89.5"),
    (LIMITED, "0.820 0.662 0.986", "0.106 0.017 0.227", "60 60 60"),
    (STIFF | FAST, "0.636 0.626 0.646", "0 0 0", "64.6 63.5 65.8"),
    (LIMITED | FAST, "0.657 0.640 0.675", "0 0 0", "60 60 60"),
    (
        LIMITED | FAST | {"device_cutoff": 200.0, "quantize": 5e-6},
        "0.644 0.624 0.663",
        "0 0 0",
        "60 60 60",
    ),
    (BESIDE | {"stiffness": 3e4, "damping": 17.0}, "0.929 0.763 1.119", "0.006 0 0.155", "59.8 58.6 69.1"),
    (BESIDE | {"stiffness": 5.5e4, "damping": 17.4}, "0.902 0.724 1.105", "3.27 1.61 6.02", "68.8 60.9 77.5"),
]


@pytest.mark.parametrize(("values", "penetration", "rebound", "peak"), DROPS)
def test_drop(values: Any, penetration: str, rebound: str, peak: str) -> None:
    scene = Drop(**{"force_limit": 0.0} | values, duration=0.2)
    span = (scene.device_period or 1e-3) / scene.period if scene.wall_on == "device" else 1.0
    found = run_phases(scene, (np.arange(24) + 0.5) / 24 * span, plant="exact").figures
    known = {"penetration": (penetration, 1e3), "rebound": (rebound, 1e3), "peak_force": (peak, 1.0)}
    for name, (text, unit) in known.items():
        each = unit * found[name]
        for value, digits in zip((np.median(each), each.min(), each.max()), text.split(), strict=True):
            half = 0.5 * 10.0 ** -len(digits.partition(".")[2])
            assert value == pytest.approx(float(digits), abs=1.001 * half if digits != "0" else 1e-12), name


class Moving(Law):
    """Two-sided spring and damper on the device along y, whose edge moves at each sample."""

    on = "device"

    def start(self) -> Any:
        return 0

    def __call__(self, position: Any, velocity: Any, state: Any, wrench: Any) -> Any:
        return state + 1, None

    def device_walls(self, state: Any) -> Sequence[DeviceWall]:
        return (DeviceWall(1, edge=2e-6 * state, side=0, stiffness=900.0, damping=12.0),)


def walls() -> Controller:
    upper = Wall(axes="x", upper=1e-3, stiffness=2e4, damping=60.0, on="device", cutoff=300.0)
    lower = Wall(axes="z", lower=0.0, stiffness=3e4, damping=120.0, on="device")
    host: list[Law] = [Wall(axes="z", lower=0.0, stiffness=2e3, damping=10.0), Bias([2.0, 0.0, 0.0, 0.0, 0.0, 0.0])]
    return Controller([upper, lower, Moving(), *host], period=0.002)


POSE, TWIST = [*START["pose"][:3], 0.0, 0.0, 0.0], START["twist"]
CLOCKS: Any = {"period": 0.002, "delay": 0.003, "device_period": 7e-4, "device_delay": 9e-4, "device_phase": 0.3}
BATCHES: dict[str, Callable[..., SampledPlant]] = {
    name: lambda *clock, made=made, **keywords: made(*clock, **keywords | {"pose": [POSE] * 2})
    for name, made in {"exact, batch": ExactPlant, "mujoco, batch": MuJoCoBatchPlant}.items()
}


def motion(made: Callable[..., SampledPlant], controller: Controller, **keywords: Any) -> tuple[Array, int]:
    """Return 150 measured poses and the number of intervals of constant force in the last period."""
    controller.reset()
    rows: list[Any] = []
    with made(Timing(**CLOCKS), **{"pose": POSE, "twist": TWIST} | keywords) as plant:
        drive(plant, controller, 150, observe=lambda sample, _: rows.append(np.broadcast_to(sample.pose, (2, 6))))
        return np.array(rows), len(plant._last_intervals)


CONTROLLER = walls()
EXACT = motion(ExactPlant, CONTROLLER)[0]


@pytest.mark.parametrize("name", [*MOTIONS, *BATCHES])
def test_one_controller_on_every_plant(name: str) -> None:
    poses, intervals = motion((BATCHES | dict(MOTIONS))[name], CONTROLLER)
    assert np.abs(poses - EXACT).max() < 2e-14
    assert EXACT[:, 0, 2].min() < 0.0 and EXACT[:, 0, 0].max() > 1e-3  # both walls touched
    assert intervals >= 5  # rendered between the host's samples


@pytest.mark.parametrize("made", [ExactPlant, MuJoCoPlant])
def test_samples_skipped_in_free_flight(made: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Drop(**STIFF, device_cutoff=2e3, device_period=2e-4, duration=0.05)
    flights = []
    for _ in range(2):
        with scene.plant(made) as plant:
            counts: list[int] = []
            controller = scene.controller()
            end = drive(plant, controller, 10, observe=lambda *_, c=counts, p=plant: c.append(len(p._last_intervals)))
            flights.append((end.position[2], counts))
        monkeypatch.setattr(DeviceWalls, "_reach", lambda *_: 0.0)
    (skipped, some), (each, every) = flights
    assert skipped == pytest.approx(each, abs=1e-12)
    assert max(some[1:4]) <= 3 < 25 <= min(every[2:4]) and max(some) >= 25


def grown(made: Any, loop: Any, stiffness: float, damping: float, device: DeviceLaw, periods: int) -> float:
    """Return the growth per host period of a loop without an edge, from 1 µm, on a plant."""
    own = DeviceWall(2, 0.0, 0, device.stiffness, device.damping, device.cutoff)

    class Own(Moving):
        def device_walls(self, state: Any) -> Sequence[DeviceWall]:
            return (own,)

    host = Hold(axes="z", stiffness=stiffness, damping=damping)
    heights: list[float] = []
    clocks: Any = {"device_period": device.period, "device_delay": device.delay}
    timing = Timing(period=loop["period"], delay=loop["delay"], **clocks)
    far: Any = {"escape": (1e9, 1.0), "gravity": 0.0, "pose": [0.0, 0.0, 1e-6, 0.0, 0.0, 0.0]}
    with made(timing, mass=loop["mass"], **far) as plant:
        controller = Controller([host, Own()], period=loop["period"])
        drive(plant, controller, periods, observe=lambda sample, _: heights.append(abs(sample.position[2])))
    early, late = (max(part) for part in (heights[periods // 4 : periods // 2], heights[3 * periods // 4 :]))
    return float((late / early) ** (2.0 / periods))


@pytest.mark.parametrize("seed", [*range(3), *further(*range(3, 300))])
def test_two_rate_limit(seed: int) -> None:
    random = np.random.default_rng(seed)
    period = 10.0 ** random.uniform(-3.0, -2.0)
    loop: Any = {"period": period, "delay": period * random.uniform(0.0, 1.8), "mass": random.uniform(0.1, 2.0)}
    device = period / random.integers(1, 9)
    scale = loop["mass"] / period
    law = DeviceLaw(0.0, scale * random.uniform(0.02, 0.3), device, device * random.uniform(0.0, 1.2))
    damping = scale * random.uniform(0.0, 0.1)
    limit = float(largest_stable_stiffness(damping, device=law, **loop))
    for factor in (0.98, 1.02):
        exact = float(spectral_radius(factor * limit, damping, device=law, **loop))
        for made in (ExactPlant, MuJoCoPlant):
            growth = grown(made, loop, factor * limit, damping, law, 400)
            assert (growth < 1.0) is (factor < 1.0)
            assert growth == pytest.approx(exact, abs=2e-3)


@pytest.mark.parametrize("values", [BESIDE | {"stiffness": 61385.85, "damping": 20.0}, STIFF | {"stiffness": 211773.8}])
def test_switching_at_the_edge(values: Any) -> None:
    scene = Drop(**values | {"stiffness": 0.8 * values["stiffness"]}, duration=0.6)
    settled = run_phases(scene, (np.arange(20) + 0.5) / 20, plant="exact").figures["settling_time"]
    assert settled.max() < 0.4


def test_sweep_equals_single_runs() -> None:
    scenes = [Drop(**DEVICE, stiffness=6e3 + n, device_delay=1e-4 * (1 + n % 2), duration=0.05) for n in range(16)]
    together = figures_together(scenes, "exact", [0.0] * 16)
    for scene, row in zip(scenes, together, strict=True):
        # a batch skips samples of its devices together: equal but for rounding
        assert row and row["penetration"] == pytest.approx(figures_of(scene, "exact")["penetration"], rel=1e-12)


def test_verdict_of_a_scene() -> None:
    alone, beside = Drop(**STIFF), Drop(stiffness=2e4, damping=20.0, device_damping=100.0, pulse=0.0)
    for scene, known in ((alone, 0.857502**5), (beside, 0.881964)):
        (touching,) = (state for state in stability(scene).states if state.acting)
        assert touching.axes == ("z",) and touching.spectral_radius == pytest.approx(known, abs=5e-6)
    scenes = [alone, beside, alone.replace(stiffness=2.2e5), beside.replace(device_damping=50.0)]
    assert unstable(scenes) == [False, False, True, True] == [not stability(scene).stable for scene in scenes]
    assert judge(wall_loops(alone)).ratio == pytest.approx(211773.8 / 6e4, rel=1e-3)


def test_recording_and_rewind() -> None:
    scene = Drop(**STIFF, duration=0.1)
    assert verify(record_run(scene, plant="mujoco"), rebuild).same
    controller, ends = scene.controller(), []
    with scene.plant("mujoco", sensor=Sensor(quantum=5e-6, noise=2e-6, seed=3)) as plant:
        assert isinstance(plant, MuJoCoPlant)
        drive(plant, controller, 8)
        saved, states = plant.saved(), (list(controller._states), controller._velocity_state, controller._tick)
        for _ in range(2):
            ends.append(drive(plant, controller, 8).position)
            plant.restore(saved)
            controller._states, controller._velocity_state, controller._tick = list(states[0]), *states[1:]
    assert ends[0] == ends[1]


WALL: Any = {"axes": "z", "lower": 0.0, "stiffness": 1.0, "damping": 1.0}
REFUSED: list[tuple[Callable[[], object], str]] = [
    (lambda: Timing(device_delay=0.02), "device_delay must be at most 0.01"),
    (lambda: Timing(device_period=0.0), "device_period must be"),
    (lambda: Timing(device_phase=1.0), "device_phase must be"),
    (lambda: Wall(**WALL, on="board"), "wall on must be"),
    (lambda: Wall(**WALL, pulse=1.0, pulse_width=1e-3, on="device"), "pulse must be 0"),
    (lambda: Wall(**WALL, on="device", cutoff=0.0), "cutoff must be above 0"),
    (lambda: Drop(wall_on="device", device_damping=1.0), "device_damping must be None"),
    (lambda: written(DeviceWall(6)), "axis from 0 to 5"),
    (lambda: written(DeviceWall(2, stiffness=-1.0)), "stiffness must be at least 0"),
    (lambda: written(DeviceWall(2, edge=np.zeros(3))), r"edge must have shape \(\)"),
    (lambda: written(DeviceWall(2), Timing(delay=np.array([1e-3, 2e-3]))), "delay must be a number"),
]


@pytest.mark.parametrize(("make", "message"), REFUSED)
def test_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises(MaglevError, match=message):
        make()


def test_a_wall_on_the_device_beside_a_law_without_gains_is_not_judged() -> None:
    verdict = judge(Controller([Moving()], period=0.005), delay=0.0015)
    assert verdict.stable is None and verdict.unjudged == AXES and "needs declared gains" in str(verdict)


def written(wall: DeviceWall, timing: Timing | None = None) -> None:
    """Write a wall to a plant."""
    with ExactPlant(timing, pose=np.zeros((2, 6)) if timing else np.zeros(6)) as plant:
        plant.read()
        plant.write(Command([0.0] * 6, walls=(wall,)))
