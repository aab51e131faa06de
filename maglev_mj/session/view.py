"""Faces and stick positions of a controller's laws."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from maglev_mj.controller import Controller
from maglev_mj.frames import AXES, Array
from maglev_mj.laws import Friction, Law, Wall

__all__ = ["stick_positions", "wall_faces"]


def wall_faces(laws: Sequence[Law]) -> tuple[tuple[int, float, float], ...]:
    """Return every wall of some laws: index into AXES, normal, edge."""
    return tuple(face for law in laws if isinstance(law, Wall) for face in law.faces)


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
