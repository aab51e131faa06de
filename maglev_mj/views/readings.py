"""Readings, banner and charts of a session, shared by window and page."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.colours import BAD, BOUNDARY, DEVICE, FIRST, GOOD, HAND, MEASURED, PULL, STUCK, Colour
from maglev_mj.control.timeline import peak_wrenches
from maglev_mj.frames import AXES, Array, unit_of
from maglev_mj.parameters import Parameter
from maglev_mj.plants.shapes import MIN_ARROW_FORCE, Face
from maglev_mj.scenes import Scene
from maglev_mj.session import SHOWN, Snapshot, settable_parameters
from maglev_mj.session import snapshot as columns
from maglev_mj.session.margin import STABILITY, measured_delay
from maglev_mj.theory.loop import Loop
from maglev_mj.views.forces import STRIP_SPAN, Strip, controller_of, force_text, forces, state_words
from maglev_mj.views.forces import strip as magnified

_ROUNDING = 1e-6
_LEAST_GAIN = 1e-3
_LEAST_TIME = 0.2  # time axis of a run that has just begun [s]

Range: TypeAlias = tuple[float, float]


class Curve(NamedTuple):
    """One line of a chart.

    Attributes:
        colour: Colour of the line.
        x: Horizontal coordinates, (N,).
        y: Vertical coordinates, (N,); gaps where not finite.
        dashed: True for a dashed line.
        dot: True to mark the last point.
    """

    colour: Colour
    x: ArrayLike
    y: ArrayLike
    dashed: bool = False
    dot: bool = False


class Chart(NamedTuple):
    """One chart.

    Attributes:
        title: Parts of the title with their colours; None for the text colour.
        lines: Lines, the last one on top; empty for a title alone.
        across: Limits of the horizontal axis.
        up: Limits of the vertical axis.
        foot: Label of the horizontal axis; empty for a title alone.
        side: Label of the vertical axis; empty if it is the title.
    """

    title: Sequence[tuple[str, Colour | None]]
    lines: Sequence[Curve]
    across: Range
    up: Range
    foot: str = ""
    side: str = ""


class Charts:
    """Charts of one axis of a session over the last seconds.

    Args:
        points: Largest number of points of a line.
    """

    def __init__(self, points: int) -> None:
        self._points, self._axis, self._strip_axis = points, -1, -1

    def of(self, snapshot: Snapshot, axis: int) -> list[Chart]:
        """Return the charts of position, force, stability map and phase plane; see `strip` for a magnified wall.

        Args:
            snapshot: The snapshot.
            axis: Index into AXES.
        """
        if axis != self._axis:
            self._axis, self._positions, self._speeds = axis, SteadyRange(2.0), SteadyRange(20.0)
            self._forces = SteadyRange(0.02 if axis > 2 else 2.0)
        rows, first = snapshot.history, snapshot.first
        past = rows[-1, 0] - rows[0, 0] if len(rows) else 0.0
        now = rows[-1, 0] if len(rows) else 0.0
        peaks = peak_wrenches(rows[:, columns.DEVICE], rows[:, columns.PULSE], rows[:, columns.WIDTH])[:, axis]
        time, hand = rows[:, 0] - now, rows[:, columns.HAND][:, axis]
        pulsed = "device peak" if rows[:, columns.WIDTH].any() else "device"
        all_positions, points = 1e3 * rows[:, columns.POSE][:, axis], self._points
        rows = rows[:: -max(-(-len(rows) // points), 1)][::-1]  # keeps the newest
        position, speed = 1e3 * rows[:, columns.POSE][:, axis], 1e3 * rows[:, columns.TWIST][:, axis]
        walls = [edge * 1e3 for index, _, edge in snapshot.faces if index == axis]
        across = -round_up(min(max(past, _LEAST_TIME), SHOWN)), 0.0
        positions, speeds = self._positions(all_positions, walls, 1e3 * first[:, 1 + axis]), self._speeds(speed)
        name, unit = AXES[axis], unit_of("mm", axis)
        place = f"{'angle about' if axis > 2 else 'position along'} {name[-1]} [{unit}]"
        kind = f"{'torque about' if axis > 2 else 'force along'} {name[-1]} [{unit_of('N', axis)}]"
        original = Curve(FIRST, first[:, 0] - now, 1e3 * first[:, 1 + axis], dot=True)
        run = Curve(MEASURED, *outline(time, all_positions, points), dot=True)
        pulls = [
            Curve(colour, *outline(time, values, points), dot=True)
            for colour, values in ((DEVICE, peaks), (HAND, hand))
        ]
        heights = [Curve(BOUNDARY, across, (wall, wall), dashed=True) for wall in walls]
        edges = [Curve(BOUNDARY, (wall, wall), speeds, dashed=True) for wall in walls]
        phase = Curve(MEASURED, position, speed, dot=True)
        title = [(place, MEASURED), *[("walls", None)] * bool(walls), *[("first attempt", FIRST)] * bool(len(first))]
        legend = [(kind, None), (pulsed, DEVICE), ("hand, estimated" if snapshot.hand_estimated else "hand", HAND)]
        return [
            Chart(title, [*heights, original, run], across, positions, "time [s]"),
            Chart(legend, pulls, across, self._forces(peaks, hand, [0.0]), "time [s]"),
            self._gains(snapshot),
            Chart([(f"velocity, {name} [{unit}/s]", None)], [*edges, phase], positions, speeds, place),
        ]

    def strip(self, snapshot: Snapshot, span: float = STRIP_SPAN) -> list[Chart]:
        """Return the charts of a `Strip`: position from the wall's edge, and the force that acts beside the ideal one.

        Empty without samples, or while nothing is rendered.

        Args:
            snapshot: The snapshot.
            span: Longest time span [s].
        """
        strip = magnified(snapshot, span) if acts(snapshot) else None
        return [] if strip is None else self.of_strip(strip)

    def of_strip(self, strip: Strip) -> list[Chart]:
        """Return the charts of a `Strip`; see `strip`."""
        axis, ideal = strip.axis, np.isfinite(strip.ideal).any()
        if axis != self._strip_axis:
            least = 0.02 if axis > 2 else 1.0
            self._strip_axis, self._depths, self._pulls = axis, SteadyRange(0.02, centred=False), SteadyRange(least)
        across, name = (-round_up(max(-float(strip.time[0]), 1e-3)), 0.0), AXES[axis]
        place = 1e3 * (strip.position - strip.edge)
        switches, steps = np.append(strip.switches, 0.0).repeat(2)[1:-1], strip.force.repeat(2)
        origin = "the wall's edge" if strip.normal else "the stick position" if strip.sticks else "the mean"
        kind = f"{'torque' if axis > 2 else 'force'}, {name} [{unit_of('N', axis)}]"
        pulls = [Curve(BOUNDARY, strip.time, strip.ideal)] * bool(ideal) + [Curve(DEVICE, switches, steps)]
        ground = [Curve(STUCK if strip.sticks else BOUNDARY, across, (0.0, 0.0), dashed=True)]
        run = Curve(MEASURED, strip.time, place, dot=True)
        title = [(f"{name} from {origin} [{unit_of('mm', axis)}]", MEASURED)]
        legend = [(kind, None), ("acts", DEVICE), *[("ideal", None)] * bool(ideal)]
        finite = strip.ideal[np.isfinite(strip.ideal)]
        return [
            Chart(title, [*ground, run], across, self._depths(place, [0.0]), "time [s]"),
            Chart(legend, pulls, across, self._pulls(steps, finite, [0.0]), "time [s]"),
        ]

    def _gains(self, snapshot: Snapshot) -> Chart:
        """Return the stability map; the verdict alone if a law states no gains."""
        status, margin = law_status(snapshot), STABILITY.of(snapshot)
        title = [(status.value, status.colour)]
        if (loop := margin.loop) is None or not acts(snapshot):
            return Chart(title, [], (0.0, 1.0), (0.0, 1.0))
        axis = loop.axis
        factor, prefix = (1.0, "") if axis.startswith("r") else (1e-3, "k")
        dampings, stiffnesses = margin.boundary
        boundary, stiffness = factor * stiffnesses, factor * loop.stiffness
        width = max(float(dampings.max(initial=0.0)), 1.1 * loop.damping, _LEAST_GAIN)
        height = max(float(boundary.max(initial=0.0)), 1.1 * stiffness, factor * _LEAST_GAIN)
        here = Curve(margin.colour or BOUNDARY, [loop.damping], [stiffness], dot=True)
        (wall, damper), parts = gain_parts(snapshot.scene, loop)
        x, y = [damper, loop.damping], [factor * wall, stiffness]
        own = [Curve(PULL, x, y, dashed=True), Curve(PULL, x[:1], y[:1], dot=True)] if parts else []
        lines = [Curve(BOUNDARY, dampings, boundary), *own, here]
        foot, side = f"damping [{unit_of('N s/m', axis)}], {axis}", f"stiffness [{prefix}{unit_of('N/m', axis)}]"
        return Chart(title, lines, (0.0, round_up(width)), (0.0, round_up(height)), foot, side)


def outline(time: Array, values: Array, points: int) -> tuple[Array, Array]:
    """Return times and values of at most `points` samples that keep every extreme, and the newest sample.

    Of each group of consecutive samples the smallest and the largest are kept, so that a pulse of one sample is drawn.

    Args:
        time: Times [s], (N,).
        values: Values, (N,).
        points: Number of points, at least 4.
    """
    if len(time) <= points:
        return time, values
    group = -(-len(time) // ((points - 1) // 2))
    starts = range(0, len(time), group)
    extremes = {first + int(pick(values[first : first + group])) for first in starts for pick in (np.argmin, np.argmax)}
    kept = sorted(extremes | {len(time) - 1})
    return time[kept], values[kept]


_GAIN_WORDS = {"contact": "wall", "always": "centring", "stuck": "friction"}


def gain_parts(scene: Scene, loop: Loop) -> tuple[tuple[float, float], str]:
    """Return stiffness and damping of the wall in a loop of several laws, and the sum of its stiffness in words.

    Returns:
        Stiffness [N/m, N m/rad] and damping; words such as "wall 6000 + centring 300 N/m", empty for one law.
    """
    controller, axis = controller_of(scene), AXES.index(loop.axis) if loop.axis in AXES else -1
    sums: dict[str, Array] = {}
    for law in () if controller is None or axis < 0 else controller.laws:
        for near in law.gains() or ():
            if near.state in ("always", *loop.state) and (near.stiffness[axis] or near.damping[axis]):
                sums[near.state] = sums.get(near.state, 0.0) + np.array([near.stiffness[axis], near.damping[axis]])
    stiff = {state: gains for state, gains in sums.items() if gains[0]}
    if len(stiff) < 2 or "contact" not in stiff:
        return (loop.stiffness, loop.damping), ""
    names = sorted(stiff, key=list(_GAIN_WORDS).index)
    digits = "{} {:.0f}" if axis < 3 else "{} {:.3g}"
    words = " + ".join(digits.format(_GAIN_WORDS[state], stiff[state][0]) for state in names)
    wall = stiff["contact"].tolist()
    return (wall[0], wall[1]), f"{words} {unit_of('N/m', loop.axis)}"


class SteadyRange:
    """Axis range that follows data without jitter.

    Args:
        least: Smallest span, in the unit of the data.
        centred: True to centre zero if the data have both signs.
    """

    def __init__(self, least: float, *, centred: bool = True) -> None:
        self._least, self._centred, self._last = least, centred, (math.inf, -math.inf)

    def __call__(self, *values: ArrayLike) -> Range:
        """Return a range that contains all values.

        It shrinks only when half of the last range is enough.
        """
        low, high = fitted_range(np.concatenate([np.ravel(array) for array in values]), self._least)
        if self._centred and low < 0.0 < high:  # symmetric, so that zero is the middle tick
            low, high = -max(-low, high), max(-low, high)
        bottom, top = self._last
        if low < bottom or high > top or high - low <= 0.5 * (top - bottom):
            self._last = low, high
        return self._last


def fitted_range(values: Array, least: float) -> Range:
    """Return a range whose ends are multiples of the power of ten below its span.

    Args:
        values: Values to contain; any number.
        least: Smallest span.
    """
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 0.0)
    if (lack := least - (high - low)) > 0.0:
        low, high = low - 0.5 * lack, high + 0.5 * lack
    step = 10.0 ** np.floor(np.log10(high - low) + _ROUNDING)
    while True:
        bottom, top = (float(np.floor(low / step + _ROUNDING)), float(np.ceil(high / step - _ROUNDING)))
        if top - bottom < 10.0:
            return bottom * step, top * step
        step *= 10.0  # rounding both ends outward passed the next power of ten


def round_up(value: float) -> float:
    """Return the next larger of 1, 2, 5 times 10^n."""
    step = 10.0 ** np.floor(np.log10(value))
    return float(next(step * size for size in (1.0, 2.0, 5.0, 10.0) if step * size >= 0.999 * value))


class Banner(NamedTuple):
    """Banner above all other elements.

    Attributes:
        text: State and reason.
        resume_action: Action that resumes; empty for none.
        bad: True for a problem, False for a state that the user asked for.
        remedy: Advice where no action resumes; empty otherwise.
    """

    text: str
    resume_action: str
    bad: bool
    remedy: str = ""


def banner(snapshot: Snapshot) -> Banner | None:
    """Return the banner of a snapshot; None while running normally."""
    step = snapshot.tour
    if snapshot.state == "stopped":
        content = Banner(f"STOPPED: {snapshot.reason}", "centre", True, snapshot.remedy)
    elif snapshot.state == "paused":
        position = f", {snapshot.rewound:.1f} s back" if snapshot.rewound else ""
        position += "" if snapshot.duration is None else f": {snapshot.time:.3f} of {snapshot.duration:.3f} s"
        content = Banner(f"PAUSED{position}", "pause", False)
    elif step is not None and step.done and step.number < step.total:
        content = Banner("DONE", "next", False)
    elif snapshot.overloaded:
        content = Banner("Running slower than real time", "slower", True)
    else:
        return None
    return content if content.resume_action in snapshot.actions else content._replace(resume_action="")


RESUME = {"centre": "to restart", "pause": "to resume", "slower": "for slow motion", "next": "to continue"}
"""Purpose of each action that a banner names."""


def acts(snapshot: Snapshot) -> bool:
    """Return True while the scene's laws act, or would but for a pause."""
    return not snapshot.idle and snapshot.state != "stopped"


