"""Numbers in data frames, pictures and tables of results."""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Iterator, Mapping
from copy import copy
from dataclasses import fields, replace
from functools import cache
from html import escape
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np
import pytest
from numpy.typing import NDArray

from maglev_mj import Range, find_scene, linearise, measure_fidelity, run, run_phases, stability, sweep
from maglev_mj.bridge.fault import _NAMES, FaultRecord
from maglev_mj.bridge.preflight import LinkReport
from maglev_mj.device import Device
from maglev_mj.errors import MissingPackageError, ParameterError
from maglev_mj.plants.shapes import device_report
from maglev_mj.result import Result, Table, number_text, plain
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.press import Press
from maglev_mj.scenes.results import Figure, Variants
from maglev_mj.session.replay import record_run
from maglev_mj.studies import levels
from maglev_mj.studies.card import DeviceFigures, device_card
from maglev_mj.studies.compare import Comparison, sweep_laws
from maglev_mj.studies.designed_wall import ContactParameters, evaluate_wall
from maglev_mj.studies.diagnosis import diagnose
from maglev_mj.studies.drop_map import DropMapParameters, run_drop_map
from maglev_mj.studies.fidelity import MARGIN
from maglev_mj.studies.oscillation import Oscillation
from maglev_mj.studies.stability_map import GainMap, StabilityParameters, run_stability
from maglev_mj.terminal import WIDTH
from maglev_mj.theory import WallRequirements, design_wall
from maglev_mj.theory.loop import Bound, StableRange
from tests.analysis.test_analysis import analysed, recorded
from tests.studies.test_verdict_properties import Linearised

pytestmark = pytest.mark.xdist_group("tabular")  # one worker makes the results

STIFF = Drop(stiffness=12000.0)
GRID = 2


@cache
def results() -> dict[str, Result]:
    """Return one of each kind."""
    near = linearise(STIFF.controller(), [[0.0, 0.0, -1e-3, 0.0, 0.0, 0.0]])[0]
    recording = record_run(Drop(), plant="exact", phase=0.0)
    wall = design_wall(WallRequirements(mass=(0.6, 0.8)))
    phases = {"pd": run_phases(Drop(), 8, plant="exact")}
    rest = dict.fromkeys(("stiffness", "noise", "limit_cycle", "spectral_radius", "critical_stiffness", "margin"), 0.5)
    names = [name for kind in _NAMES.values() for name in kind]
    cycles = dict.fromkeys([*names, "time", "width", "delay", "latency"], np.arange(3.0))
    cycles |= dict.fromkeys(["sample", "state", "faults", *_NAMES["temperatures"]], np.arange(3))
    one = run(Drop(), plant="exact", phase=0.56)
    with pytest.MonkeyPatch.context() as few:  # no figure of it is looked at
        for name, value in {"_POINTS": 16, "_SEEDS": 2, "_LONG": 0.0, "_SHORT": 1e-9}.items():
            few.setattr(levels, name, value)
        let_go: Any = find_scene("let-go")
        fidelity = measure_fidelity(let_go(duration=0.02), over=Range(phases=1))
    return {
        "result": one,
        "trace": one.trace,
        "phases": phases["pd"],
        "sweep": sweep(Drop(), {"stiffness": [4000.0, 6000.0], "damping": [60.0, 70.0, 80.0]}, plant="exact"),
        "verdict": stability(STIFF),
        "linearised": near,
        "closed loop": near.closed_loop(delay=STIFF.delay),
        "recording": recording,
        "samples": recording.samples(),
        "analysed": analysed(recorded(Drop())),
        "diagnosis": diagnose(stiffness=500.0, damping=1.0, period=0.005, mass=0.15),
        "diagnosed loops": diagnose(stiffness=[100.0, 500.0], damping=1.0, period=0.005, mass=0.15),
        "stability map": run_stability(StabilityParameters(grid=GRID, plant="exact")),
        "drop map": run_drop_map(DropMapParameters(grid=GRID)),
        "design": evaluate_wall(wall, ContactParameters()),
        "fidelity": fidelity,
        "variants": Variants({"pd": one}),
        "comparison": Comparison({"pd": one}, phases, margins={"pd": rest}, scene=Drop()),
        "card": device_card(Drop()),
        "fault": FaultRecord(
            faults="SENSOR_FROZEN",
            first="SENSOR_FROZEN",
            message="fault SENSOR_FROZEN",
            fault_time=1.0,
            tick=3,
            lost=0,
            skipped=0,
            period=0.005,
            values=cycles,
        ),
    }


