"""The window as a front in a process of its own."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from maglev_mj.display.remote import Front
from maglev_mj.session import SnapshotSource

__all__ = ["window"]


def window(folder: Path = Path()) -> Front:
    """Return what opens a window; screenshots go to a folder."""
    return partial(_window, folder)


def _window(folder: Path, session: SnapshotSource) -> None:
    from maglev_mj.viewer.window import show

    show(session, folder=folder)
