"""Units along each of the six axes, in every table, chart, slider and data frame."""

from __future__ import annotations

import re
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from maglev_mj import Hold, Scene, Session, figure, identify, param, record_run, run, run_phases, sweep
from maglev_mj.frames import AXES, unit_of
from maglev_mj.scenes.pictures import series, spread, stick_slip
from maglev_mj.scenes.results import Variants
from maglev_mj.scenes.stick_slip import Pull
from maglev_mj.session import Snapshot
from maglev_mj.session.margin import STABILITY
from maglev_mj.session.snapshot import COLUMNS
from maglev_mj.theory.verdict import stability
from maglev_mj.views.page import panel as page_plots
from maglev_mj.views.page.panel import control
from maglev_mj.views.readings import Charts
from maglev_mj.views.window import screen as window_plots
from maglev_mj.views.window.screen import number_rows
from tests.studies.test_charts import details
from tests.sweeps import sweep as cases

SHORT: dict[str, Any] = {"duration": 0.02}
UNIT = re.compile(r"(?<![\w/.])(N m s/rad|k?N m/m?rad|m?N m|[mµ]?rad(/s)?|N s/m|k?N/m+|[km]?N|[mµ]?m(/s)?)(?![\w/])")


def wrong(text: str, axis: str) -> list[str]:
    """Return the units of the other kind of axis in a text."""
    units = [match[0] for match in UNIT.finditer(text)]
    return [unit for unit in units if ("rad" in unit or "N m" in unit) != axis.startswith("r")]


class Gui:
    """Widgets of a page, as texts."""

    def __init__(self) -> None:
        self.texts: list[str] = []

    def __getattr__(self, _: str) -> Any:
        def add(label: str, *_: Any, hint: str = "", **__: Any) -> Any:
            self.texts += [label.replace("\N{NO-BREAK SPACE}", " "), hint]
            return SimpleNamespace(on_update=lambda function: None, value=0.0, min=0.0, max=1.0)

        return add


class PlotGui:
    """Widgets of a page's plots."""

    def __init__(self) -> None:
        self.plots: list[Any] = []

    def add_dropdown(self, *_: Any, initial_value: str, **__: Any) -> Any:
        return SimpleNamespace(value=initial_value)

    def add_html(self, content: str) -> Any:
        self.plots.append(SimpleNamespace(content=content))
        return self.plots[-1]


def page_curves(snapshot: Any) -> str:
    """Return the texts of the page's plots."""
    gui = PlotGui()
    shown = page_plots.Plots(gui, snapshot.scene)
    STABILITY.of(snapshot, wait=True)
    shown.show(snapshot)
    return "\n".join(re.sub("<[^>]*>", " ", plot.content) for plot in gui.plots)


def window_curves(snapshot: Any) -> str:
    """Return the texts of the window's plots."""
    shown = window_plots.WindowPlots()
    STABILITY.of(snapshot, wait=True)
    return "\n".join(f"{one.title}\n{one.xlabel}" for one in shown.update(snapshot))


def texts_of(drawn: Any) -> Iterator[str]:
    yield from (" ".join(drawn.get_suptitle().split()), details(drawn))
    for panel in drawn.axes:
        yield from (panel.get_title("left"), panel.get_xlabel(), panel.get_ylabel())
        yield from (text.get_text() for text in panel.texts)
        if panel.get_legend() is not None:
            yield from (text.get_text() for text in panel.get_legend().get_texts())


