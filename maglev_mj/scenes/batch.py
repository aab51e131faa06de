"""Many scenes as one batch on the exact plant, their laws stacked."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Hashable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from maglev_mj.control import VelocityEstimator
from maglev_mj.control.controller import Controller
from maglev_mj.control.stack import content, law_kind, stacked
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array, Command, Mask, Sample, components
from maglev_mj.plants import ExactPlant, Timing
from maglev_mj.plants.hand import HandForce
from maglev_mj.plants.model import Flotor
from maglev_mj.scenes.results import figures_of_each
from maglev_mj.scenes.run import run
from maglev_mj.scenes.scene import Scene, SideBySide

_LEAST = 8  # smaller batches are slower than single runs
_MOST, _AT_ONCE = 512, 64
_MEMORY = 256e6
_PER_KNOT = 18 * 8.0
_FAR = (1e15, 1e15)
_NEAR = 0.9
_STACKED = ("pose", "twist", "wrench", "mass", "wrench_limit")
_OWN_RUN = ("run_figures", "plant", "plant_keywords", "controller", "ticks")


@dataclass(frozen=True)
class _Member:
    """One run before its batch."""

    scene: Scene
    phase: float
    timing: Timing
    laws: Sequence[Any]
    velocity: VelocityEstimator | None
    options: Mapping[str, Any]
    hand_force: HandForce | None


class SceneStack:
    """N scenes that differ in numbers only, as one scene of N devices for `run`.

    An attribute is that of the scenes if equal, otherwise (N,).
    """

    def __init__(self, members: Sequence[_Member]) -> None:
        self.scenes = [member.scene for member in members]
        self.phases = np.array([member.phase for member in members])
        self._members = members

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        values = [getattr(scene, name) for scene in self.scenes]
        if all(value == values[0] for value in values[1:]):
            return values[0]
        if any(value is None for value in values):  # an array would make it NaN
            raise TypeError(f"{name} must be a number in every scene of a batch")
        return np.array(values, dtype=np.float64)

    @cached_property
    def body(self) -> Flotor:
        """Flotors and limits of the scenes; arrays that differ have the devices last, (6, N)."""
        columns: list[Any] = [np.array(values) for values in zip(*(scene.body for scene in self.scenes))]
        return Flotor(*(values[0] if (values == values[0]).all() else values.T for values in columns))

    def __getitem__(self, device: Any) -> Any:
        """Return one device's scene, or a stack for an array of indices."""
        if np.ndim(device) == 0:
            return self.scenes[device]
        return SceneStack([self._members[index] for index in device.tolist()])

    def controller(self) -> Controller:
        """Return one controller with the stacked laws."""
        laws = [stacked(same) for same in zip(*(member.laws for member in self._members), strict=True)]
        return Controller(laws, period=self.scenes[0].period, velocity=self._members[0].velocity)

    def plant_options(self) -> Mapping[str, Any]:
        """Return the plant's keywords of the first scene."""
        return self._members[0].options

    def plant(
        self, plant: str, *, phase: Array | None = None, timing: Timing | None = None, **keywords: Any
    ) -> ExactPlant:
        """Return the exact plant of N devices at release; leaving the range does not end the run.

        Args:
            plant: "exact".
            phase: Ignored: each scene has its own timing.
            timing: Timing in place of the scenes' own.
            keywords: Keywords of the plant; they override the scenes'.
        """
        options = dict(self.plant_options())
        for name in _STACKED:
            if options.get(name) is not None:
                rows = np.array([member.options[name] for member in self._members], dtype=np.float64)
                options[name] = rows if name == "pose" or (rows != rows[0]).any() else options[name]
        hands = [member.hand_force for member in self._members if member.hand_force is not None]
        options |= {"escape": _FAR, "hand_force": SideBySide(hands) if hands else None}
        return ExactPlant(timing or self.timing(), **options | keywords)

    def ticks(self, timing: Timing) -> int:
        """Return the number of samples until the end."""
        return self.scenes[0].ticks(timing)

    def timing(self, _: Array | None = None) -> Timing:
        """Return the timing of samples and commands, with the scenes' own phases."""
        phases = [member.timing.phase for member in self._members]
        equal = all(phase == phases[0] for phase in phases)  # a hand needs a common clock
        return replace(self._members[0].timing, phase=phases[0] if equal else np.array(phases))


