"""Laws of a wall side by side in one scene.

Figures: contact over the sampler's phases, force noise and stability margins at rest in the wall.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from inspect import Parameter, signature
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from maglev_mj.control import Law, ObserverWall, PredictiveWall, Wall
from maglev_mj.errors import ParameterError, check_instance, check_one_of
from maglev_mj.parameters import number
from maglev_mj.plants.model import load_model
from maglev_mj.result import Table, plain, with_unit
from maglev_mj.scenes.find import SceneLike, class_in_file, get_scene
from maglev_mj.scenes.results import Figure, Variants
from maglev_mj.scenes.run import run_variants
from maglev_mj.scenes.scene import Scene
from maglev_mj.scenes.stability_check import wall_margin
from maglev_mj.scenes.wall_scene import WallScene
from maglev_mj.spec import Spec
from maglev_mj.studies.designed_wall import hum
from maglev_mj.theory import least_passive_damping

_SHARES = {"": 50.0, "_10": 10.0, "_90": 90.0}
_BESIDE = {"final_z", "approach_speed", "contact_time", "final_force", "final_depth", "ripple", "force_ripple"}
"""Figures not compared: they depend on hand, weight or sensor more than on the law."""
_PICTURES = "maglev_mj.scenes.pictures"
_TICKS = 800
"""Samples of a noise measurement."""

LawMaker = Callable[..., Law]
"""Class of a law, or function that returns one, of numbers that `compare` gives by name."""


def _pd(wall: Wall) -> Wall:
    return replace(wall, pulse=0.0)


LAWS: Mapping[str, LawMaker] = {
    "pd": _pd,
    "pulse": lambda wall: wall,
    "half-sample": PredictiveWall,
    "observer": ObserverWall,
    "colgate": partial(_pd),
}
"""Laws by name; colgate is pd at the largest passive stiffness, without damping."""
ORIGINS = dict(zip(LAWS, ("as published", "as published", "modified", "own", "modified"), strict=True))
"""Whether a law is its source's equation, a modification of it, or the project's own."""


_MARGINS = {"stiffness": "N/m", "noise": "N", "spectral_radius": "", "critical_stiffness": "N/m", "margin": ""}
"""Unit of each figure of `Comparison.margins`."""
_MARGIN_HEADS = {"stiffness": "static stiffness", "critical_stiffness": "critical gain"}
"""Column heads that differ from the figure's name."""
_AT_REST = "at rest in the wall"
_MARGIN_NOTE = "margin = critical gain / gain in use"


@dataclass(frozen=True, eq=False)
class Comparison(Variants):
    """Laws of a wall in one scene: runs and phases of `Variants` by law.

    Attributes:
        margins: Figures of each law at rest in the wall, in the scene's hand: `stiffness` against a slow push [N/m];
            `noise`, the standard deviation of the force over a quantized sensor [N], see `hum`; `spectral_radius`,
            that of the wall alone, below 1 for a stable wall; `critical_stiffness`, the stiffness gain at
            which stability changes, other gains unchanged [N/m]; and `margin`, its ratio to the law's gain. The last
            two are NaN if nothing changes up to ten times the gain, and for a law without a stiffness.
        scene: The scene with its own wall.
    """

    margins: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    scene: Any = None

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
        return units | _MARGINS

    def as_json(self) -> dict[str, Any]:
        """Return the columns, and the figures of each law at each phase, ready for JSON."""
        head = {"scene": self.scene.name, "plant": self.first.plant, "parameters": self.scene.as_json()}
        return {**head, "columns": plain(self.columns()), "laws": plain(self.phases)}

    def table(self) -> Table:
        """Return a row for each law: its contact, and below its rest in the wall."""
        figures: Mapping[str, Figure] = self.first.scene.figures
        unstable = [label for label, one in self.margins.items() if one["spectral_radius"] >= 1.0]
        mark = {label: f"{label}{' (unstable)' * (label in unstable)}" for label in self.margins}
        rows = [
            [mark[label], *(one.spread(phases.figures[name], _SHARES.values()) for name, one in figures.items())]
            for label, phases in self.phases.items()
        ]
        head = [with_unit(name.replace("_", " "), one.unit) for name, one in figures.items()]
        named = {name: _MARGIN_HEADS.get(name, name.replace("_", " ")) for name in _MARGINS}
        still = ["law", *(with_unit(named[name], unit) for name, unit in _MARGINS.items())]
        rest = [[mark[label], *one.values()] for label, one in self.margins.items()]
        below = Table(_AT_REST, still, rest, _MARGIN_NOTE)
        count = len(next(iter(self.phases.values())).phases)
        over = f"plant {self.first.plant}: median (10th to 90th percentile) over {count} sampling phases"
        return Table(f"{self._describe()}, {over}", ["law", *head], rows, below=[below], warnings=self.warnings)

    def _describe(self) -> str:
        """Return the scene's description, with its pulse only for the laws that have one."""
        text: str = self.scene.replace(pulse=0.0).describe().removesuffix(", no pulse")
        first = {label: phases.scene.laws()[0] for label, phases in self.phases.items()}
        pulsed = [label for label, law in first.items() if np.any(getattr(law, "pulse", 0.0))]
        if not pulsed:
            return text
        return f"{text}, pulse {self.scene.pulse:g} N s/m for law{'s' * (len(pulsed) > 1)} {', '.join(pulsed)}"


