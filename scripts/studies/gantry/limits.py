"""Limits of the theory: growth and contacts.

Growth measured against eigenvalues, and contacts over phases, speeds, forces and hands.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np

from gantry.coupling import Coupling
from gantry.run import carry_out
from gantry.slave import BLOCK_DAMPING
from gantry.task import FIRM, Task
from gantry.theory import Gains, TwoBodies
from maglev_mj.plants.hand import HANDS, get_hand

GRIPS = {"firm": FIRM, **{name: hand for name in HANDS if (hand := get_hand(name)) is not None}}
"""Hands on the joystick, by name."""

_START, _SAMPLES = 0.72, 200


class Growth(NamedTuple):
    """Growth a sample, as measured and by the eigenvalues."""

    measured: float
    foreseen: float


class Contact(NamedTuple):
    """Outcome of one contact; forces are the slave's [N]."""

    hand: str
    phase: float
    """Of the first sample [periods]."""
    speed: float
    """Of the joystick at contact [m/s]."""
    asked: float
    """Force of the hand's press, as felt at the slave."""
    press: float
    """Mean force in the last half second of the hold."""
    ripple: float
    """Root mean square of the force about that."""
    bounces: int
    """Number of bounces of the pin on landing."""
    losses: int
    """Number of bounces afterwards."""


def bodies(task: Task, coupling: Coupling, slave_mass: float) -> TwoBodies:
    """Return the bodies that the coupling joins along z.

    Args:
        task: The task.
        coupling: Its scales.
        slave_mass: What the slave moves along z [kg, the slave's].
    """
    felt, there = coupling.felt, task.mode != "free"
    return TwoBodies(
        timing=task.timing,
        slave_mass=felt * slave_mass,
        contact=felt * task.block * there,
        contact_damping=felt * BLOCK_DAMPING * there,
        hand=task.hand,
    )


def growth(task: Task) -> Growth:
    """Measure the growth of the joystick's oscillation along z.

    By fourth differences of its samples, in which slow motion does not count: their root mean square over 100 samples,
    over that of the 100 before.

    Args:
        task: In mode "touching" or "free".
    """
    history = carry_out(replace(task, hold=_START + _SAMPLES * task.period - 0.6))
    ticks = (round(_START / task.period) + np.arange(_SAMPLES)) * task.period
    bends = np.diff(np.interp(ticks, history.time, history.joystick[0][:, 2]), 4)
    half = len(bends) // 2
    first, last = (float(np.sqrt(np.mean(part**2))) for part in (bends[:half], bends[half:]))
    coupling = history.coupling
    theory = bodies(task, coupling, float(history.slave_mass[2]))
    return Growth((last / first) ** (1.0 / half), theory.modulus(Gains(coupling.stiffness, coupling.damping)))


def measured_boundary(shares: Sequence[float], found: Sequence[Growth]) -> float:
    """Return the share without growth or decay: interpolated between those measured.

    Args:
        shares: Of the stiffness that the eigenvalues foresee, increasing.
        found: Growth at each.
    """
    return float(np.interp(1.0, [one.measured for one in found], shares))


def contacts(
    task: Task, hands: Sequence[str], phases: Sequence[float], approaches: Sequence[tuple[float, float]]
) -> Iterator[Contact]:
    """Run a task over hands, phases and presses.

    Pairs of speed [m/s] and force of the press [N].

    Raises:
        PlantError: If joystick or slave go where they cannot be.
    """
    for hand, phase, (speed, press) in product(hands, phases, approaches):
        changed = replace(task, hand=GRIPS[hand], phase=phase, speed=speed, press=press, leaves=False)
        history = carry_out(changed)
        bounces, losses = history.losses
        asked = press / history.coupling.reflection
        yield Contact(hand, phase, speed, asked, history.press, history.ripple, bounces, losses)
