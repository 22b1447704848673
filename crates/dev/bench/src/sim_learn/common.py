"""What the parts of `sim_learn` share.

Standard input: {"example": path, "scenes": {name: scene}, "seed": n, ...} with numbers of the part.
Standard output: {"rows": [{"scene": name, ...}], "packages": {name: version}}.
"""

import contextlib
import importlib.metadata
import importlib.util
import json
import os
import sys

import numpy as np
import paws_sim

# Goals that no training has seen.
GOAL_SEED = 1
# Other goals, by which no setting of the example was chosen.
HELD_BACK_GOAL_SEED = 20_261_129
PACKAGES = ("gymnasium", "numpy", "stable-baselines3", "rsl-rl-lib", "torch")


def load(path):
    """The example as a module. It imports others of its folder."""
    sys.path.insert(0, os.path.dirname(path))
    spec = importlib.util.spec_from_file_location("train_point_goal", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def config(example, **task):
    """Settings of the example, with others of the task."""
    return paws_sim.simulator.merge_settings(example.CONFIG, {"task": {"min_detour": 1.1, **task}})


def uniform(seed=0, components=2):
    """A policy of random actions."""
    generator = np.random.default_rng(seed)

    def act(observations):
        n = len(observations["state"] if isinstance(observations, dict) else observations)
        return generator.uniform(-1, 1, (n, components))

    return act


def version(name):
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def answer(part):
    """Answers with `part(scene, question)` for each scene."""
    question = json.load(sys.stdin)
    rows = []
    # Standard output is the answer's.
    with contextlib.redirect_stdout(sys.stderr):
        for name, path in question["scenes"].items():
            row = {"scene": name, **part(paws_sim.open_scene(path), question)}
            print(row, flush=True)
            rows.append(row)
    packages = {name: version(name) for name in PACKAGES}
    json.dump({"rows": rows, "packages": packages}, sys.stdout, default=float)
