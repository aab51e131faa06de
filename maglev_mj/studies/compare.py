"""Laws of a wall side by side in one scene.

Figures: contact over the sampler's phases, force noise and stability margins at rest in the wall.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from maglev_mj.control import Wall
from maglev_mj.control.controller import Controller
from maglev_mj.errors import DivergenceError, ParameterError, TooManyCallsError, check_one_of
from maglev_mj.frames import Array
from maglev_mj.keywords import checked, with_period
from maglev_mj.parameters import number, param, whole
from maglev_mj.result import Table, capitalised, plain, with_unit
from maglev_mj.scenes.find import SceneLike, get_scene
from maglev_mj.scenes.results import Figure, Variants, figure_head
from maglev_mj.scenes.run import run_phases, run_variants
from maglev_mj.scenes.scene import Scene
from maglev_mj.scenes.stability_check import UNKNOWN
from maglev_mj.scenes.wall_scene import WallScene, along
from maglev_mj.spec import GRAVITY
from maglev_mj.studies.cells import Study, local_workers
from maglev_mj.studies.designed_wall import hum
from maglev_mj.studies.record import Cell, Record
from maglev_mj.studies.stability_map import gain_axis, highest_damping, stiffest_in
from maglev_mj.studies.sweep import Grid, Sweep
from maglev_mj.studies.wall_laws import LAWS, LawMaker, WallLaw, laws_of, wall_law
from maglev_mj.theory import stated_gains
from maglev_mj.theory.critical import critical_ratios
from maglev_mj.theory.linearise import linearise
from maglev_mj.theory.loop import Bound, Doubt, Loop, Loops
from maglev_mj.theory.read import in_use, loops_at, partial_laws, scene_doubts, scene_lag, with_doubt
from maglev_mj.theory.verdict import Verdict, verdicts

_SHARES = {"": 50.0, "_10": 10.0, "_90": 90.0}
_BESIDE = {"final_z", "approach_speed", "contact_time", "final_force", "final_depth", "ripple", "force_ripple"}
"""Figures not compared: they depend on hand, weight or sensor more than on the law."""
_PICTURES = "maglev_mj.scenes.pictures"
_TOGETHER = 120  # points of a map
_TICKS = 800
"""Samples of a noise measurement."""
_UNITS = {"stiffness": "N/m", "noise": "N", "limit_cycle": "µm", "critical_stiffness": "N/m"}
_MAPPED = "critical_stiffness"
_MARGINS: Mapping[str, Figure] = {
    name: Figure(name, lambda result: None, _UNITS.get(name, ""), scale=1e6 if name == "limit_cycle" else 1.0)
    for name in ("stiffness", "noise", "limit_cycle", "spectral_radius", "critical_stiffness", "margin")
}
"""Figures of `Comparison.margins`."""
_MARGIN_HEADS = {"stiffness": "static stiffness", "critical_stiffness": "critical gain"}
"""Column heads that differ from the figure's name."""
_AT_REST = "at rest in the wall"
_ALONE = "a verdict in this table holds at rest in the wall, a warning over the whole range"
_MARGIN_NOTE = "margin = critical gain / gain in use; limit cycle: peak to peak, over a quantized sensor"


