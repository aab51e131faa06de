"""Verdict and margins of many loops at once, as columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array, Mask
from maglev_mj.parameters import numbers
from maglev_mj.result import Result, Table, number_text, plain, with_unit
from maglev_mj.theory.boundary import boundary_of, highest_of, least_passive_damping
from maglev_mj.theory.loop import Bound, Loop, alike, delay_bounds
from maglev_mj.theory.loop_array import LoopArray, is_stable, pd
from maglev_mj.theory.remedies import hidden_amplitude

if TYPE_CHECKING:
    from maglev_mj.studies.diagnosis import DiagnosedLoop

_SAMPLES, _ROUNDING, _MOST_ROWS = 4096, 1e-9, 8
_UNITS = {
    **{"spectral_radius": "", "ratio": "", "frequency": "Hz", "doubling_time": "s", "critical_stiffness": "N/m"},
    **{"critical_delay": "s", "passive_damping": "N s/m", "amplitude_limit": "m", "hum": "m"},
}
"""Figures and their units on a translation; NaN where the diagnosis of one loop has NaN."""


@dataclass(frozen=True, eq=False)
class DiagnosedLoops(Result):
    """Verdict and margins of loops of arrays of values; each array has their broadcast shape (...,).

    A figure is that of the `Diagnosis` of one loop, to some 1e-9: loops computed together share the scaling of a matrix
    exponential. What only one loop has are its ranges of damping and rate, remedies and hands.

    Attributes:
        loop: What the loops have in common, with one of the values of each array.
        values: The arrays as stated, by name.
        assumptions: What was assumed.
        stable: True if the loop settles.
        spectral_radius: Spectral radius per sample of the host.
        frequency: Frequency of the dominant pole [Hz]; 0 for a motion that does not oscillate.
        doubling_time: Time in which the motion doubles [s]; negative for the time in which it halves.
        critical_stiffness: Stiffness of the law in question at which stability changes [N/m, N m/rad].
        stiffness_is_more: True where it is the end of the search: more than that.
        ratio: Ratio of critical to requested stiffness.
        critical_delay: Delay at which stability changes [s]; 0 if unstable without delay.
        delay_is_more: True where it is the end of the search, as where any delay is stable.
        passive_damping: Own damping that makes the law passive [N s/m, N m s/rad]; NaN at two rates, with a driver lag
            or a mode.
        amplitude_limit: Amplitude below which friction ends the oscillation [m, rad]; NaN for none.
        hum: Largest steady error by the sensor's resolution while contact lasts [m, rad]; NaN if unknown.
    """

    loop: DiagnosedLoop
    values: Mapping[str, Array]
    assumptions: tuple[str, ...]
    stable: Mask
    spectral_radius: Array
    frequency: Array
    doubling_time: Array
    critical_stiffness: Array
    stiffness_is_more: Mask
    ratio: Array
    critical_delay: Array
    delay_is_more: Mask
    passive_damping: Array
    amplitude_limit: Array
    hum: Array

    @property
    def shape(self) -> tuple[int, ...]:
        """Broadcast shape of the values."""
        return self.stable.shape

    def _headline(self) -> str:
        unstable, count = int((~self.stable).sum()), self.stable.size
        least = np.unravel_index(np.argmin(self.ratio), self.shape)
        critical = Bound(self.critical_stiffness[least], bool(self.stiffness_is_more[least]))
        words = "unstable" if unstable else f"all {count} loops stable"
        words = f"{unstable} of {count} loops unstable" if unstable else words
        return f"{words}; least critical stiffness {'more than ' * critical.beyond}{number_text(critical)} " + (
            f"{self.loop.unit('N/m')} ({number_text(self.ratio[least], 3)} times the requested)"
        )

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return the values that differ and all figures of N loops, (N,) each, in the order of the flattened arrays."""
        figures = {name: getattr(self, name) for name in ("stable", *_UNITS, "stiffness_is_more", "delay_is_more")}
        return {name: np.asarray(column).reshape(-1) for name, column in {**self.values, **figures}.items()}

    @property
    def units(self) -> Mapping[str, str]:
        """See `Result`."""
        stated = {name: self.loop.parameter(name).unit for name in self.values}
        return {name: self.loop.unit(unit) if unit else "" for name, unit in {**_UNITS, **stated}.items() if unit}

    def table(self) -> Table:
        """Return the first rows: values, verdict and margins."""
        columns, units = self.columns(), self.units
        names = [*self.values, "stable", "spectral_radius", "frequency", "critical_stiffness", "ratio", "critical_delay"]
        texts: dict[str, Sequence[Any]] = {name: columns[name][:_MOST_ROWS].tolist() for name in names}
        for name, more in (("critical_stiffness", "stiffness_is_more"), ("critical_delay", "delay_is_more")):
            texts[name] = list(map(Bound, texts[name], columns[more].tolist()))
        texts["stable"] = ["stable" if good else "unstable" for good in texts["stable"]]
        hidden = self.stable.size - len(texts["stable"])
        notes = [f"{hidden} more rows"] * bool(hidden) + [f"assumed: {text}" for text in self.assumptions]
        head = ["verdict" if name == "stable" else with_unit(name, units.get(name)) for name in names]
        return Table("", head, list(zip(*texts.values(), strict=True)), "\n".join(notes))

    def as_json(self) -> dict[str, Any]:
        """Return the common loop, the values, and all figures in their shape, ready for JSON."""
        names = "loop", "values", "assumptions", "stable", *_UNITS, "stiffness_is_more", "delay_is_more"
        return {name: plain(getattr(self, name)) for name in names}


