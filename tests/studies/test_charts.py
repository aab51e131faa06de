"""Charts are readable at page width, in every format."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import zlib
from collections.abc import Iterator
from contextlib import nullcontext, suppress
from dataclasses import replace
from importlib import import_module
from inspect import isfunction, unwrap
from pathlib import Path
from pkgutil import walk_packages
from typing import Any

import numpy as np
import pytest
from cycler import cycler
from matplotlib import rc_context
from matplotlib.text import Text

import maglev_mj
from maglev_mj.analysis.pictures import staircases, whole_run
from maglev_mj.bridge.fault import load_fault
from maglev_mj.bridge.pictures import last_cycles
from maglev_mj.cli import main
from maglev_mj.errors import ParameterError
from maglev_mj.pictures import FORMATS, ChartPanel, broken, new_figure, new_grid, save, small_multiples
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.free import LetGo, SixAxes
from maglev_mj.scenes.interactive import Box
from maglev_mj.scenes.run import run
from maglev_mj.studies.pictures import _even
from maglev_mj.studies.stability_map import StabilityParameters, run_stability
from maglev_mj.studies.sweep import sweep
from tests.analysis.test_analysis import analysed, recorded
from tests.bridge.test_black_box import flown
from tests.views.test_colours import PAPER, contrast
from work_precision import WorkPoint, work_precision

COLUMN = 830 / 96
"""Width of a page's column [inch]."""
SMALLEST = 8.0
"""Size of the smallest words there [pt]."""


HEAD = ["Headline of 3 N"]


