"""Reads what scene-bundle writes with other people's readers, and prints what they see as JSON."""

import json
import math
import sys

import cv2
import laspy
import numpy as np
import plyfile
import pycolmap

paths = json.loads(sys.argv[1])


def plain(value):
    """Lists and numbers of NumPy's, with nothing in place of not-a-number."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and math.isnan(value) else value


def full(upper):
    matrix = np.zeros((6, 6))
    matrix[np.triu_indices(6)] = upper
    return matrix + np.triu(matrix, 1).T


def picture(path):
    read = cv2.imread(path, cv2.IMREAD_UNCHANGED)
    return {"dtype": str(read.dtype), "shape": read.shape, "values": read.ravel().tolist()}


def points(x, y, z, red, green, blue):
    columns = [np.asarray(c, dtype=np.float64) for c in (x, y, z, red, green, blue)]
    return np.stack(columns, axis=1).tolist()


def model(path):
    reconstruction = pycolmap.Reconstruction(path)
    images = []
    for image in reconstruction.images.values():
        camera_from_world = image.cam_from_world
        if callable(camera_from_world):
            camera_from_world = camera_from_world()
        camera = reconstruction.cameras[image.camera_id]
        projected = camera.img_from_cam(np.array([[0.1, -0.05, 1.0]])).ravel()
        images.append({
            "name": image.name,
            "camera_from_world": plain(camera_from_world.matrix()),
            "projected": plain(projected),
        })
    first = reconstruction.points3D[1]
    return {
        "images": images,
        "points": len(reconstruction.points3D),
        "first_point": [first.xyz[0], plain(first.color)],
    }


trajectory = np.load(paths["trajectory"])
keyframes = np.load(paths["keyframes"])
tum = np.loadtxt(paths["tum"])
cloud = plyfile.PlyData.read(paths["ply"])["vertex"]
seen = {
    "trajectory": {
        "names": trajectory.dtype.names,
        "rows": [
            plain([full(field) if name == "covariance" else field for name, field in zip(trajectory.dtype.names, row)])
            for row in trajectory
        ],
    },
    "keyframes": [plain([row[name] for name in ("set", "frame", "time_ns", "camera")]) for row in keyframes],
    "tum": [plain([row[1:4], row[4:8]]) for row in tum],
    "depth": picture(paths["depth"]),
    "sigma": picture(paths["sigma"]),
    "ply": points(*(cloud[name] for name in ("x", "y", "z", "red", "green", "blue"))),
}
for name in ("las", "laz"):
    las = laspy.read(paths[name])
    seen[name] = points(las.x, las.y, las.z, las.red, las.green, las.blue)
for name in ("colmap-text", "colmap-binary"):
    seen[name] = model(paths[name])
json.dump(seen, sys.stdout)
