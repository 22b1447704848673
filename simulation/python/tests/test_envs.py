"""The environments against Gymnasium's checker, scalar against vector, copies and processes."""

import copy
import pickle
import subprocess
import sys
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
# Episodes of few steps; agents are so fast that collisions terminate some.
ENDS = {
    "config": {
        "end": {"time_limit_s": 1.0, "collision_ends": True},
        "agent": {"max_speed_m_s": 6.0},
    },
    "task": "velocity",
}
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

    def test_a_picture_is_through_the_camera_of_the_agent(self):
        K = np.array([[60.0, 0.0, 30.0], [0.0, 50.0, 10.0], [0.0, 0.0, 1.0]])
        distortion = {"model": "radial2", "k1": -0.1, "k2": 0.01}
        camera = {"width": 48, "height": 32, "K": K, "distortion": distortion, "max_bytes": 20_000,
                  "exposure": {"gain": 0.7}, "shutter": {"line_s": 1e-3}}
        arguments = {"render_mode": "rgb_array", "config": SHORT, "camera": camera}
        env = paws_sim.make(ROOM, observation="rgb", **arguments)
        env.reset(seed=0)
        image = env.render()
        # The corner of the first pixel is the same.
        x, y = 320 / 48, 213 / 32
        film = np.diag([x, y, 1.0]) @ K
        film[:2, 2] += [0.5 * x - 0.5, 0.5 * y - 0.5]
        expected = paws_sim.Cameras(ROOM).render(
            env.camera_poses()[0], 320, 213, K=film, distortion=distortion, exposure={"gain": 0.7}
        )
        np.testing.assert_array_equal(image, expected["rgb"][0])
        # Without images among its observations it is the same.
        env = paws_sim.make(ROOM, **arguments)
        env.reset(seed=0)
        np.testing.assert_array_equal(env.render(), image)

    def test_the_memory_for_gaussians_is_a_setting_of_the_camera(self):
        camera = {"budget_bytes": 10, "width": 8, "height": 8}
        env = paws_sim.make(ROOM, observation="rgb", camera=camera, config=SHORT)
        with self.assertRaisesRegex(paws_sim.BudgetError, "bytes are needed"):
            env.reset(seed=0)
        env = paws_sim.make(ROOM, observation="rgb", camera={**camera, "budget_bytes": 2**30})
        env.reset(seed=0)

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


def on_step(change):
    """A vector environment whose results of steps are `change(env, *results)`, in which None are
    those of before."""

    class Faulty(paws_sim.WalkVectorEnv):
        def step(self, actions):
            results = super().step(actions)
            return tuple(
                before if after is None else after
                for before, after in zip(results, change(self, *results))
            )

    return Faulty


def on_info(change):
    """The same with `change(info)` of steps."""

    def of_step(env, observations, rewards, terminated, truncated, info):
        change(info)
        return (None,) * 5

    return on_step(of_step)


def on_reset(change):
    """The same with `change(reset, seed, options)` as its reset."""

    class Faulty(paws_sim.WalkVectorEnv):
        def reset(self, *, seed=None, options=None):
            return change(super().reset, seed, options)

    return Faulty


def on_constructor(change):
    """The same after `change(env)` in its constructor."""

    class Faulty(paws_sim.WalkVectorEnv):
        def __init__(self, *arguments, **named):
            super().__init__(*arguments, **named)
            change(self)

    return Faulty


def after_an_end(part):
    """Flags or rewards that are not 0 in the step after an end."""

    def change(env, *results):
        late = getattr(env, "late", np.zeros(3, np.bool_))
        env.late = results[2] | results[3]
        wrong = [None] * 5
        if env.autoreset_mode is NEXT:
            wrong[part] = np.where(late, results[part].dtype.type(1), results[part])
        return wrong

    return on_step(change)


def kept(part):
    """Results of a part in one array, or one dictionary, that each step writes into."""

    def change(env, *results):
        same = getattr(env, "same", results[part])
        env.same = same
        if isinstance(same, dict):
            same.update(results[part])
        else:
            same[:] = results[part]
        return [same if k == part else None for k in range(5)]

    return on_step(change)


def first_observations(env, observations, rewards, terminated, truncated, info):
    for index, ended in enumerate(info.get("_final_obs", ())):
        if ended:
            info["final_obs"][index] = observations[index]
    return (None,) * 5


def first_numbers(info):
    if "final_info" in info:
        info["final_info"] = {name: info[name] for name in info["final_info"]}


def swapped(env, observations, rewards, terminated, truncated, info):
    return None, None, truncated, terminated, None


def other_reset(reset, seed, options):
    observations, info = reset(seed=seed, options=options)
    return observations[::-1].copy(), info


def other_numbers(reset, seed, options):
    observations, info = reset(seed=seed, options=options)
    return observations, {**info, "steps": info["steps"] + 1}


def other_list(reset, seed, options):
    seed = [one + 1 for one in seed] if isinstance(seed, list) else seed
    return reset(seed=seed, options=options)


