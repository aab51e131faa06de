"""Loops of a scene, a controller, a device or of numbers: nothing is left out."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, replace
from itertools import compress, islice, product
from os import PathLike
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.control import PassivityController
from maglev_mj.control.controller import Controller
from maglev_mj.device import Device, devices, lag_of
from maglev_mj.errors import KeywordError, ParameterError, TooManyCallsError, check_one_of, choice_message
from maglev_mj.frames import AXES, ZERO, Array
from maglev_mj.keywords import with_period
from maglev_mj.lazy import loaded
from maglev_mj.parameters import MEASURED_MOTIONS, loop_delay, number, numbers
from maglev_mj.plants.hand import Hand, get_hand, get_mode
from maglev_mj.spec import DEVICE_DELAY, DEVICE_PERIOD, INERTIA, RANGE
from maglev_mj.theory.doubts import doubts
from maglev_mj.theory.linearise import (
    MOST_SAMPLES_AS_STATES,
    ROUNDING_OF_RESPONSE,
    Linearised,
    is_ours,
    linearise,
    realise,
)
from maglev_mj.theory.loop import STILL, AtPose, Doubt, Loop, Loops, memory_of
from maglev_mj.theory.loop_array import is_linear
from maglev_mj.theory.poses import BESIDE_EDGE, POINTS, SCALE, edges_of, extremes_of, poses_of
from maglev_mj.theory.two_rates import DeviceLaw, laws_on_device

_KINDS_COMPARED = 4
"""Latest kinds of poses with which another pose is compared: fewer realise equal laws again, effort alone."""
JUMPS, UNKNOWN = "discontinuous force", "controller memory exceeds 512 samples"
_COUNTS, _SHARE_OF_DEPTH = (1.0, 10.0, 100.0), 0.9
"""Amplitudes at which a law in fixed point is linearised, in counts and as a share of the depth: inside an edge."""
_LEAST_COUNTS = 5.0
"""Least amplitude that is judged, in counts: within one count every law of counts rings, or rests."""
_UNDECLARED = "a law with walls on the device needs declared gains: define gains()"
"""Reasons why a loop cannot be judged."""

_FIELDS = tuple(item.name for item in fields(Loop) if item.name not in ("linear", "body", "pose", "reason"))
_OF_LINEARISED = "delay", "driver_lag", "hand"
"""Fields of laws linearised at a pose that may change: the other ones are in their responses."""
_OF_CONTROLLER = "delay", "pose", "inertia", "reach", "device", "driver_lag", "hand", "load", "poses"


def loops_of(what: Any = None, **changes: Any) -> Loops:
    """Return the loops of a scene, controller, device or of fields; see `Loop.of`."""
    if isinstance(what, Loops | Loop):
        found, around = _loops(what), _fields_of(changes)
        if any(one.linear is not None for one in found):
            _check_names(around, _OF_LINEARISED)
        return found.replace(**around) if around else found
    if isinstance(what, Controller):
        _check_names(changes, _OF_CONTROLLER)
        if changes.get("delay") is None:
            raise ParameterError("arguments of judge must be a controller and its delay, judge(controller, delay=...)")
        return of_controller(what, **changes)
    if isinstance(what, str | PathLike):
        what = _named(what, changes)
        if isinstance(what, Loops):
            return what
    if isinstance(what, type):
        what = what()
    if hasattr(what, "controller"):
        return of_scene(what, **changes)
    if isinstance(what, Device) or what is None:
        return _of_numbers(what, **changes)
    raise ParameterError(f"what must be a scene, controller, device, recording, loop or None (got {what!r})")


def _loops(what: Loop | Loops) -> Loops:
    return Loops((what,)) if isinstance(what, Loop) else what


def _named(what: Any, changes: dict[str, Any]) -> Any:
    """Return the scene, or device, of a name or file, or the loop that explains a recording."""
    text = str(what)
    if text.endswith(MEASURED_MOTIONS):
        found = loaded("maglev_mj.studies.diagnosis:diagnose")(what, **changes)
        return found.verdict.loops
    if text.endswith(".toml") or text in devices():
        return Device.load(text)
    return loaded("maglev_mj.scenes.find:get_scene")(text)


def _fields_of(changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return fields of a loop with texts replaced."""
    found = with_period(_FIELDS, changes)
    _check_names(found, _FIELDS)
    if "hand" in found:
        found["hand"] = get_hand(found["hand"])
    return found | ({"mode": get_mode(found["mode"])} if "mode" in found else {})


