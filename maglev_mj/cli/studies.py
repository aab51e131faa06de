"""Commands that answer a question by theory and many runs."""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, TypeAlias

import numpy as np

from maglev_mj.cli.declare import Option, Parser, Shared, declare, declared, option
from maglev_mj.cli.options import (
    Json,
    Picture,
    Pictures,
    add_parameters,
    add_phase,
    add_scene,
    chosen,
    chosen_scene,
    described,
    given,
    json_of,
    parameters,
    pictures_to,
    range_of,
    scene_class,
)
from maglev_mj.cli.output import Progress, check_folder, write_result, write_results
from maglev_mj.errors import ParameterError
from maglev_mj.parameters import parsed_number
from maglev_mj.pictures import PictureFolder
from maglev_mj.plants.hand import HANDS
from maglev_mj.result import plain
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.find import find_scene
from maglev_mj.scenes.scene import Scene
from maglev_mj.studies.card import device_card
from maglev_mj.studies.cells import StudyInterrupted, Workers, WorkersError, dask_workers, local_workers
from maglev_mj.studies.compare import LAWS
from maglev_mj.studies.compare import compare as compare_laws
from maglev_mj.studies.designed_wall import Contact, evaluate_wall
from maglev_mj.studies.drop_map import PART, DropMapParameters, run_drop_map
from maglev_mj.studies.fidelity import (
    COMPARED,
    MARGIN,
    Range,
    levels_table,
    measure_fidelity,
    measure_levels,
    preset_of,
)
from maglev_mj.studies.record import Record, json_text
from maglev_mj.studies.stability_map import StabilityParameters, run_stability
from maglev_mj.studies.sweep import MOST_CELLS, Grid, value_of
from maglev_mj.studies.sweep import sweep as run_sweep
from maglev_mj.terminal import wrapped
from maglev_mj.theory import WallRequirements, design_wall
from maglev_mj.theory import stability as judge
from maglev_mj.versions import hash_of


@dataclass(frozen=True, kw_only=True)
class WorkerOptions:
    """Chosen workers of a study."""

    workers: Annotated[int | None, option("processes on this machine; 0 for this one alone", "workers")] = None
    scheduler: Annotated[
        str | None, option("run on the Dask cluster of this scheduler instead", "workers", "ADDRESS")
    ] = None
    command: Annotated[str, Shared(None, lambda options: options.command)]

    def open(self, default: int | None) -> Workers:
        """Return the workers.

        By default `default` processes; None for one per processor.
        """
        if self.scheduler is None:
            return local_workers(default if self.workers is None else self.workers)
        if self.workers is not None:
            raise ParameterError(f"workers must be left to the scheduler where there is one, not {self.workers}")
        with warnings.catch_warnings(record=True) as caught:
            workers = dask_workers(self.scheduler)
        for warning in caught:
            print(f"maglev-mj {self.command}: {warning.message}", file=sys.stderr)
        return workers


def cells_in(purpose: str) -> Option:
    """Declare the record of a study's cells."""
    return option(f"{purpose}; a folder of tables", "output", "DIR")


@contextmanager
def cells_kept(path: Path | None, fallback: Path) -> Iterator[None]:
    """Write the cells of an interrupted study to a new folder.

    Only if they are not in a record yet; the error names the folder.
    """
    try:
        yield
    except (StudyInterrupted, WorkersError) as stopped:
        kept = stopped.record
        if path is None:
            kept.path = path = fallback.with_name(f"{fallback.name}-{kept.name}")
            kept.flush()
        where = f"{kept.done.sum()} cells are in {path}, the same command with --record {path} goes on from there"
        stopped.args = (f"{stopped}; {where}",)
        raise


def _list_parameters(parser: Parser, cls: type[Scene]) -> None:
    """List a scene's parameters in the help."""
    texts = {"plant": f"{', '.join(cls.plants)} (default {cls.plants[0]})"}
    if cls.takes_phase:
        texts["phase"] = "of the samples, in [0, 1) (default 0)"
    texts |= {one.name: described(one, getattr(cls(), one.name)) for one in cls.parameters()}
    lines = [line for name, text in texts.items() for line in wrapped(text, f"  {name:<15}", " " * 17)]
    parser.epilog = "\n".join([f"parameters of {cls.name}:", *lines])


