"""Geometry of three light beams on three position-sensing diodes.

Spots from a pose, and the pose from spots by Newton's method.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maglev_mj.errors import ModelError, SensingError
from maglev_mj.frames import Array, quaternions, rotation_matrix, rotation_vector

_CLOSE_ENOUGH = 1e-13
_MOST_STEPS = 20


@dataclass(frozen=True, eq=False)
class Beams:
    """Geometry of the pose sensor.

    Three LEDs on the flotor each light one two-dimensional diode on the stator.

    Args:
        leds: Position of each LED from the flotor's centre of mass, in flotor axes [m], (3, 3).
        directions: Unit direction of each beam in flotor axes, (3, 3).
        diodes: Centre of each diode from the centre of the range, in stator axes [m], (3, 3).
        across: The two unit axes of each diode's surface in stator axes, (3, 2, 3).

    Raises:
        ModelError: If a beam does not meet its diode, or the spots at the centre do not determine the pose.

    Source: Salcudean & Vlaar 1997, section 2 and figure 1; the positions are the model's, assumed.
    """

    leds: Array
    directions: Array
    diodes: Array
    across: Array

    def __post_init__(self) -> None:
        shapes = self.leds.shape, self.directions.shape, self.diodes.shape, self.across.shape
        if shapes != ((3, 3), (3, 3), (3, 3), (3, 2, 3)):
            raise ModelError(f"three LEDs and three diodes are needed, not {shapes}")
        if np.abs(np.einsum("ka,ka->k", self.directions, self.normals)).min() < 1e-6:
            raise ModelError("every beam must meet its diode, not run along it")
        if np.linalg.matrix_rank(self._spots(np.zeros(6))[1]) < 6:
            raise ModelError("the spots must tell all six coordinates apart")

    @property
    def normals(self) -> Array:
        """Unit normal of each diode in stator axes, (3, 3)."""
        return np.cross(self.across[:, 0], self.across[:, 1])

    def spots(self, pose: Array) -> Array:
        """Return the beams' spots on their diodes.

        Args:
            pose: Poses [m, rad], (..., 6).

        Returns:
            Both coordinates of the first diode's spot, then of the second's and the third's [m], (..., 6).
        """
        return self._spots(pose)[0]

    def pose(self, spots: Array, guess: Array | None = None) -> Array:
        """Return the pose of given spots by Newton's method.

        Args:
            spots: Spots in the order of `spots` [m], (..., 6).
            guess: Start of Newton's method [m, rad], (..., 6); the centre by default.

        Raises:
            SensingError: If it does not converge, as for spots outside the range of poses.
        """
        pose = np.zeros(spots.shape) if guess is None else np.array(np.broadcast_to(guess, spots.shape))
        for _ in range(_MOST_STEPS):
            seen, slopes = self._spots(pose)
            try:
                change = np.linalg.solve(slopes, (spots - seen)[..., None])[..., 0]
            except np.linalg.LinAlgError:
                break
            if not np.isfinite(change).all():
                break
            pose = _moved(pose, change)
            if np.abs(change).max(initial=0.0) < _CLOSE_ENOUGH:
                return pose
        raise SensingError(f"no pose was found for the spots {np.array2string(spots, precision=6)} m")

    def _spots(self, pose: Array) -> tuple[Array, Array]:
        """Return spots (..., 6) and their derivatives (..., 6, 6).

        Derivatives with respect to small translations and rotations in stator axes.
        """
        turn = rotation_matrix(pose[..., 3:])
        arm = np.einsum("...ab,kb->...ka", turn, self.leds)
        beam = np.einsum("...ab,kb->...ka", turn, self.directions)
        normals = self.normals
        forward = np.einsum("...ka,ka->...k", beam, normals)[..., None]
        to_diode = self.diodes - arm - pose[..., None, :3]
        length = np.einsum("...ka,ka->...k", to_diode, normals)[..., None] / forward
        spots = np.einsum("kca,...ka->...kc", self.across, length * beam - to_diode)
        # a motion of the light moves the spot by its part along the diode, seen along the beam
        seen = self.across - np.einsum("kca,...ka->...kc", self.across, beam)[..., None] * (
            normals[:, None] / forward[..., None]
        )
        turned = np.cross((arm + length * beam)[..., None, :], seen)
        slopes = np.concatenate([seen, turned], axis=-1)
        return spots.reshape(*pose.shape[:-1], 6), slopes.reshape(*pose.shape[:-1], 6, 6)


def _moved(pose: Array, change: NDArray[Any]) -> Array:
    """Return poses after a translation and a rotation.

    The rotation is about stator axes.
    """
    w, x, y, z = quaternions(change[..., 3:])
    p, a, b, c = quaternions(pose[..., 3:])
    product = (
        w * p - x * a - y * b - z * c,
        w * a + x * p + y * c - z * b,
        w * b - x * c + y * p + z * a,
        w * c + x * b - y * a + z * p,
    )
    turn = rotation_vector(*product, np.sqrt, np.arctan2)
    return np.concatenate([pose[..., :3] + change[..., :3], np.stack(turn, axis=-1)], axis=-1)
