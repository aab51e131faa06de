"""Measurements of other programs: public log formats, known answers, and tables that are refused."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from maglev_mj import Recording, analyse, rebuild, record_run
from maglev_mj.analysis import identify
from maglev_mj.cli import main
from maglev_mj.cli.scenes import _path_of
from maglev_mj.device import Device, published_device
from maglev_mj.errors import ParameterError
from maglev_mj.frames import quaternions, rotation_matrix
from maglev_mj.plants.coils import CoilMap
from maglev_mj.plants.hand import GuidedHand
from maglev_mj.recording import InvalidRecordingError, import_table
from maglev_mj.recording.export import export
from maglev_mj.recording.formats import FORMATS
from maglev_mj.recording.text_table import read_table
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.press import Press
from tests.published import EIGHT

TURN = np.array([0.02, -0.03, 0.04])
W, X, Y, Z = (float(part) for part in quaternions(TURN))
WAVE = [1e-3 * math.sin(0.3 * k) for k in range(40)]


def lines(head: str, rows: list[list[Any]], mark: str = ",") -> str:
    return "\n".join(
        [*[head] * bool(head), *(mark.join(f"{part!r}" if part != "" else "" for part in row) for row in rows)]
    )


LOGS: dict[str, tuple[str, str, dict[str, list[float]]]] = {
    "levitation benchmark, blanks without names": (
        lines("", [[0.001 * k, 5e-3 + WAVE[k], 0.1, 6.0, 0.8, 5e-3] for k in range(40)], "  "),
        "time=1 z=2 --units time=s length=m --mass 0.018",
        {"position.z": [5e-3 + part for part in WAVE]},
    ),
    "food acquisition, wrench and pose on rows of their own": (
        lines(
            "Time(s),F_x(N),F_y(N),F_z(N),P_x(m),P_y(m),P_z(m),O_z(rad),O_y(rad),O_x(rad)",
            [
                [0.005 * k, 1.0, 2.0 + k // 2, 3.0, *[""] * 6]
                if k % 2 == 0
                else [0.005 * k, *[""] * 3, 0.3, WAVE[k // 2], 0.1, 0.3, -0.2, 0.1]
                for k in range(80)
            ],
        ),
        "time=Time(s) x=P_x(m) y=P_y(m) z=P_z(m) euler=ZYX:O_z(rad)+O_y(rad)+O_x(rad) hx=F_x(N) hy=F_y(N) hz=F_z(N) "
        "--units time=s length=m angle=rad force=N --scale F_y(N)=-1 --join hold --mass 1",
        {"position.y": WAVE, "hand.y": [-2.0 - k for k in range(40)]},
    ),
    "haptic paddle, counts on a host's clock": (
        lines("time,pos,duty_cycle", [[5.0 + 0.01 * k + 0.002 * (-1) ** k, 100 * k, 0.5] for k in range(40)]),
        "time=time x=pos frx=duty_cycle --units time=s --scale pos=1.2e-6 duty_cycle=1 --rate 100 --mass 1 "
        "--inertia 1,1,1",
        {"position.x": [1.2e-4 * k for k in range(40)], "applied.rx": [0.5] * 40},
    ),
    "force sensor, time since 1970, a second run appended": (
        lines("", [[1.7e9 + 0.002 * k + 3.0 * (k > 19), 1.0, 2.0, 0.1 * k] for k in range(40)]),
        "time=1 hx=2 hy=3 hz=4 --units time=s force=N --rate 500 --mass 1",
        {"hand.z": [0.1 * k for k in range(40)], "tick": [k + 1500.0 * (k > 19) for k in range(40)]},
    ),
    "kinodynamics, quaternions with the scalar last and no time": (
        lines("qX,qY,qZ,qW,gX", [[-X, -Y, -Z, -W, 0.1]] * 40),
        "quaternion=xyzw:qX+qY+qZ+qW --rate 100 --mass 1",
        {"position.ry": [-0.03] * 40},
    ),
}


@pytest.mark.parametrize("name", LOGS)
def test_logs_of_public_data_sets_are_imported(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    text, options, expected = LOGS[name]
    Path("log.csv").write_text(text + "\n")
    assert main(["convert", "log.csv", "log.maglev", "--columns", *options.split()]) == 0
    columns = Recording.load("log.maglev").columns()
    for column, values in expected.items():
        assert_allclose(columns[column], values, rtol=0.0, atol=5e-12)
    assert main(["analyse", "log.maglev"]) == 0


def test_euler_angles_are_about_axes_turned_by_those_before(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text(lines("a,b,c", [[20.0, -30.0, 10.0]] * 16))
    columns, units = {"euler": "ZYX:a+b+c"}, {"angle": "deg"}
    segment = import_table(tmp_path / "log.csv", columns, units, mass=1.0, rate=100.0).segments[0]
    z, y, x = (rotation_matrix(np.radians(angle) * axis) for angle, axis in zip((20, -30, 10), np.eye(3)[::-1]))
    assert_allclose(rotation_matrix(segment.position[0, 3:]), z @ y @ x, atol=1e-14)


COLUMNS = {"time": "1", "quaternion": "xyzw:5+6+7+8"}
COLUMNS |= {key: str(column) for key, column in zip("x y z fx fy fz frx fry frz".split(), (2, 3, 4, *range(9, 15)))}
UNITS = {"time": "ms", "length": "mm", "force": "N", "torque": "Nm"}


def test_an_imported_run_identifies_what_its_recording_does_and_a_wrong_mass_is_said(tmp_path: Path) -> None:
    scene = Drop(pulse=0.0, stiffness=2000.0, damping=30.0, quantize=5e-6, mass=0.3)
    native = record_run(scene, plant="exact").segments[0]
    w, x, y, z = quaternions(native.position[:, 3:])
    stamps = 1e3 * native.time + 5e7 + np.random.default_rng(1).uniform(-0.2, 0.2, len(native))
    table = np.column_stack([stamps, 1e3 * native.position[:, :3], x, y, z, w, native.applied])
    np.savetxt(tmp_path / "rig.csv", table, fmt="%.17g")
    known: dict[str, Any] = {"delay": 1.5e-3, "inertia": native.metadata.inertia[3:], "faces": native.metadata.faces}
    right, wrong = (
        import_table(tmp_path / "rig.csv", COLUMNS, UNITS, mass=mass, rate=200.0, **known).segments[0]
        for mass in (0.3, 0.7)
    )
    assert_allclose(right.position, native.position, rtol=0.0, atol=5e-12)
    found, same, heavy = identify(native), identify(right), identify(wrong)
    for ours in (same, heavy):
        assert ours.delay.value == pytest.approx(found.delay.value, rel=1e-6)
        assert ours.axes["z"].inertia.value == pytest.approx(found.axes["z"].inertia.value, rel=1e-6)
        assert ours.axes["z"].quantum.value == pytest.approx(5e-6)
        for name in ("stiffness", "damping", "share", "commanded_stiffness"):
            estimates = (getattr(one.walls[0], name).value for one in (ours, found))
            assert next(estimates) == pytest.approx(next(estimates), rel=1e-4)
    assert same.replaced == {} and heavy.replaced == {"z": 0.7}
    assert "wrong mass on z: 0.7 kg was stated, 0.3 kg explains" in str(heavy.table())


def test_stamps_off_a_grid_are_resampled_and_identify_no_delay(tmp_path: Path) -> None:
    time = np.cumsum(np.random.default_rng(2).uniform(0.5, 1.5, 400)) * 1e-3
    path, stamps = tmp_path / "log.csv", [1_700_000_000_123_456_789 + round(1e9 * part) for part in time.tolist()]
    rows = [[stamp, math.sin(30.0 * at), float(at > 0.2)] for stamp, at in zip(stamps, time.tolist())]
    path.write_text(lines("", rows[:200] + rows[220:]))
    columns, units = {"time": "1", "z": "2", "fz": "3"}, {"time": "ns", "length": "m", "force": "N"}
    with pytest.raises(ParameterError, match=r"within 0.25 periods .* \S+ Hz, one row each .* in row \d+.: resample"):
        import_table(path, columns, units, mass=0.3)
    recording = import_table(path, columns, units, mass=0.3, rate=1000.0, resample=True)
    segment, found = recording.segments[0], identify(recording.segments[0])
    assert "resampled" in recording.events[0] and 15 <= np.diff(segment.tick).max() <= 25
    assert_allclose(segment.position[:, 2], np.sin(30.0 * (time[0] + segment.time)), atol=1e-5)
    assert set(segment.applied[:, 2]) == {0.0, 1.0}
    assert read_table(f"{stamps[0]}\n{stamps[0] + 1}\n".encode()).stamps("1")[1] == 1.0
    assert found.axes["z"].delay.why == found.axes["z"].noise.why == "resampled"


@pytest.mark.parametrize("device", [published_device(), EIGHT])
def test_currents_give_the_wrench_of_the_coils(device: Device, tmp_path: Path) -> None:
    coils = CoilMap.of(device)
    (tmp_path / "log.csv").write_text(lines("", [[k, *coils.currents(np.arange(6.0)).tolist()] for k in range(16)]))
    columns = {"time": "1", **{f"i{k}": str(k + 2) for k in range(len(coils))}}
    units = {"time": "ms", "current": "A"}
    for wrong in ({"i7" if len(coils) == 6 else "i8": "2"}, {"i0": "2"}):
        with pytest.raises(ParameterError, match=f"column.* i{len(coils) - 1}"):
            import_table(tmp_path / "log.csv", {"time": "1"} | wrong, units, mass=0.7, inertia=1e-3, coils=coils)
    segment = import_table(tmp_path / "log.csv", columns, units, mass=0.7, inertia=1e-3, coils=coils).segments[0]
    assert_allclose(segment.applied, np.tile(np.arange(6.0), (16, 1)), atol=1e-12)


def test_a_measured_recording_is_replayed_exported_and_analysed_without_a_simulation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("log.csv").write_text(LOGS["levitation benchmark, blanks without names"][0])
    recording = import_table("log.csv", {"time": "1", "z": "2"}, {"time": "s", "length": "m"}, mass=0.018)
    recording.save("log.maglev")
    for words in ("replay log.maglev --check", "analyse log.maglev --out ."):
        assert main(words.split()) == 0
        assert "without controller" in " ".join(capsys.readouterr().out.split())
    report = analyse(Recording.load("log.maglev").segments[0], rebuild)
    assert report.simulated is None and report.kind == "measured"
    with pytest.raises(InvalidRecordingError, match="without controller"):
        rebuild(recording.segments[0].setup, None)
    for kind in FORMATS:
        export(recording, kind, Path(f"log_.{kind}"))


GOOD = [[0.01 * k, WAVE[k], 0.0, 0.0, 1.0] for k in range(40)]
HEAD = "t,z,a,b,q"


def changed(row: int, column: int, value: Any) -> str:
    return lines(
        HEAD, [[*part[:column], value, *part[column + 1 :]] if k == row else part for k, part in enumerate(GOOD)]
    )


BROKEN = {
    "empty": ("", "", "must have rows of numbers"),
    "no rows": (HEAD, "", "must have rows of numbers"),
    "repeated name": (lines("t,z,a,a,q", GOOD), "", "column 'a' must be named once"),
    "short row": (lines(HEAD, [*GOOD[:5], [1.0], *GOOD[5:]]), "", "row 7 must have 5 values"),
    "word": (changed(3, 1, "left"), "", "left.* in row 5, column 'z'"),
    "infinity": (changed(3, 1, math.inf), "", "got 'inf' in row 5"),
    "missing stamp": (changed(3, 0, ""), "", "time must be known .got nan in row 5.: delete it"),
    "equal stamps": (changed(3, 0, 0.02), "", "time must increase .got 0 in row 5.: .* or give rate"),
    "back": (changed(3, 0, 0.0), "", "time must not go back .got -0.02 in row 5.: split"),
    "off grid": (changed(3, 0, 0.034), "", "within 0.25 periods of its tick at .* in row 5.: resample"),
    "other rate": (lines(HEAD, GOOD), "--rate 110", "tick at 110 Hz"),
    "half missing": (
        lines(HEAD, [[k, "" if k % 3 else 0, 0, 0, 1] for k in range(40)]),
        "",
        "got 26 of 40, first row 3",
    ),
    "few samples": (lines(HEAD, GOOD[:15]), "", "at least 16 samples .got 15"),
    "absent column": (lines(HEAD, GOOD), "--columns x=zz", "column must be one of t, z, a, b, q .got 'zz'"),
    "unknown value": (lines(HEAD, GOOD), "--columns up=a", "columns must be one of time"),
    "value twice": (lines(HEAD, GOOD), "--columns z=a", "z must be given once .got z and a"),
    "no unit": (lines(HEAD, GOOD), "--columns fz=a", "units must be stated for 'a': force=N|mN; counts need a scale"),
    "wrong unit": (lines(HEAD, GOOD), "--units force=kg", "unit of force must be one of N, mN"),
    "wrong quantity": (lines(HEAD, GOOD), "--units mass=kg", "quantity of units must be one of"),
    "norm": (lines(HEAD, GOOD), "--columns quaternion=wxyz:a+b+t+b --scale b=1", "norm 1 .got 0 in row 2"),
    "order": (lines(HEAD, GOOD), "--columns quaternion=a+b+z+q", "quaternion must be an order and its columns"),
    "euler": (lines(HEAD, GOOD), "--columns euler=ZZX:a+b+q --units angle=deg", "euler must be an order"),
    "two rotations": (lines(HEAD, GOOD), "--columns rx=a quaternion=xyzw:a+a+b+q --units angle=rad", "must be one of"),
    "turn": (changed(5, 2, 180.0), "--columns rx=a --units angle=deg", "1 rad a sample .got 3.142 in row 7"),
    "torque": (lines(HEAD, GOOD), "--columns frx=a --units torque=Nm", "inertia must be given"),
    "moments": (lines(HEAD, GOOD), "--inertia 1,2", "inertia must be a number or have shape .3,. .got .2,"),
    "currents": (lines(HEAD, GOOD), "--columns i0=a --units current=A", "currents must be i0 to i5"),
    "face": (lines(HEAD, GOOD), "--face z:0:left", "side of a face must be one of above, below, as in"),
    "delay": (lines(HEAD, GOOD), "--delay 0.2", "delay must be at most 0.1 s, 10 periods"),
    "separator": (
        lines(HEAD, GOOD),
        "--separator semicolon",
        "rows of numbers .got none in 41 lines with separator semi",
    ),
    "names": (lines(HEAD, GOOD), "--names t,z", "names must be one for each of 5 columns .got 2"),
    "decimal": (
        lines(HEAD, GOOD, ";"),
        "--decimal comma",
        "numbers must have a decimal comma .got '0.0' in row 2, column 't'",
    ),
    "format": (lines(HEAD, GOOD), "--to xls", "format of out must be one of maglev, npz"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_table_or_option_is_refused_in_a_line(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    text, options, message = BROKEN[name]
    Path("log.csv").write_text(text)
    words = "convert log.csv log.maglev --columns time=t z=z --units time=s length=m --mass 1".split()
    assert main(words + options.split()) == 2
    said = capsys.readouterr()
    assert said.out == "" and said.err.count("\n") == 1 and [path.name for path in Path().iterdir()] == ["log.csv"]
    assert re.search(message, said.err), said.err


def test_a_measured_motion_is_the_path_of_a_hand(tmp_path: Path) -> None:
    period, turns = 0.005, 10.0  # 20 samples per turn
    time = 7.0 + period * np.arange(201)  # whose first stamp is not 0
    amplitude, rate = 1e-3, 2.0 * math.pi * turns
    np.savetxt(tmp_path / "rig.csv", np.column_stack([time, 1e3 * amplitude * np.sin(rate * (time - 7.0))]))
    rig, flown = tmp_path / "rig.maglev", tmp_path / "flown.maglev"
    units = ["--units", "time=s", "length=mm"]
    assert not main(
        ["convert", str(tmp_path / "rig.csv"), str(rig), "--columns", "time=1", "x=2", *units, "--mass", "0.3"]
    )
    assert not main(["run", "joystick", "--no-wall", "--hand-path", str(rig), "--record", str(flown)])
    segment = Recording.load(flown).segments[0]
    target = _path_of(rig)
    fine = np.arange(0.0, 1.0, period / 7.0)  # between the samples too
    path = np.array([target.at(each)[0] for each in fine])
    errors = np.abs(path - amplitude * np.sin(rate * fine)) / amplitude
    assert errors[7:-7].max() < 5e-4 and errors.max() < 2e-3  # slopes of the first and the last sample are one-sided
    assert np.abs(np.diff(path) / np.diff(fine)).max() < 1.03 * amplitude * rate  # does not stop at each sample
    assert len(segment) * period > 1.0 and np.ptp(segment.position[:, 0]) > 0.1 * amplitude
    guided = Press().guided(target).scripted_hand()
    assert isinstance(guided, GuidedHand) and guided.hand.values == Press().impedance.values and guided.path is target
