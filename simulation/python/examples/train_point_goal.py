"""Trains an agent to reach goals, with PPO of Stable-Baselines3 from its state alone.

    python3 -m venv sim
    sim/bin/pip install "$(ls target/wheels/paws_sim-*.whl)[sb3]"
    sim/bin/python simulation/python/examples/train_point_goal.py target/demo/walk.scene

The policy is written to `point_goal.zip`.
"""

import argparse
import time

import numpy as np
import paws_sim
import torch
from paws_sim.sb3 import VecEnv
from point_goal import CONFIG, evaluate, random_actions, summary
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback


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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene")
    parser.add_argument("--steps", type=int, default=200_000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    scene = paws_sim.open_scene(arguments.scene)
    random = evaluate(scene, CONFIG, random_actions(), episodes=200, goal_seed=1)
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
