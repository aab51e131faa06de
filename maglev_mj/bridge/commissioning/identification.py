"""Identification of gravity, mass and wrench map from small motions.

Currents and motion of a free rigid body give its acceleration per ampere, M⁻¹ W (6, 6), and of free fall. Forces in
newtons need a known mass: the flotor, or a weight on it. Torques need a moment of inertia, the controller's own.

The relation fitted is exact for a sampled motion, so that no rate is too low for it. Currents are constant from switch
to switch, and the second difference of three poses is the mean of the acceleration under a triangle two periods wide:

    (x[k+1] - 2 x[k] + x[k-1]) / T² = A i[k] + K x[k] + a,

with i[k] and x[k] means under that same triangle. K is the device's own stiffness: forces stay in stator axes
and their points turn with the flotor. Without K the torques' rows of A are 1.5 % wrong. Second orders of angles are
left out.

The controller answers to noise of the poses, which biases least squares. So both sides are projected on the sines that
were shaken, under a smooth window: instruments without noise. Weights and errors are those of white noise on the poses.

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
from maglev_mj.control.loop import Answers, ControlLoop, Plant
from maglev_mj.control.timeline import split_delay
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.frames import AXES, Array, Command, Component, Sample
from maglev_mj.parameters import number, numbers
from maglev_mj.plants.coils import CoilMap

LINES = np.array([[4.5 + axis, 10.5 + axis] for axis in range(6)])
"""Excitation frequencies, two per axis [Hz], (6, 2).

Odd multiples of 0.5 Hz: products of two, as of angle and current, are even multiples.
"""

_TRIM, _ON_TIME, _SETTLED = 0.125, 0.1, 2.0
_SINGULAR, _ROUNDS = 1e-9, 4


class IdentificationError(MaglevError):
    """Motion from which the requested values cannot be identified."""


class Motion(NamedTuple):
    """Recorded motion of a device.

    Attributes:
        poses: Measured pose at each sample [m, rad], (N, 6); NaN for lost samples.
        currents: Answers to these, as applied [A], (N, 6); NaN for lost samples and for answers later or earlier than
            most.
        delay: Median time from a sample to the effect of its answer [s]; NaN if the plant does not report it.
    """

    poses: Array
    currents: Array
    delay: float


class CurrentPlant(Plant, Protocol):
    """Plant that reports the currents it sent."""

    @property
    def last_currents(self) -> Sequence[float]:
        """Currents held since the last answer, limited [A], six."""

    @property
    def last_delay(self) -> float:
        """Delay of the answer to the last sample but one.

        In [s]; NaN if not known.
        """


class Shaker:
    """Controller with sines added to its wrench.

    force += sum of amplitude sin(2 pi frequency t), with t the time of the sample.

    Args:
        controller: Controller that keeps the flotor near the centre; without pulses.
        frequencies: Frequencies of each axis [Hz], (6, L).
        amplitudes: Amplitude at each frequency [N, N m], (6, L).

    Raises:
        ParameterError: If shapes do not fit, or a frequency is not below half the sample rate.
    """

    def __init__(self, controller: Answers, *, frequencies: ArrayLike, amplitudes: ArrayLike) -> None:
        self._controller, self.period = controller, controller.period
        lines, sizes = numbers("frequencies", frequencies, at_least=0.0), numbers("amplitudes", amplitudes)
        if lines.ndim != 2 or len(lines) != len(AXES) or sizes.shape != lines.shape:
            raise ParameterError(f"frequencies and amplitudes must be (6, L), not {lines.shape} and {sizes.shape}")
        number("the highest frequency", float(lines.max(initial=0.0)), below=0.5 / self.period)
        self._sines = [(at[0], float(lines[at]), float(sizes[at])) for at in np.ndindex(lines.shape)]

    def step(self, sample: Sample) -> Command:
        """Answer one sample."""
        force = list(self._controller.step(sample).force)
        turned = 2.0 * math.pi * sample.tick * self.period
        for axis, frequency, size in self._sines:
            force[axis] += size * math.sin(frequency * turned)
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
    period: float

    def __post_init__(self) -> None:
        super().__post_init__()
        number("period", self.period, above=0.0)

    def force(self, x: Component, v: Component, gains: Any, state: Component | None) -> tuple[Component, Component]:
        """Return force and next state of one axis.

        The two are equal. See `AxisLaw`.
        """
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
        translation: Amplitude of each line on x, y and z, if the calibration is right [m].
        rotation: Amplitude of each line on rx, ry and rz, if the calibration is right [rad].
        lines: Frequencies of each axis [Hz], (6, L).

    Raises:
        ParameterError: If a value is outside its bounds.
    """
    body = np.concatenate([np.full(3, known.mass), known.inertia])
    hold = Hold.critically_damped(inertia=body, period=period, delay=delay)
    stiffness = np.asarray(hold.stiffness)
    rate = np.sqrt(stiffness / body)
    sizes = np.repeat([number("translation", translation, at_least=0.0), number("rotation", rotation, at_least=0.0)], 3)
    turns = 2.0 * math.pi * numbers("lines", lines)
    if turns.ndim != 2 or len(turns) != len(AXES):
        raise ParameterError(f"lines must be (6, L), not {turns.shape}")
    # a critically damped hold answers a sine by 1 / (body (rate² + turn²))
    forces = (body * sizes)[:, None] * (np.square(rate)[:, None] + np.square(turns))
    weight = np.concatenate([-known.mass * known.gravity, np.zeros(3)])
    laws: list[Law] = [Bias(weight), hold, Trim(gain=_TRIM * stiffness * rate, period=period)]
    return Shaker(Controller(laws, period=period), frequencies=lines, amplitudes=forces)


