"""Page inputs for the live parameters of a scene."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from maglev_mj.frames import unit_of
from maglev_mj.parameters import Parameter
from maglev_mj.scenes import Scene
from maglev_mj.views.charts import round_up

Ask = Callable[[str, Any], object]
"""Takes "act" and an action, or "change" and parameters."""

SETTLED = 1.0
"""Pause after a person's last change [s].

A control shows the value in force only then, since that comes back with a delay.
"""

_SHARES, _ROOM = 200.0, 2.5
_INSIDE = 1e-3
"""Distance from an excluded bound, a share of the default."""


def update(handle: Any, **properties: Any) -> None:
    """Set the properties of viser's element that differ.

    viser would send the others to every browser again.
    """
    for name, value in properties.items():
        if not np.array_equal(getattr(handle, name), value):
            setattr(handle, name, value)


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


class Switch(Control):
    """A checkbox."""


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
        return Switch(one.name, gui.add_checkbox(label, value, hint=hint), ask)
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
    made = Slider(
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
    return made


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
