"""RSL-RL: its interface of vectorized environments on a `WalkVectorEnv`.

RSL-RL takes tensors in groups of observations, sets the time in the episode at random at its start,
and bootstraps time-outs with the value of the observation before the end.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode

from .physics import BackendMissing
from .walk_vector_env import WalkVectorEnv

try:
    import torch
    from rsl_rl.env import VecEnv as _VecEnv
    from tensordict import TensorDict
except ImportError as error:
    raise BackendMissing("rsl-rl-lib", "paws_sim.rsl_rl") from error


class VecEnv(_VecEnv):
    """Environments for RSL-RL with continuous actions. Arguments are those of `WalkVectorEnv`.

    `cfg` is handed to the trainer's logger as it is.
    """

    def __init__(
        self,
        scene,
        num_envs: int,
        *,
        device: str = "cpu",
        seed: int = 0,
        cfg: Mapping[str, Any] | None = None,
        **arguments: Any,
    ):
        self.envs = WalkVectorEnv(
            scene, num_envs, autoreset_mode=AutoresetMode.SAME_STEP, **arguments
        )
        if not isinstance(self.envs.single_action_space, spaces.Box):
            raise ValueError("rsl_rl: found discrete actions, expected continuous ones")
        settings = self.envs.config
        self.num_envs = num_envs
        self.num_actions = self.envs.single_action_space.shape[0]
        limit = settings["end"]["time_limit_s"] / settings["dt_s"]
        self.max_episode_length = int(np.ceil(limit - 1e-6))
        self.device = device
        self.cfg = dict(cfg or {})
        # The runner writes into it; episodes are cut where it reaches the limit.
        self.episode_length_buf = torch.zeros(num_envs, dtype=torch.long, device=device)
        observations, _ = self.envs.reset(seed=seed)
        self._observations = self._tensors(observations)

    def _tensors(self, observations) -> TensorDict:
        if not isinstance(observations, dict):
            observations = {"policy": observations}
        groups = {
            name: torch.as_tensor(values, device=self.device)
            for name, values in observations.items()
        }
        return TensorDict(groups, batch_size=[self.num_envs], device=self.device)

    def get_observations(self) -> TensorDict:
        """Observations of the last step or reset."""
        return self._observations

    def step(self, actions: torch.Tensor):
        """Observations, rewards, ends, and `time_outs` among the extras."""
        observations, rewards, terminated, truncated, info = self.envs.step(
            actions.detach().cpu().numpy()
        )
        self.episode_length_buf += 1
        ends = terminated | truncated
        ahead = (self.episode_length_buf >= self.max_episode_length).cpu().numpy() & ~ends
        if ahead.any():
            # Those that the runner set ahead in time: their episodes begin anew.
            observations, _ = self.envs.reset(options={"reset_mask": ahead})
        dones = torch.as_tensor(ends | ahead, device=self.device)
        self.episode_length_buf[dones] = 0
        self._observations = self._tensors(observations)
        extras: dict[str, Any] = {
            "time_outs": torch.as_tensor(truncated | ahead, device=self.device),
            "log": {},
        }
        if "final_info" in info:
            mask = info["_final_info"]
            extras["log"] = {
                name: float(np.mean(info["final_info"][name][mask]))
                for name in ("is_success", "spl", "soft_spl")
            }
        rewards = torch.as_tensor(rewards, dtype=torch.float32, device=self.device)
        return self._observations, rewards, dones, extras

    def close(self) -> None:
        """Gives memory back; may be called twice."""
        self.envs.close()
