"""`maglev-mj twin`: a simulated device behind a real device's protocol."""

from __future__ import annotations

import argparse
import math
import re
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from maglev_mj.bridge.bench.calibration import Calibration
from maglev_mj.bridge.links import Server, UdpServer, parse_url
from maglev_mj.bridge.realtime import realtime, stopping
from maglev_mj.bridge.safety import Limits
from maglev_mj.bridge.twin.fault_injection import INJECTED_FAULTS, InjectedFault
from maglev_mj.bridge.twin.twin import Twin, TwinParameters, TwinServer
from maglev_mj.bridge.wire import Fault, State, fault_names
from maglev_mj.cli.arguments import Parser
from maglev_mj.cli.options import add_bridge, beside_inverse, chosen_key, count, number_option
from maglev_mj.cli.publishers import add_foxglove, chosen_foxglove
from maglev_mj.cli.web import add_web, chosen_front
from maglev_mj.control.controller import Controller
from maglev_mj.errors import ParameterError
from maglev_mj.frames import AXES, ZERO, Command, Sample
from maglev_mj.interop.foxglove import LiveServer
from maglev_mj.parameters import number
from maglev_mj.plants import engine_warnings_silenced
from maglev_mj.plants.hand import HandForce, SpringHand
from maglev_mj.recording import setup_of
from maglev_mj.scenes import find_scene
from maglev_mj.scenes.rooms import WEIGHT
from maglev_mj.session import EMERGENCY_STOP, Publishers, SampledMotion, Snapshot
from maglev_mj.session.access import check_host
from maglev_mj.spec import INERTIA, Spec
from maglev_mj.views.remote import RemoteViewer

_LISTEN = "udp://127.0.0.1:5678"


def add_options(parser: Parser) -> None:
    """Add the options of the command."""
    device, hand = parser.group("device"), parser.group("faults and hands")
    device.add_argument(
        "--listen", default=_LISTEN, metavar="ADDRESS", help=f"udp://HOST:PORT, or pty (default {_LISTEN})"
    )
    numbers = {
        "rate": ("sample rate [Hz]", Spec.control_rate.value),
        "delay": ("from a command's arrival to its taking effect [s]", Spec.transport_delay.value),
        "watchdog": ("how long it waits for a command [s]", Limits.watchdog),
        "noise": ("standard deviation of a spot's noise [m]", TwinParameters.noise),
    }
    for name, (text, default) in numbers.items():
        into = beside_inverse(device, "--period", "rate") if name == "rate" else device
        into.add_argument(
            f"--{name}", type=number_option, default=default, metavar="X", help=f"{text} (default {default:g})"
        )
    device.add_argument("--seed", type=count, default=0, metavar="N", help="of the noise (default 0)")
    device.add_argument("--lockstep", action="store_true", help="wait for each answer instead of keeping real time")
    faults = "; ".join(f"{name}:K, {effect.words}" for name, effect in INJECTED_FAULTS.items())
    hand.add_argument(
        "--fault", action="append", default=[], metavar="NAME:K@SECONDS", help=f"what goes wrong, and when: {faults}"
    )
    hand.add_argument(
        "--push",
        action="append",
        default=[],
        metavar="AXIS:NEWTONS@START-END",
        help="a hand that pushes along x, y, z (N) or about rx, ry, rz (N m) from START to END [s], such as z:-5@2-3",
    )
    hand.add_argument(
        "--block", type=number_option, metavar="X", help="foam around the centre, so stiff [N/m], as for `commission`"
    )
    device.add_argument("--truth", metavar="FILE", type=Path, help="what the device is, where a host knows it wrongly")
    add_bridge(parser)
    window = parser.group("window")
    window.add_argument("--view", action="store_true", help="a window, with the mouse as the hand")
    window.add_argument(
        "--scene", default="joystick", metavar="SCENE", help="what the window or page looks like (default joystick)"
    )
    add_web(parser)
    add_foxglove(parser)
    parser.set_defaults(run=_twin)


def _twin(options: argparse.Namespace) -> int:
    key = chosen_key(options.key)
    look = find_scene(options.scene or "joystick")
    seconds = None if options.seconds is None else number("seconds", options.seconds, above=0.0)
    calibration = Calibration.nominal() if options.calibration is None else Calibration.load(options.calibration)
    parameters = TwinParameters(
        period=1.0 / number("rate", options.rate, at_least=10.0, at_most=20_000.0),
        delay=options.delay,
        lockstep=options.lockstep,
        calibration=calibration,
        truth=None if options.truth is None else Calibration.load(options.truth),
        noise=options.noise,
        seed=options.seed,
        limits=Limits(watchdog=options.watchdog),
        faults=[InjectedFault.parse(text) for text in options.fault],
    )
    block = None if options.block is None else foam(number("block", options.block, above=0.0, at_most=20_000.0))
    _hand(options.push, None)  # a push that is none is said before a window opens
    with ExitStack() as last:
        viewer, front = None, chosen_front(options)
        if front is not None:
            # the rendered scene is the host's choice
            off = {one.name: False for one in look.parameters() if one.kind is bool and one.live}
            blank = Snapshot(
                scene=look(**off, period=parameters.period, delay=parameters.delay), actions=(EMERGENCY_STOP,)
            )
            viewer = RemoteViewer(blank, front)
            last.callback(viewer.close)
        if (live := chosen_foxglove(options)) is not None:
            last.callback(live.close)
        twin = Twin(parameters, key=key, hand_force=_hand(options.push, block if viewer is None else viewer.hand))
        server = TwinServer(twin, _server(options.listen, key))
        last.callback(server.close)
        print(_greeting(options, server), flush=True)
        shown = [] if viewer is None else [_shown(viewer, blank, server)]
        shown += [] if live is None else [_logged(live, twin)]
        last.enter_context(engine_warnings_silenced())
        for complaint in last.enter_context(realtime(options.realtime)):
            print(f"  not in real time: {complaint}", flush=True)
        with stopping(server.stop):
            served = server.run(seconds, (lambda: [show() for show in shown]) if shown else None)
    print(served)
    return 0


