"""A browser without a screen, for tests of the page."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any

import numpy as np

from maglev_mj.frames import Array

_CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")

MISSING = [name for name in ("viser", "playwright") if find_spec(name) is None] + ["chromium"] * (_CHROMIUM is None)
"""Missing programs that a browser test needs."""

FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
"""Of a Chromium that draws by software alone."""


@contextmanager
def chromium(*flags: str, draws_3d: bool = True) -> Iterator[Any]:
    """Yield a Chromium that is started with more flags, and with `FLAGS` if it draws in three dimensions."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        own = [*FLAGS, "--disable-gpu-sandbox", "--ignore-gpu-blocklist"] if draws_3d else ["--no-sandbox"]
        browser = playwright.chromium.launch(executable_path=_CHROMIUM, args=[*own, *flags])
        yield browser
        browser.close()


def on_screen(page: Any, point: Any, view: tuple[Any, Any], field: float) -> tuple[float, float]:
    """Return a point's position in the browser [px].

    Args:
        page: Playwright's.
        point: The point [m], (3,).
        view: Where the camera is and what it looks at [m], (3,) each.
        field: Angle of view, up [rad].
    """
    box = page.locator("canvas[data-engine]").bounding_box()
    place, target = np.array(view)
    ahead = _unit(target - place)
    right = _unit(np.cross(ahead, [0.0, 0.0, 1.0]))
    away = np.asarray(point) - place
    scale = 0.5 * box["height"] / np.tan(0.5 * field) / (away @ ahead)
    x = box["x"] + 0.5 * box["width"] + scale * (away @ right)
    return float(x), float(box["y"] + 0.5 * box["height"] - scale * (away @ np.cross(right, ahead)))


def _unit(vector: Array) -> Array:
    made: Array = vector / np.linalg.norm(vector)
    return made
