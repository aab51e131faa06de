"""Status text on the screen: the readings and the tour's task."""

from __future__ import annotations

from collections.abc import Sequence

from maglev_mj.plants.shapes import ARROW
from maglev_mj.session import Snapshot
from maglev_mj.views.window.keys import HAND, key_of
from maglev_mj.views.window.layout import Row
from maglev_mj.views.words import FORCES, readings

_DRAWN = "position", *FORCES  # by plots and arrows
_ARROWS = "arrows", f"blue hand, orange device, black stop, {5e3 * ARROW:.0f} mm for 5 N"


def status_rows(snapshot: Snapshot, notes: Sequence[str] = ()) -> list[Row]:
    """Return the status rows of a session.

    Names and values, the most important first.

    Args:
        snapshot: The present snapshot.
        notes: Further notes, such as the last screenshot.
    """
    rows = [(name, value) for name, value, _ in readings(snapshot, notes) if name not in _DRAWN]
    place = next((place for place, row in enumerate(rows) if row[0] == "tick"), len(rows))
    return [*_tour(snapshot), *rows[:place], _ARROWS, *rows[place:]]


def _tour(snapshot: Snapshot) -> list[Row]:
    """Return the step and task of the guided tour."""
    if (line := snapshot.tour) is None:
        return []
    text, deed = line.words(lambda action: HAND if action == "hand" else key_of(action, snapshot.actions))
    return [(f"{line.number} of {line.total}", text), *([] if line.done else [("do", deed)])]
