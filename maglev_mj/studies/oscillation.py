"""Oscillation of a wall in a recording: its pole, and what the file states of its loop."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import fields
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.control import Controller, FiniteDifference, LowPass
from maglev_mj.device import Device, lag_of
from maglev_mj.errors import MaglevError, ParameterError, refuse_mask
from maglev_mj.frames import AXES, Array, Mask
from maglev_mj.parameters import SAMPLE_PERIOD, common_shape, number, numbers
from maglev_mj.plants.hand import Hand
from maglev_mj.recording import Recording
from maglev_mj.recording.setup import MEASURED, rebuild_controller, rebuild_plant
from maglev_mj.recording.table import read_log
from maglev_mj.theory import stated_gains
from maglev_mj.theory.loop_array import PdLaw
from maglev_mj.theory.two_rates import DeviceLaw, laws_on_device

_HALF_CYCLES, _LONGEST = 5, 100
_ORDER, _COLUMNS = 3, 24
_BAND = 0.02  # least reversal, as a share of the travel
_MISFIT = 0.03  # largest residual, as a share of the wave
_STEADY = 0.02  # least change of the amplitude in the window
_LOSS, _ERRORS = 0.01, 4.0  # least amplitude lost to friction in half a cycle: share of the mean, standard errors
_NAMED = 3  # gaps named in a message
_LAGS, _WHITE = 8, 0.5  # largest correlation of noise at the first lags
_NOISE = 3.0  # largest residual over the least of five half cycles, and growth over its standard error


class Oscillation(NamedTuple):
    """Oscillation with the pole z: duration of a cycle [s], frequency [Hz], growth of the amplitude [1/s], and more.

    The doubling time [s] is minus the halving time if it decays. The amplitude [m, rad] is the largest of the samples
    used, rate the sample rate [Hz], error the standard error of growth and angular frequency [1/s], damage that at
    which the recording ends.
    """

    pole: complex
    period: float
    frequency: float
    growth: float
    doubling_time: float
    samples: int
    amplitude: float
    rate: float
    error: float
    damage: str = ""


class LoggedMotion(NamedTuple):
    """Samples of the main axis of a recording, without a gap in time.

    Attributes:
        position: Positions [m, rad], (N,).
        period: Sample period [s].
        usable: True for samples in one contact state without saturation, (N,).
        command: Recorded forces of the commands [N, N m], (N,); None if the law gives them.
        before: Command in effect before the first one [N, N m]; NaN if unknown.
        edge: Edge of the wall that acts in usable samples alone [m, rad]; NaN for a law that acts everywhere.
        source: Name of the file.
    """

    position: Array
    period: float
    usable: Mask
    command: Array | None = None
    before: float = math.nan
    edge: float = math.nan
    source: str = "log"


class _Fit(NamedTuple):
    pole: complex
    amplitude: float
    residual: float
    misfit: float
    error: float
    noisy: bool


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
    refuse_mask("usable", usable)
    valid = np.ones(len(x), dtype=np.bool_) if usable is None else np.asarray(usable, dtype=np.bool_)
    common_shape("position and usable", x.shape, valid.shape)
    ends = np.flatnonzero(~valid[1:] | ~valid[:-1] | (np.abs(np.diff(times) - step) > 0.01 * step)) + 1
    runs = [(run, reversals(run)) for run in np.split(x, ends)]
    if (most := max(len(turns) for _, turns in runs) - 1) < _HALF_CYCLES:
        where = "" if usable is None else " in one contact state without saturation"
        gaps = _gaps(times, step)
        remedy = f"record without gaps: {gaps}" if gaps else "record a longer oscillation, or a larger one"
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
    if fit.misfit > _MISFIT and fit.noisy:
        floor, got = f"{fit.residual:.2g} m or rad", f"{fit.amplitude:.2g} in the longest window"
        raise ParameterError(f"position must be above the noise floor of {floor} (got {got}): record larger amplitudes")
    _check(fit, *window, step)
    growth, frequency = math.log(abs(fit.pole)) / step, float(np.angle(fit.pole)) / (2.0 * math.pi * step)
    doubling, samples = math.log(2.0) / growth, window[1][-1] - window[1][0] + 1
    return Oscillation(
        pole=fit.pole,
        period=1.0 / frequency,
        frequency=frequency,
        growth=growth,
        doubling_time=doubling,
        samples=samples,
        amplitude=fit.amplitude,
        rate=1.0 / step,
        error=fit.error / step,
    )


def _gaps(times: Array, step: float) -> str:
    """Return where samples are missing and how many, in words; empty without gaps."""
    missing = np.rint(np.diff(times) / step).astype(int) - 1
    gaps = [f"{missing[index]} missing after {times[index]:.4g} s" for index in np.flatnonzero(missing > 0)]
    more = f", {len(gaps) - _NAMED} more" if len(gaps) > _NAMED else ""
    return ", ".join(gaps[:_NAMED]) + more


def reversals(x: Array) -> list[int]:
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
    rest = x - mean - wave.real
    residual = math.sqrt(float(np.sum(rest**2)) / max(len(x) - 5, 1))
    slopes = np.column_stack([parts, index * wave.real, -index * wave.imag])  # by mean, amplitude and log of the pole
    error = residual * math.sqrt(max(float(np.linalg.pinv(slopes.T @ slopes)[3, 3]), 0.0))
    misfit = residual / max(float(np.std(wave.real)), 1e-300)
    return _Fit(pole, float(np.abs(wave).max()), residual, misfit, error, is_white(rest))


def is_white(rest: Array) -> bool:
    """Return True for a residual without correlation from sample to sample: noise, not another motion."""
    power = max(float(rest @ rest), 1e-300)
    largest = max(abs(float(rest[lag:] @ rest[:-lag])) for lag in range(1, min(_LAGS, len(rest) - 1) + 1)) / power
    return largest < max(_WHITE, 3.0 / math.sqrt(len(rest)))


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
        reason = f"a residual of {fit.misfit:.0%}: contact is lost in bounces, the force saturates, or two modes move"
        raise ParameterError(f"position must oscillate with one pole (got {reason}); record motion inside the wall")


def read_oscillation(path: str | Path) -> tuple[Oscillation, dict[str, Any], tuple[str, ...], LoggedMotion]:
    """Return the oscillation in a recording or table, on its main axis, and what the file states of its loop.

    Time and pose of a table are chosen by their names; without a unit, they are SI.

    Returns:
        The oscillation, values of `DiagnosedLoop` by name, what a table was taken for, in words, and the samples. An
        inertia of None is that of a rotary axis of unknown inertia.

    Raises:
        ParameterError: If the file cannot be read, or contains no oscillation.
    """
    if Path(path).suffix == ".maglev":
        recording = Recording.load(path)
        recording.require_samples(path)
        try:
            seen, stated, motion = _of_recording(recording)
        except ParameterError as error:
            raise ParameterError(f"{error}" + f"; {recording.damage}" * bool(recording.damage)) from None
        return seen._replace(damage=recording.damage), stated, (), motion._replace(source=Path(path).name)
    log = read_log(path, si=True)
    time, position = log.tick * log.period, log.parts["position"][:, log.axis]
    seen = find_oscillation(time, position, period=log.period)
    motion = LoggedMotion(position, log.period, np.ones(len(time), dtype=np.bool_), source=Path(path).name)
    motion = _longest(time, motion)
    return seen, {"inertia": None} if log.axis > 2 else {}, (f"{log.taken}; axis {AXES[log.axis]}",), motion


def _longest(time: Array, motion: LoggedMotion) -> LoggedMotion:
    """Return the part of a motion without gaps that has the longest usable run."""
    starts = np.flatnonzero(np.abs(np.diff(time, prepend=-np.inf) - motion.period) > 0.01 * motion.period)
    parts = [slice(first, last) for first, last in pairwise([*starts.tolist(), len(time)])]

    def most(part: slice) -> int:
        return max(len(run) for run in np.split(motion.usable[part], np.flatnonzero(~motion.usable[part])))

    best = max(parts, key=most)
    command = None if motion.command is None else motion.command[best]
    before = motion.before if best.start == 0 else math.nan
    cut: dict[str, Any] = {
        "position": motion.position[best],
        "usable": motion.usable[best],
        "command": command,
        "before": before,
    }
    return motion._replace(**cut)


def _of_recording(recording: Recording) -> tuple[Oscillation, dict[str, Any], LoggedMotion]:
    """Return the oscillation on the main axis in the longest segment, and its loop as far as it is stated.

    A sample is usable in a wall, if the axis has one, while neither a limit nor a pulse acts on it.
    """
    segment = max(recording.segments, key=len)
    metadata, setup = segment.metadata, segment.setup
    axis = AXES.index(metadata.axis)
    position = segment.position[:, axis]
    contacts = [normal * (position - edge) <= 0.0 for index, normal, edge in metadata.faces if index == axis]
    edges = [edge for index, _, edge in metadata.faces if index == axis]
    usable = np.logical_or.reduce(contacts) if contacts else np.ones(len(position), dtype=np.bool_)
    usable &= (segment.applied == segment.command)[:, axis] & (segment.applied_pulse[:, axis] == 0.0)
    seen = find_oscillation(segment.time, position, period=metadata.period, usable=usable)
    stated: dict[str, Any] = {"inertia" if axis > 2 else "mass": float(metadata.inertia[axis])}
    if axis > 2 and setup["kind"] == MEASURED and setup["parameters"].get("inertia_assumed"):
        stated["inertia"] = None
    if setup["kind"] != MEASURED:  # a table of another program states neither rate nor law
        stated |= {"period": metadata.period}
    if not (setup["kind"] == MEASURED and setup["parameters"].get("delay_assumed")):
        stated |= {"delay": metadata.delay}
    with suppress(MaglevError):  # user-defined plants are not rebuilt, user-defined laws not executed
        plant = rebuild_plant(setup)
        if plant is not None:
            stated["driver_lag"] = plant.driver_lag
        elif device := setup.get("parameters", {}).get("device"):  # of a flight
            stated["driver_lag"] = lag_of(Device.load(device))
        controller = rebuild_controller(setup)
        if plant is not None:
            stated |= _stated_hand(plant.given.get("hand"), axis, stated)
            stated |= _stated_device(laws_on_device(controller, plant.timing.device).get(axis))
        stated |= _stated_law(controller, axis)
    applied, known = segment.applied[:, axis], segment.time[0] < metadata.period and segment.before is None
    motion = LoggedMotion(position, metadata.period, usable, edge=edges[0] if len(edges) == 1 else math.nan)
    if applied.any():
        motion = motion._replace(command=applied, before=float(metadata.before[axis]) if known else math.nan)
    elif motion.edge == motion.edge and known and not usable[0]:  # of no contact yet
        motion = motion._replace(before=0.0)
    return seen, stated, _longest(segment.time, motion)


def _stated_hand(hand: Hand | None, axis: int, stated: Mapping[str, Any]) -> dict[str, Any]:
    """Return a simulated hand, and the mass beside it: that of a recording includes a rigid one."""
    if hand is None or axis not in hand.indices:
        return {}
    values = [float(value) for value in hand.values[: 5 if hand.soft else 3]]
    name = "inertia" if axis > 2 else "mass"
    return {"hand": ",".join(map(repr, values)), name: stated[name] - (0.0 if hand.soft else values[0])}


def _stated_device(law: DeviceLaw | None) -> dict[str, Any]:
    """Return a law on the device."""
    return {} if law is None else {f"device_{item.name}": getattr(law, item.name) for item in fields(law)}


def _stated_law(controller: Controller, axis: int) -> dict[str, Any]:
    """Return the host's laws of an axis in contact; nothing if they state no gains."""
    gains, velocity = stated_gains(controller), controller.velocity
    if gains is None:
        return {}
    stiffness, damping = (float(part[axis]) for part in [*gains.values()][-1])
    stated: dict[str, Any] = {"stiffness": stiffness, "damping": damping}
    if isinstance(velocity, LowPass):
        stated["cutoff"] = velocity.cutoff
    elif not isinstance(velocity, FiniteDifference) and stiffness > 0.0:
        stated["law"] = PdLaw(velocity)
    return stated
