"""Recordings of runs: what went by at each sample, to be looked at, checked and run again bit for bit."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeAlias

import numpy as np

from maglev_mj.controller import Controller
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.frames import AXES, Array, Command, Sample
from maglev_mj.hand import HandForce, RecordedHand
from maglev_mj.plants import SampledPlant

__all__ = ["Recorder", "Recording", "RecordingError", "Setup", "Stretch", "Verdict", "verify"]

_FORMAT = "maglev_mj recording 1"
_COLUMNS = {"tick": 0, "time": 0, "position": 6, "command": 13, "applied": 13, "hand": 6}
"""Columns of each array of a stretch; 0 for one number a sample."""

Setup: TypeAlias = Mapping[str, Any]
"""What a plant and a controller are made from, ready for JSON."""

Rebuild: TypeAlias = Callable[[Setup, HandForce | None], tuple[SampledPlant | None, Controller]]
"""Makes plant and controller; None for a plant that cannot be made, such as a device."""


class Felt(Protocol):
    """What a recorder asks of a plant."""

    @property
    def hand_wrench(self) -> Sequence[Any]:
        """What the hand exerts since the last sample [N, N m], six."""


class RecordingError(MaglevError):
    """A file is no recording, or is not whole."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Stretch:
    """N samples under one controller.

    Attributes:
        setup: What plant and controller were made from.
        tick: Sample numbers, (N,).
        time: When they were taken since the start of the stretch [s], (N,).
        position: What the controller saw [m, rad], (N, 6).
        command: What it answered: held wrench and pulse [N, N m], pulse width [s], (N, 13).
        applied: The same after the plant's limits, (N, 13).
        hand: What the hand exerted from each sample on [N, N m], (N, 6).
    """

    setup: Setup
    tick: Array
    time: Array
    position: Array
    command: Array
    applied: Array
    hand: Array


class Recorder:
    """Stands between a control loop and a controller, and keeps what goes by.

    Args:
        plant: The plant that is driven.
        controller: The controller that drives it.
        setup: What both were made from.

    Attributes:
        period: The controller's sample period [s].
    """

    def __init__(self, plant: Felt, controller: Controller, setup: Setup) -> None:
        self.period = controller.period
        self._plant, self._answer, self._setup = plant, controller.step, dict(setup)
        self._rows: list[tuple[Any, ...]] = []
        self._applied: list[list[float]] = []

    def step(self, sample: Sample) -> Command:
        """Answer one sample as the controller does."""
        command = self._answer(sample)
        self._rows.append((sample.tick, sample.time, sample.position, row_of(command), self._plant.hand_wrench))
        return command

    def observe(self, sample: Sample, applied: Command) -> None:
        """Keep a command as applied."""
        self._applied.append(row_of(applied))

    def stretch(self) -> Stretch:
        """Return what was kept so far; an answer that the plant refused is kept as applied zero."""
        missing = len(self._rows) - len(self._applied)
        columns = list(zip(*self._rows)) if self._rows else [()] * 5
        tick, time, position, command, hand = columns
        applied = [*self._applied, *[[0.0] * 13] * missing]
        return Stretch(
            setup=self._setup,
            tick=np.array(tick, dtype=np.float64),
            time=np.array(time, dtype=np.float64),
            position=_table(position, 6),
            command=_table(command, 13),
            applied=_table(applied, 13),
            hand=_table(hand, 6),
        )


