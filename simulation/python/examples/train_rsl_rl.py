"""Trains an agent to reach goals, with PPO of RSL-RL from its state alone.

    python3 -m venv sim
    sim/bin/pip install "$(ls target/wheels/paws_sim-*.whl)[rsl-rl]"
    sim/bin/python simulation/python/examples/train_rsl_rl.py target/demo/walk.scene

The policy is written to `point_goal_rsl_rl.pt`.
"""

import argparse
import time

import paws_sim
import torch
from paws_sim.rsl_rl import VecEnv
from point_goal import CONFIG, evaluate, random_actions, summary
from rsl_rl.runners import OnPolicyRunner
from tensordict import TensorDict

ENVIRONMENTS = 64
ROLLOUT = 32


def settings() -> dict:
    """Settings of the runner, which changes them."""
    mlp = {
        "class_name": "MLPModel",
        "hidden_dims": [64, 64],
        "activation": "elu",
        "obs_normalization": True,
    }
    distribution = {"class_name": "GaussianDistribution", "init_std": 0.6}
    return {
        "num_steps_per_env": ROLLOUT,
        "save_interval": 50,
        # A state vector is the group `policy`; of a dictionary each part is a group of its name.
        "obs_groups": {"actor": ["policy"], "critic": ["policy"]},
        "algorithm": {
            "class_name": "PPO",
            "num_learning_epochs": 5,
            "num_mini_batches": 4,
            "gamma": 0.98,
            "lam": 0.95,
            "entropy_coef": 0.0,
            "learning_rate": 5e-4,
        },
        "actor": {**mlp, "distribution_cfg": distribution},
        "critic": mlp,
    }


def train(scene, config=CONFIG, steps: int = 100_000, seed: int = 0, log_dir=None):
    """The runner after the training. Its log has the share of episodes that ended at the goal as
    `is_success`."""
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    envs = VecEnv(scene, ENVIRONMENTS, config=config, seed=seed)
    runner = OnPolicyRunner(envs, settings(), log_dir=log_dir, device="cpu")
    iterations = max(1, steps // (ROLLOUT * ENVIRONMENTS))
    runner.learn(iterations, init_at_random_ep_len=True)
    envs.close()
    return runner


def actions_of(policy):
    """A policy as `evaluate` calls it: NumPy arrays in and out."""

    def act(observations):
        group = {"policy": torch.as_tensor(observations)}
        with torch.inference_mode():
            return policy(TensorDict(group, batch_size=[len(observations)])).numpy()

    return act


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene")
    parser.add_argument("--steps", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--log", help="a folder for TensorBoard's logs and for checkpoints")
    arguments = parser.parse_args()
    scene = paws_sim.open_scene(arguments.scene)
    random = evaluate(scene, CONFIG, random_actions(), episodes=200, goal_seed=1)
    print("random:", summary(random))
    start = time.perf_counter()
    runner = train(scene, steps=arguments.steps, seed=arguments.seed, log_dir=arguments.log)
    print(f"trained for {time.perf_counter() - start:.0f} s")
    act = actions_of(runner.get_inference_policy())
    print("trained:", summary(evaluate(scene, CONFIG, act, episodes=200, goal_seed=1)))
    runner.save("point_goal_rsl_rl.pt")


if __name__ == "__main__":
    main()
