"""Command `bridge`: a scene on a remote device."""

from __future__ import annotations

import argparse
import itertools
import shlex
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Annotated, Literal, NamedTuple, TypeAlias

import numpy as np

from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.commissioning.identification import collect, excitation
from maglev_mj.bridge.commissioning.identification import identify as identify_device
from maglev_mj.bridge.fault import DeviceFault, HandshakeError, fault_meanings
from maglev_mj.bridge.flight import Flight
from maglev_mj.bridge.landing import LANDING_TIME, StopSwitch
from maglev_mj.bridge.links import open_link
from maglev_mj.bridge.preflight import MARGIN, Preflight, judge_change, measure_line, preflight, stiffest_walls
from maglev_mj.bridge.realtime import interrupt, stopping
from maglev_mj.bridge.realtime import realtime as scheduled
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.bridge.safety import HostLimits
from maglev_mj.bridge.wire import Fault, fault_names
from maglev_mj.cli.declare import Parser, Shared, option
from maglev_mj.cli.options import (
    Address,
    CalibrationFile,
    Key,
    Realtime,
    Record,
    Seconds,
    add_parameters,
    add_scene,
    chosen,
    chosen_scene,
)
from maglev_mj.cli.output import Progress, print_written
from maglev_mj.cli.peripherals import PageOptions
from maglev_mj.errors import MaglevError, ParameterError, PlantError
from maglev_mj.process import SideAnswers
from maglev_mj.recording import RecordingFile, open_recording
from maglev_mj.scenes import Scene
from maglev_mj.session import DEVICES_OWN, UNKNOWN, Snapshot, device_actions
from maglev_mj.terminal import say, wrapped
from maglev_mj.views.viewer_process import Front, RemoteViewer

_IDENTIFYING = 10.0
_IDENTIFICATION = "identification, instead of a scene"
_MEASURED = 10.0
_LIMITS = "limits of the host; the smaller of these and the device's counts"

