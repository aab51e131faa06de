"""Snapshots of a scene and their publishers."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol, TypeAlias

import numpy as np

from maglev_mj.frames import Array
from maglev_mj.plants.hand import SpringHand
from maglev_mj.plants.trace import HandWork
from maglev_mj.scenes import Scene
from maglev_mj.session.pacing import Due

SHOWN = 2.0
"""Time that a history covers [s]."""

_COLUMNS, _LEAST_ROWS, _MOST_ROWS = 25, 512, 250_000
_NAN = float("nan")

_Six: TypeAlias = Sequence[float] | Array


def _zeros() -> Array:
    return np.zeros(6)


class TourLine(NamedTuple):
    """Step of a guided tour.

    Names in braces, such as {stiffness up}, are actions, and {hand} is the hand's way to pull.

    Attributes:
        number: Number of the step, from 1.
        total: Number of steps.
        text: Explanation.
        deed: Task of the user.
        done: True if it was done.
    """

    number: int
    total: int
    text: str
    deed: str
    done: bool

    def words(self, name: Callable[[str], str]) -> tuple[str, str]:
        """Return text and deed with a viewer's own names.

        Args:
            name: Function that returns the viewer's name of an entry in braces.
        """
        text, deed = (re.sub(r"\{(.*?)\}", lambda match: name(match[1]), part) for part in (self.text, self.deed))
        return text, deed


@dataclass(frozen=True, kw_only=True, eq=False)
class Snapshot:
    """State of a scene at one instant.

    The defaults are those of a scene before its start.

    Attributes:
        scene: The scene with its present parameters.
        since: First sample answered with them.
        delay: Time from a sample to its command's effect [s]; the median of the last 100 if measured.
        inertia: Mass and moments of inertia of the flotor [kg, kg m²], (6,); None for the scene's own.
        tick: Samples answered so far.
        time: Time of the session [s].
        pose: Pose of the flotor [m, rad], (6,).
        force: Held wrench of the device, limited, without pulses and weight compensation [N, N m], (6,).
        hand: Wrench of the hand [N, N m], (6,); zeros if not measured.
        hand_estimated: True if that is a device's estimate.
        stops: Wrench of the metal stops [N, N m], (6,); zeros if not measured.
        target: Pose of the hand's spring [m, rad]; None if released, or if it follows a path.
        hand_stiffness: Stiffness of that spring [N/m].
        currents: Currents in the coils [A], (6,).
        faces: Every wall: index into AXES, normal, edge.
        anchors: Stick positions [m, rad], (6,), NaN on axes that do not stick; None without friction.
        history: Latest samples, (N, 25): time, then pose, twist, wrench of the device and of the hand, six each.
        work: Work of the hand [J]; NaN if unknown.
        taken: Energy absorbed by the rendered world [J]; NaN if not known.
        rewound: How long before the newest sample the scene is shown [s]; None if it cannot be rewound.
        first: Time and pose of the first try beside a second one, (N, 7), over the time shown; empty for none.
        pulses: Braking pulses given so far.
        cost: Computing time of a tick [s].
        missed: Ticks given up, or samples that did not arrive.
        late: True if ticks are being given up: this machine cannot keep up.
        time_scale: Simulated time for each second of real time.
        duration: Length of a recording [s]; None for a running scene.
        marks: Times of a recording's events [s].
        actions: Names of the actions for `act`.
        state: "running", "paused", "stopped" or "flying".
        reason: Reason of the stop; empty otherwise.
        remedy: Advice to restart after a stop without such an action; empty otherwise.
        notes: Messages for the user.
        tour: Present step of a guided tour; None for no tour.
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
    stops: Array = field(default_factory=_zeros)
    target: Sequence[float] | None = None
    hand_stiffness: float = SpringHand.stiffness
    currents: Array = field(default_factory=_zeros)
    faces: Sequence[tuple[int, float, float]] = ()
    anchors: Array | None = None
    history: Array = field(default_factory=lambda: np.empty((0, _COLUMNS)))
    work: float = 0.0
    taken: float = _NAN
    rewound: float | None = None
    first: Array = field(default_factory=lambda: np.empty((0, 7)))
    pulses: int = 0
    cost: float = 0.0
    missed: int = 0
    late: bool = False
    time_scale: float = 1.0
    duration: float | None = None
    marks: Sequence[float] = ()
    actions: Sequence[str] = ()
    state: str = "running"
    reason: str = ""
    remedy: str = ""
    notes: Sequence[str] = ()
    tour: TourLine | None = None

    @property
    def ghost(self) -> Array | None:
        """Pose of the first try, else where friction sticks [m, rad], (6,); None for neither."""
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
        """Advance by real time [s]; return the number of ticks."""

    def act(self, action: str) -> None:
        """Perform one of a snapshot's actions."""

    def change(self, parameters: Mapping[str, Any]) -> None:
        """Change parameters by name.

        Raises:
            ParameterError: If there is no such parameter, or a value is refused.
        """

    def snapshot(self) -> Snapshot:
        """Return the snapshot of now."""

    def close(self) -> None:
        """Close the recording."""


