"""Commands for studies: theory and many runs."""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, TypeAlias

import numpy as np

from maglev_mj.cli.declare import Option, Parser, Shared, declared, listed, option
from maglev_mj.cli.options import (
    Json,
    Picture,
    Pictures,
    add_device,
    add_parameters,
    add_phase,
    add_scene,
    assignments,
    chosen,
    chosen_scene,
    described,
    json_of,
    pictures_to,
    range_of,
    scene_class,
    stated,
)
from maglev_mj.cli.output import Progress, check_folder, write_result, write_results
from maglev_mj.device import Device, OnDevice, devices
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.keywords import with_period
from maglev_mj.pictures import PictureFolder
from maglev_mj.plants.hand import HANDS
from maglev_mj.result import Result, plain
from maglev_mj.scenes.drop import Drop
from maglev_mj.scenes.find import find_scene
from maglev_mj.scenes.scene import Scene
from maglev_mj.studies.card import DeviceFigures, device_card
from maglev_mj.studies.cells import StudyInterrupted, Workers, WorkersError, dask_workers, local_workers
from maglev_mj.studies.compare import compare as compare_laws
from maglev_mj.studies.compare import sweep_laws
from maglev_mj.studies.designed_wall import ContactParameters, evaluate_wall
from maglev_mj.studies.diagnosis import diagnose
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
from maglev_mj.studies.wall_laws import LAWS
from maglev_mj.terminal import wrapped
from maglev_mj.theory import WallRequirements, design_wall
from maglev_mj.theory import stability as judge
from maglev_mj.theory.loop_parameters import LoopParameters
from maglev_mj.versions import hash_of


@dataclass(frozen=True, kw_only=True)
class WorkerOptions:
    """Workers of a study."""

    workers: Annotated[int | None, option("worker processes on this machine; 0 for none", "workers")] = None
    scheduler: Annotated[
        str | None, option("address of a Dask scheduler, to run on its cluster", "workers", "ADDRESS")
    ] = None
    command: Annotated[str, Shared(None, lambda options: options.command)]

    def open(self, default: int | None) -> Workers:
        """Return the workers; `default` is the default number of processes, None for one per processor."""
        if self.scheduler is None:
            return local_workers(default if self.workers is None else self.workers)
        if self.workers is not None:
            raise ParameterError(f"workers and scheduler are mutually exclusive (got workers {self.workers})")
        with warnings.catch_warnings(record=True) as caught:
            workers = dask_workers(self.scheduler)
        for warning in caught:
            print(f"maglev-mj {self.command}: {warning.message}", file=sys.stderr)
        return workers


def cells_in(default: str) -> Option:
    """Declare the folder of a study's finished cells."""
    return option(f"results folder; finished cells are skipped (default: {default})", "output", "DIR")


@contextmanager
def saved_cells(path: Path | None, fallback: Path) -> Iterator[None]:
    """Save the finished cells of an interrupted study, to a new folder if it has no record; name it in the error."""
    try:
        yield
    except (StudyInterrupted, WorkersError) as stopped:
        record = stopped.record
        if path is None:
            record.path = path = fallback.with_name(f"{fallback.name}-{record.name}")
            record.flush()
        hint = f"{record.done.sum()} cells saved in {path}; to resume, repeat the command with --record {path}"
        stopped.args = (f"{stopped}; {hint}",)
        raise


