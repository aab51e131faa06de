"""Numerical linearisation of any controller from its response to a small displacement, and its closed loop."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from maglev_mj.control import LinearController
from maglev_mj.control.controller import Controller
from maglev_mj.errors import MaglevError, check_instance, require
from maglev_mj.frames import AXES, Array, Mask, Sample, components, unit_of
from maglev_mj.parameters import axis_indices, numbers
from maglev_mj.pictures import save
from maglev_mj.plants.hand import Hand
from maglev_mj.result import Result, Table
from maglev_mj.spec import INERTIA
from maglev_mj.theory.closed_loop import SampledLoop, loop_matrix

_SPEED = np.array([2e-5] * 3 + [2e-4] * 3)
"""Largest speed of a test displacement [m/s, rad/s], far below the speed of sticking friction."""
_LARGEST = np.array([1e-7] * 3 + [1e-6] * 3)
"""Largest test displacement [m, rad]."""
_REST, _MEMORY, _LONGEST, _QUIET = 40, 64, 512, 8
"""Samples at rest before the displacement, recorded after it (initially and at most), and zero at the end."""
_CUT, _BENT = 1e-9, 1e-3
"""Thresholds of zero and of nonlinearity, relative to the largest response."""
_RANK, _FIT, _MOST, _INTEGRATES = 1e-7, 1e-6, 24, 1e-7
"""Realisation: least singular value, largest error, most states, and distance of an integrator's pole from 1.

Responses are accurate to 1e-9 of their largest value.
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class Linearised(Result):
    """Controller linearised at a pose.

    Attributes:
        pose: Pose [m, rad], (6,).
        period: Sample period [s].
        response: Wrench at sample j after a unit displacement at sample 0 alone, (M, 6, 6): [j, to, from].
        jumps: True for axes on which the wrench or its slope is discontinuous at the pose, (6,).
        settled: True for axes whose impulse response decays within 512 samples, (6,).
    """

    pose: Array
    period: float
    response: Array
    jumps: Mask
    settled: Mask
    units: ClassVar = {"time": "s"} | {
        f"{to}.{source}": f"{unit_of('N', to)}/{unit_of('m', source)}" for to in AXES for source in AXES
    }

    def columns(self) -> dict[str, Array]:
        """Return time and each nonzero response, (M,) each; `z.x` is the force along z per displacement along x."""
        count = len(self.response)
        columns: dict[str, Array] = {"time": np.linspace(0.0, (count - 1) * self.period, count)}
        for to, source in zip(*np.nonzero(self.response.any(axis=0))):
            columns[f"{AXES[to]}.{AXES[source]}"] = self.response[:, to, source]
        return columns

    def plot(self, path: Path | str | None = None) -> Any:
        """Draw the wrench after a unit displacement at one sample; see `Result.plot`."""
        from maglev_mj.theory.pictures import impulse_response

        return save(impulse_response(self), path)

    def table(self) -> Table:
        """Return stiffness and damping of each axis."""
        gains = zip(AXES, np.diag(self.stiffness).tolist(), np.diag(self.damping).tolist(), self.jumps, self.settled)
        head = "axis", "stiffness [N/m, N m/rad]", "damping [N s/m, N m s/rad]", "discontinuous", "settled"
        rows = [(*row[:3], *("yes" if part else "no" for part in row[3:])) for row in gains]
        return Table(f"linearised controller, {1.0 / self.period:g} Hz", head, rows)

    @property
    def stiffness(self) -> Array:
        """Static stiffness [N/m, N/rad, N, N m/rad], (6, 6): [to, from]."""
        return np.asarray(-self.response.sum(axis=0))

    @property
    def damping(self) -> Array:
        """Damping of slow motion [N s/m, N s/rad, N s, N m s/rad], (6, 6), reduced by lags such as a filter's."""
        age = np.arange(len(self.response))[:, None, None]
        return np.asarray(self.period * (age * self.response).sum(axis=0))

    def scaled(self, inertia: ArrayLike = INERTIA) -> Array:
        """Return the dimensionless response T² response / sqrt(inertia inertia), (M, 6, 6)."""
        root = np.sqrt(np.asarray(inertia, dtype=np.float64))
        return np.asarray(self.period**2 * self.response / np.outer(root, root))

    def closed_loop(
        self, *, delay: float, inertia: ArrayLike = INERTIA, axes: str | Sequence[str] | None = None
    ) -> ClosedLoop:
        """Return the closed loop of flotor and linearised controller.

        Args:
            delay: Transport delay [s], up to 10 periods.
            inertia: Mass and moments of inertia [kg, kg m²], (6,).
            axes: Names from AXES, as one loop; all six by default.

        Raises:
            ParameterError: If a value is outside its bounds.
        """
        chosen = list(range(6)) if axes is None else list(axis_indices(axes))
        body = numbers("inertia", inertia, shape="(6,)", at_least=0.0)[chosen]
        response = self.response[:, chosen][:, :, chosen]
        matrix = StateSpace.of(response).closed_loop(period=self.period, delay=delay, inertia=body)
        n, size = len(chosen), len(matrix)
        moved, sped = np.diag(0.5 * self.period**2 / body), np.diag(self.period / body)
        return ClosedLoop(matrix, np.vstack([moved, sped, np.zeros((size - 2 * n, n))]), np.eye(n, size), self.period)

    def to_statespace(self) -> Any:
        """Return the controller as python-control's StateSpace, from six positions to six wrench components.

        Its states are the previous positions, newest first.

        Raises:
            MissingPackageError: If python-control is not installed.
        """
        none = max(2 - len(self.response), 0)
        return _statespace(*StateSpace.of(np.pad(self.response, ((0, none), (0, 0), (0, 0)))), self.period)


