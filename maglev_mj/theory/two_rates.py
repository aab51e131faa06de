"""Law on the device beside the host's, at a second rate: the maps of all events in one loop.

Between events, a sample or the effect of a command, both forces are constant, so each event is a linear map.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from operator import itemgetter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from maglev_mj.control import FiniteDifference, LinearController, LowPass
from maglev_mj.control.controller import Controller
from maglev_mj.control.timeline import split_delay
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array
from maglev_mj.keywords import checked
from maglev_mj.parameters import SAMPLE_PERIOD, number, transport_delay
from maglev_mj.plants.hand import exponential
from maglev_mj.spec import DEVICE_DELAY, DEVICE_PERIOD

_LEAST_DENOMINATOR, _MOST_DENOMINATOR, _MOST_DEVICE_PERIODS = 4, 128, 512
"""Bounds of the denominator of a ratio of rates, which are host periods, and device periods in a hyperperiod.

Each event is a matrix product. More than 128 host periods are refused as a period of the device that is too long.
"""
_LARGEST_CHANGE_OF_PERIOD, _COMMENSURATE = 0.02, 1e-9
"""Relative change of the device's period by the nearest fraction: the largest one, and that of commensurate clocks."""
_PHASES_JUDGED, _RATIO_WITHOUT_PHASE = 10, 4.0
"""Phases between incommensurate clocks, and ratio of the rates from which on they do not matter.

At a ratio of 1 the phase adds 9e-4 to a spectral radius, at 5 it adds 2e-5 (tests/theory/test_two_rates.py).
"""