_SweptScene: TypeAlias = Annotated[
    type[Scene], Shared(partial(add_scene, more=_list_parameters, options=False), scene_class)
]
SceneName: TypeAlias = Annotated[str, Shared(None, lambda options: options.scene)]


def sweep(
    *,
    scene: _SweptScene,
    name: SceneName,
    vary: Annotated[
        list[str],
        option(
            "its values: LOW:HIGH:COUNT evenly spread, A,B,C, or A;B;C where values have commas; repeat for a grid",
            "grid",
            "NAME=VALUES",
        ),
    ],
    set: Annotated[list[str], option("a parameter that is not its default", "grid", "NAME=VALUE")],
    json: Annotated[str | None, json_of("all cells and figures")] = None,
    record: Annotated[
        Path | None,
        cells_in("results land here as they come, and what is here is not done again (SCENE-sweep-GRID)"),
    ] = None,
    workers: WorkerOptions,
    pictures: Picture,
) -> int:
    """Any scene over a grid of its parameters."""
    fixed = {name: [value_of(scene, name, text)] for name, text in _assignments(set).items()}
    varied = {name: _values(scene, name, text) for name, text in _assignments(vary).items()}
    if not varied:
        raise ParameterError(f"a sweep needs --vary NAME=VALUES; for one run: maglev-mj run {name}")
    if both := sorted(fixed.keys() & varied.keys()):
        raise ParameterError(f"{both[0]} must be either set or varied, not both")
    if pictures is not None and not scene.figures and scene.run_figures is None:
        raise ParameterError(f"out must be left out: {scene.name} has no figures to draw")
    path = record
    if path is None:  # another grid gets another
        grid = hash_of(json_text("a grid", Grid(scene(), fixed | varied).plan))[:8]
        path = Path(f"{scene.name}-sweep-{grid}")
        check_folder("record", path)
    running = workers.open(default=None)
    with cells_kept(path, path), Progress(f"sweep {scene.name}") as progress:
        result = run_sweep(scene, fixed | varied, workers=running, record=path, progress=progress)
    result = replace(result, varied=varied)  # a set parameter is no dimension of the grid
    write_result(json, result, pictures, "sweep")
    return 0


def _assignments(words: list[str]) -> dict[str, str]:
    """Return parameters and the text of their values."""
    result: dict[str, str] = {}
    for word in words:
        name, equals, text = word.partition("=")
        name = name.replace("-", "_")
        if not (name and equals and text):
            raise ParameterError(f"a parameter must be given as NAME=VALUE, not {word!r}")
        if name in result:
            raise ParameterError(f"{name} must be given once, not as {result[name]} and {text}")
        result[name] = text
    return result


def _values(cls: type[Scene], name: str, text: str) -> list[Any]:
    """Return the values of a swept parameter."""
    parts = text.split(":")
    if len(parts) == 1:
        return [value_of(cls, name, part) for part in text.split(";" if ";" in text else ",")]
    try:
        low, high, count = parsed_number(name, parts[0]), parsed_number(name, parts[1]), int(parts[2])
    except (ValueError, IndexError):
        count = 0
    if len(parts) != 3 or not 1 <= count <= MOST_CELLS:
        raise ParameterError(f"{name} must vary as LOW:HIGH:COUNT, A,B,C or A;B;C, not {text!r}")
    value_of(cls, name, parts[0])  # is there such a parameter, and is it a number?
    return [float(value) for value in np.linspace(low, high, count)]


