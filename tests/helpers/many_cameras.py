"""Demonstrations that are seen by many cameras, and changes of those cameras' poses."""

from dataclasses import replace

import numpy as np

from jaxcam.rays import POSE_RANGES, sample_poses

CAMERAS = 60


def seen_by_many(demos):
    """The session's six demonstrations ten times, each seen by a camera of its own."""
    episodes = demos.episodes * (CAMERAS // 6)
    train = [replace(demo, cameras=np.array([i])) for i, demo in enumerate(episodes)]
    poses = sample_poses(POSE_RANGES["robosuite"], CAMERAS, 1)
    header = replace(demos.header, world_from_camera=poses, train=CAMERAS, valid=0)
    return replace(demos, header=header, train=train, valid=[])


def with_poses(demos, poses):
    return replace(demos, header=replace(demos.header, world_from_camera=poses))


def rotated(poses, rotation):
    poses = poses.copy()
    poses[:, :3, :3] = rotation
    return poses


def scaled(poses, unit):
    poses = poses.copy()
    poses[:, :3, 3] *= unit
    return poses
