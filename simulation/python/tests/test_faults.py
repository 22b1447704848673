"""Every fault gives the error that names it, and the environment goes on."""

import fcntl
import importlib
import json
import os
import pathlib
import re
import signal
import sys
import tempfile
import threading
import unittest
import warnings

import numpy as np
import paws_sim
from paws_sim import _core

ROOM = paws_sim.open_scene("synthetic:room")
SHORT = {"end": {"time_limit_s": 1.5}, "task": {"goals": 4}}
# With one try some episodes have no start.
ONE_TRY = {
    "end": {"time_limit_s": 0.3, "max_deviation_m": 1.0},
    "start": {"max_tries": 1},
}


class Usable(unittest.TestCase):
    def setUp(self):
        self.vector = paws_sim.make_vec(ROOM, 3, config=SHORT)
        self.vector.reset(seed=0)

    def refused(self, error, pattern, call):
        """`call` is refused and changes no environment."""
        before = [self.vector.save(index) for index in range(3)]
        with self.assertRaisesRegex(error, pattern):
            call()
        self.assertEqual([self.vector.save(index) for index in range(3)], before)
        self.vector.step(np.zeros((3, 2)))

    def test_actions(self):
        for value in (np.nan, np.inf, -np.inf):
            actions = np.zeros((3, 2))
            actions[1, 1] = value
            self.refused(
                paws_sim.ActionError,
                "environment 1: found .* as component 1",
                lambda actions=actions: self.vector.step(actions),
            )
        for wrong in (np.zeros((2, 2)), np.zeros(6), np.zeros((3, 3)), "left", None):
            self.refused(ValueError, "actions", lambda wrong=wrong: self.vector.step(wrong))
        self.assertTrue(issubclass(paws_sim.ActionError, ValueError))

    def test_other_layouts_and_types_of_actions_are_copied(self):
        actions = np.linspace(-1, 1, 6).reshape(3, 2)
        other = paws_sim.make_vec(ROOM, 3, config=SHORT)
        other.reset(seed=0)
        expected = other.step(actions)[0]
        strided = np.zeros((6, 4))
        strided[::2, ::2] = actions
        for same in (strided[::2, ::2], np.asfortranarray(actions), actions.tolist()):
            self.vector.reset(seed=0)
            np.testing.assert_array_equal(self.vector.step(same)[0], expected)

    def test_actions_beyond_the_box_are_clipped_and_counted(self):
        _, _, _, _, info = self.vector.step(np.array([[2.0, 0.0], [0.0, 0.0], [-3.0, 1.5]]))
        self.assertEqual(info["clipped"].tolist(), [1, 0, 2])

    def test_discrete_actions(self):
        vector = paws_sim.make_vec(ROOM, 2, config=SHORT, actions="discrete")
        vector.reset(seed=0)
        for wrong in (np.array([0, 4]), np.array([0, -1]), np.array([0.5, 1.0])):
            with self.assertRaises(paws_sim.ActionError):
                vector.step(wrong)
        vector.step(np.array([0, 3]))

    def test_calls_out_of_order(self):
        with self.assertRaisesRegex(paws_sim.StateError, "before the first reset"):
            paws_sim.make(ROOM, config=SHORT).step(np.zeros(2))
        env = paws_sim.make(ROOM, config=SHORT)
        env.reset(seed=0)
        while True:
            _, _, terminated, truncated, _ = env.step(np.zeros(2))
            if terminated or truncated:
                break
        with self.assertRaisesRegex(paws_sim.StateError, "has ended and was not reset"):
            env.step(np.zeros(2))
        env.reset()
        env.step(np.zeros(2))
        env.close()
        env.close()
        for call in (env.reset, lambda: env.step(np.zeros(2)), env.save):
            with self.assertRaisesRegex(paws_sim.StateError, "closed"):
                call()

    def test_settings(self):
        for arguments, pattern in (
            ({"config": {"dt_s": -1.0}}, "dt_s"),
            ({"config": {"agent": {"radius": 1.0}}}, "radius"),
            ({"config": {"end": {"time_limit_s": "long"}}}, "time_limit_s|string"),
            ({"task": "fly"}, "task"),
            ({"observation": "smell"}, "observation"),
            ({"actions": np.zeros((2, 5))}, "actions"),
            ({"render_mode": "human"}, "render_mode"),
            ({"config": {"seed": 7}}, r"config.seed: found 7, expected none: `reset\(seed"),
            ({"config": {"environments": 5}}, "config.environments: found 5"),
            ({"camera": {"budget_bytes": 0}}, "camera.budget_bytes"),
            ({"camera": {"budget_bytes": 1.5}}, "camera.budget_bytes"),
        ):
            with self.subTest(pattern), self.assertRaisesRegex(paws_sim.SettingError, pattern):
                paws_sim.make(ROOM, **arguments)
        with self.assertRaisesRegex(paws_sim.SettingError, "synthetic"):
            paws_sim.open_scene("synthetic:moon")

    def test_seeds(self):
        seeds = lambda vector: vector._simulator.world.random_keys().tolist()
        for kind in (int, np.int64, np.uint8):
            self.vector.reset(seed=kind(5))
            self.assertEqual(seeds(self.vector), [[5, 0], [6, 0], [7, 0]])
            self.vector.reset(seed=np.array([1, 2, 3], np.uint8))
            self.assertEqual(seeds(self.vector), [[1, 0], [2, 0], [3, 0]])
            # None goes on with the next episode.
            self.vector.reset(seed=[kind(9), None, None])
            self.assertEqual(seeds(self.vector), [[9, 0], [2, 1], [3, 1]])
            env = paws_sim.make(ROOM, config=SHORT)
            env.reset(seed=kind(5))
            self.assertEqual(seeds(env), [[5, 0]])
        for wrong in (-1, 1.5, "one", 2**64, [1, 2], [1, 2, -3], [1, 2, 3.5]):
            with self.subTest(wrong):
                self.refused(
                    paws_sim.SettingError, "seed: found",
                    lambda wrong=wrong: self.vector.reset(seed=wrong),
                )

    def test_seeds_that_are_not_given_are_drawn(self):
        seeds = lambda vector: vector._simulator.world.random_keys()[:, 0].tolist()
        vector = paws_sim.make_vec(ROOM, 3, config=SHORT)
        vector.reset(seed=[5, None, None])
        self.assertEqual(seeds(vector)[0], 5)
        self.assertGreater(min(seeds(vector)[1:]), 2)
        vector = paws_sim.make_vec(ROOM, 3, config=SHORT)
        vector.reset(seed=5, options={"reset_mask": np.array([True, False, False])})
        vector.reset()
        # The seed that was given has its next episode.
        self.assertEqual(vector._simulator.world.random_keys()[0].tolist(), [5, 1])
        self.assertGreater(min(seeds(vector)[1:]), 2)

    def test_a_reset_with_and_without_seeds_that_fails_changes_nothing(self):
        has_start = {}
        for seed in range(200):
            env = paws_sim.make(ROOM, task="velocity", config=ONE_TRY)
            try:
                env.reset(seed=seed)
                has_start.setdefault(True, seed)
                env.reset()
            except paws_sim.StartError:
                # A start of its first episode and none of its next.
                if env._simulator.world.has_ended()[0]:
                    continue
                has_start[False] = seed
                break
        vector = paws_sim.make_vec(ROOM, 2, task="velocity", config=ONE_TRY)
        vector.reset(seed=[has_start[True], has_start[False]])
        vector.step(np.full((2, 2), 0.5))
        before = [vector.save(index) for index in range(2)]
        with self.assertRaises(paws_sim.StartError):
            vector.reset(seed=[has_start[True], None])
        self.assertEqual([vector.save(index) for index in range(2)], before)

    def test_agents_of_physics_outside(self):
        env = paws_sim.make(ROOM, config={**SHORT, "end": {"time_limit_s": 60.0}})
        env.reset(seed=0)
        state = env.states()
        target, angles = state["position_m"] + [0.05, 0.02, 0.0], [0.3, 0.0, 0.0]
        env.place(target, angles, [0.5, 0.0, 0.1])
        found = env.states()
        np.testing.assert_array_equal(found["position_m"], target)
        np.testing.assert_array_equal(found["angles_rad"], angles)
        np.testing.assert_array_equal(found["velocity"], [0.5, 0.0, 0.1])
        # The goal is where the observation has it.
        ahead = found["goal_m"] - target
        fields = env.observation_fields
        distance = np.hypot(*ahead[:2])
        self.assertIn(distance.astype(np.float32), env.observe()[fields["goal"]])
        self.assertEqual(sum(of.stop - of.start for of in fields.values()), len(env.observe()))
        pose, sector = env.camera_poses()
        self.assertEqual((pose.shape, sector), ((4, 4), 0))
        np.testing.assert_allclose(pose[:2, 3], target[:2], atol=1e-9)
        snapshot = env.save(b"gait")
        self.assertEqual(self.vector.restore(0, self.vector.save(1, b"of 1")), b"of 1")
        other = paws_sim.make_vec(ROOM, 2, config=env._arguments["config"])
        other.reset(seed=3)
        self.assertEqual(other.restore(1, snapshot), b"gait")
        np.testing.assert_array_equal(other.states()["goal_m"][1], found["goal_m"])
        other.place(0, target)
        np.testing.assert_array_equal(other.states()["position_m"], [target, target])
        velocity = paws_sim.make(ROOM, task="velocity", config=SHORT)
        velocity.reset(seed=0)
        self.assertTrue(np.isnan(velocity.states()["goal_m"]).all())
        for wrong, pattern in (
            (lambda: env.place([0.0, 0.0]), r"position_m: found shape \(2,\)"),
            (lambda: env.place("here"), "position_m"),
            (lambda: env.place(target, level=9), "level 9 of sector 0"),
            (lambda: env.place(target, sector=3), "level 0 of sector 3"),
            (lambda: other.place(2, target), "environment"),
        ):
            with self.assertRaisesRegex(paws_sim.SettingError, pattern):
                wrong()
        env.place([np.nan, 0.0, 0.0])
        _, _, terminated, truncated, info = env.step(np.zeros(2))
        self.assertTrue(truncated and not terminated)
        self.assertEqual(info["end_reason"], paws_sim.EndReason.PHYSICS_FAULT)

    def test_one_class_of_snapshot_errors(self):
        from paws_sim import physics

        self.assertIs(physics.SnapshotError, paws_sim.SnapshotError)

    def test_a_vector_that_is_not_reset_by_itself_waits_for_its_caller(self):
        vector = paws_sim.make_vec(ROOM, 3, config=SHORT, autoreset_mode="Disabled")
        with self.assertRaisesRegex(paws_sim.StateError, "before the first reset"):
            vector.step(np.zeros((3, 2)))
        vector.reset(seed=0)
        ended = np.zeros(3, np.bool_)
        while not ended.any():
            _, _, terminated, truncated, _ = vector.step(np.zeros((3, 2)))
            ended = terminated | truncated
        before = [vector.save(index) for index in range(3)]
        first = int(ended.argmax())
        with self.assertRaisesRegex(paws_sim.StateError, f"environment {first} has ended"):
            vector.step(np.zeros((3, 2)))
        self.assertEqual([vector.save(index) for index in range(3)], before)
        vector.reset(options={"reset_mask": ended})
        vector.step(np.zeros((3, 2)))

    def test_scenes(self):
        with tempfile.TemporaryDirectory() as folder:
            for wrong in (folder, os.path.join(folder, "absent.scene")):
                with self.assertRaises(paws_sim.SceneError):
                    paws_sim.open_scene(wrong)

    def test_damaged_scenes_are_refused_when_they_are_opened(self):
        def flip(content):
            middle = len(content) // 2
            return content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]

        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder) / "room.scene"
            paws_sim.write_synthetic("room", str(path))
            whole = paws_sim.open_scene(path).hash
            for output, ending in (
                ("splats", ".ply"),
                ("maps", "elevation.npy"),
                ("trajectory", "trajectory.npy"),
                ("contacts", "contacts.npy"),
                ("rig", "rig.json"),
            ):
                (file,) = (
                    found
                    for found in sorted(path.glob(f"{output}.*/**/*"))
                    if found.name.endswith(ending)
                )
                content = file.read_bytes()
                for damage in (flip, lambda content: content[:-7], None):
                    if damage is None:
                        file.unlink()
                    else:
                        file.write_bytes(damage(content))
                    with self.subTest(file.name, damage=damage):
                        with self.assertRaises(paws_sim.SceneError) as caught:
                            paws_sim.make(path)
                        self.assertIn(f"output {output}", str(caught.exception))
                        self.assertIn(file.name, str(caught.exception))
                    file.write_bytes(content)
            (path / "scene.json").write_text("{")
            with self.assertRaises(paws_sim.SceneError):
                paws_sim.open_scene(path)
        self.assertEqual(len(whole), 64)

    def test_no_start(self):
        config = {**SHORT, "start": {"min_clearance_m": 50.0}}
        env = paws_sim.make(ROOM, task="velocity", config=config)
        with self.assertRaisesRegex(paws_sim.StartError, "no start found in 0 tries"):
            env.reset(seed=0)
        # Each draw is excluded by a condition that is named with its count.
        config = {**SHORT, "start": {"max_tries": 40}, "end": {"max_deviation_m": 1e-4}}
        env = paws_sim.make(ROOM, task="velocity", config=config)
        with self.assertRaises(paws_sim.StartError) as caught:
            env.reset(seed=0)
        message = str(caught.exception)
        self.assertRegex(message, r"^no start found in 40 tries: .*too far from recorded cameras \d+")
        reasons = message.split(": ", 1)[1]
        self.assertEqual(sum(map(int, re.findall(r"\d+", reasons))), 40, message)
        with self.assertRaises(paws_sim.StateError):
            env.step(np.zeros(2))

    def test_who_leaves_the_map_is_cut_off_and_keeps_its_height(self):
        # On a slope no height but that of the origin is 0.
        scene = paws_sim.open_scene("synthetic:tilted-plane")
        config = {"end": {"time_limit_s": 60.0, "max_deviation_m": 100.0}}
        vector = paws_sim.make_vec(
            scene, 8, task="velocity", config=config, autoreset_mode="Disabled"
        )
        vector.reset(seed=0)
        names, heights = {}, []
        for _ in range(300):
            _, _, terminated, truncated, info = vector.step(np.tile([1.0, 0.0], (8, 1)))
            states = vector.states()
            x, y, z = states["position_m"].T
            np.testing.assert_allclose(z, 0.1 * x + 0.05 * y, atol=0.02)
            heights.append(z.min())
            for index in np.flatnonzero(terminated | truncated):
                names[index] = paws_sim.EndReason(info["end_reason"][index]).name
                self.assertTrue(truncated[index] and not terminated[index])
            if (terminated | truncated).any():
                vector.reset(options={"reset_mask": terminated | truncated})
        self.assertLessEqual(set(names.values()), {"LEFT_MAP", "UNKNOWN_GROUND"})
        self.assertIn("LEFT_MAP", names.values())
        self.assertGreater(min(heights), 0.0)

    def test_budgets(self):
        cameras = paws_sim.Cameras(ROOM)
        poses = ROOM.reference_poses(0)[:1]
        with self.assertRaisesRegex(MemoryError, "bytes are needed"):
            cameras.render(np.tile(poses, (4, 1, 1)), 64, 64, max_bytes=1000)
        with self.assertRaisesRegex(paws_sim.BudgetError, "bytes are needed"):
            paws_sim.Cameras(ROOM, budget_bytes=10).render(poses)
        self.assertEqual(cameras.render(poses)["rgb"].shape, (1, 64, 64, 3))

    def test_cameras(self):
        cameras = paws_sim.Cameras(ROOM)
        poses = ROOM.reference_poses(0)
        skewed = poses[:1].copy()
        skewed[0, 0, 0] = np.nan
        for wrong, arguments in (
            (np.zeros((2, 3, 4)), {}),
            (skewed, {}),
            (poses[:1], {"fov": 4.0}),
            (poses[:1], {"sectors": [7]}),
            (poses[:1], {"colour": 1}),
        ):
            with self.assertRaises(paws_sim.SettingError):
                cameras.render(wrong, **arguments)
        one = cameras.render(poses[2], 48, 32)
        many = cameras.render(poses[:70], 48, 32)
        for name, values in one.items():
            np.testing.assert_array_equal(values[0], many[name][2])
        self.assertEqual(many["depth"].dtype, np.float32)
        K = [[24.0, 0.0, 23.5], [0.0, 24.0, 15.5], [0.0, 0.0, 1.0]]
        by_matrix = cameras.render(poses[2], 48, 32, K=K)
        np.testing.assert_allclose(by_matrix["depth"], one["depth"], atol=1e-4)
        cameras.close()
        cameras.close()
        with self.assertRaisesRegex(paws_sim.StateError, "closed"):
            cameras.render(poses[:1])

    def test_a_step_whose_autoreset_finds_no_start_is_not_repeated(self):
        # Some seeds have a start, and none for the next episode.
        start = lambda mode: paws_sim.make_vec(
            ROOM, 1, task="velocity", config=ONE_TRY, autoreset_mode=mode
        )
        seeds = {True: [], False: []}
        for seed in range(400):
            vector = start("Disabled")
            try:
                vector.reset(seed=seed)
            except paws_sim.StartError:
                continue
            try:
                vector.reset()
            except paws_sim.StartError:
                seeds[False].append(seed)
            else:
                seeds[True].append(seed)
            if min(map(len, seeds.values())) >= 2:
                break
        self.assertTrue(all(seeds.values()), seeds)
        both = [seeds[True][0], seeds[False][0]]
        actions = np.zeros((2, 2))
        for mode, steps in (("SameStep", 2), ("NextStep", 3)):
            vector = paws_sim.make_vec(
                ROOM, 2, task="velocity", config=ONE_TRY, autoreset_mode=mode
            )
            vector.reset(seed=both)
            for _ in range(steps):
                vector.step(actions)
            with self.subTest(mode):
                with self.assertRaisesRegex(paws_sim.StartError, "in 1 tries"):
                    vector.step(actions)
                refused = lambda: self.assertRaisesRegex(paws_sim.StateError, "reset all")
                with refused():
                    vector.step(actions)
                # A part of them is not enough: the results of the others are lost too.
                vector.reset(seed=both, options={"reset_mask": np.array([False, True])})
                with refused():
                    vector.step(actions)
                vector.reset(seed=both)
                for _ in range(steps):
                    _, _, _, truncated, info = vector.step(actions)
                self.assertEqual(truncated.tolist(), [mode == "NextStep"] * 2)
                self.assertEqual(info["steps"].tolist(), [steps] * 2)

    def test_snapshots(self):
        snapshot = self.vector.save(0)
        for at in range(len(snapshot)):
            damaged = bytearray(snapshot)
            damaged[at] ^= 1 << (at % 8)
            with self.assertRaises(paws_sim.SnapshotError):
                self.vector.restore(1, bytes(damaged))
        for length in range(len(snapshot)):
            with self.assertRaises(paws_sim.SnapshotError):
                self.vector.restore(1, snapshot[:length])
        other = paws_sim.make(ROOM, config={**SHORT, "dt_s": 0.2})
        with self.assertRaises(paws_sim.SnapshotError):
            other.reset(options={"snapshot": snapshot})
        stairs = paws_sim.make("synthetic:stairs", config=SHORT)
        with self.assertRaises(paws_sim.SnapshotError):
            stairs.restore(snapshot)
        self.vector.step(np.zeros((3, 2)))

    def test_rewards_of_the_user(self):
        class Broken(Exception):
            pass

        def raises(inputs):
            raise Broken

        for reward, error in (
            (raises, Broken),
            (lambda inputs: np.zeros(2), ValueError),
            (lambda inputs: np.full(3, np.nan), ValueError),
        ):
            vector = paws_sim.make_vec(ROOM, 3, config=SHORT, reward=reward)
            vector.reset(seed=0)
            for _ in range(2):
                with self.assertRaises(error):
                    vector.step(np.zeros((3, 2)))
        vector = paws_sim.make_vec(
            ROOM, 3, config=SHORT, reward=lambda inputs: 2.0 * inputs.terms["progress_m"]
        )
        plain = paws_sim.make_vec(ROOM, 3, config={**SHORT, "reward": {
            name: 2.0 if name == "progress" else 0.0
            for name in json.loads(vector._simulator.world.config)["reward"]
            if name != "tracking_sigma"
        }})
        vector.reset(seed=0), plain.reset(seed=0)
        some = False
        for _ in range(40):
            actions = np.full((3, 2), 0.6)
            rewards = vector.step(actions)[1]
            np.testing.assert_allclose(rewards, plain.step(actions)[1])
            some |= rewards.any()
        self.assertTrue(some)

    def test_rewards_of_the_user_are_of_the_step_before_an_autoreset(self):
        reward = lambda inputs: inputs.numbers["steps"] + 0.01 * np.abs(inputs.state).sum(axis=1)
        actions = np.array([[0.6, 0.1], [0.2, -0.4], [1.0, 0.5]])
        for mode in ("NextStep", "SameStep", "Disabled"):
            with self.subTest(mode):
                vector = paws_sim.make_vec(
                    ROOM, 3, config=SHORT, reward=reward, autoreset_mode=mode
                )
                vector.reset(seed=0)
                envs = [paws_sim.make(ROOM, config=SHORT, reward=reward) for _ in range(3)]
                for seed, env in enumerate(envs):
                    env.reset(seed=seed)
                ended, ends = np.zeros(3, np.bool_), 0
                for _ in range(40):
                    if mode == "Disabled" and ended.any():
                        vector.reset(options={"reset_mask": ended})
                    _, rewards, terminated, truncated, _ = vector.step(actions)
                    for index, env in enumerate(envs):
                        if ended[index]:
                            env.reset()
                            if mode == "NextStep":
                                self.assertEqual(rewards[index], 0.0)
                                continue
                        expected = env.step(actions[index])
                        self.assertGreater(expected[1], 1.0)
                        self.assertEqual(rewards[index], expected[1])
                    ended = terminated | truncated
                    ends += ended.sum()
                self.assertGreaterEqual(ends, 6)

    def test_rewards_of_the_user_after_restoring_an_end(self):
        reward = lambda inputs: inputs.numbers["steps"].astype(float)
        env = paws_sim.make(ROOM, config=SHORT)
        env.reset(seed=0)
        before = env.save()
        while not any(env.step(np.zeros(2))[2:4]):
            pass
        ended = env.save()
        for mode in ("NextStep", "SameStep"):
            with self.subTest(mode):
                vector = paws_sim.make_vec(
                    ROOM, 2, config=SHORT, reward=reward, autoreset_mode=mode
                )
                vector.reset(seed=5)
                vector.restore(0, ended)
                # The first step only begins an episode.
                _, rewards, terminated, truncated, info = vector.step(np.zeros((2, 2)))
                self.assertEqual(rewards.tolist(), [0.0, 1.0])
                self.assertEqual(info["steps"].tolist(), [0, 1])
                self.assertFalse(terminated.any() or truncated.any() or "final_obs" in info)
                for steps in (1, 2):
                    rewards = vector.step(np.zeros((2, 2)))[1]
                    self.assertEqual(rewards.tolist(), [steps, steps + 1])
                vector.restore(0, before)
                self.assertEqual(vector.step(np.zeros((2, 2)))[1].tolist(), [1.0, 4.0])

    def test_a_refused_step_changes_no_reward_of_the_user(self):
        reward = lambda inputs: inputs.numbers["steps"].astype(float)
        vector = paws_sim.make_vec(ROOM, 2, config=SHORT, reward=reward)
        vector.reset(seed=0)
        while not any(map(np.any, vector.step(np.zeros((2, 2)))[2:4])):
            pass
        with self.assertRaises(paws_sim.ActionError):
            vector.step(np.full((2, 2), np.nan))
        self.assertEqual(vector.step(np.zeros((2, 2)))[1].tolist(), [0.0, 0.0])
        self.assertEqual(vector.step(np.zeros((2, 2)))[1].tolist(), [1.0, 1.0])

    def test_optional_packages(self):
        for module, package, install in (
            ("sb3", "stable_baselines3", "stable-baselines3"),
            ("rsl_rl", "rsl_rl", "rsl-rl-lib"),
            ("physics.mujoco_scene", "mujoco", "mujoco"),
            ("physics.go2", "mujoco", "mujoco"),
        ):
            name = f"paws_sim.{module}"
            # None is a package that is not installed.
            kept = {of: sys.modules.pop(of) for of in list(sys.modules)
                    if of == name or of.split(".")[0] == package}
            sys.modules[package] = None
            try:
                with self.subTest(module), self.assertRaises(paws_sim.BackendMissing) as caught:
                    importlib.import_module(name)
                self.assertIsInstance(caught.exception, ImportError)
                self.assertEqual(caught.exception.name, install)
                self.assertIn(f"pip install {install}", str(caught.exception))
            finally:
                del sys.modules[package]
                sys.modules.pop(name, None)
                sys.modules.update(kept)

    def test_a_world_does_not_cross_a_fork(self):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            child = os.fork()
        if child == 0:
            code = 1
            try:
                self.vector.step(np.zeros((3, 2)))
            except paws_sim.StateError as error:
                code = 0 if "fork" in str(error) else 2
            try:
                fresh = paws_sim.make_vec(ROOM, 100, config=SHORT)
                fresh.reset(seed=0)
                fresh.step(np.zeros((100, 2)))
            except BaseException:
                code = 3
            os._exit(code)
        _, status = os.waitpid(child, 0)
        self.assertEqual(os.waitstatus_to_exitcode(status), 0)
        self.vector.step(np.zeros((3, 2)))

    def test_no_thread_before_the_first_reset(self):
        code = (
            "import os, paws_sim\n"
            "before = len(os.listdir('/proc/self/task'))\n"
            "scene = paws_sim._core.Scene\n"
            "vector = paws_sim.make_vec('synthetic:room', 64)\n"
            "paws_sim.Cameras(vector.scene)\n"
            "print(len(os.listdir('/proc/self/task')) - before)\n"
        )
        import subprocess
        import sys

        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
        self.assertEqual(done.stdout.strip(), "0", done.stderr)


