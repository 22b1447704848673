"""What the parts of `sim_learn` share.

Standard input: {"examples": folder, "scenes": {name: scene}, "seed": n, ...} with numbers of the part.
Standard output: {"rows": [{"scene": name, ...}], "packages": {name: version}}.
"""

import contextlib
import importlib
import importlib.metadata
import json
import sys

import paws_sim

# Goals that no training has seen.
GOAL_SEED = 1
# Other goals, by which no setting of the example was chosen.
HELD_BACK_GOAL_SEED = 20_261_129
PACKAGES = ("gymnasium", "numpy", "stable-baselines3", "rsl-rl-lib", "torch")


def load(folder, name):
    """An example of the package. It imports others of its folder."""
    if folder not in sys.path:
        sys.path.insert(0, folder)
    return importlib.import_module(name)


def config(settings, **task):
    """Settings of an example, with others of the task."""
    return paws_sim.simulator.merge_settings(settings, {"task": {"min_detour": 1.1, **task}})


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
