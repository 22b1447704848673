"""PAWS-Sim's face: batches of camera poses in, RGB and depth out. Physics is outside or absent."""

from __future__ import annotations

import json
from collections.abc import Mapping
from numbers import Integral
from typing import Any

import numpy as np

from . import _core

#: Memory for Gaussians.
BUDGET_BYTES = 2 << 30

#: Width, height, fx, fy, cx, cy.
Lens = tuple[int, int, float, float, float, float]


class Cameras:
    """Cameras anywhere in a scene.

    Images are the same bits for any batch, order and number of threads. Gaussians are loaded with
    the first image, within `budget_bytes`.
    """

    def __init__(self, scene, *, budget_bytes: int = BUDGET_BYTES):
        from .simulator import open_scene

        self._budget_bytes = check_budget("budget_bytes", budget_bytes)
        self.scene = open_scene(scene)
        if not any(self.scene.gaussians):
            raise _core.SceneError(
                f"scene {self.scene.name}: found no Gaussians, expected output splats, which "
                "images are rendered from"
            )
        self._core = _core.Cameras(self.scene, self._budget_bytes)

    def render(
        self,
        world_from_camera,
        width: int | None = None,
        height: int | None = None,
        *,
        sectors=None,
        keys=None,
        velocity=None,
        rate=None,
        gain=None,
        **camera: Any,
    ) -> dict[str, np.ndarray]:
        """Images at poses of optical frames, shape (N, 4, 4) or (4, 4).

        Lens: `fov`, the field of view from left to right, rad (90 degrees without any); or `K`, the
        3x3 matrix of intrinsics with pixel centers at integers, or one for each pose (N, 3, 3); or
        `recorded`, the name of a camera that recorded the first sector, whose lens images of all
        sectors then have. `distortion` goes with each of them, such as `{"model":
        "kannala_brandt4", "k1": 0.02, "k2": 0.0, "k3": 0.0, "k4": 0.0}`. Images are 64x64 without a
        size, those of a recorded camera as large as it recorded.

        `sectors` (N,) are indices of the sectors in whose frames the poses are (0 without). `keys`
        (N, 3) are seed, episode and frame number of the noise of each image. `velocity` and `rate`
        (N, 3) are the motion of each camera in its own axes, m/s and rad/s, for `shutter`; `gain`
        (N,) is one of linear light for each image. Without the first axis they are those of all
        images.

        Other settings: `exposure` (`gain`, `white_balance`, `gamma`), `noise` (`full_well_e`,
        `readout_e`), `variation` (ranges `gain` and `focal_scale`, drawn for each seed and episode
        of `keys`), `shutter` (`line_s`, `exposure_s`, `blur_poses`), `quality` ("exact",
        "detail"), `depth` ("median", "expected"), `far_m`, `max_bytes`. `mount`, `timing` and
        `budget_bytes` are of the cameras of environments alone.

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
        sectors = _of_images("sectors", 0 if sectors is None else sectors, n, (), np.int64)
        keys = _of_images("keys", [0, 0, 0] if keys is None else keys, n, (3,), np.uint64)
        conditions = _conditions(n, velocity, rate, gain)
        K = camera.get("K")
        if K is None or np.ndim(K) != 3:
            lens, options = lens_and_options(
                self.scene, {"width": width, "height": height, **camera}
            )
            return self.render_lens(poses, sectors, keys, conditions, lens, options)
        K = np.asarray(K, np.float64)
        if K.shape != (n, 3, 3):
            raise _core.SettingError(
                f"camera.K: found shape {K.shape}, expected (3, 3) or ({n}, 3, 3)"
            )
        # A lens each: those of equal ones in one batch.
        matrices, which = np.unique(K, axis=0, return_inverse=True)
        images: dict[str, np.ndarray] = {}
        for number, matrix in enumerate(matrices):
            own = np.flatnonzero(which.ravel() == number)
            whole = {"width": width, "height": height, **camera, "K": matrix}
            lens, options = lens_and_options(self.scene, whole)
            of_own = None if conditions is None else conditions[own]
            found = self.render_lens(poses[own], sectors[own], keys[own], of_own, lens, options)
            for name, array in found.items():
                whole = np.empty((n, *array.shape[1:]), array.dtype)
                images.setdefault(name, whole)[own] = array
        return images

    def render_lens(
        self, poses, sectors, keys, conditions, lens: Lens, options: str
    ) -> dict[str, np.ndarray]:
        """Images of a lens and options of `lens_and_options`; `conditions` (N, 7) as the frames of a
        world have them, or None."""
        if conditions is not None:
            conditions = np.ascontiguousarray(conditions)
        arrays = np.ascontiguousarray(poses), sectors
        return self._core.render(*arrays, lens, options, np.ascontiguousarray(keys), conditions)

    def close(self) -> None:
        """Gives memory back; may be called twice."""
        self._core.close()

    def __reduce__(self):
        return _cameras, (self.scene, self._budget_bytes)


def _cameras(scene, budget_bytes: int) -> Cameras:
    return Cameras(scene, budget_bytes=budget_bytes)


def check_budget(name: str, budget_bytes) -> int:
    """Memory for Gaussians, bytes, or the error that names the setting."""
    is_count = isinstance(budget_bytes, Integral) and not isinstance(budget_bytes, bool)
    if not is_count or not 0 < budget_bytes < 2**64:
        raise _core.SettingError(
            f"{name}: found {budget_bytes!r}, expected a whole number of bytes above 0"
        )
    return int(budget_bytes)


def lens_and_options(scene: _core.Scene, camera: Mapping[str, Any]) -> tuple[Lens, str]:
    """Lens of a camera's settings, and all others as JSON. Loads nothing and starts no threads; an
    error names the setting. `recorded` is a camera of the first sector, for images of all."""
    options = dict(camera)
    for name in ("mount", "timing", "budget_bytes"):
        if name in options:
            raise _core.SettingError(
                f"camera.{name}: found a setting that only cameras of environments have, expected "
                "none: images of given poses are neither mounted nor late, and `Cameras` has the "
                "budget"
            )
    recorded, fov, K = (options.pop(name, None) for name in ("recorded", "fov", "K"))
    size = [options.pop(edge, None) for edge in ("width", "height")]
    for edge, value in zip(("width", "height"), size):
        is_count = isinstance(value, Integral) and not isinstance(value, bool)
        if value is not None and (not is_count or not 0 < value < 2**32):
            raise _core.SettingError(
                f"camera.{edge}: found {value!r}, expected a whole number of pixels"
            )
    if recorded is None:
        width, height = (64 if edge is None else int(edge) for edge in size)
        return (width, height, *intrinsics(width, height, fov, K)), _text(options)
    if fov is not None or K is not None:
        raise _core.SettingError("camera.recorded: found fov or K beside it, expected none")
    if not isinstance(recorded, str):
        raise _core.SettingError(f"camera.recorded: found {recorded!r}, expected a name")
    lens = scene.recording(0).lens(recorded, *size)
    options.setdefault("distortion", json.loads(lens["distortion"]))
    shutter = options.get("shutter", {})
    if isinstance(shutter, Mapping):
        options["shutter"] = {"line_s": lens["line_s"], **shutter}
    return (*lens["size"], *lens["intrinsics"]), _text(options)


def film_camera(lens: Lens, options: str) -> tuple[Lens, str]:
    """Lens and options of a camera for films: the shape of its images within 320x240 pixels, at
    rest."""
    width, height, fx, fy, cx, cy = lens
    scale = min(320 / width, 240 / height)
    wide, high = (max(1, round(scale * edge)) for edge in (width, height))
    x, y = wide / width, high / height
    # Pixel centers are at integers.
    center = (x * (cx + 0.5) - 0.5, y * (cy + 0.5) - 0.5)
    left_out = ("shutter", "max_bytes")
    kept = {name: of for name, of in json.loads(options).items() if name not in left_out}
    return (wide, high, x * fx, y * fy, *center), _text(kept)


def mount(scene: _core.Scene, camera: Mapping[str, Any]) -> dict[str, Any] | None:
    """`body_from_camera` of a camera's settings for the configuration of a world: `mount`, or where
    the wearer had the camera `recorded` in the first sector. None for neither: at the height of the
    eyes, level."""
    matrix = camera.get("mount")
    if matrix is None:
        if not isinstance(camera.get("recorded"), str):
            return None
        matrix = scene.recording(0).mount(camera["recorded"])
    try:
        rows = np.asarray(matrix, np.float64)
    except (TypeError, ValueError) as error:
        raise _core.SettingError(f"camera.mount: {error}") from error
    if rows.shape != (4, 4):
        raise _core.SettingError(f"camera.mount: found shape {rows.shape}, expected (4, 4)")
    return json.loads(_core.pose(rows.tolist()))


def _conditions(n: int, velocity, rate, gain) -> np.ndarray | None:
    """What the core renders frames with besides poses; None for cameras at rest."""
    if velocity is None and rate is None and gain is None:
        return None
    conditions = np.zeros((n, 7))
    conditions[:, 6] = 1.0
    columns = {"velocity": slice(0, 3), "rate": slice(3, 6), "gain": 6}
    for (name, of), values in zip(columns.items(), (velocity, rate, gain)):
        if values is not None:
            shape = conditions[:, of].shape[1:]
            conditions[:, of] = _of_images(name, values, n, shape, np.float64)
    return conditions


def _of_images(name: str, values, n: int, shape: tuple[int, ...], kind: type) -> np.ndarray:
    """Values of n images, of `shape` for each: one for all of them, or one for each."""
    try:
        array = np.asarray(values, kind)
    except (TypeError, ValueError, OverflowError) as error:
        raise _core.SettingError(f"{name}: {error}") from error
    whole = (n, *shape)
    if array.shape not in (shape, whole):
        raise _core.SettingError(
            f"{name}: found shape {array.shape}, expected {whole}, or {shape} for all images"
        )
    return np.array(np.broadcast_to(array, whole))


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
        if matrix[0, 1] != 0.0 or matrix[1, 0] != 0.0 or matrix[2].tolist() != [0.0, 0.0, 1.0]:
            raise _core.SettingError(
                f"camera.K: found {matrix.tolist()}, expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]"
            )
        return (*(float(matrix[k, k]) for k in (0, 1)), float(matrix[0, 2]), float(matrix[1, 2]))
    try:
        angle = np.pi / 2 if fov is None else float(fov)
    except (TypeError, ValueError) as error:
        raise _core.SettingError(f"camera.fov: {error}") from error
    if not 0.0 < angle < np.pi:
        raise _core.SettingError(f"camera.fov: found {angle} rad, expected above 0 and below pi")
    focal = 0.5 * width / np.tan(0.5 * angle)
    return (focal, focal, 0.5 * (width - 1), 0.5 * (height - 1))
