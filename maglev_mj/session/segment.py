"""Segment of a session (a scene with constant parameters), and the history for rewinding."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import ControlLoop, Record
from maglev_mj.errors import ParameterError
from maglev_mj.frames import ZERO, Array, Command, Component, Sample, Six
from maglev_mj.plants import MuJoCoPlant, Timing
from maglev_mj.plants.base import restore, states_of
from maglev_mj.plants.hand import HandForce, State
from maglev_mj.plants.trace import EnergyAccount
from maglev_mj.recording import RecordingFile, setup_of
from maglev_mj.recording.sample import Setup
from maglev_mj.recording.setup import attach_model, attach_source
from maglev_mj.scenes import Scene
from maglev_mj.scenes.find import reference_of, source_of
from maglev_mj.session.snapshot import HAND, SHOWN, History

MAX_REWIND = 60.0
"""Longest rewind [s]."""

_EVERY = 0.5
"""Interval of saved states [s]."""

_MAX_STATES = 160  # one minute plus some changes; each has a plant of 0.5 MB
_MAX_POINTS = 200
_ROUNDING = 1e-9


def begin_scene(file: RecordingFile, scene: Scene, plant: Any, controller: Controller, **details: Any) -> Record:
    """Start a segment of a recording with a scene's metadata; arguments as for `describe_scene`."""
    return file.begin(plant, controller, describe_scene(file, scene, plant, controller, **details))


def describe_scene(file: RecordingFile, scene: Scene, plant: Any, controller: Controller, **details: Any) -> Setup:
    """Return the setup of a scene's segment, and attach its files to the recording.

    Args:
        file: The file.
        scene: The scene.
        plant: The controlled plant.
        controller: The controller.
        details: Additional arguments of `setup_of`.
    """
    cls = type(scene)
    attach_model(file, scene.model)
    attach_source(file, cls)
    details |= {
        "scene": reference_of(cls),
        "source": source_of(cls),
        "parameters": scene.as_json() | {"device": scene.hardware.reference},
        "axis": scene.axis,
    }
    return setup_of(plant, controller, **details)


class LiveSegment:
    """Scene running with constant parameters from a given state.

    Args:
        scene: The scene.
        hand: The hand.
        pose: Initial pose [m, rad].
        twist: Initial twist [m/s, rad/s].
        wrench: Coil wrench until the first command takes effect [N, N m].
        file: File to record to, or None.
        began: Session time at the start [s].
        first: Session number of its first sample.
        keep: Function called after each tick with a row of history, see `History.add`.

    Attributes:
        scene: The scene.
        energy: Energy balance.
        pulsed: True if the last command had a pulse.
        ticks: Number of ticks so far.
        every: Number of ticks between saved states.
    """

    def __init__(
        self,
        scene: Scene,
        hand_force: HandForce,
        *,
        pose: Sequence[float],
        twist: Sequence[float] = ZERO,
        wrench: Sequence[float],
        file: RecordingFile | None,
        began: float,
        first: int,
        keep: Callable[..., object],
    ) -> None:
        self.plant = live_plant(scene, hand_force, pose=pose, twist=twist, wrench=wrench)
        self.controller = scene.controller()
        self._carried = self.controller.carried
        self.energy = EnergyAccount(np.array(pose), self._carried)
        self.scene, self._keep, self._began = scene, keep, began
        self.ticks, self._period = 0, scene.period
        self.every = max(round(_EVERY / scene.period), 1)
        self.pose, self.twist = np.array(pose, dtype=np.float64), np.array(twist, dtype=np.float64)
        self.force: Sequence[float] = wrench
        self.pulsed = False
        self._parts: list[tuple[int, int]] = []
        self.begin(hand_force, file, first)

    def begin(self, hand_force: HandForce, file: RecordingFile | None, first: int) -> None:
        """Resume with a hand, recorded from here on.

        Args:
            hand_force: The hand.
            file: File to record to, or None.
            first: Session number of the next sample; rewinds do not reset it.
        """
        # by tick; drop parts without samples before a rewind
        self._parts = [part for part in self._parts if part[0] < self.ticks]
        after = self._parts[-1][1] + self.ticks - self._parts[-1][0] - 1 if self._parts else None
        self._parts.append((self.ticks, first))
        record = None
        if file is not None:
            details = {"before": self.force, "session": {"first": first, "after": after}}
            name, plant = f"scene {self.scene.name}", self.plant
            record = begin_scene(file, self.scene, plant, self.controller, name=name, **details)
        self._start_loop(hand_force, record)

    def _start_loop(self, hand_force: HandForce, record: Record | None) -> None:
        self.plant.hold(hand_force)
        self._loop = ControlLoop(self.plant, self.controller, observe=self._observe, record=record)

    def tick(self) -> None:
        """Run one tick."""
        self._loop.cycle()
        self.ticks += 1

    def saved(self) -> Any:
        """Return the current state between two ticks, for `restore`."""
        return states_of(self, self.controller, self.energy), self.plant.saved()

    def restore(self, saved: Any, efforts: Sequence[Six]) -> None:
        """Restore a saved state, and replay the hand's wrenches [N, N m] from it."""
        states, plant = saved
        restore(states)
        self.plant.restore(plant)
        wrenches = iter(efforts)
        self._start_loop(lambda *_: next(wrenches), None)
        for _ in efforts:
            self.tick()

    @property
    def time(self) -> float:
        """Session time [s]."""
        return self._began + self.ticks * self._period

    @property
    def wrench(self) -> Array:
        """Device wrench, that of walls on the device included [N, N m], (6,)."""
        return np.add(self.force, self.plant.walls_wrench)

    @property
    def rendered(self) -> Array:
        """Device wrench without weight compensation [N, N m], (6,)."""
        return np.asarray(self.wrench - self._carried)

    def _observe(self, sample: Sample, applied: Command) -> None:
        plant = self.plant
        self.pose, self.twist = plant.state()
        effort = plant.hand_wrench
        self.energy.add(self.pose, effort, plant.work)
        self.force = applied.force
        extra, width = (ZERO, 0.0) if applied.extra is None else (applied.extra, applied.pulse_width)
        self.pulsed = any(extra)
        self._keep(self.time, self.pose, self.twist, self.rendered, effort, extra, width)


