"""Stability verdict on any controller.

It is computed from the gains declared by the laws, or by numerical linearisation if a law declares none.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache, partial
from itertools import compress, product
from typing import Any, ClassVar, NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from maglev_mj.control import LinearController
from maglev_mj.control.controller import Controller
from maglev_mj.control.timeline import Timing
from maglev_mj.device import lag_of
from maglev_mj.errors import ParameterError, TooManyCallsError
from maglev_mj.frames import AXES, ZERO, Array, Mask, unit_of
from maglev_mj.keywords import checked
from maglev_mj.parameters import number, numbers, transport_delay
from maglev_mj.plants.hand import Hand, get_hand
from maglev_mj.plants.model import Body
from maglev_mj.result import NoTruthValue, Result, Table, plain
from maglev_mj.spec import DEVICE_DELAY, DEVICE_PERIOD, INERTIA, MAX_DELAY_PERIODS, RANGE
from maglev_mj.theory.closed_loop import SampledLoop, bisect, pd
from maglev_mj.theory.linearise import Linearised, StateSpace, linearise, realise
from maglev_mj.theory.loop import AffineLaw, Bound
from maglev_mj.theory.poses import EDGE, POINTS, SCALE, edges_of, poses_of
from maglev_mj.theory.two_rates import DeviceLaw, laws_on_device, rates_of

_ROUNDING, _FREE, _PAIR = 1e-9, 1e-6, 1e-8
"""Tolerances of a spectral radius, of gains relative to their responses, and of the mean of a double root at 1."""
_SHORT, _STATED = 16, 64
"""Longest response that is realised sample by sample, and length of that of declared gains [samples]."""
_LONGEST, _FINEST, _PER_PERIOD, _HALVINGS = 0.03, 2.5e-4, 16, 12
"""Longest delay and finest step of a margin [s], delays per period, and bisections."""


class LoopState(NamedTuple):
    """Closed loop of axes with equal gains in one combination of law states.

    Attributes:
        axes: Names of the axes.
        acting: Active states, such as "contact"; () for none.
        others: Inactive states of the laws on these axes.
        spectral_radius: Spectral radius without the poles of free motion; 0 if there are no others.
        free: True without stiffness: poles at exactly 1.
    """

    axes: tuple[str, ...]
    acting: tuple[str, ...]
    others: tuple[str, ...]
    spectral_radius: float
    free: bool

    def row(self) -> tuple[str, ...]:
        """Return axes, state, spectral radius and verdict as texts for a table."""
        axes = "all axes" if self.axes == AXES else ", ".join(self.axes)
        inactive = (f"no {name}" if name == "contact" else f"not {name}" for name in self.others)
        state = ", ".join([*self.acting, *inactive]) or "always"
        if not self.spectral_radius:
            return axes, state, "-", "free motion"
        word = f"{_word(self.spectral_radius < 1.0)}{' (free motion)' * self.free}"
        return axes, state, f"{self.spectral_radius:.4f}", word


@dataclass(frozen=True, kw_only=True, eq=False)
class Verdict(NoTruthValue, Result):
    """Stability verdict on a controller, with its worst closed loop.

    Attributes:
        stable: False if a loop is unstable; else None if one was not computed; else True. Free motion is stable.
        spectral_radius: Spectral radius of the worst loop, without the poles of free motion, which are exactly 1
            without stiffness. Below 1 for a stable loop; NaN if not computed.
        axes: Names of the worst loop's axes; () if not computed.
        acting: Active law states of the worst loop: "contact", "stuck" and so on; () if a law declares no gains.
        pose: Pose of the worst loop [m, rad], (6,).
        stiffness: Total stiffness at the pose [N/m, N m/rad], (6, 6).
        damping: Total damping at the pose [N s/m, N m s/rad], (6, 6).
        stated: True if all laws declare their gains, so that the verdict does not depend on the pose.
        jumps: Skipped poses: the wrench or its slope is discontinuous there, (J, 6).
        unknown: Skipped poses: the impulse response exceeds 512 samples and has no low-order realisation, (U, 6).
        away: Skipped poses: unstable equilibria, such as the crest between two detents, (A, 6).
        states: Loop of each axis in each state of its laws, equal ones merged; () if a law declares no gains.
        unjudged: Names of axes with a loop that was not computed, such as a law with a sign of the velocity.
    """

    stable: bool | None
    spectral_radius: float
    axes: tuple[str, ...]
    acting: tuple[str, ...] = ()
    pose: Array
    stiffness: Array
    damping: Array
    eigenvalues: NDArray[np.complex128]
    stated: bool
    jumps: Array = field(default_factory=lambda: np.zeros((0, 6)))
    unknown: Array = field(default_factory=lambda: np.zeros((0, 6)))
    away: Array = field(default_factory=lambda: np.zeros((0, 6)))
    states: tuple[LoopState, ...] = ()
    unjudged: tuple[str, ...] = ()
    units: ClassVar = {"pose": "m, rad", "stiffness": "N/m, N m/rad", "damping": "N s/m, N m s/rad"}
    picture: ClassVar = "maglev_mj.theory.pictures:pole_map"

    def _headline(self) -> str:
        parts = [f"{axis} = {1e3 * x:.3g} {unit_of('mm', axis)}" for axis, x in zip(AXES, self.pose) if x]
        pose = f"at {', '.join(parts) or 'the centre'}" if self.axes else ""
        worst = f"in {' and '.join(self.acting)}" * bool(self.acting) if self.stated else pose
        return f"{self} (worst {worst})" if worst else str(self)

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return pose, stiffness and damping of each axis."""
        gains = {"stiffness": np.diag(self.stiffness), "damping": np.diag(self.damping)}
        return {"axis": np.array(AXES), "pose": self.pose, **gains}

    def table(self) -> Table:
        """Return a row for each combination of law states; without declared gains, the worst pose."""
        rows = [state.row() for state in self.states]
        method = "from the gains declared by the laws" if self.stated else "by numerical linearisation"
        remarks = "\n".join([f"line above the table: worst axis; computed {method}", *self.remarks])
        return Table("", ("axes", "state", "spectral radius", "verdict"), rows, remarks)

    def __str__(self) -> str:
        if self.stable is None:
            return f"not computed{self._unjudged}: {next((reason for _, reason in self._skipped()), 'no finite force')}"
        text = f"{_word(self.stable)}, spectral radius {self.spectral_radius:.3f}"
        return f"{', '.join(self.axes)}: {'free motion' if self.stable and not self.spectral_radius else text}"

    def as_json(self) -> dict[str, Any]:
        """Return the verdict, ready for JSON."""
        names = "stable", "spectral_radius", "axes", "acting", "pose", "stated", "states", "unjudged", "remarks"
        return {name: plain(getattr(self, name)) for name in names}

    @property
    def remarks(self) -> tuple[str, ...]:
        """Axes that were not computed, and the number of skipped poses by reason, one line each."""
        skipped = (f"{count} pose{'s' * (count > 1)} skipped: {reason}" for count, reason in self._skipped())
        return (*[f"not computed{self._unjudged}"] * bool(self.unjudged), *skipped)

    @property
    def _unjudged(self) -> str:
        return f" on {', '.join(self.unjudged)}" * bool(self.unjudged)

    def _skipped(self) -> list[tuple[int, str]]:
        reasons = (
            (self.unknown, "controller memory exceeds 512 samples"),
            (self.jumps, "discontinuous force"),
            (self.away, "unstable equilibrium (negative stiffness)"),
        )
        return [(len(poses), reason) for poses, reason in reasons if len(poses)]


