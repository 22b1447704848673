"""What the scalar and the vector environment share: configuration, spaces, observations."""

from __future__ import annotations

import json
import operator
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode

from . import _core
from .cameras import (
    BUDGET_BYTES,
    Cameras,
    check_budget,
    film_camera,
    intrinsics,
    lens_and_options,
    mount,
    timing,
)

TASKS = ("point-goal", "follow-path", "velocity")
PARTS = ("state", "rgb", "depth")
AUTORESET_CODES = {
    AutoresetMode.NEXT_STEP: 0,
    AutoresetMode.SAME_STEP: 1,
    AutoresetMode.DISABLED: 2,
}
_DISCRETE = {
    # Stop, forward, turn left, turn right.
    "differential": [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, -1.0]],
    "wheels": [[0.0, 0.0], [1.0, 1.0], [-1.0, 1.0], [1.0, -1.0]],
    "holonomic": [
        [0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [0.0, 0.0, 1.0],
        [0.0, 0.0, -1.0],
        [0.0, 1.0, 0.0],
        [0.0, -1.0, 0.0],
    ],
}


@dataclass(frozen=True)
class Inputs:
    """What a reward is computed from: a step of all environments, before any autoreset.

    `terms` are the terms of the built-in reward by name, `numbers` those of `info`, `state` the
    observation vectors (n, k), `actions` (n, components), all first axes of n environments.
    """

    terms: dict[str, np.ndarray]
    numbers: dict[str, np.ndarray]
    state: np.ndarray
    actions: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray


Reward = Callable[[Inputs], np.ndarray]


def open_scene(scene) -> _core.Scene:
    """A scene of a path to a bundle or a folder of several, of `synthetic:NAME`, or as it is."""
    if isinstance(scene, _core.Scene):
        return scene
    text = os.fspath(scene)
    if text.startswith("synthetic:"):
        return _core.Scene.synthetic(text.removeprefix("synthetic:"))
    return _core.Scene.open(text)


def import_beogym(folder, out) -> _core.Scene:
    """Writes a folder of Beogym as a new folder of scene bundles, and opens it. An error if
    there is something at `out`."""
    _core.import_beogym(os.fspath(folder), os.fspath(out), time.time_ns())
    return open_scene(out)


def whole_seed(seed) -> int:
    """A seed of any type of whole numbers, or the error that names it."""
    try:
        whole = operator.index(seed)
    except TypeError:
        whole = -1
    if not 0 <= whole < 2**64:
        raise _core.SettingError(
            f"seed: found {seed!r}, expected a whole number of 0 to 2^64 - 1, or None"
        )
    return whole


def merge_settings(*parts: Mapping[str, Any]) -> dict[str, Any]:
    """Nested settings; later ones win."""
    whole: dict[str, Any] = {}
    for part in parts:
        for key, value in part.items():
            if isinstance(value, Mapping):
                value = merge_settings(whole.get(key, {}), value)
            whole[key] = value
    return whole


#: Lens and options of films where an environment has no camera.
_FILM = (320, 240, *intrinsics(320, 240, None, None)), "{}"


