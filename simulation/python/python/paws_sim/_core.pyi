"""Scenes, worlds and cameras. The package's classes stand on these; see their documentation."""

from typing import Any, Literal, final

import numpy as np
from numpy.typing import NDArray

REWARD_TERMS: list[str]
# Time of a step without a setting, s.
DT_S: float
# Names of the reasons why episodes end, with their codes.
END_REASONS: dict[str, int]
__version__: str

class SceneError(Exception): ...
class SettingError(ValueError): ...
class ActionError(ValueError): ...
class StartError(RuntimeError): ...
class BudgetError(MemoryError): ...
class StateError(RuntimeError): ...
class SnapshotError(ValueError): ...

def set_threads(threads: int) -> None:
    """Number of threads for steps and images, 0 for one per core. Results do not depend on it."""

def check_camera(lens: tuple[int, int, float, float, float, float], options: str) -> None:
    """Refuses a camera that no image could be rendered with."""

def pose(matrix: list[list[float]]) -> str:
    """A pose, a homogeneous matrix, as JSON in a world's configuration."""

def write_synthetic(name: str, path: str) -> None:
    """Writes a synthetic scene of one sector as a scene bundle, which must not exist."""

def timing(settings: str) -> str:
    """The whole timing of a camera as JSON, of settings or the name of a preset."""

def import_beogym(folder: str, out: str, now_ns: int) -> None:
    """Writes a folder of Beogym as a new folder of scene bundles."""

@final
class Scene:
    @staticmethod
    def open(path: str) -> Scene: ...
    @staticmethod
    def synthetic(name: str) -> Scene: ...
    @property
    def name(self) -> str: ...
    @property
    def hash(self) -> str: ...
    @property
    def source(self) -> str: ...
    @property
    def sectors(self) -> list[str]: ...
    @property
    def missing(self) -> list[tuple[str, str, str]]: ...
    @property
    def gaussians(self) -> list[int]: ...
    def reference_poses(self, sector: int) -> NDArray[np.float64]: ...
    def cameras(self, sector: int) -> list[dict[str, Any]]: ...
    def recording(self, sector: int) -> Recording: ...

_Numbers = dict[str, NDArray[Any]]
# Poses, sectors, seed, episode and number of each frame, and their conditions.
_Frames = tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.uint64], NDArray[np.float64]]

@final
class Recording:
    """What was recorded of the walk, in the frame of a sector."""

    def lens(
        self, name: str, width: int | None = None, height: int | None = None
    ) -> dict[str, Any]:
        """`size`, `intrinsics`, `distortion` as JSON and `line_s` of a camera; a missing edge keeps
        the shape."""

    def mount(self, name: str) -> list[list[float]]:
        """Rows of `body_from_camera` of a camera on an agent, where the wearer had it."""

    def contacts(self) -> _Numbers:
        """`foot` (0 left, 1 right), `time_ns` (N, 4), `world_from_foot` (N, 4, 4)."""

    @property
    def range_ns(self) -> tuple[int, int] | None:
        """Times of the first and the last pose of the wearer."""

    def wearer(self, time_ns: int) -> dict[str, Any] | None:
        """`world_from_rig`, `velocity` and `contacts` of both feet at a time."""

@final
class World:
    def __init__(self, scene: Scene, config: str, copy: bool) -> None: ...
    @property
    def environments(self) -> int: ...
    @property
    def action_size(self) -> int: ...
    @property
    def config(self) -> str: ...
    def observation_fields(self) -> list[tuple[str, int, int]]: ...
    def observation_bounds(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]: ...
    def reset(
        self, mask: NDArray[np.bool_] | None = None, seeds: list[int | None] | None = None
    ) -> None: ...
    def step(
        self, actions: NDArray[np.float64], autoreset: Literal[0, 1, 2]
    ) -> tuple[
        NDArray[np.float32],
        NDArray[np.float64],
        NDArray[np.bool_],
        NDArray[np.bool_],
        _Numbers,
        NDArray[np.bool_],
        tuple[NDArray[np.bool_], NDArray[np.float32], _Numbers] | None,
    ]: ...
    def observations(self) -> NDArray[np.float32]: ...
    def numbers(self) -> _Numbers: ...
    def reward_terms(self) -> NDArray[np.float64]: ...
    def has_ended(self) -> NDArray[np.bool_]: ...
    def states(self) -> _Numbers: ...
    def camera_poses(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]: ...
    def frames(self) -> _Frames: ...
    def final_frames(self) -> _Frames: ...
    def random_keys(self) -> NDArray[np.uint64]: ...
    def place(
        self,
        environment: int,
        position_m: list[float],
        angles_rad: list[float],
        velocity: list[float],
        sector: int | None = None,
        level: int = 0,
    ) -> None: ...
    def play(self, environment: int, time_ns: int) -> bool: ...
    def save(self, environment: int, attachment: bytes) -> bytes: ...
    def restore(self, environment: int, snapshot: bytes) -> bytes: ...
    def close(self) -> None: ...

@final
class Cameras:
    def __init__(self, scene: Scene, budget_bytes: int) -> None: ...
    def render(
        self,
        poses: NDArray[np.float64],
        sectors: NDArray[np.int64],
        lens: tuple[int, int, float, float, float, float],
        options: str,
        keys: NDArray[np.uint64],
        conditions: NDArray[np.float64] | None = None,
    ) -> _Numbers: ...
    def resident(self) -> list[int]: ...
    def close(self) -> None: ...
