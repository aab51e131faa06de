"""Snapshots of a running scene, and their publishers."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol, TypeAlias

import numpy as np

from maglev_mj.frames import ZERO, Array
from maglev_mj.plants.hand import SpringHand
from maglev_mj.plants.trace import HandWork
from maglev_mj.scenes import Scene
from maglev_mj.session.pacing import FrameClock

SHOWN = 2.0
"""Time span of a history [s]."""

POSE, TWIST, DEVICE, HAND, PULSE, WIDTH = *(slice(first, first + 6) for first in range(1, 31, 6)), 31
"""Columns of a history after the time: pose [m, rad], twist, wrench of the device that is held, wrench of the hand,
wrench added by a pulse [N, N m], six each, and duration of the pulse [s]."""

COLUMNS = 32
_MIN_ROWS, _MAX_ROWS = 512, 250_000
_NAN, _INFINITE = float("nan"), float("inf")

_Six: TypeAlias = Sequence[float] | Array


def _zeros() -> Array:
    return np.zeros(6)


class TourLine(NamedTuple):
    """Step of a guided tour.

    Names in braces, such as {stiffness up}, are actions; {hand} is how to pull in this viewer.

    Attributes:
        number: Number of the step, from 1.
        total: Number of steps.
        text: Explanation.
        task: Task of the user.
        done: True if the task is done.
    """

    number: int
    total: int
    text: str
    task: str
    done: bool

    def words(self, name: Callable[[str], str]) -> tuple[str, str]:
        """Return text and task with the names in braces replaced.

        Args:
            name: Function that returns the viewer's name of an action or the hand.
        """
        text, task = (re.sub(r"\{(.*?)\}", lambda match: name(match[1]), part) for part in (self.text, self.task))
        return text, task


class DeviceStatus(NamedTuple):
    """Status of a device behind a session.

    Attributes:
        address: Address of the device.
        phase: Phase, such as "in flight".
        warmth: Temperature rise of the hottest coil, as a fraction of its limit; NaN if unknown.
        requested: Wall stiffness before a reduction to a stable one [N/m]; NaN if it was not reduced.
        simulated: True for a twin.
    """

    address: str
    phase: str
    warmth: float = _NAN
    requested: float = _NAN
    simulated: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class Snapshot:
    """State of a scene at one instant.

    The defaults are those of a scene before its start.

    Attributes:
        scene: The scene with its current parameters.
        since: Number of the first sample with these parameters.
        delay: Delay from a sample to its command's effect [s]; if measured, the median of the last 100.
        inertia: Mass and moments of inertia of the flotor [kg, kg m²], (6,); None for the scene's own.
        tick: Number of ticks so far.
        time: Session time [s].
        pose: Pose of the flotor [m, rad], (6,).
        force: Held wrench of the device, limited, without weight compensation [N, N m], (6,); pulses are in `history`.
        hand: Wrench of the hand [N, N m], (6,); zeros if not measured.
        hand_estimated: True if `hand` is an estimate, as on a device.
        hand_limit: Force limit of the hand [N]; infinite if unknown.
        stops: Wrench of the metal stops [N, N m], (6,); zeros if not measured.
        target: Target pose of the hand's spring [m, rad]; None if released or following a path.
        hand_stiffness: Stiffness of that spring [N/m].
        currents: Currents in the coils [A], one each.
        faces: Planes of all walls: index into AXES, normal, edge.
        anchors: Stick positions [m, rad], (6,), NaN on axes that do not stick; None without friction.
        beside: Centres [m] and quaternions of the scene's shapes beside the device, (N, 7).
        history: Latest samples, (N, 32): time, and the columns POSE, TWIST, DEVICE, HAND, PULSE, WIDTH of this module.
        work: Work of the hand [J]; NaN if unknown.
        taken: Energy absorbed by the control laws [J]; NaN if unknown.
        rewound: Time shown before the newest sample [s]; None if rewinding is not available.
        first: Time and pose of the original run after a rewind, (N, 7), within the displayed time; else empty.
        pulses: Number of braking pulses so far.
        cost: Computing time of a tick [s].
        missed: Number of skipped ticks and lost samples.
        overloaded: True while ticks are skipped because this machine is too slow.
        time_scale: Simulated time over real time.
        duration: Duration of a recording [s]; None for a running scene.
        marks: Times of a recording's events [s].
        actions: Names of the actions for `act`.
        state: "running", "paused", "stopped" or "flying".
        idle: Why the scene's laws do not act, such as "inactive: nothing is rendered"; empty while they act.
        device: Status of the device; None for a simulation.
        reason: Reason of the stop, or empty.
        remedy: How to restart after a stop if no action does, or empty.
        notes: Messages for the user.
        tour: Current step of a guided tour, or None.
    """

    scene: Scene
    since: int = 0
    delay: float = _NAN
    inertia: Sequence[float] | None = None
    tick: int = 0
    time: float = 0.0
    pose: Array = field(default_factory=_zeros)
    force: Array = field(default_factory=_zeros)
    hand: Array = field(default_factory=_zeros)
    hand_estimated: bool = False
    hand_limit: float = _INFINITE
    stops: Array = field(default_factory=_zeros)
    target: Sequence[float] | None = None
    hand_stiffness: float = SpringHand.stiffness
    currents: Array = field(default_factory=_zeros)
    faces: Sequence[tuple[int, float, float]] = ()
    anchors: Array | None = None
    beside: Array = field(default_factory=lambda: np.empty((0, 7)))
    history: Array = field(default_factory=lambda: np.empty((0, COLUMNS)))
    work: float = 0.0
    taken: float = _NAN
    rewound: float | None = None
    first: Array = field(default_factory=lambda: np.empty((0, 7)))
    pulses: int = 0
    cost: float = 0.0
    missed: int = 0
    overloaded: bool = False
    time_scale: float = 1.0
    duration: float | None = None
    marks: Sequence[float] = ()
    actions: Sequence[str] = ()
    state: str = "running"
    idle: str = ""
    device: DeviceStatus | None = None
    reason: str = ""
    remedy: str = ""
    notes: Sequence[str] = ()
    tour: TourLine | None = None

    @property
    def ghost(self) -> Array | None:
        """Pose of the original run after a rewind, else the stick position [m, rad], (6,), or None."""
        if len(self.first):
            return np.array(self.first[-1, 1:])
        if self.anchors is None or np.isnan(self.anchors).all():
            return None
        return np.where(np.isnan(self.anchors), self.pose, self.anchors)


class SnapshotSource(Protocol):
    """Interface of a real-time scene for a viewer."""

    hand: SpringHand
    simulated: float

    def tick(self, elapsed: float) -> int:
        """Advance by elapsed real time [s]; return the number of ticks."""

    def act(self, action: str) -> None:
        """Perform one of a snapshot's actions."""

    def change(self, parameters: Mapping[str, Any]) -> None:
        """Change parameters by name.

        Raises:
            ParameterError: If a parameter is unknown, or a value is refused.
        """

    def snapshot(self) -> Snapshot:
        """Return the current snapshot."""

    def close(self) -> None:
        """Close the recording."""