class Judged(Protocol):
    """Interface of a scene for `stability`."""

    @property
    def delay(self) -> float:
        """Transport delay [s]."""

    def controller(self) -> Controller:
        """Return a new controller."""

    def start(self) -> Any:
        """Return the state at release, with its `pose`."""

    def timing(self) -> Timing:
        """Return the timing of host and device."""

    @property
    def body(self) -> Body:
        """Flotor of the device in use."""


@checked(own="scene")
def stability(scene: Judged, *, inertia: ArrayLike | None = None, delay: float | None = None) -> Verdict:
    """Return the stability verdict on a scene; see `judge`.

    Args:
        scene: The scene.
        inertia: Mass and moments of inertia in place of the scene's own [kg, kg m²], (6,).
        delay: Transport delay in place of the scene's own [s]; gains derived from the delay do not change.

    Raises:
        ParameterError: If `scene` is not a scene, or a value is outside its bounds.

    Example:
        >>> from maglev_mj import find_scene, stability
        >>> drop = find_scene("drop")
        >>> stability(drop(stiffness=6000.0)).stable, stability(drop(stiffness=20000.0)).stable
        (True, False)
    """
    if isinstance(scene, type) or not hasattr(scene, "controller"):
        raise ParameterError(f"scene must be a Scene, such as find_scene('drop')() (got {scene!r})")
    body, delay = scene.body.bounded, scene.delay if delay is None else delay
    inertia = body.inertia if inertia is None else inertia
    controller, pose = scene.controller(), scene.start().pose
    device = scene.timing().device if controller.on_device else (DEVICE_PERIOD, DEVICE_DELAY)
    around: Any = {"inertia": inertia, "reach": body.range, "device": device, "driver_lag": scene_lag(scene)}
    return judge(controller, delay=delay, pose=pose, **around)


