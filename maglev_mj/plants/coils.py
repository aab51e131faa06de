"""Coil map between currents and wrench, its inverse for a rotated flotor, and current limits."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Self, cast

import numpy as np

from maglev_mj.device import Device, inverse_map, wrench_map
from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, Array, Command
from maglev_mj.keywords import checked, explained
from maglev_mj.parameters import number, numbers, store

UPRIGHT = 1e-9
"""Largest angle [rad] at which the upright coil map is used; its error is negligible."""


@checked
@dataclass(frozen=True, eq=False)
class CoilMap:
    """Linear map between the currents of N coils, six or more, and the wrench; `len` is N.

    The magnets are fixed to the stator and the coils to the flotor: a force keeps its direction in stator axes, and its
    point of application rotates with the flotor. Methods without an angle use the map of the upright flotor. The
    currents of a wrench are those of least norm, by the pseudoinverse of the map: for six coils, the only ones.

    Args:
        points: Point of application of each coil's force, from the flotor's centre of mass, in flotor axes [m], (N, 3).
        directions: Unit direction of each force in stator axes, (N, 3).
        force_constants: Force constants [N/A], (N,).

    Raises:
        ModelError: If there are fewer than six coils, or their map is singular.

    Example:
        >>> from maglev_mj import Calibration
        >>> coils = Calibration.nominal().coils
        >>> currents = coils.currents([0.0, 0.0, 6.867, 0.0, 0.0, 0.0])  # weight of 0.7 kg
        >>> currents.round(2).tolist()
        [1.14, 1.14, 1.14, 0.0, 0.0, 0.0]
        >>> coils.wrench(currents).round(3).tolist()[2]
        6.867
    """

    points: Array
    directions: Array
    force_constants: Array
    wrench_per_current: Array = field(init=False)
    current_per_wrench: Array = field(init=False)
    _turning: Array = field(init=False, repr=False)
    _blocks: Array = field(init=False, repr=False)
    _spread: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        for name in ("points", "directions", "force_constants"):
            shape = "(N,)" if name == "force_constants" else "(N, 3)"
            store(self, **{name: np.array(numbers(name, getattr(self, name), shape=shape))})
        upright = wrench_map(self.points, self.directions, self.force_constants)
        forces = upright[:3].T
        # torque a of coil j is linear in the rotation matrix: eps_abc R_bk p_jk f_jc
        levi_civita = np.cross(np.eye(3)[:, None], np.eye(3))  # [b, c, a]
        turning = np.einsum("bca,jk,jc->ajbk", levi_civita, self.points, forces).reshape(-1, 9)
        store(self, wrench_per_current=upright, current_per_wrench=inverse_map(upright), _turning=turning)
        if len(self) == len(AXES):
            blocks, spread = _blocks_of(self.current_per_wrench, turning)
            store(self, _blocks=blocks, _spread=spread)
        for array in (self.points, self.directions, self.force_constants, upright, self.current_per_wrench):
            array.setflags(write=False)  # shared by many plants

    def __len__(self) -> int:
        return len(self.force_constants)

    @classmethod
    def of(cls, device: Device) -> Self:
        """Return the coils of a device.

        Raises:
            ParameterError: If it has none.
        """
        if (coils := device.coils) is None:
            raise ParameterError(f"device {device.name!r} has no coils, which flights and their twin need")
        points = np.array(coils.points) - device.body.centre_of_mass
        return cls(points, np.array(coils.directions), np.array(coils.force_constants))

    @explained
    def inverse_at(self, rotation: Array) -> Array:
        """Return the inverse coil map [A/N, A/(N m)], (N, 6) or (M, N, 6), at rotation matrices (9,) or (M, 9)."""
        if rotation.ndim > 1:
            maps = np.repeat(self.wrench_per_current[None], len(rotation), axis=0)
            maps[:, 3:] = (rotation @ self._turning.T).reshape(-1, 3, len(self))
            return inverse_map(maps)
        rotated = self.wrench_per_current.copy()
        rotated[3:] = self._turning.dot(rotation).reshape(3, -1)
        return inverse_map(rotated)

    @explained
    def inverse_at_angle(self, rx: float, ry: float, rz: float) -> Array:
        """Return the inverse coil map [A/N, A/(N m)], (N, 6), at a rotation vector [rad].

        Equal to `inverse_at` to rounding, for six coils in half the time; see `_blocks_of`.
        """
        square = rx * rx + ry * ry + rz * rz
        if square <= UPRIGHT * UPRIGHT:
            return self.current_per_wrench
        angle = math.sqrt(square)
        half = math.sin(0.5 * angle) / angle
        w, x, y, z = math.cos(0.5 * angle), half * rx, half * ry, half * rz
        xx, yy, zz = 2.0 * x * x, 2.0 * y * y, 2.0 * z * z
        xy, xz, yz, wx, wy, wz = 2.0 * x * y, 2.0 * x * z, 2.0 * y * z, 2.0 * w * x, 2.0 * w * y, 2.0 * w * z
        rows = [1.0 - yy - zz, xy - wz, xz + wy, xy + wz, 1.0 - xx - zz, yz - wx, xz - wy, yz + wx, 1.0 - xx - yy]
        if len(self) > len(AXES):  # the inverse of M W is W⁻¹ M⁻¹ for square W only
            return self.inverse_at(np.array(rows))
        lower = struct.pack("19d", *_lower_rows(self._blocks.dot(rows).tolist()))  # packed: half the time of np.array
        return cast(Array, self._spread.dot(np.frombuffer(lower)).reshape(6, 6))

    def currents(self, wrench: Array) -> Array:
        """Return the currents [A], (..., N), of least norm for a wrench [N, N m], (..., 6)."""
        return numbers("wrench", wrench, shape="(..., 6)") @ self.current_per_wrench.T

    def wrench(self, currents: Array) -> Array:
        """Return the wrench [N, N m], (..., 6), of currents [A], (..., N)."""
        return numbers("currents", currents, shape=f"(..., {len(self)})") @ self.wrench_per_current.T

    def largest_wrench(self, current: float) -> Array:
        """Return the largest force or torque on each axis, with zero on all others [N, N m], (6,).

        Args:
            current: Largest current in any coil [A].

        Raises:
            ParameterError: If the current is negative.
        """
        return np.asarray(number("current", current, at_least=0.0) / np.abs(self.current_per_wrench).max(axis=0))

    def condition_number(self, length: float) -> float:
        """Return the 2-norm condition number, with torques divided by a length [m]."""
        scale = np.array([1.0] * 3 + [1.0 / number("length", length, above=0.0)] * 3)
        return float(np.linalg.cond(scale[:, None] * self.wrench_per_current))


def limited_wrench(inverse_map: Array, force: Sequence[float], limit: float) -> tuple[Sequence[float], list[float]]:
    """Saturate the currents of a wrench; return the resulting wrench and its currents.

    Six currents are clipped, each alone. More are scaled together: clipped ones are not of least norm.

    Args:
        inverse_map: Inverse coil map [A/N, A/(N m)], (N, 6).
        force: Wrench [N, N m], six; the same object is returned if no current saturates.
        limit: Largest current in any coil [A].
    """
    currents = inverse_map.dot(force)
    listed: list[float] = currents.tolist()
    if max(listed) <= limit and min(listed) >= -limit:
        return force, listed
    if len(listed) > len(force):
        share = limit / float(np.abs(currents).max())
        return [share * part for part in force], [share * current for current in listed]
    saturated = np.linalg.solve(inverse_map, np.clip(currents, -limit, limit))
    return saturated.tolist(), inverse_map.dot(saturated).tolist()


def wrench_of(inverse_map: Array, currents: Array) -> Array:
    """Return the wrench [N, N m], (..., 6), of currents [A], (..., N), by inverse coil maps, (..., N, 6)."""
    if inverse_map.shape[-2] > len(AXES):
        return np.asarray(np.linalg.pinv(inverse_map) @ currents[..., None])[..., 0]
    return np.asarray(np.linalg.solve(inverse_map, currents[..., None]))[..., 0]


def _blocks_of(upright: Array, turning: Array) -> tuple[Array, Array]:
    """Return the matrices for `CoilMap.inverse_at_angle`.

    Rotation does not change the coils' forces: the map is M W, with W that of the upright flotor and
    M = [[1, 0], [A, B]]. Its inverse is W⁻¹ [[1, 0], [-B⁻¹ A, B⁻¹]].

    Args:
        upright: W⁻¹, (6, 6).
        turning: Map of a rotation matrix (9,) to the lower three rows of M W, (18, 9).

    Returns:
        Map of a rotation matrix to the rows of A and then of B, (18, 9); map of the result of `_lower_rows` to the
        inverse of M W, (36, 19).
    """
    lower = np.einsum("ajr,jm->amr", turning.reshape(3, 6, 9), upright)
    blocks = np.concatenate([lower[:, :3].reshape(9, 9), lower[:, 3:].reshape(9, 9)])
    spread = np.zeros((6, 6, 19))
    for row in range(3):
        for column in range(3):
            spread[:, column, 3 * row + column] = upright[:, 3 + row]
            spread[:, 3 + column, 9 + 3 * row + column] = upright[:, 3 + row]
    spread[:, :3, 18] = upright[:, :3]
    return blocks, spread.reshape(36, 19)


def _lower_rows(blocks: Sequence[float]) -> tuple[float, ...]:
    """Return the rows of -B⁻¹ A and B⁻¹, and 1, from the rows of A and B."""
    a0, a1, a2, a3, a4, a5, a6, a7, a8, b0, b1, b2, b3, b4, b5, b6, b7, b8 = blocks
    c0, c3, c6 = b4 * b8 - b5 * b7, b5 * b6 - b3 * b8, b3 * b7 - b4 * b6
    over = 1.0 / (b0 * c0 + b1 * c3 + b2 * c6)
    c0, c3, c6 = over * c0, over * c3, over * c6
    c1, c4, c7 = over * (b2 * b7 - b1 * b8), over * (b0 * b8 - b2 * b6), over * (b1 * b6 - b0 * b7)
    c2, c5, c8 = over * (b1 * b5 - b2 * b4), over * (b2 * b3 - b0 * b5), over * (b0 * b4 - b1 * b3)
    return (
        *(-c0 * a0 - c1 * a3 - c2 * a6, -c0 * a1 - c1 * a4 - c2 * a7, -c0 * a2 - c1 * a5 - c2 * a8),
        *(-c3 * a0 - c4 * a3 - c5 * a6, -c3 * a1 - c4 * a4 - c5 * a7, -c3 * a2 - c4 * a5 - c5 * a8),
        *(-c6 * a0 - c7 * a3 - c8 * a6, -c6 * a1 - c7 * a4 - c8 * a7, -c6 * a2 - c7 * a5 - c8 * a8),
        *(c0, c1, c2, c3, c4, c5, c6, c7, c8, 1.0),
    )


class CoilDrive:
    """Saturated coil currents of a wrench at the flotor's present angle.

    Args:
        coils: Coil map of the commanding side.
        limit: Largest current in any coil [A]; None for no limit.

    Attributes:
        inverse_map: Inverse coil map at the last angle of `follow` [A/N, A/(N m)], (N, 6).
    """

    def __init__(self, coils: CoilMap, limit: float | None) -> None:
        self._coils, self._limit = coils, limit
        self._upright = coils.current_per_wrench
        self._wrench, self._currents = np.zeros(6), np.zeros(len(coils))
        # equivalent to self._wrench[:] = force, in half the time
        self._fill = partial(struct.pack_into, "6d", self._wrench.data, 0)
        self.reset()

    def reset(self) -> None:
        """Set the map to that of the upright flotor."""
        self.inverse_map = self._upright
        self._cached: tuple[Sequence[float] | None, list[float]] = None, []

    def follow(self, rotation: Array | None, angle: Sequence[float] | None = None) -> bool:
        """Update the map to a new angle; return True if the flotor was upright and still is.

        Args:
            rotation: Rotation matrix of the flotor, (9,); None for upright.
            angle: Measured rotation vector [rad], used instead of the matrix.
        """
        before = self.inverse_map
        if angle is not None:
            self.inverse_map = self._coils.inverse_at_angle(*angle)
        else:
            self.inverse_map = self._upright if rotation is None else self._coils.inverse_at(rotation)
        return before is self._upright is self.inverse_map

    def currents(self, force: Sequence[float]) -> list[float]:
        """Return the N currents [A] for a wrench [N, N m], six."""
        wrench, currents = self._cached
        if force is wrench:  # already computed by the limiter
            return currents
        return self._mapped(force)

    def _mapped(self, force: Sequence[float]) -> list[float]:
        self._fill(*force)
        listed: list[float] = self.inverse_map.dot(self._wrench, out=self._currents).tolist()
        return listed

    def limited(self, command: Command) -> Command:
        """Saturate the currents of a command and those of its pulse separately."""
        force, extra = command.force, command.extra
        if extra is None:
            saturated = self._clipped(force)
            return command if saturated is force else Command(saturated)
        total = self._clipped([held + pulse for held, pulse in zip(force, extra)])
        saturated = self._clipped(force)
        return Command(saturated, [both - held for both, held in zip(total, saturated)], command.pulse_width)

    def _clipped(self, force: Sequence[float]) -> Sequence[float]:
        limit = self._limit
        assert limit is not None
        currents = self._mapped(force)
        within = max(currents) <= limit and min(currents) >= -limit  # the usual case
        self._cached = (force, currents) if within else limited_wrench(self.inverse_map, force, limit)
        return self._cached[0]
