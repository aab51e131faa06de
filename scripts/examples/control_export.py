"""Export to python-control: poles and step response, compared with this package's.

pip install control
"""

import control
import numpy as np

from maglev_mj import Controller, ExactPlant, Hold, Timing, drive, judge, linearise

PERIOD, DELAY = 0.005, 0.0015

spring = Hold(axes="z", stiffness=9000.0, damping=80.0)
others = Hold.critically_damped(("x", "y", "rx", "ry", "rz"), period=PERIOD, delay=DELAY)
controller = Controller([spring, others], period=PERIOD)
(near,) = linearise(controller, [[0.0] * 6])
loop = near.closed_loop(delay=DELAY, axes="z").to_statespace()  # from a hand's force [N] to the position [m]

print(f"slowest pole: {np.abs(control.poles(loop)).max():.9f} (python-control)")
print(f"              {judge(controller, delay=DELAY).spectral_radius:.9f} (maglev_mj)")

# The hand pushes with 1 N from the first sample on.
response = control.step_response(loop, T=np.arange(60) * PERIOD)
plant = ExactPlant(
    Timing(period=PERIOD, delay=DELAY), gravity=0.0, hand_force=lambda *_: [0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
)
heights = []
drive(plant, controller, 60, observe=lambda sample, _: heights.append(sample.position[2]))
error = np.abs(response.outputs - heights).max()
print(f"deflection at the end: {response.outputs[-1] * 1e6:.2f} µm (python-control)")
print(f"                       {heights[-1] * 1e6:.2f} µm (simulated)")
print(f"all samples within a picometre: {error < 1e-12}")
