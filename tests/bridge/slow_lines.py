"""Flights of a twin over a link with scripted delay and hand."""

from __future__ import annotations

import heapq
import itertools
import math
import random
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from maglev_mj import find_scene
from maglev_mj.bridge import RemotePlant, Twin, TwinParameters
from maglev_mj.bridge.flight import Flight
from maglev_mj.bridge.flight_guards import PowerGuard
from maglev_mj.bridge.landing import LandingReport
from maglev_mj.bridge.twin.simulated_links import VirtualLink
from maglev_mj.control.controller import Controller
from maglev_mj.errors import MaglevError
from maglev_mj.frames import Array, Command, Sample
from maglev_mj.scenes import Scene
from maglev_mj.session import device_controller
from maglev_mj.theory.verdict import judge

_NEVER = 1 << 62
_STOP = 0.0044

STOP_REACHED = 0.0042
"""Coordinate from which a stop acts on the flotor [m]."""

HAND_BEGINS = 1.3
"""Begin of a hand, soon after takeoff [s]."""

PUSHES = {"drop": (2, -1), "press": (2, -1), "wall": (2, -1), "joystick": (0, -1), "box": (0, -1), "corner": (0, -1)}
"""Axis and direction in which a hand presses on a scene's wall; +x for the others."""

SHAPES: dict[str, Callable[[float, float, random.Random], float]] = {
    "step": lambda size, since, _: size * (since >= 0.0),
    "ramp": lambda size, since, _: size * min(max(since, 0.0), 1.0),
    "burst": lambda size, since, _: size * (0.0 <= since < 0.2),
    "jitter": lambda size, since, draw: size * draw.random() * (since >= 0.0),
}
"""Delay each way at a time since its begin [s]."""


class Line:
    """`Line` of a `VirtualLink` with a scripted delay each way [s]."""

    to_host, to_device = "to host", "to device"

    def __init__(self, delay: Callable[[float], float]) -> None:
        self._delay, self._order = delay, itertools.count()
        self._frames: list[tuple[int, int, str, bytes]] = []
        self.delays: list[tuple[float, float]] = []  # time sent and delay of each frame [s]

    def send(self, way: str, data: bytes, now: int) -> None:
        """Send one frame one way at `now` [ns]."""
        delay = max(self._delay(now * 1e-9), 0.0)
        self.delays.append((now * 1e-9, delay))
        due = now + round(delay * 1e9)
        heapq.heappush(self._frames, (due, next(self._order), way, data))

    @property
    def due(self) -> int:
        """Instant of the next arrival [ns]."""
        return self._frames[0][0] if self._frames else _NEVER

    def arrived(self, now: int) -> Iterator[tuple[str, bytes]]:
        """Yield way and content of each frame that has arrived."""
        while self.due <= now:
            yield heapq.heappop(self._frames)[2:]


class ScriptedHand:
    """Hand that presses with a force [N] ("~": with a tremor), taps with 20 N, pushes with 15 N, or is "none"."""

    def __init__(self, kind: str, scene: str, begin: float) -> None:
        self._kind, self._begin = kind, begin
        self._axis, self._sense = PUSHES.get(scene, (0, 1))

    def wrench(self, time: float) -> list[float]:
        """Return its wrench at a time [N, N m], six."""
        wrench, since = [0.0] * 6, float(time) - self._begin
        if self._kind == "none" or since < 0.0:
            return wrench
        kind, tremor = self._kind.rstrip("~"), 0.1 * self._kind.endswith("~")
        pulses = {"tap": 20.0 * (since % 0.5 < 0.03), "push": 15.0 * max(math.sin(math.pi * since), 0.0)}
        force = pulses[kind] if kind in pulses else float(kind) * min(since / 0.1, 1.0)
        wrench[(self._axis + 1) % 3] = tremor * force * math.sin(14.0 * math.pi * since)
        wrench[self._axis] = self._sense * force * (1.0 + tremor * math.sin(18.0 * math.pi * since))
        return wrench

    def __call__(self, tick: int, time: float, state: Any) -> list[float]:
        """Return its wrench for the plant [N, N m], six."""
        return self.wrench(time)