@pytest.fixture(scope="module", autouse=True)
def made() -> None:
    """Make the results before the first test."""
    results()


NAMES = ["result", "trace", "phases", "sweep", "verdict", "linearised", "closed loop", "recording", "samples"]
NAMES += ["analysed", "stability map", "drop map", "design", "fidelity", "variants", "comparison", "card", "fault"]


@pytest.mark.parametrize("name", NAMES)
def test_every_result_has_a_frame_with_units_a_picture_and_a_table(name: str) -> None:
    found = results()[name]
    frame = found.to_pandas()
    assert len(frame) and list(frame.columns) == list(found.columns()) and set(frame.attrs["units"]) <= set(frame)
    numbers = [column for column in frame if frame[column].dtype == np.float64]
    known = {"phase", "magnitude", "spectral_radius", "real", "imaginary", "segment", "keeps", "margin"}
    assert {column for column in numbers if not frame.attrs["units"].get(column)} <= known
    assert " ".join(found.plot().get_suptitle().split()) == found.headline
    table, html = found.table(), found._repr_html_()
    assert html.startswith(f"<table><caption><strong>{escape(found.headline)}</strong><br>{table.title[:20]}")
    tables = [table, *table.below]
    assert all(len(row) == len(one.head) for one in tables for row in one.rows)
    assert html.count("<tr>") == sum(len(one.rows) + 1 for one in tables)
    assert "style" not in html and "nan" not in html


UNIT = re.compile(r"\d (m|N|Hz|µ|s\b|kN|%|deg)|spectral radius \d")


@cache
def of_each_kind() -> dict[type[Result], Result]:
    """Return one result of each class."""
    numbers: Any = {
        "delay": np.array([1e-3]),
        "answer": np.array([1e-4]),
        "samples": 1,
        "lost": 0,
        "skipped": 0,
        "late": 0,
    }
    link = LinkReport(device_delay=1e-4, clock=1.0, lockstep=False, **numbers)
    laws = sweep_laws(Drop(duration=0.05), ["pd"], "stiffness", [2000.0, 4000.0], phases=2)
    own = DeviceFigures(Device.load("stage"))
    return {type(one): one for one in [*results().values(), link, device_report(), laws, own]}


@cache
def data_of_each_kind() -> dict[type[Result], Any]:
    """Return the JSON of one result of each class."""
    return {kind: found.as_json() for kind, found in of_each_kind().items()}


def values_of(hint: Any) -> Iterator[Any]:
    """Yield values of each alternative of a type, with NaN and complex numbers in them."""
    parts = get_args(hint)
    if hint in (None, type(None), int, str, bool, float, complex):
        yield {int: 1, str: "a", bool: True, float: math.nan, complex: 1.0 + 2.0j}.get(hint)
    elif isinstance(hint, UnionType) or get_origin(hint) is Union:
        yield from (value for part in parts for value in values_of(part))
    elif isinstance(hint, type) and issubclass(hint, tuple) and hasattr(hint, "_fields"):
        made: Any = hint
        yield made(*(next(values_of(part), None) for part in get_type_hints(hint).values()))
    elif get_origin(hint) is tuple:
        yield tuple(next(values_of(part), None) for part in parts if part is not ...)
    elif get_origin(hint) is np.ndarray:
        yield np.array([math.nan, 1.0 + 2.0j])


