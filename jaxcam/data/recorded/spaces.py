"""A recorded dataset's actions in another of the four spaces, where it is known what they are.

Targets and what they move by become each other as they do for simulated demonstrations
(`jaxcam.sim.actions`). Between grip poses and joint angles lies the arm, whose lengths nobody says.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, cast

import numpy as np
from scipy.spatial.transform import Rotation

from jaxcam.config.names import ActionChoice, ActionMeaning
from jaxcam.config.train import TrainConfig
from jaxcam.data.recorded.parts import meaning_of, opens_gripper
from jaxcam.data.recorded.recording import Episode, Recording
from jaxcam.errors import ConfigError
from jaxcam.sim.actions import decode, encode, is_absolute, is_joint

AGREE_M, AGREE_RAD = 0.1, 0.3
"""What the state says of the grip and the first target are this near, or they are not in the same
frame."""
NEAR = 0.5
"""Deviations of what is felt within which most commands are that say where to be."""
_Form = Literal["rotation vector", "Euler angles"]
_EULER = re.compile(r"roll|pitch|yaw|euler")
_AXIS = re.compile(r"(?:^|[._ ])(?:pos(?:ition)?[._ ]?)?([xyz])$")
_FOUR = re.compile(r"quat|^q[wxyz]$|[._]q[wxyz]$|rot6d")


@dataclass(frozen=True)
class _Poses:
    """Where the targets are in the actions, and what was measured is in the state."""

    action: tuple[int, ...]
    """Columns that are grip poses (position, rotation) or joint angles; others stay as they are."""
    state: tuple[int, ...]
    """Columns of the same quantities; empty where no names say which."""
    form: tuple[_Form, _Form] = ("rotation vector", "rotation vector")
    """How the rotations of action and state are written."""


def named_meaning(recording: Recording) -> ActionMeaning:
    """What actions are that have the names of what is felt, and stay near it: where to be.

    Names alone do not tell, since what a grip moves by is called x, y and z as well.

    Args:
        recording: The dataset.
    """
    commanded = [i for i, n in enumerate(recording.action_names) if not opens_gripper(n)]
    names, state = [recording.action_names[i] for i in commanded], list(recording.state_names)
    if not names or not set(names) <= set(state):
        return "unknown"
    columns = [state.index(name) for name in names]
    felt = np.concatenate([e.state[:, columns] for e in recording.episodes])
    apart = np.concatenate([e.action[:, commanded] for e in recording.episodes]) - felt
    if (np.median(np.abs(apart), 0) > NEAR * np.maximum(felt.std(0), 1e-6)).any():
        return "unknown"
    axes = {match[1] for name in names if (match := _AXIS.search(name.lower()))}
    if axes != set("xyz"):
        return "joint_abs"
    grip, first = meaning_of(recording).grip, commanded[:3] == [0, 1, 2]
    return "eef_abs" if first and tuple(columns[:3]) == grip else "unknown"


def as_learned(recording: Recording, config: TrainConfig) -> Recording:
    """The dataset as a run learns from it.

    Args:
        recording: As it was recorded.
        config: The run's settings; its actions are what `action_is` says, if it says anything.

    Raises:
        ConfigError: Its actions cannot become those that are asked for.
    """
    if config.action_is != "unknown":
        recording = replace(recording, action_is=config.action_is)
    wanted = vars(config)["action_space"] or "native"
    grip = meaning_of(recording, config.grip).grip or ()
    return in_space(recording, recording.action_is, wanted, grip)


def in_space(
    recording: Recording, meaning: ActionMeaning, wanted: ActionChoice, grip: Sequence[int] = ()
) -> Recording:
    """The dataset with its actions in another space.

    Args:
        recording: The dataset.
        meaning: What its actions are.
        wanted: What they are to become; "native" leaves them alone. The space that they are in
            already makes Euler angles rotation vectors.
        grip: Columns of the state that are the grip's position.

    Raises:
        ConfigError: They cannot become that, by what is known of them.
    """
    if wanted == "native" or (wanted == meaning and is_joint(meaning)):
        return recording
    why = _obstacle(meaning, wanted)
    poses = None if why else _poses(recording, is_joint(meaning), grip)
    if isinstance(poses, str):
        why = poses
    if why or not isinstance(poses, _Poses):
        raise ConfigError(
            f"--action-space {wanted}: {why}. Leave it out to learn them as they are."
        )
    if wanted == meaning and poses.form[0] == "rotation vector":
        return recording
    starts = _starts(recording, poses, meaning)
    if starts is None and wanted != meaning and not is_absolute(meaning):
        raise ConfigError(
            f"--action-space {wanted}: actions that say how far to go lead somewhere only from "
            f"where the {'joints' if is_joint(meaning) else 'grip'} first stood, position and "
            f"rotation, and no names of the state say that ({', '.join(recording.state_names)}). "
            "Leave it out to learn them as they are."
        )
    episodes = []
    for number, episode in enumerate(recording.episodes):
        start = None if starts is None else starts[number]
        action = _converted(episode, poses, (meaning, wanted), start)
        episodes.append(replace(episode, action=action))
    return replace(
        recording,
        action_names=_names(recording, poses),
        action_is=cast(ActionMeaning, wanted),
        episodes=episodes,
        fingerprint=f"{recording.fingerprint}-{meaning}-{wanted}",
        pictures=recording.pictures_fingerprint,
    )


def _obstacle(meaning: ActionMeaning, wanted: ActionChoice) -> str:
    """Why no dataset's actions of one kind become another; empty where they may."""
    if meaning == "unknown":
        return (
            "nobody says what this dataset's actions are; say it with --action-is, such as "
            "--action-is eef_abs"
        )
    if wanted == "eef_delta_componentwise":
        return "this way of differencing is for simulated tasks"
    if is_joint(meaning) != is_joint(wanted):
        return (
            f"the dataset has {meaning}, and only the arm's own lengths lead from one to the other"
        )
    return ""


