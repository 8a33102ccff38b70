"""Demonstrations that are seen by many cameras, and changes of those cameras and of others."""

from dataclasses import replace

import numpy as np

from jaxcam.config.conditions import Conditions
from jaxcam.data.header import optics_ranges
from jaxcam.rays import POSE_RANGES, sample_poses
from jaxcam.rays.optics import sample_optics

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


def with_errors(demo, first=3, last=8):
    """The demonstration, its commands from `first` to before `last` being errors."""
    steps = np.arange(demo.length)
    return replace(demo, errors=(first <= steps) & (steps < last))


def with_optics(demos, **optics):
    """The demonstrations, seen by cameras whose intrinsics and lenses are drawn from ranges."""
    header, task = replace(demos.header, optics=optics), demos.task
    ranges = optics_ranges(Conditions(**optics), task.fovy_deg)
    K, lens = sample_optics(ranges, len(header.world_from_camera), 3)
    return replace(demos, header=replace(header, K=K, distortion=lens))
