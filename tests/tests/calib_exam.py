"""OpenCV's calibration of stereo pairs of a chessboard, for comparison with ours.

    calib_exam.py FOLDER COLUMNS ROWS SQUARE_M

FOLDER holds left01.jpg, right01.jpg and so on. Prints one JSON object: the corners that OpenCV finds, its
stereo RMS over all pairs, and the parameters from all pairs and from either half of them (every other one).
"""

import json
import sys
from pathlib import Path

import cv2
import numpy as np

cv2.setNumThreads(1)

folder, columns, rows, square = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4])
board = np.zeros((columns * rows, 3), np.float32)
board[:, :2] = np.mgrid[0:columns, 0:rows].T.reshape(-1, 2) * square


def corners(path):
    grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    found, points = cv2.findChessboardCorners(grey, (columns, rows))
    if not found:
        raise SystemExit(f"OpenCV finds no chessboard in {path}")
    end = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
    return cv2.cornerSubPix(grey, points, (5, 5), (-1, -1), end).reshape(-1, 2), grey.shape[::-1]


names = sorted(path.name[4:] for path in folder.glob("left*.jpg"))
pairs = [[corners(folder / f"{side}{name}")[0] for side in ("left", "right")] for name in names]
size = corners(folder / f"left{names[0]}")[1]


def calibrate(numbers):
    objects = [board for _ in numbers]
    seen = [[pairs[n][eye] for n in numbers] for eye in (0, 1)]
    single = [cv2.calibrateCamera(objects, images, size, None, None) for images in seen]
    end = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 200, 1e-9)
    rms, k1, d1, k2, d2, r, t, _, _ = cv2.stereoCalibrate(
        objects, seen[0], seen[1],
        single[0][1], single[0][2], single[1][1], single[1][2], size,
        flags=cv2.CALIB_USE_INTRINSIC_GUESS, criteria=end,
    )
    lens = lambda k, d: [k[0, 0], k[1, 1], k[0, 2], k[1, 2], *d.ravel()[:5]]
    return {"rms_px": rms, "left": lens(k1, d1), "right": lens(k2, d2),
            "rotation_rows": r.ravel().tolist(), "translation_m": t.ravel().tolist()}


everything = range(len(pairs))
print(json.dumps({
    "corners": [[eye.tolist() for eye in pair] for pair in pairs],
    "all": calibrate(list(everything)),
    "even": calibrate([n for n in everything if n % 2 == 0]),
    "odd": calibrate([n for n in everything if n % 2 == 1]),
}))
