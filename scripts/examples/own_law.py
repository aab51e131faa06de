"""Own law: a push button along z that clicks.

Its spring gives way beyond the travel and recovers at half of it. The law remembers on each axis whether it is down.
"""

import numpy as np

import maglev_mj
from maglev_mj import AxisLaw, Controller, ExactPlant, Hold, SpringHand, Timing, Trajectory, drive, gain, judge


class Button(AxisLaw):
    """A button below 0."""

    stiffness: float = gain("stiffness until it clicks", "N/m")
    damping: float = gain("damping", "N s/m", default=20.0)
    travel: float = gain("depth of the click", "m", default=0.0015, above=0.0)
    left: float = gain("share of the stiffness that is left when it is down", default=0.3)

    def force(self, x, v, gains, state):
        """Return the force on one axis [N], and the state."""
        depth = np.maximum(-x, 0.0)
        was_down = False if state is None else state
        down = (depth > gains.travel) | (was_down & (depth > 0.5 * gains.travel))
        spring = gains.stiffness * depth * np.where(down, gains.left, 1.0)
        return np.where(depth > 0.0, spring - gains.damping * v, 0.0), down


def controller_of(button, timing):
    """Return a controller: button along z, other axes held."""
    others = Hold.critically_damped(("x", "y", "rx", "ry", "rz"), period=timing.period, delay=timing.delay)
    return Controller([button, others], period=timing.period)


def press(button, timing):
    """Return depth [m] and force [N] at samples, (2, N).

    A hand presses towards 4 mm and returns.
    """
    path = Trajectory([0.8, 1.6], [[0.0, 0.0, -0.004, 0.0, 0.0, 0.0], [0.0] * 6])
    plant = ExactPlant(timing, gravity=0.0, hand_force=SpringHand(stiffness=2000.0, damping=20.0, target=path))
    rows = []
    note = lambda sample, command: rows.append((-sample.position[2], command.force[2]))  # noqa: E731
    drive(plant, controller_of(button, timing), round(1.6 / timing.period), observe=note)
    return np.array(rows).T


if __name__ == "__main__":
    timing, button = Timing(period=0.001, delay=0.0005), Button(axes="z", stiffness=3000.0)
    maglev_mj.check_law(button)  # equal alone and in a batch, finite, no side effects
    depth, force = press(button, timing)
    step = np.diff(force)
    for word, at in (("pressed: clicks", step.argmin()), ("released: returns", step.argmax())):
        print(f"{word} at {1e3 * depth[at]:.2f} mm, from {force[at]:.1f} to {force[at + 1]:.1f} N")
    print("stable at each depth:", judge(controller_of(button, timing), delay=timing.delay).stable)