def live_plant(scene: Scene, hand_force: HandForce | None = None, **start: ArrayLike) -> MuJoCoPlant:
    """Return a scene's plant with metal stops and current limits, by default 10 A per coil.

    Args:
        scene: The scene.
        hand_force: The hand on the flotor; its attribute `hand`, if any, is its impedance.
        start: Pose, twist and wrench that override the scene's.
    """

    def make(timing: Timing, **options: Any) -> MuJoCoPlant:
        coils = scene.hardware.coils
        limits: dict[str, Any] = {"current_limit": coils and coils.current_limit, "stops": scene.hardware.range.stops}
        hands = {"hand_force": hand_force, "hand": getattr(hand_force, "hand", None)}
        return MuJoCoPlant(timing, **limits | {"metered": True} | options | hands)

    plant = scene.plant(make, **start)  # type: ignore[arg-type]
    assert isinstance(plant, MuJoCoPlant)
    return plant


class RepeatedHand:
    """Recorded hand, by session time; another hand takes over at its end.

    Args:
        rows: Samples as in `History.rows`.
        end: End of the last sample [s].
        clock: Function that returns the session time of the current sample [s].
        after: Hand that takes over.

    Attributes:
        hand: Impedance of the hand.
    """

    def __init__(self, rows: Array, end: float, clock: Callable[[], float], after: HandForce) -> None:
        self._times, self._efforts = rows[:, 0].tolist(), rows[:, HAND]
        self._end, self._clock, self._after, self.hand = end, clock, after, getattr(after, "hand", None)

    def __call__(self, tick: int, time: Component, state: State) -> Six:
        """See `HandForce`."""
        now = self._clock() + _ROUNDING
        index = bisect_right(self._times, now) - 1
        if now >= self._end:
            return self._after(tick, time, state)
        effort: list[float] = self._efforts[index].tolist()
        return effort


class RewindBuffer:
    """Samples and states of the last minute, at most since the last start.

    Attributes:
        history: Samples up to the time shown.
        rewound: True while an earlier time is shown.
    """

    def __init__(self) -> None:
        self.history = History(MAX_REWIND)
        self._states: deque[tuple[float, LiveSegment, Any]] = deque(maxlen=_MAX_STATES)
        self.clear()

    def clear(self) -> None:
        """Discard everything, at the start of a scene."""
        self.history.clear()
        self._states.clear()
        self.rewound, self._end = False, 0.0
        self._original = self._first = self.history.rows

    def keep(self, segment: LiveSegment) -> None:
        """Save the current state of a running scene."""
        for oldest in self.history.rows[:1, 0]:
            while self._states and self._states[0][0] < oldest - _ROUNDING:
                self._states.popleft()
        self._states.append((segment.time, segment, segment.saved()))

    def bounds(self, now: float) -> tuple[float, float]:
        """Return the earliest and the newest available time [s]."""
        return self._states[0][0], self._end if self.rewound else now

    def show(self, time: float, now: float) -> LiveSegment:
        """Return the scene at an earlier time, replayed from the last saved state before it.

        Args:
            time: Session time to show, within the bounds [s].
            now: Current session time [s].
        """
        if not self.rewound:
            self.rewound, self._end, self._original = True, now, self.history.rows
        since, segment, state = [saved for saved in self._states if saved[0] <= time + _ROUNDING][-1]
        begin, end = np.searchsorted(self._original[:, 0], (since - _ROUNDING, time - _ROUNDING))
        self.history.replace(self._original[:begin])  # the replay adds the remaining samples
        segment.restore(state, self._original[begin:end, HAND].tolist())
        return segment

    def leave(self, now: float) -> tuple[Array, float]:
        """Resume from the time shown; return the original samples from there on, and their end [s]."""
        if not self.rewound:
            raise ParameterError("the hand's motion can only be repeated after a rewind")
        self.rewound = False
        self._first = self._original[np.searchsorted(self._original[:, 0], now - _ROUNDING) :]
        while self._states[-1][0] > now + _ROUNDING:
            self._states.pop()
        return self._first, self._end

    @property
    def first(self) -> Array:
        """Time and pose of the original run within the displayed time, (N, 7), until its end."""
        times = self.history.last(SHOWN)[:, 0]
        if self.rewound or not len(times) or times[-1] > self._end - _ROUNDING:
            return np.empty((0, 7))
        begin, end = np.searchsorted(self._first[:, 0], (times[0] - _ROUNDING, times[-1] + _ROUNDING))
        return self._first[begin:end][:: -max(-(-(end - begin) // _MAX_POINTS), 1)][::-1, :7]
