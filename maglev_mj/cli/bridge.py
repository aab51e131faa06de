"""`maglev-mj bridge`: a scene on a remote device."""

from __future__ import annotations

import argparse
import itertools
import shlex
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path

import numpy as np

from maglev_mj.bridge.bench.calibration import Calibration
from maglev_mj.bridge.bench.identification import collect, excitation, identify
from maglev_mj.bridge.fault import DeviceFault, HandshakeError, fault_meanings
from maglev_mj.bridge.flight import LANDING_TIME, Flight, StopSwitch, expected_delay
from maglev_mj.bridge.links import open_link
from maglev_mj.bridge.realtime import interrupt, realtime, stopping
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.bridge.safety import HostLimits
from maglev_mj.bridge.wire import Fault, fault_names
from maglev_mj.cli.arguments import Parser
from maglev_mj.cli.options import add_bridge, add_parameters, add_recording, chosen, chosen_key, number_option
from maglev_mj.cli.progress import Progress
from maglev_mj.cli.publishers import add_publishers, chosen_publishers
from maglev_mj.cli.scenes import add_scene, chosen_scene, warn_of_instability
from maglev_mj.cli.web import add_web, chosen_front
from maglev_mj.errors import MaglevError, ParameterError, PlantError
from maglev_mj.parameters import number
from maglev_mj.recording import RecordingFile, open_recording, tee
from maglev_mj.scenes import Scene
from maglev_mj.session import DEVICES_OWN, Publisher, Snapshot, device_actions
from maglev_mj.terminal import say, wrapped
from maglev_mj.views.remote import Front, RemoteViewer

_IDENTIFYING = 10.0
_FLYING = "record", "view", "web", "seconds", "spacenav", "foxglove"

_ENDS = f"""\
how a flight ends, in takeoff, flight and landing alike:
  Ctrl-C               lands; currents not off {LANDING_TIME:g} s later are cut
  Ctrl-C twice         cuts the currents now: an emergency stop
  SIGTERM, SIGHUP      land as the first Ctrl-C, however often they come
  Esc in the window    cuts the currents now; closing the window lands
  emergency stop       on the page cuts them too; closing a tab does nothing
  maglev-mj estop ADDRESS [--key FILE]
                       cuts them from any terminal, whatever this program does
  this program dies    the device's watchdog cuts them
A cut latches a fault: --reset shows and clears it. None of this replaces a switch
that cuts the amplifiers. Exit status: 0 landed, 1 cut or failed, 2 bad input,
130 stopped before takeoff.
"""


def add_options(parser: Parser) -> None:
    """Add the options of the command."""
    parser.description, parser.epilog = "A scene on a device at the other end of a wire.", _ENDS
    parser.add_argument("address", metavar="ADDRESS", help="udp://HOST:PORT, or serial:///PATH?baud=RATE")
    add_scene(parser, option="--scene", default="joystick", without=DEVICES_OWN)
    run = parser.group("run")
    run.add_argument("--reset", action="store_true", help="show what is latched in the device, clear it, and end")
    run.add_argument("--view", action="store_true", help="a window on the device; its hand is at the device")
    add_web(parser)
    add_bridge(parser)
    limits = parser.group("limits of the host; the smaller of these and the device's counts")
    add_parameters(limits, HostLimits)
    limits.add_argument(
        "--profile", metavar="FILE", type=Path, help="these limits by name, as JSON; options go before it"
    )
    add_recording(parser)
    parser.group("output").add_argument(
        "--out", metavar="DIR", type=Path, default=Path(), help="folder for the last cycles before a fault (default .)"
    )
    add_publishers(parser)
    identification = parser.group("identification, instead of a scene")
    identification.add_argument(
        "--identify",
        metavar="FILE",
        type=Path,
        help=f"shake the flotor gently for {_IDENTIFYING:g} s and write its calibration",
    )
    identification.add_argument("--mass", type=number_option, metavar="X", help="moving mass [kg]")
    parser.set_defaults(run=_bridge)


def _bridge(options: argparse.Namespace) -> int:
    scene, key = chosen_scene(options), chosen_key(options.key)  # before the device: errors are reported at once
    limits = chosen(options, HostLimits() if options.profile is None else HostLimits.load(options.profile))
    _check(options)
    calibration = Calibration.nominal() if options.calibration is None else Calibration.load(options.calibration)
    front = chosen_front(options, options.out, watch=True)
    # publishers first: their errors are reported before the device moves
    with (
        _faults_told(options),
        stopping(interrupt, lambda: None),  # closing is not stopped by a second Ctrl-C
        chosen_publishers(options) as (publishers, live),
        _opened(options, calibration, key, limits) as plant,
    ):
        if options.reset:
            print(_latched(plant), flush=True)
            if plant.faults:
                plant.reset()
                print("  reset; the next flight is a command of its own")
            return 0
        if options.identify is not None:
            return _identify(plant, options)
        scene = scene.replace(period=plant.period, delay=plant.delay)
        warn_of_instability(scene, [*[calibration.mass] * 3, *calibration.inertia], expected_delay(plant))
        _fly(plant, scene, options, front, publishers, live)
    return 0


def _check(options: argparse.Namespace) -> None:
    """Check options as far as possible without the device."""
    if options.seconds is not None:
        number("seconds", options.seconds, above=0.0)
    if options.mass is not None and options.identify is None:
        raise ParameterError("mass is for --identify")
    for mode in ("identify", "reset"):
        for name in _FLYING:
            if getattr(options, mode) and getattr(options, name) not in (None, False):
                raise ParameterError(f"{name} is for scenes, not for --{mode}")
    if options.reset and options.identify is not None:
        raise ParameterError("identify flies, and --reset does not: two commands")


