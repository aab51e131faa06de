"""What the tables share."""

from __future__ import annotations

from typing import Any

import numpy as np

__all__ = ["cell"]


def cell(value: Any, scale: float) -> str:
    """Return a figure to four digits; a dash for one that is not there."""
    number = float(value) * scale
    if not np.isfinite(number):
        return "-"
    return f"{number:.0f}" if abs(number) >= 100.0 else f"{number:.1f}" if abs(number) >= 10.0 else f"{number:.2f}"
