"""Renders the walk of `trajectory.py` through the scene of `scene.py` with Mitsuba 3, as a folder in
EuRoC's format.

    python render.py FOLDER [--pairs N]

FOLDER/mav0 has cam0, cam1, imu0 and state_groundtruth_estimate0; FOLDER/disparity has the true
disparity of the left image for every eighth pair (little-endian f32, row-major, NaN where there is
no surface or the glass pane). Existing images are kept, so that a run that was ended goes on.

Camera: pinhole, rectified, thin lens of 2.4 mm aperture focused at 2 m, exposure 8 ms: four
instants of the shutter with nine samples each. Samples per pixel are fixed: nothing depends on
the speed of the machine. Response: sRGB, then noise of read-out and photons with a fixed seed.
Monte Carlo noise of the renderer comes on top of it.
"""

import argparse
import ctypes.util
import glob
import hashlib
import json
import os
import time
from pathlib import Path

# LLVM 14 and 15 fail on processors with 16-bit floats ("cannot select"); the newest one is taken.
newest = sorted(glob.glob("/usr/lib/*/libLLVM.so.*") + glob.glob("/usr/lib/*/libLLVM-1[6-8].so.1"))
if newest and "DRJIT_LIBLLVM_PATH" not in os.environ:
    os.environ["DRJIT_LIBLLVM_PATH"] = newest[-1]

import mitsuba as mi
import numpy as np
from PIL import Image

has_llvm = "DRJIT_LIBLLVM_PATH" in os.environ or ctypes.util.find_library("LLVM")
VARIANT = "llvm_ad_mono" if has_llvm else "scalar_rgb"
mi.set_variant(VARIANT)

import scene as scenery
import trajectory

WIDTH, HEIGHT, FOCAL = 416, 264, 252.0
BASELINE = 0.11
RATE_HZ, PAIRS = 12, 120
START_NS = 1_700_000_000_000_000_000
IMU_HZ = 200
EXPOSURE_S, INSTANTS, SAMPLES = 0.008, 4, 9
APERTURE_M, FOCUS_M = 0.0012, 2.0
SEED = 24
EXPOSURE_GAIN = 0.42
# Densities of EuRoC's ADIS16448, continuous time: rad/s/sqrt(Hz), rad/s^2/sqrt(Hz), and m/s^2.
GYRO, GYRO_WALK, ACCEL, ACCEL_WALK = 1.7e-4, 1.9e-5, 2.0e-3, 3.0e-3
GYRO_BIAS, ACCEL_BIAS = [0.004, -0.011, 0.007], [0.05, -0.08, 0.03]
DEPTH_EVERY = 8
# imu_from_left: optical axes (x right, y down, z forward) in the body, lever arm in m.
ROTATION = np.array([[0, 0, 1.0], [-1, 0, 0], [0, -1, 0]])
ARM = {0: np.array([0.03, 0.055, 0.01]), 1: np.array([0.03, 0.055 - BASELINE, 0.01])}


def sensor_matrix(t, eye):
    """Mitsuba's sensor: x left, y up, z forward."""
    r, p = trajectory.pose(t)
    m = np.eye(4)
    m[:3, :3] = r @ ROTATION @ np.diag([-1.0, -1.0, 1.0])
    m[:3, 3] = p + r @ ARM[eye]
    return m


def sensor():
    return mi.load_dict(
        {
            "type": "thinlens",
            "aperture_radius": APERTURE_M,
            "focus_distance": FOCUS_M,
            "fov": float(np.degrees(2 * np.arctan(WIDTH / 2 / FOCAL))),
            "near_clip": 0.05,
            "far_clip": 100.0,
            "film": {
                "type": "hdrfilm",
                "width": WIDTH,
                "height": HEIGHT,
                "pixel_format": "luminance",
                "rfilter": {"type": "box"},
            },
            "sampler": {"type": "multijitter", "sample_count": SAMPLES},
        }
    )


