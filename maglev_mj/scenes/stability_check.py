"""Stability check of a scene, and limit of force steps.

The stability check covers the closed loop of every axis; the force step is that at the flotor's present pose.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj import theory
from maglev_mj.control.controller import Controller
from maglev_mj.errors import MaglevError, ParameterError, check_instance, named
from maglev_mj.frames import AXES, ZERO, Sample, components, unit_of
from maglev_mj.parameters import numbers
from maglev_mj.scenes.find import line_of
from maglev_mj.scenes.scene import Scene, Start
from maglev_mj.scenes.wall_scene import WallScene, along
from maglev_mj.spec import GRAVITY
from maglev_mj.theory.closed_loop import bisect
from maglev_mj.theory.verdict import axis_loop, inertia_of, stability

STEP_FORCE = 2.0
"""Default limit of force steps by other programs [N].

This force accelerates a free flotor over its whole range of 9 mm to 0.23 m/s, less than a device's host allows.
"""

UNKNOWN = "it is not known whether the scene would be stable"
"""Beginning of the reason to refuse a scene without a verdict."""

_ARM = 0.05
"""Lever arm that converts a torque to a force [m].

It is about the distance of the flotor's rim from the axis.
"""

_FACTOR, _MOST, _HALVINGS = 1.2, 14, 13
"""Step of a gain's factor, most steps, and halvings of the last."""

_ACTING = {"contact": "walls", "stuck": "friction"}


class UnstableLoop(NamedTuple):
    """Unstable loop of refused parameters, on its worst axis.

    Attributes:
        axis: Name of its axis.
        acting: Acting laws: "walls", "friction", both, "nothing but the scene", or "the laws" if one of them does not
            state its gains.
        stiffness: Total stiffness [N/m, N m/rad].
        damping: Total damping [N s/m, N m s/rad].
        spectral_radius: Spectral radius of the loop's eigenvalues; from 1 on it is unstable.
        largest_stable: Largest stable stiffness at that damping [N/m, N m/rad]; 0 for none, None if a law does not
            state its gains.
        period: Sample period [s].
        delay: Time from a sample to the effect of its command [s].
    """

    axis: str
    acting: str
    stiffness: float
    damping: float
    spectral_radius: float
    largest_stable: float | None
    period: float
    delay: float

    def __str__(self) -> str:
        stiff, damp = (unit_of(unit, self.axis) for unit in ("N/m", "N s/m"))
        if self.largest_stable is None:
            bound = ""
        elif self.largest_stable:
            bound = f"; at this damping it is stable up to {self.largest_stable:.4g} {stiff}"
        else:
            bound = "; at this damping it is unstable at any stiffness"
        return (
            f"{self.acting} on {self.axis}: {self.stiffness:.4g} {stiff} and {self.damping:.4g} {damp} in all, at "
            f"{1.0 / self.period:.4g} Hz with {self.delay * 1e3:.3g} ms of delay, have the spectral radius "
            f"{self.spectral_radius:.4f}, which must be below 1{bound}"
        )


@contextmanager
def own_code_refused() -> Iterator[None]:
    """Refuse parameters at which a user's own code fails.

    A slider can reach unexpected values; they must end neither a session nor a flight.

    Raises:
        ParameterError: If the code in the context fails.
    """
    try:
        yield
    except MaglevError:
        raise
    except Exception as error:
        where = line_of(error)
        said = f"{type(error).__name__}: {error}"
        raise ParameterError(f"the parameters are refused: {said if where is None else f'{where}: {said}'}") from error


def unstable_loop(scene: Scene, *, inertia: ArrayLike | None = None, delay: float | None = None) -> UnstableLoop | None:
    """Return a scene's unstable loop, or None if stable.

    The loop is that of a free flotor; see `judge`. Of the published hands, arm and fingertip allow a longer delay than
    that; a stylus up to 10 % less (1000 to 8000 N/m, 20 to 100 N s/m, 200 Hz to 1 kHz).

    Args:
        scene: The scene, with the present period and delay.
        inertia: Mass and moments of inertia in place of the scene's own [kg, kg m²], (6,).
        delay: See `stability`.

    Raises:
        ParameterError: If the stability cannot be decided.
    """
    period, delay = scene.period, scene.delay if delay is None else delay
    body = inertia_of(scene) if inertia is None else numbers("inertia", inertia)
    verdict = stability(scene, inertia=body, delay=delay)
    if verdict.stable:
        return None
    if verdict.stable is None:
        raise ParameterError("; ".join((UNKNOWN, *verdict.remarks)))
    index = AXES.index(verdict.axes[0])
    damping, bound = float(verdict.damping[index, index]), None
    if verdict.stated:
        bound = float(theory.largest_stable_stiffness(damping, period=period, delay=delay, mass=body[index]))
    return UnstableLoop(
        axis=AXES[index],
        acting=" and ".join(_ACTING.get(state, state) for state in verdict.acting)
        or ("nothing but the scene" if verdict.stated else "the laws"),
        stiffness=float(verdict.stiffness[index, index]),
        damping=damping,
        spectral_radius=verdict.spectral_radius,
        largest_stable=bound,
        period=period,
        delay=delay,
    )


