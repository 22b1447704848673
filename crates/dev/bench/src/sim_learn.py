"""Trains agents with the example of the Python package and counts successes on unseen goals.

Standard input: {"example": path, "scenes": {name: scene}, "steps": n, "seed": n, "goals": n,
"environments": n, "measured_steps": n}. Standard output: rows of learning per scene, speed of
`VectorEnv.step` per scene.
"""

import contextlib
import importlib.util
import json
import sys
import time

import numpy as np
import paws_sim

MIN_DETOUR = 1.1


def load(path):
    spec = importlib.util.spec_from_file_location("train_point_goal", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def learn(example, scene, question):
    config = paws_sim.simulator.merged(
        example.CONFIG, {"task": {"min_detour": MIN_DETOUR}}
    )
    generator = np.random.default_rng(0)
    goals = {"episodes": question["goals"], "goal_seed": 1}
    random = example.evaluate(
        scene, config, lambda o: generator.uniform(-1, 1, (len(o), 2)), **goals
    )
    curves, times = [], []
    for _ in range(2):
        wall, cpu = time.perf_counter(), time.process_time()
        model, curve = example.train(
            scene, config, steps=question["steps"], seed=question["seed"]
        )
        times.append({"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu})
        curves.append(curve)
    trained = example.evaluate(
        scene, config, lambda o: model.predict(o, deterministic=True)[0], **goals
    )
    return {
        "random": random,
        "trained": trained,
        "curve": curves[0],
        "same_seed_same_curve": curves[0] == curves[1],
        "times": times,
        "steps": question["steps"],
    }


def speed(scene, question):
    """Steps of all environments together per second, with resets."""
    n = question["environments"]
    # Short episodes: at least 1 % of the steps reset.
    config = {"end": {"time_limit_s": 9.0}}
    envs = paws_sim.make_vec(scene, n, config=config)
    envs.reset(seed=0)
    envs.action_space.seed(0)
    actions = [envs.action_space.sample() for _ in range(16)]
    for k in range(100):
        envs.step(actions[k % 16])
    took, ends = [], 0
    cpu = time.process_time()
    for k in range(question["measured_steps"]):
        start = time.perf_counter()
        _, _, terminated, truncated, _ = envs.step(actions[k % 16])
        took.append(time.perf_counter() - start)
        ends += int((terminated | truncated).sum())
    cpu = time.process_time() - cpu
    envs.close()
    steps = n * len(took)
    return {
        "environments": n,
        "steps_per_s": steps / sum(took),
        "steps_per_cpu_s": steps / cpu,
        "resets_per_step": ends / steps,
        "step_ms": dict(zip(("p50", "p95", "p99"), 1e3 * np.quantile(took, [0.5, 0.95, 0.99]))),
    }


def main():
    question = json.load(sys.stdin)
    rows = []
    # Standard output is the answer's.
    with contextlib.redirect_stdout(sys.stderr):
        example = load(question["example"])
        for name, path in question["scenes"].items():
            scene = paws_sim.open_scene(path)
            row = {"scene": name, "speed": speed(scene, question)}
            print(row, flush=True)
            if question["steps"]:
                row["learning"] = learn(example, scene, question)
                print(row, flush=True)
            rows.append(row)
    json.dump({"rows": rows, "version": paws_sim.__version__}, sys.stdout, default=float)


main()
