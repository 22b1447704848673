"""Many environments, as `gymnasium.vector.VectorEnv`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from . import _core
from .simulator import AUTORESET_CODES, Simulator, whole_seed


class WalkVectorEnv(gymnasium.vector.VectorEnv):
    """Agents in environments of their own on one scene. Environment i with the seed s is
    `WalkEnv` with the seed s + i, bit for bit.

    - `autoreset_mode`: `NEXT_STEP` (after an episode's end the next step ignores the action, has
      reward 0 and returns the first observation of the next episode), `SAME_STEP` (the step of the
      end returns it; `info["final_obs"]` and `info["final_info"]` have the end) or `DISABLED`
      (`reset(options={"reset_mask": mask})`).
    - `copy`: without it the state vectors are one of two arrays that steps alternate between, valid
      until the step after the next. `reset` and `observe` write into that of the last step.

    The others are those of `WalkEnv`. `info` has arrays of the numbers, and with each its mask.
    """

    metadata = {
        "render_modes": ["rgb_array"],
        "render_fps": 10,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }
    #: What was refused by its constructor has nothing to close.
    closed = True

    def __init__(
        self,
        scene="synthetic:room",
        num_envs: int = 1,
        *,
        task: str = "point-goal",
        observation="state",
        actions="continuous",
        config: Mapping[str, Any] | None = None,
        camera: Mapping[str, Any] | None = None,
        reward=None,
        render_mode: str | None = None,
        max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        copy: bool = True,
    ):
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise _core.SettingError(
                f"render_mode: found {render_mode!r}, expected None or rgb_array"
            )
        try:
            self.autoreset_mode = AutoresetMode(autoreset_mode)
        except ValueError as error:
            names = ", ".join(mode.value for mode in AutoresetMode)
            raise _core.SettingError(
                f"autoreset_mode: found {autoreset_mode!r}, expected one of {names}"
            ) from error
        self._simulator = Simulator(
            scene,
            num_envs,
            task=task,
            observation=observation,
            actions=actions,
            config=config,
            camera=camera,
            reward=reward,
            max_episode_steps=max_episode_steps,
            copy=copy,
        )
        self._arguments = {
            "scene": self._simulator.scene,
            "num_envs": num_envs,
            "task": task,
            "observation": observation,
            "actions": actions,
            "config": config,
            "camera": camera,
            "reward": reward,
            "render_mode": render_mode,
            "max_episode_steps": max_episode_steps,
            "autoreset_mode": self.autoreset_mode,
            "copy": copy,
        }
        self.num_envs = num_envs
        self.render_mode = render_mode
        self.metadata = {
            **self.metadata,
            "render_fps": 1.0 / self._simulator.dt_s,
            "autoreset_mode": self.autoreset_mode,
        }
        self.single_observation_space = self._simulator.observation_space
        self.single_action_space = self._simulator.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._has_seed = np.zeros(num_envs, np.bool_)
        self.closed = False

    @property
    def scene(self) -> _core.Scene:
        """The scene."""
        return self._simulator.scene

    @property
    def config(self) -> dict[str, Any]:
        """The whole configuration of the world."""
        return self._simulator.config

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: Mapping[str, Any] | None = None,
    ):
        """Begins episodes, in the environments of `options["reset_mask"]` or in all. A seed s gives
        environment i the seed s + i; a list has one for each. Without one, or with None in the
        list, the next episode of its seed begins, and the first time a seed is drawn."""
        is_list = isinstance(seed, (Sequence, np.ndarray))
        seed = seed if seed is None or is_list else whole_seed(seed)
        super().reset(seed=None if is_list else seed)
        options = dict(options or {})
        mask = options.pop("reset_mask", None)
        if options:
            raise _core.SettingError(f"options: found {sorted(options)}, expected reset_mask")
        if mask is not None:
            mask = self._checked_mask(mask)
        world = self._simulator.world
        world.reset(mask, self._seeds(seed, mask))
        self._has_seed[slice(None) if mask is None else mask] = True
        state, numbers = world.observations(), world.numbers()
        return self._simulator.observe(state), self._info(numbers, mask)

    def _seeds(self, seed, mask: np.ndarray | None) -> list[int | None]:
        """Seeds of all environments, None for the next episode of the seed that one has."""
        n = self.num_envs
        if isinstance(seed, int):
            return [whole_seed(seed + k) for k in range(n)]
        if seed is None:
            seed = [None] * n
        if len(seed) != n:
            raise _core.SettingError(f"seed: found {len(seed)} seeds, expected {n}")
        seeds = [None if one is None else whole_seed(one) for one in seed]
        is_new = ~self._has_seed if mask is None else mask & ~self._has_seed
        missing = [k for k in np.flatnonzero(is_new) if seeds[k] is None]
        if missing:
            first = int(self.np_random.integers(2**32))
            for k in missing:
                seeds[k] = first + int(k)
        return seeds

    def _checked_mask(self, mask) -> np.ndarray:
        if not isinstance(mask, np.ndarray):
            raise TypeError(f"reset_mask: found {type(mask)}, expected a numpy array")
        if mask.dtype != np.bool_:
            raise TypeError(f"reset_mask: found {mask.dtype}, expected bool")
        if mask.shape != (self.num_envs,):
            raise _core.SettingError(
                f"reset_mask: found shape {mask.shape}, expected ({self.num_envs},)"
            )
        if not mask.any():
            raise _core.SettingError("reset_mask: found no True, expected at least one")
        return np.ascontiguousarray(mask)

    def step(self, actions):
        """Advances all environments by `dt_s` seconds."""
        simulator = self._simulator
        commands = simulator.commands(actions)
        state, rewards, terminated, truncated, numbers, had_ended, ended = simulator.world.step(
            commands, AUTORESET_CODES[self.autoreset_mode]
        )
        # A reward is of the episode that the action belonged to.
        before = (state, numbers) if ended is None else ended[1:]
        rewards = simulator.rewards(
            rewards, commands, *before, terminated, truncated, had_ended
        )
        info = self._info(numbers, None)
        if ended is not None:
            mask, final_state, final_numbers = ended
            info.update(self._final(mask, final_state, final_numbers))
        return simulator.observe(state), rewards, terminated, truncated, info

    def _info(self, numbers: Mapping[str, np.ndarray], mask: np.ndarray | None) -> dict[str, Any]:
        info: dict[str, Any] = {}
        for name, values in numbers.items():
            info[name] = values if mask is None else np.where(mask, values, values.dtype.type(0))
            info[f"_{name}"] = np.ones(self.num_envs, np.bool_) if mask is None else mask.copy()
        return info

    def _final(self, mask, state, numbers) -> dict[str, Any]:
        observations = self._simulator.final_observations(mask, state)
        final = np.full(self.num_envs, None, dtype=object)
        for row, index in enumerate(np.flatnonzero(mask)):
            if isinstance(observations, dict):
                final[index] = {part: values[row] for part, values in observations.items()}
            else:
                final[index] = observations[row]
        return {
            "final_obs": final,
            "_final_obs": mask.copy(),
            "final_info": self._info(numbers, mask),
            "_final_info": mask.copy(),
        }

    def render(self) -> tuple[np.ndarray, ...] | None:
        """What each agent sees of now: through its camera with the shape of its images, within
        320x240 pixels, or 90 degrees on 320x240 pixels without images and settings of a camera."""
        if self.render_mode is None:
            gymnasium.logger.warn("render() without render_mode; make the environment with one")
            return None
        return tuple(self._simulator.film())

    @property
    def observation_fields(self) -> dict[str, slice]:
        """Named parts of a state vector, for `state[:, fields[name]]`."""
        return self._simulator.observation_fields()

    def states(self) -> dict[str, np.ndarray]:
        """Agents: `sector`, `level`, `position_m`, `angles_rad` (yaw, pitch, roll), `velocity`
        (forward, left, yaw rate), `is_on_ground`, and `goal_m`, NaN where there is no goal."""
        return self._simulator.world.states()

    def camera_poses(self) -> tuple[np.ndarray, np.ndarray]:
        """Poses `world_from_camera` (n, 4, 4) in their sectors, and the sectors."""
        return self._simulator.world.camera_poses()

    def play(self, environment: int, time_ns: int) -> bool:
        """Puts an agent where the recorded wearer was at a time, ns, of the recording of the
        agent's sector. False where there is no pose above known ground; nothing changed then.
        `observe` shows it."""
        return self._simulator.world.play(environment, time_ns)

    def observe(self):
        """Observations of now, after `play`, `place` or `restore`."""
        return self._simulator.observe(self._simulator.world.observations())

    def place(
        self,
        environment: int,
        position_m,
        angles_rad=(0.0, 0.0, 0.0),
        velocity=(0.0, 0.0, 0.0),
        *,
        sector: int | None = None,
        level: int = 0,
    ) -> None:
        """Puts an agent somewhere, as physics outside does: parts of its state as `states` has
        them, in a sector of the same recording. A state that is not finite ends the episode in the
        next step as `PHYSICS_FAULT`. `observe` shows it."""
        self._simulator.place(environment, position_m, angles_rad, velocity, sector, level)

    def save(self, environment: int, attachment: bytes = b"") -> bytes:
        """A snapshot of an environment of at most 4 KB, with an attachment such as the state of
        physics outside."""
        return self._simulator.world.save(environment, attachment)

    def restore(self, environment: int, snapshot: bytes) -> bytes:
        """An environment goes on from a snapshot, which may be of another one; returns the
        attachment."""
        attachment = self._simulator.world.restore(environment, bytes(snapshot))
        self._has_seed[environment] = True
        return attachment

    def close_extras(self, **_kwargs: Any) -> None:
        """Gives memory back."""
        self._simulator.close()

    def __getstate__(self) -> dict[str, Any]:
        left_out = (
            "_simulator",
            "single_observation_space",
            "single_action_space",
            "observation_space",
            "action_space",
        )
        kept = {name: value for name, value in self.__dict__.items() if name not in left_out}
        # Before its first reset an environment has nothing to go on from.
        kept["snapshots"] = [
            self.save(index) if self._has_seed[index] else None for index in range(self.num_envs)
        ]
        kept["_has_seed"] = self._has_seed.copy()
        kept["spaces"] = {name: getattr(self, name) for name in left_out[1:]}
        return kept

    def __setstate__(self, kept: dict[str, Any]) -> None:
        snapshots, spaces = kept.pop("snapshots"), kept.pop("spaces")
        # A subclass may have a constructor of its own, whose attributes are among those kept.
        WalkVectorEnv.__init__(self, **kept["_arguments"])
        self.__dict__.update(kept)
        self.__dict__.update(spaces)
        for index, snapshot in enumerate(snapshots):
            if snapshot is not None:
                self._simulator.world.restore(index, snapshot)