def law_status(snapshot: Snapshot) -> ReadingRow:
    """Return the verdict on the scene's laws; why they do not act otherwise, without a colour."""
    if not acts(snapshot):
        return ReadingRow("margin", snapshot.idle or "stopped: nothing is rendered")
    margin = STABILITY.of(snapshot)
    return ReadingRow("margin", margin.words, margin.colour)


def _loop_words(snapshot: Snapshot) -> str:
    loop = STABILITY.of(snapshot).loop if acts(snapshot) else None
    return "" if loop is None else gain_parts(snapshot.scene, loop)[1]


_WARM = 0.8
"""Share of a coil's temperature limit from which the strip of a device warns."""


def device_strip(snapshot: Snapshot) -> ReadingRow | None:
    """Return address and state of the device, and the colour of their strip; None for a simulation.

    The name is "DEVICE", or "SIMULATED DEVICE" for a twin.
    """
    device = snapshot.device
    if device is None:
        return None
    wall = getattr(snapshot.scene, "stiffness", None)
    wall = wall if snapshot.faces and isinstance(wall, int | float) and acts(snapshot) else None
    asked = "" if math.isnan(device.requested) else f" of {device.requested:.0f}"
    parts = [
        device.phase,
        "" if (delay := measured_delay(snapshot)) is None else f"loop {delay * 1e3:.1f} ms",
        "" if math.isnan(device.warmth) else f"coils {100.0 * device.warmth:.0f} % of limit",
        "" if wall is None else f"wall {wall:.0f}{asked} N/m",
    ]
    colour = BAD if snapshot.state == "stopped" or device.warmth > _WARM else PULL if snapshot.idle else GOOD
    name = "SIMULATED DEVICE" if device.simulated else "DEVICE"
    return ReadingRow(name, f"{device.address}: {', '.join(filter(None, parts))}", colour)