def scene_lag(scene: Any) -> float:
    """Return the time constant of the drivers of a scene's device [s]; 0 without a device."""
    hardware = getattr(scene, "hardware", None)
    return 0.0 if hardware is None else lag_of(hardware)


@checked
def judge(
    controller: Controller,
    *,
    delay: float,
    pose: ArrayLike = ZERO,
    inertia: ArrayLike = INERTIA,
    reach: ArrayLike = RANGE,
    device: ArrayLike = (DEVICE_PERIOD, DEVICE_DELAY),
    driver_lag: float = 0.0,
) -> Verdict:
    """Return the stability verdict on the closed loop of a free flotor.

    If all laws declare their gains, the loop is exact in every combination of their states. Otherwise the controller
    is linearised at the start, at the centre, along each axis, and 1 µm to 0.1 mm inside each face and each edge of a
    region of constant gains; coupled axes form one loop.

    Args:
        controller: The controller, with laws for one device; it is not changed.
        delay: Transport delay [s], up to 10 periods.
        pose: Start of the flotor [m, rad], (6,).
        inertia: Mass and moments of inertia [kg, kg m²], (6,).
        reach: Range of motion [m, rad], (6,).
        device: Sample period and delay of walls on the device [s], (2,).
        driver_lag: Time constant of the drivers [s].

    Raises:
        ParameterError: If `controller` is no Controller, or a value is outside its bounds.
        MaglevError: If a law fails at a pose.

    Example:
        >>> from maglev_mj import Controller, Wall, judge
        >>> wall = Wall(axes="z", lower=0.0, stiffness=6000.0, damping=80.0)
        >>> judge(Controller([wall], period=0.005), delay=0.0015).stable
        True
    """
    start, body = numbers("pose", pose, shape="(6,)"), numbers("inertia", inertia, shape="(6,)", above=0.0)
    transport_delay(number("delay", delay), controller.period)
    own, late = numbers("device", device, shape="(2,)").tolist()
    gains = stated_gains(controller)
    if gains is None and controller.on_device:
        raise ParameterError("stability of a law with walls on the device needs declared gains: define gains()")
    if gains is None:
        far = numbers("reach", reach, shape="(6,)", above=0.0)
        return _numerically(controller, delay, start, body, far, driver_lag)
    return _by_gains(gains, controller, delay, start, body, laws_on_device(controller, (own, late)), None, driver_lag)


_Gains: TypeAlias = dict[tuple[str, ...], tuple[Array, Array]]


def stated_gains(controller: Controller) -> _Gains | None:
    """Return total stiffness and damping of the six axes for each combination of law states.

    None if a law declares no gains, a gain is negative, or the velocity estimator is not linear.
    """
    sums: dict[str, Array] = {state: np.zeros((2, len(AXES))) for state in ("always", "contact")}
    for law in controller.laws:
        stated = law.gains()
        if stated is None or law.batch:
            return None
        for near in stated:
            sums[near.state] = sums.get(near.state, 0.0) + np.array([near.stiffness, near.damping])
    if not hasattr(controller.velocity, "linear"):
        return None
    always = sums.pop("always")
    states = sorted({*["contact"] * controller.on_device, *(state for state, gains in sums.items() if gains.any())})
    totals = {}
    for active in product((False, True), repeat=len(states)):
        acting = tuple(compress(states, active))
        stiffness, damping = sum((sums[state] for state in acting), always)
        totals[acting] = stiffness, damping
    return None if any((gains < 0.0).any() for both in totals.values() for gains in both) else totals