_TWINS = "udp://127.", "udp://localhost", "udp://[::1]"
"""Addresses at which a twin of this machine answers."""

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
that cuts the amplifiers. Exit status: 0 landed, 1 cut, refused or ended
by a guard, 2 bad input,
130 stopped before takeoff.
"""


def _add_scene(parser: Parser) -> None:
    parser.epilog = _ENDS
    add_scene(parser, option="--scene", default="joystick", without=DEVICES_OWN)


def _add_limits(parser: Parser) -> None:
    group = parser.group(_LIMITS)
    add_parameters(group, HostLimits)
    group.add_argument(
        "--profile", metavar="FILE", type=Path, help="these limits by name, as JSON; options go before it"
    )


def _chosen_limits(options: argparse.Namespace) -> HostLimits:
    return chosen(options, HostLimits() if options.profile is None else HostLimits.load(options.profile))


_FlownScene: TypeAlias = Annotated[Scene, Shared(_add_scene, chosen_scene)]
_Limits: TypeAlias = Annotated[HostLimits, Shared(_add_limits, _chosen_limits)]


def _ends_of(options: argparse.Namespace) -> list[str]:
    """Return the options by which the device is reached again."""
    return [f"--{name}={value}" for name in ("key", "calibration") if (value := getattr(options, name)) is not None]


_Reconnect: TypeAlias = Annotated[list[str], Shared(None, _ends_of)]


def bridge(
    *,
    address: Address,
    scene: _FlownScene,
    reset: Annotated[bool, option("show what is latched in the device, clear it, and end")] = False,
    check: Annotated[
        bool, option(f"measure the line for {_MEASURED:g} s without current, say what it bears, and end")
    ] = False,
    as_written: Annotated[
        bool, option(f"the scene's own walls, though they bear less than {MARGIN:g} times the line's delay")
    ] = False,
    anyway: Annotated[
        bool, option("fly what the check before takeoff refuses; on a device with --max-current of at most half")
    ] = False,
    view: Annotated[bool, option("a window on the device; its hand is at the device")] = False,
    page: PageOptions,
    calibration: CalibrationFile,
    key: Key = None,
    seconds: Seconds = None,
    realtime: Realtime = "ignore",
    limits: _Limits,
    record: Record = None,
    out: Annotated[Path, option("folder for the last cycles before a fault", "output", "DIR")] = Path(),
    identify: Annotated[
        Path | None,
        option(f"shake the flotor gently for {_IDENTIFYING:g} s and write its calibration", _IDENTIFICATION),
    ] = None,
    mass: Annotated[float | None, option("moving mass [kg]", _IDENTIFICATION, above=0.0)] = None,
    reconnect: _Reconnect,
) -> int:
    """A scene on a device at the other end of a wire."""  # noqa: D401
    flying = {"record": record is not None, "view": view, "web": page.web, "seconds": seconds is not None}
    modes = {"reset": reset, "check": check, "identify": identify is not None}
    _check(modes, mass is not None, [name for name, chosen in flying.items() if chosen])
    front = page.front(view, out, watch=True)
    with (
        _with_remedy(address, reconnect),
        stopping(interrupt, lambda: None),  # closing is not stopped by a second Ctrl-C
        _opened(address, key, calibration, limits, out) as plant,
    ):
        if reset:
            print(_latched(plant), flush=True)
            if plant.faults:
                plant.reset()
                print("  reset; the next flight is a command of its own")
            return 0
        if identify is not None:
            return _identify(plant, identify, mass, realtime)
        if check:
            return _checked_line(plant, scene, realtime)
        print("  measuring the line, and computing what the scene bears", flush=True)
        with scheduled(realtime):  # as the flight, which says what is refused
            report = measure_line(plant)
        found = preflight(plant, scene, as_written=as_written, report=report)
        anyway = _may_fly(plant, address, found, anyway)
        if found.softened:
            print("\n".join(wrapped(found.softened)), flush=True)
        return _fly(plant, _Flown(found, anyway, seconds, record, realtime), front, page.web)


def _check(modes: Mapping[str, bool], mass: bool, flying: Sequence[str]) -> None:
    """Check which options are given together, as far as possible without the device."""
    if mass and not modes["identify"]:
        raise ParameterError("mass is for --identify")
    active = [mode for mode, on in modes.items() if on]
    if active and flying:
        raise ParameterError(f"{flying[0]} is for scenes, not for --{active[0]}")
    if modes["reset"] and modes["identify"]:
        raise ParameterError("identify flies, and --reset does not: two commands")
    if len(active) > 1:
        raise ParameterError(f"{active[0]} and {active[1]} are two commands")


def _checked_line(plant: RemotePlant, scene: Scene, policy: Literal["enforce", "ignore"]) -> int:
    """Print what the line takes and bears; return the exit status."""
    print(f"  measuring the line for {_MEASURED:g} s, without current", flush=True)
    with _punctual(policy):
        report = measure_line(plant, _MEASURED)
    found = preflight(plant, scene, report=report)
    print(found.report.table())
    walls = (
        f"{hand} {stiffness:.0f} N/m with {damping:.0f} N s/m"
        for hand, (stiffness, damping) in stiffest_walls(found.report, plant).items()
    )
    bears = f"the stiffest wall at {found.report.planned * 1e3:.2f} ms ({MARGIN:g} times the line), by hand"
    print("\n".join(wrapped(f"{bears}: {', '.join(walls)}")))
    verdict = found.problem or found.softened or f"{scene.name} bears {found.bears * 1e3:.2f} ms: it may fly"
    print("\n".join(wrapped(verdict)))
    return 1 if found.problem else 0


def _may_fly(plant: RemotePlant, address: str, found: Preflight, anyway: bool) -> bool:
    """Refuse or say what the check before takeoff has found.

    Returns:
        Whether settings in flight are taken though they would be refused.
    """
    half = 0.5 * plant.stated.current_limit
    weak = address.startswith(_TWINS) or plant.limits.current_limit <= half
    if found.problem and not anyway:
        raise PlantError(f"no takeoff: {found.problem}; --anyway flies it")
    if found.problem and not weak:
        raise PlantError(f"no takeoff: --anyway needs --max-current of at most {half:g} A on a device: {found.problem}")
    if found.problem:
        _warn(f"warning: {found.problem}")
    return anyway and weak


class _Flown(NamedTuple):
    """Chosen flight of a scene."""

    found: Preflight
    anyway: bool
    seconds: float | None
    record: Path | None
    realtime: Literal["enforce", "ignore"]


def _fly(plant: RemotePlant, flown: _Flown, front: Front | None, watch: bool) -> int:
    """Fly a scene; then disarm the device and close recordings; return the exit status.

    In this order, at any end of the flight.
    """
    found, switch = flown.found, StopSwitch()
    scene = found.scene
    with ExitStack() as last:
        last.enter_context(switch.signals())
        viewer = None
        if front is not None:
            blank = Snapshot(scene=scene, actions=device_actions(type(scene)))
            viewer = RemoteViewer(blank, front, watch=watch)
            last.callback(viewer.close)
        file = None if flown.record is None else open_recording(flown.record)
        if file is not None:
            last.push(partial(_keep, file))
        judge = None
        if viewer is not None:  # before this thread is a real-time one, as a process inherits that
            judge = SideAnswers(partial(judge_change, report=found.report, anyway=flown.anyway), UNKNOWN)
            last.callback(judge.close, 0.0)
        flight = Flight(
            plant,
            scene,
            switch=switch,
            file=file,
            publishers=[] if viewer is None else [viewer],
            warn=_warn,
            bears=found.report.anyway if found.problem else found.bears,
            judge=judge,
        )
        if viewer is not None:
            viewer.on_close, viewer.on_emergency = switch.land, switch.cut
        last.push(plant)  # the device is closed first
        with _punctual(flown.realtime):
            print(f"  {scene.name} at {1.0 / plant.period:g} Hz; keep hands off while it takes off", flush=True)
            try:
                report = flight.run(flown.seconds)
            except BaseException:
                if text := str(flight.timing.table()):
                    with suppress(OSError):  # a closed output must not hide the fault
                        print(text, flush=True)
                raise
            print(report, flight.timing.table(), sep="\n", flush=True)
    return 1 if report.landing.reason else 0


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
    if path is None:
        print("  nothing was recorded: it did not come to fly")
    else:
        print_written(path)


def _opened(address: str, key: bytes | None, calibration: Calibration, limits: HostLimits, folder: Path) -> RemotePlant:
    try:
        link = open_link(address, key)
        return RemotePlant(link, calibration=calibration, key=key, limits=limits, folder=folder)
    except HandshakeError as error:
        raise HandshakeError(f"{address}: {error}") from None


@contextmanager
def _with_remedy(address: str, ends: Sequence[str]) -> Iterator[None]:
    """Add the command that clears a fault to its message."""
    try:
        yield
    except DeviceFault as error:
        again = shlex.join(["maglev-mj", "bridge", address, *ends, "--reset"])
        late = address.startswith("serial:") and Fault.WATCHDOG in error.faults
        hint = "; a busy machine hands over a serial line's bytes late: keep a processor free" if late else ""
        raise PlantError(f"{error}{hint}; the currents are cut; {again} clears the fault") from error


@contextmanager
def _punctual(policy: Literal["enforce", "ignore"]) -> Iterator[None]:
    """Run in real time and print refused settings."""
    with scheduled(policy) as refused:
        for complaint in refused:
            print(f"  not in real time: {complaint}", file=sys.stderr)
        yield


def _identify(plant: RemotePlant, path: Path, mass: float | None, policy: Literal["enforce", "ignore"]) -> int:
    mass = plant.calibration.mass if mass is None else mass
    # before takeoff: the device would take the time that this needs for a host that is gone
    shaker = excitation(plant.calibration, period=plant.period, delay=plant.delay)
    switch = StopSwitch()
    with switch.signals(), _punctual(policy), switch.flying(plant):
        plant.takeoff(watch=lambda: switch.landing)
        motion = collect(plant, shaker, _IDENTIFYING, then=plant.land, watch=lambda: switch.landing)
    # the wire and this program take their time too, which the map would have to pay for
    with Progress("identify"):
        device = identify_device(motion.poses, motion.currents, period=plant.period, delay=motion.delay)
    device.calibration(plant.calibration, mass).save(path)
    x, y, z = device.gravity
    doubt = device.free_errors[:3].max()
    missing = int(np.isnan(motion.currents[:, 0]).sum())
    taken = f"gravity {x:.4f}, {y:.4f}, {z:.4f} m/s², give or take {doubt:.4f}; mass taken for {mass:g} kg"
    late = (
        f"delay {motion.delay * 1e3:.3f} ms; {missing} of {len(motion.poses)} samples lost, or answered late or early"
    )
    print("\n".join(wrapped(taken) + wrapped(late)))
    print(f"  wrote {path}")
    return 0
