"""Lenses, mounts, exposure, shutter: against images that are put together here."""

import json
import tempfile
import unittest
from pathlib import Path

import numpy as np
import paws_sim
from paws_sim.cameras import lens_and_options

ROOM = paws_sim.open_scene("synthetic:room")
SHORT = {"end": {"time_limit_s": 3.0}, "task": {"goals": 4}}
FISHEYE = {"model": "kannala_brandt4", "k1": 0.05, "k2": -0.01, "k3": 0.0, "k4": 0.0}
RADTAN = {"model": "rad_tan5", "k1": -0.25, "k2": 0.06, "p1": 0.002, "p2": -0.001, "k3": 0.0}


def pose(at=3):
    return ROOM.reference_poses(0)[at]


def moved(world_from_camera, translation):
    step = np.eye(4)
    step[:3, 3] = translation
    return world_from_camera @ step


def psnr_db(a, b):
    error = np.mean((a.astype(float) - b.astype(float)) ** 2)
    return 10.0 * np.log10(255.0**2 / max(error, 1e-9))


def distorted(x, y, lens):
    """Where a ray (x, y, 1) is in normalized image coordinates of a distorted lens."""
    r = np.hypot(x, y)
    if lens["model"] == "kannala_brandt4":
        theta = np.arctan(r)
        t2 = theta**2
        k = [lens[f"k{i}"] for i in (1, 2, 3, 4)]
        radius = theta * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))))
        scale = np.where(r > 0, radius / np.maximum(r, 1e-12), 1.0)
        return scale * x, scale * y
    k1, k2, p1, p2, k3 = (lens[name] for name in ("k1", "k2", "p1", "p2", "k3"))
    radial = 1 + r**2 * (k1 + r**2 * (k2 + r**2 * k3))
    return (
        radial * x + 2 * p1 * x * y + p2 * (r**2 + 2 * x**2),
        radial * y + p1 * (r**2 + 2 * y**2) + 2 * p2 * x * y,
    )


def sampled(image, u, v):
    """An image at pixel coordinates, bilinear."""
    column, row = np.floor(u).astype(int), np.floor(v).astype(int)
    a, b = (u - column)[..., None], (v - row)[..., None]
    image = image.astype(float)
    top = (1 - a) * image[row, column] + a * image[row, column + 1]
    bottom = (1 - a) * image[row + 1, column] + a * image[row + 1, column + 1]
    return (1 - b) * top + b * bottom