def render(scene, camera, params, t, eye, seed):
    total = np.zeros((HEIGHT, WIDTH))
    for k in range(INSTANTS):
        at = t + EXPOSURE_S * ((k + 0.5) / INSTANTS - 0.5)
        params["to_world"] = mi.Transform4f(sensor_matrix(at, eye))
        params.update()
        image = mi.render(scene, sensor=camera, spp=SAMPLES, seed=seed * INSTANTS + k)
        total += np.array(image).reshape(HEIGHT, WIDTH, -1)[..., 0]
    return total / INSTANTS


def develop(radiance, seed):
    """8-bit pixels."""
    rng = np.random.default_rng([SEED, seed])
    x = np.clip(EXPOSURE_GAIN * radiance, 0, 1)
    # Photons: a full well of 8000 electrons; read-out: 8 electrons.
    x = x + rng.standard_normal(x.shape) * np.sqrt(x / 8000 + (8 / 8000) ** 2)
    x = np.clip(x, 0, 1)
    srgb = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    return np.clip(np.round(255 * srgb), 0, 255).astype(np.uint8)


def disparity(scene, t):
    """Of the first surface along the ray through each pixel's center and the lens's center."""
    m = sensor_matrix(t, 0)
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH]
    # Integer coordinates are centers: the principal point is at (WIDTH - 1) / 2.
    x, y = (u - (WIDTH - 1) / 2) / FOCAL, (v - (HEIGHT - 1) / 2) / FOCAL
    d = np.stack([-x, -y, np.ones_like(x)], -1).reshape(-1, 3) @ m[:3, :3].T
    if "scalar" in VARIANT:
        hits = [
            (lambda si: (si.t, si.is_valid() and si.shape.id() != scenery.GLASS))(
                scene.ray_intersect(mi.Ray3f(m[:3, 3], list(row)))
            )
            for row in d
        ]
        z, good = np.array([h[0] for h in hits]), np.array([h[1] for h in hits])
    else:
        ray = mi.Ray3f(mi.Point3f([float(v) for v in m[:3, 3]]), mi.Vector3f(d.T.astype(np.float32)))
        hit = scene.ray_intersect(ray)
        pane = [s for s in scene.shapes() if s.id() == scenery.GLASS][0]
        z = np.array(hit.t)
        good = np.array(hit.is_valid()) & ~np.array(hit.shape == mi.ShapePtr(pane))
    # The direction has a component of 1 along the optical axis: t is the depth.
    return np.where(good, FOCAL * BASELINE / z, np.nan).reshape(HEIGHT, WIDTH)


def times():
    return [k / RATE_HZ for k in range(PAIRS)]


def stamp(t):
    return START_NS + round(t * 1e9)


def lines(path, header, rows):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join([header, *rows]) + "\n")


def yaml_matrix(rotation, translation):
    m = np.vstack([np.column_stack([rotation, translation]), [0, 0, 0, 1]])
    values = ", ".join(f"{v:.12g}" for v in m.ravel())
    return f"T_BS:\n  cols: 4\n  rows: 4\n  data: [{values}]\n"


def write_sensors(mav):
    for eye in (0, 1):
        folder = mav / f"cam{eye}"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "sensor.yaml").write_text(
            "sensor_type: camera\ncomment: rendered by Mitsuba 3\n"
            + yaml_matrix(ROTATION, ARM[eye])
            + f"rate_hz: {RATE_HZ}\nresolution: [{WIDTH}, {HEIGHT}]\ncamera_model: pinhole\n"
            f"intrinsics: [{FOCAL}, {FOCAL}, {(WIDTH - 1) / 2}, {(HEIGHT - 1) / 2}]\n"
            "distortion_model: radial-tangential\ndistortion_coefficients: [0.0, 0.0, 0.0, 0.0]\n"
        )
        rows = [f"{stamp(t)},{stamp(t)}.png" for t in times()]
        lines(folder / "data.csv", "#timestamp [ns],filename", rows)
    (mav / "imu0").mkdir(parents=True, exist_ok=True)
    (mav / "imu0/sensor.yaml").write_text(
        "sensor_type: imu\ncomment: derived from the trajectory\n"
        + yaml_matrix(np.eye(3), np.zeros(3))
        + f"rate_hz: {IMU_HZ}\ngyroscope_noise_density: {GYRO}\n"
        f"gyroscope_random_walk: {GYRO_WALK}\naccelerometer_noise_density: {ACCEL}\n"
        f"accelerometer_random_walk: {ACCEL_WALK}\n"
    )


