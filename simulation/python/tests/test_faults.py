"""Every fault gives the error that names it, and the environment goes on."""

import importlib
import json
import os
import pathlib
import re
import signal
import sys
import tempfile
import threading
import time
import unittest
import warnings

import numpy as np
import paws_sim
from paws_sim import _core

ROOM = paws_sim.open_scene("synthetic:room")
SHORT = {"end": {"time_limit_s": 1.5}, "task": {"goals": 4}}
#: Time within which Ctrl-C is answered.
LIMIT_S = 0.1


def duration_s(call):
    begin = time.perf_counter()
    call()
    return time.perf_counter() - begin


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
        ):
            with self.subTest(pattern), self.assertRaisesRegex(paws_sim.SettingError, pattern):
                paws_sim.make(ROOM, **arguments)
        with self.assertRaisesRegex(paws_sim.SettingError, "synthetic"):
            paws_sim.open_scene("synthetic:moon")

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
        for _ in range(40):
            actions = np.full((3, 2), 0.6)
            np.testing.assert_allclose(vector.step(actions)[1], plain.step(actions)[1])

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

    def answers_ctrl_c(self, call, whole):
        """Ctrl-C ends a call that takes `whole` seconds long before its own end, in one of four
        tries: other programs may hold any of them up."""
        # A shell starts background jobs with SIGINT ignored.
        before = signal.signal(signal.SIGINT, signal.default_int_handler)
        self.addCleanup(signal.signal, signal.SIGINT, before)
        tries = []
        for _ in range(4):
            if whole < 4 * LIMIT_S:
                self.skipTest(f"a call takes {1e3 * whole:.0f} ms, too short to be interrupted")
            sent, late, is_answered = [], [], threading.Event()

            def interrupt():
                if is_answered.wait(0.2 * whole):
                    return
                sent.append(time.perf_counter())
                os.kill(os.getpid(), signal.SIGINT)
                late.append(time.perf_counter() - sent[0])
                # How late sleeps end that have nothing to do with the call.
                while not is_answered.is_set():
                    late.append(duration_s(lambda: time.sleep(0.01)) - 0.01)

            thread = threading.Thread(target=interrupt)
            took = None
            begin = time.perf_counter()
            thread.start()
            try:
                with self.assertRaises(KeyboardInterrupt):
                    call()
                    took = time.perf_counter() - begin
                    # The call was over before the signal, which must not come after this block.
                    time.sleep(60.0)
            finally:
                answer = time.perf_counter()
                is_answered.set()
                thread.join()
            if took is not None:
                whole = took
                continue
            limit = max(LIMIT_S, 0.25 * whole) + max(late)
            tries.append((answer - sent[0], limit, whole))
            if tries[-1][0] <= limit:
                break
        self.assertTrue(tries, "each call was over before the signal")
        wait, limit, whole = (1e3 * value for value in tries[-1])
        print(f"Ctrl-C answered after {wait:.0f} ms of {whole:.0f}, limit {limit:.0f}")
        self.assertLessEqual(wait, limit)

    def test_ctrl_c_ends_images(self):
        cameras = paws_sim.Cameras(ROOM)
        pose = ROOM.reference_poses(0)[0]
        # More than is rendered between two looks, so that the wait is ended and not the work.
        count = 64

        def render():
            cameras.render(np.tile(pose, (count, 1, 1)), 256, 256, quality="exact")

        # The first call loads Gaussians and starts threads.
        render()
        # At most 1 GB of images.
        while (whole := duration_s(render)) < 1.0 and count < 2048:
            count *= 2
        self.answers_ctrl_c(render, whole)
        self.assertEqual(cameras.render(pose, 16, 16)["rgb"].shape, (1, 16, 16, 3))

    def test_ctrl_c_ends_steps_and_resets(self):
        # Few environments too: what counts is how long a step takes.
        rays = {"observation": {"rays": 360, "scan_rows": 64, "scan_columns": 64}}
        slow = {**SHORT, **rays, "end": {"time_limit_s": 1e4}}
        n = 256
        vector = paws_sim.make_vec(ROOM, n, config=slow, task="velocity")
        vector.reset(seed=0)
        took = duration_s(lambda: vector.step(np.zeros((n, 2))))
        # Memory does not grow with the speed of the machine; a call may be too short then.
        n = min(4096, int(n * max(1.0, 1.0 / took)))
        vector = paws_sim.make_vec(ROOM, n, config=slow, task="velocity")
        vector.reset(seed=0)
        actions = np.zeros((n, 2))
        calls = {"step": lambda: vector.step(actions), "reset": lambda: vector.reset(seed=1)}
        for name, call in calls.items():
            # This one also waits for what the last signal left in the background.
            call()
            with self.subTest(name):
                self.answers_ctrl_c(call, duration_s(call))
        # What was interrupted is finished, and the next call has it.
        few = paws_sim.make_vec(ROOM, 3, config=slow, task="velocity")
        few.reset(seed=1)
        np.testing.assert_array_equal(vector.step(actions)[0][:3], few.step(actions[:3])[0])


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
