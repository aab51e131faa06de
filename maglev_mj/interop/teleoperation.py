"""Teleoperation: your own MuJoCo robot follows the joystick, and the hand feels its contacts."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from maglev_mj.control import Bias, Hold, Law
from maglev_mj.control.laws.base import Answer, Gains
from maglev_mj.errors import ModelError, ParameterError, PlantError
from maglev_mj.frames import AXES, Array, Component, Six
from maglev_mj.lazy import mujoco
from maglev_mj.parameters import param
from maglev_mj.plants.engine import engine_warnings_silenced, warned
from maglev_mj.plants.shapes import Shape, shape_of
from maglev_mj.scenes import Scene
from maglev_mj.scenes.wall_scene import hold
from maglev_mj.theory import largest_stable_stiffness
from maglev_mj.theory.read import scene_lag

_PLACE = np.array([0.065, 0.0, 0.099])
"""Where the robot's site is drawn at the start, beside the knob and in the default view [m], (3,)."""


class Robot:
    """MuJoCo model with a site that follows.

    Args:
        model: MJCF file, or its text.
        site: Name of the site.

    Attributes:
        start: Integration state at the start: that of the first keyframe, if there is one.
        mass: Smallest apparent mass of the site over all directions [kg].
        shapes: Visible geoms by index, at the origin.
    """

    def __init__(self, model: str | Path, site: str) -> None:
        text = isinstance(model, str) and model.lstrip().startswith("<")
        load = mujoco.MjModel.from_xml_string if text else mujoco.MjModel.from_xml_path
        try:
            self.model = load(str(model))
            self.site = self.model.site(site).id
        except (ValueError, KeyError) as error:
            raise ModelError(f"robot is invalid: {' '.join(str(error).split())}") from None
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # would hide that the robot diverges
        self.data, self._step = mujoco.MjData(self.model), float(self.model.opt.timestep)
        if self.model.nkey:
            mujoco.mj_resetDataKeyframe(self.model, self.data, 0)
        mujoco.mj_forward(self.model, self.data)
        self.start, jacobian, inverse = self.state(), np.zeros((3, self.model.nv)), np.zeros((3, self.model.nv))
        mujoco.mj_jacSite(self.model, self.data, jacobian, None, self.site)
        mujoco.mj_solveM(self.model, self.data, inverse, jacobian)
        self.mass = 1.0 / float(np.linalg.eigvalsh(inverse @ jacobian.T)[-1])
        self.origin = self.data.site_xpos[self.site].copy()
        found = {geom: shape_of(self.model, self.data, geom, meshes=True) for geom in range(self.model.ngeom)}
        self.shapes = {geom: shape for geom, shape in found.items() if shape is not None}

    def state(self) -> Array:
        """Return the integration state, which repeats the motion bit for bit."""
        kind = mujoco.mjtState.mjSTATE_INTEGRATION
        state = np.empty(mujoco.mj_stateSize(self.model, kind))
        mujoco.mj_getState(self.model, self.data, state, kind)
        return state

    def place(self, state: Array) -> Array:
        """Restore a state; return the displacement of the site from its start [m], (3,)."""
        mujoco.mj_setState(self.model, self.data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        return np.asarray(self.data.site_xpos[self.site] - self.origin)

    def pull(self, force: Array, duration: float) -> None:
        """Advance by a duration [s], in whole steps, under a force on the site [N], (3,).

        Raises:
            PlantError: If the engine warns, as when the robot diverges.
        """
        count = round(duration / self._step) or (duration > 1e-9)
        body, point = self.model.site_bodyid[self.site], self.data.site_xpos[self.site].copy()
        self.data.qfrc_applied[:] = 0.0
        mujoco.mj_applyFT(self.model, self.data, force, np.zeros(3), point, body, self.data.qfrc_applied)
        self.model.opt.timestep = duration / max(count, 1)
        before = self.data.warning.number.copy()
        with engine_warnings_silenced():
            mujoco.mj_step(self.model, self.data, count)
        if names := warned((self.data.warning.number - before).tolist()):
            remedy = "reduce its time step, or make what it touches softer or heavier"
            raise PlantError(f"MuJoCo warns of the robot at {self.data.time:.4g} s: {names}; {remedy}")


robot_of = lru_cache(maxsize=8)(Robot)


class Coupling(Law):
    """Spring and damper between the joystick and a robot's site.

    Its state: integration state of the robot, last extension [m] and last force [N]. The force acts on both ends one
    delay after a sample.

    Args:
        scene: Scene with the robot and the gains.
    """

    def __init__(self, scene: Teleoperation) -> None:
        self.scene = scene

    def start(self) -> tuple[Array, Array, Array]:
        """See `Law`."""
        return self.scene.follower.start, np.zeros(3), np.zeros(3)

    def __call__(self, position: Six, velocity: Six, state: Any, wrench: list[Component]) -> Answer:
        """See `Law`."""
        scene, robot, (before, last, held) = self.scene, self.scene.follower, state
        extension = np.array(position[:3]) - robot.place(before) / scene.scale
        stiffness, damping = scene.coupling
        force = stiffness * extension + damping * (extension - last) / scene.period
        robot.pull(scene.scale * held, scene.delay)
        robot.pull(scene.scale * force, scene.period - scene.delay)
        wrench[:3] = [total - part for total, part in zip(wrench, force.tolist())]
        return (robot.state(), extension, force), None

    def gains(self) -> Iterable[Gains]:
        """Return the gains of the joystick's mass alone that have the poles of both free bodies."""
        share = float(self.scene.body.inertia[0]) / self.scene.reduced_mass
        stiffness, damping = (share * gain for gain in self.scene.coupling)
        return Hold(axes=AXES[:3], stiffness=stiffness, damping=damping).gains()


class Teleoperation(Scene):
    """A robot follows the joystick, and the hand feels its contacts; subclass it with your robot.

    Displacement and force of the robot are `scale` times those of the joystick, so masses and stiffnesses feel
    unscaled.

    Class attributes:
        robot: MJCF file, or its text.
        site: Name of the site that follows the joystick, along the axes of the world.
        scale: Displacement of the robot over that of the joystick.

    Raises:
        ModelError: If the robot is invalid or has no such site.

    Example:
        >>> from maglev_mj.interop.teleoperation import Teleoperation
        >>> class Ball(Teleoperation):
        ...     "A free ball follows."
        ...
        ...     robot = '''<mujoco><worldbody><body gravcomp="1"><freejoint/><geom size=".01" mass="1"/>
        ...       <site name="tool"/></body></worldbody></mujoco>'''
        ...     site, scale = "tool", 10.0
        >>> round(Ball().coupling[0])  # a quarter of the critical stiffness of two free bodies [N/m]
        1496
    """

    robot: ClassVar[str | Path] = ""
    site: ClassVar[str] = ""
    scale: ClassVar[float] = 1.0

    share: float = param(
        "coupling stiffness over critical stiffness of two free bodies", default=0.25, above=0.0, at_most=2.0, live=True
    )
    push: float = param("force of the scripted hand downwards", "N", default=3.0, at_least=0.0, at_most=50.0)

    def check(self) -> None:
        """See `Scene`."""
        if self.delay > self.period:
            raise ParameterError(f"delay must be at most the period, {self.period:g} s (got {self.delay:g})")

    @property
    def follower(self) -> Robot:
        """The robot, compiled once."""
        return robot_of(self.robot, self.site)

    @property
    def reduced_mass(self) -> float:
        """Reduced mass of joystick and robot [kg]: their distance moves as one body of this mass at a wall."""
        mass = float(self.body.inertia[0])
        return mass * self.follower.mass / (mass + self.follower.mass)

    @property
    def coupling(self) -> tuple[float, float]:
        """Stiffness [N/m] and damping [N s/m] of the coupling."""
        limit = _limit(self.period, self.delay, self.reduced_mass, scene_lag(self))
        return self.share * limit[0], self.share**0.5 * limit[1]

    def laws(self) -> Sequence[Law]:
        """See `Scene`."""
        return [Coupling(self), Bias(-self.body.load), hold(self, AXES[3:])]

    def scripted_hand(self, phase: float = 0.0) -> Any:
        """Return a hand that pushes down, by its force within half a second."""
        return lambda tick, time, state: [0.0, 0.0, -self.push * min(2.0 * time, 1.0), 0.0, 0.0, 0.0]

    def beside(self) -> Sequence[Shape]:
        """See `Scene`."""
        return [shape._replace(half=shape.half / self.scale) for shape in self.follower.shapes.values()]

    def beside_poses(self, states: Any) -> Array:
        """See `Scene`."""
        robot, quaternion = self.follower, np.zeros(4)
        robot.place(states[0][0])
        rows = []
        for geom in robot.shapes:
            mujoco.mju_mat2Quat(quaternion, robot.data.geom_xmat[geom])
            place = _PLACE + (robot.data.geom_xpos[geom] - robot.origin) / self.scale
            rows.append([*place, *quaternion])
        return np.array(rows)


@lru_cache
def _limit(period: float, delay: float, mass: float, driver_lag: float) -> tuple[float, float]:
    limit = largest_stable_stiffness(period=period, delay=delay, mass=mass, driver_lag=driver_lag)
    return float(limit.stiffness), float(limit.damping)