@dataclass(frozen=True, eq=False)
class Comparison(Variants):
    """Laws of a wall in one scene: runs and phases of `Variants` by law.

    Attributes:
        margins: Figures of each law at rest in the wall, in the scene's hand: `stiffness` against a slow push [N/m];
            `noise`, the standard deviation of the force over a quantized sensor [N], and `limit_cycle`, the
            peak-to-peak motion there [m], see `hum`; `spectral_radius`, that of the wall alone, or of free air if the
            law acts there and is less stable, below 1 for a stable wall; `critical_stiffness`, the stiffness gain at
            which stability changes, other gains unchanged [N/m]; and `margin`, its ratio to the law's gain. The last
            two are of type `Bound`: more than the end of the search if nothing changes; NaN if softer walls are
            unstable, and for a law without a stiffness.
        laws: Row of each law in the table of laws.
        scene: The scene with its own wall.
        reasons: Reason for NaN among the margins of a law, or for a verdict on a part of it, by law.
    """

    margins: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    laws: Mapping[str, WallLaw] = field(default_factory=dict)
    scene: Any = None
    reasons: Mapping[str, str] = field(default_factory=dict)

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return a row for each law, in SI units.

        Median, 10th and 90th percentile of each figure, its hits pooled, and the margins.
        """
        columns: dict[str, NDArray[Any]] = {"law": np.array(list(self.phases))}
        for name, one in self.first.scene.figures.items():
            for end, share in _SHARES.items():
                each = [one.percentile(np.ravel(phases.figures[name]), share) for phases in self.phases.values()]
                columns[name + end] = np.array(each)
        return columns | {name: np.array([one[name] for one in self.margins.values()]) for name in _MARGINS}

    @property
    def units(self) -> dict[str, str]:
        """Unit of each column."""
        units = {name + end: one.si_unit for name, one in self.first.scene.figures.items() for end in _SHARES}
        return units | {name: one.si_unit for name, one in _MARGINS.items()}

    @property
    def verdicts(self) -> dict[str, str]:
        """Verdict on each law at rest in the wall: stable, unstable or not computed."""
        return {label: _verdict(one["spectral_radius"]) for label, one in self.margins.items()}

    def as_json(self) -> dict[str, Any]:
        """Return the columns, and the figures of each law at each phase, ready for JSON."""
        head = {"scene": self.scene.name, "plant": self.first.plant, "parameters": self.scene.as_json()}
        margins = {name: [one[name] for one in self.margins.values()] for name in _MARGINS}  # with ends of searches
        columns = plain(self.columns() | margins) | {"verdict": list(self.verdicts.values())}
        return {**head, "columns": columns, "laws": plain(self.phases), "reasons": dict(self.reasons)}

    def table(self) -> Table:
        """Return a row for each law: its contact, and below its rest in the wall, and its equation."""
        figures: Mapping[str, Figure] = self.first.scene.figures
        verdicts = self.verdicts
        mark = {label: f"{label}{' (unstable)' * (text == 'unstable')}" for label, text in verdicts.items()}
        rows = [
            [mark[label], *(one.spread(phases.figures[name], _SHARES.values()) for name, one in figures.items())]
            for label, phases in self.phases.items()
        ]
        head = [with_unit(name.replace("_", " "), one.unit) for name, one in figures.items()]
        named = {name: _MARGIN_HEADS.get(name, name.replace("_", " ")) for name in _MARGINS}
        still = ["law", "verdict", *(with_unit(named[name], one.unit) for name, one in _MARGINS.items())]
        rest = [
            [label, verdicts[label], *(_scaled(one[name], figure.scale) for name, figure in _MARGINS.items())]
            for label, one in self.margins.items()
        ]
        equations = [[label, law.status, law.text] for label, law in self.laws.items()]
        alone = [_ALONE] * any("unstable" in text for text in self.warnings)
        below = [
            Table(_AT_REST, still, rest, "\n".join([_MARGIN_NOTE, *alone, *map(": ".join, self.reasons.items())])),
            Table("laws", ("law", "status", "equation; source"), equations),
        ]
        count = len(next(iter(self.phases.values())).phases)
        over = f"plant {self.first.plant}: median (10th to 90th percentile) over {count} sampling phases"
        return Table(f"{self._describe()}, {over}", ["law", *head], rows, below=below, warnings=self.warnings)

    def _describe(self) -> str:
        """Return the scene's description, with its pulse only for the laws that have one."""
        text: str = self.scene.replace(pulse=0.0).describe().removesuffix(", no pulse")
        first = {label: phases.scene.laws()[0] for label, phases in self.phases.items()}
        pulsed = [label for label, law in first.items() if np.any(getattr(law, "pulse", 0.0))]
        if not pulsed:
            return text
        return f"{text}, pulse {self.scene.pulse:g} N s/m for law{'s' * (len(pulsed) > 1)} {', '.join(pulsed)}"


def _scaled(value: float, scale: float) -> float:
    return Bound(scale * value, True) if _ends(value) else scale * value


def _ends(value: float) -> bool:
    """Return True for the end of a search."""
    return isinstance(value, Bound) and value.beyond


def _verdict(radius: float) -> str:
    return "not computed" if math.isnan(radius) else "stable" if radius < 1.0 else "unstable"


Laws = Collection[str | LawMaker] | Mapping[str, str | LawMaker]
"""Laws to compare; a mapping gives their labels."""


