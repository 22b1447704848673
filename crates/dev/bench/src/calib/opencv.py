"""OpenCV's calibration of one stereo camera from given corners: JSON on standard input, JSON out."""

import json
import sys
import time

import cv2
import numpy as np

cv2.setNumThreads(2)
job = json.load(sys.stdin)
size = tuple(job["size"])
# Corners that both eyes saw; a view is one instant.
both = [([np.float32(view[eye]) for eye in ("left", "right")], np.float32(view["points"])) for view in job["views"]]
objects = [points for _, points in both]
left, right = [images[0] for images, _ in both], [images[1] for images, _ in both]
begin = time.process_time()
guess = lambda name: np.float64(job[name]["k"]).reshape(3, 3)
distortion = lambda name: np.float64(job[name]["d"])
flags = cv2.CALIB_USE_INTRINSIC_GUESS
_, k1, d1, _, _ = cv2.calibrateCamera(objects, left, size, guess("left"), distortion("left"), flags=flags)
_, k2, d2, _, _ = cv2.calibrateCamera(objects, right, size, guess("right"), distortion("right"), flags=flags)
end = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-7)
rms, k1, d1, k2, d2, r, t, _, _ = cv2.stereoCalibrate(
    objects, left, right, k1, d1, k2, d2, size, flags=flags, criteria=end)
print(json.dumps({
    "rms_px": rms, "seconds": time.process_time() - begin,
    "left": [k1[0, 0], k1[1, 1], k1[0, 2], k1[1, 2], *d1.ravel()[:5]],
    "rotation_rows": r.ravel().tolist(), "translation_m": t.ravel().tolist(),
}))
