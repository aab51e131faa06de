"""Pictures and clips as files.

PNG needs only the core packages; GIF and MP4 need imageio.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maglev_mj.errors import ParameterError, require

CLIPS = (".gif", ".mp4")
"""File endings of clips."""

Pixels = NDArray[np.uint8]


def checked_name(path: Path) -> Path:
    """Return a file's name with a checked ending.

    Raises:
        ParameterError: If the ending is not that of a picture or clip.
        MissingPackageError: If the package that writes it is not installed.
    """
    if path.suffix not in (".png", *CLIPS):
        raise ParameterError(f"out must end in .png, .gif or .mp4, not {str(path)!r}")
    if path.suffix in CLIPS:
        _imageio()
    return path


def write_picture(pixels: Pixels, path: Path) -> None:
    """Write a PNG file.

    Args:
        pixels: The picture, (height, width, 3).
        path: The file.
    """
    height, width, _ = pixels.shape
    rows = np.zeros((height, 1 + 3 * width), dtype=np.uint8)  # each row begins with its filter: 0, none
    rows[:, 1:] = pixels.reshape(height, -1)
    head = struct.pack(">2I5B", width, height, 8, 2, 0, 0, 0)
    parts = ((b"IHDR", head), (b"IDAT", zlib.compress(rows.tobytes(), 6)), (b"IEND", b""))
    chunks = b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in parts
    )
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunks)


def write_clip(frames: Iterable[Pixels], path: Path, rate: int) -> None:
    """Write a GIF or MP4 file.

    Args:
        frames: The pictures, (height, width, 3) each, of even height and width.
        path: The file.
        rate: Frames per second.

    Raises:
        MissingPackageError: If imageio is not installed.
    """
    imageio = _imageio()
    if path.suffix == ".gif":
        _write_gif(frames, path, 1000.0 / rate)
        return
    with imageio.get_writer(path, fps=rate, macro_block_size=2) as writer:
        for frame in frames:
            writer.append_data(np.ascontiguousarray(frame))


def _write_gif(frames: Iterable[Pixels], path: Path, duration: float) -> None:
    """Write a GIF of frames with own palettes.

    A frame lasts `duration` [ms] and has 256 colours of its own.
    """
    from PIL import Image  # imageio's own

    # the octree keeps the colour of a small mark, which a median cut loses to shades of a large floor
    octree, plain = Image.Quantize.FASTOCTREE, Image.Dither.NONE
    few = (Image.fromarray(np.ascontiguousarray(frame)).quantize(256, octree, dither=plain) for frame in frames)
    next(few).save(path, save_all=True, append_images=few, duration=duration, loop=0)


def _imageio() -> Any:
    require(("imageio", "imageio_ffmpeg"), "clips", "clips need imageio with ffmpeg")
    import imageio.v2

    return imageio.v2