def write_motion(mav):
    trajectory.check()
    rng = np.random.default_rng([SEED, 1])
    gyro, accel = np.array(GYRO_BIAS), np.array(ACCEL_BIAS)
    imu, truth = [], []
    for k in range(int(IMU_HZ * (PAIRS / RATE_HZ + 0.1))):
        t = k / IMU_HZ
        r, p = trajectory.pose(t)
        velocity, rate, force = trajectory.inertial(t)
        white = np.sqrt(IMU_HZ) * rng.standard_normal(6)
        measured = [*(rate + gyro + GYRO * white[:3]), *(force + accel + ACCEL * white[3:])]
        imu.append(",".join([str(stamp(t)), *(f"{v:.9f}" for v in measured)]))
        q = trajectory.quaternion(r)
        state = [*p, *q, *velocity, *gyro, *accel]
        truth.append(",".join([str(stamp(t)), *(f"{v:.9f}" for v in state)]))
        walk = rng.standard_normal(6) / np.sqrt(IMU_HZ)
        gyro, accel = gyro + GYRO_WALK * walk[:3], accel + ACCEL_WALK * walk[3:]
    lines(mav / "imu0/data.csv", "#timestamp [ns],wx,wy,wz [rad/s],ax,ay,az [m/s^2]", imu)
    header = "#timestamp [ns],p xyz [m],q wxyz,v xyz [m/s],b_w xyz [rad/s],b_a xyz [m/s^2]"
    lines(mav / "state_groundtruth_estimate0/data.csv", header, truth)


def checksum(folder):
    """Of all pixels in order; equal on machines whose floats round alike."""
    digest = hashlib.sha256()
    for path in sorted(folder.glob("mav0/cam?/data/*.png")):
        digest.update(np.array(Image.open(path)).tobytes())
    return digest.hexdigest()[:16]


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("--pairs", type=int, default=PAIRS)
    options = parser.parse_args()
    mav = options.folder / "mav0"
    log = options.folder / "render.json"
    spent = json.loads(log.read_text()) if log.exists() else {"images": 0, "seconds": 0.0}
    write_sensors(mav)
    write_motion(mav)
    (options.folder / "disparity").mkdir(exist_ok=True)
    scene = None
    for k, t in list(enumerate(times()))[: options.pairs]:
        images = [mav / f"cam{eye}/data/{stamp(t)}.png" for eye in (0, 1)]
        truth = options.folder / f"disparity/{stamp(t)}.f32"
        needs_truth = k % DEPTH_EVERY == 0 and not truth.exists()
        if all(path.exists() for path in images) and not needs_truth:
            continue
        if scene is None:
            scene = mi.load_dict(scenery.build(SEED))
            camera = sensor()
            params = mi.traverse(camera)
        for eye, path in enumerate(images):
            if path.exists():
                continue
            begin = time.perf_counter()
            path.parent.mkdir(exist_ok=True)
            pixels = develop(render(scene, camera, params, t, eye, 2 * k + eye), 2 * k + eye)
            part = path.with_suffix(".part")
            Image.fromarray(pixels).save(part, format="png")
            part.rename(path)
            spent["images"] += 1
            spent["seconds"] += time.perf_counter() - begin
        if needs_truth:
            disparity(scene, t).astype("<f4").tofile(truth)
        log.write_text(json.dumps(spent))
        print(f"pair {k + 1} of {options.pairs}, {spent['seconds'] / spent['images']:.1f} s per image", flush=True)
    spent["seconds_per_image"] = round(spent["seconds"] / max(1, spent["images"]), 1)
    spent["mitsuba"], spent["variant"] = mi.__version__, VARIANT
    spent["size"], spent["samples"] = [WIDTH, HEIGHT], INSTANTS * SAMPLES
    spent["sha256"] = checksum(options.folder)
    log.write_text(json.dumps(spent))


main()
