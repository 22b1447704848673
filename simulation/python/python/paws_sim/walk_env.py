"""One environment, as `gymnasium.Env`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode

from . import _core
from .simulator import AUTORESET_CODES, Simulator, whole_seed

_DISABLED = AUTORESET_CODES[AutoresetMode.DISABLED]


class WalkEnv(gymnasium.Env):
    """An agent that walks through a scene.

    - `scene`: path of a scene bundle, `synthetic:NAME`, or a `Scene`.
    - `task`: `point-goal`, `follow-path` or `velocity`.
    - `observation`: `state` for a vector, or some of `state`, `rgb`, `depth` for a dictionary.
    - `actions`: `continuous`, `discrete`, or a table (m, components) of components of -1 to 1.
    - `config`: nested settings of the world, such as `{"end": {"time_limit_s": 30.0}}`.
    - `camera`: settings of the images: lens, exposure, noise, shutter, ... as `Cameras.render` has
      them, and `mount`, a matrix `body_from_camera`. `recorded` names a camera of the rig of the
      first sector and takes its mount along. `timing`, settings such as `{"interval_s": [0.1, 0.1],
      "latency_s": [0.1, 0.2]}` or `gauss_gym`, makes images late and gives them a rate; `state` is
      not late.
    - `reward`: a callable of `Inputs` that returns one number per environment.

    `info` holds numbers with the same keys and types in every step: `end_reason` (`EndReason`),
    `is_success`, `blocked`, `deviation_m`, `deviation_rad`, `support_db`, `collisions`, `clipped`,
    `steps`, `path_length_m`, `remaining_m`, `spl`, `soft_spl`, `frame_age_s` (the time since the
    image was captured).

    `reset(options={"snapshot": bytes})` goes on from a snapshot of `save`.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}

    def __init__(
        self,
        scene="synthetic:room",
        *,
        task: str = "point-goal",
        observation="state",
        actions="continuous",
        config: Mapping[str, Any] | None = None,
        camera: Mapping[str, Any] | None = None,
        reward=None,
        render_mode: str | None = None,
        max_episode_steps: int | None = None,
    ):
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise _core.SettingError(
                f"render_mode: found {render_mode!r}, expected None or rgb_array"
            )
        self._simulator = Simulator(
            scene,
            1,
            task=task,
            observation=observation,
            actions=actions,
            config=config,
            camera=camera,
            reward=reward,
            max_episode_steps=max_episode_steps,
            copy=True,
        )
        self._arguments = {
            "scene": self._simulator.scene,
            "task": task,
            "observation": observation,
            "actions": actions,
            "config": config,
            "camera": camera,
            "reward": reward,
            "render_mode": render_mode,
            "max_episode_steps": max_episode_steps,
        }
        self.render_mode = render_mode
        self.metadata = {**self.metadata, "render_fps": 1.0 / self._simulator.dt_s}
        self.observation_space = self._simulator.observation_space
        self.action_space = self._simulator.action_space
        self._has_seed = False

    @property
    def scene(self) -> _core.Scene:
        """The scene."""
        return self._simulator.scene

    @property
    def config(self) -> dict[str, Any]:
        """The whole configuration of the world."""
        return self._simulator.config

    def reset(self, *, seed: int | None = None, options: Mapping[str, Any] | None = None):
        """Begins an episode. The same seed gives the same episodes; without one, the next."""
        seed = None if seed is None else whole_seed(seed)
        super().reset(seed=seed)
        world = self._simulator.world
        options = dict(options or {})
        snapshot = options.pop("snapshot", None)
        if options:
            raise _core.SettingError(f"options: found {sorted(options)}, expected snapshot")
        if snapshot is not None:
            self.restore(snapshot)
        else:
            if seed is None and not self._has_seed:
                seed = int(self.np_random.integers(2**32))
            world.reset(None, [seed])
            self._has_seed = True
        state, numbers = world.observations(), world.numbers()
        return _first(self._simulator.observe(state)), _scalars(numbers)

    def step(self, action):
        """Advances by `dt_s` seconds."""
        simulator = self._simulator
        commands = simulator.commands(np.asarray(action)[None])
        state, rewards, terminated, truncated, numbers, had_ended, _ = simulator.world.step(
            commands, _DISABLED
        )
        rewards = simulator.rewards(
            rewards, commands, state, numbers, terminated, truncated, had_ended
        )
        return (
            _first(simulator.observe(state)),
            float(rewards[0]),
            bool(terminated[0]),
            bool(truncated[0]),
            _scalars(numbers),
        )

    def render(self) -> np.ndarray | None:
        """What the agent sees of now: through its camera with the shape of its images, within
        320x240 pixels, or 90 degrees on 320x240 pixels without images and settings of a camera."""
        if self.render_mode is None:
            gymnasium.logger.warn("render() without render_mode; make the environment with one")
            return None
        return self._simulator.film()[0]

    def play(self, time_ns: int) -> bool:
        """Puts the agent where the recorded wearer was at a time, ns, of the recording of the
        agent's sector. False where there is no pose above known ground; nothing changed then.
        `observe` shows it."""
        return self._simulator.world.play(0, time_ns)

    def observe(self):
        """The observation of now, after `play`, `place` or `restore`."""
        return _first(self._simulator.observe(self._simulator.world.observations()))

    @property
    def observation_fields(self) -> dict[str, slice]:
        """Named parts of the state vector, for `state[fields[name]]`."""
        return self._simulator.observation_fields()

    def states(self) -> dict[str, Any]:
        """The agent: `sector`, `level`, `position_m`, `angles_rad` (yaw, pitch, roll), `velocity`
        (forward, left, yaw rate), `is_on_ground`, and `goal_m`, NaN where there is no goal."""
        return {name: values[0] for name, values in self._simulator.world.states().items()}

    def camera_poses(self) -> tuple[np.ndarray, int]:
        """The pose `world_from_camera` (4, 4) in the agent's sector, and the sector."""
        poses, sectors = self._simulator.world.camera_poses()
        return poses[0], int(sectors[0])

    def place(
        self,
        position_m,
        angles_rad=(0.0, 0.0, 0.0),
        velocity=(0.0, 0.0, 0.0),
        *,
        sector: int | None = None,
        level: int = 0,
    ) -> None:
        """Puts the agent somewhere, as physics outside does: parts of its state as `states` has
        them, in a sector of the same recording. A state that is not finite ends the episode in the
        next step as `PHYSICS_FAULT`. `observe` shows it."""
        self._simulator.place(0, position_m, angles_rad, velocity, sector, level)

    def save(self, attachment: bytes = b"") -> bytes:
        """A snapshot of at most 4 KB, with an attachment such as the state of physics outside."""
        return self._simulator.world.save(0, attachment)

    def restore(self, snapshot: bytes) -> bytes:
        """Goes on from a snapshot, which may be of another process, and returns its attachment."""
        attachment = self._simulator.world.restore(0, bytes(snapshot))
        self._has_seed = True
        return attachment

    def close(self) -> None:
        """Gives memory back; may be called twice."""
        self._simulator.close()

    def __getstate__(self) -> dict[str, Any]:
        kept = {
            name: value
            for name, value in self.__dict__.items()
            if name not in ("_simulator", "observation_space", "action_space")
        }
        # Before the first reset there is nothing to go on from.
        kept["snapshot"] = self.save() if self._has_seed else None
        kept["spaces"] = (self.observation_space, self.action_space)
        return kept

    def __setstate__(self, kept: dict[str, Any]) -> None:
        snapshot, spaces = kept.pop("snapshot"), kept.pop("spaces")
        # A subclass may have a constructor of its own, whose attributes are among those kept.
        WalkEnv.__init__(self, **kept["_arguments"])
        self.__dict__.update(kept)
        # With the state of their random numbers.
        self.observation_space, self.action_space = spaces
        if snapshot is not None:
            self._simulator.world.restore(0, snapshot)


def _first(observation):
    if isinstance(observation, dict):
        return {part: values[0] for part, values in observation.items()}
    return observation[0]


def _scalars(numbers: Mapping[str, np.ndarray]) -> dict[str, Any]:
    return {name: values[0].item() for name, values in numbers.items()}
