"""What a key does to the settings of a session."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from maglev_mj.scenes import Settings

__all__ = ["CHANGES"]

_RATES = (50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0)
_GAIN_STEP = 1.25
_DELAY_STEP = 0.0005
_MOST_STIFFNESS, _LEAST_STIFFNESS, _MOST_DAMPING, _LEAST_DAMPING = 1e5, 100.0, 1e3, 1.0
_MOST_DELAY = 0.02


def _gain(name: str, factor: float, least: float, most: float) -> Callable[[Settings], Settings]:
    def change(settings: Settings) -> Settings:
        # three figures are what a person reads and sets again
        value = float(f"{getattr(settings, name) * factor:.3g}")
        return Settings.from_json({**settings.as_json(), name: min(max(value, least), most)})

    return change


def _rate(step: int) -> Callable[[Settings], Settings]:
    def change(settings: Settings) -> Settings:
        now = 1.0 / settings.period
        nearest = min(range(len(_RATES)), key=lambda place: abs(_RATES[place] - now))
        place = min(max(nearest + step, 0), len(_RATES) - 1)
        return replace(settings, period=1.0 / _RATES[place])

    return change


def _delay(step: int) -> Callable[[Settings], Settings]:
    def change(settings: Settings) -> Settings:
        count = round(settings.delay / _DELAY_STEP) + step
        return replace(settings, delay=min(max(count * _DELAY_STEP, 0.0), _MOST_DELAY))

    return change


def _toggle(name: str) -> Callable[[Settings], Settings]:
    return lambda settings: Settings.from_json({**settings.as_json(), name: not getattr(settings, name)})


CHANGES: Mapping[str, Callable[[Settings], Settings]] = {
    "wall": _toggle("wall"),
    "pulse": _toggle("pulse"),
    "friction": _toggle("friction"),
    "stiffness up": _gain("stiffness", _GAIN_STEP, _LEAST_STIFFNESS, _MOST_STIFFNESS),
    "stiffness down": _gain("stiffness", 1.0 / _GAIN_STEP, _LEAST_STIFFNESS, _MOST_STIFFNESS),
    "damping up": _gain("damping", _GAIN_STEP, _LEAST_DAMPING, _MOST_DAMPING),
    "damping down": _gain("damping", 1.0 / _GAIN_STEP, _LEAST_DAMPING, _MOST_DAMPING),
    "rate up": _rate(1),
    "rate down": _rate(-1),
    "delay up": _delay(1),
    "delay down": _delay(-1),
}
"""Settings after each action, from those before it."""