def _check_names(changes: Iterable[str], names: Sequence[str]) -> None:
    if wrong := [name for name in changes if name not in names]:
        raise KeywordError(choice_message("argument of judge", ("what", *names), wrong[0]))


def _of_numbers(what: Device | None, *, device: Any = None, axis: str = "z", **values: Any) -> Loops:
    """Return the loop of fields, those of a device in place of missing ones."""
    check_one_of("axis", AXES, axis)
    if isinstance(device, str | PathLike | Device):
        what, device = device if isinstance(device, Device) else Device.load(str(device)), None
    own: dict[str, Any] = {"axis": axis, "device": device}
    if what is not None:
        own |= {"period": what.period, "delay": what.delay, "driver_lag": lag_of(what)}
        own["inertia"] = float(what.inertia[AXES.index(axis)])
    given = _fields_of(values)
    missing = [name for name in ("stiffness", "damping", "period", "delay", "inertia") if name not in own | given]
    if missing:
        raise ParameterError(f"{' and '.join(missing)} of the loop must be given, or a device")
    gains = {name: number(name, (own | given)[name]) for name in ("stiffness", "damping", "inertia")}
    return Loops((Loop(**own | given | gains),))


def of_scene(
    scene: Any,
    *,
    inertia: ArrayLike | None = None,
    delay: float | None = None,
    driver_lag: float | None = None,
    hand: Hand | str | None = None,
    poses: ArrayLike | None = None,
    controller: Controller | None = None,
    probed: _Probed | None = None,
    **changes: Any,
) -> Loops:
    """Return the loops of a scene; see `Loop.of`.

    Args:
        scene: The scene.
        inertia: Mass and moments of inertia in place of the scene's own [kg, kg m²], (6,).
        delay: Transport delay in place of the scene's own [s]; gains derived from the delay do not change.
        driver_lag: Time constant of the drivers in place of the device's [s].
        hand: Hand that may hold the flotor in place of the scene's own; "none" for a free flotor alone.
        poses: Poses at which laws without declared gains are linearised in place of all these [m, rad], (P, 6).
        controller: Controller that was made by this scene; None to make it.
        probed: What `probed_at` found.
        changes: Parameters of the scene.
    """
    scene = scene.replace(**changes) if changes else scene
    controller, body = scene.controller() if controller is None else controller, scene.body.bounded
    own: Any = {
        "delay": scene.delay if delay is None else delay,
        "inertia": body.inertia if inertia is None else inertia,
    }
    own["device"] = scene.device_clock if controller.on_device else (DEVICE_PERIOD, DEVICE_DELAY)
    own |= {
        "driver_lag": scene_lag(scene) if driver_lag is None else driver_lag,
        "hand": scene_hand(scene) if hand is None else get_hand(hand),
    }
    where: Any = {"pose": scene.start().pose, "reach": body.range, "load": body.load, "poses": poses}
    found = of_controller(controller, probed=probed, **where, **own)
    return replace(found, grown=grown_of(scene, own))


def grown_of(scene: Any, around: Mapping[str, Any]) -> Callable[[Loop, float], Loop] | None:
    """Return the function from a loop of a scene and a ratio to the loop with that ratio of the scene's stiffness.

    Args:
        scene: The scene.
        around: Other keywords of `of_controller`.
    """
    if not getattr(scene, "stiffness", 0.0):
        return None
    around = {**around, "hand": None}

    def grown(loop: Loop, ratio: float) -> Loop:
        controller = scene.replace(stiffness=ratio * scene.stiffness).controller()
        if loop.linear is None:
            same = [
                one for one in of_controller(controller, **around) if (one.axis, one.state) == (loop.axis, loop.state)
            ]
            return same[0].in_hand(loop.hand) if same else loop
        own: Any = {**around, "inertia": numbers("inertia", around["inertia"])}
        near, axis = loop.linear.near, AXES.index(loop.axes[0])
        if near.resolution:
            own |= {"amplitude": near.amplitude[axis], "resolution": near.resolution}
        return loops_at([controller], axis, poses=[loop.pose or ZERO], **own)[0].in_hand(loop.hand)

    return grown


def scene_lag(scene: Any) -> float:
    """Return the time constant of the drivers of a scene's device [s]; 0 without a device."""
    hardware = getattr(scene, "hardware", None)
    return 0.0 if hardware is None else lag_of(hardware)


