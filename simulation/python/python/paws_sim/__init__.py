"""Simulators on reconstructed walks: Gymnasium environments and batches of cameras.

    import paws_sim

    env = paws_sim.make("walk.scene")
    observation, info = env.reset(seed=0)
    observation, reward, terminated, truncated, info = env.step(env.action_space.sample())

World frame z up, bodies x forward, y left, z up, optical frames x right, y down, z forward; metres,
radians, seconds. The same scene, configuration and seed give the same bits on any number of threads
and environments.
"""

from __future__ import annotations

from ._core import (
    REWARD_TERMS,
    ActionError,
    BudgetError,
    Scene,
    SceneError,
    SettingError,
    SnapshotError,
    StartError,
    StateError,
    __version__,
    set_threads,
    write_synthetic,
)
from .cameras import Cameras
from .end_reason import EndReason
from .physics import BackendMissing
from .registration import register
from .simulator import Inputs, import_beogym, open_scene
from .walk_env import WalkEnv
from .walk_vector_env import WalkVectorEnv

__all__ = [
    "REWARD_TERMS",
    "ActionError",
    "BackendMissing",
    "BudgetError",
    "Cameras",
    "EndReason",
    "Inputs",
    "Scene",
    "SceneError",
    "SettingError",
    "SnapshotError",
    "StartError",
    "StateError",
    "WalkEnv",
    "WalkVectorEnv",
    "__version__",
    "import_beogym",
    "make",
    "make_vec",
    "open_scene",
    "set_threads",
    "write_synthetic",
]

register()


def make(scene, **arguments) -> WalkEnv:
    """An environment on a scene: a path, `synthetic:NAME` or a `Scene`. Arguments are those of
    `WalkEnv`."""
    return WalkEnv(scene, **arguments)


def make_vec(scene, num_envs: int = 1, **arguments) -> WalkVectorEnv:
    """Many environments on a scene. Arguments are those of `WalkVectorEnv`."""
    return WalkVectorEnv(scene, num_envs, **arguments)
