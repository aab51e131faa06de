"""Measured walls: the file of points, and what its study makes of them."""

from __future__ import annotations

import math
import re
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import measured_walls
from maglev_mj.errors import ParameterError
from maglev_mj.theory import spectral_radius
from measured_walls import FILE, Series, compare, draw, lines, load
from tests.studies.test_charts import complaints

SERIES = load(FILE)
COMPUTED = [series for series in SERIES if not series.missing]
DEGREES = math.pi / 180.0


def by_name(text: str) -> Series:
    """Return the series of a device."""
    return next(series for series in SERIES if text in series.text["device"])


def test_ten_thousand_is_what_theory_says_at_the_stated_delay_and_half_a_millisecond_moves_it_by_a_sixth() -> None:
    found = compare(by_name("UBC"))
    limits = [float(part[0]) for part in (found.theory, found.shorter, found.longer)]
    assert limits == pytest.approx([10173.0, 12169.0, 8662.0], abs=0.6)
    assert math.isnan(found.delay[0])  # no damping is stated


@pytest.mark.parametrize("series", COMPUTED, ids=[one.text["device"] for one in COMPUTED])
def test_at_the_delay_and_at_the_damping_that_meet_a_point_its_wall_is_on_the_boundary(series: Series) -> None:
    found, around = compare(series), series.keywords()
    met = 0
    for index, (damping, stiffness) in enumerate(series.points):
        delay, own = float(found.delay[index]), float(found.damping[index])
        if 0.0 < delay < math.inf:
            met += 1
            sides = [
                spectral_radius(stiffness, damping, **{**around, "delay": delay * part}) for part in (0.999, 1.001)
            ]
            assert sides[0] < 1.0 < sides[1]
        if 0.0 < own < math.inf:
            met += 1
            with_own = {**around, "own_damping": 1.001 * own}
            assert spectral_radius(stiffness, np.nan_to_num(damping), **with_own) < 1.0
            assert series.critical(own_damping=0.99 * own)[index] < stiffness
    assert met or series.text["kind"] == "limit"


def test_walls_that_ran_are_stable_by_theory_and_those_that_did_not_are_not() -> None:
    judged = {one.text["kind"]: compare(one) for one in COMPUTED if one.text["kind"] != "limit"}
    assert judged.keys() == {"stable", "unstable"}
    assert judged["stable"].theory[0] > 6000.0
    assert judged["unstable"].theory[0] == 0.0


def test_one_delay_explains_the_paddle_s_lightly_filtered_wall_but_not_the_heavily_filtered_one() -> None:
    light, heavy = compare(by_name("1 kHz filter, compensated")), compare(by_name("10 Hz filter"))
    assert light.delay[2:].min() > 0.7e-3 and light.delay[2:].max() < 0.96e-3
    assert (heavy.damping > 0.02).all()  # a finger or friction: measured at up to seven times of theory without
    assert not (heavy.theory * 4.0 > by_name("10 Hz filter").points[:, 1]).any()


def test_the_paddle_s_points_are_those_of_its_source_in_degrees() -> None:
    for series in SERIES:
        if "EPFL" in series.text["device"]:
            damping, stiffness = (series.points * DEGREES).T  # N m/deg and N m s/deg: one and three decimals
            np.testing.assert_allclose(stiffness, stiffness.round(1), atol=1e-4)
            np.testing.assert_allclose(damping, damping.round(3), atol=1e-7)


def test_the_paddle_s_filter_is_that_of_its_firmware() -> None:
    for series in SERIES:
        if "EPFL" in series.text["device"]:
            number, unit = re.findall(r"(\d+) (k?Hz)", series.text["device"])[0]
            stated = float(number) * (1e3 if unit == "kHz" else 1.0)
            period = series.loop["period"]
            share = period / (1.0 / (2.0 * math.pi * stated) + period)  # dt / (tau + dt)
            assert 1.0 - math.exp(-2.0 * math.pi * series.loop["cutoff"] * period) == pytest.approx(share, rel=1e-3)


def test_each_series_names_what_it_does_not_know() -> None:
    assert any(one.missing for one in SERIES) and any(not one.text["opened"] for one in SERIES)
    for series in SERIES:
        text = "\n".join(islice(lines(series), 3 if series.missing else 2))
        assert ("not opened" in text) == (not series.text["opened"])
        assert (", ".join(series.assumed) or "assumed: nothing") in text
        assert ("not computed: " in text) == bool(series.missing)


MINE = {
    "device": "mine",
    "rotary": False,
    "mass": 0.5,
    "period": 0.001,
    "delay": 0.0005,
    "sensor": "encoder",
    "kind": "limit",
    "opened": True,
    "source": "my log",
    "reading": "by hand",
    "points": [[10.0, 2000.0], [20.0, 4000.0], [40.0, 6000.0]],
}


def written(path: Path, **changes: Any) -> Path:
    """Return a file with one series."""

    def text(value: Any) -> str:
        return repr(value).lower() if isinstance(value, bool) else repr(value)

    rows = {name: value for name, value in {**MINE, **changes}.items() if value is not None}
    path.write_text("[[series]]\n" + "".join(f"{name} = {text(value)}\n" for name, value in rows.items()))
    return path


def test_your_own_file_is_read_by_the_same_study(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    measured_walls.main(written(tmp_path / "mine.toml"))
    out = capsys.readouterr().out
    assert out.startswith("mine (limit; N/m, N s/m)") and "theory meets the points with damping at" in out
    measured_walls.main(written(tmp_path / "mine.toml", mass=None))
    assert "not computed: mass not stated" in capsys.readouterr().out


def test_a_curve_is_drawn_and_fewer_points_are_not(tmp_path: Path) -> None:
    drawn: list[Any] = []

    def keep(figure: Any, path: Path) -> Path:
        drawn.append(figure)
        return path

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(measured_walls, "save", keep)
        assert draw([by_name("50 Hz"), by_name("UBC")], tmp_path / "walls.png") == tmp_path / "walls.png"
        assert draw([by_name("UBC"), by_name("ETH ")], tmp_path / "walls.png") is None
    (figure,) = drawn
    assert complaints(figure) == []
    curves = {line.get_label(): line for line in figure.axes[0].get_lines()}
    assert curves.keys() == {"theory, delay of the file", "theory, that delay", "measured"}
    np.testing.assert_array_equal(curves["measured"].get_xydata(), by_name("50 Hz").points)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"kind": "best"}, "kind must be one of"),
        ({"device": 3}, "device must be a str"),
        ({"stiffness": 3.0}, "unknown keys stiffness"),
        ({"mass": -1.0}, "mass must be a number"),
        ({"assumed": ["cutoff"]}, "assumed must be a list"),
        ({"points": []}, "points must be rows"),
        ({"points": [[1.0, 2.0, 3.0]]}, "points must be rows"),
        ({"points": [[1.0, -2.0]]}, "stiffness must be above 0"),
    ],
)
def test_a_wrong_file_is_refused(changes: dict[str, Any], message: str, tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match=message):
        load(written(tmp_path / "mine.toml", **changes))


def test_a_file_that_is_none_is_refused(tmp_path: Path) -> None:
    (tmp_path / "empty.toml").write_text("")
    for name, message in (("none.toml", "cannot be read"), ("empty.toml", r"no \[\[series\]\]")):
        with pytest.raises(ParameterError, match=message):
            load(tmp_path / name)