def test_every_result_in_every_state_becomes_json() -> None:
    states, named = 0, {"Oscillation": Oscillation, "NDArray": NDArray}
    for kind, found in of_each_kind().items():
        json.dumps(data_of_each_kind()[kind], allow_nan=False)
        if kind.as_json.__wrapped__ is not Result.as_json.__wrapped__:  # type: ignore[attr-defined]
            continue  # of its own: not of any values
        for item in fields(found):  # type: ignore[arg-type]
            hints = get_type_hints(kind, localns=named)
            for value in values_of(hints[item.name]) if item.repr else ():
                changed = copy(found)
                object.__setattr__(changed, item.name, value)
                plain = Result.as_json.__wrapped__(changed)  # type: ignore[attr-defined]
                json.dumps(plain, allow_nan=False)
                states += 1
    assert states > 60


def bounds_of(value: Any) -> Iterator[Bound | StableRange]:
    """Yield the bounds, and ranges of two, in a value of a result."""
    if isinstance(value, Bound | StableRange):
        yield value
    elif isinstance(value, Mapping):
        for one in value.values():
            yield from bounds_of(one)
    elif isinstance(value, tuple | list):
        for one in value:
            yield from bounds_of(one)


def test_every_bound_of_a_result_has_the_end_of_its_search_in_the_json() -> None:
    loop: dict[str, Any] = {"stiffness": 10.0, "damping": 1.0, "rate": 1000.0, "delay": 0.0, "mass": 0.7}
    compared: Any = results()["comparison"]
    margins = {"pd": {**compared.margins["pd"], "margin": Bound(640.0, True)}}
    more: list[Any] = [diagnose(**loop), diagnose(**loop, hand="0.1,20,500"), stability(Linearised(duration=0.01))]
    more.append(replace(compared, margins=margins))
    every = [*zip(of_each_kind().values(), data_of_each_kind().values()), *((found, found.as_json()) for found in more)]
    written = set[str]()
    for found, data in every:
        text = str(data)
        for name in {*data, *(item.name for item in fields(found))}:
            for bound in bounds_of(getattr(found, name, None)):
                end = str(plain(bound))
                assert end in text, (type(found).__name__, name)
                written |= {f"{type(found).__name__} {key}" for key in ("more_than", "less_than", "any") if key in end}
    wanted = {
        "Diagnosis more_than",
        "Diagnosis less_than",
        "Diagnosis any",
        "Verdict more_than",
        "Comparison more_than",
    }
    assert wanted <= written
    assert "more than 640" in str(more[-1].table())


def test_every_kind_of_result_has_a_headline() -> None:
    found = of_each_kind()
    kinds = [Result]
    for kind in kinds:
        kinds += kind.__subclasses__()
        if kind.__module__.startswith("maglev_mj.") and kind not in (Result, GainMap):
            headline = found[kind].headline
            assert UNIT.search(headline) and len(headline) <= 110
            assert headline in " ".join(str(found[kind].table()).split())
            assert found[kind].as_json()["headline"] == headline


def test_the_units_of_each_kind_of_result_are_these() -> None:
    units = {name: found.units for name, found in results().items()}
    gains = {"stiffness": "N/m", "damping": "N s/m"}
    assert gains.items() <= units["stability map"].items() and gains.items() <= units["sweep"].items()
    assert units["drop map"] == {**gains, "swing": "m"} and units["phases"]["peak_force"] == "N"
    assert units["verdict"] == {"pose": "m, rad", "stiffness": "N/m, N m/rad", "damping": "N s/m, N m s/rad"}
    assert units["linearised"]["z.z"] == "N/m" and units["linearised"]["time"] == "s"
    assert units["closed loop"] == {"frequency": "Hz"} and units["design"] == {"mass": "kg", "delay": "s"}
    assert units["sweep"]["penetration"] == "m" and units["sweep"]["settling_time"] == "s"
    # those of six components, of a translation and a rotation
    trace = {"pose": ("m", "rad"), "twist": ("m/s", "rad/s"), "wrench": ("N", "N m")}
    sample = {"position": ("m", "rad"), "command": ("N", "N m"), "applied": ("N", "N m"), "hand": ("N", "N m")}
    analysed = {"recorded": ("m", "rad"), "simulated": ("m", "rad")}
    sides = {"trace": trace, "samples": sample, "recording": sample, "analysed": analysed}
    for name, parts in sides.items():
        assert {part: (units[name][f"{part}.z"], units[name][f"{part}.ry"]) for part in parts} == parts
        assert units[name]["time"] == "s"


