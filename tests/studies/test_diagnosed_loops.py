"""Diagnosis of arrays of loops: every column is what the diagnosis of one loop answers."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

from maglev_mj import diagnose
from maglev_mj.errors import ParameterError
from maglev_mj.studies.diagnosed_loops import DiagnosedLoops
from maglev_mj.theory import largest_stable_stiffness
from maglev_mj.theory.loop_array import LoopArray

LOOPS = 25
FIGURES = {"spectral_radius", "frequency", "doubling_time", "critical_stiffness", "ratio", "critical_delay"}
MORE = {"passive_damping", "amplitude_limit", "hum"}

CASES: dict[str, dict[str, Any]] = {
    "plain": {},
    "friction and resolution": {"friction": 0.3, "quantum": 1e-5},
    "driver lag, none in some": {"driver_lag": True},
    "cutoffs": {"cutoff": True},
    "hand": {"hand": "arm"},
    "mode": {"mode": "180,0.05,0.4"},
    "rotary": {"inertia": True},
    "law on the device": {"periods": [0.0005, 0.002], "count": 5},
    "law on the device at another rate": {"periods": [0.0031], "count": 1},
    "long delay": {"late": 45.0},
}


def arrays_of(name: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return random arrays of loops, and numbers beside them."""
    rng, own = np.random.default_rng([*name.encode()]), dict(CASES[name])
    count, periods = own.pop("count", LOOPS), own.pop("periods", None)
    period = 10.0 ** rng.uniform(-3.5, -2.2, count) if periods is None else rng.choice(periods, count)
    late = rng.uniform(0.0, own.pop("late", 3.5), count)
    late[:3] = (0.0, 1.0, 2.0)[:count]
    mass = 10.0 ** rng.uniform(-1.0, 0.5, count)
    size = mass / period**2
    arrays = {
        "stiffness": size * 10.0 ** rng.uniform(-4.0, -0.3, count),
        "damping": size * period * 10.0 ** rng.uniform(-3.0, 0.0, count),
        "period": period,
        "delay": late * period,
        "mass": mass,
        "own_damping": np.where(rng.random(count) < 0.5, 0.0, rng.uniform(0.0, 3.0, count)),
    }
    arrays["damping"][3:5] = 0.0
    if own.pop("driver_lag", False):
        arrays["driver_lag"] = np.where(np.arange(count) % 3, rng.uniform(1e-5, 2e-3, count), 0.0)
    if own.pop("cutoff", False):
        arrays["cutoff"] = rng.choice([20.0, 60.0, 200.0], count)
    if own.pop("inertia", False):
        arrays["inertia"] = arrays.pop("mass")
    if periods is not None:
        own |= {"device_stiffness": 300.0, "device_damping": 2.0, "device_period": 0.0005}
        arrays["stiffness"][5:8] = 0.0
        arrays["damping"][5:7] = 0.0
    return arrays, own


@pytest.mark.parametrize("name", CASES)
def test_every_column_is_what_one_diagnosis_answers(name: str) -> None:
    arrays, own = arrays_of(name)
    found: DiagnosedLoops = diagnose(**arrays, **own)
    columns, seen = found.columns(), set[str]()
    count = len(columns["stable"])
    for index in range(count):
        row: dict[str, Any] = {key: float(array[index]) for key, array in arrays.items()}
        one = diagnose(**row, **own)
        assert columns["stable"][index] == one.stable
        assert columns["stiffness_searched"][index] == one.critical_stiffness.beyond
        assert columns["delay_searched"][index] == one.critical_delay.beyond
        for key in sorted(FIGURES | MORE):
            value, expected = columns[key][index], float(getattr(one, key))
            # loops computed together share the scaling of a matrix exponential, so the last digits differ
            assert value == pytest.approx(expected, rel=1e-9, abs=0.0, nan_ok=True), (index, key)
            seen |= {key} if math.isfinite(expected) else set()
    assert seen >= FIGURES
    assert seen >= MORE or name != "friction and resolution"
    assert name.endswith("rate") or 0 < columns["stable"].sum() < count


PEN: dict[str, Any] = {"stiffness": 500.0, "damping": 1.0, "rate": 200.0, "delay": 0.005, "mass": 0.15}


def test_arrays_broadcast_and_become_columns_in_their_order() -> None:
    found = diagnose(**PEN | {"stiffness": np.array([[100.0], [400.0]]), "damping": [0.5, 1.0, 3.0]})
    assert found.shape == found.ratio.shape == (2, 3)
    one = diagnose(**PEN | {"stiffness": 400.0, "damping": 3.0})
    assert found.ratio[1, 2] == pytest.approx(one.ratio, rel=1e-9)
    columns = found.columns()
    assert columns["stiffness"].tolist() == [100.0] * 3 + [400.0] * 3
    assert columns["damping"].tolist() == [0.5, 1.0, 3.0] * 2
    assert columns["critical_delay"].tolist() == found.critical_delay.reshape(-1).tolist()
    data = json.loads(json.dumps(found.as_json(), allow_nan=False))
    assert np.shape(data["frequency"]) == (2, 3) and data["amplitude_limit"] == [[None] * 3] * 2
    assert data["stable"] == found.stable.tolist() and found.units["critical_delay"] == "s"