def compare(
    *,
    scene: Annotated[Scene, Shared(add_scene, chosen_scene)],
    law: Annotated[
        list[str], option(f"{', '.join(LAWS)}, or one's own, which is run: FILE.py, FILE.py:CLASS", "laws", "LAW")
    ],
    phases: Annotated[int, option("phases of the samples, evenly spread over a period")] = 100,
    plant: Annotated[str, option("exact, or mujoco", metavar="NAME")] = "exact",
    json: Json = None,
    pictures: Pictures,
) -> int:
    """Laws of a wall side by side in a scene: contact, noise and margins.

    Repeat --law for each law. A figure of the contact is its median, and 10 to 90 %, over phases of the samples.
    """
    with Progress(f"compare {scene.name}") as progress:
        result = compare_laws(scene, law, phases=phases, plant=plant, progress=progress)
    write_result(json, result, pictures)
    return 0


_WALL = "parameters of a wall"
_DROP = "a map of drops instead, where one of these is given"
_NEEDED = "what the wall must bear"
_RANGE = "what the answer is to hold for"


def _add_ranges(parser: Parser, group: str, cls: Any, names: Sequence[str]) -> None:
    """Add options of one or two values, for parameters that are ranges."""
    for name in names:
        one = cls.parameter(name)
        shown = "(default: what shows the stable region)" if one.default is None else f"(default {one.default[0]:g})"
        text = f"{one.help} [{one.unit}]: LOW HIGH, LOW:HIGH, or one value {shown}"
        parser.group(group).add_argument(f"--{name}", nargs="+", metavar="X", help=text)


def _given_ranges(options: argparse.Namespace, names: Sequence[str]) -> dict[str, Any]:
    return {name: range_of(name, words) for name in names if (words := getattr(options, name)) is not None}


def _add_map(parser: Parser) -> None:
    _add_ranges(parser, _WALL, StabilityParameters, ("damping", "stiffness"))
    add_parameters(parser.group(_WALL), StabilityParameters)
    add_parameters(parser.group(_DROP), DropMapParameters)


def _chosen_map(options: argparse.Namespace) -> StabilityParameters | DropMapParameters:
    """Return the parameters of a map of walls, or of drops if one is given."""
    ranges = _given_ranges(options, ("damping", "stiffness"))
    drops = given(options, DropMapParameters) - given(options, StabilityParameters)
    return chosen(options, DropMapParameters if drops else StabilityParameters, **ranges)


_Map: TypeAlias = Annotated[StabilityParameters | DropMapParameters, Shared(_add_map, _chosen_map)]


def stability_map(
    *,
    region: _Map,
    json: Json = None,
    pictures: Annotated[PictureFolder | None, pictures_to("write the picture to this folder")],
    record: Annotated[Path | None, cells_in("cells done are kept here and not done again")] = None,
    workers: WorkerOptions,
) -> int:
    """Where a wall is stable, by theory and simulation (figure 2); or whether a scene is."""
    if pictures is not None:
        for name in ("damping", "stiffness"):
            if (limits := getattr(region, name)) is not None and limits[0] == limits[1]:
                raise ParameterError(f"{name} must be a range for a picture, not {limits[0]:g} alone")
    drops = isinstance(region, DropMapParameters)
    if record is not None and not drops and region.plant == "none":
        raise ParameterError(f"record must be left out with plant none, which has no cells to keep, not {record}")
    # a map of drops is simulated on every core where it has more than one part
    running = workers.open(default=None if drops and region.grid**2 > PART else 0)
    run: Any = run_drop_map if drops else run_stability
    with cells_kept(record, Path("stability-cells")), Progress("stability") as progress:
        result = run(region, record=Record(record), workers=running, progress=progress)
    write_result(json, result, pictures, "stability_drops" if drops else "stability")
    return 0


def _add_stability_scene(parser: Parser) -> None:
    """Add the scene, or without one the options of a map."""
    add_scene(parser, instead=partial(declare, stability_map))
    parser.group(_WALL)


_JudgedScene: TypeAlias = Annotated[Scene, Shared(_add_stability_scene, chosen_scene)]


def stability(*, scene: _JudgedScene, json: Json = None) -> int:
    """Where a wall is stable, by theory and simulation (figure 2); or whether a scene is."""
    verdict = judge(scene)
    data = {"scene": scene.name, "parameters": scene.as_json(), **verdict.as_json()}
    heading = "\n".join(wrapped(f"{scene.name}: {scene.describe()}", "", "  "))
    write_results(json, lambda: data, lambda: f"{heading}\n{verdict.table()}")
    return 0


