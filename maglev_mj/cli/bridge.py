"""Command `bridge`: fly a scene on a device."""

from __future__ import annotations

import argparse
import itertools
import math
import shlex
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, TypeAlias

import numpy as np

from maglev_mj.bridge.commissioning.calibration import Calibration
from maglev_mj.bridge.commissioning.identification import collect, excitation
from maglev_mj.bridge.commissioning.identification import identify as identify_device
from maglev_mj.bridge.fault import DeviceFault, HandshakeError, fault_meanings
from maglev_mj.bridge.flight import Flight
from maglev_mj.bridge.haply.flight import fly_arm, preflight_arm
from maglev_mj.bridge.haply.plant import Arm, HaplyPlant
from maglev_mj.bridge.landing import LANDING_TIME, StopSwitch
from maglev_mj.bridge.links import open_link
from maglev_mj.bridge.preflight import MARGIN, Preflight, check_change, measure_link, preflight, stiffest_walls
from maglev_mj.bridge.realtime import interrupt, stopping
from maglev_mj.bridge.realtime import realtime as scheduled
from maglev_mj.bridge.remote import RemotePlant
from maglev_mj.bridge.safety import HostLimits
from maglev_mj.bridge.wire import Fault, fault_names
from maglev_mj.cli.declare import Parser, Shared, option
from maglev_mj.cli.options import (
    Address,
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
from maglev_mj.device import PUBLISHED
from maglev_mj.errors import MaglevError, ParameterError, PlantError
from maglev_mj.process import SideAnswers
from maglev_mj.recording import RecordingFile, open_recording
from maglev_mj.result import Table
from maglev_mj.scenes import Scene
from maglev_mj.session import DEVICE_PARAMETERS, UNKNOWN, DeviceStatus, Snapshot, device_actions
from maglev_mj.terminal import say, wrapped
from maglev_mj.theory.loop import Bound
from maglev_mj.theory.read import scene_lag
from maglev_mj.views.viewer_process import RemoteViewer, ViewerFunction

_IDENTIFYING, _ANSWER = 10.0, 10.0
_IDENTIFICATION = "identification (instead of a scene)"
_MEASURED = 10.0
_LIMITS = "limits of the host (the device's own limits apply too)"

_TWINS = "udp://127.", "udp://localhost", "udp://[::1]"
"""Loopback addresses: only a twin can answer there."""

_ENDS = f"""\
how to stop a flight, at any time from takeoff to landing:
  Ctrl-C               land; cut the currents if they are not off after {LANDING_TIME:g} s
  Ctrl-C twice         cut the currents immediately (emergency stop)
  SIGTERM, SIGHUP      land; repeating them changes nothing
  Esc in the window    cut the currents immediately; closing the window lands
  Emergency stop       on the page: cut the currents; closing a tab does not
  maglev-mj estop ADDRESS [--key FILE]
                       cut them from any terminal, even if this program hangs
                       (UDP only: a serial link has one user)
  this program dies    the device's watchdog starts a controlled stop
A cut latches a fault; --reset shows and clears it. None of this replaces a
switch that cuts the amplifiers' power. Exit status: 0 landed; 1 cut, refused,
or ended by a guard; 2 invalid input; 130 stopped before takeoff.
"""


def _add_scene(parser: Parser) -> None:
    parser.epilog = _ENDS
    add_scene(parser, option="--scene", default="joystick", without=DEVICE_PARAMETERS)


def _add_limits(parser: Parser) -> None:
    group = parser.group(_LIMITS)
    published, scaled = HostLimits(), [item.name for item in HostLimits.parameters() if item.derive is not None]
    own = {name: f"the device's own; {getattr(published, name):.4g} on the published joystick" for name in scaled}
    add_parameters(group, published, sources=own)
    group.add_argument(
        "--profile", metavar="FILE", type=Path, help="JSON file with these limits by name; options override it"
    )


def _chosen_limits(options: argparse.Namespace) -> HostLimits:
    return chosen(options, HostLimits() if options.profile is None else HostLimits.load(options.profile))


_FlownScene: TypeAlias = Annotated[Scene, Shared(_add_scene, chosen_scene)]
_Limits: TypeAlias = Annotated[HostLimits, Shared(_add_limits, _chosen_limits)]


def _ends_of(options: argparse.Namespace) -> list[str]:
    """Return the options that a command needs to reach the same device."""
    device = chosen_scene(options).device
    key = [] if options.key is None else [f"--key={options.key}"]
    return key + ([] if device == PUBLISHED else [f"--device={device}"])


_Reconnect: TypeAlias = Annotated[list[str], Shared(None, _ends_of)]


def bridge(
    *,
    address: Address,
    scene: _FlownScene,
    reset: Annotated[bool, option("show and clear the latched faults, then exit")] = False,
    check: Annotated[
        bool, option(f"preflight check only: loop delay and stability, measured for {_MEASURED:g} s with currents off")
    ] = False,
    as_written: Annotated[
        bool,
        option(f"keep the scene's walls even if unstable at the device's delay plus {MARGIN:g} times the link latency"),
    ] = False,
    require_stiffness: Annotated[
        float | None,
        option("refuse to fly with walls softer than this, instead of reducing their stiffness [N/m]", above=0.0),
    ] = None,
    anyway: Annotated[
        bool, option("fly despite a failed preflight check; a device needs --max-current of at most half its limit")
    ] = False,
    view: Annotated[bool, option("3D window; keys change settings, the mouse does nothing")] = False,
    page: PageOptions,
    key: Key = None,
    seconds: Seconds = None,
    realtime: Realtime = "ignore",
    limits: _Limits,
    record: Record = None,
    out: Annotated[Path, option("folder for the fault recording", "output", "DIR")] = Path(),
    identify: Annotated[
        Path | None,
        option(f"identify the device by small motions, {_IDENTIFYING:g} s; write the device file", _IDENTIFICATION),
    ] = None,
    mass: Annotated[float | None, option("moving mass [kg]", _IDENTIFICATION, above=0.0)] = None,
    reconnect: _Reconnect,
) -> int:
    """Fly a scene on a device, or on its twin, over UDP or a serial link; or on an arm at haply://HOST:PORT."""
    if address.startswith("haply:"):
        refused: dict[str, object] = {"reset": reset, "identify": identify, "mass": mass, "anyway": anyway}
        refused |= {"view": view, "web": page.web}
        if others := [name for name, value in refused.items() if value]:
            raise ParameterError(f"--{others[0]} does not apply to haply://")
        with _opened_arm(Arm.of(scene.hardware), address, key, limits, realtime) as arm:
            result = preflight_arm(arm, scene, as_written=as_written)
            if check:
                return _print_check(result, arm.period, arm.arm.mass)
            _print_held(result)
            _require(require_stiffness, result)
            if result.problem:
                raise PlantError(f"no flight: {result.problem}")
            return _fly_arm(arm, scene, result, seconds, record)
    flying = {"record": record is not None, "view": view, "web": page.web, "seconds": seconds is not None}
    calibration = Calibration.of(scene.hardware)
    modes = {"reset": reset, "check": check, "identify": identify is not None}
    _check(modes, mass is not None, [name for name, chosen in flying.items() if chosen])
    front = page.front(view, out, watch=True)
    with (
        _with_remedy(address, reconnect),
        stopping(interrupt, lambda: None),  # a second Ctrl-C must not interrupt closing
        _opened(address, key, calibration, limits, out) as plant,
    ):
        if reset:
            print(_latched(plant), flush=True)
            if plant.faults:
                plant.reset()
                print("  faults cleared")
            return 0
        if identify is not None:
            return _identify(plant, identify, mass, realtime)
        if check:
            print(f"  measuring link latency for {_MEASURED:g} s, currents off", flush=True)
            with _punctual(realtime):
                report = measure_link(plant, _MEASURED)
            return _print_check(preflight(plant, scene, report=report), plant.period, plant.calibration.mass)
        print("  measuring link latency and checking the scene's stability", flush=True)
        result = preflight(plant, scene, as_written=as_written, aside=True, realtime=realtime)
        _print_held(result)
        _require(require_stiffness, result)
        anyway = _may_fly(plant, address, result, anyway)
        if result.reduction:
            print("\n".join(wrapped(result.reduction)), flush=True)
        return _fly(plant, _Flown(address, result, anyway, seconds, record, realtime), front, page.web)


def _check(modes: Mapping[str, bool], mass: bool, flying: Sequence[str]) -> None:
    """Raise ParameterError for options that exclude each other."""
    if mass and not modes["identify"]:
        raise ParameterError("--mass requires --identify")
    active = [mode for mode, on in modes.items() if on]
    if active and flying:
        raise ParameterError(f"--{flying[0]} cannot be combined with --{active[0]}")
    if len(active) > 1:
        raise ParameterError(f"--{active[0]} and --{active[1]} cannot be combined; run them one after the other")


def _print_check(result: Preflight, period: float, mass: float) -> int:
    """Print link latency and stability of the scene; return the exit status."""
    print("", result.report.table(), sep="\n")
    walls = stiffest_walls(result.report, period, mass, scene_lag(result.scene))
    rows = [(hand, f"{stiffness:.0f}", f"{damping:.0f}") for hand, (stiffness, damping) in walls.items()]
    title = f"Critical stiffness at {result.report.required_delay * 1e3:.2f} ms ({MARGIN:g} times the latency)"
    print("", Table(title, ("hand", "stiffness [N/m]", "at damping [N s/m]"), rows), "", sep="\n")
    critical = result.critical_delay
    limit = f"up to {critical * 1e3:.2f} ms"
    if isinstance(critical, Bound) and critical.beyond:
        limit = f"at delays of {critical.text('ms', 1e3)}"
    verdict = result.problem or result.reduction or f"{result.scene.name} is stable {limit}: ready"
    print("\n".join(wrapped(verdict)))
    _print_held(result)
    return 1 if result.problem else 0


def _print_held(result: Preflight) -> None:
    """Print the verdict free and in each hand, as a scene may have been tested in one only; and that on the line."""
    for line in (*result.held, *filter(None, [result.line])):
        print("\n".join(wrapped(line, further="    ")), flush=True)


def _require(least: float | None, result: Preflight) -> None:
    """Raise PlantError if the walls are softer than the least stiffness [N/m]; ParameterError without walls."""
    if least is None:
        return
    if result.requested is None:
        raise ParameterError(f"--require-stiffness needs a scene with a stiffness (got {result.scene.name})")
    if result.scene.stiffness < least:  # type: ignore[attr-defined]
        why = f": {result.reduction}" if result.reduction else ""
        raise PlantError(f"no takeoff: {result.rendered}, below the required {least:g} N/m{why}")


def _may_fly(plant: RemotePlant, address: str, result: Preflight, anyway: bool) -> bool:
    """Return True if a failed check may be overridden, in flight too.

    Raises:
        PlantError: If the preflight check failed and may not be overridden.
    """
    half = 0.5 * plant.stated.current_limit
    weak = address.startswith(_TWINS) or plant.limits.current_limit <= half
    if result.problem and not anyway:
        raise PlantError(f"no takeoff: {result.problem}; use --anyway to fly regardless")
    if result.problem and not weak:
        raise PlantError(
            f"no takeoff: --anyway needs --max-current of at most {half:g} A on a device: {result.problem}"
        )
    if result.problem:
        _warn(f"warning: {result.problem}")
    return anyway and weak


class _Flown(NamedTuple):
    """Options of a flight."""

    address: str
    result: Preflight
    anyway: bool
    seconds: float | None
    record: Path | None
    realtime: Literal["enforce", "ignore"]


def _fly(plant: RemotePlant, flown: _Flown, front: ViewerFunction | None, watch: bool) -> int:
    """Fly a scene and return the exit status.

    However the flight ends, the device is disarmed before recordings are closed.
    """
    result, switch = flown.result, StopSwitch()
    scene = result.scene
    with ExitStack() as last:
        last.enter_context(switch.signals())
        viewer = None
        requested = result.requested if result.reduction and result.requested is not None else math.nan
        device = DeviceStatus(flown.address, "before takeoff", requested=requested)
        if front is not None:
            idle = "before takeoff: nothing is rendered"
            blank = Snapshot(scene=scene, actions=device_actions(type(scene)), idle=idle, device=device)
            viewer = RemoteViewer(blank, front, watch=watch)
            last.callback(viewer.close)
        file = None if flown.record is None else open_recording(flown.record)
        if file is not None:
            last.push(partial(_keep, file))
        # before real-time scheduling, which a child process would inherit
        check = SideAnswers(partial(check_change, report=result.report, anyway=flown.anyway), UNKNOWN, _ANSWER)
        last.callback(check.close, 0.0)
        flight = Flight(
            plant,
            scene,
            switch=switch,
            file=file,
            publishers=[] if viewer is None else [viewer],
            warn=_warn,
            rendered=result.rendered,
            critical_delay=result.report.anyway if result.problem else result.critical_delay,
            device=device,
            check=check,
        )
        if viewer is not None:
            viewer.on_close, viewer.on_emergency = switch.land, switch.cut
        last.push(plant)  # the device is closed first
        with _punctual(flown.realtime):
            flown_as = ", ".join(filter(None, (f"{scene.name} at {1.0 / plant.period:g} Hz", result.rendered)))
            print(f"  {flown_as}; keep hands off during takeoff", flush=True)
            try:
                report = flight.run(flown.seconds)
            except BaseException:
                if text := str(flight.timing.table()):
                    with suppress(OSError):  # a closed output must not hide the fault
                        print("", text, "", sep="\n", flush=True)
                raise
            print(report, "", flight.timing.table(), "", sep="\n", flush=True)
    return 1 if report.landing.reason else 0


@contextmanager
def _opened_arm(
    arm: Arm, address: str, key: bytes | None, limits: HostLimits, policy: Literal["enforce", "ignore"]
) -> Iterator[HaplyPlant]:
    """Open an arm in real time, with the smaller of its limits and the host's on force and speed."""
    if limits.replace(force_limit=None, speed_limit=HostLimits().speed_limit) != HostLimits():
        raise ParameterError("limits of the host for haply:// are --force-limit and --speed-limit")
    force = limits.force_limit or math.inf
    most: Any = {"force_limit": [min(force, part) for part in arm.force_limit]}
    arm = replace(arm, speed_limit=min(limits.speed_limit, arm.speed_limit), **most)
    with _punctual(policy), HaplyPlant(address, arm=arm, key=key) as plant:  # its thread receives in real time too
        print(f"  arm {plant.device}: measuring round trips and checking stability; force off", flush=True)
        yield plant


def _fly_arm(plant: HaplyPlant, scene: Scene, result: Preflight, seconds: float | None, record: Path | None) -> int:
    """Fly a scene on an arm; return the exit status."""
    with ExitStack() as last:
        last.enter_context((switch := StopSwitch()).signals())
        file = None if record is None else open_recording(record)
        if file is not None:
            last.push(partial(_keep, file))
        start = f"{scene.name}, forces only, without torques and pulses; {result.reduction or result.rendered}"
        print("\n".join(wrapped(start)), flush=True)
        count, reason = fly_arm(plant, scene, result, duration=seconds, switch=switch, file=file)
        ended = f"; ended early: {reason}" if reason else ""
        print("\n".join(wrapped(f"{count * plant.period:.1f} s, {count} samples; the force has faded to zero{ended}")))
    return 1 if reason else 0


def _latched(plant: RemotePlant) -> str:
    """Return the latched faults and their meanings as text."""
    if not plant.faults:
        return f"  no fault latched; device {plant.state.name.lower()}"
    meanings = [wrapped(meaning, "    ", "      ") for meaning in fault_meanings(fault_names(plant.faults))]
    return "\n".join(itertools.chain(wrapped(plant.latched), *meanings))


def _warn(text: str) -> None:
    with suppress(OSError):  # a closed terminal must not end the flight
        say(f"  {text}", sys.stderr)


def _keep(file: RecordingFile, _kind: object, error: BaseException | None, _trace: object) -> None:
    """Close a recording; print its error if another one is already propagating."""
    try:
        path = file.close()
    except (MaglevError, OSError) as problem:
        if error is None:
            raise
        say(f"  {problem}", sys.stderr)
        return
    if path is None:
        print("  no recording: the flight did not start")
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
    """Append the command that clears a fault to its message."""
    try:
        yield
    except DeviceFault as error:
        again = shlex.join(["maglev-mj", "bridge", address, *ends, "--reset"])
        serial = address.startswith("serial:") and Fault.WATCHDOG in error.faults
        hint = "; a busy machine delays serial data: keep a CPU core free" if serial else ""
        raise PlantError(
            f"{error}{hint}; {'then ' if error.off is None else ''}clear the fault with: {again}"
        ) from error


@contextmanager
def _punctual(policy: Literal["enforce", "ignore"]) -> Iterator[None]:
    """Run in real time and print the settings that the system refused."""
    with scheduled(policy) as refused:
        for complaint in refused:
            print(f"  not in real time: {complaint}", file=sys.stderr)
        yield


def _identify(plant: RemotePlant, path: Path, mass: float | None, policy: Literal["enforce", "ignore"]) -> int:
    mass = plant.calibration.mass if mass is None else mass
    # before takeoff: in flight the computing time would trip the watchdog
    shaker = excitation(plant.calibration, period=plant.period, delay=plant.delay)
    switch = StopSwitch()
    with switch.signals(), _punctual(policy), switch.flying(plant):
        plant.takeoff(watch=lambda: switch.landing)
        motion = collect(plant, shaker, _IDENTIFYING, then=plant.land, watch=lambda: switch.landing)
    # use the measured delay, which includes the link and this program
    with Progress("identify"):
        device = identify_device(motion.poses, motion.currents, period=plant.period, delay=motion.delay)
    device.calibration(plant.calibration, mass).save(path)
    x, y, z = device.gravity
    error = device.free_errors[:3].max()
    missing = int(np.isnan(motion.currents[:, 0]).sum())
    gravity = f"gravity {x:.4f}, {y:.4f}, {z:.4f} m/s², standard error {error:.4f}; mass {mass:g} kg (assumed)"
    timing = (
        f"delay {motion.delay * 1e3:.3f} ms; {missing} of {len(motion.poses)} samples lost, or answered late or early"
    )
    print("\n".join(wrapped(gravity) + wrapped(timing)))
    print(f"  wrote {path}")
    return 0