class History:
    """Samples of the last seconds, at most 250 000; returned rows never change.

    Args:
        span: Time span [s].
    """

    def __init__(self, span: float = SHOWN) -> None:
        self._span = span
        self.clear()

    def clear(self) -> None:
        """Discard all samples."""
        self._rows, self._end = np.empty((_MIN_ROWS, COLUMNS)), 0

    def add(
        self, time: float, pose: _Six, twist: _Six, force: _Six, hand: _Six, pulse: _Six = ZERO, width: float = 0.0
    ) -> None:
        """Add a sample: time, the columns POSE to PULSE, six components each, and WIDTH."""
        if self._end == len(self._rows):
            self._grow(1)
        row = self._rows[self._end]
        row[0], row[POSE], row[TWIST], row[DEVICE], row[HAND] = time, pose, twist, force, hand
        row[PULSE], row[WIDTH] = pulse, width
        self._end += 1

    def replace(self, rows: Array) -> None:
        """Replace all samples by rows, which are not overwritten."""
        self._rows, self._end = rows, len(rows)

    def extend(self, rows: Array) -> None:
        """Add samples in the format of `rows`, (N, 32)."""
        if self._end + len(rows) > len(self._rows):
            self._grow(len(rows))
        self._rows[self._end : self._end + len(rows)] = rows
        self._end += len(rows)

    def _grow(self, count: int) -> None:
        current = self.rows
        self._rows, self._end = np.empty((2 * (len(current) + count) + _MIN_ROWS, COLUMNS)), len(current)
        self._rows[: self._end] = current

    @property
    def rows(self) -> Array:
        """All samples, (N, 32)."""
        return self.last(self._span)

    def last(self, span: float) -> Array:
        """Return the samples of the last `span` seconds, (N, 32)."""
        rows = self._rows[max(self._end - _MAX_ROWS, 0) : self._end]
        return rows[np.searchsorted(rows[:, 0], rows[-1, 0] - span) :] if len(rows) else rows


