"""A plain PyTorch renderer and trainer of 3D Gaussians on the CPU.

What one writes from the papers with tensors and automatic differentiation, without a kernel of its
own: projection of all Gaussians at once, blending tile by tile. Lens without distortion, global
shutter, harmonics of degree 0, no growth; Kerbl et al., 3D Gaussian Splatting, 2023.

JSON on standard input: views, Gaussians, order of the views and learning rates; JSON on standard
output: PSNR of the test views before and after, processor time of the steps.
"""

import json
import math
import sys
import time

import torch
import torch.nn.functional as F

TILE = 16
C0 = 0.2820948
MAX_ALPHA = 0.99
MIN_ALPHA = 1.0 / 255.0
DILATION = 0.3
NEAR = 0.05
MARGIN = 0.15


def rotations(quaternions):
    w, x, y, z = F.normalize(quaternions, dim=-1).unbind(-1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]
    return torch.stack(rows, dim=-1).reshape(-1, 3, 3)


def project(scene, pose, lens, size):
    """Centers, inverse covariances, extents, opacities and colors of what is in front."""
    fx, fy, cx, cy = lens
    width, height = size
    rotation, translation = pose[:, :3], pose[:, 3]
    point = scene["position"] @ rotation.T + translation
    seen = (point[:, 2] > NEAR).nonzero().squeeze(-1)
    point = point[seen]
    x, y, z = point.unbind(-1)
    order = torch.argsort(z.detach(), stable=True)
    seen, x, y, z = seen[order], x[order], y[order], z[order]
    # Beyond the border the projection is linearized at it, or it would diverge.
    low = [(-MARGIN * width - cx) / fx, (-MARGIN * height - cy) / fy]
    high = [((1 + MARGIN) * width - cx) / fx, ((1 + MARGIN) * height - cy) / fy]
    tx = torch.minimum(torch.maximum(x / z, z.new_tensor(low[0])), z.new_tensor(high[0]))
    ty = torch.minimum(torch.maximum(y / z, z.new_tensor(low[1])), z.new_tensor(high[1]))
    zero = torch.zeros_like(z)
    jacobian = torch.stack([fx / z, zero, -fx * tx / z, zero, fy / z, -fy * ty / z], dim=-1)
    jacobian = jacobian.reshape(-1, 2, 3) @ rotation
    axes = rotations(scene["rotation"][seen]) * torch.exp(scene["scale"][seen])[:, None, :]
    half = jacobian @ axes
    covariance = half @ half.transpose(1, 2)
    a = covariance[:, 0, 0] + DILATION
    b = covariance[:, 0, 1]
    c = covariance[:, 1, 1] + DILATION
    determinant = a * c - b * b
    conic = torch.stack([c, -b, a], dim=-1) / determinant[:, None]
    center = torch.stack([fx * x / z + cx, fy * y / z + cy], dim=-1)
    opacity = torch.sigmoid(scene["opacity"][seen])
    # Where alpha falls below one step of 8 bits.
    reach = 2 * torch.log((opacity.detach() / MIN_ALPHA).clamp(min=1.0))
    extent = torch.sqrt(reach[:, None] * torch.stack([a, c], dim=-1).detach())
    color = (0.5 + C0 * scene["color"][seen]).clamp(min=0.0)
    return center, conic, extent, opacity, color


def render(scene, pose, lens, size):
    width, height = size
    center, conic, extent, opacity, color = project(scene, pose, lens, size)
    low, high = (center.detach() - extent), (center.detach() + extent)
    rows = []
    for top in range(0, height, TILE):
        bottom = min(top + TILE, height)
        in_rows = (high[:, 1] >= top) & (low[:, 1] <= bottom - 1) & (extent[:, 1] > 0)
        tiles = []
        for left in range(0, width, TILE):
            right = min(left + TILE, width)
            chosen = in_rows & (high[:, 0] >= left) & (low[:, 0] <= right - 1)
            tiles.append(blend(
                [left, right, top, bottom], chosen.nonzero().squeeze(-1),
                center, conic, opacity, color, scene["background"],
            ))
        rows.append(torch.cat(tiles, dim=1))
    return torch.cat(rows, dim=0)


