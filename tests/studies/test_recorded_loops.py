"""Diagnosis of logs of random loops: it names the true loop, or says what is not determined, or refuses."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj import diagnose
from maglev_mj.errors import ParameterError
from maglev_mj.studies.diagnosed_loops import DiagnosedLoop
from maglev_mj.studies.diagnosis import Diagnosis
from tests.studies.exact_log import exact_log

RATIOS = 0.5, 1.0, 2.0, 3.7, 10.0
"""Rates of the logs over those of the loops."""


def random_loop(rng: np.random.Generator) -> dict[str, Any]:
    """Return values of a loop with some of hand, mode, lag, own damping, filter and a law on the device."""

    def chance(share: float) -> bool:
        return bool(rng.random() < share)

    rotary, period = chance(0.25), 10.0 ** rng.uniform(-3.3, -2.1)
    mass, turn = 10.0 ** rng.uniform(-1.2, 0.3) * (0.02 if rotary else 1.0), rng.uniform(0.05, 0.6)
    hand = [max(mass * rng.uniform(0.1, 0.8), 1.1e-3)] if chance(0.35) else []
    hand += [hand[0] * rng.uniform(2.0, 20.0), hand[0] * rng.uniform(50.0, 400.0)] if hand else []
    hand += [mass * rng.uniform(1.0, 20.0), mass * rng.uniform(500.0, 5000.0)] if hand and chance(0.4) else []
    total, ring = mass + (hand[0] if len(hand) == 3 else 0.0), turn / period / (2.0 * math.pi)
    stiffness = total * (turn / period) ** 2
    damping = rng.uniform(0.0, 0.6) * math.sqrt(stiffness * total)
    values: dict[str, Any] = {"stiffness": stiffness, "damping": damping, "period": period}
    values |= {"delay": period * rng.uniform(0.0, 3.0), "inertia" if rotary else "mass": mass}
    values |= {"hand": ",".join(map(repr, map(float, hand)))} if hand else {}
    if chance(0.3):
        mode = ring * rng.uniform(4.0, 20.0), rng.uniform(0.005, 0.05), rng.uniform(-0.8, 0.8)
        values["mode"] = ",".join(map(repr, map(float, mode)))
    values |= {"driver_lag": min(period * rng.uniform(0.02, 0.4), 9e-3)} if chance(0.3) else {}
    values |= {"own_damping": damping * rng.uniform(0.05, 0.6)} if chance(0.4) else {}
    values |= {"cutoff": ring * rng.uniform(2.0, 10.0)} if chance(0.3) else {}
    if chance(0.35):
        step = period / int(rng.integers(2, 9))
        values |= {"device_period": step, "device_delay": step * rng.uniform(0.0, 1.5)}
        values |= {"device_damping": damping * rng.uniform(0.1, 1.0)}
        values |= {"device_stiffness": stiffness * rng.uniform(0.05, 0.5)} if chance(0.4) else {}
        values |= {"device_cutoff": ring * rng.uniform(3.0, 10.0)} if chance(0.3) else {}
    return values


def laws_of(values: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the laws of host and device for `exact_log`."""
    names = "stiffness", "damping", "period", "delay", "cutoff"
    device = {name: values.get(f"device_{name}", 0.0) for name in names}
    return [{name: values.get(name, 0.0) for name in names}, *[device] * bool(device["period"])]


def numbers_of(values: dict[str, Any], name: str) -> list[float]:
    return [float(part) for part in values[name].split(",")] if name in values else []


