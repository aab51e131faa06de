"""Commands that run or show a scene."""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from contextlib import AbstractContextManager
from functools import partial
from inspect import getdoc
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, TypeAlias

from maglev_mj.cli.declare import Parser, Shared, count, option
from maglev_mj.cli.options import (
    Folder,
    Pictures,
    Record,
    Shown,
    add_phase,
    add_scene,
    chosen_scene,
    json_of,
)
from maglev_mj.cli.output import Progress, keep_partial, print_written, write_result
from maglev_mj.cli.peripherals import HandOptions, PageOptions, window
from maglev_mj.errors import DivergenceError, ParameterError
from maglev_mj.terminal import say

if TYPE_CHECKING:
    from maglev_mj.interop.hand_devices import HandDevice
    from maglev_mj.plants.hand import Trajectory
    from maglev_mj.scenes.run import Begin
    from maglev_mj.scenes.scene import Scene
    from maglev_mj.session import Session, SnapshotSource
    from maglev_mj.views.viewer_process import ViewerFunction


class _Sampling(NamedTuple):
    """Plant and sampling phases."""

    plant: str
    phase: float
    phases: int | None


def _add_sampling(parser: Parser, cls: type[Scene]) -> None:
    if cls.__doc__:
        parser.description, *paragraphs = [" ".join(part.split()) for part in str(getdoc(cls)).split("\n\n")]
        parser.epilog = "\n\n".join([*paragraphs, str(parser.epilog)])
    plants, group = cls.plants, parser.group("run")
    text = f"plant: {', '.join(plants)} (default {plants[0]})"
    plant: Any = group.add_argument("--plant", default=plants[0], metavar="NAME", help=text)
    plant.offered = plants  # for shell completion
    if cls.takes_phase:
        add_phase(parser, "run", 0.0)
        group.add_argument("--phases", type=count, metavar="N", help="number of sampling phases, for statistics")
    else:
        parser.set_defaults(phase=0.0, phases=None)


_RunScene: TypeAlias = Annotated["Scene", Shared(partial(add_scene, more=_add_sampling), chosen_scene)]
_HandPath: TypeAlias = Annotated[
    Path | None, option("recording whose motion is the path of the hand, from its first sample on", "run", "FILE")
]


def _path_of(file: Path) -> Trajectory:
    """Return the motion of a recording, from its start."""
    from maglev_mj.plants.hand import Trajectory
    from maglev_mj.recording import load_samples

    samples = load_samples(file, ["time", "position"])
    samples.recording.require_samples(file)
    if damage := samples.recording.damage:
        say(f"  {file}: {damage}; {len(samples)} samples were read", sys.stderr)
    return Trajectory(samples.time - samples.time[0], samples.position)


def run(
    *,
    scene: _RunScene,
    sampling: Annotated[_Sampling, Shared(None, lambda values: _Sampling(values.plant, values.phase, values.phases))],
    json: Annotated[str | None, json_of("parameters, motion and figures")] = None,
    pictures: Pictures,
    record: Record = None,
    hand_path: _HandPath = None,
) -> int:
    """Run a scene, built-in or from your own file."""
    from maglev_mj.scenes.run import run_variants

    alone = json == "-" and pictures is None
    variants = dict(list(scene.variants().items())[: 1 if alone else None])
    if hand_path is not None:
        path = _path_of(hand_path)
        variants = {name: variant.guided(path) for name, variant in variants.items()}
    banded = pictures is not None and scene.band_phases and "exact" in scene.plants
    bands = (sampling.phases or scene.band_phases) if banded else None
    written = list[Path]()
    recording: AbstractContextManager[Begin] | None = None
    if record is not None:
        from maglev_mj.session.replay import record_to_file  # imported here: loads the recording package

        recording = record_to_file(record, written)
    try:
        with Progress(scene.name) as progress:
            results = run_variants(
                variants,
                plant=sampling.plant,
                phase=sampling.phase,
                phases=sampling.phases,
                bands=bands,
                recording=recording,
                compare=json != "-",
                progress=progress,
            )
    except DivergenceError as error:
        keep_partial(error, json)
        raise
    write_result(json, results, pictures, written=written)
    return 0


_SCENE = "joystick"
_MIN_SIDE, _MAX_SIDE = 160, 4000  # [pixels]


_add_joystick = partial(add_scene, default=_SCENE)


def _hand_stiffness() -> float:
    from maglev_mj.plants.hand import SpringHand

    return SpringHand.stiffness


