"""A row of detents along x: a scene of one's own, with a law of one's own. Try: maglev-mj run detents.py."""

import numpy as np

from maglev_mj.frames import AXES
from maglev_mj.laws import AxisLaw, Bias, gain
from maglev_mj.parameters import param
from maglev_mj.scenes.bench import hold
from maglev_mj.scenes.parts import WEIGHT
from maglev_mj.scenes.scene import Scene, Start


class Detent(AxisLaw):
    """Sine detents: -stiffness pitch / 2π sin(2π x / pitch) - damping v."""

    pitch: float = gain("distance between detents", "m", above=0.0)
    stiffness: float = gain("stiffness at the bottom of one", "N/m")
    damping: float = gain("damping", "N s/m")

    def force(self, x, v, gains, state):
        """Return the force on one axis."""
        turn = 2.0 * np.pi / gains.pitch
        return -gains.stiffness / turn * np.sin(turn * x) - gains.damping * v


class Detents(Scene):
    """Let the flotor go beside a detent."""

    shown_axis = "x"
    figures = ("final_position", "peak_speed", "ripple")

    pitch: float = param("distance between detents", "m", default=0.002, above=1e-5, at_most=0.01)
    stiffness: float = param("stiffness at the bottom", "N/m", default=4000.0, at_least=0.0, at_most=1e6, live=True)
    damping: float = param("damping", "N s/m", default=50.0, at_least=0.0, at_most=1e4, live=True)
    away: float = param("distance from the bottom at release", "m", default=2e-4, at_least=-0.004, at_most=0.004)
    duration: float = param("simulated time", "s", default=0.5, above=0.0, at_most=100.0)

    def laws(self):
        """Carry the flotor, give the detents, hold the other axes."""
        detent = Detent(axes="x", pitch=self.pitch, stiffness=self.stiffness, damping=self.damping)
        return [Bias(WEIGHT), detent, hold(self, AXES[1:])]

    def start(self):
        """Rest beside the detent."""
        return Start(pose=(self.away, 0.0, 0.0, 0.0, 0.0, 0.0), wrench=WEIGHT)
