"""Batched runs of many scenes on the exact plant."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Hashable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from maglev_mj.controller import Controller
from maglev_mj.frames import Array, Command, Mask, Sample, components
from maglev_mj.hand import HandForce
from maglev_mj.laws.stack import content, law_kind, stacked
from maglev_mj.plants import ExactPlant, Timing
from maglev_mj.scenes.figures import Figure
from maglev_mj.scenes.run import RunResult, run
from maglev_mj.scenes.scene import Scene, SideBySide

_LEAST = 8  # fewer do not pay for a batch
_MOST, _AT_ONCE = 512, 64
_ROOM = 256e6
_PER_KNOT = 18 * 8.0
_FAR = (1e15, 1e15)
_NEAR = 0.9
_STACKED = ("pose", "twist", "wrench", "mass", "wrench_limit")
_OWN_RUN = ("run_figures", "plant", "plant_keywords", "controller", "ticks")


@dataclass(frozen=True)
class _Member:
    """One run before its batch.

    Runs of one kind fit one batch.
    """

    index: int
    scene: Scene
    phase: float
    timing: Timing
    laws: Sequence[Any]
    options: Mapping[str, Any]
    hand: HandForce | None
    kind: Hashable


class SceneStack:
    """Scenes with different numbers as one scene for `run`.

    They differ in numbers alone; each is one of N devices.

    An attribute is that of the scenes if they agree, otherwise (N,).
    """

    def __init__(self, members: Sequence[_Member]) -> None:
        self.scenes = [one.scene for one in members]
        self.phases = np.array([one.phase for one in members])
        self._members = members

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        values = [getattr(one, name) for one in self.scenes]
        if all(value == values[0] for value in values[1:]):
            return values[0]
        if any(value is None for value in values):  # an array would make it NaN
            raise TypeError(f"{name} must be a number in all of a batch")
        return np.array(values, dtype=np.float64)

    def __getitem__(self, device: Any) -> Any:
        """Return one device's scene, or a stack of several.

        Several are given by an array of indices.
        """
        if np.ndim(device) == 0:
            return self.scenes[device]
        return SceneStack([self._members[index] for index in device.tolist()])

    def controller(self) -> Controller:
        """Return one controller with the stacked laws."""
        first = self.scenes[0]
        laws = [stacked(of_all) for of_all in zip(*(one.laws for one in self._members), strict=True)]
        return Controller(laws, period=first.period, velocity=first.velocity_estimator())

    def plant(self, plant: str, *, phase: Array, **keywords: Any) -> ExactPlant:
        """Return the exact plant of N devices at release.

        No device ends the run by leaving its range.
        """
        first = self._members[0]
        options = dict(first.options)
        for name in _STACKED:
            if options.get(name) is not None:
                rows = np.array([one.options[name] for one in self._members], dtype=np.float64)
                options[name] = rows if name == "pose" or (rows != rows[0]).any() else options[name]
        hands = [one.hand for one in self._members if one.hand is not None]
        options |= {"escape": _FAR, "hand_force": SideBySide(hands) if hands else None}
        return ExactPlant(self.timing(phase), **options, **keywords)

    def ticks(self, timing: Timing) -> int:
        """Return the number of samples until the end."""
        return self.scenes[0].ticks(timing)

    def timing(self, _: Array) -> Timing:
        """Return the timing of samples and commands.

        The phase is ignored: each scene has its own timing already.
        """
        phases = [one.timing.phase for one in self._members]
        alike = all(phase == phases[0] for phase in phases)  # a hand is moved by one clock
        return replace(self._members[0].timing, phase=phases[0] if alike else np.array(phases))


def figures_together(scenes: Sequence[Scene], plant: str, phases: Sequence[float]) -> list[Mapping[str, Any] | None]:
    """Return the figures of many runs by name.

    None for a run that must run alone.

    Runs fit one batch if their laws are of the same kinds and declare the parameters that may differ, and all plant
    options common to a batch are equal. These run alone: runs of a scene with its own run method, fewer than `_LEAST`
    of a kind, runs that come near the end of their range, and all of a batch that fails.

    Args:
        scenes: Scenes of one class.
        plant: Name from PLANTS.
        phases: Phases of the samples, one for each scene.
    """
    found: list[Mapping[str, Any] | None] = [None] * len(scenes)
    cls = type(scenes[0])
    if plant != "exact" or any(getattr(cls, name) is not getattr(Scene, name) for name in _OWN_RUN):
        return found
    kinds: dict[Hashable, list[_Member]] = defaultdict(list)
    for index, (scene, phase) in enumerate(zip(scenes, phases, strict=True)):
        with suppress(Exception):  # of a scene's own code: its own run reports the error
            member = _member(index, scene, phase)
            kinds[member.kind].append(member)
    kinds.pop(None, None)
    for members in kinds.values():
        size = _most_of(members[0])
        for start in range(0, len(members), size):
            for member, figures in _figures_of(members[start : start + size]):
                found[member.index] = figures
    return found


def _member(index: int, scene: Scene, phase: float) -> _Member:
    """Return a run with its kind; None for no batch."""
    laws = scene.laws()
    kinds = [law_kind(law) for law in laws]
    hand = scene.scripted_hand(phase)
    options = scene.plant_keywords("exact", hand)
    timing = scene.timing(phase)
    fixed = content(
        (
            (scene.axis, scene.end, scene.period, type(hand)),
            (timing.period, timing.delay, timing.jitter, timing.seed),
            {name: value for name, value in options.items() if name not in _STACKED},
            [name for name in _STACKED if options.get(name) is None],
            scene.velocity_estimator(),
        )
    )
    fits = fixed is not None and None not in kinds
    return _Member(index, scene, phase, timing, laws, options, hand, (*kinds, fixed) if fits else None)


def _most_of(member: _Member) -> int:
    """Return the largest batch size of a kind.

    It is smaller for long runs, to fit the recorded motion into memory.
    """
    step = member.options.get("longest_step") or math.inf
    knots = 3.0 * member.scene.ticks(member.timing) * max(math.ceil(member.scene.period / step), 1)
    return max(min(_MOST, int(_ROOM / (knots * _PER_KNOT))), 1)


def _figures_of(members: Sequence[_Member]) -> list[tuple[_Member, Mapping[str, Any]]]:
    """Return the figures of the successful runs of a batch.

    If one fails, the batch is split in halves.
    """
    if len(members) < _LEAST:
        return []
    try:
        stays = _Stays(members)
        stack: Any = SceneStack(members)
        result = run(stack, plant="exact", phase=stack.phases, observe=stays)
        stays.look(components(result.trace.pose[-1]))
        good = np.flatnonzero(stays.all_along)
        parts = [good[start : start + _AT_ONCE] for start in range(0, good.size, _AT_ONCE)]
        rows = [row for part in parts for row in _rows(result[part])]
        return [(members[device], row) for device, row in zip(good.tolist(), rows, strict=True)]
    except Exception:  # of any of them: its own run reports the error
        half = len(members) // 2
        return [*_figures_of(members[:half]), *_figures_of(members[half:])]


def _rows(result: RunResult) -> list[Mapping[str, Any]]:
    """Return the figures of each device of a batch.

    Figures that accept a batch are computed at once.
    """
    figures: Mapping[str, Figure] = result.scene.figures
    at_once = {name: np.asarray(one(result)) for name, one in figures.items() if one.batched}
    others = {name: one for name, one in figures.items() if not one.batched}
    rows: list[Mapping[str, Any]] = []
    for index in range(result.phase.size):
        row = {name: values[..., index] for name, values in at_once.items()}
        if others:
            device = result[index]
            row |= {name: one(device) for name, one in others.items()}
        rows.append({name: row[name] for name in figures})
    return rows


class _Stays:
    """Observer of devices that stay well within range."""

    def __init__(self, members: Sequence[_Member]) -> None:
        distance, angle = members[0].options["escape"]
        self._bounds = (_NEAR * distance) ** 2, (_NEAR * angle) ** 2
        self.all_along: Mask = np.ones(len(members), dtype=bool)

    def __call__(self, sample: Sample, _: Command) -> None:
        """Look at one sample."""
        self.look(sample.position)

    def look(self, position: Sequence[Any]) -> None:
        """Check six position components against the bounds.

        NaN counts as outside.
        """
        x, y, z, rx, ry, rz = position
        distance, angle = self._bounds
        self.all_along &= (x * x + y * y + z * z < distance) & (rx * rx + ry * ry + rz * rz < angle)
