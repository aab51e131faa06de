"""Messages of a run for other programs: samples, frames, drawings, events.

They are logged to a foxglove-sdk context and written to the files attached to it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from foxglove import Channel, Context, Schema, messages
from foxglove.channels import FrameTransformsChannel, LogChannel, SceneUpdateChannel

from maglev_mj.colours import DEVICE, HAND, WALL
from maglev_mj.device import PUBLISHED, Device, Knob
from maglev_mj.frames import Array, quaternion, rotation_matrix
from maglev_mj.plants.shapes import ARROW, MIN_ARROW_FORCE, Shape, arrow_start, shapes, wall_box
from maglev_mj.recording.mcap import EVENT, NAME, SAMPLE, SEGMENT, SEGMENT_NUMBER, descriptor, packed
from maglev_mj.recording.sample import FIELDS, Field, Rows, RunMetadata, Setup, Totals, schema

FRAMES, SHAPES, ARROWS, LOG = "/tf", "/maglev/shapes", "/maglev/arrows", "/log"

_FRAME_RATE = 60.0  # poses per second for 3D views [Hz]
_WALL_OPACITY = 0.16
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
        "object", "construction of plant and controller: kind, scene, parameters, controller, plant, versions"
    ),
    "period": schema(Field("period", "s", "sample period")),
    "delay": schema(Field("delay", "s", "delay from a sample to its command's effect")),
    "carried": schema(Field("carried", _WRENCH, "wrench of the weight compensation")),
    "inertia": schema(Field("inertia", ("kg", "kg m²"), "moving mass and moments of inertia, used for `taken`")),
    "load": schema(Field("load", _WRENCH, "constant external wrench, such as the weight, used for `taken`")),
    "before": schema(Field("before", _WRENCH, "actuator wrench before the first command takes effect")),
    "faces": _of("array", "planes of walls: axis, normal (1 if the wall is below the edge), edge [m, rad]")
    | {"items": {"type": "object"}},
    "name": _of("string", "name of the run"),
    "axis": _of("string", "main axis"),
    "hand_recorded": _of("boolean", "true if `hand` is the hand's actual wrench; false if estimated or unknown"),
    "hand_acts_on_flotor": _of("boolean", "true if the hand acts on the flotor directly; false for a soft grip"),
}
_EVENT_FIELDS = {
    "segment": _NUMBER,
    "tick": schema(FIELDS[0]),
    "kind": _of("string", "fault, missed, lost, timing or landing"),
    "text": _of("string", "description of the event"),
    "missed": schema(Field("missed", "", "missed samples that leave no gap in the tick numbers")),
}


def _schema(name: str, fields: Mapping[str, Any], description: str) -> dict[str, Any]:
    about = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": f"maglev_mj.{name}"}
    return {**about, "description": description, "type": "object", "properties": dict(fields), "required": list(fields)}


class Messages:
    """Logger of a run's messages.

    Args:
        context: Destination of the messages.
    """

    def __init__(self, context: Context) -> None:
        segment = "start of a segment with its plant and controller; stator axes"
        event = "event for the user"
        self._segment_channel = Channel(SEGMENT, schema=_schema("Segment", _SEGMENT_FIELDS, segment), context=context)
        self._event_channel = Channel(EVENT, schema=_schema("Event", _EVENT_FIELDS, event), context=context)
        sample = Schema(name=NAME, encoding="protobuf", data=descriptor())
        self._sample = Channel(SAMPLE, message_encoding="protobuf", schema=sample, context=context).base
        self._frames = FrameTransformsChannel(FRAMES, context=context)
        # seeking shows the last message of each topic, so static shapes need a topic of their own
        self._shapes = SceneUpdateChannel(SHAPES, context=context)
        self._arrows = SceneUpdateChannel(ARROWS, context=context)
        self._log = LogChannel(LOG, context=context)
        self._knob = Knob()
        self._segment, self._tick = -1, 0
        self._start = self._now = 0
        self._first: float | None = None
        self._frame = -1
        self._stick: Sequence[float] | None = None
        self._totals: Totals | None = None

    def begin(self, setup: Setup, began_ns: int) -> None:
        """Start a segment.

        Args:
            setup: Setup of plant and controller, with the metadata as `run`.
            began_ns: Start time since 1970 [ns].

        Raises:
            ParameterError: If the device of the setup is not valid.
        """
        self._segment += 1
        self._first, self._frame = None, -1
        # segments faster than real time must not overlap
        self._start = self._now = max(began_ns, self._now + 1)
        run = setup["run"]
        metadata = RunMetadata.from_json(run)
        self._totals = Totals(metadata)
        device = device_of(setup)
        self._knob = device.knob
        plates = wall_box(metadata.faces, device.knob)[0].values()
        walls = [Shape(False, "box", half, centre, _UPRIGHT, (*WALL, _WALL_OPACITY)) for centre, half in plates]
        self._stick = None
        construction = {name: part for name, part in setup.items() if name != "run"}
        self._send(self._segment_channel, {"segment": self._segment, "setup": construction, **run})
        self._draw(self._shapes, [*_entities(device), ("stator", "walls", _primitives(walls))])
        self._log_text(messages.LogLevel.Info, f"segment {self._segment + 1}: {metadata.name or setup.get('kind', '')}")

    def stick(self, position: Sequence[float] | None) -> None:
        """Set the stick position [m, rad], six components: NaN for sliding axes; None without friction."""
        self._stick = position

    def rows(self, rows: Rows) -> None:
        """Log samples, a structured array (N,)."""
        assert self._totals is not None
        for values, message in zip(rows, packed(self._segment, rows, self._totals.take(rows))):
            time, self._tick = float(values["time"]), int(values["tick"])
            self._first = time if self._first is None else self._first
            self._now = max(self._now, self._start + round((time - self._first) * 1e9))
            self._sample.log(message, self._now)
            frame = math.floor((time - self._first) * _FRAME_RATE + 1e-6)
            if frame > self._frame:
                self._frame = frame
                self._log_frame(values)

    def event(self, kind: str, text: str, missed: int = 0) -> None:
        """Log an event.

        Args:
            kind: Kind of event.
            text: Text for the user.
            missed: Missed samples that leave no gap in the tick numbers.
        """
        if self._totals is not None:
            self._totals.miss(missed)
        message = {"segment": self._segment, "tick": self._tick, "kind": kind, "text": text, "missed": missed}
        self._send(self._event_channel, message)
        self._log_text(_LEVELS.get(kind, messages.LogLevel.Info), f"{kind}: {text}")

    def _send(self, channel: Channel, message: Mapping[str, Any]) -> None:
        channel.log(json.dumps(message, allow_nan=False, separators=(",", ":")).encode(), log_time=self._now)

    def _log_text(self, level: messages.LogLevel, text: str) -> None:
        log = messages.Log(timestamp=_stamp(self._now), level=level, message=text, name="maglev_mj")
        self._log.log(log, log_time=self._now)

    def _log_frame(self, values: np.void) -> None:
        """Log the coordinate frames, and the forces as arrows."""
        position, stamp = values["position"], _stamp(self._now)
        frames = [
            ("stator", "flotor", position[:3], quaternion(position[3:])),
            ("flotor", "hand", self._knob.centre, _UPRIGHT),
        ]
        if self._stick is not None:
            stuck = [free if math.isnan(held) else held for held, free in zip(self._stick, position)]
            frames.append(("stator", "stick position", stuck[:3], quaternion(stuck[3:])))
        transforms = [
            messages.FrameTransform(
                timestamp=stamp,
                parent_frame_id=parent,
                child_frame_id=child,
                translation=_vector(offset),
                rotation=_quaternion(rotation),
            )
            for parent, child, offset, rotation in frames
        ]
        self._frames.log(messages.FrameTransforms(transforms=transforms), log_time=self._now)
        knob = self._knob
        place = np.array(position[:3]) + rotation_matrix(np.array(position[3:])) @ knob.centre
        forces = ("force of the hand", values["hand"], HAND), ("force of the device", values["applied"], DEVICE)
        arrows = [
            ("stator", name, {"arrows": _arrow(place, force[:3], colour, knob)}) for name, force, colour in forces
        ]
        self._draw(self._arrows, arrows)

    def _draw(self, channel: SceneUpdateChannel, entities: Sequence[tuple[str, str, Mapping[str, Any]]]) -> None:
        """Log entities: frame, name and shapes of each; one replaces the previous one of its name."""
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
    red, green, blue, opacity = (*colour, 1.0)[:4]
    return messages.Color(r=red, g=green, b=blue, a=opacity)


def device_of(setup: Setup) -> Device:
    """Return the device of a segment; the published joystick if the segment does not state one."""
    model = setup.get("plant", {}).get("model")
    stated = model.get("device") if isinstance(model, dict) else None
    return Device.load(setup.get("parameters", {}).get("device") or stated or PUBLISHED)


@lru_cache(maxsize=8)
def _entities(device: Device) -> list[tuple[str, str, Mapping[str, Any]]]:
    """Return the entities stator and flotor of a device."""
    parts = shapes("maglev", device)
    return [
        (frame, frame, _primitives([shape for shape in parts if shape.moves == moves]))
        for frame, moves in (("stator", False), ("flotor", True))
    ]


def _primitives(parts: Sequence[Shape]) -> dict[str, Any]:
    """Return the primitives of an entity."""
    primitives: dict[str, Any] = {"cubes": [], "cylinders": [], "spheres": []}
    for shape in parts:
        pose = messages.Pose(position=_vector(shape.position), orientation=_quaternion(shape.turn))
        common: dict[str, Any] = {"pose": pose, "size": _vector(2.0 * shape.half), "color": _color(shape.colour)}
        if shape.kind == "box":
            primitives["cubes"].append(messages.CubePrimitive(**common))
        elif shape.kind == "cylinder":
            primitives["cylinders"].append(messages.CylinderPrimitive(bottom_scale=1.0, top_scale=1.0, **common))
        else:
            primitives["spheres"].append(messages.SpherePrimitive(**common))
    return primitives


def _arrow(place: Array, force: Sequence[float], colour: Sequence[float], knob: Knob) -> list[messages.ArrowPrimitive]:
    """Return a force arrow; an empty list if it is too small or NaN."""
    size = math.hypot(*force)
    if not MIN_ARROW_FORCE <= size < math.inf:
        return []
    # arrows point along x: rotate by half a turn about the bisector of x and the force
    x, y, z = force[0] / size + 1.0, force[1] / size, force[2] / size
    length = math.hypot(x, y, z)
    x, y, z = (x / length, y / length, z / length) if length > 1e-9 else (0.0, 0.0, 1.0)
    start = arrow_start(place, np.array(force), knob)
    return [
        messages.ArrowPrimitive(
            pose=messages.Pose(position=_vector(start), orientation=messages.Quaternion(w=0.0, x=x, y=y, z=z)),
            shaft_length=ARROW * size * (1.0 - _HEAD_LENGTH),
            shaft_diameter=_SHAFT,
            head_length=ARROW * size * _HEAD_LENGTH,
            head_diameter=_HEAD,
            color=_color(colour),
        )
    ]
