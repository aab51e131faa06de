"""Playback of a recording: play, seek, step, loop."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from itertools import islice
from typing import Any

import numpy as np

from maglev_mj.errors import ParameterError, not_one_of
from maglev_mj.frames import Array
from maglev_mj.parameters import number
from maglev_mj.plants.hand import SpringHand
from maglev_mj.plants.model import load_model
from maglev_mj.plants.trace import hand_work
from maglev_mj.recording import InvalidRecordingError, Recording, Stretch
from maglev_mj.session import SHOWN, TIME_SCALES, Snapshot, next_scale
from maglev_mj.session.replay import OwnCode, rebuild_for, shown_scene, stick_positions

ACTIONS = "pause", "step", "step back", "skip forward", "skip back", "slower", "faster", "loop", "start", "end"
"""Actions of `Replay.act`.

"skip forward" and "skip back" move by a twentieth of the recording.
"""

_SCALES = (*TIME_SCALES, 2.0, 5.0, 10.0)
_JUMP = 0.05
_ROUNDING = 1e-9
_STICKS = 100
"""Number of stick positions found in one `tick`.

It takes some ms.
"""


class Replay:
    """Recording shown in time; a `SnapshotSource`.

    All its stretches are on one time axis, one after the other. The time of opening and seeking does not grow with the
    number of samples: stick positions are found during playback, in each stretch from its first sample on.

    Args:
        recording: The recording, of at least one sample.
        own: User code allowed to run, for the stick positions; without it the recording is shown without them.

    Attributes:
        hand: A hand that moves nothing; the recorded one acts.
        simulated: Time shown so far [s].

    Raises:
        RecordingError: If it is empty, or its setup is not known here.
    """

    def __init__(self, recording: Recording, own: OwnCode | None = None) -> None:
        self.hand = SpringHand()
        self.simulated = 0.0
        self._stretches = [_Shown(stretch, own) for stretch in recording.stretches if len(stretch)]
        if not self._stretches:
            raise InvalidRecordingError("there is nothing in the recording")
        begins = np.cumsum([0.0, *(one.duration for one in self._stretches)])
        self._duration = float(begins[-1])
        self._times: Array = np.concatenate([begin + one.time for begin, one in zip(begins, self._stretches)])
        self._firsts = np.cumsum([0, *(len(one.time) for one in self._stretches)])
        last = len(self._times) - 1
        self._marks = [float(self._times[min(max(count - 1, 0), last)]) for count in recording.event_samples]
        self._events = list(recording.events)
        self._paused, self._loops, self._scale = False, True, 1.0
        self._time, self._row = 0.0, 0

    def tick(self, elapsed: float) -> int:
        """Advance by a real time.

        Args:
            elapsed: Real time since the last call [s].

        Returns:
            Number of samples passed.
        """
        self._now.find_sticking()
        if self._paused:
            return 0
        before, rounds = self._row, 0.0
        passed = elapsed * self._scale
        self.simulated += passed
        time = self._time + passed
        if time >= self._duration - _ROUNDING:
            rounds, time = divmod(time + _ROUNDING, self._duration) if self._loops else (0.0, self._duration)
            self._paused = not self._loops
        self._seek(time)
        return int(rounds) * len(self._times) + self._row - before

    def act(self, action: str) -> None:
        """Run one of `ACTIONS`.

        Raises:
            ParameterError: If there is no such action.
        """
        way = -1 if action.endswith("back") else 1
        if action == "pause":
            if self._paused and self._time >= self._duration:
                self._seek(0.0)
            self._paused = not self._paused
        elif action in ("step", "step back"):
            self._paused = True
            self._seek(float(self._times[min(max(self._row + way, 0), len(self._times) - 1)]))
        elif action in ("skip forward", "skip back"):
            time = self._time + way * _JUMP * self._duration
            self._seek(min(max(time, 0.0), float(self._times[-1])))
        elif action in ("slower", "faster"):
            self._scale = next_scale(self._scale, action, _SCALES)
        elif action == "loop":
            self._loops = not self._loops
        elif action == "start":
            self._seek(0.0)
        elif action == "end":
            self._paused = True
            self._seek(self._duration)
        else:
            raise ParameterError(not_one_of("action", ACTIONS, action))

    def change(self, parameters: Mapping[str, Any]) -> None:
        """Change the time or the playback speed.

        Args:
            parameters: `time` [s], from 0 to the recording's length, and `time_scale`, from 0.001 to 10.

        Raises:
            ParameterError: If there is another parameter or a value is out of range; nothing changes then.
        """
        given = dict(parameters)
        time = number("time", given.pop("time", self._time), at_least=0.0, at_most=self._duration)
        least, most = _SCALES[0], _SCALES[-1]
        scale = number("time_scale", given.pop("time_scale", self._scale), at_least=least, at_most=most)
        if given:
            raise ParameterError(f"parameters of a recording must be of time, time_scale, not {', '.join(given)}")
        self._scale = scale
        self._seek(time)

    def snapshot(self) -> Snapshot:
        """Return the present snapshot."""
        now, row = self._now, self._row - self._firsts[self._place]
        samples, time = now.stretch.arrays, float(self._times[self._row])
        since = SHOWN * max(self._scale, 1.0)
        passed = [event for event, mark in zip(self._events, self._marks) if 0.0 <= time - mark < since]
        return Snapshot(
            scene=now.scene,
            since=int(self._firsts[self._place]),
            delay=now.scene.delay,
            tick=self._row,
            time=time,
            pose=np.array(samples["position"][row]),
            force=samples["applied"][row] - now.carried,
            hand=np.array(samples["hand"][row]),
            currents=_current_per_wrench() @ samples["applied"][row],
            faces=now.faces,
            anchors=now.anchors(row),
            history=self._history(),
            work=float(now.work[row]),
            missed=int(samples["missed"][row]) if "missed" in samples else 0,
            taken=float(samples["taken"][row]) if "taken" in samples else float("nan"),
            time_scale=self._scale,
            duration=self._duration,
            marks=self._marks,
            actions=ACTIONS,
            state="paused" if self._paused else "running",
            notes=["REPLAY, in a loop" if self._loops else "REPLAY", *passed],
        )

    def close(self) -> None:
        """Do nothing: a recording needs no closing."""

    @property
    def _place(self) -> int:
        """Index of the stretch shown."""
        return int(np.searchsorted(self._firsts, self._row, side="right")) - 1

    @property
    def _now(self) -> _Shown:
        return self._stretches[self._place]

    def _seek(self, time: float) -> None:
        self._time, self._row = time, int(np.searchsorted(self._times, time + _ROUNDING, side="right")) - 1

    def _history(self) -> Array:
        """Return the samples of the last two seconds.

        Those of earlier stretches are included.
        """
        end, firsts = self._row + 1, self._firsts
        first = int(np.searchsorted(self._times, self._times[self._row] - SHOWN))
        rows = []
        for place in range(int(np.searchsorted(firsts, first, side="right")) - 1, self._place + 1):
            low, high = max(first, firsts[place]), min(end, firsts[place + 1])
            part = self._stretches[place].history(low - firsts[place], high - firsts[place])
            rows.append(np.column_stack([self._times[low:high], part]))
        return np.concatenate(rows)


class _Shown:
    """Stretch of a recording with its metadata."""

    def __init__(self, stretch: Stretch, own: OwnCode | None) -> None:
        self._again = rebuild_for(stretch, own)
        metadata = stretch.metadata
        self.stretch, self.scene = stretch, shown_scene(stretch.setup, metadata, own)
        self.time: Array = stretch.time - stretch.time[0]
        self.duration = float(self.time[-1]) + metadata.period
        self.carried, self.faces = metadata.carried, tuple(metadata.faces)
        if "hand_work" in stretch.arrays:
            self.work: Array = stretch.hand_work
        else:
            work = hand_work(stretch.position, stretch.hand).sum(axis=1)
            self.work = np.concatenate([[0.0], np.cumsum(work)])
        self._sticking = stick_positions(stretch, self._again)
        self._anchors: list[Array] = []

    def find_sticking(self) -> None:
        """Find the next stick positions."""
        self._anchors += islice(self._sticking, _STICKS)

    def anchors(self, row: int) -> Array | None:
        """Return the stick positions at a sample, or None.

        None without friction, or if they are not found yet.
        """
        return self._anchors[row] if row < len(self._anchors) else None

    def history(self, low: int, high: int) -> Array:
        """Return motion and forces of a range of samples.

        (N, 24): pose, speed, wrench of the device, wrench of the hand.
        """
        stretch, before = self.stretch, max(low - 1, 0)
        pose, time = stretch.position[before:high], self.time[before:high]
        speed = np.diff(pose, axis=0) / np.diff(time)[:, None]
        if low == 0:  # the first sample has no speed: it gets the next one's
            speed = np.concatenate([speed[:1] if len(speed) else np.zeros((1, 6)), speed])
        force = stretch.applied[low:high] - self.carried
        return np.column_stack([pose[low - before :], speed, force, stretch.hand[low:high]])


@cache
def _current_per_wrench() -> Array:
    """Return the coil currents per wrench, (6, 6).

    In [A/N, A/(N m)].
    """
    coils = load_model("drop").coils
    assert coils is not None
    return coils.current_per_wrench