def scene_hand(scene: Any) -> Hand | None:
    """Return the impedance of a scene's scripted hand; None without one."""
    scripted = scene.scripted_hand() if hasattr(scene, "scripted_hand") else None
    hand = getattr(scripted, "hand", None)
    return hand if isinstance(hand, Hand) and not hand.shape else None


def of_controller(
    controller: Controller,
    *,
    delay: float,
    pose: ArrayLike = ZERO,
    inertia: ArrayLike = INERTIA,
    reach: ArrayLike = RANGE,
    device: ArrayLike = (DEVICE_PERIOD, DEVICE_DELAY),
    driver_lag: float = 0.0,
    hand: Hand | str | None = None,
    load: ArrayLike = ZERO,
    poses: ArrayLike | None = None,
    probed: _Probed | None = None,
) -> Loops:
    """Return the loops of a controller on all axes; see `judge`."""
    start, body = numbers("pose", pose, shape="(6,)"), numbers("inertia", inertia, shape="(6,)", above=0.0)
    loop_delay(number("delay", delay), controller.period)
    clock: Any = numbers("device", device, shape="(2,)").tolist()
    around: Any = {"period": controller.period, "delay": float(delay), "driver_lag": driver_lag}
    gains, far = stated_gains(controller), numbers("reach", reach, shape="(6,)", above=0.0)
    if gains is None and controller.on_device:
        found = _nothing(_UNDECLARED, start, body, around)
    elif gains is None:
        try:
            if probed is None:
                weight = numbers("load", load, shape="(6,)")
                (probed,) = probed_at([controller], pose=start, reach=far, load=weight, poses=poses)
            found = _linearised(start, body, far, around, probed)
        except TooManyCallsError as error:
            found = _nothing(str(error).removeprefix("stability not computed: "), start, body, around)
    else:
        found = _stated(gains, controller, body, laws_on_device(controller, tuple(clock)), start, around)
    return replace(found, partial=partial_laws(controller), reach=far).free_and_held(get_hand(hand))


def partial_laws(controller: Controller) -> tuple[str, ...]:
    """Return the names of laws that declare the gains of a part of them: of users, and passivity controllers."""
    stated = [law for law in controller.laws if law.gains() is not None]
    own = (law for law in stated if not is_ours(type(law)) or isinstance(law, PassivityController))
    return tuple(dict.fromkeys(type(law).__name__ for law in own))


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
    if not is_linear(controller.velocity):
        return None
    always = sums.pop("always")
    states = sorted({*["contact"] * controller.on_device, *(state for state, gains in sums.items() if gains.any())})
    totals = {}
    for active in product((False, True), repeat=len(states)):
        acting = tuple(compress(states, active))
        stiffness, damping = sum((sums[state] for state in acting), always)
        totals[acting] = stiffness, damping
    return None if any((gains < 0.0).any() for both in totals.values() for gains in both) else totals


def _stated(
    gains: _Gains,
    controller: Controller,
    body: Array,
    laws: Mapping[int, DeviceLaw],
    start: Array,
    around: Mapping[str, Any],
) -> Loops:
    """Return the loop of each axis in each combination of the states of its laws, from declared gains."""
    loops = []
    for index, axis in enumerate(AXES):
        own = {
            acting: (float(k[index]), float(b[index]), laws.get(index) if "contact" in acting else None)
            for acting, (k, b) in gains.items()
        }
        states = [acting[0] for acting in gains if len(acting) == 1 and own[acting] != own[()]]
        for acting, (stiffness, damping, law) in own.items():
            if set(acting) <= set(states):
                loop: Any = {"stiffness": stiffness, "damping": damping, "device": law, "inertia": float(body[index])}
                loop |= {"axis": axis, "state": acting, "others": tuple(one for one in states if one not in acting)}
                loops.append(Loop(**loop, velocity=controller.velocity, **around))
    return Loops(tuple(loops), start=start)


class _Probed(NamedTuple):
    """A controller without declared gains, probed and linearised.

    Attributes:
        doubts: What probes found, by index of the axis.
        counts: Laws in fixed point linearised at one count and more, by index of the axis.
        grid: Laws linearised at poses; empty if no axis can be judged.
        regions: Indices of axes with a region of discontinuous force.
    """

    doubts: Mapping[int, Doubt]
    counts: Mapping[int, Sequence[Linearised]]
    grid: Sequence[Linearised] = ()
    regions: Collection[int] = ()


