"""The task of the examples: reach goals at 1 to 5 m within 20 s. Its settings, and the exam."""

import numpy as np
import paws_sim
from gymnasium.vector import AutoresetMode

# Few goals are learned by heart: the policy then fails on others.
CONFIG = {
    "task": {"goal_distance_m": [1.0, 5.0], "goals": 256},
    "end": {"time_limit_s": 20.0, "unknown_ground_ends": False, "left_map_ends": False},
}


def random_actions(seed: int = 0, components: int = 2):
    """A policy of random actions, for comparison."""
    generator = np.random.default_rng(seed)

    def act(observations):
        n = len(observations["state"] if isinstance(observations, dict) else observations)
        return generator.uniform(-1, 1, (n, components))

    return act


def evaluate(
    scene, config, act, episodes: int, goal_seed: int, environments: int = 50, **arguments
) -> dict:
    """Success, SPL, ends and the return of each episode, with goals of another seed. The other
    arguments are those of `WalkVectorEnv`."""
    environments = min(environments, episodes)
    config = {**config, "task": {**config["task"], "goal_seed": goal_seed, "goals": episodes}}
    envs = paws_sim.make_vec(
        scene,
        environments,
        config=config,
        autoreset_mode=AutoresetMode.SAME_STEP,
        **arguments,
    )
    observations, _ = envs.reset(seed=1_000_000)
    # A fixed number per environment: fast ones must not be counted more often.
    left = np.full(environments, episodes // environments)
    results, returns, sums = [], [], np.zeros(environments)
    while left.any():
        observations, rewards, terminated, truncated, info = envs.step(act(observations))
        sums += rewards
        for index in np.flatnonzero(terminated | truncated):
            if left[index] > 0:
                left[index] -= 1
                final = info["final_info"]
                results.append([final[k][index] for k in ("is_success", "spl", "end_reason")])
                returns.append(float(sums[index]))
            sums[index] = 0.0
    envs.close()
    success, spl, reasons = np.array(results, float).T
    names, counts = np.unique(reasons.astype(int), return_counts=True)
    return {
        "success": float(success.mean()),
        "spl": float(spl.mean()),
        "returns": returns,
        "ends": {paws_sim.EndReason(n).name: int(c) for n, c in zip(names, counts)},
    }


def summary(result: dict) -> dict:
    """A result with the mean of its returns."""
    return {**result, "returns": float(np.mean(result["returns"]))}