def _list_parameters(parser: Parser, cls: type[Scene]) -> None:
    """List a scene's parameters in the epilog of the help."""
    texts = {"plant": f"{', '.join(cls.plants)} (default {cls.plants[0]})"}
    if cls.takes_phase:
        texts["phase"] = "sampling phase in [0, 1) (default 0)"
    texts |= {item.name: described(item, getattr(cls(), item.name)) for item in cls.parameters()}
    parser.epilog = listed(f"parameters of {cls.name}", texts)


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
            "parameter and values: LOW:HIGH:COUNT evenly spaced, A,B,C, or A;B;C for values with commas; repeatable",
            "grid",
            "NAME=VALUES",
        ),
    ],
    set: Annotated[list[str], option("fixed parameter value; repeatable", "grid", "NAME=VALUE")],
    rate: Annotated[float | None, option("sample rate [Hz], as --set rate=RATE", "grid", above=0.0)] = None,
    json: Annotated[str | None, json_of("cells and figures")] = None,
    record: Annotated[
        Path | None,
        cells_in("SCENE-sweep-GRID"),
    ] = None,
    workers: WorkerOptions,
    pictures: Picture,
) -> int:
    """Run a scene over a grid of its parameters."""
    names, set = [item.name for item in scene.parameters()], set + [f"rate={rate!r}"] * (rate is not None)
    fixed, varied = (assignments("a parameter", words, lambda name: name.replace("-", "_")) for words in (set, vary))
    fixed = with_period(names, {name: [value_of(scene, name, text)] for name, text in fixed.items()})
    varied = with_period(names, {name: _values(scene, name, text) for name, text in varied.items()})
    if not varied:
        raise ParameterError(f"a sweep needs --vary NAME=VALUES; for one run: maglev-mj run {name}")
    if common := sorted(fixed.keys() & varied.keys()):
        raise ParameterError(f"{common[0]} must be either set or varied (got both)")
    if pictures is not None and not scene.figures and scene.run_figures is None:
        raise ParameterError(f"out is not supported: {scene.name} has no figures to draw")
    path = record
    if path is None:  # one folder per grid
        grid = hash_of(json_text("a grid", Grid(scene(), fixed | varied).plan))[:8]
        path = Path(f"{scene.name}-sweep-{grid}")
        check_folder("record", path)
    running = workers.open(default=None)
    with saved_cells(path, path), Progress(f"sweep {scene.name}") as progress:
        result = run_sweep(scene, fixed | varied, workers=running, record=path, progress=progress)
    result = replace(result, varied=varied)  # fixed parameters are not dimensions of the grid
    write_result(json, result, pictures)
    if len(result.results.failed) == len(result.cells):
        raise MaglevError(f"no cell finished: {result.results[0]['error']}")
    return 0


def _values(cls: type[Scene], name: str, text: str) -> list[Any]:
    """Parse the values of a swept parameter."""
    if ":" not in text:
        return [value_of(cls, name, part) for part in text.split(";" if ";" in text else ",")]
    forms = "LOW:HIGH:COUNT, A,B,C or A;B;C"
    low, high, *count = range_of(f"values of {name}", text, forms)
    if not count or count[0] > MOST_CELLS:
        raise ParameterError(f"values of {name} must be {forms} (got {text!r})")
    value_of(cls, name, text.partition(":")[0])  # checks that the parameter exists and is a number
    return [float(value) for value in np.linspace(low, high, int(count[0]))]


_LAWS = ", ".join(f"{name} ({law.status})" for name, law in LAWS.items())


def _add_compared(parser: Parser) -> None:
    """Add the scene, and the table of laws to the end of the help."""
    texts = {name: law.text for name, law in LAWS.items()}
    parser.epilog = listed("laws, force f on the flotor at depth x and velocity v", texts)
    add_scene(parser)


def compare(
    *,
    scene: Annotated[Scene, Shared(_add_compared, chosen_scene)],
    law: Annotated[list[str], option(f"{_LAWS}, or your own FILE.py[:CLASS] (executed); repeatable", "laws", "LAW")],
    phases: Annotated[int, option("number of sampling phases, evenly spaced")] = 100,
    plant: Annotated[str, option("plant: exact, mujoco", metavar="NAME")] = "exact",
    vary: Annotated[
        str | None,
        option("compare at each value of one parameter: LOW:HIGH:COUNT or A,B,C; also rate", "over", "NAME=VALUES"),
    ] = None,
    figure: Annotated[str | None, option("figure in the table of --vary (default: the scene's first)", "over")] = None,
    map: Annotated[bool, option("map the stable region over damping and stiffness instead", "over")] = False,
    json: Json = None,
    pictures: Pictures,
) -> int:
    """Compare wall laws in a scene: contact, noise, margins and verdicts.

    Repeat --law for each law. Contact figures are the median and the 10 to 90 % range over sampling phases.
    """
    if map and vary is not None:
        raise ParameterError(f"vary and map are mutually exclusive (got vary {vary})")
    if figure is not None and vary is None:
        raise ParameterError(f"figure needs --vary NAME=VALUES (got {figure})")
    with Progress(f"compare {scene.name}") as progress:
        around: Any = {"phases": phases, "plant": plant, "progress": progress}
        if map:
            result: Result = sweep_laws(scene, law, figure="critical_stiffness", **around)
        elif vary is None:
            result = compare_laws(scene, law, **around)
        else:
            ((name, text),) = assignments("a parameter", [vary], lambda name: name.replace("-", "_")).items()
            result = sweep_laws(scene, law, name, _values(type(scene), name, text), figure=figure, **around)
    write_result(json, result, pictures)
    return 0


