"""Bodies that fall on exported ground in MuJoCo: JSON on standard input, JSON on standard output.

`{"jobs": [{"model": FOLDER, "shapes": [...], "mass_kg": M, "position_m": [x, y, z], "velocity_m_s":
[x, y, z], "step_s": DT, "duration_s": T, "friction": F}]}` gives the last pose and the least height
for each job.
"""

import json
import math
import sys
import time
from pathlib import Path

import mujoco
import numpy as np

TYPES = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "ball": mujoco.mjtGeom.mjGEOM_SPHERE,
    # Radius, and half of the length of its cylinder, which is along x.
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
}
# Rotates z to x.
ALONG_X = [math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0]


def volume_m3(shape):
    size = shape["size_m"]
    if shape["type"] == "box":
        return 8 * math.prod(size)
    ball = 4 / 3 * math.pi * size[0] ** 3
    return ball if shape["type"] == "ball" else ball + 2 * math.pi * size[0] ** 2 * size[1]


def model(job):
    spec = mujoco.MjSpec.from_file(str(Path(job["model"]) / "model.xml"))
    spec.option.timestep = job["step_s"]
    friction = [job["friction"], 0.005, 0.0001]
    for geom in spec.worldbody.geoms:
        geom.friction = friction
    body = spec.worldbody.add_body(name="body")
    body.add_freejoint()
    total = sum(volume_m3(shape) for shape in job["shapes"])
    for shape in job["shapes"]:
        body.add_geom(
            type=TYPES[shape["type"]],
            size=(shape["size_m"] + [0, 0])[:3],
            pos=shape["position_m"],
            quat=ALONG_X if shape["type"] == "capsule" else [1, 0, 0, 0],
            mass=job["mass_kg"] * volume_m3(shape) / total,
            friction=friction,
        )
    return spec.compile()


def run(job):
    compiled = model(job)
    data = mujoco.MjData(compiled)
    data.qpos[:] = job["position_m"] + [1, 0, 0, 0]
    data.qvel[:3] = job["velocity_m_s"]
    steps = round(job["duration_s"] / job["step_s"])
    lowest = math.inf
    for _ in range(steps):
        mujoco.mj_step(compiled, data)
        lowest = min(lowest, data.qpos[2])
    # The same again in one call, without Python in between.
    again = mujoco.MjData(compiled)
    again.qpos[:] = job["position_m"] + [1, 0, 0, 0]
    again.qvel[:3] = job["velocity_m_s"]
    before = time.process_time()
    mujoco.mj_step(compiled, again, steps)
    took = time.process_time() - before
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, data.qpos[3:7])
    return {
        "position_m": [float(v) for v in data.qpos[:3]],
        "up": [float(v) for v in rotation.reshape(3, 3)[:, 2]],
        "lowest_m": float(lowest),
        "cpu_us_per_step": 1e6 * took / steps,
    }


question = json.load(sys.stdin)
json.dump({"mujoco": mujoco.__version__, "jobs": [run(job) for job in question["jobs"]]}, sys.stdout)
