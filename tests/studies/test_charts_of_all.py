"""Every chart of every result and command: what its head says, its units, its widths, and axes of the user's own."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from maglev_mj import AxisLaw, find_scene, gain, run, stability, sweep
from maglev_mj.cli import main
from maglev_mj.errors import DivergenceError, ParameterError
from maglev_mj.result import Result
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.results import RunResult, Variants
from maglev_mj.scenes.stick_slip import Pull
from maglev_mj.studies.compare import compare, sweep_laws
from maglev_mj.studies.designed_wall import ContactParameters, evaluate_wall
from maglev_mj.studies.diagnosis import diagnose
from maglev_mj.studies.drop_map import DropMapParameters, run_drop_map
from maglev_mj.studies.stability_map import StabilityParameters, run_stability
from maglev_mj.theory import WallRequirements, design_wall
from tests.cli.test_result import of_each_kind
from tests.studies.test_charts import complaints, figures

drawn = figures  # a fixture
pytestmark = pytest.mark.xdist_group("tabular")  # beside the results of tests/cli/test_result.py


class _Sticky(AxisLaw):
    """Wall with friction inside, which has no critical stiffness."""

    stiffness: float = gain("stiffness", "N/m")
    damping: float = gain("damping", "N s/m")

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        return -(gains.stiffness * x + gains.damping * v + np.sign(v)) * (x < 0.0)


def _diverged(**gains: Any) -> RunResult:
    with pytest.raises(DivergenceError) as caught:
        run(Drop(force_limit=0.0, **gains), plant="exact")
    partial: RunResult = caught.value.partial
    return partial


def _random() -> float:
    """Return a random factor of gains; seeded."""
    return float(np.exp(_RANDOM.uniform(-1.0, 1.0)))


_RANDOM = np.random.default_rng(11)
_SMALL: dict[str, Any] = {"grid": 3}
CASES: dict[str, Callable[[], Result]] = {
    "diverged": lambda: _diverged(stiffness=60_000.0),
    "trace of it": lambda: _diverged(stiffness=3e5, damping=0.0).trace,
    "one that diverged": lambda: Variants({"soft": run(Drop(), plant="exact"), "stiff": _diverged(stiffness=60_000.0)}),
    "rotary run": lambda: run(Pull(axis="ry", law="lugre"), plant="exact"),
    "box": lambda: run(find_scene("box")(), plant="exact"),
    "let-go": lambda: run(find_scene("let-go")(), plant="exact"),
    "unstable law": lambda: stability(Drop(stiffness=1e7 * _random(), damping=0.0)),
    "free motion": lambda: stability(Drop(stiffness=0.0, damping=0.0)),
    "one cell": lambda: sweep(Drop(), {"stiffness": [5000.0 * _random()]}, plant="exact"),
    "cells that diverged": lambda: sweep(Drop(force_limit=0.0), {"stiffness": [6e3, 6e4, 9e4]}, plant="exact"),
    "all cells diverged": lambda: sweep(Drop(force_limit=0.0), {"stiffness": [6e4, 9e4]}, plant="exact"),
    "choice": lambda: sweep(Pull(), {"law": ["stick-slip", "dahl"]}, plant="exact"),
    "rates": lambda: sweep(Drop(), {"rate": [200.0, 500.0, 1000.0], "height": [1e-3, 2e-3]}, plant="exact"),
    "heat map": lambda: sweep(
        Drop(), {"stiffness": [3e3, 5e3, 7e3, 9e3], "damping": [60.0, 80.0, 100.0, 120.0]}, plant="exact"
    ),
    "rotary sweep": lambda: sweep(Pull(), {"axis": ["rx", "rz"]}, plant="exact"),
    "law without a result": lambda: sweep_laws(
        Drop(period=1e-3, delay=8e-4, stiffness=4e4),
        {"pd": "pd", "own": _Sticky},
        values=[60.0, 80.0],
        figure="critical_stiffness",
    ),
    "laws": lambda: compare(Drop(), ["pd", "pulse"], phases=4),
    "rotary map": lambda: run_stability(StabilityParameters(inertia=1e-3 * _random(), **_SMALL)),
    "map without a stable wall": lambda: run_stability(
        StabilityParameters(delay=0.04, stiffness=(5e3, 9e3), damping=(10.0, 90.0), **_SMALL)
    ),
    "map of a device": lambda: run_stability(
        StabilityParameters(period=1e-3, delay=5e-4, mass=0.15, friction=0.6, quantum=1e-5, **_SMALL)
    ),
    "drops that do not settle": lambda: run_drop_map(
        DropMapParameters(stiffness=(2e4, 3e4), damping=(1.0, 5.0), **_SMALL)
    ),
    "rotary design": lambda: evaluate_wall(
        design_wall(WallRequirements(mass=None, inertia=(1e-3, 2e-3), delay=(1e-3, 2e-3))), ContactParameters()
    ),
    "rotary diagnosis": lambda: diagnose(
        stiffness=5.0 * _random(), damping=0.05, rate=1000.0, delay=1e-3, inertia=1e-3
    ),
    "unstable rotary diagnosis": lambda: diagnose(stiffness=80.0, damping=0.05, rate=500.0, delay=2e-3, inertia=1e-3),
    "diagnosed scene": lambda: diagnose("stick-slip"),
}
"""Results of random parameters, diverging runs, rotary axes, unstable and unjudged laws, and sweeps of one cell."""


@cache
def result_of(name: str) -> Any:
    """Return a result of `CASES`, or that of a class."""
    return CASES[name]() if name in CASES else next(x for kind, x in of_each_kind().items() if kind.__name__ == name)


KINDS = [
    *"RunResult Trace Phases Sweep Verdict Linearised ClosedLoop Recording Samples SegmentReport StabilityMap".split(),
    *"DropMap DesignResult FidelityResult Variants Comparison DeviceCard FaultRecord LawSweep Diagnosis".split(),
]
"""Classes of results with a chart; `test_every_kind_of_result_is_drawn` holds them to the package."""

RESULTS = [*KINDS, *CASES]


def charts_of(result: Any, **layout: Any) -> Iterator[tuple[str, Any]]:
    """Yield the name of each picture of a result, and its figure."""
    for name in result.pictures:
        if isinstance(result, Variants | RunResult) and name.endswith("_phases") and not _phases_of(result):
            continue
        yield name, result.plot(picture=name, **layout)


def _phases_of(result: Any) -> bool:
    return bool(isinstance(result, Variants) and (result.phases or result.bands))


def text_of(figure: Figure) -> str:
    """Return headline and details of a chart."""
    parts = [text.get_text() for text in figure.texts]
    return " ".join(" ".join(parts).replace("\N{NO-BREAK SPACE}", " ").split())


def test_every_kind_of_result_is_drawn() -> None:
    drawn = {kind.__name__ for kind, result in of_each_kind().items() if result.pictures}
    assert drawn == {*KINDS} and len(of_each_kind()) > len(KINDS)


HEAD = re.compile(r"(along|about) r?[xyz]\b|on all axes")
RATE, DELAY = re.compile(r"\d Hz"), re.compile(r"delay \d|without delay")
NONSENSE = re.compile(r"\b([Nn]a[Nn]|[Ii]nf|None)\b|(?<![.\d])\d{7,}|\de\+?0?[6-9]|\d and \d+ more| - N")
LINEAR = re.compile(r"\d (N/m|N s/m|kg|mm|mm/s|N)(?=[ ,;:.)]|$)(?! (m|s))")


@pytest.mark.parametrize("name", RESULTS)
def test_a_chart_says_scene_axis_rate_and_delay_and_no_impossible_number(name: str) -> None:
    result = result_of(name)
    for _, figure in charts_of(result):
        text = text_of(figure)
        assert HEAD.search(text) and RATE.search(text) and DELAY.search(text), text
        assert result.conditions.partition(" a")[0].split(" on all")[0] in text
        labels = " ".join(words for panel in figure.axes for words in panel.get_legend_handles_labels()[1])
        assert not NONSENSE.search(f"{text} {labels}"), text
        if "rotary" in name:
            assert not LINEAR.search(text), text
        assert complaints(figure) == []


@pytest.mark.parametrize("name", RESULTS)
def test_a_chart_as_wide_as_a_column_of_a_journal_can_be_read(name: str) -> None:
    for _, figure in charts_of(result_of(name), width=3.4, bare=True):
        assert figure.get_figwidth() == pytest.approx(3.4) and text_of(figure) == ""
        assert complaints(figure) == []


@pytest.mark.parametrize("name", RESULTS)
def test_a_chart_of_one_panel_is_drawn_into_axes_of_the_user(name: str) -> None:
    result = result_of(name)
    for picture, own in charts_of(result):
        panels = [panel for panel in own.axes if panel.axison and panel.get_label() not in ("<colorbar>", "<states>")]
        figure = Figure(figsize=(4.0, 4.0))
        ax = figure.subplots()
        if len(panels) > 1:
            with pytest.raises(ParameterError, match="ax must be omitted: this chart has several panels"):
                result.plot(picture=picture, ax=ax)
            continue
        assert result.plot(picture=picture, ax=ax) is figure and figure.get_size_inches().tolist() == [4.0, 4.0]
        assert len(ax.lines) == len(panels[0].lines) and ax.get_xlabel() == panels[0].get_xlabel()
        assert ax.get_xlabel() and not figure.texts and not figure.get_suptitle()


def test_axes_and_a_file_or_a_width_are_refused_together(tmp_path: Path) -> None:
    result: Any = result_of("Verdict")
    ax = Figure().subplots()
    for other in ({"path": tmp_path / "x.png"}, {"width": 3.4}):
        with pytest.raises(ParameterError, match="ax must be omitted with path or width"):
            result.plot(ax=ax, **other)
    with pytest.raises(ParameterError, match=r"ax must be matplotlib axes [(]got"):
        result.plot(ax=Figure())
    for width in (1.0, 30.0, math.nan):
        with pytest.raises(ParameterError, match="width must be"):
            result.plot(width=width)
    with pytest.raises(ParameterError, match="bare must be True or False"):
        result.plot(bare="yes")


def test_a_diverged_run_is_said_to_diverge_without_figures() -> None:
    assert result_of("diverged").headline == "Drop on 60000 N/m: diverged"
    assert result_of("one that diverged").headline.endswith("; stiff diverged")
    assert result_of("all cells diverged").headline == "Drop: all 2 cells diverged"
    assert "2 of 3 cells diverged" in result_of("cells that diverged").headline
    assert "N/m (pd); not computed for own" in result_of("law without a result").headline


def test_the_chart_of_a_scene_is_that_of_its_contact() -> None:
    for scene, axis, state in (("drop", "z", "contact"), ("press", "z", "contact"), ("stick-slip", "x", "stuck")):
        verdict = stability(scene)
        assert verdict.contact is not None
        loop, radius = verdict.contact
        assert loop.axes == (axis,) and state in loop.state and radius == pytest.approx(loop.spectral_radius)
        figure = verdict.plot()
        assert text_of(figure).startswith(f"{axis}: stable, spectral radius {radius:.3f} ")
        poles = next(line for line in figure.axes[0].lines if line.get_label() == "stable poles")
        assert np.hypot(*poles.get_data()).max() == pytest.approx(radius)
    unstable = stability(Drop(stiffness=12_000.0))
    assert unstable.contact is not None and unstable.contact[0] is unstable.loop


COMMANDS = {
    "drop": "drop --plant exact",
    "stability": "stability drop",
    "map": "map --grid 3",
    "diagnose": "diagnose --stiffness 500 --damping 1 --rate 200 --delay 0.005 --mass 0.15",
    "sweep": "sweep drop --vary height=1e-3:3e-3:3 --set plant=exact --workers 0",
    "compare": "compare drop --law pd --law half-sample --vary stiffness=4000,6000 --phases 2",
}


@pytest.mark.parametrize("command", COMMANDS.values(), ids=COMMANDS)
def test_options_of_charts_act_in_every_command(
    command: str, tmp_path: Path, drawn: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main([*command.split(), "--out", "charts", "--format", "pdf", "--width", "3.4", "--bare"]) == 0
    assert drawn and all(figure.get_figwidth() == pytest.approx(3.4) for figure in drawn)
    assert all(text_of(figure) == "" and complaints(figure) == [] for figure in drawn)