def foam(stiffness: float) -> SpringHand:
    """Return an elastic support of the flotor at the centre.

    Its translations are critically damped.
    """
    mass, lever = INERTIA[0], 0.02  # [m]
    damping = 2.0 * math.sqrt(stiffness * mass)
    return SpringHand(
        stiffness=stiffness,
        damping=0.5 * damping,
        turning_stiffness=stiffness * lever**2,
        turning_damping=0.5 * damping * lever**2,
        force_limit=100.0,
        torque_limit=2.0,
        target=ZERO,
    )


def _hand(pushes: Sequence[str], mouse: HandForce | None) -> HandForce | None:
    """Return a hand with timed pushes beside the mouse's hand."""
    parts: list[tuple[int, float, float, float]] = []
    for text in pushes:
        found = re.fullmatch(r"(r?[xyz]):([+-]?\d+\.?\d*)@(\d+\.?\d*)-(\d+\.?\d*)", text)
        if not found or float(found[3]) >= float(found[4]):
            axes = ", ".join(AXES)
            raise ParameterError(
                f"push must be AXIS:NEWTONS@START-END with an axis of {axes} and START before END, not {text!r}"
            )
        parts.append((AXES.index(found[1]), float(found[2]), float(found[3]), float(found[4])))

    def pushing(tick: int, time: Any, state: Any) -> Sequence[Any]:
        wrench = [0.0] * 6 if mouse is None else list(mouse(tick, time, state))
        for axis, force, start, end in parts:
            wrench[axis] += force * (start <= time < end)
        return wrench

    return pushing if parts else mouse


def _server(listen: str, key: bytes | None) -> Server:
    if listen == "pty":
        from maglev_mj.bridge.links import PtyServer

        return PtyServer()
    if not listen.startswith("udp:"):
        raise ParameterError(f"listen must be udp://HOST:PORT or pty, not {listen!r}")
    url = parse_url(listen, server=True)
    return UdpServer(check_host(url.place, key), url.number)


def _greeting(options: argparse.Namespace, server: TwinServer) -> str:
    place, number = server.address
    address = f"serial://{place}" if options.listen == "pty" else f"udp://{place}:{number}"
    pace = "in lockstep" if options.lockstep else "in real time"
    return f"  a twin at {address}, {options.rate:g} Hz, {pace}; Ctrl-C ends it"


def _shown(viewer: RemoteViewer, blank: Snapshot, server: TwinServer) -> Callable[[], None]:
    """Return a function that shows a twin's sample.

    It is shown in the window; closing that stops the twin.
    """
    twin, plant = server.twin, server.twin.plant
    coils, carried = plant.device.coils, np.array(WEIGHT)
    assert coils is not None  # it is driven through them
    motion, publishers = SampledMotion(), Publishers([viewer])
    viewer.on_close, viewer.on_emergency = server.stop, twin.estop

    def each() -> None:
        currents, pose, time = plant.currents, twin.pose, twin.tick * blank.scene.period
        force = coils.wrench(currents) - carried if currents.any() else np.zeros(6)
        motion.add(time, pose, force, plant.hand_wrench)
        publishers.show(
            lambda: replace(
                blank,
                tick=twin.tick,
                time=time,
                pose=pose,
                force=force,
                hand=np.array(plant.hand_wrench),
                stops=plant.stop_wrench,
                currents=currents,
                history=motion.history.rows,
                work=motion.work,
                state="stopped" if twin.firmware.state == State.FAULT else "running",
                reason=fault_names(twin.firmware.faults) if twin.firmware.faults else "",
                remedy="maglev-mj bridge ADDRESS --reset goes on",
                notes=[f"a device, {twin.firmware.state.name.lower()}{_faults(twin)}"],
            )
        )
        publishers.wanted()  # the mouse; the settings are the host's

    return each


def _logged(live: LiveServer, twin: Twin) -> Callable[[], None]:
    """Return a function that logs a twin's sample.

    True pose, wrench of the currents, faults.
    """
    plant, period, coils = twin.plant, twin.parameters.period, twin.plant.device.coils
    assert coils is not None  # it is driven through them
    controller, told = Controller([], period=period), Fault(0)
    record = live.begin(plant, controller, setup_of(plant, controller, name="twin"))

    def each() -> None:
        nonlocal told
        sample = Sample(twin.tick, twin.tick * period, twin.pose.tolist())
        wrench = Command(coils.wrench(plant.currents).tolist())
        record(sample, wrench, wrench)
        if (faults := twin.firmware.faults) and faults != told:
            live.event("fault", fault_names(faults))
        told = faults

    return each


def _faults(twin: Twin) -> str:
    return f", {fault_names(twin.firmware.faults)}" if twin.firmware.faults else ""
