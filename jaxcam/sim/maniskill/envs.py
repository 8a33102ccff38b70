"""The three tasks as environments of ManiSkill: `gymnasium.make("JaxcamPush-v1")`.

They are ManiSkill's PushCube, LiftPegUpright and RollBall with the starts, the success and the
gripper of `jaxcam.sim.tasks`. In randomised scenes the table is only seen elsewhere and the floor
is plain white, as in the authors' variants; what is touched stays where it is. Needs the extra
`jaxcam[maniskill]`.
"""

from copy import deepcopy
from typing import Any, ClassVar

import numpy as np
import sapien
import torch
from mani_skill.agents.registration import register_agent
from mani_skill.agents.robots import Panda
from mani_skill.envs.sapien_env import BaseEnv
from mani_skill.envs.tasks.tabletop.lift_peg_upright import LiftPegUprightEnv
from mani_skill.envs.tasks.tabletop.push_cube import PushCubeEnv
from mani_skill.envs.tasks.tabletop.roll_ball import RollBallEnv
from mani_skill.sensors.camera import CameraConfig
from mani_skill.utils import common
from mani_skill.utils.registration import register_env
from mani_skill.utils.structs import Pose

from jaxcam.rays import sample_poses, sapien_from_opencv
from jaxcam.rays.rotations import matrix_from_quaternion
from jaxcam.sim import make_task
from jaxcam.sim.maniskill.memory import FAR, JOINTS, NEAR
from jaxcam.sim.maniskill.scenery import SeenTable, lighten, sapien_pose, set_camera
from jaxcam.sim.task import starts
from jaxcam.sim.types import Start, State

ROBOT = "panda_firm"


@register_agent()
class FirmPanda(Panda):
    """ManiSkill's Panda with the firmer gripper of the authors' simulator."""

    uid = ROBOT

    @property
    def _controller_configs(self) -> dict[str, Any]:
        configs = deepcopy(super()._controller_configs)
        for config in configs.values():
            gripper = config["gripper"]
            gripper.lower, gripper.force_limit = -0.03, 300.0
            gripper.stiffness, gripper.damping = 3e3, 2e2
        return configs


