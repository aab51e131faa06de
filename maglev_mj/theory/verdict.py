"""Stability verdict on any controller.

It follows from the laws' gains if all state them, otherwise from a numerical linearisation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import compress, product
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from maglev_mj.control.controller import Controller
from maglev_mj.errors import ParameterError, check_instance
from maglev_mj.frames import AXES, ZERO, Array
from maglev_mj.parameters import number, numbers
from maglev_mj.pictures import save
from maglev_mj.plants.hand import Hand, get_hand
from maglev_mj.plants.model import load_model
from maglev_mj.result import Result, Table, plain
from maglev_mj.spec import INERTIA, RANGE
from maglev_mj.theory.closed_loop import MOST_PERIODS, SampledLoop
from maglev_mj.theory.linearise import Linearised, StateSpace, linearise, realise

_ROUNDING, _FREE, _PAIR = 1e-9, 1e-6, 1e-8
"""Tolerances of a spectral radius, of gains beside their responses, and of a mean root."""
_SHORT = 16
"""Samples of a response whose closed loop is exact as it is."""
_POINTS, _STRIDE = 23, 0.9871
"""Number of poses along each axis, and range covered.

The range is a share of the motion range, chosen so that few poses fall on an edge.
"""
_LONGEST, _FINEST, _PER_PERIOD, _HALVINGS = 0.03, 2.5e-4, 16, 12
"""Longest delay and finest step of a margin [s], delays tried a period, and halvings."""
_OFF, _DEPTHS = 1e-5, (1e-6, 1e-4)
"""Distances from an edge [m]; ten times as many [rad].

