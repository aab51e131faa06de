"""Does a simulated wall settle or grow? The flotor rests in it, is moved a little, and the samples tell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.controller import Controller
from maglev_mj.errors import ParameterError
from maglev_mj.experiments.wall_controller import wall_controller
from maglev_mj.frames import Array, Command, Mask, Sample
from maglev_mj.hand import Hand
from maglev_mj.laws import VelocityEstimator
from maglev_mj.loop import run
from maglev_mj.parameters import flag, numbers
from maglev_mj.plants import ExactPlant, MuJoCoBatchPlant, SampledPlant, Timing, engine_warnings_silenced
from maglev_mj.scenes.choices import PLANTS
from maglev_mj.spec import GRAVITY, Spec

__all__ = ["Growth", "RestingWall", "measure_growth"]

_MOVED = 1e-6
_DECIDED = 1e4
_BLOCK = 16
_FAR = (1e15, 1.0)
_PATIENCE = (128, 512, 2048, 8192)


class Growth(NamedTuple):
    """What the samples of each loop say, (N,) each.

    Attributes:
        stable: Whether the motion dies out.
        rate: Factor by which it grows from one sample to the next, from its largest values; rough where a few samples
            decide.
        ticks: Samples it took to tell.
    """

    stable: Mask
    rate: Array
    ticks: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class RestingWall:
    """Everything around the gains of walls that the flotor rests in.

    Args:
        plant: "exact" or "mujoco".
        period: Sample period [s].
        delay: Transport delay [s].
        mass: Moving mass [kg].
        hand: A hand on the flotor; numbers.
        driver_lag: Switch the drivers' lag on.
        velocity: Velocity estimate; None for the finite difference.
        jitter: See `Timing`.
        integrator: MuJoCo's integrator.
        longest_step: MuJoCo's longest step [s]; None for as long as the force is constant.
        threads: MuJoCo's threads; 0 for one a processor.

    Raises:
        ParameterError: If there is no such plant.
    """

    plant: str = "exact"
    period: float = 1.0 / Spec.control_rate.value
    delay: float = Spec.transport_delay.value
    mass: float = Spec.moving_mass.value
    hand: Hand | None = None
    driver_lag: bool = False
    velocity: VelocityEstimator | None = None
    jitter: float = 0.0
    integrator: str = "rk4"
    longest_step: float | None = None
    threads: int = 0

    def __post_init__(self) -> None:
        if self.plant not in PLANTS:
            raise ParameterError(f"plant must be one of {', '.join(PLANTS)}, not {self.plant!r}")
        flag("driver_lag", self.driver_lag)
        if self.hand is not None and self.hand.shape:
            raise ParameterError(f"hand must be one for all walls, not {self.hand.shape}")

    def rest(self, stiffness: Array) -> Array:
        """Return where weight, wall and arm balance [m]."""
        arm = 0.0 if self.hand is None else float(self.hand.static_stiffness)
        return -self.mass * GRAVITY / (stiffness + arm)

    def start(self, stiffness: Array, damping: Array) -> tuple[SampledPlant, Controller]:
        """Return N flotors a millionth off their rest, held up by the wall's force, and their controller."""
        rest = self.rest(stiffness)
        pose, wrench = np.zeros((stiffness.size, 6)), np.zeros((stiffness.size, 6))
        pose[:, 2], wrench[:, 2] = rest * (1.0 + _MOVED), -stiffness * rest
        timing = Timing(period=self.period, delay=self.delay, jitter=self.jitter)
        common: dict[str, Any] = {
            "pose": pose,
            "wrench": wrench,
            "mass": self.mass,
            "hand": self.hand,
            "driver_lag": self.driver_lag,
            "escape": _FAR,
        }
        made: SampledPlant = (
            ExactPlant(timing, **common)
            if self.plant == "exact"
            else MuJoCoBatchPlant(
                timing, integrator=self.integrator, longest_step=self.longest_step, threads=self.threads, **common
            )
        )
        controller = wall_controller(
            stiffness=stiffness,
            damping=damping,
            period=self.period,
            delay=self.delay,
            mass=self.mass,
            velocity=self.velocity,
        )
        return made, controller


def measure_growth(stiffness: ArrayLike, damping: ArrayLike, walls: RestingWall) -> Growth:
    """Simulate walls in closed loop, each with the flotor resting in it, and tell whether a small motion grows.

    The flotor starts off its rest under gravity by a millionth of its depth. A loop is decided when that has become
    ten thousand times larger or smaller, so that the wall's edge and rounding are both far away; one that takes longer
    than 8192 samples is decided by whether its last quarter is larger than its second.

    Args:
        stiffness: Wall stiffness [N/m], above 0, (N,).
        damping: Wall damping [N s/m], (N,).
        walls: Everything else.

    Raises:
        ParameterError: If a value is outside its bounds.
    """
    k, b = np.broadcast_arrays(numbers("stiffness", stiffness, at_least=0.0), numbers("damping", damping, at_least=0.0))
    if k.ndim != 1 or not (k > 0.0).all():
        raise ParameterError("stiffness must be (N,) and above 0 everywhere: without it there is nowhere to rest")
    stable, rate, spent = np.zeros(k.size, dtype=bool), np.full(k.size, np.nan), np.zeros(k.size)
    undecided = np.arange(k.size)
    for ticks in _PATIENCE:
        if undecided.size:
            gains, drags = k[undecided], b[undecided]
            sizes = _sizes(*walls.start(gains, drags), walls.rest(gains), ticks)
            growth, decided = _judge(sizes, last=ticks == _PATIENCE[-1])
            done = undecided[decided]
            stable[done], rate[done], spent[done] = (part[decided] for part in growth)
            undecided = undecided[~decided]
    return Growth(stable, rate, spent)


def _sizes(plant: SampledPlant, controller: Controller, rest: Array, ticks: int) -> Array:
    """Run and return the largest distance from rest in each block of samples, over that at the start, (blocks, N)."""
    blocks = np.zeros((ticks // _BLOCK, rest.size))

    def observe(sample: Sample, _: Command) -> None:
        row = blocks[sample.tick // _BLOCK]
        np.maximum(row, np.abs(sample.position[2] / rest - 1.0) / _MOVED, out=row)

    with plant, engine_warnings_silenced():
        run(plant, controller, ticks, observe=observe)
    return blocks


def _judge(sizes: Array, *, last: bool) -> tuple[Growth, Mask]:
    """Return what the sizes of the blocks say of each loop, and where that is certain."""
    gone = sizes < 1.0 / _DECIDED
    either = gone | (sizes > _DECIDED)
    decided: Mask = np.any(either, axis=0)
    pick = np.where(decided, np.argmax(either, axis=0), len(sizes) - 1)
    column = np.arange(sizes.shape[1])
    stable = gone[pick, column]
    with np.errstate(divide="ignore"):
        # from the first block to the one that decides; within the first, from the start
        since = np.where(pick > 0, sizes[0], 1.0)
        rate = np.exp(np.log(sizes[pick, column] / since) / np.where(pick > 0, pick, 1.0) / _BLOCK)
    if last:
        quarter = len(sizes) // 4
        early, late = sizes[quarter : 2 * quarter].max(axis=0), sizes[-quarter:].max(axis=0)
        stable = np.where(decided, stable, late < early)
        rate = np.where(decided, rate, (late / early) ** (1.0 / (2 * quarter * _BLOCK)))
        decided = np.ones(column.size, dtype=bool)
    return Growth(stable, rate, (pick + 1.0) * _BLOCK), decided
