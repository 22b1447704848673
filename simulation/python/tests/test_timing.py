"""Images that are late and have a rate of their own."""

import pickle
import unittest

import numpy as np
import paws_sim
from gymnasium.vector import AutoresetMode
from paws_sim import _core
from paws_sim.check import check_vector_env

ROOM = paws_sim.open_scene("synthetic:room")
SHORT = {"end": {"time_limit_s": 1.5}, "task": {"goals": 4}}
IMAGES = ("rgb", "depth", "state")
SMALL = {"width": 24, "height": 18}


def vector(timing=None, n=3, **arguments):
    camera = SMALL if timing is None else {**SMALL, "timing": timing}
    arguments = {"observation": IMAGES, "config": SHORT, **arguments}
    return paws_sim.make_vec(ROOM, n, camera=camera, **arguments)


class Timing(unittest.TestCase):
    def test_images_two_steps_late_are_those_of_two_steps_before(self):
        late, plain = vector({"latency_s": [0.2, 0.2]}), vector()
        mode = plain.metadata["autoreset_mode"]
        self.assertIs(mode, AutoresetMode.NEXT_STEP)
        shown, history = late.reset(seed=3)[0], [plain.reset(seed=3)[0]]
        np.testing.assert_array_equal(shown["rgb"], history[0]["rgb"])
        differing = 0
        actions = np.tile([0.8, 0.6], (3, 1))
        for _ in range(40):
            a, b = late.step(actions), plain.step(actions)
            history.append(b[0])
            for k in (1, 2, 3):
                np.testing.assert_array_equal(a[k], b[k])
            np.testing.assert_array_equal(a[0]["state"], b[0]["state"])
            np.testing.assert_array_equal(b[4]["frame_age_s"], 0.0)
            for index, steps in enumerate(b[4]["steps"]):
                back = min(int(steps), 2)
                before = history[-1 - back]
                for part in ("rgb", "depth"):
                    np.testing.assert_array_equal(a[0][part][index], before[part][index])
                self.assertAlmostEqual(a[4]["frame_age_s"][index], 0.1 * back, 6)
                differing += not np.array_equal(a[0]["rgb"][index], b[0]["rgb"][index])
        self.assertGreater(differing, 60)

    def test_a_timing_without_latency_changes_no_byte(self):
        settings = {"interval_s": [0.0, 0.0], "latency_s": [0.0, 0.0]}
        noisy = {**SMALL, "noise": {"full_well_e": 500.0}}
        results = []
        for camera in (noisy, {**noisy, "timing": settings}):
            env = paws_sim.make_vec(
                ROOM, 2, observation=IMAGES, config=SHORT, camera=camera,
                autoreset_mode="SameStep",
            )
            env.reset(seed=1)
            bits = [env.save(0)]
            for _ in range(20):
                observations, *_, info = env.step(np.tile([0.9, 0.3], (2, 1)))
                bits += [values.tobytes() for values in observations.values()]
                for final in info.get("final_obs", ()):
                    bits += [values.tobytes() for values in (final or {}).values()]
            results.append(bits)
        self.assertEqual(*results)

    def test_the_vector_equals_scalar_environments_in_all_modes(self):
        camera = {**SMALL, "timing": "gauss_gym"}
        arguments = {"observation": IMAGES, "config": SHORT, "camera": camera}
        ends = check_vector_env(
            lambda mode: paws_sim.make_vec(ROOM, 3, autoreset_mode=mode, **arguments),
            lambda: paws_sim.make(ROOM, **arguments),
            steps=40,
        )
        self.assertGreaterEqual(min(ends.values()), 3)

    def test_frames_are_rarer_than_steps_and_late(self):
        env = vector("gauss_gym", config={**SHORT, "dt_s": 0.02})
        before = env.reset(seed=2)[0]
        changes, ages = np.zeros(3), []
        for _ in range(70):
            observations, *_, info = env.step(np.tile([0.6, 0.5], (3, 1)))
            same = (observations["depth"] == before["depth"]).all(axis=(1, 2, 3))
            changes += ~same
            ages.append(info["frame_age_s"])
            before = observations
        # 50 Hz of control, 7 to 20 Hz of images.
        self.assertTrue((changes > 5).all() and (changes < 35).all(), changes)
        ages = np.array(ages)[30:]
        self.assertGreaterEqual(ages.min(), 0.119)
        self.assertLessEqual(ages.max(), 0.46)

    def test_snapshots_and_pickles_go_on_with_the_same_images(self):
        regular = {"interval_s": [0.1, 0.1], "latency_s": [0.15, 0.15]}
        actions = np.tile([0.7, 0.4], (2, 1))
        # Right after the reset too.
        for timing, steps in (("gauss_gym", 7), (regular, 0), (regular, 3)):
            env = vector(timing, n=2)
            env.reset(seed=5)
            for _ in range(steps):
                env.step(actions)
            snapshot = env.save(1)
            self.assertLessEqual(len(snapshot), 4096)
            other, elsewhere = pickle.loads(pickle.dumps(env)), vector(timing, n=3)
            elsewhere.reset(seed=99)
            elsewhere.restore(2, snapshot)
            for _ in range(20):
                a, b = env.step(actions), other.step(actions)
                c = elsewhere.step(np.tile([0.7, 0.4], (3, 1)))
                for part in IMAGES:
                    np.testing.assert_array_equal(a[0][part], b[0][part])
                    np.testing.assert_array_equal(a[0][part][1], c[0][part][2])
                np.testing.assert_array_equal(a[4]["frame_age_s"], b[4]["frame_age_s"])
        with self.assertRaises(paws_sim.SnapshotError):
            vector().restore(0, snapshot)

    def test_the_preset_is_that_of_the_core(self):
        env = vector("gauss_gym")
        expected = {
            "interval_s": [0.05, 0.15],
            "phase": [0.0, 1.0],
            "latency_s": [0.12, 0.3],
            "redraw_s": 3.0,
        }
        self.assertEqual(env.config["timing"], expected)


