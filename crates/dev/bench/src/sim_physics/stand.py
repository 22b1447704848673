"""The Go2 that stands: JSON on standard input, JSON on standard output.

`{"modules": FOLDER, "jobs": [{"model": FOLDER or null, "at": [x, y], "ground_m": Z}]}` gives height
and tilt at rest for each job; without a model it stands on a plane of MuJoCo.
"""

import json
import math
import sys

import numpy as np

DURATION_S = 4.0
DROP_M = 0.02
# Over the last second nothing moves by more.
STILL_M = 1e-3


def run(job):
    if job["model"] is None:
        scene = mujoco.MjSpec()
        bits = mujoco_scene.FINE_BIT | mujoco_scene.COARSE_BIT
        plane = mujoco.mjtGeom.mjGEOM_PLANE
        scene.worldbody.add_geom(type=plane, size=[0, 0, 0.05], contype=bits, conaffinity=0)
    else:
        scene = mujoco_scene.scene_spec(job["model"])
    robot = go2.Go2Walkers(scene, 1)
    ground = job["ground_m"]
    robot.reset(0, *job["at"], 0.0, ground + DROP_M)
    heights = []
    for _ in range(round(DURATION_S / go2.CONTROL_S)):
        robot.stand()
        heights.append(float(robot.pose(0)[0][2]))
    position, rotation = robot.pose(0)
    model, data = robot.scene.model, robot.scene.data[0]
    feet = [model.geom(name).id for name in robot.scene.feet]
    soles = [1e3 * float(data.geom_xpos[foot][2] - model.geom_size[foot][0] - ground) for foot in feet]
    contacts = robot.scene.foot_contacts(0)
    found = {
        "trunk_above_ground_mm": 1e3 * (float(position[2]) - ground),
        "tilt_deg": math.degrees(math.acos(min(1.0, float(rotation[2, 2])))),
        "feet_touching": int(np.sum(contacts.is_touching)),
        "soles_above_ground_mm": soles,
        "is_still": max(heights[-50:]) - min(heights[-50:]) < STILL_M,
        "moved_mm": 1e3 * math.dist(position[:2], job["at"]),
    }
    robot.scene.close()
    return found


question = json.load(sys.stdin)
sys.path.insert(0, question["modules"])
from physics import go2, mujoco_scene  # noqa: E402
from physics.mujoco_scene import mujoco  # noqa: E402

json.dump({"mujoco": mujoco.__version__, "jobs": [run(job) for job in question["jobs"]]}, sys.stdout)
