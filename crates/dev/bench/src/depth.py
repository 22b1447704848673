"""OpenCV's stereo matchers, kept between pairs: a line of JSON in, a line of JSON out, until the input ends.

A pair: {"left": FILE, "right": FILE, "size": [columns, rows], "range": N, "threads": N, "out": FOLDER or null,
"configs": [{"mode": ..., "block": N, "unique": N, "speckle": N, "smooth": bool}]}. Images are bytes without a header. The answer has
the time of each matcher in ms; with "out" its disparities are written there as K.raw, 16-bit, in sixteenths of a pixel,
negative where there is none."""

import json
import os
import sys
import time

import cv2
import numpy as np

made = {}


def make(config, count):
    block, unique, speckle = config["block"], config["unique"], config["speckle"]
    if config["mode"] == "BM":
        matcher = cv2.StereoBM_create(count, block)
        matcher.setUniquenessRatio(unique)
        matcher.setSpeckleWindowSize(100)
        matcher.setSpeckleRange(speckle)
        matcher.setDisp12MaxDiff(1)
        return matcher
    # P1 and P2 as in OpenCV's documentation, for one channel.
    return cv2.StereoSGBM_create(
        0, count, block, 8 * block * block, 32 * block * block, 1, 63, unique, 100, speckle,
        getattr(cv2, "STEREO_SGBM_MODE_" + config["mode"]),
    )


print(json.dumps({"version": cv2.__version__, "threads": cv2.getNumThreads()}), flush=True)
for line in sys.stdin:
    job = json.loads(line)
    cv2.setNumThreads(job["threads"])
    size = tuple(job["size"])
    left, right = (np.fromfile(job[eye], np.uint8).reshape(size[1], size[0]) for eye in ("left", "right"))
    times = []
    for k, config in enumerate(job["configs"]):
        name = json.dumps([config, size, job["range"]])
        matcher = made.setdefault(name, None) or make(config, job["range"])
        made[name] = matcher
        begin = time.perf_counter()
        pair = [cv2.GaussianBlur(eye, (3, 3), 0) for eye in (left, right)] if config["smooth"] else [left, right]
        found = matcher.compute(*pair)
        times.append(1e3 * (time.perf_counter() - begin))
        if job["out"]:
            # BM and SGBM say "none" by a disparity below the first one.
            found.astype(np.int16).tofile(os.path.join(job["out"], f"{k}.raw"))
    print(json.dumps({"ms": times}), flush=True)
