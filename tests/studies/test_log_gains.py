"""Gains from logs of hidden devices, checked by eigenvalues of another code; logs that do not tell are refused."""

from __future__ import annotations

import math
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from maglev_mj import Hand, diagnose
from maglev_mj.cli import main
from maglev_mj.errors import ParameterError
from maglev_mj.plants.hand import Mode
from maglev_mj.studies.log_gains import LogGains, gains_from_log
from maglev_mj.studies.oscillation import LoggedMotion, find_oscillation
from maglev_mj.theory.loop import Loop
from maglev_mj.theory.two_rates import DeviceLaw
from tests.studies.exact_log import Vector
from tests.studies.hidden_device import Hidden, critical, hidden, log_of, ring

QUIET = Hidden(0.005, 0.0015, {"mass": 0.7, "own": 0.0})
GAINS = 2000.0, 15.0


def gains_of(
    device: Hidden,
    stiffness: float,
    damping: float,
    log: Vector,
    /,
    *,
    target: float = 2.0,
    stated: Any = None,
    **loop: Any,
) -> LogGains:
    """Return the gains from a log of a release whose start is known to be one."""
    time = device.period * np.arange(len(log))
    seen = find_oscillation(time, log, period=device.period)
    around = Loop(
        **{"stiffness": stiffness, "damping": damping, "period": device.period, "delay": 0.0, "inertia": 1.0} | loop
    )
    motion = LoggedMotion(log, device.period, np.ones(len(log), dtype=np.bool_))
    return gains_from_log(motion, around, seen, target=target, stated=stated or {})