def workers():
    """Number of threads of calls whose work has not ended; a call that waits for it ends its own."""
    names = []
    for task in os.listdir("/proc/self/task"):
        try:
            names.append(pathlib.Path(f"/proc/self/task/{task}/comm").read_text().strip())
        except OSError:
            # It has ended.
            continue
    return names.count("paws-sim work")


@unittest.skipUnless(os.path.exists("/proc/self/task"), "threads are listed from /proc")
class CtrlC(unittest.TestCase):
    """Ctrl-C ends the wait of a call before its work ends."""

    def setUp(self):
        # A shell starts background jobs with SIGINT ignored.
        before = signal.signal(signal.SIGINT, signal.default_int_handler)
        self.addCleanup(signal.signal, signal.SIGINT, before)

    def interrupt(self, call, count):
        """Ctrl-C in a call whose work is the `count`-th that has not ended."""
        is_over = threading.Event()

        def send():
            while workers() < count:
                if is_over.wait(0.001):
                    return
            os.kill(os.getpid(), signal.SIGINT)

        thread = threading.Thread(target=send)
        thread.start()
        try:
            with self.assertRaises(KeyboardInterrupt):
                call()
            self.assertEqual(workers(), count)
        finally:
            is_over.set()
            thread.join()

    def test_it_ends_the_opening_of_a_scene(self):
        with tempfile.NamedTemporaryFile("w", suffix=".json") as file:
            file.write("{}")
            file.flush()
            with self.assertRaisesRegex(paws_sim.SceneError, "scene file"):
                paws_sim.open_scene(file.name)
            # Who opens a file with a lease waits until it is given back.
            before = signal.signal(signal.SIGIO, signal.SIG_IGN)
            self.addCleanup(signal.signal, signal.SIGIO, before)
            try:
                fcntl.fcntl(file, fcntl.F_SETLEASE, fcntl.F_WRLCK)
            except OSError as error:
                self.skipTest(f"files in {tempfile.gettempdir()} have no leases: {error}")
            self.interrupt(lambda: paws_sim.open_scene(file.name), 1)
            fcntl.fcntl(file, fcntl.F_SETLEASE, fcntl.F_UNLCK)

    def test_it_ends_images_steps_and_resets(self):
        _core.set_threads(1)
        self.addCleanup(_core.set_threads, 0)
        cameras, pose = paws_sim.Cameras(ROOM), ROOM.reference_poses(0)[0]
        vector, other = (paws_sim.make_vec(ROOM, 3, config=SHORT) for _ in range(2))
        cameras.render(pose, 16, 16)
        vector.reset(seed=0)
        actions = np.full((3, 2), 0.5)
        # Seconds of work until its first look at the signal, and the others wait for its thread.
        poses = np.tile(pose, (64, 1, 1))
        render = lambda: cameras.render(poses, 384, 384, quality="exact")
        for count, call in enumerate(
            (render, lambda: vector.reset(seed=1), lambda: vector.step(actions)), 1
        ):
            self.interrupt(call, count)
        # What was interrupted is finished, and the next call has it.
        other.reset(seed=1)
        other.step(actions)
        np.testing.assert_array_equal(vector.step(actions)[0], other.step(actions)[0])
        self.assertEqual(cameras.render(pose, 16, 16)["rgb"].shape, (1, 16, 16, 3))


