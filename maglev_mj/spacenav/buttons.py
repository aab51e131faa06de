"""Virtual buttons: short taps of the handle on a wall."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from maglev_mj.parameters import number
from maglev_mj.session import Snapshot
from maglev_mj.spacenav.axes import RUNS

Buttons: TypeAlias = Callable[[Snapshot], tuple[bool, ...]]
"""Returns which buttons are down at a snapshot."""

NO_BUTTONS: tuple[bool, ...] = (False, False)
"""Both buttons, up."""

_Z, _WALLS = 2, (1.0, -1.0)
_SHORTEST, _LONGEST = 0.055, 0.155
_RELEASE = 0.5


class Taps:
    """Two buttons: 0 at the lower wall, 1 above.

    The handle taps if the force along z in a wall passes half of `force`, reaches `force`, and is below half of it
    again 0.06 to 0.15 s later. A bounce is shorter, a handle that leans on the wall longer. The button is down for one
    snapshot, at the end of the tap. The times are those of snapshots, 60 in a second.

    Args:
        force: Force of the device against the handle, springs and friction included [N].

    Raises:
        ParameterError: If it is not above 0.
    """

    def __init__(self, force: float) -> None:
        self._force = number("force", force, above=0.0)
        self._began: list[float | None] = [None, None]
        self._peak = [0.0, 0.0]

    def __call__(self, snapshot: Snapshot) -> tuple[bool, ...]:
        """Return which buttons are down; see `Buttons`."""
        return tuple(self._tapped(button, normal, snapshot) for button, normal in enumerate(_WALLS))

    def _tapped(self, button: int, normal: float, snapshot: Snapshot) -> bool:
        """Follow one wall; return True when a tap ends."""
        began, force = self._began[button], _force(snapshot, normal)
        if force >= _RELEASE * self._force:
            self._began[button] = snapshot.time if began is None else began
            self._peak[button] = max(self._peak[button], force)
            return False
        tapped = self._peak[button] >= self._force and began is not None
        self._began[button], self._peak[button] = None, 0.0
        return tapped and began is not None and _SHORTEST <= snapshot.time - began <= _LONGEST


def _force(snapshot: Snapshot, normal: float) -> float:
    """Return the wall force along z [N].

    0 outside the wall, and while the scene does not run.
    """
    inside = any(
        axis == _Z and way == normal and way * (edge - snapshot.pose[_Z]) > 0.0 for axis, way, edge in snapshot.faces
    )
    return normal * float(snapshot.force[_Z]) if inside and snapshot.state in RUNS else 0.0