def lines(figure: Any, panel: int = 0) -> Any:
    return figure.axes[panel].get_lines()


def test_the_series_of_a_run_are_those_of_its_trace() -> None:
    one: Any = results()["result"]
    frame = one.to_pandas()
    pose, _, wrench = one.trace.at(frame["time"].to_numpy())
    np.testing.assert_array_equal(frame["z"], pose[:, 2])
    np.testing.assert_array_equal(frame["force"], wrench[:, 2])
    assert frame.attrs["units"] == {"time": "s", "z": "m", "force": "N"}
    rows = {row[0]: row[1:3] for row in one.table().rows}
    assert rows["penetration"] == (f"{one.figures['penetration'] * 1e3:.2f}", "mm") and rows["peak force"][1] == "N"
    assert one.plot()._repr_png_().startswith(b"\x89PNG")
    drawn = next(line for line in lines(one.plot()) if line.get_label() == "drop")
    at = one.trace.at(drawn.get_xdata())[0][:, 2] * 1e3
    np.testing.assert_array_equal(drawn.get_ydata(), at)
    assert len(one.plot(picture="drop_phase_plane").axes) == 1
    with pytest.raises(ParameterError, match=r"picture must be one of drop_time, drop_phase_plane, .*got 'x'\)"):
        one.plot(picture="x")
    with pytest.raises(ParameterError, match="this picture needs sampling phases: see run_phases"):
        one.plot(picture="drop_phases")
    with pytest.raises(ParameterError, match="this picture needs figures"):
        run_phases("corner", 2, plant="exact").plot()


def test_a_choice_of_model_draws_the_distance_of_each_level() -> None:
    found: Any = results()["fidelity"]
    missing = 1e6 * found.to_pandas()["missing"].to_numpy()
    *dots, tolerance = lines(found.plot())
    drawn = {int(level): x for line in dots for x, level in zip(*line.get_data())}
    assert drawn == dict(zip(np.flatnonzero(missing), missing[missing > 0.0]))
    within = {line.get_label(): np.max(line.get_xdata()) <= tolerance.get_xdata()[0] for line in dots}
    assert within.pop("max. deviation, too large", False) is False and all(within.values())
    assert tolerance.get_xdata()[0] == pytest.approx(1e6 * found.tolerance / MARGIN)
    assert found.to_pandas().attrs["units"] == {
        **dict.fromkeys(("changes", "worst", "missing"), "m"),
        "force": "N",
        "cost": "s",
    }
    table = found.table()
    assert table.head[2] == "worst [µm]" and table.head[5] == "cost [µs]"
    worst = [1e6 * row.worst for row in found.levels]
    assert [row[2] for row in table.rows] == pytest.approx(worst, abs=5e-4) and found.level.level in table.note


def test_a_batch_says_that_a_series_needs_one_phase() -> None:
    batch = run(Drop(), plant="exact", phase=[0.0, 0.5])
    for wanted in (batch.to_pandas, batch.plot, batch.times):
        with pytest.raises(ParameterError, match=r"result must be of one sampling phase, such as result\[0\] \(got 2"):
            wanted()
    alone = batch[1].to_pandas()
    assert alone["z"].min() == pytest.approx(run(Drop(), plant="exact", phase=0.5).to_pandas()["z"].min(), abs=1e-15)
    assert "median (5 to 95 %) over 2 phases" in batch.table().title
    with pytest.raises(ParameterError, match=r"trace must be of one device on six axes, \(K, 6\) [(]got \(\d+, 2, 6\)"):
        batch.trace.to_pandas()
    six = run(Drop(), plant="exact", phase=np.arange(6) / 6).trace  # as many devices as axes
    with pytest.raises(ParameterError, match="trace must be of one device on six axes"):
        six.to_pandas()


