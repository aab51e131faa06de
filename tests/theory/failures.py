"""Failures of walls: light presses, varying delays, and a corner with three contacts at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.control import Hold, Wall
from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import drive
from maglev_mj.frames import Array
from maglev_mj.parameters import numbers
from maglev_mj.plants import ExactPlant, MuJoCoPlant, Sensor, Timing, engine_warnings_silenced
from maglev_mj.scenes.wall_scene import along, wall_controller
from maglev_mj.spec import INERTIA, Spec
from maglev_mj.theory.loop_array import LoopArray, LoopKeywords, sampled_fields
from tests.theory.impacts import watched

_MASS = Spec.moving_mass.value
_PERIOD = 1.0 / Spec.control_rate.value
_DELAY = Spec.transport_delay.value


class Chatter(NamedTuple):
    """Activity at a wall's edge.

    Attributes:
        pulses: Braking pulses a second, mean over the phases.
        ripple: Largest swing of the position in the second half [m], the worst phase.
    """

    pulses: Array
    ripple: Array


def press_at_edge(
    press: float,
    gates: ArrayLike,
    *,
    height: float | None = None,
    pulse: float = 220.0,
    noise: float = 2e-6,
    quantum: float = Spec.translation_resolution.value,
    duration: float = 2.0,
    phases: int = 8,
    period: float = _PERIOD,
    delay: float = _DELAY,
) -> Chatter:
    """Press lightly on the wall; count its braking pulses."""
    stiffness, damping, width = 6000.0, 80.0, 0.003
    gate = np.repeat(np.atleast_1d(numbers("gates", gates)), phases)
    phase = np.resize(np.arange(phases) / phases, gate.size)
    start = np.full(gate.size, -press / stiffness if height is None else height)
    plant = ExactPlant(
        Timing(period=period, delay=delay, phase=phase),
        pose=along("z", start),
        wrench=along("z", np.full(gate.size, press if height is None else 0.0)),
        gravity=press / _MASS,
        sensor=Sensor(quantum=np.eye(6)[2] * quantum, noise=np.eye(6)[2] * noise, seed=1),
    )
    controller = wall_controller(
        stiffness=stiffness,
        damping=damping,
        pulse=np.full(gate.size, pulse),
        pulse_width=width,
        pulse_gate=gate,
        period=period,
        delay=delay,
        mass=_MASS,
    )
    watch = watched(plant, controller, duration, gate.size)
    swing = np.ptp(watch.places[len(watch.places) // 2 :], axis=0)
    return Chatter(watch.pulses.reshape(-1, phases).mean(axis=1) / duration, swing.reshape(-1, phases).max(axis=1))


def random_delay_rate(stiffness: float, damping: float, delays: ArrayLike, loop: LoopKeywords | None = None) -> float:
    """Return the mean growth a sample under random delays, by the product of the matrices."""
    keywords: LoopKeywords = {**(loop or {}), "delay": delays}
    matrices = LoopArray(**sampled_fields(keywords)).matrix(stiffness, damping)
    state, sizes = np.ones(matrices.shape[-1]), []
    for matrix in matrices:
        state = matrix @ state
        sizes.append(float(np.linalg.norm(state)))
        state = state / sizes[-1]
    # the first tenth turns the state into the direction that grows
    return float(np.exp(np.mean(np.log(sizes[len(sizes) // 10 :]))))


def corner(plant: str, pose: Sequence[float], twist: Sequence[float], *, duration: float = 2.0) -> tuple[Array, Array]:
    """Throw the flotor into a corner, pulled by a spring."""
    body = np.array(INERTIA)
    into = np.array([0, 2, 4])
    share = body[into] / _MASS
    # a press of 0.4 N at the walls, and as much acceleration at the stop
    pull = Hold(stiffness=200.0 * body / _MASS, damping=4.0 * body / _MASS, target=np.isin(np.arange(6), into) * -2e-3)
    walls = Wall(
        axes=("x", "z", "ry"),
        lower=0.0,
        stiffness=6000.0 * share,
        damping=80.0 * share,
        pulse=220.0 * share,
        pulse_width=0.003,
    )
    kind = ExactPlant if plant == "exact" else MuJoCoPlant
    with kind(Timing(), pose=pose, twist=twist, gravity=0.0, record=True) as made, engine_warnings_silenced():
        drive(made, Controller([walls, pull], period=made.period), round(duration / made.period))
        time = np.arange(round(duration / made.period)) * made.period
        poses, twists, _ = made.trace().at(time)
    return poses, 0.5 * (body * twists**2).sum(axis=1)
