"""Panels of the page: banner, forces, verdict, actions, scene, parameters, cameras, readings; plots."""

from __future__ import annotations

import math
import textwrap
import time
from collections.abc import Callable, Iterable
from contextlib import nullcontext
from functools import partial
from html import escape
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.colours import BAD, BOUNDARY, DEVICE, GOOD, HAND, PULL, STUCK, Colour, hex_of, on_page, on_white
from maglev_mj.frames import AXES, unit_of
from maglev_mj.parameters import Parameter
from maglev_mj.scenes import Scene
from maglev_mj.session import EMERGENCY_STOP, MAX_REWIND, REWIND_ACTIONS, SCENE_PREFIX, Snapshot
from maglev_mj.session.snapshot import TourLine
from maglev_mj.views.forces import averaging_time, force_text, forces, is_halted, state_words
from maglev_mj.views.page.stage import VIEWS, look, rgb, update
from maglev_mj.views.readings import (
    GROUPS,
    RESUME,
    Chart,
    Charts,
    Range,
    banner,
    device_strip,
    grouped,
    readings,
    round_up,
)

Ask = Callable[[str, Any], object]
"""Request of a user: "act" and an action, or "change" and parameters."""

Add = Callable[..., Any]

SETTLED = 1.0
"""Time after a user's last change before a control shows the current value again [s], longer than its round trip."""

_STEPS, _HEADROOM, _DECIMALS = 200.0, 2.5, 9


class Control:
    """Input for one value.

    Args:
        name: Name of the parameter.
        handle: viser's handle of the input.
        ask: Called with the user's requests.
    """

    def __init__(self, name: str, handle: Any, ask: Ask) -> None:
        self.name, self.handle, self._moved = name, handle, -math.inf

        async def moved(event: Any) -> None:
            if event.client is not None:  # by a user
                self._moved = time.monotonic()
                ask("change", {name: self.value(handle.value)})

        handle.on_update(moved)

    def show(self, value: Any) -> None:
        """Show the current value, unless the user is changing it."""
        if time.monotonic() - self._moved > SETTLED:
            update(self.handle, value=self.to_input(value))

    def value(self, displayed: Any) -> Any:
        """Convert the input's value to the parameter's."""
        return displayed

    def to_input(self, value: Any) -> Any:
        """Convert the parameter's value to the input's."""
        return value


class Choice(Control):
    """Drop-down list of texts, or of numbers with their unit.

    Args:
        name: See `Control`.
        add: Function that adds the list: `add_dropdown` with label and tooltip.
        value: Initial value.
        values: All values.
        ask: See `Control`.
        text: Function that returns the text of a value.
    """

    def __init__(
        self, name: str, add: Add, value: Any, values: Iterable[Any], ask: Ask, text: Callable[[Any], str] = str
    ) -> None:
        self._text, self._values = text, {text(entry): entry for entry in values}
        super().__init__(name, add(tuple(self._values), initial_value=text(value)), ask)

    def value(self, displayed: Any) -> Any:
        """See `Control`."""
        return self._values[displayed]

    def to_input(self, value: Any) -> str:
        """See `Control`; a new value is added to the list."""
        text = self._text(value)
        if text not in self._values:
            self._values[text] = value
            self.handle.options = tuple(self._values)
        return text


class Slider(Control):
    """Slider whose track extends to any value that its box or a program sets.

    Args:
        name: See `Control`.
        add: Function that adds the slider: `add_slider` with label and tooltip.
        value: Initial value.
        bounds: Initial limits of the track.
        ask: See `Control`.
        scale: Displayed number per unit of the value.
        usual: Value that the initial range includes.
    """

    def __init__(
        self, name: str, add: Add, value: float, bounds: Range, ask: Ask, scale: float = 1.0, usual: float = 0.0
    ) -> None:
        self._scale, (lower, self._upper) = scale, bounds
        high = self._top(max(abs(value), usual)) * scale
        step = round_up(high / _STEPS)
        low = max(lower * scale, -high)
        low = 0.0 if 0.0 <= low < step else low  # else every value is offset by it
        super().__init__(name, add(low, high, step, min(max(value * scale, low), high)), ask)
        self.handle.precision = _DECIMALS

    def value(self, displayed: float) -> float:
        """See `Control`."""
        return displayed / self._scale

    def to_input(self, value: float) -> float:
        """See `Control`."""
        displayed = float(f"{value * self._scale:.12g}")
        if displayed >= self.handle.max:
            update(self.handle, max=self._top(value) * self._scale)
        if displayed < self.handle.min:
            update(self.handle, min=displayed)
        return displayed

    def _top(self, value: float) -> float:
        """Return the upper limit of a range with headroom above a value."""
        return min(round_up(_HEADROOM * value) if value else 1.0, max(self._upper, value))