@dataclass(frozen=True, eq=False)
class ClosedLoop(Result):
    """Closed loop as a discrete-time state-space system.

    s[k+1] = matrix s[k] + enters w[k]; position[k] = seen s[k], with a wrench w constant from sample to sample.

    Attributes:
        matrix: (S, S).
        enters: Input matrix of an external wrench, such as a hand's, (S, n).
        seen: Output matrix of the position, (n, S).
        period: Sample period [s].
    """

    matrix: Array
    enters: Array
    seen: Array
    period: float
    units: ClassVar = {"frequency": "Hz"}

    @property
    def eigenvalues(self) -> NDArray[np.complex128]:
        """Poles: eigenvalues of the matrix, in descending magnitude, (S,)."""
        poles = np.linalg.eigvals(self.matrix).astype(np.complex128)
        return poles[np.argsort(-np.abs(poles))]

    @property
    def spectral_radius(self) -> float:
        """Largest magnitude of the poles; below 1 the loop is stable."""
        return float(np.abs(self.eigenvalues[0]))

    def columns(self) -> dict[str, Array]:
        """Return the poles in descending magnitude, (S,) each."""
        poles = self.eigenvalues
        frequency = np.abs(np.angle(poles)) / (2.0 * np.pi * self.period)
        return {"real": poles.real, "imaginary": poles.imag, "magnitude": np.abs(poles), "frequency": frequency}

    def plot(self, path: Path | str | None = None) -> Any:
        """Draw the poles and the unit circle; see `Result.plot`."""
        from maglev_mj.theory.pictures import pole_map

        return save(pole_map(self), path)

    def table(self) -> Table:
        """Return the first poles."""
        word = "stable" if self.spectral_radius < 1.0 else "unstable"
        return super().table()._replace(title=f"closed loop: {word}, spectral radius {self.spectral_radius:.3f}")

    def to_statespace(self) -> Any:
        """Return python-control's StateSpace, from an external wrench to the position.

        Raises:
            MissingPackageError: If python-control is not installed.
        """
        return _statespace(
            self.matrix, self.enters, self.seen, np.zeros((len(self.seen), self.enters.shape[1])), self.period
        )


