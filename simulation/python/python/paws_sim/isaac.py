"""Our cameras as a renderer of Isaac Lab. It has never run in Isaac Lab.

`IsaacRenderer` has the methods of `isaaclab.renderers.BaseRenderer` as Isaac Lab 3.0 has them and
is tested against a stub of that interface only. Isaac Lab says that the interface may change: use
the version that you test.

The robot is in Isaac's stage and not among our Gaussians. Where Isaac also renders it, `composite`
puts it over our images by depth.

Conventions: Isaac Lab has quaternions x y z w and images (N, H, W, C), rgb of 8 bits and depth along
the optical axis in metres. Its cameras give renderers axes of the convention `world` (x forward, y
left, z up); there are also `ros` (x right, y down, z forward, as ours) and `opengl` (x right, y up,
z backward).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

#: Rotations from optical axes (x right, y down, z forward) to those of a convention, as columns.
_CONVENTION_FROM_OPTICAL = {
    "ros": np.eye(3),
    "opengl": np.diag([1.0, -1.0, -1.0]),
    "world": np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]),
}

#: Types of images, with their channels and numbers.
OUTPUT_TYPES = {
    "rgb": (3, np.uint8),
    "rgba": (4, np.uint8),
    "depth": (1, np.float32),
    "distance_to_image_plane": (1, np.float32),
    "distance_to_camera": (1, np.float32),
}


class Cameras(Protocol):
    """What renders, such as `paws_sim.Cameras`."""

    def render(
        self, world_from_camera: np.ndarray, width: int, height: int, K: np.ndarray
    ) -> dict[str, np.ndarray]:
        """`rgb` (N, H, W, 3) of 8 bits, `depth` (N, H, W) along the optical axis, m; poses
        (N, 4, 4) of optical frames, intrinsics (N, 3, 3)."""


@dataclass
class RenderData:
    """Cameras of one sensor."""

    width: int
    height: int
    types: tuple[str, ...]
    outputs: dict[str, Any] = field(default_factory=dict)
    world_from_camera: np.ndarray | None = None
    intrinsics: np.ndarray | None = None
    rgb: np.ndarray | None = None
    depth_m: np.ndarray | None = None


def rotation_of_xyzw(quaternions: np.ndarray) -> np.ndarray:
    """Rotation matrices (N, 3, 3) of quaternions x y z w (N, 4) of any length but 0.

    Raises ValueError for others.
    """
    q = np.asarray(quaternions, float)
    norm = np.linalg.norm(q, axis=-1, keepdims=True)
    if q.ndim != 2 or q.shape[1] != 4 or not np.isfinite(q).all() or (norm < 1e-9).any():
        raise ValueError(f"expected quaternions (N, 4), finite and not 0, found {q.shape}")
    x, y, z, w = (q / norm).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def optical_poses(
    positions_m: np.ndarray, quaternions_xyzw: np.ndarray, convention: str
) -> np.ndarray:
    """`world_from_camera` of optical frames (N, 4, 4) from poses of a convention of Isaac Lab."""
    if convention not in _CONVENTION_FROM_OPTICAL:
        expected = ", ".join(_CONVENTION_FROM_OPTICAL)
        raise ValueError(f"convention {convention!r}, expected one of {expected}")
    rotation = rotation_of_xyzw(quaternions_xyzw)
    positions = np.asarray(positions_m, float)
    if positions.shape != (len(rotation), 3) or not np.isfinite(positions).all():
        raise ValueError(f"expected positions ({len(rotation)}, 3), found {positions.shape}")
    poses = np.tile(np.eye(4), (len(rotation), 1, 1))
    poses[:, :3, :3] = rotation @ _CONVENTION_FROM_OPTICAL[convention]
    poses[:, :3, 3] = positions
    return poses


class IsaacRenderer:
    """Renders the scene of `cameras` where Isaac Lab moves its sensors.

    `world_from_origin` (N, 3) are origins of Isaac's environments, which stand side by side while all
    see the same scene: they are subtracted from positions. `convention` is that of the quaternions.
    Arrays are NumPy's, or have a view `torch` as Isaac Lab's have; images are copied to their device.
    """

    def __init__(
        self,
        cameras: Cameras,
        world_from_origin: np.ndarray | None = None,
        convention: str = "world",
    ):
        optical_poses(np.zeros((1, 3)), np.array([[0.0, 0.0, 0.0, 1.0]]), convention)
        self._cameras = cameras
        self._origins = None if world_from_origin is None else np.asarray(world_from_origin, float)
        self._convention = convention

    def initialize(self) -> None:
        """Nothing is to be done once."""

    def supported_output_types(self) -> dict[Any, Any]:
        """Types of images with their channels and kinds of numbers: Isaac Lab's own classes, or
        names and pairs where it is not installed."""
        try:
            import torch
            from isaaclab.renderers.output_contract import RenderBufferKind, RenderBufferSpec
        except ImportError:
            return dict(OUTPUT_TYPES)
        return {
            RenderBufferKind(name): RenderBufferSpec(channels, getattr(torch, np.dtype(kind).name))
            for name, (channels, kind) in OUTPUT_TYPES.items()
        }

    def prepare_cameras(self, stage: Any, spec: Any) -> None:
        """Nothing: our cameras are not in the stage."""

    def prepare_stage(self, stage: Any, num_envs: int) -> None:
        """Checks that there is an origin for each environment. The stage stays as it is."""
        del stage
        if self._origins is not None and len(self._origins) != num_envs:
            raise ValueError(f"{len(self._origins)} origins for {num_envs} environments")

    def create_render_data(self, spec: Any) -> RenderData:
        """Cameras of a sensor whose `spec.cfg` has `width`, `height` and `data_types`.

        Raises ValueError for types that there are not.
        """
        types = tuple(spec.cfg.data_types)
        unknown = [name for name in types if name not in OUTPUT_TYPES]
        if unknown:
            raise ValueError(f"no images of the types {unknown}, there are {list(OUTPUT_TYPES)}")
        return RenderData(int(spec.cfg.width), int(spec.cfg.height), types)

    def set_outputs(self, render_data: RenderData, output_data: dict[str, Any]) -> None:
        """Takes the arrays (N, H, W, C) that images are written into."""
        for name, array in output_data.items():
            if name not in render_data.types:
                continue
            array = getattr(array, "torch", array)
            expected = (render_data.height, render_data.width, OUTPUT_TYPES[name][0])
            if tuple(array.shape[1:]) != expected:
                raise ValueError(f"{name}: images {tuple(array.shape[1:])}, expected {expected}")
            render_data.outputs[name] = array

    def update_transforms(self) -> None:
        """Nothing: the scene does not move."""

    def update_geometries(self) -> None:
        """Nothing: the scene does not change."""

    def update_camera(
        self,
        render_data: RenderData,
        positions: Any,
        orientations: Any,
        intrinsics: Any,
    ) -> None:
        """Poses of the next images: positions (N, 3) m, quaternions x y z w (N, 4), intrinsics
        (N, 3, 3) px."""
        positions = _numpy(positions)
        if self._origins is not None:
            if positions.shape != self._origins.shape:
                raise ValueError(
                    f"positions {positions.shape}, expected those of {len(self._origins)} "
                    "environments with one camera each"
                )
            positions = positions - self._origins
        poses = optical_poses(positions, _numpy(orientations), self._convention)
        intrinsics = _numpy(intrinsics)
        if intrinsics.shape != (len(poses), 3, 3):
            raise ValueError(f"intrinsics {intrinsics.shape}, expected ({len(poses)}, 3, 3)")
        render_data.world_from_camera = poses
        render_data.intrinsics = intrinsics

    def render(self, render_data: RenderData) -> None:
        """Images of all cameras, into the outputs that were set.

        Raises RuntimeError before the first `update_camera`.
        """
        if render_data.world_from_camera is None:
            raise RuntimeError("render before update_camera: there are no poses")
        images = self._cameras.render(
            render_data.world_from_camera,
            width=render_data.width,
            height=render_data.height,
            K=render_data.intrinsics,
        )
        render_data.rgb = np.asarray(images["rgb"])
        render_data.depth_m = np.asarray(images["depth"])
        for name, array in render_data.outputs.items():
            image = self._image(render_data, name)
            # A tensor makes its like on its own device.
            array[...] = image if isinstance(array, np.ndarray) else array.new_tensor(image)

    def _image(self, render_data: RenderData, name: str) -> np.ndarray:
        if name == "rgb":
            return render_data.rgb
        if name == "rgba":
            opaque = np.full(render_data.rgb.shape[:3] + (1,), 255, np.uint8)
            return np.concatenate([render_data.rgb, opaque], axis=-1)
        depth = render_data.depth_m
        if name == "distance_to_camera":
            depth = depth * _ray_lengths(render_data)
        return depth[..., None].astype(np.float32)

    def read_output(self, render_data: RenderData, camera_data: Any) -> None:
        """Nothing is left to copy: `render` wrote into the arrays of the camera's data.

        Raises RuntimeError before the first `render`.
        """
        del camera_data
        if render_data.rgb is None:
            raise RuntimeError("read_output before render: there are no images")

    def cleanup(self, render_data: RenderData | None) -> None:
        """Lets go of the images of a sensor. A second call does nothing."""
        if render_data is not None:
            render_data.outputs.clear()
            render_data.rgb = render_data.depth_m = None

    def close(self) -> None:
        """Nothing: the scene's cameras belong to their maker."""


