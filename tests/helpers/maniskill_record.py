"""Records trajectories with ManiSkill's own `RecordEpisode`; run as a program, with PyTorch.

`python maniskill_record.py FOLDER NAME=ENV,MODE,SEED...` writes FOLDER/NAME.h5 and .json, one
episode a seed shown by the expert of our task; a seed below zero stands still. FOLDER/targets.npz
gets what ManiSkill's controllers make of actions in each control mode.
"""

import sys
from typing import Any

import gymnasium
import numpy as np
import torch
from mani_skill.utils.geometry.rotation_conversions import matrix_to_euler_angles
from mani_skill.utils.wrappers import RecordEpisode

import jaxcam.sim.maniskill.envs  # noqa: F401  (registers ours)
from jaxcam.interop.maniskill_actions import SIZES
from jaxcam.interop.maniskill_files import ENVIRONMENTS
from jaxcam.rays.rotations import matrix_from_quaternion, matrix_from_rotvec
from jaxcam.sim import make_task
from jaxcam.sim.maniskill import kinematics
from jaxcam.sim.types import Aim, ExpertSight, Start


class Show:
    """The expert of our task in somebody's environment."""

    def __init__(self, env: Any, mode: str) -> None:
        self.env, self.mode, self.inner = env, mode, env.unwrapped
        self.task: Any = make_task(ENVIRONMENTS[env.spec.id])
        self.world = self.task.scene("fixed")
        self.base = self.world.world_from_base

    def episode(self, seed: int) -> None:
        self.env.reset(seed=abs(seed))
        fixtures = np.zeros((2 + len(self.task.markers), 7))
        for row, name in enumerate(self.task.markers, start=2):
            fixtures[row] = self.inner.scene.actors[name].pose.raw_pose[0]
        qpos, position, rotation = self.look()
        start = Start(qpos, np.zeros((0, 3)), fixtures)
        sight = ExpertSight(position, rotation, qpos, np.random.default_rng(abs(seed)), start)
        for aim in self.task.expert(self.world, sight):
            aim = Aim(position, rotation, aim.gripper) if seed < 0 else aim
            self.env.step(self.action(aim, sight))
            sight.qpos, sight.grip_position, sight.grip_rotation = self.look()
            if seed < 0 and self.inner.elapsed_steps[0] > 5:
                return

    def look(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        robot, tcp = self.inner.agent.robot, self.inner.agent.tcp.pose
        poses = [self.inner.scene.actors[name].pose.raw_pose for name in self.world.objects]
        qpos = torch.cat([robot.get_qpos(), *poses], -1)[0].numpy().astype(float)
        rotation = matrix_from_quaternion(tcp.q[0].numpy().astype(float))
        return qpos, tcp.p[0].numpy().astype(float), rotation

    def action(self, aim: Any, sight: ExpertSight) -> np.ndarray:
        """An aim in the environment's control mode."""
        turn = self.base[:3, :3]
        position, rotation = turn.T @ (aim.position - self.base[:3, 3]), turn.T @ aim.rotation
        joints = sight.qpos[:7]
        if self.mode.startswith("pd_joint"):
            goal = kinematics.inverse(position[None], rotation[None], joints[None], joints[None])
            move = goal[0] if self.mode == "pd_joint_pos" else (goal[0] - joints) / 0.1
        else:
            move = np.concatenate([position, _euler(rotation)])
            if self.mode == "pd_ee_delta_pose":
                at, axes = (x[0] for x in kinematics.forward(joints[None])[:2])
                move = np.concatenate([position - at, -_euler(rotation @ axes.T)]) / 0.1
        return np.append(move, -aim.gripper).astype(np.float32)


def _euler(rotation: np.ndarray) -> np.ndarray:
    return matrix_to_euler_angles(torch.tensor(rotation), "XYZ").numpy()


def controller_targets() -> dict[str, np.ndarray]:
    """Actions, joint angles and targets (poses, or joint angles) of each mode, by `mode/what`."""
    arrays, rng = {}, np.random.default_rng(0)
    env = make("PushCube-v1", "pd_ee_pose")
    modes = [m for m in env.unwrapped.agent.supported_control_modes if m in SIZES]
    for mode in modes:
        env = make("PushCube-v1", mode)
        inner = env.unwrapped
        env.reset(seed=5)
        rows: dict[str, list[np.ndarray]] = {"actions": [], "joints": [], "targets": []}
        for _ in range(6):
            joints = inner.agent.robot.get_qpos()[0, :7].numpy().astype(float)
            position, rotation, _ = (x[0] for x in kinematics.forward(joints[None]))
            action = rng.uniform(-1.2, 1.2, SIZES[mode])
            if mode == "pd_joint_pos":
                action[:7] = joints + 0.05 * action[:7]
            elif mode == "pd_ee_pose":
                turn = matrix_from_rotvec(0.05 * action[3:6])
                action[:6] = *(position + 0.05 * action[:3]), *_euler(turn @ rotation)
            env.step(action.astype(np.float32))
            arm = inner.agent.controller.controllers["arm"]
            target = arm._target_qpos if "joint" in mode else arm._target_pose.raw_pose
            rows["actions"].append(action.astype(np.float32))
            rows["joints"].append(joints)
            rows["targets"].append(target[0].numpy().astype(float))
        rows["joints"].append(inner.agent.robot.get_qpos()[0, :7].numpy().astype(float))
        arrays |= {f"{mode}/{what}": np.stack(values) for what, values in rows.items()}
    return arrays


def make(name: str, mode: str) -> Any:
    return gymnasium.make(
        name, obs_mode="none", control_mode=mode, render_backend="none", sim_backend="physx_cpu"
    )


def main() -> None:
    folder, *cases = sys.argv[1:]
    for case in cases:
        name, _, how = case.partition("=")
        env, mode, *seeds = how.split(",")
        recorded = RecordEpisode(make(env, mode), folder, trajectory_name=name, save_video=False)
        show = Show(recorded, mode)
        for seed in map(int, seeds):
            show.episode(seed)
        recorded.close()
    np.savez(f"{folder}/targets.npz", **controller_targets())


if __name__ == "__main__":
    main()
