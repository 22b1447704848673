"""What was recorded of the walk: contacts, the wearer, and agents that are where it was."""

import pickle
import tempfile
import unittest
from pathlib import Path

import numpy as np
import paws_sim

STEP_NS = 100_000_000
SHORT = {"end": {"time_limit_s": 60.0}, "task": {"goals": 4}}


class Recordings(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(folder.cleanup)
        path = str(Path(folder.name) / "stairs.scene")
        paws_sim.write_synthetic("stairs", path)
        cls.scenes = [paws_sim.open_scene("synthetic:stairs"), paws_sim.open_scene(path)]

    def test_contacts_lie_on_the_steps(self):
        for scene in self.scenes:
            contacts = scene.recording(0).contacts()
            n = len(contacts["foot"])
            self.assertGreater(n, 5)
            self.assertEqual(contacts["world_from_foot"].shape, (n, 4, 4))
            self.assertEqual(contacts["time_ns"].shape, (n, 4))
            self.assertTrue((np.diff(contacts["time_ns"], axis=1) > 0).all())
            np.testing.assert_array_equal(contacts["foot"], np.arange(n) % 2)
            heights = contacts["world_from_foot"][:, 2, 3]
            # Risers of 15 cm.
            np.testing.assert_allclose(heights / 0.15, np.round(heights / 0.15), atol=1e-6)
            self.assertAlmostEqual(heights.max() - heights.min(), 8 * 0.15, delta=0.16)

    def test_the_wearer_is_at_the_recorded_poses(self):
        for scene in self.scenes:
            recording = scene.recording(0)
            first, last = recording.range_ns
            references = scene.reference_poses(0)
            mount = np.linalg.inv(recording.wearer(first)["world_from_rig"]) @ references[0]
            for k in (0, 5, 20):
                found = recording.wearer(first + k * STEP_NS)
                pose = np.array(found["world_from_rig"]) @ mount
                np.testing.assert_allclose(pose, references[k], atol=1e-9)
                self.assertAlmostEqual(np.hypot(*found["velocity"][:2]), 1.0, delta=0.05)
                self.assertTrue(any(contact is not None for contact in found["contacts"]))
            self.assertIsNone(recording.wearer(first - 1))
            self.assertIsNone(recording.wearer(last + 1))

    def test_an_agent_is_where_the_wearer_was(self):
        for scene in self.scenes:
            vector = paws_sim.make_vec(scene, 2, task="velocity", config=SHORT)
            vector.reset(seed=0)
            recording = scene.recording(0)
            first, last = recording.range_ns
            played = 0
            for time_ns in range(first, last, STEP_NS):
                other = vector.save(0)
                if not vector.play(1, time_ns):
                    continue
                played += 1
                self.assertEqual(vector.save(0), other)
                rig = np.array(recording.wearer(time_ns)["world_from_rig"])
                states = vector.states()
                np.testing.assert_allclose(states["position_m"][1, :2], rig[:2, 3], atol=1e-9)
                # The rig is 1.4 m above the step, whose edge the map knows to a cell.
                self.assertLess(abs(rig[2, 3] - 1.4 - states["position_m"][1, 2]), 0.16)
                self.assertAlmostEqual(states["velocity"][1, 0], 1.0, delta=0.05)
                self.assertIn(vector.observe(), vector.observation_space)
            self.assertGreater(played, 0.8 * (last - first) / STEP_NS)
            # It goes on from there.
            before = vector.states()["position_m"][1]
            vector.step(np.array([[0.0, 0.0], [1.0, 0.0]]))
            after = vector.states()["position_m"][1]
            self.assertLess(np.linalg.norm(after - before), 0.3)

    def test_times_without_a_pose_change_nothing(self):
        env = paws_sim.make(self.scenes[1], task="velocity", config=SHORT)
        with self.assertRaisesRegex(paws_sim.StateError, "no running episode"):
            env.play(self.scenes[1].recording(0).range_ns[0] + STEP_NS)
        env.reset(seed=0)
        before, snapshot = env.observe(), env.save()
        for time_ns in (-1, 10**15):
            self.assertFalse(env.play(time_ns))
        np.testing.assert_array_equal(env.observe(), before)
        self.assertEqual(env.save(), snapshot)

    def test_a_scene_from_a_bundle_is_pickled_by_its_path(self):
        scene = pickle.loads(pickle.dumps(self.scenes[1]))
        self.assertEqual(scene.hash, self.scenes[1].hash)
        self.assertEqual([m[1] for m in scene.missing], ["feet", "terrain", "collision"])

    def test_bundles_of_synthetic_scenes_replace_nothing(self):
        path = self.scenes[1].source
        with self.assertRaises(paws_sim.SceneError):
            paws_sim.write_synthetic("room", path)
        with self.assertRaisesRegex(paws_sim.SceneError, "4 recordings"):
            paws_sim.write_synthetic("corridor-loop", path + "-loop")
        with self.assertRaises(paws_sim.SettingError):
            paws_sim.write_synthetic("moon", path + "-moon")
        self.assertEqual(paws_sim.open_scene(path).hash, self.scenes[1].hash)


if __name__ == "__main__":
    unittest.main()