class JaxcamEnv(BaseEnv):
    """What the three environments share; to be mixed in before one of ManiSkill's.

    Rewards are ManiSkill's, made for its own starts.

    Args:
        scene: `fixed` or `randomized`, as in `jaxcam.sim.task.Task.scene`.
        resolution: Height and width (pixels) of the task's cameras, `view_0` and so on.
        eye: Height and width (pixels) of one camera that takes their place: it looks along the
            actor `eye`, which goes anywhere, on a card too. Robot and floor are drawn with fewer
            triangles.
        args: See ManiSkill.
        kwargs: See ManiSkill.
    """

    SUPPORTED_ROBOTS: Any = (ROBOT,)
    agent: Any
    scene: Any
    table_scene: Any
    _eye: Any
    task_name: ClassVar[str]
    table_stretch: ClassVar[float] = 1.0
    """How much longer than ManiSkill's the table of randomised scenes is."""

    def __init__(
        self,
        *args: Any,
        scene: str = "fixed",
        resolution: int = 128,
        eye: tuple[int, int] | None = None,
        **kwargs: Any,
    ) -> None:
        self.task = make_task(self.task_name)
        self.world = self.task.scene(scene)
        self.start: Start
        self._resolution, self._eye_size, self._seeded = resolution, eye, True
        super().__init__(*args, robot_uids=kwargs.pop("robot_uids", ROBOT), **kwargs)

    @property
    def _default_sensor_configs(self) -> list[CameraConfig]:
        """The task's cameras, at poses of its ranges; `set_cameras` moves them. Or the eye."""
        if self._eye_size:
            height, width = self._eye_size
            pose = Pose.create(sapien.Pose())
            return [CameraConfig("eye", pose, width, height, 1.0, NEAR, FAR, mount=self._eye)]
        fov, side = float(np.deg2rad(self.task.fovy_deg)), self._resolution
        poses = sample_poses(self.task.cameras, self.task.views, 0)
        return [
            CameraConfig(f"view_{i}", sapien_pose(pose), side, side, fov, NEAR, FAR)
            for i, pose in enumerate(poses)
        ]

    def _load_scene(self, options: dict[str, Any]) -> None:
        super()._load_scene(options)
        self.actors = [self.scene.actors[name] for name in self.task.objects()]
        self.markers = [self.scene.actors[name] for name in self.task.markers]
        self._drawn_table = None
        if self.world.name == "randomized":
            self._drawn_table = SeenTable(self.scene, self.table_scene, self.table_stretch)
        if self._eye_size:
            for link in self.agent.robot.links:
                for part in link._objs:
                    lighten(part.entity)
            for ground in self.table_scene.ground._objs:
                lighten(ground)
            builder = self.scene.create_actor_builder()
            builder.initial_pose = sapien.Pose()
            self._eye = builder.build_kinematic(name="eye")

    def reset(
        self, seed: int | list[int] | None = None, options: dict[str, Any] | None = None
    ) -> Any:
        """Starts episodes: those of the seeds, or others than before without."""
        self._seeded = seed is not None
        return super().reset(seed, options)

    def _initialize_episode(self, env_idx: torch.Tensor, options: dict[str, Any]) -> None:
        rows: Any = common.to_numpy(env_idx)
        seeds: Any = self._episode_seed[rows]
        if not self._seeded:
            seeds = self._batched_episode_rng[rows].randint(2**31)
        self.begin(starts(self.task, self.world, [int(seed) for seed in seeds]), rows=rows)

    def begin(
        self, start: Start, *, rows: np.ndarray | None = None, qvel: np.ndarray | None = None
    ) -> None:
        """Puts robot, objects and what is seen at a start. On a card `reset` or `put` make it so.

        Args:
            start: Of the environments in `rows`.
            rows: Environments that start; all when None. Only within `reset` may it be some.
            qvel: Velocities [B, nv] of robot and objects; at rest when None.
        """
        rows = np.arange(self.num_envs) if rows is None else rows
        qvel = np.zeros((len(rows), self.world.nv)) if qvel is None else qvel
        if len(rows) == self.num_envs:
            self.start = start
        else:
            self.start = Start(
                *(_replaced(a, rows, b) for a, b in zip(self.start, start, strict=True))
            )
        base = self.world.world_from_base
        self.agent.reset(self._tensor(start.qpos[:, :JOINTS]))
        self.agent.robot.set_qvel(self._tensor(qvel[:, :JOINTS]))
        self.agent.robot.set_pose(sapien.Pose(base))
        poses = start.qpos[:, JOINTS:].reshape(len(rows), -1, 7).swapaxes(0, 1)
        moves = qvel[:, JOINTS:].reshape(len(rows), -1, 6).swapaxes(0, 1)
        for actor, pose, move in zip(self.actors, poses, moves, strict=True):
            actor.set_pose(Pose.create(self._tensor(pose)))
            actor.set_linear_velocity(self._tensor(move[:, :3]))
            actor.set_angular_velocity(self._tensor(move[:, 3:]))
        for marker, pose in zip(self.markers, start.fixtures[:, 2:].swapaxes(0, 1), strict=True):
            marker.set_pose(Pose.create(self._tensor(pose)))
        if self._drawn_table is not None:
            self._drawn_table.place(self._tensor, start.fixtures[:, 0])

    def put(self, start: Start, qvel: np.ndarray) -> None:
        """Puts all environments at states between resets; see `begin`."""
        self.begin(start, qvel=qvel)
        self._settle()

    def show(self, start: Start | None, world_from_camera: np.ndarray) -> None:
        """Puts all environments at a start, unless None, and the eye where it sees from.

        Args:
            start: Of all of them.
            world_from_camera: OpenCV axes [B, 4, 4].
        """
        if start is not None:
            self.begin(start)
        poses = [sapien.Pose(np.asarray(sapien_from_opencv(x), float)) for x in world_from_camera]
        self._eye.set_pose(Pose.create(poses, device=self.device))
        self._settle()

    def advance(self, targets: np.ndarray) -> None:
        """One control step of all environments, without observations.

        Args:
            targets: Of the joints' drives (rad, m) [B, 9].
        """
        robot = self.agent.robot
        robot.set_joint_drive_targets(self._tensor(targets), robot.active_joints)
        if self.gpu_sim_enabled:
            self.scene.px.gpu_apply_articulation_target_position()
        for _ in range(self.sim_freq // self.control_freq):
            self.scene.step()
        if self.gpu_sim_enabled:
            self.scene._gpu_fetch_all()

    def _settle(self) -> None:
        """Hands what was set over to the card, as ManiSkill does after it has set states."""
        if self.gpu_sim_enabled:
            self.scene._gpu_apply_all()
            self.scene.px.gpu_update_articulation_kinematics()
            self.scene._gpu_fetch_all()

    def numbers(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A state's qpos [B, nq] and qvel [B, nv], and poses of the grip [B, 7]."""
        robot = self.agent.robot
        qpos = [robot.get_qpos(), *(actor.pose.raw_pose for actor in self.actors)]
        moves = (part for a in self.actors for part in (a.linear_velocity, a.angular_velocity))
        qvel = [robot.get_qvel(), *moves]
        parts = torch.cat(qpos, -1), torch.cat(qvel, -1), self.agent.tcp.pose.raw_pose
        qpos, qvel, grip = (common.to_numpy(x).astype(float) for x in parts)
        return qpos, qvel, grip

    def state(self) -> State:
        """Joints and objects, and the grip; [B, ...] as in `jaxcam.sim.types.State`."""
        qpos, qvel, grip = self.numbers()
        count = len(qpos)
        return State(
            qpos=qpos,
            qvel=qvel,
            warmstart=np.zeros_like(qvel),
            closed=np.zeros(count),
            rest=self.start.qpos[:, :7],
            grip_position=grip[:, :3],
            grip_rotation=matrix_from_quaternion(grip[:, 3:]),
            ok=np.isfinite(qpos).all(-1) & np.isfinite(qvel).all(-1),
        )

    def evaluate(self) -> dict[str, torch.Tensor]:
        """The task's own success."""
        done = self.task.success(self.world, self.state(), self.start)
        return {"success": torch.as_tensor(done, device=self.device)}

    def set_cameras(self, K: np.ndarray, world_from_camera: np.ndarray) -> None:
        """Gives the task's cameras intrinsics and poses, from the next picture on.

        Args:
            K: Pixels [V, 3, 3].
            world_from_camera: OpenCV axes [V, 4, 4].
        """
        for i in range(self.task.views):
            set_camera(self._sensors[f"view_{i}"], K[i], world_from_camera[i])

    def _tensor(self, array: np.ndarray) -> torch.Tensor:
        return torch.as_tensor(np.asarray(array), dtype=torch.float32, device=self.device)


@register_env("JaxcamPush-v1", max_episode_steps=150)
class JaxcamPushEnv(JaxcamEnv, PushCubeEnv):
    """`jaxcam.sim.tasks.push` on ManiSkill's PushCube."""

    task_name = "push"


@register_env("JaxcamLiftUpright-v1", max_episode_steps=450)
class JaxcamLiftUprightEnv(JaxcamEnv, LiftPegUprightEnv):
    """`jaxcam.sim.tasks.lift_upright` on ManiSkill's LiftPegUpright."""

    task_name = "lift_upright"


@register_env("JaxcamRollBall-v1", max_episode_steps=150)
class JaxcamRollBallEnv(JaxcamEnv, RollBallEnv):
    """`jaxcam.sim.tasks.roll_ball` on ManiSkill's RollBall."""

    task_name = "roll_ball"
    table_stretch = 2.0

    def _initialize_episode(self, env_idx: torch.Tensor, options: dict[str, Any]) -> None:
        super()._initialize_episode(env_idx, options)
        self.reached_status = self.reached_status.to(self.device)  # ManiSkill's reward needs it
        self.reached_status[env_idx] = 0.0


def _replaced(array: np.ndarray, rows: np.ndarray, values: np.ndarray) -> np.ndarray:
    array = array.copy()
    array[rows] = values
    return array