def _by_gains(
    gains: _Gains,
    controller: Controller,
    delay: float,
    pose: Array,
    body: Array,
    laws: Mapping[int, DeviceLaw],
    hand: Hand | None = None,
    lag: float = 0.0,
) -> Verdict:
    """Return the verdict from declared gains, and laws on the device in contact; with a hand on the translations."""
    kinds: dict[tuple[Any, ...], tuple[list[str], NDArray[Any]]] = {}
    touching: Mapping[Any, Mapping[int, DeviceLaw]] = {acting: laws if "contact" in acting else {} for acting in gains}
    own = [
        {acting: (float(k[axis]), float(b[axis]), touching[acting].get(axis)) for acting, (k, b) in gains.items()}
        for axis in range(len(AXES))
    ]
    loop: Any = {"period": controller.period, "delay": delay, "velocity": controller.velocity, "driver_lag": lag}
    cases = {mass: {pair for axis in np.flatnonzero(body == mass) for pair in own[axis].values()} for mass in {*body}}
    held = {mass: hand if mass in body[:3] else None for mass in cases}
    # once for equal axes
    roots_of = {mass: _poles_of(frozenset(pairs), mass=mass, hand=held[mass], **loop) for mass, pairs in cases.items()}
    for axis, mass, axis_gains in zip(AXES, body.tolist(), own, strict=True):
        states_here = [acting[0] for acting in gains if len(acting) == 1 and axis_gains[acting] != axis_gains[()]]
        for acting in (acting for acting in gains if set(acting) <= set(states_here)):
            stiffness, damping, law = case = axis_gains[acting]
            if law is not None:
                stiffness, damping = stiffness + law.stiffness, damping + law.damping
            free = 0 if stiffness > 0.0 or held[mass] is not None else 1 if damping > 0.0 else 2
            roots = roots_of[mass][case]
            others = tuple(name for name in states_here if name not in acting)
            kind = acting, others, round(_spectral_radius(roots, free), 12), free > 0
            kinds.setdefault(kind, ([], roots))[0].append(axis)
    states = tuple(LoopState(tuple(axes), *kind) for kind, (axes, _) in kinds.items())
    worst, (_, roots) = max(zip(states, kinds.values(), strict=True), key=lambda pair: pair[0].spectral_radius)
    stiff, damp = map(np.array, gains[worst.acting])
    for index, beside in touching[worst.acting].items():
        stiff[index], damp[index] = stiff[index] + beside.stiffness, damp[index] + beside.damping
    return Verdict(
        stable=worst.spectral_radius < 1.0 - _ROUNDING,
        spectral_radius=worst.spectral_radius,
        axes=worst.axes[:1],
        acting=worst.acting,
        pose=pose,
        stiffness=np.diag(stiff),
        damping=np.diag(damp),
        eigenvalues=roots.astype(np.complex128),
        stated=True,
        states=states,
    )


_Case: TypeAlias = tuple[float, float, DeviceLaw | None]


@lru_cache(maxsize=512)  # rotations are the same in every hand
def _poles_of(cases: frozenset[_Case], **loop: Any) -> dict[_Case, NDArray[Any]]:
    """Return the poles per host period of gains beside a law on the device, those without one at once."""
    alone = [case for case in cases if case[2] is None]
    stiffness, damping = np.array([case[:2] for case in alone]).reshape(-1, 2).T
    poles = np.linalg.eigvals(SampledLoop(**loop).matrix(stiffness, damping))
    roots_of: dict[_Case, NDArray[Any]] = dict(zip(alone, poles, strict=True))
    for stiff, damp, law in cases:
        if law is not None:
            late = loop["delay"] if stiff or damp else 0.0  # without gains on the host its delay does not matter
            roots_of[stiff, damp, law] = _two_rate_poles(stiff, damp, law, **loop | {"delay": late})
    return roots_of


@lru_cache(maxsize=512)
def _two_rate_poles(stiffness: float, damping: float, law: DeviceLaw, **loop: Any) -> NDArray[Any]:
    """Return the poles per host period of gains beside a law on the device."""
    roots = np.linalg.eigvals(SampledLoop(device=law, **loop).matrix(stiffness, damping)).astype(np.complex128)
    return np.asarray(roots ** (1.0 / rates_of(loop["period"], law).host))


def _word(stable: bool | None) -> str:
    return {True: "stable", False: "unstable", None: "not computed"}[stable]


def _spectral_radius(roots: NDArray[Any], free: int) -> float:
    """Return the spectral radius without the poles of free motion, those nearest to 1."""
    bound = np.argsort(np.abs(roots - 1.0))[free:]
    return float(np.abs(roots[bound]).max(initial=0.0))


class _Loop(NamedTuple):
    """Coupled axes at a pose."""

    near: Linearised
    axes: tuple[int, ...]
    scaled: Array
    settles: bool
    system: StateSpace | None
    """Dimensionless; None for a short response, or one without a low-order realisation."""
    still: int
    """Number of directions without stiffness."""
    moments: tuple[Array, Array]
    """Sums of the response and of age times response, dimensionless."""

    @property
    def unstable_equilibrium(self) -> bool:
        """True for an unstable equilibrium."""
        static = self.moments[0]
        own = np.linalg.eigvals(-static).real if np.isfinite(static).all() else np.zeros(1)
        return bool(own.min() < -_FREE * np.abs(self.scaled).max())

    def gains(self, body: Array) -> tuple[Array, Array]:
        """Return stiffness and damping, (6, 6) each."""
        block, root = np.ix_(self.axes, self.axes), np.sqrt(body[list(self.axes)])
        stiffness, damping = self.near.stiffness.copy(), self.near.damping.copy()
        size = np.outer(root, root) / self.near.period**2
        stiffness[block], damping[block] = -size * self.moments[0], self.near.period * size * self.moments[1]
        return stiffness, damping