def test_a_rate_is_an_array_like_a_period() -> None:
    rates = [200.0, 1000.0]
    found = diagnose(**PEN | {"rate": rates})
    period = diagnose(**{name: value for name, value in PEN.items() if name != "rate"}, period=[0.005, 0.001])
    np.testing.assert_array_equal(found.ratio, period.ratio)
    assert [*found.values] == ["period"] and not found.assumptions


def test_a_delay_that_is_not_stated_is_one_period_of_each_loop() -> None:
    values = {name: value for name, value in PEN.items() if name != "delay"}
    found = diagnose(**values | {"rate": [200.0, 1000.0]})
    np.testing.assert_array_equal(found.ratio, diagnose(**values | {"rate": [200.0, 1000.0]}, delay=[5e-3, 1e-3]).ratio)
    assert found.assumptions == ("a delay of one period",) and "assumed: a delay of one period" in str(found)


def test_an_end_of_the_search_is_marked() -> None:
    found = diagnose(stiffness=[10.0, 500.0], damping=1.0, rate=1000.0, delay=0.0, mass=0.7, hand="0.1,20,500")
    singles = [
        diagnose(stiffness=k, damping=1.0, rate=1000.0, delay=0.0, mass=0.7, hand="0.1,20,500") for k in (10.0, 500.0)
    ]
    assert found.delay_searched.tolist() == [one.critical_delay.beyond for one in singles]
    assert found.delay_searched.any() and np.isfinite(found.critical_delay).all()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"stiffness": [0.0, 100.0]}, r"stiffness must be above 0 \(got 0\)"),
        ({"stiffness": [100.0, -1.0]}, r"stiffness must be between 0 .* \(got -1.0\)"),
        ({"mass": [1.0, math.nan]}, "mass must be .*nan"),
        ({"stiffness": [1.0, 2.0], "damping": [1.0, 2.0, 3.0]}, r"shapes that broadcast \(got stiffness"),
        ({"stiffness": []}, "must not be empty"),
        ({"delay": [0.1, 2.0]}, r"delay must be between 0 and 1 s \(got 2.0\)"),
        ({"stiffness": [1.0, 2.0], "target": 3.0}, "target must be 2 .*: remedies are those of one loop"),
        ({"device_damping": 1.0, "device_period": [1e-3, 1e-4], "device_delay": 5e-3}, "device_delay must be at most"),
        ({"mass": [1.0], "inertia": 1e-3}, "mass and inertia must not both be given"),
        ({"scene": "drop", "stiffness": [1.0, 2.0]}, "stiffness must be a number beside a scene"),
    ],
)
def test_wrong_arrays_are_refused(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ParameterError, match=words):
        diagnose(**PEN | changes)


def test_driver_lags_are_an_array_of_a_loop() -> None:
    lags = [1e-4, 1e-3]
    around: Any = {"period": 1e-3, "delay": 8e-4, "mass": 0.3}
    single = [float(largest_stable_stiffness(140.9, **around, driver_lag=lag)) for lag in lags]
    np.testing.assert_allclose(largest_stable_stiffness(140.9, **around, driver_lag=lags), single, rtol=1e-12)
    assert single == pytest.approx([48340.252, 21503.423], abs=1e-3)
    with pytest.raises(ParameterError, match="driver_lag must be 0 in all loops, or above 0 in all"):
        largest_stable_stiffness(140.9, **around, driver_lag=[0.0, 1e-3])


def test_a_part_of_loops_has_its_own_maps_of_the_flotor() -> None:
    loop = LoopArray(period=np.array([1e-3, 2e-3]), delay=5e-4)
    both = loop.flotor[0]
    assert loop.flotor[0] is both  # computed once
    part = loop.part((2,), np.array([1]))
    np.testing.assert_array_equal(part.flotor[0], both[1:])


def test_the_delay_of_a_host_without_gains_does_not_matter() -> None:
    on_device: dict[str, Any] = {"device_stiffness": 300.0, "device_damping": 2.0, "device_period": 7e-4}
    found = diagnose(stiffness=0.0, damping=0.0, period=1e-3, mass=0.3, delay=[0.0, 0.1], **on_device)
    assert found.spectral_radius[0] == found.spectral_radius[1]  # to the last bit: the same matrix
    assert found.critical_delay[0] == found.critical_delay[1]