def collect(
    plant: CurrentPlant,
    controller: Answers,
    duration: float,
    *,
    then: Callable[[], object] | None = None,
    watch: Callable[[], object] | None = None,
) -> Motion:
    """Run a controller on a plant; return poses and currents.

    Args:
        plant: Plant that reports its currents, hovering or just released; left open.
        controller: As from `excitation`.
        duration: Recorded time, after two seconds to settle [s].
        then: Called at the end of the motion, such as to land.
        watch: Called before each sample; True ends the motion.

    Raises:
        IdentificationError: If the motion ended early.
        ParameterError: If the periods differ, or a duration is shorter than a sample.
        MaglevError: As `run`.
    """
    period = plant.period
    ahead = round(_SETTLED / period)
    ticks = ahead + max(round(number("duration", duration, above=0.0) / period), 1)
    seen: list[tuple[int, Sequence[float], Sequence[float]]] = []
    delays: dict[int, float] = {}

    def observe(sample: Sample, command: Command) -> None:
        delays[sample.tick - 1] = plant.last_delay
        seen.append((sample.tick, tuple(sample.position), tuple(plant.last_currents)))

    loop = ControlLoop(plant, controller, observe=observe)
    while len(seen) < ticks and not (watch is not None and watch()):
        loop.cycle()
    if len(seen) == ticks:
        loop.finish()
    if then is not None:
        then()
    if len(seen) < ticks:
        raise IdentificationError(f"stopped after {len(seen)} of {ticks} samples: nothing is written")
    rows = [tick - seen[ahead][0] for tick, _, _ in seen[ahead:]]
    known = np.array([delays.get(tick, math.nan) for tick, _, _ in seen[ahead:]])
    usual = float(np.nanmedian(known)) if np.isfinite(known).any() else math.nan
    poses, currents = np.full((2, rows[-1] + 1, 6), np.nan)
    poses[rows], currents[rows] = ([one[part] for one in seen[ahead:]] for part in (1, 2))
    if not math.isnan(usual):
        currents[np.array(rows)[~(np.abs(known - usual) <= _ON_TIME * period)]] = np.nan
    return Motion(poses, currents, usual)