def reached(device: Hidden, rng: np.random.Generator) -> float:
    """Return the true ratio of critical to recommended stiffness of a hidden device; NaN for a refusal."""
    stiffness, damping, log = ring(device, rng)
    try:
        found = gains_of(device, stiffness, damping, log)
    except ParameterError as refusal:  # no oscillation of one pole
        assert re.search("friction|5 half cycles", str(refusal))
        return math.nan
    if found.refused:
        assert "state --own-damping" in found.refused or "ring it" in found.refused
        return math.nan
    true = [("mass", device.body["mass"]), ("delay", device.delay), ("own damping", device.body["own"])]
    for name, value in true:
        width = found.values[name].high - found.values[name].low
        assert found.values[name].low - width <= value <= found.values[name].high + width, name
    return critical(device, found.damping) / found.stiffness


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_gains_from_a_log_reach_the_ratio(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ratio = reached(hidden(rng)._replace(friction=0.0), rng)
    assert 1.99 <= ratio < 2.3


@pytest.mark.study
def test_thirty_hidden_devices() -> None:
    rng = np.random.default_rng(70)
    ratios = [reached(hidden(rng), rng) for _ in range(30)]
    told = [ratio for ratio in ratios if not math.isnan(ratio)]
    assert len(told) >= 18 and min(told) >= 1.99 and np.median(told) < 2.1


@pytest.mark.study
def test_intervals_hold() -> None:
    """95 % of them, less three standard errors of 60 devices whose three intervals are correlated."""
    rng, inside = np.random.default_rng(95), list[bool]()
    for _ in range(60):
        device = hidden(rng)._replace(friction=0.0)
        found = gains_of(device, *(one := ring(device, rng))[:2], one[2])
        true = {"mass": device.body["mass"], "delay": device.delay, "own damping": device.body["own"]}
        inside += [found.values[name].low <= true[name] <= found.values[name].high for name in true if found.values]
    assert len(inside) > 120 and np.mean(inside) > 0.87


@pytest.mark.parametrize("target", [1.5, 4.0])
def test_the_ratio_is_the_one_asked_for(target: float) -> None:
    log = log_of(QUIET, *GAINS, np.random.default_rng(0), 150)
    found = gains_of(QUIET, *GAINS, log, target=target, stated={"own_damping": 0.0})
    assert target <= critical(QUIET, found.damping) / found.stiffness < 1.03 * target
    assert found.ratio.low <= critical(QUIET, GAINS[1]) / GAINS[0] <= found.ratio.high


def test_friction_is_identified() -> None:
    device = QUIET._replace(friction=0.012)
    log = log_of(device, *GAINS, np.random.default_rng(0), 120, start=8e-3)
    found = gains_of(device, *GAINS, log, stated={"own_damping": 0.0})
    friction = found.values["friction"]
    assert friction.low <= 0.012 <= friction.high and friction.high - friction.low < 0.004


def test_a_cut_log_does_not_tell_own_damping_from_delay() -> None:
    """One pole has two numbers; with the third one stated, the log tells."""
    device = QUIET._replace(body={"mass": 0.7, "own": 4.0})
    log = log_of(device, 2500.0, 12.0, np.random.default_rng(0), 170, start=8e-3)[60:]
    refused = gains_of(device, 2500.0, 12.0, log).refused
    assert "delay is between" in refused and "state --own-damping" in refused
    found = gains_of(device, 2500.0, 12.0, log, stated={"own_damping": 4.0})
    assert found.values["delay"].value == pytest.approx(0.0015, abs=1e-4)
    assert critical(device, found.damping) / found.stiffness >= 1.99


REFUSED: list[tuple[str, dict[str, Any]]] = [
    ("a hand holds the device", {"hand": Hand(mass=0.5, damping=20.0, stiffness=135.0)}),
    ("a flexible mode is stated", {"mode": Mode(100.0, 0.01, 0.5)}),
    ("a law on the device acts beside yours", {"device": DeviceLaw(100.0, 1.0)}),
    ("the log has 200 samples a second and the law runs at 400 Hz", {"period": 0.0025}),
]


@pytest.mark.parametrize(("words", "stated"), REFUSED)
def test_a_device_that_is_not_the_one_of_the_log_is_refused(words: str, stated: dict[str, Any]) -> None:
    log = log_of(QUIET, *GAINS, np.random.default_rng(0), 120)
    found = gains_of(QUIET, *GAINS, log, **stated)
    assert words in found.refused and str(found.table()).startswith("Gains from the log: refused, as ")
    with pytest.raises(ParameterError, match="log must tell the device"):
        found.header()


def body_with(**parts: Any) -> dict[str, Any]:
    return {"mass": 0.7, "own": 0.0, **parts}


DISTURBED: list[tuple[str, Hidden]] = [
    ("rigid hand", QUIET._replace(body=body_with(hand=(0.2, 0.5, 100.0)))),
    ("soft hand", QUIET._replace(body=body_with(hand=(0.3, 1.0, 50.0, 2.0, 900.0)))),
    ("mode", QUIET._replace(body=body_with(mode=(31.0, 0.02, 0.6)))),
    ("stop", QUIET._replace(stop=1.4e-3)),
    ("saturation", QUIET._replace(limit=2.0)),
]


@pytest.mark.parametrize("device", [device for _, device in DISTURBED], ids=[what for what, _ in DISTURBED])
def test_another_force_is_refused(device: Hidden) -> None:
    """By the oscillation, the mass or the residual."""
    log = log_of(device, *GAINS, np.random.default_rng(0), 160, start=3e-3)
    try:
        refused = gains_of(device, *GAINS, log, stated={"inertia": 0.7}).refused
    except ParameterError as error:
        refused = str(error)
    assert re.search("a hand holds it|another force acts|contact is lost in bounces|delay is between", refused)


@pytest.mark.study
@pytest.mark.parametrize("what", ["mode", "stop", "saturation"])
def test_logs_with_another_force_give_no_wrong_gains(what: str) -> None:
    """A log may be used from where the other force ends, and a mode may be too fast to matter."""
    rng, refused = np.random.default_rng(31), 0
    for _ in range(12):
        device = hidden(rng)._replace(friction=0.0)
        stiffness, damping, _ = ring(device, rng)
        mode = rng.uniform(15.0, 0.4 / device.period), 0.01, float(rng.choice([-1.0, 0.5, 1.0]))
        changes: dict[str, dict[str, Any]] = {
            "mode": {"body": {**device.body, "mode": mode}},
            "stop": {"stop": rng.uniform(0.5e-3, 1.5e-3)},
            "saturation": {"limit": 2e-3 * stiffness * rng.uniform(0.2, 0.8)},
        }
        disturbed = device._replace(**changes[what])
        log = log_of(disturbed, stiffness, damping, rng)
        try:
            found = gains_of(device, stiffness, damping, log, stated={"inertia": device.body["mass"]})
        except ParameterError:
            refused += 1
            continue
        refused += bool(found.refused)
        true = disturbed if what == "mode" else device
        assert found.refused or critical(true, found.damping) / found.stiffness >= 1.99
    assert refused >= 6


def test_a_wrong_stiffness_is_named() -> None:
    """Twice the stiffness at half the force is the same motion with twice the mass: the stated mass contradicts it."""
    log = log_of(QUIET, *GAINS, np.random.default_rng(0), 150)
    found = gains_of(QUIET, 2.0 * GAINS[0], 2.0 * GAINS[1], log, stated={"inertia": 0.7})
    assert "0.7 is stated" in found.refused and "1.4" in found.refused


def test_short_and_small_logs_are_refused() -> None:
    log = log_of(QUIET, *GAINS, np.random.default_rng(0), 150)
    motion = LoggedMotion(log[:40], 0.005, np.ones(40, dtype=np.bool_))
    around = Loop(stiffness=GAINS[0], damping=GAINS[1], period=0.005, delay=0.0, inertia=1.0)
    seen = find_oscillation(0.005 * np.arange(len(log)), log, period=0.005)
    assert "half cycles, and five are needed" in gains_from_log(motion, around, seen, target=2.0, stated={}).refused
    coarse = motion._replace(position=5e-4 * np.rint(log / 5e-4), usable=np.ones(len(log), dtype=np.bool_))
    assert "10 steps of the sensor" in gains_from_log(coarse, around, seen, target=2.0, stated={}).refused


def test_the_command_prints_the_device_and_writes_a_header(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, path = log_of(QUIET, *GAINS, np.random.default_rng(0), 150), tmp_path / "ring.csv"
    rows = [f"{0.005 * index:.4f},{value:.9f}\n" for index, value in enumerate(log.tolist())]
    path.write_text("time [s],z [m]\n" + "".join(rows), encoding="utf-8")
    line = f"diagnose {path} --stiffness 2000 --damping 15 --own-damping 0"
    assert main(line.split()) == 0
    assert "Gains from the log" in (text := capsys.readouterr().out) and "not identifiable: a lag" in text
    assert sorted(one.name for one in tmp_path.iterdir()) == ["ring.csv"]
    assert main(f"{line} --out {tmp_path / 'out'}".split()) == 0
    header = (tmp_path / "out" / "gains.h").read_text(encoding="ascii")
    found = diagnose(path, stiffness=2000.0, damping=15.0, own_damping=0.0).from_log
    assert found is not None and f"#define MAGLEV_STIFFNESS {found.stiffness!r} /* N/m */" in header
    assert "Gains from ring.csv" in header and "mass: 0.69" in header and "at least 2 " in header
    assert critical(QUIET, found.damping) / found.stiffness >= 1.99
    if compiler := shutil.which("cc"):
        source = tmp_path / "check.c"
        source.write_text('#include "out/gains.h"\ndouble gain = MAGLEV_STIFFNESS + MAGLEV_DAMPING * MAGLEV_PERIOD;\n')
        subprocess.run([compiler, "-Wall", "-Werror", "-c", source, "-o", tmp_path / "check.o"], check=True)