The first is for a start moved off an edge, the others for poses inside a face.
"""
_SCALE = np.array([1.0] * 3 + [10.0] * 3)


class LoopState(NamedTuple):
    """Closed loop of like axes in one state of the laws that act there.

    Attributes:
        axes: Names of the axes.
        acting: States of the laws that act, such as "contact"; () for none.
        others: States of laws on these axes that do not act.
        spectral_radius: Spectral radius, those of free motion left out; 0 if there are no others.
        free: True if nothing pulls back: there are roots at exactly 1.
    """

    axes: tuple[str, ...]
    acting: tuple[str, ...]
    others: tuple[str, ...]
    spectral_radius: float
    free: bool

    @property
    def margin(self) -> float:
        """Distance of the spectral radius from 1; negative for an unstable loop."""
        return 1.0 - self.spectral_radius

    def row(self) -> tuple[str, ...]:
        """Return axes, state, spectral radius, margin and verdict as texts for a table."""
        where = "all axes" if self.axes == AXES else ", ".join(self.axes)
        lacking = (f"no {name}" if name == "contact" else f"not {name}" for name in self.others)
        state = ", ".join([*self.acting, *lacking]) or "always"
        if not self.spectral_radius:
            return where, state, "-", "-", "free"
        word = f"{'free, else ' * self.free}{_word(self.margin > 0.0)}"
        return where, state, f"{self.spectral_radius:.4f}", f"{self.margin:.4f}", word


@dataclass(frozen=True, kw_only=True, eq=False)
class Verdict(Result):
    """Stability verdict with the worst closed loop of a controller.

    Attributes:
        stable: True if all loops are stable, apart from free motion; None if not known.
        spectral_radius: Spectral radius of the worst loop, without the eigenvalues of free motion: they are exactly 1
            where nothing pulls back. Below 1 for a stable loop; NaN if not known.
        axes: Names of the worst loop's axes; () if not known.
        acting: States of the acting laws: "always", "contact", "stuck" and so on; () if gains are not stated.
        pose: Pose of the worst loop [m, rad], (6,).
        stiffness: Total stiffness at the pose [N/m, N m/rad], (6, 6).
        damping: Total damping at the pose [N s/m, N m s/rad], (6, 6).
        stated: True if all laws state their gains, so that the pose does not matter.
        jumps: Poses with a jump or kink of the wrench, so that no gains describe it, (J, 6); they are left out.
        unknown: Poses where the controller remembers for more than 512 samples, and not as a linear law of few states
            does, (U, 6).
        away: Poses of unstable equilibrium, such as the crest between two detents, (A, 6); they are left out.
        states: Loop of each axis in each state of the laws on it, like ones together; () if gains are not stated.
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
    units: ClassVar = {"pose": "m, rad", "stiffness": "N/m, N m/rad", "damping": "N s/m, N m s/rad"}

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return pose, stiffness and damping of each axis."""
        gains = {"stiffness": np.diag(self.stiffness), "damping": np.diag(self.damping)}
        return {"axis": np.array(AXES), "pose": self.pose, **gains}

    def plot(self, path: Path | None = None) -> Any:
        """Draw the eigenvalues in the unit circle; see `Result.plot`."""
        from maglev_mj.theory.pictures import pole_map

        return save(pole_map(self), path)

    def table(self) -> Table:
        """Return a row for each state of the laws, or without stated gains the worst pose."""
        rows = [state.row() for state in self.states]
        if self.stated:
            where = f", with {' and '.join(self.acting)}" if self.acting else ""
            means = "by the laws' own gains"
        else:
            parts = [f"{axis} {value:g}" for axis, value in zip(AXES, self.pose, strict=True) if value]
            where = f"; at {', '.join(parts) or 'centre'} (m, rad)"
            means = "by the answers of the laws to small displacements"
        remarks = "\n".join([f"found {means}", *self.remarks])
        return Table(f"{self}{where}", ("axes", "state", "spectral radius", "margin", "verdict"), rows, remarks)

    def __str__(self) -> str:
        if self.stable and not self.spectral_radius:
            return f"{', '.join(self.axes)}: free"
        loop = f"{', '.join(self.axes)}: spectral radius {self.spectral_radius:.4g}" if self.axes else "stability"
        return f"{loop} {_word(self.stable)}"

    def as_json(self) -> dict[str, Any]:
        """Return the verdict, ready for JSON."""
        kept = {
            name: plain(getattr(self, name))
            for name in ("stable", "spectral_radius", "axes", "acting", "pose", "stated")
        }
        states = [{**plain(state), "margin": state.margin} for state in self.states]
        return {**kept, "states": states, "remarks": list(self.remarks)}

    @property
    def remarks(self) -> tuple[str, ...]:
        """Remarks on omitted poses, one line each."""
        omitted = (
            (self.unknown, "the controller remembers for longer than 512 samples"),
            (self.jumps, "the wrench jumps or bends"),
            (self.away, "the laws push away from the pose"),
        )
        return tuple(f"not judged at {len(poses)} poses, where {why}" for poses, why in omitted if len(poses))


class Judged(Protocol):
    """Interface of a scene for `stability`."""

    @property
    def delay(self) -> float:
        """Transport delay [s]."""

    def controller(self) -> Controller:
        """Return a new controller."""

    def start(self) -> Any:
        """Return the state at release, with its `pose`."""

    def plant_options(self) -> Mapping[str, Any]:
        """Return keywords of the plant.

        Those used are model, mass and inertia.
        """


def inertia_of(scene: Judged) -> Array:
    """Return a scene's mass and moments of inertia, (6,).

    In [kg, kg m²].

    Raises:
        ModelError: If the model of its device cannot be used.
    """
    options = scene.plant_options()
    body = np.array(INERTIA)
    if options.get("model") is not None:
        device = load_model(options["model"])
        body[:3], body[3:] = device.mass, device.inertia
    for name, axes in (("mass", slice(3)), ("inertia", slice(3, None))):
        if options.get(name) is not None:
            body[axes] = options[name]
    return body


def stability(scene: Judged, *, inertia: ArrayLike | None = None, delay: float | None = None) -> Verdict:
    """Return the stability verdict on a scene; see `judge`.

    Args:
        scene: The scene.
        inertia: Mass and moments of inertia in place of the scene's own [kg, kg m²], (6,).
        delay: Transport delay in place of the scene's own [s]; the gains of the scene stay unchanged.

    Raises:
        ParameterError: If `scene` is not a scene, or a value is outside its bounds.

    Example:
        >>> from maglev_mj import find_scene, stability
        >>> drop = find_scene("drop")
        >>> stability(drop(stiffness=6000.0)).stable, stability(drop(stiffness=20000.0)).stable
        (True, False)
    """
    if isinstance(scene, type) or not hasattr(scene, "controller"):
        raise ParameterError(f"scene must be a scene, such as find_scene('drop')(), not {scene!r}")
    body, late = inertia_of(scene) if inertia is None else inertia, scene.delay if delay is None else delay
    return judge(scene.controller(), delay=late, pose=scene.start().pose, inertia=body)


def judge(controller: Controller, *, delay: float, pose: ArrayLike = ZERO, inertia: ArrayLike = INERTIA) -> Verdict:
    """Return the stability verdict on a free flotor's loop.

    If all laws state their gains, it is a closed form in every combination of their states. Otherwise the whole
    controller is linearised at its start, at the centre, along each axis, and inside each face, and coupled axes are
    judged together.

    Args:
        controller: The controller, of laws for one device; it is not changed.
        delay: Transport delay [s], up to 10 periods.
        pose: Start of the flotor [m, rad], (6,).
        inertia: Mass and moments of inertia [kg, kg m²], (6,).

    Raises:
        ParameterError: If `controller` is no Controller, or a value is outside its bounds.
        MaglevError: If a law fails at a pose.

    Example:
        >>> from maglev_mj import Controller, Wall, judge
        >>> wall = Wall(axes="z", lower=0.0, stiffness=6000.0, damping=80.0)
        >>> judge(Controller([wall], period=0.005), delay=0.0015).stable
        True
    """
    check_instance("controller", controller, Controller, "a Controller")
    start, body = numbers("pose", pose), numbers("inertia", inertia, at_least=0.0, above=0.0)
    if start.shape != (6,) or body.shape != (6,):
        raise ParameterError(f"pose and inertia must be (6,), not {start.shape} and {body.shape}")
    number("delay", delay, at_least=0.0)
    gains = stated_gains(controller)
    if gains is None:
        return _numerically(controller, delay, start, body)
    return _by_gains(gains, controller, delay, start, body)


_Gains: TypeAlias = dict[tuple[str, ...], tuple[Array, Array]]


def stated_gains(controller: Controller) -> _Gains | None:
    """Return total gains for each combination of law states.

    Stiffness and damping on the six axes.

    None if a law states none, one is negative, or the velocity estimate is not linear.
    """
    sums: dict[str, Array] = {"always": np.zeros((2, len(AXES)))}
    for law in controller.laws:
        stated = law.gains()
        if stated is None or law.batch:
            return None
        for near in stated:
            sums[near.state] = sums.get(near.state, 0.0) + np.array([near.stiffness, near.damping])
    if not hasattr(controller.velocity, "linear"):
        return None
    always = sums.pop("always")
    states = sorted(state for state, gains in sums.items() if gains.any())
    totals = {}
    for acts in product((False, True), repeat=len(states)):
        acting = tuple(compress(states, acts))
        stiffness, damping = sum((sums[state] for state in acting), always)
        totals[acting] = stiffness, damping
    return None if any((gains < 0.0).any() for both in totals.values() for gains in both) else totals


def _by_gains(gains: _Gains, controller: Controller, delay: float, pose: Array, body: Array) -> Verdict:
    """Return the verdict from stated gains, in closed form."""
    kinds: dict[tuple[Any, ...], tuple[list[str], NDArray[Any]]] = {}
    own = [{acting: (float(k[axis]), float(b[axis])) for acting, (k, b) in gains.items()} for axis in range(len(AXES))]
    known = _known_roots(own, controller, delay, body)
    for axis, mass, mine in zip(AXES, body.tolist(), own, strict=True):
        here = [acting[0] for acting in gains if len(acting) == 1 and mine[acting] != mine[()]]
        for acting in (acting for acting in gains if set(acting) <= set(here)):
            stiffness, damping = mine[acting]
            free = 0 if stiffness > 0.0 else 1 if damping > 0.0 else 2
            roots = known[mass, stiffness, damping]
            others = tuple(name for name in here if name not in acting)
            kind = acting, others, round(_spectral_radius(roots, free), 12), free > 0
            kinds.setdefault(kind, ([], roots))[0].append(axis)
    states = tuple(LoopState(tuple(axes), *kind) for kind, (axes, _) in kinds.items())
    worst, (_, roots) = max(zip(states, kinds.values(), strict=True), key=lambda pair: pair[0].spectral_radius)
    stiff, damp = gains[worst.acting]
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


def _known_roots(
    own: Sequence[Mapping[tuple[str, ...], tuple[float, float]]], controller: Controller, delay: float, body: Array
) -> dict[tuple[float, float, float], NDArray[Any]]:
    """Return eigenvalues by mass, stiffness and damping; axes with the same share one computation."""
    known: dict[tuple[float, float, float], NDArray[Any]] = {}
    for mass in dict.fromkeys(body.tolist()):
        pairs = [*{pair: None for axis in np.flatnonzero(body == mass).tolist() for pair in own[axis].values()}]
        loop = SampledLoop(period=controller.period, delay=delay, mass=mass, velocity=controller.velocity)
        roots = np.linalg.eigvals(loop.matrix(*np.array(pairs).T))
        known |= {(mass, *pair): each for pair, each in zip(pairs, roots, strict=True)}
    return known


def _word(stable: bool | None) -> str:
    return {True: "stable", False: "UNSTABLE", None: "not known"}[stable]


def _spectral_radius(roots: NDArray[Any], free: int) -> float:
    """Return the spectral radius without the roots of free motion, those nearest to 1."""
    kept = np.argsort(np.abs(roots - 1.0))[free:]
    return float(np.abs(roots[kept]).max(initial=0.0))


class _Loop(NamedTuple):
    """Coupled axes at a pose."""

    near: Linearised
    axes: tuple[int, ...]
    scaled: Array
    settles: bool
    system: StateSpace | None
    """Without units; None for a short response, or one that no law of few states has."""
    still: int
    """Number of directions without stiffness."""
    moments: tuple[Array, Array]
    """Sums of the response and of its age times response, without units."""

    @property
    def pushes_away(self) -> bool:
        """True if the flotor leaves the pose by itself."""
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


def _loop(near: Linearised, axes: tuple[int, ...], own: Array, seen: list[_Loop]) -> _Loop:
    """Return the loop of some axes, added to those seen or like one of them."""
    settles = bool(near.settled[list(axes)].all())
    for one in seen:
        if one.axes == axes and one.settles == settles and _alike(one.scaled, own):
            return one._replace(near=near)
    memory = _memory(own)
    # the roots of a long response, cut off where it is small, are those of the cut
    system = realise(own[:memory]) if memory > _SHORT and np.isfinite(near.response).all() else None
    moments = (own.sum(axis=0), np.tensordot(np.arange(len(own)), own, 1)) if system is None else system.moments()
    sizes = np.linalg.svd(np.nan_to_num(moments[0], neginf=1.0), compute_uv=False)
    still = int((sizes <= _FREE * max(np.abs(own).sum(axis=0).max(), _FREE)).sum())
    seen.append(_Loop(near, axes, own, settles, system, still, moments))
    return seen[-1]


def _alike(one: Array, other: Array) -> bool:
    return bool(np.abs(one - other).max() <= _ROUNDING * np.abs(other).max())


def _own_spectral_radius(roots: NDArray[np.complex128], still: int) -> float:
    """Return the spectral radius without the roots of free motion.

    Each direction without stiffness has a root at exactly 1, and a second where there is no damping either. A virtual
    mass leaves both: nothing holds it and the flotor in place together. Such a pair is known to half of the digits, and
    its mean to nearly all.
    """
    near = roots[np.argsort(np.abs(roots - 1.0))][: 2 * still]
    free = [count for count in range(still, 2 * still + 1) if abs(near[:count].mean() - 1.0) < _PAIR] if still else []
    return _spectral_radius(roots, max(free, default=still))


class _Found(NamedTuple):
    """Loops of a controller by linearisation, and poses without any."""

    loops: list[_Loop]
    """Those at unstable equilibria among them only of axes that have no stable one."""
    away: list[_Loop]
    jumps: list[Array]
    unknown: list[Array]
    complete: bool
    """True if each axis has a loop, and none is unknown."""


def _linearised(controller: Controller, pose: Array, body: Array) -> _Found:
    loops: list[_Loop] = []
    away: list[_Loop] = []
    seen: list[_Loop] = []
    jumps, unknown, judged = [], [], set()
    for near in linearise(controller, _poses(controller, pose)):
        scaled = near.scaled(body)
        for axes in _coupled(scaled):
            chosen = list(axes)
            if near.jumps[chosen].any():
                jumps.append(near.pose)
                continue
            loop = _loop(near, axes, scaled[:, chosen][:, :, chosen], seen)
            if loop.system is None and not loop.settles:
                unknown.append(near.pose)
            elif loop.pushes_away:
                away.append(loop)
            else:
                loops.append(loop)
                judged |= set(axes)
    # an axis without a stable equilibrium is judged at the unstable ones
    lost = [loop for loop in away if not judged.issuperset(loop.axes)]
    nowhere = set(range(len(AXES))) - judged - {axis for loop in lost for axis in loop.axes}
    return _Found(loops + lost, away, jumps, unknown, not (nowhere or unknown))


def _numerically(controller: Controller, delay: float, pose: Array, body: Array) -> Verdict:
    """Return the verdict by linearisation."""
    found = _linearised(controller, pose, body)
    worst: _Loop | None = None
    spectral_radius, eigenvalues = np.nan, np.empty(0, dtype=np.complex128)
    for loop, roots in _roots(_grouped(found.loops), delay, body):
        own = _own_spectral_radius(roots, loop.still)
        if worst is None or own > spectral_radius * (1.0 + _ROUNDING):
            worst, spectral_radius, eigenvalues = loop, own, roots
    unstable = spectral_radius >= 1.0 - _ROUNDING
    stiffness, damping = np.full((2, 6, 6), np.nan) if worst is None else worst.gains(body)
    return Verdict(
        stable=not unstable if unstable or found.complete else None,
        spectral_radius=spectral_radius,
        axes=() if worst is None else tuple(AXES[axis] for axis in worst.axes),
        pose=pose if worst is None else worst.near.pose,
        stiffness=stiffness,
        damping=damping,
        eigenvalues=eigenvalues,
        stated=False,
        jumps=_distinct(found.jumps),
        unknown=_distinct(found.unknown),
        away=_distinct([loop.near.pose for loop in found.away]),
    )


def _roots(
    groups: Iterable[_Group], delay: float, body: Array, hand: Hand | None = None
) -> Iterator[tuple[_Loop, NDArray[np.complex128]]]:
    """Yield different loops with their eigenvalues; loops of one size are computed at once."""
    for different, systems, axes in groups:
        period, inertia = different[0].near.period, body[list(axes)]
        held = hand if hand is not None and set(axes) <= set(hand.indices) else None
        system = StateSpace(*map(np.array, zip(*systems))).with_units(period, inertia)
        matrices = system.closed_loop(period=period, delay=delay, inertia=inertia, hand=held)
        yield from zip(different, np.linalg.eigvals(matrices).astype(np.complex128), strict=True)


def _grouped(loops: Sequence[_Loop]) -> Iterator[_Group]:
    """Yield different loops of the same axes and size, with their systems and axes."""
    seen: dict[tuple[int, ...], list[_Loop]] = {}
    sizes: dict[tuple[tuple[int, ...], int], list[tuple[_Loop, StateSpace]]] = {}
    for loop in loops:
        same = seen.setdefault(loop.axes, [])
        if any(_alike(one.scaled, loop.scaled) for one in same):
            continue
        same.append(loop)
        system = loop.system or StateSpace.of(loop.scaled[: _memory(loop.scaled)])
        sizes.setdefault((loop.axes, len(system.advance)), []).append((loop, system))
    for (axes, _), group in sizes.items():
        different, systems = zip(*group)
        yield different, systems, axes


def axis_loop(
    controller: Controller, axis: int, *, pose: ArrayLike, delay: float, inertia: Array, hand: Hand | None = None
) -> tuple[float, float]:
    """Return static stiffness and spectral radius of one axis' loop with all that acts there.

    By the laws' own gains if all state them, otherwise by linearisation at a pose.

    Args:
        controller: The controller, of laws for one device; it is not changed.
        axis: Index into AXES; the other axes are left out.
        pose: Pose [m, rad], (6,).
        delay: Transport delay [s], up to 10 periods.
        inertia: Mass and moments of inertia [kg, kg m²], (6,).
        hand: The hand on the axis; None for a free flotor.

    Returns:
        Stiffness [N/m, N m/rad], infinite for an integrator, and spectral radius, below 1 for a stable loop; NaN if
        not known.

    Raises:
        MaglevError: If a law fails at the pose.

    Example:
        >>> import numpy as np
        >>> from maglev_mj import Controller, Wall
        >>> from maglev_mj.spec import INERTIA
        >>> wall = Controller([Wall(axes="z", lower=0.0, stiffness=6000.0, damping=80.0)], period=0.005)
        >>> inside, body = (0, 0, -1e-3, 0, 0, 0), np.array(INERTIA)
        >>> stiffness, spectral_radius = axis_loop(wall, 2, pose=inside, delay=0.0015, inertia=body)
        >>> round(stiffness), round(spectral_radius, 3)
        (6000, 0.877)
    """
    held = hand if hand is not None and axis in hand.indices else None
    if (gains := stated_gains(controller)) is not None:
        stiffness, damping = (float(both[axis]) for both in list(gains.values())[-1])
        around: Any = {"period": controller.period, "delay": delay, "velocity": controller.velocity}
        spectral_radius = SampledLoop(mass=inertia[axis], hand=held, **around).spectral_radius(stiffness, damping)
        return stiffness, float(spectral_radius)
    (near,) = linearise(controller, pose)
    loop = _loop(near, (axis,), near.scaled(inertia)[:, axis : axis + 1, axis : axis + 1], [])
    if near.jumps[axis] or (loop.system is None and not loop.settles):
        return math.nan, math.nan
    ((_, roots),) = _roots(_grouped([loop]), delay, inertia, hand)
    return float(loop.gains(inertia)[0][axis, axis]), _own_spectral_radius(roots, loop.still)


def delay_margins(
    controller: Controller, hands: Sequence[str], *, pose: ArrayLike = ZERO, inertia: ArrayLike = INERTIA
) -> dict[str, float]:
    """Return the longest delay that a controller's loops bear, free and in each hand [s].

    The controller is linearised once. A hand holds the translations; coupled translations and rotations are free.

    Args:
        controller: The controller, of laws for one device; it is not changed.
        hands: Names of hands; "none" for a free flotor.
        pose: Start of the flotor [m, rad], (6,).
        inertia: Mass and moments of inertia [kg, kg m²], (6,).

    Returns:
        By hand: 0 if a loop is unstable without delay, infinity if all are stable up to 30 ms or 10 periods, the
        shorter; NaN if a loop is not known.

    Raises:
        MaglevError: If a law fails at a pose.

    Example:
        >>> from maglev_mj import find_scene
        >>> from maglev_mj.theory.verdict import delay_margins
        >>> joystick = find_scene("joystick")(period=0.005)
        >>> round(delay_margins(joystick.controller(), ["none"])["none"] * 1e3, 2)  # [ms]
        2.91
    """
    check_instance("controller", controller, Controller, "a Controller")
    start, body = numbers("pose", pose), numbers("inertia", inertia, at_least=0.0, above=0.0)
    gains, period = stated_gains(controller), controller.period
    if gains is None:
        found = _linearised(controller, start, body)
        if not found.complete:
            return dict.fromkeys(hands, math.nan)
        loops = [*_grouped(found.loops)]

    def spectral_radius(delay: float, hand: Hand | None) -> float:
        if gains is not None:
            return _stated_spectral_radius(gains, controller, delay, body, hand)
        roots = (_own_spectral_radius(own, loop.still) for loop, own in _roots(loops, delay, body, hand))
        return max(roots, default=0.0)

    return {name: _margin(partial(spectral_radius, hand=get_hand(name)), period) for name in hands}


def _stated_spectral_radius(
    gains: _Gains, controller: Controller, delay: float, body: Array, hand: Hand | None
) -> float:
    """Return the spectral radius of the axes' loops, those of free motion left out."""
    worst = 0.0
    for part, held in ((slice(3), hand), (slice(3, 6), None)):
        stiffness, damping = (np.array([both[kind][part] for both in gains.values()]).ravel() for kind in (0, 1))
        mass = np.tile(body[part], len(gains))
        loop = SampledLoop(period=controller.period, delay=delay, mass=mass, hand=held, velocity=controller.velocity)
        roots = np.linalg.eigvals(loop.matrix(stiffness, damping))
        free = np.where(stiffness > 0.0, 0, np.where(damping > 0.0, 1, 2)) * (held is None)
        worst = max(worst, *map(_spectral_radius, roots, free))
    return worst


