"""A scene with its scripted hand, drawn into a file."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from maglev_mj.hand import SpringHand
from maglev_mj.parameters import flag
from maglev_mj.plants import engine_warnings_silenced
from maglev_mj.scenes import Scene
from maglev_mj.session import Pacer, Session
from maglev_mj.viewer.clip import CLIPS, write_clip, write_picture
from maglev_mj.viewer.offscreen import OffscreenPainter

__all__ = ["render"]

_FOR_EVER = 3600.0


def render(
    scene: Scene,
    path: Path,
    *,
    seconds: float | None = None,
    width: int = 1200,
    height: int = 750,
    rate: int = 20,
    plots: bool = True,
    progress: Callable[[int, int], object] = lambda done, total: None,
) -> int:
    """Run a scene in the scripted hand and write a picture or a clip of it.

    Args:
        scene: The scene.
        path: File that ends in .png, .gif or .mp4.
        seconds: When the picture is taken, or how long the clip is [s]; None for half the run, or all of it.
        width: Pixels.
        height: Pixels.
        rate: Pictures a second of a clip.
        plots: Whether plots and words are in it.
        progress: Called with how many pictures are drawn, and with all of them.

    Returns:
        How many pictures were drawn.

    Raises:
        DisplayError: If there is no library to draw with.
        MissingPackageError: If a clip is asked for, and what writes it is not installed.
    """
    flag("plots", plots)
    moving = path.suffix in CLIPS
    end = seconds if seconds is not None else scene.end if moving else 0.5 * scene.end
    session = Session(
        scene,
        hand=scene.scripted_hand() or SpringHand(),
        pacer=Pacer(budget=_FOR_EVER, patience=_FOR_EVER),  # no hurry
    )
    drawn = max(round(end * rate), 1) if moving else 1
    with OffscreenPainter(scene, width, height, plots=plots) as painter, engine_warnings_silenced():
        painter.wait(session.snapshot())
        if not moving:
            session.tick(end)
            write_picture(painter.picture(session.snapshot()), path)
        else:
            write_clip(_pictures(session, painter, drawn, 1.0 / rate, progress), path, rate)
    session.close()
    return drawn


def _pictures(
    session: Session,
    painter: OffscreenPainter,
    count: int,
    step: float,
    progress: Callable[[int, int], object],
) -> Iterator[Any]:
    for place in range(count):
        yield painter.picture(session.snapshot())
        session.tick(step)
        progress(place + 1, count)