class Case:
    """A loop with a clear oscillation, its log, and what is stated of it: all, less some, and one value wrong."""

    def __init__(self, rng: np.random.Generator, path: Path) -> None:
        while True:
            self.values = values = random_loop(rng)
            loop, ratio = DiagnosedLoop(**values), float(rng.choice(RATIOS))
            radius, self.frequency = loop.sampled.pole(*loop.gains)
            if not self.frequency:
                continue
            cycle, step = 1.0 / self.frequency, values["period"] / ratio
            if 0.03 < abs(math.log(radius)) * cycle / values["period"] < 0.45 and cycle > 4.0 * step:
                break
        self.body = "inertia" if "inertia" in values else "mass"
        body = {"mass": values[self.body], "hand": numbers_of(values, "hand"), "mode": numbers_of(values, "mode")}
        body |= {"lag": values.get("driver_lag", 0.0), "own": values.get("own_damping", 0.0)}
        x = exact_log(body, laws_of(values), step, int(min(12.0 * cycle / step, 4000)), 1e9)
        x *= rng.uniform(1.5e-3, 6e-3) / np.abs(x).max()
        x = 5e-6 * np.round((x + 2e-6 * rng.standard_normal(len(x))) / 5e-6)
        head = f"time [ms],{'angle [rad]' if self.body == 'inertia' else 'position'}"
        rows = np.column_stack([1e3 * step * np.arange(len(x)), x])
        np.savetxt(path, rows, delimiter=",", header=head, comments="", fmt="%.9g")
        hidden = [name for name in (self.body, "delay", "own_damping") if rng.random() < 0.5]
        self.stated = {name: value for name, value in values.items() if name not in hidden}
        wrong = [name for name in (self.body, "delay") if name in self.stated and rng.random() < 0.15]
        self.wrong = wrong[:1]
        for name in self.wrong:
            self.stated[name] *= rng.uniform(1.3, 2.0) ** rng.choice([-1.0, 1.0])

    def outcome(self, path: Path) -> str:
        """Return what the diagnosis does: true, not determined, refused, or silent for a wrong loop without a word."""
        try:
            found = diagnose(path, **self.stated)
        except ParameterError as error:
            text = str(error)
            word = "".join(self.wrong)
            named = "must be consistent" in text and word in text.partition(" must be consistent")[0]
            return "wrong value named" if self.wrong and named else "refused"
        assert found.measured is not None
        assert found.frequency == pytest.approx(found.measured.frequency, rel=0.02)
        assert found.frequency == pytest.approx(self.frequency, rel=0.02)
        units = " ".join([*found.remarks, *found.assumptions])
        assert not (self.body == "inertia" and ("mass" in units or "N s/m" in units or " kg," in units)), units
        return "true" if self.is_true(found) else "not determined" if said(found) else "silent"

    def is_true(self, found: Diagnosis) -> bool:
        """Return True for the true inertia within 5 %, delay within 0.1 periods, and own damping."""
        values, loop, own = self.values, found.loop, self.values.get("own_damping", 0.0)
        near = abs(loop.body / values[self.body] - 1.0) < 0.05
        near &= abs(loop.delay - values["delay"]) < 0.1 * values["period"]
        least = 0.05 * (values["damping"] + own) + 0.01 * values[self.body] / values["period"]
        return bool(near and abs(loop.own_damping - own) < least)


def said(found: Diagnosis) -> bool:
    """Return True if the diagnosis says what is not determined, or that there is no own damping, as assumed."""
    texts = *found.remarks, *found.assumptions
    return any("not determined" in text or "no damping of the device" in text for text in texts)


def outcomes(count: int, seed: int, folder: Path) -> Counter[str]:
    """Return how often each outcome occurs."""
    rng, path = np.random.default_rng(seed), folder / "log.csv"
    return Counter(Case(rng, path).outcome(path) for _ in range(count))


@pytest.mark.parametrize("seed", range(12))
def test_a_log_of_a_random_loop_is_never_explained_by_another_one(seed: int, tmp_path: Path) -> None:
    assert not outcomes(1, seed, tmp_path)["silent"]


@pytest.mark.study
def test_logs_of_random_loops_name_the_truth(tmp_path: Path) -> None:
    found = outcomes(200, 7, tmp_path)
    print(dict(found))
    assert not found["silent"] and found["true"] >= 120 and found["refused"] <= 40
