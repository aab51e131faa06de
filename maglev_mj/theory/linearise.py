"""Numerical linearisation of any controller from its response to a small displacement, and its closed loop."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from maglev_mj.control import AxisLaw, LinearController
from maglev_mj.control.controller import Controller
from maglev_mj.control.stack import stacked_controller
from maglev_mj.errors import MaglevError, TooManyCallsError, named, require
from maglev_mj.frames import AXES, Array, Mask, Sample, components, unit_of
from maglev_mj.keywords import checked
from maglev_mj.parameters import axis_indices, number, numbers, six
from maglev_mj.plants.hand import Hand, transition
from maglev_mj.result import Result, Table, conditions_text, radius_text
from maglev_mj.spec import INERTIA
from maglev_mj.theory.delay import AnyCutOf, CoupledCut
from maglev_mj.theory.loop_array import LoopArray, is_linear, loop_matrix

# -- test displacement
_LARGEST_SPEED = np.array([2e-5] * 3 + [2e-4] * 3)
"""Largest speed of a test displacement [m/s, rad/s]; friction slides from 0.4 mm/s on in a test."""
_LARGEST_DISPLACEMENT = np.array([1e-7] * 3 + [1e-6] * 3)
"""Largest test displacement [m, rad]: at a hundredth of it, rounding hides the response of a virtual mass."""
SAMPLES_AT_REST = 40
"""Samples at rest before the displacement, in which friction sticks and filters settle; two are too few."""

# -- response
_FIRST_SAMPLES, _MOST_SAMPLES = 64, 512
"""Samples recorded after the displacement at first, and at most; effort alone below that, as all are zero."""
_SAMPLES_OF_ZERO = 8
"""Samples of zero at the end of a response that has decayed: a law may answer late, or at every few samples alone."""
_MOST_CALLS = 50_000
"""Largest number of calls of one controller; a time would refuse it on a busy machine alone."""
_PHASES = 64
"""Positions within one count of a law with a resolution: a mean to 1 %."""
_POSES_AT_ONCE = 2 * _PHASES
"""Poses whose responses are computed at once; limits memory alone."""
ROUNDING_OF_RESPONSE = 1e-9
"""Response that is zero, relative to the largest one: rounding of a difference of forces by 0.1 µm."""
_NONLINEAR_RESPONSE = 1e-2
"""Difference of the responses to both sides that marks a jump of the force or of its slope, relative to the largest."""

_SMALL_COUNTS = 30.0
"""Amplitude in counts up to which a law in fixed point is compared with ten times the amplitude, above with a tenth."""
_RESIDUE = 3.0
"""Largest ratio of the forces left after displacements in the ratio of 10 that is a residue: an integrator has 10."""

# -- realisation; responses are accurate to 1e-9 of their largest value
_LEAST_SINGULAR_VALUE = 1e-7
"""Least singular value of a state, relative to the largest: smaller ones are rounding."""
_ERROR_OF_REALISATION = 1e-6
"""Largest error of the response of a realisation, relative to the largest one; above, it is no linear system."""
MOST_SAMPLES_AS_STATES = 16
"""Longest response whose samples themselves are the states: a longer one is realised, as its end would add poles."""
_MOST_STATES, _MOST_ROWS = 24, 64
"""Most states, and rows of the Hankel matrix, of which the states need one each; limits effort."""
INTEGRATOR_POLE = 1e-7
"""Distance from 1 of a pole that integrates: a decay slower than in 1e7 samples counts as integration."""


def pose_text(pose: Sequence[float] | Array) -> str:
    """Return a pose [m, rad], (6,), in words."""
    parts = [f"{axis} = {1e3 * x:.3g} {unit_of('mm', axis)}" for axis, x in zip(AXES, pose) if x]
    return f"at {', '.join(parts) or 'the centre'}"


@dataclass(frozen=True, kw_only=True, eq=False)
class Linearised(Result):
    """Controller linearised at a pose.

    Attributes:
        pose: Pose [m, rad], (6,).
        amplitude: Displacement from which the response was computed, and for which it holds [m, rad], (6,).
        resolution: Resolution of the laws over which it is a mean [m, rad]; 0 for none.
        period: Sample period [s].
        response: Wrench at sample j after a unit displacement at sample 0 alone, (M, 6, 6): [j, to, from].
        jumps: True for axes on which the wrench or its slope is discontinuous at the pose, (6,).
        settled: True for axes whose impulse response decays within 512 samples, (6,).
    """

    pose: Array
    amplitude: Array
    resolution: float
    period: float
    response: Array
    jumps: Mask
    settled: Mask
    units: ClassVar = {"time": "s"} | {
        f"{to}.{source}": f"{unit_of('N', to)}/{unit_of('m', source)}" for to in AXES for source in AXES
    }
    pictures: ClassVar = {"impulse_response": "maglev_mj.theory.pictures:impulse_response"}

    def _headline(self) -> str:
        stiffness = np.diag(self.stiffness)[:3]
        axis = int(np.argmax(np.nan_to_num(np.abs(stiffness), nan=-1.0)))
        known = math.isfinite(stiffness[axis]) and self.settled[axis]
        size = f"{stiffness[axis]:.4g} N/m" if known else "stiffness not computed: the response does not decay"
        return f"Stiffest translation: {AXES[axis]}, {size}"

    @property
    def conditions(self) -> str:
        """See `Result`."""
        acts = np.asarray(self.response.any(axis=(0, 1)))
        return conditions_text(
            f"controller {pose_text(self.pose)}", compress(AXES, acts) if acts.any() else AXES, [self.period], ()
        )

    def columns(self) -> dict[str, Array]:
        """Return time and each nonzero response, (M,) each; `z.x` is the force along z per displacement along x."""
        count = len(self.response)
        columns: dict[str, Array] = {"time": np.linspace(0.0, (count - 1) * self.period, count)}
        for to, source in zip(*np.nonzero(self.response.any(axis=0))):
            columns[f"{AXES[to]}.{AXES[source]}"] = self.response[:, to, source]
        return columns

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
            delay: Transport delay [s], up to 1000 periods.
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
        enters, seen = np.vstack([moved, sped, np.zeros((size - 2 * n, n))]), np.eye(n, size)
        return ClosedLoop(matrix, enters, seen, self.period, delay, tuple(AXES[index] for index in chosen))

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
        delay: Transport delay [s].
        axes: Names of its axes.
    """

    matrix: Array
    enters: Array
    seen: Array
    period: float
    delay: float
    axes: tuple[str, ...]
    units: ClassVar = {"frequency": "Hz"}
    pictures: ClassVar = {"poles": "maglev_mj.theory.pictures:pole_map"}

    def _headline(self) -> str:
        word = "stable" if self.spectral_radius < 1.0 else "unstable"
        return f"Closed loop at {1.0 / self.period:g} Hz: {word}, {radius_text(self.spectral_radius)}"

    @property
    def conditions(self) -> str:
        """See `Result`."""
        return conditions_text("closed loop", self.axes, [self.period], [self.delay])

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

    def single(self, stiffness: Array, damping: Array, period: Array) -> LinearController:
        """Return the controllers of one axis with given indices, as a `Design` whose stiffness is the index."""
        rows = np.asarray(stiffness).astype(int) + 0 * np.asarray(damping).astype(int)
        advance, take, give, direct = (part[rows] for part in self)
        return LinearController(advance, take[..., 0], give[..., 0, :], direct[..., 0, 0])

    def moments(self) -> tuple[Array, Array]:
        """Return the sums of the response and of age times response, (n, n) each.

        The first is infinite if the controller integrates.
        """
        still = np.eye(len(self.advance)) - self.advance
        if (np.abs(np.linalg.eigvals(still)) < INTEGRATOR_POLE).any():
            return np.full_like(self.direct, -np.inf), np.zeros_like(self.direct)
        once = np.linalg.solve(still, self.take)
        return self.direct + self.give @ once, self.give @ np.linalg.solve(still, once)

    def closed_loop(
        self, *, period: float, delay: float, inertia: Array, hand: Hand | None = None, driver_lag: float = 0.0
    ) -> Array:
        """Return the closed loop's matrix; see `loop_matrix`.

        Args:
            period: Sample period [s].
            delay: Transport delay [s], up to 1000 periods.
            inertia: Mass or moments of inertia [kg, kg m²], (n,).
            hand: Hand on each of the axes; None for a free flotor.
            driver_lag: Time constant of the drivers [s].
        """
        around: Any = {"period": period, "delay": delay, "hand": hand, "driver_lag": driver_lag}
        phi, old, new, whole, waiting = LoopArray(mass=inertia, **around).flotor
        states = range(phi.shape[-1])
        body = np.block([[np.diag(phi[:, row, column]) for column in states] for row in states])
        before, after = (np.vstack([np.diag(part[:, row]) for row in states]) for part in (old, new))
        return loop_matrix(body, before, after, whole, waiting, *self)

    def cuts(self, *, period: float, inertia: Array, hand: Hand | None = None, driver_lag: float = 0.0) -> AnyCutOf:
        """Return the loop cut at the host's commands as `AnyCutOf`, for any index; arguments as for `closed_loop`."""
        a, b = LoopArray(mass=inertia, period=period, delay=0.0, hand=hand, driver_lag=driver_lag).motion()
        whole, _ = transition(a, b[..., :1], period)

        def cut_of(_: Any, fractions: Array) -> CoupledCut:
            late = period * fractions[:, None]
            (_, early), (after, new) = (transition(a, b[..., :1], time) for time in (late, period - late))
            return CoupledCut(whole, (after @ early)[..., 0], new[..., 0], (*self,))

        return cut_of