def test_phases_have_a_row_each_in_si_units_and_a_column_for_each_hit() -> None:
    found: Any = results()["phases"]
    frame = found.to_pandas()
    assert list(frame["phase"]) == [index / 8 for index in range(8)]
    np.testing.assert_array_equal(frame["penetration"], found.figures["penetration"])
    assert frame.attrs["units"]["penetration"] == "m" and frame.attrs["units"]["settling_time"] == "s"
    median = np.percentile(found.figures["penetration"], 50.0) * 1e3
    assert next(row for row in found.table().rows if row[0] == "penetration")[1].startswith(f"{median:.2f} (")
    drawn = lines(found.plot())[0].get_ydata()  # with gaps at jumps
    np.testing.assert_array_equal(drawn[np.isfinite(drawn)], found.figures["penetration"] * 1e3)
    hits = run_phases(Press(hits=2), [0.0], plant="exact")
    hit = hits.to_pandas()
    assert [hit.at[0, f"penetration.{index}"] for index in (0, 1)] == hits.figures["penetration"][0].tolist()
    assert hit.attrs["units"]["penetration.1"] == "m" and hit.attrs["units"]["final_force"] == "N"


@pytest.mark.parametrize(
    ("unit", "scale", "wanted"), [("mm", 1e3, "m"), ("µm/s", 1e6, "m/s"), ("N", 1.0, "N"), ("deg", 57.3, "")]
)
def test_a_figure_knows_the_unit_without_its_prefix(unit: str, scale: float, wanted: str) -> None:
    assert Figure("any", lambda result: 0.0, unit, scale=scale).si_unit == wanted


@pytest.mark.needs("xarray")
def test_a_sweep_is_a_data_set_over_its_parameters_with_units() -> None:
    found: Any = results()["sweep"]
    data = found.to_xarray()
    assert data["penetration"].sel(stiffness=6000.0, damping=70.0).item() == found.figure("penetration")[1, 1]
    assert {data[name].attrs["units"] for name in ("damping", "peak_force")} == {"N s/m", "N"}
    pressed = sweep(Press(), {"stiffness": [4000.0]}, plant="exact")  # some of its figures are a number for each hit
    assert set(pressed.units) > set(pressed.to_xarray().variables)


def test_a_sweep_has_a_row_for_each_cell_and_a_line_for_each_value() -> None:
    found: Any = results()["sweep"]
    frame = found.to_pandas()
    assert list(frame["stiffness"]) == [4000.0] * 3 + [6000.0] * 3 and list(frame["damping"]) == [60.0, 70.0, 80.0] * 2
    cell = frame[(frame.stiffness == 6000.0) & (frame.damping == 70.0)]
    assert cell["penetration"].item() == run(Drop(damping=70.0), plant="exact").figures["penetration"]
    assert frame.attrs["units"]["damping"] == "N s/m" and "error" not in frame
    indexed = found.to_pandas(indexed=True)
    assert indexed.index.names == ["stiffness", "damping"] and indexed.attrs == frame.attrs
    assert indexed.loc[(6000.0, 70.0), "penetration"] == cell["penetration"].item()
    drawn = lines(found.plot())
    assert [line.get_label() for line in drawn] == [f"damping {damping} N s/m" for damping in (60, 70, 80)]
    np.testing.assert_array_equal(drawn[1].get_ydata(), found.figure("penetration")[:, 1] * 1e3)
    failed = sweep(Drop(), {"stiffness": [6000.0, 60000.0]}, plant="exact").to_pandas()
    assert failed["error"][0] == "" and "diverged" in failed["error"][1] and np.isnan(failed["penetration"][1])
    with pytest.raises(ParameterError, match=r"vary must give .* one parameter, not \{\}; see run\(\)"):
        sweep(Drop(), {}, plant="exact")
    pressed = sweep(Press(), {"stiffness": [4000.0]}, plant="exact")
    with pytest.raises(ParameterError, match=r"figure must be one number per cell [(]got peak_force"):
        pressed.figure("peak_force")
    with pytest.raises(ParameterError, match=r"figure must be one of penetration, .*got 'penetraton'\); did you mean"):
        found.figure("penetraton")
    walls = sweep(find_scene("wall"), {"stiffness": [7000.0, 11000.0]}, plant="exact")
    assert list(walls.to_pandas()["simulated_stable"]) == [1.0, 0.0] and len(walls.plot().axes) == 3  # what changes
    assert "penetration" not in sweep(Press(hits=2), {"height": [0.002]}, plant="exact").to_pandas()


