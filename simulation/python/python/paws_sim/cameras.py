"""PAWS-Sim's face: batches of camera poses in, RGB and depth out. Physics is outside or absent."""

from __future__ import annotations

import json
from collections.abc import Mapping
from numbers import Integral
from typing import Any

import numpy as np

from . import _core

_BUDGET_BYTES = 2 << 30


class Cameras:
    """Cameras anywhere in a scene.

    Images are the same bits for any batch, order and number of threads. Gaussians are loaded with
    the first image, within `budget_bytes`.
    """

    def __init__(self, scene, *, budget_bytes: int = _BUDGET_BYTES):
        from .simulator import open_scene

        self._arguments = (scene, budget_bytes)
        self.scene = open_scene(scene)
        if not any(self.scene.gaussians):
            raise _core.SceneError(
                f"scene {self.scene.name}: found no Gaussians, expected output splats, which "
                "images are rendered from"
            )
        self._core = _core.Cameras(self.scene, budget_bytes)

    def render(
        self,
        world_from_camera,
        width: int = 64,
        height: int = 64,
        *,
        fov: float | None = None,
        K=None,
        sectors=None,
        keys=None,
        **options: Any,
    ) -> dict[str, np.ndarray]:
        """Images at poses of optical frames, shape (N, 4, 4) or (4, 4).

        `fov` is the field of view from left to right, rad (90 degrees without it and K), `K` the
        3x3 matrix of intrinsics with pixel centers at integers, or one for each pose (N, 3, 3).
        `sectors` are indices of the sectors in whose frames the poses are (0 without). `keys`
        (N, 3) are seed, episode and frame number of the noise of each image. Options: `quality`
        ("exact", "detail"), `depth` ("median", "expected"), `far_m`, `noise` (settings),
        `max_bytes`.

        Returns `rgb` u8 (N, height, width, 3), `depth` f32 (N, height, width) along the optical
        axis, m, `far_m` where no surface is, and `has_depth`.
        """
        poses = np.ascontiguousarray(world_from_camera, np.float64)
        if poses.ndim == 2:
            poses = poses[None]
        if poses.ndim != 3 or poses.shape[1:] != (4, 4):
            raise _core.SettingError(
                f"world_from_camera: found shape {poses.shape}, expected (N, 4, 4)"
            )
        n = len(poses)
        sectors = np.zeros(n, np.int64) if sectors is None else np.asarray(sectors, np.int64)
        keys = np.zeros((n, 3), np.uint64) if keys is None else np.asarray(keys, np.uint64)
        text = _text(options)
        if K is not None and np.ndim(K) == 3:
            return self._render_lenses(poses, sectors, (width, height, fov, K), text, keys)
        lens = (int(width), int(height), *intrinsics(width, height, fov, K))
        return self._core.render(poses, sectors, lens, text, np.ascontiguousarray(keys))

    def _render_lenses(self, poses, sectors, lens, text: str, keys) -> dict[str, np.ndarray]:
        """Images with a lens each: those of equal ones in one batch."""
        width, height, fov, K = lens
        K = np.asarray(K, np.float64)
        if K.shape != (len(poses), 3, 3):
            raise _core.SettingError(
                f"camera.K: found shape {K.shape}, expected (3, 3) or ({len(poses)}, 3, 3)"
            )
        matrices, which = np.unique(K, axis=0, return_inverse=True)
        images: dict[str, np.ndarray] = {}
        for number, matrix in enumerate(matrices):
            own = np.flatnonzero(which.ravel() == number)
            of_lens = (int(width), int(height), *intrinsics(width, height, fov, matrix))
            found = self._core.render(
                np.ascontiguousarray(poses[own]),
                sectors[own],
                of_lens,
                text,
                np.ascontiguousarray(keys[own]),
            )
            for name, array in found.items():
                whole = np.empty((len(poses), *array.shape[1:]), array.dtype)
                images.setdefault(name, whole)[own] = array
        return images

    def close(self) -> None:
        """Gives memory back; may be called twice."""
        self._core.close()

    def __reduce__(self):
        return _cameras, (self.scene, self._arguments[1])


def _cameras(scene, budget_bytes: int) -> Cameras:
    return Cameras(scene, budget_bytes=budget_bytes)


def check_camera(camera: Mapping[str, Any]) -> None:
    """Refuses settings of a camera, as `Cameras.render` has them, that no image could be rendered
    with; the error names the setting. Loads nothing and starts no threads."""
    options = dict(camera)
    size = [options.pop(edge, 64) for edge in ("width", "height")]
    for edge, value in zip(("width", "height"), size):
        is_count = isinstance(value, Integral) and not isinstance(value, bool)
        if not is_count or not 0 < value < 2**32:
            raise _core.SettingError(
                f"camera.{edge}: found {value!r}, expected a whole number of pixels"
            )
    width, height = map(int, size)
    lens = intrinsics(width, height, options.pop("fov", None), options.pop("K", None))
    _core.check_camera((width, height, *lens), _text(options))


def timing(settings) -> dict[str, Any]:
    """The whole timing of a camera: of some of its settings, or of a preset by its name."""
    return json.loads(_core.timing(_json("timing", settings)))


def _json(name: str, value: Any) -> str:
    """A setting as JSON."""
    try:
        return json.dumps(value, allow_nan=False, sort_keys=True)
    except (TypeError, ValueError) as error:
        raise _core.SettingError(f"camera.{name}: found {value!r}: {error}") from error


def _text(options: Mapping[str, Any]) -> str:
    """Settings by name as JSON, in one order."""
    values = [f"{json.dumps(name)}:{_json(name, options[name])}" for name in sorted(options)]
    return f"{{{','.join(values)}}}"


def intrinsics(width: int, height: int, fov, K) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy of a field of view or a matrix."""
    if K is not None:
        if fov is not None:
            raise _core.SettingError("camera.K: found fov and K, expected one of them")
        matrix = np.asarray(K, np.float64)
        if matrix.shape != (3, 3):
            raise _core.SettingError(f"camera.K: found shape {matrix.shape}, expected (3, 3)")
        return (*(float(matrix[k, k]) for k in (0, 1)), float(matrix[0, 2]), float(matrix[1, 2]))
    try:
        angle = np.pi / 2 if fov is None else float(fov)
    except (TypeError, ValueError) as error:
        raise _core.SettingError(f"camera.fov: {error}") from error
    if not 0.0 < angle < np.pi:
        raise _core.SettingError(f"camera.fov: found {angle} rad, expected above 0 and below pi")
    focal = 0.5 * width / np.tan(0.5 * angle)
    return (focal, focal, 0.5 * (width - 1), 0.5 * (height - 1))
