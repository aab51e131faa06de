"""Flight of a scene on an arm: its laws without torques, preflight check, rendering, landing."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from maglev_mj.bridge.flight_guards import DelayGuard, PowerGuard, delay_limit
from maglev_mj.bridge.haply.plant import HaplyPlant
from maglev_mj.bridge.landing import StopSwitch
from maglev_mj.bridge.preflight import LinkReport, Preflight, assess
from maglev_mj.control import Law
from maglev_mj.control.laws.base import Answer, Face, Gains, as_law
from maglev_mj.control.loop import ControlLoop
from maglev_mj.frames import ZERO, Command, Component, DeviceWall, Sample, Six
from maglev_mj.plants.model import Body
from maglev_mj.recording import RecordingFile
from maglev_mj.scenes import Scene
from maglev_mj.session import begin_scene, device_controller

_EXCHANGES = 200
_FORCES = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])


class ForcesOnly(Law):
    """Forces of another law, without its torques and pulses; it sees no rotation.

    Args:
        law: The law.
    """

    def __init__(self, law: Law) -> None:
        self.law, self.on = law, law.on

    def start(self) -> Any:
        """See `Law`."""
        return self.law.start()

    def __call__(self, position: Six, velocity: Six, state: Any, wrench: list[Component]) -> Answer:
        """See `Law`."""
        own: list[Component] = [0.0] * 6
        state, _ = self.law([*position[:3], 0.0, 0.0, 0.0], [*velocity[:3], 0.0, 0.0, 0.0], state, own)
        wrench[:3] = [total + part for total, part in zip(wrench[:3], own)]
        return state, None

    def gains(self) -> Iterable[Gains] | None:
        """See `Law`."""
        gains = self.law.gains()
        return gains and [Gains(x.state, _FORCES * x.stiffness, _FORCES * x.damping) for x in gains]

    def faces(self) -> Sequence[Face]:
        """See `Law`."""
        return [face for face in self.law.faces() if face[0] < 3]

    def device_walls(self, state: Any) -> Sequence[DeviceWall]:
        """See `Law`."""
        return self.law.device_walls(state)

    def stick_positions(self, state: Any) -> Mapping[int, float]:
        """See `Law`."""
        return {axis: place for axis, place in self.law.stick_positions(state).items() if axis < 3}

    def signals(self, state: Any) -> Mapping[str, Sequence[Component]]:
        """See `Law`."""
        return self.law.signals(state)


def on_arm(scene: Scene, plant: HaplyPlant) -> Scene:
    """Return a scene for an arm: with its mass, timing and compensated gravity, and laws without torques and pulses."""
    arm, cls = plant.arm, type(scene)
    inertia = np.append([arm.mass] * 3, scene.body.inertia[3:])

    class OnArm(cls):  # type: ignore[misc, valid-type]
        name, title = scene.name, scene.title

        @property
        def body(self) -> Body:
            limits = np.append(arm.range, [np.inf] * 3)
            return Body(inertia, np.zeros(3), limits, arm.force_limit[2])

        def laws(self) -> list[Law]:
            return [ForcesOnly(as_law(law)) for law in super().laws()]

    values = {item.name: getattr(scene, item.name) for item in scene.parameters()}
    return OnArm(**values | {"period": plant.period, "delay": plant.delay})


def measure_arm(plant: HaplyPlant) -> LinkReport:
    """Measure the latency of 200 exchanges without force."""
    trips = []
    for _ in range(_EXCHANGES):
        plant.read()
        plant.write(Command(ZERO))
        trips.append(plant.round_trip)
    return LinkReport(
        device_delay=plant.delay,
        delay=plant.arm.delay + np.maximum(trips, plant.period),
        answer=np.zeros(0),
        samples=_EXCHANGES,
        lost=0,
        skipped=0,
        late=sum(trip > plant.period for trip in trips),
        clock=1.0,
        lockstep=False,
    )


def preflight_arm(plant: HaplyPlant, scene: Scene, *, as_written: bool = False) -> Preflight:
    """Measure the round trips, and check that a scene is stable on the arm; see `preflight`.

    Args:
        plant: The arm.
        scene: Scene to be rendered, of the published device; the result has that of the arm.
        as_written: True to leave the wall stiffness unchanged.

    Raises:
        MaglevError: If the arm has a fault, or a law fails.
    """
    report, own = measure_arm(plant), on_arm(scene, plant)
    result = assess(own, own.body.inertia, report, as_written)
    slowest = float(np.percentile(report.delay, 99.0)) - plant.arm.delay
    if slowest > plant.period and not result.problem:
        times = f"the slowest 1 % of the round trips take {slowest * 1e3:.2f} ms, above the period"
        result = result._replace(problem=f"{times} of {plant.period * 1e3:g} ms: keep a processor free or lower ?rate=")
    return result


class ArmReport(NamedTuple):
    """Outcome of a flight on an arm.

    Attributes:
        ticks: Number of rendered samples.
        skipped: Periods without a sample.
        wall_time: Duration in real time [s].
        reason: Reason of a guard to end it; "" without.
    """

    ticks: int
    skipped: int
    wall_time: float
    reason: str = ""

    def __str__(self) -> str:
        ended = f"; ended early: {self.reason}" if self.reason else ""
        return f"{self.wall_time:.1f} s, {self.ticks} samples, {self.skipped} skipped; force faded to zero{ended}"


def fly_arm(
    plant: HaplyPlant,
    scene: Scene,
    checked: Preflight,
    *,
    duration: float | None = None,
    switch: StopSwitch | None = None,
    file: RecordingFile | None = None,
) -> ArmReport:
    """Render a scene on an arm, then fade the force to zero and close the plant.

    Args:
        plant: The arm.
        scene: The scene before the check, for the recording.
        checked: Result of `preflight_arm`.
        duration: Duration [s]; None until the switch requests landing.
        switch: Switch that ends the flight.
        file: Recording of every sample; not closed.

    Raises:
        PlantError: If the arm or the link has a fault; the force is off.
    """
    switch, began, record = switch or StopSwitch(), time.monotonic(), None
    controller = device_controller(checked.scene, np.zeros(6))
    inertia = checked.scene.body.inertia.tolist()
    if file is not None:
        values = {"inertia": inertia, "load": ZERO, "before": ZERO, "hand_recorded": False}
        record = begin_scene(file, scene, plant, controller, kind="device", name=f"{scene.name} on an arm", **values)
    delays, power = DelayGuard(delay_limit(checked.critical_delay, plant.period)), PowerGuard(plant.period, inertia)
    reason, first, last, count = "", None, 0, 0

    def observe(sample: Sample, applied: Command) -> None:
        nonlocal reason, first, last
        first, last = sample.tick if first is None else first, sample.tick
        reason = delays.check(plant.age + plant.arm.delay) or power.check(sample.position, applied.force)

    loop = ControlLoop(plant, controller, observe=observe, record=record)
    while not (reason or switch.landing or (duration is not None and count * plant.period >= duration)):
        loop.cycle()
        count += 1
    plant.land()
    return ArmReport(count, last - (first or 0) + 1 - count, time.monotonic() - began, reason)
