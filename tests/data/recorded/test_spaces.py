"""Recorded actions in other spaces: targets and what they move by, there and back."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxcam.config.train import TrainConfig
from jaxcam.data.recorded.recording import Episode, Recording
from jaxcam.data.recorded.spaces import as_learned, in_space, named_meaning
from jaxcam.errors import ConfigError

POSE = ("x", "y", "z", "rx", "ry", "rz", "gripper")
GRIP = ("grip_x", "grip_y", "grip_z")
STEPS = (40, 30)


def rotations(rng, count):
    """Turns that stay near half a turn, where rotation vectors jump."""
    wander = Rotation.from_rotvec(np.cumsum(rng.normal(0, 0.1, (count, 3)), 0))
    return wander * Rotation.from_rotvec([np.pi - 0.02, 0, 0])


def made(states, actions, state_names, action_names):
    episodes = [
        Episode(str(i), s.astype(np.float32), a.astype(np.float32), "", {})
        for i, (s, a) in enumerate(zip(states, actions, strict=True))
    ]
    return Recording(Path("d"), (), state_names, action_names, 10.0, episodes, "f", pictures="p")


def grips(form="rotvec", state_turns=("rx", "ry", "rz"), offset=0.0):
    """Grip poses that trail behind their targets by a step."""
    rng = np.random.default_rng(0)
    states, actions = [], []
    for count in STEPS:
        turns = rotations(rng, count + 1)
        way = np.cumsum(rng.normal(0, 0.01, (count + 1, 3)), 0) + 0.4
        gripper = rng.choice([-1.0, 1.0], (count, 1))
        written = turns.as_rotvec() if form == "rotvec" else turns.as_euler("xyz")
        states.append(np.concatenate([way[:-1] + offset, written[:-1]], 1))
        actions.append(np.concatenate([way[1:], written[1:], gripper], 1))
    names = POSE if form == "rotvec" else ("x", "y", "z", "roll", "pitch", "yaw", "gripper")
    return made(states, actions, (*GRIP, *state_turns), names)


def joints(state_names=tuple(f"joint_{i}" for i in range(6))):
    rng = np.random.default_rng(1)
    ways = [np.cumsum(rng.normal(0, 0.05, (count + 1, 6)), 0) for count in STEPS]
    actions = [np.concatenate([w[1:], np.sign(w[1:, :1])], 1) for w in ways]
    names = (*(f"joint_{i}" for i in range(6)), "gripper")
    return made([w[:-1] for w in ways], actions, state_names, names)


def turn(action):
    return Rotation.from_rotvec(action[:, 3:6])


@pytest.mark.parametrize("form", ["rotvec", "euler"])
def test_grip_poses_become_moves_and_back(form):
    turns = ("rx", "ry", "rz") if form == "rotvec" else ("roll", "pitch", "yaw")
    before = grips(form, turns)
    moves = in_space(before, "eef_abs", "eef_delta", (0, 1, 2))
    assert (moves.action_is, moves.action_names) == ("eef_delta", POSE)
    plain = grips("rotvec")
    for old, new in zip(plain.episodes, moves.episodes, strict=True):
        np.testing.assert_allclose(
            new.action[:, :3], old.action[:, :3] - old.state[:, :3], atol=1e-6
        )
        now, measured = turn(old.action), Rotation.from_rotvec(old.state[:, 3:])
        np.testing.assert_allclose((turn(new.action) * measured).as_matrix(), now.as_matrix(),
                                   atol=1e-5)  # fmt: skip
        np.testing.assert_array_equal(new.action[:, 6], old.action[:, 6])
    back = in_space(moves, "eef_delta", "eef_abs", (0, 1, 2))
    for old, new in zip(plain.episodes, back.episodes, strict=True):
        np.testing.assert_allclose(new.action[:, :3], old.action[:, :3], atol=1e-5)
        np.testing.assert_allclose(turn(new.action).as_matrix(), turn(old.action).as_matrix(),
                                   atol=1e-5)  # fmt: skip
        assert (np.linalg.norm(np.diff(new.action[:, 3:6], axis=0), axis=-1) < 1).all()  # no jumps


def test_joints_become_moves_and_back():
    before = joints()
    moves = in_space(before, "joint_abs", "joint_delta")
    for old, new in zip(before.episodes, moves.episodes, strict=True):
        np.testing.assert_allclose(new.action[:, :6], old.action[:, :6] - old.state, atol=1e-6)
        np.testing.assert_array_equal(new.action[:, 6], old.action[:, 6])
    back = in_space(moves, "joint_delta", "joint_abs")
    for old, new in zip(before.episodes, back.episodes, strict=True):
        np.testing.assert_allclose(new.action, old.action, atol=1e-5)


def test_joints_in_degrees_count_from_what_was_measured():
    before = joints()
    for episode in before.episodes:
        episode.state[:] = np.rad2deg(episode.state)
        episode.action[:, :6] = np.rad2deg(episode.action[:, :6])
    moves = in_space(before, "joint_abs", "joint_delta")
    for old, new in zip(before.episodes, moves.episodes, strict=True):
        np.testing.assert_allclose(new.action[0, :6], old.action[0, :6] - old.state[0], atol=1e-4)
        assert np.abs(new.action[0, :6]).max() > 0.3


@pytest.mark.parametrize(
    "recording",
    [grips(state_turns=("a", "b", "c")), grips(offset=0.5), joints(tuple("abcdef"))],
    ids=["no rotation in the state", "a state in another frame", "joints without names"],
)
def test_where_nobody_says_what_was_measured_the_first_step_is_none(recording):
    kind = "joint" if "joint_0" in recording.action_names else "eef"
    moves = in_space(recording, f"{kind}_abs", f"{kind}_delta", (0, 1, 2))
    for old, new in zip(recording.episodes, moves.episodes, strict=True):
        np.testing.assert_allclose(new.action[0, :6], 0, atol=1e-6)
        np.testing.assert_allclose(
            new.action[1:, :3], np.diff(old.action[:, :3], axis=0), atol=1e-6
        )
    with pytest.raises(ConfigError, match="first stood"):
        in_space(replace(moves, state_names=tuple("abcdef")), f"{kind}_delta", f"{kind}_abs")


@pytest.mark.parametrize(
    ("recording", "spaces", "words"),
    [
        (grips(), ("unknown", "eef_delta"), "say it with --action-is"),
        (grips(), ("eef_abs", "joint_abs"), "the arm's own lengths"),
        (joints(), ("joint_abs", "eef_delta"), "the arm's own lengths"),
        (grips(), ("eef_abs", "eef_delta_componentwise"), "for simulated tasks"),
        (
            replace(grips(), action_names=("x", "y", "z", "roll", "pitch", "gripper", "d")),
            ("eef_abs", "eef_delta"),
            "one of those is 'gripper'",
        ),
        (
            replace(grips(), action_names=("x", "y", "z", "qx", "qy", "qz", "qw")),
            ("eef_abs", "eef_delta"),
            "rotations must be three numbers",
        ),
        (replace(grips(), action_names=tuple("xyzab")), ("eef_abs", "eef_delta"), "six numbers"),
    ],
)
def test_what_cannot_be_told_is_refused(recording, spaces, words):
    with pytest.raises(ConfigError, match=words):
        in_space(recording, *spaces, (0, 1, 2))


def test_actions_that_are_near_what_is_felt_by_the_same_name_say_where_to_be():
    targets = joints()
    assert named_meaning(targets) == "joint_abs"
    assert named_meaning(replace(targets, state_names=tuple("abcdef"))) == "unknown"
    assert named_meaning(in_space(targets, "joint_abs", "joint_delta")) == "unknown"
    names = (*GRIP, "rx", "ry", "rz", "gripper")
    poses = replace(grips(), action_names=names)
    assert named_meaning(poses) == "eef_abs"
    assert named_meaning(in_space(poses, "eef_abs", "eef_delta", (0, 1, 2))) == "unknown"


def test_places_are_no_joints():
    poses, names = grips(), (*POSE[:6], "gripper")
    for which in (names, (*(f"tool.{name}" for name in names[:6]), "gripper")):
        named = replace(poses, action_names=which, state_names=which[:6])
        assert named_meaning(named) == "unknown"


@pytest.mark.parametrize("kind", ["eef_abs", "eef_delta"])
def test_in_the_space_that_they_are_in_rotations_become_vectors(kind):
    turned = grips("euler", ("a", "b", "c"))
    vectors = in_space(turned, kind, kind)
    assert (vectors.action_names, vectors.action_is) == (POSE, kind)
    assert vectors.fingerprint != turned.fingerprint
    for old, new in zip(turned.episodes, vectors.episodes, strict=True):
        wanted = Rotation.from_euler("xyz", old.action[:, 3:6]).as_matrix()
        np.testing.assert_allclose(turn(new.action).as_matrix(), wanted, atol=1e-5)
        np.testing.assert_allclose(new.action[:, [0, 1, 2, 6]], old.action[:, [0, 1, 2, 6]],
                                   atol=1e-6)  # fmt: skip


def test_a_run_learns_what_its_settings_ask_for():
    recording = replace(grips(), action_is="eef_abs")
    assert as_learned(recording, TrainConfig()) == recording
    assert as_learned(recording, TrainConfig(action_space="eef_abs")) == recording
    moves = as_learned(recording, TrainConfig(action_space="eef_delta"))
    assert moves.action_is == "eef_delta"
    assert moves.fingerprint != recording.fingerprint
    assert moves.pictures_fingerprint == recording.pictures_fingerprint
    # What a flag says counts more than what the dataset says.
    other = as_learned(recording, TrainConfig(action_is="eef_delta", action_space="eef_abs"))
    assert (other.action_is, other.fingerprint == moves.fingerprint) == ("eef_abs", False)
