"""OpenCV's map and remap of one eye: JSON on standard input, JSON out. Times are the best of many, in ms, on one thread."""

import json
import sys
import time

import cv2
import numpy as np

cv2.setNumThreads(1)
job = json.load(sys.stdin)


def best(work):
    times = []
    for _ in range(job["runs"]):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return 1e3 * min(times)


size = tuple(job["size"])
old, new = np.float64(job["old"]).reshape(3, 3), np.float64(job["new"]).reshape(3, 3)
rotation, distortion = np.float64(job["rotation"]).reshape(3, 3), np.float64(job["distortion"])
make = lambda: cv2.initUndistortRectifyMap(old, distortion, rotation, new, size, cv2.CV_32FC1)
x, y = make()
columns, rows = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
image = ((3 * columns + 2 * rows) % 160).astype(np.uint8)
print(json.dumps({
    "map_ms": best(make),
    "remap_ms": best(lambda: cv2.remap(image, x, y, cv2.INTER_LINEAR)),
    "version": cv2.__version__,
}))
