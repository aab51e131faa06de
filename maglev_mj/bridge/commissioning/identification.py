"""Identification of gravity, mass and wrench map from small motions.

Currents and motion of a free rigid body determine its acceleration per ampere, M⁻¹ W (6, 6), and free fall. Forces in
newtons need a known mass: the flotor, or a weight on it. Torques need the moments of inertia of the calibration.

The fitted model is exact for a sampled motion at any rate. Currents are piecewise constant, and the second difference
of three poses is the mean acceleration weighted by a triangle two periods wide:

    (x[k+1] - 2 x[k] + x[k-1]) / T² = A i[k] + K x[k] + a,

with i[k] and x[k] means under the same triangle. K is the device's own stiffness: forces are fixed in stator axes
and their points rotate with the flotor. Without K the torque rows of A are 1.5 % wrong. Second-order terms in the
angles are neglected.

The controller responds to pose noise, which biases least squares. Both sides are therefore projected on the windowed
excitation sines: noise-free instruments. Weights and errors assume white pose noise.

Source: instrumental variables as in Söderström & Stoica 1983; modulating functions as in Shinbrot 1957; from
recollection.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.control import AxisLaw, Bias, Hold, Law, gain
from maglev_mj.control.controller import Controller
from maglev_mj.control.laws.base import setting
from maglev_mj.control.loop import Answers, ControlLoop, Plant
from maglev_mj.control.timeline import Timing
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.frames import Array, Command, Component, Sample
from maglev_mj.parameters import number, numbers
from maglev_mj.plants.coils import CoilMap
from maglev_mj.spec import MAX_PERIOD, MIN_PERIOD

LINES = np.array([[4.5 + axis, 10.5 + axis] for axis in range(6)])
"""Excitation frequencies, two per axis [Hz], (6, 2).

