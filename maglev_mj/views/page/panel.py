"""The page's panel: banner, readings, actions, scene, parameters, cameras, and their inputs."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from functools import partial
from html import escape
from typing import Any

from maglev_mj.colours import BAD, GOOD, HAND, STOP, Colour, hex_of
from maglev_mj.frames import unit_of
from maglev_mj.parameters import Parameter
from maglev_mj.scenes import Scene
from maglev_mj.session import CHOOSES, DEVICES_OWN, EMERGENCY_STOP, KEPT, REWINDS, Snapshot
from maglev_mj.session.actions import actions
from maglev_mj.session.snapshot import TourLine
from maglev_mj.views.magnifier import MAGNIFICATIONS
from maglev_mj.views.page.stage import VIEWS, look, update
from maglev_mj.views.readings import FORCES, Banner, Reading, banner, readings, round_up

Ask = Callable[[str, Any], object]
"""Takes "act" and an action, or "change" and parameters."""

SETTLED = 1.0
"""Pause after a person's last change [s].

A control shows the value in force only then, since that comes back with a delay.
"""

_SHARES, _ROOM = 200.0, 2.5
_INSIDE = 1e-3
"""Distance from an excluded bound, a share of the default."""


class Control:
    """Input of the page for one value.

    Args:
        name: Name of the parameter.
        handle: viser's.
        ask: Told what a person wants.
    """

    def __init__(self, name: str, handle: Any, ask: Ask) -> None:
        self.name, self.handle, self._moved = name, handle, -math.inf

        async def moved(event: Any) -> None:
            if event.client is not None:  # a person's
                self._moved = time.monotonic()
                ask("change", {name: self.value(handle.value)})

        handle.on_update(moved)

    def show(self, value: Any) -> None:
        """Show the value in force.

        Not while a person is changing it.
        """
        if time.monotonic() - self._moved > SETTLED:
            update(self.handle, value=self.shown(value))

    def value(self, shown: Any) -> Any:
        """Convert an input's number into a parameter's value."""
        return shown

    def shown(self, value: Any) -> Any:
        """Convert a parameter's value into an input's number."""
        return value


class Choice(Control):
    """A choice among texts, or among numbers with their unit.

    Args:
        name: See `Control`.
        handle: See `Control`.
        ask: See `Control`.
        texts: Text for each value.
    """

    def __init__(
        self, name: str, handle: Any, ask: Ask, texts: Callable[[Any], str], values: Mapping[str, Any]
    ) -> None:
        self._texts, self._values = texts, dict(values)
        super().__init__(name, handle, ask)

    def value(self, shown: Any) -> Any:
        """See `Control`."""
        return self._values[shown]

    def shown(self, value: Any) -> str:
        """See `Control`.

        A value that is not among the choices is added to them.
        """
        text = self._texts(value)
        if text not in self._values:
            self._values[text] = value
            self.handle.options = tuple(self._values)
        return text


class Slider(Control):
    """Slider whose range grows up to the parameter's bounds.

    Args:
        gui: viser's.
        name: See `Control`.
        label: Its label.
        hint: Shown when the pointer rests on it.
        value: Value at first.
        bounds: Least and largest value that a person may choose.
        ask: See `Control`.
        scale: Shown for each unit of the value.
        room: A value that shall be in the range.
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
        room: float = 0.0,
    ) -> None:
        self._scale, (self._least, self._most) = scale, bounds
        most = self._top(max(abs(value), room)) * scale
        step = round_up(most / _SHARES)
        low = max(self._least * scale, -most)
        low = 0.0 if 0.0 <= low < step else low  # or every value would be odd by that much
        shown = min(max(value * scale, low), most)
        super().__init__(name, gui.add_slider(label, low, most, step, shown, hint=hint), ask)

    def value(self, shown: float) -> float:
        """See `Control`."""
        return min(max(shown / self._scale, self._least), self._most)

    def shown(self, value: float) -> float:
        """See `Control`."""
        shown = float(f"{value * self._scale:.12g}")
        if shown >= self.handle.max and value < self._most:
            update(self.handle, max=self._top(value) * self._scale)
        if shown < self.handle.min:
            update(self.handle, min=shown)
        return shown

    def _top(self, value: float) -> float:
        """Return a range's upper end, with room above a value."""
        return min(round_up(_ROOM * value) if value else 1.0, self._most)


