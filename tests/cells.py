"""Verdicts on cells of a sweep, for tests."""

from __future__ import annotations

from collections.abc import Sequence

from maglev_mj.scenes.scene import Scene
from maglev_mj.scenes.stability_check import marks


def unstable(scenes: Sequence[Scene]) -> list[bool | None]:
    """Return whether the cell of each scene is marked as unstable; None if it is not judged."""
    return [{"": False, "unstable": True}.get(mark) for mark in marks(scenes)]
