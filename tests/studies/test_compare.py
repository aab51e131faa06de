"""Laws of a wall side by side: the figures of single studies, margins of theory, errors."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import mujoco
import numpy as np
import pytest

from maglev_mj import AxisLaw, Controller, Sample, cli, gain
from maglev_mj.control import HalfSampleWall, Hold, VirtualCoupling, Wall
from maglev_mj.errors import ParameterError
from maglev_mj.plants.hand import get_hand
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.figures import perceived_hardness
from maglev_mj.scenes.press import Press
from maglev_mj.scenes.run import run, run_phases
from maglev_mj.scenes.stability_check import wall_loops
from maglev_mj.spec import GRAVITY
from maglev_mj.studies.compare import _MARGINS, Comparison, _AtRest, _with_law, compare, sweep_laws
from maglev_mj.studies.designed_wall import hum
from maglev_mj.studies.wall_laws import LAWS
from maglev_mj.theory import judge, largest_stable_stiffness, least_passive_damping
from maglev_mj.theory.boundary import boundary_of
from maglev_mj.theory.loop_array import LoopArray, spectral_radius
from maglev_mj.theory.read import loops_at
from tests.studies.test_charts import details

ROOT = Path(__file__).resolve().parents[2]
OWN = """
from maglev_mj import AxisLaw, Law, gain


class Mine(AxisLaw):
    stiffness: float = gain("stiffness", "N/m")
    damping: float = gain("damping", "N s/m")
    share: float = gain("share of the force", default=1.0)

    def force(self, x, v, gains, state):
        return (x <= 0.0) * -(gains.share * (gains.stiffness * x + gains.damping * v))


class Needy(Law):
    def __init__(self, temperature):
        self.temperature = temperature


class Other:
    pass