def probed_at(
    controllers: Sequence[Controller], *, pose: Array, reach: Array, load: Array, poses: ArrayLike | None = None
) -> list[_Probed]:
    """Return controllers probed and linearised, all together; arguments as for `doubts`.

    Args:
        controllers: Controllers of equal laws with other gains.
        pose: Pose at the start [m, rad], (6,).
        reach: Range of motion [m, rad], (6,).
        load: Constant external force [N, N m], (6,).
        poses: Poses of each [m, rad], (P, 6); None for all, those at edges, and those at which a law carries a load.
    """
    each = doubts(controllers, pose=pose, reach=reach, load=load)
    result = [
        _Probed(one, _by_amplitude(controller, one, pose)) for controller, one in zip(controllers, each, strict=True)
    ]
    some = [index for index, one in enumerate(result) if sum(doubt.void for doubt in one.doubts.values()) < len(AXES)]
    own = [controllers[index] for index in some]
    if not own:
        return result
    chosen = poses_of(own, pose, reach) if poses is None else [np.atleast_2d(poses)] * len(own)
    grids = _linearised_at(own, chosen)
    if poses is None:
        lines = slice(2, 2 + len(AXES) * POINTS)
        others = [
            [*edges_of(controller, grid[lines]), *extremes_of(controller, pose, reach), *_rests(result[index], pose)]
            for index, controller, grid in zip(some, own, grids)
        ]
        grids = [grid + more for grid, more in zip(grids, _linearised_at(own, others))]
    for index, grid, regions in zip(some, grids, _regions(own, grids)):
        result[index] = result[index]._replace(grid=grid, regions=regions)
    return result


def _by_amplitude(controller: Controller, found: Mapping[int, Doubt], pose: Array) -> dict[int, Sequence[Linearised]]:
    """Return laws in fixed point linearised at one count, at some more, and at the depth of the motion, by axis."""
    result = dict[int, Sequence[Linearised]]()
    for axis, doubt in found.items():
        if not doubt.resolution:
            continue
        at, own = np.where(np.arange(len(AXES)) == axis, doubt.position, pose), in_use(doubt)
        sizes = [count * doubt.resolution for count in _COUNTS]
        each = [*({**own, "amplitude": size} for size in sizes if size < own["amplitude"]), own]
        with suppress(TooManyCallsError):
            result[axis] = [linearise(controller, at, axes=AXES[axis], **one)[0] for one in each]
    return result


def in_use(doubt: Doubt | None) -> dict[str, float]:
    """Return amplitude and resolution at which laws in fixed point are linearised in use; empty for other laws."""
    if doubt is None or not doubt.resolution:
        return {}
    return {"amplitude": _SHARE_OF_DEPTH * doubt.depth, "resolution": doubt.resolution}


def _rests(probed: _Probed, pose: Array) -> list[Array]:
    """Return the poses at which laws carry a load on an axis [m, rad], six each."""
    return [
        np.where(np.arange(len(AXES)) == axis, rest, pose) for axis, one in probed.doubts.items() for rest in one.rests
    ]


def _linearised_at(
    controllers: Sequence[Controller], poses: Sequence[Sequence[Array] | Array], axes: str | Sequence[str] = AXES
) -> list[list[Linearised]]:
    """Return each controller linearised at its poses, all together."""
    rows = [controller for controller, own in zip(controllers, poses) for _ in own]
    each = np.concatenate([np.reshape(own, (-1, len(AXES))) for own in poses])
    near = iter(linearise(rows, each, axes=axes) if rows else ())
    return [list(islice(near, len(own))) for own in poses]


