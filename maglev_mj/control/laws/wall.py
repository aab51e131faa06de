"""Walls: spring and damper with braking pulse, predictive walls, and passivity control of them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import field
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.control.laws.base import Answer, AxisLaw, Face, Gains, LinearController, choose, gain, setting
from maglev_mj.control.timeline import checked_delay
from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Array, Component, Six, clipped
from maglev_mj.parameters import flag, number, store


class _Braking(NamedTuple):
    """Braking-pulse parameters of one wall face.

    `some` is True for devices with a pulse; `limit` is None if no device has a limit.
    """

    pulse: Component
    some: Component
    limit: Component | None
    gate: Component


_Face: TypeAlias = tuple[int, float, Component, Component, Component, _Braking | None]
"""One plane of the wall with its gains.

Axis, normal, edge, stiffness, damping, braking. The axis is free while normal * (x - edge) > 0.
"""

_FaceState: TypeAlias = tuple[Component, Component | None]
"""Free flag of the last sample, and remaining braking force.

The remaining force is None if there is none.
"""

_FREE: _FaceState = (True, None)


class Wall(AxisLaw):
    """PD wall on one or both sides, with braking pulse.

    The wall is below `lower`, above `upper`, or both. The pulse is given on the first sample inside.

    Inside, f = -stiffness (x - edge) - damping v. On the sample k with x[k-1] free and x[k] inside, the force
    is -(pulse + damping) v for `pulse_width` and the PD value after it. If it exceeds `force_limit`, the rest of
    the impulse follows on the next samples while the flotor still moves inward.

    Each parameter is a number for all of the law's axes, one number per axis, or (N, axes) for N devices. Use
    two laws for different gains on the two sides.

    Args:
        axes: Names from AXES; all six by default.
        lower: The wall fills x <= lower [m, rad]; -inf for none.
        upper: The wall fills x >= upper [m, rad]; inf for none.
        stiffness: Stiffness [N/m, N m/rad].
        damping: Damping [N s/m, N m s/rad].
        pulse: Further damping in the braking pulse [N s/m, N m s/rad]; 0 for none. Stopping within the pulse
            takes pulse + damping = inertia / pulse_width.
        pulse_width: Duration of the pulse [s]; a number.
        pulse_gate: Least approach speed for a pulse [m/s, rad/s]; 0 for always. Without it sensor noise triggers
            pulses on a flotor at rest at the edge.
        force_limit: Largest actuator force [N, N m], used to compute the rest of a pulse; the plant applies the
            limit itself. Other laws on the axis are not counted.

    Raises:
        ParameterError: If a gain, the width, the gate or the limit is negative, no side is given, `lower` is not below
            `upper`, or a shape does not fit.

    Source: Salcudean & Vlaar 1997, eq. (3), (8) and (9), with one delay less as in the simulation of figure 3.

    Example:
        >>> from maglev_mj import Controller, Sample, Wall
        >>> wall = Wall(axes="z", lower=0.0, stiffness=6000.0, damping=80.0, pulse=220.0, pulse_width=0.003)
        >>> controller = Controller([wall], period=0.005)
        >>> controller.step(Sample(0, 0.0, [0, 0, 0.001, 0, 0, 0])).force[2]  # outside
        0.0
        >>> entered = controller.step(Sample(1, 0.005, [0, 0, -0.0005, 0, 0, 0]))  # at -0.3 m/s
        >>> round(entered.force[2]), round(entered.extra[2]), entered.pulse_width
        (27, 63, 0.003)
    """

    lower: ArrayLike = gain(unit="m, rad", default=-math.inf, at_least=-math.inf, finite=False)
    upper: ArrayLike = gain(unit="m, rad", default=math.inf, at_least=-math.inf, finite=False)
    stiffness: ArrayLike = gain(unit="N/m, N m/rad")
    damping: ArrayLike = gain(unit="N s/m, N m s/rad")
    pulse: ArrayLike = gain(unit="N s/m, N m s/rad", default=0.0)
    pulse_width: float = 0.0
    pulse_gate: ArrayLike = gain(unit="m/s, rad/s", default=0.0)
    force_limit: ArrayLike = gain(unit="N, N m", default=math.inf, finite=False)

    _title = "wall"
    _faces: tuple[_Face, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not np.less(self.lower, self.upper).all():
            raise ParameterError(f"wall lower must be below upper, not {self.lower!r} and {self.upper!r}")
        width = number("wall pulse_width", self.pulse_width, at_least=0.0)
        if width == 0.0 and np.any(self.pulse):
            raise ParameterError("wall pulse_width must be above 0 where there is a pulse, not 0")
        lower = [_face(axis, 1.0, one.lower, one) for axis, one in self._each]
        upper = [_face(axis, -1.0, one.upper, one) for axis, one in self._each]
        faces = tuple(face for face in (*lower, *upper) if face is not None)
        if not faces:
            raise ParameterError("wall needs a finite lower or upper, not -inf and inf")
        store(self, pulse_width=width, _faces=faces)

    def faces(self) -> tuple[Face, ...]:
        """Return each plane: index into AXES, normal, edge.

        The axis is free while normal (x - edge) > 0.
        """
        return tuple(face[:3] for face in self._faces)

    def gains(self) -> Iterable[Gains]:
        """Return stiffness and damping in contact."""
        stiffness, damping = np.zeros((2, *self.batch, len(AXES)))
        for axis, _, _, spring, damper, _ in self._faces:
            stiffness[..., axis], damping[..., axis] = spring, damper
        return (Gains("contact", stiffness, damping),)

    def start(self) -> Sequence[_FaceState]:
        """Return the state before the first sample.

        A flotor inside at the first sample has not entered.
        """
        return [(False, None)] * len(self._faces)

    def __call__(self, position: Six, velocity: Six, state: Any, wrench: list[Component]) -> Answer:
        """Answer one sample; see `Law`."""
        pulses: list[Component] | None = None
        following = []
        for (axis, normal, edge, stiffness, damping, braking), (free, owed) in zip(self._faces, state):
            offset = position[axis] - edge
            inside = offset <= 0.0 if normal > 0.0 else offset >= 0.0
            if inside is False or (inside is not True and not inside.any()):
                following.append(_FREE)
                continue
            speed = velocity[axis]
            damped = damping * speed
            force = inside * -(stiffness * offset + damped)
            wrench[axis] = wrench[axis] + force
            if braking is None:
                owed = None
            elif owed is not None or (free is not False and _any(inside & free)):
                approach = normal * speed
                entered = inside & free & (approach <= -braking.gate)
                pulse = (entered & braking.some) * (-(braking.pulse * speed + damped) - force)
                if owed is not None:
                    pulse = pulse + (inside & (approach < 0.0) & _not(entered)) * owed
                pulse, owed = _within(braking.limit, force, pulse)
                pulses = pulses or [0.0] * len(AXES)
                pulses[axis] = pulses[axis] + pulse
            following.append((False if inside is True else ~inside, owed))
        return following, pulses


def _face(axis: int, normal: float, edge: Component, gains: Any) -> _Face | None:
    """Return the face of an axis; None without an edge."""
    finite = np.isfinite(edge)
    if np.any(finite) and not np.all(finite):
        raise ParameterError("wall edges of one axis must be finite on all devices or on none")
    if not np.all(finite):
        return None
    some, limited = gains.pulse > 0.0, not np.all(np.isinf(gains.force_limit))
    braking = _Braking(gains.pulse, some, gains.force_limit if limited else None, gains.pulse_gate)
    return axis, normal, edge, gains.stiffness, gains.damping, braking if np.any(some) else None


def _within(limit: Component | None, force: Component, pulse: Component) -> tuple[Component, Component | None]:
    """Return the pulse within the force limit, and the impulse left over.

    The pulse is on top of the PD force; later samples give the rest.
    """
    if limit is None:
        return pulse, None
    # excess over the limit with the pulse, less the excess of the PD force alone
    whole = force + pulse
    left = (whole - clipped(whole, limit)) - (force - clipped(force, limit))
    return pulse - left, left if _any(left != 0.0) else None


def _any(mask: Component) -> bool:
    return mask if mask.__class__ is bool else bool(mask.any())


def _not(mask: Component) -> Component:
    return not mask if mask.__class__ is bool else ~mask


class _LowerWall(AxisLaw):
    """Wall below an edge on each axis."""

    lower: ArrayLike = gain(unit="m, rad", default=0.0, at_least=-math.inf)
    stiffness: ArrayLike = gain(unit="N/m, N m/rad")

    def faces(self) -> Sequence[Face]:
        """Return each plane of the wall."""
        return [(axis, 1.0, one.lower) for axis, one in self._each]


class PredictiveWall(_LowerWall):
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

    damping: ArrayLike = gain(unit="N s/m, N m s/rad", default=0.0)
    period: float = setting(above=0.0)
    delay: float = setting(default=0.0, at_least=0.0)

    def force(self, x: Component, v: Component, gains: Any, state: None) -> Component:
        """Return the force on one axis; see `AxisLaw`."""
        begin = x - gains.lower + v * self.delay
        end = begin + v * self.period
        deep, deeper = begin * (begin < 0.0), end * (end < 0.0)
        travel = begin - end
        rests = travel == 0.0
        share = (deep - deeper) / (travel + rests) + rests * (begin <= 0.0)
        return -(share * (0.5 * gains.stiffness * (deep + deeper) + gains.damping * v))


class _Belief(NamedTuple):
    """Observer state at a sample.

    The forces are the law's own, newest first: those still delayed, the one in effect, and the one before.
    """

    place: Component
    speed: Component
    unknown: Component  # acceleration by unmodelled forces
    forces: tuple[Component, ...]


class ObserverWall(_LowerWall):
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

    damping: ArrayLike = gain(unit="N s/m, N m s/rad")
    inertia: ArrayLike = gain(unit="kg, kg m²", above=0.0)
    period: float = setting(above=0.0)
    delay: float
    pole: float = setting(default=0.0, at_least=0.0, below=1.0)
    disturbance: bool = False
    force_limit: float = math.inf

    _split: tuple[int, float] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        store(self, _split=checked_delay(self.delay, self.period))
        flag("disturbance", self.disturbance)
        if not self.force_limit > 0.0:
            raise ParameterError(f"wall force_limit must be above 0, not {self.force_limit!r}")

    def force(self, x: Component, v: Component, gains: Any, state: _Belief | None) -> tuple[Component, _Belief]:
        """Return the force on one axis and its observer state.

        The observer starts at rest at the first position seen.

        The controller's own velocity estimate is not used.
        """
        offset = x - gains.lower
        if state is None:
            belief = _Belief(offset, 0.0, 0.0, (0.0,) * (self._split[0] + 2))
        else:
            belief = self._corrected(state, offset, gains.inertia)
        place, speed = self._at_effect(belief, gains.inertia)
        force = (place <= 0.0) * -(gains.stiffness * place + gains.damping * speed)
        applied = force if self.force_limit == math.inf else clipped(force, self.force_limit)
        return force, belief._replace(forces=(applied, *belief.forces[:-1]))

    def linear(self, stiffness: Array, damping: Array) -> LinearController:
        """Return the law in contact as a linear system.

        The gains have shape (...,); the inertia is that of its first axis.

        Its state is position, velocity, unknown acceleration, and the forces, newest first.
        """
        inertia = np.asarray(self._each[0][1].inertia)
        size = 3 + self._split[0] + 2
        shape = np.broadcast_shapes(stiffness.shape, damping.shape, inertia.shape)
        columns = []
        for part in np.eye(size + 1):  # each entry of the memory in turn, then the position
            memory = _Belief(part[0], part[1], part[2], tuple(part[3:size]))
            belief = self._corrected(memory, part[size], inertia)
            place, speed = self._at_effect(belief, inertia)
            force = -(stiffness * place + damping * speed)
            rows = (belief.place, belief.speed, belief.unknown, force, *belief.forces[:-1], force)
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
        pole, period, rest = self.pole, self.period, self._split[1]
        place, speed = _moved(place, speed, unknown + forces[-1] / inertia, rest)
        place, speed = _moved(place, speed, unknown + forces[-2] / inertia, period - rest)
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
        place, speed = _moved(place, speed, unknown + forces[-2] / inertia, self._split[1])
        for force in forces[-3::-1]:
            place, speed = _moved(place, speed, unknown + force / inertia, self.period)
        return place, speed


def _moved(place: Component, speed: Component, acceleration: Component, duration: float) -> tuple[Component, Component]:
    return place + duration * (speed + 0.5 * duration * acceleration), speed + duration * acceleration


_AxisState: TypeAlias = tuple[Component, Component, tuple[Component, ...]]
"""Absorbed energy [J], last position, past forces.