def control(gui: Any, item: Parameter, scene: Scene, ask: Ask) -> Control | None:
    """Return an input for a live parameter; None for one that only programs set."""
    value, label = getattr(scene, item.name), item.name.replace("_", " ")
    unit = unit_of(item.unit, scene.axis, item.along)
    limits = [f"{word.replace('_', ' ')} {bound:g} {unit}".strip() for word, bound in item.bounds.items()]
    hint = f"{item.help} ({', '.join(limits)})" if limits else item.help
    if item.kind is bool:
        return Control(item.name, gui.add_checkbox(label, value, hint=hint), ask)
    if item.kind is str and item.choices:
        return Choice(item.name, partial(gui.add_dropdown, label, hint=hint), value, item.choices, ask)
    if item.kind not in (float, int) or value is None or not item.live:
        return None
    keys, bounds = item.live, item.bounds
    if keys.among:
        inverse, rate = keys.inverse, "Hz" if keys.inverse and item.unit == "s" else item.unit

        def text(value: float) -> str:
            return f"{1.0 / value if inverse else value:.4g} {rate}".strip()

        values = sorted({*(1.0 / entry if inverse else entry for entry in keys.among), value}, reverse=inverse)
        add = partial(gui.add_dropdown, keys.word or label, hint=hint)
        return Choice(item.name, add, value, values, ask, text)
    scale, unit = (1e3, "ms") if item.unit == "s" else (1.0, unit)
    whole = unit.replace(" ", "\N{NO-BREAK SPACE}")  # no line break inside
    add = partial(gui.add_slider, f"{label} [{whole}]" if unit else label, hint=hint)
    usual = item.default or value  # of a derived default
    usual = abs(usual) if isinstance(usual, float | int) else 0.0
    lower = max(bounds.get("at_least", -math.inf), bounds.get("above", -math.inf), keys.least)
    upper = min(bounds.get("at_most", math.inf), bounds.get("below", math.inf), keys.most)
    return Slider(item.name, add, value, (lower, upper), ask, scale, usual)


_ROWS = {
    "tour": ("back", "next"),  # at its text
    "handle": ("centre", "drop", "record"),
    "time": ("pause", "step", "slower", "faster"),
    "replay": ("start", "step back", "end", "loop"),
    "rewind": REWIND_ACTIONS[1:],
    "skip": ("skip back", "skip forward"),
}
_MAX_STIFFNESS = 5000.0  # of the hand [N/m]
_INPUTS = "gains", "active", "rate"
_FULL = 10.0
"""Force of a full bar [N], above that of the mouse's hand."""
_BAR = "position:relative;flex:1;height:14px;border-radius:4px;overflow:hidden;background:rgba(128,128,128,.22)"
_STRIP = "color:#fff;font-size:.9em;padding:.4em .7em;margin:0 .6em .4em;border-radius:4px"
_PAUSED: Colour = (0.25, 0.28, 0.33)


