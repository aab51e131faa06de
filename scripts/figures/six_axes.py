"""Stick-slip on all six axes, moved by a hand: figure 9 of Salcudean and Vlaar (1997)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from maglev_mj.control import StickSlip
from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import drive
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array, Command, Component, Mask, Sample
from maglev_mj.parameters import number
from maglev_mj.plants import ExactPlant, MuJoCoPlant, Timing
from maglev_mj.scenes.scene import PLANTS
from maglev_mj.spec import INERTIA, Spec

_RADIUS = np.sqrt(np.array(INERTIA) / INERTIA[0])
"""Radius of gyration of rotations, 1 for translations; it scales figure 8's values to every axis."""


class _Hand:
    """Spring on each axis, its far end moved smoothly.

    The motion is a sum of three seeded sines, slow enough to stick.

    It pulls at the flotor from where that truly is, held from one sample to the next. The spring of a rotation turns by
    one component of the rotation vector, about that axis of the stator.
    """

    def __init__(self, seed: int, stiffness: Array, reach: Array) -> None:
        random = np.random.default_rng(seed)
        self._frequency = random.uniform(0.1, 0.6, (3, 6))
        self._phase = random.uniform(0.0, 2.0 * math.pi, (3, 6))
        self._stiffness, self._reach = stiffness, reach

    def __call__(self, tick: int, time: Component, state: Callable[[], tuple[Array, Array]]) -> Sequence[Component]:
        """Pull towards the spring's far end; see `HandForce`."""
        waves = np.sin(2.0 * math.pi * self._frequency * time + self._phase) - np.sin(self._phase)
        target = self._reach / 3.0 * waves.sum(axis=0)
        pull: list[Component] = (self._stiffness * (target - state()[0])).tolist()
        return pull


@dataclass(frozen=True, eq=False)
class SixAxesResult:
    """Samples of a run in stick-slip.

    Attributes:
        time: Sample times [s], (K,).
        position: Positions [m, rad], (K, 6).
        anchor: Stick positions [m, rad], (K, 6).
        stuck: Whether each axis sticks, (K, 6).
        expected_stretch: breakaway / stiffness of each axis [m, rad], (6,).
    """

    time: Array
    position: Array
    anchor: Array
    stuck: Mask
    expected_stretch: Array

    @property
    def stretch(self) -> tuple[Array, Array]:
        """Bounds of the distance at breakaway [m, rad], (6,) each.

        The distance of each axis is from its stick position.

        Before every slip one sample still sticks and the next one does not: the greatest of the former and the least
        of the latter hold the true distance between them.
        """
        distance = np.abs(self.position[1:] - self.anchor[:-1])
        held, gone = self.stuck[:-1] & self.stuck[1:], self.stuck[:-1] & ~self.stuck[1:]
        return np.where(held, distance, 0.0).max(axis=0), np.where(gone, distance, np.inf).min(axis=0)

    def steps(self, least: float = 0.04) -> list[Array]:
        """Return distances between successive resting positions [m, rad], by axis.

        A resting place is a stick position kept for at least `least` [s]: after most breakaways the law sticks once
        more, for 15 to 20 ms, and the hand pulls on.
        """
        period = float(self.time[1] - self.time[0])
        steps = []
        for anchor, stuck in zip(self.anchor.T, self.stuck.T, strict=True):
            ends = np.flatnonzero(np.diff(stuck)) + 1
            spells = zip([0, *ends], [*ends, len(stuck)], strict=True)
            places = [anchor[a] for a, b in spells if stuck[a] and (b - a) * period > least - 1e-9]
            steps.append(np.abs(np.diff(places)))
        return steps

    @property
    def slips(self) -> Array:
        """Number of breakaways of each axis, (6,)."""
        count: Array = (self.stuck[:-1] & ~self.stuck[1:]).sum(axis=0)
        return count


def run_six_axes(
    *,
    plant: str = "mujoco",
    seed: int = 1,
    duration: float = 12.0,
    period: float = 1.0 / Spec.control_rate.value,
    delay: float = Spec.transport_delay.value,
    phase: float = 0.0,
    hand_stiffness: float = 1500.0,
) -> SixAxesResult:
    """Move the flotor by a smooth seeded hand: figure 8's stick-slip acts on every axis.

    On rotation axes figure 8's values are taken at the radius of gyration. Gravity is compensated.

    Args:
        plant: "mujoco" or "exact".
        seed: Seed of the hand's motion.
        duration: Simulated time [s].
        period: Sample period [s].
        delay: Transport delay [s].
        phase: Sampling phase, in [0, 1).
        hand_stiffness: Of the hand's spring [N/m], at the radius of gyration for rotations.

    Raises:
        ParameterError: If a value is outside its bounds.
    """
    if plant not in PLANTS:
        raise ParameterError(f"plant must be one of {', '.join(PLANTS)} (got {plant!r})")
    ticks = max(round(number("duration", duration, above=0.0, at_most=1000.0) / number("period", period, above=0.0)), 1)
    stiffness, breakaway = 6000.0 * _RADIUS**2, 2.0 * _RADIUS
    law = StickSlip(stiffness=stiffness, damping=80.0 * _RADIUS**2, breakaway=breakaway, v_min=0.005 / _RADIUS)
    # the hand reaches as far as the device goes: 3.5 mm, and 4.5 degrees
    reach = np.array([3.5e-3] * 3 + [math.radians(4.5)] * 3)
    # no damping of its own: held for a period it takes K T / 2 off the law's 80 N s/m, 3.75 at 1500 N/m
    pull = number("hand_stiffness", hand_stiffness, above=0.0)
    hand = _Hand(seed, pull * _RADIUS**2, reach)
    controller = Controller([law], period=period)
    rows: list[tuple[float, list[float], list[float], list[bool]]] = []

    def observe(sample: Sample, _: Command) -> None:
        signals = controller.signals
        rows.append(
            (
                float(sample.time),
                list(sample.position),
                list(signals["stick_position"]),
                [bool(stuck) for stuck in signals["stuck"]],
            )
        )

    kind = ExactPlant if plant == "exact" else MuJoCoPlant
    with kind(Timing(period=period, delay=delay, phase=phase), gravity=0.0, hand_force=hand) as device:
        drive(device, controller, ticks, observe=observe)
    time, position, anchor, stuck = (np.array(column) for column in zip(*rows, strict=True))
    return SixAxesResult(time, position, anchor, stuck, breakaway / stiffness)