class StateSpace(LinearController):
    """Linear controller of n coupled axes.

    Take is (..., s, n), give (..., n, s) and direct (..., n, n). In dimensionless form positions are multiplied by
    sqrt(inertia), forces by T²/sqrt(inertia).
    """

    @classmethod
    def of(cls, response: Array) -> StateSpace:
        """Return the controller with this impulse response; its states are the previous positions, newest first.

        Args:
            response: Force at sample j after a unit displacement at sample 0 alone, (..., M, n, n): [j, to, from].
        """
        memory, n = response.shape[-3:-1]
        size = n * (memory - 1)
        give = np.moveaxis(response[..., 1:, :, :], -3, -2).reshape(*response.shape[:-3], n, size)
        return cls(np.eye(size, k=-n), np.eye(size, n), give, response[..., 0, :, :])

    def with_units(self, period: float, inertia: Array) -> StateSpace:
        """Return the controller in SI units, from a period [s] and inertia [kg, kg m²], (n,)."""
        root = np.sqrt(inertia)
        size = root[:, None] / period**2
        return StateSpace(self.advance, self.take * root, self.give * size, self.direct * size * root)

    def moments(self) -> tuple[Array, Array]:
        """Return the sums of the response and of age times response, (n, n) each.

        The first is infinite if the controller integrates.
        """
        still = np.eye(len(self.advance)) - self.advance
        if (np.abs(np.linalg.eigvals(still)) < _INTEGRATES).any():
            return np.full_like(self.direct, -np.inf), np.zeros_like(self.direct)
        once = np.linalg.solve(still, self.take)
        return self.direct + self.give @ once, self.give @ np.linalg.solve(still, once)

    def closed_loop(self, *, period: float, delay: float, inertia: Array, hand: Hand | None = None) -> Array:
        """Return the closed loop's matrix; see `loop_matrix`.

        Args:
            period: Sample period [s].
            delay: Transport delay [s], up to 10 periods.
            inertia: Mass or moments of inertia [kg, kg m²], (n,).
            hand: Hand on each of the axes; None for a free flotor.
        """
        phi, old, new, whole, waiting = SampledLoop(period=period, delay=delay, mass=inertia, hand=hand).flotor()
        states = range(phi.shape[-1])
        body = np.block([[np.diag(phi[:, row, column]) for column in states] for row in states])
        before, after = (np.vstack([np.diag(part[:, row]) for row in states]) for part in (old, new))
        return loop_matrix(body, before, after, whole, waiting, *self)


def linearise(controller: Controller, poses: ArrayLike) -> list[Linearised]:
    """Return a controller's linearisation at each pose.

    Thirteen copies per pose, one undisturbed and two for each axis, rest there for 40 samples, so that friction sticks
    and filters settle. Then one coordinate is displaced for one sample, by at most 0.1 µm or 1 µrad in one direction
    and half of that in the other. The difference of the wrenches is the impulse response, for any laws and estimator.
    Braking pulses are ignored, because they are of finite duration.

    Args:
        controller: The controller, with laws for one device; it is not changed.
        poses: Poses [m, rad], (P, 6) or (6,).

    Raises:
        ParameterError: If `controller` is not a Controller, or the poses have another shape.
        MaglevError: If a law fails at a pose.

    Example:
        >>> import numpy as np
        >>> from maglev_mj import Controller, Hold, linearise
        >>> controller = Controller([Hold(axes="z", stiffness=6000.0, damping=80.0)], period=0.005)
        >>> near = linearise(controller, np.zeros((1, 6)))[0]
        >>> round(near.stiffness[2, 2]), round(near.damping[2, 2])
        (6000, 80)
    """
    check_instance("controller", controller, Controller, "a Controller")
    rest = np.atleast_2d(numbers("poses", poses, shape="(6,) or (P, 6)"))
    size = np.minimum(_LARGEST, _SPEED * controller.period)
    shift = np.zeros((13, 6))
    shift[1:7], shift[7:] = np.diag(size), np.diag(-0.5 * size)
    still = np.repeat(rest, 13, axis=0)
    moved = still + np.tile(shift, (len(rest), 1))
    rows = _responses(controller, still, moved)
    # the actual change of a coordinate, rounding included
    change, axes, linearised = (moved - still).reshape(len(rest), 13, 6), np.arange(6), []
    for index, pose in enumerate(rest):
        forces = rows[:, index]
        difference = forces[:, 1:] - forces[:, :1]
        up, down = difference[:, :6].swapaxes(1, 2), difference[:, 6:].swapaxes(1, 2)  # [j, to, from]
        step, back = change[index, 1 + axes, axes], change[index, 7 + axes, axes]
        linearised.append(_near(pose, controller.period, up / step, down / back))
    length = 1 + max(np.flatnonzero(near.response.any(axis=(1, 2))).max(initial=0) for near in linearised)
    return [replace(near, response=near.response[:length]) for near in linearised]


def _near(pose: Array, period: float, up: Array, down: Array) -> Linearised:
    """Return the linearisation from the responses to a displacement and to minus half of it, per unit."""
    finite = np.isfinite(up).all(axis=(0, 1)) & np.isfinite(down).all(axis=(0, 1))
    up, down = np.where(finite, up, 0.0), np.where(finite, down, 0.0)
    root = np.sqrt(np.asarray(INERTIA))
    weight = 1.0 / np.outer(root, root)
    # exact to second order in the displacement
    response = (up + 2.0 * down) / 3.0
    gap = np.abs(up - down)
    largest = (weight * np.abs(response)).max(axis=(0, 1))
    jumps = (weight * gap).max(axis=(0, 1)) > _BENT * largest
    # a response that shrinks with the displacement, such as the creep of a bristle, vanishes in the limit
    least = np.maximum(_CUT * largest / weight, np.where(jumps, 0.0, 2.0 * gap))
    response = np.where(np.abs(response) > least, response, 0.0)
    quiet = ~response[-_QUIET:].any(axis=(0, 1))
    return Linearised(pose=pose, period=period, response=response, jumps=jumps, settled=np.asarray(finite & quiet))


