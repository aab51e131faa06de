"""Replay of recordings with bitwise comparison of every field."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.control.controller import Controller
from maglev_mj.errors import MaglevError, ParameterError, check_instance
from maglev_mj.frames import ZERO, Array, Command, Mask, Sample
from maglev_mj.parameters import whole
from maglev_mj.plants import SampledPlant, engine_warnings_silenced
from maglev_mj.plants.hand import HandForce, RecordedHand
from maglev_mj.recording.recording import READ, Recording, Segment
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
"""Function that rebuilds plant and controller.

None in place of a plant that cannot be made, such as a device.
"""

_Field: TypeAlias = tuple[str, Array, Array | None]


class FieldVerdict(NamedTuple):
    """Comparison of one recorded field with its replay.

    Attributes:
        same: Number of bitwise equal values, one per sample or one per segment.
        compared: Number of compared values; 0 for a field that is not replayed.
        first: Segment and tick of the first difference; None without differences.
    """

    same: int
    compared: int
    first: tuple[int, int] | None


class Verdict(NamedTuple):
    """Result of a replay.

    Attributes:
        ticks: Number of samples.
        fields: Comparison of each recorded field by name.
        damage: Description of damage to the file; empty for none.
    """

    ticks: int
    fields: Mapping[str, FieldVerdict]
    damage: str

    @property
    def same(self) -> bool:
        """True if the file is complete and all fields equal."""
        return not self.damage and self.first is None

    @property
    def first(self) -> tuple[int, int] | None:
        """Segment and tick of the first difference, or None."""
        return min((field.first for field in self.fields.values() if field.first is not None), default=None)

    def __str__(self) -> str:
        """Return lines for a terminal: equal fields share one, each different one has its own."""
        same: dict[int, list[str]] = {}
        remarks = []
        for name, field in self.fields.items():
            if field.first is None:
                same.setdefault(field.compared, []).append(name)
            else:
                segment, tick = field.first
                where = f"{name}, which first differs at tick {tick} of segment {segment + 1}"
                remarks.append(f"{field.same} of {field.compared} the same: {where}")
        copied = same.pop(0, [])
        remarks = [*(f"{count} of {count} the same: {', '.join(names)}" for count, names in same.items()), *remarks]
        if copied:
            remarks.append(f"not run again, for only the recording knows them: {', '.join(copied)}")
        lines = [line for remark in remarks for line in wrapped(remark, further="    ")]
        return "\n".join([f"  {self.ticks} samples, run again and compared to the last bit", *lines])


def verify(recording: Recording, rebuild: Rebuild) -> Verdict:
    """Replay a recording and compare every field bitwise.

    A new controller gets the recorded samples, and a new plant the recorded hand.

    Args:
        recording: The recording.
        rebuild: Makes plant and controller from a setup and a hand.

    Raises:
        ParameterError: If a setup cannot be rebuilt.

    Example:
        >>> from maglev_mj import find_scene, rebuild, record_run, verify
        >>> verdict = verify(record_run(find_scene("drop")(duration=0.1), plant="exact"), rebuild)
        >>> verdict.same
        True
    """
    check_instance("recording", recording, Recording, READ)
    verdicts: dict[str, FieldVerdict] = {}
    for place, segment in enumerate(recording.segments):
        for name, values, again in _fields(segment, rebuild):
            same = np.ones(0, np.bool_) if again is None else _same(values, again)
            verdicts[name] = _added(verdicts.get(name, FieldVerdict(0, 0, None)), same, place, segment.tick)
    return Verdict(recording.ticks, verdicts, recording.damage)


def first_other_answer(recording: Recording, rebuild: Rebuild, most: int) -> tuple[int, int, str] | None:
    """Return the first command that differs from a new controller's.

    Segment, tick and field; None if all are equal.

    Args:
        recording: The recording.
        rebuild: Makes plant and controller from a setup and a hand.
        most: Number of compared samples of each segment, from its first.

    Raises:
        ParameterError: If a setup cannot be rebuilt.
    """
    for place, segment in enumerate(recording.segments):
        part = segment[:most]
        run = part.whole
        answers = _answers(run, rebuild(run.setup, None)[1])[-len(part) :]
        same = {field.name: _same(part.arrays[field.name], answers[field.name]) for field in _COMMANDED}
        first = {name: int(np.argmin(one)) for name, one in same.items() if not one.all()}
        if first:
            name = min(first, key=lambda name: first[name])
            return place, int(part.tick[first[name]]), name
    return None


def _added(before: FieldVerdict, same: Mask, place: int, ticks: Array) -> FieldVerdict:
    """Return a verdict extended by another segment: a value per tick, one, or none."""
    good, compared, first = before
    if first is None and not same.all():
        first = place, int(ticks[np.argmin(same)])
    return FieldVerdict(good + int(same.sum()), compared + len(same), first)


def _same(recorded: Array, again: Array) -> Mask:
    """Return True for each row that is bitwise equal.

    A command that was not finite is NaN in a file format without infinity.
    """
    one, other = (np.ascontiguousarray(part, dtype=np.float64).reshape(len(recorded), -1) for part in (recorded, again))
    good = one.view(np.int64) == other.view(np.int64)
    good |= np.isnan(one) & ~np.isfinite(other)
    return np.asarray(good.all(axis=1))


def _fields(segment: Segment, rebuild: Rebuild) -> Iterator[_Field]:
    """Yield name, recorded and replayed values of each field.

    None in place of values that are not replayed.
    """
    run = segment.whole
    _, controller = rebuild(run.setup, None)
    # after a rewind a recorded hand may act again
    has_hand = segment.before is None and scripted(run.setup)
    plant, other = rebuild(run.setup, None if has_hand else RecordedHand(run.known_hand))
    with refused(KeyError, TypeError, ParameterError):
        metadata = _metadata(segment, plant, controller, has_hand)
        samples = None if run.setup.get("samples") is None else float(whole("samples", run.setup["samples"]))
    seen, failed = (None, False) if plant is None else _seen(plant, other, len(run))
    if samples is not None:
        count = float(len(segment))
        yield "samples", np.array([count]), np.array([count if failed else samples])
    answers = _answers(run, controller)
    for field in (field for array in ARRAYS.values() for field in array):
        recorded = segment.arrays[field.name]
        if not is_recorded(field, recorded):
            continue
        again = answers if field in _COMMANDED else seen if field.name != "hand" or has_hand else None
        yield field.name, recorded, None if again is None else again[field.name][-len(recorded) :]
    yield from metadata


def _metadata(segment: Segment, plant: SampledPlant | None, controller: Controller, has_hand: bool) -> list[_Field]:
    """Return the metadata fields, one row each, names excluded."""
    recorded, setup = segment.metadata, segment.whole.setup
    values: dict[str, Any] = {name: getattr(controller, name) for name in ("period", "carried", "faces")}
    names = "period", "delay", "carried", "inertia", "load", "before", "faces", "hand_recorded", "hand_acts_on_flotor"
    if plant is not None:
        metadata = RunMetadata.of(plant, controller)
        values |= {name: getattr(metadata, name) for name in names if name not in (*values, "hand_recorded")}
        values["hand_recorded"] = plant.held if has_hand else True if isinstance(setup.get("plant"), dict) else None
    if setup["kind"] == "device":  # inertia and previous wrench are recorded with the flight, not in the setup
        values |= {"delay": setup["parameters"]["delay"], "hand_recorded": False, "hand_acts_on_flotor": True}
    if segment.before is not None:
        values["before"] = segment.before.applied[-1]
    return [(name, *_rows(getattr(recorded, name), values.get(name))) for name in names]


def _rows(recorded: ArrayLike, again: ArrayLike | None) -> tuple[Array, Array | None]:
    """Return two values as one row each, size first."""
    one, other = _row(recorded), None if again is None else _row(again)
    return one, np.full_like(one, np.nan) if other is not None and other.size != one.size else other


def _row(value: ArrayLike) -> Array:
    return np.array([np.size(value), *np.ravel(value)], dtype=np.float64)[None]


def _answers(segment: Segment, controller: Controller) -> Rows:
    """Return a new controller's commands for the recorded samples.

    The array is (N,), with the fields of a command.
    """
    samples = zip(segment.tick.tolist(), segment.time.tolist(), segment.position.tolist(), strict=True)
    commands = [controller.step(Sample(int(tick), time, place)) for tick, time, place in samples]
    values = [(*one.force, *(one.extra or ZERO), one.pulse_width if one.extra else 0.0) for one in commands]
    return as_rows(values, _COMMANDED)


_COMMANDED = [field for field in FIELDS if field.array == "command"]


def _seen(plant: SampledPlant, controller: Controller, count: int) -> tuple[Rows, bool]:
    """Return a plant's samples, (count,), and its failure.

    Rows after a failure are NaN.
    """
    seen = as_rows(np.full((count, ROW.itemsize // 8), np.nan))
    with plant, engine_warnings_silenced():
        try:
            for row in as_table(seen):
                sample = plant.read()
                command, applied = controller.step(sample), Command(ZERO)
                try:
                    applied = plant.write(command)
                finally:  # of one that is refused, nothing is applied
                    row[:] = row_of(sample, command, applied, plant)
            plant.write(controller.step(plant.read()))
        except ParameterError:
            raise
        except MaglevError:  # the recorded run ended there too, or the comparison will say that it did not
            return seen, True
    return seen, False
