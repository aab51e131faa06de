"""Runs of a task: record, energy from hand to block, and limits of the theory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np

from gantry.task import BLOCK_DAMPING, FIRM, Coupling, CouplingLaw, Gains, Slave, Task, TwoBodies
from maglev_mj import Controller, drive
from maglev_mj.control import Bias, Hold, StickSlip
from maglev_mj.frames import Array, Command, Mask, Sample
from maglev_mj.interop.navigation import Navigation, Navigator
from maglev_mj.plants import MuJoCoPlant
from maglev_mj.plants.hand import HANDS, GuidedHand, get_hand
from maglev_mj.scenes.rooms import INERTIA, MASS, WEIGHT
from maglev_mj.spec import GRAVITY

_STEP = 2e-4
_BREAKAWAY, _V_MIN = 2.0, 0.005
_EDGE, _RATE = 0.0025, 5.0
_EVERYWHERE = 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class History:
    """Record of a run at steps and samples.

    N at the slave's steps and K at samples; as at the joystick if not the slave's.

    Attributes:
        task: What was done.
        coupling: With what.
        slave_mass: What the slave moves along x, y and z [kg, the slave's], (3,).
        pressed: When the hand was done with pushing [s].
        time: Of the steps, from the first sample on [s], (N,).
        joystick: Place [m] and velocity [m/s], (2, N, 3).
        slave: Place [m, the slave's] and velocity [m/s, the slave's], (2, N, 3).
        force: What the coupling gives from then on, to the slave one way and to the joystick the other [N], (N, 3).
        contact: The block's force on the slave [N, the slave's], (N, 3).
        target: Where the slave is drawn to from each sample on [m, the slave's], (K, 3).
        muscles: What the hand's muscles exert from each sample on [N], (K, 3).
        rate: Whether an axis is in rate mode, (K, 3).
        contacts: How often the pin had left the block at each sample, (K,).
        wrench: What the actuators give the joystick from then on, beyond what carries it [N], (N, 3).
        work: Their work up to the last sample [J].
    """

    task: Task
    coupling: Coupling
    slave_mass: Array
    pressed: float
    time: Array
    joystick: Array
    slave: Array
    force: Array
    contact: Array
    target: Array
    muscles: Array
    rate: Mask
    contacts: Array
    wrench: Array
    work: float

    def held(self, seconds: float = 0.5) -> Mask:
        """Return the steps in the end of the hold, (N,)."""
        end = self.pressed + self.task.hold
        return (self.time >= end - seconds) & (self.time < end)

    @property
    def press(self) -> float:
        """Mean force on the block in the hold [N], over its last half second; the slave's."""
        return float(self.contact[self.held(), 2].mean())

    @property
    def ripple(self) -> float:
        """Ripple of the force on the block, RMS [N], in that time; the slave's."""
        return float(self.contact[self.held(), 2].std())

    @property
    def pull(self) -> float:
        """Net force of the hand along z [N].

        Its muscles' less its arm's in that time, with a rigid grip.
        """
        step, arm = int(np.flatnonzero(self.held())[-1]), float(np.asarray(self.task.hand.stiffness))
        tick = int(self.time[step] / self.task.period)
        return float(arm * self.joystick[0][step, 2] - self.muscles[tick, 2])

    @property
    def losses(self) -> tuple[int, int]:
        """Contacts lost before the release, and in the hold."""
        period = self.task.period
        start, end = (round(when / period) for when in (self.pressed, self.pressed + self.task.hold))
        first, last = (int(self.contacts[min(tick, len(self.contacts) - 1)]) for tick in (start, end - 1))
        return first, last - first


class _Exchange:
    """Exchange of both sides at a sample, recorded."""

    def __init__(self, plant: MuJoCoPlant, slave: Slave, law: CouplingLaw) -> None:
        self._plant, self._slave, self._law = plant, slave, law
        self.rows: list[tuple[Array, Array, list[bool], int]] = []

    def __call__(self, sample: Sample, command: Command) -> None:
        law, slave = self._law, self._slave
        pushes = np.array(self._plant.hand_wrench[:3], dtype=np.float64)
        self.rows.append((law.target, pushes, law.rates.tolist(), slave.contacts))
        slave.step(law.force / law.coupling.reflection)


def carry_out(task: Task) -> History:
    """Do a task.

    Raises:
        PlantError: If joystick or slave go where they cannot be.
    """
    slave = Slave(task.timing, task.block_top, stiffness=task.block, record=True, longest_step=_STEP)
    coupling = task.chosen(float(slave.mass.min()))
    path, pressed = task.path(coupling)
    plant = MuJoCoPlant(
        task.timing,
        metered=True,
        hand=task.hand,
        hand_force=GuidedHand(hand=task.hand, path=path),
        wrench=WEIGHT,
        record=True,
        longest_step=_STEP,
    )
    law = _law(task, coupling, slave)
    keep = Hold.critically_damped(("rx", "ry", "rz"), inertia=INERTIA[3:], period=task.period, delay=task.delay)
    exchange = _Exchange(plant, slave, law)
    end = max(path.end, pressed + task.hold)
    drive(plant, Controller([Bias(WEIGHT), law, keep], period=task.period), round(end / task.period), observe=exchange)
    slave.note()
    return _history(task, coupling, pressed, plant, slave, exchange)


def _law(task: Task, coupling: Coupling, slave: Slave) -> CouplingLaw:
    """Return the coupling's law, in rate mode with friction."""
    scale, friction = coupling.scale, None
    way = Navigation(edge=_EVERYWHERE, scale=scale)
    if task.mode == "rate":
        stiffness, damping = task.friction
        friction = StickSlip(
            axes=("x", "y", "z"), stiffness=stiffness, damping=damping, breakaway=_BREAKAWAY, v_min=_V_MIN
        )
        way = Navigation(edge=_EDGE, scale=scale, gain=scale * _RATE, give=_BREAKAWAY / stiffness)
    return CouplingLaw(
        coupling, lambda: slave.position, period=task.period, navigator=Navigator(way), friction=friction
    )


def _history(
    task: Task, coupling: Coupling, pressed: float, plant: MuJoCoPlant, slave: Slave, exchange: _Exchange
) -> History:
    """Return the assembled record."""
    rows = np.array(slave.rows)
    time = rows[:, 0]
    pose, twist, wrench = plant.trace().at(time + task.phase * task.period)
    force = rows[:, 7:10] * coupling.reflection
    target, muscles, rate, contacts = (np.array(column) for column in zip(*exchange.rows, strict=True))
    carried = MASS * GRAVITY * float(plant.state()[0][2])
    return History(
        task=task,
        coupling=coupling,
        slave_mass=slave.mass,
        pressed=pressed,
        time=time,
        joystick=np.stack([pose[:, :3], twist[:, :3]]),
        slave=np.stack([rows[:, 1:4], rows[:, 4:7]]),
        force=force,
        contact=rows[:, 10:13],
        target=target,
        muscles=muscles,
        rate=rate,
        contacts=contacts,
        wrench=wrench[:, :3] - WEIGHT[:3],
        work=plant.work - carried,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Ledger:
    """Energies up to each step [J], (N,) each.

    Those of the slave as felt at the joystick.

    Attributes:
        time: [s]
        hand: Work of the hand's muscles.
        drift: Work that drives the target on in rate mode, which is not the hand's.
        made: What sampling and delay make: what the coupling has given beyond what its ideal spring and damper would.
        taken: What the coupling has taken from the joystick.
        given: What it has given to the slave.
        motion: Kinetic energy of joystick, hand and slave.
        springs: Energy in the coupling's spring and the arm's.
        arm: Taken by the arm's damper.
        friction: Taken by the stick-slip law.
        damper: Taken by the coupling's ideal damper.
        block: Taken by the block, and kept in it while it is pressed.
        foreseen: What sampling and delay make to first order, K (T/2 + delay) for each B of the damper.
        joystick_lack: What is missing on the joystick's side of the coupling: 0 but for the integration.
        slave_lack: Likewise on the slave's.
    """

    time: Array
    hand: Array
    drift: Array
    made: Array
    taken: Array
    given: Array
    motion: Array
    springs: Array
    arm: Array
    friction: Array
    damper: Array
    block: Array
    foreseen: Array
    joystick_lack: Array
    slave_lack: Array

    @property
    def put_in(self) -> Array:
        """All that was put in."""
        return self.hand + self.drift + self.made

    @property
    def kept_or_lost(self) -> Array:
        """All that is stored, or lost."""
        return self.motion + self.springs + self.arm + self.friction + self.damper + self.block


def ledger(history: History) -> Ledger:
    """Add up the energies of a task.

    The forces of coupling and hand hold from step to step and from sample to sample, so that their work is force
    times way; what the dampers and the block take is integrated from step to step.
    """
    h, task, coupling = history, history.task, history.coupling
    mass, arm_damping, arm_stiffness = (float(value) for value in task.hand.values[:3])
    (x, v), (y, w) = h.joystick, h.slave / coupling.scale
    way, offset = np.diff(x, axis=0), _offset(history)
    ahead = np.diff(offset, axis=0)
    stretch = x + offset - y
    pace = ahead / np.diff(h.time)[:, None]
    squared = _squares(h.time, (v - w)[:-1] + pace, (v - w)[1:] + pace)
    force = h.force[:-1]
    taken, given, drift = (_sum(force * part) for part in (way, np.diff(y, axis=0), ahead))
    spring = 0.5 * coupling.stiffness * (stretch**2).sum(axis=1)
    spring -= spring[0]
    damper = coupling.damping * squared
    hand, arm = _sum(_at_steps(history, h.muscles)[:-1] * way), arm_damping * _squares(h.time, v[:-1], v[1:])
    bent = 0.5 * arm_stiffness * ((x**2).sum(axis=1) - (x[0] ** 2).sum())
    moving = 0.5 * (MASS + mass) * ((v**2).sum(axis=1) - (v[0] ** 2).sum())
    slave = 0.5 * coupling.energy * (h.slave_mass * h.slave[1] ** 2).sum(axis=1)
    block = coupling.energy * _integral(h.time, -(h.contact * h.slave[1]).sum(axis=1))
    friction = _sum(-(h.wrench[:-1] + force) * way)
    late = coupling.stiffness * (0.5 * task.period + task.delay)
    return Ledger(
        time=h.time,
        hand=hand,
        drift=drift,
        made=spring + damper - (taken + drift - given),
        taken=taken,
        given=given,
        motion=moving + slave,
        springs=spring + bent,
        arm=arm,
        friction=friction,
        damper=damper,
        block=block,
        foreseen=late * squared,
        joystick_lack=hand - taken - friction - moving - bent - arm,
        slave_lack=given - slave - block,
    )


def _offset(history: History) -> Array:
    """Return the target's lead over the joystick [m], (N, 3): straight from sample to sample."""
    period, time = history.task.period, history.time
    ticks = np.arange(len(history.target)) * period
    places = np.stack([np.interp(ticks, time, history.joystick[0][:, axis]) for axis in range(3)], axis=1)
    offset = history.target / history.coupling.scale - places
    # a target that moves with the joystick keeps its distance; what is left is rounding
    offset = np.stack([np.interp(time, ticks, offset[:, axis]) for axis in range(3)], axis=1)
    return offset


def _at_steps(history: History, values: Array) -> Array:
    """Return sample-held values, (K, 3), at the steps, (N, 3)."""
    tick = np.floor(history.time / history.task.period + 1e-6).astype(int)
    return np.asarray(values[np.minimum(tick, len(values) - 1)])


def _sum(parts: Array) -> Array:
    """Return a running sum over steps and axes, (N,), of (N - 1, 3), from 0."""
    return np.concatenate([[0.0], np.cumsum(parts.sum(axis=1))])


def _squares(time: Array, start: Array, end: Array) -> Array:
    """Return the running integral over all axes of a piecewise linear value's square, (N,)."""
    return _sum(np.diff(time)[:, None] * (start**2 + start * end + end**2) / 3.0)


def _integral(time: Array, values: Array) -> Array:
    """Return the running integral by the trapezoidal rule, (N,)."""
    return np.concatenate([[0.0], np.cumsum(0.5 * np.diff(time) * (values[:-1] + values[1:]))])


GRIPS = {"firm": FIRM, **{name: hand for name in HANDS if (hand := get_hand(name)) is not None}}
"""Hands on the joystick, by name."""

_START, _SAMPLES = 0.72, 200


class Growth(NamedTuple):
    """Growth a sample, as measured and by the eigenvalues."""

    measured: float
    foreseen: float


class Contact(NamedTuple):
    """Outcome of one contact; forces are the slave's [N]."""

    hand: str
    phase: float
    """Of the first sample [periods]."""
    speed: float
    """Of the joystick at contact [m/s]."""
    asked: float
    """Force of the hand's press, as felt at the slave."""
    press: float
    """Mean force in the last half second of the hold."""
    ripple: float
    """Root mean square of the force about that."""
    bounces: int
    """Number of bounces of the pin on landing."""
    losses: int
    """Number of bounces afterwards."""


def bodies(task: Task, coupling: Coupling, slave_mass: float) -> TwoBodies:
    """Return the bodies that the coupling joins along z.

    Args:
        task: The task.
        coupling: Its scales.
        slave_mass: What the slave moves along z [kg, the slave's].
    """
    felt, there = coupling.felt, task.mode != "free"
    return TwoBodies(
        timing=task.timing,
        slave_mass=felt * slave_mass,
        contact=felt * task.block * there,
        contact_damping=felt * BLOCK_DAMPING * there,
        hand=task.hand,
    )


def growth(task: Task) -> Growth:
    """Measure the growth of the joystick's oscillation along z.

    By fourth differences of its samples, in which slow motion does not count: their root mean square over 100 samples,
    over that of the 100 before.

    Args:
        task: In mode "touching" or "free".
    """
    history = carry_out(replace(task, hold=_START + _SAMPLES * task.period - 0.6))
    ticks = (round(_START / task.period) + np.arange(_SAMPLES)) * task.period
    bends = np.diff(np.interp(ticks, history.time, history.joystick[0][:, 2]), 4)
    half = len(bends) // 2
    first, last = (float(np.sqrt(np.mean(part**2))) for part in (bends[:half], bends[half:]))
    coupling = history.coupling
    theory = bodies(task, coupling, float(history.slave_mass[2]))
    return Growth((last / first) ** (1.0 / half), theory.modulus(Gains(coupling.stiffness, coupling.damping)))


def measured_boundary(shares: Sequence[float], found: Sequence[Growth]) -> float:
    """Return the share without growth or decay: interpolated between those measured.

    Args:
        shares: Of the stiffness that the eigenvalues foresee, increasing.
        found: Growth at each.
    """
    return float(np.interp(1.0, [one.measured for one in found], shares))


def contacts(
    task: Task, hands: Sequence[str], phases: Sequence[float], approaches: Sequence[tuple[float, float]]
) -> Iterator[Contact]:
    """Run a task over hands, phases and presses.

    Pairs of speed [m/s] and force of the press [N].

    Raises:
        PlantError: If joystick or slave go where they cannot be.
    """
    for hand, phase, (speed, press) in product(hands, phases, approaches):
        changed = replace(task, hand=GRIPS[hand], phase=phase, speed=speed, press=press, leaves=False)
        history = carry_out(changed)
        bounces, losses = history.losses
        asked = press / history.coupling.reflection
        yield Contact(hand, phase, speed, asked, history.press, history.ripple, bounces, losses)
