"""Scenes that differ in numbers alone, as one batch of devices."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np

from maglev_mj.controller import Controller
from maglev_mj.errors import ParameterError
from maglev_mj.parameters import axis_indices
from maglev_mj.plants import SampledPlant, Timing
from maglev_mj.scenes.scene import PlantMaker, Scene, SideBySide

__all__ = ["StackingError", "stacked"]


class StackingError(ParameterError):
    """Scenes differ in more than numbers."""


def stacked(
    scenes: Sequence[Scene],
    make: PlantMaker,
    *,
    phases: Sequence[float] | None = None,
    timing: Callable[[Timing], Timing] = lambda timing: timing,
    **keywords: Any,
) -> tuple[SampledPlant, Controller]:
    """Return one plant and one controller for N scenes that differ in start, gains and phase alone.

    Args:
        scenes: The scenes; timing, mass, sensor, limits and hand are those of the first.
        make: Makes a plant of N devices.
        phases: Phase of each; 0 by default.
        timing: Makes another timing of the scenes' own.
        keywords: Of the plant, in place of the scenes'.

    Raises:
        StackingError: If laws differ in more than numbers, or have no axes.
    """
    parts: list[tuple[Timing, dict[str, Any]]] = []

    def keep(timing: Timing, **own: Any) -> Any:
        parts.append((timing, own))

    for scene, phase in zip(scenes, phases or [0.0] * len(scenes), strict=True):
        scene.plant(keep, phase=phase)
    common, options = parts[0]
    for name in ("pose", "twist", "wrench"):
        if name in options:
            options[name] = np.array([own[name] for _, own in parts])
    if options.get("hand_force") is not None:
        options["hand_force"] = SideBySide([own["hand_force"] for _, own in parts])
    each = np.array([one.phase for one, _ in parts])
    if (each != each[0]).any():
        common = replace(common, phase=each)
    controllers = [scene.controller() for scene in scenes]
    first = controllers[0]
    laws = [_stacked_law(alike) for alike in zip(*(controller.laws for controller in controllers), strict=True)]
    controller = Controller(laws, period=first.period, velocity=first.velocity)
    return make(timing(common), **options | keywords), controller


def _stacked_law(laws: Sequence[Any]) -> Any:
    """Return one law for N devices: numbers that differ become (N, axes)."""
    first: Any = laws[0]
    if not is_dataclass(first) or not hasattr(first, "axes") or any(type(law) is not type(first) for law in laws):
        raise StackingError(f"law must be of one class with axes and declared gains, not {type(first).__name__}")
    count = len(axis_indices(first.axes))
    changed = {}
    for item in fields(first):
        values = [getattr(law, item.name) for law in laws]
        if item.init and any(not np.array_equal(values[0], value) for value in values[1:]):
            try:
                changed[item.name] = np.array([np.broadcast_to(np.asarray(value, float), (count,)) for value in values])
            except (TypeError, ValueError):
                raise StackingError(f"{item.name} of {type(first).__name__} must be numbers to differ") from None
    return replace(laws[0], **changed) if changed else first
