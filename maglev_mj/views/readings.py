"""Readings, banner and charts of a session, which window and page draw.

The stability of its gains is one of them, found in a process beside.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.colours import BAD, BOUNDARY, DEVICE, FIRST, GOOD, HAND, MEASURED, STOP, Colour
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.frames import AXES, Array, unit_of
from maglev_mj.parameters import Parameter
from maglev_mj.plants.shapes import LEAST_FORCE
from maglev_mj.process import SideAnswers
from maglev_mj.scenes import Scene
from maglev_mj.scenes.stability_check import WallMargin, wall_margin
from maglev_mj.session import DEVICES_OWN, SHOWN, Snapshot
from maglev_mj.theory import Verdict, inertia_of, largest_stable_stiffness, stability, stated_gains

_DAMPINGS = 32
_NOTHING = np.zeros(0)


class Margin(NamedTuple):
    """Place of a scene's gains under the stability boundary.

    Attributes:
        words: Verdict, such as "stable: 59 % of the boundary".
        stable: None where that is not known.
        axis: Name of the axis that is nearest to its boundary; empty where the laws do not state their gains.
        stiffness: Of all that acts together there [N/m, N m/rad].
        damping: Likewise [N s/m, N m s/rad].
        dampings: Of the axis' boundary, increasing, (N,).
        stiffnesses: Largest stable stiffness at each, (N,).
        wall: Of the scene's wall alone; None without one.
    """

    words: str
    stable: bool | None = None
    axis: str = ""
    stiffness: float = 0.0
    damping: float = 0.0
    dampings: Array = _NOTHING
    stiffnesses: Array = _NOTHING
    wall: WallMargin | None = None


def margin(scene: Scene, delay: float | None = None, inertia: Sequence[float] | None = None) -> Margin:
    """Return a scene's gains and their stability boundary.

    The loop is that of a flotor that nobody holds: of all axes and combinations of laws the one nearest its boundary.

    Args:
        scene: The scene.
        delay: See `stability`.
        inertia: See `stability`.
    """
    body, late = inertia_of(scene) if inertia is None else np.array(inertia), scene.delay if delay is None else delay
    try:
        gains = stated_gains(scene.controller())
        verdict, wall = stability(scene, inertia=body, delay=late), wall_margin(scene, inertia=body, delay=late)
        if gains is None:
            return Margin(str(verdict), verdict.stable, wall=wall)
        return _placed(scene, verdict, list(gains.values()), body, late)._replace(wall=wall)
    except MaglevError:
        return Margin("stability not known")


def _placed(scene: Scene, verdict: Verdict, gains: list[tuple[Array, Array]], body: Array, delay: float) -> Margin:
    stiffness, damping = (np.array(both) for both in zip(*gains, strict=True))
    shares = np.zeros_like(stiffness)
    if stiffness.any():
        most = largest_stable_stiffness(damping, period=scene.period, delay=delay, mass=body)
        with np.errstate(divide="ignore", invalid="ignore"):
            shares = np.where(stiffness > 0.0, stiffness / most, 0.0)
        # of those that are alike but for rounding the first
        place = divmod(int(np.argmax(shares >= shares.max() * (1.0 - 1e-9))), len(AXES))
    else:  # the most damped combination, on the axis that is looked at
        place = int(damping[:, scene.axis_index].argmax()), scene.axis_index
    share, index = float(shares[place]), place[1]
    own = float(stiffness[place]), float(damping[place])
    if not verdict.stable:
        index = AXES.index(verdict.axes[0])
        own = float(verdict.stiffness[index, index]), float(verdict.damping[index, index])
        words = f"UNSTABLE on {AXES[index]}"
        if 1.0 <= share < np.inf:
            words += f": {100.0 * share:.0f} % of the boundary"
    elif own[0]:
        words = f"stable: {100.0 * share:.0f} % of the boundary"
    else:
        words = "stable: no stiffness"
    return Margin(words, verdict.stable, AXES[index], *own, *_boundary(scene.period, delay, float(body[index])))


class StabilityMap:
    """Margin of the newest scene, found in a process beside the viewers of this one.

    Attributes:
        scene: Scene of the last margin; None before the first.
    """

    def __init__(self) -> None:
        self.scene: Scene | None = None
        self._answers: SideAnswers | None = None
        self._asked: Any = None
        self._found, self._waits = Margin(""), False

    def of(self, snapshot: Snapshot) -> Margin:
        """Return the margin of a snapshot's scene, or the last one meanwhile."""
        if not self._waits and (question := _question(snapshot)) != self._asked:
            if self._answers is None or self._answers.ended:
                self._answers = SideAnswers(margin, "")
            self._answers.ask(*question)
            self._asked, self._waits = question, True
        if self._waits and self._answers is not None:
            try:
                found = self._answers.answer()
            except Exception:  # no answer, or a scene that another process cannot get
                found = Margin("stability not known")
            if found is not None:
                self.scene, self._found, self._waits = self._asked[0], found, False
        return self._found

    def wait(self, snapshot: Snapshot) -> None:
        """Compute a missing margin at once."""
        if self.scene != snapshot.scene:
            self.scene, self._asked, self._waits = snapshot.scene, _question(snapshot), False
            self._found = margin(*self._asked)


