"""A checker for vector environments: what `gymnasium.utils.env_checker` is for scalar ones.

`check_vector_env` steps a vector environment beside scalar environments of the seeds s + i and
compares everything, for each autoreset mode. It works with any vector environment whose i-th
environment equals a scalar one, not only with those of this package.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv


_RESULTS = ("observations", "rewards", "terminated", "truncated", "infos")


class VectorEnvError(AssertionError):
    """A vector environment that does not do what Gymnasium's interface says."""


def check_vector_env(
    make_vector: Callable[[AutoresetMode], VectorEnv],
    make_scalar: Callable[[], gymnasium.Env],
    *,
    modes=tuple(AutoresetMode),
    seed: int = 17,
    steps: int = 200,
    min_ends: int = 2,
) -> dict[AutoresetMode, int]:
    """Checks a vector environment in all modes, and returns the number of ends that each saw.

    `make_vector` is called with a mode, `make_scalar` for each environment. Fewer ends than
    `min_ends` are an error: what follows an end was not checked then.
    """
    return {
        mode: _check_mode(make_vector(mode), make_scalar, mode, seed, steps, min_ends)
        for mode in modes
    }


def _check_mode(vector, make_scalar, mode, seed, steps, min_ends) -> int:
    scalars = [make_scalar() for _ in range(vector.num_envs)]
    try:
        _check_spaces(vector, scalars[0], mode)
        ends = _compare(vector, scalars, mode, seed, steps)
        _require(ends >= min_ends, f"{ends} ends in {steps} steps, at least {min_ends} are needed")
        _check_seeds(vector, seed)
        _check_mask(vector, seed)
    finally:
        for env in scalars:
            env.close()
        vector.close()
    vector.close()
    return ends


def _check_spaces(vector, scalar, mode) -> None:
    _require(
        vector.metadata.get("autoreset_mode") is mode, "metadata has another autoreset_mode"
    )
    _require(
        vector.single_observation_space == scalar.observation_space,
        "single_observation_space is not that of the scalar environment",
    )
    _require(
        vector.single_action_space == scalar.action_space,
        "single_action_space is not that of the scalar environment",
    )
    batch = gymnasium.vector.utils.batch_space
    for name in ("observation", "action"):
        single = getattr(vector, f"single_{name}_space")
        _require(
            getattr(vector, f"{name}_space") == batch(single, vector.num_envs),
            f"{name}_space is not the batch of single_{name}_space",
        )


def _compare(vector, scalars, mode, seed, steps) -> int:
    n = vector.num_envs
    generator = np.random.default_rng(seed)
    vector.action_space.seed(seed)
    observations, infos = vector.reset(seed=seed)
    for index, env in enumerate(scalars):
        observation, info = env.reset(seed=seed + index)
        _equal(_row(observations, index), observation, f"observation {index} of the reset")
        _same_info(infos, info, index, "the reset")
    ended, ends, before = np.zeros(n, np.bool_), 0, []
    for number in range(steps):
        if mode == AutoresetMode.DISABLED and ended.any():
            ended = _reset_by_mask(vector, scalars, ended, generator)
        actions = vector.action_space.sample()
        result = vector.step(actions)
        where = f"step {number}"
        _check_result(vector, result, where)
        observations, rewards, terminated, truncated, infos = result
        for index, env in enumerate(scalars):
            what = f"of environment {index} in {where}"
            if mode == AutoresetMode.NEXT_STEP and ended[index]:
                observation, info = env.reset()
                _require(rewards[index] == 0.0, f"reward {what} is not 0 after an end")
                _require(
                    not terminated[index] and not truncated[index], f"flags {what} after an end"
                )
            else:
                observation, reward, end, cut, info = env.step(_row(actions, index))
                _require(rewards[index] == reward, f"reward {what}: {rewards[index]}, {reward}")
                _require(terminated[index] == end, f"terminated {what}")
                _require(truncated[index] == cut, f"truncated {what}")
                is_final = mode == AutoresetMode.SAME_STEP and (end or cut)
                _check_final(infos, index, is_final, observation, info, what)
                if is_final:
                    observation, info = env.reset()
            _equal(_row(observations, index), observation, f"observation {what}")
            _same_info(infos, info, index, what)
        ended = terminated | truncated
        ends += int(ended.sum())
        for name, values, copied in before:
            _equal(values, copied, f"{name} kept from before {where}: an alias")
        before = [(name, values, copy.deepcopy(values)) for name, values in zip(_RESULTS, result)]
    return ends


