"""Pictures and clips of a scene, rendered off screen and written to files."""

from __future__ import annotations

import struct
import subprocess
import warnings
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, contextmanager
from importlib import import_module
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maglev_mj.errors import ParameterError, require
from maglev_mj.files import atomic_path
from maglev_mj.frames import Array
from maglev_mj.parameters import flag
from maglev_mj.plants import engine_warnings_silenced
from maglev_mj.plants.hand import SpringHand
from maglev_mj.process import interrupts_held
from maglev_mj.recording.export import write_sound
from maglev_mj.scenes import Scene
from maglev_mj.session import TIME_SCALES, Pacer, Session, Snapshot
from maglev_mj.session.margin import STABILITY
from maglev_mj.terminal import say
from maglev_mj.views.window.backend import NEEDS, DisplayError, drawing_library
from maglev_mj.views.window.painter import Painter
from maglev_mj.views.window.screen import Area, Screen

CLIPS = (".gif", ".mp4")
"""File extensions of clips."""

Pixels = NDArray[np.uint8]
Draw = Callable[[Snapshot], Pixels]


def checked_name(path: Path) -> Path:
    """Return a path after checking its extension.

    Raises:
        ParameterError: If the extension is not that of a picture or clip.
        MissingPackageError: If the package that writes clips is not installed.
    """
    if path.suffix not in (".png", *CLIPS):
        raise ParameterError(f"out must end in .png, .gif or .mp4 (got {str(path)!r})")
    if path.suffix in CLIPS:
        require(("imageio", "imageio_ffmpeg"), "clips", "clips require imageio with ffmpeg")
    return path


def write_picture(pixels: Pixels, path: Path) -> None:
    """Write a PNG file.

    Args:
        pixels: Picture, (height, width, 3).
        path: Path of the file.
    """
    height, width, _ = pixels.shape
    rows = np.zeros((height, 1 + 3 * width), dtype=np.uint8)  # each row begins with its filter type, 0: none
    rows[:, 1:] = pixels.reshape(height, -1)
    head = struct.pack(">2I5B", width, height, 8, 2, 0, 0, 0)
    content = b"\x89PNG\r\n\x1a\n"
    for chunk in (b"IHDR" + head, b"IDAT" + zlib.compress(rows.tobytes(), 6), b"IEND"):
        content += struct.pack(">I", len(chunk) - 4) + chunk + struct.pack(">I", zlib.crc32(chunk))
    path.write_bytes(content)


def write_clip(frames: Iterable[Pixels], path: Path, rate: int) -> None:
    """Write a GIF or MP4 file.

    Args:
        frames: Pictures, (height, width, 3) each, of even height and width.
        path: Path of the file.
        rate: Frames per second.

    Raises:
        MissingPackageError: If imageio is not installed.
    """
    checked_name(path)
    if path.suffix == ".gif":
        _write_gif(frames, path, 1000.0 / rate)
        return
    with import_module("imageio.v2").get_writer(path, fps=rate, macro_block_size=2) as writer:
        for frame in frames:
            writer.append_data(np.ascontiguousarray(frame))


def _write_gif(frames: Iterable[Pixels], path: Path, duration: float) -> None:
    """Write a GIF; each frame lasts `duration` [ms] and has its own palette of 256 colours."""
    from PIL import Image  # a dependency of imageio

    # an octree preserves the colour of small marks, which a median cut loses to shades of the floor
    octree, plain = Image.Quantize.FASTOCTREE, Image.Dither.NONE
    few = (Image.fromarray(np.ascontiguousarray(frame)).quantize(256, octree, dither=plain) for frame in frames)
    next(few).save(path, save_all=True, append_images=few, duration=duration, loop=0)


_LARGE = 1500


