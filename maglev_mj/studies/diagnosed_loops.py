"""One loop in numbers, and verdict and margins of many at once, as columns."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array, Mask
from maglev_mj.keywords import rate_of
from maglev_mj.parameters import numbers, param, transport_delay
from maglev_mj.result import Result, Table, number_text, plain, with_unit
from maglev_mj.spec import MAX_PERIOD, MIN_PERIOD
from maglev_mj.theory.boundary import boundary_of, highest_of, least_passive_damping
from maglev_mj.theory.loop import RELATIVE_ROUNDING, Bound, Loop, arrays_of, delay_bounds
from maglev_mj.theory.loop_array import LinearisedLaw, LoopArray, PdLaw, pd
from maglev_mj.theory.loop_parameters import LoopParameters
from maglev_mj.theory.remedies import hidden_amplitude

_SAMPLES, _MOST_ROWS = 4096, 8
_UNITS = {
    **{"spectral_radius": "", "frequency": "Hz", "doubling_time": "s", "critical_stiffness": "N/m"},
    **{"stiffness_searched": "", "ratio": "", "critical_delay": "s", "delay_searched": ""},
    **{"passive_damping": "N s/m", "amplitude_limit": "m", "hum": "m"},
}
"""Figures and their units on a translation."""


class DiagnosedLoop(LoopParameters):
    """One axis of a device that renders a wall, a spring or any stiffness with damping.

    Raises:
        ParameterError: If a value is outside its bounds, or mass and inertia are both given.
    """

    stiffness: float = param("stiffness K of wall or spring", "N/m", default=0.0, at_least=0.0, at_most=1e8)
    damping: float = param("damping B of the law", "N s/m", default=0.0, at_least=0.0, at_most=1e6)
    period: float = param("sample period T", "s", default=MAX_PERIOD, at_least=MIN_PERIOD, at_most=MAX_PERIOD)
    rate: float = rate_of("period")
    delay: float = LoopParameters.like("delay", default=0.0, derive=None)
    mass: float | None = LoopParameters.like("mass", derive=None, at_least=None, at_most=None, above=0.0)
    target: float = param("wanted ratio of critical to requested stiffness", default=2.0, above=1.0, at_most=100.0)
    law: LinearisedLaw | PdLaw | None = param(
        "law with memory on the axis, linearised at some gains; or PD with any linear estimator",
        default=None,
        optional=True,
        parse=lambda law: law,
    )

    def trial(self, **changes: Any) -> DiagnosedLoop:
        """Return a copy with changes that the user did not state: their bounds are not checked."""
        copy = object.__new__(type(self))
        vars(copy).update(vars(self) | changes)
        return copy

    def value(self, word: str) -> float:
        """Return one of these."""
        return float(getattr(self, self.whole.name(word)))

    @property
    def gains(self) -> tuple[float, float]:
        """Stiffness and damping of the law in question."""
        return self.value("stiffness"), self.value("damping")

    @property
    def sampled(self) -> LoopArray:
        """Loop without the gains of the law in question; the other law is its device law."""
        return self.loop_in_question.array()

    @property
    def loop_in_question(self) -> Loop:
        """Loop with gains, clock and filter of the law in question, and the other law beside it."""
        return self.whole.in_question

    @property
    def whole(self) -> Loop:
        """Loop with the laws on host and device where they are."""
        return self.loop(stiffness=self.stiffness, damping=self.damping, law=self.law)


@dataclass(frozen=True, eq=False)
class DiagnosedLoops(Result):
    """Verdict and margins of many loops, (...,) each: the broadcast shape of the values.

    A figure is that of the `Diagnosis` of one loop, and NaN where that has none, to a relative 1e-9: loops that are
    computed together share the scaling of a matrix exponential. It is computed when read. Ranges of damping and rate,
    remedies and hands are those of one loop alone.

    Attributes:
        loop: What the loops have in common, with the largest value of each array.
        values: The arrays as stated, (...,) each, by name.
        assumptions: What was assumed.
    """

    loop: DiagnosedLoop
    values: Mapping[str, Array]
    assumptions: tuple[str, ...]

    @property
    def shape(self) -> tuple[int, ...]:
        """Broadcast shape of the values."""
        return next(iter(self.values.values())).shape

    @cached_property
    def _wholes(self) -> list[Loop]:
        names = list(self.values)
        rows = zip(*(self.values[name].reshape(-1).tolist() for name in names), strict=True)
        return [self.loop.trial(**dict(zip(names, row))).whole for row in rows]

    @cached_property
    def _owns(self) -> list[Loop]:
        return [whole.in_question for whole in self._wholes]

    def _column(self, name: str) -> Array:
        """Return a value of each loop, also one that is a number."""
        return np.broadcast_to(self.values.get(name, getattr(self.loop, name)), self.shape).reshape(-1)

    def _of(self, figure: Callable[..., Any], loops: Sequence[Loop]) -> Array:
        """Return a figure of each loop, (...,) or (2, ...)."""
        parts = [(index, np.asarray(figure(*some))) for index, *some in arrays_of(loops)]
        result = np.empty((*parts[0][1].shape[:-1], len(loops)))
        for index, part in parts:
            result[..., index] = part
        return result.reshape(*result.shape[:-1], *self.shape)

    @cached_property
    def spectral_radius(self) -> Array:
        """Spectral radius per sample of the host."""
        # the delay of a host without gains does not matter
        asked = [one if one.stiffness or one.damping else replace(one, delay=0.0) for one in self._wholes]
        return self._of(LoopArray.spectral_radius, asked)

    @property
    def stable(self) -> Mask:
        """True if the loop settles."""
        return self.spectral_radius < 1.0 - RELATIVE_ROUNDING

    @cached_property
    def frequency(self) -> Array:
        """Frequency at which it rings [Hz]; 0 for a motion that does not oscillate."""
        return self._of(LoopArray.frequency, self._owns)

    @property
    def doubling_time(self) -> Array:
        """Time in which the motion doubles [s]; negative for the time in which it halves."""
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(2.0) * self._column("period").reshape(self.shape) / np.log(self.spectral_radius))

    @cached_property
    def _critical(self) -> tuple[Array, Mask]:
        def critical(around: LoopArray, _: Array, damping: Array) -> tuple[Array, Mask]:
            found = boundary_of(around, damping)
            return found, np.asarray(found >= highest_of(around) * (1.0 - RELATIVE_ROUNDING))

        stiffness, searched = self._of(critical, self._owns)
        return stiffness, np.asarray(searched > 0.0)

    @property
    def critical_stiffness(self) -> Array:
        """Stiffness of the law in question at which stability changes, at its damping [N/m, N m/rad]."""
        return self._critical[0]

    @property
    def stiffness_searched(self) -> Mask:
        """True where the critical stiffness is the end of the search: it is more than that."""
        return self._critical[1]

    @property
    def ratio(self) -> Array:
        """Ratio of critical to requested stiffness."""
        requested = np.array([own.stiffness for own in self._owns]).reshape(self.shape)
        return np.asarray(self.critical_stiffness / requested)

    @cached_property
    def _delays(self) -> tuple[Array, Mask]:
        def delays(*loops: Any) -> Array:
            return np.array([(bound, bound.beyond) for bound in delay_bounds(*loops)]).T

        delay, searched = self._of(delays, self._owns)
        return delay, np.asarray(searched > 0.0)

    @property
    def critical_delay(self) -> Array:
        """Delay at which stability changes [s]; 0 if unstable without delay."""
        return self._delays[0]

    @property
    def delay_searched(self) -> Mask:
        """True where the critical delay is the end of the search, as where any delay is stable."""
        return self._delays[1]

    @cached_property
    def passive_damping(self) -> Array:
        """Own damping that makes the law passive [N s/m, N m s/rad]; NaN at two rates, with a driver lag or a mode."""
        return self._of(passive_damping, self._owns)

    @cached_property
    def amplitude_limit(self) -> Array:
        """Amplitude below which friction ends the oscillation [m, rad]; NaN for none."""
        result, friction = np.full(self.stable.size, np.nan), self._column("friction")
        for index in np.flatnonzero(~self.stable.reshape(-1) & (friction > 0.0)).tolist():
            result[index] = hidden_amplitude(self._wholes[index], friction[index])
        return result.reshape(self.shape)

    @cached_property
    def hum(self) -> Array:
        """Largest steady error by the sensor's resolution while contact lasts [m, rad]; NaN if unknown."""
        quantum, good = self._column("quantum"), self.stable.reshape(-1)
        known = [index for index, own in enumerate(self._owns) if good[index] and quantum[index] and own.device is None]
        result = np.full(quantum.shape, np.nan)
        for index, around, *gains in arrays_of([self._owns[index] for index in known]):
            if not around.long:
                rows = np.array(known)[index]
                result[rows] = 0.5 * quantum[rows] * error_gain(around, *gains)
        return result.reshape(self.shape)

    def _headline(self) -> str:
        unstable, count = int((~self.stable).sum()), self.stable.size
        words = f"{unstable} of {count} loops unstable" if unstable else f"all {count} loops stable"
        worst = np.unravel_index(np.argmin(self.ratio), self.shape)
        least = Bound(float(self.critical_stiffness[worst]), bool(self.stiffness_searched[worst]))
        return (
            f"{words}; smallest margin: critical stiffness {'more than ' * least.beyond}{number_text(least)} "
            f"{self.loop.unit('N/m')}, {number_text(float(self.ratio[worst]), 3)} times the requested"
        )

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return the values, "stable" and all figures of N loops, (N,) each, in the order of the flattened arrays."""
        figures = {name: getattr(self, name) for name in ("stable", *_UNITS)}
        return {name: np.asarray(column).reshape(-1) for name, column in {**self.values, **figures}.items()}

    @property
    def units(self) -> Mapping[str, str]:
        """See `Result`."""
        stated = {name: self.loop.parameter(name).unit for name in self.values}
        return {name: self.loop.unit(unit) for name, unit in {**_UNITS, **stated}.items() if unit}

    def table(self) -> Table:
        """Return the first rows: values, verdict and critical stiffness."""
        units, names = (
            self.units,
            [*self.values, "stable", "spectral_radius", "frequency", "critical_stiffness", "ratio"],
        )
        own = self.values
        columns = {name: np.asarray(own[name] if name in own else getattr(self, name)).reshape(-1) for name in names}
        texts: dict[str, Sequence[Any]] = {name: column[:_MOST_ROWS].tolist() for name, column in columns.items()}
        texts["critical_stiffness"] = [
            Bound(*pair) for pair in zip(texts["critical_stiffness"], self.stiffness_searched.reshape(-1).tolist())
        ]
        texts["stable"] = ["stable" if good else "unstable" for good in texts["stable"]]
        hidden = self.stable.size - len(texts["stable"])
        notes = [f"{hidden} more rows"] * bool(hidden) + [f"assumed: {text}" for text in self.assumptions]
        head = ["verdict" if name == "stable" else with_unit(name, units.get(name)) for name in names]
        return Table("", head, list(zip(*texts.values(), strict=True)), "\n".join(notes))

    def as_json(self) -> dict[str, Any]:
        """Return the common loop, the values, and all figures in their shape, ready for JSON."""
        return {name: plain(getattr(self, name)) for name in ("loop", "values", "assumptions", "stable", *_UNITS)}


def checked_arrays(values: Mapping[str, Any]) -> dict[str, Array]:
    """Return the arrays among the values of a loop's parameters, checked, in one shape; none for numbers alone.

    Raises:
        ParameterError: If an entry is outside its bounds, or the shapes do not match.
    """
    found: dict[str, Array] = {}
    for parameter in DiagnosedLoop.parameters():
        value: Any = values.get(parameter.name)
        if parameter.kind is float and (isinstance(value, list | tuple) or np.ndim(value)):
            bounds: Any = {**parameter.bounds, "unit": parameter.unit}
            found[parameter.name] = numbers(parameter.name, value, **bounds)
    if found:
        try:
            shape = np.broadcast_shapes(*(array.shape for array in found.values()))
        except ValueError:
            shapes = ", ".join(f"{name} {array.shape}" for name, array in found.items())
            raise ParameterError(f"arrays must have shapes that broadcast (got {shapes})") from None
        if 0 in shape:
            raise ParameterError(f"arrays must not be empty (got shape {shape})")
        found = {name: np.broadcast_to(array, shape) for name, array in found.items()}
    return found


def loops_of(loop: DiagnosedLoop, values: dict[str, Array], *, delay_is_stated: bool) -> DiagnosedLoops:
    """Return the diagnosis of loops that differ in some values.

    Args:
        loop: The loop with the largest value of each array.
        values: The arrays, checked, in one shape.
        delay_is_stated: False for a delay of one period.

    Raises:
        ParameterError: If a loop has no stiffness, or values of it do not match.
    """
    loop.refuse({"target": "remedies are those of one loop"})
    if not delay_is_stated and "period" in values:
        values = values | {"delay": values["period"]}

    def value(name: str) -> Array:
        return np.asarray(values.get(name, getattr(loop, name)))

    transport_delay(value("device_delay"), value("device_period"), "device_delay", "on a device")
    if not np.maximum(value("stiffness"), value("device_stiffness")).all():
        raise ParameterError("stiffness must be above 0 (got 0)")
    return DiagnosedLoops(loop, values, () if delay_is_stated else ("a delay of one period",))


def passive_damping(around: LoopArray, stiffness: Any, damping: Any) -> Array:
    """Return the own damping that makes laws passive, (...,); NaN at two rates, with a driver lag or a mode."""
    if around.device is not None or around.mode is not None or np.any(around.driver_lag):
        return np.full(np.shape(stiffness), np.nan)
    times: Any = {"period": around.period, "delay": around.delay, "design": around.design or pd(around.velocity)}
    return least_passive_damping(stiffness, damping, **times)


def error_gain(around: LoopArray, stiffness: Any, damping: Any) -> Array:
    """Return the l1 norm from measurement error to position, (...,): it bounds the steady error per half a step."""
    matrix, phi = around.matrix(stiffness, damping), around.flotor[0]
    state = matrix[..., :, 0].copy()
    state[..., : phi.shape[-1]] -= phi[..., :, 0]
    total = np.zeros(state.shape[:-1])
    for _ in range(_SAMPLES):
        total += np.abs(state[..., 0])
        state = np.matmul(matrix, state[..., None])[..., 0]
    return total
