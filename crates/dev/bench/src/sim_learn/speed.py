"""Steps of all environments together per second through `VectorEnv.step`, with resets."""

import time

import common
import numpy as np
import paws_sim


def speed(scene, question):
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


common.answer(speed)
