"""Examines what `paws-rig-sim render --truth` wrote, with nothing of our code: OpenCV, numpy and the
reference AprilTag detector read the files and compute everything again from them.

    sim_exam.py WALK

prints one JSON object with a section per check. Lengths on images are px, depth errors relative.
"""

import csv
import json
import sys
from pathlib import Path

import cv2
import numpy as np
from pupil_apriltags import Detector

cv2.setNumThreads(1)


def numbers(text, key):
    return [float(v) for v in text.split(key + ":")[1].split("[")[1].split("]")[0].split(",")]


class Eye:
    """Calibration and images of one eye, as its folder has them."""

    def __init__(self, root, number):
        folder = root / f"cam{number}"
        lines = (folder / "sensor.yaml").read_text().splitlines()
        text = " ".join(line.split("#")[0] for line in lines)
        fu, fv, cu, cv = numbers(text, "intrinsics")
        self.matrix = np.array([[fu, 0, cu], [0, fv, cv], [0, 0, 1]])
        self.distortion = np.array(numbers(text, "distortion_coefficients"))
        self.body_from_eye = np.array(numbers(text, "data")).reshape(4, 4)
        self.size = tuple(int(v) for v in numbers(text, "resolution"))
        self.is_rolling = any(line.startswith("comment:") and "rolling" in line for line in lines)
        self.root, self.number = root, number

    def layer(self, layer, name):
        image = cv2.imread(str(self.root / f"{layer}{self.number}/data" / name), cv2.IMREAD_UNCHANGED)
        assert image is not None, (layer, name)
        return image

    def rays(self):
        """Directions of all pixels' centres, (rows, columns, 3)."""
        v, u = np.indices(self.size[::-1], dtype=np.float64)
        points = np.stack([u, v], -1).reshape(-1, 1, 2)
        stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
        flat = cv2.undistortPointsIter(points, self.matrix, self.distortion, None, None, stop)
        return np.dstack([flat.reshape(*u.shape, 2), np.ones_like(u)])


def images(root):
    return sorted((p.name for p in (root / "cam0/data").glob("*.png")), key=lambda name: int(name[:-4]))


def summary(values):
    values = np.asarray(values)
    return {
        "count": len(values),
        "median": float(np.median(values)),
        "p95": float(np.percentile(values, 95)),
    }


def tags(root):
    """Corners by the reference detector against those of tags.csv."""
    detector = Detector(families="tag36h11", quad_decimate=1.0, refine_edges=1)
    # The inverse of sRGB's curve. Where a white and a black cell share a pixel, the curve makes it
    # whiter than half: black squares look smaller than they are, in any camera that has such a curve.
    v = np.arange(256) / 255
    linear = np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)
    truth = {}
    for row in csv.reader(open(root.parent / "tags.csv")):
        if not row[0].startswith("#"):
            corners = np.array(row[5:13], float).reshape(4, 2)
            truth.setdefault((row[1], int(row[2])), []).append((int(row[3]), row[4] == "1", corners))
    visible = found = hidden = 0
    off = {"linear": [], "delivered": []}
    for (time, eye), expected in truth.items():
        image = cv2.imread(str(root / f"cam{eye}/data/{time}.png"), cv2.IMREAD_GRAYSCALE)
        light = linear[image]
        light = (light * (255 / light.max()) + 0.5).astype(np.uint8)
        for kind, seen in (("linear", light), ("delivered", image)):
            detected = {d.tag_id: d.corners for d in detector.detect(seen)}
            for tag, is_visible, corners in expected:
                if kind == "linear":
                    visible += is_visible
                    found += is_visible and tag in detected
                    hidden += not is_visible and tag in detected
                if is_visible and tag in detected:
                    # The detector's coordinates have the first pixel's corner at 0.
                    off[kind].append(detected[tag] - 0.5 - corners)
    report = {"visible": visible, "found": found, "found though hidden": hidden}
    for kind, all_off in off.items():
        report[kind] = summary(np.linalg.norm(all_off, axis=2).ravel())
        report[kind]["mean"] = np.mean(all_off, axis=(0, 1)).tolist()
    return report