def _fly(
    plant: RemotePlant,
    scene: Scene,
    options: argparse.Namespace,
    front: Front | None,
    publishers: Sequence[Publisher],
    live: RecordingFile | None,
) -> None:
    """Fly a scene; then disarm the device and close recordings.

    In this order, at any end of the flight.
    """
    switch = StopSwitch()
    with ExitStack() as last:
        last.enter_context(stopping(switch.land, switch.cut, within=LANDING_TIME))
        viewer = None
        if front is not None:
            blank = Snapshot(scene=scene, actions=device_actions(type(scene)))
            viewer = RemoteViewer(blank, front, watch=options.web)
            last.callback(viewer.close)
            publishers = [*publishers, viewer]
        file = None if options.record is None else open_recording(options.record)
        if file is not None:
            last.push(partial(_keep, file))
        flight = Flight(
            plant,
            scene,
            switch=switch,
            file=tee(file, live),
            publishers=publishers,
            warn=_warn,
            step_force=options.step_force,
        )
        if viewer is not None:
            viewer.on_close, viewer.on_emergency = switch.land, switch.cut
        last.push(plant)  # the device is closed first
        with _punctual(options):
            print(f"  {scene.name} at {1.0 / plant.period:g} Hz; keep hands off while it takes off", flush=True)
            try:
                report = flight.run(options.seconds)
            except BaseException:
                if text := str(flight.timing.table(flight.warning)):
                    with suppress(OSError):  # a closed output must not hide the fault
                        print(text, flush=True)
                raise
            print(report, flight.timing.table(flight.warning), sep="\n", flush=True)


def _latched(plant: RemotePlant) -> str:
    """Return the faults latched at the handshake, with their meanings."""
    if not plant.faults:
        return f"  no fault is latched; the device is {plant.state.name.lower()}"
    meanings = [wrapped(meaning, "    ", "      ") for meaning in fault_meanings(fault_names(plant.faults))]
    return "\n".join(itertools.chain(wrapped(plant.latched), *meanings))


def _warn(text: str) -> None:
    with suppress(OSError):  # a closed terminal must not end the flight
        say(f"  {text}", sys.stderr)


def _keep(file: RecordingFile, _kind: object, error: BaseException | None, _trace: object) -> None:
    """Close a recording; print its error after an earlier one."""
    try:
        path = file.close()
    except (MaglevError, OSError) as problem:
        if error is None:
            raise
        say(f"  {problem}", sys.stderr)
        return
    print(f"  wrote {path}" if path is not None else "  nothing was recorded: it did not come to fly")


def _opened(
    options: argparse.Namespace, calibration: Calibration, key: bytes | None, limits: HostLimits
) -> RemotePlant:
    try:
        link = open_link(options.address, key)
        return RemotePlant(link, calibration=calibration, key=key, limits=limits, folder=options.out)
    except HandshakeError as error:
        raise HandshakeError(f"{options.address}: {error}") from None


@contextmanager
def _faults_told(options: argparse.Namespace) -> Iterator[None]:
    """Add the command that clears a fault to its message."""
    try:
        yield
    except DeviceFault as error:
        ends = [f"--{name}={value}" for name in ("key", "calibration") if (value := getattr(options, name)) is not None]
        again = shlex.join(["maglev-mj", "bridge", options.address, *ends, "--reset"])
        late = options.address.startswith("serial:") and Fault.WATCHDOG in error.faults
        hint = "; a busy machine hands over a serial line's bytes late: keep a processor free" if late else ""
        raise PlantError(f"{error}{hint}; the currents are cut; {again} clears the fault") from error


@contextmanager
def _punctual(options: argparse.Namespace) -> Iterator[None]:
    """Run in real time and print refused settings."""
    with realtime(options.realtime) as refused:
        for complaint in refused:
            print(f"  not in real time: {complaint}", file=sys.stderr)
        yield


def _identify(plant: RemotePlant, options: argparse.Namespace) -> int:
    mass = plant.calibration.mass if options.mass is None else number("mass", options.mass, above=0.0)
    # before takeoff: the device would take the time that this needs for a host that is gone
    shaker = excitation(plant.calibration, period=plant.period, delay=plant.delay)
    switch = StopSwitch()
    with stopping(switch.land, switch.cut, within=LANDING_TIME), _punctual(options), switch.flying(plant):
        plant.takeoff(watch=lambda: switch.landing)
        motion = collect(plant, shaker, _IDENTIFYING, then=plant.land, watch=lambda: switch.landing)
    # the wire and this program take their time too, which the map would have to pay for
    with Progress("identify"):
        found = identify(motion.poses, motion.currents, period=plant.period, delay=motion.delay)
    found.calibration(plant.calibration, mass).save(options.identify)
    x, y, z = found.gravity
    doubt = found.free_errors[:3].max()
    missing = int(np.isnan(motion.currents[:, 0]).sum())
    taken = f"gravity {x:.4f}, {y:.4f}, {z:.4f} m/s², give or take {doubt:.4f}; mass taken for {mass:g} kg"
    late = (
        f"delay {motion.delay * 1e3:.3f} ms; {missing} of {len(motion.poses)} samples lost, or answered late or early"
    )
    print("\n".join(wrapped(taken) + wrapped(late)))
    print(f"  wrote {options.identify}")
    return 0