_WALL = "wall parameters"
_DROP = "parameters of --of drops"
_MAP = "map"
_NEEDED = "requirements"
_RANGE = "range of validity"
_REQUIRED, _GAINS = ("mass", "inertia", "delay"), ("damping", "stiffness")
_ENDS, _AXIS = "LOW:HIGH or one value", "LOW:HIGH:COUNT, LOW:HIGH or one value"


def _add_ranges(
    parser: Parser, group: str, cls: Any, names: Sequence[str], missing: str = "none", forms: str = _ENDS
) -> None:
    """Add options for range parameters of some forms, see `range_of`; `missing` describes the default None."""
    for name in names:
        item = cls.parameter(name)
        value = getattr(cls(), name)
        default = missing if value is None else f"{value[0]:g}"
        text = f"{item.help} [{item.unit}]: {forms} (default {default})"
        parser.group(group).add_argument(f"--{name}", nargs="+", metavar="RANGE", help=text)


def _ranges(options: argparse.Namespace, names: Sequence[str], forms: str = _ENDS) -> dict[str, Any]:
    words = {name: getattr(options, name) for name in names}
    return {name: range_of(name, " ".join(some), forms) for name, some in words.items() if some is not None}


def _add_wall(parser: Parser) -> None:
    """Add the options of a wall on a device: gains, each a value or a range, and loop."""
    _add_ranges(parser, _WALL, StabilityParameters, _GAINS, "covers the stable region", _AXIS)
    add_device(parser)
    add_parameters(parser.group(_WALL), StabilityParameters, without=("grid", "plant"))


def _add_region(parser: Parser) -> None:
    _add_wall(parser)
    add_parameters(parser.group(_WALL), StabilityParameters, without=("plant",))
    add_parameters(parser.group(_DROP), DropMapParameters, without=("plant",))


def _region(options: argparse.Namespace) -> StabilityParameters:
    """Return the walls of a map.

    Raises:
        ParameterError: If a value is outside its bounds, or a parameter of drops is set for another map.
    """
    ranges = _ranges(options, _GAINS, _AXIS)
    if options.of == "drops":
        return chosen(options, DropMapParameters, **ranges)
    if own := stated(options, DropMapParameters).keys() - {item.name for item in StabilityParameters.parameters()}:
        raise ParameterError(f"{min(own)} requires --of drops (got --of {options.of})")
    return chosen(options, StabilityParameters, plant=_PLANT_OF[options.of], **ranges)


_PLANT_OF = {"theory": "none", "exact": "exact", "mujoco": "mujoco"}
_Region: TypeAlias = Annotated[StabilityParameters, Shared(_add_region, _region)]


