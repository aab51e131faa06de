"""The page's panel: banner, readings, actions, scene, parameters, cameras."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from html import escape
from typing import Any

from maglev_mj.colours import BAD, GOOD, HAND, STOP, Colour, hex_of
from maglev_mj.parameters import flag
from maglev_mj.session import DEVICES_OWN, EMERGENCY_STOP, Snapshot
from maglev_mj.session.changes import actions
from maglev_mj.session.snapshot import TourLine
from maglev_mj.views.page.controls import Ask, Choice, Control, Slider, control, update
from maglev_mj.views.page.stage import VIEWS, look
from maglev_mj.views.words import FORCES, Banner, Reading, banner, readings

_ROWS = {
    "handle": ("centre", "drop", "record"),
    "time": ("pause", "step", "slower", "faster"),
    "replay": ("start", "step back", "end", "loop"),
    "skip": ("skip back", "skip forward"),
    "tour": ("back", "next"),
}
_SCENE = "scene "
_USUAL_STIFFNESS, _MOST_STIFFNESS = 200.0, 5000.0  # of the hand [N/m]
_INPUTS = "gains", "on"
_FIXED = '.mantine-Paper-root[style*="position: fixed"]'
_SHEET = (
    f"<style>@media(max-width:36em){{{_FIXED}{{width:100%!important;max-height:48%!important}}"
    f'{_FIXED} div[style*="width: 20em"]{{width:100%!important}}}}</style>'
)
"""Style of the panel on a phone: a full-width sheet."""
_PAUSED: Colour = (0.25, 0.28, 0.33)


class Panel:
    """Everything beside the scene but the plots.

    Args:
        server: viser's.
        snapshot: What is shown at first.
        ask: Told what a person wants.
        settings: Whether parameters can be changed.
    """

    def __init__(self, server: Any, snapshot: Snapshot, ask: Ask, settings: bool) -> None:
        self._ask, self._settings = ask, flag("settings", settings)
        gui = self._gui = server.gui
        self._actions: tuple[str, ...] | None = None
        self._scene: Any = None
        self._banner, self._words = gui.add_html("", order=0.0), gui.add_html("", order=0.1)
        gui.add_html(_SHEET, order=9.0)
        self._buttons, self._parameters = gui.add_folder(None), gui.add_folder(None)
        self._followed: list[tuple[Control, Callable[[Snapshot], Any]]] = []
        self._time: Slider | None = None
        if snapshot.duration is not None:
            hint, bounds = "moment of the recording", (0.0, snapshot.duration)
            self._time = Slider(gui, "time", "time [s]", hint, snapshot.time, bounds, ask, room=snapshot.duration)
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
            self._time.show(round(snapshot.time, 2))

    def _make_buttons(self, snapshot: Snapshot) -> None:
        """Make a button for each action without another control."""
        self._buttons.remove()
        self._buttons, known = self._gui.add_folder(None, order=1.0), snapshot.actions
        shown = {name for row in _ROWS.values() for name in row} | {
            EMERGENCY_STOP,
            "next scene",
            *actions(type(snapshot.scene)),
        }
        others = tuple(name for name in known if name not in shown and not name.startswith(_SCENE))
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

    def _make_controls(self, snapshot: Snapshot) -> None:
        """Make the controls of scene, live parameters and hand."""
        self._parameters.remove()
        self._followed, scene, gui = [], snapshot.scene, self._gui
        self._parameters = gui.add_folder(None, order=2.0)
        if not self._settings:
            return
        with self._parameters:
            names = [name.removeprefix(_SCENE) for name in snapshot.actions if name.startswith(_SCENE)]
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
        self._ask("act", _SCENE + given["scene"])


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
