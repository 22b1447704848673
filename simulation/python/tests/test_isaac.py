"""The renderer for Isaac Lab against a stub of its interface. It has never run in Isaac Lab."""

import importlib.util
import math
import sys
import unittest
from pathlib import Path
from types import SimpleNamespace

import numpy as np

# From its file: it needs nothing of the package.
_PATH = Path(__file__).parents[1] / "python" / "paws_sim" / "isaac.py"
_SPEC = importlib.util.spec_from_file_location("paws_sim_isaac", _PATH)
isaac = importlib.util.module_from_spec(_SPEC)
sys.modules[_SPEC.name] = isaac
_SPEC.loader.exec_module(isaac)


class Wall:
    """Renders a wall at x = 5 m: its color is the place where the ray meets it."""

    def render(self, world_from_camera, width, height, K):
        v, u = np.mgrid[:height, :width]
        rgb, depth = [], []
        for pose, k in zip(world_from_camera, K):
            rays = np.stack([(u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1], np.ones_like(u)], -1)
            world = rays @ pose[:3, :3].T
            z = (5.0 - pose[0, 3]) / world[..., 0]
            at = pose[:3, 3] + z[..., None] * world
            left, up = np.clip(128 + 20 * at[..., 1:], 0, 255).transpose(2, 0, 1)
            rgb.append(np.stack([left, up, np.zeros_like(up)], -1))
            depth.append(z)
        return {"rgb": np.array(rgb).astype(np.uint8), "depth": np.array(depth, np.float32)}


class ProxyArray:
    """As Isaac Lab's: numbers are in a view of it."""

    def __init__(self, numbers):
        self.torch = np.asarray(numbers)


class IsaacCamera:
    """Calls a renderer in the order in which Isaac Lab's camera does."""

    def __init__(self, renderer, width, height, types, count):
        cfg = SimpleNamespace(width=width, height=height, data_types=types)
        spec = SimpleNamespace(cfg=cfg, num_instances=count, view_count=count, device="cpu")
        renderer.initialize()
        renderer.prepare_cameras(object(), spec)
        renderer.prepare_stage(object(), count)
        self.renderer, self.data = renderer, renderer.create_render_data(spec)
        known = renderer.supported_output_types()
        self.output = {
            name: ProxyArray(np.zeros((count, height, width, known[name][0]), known[name][1]))
            for name in types
        }
        renderer.set_outputs(self.data, self.output)

    def update(self, positions, quaternions, intrinsics):
        self.renderer.update_transforms()
        self.renderer.update_geometries()
        given = [ProxyArray(own) for own in (positions, quaternions, intrinsics)]
        self.renderer.update_camera(self.data, *given)
        self.renderer.render(self.data)
        self.renderer.read_output(self.data, SimpleNamespace(output=self.output))
        return {name: array.torch for name, array in self.output.items()}


def xyzw(rotation):
    """Quaternion of a rotation matrix, by its axis and angle."""
    angle = math.acos(max(-1.0, min(1.0, (np.trace(rotation) - 1) / 2)))
    if angle < 1e-9:
        return [0.0, 0.0, 0.0, 1.0]
    values, vectors = np.linalg.eig(rotation)
    axis = np.real(vectors[:, np.argmin(np.abs(values - 1))])
    skew = rotation - rotation.T
    sense = axis @ [skew[2, 1], skew[0, 2], skew[1, 0]]
    axis = axis if sense >= 0 else -axis
    return [*(math.sin(angle / 2) * axis), math.cos(angle / 2)]


#: Looks along x, level.
OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
K = np.array([[[20.0, 0, 9.5], [0, 22.0, 7.5], [0, 0, 1]]])
TYPES = ["rgb", "rgba", "depth", "distance_to_image_plane", "distance_to_camera"]