def _responses(controller: Controller, still: Array, moved: Array) -> Array:
    """Return the wrenches of each pose's thirteen devices from the displaced sample on, (M, P, 13, 6)."""
    # a law may respond with a delay: the first pose gives the number of samples
    rows = _steps(controller, still[:13], moved[:13], _LONGEST)
    if len(still) == 13:
        return rows
    memory = min(max(_MEMORY, np.flatnonzero(_alive(rows)).max(initial=0) + 1 + _QUIET), _LONGEST)
    rows = _steps(controller, still, moved, memory)
    if memory < _LONGEST and _alive(rows)[-_QUIET:].any():
        rows = _steps(controller, still, moved, _LONGEST)
    return rows


def _alive(rows: Array) -> Mask:
    """Return True for samples at which a displaced device differs from the undisturbed one, (M,)."""
    with np.errstate(invalid="ignore"):
        gap = np.abs(rows - rows[:, :, :1])
        return np.asarray((~(gap <= _CUT * gap.max(axis=0))).any(axis=(1, 2, 3)))


def _steps(controller: Controller, still: Array, moved: Array, memory: int) -> Array:
    """Return the wrenches of N devices, as one batch, or one by one if a law does not accept arrays."""
    try:
        rows = _batch(controller, components(still), components(moved), memory, len(still))
        single = _batch(controller, still[-1].tolist(), moved[-1].tolist(), memory, 1)
        with np.errstate(invalid="ignore"):
            differs = np.abs(rows[:, -1:] - single) > _CUT * np.abs(single).max(initial=1e-300)
        batched = not differs.any()
    except (MaglevError, TypeError, ValueError):  # a law that accepts floats only, as with math.sin or `if`
        batched = False
    if not batched:
        each = (_batch(controller, *ends, memory, 1) for ends in zip(still.tolist(), moved.tolist(), strict=True))
        rows = np.concatenate(list(each), axis=1)
    return rows.reshape(memory, -1, 13, 6)


def _batch(controller: Controller, still: Sequence[Any], moved: Sequence[Any], memory: int, count: int) -> Array:
    """Return the wrench at each sample, (M, N, 6)."""
    copied, rows = copy.copy(controller), np.empty((memory, count, 6))
    copied.reset()
    for tick in range(-_REST, memory):
        force = copied.step(Sample(tick, 0.0, moved if tick == 0 else still)).force
        if tick >= 0:
            for axis, part in enumerate(force):
                rows[tick, :, axis] = part
    return rows


def realise(response: Array) -> StateSpace | None:
    """Return the minimal realisation of an impulse response by Ho and Kalman's method; None above 24 states.

    The rank of the block Hankel matrix is the number of states.

    Args:
        response: Force at sample j after a unit displacement at sample 0 alone, (M, n, n): [j, to, from].
    """
    direct, later = response[0], response[1:]
    half, n = len(later) // 2, response.shape[1]
    hankel = np.block([[later[row + column] for column in range(half)] for row in range(half)])
    to, sizes, source = np.linalg.svd(hankel)
    states = int((sizes > _RANK * sizes[0]).sum())
    if states > _MOST:
        return None
    root = np.sqrt(sizes[:states])
    observability, controllability = to[:, :states] * root, root[:, None] * source[:states]
    advance = np.linalg.lstsq(observability[:-n], observability[n:], rcond=None)[0]
    state, error = controllability[:, :n], 0.0
    with np.errstate(over="ignore", invalid="ignore"):  # of an unstable system
        for answer in later:
            error = max(error, float(np.abs(observability[:n] @ state - answer).max()))
            state = advance @ state
    if not error <= _FIT * np.abs(response).max():
        return None
    return StateSpace(advance, controllability[:, :n], observability[:n], direct)


def _statespace(*system: Any) -> Any:
    require(("control",), "control", "to_statespace() needs python-control")
    import control

    return control.ss(*system)
