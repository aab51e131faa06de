"""Every scene that can be swept: its parameters, and the figures of one cell."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields
from functools import lru_cache
from typing import Any

import numpy as np

import maglev_mj
import maglev_mj.theory as theory
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.experiments.drop import DropParameters, run_drop
from maglev_mj.experiments.stick_slip import StickSlipParameters, run_stick_slip
from maglev_mj.hand import hand_called
from maglev_mj.parameters import number, parsed_number
from maglev_mj.scenes.choices import PLANTS
from maglev_mj.spec import Spec
from maglev_mj.studies.cells import Cell
from maglev_mj.studies.growth import RestingWall, measure_growth
from maglev_mj.theory.closed_loop import MOST_PERIODS, LoopKeywords

__all__ = ["SCENES", "Scene", "WallParameters", "cell_of", "run_scene_cells", "value_of"]


@dataclass(frozen=True, kw_only=True)
class WallParameters:
    """One wall that the flotor rests in.

    Attributes:
        plant: "none" for theory alone, "exact" or "mujoco".
        stiffness: Wall stiffness [N/m].
        damping: Wall damping [N s/m].
        period: Sample period [s].
        delay: Transport delay [s].
        mass: Moving mass [kg].
        hand: See `hand_called`.

    Raises:
        ParameterError: If a value is outside its bounds.
    """

    plant: str = "none"
    stiffness: float = 6000.0
    damping: float = 80.0
    period: float = 1.0 / Spec.control_rate.value
    delay: float = Spec.transport_delay.value
    mass: float = Spec.moving_mass.value
    hand: str = "none"

    def __post_init__(self) -> None:
        if self.plant not in ("none", *PLANTS):
            raise ParameterError(f"plant must be one of none, {', '.join(PLANTS)}, not {self.plant!r}")
        hand_called(self.hand)
        for name, allowed in (
            ("stiffness", {"above": 0.0, "at_most": 1e8}),
            ("damping", {"at_least": 0.0, "at_most": 1e6}),
            ("period", {"at_least": 1e-6, "at_most": 1.0}),
            ("delay", {"at_least": 0.0, "at_most": MOST_PERIODS * number("period", self.period)}),
            ("mass", {"at_least": 1e-3, "at_most": 1e3}),
        ):
            object.__setattr__(self, name, number(name, getattr(self, name), **allowed))


@lru_cache(maxsize=1024)
def _stiffest(period: float, delay: float, mass: float, hand: str) -> theory.StiffestWall:
    """Return what does not depend on the gains, once for all of them."""
    return theory.stiffest_wall(period=period, delay=delay, mass=mass, hand=hand_called(hand))


def _wall(p: WallParameters) -> dict[str, Any]:
    loop: LoopKeywords = {"period": p.period, "delay": p.delay, "mass": p.mass, "hand": hand_called(p.hand)}
    stiffest = _stiffest(p.period, p.delay, p.mass, p.hand)
    figures: dict[str, Any] = {
        "modulus": float(theory.largest_modulus(p.stiffness, p.damping, **loop)),
        "largest_stiffness": float(theory.largest_stable_stiffness(p.damping, **loop)),
        "stiffest_wall": float(stiffest.stiffness),
        "at_damping": float(stiffest.damping),
    }
    if p.plant != "none":
        walls = RestingWall(plant=p.plant, period=p.period, delay=p.delay, mass=p.mass, hand=hand_called(p.hand))
        growth = measure_growth([p.stiffness], [p.damping], walls)
        figures |= {"simulated_rate": float(growth.rate[0]), "simulated_stable": bool(growth.stable[0])}
    return figures


def _drop(p: DropParameters) -> dict[str, Any]:
    figures: dict[str, Any] = run_drop(p).as_json()["summary"]
    return figures


def _stick_slip(p: StickSlipParameters) -> dict[str, Any]:
    figures: dict[str, Any] = run_stick_slip(p).as_json()["summary"]
    return figures


@dataclass(frozen=True)
class Scene:
    """What a sweep needs to know: the parameters' class, the figures of one cell, a line of help."""

    parameters: type[Any]
    figures: Callable[[Any], dict[str, Any]]
    help: str


SCENES: Mapping[str, Scene] = {
    "drop": Scene(DropParameters, _drop, "the flotor dropped on a wall"),
    "stick-slip": Scene(StickSlipParameters, _stick_slip, "the flotor pulled out of friction"),
    "wall": Scene(WallParameters, _wall, "the flotor resting in a wall: is it stable?"),
}


def cell_of(scene: str, values: Mapping[str, Any]) -> Cell:
    """Return the cell of a scene: every parameter, checked, with what makes the result repeatable.

    Raises:
        ParameterError: If there is no such scene, or a value is outside its bounds.
    """
    made = _scene(scene).parameters
    return {"scene": scene, "version": maglev_mj.__version__, **asdict(made(**values))}


def value_of(scene: str, name: str, text: str) -> Any:
    """Return what a word stands for as the value of a parameter: a number, a truth value, or a name.

    Raises:
        ParameterError: If there is no such scene or parameter, or the word is not of its kind.
    """
    kinds = {item.name: str(item.type) for item in fields(_scene(scene).parameters)}
    if name not in kinds:
        raise ParameterError(f"parameter of {scene} must be one of {', '.join(kinds)}, not {name!r}")
    kind = kinds[name]
    if kind == "str":
        return text
    if kind == "bool":
        if text.lower() not in ("true", "false"):
            raise ParameterError(f"{name} must be true or false, not {text!r}")
        return text.lower() == "true"
    if "None" in kind and text.lower() == "none":
        return None
    return parsed_number(name, text)


def _scene(name: str) -> Scene:
    if name not in SCENES:
        raise ParameterError(f"scene must be one of {', '.join(SCENES)}, not {name!r}")
    return SCENES[name]


def run_scene_cells(cells: list[Cell]) -> list[dict[str, Any]]:
    """Return the figures of each cell; {"error": ...} where the run itself failed, as one that diverges does."""
    return [_run(dict(cell)) for cell in cells]


def _run(cell: Cell) -> dict[str, Any]:
    scene = SCENES[cell.pop("scene")]
    cell.pop("version")
    try:
        figures = scene.figures(scene.parameters(**cell))
    except MaglevError as error:
        return {"error": str(error)}
    return {name: _plain(value) for name, value in figures.items()}


def _plain(value: Any) -> Any:
    """Return a figure as JSON has it: None for one that is not there."""
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value
