"""The flotor in MuJoCo, with cheap access to its numbers."""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import partial

import mujoco

from peers.task import Task, quaternion, rotation_vector

SEMI_IMPLICIT = ("Euler", "implicit", "implicitfast", "discrete")
INTEGRATORS = (*SEMI_IMPLICIT, "RK4")
"""The engine's integrators: the semi-implicit ones agree if nothing damps, touches or tumbles."""

_SLIDE = '<joint type="slide" axis="{}"/>'
JOINTS = {
    "free": '<freejoint name="free"/>',
    "slides and ball": "".join(map(_SLIDE.format, ("1 0 0", "0 1 0", "0 0 1"))) + '<joint type="ball"/>',
    "z alone": _SLIDE.format("0 0 1"),
}
"""Joints of the flotor."""

_MODEL = """
<mujoco>
  <option integrator="{integrator}" timestep="{step!r}" gravity="0 0 {gravity!r}">
    <flag contact="disable" constraint="disable" autoreset="disable" sensor="disable" spring="disable"
      damper="disable" island="disable" midphase="disable" warmstart="disable" actuation="{actuation}"/>
  </option>
  <worldbody>
    <body>
      <inertial pos="0 0 0" mass="{mass!r}" diaginertia="{inertia}"/>
      {joints}
    </body>
  </worldbody>
  <actuator>{actuators}</actuator>
</mujoco>
"""


class Flotor:
    """The flotor, a body with nothing to collide with.

    Attributes:
        data: The engine's state.
        options: Options of the model.
        step: Takes a step, or as many as it is told.
        push: Sets the wrench on the flotor, in world axes, six numbers.
        control: Sets the controls of the actuators.
        position: Reads the generalised position.
        velocity: Reads the generalised velocity: that of a turning body in its own axes.
        acceleration: Reads the generalised acceleration in the last step.
        put: Sets the generalised position.
        pose: Reads the pose [m, rad].

    Args:
        task: The task.
        integrator: One of INTEGRATORS.
        step: Time step at the start [s].
        joints: One of JOINTS.
        actuation: Whether actuators and the control callback work.
        actuators: MJCF elements.
    """

    def __init__(
        self,
        task: Task,
        integrator: str,
        step: float = 1e-3,
        joints: str = "free",
        *,
        actuation: bool = False,
        actuators: str = "",
    ) -> None:
        text = _MODEL.format(
            integrator=integrator,
            step=step,
            gravity=-task.gravity,
            actuation="enable" if actuation else "disable",
            mass=task.mass,
            inertia=" ".join(map(repr, task.inertia)),
            joints=JOINTS[joints],
            actuators=actuators,
        )
        self._model = model = mujoco.MjModel.from_xml_string(text)
        self.data = data = mujoco.MjData(model)
        self.options = model.opt
        self.step = partial(mujoco.mj_step, model, data)
        # live views of the engine's memory: a slice through `data` at each step costs several times as much
        self.push = partial(struct.Struct("6d").pack_into, data.xfrc_applied[1].data, 0)
        self.control = partial(struct.Struct(f"{model.nu}d").pack_into, data.ctrl.data, 0)
        self.put = partial(struct.Struct(f"{model.nq}d").pack_into, data.qpos.data, 0)
        self.position: Callable[[], list[float]] = data.qpos.tolist
        self.velocity: Callable[[], list[float]] = data.qvel.tolist
        self.acceleration: Callable[[], list[float]] = data.qacc.tolist
        start = task.pose
        self.pose = partial(_height_among, start, self.position) if model.nq == 1 else partial(_pose, self.position)
        self._start = start[2:3] if model.nq == 1 else start[:3] + quaternion(start[3:])

    def reset(self) -> None:
        """Return the flotor to its start, at rest, without wrench."""
        mujoco.mj_resetData(self._model, self.data)
        self.put(*self._start)


def _pose(position: Callable[[], list[float]]) -> list[float]:
    x, y, z, qw, qx, qy, qz = position()
    return [x, y, z, *rotation_vector(qw, qx, qy, qz)]


def _height_among(start: list[float], position: Callable[[], list[float]]) -> list[float]:
    """Return the height among the six start coordinates."""
    x, y, _, rx, ry, rz = start
    return [x, y, position()[0], rx, ry, rz]


def turned_back(
    qw: float, qx: float, qy: float, qz: float, x: float, y: float, z: float
) -> tuple[float, float, float, float]:
    """Return a quaternion turned back by a small rotation vector.

    [rad], in the axes of the body.
    """
    square = x * x + y * y + z * z
    w = 1.0 - 0.125 * square  # to the fourth order of the angle, far below rounding here
    scale = square / 48.0 - 0.5
    x, y, z = scale * x, scale * y, scale * z
    return (
        qw * w - qx * x - qy * y - qz * z,
        qw * x + qx * w + qy * z - qz * y,
        qw * y - qx * z + qy * w + qz * x,
        qw * z + qx * y - qy * x + qz * w,
    )
