"""Energy of a task, from the hand to the block.

Through joystick and coupling to the slave.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gantry.run import History
from maglev_mj.frames import Array
from maglev_mj.scenes.rooms import MASS


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
    """Return the running integral of a square, (N,).

    Of a value that is linear over each step, over all axes.
    """
    return _sum(np.diff(time)[:, None] * (start**2 + start * end + end**2) / 3.0)


def _integral(time: Array, values: Array) -> Array:
    """Return the running integral by the trapezoidal rule, (N,)."""
    return np.concatenate([[0.0], np.cumsum(0.5 * np.diff(time) * (values[:-1] + values[1:]))])
