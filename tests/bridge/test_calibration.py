"""Calibrations in files: bitwise round trips, one-line refusals."""

import hashlib
import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj.bridge.commissioning.calibration import Calibration, CalibrationError
from maglev_mj.frames import Array
from maglev_mj.plants import MuJoCoPlant
from maglev_mj.plants.coils import CoilMap
from maglev_mj.plants.model import load_model
from maglev_mj.plants.sensor import Beams, beams

_COILS = ("points", "directions", "force_constants", "wrench_per_current", "current_per_wrench")
_BEAMS = ("leds", "directions", "diodes", "across")


def other(seed: int) -> Calibration:
    """Return a calibration without round numbers."""
    draw = np.random.default_rng(seed)
    nominal = Calibration.nominal()

    def turned(values: Array) -> Array:
        moved = values + draw.normal(0.0, 0.02, values.shape)
        return np.asarray(moved / np.linalg.norm(moved, axis=-1, keepdims=True))

    known, light = nominal.coils, nominal.beams
    return Calibration(
        coils=CoilMap(
            points=known.points + draw.normal(0.0, 1e-3, (6, 3)),
            directions=turned(known.directions),
            force_constants=known.force_constants * draw.uniform(0.9, 1.1, 6),
        ),
        beams=Beams(
            leds=light.leds + draw.normal(0.0, 1e-4, (3, 3)),
            directions=turned(light.directions),
            diodes=light.diodes + draw.normal(0.0, 1e-4, (3, 3)),
            across=turned(light.across),
        ),
        spot_offsets=draw.normal(0.0, 1e-4, 6),
        mass=draw.uniform(0.6, 0.9),
        inertia=draw.uniform(8e-4, 1e-3, 3),
        gravity=draw.normal((0.0, 0.0, -9.8), 0.3),
        name=f"device [ {seed} ] of the \u201cbest\u201d sort",
    )


def bits(one: Calibration) -> list[bytes]:
    parts = [getattr(one.coils, name) for name in _COILS] + [getattr(one.beams, name) for name in _BEAMS]
    parts += [one.spot_offsets, one.inertia, one.gravity, np.float64(one.mass), one.hover]
    return [part.tobytes() for part in parts]


def test_the_nominal_calibration_is_the_model_to_the_last_bit() -> None:
    one, device = Calibration.nominal(), load_model("drop")
    assert device.coils is not None
    for name in _COILS:
        assert getattr(one.coils, name).tobytes() == getattr(device.coils, name).tobytes()
    for name in _BEAMS:
        assert getattr(one.beams, name).tobytes() == getattr(beams(), name).tobytes()
    assert one.mass == pytest.approx(device.mass, rel=1e-15)
    np.testing.assert_allclose(one.inertia, device.inertia, rtol=1e-15)
    assert one.gravity.tolist() == [0.0, 0.0, -9.81] and not one.spot_offsets.any()


def test_a_file_gives_back_every_bit(tmp_path: Path) -> None:
    for one in (other(0), Calibration.nominal()):
        one.save(tmp_path / "device.json")
        back = Calibration.load(tmp_path / "device.json")
        assert bits(back) == bits(one)
        assert back.digest == one.digest and len(one.digest) == 16
        assert back.name == one.name
        again = Calibration.from_json(json.loads(json.dumps(one.as_json())))
        assert bits(again) == bits(one) and again.digest == one.digest


def leaves(values: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Return the way to every number."""
    if isinstance(values, float):
        return [path]
    parts = values.items() if isinstance(values, dict) else enumerate(values) if isinstance(values, list) else ()
    return [leaf for name, part in parts for leaf in leaves(part, (*path, name))]


def test_the_digest_sees_every_number_and_only_those() -> None:
    one = other(0)
    seen = {one.digest}
    places = leaves(one.as_json())
    assert len(places) == 18 + 18 + 6 + 9 + 9 + 9 + 18 + 6 + 1 + 3 + 3
    for path in places:
        values = one.as_json()
        parent: Any = values
        for name in path[:-1]:
            parent = parent[name]
        parent[path[-1]] = math.nextafter(parent[path[-1]], math.inf)
        seen.add(Calibration.from_json(values).digest)
    assert len(seen) == len(places) + 1
    assert replace(one, name="another").digest == one.digest
    values = one.as_json()
    del values["name"]  # the rest in any order of keys: firmware in another language can do that too
    text = json.dumps(dict(reversed(values.items())), sort_keys=True, separators=(",", ":"))
    assert one.digest == hashlib.blake2s(text.encode(), digest_size=16).digest()


def change(*path: Any, to: Any = None) -> Callable[[dict[str, Any]], object]:
    """Return a function that changes or removes one value."""

    def apply(values: dict[str, Any]) -> None:
        parent: Any = values
        for name in path[:-1]:
            parent = parent[name]
        if to is None:
            del parent[path[-1]]
        else:
            parent[path[-1]] = to

    return apply


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (change("format", to="maglev_mj calibration 2"), r"format must be 'maglev_mj calibration 1' \(got 'magl"),
        (change("mass"), "mass is missing"),
        (change("coils", to=[1.0]), r"coils must be an object with directions, force_constants, points \(got \[1.0\]"),
        (change("mass", to=0.0), r"mass must be above 0.* \(got 0.0"),
        (change("inertia", 1, to=0.0), r"inertia must be above 0.* \(got 0.0"),
        (change("gravity", to=[0.0, -9.81]), r"gravity must have shape \(3,\) \(got \(2,\)"),
        (change("coils", "directions", 2, to=[0.0, 0.0, 1.01]), "coils directions must be unit vectors .* length 1.01"),
        (change("beams", "across", 1, 1, to=[0.0, 0.1, 0.0]), "beams across must be unit vectors .* length 0.1"),
        (change("coils", "force_constants", 3, to=0.0), "the six coils cannot produce every wrench"),
        (change("beams", "leds", to=[[0.0] * 3] * 2), r"beams leds must have shape \(3, 3\) \(got \(2, 3\)"),
        (change("units", "mass", to="g"), '"mass": "g"'),
    ],
)
def test_a_bad_value_is_one_line_with_file_and_value(edit: Callable[[Any], object], said: str, tmp_path: Path) -> None:
    values = Calibration.nominal().as_json()
    edit(values)
    path = tmp_path / "device.json"
    path.write_text(json.dumps(values))
    with pytest.raises(CalibrationError, match=rf"^calibration '.*device\.json': .*{said}") as caught:
        Calibration.load(path)
    assert "\n" not in str(caught.value)


def test_hover_carries_the_weight() -> None:
    one = other(0)
    wrench = one.coils.wrench(one.hover)
    np.testing.assert_allclose(wrench, [*(-one.mass * one.gravity), 0.0, 0.0, 0.0], atol=1e-12)
    # and so it does in the engine: upright, at the centre, nothing begins to move
    with MuJoCoPlant(coil_map=one.coils, gravity=one.gravity, mass=one.mass) as plant:
        plant.read()
        plant.drive(one.hover.tolist(), after=0.0)
        plant.read()
        _, twist = plant.state()
        assert np.abs(twist).max() < 1e-12 < 1e-3 * 9.81 * plant.period
