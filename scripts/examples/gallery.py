"""Charts of the examples for the gallery."""

import gymnasium
import numpy as np

from gym_environment import AXES, ENVIRONMENT, spring_and_damper
from maglev_mj import Timing, run, run_phases
from maglev_mj.cli.output import script_options
from maglev_mj.pictures import ChartPanel, broken, small_multiples
from maglev_mj.scenes.drop import Drop
from maglev_mj.spec import RANGE
from own_law import Button, press
from own_sensor import AveragedDrop

pictures = script_options(__doc__).pictures

depth, force = press(Button(axes="z", stiffness=3000.0), Timing(period=0.001, delay=0.0005))
deepest = int(depth.argmax())
strokes = [("pressed", slice(0, deepest + 1)), ("released", slice(deepest, None))]
button = [(name, 1e3 * depth[part], force[part]) for name, part in strokes]

falls = []
for count in (1, 2, 3):
    result = run(AveragedDrop(count=count, duration=0.2), plant="exact")
    time = result.times(0.0005)
    heights = 1e3 * result.motion(time)[0]
    inside = np.logical_and.accumulate(np.abs(heights) <= 1e3 * RANGE[2])
    name = f"mean of {count}{'' if inside.all() else ' (leaves)'}"
    falls.append((name, time[inside], heights[inside]))

phases = np.arange(100) / 100
depths = []
for name, scene in {"pulse": Drop(), "no pulse": Drop(pulse=0.0)}.items():
    penetration = run_phases(scene, phases, plant="exact").figures["penetration"]
    at, values = broken(phases, 1e3 * penetration[:, None])
    depths.append((name, at, values[:, 0]))

env = gymnasium.make(ENVIRONMENT, axes=AXES)
observation = env.reset(seed=9)[0]
observations = [observation]
for _ in range(200):
    observation = env.step(spring_and_damper(observation))[0]
    observations.append(observation)
heights, _, targets = 1e3 * np.array(observations).T
times = np.arange(len(observations)) * Timing().period
episode = [("flotor", times, heights), ("target", times, targets)]

panels = [
    ChartPanel(title="own_law: a button that clicks", labels=("depth (mm)", "force (N)"), curves=button),
    ChartPanel(title="own_sensor: averaging adds delay", labels=("time (s)", "height (mm)"), curves=falls, level=0.0),
    ChartPanel(title="phases: depth of 100 drops", labels=("sampling phase", "depth (mm)"), curves=depths),
    ChartPanel(title="gym_environment: PD, constant disturbance", labels=("time (s)", "height (mm)"), curves=episode),
]
pulsed, plain = (np.nanmedian(values) for _, _, values in depths)
head = (
    f"A braking pulse makes the median drop {pulsed:.2f} mm deep instead of {plain:.2f} mm",
    "bottom left; each panel: an example of scripts/examples",
)
print("wrote", small_multiples(head, panels, pictures.path("gallery")))