def control(gui: Any, one: Parameter, scene: Scene, ask: Ask) -> Control | None:
    """Return an input for a live parameter.

    None for a parameter that programs alone set.
    """
    value, label, hint = getattr(scene, one.name), one.name.replace("_", " "), _hint(one, scene.axis)
    if one.kind is bool:
        return Control(one.name, gui.add_checkbox(label, value, hint=hint), ask)
    if one.kind is str and one.choices:
        handle = gui.add_dropdown(label, one.choices, initial_value=value, hint=hint)
        return Choice(one.name, handle, ask, str, {text: text for text in one.choices})
    if one.kind not in (float, int) or value is None or not one.live:
        return None
    if one.live.among:
        inverse, unit = one.live.inverse, "Hz" if one.live.inverse and one.unit == "s" else one.unit

        def text(value: float) -> str:
            return f"{1.0 / value if inverse else value:.4g} {unit}".strip()

        values = sorted({*(1.0 / each if inverse else each for each in one.live.among), value}, reverse=inverse)
        named = {text(each): each for each in values}
        handle = gui.add_dropdown(one.live.word or label, tuple(named), initial_value=text(value), hint=hint)
        return Choice(one.name, handle, ask, text, named)
    scale, unit = (1e3, "ms") if one.unit == "s" else (1.0, unit_of(one.unit, scene.axis, one.along))
    return Slider(
        gui,
        one.name,
        f"{label} [{unit}]" if unit else label,
        hint,
        value,
        _ends(one),
        ask,
        scale,
        abs(one.default) if isinstance(one.default, float | int) else 0.0,
    )


def _ends(one: Parameter) -> tuple[float, float]:
    """Return the least and largest value to choose.

    These are the parameter's bounds, or the limits of its keys.
    """
    assert one.live
    bounds, keys, inside = one.bounds, one.live, _INSIDE * abs(one.default or 1.0)
    least = max(bounds.get("at_least", -math.inf), bounds.get("above", -math.inf) + inside, keys.least)
    most = min(bounds.get("at_most", math.inf), bounds.get("below", math.inf) - inside, keys.most)
    return least, most


def _hint(one: Parameter, axis: str) -> str:
    """Return a parameter's description and allowed values."""
    unit = unit_of(one.unit, axis, one.along)
    words = [f"{word.replace('_', ' ')} {bound:g} {unit}".strip() for word, bound in one.bounds.items()]
    return ": ".join([one.help, " and ".join(words)]) if words else one.help


_ROWS = {
    "handle": ("centre", "drop", "record"),
    "time": ("pause", "step", "slower", "faster"),
    "replay": ("start", "step back", "end", "loop"),
    "rewind": REWINDS[1:],
    "skip": ("skip back", "skip forward"),
    "tour": ("back", "next"),
}
_USUAL_STIFFNESS, _MOST_STIFFNESS = 200.0, 5000.0  # of the hand [N/m]
_INPUTS = "gains", "active"
_MOTIONS = {f"x{factor}": factor for factor in MAGNIFICATIONS}
_PAUSED: Colour = (0.25, 0.28, 0.33)


