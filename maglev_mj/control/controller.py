"""Sampled controller, and the check of a user-defined law.

A tick: velocity estimate, laws, sum, command. Independent of engine, sockets and clock.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from copy import copy
from functools import partial
from math import isfinite
from typing import Any, TypeAlias, overload

import numpy as np

from maglev_mj.control.laws.base import Face, Law, VelocityEstimator, answer, as_law, shape_of
from maglev_mj.control.laws.velocity import FiniteDifference
from maglev_mj.errors import MaglevError, ParameterError, check_instance
from maglev_mj.frames import (
    AXES,
    ZERO,
    Array,
    Command,
    Component,
    DeviceWall,
    Sample,
    Six,
    components,
    is_finite,
    not_finite,
)
from maglev_mj.keywords import checked, every_tick, mismatch, with_period
from maglev_mj.parameters import SAMPLE_PERIOD, number

_Laws: TypeAlias = Iterable[Law | Callable[..., Any]]
_Calls: TypeAlias = tuple[tuple[int, Callable[..., Any]], ...]


@checked(own="laws")
class Controller:
    """Evaluate a sum of laws once per sample, for one device or a batch of any shape.

    Args:
        laws: Laws whose wrenches are summed: `Law` objects, or functions f(position, velocity) that return six wrench
            components. Laws with pulses must share one pulse width, because a command has only one.
        period: Sample period [s]; or `rate`, its reciprocal [Hz].
        velocity: Velocity estimator; the paper's finite difference by default.

    Attributes:
        laws: The laws, in order.
        velocity: The velocity estimator.
        on_device: True if a law is rendered on the device, which a plant must be able to do.

    Raises:
        ParameterError: If the period is not above 0, `laws` is not a list of laws, or their pulse widths differ.

    Example:
        >>> from maglev_mj import Controller, Hold, Sample
        >>> controller = Controller([Hold(axes="z", stiffness=6000.0, damping=80.0)], period=0.005)
        >>> controller.step(Sample(0, 0.0, [0, 0, 0.001, 0, 0, 0])).force[2]
        -6.0
        >>> controller.step(Sample(1, 0.005, [0, 0, 0.002, 0, 0, 0])).force[2]  # it moves at 0.2 m/s
        -28.0
    """

    @overload
    def __init__(self, laws: _Laws, *, period: float, velocity: VelocityEstimator | None = None) -> None: ...
    @overload
    def __init__(self, laws: _Laws, *, rate: float, velocity: VelocityEstimator | None = None) -> None: ...
    def __init__(
        self,
        laws: _Laws,
        *,
        period: float | None = None,
        velocity: VelocityEstimator | None = None,
        rate: float | None = None,
    ) -> None:
        check_instance("laws", laws, Iterable, "a list of laws")
        self.laws = tuple(map(as_law, laws))
        stated = with_period(("period",), {"period": period, "rate": rate})
        self.period = number("period", stated["period"], **SAMPLE_PERIOD)
        widths = {law.pulse_width for law in self.laws if law.pulse_width > 0.0}
        if len(widths) > 1:
            raise ParameterError(f"laws must share one pulse_width (got {sorted(widths)})")
        self._pulse_width = widths.pop() if widths else 0.0
        self.velocity = velocity or FiniteDifference()
        check_instance("velocity", self.velocity, Callable, "a velocity estimator, such as LowPass()")
        self._estimate = self.velocity.__call__
        self._calls: _Calls = tuple(enumerate(law.__call__ for law in self.laws))
        self._first_calls: _Calls = tuple(enumerate(partial(answer, law) for law in self.laws))
        self._walled = [(index, law.device_walls) for index, law in enumerate(self.laws) if law.on == "device"]
        self.on_device = bool(self._walled)
        self.reset()

    def reset(self) -> None:
        """Reset all states to those before the first sample."""
        self._states: list[Any] = [law.start() for law in self.laws]
        self._velocity_state: Any = None
        self._tick: int | None = None
        self._position: Six = ZERO

    @property
    def started(self) -> bool:
        """True after the first sample."""
        return self._tick is not None

    @property
    def states(self) -> tuple[Any, ...]:
        """State of each law after the last sample, in the order of `laws`."""
        return tuple(self._states)

    @property
    def faces(self) -> tuple[Face, ...]:
        """Wall planes of all laws: index into AXES, normal, edge."""
        return tuple(face for law in self.laws for face in law.faces())

    @property
    def device_walls(self) -> Sequence[DeviceWall]:
        """Walls on the device after the last sample."""
        parts = [walls(self._states[index]) for index, walls in self._walled]
        return parts[0] if len(parts) == 1 else [wall for walls in parts for wall in walls]

    @property
    def carried(self) -> Array:
        """Weight compensation [N, N m], (..., 6): constant, and not part of the rendered environment."""
        return sum((law.carried() for law in self.laws), np.zeros(len(AXES)))

    @property
    def stick_positions(self) -> Array | None:
        """Stick positions [m, rad], (6,): NaN for a sliding axis; None without friction."""
        stuck: dict[int, float] = {}
        for law, state in zip(self.laws, self._states):
            stuck |= law.stick_positions(state)
        return np.array([stuck.get(index, np.nan) for index in range(len(AXES))]) if stuck else None

    @property
    def signals(self) -> dict[str, Sequence[Component]]:
        """State quantities of all laws by name, one value per axis of the law; see `Law.signals`."""
        each = (law.signals(state) for law, state in zip(self.laws, self._states))
        return {name: value for signals in each for name, value in signals.items()}

    @every_tick
    def step(self, sample: Sample) -> Command:
        """Return the command for one sample.

        Raises:
            ParameterError: If the sample is not finite, if the first sample after a reset does not match the batch
                shape of the laws, if a law returns an invalid result for it, or if the tick of a later sample does not
                increase, as in a new run without `reset()`.
        """
        last, calls = self._tick, self._calls
        if last is None:
            check_instance("sample", sample, Sample, "a Sample")
            self._check(sample.position)
            last, calls = sample.tick - 1, self._first_calls
        try:
            position, tick = sample.position, sample.tick
            total, periods = sum(position, sample.time), tick - last  # finite only if all terms are, short of overflow
        except (AttributeError, TypeError):
            message = mismatch(Controller.step, (self, sample), {}, arrays=True) or "sample must be a Sample"
            raise ParameterError(message) from None
        if not (isfinite(total) if total.__class__ is float else is_finite(total)):
            if message := not_finite(f"sample at tick {tick}", (*position, sample.time)):
                raise ParameterError(message)
        if periods < 1:
            raise ParameterError(
                f"sample tick must be above the previous tick {last} (got {tick}); call reset() before a new run"
            )
        velocity, self._velocity_state = self._estimate(position, self._velocity_state, periods * self.period)
        if periods > 1:
            self._skip(position, velocity, periods)
        self._tick, self._position = tick, position
        wrench: list[Component] = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        pulse: Six | None = None
        states = self._states
        for index, law in calls:
            states[index], extra = law(position, velocity, states[index], wrench)
            if extra is not None:
                pulse = extra if pulse is None else [first + second for first, second in zip(pulse, extra)]
        if self._walled:
            return Command(wrench, pulse, self._pulse_width if pulse else 0.0, self.device_walls)
        return Command(wrench) if pulse is None else Command(wrench, pulse, self._pulse_width)

    def _skip(self, position: Six, velocity: Six, periods: int) -> None:
        """Advance the states over lost samples, at constant velocity; over at most 100, to bound the time of a tick."""
        for index in range(max(1, periods - 100), periods):
            between = [last + index / periods * (now - last) for last, now in zip(self._position, position)]
            pairs = zip(self.laws, self._states)
            self._states = [None if state is None else law.skip(between, velocity, state) for law, state in pairs]

    def at_rest(self, position: Six) -> Command:
        """Return the command for a flotor at rest, without a change of state.

        Raises:
            ParameterError: As for `step` at the first sample.
        """
        static = copy(self)
        static._states, static._tick = list(self._states), None if self._tick is None else -1
        static._estimate = lambda position, state, period: (ZERO, state)
        return static.step(Sample(0, 0.0, position))

    def _check(self, position: Six) -> None:
        try:
            count = len(position)
        except TypeError:  # a number, also as an array
            count = 1
        if count != len(AXES):
            raise ParameterError(f"a sample must have {len(AXES)} position components (got {count})")
        batch = shape_of(position)
        for law in self.laws:
            if law.batch and law.batch != batch:
                raise ParameterError(f"samples must have the batch shape {law.batch} of the laws (got {batch})")


_DEVICES, _SAMPLES, _PERIOD = 7, 60, 0.005
_REACH = np.array([4e-3] * 3 + [0.09] * 3)


@checked(own="law")
def check_law(law: Law | Callable[..., Any]) -> None:
    """Check a law along seeded random trajectories of seven devices over the range of motion.

    Args:
        law: A law, or a function f(position, velocity), for one device.

    Raises:
        ParameterError: If a result has the wrong shape or is not finite, the law modifies its input, a repeated call
            returns a different result, one device and a batch are not bit-identical, or the wrench is always zero.

    Example:
        >>> from maglev_mj import Hold
        >>> check_law(Hold(axes="z", stiffness=3000.0, damping=50.0))
    """
    checked = as_law(law)
    name = f"law {getattr(checked, 'name', type(checked).__name__)}"
    if checked.batch:
        raise ParameterError(f"{name} must have scalar gains to be checked, not batch shape {checked.batch}")
    random = np.random.default_rng(0)
    phase, rate = random.uniform(0.0, 6.3, (2, _DEVICES, 6))
    paths = [_REACH * np.sin(phase + 0.1 * rate * tick) for tick in range(_SAMPLES)]
    single = np.stack(
        [_wrenches(checked, name, [path[device] for path in paths]) for device in range(_DEVICES)], axis=1
    )
    try:
        batch = _wrenches(checked, name, paths)
    except MaglevError as error:
        raise ParameterError(f"{name} does not work on arrays of N devices: {error}") from None
    if not single.any():
        raise ParameterError(
            f"{name} has zero wrench at every sample: add to the `wrench` argument, as in wrench[0] = wrench[0] + ..."
        )
    if len(wrong := np.argwhere(single != batch)):
        tick, device, part = wrong[0]
        raise ParameterError(
            f"{name} must be bit-identical for one device and a batch: {(AXES * 2)[part]} at sample {tick} is "
            f"{float(single[tick, device, part])!r} for one device, {float(batch[tick, device, part])!r} in a batch"
        )


def _wrenches(law: Law, name: str, poses: Sequence[Array]) -> Array:
    """Return wrench and pulse at each sample, (M, ..., 12)."""
    estimate, state, estimator_state, rows = FiniteDifference(), law.start(), None, []
    for pose in poses:
        position = components(pose)
        velocity, estimator_state = estimate(position, estimator_state, _PERIOD)
        first, second = (_row(law, position, velocity, state, pose.shape) for _ in range(2))
        if not np.array_equal(first[1], second[1]):
            raise ParameterError(
                f"{name} is not a pure function: two calls with the same state and sample return different wrenches"
            )
        state = second[0]
        rows.append(second[1])
    return np.array(rows)


def _row(law: Law, position: Six, velocity: Six, state: Any, shape: tuple[int, ...]) -> tuple[Any, Array]:
    """Return the next state, and wrench and pulse, (..., 12)."""
    wrench: list[Component] = [0.0] * 6
    following, pulse = answer(law, list(position), list(velocity), state, wrench)
    row = np.empty((*shape[:-1], 12))
    for axis, part in enumerate((*wrench, *(pulse or (0.0,) * 6))):
        row[..., axis] = part
    return following, row
