"""What passes between plant and controller, and the one place where rotations are converted.

Pose (..., 6): x y z [m], then a rotation vector [rad]. Twist and wrench: linear part first, in stator
axes. The leading ``...`` is the batch: nothing for one device, (N,) for N of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "AXES",
    "ZERO",
    "Array",
    "Command",
    "Component",
    "Mask",
    "Sample",
    "clipped",
    "components",
    "join",
    "quaternion",
    "quaternions",
    "rotation_matrix",
    "rotation_vector",
]

AXES = ("x", "y", "z", "rx", "ry", "rz")

ZERO = (0.0,) * 6
"""No wrench, twist or currents; the pose of a flotor at the centre."""

Array: TypeAlias = NDArray[np.float64]
Mask: TypeAlias = NDArray[np.bool_]

Component: TypeAlias = Any
"""One coordinate of one device (a float) or of N devices (an array (N,)).

Laws and the exact plant compute on components, so one source serves both: six Python floats cost a tenth
of six-element numpy calls, and N devices cost six array operations. In laws only elementwise + - * / and
comparisons appear, which IEEE 754 rounds alike in both, so commands agree bit for bit.
"""


@dataclass(slots=True, eq=False)
class Sample:
    """What the controller sees at a sampling instant.

    Attributes:
        tick: Sample number, from 0.
        time: Time since release [s]; (N,) where the devices' sampling phases differ.
        position: The six components of the measured pose [m, rad].
    """

    tick: int
    time: float | Array
    position: Sequence[Component]

    @property
    def pose(self) -> Array:
        """Measured pose [m, rad], (..., 6)."""
        return join(self.position)


@dataclass(slots=True, eq=False)
class Command:
    """What the controller answers: a wrench held until the next command takes effect.

    Attributes:
        force: The six components of the held wrench on the flotor, in stator axes [N, N m].
        extra: The six components added from the moment the command takes effect; None for no pulse.
        pulse_width: How long the pulse lasts [s].
    """

    force: Sequence[Component]
    extra: Sequence[Component] | None = None
    pulse_width: float = 0.0

    @property
    def wrench(self) -> Array:
        """Held wrench [N, N m], (..., 6)."""
        return join(self.force)

    @property
    def pulse(self) -> Array:
        """Wrench added for `pulse_width` [N, N m], (..., 6); zero without a pulse."""
        return np.zeros_like(self.wrench) if self.extra is None else join(self.extra)


def components(values: Array) -> list[Component]:
    """Split (..., 6) into six components: floats for one device, contiguous arrays for a batch."""
    if values.ndim == 1:
        return values.tolist()  # type: ignore[no-any-return]
    return list(np.ascontiguousarray(np.moveaxis(values, -1, 0)))


def clipped(value: Component, limit: Component) -> Component:
    """Return a component no further from zero than its limit."""
    if value.__class__ is float and limit.__class__ is float:
        return min(max(value, -limit), limit)
    return np.clip(value, -limit, limit)


def join(parts: Sequence[Component]) -> Array:
    """Put components, some of which may be plain numbers, into one array (..., 6); undoes `components`."""
    if set(map(type, parts)) == {float}:  # one device: a twentieth of the time
        return np.array(parts)
    return np.stack(np.broadcast_arrays(*parts), axis=-1)


_Function: TypeAlias = Callable[..., Any]


def rotation_vector(
    w: Component, x: Component, y: Component, z: Component, sqrt: _Function = math.sqrt, atan2: _Function = math.atan2
) -> tuple[Any, Any, Any]:
    """Convert a unit quaternion into a rotation vector [rad]; its angle is in [0, 2 pi).

    For N of them, as arrays, the last two arguments are numpy's. Being arguments they are also local, which the
    control tick is grateful for.
    """
    # the offset keeps 0/0 away and is far below the rounding of any rotation that is not zero
    sine = sqrt(x * x + y * y + z * z) + 1e-300
    scale = 2.0 * (atan2(sine, w) / sine)
    return scale * x, scale * y, scale * z


def quaternion(vector: Sequence[float] | Array) -> tuple[float, float, float, float]:
    """Convert one rotation vector [rad] into a unit quaternion (w, x, y, z)."""
    x, y, z = (float(part) for part in vector)
    angle = math.sqrt(x * x + y * y + z * z)
    scale = 0.5 if angle < 1e-12 else math.sin(0.5 * angle) / angle
    return math.cos(0.5 * angle), scale * x, scale * y, scale * z


def quaternions(vectors: Array) -> tuple[Array, Array, Array, Array]:
    """Convert rotation vectors [rad], (..., 3), into unit quaternions (w, x, y, z), (...) each."""
    half = 0.5 * np.linalg.norm(vectors, axis=-1)
    scale = 0.5 * np.sinc(half / np.pi)  # sin(half) / (2 half), 1/2 at zero
    return np.cos(half), scale * vectors[..., 0], scale * vectors[..., 1], scale * vectors[..., 2]


def rotation_matrix(vectors: Array) -> Array:
    """Convert rotation vectors [rad], (..., 3), into rotation matrices, (..., 3, 3)."""
    w, x, y, z = quaternions(vectors)
    rows = (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