def _poses(recording: Recording, joints: bool, grip: Sequence[int]) -> _Poses | str:
    """Where poses are in actions and state; or why that is not known."""
    names = [name.lower() for name in recording.action_names]
    if joints:
        action = tuple(i for i, name in enumerate(names) if not opens_gripper(name))
        return _Poses(action, _same_joints(recording, action))
    if len(names) < 6:
        return f"a position and a rotation are six numbers, and an action has {len(names)}"
    if four := [name for name in names if _FOUR.search(name)]:
        return (
            "rotations must be three numbers behind the position, a rotation vector or Euler "
            f"angles (x, y, z about fixed axes), and there is {four[0]!r}"
        )
    if grippers := [name for name in names[:6] if opens_gripper(name)]:
        return (
            "a position and a rotation are the first six numbers of an action, and one of those "
            f"is {grippers[0]!r}"
        )
    turned = _rotations(recording, grip)
    state = [name.lower() for name in recording.state_names]
    form = (_form(names[3:6]), _form([state[i] for i in turned]))
    return _Poses(tuple(range(6)), (*grip, *turned) if turned else (), form)


def _form(names: Sequence[str]) -> _Form:
    return "Euler angles" if any(map(_EULER.search, names)) else "rotation vector"


def _same_joints(recording: Recording, action: Sequence[int]) -> tuple[int, ...]:
    """Columns of the state that are what some columns of the action command, by their names."""
    state = list(recording.state_names)
    names = [recording.action_names[i] for i in action]
    if set(names) <= set(state):
        return tuple(state.index(name) for name in names)
    joints = tuple(i for i, name in enumerate(state) if "joint" in name.lower())
    return joints if len(joints) == len(action) else ()


def _rotations(recording: Recording, grip: Sequence[int]) -> tuple[int, ...]:
    """The three columns behind the grip's position, where their names are a rotation's."""
    behind = tuple(range(grip[-1] + 1, grip[-1] + 4)) if grip else ()
    names = [recording.state_names[i].lower() for i in behind if i < len(recording.state_names)]
    is_turn = re.compile(r"(?:^|[._ ])(?:r[xyz]|roll|pitch|yaw|rot\w*|euler\w*|axis_angle\w*)$")
    return behind if len(names) == 3 and all(map(is_turn.search, names)) else ()


def _starts(recording: Recording, poses: _Poses, meaning: ActionMeaning) -> np.ndarray | None:
    """What was measured as each episode began [episodes, N]; None where nobody says.

    Targets that are far from what is measured are in another frame than that.
    """
    if not poses.state:
        return None
    measured = np.stack([e.state[0, list(poses.state)] for e in recording.episodes])
    measured = _as_vectors(measured, poses.form[1])
    if is_absolute(meaning):
        first = np.stack([e.action[0, list(poses.action)] for e in recording.episodes])
        first = _as_vectors(first, poses.form[0])
        if is_joint(meaning):
            # In radians, degrees or steps of a motor: by how far the joints move.
            felt = np.concatenate([e.state[:, list(poses.state)] for e in recording.episodes])
            far = np.abs(first - measured).max(-1) > NEAR * felt.std(0).max()
        else:
            turn = Rotation.from_rotvec(first[:, 3:]) * Rotation.from_rotvec(measured[:, 3:]).inv()
            away = np.linalg.norm(first[:, :3] - measured[:, :3], axis=-1)
            far = (away > AGREE_M) | (turn.magnitude() > AGREE_RAD)
        if far.mean() > 0.5:
            return None
    return measured


def _as_vectors(poses: np.ndarray, form: _Form) -> np.ndarray:
    """Poses [T, N] whose rotations are vectors (rad), float64."""
    poses = np.asarray(poses, np.float64)
    if form == "rotation vector":
        return poses
    turns = Rotation.from_euler("xyz", poses[:, 3:]).as_rotvec()
    return np.concatenate([poses[:, :3], turns], -1)


def _converted(
    episode: Episode,
    poses: _Poses,
    spaces: tuple[ActionMeaning, ActionChoice],
    start: np.ndarray | None,
) -> np.ndarray:
    """An episode's actions in another space, float32 [T, A].

    Where it is not known what was measured, the first target is where the robot stood: the first
    step is none.
    """
    meaning, wanted = spaces
    moves = _as_vectors(episode.action[:, list(poses.action)], poses.form[0])
    anchor = moves[0] if start is None else start
    unused, axes = np.zeros(len(moves)), np.eye(3)
    chunk = np.concatenate([moves, unused[:, None]], -1)[None]
    targets = decode(meaning, chunk, anchor[None], axes)[0][0]
    action = episode.action.astype(np.float64)
    action[:, list(poses.action)] = encode(wanted, targets, unused, anchor, axes)[:, :-1]
    return action.astype(np.float32)


def _names(recording: Recording, poses: _Poses) -> tuple[str, ...]:
    """Names of the new actions' numbers; rotations have become vectors."""
    names = list(recording.action_names)
    if poses.form[0] == "Euler angles":
        names[3:6] = ("rx", "ry", "rz")
    return tuple(names)