def stacked_scenes(points: Sequence[tuple[Scene, float]]) -> SceneStack:
    """Return scenes at their phases as one stack.

    Raises:
        ParameterError: If their laws differ in more than declared gains.
    """
    controllers = {id(scene): scene.controller() for scene, _ in points}
    members = []
    for scene, phase in points:
        calls: list[tuple[Timing, dict[str, Any]]] = []
        scene.plant(lambda timing, calls=calls, **options: calls.append((timing, options)), phase=phase)
        timing, options = calls[0]
        controller, hand = controllers[id(scene)], options.pop("hand_force")
        members.append(_Member(scene, phase, timing, controller.laws, controller.velocity, options, hand))
    for laws in zip(*(member.laws for member in members), strict=True):
        first, kind = laws[0], law_kind(laws[0])
        if any(law is not first and (kind is None or law_kind(law) != kind) for law in laws):
            name = getattr(first, "name", type(first).__name__)
            raise ParameterError(
                f"law {name} must be an AxisLaw or list its gains in per_device, and differ only in those"
            )
    return SceneStack(members)


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
    members: dict[int, _Member] = {}
    kinds: dict[Hashable, list[int]] = defaultdict(list)
    for index, (scene, phase) in enumerate(zip(scenes, phases, strict=True)):
        with suppress(Exception):  # errors of user code are reported by the single run
            hand = scene.scripted_hand(phase)
            parts = scene.timing(phase), scene.laws(), scene.velocity_estimator(), scene.plant_keywords("exact", hand)
            members[index] = _Member(scene, phase, *parts, hand)
            kinds[_kind(members[index])].append(index)
    kinds.pop(None, None)
    for indices in kinds.values():
        size = _most_of(members[indices[0]])
        for start in range(0, len(indices), size):
            chunk = [(index, members[index]) for index in indices[start : start + size]]
            for index, row in _figures_of(chunk):
                results[index] = row
    return results


def _kind(member: _Member) -> Hashable:
    """Return a key that is equal for runs of one batch; None for a run that must run alone."""
    scene, timing, options = member.scene, member.timing, member.options
    kinds = [law_kind(law) for law in member.laws]
    fixed = content(
        (
            (scene.axis, scene.end, scene.period, type(member.hand_force)),
            (timing.period, timing.delay, timing.jitter, timing.seed, *timing.device),
            {name: value for name, value in options.items() if name not in _STACKED},
            [name for name in _STACKED if options.get(name) is None],
            member.velocity,
        )
    )
    return None if fixed is None or None in kinds else (*kinds, fixed)


def _most_of(member: _Member) -> int:
    """Return the largest batch size, limited by the memory of the recorded motion."""
    step = member.options.get("longest_step") or math.inf
    if any(getattr(law, "on", "host") == "device" for law in member.laws):
        step = min(step, 0.5 * member.timing.device_period)
    knots = 3.0 * member.scene.ticks(member.timing) * max(math.ceil(member.scene.period / step), 1)
    return max(min(_MOST, int(_MEMORY / (knots * _PER_KNOT))), 1)


def _figures_of(members: Sequence[tuple[int, _Member]]) -> list[tuple[int, Mapping[str, Any]]]:
    """Return the figures of the successful runs of a batch by index; a failed batch is split in halves."""
    if len(members) < _LEAST:
        return []
    try:
        observer = _InRange(members[0][1].options["escape"], len(members))
        stack: Any = SceneStack([member for _, member in members])
        result = run(stack, plant="exact", phase=stack.phases, observe=observer)
        observer.check(components(result.trace.pose[-1]))
        good = np.flatnonzero(observer.always)
        rows: list[Mapping[str, Any]] = []
        for start in range(0, good.size, _AT_ONCE):
            some = result[good[start : start + _AT_ONCE]]
            figures, verdicts = figures_of_each(some), some.verdicts()
            rows += [
                {**dict(zip(figures, row, strict=True)), **({"warnings": verdict} if verdict else {})}
                for verdict, row in zip(verdicts, zip(*figures.values(), strict=True), strict=True)
            ]
        return [(members[device][0], row) for device, row in zip(good.tolist(), rows, strict=True)]
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
