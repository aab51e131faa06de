"""Stability map over the gains, by theory and by growth in simulation.

In a simulated wall the flotor rests and is displaced slightly; the samples tell if the motion settles or grows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

import maglev_mj.theory as theory
from maglev_mj.control import Law, LowPass, VelocityEstimator, Wall
from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import ControlLoop
from maglev_mj.control.stack import alike, computed_together
from maglev_mj.errors import MaglevError, ParameterError, check_one_of
from maglev_mj.frames import Array, Command, Mask, Sample
from maglev_mj.parameters import param, param_range
from maglev_mj.plants import ExactPlant, MuJoCoBatchPlant, SampledPlant, engine_warnings_silenced
from maglev_mj.plants.hand import Hand, get_hand
from maglev_mj.plants.model import body_of
from maglev_mj.result import Result, Table, conditions_text
from maglev_mj.scenes.scene import PLANTS, PlantMaker, Scene, Start
from maglev_mj.scenes.stack import stacked_scenes
from maglev_mj.scenes.wall_scene import ANYWHERE, WallScene, along, hold, lagging, others
from maglev_mj.studies.cells import Workers, grid_columns, run_cells
from maglev_mj.studies.record import Cell, Record
from maglev_mj.theory.boundary import boundary_of, rigid_note, stiffest_of
from maglev_mj.theory.loop import Loop
from maglev_mj.theory.loop_array import LoopArray, pd
from maglev_mj.theory.loop_parameters import PLAIN, LoopParameters

_MOVED = 1e-6
_DECIDED = 1e4
_BLOCK = 16
_FEW = 48
_GAINS = "stiffness", "damping"
_PATIENCE = (128, 512, 2048, 8192)
_BATCHES: Mapping[str, PlantMaker] = {"exact": ExactPlant, "mujoco": MuJoCoBatchPlant}
_NEAR = 0.005
_TOGETHER = 240
_AT_ONCE = 50_000
_MOST_POINTS = 1000
_FINE = 200
_AROUND = ("period", "delay", "mass", "hand", "cutoff", "driver_lag")


class _Growth(NamedTuple):
    """Growth of the motion in each loop, (N,) each.

    Attributes:
        stable: True if the motion decays.
        rate: Growth factor from one sample to the next, from the largest values; rough if only a few samples decide.
        ticks: Number of samples until the decision.
    """

    stable: Mask
    rate: Array
    ticks: Array


class RestingWall(Scene):
    """Rest the flotor in a wall and check its stability.

    The wall fills z <= 0, the five other axes are held. The plant "none" is theory alone; on the others the flotor
    starts displaced from its equilibrium by a millionth of its depth.
    """

    name: ClassVar[str] = "wall"
    plants: ClassVar[Sequence[str]] = ("none", *PLANTS)
    takes_phase: ClassVar[bool] = False

    delay: float = Scene.like("delay", live=False)
    stiffness: float = WallScene.like("stiffness", above=0.0, at_least=None, live=False)
    damping: float = WallScene.like("damping", live=False)
    mass: float = WallScene.like("mass")
    hand: str = LoopParameters.like("hand")
    cutoff: float | None = LoopParameters.like("cutoff")
    driver_lag: float | None = LoopParameters.like("driver_lag")

    def check(self) -> None:
        """See `Scene`."""
        get_hand(self.hand)

    def velocity_estimator(self) -> VelocityEstimator | None:
        """See `Scene`."""
        return None if self.cutoff is None else LowPass(self.cutoff)

    def laws(self) -> list[Law]:
        """Return the wall and the hold of the other axes."""
        wall = Wall(axes="z", lower=0.0, stiffness=self.stiffness, damping=self.damping)
        return [wall, hold(self, others("z"))]

    def start(self) -> Start:
        """Return a flotor displaced slightly from its equilibrium.

        The displacement is a millionth of the depth; the wall's force carries the flotor.
        """
        pose = along("z", self.rest * (1.0 + _MOVED)).tolist()
        return Start(pose=pose, wrench=along("z", -self.stiffness * self.rest).tolist())

    def plant_options(self) -> dict[str, Any]:
        """See `Scene`."""
        own: dict[str, Any] = {"mass": self.mass, "hand": self.impedance, "escape": ANYWHERE}
        return own if self.driver_lag is None else own | lagging(self.driver_lag)

    @property
    def impedance(self) -> Hand | None:
        """Hand on the flotor; None for none."""
        return get_hand(self.hand)

    @property
    def rest(self) -> float:
        """Equilibrium of weight, wall and arm [m]."""
        hand = self.impedance
        arm = 0.0 if hand is None else float(hand.static_stiffness)
        body = body_of(self.device_options())
        return float(body.inertia[2] * body.gravity[2]) / (self.stiffness + arm)

    @property
    def loop(self) -> Loop:
        """Loop without the gains."""
        own = LoopParameters(device=self.device, **{name: getattr(self, name) for name in _AROUND})
        return own.loop(inertia=float(self.body.inertia[2]), velocity=self.velocity_estimator())

    def run_figures(self, plant: str, phase: float = 0.0) -> Mapping[str, Any]:
        """Return the figures of theory and simulation.

        There is no simulation on the plant "none".
        """
        return self.figures_together([self], plant, [phase])[0]

    @classmethod
    def figures_together(
        cls, scenes: Sequence[Self], plant: str, phases: Sequence[float]
    ) -> Sequence[Mapping[str, Any]]:
        """Return the figures of many walls; see `Scene`.

        Walls that differ in their gains alone are one batch.
        """

        def figures(walls: Sequence[Self]) -> Iterator[Mapping[str, Any]]:
            stiffness, damping = (np.array([getattr(wall, name) for wall in walls]) for name in _GAINS)
            stiffest, loop = stiffest_in(walls[0].loop), walls[0].loop.array()
            columns = {
                "spectral_radius": loop.spectral_radius(stiffness, damping),
                "largest_stiffness": boundary_of(loop, damping),
                "stiffest_wall": np.full(len(walls), stiffest.stiffness),
                "at_damping": np.full(len(walls), stiffest.damping),
            }
            if plant != "none":
                growth = measure_growth(walls, plant)
                columns |= {"simulated_rate": growth.rate, "simulated_stable": growth.stable}
            for row in zip(*(column.tolist() for column in columns.values()), strict=True):
                yield dict(zip(columns, row, strict=True))

        return computed_together(scenes, map(_kind, scenes), figures)


@lru_cache(maxsize=1024)
def stiffest_in(loop: Loop) -> theory.StiffestWall:
    """Return the stiffest wall, cached for all gains."""
    return stiffest_of(loop.array())


def _kind(wall: RestingWall) -> tuple[Any, ...]:
    """Return what is equal for walls that differ in their gains only."""
    return (*(getattr(wall, name) for name in _AROUND), wall.device)


def measure_growth(walls: Sequence[RestingWall], plant: str = "exact", **keywords: Any) -> _Growth:
    """Simulate walls with a resting flotor; measure the growth.

    The growth is that of a small displacement in closed loop.

    The flotor starts displaced from its equilibrium under gravity by a millionth of its depth. A loop is decided when
    the displacement has become ten thousand times larger or smaller, so that the wall's edge and rounding are both far
    away. A loop undecided after 8192 samples is unstable if its last quarter is not smaller than its second.

    Args:
        walls: The walls; those that differ in their gains alone are one batch.
        plant: "exact" or "mujoco"; the latter by corrected Euler where that is exact, otherwise by RK4.
        keywords: Further keywords of `Scene.plant`, such as another timing, and of the plant.

    Raises:
        ParameterError: If there is no such plant, or a value is outside its bounds.
    """
    check_one_of("plant", _BATCHES, plant)
    count = len(walls)
    stable, rate, spent = np.zeros(count, dtype=bool), np.full(count, np.nan), np.zeros(count)
    for undecided in map(np.array, alike(map(_kind, walls)).values()):
        for ticks in _PATIENCE:
            if not undecided.size:
                break
            some = [walls[index] for index in undecided.tolist()]
            stack = stacked_scenes([(wall, 0.0) for wall in some], plant)
            options = {**_engine(some), **keywords} if plant == "mujoco" else keywords
            device = stack.plant(_BATCHES[plant], **options)
            sizes = _sizes(device, stack.controller(), np.array([wall.rest for wall in some]), ticks)
            growth, decided = _growths(sizes, last=ticks == _PATIENCE[-1])
            done = undecided[decided]
            stable[done], rate[done], spent[done] = (part[decided] for part in growth)
            undecided = undecided[~decided]
    return _Growth(stable, rate, spent)


def _engine(walls: Sequence[RestingWall]) -> dict[str, Any]:
    """Return the cheapest exact engine options for some walls.

    Threads are used for many walls.
    """
    changes = any(wall.impedance for wall in walls)  # the force of a hand, within a step
    return {"integrator": "rk4" if changes else "corrected", "threads": int(len(walls) < _FEW)}


def _sizes(plant: SampledPlant, controller: Controller, rest: Array, ticks: int) -> Array:
    """Return relative displacements from equilibrium, (blocks, N).

    The largest in each block of samples, divided by that at the start.

    The run ends when all loops are decided.
    """
    blocks = np.zeros((ticks // _BLOCK, rest.size))

    def observe(sample: Sample, _: Command) -> None:
        row = blocks[sample.tick // _BLOCK]
        np.maximum(row, np.abs(sample.position[2] / rest - 1.0) / _MOVED, out=row)

    with plant, engine_warnings_silenced():
        loop = ControlLoop(plant, controller, observe=observe)
        for end in range(1, len(blocks) + 1):
            loop.cycle(_BLOCK)
            if _decisive(blocks[:end]).any(axis=0).all():
                break
    return blocks[:end]


def _decisive(sizes: Array) -> Mask:
    return (sizes < 1.0 / _DECIDED) | (sizes > _DECIDED)


def _growths(sizes: Array, *, last: bool) -> tuple[_Growth, Mask]:
    """Return the growth by block sizes, and a decided mask."""
    decisive = _decisive(sizes)
    decided: Mask = np.any(decisive, axis=0)
    pick = np.where(decided, np.argmax(decisive, axis=0), len(sizes) - 1)
    column = np.arange(sizes.shape[1])
    stable = sizes[pick, column] < 1.0 / _DECIDED
    with np.errstate(divide="ignore"):
        # from the first block to the one that decides; within the first, from the start
        since = np.where(pick > 0, sizes[0], 1.0)
        rate = np.exp(np.log(sizes[pick, column] / since) / np.where(pick > 0, pick, 1.0) / _BLOCK)
    if last and not decided.all():
        quarter = len(sizes) // 4
        second, fourth = sizes[quarter : 2 * quarter].max(axis=0), sizes[-quarter:].max(axis=0)
        stable = np.where(decided, stable, fourth < second)
        rate = np.where(decided, rate, (fourth / second) ** (1.0 / (2 * quarter * _BLOCK)))
        decided = np.ones(column.size, dtype=bool)
    return _Growth(stable, rate, (pick + 1.0) * _BLOCK), decided


class StabilityParameters(LoopParameters):
    """Grid of gains with its loop.

    A range is (low, high), or (low, high, count) of its points. Without ranges the grid covers the whole stable region.

    Raises:
        ParameterError: If a value is outside its bounds.
    """

    damping: tuple[float, ...] | None = param_range(
        "damping", "damping range", "N s/m", default=None, at_least=0.0, at_most=1e6, most=_MOST_POINTS
    )
    stiffness: tuple[float, ...] | None = param_range(
        "stiffness", "stiffness range", "N/m", default=None, at_least=0.0, at_most=1e8, most=_MOST_POINTS
    )
    grid: int = param("points of an axis without a COUNT", default=60, at_least=2, at_most=_MOST_POINTS)
    plant: str = param("simulated plant, or none for theory only", default="none", choices=RestingWall.plants)

    def check(self) -> None:
        """See `Parameters`."""
        super().check()
        for name in ("friction", "quantum"):
            if self.plant != "none" and getattr(self, name):
                raise ParameterError(f"{name} must be 0 on a simulated plant (got {getattr(self, name):g})")
        if bool(self.friction) != bool(self.quantum):
            raise ParameterError("friction and quantum must be given together: a wall is quiet by both")
        if self.plant != "none" and not self.plain:
            what = self.described.removeprefix(", ") or "a rotary axis"
            raise ParameterError(f"{what} cannot be simulated (plant {self.plant}): plants have {PLAIN}")

    @property
    def count(self) -> int:
        """Number of cells."""
        return math.prod(gain_axis(getattr(self, name), self.grid, 1.0).size for name in _GAINS)

    @property
    def wall(self) -> dict[str, Any]:
        """Arguments of `diagnose` for the one wall of both ranges; empty for a grid."""
        gains = {name: getattr(self, name) for name in _GAINS}
        if not all(ends and ends[0] == ends[1] for ends in gains.values()):
            return {}
        loop = {item.name: getattr(self, item.name) for item in LoopParameters.parameters()}
        return loop | {name: ends[0] for name, ends in gains.items()}

    @property
    def conditions(self) -> str:
        """Axis, rate, delay, mass and hand in words."""
        hand = "no hand" if self.hand == "none" else f"hand {self.hand}"
        body = f"{'inertia' if self.rotary else 'mass'} {self.body:g} {self.unit('kg')}"
        return conditions_text("PD wall", [self.axis], [self.period], [self.delay], body, f"{hand}{self.described}")


@dataclass(frozen=True, eq=False)
class GainMap(Result):
    """Map over a grid of gains.

    Attributes:
        parameters: The grid.
        damping: Its dampings [N s/m], (B,).
        stiffness: Its stiffnesses [N/m], (K,).
        boundary: Largest stable stiffness at each damping by theory [N/m], (B,).
        maximum: The stiffest wall by theory over all dampings, in the grid or not.
    """

    parameters: StabilityParameters
    damping: Array
    stiffness: Array
    boundary: Array
    maximum: theory.StiffestWall

    @property
    def units(self) -> Mapping[str, str]:
        """See `Result`."""
        units = {"stiffness": "N/m", "damping": "N s/m", "swing": "m"}
        return {name: self.parameters.unit(unit) for name, unit in units.items()}

    def _headline(self) -> str:
        if not self.maximum.stiffness > 0.0:
            return "No wall is stable"
        return f"Stiffest stable wall: {self.maximum.describe(self.parameters.axis)}"

    @property
    def conditions(self) -> str:
        """See `Result`."""
        return self.parameters.conditions

    def cells(self) -> Mapping[str, NDArray[Any]]:
        """Return the map's values by name, (K, B) each."""
        raise NotImplementedError

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return gains and values of each cell, (K B,) each.

        The damping varies fastest.
        """
        gains = grid_columns({"stiffness": self.stiffness, "damping": self.damping})
        return gains | {name: values.ravel() for name, values in self.cells().items()}


@dataclass(frozen=True, eq=False)
class StabilityMap(GainMap):
    """Stability of each cell by theory and simulation; see `GainMap`.

    Attributes:
        spectral_radius: Spectral radius, (K, B).
        simulated: True if the simulated wall settles, (K, B); None for theory alone.
        near: True if half a percent of a gain changes the theory's verdict, (K, B); False throughout for theory alone.
    """

    spectral_radius: Array
    simulated: Mask | None
    near: Mask
    pictures: ClassVar = {"stability": "maglev_mj.studies.pictures:stability_map"}

    def cells(self) -> dict[str, NDArray[Any]]:
        """Return spectral radius, `passive` and `quiet` where they are known, and `settles` if walls were simulated."""
        cells: dict[str, NDArray[Any]] = {"spectral_radius": self.spectral_radius}
        if self.parameters.own_damping and self.parameters.direct:
            cells["passive"] = self.passive_damping(self.damping, self.stiffness) <= self.parameters.own_damping
        if self.parameters.quantum:
            quiet = self.stiffness[:, None] <= self.quiet_stiffness(self.damping)
            cells["quiet"] = quiet & theory.is_stable(self.spectral_radius)
        return cells if self.simulated is None else {**cells, "settles": self.simulated}

    def passive_damping(self, damping: Array, stiffness: Array) -> Array:
        """Return the least damping of the device's own that makes each wall passive [N s/m], (K, B).

        See `least_passive_damping`; a hand is any passive one.
        """
        times = self._times
        return np.array([theory.least_passive_damping(row, damping, **times) for row in stiffness])  # memory for a row

    @property
    def _times(self) -> dict[str, Any]:
        """Keywords of `least_passive_damping`."""
        p = self.parameters
        return {"period": p.period, "delay": p.delay, "design": pd(p.velocity)}

    def quiet_stiffness(self, damping: Array) -> Array:
        """Return the stiffness below which a stable wall always comes to rest, at each damping [N/m], (B,).

        Where the flotor would rest just between two readings, a quantum q apart, the wall's force is K q/2 off, and off
        by B q/T more for a period T whenever the reading changes. Friction f holds the flotor against both together if

        K <= 2 f/q - 2 B/T.

        Above, it may hum. A low-pass filter of the velocity only lowers the second part. Derived here; the bound 2 f/q
        alone, for passivity without damping, is that of Abbott & Okamura 2005 (as quoted by others).
        """
        p = self.parameters
        return 2.0 * p.friction / p.quantum - 2.0 * damping / p.period

    def level_sets(self) -> tuple[Array, Array, Array]:
        """Return dampings and stiffnesses of a fine grid, (200,) each, and the spectral radius there, (200, 200)."""
        x, y = (np.linspace(values.min(), values.max(), _FINE) for values in (self.damping, self.stiffness))
        return x, y, self.parameters.loop().array().spectral_radius(y[:, None], x)

    @property
    def disagreement(self) -> Mask | None:
        """Cells with different theory and simulation, (K, B).

        Cells within half a percent of the boundary are left out.
        """
        return (
            None if self.simulated is None else (theory.is_stable(self.spectral_radius) != self.simulated) & ~self.near
        )

    def table(self) -> Table:
        """Return the stiffest wall, and the numbers of stable cells."""
        p, best, damping = self.parameters, float(self.maximum.stiffness), float(self.maximum.damping)
        remark = "; on a jump: at nearby dampings, softer walls are unstable" if self.maximum.on_jump else ""
        force, damper = p.unit("N/m"), p.unit("N s/m")
        at = f"at {damping:{'.4g' if p.rotary else '.1f'}} {damper}{remark}"
        rows = [("stiffest stable wall", best, at if best else "no wall is stable")]
        stable = theory.is_stable(self.spectral_radius)
        ranges = f"damping {_span(self.damping)} {damper}, stiffness {_span(self.stiffness)} {force}"
        note = [f"grid: {stable.sum()} of {stable.size} cells stable by theory; {ranges}"]
        if self.simulated is not None and self.disagreement is not None:
            different = (stable != self.simulated).sum()
            note.append(
                f"simulation ({p.plant}): {self.simulated.sum()} stable; {different} differ from "
                f"theory, {self.disagreement.sum()} outside ±0.5 % of the boundary ({self.near.sum()} cells inside)"
            )
        if p.mode:
            note.append(rigid_note(p.loop().array()))
        if best and p.direct:
            least = float(theory.least_passive_damping(best, damping, **self._times))
            note.append(f"the stiffest wall is passive with {least:.4g} {damper} of the device's own damping")
        note += self._regions()
        head = "", f"stiffness [{force}]", ""
        return Table(f"Stability of a {p.conditions}", head, rows, "\n".join(note))

    def _regions(self) -> Iterator[str]:
        """Yield where walls are passive and quiet, if known."""
        columns, unit = self.columns(), self.parameters.unit
        for name, cells in columns.items():
            if name in ("passive", "quiet") and (found := np.where(cells, columns["stiffness"], 0.0)).any():
                row = int(found.argmax())
                at = f"{found[row]:.4g} {unit('N/m')} at {columns['damping'][row]:.4g} {unit('N s/m')}"
                yield f"{name}: {cells.sum()} of {cells.size} cells, stiffest {at}"
            elif name in ("passive", "quiet"):
                yield f"{name}: no cell"


def _span(values: Array) -> str:
    ends = dict.fromkeys(f"{float(f'{value:.4g}'):g}" for value in (np.min(values), np.max(values)))  # no exponent
    return " to ".join(ends)


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
    p, loop = parameters, parameters.loop().array()
    damping, stiffness, best = gain_axes(p)
    k, b = stiffness[:, None], damping[None, :]
    spectral_radius = _spectral_radii(stiffness, damping, loop, progress)
    simulated, near = None, np.zeros(spectral_radius.shape, dtype=bool)
    if p.plant != "none":
        for share in (1.0 - _NEAR, 1.0 + _NEAR):
            for moved in (loop.spectral_radius(share * k, b), loop.spectral_radius(k, share * b)):
                near |= theory.is_stable(moved) != theory.is_stable(spectral_radius)
        cells = _cells(p, stiffness, damping, spectral_radius)
        results = run_cells(
            simulate_walls, cells, record=record, workers=workers, together=_TOGETHER, progress=progress
        )
        verdict = {(cell["stiffness"], cell["damping"]): _stable(result) for cell, result in zip(cells, results)}
        simulated = np.array([[verdict.get((row, column), False) for column in damping] for row in stiffness])
    boundary = boundary_of(loop, damping)
    return StabilityMap(p, damping, stiffness, boundary, best, spectral_radius, simulated, near)


def gain_axes(p: StabilityParameters) -> tuple[Array, Array, theory.StiffestWall]:
    """Return a grid's dampings, stiffnesses, and stiffest wall.

    Dampings [N s/m], (B,), stiffnesses [N/m], (K,), and the stiffest wall by theory.
    """
    if p.wall:
        raise ParameterError("damping or stiffness must be a range (got one wall): for one, maglev-mj diagnose")
    best = stiffest_of(p.loop().array())
    damping = gain_axis(p.damping, p.grid, highest_damping(best, p.body, p.period))
    stiffness = gain_axis(p.stiffness, p.grid, 1.25 * float(best.stiffness) or p.body / p.period**2)
    return damping, stiffness, best


def highest_damping(best: theory.StiffestWall, body: float, period: float) -> float:
    """Return the end of a map's dampings [N s/m], by the stiffest wall; without one, mass [kg] over period [s]."""
    return 2.2 * float(best.damping) or body / period


