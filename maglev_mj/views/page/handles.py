"""Properties of viser's elements."""

from __future__ import annotations

from typing import Any

import numpy as np


def put(handle: Any, **properties: Any) -> None:
    """Set the properties that differ.

    viser would send the others to every browser again.
    """
    for name, value in properties.items():
        if not np.array_equal(getattr(handle, name), value):
            setattr(handle, name, value)