"""
pytestmark = pytest.mark.xdist_group("compare")  # they share what two fixtures ran

BARE = Press(hits=1, duration=1.0, pulse=0.0)
PHASES = 9
HALF_SAMPLE = HalfSampleWall(axes="z", stiffness=6000.0, damping=80.0, period=0.005)


@pytest.fixture
def own(tmp_path: Path) -> Path:
    path = tmp_path / "mine.py"
    path.write_text(OWN)
    return path


@pytest.fixture(scope="module")
def drops() -> Comparison:
    return compare("drop", ["pd", "pulse", "half-sample"], phases=PHASES)


@pytest.fixture(scope="module")
def presses() -> Comparison:
    return compare(BARE.replace(pulse=220.0), ["pd"], phases=2)


def test_figures_are_those_of_single_studies_to_the_last_bit(drops: Comparison, presses: Comparison) -> None:
    scenes = [(drops, "pd", Drop(pulse=0.0)), (drops, "pulse", Drop()), (presses, "pd", BARE)]
    for found, label, scene in scenes:
        alone = run_phases(scene, len(found.phases[label].phases), plant="exact").figures
        shown = found.phases[label].figures
        assert {name for name in alone if "penetration" in name or "peak_force" in name} <= shown.keys()
        for name in shown.keys() - {"hardness"}:
            np.testing.assert_array_equal(shown[name], alone[name])
    trace = run(Drop(pulse=0.0), plant="exact", phase=2 / PHASES).trace
    assert drops.phases["pd"].figures["hardness"][2] == perceived_hardness(trace, 0.005).extended


def check_margin(found: Mapping[str, float], **more: Any) -> None:
    """Assert the margin of a wall in a drop."""
    loop: dict[str, Any] = {"period": 0.005, "delay": 0.0015, "mass": 0.7, **more}
    assert found["spectral_radius"] == pytest.approx(float(spectral_radius(6000.0, 80.0, **loop)), abs=1e-6)
    stiffest = float(boundary_of(LoopArray(**loop), np.array(80.0)))
    assert found["critical_stiffness"] == pytest.approx(stiffest, rel=5e-5)
    assert found["margin"] == pytest.approx(stiffest / 6000.0, rel=5e-5)


def test_margins_are_those_of_the_exact_closed_loop(drops: Comparison, presses: Comparison) -> None:
    for label, more in {"pd": {}, "pulse": {}, "half-sample": {"prediction": 0.0025}}.items():
        check_margin(drops.margins[label], **more)
    held: dict[str, Any] = {"period": 0.005, "delay": 0.0015, "mass": 0.7, "hand": "arm"}
    found = presses.margins["pd"]
    assert found["spectral_radius"] == pytest.approx(float(spectral_radius(6000.0, 80.0, **held)), abs=1e-6)
    assert found["critical_stiffness"] == pytest.approx(float(largest_stable_stiffness(80.0, **held)), rel=5e-5)
    assert found["stiffness"] == pytest.approx(6000.0, rel=1e-6)


class Damped(Drop):
    """A drop on a device with joint damping along z."""

    def plant_options(self) -> dict[str, Any]:
        """See `Scene`."""
        text = (ROOT / "model" / "maglev.xml").read_text(encoding="utf-8").replace('name="z"', 'name="z" damping="20"')
        return super().plant_options() | {"model": mujoco.MjSpec.from_string(text)}


@pytest.mark.usefixtures("no_margins")
def test_colgate_is_the_stiffest_passive_spring_on_the_devices_own_damping() -> None:
    scene = Damped(duration=0.05)
    (law, *_) = compare(scene, ["colgate"], phases=2, plant="mujoco").phases["colgate"].scene.laws()
    assert (law.damping, law.pulse) == (0.0, 0.0)
    assert least_passive_damping(law.stiffness, period=0.005, delay=0.0015) == pytest.approx(20.0)
    for bare, plant in ((scene, "exact"), (BARE.replace(hand="stylus"), "mujoco")):
        with pytest.raises(ParameterError, match="no passive spring: the device has no damping of its own"):
            compare(bare, ["colgate"], phases=2, plant=plant)


@pytest.mark.parametrize("law", LAWS)
def test_page_and_help_state_equation_source_and_status_of_every_law(
    law: str, capsys: pytest.CaptureFixture[str]
) -> None:
    row, page = LAWS[law], (ROOT / "docs" / "howto" / "compare.md").read_text(encoding="utf-8")
    assert f"| `{law}` | {row.status} | `{row.equation}` | {row.source} |\n" in page
    # as published is what was read: in the authors' text, or in an implementation that the row names
    assert ("not opened" not in row.source) or row.status != "as published" or " as in " in row.source
    assert "not opened" in row.source or not re.search("quoted|abstract", row.source)
    with pytest.raises(SystemExit):
        cli.main(["compare", "--help"])
    shown = " ".join(capsys.readouterr().out.split())
    assert f"{law} ({row.status})" in shown and f"{law} {row.text}" in shown


def loop_of(law: str, **options: Any) -> _AtRest:
    return _AtRest([_with_law(Drop(**options), law, LAWS[law], "exact")])


PD = float(spectral_radius(6000.0, 80.0, period=0.005, delay=0.0015, mass=0.7))
KNOWN: dict[str, tuple[dict[str, Any], float]] = {
    "pd": ({"delay": 0.005}, 1.082124),
    "pulse": ({}, PD),
    "half-sample": ({"stiffness": 10173.0, "damping": 62.14}, 1.0),
    "virtual-coupling": ({}, PD),
    "filtered": ({"stiffness": 3000.0, "damping": 60.0}, 0.870078),
    "passivity-2002": ({}, PD),
    "passivity": ({}, PD),
}


@pytest.mark.parametrize("law", [name for name in LAWS if name != "colgate"])
def test_each_law_has_the_spectral_radius_of_its_equation(law: str) -> None:
    options, radius = KNOWN[law]
    assert loop_of(law, **options).present[0].spectral_radius == pytest.approx(
        radius, abs=3e-5 if law == "half-sample" else 1e-6
    )


@pytest.mark.parametrize(
    ("inertia", "stiffness", "damping", "radius"),
    [
        (0.1, 2000.0, 10.0, 0.94191),
        (0.1, 6000.0, 40.0, 0.78342),
        (0.7, 2e4, 60.0, 0.921624),
        (2.4, 800.0, 2.0, 0.998724),
    ],
)
def test_a_virtual_coupling_in_free_air_is_linearised_with_its_virtual_mass(
    inertia: float, stiffness: float, damping: float, radius: float
) -> None:
    law = VirtualCoupling(axes="z", stiffness=stiffness, damping=damping, inertia=inertia, period=1e-3)
    free, body = [0.0, 0.0, 1e-3, 0.0, 0.0, 0.0], np.array([0.7, 0.7, 0.7, 1.0, 1.0, 1.0])
    (found,) = loops_at([Controller([law], period=1e-3)], 2, poses=[free], delay=5e-4, inertia=body)
    assert found.spectral_radius == pytest.approx(radius, abs=1e-5)


def test_a_law_that_is_stable_in_the_wall_alone_is_not_stable() -> None:
    unstable = _AtRest([_with_law(Drop(), "light", LAWS["virtual-coupling"]._replace(make=light), "exact")])
    assert unstable.present[0].stable is not True  # in free air, where the light mass is dragged


def light(stiffness: float, damping: float, axes: str, period: float) -> VirtualCoupling:
    """Return a coupling to 0.1 kg, too light for 200 Hz."""
    return VirtualCoupling(axes=axes, stiffness=stiffness, damping=damping, inertia=0.1, period=period)


class OnDevice(Wall):
    """The PD wall, on the device."""

    on: str = "device"


def test_a_law_on_the_device_has_the_clock_of_the_scenes_device(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("maglev_mj.studies.compare._TICKS", 80)  # in less time
    found = {}
    for period in (1e-3, 2.5e-4):
        scene = Drop(pulse=0.0, device_period=period, wall_on="device", duration=0.01)
        margin = judge(wall_loops(scene))
        found[period] = compare(scene, [OnDevice], phases=1).margins["OnDevice"]
        assert found[period]["spectral_radius"] == pytest.approx(margin.spectral_radius)
    assert found[2.5e-4]["noise"] > 2.0 * found[1e-3]["noise"]


def test_the_pulse_removes_the_published_momentum() -> None:
    (wall, *_) = loop_of("pulse").scenes[0].laws()
    controller = Controller([wall], period=0.005)
    controller.step(Sample(0, 0.0, [0.0, 0.0, 1e-3, 0.0, 0.0, 0.0]))
    command = controller.step(Sample(1, 0.005, [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]))  # at the edge, at -0.2 m/s
    force = command.force[2] + (command.extra or [0.0] * 6)[2]
    assert command.pulse_width * force / (0.7 * 0.2) == pytest.approx(1.2857, abs=1e-4)


def test_a_sweep_of_laws_has_the_figures_of_their_comparisons(drops: Comparison) -> None:
    laws = ["pd", "half-sample"]
    found = sweep_laws("drop", laws, "rate", [200.0, 400.0], phases=PHASES)
    columns = drops.columns()
    assert found.figure("penetration")[0].tolist() == columns["penetration"][[0, 2]].tolist()
    assert found.figure("spectral_radius")[0].tolist() == columns["spectral_radius"][[0, 2]].tolist()
    assert found.varied == {"period": [0.005, 0.0025], "law": laws} and found.units["penetration"] == "m"
    region = sweep_laws("drop", ["pd", "half-sample"], values=2, figure="critical_stiffness")
    assert region.varied["damping"][0] == 80.0 and "stiffest stable wall 10107 N/m (pd), " in region.headline
    exact = [largest_stable_stiffness(b, period=0.005, delay=0.0015, mass=0.7) for b in region.varied["damping"]]
    assert region.figure("critical_stiffness")[:, 0] == pytest.approx(np.array(exact), rel=1e-3)
    assert "scene: 6000 N/m, 80 N s/m" in [text.get_text() for text in region.plot().legends[0].get_texts()]
    thrown = sweep_laws("drop", ["filtered"], "stiffness", [2000.0, 30000.0], phases=2)
    assert np.isnan(thrown.figure("penetration")).tolist() == [[False], [True]]
    assert "- unstable" in str(thrown.table())
    with pytest.raises(ParameterError, match="values of delay must be a list of numbers"):
        sweep_laws("drop", ["pd"], "delay", 5)
    with pytest.raises(ParameterError, match="law colgate sets its own gains"):
        sweep_laws("drop", ["colgate"], figure="critical_stiffness")


class Sampled(AxisLaw):
    """PD wall that declares no gains, and counts its calls."""

    stiffness: float = gain("stiffness", "N/m")
    damping: float = gain("damping", "N s/m")
    calls: ClassVar[int] = 0

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        """See `AxisLaw`."""
        Sampled.calls += 1
        return (x <= 0.0) * -(gains.stiffness * x + gains.damping * v)


def alone(stiffness: float, damping: float) -> Any:
    """Return a wall that cannot be computed together with others, and refuses some gains."""
    if damping > 50.0 and stiffness > 9000.0:
        raise ParameterError("too stiff")
    return lambda x, v: [0.0, 0.0, -(stiffness * x[2] + damping * v[2]) * (x[2] <= 0.0), 0.0, 0.0, 0.0]


def test_a_map_of_laws_without_gains_is_that_of_its_points_and_costs_the_calls_of_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("maglev_mj.theory.linearise._MOST_SAMPLES", 80)  # in less time
    dampings, found, calls = [40.0, 250.0, 60.0, 61.0, 62.0], np.zeros((0, 2)), list[int]()
    for values in (dampings[:3], dampings):
        Sampled.calls = 0
        region = sweep_laws("drop", ["pd", Sampled], values=values, figure="critical_stiffness")
        found, calls = region.figure("critical_stiffness"), [*calls, Sampled.calls]
    assert found[:, 1] == pytest.approx(found[:, 0], rel=1e-9) and found[1, 1] == 0.0
    assert calls[1] == calls[0]
    single = sweep_laws("drop", [alone], values=[40.0, 60.0], figure="critical_stiffness")
    assert single.figure("critical_stiffness")[:, 0] == pytest.approx([found[0, 0], np.nan], rel=1e-9, nan_ok=True)


def test_a_margin_is_of_the_walls_own_stiffness_and_of_no_change_more_than_the_searched() -> None:
    loop: dict[str, Any] = {"period": 0.005, "delay": 0.0015, "mass": 0.7}
    stiffest = float(largest_stable_stiffness(80.0, **loop))
    fixed = partial(Wall, axes="z", lower=0.0, stiffness=9000.0)
    for stiffness, law in ((900.0, "pd"), (12000.0, "pd"), (3000.0, fixed)):
        (found,) = compare(Drop(stiffness=stiffness, duration=0.1), {"law": law}, phases=1).margins.values()
        if law is fixed:
            assert found["stiffness"] == pytest.approx(9000.0, rel=1e-6) and found["margin"].beyond  # type: ignore[attr-defined]
            continue
        assert found["spectral_radius"] == pytest.approx(float(spectral_radius(stiffness, 80.0, **loop)), abs=1e-6)
        if stiffness == 900.0:
            assert stiffest > 10.0 * stiffness
        assert found["margin"] == pytest.approx(stiffest / stiffness, rel=1e-9)


class Bang(AxisLaw):
    """Constant force from the depth at which 6 kN/m bear the flotor."""

    depth: float = gain("depth", "m", default=0.7 * GRAVITY / 6000.0)

    def force(self, x: Any, v: Any, gains: Any, state: Any) -> Any:
        """See `AxisLaw`."""
        return (x <= -gains.depth) * 20.0


def test_a_law_that_jumps_where_it_rests_has_noise_and_no_margin() -> None:
    found = compare(Drop(duration=0.1), [Bang], phases=1).margins["Bang"]
    assert found["noise"] > 1.0
    assert np.isnan([found[name] for name in ("stiffness", "spectral_radius", "critical_stiffness", "margin")]).all()


def test_noise_is_that_of_a_flotor_at_rest_in_the_scenes_hand(drops: Comparison, presses: Comparison) -> None:
    assert drops.margins["pd"]["noise"] == pytest.approx(hum(0.0).force.item(), rel=1e-6)
    arm = get_hand("arm")
    assert presses.margins["pd"]["noise"] == pytest.approx(hum(0.0, hand=arm).force.item(), rel=1e-6)
    rest = drops.margins["half-sample"]["stiffness"]
    assert drops.margins["half-sample"]["noise"] == hum(0.0, law=HALF_SAMPLE, stiffness=rest).force.item()


def test_a_law_of_ones_own_stands_in_the_place_of_the_wall(own: Path, drops: Comparison) -> None:
    laws = compare("drop", [f"{own}:Mine"], phases=PHASES)
    for name, values in drops.phases["pd"].figures.items():
        np.testing.assert_array_equal(laws.phases["Mine"].figures[name], values)
    assert drops.margins["pd"] == pytest.approx(laws.margins["Mine"], rel=1e-6)
    kept = laws.phases["Mine"].scene.laws()
    assert type(kept[0]).__name__ == "Mine" and isinstance(kept[1], Hold) and len(kept) == 2


@pytest.mark.usefixtures("no_margins")
def test_laws_have_the_labels_and_numbers_of_a_mapping() -> None:
    def twice(wall: Wall, stiffness: float, mass: float) -> Wall:
        assert mass == 0.7 and wall.stiffness == stiffness
        return Wall(axes="z", lower=0.0, stiffness=2.0 * stiffness, damping=80.0)

    coupled = partial(VirtualCoupling, stiffness=900.0, inertia=0.4)
    found = compare(Drop(stiffness=3000.0), {"twice": twice, "coupled": coupled, "published": "pd"}, phases=2)
    assert list(found.phases) == ["twice", "coupled", "published"]
    same = run_phases(Drop(pulse=0.0), 2, plant="exact").figures["penetration"]
    np.testing.assert_array_equal(found.phases["twice"].figures["penetration"], same)
    law = found.phases["coupled"].scene.laws()[0]
    assert (law.stiffness, law.damping, law.inertia) == (900.0, 80.0, 0.4)


@pytest.fixture
def no_margins(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the search of the margins, which takes most of the time."""
    monkeypatch.setattr("maglev_mj.studies.compare._at_rest", lambda scene: (dict.fromkeys(_MARGINS, 1.0), []))


