"""Stability check of a scene on every axis, and limit of force steps at the present pose."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj import theory
from maglev_mj.control.controller import Controller
from maglev_mj.errors import MaglevError, ParameterError, check_instance, named
from maglev_mj.frames import AXES, ZERO, Array, Mask, Sample, Six, components
from maglev_mj.parameters import numbers
from maglev_mj.scenes.find import line_of
from maglev_mj.scenes.scene import Scene, Start
from maglev_mj.scenes.wall_scene import WallScene, along
from maglev_mj.spec import GRAVITY
from maglev_mj.theory.closed_loop import bisect
from maglev_mj.theory.margin import Margin
from maglev_mj.theory.verdict import axis_loops, scene_lag, stability, stated_gains, stated_spectral_radii

STEP_FORCE = 2.0
"""Default limit of force steps caused by other programs [N].

Over the whole range of 9 mm it accelerates a free flotor to 0.23 m/s, less than a device's host allows.
"""

UNKNOWN = "stability not computed"
"""First part of the reason to refuse a scene without a verdict."""

_LAWS = {"contact": "walls", "stuck": "friction"}
_ARM = 0.05
"""Lever arm that converts a torque to a force [m], about the radius of the flotor."""

FINE, ROUGH = (1.2, 14, 13), (2.0, 8, 10)
"""Searches of a critical gain: factor per step, steps, bisections."""


@contextmanager
def user_errors_rejected() -> Iterator[None]:
    """Reject parameters at which user code fails, because they must not end a session or a flight.

    Raises:
        ParameterError: If the code in the context fails.
    """
    try:
        yield
    except MaglevError:
        raise
    except Exception as error:
        line, reason = line_of(error), f"{type(error).__name__}: {error}"
        raise ParameterError(f"parameters rejected: {reason if line is None else f'{line}: {reason}'}") from error


def unstable_loop(scene: Scene, *, inertia: ArrayLike | None = None, delay: float | None = None) -> Margin | None:
    """Return the margin of a scene's worst loop with a free flotor if unstable, or None; see `judge`.

    The critical delay is longer in the published arm and fingertip, and up to 10 % shorter in the stylus (1000 to
    8000 N/m, 20 to 100 N s/m, 200 Hz to 1 kHz).

    Args:
        scene: The scene, with the present period and delay.
        inertia: Mass and moments of inertia in place of the scene's own [kg, kg m²], (6,).
        delay: See `stability`.

    Raises:
        ParameterError: If the stability cannot be computed.
    """
    period, delay = scene.period, scene.delay if delay is None else delay
    body = scene.body.inertia if inertia is None else numbers("inertia", inertia)
    verdict = stability(scene, inertia=body, delay=delay)
    if verdict.stable:
        return None
    if verdict.stable is None:
        raise ParameterError(f"stability {'; '.join(verdict.remarks)}")
    index = AXES.index(verdict.axes[0])
    stiffness, damping = (float(gain[index, index]) for gain in (verdict.stiffness, verdict.damping))
    around: Any = {"period": period, "delay": delay}
    ratio = math.nan
    if verdict.stated and not scene.controller().on_device:
        around |= {"mass": body[index], "velocity": scene.controller().velocity, "driver_lag": scene_lag(scene)}
        ratio = float(theory.largest_stable_stiffness(damping, **around)) / stiffness if stiffness else 0.0
    acting = " and ".join(_LAWS.get(state, state) for state in verdict.acting)
    acting = acting or ("other laws" if verdict.stated else "all laws")
    return Margin(stiffness, damping, verdict.spectral_radius, ratio, AXES[index], acting, period, delay)


def wall_margin(
    scene: Scene, *, inertia: ArrayLike | None = None, delay: float | None = None, held: bool = False
) -> Margin | None:
    """Return the margin of a scene's wall with the largest spectral radius; None without a wall.

    Laws that declare no gains are linearised at the depth at which the wall carries the weight. The critical stiffness
    is NaN above tenfold, or if a law needs too many calls.

    Args:
        scene: See `unstable_loop`.
        inertia: See `unstable_loop`.
        delay: See `stability`.
        held: True for the scripted hand on the flotor; False for a free flotor.

    Raises:
        MaglevError: If a law fails.

    Example:
        >>> from maglev_mj import find_scene
        >>> print(wall_margin(find_scene("drop")()))
        stable: 59 % of critical stiffness, spectral radius 0.8771
    """
    body = scene.body.inertia if inertia is None else numbers("inertia", inertia)
    delay, gain = scene.delay if delay is None else delay, getattr(scene, "stiffness", 0.0)
    faces = scene.controller().faces or ([(2, 1.0, 0.0)] if isinstance(scene, WallScene) else [])
    if not (faces and gain):
        return None
    hand = getattr(scene.scripted_hand(), "hand", None) if held else None

    around: Any = {"delay": delay, "inertia": body, "hand": hand, "device": scene.timing().device}
    around["driver_lag"] = scene_lag(scene)

    def loop(factor: float, axis: int, normal: float, edge: float) -> tuple[float, float]:
        controller = (scene if factor == 1.0 else scene.replace(stiffness=factor * gain)).controller()
        pose = along(AXES[axis], edge - normal * float(body[0]) * GRAVITY / gain)
        ((stiffness, spectral_radius),) = axis_loops([controller], axis, poses=[pose], **around)
        return stiffness, spectral_radius

    loops = {face: loop(1.0, *face) for face in faces}
    worst = max(faces, key=lambda face: loops[face][1])
    stiffness, spectral_radius = loops[worst]
    factor = critical_ratios(lambda _, ratios: [loop(ratios[0], *worst)[1]], [spectral_radius], FINE)[0]
    factor = factor if 0.0 < factor < math.inf else math.nan
    return Margin(stiffness, math.nan, spectral_radius, factor, AXES[worst[0]], "walls", scene.period, delay)


def critical_ratios(
    radii: Callable[[Sequence[int], Sequence[float]], Sequence[float]],
    present: Sequence[float],
    search: tuple[float, int, int],
) -> list[float]:
    """Return the ratio of critical to present gain of N loops, by steps of a factor and bisection.

    Infinite if stiffer walls are stable up to the last step, 0 if softer ones are unstable, NaN if not computed.

    Args:
        radii: Function of indices and ratios of some loops that returns their spectral radii; NaN if not computed.
        present: Spectral radius of each loop at its present gain, N.
        search: FINE or ROUGH.
    """
    factor, most, halvings = search
    stable, valid = np.array(present) < 1.0, ~np.isnan(present)

    def changed(ratios: Array) -> Mask:
        """Return True where stability at a ratio above 0 differs from the present; not valid if not computed."""
        asked = np.flatnonzero((ratios > 0.0) & valid)
        found, result = np.full(asked.shape, math.nan), np.zeros(ratios.shape, dtype=bool)
        if asked.size:
            with suppress(ParameterError):  # out of bounds
                found[:] = radii(asked.tolist(), ratios[asked].tolist())
        valid[asked] = ~np.isnan(found)
        result[asked] = valid[asked] & ((found < 1.0) != stable[asked])
        return result

    before, after = np.ones(len(present)), np.full(len(present), math.inf)
    for step in range(1, most):
        ratios = np.where(np.isinf(after), np.where(stable, factor**step, (1.0 / factor) ** step), 0.0)
        crossed = changed(ratios)
        before, after = np.where(np.isinf(after) & ~crossed, ratios, before), np.where(crossed, ratios, after)
    critical = bisect(changed, before, after, halvings)
    critical = np.where(np.isinf(critical) & ~stable, 0.0, critical)
    return [*map(float, np.where(valid, critical, math.nan))]


def check_step(present: Controller, new: Controller, pose: Sequence[float], step_force: float = STEP_FORCE) -> None:
    """Reject settings that cause a large force step at the present pose.

    Forces are those at rest; the new controller's is checked with and without its pulse.

    Args:
        present: The active controller.
        new: The controller to replace it.
        pose: Pose of the flotor [m, rad], six.
        step_force: Largest step of force [N]; of torque, at 50 mm [N m].

    Raises:
        ParameterError: If the step is larger, or a law fails there.
    """
    (before, _), (after, extra) = _at_rest(present, pose), _at_rest(new, pose)
    for pulses in (ZERO, ZERO if extra is None else extra):
        for axis, old, force, pulse in zip(AXES, before, after, pulses):
            limit, unit = (step_force, "N") if axis in AXES[:3] else (step_force * _ARM, "N m")
            if not abs(step := force + pulse - old) <= limit:
                bound = f"at most {limit:g} {unit} (got {step:+.3g} {unit})"
                raise ParameterError(f"force step on {axis} at the present pose must be {bound}")


def _at_rest(controller: Controller, pose: Sequence[float]) -> tuple[Sequence[float], Six | None]:
    """Return the wrench on a flotor at rest [N, N m], six, that of walls on the device included, and the pulse."""
    command = controller.at_rest(pose)
    force = list(command.force)
    for axis, edge, side, stiffness, _, _ in command.walls:
        if side * (pose[axis] - edge) <= 0.0:
            force[axis] -= stiffness * (pose[axis] - edge)
    return force, command.extra


def started(scene: Scene) -> Controller:
    """Return a scene's controller after its first sample.

    Raises:
        ParameterError: If the timing, the start or a law's output is invalid, as in a run.
    """
    scene.timing()
    controller, start = scene.controller(), scene.start()
    check_instance(f"start() of {named(type(scene))}", start, Start, "a Start")
    controller.step(Sample(0, 0.0, components(numbers("pose", start.pose))))
    return controller


def stability_warning(scene: Scene) -> str | None:
    """Return a stability warning of one line, or None.

    It is also None for a velocity estimator that is not linear.
    """
    if not hasattr(scene.controller().velocity, "linear"):
        return None
    try:
        loop = unstable_loop(scene)
    except MaglevError as error:
        return f"{scene.name} may be unstable: {error}"
    return None if loop is None else f"{scene.name} is unstable: {loop.details}"


def unstable(scenes: Sequence[Scene]) -> list[bool]:
    """Return True for each scene with an unstable loop, by declared gains alone."""
    loops, result = defaultdict[Any, list[Any]](list), [False] * len(scenes)
    for index, scene in enumerate(scenes):
        with suppress(Exception):  # the run reports errors of a user's scene
            controller = scene.controller()
            if controller.on_device:
                result[index] = stability(scene).stable is False
                continue
            kind = scene.period, scene.delay, scene_lag(scene), *scene.body.inertia.tolist(), repr(controller.velocity)
            for pair in (stated_gains(controller) or {}).values():
                loops[kind].append((index, controller, pair))
    for (_, delay, lag, *body, _), group in loops.items():
        indices, (controller, *_), pairs = zip(*group)
        radii = stated_spectral_radii(pairs, controller, delay, np.array(body), None, lag)
        for index, spectral_radius in zip(indices, radii.tolist(), strict=True):
            result[index] |= spectral_radius >= 1.0
    return result