Odd multiples of 0.5 Hz: products of two signals, such as angle and current, are even multiples.
"""

_TRIM, _ON_TIME, _SETTLED = 0.125, 0.1, 2.0
_SINGULAR = 1e-9


class IdentificationError(MaglevError):
    """The requested values are not identifiable from the motion."""


class RecordedMotion(NamedTuple):
    """Recorded motion of a device.

    Attributes:
        poses: Measured pose at each sample [m, rad], (N, 6); NaN for lost samples.
        currents: Applied answers to these samples [A], (N, 6); NaN for lost samples and for answers with unusual delay.
        delay: Median time from a sample to the effect of its answer [s]; NaN if not reported.
    """

    poses: Array
    currents: Array
    delay: float


class CurrentPlant(Plant, Protocol):
    """Plant that reports the applied currents."""

    @property
    def last_currents(self) -> Sequence[float]:
        """Currents held since the last answer, after limiting [A], six."""

    @property
    def last_delay(self) -> float:
        """Delay of the answer to the second last sample [s]; NaN if not available."""


class Shaker:
    """Controller with sines added to its wrench.

    force += sum of amplitude sin(2 pi frequency t), with t the time of the sample.

    Args:
        controller: Controller that keeps the flotor near the centre; without pulses.
        frequencies: Frequencies of each axis [Hz], (6, L).
        amplitudes: Amplitude at each frequency [N, N m], (6, L).

    Raises:
        ParameterError: If shapes are inconsistent, or a frequency is not below half the sample rate.
    """

    def __init__(self, controller: Answers, *, frequencies: ArrayLike, amplitudes: ArrayLike) -> None:
        self._controller, self.period = controller, controller.period
        lines = numbers("frequencies", frequencies, shape="(6, L)", at_least=0.0)
        sizes = numbers("amplitudes", amplitudes, shape=str(lines.shape))
        number("the highest frequency", float(lines.max(initial=0.0)), below=0.5 / self.period)
        self._sines = [(at[0], float(lines[at]), float(sizes[at])) for at in np.ndindex(lines.shape)]

    def step(self, sample: Sample) -> Command:
        """Answer one sample."""
        force = list(self._controller.step(sample).force)
        two_pi_t = 2.0 * math.pi * sample.tick * self.period
        for axis, frequency, size in self._sines:
            force[axis] += size * math.sin(frequency * two_pi_t)
        return Command(force)


class Trim(AxisLaw):
    """Integral action towards the centre, f' = -gain x.

    Args:
        gain: Integral gain of each axis [N/(m s), N m/(rad s)].
        period: Sample period [s].

    Raises:
        ParameterError: If a gain is negative, or the period is not above 0.
    """

    gain: ArrayLike = gain(unit="N/(m s), N m/(rad s)")
    period: float = setting(at_least=MIN_PERIOD, at_most=MAX_PERIOD, unit="s")

    def force(self, x: Component, v: Component, gains: Any, state: Component | None) -> tuple[Component, Component]:
        """Return force and next state of one axis, which are equal; see `AxisLaw`."""
        force = (0.0 if state is None else state) - gains.gain * self.period * x
        return force, force


def excitation(
    known: Calibration,
    *,
    period: float,
    delay: float,
    translation: float = 1e-4,
    rotation: float = 1.5e-3,
    lines: ArrayLike = LINES,
) -> Shaker:
    """Return a soft hover controller that excites all six axes.

    Args:
        known: Calibration, possibly inaccurate.
        period: Sample period [s].
        delay: Transport delay [s].
        translation: Amplitude at each frequency on x, y and z, for a correct calibration [m].
        rotation: Amplitude at each frequency on rx, ry and rz, for a correct calibration [rad].
        lines: Frequencies of each axis [Hz], (6, L).

    Raises:
        ParameterError: If a value is outside its bounds.
    """
    body = known.body.inertia
    hold = Hold.critically_damped(inertia=body, period=period, delay=delay)
    stiffness = np.asarray(hold.stiffness)
    rate = np.sqrt(stiffness / body)
    sizes = np.repeat([number("translation", translation, at_least=0.0), number("rotation", rotation, at_least=0.0)], 3)
    omega = 2.0 * math.pi * numbers("lines", lines, shape="(6, L)")
    # compliance of a critically damped hold: 1 / (body (rate² + omega²))
    forces = (body * sizes)[:, None] * (np.square(rate)[:, None] + np.square(omega))
    laws: list[Law] = [Bias(0.0 - known.body.load), hold, Trim(gain=_TRIM * stiffness * rate, period=period)]
    return Shaker(Controller(laws, period=period), frequencies=lines, amplitudes=forces)


def collect(
    plant: CurrentPlant,
    controller: Answers,
    duration: float,
    *,
    then: Callable[[], object] | None = None,
    watch: Callable[[], object] | None = None,
) -> RecordedMotion:
    """Run a controller on a plant and record poses and currents.

    Args:
        plant: Plant, hovering or just released; left open.
        controller: Controller, for example from `excitation`.
        duration: Recording time after two seconds of settling [s].
        then: Function called at the end, for example to land.
        watch: Function called before each sample; True ends the motion.

    Raises:
        IdentificationError: If the motion ended early.
        ParameterError: If the periods differ, or a duration is shorter than a sample.
        MaglevError: As `run`.
    """
    period = plant.period
    settling = round(_SETTLED / period)
    ticks = settling + max(round(number("duration", duration, above=0.0) / period), 1)
    rows: list[tuple[int, Sequence[float], Sequence[float]]] = []
    delays: dict[int, float] = {}

    def observe(sample: Sample, command: Command) -> None:
        delays[sample.tick - 1] = plant.last_delay
        rows.append((sample.tick, tuple(sample.position), tuple(plant.last_currents)))

    loop = ControlLoop(plant, controller, observe=observe)
    while len(rows) < ticks and not (watch is not None and watch()):
        loop.cycle()
    if len(rows) == ticks:
        loop.finish()
    if then is not None:
        then()
    if len(rows) < ticks:
        raise IdentificationError(f"stopped after {len(rows)} of {ticks} samples: nothing is written")
    indices = [tick - rows[settling][0] for tick, _, _ in rows[settling:]]
    reported = np.array([delays.get(tick, math.nan) for tick, _, _ in rows[settling:]])
    median = float(np.nanmedian(reported)) if np.isfinite(reported).any() else math.nan
    poses, currents = np.full((2, indices[-1] + 1, 6), np.nan)
    poses[indices], currents[indices] = ([row[part] for row in rows[settling:]] for part in (1, 2))
    if not math.isnan(median):
        currents[np.array(indices)[~(np.abs(reported - median) <= _ON_TIME * period)]] = np.nan
    return RecordedMotion(poses, currents, median)


@dataclass(frozen=True, kw_only=True, eq=False)
class Identified:
    """Identified dynamics of a device at the centre, upright; axes x y z rx ry rz.

    Attributes:
        acceleration_per_current: A [m/s² A, rad/s² A], (6, 6).
        stiffness: K, acceleration per displacement, (6, 6) [1/s² within a block].
        free_acceleration: a, without currents, (6,) [m/s², rad/s²]; the last three are 0 unless a cable pulls, or poses
            are not those of the centre of mass.
        errors: Standard errors of A, (6, 6).
        free_errors: Standard errors of a, (6,).
        noise: White pose noise equivalent to the residual at every sample, (6,) [m, rad].
        misfit: White pose noise equivalent to the residual at the excitation frequencies, (6,) [m, rad]. If much above
            `noise`, the delay is wrong or something touches the flotor.
    """

    acceleration_per_current: Array
    stiffness: Array
    free_acceleration: Array
    errors: Array
    free_errors: Array
    noise: Array
    misfit: Array

    @property
    def gravity(self) -> Array:
        """Acceleration of free fall in stator axes [m/s²], (3,)."""
        return self.free_acceleration[:3].copy()

    def wrench_per_current(self, mass: float, inertia: ArrayLike) -> Array:
        """Return the wrench map W = M A, (6, 6) [N/A, N m/A].

        Args:
            mass: Moving mass [kg].
            inertia: Moments of inertia about stator axes, (3,) [kg m²].
        """
        return np.concatenate([np.full(3, mass), numbers("inertia", inertia)])[:, None] * self.acceleration_per_current

    def calibration(self, nominal: Calibration, mass: float | None = None, *, name: str = "identified") -> Calibration:
        """Return a calibration with the identified gravity and coils.

        Directions are unchanged. A force constant is the force component along its coil; a point moves by the shortest
        distance that gives the identified torque.

        Args:
            nominal: Calibration with directions, inertia, beams, offsets and initial points.
            mass: Moving mass [kg] (default nominal).
            name: Name of the new calibration.

        Raises:
            ParameterError: If the mass is not above 0.
            ModelError: If these coils cannot give every wrench.
        """
        mass = nominal.mass if mass is None else number("mass", mass, above=0.0)
        wrenches, initial = self.wrench_per_current(mass, nominal.inertia).T, nominal.coils
        constants = np.einsum("ja,ja->j", wrenches[:, :3], initial.directions)
        forces = constants[:, None] * initial.directions
        residual = wrenches[:, 3:] - np.cross(initial.points, forces)
        points = initial.points + np.cross(forces, residual) / np.square(constants)[:, None]
        coils = CoilMap(points=points, directions=initial.directions, force_constants=constants)
        return replace(nominal, coils=coils, mass=mass, gravity=self.gravity, name=name)


def identify(
    poses: ArrayLike, currents: ArrayLike, *, period: float, delay: float, lines: ArrayLike = LINES
) -> Identified:
    """Fit acceleration per current, stiffness and free fall to a recorded motion.

    A delay error of 0.1 ms, such as a neglected driver lag, makes A 0.15 % wrong at the default frequencies.

    Args:
        poses: Measured pose at each sample, near the centre [m, rad], (N, 6); NaN for lost samples.
        currents: Answers to these samples [A], (N, 6); NaN if not available.
        period: Sample period [s].
        delay: Time from a sample until its currents are switched on [s]; may exceed the period.
        lines: Excitation frequencies [Hz], at least two per axis to separate stiffness from inertia.

    Raises:
        ParameterError: If shapes are inconsistent, or a number is outside its bounds.
        IdentificationError: If the motion is too short, or does not excite all axes independently.
    """
    x, i = np.asarray(poses, dtype=np.float64), np.asarray(currents, dtype=np.float64)
    for name, values in (("poses", x), ("currents", i)):
        if np.isinf(values).any():
            raise ParameterError(f"{name} must be finite, or NaN if not available (got infinity)")
    if x.ndim != 2 or x.shape[1:] != (6,) or i.shape != x.shape:
        raise ParameterError(f"poses and currents must both have shape (N, 6) (got {x.shape} and {i.shape})")
    frequencies = numbers("lines", lines, at_least=0.0).ravel()
    timing = Timing(period=period, delay=number("delay", delay))
    number("the highest line", float(frequencies.max(initial=0.0)), below=0.5 / timing.period)
    ahead, switched = timing.whole + 2, float(timing.rest) / period
    if (count := len(x) - ahead - 1) < 1:
        raise IdentificationError(f"the motion must be longer than {len(x)} samples")
    before, at, after = (x[ahead + step :][:count] for step in (-1, 0, 1))
    acceleration = (before - 2.0 * at + after) / period**2
    first, last = 0.5 * switched**2, 0.5 * (1.0 - switched) ** 2
    latest, middle, oldest = (i[2 - age :][:count] for age in (0, 1, 2))
    held = last * latest + (1.0 - first - last) * middle + first * oldest
    # mean of a smooth motion under the triangle, to fourth order (Numerov)
    mean = at + acceleration * (period**2 / 12.0)
    regressors = np.concatenate([held, mean, np.ones((count, 1))], axis=1)
    valid = np.isfinite(regressors).all(axis=1) & np.isfinite(acceleration).all(axis=1)
    instruments = _instruments(count, period, frequencies)
    regressors[~valid] = acceleration[~valid] = instruments[~valid] = 0.0
    return _fitted(regressors, acceleration, instruments, period)


def _instruments(count: int, period: float, lines: Array) -> Array:
    """Return a windowed constant, cosines and sines, (count, 1 + 2 lines)."""
    tick = np.arange(count)[:, None]
    phase, window = 2.0 * np.pi * period * tick * lines, np.square(np.sin(np.pi * (tick + 1.0) / (count + 1.0)))
    return np.asarray(window * np.concatenate([np.ones((count, 1)), np.cos(phase), np.sin(phase)], axis=1))


def _whitened(values: Array, instruments: Array, period: float) -> Array:
    """Return moments of values with instruments, whitened: white pose noise keeps its variance."""
    # pose noise enters the moments through the second difference of the instruments
    noise = np.diff(np.pad(instruments, ((2, 2), (0, 0))), n=2, axis=0) / period**2
    size = np.linalg.norm(noise, axis=0)
    if len(values) < 2 * len(size) or not size.all():
        raise IdentificationError(f"the motion must be longer than {len(values)} samples, with fewer gaps")
    try:
        root = np.linalg.cholesky((noise / size).T @ (noise / size))
    except np.linalg.LinAlgError:
        raise IdentificationError(f"{len(values)} samples are too few to separate the excitation frequencies") from None
    return np.linalg.solve(root, (instruments / size).T @ values)


def _fitted(regressors: Array, acceleration: Array, instruments: Array, period: float) -> Identified:
    """Fit accelerations (N, 6) to regressors (N, 13) by weighted least squares on moments with the instruments."""
    moments = _whitened(np.concatenate([regressors, acceleration], axis=1), instruments, period)
    matrix, target = moments[:, : regressors.shape[1]], moments[:, regressors.shape[1] :]
    scale = np.maximum(np.linalg.norm(matrix, axis=0), np.finfo(np.float64).tiny)  # amperes, metres and ones
    left, values, right = np.linalg.svd(matrix / scale, full_matrices=False)
    if len(values) < len(scale) or not values[-1] > _SINGULAR * values[0]:
        raise IdentificationError("the motion must excite all six axes, each at two frequencies or more")
    inverse = (right.T / values) @ left.T / scale[:, None]
    fit = inverse @ target
    spread = np.linalg.norm(target - matrix @ fit, axis=0) / np.sqrt(max(len(target) - len(fit), 1))
    errors = np.linalg.norm(inverse, axis=1)[:, None] * spread
    residual = np.linalg.norm(acceleration - regressors @ fit, axis=0) / np.sqrt(np.count_nonzero(regressors[:, -1]))
    return Identified(
        acceleration_per_current=fit[:6].T.copy(),
        stiffness=fit[6:12].T.copy(),
        free_acceleration=fit[12].copy(),
        errors=errors[:6].T.copy(),
        free_errors=errors[12].copy(),
        noise=residual * period**2 / np.sqrt(6.0),  # (1, -2, 1) amplifies white noise by sqrt(6)
        misfit=spread,
    )
