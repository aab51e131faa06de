"""Own scene: detents along x, with their own law.

maglev-mj run scripts/examples/detents.py --stiffness 3000 --out figures
maglev-mj view scripts/examples/detents.py --web
"""

import numpy as np

from maglev_mj import AXES, AxisLaw, Hold, Scene, Start, gain, param, run


class Detent(AxisLaw):
    """Detents as a sine of the position, with damping."""

    pitch: float = gain("distance between detents", "m", above=0.0)
    stiffness: float = gain("stiffness at the bottom of one", "N/m")
    damping: float = gain("damping", "N s/m")

    def force(self, x, v, gains, state):
        """Return the force on one axis."""
        turn = 2.0 * np.pi / gains.pitch
        return -gains.stiffness / turn * np.sin(turn * x) - gains.damping * v


class Detents(Scene):
    """Release the flotor beside a detent."""

    shown_axis = "x"
    figures = ("final_position", "peak_speed", "ripple")

    pitch: float = param("distance between detents", "m", default=0.002, above=1e-5, at_most=0.01)
    stiffness: float = param("stiffness at the bottom", "N/m", default=4000.0, at_least=0.0, at_most=1e6, live=True)
    damping: float = param("damping", "N s/m", default=50.0, at_least=0.0, at_most=1e4, live=True)
    away: float = param("distance from the bottom at release", "m", default=2e-4, at_least=-0.004, at_most=0.004)
    duration: float = param("simulated time", "s", default=0.5, above=0.0, at_most=100.0)

    def laws(self):
        """Return the detents, and a hold of the other axes."""
        detent = Detent(axes="x", pitch=self.pitch, stiffness=self.stiffness, damping=self.damping)
        return [detent, Hold.critically_damped(AXES[1:], period=self.period, delay=self.delay)]

    def start(self):
        """Return the state beside the detent, the weight carried."""
        return Start(pose=(self.away, 0.0, 0.0, 0.0, 0.0, 0.0), gravity=0.0)


if __name__ == "__main__":
    for away in (0.0002, 0.0009, 0.0011):
        end = run(Detents(away=away)).figures["final_position"]
        print(f"released at {1e3 * away:.1f} mm, rests at {1e3 * abs(end):.2f} mm")