class Panel:
    """Panel beside the scene: what is felt, buttons and controls; folders for all other controls and readings.

    Args:
        server: viser's server.
        snapshot: Initial snapshot.
        ask: Called with the user's requests.
        settings: True to let the user change parameters.
    """

    def __init__(self, server: Any, snapshot: Snapshot, ask: Ask, settings: bool) -> None:
        self._ask, self._settings = ask, settings
        gui = self._gui = server.gui
        self._scene: Any = None
        self._banner, self._gauge, self._verdict = (gui.add_html("", order=0.1 * index) for index in range(1, 4))
        self._device = gui.add_html("", order=0.0)
        self._buttons, self._parameters = gui.add_folder(None, order=1.0), gui.add_folder(None)
        self._rows: dict[str, Any] = {}
        self._controls: list[tuple[Control, Callable[[Snapshot], Any]]] = []
        self._time: Slider | None = None
        name, hint, end = "time", "time in the recording", snapshot.duration
        if settings and snapshot.rewound is not None:
            name, hint, end = "rewind", "time before now; pauses the scene", MAX_REWIND
        if end is not None:
            add = partial(gui.add_slider, f"{name} [s]", hint=hint, order=1.1)
            self._time = Slider(name, add, 0.0, (0.0, end), ask, usual=end)
        if EMERGENCY_STOP in snapshot.actions:
            stop = gui.add_button(EMERGENCY_STOP, color=rgb(on_white(BAD)), order=1.05)
            stop.on_click(partial(self._act, lambda: EMERGENCY_STOP))
        views = gui.add_button_group("camera", tuple(VIEWS), order=3.0)

        async def chosen(event: Any) -> None:
            look(event.client, views.value)

        views.on_click(chosen)
        self.show(snapshot)

    def show(self, snapshot: Snapshot) -> None:
        """Show a snapshot."""
        self._show_buttons(snapshot)
        if type(snapshot.scene) is not self._scene:
            self._scene = type(snapshot.scene)
            self._make_controls(snapshot)
        update(self._device, content=_device(snapshot))
        update(self._banner, content=_banner(snapshot))
        update(self._gauge, content=_gauge(snapshot))
        update(self._verdict, content=_verdict(snapshot))
        update(self._words, content=_words(snapshot, self._settings))
        for control, value in self._controls:
            control.show(value(snapshot))
        if self._time is not None:
            self._time.show(round(snapshot.time if snapshot.rewound is None else snapshot.rewound, 2))

    def _show_buttons(self, snapshot: Snapshot) -> None:
        """Show a button for each action without another control; rows are changed in place, which keeps the focus."""
        hidden = set() if snapshot.rewound else {*REWIND_ACTIONS[1:]}
        for order, (label, row) in enumerate(_ROWS.items()):
            names = tuple(name for name in row if name in snapshot.actions and name not in hidden)
            if names and label not in self._rows:
                with self._buttons:
                    row = self._rows[label] = self._gui.add_button_group(label, names, order=order)
                row.on_click(partial(self._act, partial(getattr, row, "value")))
            elif label in self._rows:
                update(self._rows[label], options=names, visible=bool(names))

    async def _act(self, name: Callable[[], str], _: Any) -> None:
        self._ask("act", name())

    def _make_controls(self, snapshot: Snapshot) -> None:
        """Add the controls of scene, live parameters, hand and display."""
        self._parameters.remove()
        self._controls, scene, gui = [], snapshot.scene, self._gui
        self._parameters = gui.add_folder(None, order=2.0)
        names = [name.removeprefix(SCENE_PREFIX) for name in snapshot.actions if name.startswith(SCENE_PREFIX)]
        with self._parameters:
            if self._settings and scene.name in names:
                add = partial(gui.add_dropdown, "scene", hint="scene to start")
                choose: Ask = lambda _, values: self._ask("act", SCENE_PREFIX + values["scene"])  # noqa: E731
                choice = Choice("scene", add, scene.name, names, choose)
                self._controls.append((choice, lambda snapshot: snapshot.scene.name))
            for group, items in (grouped(scene.parameters()) if self._settings else {}).items():
                with nullcontext() if group == "scene" else gui.add_folder(group, expand_by_default=False):
                    for item in items:
                        if (added := control(gui, item, scene, self._ask)) is not None:
                            self._controls.append((added, attrgetter(f"scene.{item.name}")))
            if self._settings:
                hint, usual = "stiffness of the spring between pointer and knob", Snapshot.hand_stiffness
                with gui.add_folder("hand", expand_by_default=False):
                    add, bounds = partial(gui.add_slider, "hand [N/m]", hint=hint), (0.0, _MAX_STIFFNESS)
                    spring = Slider("hand_stiffness", add, usual, bounds, self._ask, usual=usual)
                self._controls.append((spring, attrgetter("hand_stiffness")))
            with gui.add_folder("numbers", expand_by_default=False):
                self._words = gui.add_html("")


def _banner(snapshot: Snapshot) -> str:
    """Return the banner as HTML."""
    if (content := banner(snapshot)) is None:
        return ""
    action = content.resume_action
    advice = f"press {action} {RESUME[action]}" if action else content.remedy
    ground = hex_of(on_white(BAD) if content.bad else _PAUSED)
    style = f"background:{ground};color:#fff;font-weight:600;margin:0 .6em .4em;padding:.5em .7em;border-radius:4px"
    return f'<div role="alert" style="{style}">{escape(content.text)}<br><small>{escape(advice)}</small></div>'


def _tour(step: TourLine | None) -> str:
    """Return the step of a guided tour as HTML."""
    if step is None:
        return ""
    text, task = (escape(part) for part in step.words(_input_name))
    done = f' <b style="color:{on_page(GOOD)}">done</b>' if step.done else ""
    style = f"margin:.3em .5em;padding:0 .6em;border-left:4px solid {on_page(GOOD if step.done else HAND, 3.0)}"
    head = f"<small>step {step.number} of {step.total}</small>{done}"
    return f'<div style="{style};font-size:.9em;line-height:1.4">{head}<br>{text}<br><b>{task}</b></div>'


