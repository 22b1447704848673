"""Stable-Baselines3: a `VecEnv` on a `WalkVectorEnv`.

Stable-Baselines3 resets in the step of the end and bootstraps with the terminal observation where
`TimeLimit.truncated` is set, so that truncation by the camera's deviation or by unknown ground is
handled as the time limit is.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from .physics import BackendMissing
from .walk_vector_env import WalkVectorEnv

try:
    from stable_baselines3.common.vec_env import VecEnv as _VecEnv
except ImportError as error:
    raise BackendMissing("stable-baselines3", "paws_sim.sb3") from error


class VecEnv(_VecEnv):
    """Environments for Stable-Baselines3. Arguments are those of `WalkVectorEnv`."""

    def __init__(self, scene, num_envs: int = 16, **arguments: Any):
        self.envs = WalkVectorEnv(
            scene, num_envs, autoreset_mode=AutoresetMode.SAME_STEP, **arguments
        )
        self._returns = np.zeros(num_envs)
        super().__init__(
            num_envs, self.envs.single_observation_space, self.envs.single_action_space
        )
        # The trainer's has its own modes of rendering.
        self.metadata = {**self.envs.metadata, **self.metadata}

    def reset(self):
        """Observations of new episodes, with the seeds of `seed` if it was called."""
        seeds = self._seeds if any(seed is not None for seed in self._seeds) else None
        observations, numbers = self.envs.reset(seed=seeds)
        self.reset_infos = [{"steps": int(steps)} for steps in numbers["steps"]]
        self._returns[:] = 0.0
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: np.ndarray) -> None:
        """Keeps the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self):
        """Observations, rewards, ends and infos of a step."""
        observations, rewards, terminated, truncated, info = self.envs.step(self._actions)
        ends = terminated | truncated
        self._returns += rewards
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for index in np.flatnonzero(ends):
            final = info["final_info"]
            numbers = {
                name: values[index].item()
                for name, values in final.items()
                if not name.startswith("_")
            }
            infos[index] = {
                **numbers,
                "terminal_observation": info["final_obs"][index],
                "TimeLimit.truncated": bool(truncated[index] and not terminated[index]),
                "episode": {
                    "r": float(self._returns[index]),
                    "l": numbers["steps"],
                    "t": numbers["steps"] * self.envs.config["dt_s"],
                },
            }
        self._returns[ends] = 0.0
        return observations, rewards.astype(np.float32), ends, infos

    def close(self) -> None:
        """Gives memory back; may be called twice."""
        self.envs.close()

    def get_images(self) -> Sequence[np.ndarray | None]:
        """What each agent sees."""
        return list(self.envs.render() or [None] * self.num_envs)

    def get_attr(self, attr_name: str, indices=None) -> list[Any]:
        """An attribute of all environments, once for each index."""
        return [getattr(self.envs, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices=None) -> None:
        """Refused: environments of one world have no attributes of their own."""
        raise AttributeError(f"{attr_name} cannot be set: it is of all environments together")

    def env_method(self, method_name: str, *args: Any, indices=None, **kwargs: Any) -> list[Any]:
        """Calls a method with the index of each environment, such as `save`."""
        method = getattr(self.envs, method_name)
        return [method(int(index), *args, **kwargs) for index in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class, indices=None) -> list[bool]:
        """No environment has a wrapper."""
        return [False for _ in self._get_indices(indices)]