class Panel:
    """Everything beside the scene but the plots.

    Args:
        server: viser's.
        snapshot: What is shown at first.
        ask: Told what a person wants.
        magnify: Told how far motion is magnified.
        settings: Whether parameters can be changed.
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
        self._followed: list[tuple[Control, Callable[[Snapshot], Any]]] = []
        self._time: Slider | None = None
        if snapshot.duration is not None:
            hint, bounds = "moment of the recording", (0.0, snapshot.duration)
            self._time = Slider(gui, "time", "time [s]", hint, snapshot.time, bounds, ask, room=snapshot.duration)
        elif snapshot.rewound is not None and settings:
            hint, bounds = "pauses, and shows the scene as it was before", (0.0, KEPT)
            self._time = Slider(gui, "rewind", "rewind [s]", hint, 0.0, bounds, ask, room=KEPT)
            self._time.handle.order = 1.1
        self._add_views()
        self.show(snapshot)

    def show(self, snapshot: Snapshot) -> None:
        """Show a snapshot."""
        if tuple(snapshot.actions) != self._actions:
            self._actions = tuple(snapshot.actions)
            self._make_buttons(snapshot)
        if type(snapshot.scene) is not self._scene:
            self._scene = type(snapshot.scene)
            self._make_controls(snapshot)
        update(self._banner, content=_banner(banner(snapshot), snapshot))
        update(self._words, content=_tour(snapshot.tour) + _words(snapshot, self._settings))
        for each, value in self._followed:
            each.show(value(snapshot))
        if self._time is not None:
            self._time.show(round(snapshot.time if snapshot.rewound is None else snapshot.rewound, 2))

    def _make_buttons(self, snapshot: Snapshot) -> None:
        """Make a button for each action without another control."""
        self._buttons.remove()
        self._buttons, known = self._gui.add_folder(None, order=1.0), snapshot.actions
        shown = {name for row in _ROWS.values() for name in row} | {
            EMERGENCY_STOP,
            "next scene",
            REWINDS[0],
            *actions(type(snapshot.scene)),
        }
        others = tuple(name for name in known if name not in shown and not name.startswith(CHOOSES))
        with self._buttons:
            for label, row in (_ROWS | {"more": others}).items():
                if there := tuple(name for name in row if name in known):
                    self._add_row(label, there)
            if EMERGENCY_STOP in known:
                stop = self._gui.add_button(EMERGENCY_STOP, color=tuple(round(255 * part) for part in BAD))
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
            "motion", tuple(_MOTIONS), order=4.1, hint="of the handle, as it is drawn"
        )
        self._motion.on_click(self._larger)

    async def _larger(self, _: Any) -> None:
        self._magnify(_MOTIONS.get(self._motion.value, 1))  # a browser may say anything

    def _make_controls(self, snapshot: Snapshot) -> None:
        """Make the controls of scene, live parameters and hand."""
        self._parameters.remove()
        self._followed, scene, gui = [], snapshot.scene, self._gui
        self._parameters = gui.add_folder(None, order=2.0)
        if not self._settings:
            return
        with self._parameters:
            names = [name.removeprefix(CHOOSES) for name in snapshot.actions if name.startswith(CHOOSES)]
            if scene.name in names:
                handle = gui.add_dropdown("scene", names, initial_value=scene.name, hint="starts it")
                choose = Choice("scene", handle, self._choose, str, {name: name for name in names})
                self._followed.append((choose, lambda snapshot: snapshot.scene.name))
            for one in sorted(scene.parameters(), key=lambda one: one.name in DEVICES_OWN):
                if one.live and (made := control(gui, one, scene, self._ask)) is not None:
                    self._followed.append((made, partial(_value, one.name)))
            hint, bounds = "of the spring from the pointer to the knob", (0.0, _MOST_STIFFNESS)
            hand = snapshot.hand_stiffness
            spring = Slider(gui, "hand_stiffness", "hand [N/m]", hint, hand, bounds, self._ask, room=_USUAL_STIFFNESS)
            self._followed.append((spring, lambda snapshot: snapshot.hand_stiffness))

    def _choose(self, _: str, given: Any) -> None:
        self._ask("act", CHOOSES + given["scene"])


def _value(name: str, snapshot: Snapshot) -> Any:
    return getattr(snapshot.scene, name)


def _banner(said: Banner | None, snapshot: Snapshot) -> str:
    """Return the banner as HTML."""
    if said is None:
        return ""
    way = f"press {said.way_on}" if said.way_on in snapshot.actions else snapshot.remedy
    style = f"background:{hex_of(BAD if said.bad else _PAUSED)};color:#fff;font-weight:600;padding:.5em .7em"
    return (
        f'<div role="alert" style="{style};border-radius:4px">{escape(said.text)}<br><small>{escape(way)}</small></div>'
    )


def _tour(step: TourLine | None) -> str:
    """Return the step of a guided tour as HTML."""
    if step is None:
        return ""
    text, deed = (escape(part) for part in step.words(_called))
    done = f' <b style="color:{hex_of(GOOD)}">done</b>' if step.done else ""
    style = f"border-left:4px solid {hex_of(GOOD if step.done else HAND)};margin:.3em .5em;padding:.2em .6em"
    head = f"<small>step {step.number} of {step.total}</small>{done}"
    return f'<div style="{style}">{head}<br>{text}<br><b>{deed}</b></div>'


def _called(name: str) -> str:
    """Return the input that triggers an action here."""
    if name == "hand":
        return "drag the knob"
    moved = name.removesuffix(" up").removesuffix(" down")
    return f"the slider {moved}" if moved != name else f"the button {name}"


def _words(snapshot: Snapshot, inputs: bool) -> str:
    """Return the session's readings as HTML, without the values that inputs show."""
    rows = [one for one in readings(snapshot) if not (inputs and one.name in _INPUTS)]
    forces = " ".join(_coloured(one) for one in rows if one.name in FORCES)
    lines = dict.fromkeys(forces if one.name in FORCES else _line(one) for one in rows)
    style = "font-size:.85em;line-height:1.45;padding:.2em .5em"
    return f'<div style="{style}">{"".join(f"<div>{line}</div>" for line in lines)}</div>'


def _line(one: Reading) -> str:
    value = escape(one.value)
    if not one.name:
        return f"<i>{value}</i>"
    if one.colour is not None:
        value = f'<b style="color:{hex_of(one.colour)}">{value}</b>'
    return f'<span style="opacity:.65">{one.name}</span> {value}'


def _coloured(one: Reading) -> str:
    return f'<span style="color:{hex_of(one.colour or STOP)}">&#9632;</span> {one.name} {one.value}'