def map(
    *,
    of: Annotated[
        Literal["theory", "exact", "mujoco", "drops"],
        option("theory, its comparison with walls simulated on the plant exact or mujoco, or simulated drops", _MAP),
    ] = "theory",
    region: _Region,
    json: Json = None,
    pictures: Annotated[PictureFolder | None, pictures_to("output folder for the chart")],
    record: Annotated[Path | None, cells_in("none")] = None,
    workers: WorkerOptions,
) -> int:
    """Map which walls are stable, over their damping and stiffness (figure 2)."""
    if pictures is not None:
        for name in _GAINS:
            if (limits := getattr(region, name)) is not None and limits[0] == limits[1]:
                raise ParameterError(f"{name} must be a range for a chart (got {limits[0]:g})")
    if record is not None and of == "theory":
        raise ParameterError(f"record requires --of exact, mujoco or drops: theory has no cells (got {record})")
    # a map of drops uses every core if it has more than one part
    running = workers.open(default=None if of == "drops" and region.count > PART else 0)
    run: Any = run_drop_map if of == "drops" else run_stability
    with saved_cells(record, Path("stability-cells")), Progress("map") as progress:
        result = run(region, record=Record(record), workers=running, progress=progress)
    write_result(json, result, pictures)
    return 0


def _add_judged(parser: Parser) -> None:
    """Add the scene, or the options of one wall if none is named."""

    def add_one_wall() -> None:
        if parser.get_default("scene_class") is None:
            _add_wall(parser)

    parser.later.append(add_one_wall)  # called after the scene is found
    add_scene(parser, optional=True)


def _judged(options: argparse.Namespace) -> Scene | None:
    return None if options.scene_class is None else chosen_scene(options)


def _one_wall(options: argparse.Namespace) -> dict[str, Any]:
    """Return the arguments of `diagnose` for one wall; empty for a scene."""
    if options.scene_class is not None:
        return {}
    return chosen(options, StabilityParameters, **_ranges(options, _GAINS, _AXIS)).wall


_JudgedScene: TypeAlias = Annotated[Scene | None, Shared(_add_judged, _judged)]
_OneWall: TypeAlias = Annotated[dict[str, Any], Shared(None, _one_wall)]


def stability(*, scene: _JudgedScene, wall: _OneWall, json: Json = None, pictures: Picture) -> int:
    """Judge a scene, or one wall by its damping and stiffness.

    Of one wall it prints what `diagnose` says. The exit status is 0 if it is unstable, too; `stable` in the JSON is
    the verdict.
    """
    if scene is None:
        write_result(json, diagnose(**wall), pictures)
        return 0
    with Progress("stability"):
        verdict = judge(scene)
    data = {"scene": scene.name, "parameters": scene.as_json(), **verdict.as_json()}
    heading = "\n".join(wrapped(f"{scene.name}: {scene.describe()}", "", "  "))
    draw = partial(lambda folder: [folder.plot(verdict, "stability")] if folder else [], pictures)
    write_results(json, lambda: data, lambda: f"{heading}\n{verdict.table()}", draw)
    return 0


def _add_requirements(parser: Parser) -> None:
    _add_ranges(parser, _NEEDED, WallRequirements, _REQUIRED)
    group = parser.group(_NEEDED)
    group.add_argument(
        "--hand",
        action="append",
        metavar="NAMES",
        help=f"hands to tolerate: {', '.join(HANDS)}, comma-separated, or one as "
        "MASS,DAMPING,STIFFNESS[,GRIP_DAMPING,GRIP_STIFFNESS]; repeatable (default none)",
    )
    group.add_argument("--held", action="store_true", help="always held: exclude the flotor without a hand")
    parser.group("wall")
    add_device(parser)
    add_parameters(group, WallRequirements)


def _chosen_requirements(options: argparse.Namespace) -> WallRequirements:
    ranges = _ranges(options, _REQUIRED)
    hands = _hands(options.hand or ["none"], options.held)
    device = chosen(options, OnDevice).device
    default = _required(options.scene_class, device)
    if "inertia" in ranges:
        ranges = {"mass": None} | ranges
    return chosen(options, default, hand=hands, **ranges)


def _required(cls: type[Scene] | None, device: str) -> WallRequirements:
    """Return requirements with a scene's sample period, delay and moving mass."""
    default = WallRequirements(device=device)
    if cls is None:
        return default
    scene = cls(device=device)
    mass = float(scene.body.inertia[2])
    return default.replace(period=scene.period, delay=(scene.delay,) * 2, mass=(mass,) * 2)


