"""Statistics of simulated images beside those of real ones.

    sim_images.py WALKS DATA OUT.json

WALKS holds one folder per walk, as `paws-rig-sim render --truth` writes it; DATA is the folder of real
recordings. OUT.json gets every number, OUT.md beside it the table.

What is measured, of every image, pair or sequence, with the same code for real and simulated ones:

- gradient: length of the luma's gradient (Scharr, per pixel) over the image's mean luma, percentiles;
- slope: exponent of the power spectrum over the spatial frequency, 0.02 to 0.3 cycles per pixel, of a
  square under a Hann window; images of nature have about -2;
- noise: standard deviation of the noise in grey levels (Immerkaer 1996);
- matched: share of pixels whose disparity from OpenCV's SGBM is confirmed by the match from right to
  left within 1 px; apart: mean difference of those two, px;
- error: median error of the confirmed disparities, px, and the share of them wrong by more than 2 px,
  where there is truth;
- corners: how many Shi-Tomasi corners there are per 100 000 pixels; kept: share of tracks that pyramidal
  Lucas-Kanade takes to the next image and back within 0.5 px; length: median number of images a track
  lives, among the first 10.
"""

import json
import sys
from pathlib import Path

import cv2
import numpy as np

TRACKED = 10
cv2.setNumThreads(1)


def grey(path):
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise SystemExit(f"reading an image: {path}")
    return image


# --- what is measured ---------------------------------------------------------------------------


def of_image(image):
    """Gradient, spectrum and noise."""
    luma = image.astype(np.float64)
    gradient = np.hypot(cv2.Scharr(luma, -1, 1, 0), cv2.Scharr(luma, -1, 0, 1)) / 32
    inner = gradient[1:-1, 1:-1] / max(luma.mean(), 1)
    found = {f"gradient p{p}": np.percentile(inner, p) for p in (50, 90, 99)}

    side = min(luma.shape)
    top, left = (luma.shape[0] - side) // 2, (luma.shape[1] - side) // 2
    square = luma[top : top + side, left : left + side]
    window = np.outer(np.hanning(side), np.hanning(side))
    power = np.abs(np.fft.fft2((square - square.mean()) * window)) ** 2
    f = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.fftfreq(side)[None, :])
    edges = np.geomspace(0.02, 0.3, 15)
    rings = [(f >= a) & (f < b) for a, b in zip(edges, edges[1:])]
    means = [np.log(power[ring].mean()) for ring in rings]
    found["slope"] = np.polyfit(np.log(np.sqrt(edges[1:] * edges[:-1])), means, 1)[0]

    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], float)
    residual = cv2.filter2D(luma, -1, kernel)[1:-1, 1:-1]
    found["noise"] = np.sqrt(np.pi / 2) * np.abs(residual).mean() / 6
    return found


def disparity(left, right, most):
    """Left disparities, those confirmed from the right, and how far the two are apart."""
    matcher = cv2.StereoSGBM_create(0, most, 5, 8 * 25, 32 * 25, 0, 31, 5, 100, 2, cv2.STEREO_SGBM_MODE_SGBM_3WAY)
    forth = matcher.compute(left, right).astype(np.float32) / 16
    mirrored = matcher.compute(np.ascontiguousarray(right[:, ::-1]), np.ascontiguousarray(left[:, ::-1]))
    back = np.ascontiguousarray(mirrored[:, ::-1]).astype(np.float32) / 16
    rows, columns = np.indices(forth.shape)
    at = np.rint(columns - forth).astype(int)
    there = back[rows, at.clip(0, forth.shape[1] - 1)]
    apart = np.abs(forth - there)
    return forth, (forth > 0) & (at >= 0) & (there > 0) & (apart <= 1), apart


def of_pair(left, right, most, truth=None, inside=None):
    """How well SGBM matches; `truth` are disparities, not finite where there is none."""
    forth, confirmed, apart = disparity(left, right, most)
    inside = np.ones(left.shape, bool) if inside is None else inside.copy()
    # The matcher leaves these columns out.
    inside[:, :most] = False
    found = {"matched": confirmed[inside].mean()}
    good = confirmed & inside
    if good.any():
        found["apart px"] = apart[good].mean()
    if truth is not None:
        good &= np.isfinite(truth) & (truth < most)
        if good.any():
            error = np.abs(forth - truth)[good]
            found["error px"] = np.median(error)
            found["error > 2 px"] = (error > 2).mean()
    return found


