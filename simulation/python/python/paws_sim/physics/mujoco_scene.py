"""A scene's collision geometry and a robot as one MuJoCo model, and a batch of its states.

The scene is the folder of `paws scene export --format mjcf`: convex parts, and a height field for
each level. World frame z up; metres, radians, seconds, newtons; quaternions w x y z as in MuJoCo.

Feet and the rest of a robot touch different layers, because MuJoCo keeps at most 50 contacts of a
pair of geoms:

=========  ========================================  ===================
layer      geometry                                  touched by
=========  ========================================  ===================
parts      convex parts as they are                  feet and the rest
fine       height fields in tiles of 64 x 64 cells   feet
coarse     every third of their heights, 12 cm       the rest
=========  ========================================  ===================
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from . import BackendMissing, SnapshotError
from .height_field import HeightField, read_height_field

try:
    import mujoco
except ImportError as error:
    raise BackendMissing("mujoco", "paws_sim.physics") from error

#: Contact bits of the layers. Bit 0 is MuJoCo's default, which robots have among themselves.
FINE_BIT = 1 << 1
COARSE_BIT = 1 << 2
#: Contacts that MuJoCo keeps of a pair of geoms.
MAX_CONTACTS_OF_PAIR = 50

TILE_CELLS = 64
COARSE_CELL_M = 0.12
# Thickness of a height field below its lowest height, and its least range, m: both must be > 0.
_BASE_M = 0.1
# Depth of the coarse layer below the fine one, m: a ray meets one after the other.
_COARSE_BELOW_M = 1e-3
_MIN_RANGE_M = 1e-4

_MAGIC = b"PAWSMJ01"
_HEAD = struct.Struct("<8s16s16sI")


def scene_spec(
    folder: str | Path,
    tile_cells: int = TILE_CELLS,
    coarse_cell_m: float = COARSE_CELL_M,
) -> mujoco.MjSpec:
    """The scene of an `mjcf` export with its contact layers, to which robots are attached.

    Raises FileNotFoundError for a folder without `model.xml`.
    """
    path = Path(folder) / "model.xml"
    if not path.is_file():
        raise FileNotFoundError(f"{path}: not there; `paws scene export --format mjcf` writes it")
    spec = mujoco.MjSpec.from_file(str(path))
    # Height fields are replaced by tiles.
    fields = {field.name: field for field in spec.hfields}
    for geom in list(spec.worldbody.geoms):
        geom.conaffinity = 0
        if geom.type != mujoco.mjtGeom.mjGEOM_HFIELD:
            geom.contype = FINE_BIT | COARSE_BIT
            continue
        asset = fields[geom.hfieldname]
        field = read_height_field(path.parent / asset.file, asset.size, geom.pos)
        name = geom.name
        spec.delete(geom)
        spec.delete(asset)
        factor = max(1, round(coarse_cell_m / field.cell_m[0]))
        _add_tiles(spec, f"{name}_fine", field, tile_cells, FINE_BIT)
        _add_tiles(spec, f"{name}_coarse", field.coarser(factor, _COARSE_BELOW_M), tile_cells, COARSE_BIT)
    return spec


def _add_tiles(
    spec: mujoco.MjSpec, name: str, field: HeightField, cells: int, bit: int
) -> None:
    for number, tile in enumerate(field.tiles(cells)):
        rows, columns = tile.heights_m.shape
        low, high = float(tile.heights_m.min()), float(tile.heights_m.max())
        height_range = max(high - low, _MIN_RANGE_M)
        half = [0.5 * (n - 1) * c for n, c in zip((columns, rows), tile.cell_m, strict=True)]
        shares = (tile.heights_m - low) / height_range
        spec.add_hfield(
            name=f"{name}_{number}",
            nrow=rows,
            ncol=columns,
            size=[half[0], half[1], height_range, _BASE_M],
            userdata=shares.astype(np.float32).ravel(),
        )
        spec.worldbody.add_geom(
            name=f"{name}_{number}",
            type=mujoco.mjtGeom.mjGEOM_HFIELD,
            hfieldname=f"{name}_{number}",
            pos=[tile.origin_m[0] + half[0], tile.origin_m[1] + half[1], low],
            contype=bit,
            conaffinity=0,
        )


def attach_robot(
    scene: mujoco.MjSpec,
    robot: mujoco.MjSpec,
    feet: Sequence[str],
    prefix: str = "robot/",
) -> list[str]:
    """Adds a robot to a scene and gives the names that its foot geoms have there.

    Feet touch parts and fine tiles, all other geoms that collide touch parts and coarse tiles.
    The scene takes the robot's time step, integrator, friction cone and `impratio`.
    Raises ValueError for a foot that the robot does not have.
    """
    names = {geom.name for geom in robot.geoms}
    missing = [foot for foot in feet if foot not in names]
    if missing:
        raise ValueError(f"the robot has no geoms {missing}, it has {sorted(names - {''})}")
    for geom in robot.geoms:
        if geom.contype or geom.conaffinity:
            geom.conaffinity |= FINE_BIT if geom.name in feet else COARSE_BIT
    for option in ("timestep", "integrator", "cone", "impratio", "iterations", "ls_iterations"):
        setattr(scene.option, option, getattr(robot.option, option))
    scene.attach(robot, prefix=prefix, frame=scene.worldbody.add_frame())
    return [prefix + foot for foot in feet]


def touch_scene(geom: mujoco.MjsGeom, is_foot: bool = False) -> None:
    """Lets a geom of a body that was added to a scene touch it, as a foot or as anything else."""
    geom.conaffinity |= FINE_BIT if is_foot else COARSE_BIT


@dataclass(frozen=True)
class FootContacts:
    """What the feet of one state touch; one row per foot, NaN where a foot touches nothing.

    `force_n` is the force of the ground on the foot in the world. `point_m` and `normal` (away
    from the ground) are means over the contacts of the foot, weighted by their normal forces;
    the point is on the surface of the ground, where MuJoCo's own is half way into the foot.
    `gap_m` is the height of the foot's lowest point above the surface below it, negative in it:
    the collision shape, or what `surface` says.
    `full_pairs` counts pairs with as many contacts as MuJoCo keeps, whose forces may lack some.
    `single` has a row for each single contact: index of the foot, point (m), normal and force (N).
    """

    is_touching: np.ndarray
    force_n: np.ndarray
    point_m: np.ndarray
    normal: np.ndarray
    gap_m: np.ndarray
    full_pairs: int
    single: np.ndarray


class MujocoScene:
    """A batch of states of one model.

    States do not influence each other: a state has the same bits in a batch of any size, on any
    number of threads. Threads start at the first step that uses them.
    """

    def __init__(
        self,
        spec: mujoco.MjSpec,
        feet: Sequence[str] = (),
        environments: int = 1,
        threads: int = 1,
    ):
        if environments < 1 or threads < 1:
            raise ValueError(f"{environments} environments, {threads} threads: 1 or more of each")
        self.model = spec.compile()
        self.data = [mujoco.MjData(self.model) for _ in range(environments)]
        self.feet = tuple(feet)
        self._foot_ids = np.array([self.model.geom(name).id for name in feet], dtype=int)
        self._is_static = self.model.body_weldid[self.model.geom_bodyid] == 0
        self._threads = threads
        self._pool: ThreadPoolExecutor | None = None
        self._hash = self._model_hash()
        for data in self.data:
            mujoco.mj_forward(self.model, data)

    def _model_hash(self) -> bytes:
        buffer = np.empty(mujoco.mj_sizeModel(self.model), np.uint8)
        mujoco.mj_saveModel(self.model, None, buffer)
        return hashlib.blake2b(buffer.tobytes(), digest_size=16).digest()

    @property
    def environments(self) -> int:
        return len(self.data)

    def reset(self, environment: int, qpos: np.ndarray | None = None) -> None:
        """Puts one state to the model's own start, or to joint positions at rest."""
        data = self.data[environment]
        mujoco.mj_resetData(self.model, data)
        if qpos is not None:
            if not np.isfinite(qpos).all():
                raise ValueError(f"environment {environment}: joint positions are not finite")
            data.qpos[:] = qpos
        mujoco.mj_forward(self.model, data)

    def step(self, controls: np.ndarray | None = None, steps: int = 1) -> None:
        """Advances all states by `steps` time steps with constant controls (N, nu).

        Raises ValueError for controls of another shape or that are not finite; nothing moved then.
        """
        if controls is not None:
            controls = np.asarray(controls, float)
            if controls.shape != (self.environments, self.model.nu):
                expected = (self.environments, self.model.nu)
                raise ValueError(f"controls have the shape {controls.shape}, expected {expected}")
            bad = np.argwhere(~np.isfinite(controls))
            if len(bad):
                environment, actuator = bad[0]
                raise ValueError(
                    f"environment {environment}: control {actuator} is not finite"
                )
            for data, control in zip(self.data, controls, strict=True):
                data.ctrl[:] = control
        self.for_each(lambda _, data: mujoco.mj_step(self.model, data, steps))

    def for_each(self, call) -> list:
        """Results of `call(environment, data)` for all states, on the threads of the scene."""
        if self._threads == 1 or self.environments == 1:
            return [call(i, data) for i, data in enumerate(self.data)]
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self._threads)
        return list(self._pool.map(call, range(self.environments), self.data))

    def close(self) -> None:
        """Ends the threads. A second call does nothing."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    def has_diverged(self, environment: int) -> bool:
        """Whether the state is not finite or MuJoCo warned about it."""
        data = self.data[environment]
        bad = (
            mujoco.mjtWarning.mjWARN_BADQPOS,
            mujoco.mjtWarning.mjWARN_BADQVEL,
            mujoco.mjtWarning.mjWARN_BADQACC,
        )
        return not np.isfinite(data.qpos).all() or any(data.warning[w].number for w in bad)

    def save(self, environment: int, more: bytes = b"") -> bytes:
        """All that the next step depends on, warm start included, and `more` of a controller.

        Restored into a scene of the same model and version of MuJoCo it continues bit for bit.
        """
        signature = mujoco.mjtState.mjSTATE_INTEGRATION
        state = np.empty(mujoco.mj_stateSize(self.model, signature))
        mujoco.mj_getState(self.model, self.data[environment], state, signature)
        body = state.tobytes() + more
        digest = hashlib.blake2b(self._hash + body, digest_size=16).digest()
        return _HEAD.pack(_MAGIC, self._hash, digest, len(state)) + body

    def restore(
        self, environment: int, snapshot: bytes, more_bytes: int | None = None
    ) -> bytes:
        """Continues from a snapshot, of any environment of a scene with the same model, and gives
        back `more`, of `more_bytes` bytes where that is given.

        Raises SnapshotError; the state is unchanged then.
        """
        signature = mujoco.mjtState.mjSTATE_INTEGRATION
        size = mujoco.mj_stateSize(self.model, signature)
        if len(snapshot) < _HEAD.size or snapshot[:8] != _MAGIC:
            raise SnapshotError("found no snapshot of a MuJoCo scene")
        _, model, digest, count = _HEAD.unpack_from(snapshot)
        if model != self._hash:
            raise SnapshotError("found a snapshot of another model or version of MuJoCo")
        body = snapshot[_HEAD.size :]
        expected = hashlib.blake2b(model + body, digest_size=16).digest()
        if count != size or len(body) < 8 * size or digest != expected:
            raise SnapshotError("found a damaged snapshot")
        found_bytes = len(body) - 8 * size
        if more_bytes is not None and found_bytes != more_bytes:
            raise SnapshotError(
                f"found {found_bytes} bytes of a controller's state, expected {more_bytes}"
            )
        data = self.data[environment]
        mujoco.mj_resetData(self.model, data)
        mujoco.mj_setState(self.model, data, np.frombuffer(body, count=size), signature)
        # What is derived from the state; the next step computes the same again.
        warm_start = data.qacc_warmstart.copy()
        mujoco.mj_forward(self.model, data)
        data.qacc_warmstart[:] = warm_start
        return body[8 * size :]

    def foot_contacts(self, environment: int, surface=None) -> FootContacts:
        """Contacts of the feet in one state.

        `surface(point_m) -> height_m or None` is the true ground below a point, from which gaps
        are measured where it is given.
        """
        data, count = self.data[environment], len(self.feet)
        force, point, normal = (np.zeros((count, 3)) for _ in range(3))
        weight = np.zeros(count)
        is_touching = np.zeros(count, bool)
        pairs: dict[tuple[int, int], int] = {}
        single = []
        wrench = np.empty(6)
        foot_of = {int(geom): i for i, geom in enumerate(self._foot_ids)}
        for number in range(data.ncon):
            contact = data.contact[number]
            first, second = (int(g) for g in contact.geom)
            pairs[first, second] = pairs.get((first, second), 0) + 1
            for own, other, sign in ((first, second, -1.0), (second, first, 1.0)):
                foot = foot_of.get(own)
                if foot is None or not self._is_static[other]:
                    continue
                mujoco.mj_contactForce(self.model, data, number, wrench)
                if wrench[0] <= 0:
                    continue
                # Rows of the frame are its axes; the first one points from the first geom to the
                # second, and the force acts on the second.
                frame = contact.frame.reshape(3, 3)
                own_force = sign * (frame.T @ wrench[:3])
                is_touching[foot] = True
                force[foot] += own_force
                normal[foot] += wrench[0] * sign * frame[0]
                # Halfway between the two surfaces; the distance is negative where they overlap.
                on_ground = contact.pos - 0.5 * contact.dist * sign * frame[0]
                point[foot] += wrench[0] * on_ground
                weight[foot] += wrench[0]
                single.append([foot, *on_ground, *(sign * frame[0]), *own_force])
        with np.errstate(invalid="ignore"):
            point /= weight[:, None]
            normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        gap = np.array([self._gap_m(data, geom, surface) for geom in self._foot_ids])
        full = sum(count >= MAX_CONTACTS_OF_PAIR for count in pairs.values())
        rows = np.array(single).reshape(-1, 10)
        return FootContacts(is_touching, force, point, normal, gap, full, rows)

    def _gap_m(self, data: mujoco.MjData, geom: int, surface) -> float:
        center = data.geom_xpos[geom]
        radius = self.model.geom_rbound[geom]
        if self.model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_SPHERE:
            below = radius
        else:
            # Half of the extent of the box around the geom, along z.
            below = float(
                np.abs(data.geom_xmat[geom].reshape(3, 3)[2]) @ self.model.geom_aabb[geom, 3:]
            )
        if surface is not None:
            height = surface(center)
            return np.nan if height is None else center[2] - below - height
        height = self.ground_m(data, center)
        return np.nan if height is None else center[2] - below - height

    def ground_m(self, data: mujoco.MjData, point: np.ndarray) -> float | None:
        """Height of the collision shape for feet at and below a point; None where there is none."""
        start = np.array([point[0], point[1], point[2]], float)
        hit = np.empty(1, np.int32)
        # Geoms that a foot does not touch, such as coarse tiles and other bodies, are passed.
        for _ in range(64):
            distance = mujoco.mj_ray(
                self.model, data, start, np.array([0.0, 0.0, -1.0]), None, 1, -1, hit
            )
            if distance < 0:
                return None
            start[2] -= distance
            if self._is_static[hit[0]] and self.model.geom_contype[hit[0]] & FINE_BIT:
                return float(start[2])
            start[2] -= 1e-6
        return None

    def world_from_camera(
        self, mounts: Sequence[tuple[str, np.ndarray]] | None = None
    ) -> np.ndarray:
        """Poses of cameras of all states, (N, C, 4, 4), axes x right, y down, z forward.

        `mounts` are names of bodies with the cameras' poses in them (4, 4); without it the poses
        are those of the model's own cameras, in its order.
        """
        if mounts is None:
            count = self.model.ncam
            poses = np.tile(np.eye(4), (self.environments, count, 1, 1))
            for i, data in enumerate(self.data):
                # MuJoCo's cameras have y up and look along -z.
                axes = data.cam_xmat.reshape(count, 3, 3) * np.array([1.0, -1.0, -1.0])
                poses[i, :, :3, :3] = axes
                poses[i, :, :3, 3] = data.cam_xpos
            return poses
        poses = np.empty((self.environments, len(mounts), 4, 4))
        bodies = [self.model.body(name).id for name, _ in mounts]
        for i, data in enumerate(self.data):
            for k, (body, (_, body_from_camera)) in enumerate(zip(bodies, mounts, strict=True)):
                world_from_body = np.eye(4)
                world_from_body[:3, :3] = data.xmat[body].reshape(3, 3)
                world_from_body[:3, 3] = data.xpos[body]
                poses[i, k] = world_from_body @ body_from_camera
        return poses