def _spectral_radii(
    stiffness: Array, damping: Array, loop: LoopArray, progress: Callable[[int, int], None] | None
) -> Array:
    """Return each cell's spectral radius, computed in groups of rows.

    The groups report progress.
    """
    rows = max(_AT_ONCE // damping.size, 1)
    parts = []
    for start in range(0, stiffness.size, rows):
        parts.append(loop.spectral_radius(stiffness[start : start + rows, None], damping))
        if progress is not None:
            progress(min(start + rows, stiffness.size) * damping.size, stiffness.size * damping.size)
    return np.concatenate(parts)


def _cells(p: StabilityParameters, stiffness: Array, damping: Array, spectral_radius: Array) -> list[Cell]:
    """Return the cells to simulate, slow ones last.

    These are near the boundary and so run together.
    """
    around = {name: value for name in ("plant", *_AROUND) if (value := getattr(p, name)) is not None}
    around |= {} if p.hardware.published else {"device": p.device}
    order = np.argsort(np.abs(np.log(np.maximum(spectral_radius, 1e-9))).ravel())[::-1]
    cells = zip(*np.unravel_index(order, spectral_radius.shape), strict=True)
    gains = [{"stiffness": float(stiffness[row]), "damping": float(damping[column])} for row, column in cells]
    return [around | cell for cell in gains if cell["stiffness"] > 0.0]


def simulate_walls(cells: list[Cell]) -> list[dict[str, Any]]:
    """Simulate cells; return stability, growth and samples.

    The growth is that per sample.

    Each cell has a plant, the parameters of its loop, stiffness and damping; they share the plant.
    """
    names = (*_AROUND, "device", "stiffness", "damping")
    walls = [RestingWall(**{name: cell[name] for name in names if name in cell}) for cell in cells]
    growth = measure_growth(walls, cells[0]["plant"])
    return [
        {"stable": stable, "rate": rate, "ticks": int(ticks)}
        for stable, rate, ticks in zip(*(part.tolist() for part in growth), strict=True)
    ]


def _stable(result: Any) -> bool:
    if not isinstance(result, dict) or "stable" not in result:
        raise MaglevError(f"cell result without a verdict: {result!r}")
    return bool(result["stable"])


def gain_axis(limits: tuple[float, ...] | None, count: int, highest: float) -> Array:
    """Return the values of one axis.

    By default they go from one step above 0 to the highest value.
    """
    if limits is None:
        return np.linspace(highest / count, highest, count)
    low, high, points = limits if len(limits) == 3 else (*limits, count)
    return np.linspace(low, high, int(points)) if low < high else np.array([low])
