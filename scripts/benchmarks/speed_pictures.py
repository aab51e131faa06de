"""Charts of bench.py's figures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import growth
import realism
import speed_accuracy
from maglev_mj.pictures import PictureFolder

_DRAWN = {"speed_accuracy": speed_accuracy.draw, "realism": realism.draw, "growth": growth.draw}


def draw(pictures: PictureFolder, sections: Mapping[str, Any]) -> list[Path]:
    """Draw the sections that have pictures; return their files."""
    return [
        path
        for name, picture in _DRAWN.items()
        if sections.get(name, {}).get("details")
        for path in picture(pictures, sections[name]["details"])
    ]