def _hands(words: Sequence[str], held: bool) -> tuple[str, ...]:
    """Parse the hands; add the free flotor unless held."""
    hands: list[str] = []
    for text in words:
        names = text.split(",")
        hands += names if all(name in HANDS for name in names) else [text]
    if held:
        return tuple(dict.fromkeys(hand for hand in hands if hand != "none"))
    return tuple(dict.fromkeys(["none", *hands]))


def _chosen_contact(options: argparse.Namespace) -> ContactParameters:
    """Return the contact, with sensor and force limit of the device unless set."""
    device, default = chosen(options, OnDevice).hardware, ContactParameters()
    if not device.published:
        own = {"quantize": device.sensor.resolution[2], "force_limit": float(device.force_limit[2])}
        default = default.replace(**own)
    return chosen(options, default)


_Contact: TypeAlias = Annotated[
    ContactParameters,
    Shared(lambda parser: add_parameters(parser.group("simulated contact"), ContactParameters), _chosen_contact),
]
_Requirements: TypeAlias = Annotated[WallRequirements, Shared(_add_requirements, _chosen_requirements)]
_OfScene: TypeAlias = Annotated[
    type[Scene] | None, Shared(partial(add_scene, options=False, optional=True), scene_class)
]


def design(
    *,
    requirements: _Requirements,
    contact: _Contact,
    json: Annotated[str | None, json_of("the design")] = None,
    pictures: Annotated[PictureFolder | None, pictures_to("output folder for the chart of the margin")],
    scene: _OfScene,
) -> int:
    """Compute the gains of the stiffest wall for uncertain mass, delay and hand.

    A scene sets the defaults of rate, delay and mass.
    """
    if pictures is not None:
        if all(low == high for low, high in (requirements.bodies, requirements.delay)):
            raise ParameterError("mass or delay must be a range for a chart (got one value each)")
    with Progress("design"):
        result = evaluate_wall(design_wall(requirements), contact)
    write_result(json, result, pictures)
    return int(result.grows.any())


def _is_device(text: str) -> bool:
    return text.endswith(".toml") or text in devices()


def _card_scene(text: str) -> Scene | type[Scene]:
    """Return a scene; for a device, `drop` on it."""
    return Drop(device=text) if _is_device(text) else find_scene(text)


def _named_device(options: argparse.Namespace) -> str | None:
    """Return the device that the command line names; None for that of the scene."""
    named: str | None = stated(options, options.scene_class).get("device")
    return options.scene if named is None and _is_device(options.scene) else named


_CardScene: TypeAlias = Annotated[Scene, Shared(partial(add_scene, default="drop", find=_card_scene), chosen_scene)]


def _add_card(parser: Parser) -> None:
    add_device(parser)
    add_parameters(parser.group("loop"), LoopParameters)


_Loop: TypeAlias = Annotated[LoopParameters, Shared(_add_card, lambda options: chosen(options, LoopParameters))]
_SHOWN = "in place of the card"


def card(
    *,
    scene: _CardScene,
    device: Annotated[str | None, Shared(None, _named_device)],
    loop: _Loop,
    table1: Annotated[
        bool, option("Table 1 of the paper compared with the model; figures of the device, if one is named", _SHOWN)
    ] = False,
    header: Annotated[bool, option("the firmware's profile as a C header", _SHOWN)] = False,
    model: Annotated[Path | None, option("your own MJCF, checked against the device first", "device", "FILE")] = None,
    json: Json = None,
    pictures: Picture,
) -> int:
    """Compute the Z-width, transparency, virtual masses and forces of a device.

    SCENE may also be a device: FILE.toml, or one of the package by name.
    """
    if table1 and header:
        raise ParameterError("table1 and header are mutually exclusive")
    if (table1 or header) and pictures is not None:
        raise ParameterError("out is not supported with table1 and header: they have no chart")
    if model is not None:
        from maglev_mj.plants.model import check_model  # imported here, as below: needs MuJoCo

        check_model(model, Device.load(scene.device))
    if header:
        from maglev_mj.bridge.commissioning.calibration import Calibration
        from maglev_mj.bridge.twin.twin import TwinParameters

        print(TwinParameters(calibration=Calibration.load(scene.device)).profile.header())
    elif table1:
        from maglev_mj.plants.shapes import device_report

        write_result(json, device_report() if device is None else DeviceFigures(Device.load(device)))
    else:
        write_result(json, device_card(scene, loop), pictures)
    return 0