@checked
def linearise(
    controller: Controller | Sequence[Controller],
    poses: ArrayLike,
    *,
    axes: str | Sequence[str] = AXES,
    amplitude: ArrayLike | None = None,
    resolution: float = 0.0,
) -> list[Linearised]:
    """Return a controller's linearisation at each pose.

    Thirteen copies per pose, one undisturbed and two for each axis, rest there for 40 samples, so that friction sticks
    and filters settle. Then one coordinate is displaced for one sample, by at most 0.1 µm or 1 µrad in one direction
    and half of that in the other; for laws that act on each axis alone, all coordinates of three copies. The difference
    of the wrenches is the impulse response, for any laws and estimator. Braking pulses are ignored, because they are of
    finite duration.

    A law in fixed point has no response to 0.1 µm. With an amplitude the displacements are that to both sides, and the
    response is the mean of both; with a resolution, the mean over 64 positions within one count, too.

    Args:
        controller: The controller, with laws for one device, or one for each pose, of equal period; none is changed.
        poses: Poses [m, rad], (P, 6) or (6,).
        axes: Names of the displaced axes; the response to the others is zero.
        amplitude: Displacement to both sides, a number or one for each axis [m, rad], (6,); None for the smallest.
        resolution: Resolution of the laws on the displaced axes [m, rad]; 0 for one position alone.

    Raises:
        ParameterError: If `controller` is not a Controller, the poses have another shape, or a size is not above 0.
        TooManyCallsError: If a controller would be called more than 50 000 times.
        MaglevError: If a law fails at a pose.

    Example:
        >>> import numpy as np
        >>> from maglev_mj import Controller, Hold, linearise
        >>> controller = Controller([Hold(axes="z", stiffness=6000.0, damping=80.0)], period=0.005)
        >>> near = linearise(controller, np.zeros((1, 6)))[0]
        >>> round(near.stiffness[2, 2]), round(near.damping[2, 2])
        (6000, 80)
    """
    rest = np.atleast_2d(numbers("poses", poses, shape="(6,) or (P, 6)"))
    each = [controller] * len(rest) if isinstance(controller, Controller) else controller
    chosen, period = list(axis_indices(axes)), each[0].period
    number("resolution", resolution, at_least=0.0, unit="m, rad")
    size, back = np.minimum(_LARGEST_DISPLACEMENT, _LARGEST_SPEED * period), 0.5
    if amplitude is not None:
        size, back = six("amplitude", numbers("amplitude", amplitude, above=0.0, unit="m, rad")), 1.0
    around: Any = {"poses": rest, "chosen": chosen, "back": back, "resolution": float(resolution)}
    linearised = _linearised(each, size=size, **around)
    if resolution and not all(near.settled.all() for near in linearised):
        ratio = np.where(size > _SMALL_COUNTS * resolution, 0.1, 10.0)
        others = _linearised(each, size=ratio * size, **around)
        linearised = [_without_residue(near, other) for near, other in zip(linearised, others, strict=True)]
    length = 1 + max(np.flatnonzero(near.response.any(axis=(1, 2))).max(initial=0) for near in linearised)
    return [replace(near, response=near.response[:length]) for near in linearised]


