"""The real trainers through the adapters of the package: Stable-Baselines3 with its own checker of
environments, and RSL-RL's runner, which sets the time in the episode at random at its start."""

import time
import warnings

import common
import numpy as np
import paws_sim
import torch
from paws_sim.rsl_rl import VecEnv
from rsl_rl.runners import OnPolicyRunner
from stable_baselines3.common.env_checker import check_env
from tensordict import TensorDict

ENVIRONMENTS = 64
ROLLOUT = 32


def warnings_of_check(scene):
    """Warnings of the checker of Stable-Baselines3; what it refuses is an exception. It advises
    against depth in metres, as it expects images of 8 bits."""
    found = []
    for arguments in (
        {},
        {"observation": ("rgb", "depth", "state"), "camera": {"width": 48, "height": 36}},
        {"observation": "rgb", "camera": {"timing": "gauss_gym"}, "actions": "discrete"},
    ):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            env = paws_sim.make(scene, **arguments)
            check_env(env)
            env.close()
        found += [str(warning.message) for warning in caught]
    return found


def stable_baselines3(example, scene, config, question):
    model, curve = example.train(scene, config, steps=question["steps"], seed=question["seed"])
    return lambda o: model.predict(o, deterministic=True)[0], {
        "curve": curve,
        "check_env": warnings_of_check(scene),
    }


def settings_of_rsl_rl():
    layers = {"class_name": "MLPModel", "hidden_dims": [64, 64], "activation": "elu"}
    spread = {"class_name": "GaussianDistribution", "init_std": 0.6}
    return {
        "num_steps_per_env": ROLLOUT,
        "save_interval": 10**9,
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
        "actor": {**layers, "obs_normalization": True, "distribution_cfg": spread},
        "critic": {**layers, "obs_normalization": True},
    }


class Counted(VecEnv):
    """Environments that keep the successes of episodes that ended, as the runner's log has them."""

    def __init__(self, *arguments, **named):
        super().__init__(*arguments, **named)
        self.successes = []

    def step(self, actions):
        result = super().step(actions)
        log = result[-1]["log"]
        self.successes += [log["is_success"]] if log else []
        return result


def rsl_rl(example, scene, config, question):
    torch.manual_seed(question["seed"])
    envs = Counted(scene, ENVIRONMENTS, config=config, seed=question["seed"])
    runner = OnPolicyRunner(envs, settings_of_rsl_rl(), log_dir=None, device="cpu")
    curve, losses = [], []
    update = runner.alg.update

    def recorded():
        found = update()
        losses.append(found)
        steps = len(losses) * ROLLOUT * ENVIRONMENTS
        curve.append([steps, float(np.mean(envs.successes or [0.0]))])
        envs.successes = []
        return found

    runner.alg.update = recorded
    iterations = max(1, question["steps"] // (ROLLOUT * ENVIRONMENTS))
    runner.learn(iterations, init_at_random_ep_len=True)
    policy = runner.get_inference_policy()
    envs.close()

    def act(observations):
        group = {"policy": torch.as_tensor(observations)}
        with torch.inference_mode():
            return policy(TensorDict(group, batch_size=[len(observations)])).numpy()

    are_finite = [np.isfinite(float(value)) for found in losses for value in found.values()]
    return act, {"curve": curve, "finite_losses": bool(all(are_finite)), "last_losses": losses[-1]}


def trainers(scene, question):
    torch.set_num_threads(1)
    example = common.load(question["example"])
    config = common.config(example)
    goals = {"episodes": question["goals"], "goal_seed": common.GOAL_SEED}
    random = example.evaluate(scene, config, common.uniform(), **goals)
    found = {}
    for train in (stable_baselines3, rsl_rl):
        wall, cpu = time.perf_counter(), time.process_time()
        act, row = train(example, scene, config, question)
        row["times"] = {
            "wall_s": time.perf_counter() - wall,
            "cpu_s": time.process_time() - cpu,
        }
        row["trained"] = example.evaluate(scene, config, act, **goals)
        del row["trained"]["returns"]
        found[train.__name__] = row
    del random["returns"]
    return {"random": random, **found, "steps": question["steps"]}


common.answer(trainers)
