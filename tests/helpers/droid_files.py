"""Episodes in DROID's raw layout, with tiny videos."""

import json

import h5py
import numpy as np

from jaxcam.files.video import write_video

SERIALS = {"wrist": "11", "ext1": "20", "ext2": "30"}
UUID = "LAB+0a1b2c3d+2023-03-07-16h-19m-59s"
SIX = {"ext1": (0.3, 0.5, 0.4, -2.0, 0.1, -1.2), "ext2": (0.2, -0.6, 0.5, -2.1, -0.1, 0.3)}
"""Translation (m) and XYZ Euler angles (rad) of the two cameras that stand still."""
WRIST = (0.05, 0.0, 0.07, 0.1, -0.2, 1.5)
"""Those of the camera on the hand, in the grip's frame."""
LENGTH, HEIGHT, WIDTH = 6, 36, 64


def euler(six):
    """A pose [4, 4] of DROID's numbers, written out: R = Rz Ry Rx."""
    x, y, z = six[3:]
    turn_x = [[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]]
    turn_y = [[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]]
    turn_z = [[np.cos(z), -np.sin(z), 0], [np.sin(z), np.cos(z), 0], [0, 0, 1]]
    pose = np.eye(4)
    pose[:3, :3] = np.array(turn_z) @ turn_y @ turn_x
    pose[:3, 3] = six[:3]
    return pose


def six_of(pose):
    """The six numbers of a pose [4, 4]."""
    R = pose[:3, :3]
    angles = np.arctan2(R[2, 1], R[2, 2]), -np.arcsin(R[2, 0]), np.arctan2(R[1, 0], R[0, 0])
    return np.array([*pose[:3, 3], *angles])


def grips(length=LENGTH):
    """Poses of the grip as six numbers [T, 6]."""
    t = np.linspace(0, 1, length)
    ones = np.ones(length)
    return np.stack([0.4 + 0.1 * t, 0.1 * t, 0.3 * ones, 3.0 * ones, 0.2 * t, -0.1 * t], 1)


def wrist_poses(length=LENGTH):
    """Where the camera on the hand is [T, 4, 4]."""
    return np.stack([euler(six) @ euler(WRIST) for six in grips(length)])


def metadata(success=True):
    wrist = six_of(wrist_poses()[0]).tolist()
    extrinsics = {
        f"{role}_cam_extrinsics": list(six) for role, six in (SIX | {"wrist": wrist}).items()
    }
    serials = {f"{role}_cam_serial": serial for role, serial in SERIALS.items()}
    about = {"uuid": UUID, "lab": "LAB", "success": success, "current_task": "Move a cup"}
    return about | serials | extrinsics | {"trajectory_length": LENGTH}


def shades(length, shift=0):
    """Pictures of one grey each, by which they are known after coding [T, H, W, 3]."""
    grey = (20 + 30 * np.arange(length) + shift).astype(np.uint8)
    return np.broadcast_to(grey[:, None, None, None], (length, HEIGHT, WIDTH, 3))


def write_episode(folder, *, success=True, length=LENGTH, videos=None, arrays=None):
    """Writes an episode.

    Args:
        folder: Made.
        success: What metadata says.
        length: Steps.
        videos: Pictures by the camera's role; of each as many as steps when None.
        arrays: More or other arrays by their path in `trajectory.h5`; None leaves one out.
    """
    (folder / "recordings" / "MP4").mkdir(parents=True)
    t = np.arange(length)
    joints = np.linspace(0, 1, 7 * length).reshape(length, 7)
    content = {
        "action/joint_position": joints + 0.5,
        "action/cartesian_position": grips(length) + 0.01,
        "action/gripper_position": t / length,
        "observation/robot_state/joint_positions": joints,
        "observation/robot_state/gripper_position": 1 - t / length,
        "observation/robot_state/cartesian_position": grips(length),
    }
    for role, serial in SERIALS.items():
        six = np.stack([six_of(p) for p in wrist_poses(length)])
        six = six if role == "wrist" else np.tile(SIX[role], (length, 1))
        content[f"observation/camera_extrinsics/{serial}_left"] = six
        content[f"observation/camera_type/{serial}"] = np.full(length, int(role != "wrist"))
    content |= arrays or {}
    with h5py.File(folder / "trajectory.h5", "w") as file:
        for name, array in content.items():
            if array is not None:
                file[name] = array
    (folder / f"metadata_{UUID}.json").write_text(json.dumps(metadata(success)))
    if videos is None:
        videos = {role: shades(length, 3 * i) for i, role in enumerate(SERIALS)}
    for role, pictures in videos.items():
        write_video(folder / "recordings" / "MP4" / f"{SERIALS[role]}.mp4", pictures, fps=15)
    return folder
