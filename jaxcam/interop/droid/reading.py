"""DROID's raw layout, as its robots recorded it and as it is released.

    <any folders>/<episode>/trajectory.h5            what was felt and done at each step
                            metadata_<uuid>.json     success, task, the cameras' serials
                            recordings/MP4/<serial>.mp4          left eye, a picture a step
                                           <serial>-stereo.mp4   both eyes, not read

and, in the folder that is read, the authors' later annotations if they are there:
`droid_language_annotations.json`, `cam2base_extrinsics.json`, `cam2base_extrinsic_superset.json`,
`intrinsics.json` (huggingface.co/KarlP/droid). Sources: droid-dataset.github.io and the repository
droid-dataset/droid. Failures are left out, and so are steps at which the operator's command was not
sent to the robot, as DROID's own training does.
"""

import hashlib
import os
from collections.abc import Iterator
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, Literal

import h5py
import numpy as np
from rich.console import Console

from jaxcam.config.names import ActionMeaning
from jaxcam.data.hdf5 import group_at, numbers, open_hdf5, reading
from jaxcam.data.recorded.recording import Episode, Recording, Sight
from jaxcam.errors import DatasetError
from jaxcam.interop.droid.annotations import (
    Annotations,
    Metadata,
    instruction_of,
    read_annotations,
    read_metadata,
)
from jaxcam.interop.droid.cameras import VIEWS, OpenEpisode, placement, roles_of
from jaxcam.interop.droid.videos import Video, decode_video, open_video

Actions = Literal["joint_position", "cartesian_position", "joint_velocity", "cartesian_velocity"]
"""Which of the actions that DROID records; each is followed by the gripper's position."""
MEANINGS: dict[Actions, ActionMeaning] = {
    "joint_position": "joint_abs",
    "cartesian_position": "eef_abs",
}
"""What those are that have a place among the four spaces; velocities have none."""
RATE = 15.0
"""Steps a second of DROID's control loop."""
JOINTS = tuple(f"joint_{i}" for i in range(1, 8))
POSE = ("x", "y", "z", "roll", "pitch", "yaw")
GRIPPER = "gripper"
TRAJECTORY = "trajectory.h5"
DEPTH = 5
"""Folders down to which episodes are looked for: lab, outcome, day, episode, and one more."""
LOOKED_AT = 10_000
"""Folders that are looked into before a folder is taken for one without episodes."""
MISSING = int(RATE)
"""Pictures that a video may lack: its last step has none, and the episode then ends earlier."""
REMEDY = "Copy the episode again."


def is_droid(path: Path) -> bool:
    """Whether a folder is an episode of DROID's, or has some."""
    return any(TRAJECTORY in files for _, files in islice(_walk(path), LOOKED_AT))


def read_droid(
    path: Path, actions: Actions = "joint_position", console: Console | None = None
) -> Recording:
    """Reads an episode, or all episodes in a folder; no picture is decoded.

    Args:
        path: The folder.
        actions: Which of DROID's actions.
        console: Where to tell what is left out; silent when None.

    Returns:
        State: seven joint angles (rad) and the gripper, from 0 open to 1 closed. Action: seven
        numbers of joints (rad, rad/s) or six of the grip (m, m/s; XYZ Euler angles, rad, rad/s),
        and the gripper's commanded position. Cameras have placements, of which
        `jaxcam.interop.calibrations` makes calibrations.

    Raises:
        DatasetError: There is no episode to learn from, or a file is missing or damaged.
        ConfigError: An episode's metadata has a value of another kind.
        CameraError: Extrinsics or intrinsics cannot be.
    """
    annotations = read_annotations(path)
    episodes, failures, unusable = [], 0, 0
    seal, films = hashlib.sha256(actions.encode()), hashlib.sha256()
    for folder in (folder for folder, files in _walk(path) if TRAJECTORY in files):
        metadata = read_metadata(folder)
        outcome = folder.relative_to(path).parts
        if metadata.success is False or (metadata.success is None and "failure" in outcome):
            failures += 1
            continue
        videos = _videos(folder)
        episode = videos and _episode(folder, metadata, videos, annotations, actions, (seal, films))
        if episode:
            episodes.append(episode)
        else:
            unusable += 1
    left_out = f"{failures} failures and {unusable} episodes without videos or without commands"
    if not episodes:
        raise DatasetError(
            f"{path}: no episode of DROID's to learn from, but {left_out}. Expected folders with "
            f"{TRAJECTORY}, metadata_<uuid>.json and recordings/MP4."
        )
    if console and failures + unusable:
        console.print(f"{path}: left out {left_out}.", markup=False, highlight=False)
    arm = JOINTS if actions.startswith("joint") else POSE
    return Recording(
        path=path,
        views=tuple(v for v in VIEWS.values() if any(v in e.sights for e in episodes)),
        state_names=(*JOINTS, GRIPPER),
        action_names=(*arm, GRIPPER),
        rate=RATE,
        episodes=episodes,
        action_is=MEANINGS.get(actions, "unknown"),
        fingerprint=seal.hexdigest()[:16],
        pictures=films.hexdigest()[:16],
    )


