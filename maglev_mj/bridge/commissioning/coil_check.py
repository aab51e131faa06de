"""Commissioning ahead of the first hover: coils, current loops, offsets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.frames import ZERO, Array
from maglev_mj.parameters import number

_PAUSE = 0.25  # [s] a current is on before its displacement is measured, and then again
_SEEN = 5.0  # standard errors from which a displacement counts
_CLOSE = 0.5  # cosine between the displacement and the calibration's force from which both agree


class CoilCheck(NamedTuple):
    """Response of one coil to a test current, flotor blocked.

    Attributes:
        coil: Its index, 0 to 5.
        current: Commanded [A].
        measured: Mean of its measured current [A].
        others: Largest mean of any other coil's measured current [A].
        displacement: Half the displacement between the two currents [m, rad], (6,).
        error: Standard error of that [m, rad], (6,).
        expected: Wrench of the coil by the calibration [N, N m], (6,).
        verdict: "as calibrated", "reversed", "elsewhere" or "not seen".
    """

    coil: int
    current: float
    measured: float
    others: float
    displacement: Array
    error: Array
    expected: Array
    verdict: str


def check_coil(plant: RemotePlant, coil: int, current: float = 0.2) -> CoilCheck:
    """Send a current and its opposite through one coil.

    The flotor must be blocked by a soft material, such as foam, that yields by some micrometers. The device is
    armed without hover currents and disarmed at the end.

    Args:
        plant: The device, not armed.
        coil: Index, 0 to 5.
        current: Above 0, at most the smaller of the host's and the device's limit [A].

    Raises:
        ParameterError: If an argument is outside its bounds.
        DeviceFault: If the device raises a fault.
    """
    one = _arm(plant, coil, current)
    means, errors, flowed = [], [], []
    for sign in (1.0, -1.0):
        poses, currents = _hold(plant, [sign * part for part in one])
        means.append(poses.mean(axis=0))
        errors.append(poses.var(axis=0) / len(poses))
        flowed.append(sign * currents.mean(axis=0))
    plant.disarm()
    displacement, error = 0.5 * (means[0] - means[1]), 0.5 * np.sqrt(errors[0] + errors[1])
    measured, expected = np.mean(flowed, axis=0), plant.calibration.coils.wrench(np.array(one))
    own, others = float(measured[coil]), float(np.abs(np.delete(measured, coil)).max())
    verdict = _verdict(displacement[:3], error[:3], expected[:3])
    return CoilCheck(coil, current, own, others, displacement, error, expected, verdict)


def record_step(plant: RemotePlant, coil: int, current: float = 0.2, samples: int = 20) -> Array:
    """Return a coil's measured currents after a step from zero.

    Args:
        plant: The device, not armed, its flotor blocked.
        coil: Index, 0 to 5.
        current: Step size [A].
        samples: Number of samples recorded after the step.

    Returns:
        (samples, 2): time since the command left [s], measured current [A].

    Raises:
        ParameterError: If an argument is outside its bounds.
        DeviceFault: If the device raises a fault.
    """
    one = _arm(plant, coil, current)
    plant.read()
    first = plant.samples.tick
    rows = []
    for _ in range(int(number("samples", samples, at_least=1))):
        plant.drive(one)
        plant.read()
        rows.append(((plant.samples.tick - first) * plant.period, plant.report.currents[coil]))
    plant.disarm()
    return np.array(rows)


def mean_pose(plant: RemotePlant, duration: float = 1.0) -> tuple[Array, Array]:
    """Return mean and standard error of the measured spots [m].

    Both are (6,). The device must be at rest.

    Args:
        plant: The device, not armed.
        duration: Measuring time [s].
    """
    spots = []
    for _ in range(max(round(number("duration", duration, above=0.0) / plant.period), 2)):
        plant.read()
        spots.append(plant.report.spots)
    rows = np.array(spots)
    return rows.mean(axis=0), rows.std(axis=0) / np.sqrt(len(rows))


def with_offsets(calibration: Calibration, spots: ArrayLike) -> Calibration:
    """Return a calibration with spot offsets that define the centre.

    Args:
        calibration: Calibration with all other values.
        spots: Mean spots with the flotor clamped at the centre, upright [m], (6,).
    """
    centre = calibration.beams.spots(np.zeros(6))
    return replace(calibration, spot_offsets=np.asarray(spots) - centre)


def _arm(plant: RemotePlant, coil: int, current: float) -> list[float]:
    """Arm a device without hover currents; return the currents of one coil."""
    number("coil", coil, at_least=0, at_most=5)
    number("current", current, above=0.0, at_most=plant.limits.current_limit)
    plant.arm(hover=ZERO)
    return [current if index == coil else 0.0 for index in range(6)]


def _hold(plant: RemotePlant, currents: Sequence[float]) -> tuple[Array, Array]:
    """Return poses and measured currents under constant currents, after settling.

    Both are (N, 6).
    """
    poses, measured = [], []
    settle = max(round(_PAUSE / plant.period), 2)
    for _ in range(2 * settle):
        poses.append(tuple(plant.read().position))
        plant.drive(currents)
        measured.append(plant.report.currents)
    return np.array(poses[settle:]), np.array(measured[settle:])


def _verdict(displacement: Array, error: Array, expected: Array) -> str:
    if np.linalg.norm(displacement) < _SEEN * np.linalg.norm(error):
        return "not seen"
    cosine = displacement @ expected / (np.linalg.norm(displacement) * np.linalg.norm(expected))
    if abs(cosine) < _CLOSE:
        return "elsewhere"
    return "as calibrated" if cosine > 0.0 else "reversed"