class WallMargin(NamedTuple):
    """Stability of a wall that the flotor rests in.

    Attributes:
        stiffness: Static stiffness [N/m, N m/rad].
        spectral_radius: Spectral radius of the wall's own eigenvalues, below 1 for a stable wall; NaN if not known.
        margin: Factor of the scene's stiffness at which that changes, the other gains as they are; NaN if it does not
            change up to tenfold.
    """

    stiffness: float
    spectral_radius: float
    margin: float

    def __str__(self) -> str:
        if math.isnan(self.spectral_radius):
            return "root not known"
        limit = "" if math.isnan(self.margin) else f", stiffness {100.0 / self.margin:.0f} % of its limit"
        return f"root {self.spectral_radius:.3f}{'' if self.spectral_radius < 1.0 else ' UNSTABLE'}{limit}"


def wall_margin(
    scene: Scene, *, inertia: ArrayLike | None = None, delay: float | None = None, held: bool = False
) -> WallMargin | None:
    """Return the margin of a scene's wall; None without a stiff one.

    Of several walls it is that with the largest spectral radius. Laws that state no gains are linearised at the depth
    at which the wall carries the weight.

    Args:
        scene: See `unstable_loop`.
        inertia: See `unstable_loop`.
        delay: See `stability`.
        held: True for the hand of the scene's script on the flotor; False for nobody's.

    Raises:
        MaglevError: If a law fails.

    Example:
        >>> from maglev_mj import find_scene
        >>> print(wall_margin(find_scene("drop")()))
        root 0.877, stiffness 59 % of its limit
    """
    body = inertia_of(scene) if inertia is None else numbers("inertia", inertia)
    late, gain = scene.delay if delay is None else delay, getattr(scene, "stiffness", 0.0)
    faces = scene.controller().faces or ([(2, 1.0, 0.0)] if isinstance(scene, WallScene) else [])
    if not (faces and gain):
        return None
    hand = getattr(scene.scripted_hand(), "hand", None) if held else None

    def loop(factor: float, axis: int, normal: float, edge: float) -> tuple[float, float]:
        controller = (scene if factor == 1.0 else scene.replace(stiffness=factor * gain)).controller()
        pose = along(AXES[axis], edge - normal * float(body[0]) * GRAVITY / gain)
        return axis_loop(controller, axis, pose=pose, delay=late, inertia=body, hand=hand)

    loops = {face: loop(1.0, *face) for face in faces}
    worst = max(faces, key=lambda face: loops[face][1])
    (stiffness, spectral_radius), margin = loops[worst], math.nan
    if math.isnan(spectral_radius):  # nor is it with another stiffness
        return WallMargin(stiffness, spectral_radius, margin)

    def changed(factor: Any) -> Any:
        other = loop(float(factor), *worst)[1]
        return other >= 1.0 if spectral_radius < 1.0 else other < 1.0  # NaN, not known, is no change

    factors = (_FACTOR if spectral_radius < 1.0 else 1.0 / _FACTOR) ** np.arange(_MOST)
    with suppress(StopIteration, ParameterError):  # not up to tenfold, or beyond the scene's bounds
        last = next(index for index, factor in enumerate(factors[1:]) if changed(factor))
        margin = float(bisect(changed, factors[last], factors[last + 1], _HALVINGS))
    return WallMargin(stiffness, spectral_radius, margin)


def check_step(present: Controller, wanted: Controller, pose: Sequence[float], step_force: float = STEP_FORCE) -> None:
    """Refuse settings that cause a large force step.

    The step is that at the present pose.

    Both controllers give their force at rest; that of the wanted one counts with its pulse and without.

    Args:
        present: The controller in force.
        wanted: A new one in its place.
        pose: Pose of the flotor [m, rad], six.
        step_force: Largest step of force [N]; of torque, at 50 mm [N m].

    Raises:
        ParameterError: If the step is larger, or a law fails there.
    """
    now, then = present.at_rest(pose).force, wanted.at_rest(pose)
    for more in (ZERO, ZERO if then.extra is None else then.extra):
        for axis, one, other, pulse in zip(AXES, now, then.force, more):
            most, unit = (step_force, "N") if axis in AXES[:3] else (step_force * _ARM, "N m")
            if not abs(step := other + pulse - one) <= most:
                raise ParameterError(
                    f"settings must change the force on {axis}, where the flotor is, by at most {most:g} {unit}, "
                    f"not {step:+.3g} {unit}"
                )


def stability_warning(scene: Scene, *, inertia: ArrayLike | None = None, delay: float | None = None) -> str | None:
    """Return a stability warning of one line, or None.

    Args:
        scene: See `unstable_loop`.
        inertia: See `unstable_loop`.
        delay: See `stability`.

    Raises:
        ParameterError: If the timing or a law's answer to the first sample is wrong, as in a run.
    """
    scene.timing()
    controller = scene.controller()
    start = scene.start()
    check_instance(f"start() of {named(type(scene))}", start, Start, "a Start")
    controller.step(Sample(0, 0.0, components(numbers("pose", start.pose))))
    if not hasattr(controller.velocity, "linear"):  # not linear: the check would take seconds and the run starts anyway
        return None
    try:
        wrong = unstable_loop(scene, inertia=inertia, delay=delay)
    except MaglevError as error:
        return f"{scene.name} may be unstable: {error}"
    return None if wrong is None else f"{scene.name} is unstable: {wrong}"
