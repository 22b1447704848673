"""The scene: a hall with a roof over one half and open sky over the other, 13 by 10 m.

Textures are sums of noise with a fixed seed. Nothing is taken from our own simulator.
"""

import mitsuba as mi
import numpy as np
from scipy.ndimage import zoom

T = mi.ScalarTransform4f


def noise(rng, rows, columns, octaves, roughness=0.65):
    """Sum of octaves of smooth noise, 0 to 1."""
    total, weight = np.zeros((rows, columns)), 1.0
    for k in octaves:
        r, c = max(2, rows >> k), max(2, columns >> k)
        grid = rng.standard_normal((r + 3, c + 3))
        big = zoom(grid, (rows / r, columns / c), order=1)[:rows, :columns]
        total += weight * big
        weight *= roughness
    low, high = np.percentile(total, [0.5, 99.5])
    return np.clip((total - low) / (high - low), 0, 1)


def bitmap(values, low, high):
    values = (low + (high - low) * values).astype(np.float32)[..., None]
    return {"type": "bitmap", "bitmap": mi.Bitmap(values), "raw": True, "wrap_mode": "mirror"}


def bricks(rng, rows, columns, height, width):
    """Bricks of different grey with mortar between them."""
    v, u = np.mgrid[0:rows, 0:columns]
    row = v // height
    u = u + (row % 2) * (width // 2)
    grey = rng.random((rows // height + 2, columns // width + 3))[row, u // width]
    mortar = (v % height < max(1, height // 9)) | (u % width < max(1, height // 9))
    grain = noise(rng, rows, columns, [3, 2, 1, 0], 0.8)
    return np.where(mortar, 0.75 + 0.2 * grain, 0.15 + 0.4 * grey + 0.35 * grain)


def planks(rng, rows, columns, width):
    v, u = np.mgrid[0:rows, 0:columns]
    board = v // width
    grey = rng.random(rows // width + 2)[board]
    grain = zoom(noise(rng, rows, columns // 8, [4, 3, 2, 1, 0], 0.8), (1, 8), order=1)
    end = (u + 977 * board) % 700 < 3
    return np.where((v % width < 2) | end, 0.05, 0.2 + 0.35 * grey + 0.4 * grain)


def poster(rng, rows, columns):
    """Blocks, lines and discs."""
    image = np.full((rows, columns), rng.uniform(0.3, 0.9))
    v, u = np.mgrid[0:rows, 0:columns]
    for _ in range(60):
        y, x = rng.integers(rows), rng.integers(columns)
        h, w = rng.integers(4, rows // 3), rng.integers(4, columns // 3)
        inside = (abs(v - y) < h / 2) & (abs(u - x) < w / 2)
        if rng.random() < 0.4:
            inside = (v - y) ** 2 + (u - x) ** 2 < (h / 2) ** 2
        image[inside] = rng.random()
    return image


def rough(texture, alpha):
    return {"type": "roughplastic", "alpha": alpha, "diffuse_reflectance": texture}


def wall(center, u, v, bsdf):
    """Rectangle with half axes u and v; its normal is u x v."""
    u, v, c = (np.asarray(a, float) for a in (u, v, center))
    n = np.cross(u, v)
    n /= np.linalg.norm(n)
    m = np.eye(4)
    m[:3, 0], m[:3, 1], m[:3, 2], m[:3, 3] = u, v, n, c
    return {"type": "rectangle", "to_world": T(m), "bsdf": bsdf}


def box(center, half, yaw, bsdf):
    to_world = T().translate(center).rotate([0, 0, 1], yaw).scale(half)
    return {"type": "cube", "to_world": to_world, "bsdf": bsdf}


def sky(rng):
    """Brighter to the horizon, with clouds."""
    rows, columns = 128, 256
    up = np.clip(1 - np.arange(rows) / (rows / 2), 0, 1)[:, None]
    clouds = noise(rng, rows, columns, [5, 4, 3, 2])
    value = np.where(np.arange(rows)[:, None] < rows / 2, 0.7 + 0.5 * (1 - up) + 0.8 * clouds, 0.2)
    rgb = np.repeat(value[..., None], 3, axis=2).astype(np.float32)
    to_world = T().rotate([1, 0, 0], 90)
    return {"type": "envmap", "bitmap": mi.Bitmap(rgb), "scale": 1.0, "to_world": to_world}


GLASS = "glass"


def build(seed):
    rng = np.random.default_rng(seed)
    white = {"type": "diffuse", "reflectance": bitmap(noise(rng, 512, 1024, [6, 4, 2, 1, 0]), 0.5, 0.8)}
    plaster = lambda: {
        "type": "diffuse",
        "reflectance": bitmap(noise(rng, 512, 2048, [7, 5, 3, 2, 1, 0], 0.85), 0.25, 0.75),
    }
    brick = lambda rows, columns: {
        "type": "diffuse",
        "reflectance": bitmap(bricks(rng, rows, columns, 26, 66), 0.05, 0.8),
    }
    floor = rough(bitmap(planks(rng, 2048, 2048, 28), 0.05, 0.6), 0.25)
    bump = bitmap(noise(rng, 1024, 1024, [4, 3, 2]), 0, 0.03)
    floor = {"type": "bumpmap", "arbitrary": bump, "scale": 1.0, "bsdf": floor}
    metal = {"type": "roughconductor", "material": "Al", "alpha": 0.12}
    steel = {"type": "roughconductor", "material": "Cr", "alpha": 0.3}
    scene = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 3, "rr_depth": 8},
        "sky": sky(rng),
        "sun": {"type": "directional", "direction": [0.35, 0.5, -0.8], "irradiance": 4.0},
        "floor": wall([0, 0, 0], [6.5, 0, 0], [0, 5, 0], floor),
        "east": wall([6.5, 0, 1.6], [0, -5, 0], [0, 0, 1.6], brick(512, 1600)),
        "west": wall([-6.5, 0, 1.6], [0, 5, 0], [0, 0, 1.6], plaster()),
        "north": wall([0, 5, 1.6], [6.5, 0, 0], [0, 0, 1.6], plaster()),
        "south": wall([0, -5, 1.6], [-6.5, 0, 0], [0, 0, 1.6], brick(512, 2080)),
        "roof": wall([-3.25, 0, 3.2], [-3.25, 0, 0], [0, 5, 0], {"type": "twosided", "b": white}),
        GLASS: wall([1.2, 3.9, 1.2], [0.9, 0, 0], [0, 0, 1.0], {"type": "thindielectric"}),
        "ball": {"type": "sphere", "center": [0.2, 0.1, 0.8], "radius": 0.45, "bsdf": metal},
    }
    # Three emitters, and nine samples by strata: each emitter is chosen three times.
    lamp = wall([-3.2, 0, 3.15], [1.5, 0, 0], [0, -2.0, 0], {"type": "diffuse"})
    lamp["emitter"] = {"type": "area", "radiance": 4.0}
    scene["lamp"] = lamp
    for k in range(8):
        side = k % 4
        image = {"type": "diffuse", "reflectance": bitmap(poster(rng, 240, 320), 0.03, 0.85)}
        along, z, half = rng.uniform(-3.5, 3.5), rng.uniform(1.2, 1.9), rng.uniform(0.35, 0.6)
        place = [[6.48, along], [-6.48, along], [along * 1.3, 4.98], [along * 1.3, -4.98]][side]
        axis = [[0, -1, 0], [0, 1, 0], [1, 0, 0], [-1, 0, 0]][side]
        u = np.array(axis) * half * 1.33
        scene[f"poster{k}"] = wall([*place, z], u, [0, 0, half], image)
    for k in range(14):
        # Beside the path, which is an oval of 3.4 by 2.2 m.
        angle = rng.uniform(0, 2 * np.pi)
        out = [0.45, 1.62][k % 2] * rng.uniform(0.9, 1.1)
        x, y = 3.4 * out * np.sin(angle), -2.2 * out * np.cos(angle)
        half = [rng.uniform(0.15, 0.4), rng.uniform(0.15, 0.4), rng.uniform(0.2, 0.75)]
        texture = bitmap(
            poster(rng, 200, 200) if k % 3 == 0 else noise(rng, 256, 256, [5, 4, 2, 1, 0], 0.8), 0.04, 0.8
        )
        bsdf = rough(texture, 0.15) if k % 2 else {"type": "diffuse", "reflectance": texture}
        scene[f"box{k}"] = box([x, y, half[2]], half, rng.uniform(0, 90), bsdf)
    for k in range(24):
        # A railing: repeated thin structure.
        x = -3.4 + 0.14 * k
        ends = {"p0": [x, 4.1, 0.05], "p1": [x, 4.1, 1.05], "radius": 0.012}
        scene[f"bar{k}"] = {"type": "cylinder", **ends, "bsdf": steel}
    scene["rail"] = box([-1.8, 4.1, 1.07], [1.7, 0.03, 0.02], 0, steel)
    for k, (x, y) in enumerate([(-6.0, -4.5), (0.0, 4.4), (5.2, 4.2), (5.4, -3.9)]):
        ends = {"p0": [x, y, 0], "p1": [x, y, 3.2], "radius": 0.22}
        stone = bitmap(bricks(rng, 512, 256, 40, 64), 0.1, 0.8)
        scene[f"column{k}"] = {"type": "cylinder", **ends, "bsdf": rough(stone, 0.3)}
    return scene