_Group: TypeAlias = tuple[tuple[_Loop, ...], tuple[StateSpace, ...], tuple[int, ...]]


def _loop(near: Linearised, axes: tuple[int, ...], own: Array, previous: list[_Loop]) -> _Loop:
    """Return the loop of some axes; a loop equal to a previous other reuses its realisation."""
    settles = bool(near.settled[list(axes)].all())
    for other in previous:
        if other.axes == axes and other.settles == settles and _alike(other.scaled, own):
            return other._replace(near=near)
    memory = _memory(own)
    # truncating a long response would add the poles of the truncation
    system = realise(own[:memory]) if memory > _SHORT and np.isfinite(near.response).all() else None
    moments = (own.sum(axis=0), np.tensordot(np.arange(len(own)), own, 1)) if system is None else system.moments()
    sizes = np.linalg.svd(np.nan_to_num(moments[0], neginf=1.0), compute_uv=False)
    still = int((sizes <= _FREE * max(np.abs(own).sum(axis=0).max(), _FREE)).sum())
    previous.append(_Loop(near, axes, own, settles, system, still, moments))
    return previous[-1]


def _alike(first: Array, second: Array) -> bool:
    return len(first) == len(second) and bool(np.abs(first - second).max() <= _ROUNDING * np.abs(second).max())


def _own_spectral_radius(roots: NDArray[np.complex128], still: int) -> float:
    """Return the spectral radius without the poles of free motion.

    Each direction without stiffness has a pole at exactly 1, and a double one without damping or with a virtual mass.
    A double pole is accurate to half of the digits, its mean to nearly all.
    """
    near = roots[np.argsort(np.abs(roots - 1.0))][: 2 * still]
    free = [count for count in range(still, 2 * still + 1) if abs(near[:count].mean() - 1.0) < _PAIR] if still else []
    return _spectral_radius(roots, max(free, default=still))


class _Loops(NamedTuple):
    """Loops of a controller by linearisation, and skipped poses."""

    loops: list[_Loop]
    """At stable equilibria, or at unstable ones of axes without a stable one."""
    away: list[_Loop]
    jumps: list[Array]
    unknown: list[Array]
    missing: tuple[int, ...]
    """Axes without a loop, with an unknown pose or with a region of discontinuous force."""


def _linearised(controller: Controller, pose: Array, body: Array, reach: ArrayLike) -> _Loops:
    loops: list[_Loop] = []
    away: list[_Loop] = []
    previous: list[_Loop] = []
    bent: list[tuple[Array, int]] = []
    jumps, unknown, judged, missing = [], [], set[int](), set[int]()
    grid = linearise(controller, poses_of(controller, pose, reach))
    edges = [*edges_of(controller, grid[2 : 2 + len(AXES) * POINTS])]
    for near in [*grid, *(linearise(controller, edges) if edges else ())]:
        scaled = near.scaled(body)
        for axes in _coupled(scaled):
            chosen = list(axes)
            if near.jumps[chosen].any():
                jumps.append(near.pose)
                bent += [(near.pose, axis) for axis in chosen if near.jumps[axis]]
                continue
            loop = _loop(near, axes, scaled[:, chosen][:, :, chosen], previous)
            if loop.system is None and not loop.settles:
                unknown.append(near.pose)
                missing |= set(axes)
            elif loop.unstable_equilibrium:
                away.append(loop)
            else:
                loops.append(loop)
                judged |= set(axes)
    # an axis without a stable equilibrium is judged at the unstable ones
    unstable = [loop for loop in away if not judged.issuperset(loop.axes)]
    missing |= set(range(len(AXES))) - judged - {axis for loop in unstable for axis in loop.axes}
    missing |= _regions(controller, bent)
    return _Loops(loops + unstable, away, jumps, unknown, tuple(sorted(missing)))


def _regions(controller: Controller, bent: Sequence[tuple[Array, int]]) -> set[int]:
    """Return the axes with a region of discontinuous force; the force is smooth to both sides of an edge alone.

    Args:
        controller: The controller.
        bent: Poses and axes with a discontinuous force.
    """
    regions: set[int] = set()
    for axis in sorted({axis for _, axis in bent}):
        poses = _distinct([pose for pose, other in bent if other == axis])
        beside = np.repeat(poses, 2, axis=0)
        beside[:, axis] += np.tile([-EDGE, EDGE], len(poses)) * SCALE[axis]
        if any(near.jumps[axis] for near in linearise(controller, beside, axes=AXES[axis])):
            regions.add(axis)
    return regions