class Simulator:
    """A world with its cameras, its spaces and the reward of the user."""

    def __init__(
        self,
        scene,
        environments: int,
        *,
        task: str,
        observation,
        actions,
        config: Mapping[str, Any] | None,
        camera: Mapping[str, Any] | None,
        reward: Reward | None,
        max_episode_steps: int | None,
        copy: bool,
    ):
        if task not in TASKS:
            raise _core.SettingError(f"task: found {task!r}, expected one of {', '.join(TASKS)}")
        if reward is not None and not callable(reward):
            raise _core.SettingError(f"reward: found {reward!r}, expected a callable")
        self.scene = open_scene(scene)
        self.task = task
        self.environments = environments
        config = dict(config or {})
        for name, argument in (("seed", "reset(seed=...)"), ("environments", "num_envs")):
            if name in config:
                raise _core.SettingError(
                    f"config.{name}: found {config[name]!r}, expected none: `{argument}` has it"
                )
        settings = merge_settings(
            {"task": {"task": task}, "environments": environments, "seed": 0}, config
        )
        has_camera = bool(camera)
        camera = {"far_m": 20.0, **(camera or {})}
        self._budget_bytes = check_budget(
            "camera.budget_bytes", camera.pop("budget_bytes", BUDGET_BYTES)
        )
        if "timing" in camera:
            settings = merge_settings(settings, {"timing": timing(camera.pop("timing"))})
        body_from_camera = mount(self.scene, camera)
        if body_from_camera is not None:
            if settings.get("body_from_camera") is not None:
                raise _core.SettingError(
                    "camera.mount: found body_from_camera beside it, expected one of them"
                )
            settings["body_from_camera"] = body_from_camera
        self.far_m = camera["far_m"]
        camera.pop("mount", None)
        self.lens, self.camera_options = lens_and_options(self.scene, camera)
        _core.check_camera(self.lens, self.camera_options)
        if max_episode_steps is not None:
            dt_s = settings.get("dt_s", _core.DT_S)
            limit = {"end": {"time_limit_s": max_episode_steps * dt_s}}
            settings = merge_settings(settings, limit)
        try:
            text = json.dumps(settings)
        except TypeError as error:
            raise _core.SettingError(f"configuration: {error}") from error
        self.world = _core.World(self.scene, text, copy)
        self.config = json.loads(self.world.config)
        self.dt_s = self.config["dt_s"]
        self.reward = reward

        self.parts = self._checked_parts(observation)
        # Without Gaussians images are refused here.
        has_images = self.parts != ("state",)
        self.images = self._cameras() if has_images else None
        self._film = _FILM
        if has_camera or has_images:
            self._film = film_camera(self.lens, self.camera_options)
        self.observation_space = self._observation_space()
        self._table = self._action_table(actions)
        size = self.world.action_size
        self.action_space: spaces.Space = (
            spaces.Box(-1.0, 1.0, (size,), np.float32)
            if self._table is None
            else spaces.Discrete(len(self._table))
        )

    @staticmethod
    def _checked_parts(observation) -> tuple[str, ...]:
        parts = (observation,) if isinstance(observation, str) else tuple(observation)
        unknown = [part for part in parts if part not in PARTS]
        if unknown or not parts or len(set(parts)) < len(parts):
            raise _core.SettingError(
                f"observation: found {observation!r}, expected some of {', '.join(PARTS)}"
            )
        return tuple(sorted(parts))

    def _observation_space(self) -> spaces.Space:
        low, high = self.world.observation_bounds()
        width, height = self.lens[:2]
        of = {
            "state": lambda: spaces.Box(low, high, dtype=np.float32),
            "rgb": lambda: spaces.Box(0, 255, (height, width, 3), np.uint8),
            "depth": lambda: spaces.Box(
                0.0, self.far_m, (height, width, 1), np.float32
            ),
        }
        if self.parts == ("state",):
            return of["state"]()
        return spaces.Dict({part: of[part]() for part in self.parts})

    def _action_table(self, actions) -> np.ndarray | None:
        if isinstance(actions, str):
            if actions == "continuous":
                return None
            drive = self.config["drive"]
            if actions == "discrete" and drive in _DISCRETE:
                return np.array(_DISCRETE[drive])
            raise _core.SettingError(
                f"actions: found {actions!r} with the drive {drive}, expected continuous, discrete "
                "(differential, wheels, holonomic) or a table of actions"
            )
        table = np.asarray(actions, np.float64)
        size = self.world.action_size
        if table.ndim != 2 or table.shape[1] != size or not np.isfinite(table).all():
            raise _core.SettingError(
                f"actions: found a table of shape {table.shape}, expected finite (m, {size})"
            )
        return table

    def commands(self, actions) -> np.ndarray:
        """Actions of the action space as components of -1 to 1, shape (n, components)."""
        n, size = self.environments, self.world.action_size
        if self._table is not None:
            indices = np.asarray(actions)
            is_index = indices.shape == (n,) and np.issubdtype(indices.dtype, np.integer)
            if not is_index:
                raise _core.ActionError(
                    f"actions: found {indices.dtype} of shape {indices.shape}, expected {n} "
                    "whole numbers"
                )
            wrong = (indices < 0) | (indices >= len(self._table))
            if wrong.any():
                at = int(wrong.argmax())
                raise _core.ActionError(
                    f"action of environment {at}: found {indices[at]}, expected 0 to "
                    f"{len(self._table) - 1}"
                )
            return self._table[indices]
        try:
            values = np.asarray(actions, np.float64)
        except (TypeError, ValueError) as error:
            raise _core.ActionError(f"actions: {error}") from error
        if values.shape != (n, size):
            raise _core.ActionError(
                f"actions: found shape {values.shape}, expected ({n}, {size})"
            )
        return np.ascontiguousarray(values)

    def observe(self, state: np.ndarray):
        """The observation of all environments after a step or reset."""
        if self.parts == ("state",):
            return state
        return self._observation(state, *self.world.frames())

    def final_observations(self, mask: np.ndarray, state: np.ndarray):
        """Those of the environments of a mask before their reset in the same step."""
        if self.parts == ("state",):
            return state[mask]
        return self._observation(state[mask], *self.world.final_frames())

    def _observation(self, state, poses, sectors, keys, conditions):
        images = self._images().render_lens(
            poses, sectors, keys, conditions, self.lens, self.camera_options
        )
        whole = {"state": state, "rgb": images["rgb"], "depth": images["depth"][..., None]}
        return {part: whole[part] for part in self.parts}

    def film(self) -> np.ndarray:
        """What each agent sees of now, shape (n, height, width, 3): through the camera of the
        environment, or 90 degrees on 320x240 pixels where it has none."""
        poses, sectors = self.world.camera_poses()
        steps = self.world.numbers()["steps"].astype(np.uint64)
        keys = np.column_stack([self.world.random_keys(), steps])
        return self._images().render_lens(poses, sectors, keys, None, *self._film)["rgb"]

    def _images(self) -> Cameras:
        if self.images is None:
            self.images = self._cameras()
        return self.images

    def _cameras(self) -> Cameras:
        return Cameras(self.scene, budget_bytes=self._budget_bytes)

    def rewards(
        self, rewards, actions, state, numbers, terminated, truncated, had_ended
    ) -> np.ndarray:
        """The built-in reward, or that of the user; 0 where a step only began an episode."""
        if self.reward is None:
            return rewards
        terms = self.world.reward_terms()
        inputs = Inputs(
            terms={name: terms[:, k].copy() for k, name in enumerate(_core.REWARD_TERMS)},
            numbers=dict(numbers),
            state=state,
            actions=actions,
            terminated=terminated.copy(),
            truncated=truncated.copy(),
        )
        values = np.asarray(self.reward(inputs), np.float64)
        if values.shape != (self.environments,):
            raise ValueError(
                f"reward: found shape {values.shape}, expected ({self.environments},)"
            )
        if not np.isfinite(values).all():
            at = int((~np.isfinite(values)).argmax())
            raise ValueError(f"reward of environment {at}: found {values[at]}, expected finite")
        return np.where(had_ended, 0.0, values)

    def observation_fields(self) -> dict[str, slice]:
        """Named parts of a state vector."""
        fields = self.world.observation_fields()
        return {name: slice(first, first + count) for name, first, count in fields}

    def place(self, environment: int, position_m, angles_rad, velocity, sector, level) -> None:
        """Puts an agent somewhere, without a sector in its own."""
        parts = {"position_m": position_m, "angles_rad": angles_rad, "velocity": velocity}
        triples = [_triple(name, values) for name, values in parts.items()]
        self.world.place(environment, *triples, sector, level)

    def close(self) -> None:
        """Gives memory back."""
        self.world.close()
        if self.images is not None:
            self.images.close()


def _triple(name: str, values) -> list[float]:
    try:
        array = np.asarray(values, np.float64)
    except (TypeError, ValueError) as error:
        raise _core.SettingError(f"{name}: {error}") from error
    if array.shape != (3,):
        raise _core.SettingError(f"{name}: found shape {array.shape}, expected (3,)")
    return array.tolist()