@checked
@dataclass(frozen=True)
class DeviceLaw:
    """PD law on the device, f = -K x - B v, for `LoopArray`.

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
    period: float = DEVICE_PERIOD
    delay: float = DEVICE_DELAY
    cutoff: float | None = None

    def __post_init__(self) -> None:
        number("device stiffness", self.stiffness, at_least=0.0)
        number("device damping", self.damping, at_least=0.0)
        number("device period", self.period, **SAMPLE_PERIOD)
        transport_delay(number("device delay", self.delay), self.period, where="on a device")
        if self.cutoff is not None:
            number("device cutoff", self.cutoff, above=0.0)

    @property
    def velocity(self) -> FiniteDifference | LowPass:
        """Velocity estimator."""
        return FiniteDifference() if self.cutoff is None else LowPass(self.cutoff)


def laws_on_device(controller: Controller, device: tuple[float, float]) -> dict[int, DeviceLaw]:
    """Return the laws of a controller's walls on the device by axis, in contact; the stiffer one of two on an axis.

    Args:
        controller: The controller.
        device: Sample period and delay on the device [s].
    """
    walls = sorted(controller.device_walls, key=lambda wall: (wall.stiffness, wall.damping))
    return {wall.axis: DeviceLaw(wall.stiffness, wall.damping, *device, wall.cutoff) for wall in walls}


class _Rates(NamedTuple):
    """Host and device periods in a hyperperiod, the device period used [s], and the phases between the clocks."""

    host: int
    device: int
    period: float
    phases: tuple[float, ...]


def rates_of(period: float, device: DeviceLaw) -> _Rates:
    """Return the rates of a host period T = p/q device periods h: the nearest fraction, p up to 512 and q up to 128.

    If h changes by it, the clocks are not commensurate. Below T/h = 4, where the phase between them matters, ten phases
    are judged then, in device periods; otherwise both clocks start together.

    Raises:
        ParameterError: If h would change by more than 2 %.
    """
    ratio = period / device.period
    nearest = Fraction(ratio).limit_denominator(
        min(max(int(_MOST_DEVICE_PERIODS / ratio), _LEAST_DENOMINATOR), _MOST_DENOMINATOR)
    )
    own = period / float(nearest) if nearest else 0.0
    if not (error := abs(own / device.period - 1.0)) <= _LARGEST_CHANGE_OF_PERIOD:
        raise ParameterError(
            f"device period must be at most {period * _MOST_DENOMINATOR:g} s, "
            f"{_MOST_DENOMINATOR} of the host's (got {device.period:g})"
        )
    count = _PHASES_JUDGED if error > _COMMENSURATE and ratio < _RATIO_WITHOUT_PHASE else 1
    return _Rates(nearest.denominator, nearest.numerator, own, tuple((np.arange(count) / count).tolist()))


class TwoRates:
    """Maps of all events of a host's and a device's law in one hyperperiod, which begins with a sample of the host.

    State: the flotor's; then of host and device each command in effect, last commands, newest first, and controller's;
    last another force on the flotor.

    Args:
        motion: See `plants.hand.motion`.
        states: Number of states of the host's controller.
        device: Law on the device.
        controller: The same, at the period of `rates`.
        period: Sample period of the host [s].
        delay: Delay of the host [s].
        rates: See `rates_of`.
        phase: Start of the device's clock after the host's, in device periods.

    Source: derived for this project; lifted multirate loops: Rakhsha & Constantinescu 2012 (abstract).
    """

    def __init__(
        self,
        motion: tuple[Array, Array],
        states: int,
        device: DeviceLaw,
        controller: LinearController,
        period: float,
        delay: float,
        rates: _Rates,
        phase: float,
    ) -> None:
        a, b = motion
        steps, order = np.array([period, rates.period]), a.shape[-1]
        whole, rest = split_delay(np.array([delay, device.delay]), steps)
        waiting = whole.astype(int) + 1
        sizes = 1 + waiting + np.array([states, controller.advance.shape[-1]])
        starts, size = np.array([order, order + sizes[0]]), order + int(sizes.sum()) + 1
        self._places = [(int(start), int(count), size) for start, count in zip(starts, waiting)]
        self._controller, self._states, total = controller, states, period * rates.host
        events: list[tuple[float, Array | None]] = []
        for index, count in enumerate(rates[:2]):
            effect = np.eye(size)
            effect[starts[index]] = np.eye(size)[starts[index] + waiting[index]]
            sample = _sample(controller, *self._places[1]) if index else None
            for time in steps[index] * (np.arange(count) + index * phase):
                events += [(time, sample), ((time + rest[index]) % total, effect)]
        events.sort(key=itemgetter(0))  # stable: without delay a sample comes before its effect
        slope = np.zeros((*a.shape[:-2], size, size))
        slope[..., :order, :order] = a
        slope[..., :order, [*starts, -1]] = b[..., [0, 0, 1]]
        self.durations = np.diff([time for time, _ in events], append=total)
        flows = exponential(slope * self.durations.reshape(-1, *[1] * slope.ndim))
        self._steps = [
            (event is None, flow if event is None else flow @ event) for (_, event), flow in zip(events, flows)
        ]

    def steps(self, law: LinearController) -> list[Array]:
        """Return the maps from each event to the next one, of `durations`, for a host's controller (...,)."""
        sample = _sample(law, *self._places[0])
        return [step @ sample if host else step for host, step in self._steps]

    def memories(self, law: LinearController) -> list[tuple[int, LinearController]]:
        """Return the index of the first state of each controller, the host's given, with the controller."""
        return [(start + 1 + waiting, one) for (start, waiting, _), one in zip(self._places, (law, self._controller))]

    @property
    def of_host(self) -> NDArray[np.int64]:
        """Indices of the host's states: command in effect, last commands, newest first, and those of its controller."""
        start, waiting, _ = self._places[0]
        return np.arange(start, start + 1 + waiting + self._states)

    def between(self) -> list[Array]:
        """Return the maps from just after each sample of the host to its next one: without its gains."""
        between: list[Array] = []
        for host, step in self._steps:
            between[len(between) - (not host) :] = [step if host else step @ between[-1]]
        return between

    def matrix(self, law: LinearController) -> Array:
        """Return the map over the hyperperiod for a host's controller (...,), (..., n, n)."""
        sample, total = _sample(law, *self._places[0]), np.eye(self._places[0][2])
        for part in self.between():
            total = part @ sample @ total
        return total


def _sample(law: LinearController, start: int, waiting: int, size: int) -> Array:
    """Return the map of a sample by a law whose states begin at an index."""
    newest, states = start + 1, slice(start + 1 + waiting, start + 1 + waiting + law.advance.shape[-1])
    older, kept = np.arange(newest + 1, states.start), np.r_[: start + 1, states.stop : size]
    result = np.zeros((*law.direct.shape, size, size))
    result[..., older, older - 1] = result[..., kept, kept] = 1.0
    result[..., newest, 0], result[..., newest, states] = law.direct, law.give
    result[..., states, 0], result[..., states, states] = law.take, law.advance
    return result
