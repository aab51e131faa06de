"""Loop of a scene to diagnose: its stiffest wall on the device, or the axis with the smallest margin."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from maglev_mj.control import FiniteDifference, LowPass
from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES
from maglev_mj.parameters import Parameters
from maglev_mj.scenes.find import get_scene
from maglev_mj.theory.closed_loop import LinearisedLaw, pd
from maglev_mj.theory.margin import worst_axis
from maglev_mj.theory.read import scene_lag, stated_gains
from maglev_mj.theory.two_rates import laws_on_device
from maglev_mj.theory.verdict import stability


def scene_values(
    scene: Any, values: Mapping[str, Any], loop: type[Parameters], assumptions: list[str]
) -> dict[str, Any]:
    """Return the values of the loop on a scene's worst axis, replaced by stated ones.

    Args:
        scene: The scene, its class or its name.
        values: Stated values. Those of parameters of the scene change it, unless a parameter of the loop with that name
            is of another kind or unit, or the hand.
        loop: Class whose parameters are returned.
        assumptions: Receives what was assumed, in words.

    Raises:
        ParameterError: If the scene renders no stiffness there.
    """
    found, kinds = get_scene(scene), {item.name: (item.kind, item.unit) for item in loop.parameters()}
    named = [item for item in found.parameters() if item.name in values and item.name != "hand"]
    same = [item.name for item in named if kinds.get(item.name, (item.kind, item.unit)) == (item.kind, item.unit)]
    found = found.replace(**{name: values[name] for name in same})
    stated = {name: value for name, value in values.items() if name not in same or name == "device"}
    controller, body = found.controller(), found.body.inertia
    gains, law, velocity = stated_gains(controller), None, controller.velocity
    around: Any = {"period": found.period, "delay": found.delay}
    own, rendered, acting = laws_on_device(controller, found.timing().device), dict[str, Any](), tuple[str, ...]()
    if own and gains is not None:  # the wall in question; the host's laws in contact are beside it
        index, acting = max(own, key=lambda axis: (own[axis].stiffness, own[axis].damping)), ("contact",)
        k, b = (float(part[index]) for part in gains[acting])
        names = "stiffness", "damping", "period", "delay", "cutoff"
        rendered = {f"device_{name}": getattr(own[index], name) for name in names}
    elif gains is None:
        verdict = stability(found)
        if verdict.stable is None:
            raise ParameterError(f"no diagnosis of {found.name}: stability {verdict}")
        index, acting = AXES.index(verdict.axes[0]) if verdict.axes else found.axis_index, verdict.acting
        k, b = float(verdict.stiffness[index, index]), float(verdict.damping[index, index])
        if len(verdict.axes) == 1:
            law = None if verdict.loop is None else verdict.loop.controller()
        memory = "coupling to other axes and memory left out"
        if law is not None:
            memory = "with its memory, which scales with the stiffness and keeps its length in samples"
        assumptions.append(f"law linearised at the worst pose, {memory}")
    else:
        acting, index, _ = worst_axis(gains, **around, inertia=body, velocity=velocity, driver_lag=scene_lag(found))
        k, b = (float(part[index]) for part in gains[acting])
        if not isinstance(velocity, FiniteDifference | LowPass):
            law = pd(velocity)(np.asarray(k), np.asarray(b), np.asarray(found.period))
    if not k > 0.0 and not rendered.get("device_stiffness"):
        raise ParameterError(f"scene {found.name} renders no stiffness on its worst axis, {AXES[index]}")
    state = f" ({', '.join(acting)})" if acting else ""
    reason = "stiffest wall on the device" if rendered else "the one with the smallest margin"
    assumptions.append(f"axis {AXES[index]} of {found.name}{state}, {reason}")
    b = max(b, 0.0)
    result: dict[str, Any] = {"stiffness": k, "damping": b, "law": None if law is None else LinearisedLaw(law, k, b)}
    result |= {"cutoff": velocity.cutoff} if isinstance(velocity, LowPass) and law is None else {}
    if stated.get("inertia") is None:
        result["inertia" if index > 2 else "mass"] = float(body[index])
    return {**result, "driver_lag": scene_lag(found), **around, **rendered, **stated}
