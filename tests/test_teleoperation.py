"""Teleoperation example: contact, energy balance, continuity, foreseen failures."""

from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import gantry.run
import teleoperation
from gantry.run import GRIPS, History, Ledger, bodies, carry_out, contacts, growth, ledger, measured_boundary
from gantry.task import (
    DELAY_SHARE,
    FIRM,
    NO_GAINS,
    Coupling,
    CouplingLaw,
    Gains,
    Slave,
    Task,
    TwoBodies,
    chosen_gains,
    stiffest_coupling,
)
from maglev_mj.frames import Array
from maglev_mj.interop.navigation import Navigation, Navigator
from maglev_mj.plants import Timing
from maglev_mj.scenes.rooms import MASS

SCRIPT = Path(__file__).resolve().parent.parent / "scripts" / "studies" / "teleoperation.py"
RATES = (200, 1000)
FINE, COARSE = 2e-4, 1e-3 / 3
"""Integration steps of studies, and of the gate [s]."""

pytestmark = pytest.mark.xdist_group("teleoperation")  # so that each task is carried out once


def at(rate: int, mode: str = "position") -> Task:
    return Task(mode=mode, period=1.0 / rate, delay=DELAY_SHARE / rate)


@pytest.fixture(autouse=True)
def step(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> float:
    """Return the integration step, which is fine in studies."""
    step = COARSE if request.node.get_closest_marker("study") is None else FINE
    monkeypatch.setattr(gantry.run, "_STEP", step)
    return step


@cache
def done(mode: str, rate: int, step: float) -> tuple[History, Ledger]:
    history = carry_out(at(rate, mode))
    assert step == gantry.run._STEP
    return history, ledger(history)


@pytest.fixture
def outcome(request: pytest.FixtureRequest, step: float) -> tuple[History, Ledger]:
    """Return a task's history and energies."""
    mode, rate = request.param
    return done(mode, rate, step)


def outcomes(*modes: str) -> pytest.MarkDecorator:
    """Return a parameter of outcomes: at 200 Hz, and finely at all rates as a study."""
    return pytest.mark.parametrize(
        "outcome",
        [
            *((mode, 200) for mode in modes),
            *(pytest.param((mode, rate), marks=pytest.mark.study) for mode in modes for rate in RATES),
        ],
        indirect=True,
        ids=lambda task: f"{task[0]}-{task[1]}",
    )


@pytest.mark.parametrize("rate", RATES)
def test_two_free_bodies_have_the_bound_of_a_wall_on_their_reduced_mass(rate: int) -> None:
    timing = Timing(period=1.0 / rate, delay=DELAY_SHARE / rate)
    free = TwoBodies(timing=timing, slave_mass=1.0)
    most = stiffest_coupling(timing, 1.0)

    def beyond(share: float) -> bool:
        # drifting apart at constant speed is a double eigenvalue at 1, which rounding splits
        return free.modulus(Gains(share * most.stiffness, most.damping)) > 1.0 + 1e-6

    assert [beyond(share) for share in (0.25, 0.999, 1.001)] == [False, False, True]


@pytest.mark.parametrize("rate", RATES)
def test_the_chosen_gains_leave_a_factor_of_three_for_any_hand_friction_and_block(rate: int) -> None:
    timing = Timing(period=1.0 / rate, delay=DELAY_SHARE / rate)
    gains = chosen_gains(timing, 1.0)
    for hand, contact in product(GRIPS.values(), (0.0, *np.geomspace(1e2, 1e6, 9).tolist())):
        for friction in (NO_GAINS, at(rate, "rate").friction):
            block = {"contact": contact, "contact_damping": 0.6 * math.sqrt(contact)}
            joined = TwoBodies(timing=timing, slave_mass=1.0, hand=hand, friction=friction, **block)
            assert all(joined.modulus(Gains(more * gains.stiffness, gains.damping)) < 1.0 for more in (1.0, 2.0, 3.0))


def test_the_slave_moves_as_its_masses_and_the_delay_say() -> None:
    timing, force = Timing(), np.array([2.0, -3.0, 1.0])
    slave = Slave(timing, np.array([0.0, 0.0, -0.1]))
    for _ in range(10):
        slave.step(force)
    pushed = 10 * timing.period - timing.delay
    assert slave.position == pytest.approx(0.5 * force / [2.0, 1.5, 1.0] * pushed**2, rel=1e-9)


STROKES = [
    (("firm",), (0.0, 0.5), (0.05, 5.0)),
    (("arm", "stylus", "fingertip"), (0.25,), (0.03, 3.0)),
    (("firm",), (0.75,), (0.01, 1.0)),
]
"""Hands, phases, speed and force."""


@pytest.mark.parametrize(
    ("rate", "strokes"),
    [
        (200, [(("arm",), *STROKES[1][1:])]),
        *(pytest.param(rate, STROKES, marks=pytest.mark.study) for rate in RATES),
    ],
)
def test_contact_settles_in_every_hand_at_every_phase_speed_and_force(rate: int, strokes: Any) -> None:
    task = replace(at(rate), hold=0.9)
    for contact in [one for hands, phases, stroke in strokes for one in contacts(task, hands, phases, [stroke])]:
        assert contact.press == pytest.approx(contact.asked, rel=0.02)
        assert contact.ripple < 1e-4 * contact.press, contact
        assert contact.losses == 0 and contact.bounces <= 5, contact


@outcomes("position", "rate")
def test_what_is_put_in_is_what_is_stored_and_lost(outcome: tuple[History, Ledger]) -> None:
    history, energies = outcome
    most = float(energies.put_in.max())
    assert np.abs(energies.put_in - energies.kept_or_lost).max() < 2e-3 * most
    assert np.abs(energies.joystick_lack).max() < 1e-5 * most
    assert np.abs(energies.slave_lack).max() < 2e-3 * most
    # the actuators' own meter, which knows nothing of coupling and friction
    assert -(energies.taken + energies.friction)[-1] == pytest.approx(history.work, abs=1e-6 * most)
    if history.task.mode == "position":
        assert np.abs(energies.friction).max() < 1e-9 * most and np.abs(energies.drift).max() < 1e-9 * most


@pytest.mark.parametrize("hold", [0.3, *(pytest.param(hold, marks=pytest.mark.study) for hold in (1.0, 3.0))])
def test_what_sampling_makes_is_that_of_the_first_order_as_period_and_delay_shrink(hold: float) -> None:
    task = replace(at(200, "free"), coupling=Coupling(stiffness=1496.0, damping=25.8), hold=hold)
    beyond = []
    for rate in (200, 1000):
        energies = ledger(carry_out(replace(task, period=1.0 / rate, delay=DELAY_SHARE / rate)))
        beyond.append(float(energies.made[-1] / energies.foreseen[-1]) - 1.0)
    assert beyond[0] < 0.35
    assert 0.1 < beyond[1] / beyond[0] < 0.3  # a fifth, being of the next order


@outcomes("position")
def test_momentum_changes_by_hand_and_block_alone(outcome: tuple[History, Ledger]) -> None:
    history, _ = outcome
    mass, damping, stiffness = (float(value) for value in FIRM.values[:3])
    coupling, (x, v) = history.coupling, history.joystick
    w = history.slave[1] / coupling.scale
    momentum = (MASS + mass) * v + coupling.felt * history.slave_mass * w
    tick = np.minimum((history.time / history.task.period + 1e-6).astype(int), len(history.muscles) - 1)
    width = np.diff(history.time)[:, None]

    def impulse(force: Array) -> Array:
        return np.concatenate([np.zeros((1, 3)), np.cumsum(0.5 * width * (force[1:] + force[:-1]), axis=0)])

    pushed = np.concatenate([np.zeros((1, 3)), np.cumsum(width * history.muscles[tick][:-1], axis=0)])
    given = pushed - impulse(stiffness * x + damping * v) + impulse(coupling.reflection * history.contact)
    before = history.time < 0.8  # nothing is touched yet: no stroke to integrate
    assert np.abs((momentum - given)[before]).max() < 1e-5 * np.abs(momentum).max()
    assert np.abs(momentum - given).max() < 1e-2 * np.abs(momentum).max()


@outcomes("rate")
def test_the_target_does_not_jump_where_the_mode_changes(outcome: tuple[History, Ledger]) -> None:
    history, _ = outcome
    scale, period = history.coupling.scale, history.task.period
    ticks = np.arange(len(history.target)) * period
    places = np.stack([np.interp(ticks, history.time, history.joystick[0][:, axis]) for axis in range(3)], axis=1)
    moved = np.abs(np.diff(history.target, axis=0))
    fastest = scale * 5.0 * (np.abs(places).max() - 0.0025)
    assert (moved <= scale * np.abs(np.diff(places, axis=0)) + fastest * period + 1e-12).all()
    assert np.count_nonzero(np.diff(history.rate, axis=0)) >= 8
    assert np.abs(history.force).max() <= history.coupling.bound


@outcomes("rate")
def test_let_go_beyond_the_edge_the_slave_stays_where_it_is(outcome: tuple[History, Ledger]) -> None:
    history, _ = outcome
    x = history.slave[0][:, 0]
    later = history.time > 3.0
    assert x.max() > 0.1 and np.ptp(x[later]) < 1e-3
    assert history.joystick[0][later, 0].min() > 0.0025  # the friction keeps the joystick beyond its edge


def test_pressing_longer_in_rate_mode_does_not_stretch_the_coupling_further() -> None:
    coupling = Coupling(stiffness=1500.0, damping=25.0, bound=8.0)

    def pressed(seconds: float) -> tuple[float, int]:
        """Return contact force and samples until a turn, after pressing on a still slave."""
        way = Navigation(edge=0.0025, scale=10.0, gain=50.0)
        law = CouplingLaw(coupling, lambda: np.zeros(3), period=0.005, navigator=Navigator(way))

        def step(place: float) -> float:
            law([0.0, 0.0, place, 0.0, 0.0, 0.0], [0.0] * 6, None, [0.0] * 6)
            return float(law.force[2])

        step(0.0)
        for _ in range(round(seconds / 0.005)):
            held = step(0.004)
        turning = 1
        while step(-0.004) > 0.0:
            turning += 1
        return held, turning

    short, for_long = pressed(3.0), pressed(15.0)
    assert short == for_long
    assert short[0] == pytest.approx(coupling.bound, rel=1e-9)


@pytest.mark.parametrize(
    "mode, rate",
    [
        ("touching", 200),
        *(pytest.param(mode, rate, marks=pytest.mark.study) for mode in ("free", "touching") for rate in RATES),
    ],
)
def test_the_coupling_fails_where_the_eigenvalues_say(mode: str, rate: int) -> None:
    task = replace(at(rate, mode), press=3.0)
    coupling = task.chosen(1.0)
    edge = bodies(task, coupling, 1.0).boundary(coupling.damping)
    shares = (0.97, 1.03)
    found = [growth(replace(task, coupling=replace(coupling, stiffness=share * edge))) for share in shares]
    assert found[0].measured < 1.0 < found[1].measured
    for one in found:
        assert one.measured == pytest.approx(one.foreseen, abs=3e-4)
    assert measured_boundary(shares, found) == pytest.approx(1.0, abs=0.01)


@pytest.mark.needs("drawing")
@pytest.mark.study
def test_the_script_prints_its_tables_and_draws(tmp_path: Path) -> None:
    from matplotlib import image

    command = [sys.executable, str(SCRIPT), "--mode", "rate", "--out", str(tmp_path)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert ended.returncode == 0, ended.stderr
    assert "stylus" in ended.stdout and "made by sampling and delay" in ended.stdout
    for name in ("teleoperation_rate_200", "teleoperation_rate_200_energy"):
        assert (tmp_path / f"{name}.png").stat().st_size > 50_000
    slave = image.imread(tmp_path / "teleoperation_rate_200_slave.png")
    assert slave[..., :3].std() > 0.1  # a gantry, not an empty sky


@pytest.mark.parametrize(
    "arguments, told",
    [
        (["--rate", "50"], "rate must be a finite number at least 200 and at most 2000, not 50.0"),
        (["--press", "9"], "press must be a finite number above 0 and at most 6, not 9.0"),
        (["--phase", "1"], "phase must be at least 0 and below 1, not 1"),
        (["--mode", "both"], "--mode must be one of position, rate, not 'both'"),
    ],
)
def test_bad_options_are_told_in_one_line(arguments: list[str], told: str, capsys: pytest.CaptureFixture[str]) -> None:
    try:
        status: Any = teleoperation.main(arguments)
    except SystemExit as ended:
        status = ended.code
    said = capsys.readouterr().err
    assert status == 2 and told in said and said.count("\n") == 1
