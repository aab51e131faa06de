"""What there is to see of a session, and what a window or a clip asks of one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from maglev_mj.controller import Controller
from maglev_mj.frames import AXES, Array
from maglev_mj.hand import SpringHand
from maglev_mj.laws import Friction
from maglev_mj.scenes import Scene, Settings

__all__ = ["Showable", "View", "stick_positions"]


@dataclass(frozen=True, kw_only=True, eq=False)
class View:
    """What there is to see at an instant.

    Attributes:
        scene: The scene.
        settings: Its settings.
        time: Time of the session [s].
        pose: Of the flotor [m, rad], (6,).
        force: Wrench that the device holds, after every limit and without pulses, beyond what carries the flotor
            [N, N m], (6,).
        hand: Wrench of the hand [N, N m], (6,).
        currents: In the coils [A], (6,).
        faces: Every wall: index into AXES, normal, edge.
        anchors: Where the flotor sticks [m, rad], (6,), NaN where it does not; None without friction.
        history: The last two seconds on the scene's axis: time, position, velocity, force of the device and of the
            hand, (N, 5).
        work: Of the hand [J].
        taken: What the rendered world has taken in [J].
        cost: Real time of a tick [s].
        missed: Ticks given up.
        notes: What a person should know now, such as that the session is paused.
    """

    scene: Scene
    settings: Settings
    time: float
    pose: Array
    force: Array
    hand: Array
    currents: Array
    faces: Sequence[tuple[int, float, float]]
    anchors: Array | None
    history: Array
    work: float
    taken: float
    cost: float
    missed: int
    notes: Sequence[str]


class Showable(Protocol):
    """What a window or a clip can show."""

    hand: SpringHand
    simulated: float

    def tick(self, elapsed: float) -> int:
        """Go on by as much as real time has [s]; return how many control ticks that were."""

    def act(self, action: str) -> None:
        """Do what a key asks for."""

    def view(self) -> View:
        """Return what there is to see."""

    def close(self) -> None:
        """Keep what is recorded."""


def stick_positions(controller: Controller) -> Callable[[], Array | None]:
    """Return what says where a controller's friction sticks [m, rad], (6,), NaN where it does not; None without any."""
    found = ((place, law.indices) for place, law in enumerate(controller.laws) if isinstance(law, Friction))
    place, indices = next(found, (-1, ()))

    def positions() -> Array | None:
        states = controller.states[place] if indices else None
        if states is None:
            return None
        anchors = np.full(len(AXES), np.nan)
        for index, state in zip(indices, states, strict=True):
            anchors[index] = state.anchor if state.stuck else np.nan
        return anchors

    return positions
