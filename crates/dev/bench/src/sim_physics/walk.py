"""Robots that walk courses: JSON on standard input, JSON on standard output.

`{"modules": FOLDER, "jobs": [{"model": FOLDER, "course": {...}, "seeds": N}]}` gives runs for each
job; a job with `step_m` instead of a model has one step of that height on a plane.
"""

import json
import math
import os
import sys

import numpy as np

FALL, TIME = "fall", "time"
# The robot gets twice as long as its command needs.
PATIENCE = 2.0


def courses(job):
    if "step_m" not in job:
        return mujoco_scene.scene_spec(job["model"]), job["course"]
    scene = mujoco.MjSpec()
    bits = mujoco_scene.FINE_BIT | mujoco_scene.COARSE_BIT
    scene.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.05], contype=bits, conaffinity=0
    )
    half = 0.5 * job["step_m"]
    scene.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[5.0, 5.0, half],
        pos=[1.5 + 5.0, 0.0, half],
        contype=bits,
        conaffinity=0,
    )
    return scene, {"start": [0.0, 0.0, 0.0], "heading_rad": 0.0, "length_m": 5.0}


def run(job):
    scene, course = courses(job)
    seeds, heading = job["seeds"], course["heading_rad"]
    walkers = go2.Go2Walkers(scene, seeds, threads=os.cpu_count() or 1)
    start = np.array(course["start"])
    ahead = np.array([math.cos(heading), math.sin(heading)])
    left = np.array([-ahead[1], ahead[0]])
    speeds = np.empty(seeds)
    for seed in range(seeds):
        random = np.random.default_rng(seed)
        x, y = start[:2] + random.uniform(-0.05, 0.05, 2)
        walkers.reset(seed, x, y, heading + math.radians(random.uniform(-5, 5)), start[2] + 0.02)
        speeds[seed] = random.uniform(0.5, 0.7)
    ends = [None] * seeds
    progress = np.zeros(seeds)
    scraped = [False] * seeds
    contacts = [[] for _ in range(seeds)]
    full = 0
    steps = 0
    while not all(ends):
        steps += 1
        commands = np.zeros((seeds, 3))
        for seed in range(seeds):
            position, rotation = walkers.pose(seed)
            away = position[:2] - start[:2]
            yaw = math.atan2(rotation[1, 0], rotation[0, 0])
            error = math.remainder(heading - yaw, math.tau)
            aside = float(away @ left)
            if not ends[seed]:
                progress[seed] = max(progress[seed], float(away @ ahead))
                commands[seed] = [
                    speeds[seed],
                    np.clip(-0.8 * aside, -0.3, 0.3),
                    np.clip(2.0 * error, -1.0, 1.0),
                ]
        walkers.step(commands)
        for seed in range(seeds):
            if ends[seed]:
                continue
            found = walkers.scene.foot_contacts(seed)
            full += found.full_pairs
            contacts[seed] += [[round(float(v), 5) for v in row[1:4]] for row in found.single]
            scraped[seed] |= walkers.trunk_touches(seed)
            if walkers.has_fallen(seed):
                ends[seed] = FALL
            elif progress[seed] >= course["length_m"]:
                ends[seed] = "goal"
            elif steps * go2.CONTROL_S > PATIENCE * course["length_m"] / speeds[seed]:
                ends[seed] = TIME
    walkers.scene.close()
    return {
        "ends": ends,
        "progress_m": [round(float(v), 3) for v in progress],
        "contacts": contacts,
        "scraped": sum(scraped) / seeds,
        "full_pairs": full,
        "geoms": int(walkers.scene.model.ngeom),
    }


question = json.load(sys.stdin)
sys.path.insert(0, question["modules"])
from physics import go2, mujoco_scene  # noqa: E402
from physics.mujoco_scene import mujoco  # noqa: E402

answer = {"mujoco": mujoco.__version__, "jobs": [run(job) for job in question["jobs"]]}
json.dump(answer, sys.stdout)