class Lenses(unittest.TestCase):
    def test_a_distorted_image_is_rectified_to_that_of_a_pinhole(self):
        cameras = paws_sim.Cameras(ROOM)
        focal, size = 200.0, (320, 240)
        K = np.array([[focal, 0, 159.5], [0, focal, 119.5], [0, 0, 1.0]])
        narrow = np.array([[focal, 0, 79.5], [0, focal, 59.5], [0, 0, 1.0]])
        plain = cameras.render(pose(), 160, 120, K=narrow, quality="exact")
        u, v = np.meshgrid(np.arange(160.0), np.arange(120.0))
        x, y = (u - 79.5) / focal, (v - 59.5) / focal
        for lens in (FISHEYE, RADTAN):
            with self.subTest(lens["model"]):
                wide = cameras.render(pose(), *size, K=K, distortion=lens, quality="exact")
                xd, yd = distorted(x, y, lens)
                at = focal * xd + 159.5, focal * yd + 119.5
                rectified = sampled(wide["rgb"][0], *at)
                self.assertGreater(psnr_db(rectified, plain["rgb"][0]), 48.0)
                depth = sampled(wide["depth"][0][..., None], *at)[..., 0]
                errors = np.abs(depth - plain["depth"][0])
                self.assertLess(np.median(errors), 0.001)
                # The test can fail: without the model the images differ.
                straight = sampled(wide["rgb"][0], u + 80.0, v + 60.0)
                self.assertLess(psnr_db(straight, plain["rgb"][0]), 38.0)

    def test_a_recorded_camera_has_its_lens_and_size(self):
        (recorded,) = ROOM.cameras(0)
        fx, fy, cx, cy = recorded["intrinsics"]
        K = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]
        cameras = paws_sim.Cameras(ROOM)
        by_name = cameras.render(pose(), recorded=recorded["name"])
        by_matrix = cameras.render(pose(), *recorded["size"], K=K)
        for name, array in by_matrix.items():
            np.testing.assert_array_equal(by_name[name], array)
        self.assertEqual(cameras.render(pose(), 80, recorded="front/left")["rgb"].shape,
                         (1, 45, 80, 3))

    def test_a_recorded_camera_keeps_its_distortion_and_readout(self):
        class Recording:
            def lens(self, name, width, height):
                return {
                    "size": (width or 320, height or 240),
                    "intrinsics": (200.0, 201.0, 159.5, 119.5),
                    "distortion": json.dumps(FISHEYE),
                    "line_s": 2e-5,
                }

        class Scene:
            def recording(self, sector):
                return Recording()

        lens, options = lens_and_options(Scene(), {"recorded": "feet/left", "width": 160})
        self.assertEqual(lens, (160, 240, 200.0, 201.0, 159.5, 119.5))
        self.assertEqual(json.loads(options), {"distortion": FISHEYE, "shutter": {"line_s": 2e-5}})
        own = {"recorded": "feet/left", "distortion": RADTAN,
               "shutter": {"line_s": 0.0, "blur_poses": 3}}
        _, options = lens_and_options(Scene(), own)
        del own["recorded"]
        self.assertEqual(json.loads(options), own)

    def test_a_recorded_camera_is_where_the_wearer_had_it(self):
        with tempfile.TemporaryDirectory() as folder:
            path = str(Path(folder) / "room.scene")
            paws_sim.write_synthetic("room", path)
            scene = paws_sim.open_scene(path)
            start = {"mode": "recorded", "max_offset_m": 0.0, "max_offset_rad": 0.0}
            vector = paws_sim.make_vec(
                scene, 16, task="velocity", observation=("rgb",),
                config={**SHORT, "start": start}, camera={"recorded": "front/left", "width": 64},
            )
            observations, _ = vector.reset(seed=0)
            self.assertEqual(observations["rgb"].shape, (16, 36, 64, 3))
            poses, references = vector.camera_poses()[0], scene.reference_poses(0)
            for found in poses:
                off = np.abs(references - found).max(axis=(1, 2)).min()
                self.assertLess(off, 1e-6)
            # Without it the camera is level: the recorded one looks down by 0.2 rad.
            level = paws_sim.make_vec(scene, 1, config=SHORT)
            level.reset(seed=0)
            self.assertAlmostEqual(level.camera_poses()[0][0, 2, 2], 0.0, places=9)
            self.assertAlmostEqual(poses[0, 2, 2], -np.sin(0.2), places=6)
            # The other eye, 12 cm to the right.
            eyes = [scene.recording(0).mount(f"front/{eye}") for eye in ("left", "right")]
            between = np.linalg.inv(eyes[0]) @ eyes[1]
            np.testing.assert_allclose(between[:3, 3], [0.12, 0.0, 0.0], atol=1e-9)

    def test_a_camera_may_be_mounted_anywhere(self):
        mount = np.eye(4)
        mount[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
        mount[:3, 3] = [0.3, 0.1, 0.25]
        vector = paws_sim.make_vec(ROOM, 2, config=SHORT, camera={"mount": mount})
        vector.reset(seed=0)
        states, (poses, _) = vector.states(), vector.camera_poses()
        height = poses[:, 2, 3] - states["position_m"][:, 2]
        np.testing.assert_allclose(height, 0.25, atol=1e-6)
        ahead = np.hypot(*(poses[:, :2, 3] - states["position_m"][:, :2]).T)
        np.testing.assert_allclose(ahead, np.hypot(0.3, 0.1), atol=1e-6)


class Light(unittest.TestCase):
    def setUp(self):
        self.cameras = paws_sim.Cameras(ROOM)
        self.plain = self.cameras.render(pose(), 64, 48)["rgb"]

    def test_gain_and_white_balance_are_of_linear_light(self):
        balance = [0.5, 1.0, 0.25]
        exposure = {"gain": 0.5, "white_balance": balance}
        image = self.cameras.render(pose(), 64, 48, exposure=exposure)["rgb"]
        expected = self.plain * (0.5 * np.array(balance)) ** (1 / 2.2)
        self.assertLessEqual(np.abs(image - expected).max(), 1.0)

    def test_a_gain_of_an_image_is_that_of_the_exposure(self):
        both = self.cameras.render(np.stack([pose(), pose()]), 64, 48, gain=[1.0, 0.25])["rgb"]
        np.testing.assert_array_equal(both[0], self.plain[0])
        exposed = self.cameras.render(pose(), 64, 48, exposure={"gain": 0.25})["rgb"]
        np.testing.assert_array_equal(both[1], exposed[0])

    def test_one_value_is_that_of_all_images(self):
        poses = np.stack([pose(3), pose(4)])
        one = {"velocity": [1.0, 0.0, 0.2], "rate": [0.0, 0.3, 0.0], "gain": 0.5,
               "keys": [1, 2, 3], "sectors": 0}
        settings = {"shutter": {"line_s": 3e-4}, "noise": {"full_well_e": 500.0}}
        of_all = self.cameras.render(poses, 64, 48, **one, **settings)["rgb"]
        each = {name: [value, value] for name, value in one.items()}
        of_each = self.cameras.render(poses, 64, 48, **each, **settings)["rgb"]
        np.testing.assert_array_equal(of_all, of_each)

    def test_noise_follows_its_key(self):
        noise = {"full_well_e": 500.0}
        images = [
            self.cameras.render(pose(), 64, 48, noise=noise, keys=[key])["rgb"]
            for key in ([1, 0, 0], [1, 0, 0], [1, 0, 1])
        ]
        np.testing.assert_array_equal(images[0], images[1])
        self.assertGreater(np.abs(images[0].astype(int) - images[2]).mean(), 1.0)
        self.assertGreater(np.abs(images[0].astype(int) - self.plain).mean(), 1.0)


class Shutter(unittest.TestCase):
    def test_each_row_of_a_rolling_shutter_is_that_of_its_own_pose(self):
        cameras = paws_sim.Cameras(ROOM)
        velocity, line_s, height = np.array([1.5, 0.0, 0.3]), 3e-4, 96
        lens = {"width": 128, "height": height, "quality": "exact"}
        rolling = cameras.render(pose(), velocity=velocity, shutter={"line_s": line_s}, **lens)
        rolling = rolling["rgb"][0]
        still = cameras.render(pose(), **lens)["rgb"][0]
        times = line_s * (np.arange(height) - 0.5 * (height - 1))
        poses = np.stack([moved(pose(), velocity * time_s) for time_s in times])
        images = cameras.render(poses, **lens)["rgb"]
        rows = images[np.arange(height), np.arange(height)]
        self.assertGreater(psnr_db(rolling, rows), psnr_db(still, rows) + 6.0)
        self.assertGreater(psnr_db(rolling, rows), 38.0)

    def test_motion_blur_is_the_mean_of_linear_light(self):
        cameras = paws_sim.Cameras(ROOM)
        velocity, exposure_s = np.array([2.0, 0.0, 0.0]), 0.03
        shutter = {"exposure_s": exposure_s, "blur_poses": 3}
        blurred = cameras.render(pose(), 64, 48, velocity=velocity, shutter=shutter)["rgb"][0]
        times = exposure_s * np.array([-1, 0, 1]) / 3
        poses = np.stack([moved(pose(), velocity * time_s) for time_s in times])
        light = (cameras.render(poses, 64, 48)["rgb"] / 255.0) ** 2.2
        mean = 255.0 * light.mean(axis=0) ** (1 / 2.2)
        # Three images are rounded to 8 bits here.
        self.assertLessEqual(np.abs(blurred - mean).max(), 2.0)
        sharp = cameras.render(pose(), 64, 48)["rgb"][0]
        self.assertGreater(np.abs(sharp - mean).max(), 5.0)

    def test_agents_hand_their_motion_to_the_shutter(self):
        camera = {"width": 48, "height": 36, "fov": 1.2,
                  "shutter": {"line_s": 5e-4, "exposure_s": 0.02, "blur_poses": 3}}
        for timing in ({}, {"timing": {"latency_s": [0.1, 0.1]}}):
            vector = paws_sim.make_vec(
                ROOM, 3, observation=("rgb",), camera={**camera, **timing},
                config={**SHORT, "dt_s": 0.02},
            )
            vector.reset(seed=1)
            cameras, actions = paws_sim.Cameras(ROOM), np.tile([0.6, 0.5], (3, 1))
            before, speeds = vector.camera_poses()[0], []
            for _ in range(30):
                rgb = vector.step(actions)[0]["rgb"]
                frames, sectors, keys, conditions = vector._simulator.world.frames()
                after = vector.camera_poses()[0]
                # The mean speed of a step is that of its end once it is steady.
                speeds.append((after[:, :3, 3] - before[:, :3, 3]) / 0.02)
                before = after
            velocity, rate = conditions[:, :3], conditions[:, 3:6]
            expected = cameras.render(
                frames, sectors=sectors, keys=keys, velocity=velocity, rate=rate, **camera
            )
            np.testing.assert_array_equal(rgb, expected["rgb"])
            at_rest = cameras.render(frames, sectors=sectors, keys=keys, **camera)
            running = np.linalg.norm(speeds[-1], axis=1) > 0.5
            self.assertTrue(running.any())
            differing = np.abs(rgb.astype(int) - at_rest["rgb"]).mean(axis=(1, 2, 3))
            self.assertGreater(differing[running].min(), 0.1)
            found = np.linalg.norm(velocity, axis=1)[running]
            np.testing.assert_allclose(found, 0.9, atol=0.02)
            np.testing.assert_allclose(rate[running, 1], -1.0, atol=0.02)


class Checks(unittest.TestCase):
    def test_errors_name_the_setting(self):
        sideways = np.eye(4)
        sideways[0, 0] = 2.0
        cases = (
            ({"recorded": "feet/left"}, "camera.recorded.*one of front/left"),
            ({"recorded": 3}, "camera.recorded"),
            ({"recorded": "front/left", "fov": 1.0}, "camera.recorded.*fov"),
            ({"distortion": {"model": "mirror"}}, "camera.distortion"),
            ({"distortion": {"model": "radial2", "k1": 0.1}}, "camera.distortion.*k2"),
            ({"exposure": {"gain": 0.0}}, "camera.exposure.gain"),
            ({"exposure": {"gains": 1.0}}, "camera.exposure.gains"),
            ({"exposure": {"white_balance": [1.0, 1.0]}}, "camera.exposure.white_balance"),
            ({"shutter": {"line_s": 1.0}}, "camera.shutter.line_s"),
            ({"shutter": {"blur_poses": 2}}, "camera.shutter.blur_poses"),
            ({"shutter": 0.1}, "camera.shutter"),
            ({"mount": np.eye(3)}, "camera.mount"),
            ({"mount": sideways}, "camera.mount"),
            ({"mount": "head"}, "camera.mount"),
        )
        for camera, pattern in cases:
            with self.subTest(camera), self.assertRaisesRegex(paws_sim.SettingError, pattern):
                paws_sim.make(ROOM, camera=camera, config=SHORT)
        body = {"rotation_wxyz": [1, 0, 0, 0], "translation_m": [0, 0, 1]}
        with self.assertRaisesRegex(paws_sim.SettingError, "camera.mount.*body_from_camera"):
            paws_sim.make(ROOM, camera={"mount": np.eye(4)}, config={"body_from_camera": body})
        cameras = paws_sim.Cameras(ROOM)
        for wrong, pattern in (
            ({"velocity": np.zeros((2, 3))}, r"velocity: found shape \(2, 3\), expected \(1, 3\)"),
            ({"velocity": 1.0}, r"velocity: found shape \(\), expected \(1, 3\)"),
            ({"velocity": np.zeros((1, 1))}, r"velocity: found shape \(1, 1\), expected"),
            ({"velocity": "fast"}, "velocity"),
            ({"rate": [0.0, 0.0]}, r"rate: found shape \(2,\), expected"),
            ({"gain": np.ones((1, 1))}, r"gain: found shape \(1, 1\), expected \(1,\)"),
            ({"gain": [1.0, 1.0]}, r"gain: found shape \(2,\), expected"),
            ({"sectors": [0, 0]}, r"sectors: found shape \(2,\), expected"),
            ({"keys": [[0, 0]]}, r"keys: found shape \(1, 2\), expected"),
            ({"rate": [0.0, 0.0, np.nan]}, "frame 0"),
            ({"gain": 0.0}, "frame 0.*gain"),
            ({"mount": np.eye(4)}, "camera.mount.*only cameras of environments"),
            ({"timing": "gauss_gym"}, "camera.timing.*only cameras of environments"),
            ({"budget_bytes": 1}, "camera.budget_bytes.*only cameras of environments"),
            ({"mounts": 1}, "camera.mounts.*unknown setting"),
        ):
            with self.subTest(wrong), self.assertRaisesRegex(paws_sim.SettingError, pattern):
                cameras.render(pose(), 16, 16, **wrong)
        self.assertEqual(cameras.render(pose(), 16, 16)["rgb"].shape, (1, 16, 16, 3))

    def test_a_scene_names_its_cameras_and_refuses_a_sector_that_it_does_not_have(self):
        names = [camera["name"] for camera in ROOM.cameras(0)]
        self.assertEqual(names, ["front/left"])
        with self.assertRaisesRegex(paws_sim.SettingError, "sector: found 3, expected below 1"):
            ROOM.recording(3)


if __name__ == "__main__":
    unittest.main()