def _linearised(pose: Array, body: Array, reach: Array, around: Mapping[str, Any], probed: _Probed) -> Loops:
    """Return the loop of coupled axes at each pose at which they differ, and those that cannot be judged."""
    loops: list[AtPose] = []
    away: list[AtPose] = []
    previous: list[AtPose] = []
    judged = set[int]()
    jumps: list[Array] = []
    unknown: list[Array] = []
    reasons: dict[int, str] = {}
    found, _, grid, regions = probed
    void = {axis for axis, doubt in found.items() if doubt.void}
    if len(void) == len(AXES):
        items = [_not_judged(axis, found[axis].reason, body, around) for axis in range(len(AXES))]
        items += _loops_of_counts(probed, body, around)
        return Loops(tuple(items), False, pose, doubts=found, reach=reach)
    kinds: list[_Kind] = []
    for near in grid:
        scaled = near.scaled(body)
        kind = next((one for one in kinds[-_KINDS_COMPARED:] if one.has(near, scaled)), None)
        if kind is None:
            kind = _Kind.of(near, scaled, previous)
            kinds.append(kind)
        jumps += [near.pose] * kind.jumping
        for part in kind.parts:
            loop = part._replace(near=near)
            if loop.system is None and not loop.settles:
                unknown.append(near.pose)
                reasons |= dict.fromkeys(loop.axes, UNKNOWN)
            elif loop.unstable_equilibrium:
                away.append(loop)
            else:
                loops.append(loop)
                judged |= set(loop.axes)
    # an axis without a stable equilibrium is judged at the unstable ones
    unstable = [loop for loop in away if not judged.issuperset(loop.axes)]
    without = set(range(len(AXES))) - judged - {axis for loop in unstable for axis in loop.axes}
    for axis in sorted(without.union(regions)):
        reasons.setdefault(axis, JUMPS)
    for axis, doubt in found.items():
        if doubt.reason:
            reasons.setdefault(axis, doubt.reason)
    valid = [loop for loop in loops + unstable if not void.intersection(loop.axes)]
    items = [_loop(one, body, around) for one in _distinct_loops(valid)]
    items += [_not_judged(axis, reason, body, around) for axis, reason in sorted(reasons.items())]
    items += _loops_of_counts(probed, body, around)
    skipped = _distinct(jumps), _distinct(unknown), _distinct([loop.near.pose for loop in away])
    return Loops(tuple(items), False, pose, *skipped, doubts=found, reach=reach)


def _loops_of_counts(probed: _Probed, body: Array, around: Mapping[str, Any]) -> list[Loop]:
    """Return the loops of laws in fixed point, those within a few counts not judged."""
    items = []
    for axis, each in probed.counts.items():
        one, doubt = slice(axis, axis + 1), probed.doubts[axis]
        for near in each:
            at = _at_pose(near, (axis,), near.scaled(body)[:, one, one], [])
            small = near.amplitude[axis] < _LEAST_COUNTS * near.resolution
            reason = doubt.reason if small or at.unstable_equilibrium else "" if at.system or at.settles else UNKNOWN
            items.append(replace(_loop(at, body, around), reason=reason))
    return items


class _Kind(NamedTuple):
    """Poses with equal responses.

    Attributes:
        near: The first of them.
        scaled: Its dimensionless response, (M, 6, 6).
        tolerance: Tolerance of a response, (6, 6).
        parts: Laws of each group of coupled axes.
        jumping: True if the force on another group is discontinuous.
    """

    near: Linearised
    scaled: Array
    tolerance: Array
    parts: Sequence[AtPose]
    jumping: bool

    @classmethod
    def of(cls, near: Linearised, scaled: Array, previous: list[AtPose]) -> _Kind:
        """Return the kind of a pose; laws equal to previous ones reuse their realisation."""
        tolerance, parts = np.full((6, 6), ROUNDING_OF_RESPONSE * float(np.abs(scaled).max())), list[AtPose]()
        groups = [[*axes] for axes in _coupled(scaled)]
        for chosen in groups:
            own = scaled[:, chosen][:, :, chosen]
            tolerance[np.ix_(chosen, chosen)] = ROUNDING_OF_RESPONSE * float(np.abs(own).max())
            if not near.jumps[chosen].any():
                parts.append(_at_pose(near, tuple(chosen), own, previous))
        return cls(near, scaled, tolerance, parts, len(parts) < len(groups))

    def has(self, near: Linearised, scaled: Array) -> bool:
        """Return True if another pose is one of them."""
        if (near.jumps != self.near.jumps).any() or (near.settled != self.near.settled).any():
            return False
        return len(scaled) == len(self.scaled) and bool(
            (np.abs(scaled - self.scaled).max(axis=0) <= self.tolerance).all()
        )


def _loop(at: AtPose, body: Array, around: Mapping[str, Any]) -> Loop:
    """Return the loop of laws linearised at a pose; its gains are those of the first axis."""
    stiffness, damping = at.gains(body)
    first = at.axes[0]
    gains: Any = {"stiffness": float(stiffness[first, first]), "damping": float(damping[first, first])}
    axis, pose = ", ".join(AXES[axis] for axis in at.axes), tuple(at.near.pose.tolist())
    return Loop(**gains, axis=axis, inertia=float(body[first]), pose=pose, linear=at, body=tuple(body), **around)