@pytest.mark.parametrize("axis", cases(AXES, every=5))
def test_all_outputs_of_a_scene_have_the_units_of_its_axis(axis: str) -> None:
    whole = Pull(axis=axis)
    scene = whole.replace(**SHORT)
    result, phases = run(scene, plant="exact"), run_phases(scene, 2, plant="exact")
    values = [0.9 * scene.stiffness, scene.stiffness]
    swept = sweep(scene, {"stiffness": values, "breakaway": [scene.breakaway, 1.1 * scene.breakaway]}, plant="exact")
    both = Variants({"a": result}, {"a": phases}, gap=1e-6)
    gui, session = Gui(), Session(scene)
    for one in scene.parameters():
        control(gui, one, scene, lambda *_: None)
    arrows = "arrows", "hand", "device"  # along x, y and z in any scene
    said = {
        "run": str(both.table()),
        "sweep": str(swept.table()),
        "stability": f"{scene.describe()}\n{stability(scene).table()}",
        "page": "\n".join(gui.texts),
        "window": "\n".join(map(" ".join, [row for row in number_rows(session.snapshot()) if row[0] not in arrows])),
        "window's plots": window_curves(session.snapshot()),
        "page's plots": page_curves(session.snapshot()),
        "identified": str(identify(record_run(whole, plant="exact").segments[0]).table()),
        "tables": "\n".join(str(found.table()) for found in (result, phases)),
        "frames": "\n".join(f" {unit} " for found in (result, phases, swept) for unit in found.units.values()),
        "figure 8": "\n".join(texts_of(stick_slip(both))),
        "plots": "\n".join(text for found in (result, phases, swept) for text in texts_of(found.plot())),
        "spread": "\n".join(texts_of(spread(both))),
        "series": "\n".join(texts_of(series(both))),
    }
    plots = Charts(100).of(session.snapshot(), AXES.index(axis))
    assert all(len(re.findall(r"\[.+?\]", title[0][0] + foot + side)) == 2 for title, *_, foot, side in plots), plots
    session.close()
    assert {name: wrong(text, axis) for name, text in said.items() if wrong(text, axis)} == {}
    other = "x" if axis.startswith("r") else "rx"
    assert all(wrong(text, other) for text in said.values())
    assert swept.units["stiffness"] == unit_of("N/m", axis) and result.units["position"] == unit_of("m", axis)


def test_a_sweep_over_axes_names_both_units() -> None:
    swept = sweep(Pull(**SHORT), {"axis": ["x", "rx"]}, plant="exact")
    assert swept.units["peak_speed"] == "m/s or rad/s" and swept.units["stick_time"] == "s"


@pytest.mark.parametrize("axis", ["x", "rz"])
def test_parameters_not_along_the_axis_keep_their_unit(axis: str) -> None:
    class Own(Scene):
        """Own."""

        shown_axis = axis
        figures = ("final_position", figure("N", "of all axes")(lambda result: 1.0))
        place: float = param("place of a wall along x", "m", default=0.002)
        force: float = param("force along x", "N", default=1.0)
        duration: float = param("simulated time", "s", default=0.02)

        def laws(self) -> list[Any]:
            return [Hold(stiffness=np.full(6, 1.0), damping=np.full(6, 0.1))]

    result = run(Own(), plant="exact")
    head, _, table = str(Variants({"a": result}).table()).partition("\n\n")
    assert "place 2 mm," in head and "force 1 N," in head
    units = {row[0]: row[2] for row in result.table().rows}
    assert units == {"final position": unit_of("mm", axis), "<lambda>": "N"} and unit_of("mm", axis) in table


def test_unit_prefixes_are_the_same_for_rotations() -> None:
    larger = {"N/mm": "N m/mrad", "kN/m": "kN m/rad", "mm": "mrad", "µm": "µrad", "mN": "mN m"}
    assert {unit: unit_of(unit, "rz") for unit in larger} == larger  # one factor serves both


def test_a_thinned_chart_ends_with_the_newest_sample() -> None:
    rows = np.zeros((401, COLUMNS))
    rows[:, 0] = rows[:, 1] = np.arange(401) * 0.005
    line = Charts(200).of(Snapshot(scene=Pull(axis="x"), history=rows), 0)[0].lines[-1]
    assert np.asarray(line.x)[-1] == 0.0 and np.asarray(line.y)[-1] == 1e3 * rows[-1, 1] and np.size(line.x) <= 200


@pytest.mark.parametrize(("samples", "across"), [(0, 0.2), (61, 0.5), (402, 2.0)])
def test_the_time_axis_grows_with_the_elapsed_time(samples: int, across: float) -> None:
    rows = np.zeros((samples, COLUMNS))
    rows[:, 0] = 7.0 + np.arange(samples) * 0.005
    chart = Charts(200).of(Snapshot(scene=Pull(axis="x"), history=rows), 0)[0]
    assert chart.across == pytest.approx((-across, 0.0))
