"""Your own MuJoCo robot follows the joystick: `maglev-mj view scripts/examples/teleoperate.py --web`."""

import mujoco
import numpy as np

from maglev_mj import AXES, Bias, Hold, Law, Scene, largest_stable_stiffness, param, run
from maglev_mj.spec import GRAVITY

ROBOT = mujoco.MjModel.from_xml_string("""<mujoco><option timestep="1e-4" integrator="RK4"><flag warmstart="disable"/>
</option><worldbody><geom type="box" size=".1 .1 .02" pos="0 0 -.04"/><body gravcomp="1"><geom size=".01" mass="1"/>
<joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/><joint name="z" type="slide"/>
</body></worldbody><actuator><motor joint="x"/><motor joint="y"/><motor joint="z"/></actuator></mujoco>""")
DATA, SCALE = mujoco.MjData(ROBOT), 10.0  # motion and force scaled by ten
MASS, REDUCED = 0.7, 0.7 / (1.0 + 0.7 / 1.0)  # of the joystick, and reduced mass of both [kg]


class Coupling(Law):
    """A spring and a damper that pull both; its state: the robot's position and velocity, last extension and force."""

    def __init__(self, scene):
        self.scene = scene

    def __call__(self, position, velocity, state, wrench):
        """Return the wrench, and simulate the robot to the next sample; the force acts on both after the delay."""
        DATA.qpos, DATA.qvel, last, held = np.zeros((4, 3)) if state is None else state
        scene, stretch = self.scene, np.array(position[:3]) - DATA.qpos / SCALE
        force = scene.stiffness * stretch + scene.damping * (stretch - last) / scene.period
        for acting, seconds in ((held, scene.delay), (force, scene.period - scene.delay)):
            DATA.ctrl = SCALE * acting
            mujoco.mj_step(ROBOT, DATA, round(seconds / ROBOT.opt.timestep))
        wrench[:3] = [part - own for part, own in zip(wrench, force.tolist())]
        return np.array([DATA.qpos, DATA.qvel, stretch, force]), None

    def gains(self):
        """Return the gains for the stability check, scaled from the reduced mass to the joystick."""
        stiffness, damping = (MASS / REDUCED * one for one in (self.scene.stiffness, self.scene.damping))
        return Hold(axes=AXES[:3], stiffness=stiffness, damping=damping).gains()


class Teleoperate(Scene):
    """A hand presses the robot onto a block."""

    stiffness: float = param("stiffness of the coupling", "N/m", default=1496.0, above=0.0, at_most=1e6, live=True)
    damping: float = param("damping of the coupling", "N s/m", default=25.8, at_least=0.0, at_most=1e4, live=True)

    def laws(self):
        """Return the coupling, the weight, and a hold of the rotations."""
        hold = Hold.critically_damped(AXES[3:], period=self.period, delay=self.delay)
        return [Coupling(self), Bias([0.0, 0.0, GRAVITY * MASS, 0.0, 0.0, 0.0]), hold]

    def scripted_hand(self, phase=0.0):
        """Return a hand that pushes down, by 3 N within half a second."""
        return lambda tick, time, state: [0.0, 0.0, -3.0 * min(2.0 * time, 1.0), 0.0, 0.0, 0.0]


if __name__ == "__main__":
    limit, damping, _ = largest_stable_stiffness(period=0.005, delay=0.0015, mass=REDUCED)
    print(f"stiffest stable coupling of two free bodies: {limit:.0f} N/m, with {damping:.1f} N s/m")
    height, force = run(Teleoperate()).trace.pose[-1, 2], DATA.qfrc_constraint[2]
    print(f"joystick at {1e3 * height:.2f} mm, robot at {1e3 * DATA.qpos[2]:.2f} mm; the block carries {force:.1f} N")