@dataclass(frozen=True, eq=False)
class Recording:
    """One run: stretches in the order in which they happened."""

    stretches: Sequence[Stretch]

    def save(self, path: Path | str) -> None:
        """Write to a file, whole or not at all.

        Raises:
            OSError: If it cannot be written.
        """
        arrays = {
            f"{index}/{name}": getattr(stretch, name)
            for index, stretch in enumerate(self.stretches)
            for name in _COLUMNS
        }
        header = {"format": _FORMAT, "axes": AXES, "setups": [dict(stretch.setup) for stretch in self.stretches]}
        path = Path(path)
        partial = path.with_name(path.name + ".partial")
        with partial.open("wb") as file:
            np.savez(file, header=np.array(json.dumps(header)), **arrays)
        partial.replace(path)

    @classmethod
    def load(cls, path: Path) -> Recording:
        """Read from a file.

        Raises:
            RecordingError: If it is not there, or no whole recording.
        """
        try:
            with path.open("rb") as whole, np.load(whole, allow_pickle=False) as file:
                header = json.loads(str(file["header"]))
                if header["format"] != _FORMAT:
                    raise RecordingError(f"recording must be of {_FORMAT!r}, not {header['format']!r}")
                stretches = [
                    Stretch(setup=setup, **{name: _checked(file[f"{index}/{name}"], name) for name in _COLUMNS})
                    for index, setup in enumerate(header["setups"])
                ]
        except OSError as error:
            raise RecordingError(f"recording {str(path)!r} cannot be read: {error.strerror or error}") from None
        except (ValueError, KeyError, TypeError, AttributeError, EOFError, zipfile.BadZipFile):
            raise RecordingError(f"{str(path)!r} is not a whole recording") from None
        if any(len({len(getattr(stretch, name)) for name in _COLUMNS}) > 1 for stretch in stretches):
            raise RecordingError(f"{str(path)!r} is not a whole recording")
        return cls(stretches)

    @property
    def ticks(self) -> int:
        """Samples in all."""
        return sum(len(stretch.tick) for stretch in self.stretches)


class Verdict(NamedTuple):
    """What running a recording again gave.

    Attributes:
        ticks: Samples in it.
        commands: How many commands of the controller, given the recorded samples, were the same to the last bit.
        positions: How many samples of the plant, given the recorded hand, were; None for a device, which no hand that
            was recorded moves again.
        first: Stretch and tick of the first that was not; None where all were.
    """

    ticks: int
    commands: int
    positions: int | None
    first: tuple[int, int] | None

    @property
    def same(self) -> bool:
        """Whether nothing differs."""
        return self.commands == self.ticks and self.positions in (self.ticks, None)


def verify(recording: Recording, rebuild: Rebuild) -> Verdict:
    """Feed the recorded samples to a new controller, and the recorded hand to a new plant, and compare bit for bit.

    Args:
        recording: The recording.
        rebuild: Makes plant and controller from a setup and a hand.

    Raises:
        ParameterError: If a setup is not one that can be made.
    """
    commands = positions = 0
    moved = False
    first: tuple[int, int] | None = None
    for place, stretch in enumerate(recording.stretches):
        answered = _answers(stretch, rebuild)
        good = (answered == stretch.command).all(axis=1)
        commands += int(good.sum())
        seen = _positions(stretch, rebuild)
        if seen is not None:
            followed = (seen == stretch.position).all(axis=1)
            positions, moved = positions + int(followed.sum()), True
            good &= followed
        if first is None and not good.all():
            first = place, int(stretch.tick[np.argmin(good)])
    return Verdict(recording.ticks, commands, positions if moved else None, first)


def row_of(command: Command) -> list[float]:
    """Return a command as 13 numbers."""
    extra = command.extra
    return [*command.force, *(extra if extra is not None else (0.0,) * 6), command.pulse_width if extra else 0.0]


def _answers(stretch: Stretch, rebuild: Rebuild) -> Array:
    """Return what a new controller answers to the recorded samples, (N, 13)."""
    _, controller = rebuild(stretch.setup, None)
    samples = zip(stretch.tick.tolist(), stretch.time.tolist(), stretch.position.tolist(), strict=True)
    return _table([row_of(controller.step(Sample(int(tick), time, place))) for tick, time, place in samples], 13)


def _positions(stretch: Stretch, rebuild: Rebuild) -> Array | None:
    """Return what a new plant is seen to do in the recorded hand, (N, 6), NaN from where it stops; None without one."""
    plant, controller = rebuild(stretch.setup, RecordedHand(stretch.hand.reshape(-1, 6)))
    if plant is None:
        return None
    seen = np.full(stretch.position.shape, np.nan)
    try:
        for row in seen:
            sample = plant.read()
            row[:] = sample.position
            plant.write(controller.step(sample))
    except ParameterError:
        raise
    except MaglevError:
        pass  # the recorded run ended there too, or the comparison will say that it did not
    return seen


def _table(rows: Sequence[Any], columns: int) -> Array:
    return np.array(rows, dtype=np.float64).reshape(-1, columns)


def _checked(array: Any, name: str) -> Array:
    columns = _COLUMNS[name]
    if array.dtype != np.float64 or array.ndim != (2 if columns else 1) or (columns and array.shape[1] != columns):
        raise ValueError(name)
    if not np.isfinite(array).all():
        raise ValueError(name)
    return np.asarray(array)
