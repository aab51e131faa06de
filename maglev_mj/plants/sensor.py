"""Pose sensors: resolution and noise, and three light beams on three position-sensing diodes.

Light spots are computed from a pose, and the pose from spots by Newton's method.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import product
from operator import add
from typing import Any, ClassVar, Protocol, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from maglev_mj.device import Device
from maglev_mj.errors import ModelError, ParameterError, SensingError
from maglev_mj.frames import Array, Component, Six, components, join, quaternions, rotation_matrix, rotation_vector
from maglev_mj.keywords import checked
from maglev_mj.lazy import mujoco
from maglev_mj.parameters import number, numbers, six, store, whole
from maglev_mj.plants.model import invalid_model, model_path, reference_state, written
from maglev_mj.versions import MODELS

_NEWTON_CLOSE = 1e-13
_NEWTON_STEPS = 20


@dataclass(frozen=True, eq=False)
class Beams:
    """Geometry of the pose sensor: three LEDs on the flotor, each on one two-dimensional diode of the stator.

    Args:
        leds: Position of each LED from the flotor's centre of mass, in flotor axes [m], (3, 3).
        directions: Unit direction of each beam in flotor axes, (3, 3).
        diodes: Centre of each diode from the centre of the range, in stator axes [m], (3, 3).
        across: Two unit axes of each diode's surface in stator axes, (3, 2, 3).

    Raises:
        ModelError: If a beam does not meet its diode, or the spots at the centre do not determine the pose.

    Source: Salcudean & Vlaar 1997, section 2 and figure 1; positions assumed, as in the model.
    """

    leds: Array
    directions: Array
    diodes: Array
    across: Array

    def __post_init__(self) -> None:
        shapes = self.leds.shape, self.directions.shape, self.diodes.shape, self.across.shape
        if shapes != ((3, 3), (3, 3), (3, 3), (3, 2, 3)):
            raise ModelError(f"three LEDs and three diodes are needed (got {shapes})")
        if np.abs(np.einsum("ka,ka->k", self.directions, self.normals)).min() < 1e-6:
            raise ModelError("every beam must meet its diode; one is parallel to it")
        if np.linalg.matrix_rank(self._spots(np.zeros(6))[1]) < 6:
            raise ModelError("the spots do not determine all six coordinates of the pose")

    @property
    def normals(self) -> Array:
        """Unit normal of each diode in stator axes, (3, 3)."""
        return np.cross(self.across[:, 0], self.across[:, 1])

    def spots(self, pose: Array) -> Array:
        """Return the light spots on the diodes.

        Args:
            pose: Poses [m, rad], (..., 6).

        Returns:
            Two spot coordinates per diode [m], (..., 6).
        """
        return self._spots(pose)[0]

    def pose(self, spots: Array, guess: Array | None = None) -> Array:
        """Return the pose for light spots, by Newton's method.

        Args:
            spots: Spot coordinates as in `spots` [m], (..., 6).
            guess: Initial guess [m, rad], (..., 6); the centre by default.

        Raises:
            SensingError: If it does not converge.
        """
        pose = np.zeros(spots.shape) if guess is None else np.array(np.broadcast_to(guess, spots.shape))
        for _ in range(_NEWTON_STEPS):
            predicted, jacobian = self._spots(pose)
            try:
                change = np.linalg.solve(jacobian, (spots - predicted)[..., None])[..., 0]
            except np.linalg.LinAlgError:
                break
            if not np.isfinite(change).all():
                break
            pose = moved(pose, change)
            if np.abs(change).max(initial=0.0) < _NEWTON_CLOSE:
                return pose
        raise SensingError(f"no pose found for the spots {np.array2string(spots, precision=6)} m")

    def _spots(self, pose: Array) -> tuple[Array, Array]:
        """Return spots (..., 6) and their Jacobian (..., 6, 6) for translations and rotations in stator axes."""
        turn = rotation_matrix(pose[..., 3:])
        arm = np.einsum("...ab,kb->...ka", turn, self.leds)
        beam = np.einsum("...ab,kb->...ka", turn, self.directions)
        normals = self.normals
        forward = np.einsum("...ka,ka->...k", beam, normals)[..., None]
        to_diode = self.diodes - arm - pose[..., None, :3]
        length = np.einsum("...ka,ka->...k", to_diode, normals)[..., None] / forward
        spots = np.einsum("kca,...ka->...kc", self.across, length * beam - to_diode)
        # a displacement of the LED moves the spot by its projection along the beam onto the diode
        projection = self.across - np.einsum("kca,...ka->...kc", self.across, beam)[..., None] * (
            normals[:, None] / forward[..., None]
        )
        turned = np.cross((arm + length * beam)[..., None, :], projection)
        jacobian = np.concatenate([projection, turned], axis=-1)
        return spots.reshape(*pose.shape[:-1], 6), jacobian.reshape(*pose.shape[:-1], 6, 6)


@dataclass(frozen=True)
class PoseScale:
    """Sensor whose device computes the pose; in place of `Beams`, `FastBeams` and `PoseTracker`.

    Its six "spots" are the translations and the rotation vector times a lever.

    Args:
        lever: Lever of the rotations [m].
    """

    lever: float

    @property
    def _scale(self) -> Array:
        return np.array([1.0] * 3 + [self.lever] * 3)

    def spots(self, pose: Any) -> Any:
        """Return the values on the wire [m] of poses [m, rad], (..., 6)."""
        scaled = np.asarray(pose) * self._scale
        return scaled.tolist() if isinstance(pose, list | tuple) else scaled

    def __call__(self, spots: Sequence[float]) -> list[float]:
        """Return the pose of the values on the wire, six components [m, rad].

        Raises:
            SensingError: If a value is not finite.
        """
        pose: list[float] = (np.asarray(spots) / self._scale).tolist()
        if not math.isfinite(sum(pose)):
            raise SensingError(f"no pose: {_formatted(spots)} m is not finite")
        return pose

    def reset(self) -> None:
        """Do nothing: there is no search; see `PoseTracker`."""


def geometry_of(device: Device) -> Beams | PoseScale:
    """Return the geometry of a device's sensor."""
    sensor, centre = device.sensor, device.body.centre_of_mass
    if sensor.kind == "pose":
        return PoseScale(sensor.lever)
    directions, across = np.array(sensor.directions), np.array(sensor.across)
    return Beams(np.array(sensor.leds) - centre, directions, np.array(sensor.diodes) - centre, across)


