"""Tests before the first hover: coils, current loops, spot offsets."""

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

_PAUSE = 0.25  # settling time, and then measuring time [s]
_SEEN = 5.0  # significant displacement [standard errors]
_TEST = 0.8  # test current as a share of the largest that counts as off
_CLOSE = 0.5  # smallest cosine between displacement and calibrated force at which both agree


class CoilCheck(NamedTuple):
    """Response of one coil to a test current, flotor blocked.

    Attributes:
        coil: Index, 0 to 5.
        current: Commanded current [A].
        measured: Mean measured current of the coil [A].
        others: Largest mean measured current of another coil [A].
        displacement: Half the displacement between the opposite currents [m, rad], (6,).
        error: Standard error of the displacement [m, rad], (6,).
        expected: Wrench of the coil according to the calibration [N, N m], (6,).
        verdict: "as calibrated", "reversed", "wrong direction" or "no motion".
    """

    coil: int
    current: float
    measured: float
    others: float
    displacement: Array
    error: Array
    expected: Array
    verdict: str


def check_coil(plant: RemotePlant, coil: int, current: float | None = None) -> CoilCheck:
    """Check polarity and position of one coil with a current of either sign.

    The flotor must be blocked by soft foam that yields by some micrometres. The device is armed without hover
    currents and disarmed at the end.

    Args:
        plant: The device, not armed.
        coil: Index, 0 to 5.
        current: Test current above 0, at most the smaller of the host's and the device's limit [A]; None for 0.8 times
            `Scale.off`, 0.2 A on the published joystick.

    Raises:
        ParameterError: If an argument is outside its bounds.
        DeviceFault: If the device raises a fault.
    """
    currents_on = _arm(plant, coil, current)
    means, errors, flowed = [], [], []
    for sign in (1.0, -1.0):
        poses, currents = _hold(plant, [sign * x for x in currents_on])
        means.append(poses.mean(axis=0))
        errors.append(poses.var(axis=0) / len(poses))
        flowed.append(sign * currents.mean(axis=0))
    plant.disarm()
    displacement, error = 0.5 * (means[0] - means[1]), 0.5 * np.sqrt(errors[0] + errors[1])
    measured, expected = np.mean(flowed, axis=0), plant.calibration.coils.wrench(np.array(currents_on))
    own, others = float(measured[coil]), float(np.abs(np.delete(measured, coil)).max())
    verdict = _verdict(displacement[:3], error[:3], expected[:3])
    return CoilCheck(coil, currents_on[coil], own, others, displacement, error, expected, verdict)


def record_step(plant: RemotePlant, coil: int, current: float | None = None, samples: int = 20) -> Array:
    """Return the step response of a coil's measured current.

    Args:
        plant: The device, not armed, its flotor blocked.
        coil: Index, 0 to 5.
        current: Step size [A]; None as for `check_coil`.
        samples: Number of samples recorded after the step.

    Returns:
        (samples, 2): time since the command was sent [s], measured current [A].

    Raises:
        ParameterError: If an argument is outside its bounds.
        DeviceFault: If the device raises a fault.
    """
    currents = _arm(plant, coil, current)
    plant.read()
    first = plant.samples.tick
    rows = []
    for _ in range(int(number("samples", samples, at_least=1))):
        plant.drive(currents)
        plant.read()
        rows.append(((plant.samples.tick - first) * plant.period, plant.report.currents[coil]))
    plant.disarm()
    return np.array(rows)


def mean_pose(plant: RemotePlant, duration: float = 1.0) -> tuple[Array, Array]:
    """Return mean and standard error of the measured spots [m], each (6,), of a device at rest.

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
    """Return a calibration whose spot offsets make the measured spots the centre.

    Args:
        calibration: Calibration with all other values.
        spots: Mean spots with the flotor clamped at the centre, upright [m], (6,).
    """
    centre = calibration.beams.spots(np.zeros(6))
    return replace(calibration, spot_offsets=np.asarray(spots) - centre)


def _arm(plant: RemotePlant, coil: int, current: float | None) -> list[float]:
    """Arm a device without hover currents; return the currents of one coil."""
    number("coil", coil, at_least=0, at_most=5)
    current = _TEST * plant.scale.off if current is None else current
    number("current", current, above=0.0, at_most=plant.limits.current_limit)
    plant.arm(hover=ZERO)
    return [current if index == coil else 0.0 for index in range(6)]


def _hold(plant: RemotePlant, currents: Sequence[float]) -> tuple[Array, Array]:
    """Return poses and measured currents under constant currents, after settling; both (N, 6)."""
    poses, measured = [], []
    settle = max(round(_PAUSE / plant.period), 2)
    for _ in range(2 * settle):
        poses.append(tuple(plant.read().position))
        plant.drive(currents)
        measured.append(plant.report.currents)
    return np.array(poses[settle:]), np.array(measured[settle:])


def _verdict(displacement: Array, error: Array, expected: Array) -> str:
    if np.linalg.norm(displacement) < _SEEN * np.linalg.norm(error):
        return "no motion"
    cosine = displacement @ expected / (np.linalg.norm(displacement) * np.linalg.norm(expected))
    if abs(cosine) < _CLOSE:
        return "wrong direction"
    return "as calibrated" if cosine > 0.0 else "reversed"