def _walk(path: Path) -> Iterator[tuple[Path, list[str]]]:
    """Folders and their files, in order; what is in an episode is not looked into."""
    for place, folders, files in os.walk(path):
        folder = Path(place)
        deep = len(folder.relative_to(path).parts) >= DEPTH
        folders[:] = [] if deep or TRAJECTORY in files else sorted(folders)
        yield folder, files


def _videos(folder: Path) -> dict[str, Video]:
    """An episode's videos of one eye, by the camera's serial."""
    files = sorted((folder / "recordings" / "MP4").glob("*.mp4"))
    return {file.stem: open_video(file) for file in files if not file.stem.endswith("-stereo")}


def _episode(
    folder: Path,
    metadata: Metadata,
    videos: dict[str, Video],
    annotations: Annotations,
    actions: Actions,
    seals: tuple[Any, Any],
) -> Episode | None:
    """One episode; None if the robot was never told to act.

    What it has goes into the first seal, which pictures it has into both.
    """
    path = folder / TRAJECTORY
    with open_hdf5(path, remedy=REMEDY) as file, reading(path, REMEDY):
        state, action = _state_and_action(file, actions)
        roles = roles_of(metadata, file)
        used = {serial: videos[serial] for serial in sorted(roles) if serial in videos}
        if not used:
            raise DatasetError(
                f"{folder}: its cameras are {', '.join(roles) or 'none'}, but the videos are of "
                f"{', '.join(videos)}."
            )
        steps = _steps(file, len(state), used)
        if not len(steps):
            return None
        episode = OpenEpisode(file, metadata, annotations, steps)
        where = f"episode '{metadata.uuid}'"
        sights = {
            VIEWS[roles[serial]]: Sight(
                video.height,
                video.width,
                partial(decode_video, video, steps, where),
                placement=placement(episode, serial, roles[serial], video),
            )
            for serial, video in used.items()
        }
    state, action = state[steps], action[steps]
    instruction = instruction_of(metadata, annotations)
    pictures = [(roles[serial], video.identity) for serial, video in used.items()]
    seal, films = seals
    films.update(repr((metadata.uuid, steps.tolist(), pictures)).encode())
    seal.update(repr((metadata.uuid, instruction, steps.tolist(), pictures)).encode())
    seal.update(state.tobytes() + action.tobytes())
    return Episode(metadata.uuid, state, action, instruction, sights)


def _state_and_action(file: h5py.File, actions: Actions) -> tuple[np.ndarray, np.ndarray]:
    """What was felt and done at each step, float32 [T, 8] and [T, 7] or [T, 8]."""
    robot = group_at(group_at(file, "observation"), "robot_state")
    commands = group_at(file, "action")
    columns = {
        "state": (numbers(robot, "joint_positions"), numbers(robot, "gripper_position")),
        "action": (numbers(commands, actions), numbers(commands, "gripper_position")),
    }
    length, result = len(columns["state"][0]), {}
    for what, (arm, gripper) in columns.items():
        width = len(JOINTS) if what == "state" or actions.startswith("joint") else len(POSE)
        if arm.shape != (length, width) or gripper.size != length:
            raise DatasetError(
                f"{file.filename}: {what} of shapes {list(arm.shape)} and {list(gripper.shape)}; "
                f"expected [{length}, {width}] and [{length}]."
            )
        with np.errstate(over="ignore"):  # what is too large becomes infinite, and is refused
            array = np.concatenate([arm, gripper.reshape(-1, 1)], 1).astype(np.float32)
        if not np.isfinite(array).all():
            step = int(np.argwhere(~np.isfinite(array))[0, 0])
            raise DatasetError(f"{file.filename}: NaN or infinity in the {what} of step {step}.")
        result[what] = array
    return result["state"], result["action"]


def _steps(file: h5py.File, length: int, videos: dict[str, Video]) -> np.ndarray:
    """Numbers of the steps that are used: all cameras saw them, and the robot was told to act."""
    counts = {video.path: video.length for video in videos.values() if video.length is not None}
    shortest = min(counts, key=counts.__getitem__) if counts else None
    end = length if shortest is None else min(length, counts[shortest])
    if length - end > MISSING:
        raise DatasetError(
            f"{shortest}: {end} pictures, expected {length}, as there are steps in "
            f"{file.filename}. Likely cause: it is truncated. {REMEDY}"
        )
    observation = group_at(file, "observation")
    moves = np.ones(length, bool)
    for group, name, skipped in (
        ("timestamp", "skip_action", 1),
        ("controller_info", "movement_enabled", 0),
    ):
        if group in observation and name in group_at(observation, group):
            flags = numbers(group_at(observation, group), name).reshape(-1)
            if len(flags) != length:
                raise DatasetError(
                    f"{file.filename}: observation/{group}/{name}: {len(flags)} steps, expected "
                    f"{length}."
                )
            moves = flags != skipped
            break
    return np.flatnonzero(moves[:end])