STABILITY = StabilityMap()
"""That of all viewers of this process."""


def _question(snapshot: Snapshot) -> tuple[Scene, float | None, Sequence[float] | None]:
    """Return the arguments of `margin`; a measured delay to 0.1 ms, as it fluctuates."""
    return snapshot.scene, round(snapshot.delay, 4) if snapshot.state == "flying" else None, snapshot.inertia


@lru_cache
def _boundary(period: float, delay: float, mass: float) -> tuple[Array, Array]:
    """Return dampings and the largest stable stiffness at each.

    Of an axis with one mass or moment of inertia.
    """
    # no damping beyond this is stable, whatever the stiffness
    most = 0.5 * np.pi * mass / (0.5 * period + delay) * 1.1
    dampings = np.linspace(0.0, most, _DAMPINGS)
    try:
        stiffnesses = largest_stable_stiffness(dampings, period=period, delay=delay, mass=mass)
    except ParameterError:  # theory goes up to ten periods of delay; beyond it there is no boundary to draw
        stiffnesses = np.zeros_like(dampings)
    end = int(np.flatnonzero(stiffnesses).max(initial=-2)) + 2
    return dampings[:end], stiffnesses[:end]


_ROUNDING = 1e-6
_LEAST_GAIN = 1e-3
_LEAST_TIME = 0.2  # shown of a run that has just begun [s]

Range: TypeAlias = tuple[float, float]


class Line(NamedTuple):
    """One line of a chart.

    Attributes:
        colour: Its colour.
        x: Along, (N,).
        y: Up, (N,); not drawn where it is not finite.
        dashed: Whether it is dashed.
        dot: Whether its last point is marked.
    """

    colour: Colour
    x: ArrayLike
    y: ArrayLike
    dashed: bool = False
    dot: bool = False


class Chart(NamedTuple):
    """One chart.

    Attributes:
        title: Pieces of text, each with a colour or None for the text's own.
        lines: The lines, the last one on top; none where the title says all.
        across: Ends of the axis along.
        up: Ends of the axis up.
        foot: Words beside the axis along; empty for none.
    """

    title: Sequence[tuple[str, Colour | None]]
    lines: Sequence[Line]
    across: Range
    up: Range
    foot: str = ""


