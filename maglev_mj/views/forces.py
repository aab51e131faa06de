"""Forces of a session as all viewers show them: mean and extremes, state of hand and friction, magnified strip."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from maglev_mj.control.controller import Controller
from maglev_mj.control.laws.friction import Friction
from maglev_mj.control.laws.wall import Wall
from maglev_mj.control.timeline import peak_forces, recorded_switches
from maglev_mj.errors import MaglevError
from maglev_mj.frames import AXES, Array, unit_of
from maglev_mj.plants.shapes import Face
from maglev_mj.scenes import Scene
from maglev_mj.session import Snapshot, device_controller
from maglev_mj.session.snapshot import DEVICE, HAND, POSE, PULSE, TWIST, WIDTH

_MEAN_SPAN = 0.1
"""Real time over which a viewer averages a force [s]."""

_ROUNDING = 1e-9


class ForceRange(NamedTuple):
    """Force of hand or device over the averaging time; NaN if it is not measured.

    Attributes:
        mean: Mean wrench, pulses included [N, N m], (6,).
        least: Smallest magnitude of the held force [N].
        most: Largest magnitude of the force, pulses included [N].
    """

    mean: Array
    least: float
    most: float

    @property
    def size(self) -> float:
        """Magnitude of the mean force [N]."""
        return float(np.linalg.norm(self.mean[:3]))


def averaging_time(snapshot: Snapshot) -> float:
    """Return the simulated time over which forces are averaged [s]: 0.1 s of real time; one sample while paused."""
    period = snapshot.scene.period
    return period if snapshot.state == "paused" else max(_MEAN_SPAN * min(snapshot.time_scale, 1.0), period)


def is_halted(snapshot: Snapshot) -> bool:
    """Return True if the time of a simulation stands still; that of a device goes on, also in a fault."""
    return snapshot.state == "stopped" and snapshot.device is None


def forces(snapshot: Snapshot) -> Mapping[str, ForceRange]:
    """Return the forces of "hand" and "device" over `averaging_time`, up to the newest sample; none while halted."""
    if is_halted(snapshot):  # what acted before is in the charts
        return dict.fromkeys(("hand", "device"), ForceRange(np.zeros(6), 0.0, 0.0))
    rows = snapshot.history
    if not len(rows):
        pairs = ("hand", snapshot.hand), ("device", snapshot.force)
        return {name: ForceRange(wrench, *[float(np.linalg.norm(wrench[:3]))] * 2) for name, wrench in pairs}
    rows = rows[rows[:, 0] > rows[-1, 0] - averaging_time(snapshot) + _ROUNDING]
    held, extra, width = rows[:, DEVICE], rows[:, PULSE], rows[:, WIDTH]
    share = np.minimum(width / snapshot.scene.period, 1.0)[:, None]
    hand, size = np.linalg.norm(rows[:, HAND][:, :3], axis=1), np.linalg.norm(held[:, :3], axis=1)
    return {
        "hand": ForceRange(rows[:, HAND].mean(axis=0), float(hand.min()), float(hand.max())),
        "device": ForceRange(
            (held + share * extra).mean(axis=0), float(size.min()), float(peak_forces(held, extra, width).max())
        ),
    }


def force_text(force: ForceRange) -> str:
    """Return a force as text, such as "3.4 N, peak 95.6 N"; empty if it is not measured."""
    return "" if math.isnan(force.most) else f"{force.size:.1f} N, peak {force.most:.1f} N"


def hand_at_limit(snapshot: Snapshot) -> bool:
    """Return True if the hand pulls with its largest force."""
    return forces(snapshot)["hand"].most >= snapshot.hand_limit * (1.0 - _ROUNDING)


def state_words(snapshot: Snapshot) -> str:
    """Return the state of hand and friction, such as "7.0 N, limit of the hand; sticking, 1.4 of 2 N"; empty without.

    Nothing is said of friction while the scene's laws do not act.
    """
    limit = f"{snapshot.hand_limit:.1f} N, limit of the hand" if hand_at_limit(snapshot) else ""
    return "; ".join(filter(None, (limit, _friction_words(snapshot))))


def _friction_words(snapshot: Snapshot) -> str:
    controller = None if snapshot.idle or snapshot.state == "stopped" else controller_of(snapshot.scene)
    anchors = snapshot.anchors
    if controller is None or anchors is None:
        return ""
    loads, sliding = [], []
    for law in controller.laws:
        if not isinstance(law, Friction) or law.batch:
            continue
        stiffness, breakaway = (law.on_axes(getattr(law, name)) for name in ("stiffness", "breakaway"))
        axes = list(law.indices)
        stuck = [axis for axis in axes if np.isfinite(anchors[axis])]
        sliding += [axis for axis in axes if axis not in stuck]
        pulls = {axis: abs(stiffness[axis] * (anchors[axis] - snapshot.pose[axis])) for axis in stuck}
        if getattr(law, "coupled", False) and len(stuck) == len(axes):
            pulls = {axes[0]: math.hypot(*pulls.values())}
        loads += [(pull / breakaway[axis], pull, breakaway[axis], axis) for axis, pull in pulls.items()]
    if sliding:
        return f"slipping along {', '.join(AXES[axis] for axis in sliding)}" if loads else "slipping"
    if not loads:
        return ""
    _, pull, most, axis = max(loads)
    return f"sticking, {min(pull, most):.{1 if axis < 3 else 3}f} of {most:.3g} {unit_of('N', AXES[axis])}"


@lru_cache(maxsize=8)
def controller_of(scene: Scene, on_device: bool = False) -> Controller | None:
    """Return a scene's controller, or that for a device, to read its laws; None if it cannot be made."""
    try:
        return device_controller(scene) if on_device else scene.controller()
    except Exception:  # of a user's laws, too
        return None


