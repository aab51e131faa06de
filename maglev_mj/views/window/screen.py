"""Overlay of text, plots, labels and banner.

It is the same in a window and in a picture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeAlias

import glfw

from maglev_mj.colours import BAD, STOP, Colour
from maglev_mj.frames import AXES
from maglev_mj.lazy import mujoco
from maglev_mj.parameters import flag
from maglev_mj.scenes import Scene
from maglev_mj.session import EMERGENCY_STOP, Note, Snapshot
from maglev_mj.views.window.keys import AXIS, KEYS, help_rows, key_of
from maglev_mj.views.window.layout import Area, Font, Layout, arrange
from maglev_mj.views.window.overlay import status_rows
from maglev_mj.views.window.plots import Label, Plots, TimeBar
from maglev_mj.views.words import Banner, banner

_Text: TypeAlias = tuple[int, int, str, str]
"""Font, position in the picture, and two columns."""

_HELPS, _CHARTS = (glfw.KEY_F1, glfw.KEY_F2), (glfw.KEY_F3, glfw.KEY_F4)
_RED: Colour = (0.80, 0.05, 0.05)
_STOPS = "ESC: EMERGENCY STOP", "ESC: STOP", "ESC"
_LOW, _ROUND = 130, 12
_DARK: Colour = (0.05, 0.06, 0.08)
_WAYS = {"centre": "to start again", "pause": "to go on", "slower": "for slow motion", "next": "to go on"}


class Drawn(NamedTuple):
    """Items to be drawn over the scene.

    Attributes:
        figures: Rectangles and figures, the lowest first.
        texts: Text over them, in the form of the engine's viewer.
        layout: Positions of all parts.
    """

    figures: list[tuple[Any, Any]]
    texts: list[_Text]
    layout: Layout


class Screen:
    """Overlay of the scene with the user's choices.

    Args:
        keys: True if a user can press keys.
    """

    def __init__(self, *, keys: bool = True) -> None:
        self._plots, self._with_keys = Plots(), flag("keys", keys)
        self._stop, self._hint, self._back = Label(_RED), Label(_DARK, 0.85), Label(_DARK, 0.80)
        self._banner, self._bar = Label(BAD), TimeBar()
        self._late = Note()
        self._axis: int | None = None
        self._wanted: bool | None = None
        self._shown = False
        self._engine: set[int] = set()

    def wait(self, scene: Scene) -> None:
        """Wait until all data of the plots is computed."""
        self._plots.wait(scene)

    def press(self, action: str, scene: Scene) -> None:
        """Run a key's action on the screen itself."""
        if action == AXIS:
            self._axis = ((scene.axis_index if self._axis is None else self._axis) + 1) % len(AXES)
        elif action == KEYS:
            self._wanted = not self._shown

    def note_engine_key(self, code: int) -> None:
        """Track the help and charts of the engine's viewer.

        The viewer does not report them.
        """
        if code in (*_HELPS, *_CHARTS):
            self._engine ^= {code}

    def draw(self, snapshot: Snapshot, view: Area, scale: int, notes: Sequence[str] = ()) -> Drawn:
        """Return the items to be drawn.

        Args:
            snapshot: The present snapshot.
            view: Area of the scene.
            scale: Scale of the engine's letters, 100 to 300 [%].
            notes: Further text for the user.
        """
        if snapshot.late:
            self._late.say("late")
        said = banner(replace(snapshot, late=bool(self._late.lines)))  # ticks are given up now and then: no flicker
        # the mouse is the hand, except in a recording and on a device, which have a hand of their own
        mouse = snapshot.duration is None and snapshot.state != "flying"
        layout = arrange(
            view,
            scale,
            status_rows(snapshot, notes),
            help_rows(snapshot.actions, hand=mouse) if self._with_keys else [],
            banner=said is not None,
            label=self._with_keys and EMERGENCY_STOP in snapshot.actions,
            shown=self._wanted if self._with_keys else False,
            helped=bool(self._engine & {*_HELPS}),
            charted=bool(self._engine & {*_CHARTS}),
        )
        self._shown = layout.keys is not None
        low = bool(layout.plots) and layout.plots[0].height < _LOW * 0.01 * scale
        figures = list(zip(layout.plots, self._plots.update(snapshot, self._axis, low=low), strict=False))
        texts: list[_Text] = []
        grids = mujoco.mjtGridPos
        for words, grid in ((layout.status, grids.mjGRID_TOPLEFT), (layout.keys, grids.mjGRID_BOTTOMLEFT)):
            if words is not None:
                figures.append((words.area, self._back.update("")))
                fonts = mujoco.mjtFont
                font = fonts.mjFONT_BIG if words.font.large else fonts.mjFONT_NORMAL
                first, second = ("\n".join(column) for column in zip(*words.rows, strict=True))
                texts.append((int(font), int(grid), first, second))
        if snapshot.duration is not None:
            layout, bar = _parted(layout, 2 * Font(scale).row)
            figures.append((bar, self._bar.update(snapshot)))
        if layout.label is not None:
            room = layout.label.width - Font(scale).row
            text = next((text for text in _STOPS if Font(scale).width(text) <= room), "")
            figures.append((layout.label, self._stop.update(text)))
        if layout.hint is not None:
            figures.append((layout.hint, self._hint.update("F11: KEYS")))
        if said is not None:
            heads, why = _said(said, snapshot)
            middle, letters, strip = int(view.centre[0]), Font(scale, large=True), layout.banner
            half = min(middle - strip.left, strip.right - middle) - _ROUND
            head = next((head for head in heads if letters.width(head) <= 2 * half), "")
            self._banner.paint(BAD if said.bad else STOP)
            figures.append((layout.banner, self._banner.update("" if head else heads[0], why)))
            if head:
                texts.append((int(mujoco.mjtFont.mjFONT_BIG), int(grids.mjGRID_TOP), head, ""))
        return Drawn([(mujoco.MjrRect(*area), figure) for area, figure in figures], texts, layout)


def _said(said: Banner, snapshot: Snapshot) -> tuple[list[str], str]:
    """Return a banner's headings and its reason.

    The headings name the key to continue, in decreasing length.
    """
    title, _, why = said.text.partition(": ")
    way = key_of(said.way_on, snapshot.actions) if said.way_on else ""
    heads = [f"{title}: press {way} {_WAYS[said.way_on]}", f"{title}: press {way}"] if way else [title]
    return heads, ". ".join(part for part in (why, said.remedy) if part)


def _parted(layout: Layout, high: int) -> tuple[Layout, Area]:
    """Return a layout with room for a time bar.

    The room is taken from the handle's area; the area of the bar is returned too.
    """
    area = layout.handle
    handle = area._replace(bottom=area.bottom + high, height=max(area.height - high, 1))
    return replace(layout, handle=handle), area._replace(height=high)