def details(figure: Any) -> str:
    """Return the lines below a headline."""
    return str(figure.texts[1].get_text()).replace("\N{NO-BREAK SPACE}", " ").replace("\n", " ")


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Return a list that collects figures instead of files."""
    from matplotlib.figure import Figure

    drawn: list[Any] = []
    monkeypatch.setattr("maglev_mj.pictures.atomic_path", nullcontext)
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: drawn.append(figure))
    return drawn


def apart(boxes: list[Any]) -> bool:
    """Return True if no boxes overlap beyond rounding."""
    return not any(
        min(one.x1, other.x1) - max(one.x0, other.x0) > 1.0 and min(one.y1, other.y1) - max(one.y0, other.y0) > 1.0
        for index, one in enumerate(boxes)
        for other in boxes[:index]
    )


def numbers_of(axis: Any) -> list[Any]:
    """Return the numbers of an axis that are seen."""
    low, high = sorted(axis.get_view_interval())
    ticks = [tick for tick in [*axis.get_major_ticks(), *axis.get_minor_ticks()] if low <= tick.get_loc() <= high]
    return [tick.label1 for tick in ticks if tick.label1.get_visible() and tick.label1.get_text()]


def legends_of(figure: Any) -> list[Any]:
    """Return the legends, also that in the empty cell of a grid."""
    found = [*figure.legends, *(panel.get_legend() for panel in figure.axes)]
    return [legend for legend in found if legend is not None]


def words_of(figure: Any) -> list[Any]:
    """Return the texts that are seen."""
    from matplotlib.axis import Tick
    from matplotlib.text import Text

    panels = [panel for panel in figure.axes if panel.axison]
    hidden = {text for panel in figure.axes if not panel.axison for text in panel.findobj(Text)}
    hidden |= {text for tick in figure.findobj(Tick) for text in tick.findobj(Text)}
    texts = [text for text in figure.findobj(Text) if text.get_visible() and text.get_text().strip()]
    numbers = [text for panel in panels for axis in (panel.xaxis, panel.yaxis) for text in numbers_of(axis)]
    return [text for text in texts if text not in hidden] + numbers


def complaints(figure: Any) -> list[str]:
    """Return the unreadable parts of a figure."""
    from matplotlib.colors import to_rgb

    figure.draw_without_rendering()
    renderer = figure.canvas.get_renderer()
    scale, whole, found = min(COLUMN / figure.get_figwidth(), 1.0), figure.bbox, []
    panels = [panel for panel in figure.axes if panel.axison]
    for text in words_of(figure):
        box = text.get_window_extent(renderer)
        if text.get_size() * scale < SMALLEST:
            found.append(f"{text.get_text()!r} has {text.get_size() * scale:.1f} pt")
        if min(box.x0, box.y0, whole.x1 - box.x1, whole.y1 - box.y1) < -1.0:
            found.append(f"{text.get_text()!r} leaves the picture")
        if contrast(to_rgb(text.get_color()), PAPER) < 4.5:
            found.append(f"{text.get_text()!r} is pale")
    legends = legends_of(figure)
    for legend in legends:
        box = legend.get_window_extent(renderer)
        inside = [panel.get_title(loc="left") for panel in panels if not apart([box, panel.bbox])]
        found += [f"a legend lies on the panel {title!r}" for title in inside]
    blocks = [legend.get_window_extent(renderer) for legend in legends]
    for panel in panels:
        names = [panel.xaxis.label, panel.yaxis.label, panel._left_title]
        blocks += [text.get_window_extent(renderer) for text in names if text.get_text()]
        numbers = numbers_of(panel.xaxis) + numbers_of(panel.yaxis)
        blocks += [text.get_window_extent(renderer).padded(3.0, 0.0) for text in numbers]
    if not apart(blocks):
        found.append("names, numbers, titles or legends lie on one another")
    return found


COMMANDS = {
    "drop": "drop --plant exact --phase 0.56 --phases 2",
    "press, own hand": "press --plant exact --hits 2 --hand 0.554,6.45,135.5,25.25,1000.5 --force-limit 60.5",
    "stick-slip": "stick-slip --plant exact",
    "scene": "run joystick --phases 2",
    "stability, hand": "map --grid 6 --delay 0 --hand arm",
    "card": "card --rate 1000 --delay 0.0005",
    "sweep": "sweep drop --vary height=1e-3:3e-3:3 --vary damping=60,80 --set plant=exact --workers 0",
    "sweep, choice": "sweep stick-slip --vary law=stick-slip,elasto-plastic,dahl,lugre,kikuuwe --workers 0",
    "fidelity": "fidelity let-go --duration 0.01 --phases 1 --around 0",
    "design": "design --mass 0.63:0.77 --delay 0.001:0.002",
}


DRAWN = {"press, own hand", "stability, hand", "fidelity"}
"""Charts of the gate, one of each kind, beside those below."""


@pytest.mark.parametrize(
    "command",
    [pytest.param(line, id=name, marks=[pytest.mark.study] * (name not in DRAWN)) for name, line in COMMANDS.items()],
)
def test_a_chart_of_a_command_can_be_read(
    command: str, tmp_path: Path, figures: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # a sweep keeps its cells there
    assert main([*command.split(), "--out", str(tmp_path)]) == 0
    assert figures and [complaints(figure) for figure in figures] == [[]] * len(figures)


def test_a_curve_of_many_points_is_small_in_an_svg(tmp_path: Path) -> None:
    for points, pixels in ((12_000, True), (500, False)):
        figure, (panel,) = new_figure(HEAD, 1, 1, 3.0)
        panel.plot(np.random.default_rng(1).normal(size=points), ".")
        text = save(figure, tmp_path / "noise.svg").read_text()
        assert len(text) < 300_000 and ("image/png" in text) is pixels


def test_a_curve_has_a_gap_at_a_jump_and_none_at_a_slope() -> None:
    x = np.linspace(0.0, 1.0, 21)
    gaps = np.isnan(broken(x, np.where(x > 0.42, 2.0, 0.0) + x)[1])
    assert np.flatnonzero(gaps).tolist() == [9]
    rounding = 40.4 + 1e-13 * np.random.default_rng(3).normal(size=21)
    for slope in (x, x**2, np.sin(6.0 * x), np.zeros(21), rounding):
        assert not np.isnan(broken(x, slope)[1]).any()


def test_a_run_outside_the_range_of_motion_is_drawn_up_to_it() -> None:
    figure = run(LetGo(), plant="exact").plot()
    height, speed = figure.axes
    low, high = height.get_ylim()
    assert -6.0 < low < -4.5 < high < 6.0
    (left,) = [patch.get_x() for patch in speed.patches]
    assert left == pytest.approx(np.sqrt(2.0 * 0.0045 / 9.81), abs=1e-3)  # the fall to its stop
    names = [text.get_text() for text in figure.legends[0].get_texts()]
    assert names == ["range of motion, ±4.5 mm", "outside the range"]
    assert complaints(figure) == []


def test_the_chart_of_a_box_has_its_walls_and_a_free_scene_all_axes() -> None:
    upper = run(Box(), plant="exact").plot().axes[0]
    edges = sorted((patch.get_y(), patch.get_y() + patch.get_height()) for patch in upper.patches)
    assert edges[0][1] == pytest.approx(-3.0) and edges[1][0] == pytest.approx(3.0)
    figure = run(SixAxes(), plant="exact").plot()
    assert [panel.get_ylabel() for panel in figure.axes] == [
        "position (mm)",
        "rotation (mrad)",
        "force (N)",
        "torque (N m)",
    ]
    assert complaints(figure) == []


def test_short_logarithmic_axes_have_plain_numbers(tmp_path: Path, figures: list[Any]) -> None:
    x = np.array([0.05, 0.3, 5.0])
    curves = [("curve", x, 1e5 * x**4)]
    panel = ChartPanel(title="title", labels=("x", "y"), curves=curves, log="xy")
    small_multiples(HEAD, [panel], tmp_path / "short.png")
    figures[0].canvas.draw()
    axis = figures[0].axes[0]
    assert {"0.1", "0.2", "0.5", "1", "2"} <= {text.get_text() for text in numbers_of(axis.xaxis)}
    assert all("10^" in text.get_text() for text in numbers_of(axis.yaxis))


def test_a_sweep_over_two_even_parameters_is_heat_maps_of_its_cells() -> None:
    found = sweep(Drop(), {"height": [1e-3, 2e-3, 3e-3, 4e-3], "damping": [50.0, 60.0, 70.0, 80.0]}, plant="exact")
    figure = found.plot()
    assert complaints(figure) == []
    image = figure.axes[0].images[0]
    assert np.asarray(image.get_array()) == pytest.approx(1e3 * found.figure("penetration").T)
    assert image.get_extent() == pytest.approx([*figure.axes[0].get_xlim(), 45.0, 85.0])
    assert figure.axes[0].get_ylim() == (45.0, 85.0)
    assert figure.axes[0].get_yticks().tolist() == [50.0, 60.0, 70.0, 80.0]
    title = details(figure)
    assert (
        title.startswith("drop along z, 200 Hz, delay 1.5 ms, plant exact, stiffness 6000 N/m")
        and "damping" not in title
    )
    assert not figure.legends
    uneven: list[list[Any]] = [[1, 2, 3], [1.0, 2.0, 4.0, 8.0], [4, 3, 2, 1], [True, False, True, False], [*"abcd"]]
    assert [_even(values) for values in ([1.0, 2.0, 3.0, 4.0], *uneven)] == [True] + [False] * 5


def test_missing_values_of_a_sweep_are_named() -> None:
    stiff = {"stiffness": [4000.0, 6000.0, 20000.0]}
    figure = sweep(Drop(force_limit=0.0), {**stiff, "damping": [80.0]}, plant="exact").plot()
    named = {panel.get_title(loc="left"): [text.get_text() for text in panel.texts] for panel in figure.axes}
    assert named["settling time (ms)"] == ["does not settle"] and not named["peak force (N)"]
    even = {"stiffness": [4000.0, 10000.0, 16000.0, 22000.0], "damping": [20.0, 60.0, 100.0, 140.0]}
    (legend,) = sweep(Drop(), even, plant="exact").plot().legends
    assert [text.get_text() for text in legend.get_texts()] == ["diverged or does not settle"]


def test_a_sweep_of_a_scene_without_figures_has_no_picture() -> None:
    found = sweep("joystick", {"stiffness": [1000.0, 2000.0]}, plant="exact")
    with pytest.raises(ParameterError, match="figures must include a scalar to draw a chart: joystick has none"):
        found.plot()


def test_each_value_of_a_choice_has_rows_of_its_own() -> None:
    found = sweep(Drop(), {"plant": ["exact", "mujoco"], "height": [1e-3, 2e-3]})
    table = found.table()
    assert table.head[:2] == ("", "plant")
    for index, plant in enumerate(("exact", "mujoco")):
        row = next(row for row in table.rows if row[:2] == ("penetration", plant))
        assert row[3] == pytest.approx(1e3 * np.median(found.figure("penetration")[index])) and row[-1] == 2
    assert [text.get_text() for text in found.plot().axes[0].get_xticklabels()] == ["exact", "mujoco"]


def test_the_gains_in_use_are_marked_where_the_map_has_them() -> None:
    for stiffness, marked in (((500.0, 9000.0), 1), ((500.0, 5000.0), 0)):
        figure = run_stability(StabilityParameters(stiffness=stiffness, damping=(10.0, 120.0), grid=2)).plot()
        labels = figure.axes[0].get_legend_handles_labels()[1]
        assert sum(label == "scene drop: 6000 N/m, 80 N s/m" for label in labels) == marked
        assert "stiffest stable wall (theory)" not in labels  # at 10 173 N/m


@pytest.mark.parametrize("kind", ["press", "stick-slip"])
def test_charts_and_results_of_a_recording(
    kind: str, tmp_path: Path, figures: list[Any], capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "run.maglev"
    assert main([kind, "--plant", "exact", "--record", str(path)]) == 0
    capsys.readouterr()
    assert main(["analyse", str(path), "--json", str(tmp_path / "run.json"), "--out", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert "bit-identical" in said and max(map(len, said.splitlines())) <= 110
    assert [complaints(figure) for figure in figures] == [[], []]
    (segment,) = json.loads((tmp_path / "run.json").read_text())["segments"]
    assert segment["comparison"]["same"] is True
    assert segment["recorded"] == segment["simulated"] | {"friction": segment["recorded"]["friction"]}
    if kind == "stick-slip":
        assert "analysis_run.png" in said and "analysis_sticks.png" in said
        assert [len(panel.lines) for panel in figures[1].axes] == [2]  # no panel for an axis without friction
        assert segment["recorded"]["friction"]["x"]["slips"] == 1
        assert "no walls" in said and "no wall contact on x: contact chart omitted" in said
    else:
        assert "analysis_run.png" in said and "analysis_contact.png" in said
        assert len(segment["recorded"]["faces"][0]["contacts"]) == 5
        assert "chart of stick positions omitted" in said


def test_the_chart_of_a_recording_that_differs_can_be_read() -> None:
    segment = recorded(Drop())
    other = segment.replace(position=segment.position + 1e-5)
    assert complaints(whole_run(analysed(other), 2)) == []


@pytest.mark.parametrize(("count", "quiet"), [(6, 0), (4, 3)])
def test_staircases_have_a_panel_for_each_axis_that_moves(count: int, quiet: int) -> None:
    time, position = np.linspace(0.0, 1.0, 50), np.random.default_rng(1).normal(size=(50, 6)) * 1e-3
    position[:, 1 : 1 + quiet] *= 1e-9  # rounding
    said = {axis: "3 slips, resting places 0.73 to 2.3 mrad apart" for axis in range(count)}
    figure = staircases(HEAD, time, position, position, said)
    out = ["y", "z", "rx"][: min(quiet, count - 1)]
    assert sum(panel.axison for panel in figure.axes) == count - len(out) and complaints(figure) == []
    assert details(figure) == (f"not shown (constant): {', '.join(out)}" if out else "")


def test_flat_panels_are_left_out_and_numbers_stand_below_the_lowest() -> None:
    figure, shown = new_grid(HEAD, {"pose": ([[np.nan, np.nan]], "mm"), "path": ([[2.0, 2.001]], "mm")}, "time (s)")
    assert [*shown] == ["pose"] and complaints(figure) == []  # one panel, where all are flat
    for force, panels in ((1e-16, 1), (5e-4, 1), (2e-3, 2)):  # rounding fills no panel
        _, shown = new_grid(
            HEAD, {"pose": ([[0.0, 0.0]], "mm"), "force": ([[-force, force]], "N")}, "time (s)", always="pose"
        )
        assert len(shown) == panels and all(float(np.ptp(panel.get_ylim())) >= 0.02 for panel in shown.values())
    named = {name: ([[np.nan, 1.0, 2.0]], "mm") for name in "abcde"}
    figure, shown = new_grid(HEAD, named | {"time": ([[100.0, 100.05]], "ms")}, "time (s)")
    assert [*shown] == list("abcde") and details(figure) == "not shown (constant): time"
    lowest = [name for name, panel in shown.items() if panel.xaxis.get_major_ticks()[0].label1.get_visible()]
    assert lowest == list("cde")  # numbers where no panel is below


def test_the_chart_of_a_fault_can_be_read(tmp_path: Path) -> None:
    _, error = flown(tmp_path)
    assert error.path is not None
    record = load_fault(error.path)
    long = replace(
        record, message="a word or two " * 20, faults="COIL_NOT_FOLLOWING FLOTOR_OVERSPEED SENSOR_FROZEN " * 2
    )
    assert complaints(last_cycles(long)) == []


def test_panels_of_curves_can_be_read(figures: list[Any]) -> None:
    x = np.geomspace(1e-3, 0.22, 20)
    names = [f"a rather long name of curve {index}" for index in range(8)]
    panels = [
        ChartPanel(
            title=f"panel {index} with a title that is\nas long as two lines",
            labels=("a quantity (unit)", "another quantity (unit)"),
            curves=[(name, x, x * (place + 1)) for place, name in enumerate(names)],
            log=("", "x", "xy")[index],
            outside=[x > 0.1] * 8 if index == 2 else (),
        )
        for index in range(3)
    ]
    small_multiples(HEAD, panels, Path("unused.png"))
    (figure,) = figures
    assert complaints(figure) == [] and len(legends_of(figure)) == 1


def test_speed_and_accuracy_can_be_read(figures: list[Any]) -> None:
    points = [
        WorkPoint("exact", "exact plant", 1e-3, 0.0),
        WorkPoint("exact, dearer", "exact plant", 2e-3, 1e-12),
        WorkPoint("rk4", "RK4", 3e-3, 1e-10),
        WorkPoint("many", "many at once", 1e-5, 1e-12, many=True),
        WorkPoint("cheap", "a cheap way", 5e-4, 1e-3, label="a cheap way"),
        *(
            WorkPoint(f"euler {step}", "raw Euler", 2e-6 / step, step, label=f"raw Euler, {step:g}", joined=True)
            for step in (1e-3, 9e-4, 8e-4, 1e-4)
        ),
    ]
    work_precision("drop: on a wall, with a braking pulse", points, "exact plant", Path("unused.png"))
    (figure,) = figures
    assert complaints(figure) == []
    (panel,) = figure.axes
    renderer = figure.canvas.get_renderer()
    labels = [text for text in panel.texts if text.get_text() in {point.label for point in points}]
    boxes = [Text.get_window_extent(text, renderer) for text in labels]
    assert len(boxes) == 5 and apart(boxes)
    dots = [panel.transData.transform(dot) for line in panel.lines for dot in line.get_xydata()[:1]]
    assert not any(box.contains(*dot) for box in boxes for dot in dots)
    assert all(panel.bbox.contains(*corner) for box in boxes for corner in box.corners())
    # a row for the cheapest of each kind that is exact enough; bold where nothing beats it
    rows = {label.get_text(): label.get_fontweight() for label in panel.get_yticklabels()[-3:]}
    assert rows == {"many at once": "bold", "exact plant": "bold", "RK4": "normal"}
    assert {"0.01", "1", "3"} <= {text.get_text() for text in panel.texts}  # relative to one exact plant


def test_what_cannot_be_read_is_found() -> None:
    figure, (left, right) = new_figure(HEAD, 1, 2, 3.0)
    left.plot([0.0, 1.0], [0.0, 1.0], label="curve")
    left.legend(loc="center")
    left.set_title("a title so long that it runs far into that of the next panel", loc="left")
    right.set_xlabel("small", fontsize=7.0)
    right.set_ylabel("pale", color="0.7")
    right.set_title("the next panel", loc="left")
    figure.text(0.9, 0.5, "a word that leaves the picture at its right side")
    said = "\n".join(complaints(figure))
    assert all(
        words in said for words in ("7.0 pt", "'pale' is pale", "leaves the picture", "a legend lies", "on one another")
    )


def test_pictures_have_the_format_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    begins = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml"}
    figure, _ = new_figure(HEAD, 1, 1, 1.0)
    for kind in FORMATS:
        assert save(figure, tmp_path / f"flat.{kind}").read_bytes().startswith(begins[kind])
    assert main(["stick-slip", "--plant", "exact", "--out", str(tmp_path / "new"), "--format", "svg"]) == 0
    (path,) = (tmp_path / "new").iterdir()
    assert path.name == "stick_slip.svg" and path.read_bytes().startswith(begins["svg"])
    assert f"wrote {path}" in capsys.readouterr().out


SETTINGS: dict[str, Any] = {
    "text.usetex": True,  # there is no LaTeX
    "font.size": 30.0,
    "font.family": "cursive",
    "axes.facecolor": "red",
    "axes.prop_cycle": cycler(color=["yellow"]),
    "axes.formatter.use_locale": True,
    "lines.linewidth": 9.0,
    "legend.frameon": True,
    "figure.dpi": 30.0,
    "figure.constrained_layout.use": False,
    "savefig.transparent": True,
    "savefig.bbox": "tight",
    "savefig.format": "svg",
    "pdf.fonttype": 3,
    "path.sketch": (3.0, 50.0, 9.0),
    "mathtext.fontset": "cm",
}
"""Settings of a user for other figures, each of which would show in a chart."""


def charts() -> dict[str, Any]:
    """Return functions that draw charts of the package, by name."""
    modules = [
        import_module(one.name)
        for one in walk_packages(maglev_mj.__path__, "maglev_mj.")
        if one.name.rpartition(".")[2] in ("pictures", "diagnosis_picture")
    ]
    found = {
        f"{module.__name__}.{name}": part
        for module in modules
        for name, part in vars(module).items()
        if isfunction(part) and part.__module__ == module.__name__ and {"new_figure", "new_grid"} & {*names_in(part)}
    }
    return {name: part for name, part in found.items() if not name.rpartition(".")[2].startswith("_")}


def names_in(function: Any, depth: int = 3) -> Iterator[str]:
    """Yield the names that a function uses, and those of its module's functions that it calls."""
    function = unwrap(function)
    for name in function.__code__.co_names:
        yield name
        if depth and isfunction(part := function.__globals__.get(name)) and part.__module__ == function.__module__:
            yield from names_in(part, depth - 1)


