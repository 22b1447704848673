"""Trains an agent that sees small images to reach goals, with PPO of Stable-Baselines3.

    python3 -m venv sim
    sim/bin/pip install "$(ls target/wheels/paws_sim-*.whl)[sb3]"
    sim/bin/python simulation/python/examples/train_from_images.py target/demo/walk.scene

The policy sees color and depth of 48x36 px, the goal and its own velocity. It has neither the scan
of heights nor the rays, so that what is in its path is in the images alone. It is written to
`point_goal_images.zip`.
"""

import argparse
import time

import paws_sim
import torch
from paws_sim.sb3 import VecEnv
from point_goal import CONFIG, evaluate, random_actions, summary
from stable_baselines3 import PPO
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import nn
from train_point_goal import Curve

# Size, px, and farthest depth, m.
CAMERA = {"width": 48, "height": 36, "far_m": 5.0}
PARTS = ("rgb", "depth", "state")
IMAGES = {"observation": PARTS, "camera": CAMERA}
WITHOUT_SCAN = {**CONFIG, "observation": {"rays": 0, "scan_columns": 0, "scan_rows": 0}}


class ImageAndState(BaseFeaturesExtractor):
    """Color and depth through a small convolutional network, beside the state vector."""

    def __init__(self, space):
        features = 64
        super().__init__(space, features + space["state"].shape[0])
        layers = []
        for inputs, outputs, kernel in ((4, 16, 5), (16, 32, 3), (32, 32, 3)):
            layers += [nn.Conv2d(inputs, outputs, kernel, stride=2), nn.ReLU()]
        self.layers = nn.Sequential(*layers, nn.Flatten())
        with torch.no_grad():
            size = self.layers(torch.zeros(1, 4, CAMERA["height"], CAMERA["width"])).shape[1]
        self.last = nn.Sequential(nn.Linear(size, features), nn.ReLU())

    def image(self, observations):
        # Stable-Baselines3 puts the channels of `rgb` first and scales it to 0 to 1; `depth` comes
        # as the environment has it: metres, channel last.
        depth = observations["depth"].permute(0, 3, 1, 2) / CAMERA["far_m"]
        return torch.cat([observations["rgb"], depth], dim=1)

    def forward(self, observations):
        image = self.last(self.layers(self.image(observations)))
        return torch.cat([image, observations["state"]], dim=1)


def train(scene, config=WITHOUT_SCAN, steps=100_000, seed=0, network=ImageAndState):
    """A trained policy and its learning curve."""
    torch.set_num_threads(1)
    envs = VecEnv(scene, 16, config=config, **IMAGES)
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
            "features_extractor_class": network,
            "net_arch": [64, 64],
            "log_std_init": -0.5,
        },
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
    parser.add_argument("--steps", type=int, default=100_000)
    parser.add_argument("--goals", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    scene = paws_sim.open_scene(arguments.scene)
    exam = {"episodes": arguments.goals, "goal_seed": 1, **IMAGES}
    print("random:", summary(evaluate(scene, WITHOUT_SCAN, random_actions(), **exam)))
    start = time.perf_counter()
    model, curve = train(scene, steps=arguments.steps, seed=arguments.seed)
    print(f"trained for {time.perf_counter() - start:.0f} s")
    for steps, success, returns in curve[:: max(1, len(curve) // 10)]:
        print(f"  {steps:7d} steps: success {success:.2f}, return {returns:6.2f}")
    act = lambda o: model.predict(o, deterministic=True)[0]
    print("trained:", summary(evaluate(scene, WITHOUT_SCAN, act, **exam)))
    model.save("point_goal_images")


if __name__ == "__main__":
    main()