def of_sequence(images):
    """How many corners there are, and how long they can be tracked."""
    first = images[0]
    corners = cv2.goodFeaturesToTrack(first, 0, 0.01, 5)
    if corners is None:
        return {"corners": 0.0}
    count = len(corners)
    length = np.ones(count)
    alive = np.arange(count)
    kept = []
    options = dict(winSize=(21, 21), maxLevel=3)
    for a, b in zip(images, images[1:TRACKED]):
        if not len(alive):
            break
        there, fine, _ = cv2.calcOpticalFlowPyrLK(a, b, corners, None, **options)
        again, fine_too, _ = cv2.calcOpticalFlowPyrLK(b, a, there, None, **options)
        away = np.linalg.norm(again - corners, axis=2).ravel()
        inside = ((there >= 0) & (there < (b.shape[1], b.shape[0]))).all(axis=2).ravel()
        stays = (fine.ravel() == 1) & (fine_too.ravel() == 1) & (away < 0.5) & inside
        kept.append(stays.mean())
        corners, alive = there[stays], alive[stays]
        length[alive] += 1
    return {
        "corners": 1e5 * count / first.size,
        "kept": float(np.mean(kept)),
        "length": float(np.median(length)),
    }


# --- where images come from ---------------------------------------------------------------------


class Source:
    """Rectified images of one camera and what was measured of them."""

    def __init__(self, name, real):
        self.name, self.real, self.values = name, real, {}

    def add(self, found):
        for key, value in found.items():
            self.values.setdefault(key, []).append(float(value))

    def measure(self, lefts, rights=(), most=64, truths=None, inside=None, sequence=False, every=1):
        for k in range(0, len(lefts), every):
            self.add(of_image(lefts[k]))
            if rights:
                self.add(of_pair(lefts[k], rights[k], most, truths[k] if truths else None, inside))
        if sequence:
            for k in range(0, len(lefts) - TRACKED + 1, TRACKED):
                self.add(of_sequence(lefts[k : k + TRACKED]))
        return self


def sensor(folder):
    """Camera matrix, distortion and body_from_camera of a sensor.yaml."""
    lines = [line for line in (folder / "sensor.yaml").read_text().splitlines() if not line.startswith("%")]
    words = " ".join(line.split("#")[0] for line in lines)

    def numbers(key):
        return [float(v) for v in words.split(key + ":")[1].split("[")[1].split("]")[0].split(",")]

    fu, fv, cu, cv = numbers("intrinsics")
    matrix = np.array([[fu, 0, cu], [0, fv, cv], [0, 0, 1]])
    size = tuple(int(v) for v in numbers("resolution"))
    return matrix, np.array(numbers("distortion_coefficients")), np.array(numbers("data")).reshape(4, 4), size


class Rectifier:
    """OpenCV's, from the calibration beside the images."""

    def __init__(self, root):
        (ka, da, body_from_a, self.size), (kb, db, body_from_b, _) = sensor(root / "cam0"), sensor(root / "cam1")
        b_from_a = np.linalg.inv(body_from_b) @ body_from_a
        flags = cv2.CALIB_ZERO_DISPARITY
        self.ra, rb, pa, pb, *_ = cv2.stereoRectify(
            ka, da, kb, db, self.size, b_from_a[:3, :3], b_from_a[:3, 3], flags=flags, alpha=0
        )
        self.k, self.baseline = pa[:, :3], -pb[0, 3] / pb[0, 0]
        maps = cv2.CV_32FC1
        self.a = cv2.initUndistortRectifyMap(ka, da, self.ra, pa, self.size, maps)
        self.b = cv2.initUndistortRectifyMap(kb, db, rb, pb, self.size, maps)

    def pair(self, left, right):
        return cv2.remap(left, *self.a, cv2.INTER_LINEAR), cv2.remap(right, *self.b, cv2.INTER_LINEAR)

    def disparity(self, depth_m):
        """From depths along the axis of the unrectified left eye."""
        depth = cv2.remap(depth_m, *self.a, cv2.INTER_NEAREST)
        v, u = np.indices(depth.shape)
        rays = np.stack([(u - self.k[0, 2]) / self.k[0, 0], (v - self.k[1, 2]) / self.k[1, 1], np.ones_like(depth)], -1)
        along = rays @ self.ra[:, 2]
        with np.errstate(divide="ignore"):
            return np.where(depth > 0, self.k[0, 0] * self.baseline * along / depth, np.inf)


def asl(root, most, name, real, every, truth=False):
    rectifier = Rectifier(root)
    paths = sorted((root / "cam0/data").glob("*.png"), key=lambda p: int(p.stem))
    pairs = [rectifier.pair(grey(p), grey(root / "cam1/data" / p.name)) for p in paths]
    truths = None
    if truth:
        depths = [cv2.imread(str(root / "depth0/data" / p.name), cv2.IMREAD_UNCHANGED) for p in paths]
        truths = [rectifier.disparity(depth.astype(np.float32) / 1000) for depth in depths]
    lefts, rights = [p[0] for p in pairs], [p[1] for p in pairs]
    return Source(name, real).measure(lefts, rights, most, truths, sequence=True, every=every)


def pfm(path):
    with open(path, "rb") as file:
        assert file.readline().strip() == b"Pf", path
        width, height = map(int, file.readline().split())
        kind = "<f4" if float(file.readline()) < 0 else ">f4"
        return np.fromfile(file, kind).reshape(height, width)[::-1].copy()