def _linearised(
    each: Sequence[Controller], *, poses: Array, chosen: list[int], size: Array, back: float, resolution: float
) -> list[Linearised]:
    """Return each controller's linearisation at its pose, for displacements by `size` and by -back times that."""
    phases, period, n = np.arange(0.5, _PHASES) / _PHASES if resolution else np.zeros(1), each[0].period, len(chosen)
    count = len(phases)
    rest, each = np.repeat(poses, count, axis=0), [one for one in each for _ in phases]
    rest[:, chosen] += np.tile(resolution * phases, len(poses))[:, None]
    alone = all(map(acts_on_each_axis_alone, {id(one): one for one in each}.values()))
    places = np.zeros(n, dtype=int) if alone else np.arange(n)  # of the displaced copies, by axis
    moves = np.zeros((1 if alone else n, 6))
    moves[places, chosen] = size[chosen]
    shift = np.concatenate([np.zeros((1, 6)), moves, -back * moves])
    still = np.repeat(rest[:, None], len(shift), axis=1)
    moved = still + shift
    rows = _Responses(each, still, moved).rows()
    change, linearised = moved - still, list[Linearised]()  # the actual change of a coordinate, rounding included
    for first in range(0, len(rest), _POSES_AT_ONCE):
        some = slice(first, first + _POSES_AT_ONCE)
        difference = np.moveaxis(rows[:, some, 1:] - rows[:, some, :1], [0, 3], [1, 2])  # [pose, j, to, from]
        both = list[Array]()
        for copies in (places, len(moves) + places):
            response = np.zeros((*difference.shape[:2], 6, 6))
            steps = change[some, 1 + copies, chosen]
            response[..., chosen] = difference[..., copies] / steps[:, None, None]
            response = response.reshape(-1, count, *response.shape[1:]).mean(axis=1)
            both.append(response * np.eye(6) if alone else response)
        up, down = both
        some = slice(first // count, (first + _POSES_AT_ONCE) // count)
        linearised += _near(poses[some], up, down, back, amplitude=size, resolution=resolution, period=period)
    return linearised


def _without_residue(near: Linearised, other: Linearised) -> Linearised:
    """Return a linearisation without what a filter in fixed point keeps for good, as its last step rounds to none.

    The force left at the end hardly depends on the amplitude then; that of an integrator is proportional to it.

    Args:
        near: The linearisation.
        other: One at another amplitude.
    """
    left, beside = (np.abs(one.response[-1]) * one.amplitude for one in (near, other))
    if (np.maximum(left, beside) > _RESIDUE * np.minimum(left, beside)).any():
        return near
    steps = np.abs(np.diff(near.response, axis=0)) > ROUNDING_OF_RESPONSE * np.abs(near.response).max()
    response = near.response.copy()
    response[1 + int(np.flatnonzero(steps.any(axis=(1, 2))).max(initial=0)) :] = 0.0
    return replace(near, response=response, settled=np.ones(len(AXES), dtype=np.bool_))


def acts_on_each_axis_alone(controller: Controller) -> bool:
    """Return True if the force on each axis is a function of the motion on that axis alone."""
    return is_linear(controller.velocity) and all(
        isinstance(law, AxisLaw) and not getattr(law, "coupled", False) and is_ours(type(law).__call__)
        for law in controller.laws
    )


def is_ours(item: Any) -> bool:
    """Return True for a class or function of this package."""
    return bool(item.__module__.partition(".")[0] == "maglev_mj")


def _near(poses: Array, up: Array, down: Array, back: float, **sizes: Any) -> Iterator[Linearised]:
    """Yield the linearisation at each pose from the responses to a displacement and to that times -back, per unit."""
    finite = np.asarray(np.isfinite(up).all(axis=(1, 2)) & np.isfinite(down).all(axis=(1, 2)))
    up, down = (np.where(finite[:, None, None], one, 0.0) for one in (up, down))
    root = np.sqrt(np.asarray(INERTIA))
    weight = 1.0 / np.outer(root, root)
    response = (back * up + down) / (1.0 + back)  # exact to second order in the displacement
    gap = np.abs(up - down)
    largest = (weight * np.abs(response)).max(axis=(1, 2))
    jumps = np.asarray((weight * gap).max(axis=(1, 2)) > _NONLINEAR_RESPONSE * largest)
    # a response that shrinks with the displacement, such as the creep of a bristle, vanishes in the limit
    vanishing = np.where(jumps[:, None, None] | (back == 1.0), 0.0, 2.0 * gap)
    least = np.maximum(ROUNDING_OF_RESPONSE * largest[:, None, None] / weight, vanishing)
    response = np.where(np.abs(response) > least, response, 0.0)
    settled = np.asarray(finite & ~response[:, -_SAMPLES_OF_ZERO:].any(axis=(1, 2)))
    for parts in zip(poses, response, jumps, settled, strict=True):
        yield Linearised(pose=parts[0], response=parts[1], jumps=parts[2], settled=parts[3], **sizes)


class _Responses:
    """Wrenches of D devices, the first one undisturbed, at each of P poses, (P, D, 6): at rest, and displaced."""

    def __init__(self, controllers: Sequence[Controller], still: Array, moved: Array) -> None:
        self._controllers, self._still, self._moved = controllers, still, moved
        self._calls = 0

    def rows(self) -> Array:
        """Return the wrenches from the displaced sample on, (M, P, D, 6)."""
        # a law may respond with a delay: the first pose gives the number of samples
        rows = self._batch(slice(1), _MOST_SAMPLES)
        if rows is None or len(self._still) == 1:
            return self._one_by_one() if rows is None else rows
        memory = min(max(_FIRST_SAMPLES, _support(rows) + _SAMPLES_OF_ZERO), _MOST_SAMPLES)
        rows = self._batch(slice(None), memory)
        if rows is not None and memory < _MOST_SAMPLES and _alive(rows)[-_SAMPLES_OF_ZERO:].any():
            rows = self._batch(slice(None), _MOST_SAMPLES)
        return self._one_by_one() if rows is None else rows

    def _batch(self, poses: slice, memory: int) -> Array | None:
        """Return the wrenches computed as one batch; None if a law does not accept arrays, or cannot be stacked."""
        ends, each = [part[poses].reshape(-1, 6) for part in (self._still, self._moved)], self._controllers[poses]
        try:
            (still, moved), (one, last) = map(components, ends), (end[-1].tolist() for end in ends)
            together = stacked_controller(each, self._still.shape[1])
            if together is None:
                return None
            rows = self._after(self._rest(together, still), still, moved, memory)
            single = self._after(self._rest(each[-1], one), one, last, memory)
        except TooManyCallsError:
            raise
        except (MaglevError, TypeError, ValueError):  # a law that accepts floats only, as with math.sin or `if`
            return None
        with np.errstate(invalid="ignore"):
            differs = np.abs(rows[:, -1:] - single) > ROUNDING_OF_RESPONSE * np.abs(single).max(initial=1e-300)
        return None if differs.any() else rows.reshape(memory, -1, *self._still.shape[1:])

    def _one_by_one(self) -> Array:
        poses, devices = self._still.shape[:2]
        rows, memory, longest = np.zeros((_MOST_SAMPLES, poses, devices, 6)), min(_FIRST_SAMPLES, _MOST_SAMPLES), 0
        for index, (still, moved) in enumerate(zip(self._still.tolist(), self._moved.tolist(), strict=True)):
            if self._controllers[index] is not self._controllers[index - 1]:
                self._calls = 0  # a verdict does not depend on others
            rested, part = self._rest(self._controllers[index], still[0]), rows[:, index : index + 1]
            for length in dict.fromkeys((memory, _MOST_SAMPLES)):
                for device, pose in enumerate(moved):
                    part[:length, 0, device] = self._after(rested, still[0], pose, length)[:, 0]
                if not _alive(part[:length])[-_SAMPLES_OF_ZERO:].any():
                    break
            longest = max(longest, length)
            memory = min(
                max(memory if index else 2 * _SAMPLES_OF_ZERO, _support(part[:length]) + _SAMPLES_OF_ZERO),
                _MOST_SAMPLES,
            )
        return rows[:longest]

    def _rest(self, controller: Controller, still: Sequence[Any]) -> Controller:
        rested = copy.copy(controller)
        rested.reset()
        for tick in range(-SAMPLES_AT_REST, 0):
            self._step(rested, tick, still)
        return rested

    def _after(self, rested: Controller, still: Sequence[Any], moved: Sequence[Any], memory: int) -> Array:
        """Return the wrenches of a rested controller at each sample, (M, N, 6)."""
        moving = copy.copy(rested)
        moving._states, moving._velocity_state = copy.deepcopy((rested._states, rested._velocity_state))
        forces = [self._step(moving, tick, still if tick else moved) for tick in range(memory)]
        count = np.size(still[0])
        if count == 1:
            return np.array(forces).reshape(memory, 1, 6)
        return np.array([[np.broadcast_to(part, count) for part in force] for force in forces]).swapaxes(1, 2)

    def _step(self, controller: Controller, tick: int, position: Sequence[Any]) -> Sequence[Any]:
        self._calls += 1
        too_many_calls(self._calls, self._controllers[:1])
        return controller.step(Sample(tick, 0.0, position)).force


def too_many_calls(calls: int, controllers: Sequence[Controller]) -> None:
    """Raise if controllers were called too often.

    Raises:
        TooManyCallsError: If they were called more than 50 000 times each.
    """
    budget = _MOST_CALLS * len({*map(id, controllers)})
    if calls > budget:
        laws = [law for law in controllers[0].laws if law.gains() is None] or controllers[0].laws
        names = " and ".join(dict.fromkeys(getattr(law, "name", named(type(law))) for law in laws))
        needed = f"more than {budget} calls: accept arrays, or declare gains()"
        raise TooManyCallsError(f"stability not computed: law {names} needs {needed}")


def _support(rows: Array) -> int:
    return 1 + int(np.flatnonzero(_alive(rows)).max(initial=0))


def _alive(rows: Array) -> Mask:
    """Return True for samples at which a displaced device differs from the undisturbed one, (M,)."""
    with np.errstate(invalid="ignore"):
        gap = np.abs(rows - rows[:, :, :1])
        return np.asarray((~(gap <= ROUNDING_OF_RESPONSE * gap.max(axis=0))).any(axis=(1, 2, 3)))


def realise(response: Array) -> StateSpace | None:
    """Return the minimal realisation of an impulse response by Ho and Kalman's method; None above 24 states.

    The rank of the block Hankel matrix is the number of states.

    Args:
        response: Force at sample j after a unit displacement at sample 0 alone, (M, n, n): [j, to, from].
    """
    direct, later = response[0], response[1:]
    half, n = len(later) // 2, response.shape[1]
    rows = min(half, _MOST_ROWS)
    blocks = later[np.add.outer(np.arange(rows), np.arange(len(later) - rows))]
    to, sizes, source = np.linalg.svd(blocks.swapaxes(1, 2).reshape(rows * n, -1), full_matrices=False)
    states = int((sizes > _LEAST_SINGULAR_VALUE * sizes[0]).sum())
    if states > _MOST_STATES:
        return None
    root = np.sqrt(sizes[:states])
    observability, controllability = to[:, :states] * root, root[:, None] * source[:states]
    advance = np.linalg.lstsq(observability[:-n], observability[n:], rcond=None)[0]
    state, error = controllability[:, :n], 0.0
    with np.errstate(over="ignore", invalid="ignore"):  # of an unstable system
        for answer in later:
            error = max(error, float(np.abs(observability[:n] @ state - answer).max()))
            state = advance @ state
    if not error <= _ERROR_OF_REALISATION * np.abs(response).max():
        return None
    return StateSpace(advance, controllability[:, :n], observability[:n], direct)


def _statespace(*system: Any) -> Any:
    require(("control",), "control", "to_statespace() needs python-control")
    import control

    return control.ss(*system)
