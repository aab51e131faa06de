"""One run of a task, recorded sample by sample: joystick and slave side by side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gantry.coupling import Coupling, CouplingLaw
from gantry.slave import Slave
from gantry.task import Task
from maglev_mj import Controller, drive
from maglev_mj.control import Bias, Hold, StickSlip
from maglev_mj.frames import Array, Command, Mask, Sample
from maglev_mj.interop.spacenav.navigation import Mode, Navigation, Navigator
from maglev_mj.plants import MuJoCoPlant
from maglev_mj.plants.hand import GuidedHand
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
        self.rows.append((law.target, pushes, [mode is Mode.RATE for mode in law.modes], slave.contacts))
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
    """Return the coupling's law.

    In rate mode with friction, by which the hand is told to push or to release.
    """
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
