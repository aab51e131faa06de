"""Mass, inertia, weight and rest of the published joystick; a device with eight coils."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from maglev_mj.device import Device, published_device
from maglev_mj.plants.model import body_of

MASS = published_device().mass
"""Moving mass [kg]."""

INERTIA = published_device().inertia
"""Mass and moments of inertia [kg, kg m²], (6,)."""

WEIGHT = tuple((0.0 - body_of({}).load).tolist())
"""Wrench that compensates the flotor's weight [N, N m]."""

REST = published_device().rest
"""Pose on the lower stop [m, rad]."""

_AROUND = np.linspace(0.0, 2.0 * np.pi, 4, endpoint=False)
_OUT, _ALONG = (
    np.column_stack([*axes, 0.0 * _AROUND])
    for axes in ((np.cos(_AROUND), np.sin(_AROUND)), (-np.sin(_AROUND), np.cos(_AROUND)))
)
EIGHT = replace(
    Device.load("stage").change(
        "coils",
        points=[*(0.03 * _OUT + [0.0, 0.0, 0.006]).tolist(), *(0.028 * _OUT - [0.0, 0.0, 0.018]).tolist()],
        directions=[[0.0, 0.0, 1.0]] * 4 + _ALONG.tolist(),
        force_constants=[1.1, 1.2, 1.0, 1.1, 1.3, 1.1, 0.9, 1.1],
    ),
    name="eight",
)
"""The stage with four vertical and four horizontal coils of different force constants."""