@checked(own="laws")
def compare(
    scene: SceneLike,
    laws: Laws,
    *,
    phases: int | ArrayLike = 100,
    phase: float = 0.5,
    plant: str = "exact",
    progress: Callable[[int, int], object] | None = None,
) -> Comparison:
    """Run laws in place of a scene's wall and compare their contact, noise and margins.

    A user-defined law is a class, or a function that returns a law or several. Its arguments are filled by name from
    the scene: any parameter, such as stiffness, damping, period, delay and mass; axes; lower, the edge of the wall;
    inertia; force_limit, infinite without a limit; and wall, the scene's own `Wall`. Other arguments need defaults.

    Args:
        scene: A scene with a wall, such as drop or press; see `run`.
        laws: Names from the table of laws, files as FILE.py or FILE.py:CLASS, which are run, classes or functions; a
            mapping gives their labels.
        phases: See `run_phases`.
        phase: Phase at which the motion is kept, for a picture.
        plant: Name from PLANTS.
        progress: See `run_phases`.

    Raises:
        ParameterError: If the scene has no wall, there is no such law, or it needs a missing parameter.
        DivergenceError: If a flotor leaves its range by a wide margin.

    Example:
        >>> from maglev_mj import compare
        >>> comparison = compare("drop", ["pd", "pulse"], phases=8)
        >>> (1e3 * comparison.columns()["penetration"]).round(2).tolist()  # [mm]
        [2.95, 2.13]
    """
    chosen, named = _chosen(scene, laws)
    variants = {label: _with_law(chosen, label, law, plant) for label, law in named.items()}
    at_rest = {label: _at_rest(variant) for label, variant in variants.items()}
    rest: Any = {"margins": {label: margins for label, (margins, _) in at_rest.items()}}
    rest["reasons"] = {label: "; ".join(reasons) for label, (_, reasons) in at_rest.items() if reasons}
    result = run_variants(variants, plant=plant, phase=phase, phases=phases, progress=progress)
    return Comparison(result.runs, result.phases, chaotic=result.chaotic, laws=named, scene=chosen, **rest)


def _chosen(scene: SceneLike, laws: Laws) -> tuple[WallScene, dict[str, WallLaw]]:
    """Return the scene and the row of each law by label."""
    chosen = get_scene(scene)
    if not isinstance(chosen, WallScene) or not isinstance(chosen.laws()[0], Wall):
        raise ParameterError(f"scene must have a wall as its first law, such as drop or press (got {chosen.name})")
    number("stiffness", chosen.stiffness, above=0.0)
    laws = [laws] if isinstance(laws, str) else laws
    named = (
        [(label, wall_law(law)[1]) for label, law in laws.items()] if isinstance(laws, Mapping) else map(wall_law, laws)
    )
    rows = dict(named)
    if len(rows) < max(len(laws), 1):
        raise ParameterError(f"laws must be at least one, without duplicates (got {', '.join(rows) or 'none'})")
    return chosen, rows


class LawSweep(Sweep):
    """Figure of each law, and its spectral radius at rest in the wall, over one parameter; see `Sweep`."""

    @property
    def pictures(self) -> Mapping[str, str]:  # type: ignore[override]
        """See `Result`."""
        kind = "map" if self._is_map else "vary"
        return {f"compare_{self.scene.name}_{kind}": "maglev_mj.studies.pictures:law_sweep"}

    @property
    def _is_map(self) -> bool:
        return (*self.varied, self.names[0]) == ("damping", "law", _MAPPED)

    def _headline(self) -> str:
        if self.names[0] != _MAPPED:
            return super()._headline()
        most = [*zip(self.varied["law"], np.fmax.reduce(self.figure(_MAPPED)).tolist())]
        unit = self.unit_along("N/m", True)
        stiffest = ", ".join(f"{k:.0f} {unit} ({law})" for law, k in most if math.isfinite(k))
        others = " and ".join(law for law, k in most if not math.isfinite(k))
        found = [f"stiffest stable wall {stiffest}"] * bool(stiffest) + [f"not computed for {others}"] * bool(others)
        return f"{capitalised(self.scene.name)}: {'; '.join(found)}"

    def table(self) -> Table:
        """Return the figure of each law at each value, marked where its wall is unstable."""
        (name, values), (_, laws) = self.varied.items()
        figure, one = self.names[0], self.shown(self.names[0])
        verdicts = np.vectorize(_verdict)(self.figure("spectral_radius"))
        marks = np.where((verdicts != "stable") & (figure != _MAPPED), np.char.add(" ", verdicts), "")
        texts = np.char.add(np.vectorize(one.text)(self.figure(figure)), marks).tolist()
        rows = [[f"{value:.6g}", *row] for value, row in zip(values, texts, strict=True)]
        title = f"{with_unit(figure_head(figure), one.unit)}, {self.conditions}"
        return Table(title, [with_unit(name, self.units[name]), *laws], rows, warnings=self.warnings)

    @property
    def warnings(self) -> Sequence[str]:
        """See `reasons`."""
        return self.reasons

    @property
    def reasons(self) -> Sequence[str]:
        """Why cells have no value or no verdict, and what a verdict leaves out, by law."""
        laws = self.columns()["law"].tolist()
        counts = Counter((law, text) for law, texts in zip(laws, self._marks) for text in texts.split("; ") if text)
        return [f"{law}, {count} of {laws.count(law)} cells: {text}" for (law, text), count in counts.items()]


