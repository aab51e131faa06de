"""Table of wall laws: equation, source and status of each, and its construction for a scene."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from inspect import Parameter, signature
from typing import Any, NamedTuple

from maglev_mj.control import (
    HalfSampleWall,
    Law,
    LowPass,
    PassivityController,
    VelocityEstimator,
    VirtualCoupling,
    Wall,
)
from maglev_mj.errors import ParameterError, check_instance, check_one_of
from maglev_mj.plants.model import load_model
from maglev_mj.scenes.find import class_in_file
from maglev_mj.scenes.wall_scene import WallScene
from maglev_mj.theory import least_passive_damping

LawMaker = Callable[..., Law | Sequence[Law]]
"""Class of a law, or function that returns one or several, of numbers that `compare` gives by name."""

_MOST = 0.4
"""Largest damping of a passivity controller, in units of inertia over period."""


class WallLaw(NamedTuple):
    """Row of the table of laws.

    Attributes:
        make: See `LawMaker`.
        equation: Force f on the flotor at depth x < 0 and velocity v; k counts samples.
        status: "as published", "changed", "own" or "user-defined".
        source: Source of the equation, "as in" an implementation that was read for it, "not opened" for a text that was
            not, and what differs from it.
        velocity: Velocity estimator; None for the scene's.
        gains: Function of scene and plant that returns parameters in place of the scene's; None for the scene's own.
    """

    make: LawMaker
    equation: str
    status: str = "user-defined"
    source: str = ""
    velocity: VelocityEstimator | None = None
    gains: Callable[[WallScene, str], dict[str, float]] | None = None

    @property
    def text(self) -> str:
        """Equation and source."""
        return "; ".join(filter(None, (self.equation, self.source)))


def _unpulsed(wall: Wall) -> Wall:
    return replace(wall, pulse=0.0)


def _watched(wall: Wall, axes: str, inertia: float, period: float, delay: float, *, paired: bool) -> list[Law]:
    around: Any = {"axes": axes, "period": period, "delay": delay, "paired": paired}
    return [_unpulsed(wall), PassivityController(most=_MOST * inertia / period, **around)]


def _passive(scene: WallScene, plant: str) -> dict[str, float]:
    """Return the gains of the stiffest passive spring, without damping, on a device with damping of its own."""
    model, damping = scene.device_options().get("model"), 0.0
    if plant != "exact" and model is not None:
        device = load_model(model)
        damping = float(device.model.dof_damping[device.velocity_address + scene.axis_index])
    if not damping:
        raise ParameterError(
            "no passive spring: the device has no damping of its own; law colgate needs joint damping in the model of "
            f"plant mujoco (got {damping:g} N s/m on {scene.axis})"
        )
    least = least_passive_damping(1.0, period=scene.period, delay=scene.delay)
    return {"stiffness": damping / float(least), "damping": 0.0, "pulse": 0.0}


LAWS: Mapping[str, WallLaw] = {
    "pd": WallLaw(
        _unpulsed,
        "f = -K x - B v, v = (x[k] - x[k-1])/T",
        "as published",
        "Salcudean & Vlaar 1997, eq. 3, for a delay of T; any delay here",
    ),
    "pulse": WallLaw(
        lambda wall: wall,
        "f = -(pulse + B) v for the pulse width from the first sample inside, then pd",
        "changed",
        "Salcudean & Vlaar 1997, eq. 8 and 9; pulse read as N s/m; width, speed gate and carried impulse are own",
    ),
    "half-sample": WallLaw(
        HalfSampleWall,
        "f = -K (x + v T/2) - B v, and the crossing time of the edge within the hold",
        "changed",
        "after Gillespie & Cutkosky 1996 (not opened): as quoted, theirs predicts by a model of hand and device",
    ),
    "virtual-coupling": WallLaw(
        VirtualCoupling,
        "f = -K (x - y) - B (v - w), M w' = -f, y >= 0; M = mass of the flotor",
        "changed",
        "f as in OpenSurgSim, VirtualToolCoupler; mass and stop are own; Adams & Hannaford 1999 (abstract, not opened)",
    ),
    "filtered": WallLaw(
        _unpulsed,
        "pd with v += (1 - exp(-2 pi f T)) ((x[k] - x[k-1])/T - v), f = 40 Hz",
        "changed",
        "Brown 1995, appendix A (read in part): a backward difference; Chawda et al. 2014 (abstract, not opened)",
        velocity=LowPass(cutoff=40.0),
    ),
    "passivity-2002": WallLaw(
        partial(_watched, paired=False),
        "pd; E += -T f v + T b v²; if E < 0: b = -E/(T v²), f -= b v, b at most 0.4 m/T",
        "as published",
        "recursion as in haptic-toolbox, tdpa.rs; the limit of b is own; Hannaford & Ryu 2002 (not opened)",
    ),
    "passivity": WallLaw(
        partial(_watched, paired=True),
        "pd; E -= (force in effect over the hold) (x[k] - x[k-1]); damper of passivity-2002",
        "own",
        "after Hannaford & Ryu 2002 (not opened); balances the energy within three samples, not at each",
    ),
    "colgate": WallLaw(
        _unpulsed,
        "f = -K x, K = 2 b/T without delay, b the device's own damping",
        "changed",
        "Colgate & Schenkel 1997 (as quoted by others, not opened); with a delay K = b/least_passive_damping(1)",
        gains=_passive,
    ),
}
"""Laws by name."""


def wall_law(law: str | LawMaker) -> tuple[str, WallLaw]:
    """Return the label and row of a law by name, of your own FILE.py[:CLASS], or of a class or function.

    Raises:
        ParameterError: If there is no such law.
    """
    if isinstance(law, str) and ".py" not in law:
        check_one_of("law", LAWS, law, ", or your own FILE.py[:CLASS]")
        return law, LAWS[law]
    own: Any = class_in_file(law, Law) if isinstance(law, str) else law
    check_instance("law", own, Callable, "a name, FILE.py[:CLASS] or a function that returns a Law")
    name, text = getattr(own, "__name__", str(own)), getattr(own, "func", own).__doc__ or ""
    summary = "" if text.startswith(f"{name}(") else text.strip().partition("\n")[0].rstrip(".")
    return name, WallLaw(own, summary)


def laws_of(label: str, maker: LawMaker, scene: WallScene, wall: Wall) -> list[Law]:
    """Return a maker's laws for the numbers of a scene.

    Raises:
        ParameterError: If the maker needs a number that the scene does not have.
    """
    numbers = scene.as_json() | {"axes": scene.axis, "lower": 0.0, "inertia": scene.mass, "wall": wall}
    numbers["force_limit"] = scene.force_limit or math.inf
    takes, fixed = signature(maker).parameters, getattr(maker, "keywords", {})
    for name, one in takes.items():
        if one.default is Parameter.empty and name not in numbers:
            raise ParameterError(f"law {label} must have a default for {name}; {scene.name} has {', '.join(numbers)}")
    made = maker(**{name: value for name, value in numbers.items() if name in takes and name not in fixed})
    return list(made) if isinstance(made, Sequence) else [made]