def tracker_of(geometry: Beams | PoseScale, reach: Sequence[float] = (0.0,) * 6) -> PoseTracker | PoseScale:
    """Return the function from values on the wire to a pose, at least of poses within a reach [m, rad]."""
    if isinstance(geometry, PoseScale):
        return geometry
    distance, angle = math.hypot(*reach[:3]), math.hypot(*reach[3:])
    return PoseTracker(geometry, max(MAX_DISTANCE, distance), max(MAX_ANGLE, min(angle, 0.5 * math.pi)))


def largest_spot(geometry: Beams | PoseScale, reach: Sequence[float]) -> float:
    """Return the largest value on the wire of poses within a reach [m, rad], on all axes at once [m].

    Infinite if a beam turns past its diode on the way.
    """
    poses = np.array(list(product((-1.0, 0.0, 1.0), repeat=6))) * reach
    if isinstance(geometry, Beams):
        beams = np.einsum("...ab,kb->...ka", rotation_matrix(poses[:, 3:]), geometry.directions)
        along = np.einsum("...ka,ka->...k", beams, geometry.normals)
        if (along * np.sign(along[len(along) // 2])).min() < _GRAZING:
            return math.inf
    return float(np.abs(geometry.spots(poses)).max())


def moved(pose: Array, change: NDArray[Any]) -> Array:
    """Return poses after a translation and a rotation in stator axes."""
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


MAX_DISTANCE = 30e-3
"""Default largest distance of a measured pose from the centre [m]; several times the range of motion."""

MAX_ANGLE = 0.8
"""Default largest angle of a measured pose [rad].

At most three other poses give the same spots on the model's diodes, each upside down or rotated by half a turn about
the flotor's axis: no two are within a quarter turn of each other.
"""

_CLOSE_ENOUGH = 1e-7
"""Convergence tolerance of Newton's method in g.

Convergence is quadratic: the next step would be 1e-14, the rounding of a pose. (A spot resolution of 0.8 µm is 1e-5.)
"""

_MOST_STEPS = 12
"""Largest number of Newton steps; 5 suffice from the centre to any pose within `MAX_DISTANCE` and `MAX_ANGLE`."""

_GRAZING = 0.05
"""Least cosine between a beam and the normal of its diode at which its spot is computed."""

_Turn: TypeAlias = tuple[float, float, float]
_UPRIGHT: _Turn = (0.0, 0.0, 0.0)


def _form(stator: Array, flotor: Array) -> Array:
    """Return a . R b as a quadratic form K of the quaternion q of R: q . K q = (q . q) (a . R b).

    Args:
        stator: a in stator axes, (..., 3).
        flotor: b in flotor axes, (..., 3).

    Returns:
        Entries ww, wx, wy, wz, xx, yy, zz, xy, xz, yz, (..., 10); off-diagonal ones count twice.
    """
    product = np.sum(stator * flotor, axis=-1)[..., None]
    outer = stator[..., :, None] * flotor[..., None, :]
    outer = outer + outer.swapaxes(-1, -2)
    diagonal = np.einsum("...aa->...a", outer) - product
    beside = outer[..., [0, 0, 1], [1, 2, 2]]
    return np.concatenate([product, np.cross(flotor, stator), diagonal, beside], axis=-1)


_ONE = np.array([1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
"""Quadratic form of the number 1, q . q."""


class FastBeams:
    """Fast `Beams.spots` for one device, in plain floats.

    Args:
        beams: Geometry.
    """

    def __init__(self, beams: Beams) -> None:
        # per diode: LED position and beam direction, each along the diode's normal and its two axes
        normals = beams.normals[:, None]
        rows = []
        for axes in (normals, beams.across):
            led = _form(axes, beams.leds[:, None])
            beam = _form(axes, beams.directions[:, None])
            from_diode = -np.sum(axes * beams.diodes[:, None], axis=-1)[..., None]
            rows.append(np.concatenate([led, axes, from_diode], axis=-1).reshape(-1, 14))
            rows.append(np.concatenate([beam, np.zeros((*beam.shape[:-1], 4))], axis=-1).reshape(-1, 14))
        self._rows = np.concatenate(rows)

    def spots(self, pose: Sequence[float]) -> list[float]:
        """Return the light spots on the diodes.

        Args:
            pose: Six components [m, rad].

        Returns:
            Spot coordinates as in `Beams.spots` [m], accurate to 1e-16 m.

        Raises:
            SensingError: If a beam is parallel to its diode, or the pose is not finite.
        """
        px, py, pz, rx, ry, rz = pose
        angle = math.sqrt(rx * rx + ry * ry + rz * rz)
        if not math.isfinite(px * px + py * py + pz * pz + angle):
            raise SensingError(f"no spots for the pose {_formatted(pose)} m, rad: not finite")
        scale = math.sin(0.5 * angle) / angle if angle else 0.5
        w, x, y, z = math.cos(0.5 * angle), scale * rx, scale * ry, scale * rz
        v, u, t = w + w, x + x, y + y
        monomials = (w * w, v * x, v * y, v * z, x * x, y * y, z * z, u * y, u * z, t * z, px, py, pz, 1.0)
        # d: distance along the normal, f: its change along the beam; p, s: position and slope along the diode's axes
        d0, d1, d2, f0, f1, f2, p0, p1, p2, p3, p4, p5, s0, s1, s2, s3, s4, s5 = self._rows.dot(monomials).tolist()
        if not f0 * f1 * f2:
            raise SensingError(f"no spots for the pose {_formatted(pose)} m, rad: a beam is parallel to its diode")
        d0, d1, d2 = d0 / f0, d1 / f1, d2 / f2
        return [p0 - d0 * s0, p1 - d0 * s1, p2 - d1 * s2, p3 - d1 * s3, p4 - d2 * s4, p5 - d2 * s5]


class PoseTracker:
    """Fast `Beams.pose` for one device, in plain floats, starting from the last rotation.

    On one machine, equal sequences of spots give bit-identical poses for equal geometries. The initial guess affects
    rounding only (1e-14).

    Args:
        beams: Geometry.
        farthest: Largest distance of a pose from the centre [m]; may be infinite.
        most_turned: Largest angle of a pose [rad].

    Raises:
        ParameterError: If the largest distance or angle is negative, or the angle is above pi.
    """

    def __init__(self, beams: Beams, farthest: float = MAX_DISTANCE, most_turned: float = MAX_ANGLE) -> None:
        distance = float(numbers("farthest", farthest, at_least=0.0, finite=False))
        angle = number("most_turned", most_turned, at_least=0.0, at_most=math.pi)
        self._limits = distance * distance, angle * angle
        self._forms, self._spots, self._products = _forms(beams), np.ones(7), np.empty(60)
        # equivalent to self._spots[:6] = spots, in half the time
        self._fill = partial(struct.pack_into, "6d", self._spots.data, 0)
        self._last = _UPRIGHT

    def __call__(self, spots: Sequence[float]) -> list[float]:
        """Return the pose for light spots, six components [m, rad], the angle in [0, pi].

        Args:
            spots: Two spot coordinates per diode [m], six.

        Raises:
            SensingError: If there is no pose within the largest distance and angle, or a spot is not finite. The next
                search starts upright.
        """
        a, b, c, d, e, f = spots
        # checked first, because numpy warns of non-finite values; squares also catch overflow
        if not math.isfinite(a * a + b * b + c * c + d * d + e * e + f * f):
            raise self._lost(spots)
        self._fill(a, b, c, d, e, f)
        forms = self._forms.dot(self._spots, out=self._products).tolist()
        turning, placing = forms[:30], forms[30:]
        distance, angle = self._limits  # squared
        # fall back to upright if the search from the last rotation fails
        for start in (self._last, _UPRIGHT):
            turn = _turn(turning, start)
            if turn is not None:
                pose = px, py, pz, rx, ry, rz = _pose(placing, turn)
                if px * px + py * py + pz * pz <= distance and rx * rx + ry * ry + rz * rz <= angle:
                    self._last = turn
                    return list(pose)
        raise self._lost(spots)

    def __deepcopy__(self, memo: object) -> Self:
        return copy(self)  # buffers may be shared: every search fills them first

    def reset(self) -> None:
        """Start the next search upright."""
        self._last = _UPRIGHT

    def _lost(self, spots: Sequence[float]) -> SensingError:
        """Reset the search and return the error to raise."""
        self.reset()
        return SensingError(f"no pose found for the spots {_formatted(spots)} m")


def _forms(beams: Beams) -> Array:
    """Return the matrix (60, 7) from six spot coordinates and a 1 to the coefficients of six quadratic forms.

    The first three vanish at the rotation; the others, divided by q . q, are the translation in flotor axes.
    """
    across_beam = np.linalg.svd(beams.directions[:, None])[2][:, 1:]
    linear = across_beam.reshape(6, 3)  # rank 3: `Beams` rejects parallel beams
    without = np.linalg.svd(linear.T)[2][3:]
    # per form and diode: the flotor axis to multiply with the spot
    axes = np.einsum("jki,kia->jka", np.concatenate([without, np.linalg.pinv(linear)]).reshape(6, 3, 2), across_beam)
    spot = np.zeros((3, 7, 3))  # stator axes, per diode: contribution of each spot coordinate and of the 1
    for diode in range(3):
        spot[diode, 2 * diode : 2 * diode + 2] = beams.across[diode]
        spot[diode, 6] = beams.diodes[diode]
    forms = _form(spot, axes[:, :, None]).sum(axis=1)
    forms[:, 6] -= np.einsum("jka,ka->j", axes, beams.leds)[:, None] * _ONE
    return np.ascontiguousarray(forms.swapaxes(1, 2).reshape(60, 7))


def _turn(forms: Sequence[float], start: _Turn, close: float = _CLOSE_ENOUGH) -> _Turn | None:
    """Solve three quadratic forms in (1, g) for g by Newton's method.

    Args:
        forms: Ten entries of each form.
        start: Initial g.
        close: Convergence tolerance of g.

    Returns:
        g; None if it does not converge.
    """
    a0, a1, a2, a3, a4, a5, a6, a7, a8, a9, b0, b1, b2, b3, b4, b5, b6, b7, b8, b9 = forms[:20]
    c0, c1, c2, c3, c4, c5, c6, c7, c8, c9 = forms[20:]
    x, y, z = start
    for _ in range(_MOST_STEPS):
        # half the gradient of each form
        ax, ay, az = a1 + a4 * x + a7 * y + a8 * z, a2 + a7 * x + a5 * y + a9 * z, a3 + a8 * x + a9 * y + a6 * z
        bx, by, bz = b1 + b4 * x + b7 * y + b8 * z, b2 + b7 * x + b5 * y + b9 * z, b3 + b8 * x + b9 * y + b6 * z
        cx, cy, cz = c1 + c4 * x + c7 * y + c8 * z, c2 + c7 * x + c5 * y + c9 * z, c3 + c8 * x + c9 * y + c6 * z
        # values of the forms
        a = a0 + (a1 + ax) * x + (a2 + ay) * y + (a3 + az) * z
        b = b0 + (b1 + bx) * x + (b2 + by) * y + (b3 + bz) * z
        c = c0 + (c1 + cx) * x + (c2 + cy) * y + (c3 + cz) * z
        # three linear equations by cross products
        px, py, pz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
        twice = ax * px + ay * py + az * pz
        if not twice:
            return None
        scale = -0.5 / twice
        dx = scale * (a * px + b * (cy * az - cz * ay) + c * (ay * bz - az * by))
        dy = scale * (a * py + b * (cz * ax - cx * az) + c * (az * bx - ax * bz))
        dz = scale * (a * pz + b * (cx * ay - cy * ax) + c * (ax * by - ay * bx))
        x, y, z = x + dx, y + dy, z + dz
        if -close < dx < close and -close < dy < close and -close < dz < close:
            return x, y, z
    return None


def _pose(forms: Sequence[float], turn: _Turn) -> tuple[float, float, float, float, float, float]:
    """Return the pose [m, rad] of a rotation g, with the `forms` of the translation in flotor axes."""
    a0, a1, a2, a3, a4, a5, a6, a7, a8, a9, b0, b1, b2, b3, b4, b5, b6, b7, b8, b9 = forms[:20]
    c0, c1, c2, c3, c4, c5, c6, c7, c8, c9 = forms[20:]
    x, y, z = turn
    square = x * x + y * y + z * z
    over = 1.0 / (1.0 + square)
    u, v, w = x + x, y + y, z + z
    # the translation in flotor axes
    a = over * (a0 + (a1 + a7 * y) * u + (a2 + a9 * z) * v + (a3 + a8 * x) * w + a4 * x * x + a5 * y * y + a6 * z * z)
    b = over * (b0 + (b1 + b7 * y) * u + (b2 + b9 * z) * v + (b3 + b8 * x) * w + b4 * x * x + b5 * y * y + b6 * z * z)
    c = over * (c0 + (c1 + c7 * y) * u + (c2 + c9 * z) * v + (c3 + c8 * x) * w + c4 * x * x + c5 * y * y + c6 * z * z)
    # rotated into stator axes
    upright, beside, along = (1.0 - square) * over, 2.0 * over, 2.0 * over * (x * a + y * b + z * c)
    # the offset avoids 0/0 and is far below the rounding of any non-zero rotation
    sine = math.sqrt(square) + 1e-300
    angle = 2.0 * (math.atan(sine) / sine)
    return (
        upright * a + beside * (y * c - z * b) + along * x,
        upright * b + beside * (z * a - x * c) + along * y,
        upright * c + beside * (x * b - y * a) + along * z,
        angle * x,
        angle * y,
        angle * z,
    )


def _formatted(values: Sequence[float]) -> str:
    return np.array2string(np.asarray(values), precision=6)


def beams() -> Beams:
    """Return the model's geometry of LEDs and position-sensing diodes.

    Raises:
        ModelError: If the model lacks an LED or diode.
    """
    return _beams(written(MODELS))


@lru_cache(maxsize=1)
def _beams(written: tuple[tuple[str, int], ...]) -> Beams:
    try:
        spec = mujoco.MjSpec.from_file(str(model_path("maglev")))
        model = spec.compile()
        flotor = model.body("flotor").id
        leds, diodes = ([model.site(f"{kind}{arm}").id for arm in range(3)] for kind in ("led", "psd"))
    except (ValueError, KeyError) as error:
        raise invalid_model("maglev", error) from error
    data = reference_state(model)
    centre = data.subtree_com[flotor]
    axes = data.site_xmat.reshape(-1, 3, 3)
    return Beams(
        leds=data.site_xpos[leds] - centre,
        directions=axes[leds][:, :, 2],
        diodes=data.site_xpos[diodes] - centre,
        across=axes[diodes][:, :, :2].swapaxes(1, 2).copy(),
    )


Measure: TypeAlias = Callable[[Six], list[Component]]
"""Function from true to measured pose components."""


class PoseSensor(Protocol):
    """Interface of a pose sensor to a plant."""

    def start(self) -> Measure:
        """Return a measurement function in its initial state, from true to measured pose components."""


class SimulatedSensor:
    """Base class of the package's pose sensors; see `PoseSensor`."""

    remembers: ClassVar = False
    """True if a reading depends on earlier poses, as with hysteresis."""

    def start(self) -> Measure:
        """See `PoseSensor`."""
        raise NotImplementedError


def measuring(sensor: PoseSensor) -> Measure:
    """Start a sensor and return its measurement function.

    Raises:
        ParameterError: If it has no `start`, or `start` does not return a function.
    """
    start = None if isinstance(sensor, type) else getattr(sensor, "start", None)
    measure = start() if callable(start) else None
    if not callable(measure):
        raise ParameterError(f"sensor must have start() that returns a function of six components (got {sensor!r})")
    return measure  # type: ignore[no-any-return]


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class Sensor(SimulatedSensor):
    """Pose sensor with white Gaussian noise and quantization, in this order.

    Args:
        quantum: Resolution, (6,) or a number [m, rad]; 0 for none.
        noise: Standard deviation of the noise, (6,) or a number [m, rad]; independent for each device of a batch.
        seed: Seed of the noise; equal seeds give equal runs.

    Raises:
        ParameterError: If a value is negative or has another shape.

    Example:
        >>> from maglev_mj import ExactPlant, Sensor
        >>> with ExactPlant(pose=[1.4e-5, 0, 0, 0, 0, 0], sensor=Sensor(quantum=1e-5)) as plant:
        ...     measured = plant.read().position[0]
        >>> round(measured, 9)
        1e-05
    """

    quantum: ArrayLike = 0.0
    noise: ArrayLike = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("quantum", "noise"):
            store(self, **{name: six(name, getattr(self, name), finite=True)})
        store(self, seed=whole("seed", self.seed))

    def start(self) -> Measure:
        """Return a measurement function in its initial state, with the noise restarted from the seed."""
        return _electronics(np.asarray(self.quantum).tolist(), self.noise, self.seed)


_WHOLE = 1.5 * 2.0**52
"""Offset for rounding: x + _WHOLE - _WHOLE is x rounded half to even, for |x| < 2**51; NaN and infinity stay."""


def _quantizer(quantum: Sequence[float]) -> Callable[[Iterable[Component]], list[Component]]:
    """Return a function that quantizes six components by six steps [m, rad]; 0 for no quantization.

    Bit-identical to np.rint, except for the sign of zero.
    """
    if not all(quantum):
        return lambda position: [
            (part / step + _WHOLE - _WHOLE) * step if step else part for part, step in zip(position, quantum)
        ]
    x_step, y_step, z_step, rx_step, ry_step, rz_step = quantum

    def quantize(position: Iterable[Component]) -> list[Component]:
        x, y, z, rx, ry, rz = position  # written out for speed: runs on every tick
        return [
            (x / x_step + _WHOLE - _WHOLE) * x_step,
            (y / y_step + _WHOLE - _WHOLE) * y_step,
            (z / z_step + _WHOLE - _WHOLE) * z_step,
            (rx / rx_step + _WHOLE - _WHOLE) * rx_step,
            (ry / ry_step + _WHOLE - _WHOLE) * ry_step,
            (rz / rz_step + _WHOLE - _WHOLE) * rz_step,
        ]

    return quantize


class _Noise:
    """White noise on six components; a copy continues the same sequence.

    For one device many samples are drawn at once; the values are the same.
    """

    def __init__(self, spread: ArrayLike, seed: int) -> None:
        self._spread, self._generator = np.asarray(spread), np.random.default_rng(seed)
        self._drawn, self._next = np.empty((0, 6)), 0

    def __call__(self, position: Six) -> Iterator[Component]:
        """Return six components with the next noise added."""
        if self._next == len(self._drawn):
            shape = np.broadcast_shapes(*map(np.shape, position))
            self._drawn = self._spread * self._generator.standard_normal((1 if shape else 256, *shape, 6))
            self._next = 0
        self._next += 1
        return map(add, position, components(self._drawn[self._next - 1]))


def _electronics(quantum: Sequence[float], noise: ArrayLike, seed: int) -> Measure:
    """Return a function that adds noise and quantizes six components."""
    quantize = _quantizer(quantum)
    return partial(_measured, _Noise(noise, seed), quantize) if np.any(noise) else quantize


def _measured(noise: _Noise, quantize: Callable[[Iterable[Component]], list[Component]], pose: Six) -> list[Component]:
    return quantize(noise(pose))


class SpotReader:
    """Simulated diode electronics of one device: light spots of the true pose, with noise and quantization.

    Args:
        beams: Geometry.
        quantum: Resolution of a spot coordinate [m], or of each, (6,); 0 for none.
        noise: Standard deviation of the white Gaussian noise on a spot coordinate, before quantization [m].
        seed: Seed of the noise; equal seeds give equal runs.

    Attributes:
        read: Function that adds noise and quantization to six spot coordinates, also of a batch.

    Raises:
        ParameterError: If a value is negative.
    """

    def __init__(
        self, beams: Beams | PoseScale, quantum: ArrayLike = 0.0, noise: ArrayLike = 0.0, seed: int = 0
    ) -> None:
        self._beams = beams if isinstance(beams, PoseScale) else FastBeams(beams)
        steps, spread = (six(name, value, finite=True) for name, value in (("quantum", quantum), ("noise", noise)))
        self.read = _electronics(steps.tolist(), spread if np.ndim(noise) else float(spread[0]), whole("seed", seed))

    def __call__(self, pose: Sequence[float]) -> list[float]:
        """Return six measured spot coordinates [m] for a true pose, six floats [m, rad].

        Raises:
            SensingError: If a beam is parallel to its diode, or the pose is not finite.
        """
        return self.read(self._beams.spots(pose))


@checked
@dataclass(frozen=True, kw_only=True, eq=False)
class SpotSensor(SimulatedSensor):
    """Optical pose sensor of the device: light spots with noise and quantization, and the pose computed from them.

    Uses `SpotReader` and `PoseTracker` for one device, `Beams` for a batch.

    Args:
        beams: Geometry; that of the model by default.
        quantum: Resolution of a spot coordinate [m]; 0 for none.
        noise: Standard deviation of the white Gaussian noise on a spot coordinate, before quantization [m]; independent
            for each device of a batch.
        seed: Seed of the noise; equal seeds give equal runs.

    Raises:
        ParameterError: If a value is negative.

    Example:
        >>> from maglev_mj import ExactPlant, SpotSensor
        >>> with ExactPlant(pose=[1e-3, 0, 0, 0, 0, 0], sensor=SpotSensor(quantum=5e-6)) as plant:
        ...     measured = plant.read().position[0]
        >>> abs(measured - 1e-3) < 1e-5
        True
    """

    beams: Beams | None = None
    quantum: float = 0.0
    noise: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("quantum", "noise"):
            number(name, getattr(self, name), at_least=0.0)
        store(self, seed=whole("seed", self.seed))

    def start(self) -> Measure:
        """Return a measurement function in its initial state.

        It raises SensingError if no pose matches the spots, and for one device also above a quarter turn.
        """
        geometry = self.beams or beams()
        reader = SpotReader(geometry, self.quantum, self.noise, self.seed)
        # the distance is checked by the plant (`escape`); spots determine the pose within a quarter turn
        tracker = PoseTracker(geometry, farthest=math.inf, most_turned=0.5 * math.pi)
        return partial(_sensed, tracker, reader, _batch_measure(geometry, reader.read))


def _batch_measure(geometry: Beams, read: Measure) -> Measure:
    """Return the measurement function of a batch."""
    last: Array | None = None

    def measure(position: Six) -> list[Component]:
        nonlocal last
        last = geometry.pose(join(read(components(geometry.spots(join(position))))), last)
        return components(last)

    return measure


def _sensed(tracker: PoseTracker, reader: SpotReader, batch: Measure, position: Six) -> list[Component]:
    return tracker(reader(position)) if join(position).ndim == 1 else batch(position)