STRIP_SPAN = 0.5
"""Time span of a strip [s]."""
_STRIP_SAMPLES, _STRIP_POINTS = 600, 240


class Strip(NamedTuple):
    """Motion beside a wall's edge over the last half second, at most 600 samples, with the forces on its axis.

    Times are relative to the newest sample [s]. Between samples the motion is that under the recorded forces, exact if
    hand and load are constant from one sample to the next.

    Attributes:
        axis: Index into AXES.
        normal: Normal of the wall: 1 if the axis is free above the edge, -1 if below; 0 without a wall.
        edge: Edge of the wall [m, rad]; away from walls the stick position, or the mean position.
        sticks: True if `edge` is the stick position.
        time: Times of position and ideal force, (N,).
        position: Position [m, rad], (N,).
        ideal: Force that the laws should give at this position and velocity, without sampling and delay [N, N m], (N,);
            NaN if a law with memory, such as friction, acts on the axis.
        switches: Times at which the force of the device changes, (M,).
        force: Force of the device that acts from each switch on, pulses included [N, N m], (M,).
    """

    axis: int
    normal: float
    edge: float
    sticks: bool
    time: Array
    position: Array
    ideal: Array
    switches: Array
    force: Array


def strip(snapshot: Snapshot, span: float = STRIP_SPAN) -> Strip | None:
    """Return the magnified strip at the stick position or the nearest wall; None with fewer than three samples.

    Takes about half a millisecond at 200 Hz; at most 240 + 1800 points.

    Args:
        snapshot: The snapshot.
        span: Longest time span [s].
    """
    rows = snapshot.history
    rows = rows[rows[:, 0] > rows[-1, 0] - span - _ROUNDING][-_STRIP_SAMPLES:] if len(rows) else rows
    if len(rows) < 3:
        return None
    axis, normal, edge, sticks = _place(snapshot, rows)
    time, scene = rows[:, 0] - rows[-1, 0], snapshot.scene
    delay = 0.0 if math.isnan(snapshot.delay) else snapshot.delay
    switches, wrench = recorded_switches(
        time, rows[:, DEVICE], rows[:, PULSE], rows[:, WIDTH], period=scene.period, delay=delay
    )
    inside = switches < -_ROUNDING
    switches, force = switches[inside], wrench[inside, axis]
    controller = None if snapshot.idle else controller_of(scene, snapshot.hand_estimated)
    mass = float(scene.body.inertia[axis] if snapshot.inertia is None else snapshot.inertia[axis])
    load = 0.0 if controller is None else float(scene.body.load[axis] + controller.carried[axis])
    fine = np.unique(np.concatenate([time, switches, np.linspace(time[0], 0.0, _STRIP_POINTS)]))
    acting = np.concatenate([force[:1], force])[np.searchsorted(switches, fine, side="right")]
    held = np.nan_to_num(rows[:, HAND][:, axis])[np.searchsorted(time, fine, side="right") - 1]
    # motion under the forces, corrected by a constant velocity in each period so that it passes the samples
    push, step = (acting + held + load) / mass, np.diff(fine)
    speed = np.concatenate([[0.0], np.cumsum(push[:-1] * step)])
    path = np.concatenate([[0.0], np.cumsum((speed[:-1] + 0.5 * push[:-1] * step) * step)])
    missing = rows[:, POSE][:, axis] - path[np.searchsorted(fine, time)]
    slope = np.diff(missing) / np.diff(time)
    speed = speed + slope[np.clip(np.searchsorted(time, fine, side="right") - 1, 0, len(slope) - 1)]
    position = path + np.interp(fine, time, missing)
    places = [np.interp(fine, time, column) for column in rows[:, POSE].T]
    speeds = [np.interp(fine, time, column) for column in rows[:, TWIST].T]
    places[axis], speeds[axis] = position, speed
    ideal = _ideal(controller, places, speeds, axis)
    starts, acting = np.append(time[0], switches), np.append(force[:1], force)
    return Strip(axis, normal, edge, sticks, fine, position, ideal, starts, acting)


