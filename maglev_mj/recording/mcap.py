"""Protobuf message of a sample in MCAP files: schema and packing."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

from maglev_mj.frames import AXES, Array
from maglev_mj.recording.sample import FIELDS, TOTALS, Field, Rows

SEGMENT, SAMPLE, EVENT = "/maglev/segment", "/maglev/sample", "/maglev/event"

NAME = "maglev_mj.Sample"
"""Full name of the message type."""

SEGMENT_NUMBER = Field("segment", "", "segment index, from 0")
"""Segment index, first field of a sample's message."""

_ORDERED = (
    SEGMENT_NUMBER,
    *(field for field in FIELDS if not field.optional),
    *(field for field in TOTALS if not field.optional),
    *(field for field in (*FIELDS, *TOTALS) if field.optional),
)
"""Fields in the order of their protobuf numbers, from 1; new ones are optional and come last."""

_TYPE = descriptor_pb2.FieldDescriptorProto


@cache
def _file() -> descriptor_pb2.FileDescriptorProto:
    """Return the descriptor of a sample, with descriptions and units as comments."""
    package, name = NAME.split(".")
    file = descriptor_pb2.FileDescriptorProto(name=f"{package}.proto", package=package, syntax="proto3")
    six, sample = file.message_type.add(name="SixAxes"), file.message_type.add(name=name)
    for number, axis in enumerate(AXES, 1):
        six.field.add(name=axis, number=number, label=_TYPE.LABEL_OPTIONAL, type=_TYPE.TYPE_DOUBLE)
    for number, field in enumerate(_ORDERED, 1):
        kind = _TYPE.TYPE_MESSAGE if field.six else _TYPE.TYPE_DOUBLE if field.unit else _TYPE.TYPE_FIXED64
        entry = sample.field.add(name=field.name, number=number, label=_TYPE.LABEL_OPTIONAL, type=kind)
        if field.six:
            entry.type_name = f".{package}.SixAxes"
        # path of a field in the second message
        file.source_code_info.location.add(
            path=[4, 1, 2, number - 1], span=[0, 0, 0], leading_comments=f" {field.text}\n"
        )
    return file


def descriptor() -> bytes:
    """Return the schema of a sample, a serialised FileDescriptorSet."""
    data: bytes = descriptor_pb2.FileDescriptorSet(file=[_file()]).SerializeToString()
    return data


@cache
def sample_type() -> Any:
    """Return the message class of a sample."""
    pool = descriptor_pool.DescriptorPool()
    pool.Add(_file())
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(NAME))


def packed(segment: int, rows: Rows, totals: Array) -> list[bytes]:
    """Return the serialised messages of N samples.

    Args:
        segment: Segment index.
        rows: Samples, (N,).
        totals: Running totals in the order of TOTALS, (N, 4).
    """
    kind = sample_type()
    columns: dict[str, Any] = {SEGMENT_NUMBER.name: [segment] * len(rows)}
    for field, values in [(field, rows[field.name]) for field in FIELDS] + list(zip(TOTALS, totals.T, strict=True)):
        if field.six:
            columns[field.name] = [dict(zip(AXES, six)) for six in values.tolist()]
        else:
            columns[field.name] = (values if field.unit else values.astype(np.uint64)).tolist()
    names = list(columns)
    return [kind(**dict(zip(names, values))).SerializeToString() for values in zip(*columns.values())]