def _margin(spectral_radius: Callable[[float], float], period: float) -> float:
    """Return the first delay at which a spectral radius reaches 1 [s]."""
    grid = np.arange(0.0, min(_LONGEST, MOST_PERIODS * period) + 1e-12, max(period / _PER_PERIOD, _FINEST))
    first = next((place for place, delay in enumerate(grid) if spectral_radius(delay) >= 1.0 - _ROUNDING), None)
    if not first:
        return math.inf if first is None else 0.0
    low, high = grid[first - 1], grid[first]
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if spectral_radius(middle) >= 1.0 - _ROUNDING else (middle, high)
    return float(low)


def _memory(response: Array) -> int:
    """Return the number of samples up to the last answer."""
    return 1 + int(np.flatnonzero(response.any(axis=(1, 2))).max(initial=0))


def _coupled(scaled: Array) -> list[tuple[int, ...]]:
    """Return groups of coupled axes."""
    size = np.abs(scaled).max(axis=0)
    linked = (size > _ROUNDING * size.max(initial=0.0)) | np.eye(len(AXES), dtype=bool)
    linked = np.linalg.matrix_power(linked.astype(float), len(AXES)) > 0.0
    return list(dict.fromkeys(tuple(np.flatnonzero(row).tolist()) for row in linked))


def _poses(controller: Controller, start: Array) -> Array:
    """Return the poses of a verdict.

    Start, centre, poses along each axis, and inside each face.
    """
    (near,) = linearise(controller, start[None])
    start = start + _OFF * _SCALE * near.jumps  # on an edge of the wrench, each pose of the grid would be a jump
    rows = [start, np.zeros(6)]
    for axis, reach in enumerate(RANGE):
        rows += [_with(start, axis, value) for value in np.linspace(-1.0, 1.0, _POINTS) * reach * _STRIDE]
    for axis, normal, edge in controller.faces:
        rows += [_with(start, axis, float(edge) - normal * depth * _SCALE[axis]) for depth in _DEPTHS]
    return np.array(rows)


def _with(pose: Array, axis: int, value: float) -> Array:
    changed = pose.copy()
    changed[axis] = value
    return changed


def _distinct(poses: Sequence[Array]) -> Array:
    return np.unique(np.array(poses).reshape(-1, 6), axis=0)
