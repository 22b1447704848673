"""The environments against Gymnasium's checker, scalar against vector, copies and processes."""

import copy
import pickle
import unittest
import warnings

import gymnasium
import numpy as np
import paws_sim
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from paws_sim.check import VectorEnvError, check_vector_env

TASKS = ("PointGoal", "FollowPath", "Velocity")
ROOM = paws_sim.open_scene("synthetic:room")
SHORT = {"end": {"time_limit_s": 1.5}, "task": {"goals": 4}}
IMAGES = ("rgb", "depth", "state")


def rows(env, steps):
    """Observations and rewards of a scalar environment."""
    out = []
    for _ in range(steps):
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        out.append((observation.tolist(), reward, info))
        if terminated or truncated:
            observation, info = env.reset()
            out.append((observation.tolist(), 0.0, info))
    return out


class Scalar(unittest.TestCase):
    def test_gymnasium_finds_nothing(self):
        for task in TASKS:
            for arguments in ({}, {"observation": IMAGES, "actions": "discrete"}):
                with self.subTest(task=task, **arguments), warnings.catch_warnings():
                    warnings.simplefilter("error")
                    env = gymnasium.make(f"paws_sim/{task}-v0", scene=ROOM, **arguments)
                    check_env(env.unwrapped)

    def test_info_has_the_same_numbers_in_every_step(self):
        env = paws_sim.make(ROOM, config=SHORT)
        _, info = env.reset(seed=0)
        types = {name: type(value) for name, value in info.items()}
        self.assertLessEqual(set(types.values()), {int, float, bool})
        for _, _, info in rows(env, 40):
            self.assertEqual({name: type(value) for name, value in info.items()}, types)

    def test_the_predicted_psnr_decides_starts_and_ends(self):
        # Few predictions: each costs an image.
        support = {"cell_m": 3.0, "headings": 2}
        make = lambda **config: paws_sim.make_vec(
            ROOM, 32, task="velocity", config={"support": support, **config}
        )
        env = make()
        _, info = env.reset(seed=0)
        predicted = np.sort(info["support_db"])
        self.assertGreater(predicted[0], 0.0)
        limit = float(predicted[16])
        self.assertLess(predicted[0], limit)
        env = make(start={"min_support_db": limit}, end={"min_support_db": limit})
        _, info = env.reset(seed=0)
        self.assertTrue((info["support_db"] >= limit).all())
        ends = 0
        for _ in range(60):
            _, _, terminated, truncated, info = env.step(env.action_space.sample())
            below = info["support_db"] < limit
            self.assertTrue((truncated | terminated)[below].all())
            ends += (info["end_reason"] == paws_sim.EndReason.DEVIATION).sum()
        self.assertGreater(ends, 0)
        env = make(start={"min_support_db": 199.0})
        with self.assertRaisesRegex(paws_sim.StartError, "support"):
            env.reset(seed=0)

    def test_bounds_are_finite_and_true(self):
        for task in ("point-goal", "follow-path", "velocity"):
            env = paws_sim.make(ROOM, task=task, config=SHORT)
            space = env.observation_space
            self.assertTrue(np.isfinite(space.low).all() and np.isfinite(space.high).all())
            self.assertTrue((space.low < space.high).all())
            observation, _ = env.reset(seed=3)
            for _ in range(100):
                self.assertTrue((space.low <= observation).all())
                self.assertTrue((observation <= space.high).all())
                observation, _, terminated, truncated, _ = env.step(env.action_space.sample())
                if terminated or truncated:
                    observation, _ = env.reset()

    def test_copies_go_on_with_the_same_bits(self):
        env = paws_sim.make(ROOM, config=SHORT)
        env.reset(seed=5)
        env.action_space.seed(1)
        rows(env, 7)
        others = (copy.deepcopy(env), pickle.loads(pickle.dumps(env)))
        expected = rows(env, 60)
        for other in others:
            self.assertEqual(rows(other, 60), expected)

    def test_a_snapshot_goes_on_elsewhere(self):
        env = paws_sim.make(ROOM, config=SHORT)
        env.reset(seed=5)
        env.step(np.array([1.0, 0.3]))
        snapshot = env.save()
        self.assertLessEqual(len(snapshot), 4096)
        expected = env.step(np.array([0.5, -0.3]))
        vector = paws_sim.make_vec(ROOM, 3, config=SHORT)
        vector.reset(seed=77)
        vector.restore(2, snapshot)
        found = vector.step(np.tile([0.5, -0.3], (3, 1)))
        np.testing.assert_array_equal(found[0][2], expected[0])
        self.assertEqual(found[1][2], expected[1])

    def test_a_picture_is_what_the_agent_sees(self):
        env = paws_sim.make(ROOM, render_mode="rgb_array", config=SHORT)
        env.reset(seed=0)
        image = env.render()
        self.assertEqual((image.shape, image.dtype), ((240, 320, 3), np.uint8))
        self.assertGreater(image.std(), 1.0)

    def test_a_matrix_of_intrinsics_is_a_lens(self):
        K = np.array([[40.0, 0.0, 23.5], [0.0, 40.0, 17.5], [0.0, 0.0, 1.0]])
        camera = {"width": 48, "height": 36, "K": K}
        env = paws_sim.make(ROOM, observation=IMAGES, camera=camera, config=SHORT)
        observation, _ = env.reset(seed=0)
        self.assertEqual(observation["rgb"].shape, (36, 48, 3))

    def test_each_pose_may_have_its_own_lens(self):
        cameras = paws_sim.Cameras(ROOM)
        poses = ROOM.reference_poses(0)[:3]
        K = np.tile(np.diag([40.0, 40.0, 1.0]), (3, 1, 1))
        K[:, 0, 2], K[:, 1, 2] = 23.5, 17.5
        K[1, 0, 0] = K[1, 1, 1] = 60.0
        together = cameras.render(poses, 48, 36, K=K)
        for number in range(3):
            alone = cameras.render(poses[number], 48, 36, K=K[number])
            for name, array in alone.items():
                np.testing.assert_array_equal(array[0], together[name][number])
        with self.assertRaises(paws_sim.SettingError):
            cameras.render(poses, 48, 36, K=K[:2])