def without_mask(reset, seed, options):
    if options:
        mask = options["reset_mask"]
        # What is refused still is.
        reset(options=options)
        return reset(options={"reset_mask": np.ones_like(mask)})
    return reset(seed=seed)


def accepting(reset, seed, options):
    try:
        return reset(seed=seed, options=options)
    except (TypeError, ValueError):
        return reset()


NEXT, SAME, DISABLED = AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP, AutoresetMode.DISABLED
BOX = gymnasium.spaces.Box(-1.0, 1.0, (3,), np.float32)
ALL = (NEXT, SAME, DISABLED)
#: What is wrong, the message of the checker, and the modes in which it is wrong.
FAULTS = {
    "mode": (
        on_constructor(lambda env: env.metadata.pop("autoreset_mode")),
        "metadata has another autoreset_mode", ALL),
    "single observations": (
        on_constructor(lambda env: setattr(env, "single_observation_space", BOX)),
        "single_observation_space is not that of the scalar", ALL),
    "single actions": (
        on_constructor(lambda env: setattr(env, "single_action_space", BOX)),
        "single_action_space is not that of the scalar", ALL),
    "observation space": (
        on_constructor(lambda env: setattr(env, "observation_space", BOX)),
        "observation_space is not the batch", ALL),
    "action space": (
        on_constructor(lambda env: setattr(env, "action_space", BOX)),
        "action_space is not the batch", ALL),
    "reset": (on_reset(other_reset), "observation 0 of the reset", ALL),
    "info of a reset": (on_reset(other_numbers), "info the reset: steps is 1", ALL),
    "list of seeds": (on_reset(other_list), "a list of the same seeds", ALL),
    "one seed": (
        on_reset(lambda reset, seed, options: reset(
            seed=17 if isinstance(seed, int) else seed, options=options)),
        "another seed gives the same", ALL),
    "masked reset of all": (
        on_reset(without_mask), "environment 0 out of the mask|of a masked reset", ALL),
    "any mask": (on_reset(accepting), "reset_mask .* was accepted", ALL),
    "observation": (
        on_step(lambda env, observations, *_: (observations[::-1].copy(), *[None] * 4)),
        "observation of environment 0 in step 0", ALL),
    "bounds": (
        on_step(lambda env, observations, *_: (observations + 1e6, *[None] * 4)),
        "observations of step 0 out of space", ALL),
    "reward": (
        on_step(lambda env, observations, rewards, *_: (None, rewards + 1e-9, *[None] * 3)),
        "reward of environment 0 in step 0", ALL),
    "type of rewards": (
        on_step(lambda env, observations, rewards, *_: (None, rewards.astype(int), *[None] * 3)),
        "rewards of step 0: int64", ALL),
    "shape of rewards": (
        on_step(lambda env, observations, rewards, *_: (None, rewards[:1], *[None] * 3)),
        r"rewards of step 0: float64 \(1,\)", ALL),
    "terminated": (on_step(swapped), "terminated of environment", ALL),
    "truncated": (
        on_step(lambda env, *results: (None, None, None, np.zeros_like(results[3]), None)),
        "truncated of environment", ALL),
    "type of flags": (
        on_step(lambda env, *results: (None, None, results[2].astype(int), None, None)),
        "terminated of step 0: int64", ALL),
    "reward after an end": (after_an_end(1), "reward .* is not 0 after an end", (NEXT,)),
    "flag after an end": (after_an_end(3), "flags of environment .* after an end", (NEXT,)),
    "no final observation": (
        on_info(lambda info: info.pop("final_obs", None)),
        "final_obs .* present is False", (SAME,)),
    "final observation": (
        on_step(first_observations), "final_obs of environment .* not equal", (SAME,)),
    "mask of final numbers": (
        on_info(lambda info: "_final_info" in info and info["_final_info"].fill(False)),
        "final_info .* is masked", (SAME,)),
    "final numbers": (
        on_info(first_numbers), "info final_info of environment", (SAME,)),
    "missing number": (
        on_info(lambda info: info.pop("steps")), "steps is missing", ALL),
    "no mask": (on_info(lambda info: info.pop("_steps")), "steps has no mask", ALL),
    "type of a mask": (
        on_info(lambda info: info.update(_steps=info["_steps"].astype(int))),
        "mask of steps of step 0", ALL),
    "mask": (on_info(lambda info: info["_steps"].fill(False)), "steps is masked", ALL),
    "count of numbers": (
        on_info(lambda info: info.update(steps=info["steps"][:1])), "steps has 1 values", ALL),
    "number": (
        on_info(lambda info: info.update(steps=info["steps"] + 1)), "steps is 2, expected 1", ALL),
    "alias of observations": (kept(0), "observations kept from before step", ALL),
    "alias of rewards": (kept(1), "rewards kept from before step", ALL),
    "alias of terminated": (kept(2), "terminated kept from before step", ALL),
    "alias of truncated": (kept(3), "truncated kept from before step", ALL),
    "alias of infos": (kept(4), "infos kept from before step", ALL),
}


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

    def test_the_checker_names_each_fault(self):
        for name, (faulty, message, modes) in FAULTS.items():
            for mode in ALL:
                check = lambda mode=mode: check_vector_env(
                    lambda mode: faulty(ROOM, 3, autoreset_mode=mode, **ENDS),
                    lambda: paws_sim.make(ROOM, **ENDS),
                    modes=(mode,),
                    steps=40,
                )
                with self.subTest(name, mode=mode):
                    if mode not in modes:
                        check()
                        continue
                    with self.assertRaisesRegex(VectorEnvError, message):
                        check()

    def test_the_checker_requires_ends(self):
        with self.assertRaisesRegex(VectorEnvError, "0 ends in 5 steps, at least 2"):
            self.check(steps=5)

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

    def test_subclasses_with_their_own_constructor_are_copied(self):
        for env in (Room(4), Rooms(4)):
            env.reset(seed=3)
            expected = env.save(*env.indices)
            for other in (copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
                self.assertIs(type(other), type(env))
                self.assertEqual(other.limit, 4)
                self.assertEqual(other.save(*env.indices), expected)

    def test_copies_before_the_first_reset_start_nothing(self):
        code = (
            "import os, pickle, paws_sim\n"
            "threads = lambda: len(os.listdir('/proc/self/task'))\n"
            "scene = paws_sim.open_scene('synthetic:room')\n"
            "before = threads()\n"
            "few = {'task': {'goals': 2}}\n"
            "envs = [paws_sim.make(scene, config=few), paws_sim.make_vec(scene, 2, config=few)]\n"
            "for _ in range(2): envs = [pickle.loads(pickle.dumps(env)) for env in envs]\n"
            "print(threads() - before)\n"
            "if os.fork() == 0:\n"
            "    for env in envs: env.reset(seed=1)\n"
            "    os._exit(0)\n"
            "print(os.wait()[1])\n"
        )
        result = subprocess.run(
            [sys.executable, "-W", "ignore", "-c", code], capture_output=True, text=True
        )
        self.assertEqual(result.stdout.split(), ["0", "0"], result.stderr)

    def test_a_copy_before_the_first_reset_draws_its_seed(self):
        env = pickle.loads(pickle.dumps(paws_sim.make_vec(ROOM, 2, config=SHORT)))
        env.reset()
        self.assertNotEqual(env._simulator.world.random_keys()[:, 0].tolist(), [0, 1])

    def test_what_its_constructor_refused_is_closed(self):
        env = paws_sim.WalkVectorEnv.__new__(paws_sim.WalkVectorEnv)
        with self.assertRaises(paws_sim.SettingError):
            env.__init__(ROOM, 2, task="fly")
        self.assertTrue(env.closed)
        env.close()
        env.__init__(ROOM, 2, config=SHORT)
        self.assertFalse(env.closed)
        env.close()
        self.assertTrue(env.closed)

    def test_arrays_without_copies_alternate(self):
        vector = paws_sim.make_vec(ROOM, 4, config=SHORT, copy=False)
        first, _ = vector.reset(seed=1)
        kept = first.copy()
        second = vector.step(np.ones((4, 2)))[0]
        np.testing.assert_array_equal(first, kept)
        third = vector.step(np.ones((4, 2)))[0]
        self.assertIs(third, first)
        self.assertIsNot(second, first)

    def test_a_reset_leaves_the_array_of_the_step_before(self):
        vector = paws_sim.make_vec(ROOM, 4, config=SHORT, copy=False)
        vector.reset(seed=1)
        first = vector.step(np.ones((4, 2)))[0]
        kept = first.copy()
        second = vector.step(np.ones((4, 2)))[0]
        mask = np.array([True, False, False, False])
        again, _ = vector.reset(options={"reset_mask": mask})
        self.assertIs(again, second)
        self.assertIs(vector.observe(), second)
        np.testing.assert_array_equal(first, kept)
        self.assertIs(vector.step(np.ones((4, 2)))[0], first)

    def test_arrays_are_exchanged_by_dlpack(self):
        vector = paws_sim.make_vec(ROOM, 4, config=SHORT)
        observations, _ = vector.reset(seed=1)
        shared = np.from_dlpack(observations)
        np.testing.assert_array_equal(shared, observations)
        self.assertTrue(np.shares_memory(shared, observations))
        images = paws_sim.Cameras(ROOM).render(ROOM.reference_poses(0)[:2], 16, 16)
        self.assertTrue(np.shares_memory(np.from_dlpack(images["depth"]), images["depth"]))


class Room(paws_sim.WalkEnv):
    indices = ()

    def __init__(self, limit):
        super().__init__(ROOM, config=SHORT, max_episode_steps=limit)
        self.limit = limit


class Rooms(paws_sim.WalkVectorEnv):
    indices = (1,)

    def __init__(self, limit):
        super().__init__(ROOM, 2, config=SHORT, max_episode_steps=limit)
        self.limit = limit


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
