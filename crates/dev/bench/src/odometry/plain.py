"""Plain visual odometry of OpenCV's parts over rectified stereo pairs: SGBM for depth, KLT for corners, PnP for each motion.

{"folder": FOLDER with image_l and image_r, "focal_px": f, "center_px": [x, y], "baseline_m": b, "threads": N} on the standard input.
The answer: {"poses": [[12 numbers]], "ms": time of a pair, "opencv": version}; rows of the first left camera from each."""

import json
import pathlib
import sys
import time

import cv2
import numpy as np

CORNERS = 2000
NEAREST_PX = 8
LEAST_DISPARITY = 4.0


def disparities(matcher, left, right):
    return matcher.compute(left, right).astype(np.float32) / 16.0


def followed(before, now):
    """Corners of an image and their positions in the next, with forward-backward check."""
    corners = cv2.goodFeaturesToTrack(before, CORNERS, 0.005, NEAREST_PX)
    settings = {"winSize": (21, 21), "maxLevel": 4}
    there, found, _ = cv2.calcOpticalFlowPyrLK(before, now, corners, None, **settings)
    back, found_back, _ = cv2.calcOpticalFlowPyrLK(now, before, there, None, **settings)
    off = np.linalg.norm((back - corners).reshape(-1, 2), axis=1)
    kept = (found.ravel() > 0) & (found_back.ravel() > 0) & (off < 0.5)
    return corners.reshape(-1, 2)[kept], there.reshape(-1, 2)[kept]


def motion(question, before, disparity, now):
    """The next camera from the one before."""
    focal, (x, y) = question["focal_px"], question["center_px"]
    old, new = followed(before, now)
    rows, columns = disparity.shape
    at = np.rint(old).astype(int)
    found = disparity[at[:, 1].clip(0, rows - 1), at[:, 0].clip(0, columns - 1)]
    kept = found > LEAST_DISPARITY
    old, new, found = old[kept], new[kept], found[kept]
    z = focal * question["baseline_m"] / found
    points = np.stack([(old[:, 0] - x) * z / focal, (old[:, 1] - y) * z / focal, z], axis=1)
    camera = np.array([[focal, 0, x], [0, focal, y], [0, 0, 1.0]])
    solved, turn, shift, fitting = cv2.solvePnPRansac(
        points, new, camera, None, iterationsCount=300, reprojectionError=1.0, confidence=0.9999
    )
    if not solved:
        raise SystemExit("no motion fits")
    fitting = fitting.ravel()
    turn, shift = cv2.solvePnPRefineLM(points[fitting], new[fitting], camera, None, turn, shift)
    moved = np.eye(4)
    moved[:3, :3], moved[:3, 3] = cv2.Rodrigues(turn)[0], shift.ravel()
    return moved


def main():
    question = json.load(sys.stdin)
    cv2.setNumThreads(question["threads"])
    cv2.setRNGSeed(1)
    matcher = cv2.StereoSGBM_create(0, 96, 5, 8 * 25, 32 * 25, 1, 63, 10, 100, 2)
    folder = pathlib.Path(question["folder"])
    sides = [sorted((folder / side).glob("*.png")) for side in ("image_l", "image_r")]
    read = [[cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in pair] for pair in zip(*sides)]
    began = time.perf_counter()
    poses, before, disparity = [np.eye(4)], None, None
    for left, right in read:
        if before is not None:
            poses.append(poses[-1] @ np.linalg.inv(motion(question, before, disparity, left)))
        before, disparity = left, disparities(matcher, left, right)
    ms = 1e3 * (time.perf_counter() - began) / len(read)
    rows = [pose[:3].ravel().tolist() for pose in poses]
    json.dump({"poses": rows, "ms": ms, "opencv": cv2.__version__}, sys.stdout)


main()
