"""Panel of the page: banner, readings, actions, scene, parameters, cameras."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from html import escape
from typing import Any

from maglev_mj.colours import BAD, GOOD, HAND, STOP, Colour, hex_of, on_page, on_white
from maglev_mj.frames import unit_of
from maglev_mj.parameters import Parameter
from maglev_mj.scenes import Scene
from maglev_mj.session import DEVICE_PARAMETERS, EMERGENCY_STOP, MAX_REWIND, REWIND_ACTIONS, SCENE_PREFIX, Snapshot
from maglev_mj.session.actions import actions
from maglev_mj.session.snapshot import TourLine
from maglev_mj.views.magnifier import MAGNIFICATIONS
from maglev_mj.views.page.stage import VIEWS, look, update
from maglev_mj.views.readings import FORCES, RESUME, Banner, Reading, banner, readings, round_up

Ask = Callable[[str, Any], object]
"""Request of a user: "act" and an action, or "change" and parameters."""

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
        handle: See `Control`.
        ask: See `Control`.
        texts: Function that returns the text of a value.
        values: Value of each text.
    """

    def __init__(
        self, name: str, handle: Any, ask: Ask, texts: Callable[[Any], str], values: Mapping[str, Any]
    ) -> None:
        self._texts, self._values = texts, dict(values)
        super().__init__(name, handle, ask)

    def value(self, displayed: Any) -> Any:
        """See `Control`."""
        return self._values[displayed]

    def to_input(self, value: Any) -> str:
        """See `Control`; a new value is added to the list."""
        text = self._texts(value)
        if text not in self._values:
            self._values[text] = value
            self.handle.options = tuple(self._values)
        return text


class Slider(Control):
    """Slider whose track extends to any value that its box or a program sets.

    Args:
        gui: viser's GUI.
        name: See `Control`.
        label: Label.
        hint: Tooltip.
        value: Initial value.
        bounds: Initial limits of the track.
        ask: See `Control`.
        scale: Displayed number per unit of the value.
        reference: Value that the initial range includes.
    """

    def __init__(
        self,
        gui: Any,
        name: str,
        label: str,
        hint: str,
        value: float,
        bounds: tuple[float, float],
        ask: Ask,
        scale: float = 1.0,
        reference: float = 0.0,
    ) -> None:
        self._scale, (lower, self._upper) = scale, bounds
        high = self._top(max(abs(value), reference)) * scale
        step = round_up(high / _STEPS)
        low = max(lower * scale, -high)
        low = 0.0 if 0.0 <= low < step else low  # else every value is offset by it
        initial = min(max(value * scale, low), high)
        handle = gui.add_slider(label, low, high, step, initial, hint=hint)
        handle.precision = _DECIMALS
        super().__init__(name, handle, ask)

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
    value, label, hint = getattr(scene, item.name), item.name.replace("_", " "), _hint(item, scene.axis)
    if item.kind is bool:
        return Control(item.name, gui.add_checkbox(label, value, hint=hint), ask)
    if item.kind is str and item.choices:
        handle = gui.add_dropdown(label, item.choices, initial_value=value, hint=hint)
        return Choice(item.name, handle, ask, str, {text: text for text in item.choices})
    if item.kind not in (float, int) or value is None or not item.live:
        return None
    if item.live.among:
        inverse, unit = item.live.inverse, "Hz" if item.live.inverse and item.unit == "s" else item.unit

        def text(value: float) -> str:
            return f"{1.0 / value if inverse else value:.4g} {unit}".strip()

        values = sorted({*(1.0 / entry if inverse else entry for entry in item.live.among), value}, reverse=inverse)
        choices = {text(entry): entry for entry in values}
        handle = gui.add_dropdown(item.live.word or label, tuple(choices), initial_value=text(value), hint=hint)
        return Choice(item.name, handle, ask, text, choices)
    scale, unit = (1e3, "ms") if item.unit == "s" else (1.0, unit_of(item.unit, scene.axis, item.along))
    return Slider(
        gui,
        item.name,
        f"{label} [{unit}]" if unit else label,
        hint,
        value,
        _limits(item),
        ask,
        scale,
        abs(item.default) if isinstance(item.default, float | int) else 0.0,
    )


def _limits(item: Parameter) -> tuple[float, float]:
    """Return the initial limits of a slider's track: the parameter's bounds, or the limits of its keys."""
    assert item.live
    bounds, keys = item.bounds, item.live
    lower = max(bounds.get("at_least", -math.inf), bounds.get("above", -math.inf), keys.least)
    return lower, min(bounds.get("at_most", math.inf), bounds.get("below", math.inf), keys.most)