@pytest.mark.usefixtures("no_margins")
def test_the_table_names_every_law_and_a_law_knows_the_force_limit(drops: Comparison) -> None:
    def limited(axes: str, stiffness: float, force_limit: float) -> Wall:
        return Wall(axes=axes, lower=0.0, stiffness=stiffness, damping=80.0, force_limit=force_limit)

    eight: dict[str, Any] = {f"a law called number {index}": "pd" if index else limited for index in range(8)}
    many = compare(Drop(duration=0.1, force_limit=60.0), eight, phases=2)
    for found in (drops, many):
        lines = str(found.table()).splitlines()
        assert max(map(len, lines)) <= 100
        for label in found.phases:
            assert sum(line.strip().startswith(f"{label} ") for line in lines) >= 3
    depths = 1e3 * drops.phases["pd"].figures["penetration"]
    low, middle, high = (f"{value:.2f}" for value in np.percentile(depths, [10, 50, 90]))
    assert f"{middle} ({low} to {high})" in str(drops.table())
    assert "N s/m, pulse 220 N s/m for law pulse, plant exact" in " ".join(str(drops.table()).split())
    assert "pulse" not in many.table().title and "static stiffness" in str(many.table())
    assert "margin = critical gain / gain in use" in str(many.table())
    assert many.phases["a law called number 0"].scene.laws()[0].force_limit == 60.0


