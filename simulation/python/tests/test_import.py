"""A folder of Beogym as a scene of bundles."""

import json
import os
import tempfile
import unittest

import numpy as np
import paws_sim

FIELDS = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"]
FIELDS += ["scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]


def write_beogym(folder):
    """Two sectors 6 m apart along x, y up, on level ground at y = -1.5."""
    for number, x in enumerate([0.0, 6.0]):
        sector = os.path.join(folder, f"sec{number + 1}")
        os.makedirs(sector)
        header = ["ply", "format binary_little_endian 1.0", "element vertex 2"]
        header += [f"property float {name}" for name in FIELDS] + ["end_header", ""]
        gaussians = np.zeros((2, len(FIELDS)), "<f4")
        gaussians[:, 0] = [0.0, 2.0]
        gaussians[:, 3] = number
        gaussians[:, 6:11] = [2.0, -2.0, -2.0, -2.0, 1.0]
        with open(os.path.join(sector, "point_cloud.ply"), "wb") as file:
            file.write("\n".join(header).encode() + gaussians.tobytes())
        rows = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [x, -0.5, 3.0]]
        with open(os.path.join(sector, "transformation.txt"), "w") as file:
            file.write(str(np.array(rows)))
        camera = {"position": [0.0, 0.0, 0.0], "rotation": np.eye(3).tolist()}
        cameras = [camera, {**camera, "position": [2.0, 0.0, 0.0]}]
        with open(os.path.join(sector, "cameras.json"), "w") as file:
            json.dump(cameras, file)
    x, z = (v.ravel() for v in np.meshgrid(np.arange(0, 12, 0.05), np.arange(0, 8, 0.05)))
    points = np.stack([x + 0.01, np.full_like(x, -1.5), z + 0.01], axis=1)
    header = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
    header += f"WIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\n"
    with open(os.path.join(folder, "surfaceMap.pcd"), "wb") as file:
        file.write(f"{header}DATA binary\n".encode() + points.astype("<f4").tobytes())


class Import(unittest.TestCase):
    def test_an_import_is_written_opened_and_walked_through(self):
        with tempfile.TemporaryDirectory() as folder:
            beogym, yard = (os.path.join(folder, name) for name in ("beogym", "yard"))
            write_beogym(beogym)
            scene = paws_sim.import_beogym(beogym, yard)
            self.assertEqual(scene.sectors, ["sec1", "sec2"])
            self.assertEqual(scene.gaussians, [2, 2])
            self.assertEqual(paws_sim.open_scene(yard).hash, scene.hash)
            with self.assertRaisesRegex(paws_sim.SceneError, "there already"):
                paws_sim.import_beogym(beogym, yard)
            os.remove(os.path.join(beogym, "sec2", "transformation.txt"))
            with self.assertRaisesRegex(paws_sim.SceneError, "sec2/transformation.txt"):
                paws_sim.import_beogym(beogym, os.path.join(folder, "other"))
            self.assertFalse(os.path.exists(os.path.join(folder, "other")))

            env = paws_sim.make(yard, task="velocity", config={"end": {"max_deviation_m": 100.0}})
            env.reset(seed=0)
            for _ in range(20):
                _, _, terminated, truncated, info = env.step(np.array([1.0, 0.3]))
                self.assertFalse(terminated or truncated)
            self.assertGreater(info["path_length_m"], 0.5)


if __name__ == "__main__":
    unittest.main()
