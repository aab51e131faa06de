"""Walls: PD wall with braking pulse, half-sample prediction, virtual coupling, passivity controller."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import field
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.control.laws.base import Answer, AxisLaw, Face, Gains, choose, gain, setting
from maglev_mj.control.timeline import check_delay
from maglev_mj.errors import ParameterError, check_one_of
from maglev_mj.frames import AXES, ZERO, Component, DeviceWall, Six, clipped
from maglev_mj.parameters import flag, number, store
from maglev_mj.spec import MAX_PERIOD, MIN_PERIOD


class _Braking(NamedTuple):
    """Braking pulse of one wall face; `active` is True for devices with a pulse, `limit` None without any limit."""

    pulse: Component
    active: Component
    limit: Component | None
    gate: Component


_Face: TypeAlias = tuple[int, float, Component, Component, Component, _Braking | None]
"""Wall plane with its gains: axis, normal, edge, stiffness, damping, braking pulse."""

_FaceState: TypeAlias = tuple[Component, Component | None]
"""Whether the last sample was free, and the remaining braking force or None."""

_FREE: _FaceState = (True, None)


class Wall(AxisLaw):
    """PD wall below `lower`, above `upper`, or both, with an optional braking pulse.

    Inside, f = -k (x - edge) - b v. On the first sample inside (x[k-1] free), f = -(pulse + b) v for `pulse_width`,
    and the PD force after it. If the pulse exceeds `force_limit`, the remaining impulse is applied at the next samples
    while the flotor still moves inward.

    Each parameter is a number, one number per axis, or (N, axes) for N devices. Use two laws for different gains on the
    two sides.

    Args:
        axes: Names from AXES; all six by default.
        lower: The wall fills x <= lower [m, rad]; -inf for none.
        upper: The wall fills x >= upper [m, rad]; inf for none.
        stiffness: Stiffness k [N/m, N m/rad].
        damping: Damping b [N s/m, N m s/rad].
        pulse: Additional damping during the braking pulse [N s/m, N m s/rad]; 0 for none. It stops the flotor within
            the pulse if pulse + damping = inertia / pulse_width.
        pulse_width: Pulse width [s]; a number.
        pulse_gate: Lowest approach speed that triggers a pulse [m/s, rad/s]; 0 for any. Without a gate, sensor noise
            triggers pulses while the flotor rests at the edge.
        force_limit: Force limit [N, N m], used to compute the remaining impulse; the plant itself saturates the force.
            Other laws on the axis are not counted.
        on: "host", or "device" for the PD wall alone at the device's own rate; its force is not part of the command.
        cutoff: Cutoff frequency of the velocity's low-pass filter on the device [Hz]; None for the finite difference.

    Raises:
        ParameterError: If a gain, the width, the gate or the limit is negative, no edge is finite, `lower` is not below
            `upper`, or shapes do not match.

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
    on: str = "host"
    cutoff: float | None = None

    _title = "wall"
    _faces: tuple[_Face, ...] = field(init=False, repr=False)
    _on_device: tuple[DeviceWall, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.on != "host":
            check_one_of("wall on", ("host", "device"), self.on)
        if self.on != "host" and np.any(self.pulse):
            raise ParameterError(f"wall pulse must be 0 on the device (got {self.pulse!r})")
        if self.cutoff is not None:
            number("wall cutoff", self.cutoff, above=0.0)
        if not np.less(self.lower, self.upper).all():
            raise ParameterError(f"wall lower must be below upper (got {self.lower!r} and {self.upper!r})")
        width = number("wall pulse_width", self.pulse_width, at_least=0.0, at_most=1.0, unit="s")
        if width == 0.0 and np.any(self.pulse):
            raise ParameterError("wall pulse_width must be above 0 with a pulse (got 0)")
        lower = [_face(axis, 1.0, law.lower, law) for axis, law in self._each]
        upper = [_face(axis, -1.0, law.upper, law) for axis, law in self._each]
        faces = tuple(face for face in (*lower, *upper) if face is not None)
        if not faces:
            raise ParameterError("wall needs a finite lower or upper, not -inf and inf")
        store(self, pulse_width=width, _faces=faces, _on_device=self._walls(faces) if self.on == "device" else ())

    def _walls(self, faces: Iterable[_Face]) -> tuple[DeviceWall, ...]:
        return tuple(DeviceWall(axis, x, int(side), k, b, self.cutoff) for axis, side, x, k, b, _ in faces)

    def faces(self) -> tuple[Face, ...]:
        """Return the wall planes; see `Face`."""
        return tuple(face[:3] for face in self._faces)

    def device_walls(self, state: Any) -> tuple[DeviceWall, ...]:
        """Return the faces, if they are on the device."""
        return self._on_device

    def gains(self) -> Iterable[Gains]:
        """Return stiffness and damping in contact; none on the host for a wall on the device."""
        if self.on == "device":
            return ()
        stiffness, damping = np.zeros((2, *self.batch, len(AXES)))
        for axis, _, _, spring, damper, _ in self._faces:
            stiffness[..., axis], damping[..., axis] = spring, damper
        return (Gains("contact", stiffness, damping),)

    def start(self) -> Sequence[_FaceState]:
        """Return the state before the first sample; a flotor that starts inside triggers no pulse."""
        return [(False, None)] * len(self._faces)

    def __call__(self, position: Six, velocity: Six, state: Any, wrench: list[Component]) -> Answer:
        """Add the forces for one sample; see `Law`."""
        pulses: list[Component] | None = None
        following = []
        if self._on_device:
            return state, None
        for (axis, normal, edge, stiffness, damping, braking), (free, remaining) in zip(self._faces, state):
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
                remaining = None
            elif remaining is not None or (free is not False and _any(inside & free)):
                approach = normal * speed
                entered = inside & free & (approach <= -braking.gate)
                pulse = (entered & braking.active) * (-(braking.pulse * speed + damped) - force)
                if remaining is not None:
                    pulse = pulse + (inside & (approach < 0.0) & _not(entered)) * remaining
                pulse, remaining = _within(braking.limit, force, pulse)
                pulses = pulses or [0.0] * len(AXES)
                pulses[axis] = pulses[axis] + pulse
            following.append((False if inside is True else ~inside, remaining))
        return following, pulses


def _face(axis: int, normal: float, edge: Component, gains: Any) -> _Face | None:
    finite = np.isfinite(edge)
    if np.any(finite) and not np.all(finite):
        raise ParameterError("wall edges of one axis must be finite on all devices or on none")
    if not np.all(finite):
        return None
    active, limited = gains.pulse > 0.0, not np.all(np.isinf(gains.force_limit))
    braking = _Braking(gains.pulse, active, gains.force_limit if limited else None, gains.pulse_gate)
    return axis, normal, edge, gains.stiffness, gains.damping, braking if np.any(active) else None


def _within(limit: Component | None, force: Component, pulse: Component) -> tuple[Component, Component | None]:
    """Saturate a pulse on top of a PD force; return it and the remainder for later samples, or None."""
    if limit is None:
        return pulse, None
    # excess of the total over the limit, less that of the PD force alone
    total = force + pulse
    excess = (total - clipped(total, limit)) - (force - clipped(force, limit))
    return pulse - excess, excess if _any(excess != 0.0) else None


def _any(mask: Component) -> bool:
    return mask if mask.__class__ is bool else bool(mask.any())


def _not(mask: Component) -> Component:
    return not mask if mask.__class__ is bool else ~mask


class _LowerWall(AxisLaw):
    """Wall below an edge on each axis."""

    lower: ArrayLike = gain(unit="m, rad", default=0.0, at_least=-math.inf)
    stiffness: ArrayLike = gain(unit="N/m, N m/rad")

    def faces(self) -> Sequence[Face]:
        """Return the wall planes."""
        return [(axis, 1.0, law.lower) for axis, law in self._each]


class HalfSampleWall(_LowerWall):
    """Wall with half-sample prediction, and the time at which its edge is crossed.

    Inside, f = -K (x + v T/2) - B v: the mean of the ideal force over the hold. If the line x + v t crosses the edge
    within the hold, only the part of the hold inside the wall counts. A delay is not predicted.

    Each gain is a number, one number per axis, or (N, axes) for N devices.

    Args:
        axes: Names from AXES; all six by default.
        lower: The wall fills x <= lower [m, rad].
        stiffness: Stiffness K [N/m, N m/rad].
        damping: Damping B [N s/m, N m s/rad].
        period: Sample period T [s].

    Raises:
        ParameterError: If a value is outside its bounds or shapes do not match.

    Source: a variant of ours, after Gillespie & Cutkosky 1996 (not opened): as quoted by others, theirs predicts by a
    model of hand and device, and drives the edge deadbeat.

    Example:
        >>> from maglev_mj import Controller, HalfSampleWall, Sample
        >>> wall = HalfSampleWall(axes="z", lower=0.0, stiffness=6000.0, damping=80.0, period=0.005)
        >>> round(Controller([wall], period=0.005).step(Sample(0, 0.0, [0, 0, -0.001, 0, 0, 0])).force[2], 3)
        6.0
    """

    damping: ArrayLike = gain(unit="N s/m, N m s/rad", default=0.0)
    period: float = setting(at_least=MIN_PERIOD, at_most=MAX_PERIOD, unit="s")

    def gains(self) -> Iterable[Gains]:
        """Return stiffness and damping in contact, B + K T/2."""
        damping = np.asarray(self.damping) + 0.5 * self.period * np.asarray(self.stiffness)
        return (Gains("contact", self.on_axes(self.stiffness), self.on_axes(damping)),)

    def force(self, x: Component, v: Component, gains: Any, state: None) -> Component:
        """Return the force on one axis; see `AxisLaw`."""
        begin = x - gains.lower
        end = begin + v * self.period
        first, last = begin * (begin < 0.0), end * (end < 0.0)
        travel = begin - end
        static = travel == 0.0
        share = (first - last) / (travel + static) + static * (begin <= 0.0)
        return -(share * (0.5 * gains.stiffness * (first + last) + gains.damping * v))


class VirtualCoupling(_LowerWall):
    """Spring and damper between the flotor and a virtual mass, which the wall stops.

    f = -K (x - y) - B (v - w) and M w' = -f, by the semi-implicit Euler method: w[k+1] = w[k] - f[k] T/M and
    y[k+1] = y[k] + T w[k+1]. At the edge the virtual mass stops, y = lower and w = 0. In contact the law is the PD
    wall, and in free air the flotor drags the virtual mass along: a stable coupling needs both loops stable.

    Each gain is a number, one number per axis, or (N, axes) for N devices.

    Args:
        axes: Names from AXES; all six by default.
        lower: The wall fills y <= lower [m, rad].
        stiffness: Stiffness K of the coupling [N/m, N m/rad].
        damping: Damping B of the coupling [N s/m, N m s/rad].
        inertia: Virtual mass or moment of inertia M [kg, kg m²].
        period: Sample period T [s].

    Raises:
        ParameterError: If a value is outside its bounds or shapes do not match.

    Source: a variant of ours. The coupling's force is that of `VirtualToolCoupler` in github.com/simquest/opensurgsim;
    the virtual mass, its step and its stop are ours. Colgate, Stanley & Brown 1995 and Adams & Hannaford 1999: not
    opened.

    Example:
        >>> from maglev_mj import Controller, Sample, VirtualCoupling
        >>> wall = VirtualCoupling(axes="z", stiffness=6000.0, damping=80.0, inertia=0.7, period=0.005)
        >>> round(Controller([wall], period=0.005).step(Sample(0, 0.0, [0, 0, -0.001, 0, 0, 0])).force[2], 3)
        6.0
    """

    damping: ArrayLike = gain(unit="N s/m, N m s/rad")
    inertia: ArrayLike = gain(unit="kg, kg m²", above=0.0)
    period: float = setting(at_least=MIN_PERIOD, at_most=MAX_PERIOD, unit="s")

    def force(self, x: Component, v: Component, gains: Any, state: Any) -> tuple[Component, Any]:
        """Return the force on one axis, and position and velocity of the virtual mass; see `AxisLaw`."""
        y, w = (choose(x > gains.lower, x, gains.lower + 0.0 * x), 0.0 * x) if state is None else state
        pull = gains.stiffness * (x - y) + gains.damping * (v - w)
        w = w + self.period / gains.inertia * pull
        y = y + self.period * w
        free = y > gains.lower
        return -pull, (choose(free, y, gains.lower + 0.0 * y), choose(free, w, 0.0 * w))


_AxisState: TypeAlias = tuple[Component, Component, tuple[Component, ...]]
"""Absorbed energy [J], last position, and past forces, newest first."""


class PassivityController(AxisLaw):
    """Time-domain passivity controller of the laws before it.

    It observes the energy that they absorb, their own damping included, and dissipates a deficit. While E < 0, the
    damper b = -E / (T v²) is added, up to `most`: more would be unstable under the delay. At rest, with E > 0, it has
    no gains.

    With `paired`, E[k] = E[k-1] - f (x[k] - x[k-1]), f the force in effect; with a delay, the weighted mean of the two
    forces in effect. This balances the energy after a contact, not at every instant: a deficit is observed at the next
    sample and dissipated after it, outside the wall too. Measured without delay at 200 Hz and 0.7 kg, `most` 60 N s/m:
    from the third sample outside on, springs up to 4000 N/m have returned at most 1.002 times the absorbed energy (20
    kN/m 1.15), but up to 1.58 (3.41) times before. With a delay the damper acts later.

    Without `paired`, E[k] = E[k-1] - T f[k] v[k] + T b v[k]², a force with the velocity at its own sample. It detects
    no energy generated by the hold: over the finite difference, -T f v of a spring is its change of energy and
    K (x[k] - x[k-1])²/2, never less.

    Args:
        axes: Names from AXES; all six by default.
        period: Sample period [s].
        most: Largest added damping [N s/m, N m s/rad]; a number, one per axis, or (N, axes).
        delay: Transport delay [s]; only with `paired`.
        slow: Lowest speed with added damping [m/s, rad/s]; below it the damping would tend to infinity.
        paired: True for the force in effect, False for the series controller of 2002.

    Raises:
        ParameterError: If a value is outside its bounds or shapes do not match.

    Source: without `paired` the recursion of `tdpa.rs` in github.com/spebern/haptic-toolbox, with the period, but for
    `most` and `slow`; Hannaford & Ryu 2002 was not opened. `paired` is a variant of ours.
    """

    period: float = setting(at_least=MIN_PERIOD, at_most=MAX_PERIOD, unit="s")
    most: ArrayLike = gain(unit="N s/m, N m s/rad")
    delay: float = 0.0
    slow: float = setting(default=1e-4, above=0.0)
    paired: bool = True

    _split: tuple[int, float] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        super().__post_init__()
        store(self, _split=check_delay(self.delay, self.period), paired=flag("paired", self.paired))

    def gains(self) -> Iterable[Gains]:
        """Return no gains: at rest no energy is missing."""
        return ()

    def start(self) -> list[_AxisState]:
        """Return the state before the first sample."""
        return [(0.0, math.nan, (0.0,) * (self._split[0] + 2))] * len(self._each)

    def skip(self, position: Six, velocity: Six, state: Any) -> Any:
        """Count the energy of the held force; see `Law`."""
        held = {axis: forces[0] for axis, (_, _, forces) in zip(self.indices, state)}
        return self(position, ZERO, state, [held.get(axis, 0.0) for axis in range(len(AXES))])[0]

    def signals(self, state: Sequence[_AxisState]) -> dict[str, Sequence[Component]]:
        """Return the absorbed energy [J] of each axis."""
        return {"energy": [axis[0] for axis in state]}

    def __call__(self, position: Six, velocity: Six, state: Any, wrench: list[Component]) -> Answer:
        """Add the forces for one sample; see `Law`."""
        following: list[_AxisState] = []
        for (axis, gains), (energy, last, forces) in zip(self._each, state):
            most = gains.most
            now, rendered = position[axis], wrench[axis]
            travel = choose(last == last, now - last, 0.0 * now)  # NaN before the first sample: no energy
            share, speed = self._split[1] / self.period, velocity[axis]
            if self.paired:
                energy = energy - (share * forces[-1] + (1.0 - share) * forces[-2]) * travel
            else:
                energy = energy - self.period * rendered * speed
            fast = (speed > self.slow) | (speed < -self.slow)
            power = self.period * speed * speed
            required = choose(fast & (energy < 0.0), -energy / (power + (power == 0.0)), 0.0 * now)
            damping = choose(required < most, required, most + 0.0 * now)
            total = rendered - damping * speed
            wrench[axis] = total
            if not self.paired:
                energy = energy + damping * power
            following.append((energy, now, (total, *forces[:-1])))
        return following, None
