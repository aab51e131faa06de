"""Metadata of older files, obtained from plant and controller."""

from __future__ import annotations

from typing import Any

import numpy as np

from maglev_mj.errors import ParameterError, check_instance
from maglev_mj.recording.metadata import Mechanics, RunMetadata
from maglev_mj.recording.recording import InvalidRecordingError, Stretch
from maglev_mj.recording.verify import Rebuild

_AXES = {"joystick": "x", "table": "x", "box": "x"}
"""Displayed axis of older scenes; z for all others."""


def metadata_of(stretch: Stretch, rebuild: Rebuild | None) -> RunMetadata:
    """Return the metadata of a stretch, recorded or reconstructed.

    Args:
        stretch: The stretch.
        rebuild: Function that makes plant and controller from the setup; None if not available.

    Raises:
        InvalidRecordingError: If the recording has no metadata and is of no older format.
    """
    check_instance("stretch", stretch, Stretch, "a Stretch, such as Recording.load(FILE).stretches[0]")
    if stretch.metadata is not None and stretch.metadata.faces is not None:
        return stretch.metadata
    kind, setup = stretch.setup["kind"], stretch.setup
    if rebuild is None:
        named = f" {setup['scene']!r}" if "scene" in setup else ""
        raise InvalidRecordingError(f"a recording of kind {kind!r}{named} must tell its metadata")
    plant, controller = rebuild(setup, None)
    told: dict[str, Any] = {"name": kind, "axis": setup.get("parameters", {}).get("axis", "z")}
    try:
        if kind in ("scene", "device"):
            device, name = kind == "device", setup["scene"]
            told = {"name": f"{name} on a device" if device else f"scene {name}", "axis": _AXES.get(name, "z")}
            told["hand_recorded"] = not device
            if device:  # a nominal one
                before = stretch.applied[0] if len(stretch) else np.negative(Mechanics.load)
                told |= {"mechanics": Mechanics(before=before), "delay": setup["settings"]["delay"]}
        return RunMetadata.of(plant, controller, **told)
    except (KeyError, TypeError, ParameterError) as error:
        raise InvalidRecordingError(f"a recording's setup cannot be made here: {error}") from None