def checked_arrays(kind: type[DiagnosedLoop], values: Mapping[str, Any]) -> dict[str, Array]:
    """Return the arrays among the values of a loop's parameters, checked, in one shape; none for numbers alone.

    Raises:
        ParameterError: If an entry is outside its bounds, or the shapes do not match.
    """
    found: dict[str, Array] = {}
    for parameter in kind.parameters():
        value = values.get(parameter.name)
        if parameter.kind is float and (isinstance(value, list | tuple) or np.ndim(value)):
            found[parameter.name] = numbers(parameter.name, value, **parameter.bounds, unit=parameter.unit)
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


def diagnosed_loops(loop: DiagnosedLoop, values: Mapping[str, Array], assumptions: Sequence[str]) -> DiagnosedLoops:
    """Return the diagnosis of loops that differ in some values, (...,) each.

    Args:
        loop: The loop with one of the values.
        values: Arrays of one shape, by name; their bounds are checked.
        assumptions: What was assumed, in words.

    Raises:
        ParameterError: If a loop has no stiffness, or values of a loop do not match.
    """
    flat = {name: array.reshape(-1).tolist() for name, array in values.items()}
    rows = [dict(zip(flat, row)) for row in zip(*flat.values(), strict=True)]
    each = [loop.trial(**row) for row in rows]
    wholes = [one.whole for one in each]
    owns = [one.in_question for one in wholes]
    shape, count = next(iter(values.values())).shape, len(rows)
    found = {name: np.full(count, np.nan) for name in _UNITS}
    more = {name: np.zeros(count, dtype=bool) for name in ("stiffness_is_more", "delay_is_more")}
    stiffness = np.array([own.stiffness for own in owns])
    if not stiffness.all():
        raise ParameterError("stiffness must be above 0 (got 0)")
    # the delay of a host without gains does not matter
    asked = [one if one.stiffness or one.damping else replace(one, delay=0.0) for one in wholes]
    for index, around, k, b in alike(asked):
        found["spectral_radius"][index] = around.spectral_radius(k, b)
    stable = found["spectral_radius"] < 1.0 - _ROUNDING
    periods = np.array([whole.period for whole in wholes])
    with np.errstate(divide="ignore"):
        found["doubling_time"] = np.log(2.0) * periods / np.log(found["spectral_radius"])
    friction, quantum = (np.array([getattr(one, name) for one in each]) for name in ("friction", "quantum"))
    for index, around, k, b in alike(owns):
        found["frequency"][index] = around.frequency(k, b)
        found["critical_stiffness"][index] = critical = boundary_of(around, b)
        more["stiffness_is_more"][index] = critical >= highest_of(around) * (1.0 - _ROUNDING)
        bounds = delay_bounds(around, k, b)
        found["critical_delay"][index] = bounds
        more["delay_is_more"][index] = [bound.beyond for bound in bounds]
        found["passive_damping"][index] = passive_damping(around, k, b)
        known = stable[index] & (quantum[index] > 0.0)
        if known.any() and around.device is None and not around.long:
            gain = error_gain(around.part(k.shape, known), k[known], b[known])
            found["hum"][index[known]] = 0.5 * quantum[index][known] * gain
    for index in np.flatnonzero(~stable & (friction > 0.0)).tolist():
        found["amplitude_limit"][index] = hidden_amplitude(wholes[index], friction[index])
    found["ratio"] = found["critical_stiffness"] / stiffness
    columns = {name: column.reshape(shape) for name, column in {**found, **more, "stable": stable}.items()}
    return DiagnosedLoops(loop=loop, values=dict(values), assumptions=tuple(assumptions), **columns)


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