def compare(
    scene: SceneLike,
    laws: Collection[str | LawMaker] | Mapping[str, str | LawMaker],
    *,
    phases: int | ArrayLike = 100,
    phase: float = 0.5,
    plant: str = "exact",
    progress: Callable[[int, int], object] | None = None,
) -> Comparison:
    """Run laws in place of a scene's wall and compare their contact, noise and margins.

    A user-defined law is a class, or a function that returns a law. Its arguments are filled by name from the scene:
    any parameter, such as stiffness, damping, period, delay and mass; axes; lower, the edge of the wall; inertia;
    force_limit, infinite without a limit; and wall, the scene's own `Wall`. Other arguments need defaults.

    Args:
        scene: A scene with a wall, such as drop or press; see `run`.
        laws: Names from `LAWS`, files as FILE.py or FILE.py:CLASS, which are run, classes or functions; a mapping gives
            their labels.
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
        [2.95, 1.76]
    """
    chosen = get_scene(scene)
    if not isinstance(chosen, WallScene) or not isinstance(chosen.laws()[0], Wall):
        raise ParameterError(f"scene must have a wall as its first law, such as drop or press (got {chosen.name})")
    number("stiffness", chosen.stiffness, above=0.0)
    laws = [laws] if isinstance(laws, str) else laws
    named = [(label, _named(law)[1]) for label, law in laws.items()] if isinstance(laws, Mapping) else map(_named, laws)
    variants = {label: _with_law(chosen, label, law, plant) for label, law in named}
    if len(variants) < max(len(laws), 1):
        raise ParameterError(f"laws must be at least one, without duplicates (got {', '.join(variants) or 'none'})")
    margins = {label: _margins(variant) for label, variant in variants.items()}
    result = run_variants(variants, plant=plant, phase=phase, phases=phases, progress=progress)
    return Comparison(result.runs, result.phases, chaotic=result.chaotic, margins=margins, scene=chosen)


def _named(law: str | LawMaker) -> tuple[str, LawMaker]:
    """Return the label of a law and the law."""
    if isinstance(law, str) and ".py" not in law:
        check_one_of("law", LAWS, law, ", or your own FILE.py[:CLASS]")
        return law, LAWS[law]
    own = class_in_file(law, Law) if isinstance(law, str) else law
    check_instance("law", own, Callable, "a name, FILE.py[:CLASS] or a function that returns a Law")
    return getattr(own, "__name__", str(own)), own


def _with_law(scene: WallScene, label: str, maker: LawMaker, plant: str) -> WallScene:
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
            return [_law_of(label, maker, self, one) if isinstance(one, Wall) else one for one in base.laws(self)]

    return Compared(**scene.independent_values() | (_passive(scene, plant) if maker is LAWS["colgate"] else {}))


def _passive(scene: WallScene, plant: str) -> dict[str, float]:
    """Return the gains of the stiffest passive spring, without damping, on a device with damping of its own."""
    model, damping = scene.plant_options().get("model"), 0.0
    if plant != "exact" and model is not None:
        device = load_model(model)
        damping = float(device.model.dof_damping[device.velocity_address + scene.axis_index])
    if not damping:
        raise ParameterError(
            "no passive spring: the device has no damping of its own; law colgate needs joint damping in the model of "
            f"plant mujoco (got {damping:g} N s/m on {scene.axis})"
        )
    least = least_passive_damping(1.0, period=scene.period, delay=scene.delay)
    return {"stiffness": damping / float(least), "damping": 0.0, "pulse": 0.0}


def _hand(scene: WallScene) -> Any:
    return getattr(scene.scripted_hand(), "hand", None)


def _law_of(label: str, maker: LawMaker, scene: WallScene, wall: Wall) -> Law:
    """Return a maker's law for the numbers of a scene."""
    numbers = scene.independent_values() | {"axes": scene.axis, "lower": 0.0, "inertia": scene.mass, "wall": wall}
    numbers["force_limit"] = math.inf if scene.force_limit is None else scene.force_limit
    takes, fixed = signature(maker).parameters, getattr(maker, "keywords", {})
    for name, one in takes.items():
        if one.default is Parameter.empty and name not in numbers:
            raise ParameterError(f"law {label} must have a default for {name}; {scene.name} has {', '.join(numbers)}")
    return maker(**{name: value for name, value in numbers.items() if name in takes and name not in fixed})


def _margins(scene: WallScene) -> dict[str, float]:
    """Return the figures of a scene's first law at rest.

    Laws that state no gains rest at the depth at which the scene's own wall carries the weight.
    """
    at_rest = wall_margin(scene, held=True)
    assert at_rest is not None
    stiffness, spectral_radius, margin = at_rest
    law: Any = scene.laws()[0]
    around: Any = {name: getattr(scene, name) for name in ("delay", "period", "mass")}
    around |= {"hand": _hand(scene), "quantum": scene.quantize or Spec.translation_resolution.value}
    rest = stiffness if 1.0 < stiffness < 1e9 else scene.stiffness
    noise = hum(0.0, law=law, stiffness=rest, duration=_TICKS * scene.period, **around).force.item()
    gain = margin * float(getattr(law, "stiffness", math.nan))
    return dict(zip(_MARGINS, (stiffness, noise, spectral_radius, gain, margin), strict=True))
