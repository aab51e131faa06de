"""Samples, commands and rotations.

Pose (..., 6): x y z [m], then a rotation vector [rad]. Twist and wrench: linear part first, in stator axes. The leading
``...`` is the batch: () for one device, (N,) for N devices.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from maglev_mj.errors import NO_MASK, is_masked
from maglev_mj.keywords import checked

AXES = ("x", "y", "z", "rx", "ry", "rz")
"""Names of the six axes: translations along the stator axes, then rotations about them."""

_ROTATIONAL_UNITS = {
    **{"m": "rad", "mm": "mrad", "µm": "µrad", "m/s": "rad/s", "mm/s": "mrad/s"},
    **{"N": "N m", "mN": "mN m", "N/m": "N m/rad", "N/mm": "N m/mrad", "kN/m": "kN m/rad", "N s/m": "N m s/rad"},
    "kg": "kg m²",
}

ZERO = (0.0,) * 6
"""Six zeros: zero wrench, twist or currents; pose at the centre."""

Array: TypeAlias = NDArray[np.float64]
"""Array of floats."""

Mask: TypeAlias = NDArray[np.bool_]
"""Array of booleans."""

Component: TypeAlias = Any
"""One coordinate: a float for one device, an array (N,) for N devices.

Laws and the exact plant compute on components, so that one implementation serves both: six Python floats cost a tenth
of six-element NumPy calls, and N devices cost six array operations. Laws use only elementwise + - * / and comparisons,
which IEEE 754 rounds identically in both, so commands agree bit for bit.
"""

Six: TypeAlias = Sequence[Component]
"""Six components, one per axis."""


def distances(furthest: Array) -> str:
    """Return the largest of six displacements [m, rad], in mm and degrees."""
    parts = [(furthest[..., :3].max() * 1e3, "mm"), (np.degrees(furthest[..., 3:].max()), "deg")]
    return " and ".join(f"{value:.3g} {unit}" for value, unit in parts if value > 1e-9) or "0 mm"


@dataclass(slots=True, eq=False)
class Sample:
    """Measured pose at a sampling instant.

    Attributes:
        tick: Sample number, from 0.
        time: Time since release [s]; (N,) if the sampling phases of the devices differ.
        position: Six components of the measured pose [m, rad].

    Example:
        >>> from maglev_mj import Sample
        >>> sample = Sample(tick=3, time=0.015, position=[0.0, 0.0, 0.001, 0.0, 0.0, 0.0])
        >>> sample.position[2]
        0.001
    """

    tick: int
    time: float | Array
    position: Six

    @property
    def pose(self) -> Array:
        """Measured pose [m, rad], (..., 6)."""
        return join(self.position)


@checked
class DeviceWall(NamedTuple):
    """PD wall that the device renders at its own rate, f = -K (x - edge) - B v inside.

    Attributes:
        axis: Index into AXES.
        edge: Edge x0 [m, rad].
        side: 1 for a wall that fills x <= edge, -1 for x >= edge, 0 for a spring and damper on both sides.
        stiffness: Stiffness K [N/m, N m/rad].
        damping: Damping B [N s/m, N m s/rad].
        cutoff: Cutoff frequency of the velocity's low-pass filter [Hz]; None for the finite difference.

    Example:
        >>> from maglev_mj import Command, DeviceWall
        >>> Command([0.0] * 6, walls=(DeviceWall(axis=2, stiffness=60e3, damping=200.0),)).walls[0].side
        1
    """

    axis: int
    edge: Component = 0.0
    side: int = 1
    stiffness: Component = 0.0
    damping: Component = 0.0
    cutoff: float | None = None


@dataclass(slots=True, eq=False)
class Command:
    """Controller output: wrench and walls, held until the next command takes effect, and pulse.

    Attributes:
        force: Six components of the held wrench on the flotor, in stator axes [N, N m].
        extra: Six components added for `pulse_width` once the command takes effect; None for no pulse.
        pulse_width: Duration of the pulse [s].
        walls: All walls that the device renders beside the wrench.

    Example:
        >>> from maglev_mj import Command
        >>> command = Command([0.0, 0.0, 6.867, 0.0, 0.0, 0.0])  # the weight of 0.7 kg, without a pulse
        >>> command.force[2], command.pulse_width
        (6.867, 0.0)
    """

    force: Six
    extra: Six | None = None
    pulse_width: float = 0.0
    walls: Sequence[DeviceWall] = ()

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
    """Clip a component to plus or minus a limit."""
    if value.__class__ is float and limit.__class__ is float:
        return min(max(value, -limit), limit)
    return np.clip(value, -limit, limit)


def join(parts: Sequence[Component]) -> Array:
    """Join components, arrays or numbers, into one array (..., 6); inverse of `components`."""
    if set(map(type, parts)) == {float}:  # one device: 20 times faster
        return np.array(parts)
    return np.stack(np.broadcast_arrays(*parts), axis=-1)


def is_finite(total: Any) -> bool:
    """Return True if a sum of components is finite, without masked values."""
    return bool(np.isfinite(total).all()) and not is_masked(total)


def not_finite(name: str, parts: Six) -> str:
    """Return the message for the first of six components, or the time after them, that is not finite; "" if all are."""
    if is_masked(tuple(parts)):
        return f"{name} {NO_MASK}"
    values = join(parts)
    for *device, axis in np.argwhere(~np.isfinite(values)).tolist():
        where = f", device {tuple(device)}" if device else ""
        return f"{name} must be finite (got {(*AXES, 'time')[axis]} = {values[(*device, axis)]:g}{where})"
    return ""


_Function: TypeAlias = Callable[..., Any]


def rotation_vector(
    w: Component, x: Component, y: Component, z: Component, sqrt: _Function = math.sqrt, atan2: _Function = math.atan2
) -> tuple[Any, Any, Any]:
    """Convert a unit quaternion to a rotation vector [rad] with an angle in [0, 2 pi).

    For arrays, pass NumPy's `sqrt` and `arctan2`; as arguments they are local names, which is faster.
    """
    # the offset avoids 0/0 and is far below the rounding of any rotation that is not zero
    sine = sqrt(x * x + y * y + z * z) + 1e-300
    scale = 2.0 * (atan2(sine, w) / sine)
    return scale * x, scale * y, scale * z


def quaternion(vector: Sequence[float] | Array) -> tuple[float, float, float, float]:
    """Convert a rotation vector [rad] to a unit quaternion (w, x, y, z)."""
    x, y, z = (float(part) for part in vector)
    angle = math.sqrt(x * x + y * y + z * z)
    scale = 0.5 if angle < 1e-12 else math.sin(0.5 * angle) / angle
    return math.cos(0.5 * angle), scale * x, scale * y, scale * z


def quaternions(vectors: Array) -> tuple[Array, Array, Array, Array]:
    """Convert rotation vectors [rad], (..., 3), to unit quaternions (w, x, y, z), (...) each."""
    half = 0.5 * np.linalg.norm(vectors, axis=-1)
    scale = 0.5 * np.sinc(half / np.pi)  # sin(half) / (2 half), 1/2 at zero
    return np.cos(half), scale * vectors[..., 0], scale * vectors[..., 1], scale * vectors[..., 2]


def rotation_matrix(vectors: Array) -> Array:
    """Convert rotation vectors [rad], (..., 3), to rotation matrices, (..., 3, 3)."""
    w, x, y, z = quaternions(vectors)
    rows = (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def unit_of(unit: str, axis: str | int, along: bool = True) -> str:
    """Return the unit of a quantity on an axis.

    Args:
        unit: Its unit on a translation.
        axis: Name or index of the axis.
        along: True if the quantity acts along the axis, such as force or torque; False to keep the unit.
    """
    rotational = along and (AXES.index(axis) if isinstance(axis, str) else axis) >= 3
    return _ROTATIONAL_UNITS.get(unit, unit) if rotational else unit