def _not_judged(axis: int, reason: str, body: Array, around: Mapping[str, Any]) -> Loop:
    gains: Any = {"stiffness": np.nan, "damping": np.nan}
    return Loop(**gains, axis=AXES[axis], inertia=float(body[axis]), reason=reason, **around)


def _at_pose(near: Linearised, axes: tuple[int, ...], own: Array, previous: list[AtPose]) -> AtPose:
    """Return the laws of some axes; laws equal to previous ones reuse their realisation."""
    settles = bool(near.settled[list(axes)].all())
    for other in previous:
        if other.axes == axes and other.settles == settles and _alike(other.scaled, own):
            return other._replace(near=near)
    memory = memory_of(own)
    # truncating a long response would add the poles of the truncation
    system = realise(own[:memory]) if memory > MOST_SAMPLES_AS_STATES and np.isfinite(near.response).all() else None
    moments = (own.sum(axis=0), np.tensordot(np.arange(len(own)), own, 1)) if system is None else system.moments()
    sizes = np.linalg.svd(np.nan_to_num(moments[0], neginf=1.0), compute_uv=False)
    still = int((sizes <= STILL * max(np.abs(own).sum(axis=0).max(), STILL)).sum())
    static = np.linalg.eigvals(-moments[0]).real if np.isfinite(moments[0]).all() else np.zeros(1)
    away = bool(static.min() < -STILL * np.abs(own).max())
    previous.append(AtPose(near, axes, own, settles, system, still, moments, away))
    return previous[-1]


def _alike(first: Array, second: Array) -> bool:
    return len(first) == len(second) and bool(
        np.abs(first - second).max() <= ROUNDING_OF_RESPONSE * np.abs(second).max()
    )


def _distinct_loops(loops: Sequence[AtPose]) -> list[AtPose]:
    """Return the first of those with equal axes and responses."""
    kept: dict[tuple[int, ...], list[AtPose]] = defaultdict(list)
    for loop in loops:
        if not any(_alike(other.scaled, loop.scaled) for other in kept[loop.axes]):
            kept[loop.axes].append(loop)
    return [loop for some in kept.values() for loop in some]


def _regions(controllers: Sequence[Controller], grids: Sequence[Sequence[Linearised]]) -> list[set[int]]:
    """Return the axes of each with a region of discontinuous force; it is smooth to both sides of an edge alone."""
    found = [set[int]() for _ in controllers]
    for axis, name in enumerate(AXES):
        beside = [_beside(_distinct([near.pose for near in grid if near.jumps[axis]]), axis) for grid in grids]
        for regions, near in zip(found, _linearised_at(controllers, beside, name)):
            regions.update([axis] * any(one.jumps[axis] for one in near))
    return found


def _beside(poses: Array, axis: int) -> Array:
    """Return poses moved to both sides on an axis."""
    moved = np.repeat(poses, 2, axis=0)
    moved[:, axis] += np.tile([-BESIDE_EDGE, BESIDE_EDGE], len(poses)) * SCALE[axis]
    return moved


def _coupled(scaled: Array) -> list[tuple[int, ...]]:
    """Return groups of coupled axes."""
    size = np.abs(scaled).max(axis=0)
    linked = (size > ROUNDING_OF_RESPONSE * size.max(initial=0.0)) | np.eye(len(AXES), dtype=bool)
    linked = np.linalg.matrix_power(linked.astype(float), len(AXES)) > 0.0
    return list(dict.fromkeys(tuple(np.flatnonzero(row).tolist()) for row in linked))


def _distinct(poses: Sequence[Array]) -> Array:
    return np.unique(np.array(poses).reshape(-1, 6), axis=0)