class Renderer(unittest.TestCase):
    def test_all_conventions_see_the_same(self):
        turn = 0.2
        yaw = np.array(
            [[math.cos(turn), -math.sin(turn), 0], [math.sin(turn), math.cos(turn), 0], [0, 0, 1]]
        )
        axes = {
            "ros": yaw @ OPTICAL,
            "opengl": yaw @ OPTICAL @ np.diag([1.0, -1.0, -1.0]),
            "world": yaw,
        }
        position = np.array([[1.0, 0.5, 0.3]])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = yaw @ OPTICAL, position[0]
        expected = Wall().render(pose[None], 20, 16, K)
        for convention, rotation in axes.items():
            renderer = isaac.IsaacRenderer(Wall(), convention=convention)
            camera = IsaacCamera(renderer, 20, 16, TYPES, 1)
            seen = camera.update(position, np.array([xyzw(rotation)]), K)
            # Rounding of rotations may change a color by one.
            off = np.abs(seen["rgb"].astype(int) - expected["rgb"].astype(int)).max()
            self.assertLessEqual(off, 1, convention)
            np.testing.assert_allclose(seen["depth"][..., 0], expected["depth"], rtol=1e-6)

    def test_shapes_and_kinds_are_those_of_isaac(self):
        renderer = isaac.IsaacRenderer(Wall())
        camera = IsaacCamera(renderer, 20, 16, TYPES, 3)
        quaternions = np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
        seen = camera.update(np.zeros((3, 3)), quaternions, np.tile(K, (3, 1, 1)))
        shapes = {name: (array.shape, array.dtype) for name, array in seen.items()}
        for name, (channels, kind) in isaac.OUTPUT_TYPES.items():
            self.assertEqual(shapes[name], ((3, 16, 20, channels), np.dtype(kind)))
        self.assertTrue((seen["rgba"][..., 3] == 255).all())
        # The wall is 5 m ahead in all pixels, and farther along rays to the side.
        np.testing.assert_allclose(seen["depth"], 5.0, rtol=1e-6)
        corner = 5 * math.sqrt(1 + (9.5 / 20) ** 2 + (7.5 / 22) ** 2)
        self.assertAlmostEqual(float(seen["distance_to_camera"][0, 0, 0, 0]), corner, delta=1e-5)
        # Left of the image is left on the wall, where y is greater; its top is up.
        red, green = seen["rgb"][0, 8, :, 0].astype(int), seen["rgb"][0, :, 10, 1].astype(int)
        self.assertGreater(red[0], red[-1])
        self.assertGreater(green[0], green[-1])

    def test_environments_side_by_side_see_the_same(self):
        origins = np.array([[0.0, 0.0, 0.0], [30.0, -8.0, 0.0]])
        renderer = isaac.IsaacRenderer(Wall(), world_from_origin=origins)
        camera = IsaacCamera(renderer, 20, 16, ["rgb", "depth"], 2)
        quaternions = np.tile([0.0, 0.0, 0.0, 1.0], (2, 1))
        seen = camera.update(origins + [1.0, 0.2, 0.1], quaternions, np.tile(K, (2, 1, 1)))
        # Rounding of positions may change a color by one.
        off = np.abs(seen["rgb"][0].astype(int) - seen["rgb"][1].astype(int)).max()
        self.assertLessEqual(off, 1)
        np.testing.assert_allclose(seen["depth"], 4.0, rtol=1e-6)

    def test_wrong_calls_are_refused(self):
        with self.assertRaisesRegex(ValueError, "convention"):
            isaac.IsaacRenderer(Wall(), convention="opencv")
        renderer = isaac.IsaacRenderer(Wall())
        with self.assertRaisesRegex(ValueError, "normals"):
            renderer.create_render_data(
                SimpleNamespace(
                    cfg=SimpleNamespace(width=20, height=16, data_types=["rgb", "normals"])
                )
            )
        camera = IsaacCamera(renderer, 20, 16, ["rgb"], 1)
        with self.assertRaises(RuntimeError):
            renderer.render(camera.data)
        with self.assertRaises(RuntimeError):
            renderer.read_output(camera.data, SimpleNamespace())
        with self.assertRaisesRegex(ValueError, "not 0"):
            camera.update(np.zeros((1, 3)), np.zeros((1, 4)), K)
        with self.assertRaisesRegex(ValueError, "intrinsics"):
            camera.update(np.zeros((1, 3)), np.array([xyzw(OPTICAL)]), K[0])
        with self.assertRaisesRegex(ValueError, "expected"):
            renderer.set_outputs(camera.data, {"rgb": np.zeros((1, 20, 16, 3), np.uint8)})
        with self.assertRaisesRegex(ValueError, "origins"):
            isaac.IsaacRenderer(Wall(), np.zeros((2, 3))).prepare_stage(None, 3)
        renderer.cleanup(camera.data)
        renderer.cleanup(camera.data)
        renderer.close()

    def test_the_robot_is_over_the_scene_where_it_is_nearer(self):
        scene_rgb = np.full((1, 1, 4, 3), 10, np.uint8)
        robot_rgb = np.full((1, 1, 4, 3), 200, np.uint8)
        scene = np.array([2.0, 2.0, 2.0, np.inf]).reshape(1, 1, 4, 1)
        robot = np.array([1.0, 3.0, np.inf, 3.0]).reshape(1, 1, 4, 1)
        rgb, depth = isaac.composite(scene_rgb, scene, robot_rgb, robot)
        self.assertEqual(rgb[0, 0, :, 0].tolist(), [200, 10, 10, 200])
        self.assertEqual(depth.ravel().tolist(), [1.0, 2.0, 2.0, 3.0])


if __name__ == "__main__":
    unittest.main()
