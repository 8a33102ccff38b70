"""What cameras see of a board, by numbers alone: its corners projected, with noise."""

import numpy as np
from scipy.spatial.transform import Rotation

from jaxcam.interop.cameras.optics import Optics
from jaxcam.rays.lens import pack
from jaxcam.robot.calibration.boards import Board, BoardSeen
from jaxcam.robot.calibration.projection import pixels_of, placed, pose_of

BOARD = Board("charuco", 7, 5, 0.03, 0.021, "4x4_50")
SIZE = (640, 480)
WEBCAM = (-0.2, 0.05, 4e-4, -3e-4, 0.01)
WIDE = (0.02, -0.01, 0.003, -0.001)


def optics(focal=600.0, lens=WEBCAM, kind="opencv", centre=(326.0, 236.0)):
    K = np.array([[focal, 0, centre[0]], [0, focal * 1.001, centre[1]], [0, 0, 1]])
    return Optics(K, *SIZE, np.asarray(pack(np.array(lens), kind)))


def board_poses(rng, count, far=0.3, tilt=0.7, board=BOARD):
    """Poses of a board in the camera's axes: all over the picture, tilted to all sides."""
    ways = np.arange(count) * 2.4
    turns = tilt * rng.uniform(0.7, 1, count)[:, None] * np.c_[np.cos(ways), np.sin(ways), 0 * ways]
    rotations = Rotation.from_rotvec(turns) * Rotation.from_rotvec(
        np.c_[np.zeros((count, 2)), rng.uniform(-0.6, 0.6, count)]
    )
    middle = np.c_[rng.uniform(-0.3, 0.3, (count, 2)) * [1, 0.75], np.ones(count)] * far
    poses = pose_of(rotations.as_matrix(), middle)
    poses[:, :3, 3] -= poses[:, :3, :3] @ board.points.mean(0)
    return poses


def seen(camera, poses, rng, board=BOARD, noise=0.05, shape=0.0, name="p"):
    """The corners of each picture that are in it; `shape` is added to their places on the board."""
    views = []
    for i, pose in enumerate(poses):
        pixels = pixels_of(placed(pose, board.points + shape), camera)
        pixels = pixels + rng.normal(0, noise, pixels.shape)
        inside = ((pixels > 2) & (pixels < np.array(SIZE) - 2)).all(-1)
        views.append(BoardSeen(f"{name}{i}", np.flatnonzero(inside), pixels[inside]))
    return views
