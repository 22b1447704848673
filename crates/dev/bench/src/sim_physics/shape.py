"""Heights of an exported collision shape in MuJoCo: JSON on standard input and standard output.

`{"modules": FOLDER, "model": FOLDER, "from": [[x, y, z], ...]}` gives the height of what a foot
touches first below each point, null for nothing.
"""

import json
import sys

import numpy as np

question = json.load(sys.stdin)
sys.path.insert(0, question["modules"])
from physics import mujoco_scene  # noqa: E402
from physics.mujoco_scene import mujoco  # noqa: E402

spec = mujoco_scene.scene_spec(question["model"])
model = spec.compile()
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
# Feet touch parts and fine tiles; the coarse ones are in a group that rays pass.
model.geom_group[:] = np.where(model.geom_contype & mujoco_scene.FINE_BIT, 0, 5)
groups = np.array([1, 0, 0, 0, 0, 0], np.uint8)
down, hit = np.array([0.0, 0.0, -1.0]), np.empty(1, np.int32)
heights = []
for start in question["from"]:
    below = mujoco.mj_ray(model, data, np.array(start, float), down, groups, 1, -1, hit)
    heights.append(None if below < 0 else start[2] - below)
json.dump({"mujoco": mujoco.__version__, "heights": heights}, sys.stdout)