def _preset_scene(text: str) -> Scene | None:
    """Return a scene; None for "all"."""
    return None if text == "all" else preset_of(text).scene


@dataclass(frozen=True, kw_only=True)
class _Validity:
    """Range of validity of a comparison."""

    tolerance: Annotated[
        float | None,
        option("tolerance of coil displacement [m] (default: the scene's)", _RANGE),
    ] = None
    boundary_tolerance: Annotated[
        float,
        option(
            "relative tolerance of critical stiffness by the integrator, at this period, delay, mass and hand: 0.01 "
            "accepts a wall up to 1 %% above critical stiffness as stable",
            _RANGE,
        ),
    ] = Range().boundary
    phases: Annotated[
        int,
        option("number of sampling phases, evenly spaced, each with its own jitter seed", _RANGE),
    ] = Range().phases
    around: Annotated[float, option("relative variation of stiffness and damping, up and down", _RANGE)] = (
        Range().around
    )
    share: Annotated[
        float,
        option(
            "required fraction of cases within tolerance on the exact plant: a few that just meet or miss the wall "
            "differ widely in any model",
            _RANGE,
        ),
    ] = Range().share

    def range(self) -> Range:
        """Return the `Range` for a study."""
        return Range(self.phases, self.around, self.share, self.boundary_tolerance)


def _add_range(parser: Parser, cls: type[Scene]) -> None:
    """Add the options of the range of validity."""
    parser.set_defaults(phase=0.0)
    if cls.takes_phase:
        add_phase(parser, _RANGE, None)
    parser.epilog = (
        "Figures are the worst case over phases, jitter seeds and gains with the full device, and over 4096 more "
        f"cases on the exact plant. A model is within tolerance if {MARGIN:g} times its figure is, in all cases of the "
        "former and a fraction of the latter: a margin for untested cases."
    )
    parser.set_defaults(validity=declared(_Validity, parser))


def _add_preset(parser: Parser) -> None:
    add_scene(
        parser,
        more=_add_range,
        find=_preset_scene,
        names=("drop-no-pulse", "all"),
        without=("quantize",),  # here a model level: the sensor resolution
    )
    parser.group(_RANGE)


class _Comparison(NamedTuple):
    """Scene whose models are compared, and the range of validity."""

    scene: Scene
    validity: _Validity
    phase: float


def _chosen_comparison(options: argparse.Namespace) -> _Comparison | None:
    """Return the comparison; None for all scenes."""
    if options.scene_class is None:
        return None
    return _Comparison(chosen_scene(options), options.validity(options), options.phase or 0.0)


_Compared: TypeAlias = Annotated[_Comparison | None, Shared(_add_preset, _chosen_comparison)]


def fidelity(*, comparison: _Compared, name: SceneName, json: Json = None, pictures: Picture) -> int:
    """Measure the effect of each part of the device in a scene, and the cheapest sufficient model."""
    if pictures is not None and comparison is None:
        raise ParameterError("out is not supported for all scenes: a chart shows one")
    with Progress("fidelity") as progress:
        if comparison is not None:
            preset, validity = preset_of(name)._replace(scene=comparison.scene), comparison.validity
            over = validity.range()
            result = measure_fidelity(preset, validity.tolerance, over, phase=comparison.phase, progress=progress)
        else:
            levels = {}
            for index, scene in enumerate(COMPARED):
                levels[scene] = measure_levels(scene)
                progress(index + 1, len(COMPARED))
    if comparison is not None:
        write_result(json, result, pictures)
        return 0
    data = {scene: plain(rows) for scene, rows in levels.items()}
    write_results(json, lambda: data, lambda: str(levels_table(levels)))
    return 0