class History:
    """Samples of the last seconds, at most 250 000; returned rows never change.

    Args:
        span: Time that they cover [s].
    """

    def __init__(self, span: float = SHOWN) -> None:
        self._span = span
        self.clear()

    def clear(self) -> None:
        """Discard all samples."""
        self._rows, self._end = np.empty((_LEAST_ROWS, _COLUMNS)), 0

    def add(self, time: float, pose: _Six, twist: _Six, force: _Six, hand: _Six) -> None:
        """Add a sample.

        Time, then pose, twist, wrench of the device and of the hand, six each.
        """
        if self._end == len(self._rows):
            self._make_room(1)
        row = self._rows[self._end]
        row[0], row[1:7], row[7:13], row[13:19], row[19:] = time, pose, twist, force, hand
        self._end += 1

    def replace(self, rows: Array) -> None:
        """Take rows in place of all samples; they are not written over."""
        self._rows, self._end = rows, len(rows)

    def extend(self, rows: Array) -> None:
        """Add samples in the format of `rows`, (N, 25)."""
        if self._end + len(rows) > len(self._rows):
            self._make_room(len(rows))
        self._rows[self._end : self._end + len(rows)] = rows
        self._end += len(rows)

    def _make_room(self, count: int) -> None:
        kept = self.rows
        self._rows, self._end = np.empty((2 * (len(kept) + count) + _LEAST_ROWS, _COLUMNS)), len(kept)
        self._rows[: self._end] = kept

    @property
    def rows(self) -> Array:
        """All samples, (N, 25)."""
        return self.last(self._span)

    def last(self, span: float) -> Array:
        """Return the samples of the last seconds, (N, 25)."""
        rows = self._rows[max(self._end - _MOST_ROWS, 0) : self._end]
        return rows[np.searchsorted(rows[:, 0], rows[-1, 0] - span) :] if len(rows) else rows


class SampledMotion:
    """Speed and hand work derived from samples alone.

    Attributes:
        history: Samples of the last two seconds.
    """

    def __init__(self) -> None:
        self.history, self._hand = History(), HandWork()
        self._last: tuple[float, Array] | None = None

    @property
    def work(self) -> float:
        """Work of the hand [J].

        Its force is taken as constant from sample to sample.
        """
        return self._hand.total

    def add(self, time: float, pose: Array, force: Array, hand: Sequence[float]) -> None:
        """Add a sample.

        Args:
            time: Time of the sample [s], later than the last.
            pose: Pose [m, rad], (6,).
            force: Wrench of the device without weight compensation [N, N m], (6,).
            hand: Wrench of the hand [N, N m], six.
        """
        self._hand.add(pose, hand)
        before, last = self._last or (time - 1.0, pose)
        self.history.add(time, pose, (pose - last) / (time - before), force, hand)
        self._last = time, pose


class ChangeRequest(NamedTuple):
    """Scene requested by another program.

    Attributes:
        scene: The scene.
        reply: Called once by the loop, with the first sample under it or the reason of its refusal.
    """

    scene: Scene
    reply: Callable[[int | str], object] = lambda since: None


REPLACED = "replaced by a newer request before it was in force"
"""Reply to a request that a newer one has overtaken."""


class Publisher(Protocol):
    """Interface of a publisher to other programs.

    It never waits, because it is called in the control loop.

    Its `note`, if any, is shown to the user.
    """

    def take(self) -> ChangeRequest | None:
        """Return a program's request once, else None."""

    def show(self, snapshot: Snapshot) -> None:
        """Publish a snapshot."""

    def close(self) -> None:
        """Close all connections; idempotent."""


class Publishers:
    """Group of publishers, served 60 times a second.

    Args:
        publishers: The publishers; may be empty.
        clock: Clock of real time [s].
    """

    def __init__(self, publishers: Sequence[Publisher] = (), clock: Callable[[], float] = time.monotonic) -> None:
        self._publishers, self._due = tuple(publishers), Due(clock=clock)

    def __bool__(self) -> bool:
        return bool(self._publishers)

    def show(self, snapshot: Callable[[], Snapshot]) -> None:
        """Make and publish a snapshot if one is due."""
        if not self._publishers or not self._due():
            return
        present = snapshot()
        for publisher in self._publishers:
            publisher.show(present)

    @property
    def notes(self) -> list[str]:
        """Messages for the user."""
        return [note for publisher in self._publishers if (note := getattr(publisher, "note", ""))]

    def wanted(self) -> ChangeRequest | None:
        """Return a program's request once, else None."""
        return next(filter(None, (publisher.take() for publisher in self._publishers)), None)

    def close(self) -> None:
        """Close all publishers."""
        for publisher in self._publishers:
            publisher.close()
