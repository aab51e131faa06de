"""Small motions about the centre that tell what a device is: six axes shaken, and what was seen of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.bridge.calibration import Calibration
from maglev_mj.controller import Controller
from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Array, Command, Component, Sample
from maglev_mj.laws import AxisLaw, Bias, Hold, Law, gain
from maglev_mj.loop import Answers, drive
from maglev_mj.parameters import number, numbers
from maglev_mj.plants import Plant

__all__ = ["LINES", "CurrentPlant", "Motion", "Shaker", "Trim", "collect", "excitation"]

LINES = np.array([[4.5 + axis, 10.5 + axis] for axis in range(6)])
"""Two frequencies for each axis [Hz], (6, 2), all odd multiples of 0.5 Hz: what two of them make of a product, such as
that of an angle and a current, has even ones and passes for nothing else."""

_TRIM = 0.125
_ON_TIME = 0.1
_SETTLED = 2.0


class Motion(NamedTuple):
    """What was seen of a device.

    Attributes:
        poses: Measured at each sample [m, rad], (N, 6); NaN where a sample was lost.
        currents: The answers to these samples, as applied [A], (N, 6); NaN where a sample was lost, and where an answer
            took effect later or earlier than they mostly do.
        delay: From a sample to its answer's taking effect, in the median [s]; NaN where the plant does not say.
    """

    poses: Array
    currents: Array
    delay: float


class CurrentPlant(Plant, Protocol):
    """A plant that says which currents it sent."""

    @property
    def last_currents(self) -> Sequence[float]:
        """Currents held from the last answer on, after every limit [A], six."""

    @property
    def last_delay(self) -> float:
        """From the sample before the last to its answer's taking effect [s]; NaN where that is not known."""


class Shaker:
    """A controller, and sines on top of its wrench: force += sum of amplitude sin(2 pi frequency t).

    Their time is that of the samples and not the number of answers, so that they stay in step where samples are lost.

    Args:
        controller: Whatever keeps the flotor near the centre; without pulses.
        frequencies: Of each axis [Hz], (6, L).
        amplitudes: Of each [N, N m], (6, L).

    Raises:
        ParameterError: If shapes do not fit, or a frequency is not below half the sample rate.
    """

    def __init__(self, controller: Answers, *, frequencies: ArrayLike, amplitudes: ArrayLike) -> None:
        self._controller, self.period = controller, controller.period
        lines, sizes = numbers("frequencies", frequencies, at_least=0.0), numbers("amplitudes", amplitudes)
        if lines.ndim != 2 or len(lines) != len(AXES) or sizes.shape != lines.shape:
            raise ParameterError(f"frequencies and amplitudes must be (6, L), not {lines.shape} and {sizes.shape}")
        number("the highest frequency", float(lines.max(initial=0.0)), below=0.5 / self.period)
        self._sines = [
            (axis, float(lines[axis, one]), float(sizes[axis, one])) for axis, one in np.ndindex(lines.shape)
        ]

    def step(self, sample: Sample) -> Command:
        """Answer one sample."""
        force = list(self._controller.step(sample).force)
        turned = 2.0 * math.pi * sample.tick * self.period
        for axis, frequency, size in self._sines:
            force[axis] += size * math.sin(frequency * turned)
        return Command(force)


class Trim(AxisLaw):
    """Integral action: it brings the flotor to the centre, however wrong its weight is known, by f' = -gain x.

    Args:
        gain: Of each axis [N/(m s), N m/(rad s)].
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
        """Return the force on one axis, which is also the next state; see `AxisLaw`."""
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
    """Return a controller that hovers softly, trims itself to the centre, and shakes each axis at its own frequencies.

    Args:
        known: What is known of the device; may be wrong.
        period: Sample period [s].
        delay: Transport delay [s].
        translation: Amplitude of each line on x, y and z, on a device that is as known [m].
        rotation: The same on rx, ry and rz [rad].
        lines: Frequencies of each axis [Hz], (6, L).

    Raises:
        ParameterError: If a value is outside its bounds.
    """
    body = np.concatenate([np.full(3, known.mass), known.inertia])
    hold = Hold.critically_damped(inertia=body, period=period, delay=delay)
    rate = np.sqrt(np.asarray(hold.stiffness) / body)
    sizes = np.repeat([number("translation", translation, at_least=0.0), number("rotation", rotation, at_least=0.0)], 3)
    turns = 2.0 * math.pi * numbers("lines", lines)
    if turns.ndim != 2 or len(turns) != len(AXES):
        raise ParameterError(f"lines must be (6, L), not {turns.shape}")
    # what a critically damped hold leaves of a sine is 1 / (body (rate² + turn²))
    forces = (body * sizes)[:, None] * (np.square(rate)[:, None] + np.square(turns))
    weight = np.concatenate([-known.mass * known.gravity, np.zeros(3)])
    laws: list[Law] = [
        Bias(weight),
        hold,
        Trim(gain=_TRIM * np.asarray(hold.stiffness) * rate, period=period),
    ]
    return Shaker(Controller(laws, period=period), frequencies=lines, amplitudes=forces)


def collect(
    plant: CurrentPlant,
    controller: Answers,
    duration: float,
    *,
    settle: float = _SETTLED,
    then: Callable[[], object] | None = None,
) -> Motion:
    """Let a controller drive a plant, and return the poses and the currents.

    Args:
        plant: Any plant that says which currents it sent; hovering, or just released. It is left open.
        controller: As from `excitation`.
        duration: How long to look [s].
        settle: How long to drive it ahead of that [s]: until trimmed.
        then: Called as soon as the motion is over, such as to land: a device does not wait for what is reckoned next.

    Raises:
        ParameterError: If the periods differ, or a duration is shorter than a sample.
        MaglevError: As `run`.
    """
    period = plant.period
    ahead = round(number("settle", settle, at_least=0.0) / period)
    ticks = ahead + max(round(number("duration", duration, above=0.0) / period), 1)
    seen: list[tuple[int, Sequence[float], Sequence[float]]] = []
    delays: dict[int, float] = {}

    def observe(sample: Sample, command: Command) -> None:
        delays[sample.tick - 1] = plant.last_delay
        seen.append((sample.tick, tuple(sample.position), tuple(plant.last_currents)))

    drive(plant, controller, ticks, observe=observe)
    if then is not None:
        then()
    kept = seen[ahead:]
    first = kept[0][0]
    known = [delays.get(tick, math.nan) for tick, _, _ in kept]
    usual = float(np.nanmedian(known)) if np.isfinite(known).any() else math.nan
    poses, currents = (np.full((kept[-1][0] - first + 1, 6), np.nan) for _ in range(2))
    for (tick, pose, answer), delay in zip(kept, known, strict=True):
        poses[tick - first] = pose
        if math.isnan(usual) or abs(delay - usual) <= _ON_TIME * period:
            currents[tick - first] = answer
    return Motion(poses, currents, usual)