def sweep_laws(
    scene: SceneLike,
    laws: Laws,
    name: str = "damping",
    values: Sequence[float] | int = 20,
    *,
    figure: str | None = None,
    phases: int | ArrayLike = 100,
    plant: str = "exact",
    progress: Callable[[int, int], None] | None = None,
) -> LawSweep:
    """Compare one figure of laws at several values of one parameter of a scene.

    A map of the stable region has the figure critical_stiffness over the damping; it is searched from 1/128 to 128
    times the scene's stiffness.

    Args:
        scene: See `compare`.
        laws: See `compare`.
        name: Parameter of the scene, such as stiffness, damping, rate or delay.
        values: Its values; for dampings also their number, up to 2.2 times that of the stiffest PD wall.
        figure: Figure of the contact, its median over the phases, or of `Comparison.margins`; the scene's first by
            default. NaN for the contact of a law that throws the flotor out.
        phases: See `compare`.
        plant: See `compare`.
        progress: Function called with the number of walls done and the number of all.

    Raises:
        ParameterError: If there is no such parameter or figure, a law in a map sets its own gains, or as `compare`.
    """
    chosen, named = _chosen(scene, laws)
    base: Any = type(chosen)
    known: Mapping[str, Figure] = type(_with_law(chosen, "", LAWS["pd"], plant)).figures | _MARGINS
    shown = figure or next(iter(known))
    check_one_of("figure", known, shown)
    if shown == _MAPPED and (fixed := [label for label, law in named.items() if law.gains]):
        raise ParameterError(f"law {fixed[0]} sets its own gains: it has no critical stiffness over {name}")
    if isinstance(values, int):
        if name != "damping":
            raise ParameterError(f"values of {name} must be a list of numbers (got {values})")
        count = whole("grid", values, at_least=2, at_most=1000)
        free: Any = {name: getattr(chosen, name) for name in ("period", "delay")}
        free |= {"inertia": float(chosen.body.inertia[2]), "driver_lag": scene_lag(chosen)}
        best = stiffest_in(Loop(stiffness=0.0, damping=0.0, **free))
        dampings = gain_axis(None, count, highest_damping(best, chosen.mass, chosen.period))
        values = list(np.unique([*dampings, chosen.damping]).tolist())

    class Swept(base):  # type: ignore[misc]
        __qualname__ = base.__qualname__  # in its text
        name, figures = base.name, {one: known[one] for one in (shown, "spectral_radius")}
        law: str = param("law", default=next(iter(named)), choices=tuple(named))

    def value_of(variant: WallScene) -> float:
        if shown in _MARGINS:
            value = _at_rest(variant)[0][shown]
            return math.nan if _ends(value) else value
        with suppress(DivergenceError):
            each = run_phases(variant, phases, plant=plant).figures[shown]
            return float(known[shown].percentile(np.ravel(each), 50.0))
        return math.nan

    def figures_of(some: Sequence[Cell]) -> list[dict[str, Any]]:
        rows = [dict[str, Any]()] * len(some)
        for label in dict.fromkeys(cell["law"] for cell in some):
            indices = [index for index, cell in enumerate(some) if cell["law"] == label]
            each = [chosen.replace(**{name: some[index][name] for name in vary}) for index in indices]
            variants = [_with_law(one, label, named[label], plant) for one in each]
            at_rest = _AtRest(variants)
            judged, radii = [*zip(variants, at_rest.present, strict=True)], [*map(_radius, at_rest.present)]
            ratios = at_rest.critical() if shown in (_MAPPED, "margin") else [Bound(math.nan)] * len(variants)
            if shown == _MAPPED:
                bases = [one.stiffness if verdict.loops[0].total[0] else math.nan for one, verdict in judged]
                values = [math.nan if ratio.beyond else ratio * one for ratio, one in zip(ratios, bases, strict=True)]
            else:
                values = [*map(value_of, variants)]
            notes = [
                [*(_reasons(*one, ratio) if math.isnan(value) or one[1].stable is None else ()), *_parts(*one)]
                for one, ratio, value in zip(judged, ratios, values, strict=True)
            ]
            for index, value, radius, texts in zip(indices, values, radii, notes, strict=True):
                marks = {"warnings": "; ".join(texts)} if texts else {}
                rows[index] = plain({shown: value, "spectral_radius": radius} | marks)
        return rows

    names = [one.name for one in chosen.parameters()]
    vary = with_period(names, {name: values})
    check_one_of("parameter", names, next(iter(vary)))
    grid: dict[str, Any] = {**vary, "law": list(named)}
    cells = Grid(Swept(**chosen.independent_values()), grid, plant=plant)
    # loops that differ in gains alone are computed together
    together = _TOGETHER if shown == _MAPPED and name in ("stiffness", "damping") else 1
    results = Study(figures_of, cells, Record(None), local_workers(0), progress).run(together)
    return LawSweep(Swept, grid, cells, results, 0, None)


