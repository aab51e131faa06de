"""Replay of recordings with a bitwise comparison of every field."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.control.controller import Controller
from maglev_mj.errors import MaglevError, ParameterError, check_instance
from maglev_mj.frames import ZERO, Array, Command, Mask, Sample
from maglev_mj.keywords import checked
from maglev_mj.parameters import whole
from maglev_mj.plants import SampledPlant, engine_warnings_silenced
from maglev_mj.plants.hand import HandForce, RecordedHand
from maglev_mj.recording.recording import RECORDING_TYPE, Recording, Segment
from maglev_mj.recording.sample import (
    ARRAYS,
    FIELDS,
    ROW,
    Rows,
    RunMetadata,
    Setup,
    as_rows,
    as_table,
    is_recorded,
    row_of,
)
from maglev_mj.recording.setup import refused, scripted
from maglev_mj.terminal import wrapped

Rebuild: TypeAlias = Callable[[Setup, HandForce | None], tuple[SampledPlant | None, Controller]]
"""Function that rebuilds plant and controller; the plant is None if it cannot be simulated, such as a device."""

_Field: TypeAlias = tuple[str, Array, Array | None]


class FieldVerdict(NamedTuple):
    """Comparison of one recorded field with its replay.

    Attributes:
        same: Number of bitwise equal values, counted per sample, or per segment for metadata.
        compared: Number of compared values; 0 for a field that is not replayed.
        first: Segment and tick of the first difference, or None.
    """

    same: int
    compared: int
    first: tuple[int, int] | None


class ReplayCheck(NamedTuple):
    """Result of a replay.

    Attributes:
        ticks: Number of samples.
        fields: Comparison of each recorded field by name.
        damage: Description of damage to the file; empty if intact.
    """

    ticks: int
    fields: Mapping[str, FieldVerdict]
    damage: str

    @property
    def same(self) -> bool:
        """True if the file is complete and all fields are equal."""
        return not self.damage and self.first is None

    @property
    def first(self) -> tuple[int, int] | None:
        """Segment and tick of the first difference, or None."""
        return min((field.first for field in self.fields.values() if field.first is not None), default=None)

    def __str__(self) -> str:
        """Return the report: the verdict, one line for the equal fields, one for each field that differs."""
        same: dict[int, list[str]] = {}
        remarks = []
        for name, field in self.fields.items():
            if field.first is None:
                same.setdefault(field.compared, []).append(name)
            else:
                segment, tick = field.first
                start = f"first difference at tick {tick} of segment {segment + 1}"
                remarks.append(f"{field.same} of {field.compared} equal: {name}; {start}")
        inputs = same.pop(0, [])
        remarks = [*(f"{count} of {count} equal: {', '.join(names)}" for count, names in same.items()), *remarks]
        if inputs:
            remarks.append(f"recorded only, not replayed: {', '.join(inputs)}")
        lines = [line for remark in remarks for line in wrapped(remark, further="    ")]
        verdict = f"Replay of {self.ticks} samples: {'bit-identical' if self.first is None else 'not bit-identical'}"
        return "\n".join([verdict, *lines])


@checked(own="recording")
def verify(recording: Recording, rebuild: Rebuild) -> ReplayCheck:
    """Replay a recording and compare every field bitwise.

    The recorded samples drive a new controller; the recorded hand drives a new plant and controller.

    Args:
        recording: The recording.
        rebuild: Function that makes plant and controller from a setup and a hand.

    Raises:
        ParameterError: If a setup cannot be rebuilt.

    Example:
        >>> from maglev_mj import find_scene, rebuild, record_run, verify
        >>> verdict = verify(record_run(find_scene("drop")(duration=0.1), plant="exact"), rebuild)
        >>> verdict.same
        True
    """
    check_instance("recording", recording, Recording, RECORDING_TYPE)
    verdicts: dict[str, FieldVerdict] = {}
    for index, segment in enumerate(recording.segments):
        for name, values, replayed in _fields(segment, rebuild):
            same = np.ones(0, np.bool_) if replayed is None else _same(values, replayed)
            verdicts[name] = _extended(verdicts.get(name, FieldVerdict(0, 0, None)), same, index, segment.tick)
    return ReplayCheck(recording.ticks, verdicts, recording.damage)


def first_different_command(recording: Recording, rebuild: Rebuild, most: int) -> tuple[int, int, str] | None:
    """Return segment, tick and field of the first command that a new controller computes differently, or None.

    Args:
        recording: The recording.
        rebuild: Function that makes plant and controller from a setup and a hand.
        most: Number of samples to compare at the start of each segment.

    Raises:
        ParameterError: If a setup cannot be rebuilt.
    """
    for index, segment in enumerate(recording.segments):
        part = segment[:most]
        run = part.whole
        answers = _answers(run, rebuild(run.setup, None)[1])[-len(part) :]
        same = {field.name: _same(part.arrays[field.name], answers[field.name]) for field in _COMMANDED}
        first = {name: int(np.argmin(equal)) for name, equal in same.items() if not equal.all()}
        if first:
            name = min(first, key=lambda name: first[name])
            return index, int(part.tick[first[name]]), name
    return None


def _extended(verdict: FieldVerdict, same: Mask, index: int, ticks: Array) -> FieldVerdict:
    """Return a verdict extended by one segment: one flag per tick, one in total, or none."""
    count, compared, first = verdict
    if first is None and not same.all():
        first = index, int(ticks[np.argmin(same)])
    return FieldVerdict(count + int(same.sum()), compared + len(same), first)


def _same(recorded: Array, replayed: Array) -> Mask:
    """Return True for each bitwise equal row; a recorded NaN equals any value that is not finite."""
    old, new = (
        np.ascontiguousarray(part, dtype=np.float64).reshape(len(recorded), -1) for part in (recorded, replayed)
    )
    equal = old.view(np.int64) == new.view(np.int64)
    equal |= np.isnan(old) & ~np.isfinite(new)
    return np.asarray(equal.all(axis=1))


def _fields(segment: Segment, rebuild: Rebuild) -> Iterator[_Field]:
    """Yield name, recorded values and replayed values of each field; None if it is not replayed."""
    run = segment.whole
    _, controller = rebuild(run.setup, None)
    # after a rewind the recorded hand may have acted, not the scripted one
    has_hand = segment.before is None and scripted(run.setup)
    plant, other = rebuild(run.setup, None if has_hand else RecordedHand(run.recorded_hand_wrench))
    with refused(KeyError, TypeError, ParameterError):
        metadata = _metadata(segment, plant, controller, has_hand)
        samples = None if run.setup.get("samples") is None else float(whole("samples", run.setup["samples"]))
    measured, failed = (None, False) if plant is None else _plant_rows(plant, other, len(run))
    if samples is not None:
        count = float(len(segment))
        yield "samples", np.array([count]), np.array([count if failed else samples])
    answers = _answers(run, controller)
    for field in (field for array in ARRAYS.values() for field in array):
        recorded = segment.arrays[field.name]
        if not is_recorded(field, recorded):
            continue
        rows = answers if field in _COMMANDED else measured if field.name != "hand" or has_hand else None
        yield field.name, recorded, None if rows is None else rows[field.name][-len(recorded) :]
    yield from metadata


def _metadata(segment: Segment, plant: SampledPlant | None, controller: Controller, has_hand: bool) -> list[_Field]:
    """Return the metadata fields except `name` and `axis`, one row each."""
    recorded, setup = segment.metadata, segment.whole.setup
    values: dict[str, Any] = {name: getattr(controller, name) for name in ("period", "carried", "faces")}
    names = "period", "delay", "carried", "inertia", "load", "before", "faces", "hand_recorded", "hand_acts_on_flotor"
    if plant is not None:
        metadata = RunMetadata.of(plant, controller)
        values |= {name: getattr(metadata, name) for name in names if name not in (*values, "hand_recorded")}
        values["hand_recorded"] = plant.held if has_hand else True if isinstance(setup.get("plant"), dict) else None
    if setup["kind"] == "device":  # the setup of a flight lacks inertia and previous wrench
        values |= {"delay": setup["parameters"]["delay"], "hand_recorded": False, "hand_acts_on_flotor": True}
    if segment.before is not None:
        values["before"] = segment.before.applied[-1]
    return [(name, *_rows(getattr(recorded, name), values.get(name))) for name in names]


def _rows(recorded: ArrayLike, replayed: ArrayLike | None) -> tuple[Array, Array | None]:
    """Return two values as one row each, size first."""
    old, new = _row(recorded), None if replayed is None else _row(replayed)
    return old, np.full_like(old, np.nan) if new is not None and new.size != old.size else new


def _row(value: ArrayLike) -> Array:
    return np.array([np.size(value), *np.ravel(value)], dtype=np.float64)[None]


def _answers(segment: Segment, controller: Controller) -> Rows:
    """Return a new controller's commands for the recorded samples, (N,)."""
    samples = zip(segment.tick.tolist(), segment.time.tolist(), segment.position.tolist(), strict=True)
    commands = [controller.step(Sample(int(tick), time, pose)) for tick, time, pose in samples]
    values = [(*item.force, *(item.extra or ZERO), item.pulse_width if item.extra else 0.0) for item in commands]
    return as_rows(values, _COMMANDED)


_COMMANDED = [field for field in FIELDS if field.array == "command"]


def _plant_rows(plant: SampledPlant, controller: Controller, count: int) -> tuple[Rows, bool]:
    """Return a plant's samples, (count,), NaN after a failure; and True if it failed."""
    rows = as_rows(np.full((count, ROW.itemsize // 8), np.nan))
    with plant, engine_warnings_silenced():
        try:
            for row in as_table(rows):
                sample = plant.read()
                command, applied = controller.step(sample), Command(ZERO)
                try:
                    applied = plant.write(command)
                finally:  # a rejected command applies nothing
                    row[:] = row_of(sample, command, applied, plant)
            plant.write(controller.step(plant.read()))
        except ParameterError:
            raise
        except MaglevError:  # the recorded run failed here too; if not, the comparison reports it
            return rows, True
    return rows, False
