"""Many scenes as one batch on the exact plant, their laws stacked."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from maglev_mj.control.stack import computed_together, content, law_kind
from maglev_mj.frames import Command, Mask, Sample, components
from maglev_mj.scenes.results import figures_of_each
from maglev_mj.scenes.run import run
from maglev_mj.scenes.scene import Scene
from maglev_mj.scenes.stack import FAR, STACKED, Member, SceneStack

_LEAST = 8  # smaller batches are slower than single runs
_MOST, _AT_ONCE = 512, 64
_MEMORY = 256e6
_PER_KNOT = 18 * 8.0
_NEAR = 0.9
_OWN_RUN = ("run_figures", "plant", "plant_keywords", "controller", "ticks")


def figures_together(scenes: Sequence[Scene], plant: str, phases: Sequence[float]) -> list[Mapping[str, Any] | None]:
    """Return the figures of many runs by name; None for a run that must run alone.

    Runs fit one batch if their laws are of the same kinds and declare the parameters that may differ, and other plant
    options are equal. These run alone: scenes with a `run_figures` method, fewer than `_LEAST` of a kind, motions near
    the end of the range, and runs that fail.

    Args:
        scenes: Scenes of one class.
        plant: Name from PLANTS.
        phases: Sampling phase of each scene.
    """
    results: list[Mapping[str, Any] | None] = [None] * len(scenes)
    cls = type(scenes[0])
    if cls.figures_together is not None:
        figures: list[Mapping[str, Any] | None] = cls.figures_together(scenes, plant, phases)
        return figures
    if plant != "exact" or any(getattr(cls, name) is not getattr(Scene, name) for name in _OWN_RUN):
        return results
    members, kinds = list[Any](results), list[Hashable](results)
    for index, (scene, phase) in enumerate(zip(scenes, phases, strict=True)):
        with suppress(Exception):  # errors of user code are reported by the single run
            hand = scene.scripted_hand(phase)
            parts = scene.timing(phase), scene.laws(), scene.velocity_estimator(), scene.plant_keywords("exact", hand)
            members[index] = Member(scene, phase, *parts, hand)
            kinds[index] = _kind(members[index])
    return computed_together(members, kinds, _figures_of, most=_most_of)


def _kind(member: Member) -> Hashable:
    """Return a key that is equal for runs of one batch; None for a run that must run alone."""
    scene, timing, options = member.scene, member.timing, member.options
    kinds = [law_kind(law) for law in member.laws]
    fixed = content(
        (
            (scene.axis, scene.end, scene.period, type(member.hand_force)),
            (timing.period, timing.delay, timing.jitter, timing.seed, *timing.device),
            {name: value for name, value in options.items() if name not in STACKED},
            [name for name in STACKED if options.get(name) is None],
            member.velocity,
        )
    )
    return None if fixed is None or None in kinds else (*kinds, fixed)


def _most_of(member: Member) -> int:
    """Return the largest batch size, limited by the memory of the recorded motion."""
    step = member.options.get("longest_step") or math.inf
    if any(getattr(law, "on", "host") == "device" for law in member.laws):
        step = min(step, 0.5 * member.timing.device_period)
    knots = 3.0 * member.scene.ticks(member.timing) * max(math.ceil(member.scene.period / step), 1)
    return max(min(_MOST, int(_MEMORY / (knots * _PER_KNOT))), 1)


def _figures_of(members: Sequence[Member]) -> list[Mapping[str, Any] | None]:
    """Return the figures of the runs of a batch, None for one that failed; a failed batch is split in halves."""
    found: list[Mapping[str, Any] | None] = [None] * len(members)
    if len(members) < _LEAST:
        return found
    try:
        observer = _InRange(members[0].options["escape"], len(members))
        stack: Any = SceneStack(members, escape=FAR)
        result = run(stack, plant="exact", phase=stack.phases, observe=observer)
        observer.check(components(result.trace.pose[-1]))
        good = np.flatnonzero(observer.always)
        for start in range(0, good.size, _AT_ONCE):
            devices = good[start : start + _AT_ONCE]
            some = result[devices]
            figures, verdicts = figures_of_each(some), some.verdicts()
            rows = zip(*figures.values(), strict=True)
            for device, verdict, row in zip(devices.tolist(), verdicts, rows, strict=True):
                found[device] = {**dict(zip(figures, row)), **({"warnings": verdict} if verdict else {})}
        return found
    except Exception:  # reported by the single run
        half = len(members) // 2
        return [*_figures_of(members[:half]), *_figures_of(members[half:])]


class _InRange:
    """Observer that tracks which devices stay well within their range."""

    def __init__(self, escape: tuple[float, float], devices: int) -> None:
        distance, angle = escape
        self._bounds = (_NEAR * distance) ** 2, (_NEAR * angle) ** 2
        self.always: Mask = np.ones(devices, dtype=bool)

    def __call__(self, sample: Sample, _: Command) -> None:
        """Check one sample."""
        self.check(sample.position)

    def check(self, position: Sequence[Any]) -> None:
        """Check six position components against the bounds; NaN is outside."""
        x, y, z, rx, ry, rz = position
        distance, angle = self._bounds
        self.always &= (x * x + y * y + z * z < distance) & (rx * rx + ry * ry + rz * rz < angle)
