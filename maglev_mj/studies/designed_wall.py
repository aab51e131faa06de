"""Simulation of a designed wall in its required cases.

Figures: stability, penetration, peak force, and force noise at rest.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from maglev_mj.control import Law, VelocityEstimator
from maglev_mj.control.controller import Controller
from maglev_mj.control.loop import drive
from maglev_mj.control.stack import alike
from maglev_mj.control.timeline import split_delay
from maglev_mj.frames import Array, Command, Mask, Sample
from maglev_mj.parameters import Parameters, numbers, param
from maglev_mj.plants import ExactPlant, Timing
from maglev_mj.plants.hand import Hand, get_hand
from maglev_mj.plants.limits import LIMITS, excess_of
from maglev_mj.plants.model import body_of
from maglev_mj.result import Result, Table, conditions_text, span_text
from maglev_mj.scenes.figures import summarise_bounce
from maglev_mj.scenes.wall_scene import WallScene, along, wall_controller, wall_plant
from maglev_mj.spec import DEVICE_DELAY, DEVICE_PERIOD, GRAVITY, MAX_DELAY_PERIODS, Spec
from maglev_mj.studies.cells import grid_columns
from maglev_mj.theory.boundary import rigid_note
from maglev_mj.theory.design import DesignedWall, WallRequirements
from maglev_mj.theory.loop import Loop
from maglev_mj.theory.loop_parameters import PLAIN

_TICKS, _CONTACT_TICKS = 800, 100
_RANDOM, _PHASES = 240, 8
_MOST_LISTED = 8
_GATE_STEPS, _SETTLED_STEPS = 5.0, 20.0


class ContactParameters(Parameters):
    """Contact conditions of a designed wall.

    Raises:
        ParameterError: If a value is outside its bounds.
    """

    pulse: bool = param("braking pulse on entering the wall, sized to stop the lightest flotor", default=False)
    pulse_width: float = param("pulse duration", "s", default=0.003, above=0.0, at_most=1.0)
    quantize: float = WallScene.like("quantize", default=Spec.translation_resolution.value)
    force_limit: float = WallScene.like("force_limit", default=Spec.largest_vertical_force.value, derive=None)
    speed: float = param("approach speed", "m/s", default=0.2, above=0.0, at_most=10.0)

    def pulse_of(self, wall: DesignedWall) -> float:
        """Return the pulse damping [N s/m] for the lightest flotor.

        It stops the lightest flotor within the pulse, and no heavier one earlier.
        """
        if not self.pulse:
            return 0.0
        return max(wall.requirements.bodies[0] / self.pulse_width - wall.damping, 0.0)

    def gate(self, period: float) -> float:
        """Return the least approach speed for a pulse [m/s].

        It is five steps of the sensor per period.
        """
        return _GATE_STEPS * self.quantize / period


@dataclass(frozen=True, eq=False)
class DesignResult(Result):
    """Designed wall with its simulated figures.

    Attributes:
        wall: Its gains, and its figures by theory.
        contact: Contact conditions.
        cases: Loops simulated, in and out of contact: corners and middles of the ranges, the worst, random ones. None,
            and no simulated figure, on a rotary axis, with own damping, a mode, a device law or more than ten periods
            of delay: the plants have none of them.
        grows: True for each case that does not settle, (C,).
        depth: Maximum penetration at the approach speed over corners, hands and phases [m].
        peak: Largest force there [N].
        hum: Force noise at rest over the sensor, standard deviation [N]: middle of the ranges, first hand, worst start.
        masses: Masses [kg], or moments of inertia [kg m²], of the map, (M,).
        delays: Delays of the map [s], (D,).
        map: Spectral radius over the hands, (M, D).
    """

    wall: DesignedWall
    contact: ContactParameters
    cases: Sequence[Loop]
    grows: Mask
    depth: float
    peak: float
    hum: float
    masses: Array
    delays: Array
    map: Array
    derived: ClassVar = ("pulse", "gate")
    pictures: ClassVar = {"design": "maglev_mj.studies.pictures:design_map"}

    @property
    def body_name(self) -> str:
        """Name of the masses: mass, or inertia of a rotary axis."""
        return "inertia" if self.wall.requirements.rotary else "mass"

    @property
    def units(self) -> Mapping[str, str]:
        """See `Result`."""
        return {self.body_name: self.wall.requirements.unit("kg"), "delay": "s"}

    def _headline(self) -> str:
        wall = self.wall
        unit, digits = wall.requirements.unit, (".4g", ".4g") if wall.requirements.rotary else (".0f", ".1f")
        stiffness, damping = (f"{gain:{digit}}" for gain, digit in zip((wall.stiffness, wall.damping), digits))
        gains = f"{stiffness} {unit('N/m')} and {damping} {unit('N s/m')}"
        return f"PD wall of {gains}: spectral radius {wall.spectral_radius:.3g} in the worst case"

    @property
    def conditions(self) -> str:
        """See `Result`."""
        needs = self.wall.requirements
        body = f"{self.body_name} {span_text(needs.bodies)} {needs.unit('kg')}"
        hands = f"hand {', '.join(needs.hands)}{needs.described}"
        return conditions_text("PD wall", [needs.axis], [needs.period], needs.delay, body, hands)

    def columns(self) -> dict[str, Array]:
        """Return mass, delay and spectral radius of each cell."""
        cells = grid_columns({self.body_name: self.masses, "delay": self.delays})
        return cells | {"spectral_radius": self.map.ravel()}

    @property
    def warnings(self) -> Sequence[str]:
        """See `Result`."""
        grows, body = int(self.grows.sum()), body_of(self.wall.requirements.hardware.keywords)
        excess = excess_of(np.array([self.peak, 0.0, 0.0, self.depth, 0.0, 0.0, 0.0]), body)
        unstable = [f"unstable in simulation: {grows} of {len(self.cases)} cases do not settle"] * (grows > 0)
        return [*unstable, *(limit.warning(excess, body) for limit in LIMITS if excess[limit.part].any())]

    def table(self) -> Table:
        """Return gains, margins, contact and simulated check of the wall."""
        wall, contact, needs = self.wall, self.contact, self.wall.requirements
        force, damping, softest = needs.unit("N/m"), needs.unit("N s/m"), needs.describe(wall.softest)
        outside = self.depth > needs.hardware.reach[2]
        far = "outside the range of motion" if outside else "largest over mass, delay, hands, phases"
        limit = "at the force limit" if contact.force_limit and self.peak >= contact.force_limit else ""
        rows: list[tuple[str, float, str, str]] = [
            ("stiffness", wall.stiffness, force, ""),
            ("damping", wall.damping, damping, ""),
            ("spectral radius", wall.spectral_radius, "", needs.describe(wall.worst)),
            ("min. dynamic stiffness over frequency", wall.dynamic_stiffness, force, softest),
        ]
        contacts: list[tuple[str, float, str, str]] = [
            ("force noise at rest", self.hum, "N", f"{contact.quantize * 1e6:g} µm sensor, hand {needs.hands[0]}"),
            (f"penetration at {contact.speed:g} m/s", self.depth * 1e3, "mm", far),
            (f"peak force at {contact.speed:g} m/s", self.peak, "N", limit),
        ]
        rows += [] if needs.rotary else contacts  # contacts are along z
        if contact.pulse and not needs.rotary:
            words = f"added for {contact.pulse_width * 1e3:g} ms, above {self.gate * 1e3:.1f} mm/s"
            rows.insert(2, ("pulse", self.pulse, "N s/m", words))
        if wall.island is not None:
            rows.append(("stable island, not used", wall.island, force, "and above: stable again in some cases"))
        growing = [needs.describe(case) for case, grows in zip(self.cases, self.grows) if grows]
        more = [f"and {len(growing) - _MOST_LISTED} more"] if len(growing) > _MOST_LISTED else []
        runs = f"{len(self.cases)} runs simulated from random heights, speeds and phases"
        note = f"{runs}; not settling: {len(growing) or 'none'}"
        if not _simulated(needs):
            words = f"delays of at most {MAX_DELAY_PERIODS} periods" if needs.plain else PLAIN
            note = f"not simulated: plants have {words}"
        if needs.mode:
            note += f"\n{rigid_note(needs.loops([wall.worst])[0][1].part((1,), 0))}"
        title = f"Stiffest PD wall at {1.0 / needs.period:g} Hz with spectral radius at most {needs.spectral_radius:g}"
        return Table(
            f"{title} in all combinations of {needs.description}",
            ("", "value", "unit", ""),
            rows,
            "\n".join([note, *growing[:_MOST_LISTED], *more]),
            warnings=self.warnings,
        )

    @property
    def pulse(self) -> float:
        """Pulse damping [N s/m]; see `ContactParameters.pulse_of`."""
        return self.contact.pulse_of(self.wall)

    @property
    def gate(self) -> float:
        """Least approach speed for a pulse [m/s].

        0 without a pulse.
        """
        return self.contact.gate(self.wall.requirements.period) if self.contact.pulse else 0.0


def _simulated(needs: WallRequirements) -> bool:
    """Return True for requirements that plants simulate."""
    return needs.plain and needs.delay[1] <= MAX_DELAY_PERIODS * needs.period


def evaluate_wall(wall: DesignedWall, contact: ContactParameters, *, seed: int = 0) -> DesignResult:
    """Simulate a designed wall in its required cases, and contacts at its approach speed.

    Args:
        wall: The wall.
        contact: Contact conditions.
        seed: Seed of the random cases.
    """
    needs = wall.requirements
    masses, delays, spectral_radius = needs.map(wall.stiffness, wall.damping)
    if not _simulated(needs):
        none = np.zeros(0, dtype=bool), math.nan, math.nan, math.nan
        return DesignResult(wall, contact, [], *none, masses, delays, spectral_radius)
    cases = [*needs.grid(3), wall.worst, *needs.random(_RANDOM, seed)]
    cases = [replace(case, stiffness=wall.stiffness, damping=wall.damping) for case in cases]
    grows = growing_cases(wall, contact, cases, seed=seed)
    depth, peak = hardest_contact(wall, contact)
    mass, delay = needs.nominal
    at_rest = 0.0
    if contact.quantize:
        around: Any = {"quantum": contact.quantize, "delay": delay, "period": needs.period, "mass": mass}
        around |= {"hand": get_hand(needs.hands[0]), "velocity": needs.velocity}
        duration = _TICKS * needs.period
        noise = hum(0.0, stiffness=wall.stiffness, damping=wall.damping, duration=duration, **around)
        at_rest = float(noise.force[0])
    return DesignResult(wall, contact, cases, grows, depth, peak, at_rest, masses, delays, spectral_radius)


def growing_cases(wall: DesignedWall, contact: ContactParameters, cases: Sequence[Loop], *, seed: int = 0) -> Mask:
    """Return True for cases that do not settle on the exact plant within 800 samples, (C,).

    Each starts at random from 1 mm behind the wall to 2 mm above it, moving down at up to the approach speed, at a
    random phase of the sampler. It settles if its swing in the last quarter is below 20 steps of the sensor, or below
    half of that in the second quarter; if the
    allowed spectral radius is near 1, below the share that remains at it.

    Args:
        wall: The wall, below z = 0.
        contact: Sensor, limit, pulse and speed.
        cases: The cases, (C,).
        seed: Seed of the starts.
    """
    random, count = np.random.default_rng(seed), len(cases)
    height, speed = random.uniform(-1e-3, 2e-3, count), contact.speed * random.uniform(0.05, 1.0, count)
    grows, phase = np.zeros(count, dtype=bool), random.uniform(0.0, 1.0, count)
    quarter, floor = _TICKS // 4, max(_SETTLED_STEPS * contact.quantize, 1e-9)
    slowest = min(max(0.5, 1.02 * wall.requirements.spectral_radius ** (2 * quarter)), 0.98)
    for index, plant in _plants(wall, contact, cases, height, speed, phase):
        heights: list[Array] = []

        def observe(sample: Sample, _: Command, plant: ExactPlant = plant, heights: list[Array] = heights) -> None:
            heights.append(plant.state()[0][:, 2])

        with plant:
            drive(plant, _controller(wall, contact), _TICKS, observe=observe)
        second, last = (np.ptp(heights[start : start + quarter], axis=0) for start in (quarter, 3 * quarter))
        grows[index] = (last > floor) & (last > slowest * second)
    return grows


def hardest_contact(wall: DesignedWall, contact: ContactParameters) -> tuple[float, float]:
    """Return the largest penetration [m] and force [N] over mass, delay, hands and 8 phases.

    The flotor starts above the wall, so that one sample is outside it, and gravity brings it to the approach speed at
    the edge; where that fall is too fast, it starts at rest.
    """
    cases = [case for case in wall.requirements.grid(2) for _ in range(_PHASES)]
    above = min(1.5 * contact.speed * wall.requirements.period, contact.speed**2 / (2.0 * GRAVITY))
    slower = math.sqrt(max(contact.speed**2 - 2.0 * GRAVITY * above, 0.0))
    starts = np.full(len(cases), above), np.full(len(cases), slower)
    depth, peak = 0.0, 0.0
    for _, plant in _plants(wall, contact, cases, *starts, np.arange(len(cases)) % _PHASES / _PHASES, record=True):
        with plant:
            drive(plant, _controller(wall, contact), _CONTACT_TICKS)
        summary = summarise_bounce(plant.trace().along(2), rest=0.0, axis=0)
        depth, peak = max(depth, float(summary.penetration.max())), max(peak, float(summary.peak_force.max()))
    return depth, peak


class _Hum(NamedTuple):
    """Limit cycle of a flotor at rest in a wall, from the worst start.

    Attributes:
        swing: Peak-to-peak position [m].
        force: Standard deviation of the force [N].
    """

    swing: Array
    force: Array


def hum(
    frictions: ArrayLike,
    *,
    law: Law | Controller | None = None,
    stiffness: float = 6000.0,
    damping: float = 80.0,
    quantum: float = Spec.translation_resolution.value,
    delay: float = Spec.transport_delay.value,
    period: float = 1.0 / Spec.control_rate.value,
    mass: float = Spec.moving_mass.value,
    hand: Hand | None = None,
    velocity: VelocityEstimator | None = None,
    device: tuple[float, float] = (DEVICE_PERIOD, DEVICE_DELAY),
    duration: float = 4.0,
    offsets: int = 32,
) -> _Hum:
    """Measure the limit cycle of a flotor that rests in a wall over a quantized sensor.

    The last quarter of the time is evaluated.

    Args:
        frictions: Coulomb friction of the device itself [N], (M,).
        law: The wall along z, or a controller; None for PD.
        stiffness: Wall stiffness, the rendered one of another law [N/m].
        damping: Wall damping [N s/m].
        quantum: Step of the sensor [m].
        delay: Transport delay [s].
        period: Sample period [s].
        mass: Moving mass [kg].
        hand: The hand on the flotor; None for none.
        velocity: Velocity estimator; None for the finite difference.
        device: Sample period and delay of walls on the device [s].
        duration: Simulated time [s].
        offsets: Number of starts over two steps of the sensor.

    Returns:
        A figure per friction, (M,) each.
    """
    friction = np.repeat(np.atleast_1d(numbers("frictions", frictions)), offsets)
    offset = np.resize(np.arange(offsets) / offsets, friction.size)
    arm = 0.0 if hand is None else float(hand.static_stiffness)
    depth = mass * GRAVITY / (stiffness + arm)
    plant = wall_plant(
        Timing(period=period, delay=delay, device_period=device[0], device_delay=device[1]),
        height=np.floor(-depth / quantum) * quantum + 2.0 * quantum * offset,
        quantum=quantum,
        mass=mass,
        hand=hand,
        wrench=along("z", np.full(friction.size, stiffness * depth)),
        dry_friction=along("z", friction),
        record=True,
    )
    around: Any = {"period": period, "delay": delay, "mass": mass, "velocity": velocity}
    with plant:
        controller = wall_controller(law, stiffness=stiffness, damping=damping, **around)
        drive(plant, controller, round(duration / period))
    trace = plant.trace()
    last = slice(-len(trace.time) // 4, -1)
    swing, force = np.ptp(trace.pose[last, :, 2], axis=0), np.std(trace.wrench[last, :, 2], axis=0)
    return _Hum(*(part.reshape(-1, offsets).max(axis=1) for part in (swing, force)))


def _plants(
    wall: DesignedWall,
    contact: ContactParameters,
    cases: Sequence[Loop],
    height: Array,
    speed: Array,
    phase: Array,
    *,
    record: bool = False,
) -> Iterator[tuple[list[int], ExactPlant]]:
    """Yield exact plants with the indices of their cases.

    Cases are separated by rigid or soft grip, and by the whole periods of the delay; the rest is one batch.
    """
    needs = wall.requirements
    soft = [case.hand is not None and case.hand.soft for case in cases]
    whole = [int(split_delay(case.delay, needs.period)[0]) for case in cases]
    for (grip, _), index in alike(zip(soft, whole)).items():
        some = [cases[number] for number in index]
        yield (
            index,
            wall_plant(
                Timing(period=needs.period, delay=np.array([case.delay for case in some]), phase=phase[index]),
                height=height[index],
                velocity=-speed[index],
                quantum=contact.quantize,
                lag=needs.lag,
                mass=np.array([case.inertia for case in some]),
                hand=_hands([case.hand or Hand() for case in some], grip),
                wrench_limit=contact.force_limit or None,
                record=record,
            ),
        )


def _controller(wall: DesignedWall, contact: ContactParameters) -> Controller:
    needs = wall.requirements
    mass, delay = needs.nominal
    return wall_controller(
        stiffness=wall.stiffness,
        damping=wall.damping,
        pulse=contact.pulse_of(wall),
        pulse_width=contact.pulse_width,
        pulse_gate=contact.gate(needs.period),
        period=needs.period,
        delay=delay,
        mass=mass,
        velocity=needs.velocity,
    )


def _hands(hands: Sequence[Hand], soft: bool) -> Hand:
    """Return the hands of a batch along z; none is one without mass."""
    mass, damping, stiffness, grip_damping, grip_stiffness = np.array([hand.values for hand in hands]).T
    grip = {"grip_damping": grip_damping, "grip_stiffness": grip_stiffness} if soft else {}
    return Hand(mass=mass, damping=damping, stiffness=stiffness, axes="z", **grip)