def _place(snapshot: Snapshot, rows: Array) -> tuple[int, float, float, bool]:
    """Return axis, normal, edge and whether it is a stick position: of a touched wall, else where it sticks.

    Otherwise the nearest wall, in shares of the range of motion, or without walls the mean position.
    """
    reach, own = snapshot.scene.body.bounded.range, snapshot.scene.axis_index

    def distance(face: Face) -> tuple[bool, float, bool]:
        axis, normal, edge = face
        gap = float((normal * (rows[:, 1 + axis] - edge)).min())
        return (axis > 2) != (own > 2), gap / float(reach[axis]), axis != own

    face = min(snapshot.faces, key=distance, default=None)
    anchors = np.full(len(AXES), np.nan) if snapshot.anchors is None else snapshot.anchors
    if face is None or distance(face)[1] > 0.0:
        stuck = [axis for axis in range(3 * (own > 2), 3 * (own > 2) + 3) if np.isfinite(anchors[axis])]
        if stuck:
            pulls = {axis: (abs(float(anchors[axis]) - float(rows[-1, 1 + axis])), axis == own) for axis in stuck}
            axis = max(stuck, key=pulls.__getitem__)
            return axis, 0.0, float(anchors[axis]), True
    return (own, 0.0, float(rows[:, 1 + own].mean()), False) if face is None else (*face, False)


def _ideal(controller: Controller | None, places: Sequence[Array], speeds: Sequence[Array], axis: int) -> Array:
    """Return the force of all laws on an axis, weight compensation excluded; NaN if one of them has memory."""
    unknown, wrench = np.full(places[0].shape, np.nan), [np.zeros_like(places[0]) for _ in AXES]
    if controller is None:
        return unknown
    for law in controller.laws:
        if law.carried().any():
            continue
        before, parts = wrench[axis], list[Any](wrench)
        try:
            following, _ = law(places, speeds, law.start(), parts)
        except (MaglevError, ArithmeticError, TypeError, ValueError, IndexError):  # a user's law for floats only
            return unknown
        has_memory = not isinstance(law, Wall) and _remembers(following)
        if has_memory and not np.array_equal(parts[axis], before):
            return unknown
        wrench = parts
    for wall in controller.device_walls:
        if wall.axis == axis:
            offset, speed = places[axis] - wall.edge, speeds[axis]
            wrench[axis] = wrench[axis] - (wall.side * offset <= 0.0) * (wall.stiffness * offset + wall.damping * speed)
    return np.asarray(wrench[axis] + 0.0 * places[axis])


def _remembers(state: Any) -> bool:
    """Return True if a law's state is more than None for each axis."""
    return state is not None and not (isinstance(state, tuple | list) and all(part is None for part in state))