def pace(snapshot: Snapshot) -> str:
    """Return the ratio of simulated to real time; empty for real time."""
    if (scale := snapshot.time_scale) == 1.0:
        return ""
    return f"1/{1.0 / scale:.3g} of real time" if scale < 1.0 else f"{scale:.3g}x real time"


_LEAST_TORQUE = 1e-3
"""Threshold of contact with the rotation stop [N m]."""


def stop_contacts(snapshot: Snapshot) -> tuple[list[Face], str]:
    """Return the contacts of the flotor with the metal stops.

    Returns:
        Faces in contact, one with the first rotation for the rotation stop; their description, empty without contact.
    """
    pose, faces, words = snapshot.pose, list[Face](), []
    for index, force in enumerate(snapshot.stops[:3].tolist()):
        if abs(force) >= MIN_ARROW_FORCE:
            faces.append((index, math.copysign(1.0, force), float(pose[index])))
            side = f"{'-' if force > 0.0 else '+'}{AXES[index]}"
            words.append(f"{side} {abs(pose[index]) * 1e3:.1f} mm, {abs(force):.1f} N")
    if (torque := float(np.linalg.norm(snapshot.stops[3:]))) >= _LEAST_TORQUE:
        faces.append((3, 1.0, 0.0))
        words.append(f"rotation {np.degrees(np.linalg.norm(pose[3:])):.1f} deg, {torque:.2f} N m")
    return faces, f"metal stop: {'; '.join(words)}" if words else ""


