"""The task of the teleoperation study and its means: gains by theory, coupling, slave and hand."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import mujoco
import numpy as np

from maglev_mj.control import Law, StickSlip
from maglev_mj.control.timeline import Timeline
from maglev_mj.errors import ParameterError, PlantError
from maglev_mj.frames import Array
from maglev_mj.interop.navigation import Navigator
from maglev_mj.parameters import number, numbers
from maglev_mj.plants import Timing
from maglev_mj.plants.hand import Hand, Trajectory, motion, transition
from maglev_mj.spec import Spec
from maglev_mj.theory import stiffest_wall

_STIFFNESS_SHARE, _DAMPING_SHARE = 0.25, 0.5
_MASS = Spec.moving_mass.value


class Gains(NamedTuple):
    """Stiffness [N/m] and damping [N s/m]."""

    stiffness: float
    damping: float


def stiffest_coupling(timing: Timing, slave_mass: float, mass: float = _MASS) -> Gains:
    """Return the stiffest stable coupling, and its damping, between two free bodies.

    The force comes at the same instants on both, one way and the other. So their distance moves as one body of the
    reduced mass would before a wall, and the coupling has that wall's bound.

    Args:
        timing: Sample period and delay.
        slave_mass: Of the slave as felt at the joystick [kg]; infinite for a law on the joystick alone.
        mass: Of the joystick [kg].
    """
    return _stiffest(timing.period, timing.delay, mass / (1.0 + mass / slave_mass))


@cache
def _stiffest(period: float, delay: float, mass: float) -> Gains:
    wall = stiffest_wall(period=period, delay=delay, mass=mass)
    return Gains(float(wall.stiffness), float(wall.damping))


def chosen_gains(timing: Timing, slave_mass: float, mass: float = _MASS) -> Gains:
    """Return a quarter of that stiffness, half its damping.

    That is half the frequency, as well damped.

    Args:
        timing: Sample period and delay.
        slave_mass: Of the slave as felt at the joystick [kg]; infinite for a law on the joystick alone.
        mass: Of the joystick [kg].
    """
    most = stiffest_coupling(timing, slave_mass, mass)
    return Gains(_STIFFNESS_SHARE * most.stiffness, _DAMPING_SHARE * most.damping)


NO_GAINS = Gains(0.0, 0.0)
"""No law at all."""


@dataclass(frozen=True, kw_only=True)
class TwoBodies:
    """Bodies that the coupling joins, along one axis; all as felt at the joystick.

    Args:
        timing: Sample period and delay.
        slave_mass: Mass of the slave [kg].
        contact: Stiffness of what the slave touches [N/m]; 0 where it is free.
        contact_damping: Its damping [N s/m].
        mass: Mass of the joystick [kg].
        hand: The hand on it; None for none.
        friction: Gains of a stuck stick-slip law on the joystick.
    """

    timing: Timing
    slave_mass: float
    contact: float = 0.0
    contact_damping: float = 0.0
    mass: float = _MASS
    hand: Hand | None = None
    friction: Gains = NO_GAINS

    def matrix(self, coupling: Gains) -> Array:
        """Return the matrix from one sample to the next.

        Its state: place and speed of the joystick, of the hand if its grip is soft, of the slave; the forces (on
        joystick, on slave) of the commands on their way, newest first; then both places one sample before.
        """
        timing, (a, b) = self.timing, self._motion()
        before, old = transition(a, b, timing.rest)
        after, new = transition(a, b, timing.period - timing.rest)
        waiting, bodies = timing.whole + (timing.rest > 0.0), len(a)
        size = bodies + 2 * waiting + 2
        command = self._command(coupling, bodies, size)
        m = np.zeros((size, size))
        m[:bodies, :bodies] = after @ before
        for age, share in ((timing.whole, new), (timing.whole + 1, after @ old)):
            if age == 0:
                m[:bodies] += share @ command
            elif age <= waiting:
                m[:bodies, bodies + 2 * age - 2 : bodies + 2 * age] += share
        if waiting:
            m[bodies : bodies + 2] = command
            m[bodies + 2 : -2, bodies:-4] = np.eye(2 * waiting - 2)
        m[-2, 0] = m[-1, bodies - 2] = 1.0
        return m

    def modulus(self, coupling: Gains) -> float:
        """Return the largest modulus of the eigenvalues, at least 1 if both bodies are free."""
        return float(np.abs(np.linalg.eigvals(self.matrix(coupling))).max())

    def boundary(self, damping: float) -> float:
        """Return the largest stable coupling stiffness [N/m], at some damping [N s/m]."""
        low, high = 1.0, 1e7
        for stiffness in np.geomspace(low, high, 200).tolist():
            if self.modulus(Gains(stiffness, damping)) > 1.0:
                high = stiffness
                break
            low = stiffness
        for _ in range(40):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if self.modulus(Gains(middle, damping)) > 1.0 else (middle, high)
        return low

    def _motion(self) -> tuple[Array, Array]:
        """Return the continuous equations for both forces."""
        own, push = motion(self.mass, self.hand)
        size, slave = len(own) + 2, self.slave_mass
        a, b = np.zeros((size, size)), np.zeros((size, 2))
        a[:-2, :-2], b[:-2, 0] = own, push[:, 0]
        a[-2, -1] = 1.0
        a[-1, -2:] = -self.contact / slave, -self.contact_damping / slave
        b[-1, 1] = 1.0 / slave
        return a, b

    def _command(self, coupling: Gains, bodies: int, size: int) -> Array:
        """Return both forces from the state at a sample."""
        period, unit = self.timing.period, np.eye(size)
        joystick, before = unit[0], unit[-2]
        stretch, last = joystick - unit[bodies - 2], before - unit[-1]
        force = coupling.stiffness * stretch + coupling.damping / period * (stretch - last)
        stuck = self.friction.stiffness * joystick + self.friction.damping / period * (joystick - before)
        return np.array([-force - stuck, force])


@dataclass(frozen=True, kw_only=True)
class Coupling:
    """A spring and a damper from joystick to slave.

    Args:
        stiffness: Of the spring [N/m].
        damping: Of the damper [N s/m].
        scale: The slave's way for the joystick's [1].
        reflection: The joystick's force for the slave's [1].
        bound: Largest force that the coupling gives, on each axis [N].

    Raises:
        ParameterError: If a value is outside its bounds.

    Source: a coupling between device and virtual tool after Colgate, Stanley & Brown 1995 and Adams & Hannaford 1999,
        recalled.
    """

    stiffness: float
    damping: float
    scale: float = 10.0
    reflection: float = 0.1
    bound: float = 8.0

    def __post_init__(self) -> None:
        number("stiffness", self.stiffness, above=0.0)
        number("damping", self.damping, at_least=0.0)
        for name in ("scale", "reflection", "bound"):
            number(name, getattr(self, name), above=0.0)

    @property
    def felt(self) -> float:
        """Factor from the slave's impedance to the joystick's [1], for masses, stiffnesses and dampings."""
        return self.scale * self.reflection

    @property
    def energy(self) -> float:
        """Factor from the slave's energies to the joystick's [1]."""
        return self.reflection / self.scale


class CouplingLaw(Law):
    """Stick-slip, if any, and the coupling's force, which is also kept for the slave.

    The slave is asked where it is when the joystick is. Where it is drawn to, the target, moves by the navigator's
    increments. In rate mode the target stays where the spring would pull harder than the coupling may: else it would
    go on into whatever the slave presses on, and the slave would be stuck to that until it had all come back.

    Args:
        coupling: The coupling.
        place: Returns where the slave is [m, the slave's], (3,).
        period: Sample period [s].
        navigator: What moves the target.
        friction: Stick-slip on the joystick, by which the navigator tells what the hand does; None for none.

    Attributes:
        force: What draws the slave, and the joystick the other way [N], (3,).
        target: Where the slave is drawn to [m, the slave's], (3,).
        rates: True for each of the three axes in rate mode.
    """

    def __init__(
        self,
        coupling: Coupling,
        place: Callable[[], Array],
        *,
        period: float,
        navigator: Navigator,
        friction: StickSlip | None = None,
    ) -> None:
        self.coupling, self._place, self._period = coupling, place, period
        self._navigator, self._friction = navigator, friction
        self.force, self.target = np.zeros(3), place()
        self.rates = navigator.rates[:3]
        self._stretch: Array | None = None

    def start(self) -> Any:
        """Return the friction's state before the first sample."""
        return None if self._friction is None else self._friction.start()

    def __call__(
        self, position: Sequence[float], velocity: Sequence[float], state: Any, wrench: list[float]
    ) -> tuple[Any, None]:
        """Answer one sample; see `Law`."""
        anchors = None
        if self._friction is not None:
            state, _ = self._friction(position, velocity, state, wrench)
            anchors = np.full(6, np.nan)
            for index, anchor in self._friction.stick_positions(state).items():
                anchors[index] = anchor
        moved = self._navigator.move(position, anchors, self._period)[:3]
        self.rates = self._navigator.rates[:3]
        place = self._place()
        self.target = self.target + self._allowed(moved, self.target - place)
        self.force = self._pull((self.target - place) / self.coupling.scale)
        for axis in range(3):
            wrench[axis] = wrench[axis] - float(self.force[axis])
        return state, None

    def _pull(self, stretch: Array) -> Array:
        """Return the coupling's force."""
        coupling = self.coupling
        rate = np.zeros(3) if self._stretch is None else (stretch - self._stretch) / self._period
        self._stretch = stretch
        pull = coupling.stiffness * stretch + coupling.damping * rate
        return np.clip(pull, -coupling.bound, coupling.bound)

    def _allowed(self, moved: Array, ahead: Array) -> Array:
        """Return the target's allowed movement [m]: the slave's, given its wish and its lead."""
        most = self.coupling.bound / self.coupling.stiffness * self.coupling.scale
        cut = np.clip(moved, np.minimum(-most - ahead, 0.0), np.maximum(most - ahead, 0.0))
        return np.where(self.rates, cut, moved)


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


DELAY_SHARE = 0.3
"""Transport delay in periods: the paper's 1.5 ms at 200 Hz."""

FIRM = Hand(mass=0.5, damping=25.0, stiffness=1000.0)
"""A firm grip, near the top of published hands."""

_Point: TypeAlias = tuple[float, float, float, float]

_JERK, _PUSHED = 0.1, 5.4
_BLOCK = {
    "position": (0.02, -0.01, -0.005),
    "rate": (0.13, 0.0, -0.06),
    "touching": (0.0, 0.0, 0.0),
    "free": (0.0, 0.0, -0.1),
}
"""Position of the block in each mode [m, the slave's], from the pin's start."""


@dataclass(frozen=True, kw_only=True)
class Task:
    """The task and its means.

    Args:
        mode: "position", or "rate": stick-slip on the joystick, and a rate beyond its edge. For studies of stability
            also "touching", position mode on the block from the start, and "free", without a block.
        period: Sample period [s].
        delay: From a sample to its command taking effect on joystick and slave [s].
        phase: When the first sample is taken [periods].
        press: Force with which the hand presses [N].
        speed: Of the joystick when the slave meets the block, in position mode [m/s].
        coupling: Virtual coupling; None for gains by the theory.
        hand: The hand on the joystick, with an arm.
        block: Stiffness of the block [N/m, the slave's].
        hold: How long it is pressed after the pushing has come to its end [s].
        leaves: Whether the hand lifts the slave off at the end, in the first two modes.

    Raises:
        ParameterError: If a value is outside its bounds.
    """

    mode: str = "position"
    period: float = 1.0 / Spec.control_rate.value
    delay: float = Spec.transport_delay.value
    phase: float = 0.0
    press: float = 5.0
    speed: float = 0.02
    coupling: Coupling | None = None
    hand: Hand = FIRM
    block: float = BLOCK_STIFFNESS
    hold: float = 1.2
    leaves: bool = True

    def __post_init__(self) -> None:
        if self.mode not in _BLOCK:
            raise ParameterError(f"mode must be one of {', '.join(_BLOCK)}, not {self.mode!r}")
        number("press", self.press, above=0.0, at_most=6.0)
        number("speed", self.speed, at_least=0.001, at_most=0.1)
        number("hold", self.hold, above=0.0)

    @property
    def timing(self) -> Timing:
        """Sample period, delay and phase."""
        return Timing(period=self.period, delay=self.delay, phase=self.phase)

    def chosen(self, slave_mass: float) -> Coupling:
        """Return the coupling.

        By default one for a slave of this mass along its lightest axis [kg, the slave's].
        """
        if self.coupling is not None:
            return self.coupling
        start = Coupling(stiffness=1.0, damping=0.0)
        return replace(start, **chosen_gains(self.timing, start.felt * slave_mass)._asdict())

    @property
    def friction(self) -> Gains:
        """Gains of the stick-slip law in rate mode, no stiffer than at the paper's rate."""
        return min(chosen_gains(self.timing, math.inf), chosen_gains(Timing(), math.inf))

    @property
    def block_top(self) -> Array:
        """Middle of the block's top [m], (3,), from the start of the pin's tip, the slave's."""
        return np.array(_BLOCK[self.mode])

    def path(self, coupling: Coupling) -> tuple[Trajectory, float]:
        """Return the arm's path, and its end of pushing [s]."""
        _, _, arm, _, grip = (float(value) for value in self.hand.values)
        reach = 1e3 * self.press * (1.0 / arm + (1.0 / grip if grip else 0.0))
        if self.mode == "rate":
            return _steered(self, reach)
        if self.mode == "touching":
            return _path([(0.1, 0, 0, 0), (0.6, 0, 0, -reach), (0.7, 0, 0, -reach), (0.701, 0, 0, -reach - _JERK)]), 0.6
        if self.mode == "free":
            return _path([(0.7, 0, 0, 0), (0.701, 0, 0, _JERK)]), 0.6
        return _drawn(self, reach + 1e3 * self.press / coupling.stiffness)


def _drawn(task: Task, reach: float) -> tuple[Trajectory, float]:
    """Return the way to the block in position mode.

    Aside, down at a speed that is greatest on contact, and press.

    Args:
        task: The task.
        reach: By how much arm, grip and coupling are stretched in the end [mm].
    """
    down = 0.7 + 1.875 * 0.004 / task.speed  # a minimum-jerk stroke of 4 mm
    points: list[_Point] = [(0.1, 0, 0, 0), (0.6, 2, -1, 1.5), (0.7, 2, -1, 1.5), (down, 2, -1, -2.5)]
    points += [(down + 0.4, 2, -1, -0.5 - reach)]
    if task.leaves:
        end = down + 0.4 + task.hold
        points += [(end, 2, -1, -0.5 - reach), (end + 0.4, 2, -1, 1.5), (end + 0.6, 2, -1, 1.5)]
    return _path(points), down + 0.4


def _steered(task: Task, reach: float) -> tuple[Trajectory, float]:
    """Return the way to the block in rate mode.

    Push aside, release, push down onto the block, press, release.

    Args:
        task: The task.
        reach: By how much arm and grip are stretched in the end [mm].
    """
    aside, along = 3.5, 4.0
    points: list[_Point] = [(0.1, 0, 0, 0), (0.8, along, 0, 0), (1.0, _PUSHED, 0, 0), (2.0, _PUSHED, 0, 0)]
    points += [(2.2, aside, 0, 0), (2.8, aside, 0, -along), (3.0, aside, 0, -_PUSHED), (4.0, aside, 0, -_PUSHED)]
    points += [(4.8, aside, 0, -along - reach)]
    if task.leaves:
        end = 4.8 + task.hold
        points += [(end, aside, 0, -along - reach), (end + 0.4, aside, 0, 2.5), (end + 0.8, aside, 0, 2.5)]
    return _path(points), 4.8


def _path(points: Sequence[_Point]) -> Trajectory:
    """Return a path from times [s] and places [mm]."""
    table = np.array(points)
    return Trajectory(table[:, 0], np.pad(table[:, 1:] * 1e-3, ((0, 0), (0, 3))))