class ChangedLaw:
    """Controller whose commands are changed from a time after takeoff.

    Args:
        controller: The controller.
        period: Sample period [s].
        change: Returns the force to add along an axis for the number of a sample and the laws' own force there [N].
        after: Time from takeoff to the change [s].
        axis: Number of that axis.
    """

    def __init__(
        self,
        controller: Controller,
        period: float,
        change: Callable[[int, float], float],
        after: float = 0.5,
        axis: int = 0,
    ) -> None:
        self._controller, self._period, self._change, self._ticks = controller, period, change, 0
        self._after, self._axis = after, axis

    def __getattr__(self, name: str) -> Any:
        return getattr(self._controller, name)

    def step(self, sample: Sample) -> Command:
        """Answer one sample."""
        command, self._ticks = self._controller.step(sample), self._ticks + 1
        if self._ticks * self._period < self._after:
            return command
        force, axis = list(command.force), self._axis
        force[axis] += self._change(self._ticks, force[axis] - float(self._controller.carried[axis]))
        return Command(force, command.extra, command.pulse_width)


class NotedPower(PowerGuard):
    """Guard that stores the maxima of its sums.

    Attributes:
        reversals: Largest reversals [N].
        small: Largest reversals of up to 10 N each [N].
        energy: Largest energy generated beyond the stored [J].
    """

    reversals = small = energy = 0.0

    def check(self, position: Any, force: Any) -> str:
        """Add one sample; return an error message, or ""."""
        message = super().check(position, force)
        self.energy = max(self.energy, -self._stored)
        self.reversals = max(self.reversals, max(self._reversals) / self._weight)
        self.small = max(self.small, max(self._small) / self._weight)
        return message


class Flown(NamedTuple):
    """Outcome of a flight, by the twin's truth."""

    outcome: str
    """Why it ended: "landed", the reason of an early landing, or the fault."""
    rows: Array
    """Time [s], pose, velocity, angular velocity in its axes, largest current [A], state, stop met since, (N, 16)."""
    wrenches: Array
    """Time of each sample [s], and the hand's wrench by the host's estimate, (N, 7)."""
    began: float
    """Time at which the scene was first rendered [s]."""
    ended: float
    """Time at which it began to land, or was cut [s]."""
    delays: list[tuple[float, float]]
    """Time sent and delay of each frame [s]."""
    critical_delay: float
    """Critical delay of the scene [s]."""
    reversals: float
    """Largest reversals of the laws' force, by the guard's sum [N]."""
    small: float
    """Largest reversals of up to 10 N each, by the guard's sum [N]."""
    energy: float
    """Largest energy generated by the laws beyond what they stored, by the guard's sum [J]."""

    def after(self, time: float) -> Array:
        """Return the rows from a time on."""
        return self.rows[self.rows[:, 0] >= time]

    def speeds(self, time: float) -> Array:
        """Return the speeds from a time on [m/s]."""
        return np.asarray(np.linalg.norm(self.after(time)[:, 7:10], axis=1))

    def at_stop(self, time: float) -> float:
        """Return the largest speed at a stop from a time on [m/s]."""
        touching = np.abs(self.after(time)[:, 1:4]).max(axis=1) > _STOP
        return float(self.speeds(time)[touching].max(initial=0.0))


