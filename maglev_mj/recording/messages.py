"""Run as messages for other programs: samples, frames, drawings, events.

They are logged to a context of foxglove-sdk, for the files attached to it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from foxglove import Channel, Context, Schema, messages
from foxglove.channels import FrameTransformsChannel, LogChannel, SceneUpdateChannel

from maglev_mj.frames import Array, quaternion, rotation_matrix
from maglev_mj.plants.shapes import ARROW, GRIP, LEAST_FORCE, Shape, arrow_start, shapes, wall_plate
from maglev_mj.recording.mcap import EVENT, NAME, SAMPLE, SEGMENT, SEGMENT_NUMBER, descriptor, packed
from maglev_mj.recording.sample import FIELDS, Field, Rows, RunMetadata, Setup, Totals, schema

FRAMES, SHAPES, ARROWS, LOG = "/tf", "/maglev/shapes", "/maglev/arrows", "/log"

_SHOWN = 60.0  # poses to look at in a second
_WALL, _HAND, _DEVICE = (0.25, 0.47, 0.85, 0.16), (0.13, 0.62, 0.30, 1.0), (0.80, 0.16, 0.14, 1.0)
_UPRIGHT = 1.0, 0.0, 0.0, 0.0
_SHAFT, _HEAD, _HEAD_LENGTH = 0.0032, 0.0064, 0.25
_LEVELS = {
    "fault": messages.LogLevel.Error,
    "lost": messages.LogLevel.Error,
    "missed": messages.LogLevel.Warning,
}
_WRENCH = "N", "N m"
_NUMBER = schema(SEGMENT_NUMBER)


def _of(kind: str, description: str) -> dict[str, Any]:
    return {"type": kind, "description": description}


_SEGMENT_FIELDS = {
    "segment": _NUMBER,
    "setup": _of(
        "object", "what plant and controller are made from: kind, scene, parameters, controller, plant, versions"
    ),
    "period": schema(Field("period", "s", "sample period")),
    "delay": schema(Field("delay", "s", "from a sample to its command taking effect")),
    "carried": schema(Field("carried", _WRENCH, "what carries the flotor")),
    "inertia": schema(Field("inertia", ("kg", "kg m²"), "what the actuators push at, for `taken`")),
    "load": schema(Field("load", _WRENCH, "what acts besides, its weight, for `taken`")),
    "before": schema(Field("before", _WRENCH, "what the actuators give until the first command takes effect")),
    "faces": _of("array", "planes of walls: axis, normal (1 where the axis is free above), edge [m, rad]")
    | {"items": {"type": "object"}},
    "name": _of("string", "what to call the run"),
    "axis": _of("string", "the axis that matters most"),
    "hand_recorded": _of("boolean", "whether `hand` is what the hand exerts; else it is estimated, or not known"),
    "hand_acts_on_flotor": _of("boolean", "whether it acts there, not on a hand in a soft grip"),
}
_EVENT_FIELDS = {
    "segment": _NUMBER,
    "tick": schema(FIELDS[0]),
    "kind": _of("string", "fault, missed, lost, timing or landing"),
    "text": _of("string", "what happened"),
    "missed": schema(Field("missed", "", "samples that were missed with it, besides gaps in the ticks")),
}


def _schema(name: str, fields: Mapping[str, Any], says: str) -> dict[str, Any]:
    about = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": f"maglev_mj.{name}"}
    return {**about, "description": says, "type": "object", "properties": dict(fields), "required": list(fields)}


class Messages:
    """Logger of a run's messages.

    Args:
        context: Destination; all files attached to it get every message.
        model: Model of the drawn device, as of `maglev_mj.plants.model.load_model`.

    Raises:
        ModelError: If the model cannot be used.
    """

    def __init__(self, context: Context, *, model: str = "maglev") -> None:
        begins = "a controller and a plant begin; axes are those of the stator"
        happens = "something that a person should know of"
        self._segment_channel = Channel(SEGMENT, schema=_schema("Segment", _SEGMENT_FIELDS, begins), context=context)
        self._event_channel = Channel(EVENT, schema=_schema("Event", _EVENT_FIELDS, happens), context=context)
        sample = Schema(name=NAME, encoding="protobuf", data=descriptor())
        self._sample = Channel(SAMPLE, message_encoding="protobuf", schema=sample, context=context).base
        self._frames = FrameTransformsChannel(FRAMES, context=context)
        # a viewer that seeks shows the last message of each topic: what stands still must not share one with arrows
        self._shapes = SceneUpdateChannel(SHAPES, context=context)
        self._arrows = SceneUpdateChannel(ARROWS, context=context)
        self._log = LogChannel(LOG, context=context)
        self._device = _device(shapes(model))
        self._segment, self._tick = -1, 0
        self._began = self._now = 0
        self._first: float | None = None
        self._shown = -1
        self._stick: Sequence[float] | None = None
        self._totals: Totals | None = None

    def begin(self, setup: Setup, began_ns: int) -> None:
        """Begin a segment.

        Args:
            setup: Setup of plant and controller, with the metadata as `run`.
            began_ns: Time of the beginning since 1970 [ns].
        """
        self._segment += 1
        self._first, self._shown = None, -1
        # a run that is faster than real time must not lie over the next
        self._began = self._now = max(began_ns, self._now + 1)
        run = setup["run"]
        metadata = RunMetadata.from_json(run)
        self._totals = Totals(metadata)
        plates = [plate for plate in map(wall_plate, metadata.faces) if plate]
        walls = [Shape(False, "box", half, place, _UPRIGHT, _WALL) for place, half in plates]
        self._stick = None
        whole = {name: part for name, part in setup.items() if name != "run"}
        self._send(self._segment_channel, {"segment": self._segment, "setup": whole, **run})
        self._draw(self._shapes, [*self._device, ("stator", "walls", _primitives(walls))])
        self._tell(messages.LogLevel.Info, f"segment {self._segment + 1}: {metadata.name or setup.get('kind', '')}")

    def stick(self, position: Sequence[float] | None) -> None:
        """Set the stick position [m, rad], six.

        NaN for sliding axes; None without friction.
        """
        self._stick = position

    def rows(self, rows: Rows) -> None:
        """Log samples, a structured array (N,)."""
        assert self._totals is not None
        for values, message in zip(rows, packed(self._segment, rows, self._totals.take(rows))):
            time, self._tick = float(values["time"]), int(values["tick"])
            self._first = time if self._first is None else self._first
            self._now = max(self._now, self._began + round((time - self._first) * 1e9))
            self._sample.log(message, self._now)
            turn = math.floor((time - self._first) * _SHOWN + 1e-6)
            if turn > self._shown:
                self._shown = turn
                self._show(values)

    def event(self, kind: str, text: str, missed: int = 0) -> None:
        """Log an event.

        Args:
            kind: Kind of event.
            text: Text for the user.
            missed: Samples missed with it.
        """
        if self._totals is not None:
            self._totals.miss(missed)
        message = {"segment": self._segment, "tick": self._tick, "kind": kind, "text": text, "missed": missed}
        self._send(self._event_channel, message)
        self._tell(_LEVELS.get(kind, messages.LogLevel.Info), f"{kind}: {text}")

    def _send(self, channel: Channel, message: Mapping[str, Any]) -> None:
        channel.log(json.dumps(message, allow_nan=False, separators=(",", ":")).encode(), log_time=self._now)

    def _tell(self, level: messages.LogLevel, text: str) -> None:
        log = messages.Log(timestamp=_stamp(self._now), level=level, message=text, name="maglev_mj")
        self._log.log(log, log_time=self._now)

    def _show(self, values: np.void) -> None:
        """Log the frames, and the forces as arrows."""
        position, stamp = values["position"], _stamp(self._now)
        frames = [("stator", "flotor", position[:3], quaternion(position[3:])), ("flotor", "hand", GRIP, _UPRIGHT)]
        if self._stick is not None:
            stuck = [seen if math.isnan(held) else held for held, seen in zip(self._stick, position)]
            frames.append(("stator", "stick position", stuck[:3], quaternion(stuck[3:])))
        transforms = [
            messages.FrameTransform(
                timestamp=stamp,
                parent_frame_id=parent,
                child_frame_id=child,
                translation=_vector(place),
                rotation=_quaternion(turn),
            )
            for parent, child, place, turn in frames
        ]
        self._frames.log(messages.FrameTransforms(transforms=transforms), log_time=self._now)
        knob = np.array(position[:3]) + rotation_matrix(np.array(position[3:])) @ GRIP
        forces = ("force of the hand", values["hand"], _HAND), ("force of the device", values["applied"], _DEVICE)
        arrows = [("stator", name, {"arrows": _arrow(knob, force[:3], colour)}) for name, force, colour in forces]
        self._draw(self._arrows, arrows)

    def _draw(self, channel: SceneUpdateChannel, entities: Sequence[tuple[str, str, Mapping[str, Any]]]) -> None:
        """Log drawn entities: frame, name and shapes of each.

        An entity replaces the former one of its name.
        """
        stamp, endless = _stamp(self._now), messages.Duration(sec=0)
        drawn = [
            messages.SceneEntity(
                timestamp=stamp,
                frame_id=frame,
                id=name,
                lifetime=endless,
                frame_locked=True,
                **primitives,
            )
            for frame, name, primitives in entities
        ]
        channel.log(messages.SceneUpdate(entities=drawn), log_time=self._now)


def _stamp(now: int) -> messages.Timestamp:
    return messages.Timestamp(sec=now // 10**9, nsec=now % 10**9)


def _vector(values: Iterable[float]) -> messages.Vector3:
    x, y, z = values
    return messages.Vector3(x=float(x), y=float(y), z=float(z))


def _quaternion(values: Sequence[float]) -> messages.Quaternion:
    w, x, y, z = values
    return messages.Quaternion(w=w, x=x, y=y, z=z)


def _color(colour: Sequence[float]) -> messages.Color:
    red, green, blue, opacity = colour
    return messages.Color(r=red, g=green, b=blue, a=opacity)


def _device(parts: Sequence[Shape]) -> list[tuple[str, str, Mapping[str, Any]]]:
    """Return the entities of the device: stator and flotor."""
    return [
        (frame, frame, _primitives([shape for shape in parts if shape.moves == moves]))
        for frame, moves in (("stator", False), ("flotor", True))
    ]


def _primitives(parts: Sequence[Shape]) -> dict[str, Any]:
    """Return shapes as the primitives of an entity."""
    primitives: dict[str, Any] = {"cubes": [], "cylinders": [], "spheres": []}
    for shape in parts:
        pose = messages.Pose(position=_vector(shape.position), orientation=_quaternion(shape.turn))
        about: dict[str, Any] = {"pose": pose, "size": _vector(2.0 * shape.half), "color": _color(shape.colour)}
        if shape.kind == "box":
            primitives["cubes"].append(messages.CubePrimitive(**about))
        elif shape.kind == "cylinder":
            primitives["cylinders"].append(messages.CylinderPrimitive(bottom_scale=1.0, top_scale=1.0, **about))
        else:
            primitives["spheres"].append(messages.SpherePrimitive(**about))
    return primitives


def _arrow(knob: Array, force: Sequence[float], colour: Sequence[float]) -> list[messages.ArrowPrimitive]:
    """Return a force arrow; none if too small or NaN."""
    size = math.hypot(*force)
    if not LEAST_FORCE <= size < math.inf:
        return []
    # an arrow points along x: half a turn about the middle of x and the force brings it there
    x, y, z = force[0] / size + 1.0, force[1] / size, force[2] / size
    length = math.hypot(x, y, z)
    x, y, z = (x / length, y / length, z / length) if length > 1e-9 else (0.0, 0.0, 1.0)
    place = arrow_start(knob, np.array(force))
    return [
        messages.ArrowPrimitive(
            pose=messages.Pose(position=_vector(place), orientation=messages.Quaternion(w=0.0, x=x, y=y, z=z)),
            shaft_length=ARROW * size * (1.0 - _HEAD_LENGTH),
            shaft_diameter=_SHAFT,
            head_length=ARROW * size * _HEAD_LENGTH,
            head_diameter=_HEAD,
            color=_color(colour),
        )
    ]