def _numerically(
    controller: Controller, delay: float, pose: Array, body: Array, reach: Array, lag: float = 0.0
) -> Verdict:
    """Return the verdict by linearisation."""
    linear = _linearised(controller, pose, body, reach)
    worst: _Loop | None = None
    spectral_radius, eigenvalues = np.nan, np.empty(0, dtype=np.complex128)
    for loop, roots in _roots(_grouped(linear.loops), delay, body, None, lag):
        own = _own_spectral_radius(roots, loop.still)
        if worst is None or own > spectral_radius * (1.0 + _ROUNDING):
            worst, spectral_radius, eigenvalues = loop, own, roots
    unstable, complete = spectral_radius >= 1.0 - _ROUNDING, not linear.missing
    stiffness, damping = np.full((2, 6, 6), np.nan) if worst is None else worst.gains(body)
    return Verdict(
        stable=not unstable if unstable or complete else None,
        spectral_radius=spectral_radius,
        axes=() if worst is None else tuple(AXES[axis] for axis in worst.axes),
        pose=pose if worst is None else worst.near.pose,
        stiffness=stiffness,
        damping=damping,
        eigenvalues=eigenvalues,
        stated=False,
        jumps=_distinct(linear.jumps),
        unknown=_distinct(linear.unknown),
        away=_distinct([loop.near.pose for loop in linear.away]),
        unjudged=tuple(AXES[axis] for axis in linear.missing),
    )


def _roots(
    groups: Iterable[_Group], delay: float, body: Array, hand: Hand | None = None, lag: float = 0.0
) -> Iterator[tuple[_Loop, NDArray[np.complex128]]]:
    """Yield distinct loops with their poles; loops of equal size are computed as one batch."""
    for different, systems, axes in groups:
        period, inertia = different[0].near.period, body[list(axes)]
        held = hand if hand is not None and set(axes) <= set(hand.indices) else None
        system = StateSpace(*map(np.array, zip(*systems))).with_units(period, inertia)
        matrices = system.closed_loop(period=period, delay=delay, inertia=inertia, hand=held, driver_lag=lag)
        yield from zip(different, np.linalg.eigvals(matrices).astype(np.complex128), strict=True)


def _grouped(loops: Sequence[_Loop]) -> Iterator[_Group]:
    """Yield distinct loops of equal axes and size, with their systems and axes."""
    previous: dict[tuple[int, ...], list[_Loop]] = {}
    sizes: dict[tuple[tuple[int, ...], int], list[tuple[_Loop, StateSpace]]] = {}
    for loop in loops:
        same = previous.setdefault(loop.axes, [])
        if any(_alike(other.scaled, loop.scaled) for other in same):
            continue
        same.append(loop)
        system = loop.system or StateSpace.of(loop.scaled[: _memory(loop.scaled)])
        sizes.setdefault((loop.axes, len(system.advance)), []).append((loop, system))
    for (axes, _), group in sizes.items():
        different, systems = zip(*group)
        yield different, systems, axes


def axis_loops(
    controllers: Sequence[Controller],
    axis: int,
    *,
    poses: ArrayLike,
    delay: float,
    inertia: Array,
    hand: Hand | None = None,
    device: tuple[float, float] = (DEVICE_PERIOD, DEVICE_DELAY),
    driver_lag: float = 0.0,
) -> list[tuple[float, float]]:
    """Return static stiffness and spectral radius of one axis with all of its laws active, for each controller.

    Computed from the declared gains, or by linearisation at its pose if a law declares none.

    Args:
        controllers: Controllers of equal laws with other gains, for one device each; none is changed.
        axis: Index into AXES; coupling to the other axes is ignored.
        poses: Pose of each [m, rad], (N, 6).
        delay: Transport delay [s], up to 10 periods.
        inertia: Mass and moments of inertia [kg, kg m²], (6,).
        hand: The hand on the axis; None for a free flotor.
        device: See `judge`.
        driver_lag: See `judge`.

    Returns:
        Stiffness [N/m, N m/rad], infinite for an integrator, and spectral radius, below 1 for a stable loop, of each;
        NaN if not computed.

    Raises:
        MaglevError: If a law fails at a pose.

    Example:
        >>> import numpy as np
        >>> from maglev_mj import Controller, Wall
        >>> from maglev_mj.spec import INERTIA
        >>> wall = Controller([Wall(axes="z", lower=0.0, stiffness=6000.0, damping=80.0)], period=0.005)
        >>> inside, body = (0, 0, -1e-3, 0, 0, 0), np.array(INERTIA)
        >>> ((stiffness, spectral_radius),) = axis_loops([wall], 2, poses=[inside], delay=0.0015, inertia=body)
        >>> round(stiffness), round(spectral_radius, 3)
        (6000, 0.877)
    """
    held = hand if hand is not None and axis in hand.indices else None
    result = []
    for controller in controllers:
        if (gains := stated_gains(controller)) is None:
            break
        stiffness, damping = (float(both[axis]) for both in list(gains.values())[-1])
        law = laws_on_device(controller, device).get(axis)
        around: Any = {"period": controller.period, "velocity": controller.velocity, "device": law, "hand": held}
        both = SampledLoop(mass=inertia[axis], delay=delay, driver_lag=driver_lag, **around)
        result.append((stiffness + (law.stiffness if law else 0.0), float(both.spectral_radius(stiffness, damping))))
    else:
        return result
    result = [(math.nan, math.nan)] * len(controllers)
    for index, loop in enumerate(_axis(controllers, axis, poses, inertia)):
        if loop is not None:
            ((_, roots),) = _roots(_grouped([loop]), delay, inertia, hand, driver_lag)
            result[index] = float(loop.gains(inertia)[0][axis, axis]), _own_spectral_radius(roots, loop.still)
    return result


