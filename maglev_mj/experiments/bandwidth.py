"""How fast the held flotor follows: the closed-loop position response of Table 1."""

from __future__ import annotations

import math

import numpy as np

from maglev_mj.controller import Controller
from maglev_mj.frames import AXES, Command, Sample
from maglev_mj.laws import Hold
from maglev_mj.loop import run
from maglev_mj.parameters import axis_indices
from maglev_mj.plants import MuJoCoPlant, Timing

__all__ = ["position_bandwidth"]


def position_bandwidth(
    axis: str, *, stiffness: float, damping: float, period: float, delay: float, step: float = 1e-4
) -> float:
    """Return the frequency [Hz] at which the response to the hold's target falls to -3 dB.

    Measured on the MuJoCo device without gravity: the target steps, the sampled positions are
    differenced, and their Fourier transform is the frequency response.

    Args:
        axis: Name from AXES.
        stiffness: Stiffness of the hold [N/m, N m/rad].
        damping: Damping of the hold [N s/m, N m s/rad].
        period: Sample period [s].
        delay: Transport delay [s].
        step: Size of the step [m, rad].

    Returns:
        The bandwidth; NaN if the response does not fall to -3 dB below half the sample rate.
    """
    (index,) = axis_indices(axis)
    positions: list[float] = []

    def observe(sample: Sample, _: Command) -> None:
        positions.append(sample.position[index])

    ticks = max(math.ceil(1.0 / period), 100)
    others = [name for name in AXES if name != axis]
    with MuJoCoPlant(Timing(period=period, delay=delay), gravity=0.0) as plant:
        inertia = np.delete([plant.device.mass] * 3 + plant.device.inertia.tolist(), index)
        laws = [
            Hold(axes=axis, stiffness=stiffness, damping=damping, target=step),
            Hold.critically_damped(others, inertia=inertia, period=period, delay=delay),
        ]
        run(plant, Controller(laws, period=period), ticks, observe=observe)
    response = np.abs(np.fft.rfft(np.diff(positions, append=positions[-1]), 8 * ticks)) / step
    frequencies = np.fft.rfftfreq(8 * ticks, period)
    below = np.flatnonzero(response < math.sqrt(0.5))
    return float(frequencies[below[0]]) if below.size else math.nan