class Vector(unittest.TestCase):
    def check(self, steps=120, **arguments):
        arguments = {"config": SHORT, **arguments}
        return check_vector_env(
            lambda mode: paws_sim.make_vec(ROOM, 3, autoreset_mode=mode, **arguments),
            lambda: paws_sim.make(ROOM, **arguments),
            steps=steps,
        )

    def test_it_equals_scalar_environments_in_all_modes(self):
        for task in ("point-goal", "follow-path", "velocity"):
            with self.subTest(task):
                ends = self.check(task=task)
                self.assertGreaterEqual(min(ends.values()), 10)

    def test_images_and_discrete_actions_too(self):
        camera = {"width": 32, "height": 24}
        self.check(steps=40, observation=IMAGES, actions="discrete", camera=camera)

    def test_more_environments_than_one_chunk_of_a_thread(self):
        many = paws_sim.make_vec(ROOM, 100, config=SHORT)
        few = paws_sim.make_vec(ROOM, 3, config=SHORT)
        (a, _), (b, _) = many.reset(seed=9), few.reset(seed=9)
        np.testing.assert_array_equal(a[:3], b)
        actions = np.full((100, 2), 0.7, np.float32)
        for _ in range(40):
            a, b = many.step(actions), few.step(actions[:3])
            np.testing.assert_array_equal(a[0][:3], b[0])
            np.testing.assert_array_equal(a[1][:3], b[1])

    def test_the_checker_finds_faults(self):
        class Late(paws_sim.WalkVectorEnv):
            def step(self, actions):
                observations, rewards, *others = super().step(actions)
                return observations, rewards + 1e-9, *others

        class Aliased(paws_sim.WalkVectorEnv):
            def __init__(self, *arguments, **named):
                super().__init__(*arguments, copy=False, **named)

            def step(self, actions):
                first = super().step(actions)
                self.kept = getattr(self, "kept", first[0])
                self.kept[:] = first[0]
                return (self.kept, *first[1:])

        for wrong in (Late, Aliased):
            with self.subTest(wrong.__name__), self.assertRaises(VectorEnvError):
                check_vector_env(
                    lambda mode, wrong=wrong: wrong(ROOM, 3, config=SHORT, autoreset_mode=mode),
                    lambda: paws_sim.make(ROOM, config=SHORT),
                )

    def test_registered_by_gymnasium(self):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            vector = gymnasium.make_vec("paws_sim/PointGoal-v0", 4, scene=ROOM)
        self.assertIs(vector.metadata["autoreset_mode"], AutoresetMode.NEXT_STEP)
        self.assertEqual(vector.unwrapped.spec.id, "paws_sim/PointGoal-v0")
        observations, _ = vector.reset(seed=0)
        self.assertIn(observations, vector.observation_space)
        vector.close()
        vector.close()

    def test_pickles_go_on_with_the_same_bits(self):
        vector = paws_sim.make_vec(ROOM, 4, config=SHORT)
        vector.reset(seed=1)
        actions = np.full((4, 2), 0.5)
        for _ in range(20):
            vector.step(actions)
        other = pickle.loads(pickle.dumps(vector))
        for _ in range(30):
            a, b = vector.step(actions), other.step(actions)
            for k in range(4):
                np.testing.assert_array_equal(a[k], b[k])

    def test_arrays_without_copies_alternate(self):
        vector = paws_sim.make_vec(ROOM, 4, config=SHORT, copy=False)
        first, _ = vector.reset(seed=1)
        kept = first.copy()
        second = vector.step(np.ones((4, 2)))[0]
        np.testing.assert_array_equal(first, kept)
        third = vector.step(np.ones((4, 2)))[0]
        self.assertIs(third, first)
        self.assertIsNot(second, first)

    def test_arrays_are_exchanged_by_dlpack(self):
        vector = paws_sim.make_vec(ROOM, 4, config=SHORT)
        observations, _ = vector.reset(seed=1)
        shared = np.from_dlpack(observations)
        np.testing.assert_array_equal(shared, observations)
        self.assertTrue(np.shares_memory(shared, observations))
        images = paws_sim.Cameras(ROOM).render(ROOM.reference_poses(0)[:2], 16, 16)
        self.assertTrue(np.shares_memory(np.from_dlpack(images["depth"]), images["depth"]))


class Processes(unittest.TestCase):
    def test_async_vector_env_with_fork_and_spawn(self):
        expected = paws_sim.make_vec("synthetic:room", 2, config=SHORT)
        first, _ = expected.reset(seed=3)
        actions = np.full((2, 2), 0.5, np.float32)
        after = expected.step(actions)
        for context in ("fork", "spawn"):
            with self.subTest(context), warnings.catch_warnings():
                warnings.simplefilter("ignore", DeprecationWarning)
                envs = gymnasium.vector.AsyncVectorEnv([make_short] * 2, context=context)
                observations, _ = envs.reset(seed=3)
                np.testing.assert_array_equal(observations, first)
                result = envs.step(actions)
                np.testing.assert_array_equal(result[0], after[0])
                np.testing.assert_array_equal(result[1], after[1])
                envs.close()


def make_short():
    return paws_sim.make("synthetic:room", config=SHORT)


if __name__ == "__main__":
    unittest.main()
