"""Command `twin`: a simulated device behind the device protocol."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from maglev_mj.bridge.twin.fault_injection import INJECTED_FAULTS
from maglev_mj.cli.declare import option
from maglev_mj.cli.options import AnyDevice, Key, Realtime, Seconds
from maglev_mj.cli.peripherals import PageOptions
from maglev_mj.errors import ParameterError

if TYPE_CHECKING:
    from maglev_mj.bridge.links import Server
    from maglev_mj.bridge.twin.twin import TwinParameters, TwinServer
    from maglev_mj.plants.hand import HandForce, SpringHand
    from maglev_mj.scenes import Scene
    from maglev_mj.session import Snapshot
    from maglev_mj.views.viewer_process import RemoteViewer

_DEVICE, _HANDS = "device", "faults and hand"
_ADDRESS = "udp://127.0.0.1:5678"


_WATCHDOG = 0.05
_FAULTS = {f"{name}:K": effect.words for name, effect in INJECTED_FAULTS.items()}


def twin(
    *,
    listen: Annotated[str, option("udp://HOST:PORT or pty (serial)", _DEVICE, "ADDRESS")] = _ADDRESS,
    haply: Annotated[
        str | None,
        option(
            "arm behind the JSON of Haply's Inverse service, instead of a device", _DEVICE, "[HOST:]PORT", const="10001"
        ),
    ] = None,
    rate: Annotated[
        float | None,
        option(
            "sample rate [Hz] (default: the device's; arm 1000)",
            _DEVICE,
            inverse="period",
            at_least=10.0,
            at_most=20_000.0,
        ),
    ] = None,
    delay: Annotated[
        float | None,
        option(
            "delay from a command's arrival to its effect [s] (default: the device's; arm 0.001)",
            _DEVICE,
            at_least=0.0,
        ),
    ] = None,
    watchdog: Annotated[float, option("watchdog timeout [s]", _DEVICE)] = _WATCHDOG,
    noise: Annotated[
        float | None, option("standard deviation of the spot noise [m] (default: 4e-7, or the device's)", _DEVICE)
    ] = None,
    seed: Annotated[int, option("seed of the noise", _DEVICE)] = 0,
    lockstep: Annotated[bool, option("wait for each command instead of running in real time", _DEVICE)] = False,
    plant: Annotated[str, option("mujoco or exact; exact runs without MuJoCo", _DEVICE, "NAME")] = "mujoco",
    fault: Annotated[
        list[str], option("injected fault and its start; repeatable", _HANDS, "NAME:K@SECONDS", meanings=_FAULTS)
    ],
    push: Annotated[
        list[str],
        option(
            "hand force along x, y, z [N] or torque about rx, ry, rz [N m], from START to END on the "
            "device's clock, which starts with the twin [s], such as z:-5@2-3",
            _HANDS,
            "AXIS:NEWTONS@START-END",
        ),
    ],
    block: Annotated[
        float | None,
        option("stiffness of foam around the flotor, for `commission` [N/m]", _HANDS, above=0.0, at_most=20_000.0),
    ] = None,
    truth: Annotated[Path | None, option("file of the true device, if the host's is wrong", _DEVICE)] = None,
    device: AnyDevice,
    key: Key = None,
    seconds: Seconds = None,
    realtime: Realtime = "ignore",
    view: Annotated[bool, option("3D window; the mouse is the hand", "window")] = False,
    scene: Annotated[str, option("appearance of the window or page", "window", "SCENE")] = "joystick",
    page: PageOptions,
) -> int:
    """Run the twin: a simulated device behind the protocol of a real one."""
    from maglev_mj.bridge.commissioning.calibration import Calibration
    from maglev_mj.bridge.haply.plant import Arm
    from maglev_mj.bridge.realtime import realtime as realtime_policy
    from maglev_mj.bridge.realtime import stopping
    from maglev_mj.bridge.safety import limits_of
    from maglev_mj.bridge.twin.fault_injection import InjectedFault
    from maglev_mj.bridge.twin.twin import Twin, TwinParameters, TwinServer
    from maglev_mj.plants import engine_warnings_silenced
    from maglev_mj.scenes import find_scene
    from maglev_mj.views.viewer_process import RemoteViewer

    if haply is not None:
        refused = {
            "listen": listen != _ADDRESS,
            "fault": fault,
            "block": block,
            "truth": truth,
            "view": view,
            "web": page.web,
            "plant": plant != "mujoco",
            "noise": noise is not None,
            "seed": seed,
            "watchdog": watchdog != _WATCHDOG,
        }
        if extra := [name for name, value in refused.items() if value]:
            raise ParameterError(f"--{extra[0]} does not apply to --haply")
        numbers: dict[str, Any] = {
            name: value for name, value in (("rate", rate), ("delay", delay)) if value is not None
        }
        arm = {"arm": replace(Arm.of(device), **numbers), "lockstep": lockstep, "hand_force": _hand(push, None)}
        return _serve_arm(haply, seconds, arm, realtime, {"key": key, "origins": page.allow_origin})
    look, calibration = find_scene(scene or "joystick"), Calibration.of(device)
    own = {"period": rate and 1.0 / rate, "delay": delay, "noise": noise}
    parameters = TwinParameters(
        **{name: value for name, value in own.items() if value is not None},
        lockstep=lockstep,
        calibration=calibration,
        truth=None if truth is None else Calibration.load(truth),
        seed=seed,
        limits=limits_of(calibration.device).replace(watchdog=watchdog),
        faults=[InjectedFault.parse(text) for text in fault],
        plant=plant,
    )
    support = None if block is None else foam(block, calibration.mass)
    _hand(push, None)  # report invalid pushes before a window opens
    with ExitStack() as last:
        viewer, blank = None, _blank(look, parameters)
        if (front := page.front(view)) is not None:
            viewer = RemoteViewer(blank, front)
            last.callback(viewer.close)
        twin = Twin(parameters, key=key, hand_force=_hand(push, support if viewer is None else viewer.hand))
        server = TwinServer(twin, _server(listen, key))
        last.callback(server.close)
        print(_greeting(listen, server), flush=True)
        shown = None if viewer is None else _shown(viewer, blank, server, listen)
        last.enter_context(engine_warnings_silenced())
        for complaint in last.enter_context(realtime_policy(realtime)):
            print(f"  not in real time: {complaint}", flush=True)
        with stopping(server.stop):
            served = server.run(seconds, shown)
    print(served)
    return 0


def _serve_arm(
    place: str,
    seconds: float | None,
    arm: dict[str, Any],
    policy: Literal["enforce", "ignore"],
    server_options: dict[str, Any],
) -> int:
    """Serve the twin of an arm at [HOST:]PORT; return the exit status."""
    from maglev_mj.bridge.haply.twin import HaplyServer, HaplyTwin
    from maglev_mj.bridge.realtime import realtime, stopping

    if not (match := re.fullmatch(r"(?:([\w.-]+):)?(\d{1,5})", place, re.ASCII)):
        raise ParameterError(f"haply must be PORT or HOST:PORT (got {place!r})")
    twin = HaplyTwin(**arm)
    with realtime(policy) as refused:  # the threads of the server inherit it
        server = HaplyServer(twin, int(match[2]), match[1] or "127.0.0.1", **server_options)
        host, port = server.address
        pace = "in lockstep" if twin.lockstep else "in real time"
        print(f"  arm at ws://{host}:{port}/{server.query}, {twin.arm.rate:g} Hz, {pace}; Ctrl-C ends it", flush=True)
        for complaint in refused:
            print(f"  not in real time: {complaint}", flush=True)
        with stopping(server.stop):
            server.run(seconds)
        server.close()
    print(f"  {twin.clipped} forces above the limit")
    return 0


def _blank(look: type[Scene], parameters: TwinParameters) -> Snapshot:
    """Return a view of a twin before its first sample."""
    from maglev_mj.bridge.wire import State
    from maglev_mj.session import EMERGENCY_STOP, Snapshot

    # the host chooses what is rendered
    off: dict[str, Any] = {row.name: False for row in look.parameters() if row.kind is bool and row.live}
    device = parameters.calibration.base.reference
    scene = look(**off, device=device, period=parameters.period, delay=parameters.delay)
    return Snapshot(scene=scene, actions=(EMERGENCY_STOP,), idle=_IDLE[State.INACTIVE])


def foam(stiffness: float, mass: float) -> SpringHand:
    """Return an elastic support of the flotor at the centre, critically damped in translation."""
    from maglev_mj.frames import ZERO
    from maglev_mj.plants.hand import SpringHand

    lever = 0.02  # [m]
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
    """Return a hand with timed pushes, added to the mouse's hand."""
    from maglev_mj.frames import AXES

    parts: list[tuple[int, float, float, float]] = []
    for text in pushes:
        match = re.fullmatch(r"(r?[xyz]):([+-]?\d+\.?\d*)@(\d+\.?\d*)-(\d+\.?\d*)", text)
        if not match or float(match[3]) >= float(match[4]):
            axes = ", ".join(AXES)
            raise ParameterError(
                f"push must be AXIS:NEWTONS@START-END with AXIS one of {axes} and START before END (got {text!r})"
            )
        parts.append((AXES.index(match[1]), float(match[2]), float(match[3]), float(match[4])))

    def push(tick: int, time: Any, state: Any) -> Sequence[Any]:
        wrench = [0.0] * 6 if mouse is None else list(mouse(tick, time, state))
        for axis, force, start, end in parts:
            wrench[axis] += force * (start <= time < end)
        return wrench

    return push if parts else mouse


