"""Stability check of a scene on every axis, and limit of force steps at the present pose."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from numpy.typing import ArrayLike

from maglev_mj.control.controller import Controller
from maglev_mj.errors import MaglevError, ParameterError, check_instance, named
from maglev_mj.frames import AXES, ZERO, Sample, Six, components
from maglev_mj.parameters import numbers
from maglev_mj.scenes.cell_verdicts import cell_verdicts
from maglev_mj.scenes.find import line_of
from maglev_mj.scenes.scene import Scene, Start
from maglev_mj.scenes.wall_scene import WallScene, along
from maglev_mj.spec import GRAVITY, LEVER_ARM
from maglev_mj.theory.loop import Loop, Loops
from maglev_mj.theory.read import loops_at, scene_doubts, scene_hand, scene_lag, with_doubt
from maglev_mj.theory.verdict import Verdict, judge

STEP_FORCE = 2.0
"""Default limit of force steps caused by other programs [N].

Over the whole range of 9 mm it accelerates a free flotor to 0.23 m/s, less than a device's host allows.
"""

UNKNOWN = "stability not computed"
"""First part of the reason to refuse a scene without a verdict."""


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


def wall_loops(
    scene: Scene, *, inertia: ArrayLike | None = None, delay: float | None = None, held: bool = False
) -> Loops:
    """Return the loop of each wall of a scene at rest in it; none without a wall.

    Laws that declare no gains are linearised at the depth at which the wall carries the weight.

    Args:
        scene: The scene.
        inertia: See `stability`.
        delay: See `stability`.
        held: True for the scripted hand on the flotor; False for a free flotor.

    Raises:
        MaglevError: If a law fails.

    Example:
        >>> from maglev_mj import find_scene, judge
        >>> print(judge(wall_loops(find_scene("drop")())).words)
        stable: 59 % of critical stiffness, spectral radius 0.8771
    """
    body = scene.body.inertia if inertia is None else numbers("inertia", inertia)
    gain, controller = getattr(scene, "stiffness", 0.0), scene.controller()
    faces = controller.faces or ([(2, 1.0, 0.0)] if isinstance(scene, WallScene) else [])
    if not (faces and gain):
        return Loops(())
    around: Any = {"delay": scene.delay if delay is None else delay, "inertia": body, "driver_lag": scene_lag(scene)}
    around |= {"hand": scene_hand(scene) if held else None, "device": scene.device_clock}

    def at(controller: Controller, axis: int, pose: Any) -> Loop:
        return loops_at([controller], axis, poses=[pose], **around)[0]

    def grown(loop: Loop, ratio: float) -> Loop:
        return at(scene.replace(stiffness=ratio * gain).controller(), AXES.index(loop.axis), loop.pose or ZERO)

    weight = float(body[0]) * GRAVITY / gain
    items = [at(controller, axis, along(AXES[axis], edge - normal * weight)) for axis, normal, edge in faces]
    stated = all(loop.pose is None and not loop.reason for loop in items)
    if not stated:
        doubt = {axis: scene_doubts([scene], axis)[0] for axis in {axis for axis, *_ in faces}}
        items = [one for item in items for one in with_doubt([item], doubt[AXES.index(item.axis)])]
    return Loops(tuple(items), stated, grown=grown)


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
            limit, unit = (step_force, "N") if axis in AXES[:3] else (step_force * LEVER_ARM, "N m")
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
    """Return a warning of one line for a scene that is unstable or not judged, or None."""
    try:
        verdict = judge(scene)
    except MaglevError as error:
        return f"{scene.name} may be unstable: {error}"
    if verdict.stable is None:
        return f"{scene.name} may be unstable: stability {'; '.join(verdict.remarks)}"
    return None if verdict.stable else f"{scene.name} is unstable: {verdict.details}"


def marks(scenes: Sequence[Scene]) -> list[str]:
    """Return what `stability` says of each scene in short: "" if stable, "unstable", or why it is not computed."""
    return [_mark(one) for one in cell_verdicts(scenes)]


def _mark(verdict: Verdict | Exception) -> str:
    if isinstance(verdict, Verdict):
        return {True: "", False: "unstable", None: f"stability {verdict}"}[verdict.stable]
    reason = str(verdict).removeprefix(f"{UNKNOWN}: ") if isinstance(verdict, MaglevError) else repr(verdict)
    return f"{UNKNOWN}: {reason}"
