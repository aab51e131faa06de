"""Closed loop of a wall with one law on the host and one on the device, at two rates.

Between events, a sample or the effect of a command, both forces are constant, so each event is a linear map.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from operator import itemgetter
from typing import Unpack

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.control import FiniteDifference, LinearController, LowPass
from maglev_mj.control.timeline import split_delay
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array
from maglev_mj.keywords import with_hints
from maglev_mj.parameters import SAMPLE_PERIOD, number, transport_delay
from maglev_mj.plants.hand import exponential
from maglev_mj.theory.boundary import scales
from maglev_mj.theory.closed_loop import LoopKeywords, SampledLoop, bisect, bracket, is_stable, pd

_DENOMINATOR, _TOLERANCE = 4, 0.02
_GRID, _HALVINGS = np.geomspace(8e-5, 64.0, 240), 45


@with_hints
@dataclass(frozen=True)
class DeviceLaw:
    """PD law on the device, f = -K x - B v; alone it is a `SampledLoop` of its period, delay and `velocity`.

    Args:
        stiffness: Stiffness K [N/m].
        damping: Damping B [N s/m].
        period: Sample period h [s].
        delay: Time from a sample to the effect of its command [s], up to 10 periods.
        cutoff: Cutoff frequency of the velocity's low-pass filter [Hz]; None for the finite difference.

    Raises:
        ParameterError: If a value is outside its bounds.

    Source: the law of Salcudean & Vlaar 1997, eq. (3), moved to the device.
    """

    stiffness: float = 0.0
    damping: float = 0.0
    period: float = 1e-3
    delay: float = 2e-4
    cutoff: float | None = None

    def __post_init__(self) -> None:
        number("device stiffness", self.stiffness, at_least=0.0)
        number("device damping", self.damping, at_least=0.0)
        number("device period", self.period, **SAMPLE_PERIOD)
        transport_delay(number("device delay", self.delay), self.period)
        if self.cutoff is not None:
            number("device cutoff", self.cutoff, above=0.0)

    @property
    def velocity(self) -> FiniteDifference | LowPass:
        """Velocity estimator."""
        return FiniteDifference() if self.cutoff is None else LowPass(self.cutoff)


def two_rate_radius(stiffness: ArrayLike, damping: ArrayLike, device: DeviceLaw, **loop: Unpack[LoopKeywords]) -> Array:
    """Return the spectral radius per host period of a wall with laws on host and device; stable below 1.

    It is max abs(eig(E_n ... E_1))^(1/q), with E_j the maps of all events in q host periods T = p device periods h. The
    nearest p/q to T/h with q up to 4 is taken; if h changes by it, at most by 2 %, there is a warning. Both clocks
    start together.

    Args:
        stiffness: Stiffness on the host [N/m], (...,).
        damping: Damping on the host [N s/m], (...,).
        device: Law on the device.
        loop: Keywords of `SampledLoop`; period and delay are the host's, and numbers.

    Raises:
        ParameterError: If a value is outside its bounds, or T/h is near no such fraction.

    Source: derived for this project; lifted multirate loops: Rakhsha & Constantinescu 2012 (abstract).
    """
    around = SampledLoop(**loop)
    return _radius_of(around, device)(*around.broadcast(stiffness, damping))


def two_rate_stiffness(damping: ArrayLike, device: DeviceLaw, **loop: Unpack[LoopKeywords]) -> Array:
    """Return the critical stiffness on the host beside a law on the device: all softer walls are stable [N/m].

    Searched on a grid of 240 stiffnesses, 8e-5 to 64 m/T², then by bisection; see `two_rate_radius`.

    Args:
        damping: Damping on the host [N s/m], (...,).
        device: Law on the device.
        loop: Keywords of `SampledLoop`; period and delay are numbers.

    Returns:
        The stiffness (...,): 0 if the softest of the grid is unstable, infinity if none is.

    Raises:
        ParameterError: See `two_rate_radius`.

    Source: derived for this project.
    """
    around = SampledLoop(**loop)
    radius = _radius_of(around.widened(), device)
    grid, b = (part[..., None] for part in around.broadcast(scales(around)[0], damping))
    grid = grid * _GRID
    low, high = bracket(grid, ~is_stable(radius(grid, b)))
    critical = bisect(lambda middle: ~is_stable(radius(middle[..., None], b)[..., 0]), low, high, _HALVINGS)
    return np.where(high > grid[..., 0], critical, 0.0)


def _radius_of(loop: SampledLoop, device: DeviceLaw) -> Callable[[Array, Array], Array]:
    """Return the spectral radius per host period as a function of the host's gains.

    State: the flotor's, then of host and device each command in effect, last commands, newest first, and controller's.
    """
    if np.ndim(loop.period) or np.ndim(loop.delay):
        shapes = f"{np.shape(loop.period)} and {np.shape(loop.delay)}"
        raise ParameterError(f"period and delay must be numbers beside a device law (got shapes {shapes})")
    period = float(np.asarray(loop.period))
    ratio = max(Fraction(period / device.period).limit_denominator(_DENOMINATOR), Fraction(1, _DENOMINATOR))
    own = period / float(ratio)
    if abs(own / device.period - 1.0) > _TOLERANCE:
        allowed = f"within 2 % of the host's {period:g} s times q/p, q up to {_DENOMINATOR}, such as {own:g} s"
        raise ParameterError(f"device period must be {allowed} (got {device.period:g})")
    if abs(own / device.period - 1.0) > 1e-9:
        text = f"device period {device.period:g} s replaced by {own:g} s: {ratio} of it in a host period"
        warnings.warn(text, stacklevel=5)
    (a, b), zero = loop.motion(), np.zeros(())
    laws = loop.law(zero, zero), pd(device.velocity)(*map(np.asarray, (device.stiffness, device.damping, own)))
    steps = np.array([period, own])
    whole, rest = split_delay(np.array([loop.delay, device.delay]), steps)
    waiting = whole.astype(int) + 1
    order, sizes = a.shape[-1], [1 + count + law.advance.shape[-1] for count, law in zip(waiting, laws)]
    starts, size = [order, order + sizes[0]], order + sum(sizes)
    events: list[tuple[float, Array | None]] = []
    for index, count in enumerate((ratio.denominator, ratio.numerator)):
        effect = np.eye(size)
        effect[starts[index]] = np.eye(size)[starts[index] + waiting[index]]
        sample = _sample(laws[1], starts[1], waiting[1], size) if index else None
        for time in steps[index] * np.arange(count):
            events += [(time, sample), (time + rest[index], effect)]
    events.sort(key=itemgetter(0))  # stable: without delay a sample comes before its effect
    slope = np.zeros((*a.shape[:-2], size, size))
    slope[..., :order, :order], slope[..., :order, starts] = a, b[..., :1]
    durations = np.diff([time for time, _ in events], append=period * ratio.denominator)
    between: list[Array] = []  # maps from just after a host sample to the next one
    for (_, event), flow in zip(events, exponential(slope * durations.reshape(-1, *[1] * slope.ndim))):
        between[len(between) - (event is not None) :] = [flow if event is None else flow @ event @ between[-1]]

    def radius(stiffness: Array, damping: Array) -> Array:
        sample, total = _sample(loop.law(stiffness, damping), starts[0], waiting[0], size), np.eye(size)
        for part in between:
            total = part @ sample @ total
        return np.asarray(np.abs(np.linalg.eigvals(total)).max(axis=-1) ** (1.0 / len(between)))

    return radius


def _sample(law: LinearController, start: int, waiting: int, size: int) -> Array:
    """Return the map of a sample by a law whose states begin at an index."""
    newest, states = start + 1, slice(start + 1 + waiting, start + 1 + waiting + law.advance.shape[-1])
    older, kept = np.arange(newest + 1, states.start), np.r_[: start + 1, states.stop : size]
    result = np.zeros((*law.direct.shape, size, size))
    result[..., older, older - 1] = result[..., kept, kept] = 1.0
    result[..., newest, 0], result[..., newest, states] = law.direct, law.give
    result[..., states, 0], result[..., states, states] = law.take, law.advance
    return result