def _input_name(name: str) -> str:
    """Return the name of the input that triggers an action."""
    if name == "hand":
        return "drag the knob"
    parameter = name.removesuffix(" up").removesuffix(" down")
    return f"the slider {parameter}" if parameter != name else f"the button {name}"


def _gauge(snapshot: Snapshot) -> str:
    """Return the forces of hand and device as bars: mean, and band of the extremes; state of hand and friction."""
    hand, bars = "hand, estimated" if snapshot.hand_estimated else "hand", ""
    for force, label, colour in zip(forces(snapshot).values(), (hand, "device"), (HAND, DEVICE)):
        if not (text := force_text(force)):
            continue
        shade, (first, *more) = on_page(colour, 3.0), label.split(", ")
        name = ", ".join([f"{first} |F|", *more])
        low, mean, high = (100.0 * min(size / _FULL, 1.0) for size in (force.least, force.size, force.most))
        band = f"left:{low:.1f}%;width:{max(high - low, 0.0):.1f}%;background:{shade};opacity:.4;inset-block:0"
        number = f"width:5.2em;text-align:right;line-height:1.1;color:{on_page(colour)}"
        bars += (
            f'<div role="meter" aria-label="{label}, force [N]" aria-valuemin="0" aria-valuemax="{_FULL:g}" '
            f'aria-valuenow="{min(force.size, _FULL):.0f}" aria-valuetext="{text}" '
            f'style="display:flex;align-items:center;gap:.5em;margin-bottom:.2em">'
            f'<span style="width:5.6em;line-height:1.1">{name}</span>'
            f'<div style="{_BAR}">'
            f'<div style="width:{mean:.1f}%;background:{shade};height:100%"></div>'
            f'<div style="position:absolute;{band}"></div></div><span style="{number}">'
            f'<b style="font-size:20px">{force.size:.1f} N</b><br><small>peak {force.most:.1f} N</small></span></div>'
        )
    if bars:
        words = f"mean and range over {averaging_time(snapshot):.2g} s; arrows: mean"
        words = "no force; plots and strip show the last one" if is_halted(snapshot) else words
        bars += f'<div style="font-size:.78em;opacity:.7">{words}</div>'
    state = f'<b style="color:{on_page(STUCK)}">{escape(state_words(snapshot))}</b>'
    return f'<div class="gauge" style="padding:.2em .75em 0">{bars}<div style="min-height:1.5em">{state}</div></div>'


def _device(snapshot: Snapshot) -> str:
    """Return the strip of a device as HTML; empty for a simulation."""
    if (strip := device_strip(snapshot)) is None:
        return ""
    name, words, colour = strip
    style = f"background:{hex_of(on_white(colour or PULL))};{_STRIP}"
    return f'<div class="device" data-name="{name}" style="{style}"><b>{name}</b> {escape(words)}</div>'


def _verdict(snapshot: Snapshot) -> str:
    """Return stability, notes, speed and the step of a tour as HTML, which the page's script has announced."""
    lines = "".join(_line(*row) for row in readings(snapshot) if row.name in ("margin", "loop", "", "speed"))
    style = "padding:.1em .75em .4em;min-height:3em"  # for a note that comes and goes
    return f'<div class="verdict" style="{style}">{lines}{_tour(snapshot.tour)}</div>'


def _words(snapshot: Snapshot, inputs: bool) -> str:
    """Return the other readings as HTML, without those that inputs show."""
    rows = {row.name: row for row in readings(snapshot) if not (inputs and row.name in _INPUTS)}
    lines = "".join(_line(*rows[name]) for name in GROUPS["numbers"] if name in rows)
    return f'<div style="font-size:.85em;line-height:1.45;padding:.2em .5em">{lines}</div>'


def _line(name: str, value: str, colour: Colour | None) -> str:
    text = escape(value) if colour is None else f'<b style="color:{on_page(colour)}">{escape(value)}</b>'
    label = "" if name in ("margin", "loop", "") else f'<span style="opacity:.65">{name}</span> '
    return f"<div>{label}{text}</div>"


_WIDTH, _HEIGHT = 320, 160
_LEFT, _RIGHT, _TOP, _BOTTOM = 44, 12, 20, 34
_TICKS, _POINTS = 4, 200
_GRID = "rgba(128,128,128,.28)"


