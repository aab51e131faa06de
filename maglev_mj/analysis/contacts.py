"""Contacts at a wall, with their figures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from maglev_mj.frames import AXES, Array, Mask, unit_of
from maglev_mj.result import plain
from maglev_mj.scenes.figures import Hardness, perceived_hardness, summarise_bounce
from maglev_mj.trace import Trace

HARDNESS_WINDOW = 0.005
"""Window of the force rise for the hardness [s]."""

_REST = 0.1
"""Final share of a stretch that counts as rest.

The flotor must rest over it to have settled.
"""


class Contact(NamedTuple):
    """Contact from entering a wall to leaving it.

    Attributes:
        start: Time of entry [s].
        duration: Time until the exit, or the end of the recording [s].
        approach_speed: Speed at entry [m/s, rad/s]; NaN if the recording begins inside.
        penetration: Largest depth [m, rad].
        peak_force: Largest force of the actuators on the axis during contact, either sign [N, N m].
    """

    start: float
    duration: float
    approach_speed: float
    penetration: float
    peak_force: float


@dataclass(frozen=True, kw_only=True, eq=False)
class FaceFigures:
    """Figures of the contacts at one wall.

    Attributes:
        axis: Index into AXES.
        normal: 1 if the axis is free above the edge, -1 if below.
        edge: Edge of the wall [m, rad].
        contacts: All contacts, in order.
        penetration: Largest depth of all [m, rad].
        rebound: Largest distance from the wall after the first contact, from any cause [m, rad].
        peak_force: Largest force of the actuators on the axis, in contact or not [N, N m].
        settling_time: Time from the start after which the position stays within 2 % of the way from start to rest
            around the rest [s]; NaN if the flotor does not rest over the last tenth.
        rest: Mean position over the last tenth [m, rad].
        hardness: Hardness of the contact with the fastest approach [N/m, N m/rad]; NaN if there is no such contact
            with enough time.
    """

    axis: int
    normal: float
    edge: float
    contacts: Sequence[Contact]
    penetration: float
    rebound: float
    peak_force: float
    settling_time: float
    rest: float
    hardness: Hardness

    @property
    def name(self) -> str:
        """Axis, side and edge, such as "z below 0 mm"."""
        side = "below" if self.normal > 0.0 else "above"
        return f"{AXES[self.axis]} {side} {self.edge * 1e3:.4g} {unit_of('mm', self.axis)}"

    def as_json(self) -> dict[str, Any]:
        """Return everything, ready for JSON."""
        figures = {name: plain(value) for name, value in asdict(self).items() if isinstance(value, float)}
        hardness = {f"{name}_hardness": plain(float(value)) for name, value in self.hardness._asdict().items()}
        contacts = [{name: plain(value) for name, value in one._asdict().items()} for one in self.contacts]
        return {"axis": AXES[self.axis], **figures, **hardness, "contacts": contacts}


def face_figures(
    trace: Trace, face: tuple[int, float, float], *, rest: float | None = None, window: float = HARDNESS_WINDOW
) -> FaceFigures | None:
    """Return the figures of a wall, None if untouched.

    Args:
        trace: The motion.
        face: The wall: index into AXES, normal, edge.
        rest: Rest position of the flotor [m, rad]; its mean position over the last tenth by default.
        window: Window of the force rise for the hardness [s].
    """
    axis, normal, edge = face
    line, begin = _facing(trace, axis, normal, edge), float(trace.time[0])
    curve = _Curve.of(line)
    if not curve.inside.any():
        return None
    contacts = curve.contacts()
    end = float(line.time[-1])
    tail = line.at(np.linspace(end * (1.0 - _REST), end, 201))[0][:, 0]
    resting = float(tail.mean()) if rest is None else normal * (rest - edge)
    bounce = summarise_bounce(line, resting, axis=0)
    settled = float(bounce.settling_time)
    return FaceFigures(
        axis=axis,
        normal=float(normal),
        edge=float(edge),
        contacts=[contact._replace(start=contact.start + begin) for contact in contacts],
        penetration=float(bounce.penetration),
        rebound=float(bounce.rebound),
        peak_force=float(bounce.peak_force),
        settling_time=settled if settled <= end * (1.0 - _REST) else math.nan,
        rest=edge + normal * resting,
        hardness=_hardness(line, contacts, window),
    )


def _hardness(line: Trace, contacts: Sequence[Contact], window: float) -> Hardness:
    """Return the hardness of the contact with fastest approach.

    A grazing contact has no hardness.
    """
    speeds = [contact.approach_speed for contact in contacts]
    if np.isnan(speeds).all():
        return Hardness(np.array(np.nan), np.array(np.nan))
    place = int(np.nanargmax(speeds))
    if place:  # from the middle between the previous contact and this one
        before, this = contacts[place - 1], contacts[place]
        start = 0.5 * (before.start + before.duration + this.start)
        pose, twist, wrench = line.at(start)
        rest = line.time > start
        time = np.append(0.0, line.time[rest] - start)
        parts = ((pose, line.pose), (twist, line.twist), (wrench, line.wrench))
        line = Trace(time, *(np.concatenate([first, part[rest]]) for first, part in parts))
    if float(line.time[-1]) <= window:
        return Hardness(np.array(np.nan), np.array(np.nan))
    return perceived_hardness(line, window, axis=0)


def _facing(trace: Trace, axis: int, normal: float, edge: float) -> Trace:
    """Return one axis relative to a wall, from time 0.

    The wall then fills positions up to 0.
    """
    line = trace.along(axis)
    return Trace(line.time - line.time[0], normal * (line.pose - edge), normal * line.twist, normal * line.wrench)


class _Curve(NamedTuple):
    """One axis on its knots and turning points.

    The motion is monotonic between them.
    """

    time: Array
    place: Array
    speed: Array
    force: Array
    inside: Mask

    @classmethod
    def of(cls, line: Trace) -> _Curve:
        """Return the curve of a trace of one axis."""
        turn_time, turn = (part[:, 0] for part in line.turning_points())
        knots, place, speed = line.time, line.pose[:, 0], line.twist[:, 0]
        turned = speed[:-1] * speed[1:] < 0.0
        times, places = _woven(knots, turn_time), _woven(place, turn)
        speeds = _woven(speed, np.where(turned, 0.0, speed[:-1]))
        return cls(times, places, speeds, np.repeat(line.wrench[:, 0], 2)[:-1], places <= 0.0)

    def contacts(self) -> list[Contact]:
        """Return every contact, in order."""
        changes = np.flatnonzero(self.inside[1:] != self.inside[:-1])
        crossings = [self._crossing(int(place)) for place in changes]
        entered = [(int(place) + 1, *crossing) for place, crossing in zip(changes, crossings) if self.inside[place + 1]]
        left = [(int(place), when) for place, (when, _) in zip(changes, crossings) if self.inside[place]]
        if self.inside[0]:
            entered.insert(0, (0, float(self.time[0]), math.nan))
        if self.inside[-1]:
            left.append((len(self.time) - 1, float(self.time[-1])))
        found = []
        for (first, start, speed), (last, end) in zip(entered, left, strict=True):
            depth = -float(self.place[first : last + 1].min())
            # from the piece on in which the wall is entered
            force = float(np.abs(self.force[max(first - 1, 0) : max(last, first) + 1]).max())
            found.append(Contact(start, end - start, speed, depth, force))
        return found

    def _crossing(self, place: int) -> tuple[float, float]:
        """Return time and speed of an edge crossing.

        It is after a given point: v² = v0² - 2 a x0, exact on a parabola.
        """
        width = self.time[place + 1] - self.time[place]
        start, speed = float(self.place[place]), float(self.speed[place])
        if width <= 0.0:
            return float(self.time[place]), abs(speed)
        push = (self.speed[place + 1] - speed) / width
        crossing = math.sqrt(max(speed * speed - 2.0 * push * start, 0.0))
        mean = 0.5 * (abs(speed) + crossing)
        elapsed = min(abs(start) / mean, width) if mean > 0.0 else 0.0
        return float(self.time[place] + elapsed), crossing


def _woven(knots: Array, between: Array) -> Array:
    """Return values at knots interleaved with values between them."""
    woven = np.empty(2 * len(knots) - 1)
    woven[0::2], woven[1::2] = knots, between
    return woven