class Charts:
    """Charts of one axis of a session over the last seconds.

    Args:
        most: Largest number of points of a line.
    """

    def __init__(self, most: int) -> None:
        self._most, self._axis = most, -1

    def of(self, snapshot: Snapshot, axis: int) -> list[Chart]:
        """Return position, force, gains and phase plane, the most important first.

        Args:
            snapshot: The snapshot.
            axis: Index into AXES.
        """
        if axis != self._axis:
            self._axis, self._places, self._speeds = axis, SteadyRange(2.0), SteadyRange(20.0)
            self._forces = SteadyRange(0.02 if axis > 2 else 2.0)
        rows = snapshot.history
        rows = rows[:: -max(-(-len(rows) // self._most), 1)][::-1]  # the newest is among them
        now = rows[-1, 0] if len(rows) else 0.0
        time = rows[:, 0] - now
        position, speed = 1e3 * rows[:, 1 + axis], 1e3 * rows[:, 7 + axis]
        device, hand = rows[:, 13 + axis], rows[:, 19 + axis]
        walls = [edge * 1e3 for index, _, edge in snapshot.faces if index == axis]
        past = now - snapshot.history[0, 0] if len(rows) else 0.0
        name, unit, across = AXES[axis], unit_of("mm", axis), (-round_up(min(max(past, _LEAST_TIME), SHOWN)), 0.0)
        before = snapshot.first
        places, speeds = self._places(position, walls, 1e3 * before[:, 1 + axis]), self._speeds(speed)
        kind = f"{'torque about' if axis > 2 else 'force on'} {name} [{unit_of('N', axis)}]"
        shown = [(f"{name} [{unit}]", MEASURED), *([("walls", None)] if walls else [])]
        shown += [("first try", FIRST)] if len(before) else []
        return [
            Chart(
                shown,
                [
                    *(Line(BOUNDARY, across, (wall, wall), True) for wall in walls),
                    Line(FIRST, before[:, 0] - now, 1e3 * before[:, 1 + axis], dot=True),
                    Line(MEASURED, time, position, dot=True),
                ],
                across,
                places,
            ),
            Chart(
                [(kind, None), ("device", DEVICE), ("hand, estimated" if snapshot.hand_estimated else "hand", HAND)],
                [Line(DEVICE, time, device, dot=True), Line(HAND, time, hand, dot=True)],
                across,
                self._forces(device, hand, [0.0]),
            ),
            self._gains(snapshot),
            Chart(
                [(f"speed [{unit}/s] over {name} [{unit}]", None)],
                [
                    *(Line(BOUNDARY, (wall, wall), speeds, True) for wall in walls),
                    Line(MEASURED, position, speed, dot=True),
                ],
                places,
                speeds,
            ),
        ]

    def _gains(self, snapshot: Snapshot) -> Chart:
        """Return the gains under their stability boundary; the verdict alone if a law states no gains."""
        margin = STABILITY.of(snapshot)
        colour = None if margin.stable is None else GOOD if margin.stable else BAD
        if not margin.axis:
            return Chart([(margin.words, colour)], [], (0.0, 1.0), (0.0, 1.0))
        factor, unit = (1.0, "N m/rad") if margin.axis.startswith("r") else (1e-3, "kN/m")
        boundary, stiffness = factor * margin.stiffnesses, factor * margin.stiffness
        width = max(float(margin.dampings.max(initial=0.0)), 1.1 * margin.damping, _LEAST_GAIN)
        height = max(float(boundary.max(initial=0.0)), 1.1 * stiffness, factor * _LEAST_GAIN)
        lines = [
            Line(BOUNDARY, margin.dampings, boundary),
            Line(colour or BOUNDARY, [margin.damping], [stiffness], dot=True),
        ]
        foot = f"{margin.axis}: {unit} over damping"
        return Chart([(margin.words, colour)], lines, (0.0, round_up(width)), (0.0, round_up(height)), foot)


class SteadyRange:
    """Range of a plot's axis that follows data without jitter.

    Args:
        least: Smallest span, in the data's unit.
    """

    def __init__(self, least: float) -> None:
        self._least = least
        self._last: tuple[float, float] | None = None

    def __call__(self, *values: ArrayLike) -> tuple[float, float]:
        """Return a range that holds all values.

        It is narrower than the last only if that is twice as wide.
        """
        found = fitted_range(np.concatenate([np.ravel(some) for some in values]), self._least)
        if found[0] < 0.0 < found[1]:  # alike on both sides, so that zero has the middle tick
            found = -max(-found[0], found[1]), max(-found[0], found[1])
        last = self._last
        if last is None or found[0] < last[0] or found[1] > last[1] or found[1] - found[0] <= 0.5 * (last[1] - last[0]):
            last = self._last = found
        return last


def fitted_range(values: Array, least: float) -> tuple[float, float]:
    """Return a range between multiples of a power of ten.

    That below its span.

    Args:
        values: Values that it holds; any number.
        least: Smallest span.
    """
    kept = values[np.isfinite(values)]
    low, high = (float(kept.min()), float(kept.max())) if kept.size else (0.0, 0.0)
    if (lack := least - (high - low)) > 0.0:
        low, high = low - 0.5 * lack, high + 0.5 * lack
    step = 10.0 ** np.floor(np.log10(high - low) + _ROUNDING)
    while True:
        bottom, top = (float(np.floor(low / step + _ROUNDING)), float(np.ceil(high / step - _ROUNDING)))
        if top - bottom < 10.0:
            return bottom * step, top * step
        step *= 10.0  # both ends rounded away beyond the next power


def round_up(value: float) -> float:
    """Return the next of 1, 2, 5 times 10^n."""
    step = 10.0 ** np.floor(np.log10(value))
    return float(next(step * size for size in (1.0, 2.0, 5.0, 10.0) if step * size >= 0.999 * value))


class Banner(NamedTuple):
    """Words over everything else.

    Attributes:
        text: What is the matter.
        way_on: Action that goes on; empty where there is none.
        bad: Whether something is wrong, and not only asked for.
        remedy: Way on where it is no action; empty otherwise.
    """

    text: str
    way_on: str
    bad: bool
    remedy: str = ""


def banner(snapshot: Snapshot) -> Banner | None:
    """Return the banner of a snapshot; None while running normally."""
    if snapshot.state == "stopped":
        return Banner(f"STOPPED: {snapshot.reason}", _known("centre", snapshot), True, snapshot.remedy)
    if snapshot.state == "paused":
        where = f", {snapshot.rewound:.1f} s back" if snapshot.rewound else ""
        where += "" if snapshot.duration is None else f": {snapshot.time:.3f} of {snapshot.duration:.3f} s"
        return Banner(f"PAUSED{where}", _known("pause", snapshot), False)
    if (line := snapshot.tour) is not None and line.done and line.number < line.total:
        return Banner("DONE", "next", False)
    if snapshot.late:
        text = "TOO SLOW: this machine cannot keep up, simulated time slows down"
        return Banner(text, _known("slower", snapshot), True)
    return None


def _known(action: str, snapshot: Snapshot) -> str:
    """Return an action if it has effect; else empty."""
    return action if action in snapshot.actions else ""


def pace(snapshot: Snapshot) -> str:
    """Return the pace of time; empty for real time."""
    if (scale := snapshot.time_scale) == 1.0:
        return ""
    return f"1/{1.0 / scale:.3g} of real time" if scale < 1.0 else f"{scale:.3g} times real time"


_LEAST_TORQUE = 1e-3
"""Below this no stop is met [N m]."""


class MetStops(NamedTuple):
    """Metal stops that push.

    Attributes:
        faces: Those along the axes: index into AXES, normal, edge [m].
        turning: Whether that of the rotation is one.
        words: Names them; empty where there is none.
    """

    faces: tuple[tuple[int, float, float], ...]
    turning: bool
    words: str


def met_stops(snapshot: Snapshot) -> MetStops:
    """Return the metal stops that the flotor is at."""
    pose, wrench = snapshot.pose, snapshot.stops
    faces, words = [], []
    for index in range(3):
        force = float(wrench[index])
        if abs(force) >= LEAST_FORCE:
            faces.append((index, float(np.sign(force)), float(pose[index])))
            words.append(
                f"{'-' if force > 0.0 else '+'}{AXES[index]} {abs(pose[index]) * 1e3:.1f} mm, {abs(force):.1f} N"
            )
    torque = float(np.linalg.norm(wrench[3:]))
    turning = torque >= _LEAST_TORQUE
    if turning:
        words.append(f"turned {np.degrees(np.linalg.norm(pose[3:])):.1f} deg, {torque:.2f} N m")
    return MetStops(tuple(faces), turning, f"metal stop: {'; '.join(words)}" if words else "")


_ROUNDED_ENERGY = 5e-5
FORCES = "hand", "device", "stops"
"""Names of the readings of forces."""


class Reading(NamedTuple):
    """One reading.

    Attributes:
        name: Its name; empty for a note.
        value: Its value in words, with the unit.
        colour: Colour of what it is about; None for none.
    """

    name: str
    value: str
    colour: Colour | None = None


def readings(snapshot: Snapshot, notes: Sequence[str] = ()) -> list[Reading]:
    """Return the readings of a session that say something, the most important first.

    Args:
        snapshot: The present snapshot.
        notes: Further notes, such as the last screenshot.
    """
    scene = snapshot.scene
    live = [one for one in scene.parameters() if one.live and one.live.has_keys and one.name not in DEVICES_OWN]
    on = [one.name for one in live if one.kind is bool and getattr(scene, one.name)]
    gains = [_gain(one, getattr(scene, one.name), scene.axis) for one in live if one.kind in (float, int)]
    whole = "" if snapshot.duration is None else f" of {snapshot.duration:.1f}"
    digits = 3 if snapshot.time_scale < 1.0 else 1
    place = 1e3 * snapshot.pose[:3].round(5) + 0.0
    rows = [
        Reading("scene", f"{scene.name}: {scene.describe()}"),
        *(Reading("", note) for note in (met_stops(snapshot).words, *snapshot.notes, *notes)),
        Reading("gains", "  ".join(gains)),
        _wall(snapshot),
        Reading("on", ", ".join(on) or "none" * any(one.kind is bool for one in live)),
        Reading("rate", f"{1.0 / scene.period:.0f} Hz, delay {scene.delay * 1e3:.1f} ms"),
        Reading("time", f"{snapshot.time:.{digits}f}{whole} s"),
        Reading("speed", pace(snapshot)),
        Reading("position", ", ".join(f"{name} {value:.2f}" for name, value in zip("xyz", place)) + " mm"),
        _force("hand", snapshot.hand, HAND, " (estimated)" * snapshot.hand_estimated),
        _force("device", snapshot.force, DEVICE),
        _force("stops", snapshot.stops, STOP),
        Reading("energy", _energy(snapshot), BAD if _makes_energy(snapshot) else None),
        Reading("tick", f"{snapshot.cost * 1e6:.0f} us, {snapshot.missed} missed" if snapshot.cost else ""),
    ]
    return [row for row in rows if row.value]


def _force(name: str, wrench: Array, colour: Colour, note: str = "") -> Reading:
    """Return a force's size, if known."""
    known = np.isfinite(wrench).all()
    return Reading(name, f"{np.linalg.norm(wrench[:3]):.1f} N{note}" if known else "", colour)


def _wall(snapshot: Snapshot) -> Reading:
    """Return the stability of the wall alone, if there is one."""
    wall = STABILITY.of(snapshot).wall
    if STABILITY.scene != snapshot.scene:
        return Reading("wall", "..." if snapshot.faces else "")
    return Reading("wall", str(wall or ""), BAD if wall and wall.spectral_radius >= 1.0 else None)


def _makes_energy(snapshot: Snapshot) -> bool:
    return snapshot.taken < -_ROUNDED_ENERGY


def _energy(snapshot: Snapshot) -> str:
    """Return the energy of the hand and of the computed forces, if known."""
    added = _makes_energy(snapshot)
    parts = {"hand gave": snapshot.work, f"device {'added' if added else 'took'}": abs(snapshot.taken)}
    words = ", ".join(f"{name} {value * 1e3:.1f} mJ" for name, value in parts.items() if not math.isnan(value))
    return f"{words}: its forces come late" if added else words


def _gain(one: Parameter, value: float | None, axis: str) -> str:
    """Return a gain as text, with its name if needed.

    Gains of a wall have no name.
    """
    if value is None:
        return f"{one.name} none"
    number = f"{value:.0f}" if abs(value) >= 1e3 else f"{value:.3g}"
    text = f"{number} {unit_of(one.unit, axis, one.along)}".strip()
    return text if one.name in ("stiffness", "damping") else f"{one.name} {text}"