def test_a_verdict_and_its_closed_loop_have_the_same_worst_eigenvalue() -> None:
    verdict: Any = results()["verdict"]
    loop: Any = results()["closed loop"]
    assert np.abs(verdict.eigenvalues).max() == pytest.approx(verdict.spectral_radius, rel=1e-12)
    assert loop.spectral_radius == pytest.approx(verdict.spectral_radius, rel=1e-9) and verdict.spectral_radius > 1.0
    frame = loop.to_pandas()
    assert list(frame["magnitude"]) == sorted(frame["magnitude"], reverse=True)
    assert frame["frequency"][0] == pytest.approx(np.angle(loop.eigenvalues[0]) / (2.0 * np.pi * 0.005))
    assert list(verdict.to_pandas()["stiffness"])[2] == 12000.0
    assert "unstable" in verdict.headline and "(worst in contact)" in verdict.headline
    assert "unstable" in loop.headline
    outside = next(line for line in lines(verdict.plot()) if line.get_label().startswith("unstable poles"))
    assert len(outside.get_xdata()) == 2 and (np.hypot(*outside.get_data()) > 1.0).all()
    stable = stability(Drop())
    assert not any(line.get_label().startswith("unstable poles") for line in lines(stable.plot()))


def test_a_linearised_wall_answers_now_and_one_sample_later() -> None:
    near: Any = results()["linearised"]
    frame = near.to_pandas()
    k, b, period = 12000.0, 80.0, 0.005
    assert frame["z.z"].tolist() == pytest.approx([-k - b / period, b / period])
    assert frame["time"].tolist() == [0.0, period] and frame.attrs["units"]["rz.rz"] == "N m/rad"
    assert [row[1] for row in near.table().rows][2] == pytest.approx(k)


def test_a_recording_and_its_samples_are_the_same_frame() -> None:
    recording: Any = results()["recording"]
    frame, (segment,) = recording.to_pandas(), recording.segments
    np.testing.assert_array_equal(frame["position.z"], segment.position[:, 2])
    assert frame.equals(results()["samples"].to_pandas()) and frame.attrs["units"]["command.rx"] == "N m"
    assert recording.table().rows == [(0, "run", 81, 0.0, 0.4)]
    assert "73 more rows and" in results()["samples"].table().note
    upper, lower = recording.plot().axes
    np.testing.assert_array_equal(upper.get_lines()[0].get_ydata(), segment.position[:, 2] * 1e3)
    np.testing.assert_array_equal(lower.get_lines()[0].get_ydata(), segment.command[:, 2])


def test_an_analysis_has_both_sides_and_what_was_identified() -> None:
    found: Any = results()["analysed"]
    frame = found.to_pandas()
    np.testing.assert_array_equal(frame["recorded.z"], frame["simulated.z"])
    identified = found.table().below[-1]
    assert ("  stiffness", "6000.0000") in [row[:2] for row in identified.rows]
    assert "not identifiable: noise of z: " in identified.note
    with pytest.raises(ParameterError, match=r"axis must be one of those with motion \(z\) [(]got 'x'"):
        found.plot(axis="x")