def _reset_by_mask(vector, scalars, ended, generator):
    """Resets those that ended and, now and then, one that runs."""
    mask = ended.copy()
    if generator.random() < 0.3:
        mask[generator.integers(len(mask))] = True
    observations, infos = vector.reset(options={"reset_mask": mask})
    for index in np.flatnonzero(mask):
        observation, info = scalars[index].reset()
        _equal(_row(observations, index), observation, f"observation {index} of a masked reset")
        _same_info(infos, info, index, "a masked reset")
    return np.zeros_like(ended)


def _check_result(vector, result, where) -> None:
    observations, rewards, terminated, truncated, infos = result
    n = vector.num_envs
    _require(observations in vector.observation_space, f"observations of {where} out of space")
    _require(
        rewards.shape == (n,) and np.issubdtype(rewards.dtype, np.floating),
        f"rewards of {where}: {rewards.dtype} {rewards.shape}",
    )
    for name, flags in (("terminated", terminated), ("truncated", truncated)):
        _require(
            flags.shape == (n,) and flags.dtype == np.bool_,
            f"{name} of {where}: {flags.dtype} {flags.shape}",
        )
    _check_masks(infos, n, where)


def _check_masks(infos: dict[str, Any], n: int, where: str) -> None:
    for name, values in infos.items():
        if name.startswith("_"):
            continue
        mask = infos.get(f"_{name}")
        _require(mask is not None, f"info of {where}: {name} has no mask")
        _require(mask.shape == (n,) and mask.dtype == np.bool_, f"mask of {name} of {where}")
        if isinstance(values, dict):
            _check_masks(values, n, f"{name} of {where}")
        else:
            _require(len(values) == n, f"info of {where}: {name} has {len(values)} values")


def _check_final(infos, index, is_final, observation, info, what) -> None:
    has_final = "final_obs" in infos and bool(infos["_final_obs"][index])
    _require(has_final == is_final, f"final_obs {what}: present is {has_final}")
    if is_final:
        _equal(infos["final_obs"][index], observation, f"final_obs {what}")
        _require(bool(infos["_final_info"][index]), f"final_info {what} is masked")
        _same_info(infos["final_info"], info, index, f"final_info {what}")


def _check_seeds(vector, seed) -> None:
    first, _ = vector.reset(seed=seed)
    first = copy.deepcopy(first)
    again, _ = vector.reset(seed=[seed + index for index in range(vector.num_envs)])
    _equal(again, first, "a reset with a list of the same seeds")
    other, _ = vector.reset(seed=seed + 1000)
    _require(not _is_equal(other, first), "another seed gives the same observations")


def _check_mask(vector, seed) -> None:
    before, _ = vector.reset(seed=seed)
    before = copy.deepcopy(before)
    mask = np.zeros(vector.num_envs, np.bool_)
    mask[-1] = True
    after, _ = vector.reset(options={"reset_mask": mask})
    for index in range(vector.num_envs - 1):
        _equal(_row(after, index), _row(before, index), f"environment {index} out of the mask")
    for wrong in (np.zeros_like(mask), mask.astype(np.int8), mask[:-1], mask.tolist()):
        try:
            vector.reset(options={"reset_mask": wrong})
        except (TypeError, ValueError, AssertionError):
            continue
        raise VectorEnvError(f"reset_mask {wrong!r} was accepted")


def _same_info(infos, info, index, what) -> None:
    for name, value in info.items():
        _require(name in infos, f"info {what}: {name} is missing")
        _require(bool(infos[f"_{name}"][index]), f"info {what}: {name} is masked")
        found = infos[name][index]
        _require(found == value, f"info {what}: {name} is {found}, expected {value}")


def _row(batch, index):
    if isinstance(batch, dict):
        return {name: _row(values, index) for name, values in batch.items()}
    if isinstance(batch, tuple):
        return tuple(_row(values, index) for values in batch)
    return batch[index]


def _is_equal(a, b) -> bool:
    if a is None or b is None:
        return a is b
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(_is_equal(a[name], b[name]) for name in a)
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(_is_equal, a, b))
    a, b = np.asarray(a), np.asarray(b)
    if a.dtype == b.dtype == object and a.ndim > 0:
        return len(a) == len(b) and all(map(_is_equal, a, b))
    return a.shape == b.shape and a.dtype == b.dtype and np.array_equal(a, b)


def _equal(a, b, what) -> None:
    _require(_is_equal(a, b), f"{what}: not equal")


def _require(condition, what) -> None:
    if not condition:
        raise VectorEnvError(what)