def test_every_chart_has_a_style_of_its_own() -> None:
    found = charts()
    assert len(found) > 20 and not [name for name, part in found.items() if not hasattr(part, "__wrapped__")]


@pytest.fixture(scope="module")
def results() -> dict[str, Any]:
    small = StabilityParameters(stiffness=(500.0, 9000.0), damping=(10.0, 120.0), grid=2)
    return {"time series": run(Drop(), plant="exact"), "map": run_stability(small)}


def settings() -> dict[str, Any]:
    """Return the settings as they are; asking for the backend would choose one."""
    import matplotlib

    raw: dict[str, Any] = matplotlib.rcParams  # type: ignore[assignment]
    return dict(dict.items(raw))


@pytest.mark.parametrize("kind", ["time series", "map"])
def test_settings_of_the_user_change_no_chart_and_charts_change_no_setting(
    kind: str, results: Any, tmp_path: Path
) -> None:
    result = results[kind]
    plain = result.plot(tmp_path / "plain.png").read_bytes()
    with rc_context(SETTINGS):  # type: ignore[arg-type]
        before, styled = settings(), result.plot(tmp_path / "styled.png").read_bytes()
        assert settings() == before and styled == plain


@pytest.mark.parametrize("by_hand", [False, True])
def test_fonts_of_a_pdf_are_those_that_publishers_accept(by_hand: bool, results: Any, tmp_path: Path) -> None:
    path = tmp_path / "chart.pdf"
    with rc_context(SETTINGS):  # type: ignore[arg-type]
        if by_hand:
            results["map"].plot().savefig(path)
        else:
            results["map"].plot(path)
    data = unpacked(path.read_bytes())
    assert b"/Type3" not in data and b"/CIDFontType2" in data


def unpacked(data: bytes) -> bytes:
    """Return a PDF with its streams decompressed."""
    parts = re.findall(rb"stream\r?\n(.*?)endstream", data, re.S)
    for part in parts:
        with suppress(zlib.error):
            data += zlib.decompress(part)
    return data


@pytest.mark.machine
@pytest.mark.parametrize(
    "backend", ["module://matplotlib_inline.backend_inline", "module://nowhere", "nonsense", "qtagg"]
)
def test_a_notebooks_backend_ends_no_chart_and_is_left_as_it_is(backend: str, tmp_path: Path) -> None:
    program = (
        "import os, sys, maglev_mj\n"
        "maglev_mj.run('drop', plant='exact').plot('chart.png')\n"
        "import matplotlib\n"
        "own = dict.__getitem__(matplotlib.rcParams, 'backend')\n"
        "assert own == os.environ['MPLBACKEND'] or 'nonsense' in sys.argv\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
        "print(os.environ['MPLBACKEND'])"
    )
    command = [sys.executable, "-c", program, backend]
    environment = {**os.environ, "MPLBACKEND": backend}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stderr, done.stdout.strip()) == (0, "", backend)