def test_a_data_frame_has_a_row_for_each_law(drops: Comparison) -> None:
    pytest.importorskip("pandas")
    frame = drops.to_pandas()
    assert list(frame["law"]) == list(drops.phases)
    depths = drops.phases["pulse"].figures["penetration"]
    row = frame[frame["law"] == "pulse"].iloc[0]
    assert [row["penetration_10"], row["penetration"], row["penetration_90"]] == np.percentile(
        depths, [10.0, 50.0, 90.0]
    ).tolist()
    assert frame.attrs["units"]["penetration_10"] == "m" and frame.attrs["units"]["hardness"] == "N/m"
    assert frame.attrs["units"]["noise"] == "N"


@pytest.mark.usefixtures("no_margins")
def test_pictures_tell_eight_laws_apart_with_and_without_colour(tmp_path: Path) -> None:
    laws = {f"law {place}": "pd" for place in range(7)} | {"pulse": "pulse"}
    found = compare(Drop(duration=0.1), laws, phases=2)
    assert list(found.pictures) == ["compare_drop", "compare_drop_phases"]
    for name in found.pictures:
        figure = found.plot(picture=name)
        (legend,) = figure.legends
        assert [text.get_text() for text in legend.get_texts()][:8] == list(laws)
        handles = [(line.get_color(), str(line._unscaled_dash_pattern)) for line in legend.legend_handles[:8]]
        assert len(set(handles)) == 8 and len({dash for _, dash in handles}) == 8
    assert "sampling phase 0.5" in details(found.plot())


