"""Every front end gives one verdict: nothing that was not judged is called stable."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import maglev_mj
from maglev_mj import (
    AxisLaw,
    Device,
    device_card,
    diagnose,
    gain,
    hold,
    judge,
    param,
    stability,
)
from maglev_mj.bridge.preflight import check_change
from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.stability_check import stability_warning, wall_loops
from maglev_mj.session.margin import margin
from maglev_mj.studies.compare import compare, sweep_laws
from maglev_mj.studies.stability_map import StabilityParameters
from maglev_mj.theory.boundary import boundary_of, stiffest_of
from maglev_mj.theory.loop import Loop
from maglev_mj.theory.loop_array import spectral_radius
from tests.bridge.test_preflight import GOOD
from tests.cells import unstable


class Coulomb(AxisLaw):
    """Wall with friction against the velocity, from a depth on."""

    stiffness: float = gain("stiffness", "N/m")
    damping: float = gain("damping", "N s/m")
    friction: float = gain("friction", "N", default=1.0)
    below: float = gain("position", "m", default=0.0, at_least=-1.0)

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        wall = -(gains.stiffness * x + gains.damping * v) * (x < 0.0)
        return wall - gains.friction * np.sign(v) * (x < gains.below)


class Rough(Drop):
    """Drop on a wall, with friction on one axis."""

    rough: str = param("axis", default="z", choices=AXES)
    below: float = param("friction from here on", "m, rad", default=0.0)
    friction: float = param("friction", "N, N m", default=1.0)

    def laws(self) -> list[Any]:
        stiffness, damping = (self.stiffness, self.damping) if self.rough in "xyz" else (1.0, 0.01)
        own: Any = {"stiffness": stiffness, "damping": damping, "friction": self.friction, "below": self.below}
        law = Coulomb(axes=self.rough, **own)
        return [law, hold(self, [axis for axis in AXES if axis != self.rough])]


def rough(seed: int) -> Rough:
    """Return a random drop with a sign of the velocity on one axis."""
    random = np.random.default_rng(seed)
    loop: Any = {"period": 1e-3, "delay": 8e-4, "stiffness": 10.0 ** random.uniform(3.5, 5.5), "damping": 80.0}
    edge, force = random.uniform(-2e-3, 0.0), random.uniform(0.01, 3.0)
    return Rough(**loop, rough=AXES[seed % len(AXES)], below=edge, friction=force)


@pytest.mark.parametrize("seed", range(8))
def test_an_axis_that_is_not_judged_is_stable_nowhere(seed: int) -> None:
    scene = rough(seed)
    verdict = stability(scene)
    assert verdict.stable is not True and (verdict.stable is False or verdict.unjudged == (scene.rough,))
    assert margin(scene).stable is not True
    assert stability_warning(scene) is not None
    with pytest.raises(TypeError, match=r"no truth value: use \.stable"):
        bool(verdict)


@pytest.mark.parametrize("seed", range(8))
def test_an_axis_that_is_not_judged_flies_and_is_diagnosed_nowhere(seed: int) -> None:
    scene = rough(seed)
    assert check_change(scene, scene.body.inertia.tolist(), [], report=GOOD, anyway=False)[1]
    try:
        assert not diagnose(scene).stable
    except ParameterError as error:
        assert "not computed" in str(error)


def test_the_wall_of_a_law_that_is_not_judged_has_no_margin() -> None:
    loop: Any = {"period": 1e-3, "delay": 8e-4, "stiffness": 2e4, "damping": 80.0}
    assert judge(wall_loops(Rough(**loop, rough="z", below=0.0, friction=0.5))).stable is None
    assert np.isnan(compare(Drop(**loop), {"own": Coulomb}, phases=1).margins["own"]["spectral_radius"])


def test_an_edge_is_skipped_and_its_region_is_not() -> None:
    """A wall without a gains() method is smooth to both sides of its edge, and stays judged."""
    verdict = stability(Rough(stiffness=2000.0, friction=0.0))
    assert verdict.stable is True and len(verdict.jumps) and not verdict.unjudged


def lagging(lag: float, folder: Path) -> str:
    path = folder / f"{lag:g}.toml"
    path.write_text(Device.load("stage").change("driver", time_constant=lag).toml())
    return str(path)


FRONTS: dict[str, Callable[[Drop], Any]] = {
    "stability": lambda scene: max(one.spectral_radius for one in stability(scene).states if "contact" in one.acting),
    "diagnose": lambda scene: diagnose(scene).critical_stiffness,
    "compare": lambda scene: compare(scene.replace(duration=0.1), ["pd"], phases=1).margins["pd"]["spectral_radius"],
    "wall": lambda scene: judge(wall_loops(scene)).spectral_radius,
    "sweep": lambda scene: unstable([scene]),
    "page": lambda scene: (margin(scene).words, margin(scene).boundary[1].tolist()),
    "flight": lambda scene: check_change(scene, scene.body.inertia.tolist(), [], report=GOOD, anyway=False),
    "card": lambda scene: float(device_card(scene).walls[0].stiffness),
    "map": lambda scene: float(stiffest_of(StabilityParameters(device=scene.device).loop().array()).stiffness),
}
LOOP: dict[str, Any] = {"stiffness": 40_000.0, "damping": 140.9, "pulse": 0.0}


@pytest.mark.parametrize("front", FRONTS)
def test_the_lag_of_a_device_moves_every_verdict(front: str, tmp_path: Path) -> None:
    exact, late = (FRONTS[front](Drop(device=lagging(lag, tmp_path), **LOOP)) for lag in (0.0, 1e-3))
    assert exact != late


FILTERED = {"stability", "compare", "wall", "page", "flight"}


@pytest.mark.parametrize("front", sorted(FILTERED))
def test_the_filter_of_a_law_on_the_device_moves_every_verdict(front: str) -> None:
    gains: Any = {**LOOP, "damping": 20.0, "device_damping": 200.0}
    plain, filtered = (FRONTS[front](Drop(**gains, device_cutoff=cutoff)) for cutoff in (None, 50.0))
    assert plain != filtered


def test_front_ends_agree_on_random_devices(tmp_path: Path) -> None:
    random = np.random.default_rng(5)
    for lag in (0.0, 1e-4, 1e-3):
        values: Any = {"device": lagging(lag, tmp_path), "stiffness": 10.0 ** random.uniform(3.5, 4.9), "pulse": 0.0}
        values |= {"damping": random.uniform(30.0, 250.0), "delay": random.uniform(1e-4, 1.5e-3)}
        scene = Drop(**values)
        contact = FRONTS["stability"](scene)
        found, wall = diagnose(scene), judge(wall_loops(scene))
        (loop,) = Loop.of(scene.device, **{name: getattr(scene, name) for name in ("stiffness", "damping", "delay")})
        for other in (found.spectral_radius, wall.spectral_radius, FRONTS["compare"](scene), loop.spectral_radius):
            assert other == pytest.approx(contact, abs=1e-9)
        assert (stability_warning(scene) is not None) == (contact > 1.0) == unstable([scene])[0]


def test_the_lag_of_the_published_joystick_is_part_of_its_delay() -> None:
    assert Loop.of("ubc", stiffness=1.0, damping=1.0)[0].driver_lag == 0.0
    assert Device.load("ubc").driver.time_constant == pytest.approx(8e-5, rel=0.01)
    assert float(device_card(Drop()).walls[0].stiffness) == pytest.approx(10_173.0, abs=1.0)


@pytest.mark.parametrize(
    ("lag", "critical"), [(0.0, 54_339.185), (1e-4, 48_340.252), (1e-3, 21_503.423)]
)  # by events and eigenvalues of another program
def test_critical_stiffness_with_lagging_drivers(lag: float, critical: float) -> None:
    (loop,) = Loop.of("stage", stiffness=0.0, damping=140.9, delay=8e-4, driver_lag=lag)
    assert float(boundary_of(loop.array(), np.asarray(140.9))) == pytest.approx(critical, abs=2e-3)


def test_diagnose_has_the_filter_of_a_law_on_the_device() -> None:
    found = diagnose(Drop(stiffness=40_000.0, damping=20.0, device_damping=200.0, device_cutoff=50.0, pulse=0.0))
    assert found.spectral_radius > 1.0 and found.critical_stiffness < 40_000.0


@pytest.mark.parametrize("rate", [60.0, 1000.0, 8000.0])
def test_no_limit_is_infinite(rate: float) -> None:
    found = diagnose(stiffness=6000.0, damping=80.0, rate=rate, delay=0.0, mass=0.7)
    bound, text = found.critical_delay, json.dumps(found.as_json(), allow_nan=False)
    assert math.isfinite(bound) and not re.search(r"\b(any|inf|nan)\b", f"{found} {text}")
    assert ("more than" in str(found)) == bound.beyond == ("more_than" in str(found.as_json()["critical_delay"]))
    if bound.beyond:
        assert float(spectral_radius(6000.0, 80.0, period=1.0 / rate, delay=float(bound), mass=0.7)) < 1.0


class Notch(AxisLaw):
    """Spring through a notch at 60 Hz, and a damper."""

    stiffness: float = gain("stiffness", "N/m")
    damping: float = gain("damping", "N s/m")
    period: float = gain("period", "s")

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        w = math.tan(math.pi * 60.0 * gains.period)
        n = 1.0 + 1.4 * w + w * w
        b0, b1, b2 = (1.0 + 0.6 * w + w * w) / n, 2.0 * (w * w - 1.0) / n, (1.0 - 0.6 * w + w * w) / n
        one, two = (0.0 * x, 0.0 * x) if state is None else state
        y, inside = b0 * x + one, x < 0.0
        later = (b1 * x - b1 * y + two) * inside, (b2 * x - (1.0 - 1.4 * w + w * w) / n * y) * inside
        return -(gains.stiffness * y + gains.damping * v) * inside, later


def test_the_map_is_the_table_and_jumps_no_unstable_band() -> None:
    scene = Drop(period=1e-3, delay=8e-4, stiffness=40_000.0, damping=140.0, pulse=0.0, duration=0.03)
    swept = sweep_laws(scene, {"own": Notch}, "damping", [140.0], figure="critical_stiffness")
    critical = float(swept.columns()["critical_stiffness"][0])
    assert critical == pytest.approx(92_911.084, rel=1e-6)  # by eigenvalues of another program
    assert compare(scene, {"own": Notch}, phases=1).margins["own"]["critical_stiffness"] == pytest.approx(critical)
    for share in (0.1, 0.7, 0.999):
        softer = scene.replace(stiffness=share * critical)
        assert compare(softer, {"own": Notch}, phases=1).margins["own"]["spectral_radius"] < 1.0


def test_judge_is_the_name_of_one_function_and_a_stability_map_of_one_class() -> None:
    package = Path(maglev_mj.__file__).parent
    names = [
        (path.relative_to(package).as_posix(), name)
        for path in package.rglob("*.py")
        for name in re.findall(r"^ *(?:def|class) (\w+)", path.read_text("utf-8"), re.MULTILINE)
    ]
    judges = [(path, name) for path, name in names if name.strip("_").partition("_")[0] == "judge"]
    assert judges == [("theory/verdict.py", "judge")]
    assert [path for path, name in names if name == "StabilityMap"] == ["studies/stability_map.py"]