def _hint(item: Parameter, axis: str) -> str:
    """Return a parameter's description and bounds."""
    unit = unit_of(item.unit, axis, item.along)
    bounds = [f"{word.replace('_', ' ')} {bound:g} {unit}".strip() for word, bound in item.bounds.items()]
    return f"{item.help} ({', '.join(bounds)})" if bounds else item.help


_ROWS = {
    "handle": ("centre", "drop", "record"),
    "time": ("pause", "step", "slower", "faster"),
    "replay": ("start", "step back", "end", "loop"),
    "rewind": REWIND_ACTIONS[1:],
    "skip": ("skip back", "skip forward"),
    "tour": ("back", "next"),
}
_MAX_STIFFNESS = 5000.0  # of the hand [N/m]
_INPUTS = "gains", "active"
_MOTIONS = {f"x{factor}": factor for factor in MAGNIFICATIONS}
_PAUSED: Colour = (0.25, 0.28, 0.33)


class Panel:
    """Panel beside the scene: banner, readings, buttons and controls.

    Args:
        server: viser's server.
        snapshot: Initial snapshot.
        ask: Called with the user's requests.
        magnify: Called with the magnification of the handle's motion.
        settings: True to let the user change parameters.
    """

    def __init__(
        self, server: Any, snapshot: Snapshot, ask: Ask, magnify: Callable[[float], object], settings: bool
    ) -> None:
        self._ask, self._magnify, self._settings = ask, magnify, settings
        gui = self._gui = server.gui
        self._actions: tuple[str, ...] | None = None
        self._scene: Any = None
        self._banner, self._words = gui.add_html("", order=0.0), gui.add_html("", order=0.1)
        self._buttons, self._parameters = gui.add_folder(None), gui.add_folder(None)
        self._controls: list[tuple[Control, Callable[[Snapshot], Any]]] = []
        self._time: Slider | None = None
        if snapshot.duration is not None:
            hint, bounds = "time in the recording", (0.0, snapshot.duration)
            self._time = Slider(gui, "time", "time [s]", hint, snapshot.time, bounds, ask, reference=snapshot.duration)
        elif snapshot.rewound is not None and settings:
            hint, bounds = "time before now; pauses the scene", (0.0, MAX_REWIND)
            self._time = Slider(gui, "rewind", "rewind [s]", hint, 0.0, bounds, ask, reference=MAX_REWIND)
            self._time.handle.order = 1.1
        self._add_views()
        self.show(snapshot)

    def show(self, snapshot: Snapshot) -> None:
        """Show a snapshot."""
        available = tuple(name for name in snapshot.actions if snapshot.rewound or name not in REWIND_ACTIONS[1:])
        if available != self._actions:
            self._actions = available
            self._make_buttons(snapshot, available)
        if type(snapshot.scene) is not self._scene:
            self._scene = type(snapshot.scene)
            self._make_controls(snapshot)
        update(self._banner, content=_banner(banner(snapshot), snapshot))
        update(self._words, content=_tour(snapshot.tour) + _words(snapshot, self._settings))
        for control, value in self._controls:
            control.show(value(snapshot))
        if self._time is not None:
            self._time.show(round(snapshot.time if snapshot.rewound is None else snapshot.rewound, 2))

    def _make_buttons(self, snapshot: Snapshot, available: Sequence[str]) -> None:
        """Add a button for each action without another control."""
        self._buttons.remove()
        self._buttons = self._gui.add_folder(None, order=1.0)
        placed = {name for row in _ROWS.values() for name in row} | {
            EMERGENCY_STOP,
            "next scene",
            REWIND_ACTIONS[0],
            *actions(type(snapshot.scene)),
        }
        others = tuple(name for name in available if name not in placed and not name.startswith(SCENE_PREFIX))
        with self._buttons:
            for label, row in (_ROWS | {"more": others}).items():
                if names := tuple(name for name in row if name in available):
                    self._add_row(label, names)
            if EMERGENCY_STOP in available:
                stop = self._gui.add_button(EMERGENCY_STOP, color=tuple(round(255 * part) for part in on_white(BAD)))
                stop.on_click(partial(self._act, lambda: EMERGENCY_STOP))

    def _add_row(self, label: str, names: tuple[str, ...]) -> None:
        row = self._gui.add_button_group(label, names)
        row.on_click(partial(self._act, lambda: row.value))

    async def _act(self, name: Callable[[], str], _: Any) -> None:
        self._ask("act", name())

    def _add_views(self) -> None:
        views = self._gui.add_button_group("camera", tuple(VIEWS), order=4.0)

        async def chosen(event: Any) -> None:
            look(event.client, views.value)

        views.on_click(chosen)
        self._motion = self._gui.add_button_group(
            "motion", tuple(_MOTIONS), order=4.1, hint="magnification of the displayed motion"
        )
        self._motion.on_click(self._set_motion)

    async def _set_motion(self, _: Any) -> None:
        self._magnify(_MOTIONS.get(self._motion.value, 1))  # untrusted input

    def _make_controls(self, snapshot: Snapshot) -> None:
        """Add the controls of scene, live parameters and hand."""
        self._parameters.remove()
        self._controls, scene, gui = [], snapshot.scene, self._gui
        self._parameters = gui.add_folder(None, order=2.0)
        if not self._settings:
            return
        with self._parameters:
            names = [name.removeprefix(SCENE_PREFIX) for name in snapshot.actions if name.startswith(SCENE_PREFIX)]
            if scene.name in names:
                handle = gui.add_dropdown("scene", names, initial_value=scene.name, hint="scene to start")
                choose = Choice("scene", handle, self._choose, str, {name: name for name in names})
                self._controls.append((choose, lambda snapshot: snapshot.scene.name))
            for item in sorted(scene.parameters(), key=lambda item: item.name in DEVICE_PARAMETERS):
                if item.live and (added := control(gui, item, scene, self._ask)) is not None:
                    self._controls.append((added, partial(_value, item.name)))
            hint, bounds = "stiffness of the spring between pointer and knob", (0.0, _MAX_STIFFNESS)
            hand, usual = snapshot.hand_stiffness, Snapshot.hand_stiffness
            spring = Slider(gui, "hand_stiffness", "hand [N/m]", hint, hand, bounds, self._ask, reference=usual)
            self._controls.append((spring, lambda snapshot: snapshot.hand_stiffness))

    def _choose(self, _: str, values: Any) -> None:
        self._ask("act", SCENE_PREFIX + values["scene"])


