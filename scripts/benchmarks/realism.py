"""Cost and effect of realism in the drop, by piece.

Each piece is added alone to the plain loop of its plant. `measure` is a section of bench.py.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from maglev_mj.colours import DEVICE, HAND, REFERENCE
from maglev_mj.control.controller import Controller
from maglev_mj.pictures import TITLE, PictureFolder, new_figure, save
from maglev_mj.plants import ExactPlant, MuJoCoPlant, SampledPlant, Sensor, SpotSensor
from maglev_mj.plants.hand import get_hand
from maglev_mj.scenes.drop import Drop
from maglev_mj.spec import RESOLUTION, Spec
from maglev_mj.studies.levels import apart, motion_of
from timing import Run, columns, driven, in_turns, medians, ratio

EXACT, ENGINE = "exact plant", "engine, RK4"
_TURNS, _RUNS, _DEAR = 9, 3, 0.05
_NOTHING = 1e-3  # a smaller change is drawn here [µm]


class Piece(NamedTuple):
    """A piece of realism.

    The plant that it is added to, its options there, and jitter of the conversions [s].
    """

    plant: str
    options: Mapping[str, Any]
    jitter: float = 0.0


_LIMIT = [np.inf, np.inf, Spec.largest_vertical_force.value, np.inf, np.inf, np.inf]
PIECES = {
    "sensor: 5 µm, 10 µrad": Piece(EXACT, {"sensor": Sensor(quantum=RESOLUTION)}),
    "sensor with noise as large": Piece(EXACT, {"sensor": Sensor(quantum=RESOLUTION, noise=RESOLUTION)}),
    "conversions ±0.1 ms": Piece(EXACT, {}, 1e-4),
    "force limit": Piece(EXACT, {"wrench_limit": _LIMIT}),
    "drivers of 2 kHz": Piece(EXACT, {"driver_lag": True}),
    "an arm's hand": Piece(EXACT, {"hand": get_hand("arm")}),
    "dry friction of 0.1 N": Piece(EXACT, {"dry_friction": [0.1, 0.1, 0.1, 0.0, 0.0, 0.0]}),
    "six coils that turn": Piece(ENGINE, {"coils": True}),
    "six coils, 10 A each": Piece(ENGINE, {"coils": True, "current_limit": Spec.peak_current.value}),
    "force falls off by a tenth": Piece(ENGINE, {"coils": True, "force_falloff": 0.1}),
    "LEDs and diodes": Piece(ENGINE, {"sensor": SpotSensor(quantum=Spec.spot_resolution.value)}),
    "metal stops": Piece(ENGINE, {"stops": True}),
    "drivers of 2 kHz in the engine": Piece(ENGINE, {"driver_lag": True, "coils": True}),
    "a handle that swings": Piece(ENGINE, {"flexible": True, "coils": True}),
}
"""Pieces by their name in a chart."""

_MAKERS: dict[str, Callable[..., SampledPlant]] = {EXACT: ExactPlant, ENGINE: partial(MuJoCoPlant, coils=False)}


def parts(piece: Piece) -> tuple[SampledPlant, Controller, int]:
    """Return plant, controller and tick count of a drop."""
    scene = Drop(force_limit=0.0)
    timing = replace(scene.timing(), jitter=piece.jitter)
    options = dict(piece.options)
    held = {"hand": options.pop("hand")} if "hand" in options else {}  # a scene's own hand is one that pushes
    plant = scene.plant(partial(_MAKERS[piece.plant], **held), timing=timing, **options)
    return plant, scene.controller(), scene.ticks(timing)


def cost(piece: Piece, runs: int) -> Run:
    """Return the cheapest of several drops, the first if it takes long."""
    first = driven(*parts(piece))
    more = 0 if first.seconds > _DEAR else runs - 1
    return min([first, *(driven(*parts(piece)) for _ in range(more))], key=lambda run: run.seconds)


def measure(quick: bool) -> dict[str, Any]:
    """Return each piece's cost over plain, cost [µs a simulated ms] and change [µm]."""
    plain = {kind: Piece(kind, {}) for kind in _MAKERS}
    truth = {kind: motion_of(*parts(piece)).pose for kind, piece in plain.items()}
    device = Drop().hardware
    moved = {name: apart(motion_of(*parts(piece)).pose, truth[piece.plant], device) for name, piece in PIECES.items()}
    runs = 2 if quick else _RUNS
    work = {name: partial(cost, piece, runs) for name, piece in {**plain, **PIECES}.items()}
    drops = in_turns(work, 1 if quick else _TURNS)
    times = {name: [run.seconds for run in some] for name, some in drops.items()}
    return {
        "cost over plain": {name: ratio(times[name], times[PIECES[name].plant]) for name in PIECES},
        "µs a simulated ms": medians(times, 1e3 / (parts(plain[EXACT])[2] * Drop().period)),
        **columns(drops),
        "change (µm)": {name: 1e6 * float(change) for name, change in moved.items()},
    }


def draw(pictures: PictureFolder, found: Mapping[str, Any]) -> list[Path]:
    """Draw cost beside change, the cheapest on top; return the file."""
    costs, changes = found["cost over plain"], found["change (µm)"]
    names = sorted(costs, key=lambda name: -costs[name])
    head = f"Most expensive option: {names[0]}, {costs[names[0]]:.0f} times the cost of the plain loop"
    scene = Drop(force_limit=0.0)
    detail = (
        f"drop, {1.0 / scene.period:g} Hz, delay {1e3 * scene.delay:g} ms; "
        "each option alone, beside the plain loop of its plant"
    )
    figure, axes = new_figure([head, detail], 1, 2, 0.24 * len(names) + 1.0, sharey=True)
    kinds = {EXACT: ("o", HAND), ENGINE: ("s", DEVICE)}
    titles = "cost relative to the plain loop", "largest displacement of a coil (µm)"
    columns = costs, {name: max(value, _NOTHING) for name, value in changes.items()}
    for axis, title, values in zip(axes, titles, columns, strict=True):
        for row, name in enumerate(names):
            marker, colour = kinds[PIECES[name].plant]
            axis.plot(values[name], row, marker=marker, color=colour, markersize=7.0)
            words = {"xytext": (8, 0), "textcoords": "offset points", "va": "center", "fontsize": 9.0}
            told = "none" if values[name] == _NOTHING else f"{float(f'{values[name]:.2g}'):g}"
            axis.annotate(told, (values[name], row), color=REFERENCE, **words)
        axis.set_xscale("log")
        low, high = axis.get_xlim()
        axis.set_xlim(min(low, 0.9), 8.0 * high)
        axis.minorticks_off()
        axis.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axis.set_title(title, **TITLE)
        axis.set_yticks(range(len(names)), names)
    for kind, (marker, colour) in kinds.items():
        axes[0].plot([], [], marker=marker, color=colour, linestyle="none", label=f"added to the {kind}")
    figure.legend(loc="outside lower center", ncols=2, frameon=False, fontsize=9.0)
    return [save(figure, pictures.path("speed_options"))]
