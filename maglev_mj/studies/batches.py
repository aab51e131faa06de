"""Batches of flotors moving along z.

Starts, walls, samples, and the force noise over a quantized sensor.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.controller import Controller
from maglev_mj.frames import AXES, Array, Command, Sample
from maglev_mj.hand import Hand
from maglev_mj.laws import Hold, Law, VelocityEstimator, Wall
from maglev_mj.loop import drive
from maglev_mj.parameters import numbers
from maglev_mj.plants import ExactPlant, SampledPlant, Sensor, Timing
from maglev_mj.spec import GRAVITY, INERTIA, Spec

_HELD = tuple(axis for axis in AXES if axis != "z")

FAR = (1e9, 1.0)
"""Escape bounds for unstable flotors: distance [m], angle [rad].

They let an unstable run go on to its end.
"""


class Watch:
    """Observer of positions along z and of pulses.

    Positions are (ticks, N), pulse counts (N,).
    """

    def __init__(self, ticks: int, devices: int) -> None:
        self.places = np.zeros((ticks, devices))
        self.pulses = np.zeros(devices)

    def __call__(self, sample: Sample, command: Command) -> None:
        """Store one sample and its command."""
        self.places[sample.tick] = sample.position[2]
        if command.extra is not None:
            self.pulses += np.broadcast_to(np.asarray(command.extra[2]) != 0.0, self.pulses.shape)


def watched(plant: SampledPlant, controller: Controller, duration: float, devices: int) -> Watch:
    """Run a batch for `duration` [s]; return its samples."""
    watch = Watch(round(duration / plant.period), devices)
    with plant:
        drive(plant, controller, len(watch.places), observe=watch)
    return watch


def each_phase(values: ArrayLike, phases: int) -> tuple[Array, Array]:
    """Return each value repeated for each phase, and phases."""
    chosen = np.atleast_1d(numbers("values", values))
    return np.repeat(chosen, phases), np.tile(np.arange(phases) / phases, chosen.size)


def along_z(values: Array) -> Array:
    """Return (N, 6) with values along z.

    The other components are zero.
    """
    result = np.zeros((values.size, 6))
    result[:, 2] = values
    return result


class Hum(NamedTuple):
    """Limit cycle of a flotor at rest in a wall.

    It is that of the worst start.

    Attributes:
        swing: Peak-to-peak position [m].
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
    delay: float = Spec.transport_delay.value,
    period: float = 1.0 / Spec.control_rate.value,
    mass: float = Spec.moving_mass.value,
    hand: Hand | None = None,
    duration: float = 4.0,
    offsets: int = 32,
) -> Hum:
    """Measure the limit cycle over a quantized sensor.

    The flotor rests in a wall; the last quarter of the time is evaluated.

    Args:
        frictions: Coulomb friction of the device itself [N], (M,).
        law: The wall along z; None for PD.
        stiffness: Wall stiffness, the rendered one of another law [N/m].
        damping: Wall damping [N s/m].
        quantum: Step of the sensor [m].
        delay: Transport delay [s].
        period: Sample period [s].
        mass: Moving mass [kg].
        hand: The hand on the flotor; None for none.
        duration: Simulated time [s].
        offsets: Number of starts over two steps of the sensor.

    Returns:
        A figure per friction, (M,) each.
    """
    friction, offset = each_phase(frictions, offsets)
    arm = 0.0 if hand is None else float(hand.static_stiffness)
    depth = mass * GRAVITY / (stiffness + arm)
    plant = ExactPlant(
        Timing(period=period, delay=delay),
        mass=mass,
        hand=hand,
        escape=FAR,
        pose=along_z(np.floor(-depth / quantum) * quantum + 2.0 * quantum * offset),
        wrench=along_z(np.full(friction.size, stiffness * depth)),
        dry_friction=along_z(friction),
        sensor=Sensor(quantum=np.eye(6)[2] * quantum),
        record=True,
    )
    wall = law or Wall(axes="z", lower=0.0, stiffness=stiffness, damping=damping)
    watched(plant, around_wall(wall, period=period, delay=delay, mass=mass), duration, friction.size)
    trace = plant.trace()
    late = slice(-len(trace.time) // 4, -1)
    swing, force = np.ptp(trace.pose[late, :, 2], axis=0), np.std(trace.wrench[late, :, 2], axis=0)
    return Hum(*(part.reshape(-1, offsets).max(axis=1) for part in (swing, force)))


def wall_controller(
    *,
    stiffness: ArrayLike,
    damping: ArrayLike,
    pulse: ArrayLike = 0.0,
    pulse_width: float = 0.0,
    pulse_gate: ArrayLike = 0.0,
    force_limit: float = math.inf,
    period: float,
    delay: float,
    mass: float,
    velocity: VelocityEstimator | None = None,
) -> Controller:
    """Return a controller of the PD wall with pulses.

    The wall is that of eq. (3). Gains are numbers, or (N,) for N devices.

    Args:
        stiffness: Wall stiffness [N/m].
        damping: Wall damping [N s/m].
        pulse: Further damping in the braking pulse [N s/m].
        pulse_width: Duration of the pulse [s].
        pulse_gate: Least approach speed for a pulse [m/s].
        force_limit: See `Wall`.
        period: Sample period [s].
        delay: Transport delay [s], for the hold of the other axes.
        mass: Moving mass [kg], for the hold of the other axes.
        velocity: Velocity estimate; None for the finite difference.
    """
    gains = (_column(gain) for gain in (stiffness, damping, pulse, pulse_gate))
    k, b, further, gate = gains
    wall = Wall(
        axes="z",
        lower=0.0,
        stiffness=k,
        damping=b,
        pulse=further,
        pulse_width=pulse_width,
        pulse_gate=gate,
        force_limit=force_limit,
    )
    return around_wall(wall, period=period, delay=delay, mass=mass, velocity=velocity)


def around_wall(
    law: Law, *, period: float, delay: float, mass: float, velocity: VelocityEstimator | None = None
) -> Controller:
    """Return a controller of one law along z.

    The five other axes are held.
    """
    hold = Hold.critically_damped(_HELD, inertia=[mass, mass, *INERTIA[3:]], period=period, delay=delay)
    return Controller([law, hold], period=period, velocity=velocity)


def _column(gain: ArrayLike) -> ArrayLike:
    """Return (N,) as (N, 1), and a number unchanged.

    The columns are axes.
    """
    values = np.asarray(gain)
    return values[:, None] if values.ndim else gain