_ViewedScene: TypeAlias = Annotated["Scene", Shared(_add_joystick, chosen_scene)]


def view(
    *,
    scene: _ViewedScene,
    tour: Annotated[bool, option("guided tour of walls and friction in eight steps, which set the parameters")] = False,
    hand_stiffness: Annotated[float, option("stiffness of the hand's spring [N/m]", default=_hand_stiffness)],
    seconds: Shown = None,
    record: Record = None,
    out: Folder = Path(),
    page: PageOptions,
    input_hand: HandOptions,
    hand_path: _HandPath = None,
) -> int:
    """Show a scene in a window or browser and drag its handle with the mouse."""
    from maglev_mj.plants.hand import SpringHand
    from maglev_mj.result import Table
    from maglev_mj.scenes.find import find_scene
    from maglev_mj.scenes.stability_check import stability_warning, started
    from maglev_mj.session import Session
    from maglev_mj.session.tour import Tour
    from maglev_mj.theory import stated_gains

    if tour and (scene.name != _SCENE or scene.as_json() != find_scene(_SCENE)().as_json()):
        raise ParameterError(f"tour needs the scene {_SCENE} with its defaults (got {scene.name}: {scene.describe()})")
    hand = SpringHand.of_mouse(hand_stiffness, scene.device)
    hand.target = None if hand_path is None else _path_of(hand_path)
    controller = started(scene)  # raises errors of a user's scene before a page opens
    if stated_gains(controller) is not None and (warning := stability_warning(scene)):  # else the viewer computes it
        print(Table("", (), (), warnings=[warning]), file=sys.stderr)
    front = page.open() or window(out)
    if tour:
        from maglev_mj.views.pages import FOLDER

        print(f"A first wall without Python: open {FOLDER / 'wall.html'}", flush=True)
    out.mkdir(parents=True, exist_ok=True)
    with input_hand.open(hand) as devices:
        session = Session(scene, hand_force=hand, folder=out, record=record, publishers=devices)
        _show(Tour(session) if tour else session, session, devices, front, seconds)
    return 0


def _show(
    source: SnapshotSource,
    session: Session,
    devices: Sequence[HandDevice],
    front: ViewerFunction,
    seconds: float | None,
) -> None:
    """Show a session whose hand is moved by the devices, and print the paths of its recordings."""
    from maglev_mj.views.viewer_process import show_remotely

    for device in devices:
        device.act = session.act
    try:
        print(show_remotely(source, front, seconds))
    finally:
        for path in session.recordings:  # also after an error: the user needs the paths
            print_written(path)


def render(
    *,
    scene: _ViewedScene,
    out: Annotated[Path, option("output file, .png, .gif or .mp4", "output")],
    seconds: Annotated[
        float | None,
        option(
            "simulated duration of a video, or time of an image [s] (default: the scene's duration, or half of it)",
            "output",
            at_least=0.0,
            at_most=600.0,
        ),
    ] = None,
    time_scale: Annotated[
        float | None,
        option("playback speed, relative (default 1; less if short)", "output", at_least=1e-3, at_most=1.0),
    ] = None,
    size: Annotated[str, option("width and height [pixels]", "output", "WxH")] = "1200x750",
    fps: Annotated[int, option("frame rate [1/s]", "output", at_least=1, at_most=50)] = 20,
    bare: Annotated[bool, option("omit plots and text", "output")] = False,
    hand_path: _HandPath = None,
) -> int:
    """Render an image or video of a scene off-screen."""
    # imported here: loads the rendering libraries
    from maglev_mj.views.window.offscreen import checked_name, render

    width, height = _pixels(size)
    checked_name(out)
    with Progress(f"render {scene.name}") as progress:
        frames = render(
            scene if hand_path is None else scene.guided(_path_of(hand_path)),
            out,
            seconds=seconds,
            time_scale=time_scale,
            width=width,
            height=height,
            rate=fps,
            plots=not bare,
            progress=progress,
        )
    print(f"  wrote {out}" + (f": {frames} frames" if frames > 1 else ""))
    return 0


def _pixels(size: str) -> tuple[int, int]:
    """Parse width and height from a text such as 1200x750.

    Raises:
        ParameterError: If the text has another form, or a size is outside its bounds.
    """
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", size)
    if match is None or not all(_MIN_SIDE <= int(part) <= _MAX_SIDE for part in match.groups()):
        raise ParameterError(f"size must be WxH, e.g. 1200x750, {_MIN_SIDE} to {_MAX_SIDE} pixels each (got {size!r})")
    return int(match[1]), int(match[2])
