"""Devices of three sizes, on which the thresholds of a flight differ."""

from __future__ import annotations

from collections.abc import Mapping

from maglev_mj.device import Device, published_device

STAGE = Device.load("stage")
LIGHT = (
    STAGE.change("body", mass=0.25, inertia=(1.0e-4, 1.1e-4, 1.6e-4))
    .change("coils", force_constants=(7.0, 7.5, 8.0, 6.0, 6.5, 7.0), current_limit=1.5, continuous_current=0.6)
    .change("loop", rate=500.0, delay=8e-4)
)
"""A device that hovers with 0.11 A."""

DEVICES: Mapping[str, Device] = {"ubc": published_device(), "stage": STAGE, "light": LIGHT}
