"""Metadata of files of before, which do not tell them: found from the kind of their setup."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from maglev_mj.controller import Controller
from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES
from maglev_mj.hand import hand_called
from maglev_mj.recording.metadata import Mechanics, RunMetadata
from maglev_mj.recording.recording import InvalidRecordingError, Stretch
from maglev_mj.spec import GRAVITY, INERTIA

__all__ = ["metadata_of"]

_AXES = {"joystick": "x", "table": "x", "box": "x"}
"""Shown axes of the scenes of before; z elsewhere."""


def metadata_of(stretch: Stretch, controller: Controller | None) -> RunMetadata:
    """Return the metadata of a stretch, as it has them or as the kind of its setup tells.

    Args:
        stretch: The stretch.
        controller: Made from its setup; None where that cannot be.

    Raises:
        InvalidRecordingError: If the recording has none, and is of no kind of before.
    """
    if stretch.metadata is not None and stretch.metadata.faces is not None:
        return stretch.metadata
    kind, setup = stretch.setup["kind"], stretch.setup
    if controller is None:
        named = f" {setup['scene']!r}" if "scene" in setup else ""
        raise InvalidRecordingError(f"a recording of kind {kind!r}{named} must tell its metadata")
    try:
        known = _of_scene(stretch) if kind in ("scene", "device") else _of_experiment(kind, setup["parameters"])
        return RunMetadata(faces=controller.faces, carried=controller.carried, **known)
    except (KeyError, TypeError, ParameterError) as error:
        raise InvalidRecordingError(f"a recording's setup cannot be made here: {error}") from None


def _of_scene(stretch: Stretch) -> Mapping[str, Any]:
    """Return what the setup of a scene tells; on a device, that it is the nominal one."""
    setup, device = stretch.setup, stretch.setup["kind"] == "device"
    before = (stretch.applied[0] if len(stretch) else np.negative(Mechanics.load)) if device else setup["wrench"]
    return {
        "name": f"{setup['scene']} on a device" if device else f"scene {setup['scene']}",
        "period": setup["settings"]["period"],
        "delay": setup["settings"]["delay"],
        "inertia": np.array(INERTIA),
        "load": np.array(Mechanics.load),
        "before": np.array(before, dtype=np.float64),
        "hand_recorded": not device,
        "axis": _AXES.get(setup["scene"], "z"),
    }


def _of_experiment(kind: str, parameters: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return what the parameters of an experiment tell."""
    inertia, load, acts = np.array(INERTIA), np.zeros(len(AXES)), True
    inertia[:3] = parameters.get("mass", inertia[0])
    if kind == "press":
        hand = hand_called(str(parameters["hand"]))
        assert hand is not None  # a press without one cannot be made
        acts = not hand.soft
        if acts:  # the hand's mass moves with the flotor; damping and spring of the arm are found from the samples
            inertia[list(hand.indices)] += float(np.asarray(hand.mass))
    if kind == "drop":
        load[2] = -float(inertia[2]) * GRAVITY
    return {
        "name": kind,
        "period": float(parameters["period"]),
        "delay": float(parameters["delay"]),
        "inertia": inertia,
        "load": load,
        "before": np.zeros(len(AXES)),
        "hand_recorded": kind == "press",
        "hand_acts_on_flotor": acts,
        "axis": parameters.get("axis", "z"),
    }