def rows(left, right, names):
    """Rows of the same features in images that OpenCV rectifies."""
    right_from_left = np.linalg.inv(right.body_from_eye) @ left.body_from_eye
    turn_left, turn_right, new_left, new_right, *_ = cv2.stereoRectify(
        left.matrix, left.distortion, right.matrix, right.distortion, left.size,
        right_from_left[:3, :3], right_from_left[:3, 3], flags=cv2.CALIB_ZERO_DISPARITY, alpha=0,
    )  # fmt: skip
    maps = [
        cv2.initUndistortRectifyMap(eye.matrix, eye.distortion, turn, new, eye.size, cv2.CV_32FC1)
        for eye, turn, new in ((left, turn_left, new_left), (right, turn_right, new_right))
    ]
    apart = []
    for name in names:
        a, b = (cv2.remap(eye.layer("cam", name), *m, cv2.INTER_CUBIC) for eye, m in zip((left, right), maps))
        corners = cv2.goodFeaturesToTrack(a, 600, 0.01, 9)
        stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-4)
        options = dict(winSize=(31, 31), maxLevel=3, criteria=stop)
        there, fine, _ = cv2.calcOpticalFlowPyrLK(a, b, corners, None, **options)
        again, fine_too, _ = cv2.calcOpticalFlowPyrLK(b, a, there, None, **options)
        back = np.linalg.norm(again - corners, axis=2).ravel()
        good = (fine.ravel() == 1) & (fine_too.ravel() == 1) & (back < 0.05)
        apart.append((there - corners)[good, 0, 1])
    apart = np.concatenate(apart)
    return {**summary(np.abs(apart)), "mean": float(apart.mean()), "middle": float(np.median(apart))}


def depth(left, right, names):
    """Points of the left depth, projected into the right eye, against the right depth there."""
    right_from_left = np.linalg.inv(right.body_from_eye) @ left.body_from_eye
    rays = left.rays()
    off = []
    for name in names:
        near, far = left.layer("depth", name) / 1000, right.layer("depth", name) / 1000
        points = (rays * near[..., None])[near > 0]
        there = points @ right_from_left[:3, :3].T + right_from_left[:3, 3]
        spots, _ = cv2.projectPoints(there, np.zeros(3), np.zeros(3), right.matrix, right.distortion)
        u, v = spots[:, 0, 0], spots[:, 0, 1]
        inside = (u >= 0) & (v >= 0) & (u < right.size[0] - 1) & (v < right.size[1] - 1)
        u, v, z = u[inside], v[inside], there[inside, 2]
        column, row = u.astype(int), v.astype(int)
        p, q = u - column, v - row
        corners = [far[row + j, column + i] for j in (0, 1) for i in (0, 1)]
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = [1 / c for c in corners]
            found = (1 - p) * (1 - q) * inverse[0] + p * (1 - q) * inverse[1]
            found = 1 / (found + (1 - p) * q * inverse[2] + p * q * inverse[3])
            # Where the four pixels lie on one surface, which also is the point's: no edge between.
            smooth = np.max(corners, axis=0) < 1.05 * np.min(corners, axis=0)
            error = np.abs(found / z - 1)
        off.append(error[smooth & (error < 0.02)])
    return summary(np.concatenate(off))


def read_ply(path):
    data = path.read_bytes()
    head, body = data.split(b"end_header\n", 1)
    counts = [int(line.split()[2]) for line in head.splitlines() if line.startswith(b"element")]
    vertices = np.frombuffer(body, "<f4", 3 * counts[0]).reshape(-1, 3).astype(float)
    kind = np.dtype(
        [("count", "u1"), ("corners", "<u4", 3), ("class", "u1"), ("walkable", "u1"), ("plane", "<i4")]
    )
    faces = np.frombuffer(body, kind, counts[1], offset=12 * counts[0])
    assert (faces["count"] == 3).all() and len(body) == 12 * counts[0] + kind.itemsize * counts[1]
    return vertices[faces["corners"]], faces["class"]


