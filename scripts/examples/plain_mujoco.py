"""Render a wall in plain MuJoCo, without this package; `--view` opens MuJoCo's viewer, whose mouse forces act."""

import sys

import mujoco
import mujoco.viewer
import numpy as np

PERIOD, DELAY, PULSE_WIDTH, LIMIT = 0.005, 0.0015, 0.003, 60.0  # s, s, s, N
STIFFNESS = np.array([1000.0, 1000.0, 6000.0, 1.4, 1.4, 1.2])  # x, y, z: N/m; rx, ry, rz: N m/rad
DAMPING, PULSE = np.array([50.0, 50.0, 80.0, 0.07, 0.07, 0.06]), 220.0  # N s/m, N m s/rad


class Controller:
    """Render a PD wall at z <= 0 with a braking pulse on the first sample inside; hold the other axes at 0."""

    def __init__(self, model: mujoco.MjModel) -> None:
        data, coils = mujoco.MjData(model), np.zeros((model.nu, model.nv))
        mujoco.mj_forward(model, data)
        mujoco.mju_sparse2dense(coils, data.actuator_moment, data.moment_rownnz, data.moment_rowadr, data.moment_colind)
        self.currents = np.linalg.inv(coils.T * model.actuator_gainprm[:, 0])  # A per N and N m
        self.pose, self.tick, self.time = np.zeros(6), 0, 0.0
        self.switches: list[tuple[float, np.ndarray]] = []

    def __call__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Sample at each period, and set the currents when a command takes effect."""
        if data.time == 0.0:  # the start, or a reset by the viewer
            self.tick, self.switches = 0, []
        # RK4 also calls at inner stages; a step begins at the time of the last stage of the previous one
        begins, self.time = data.time in (0.0, self.time), data.time
        if begins and data.time > self.tick * PERIOD - 1e-9:
            self._sample(np.append(data.sensor("position").data, 2.0 * data.sensor("orientation").data[1:]), data.time)
        while begins and self.switches and data.time > self.switches[0][0] - 1e-9:
            data.ctrl = self.currents @ self.switches.pop(0)[1].clip(-LIMIT, LIMIT)

    def _sample(self, pose: np.ndarray, time: float) -> None:
        last, self.pose = self.pose if self.tick else pose, pose
        velocity, self.tick = (pose - last) / PERIOD, self.tick + 1
        wrench = -STIFFNESS * pose - DAMPING * velocity
        wrench[2] *= pose[2] <= 0.0
        if last[2] > 0.0 >= pose[2]:
            braking = wrench.copy()
            braking[2] = -(PULSE + DAMPING[2]) * velocity[2]
            self.switches = [(time + DELAY, braking), (time + DELAY + PULSE_WIDTH, wrench)]
        else:
            self.switches = [(time + DELAY, wrench)]


if __name__ == "__main__":
    model = mujoco.MjModel.from_xml_path("model/scene.xml")
    data = mujoco.MjData(model)
    data.joint("z").qpos = model.joint("z").range[1]
    mujoco.set_mjcb_control(Controller(model))
    if "--view" in sys.argv:
        mujoco.viewer.launch(model, data)
    low = np.inf
    while data.time < 0.4 and not any(data.warning.number):  # a model that diverges starts again by itself
        mujoco.mj_step(model, data)
        low = min(low, data.qpos[2])
    print("diverged" if any(data.warning.number) else f"lowest {1e3 * low:.2f} mm, at rest {1e3 * data.qpos[2]:.2f} mm")