def drawn(chart: Chart) -> str:
    """Return a chart as SVG; only its title if it has no lines."""
    title, lines, across, up, foot, side = chart
    if not lines:
        return f'<p class="chart" style="margin:.5em">{escape(textwrap.shorten(title[0][0], 300))}</p>'
    right, bottom = _WIDTH - _RIGHT, _HEIGHT - _BOTTOM
    area = f'x="{_LEFT}" y="{_TOP}" width="{right - _LEFT}" height="{bottom - _TOP}"'
    words = "".join(f'<tspan{_fill(colour)} font-weight="600">{escape(text)} </tspan>' for text, colour in title)
    inside, outside = "", f'<text x="4" y="13">{words}</text>'
    for value in ticks(*across):
        place = float(_between(value, across, _LEFT, right))
        inside += f'<path d="M{place:.1f} {_TOP}V{bottom}" stroke="{_GRID}"/>'
        outside += f'<text x="{place:.1f}" y="{bottom + 15}" text-anchor="middle">{value:g}</text>'
    for value in ticks(*up):
        place = float(_between(value, up, bottom, _TOP))
        inside += f'<path d="M{_LEFT} {place:.1f}H{right}" stroke="{_GRID}"/>'
        outside += f'<text x="{_LEFT - 4}" y="{place + 4:.1f}" text-anchor="end">{value:g}</text>'
    for line in lines:
        x, y = _between(line.x, across, _LEFT, right), _between(line.y, up, bottom, _TOP)
        points = " ".join(f"{px:.1f},{py:.1f}" for px, py in zip(x, y) if np.isfinite(py))
        style = f'stroke="{on_page(line.colour, 3.0)}" stroke-width="1.6"' + ' stroke-dasharray="4 3"' * line.dashed
        inside += f'<polyline points="{points}" fill="none" {style}/>'
        if line.dot and len(x) and _LEFT <= x[-1] <= right and _TOP <= y[-1] <= bottom:  # whole, above the frame
            outside += f'<circle cx="{x[-1]:.1f}" cy="{y[-1]:.1f}" r="4"{_fill(line.colour, 3.0)}/>'
    turned = f"translate(11 {(_TOP + bottom) // 2}) rotate(-90)"
    for text, place_of in ((foot, f"translate({(_LEFT + right) // 2} {_HEIGHT - 5})"), (side, turned)):
        outside += f'<text transform="{place_of}" text-anchor="middle">{escape(text)}</text>'
    return (
        f'<svg class="chart" viewBox="0 0 {_WIDTH} {_HEIGHT}" style="width:100%;display:block" font-size="11" '
        f'font-family="system-ui,sans-serif" fill="currentColor">'
        f'<svg {area} viewBox="{_LEFT} {_TOP} {right - _LEFT} {bottom - _TOP}">{inside}</svg>'
        f'<rect {area} fill="none" stroke="{on_page(BOUNDARY, 3.0)}"/>{outside}</svg>'
    )


def ticks(low: float, high: float) -> list[float]:
    """Return about four round numbers between two limits."""
    step = 10.0 ** np.floor(np.log10((high - low) / _TICKS))
    step *= next(size for size in (1.0, 2.0, 2.5, 5.0, 10.0) if size * step * (_TICKS + 1) >= high - low)
    return [float(np.round(count * step, 12)) for count in range(int(np.ceil(low / step)), int(high / step) + 1)]


def _fill(colour: Colour | None, contrast: float = 4.5) -> str:
    return "" if colour is None else f' fill="{on_page(colour, contrast)}"'


def _between(value: ArrayLike, ends: Range, first: int, last: int) -> Any:
    """Return pixel coordinates of values [px]."""
    return first + (np.asarray(value) - ends[0]) / (ends[1] - ends[0]) * (last - first)


class Plots:
    """Four plots of one axis.

    Args:
        gui: viser's GUI, inside the container of the plots.
        scene: Scene with the initial axis.
    """

    def __init__(self, gui: Any, scene: Scene) -> None:
        self._charts, self._type = Charts(_POINTS), type(scene)
        self._axis = gui.add_dropdown("axis", AXES, initial_value=scene.axis, hint="plot axis")
        self._plots = [gui.add_html("") for _ in range(4)]

    def show(self, snapshot: Snapshot) -> None:
        """Show a snapshot."""
        if type(snapshot.scene) is not self._type:
            self._type, self._axis.value = type(snapshot.scene), snapshot.scene.axis
        axis = self._axis.value if self._axis.value in AXES else snapshot.scene.axis  # untrusted input
        charts = self._charts.of(snapshot, AXES.index(axis))
        for plot, chart in zip(self._plots, charts, strict=True):
            update(plot, content=drawn(chart))
