"""Tags by the reference implementation, AprilTag 3, through pupil-apriltags: JSON in, JSON out.

In: {"images": [FILE], "size": [columns, rows], "decimations": [N]}; images are bytes without a header.
Out: {"version": TEXT, "methods": [{"name": TEXT, "images": [{"ms": N, "tags": [{"id": N, "corners": [[x, y]]}]}]}]}, with the
processor time of this process, which has one thread."""

import importlib.metadata
import json
import sys
import time

import numpy as np
from pupil_apriltags import Detector

job = json.load(sys.stdin)
columns, rows = job["size"]
images = [np.fromfile(path, np.uint8).reshape(rows, columns) for path in job["images"]]
methods = []
for decimation in job["decimations"]:
    detector = Detector(families="tag36h11", nthreads=1, quad_decimate=float(decimation))
    answers = []
    for image in images:
        begin = time.process_time()
        found = detector.detect(image)
        ms = 1e3 * (time.process_time() - begin)
        # Its pixel centers are at halves. Its corners: bottom left, bottom right, top right, top left.
        tags = [{"id": tag.tag_id, "corners": (tag.corners - 0.5).tolist()} for tag in found]
        answers.append({"ms": ms, "tags": tags})
    methods.append({"name": f"AprilTag 3, decimation {decimation}", "images": answers})
version = "pupil-apriltags " + importlib.metadata.version("pupil-apriltags")
print(json.dumps({"version": version, "methods": methods}))
