"""Your own MuJoCo robot follows the joystick: `maglev-mj view scripts/examples/teleoperate.py --web`."""

from maglev_mj import run
from maglev_mj.interop.teleoperation import Teleoperation

ROBOT = """<mujoco><option timestep="1e-4" integrator="RK4"/><worldbody>
<geom type="box" size=".1 .1 .02" pos="0 0 -.04" rgba=".7 .75 .8 1"/>
<body gravcomp="1"><geom size=".01" mass="1" rgba=".9 .5 .1 1"/><site name="tool"/>
<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/><joint type="slide" axis="0 0 1"/></body>
</worldbody></mujoco>"""


class Teleoperate(Teleoperation):
    """A hand presses a ball onto a block."""

    robot, site, scale = ROBOT, "tool", 10.0  # or an MJCF file; motion and force scaled by ten


if __name__ == "__main__":
    scene = Teleoperate()
    print("coupling of {:.0f} N/m with {:.1f} N s/m, a quarter of critical stiffness".format(*scene.coupling))
    height, robot = run(scene).trace.pose[-1, 2], scene.follower
    depth, force = robot.data.site_xpos[robot.site][2], robot.data.qfrc_constraint[2]
    print(f"joystick at {1e3 * height:.2f} mm, robot at {1e3 * depth:.2f} mm; the block carries {force:.1f} N")