_LEAST_ENERGY = 5e-5
GROUPS: Mapping[str, Sequence[str]] = {
    "felt": ("hand", "device", "margin", "loop", "state", "speed"),
    "scene": ("wall", "wall_on", "pulse", "stiffness", "damping"),
    "friction": ("friction", "breakaway"),
    "loop": ("period", "delay", "weightless"),
    "numbers": ("gains", "active", "rate", "time", "position", "scene", "tick", "energy"),
}
"""Readings (first and last group) and live parameters by group, in the order of window and page.

Energy is last, as its number of lines varies.
"""


def grouped(parameters: Iterable[Parameter]) -> dict[str, list[Parameter]]:
    """Return live parameters by group in the order of GROUPS; "scene" contains those of other names."""
    groups: dict[str, list[Parameter]] = {name: [] for name in [*GROUPS][1:-1]}
    for item in filter(lambda item: item.live, parameters):
        groups[next((name for name in groups if item.name in GROUPS[name]), "scene")].append(item)
    return {name: items for name, items in groups.items() if items}


class ReadingRow(NamedTuple):
    """One reading.

    Attributes:
        name: Name; empty for a note.
        value: Value as text, with its unit.
        colour: Colour; None for the text colour.
    """

    name: str
    value: str
    colour: Colour | None = None


