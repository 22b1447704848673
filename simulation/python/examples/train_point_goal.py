"""Trains an agent to reach goals, with PPO of Stable-Baselines3 from its state alone.

    pip install paws_sim-*.whl stable-baselines3
    python train_point_goal.py walk.scene
"""

import argparse
import time

import numpy as np
import paws_sim
import torch
from gymnasium.vector import AutoresetMode
from paws_sim.sb3 import VecEnv
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

# Few goals are learned by heart: the policy then fails on others.
CONFIG = {
    "task": {"goal_distance_m": [1.0, 5.0], "goals": 256},
    "end": {"time_limit_s": 20.0, "unknown_ground_ends": False, "left_map_ends": False},
}


class Curve(BaseCallback):
    """Success among the episodes of each rollout."""

    def __init__(self):
        super().__init__()
        self.points = []
        self.episodes = []

    def _on_step(self) -> bool:
        ended = [info for info in self.locals["infos"] if "episode" in info]
        self.episodes += [(info["is_success"], info["episode"]["r"]) for info in ended]
        return True

    def _on_rollout_end(self) -> None:
        if self.episodes:
            success, returns = np.mean(np.array(self.episodes, float), axis=0)
            self.points.append([self.num_timesteps, float(success), float(returns)])
        self.episodes = []


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
        "success": success.mean(),
        "spl": spl.mean(),
        "returns": returns,
        "ends": {paws_sim.EndReason(n).name: int(c) for n, c in zip(names, counts)},
    }


def train(scene, config=CONFIG, steps: int = 200_000, seed: int = 0):
    """A trained policy and its learning curve."""
    torch.set_num_threads(1)
    envs = VecEnv(scene, 16, config=config)
    model = PPO(
        "MlpPolicy",
        envs,
        n_steps=256,
        batch_size=512,
        n_epochs=8,
        learning_rate=5e-4,
        gamma=0.98,
        gae_lambda=0.95,
        ent_coef=0.0,
        policy_kwargs={"net_arch": [64, 64], "log_std_init": -0.5},
        seed=seed,
        device="cpu",
    )
    curve = Curve()
    model.learn(steps, callback=curve)
    envs.close()
    return model, curve.points


def summary(result: dict) -> dict:
    """A result with the mean of its returns."""
    return {**result, "returns": np.mean(result["returns"])}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene")
    parser.add_argument("--steps", type=int, default=200_000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    scene = paws_sim.open_scene(arguments.scene)
    generator = np.random.default_rng(0)
    random = evaluate(
        scene, CONFIG, lambda o: generator.uniform(-1, 1, (len(o), 2)), episodes=200, goal_seed=1
    )
    print("random:", summary(random))
    start = time.perf_counter()
    model, curve = train(scene, steps=arguments.steps, seed=arguments.seed)
    print(f"trained for {time.perf_counter() - start:.0f} s")
    for steps, success, returns in curve[:: max(1, len(curve) // 10)]:
        print(f"  {steps:7d} steps: success {success:.2f}, return {returns:6.2f}")
    act = lambda o: model.predict(o, deterministic=True)[0]
    print("trained:", summary(evaluate(scene, CONFIG, act, episodes=200, goal_seed=1)))
    model.save("point_goal")


if __name__ == "__main__":
    main()
