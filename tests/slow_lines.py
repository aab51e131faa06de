"""Flights of a twin over a line of scheduled delay, with a scripted hand."""

from __future__ import annotations

import heapq
import itertools
import random
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from maglev_mj import find_scene
from maglev_mj.bridge import RemotePlant, Twin, TwinParameters
from maglev_mj.bridge.flight import Flight
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.control.controller import Controller
from maglev_mj.errors import MaglevError
from maglev_mj.frames import Array
from maglev_mj.scenes import Scene
from maglev_mj.session import device_controller
from maglev_mj.theory.verdict import delay_margins

_NEVER = 1 << 62
_STOP = 0.0044

PUSHES = {"drop": (2, -1), "press": (2, -1), "wall": (2, -1), "joystick": (0, -1), "box": (0, -1), "corner": (0, -1)}
"""Axis and sense in which a hand presses on a scene's wall; +x for the others."""

SHAPES: dict[str, Callable[[float, float, random.Random], float]] = {
    "step": lambda size, since, _: size * (since >= 0.0),
    "ramp": lambda size, since, _: size * min(max(since, 0.0), 1.0),
    "burst": lambda size, since, _: size * (0.0 <= since < 0.2),
    "jitter": lambda size, since, draw: size * draw.random() * (since >= 0.0),
}
"""Delay each way at a time since its begin [s]."""


class Line:
    """Line of a `VirtualLink` with a given delay each way at each time [s]."""

    to_host, to_device = "to host", "to device"

    def __init__(self, delay: Callable[[float], float]) -> None:
        self._delay, self._order = delay, itertools.count()
        self._frames: list[tuple[int, int, str, bytes]] = []

    def send(self, way: str, data: bytes, now: int) -> None:
        due = now + round(max(self._delay(now * 1e-9), 0.0) * 1e9)
        heapq.heappush(self._frames, (due, next(self._order), way, data))

    @property
    def due(self) -> int:
        return self._frames[0][0] if self._frames else _NEVER

    def arrived(self, now: int) -> Iterator[tuple[str, bytes]]:
        while self.due <= now:
            yield heapq.heappop(self._frames)[2:]


class ScriptedHand:
    """Hand that presses with a force [N], taps with 20 N, or is "none"."""

    def __init__(self, kind: str, scene: str, begin: float) -> None:
        self._kind, self._begin = kind, begin
        self._axis, self._sense = PUSHES.get(scene, (0, 1))

    def __call__(self, tick: int, time: float, state: Any) -> list[float]:
        wrench, since = [0.0] * 6, float(time) - self._begin
        if self._kind == "none" or since < 0.0:
            return wrench
        tapped = 20.0 * (since % 0.5 < 0.03)
        force = tapped if self._kind == "tap" else float(self._kind) * min(since / 0.1, 1.0)
        wrench[self._axis] = self._sense * force
        return wrench


class Flown(NamedTuple):
    """Outcome of a flight, by the twin's truth."""

    outcome: str
    """Why it ended: "landed", the reason of an early landing, or the fault."""
    rows: Array
    """Time [s], pose, twist, largest current [A], and state, at each sample, (N, 15)."""
    wrenches: Array
    """Time of each sample [s], and the hand's wrench by the host's estimate, (N, 7)."""

    def after(self, time: float) -> Array:
        return self.rows[self.rows[:, 0] >= time]

    def speeds(self, time: float) -> Array:
        """Return the speeds from a time on [m/s]."""
        return np.asarray(np.linalg.norm(self.after(time)[:, 7:10], axis=1))

    def at_stop(self, time: float) -> float:
        """Return the largest speed at a stop from a time on [m/s]."""
        touching = np.abs(self.after(time)[:, 1:4]).max(axis=1) > _STOP
        return float(self.speeds(time)[touching].max(initial=0.0))


def fly(
    name: str,
    *,
    rate: int = 200,
    hand: str = "none",
    delay: Callable[[float], float] = lambda time: 0.0,
    seconds: float = 2.0,
    seed: int = 0,
    scene: Scene | None = None,
    law: Callable[[Controller, float], Any] | None = None,
    bears: float | None = None,
    folder: Any = "",
    **twin_parameters: Any,
) -> Flown:
    """Fly a scene on a twin; the hand begins after 1.3 s."""
    twin = Twin(
        TwinParameters(period=1.0 / rate, seed=seed, **twin_parameters),
        hand_force=ScriptedHand(hand, name, 1.3),
        draw=lambda: 7,
    )
    link = VirtualLink(twin)
    link._line = Line(delay)  # type: ignore[assignment]
    rows: list[Array] = []
    wrenches: list[Array] = []
    take = twin.sample

    def sample() -> bytes | None:
        frame = take()
        pose, twist = twin.plant.state()
        current = float(np.abs(twin.plant.currents).max())
        rows.append(np.array([twin.tick / rate, *pose, *twist, current, twin.firmware.state]))
        return frame

    twin.sample = sample  # type: ignore[method-assign]
    plant = RemotePlant(link, folder=folder)
    scene = (scene or find_scene(name)()).replace(period=plant.period, delay=plant.delay)
    if bears is None:
        bears = delay_margins(device_controller(scene), ["none"], pose=scene.start().pose)["none"]
    flight = Flight(plant, scene, bears=bears)
    if law is not None:
        flight._controller = law(flight._controller, plant.period)
    read = plant.read

    def noted() -> Any:
        got = read()
        wrenches.append(np.array([got.time, *plant.hand_wrench]))
        return got

    plant.read = noted  # type: ignore[method-assign]
    try:
        landing = flight.run(seconds).landing
        outcome = landing.reason or "landed"
    except MaglevError as error:
        outcome = f"{type(error).__name__}: {error}"
    for _ in range(round(0.4 * rate)):  # it falls, or rests
        twin.sample()
    return Flown(outcome, np.array(rows), np.array(wrenches))
