"""Fuses depth maps with Open3D on the CPU, in a `VoxelBlockGrid`.

Standard input has JSON: `folder`, `frames` (each with `width`, `height`, `focal`, `center`,
`view_from_world` as 4x4 rows; depth of frame k lies in `k.bin`, f32, m, 0 for none), `voxel_m`,
`truncation_voxels`, `max_depth_m`, `threads`, `repeats`. Standard output has JSON: the version and
for each method the ms and ms of processor time per keyframe of each repeat, and the files of its mesh.
"""

import json
import os
import sys
import time

question = json.load(sys.stdin)
os.environ["OMP_NUM_THREADS"] = str(question["threads"])

import numpy as np  # noqa: E402
import open3d as o3d  # noqa: E402

MAX_BLOCKS = 60000


def frames():
    for number, frame in enumerate(question["frames"]):
        depth = np.fromfile(os.path.join(question["folder"], f"{number}.bin"), np.float32)
        yield frame, depth.reshape(frame["height"], frame["width"])


def now():
    return np.array([time.perf_counter(), time.process_time()])


def matrix(frame):
    (fx, fy), (cx, cy) = frame["focal"], frame["center"]
    return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])


def tensor():
    device = o3d.core.Device("CPU:0")
    grid = o3d.t.geometry.VoxelBlockGrid(
        attr_names=("tsdf", "weight"),
        attr_dtypes=(o3d.core.float32, o3d.core.float32),
        attr_channels=((1), (1)),
        voxel_size=question["voxel_m"],
        block_resolution=8,
        block_count=MAX_BLOCKS,
        device=device,
    )
    seconds = np.zeros(2)
    for frame, depth in frames():
        image = o3d.t.geometry.Image(o3d.core.Tensor(depth[:, :, None]))
        intrinsic = o3d.core.Tensor(matrix(frame))
        extrinsic = o3d.core.Tensor(np.array(frame["view_from_world"]).reshape(4, 4))
        far, margin = question["max_depth_m"], question["truncation_voxels"]
        begin = now()
        if not np.any(depth > 0):
            continue
        blocks = grid.compute_unique_block_coordinates(
            image, intrinsic, extrinsic, 1.0, far, margin
        )
        grid.integrate(blocks, image, intrinsic, extrinsic, 1.0, far, margin)
        seconds += now() - begin
    return seconds, lambda: grid.extract_triangle_mesh(weight_threshold=0.5).to_legacy()


answer = {"version": o3d.__version__, "methods": {}}
for name, method in (("VoxelBlockGrid", tensor),):
    times = []
    for _ in range(question["repeats"]):
        seconds, extract = method()
        times.append(list(1e3 * seconds / max(1, len(question["frames"]))))
    mesh = extract()
    vertices = np.asarray(mesh.vertices, np.float32)
    triangles = np.asarray(mesh.triangles, np.uint32)
    files = [f"{name}-vertices.bin", f"{name}-triangles.bin"]
    for file, values in zip(files, (vertices, triangles)):
        np.ascontiguousarray(values).tofile(os.path.join(question["folder"], file))
    answer["methods"][name] = {"ms": times, "files": files}
json.dump(answer, sys.stdout)
