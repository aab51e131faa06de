"""Flight of a scene on an arm: its laws without torques, preflight check, rendering, landing."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from maglev_mj.bridge.flight_guards import DelayGuard, PowerGuard, delay_limit
from maglev_mj.bridge.haply.plant import HaplyPlant
from maglev_mj.bridge.landing import StopSwitch
from maglev_mj.bridge.preflight import LinkReport, Preflight, assess
from maglev_mj.control import Law
from maglev_mj.control.laws.base import Answer, Face, Gains, as_law
from maglev_mj.control.loop import ControlLoop
from maglev_mj.errors import PlantError
from maglev_mj.frames import ZERO, Command, Component, Sample, Six
from maglev_mj.plants.model import Flotor
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
        self.law, self.on, self.start, self.signals = law, law.on, law.start, law.signals  # type: ignore[method-assign]

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


def on_arm(scene: Scene, plant: HaplyPlant) -> Scene:
    """Return a scene with the mass and timing of an arm, and laws without weight, torques and pulses."""
    cls, inertia = type(scene), np.append([plant.arm.mass] * 3, scene.body.inertia[3:])

    class OnArm(cls):  # type: ignore[misc, valid-type]
        name, title = scene.name, scene.title
        body = Flotor(inertia, np.zeros(3), np.append(plant.arm.range, [np.inf] * 3), plant.arm.force_limit[2])

        def laws(self) -> list[Law]:
            return [ForcesOnly(law) for law in map(as_law, super().laws()) if not law.carried().any()]

    return OnArm(**scene.as_json() | {"period": plant.period, "delay": plant.delay})


def preflight_arm(plant: HaplyPlant, scene: Scene, *, as_written: bool = False) -> Preflight:
    """Measure 200 round trips without force, and check that a scene is stable on the arm; see `preflight`.

    Args:
        plant: The arm.
        scene: Scene to be rendered, of the published device; the result has that of the arm.
        as_written: True to leave the wall stiffness unchanged.

    Raises:
        PlantError: If the arm has a fault, or 1 % of the round trips take longer than a period.
        MaglevError: If a law fails.
    """
    own, trips, ages = on_arm(scene, plant), list[float](), list[float]()
    for _ in range(_EXCHANGES):
        plant.read()
        plant.write(Command(ZERO))
        trips.append(plant.round_trip)
        ages.append(plant.age)
    if (slowest := float(np.percentile(trips, 99.0))) > plant.period:
        times = f"the slowest 1 % of the round trips take {slowest * 1e3:.2f} ms, above the period"
        raise PlantError(f"no flight: {times} of {plant.period * 1e3:g} ms; keep a processor free or lower ?rate=")
    delay, late = plant.arm.delay + np.array(ages), int(np.sum(np.array(trips) > plant.period))
    report = LinkReport(device_delay=plant.delay, delay=delay, answer=np.zeros(0), samples=_EXCHANGES, late=late)
    return assess(own, own.body.inertia, report, as_written)


def fly_arm(
    plant: HaplyPlant,
    scene: Scene,
    checked: Preflight,
    *,
    duration: float | None = None,
    switch: StopSwitch | None = None,
    file: RecordingFile | None = None,
) -> tuple[int, str]:
    """Render a scene on an arm, then fade the force to zero and close the plant.

    The present position counts as the scene's start, or as the centre if the start is inside a wall.

    Args:
        plant: The arm.
        scene: The scene before the check, for the recording.
        checked: Result of `preflight_arm`.
        duration: Duration [s]; None until the switch requests landing.
        switch: Switch that ends the flight.
        file: Recording of every sample; not closed.

    Returns:
        Number of samples, and the reason of a guard to end the flight, or "".

    Raises:
        PlantError: If the arm or the link has a fault; the force is off.
    """
    controller, inertia = device_controller(checked.scene, np.zeros(6)), checked.scene.body.inertia.tolist()
    record, switch, reason, count = None, switch or StopSwitch(), "", 0
    if file is not None:
        values: Any = {"inertia": inertia, "load": ZERO, "before": ZERO, "hand_recorded": False}
        record = begin_scene(file, scene, plant, controller, kind="device", name=f"{scene.name} on an arm", **values)
    limit = delay_limit(checked.critical_delay, plant.period, own=plant.delay)
    delays, power = DelayGuard(limit), PowerGuard(plant.period, inertia)

    def observe(sample: Sample, applied: Command) -> None:
        nonlocal reason
        reason = delays.check(plant.age + plant.arm.delay) or power.check(sample.position, applied.force)

    start = checked.scene.start().pose
    inside = any(normal * (start[axis] - edge) < 0.0 for axis, normal, edge in controller.faces)
    plant.recentre((0.0, 0.0, 0.0) if inside else start[:3])  # a hand may have moved the tip since the check
    loop = ControlLoop(plant, controller, observe=observe, record=record)
    while not (reason or switch.landing or (duration is not None and count * plant.period >= duration)):
        loop.cycle()
        count += 1
    plant.land()
    return count, reason
