"""Stability maps of nonlinear walls, from simulated drops."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from functools import partial
from operator import attrgetter
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from maglev_mj.control.loop import drive
from maglev_mj.errors import MaglevError
from maglev_mj.frames import Array, Command, Mask, Sample
from maglev_mj.parameters import param
from maglev_mj.plants import Timing
from maglev_mj.plants.hand import get_hand
from maglev_mj.result import Table
from maglev_mj.scenes.wall_scene import WallScene, along, wall_controller, wall_plant
from maglev_mj.studies.cells import Workers, run_cells
from maglev_mj.studies.record import Cell, Record
from maglev_mj.studies.stability_map import GainMap, StabilityParameters, gain_axes
from maglev_mj.theory.boundary import boundary_of

PART = 10_000
"""Number of walls simulated at once; they fit the cache."""

SAMPLES = 400
"""Number of samples in a drop."""

_STEPS, _SHARE, _DYING = 10.0, 1e-3, 0.8
# larger than any wall's force until it has swung by metres, so that growing motion stays finite
_MOST_FORCE = 1e9


class DropEnding(IntEnum):
    """Ending of a drop on a wall.

    It settles if the samples of its last quarter swing by at most ten steps of the sensor, or a thousandth of the
    range if that is more. It also settles if it has not left the wall in the second half, and swings by less than 0.8
    of the quarter before. Otherwise it rises if it exceeds its release height in the last quarter.
    """

    SETTLES = 0
    PERSISTS = 1
    RISES = 2


class DropMapParameters(StabilityParameters):
    """Parameters of a map of drops.

    Raises:
        ParameterError: If a value is outside its bounds.
    """

    plant: str = param("plant", default="exact", choices=("exact",))
    height: float = param(
        "drop height above the wall; 0 to release the flotor at the edge",
        "m",
        default=None,
        derive=attrgetter("hardware.height"),
        at_least=0.0,
        at_most=1.0,
    )
    pulse: float = WallScene.like("pulse", default=0.0, live=False)
    pulse_width: float = param("pulse duration", "s", default=0.003, above=0.0, at_most=1.0)
    force_limit: float = WallScene.like("force_limit", default=0.0, derive=None)
    quantize: float = WallScene.like("quantize")

    def check(self) -> None:
        """See `Parameters`."""
        self.refuse({"inertia": "a drop is along z"})
        super().check()

    @property
    def start(self) -> str:
        """Start and contact of the drops in a few words."""
        start = f"released at {self.height * 1e3:g} mm" if self.height else "released at the edge"
        more = [
            f"pulse {self.pulse:g} N s/m for {self.pulse_width * 1e3:g} ms" if self.pulse else "",
            f"{self.force_limit:g} N" if self.force_limit else "",
            f"sensor {self.quantize * 1e6:g} µm" if self.quantize else "",
        ]
        return ", ".join([start, *filter(None, more)])

    @property
    def band(self) -> float:
        """Largest swing of a flotor at rest [m]."""
        return max(_STEPS * self.quantize, _SHARE * float(self.hardware.reach[2]))


@dataclass(frozen=True, eq=False)
class DropMap(GainMap):
    """Endings of drops on a grid of walls; see `GainMap`.

    Attributes:
        swing: Swing of the samples in the last quarter [m], (K, B).
        ending: Values of `DropEnding`, (K, B).
    """

    parameters: DropMapParameters
    swing: Array
    ending: Array
    derived: ClassVar = ("endings", "settles_up_to")
    pictures: ClassVar = {"stability_drops": "maglev_mj.studies.pictures:drop_map"}
    endings: ClassVar = tuple(one.name.lower() for one in DropEnding)

    def _headline(self) -> str:
        most = float(self.settles_up_to.max())
        settled = f"all drops settle up to {most:.0f} N/m" if most else "no drop settles"
        return f"{super()._headline()} (theory); {settled}"

    @property
    def conditions(self) -> str:
        """See `Result`."""
        return f"{super().conditions}, {self.parameters.start}"

    def cells(self) -> dict[str, NDArray[Any]]:
        """Return swing and ending of each drop."""
        names = np.array([name.replace("_", " ") for name in self.endings])
        return {"swing": self.swing, "ending": names[self.ending.astype(np.intp)]}

    @property
    def settles(self) -> Mask:
        """Cells whose drop settles, (K, B)."""
        return np.asarray(self.ending == DropEnding.SETTLES)

    @property
    def settles_up_to(self) -> Array:
        """Largest stiffness below the first unsettled one [N/m], (B,).

        0 for none.

        Walls too soft to settle within the samples are skipped.
        """
        settles = self.settles
        over = ~settles & np.logical_or.accumulate(settles, axis=0)
        count = np.where(over.any(axis=0), np.argmax(over, axis=0), self.stiffness.size)
        return np.where(settles.any(axis=0), self.stiffness[np.maximum(count, 1) - 1], 0.0)

    @property
    def stable_by_theory(self) -> Mask:
        """Cells below theory's boundary, (K, B)."""
        return np.asarray(self.stiffness[:, None] <= self.boundary)

    def table(self) -> Table:
        """Return the stiffest walls, the endings of the drops, and their differences from theory."""
        p, settles, stable, up_to = self.parameters, self.settles, self.stable_by_theory, self.settles_up_to
        best, counts = int(np.argmax(up_to)), {one: int((self.ending == one).sum()) for one in DropEnding}
        rows = [
            (
                "stiffest wall with all softer ones settling",
                up_to[best],
                self.damping[best],
                "" if up_to[best] else "none settle",
            ),
            (
                "stiffest stable wall (theory)",
                float(self.maximum.stiffness),
                float(self.maximum.damping),
                "on a jump" if self.maximum.on_jump else "",
            ),
        ]
        note = (
            f"grid: {settles.size} walls, {stable.sum()} stable by theory\n"
            f"simulation: {counts[DropEnding.SETTLES]} settle in {SAMPLES} samples (to {p.band * 1e6:g} µm, or "
            f"decaying in contact), {counts[DropEnding.PERSISTS]} keep moving, {counts[DropEnding.RISES]} rise above "
            "the release height\n"
            f"disagreement: {(stable & ~settles).sum()} stable by theory do not settle, {(~stable & settles).sum()} "
            "unstable by theory settle"
        )
        head = "", "stiffness [N/m]", "damping [N s/m]", ""
        return Table(f"Drops on a {self.conditions}", head, rows, note)