def blend(box, chosen, center, conic, opacity, color, background):
    left, right, top, bottom = box
    shape = (bottom - top, right - left, 3)
    if len(chosen) == 0:
        return background.expand(shape)
    v, u = torch.meshgrid(
        torch.arange(top, bottom, dtype=torch.float32),
        torch.arange(left, right, dtype=torch.float32), indexing="ij",
    )
    at = center[chosen]
    dx = u.reshape(1, -1) - at[:, 0:1]
    dy = v.reshape(1, -1) - at[:, 1:2]
    q = conic[chosen]
    power = q[:, 0:1] * dx * dx + 2 * q[:, 1:2] * dx * dy + q[:, 2:3] * dy * dy
    alpha = (opacity[chosen][:, None] * torch.exp(-0.5 * power)).clamp(max=MAX_ALPHA)
    alpha = torch.where(alpha < MIN_ALPHA, torch.zeros_like(alpha), alpha)
    remaining = torch.cumprod(1 - alpha, dim=0)
    before = torch.cat([torch.ones_like(remaining[:1]), remaining[:-1]], dim=0)
    weights = alpha * before
    pixels = weights.T @ color[chosen] + remaining[-1][:, None] * background
    return pixels.reshape(shape)


def window():
    offsets = torch.arange(11, dtype=torch.float32) - 5
    line = torch.exp(-offsets * offsets / (2 * 1.5 * 1.5))
    line = line / line.sum()
    return (line[:, None] * line[None, :]).expand(3, 1, 11, 11)


def ssim(a, b, kernel):
    a, b = a.permute(2, 0, 1)[None], b.permute(2, 0, 1)[None]
    mean = lambda image: F.conv2d(image, kernel, padding=5, groups=3)
    ma, mb = mean(a), mean(b)
    va, vb, vab = mean(a * a) - ma * ma, mean(b * b) - mb * mb, mean(a * b) - ma * mb
    c1, c2 = 0.01 ** 2, 0.03 ** 2
    top = (2 * ma * mb + c1) * (2 * vab + c2)
    return (top / ((ma * ma + mb * mb + c1) * (va + vb + c2))).mean()


def psnr(scene, views, lens, size):
    values = []
    with torch.no_grad():
        for pose, image in views:
            rendered = (render(scene, pose, lens, size).clamp(0, 1) * 255).round()
            mean = ((rendered - image * 255) ** 2).mean().item()
            values.append(10 * math.log10(255 * 255 / max(mean, 0.1)))
    return sum(values) / len(values)


def main():
    question = json.load(sys.stdin)
    torch.set_num_threads(question["threads"])
    width, height = size = question["size"]
    lens = question["lens"]

    def read(views):
        image = lambda view: torch.tensor(view["rgb"], dtype=torch.float32) / 255
        pose = lambda view: torch.tensor(view["pose"], dtype=torch.float32).reshape(3, 4)
        return [(pose(view), image(view).reshape(height, width, 3)) for view in views]

    training, tests = read(question["training"]), read(question["tests"])
    planes = torch.tensor(question["planes"], dtype=torch.float32)
    scene = {
        "position": planes[0:3].T.clone(),
        "scale": planes[3:6].T.clone(),
        "rotation": planes[6:10].T.clone(),
        "opacity": planes[10].clone(),
        "color": planes[11:14].T.clone(),
        "background": torch.tensor(question["background"], dtype=torch.float32),
    }
    for value in scene.values():
        value.requires_grad_(True)
    rates = question["rates"]
    groups = [{"params": [scene[name]], "lr": rates[name], "name": name} for name in scene]
    optimizer = torch.optim.Adam(groups, betas=(0.9, 0.999), eps=1e-15)
    before = psnr(scene, tests, lens, size)
    kernel = window()
    order = question["order"]
    cpu, wall = time.process_time(), time.perf_counter()
    for step, view in enumerate(order):
        pose, image = training[view]
        share = question["position_decay"] ** (step / len(order))
        for group in optimizer.param_groups:
            if group["name"] == "position":
                group["lr"] = rates["position"] * share
        rendered = render(scene, pose, lens, size)
        l1 = (rendered - image).abs().mean()
        loss = 0.8 * l1 + 0.2 * (1 - ssim(rendered, image, kernel))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    json.dump({
        "torch": torch.__version__,
        "psnr_before_db": before,
        "psnr_db": psnr(scene, tests, lens, size),
        "cpu_s": cpu,
        "wall_s": wall,
    }, sys.stdout)


main()