def loops_at(
    controllers: Sequence[Controller],
    axis: int,
    *,
    poses: ArrayLike,
    delay: float,
    inertia: Array,
    hand: Hand | None = None,
    device: tuple[float, float] = (DEVICE_PERIOD, DEVICE_DELAY),
    driver_lag: float = 0.0,
    **sizes: float,
) -> Loops:
    """Return the loop of one axis with all of its laws active, for each controller.

    From the declared gains, or linearised at its pose, all together, if a law declares none.

    Args:
        controllers: Controllers of equal laws with other gains, for one device each; none is changed.
        axis: Index into AXES; coupling to the other axes is ignored.
        poses: Pose of each [m, rad], (N, 6).
        delay: Transport delay [s], up to 1 s.
        inertia: Mass and moments of inertia [kg, kg m²], (6,).
        hand: The hand on the axis; None for a free flotor.
        device: See `judge`.
        driver_lag: See `judge`.
        sizes: Amplitude and resolution of a linearisation, see `linearise`.

    Raises:
        MaglevError: If a law fails at a pose.

    Example:
        >>> import numpy as np
        >>> from maglev_mj import Controller, Wall
        >>> from maglev_mj.spec import INERTIA
        >>> wall = Controller([Wall(axes="z", lower=0.0, stiffness=6000.0, damping=80.0)], period=0.005)
        >>> inside, body = (0, 0, -1e-3, 0, 0, 0), np.array(INERTIA)
        >>> (loop,) = loops_at([wall], 2, poses=[inside], delay=0.0015, inertia=body)
        >>> round(loop.stiffness), round(loop.spectral_radius, 3)
        (6000, 0.877)
    """
    around: Any = {"delay": delay, "driver_lag": driver_lag}
    each = [stated_gains(controller) for controller in controllers]
    if all(gains is not None for gains in each):
        items = []
        for controller, gains in zip(controllers, each, strict=True):
            stiffness, damping = (float(both[axis]) for both in list((gains or {}).values())[-1])
            law = laws_on_device(controller, device).get(axis)
            own: Any = {"period": controller.period, "velocity": controller.velocity, "device": law}
            own |= {"stiffness": stiffness, "damping": damping, "inertia": float(inertia[axis]), "axis": AXES[axis]}
            items.append(Loop(**own, **around))
        found = Loops(tuple(items))
    else:
        found = Loops(tuple(_along(controllers, axis, poses, inertia, around, sizes)), False)
    return found if hand is None else found.replace(hand=hand)


def scene_doubts(scenes: Sequence[Any], axis: int) -> list[Doubt | None]:
    """Return what probes of one axis found in scenes that differ in gains alone; None for declared gains."""
    controllers = [scene.controller() for scene in scenes]
    own = [index for index, one in enumerate(controllers) if stated_gains(one) is None]
    result: list[Doubt | None] = [None] * len(controllers)
    if own:
        first = scenes[own[0]]
        around: Any = {"reach": first.body.bounded.range, "load": first.body.load, "axes": [axis]}
        for index, found in zip(
            own, doubts([controllers[one] for one in own], pose=first.start().pose, **around), strict=True
        ):
            result[index] = found.get(axis)
    return result


def with_doubt(loops: Sequence[Loop], doubt: Doubt | None) -> list[Loop]:
    """Return the loops of one axis, not judged, or beside one that is not judged, where a probe gives a reason."""
    if doubt is None or not doubt.reason or not loops:
        return [*loops]
    doubted = [replace(loop, reason=loop.reason or doubt.reason) for loop in loops]
    return doubted if doubt.void else [*loops, doubted[0]]


def _nothing(reason: str, start: Array, body: Array, around: Mapping[str, Any]) -> Loops:
    """Return the loops of a controller that cannot be judged on any axis."""
    return Loops(tuple(_not_judged(axis, reason, body, around) for axis in range(len(AXES))), False, start)


def _along(
    controllers: Sequence[Controller],
    axis: int,
    poses: ArrayLike,
    inertia: Array,
    around: Mapping[str, Any],
    sizes: Mapping[str, float],
) -> list[Loop]:
    """Return the loop of one axis for each controller, by linearisation at its pose."""
    clocks: list[Any] = [{"period": controller.period, **around} for controller in controllers]
    try:
        linear = linearise(controllers, poses, axes=AXES[axis], **sizes)
    except TooManyCallsError as error:
        return [_not_judged(axis, str(error), inertia, clock) for clock in clocks]
    one, previous = slice(axis, axis + 1), list[AtPose]()
    result = []
    for near, clock in zip(linear, clocks, strict=True):
        at = _at_pose(near, (axis,), near.scaled(inertia)[:, one, one], previous)
        reason = JUMPS if near.jumps[axis] and not sizes else "" if at.system or at.settles else UNKNOWN
        loop = _not_judged(axis, reason, inertia, clock) if reason else _loop(at, inertia, clock)
        result.append(loop)
    return result