def _with_law(scene: WallScene, label: str, law: WallLaw, plant: str) -> WallScene:
    """Return a scene with another law as its wall, and perceived hardness among its figures."""
    base: Any = type(scene)

    class Compared(base):  # type: ignore[misc]
        __qualname__ = base.__qualname__  # in its text
        name, title, series = base.name, base.title, Scene.series
        figures = {name: one for name, one in base.figures.items() if name not in _BESIDE} | {"hardness": "hardness"}
        plots: ClassVar = {
            f"compare_{base.name}": f"{_PICTURES}:first_contact",
            f"compare_{base.name}_phases": f"{_PICTURES}:spread",
        }

        def laws(self) -> list[Any]:
            parts = (laws_of(label, law.make, self, x) if isinstance(x, Wall) else [x] for x in base.laws(self))
            return list(chain.from_iterable(parts))

        def velocity_estimator(self) -> Any:
            return law.velocity or base.velocity_estimator(self)

    return Compared(**scene.independent_values() | (law.gains(scene, plant) if law.gains else {}))


class _AtRest:
    """Loops of a law at rest in the wall, and in free air if it acts there, in scenes that differ in gains alone.

    A law with declared gains is exact. Others are linearised at the depth at which the scene's wall carries the weight,
    all of them together if they can be stacked.
    """

    def __init__(self, scenes: Sequence[WallScene]) -> None:
        first, self.scenes = scenes[0], scenes
        self.hand, weight = getattr(first.scripted_hand(), "hand", None), float(first.body.inertia[0]) * GRAVITY
        own: Any = {"inertia": first.body.inertia, "device": first.device_clock}
        own["driver_lag"] = scene_lag(first)
        self._around: Any = {"delay": first.delay, "hand": self.hand, **own}
        self._poses = [[along(first.axis, -weight / scene.stiffness)] for scene in scenes]
        controllers = {index: scene.controller() for index, scene in enumerate(scenes)}
        some = {index: one for index, one in controllers.items() if stated_gains(one) is None}
        with suppress(TooManyCallsError):
            free = [-self._poses[index][0] for index in some]
            for index, near in zip(some, linearise([*some.values()], free, axes=first.axis) if some else ()):
                self._poses[index] += [-self._poses[index][0]] * bool(near.response.any() or not near.settled.all())
        self._doubts: Sequence[Doubt | None] = [None] * len(scenes)
        with suppress(TooManyCallsError):
            self._doubts = scene_doubts(scenes, first.axis_index) if some else self._doubts

    def loops(self, indices: Sequence[int], ratios: Sequence[float]) -> list[Loops]:
        """Return the loops of some scenes at ratios of their stiffness, in the wall first; none out of its bounds."""
        rows: list[tuple[int, Controller, Array]] = []
        for row, (index, ratio) in enumerate(zip(indices, ratios, strict=True)):
            scene = self.scenes[index]
            with suppress(ParameterError):
                controller = scene.replace(stiffness=ratio * scene.stiffness).controller()
                rows += [(row, controller, pose) for pose in self._poses[index]]
        each, stated = [list[Loop]() for _ in indices], True
        if rows:
            order, controllers, poses = zip(*rows)
            sizes: Any = in_use(self._doubts[indices[order[0]]])  # of equal laws with other gains
            found = loops_at(controllers, self.scenes[0].axis_index, poses=poses, **self._around, **sizes)
            for row, loop in zip(order, found, strict=True):
                each[row].append(loop)
            stated = found.stated
        every = (with_doubt(some, self._doubts[index]) for some, index in zip(each, indices, strict=True))
        return [Loops(tuple(some), stated) for some in every]

    @cached_property
    def present(self) -> list[Verdict]:
        """Verdict on each scene."""
        return verdicts(self.loops(range(len(self.scenes)), [1.0] * len(self.scenes)))

    def critical(self) -> list[Bound]:
        """Return the ratio of critical to present stiffness of each scene: all softer walls are stable."""
        return critical_ratios(self.loops, [verdict.loops for verdict in self.present])