def _value(name: str, snapshot: Snapshot) -> Any:
    return getattr(snapshot.scene, name)


def _banner(content: Banner | None, snapshot: Snapshot) -> str:
    """Return the banner as HTML."""
    if content is None:
        return ""
    action = content.resume_action
    advice = f"press {action} {RESUME[action]}" if action in snapshot.actions else snapshot.remedy
    style = (
        f"background:{hex_of(on_white(BAD) if content.bad else _PAUSED)};color:#fff;font-weight:600;padding:.5em .7em"
    )
    texts = f"{escape(content.text)}<br><small>{escape(advice)}</small>"
    return f'<div role="alert" style="{style};border-radius:4px">{texts}</div>'


def _tour(step: TourLine | None) -> str:
    """Return the step of a guided tour as HTML."""
    if step is None:
        return ""
    text, task = (escape(part) for part in step.words(_input_name))
    done = f' <b style="color:{on_page(GOOD)}">done</b>' if step.done else ""
    style = f"border-left:4px solid {on_page(GOOD if step.done else HAND, 3.0)};margin:.3em .5em;padding:.2em .6em"
    head = f"<small>step {step.number} of {step.total}</small>{done}"
    return f'<div style="{style}">{head}<br>{text}<br><b>{task}</b></div>'


def _input_name(name: str) -> str:
    """Return the name of the input that triggers an action."""
    if name == "hand":
        return "drag the knob"
    parameter = name.removesuffix(" up").removesuffix(" down")
    return f"the slider {parameter}" if parameter != name else f"the button {name}"


def _words(snapshot: Snapshot, inputs: bool) -> str:
    """Return the readings as HTML, without those that inputs show."""
    rows = [row for row in readings(snapshot) if not (inputs and row.name in _INPUTS)]
    forces = " ".join(_coloured(row) for row in rows if row.name in FORCES)
    lines = dict.fromkeys(forces if row.name in FORCES else _line(row) for row in rows)
    style = "font-size:.85em;line-height:1.45;padding:.2em .5em"
    return f'<div style="{style}">{"".join(f"<div>{line}</div>" for line in lines)}</div>'


def _line(row: Reading) -> str:
    value = escape(row.value)
    if not row.name:
        return f"<i>{value}</i>"
    if row.colour is not None:
        value = f'<b style="color:{on_page(row.colour)}">{value}</b>'
    return f'<span style="opacity:.65">{row.name}</span> {value}'


def _coloured(row: Reading) -> str:
    return f'<span style="color:{on_page(row.colour or STOP, 3.0)}">&#9632;</span> {row.name} {row.value}'