@cache
def margin(name: str, rate: int, delay: float) -> float:
    """Return the critical delay of a scene of the package, without a hand [s]."""
    scene = find_scene(name)().replace(period=1.0 / rate, delay=delay)
    return judge(device_controller(scene), delay=0.0, pose=scene.start().pose).critical_delay


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
    critical_delay: float | None = None,
    prepare: Callable[[Twin, VirtualLink], object] | None = None,
    folder: Any = "",
    **twin_parameters: Any,
) -> Flown:
    """Fly a scene on a twin in simulated time.

    Args:
        name: Name of the scene, and of where the hand presses.
        rate: Samples a second.
        hand: See `ScriptedHand`; it begins after 1.3 s.
        delay: Delay of a frame sent at a time [s], each way.
        seconds: Time of the rendering [s].
        seed: Seed of the sensor's noise.
        scene: The scene; the package's of that name by default.
        law: Makes the flown controller from the scene's and the period.
        critical_delay: Critical delay of the scene [s]; by default by linearisation.
        prepare: Called with twin and link before the flight.
        folder: Folder of black box files.
        **twin_parameters: Of the twin.
    """
    twin = Twin(
        TwinParameters(period=1.0 / rate, seed=seed, **twin_parameters),
        hand_force=ScriptedHand(hand, name, HAND_BEGINS),
        draw=lambda: 7,
    )
    link = VirtualLink(twin)
    line = Line(delay)
    link._line = line  # type: ignore[assignment]
    if prepare is not None:
        prepare(twin, link)
    rows: list[list[float]] = []
    wrenches: list[list[float]] = []
    take = twin.sample
    simulated: Any = twin.plant  # in the engine

    def sample() -> bytes | None:
        frame = take()
        pose, twist = simulated._motion()  # state() in a fifth of the time, but the angular velocity in flotor axes
        current, met = max(map(abs, simulated.currents.tolist())), simulated.met_stops
        simulated._data.maxuse_efc = 0  # asked again from here on
        rows.append([twin.tick / rate, *pose, *twist, current, twin.firmware.state, met])
        return frame

    twin.sample = sample  # type: ignore[method-assign]
    plant = RemotePlant(link, folder=folder)
    if critical_delay is None:
        critical_delay = margin(name, rate, plant.delay)
    scene = (scene or find_scene(name)()).replace(period=plant.period, delay=plant.delay)
    flight = Flight(plant, scene, critical_delay=critical_delay)
    flight._power_guard = power = NotedPower(plant.period)
    if law is not None:
        flight._controller = law(flight._controller, plant.period)
    read = plant.read

    def noted() -> Any:
        got = read()
        wrenches.append([plant.samples.time * 1e-9, *plant.hand_wrench])  # the host counts from its first
        return got

    plant.read = noted  # type: ignore[method-assign]
    take_off, land = plant.takeoff, plant.land
    began, ended = [math.nan], [math.nan]

    def taken_off(*arguments: Any, **options: Any) -> None:
        take_off(*arguments, **options)
        began[0] = twin.tick / rate

    def landing_began(*arguments: Any, **options: Any) -> LandingReport:
        ended[0] = twin.tick / rate
        return land(*arguments, **options)

    plant.takeoff = taken_off  # type: ignore[method-assign]
    plant.land = landing_began  # type: ignore[method-assign]
    try:
        landing = flight.run(seconds).landing
        outcome = landing.reason or "landed"
    except (MaglevError, ArithmeticError) as error:
        outcome = f"{type(error).__name__}: {error}"
        ended[0] = twin.tick / rate if math.isnan(ended[0]) else ended[0]
    for _ in range(round(0.4 * rate)):  # falling, or at rest
        twin.sample()
    found = np.array(rows), np.array(wrenches)
    return Flown(
        outcome, *found, began[0], ended[0], line.delays, critical_delay, power.reversals, power.small, power.energy
    )


def rounded(value: float, digits: int = 4) -> float | None:
    """Return a rounded number, None for NaN."""
    return None if math.isnan(value) else round(float(value), digits)


def residual(flown: Flown, name: str, hand: str, rate: int) -> tuple[list[float], list[float]]:
    """Return errors of the hand's force and torque, rms and largest, away from the stops.

    The true wrench, held from sample to sample, is taken as the estimate is: weighted by a triangle of two periods,
    then through the same low pass.
    """
    period, keep = 1.0 / rate, math.exp(-2.0 * math.pi * 31.0 / rate)
    script = ScriptedHand(hand, name, HAND_BEGINS)
    low = lower = np.zeros(6)
    errors: list[Any] = []
    touched = flown.rows[flown.rows[:, 15] != 0.0, 0]  # by angles too: a turned ring meets its stop at 2.2 mm
    known = flown.wrenches[flown.wrenches[:, 0] < flown.ended]
    for time, *estimate in known[known[:, 0] > flown.began - 0.1]:
        tick = round(time * rate)  # as the twin counts its hand's time
        before, at = (np.array(script.wrench((tick - since) * period)) for since in (2, 1))
        true = 0.5 * (before + at)
        low = true + keep * (low - true)
        lower = low + keep * (lower - low)
        clear = not touched.size or not ((touched > time - 0.15) & (touched <= time)).any()
        if clear and math.isfinite(estimate[0]) and time > flown.began:
            errors.append(np.array(estimate) - lower)
    if not errors:
        return [], []
    found = np.array(errors)
    norms = np.linalg.norm(found[:, :3], axis=1), np.linalg.norm(found[:, 3:], axis=1)
    return (
        [rounded(math.sqrt(float((one**2).mean())), 6) or 0.0 for one in norms],
        [rounded(float(one.max()), 6) or 0.0 for one in norms],
    )