def cast(triangles, origin, direction):
    """Distance along a ray and number of the first triangle (Moeller and Trumbore 1997)."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    ab, ac = b - a, c - a
    normal = np.cross(direction, ac)
    determinant = (ab * normal).sum(1)
    with np.errstate(divide="ignore", invalid="ignore"):
        arm = origin - a
        u = (arm * normal).sum(1) / determinant
        side = np.cross(arm, ab)
        v = (side @ direction) / determinant
        t = (ac * side).sum(1) / determinant
    t[~((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0))] = np.inf
    return t.min(), int(t.argmin())


def mesh(walk, eye, names):
    """Depth and class against rays cast into scene.ply from the eye's true pose."""
    triangles, classes = read_ply(walk / "scene.ply")
    table = np.loadtxt(eye.root / "state_groundtruth_estimate0/data.csv", delimiter=",")
    rays = eye.rays()
    chosen = np.random.default_rng(3)
    off, same, edges = [], 0, 0
    for name in names:
        row = table[np.flatnonzero(table[:, 0] == int(name[:-4]))[0]]
        w, x, y, z = row[4:8]
        turn = np.array([
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ])  # fmt: skip
        origin = turn @ eye.body_from_eye[:3, 3] + row[1:4]
        turn = turn @ eye.body_from_eye[:3, :3]
        depths, seen = eye.layer("depth", name) / 1000, eye.layer("class", name)
        for _ in range(60):
            u, v = chosen.integers(eye.size[0]), chosen.integers(eye.size[1])
            # People move, and are not in the mesh; the sky has no depth.
            if seen[v, u] == 8 or depths[v, u] == 0:
                continue
            distance, triangle = cast(triangles, origin, turn @ rays[v, u])
            error = abs(distance / depths[v, u] - 1)
            if error > 0.02:
                edges += 1
                continue
            # To the mm is what the file can say.
            off.append(max(error - 0.0005 / depths[v, u], 0))
            same += int(classes[triangle] == seen[v, u])
    return {**summary(off), "same class": same, "at edges": edges}


def flow(eye, names):
    """The next image, brought back by the true flow, against this one; gray levels."""
    v, u = np.indices(eye.size[::-1], dtype=np.float32)
    plain, warped, moved, shares = [], [], [], []
    for a, b in zip(names, names[1:]):
        # OpenCV has blue first.
        truth = eye.layer("flow", a)[..., ::-1]
        by = (truth[..., :2].astype(np.float32) - 32768) / 64
        length = np.hypot(by[..., 0], by[..., 1])
        good = (truth[..., 2] == 1) & (length > 1)
        first, second = (eye.layer("cam", name).astype(np.float32) for name in (a, b))
        back = cv2.remap(second, u + by[..., 0], v + by[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        plain.append(np.abs(second - first)[good])
        warped.append(np.abs(back - first)[good])
        moved.append(length[good])
        shares.append((truth[..., 2] == 1).mean())
    plain, warped, moved = (np.concatenate(x) for x in (plain, warped, moved))
    return {
        "pixels": len(plain),
        "moved": summary(moved),
        "plain": float(plain.mean()),
        "warped": float(warped.mean()),
        "plain median": float(np.median(plain)),
        "warped median": float(np.median(warped)),
        "shown": float(np.mean(shares)),
    }


def main():
    walk = Path(sys.argv[1])
    shoulder, feet = walk / "left_shoulder/mav0", walk / "feet/mav0"
    names = images(shoulder)
    report = {"tags": tags(feet), "flow": {}, "depth": {}}
    for name, root in (("shoulder", shoulder), ("feet", feet)):
        left, right = Eye(root, 0), Eye(root, 1)
        report["flow"][name] = {"left": flow(left, names), "right": flow(right, names)}
        report["depth"][name] = depth(left, right, names[::4])
        if not left.is_rolling:
            report["rows"] = rows(left, right, names)
            report["mesh"] = mesh(walk, left, names[::3])
    json.dump(report, sys.stdout)


if __name__ == "__main__":
    main()
