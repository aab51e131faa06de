"""What is known of what a stretch was recorded from: timing, inertia, forces that no sample tells of, walls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from maglev_mj.controller import Controller
from maglev_mj.frames import AXES, Array
from maglev_mj.hand import hand_called
from maglev_mj.parameters import flag, number, numbers
from maglev_mj.recording import Mechanics, Stretch
from maglev_mj.scenes.legacy import recorded_scene
from maglev_mj.scenes.parts import INERTIA, WEIGHT
from maglev_mj.session import mechanics
from maglev_mj.spec import GRAVITY

__all__ = ["Known", "known_experiment", "known_of"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Known:
    """What is known of what a stretch was recorded from.

    Attributes:
        kind: Of its setup.
        name: What to call it: the experiment, or the scene.
        period: Sample period [s].
        delay: From a sample to its command taking effect [s].
        inertia: Mass and moments of inertia that the actuators push at [kg, kg m²], (6,).
        weight: Force of gravity along z [N]; 0 where nothing weighs.
        carried: Wrench of the actuators that carries the flotor and renders nothing [N, N m], (6,).
        before: Wrench of the actuators until the first command takes effect [N, N m], (6,).
        felt: Whether what the hand exerts was recorded.
        pushed: Whether what was recorded pushes at the flotor itself, not at a hand in a soft grip.
        faces: Every wall: index into AXES, normal, edge.
        axis: Index into AXES of the axis that matters most.

    Raises:
        ParameterError: If a number is outside its bounds.
    """

    kind: str
    name: str
    period: float
    delay: float
    inertia: Array
    weight: float
    carried: Array
    before: Array
    felt: bool
    pushed: bool
    faces: Sequence[tuple[int, float, float]]
    axis: int

    def __post_init__(self) -> None:
        number("period", self.period, above=0.0)
        number("delay", self.delay, at_least=0.0)
        numbers("inertia", self.inertia, at_least=1e-12)
        flag("felt", self.felt)
        flag("pushed", self.pushed)


def known_of(stretch: Stretch, controller: Controller) -> Known:
    """Return what a stretch's setup tells.

    Of a device it tells that it is the nominal one: mass and inertia are those of the model, and until the first
    command takes effect the device gives what that asks for.

    Args:
        stretch: The stretch, of a setup that `rebuild` has made a controller from.
        controller: That controller.
    """
    setup = stretch.setup
    kind, faces = setup["kind"], controller.faces
    if kind not in ("scene", "device"):
        return known_experiment(kind, setup["parameters"], faces)
    scene = recorded_scene(setup["scene"], setup["settings"])
    before = setup["wrench"] if kind == "scene" else stretch.applied[0] if len(stretch.applied) else WEIGHT
    masses = mechanics(scene, before) if kind == "scene" else Mechanics()
    return Known(
        kind=kind,
        name=f"{kind} {scene.name}" if kind == "scene" else f"{scene.name} on a device",
        period=scene.period,
        delay=scene.delay,
        inertia=np.asarray(masses.inertia),
        weight=float(np.asarray(masses.load)[2]),
        carried=controller.carried,
        before=np.array(before, dtype=np.float64),
        felt=kind == "scene",
        pushed=True,
        faces=faces,
        axis=scene.axis_index,
    )


def known_experiment(kind: str, parameters: Mapping[str, Any], faces: Sequence[tuple[int, float, float]] = ()) -> Known:
    """Return what an experiment's parameters tell.

    Args:
        kind: Of the experiment.
        parameters: Its parameters by name.
        faces: Every wall: index into AXES, normal, edge.
    """
    inertia, pushed = INERTIA.copy(), True
    inertia[:3] = parameters.get("mass", inertia[0])
    if kind == "press":
        hand = hand_called(str(parameters["hand"]))
        assert hand is not None  # a press without one cannot be made
        pushed = not hand.soft
        if pushed:  # the hand's mass moves with the flotor; damping and spring of the arm are found from the samples
            inertia[list(hand.indices)] += float(np.asarray(hand.mass))
    return Known(
        kind=kind,
        name=kind,
        period=float(parameters["period"]),
        delay=float(parameters["delay"]),
        inertia=inertia,
        weight=-float(inertia[2]) * GRAVITY if kind == "drop" else 0.0,
        carried=np.zeros(6),
        before=np.zeros(6),
        felt=kind == "press",
        pushed=pushed,
        faces=faces,
        axis=AXES.index(parameters.get("axis", "z")),
    )
