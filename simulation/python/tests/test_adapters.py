"""The adapters of trainers against stand-ins of their interfaces: the trainers are not installed
where tests run."""

import importlib
import sys
import types
import unittest
from unittest import mock

import numpy as np
import paws_sim

ROOM = paws_sim.open_scene("synthetic:room")
SHORT = {"end": {"time_limit_s": 1.0}, "task": {"goals": 4}}


class StandInVecEnv:
    """The part of Stable-Baselines3's `VecEnv` that subclasses rely on."""

    def __init__(self, num_envs, observation_space, action_space):
        self.num_envs = num_envs
        self.observation_space = observation_space
        self.action_space = action_space
        self._reset_seeds()
        self._reset_options()

    def _reset_seeds(self):
        self._seeds = [None] * self.num_envs

    def _reset_options(self):
        self._options = [{}] * self.num_envs

    def _get_indices(self, indices):
        if indices is None:
            return range(self.num_envs)
        return [indices] if isinstance(indices, int) else indices

    def seed(self, seed):
        self._seeds = [seed + index for index in range(self.num_envs)]

    def step(self, actions):
        self.step_async(actions)
        return self.step_wait()


class Tensor(np.ndarray):
    """Arrays with the methods of tensors that the adapter uses."""

    def detach(self):
        return self

    def cpu(self):
        return self

    def numpy(self):
        return np.asarray(self)


def tensor(values, device=None, dtype=None):
    return np.asarray(values, dtype).view(Tensor)


def imported(name, modules):
    """A module of the package that sees stand-ins, without a trace of them afterwards."""
    with mock.patch.dict(sys.modules, modules):
        sys.modules.pop(name, None)
        module = importlib.import_module(name)
        sys.modules.pop(name)
        return module


def sb3():
    return imported(
        "paws_sim.sb3",
        {
            "stable_baselines3": types.ModuleType("stable_baselines3"),
            "stable_baselines3.common": types.ModuleType("common"),
            "stable_baselines3.common.vec_env": types.SimpleNamespace(VecEnv=StandInVecEnv),
        },
    )


def rsl_rl():
    torch = types.SimpleNamespace(
        Tensor=Tensor,
        as_tensor=tensor,
        zeros=lambda n, dtype, device: np.zeros(n, dtype).view(Tensor),
        long=np.int64,
        float32=np.float32,
    )
    groups = types.SimpleNamespace(TensorDict=lambda of, batch_size, device: of)
    return imported(
        "paws_sim.rsl_rl",
        {
            "torch": torch,
            "tensordict": groups,
            "rsl_rl": types.ModuleType("rsl_rl"),
            "rsl_rl.env": types.SimpleNamespace(VecEnv=object),
        },
    )


class StableBaselines3(unittest.TestCase):
    def test_it_steps_as_the_vector_environment_does(self):
        envs = sb3().VecEnv(ROOM, 3, config=SHORT)
        plain = paws_sim.make_vec(ROOM, 3, config=SHORT, autoreset_mode="SameStep")
        envs.seed(4)
        np.testing.assert_array_equal(envs.reset(), plain.reset(seed=4)[0])
        ends = 0
        returns = np.zeros(3)
        for _ in range(35):
            actions = np.full((3, 2), 0.9, np.float32)
            observations, rewards, dones, infos = envs.step(actions)
            expected = plain.step(actions)
            returns += expected[1]
            np.testing.assert_array_equal(observations, expected[0])
            np.testing.assert_array_equal(rewards, expected[1].astype(np.float32))
            np.testing.assert_array_equal(dones, expected[2] | expected[3])
            for index in range(3):
                self.assertEqual("terminal_observation" in infos[index], bool(dones[index]))
                if not dones[index]:
                    continue
                ends += 1
                np.testing.assert_array_equal(
                    infos[index]["terminal_observation"], expected[4]["final_obs"][index]
                )
                is_cut = bool(expected[3][index] and not expected[2][index])
                self.assertIs(infos[index]["TimeLimit.truncated"], is_cut)
                self.assertAlmostEqual(infos[index]["episode"]["r"], returns[index])
                returns[index] = 0.0
        self.assertGreaterEqual(ends, 9)
        envs.close()
        envs.close()

    def test_methods_of_environments(self):
        envs = sb3().VecEnv(ROOM, 3, config=SHORT)
        envs.reset()
        snapshots = envs.env_method("save", indices=[0, 2])
        self.assertEqual(snapshots, [envs.envs.save(0), envs.envs.save(2)])
        self.assertEqual(envs.get_attr("num_envs"), [3, 3, 3])
        self.assertEqual(envs.env_is_wrapped(object), [False] * 3)
        with self.assertRaises(AttributeError):
            envs.set_attr("num_envs", 4)


class RslRl(unittest.TestCase):
    def test_it_cuts_where_the_runner_set_the_time(self):
        envs = rsl_rl().VecEnv(ROOM, 4, config=SHORT, task="velocity", seed=2)
        self.assertEqual((envs.num_actions, envs.max_episode_length), (2, 10))
        envs.episode_length_buf = np.array([0, 7, 9, 3]).view(Tensor)
        cut = []
        for _ in range(10):
            before = envs.get_observations()["policy"]
            observations, rewards, dones, extras = envs.step(np.zeros((4, 2)).view(Tensor))
            self.assertEqual((rewards.dtype, rewards.shape), (np.float32, (4,)))
            self.assertFalse(np.shares_memory(before, observations["policy"]))
            np.testing.assert_array_equal(np.asarray(dones), np.asarray(extras["time_outs"]))
            np.testing.assert_array_equal(envs.episode_length_buf[np.asarray(dones)], 0)
            cut.append(np.flatnonzero(dones).tolist())
        self.assertEqual(cut, [[2], [], [1], [], [], [], [3], [], [], [0]])
        envs.close()
        envs.close()

    def test_discrete_actions_are_refused(self):
        with self.assertRaisesRegex(ValueError, "continuous"):
            rsl_rl().VecEnv(ROOM, 2, config=SHORT, actions="discrete")


if __name__ == "__main__":
    unittest.main()
