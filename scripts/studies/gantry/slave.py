"""The slave: a gantry in MuJoCo over a stiff block.

It carries a pin in its gripper.
"""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np

from maglev_mj.control.timeline import Timeline, Timing
from maglev_mj.errors import PlantError
from maglev_mj.frames import Array
from maglev_mj.parameters import number, numbers

MODEL = Path(__file__).with_name("slave.xml")

BLOCK_STIFFNESS = 1e5
"""Stiffness of the contact with the block [N/m]."""

BLOCK_DAMPING = 190.0
"""Damping of the block [N s/m], 0.3 of critical."""


class Slave:
    """Gantry driven by delayed and held forces, as those on the joystick are.

    Args:
        timing: Sample period and delay, as the joystick's.
        block: Middle of the block's top, from where the pin's tip starts [m], (3,).
        stiffness: Of the contact [N/m].
        damping: Of the contact [N s/m].
        record: Keep each step, for `rows`.
        longest_step: Longest integration step [s].

    Attributes:
        mass: What moves along x, y and z [kg], (3,).
        contacts: How often the pin has left the block.
        rows: One for each step, (N, 13): time since the first sample, position (3), velocity (3), force (3) in effect
            from then on, contact force (3).

    Raises:
        ParameterError: If a value is outside its bounds.
    """

    def __init__(
        self,
        timing: Timing,
        block: Array,
        *,
        stiffness: float = BLOCK_STIFFNESS,
        damping: float = BLOCK_DAMPING,
        record: bool = False,
        longest_step: float = 2e-4,
    ) -> None:
        self._timing, self._records = timing, record
        self._longest = number("longest_step", longest_step, above=0.0)
        self.model = model = mujoco.MjModel.from_xml_path(str(MODEL))
        start = model.body("along_x").pos
        top = start + numbers("block", block)
        model.geom("block").size[2] = half = 0.5 * number("height of the block", top[2], above=0.01)
        model.geom("block").pos[:] = top[0], top[1], half
        # the engine scales a contact by the inverse masses that it sees, in the mean over the axes, and by 1 - solimp
        weight = float(model.body("along_z").invweight0[0]) * (1.0 - float(model.pair_solimp[0, 0]))
        model.pair_solref[0] = (
            -number("stiffness", stiffness, above=0.0) * weight,
            -number("damping", damping, at_least=0.0) * weight,
        )
        self.data = mujoco.MjData(model)
        mujoco.mj_forward(model, self.data)
        inertia = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, self.data, inertia)
        self.mass: Array = np.diag(inertia).copy()
        self._timeline = Timeline(timing, np.zeros(3))
        self._force, self._tick, self._touched = np.zeros(3), 0, False
        self.contacts = 0
        self.rows: list[list[float]] = []

    @property
    def position(self) -> Array:
        """Displacement of the pin's tip [m], (3,)."""
        return np.array(self.data.qpos)

    def step(self, force: Array) -> None:
        """Take a sample's answer, and advance one period.

        Args:
            force: What the actuators are to give, from `delay` on [N], (3,).

        Raises:
            PlantError: If the slave has gone where it cannot be.
        """
        offset = 0.0
        for duration, acting in self._timeline.period(self._tick, (force, None, 0.0)):
            self._force = acting
            self._advance(offset, duration)
            offset += duration
        self._tick += 1
        if not np.abs(self.data.qpos).max() < 1.0:
            raise PlantError(f"the slave is at {self.data.qpos.max():g} m after {self._tick} ticks")

    def _advance(self, offset: float, duration: float) -> None:
        pieces = math.ceil(duration / self._longest - 1e-9)
        data, model = self.data, self.model
        model.opt.timestep = duration / pieces
        data.ctrl[:] = self._force
        for piece in range(pieces):
            if self._records:
                self.note(offset + duration * piece / pieces)
            mujoco.mj_step(model, data)
            touches = data.ncon > 0 and data.contact[0].dist < 0.0
            self.contacts += self._touched and not touches
            self._touched = touches

    def note(self, offset: float = 0.0) -> None:
        """Record position and forces at a time [s], after the last sample."""
        data = self.data
        mujoco.mj_forward(self.model, data)
        time = self._tick * self._timing.period + offset
        self.rows.append([time, *data.qpos, *data.qvel, *self._force, *data.qfrc_constraint])