class SampledMotion:
    """Speed and work of the hand, computed from samples.

    Attributes:
        history: Samples of the last two seconds.
    """

    def __init__(self) -> None:
        self.history, self._hand = History(), HandWork()
        self._last: tuple[float, Array] | None = None

    @property
    def work(self) -> float:
        """Work of the hand [J], with a constant force between samples."""
        return self._hand.total

    def add(
        self,
        time: float,
        pose: Array,
        force: Array,
        hand: Sequence[float],
        pulse: Sequence[float] = ZERO,
        width: float = 0.0,
    ) -> None:
        """Add a sample.

        Args:
            time: Time of the sample [s], after the previous one.
            pose: Pose [m, rad], (6,).
            force: Held wrench of the device without weight compensation [N, N m], (6,).
            hand: Wrench of the hand [N, N m], six.
            pulse: Wrench added by a pulse [N, N m], six.
            width: Duration of the pulse [s].
        """
        self._hand.add(pose, hand)
        before, last = self._last or (time - 1.0, pose)
        self.history.add(time, pose, (pose - last) / (time - before), force, hand, pulse, width)
        self._last = time, pose


class ChangeRequest(NamedTuple):
    """Scene requested by another program.

    Attributes:
        scene: The scene.
        reply: Function called once, with the number of the first sample under the scene, or the reason for refusal.
    """

    scene: Scene
    reply: Callable[[int | str], object] = lambda since: None


REPLACED = "replaced by a newer request before it took effect"
"""Reply to a request superseded by a newer one."""


class Publisher(Protocol):
    """Interface of a publisher to other programs; non-blocking, as it is called in the control loop.

    Its optional attribute `note` is shown to the user.
    """

    def take(self) -> ChangeRequest | None:
        """Return a pending request of another program once, or None."""

    def show(self, snapshot: Snapshot) -> None:
        """Publish a snapshot."""

    def close(self) -> None:
        """Close all connections; idempotent."""


class Publishers:
    """Group of publishers, served at 60 Hz.

    Args:
        publishers: The publishers; may be empty.
        clock: Real-time clock [s].
    """

    def __init__(self, publishers: Sequence[Publisher] = (), clock: Callable[[], float] = time.monotonic) -> None:
        self._publishers, self._due = tuple(publishers), FrameClock(clock=clock)

    def __bool__(self) -> bool:
        return bool(self._publishers)

    def show(self, snapshot: Callable[[], Snapshot]) -> None:
        """Take and publish a snapshot if one is due."""
        if not self._publishers or not self._due():
            return
        current = snapshot()
        for publisher in self._publishers:
            publisher.show(current)

    @property
    def notes(self) -> list[str]:
        """Messages for the user."""
        return [note for publisher in self._publishers if (note := getattr(publisher, "note", ""))]

    def wanted(self) -> ChangeRequest | None:
        """Return a pending request of another program once, or None."""
        return next(filter(None, (publisher.take() for publisher in self._publishers)), None)

    def close(self) -> None:
        """Close all publishers."""
        for publisher in self._publishers:
            publisher.close()
