"""Metadata of a run and its running totals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.controller import Controller
from maglev_mj.energy import HandWork, PassivityObserver
from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, ZERO, Array, Command, Sample
from maglev_mj.parameters import axis_indices, flag, number, numbers
from maglev_mj.recording.checks import flag_in, list_in, object_in, six, text_in
from maglev_mj.recording.row import Rows
from maglev_mj.spec import GRAVITY, INERTIA
from maglev_mj.terminal import printable
from maglev_mj.timeline import Timing

Face: TypeAlias = tuple[int, float, float]
"""Plane of a wall: index into AXES, normal, edge.

The normal is 1 or -1; the edge is in [m, rad].
"""

Setup: TypeAlias = Mapping[str, Any]
"""Setup of plant and controller, ready for JSON.

Its entry `run` holds the metadata.
"""

_WRENCHES = ("load", "before", "carried")


@dataclass(frozen=True, kw_only=True, eq=False)
class Mechanics:
    """Mass, constant load and initial wrench of a plant.

    They determine the energy balance. The defaults are the published device's.

    Attributes:
        inertia: Mass and moments of inertia [kg, kg m²], (6,).
        load: Constant wrench besides the actuators', the weight [N, N m], (6,).
        before: Wrench of the actuators until the first command takes effect [N, N m], (6,).

    Raises:
        ParameterError: If a value is not finite, or an inertia is not above 0.
    """

    inertia: ArrayLike = INERTIA
    load: ArrayLike = (0.0, 0.0, -INERTIA[2] * GRAVITY, 0.0, 0.0, 0.0)
    before: ArrayLike = ZERO

    def __post_init__(self) -> None:
        numbers("inertia", self.inertia, at_least=1e-12)
        numbers("load", self.load)
        numbers("before", self.before)

    @classmethod
    def of(cls, plant: Any) -> Self:
        """Return the mechanics of a plant, by default the device's.

        The mass of a hand in a rigid grip moves with the flotor.
        """
        known = {name: getattr(plant, name) for name in ("inertia", "load", "before") if hasattr(plant, name)}
        hand = getattr(plant, "hand", None)
        if hand is not None and not hand.soft:
            known["inertia"] = np.array(known["inertia"], dtype=np.float64)
            known["inertia"][list(hand.indices)] += float(np.asarray(hand.mass))
        return cls(**known)


@dataclass(frozen=True, kw_only=True, eq=False)
class RunMetadata:
    """Metadata of a run besides its samples.

    Attributes:
        period: Sample period [s].
        delay: Time from a sample to its command's effect [s].
        inertia: Moving mass and moments of inertia [kg, kg m²], (6,).
        load: Constant wrench besides the actuators' [N, N m], (6,).
        before: Wrench of the actuators until the first command takes effect [N, N m], (6,).
        carried: Wrench of the actuators that carries the flotor and renders nothing [N, N m], (6,).
        faces: All planes of walls; None in older files, which lack this and the following values.
        name: Name of the run.
        axis: Name of the axis that matters most.
        hand_recorded: True if the hand's wrench was recorded.
        hand_acts_on_flotor: True if the recorded hand acts on the flotor directly, not through a soft grip.

    Raises:
        ParameterError: If a number is outside its bounds.
    """

    period: float
    delay: float
    inertia: Array
    load: Array
    before: Array
    carried: Array
    faces: Sequence[Face] | None = None
    name: str = ""
    axis: str = "z"
    hand_recorded: bool = False
    hand_acts_on_flotor: bool = True

    def __post_init__(self) -> None:
        flag("hand_recorded", self.hand_recorded)
        flag("hand_acts_on_flotor", self.hand_acts_on_flotor)

    @classmethod
    def of(
        cls,
        plant: Any,
        controller: Controller,
        *,
        name: str = "own run",
        axis: str | None = None,
        delay: float | None = None,
        mechanics: Mechanics | None = None,
        hand_recorded: bool | None = None,
    ) -> Self:
        """Return the metadata of a plant and its controller.

        Args:
            plant: The plant.
            controller: The controller.
            name: Name of the run.
            axis: The axis that matters most; by default that of the first wall, or z.
            delay: Time from a sample to its command's effect [s]; the plant's by default.
            mechanics: Mass and constant wrenches; the plant's by default.
            hand_recorded: True if the hand's wrench is recorded; by default if the plant has a hand.

        Raises:
            ParameterError: If the plant has no delay and none is given.
        """
        known = getattr(plant, "timing", plant)
        late = getattr(known, "delay", None) if delay is None else delay
        if late is None:
            raise ParameterError("delay must be given for a plant that has neither timing nor delay, not None")
        masses, faces, hand = mechanics or Mechanics.of(plant), controller.faces, getattr(plant, "hand", None)
        return cls(
            period=controller.period,
            delay=number("delay", late, at_least=0.0),
            **{part: np.broadcast_to(getattr(masses, part), 6) for part in ("inertia", "load", "before")},
            carried=controller.carried,
            faces=faces,
            name=name,
            axis=axis or (AXES[faces[0][0]] if faces else "z"),
            hand_recorded=getattr(plant, "held", False) if hand_recorded is None else hand_recorded,
            hand_acts_on_flotor=hand is None or not hand.soft,
        )

    @classmethod
    def from_json(cls, values: Any) -> Self:
        """Return the metadata from JSON.

        Raises:
            ParameterError: If a value is missing or outside its bounds.
        """
        known: dict[str, Any] = {
            "period": number("period", values.get("period"), above=0.0, at_most=1e3),
            "delay": number("delay", values.get("delay"), at_least=0.0, at_most=1e3),
            "inertia": np.array(six(values, "inertia", at_least=1e-12)),
            **{name: np.array(six(values, name)) for name in _WRENCHES},
        }
        if "faces" in values:
            known["faces"] = [_face(face) for face in list_in(values, "faces")]
            known["name"], known["axis"] = printable(text_in(values, "name")), text_in(values, "axis")
            known |= {name: flag_in(values, name) for name in ("hand_recorded", "hand_acts_on_flotor")}
            axis_indices(known["axis"])
        return cls(**known)

    def as_json(self) -> dict[str, Any]:
        """Return all values, ready for JSON."""
        wrenches = {
            name: dict(zip(AXES, getattr(self, name).tolist(), strict=True)) for name in ("inertia", *_WRENCHES)
        }
        known: dict[str, Any] = {"period": self.period, "delay": self.delay, **wrenches}
        if self.faces is not None:
            known["faces"] = [dict(zip(("axis", "normal", "edge"), (AXES[face[0]], *face[1:]))) for face in self.faces]
            known |= {name: getattr(self, name) for name in ("name", "axis", "hand_recorded", "hand_acts_on_flotor")}
        return known


def _face(values: Any) -> Face:
    """Return a plane of a wall from JSON."""
    face = object_in({"a face": values}, "a face")
    (axis,) = axis_indices(text_in(face, "axis"))
    edge = number("edge", face.get("edge"), at_least=-1e3, at_most=1e3)
    normal = number("normal", face.get("normal"))
    if abs(normal) != 1.0:
        raise ParameterError(f"normal must be 1 or -1, not {normal:g}")
    return axis, normal, edge


class Totals:
    """Running totals of energy, hand work and missed samples.

    Args:
        metadata: Metadata of the stretch.
    """

    def __init__(self, metadata: RunMetadata) -> None:
        timing = Timing(period=metadata.period, delay=metadata.delay)
        self._carried = metadata.carried
        load, before = self._carried + metadata.load, metadata.before - self._carried
        self._observer = PassivityObserver(timing, metadata.inertia, load, before)
        self._hand, self._missed = HandWork(), 0
        self._tick: float | None = None

    def miss(self, count: int) -> None:
        """Count missed samples without a gap in the ticks."""
        self._missed += count

    def add(self, row: Mapping[str, Any]) -> tuple[float, float, int]:
        """Return the totals at a sample given by name.

        Energy absorbed by the rendered world [J], work of the hand [J], missed samples.
        """
        force, width = np.array(row["applied"]) - self._carried, row["applied_pulse_width"]
        command = Command(force.tolist(), row["applied_pulse"], width) if width else Command(force.tolist())
        self._observer(Sample(int(row["tick"]), row["time"], row["position"]), command)
        self._hand.add(np.array(row["position"]), row["hand"])
        if self._tick is not None:  # a device counts on from stretch to stretch
            self._missed += max(int(row["tick"] - self._tick) - 1, 0)
        self._tick = row["tick"]
        return float(self._observer.energy.sum()), self._hand.total, self._missed

    def take(self, rows: Rows) -> Array:
        """Return the totals at N samples, (N, 3).

        Bitwise equal to those of `add`.
        """
        poses, force = np.ascontiguousarray(rows["position"]), rows["applied"] - self._carried
        energy = self._observer.take(poses, force, rows["applied_pulse"], rows["applied_pulse_width"])
        work = self._hand.take(poses, np.ascontiguousarray(rows["hand"]))
        ticks = rows["tick"]
        gaps = np.diff(ticks, prepend=ticks[:1] - 1.0 if self._tick is None else self._tick)
        missed = self._missed + np.add.accumulate(np.maximum(np.trunc(gaps) - 1.0, 0.0))
        self._tick, self._missed = float(ticks[-1]), int(missed[-1])
        return np.column_stack([energy.sum(axis=1), work, missed])
