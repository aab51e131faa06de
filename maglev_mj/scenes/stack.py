"""Many scenes as one scene of N devices: of several phases, or that differ in numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any

import numpy as np

from maglev_mj.control import VelocityEstimator
from maglev_mj.control.controller import Controller
from maglev_mj.control.stack import law_kind, stacked
from maglev_mj.errors import ParameterError
from maglev_mj.frames import Array, Component
from maglev_mj.plants import SampledPlant, Timing
from maglev_mj.plants.hand import HandForce
from maglev_mj.plants.model import Flotor
from maglev_mj.scenes.scene import PLANTS, PlantMaker, Scene

FAR = (1e15, 1e15)
"""Divergence bounds of a batch that a device which leaves its range does not end."""

STACKED = ("pose", "twist", "wrench", "mass", "wrench_limit")
"""Keywords of a plant that may differ between the devices of a batch."""


@dataclass(frozen=True)
class Member:
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

    Args:
        members: The runs.
        escape: Divergence bounds of each device, see `SampledPlant`; None for those of the first scene.
    """

    def __init__(self, members: Sequence[Member], escape: tuple[float, float] | None = None) -> None:
        self.scenes = [member.scene for member in members]
        self.phases = np.array([member.phase for member in members])
        self._members, self._escape = members, escape

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
        self,
        plant: str | PlantMaker = "exact",
        *,
        phase: Array | None = None,
        timing: Timing | None = None,
        **keywords: Any,
    ) -> SampledPlant:
        """Return the plant of N devices at release.

        Args:
            plant: "exact", or a function that returns a plant of N devices.
            phase: Ignored: each scene has its own timing.
            timing: Timing in place of the scenes' own.
            keywords: Keywords of the plant; they override the scenes'.
        """
        options = dict(self.plant_options())
        for name in STACKED:
            if options.get(name) is not None:
                rows = np.array([member.options[name] for member in self._members], dtype=np.float64)
                options[name] = rows if name == "pose" or (rows != rows[0]).any() else options[name]
        hands = [member.hand_force for member in self._members if member.hand_force is not None]
        options |= {"escape": self._escape or options["escape"], "hand_force": SideBySide(hands) if hands else None}
        make = PLANTS[plant] if isinstance(plant, str) else plant
        return make(timing or self.timing(), **options | keywords)

    def ticks(self, timing: Timing) -> int:
        """Return the number of samples until the end."""
        return self.scenes[0].ticks(timing)

    def timing(self, _: Array | None = None) -> Timing:
        """Return the timing of samples and commands, with the scenes' own phases."""
        phases = [member.timing.phase for member in self._members]
        equal = all(phase == phases[0] for phase in phases)  # a hand needs a common clock
        return replace(self._members[0].timing, phase=phases[0] if equal else np.array(phases))


def stacked_scenes(points: Sequence[tuple[Scene, float]], plant: str = "exact") -> SceneStack:
    """Return scenes at their phases as one stack.

    Args:
        points: Scenes and phases; of a scene at several phases, the laws and the keywords of the plant are made once.
        plant: Name from PLANTS, for those keywords.

    Raises:
        ParameterError: If their laws differ in more than declared gains.
    """
    members, first = list[Member](), dict[int, Member]()
    for scene, phase in points:
        hand, timing = scene.scripted_hand(phase), scene.timing(phase)
        if (one := first.get(id(scene))) is None:
            controller, options = scene.controller(), scene.plant_keywords(plant, hand)
            one = first[id(scene)] = Member(scene, phase, timing, controller.laws, controller.velocity, options, hand)
        members.append(replace(one, phase=phase, timing=timing, hand_force=hand))
    for laws in zip(*(member.laws for member in first.values()), strict=True):
        kinds = {id(law): law_kind(law) for law in laws}
        if len(kinds) > 1 and (len({*kinds.values()}) > 1 or None in kinds.values()):
            name = getattr(laws[0], "name", type(laws[0]).__name__)
            raise ParameterError(
                f"law {name} must be an AxisLaw or list its gains in per_device, and differ only in those"
            )
    return SceneStack(members)


class SideBySide:
    """N hands of a batch as one, each at the time and state of its device."""

    def __init__(self, hands: Sequence[HandForce]) -> None:
        self._hands, self.hand = hands, getattr(hands[0], "hand", None)

    def __call__(self, tick: int, time: Component, state: Any) -> list[Array]:
        """See `HandForce`."""
        times, once = np.broadcast_to(time, len(self._hands)).tolist(), cache(state)
        rows = [
            hand(tick, at, lambda own=device: tuple(part[own] for part in once()))  # type: ignore[misc]
            for device, (hand, at) in enumerate(zip(self._hands, times, strict=True))
        ]
        return [np.array(part) for part in zip(*rows, strict=True)]
