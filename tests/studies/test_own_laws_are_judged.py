"""Integral action, estimators of your own, and names of scenes are taken by every front end."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any, ClassVar

import pytest

from maglev_mj import AxisLaw, critical_delay, device_card, diagnose, find_scene, gain, hold, judge, run, stability
from maglev_mj import largest_stable_stiffness as critical_stiffness
from maglev_mj.control import LowPass, Window
from maglev_mj.errors import ParameterError
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.stability_check import stability_warning, wall_loops
from maglev_mj.session.margin import margin
from maglev_mj.studies.compare import compare
from maglev_mj.theory.loop_array import spectral_radius
from tests.cells import unstable

LOOP: dict[str, Any] = {"period": 1e-3, "delay": 8e-4, "stiffness": 40_000.0, "damping": 80.0, "pulse": 0.0}


class Integral(AxisLaw):
    """Wall with integral action, of one integrator or two."""

    stiffness: float = gain("stiffness", "N/m")
    damping: float = gain("damping", "N s/m")
    period: float = gain("period", "s")
    integral: float = gain("integral action", "N/(m s)", default=2e6)

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        total = ((0.0 * x if state is None else state) + gains.period * x) * (x < 0.0)
        return -(gains.stiffness * x + gains.damping * v + gains.integral * total) * (x < 0.0), total


class Integrating(Drop):
    """Drop on it."""

    def laws(self) -> list[Any]:
        own: Any = {"stiffness": self.stiffness, "damping": self.damping, "period": self.period}
        return [Integral(axes="z", **own), hold(self, ["x", "y", "rx", "ry", "rz"])]


INTEGRATING = Integrating(**LOOP)


def finite(*results: Any) -> str:
    """Return results as text and JSON, without infinity."""
    parts = [f"{one} {json.dumps(one.as_json()) if hasattr(one, 'as_json') else ''}" for one in results]
    assert not re.search(r"\binf\b|Infinity", " ".join(parts), re.IGNORECASE)
    return parts[0]


def test_a_verdict_on_integral_action_has_the_gains_in_use() -> None:
    verdict = stability(INTEGRATING)
    assert (verdict.stiffness[2, 2], verdict.damping[2, 2]) == pytest.approx((40_000.0, 80.0))
    assert verdict.spectral_radius == pytest.approx(1.0081, abs=5e-5)
    finite(verdict)


def test_a_warning_of_integral_action_has_the_gains_in_use() -> None:
    assert "80 N s/m" in finite(stability_warning(INTEGRATING))


def test_a_diagnosis_of_integral_action_has_the_gains_in_use() -> None:
    found = diagnose(INTEGRATING)
    assert found.loop.gains == pytest.approx((40_000.0, 80.0))
    assert found.spectral_radius == pytest.approx(1.0081, abs=5e-5)
    finite(found)
    assert "no damping of the device's own makes it passive" in str(found.table())


def test_a_comparison_of_integral_action_has_the_gains_in_use() -> None:
    margins = compare(Drop(**LOOP), {"own": Integral}, phases=1).margins["own"]
    assert margins["stiffness"] == pytest.approx(40_000.0)
    assert margins["spectral_radius"] == pytest.approx(1.0081, abs=5e-5)


def test_the_margin_of_a_wall_with_integral_action_has_the_gains_in_use() -> None:
    wall = judge(wall_loops(INTEGRATING))
    assert wall.gains[0] == pytest.approx(40_000.0)
    finite(wall)


class Mine:
    """Estimator with the documented `linear`, without a name of the package."""

    def __init__(self, cutoff: float = 60.0) -> None:
        self.one = LowPass(cutoff=cutoff)

    def __call__(self, position: Any, state: Any, period: Any) -> Any:
        return self.one(position, state, period)

    def linear(self, period: Any) -> Any:
        return self.one.linear(period)


class Curved(Mine):
    """The same without it."""

    linear = property()


class Filtered(Drop):
    """Drop with an estimator."""

    estimator: ClassVar[Any] = LowPass(cutoff=60.0)

    def velocity_estimator(self) -> Any:
        return self.estimator


class Windowed(Filtered):
    """With a window."""

    estimator: ClassVar[Any] = Window(samples=3)


class Own(Filtered):
    """With one's own."""

    estimator: ClassVar[Any] = Mine()


def test_an_estimator_of_your_own_is_judged_as_that_of_the_package() -> None:
    values: Any
    for values in ({"stiffness": 3000.0, "damping": 40.0}, {"stiffness": 9000.0, "damping": 60.0}):
        one, own = (kind(pulse=0.0, **values) for kind in (Filtered, Own))
        assert stability(own).spectral_radius == pytest.approx(stability(one).spectral_radius, abs=1e-12)
        assert stability(own).stated and stability(own).held.lines == stability(one).held.lines
        found = diagnose(own)
        assert found.critical_stiffness == pytest.approx(diagnose(one).critical_stiffness, rel=1e-6)
        assert json.dumps(found.as_json()) and found.held.lines == stability(own).held.lines
        warnings = [str(stability_warning(scene)).replace(scene.name, "it") for scene in (one, own)]
        assert warnings[0] == warnings[1] and unstable([own]) == unstable([one])
        assert margin(own).words == margin(one).words
    for figure in (spectral_radius, critical_delay):
        assert figure(3000.0, 40.0, velocity=Mine()) == figure(3000.0, 40.0, velocity=LowPass(cutoff=60.0))
    assert critical_stiffness(40.0, velocity=Mine()) == pytest.approx(
        critical_stiffness(40.0, velocity=LowPass(cutoff=60.0))
    )
    window = Window(samples=3)
    found = diagnose(Windowed(pulse=0.0))
    assert found.critical_stiffness == pytest.approx(float(critical_stiffness(80.0, velocity=window)), rel=1e-9)
    with pytest.raises(ParameterError, match=r"velocity must be a linear estimator: .*, or your own with linear"):
        spectral_radius(3000.0, 40.0, velocity=Curved())


def test_a_scene_is_judged_by_instance_class_name_and_file(tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text("from maglev_mj import find_scene\n\n\nclass Mine(find_scene('drop')):\n    'Drop.'\n")
    one = stability(Drop())
    for scene in ("drop", find_scene("drop"), str(file), file, f"{file}:Mine"):
        assert stability(scene).as_json() == one.as_json()
    assert stability("drop", delay=0.003).spectral_radius == stability(Drop(), delay=0.003).spectral_radius
    for call in (stability, device_card, run):
        with pytest.raises(ParameterError, match=r"scene must be one of .*'drp'.; did you mean drop"):
            call("drp")
        with pytest.raises(ParameterError, match=r"scene must be a Scene, or the name of one such as 'drop' \(got 3\)"):
            call(3)  # type: ignore[arg-type]