def _add_requirements(parser: Parser) -> None:
    _add_ranges(parser, _NEEDED, WallRequirements, ("mass", "delay"))
    group = parser.group(_NEEDED)
    group.add_argument(
        "--hand",
        action="append",
        metavar="NAMES",
        help=f"hands that it must bear: {', '.join(HANDS)}, several with commas between them, or one as "
        "MASS,DAMPING,STIFFNESS[,GRIP_DAMPING,GRIP_STIFFNESS]; may be given again (default none)",
    )
    group.add_argument("--held", action="store_true", help="held throughout: leave out the flotor without a hand")
    parser.group("the wall")
    add_parameters(group, WallRequirements)


def _chosen_requirements(options: argparse.Namespace) -> WallRequirements:
    ranges = _given_ranges(options, ("mass", "delay"))
    hands = _hands(options.hand or ["none"], options.held)
    return chosen(options, _required(options.scene_class), hands=hands, **ranges)


def _required(cls: type[Scene] | None) -> WallRequirements:
    """Return the wall requirements of a scene.

    Its sample period, delay and moving mass.
    """
    usual = WallRequirements()
    if cls is None:
        return usual
    scene = cls()
    mass = scene.plant_options().get("mass", usual.mass[0])
    return usual.replace(period=scene.period, delay=(scene.delay,) * 2, mass=(mass,) * 2)


def _hands(words: Sequence[str], held: bool) -> tuple[str, ...]:
    """Return the named hands; a free flotor too unless held."""
    hands: list[str] = []
    for text in words:
        names = text.split(",")
        hands += names if all(name in HANDS for name in names) else [text]
    if held:
        return tuple(dict.fromkeys(hand for hand in hands if hand != "none"))
    return tuple(dict.fromkeys(["none", *hands]))


_Requirements: TypeAlias = Annotated[WallRequirements, Shared(_add_requirements, _chosen_requirements)]
_OfScene: TypeAlias = Annotated[
    type[Scene] | None, Shared(partial(add_scene, options=False, instead=lambda _: None), scene_class)
]


def design(
    *,
    requirements: _Requirements,
    law: Annotated[Literal["pd", "observer", "disturbance-observer"], option("law of the wall", "the wall")] = "pd",
    goal: Annotated[
        Literal["static", "dynamic"],
        option("make the stiffness against a slow push largest, or the least at any frequency", "the wall"),
    ] = "static",
    contact: Annotated[Contact, parameters(Contact, "contact that is simulated")],
    json: Annotated[str | None, json_of("the design")] = None,
    pictures: Annotated[PictureFolder | None, pictures_to("write a picture of the margin to this folder")],
    scene: _OfScene,
) -> int:
    """Gains of the stiffest wall for uncertain mass, delay and hand.

    Rate, delay and mass may be a scene's.
    """
    if pictures is not None:
        if all(low == high for low, high in (requirements.mass, requirements.delay)):
            raise ParameterError("mass or delay must be a range for a picture, not one value each")
    if contact.pulse and law != "pd":
        raise ParameterError(f"pulse must be left out for the {law}: it gives none")
    with Progress("design"):
        wall = design_wall(requirements, law, goal=goal)
        reference = None
        if law != "pd":
            with suppress(ParameterError):  # no PD wall bears them
                reference = design_wall(requirements, goal=goal)
        result = evaluate_wall(wall, contact, reference)
    write_result(json, result, pictures, "design")
    return int(result.grows.any())


def _carded(text: str) -> Scene | type[Scene]:
    """Return a scene, or `drop` with the mass of a calibration."""
    if not text.endswith(".json"):
        return find_scene(text)
    from maglev_mj.bridge.commissioning.calibration import Calibration  # a scene's card needs no bridge

    return Drop(mass=Calibration.load(text).mass)


_Carded: TypeAlias = Annotated[Scene, Shared(partial(add_scene, default="drop", find=_carded), chosen_scene)]