def _numpy(array: Any) -> np.ndarray:
    """Numbers of an array, of its view `torch`, or of a tensor on any device."""
    array = getattr(array, "torch", array)
    if hasattr(array, "detach"):
        array = array.detach().cpu().numpy()
    return np.asarray(array, float)


def _ray_lengths(render_data: RenderData) -> np.ndarray:
    """Distance from the camera of a point at depth 1 in each pixel, (N, H, W)."""
    columns = np.arange(render_data.width)[None, None, :]
    rows = np.arange(render_data.height)[None, :, None]
    K = render_data.intrinsics[:, :, :, None, None]
    x = (columns - K[:, 0, 2]) / K[:, 0, 0]
    y = (rows - K[:, 1, 2]) / K[:, 1, 1]
    return np.sqrt(1.0 + x * x + y * y)


def composite(
    scene_rgb: np.ndarray,
    scene_depth_m: np.ndarray,
    robot_rgb: np.ndarray,
    robot_depth_m: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """The robot of Isaac's images over ours, where it is nearer: rgb and depth.

    Images (N, H, W, 3) and (N, H, W, 1); depth that is not finite or not above 0 is none.
    """
    is_there = np.isfinite(robot_depth_m) & (robot_depth_m > 0)
    is_scene = np.isfinite(scene_depth_m) & (scene_depth_m > 0)
    is_nearer = is_there & (~is_scene | (robot_depth_m < scene_depth_m))
    depth = np.where(is_nearer, robot_depth_m, scene_depth_m)
    return np.where(is_nearer, robot_rgb, scene_rgb), depth


__all__: Sequence[str] = [
    "Cameras",
    "IsaacRenderer",
    "OUTPUT_TYPES",
    "RenderData",
    "composite",
    "optical_poses",
    "rotation_of_xyzw",
]
