"""Device files: every key, the shipped devices, and the models generated from them."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from maglev_mj import Device, ExactPlant, load_model
from maglev_mj import device as device_module
from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.safety import HostLimits, Limits, SpotGuard, limits_of
from maglev_mj.bridge.twin.twin import TwinParameters
from maglev_mj.cli import main
from maglev_mj.device import SensorSection, devices
from maglev_mj.errors import ParameterError
from maglev_mj.parameters import Parameters, param
from maglev_mj.plants.model import body_of, model_path
from maglev_mj.plants.sensor import beams, geometry_of, tracker_of
from maglev_mj.scenes.interactive import Joystick
from maglev_mj.session import Session
from maglev_mj.session.session import device_controller
from maglev_mj.spec import DRIVER_TIME_CONSTANT, ESCAPE, INERTIA, RANGE, RESOLUTION, Spec
from maglev_mj.studies.record import json_text
from maglev_mj.studies.stability_map import RestingWall
from tests.published import EIGHT

DEVICES = {name: Device.load(name) for name in devices()}
COILS = [name for name, device in DEVICES.items() if device.coils is not None]


def keys(text: str) -> Iterator[tuple[int, str, str, str]]:
    """Yield line number, section, key and value of each row of a file."""
    section = ""
    for number, line in enumerate(text.splitlines()):
        if match := re.fullmatch(r"\[(\w+)\]", line):
            section = f"{match[1]}."
        elif match := re.fullmatch(r"(\w+) = (.*)", line):
            yield number, section, match[1], match[2]


def damages(value: str) -> Iterator[str]:
    """Yield values of another type, and outside the bounds."""
    yield "17" if value.startswith('"') else '"text"'
    yield "true" if value[0] in "[0123456789-" else "[1.0]"
    if value[0] not in '"tf' and not value.startswith('["'):
        yield re.sub(r"[\d.e-]+|inf", "nan", value)
        yield "[]" if value.startswith("[") else "-1e12"


ROWS = [(name, *row) for name, device in DEVICES.items() for row in keys(device.toml())]


@pytest.mark.parametrize(("name", "line", "section", "key", "value"), ROWS)
def test_a_wrong_value_is_refused_in_one_line(
    name: str, line: int, section: str, key: str, value: str, tmp_path: Path
) -> None:
    rows, path = DEVICES[name].toml().splitlines(), tmp_path / "own.toml"

    def message(row: str) -> str:
        path.write_text("\n".join([*rows[:line], row, *rows[line + 1 :]]), encoding="utf-8-sig")
        try:
            Device.load(path)
        except ParameterError as error:
            assert "\n" not in str(error) and str(error).startswith(f"device file {str(path)!r}: ")
            return str(error)
        return ""

    assert message(rows[line]) == ""
    assert f"{section}{key}x" in message(f"{key}x = {value}")
    for damaged in damages(value):
        assert f"{section}{key}" in message(f"{key} = {damaged}"), damaged
    missing = message("")
    assert not missing or f"{section}{key}" in missing or key in missing  # a default, or the key


NESTED = {"list": ("[", "]"), "table": ("{a = ", "}"), "object": ('{"a": ', "}")}


@pytest.mark.parametrize("depth", [10, 100, 900, 3000])
@pytest.mark.parametrize("shape", NESTED)
def test_a_value_nested_too_deep_is_one_line_with_the_file(shape: str, depth: int, tmp_path: Path) -> None:
    before, after = NESTED[shape]
    value, stage, path = f"{before * depth}1{after * depth}", DEVICES["stage"].toml(), tmp_path / "deep"
    texts = {f"x = {value}\n{stage}": "device", stage.replace("mass = 0.3", f"mass = {value}"): "device"}
    texts |= {value: "profile", f'{{"speed_limit": {value}}}': "profile"}
    texts |= {
        f"{stage}[body{'.a' * depth}]\nb = 1\n": "device",
        stage.replace("0.3\n", f"1{'0' * depth * 2}\n"): "device",
    }
    for text, kind in texts.items():
        path = path.with_suffix(".toml" if kind == "device" else ".json")
        path.write_text(text, encoding="utf-8")
        with pytest.raises(ParameterError) as caught:
            Device.load(path) if kind == "device" else HostLimits.load(path)
        assert str(caught.value).startswith(f"{kind}") and str(path) in str(caught.value)
        assert "\n" not in str(caught.value)


def test_a_result_nested_too_deep_is_one_line() -> None:
    deep: list[Any] = []
    for _ in range(100_000):
        deep = [deep]
    with pytest.raises(ParameterError, match="a result must hold values of JSON, which are nested less"):
        json_text("a result", deep)


DIGESTS = {
    "arm": "6217a122fd6daa475477f7135515cd87",
    "stage": "77e41b0f9fe2c6ee4d72184c8c57443f",
    "ubc": "0acec8bc602ee426cf53e57c4f91e77a",
}
NEW_KEY = "a new key? give its neutral value in _NEUTRAL"


def test_digests_stay_so_that_devices_in_use_and_later_hosts_agree() -> None:
    keys = {(section, row.name) for section, kind in device_module._SECTIONS.items() for row in kind.parameters()}
    first = {(section, name) for section, names in device_module._FIRST.items() for name in names.split()}
    assert keys - first == device_module._NEUTRAL.keys(), NEW_KEY
    assert first <= keys and not first & device_module._NEUTRAL.keys()
    assert {name: device.digest.hex() for name, device in DEVICES.items()} == DIGESTS, NEW_KEY


class Sensing(SensorSection):
    """Sensor with two keys that are newer, one of them with a default that is not neutral."""

    hysteresis: float = param("play", "m", default=0.0, at_least=0.0)
    gain: float = param("gain", default=2.0, above=0.0)


class Cable(Parameters):
    """A section that is newer."""

    stiffness: float = param("stiffness", "N/m", default=0.0, at_least=0.0)


@pytest.mark.parametrize("name", DEVICES)
def test_a_new_key_counts_unless_it_has_its_neutral_value(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device_module, "_NEUTRAL", {("sensor", "gain"): 1.0})
    known = DEVICES[name].sensor.as_json()

    def digest(device: Device, **values: Any) -> str:
        return replace(device, sensor=Sensing(**known, **values)).digest.hex()

    assert digest(DEVICES[name], gain=1.0) == DIGESTS[name]
    others = {digest(DEVICES[name], **values) for values in ({}, {"gain": 1.0, "hysteresis": 1e-5}, {"gain": 3.0})}
    assert len(others) == 3 and DIGESTS[name] not in others

    class Tethered(Device):
        cable = Cable()

    monkeypatch.setattr(device_module, "_SECTIONS", {**device_module._SECTIONS, "cable": Cable})
    own = {item.name: getattr(DEVICES[name], item.name) for item in fields(Device)}
    assert Tethered(**own).digest.hex() == DIGESTS[name]
    monkeypatch.setattr(Tethered, "cable", Cable(stiffness=1.0))
    assert Tethered(**own).digest.hex() != DIGESTS[name]


@pytest.mark.parametrize("name", DEVICES)
def test_a_file_holds_every_value(name: str) -> None:
    device = DEVICES[name]
    copy = Device.parse(device.toml())
    assert copy == device and copy.digest == device.digest
    assert copy.change("loop", delay=1e-4).digest != device.digest
    assert Device.parse(device.toml().replace(f'"{name}"', '"copy"')).digest == device.digest
    assert device.published == (name == "ubc")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("format = 2\nname = 'x'", "format must be 1"),
        ("format = 1\nname = 'x'\n[bode]\nmass = 1", "section must be one of"),
        ("format = 1\nname = 'x'\n[body]\nmass = 1", "loop.rate is missing"),
        ("format = 1\nname = 'x'\n[body]\nmass = 1\n[loop]\nrate = 100\ndelay = 0", r"exactly one of \[coils\] and"),
        ("format = 1\nname =", "not TOML"),
    ],
)
def test_a_wrong_file_is_refused_in_one_line(text: str, message: str) -> None:
    with pytest.raises(ParameterError, match=message) as error:
        Device.parse(text)
    assert "\n" not in str(error.value)


def test_the_published_device_is_that_of_the_paper_and_of_its_model() -> None:
    device, model, sensor = DEVICES["ubc"], load_model("maglev"), beams()
    assert device.coils is not None and model.coils is not None
    for exact, value in ((INERTIA, device.inertia), (RANGE, device.reach), (RESOLUTION, device.sensor.resolution)):
        np.testing.assert_array_equal(exact, value)
    times = 1.0 / Spec.control_rate.value, Spec.transport_delay.value, DRIVER_TIME_CONSTANT, ESCAPE
    assert times == (device.period, device.delay, device.driver.time_constant, device.escape)
    currents = device.coils.current_limit, device.coils.continuous_current
    assert currents == (Spec.peak_current.value, Spec.continuous_current.value)
    for name in ("points", "directions", "force_constants"):
        np.testing.assert_allclose(getattr(device.coils, name), getattr(model.coils, name), atol=1e-15)
    for name in ("leds", "directions", "diodes", "across"):
        np.testing.assert_allclose(getattr(device.sensor, name), getattr(sensor, name), atol=1e-15)
    limits = [body_of(keywords).force_limit for keywords in ({}, {"model": device}, {"model": "drop"})]
    assert limits[:2] == [Spec.largest_vertical_force.value] * 2 and limits[2] == pytest.approx(limits[0])


def test_the_force_limit_of_your_own_model_is_that_of_its_current_limit() -> None:
    spec = mujoco.MjSpec.from_file(str(model_path("drop")))
    spec.actuators[1].ctrlrange = [-5.0, 5.0]
    assert body_of({"model": spec}).force_limit == pytest.approx(30.0)


def test_held_axes_weight_and_drop_follow_the_device_in_use() -> None:
    walls = {name: RestingWall(device=name, period=1e-3, delay=1e-3, mass=0.3) for name in ("ubc", "stage")}
    held: dict[str, Any] = {name: wall.laws()[1] for name, wall in walls.items()}
    stiffness = {name: law.stiffness[2:] for name, law in held.items()}  # of rotations
    ratio = DEVICES["stage"].inertia[3:] / DEVICES["ubc"].inertia[3:]
    np.testing.assert_allclose(stiffness["stage"] / stiffness["ubc"], ratio)
    assert device_controller(Joystick(device="stage")).carried[2] == pytest.approx(0.3 * 9.81)
    session = Session(Joystick(device="stage"))
    session.act("drop")
    assert session.snapshot().pose[2] == pytest.approx(4.0 / 4.5 * 2e-3)


@pytest.mark.parametrize("name", DEVICES)
def test_the_generated_model_is_the_device(name: str) -> None:
    device = DEVICES[name]
    model, exact = load_model(device), ExactPlant(model=device)
    np.testing.assert_allclose([model.mass, *model.inertia], device.inertia[2:], rtol=1e-12)
    np.testing.assert_allclose(model.range[:3], device.reach[:3], rtol=1e-12)
    assert model.range[3] == pytest.approx(device.reach[3:].min())
    np.testing.assert_array_equal(model.gravity, device.body.gravity)
    np.testing.assert_array_equal(exact.inertia, device.inertia)
    np.testing.assert_allclose(exact.load, device.mass * np.array([*device.body.gravity, 0.0, 0.0, 0.0]))
    assert (model.coils is None) == (device.coils is None)
    if model.coils is not None:
        limit = model.coils.largest_wrench(device.coils.current_limit)  # type: ignore[union-attr]
        np.testing.assert_allclose(limit, device.force_limit, rtol=1e-12)


def test_points_are_from_the_centre_of_mass() -> None:
    stage = DEVICES["stage"]
    assert stage.coils is not None
    shifted = stage.change("body", centre_of_mass=(0.0, 0.0, 0.0))
    points = [(x, y, z - 0.002) for x, y, z in stage.coils.points]
    np.testing.assert_allclose(shifted.change("coils", points=points).force_limit, stage.force_limit, rtol=1e-12)
    assert math.isclose(stage.force_limit[2], 33.0) and stage.rest[2] == -0.002


def test_the_page_names_every_key() -> None:
    page = (Path(__file__).parents[1] / "docs/howto/describe_your_device.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`(\w+\.\w+)`", "".join(line for line in page.splitlines() if line.startswith("| `"))))
    every = {
        f"{section}.{key}"
        for device in DEVICES.values()
        for section, part in device.as_json().items()
        for key in part
        if section != "axes"
    }
    assert named - {"ubc.toml", "stage.toml", "arm.toml"} == every


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("mass", lambda spec: setattr(spec.body("flotor"), "mass", 0.31), "mass must be that of the device, 0.3 kg"),
        ("inertia", lambda spec: setattr(spec.body("flotor"), "inertia", [2e-4] * 3), "inertia must be that of"),
        ("range", lambda spec: setattr(spec.joint("z"), "range", [-3e-3, 3e-3]), "range must be that of the device"),
        (
            "coil",
            lambda spec: setattr(spec.site("vertical1"), "pos", [0.0, 0.03, 0.004]),
            "point of coil vertical1",
        ),
        (
            "gear",
            lambda spec: setattr(spec.actuators[3], "gear", [0, 0.98, 0.2, 0, 0, 0]),
            "direction of coil horizontal0",
        ),
        (
            "gain",
            lambda spec: spec.actuators[2].gainprm.__setitem__(0, 1.2),
            "force constant of coil vertical2",
        ),
        ("limit", lambda spec: setattr(spec.actuators[0], "ctrlrange", [-9.0, 9.0]), "current limit must be that of"),
    ],
    ids=lambda value: value if isinstance(value, str) and " " not in value else "",
)
def test_your_own_model_is_checked_against_the_device(
    name: str, change: Any, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    spec, path = mujoco.MjSpec.from_string(DEVICES["stage"].mjcf()), tmp_path / "mine.xml"
    path.write_text(spec.to_xml())
    assert not main(["card", "stage", "--table1", "--model", str(path)])
    change(spec)
    path.write_text(spec.to_xml())
    assert main(["card", "stage", "--table1", "--model", str(path)]) == 2
    assert capsys.readouterr().err.startswith(f"maglev-mj card: {message}")


@pytest.mark.parametrize("name", ["ubc", "stage"])
def test_the_firmware_s_header_has_the_limits_of_the_device(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert not main(["card", name, "--header"])
    members = dict(re.findall(r"\.(\w+) = (\{[^}]*\}|[^ ,\n]+)", capsys.readouterr().out))
    device, struct = DEVICES[name], Path("scripts/firmware/maglev_firmware.h").read_text()
    assert device.coils is not None
    fields = re.search(r"struct maglev_profile \{(.*?)\n\};", struct, re.S)
    assert fields is not None  # all but the key, which the build adds
    declared = set(re.findall(r"^ +\w+ (\w+)(?:\[\w+\])?;", fields[1], re.M))
    assert declared - members.keys() == {"key", "key_length"} and not members.keys() - declared
    limits = [float(members[part]) for part in ("current_limit", "continuous_current", "thermal_time")]
    assert limits == [device.coils.current_limit, device.coils.continuous_current, device.coils.thermal_time]
    assert int(members["period"]) == round(device.period * 1e9) and members["lockstep"] == "0"
    assert bytes(map(int, members["calibration"].strip("{}").split(", "))) == device.digest


@pytest.mark.parametrize("count", [5, 7])
def test_each_coil_needs_a_point_a_direction_and_a_constant(count: int) -> None:
    points = np.zeros((count, 3)).tolist()
    name, needed = ("points", 6) if count < 6 else ("directions", 7)
    with pytest.raises(ParameterError, match=f"^{name} must have {needed} entries, one for each of six or more coils"):
        DEVICES["stage"].change("coils", points=points)


UP, ALONG = [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]


@pytest.mark.parametrize(("directions", "axes"), [([UP] * 8, "x, y, rz"), ([UP] * 5 + [ALONG] * 3, "y")])
def test_coils_that_cannot_give_every_wrench_are_refused_by_axis(directions: Any, axes: str) -> None:
    why = f"the coil map is singular, 8 coils cannot drive {axes} alone"
    with pytest.raises(ParameterError, match=f"^points and directions must allow every wrench: {why}$"):
        EIGHT.change("coils", directions=directions)


def seen(seed: int) -> Device:
    """Return a random device: a pose sensor, or three beams on three diodes as on the published joystick."""
    draw = np.random.default_rng(seed)
    device = DEVICES["stage" if seed % 2 else "ubc"].change(
        "range",
        translation=np.exp(draw.uniform(math.log(3e-4), math.log(0.05), 3)).tolist(),
        rotation_deg=np.exp(draw.uniform(0.0, math.log(25.0), 3)).tolist(),
    )
    sensor, offsets = device.sensor, (1e-3 * draw.uniform(-1.0, 1.0, 6)).tolist()
    if sensor.kind == "pose":
        return device.change("sensor", lever=float(draw.uniform(0.001, 1.0)), offsets=offsets)
    moved = {name: getattr(sensor, name) + 0.01 * draw.uniform(-1.0, 1.0, (3, 3)) for name in ("leds", "diodes")}
    beams = np.array(sensor.directions) + 0.3 * draw.uniform(-1.0, 1.0, (3, 3))
    directions = (beams / np.linalg.norm(beams, axis=1)[:, None]).tolist()
    moved = {name: points.tolist() for name, points in moved.items()}
    return device.change("sensor", directions=directions, offsets=offsets, **moved)


def test_every_kind_of_sensor_is_among_the_random_devices() -> None:
    (kinds,) = (item.choices for item in device_module.SensorSection.parameters() if item.name == "kind")
    assert {seen(seed).sensor.kind for seed in range(2)} == {*kinds}, "draw a device of each kind in `seen`"


@pytest.mark.parametrize("seed", [*range(40), -1])
def test_no_pose_of_the_range_is_out_of_range_of_the_sensor(seed: int) -> None:
    """The limit follows from range and geometry: poses of the range are within it, poses outside the envelope soon not.

    Before, the published joystick moved, turned on three axes, was out of range: 15.2 mm on a diode, limit 12 mm.
    """
    device = DEVICES["ubc"] if seed < 0 else seen(seed)
    draw, limit = np.random.default_rng(seed + 1), limits_of(device).spot_limit
    geometry, offsets = geometry_of(device), np.array(device.sensor.offsets)
    ends = draw.uniform(-1.0, 1.0, (300, 6)) * device.reach
    ends[::2] = np.sign(ends[::2]) * device.reach
    spots = geometry.spots(ends) + offsets
    guard, track = SpotGuard(Limits(spot_limit=limit, spot_speed=100.0), 1.0), tracker_of(geometry, device.scale.reach)
    for count, (six, pose) in enumerate(zip(spots.tolist(), ends)):
        assert not guard.check(six, 7, count, 1)
        if np.linalg.norm(pose[3:]) < 0.8:
            assert track((six - offsets).tolist()) == pytest.approx(pose.tolist(), abs=1e-9)
    outer = geometry.spots(1.2 * draw.choice([-1.0, 1.0], (64, 6)) * device.scale.reach)
    assert np.abs(outer).max() > 0.9 * (limit - 1e-3)  # no wider than needed


def test_a_sensor_that_does_not_see_its_range_is_refused() -> None:
    blind = DEVICES["ubc"].change("range", rotation_deg=(70.0, 70.0, 70.0))
    with pytest.raises(ParameterError, match=r"^sensor\.directions: a beam turns past its diode within the range"):
        limits_of(blind)
    endless = DEVICES["stage"].change("range", translation=(math.inf,) * 3)
    assert limits_of(endless).spot_limit == pytest.approx(0.0073, abs=2e-4)  # the envelope of the published joystick


def test_the_limits_of_a_device_are_checked_with_its_meter() -> None:
    stage = DEVICES["stage"]
    with pytest.raises(ParameterError, match=r"three times coils\.meter, 0\.07 A \(got 0\.195 A\)"):
        limits_of(stage.change("coils", meter=0.07))
    assert limits_of(DEVICES["ubc"]).spot_limit == Limits().spot_limit
    assert TwinParameters(calibration=Calibration.of(stage)).profile.limits.spot_limit == limits_of(stage).spot_limit