@contextmanager
def _drawing(scene: Scene, width: int, height: int, *, plots: bool) -> Iterator[Draw]:
    """Yield a function that returns the picture of a snapshot, (height, width, 3).

    Args:
        scene: The scene.
        width: Width of the pictures [pixels].
        height: Height of the pictures [pixels].
        plots: True to include plots and text.

    Raises:
        DisplayError: If there is no OpenGL library.
        ModelError: If the model file is missing or invalid.
    """
    view, library = Area(0, 0, width, height), drawing_library()
    try:
        with interrupts_held(), warnings.catch_warnings():  # a half-created context cannot be freed
            warnings.simplefilter("error", UserWarning)  # glfw only warns of a missing display
            context = import_module(f"mujoco.{library}").GLContext(width, height)
    except (ImportError, AttributeError, OSError, RuntimeError, TypeError, UserWarning) as error:
        raise DisplayError(f"cannot render with {library} ({NEEDS[library]}; or set MUJOCO_GL): {error}") from error
    context.make_current()
    # without plots, only the numbers of the forces: larger
    scale = (150 if height >= _LARGE else 100) if plots else min(max(50 * round(height / 125), 150), 300)
    screen = Screen(keys=False, plots=plots)

    def picture(snapshot: Snapshot) -> Pixels:
        STABILITY.of(snapshot, wait=True)
        painter.draw(snapshot, view)
        return painter.pixels(view)

    try:
        with closing(Painter(scene, screen, scale=scale, size=(width, height))) as painter:
            yield picture
    finally:
        context.free()


_UNLIMITED = 3600.0


def slow_motion(seconds: float) -> float:
    """Return the default time scale of a clip.

    1 from 1 s of simulated time; below, the largest of TIME_SCALES at which the clip lasts at least 4 s.
    """
    slow = [scale for scale in TIME_SCALES if seconds / scale >= 4.0]
    return 1.0 if seconds >= 1.0 else max(slow, default=TIME_SCALES[0])


def render(
    scene: Scene,
    path: Path,
    *,
    seconds: float | None = None,
    time_scale: float | None = None,
    width: int = 1200,
    height: int = 750,
    rate: int = 20,
    plots: bool = True,
    progress: Callable[[int, int], object] = lambda done, total: None,
) -> int:
    """Run a scene with its scripted hand and write a picture or clip.

    An MP4 file contains the force as sound, at the time scale of the clip.

    Args:
        scene: The scene.
        path: File with the extension .png, .gif or .mp4.
        seconds: Simulated time of the picture, or duration of the clip [s]; None for half the run, or all of it.
        time_scale: Simulated time per second of a clip, 0.001 to 1; None for `slow_motion`.
        width: Width [pixels].
        height: Height [pixels].
        rate: Frames per second of a clip.
        plots: True to include plots and text.
        progress: Function called with the number of pictures drawn and the total.

    Returns:
        Number of pictures drawn.

    Raises:
        DisplayError: If there is no OpenGL library.
        MissingPackageError: If the package that writes clips is not installed.
    """
    flag("plots", plots)
    moving = path.suffix in CLIPS
    end = seconds if seconds is not None else scene.end if moving else 0.5 * scene.end
    unlimited = Pacer(budget=_UNLIMITED, patience=_UNLIMITED)  # no deadline
    session = Session(scene, hand_force=scene.scripted_hand() or SpringHand(), pacer=unlimited)
    if time_scale is None:
        time_scale = slow_motion(end) if moving else 1.0
    session.change({"time_scale": time_scale})
    drawn, forces = max(round(end * rate / time_scale), 1) if moving else 1, list[Array]()
    with engine_warnings_silenced(), _drawing(scene, width, height, plots=plots) as picture:

        def pictures() -> Iterator[Pixels]:
            for index in range(drawn):
                yield picture(session.snapshot())
                if ticks := session.tick(1.0 / rate):
                    forces.append(session.snapshot().history[-ticks:, 13:19])
                progress(index + 1, drawn)

        with atomic_path(path) as partial:
            if not moving:
                session.tick(end / time_scale)
                write_picture(picture(session.snapshot()), partial)
            else:
                write_clip(pictures(), partial, rate)
            if path.suffix == ".mp4" and forces:
                sound = BytesIO()
                write_sound(sound, [(np.concatenate(forces), scene.period / time_scale)], turns=scene.axis_index > 2)
                _add_sound(partial, sound.getvalue(), drawn / rate)
    session.close()
    return drawn


def _add_sound(path: Path, sound: bytes, length: float) -> None:
    """Add the sound of a WAV file to a clip of a given duration [s]; report a failure."""
    from imageio_ffmpeg import get_ffmpeg_exe

    options = f"-c:v copy -c:a aac -af apad -t {length} -loglevel error -y".split()
    command = [get_ffmpeg_exe(), "-i", str(path), "-i", "pipe:0", *options]
    try:
        with atomic_path(path) as partial:
            subprocess.run([*command, str(partial)], input=sound, capture_output=True, check=True)
    except subprocess.CalledProcessError as error:
        say(f"  the clip has no sound: {error.stderr.decode(errors='replace').partition(chr(10))[0]}")
