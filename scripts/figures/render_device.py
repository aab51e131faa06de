"""A picture of the device, as the README shows it.

MuJoCo draws with the library that MUJOCO_GL names, by default with the first that works.
"""

import os
import sys
from pathlib import Path

from maglev_mj.views.window.backend import drawing_library

os.environ["MUJOCO_GL"] = drawing_library()

import mujoco
import numpy as np
from matplotlib.image import imsave

from maglev_mj.plants.model import model_path

target = Path(sys.argv[1] if len(sys.argv) > 1 else "figures/device.png")
width, height = map(int, sys.argv[2].split("x")) if len(sys.argv) > 2 else (1400, 1050)
target.parent.mkdir(parents=True, exist_ok=True)

model = mujoco.MjModel.from_xml_path(str(model_path("scene")))
model.vis.quality.shadowsize = 8192  # smooth edges
model.vis.global_.offwidth, model.vis.global_.offheight = 2 * width, 2 * height
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)

camera = mujoco.MjvCamera()
mujoco.mjv_defaultFreeCamera(model, camera)
camera.lookat[:] = 0.0, 0.0, 0.012
camera.distance, camera.azimuth, camera.elevation = 0.26, 205.0, -22.0

with mujoco.Renderer(model, 2 * height, 2 * width) as renderer:
    renderer.update_scene(data, camera)
    fine = renderer.render()
image = fine.reshape(height, 2, width, 2, 3).mean(axis=(1, 3)).round().astype(np.uint8)

imsave(target, image)
print("wrote", target)