class Module(unittest.TestCase):
    def test_stubs_name_what_is_there(self):
        import ast
        import pathlib

        text = pathlib.Path(_core.__file__).with_name("_core.pyi").read_text()
        stubs = ast.parse(text).body
        classes = [node for node in stubs if isinstance(node, ast.ClassDef)]
        functions = [node for node in stubs if isinstance(node, ast.FunctionDef)]
        public = {name for name in vars(_core) if not name.startswith("_")}
        constants = [node for node in stubs if isinstance(node, ast.AnnAssign)]
        named = {node.name for node in (*classes, *functions)}
        named |= {node.target.id for node in constants} - {"__version__"}
        self.assertEqual(named, public)
        for node in classes:
            if issubclass(getattr(_core, node.name), BaseException):
                continue
            members = {of.name for of in node.body if isinstance(of, ast.FunctionDef)}
            found = {name for name in vars(getattr(_core, node.name)) if not name.startswith("_")}
            self.assertEqual(members - {"__init__"}, found, node.name)

    def test_end_reasons_are_those_of_the_core_and_the_stub_has_them(self):
        import ast
        import pathlib
        import pickle

        found = {reason.name: reason.value for reason in paws_sim.EndReason}
        self.assertEqual(found, _core.END_REASONS)
        self.assertEqual(paws_sim.EndReason(10).name, "TIME_LIMIT")
        for reason in paws_sim.EndReason:
            self.assertIs(pickle.loads(pickle.dumps(reason)), reason)
        text = pathlib.Path(paws_sim.__file__).with_name("end_reason.pyi").read_text()
        (stub,) = (node for node in ast.parse(text).body if isinstance(node, ast.ClassDef))
        members = [node for node in stub.body if isinstance(node, ast.Assign)]
        named = {node.targets[0].id: node.value.value for node in members}
        self.assertEqual(named, _core.END_REASONS)

    def test_threads_change_no_bit(self):
        results = []
        for threads in (1, 2, 4):
            _core.set_threads(threads)
            vector = paws_sim.make_vec(ROOM, 200, config=SHORT)
            vector.reset(seed=0)
            for _ in range(25):
                step = vector.step(np.full((200, 2), 0.8))
            results.append((step[0].tobytes(), step[1].tobytes()))
        _core.set_threads(0)
        self.assertEqual(len(set(results)), 1)


if __name__ == "__main__":
    unittest.main()
