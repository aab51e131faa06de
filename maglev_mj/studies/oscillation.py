"""Oscillation of a wall from measured positions: its pole, and the inertia and delay that explain it."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from maglev_mj.control import VelocityEstimator
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.frames import AXES, Array, Mask
from maglev_mj.parameters import SAMPLE_PERIOD, common_shape, number, numbers, read_file
from maglev_mj.plants.hand import transition
from maglev_mj.recording import Recording
from maglev_mj.recording.setup import rebuild_controller
from maglev_mj.recording.table import read_table, uniform_ticks
from maglev_mj.spec import MAX_DELAY_PERIODS
from maglev_mj.theory import stated_gains
from maglev_mj.theory.closed_loop import pd, rendered_stiffness

_HALF_CYCLES, _LONGEST = 5, 100
_ORDER, _COLUMNS = 3, 24
_BAND = 0.02  # least reversal, as a share of the travel
_MISFIT = 0.03  # largest residual, as a share of the wave
_STEADY = 0.02  # least change of the amplitude in the window
_LOSS, _ERRORS = 0.01, 4.0  # least amplitude lost to friction in half a cycle: share of the mean, standard errors
_AGREES = 0.05  # largest change of a stated value that is put down to noise
_NEWTON_STEPS, _SHIFT = 20, 1e-6
_LEAST_DAMPING = -1e-3  # own damping that is put down to noise, in mass over period
_NOISE = 3.0  # largest residual over the least of five half cycles, and growth over its standard error


class Oscillation(NamedTuple):
    """Oscillation with the pole z: duration of a cycle [s], frequency [Hz], growth of the amplitude [1/s], and more.

    The doubling time [s] is minus the halving time if it decays. The amplitude [m, rad] is the largest of the samples
    used.
    """

    pole: complex
    period: float
    frequency: float
    growth: float
    doubling_time: float
    samples: int
    amplitude: float


class Match(NamedTuple):
    """Mass [kg, kg m²], delay [s] and own damping [N s/m, N m s/rad] that explain a pole, and a sentence about them."""

    mass: float
    delay: float
    own_damping: float
    text: str


class RecordedMotion(NamedTuple):
    """Motion of one axis as recorded, (N,) each, and what the recording states; None for gains that it does not."""

    time: Array
    position: Array
    period: float
    usable: Mask
    axis: str
    mass: float
    delay: float
    stiffness: float | None
    damping: float | None
    velocity: VelocityEstimator | None


class _Fit(NamedTuple):
    pole: complex
    amplitude: float
    residual: float
    misfit: float
    error: float


def find_oscillation(
    time: ArrayLike, position: ArrayLike, *, period: float, usable: ArrayLike | None = None
) -> Oscillation:
    """Return the oscillation in the longest window that one pole and a mean describe to within the noise.

    Matrix pencil of order 3 (Hua & Sarkar 1990), whose third pole is the mean: with two and the mean of the window
    subtracted, the pole would be biased.

    Args:
        time: Times of the samples [s], (N,); a gap ends a window.
        position: Positions [m, rad], (N,).
        period: Sample period [s].
        usable: True for samples in one contact state without saturation, (N,); all by default.

    Raises:
        ParameterError: If there are less than five half cycles, the amplitude is constant, contact is lost, or friction
            dominates.
    """
    step = number("period", period, **SAMPLE_PERIOD)
    times, x = numbers("time", time, shape="(N,)"), numbers("position", position, shape=f"({np.size(time)},)")
    valid = np.ones(len(x), dtype=np.bool_) if usable is None else np.asarray(usable, dtype=np.bool_)
    common_shape("position and usable", x.shape, valid.shape)
    ends = np.flatnonzero(~valid[1:] | ~valid[:-1] | (np.abs(np.diff(times) - step) > 0.01 * step)) + 1
    runs = [(run, _reversals(run)) for run in np.split(x, ends)]
    if (most := max(len(turns) for _, turns in runs) - 1) < _HALF_CYCLES:
        where = "" if usable is None else " in one contact state without saturation"
        remedy = "record a longer oscillation, or a larger one"
        raise ParameterError(f"position must have at least 5 half cycles{where} (got {max(most, 0)}): {remedy}")
    noise = min(_fit(*window).residual for run in runs for window in _windows(*run, _HALF_CYCLES))
    limit = max(_NOISE * noise, 1e-9 * float(np.ptp(x)))
    count = min(most, _LONGEST)
    while True:
        windows = [window for run in runs for window in _windows(*run, count)]
        fit, window = min(((_fit(*window), window) for window in windows), key=lambda pair: pair[0].residual)
        if fit.residual <= limit or count == _HALF_CYCLES:
            break
        count = max(int(0.8 * count), _HALF_CYCLES)
    _check(fit, *window, step)
    growth, frequency = math.log(abs(fit.pole)) / step, float(np.angle(fit.pole)) / (2.0 * math.pi * step)
    doubling, samples = math.log(2.0) / growth, window[1][-1] - window[1][0] + 1
    return Oscillation(fit.pole, 1.0 / frequency, frequency, growth, doubling, samples, fit.amplitude)


def _reversals(x: Array) -> list[int]:
    """Return the indices of alternating extremes, without those of noise and the ends."""
    band, sign, best, turns = _BAND * float(np.ptp(x)) if len(x) else 0.0, 1.0, 0, []
    for index, value in enumerate(x.tolist()):
        if sign * (value - x[best]) > 0.0:
            best = index
        elif sign * (x[best] - value) > band:
            turns.append(best)
            best, sign = index, -sign
    return turns[1:] if turns[:1] == [0] else turns


def _windows(x: Array, turns: list[int], count: int) -> Iterator[tuple[Array, list[int]]]:
    """Yield windows of a number of half cycles: their run, and the indices of their extremes."""
    for first in range(0, len(turns) - count, max(count // 4, len(turns) // 32, 1)):
        yield x, turns[first : first + count + 1]


def _fit(run: Array, turns: list[int]) -> _Fit:
    """Fit a window; the pencil's columns are spaced to span a third of it, but less than a quarter cycle apart."""
    x = run[turns[0] : turns[-1] + 1]
    stride = int(max(min(len(x) // (3 * _COLUMNS), len(x) / (4 * len(turns))), 1))
    columns = min(len(x) // (3 * stride), _COLUMNS)
    rows = np.lib.stride_tricks.sliding_window_view(x, columns * stride + 1)[:, ::stride]
    space = np.linalg.eigh(rows.T @ rows)[1][:, -_ORDER:]
    poles = np.linalg.eigvals(np.linalg.lstsq(space[:-1], space[1:], rcond=None)[0]).astype(np.complex128)
    pole = complex(poles[poles.imag.argmax()] ** (1.0 / stride))
    index = np.arange(len(x)) - (len(x) if abs(pole) > 1.0 else 0)  # no power above 1
    turn = pole**index
    parts = np.column_stack([np.ones(len(x)), turn.real, -turn.imag])
    mean, real, imaginary = np.linalg.lstsq(parts, x, rcond=None)[0]
    wave = complex(real, imaginary) * turn
    residual = math.sqrt(float(np.sum((x - mean - wave.real) ** 2)) / max(len(x) - 5, 1))
    slopes = np.column_stack([parts, index * wave.real, -index * wave.imag])  # by mean, amplitude and log of the pole
    error = residual * math.sqrt(max(float(np.linalg.pinv(slopes.T @ slopes)[3, 3]), 0.0))
    return _Fit(pole, float(np.abs(wave).max()), residual, residual / max(float(np.std(wave.real)), 1e-300), error)


def _check(fit: _Fit, x: Array, turns: list[int], step: float) -> None:
    """Raise ParameterError with the reason if the motion of a window is not that of one pole.

    Friction: successive amplitudes obey A[n+1] = g A[n] - a, a = 2 f_c / (pi m w) (g - 1) / sigma.
    """
    turn, length = max(float(np.angle(fit.pole)), 1e-6), turns[-1] - turns[0]
    before, at, after = (x[np.array(turns) + shift] for shift in (-1, 0, 1))
    cosine = (2.0 * at - before - after) / (2.0 * (1.0 - math.cos(turn)))  # sinusoids through three samples each
    extremes = at - cosine + np.sign(cosine) * np.hypot(cosine, (after - before) / (2.0 * math.sin(turn)))
    sizes = 0.5 * np.abs(np.diff(extremes))
    rows = np.column_stack([sizes[:-1], -np.ones(len(sizes) - 1)])
    (ratio, loss), *_ = np.linalg.lstsq(rows, sizes[1:], rcond=None)
    scatter = float(np.sum((rows @ (ratio, loss) - sizes[1:]) ** 2)) / (len(sizes) - 3)
    error = math.sqrt(scatter * max(float(np.linalg.pinv(rows.T @ rows)[1, 1]), 0.0))
    if abs(math.log(abs(fit.pole))) * length < max(_NOISE * fit.error * length, _STEADY):
        reason = "a limit cycle of constant amplitude: saturation, bounces, friction or quantisation"
        raise ParameterError(f"position must grow or decay (got {reason}); record the start of the oscillation")
    if ratio > 0.0 and loss > max(_ERRORS * error, _LOSS * sizes.mean()):
        push = 0.5 * loss * (turn / step) ** 2 * (math.log(ratio) / (ratio - 1.0) if ratio != 1.0 else 1.0)
        reason = f"friction of about {push:.2g} N per kg of moving mass (N m per kg m²)"
        raise ParameterError(f"position must decay or grow exponentially (got {reason}): record larger amplitudes")
    if fit.misfit > _MISFIT:
        reason = f"a residual of {fit.misfit:.0%}: contact is lost in bounces, or the force saturates"
        raise ParameterError(f"position must oscillate with one pole (got {reason}); record motion inside the wall")


def matched(
    oscillation: Oscillation,
    stiffness: float,
    damping: float,
    period: float,
    *,
    mass: float | None = None,
    delay: float | None = None,
    velocity: VelocityEstimator | None = None,
) -> tuple[Match, ...]:
    """Return what explains a pole: mass and delay without own damping, then, with a known mass, delay and own damping.

    Args:
        oscillation: The oscillation.
        stiffness: Wall stiffness [N/m, N m/rad].
        damping: Wall damping [N s/m, N m s/rad].
        period: Sample period of the wall, and of the oscillation's samples [s].
        mass: Stated mass or moment of inertia [kg, kg m²]; None if unknown.
        delay: Stated delay from a sample to the effect of its command [s]; None if unknown.
        velocity: Linear velocity estimator of the wall; None for the finite difference.

    Returns:
        Matches, each pair the closest to the stated values first; empty if no mass above 0 explains the pole.

    Raises:
        ParameterError: If a value is outside its bounds.
    """
    step = number("period", period, **SAMPLE_PERIOD)
    gains = numbers("stiffness", stiffness, above=0.0), numbers("damping", damping, at_least=0.0)
    wall = complex(rendered_stiffness(pd(velocity)(*gains, np.asarray(step)), oscillation.pole))
    limits: Any = {"at_least": 0.0, "at_most": MAX_DELAY_PERIODS * step, "unit": "s"}
    stated_mass = math.nan if mass is None else number("mass", mass, above=0.0)
    stated_delay = math.nan if delay is None else number("delay", delay, **limits)
    pairs = _masses(oscillation.pole, wall, step)
    ranked = sorted((*_compared(*pair, stated_mass, stated_delay, step), *pair) for pair in pairs)
    matches = [Match(heavy, late, 0.0, text) for _, text, heavy, late in ranked]
    for late, own in () if mass is None else _own_dampings(oscillation.pole, wall, step, stated_mass):
        text = f"consistent with a delay of {late * 1e3:.3g} ms and own damping of {own:.3g} N s/m"
        matches.append(Match(stated_mass, late, own, f"{text} (assumed: {stated_mass:.4g} kg)"))
    return tuple(matches)


def _masses(z: complex, wall: complex, step: float) -> Iterator[tuple[float, float]]:
    """Yield the masses and delays of a free mass: Im m = 0 is quadratic in the fraction of a period."""
    for whole in range(MAX_DELAY_PERIODS):
        scale = -(step**2) * wall / (2.0 * z ** (whole + 1) * (z - 1.0) ** 2)
        parts = scale * np.array([(z - 1.0) ** 2, -2.0 * z * (z - 1.0), z * (z + 1.0)])
        for root in np.roots(parts.imag):
            fraction, least = max(float(root.real), 0.0), -1e-9 if whole else -0.02  # no delay, but for noise
            mass = float(np.polyval(parts.real, fraction))
            if abs(root.imag) < 1e-9 and least <= root.real < 1.0 - 1e-9 and mass > 0.0:
                yield mass, (whole + fraction) * step


def _own_dampings(z: complex, wall: complex, step: float, mass: float) -> Iterator[tuple[float, float]]:
    """Yield delays and own dampings of a known mass, by Newton's method from the middle of each period."""

    def gap(late: NDArray[Any], own: NDArray[Any]) -> NDArray[np.complex128]:
        """Return the characteristic function for delays in periods and own dampings in mass over period."""
        flow, push = np.zeros((*own.shape, 2, 2)), np.array([[0.0], [1.0 / mass]])
        flow[..., 0, 1], flow[..., 1, 1] = 1.0, -own / step
        phi, both = transition(flow, push, step)
        new = transition(flow, push, (1.0 - late % 1.0) * step)[1]
        moved = np.linalg.solve(z * np.eye(2) - phi, (both - new) / z + new)[..., 0, 0]
        return np.asarray(1.0 + wall * moved / z ** np.floor(late))

    late, own = np.arange(MAX_DELAY_PERIODS) + 0.5, np.zeros(MAX_DELAY_PERIODS)
    for _ in range(_NEWTON_STEPS):
        value = gap(late, own)
        by_late, by_own = (gap(late + _SHIFT, own) - value) / _SHIFT, (gap(late, own + _SHIFT) - value) / _SHIFT
        steps = np.array([-by_own.conj() * value, by_late.conj() * value]).imag
        with np.errstate(divide="ignore", invalid="ignore"):  # parallel slopes: no step
            steps = np.nan_to_num(steps / (by_own.conj() * by_late).imag)
        late, own = np.clip(late + steps[0], 0.0, MAX_DELAY_PERIODS), np.clip(own + steps[1], _LEAST_DAMPING, 10.0)
    found = np.array([late, own])[:, (np.abs(gap(late, own)) < 1e-9) & (own > _LEAST_DAMPING)]
    for index in np.unique(found.round(6), axis=1, return_index=True)[1]:
        late, own = found[:, index].tolist()
        yield late * step, own * mass / step


def _compared(mass: float, late: float, stated_mass: float, stated_delay: float, step: float) -> tuple[float, str]:
    """Return the largest relative change of a stated value, not NaN, and the sentence that names it."""
    heavier, later = abs(mass / stated_mass - 1.0), abs(late - stated_delay) / max(stated_delay, 0.5 * step)
    change = max((part for part in (heavier, later) if part == part), default=0.0)
    text = f"consistent with {mass:.4g} kg and a delay of {late * 1e3:.3g} ms (assumed: no own damping)"
    if change > _AGREES and change == later:
        text = f"delay {late * 1e3:.3g} ms explains it, {stated_delay * 1e3:.3g} ms was given; {text}"
    elif change > _AGREES:
        text = f"mass {mass:.3g} kg explains it, {stated_mass:.3g} kg was given; {text}"
    return change, text


def read_motion(path: str | Path) -> tuple[Array, Array, float]:
    """Read time [s] and position [m; mm if the head says so], (N,) each, and the sample period [s] from a table.

    Raises:
        ParameterError: If the file cannot be read, or the times are not uniform; see `read_table`, `uniform_ticks`.
    """
    return read_file("motion", path, _parsed)


def _parsed(text: str) -> tuple[Array, Array, float]:
    table = read_table(text)
    if len(table.names) != 2 or len(table.rows) < 2:
        got = f"{len(table.names)} columns, {len(table.rows)} rows"
        raise ParameterError(f"table must be time and position, at least 2 rows (got {got}); others: maglev-mj import")
    time, position = (numbers("time and position", table.values(name)) for name in table.names)
    if re.search("(?<![a-z])mm(?![a-z])", " ".join(table.names).lower()):
        position = position * 1e-3
    period, tick, _ = uniform_ticks(time - time[0], table.rows)
    return tick * period, position, number("period", period, **SAMPLE_PERIOD)


def recorded_motion(recording: Recording) -> RecordedMotion:
    """Return the motion of the main axis in the longest segment, with the gains inside the wall if its laws state them.

    A sample is usable in a wall, if the axis has one, while neither a limit nor a pulse acts on it.

    Raises:
        ParameterError: If there are no samples.
    """
    if not recording.segments:
        raise ParameterError("recording must have samples (got no segment)")
    segment = max(recording.segments, key=len)
    metadata = segment.metadata
    axis = AXES.index(metadata.axis)
    position = segment.position[:, axis]
    contacts = [normal * (position - edge) <= 0.0 for index, normal, edge in metadata.faces if index == axis]
    usable = np.logical_or.reduce(contacts) if contacts else np.ones(len(position), dtype=np.bool_)
    usable &= (segment.applied == segment.command)[:, axis] & (segment.applied_pulse[:, axis] == 0.0)
    try:
        controller = rebuild_controller(segment.setup)
        gains, velocity = stated_gains(controller), controller.velocity
    except MaglevError:  # user-defined laws are not executed
        gains, velocity = None, None
    stiffness, damping = (None, None) if gains is None else (float(part[axis]) for part in [*gains.values()][-1])
    states = metadata.axis, float(metadata.inertia[axis]), metadata.delay, stiffness, damping, velocity
    return RecordedMotion(segment.time, position, metadata.period, usable, *states)