@pytest.mark.usefixtures("no_margins")
def test_the_command_draws_and_gives_the_numbers_of_the_scenes_own(
    own: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--stiffness", "4000", "--phases", "2", "--plant", "exact", "--json"]
    assert cli.main(["drop", *options, "-"]) == 0
    alone = json.loads(capsys.readouterr().out)["sweep"]["phases"]
    path, laws = tmp_path / "laws.json", ["--law", "pulse", "--law", f"{own}:Mine"]
    charts = ["--out", str(tmp_path), "--format", "svg"]
    assert cli.main(["compare", "drop", *options, str(path), *laws, *charts]) == 0
    out, data = capsys.readouterr().out, json.loads(path.read_text())
    assert "a wall of 4000 N/m" in out and "  Mine " in out and "over 2 sampling phases" in out.replace("\n  ", " ")
    assert all(f"wrote {tmp_path / name}.svg" in out for name in ("compare_drop", "compare_drop_phases"))
    rows = data["laws"]["pulse"]["phases"]
    found = [{name: row[name] for name in row if name != "hardness"} for row in rows]
    assert found == [{name: row[name] for name in found[0]} for row in alone] and data["scene"] == "drop"
    assert len(found[0]) >= 5 and all("hardness" in row for row in rows)
    assert data["columns"]["law"] == ["pulse", "Mine"] == list(data["laws"])


def test_laws_that_cannot_be_taken_are_refused_in_one_line(own: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words, said in (
        (["--law", f"{own}:Other"], "law of mine.py must be one of Mine, Needy (got 'Other')"),
        (["--law", str(own)], "mine.py defines several (Mine, Needy); choose one as mine.py:CLASS"),
        (
            ["--law", f"{own}:Needy"],
            "law Needy must have a default for temperature; drop has device, period, delay, stiffness",
        ),
        ([], "laws must be at least one, without duplicates (got none)"),
    ):
        assert cli.main(["compare", "drop", *words]) == 2
        err = capsys.readouterr().err
        assert said in err and err.count("\n") == 1
    with pytest.raises(ParameterError, match="law must be one of pd"):
        compare("drop", ["pid"])
    held = type("Held", (Drop,), {"laws": lambda scene: [Hold(axes="z", stiffness=scene.stiffness, damping=80.0)]})
    with pytest.raises(ParameterError, match="scene must have a wall as its first law"):
        compare(held(), ["pd"])