def real(data):
    """All real sources."""
    kitti = data / "02_stereo_odometry_kitti/KITTI_sequence_1"
    lefts = [grey(p) for p in sorted((kitti / "image_l").glob("*.png"))]
    rights = [grey(p) for p in sorted((kitti / "image_r").glob("*.png"))]
    yield Source("KITTI, street", True).measure(lefts, rights, 128, sequence=True, every=3)

    yield asl(data / "03_stereo_imu/euroc_V1_01_micro/mav0", 64, "EuRoC V1_01, hall", True, 5)

    desk = data / "01_stereo_depth/foundationstereo_demo"
    yield Source("FoundationStereo, desk", True).measure([grey(desk / "left.png")], [grey(desk / "right.png")], 128)

    bike = data / "01_stereo_depth/middlebury2014_motorcycle_Q"
    truth = pfm(bike / "disp0GT.pfm")
    truth[grey(bike / "mask0nocc.png") != 255] = np.inf
    pair = [[grey(bike / name)] for name in ("im0.png", "im1.png")]
    yield Source("Middlebury, motorcycle", True).measure(*pair, 80, [truth])

    camvid = sorted((data / "10_segmentation/camvid/train").glob("*.png"))
    yield Source("CamVid, street", True).measure([grey(p) for p in camvid], every=3)

    # From hand-held cameras; the phone's images are brought to the size of the others.
    kinect = sorted((data / "08_rgbd_mesh/tsdf_fusion_kinect50/rgbd-frames").glob("*.color.png"))
    yield Source("Kinect, room", True).measure([grey(p) for p in kinect], sequence=True, every=3)
    fox = sorted((data / "07_multiview/fox/images").glob("*.jpg"))
    small = [cv2.resize(grey(p), None, fx=0.4, fy=0.4, interpolation=cv2.INTER_AREA) for p in fox[::5]]
    yield Source("phone, room", True).measure(small)


def simulated(walks):
    for walk in sorted(p for p in walks.iterdir() if p.is_dir()):
        for camera in ("left_shoulder", "feet"):
            root = walk / camera / "mav0"
            if root.is_dir():
                yield asl(root, 96 if camera == "feet" else 64, f"{walk.name}, {camera}", False, 5, truth=True)


# --- the table ---------------------------------------------------------------------------------------

MEASURES = {
    "gradient p50": ".4f",
    "gradient p90": ".3f",
    "gradient p99": ".3f",
    "slope": ".2f",
    "noise": ".2f",
    "matched": ".2f",
    "apart px": ".3f",
    "error px": ".2f",
    "error > 2 px": ".3f",
    "corners": ".0f",
    "kept": ".2f",
    "length": ".0f",
}


HEAD = """# Simulated images beside real ones

Made by `cargo xtask bench sim_images`; the columns are documented at the head of `crates/dev/bench/src/sim_images.py`. Values are
medians over images, pairs or sequences. A simulated one in bold is outside of the range of all real ones, below (<) or above (>).
No real image here shows the ground from above as the feet camera does. The matching error is known of one real pair only.

"""


def table(sources):
    ranges, text = {}, []
    for key in MEASURES:
        spanned = [v for s in sources if s.real for v in s.values.get(key, [])]
        if len(spanned) > 1:
            ranges[key] = (min(spanned), max(spanned))
    text.append("| image | " + " | ".join(MEASURES) + " |")
    text.append("|---" * (len(MEASURES) + 1) + "|")

    def cell(source, key):
        values = source.values.get(key)
        if not values:
            return ""
        word = format(np.median(values), MEASURES[key])
        if not source.real and key in ranges:
            low, high = ranges[key]
            middle = float(np.median(values))
            if middle < low:
                word = f"**{word}** <"
            elif middle > high:
                word = f"**{word}** >"
        return word

    for source in (s for s in sources if s.real):
        text.append(f"| {source.name} | " + " | ".join(cell(source, key) for key in MEASURES) + " |")
    spans = [" to ".join(format(v, MEASURES[key]) for v in ranges[key]) if key in ranges else "" for key in MEASURES]
    text.append("| **span of the real ones** | " + " | ".join(spans) + " |")
    for source in (s for s in sources if not s.real):
        text.append(f"| {source.name} | " + " | ".join(cell(source, key) for key in MEASURES) + " |")
    return ranges, "\n".join(text) + "\n"


def main():
    walks, data, out = map(Path, sys.argv[1:])
    sources = [*real(data), *simulated(walks)]
    ranges, text = table(sources)
    rows = [
        {"name": s.name, "real": s.real, "count": {k: len(v) for k, v in s.values.items()},
         "median": {k: round(float(np.median(v)), 5) for k, v in s.values.items()},
         "least": {k: round(min(v), 5) for k, v in s.values.items()},
         "most": {k: round(max(v), 5) for k, v in s.values.items()}}
        for s in sources
    ]
    report = {"span": {k: [round(v, 5) for v in span] for k, span in ranges.items()}, "sources": rows}
    out.with_suffix(".json").write_text(json.dumps(report, indent=1) + "\n")
    out.with_suffix(".md").write_text(HEAD + text)
    print(text)


if __name__ == "__main__":
    main()