The forces are newest first.
"""


class PassivityController(AxisLaw):
    """Time-domain passivity controller; must be the last law.

    It observes the energy rendered by the laws before it and dissipates any surplus.

    The energy absorbed over the last period is -f (x[k] - x[k-1]), its own damping included. f is the force in effect;
    with a delay, it is the weighted mean of the two forces in effect. While the sum is negative, a damper is added that
    would dissipate the deficit over one period at the present speed, up to `most`: more would not be stable under the
    delay. Without delay this makes any wall passive; with a delay the damper acts too late.

    Args:
        axes: Names from AXES; all six by default.
        period: Sample period [s].
        most: Largest damping added [N s/m, N m s/rad]; a number, one an axis, or (N, axes).
        delay: Transport delay [s].
        slow: Least speed for added damping [m/s, rad/s]: at lower speed the damper would tend to infinity.

    Raises:
        ParameterError: If a value is outside its bounds or a shape does not fit.

    Source: Hannaford & Ryu 2002, series controller in impedance causality; not checked against the original.
    """

    period: float = setting(above=0.0)
    most: ArrayLike = gain(unit="N s/m, N m s/rad")
    delay: float = 0.0
    slow: float = setting(default=1e-4, above=0.0)

    _split: tuple[int, float] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        store(self, _split=checked_delay(self.delay, self.period))

    def start(self) -> list[_AxisState]:
        """Return the state before the first sample."""
        return [(0.0, math.nan, (0.0,) * (self._split[0] + 2))] * len(self._each)

    def signals(self, state: Sequence[_AxisState]) -> dict[str, Sequence[Component]]:
        """Return the absorbed energy [J] of each axis."""
        return {"energy": [one[0] for one in state]}

    def __call__(self, position: Six, velocity: Six, state: Any, wrench: list[Component]) -> Answer:
        """Answer one sample; see `Law`."""
        following: list[_AxisState] = []
        for (axis, gains), (energy, place, forces) in zip(self._each, state):
            most = gains.most
            now, rendered = position[axis], wrench[axis]
            moved = choose(place == place, now - place, 0.0 * now)  # no energy before the first sample
            share = self._split[1] / self.period
            energy = energy - (share * forces[-1] + (1.0 - share) * forces[-2]) * moved
            speed = velocity[axis]
            fast = (speed > self.slow) | (speed < -self.slow)
            power = self.period * speed * speed
            wanted = choose(fast & (energy < 0.0), -energy / (power + (power == 0.0)), 0.0 * now)
            added = choose(wanted < most, wanted, most + 0.0 * now)
            total = rendered - added * speed
            wrench[axis] = total
            following.append((energy, now, (total, *forces[:-1])))
        return following, None