def readings(snapshot: Snapshot, notes: Sequence[str] = ()) -> list[ReadingRow]:
    """Return the readings of a session that have a value.

    Args:
        snapshot: The present snapshot.
        notes: Additional notes, such as the file of a screenshot.
    """
    scene = snapshot.scene
    settable = [scene.parameter(name) for name in settable_parameters(scene)]
    live = [item for item in settable if item.live and item.live.has_keys]
    enabled = [item.name for item in live if item.kind is bool and getattr(scene, item.name)]
    enabled += [f"{item.name.replace('_', ' ')} {getattr(scene, item.name)}" for item in live if item.choices]
    gains = [_gain(item, getattr(scene, item.name), scene.axis) for item in live if item.kind in (float, int)]
    total = "" if snapshot.duration is None else f" of {snapshot.duration:.1f}"
    digits = 3 if snapshot.time_scale < 1.0 else 1
    position = 1e3 * snapshot.pose[:3].round(5) + 0.0
    measured = measured_delay(snapshot)
    delay = scene.delay if measured is None else measured  # the one of the margin
    active, felt = snapshot.taken < -_LEAST_ENERGY, forces(snapshot)
    laws = [
        ReadingRow("gains", "  ".join(gains)),
        ReadingRow("active", ", ".join(enabled) or "none" * any(item.kind is bool for item in live)),
        ReadingRow("rate", f"{1.0 / scene.period:.0f} Hz, delay {1e3 * delay:.1f} ms"),
    ]
    strip = device_strip(snapshot)
    rows = [
        ReadingRow("scene", "" if snapshot.idle else f"{scene.name}: {scene.describe()}"),
        law_status(snapshot),
        ReadingRow("loop", _loop_words(snapshot)),
        *([] if strip is None else [strip]),
        ReadingRow("state", state_words(snapshot), STUCK),
        *(ReadingRow("", note) for note in (stop_contacts(snapshot)[1], *snapshot.notes, *notes)),
        *([] if snapshot.idle else laws),
        ReadingRow("time", f"{snapshot.time:.{digits}f}{total} s"),
        ReadingRow("speed", pace(snapshot)),
        ReadingRow("position", ", ".join(f"{name} {value:.2f}" for name, value in zip("xyz", position)) + " mm"),
        ReadingRow(
            "hand", (text := force_text(felt["hand"])) + " (estimated)" * bool(text and snapshot.hand_estimated)
        ),
        ReadingRow("device", force_text(felt["device"])),
        ReadingRow("energy", _energy(snapshot, active), BAD if active else None),
        ReadingRow("tick", f"{snapshot.cost * 1e6:.0f} us, {snapshot.missed} skipped" if snapshot.cost else ""),
    ]
    return [row for row in rows if row.value]


def _energy(snapshot: Snapshot, active: bool) -> str:
    parts = {"from the hand": snapshot.work, "generated" if active else "absorbed": abs(snapshot.taken)}
    parts["in motion, height and stops"] = snapshot.work - snapshot.taken
    millis = {name: 1e3 * round(value, 4) + 0.0 for name, value in parts.items() if not math.isnan(value)}
    words = ", ".join(f"{value:.1f} mJ {name}" for name, value in millis.items())
    return f"{words} (delayed forces)" if active else words


def _gain(parameter: Parameter, value: float | None, axis: str) -> str:
    """Return a gain as text; stiffness and damping are recognised by their units."""
    if value is None:
        return f"{parameter.name} none"
    number = f"{value:.0f}" if abs(value) >= 1e3 else f"{value:.3g}"
    text = f"{number} {unit_of(parameter.unit, axis, parameter.along)}".strip()
    return text if parameter.name in ("stiffness", "damping") else f"{parameter.name} {text}"