def _axis(controllers: Sequence[Controller], axis: int, poses: ArrayLike, inertia: Array) -> list[_Loop | None]:
    """Return the loop of one axis for each controller, by linearisation at its pose; None if not computed."""
    try:
        linear = linearise(controllers, poses, axes=AXES[axis])
    except TooManyCallsError:
        return [None] * len(controllers)
    one, known = slice(axis, axis + 1), list[_Loop]()
    loops = (_loop(near, (axis,), near.scaled(inertia)[:, one, one], known) for near in linear)
    return [None if loop.near.jumps[axis] or not (loop.system or loop.settles) else loop for loop in loops]


def axis_law(controller: Controller, axis: int, *, pose: ArrayLike, inertia: Array) -> LinearController | None:
    """Return the laws of one axis, linearised at a pose with their memory; None if not computed. See `axis_loops`."""
    (loop,) = _axis([controller], axis, np.atleast_2d(pose), inertia)
    if loop is None:
        return None
    system = loop.system or StateSpace.of(loop.scaled[: _memory(loop.scaled)])
    advance, take, give, direct = system.with_units(controller.period, inertia[[axis]])
    return LinearController(advance, take[:, 0], give[0], direct[0, 0])


def affine_laws(
    controllers: Sequence[Sequence[Controller]], gains: Sequence[float], axis: int, *, poses: ArrayLike, inertia: Array
) -> list[AffineLaw | None]:
    """Return the laws of one axis as a function of a gain, for each controller; None if not affine in it.

    Args:
        controllers: N controllers at three gains each.
        gains: The gains, (3,).
        axis: Index into AXES.
        poses: Pose of each [m, rad], (N, 6).
        inertia: Mass and moments of inertia [kg, kg m²], (6,).
    """
    flat = [one for some in controllers for one in some]
    stated = [stated_gains(one) for one in flat]
    responses: list[Array | None] = [None if one is None else _stated_response(flat[0], one, axis) for one in stated]
    others = [index for index, response in enumerate(responses) if response is None]
    if others:
        at = np.repeat(np.atleast_2d(poses), len(gains), axis=0)[others]
        for index, loop in zip(others, _axis([flat[index] for index in others], axis, at, inertia), strict=True):
            responses[index] = None if loop is None else loop.near.response[:, axis, axis]
    laws: list[AffineLaw | None] = []
    for first in range(0, len(flat), len(gains)):
        some = [one for one in responses[first : first + len(gains)] if one is not None]
        size = max(map(len, some), default=0)
        padded = np.array([np.pad(one, (0, size - len(one))) for one in some])
        laws.append(AffineLaw.of(padded, gains, _realised) if len(some) == len(gains) else None)
    return laws


def _realised(response: Array) -> StateSpace | None:
    return StateSpace.of(response) if len(response) <= _SHORT else realise(response)


def _stated_response(controller: Controller, gains: _Gains, axis: int) -> Array:
    """Return the impulse response of declared gains on one axis, all of its laws active."""
    stiffness, damping = (float(both[axis]) for both in list(gains.values())[-1])
    law = pd(controller.velocity)(*map(np.asarray, (stiffness, damping, controller.period)))
    state, response = law.take, [float(law.direct)]
    for _ in range(_STATED):
        response.append(float(law.give @ state))
        state = law.advance @ state
    return np.array(response[: 2 + int(np.flatnonzero(response).max(initial=0))])