@dataclass(frozen=True, kw_only=True, eq=False)
class Identified:
    """Identified dynamics of a device at the centre, upright.

    The six rows are x y z and rx ry rz.

    Attributes:
        acceleration_per_current: A [m/s² A, rad/s² A], (6, 6).
        stiffness: K, acceleration per displacement, (6, 6) [1/s² within a block].
        free_acceleration: a, without currents, (6,) [m/s², rad/s²]; the last three are 0 unless a cable pulls, or the
            pose is not that of the centre of mass.
        errors: Standard errors of A, (6, 6).
        free_errors: Standard errors of a, (6,).
        noise: White noise of the poses equivalent to the fit's residual at every sample, (6,) [m, rad].
        misfit: Noise equivalent to the residual on the lines alone, (6,) [m, rad]. If much above `noise`, the delay is
            wrong or something touches the flotor.
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
        """Return the wrench map W = M A.

        Shape (6, 6), units [N/A, N m/A].

        Args:
            mass: Moving mass [kg].
            inertia: Moments of inertia about stator axes, (3,) [kg m²].
        """
        return np.concatenate([np.full(3, mass), numbers("inertia", inertia)])[:, None] * self.acceleration_per_current

    def calibration(self, nominal: Calibration, mass: float | None = None, *, name: str = "identified") -> Calibration:
        """Return a calibration with the identified gravity and coils.

        Directions are kept. A force constant is the force's component along its coil; a point moves the shortest way to
        the position of right torque.

        Args:
            nominal: Calibration with directions, inertia, beams, offsets and initial points.
            mass: Moving mass [kg]; the nominal one by default.
            name: Name of the new calibration.

        Raises:
            ParameterError: If the mass is not above 0.
            ModelError: If such coils cannot give every wrench.
        """
        mass = nominal.mass if mass is None else number("mass", mass, above=0.0)
        wrenches, given = self.wrench_per_current(mass, nominal.inertia).T, nominal.coils
        constants = np.einsum("ja,ja->j", wrenches[:, :3], given.directions)
        forces = constants[:, None] * given.directions
        lacking = wrenches[:, 3:] - np.cross(given.points, forces)
        moved = given.points + np.cross(forces, lacking) / np.square(constants)[:, None]
        coils = CoilMap(points=moved, directions=given.directions, force_constants=constants)
        return replace(nominal, coils=coils, mass=mass, gravity=self.gravity, name=name)


def added_mass(without: Identified, carrying: Identified, added: float) -> float:
    """Identify the moving mass [kg] by an added weight.

    The map is the same in both: the translations' block of A₁ A₂⁻¹ = M₁⁻¹ M₂ is (1 + added/mass) times the identity,
    at any position of the weight.

    Args:
        without: Result without the weight.
        carrying: Result with the weight.
        added: Mass of the weight [kg].

    Raises:
        ParameterError: If the added mass is not above 0.
        IdentificationError: If the flotor did not accelerate less with the weight.
    """
    number("added", added, above=0.0)
    ratio = without.acceleration_per_current @ np.linalg.inv(carrying.acceleration_per_current)
    gained = float(np.trace(ratio[:3, :3])) / 3.0 - 1.0
    if not gained > 0.0:
        raise IdentificationError(f"the flotor must be heavier with the weight, not {1.0 + gained:.4g} times as heavy")
    return added / gained


def identify(
    poses: ArrayLike, currents: ArrayLike, *, period: float, delay: float, lines: ArrayLike = LINES
) -> Identified:
    """Fit acceleration per current, stiffness and free fall to motion.

    A delay wrong by 0.1 ms, or a driver's lag not added to it, makes A 0.15 % wrong with the lines by default.

    Args:
        poses: Measured pose at each sample, near the centre [m, rad], (N, 6); NaN for lost samples.
        currents: Answers to these samples [A], (N, 6); NaN if not known.
        period: Sample period [s].
        delay: Time from a sample to the switch to its currents [s]; may exceed the period.
        lines: Excitation frequencies [Hz]: at least two for each axis, to separate stiffness from inertia.

    Raises:
        ParameterError: If the shapes do not fit, or a number is outside its bounds.
        IdentificationError: If the motion is too short, or does not excite all axes independently.
    """
    places, given = np.asarray(poses, dtype=np.float64), np.asarray(currents, dtype=np.float64)
    for name, values in (("poses", places), ("currents", given)):
        if np.isinf(values).any():
            raise ParameterError(f"{name} must be finite, or NaN where they are not known, not infinite")
    if places.ndim != 2 or places.shape[1:] != (6,) or given.shape != places.shape:
        raise ParameterError(f"poses and currents must both be (N, 6), not {places.shape} and {given.shape}")
    shaken = numbers("lines", lines, at_least=0.0).ravel()
    number("the highest line", float(shaken.max(initial=0.0)), below=0.5 / number("period", period, above=0.0))
    wholes, rest = split_delay(number("delay", delay, at_least=0.0), period)
    ahead, switched = int(wholes) + 2, rest / period
    if (count := len(places) - ahead - 1) < 1:
        raise IdentificationError(f"the motion must be longer than {len(places)} samples")
    before, at, after = (places[ahead + step :][:count] for step in (-1, 0, 1))
    bent = (before - 2.0 * at + after) / period**2
    first, last = 0.5 * switched**2, 0.5 * (1.0 - switched) ** 2
    latest, middle, oldest = (given[2 - age :][:count] for age in (0, 1, 2))
    held = last * latest + (1.0 - first - last) * middle + first * oldest
    # the mean of a smooth motion under the triangle, to the fourth order (Numerov)
    place = at + bent * (period**2 / 12.0)
    known = np.concatenate([held, place, np.ones((count, 1))], axis=1)
    there = np.isfinite(known).all(axis=1) & np.isfinite(bent).all(axis=1)
    instruments = _instruments(count, period, shaken)
    known[~there] = bent[~there] = instruments[~there] = 0.0
    return _fitted(known, bent, instruments, period)


def find_delay(
    poses: ArrayLike, currents: ArrayLike, *, period: float, near: float, reach: float = 5e-4, lines: ArrayLike = LINES
) -> float:
    """Return the delay [s] of least misfit.

    Args:
        poses: This, `currents`, `period` and `lines` as for `identify`.
        currents: See `poses`.
        period: See `poses`.
        near: First guess [s].
        reach: Initial search range to either side [s].
        lines: See `poses`.

    Raises:
        ParameterError: As `identify`.
        IdentificationError: As `identify`, or if there is no best delay within reach.
    """
    best, step = number("near", near, at_least=0.0), number("reach", reach, above=0.0)

    for _ in range(_ROUNDS):
        best = max(best, step)
        fits = [identify(poses, currents, period=period, delay=best + off, lines=lines) for off in (-step, 0.0, step)]
        below, here, above = (float(np.square(one.misfit / fits[1].noise).sum()) for one in fits)
        bend = below - 2.0 * here + above
        move = 0.5 * step * (below - above) / bend if bend > 0.0 else math.inf
        if abs(move) > 2.0 * step:
            raise IdentificationError(f"no delay within {2.0 * step:g} s of {best:g} s explains the motion best")
        best, step = best + move, 0.3 * step
    return max(best, 0.0)


def _instruments(count: int, period: float, lines: Array) -> Array:
    """Return a windowed constant, cosines and sines.

    The shape is (count, 1 + 2 lines).
    """
    tick = np.arange(count)[:, None]
    phase, window = 2.0 * np.pi * period * tick * lines, np.square(np.sin(np.pi * (tick + 1.0) / (count + 1.0)))
    return np.asarray(window * np.concatenate([np.ones((count, 1)), np.cos(phase), np.sin(phase)], axis=1))


def _whitened(values: Array, instruments: Array, period: float) -> Array:
    """Return moments of values with instruments, whitened.

    White noise on the poses stays white and keeps its size.
    """
    # noise of the poses reaches the moments through the instruments' second difference
    noise = np.diff(np.pad(instruments, ((2, 2), (0, 0))), n=2, axis=0) / period**2
    size = np.linalg.norm(noise, axis=0)
    if len(values) < 2 * len(size) or not size.all():
        raise IdentificationError(f"the motion must be longer than {len(values)} samples, with fewer gaps")
    try:
        root = np.linalg.cholesky((noise / size).T @ (noise / size))
    except np.linalg.LinAlgError:
        raise IdentificationError(f"{len(values)} samples are too few to tell the lines apart") from None
    return np.linalg.solve(root, (instruments / size).T @ values)


def _fitted(known: Array, bent: Array, instruments: Array, period: float) -> Identified:
    """Fit accelerations (N, 6) by known values (N, 13).

    Weighted least squares on the moments with the instruments.
    """
    moments = _whitened(np.concatenate([known, bent], axis=1), instruments, period)
    told, seen = moments[:, : known.shape[1]], moments[:, known.shape[1] :]
    scale = np.maximum(np.linalg.norm(told, axis=0), np.finfo(np.float64).tiny)  # amperes, metres and ones
    left, values, right = np.linalg.svd(told / scale, full_matrices=False)
    if len(values) < len(scale) or not values[-1] > _SINGULAR * values[0]:
        raise IdentificationError("the motion must shake all six axes, each at two frequencies or more")
    inverse = (right.T / values) @ left.T / scale[:, None]
    found = inverse @ seen
    spread = np.linalg.norm(seen - told @ found, axis=0) / np.sqrt(max(len(seen) - len(found), 1))
    errors = np.linalg.norm(inverse, axis=1)[:, None] * spread
    rest = np.linalg.norm(bent - known @ found, axis=0) / np.sqrt(np.count_nonzero(known[:, -1]))
    return Identified(
        acceleration_per_current=found[:6].T.copy(),
        stiffness=found[6:12].T.copy(),
        free_acceleration=found[12].copy(),
        errors=errors[:6].T.copy(),
        free_errors=errors[12].copy(),
        noise=rest * period**2 / np.sqrt(6.0),  # (1, -2, 1) makes the noise the square root of 6 times as large
        misfit=spread,
    )