def card(*, scene: _Carded, json: Json = None, pictures: Picture) -> int:
    """Range of impedances, transparency, virtual masses and forces of a device.

    In place of a scene: a calibration file, CALIBRATION.json.
    """
    write_result(json, device_card(scene), pictures, "card")
    return 0


def _preset_scene(text: str) -> Scene | None:
    """Return a scene; None for "all"."""
    return None if text == "all" else preset_of(text).scene


@dataclass(frozen=True, kw_only=True)
class _Validity:
    """What the answer of a comparison is to hold for."""

    tolerance: Annotated[
        float | None,
        option("largest displacement of a coil that does not matter [m] (default: the scene's own)", _RANGE),
    ] = None
    boundary_tolerance: Annotated[
        float,
        option(
            "largest shift of the stiffest stable wall by the integrator, as a share of it, at this period, delay, "
            "mass and hand: 0.01 takes an unstable wall for stable up to 1 %% beyond",
            _RANGE,
        ),
    ] = Range().boundary
    phases: Annotated[
        int,
        option("phases of the samples, evenly spread over a period, each with a jitter seed of its own", _RANGE),
    ] = Range().phases
    around: Annotated[
        float, option("stiffness and damping each also so much smaller and larger, as a share", _RANGE)
    ] = Range().around
    share: Annotated[
        float,
        option(
            "share of the cases on the exact plant that must keep the tolerance: where a sample just meets the wall "
            "or just misses it, a few go far in any model",
            _RANGE,
        ),
    ] = Range().share

    def range(self) -> Range:
        """Return it as studies take it."""
        return Range(self.phases, self.around, self.share, self.boundary_tolerance)


def _add_range(parser: Parser, cls: type[Scene]) -> None:
    """Add the options of the range of validity."""
    parser.set_defaults(phase=0.0)
    if cls.takes_phase:
        add_phase(parser, _RANGE, None)
    parser.epilog = (
        "Figures are the worst over phases, jitter seeds and gains of the whole device, and over 4096 cases more on "
        f"the exact plant. A model keeps a tolerance if {MARGIN:g} times its figure does, in all cases of the former "
        "and a share of the latter: the margin for cases not looked at."
    )
    parser.set_defaults(validity=declared(_Validity, parser))


def _add_preset(parser: Parser) -> None:
    add_scene(
        parser,
        more=_add_range,
        find=_preset_scene,
        names=("drop-no-pulse", "all"),
        without=("quantize",),  # a model level here: the sensor's steps
    )
    parser.group(_RANGE)


class _Question(NamedTuple):
    """Scene whose models are compared, and what the answer is to hold for."""

    scene: Scene
    validity: _Validity
    phase: float


def _chosen_question(options: argparse.Namespace) -> _Question | None:
    """Return the question; None for all scenes."""
    if options.scene_class is None:
        return None
    return _Question(chosen_scene(options), options.validity(options), options.phase or 0.0)


_Asked: TypeAlias = Annotated[_Question | None, Shared(_add_preset, _chosen_question)]


def fidelity(*, question: _Asked, name: SceneName, json: Json = None, pictures: Picture) -> int:
    """What each piece of the device changes in a scene, and the cheapest sufficient model."""  # noqa: D401
    if pictures is not None and question is None:
        raise ParameterError("out must be left out for all scenes: a picture is of one")
    with Progress("fidelity") as progress:
        if question is not None:
            preset = preset_of(name)._replace(scene=question.scene)
            result = measure_fidelity(
                preset, question.validity.tolerance, question.validity.range(), phase=question.phase, progress=progress
            )
        else:
            levels = {}
            for place, scene in enumerate(COMPARED):
                levels[scene] = measure_levels(scene)
                progress(place + 1, len(COMPARED))
    if question is not None:
        write_result(json, result, pictures, "fidelity")
        return 0
    data = {scene: plain(rows) for scene, rows in levels.items()}
    write_results(json, lambda: data, lambda: str(levels_table(levels)))
    return 0