class Checks(unittest.TestCase):
    def test_cameras_are_checked_when_the_environment_is_made(self):
        K = np.eye(3)
        for camera, name in (
            ({"width": 0}, "camera.width"),
            ({"width": 20000}, "camera.width"),
            ({"height": 24.5}, "camera.height"),
            ({"height": True}, "camera.height"),
            ({"fov": 4.0}, "camera.fov"),
            ({"fov": "wide"}, "camera.fov"),
            ({"fov": 1.0, "K": K}, "camera.K"),
            ({"K": np.stack([K, K])}, "camera.K"),
            ({"K": np.diag([0.0, 0.0, 1.0])}, "camera.model"),
            ({"K": np.zeros((3, 3))}, "camera.K"),
            ({"K": [[9.0, 0.1, 4.0], [0.0, 9.0, 4.0], [0.0, 0.0, 1.0]]}, "camera.K"),
            ({"K": [[9.0, 0.0, 4.0], [0.1, 9.0, 4.0], [0.0, 0.0, 1.0]]}, "camera.K"),
            ({"K": [[9.0, 0.0, 4.0], [0.0, 9.0, 4.0], [0.0, 0.0, 2.0]]}, "camera.K"),
            ({"far_m": -1.0}, "camera.far_m"),
            ({"far_m": float("nan")}, "camera.far_m"),
            ({"far_m": np.float32(3.0)}, "camera.far_m"),
            ({"quality": "best"}, "camera.quality"),
            ({"depth": 3}, "camera.depth"),
            ({"noise": {"full_well": 1.0}}, "camera.noise.full_well"),
            ({"noise": {"full_well_e": -1.0}}, "camera.noise.full_well_e"),
            ({"max_bytes": -1}, "camera.max_bytes"),
            ({"colour": 1}, "camera.colour"),
            ({"timing": "gauss"}, "camera.timing"),
            ({"timing": 3}, "camera.timing"),
            ({"timing": {"latency": [0.0, 0.1]}}, "camera.timing.latency"),
            ({"timing": {"latency_s": 0.1}}, "camera.timing.latency_s"),
            ({"timing": {"latency_s": [0.3, 0.1]}}, "camera.timing.latency_s"),
            ({"timing": {"latency_s": [0.0, 1.7]}}, "camera.timing.latency_s"),
            ({"timing": {"interval_s": [0.0, 0.1]}}, "camera.timing.interval_s"),
            ({"timing": {"phase": [0.0, float("inf")]}}, "camera.timing"),
            ({"timing": {"redraw_s": -1.0}}, "camera.timing.redraw_s"),
        ):
            for observation in ("state", "rgb"):
                with self.subTest(name, camera=camera), self.assertRaises(
                    paws_sim.SettingError
                ) as caught:
                    paws_sim.make(ROOM, observation=observation, camera=camera)
                self.assertRegex(str(caught.exception), f"^{name}\\b")

    def test_a_whole_camera_is_accepted(self):
        camera = {**SMALL, "fov": 1.2, "far_m": 10.0, "quality": "exact", "depth": "expected",
                  "noise": {"full_well_e": 800.0}, "max_bytes": 10**9, "timing": "gauss_gym"}
        env = paws_sim.make(ROOM, observation=IMAGES, camera=camera, config=SHORT)
        env.reset(seed=0)
        self.assertIn(env.step(np.zeros(2))[0], env.observation_space)

    def test_the_check_is_that_of_the_core(self):
        with self.assertRaisesRegex(paws_sim.SettingError, "camera.far_m"):
            _core.check_camera((8, 8, 4.0, 4.0, 3.5, 3.5), '{"far_m": 0.0}')


if __name__ == "__main__":
    unittest.main()
