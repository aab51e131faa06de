"""Pictures of drops show the simulated values."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from maglev_mj.colours import SERIES
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.pictures import figure_6, phase_plane, series, spread, time_series
from maglev_mj.scenes.press import Press
from maglev_mj.scenes.results import Variants
from maglev_mj.scenes.run import run, run_phases, run_variants
from tests.studies.test_charts import details
from tests.sweeps import sweep

DROP, PHASE, BANDS = Drop(), 0.56, 20
ANALOG = "analog wall, 10 kHz low-pass"


@cache
def drops(drop: Drop, phase: float = PHASE, bands: int = BANDS) -> Variants:
    return run_variants(drop.variants(), plant="exact", phase=phase, bands=bands)


def lines(panel: Any) -> dict[str, Any]:
    """Return the lines of the legend by label."""
    return {line.get_label(): line for line in panel.get_lines() if not line.get_label().startswith("_")}


def reach(band: Any) -> tuple[float, float]:
    """Return the smallest and largest value of a band."""
    vertices = np.concatenate([path.vertices for path in band.get_paths()])
    return float(vertices[:, 1].min()), float(vertices[:, 1].max())


def test_figure_3_has_a_column_for_each_reading() -> None:
    figure = time_series(drops(DROP))
    heights, forces = figure.axes[:2], figure.axes[2:]
    for upper, lower, title in zip(heights, forces, ("+220 N s/m (300 total)", "220 N s/m total"), strict=True):
        assert upper.get_title(loc="left") == title
        assert list(lines(upper)) == [title, "no pulse", ANALOG]
        assert set(lines(lower)) == {title, "no pulse", ANALOG, "force limit, 60 N"}
        assert list(lines(lower)["force limit, 60 N"].get_ydata()) == [60.0, 60.0]
        for panel, part, scale in ((upper, 0, 1e3), (lower, 2, 1.0)):
            time, drawn = lines(panel)[ANALOG].get_data()
            np.testing.assert_allclose(drawn, DROP.analog(time)[part] * scale, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("draw", sweep([time_series, phase_plane, series, spread, figure_6], every=5))
def test_eight_variants_differ_in_their_dashes_and_so_without_colour(draw: Any) -> None:
    scene = Press(hits=1) if draw is figure_6 else DROP.replace(duration=0.1)
    pulses = {f"pulse {pulse:g}": scene.replace(pulse=pulse) for pulse in (220.0, 140.0, 100.0, 60.0)}
    plain = {f"damping {value:g}": scene.replace(pulse=0.0, damping=value) for value in (80.0, 70.0, 60.0, 50.0)}
    found = run_variants(pulses | plain, plant="exact", phases=None if draw is figure_6 else 3)
    drawn = {label: line for panel in draw(found).axes for label, line in lines(panel).items() if label in found.runs}
    assert drawn.keys() == found.runs.keys()
    assert len({str(line._unscaled_dash_pattern) for line in drawn.values()}) == 8
    assert len({(line.get_color(), str(line._unscaled_dash_pattern)) for line in drawn.values()}) == 8
    assert len({line.get_color() for line in drawn.values()}) == len(SERIES)


def test_bands_reach_as_far_as_the_drop_at_any_phase() -> None:
    figure = time_series(drops(DROP))
    variants = DROP.variants()
    for column, label in enumerate(list(variants)[:2]):
        for place, variant in enumerate((variants[label], variants["no pulse"])):
            over_phases = run_phases(variant, BANDS, plant="exact").figures
            depth, _ = reach(figure.axes[column].collections[place])
            _, peak = reach(figure.axes[2 + column].collections[place])
            assert -depth == pytest.approx(over_phases["penetration"].max() * 1e3, abs=1e-3)
            assert peak == pytest.approx(over_phases["peak_force"].max(), rel=1e-9)
    for panel in figure.axes:  # each is one outline, however many the phases
        for band in panel.collections:
            (outline,) = band.get_paths()
            assert len(outline.vertices) < 9000


@pytest.mark.parametrize(("draw", "phase"), sweep([time_series, phase_plane], [PHASE, 0.06, 0.9], every=4))
def test_pictures_name_their_phase_and_how_deep_it_is(draw: Any, phase: float) -> None:
    figure = draw(drops(DROP, phase))
    depth = run(DROP, plant="exact", phase=phase).figures["penetration"]
    others = run_phases(DROP, BANDS, plant="exact").figures["penetration"]
    share = 100.0 * float(np.mean(others < depth))
    words = f"lines: sampling phase {phase:g} (depth exceeds {share:.0f} % of the phases); band: {BANDS} phases"
    assert words in details(figure)


def test_the_published_figures_show_a_phase_of_median_penetration() -> None:
    for pulse in (220.0, 140.0, 0.0):
        drop = Drop(pulse=pulse)
        depths = run_phases(drop, 101, plant="exact").figures["penetration"]
        depth = run(drop, plant="exact", phase=PHASE).figures["penetration"]
        assert depth == pytest.approx(np.median(depths), abs=0.02e-3)


@pytest.mark.parametrize(
    ("changes", "columns"),
    [({"pulse": 150.0}, 1), ({"stiffness": 0.0, "damping": 0.0, "duration": 0.05}, 1)],
)
def test_every_drop_can_be_drawn(changes: dict[str, float], columns: int) -> None:
    drop = DROP.replace(**changes)
    figures = [time_series(drops(drop, bands=3)), phase_plane(drops(drop, bands=3))]
    assert [len(figure.axes) for figure in figures] == [2 * columns, columns]
    for figure in figures:
        has_analog = any(ANALOG in lines(panel) for panel in figure.axes)
        assert has_analog == (drop.stiffness > 0.0)


def test_a_figure_that_is_flat_has_no_panel() -> None:
    found = drops(DROP, bands=20)
    figure = spread(found)
    titles = [panel.get_title(loc="left") for panel in figure.axes]
    assert "final height (mm)" not in titles and titles[:2] == ["penetration (mm)", "rebound (mm)"]
    head = details(figure)
    assert head.endswith("not shown (constant): final height")
    assert "drop along z" in head and "200 Hz, delay 1.5 ms" in head
    assert "pulse 220" not in head  # it differs between the drops
    marked = [panel for panel in figure.axes for line in panel.lines if [*line.get_ydata()] == [60.0, 60.0]]
    assert [panel.get_title(loc="left") for panel in marked] == ["peak force (N)"]