def _radius(verdict: Verdict) -> float:
    """Return the spectral radius; NaN if not judged in one of the places."""
    return math.nan if verdict.stable is None else verdict.spectral_radius


def _at_rest(scene: WallScene) -> tuple[dict[str, float], list[str]]:
    """Return the figures of a scene's first law at rest, and why some are NaN or hold for a part of its laws.

    Laws that state no gains rest at the depth at which the scene's own wall carries the weight.
    """
    at_rest = _AtRest([scene])
    (verdict,), (ratio,) = at_rest.present, at_rest.critical()
    stiffness, radius = verdict.loops[0].total[0], _radius(verdict)
    margin = ratio if ratio > 0.0 else Bound(math.nan)
    law: Any = scene.laws()[0]
    around: Any = {name: getattr(scene, name) for name in ("delay", "period", "mass")}
    around |= {"hand": at_rest.hand, "quantum": scene.quantize or scene.hardware.sensor.resolution[2]}
    around["device"] = scene.device_clock
    rest = stiffness if 1.0 < stiffness < 1e9 else scene.stiffness
    swing, force = hum(0.0, law=scene.controller(), stiffness=rest, duration=_TICKS * scene.period, **around)
    gain = Bound(margin * float(getattr(law, "stiffness", math.nan)), margin.beyond)
    margins = dict(zip(_MARGINS, (stiffness, force.item(), swing.item(), radius, gain, margin), strict=True))
    reasons = [] if ratio.beyond else [*_reasons(scene, verdict, ratio)]
    if not reasons and math.isnan(gain):
        reasons.append("no critical gain: the law has no gain called stiffness")
    return margins, [*reasons, *_parts(scene, verdict)]


def _reasons(scene: WallScene, verdict: Verdict, ratio: Bound) -> Iterator[str]:
    """Yield why a law is not judged, or has no critical gain."""
    if verdict.stable is None:
        yield f"{UNKNOWN}: {next((loop.reason for loop in verdict.loops if loop.reason), 'no finite force')}"
    elif not verdict.loops[0].total[0]:
        yield "no critical gain: the law has no stiffness at rest"
    elif ratio == 0.0:
        yield "no critical gain: softer walls are unstable"
    elif ratio.beyond:
        yield f"critical gain more than {ratio * scene.stiffness:.4g} N/m ({ratio:.3g} times; end of the search)"


def _parts(scene: WallScene, verdict: Verdict) -> Iterator[str]:
    """Yield what a verdict on a law leaves out."""
    if partial := partial_laws(scene.controller()):
        yield f"{' and '.join(partial)} as declared, without the rest"
    if left_out := dict.fromkeys(axis for loop in verdict.loops for axis in loop.left_out):
        yield f"coupling of {scene.axis} to {', '.join(left_out)} left out"
