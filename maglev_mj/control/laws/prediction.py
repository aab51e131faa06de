"""Predictive walls: linear extrapolation or model-based observer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.control.laws.base import AxisLaw, Face, LinearController, gain
from maglev_mj.control.laws.friction import choose
from maglev_mj.control.timeline import MOST_PERIODS, split_delay
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array, Component
from maglev_mj.parameters import flag, number


class PredictiveWall(AxisLaw):
    """Wall that renders the predicted mean force over each hold.

    The position is extrapolated along a straight line, and the force of the ideal wall averaged over it.

    Inside the wall this is half-sample prediction, f = -K (x + v (T_d + T/2)) - B v. If the line crosses the edge
    within the hold, only the part inside the wall counts.

    Each gain is a number for all of the law's axes, one number an axis, or (N, axes) for N devices.

    Args:
        axes: Names from AXES; all six by default.
        lower: The wall fills x <= lower [m, rad].
        stiffness: Stiffness K [N/m, N m/rad].
        damping: Damping B [N s/m, N m s/rad].
        period: Sample period T [s].
        delay: Transport delay T_d [s].

    Raises:
        ParameterError: If a value is outside its bounds or a shape does not fit.

    Source: after Gillespie & Cutkosky 1996, with half-sample prediction and deadbeat control of the crossing there; the
        mean over the hold is this project's.

    Example:
        >>> from maglev_mj import Controller, PredictiveWall, Sample
        >>> wall = PredictiveWall(axes="z", lower=0.0, stiffness=6000.0, damping=80.0, period=0.005, delay=0.0015)
        >>> round(Controller([wall], period=0.005).step(Sample(0, 0.0, [0, 0, -0.001, 0, 0, 0])).force[2], 3)
        6.0
    """

    lower: ArrayLike = gain(unit="m, rad", default=0.0, at_least=-math.inf)
    stiffness: ArrayLike = gain(unit="N/m, N m/rad")
    damping: ArrayLike = gain(unit="N s/m, N m s/rad", default=0.0)
    period: float
    delay: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        number("period", self.period, above=0.0)
        number("delay", self.delay, at_least=0.0)

    def force(self, x: Component, v: Component, gains: Any, state: None) -> Component:
        """Return the force on one axis; see `AxisLaw`."""
        begin = x - gains.lower + v * self.delay
        end = begin + v * self.period
        deep, deeper = begin * (begin < 0.0), end * (end < 0.0)
        travel = begin - end
        rests = travel == 0.0
        share = (deep - deeper) / (travel + rests) + rests * (begin <= 0.0)
        return -(share * (0.5 * gains.stiffness * (deep + deeper) + gains.damping * v))

    def faces(self) -> Sequence[Face]:
        """Return each plane of the wall."""
        return [(axis, 1.0, one.lower) for axis, one in self._each]


class _Belief(NamedTuple):
    """Observer state at a sample.

    The forces are the law's own, newest first: those still delayed, the one in effect, and the one before.
    """

    place: Component
    speed: Component
    unknown: Component  # acceleration by unmodelled forces
    forces: tuple[Component, ...]


class ObserverWall(AxisLaw):
    """Wall with state feedback from a delay-compensating observer.

    The feedback uses the state predicted for the moment the command takes effect.

    The model is a mass under the law's own forces, including the delayed ones, so that the delay is part of the state.
    An observer with equal poles corrects it at each sample. An unmodelled force, such as a hand's, biases the estimate:
    the wall is softer than its gain, unless the observer estimates that force too (`disturbance`).

    Each gain is a number for all of the law's axes, one number an axis, or (N, axes) for N devices.

    Args:
        axes: Names from AXES; all six by default.
        lower: The wall fills x <= lower [m, rad].
        stiffness: Gain on the position at the moment of effect [N/m, N m/rad].
        damping: Gain on the velocity then [N s/m, N m s/rad].
        inertia: Mass or moment of inertia in the model [kg, kg m²].
        period: Sample period [s].
        delay: Transport delay in the model [s].
        pole: Position of the observer's poles, in [0, 1); 0 for deadbeat.
        disturbance: True to estimate a constant unknown force.
        force_limit: Largest actuator force [N, N m]; a number. Without it the model assumes forces beyond saturation,
            and a hard impact throws the flotor out.

    Raises:
        ParameterError: If a value is outside its bounds or a shape does not fit.

    Source: the design reported by Salcudean & Vlaar 1997 from Vlaar 1994, delay as poles at the origin; gains and
        observer are this project's, the observer's gains those of a fading-memory filter.

    Example:
        >>> from maglev_mj import Controller, ObserverWall, Sample
        >>> wall = ObserverWall(axes="z", stiffness=12000.0, damping=150.0, inertia=0.7, period=0.005, delay=0.0015)
        >>> round(Controller([wall], period=0.005).step(Sample(0, 0.0, [0, 0, -0.001, 0, 0, 0])).force[2], 3)
        12.0
    """

    lower: ArrayLike = gain(unit="m, rad", default=0.0, at_least=-math.inf)
    stiffness: ArrayLike = gain(unit="N/m, N m/rad")
    damping: ArrayLike = gain(unit="N s/m, N m s/rad")
    inertia: ArrayLike = gain(unit="kg, kg m²", above=0.0)
    period: float
    delay: float
    pole: float = 0.0
    disturbance: bool = False
    force_limit: float = math.inf

    _whole: int = field(init=False, repr=False)
    _rest: float = field(init=False, repr=False)

    def __post_init__(self) -> None:
        period = number("period", self.period, above=0.0)
        delay = number("delay", self.delay, at_least=0.0, at_most=MOST_PERIODS * period)
        whole, rest = split_delay(delay, period)
        object.__setattr__(self, "_whole", int(whole))
        object.__setattr__(self, "_rest", rest)
        super().__post_init__()
        flag("disturbance", self.disturbance)
        if not self.force_limit > 0.0:
            raise ParameterError(f"wall force_limit must be above 0, not {self.force_limit!r}")
        number("pole", self.pole, at_least=0.0, below=1.0)

    def force(self, x: Component, v: Component, gains: Any, state: _Belief | None) -> tuple[Component, _Belief]:
        """Return the force on one axis and its observer state.

        The observer starts at rest at the first position seen.

        The controller's own velocity estimate is not used.
        """
        offset = x - gains.lower
        if state is None:
            known = _Belief(offset, 0.0, 0.0, (0.0,) * (self._whole + 2))
        else:
            known = self._corrected(state, offset, gains.inertia)
        place, speed = self._at_effect(known, gains.inertia)
        force = (place <= 0.0) * -(gains.stiffness * place + gains.damping * speed)
        given = force if self.force_limit == math.inf else _limited(force, self.force_limit)
        return force, known._replace(forces=(given, *known.forces[:-1]))

    def faces(self) -> Sequence[Face]:
        """Return each plane of the wall."""
        return [(axis, 1.0, one.lower) for axis, one in self._each]

    def linear(self, stiffness: Array, damping: Array) -> LinearController:
        """Return the law in contact as a linear system.

        The gains have shape (...,); the inertia is that of its first axis.

        Its state is position, velocity, unknown acceleration, and the forces, newest first.
        """
        inertia = np.asarray(self._each[0][1].inertia)
        size = 3 + self._whole + 2
        shape = np.broadcast_shapes(stiffness.shape, damping.shape, inertia.shape)
        columns = []
        for part in np.eye(size + 1):  # each entry of the memory in turn, then the position
            belief = _Belief(part[0], part[1], part[2], tuple(part[3:size]))
            known = self._corrected(belief, part[size], inertia)
            place, speed = self._at_effect(known, inertia)
            force = -(stiffness * place + damping * speed)
            rows = (known.place, known.speed, known.unknown, force, *known.forces[:-1], force)
            columns.append(np.stack([np.broadcast_to(row, shape) for row in rows], axis=-1))
        whole = np.stack(columns, axis=-1)
        return LinearController(
            whole[..., :size, :size], whole[..., :size, size], whole[..., size, :size], whole[..., size, size]
        )

    def _corrected(self, belief: _Belief, seen: Component, inertia: Component) -> _Belief:
        """Return the observer state after one period and correction.

        `seen` is the measured position; all observer poles are equal.
        """
        place, speed, unknown, forces = belief
        pole, period = self.pole, self.period
        place, speed = _moved(place, speed, unknown + forces[-1] / inertia, self._rest)
        place, speed = _moved(place, speed, unknown + forces[-2] / inertia, period - self._rest)
        missed = seen - place
        if self.disturbance:
            first, second = 1.0 - pole**3, 1.5 * (1.0 - pole) ** 2 * (1.0 + pole)
            unknown = unknown + (1.0 - pole) ** 3 / period**2 * missed
        else:
            first, second = 1.0 - pole**2, (1.0 - pole) ** 2
            unknown = 0.0 * missed
        return _Belief(place + first * missed, speed + second / period * missed, unknown, forces)

    def _at_effect(self, belief: _Belief, inertia: Component) -> tuple[Component, Component]:
        """Return predicted position and velocity at the command's effect."""
        place, speed, unknown, forces = belief
        place, speed = _moved(place, speed, unknown + forces[-2] / inertia, self._rest)
        for force in forces[-3::-1]:
            place, speed = _moved(place, speed, unknown + force / inertia, self.period)
        return place, speed


def _limited(force: Component, limit: float) -> Component:
    return choose(force > limit, limit + 0.0 * force, choose(force < -limit, -limit + 0.0 * force, force))


def _moved(place: Component, speed: Component, acceleration: Component, duration: float) -> tuple[Component, Component]:
    return place + duration * (speed + 0.5 * duration * acceleration), speed + duration * acceleration
