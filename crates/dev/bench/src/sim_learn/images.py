"""Trains agents that see small images, and the same network with black ones.

Both know the goal and their velocity; neither has the scan of heights nor the rays, so that what
stands in the way is in the images alone. All act on the same unseen goals from the same starts.
"""

import time

import common
import numpy as np
import torch


def sigmas(a, b):
    """Difference of two means in its standard deviation, of independent episodes; `None` where
    neither varies."""
    variance = sum(np.var(values, ddof=1) / len(values) for values in (a, b))
    return float((np.mean(a) - np.mean(b)) / np.sqrt(variance)) if variance > 0.0 else None


def images(scene, question):
    example = common.load(question["examples"], "train_from_images")

    class Blind(example.ImageAndState):
        """The same network with black images."""

        def image(self, observations):
            return torch.zeros_like(super().image(observations))

    config = common.config(example.WITHOUT_SCAN)

    def exam(act):
        goals = {"episodes": question["goals"], "goal_seed": common.GOAL_SEED}
        return example.evaluate(scene, config, act, **goals, **example.IMAGES)

    found = {"random": exam(example.random_actions())}
    for name, network in (("blind", Blind), ("seeing", example.ImageAndState)):
        wall, cpu = time.perf_counter(), time.process_time()
        model, curve = example.train(
            scene, config, question["steps"], question["seed"], network
        )
        times = {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
        act = lambda o: model.predict(o, deterministic=True)[0]
        found[name] = {**exam(act), "curve": curve, "times": times}
    returns = {name: result.pop("returns") for name, result in found.items()}
    for name, result in found.items():
        result["return"] = np.mean(returns[name])
    return {
        **found,
        "sigma_over_random": sigmas(returns["seeing"], returns["random"]),
        "sigma_over_blind": sigmas(returns["seeing"], returns["blind"]),
        "size": [example.CAMERA["width"], example.CAMERA["height"]],
        "steps": question["steps"],
    }


common.answer(images)
