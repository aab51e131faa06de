"""Every front end gives one verdict: nothing that was not judged is called stable."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from maglev_mj import AxisLaw, diagnose, gain, hold, param, stability
from maglev_mj.bridge.preflight import judge_change
from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.stability_check import stability_warning, wall_margin
from maglev_mj.session.margin import margin
from maglev_mj.studies.compare import compare
from tests.scenes.test_stability_check import GOOD


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


@pytest.mark.parametrize("seed", range(8))
def test_an_axis_that_is_not_judged_is_stable_nowhere(seed: int) -> None:
    random = np.random.default_rng(seed)
    axis = AXES[seed % len(AXES)]
    loop: Any = {"period": 1e-3, "delay": 8e-4, "stiffness": 10.0 ** random.uniform(3.5, 5.5), "damping": 80.0}
    edge, force = random.uniform(-2e-3, 0.0), random.uniform(0.01, 3.0)
    scene = Rough(**loop, rough=axis, below=edge, friction=force)
    verdict = stability(scene)
    assert verdict.stable is not True and (verdict.stable is False or verdict.unjudged == (axis,))
    assert margin(scene).stable is not True
    assert stability_warning(scene) is not None
    assert judge_change(scene, scene.body.inertia.tolist(), [], report=GOOD, anyway=False)[1]
    with pytest.raises(TypeError, match=r"no truth value: use \.stable"):
        bool(verdict)
    try:
        assert not diagnose(scene).stable
    except ParameterError as error:
        assert "not computed" in str(error)
    if axis == "z":
        scene = scene.replace(below=0.0)
        assert np.isnan(wall_margin(scene).spectral_radius)  # type: ignore[union-attr]
        assert np.isnan(compare(Drop(**loop), {"own": Coulomb}, phases=1).margins["own"]["spectral_radius"])


def test_an_edge_is_skipped_and_its_region_is_not() -> None:
    """A wall without a gains() method is smooth to both sides of its edge, and stays judged."""
    verdict = stability(Rough(stiffness=2000.0, friction=0.0))
    assert verdict.stable is True and len(verdict.jumps) and not verdict.unjudged