def _server(listen: str, key: bytes | None) -> Server:
    from maglev_mj.bridge.links import PtyServer, UdpServer, parse_url
    from maglev_mj.session.access import check_host

    if listen == "pty":
        return PtyServer()
    if not listen.startswith("udp:"):
        raise ParameterError(f"listen must be udp://HOST:PORT or pty (got {listen!r})")
    url = parse_url(listen, server=True)
    return UdpServer(check_host(url.host, key), url.number)


def _greeting(listen: str, server: TwinServer) -> str:
    (host, port), parameters = server.address, server.twin.parameters
    address = f"serial://{host}" if listen == "pty" else f"udp://{host}:{port}"
    pace = "in lockstep" if parameters.lockstep else "in real time"
    return f"  twin listening at {address}, {1.0 / parameters.period:g} Hz, {pace}; Ctrl-C ends it"


_IDLE = "inactive: nothing is rendered", "active: the host renders", "fault: nothing is rendered"
"""Words for what is rendered, by state of the device; the twin does not know the host's laws."""


def _shown(viewer: RemoteViewer, blank: Snapshot, server: TwinServer, address: str) -> Callable[[], None]:
    """Return a function that publishes a twin's sample to the window; closing it stops the twin."""
    import numpy as np

    from maglev_mj.bridge.wire import State, fault_names
    from maglev_mj.session import DeviceStatus, Publishers, SampledMotion

    twin, plant = server.twin, server.twin.plant
    coils, load = twin.truth.coils, twin.truth.body.load
    motion, publishers = SampledMotion(), Publishers([viewer])
    viewer.on_close, viewer.on_emergency = server.stop, twin.estop

    def publish() -> None:
        currents, pose, time = plant.currents, twin.pose, twin.tick * blank.scene.period
        faults = fault_names(twin.firmware.faults) if twin.firmware.faults else ""
        force = coils.wrench(currents) + load if currents.any() else np.zeros(6)
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
                idle=_IDLE[twin.firmware.state],
                device=DeviceStatus(address, twin.firmware.state.name.lower(), simulated=True),
                hand_limit=viewer.hand.force_limit,
                reason=faults,
                remedy="clear it with: maglev-mj bridge ADDRESS --reset",
            )
        )
        publishers.wanted()  # read the mouse; settings belong to the host

    return publish