def delay_margins(
    controller: Controller,
    hands: Sequence[str],
    *,
    pose: ArrayLike = ZERO,
    inertia: ArrayLike = INERTIA,
    reach: ArrayLike = RANGE,
    device: ArrayLike = (DEVICE_PERIOD, DEVICE_DELAY),
    driver_lag: float = 0.0,
) -> dict[str, Bound]:
    """Return the critical delay of a controller's loops, free and in each hand [s].

    The controller is linearised once. A hand acts on the translations only; translations coupled to rotations are free.

    Args:
        controller: The controller, of laws for one device; it is not changed.
        hands: Names of hands; "none" for a free flotor.
        pose: Start of the flotor [m, rad], (6,).
        inertia: Mass and moments of inertia [kg, kg m²], (6,).
        reach: Range of motion [m, rad], (6,).
        device: Sample period and delay of walls on the device [s], (2,).
        driver_lag: See `judge`.

    Returns:
        By hand: 0 if unstable without delay, `beyond` at the lesser of 30 ms and 10 periods, NaN if not computed.

    Raises:
        MaglevError: If a law fails at a pose.

    Example:
        >>> from maglev_mj import find_scene
        >>> from maglev_mj.theory.verdict import delay_margins
        >>> joystick = find_scene("joystick")(period=0.005)
        >>> round(delay_margins(joystick.controller(), ["none"])["none"] * 1e3, 2)  # [ms]
        2.91
    """
    start, body = numbers("pose", pose), numbers("inertia", inertia, at_least=0.0, above=0.0)
    gains, period = stated_gains(controller), controller.period
    laws = laws_on_device(controller, numbers("device", device, shape="(2,)").tolist())
    if gains is None:
        linear = None
        with suppress(TooManyCallsError):
            linear = None if laws else _linearised(controller, start, body, reach)
        if linear is None or linear.missing:
            return dict.fromkeys(hands, Bound(math.nan))
        loops = [*_grouped(linear.loops)]

    def spectral_radius(delay: float, hand: Hand | None) -> float:
        if gains is not None and laws:
            return _by_gains(gains, controller, delay, start, body, laws, hand, driver_lag).spectral_radius
        if gains is not None:
            return float(stated_spectral_radii([*gains.values()], controller, delay, body, hand, driver_lag).max())
        roots = (_own_spectral_radius(own, loop.still) for loop, own in _roots(loops, delay, body, hand, driver_lag))
        return max(roots, default=0.0)

    return {name: _margin(partial(spectral_radius, hand=get_hand(name)), period) for name in hands}


def stated_spectral_radii(
    gains: Sequence[tuple[Array, Array]],
    controller: Controller,
    delay: float,
    body: Array,
    hand: Hand | None = None,
    lag: float = 0.0,
) -> Array:
    """Return the largest spectral radius over the axes for each of N pairs of gains (6,), without free motion, (N,)."""
    radii = []
    for part, held in ((slice(3), hand), (slice(3, 6), None)):
        stiffness, damping = (np.array([both[kind][part] for both in gains]).ravel() for kind in (0, 1))
        mass = np.tile(body[part], len(gains))
        around: Any = {"period": controller.period, "delay": delay, "velocity": controller.velocity, "driver_lag": lag}
        loop = SampledLoop(mass=mass, hand=held, **around)
        roots = np.linalg.eigvals(loop.matrix(stiffness, damping))
        free = np.where(stiffness > 0.0, 0, np.where(damping > 0.0, 1, 2)) * (held is None)
        radii.append(np.array([*map(_spectral_radius, roots, free)]).reshape(-1, 3))
    return np.asarray(np.hstack(radii).max(axis=1))


def _margin(spectral_radius: Callable[[float], float], period: float) -> Bound:
    """Return the first delay at which a spectral radius reaches 1 [s]."""

    def stable(delay: Any) -> Mask:
        return np.array(spectral_radius(float(delay)) < 1.0 - _ROUNDING)

    grid = np.arange(0.0, min(_LONGEST, MAX_DELAY_PERIODS * period) + 1e-12, max(period / _PER_PERIOD, _FINEST))
    first = next((index for index, delay in enumerate(grid) if not stable(delay)), None)
    if not first:
        return Bound(float(grid[-1]), True) if first is None else Bound(0.0)
    return Bound(float(bisect(stable, grid[first], grid[first - 1], _HALVINGS)))


def _memory(response: Array) -> int:
    """Return the length of a response without trailing zeros."""
    return 1 + int(np.flatnonzero(response.any(axis=(1, 2))).max(initial=0))


def _coupled(scaled: Array) -> list[tuple[int, ...]]:
    """Return groups of coupled axes."""
    size = np.abs(scaled).max(axis=0)
    linked = (size > _ROUNDING * size.max(initial=0.0)) | np.eye(len(AXES), dtype=bool)
    linked = np.linalg.matrix_power(linked.astype(float), len(AXES)) > 0.0
    return list(dict.fromkeys(tuple(np.flatnonzero(row).tolist()) for row in linked))


def _distinct(poses: Sequence[Array]) -> Array:
    return np.unique(np.array(poses).reshape(-1, 6), axis=0)
