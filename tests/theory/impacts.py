"""Impacts under a force limit: rattles and drops.

Of a flotor between two walls, and of one that is dropped.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.control import Law, Wall
from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import drive
from maglev_mj.frames import Array, Command, Sample
from maglev_mj.parameters import numbers
from maglev_mj.plants import ExactPlant, SampledPlant, Timing
from maglev_mj.scenes.wall_scene import along, wall_controller
from maglev_mj.spec import Spec

_MASS = Spec.moving_mass.value
_PERIOD = 1.0 / Spec.control_rate.value
_DELAY = Spec.transport_delay.value

FAR = (1e9, 1.0)
"""Escape bounds for unstable flotors: distance [m], angle [rad].

They let an unstable run go on to its end.
"""


class Watch:
    """Observer of positions along z and of pulses: positions are (ticks, N), pulse counts (N,)."""

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


class Rattle(NamedTuple):
    """Motion between two walls, of the shape of the starts.

    Attributes:
        speed: Greatest speed in the last second, from sample to sample [m/s]; above `RATTLE` it rattles.
        furthest: Greatest distance of a sample from the middle [m].
    """

    speed: Array
    furthest: Array


RATTLE = 0.01
"""Speed above which a flotor still rattles [m/s].

After the default duration; a flotor that coasts loses it.
"""


def rattle(
    gaps: ArrayLike,
    speeds: ArrayLike,
    phases: ArrayLike = 0.0,
    *,
    pulse: float,
    starts: ArrayLike = 0.0,
    stiffness: float = 6000.0,
    damping: float = 80.0,
    delay: float = _DELAY,
    period: float = _PERIOD,
    force_limit: float = Spec.largest_vertical_force.value,
    duration: float = 16.0,
) -> Rattle:
    """Throw flotors between two walls, without weight."""
    shape, (gap, speed, phase, start) = _starts(gaps=gaps, speeds=speeds, phases=phases, starts=starts)
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
        pose=along("z", 0.5 * gap * start),
        twist=along("z", speed),
        gravity=0.0,
        wrench_limit=force_limit,
        escape=FAR,
    )
    places = watched(plant, Controller([walls], period=period), duration, gap.size).places
    late = np.abs(np.diff(places[-round(1.0 / period) :], axis=0)).max(axis=0) / period
    return Rattle(*(part.reshape(shape) for part in (late, np.abs(places).max(axis=0))))


class LimitedDrop(NamedTuple):
    """Drops on a wall whose actuators saturate.

    Attributes:
        swing: Swing of the position in the last second [m].
        furthest: Greatest distance from the centre [m]; the wall fills z <= 0.
    """

    swing: Array
    furthest: Array


def limited_drop(
    heights: ArrayLike,
    law: Law,
    phases: ArrayLike = 0.0,
    *,
    force_limit: ArrayLike,
    delay: float = _DELAY,
    period: float = _PERIOD,
    duration: float = 4.0,
) -> LimitedDrop:
    """Drop the flotor on a wall under a force limit."""
    shape, (height, phase, limit) = _starts(heights=heights, phases=phases, force_limit=force_limit)
    plant = ExactPlant(
        Timing(period=period, delay=delay, phase=phase),
        pose=along("z", height),
        wrench_limit=np.repeat(limit[:, None], 6, axis=1),
        escape=FAR,
        record=True,
    )
    controller = wall_controller(law, period=period, delay=delay, mass=_MASS)
    places = watched(plant, controller, duration, height.size).places
    swing = np.ptp(places[-round(1.0 / period) :], axis=0)
    furthest = plant.trace().furthest()[:, 2]
    return LimitedDrop(*(part.reshape(shape) for part in (swing, furthest)))


def _starts(**given: ArrayLike) -> tuple[tuple[int, ...], list[Array]]:
    """Return the broadcast shape and each value, (N,)."""
    values = np.broadcast_arrays(*(numbers(name, value) for name, value in given.items()))
    return values[0].shape, [value.ravel() for value in values]
