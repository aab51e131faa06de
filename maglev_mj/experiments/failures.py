"""Where walls fail: at the edge under a light press, in a narrow gap, under a force limit, over a coarse sensor."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.controller import Controller
from maglev_mj.experiments.wall_controller import around_wall, wall_controller
from maglev_mj.frames import Array, Command, Sample
from maglev_mj.hand import Hand
from maglev_mj.laws import Law, Wall
from maglev_mj.loop import run
from maglev_mj.parameters import numbers
from maglev_mj.plants import ExactPlant, SampledPlant, Sensor, Timing
from maglev_mj.sampled import LoopKeywords, SampledLoop
from maglev_mj.spec import GRAVITY, Spec

__all__ = ["Chatter", "Hum", "hum", "press_at_edge", "random_delay_rate", "rattle", "swing_after_drop"]

_FAR = (1e9, 1.0)
_MASS = Spec.moving_mass.value
_PERIOD = 1.0 / Spec.control_rate.value
_DELAY = Spec.transport_delay.value


class Chatter(NamedTuple):
    """What goes on at a wall's edge.

    Attributes:
        pulses: Braking pulses a second, mean over the phases.
        ripple: Largest swing of the position in the second half [m], the worst phase.
    """

    pulses: Array
    ripple: Array


class _Watch:
    """Keeps the positions along z and counts the pulses of each device."""

    def __init__(self, ticks: int, devices: int) -> None:
        self.places = np.zeros((ticks, devices))
        self.pulses = np.zeros(devices)

    def __call__(self, sample: Sample, command: Command) -> None:
        self.places[sample.tick] = sample.position[2]
        if command.extra is not None:
            self.pulses += np.broadcast_to(np.asarray(command.extra[2]) != 0.0, self.pulses.shape)


def _watched(plant: SampledPlant, controller: Controller, duration: float, devices: int) -> _Watch:
    watch = _Watch(round(duration / plant.period), devices)
    with plant:
        run(plant, controller, len(watch.places), observe=watch)
    return watch


def _every(values: ArrayLike, phases: int) -> tuple[Array, Array]:
    """Return each value once for each sampling phase, and the phases."""
    chosen = np.atleast_1d(numbers("values", values))
    return np.repeat(chosen, phases), np.tile(np.arange(phases) / phases, chosen.size)


def _along_z(values: Array) -> Array:
    """Return (N, 6) with values along z and zero elsewhere."""
    result = np.zeros((values.size, 6))
    result[:, 2] = values
    return result


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
    """Press the flotor lightly on the paper's wall with its pulse, and count how often the pulse fires.

    Args:
        press: Constant force of the hand towards the wall, weight compensated [N].
        gates: Approach speeds from which on a pulse is given [m/s], (M,).
        height: Where it is let go above the edge [m]; None for at rest in the wall.
        pulse: Further damping in the pulse [N s/m].
        noise: Standard deviation of the sensor's noise [m].
        quantum: Its resolution [m].
        duration: Simulated time [s].
        phases: Sampling phases, each with noise of its own.
        period: Sample period [s].
        delay: Transport delay [s].

    Returns:
        A figure a gate, (M,) each.
    """
    stiffness, damping, width = 6000.0, 80.0, 0.003
    gate, phase = _every(gates, phases)
    start = np.full(gate.size, -press / stiffness if height is None else height)
    plant = ExactPlant(
        Timing(period=period, delay=delay, phase=phase),
        pose=_along_z(start),
        wrench=_along_z(np.full(gate.size, press if height is None else 0.0)),
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
    watch = _watched(plant, controller, duration, gate.size)
    swing = np.ptp(watch.places[len(watch.places) // 2 :], axis=0)
    return Chatter(watch.pulses.reshape(-1, phases).mean(axis=1) / duration, swing.reshape(-1, phases).max(axis=1))


def rattle(
    gaps: ArrayLike,
    *,
    pulse: float,
    stiffness: float = 6000.0,
    damping: float = 80.0,
    delay: float = _DELAY,
    period: float = _PERIOD,
    speed: float = 0.1,
    force_limit: float = Spec.largest_vertical_force.value,
    duration: float = 4.0,
    phases: int = 8,
) -> Array:
    """Set the flotor going between two walls; return how fast it still moves in the last second [m/s], worst phase.

    Args:
        gaps: Distances between the walls [m], (M,).
        pulse: Further damping in the pulse of 3 ms [N s/m].
        stiffness: Of both walls [N/m].
        damping: Of both walls [N s/m].
        delay: Transport delay [s].
        period: Sample period [s].
        speed: Speed at the start [m/s].
        force_limit: Of the actuators [N].
        duration: Simulated time [s].
        phases: Sampling phases.
    """
    gap, phase = _every(gaps, phases)
    edge = 0.5 * gap[:, None]
    walls = Wall(
        axes="z",
        lower=-edge,
        upper=edge,
        stiffness=stiffness,
        damping=damping,
        pulse=pulse,
        pulse_width=0.003,
    )
    plant = ExactPlant(
        Timing(period=period, delay=delay, phase=phase),
        pose=np.zeros((gap.size, 6)),
        twist=_along_z(np.full(gap.size, speed)),
        gravity=0.0,
        wrench_limit=force_limit,
        escape=_FAR,
    )
    places = _watched(plant, Controller([walls], period=period), duration, gap.size).places
    late = np.diff(places[-round(1.0 / period) :], axis=0) / period
    return np.asarray(np.abs(late).max(axis=0).reshape(-1, phases).max(axis=1))


def swing_after_drop(
    heights: ArrayLike,
    law: Law,
    *,
    force_limit: float,
    delay: float = _DELAY,
    period: float = _PERIOD,
    duration: float = 4.0,
    phases: int = 8,
) -> Array:
    """Drop the flotor on a wall whose actuators saturate; return its swing in the last second, worst phase [m].

    Args:
        heights: Drop heights [m], (M,).
        law: The wall, along z.
        force_limit: Of the actuators [N].
        delay: Transport delay [s].
        period: Sample period [s].
        duration: Simulated time [s].
        phases: Sampling phases.
    """
    height, phase = _every(heights, phases)
    plant = ExactPlant(
        Timing(period=period, delay=delay, phase=phase), pose=_along_z(height), wrench_limit=force_limit, escape=_FAR
    )
    controller = around_wall(law, period=period, delay=delay, mass=_MASS)
    places = _watched(plant, controller, duration, height.size).places
    return np.asarray(np.ptp(places[-round(1.0 / period) :], axis=0).reshape(-1, phases).max(axis=1))


class Hum(NamedTuple):
    """What a wall does to a flotor at rest in it, the worst start.

    Attributes:
        swing: Swing of the position [m].
        force: Standard deviation of the force [N].
    """

    swing: Array
    force: Array


def hum(
    frictions: ArrayLike,
    *,
    law: Law | None = None,
    stiffness: float = 6000.0,
    damping: float = 80.0,
    quantum: float = Spec.translation_resolution.value,
    delay: float = _DELAY,
    period: float = _PERIOD,
    mass: float = _MASS,
    hand: Hand | None = None,
    duration: float = 4.0,
    offsets: int = 32,
) -> Hum:
    """Rest the flotor in a wall over a sensor with steps, and look at the last quarter of the time.

    Args:
        frictions: Coulomb friction of the device itself [N], (M,).
        law: The wall along z; None for PD.
        stiffness: Wall stiffness, the rendered one of another law [N/m].
        damping: Wall damping [N s/m].
        quantum: Step of the sensor [m].
        delay: Transport delay [s].
        period: Sample period [s].
        mass: Moving mass [kg].
        hand: On the flotor; None for none.
        duration: Simulated time [s].
        offsets: How many starts over two steps of the sensor.

    Returns:
        A figure a friction, (M,) each.
    """
    friction, offset = _every(frictions, offsets)
    arm = 0.0 if hand is None else float(hand.static_stiffness)
    depth = mass * GRAVITY / (stiffness + arm)
    plant = ExactPlant(
        Timing(period=period, delay=delay),
        mass=mass,
        hand=hand,
        escape=_FAR,
        pose=_along_z(np.floor(-depth / quantum) * quantum + 2.0 * quantum * offset),
        wrench=_along_z(np.full(friction.size, stiffness * depth)),
        dry_friction=_along_z(friction),
        sensor=Sensor(quantum=np.eye(6)[2] * quantum),
        record=True,
    )
    wall = law or Wall(axes="z", lower=0.0, stiffness=stiffness, damping=damping)
    _watched(plant, around_wall(wall, period=period, delay=delay, mass=mass), duration, friction.size)
    trace = plant.trace()
    late = slice(-len(trace.time) // 4, -1)
    swing, force = np.ptp(trace.pose[late, :, 2], axis=0), np.std(trace.wrench[late, :, 2], axis=0)
    return Hum(*(part.reshape(-1, offsets).max(axis=1) for part in (swing, force)))


def random_delay_rate(stiffness: float, damping: float, delays: ArrayLike, loop: LoopKeywords | None = None) -> float:
    """Return the mean growth a sample of a loop whose delay changes from sample to sample, by its matrices' product.

    Args:
        stiffness: Wall stiffness [N/m].
        damping: Wall damping [N s/m].
        delays: The delay of each sample's command [s], (K,), all within one period or all in the same later one.
        loop: Keywords of `SampledLoop` but the delay.
    """
    keywords: LoopKeywords = {**(loop or {}), "delay": delays}
    matrices = SampledLoop(**keywords).matrix(stiffness, damping)
    state, sizes = np.ones(matrices.shape[-1]), []
    for matrix in matrices:
        state = matrix @ state
        sizes.append(float(np.linalg.norm(state)))
        state = state / sizes[-1]
    # the first tenth turns the state into the direction that grows
    return float(np.exp(np.mean(np.log(sizes[len(sizes) // 10 :]))))
