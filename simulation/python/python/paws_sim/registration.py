"""Ids for `gymnasium.make` and `gymnasium.make_vec`."""

from __future__ import annotations

import gymnasium

_TASKS = {
    "paws_sim/PointGoal-v0": "point-goal",
    "paws_sim/FollowPath-v0": "follow-path",
    "paws_sim/Velocity-v0": "velocity",
}


def register() -> None:
    """Registers the ids. Without an argument `scene` they are on a synthetic room."""
    for name, task in _TASKS.items():
        if name not in gymnasium.registry:
            gymnasium.register(
                name,
                entry_point="paws_sim.walk_env:WalkEnv",
                vector_entry_point="paws_sim.walk_vector_env:WalkVectorEnv",
                kwargs={"task": task},
            )
