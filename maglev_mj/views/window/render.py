"""Rendering of a scene to a file.

Its scripted hand moves the flotor.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from maglev_mj.parameters import flag
from maglev_mj.plants import engine_warnings_silenced
from maglev_mj.plants.hand import SpringHand
from maglev_mj.scenes import Scene
from maglev_mj.session import Pacer, Session
from maglev_mj.views.window.clip import CLIPS, write_clip, write_picture
from maglev_mj.views.window.offscreen import OffscreenPainter

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
    """Run a scene and write a picture or clip.

    The scripted hand moves the flotor.

    Args:
        scene: The scene.
        path: File with the ending .png, .gif or .mp4.
        seconds: Time of the picture, or duration of the clip [s]; None for half the run, or all of it.
        width: Width [pixels].
        height: Height [pixels].
        rate: Frames per second of a clip.
        plots: True to include plots and text.
        progress: Function called with the number of pictures drawn and the number of all.

    Returns:
        Number of pictures drawn.

    Raises:
        DisplayError: If there is no drawing library.
        MissingPackageError: If a clip is requested, and the package that writes it is not installed.
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