def run_drop_map(
    parameters: DropMapParameters,
    *,
    record: Record | None = None,
    workers: Workers | None = None,
    progress: Callable[[int, int], None] | None = None,
    part: int = PART,
) -> DropMap:
    """Simulate drops on every wall of a grid.

    The grid is run in parts; each drop is judged by its samples.

    Args:
        parameters: The grid.
        record: Record of the finished parts; None for memory.
        workers: Workers that compute the parts; None for this process.
        progress: Function called with the number of walls done and the number of all.
        part: Number of walls simulated at once. It changes results by rounding only, and only with pulses.

    Raises:
        ParameterError: If a value is outside its bounds.
        StudyInterrupted: On Ctrl-C; the parts done are in the record.
    """
    damping, stiffness, best = gain_axes(parameters)
    count = stiffness.size * damping.size
    whole = parameters.as_json()
    parts: list[Cell] = [whole | {"first": first, "last": min(first + part, count)} for first in range(0, count, part)]

    def progress_of_walls(done: int, total: int) -> None:
        if progress is not None:
            progress(min(done * part, count), count)

    endings = partial(_endings_of_parts, parameters, stiffness, damping)
    results = run_cells(endings, parts, record=record, workers=workers, progress=progress_of_walls)
    if lost := [result for result in results if "swing" not in result]:
        raise MaglevError(f"map part without verdicts: {lost[0]!r}")
    shape = stiffness.size, damping.size
    swing, ending = (
        np.concatenate([result[name] for result in results]).reshape(shape) for name in ("swing", "ending")
    )
    boundary = boundary_of(parameters.loop().array(), damping)
    return DropMap(parameters, damping, stiffness, boundary, best, swing, ending)


def _endings_of_parts(
    parameters: DropMapParameters, stiffness: Array, damping: Array, cells: list[Cell]
) -> list[dict[str, Any]]:
    """Return swing and ending of each part's walls."""
    results = []
    for cell in cells:
        row, column = np.divmod(np.arange(cell["first"], cell["last"]), damping.size)
        swing, ending = drop_endings(stiffness[row], damping[column], parameters)
        results.append({"swing": swing.tolist(), "ending": ending.tolist()})
    return results


def drop_endings(stiffness: Array, damping: Array, parameters: DropMapParameters) -> tuple[Array, Array]:
    """Return how simulated drops on N walls end.

    Returns the last swing [m] and the `DropEnding`, (N,) each.

    Args:
        stiffness: Stiffness of each wall [N/m], (N,).
        damping: Damping of each [N s/m], (N,).
        parameters: Everything else; their grid is not used.
    """
    p, count = parameters, stiffness.size
    plant = wall_plant(
        Timing(period=p.period, delay=p.delay),
        height=np.full(count, p.height),
        quantum=p.quantize,
        lag=p.lag,
        mass=p.body,
        hand=get_hand(p.hand),
        wrench_limit=along("z", p.force_limit or _MOST_FORCE, math.inf),
    )
    controller = wall_controller(
        stiffness=stiffness,
        damping=damping,
        pulse=p.pulse,
        pulse_width=p.pulse_width,
        period=p.period,
        delay=p.delay,
        mass=p.body,
        moments=p.hardware.body.inertia,
        velocity=p.velocity,
    )
    quarters = _Quarters(count)
    with plant:
        drive(plant, controller, SAMPLES, observe=quarters)
    return quarters.endings(p)


class _Quarters:
    """Observer of extreme positions along z, by quarter.

    It covers the third and the last quarter of the samples.
    """

    def __init__(self, devices: int) -> None:
        self._least, self._most = np.full((2, devices), np.inf), np.full((2, devices), -np.inf)

    def __call__(self, sample: Sample, _: Command) -> None:
        """Process one sample."""
        if (quarter := 4 * sample.tick // SAMPLES - 2) >= 0:
            position = sample.position[2]
            np.minimum(self._least[quarter], position, out=self._least[quarter])
            np.maximum(self._most[quarter], position, out=self._most[quarter])

    def endings(self, p: DropMapParameters) -> tuple[Array, Array]:
        """Return last swing and ending, (N,) each."""
        before, swing = self._most - self._least
        inside = self._most.max(axis=0) <= 0.0
        settles = (swing <= p.band) | (inside & (swing < _DYING * before))
        rises = self._most[1] > p.height
        return swing, np.where(settles, DropEnding.SETTLES, np.where(rises, DropEnding.RISES, DropEnding.PERSISTS))
