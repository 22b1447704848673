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


def stable_baselines3(scene, config, question):
    example = common.load(question["examples"], "train_point_goal")
    model, curve = example.train(scene, config, steps=question["steps"], seed=question["seed"])
    return lambda o: model.predict(o, deterministic=True)[0], {
        "curve": curve,
        "check_env": warnings_of_check(scene),
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


def rsl_rl(scene, config, question):
    example = common.load(question["examples"], "train_rsl_rl")
    torch.manual_seed(question["seed"])
    envs = Counted(scene, example.ENVIRONMENTS, config=config, seed=question["seed"])
    runner = OnPolicyRunner(envs, example.settings(), log_dir=None, device="cpu")
    curve, losses = [], []
    update = runner.alg.update

    def recorded():
        found = update()
        losses.append(found)
        steps = len(losses) * example.ROLLOUT * example.ENVIRONMENTS
        curve.append([steps, float(np.mean(envs.successes or [0.0]))])
        envs.successes = []
        return found

    runner.alg.update = recorded
    iterations = max(1, question["steps"] // (example.ROLLOUT * example.ENVIRONMENTS))
    runner.learn(iterations, init_at_random_ep_len=True)
    act = example.actions_of(runner.get_inference_policy())
    envs.close()
    are_finite = [np.isfinite(float(value)) for found in losses for value in found.values()]
    return act, {"curve": curve, "finite_losses": bool(all(are_finite)), "last_losses": losses[-1]}


def trainers(scene, question):
    torch.set_num_threads(1)
    example = common.load(question["examples"], "point_goal")
    config = common.config(example.CONFIG)
    goals = {"episodes": question["goals"], "goal_seed": common.GOAL_SEED}
    random = example.evaluate(scene, config, example.random_actions(), **goals)
    found = {}
    for train in (stable_baselines3, rsl_rl):
        wall, cpu = time.perf_counter(), time.process_time()
        act, row = train(scene, config, question)
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
