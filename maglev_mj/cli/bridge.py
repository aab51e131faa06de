"""`maglev-mj bridge`: a scene on a device at the other end of a wire."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from maglev_mj.bridge.calibration import Calibration
from maglev_mj.bridge.fault import HandshakeError
from maglev_mj.bridge.flight import Flight
from maglev_mj.bridge.identification import collect, excitation, identify
from maglev_mj.bridge.realtime import realtime, stopping
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.cli.options import add_bridge, add_recording, chosen_key, number_option
from maglev_mj.cli.output import check_file, check_outputs, check_recording
from maglev_mj.cli.publishers import add_publishers, chosen_publishers
from maglev_mj.cli.scenes import add_scene, chosen_scene, warn_of_instability
from maglev_mj.errors import MaglevError, ParameterError
from maglev_mj.net.udp import open_link
from maglev_mj.parameters import number
from maglev_mj.recording import RecordingFile, open_recording
from maglev_mj.scenes import Scene
from maglev_mj.session import DEVICES_OWN, Publisher, Snapshot
from maglev_mj.tables import flown_table
from maglev_mj.terminal import say
from maglev_mj.viewer.process import RemoteViewer

__all__ = ["add_command"]

_IDENTIFYING = 10.0


def add_command(commands: Any) -> None:
    """Add the command to the parser's."""
    bridge = commands.add_parser("bridge", help="a scene on a device at the other end of a wire")
    bridge.add_argument("address", metavar="ADDRESS", help="udp://HOST:PORT, or serial:///PATH?baud=RATE")
    add_scene(bridge, option="--scene", default="joystick", without=DEVICES_OWN)
    add_recording(bridge)
    add_bridge(bridge)
    add_publishers(bridge)
    bridge.add_argument("--reset", action="store_true", help="leave the fault state first")
    bridge.add_argument("--view", action="store_true", help="a window on the device; its hand is at the device")
    bridge.add_argument(
        "--identify",
        metavar="FILE",
        type=Path,
        help=f"shake the flotor gently for {_IDENTIFYING:g} s and write its calibration, instead of a scene",
    )
    bridge.add_argument("--mass", type=number_option, metavar="X", help="moving mass, for --identify [kg]")
    bridge.add_argument(
        "--out", metavar="DIR", type=Path, default=Path(), help="folder for the last cycles before a fault (default .)"
    )
    bridge.set_defaults(run=_bridge)


def _bridge(options: argparse.Namespace) -> int:
    scene, key = chosen_scene(options), chosen_key(options.key)  # before the device: what is wrong is said at once
    if options.seconds is not None:
        number("seconds", options.seconds, above=0.0)
    check_recording(options.record)
    if options.identify is not None:
        check_file("identify", options.identify)
    if options.mass is not None and options.identify is None:
        raise ParameterError("mass is for --identify")
    for name in ("record", "view", "seconds", "spacenav", "stream"):
        if options.identify is not None and getattr(options, name):
            raise ParameterError(f"{name} is for scenes, not for --identify")
    check_outputs(out=options.out)
    calibration = Calibration.nominal() if options.calibration is None else Calibration.load(options.calibration)
    if options.view:
        from maglev_mj.viewer.window import require_display

        require_display()
    # publishers first: what is wrong with them is said before the device moves
    with chosen_publishers(options) as publishers, _opened(options, calibration, key) as plant:
        if options.reset:
            plant.reset()
        if options.identify is not None:
            return _identify(plant, options)
        scene = scene.replace(period=plant.period, delay=plant.delay)
        warn_of_instability(scene, [*[calibration.mass] * 3, *calibration.inertia])
        _fly(plant, scene, options, publishers)
    return 0


def _fly(plant: RemotePlant, scene: Scene, options: argparse.Namespace, publishers: Sequence[Publisher]) -> None:
    """Fly a scene; whatever ends it, first the device is let go, then what was recorded is kept."""
    with ExitStack() as last:
        viewer = None
        if options.view:
            viewer = RemoteViewer(Snapshot(scene=scene), options.out)
            last.callback(viewer.close)
            publishers = [*publishers, viewer]
        file = None if options.record is None else open_recording(options.record)
        if file is not None:
            last.push(partial(_keep, file))
        flight = Flight(plant, scene, file=file, publishers=publishers, warn=_warn, step_force=options.step_force)
        if viewer is not None:
            viewer.on_close = flight.stop
        last.push(plant)  # first of all the device is let go
        with stopping(flight.stop), _punctual(options):
            print(f"  {scene.name} at {1.0 / plant.period:g} Hz; keep hands off while it takes off", flush=True)
            print(flown_table(flight.run(options.seconds)), flush=True)


def _warn(text: str) -> None:
    say(f"  {text}", sys.stderr)


def _keep(file: RecordingFile, _kind: object, error: BaseException | None, _trace: object) -> None:
    """Write what is left of what was recorded; what ended the flight is told of first."""
    try:
        path = file.close()
    except MaglevError as problem:
        if error is None:
            raise
        say(f"  {problem}", sys.stderr)
        return
    print(f"  wrote {path}" if path is not None else "  nothing was recorded: it did not come to fly")


def _opened(options: argparse.Namespace, calibration: Calibration, key: bytes | None) -> RemotePlant:
    try:
        link = open_link(options.address, key)
        return RemotePlant(link, calibration=calibration, key=key, folder=options.out)
    except HandshakeError as error:
        raise HandshakeError(f"{options.address}: {error}") from None


@contextmanager
def _punctual(options: argparse.Namespace) -> Iterator[None]:
    """Run in real time, and say what of that was refused."""
    with realtime(options.realtime) as refused:
        for complaint in refused:
            print(f"  not in real time: {complaint}", file=sys.stderr)
        yield


def _identify(plant: RemotePlant, options: argparse.Namespace) -> int:
    mass = plant.calibration.mass if options.mass is None else number("mass", options.mass, above=0.0)
    # before takeoff: the device would take the time that this needs for a host that is gone
    shaker = excitation(plant.calibration, period=plant.period, delay=plant.delay)
    with _punctual(options):
        plant.takeoff()
        motion = collect(plant, shaker, _IDENTIFYING, then=plant.land)
    # the wire and this program take their time too, which the map would have to pay for
    found = identify(motion.poses, motion.currents, period=plant.period, delay=motion.delay)
    found.calibration(plant.calibration, mass).save(options.identify)
    x, y, z = found.gravity
    doubt = found.free_errors[:3].max()
    missing = int(np.isnan(motion.currents[:, 0]).sum())
    print(f"  gravity {x:.4f}, {y:.4f}, {z:.4f} m/s², give or take {doubt:.4f}; mass taken for {mass:g} kg")
    print(
        f"  delay {motion.delay * 1e3:.3f} ms; {missing} of {len(motion.poses)} samples lost, or answered late or early"
    )
    print(f"  wrote {options.identify}")
    return 0
