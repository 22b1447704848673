"""Trains agents that see small images, and the same network with black ones.

Both know the goal and their velocity; neither has the scan of heights nor the rays, so that what
stands in the way is in the images alone. All act on the same unseen goals from the same starts.
"""

import time

import common
import numpy as np
import torch
from paws_sim.sb3 import VecEnv
from stable_baselines3 import PPO
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import nn

# Size, px, and farthest depth, m.
CAMERA = {"width": 48, "height": 36, "far_m": 5.0}
PARTS = ("rgb", "depth", "state")
WITHOUT_SCAN = {"observation": {"rays": 0, "scan_columns": 0, "scan_rows": 0}}


class Eyes(BaseFeaturesExtractor):
    """Colors and depth through a small convolutional network, beside the state."""

    def __init__(self, space, is_blind: bool):
        features = 64
        super().__init__(space, features + space["state"].shape[0])
        self.is_blind = is_blind
        layers = []
        for inputs, outputs, kernel in ((4, 16, 5), (16, 32, 3), (32, 32, 3)):
            layers += [nn.Conv2d(inputs, outputs, kernel, stride=2), nn.ReLU()]
        self.layers = nn.Sequential(*layers, nn.Flatten())
        with torch.no_grad():
            size = self.layers(torch.zeros(1, 4, CAMERA["height"], CAMERA["width"])).shape[1]
        self.last = nn.Sequential(nn.Linear(size, features), nn.ReLU())

    def forward(self, observations):
        depth = observations["depth"].permute(0, 3, 1, 2) / CAMERA["far_m"]
        image = torch.cat([observations["rgb"], depth], dim=1)
        if self.is_blind:
            image = torch.zeros_like(image)
        return torch.cat([self.last(self.layers(image)), observations["state"]], dim=1)


def trained(example, scene, config, question, is_blind):
    wall, cpu = time.perf_counter(), time.process_time()
    envs = VecEnv(scene, 16, config=config, observation=PARTS, camera=CAMERA)
    model = PPO(
        "MultiInputPolicy",
        envs,
        n_steps=128,
        batch_size=256,
        n_epochs=4,
        learning_rate=5e-4,
        gamma=0.98,
        gae_lambda=0.95,
        ent_coef=0.0,
        policy_kwargs={
            "features_extractor_class": Eyes,
            "features_extractor_kwargs": {"is_blind": is_blind},
            "net_arch": [64, 64],
            "log_std_init": -0.5,
        },
        seed=question["seed"],
        device="cpu",
    )
    curve = example.Curve()
    model.learn(question["steps"], callback=curve)
    envs.close()
    times = {"wall_s": time.perf_counter() - wall, "cpu_s": time.process_time() - cpu}
    return lambda o: model.predict(o, deterministic=True)[0], curve.points, times


def sigmas(a, b):
    """Difference of two means in its standard deviation, of independent episodes; `None` where
    neither varies."""
    variance = sum(np.var(values, ddof=1) / len(values) for values in (a, b))
    return float((np.mean(a) - np.mean(b)) / np.sqrt(variance)) if variance > 0.0 else None


def images(scene, question):
    torch.set_num_threads(1)
    example = common.load(question["example"])
    config = common.paws_sim.simulator.merge_settings(common.config(example), WITHOUT_SCAN)

    def exam(act):
        return example.evaluate(
            scene,
            config,
            act,
            episodes=question["goals"],
            goal_seed=common.GOAL_SEED,
            observation=PARTS,
            camera=CAMERA,
        )

    found = {"random": exam(common.uniform())}
    for name, is_blind in (("blind", True), ("seeing", False)):
        act, curve, times = trained(example, scene, config, question, is_blind)
        found[name] = {**exam(act), "curve": curve, "times": times}
    returns = {name: result.pop("returns") for name, result in found.items()}
    for name, result in found.items():
        result["return"] = np.mean(returns[name])
    return {
        **found,
        "sigma_over_random": sigmas(returns["seeing"], returns["random"]),
        "sigma_over_blind": sigmas(returns["seeing"], returns["blind"]),
        "size": [CAMERA["width"], CAMERA["height"]],
        "steps": question["steps"],
    }


common.answer(images)