def test_maps_have_a_row_for_each_wall() -> None:
    growth: Any = results()["stability map"]
    drops: Any = results()["drop map"]
    for found in (growth, drops):
        frame = found.to_pandas()
        assert list(frame["damping"][:GRID]) == found.damping.tolist()
        assert list(frame["stiffness"][::GRID]) == found.stiffness.tolist()
        row = next(row for row in found.table().rows if row[0].startswith("stiffest stable wall"))
        assert row[1] == pytest.approx(10173.0, abs=0.5)
    np.testing.assert_array_equal(growth.to_pandas()["settles"], growth.simulated.ravel())
    assert (drops.to_pandas()["ending"] == "settles").sum() == drops.settles.sum()
    design: Any = results()["design"]
    assert design.to_pandas()["spectral_radius"].max() == pytest.approx(design.wall.spectral_radius, abs=1e-3)
    assert design.table().rows[0][1] == design.wall.stiffness


def test_a_package_that_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("maglev_mj.errors.find_spec", lambda name: None)
    one = results()["result"]
    with pytest.raises(MissingPackageError, match=r"data frames require pandas: .* -m pip install 'pandas>="):
        one.to_pandas()
    with pytest.raises(MissingPackageError, match=r"charts require matplotlib: .* -m pip install 'matplotlib>="):
        one.plot()
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(MissingPackageError, match="a data set needs xarray: pip install xarray"):
        results()["sweep"].to_xarray()  # type: ignore[attr-defined]


def test_text_in_a_table_is_no_markup() -> None:
    class Odd(Result):
        def table(self) -> Table:
            return Table("<b>", ("a&b",), [("<script>",), (float("nan"),), (123456.7,), (0.00012345,)], "<i>")

    html = Odd()._repr_html_()
    assert "<script>" not in html and "<b>" not in html and "&lt;i&gt;" in html and "a&amp;b" in html
    assert "<td>-</td>" in html and "<td>123457</td>" in html and "<td>0.0001234</td>" in html


@pytest.mark.parametrize("count", range(1, 30))
def test_columns_that_continue_below_follow_a_blank_line(count: int) -> None:
    head = ["law", *(f"figure {index} [m]" for index in range(count))]
    lines = str(Table("", head, [("pd", *[0.25] * count), ("pulse", *[0.5] * count)])).splitlines()
    starts = [index for index, line in enumerate(lines) if line.startswith("  law")]
    assert [index for index, line in enumerate(lines) if not line] == [start - 1 for start in starts[1:]]
    assert sum(line.count("figure") for line in lines) == count and (len(starts) > 1) == (count > 8)


def test_a_representation_is_short_and_fits_a_terminal() -> None:
    for name, found in results().items():
        said = repr(found)
        assert len(said.encode()) <= 2000 and "nan" not in said and len(said.splitlines()) > 2, name
        assert max(map(len, said.splitlines())) <= WIDTH, name


@pytest.mark.parametrize(
    ("value", "digits", "decimals", "text"),
    [
        *((0.0, 4, None, "0"), (-1e-30, 3, 2, "0.00"), (6000.0, 4, None, "6000"), (math.nan, 4, None, "-")),
        *((123456.7, 4, None, "123457"), (0.00012345, 4, None, "0.0001234"), (1.5e-9, 4, None, "1.5e-09")),
        *((9.994, 3, 2, "9.99"), (12.34, 3, 2, "12.3"), (8123.4, 3, 2, "8123"), (0.984, 3, 2, "0.98")),
        *((math.inf, 3, 2, "-"), (1e9, 4, None, "1e+09")),
    ],
)
def test_numbers_have_one_form(value: float, digits: int, decimals: int | None, text: str) -> None:
    assert number_text(value, digits, decimals) == text
