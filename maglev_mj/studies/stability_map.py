"""Stability map over the gains, by theory and simulation.

It includes the map of figure 2.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

import maglev_mj
import maglev_mj.theory as theory
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.frames import Array, Mask
from maglev_mj.hand import get_hand
from maglev_mj.parameters import Parameters, interval, param
from maglev_mj.result import Result, Table
from maglev_mj.spec import Spec
from maglev_mj.studies.cells import Cell, Record, Workers, run_cells
from maglev_mj.studies.growth import HAND_HELP, RestingWall, grow_together, stiffest_in
from maglev_mj.theory import bounds
from maglev_mj.theory.closed_loop import MOST_PERIODS, LoopKeywords

_NEAR = 0.005
_TOGETHER = 240
_AT_ONCE = 50_000
_AROUND = ("plant", "period", "delay", "mass", "hand")


class StabilityParameters(Parameters):
    """Grid of gains with its loop.

    Without ranges the grid covers the whole stable region.

    Raises:
        ParameterError: If a value is outside its bounds.
    """

    damping: tuple[float, float] | None = param(
        "least and greatest damping",
        "N s/m",
        default=None,
        optional=True,
        parse=partial(interval, "damping", at_least=0.0, at_most=1e6),
    )
    stiffness: tuple[float, float] | None = param(
        "least and greatest stiffness",
        "N/m",
        default=None,
        optional=True,
        parse=partial(interval, "stiffness", at_least=0.0, at_most=1e8),
    )
    grid: int = param("points on each axis; one for a range of one value", default=60, at_least=2, at_most=1000)
    period: float = param("sample period", "s", default=1.0 / Spec.control_rate.value, at_least=1e-6, at_most=1.0)
    delay: float = param(
        "from a sample to its command taking effect", "s", default=Spec.transport_delay.value, at_least=0.0
    )
    mass: float = param("moving mass", "kg", default=Spec.moving_mass.value, at_least=1e-3, at_most=1e3)
    hand: str = param(HAND_HELP, default="none")
    plant: str = param("plant; none for theory alone", default="none", choices=RestingWall.plants)

    def check(self) -> None:
        """See `Parameters`."""
        if self.delay > MOST_PERIODS * self.period:
            raise ParameterError(
                f"delay must be at most {MOST_PERIODS} periods of {self.period:g} s, not {self.delay:g}"
            )
        get_hand(self.hand)

    @property
    def loop_named(self) -> str:
        """Rate, delay, mass and hand in a few words."""
        hand = "no hand" if self.hand == "none" else f"hand {self.hand}"
        return f"{1.0 / self.period:g} Hz, delay {self.delay * 1e3:g} ms, mass {self.mass:g} kg, {hand}"

    @property
    def loop(self) -> LoopKeywords:
        """Keywords of the theory besides the gains."""
        return {"period": self.period, "delay": self.delay, "mass": self.mass, "hand": get_hand(self.hand)}


class GainMap(Result):
    """Map over a grid of gains.

    Attributes:
        damping: Dampings of the grid [N s/m], (B,).
        stiffness: Its stiffnesses [N/m], (K,).
        maximum: The stiffest wall by theory over all dampings, in the grid or not.
    """

    damping: Array
    stiffness: Array
    maximum: theory.StiffestWall

    def cells(self) -> Mapping[str, NDArray[Any]]:
        """Return the map's values by name, (K, B) each."""
        raise NotImplementedError

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return gains and values of each cell, (K B,) each.

        The damping varies fastest.
        """
        stiffness, damping = np.meshgrid(self.stiffness, self.damping, indexing="ij")
        columns: dict[str, NDArray[Any]] = {"stiffness": stiffness, "damping": damping, **self.cells()}
        return {name: values.ravel() for name, values in columns.items()}

    @property
    def units(self) -> dict[str, str]:
        """Unit of each column."""
        return {"stiffness": "N/m", "damping": "N s/m", "swing": "m"}


@dataclass(frozen=True, eq=False)
class StabilityMap(GainMap):
    """Stability of each cell by theory and simulation.

    Attributes:
        parameters: The grid.
        damping: Its dampings [N s/m], (B,).
        stiffness: Its stiffnesses [N/m], (K,).
        modulus: Largest eigenvalue modulus, (K, B).
        boundary: Largest stable stiffness at each damping [N/m], (B,).
        maximum: The stiffest wall over all dampings, in the grid or not.
        simulated: True if the simulated wall settles, (K, B); None for theory alone.
        near: True if half a percent of a gain changes the theory's verdict, (K, B); False throughout for theory alone.
        other_versions: Other code behind cells of the record; see `Record.others`.
    """

    parameters: StabilityParameters
    damping: Array
    stiffness: Array
    modulus: Array
    boundary: Array
    maximum: theory.StiffestWall
    simulated: Mask | None
    near: Mask
    other_versions: Sequence[Mapping[str, Any]] = ()
    drawn_by: ClassVar = "maglev_mj.studies.pictures:stability_map"

    def cells(self) -> dict[str, NDArray[Any]]:
        """Return modulus, and `settles` if walls were simulated."""
        return {"modulus": self.modulus} | ({} if self.simulated is None else {"settles": self.simulated})

    @property
    def misjudged(self) -> Mask | None:
        """Cells with different theory and simulation, (K, B).

        Cells within half a percent of the boundary are left out.
        """
        return None if self.simulated is None else (theory.is_stable(self.modulus) != self.simulated) & ~self.near

    def table(self) -> Table:
        """Return the stiffest wall beside published bounds, and the numbers of stable cells."""
        p, best, damping = self.parameters, float(self.maximum.stiffness), float(self.maximum.damping)
        published = (
            ("Colgate & Schenkel", bounds.colgate(damping, period=p.period), "passive; none on a flotor"),
            ("Gil et al.", bounds.gil(damping, period=p.period, delay=p.delay), "stable, low damping"),
            ("Minsky et al.", bounds.minsky(damping, period=p.period), "stable, no delay, low damping"),
        )
        beside = "; at a damping slightly beside the jump, softer walls are unstable" if self.maximum.on_jump else ""
        rows = [("stiffest stable wall", best, 1.0, f"at {damping:.1f} N s/m{beside}" if best else "no wall is stable")]
        rows += [(name, float(one), float(one) / best if best else math.nan, sense) for name, one, sense in published]
        stable = theory.is_stable(self.modulus)
        note = [f"grid: {stable.sum()} of {stable.size} cells stable by theory"]
        if self.simulated is not None and self.misjudged is not None:
            note.append(
                f"simulated ({p.plant}): {self.simulated.sum()} stable; {(stable != self.simulated).sum()} verdicts "
                f"differ from theory, {self.misjudged.sum()} of them further than 0.5 % of a gain from the boundary "
                f"({self.near.sum()} cells are nearer)"
            )
        note.append("published bounds are at this damping, without a hand")
        head = "", "stiffness [N/m]", "ratio to it", ""
        return Table(f"Stability of a PD wall, {p.loop_named}", head, rows, "\n".join(note))


def run_stability(
    parameters: StabilityParameters,
    *,
    record: Record | None = None,
    workers: Workers | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> StabilityMap:
    """Compute a stability map, simulating each cell if wanted.

    A cell without stiffness has no equilibrium and is not simulated; it counts as unstable, as in theory.

    Raises:
        StudyInterrupted: On Ctrl-C; the cells done are in the record.
    """
    p, loop = parameters, parameters.loop
    damping, stiffness, best = gain_axes(p)
    k, b = stiffness[:, None], damping[None, :]
    modulus = _moduli(stiffness, damping, loop, progress)
    simulated, near, others = None, np.zeros(modulus.shape, dtype=bool), []
    if p.plant != "none":
        for share in (1.0 - _NEAR, 1.0 + _NEAR):
            for moved in (theory.largest_modulus(share * k, b, **loop), theory.largest_modulus(k, share * b, **loop)):
                near |= theory.is_stable(moved) != theory.is_stable(modulus)
        cells = _cells(p, stiffness, damping, modulus)
        others = [] if record is None else record.others(cells)
        results = run_cells(
            simulate_walls, cells, record=record, workers=workers, together=_TOGETHER, progress=progress
        )
        verdict = {(cell["stiffness"], cell["damping"]): _stable(result) for cell, result in zip(cells, results)}
        simulated = np.array([[verdict.get((row, column), False) for column in damping] for row in stiffness])
    boundary = theory.largest_stable_stiffness(damping, **loop)
    return StabilityMap(p, damping, stiffness, modulus, boundary, best, simulated, near, others)


def gain_axes(p: StabilityParameters) -> tuple[Array, Array, theory.StiffestWall]:
    """Return a grid's dampings, stiffnesses, and stiffest wall.

    Dampings [N s/m], (B,), stiffnesses [N/m], (K,), and the stiffest wall by theory.
    """
    best = stiffest_in(p.period, p.delay, p.mass, p.hand)
    # a wall without damping or stiffness, or none, frames nothing
    damping = _axis(p.damping, p.grid, 2.2 * float(best.damping) or p.mass / p.period)
    stiffness = _axis(p.stiffness, p.grid, 1.25 * float(best.stiffness) or p.mass / p.period**2)
    return damping, stiffness, best


def _moduli(stiffness: Array, damping: Array, loop: LoopKeywords, progress: Callable[[int, int], None] | None) -> Array:
    """Return each cell's largest modulus, computed in groups of rows.

    The groups report progress.
    """
    rows = max(_AT_ONCE // damping.size, 1)
    parts = []
    for start in range(0, stiffness.size, rows):
        parts.append(theory.largest_modulus(stiffness[start : start + rows, None], damping, **loop))
        if progress is not None:
            progress(min(start + rows, stiffness.size) * damping.size, stiffness.size * damping.size)
    return np.concatenate(parts)


def _cells(p: StabilityParameters, stiffness: Array, damping: Array, modulus: Array) -> list[Cell]:
    """Return the cells to simulate, slow ones last.

    These are near the boundary and so run together.
    """
    around = {name: getattr(p, name) for name in _AROUND}
    order = np.argsort(np.abs(np.log(np.maximum(modulus, 1e-9))).ravel())[::-1]
    places = [np.unravel_index(place, modulus.shape) for place in order]
    return [
        {
            "scene": "stability",
            "version": maglev_mj.__version__,
            **around,
            "stiffness": float(stiffness[row]),
            "damping": float(damping[column]),
        }
        for row, column in places
        if stiffness[row] > 0.0
    ]


def simulate_walls(cells: list[Cell]) -> list[dict[str, Any]]:
    """Simulate cells; return stability, growth and samples.

    The growth is that per sample.

    Each cell has plant, period, delay, mass, hand, stiffness and damping; they share the plant.
    """
    names = (*_AROUND[1:], "stiffness", "damping")
    growth = grow_together([RestingWall(**{name: cell[name] for name in names}) for cell in cells], cells[0]["plant"])
    return [
        {"stable": stable, "rate": rate, "ticks": int(ticks)}
        for stable, rate, ticks in zip(*(part.tolist() for part in growth), strict=True)
    ]


def _stable(result: Any) -> bool:
    if not isinstance(result, dict) or "stable" not in result:
        raise MaglevError(f"a cell has no verdict: {result!r}")
    return bool(result["stable"])


def _axis(limits: tuple[float, float] | None, count: int, highest: float) -> Array:
    """Return the values of one axis.

    By default they go from one step above 0 to the highest value.
    """
    if limits is None:
        return np.linspace(highest / count, highest, count)
    return np.linspace(*limits, count) if limits[0] < limits[1] else np.array([limits[0]])
