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
# Goals are near, so that episodes terminate as well.
NEAR = {
    "end": {"time_limit_s": 2.0},
    "task": {"goals": 64, "goal_distance_m": [0.7, 3.0], "success_radius_m": 0.5},
}


def towards_goals(envs):
    """Actions that turn agents to their goals and walk on."""
    states = envs.states()
    ahead = states["goal_m"] - states["position_m"]
    bearing = np.arctan2(ahead[:, 1], ahead[:, 0]) - states["angles_rad"][:, 0]
    bearing = np.arctan2(np.sin(bearing), np.cos(bearing))
    return np.column_stack([np.cos(bearing).clip(0.0), bearing.clip(-1.0, 1.0)])


class StandInVecEnv:
    """The part of Stable-Baselines3's `VecEnv` that subclasses rely on."""

    def __init__(self, num_envs, observation_space, action_space):
        self.num_envs = num_envs
        self.observation_space = observation_space
        self.action_space = action_space
        self._reset_seeds()
        self._reset_options()
        self.render_mode = self.get_attr("render_mode")[0]
        self.metadata = {"render_modes": ["human", "rgb_array"] if self.render_mode else []}

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
        envs = sb3().VecEnv(ROOM, 3, config=NEAR)
        plain = paws_sim.make_vec(ROOM, 3, config=NEAR, autoreset_mode="SameStep")
        envs.seed(4)
        np.testing.assert_array_equal(envs.reset(), plain.reset(seed=4)[0])
        terminations = truncations = 0
        returns = np.zeros(3)
        for _ in range(120):
            actions = towards_goals(plain).astype(np.float32)
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
                terminations += expected[2][index]
                truncations += expected[3][index]
                self.assertEqual(infos[index]["is_success"], bool(expected[2][index]))
                np.testing.assert_array_equal(
                    infos[index]["terminal_observation"], expected[4]["final_obs"][index]
                )
                is_cut = bool(expected[3][index] and not expected[2][index])
                self.assertIs(infos[index]["TimeLimit.truncated"], is_cut)
                self.assertAlmostEqual(infos[index]["episode"]["r"], returns[index])
                returns[index] = 0.0
        self.assertGreaterEqual(min(terminations, truncations), 3)
        envs.close()
        envs.close()

    def test_methods_of_environments(self):
        envs = sb3().VecEnv(ROOM, 3, config=SHORT)
        envs.reset()
        snapshots = envs.env_method("save", indices=[0, 2])
        self.assertEqual(snapshots, [envs.envs.save(0), envs.envs.save(2)])
        self.assertEqual(envs.get_attr("num_envs"), [3, 3, 3])
        self.assertEqual(envs.env_is_wrapped(object), [False] * 3)
        self.assertEqual(envs.metadata["render_fps"], 10.0)
        self.assertEqual(envs.metadata["render_modes"], [])
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

    def test_time_outs_are_the_ends_that_are_no_end_of_the_task(self):
        envs = rsl_rl().VecEnv(ROOM, 4, config=NEAR, seed=4)
        plain = paws_sim.make_vec(ROOM, 4, config=NEAR, autoreset_mode="SameStep")
        plain.reset(seed=4)
        terminations = truncations = 0
        for _ in range(120):
            actions = towards_goals(plain)
            observations, rewards, dones, extras = envs.step(actions.view(Tensor))
            expected = plain.step(actions)
            np.testing.assert_array_equal(observations["policy"], expected[0])
            np.testing.assert_array_equal(rewards, expected[1].astype(np.float32))
            np.testing.assert_array_equal(dones, expected[2] | expected[3])
            np.testing.assert_array_equal(extras["time_outs"], expected[3])
            if dones.any():
                final = {name: expected[4]["final_info"][name][dones] for name in extras["log"]}
                self.assertEqual(set(final), {"is_success", "spl", "soft_spl"})
                for name, values in final.items():
                    self.assertAlmostEqual(extras["log"][name], values.mean())
                self.assertEqual(extras["log"]["is_success"], expected[2][dones].mean())
                self.assertEqual(extras["log"]["spl"] > 0.0, expected[2].any())
            else:
                self.assertEqual(extras["log"], {})
            terminations += expected[2].sum()
            truncations += expected[3].sum()
        self.assertGreaterEqual(min(terminations, truncations), 3)

    def test_observations_of_the_step_before_stay_without_copies(self):
        kept = []
        for copy in (True, False):
            envs = rsl_rl().VecEnv(ROOM, 4, config=SHORT, task="velocity", seed=2, copy=copy)
            envs.episode_length_buf = np.array([0, 7, 9, 3]).view(Tensor)
            kept.append([])
            for _ in range(12):
                # As the trainer stores it: by reference, and copied after the step.
                before = envs.get_observations()["policy"]
                envs.step(np.full((4, 2), 0.5).view(Tensor))
                kept[-1].append(before.copy())
        np.testing.assert_array_equal(*kept)

    def test_discrete_actions_are_refused(self):
        with self.assertRaisesRegex(ValueError, "continuous"):
            rsl_rl().VecEnv(ROOM, 2, config=SHORT, actions="discrete")


if __name__ == "__main__":
    unittest.main()
